"""The header with the elementary functions that an export uses."""

from __future__ import annotations

import undeadzone
from undeadzone.exports import elementary
from undeadzone.exports.expressions import Style
from undeadzone.exports.formulas import FUNCTIONS
from undeadzone.exports.statements import returned

BIT_FUNCTIONS = {
    "truncated": """/** x without its fraction. */
static inline {real} {prefix}_truncated({real} x)
{{
    return ({real})({integer})x;
}}""",
    "power": """/** 2^x of a whole number, in the normal range. */
static inline {real} {prefix}_power({real} x)
{{
    const {word} bits = ({word})(({integer})x + {bias}) << {mantissa};
    {real} value;
    (void)memcpy(&value, &bits, sizeof value);
    return value;
}}""",
    "exponent": """/** n of x = 2^n f, 1/sqrt(2) <= f < sqrt(2), of a positive normal number. */
static inline {real} {prefix}_exponent({real} x)
{{
    {word} bits;
    (void)memcpy(&bits, &x, sizeof bits);
    return ({real})({integer})((bits + {raised}) >> {mantissa}) - {bias_real};
}}""",
    "fraction": """/** f of x = 2^n f, 1/sqrt(2) <= f < sqrt(2), of a positive normal number. */
static inline {real} {prefix}_fraction({real} x)
{{
    {word} bits;
    (void)memcpy(&bits, &x, sizeof bits);
    bits = ((bits + {raised}) & {mask}) + {half};
    {real} value;
    (void)memcpy(&value, &bits, sizeof value);
    return value;
}}""",
}


def math_header(functions: list[str], called: set[str], style: Style) -> str:
    """The text of the header with elementary functions.

    Args:
        functions: names of functions, each after those that it calls.
        called: every function that is called, those of a number's bits included.
        style: how numbers and functions are written.
    """
    texts = []
    bits = elementary.bitwise(functions, style.single) | (called & BIT_FUNCTIONS.keys())
    for name, text in BIT_FUNCTIONS.items():
        if name in bits:
            texts.append(text.format(**_bit_words(style)))
    for name in functions:
        texts.append(_function(name, style))
    includes = ["#include <float.h>", "#include <math.h>", "#include <stdbool.h>"]
    if bits:
        includes += ["#include <stdint.h>", "#include <string.h>"]
    guard = f"{style.prefix.upper()}_MATH_H"
    top = [
        f"/* Elementary functions of {style.prefix}, the same bits on every processor.",
        f"   Written by undeadzone {undeadzone.__version__}; do not edit. */",
        f"#ifndef {guard}",
        f"#define {guard}",
        "",
        *includes,
        "",
    ]
    return "\n".join([*top, "\n\n".join(texts), "", "#endif", ""])


def _function(name: str, style: Style) -> str:
    """One elementary function."""
    shape = elementary.formula(name, style.single)
    inputs = {text: text for text in shape.inputs}
    part = returned(shape.graph, style, inputs, {})
    arguments = ", ".join(f"{style.real} {text}" for text in shape.inputs)
    meaning = FUNCTIONS[name].meaning
    head = f"/** {meaning} */\nstatic {style.real} {style.prefix}_{name}({arguments})"
    return "\n".join([head, "{", *part.lines, "}"])


def _bit_words(style: Style) -> dict[str, str]:
    """What stands for the words in `BIT_FUNCTIONS`."""
    words = {"real": style.real, "prefix": style.prefix}
    if style.single:
        return words | {
            "integer": "int32_t",
            "word": "uint32_t",
            "bias": "127",
            "bias_real": "127.0f",
            "mantissa": "23",
            "raised": "(0x3f800000u - 0x3f3504f3u)",
            "mask": "0x007fffffu",
            "half": "0x3f3504f3u",
        }
    return words | {
        "integer": "int64_t",
        "word": "uint64_t",
        "bias": "1023",
        "bias_real": "1023.0",
        "mantissa": "52",
        "raised": "(0x3ff0000000000000u - 0x3fe6a09e667f3bcdu)",
        "mask": "0x000fffffffffffffu",
        "half": "0x3fe6a09e667f3bcdu",
    }
