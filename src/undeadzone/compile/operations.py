"""Names of types and instructions in the target languages, as `operations.toml` has them."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any, Final

LANGUAGES: Final[dict[str, dict[str, Any]]] = tomllib.loads(
    Path(__file__).with_suffix(".toml").read_text(encoding="utf-8")
)
"""Tables of each language by kind of operands: what it calls an instruction, or a type."""
