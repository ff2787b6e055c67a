"""TOML file of the tuned numbers and the settings of the tuning."""

from __future__ import annotations

from pathlib import Path

import msgspec

from undeadzone.util import toml
from undeadzone.util.files import convert_read_errors, read_bytes, write_text
from undeadzone.util.own_files import is_own_file, mark_toml

HEAD = (
    "# Written by undeadzone arena --tune. Knobs are counted in the units that "
    "undeadzone_arena/contest/methods.toml names.\n"
)


class TunedMethod(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Tuned numbers of one method.

    Attributes:
        regret: mean over the tuning scenarios.
        before: the same with every knob in the middle of its range.
        candidates: how many were tried.
        knobs: the numbers found, in the units of `prior_knowledge.UNITS`.
    """

    regret: float
    before: float
    candidates: int
    knobs: dict[str, float]


class Tuned(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Tuned numbers of all methods, and the settings of the tuning.

    Attributes:
        budget: candidates of each method.
        seeds: of the runs.
        search: seed of the evolution.
        scenarios: names of those tuned on.
        methods: tuned numbers, by method.
    """

    budget: int
    seeds: list[int]
    search: int
    scenarios: list[str]
    methods: dict[str, TunedMethod]


def save_tuned(tuned: Tuned, path: Path) -> Path:
    """Write the tuned numbers. Raises FileError.

    Of methods that were not tuned now, those already in the file stay, unless someone edited it.
    """
    stored_methods = load_tuned(path).methods if is_own_file(path) else {}
    methods = dict(sorted((stored_methods | tuned.methods).items()))
    text = HEAD + toml.to_toml(msgspec.structs.replace(tuned, methods=methods))
    return write_text(mark_toml(text), path)


def load_tuned(path: Path) -> Tuned:
    """Read a file that `save_tuned` wrote. Raises FileError."""
    with convert_read_errors(path, "not written by undeadzone arena --tune"):
        return msgspec.toml.decode(read_bytes(path), type=Tuned)
