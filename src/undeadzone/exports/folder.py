"""The folder of an export, whose files come in place once all are written."""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path
from typing import Any

from undeadzone.errors import FileError
from undeadzone.support.files import read_text, require_folder, writing
from undeadzone.support.own_files import CURE, digest, edited

Files = dict[str, str | bytes]
GENERATOR = "undeadzone export"
MANIFEST = "manifest.json"


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
    if out.exists() and not out.is_dir():
        raise FileError(f"{out}: is a file; give another folder")
    require_folder(out)
    if not out.exists():
        return
    if force or all(path.name.startswith(".") for path in out.iterdir()):
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
    """Write files into a folder; each takes its place once all are written beside.

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
        if (out / path).parent.resolve() != out.resolve() / Path(path).parent:
            raise FileError(f"{out / path}: a link leads elsewhere; give another folder")
        if not force and path not in own and (out / path).exists():
            raise FileError(f"{out / path}: exists already, and someone else wrote it; {CURE}")
    with writing(out):
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=out, prefix=".fresh-") as name:
            fresh = Path(name)
            for path, content in _signed(files).items():
                (fresh / path).parent.mkdir(parents=True, exist_ok=True)
                (fresh / path).write_bytes(_bytes(content))
            for path in own - files.keys():
                (out / path).unlink(missing_ok=True)
            for path in sorted(files, key=MANIFEST.__eq__):  # the manifest last
                (out / path).parent.mkdir(parents=True, exist_ok=True)
                os.replace(fresh / path, out / path)
    return [out / path for path in files]
