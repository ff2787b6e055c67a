"""Constants of the direct looks at other values: how many answers change, and how many get worse?

Each number that a module of the looks sets by hand is multiplied by the factors, in its module and
wherever it is imported. One that changes nothing at half and double needs no source; one that
changes nothing at any factor belongs to a rule that these logs do not need.
"""

from __future__ import annotations

import importlib
import pkgutil
import re
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

import pandas as pd

from benchmarks.identify.logs.doors import Door
from benchmarks.identify.numbers import WORDS, judge, logs
from benchmarks.markdown import head, row
from undeadzone.util.progress import terminal_progress
from undeadzone_identify.logs.log import Log
from undeadzone_identify.logs.loops import read_log_or_loop
from undeadzone_identify.looks.first import look_at
from undeadzone_identify.results.account import OPEN, Account
from undeadzone_identify.results.seen import account_of_looks
from undeadzone_identify.selection.lost_motion import without_drive

LOOKS = "undeadzone_identify.looks"
FACTORS = (0.5, 2.0, 1e-3, 1e3)


def constants() -> Iterator[tuple[ModuleType, str]]:
    """Yield the numbers that modules of the looks set by hand."""
    for one in pkgutil.iter_modules(importlib.import_module(LOOKS).__path__):
        module = importlib.import_module(f"{LOOKS}.{one.name}")
        for name, value in list(vars(module).items()):
            if isinstance(value, int | float) and _sets(module, name):
                yield module, name


def _sets(module: ModuleType, name: str) -> bool:
    """Return whether a module sets a constant itself."""
    source = Path(str(module.__file__)).read_text(encoding="utf-8")
    return name.isupper() and re.search(rf"^(\w+, )*{name}\b.*= ", source, re.MULTILINE) is not None


@contextmanager
def scaled(module: ModuleType, name: str, factor: float) -> Iterator[None]:
    """Multiply a constant, in its module and where it is imported, until the end."""
    value = getattr(module, name)
    others = [one for key, one in sys.modules.items() if key.startswith("undeadzone_identify")]
    users = [one for one in others if vars(one).get(name) is value and not _sets(one, name)]
    other = type(value)(round(factor * value) if isinstance(value, int) else factor * value)
    try:
        for one in (module, *users):
            setattr(one, name, other)
        yield
    finally:
        for one in (module, *users):
            setattr(one, name, value)


def answer(log: Log, door: Door) -> tuple[str, str]:
    """Return what the looks say of a log, to two digits, and its word (the worst if they fail)."""
    try:
        account = account_of_looks(log, look_at(log)) or Account(OPEN, {}, "", ("", ""))
    except (ArithmeticError, LookupError, MemoryError, ValueError) as error:
        return str(error), WORDS[-1]
    numbers = [f"{one.value:.2g}" for ways in account.effects.values() for one in ways.values()]
    said = " ".join([account.grade, *account.effects, *numbers])
    return said, judge(account, door)[0]


def read_doors(families: tuple[str, ...], seeds: range) -> Iterator[tuple[Log, Door]]:
    """Yield the logs of the families as they are read from a file, with their truths."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        for family in families:
            for _, door in (one for seed in seeds for one in logs(family, seed)):
                pd.DataFrame(door.columns).to_csv(path, index=False)
                yield without_drive(read_log_or_loop(path, None, False)), door


def table(families: tuple[str, ...] = ("doors", "small"), seeds: int = 1, first: int = 1) -> str:
    """Return the section of RESULTS.md.

    Args:
        families: of the bench `numbers`.
        seeds, first: of each family.
    """
    every = [*read_doors(families, range(first, first + seeds))]
    before = [answer(*one) for one in every]
    rows = head("constant", "value", *(f"x {factor:g}" for factor in FACTORS))
    with terminal_progress("constants", len(found := list(constants())), "constant") as advance:
        for module, name in found:
            cells = []
            for factor in FACTORS:
                with scaled(module, name, factor):
                    pairs = [(old, answer(*one)) for old, one in zip(before, every, strict=True)]
                changed = sum(old != new for old, new in pairs)
                worse = sum(WORDS.index(old) < WORDS.index(new) for (_, old), (_, new) in pairs)
                cells.append(f"{changed}, {worse}")
            short = module.__name__.rpartition(".")[2]
            rows.append(row(f"{short}.{name}", f"{getattr(module, name):g}", *cells))
            advance(1)
    title = f"Of {len(every)} logs: answers that change, and those that get worse."
    return "\n".join(["## Constants", "", title, "", *rows, ""])
