"""The files around the C, and the folder that takes them all or none."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

from undeadzone.errors import FileError
from undeadzone.support.files import read_text, reason, require_folder
from undeadzone.support.own_files import CURE, digest, edited
from undeadzone.support.text import one_line, printable

Files = dict[str, str | bytes]
GENERATOR = "undeadzone export"
MANIFEST = "manifest.json"

MAKEFILE = """# `make` builds {name}_test, which compares every bit with the reference: exit code 0.
CFLAGS = -O2 -std=c99 -ffp-contract=off -fno-math-errno -ffunction-sections -Wall
{name}_test: {name}.c {name}.h {math}{name}_test.c
\t$(CC) $(CFLAGS) -o $@ {name}.c {name}_test.c -lm

# `make size` prints the bytes of flash (text) and RAM (data, bss) on a Cortex-M4F.
CROSS = arm-none-eabi-
CORE = -mcpu=cortex-m4 -mthumb -mfloat-abi=hard -mfpu=fpv4-sp-d16
size:
\t$(CROSS)gcc $(CFLAGS) $(CORE) -c -o {name}_target.o {name}.c
\t$(CROSS)size {name}_target.o
.PHONY: size
"""

FLASH = """
`make size` compiles for a Cortex-M4F with arm-none-eabi-gcc (`CROSS` and `CORE` for others) and
prints the bytes of flash: all three calls, of which `--gc-sections` keeps those that you make. For
the time read the chip's counter before and after a step, on a Cortex-M `DWT->CYCCNT`.
"""

CMAKE = """cmake_minimum_required(VERSION 3.10)
project({name} C)
add_library({name} STATIC {name}.c)
target_include_directories({name} PUBLIC ${{CMAKE_CURRENT_SOURCE_DIR}})
target_compile_options({name} PRIVATE
  -std=c99 -ffp-contract=off -fno-math-errno -ffunction-sections)
"""

PROPERTIES = """name={name}
version=1.0.0
author=undeadzone export
maintainer=undeadzone export
sentence={title}
paragraph=An observer that sees through a sensor's dead zone, as C99 without a runtime.
category=Signal Input/Output
url=https://www.arduino.cc
architectures=*
includes={name}.h
"""

SKETCH = """// Reads a sensor on A0 at the sample time and prints what lies behind its dead zone.
#include <{name}.h>

static {name}_state state;
static {name}_in in;
static {name}_out out;
static unsigned long next_sample;
{params_declared}
void setup() {{
  Serial.begin(115200);
{params_default}  {name}_init(&state);
  next_sample = micros();
}}

void loop() {{
  if ((long)(micros() - next_sample) < 0) {{
    return;
  }}
  next_sample += (unsigned long)({upper}_STEP * 1e6f + 0.5f);
  in.y[0] = analogRead(A0);  // scale it to the unit in the header; fill all of `in`
  {name}_step(&state, {params}&in, &out);
  Serial.println(out.z[0]);
}}
"""


def readme(report: dict[str, Any], build: str = "") -> str:
    """The README of an export.

    Args:
        report: what the manifest holds.
        build: how it is built or installed; default: by make, with the self-test.
    """
    name, sizes = report["name"], report["sizes"]
    counts = ", ".join(f"{count} {word}" for word, count in report["operations"].items())
    flash = "" if build else FLASH
    build = build or f"Run `make && ./{name}_test`: exit code 0 means that every bit agrees."
    phases = ""
    if report["two_phase"]:
        phases = f"""
Where u is computed from the estimate, call the halves instead; they give the same bits:

    {name}_estimate(&state, {_params(report)}&in, &out);   /* reads in.y */
    {name}_advance(&state, {_params(report)}&in);          /* reads in.u */
"""
    return f"""# {name}: {printable(report["title"])}

{report["part"]} in {report["precision"]} precision, written by undeadzone {report["version"]}.
Hash {report["hash"]}. The header names the unit of every field.

## Build

{build}
Compile with `-std=c99 -ffp-contract=off` and never with `-ffast-math`. There is no heap, no
recursion, no loop, no static that changes; any number of instances may run, in interrupts too.
The step and its halves stand beside each other: `-ffunction-sections` and the linker's
`--gc-sections` keep what is called.

## Call

    {name}_init(&state);                     /* once */
    {name}_step(&state, {_params(report)}&in, &out);       /* every {report["step"]:g} s */

A reading in `in.y` that is not finite counts as missing.
{phases}
## Cost

Bytes: state {sizes["state"]}, in {sizes["in"]}, out {sizes["out"]}.
One step takes at most these operations, whatever the data: {counts}.
{flash}
## What may not be changed

