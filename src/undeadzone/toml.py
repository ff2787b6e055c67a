"""Write what `tomllib` reads: plain values, lists and tables, every float exactly."""

from __future__ import annotations

import json
import re
from typing import Any


def dumps(table: dict[str, Any], path: str = "") -> str:
    """A table as TOML text; None is left out, a non-empty list of tables becomes [[...]]."""
    lines, tables = [], []
    for key, value in table.items():
        name = key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _text(key)
        here = f"{path}.{name}" if path else name
        if isinstance(value, dict):
            tables.append(f"\n[{here}]\n{dumps(value, here)}")
        elif isinstance(value, list) and value and all(isinstance(entry, dict) for entry in value):
            tables += [f"\n[[{here}]]\n{dumps(entry, here)}" for entry in value]
        elif value is not None:
            lines.append(f"{name} = {_value(value)}\n")
    return "".join(lines + tables)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float | int):
        return repr(value)
    if isinstance(value, str):
        return _text(value)
    return f"[{', '.join(map(_value, value))}]"


def _text(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
