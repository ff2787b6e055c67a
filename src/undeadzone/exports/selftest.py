"""The self-test of an export: a C program that compares every bit with reference vectors."""

from __future__ import annotations

import undeadzone
from undeadzone.exports.code import Code
from undeadzone.exports.template import called, filled
from undeadzone.exports.vectors import NAN, OFFSET, PRIME, Vectors


def selftest(code: Code, prefix: str, vectors: Vectors) -> str:
    """The text of the self-test.

    Args:
        code: what is printed.
        prefix: what every symbol begins with.
        vectors: the reference vectors.
    """
    digits, ending = (8, "u") if code.single else (16, "ull")
    words = called(prefix, bool(code.step.params)) | {
        "version": undeadzone.__version__,
        "samples": len(vectors.states),
        "inputs": vectors.inputs.shape[1],
        "outputs": vectors.outputs.shape[1],
        "memory": code.step.start.size,
        "real": code.real,
        "word": f"uint{4 * digits}_t",
        "is_double": not code.single,
        "magnitude": "0x7fffffffu" if code.single else "0x7fffffffffffffffull",
        "infinity": "0x7f800000u" if code.single else "0x7ff0000000000000ull",
        "nan": f"0x{NAN[code.kind]:x}{ending}",
        "offset": OFFSET,
        "prime": PRIME,
        "phased": code.phases is not None,
        "input_words": _rows(vectors.inputs.tolist(), digits, ending),
        "output_words": _rows(vectors.outputs.tolist(), digits, ending),
        "state_words": _listed(vectors.states, 8, "u"),
    }
    return filled("templates/selftest.c", words)


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
