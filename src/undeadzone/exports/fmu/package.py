"""The FMU itself: model description, a binary for this computer, and the C to build others."""

from __future__ import annotations

import io
import platform
import sys
import tempfile
import zipfile
from importlib import resources
from pathlib import Path
from typing import Any

from undeadzone.errors import InputError
from undeadzone.exports import compiler
from undeadzone.exports.code import Code
from undeadzone.exports.fmu.description import build_description, description, token, variables
from undeadzone.scenario.schema import Units

MODEL = """/* What fmu.h needs to know of {prefix}; written by undeadzone {version}, do not edit. */
#ifndef FMU_MODEL_H
#define FMU_MODEL_H

#include "{prefix}.h"

#define FMU_TOKEN "{token}"
#define FMU_STEP {step!r} /* [s] */
#define FMU_INPUTS {inputs}u
#define FMU_READINGS {readings}u
#define FMU_OUTPUTS {outputs}u
#define FMU_PARAMS {params}u

typedef {real} fmu_real;
typedef {prefix}_state fmu_state;
typedef {prefix}_in fmu_in;
typedef {prefix}_out fmu_out;
{tunable}
#define FMU_START(state) {prefix}_init(state)

#endif
"""
TUNABLE = """typedef {prefix}_params fmu_params;
#define FMU_DEFAULT(params) {prefix}_params_default(params)
#define FMU_SAMPLE(state, params, in, out) {prefix}_step(state, params, in, out)"""
FIXED = """typedef struct
{{
    {real} none;
}} fmu_params;
#define FMU_DEFAULT(params) ((params)->none = 0)
#define FMU_SAMPLE(state, params, in, out) {prefix}_step(state, in, out)"""

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
        sources[name] = resources.files(__package__).joinpath(name).read_text(encoding="utf-8")
    compiled = sorted(name for name in sources if name.endswith(".c"))
    contents: dict[str, str | bytes] = {
        "modelDescription.xml": description(report, listed, compiled, version)
    }
    contents[binary_path(prefix, version)] = _binary(sources, compiled)
    if version == 3:
        contents["sources/buildDescription.xml"] = build_description(prefix, compiled)
    contents |= {f"sources/{name}": text for name, text in sorted(sources.items())}
    return _zipped(contents)


def _model(printed: Code, report: dict[str, Any], version: int) -> str:
    """The text of fmu_model.h."""
    step, prefix = printed.step, report["name"]
    real = "float" if printed.single else "double"
    tunable = (TUNABLE if step.params else FIXED).format(prefix=prefix, real=real)
    return MODEL.format(
        prefix=prefix,
        version=report["version"],
        token=token(report, version),
        step=step.Ts,
        inputs=sum(field.size for field in step.inputs),
        readings=step.readings,
        outputs=sum(field.size for field in step.outputs),
        params=sum(field.size for field in step.params),
        real=real,
        tunable=tunable,
    )


def _binary(sources: dict[str, str], compiled: list[str]) -> bytes:
    """The shared library."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for path, text in sources.items():
            (folder / path).write_text(text, encoding="utf-8")
        files = [folder / path for path in compiled]
        options = ("-O2", "-fvisibility=hidden")
        return compiler.shared_library(files, folder / "model.so", options).read_bytes()


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
