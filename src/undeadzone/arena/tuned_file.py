"""The numbers that tuning found, and how, as a TOML file."""

from __future__ import annotations

from pathlib import Path

import msgspec

from undeadzone.errors import FileError
from undeadzone.support import toml
from undeadzone.support.files import reason, write_text


class Found(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Of one method. regret: mean over the tuning scenarios; before: with every knob in the middle of its range; knobs: in the units of `situation.UNITS`."""

    regret: float
    before: float
    candidates: int
    knobs: dict[str, float]


class Tuned(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """budget: candidates of each method; seeds: of the runs; search: of the evolution; scenarios: tuned on."""

    budget: int
    seeds: list[int]
    search: int
    scenarios: list[str]
    methods: dict[str, Found]


def save(found: Tuned, path: Path) -> Path:
    """Write the numbers; of methods that were not tuned now, those already in the file stay. Raises FileError."""
    kept = load(path).methods if path.is_file() else {}
    methods = dict(sorted((kept | found.methods).items()))
    head = "# Written by undeadzone arena --tune. Knobs are counted in the units that undeadzone/arena/methods.py names.\n"
    return write_text(head + toml.dumps(msgspec.structs.replace(found, methods=methods)), path)


def load(path: Path) -> Tuned:
    """What `save` wrote. Raises FileError."""
    try:
        return msgspec.toml.decode(path.read_bytes(), type=Tuned)
    except OSError as error:
        raise FileError(f"{path}: cannot read: {reason(error)}") from None
    except msgspec.DecodeError as error:
        raise FileError(f"{path}: not written by undeadzone arena --tune ({error})") from None