The files are one whole: the self-test and the hash belong to exactly this code. Change the scenario
and export again.
"""


def _params(report: dict[str, Any]) -> str:
    return "&params, " if report["tunable"] else ""


def build_files(report: dict[str, Any], math: bool) -> dict[str, str]:
    """The texts of Makefile, CMakeLists.txt, README.md and manifest.json, by name."""
    name = report["name"]
    header = f"{name}_math.h " if math else ""
    return {
        "Makefile": MAKEFILE.format(name=name, math=header),
        "CMakeLists.txt": CMAKE.format(name=name),
        "README.md": readme(report),
        MANIFEST: manifest(report),
    }


def arduino_files(report: dict[str, Any]) -> dict[str, str]:
    """The texts around the C of an Arduino library, by name."""
    name = report["name"]
    declared, default = "", ""
    if report["tunable"]:
        declared = f"static {name}_params params;\n"
        default = f"  {name}_params_default(&params);\n"
    sketch = SKETCH.format(
        name=name,
        upper=name.upper(),
        params=_params(report),
        params_declared=declared,
        params_default=default,
    )
    title = one_line(str(report["title"]))
    return {
        "library.properties": PROPERTIES.format(name=name, title=title),
        f"examples/{name}_example/{name}_example.ino": sketch,
        "README.md": readme(
            report, "Copy this folder into the libraries folder of the Arduino IDE."
        ),
        MANIFEST: manifest(report),
    }


def manifest(report: dict[str, Any]) -> str:
    """The text of the manifest."""
    return _text({"generator": GENERATOR} | report)


def require_replaceable(out: Path, force: bool = False) -> None:
    """Raise FileError unless a folder can be written, and is absent, empty or an earlier export.

    Args:
        out: the folder.
        force: whether files of the export that were edited are replaced, too, and whether others
            may be put into any folder.
    """
    require_folder(out.absolute().parent)
    if not out.exists():
        return
    if not out.is_dir():
        raise FileError(f"{out}: is a file; give another folder")
    if force or not any(out.iterdir()):
        return
    written = _written(out)
    if not written:
        raise FileError(
            f"{out}: holds no {MANIFEST} of `{GENERATOR}` as it was written, so it is not "
            f"replaced; {CURE}"
        )
    changed = edited(out, written)
    if changed:
        raise FileError(f"{out / changed[0]}: someone edited it; {CURE}")


def _written(out: Path) -> dict[str, str]:
    """The digests of an export's files by path; none where its manifest is not as written."""
    try:
        text = read_text(out / MANIFEST)
        content = json.loads(text)
        is_whole = text == _text(content) and content["generator"] == GENERATOR
        written = content["files"]
        own, written[MANIFEST] = written[MANIFEST], ""
        if not is_whole or own != digest(_text(content).encode()):
            return {}
    except (OSError, ValueError, KeyError, TypeError):
        return {}
    return {path: value for path, value in written.items() if path != MANIFEST}


def _signed(files: Files) -> Files:
    """The files with the digest of each in the manifest, its own with nothing in that place."""
    content = json.loads(files[MANIFEST])
    content["files"] = {path: digest(_bytes(text)) for path, text in sorted(files.items())}
    content["files"][MANIFEST] = ""
    content["files"][MANIFEST] = digest(_text(content).encode())
    return files | {MANIFEST: _text(content)}


def _text(content: dict[str, Any]) -> str:
    """The text of a manifest."""
    return json.dumps(content, indent=2) + "\n"


def _bytes(content: str | bytes) -> bytes:
    """What a file holds, in bytes."""
    return content.encode() if isinstance(content, str) else content


def write_folder(files: Files, out: Path, force: bool = False) -> list[Path]:
    """Write files into a new folder that takes the name `out` once it is whole.

    Args:
        files: texts and bytes by their paths inside the folder, a manifest among them.
        out: the folder; of an earlier export there its files are replaced, all others stay.
        force: whether files in their places are replaced that someone else wrote or edited.

    Returns:
        The paths written.

    Raises:
        FileError: it cannot be written, or `out` or a file there is something else.
    """
    require_replaceable(out, force)
    before = _written(out)
    own = {MANIFEST, *before} - set(edited(out, before))
    for path in files:
        if not force and path not in own and (out / path).exists():
            raise FileError(f"{out / path}: exists already, and someone else wrote it; {CURE}")

    def replaced(folder: str, names: list[str]) -> list[str]:
        here = Path(folder).relative_to(out)
        return [name for name in names if (here / name).as_posix() in {*own, *files}]

    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=out.parent, prefix=f".{out.name}-") as name:
            fresh = Path(name) / "new"
            for path, content in _signed(files).items():
                (fresh / path).parent.mkdir(parents=True, exist_ok=True)
                (fresh / path).write_bytes(_bytes(content))
            if out.exists():
                shutil.copytree(out, fresh, symlinks=True, ignore=replaced, dirs_exist_ok=True)
                os.replace(out, Path(name) / "old")
            os.replace(fresh, out)
    except (OSError, ValueError) as error:
        raise FileError(f"{out}: cannot write: {reason(error)}") from None
    return [out / path for path in files]
