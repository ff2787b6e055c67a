"""State of live estimation in a file: it is replaced whole, and read as numbers only.

Objects name in `SAVED` what of them a file holds: numbers, arrays, texts, and other such objects.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

import undeadzone
from undeadzone.errors import FileError
from undeadzone.util.files import (
    LARGEST_TABLE,
    convert_read_errors,
    load_arrays,
    replace_file,
)

DIGEST: Final = "digest"


def save(path: Path, parts: Mapping[str, Any], digest: str) -> None:
    """Replace a file by the present numbers. It is on the disk when this returns.

    Args:
        path: of the file.
        parts: objects with `SAVED`, by name.
        digest: of the object that the numbers belong to.

    Raises:
        FileError: it cannot be written.
    """
    arrays: dict[str, Any] = {}
    for owner, name, key in _stored_arrays(parts):
        arrays[key] = np.asarray(getattr(owner, name))
    with replace_file(path) as temporary, open(temporary, "wb") as file:
        np.savez(file, allow_pickle=False, **{DIGEST: np.array(_whole(digest))}, **arrays)
        file.flush()
        os.fsync(file.fileno())


def load(path: Path, parts: Mapping[str, Any], digest: str) -> None:
    """Put the numbers of a file into objects like those that were saved.

    Args:
        path: of the file.
        parts: objects with `SAVED`, by name, as new.
        digest: of the object that the numbers must belong to.

    Raises:
        FileError: it cannot be read, has another content, or belongs to another object.
    """
    cure = ". Name another file, or delete this one to begin anew"
    with convert_read_errors(path, "no state saved by undeadzone, or a damaged one", cure):
        arrays = load_arrays(path, LARGEST_TABLE)
        is_of_these = str(arrays[DIGEST]) == _whole(digest)
        if is_of_these:
            for owner, name, key in _stored_arrays(parts):
                setattr(owner, name, _like(getattr(owner, name), arrays[key], key))
    if not is_of_these:
        raise FileError(
            f"{path}: the state of another observer (model, sensor, options, step or version){cure}"
        )


def _whole(digest: str) -> str:
    """Return a digest, and the version that gives the numbers their names."""
    return f"{undeadzone.__version__} {digest}"


def _stored_arrays(parts: Mapping[str, Any]) -> Iterator[tuple[Any, str, str]]:
    """Yield (owner, attribute, dotted name in the file) of all numbers that objects hold."""
    for above, part in parts.items():
        for name in part.SAVED:
            value = getattr(part, name)
            key = f"{above}.{name}"
            inner = _inner(key, value)
            if not inner and value is not None:
                yield part, name, key
            yield from _stored_arrays(inner)


def _inner(name: str, value: Any) -> dict[str, Any]:
    """Return the objects with `SAVED` under a name, alone or in a list, but no numbers."""
    if hasattr(value, "SAVED"):
        return {name: value}
    if isinstance(value, list):
        return {f"{name}.{k}": part for k, part in enumerate(value) if hasattr(part, "SAVED")}
    return {}


def _like(value: Any, array: Any, name: str) -> Any:
    """Return an array as a value of the same kind, of another shape only if the value is empty.

    Raises ValueError for an array that does not fit.
    """
    known = np.asarray(value)
    grows = known.ndim == 1 and not known.size
    fits = array.ndim == known.ndim if grows else array.shape == known.shape
    if not fits or array.dtype.kind != known.dtype.kind:
        raise ValueError(f"{name} is {array.dtype} {array.shape}")
    return array if isinstance(value, np.ndarray) else array.tolist()
