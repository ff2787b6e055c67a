"""What an export writes for each target: C alone, or the same C inside of something else."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

from undeadzone.exports import folder
from undeadzone.exports.code import Code
from undeadzone.exports.fields import Field
from undeadzone.exports.fmu import package
from undeadzone.exports.folder import Files
from undeadzone.exports.source import Source
from undeadzone.exports.template import called, filled
from undeadzone.scenario.schema import Units
from undeadzone.support.text import one_line, printable

# The targets, and the precision that each has by default.
PRECISION: Final = {
    "c": "single",
    "arduino": "single",
    "fmu2": "double",
    "fmu3": "double",
    "python": "double",
    "page": "double",
}
VERSIONS: Final = {"fmu2": 2, "fmu3": 3}  # of FMI


class Material(NamedTuple):
    """What the files of an export are made of.

    Attributes:
        printed: the graphs.
        text: the C.
        test: the C of the self-test.
        units: names of the scenario's units.
        report: what the manifest holds; `files` is added to it.
    """

    printed: Code
    text: Source
    test: str
    units: Units
    report: dict[str, Any]


def require_possible(to: str, prefix: str) -> None:
    """Raise InputError for a target that cannot be made on this computer.

    Args:
        to: the target.
        prefix: what every symbol begins with.
    """
    if to in VERSIONS:
        package.require_buildable(prefix, VERSIONS[to])


def files(to: str, material: Material) -> Files:
    """The files of an export by their paths in its folder.

    Args:
        to: the target.
        material: what they are made of.

    Raises:
        InputError: the C compiler refuses an FMU.
    """
    report, name = material.report, material.report["name"]
    code = material.text.files(name)
    content: Files = dict(code)
    if to == "arduino":
        content = {f"src/{path}": text for path, text in code.items()}
        around = _arduino_files(report)
    elif to == "c":
        content[f"{name}_test.c"] = material.test
        around = _build_files(report, bool(material.text.math))
    elif to == "python":
        content[f"{name}.py"] = _module(material.printed, report)
        around = {"README.md": _installed("python", {"name": name}, report)}
    else:
        version = VERSIONS[to]
        unit = package.package(material.printed, code, report, material.units, version)
        content = {f"{name}.fmu": unit}
        around = {"README.md": _installed("fmu", {"name": name, "version": version}, report)}
    report["files"] = sorted({*content, *around, folder.MANIFEST})
    return content | around | {folder.MANIFEST: folder.manifest(report)}


def _readme(report: dict[str, Any], build: str = "") -> str:
    """The README; of what is built, how: by default by make, with the self-test."""
    by_make = f"Run `make && ./{report['name']}_test`: exit code 0 means that every bit agrees."
    words = _words(report) | {
        "shown_title": printable(report["title"]),
        "build": build or by_make,
        "by_make": not build,
        "seconds": f"{report['step']:g}",
        "counts": ", ".join(f"{count} {word}" for word, count in report["operations"].items()),
    }
    for struct, size in report["sizes"].items():
        words[f"{struct}_bytes"] = size
    return filled("templates/README.md", words)


def _words(report: dict[str, Any]) -> dict[str, Any]:
    """What stands for the words of the texts."""
    return report | called(report["name"], bool(report["tunable"]))


def _build_files(report: dict[str, Any], math: bool) -> dict[str, str]:
    """The texts of Makefile, CMakeLists.txt and README.md, by name."""
    words = _words(report)
    words["math"] = f"{report['name']}_math.h " if math else ""
    return {
        "Makefile": filled("templates/Makefile", words),
        "CMakeLists.txt": filled("templates/CMakeLists.txt", words),
        "README.md": _readme(report),
    }


def _arduino_files(report: dict[str, Any]) -> dict[str, str]:
    """The texts around the C of an Arduino library, by name."""
    name = report["name"]
    words = _words(report) | {"upper": name.upper(), "title": one_line(str(report["title"]))}
    build = "Copy this folder into the libraries folder of the Arduino IDE."
    return {
        "library.properties": filled("templates/library.properties", words),
        f"examples/{name}_example/{name}_example.ino": filled("templates/example.ino", words),
        "README.md": _readme(report, build),
    }


def _installed(kind: str, words: dict[str, Any], report: dict[str, Any]) -> str:
    """The README of what takes more than the C."""
    return _readme(report, filled(f"templates/{kind}.md", words).rstrip("\n"))


# --- `--to python`: a module that compiles the exported C and calls it, without undeadzone


def _module(printed: Code, report: dict[str, Any]) -> str:
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
