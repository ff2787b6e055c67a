"""Structs as TOML text, every number exactly; fields that are None are left out."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import tomli_w

from undeadzone.errors import InputError


def dumps(value: msgspec.Struct) -> str:
    """The TOML text of a struct. Raises InputError for what no text can hold."""
    return tomli_w.dumps(tables(value))


def tables(value: msgspec.Struct) -> dict[str, Any]:
    """A struct as dictionaries, lists and numbers, its tag among them, without what is None. Raises InputError for what no text can hold."""
    found: dict[str, Any] = _given(msgspec.to_builtins(value, enc_hook=_plain))
    return found


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.number):
        return value.tolist()
    raise InputError(f"{value!r:.60} cannot be written as TOML; give formulas as text")


def _given(value: Any) -> Any:
    """A tree of dictionaries and lists without the keys that hold None."""
    if isinstance(value, dict):
        return {key: _given(entry) for key, entry in value.items() if entry is not None}
    return [_given(entry) for entry in value] if isinstance(value, list | tuple) else value
