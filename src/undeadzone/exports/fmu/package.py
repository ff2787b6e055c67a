"""The FMU itself: model description, a binary for this computer, and the C to build others."""

from __future__ import annotations

import io
import platform
import sys
import tempfile
import zipfile
from pathlib import Path
from typing import Any

from undeadzone.errors import InputError
from undeadzone.exports import compiler
from undeadzone.exports.code import Code
from undeadzone.exports.fields import total
from undeadzone.exports.fmu.description import build_description, description, token, variables
from undeadzone.exports.template import filled, text_of
from undeadzone.scenario.schema import Units

PLATFORMS = {  # names of folders in FMI 2.0; those of 3.0 begin with the architecture
    "linux": ("linux", ".so"),
    "darwin": ("darwin", ".dylib"),
    "win32": ("win", ".dll"),
}


def binary_path(prefix: str, version: int) -> str:
    """Where the binary for this computer is kept in an FMU. Raises InputError if FMI has no name.

    Args:
        prefix: the model's identifier.
        version: of FMI, 2 or 3.
    """
    machine = platform.machine().lower()
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(machine, machine)
    known = PLATFORMS.get(sys.platform)
    if known is None or (version == 2 and machine != "x86_64"):
        raise InputError(
            f"to: FMI {version} has no folder for binaries of {sys.platform} on {machine}; "
            "use --to fmu3, or --to c"
        )
    system, ending = known
    folder = f"{system}64"
    if version == 3:
        folder = f"{machine}-{'windows' if system == 'win' else system}"
    return f"binaries/{folder}/{prefix}{ending}"


def require_buildable(prefix: str, version: int) -> None:
    """Raise InputError where no FMU can be built: it needs a compiler and a folder's name.

    Args:
        prefix: the model's identifier.
        version: of FMI, 2 or 3.
    """
    compiler.require_compiler()
    binary_path(prefix, version)


def package(
    printed: Code, files: dict[str, str], report: dict[str, Any], units: Units, version: int
) -> bytes:
    """The FMU.

    Args:
        printed: what was printed.
        files: the C files by name.
        report: what the manifest holds.
        units: names of the scenario's units.
        version: of FMI, 2 or 3.

    Raises:
        InputError: there is no C compiler, or it refuses.
    """
    prefix = report["name"]
    listed = variables(printed.step, units)
    sources = files | {"fmu_model.h": _model(printed, report, version)}
    for name in ("fmu.h", f"fmi{version}.h", f"fmi{version}.c"):
        sources[name] = text_of(f"fmu/{name}")
    compiled = sorted(name for name in sources if name.endswith(".c"))
    contents: dict[str, str | bytes] = {
        "modelDescription.xml": description(report, listed, compiled, version)
    }
    contents[binary_path(prefix, version)] = _binary(sources)
    if version == 3:
        contents["sources/buildDescription.xml"] = build_description(prefix, compiled)
    contents |= {f"sources/{name}": text for name, text in sorted(sources.items())}
    return _zipped(contents)


def _model(printed: Code, report: dict[str, Any], version: int) -> str:
    """The text of fmu_model.h."""
    step = printed.step
    words = report | {
        "token": token(report, version),
        "tunable": bool(step.params),
        "fixed": not step.params,
        "inputs": total(step.inputs),
        "readings": step.readings,
        "outputs": total(step.outputs),
        "params": total(step.params),
        "real": printed.real,
    }
    return filled("templates/fmu_model.h", words)


def _binary(sources: dict[str, str]) -> bytes:
    """The shared library."""
    with tempfile.TemporaryDirectory() as name:
        files = compiler.written(sources, Path(name))
        options = ("-O2", "-fvisibility=hidden")
        return compiler.shared_library(sorted(files), Path(name, "model.so"), options).read_bytes()


def _zipped(contents: dict[str, str | bytes]) -> bytes:
    """A zip file of the same bytes each time."""
    memory = io.BytesIO()
    with zipfile.ZipFile(memory, "w", zipfile.ZIP_DEFLATED) as archive:
        for path, content in contents.items():
            entry = zipfile.ZipInfo(path)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, content)
    return memory.getvalue()
