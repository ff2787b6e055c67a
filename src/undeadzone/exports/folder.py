"""The folder of an export, which takes all files or none."""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path
from typing import Any

from undeadzone.errors import FileError
from undeadzone.support.files import reason, require_folder

Files = dict[str, str | bytes]
GENERATOR = "undeadzone export"
MANIFEST = "manifest.json"


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
