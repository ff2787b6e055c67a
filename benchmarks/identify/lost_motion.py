"""Lost motion between two positions, and motors: is the name right, does the interval hold?

LOST_LOGS: of each kind (4), LOST_FIRST: the first seed (1000), LOST_KINDS: kinds, by commas.
"""

from __future__ import annotations

import os
import time
from typing import NamedTuple

import numpy as np
import pandas as pd

import undeadzone as uz
from benchmarks.identify.logs.lost_motion import KINDS, MotionLog
from benchmarks.markdown import head, row
from undeadzone_identify.models.lost_motion import MotionFit

SURE = 0.9  # odds above which no name may be wrong
NO_NAME = ("undecided", "unclear")
NORMAL = 1.96


class Outcome(NamedTuple):
    """Result of a log.

    Attributes:
        word: right, withheld or wrong.
        is_sure: whether the odds of the name are above `SURE`.
        covered: whether the interval of what is lost held it; None where none is given.
        half: half the interval over that of least squares with white residuals; nan likewise.
        gap_covered: the same of the gap alone, where a current tells it apart.
        seconds: CPU.
    """

    word: str
    is_sure: bool
    covered: bool | None
    half: float
    gap_covered: bool | None
    seconds: float


def ask(log: MotionLog) -> Outcome:
    """Ask `identify` of a log, with no option."""
    began = time.process_time()
    frame = pd.DataFrame(log.columns)
    named = None if "q [rad]" not in log.columns else "y=q,u=torque"
    found = uz.identify(frame, columns=named, integrators=0 if named is None else 1)
    seconds = time.process_time() - began
    word = "right" if found.verdict in log.right else "wrong"
    word = "withheld" if found.verdict in NO_NAME else word
    odds = found.numbers().get("odds", {})
    is_sure = max(odds.values(), default=0.0) > SURE
    if log.lost is None or word == "withheld" or not isinstance(found, uz.IdentifiedMotion):
        return Outcome(word, is_sure, None, np.nan, None, seconds)
    answer, parts = found.answer, found.answer.parts
    fit = MotionFit(answer.data, answer.found.structure)
    white = NORMAL * answer.found.rms / np.linalg.norm(fit.gap_slope(answer.found))
    half, covered = (
        answer.gap.half_width / max(white, 1e-300),
        answer.gap.low <= log.lost <= answer.gap.high,
    )
    of_gap = None
    if log.gap is not None and parts is not None:
        of_gap = parts.gap.low <= log.gap <= parts.gap.high
    return Outcome(word, is_sure, bool(covered), float(half), of_gap, seconds)


def table() -> str:
    """Return the section of RESULTS.md."""
    count, begin = int(os.environ.get("LOST_LOGS", "4")), int(os.environ.get("LOST_FIRST", "1000"))
    requested = os.environ.get("LOST_KINDS", ",".join(name.replace(",", ";") for name in KINDS))
    kinds = {name: KINDS[name] for name in (one.replace(";", ",") for one in requested.split(","))}
    lines = ["## Lost motion", ""]
    lines += head("log", "right", "withheld", "wrong (> .9)", "lost motion held",
                  "half over least squares", "gap held", "CPU s")  # fmt: skip
    for k, (name, make) in enumerate(kinds.items()):
        every = [ask(make(np.random.default_rng([k, begin + seed]))) for seed in range(count)]
        words = [one.word for one in every]
        wrong = [one for one in every if one.word == "wrong"]
        covered = [one.covered for one in every if one.covered is not None]
        gaps = [one.gap_covered for one in every if one.gap_covered is not None]
        halves = [one.half for one in every if np.isfinite(one.half) and one.half < 1e6]
        lines.append(
            row(
                name,
                str(words.count("right")),
                str(words.count("withheld")),
                f"{len(wrong)} ({sum(one.is_sure for one in wrong)})",
                f"{sum(covered)} of {len(covered)}" if covered else "-",
                f"{np.median(halves):.2f}" if halves else "-",
                f"{sum(gaps)} of {len(gaps)}" if gaps else "-",
                f"{np.median([one.seconds for one in every]):.1f}",
            )
        )
    return "\n".join(lines)
