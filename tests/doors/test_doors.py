"""A hundred files, each answer followed to the letter: commands, options, lines, and a number."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import pytest
from benchmarks.end_to_end.cases import load_snippet
from benchmarks.identify.logs.doors import KINDS, SMALL, Door
from benchmarks.identify.logs.names import TRUTHS
from benchmarks.identify.logs.public_reports import KINDS as REPORTS
from benchmarks.identify.logs.strangers import dragged, zone
from benchmarks.identify.numbers import logs

from further import further
from requirements import needs
from undeadzone.util.arrays import Floats
from walks import Walk, commands_in

pytestmark = needs("compiler", "gcc", "make")
Correct = Callable[[float], float]
ADVICE = re.compile(r"(?:use|[Tt]ry|[Gg]ive|by|about; |;) (--(?!columns)[a-z]+ -?[\w.]+)")
OPTION = re.compile(r'(--columns "[^"]+"|--(?:delay|integrators|zero|place|kind) -?[\w.]+)')
NUMBER = re.compile(r"(upper|lower|right|left|gap) (-?[\d.e+-]+)")
PAYS = re.compile(r"rms error (\S+) -> (\S*\d)")
DRAWN = {  # the kinds and seeds that every run of the tests follows
    ("converter", 2),
    ("wheel, one sweep", 1),
    ("load flips", 1),
    ("play without dynamics", 2),
    ("focuser's table", 1),
    ("plain table", 1),
    ("joint's torque", 3),
    ("dial gauge", 1),
    ("encoder flickers", 2),
    ("nothing hidden", 1),
}


class Work(NamedTuple):
    """Second record of the machine of a file.

    Attributes:
        signal: the true output, or the wanted command (N).
        machine: what is read of it, or what a command does.
        at_output: whether a correction acts on the readings.
        has_flanks: whether a gap has two flanks, of which either may be 0.
    """

    signal: Floats
    machine: Callable[[Floats], Floats]
    at_output: bool
    has_flanks: bool = False

    def error(self, correct: Correct = float) -> float:
        """The rms error with a correction."""
        x = self.machine(self.signal) if self.at_output else self.signal
        out = np.array([correct(float(one)) for one in x])
        error = (out if self.at_output else self.machine(out))[50:] - self.signal[50:]
        return float(error.std() if self.has_flanks else np.sqrt(np.mean(error**2)))


def work_of(door: Door) -> Work | None:
    """The second record of a file, if its truth is one band or one gap."""
    known, (effect, *_) = door.numbers, door.effects or ("",)
    slow = np.sin(0.013 * np.arange(1500)) + 0.5 * np.sin(0.041 * np.arange(1500))
    if gap := known.get("gap") if "reversal" in effect else None:
        return Work(6 * gap * slow, lambda x: dragged(x, gap), False, True)
    if "loss" not in effect or not known.keys() & {"right", "upper"}:
        return None
    high = known.get("upper", known.get("right", 0.0))
    low = known.get("lower", -known.get("left", 0.0))
    middle, half = (high + low) / 2, (high - low) / 2
    wanted = 6 * half * (slow if {"lower", "left"} & known.keys() else abs(slow))

    def machine(x: Floats) -> Floats:
        return zone(x - middle, high - middle, middle - low) + middle

    return Work(middle + wanted, machine, effect == "output loss")


def correct_by_words(answer: str) -> Correct | None:
    """What the printed remedy does with the printed numbers; None if it corrects nothing."""
    known = {name: float(value) for name, value in NUMBER.findall(answer.partition("\n")[0])}
    high, low = known.get("upper", known.get("right")), known.get("lower", -known.get("left", 0.0))
    if high is None or "from the edge on its side" not in answer:
        return None
    rest = (high + low) / 2 if "upper" in known else 0.0
    return lambda u: u - rest + (high if u > rest else low) if u != rest else u


def follow(door: Door, folder: Path) -> tuple[float, float]:
    """The errors on a second record without and with what the answer prints.

    Every printed command and option runs, and advice changes the answer.
    """
    pd.DataFrame(door.columns).to_csv(folder / "log.csv", index=False)
    walk = Walk(folder)
    said = walk.run("undeadzone identify log.csv --out answer --no-figures")
    for line in commands_in(said):
        walk.run(line, highest=int(line.split()[1] in ("run", "estimate")))  # 1: a negative answer
    plain = said
    for line in commands_in(said):
        plain = plain.replace(line, "")
    found = re.findall(r"^found +(.*(?:\n.*)*)", said, re.M)
    for option in dict.fromkeys(OPTION.findall(plain)):
        again = walk.run(f"undeadzone identify log.csv --no-figures --out again --force {option}")
        if option in ADVICE.findall(plain):
            assert re.findall(r"^found +(.*)", again, re.M) != found[0].splitlines()[:1], option
    work, few = work_of(door), folder / "snippet"
    correct: Correct | None = load_snippet(few) if few.is_dir() else correct_by_words(found[0])
    for without, remaining in PAYS.findall(said):
        assert float(remaining) < float(without)
    if work is None or correct is None:
        return 0.0, 0.0
    return work.error(), work.error(correct)


def list_files() -> list[tuple[str, str, int]]:
    """Family, kind and seed of a hundred files."""
    families = {"doors": KINDS, "small": SMALL, "reports": REPORTS, "names": TRUTHS}
    counts = {"doors": 3, "small": 4, "reports": 1, "names": 1}
    return [
        (family, kind, seed)
        for family, kinds in families.items()
        for seed in range(1, counts[family] + 1)
        for kind in kinds
    ]


FILES = list_files()


@pytest.mark.parametrize(
    ("family", "kind", "seed"),
    [
        *(one for one in FILES if one[1:] in DRAWN),
        *further(*(one for one in FILES if one[1:] not in DRAWN)),
    ],
)
def test_an_answer_that_is_followed_makes_nothing_worse(
    family: str, kind: str, seed: int, tmp_path: Path
) -> None:
    without, corrected = follow(dict(logs(family, seed))[kind], tmp_path)
    assert corrected <= without


def test_there_are_a_hundred_files() -> None:
    assert len(FILES) >= 95
    assert sum(one[1:] in DRAWN for one in FILES) == len(DRAWN)
