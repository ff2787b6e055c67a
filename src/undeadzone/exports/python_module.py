"""`--to python`: a module that compiles the exported C and calls it, without undeadzone."""

from __future__ import annotations

from typing import Any

from undeadzone.exports.code import Code
from undeadzone.exports.fields import Field
from undeadzone.exports.template import filled
from undeadzone.support.text import one_line


def module(printed: Code, report: dict[str, Any]) -> str:
    """The text of the module.

    Args:
        printed: what is printed as C.
        report: what the manifest holds.
    """
    structs = printed.structs
    words = {key: report[key] for key in ("name", "version", "part")} | {
        "title": _plain(report["title"]),
        "hash": repr(report["hash"]),
        "step": repr(report["step"]),
        "seconds": f"{report['step']:g}",
        "arguments": ", ".join(field.name for field in structs["in"]),
        "inputs": _listed(structs["in"]),
        "outputs": _listed(structs["out"]),
        "real": f"c_{printed.real}",
    }
    for name in ("state", "in", "out", "params"):
        words[f"fields_of_{name}"] = _sizes(structs.get(name, []))
    return filled("templates/python_module.txt", words)


def _sizes(fields: list[Field]) -> list[tuple[str, int]]:
    """Names and sizes of the arrays of a struct."""
    return [(field.name, field.size) for field in fields]


def _listed(fields: list[Field]) -> str:
    """Fields in words, a line each."""
    return "".join(
        f"\n    {field.name} ({field.size}): {_plain(field.meaning)}" for field in fields
    )


def _plain(text: str) -> str:
    """A text that ends no docstring."""
    return one_line(text).replace("\\", "/").replace('"', "'")
