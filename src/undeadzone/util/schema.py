"""Number of the meanings that keys have, in files and in --json alike (docs/versions.md)."""

from __future__ import annotations

from typing import Final

from undeadzone.errors import FileError

SCHEMA: Final = 3  # raised when a key goes or changes its meaning; keys may be added


def require_schema(schema: int | None, path: object) -> None:
    """Raise FileError for a saved result of another schema.

    Args:
        schema: of the file (None: it has no number, as files had none up to schema 2).
        path: of the file.
    """
    if schema != SCHEMA:
        raise FileError(
            f"{path}: expected schema = {SCHEMA}, found {schema}: another version of undeadzone "
            "saved it. Make it anew"
        )
