"""The self-test of an export: a C program that compares every bit with reference vectors."""

from __future__ import annotations

import undeadzone
from undeadzone.exports.code import Code
from undeadzone.exports.vectors import OFFSET, PRIME, Vectors

_PROGRAM = """/* Self-test of {prefix}: reference vectors as bits.
   Exit code 0: every bit agrees; 1: not.
   Written by undeadzone {version}; do not edit. */
#include "{prefix}.h"
#include <inttypes.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

enum {{ SAMPLES = {samples}, INPUTS = {inputs}, OUTPUTS = {outputs}, MEMORY = {memory} }};

static const {word} given[SAMPLES][INPUTS] = {{
{input_words}
}};

static const {word} expected[SAMPLES][OUTPUTS] = {{
{output_words}
}};

/* Checksum of the memory after each sample. */
static const uint32_t remembered[SAMPLES] = {{
{state_words}
}};

/* The bits of a number; every NaN has the same. */
static {word} bits_of(const void *number)
{{
    {word} bits;
    (void)memcpy(&bits, number, sizeof bits);
    if ((bits & {magnitude}) > {infinity}) {{
        bits = {nan};
    }}
    return bits;
}}

static uint32_t checksum(const {prefix}_state *state)
{{
    const unsigned char *bytes = (const unsigned char *)state;
    uint32_t total = {offset}u;
    for (size_t k = 0u; k < (size_t)MEMORY; k++) {{
        const {word} bits = bits_of(bytes + (k * sizeof({real})));
        total = (total ^ (uint32_t)(bits & 0xffffffffu)) * {prime}u;
{upper}    }}
    return total;
}}

static int differing(const {prefix}_out *out, int sample)
{{
    const unsigned char *bytes = (const unsigned char *)out;
    int count = 0;
    for (int k = 0; k < OUTPUTS; k++) {{
        if (bits_of(bytes + ((size_t)k * sizeof({real}))) != expected[sample][k]) {{
            count++;
        }}
    }}
    return count;
}}

int main(void)
{{
    {prefix}_state state;
{declare}    {prefix}_in in;
    {prefix}_out out;
    int outputs = 0;
    int states = 0;

{default}    {prefix}_init(&state);
{init}    if ((sizeof in != sizeof given[0]) || (sizeof out != sizeof expected[0])) {{
        (void)printf("{prefix}_test: the structs have gaps\\n");
        return 1;
    }}
    for (int sample = 0; sample < SAMPLES; sample++) {{
        (void)memcpy(&in, given[sample], sizeof in);
        {prefix}_step(&state, {params}&in, &out);
        outputs += differing(&out, sample);
        states += (checksum(&state) != remembered[sample]) ? 1 : 0;
{phases}    }}
    if ((outputs != 0) || (states != 0)) {{
        (void)printf("{prefix}_test: FAILED: %d outputs and %d states differ\\n", outputs, states);
        (void)printf("compile with -ffp-contract=off and without -ffast-math\\n");
        return 1;
    }}
    (void)printf("{prefix}_test: {samples} samples, every bit agrees\\n");
    return 0;
}}
"""

_PHASES = """        {prefix}_estimate(&halves, {params}&in, &out);
        outputs += differing(&out, sample);
        {prefix}_advance(&halves, {params}&in);
        states += (checksum(&halves) != remembered[sample]) ? 1 : 0;
"""


def selftest(code: Code, prefix: str, vectors: Vectors) -> str:
    """The text of the self-test.

    Args:
        code: what is printed.
        prefix: what every symbol begins with.
        vectors: the reference vectors.
    """
    single, phased = code.single, code.phases is not None
    params = "&params, " if code.step.params else ""
    digits = 8 if single else 16
    ending = "u" if single else "ull"
    declare = f"    {prefix}_state halves;\n" if phased else ""
    default = ""
    if code.step.params:
        declare += f"    {prefix}_params params;\n"
        default = f"    {prefix}_params_default(&params);\n"
    upper = f"        total = (total ^ (uint32_t)(bits >> 32)) * {PRIME}u;\n"
    return _PROGRAM.format(
        prefix=prefix,
        version=undeadzone.__version__,
        samples=len(vectors.states),
        inputs=vectors.inputs.shape[1],
        outputs=vectors.outputs.shape[1],
        memory=code.step.start.size,
        real="float" if single else "double",
        word="uint32_t" if single else "uint64_t",
        magnitude="0x7fffffffu" if single else "0x7fffffffffffffffull",
        infinity="0x7f800000u" if single else "0x7ff0000000000000ull",
        nan="0x7fc00000u" if single else "0x7ff8000000000000ull",
        offset=OFFSET,
        prime=PRIME,
        upper="" if single else upper,
        input_words=_rows(vectors.inputs.tolist(), digits, ending),
        output_words=_rows(vectors.outputs.tolist(), digits, ending),
        state_words=_listed(vectors.states, 8, "u"),
        declare=declare,
        default=default,
        init=f"    {prefix}_init(&halves);\n" if phased else "",
        params=params,
        phases=_PHASES.format(prefix=prefix, params=params) if phased else "",
    )


def _rows(rows: list[list[int]], digits: int, ending: str) -> str:
    """Rows of words in braces."""
    return ",\n".join("{\n" + _listed(row, digits, ending) + "\n}" for row in rows)


def _listed(numbers: list[int], digits: int, ending: str) -> str:
    """Words in lines of up to eight."""
    texts = [f"0x{number:0{digits}x}{ending}" for number in numbers]
    count = 64 // digits
    lines = []
    for start in range(0, len(texts), count):
        lines.append("    " + ", ".join(texts[start : start + count]))
    return ",\n".join(lines)
