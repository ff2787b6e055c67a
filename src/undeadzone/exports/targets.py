"""What an export writes for each target: C alone, or the same C inside of something else."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

from undeadzone.exports import folder
from undeadzone.exports.code import Code
from undeadzone.exports.fmu import package
from undeadzone.exports.folder import Files
from undeadzone.exports.python_module import module
from undeadzone.exports.source import Source
from undeadzone.exports.template import filled
from undeadzone.scenario.schema import Units

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
        around = folder.arduino_files(report)
    elif to == "c":
        content[f"{name}_test.c"] = material.test
        around = folder.build_files(report, bool(material.text.math))
    elif to == "python":
        content[f"{name}.py"] = module(material.printed, report)
        around = {"README.md": _installed("python", {"name": name}, report)}
    else:
        version = VERSIONS[to]
        unit = package.package(material.printed, code, report, material.units, version)
        content = {f"{name}.fmu": unit}
        around = {"README.md": _installed("fmu", {"name": name, "version": version}, report)}
    report["files"] = sorted({*content, *around, folder.MANIFEST})
    return content | around | {folder.MANIFEST: folder.manifest(report)}


def _installed(kind: str, words: dict[str, Any], report: dict[str, Any]) -> str:
    """The README of what takes more than the C."""
    return folder.readme(report, filled(f"templates/{kind}.md", words).rstrip("\n"))
