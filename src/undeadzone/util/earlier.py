"""Translation of files whose keys had a different meaning in an earlier version.

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

# Number of the meanings that keys have, in files and in --json alike: raised when a key goes or
# changes its meaning; keys may be added.
SCHEMA: Final = 3
BEFORE: Final = 2  # the one that is still understood
ASSUMPTION_TABLES: Final = (
    "observer",
    "compare",
    "declared",
)  # tables that may contain a centre of the zone


def translate_scenario(data: dict[str, Any]) -> dict[str, Any]:
    """Return the tables of a scenario with keys of the current schema.

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
            f"schema: expected {SCHEMA}, or {BEFORE} of old files, found {schema!r:.40}"
        )
    if schema == SCHEMA:
        return data
    own = {key: value for key, value in data.items() if key != "schema"}
    moved = [name for name in ASSUMPTION_TABLES if assumes_centre(own.get(name))]
    if not moved:
        return own
    keys = " and ".join(f"{name}.centre" for name in moved)
    if schema is None:
        _warn_at_caller(
            f"{keys}: is taken for (d_r - d_l)/2, the middle of the zone; up to schema {BEFORE} it "
            f"was d_r - d_l. Write schema = {SCHEMA} above all tables if the middle is meant, "
            f"schema = {BEFORE} if the difference is"
        )
        return own
    _warn_at_caller(
        f"schema: {keys} of schema {BEFORE} is d_r - d_l; the next version does not read it. Halve "
        f"the numbers, and write schema = {SCHEMA}"
    )
    return own | {
        name: own[name] | {"centre": _halve_numbers(own[name]["centre"])} for name in moved
    }


def translate_stds(stds: Sequence[Any], schema: int | None, where: object) -> list[Any]:
    """Return the standard deviations of a results file, translated to the current schema.

    Args:
        stds: deviations by name, of each output (other values stay unchanged).
        schema: of the file (None: it has no number, as files had none up to schema 2).
        where: the file, for the warning.
    """
    if schema is not None and schema >= SCHEMA:
        return list(stds)
    if any(map(_has_centre_std, stds)):
        _warn_at_caller(
            f"{where}: std.centre of schema {BEFORE} is that of d_r - d_l, and is halved. The next "
            "version does not read it. Make the file anew"
        )
    return list(map(_halve_centre_std, stds))


def _has_centre_std(std: Any) -> bool:
    """Return whether a table of standard deviations contains a centre."""
    return isinstance(std, dict) and isinstance(std.get("centre"), float)


def _halve_centre_std(std: Any) -> Any:
    """Return the deviations with the centre's halved: d_r - d_l becomes the middle of the
    zone.
    """
    return std | {"centre": std["centre"] / 2} if _has_centre_std(std) else std


def assumes_centre(table: Any) -> bool:
    """Return whether a table assumes a centre of the zone other than 0.

    `contact` has the gears' centre.
    """
    if not isinstance(table, dict) or table.get("method") == "contact":
        return False
    return _has_nonzero(table.get("centre"))


def _has_nonzero(value: Any) -> bool:
    """Return whether a number, or an entry of nested lists, differs from 0."""
    if isinstance(value, list):
        return any(map(_has_nonzero, value))
    return isinstance(value, int | float) and value != 0


def _halve_numbers(value: Any) -> Any:
    """Return half of a number, or of each entry in nested lists. Values of other types stay."""
    if isinstance(value, list):
        return list(map(_halve_numbers, value))
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return value / 2 if is_number else value


def _warn_at_caller(words: str) -> None:
    """Warn at the line outside of this package that reads the scenario."""
    frame = sys._getframe(1)
    level = 2
    while frame.f_back is not None and _is_own_frame(frame):
        frame = frame.f_back
        level = level + 1
    warnings.warn(words, EarlierMeaning, stacklevel=level)


def _is_own_frame(frame: FrameType) -> bool:
    """Return whether a frame belongs to this package, or to a package that comes with it."""
    return str(frame.f_globals.get("__name__")).startswith("undeadzone")
