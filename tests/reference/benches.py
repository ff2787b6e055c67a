"""Families of drawn logs: `identify` beside the truth, judged as the benchmarks judge it.

Logs of the same seeds are in no table of `benchmarks/RESULTS.md`.
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pandas as pd
from benchmarks.identify import (
    labelled_records,
    lost_motion,
    motors,
    names,
    valves,
)
from benchmarks.identify.logs.lost_motion import KINDS as MOTIONS
from benchmarks.identify.logs.motors import random_motor, record
from benchmarks.identify.logs.names import ROUNDED, TRUTHS
from benchmarks.identify.logs.names import make as make_named
from benchmarks.identify.logs.public_reports import KINDS as REPORTS
from benchmarks.identify.logs.public_reports import judge_report
from benchmarks.identify.logs.strangers import ALL, STEP
from benchmarks.identify.logs.valves import make as make_loop

import undeadzone as uz

from .fields import Answer, Fields, flatten

SEED = 17600  # of all logs
NAMES = (
    *(f"{truth} {SEED}" for truth in TRUTHS),
    *(f"{truth} {ROUNDED + SEED}" for truth in TRUTHS),
)
STRANGERS = (
    "fan", "play ahead, 12", "valve that sticks and slips", "pulses about 1500", "zone, lag of 3",
    "soft sensor", "joint, friction .3", "motor of 50", "tank", "zone of one side", "noise gate",
    "lost rows", "no dynamics, play", "zone, coloured noise", "drag by the square", "thermostat",
    "zone", "line", "heater", "zone beside a line",
)  # fmt: skip
MOTORS = (*(f"rigid {SEED + k}" for k in range(4)), *(f"gap {SEED + k}" for k in range(8)))
BOTH_ENCODERS = tuple(f"{one}, both encoders" for one in MOTORS[2:6])
VALVES = tuple(str(SEED + k) for k in range(10))
LOST_MOTION = tuple(MOTIONS)
OF_REPORTS = tuple(name for name in REPORTS if name not in MOTIONS)


@contextlib.contextmanager
def noted_answers() -> Iterator[list[Fields]]:
    """Provide the fields of each answer of `identify` in a block, which benchmarks sum up."""
    noted: list[Fields] = []
    identify = uz.identify

    def note(*log: Any, **options: Any) -> Any:
        found = identify(*log, **options)
        noted.append(flatten(found.numbers()))
        return found

    with mock.patch.object(uz, "identify", note):
        yield noted


def judged(
    noted: list[Fields],
    word: str,
    verdicts: Iterable[str],
    holds: bool | None,
    sizes: Mapping[str, float | None],
) -> Answer:
    """Return an answer with the benchmark's judgement.

    Args:
        noted: fields of what `identify` found; none where it refused the log.
        word: right, withheld or wrong.
        verdicts: that are right.
        holds: whether the interval of what is measured holds the truth; None: none is given.
        sizes: that are known, by their keys; None: one is not.
    """
    words = sorted(verdicts)
    known = {key: value for key, value in sizes.items() if value is not None}
    fields = noted[0] if noted else {"verdict": "refused"}
    odds = {f"odds.{words[0]}": 1.0} if len(words) == 1 else {}
    rounded = {key: float(f"{one:.6g}") for key, one in known.items()}
    judgement = {"word": word} if holds is None else {"word": word, "holds": holds}
    return Answer(fields | judgement, {"verdict": words or ["a withheld one"]} | odds | rounded)


def word_of(is_right: bool, is_wrong: bool) -> str:
    """Return right, withheld or wrong."""
    if is_right:
        return "right"
    return "wrong" if is_wrong else "withheld"


def judge_word(verdict: str, right: Iterable[str]) -> str:
    """Return right, withheld or wrong, by the words of the benchmarks that withhold."""
    is_right = verdict in right
    return word_of(is_right, not is_right and verdict not in labelled_records.NO_NAME)


def ask_named(name: str) -> Answer:
    """Return the answer to a log of ten truths.

    Args:
        name: truth and seed.
    """
    truth, _, seed = name.rpartition(" ")
    log = make_named(int(seed), truth)
    with noted_answers() as noted:
        one = names.outcome_of(log)
    numbers = {"right": log.widths[0], "left": log.widths[1], "width": sum(log.widths)}
    known = {key: numbers[key] for key in names.MEASURED.get(truth, ())}
    covered = names.covers([one])
    word = word_of(names.is_right(one), names.is_wrong(one))
    return judged(noted, word, [names.right_word(one)], all(covered) if covered else None, known)


def ask_strange(kind: str) -> Answer:
    """Return the answer to a stranger's log.

    Args:
        kind: of `strangers_logs`.
    """
    log, right = ALL[kind].make(np.random.default_rng(SEED)), ALL[kind].right
    with noted_answers() as noted:
        one = labelled_records.ask(kind, right, log.width, t=STEP, u=log.u, y=log.y, **log.options)
    word = word_of(one.is_right, one.is_wrong)
    return with_false_odds(judged(noted, word, right, one.holds, {"width": log.width}), one)


def with_false_odds(answer: Answer, one: labelled_records.Outcome) -> Answer:
    """Return an answer with the odds of a false word, of which none is best.

    Args:
        answer: to a log.
        one: what `labelled_records` makes of it.
    """
    odds = float(f"{one.false_odds:.3g}")
    return Answer(answer.fields | {"false_odds": odds}, answer.truth | {"false_odds": 0.0})


def ask_motor(name: str) -> Answer:
    """Return the answer to a motor's log.

    Args:
        name: rigid or gap, the seed, and whether both encoders are given.
    """
    drawn, _, encoders = name.partition(", ")
    kind, seed = drawn.split()
    motor = random_motor(int(seed), kind == "gap")
    with noted_answers() as noted:
        if encoders:
            found = motors.by_both_encoders(motor, int(seed))
        else:
            found = motors.identified(*record(motor, int(seed)))
    right = motors.right_word(motor, not encoders)
    sizes = {"width": motor.gap or None}
    return judged(noted, judge_word(found.word, [right]), [right], None, sizes)


def ask_valve(seed: str) -> Answer:
    """Return the answer to a control loop.

    Args:
        seed: of the loop.
    """
    loop = make_loop(int(seed))
    with noted_answers() as noted:
        found = uz.identify(pd.DataFrame({"OP": loop.op, "PV": loop.pv, "SP": loop.sp}))
    right = valves.WORDS[loop.cause]
    sizes = {"width": loop.stick or None, "loop.J": loop.jump or None}
    return judged(noted, judge_word(found.verdict, right), right, None, sizes)


def ask_motion(kind: str) -> Answer:
    """Return the answer to a log of two positions, or of a motor.

    Args:
        kind: of `lost_motion_logs`.
    """
    log = MOTIONS[kind](np.random.default_rng([list(MOTIONS).index(kind), SEED]))
    with noted_answers() as noted:
        one = lost_motion.ask(log)
    sizes = {"lost_motion.gap": log.lost, "lost_motion.parts.gap": log.gap}
    return judged(noted, one.word, log.right, one.covered, sizes)


def ask_report(kind: str) -> Answer:
    """Return the answer to the file of a public report.

    Args:
        kind: of `reports_logs`.
    """
    report = REPORTS[kind](np.random.default_rng([list(REPORTS).index(kind), 25, SEED]))
    with tempfile.TemporaryDirectory() as folder, noted_answers() as noted:
        word, holds = judge_report(report, Path(folder) / "report.csv")
    return judged(noted, word, report.right, holds, {"width": report.width})
