"""A number for every log: is what the account says right, useful, or wrong, and what is mute?

NUMBERS_SEEDS: logs of each kind (2); NUMBERS_FIRST: the first seed (1); NUMBERS_FAMILIES: of names,
strangers, reports, doors, small (all). Nobody of the kinds is told apart by hand: an effect counts
as right if its remedy is the truth's, and its number is off by less than 15 %, or its interval
holds the truth. An indicated one that is right is useful. A bound counts if the truth is below it.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

import undeadzone as uz
from benchmarks.identify.logs.doors import KINDS as DOORS
from benchmarks.identify.logs.doors import SMALL, Door
from benchmarks.identify.logs.names import TRUTHS, make
from benchmarks.identify.logs.public_reports import KINDS as REPORTS
from benchmarks.identify.logs.strangers import ALL, STEP
from benchmarks.markdown import head, row
from benchmarks.results import share
from undeadzone.util.arrays import Floats
from undeadzone.util.progress import terminal_progress
from undeadzone_identify.results.account import BOUNDED, INDICATED, MEASURED, NAMED, OPEN, Account
from undeadzone_identify.results.speech import EFFECT_OF

NULL = ("none", "operating_point")
CERTAIN = (NAMED, MEASURED)  # grades whose numbers are certain
NEAR, FAR = 0.15, 0.4  # of the truth, up to which a number is right, and useful
WORDS = ("right", "useful", "partly", "sentence", "mute", "wrong")
SAME = {  # effects that share a remedy, or that a log of one end cannot tell apart
    "loss": ("input loss", "output loss"),
    "input loss": ("loss",),
    "output loss": ("loss",),
    "input reversal": ("output reversal", "free play"),
    "output reversal": ("input reversal",),
    "output threshold": ("low end", "output loss"),
    "low end": ("output range",),
    "high end": ("output range",),
    "curve": ("input shape", "output shape"),
    "ways": ("input reversal", "output reversal"),
}


class Outcome(NamedTuple):
    """What the account of a log is worth.

    Attributes:
        family, kind: of the log.
        grade: of the account.
        word: of WORDS.
        held: whether intervals of certain numbers hold the truth.
        bounded: whether the bounds do.
        seconds: CPU.
        text: the headline.
    """

    family: str
    kind: str
    grade: str
    word: str
    held: list[bool]
    bounded: list[bool]
    seconds: float
    text: str


# --- Logs


def _of_words(columns: dict[str, Floats], right: tuple[str, ...], width: float | None) -> Door:
    """Return a log with the effects of the words that are right."""
    effects = tuple({EFFECT_OF[word] for word in right if word in EFFECT_OF})
    effects = effects or (() if set(right) & {*NULL} else ("of another kind",))
    number = {} if not width else {"width": width, "gap": width}
    return Door(columns, effects, number, width or 0.0)


def _columns(step: float, u: Floats, y: Floats) -> dict[str, Floats]:
    """Return the columns of a log of one input."""
    return {"t": step * np.arange(len(y)), "u": u, "y": y}


BY_HAND = {  # effects of strangers whose words have none
    "limit of the input": ("input shape",),
    "lag, zone, plant": ("input loss", "input shape"),
    "lag, soft limit, plant": ("input shape",),
    "least pulse": ("input threshold", "input loss"),
    "relay": ("input shape", "input threshold"),
    "relay with hysteresis": ("input shape", "input threshold", "input reversal"),
    "slow drive that saturates": ("input shape",),
    "rounded input": ("input shape", "input threshold"),
    "input without its sign": ("input shape",),
    "comparator": ("output shape", "output range", "output threshold"),
    "zone, sensor of changes": ("output loss",),
}


def logs(family: str, seed: int) -> Iterator[tuple[str, Door]]:
    """Yield the logs of a family with a seed.

    Args:
        family: of FAMILIES.
        seed: of the draws.
    """
    if family == "names":
        for truth, word in TRUTHS.items():
            one = make(40_000 + seed, truth)
            right, left = one.widths
            door = _of_words(_columns(one.step, one.u, one.y), (word,), right + left)
            if truth in ("sensor", "input"):
                door = door._replace(numbers={"right": right, "left": left})
            if truth == "friction":
                door = door._replace(numbers={"level": right})
            yield truth, door
        return
    if family == "strangers":
        for name, kind in ALL.items():
            strange = kind.make(np.random.default_rng(9000 + seed))
            if not strange.options and strange.u.ndim == 1:
                door = _of_words(_columns(STEP, strange.u, strange.y), kind.right, strange.width)
                yield name, door._replace(effects=BY_HAND.get(name, door.effects))
        return
    if family == "reports":
        for name, draw in REPORTS.items():
            report = draw(np.random.default_rng(9000 + seed))
            yield name, _of_words(report.columns, report.right, report.width)
        return
    for name, draw_door in {"doors": DOORS, "small": SMALL}[family].items():
        yield name, draw_door(np.random.default_rng(9000 + seed))


FAMILIES = ("names", "strangers", "reports", "doors", "small")


# --- Judgement


def _match(account: Account, truth: Door) -> tuple[str, list[bool]]:
    """Return whether numbers of a right effect are right, useful or wrong, and what they hold."""
    distances, held = [], []
    for effect, numbers in account.effects.items():
        if effect not in truth.effects and not {*SAME.get(effect, ())} & {*truth.effects}:
            continue
        for name, one in numbers.items():
            if name in truth.numbers:
                value = truth.numbers[name]
                inside = one.low <= value <= one.high
                held.append(bool(inside))
                distances.append(0.0 if inside else abs(one.value - value) / abs(value))
    far = max(distances, default=0.0)
    return ("right" if far < NEAR else "useful" if far < FAR else "wrong"), held


def judge(account: Account, truth: Door) -> tuple[str, list[bool], list[bool]]:
    """Return the word of an account, whether its intervals and its bounds hold the truth.

    Args:
        account: of the log.
        truth: of the log.
    """
    if account.grade == OPEN:
        return ("sentence" if account.doubts else "mute"), [], []
    if account.grade == BOUNDED or not account.effects:
        if not truth.effects:
            return "right", [], [True] if account.limits else []
        largest = max(account.limits.values(), default=0.0)
        if not truth.size:
            return ("wrong" if account.grade in CERTAIN else "partly"), [], []
        return ("partly" if largest >= truth.size else "wrong"), [], [largest >= truth.size]
    known = {same for effect in account.effects for same in (effect, *SAME.get(effect, ()))}
    if known & {*truth.effects}:
        word, held = _match(account, truth)
        sure = account.grade in CERTAIN
        return (word if sure or word != "right" else "useful"), held if sure else [], []
    if account.grade == INDICATED and ({*account.others} & {*truth.effects}):
        return "partly", [], []
    if account.grade == INDICATED and "of another kind" in truth.effects:
        return "partly", [], []
    return "wrong", [], []


def outcome_of(family: str, kind: str, truth: Door, path: Path) -> Outcome:
    """Return what `identify` says of a log's file without any option, judged.

    Args:
        family, kind: of the log.
        truth: the log.
        path: where the file goes.
    """
    pd.DataFrame(truth.columns).to_csv(path, index=False)
    began = time.process_time()
    try:
        account = uz.identify(str(path)).account
    except uz.UndeadzoneError as error:
        spent = time.process_time() - began
        return Outcome(family, kind, "refused", "mute", [], [], spent, str(error)[:100])
    spent = time.process_time() - began
    word, held, bounded = judge(account, truth)
    return Outcome(family, kind, account.grade, word, held, bounded, spent, account.headline())


def outcomes() -> list[Outcome]:
    """Return the outcomes of all logs of the families."""
    count, first = (int(os.environ.get(f"NUMBERS_{k}", n)) for k, n in (("SEEDS", 2), ("FIRST", 1)))
    families = os.environ.get("NUMBERS_FAMILIES", " ".join(FAMILIES)).split()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for family in families:
            every = [one for k in range(first, first + count) for one in logs(family, k)]
            with terminal_progress(family, len(every), "log") as advance:
                for kind, truth in every:
                    rows.append(outcome_of(family, kind, truth, Path(folder) / "log.csv"))
                    advance(1)
    return rows


# --- Tables


def _counts(name: str, rows: list[Outcome]) -> str:
    """Return the counts of a family as a row."""
    counts = [sum(one.word == word for one in rows) for word in WORDS]
    sure = [one for one in rows if one.grade in CERTAIN]
    wrong = [one.word == "wrong" for one in sure]
    held = [flag for one in rows for flag in one.held]
    bounded = [flag for one in rows for flag in one.bounded]
    spent = np.array([one.seconds for one in rows])
    times = f"{np.median(spent):.1f}, {np.quantile(spent, 0.95):.1f}, {spent.max():.1f}"
    shares = (share(wrong), share(held), share(bounded), times)
    return row(name, str(len(rows)), *map(str, counts), *shares)


def table() -> str:
    """Return the section of RESULTS.md."""
    every = outcomes()
    ends = ("wrong of named and measured", "intervals held", "bounds held")
    lines = head("logs", "n", *WORDS, *ends, "CPU s: median, 95 %, most")
    for family in dict.fromkeys(one.family for one in every):
        lines.append(_counts(family, [one for one in every if one.family == family]))
    lines.append(_counts("all", every))
    rows = head("family", "kind", "grade", "", "CPU s", "says")
    for one in every:
        if one.word not in ("right", "useful"):
            cells = (one.kind, one.grade, one.word, f"{one.seconds:.1f}", one.text[:140])
            rows.append(row(one.family, *cells))
    title = "Those that are neither right nor useful:"
    return "\n".join(["## Numbers", "", *lines, "", title, "", *rows, ""])
