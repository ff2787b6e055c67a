"""The files around the C, and the folder that takes them all or none."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

from undeadzone.errors import FileError
from undeadzone.exports.template import called, filled
from undeadzone.support.files import reason, require_folder
from undeadzone.support.text import one_line, printable

Files = dict[str, str | bytes]
GENERATOR = "undeadzone export"
MANIFEST = "manifest.json"


def readme(report: dict[str, Any], build: str = "") -> str:
    """The README of an export.

    Args:
        report: what the manifest holds.
        build: how it is built or installed; default: by make, with the self-test.
    """
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


def build_files(report: dict[str, Any], math: bool) -> dict[str, str]:
    """The texts of Makefile, CMakeLists.txt, README.md and manifest.json, by name."""
    words = _words(report)
    words["math"] = f"{report['name']}_math.h " if math else ""
    return {
        "Makefile": filled("templates/Makefile", words),
        "CMakeLists.txt": filled("templates/CMakeLists.txt", words),
        "README.md": readme(report),
        MANIFEST: manifest(report),
    }


def arduino_files(report: dict[str, Any]) -> dict[str, str]:
    """The texts around the C of an Arduino library, by name."""
    name = report["name"]
    words = _words(report) | {"upper": name.upper(), "title": one_line(str(report["title"]))}
    build = "Copy this folder into the libraries folder of the Arduino IDE."
    return {
        "library.properties": filled("templates/library.properties", words),
        f"examples/{name}_example/{name}_example.ino": filled("templates/example.ino", words),
        "README.md": readme(report, build),
        MANIFEST: manifest(report),
    }


def manifest(report: dict[str, Any]) -> str:
    """The text of the manifest."""
    return json.dumps({"generator": GENERATOR} | report, indent=2) + "\n"


def require_replaceable(out: Path) -> None:
    """Raise FileError unless a folder can be written, and is absent, empty or an earlier export."""
    require_folder(out.absolute().parent)
    if not out.exists():
        return
    if not out.is_dir():
        raise FileError(f"{out}: is a file; give another folder")
    try:
        if not any(out.iterdir()):
            return
        content = json.loads((out / MANIFEST).read_text(encoding="utf-8"))
        ours = isinstance(content, dict) and content.get("generator") == GENERATOR
    except (OSError, ValueError):
        ours = False
    if not ours:
        raise FileError(
            f"{out}: holds no {MANIFEST} of `{GENERATOR}`, so it is not replaced; "
            "give another folder or remove this one"
        )


def write_folder(files: Files, out: Path) -> list[Path]:
    """Write files into a new folder that takes the name `out` once it is whole.

    Args:
        files: texts and bytes by their paths inside the folder.
        out: the folder; an earlier export there is replaced.

    Returns:
        The paths written.

    Raises:
        FileError: it cannot be written, or `out` is something else.
    """
    require_replaceable(out)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=out.parent, prefix=f".{out.name}-") as name:
            fresh = Path(name) / "new"
            for path, content in files.items():
                (fresh / path).parent.mkdir(parents=True, exist_ok=True)
                whole = content.encode() if isinstance(content, str) else content
                (fresh / path).write_bytes(whole)
            if out.exists():
                os.replace(out, Path(name) / "old")
            os.replace(fresh, out)
    except (OSError, ValueError) as error:
        raise FileError(f"{out}: cannot write: {reason(error)}") from None
    return [out / path for path in files]


def remove(out: Path) -> None:
    """Remove a folder."""
    shutil.rmtree(out, ignore_errors=True)
