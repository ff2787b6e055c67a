"""What an export writes for each target: C alone, or the same C inside of something else."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

from undeadzone.exports import folder
from undeadzone.exports.code import Code
from undeadzone.exports.fmu import package
from undeadzone.exports.folder import Files
from undeadzone.exports.python_module import module
from undeadzone.exports.source import Source
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
        around = {"README.md": folder.readme(report, _PYTHON.format(name=name))}
    else:
        version = VERSIONS[to]
        unit = package.package(material.printed, code, report, material.units, version)
        content = {f"{name}.fmu": unit}
        around = {"README.md": folder.readme(report, _FMU.format(name=name, version=version))}
    report["files"] = sorted({*content, *around, folder.MANIFEST})
    return content | around | {folder.MANIFEST: folder.manifest(report)}


_FMU = """`{name}.fmu` is for co-simulation by FMI {version}.0 and needs nothing but an importer.
A step runs every sample that is due from its beginning to just before its end, by the inputs as
they are: what it shows at its end is known from the reading at its beginning. The input
`missing[k]` says that reading `y[k]` is missing. Before the first sample the outputs are what is
known without a reading. Other platforms: compile `sources/*.c` inside of it, as follows."""
_PYTHON = """`import {name}` needs Python 3.8 or later, a C compiler and no package. At the first
use the C is compiled beside the module, for this computer. `{name}.Instance().update(...)` takes
one sample; the module says what else there is."""
