"""Files whose keys had another meaning in an earlier version.

Up to schema 2 `centre` of an observer was d_r - d_l. It is (d_r - d_l)/2 since, the middle of the
zone, as `plant.arm.gears.centre` always was.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from types import FrameType
from typing import Any, Final

from undeadzone.errors import EarlierMeaning, InputError

SCHEMA: Final = 3  # number of the meanings that keys have, the same as that of --json
BEFORE: Final = 2  # the one that is still understood
CLAIMS: Final = ("observer", "compare", "declared")  # tables that may claim a centre of the zone


def translated(data: dict[str, Any]) -> dict[str, Any]:
    """Return the tables of a scenario in the meanings of today.

    A warning names what an earlier version took for something else. A centre of 0 is the same in
    both.

    Args:
        data: the tables as TOML gives them.

    Raises:
        InputError: for the number of another schema.
    """
    schema = data.get("schema")
    if schema not in (None, BEFORE, SCHEMA):
        raise InputError(
            f"schema: expected {SCHEMA}, or {BEFORE} of old files; found {schema!r:.40}"
        )
    if schema == SCHEMA:
        return data
    own = {key: value for key, value in data.items() if key != "schema"}
    moved = [name for name in CLAIMS if claims_centre(own.get(name))]
    if not moved:
        return own
    keys = " and ".join(f"{name}.centre" for name in moved)
    if schema is None:
        _warn(
            f"{keys}: is taken for (d_r - d_l)/2, the middle of the zone; up to schema {BEFORE} it "
            f"was d_r - d_l. Write schema = {SCHEMA} above all tables if the middle is meant, "
            f"schema = {BEFORE} if the difference is"
        )
        return own
    _warn(
        f"schema: {keys} of schema {BEFORE} is d_r - d_l; the next version does not read it. Halve "
        f"the numbers, and write schema = {SCHEMA}"
    )
    return own | {name: own[name] | {"centre": _halved(own[name]["centre"])} for name in moved}


def translated_std(stds: Sequence[Any], schema: int | None, where: object) -> list[Any]:
    """Return the deviations that a file of results keeps, in the meanings of today.

    Args:
        stds: deviations by name, of each output; what is no table stays as it is.
        schema: of the file; None: it has no number, as files had none up to schema 2.
        where: the file, for the warning.
    """
    if schema is not None and schema >= SCHEMA:
        return list(stds)
    if any(map(_has_centre, stds)):
        _warn(
            f"{where}: std.centre of schema {BEFORE} is that of d_r - d_l, and is halved; the next "
            "version does not read it. Make the file anew"
        )
    return list(map(_of_centre, stds))


def _has_centre(std: Any) -> bool:
    """Whether deviations by name have one of a centre."""
    return isinstance(std, dict) and isinstance(std.get("centre"), float)


def _of_centre(std: Any) -> Any:
    """The deviations with that of the centre in place of that of d_r - d_l."""
    return std | {"centre": std["centre"] / 2} if _has_centre(std) else std


def claims_centre(table: Any) -> bool:
    """Whether a table of claims has a centre of the zone that is not 0; `contact` has gears'."""
    if not isinstance(table, dict) or table.get("method") == "contact":
        return False
    return _is_other_than_0(table.get("centre"))


def _is_other_than_0(value: Any) -> bool:
    """Whether a number, or one in nested lists, is not 0."""
    if isinstance(value, list):
        return any(map(_is_other_than_0, value))
    return isinstance(value, int | float) and value != 0


def _halved(value: Any) -> Any:
    """Half of a number, or of each in nested lists; all else is left to the check of types."""
    if isinstance(value, list):
        return [_halved(each) for each in value]
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return value / 2 if is_number else value


def _warn(words: str) -> None:
    """Warn at the line outside of this package that reads the scenario."""
    frame, level = sys._getframe(1), 2
    while frame.f_back is not None and _is_own(frame):
        frame, level = frame.f_back, level + 1
    warnings.warn(words, EarlierMeaning, stacklevel=level)


def _is_own(frame: FrameType) -> bool:
    """Whether a frame is of this package, or of one that comes with it."""
    return str(frame.f_globals.get("__name__")).startswith("undeadzone")
