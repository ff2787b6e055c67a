"""Servos whose encoder is behind gear play: their gap from a log, against the gap that was there.

SERVO_LOGS: how many logs the predictor gets (60), SERVO_FIRST: the first seed, SERVO_WHOLE: how
many of them go through `identify` with no option, too (6).
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

import undeadzone as uz
from benchmarks.identify.logs.mujoco_servo import mujoco_log
from benchmarks.identify.logs.servo import Recorded, random_log, resting_log
from benchmarks.markdown import head, row
from benchmarks.results import commit
from undeadzone.scenario.reader import parse
from undeadzone_identify.servo.gap import REVERSALS, ServoGap, identify_servo_gap
from undeadzone_identify.servo.observations import build_observations
from undeadzone_studies.statistics.intervals import proportion

FRESH = 5000  # first seed: those below were used while the method was made
PER_LOG = 4000  # samples, to which CPU times are scaled
FAR = 0.25  # of the gap


class Outcome(NamedTuple):
    """What became of a log.

    Attributes:
        family: of its readings.
        closed: whether a loop was closed.
        ticks: gap in quanta, or in rms of the noise.
        error: of the gap over the gap; nan where none was given.
        covered: whether its interval held it.
        half: half the interval over the gap.
        few: whether the readings turned too seldom for any answer.
        reason: why none was given.
        loop_detected: whether a loop was said to be closed.
        seconds: of CPU, for `PER_LOG` samples.
    """

    family: str
    closed: bool
    ticks: float
    error: float
    covered: bool
    half: float
    few: bool
    reason: str
    loop_detected: bool
    seconds: float

    @property
    def is_given(self) -> bool:
        """Whether there was a gap."""
        return math.isfinite(self.error)


def outcome_of(log: Recorded) -> Outcome:
    """What the predictor says of a log."""
    begun = time.process_time()
    whole, first = np.ones(log.y.size, bool), np.zeros(1, int)
    found = identify_servo_gap(build_observations(log.u, log.y, whole, first, log.step))
    spent = (time.process_time() - begun) * PER_LOG / log.y.size
    ticks = log.servo.gap / (log.servo.quantum or log.noise)
    family = "noise" if log.noise else _family(ticks)
    given = found is not None and found.is_gap_reported
    error, half, covered = math.nan, math.nan, False
    if found is not None and given:
        error = found.gap.value / log.servo.gap - 1
        half, covered = (
            found.gap.half_width / log.servo.gap,
            found.gap.low <= log.servo.gap <= found.gap.high,
        )
    return Outcome(
        family=family,
        closed=log.closed,
        ticks=ticks,
        error=error,
        covered=covered,
        half=half,
        few=found is None or found.reversals < REVERSALS,
        reason="" if given else _reason(found),
        loop_detected=found is not None and found.log.is_closed_loop,
        seconds=spent,
    )


def _family(ticks: float) -> str:
    """Ticks by how many the gap has."""
    if ticks > 10:
        return "ticks, gap > 10"
    return "ticks, 2 to 10" if ticks > 2 else "ticks, < 2"


def _reason(found: ServoGap | None) -> str:
    """Why there is no gap, in a word."""
    if found is None:
        return "nothing fits"
    words = {"turn": "few reversals", "below": "gap of 0 not excluded", "crossings": "crossings"}
    words |= {"simulated": "simulated logs", "": "errors"}
    return next(name for word, name in words.items() if word in found.reasons[0])


def _line(name: str, every: Sequence[Outcome], among: Callable[[Outcome], bool]) -> str:
    """A row of the table."""
    own = [one for one in every if among(one)]
    given = [one for one in own if one.is_given]
    if not given:
        return row(name, str(len(own)), "0", *["-"] * 6)
    errors = 100 * np.abs([one.error for one in given])
    cover = proportion(sum(one.covered for one in given), len(given))
    return row(
        name,
        str(len(own)),
        f"{len(given)} ({len(given) / len(own):.2f})",
        f"{np.median(errors):.2f} %",
        f"{np.quantile(errors, 0.9):.1f} %",
        f"{errors.max():.1f} %",
        f"{cover.value:.2f} [{cover.low:.2f}, {cover.high:.2f}]",
        f"{100 * np.median([one.half for one in given]):.1f} %",
        f"{np.median([one.seconds for one in own]):.1f}",
    )


def predictor(count: int, first: int) -> list[str]:
    """The table of the predictor alone."""
    every = [outcome_of(random_log(first + seed)) for seed in range(count)]
    pushed = [outcome_of(mujoco_log(first + seed)) for seed in range(count // 4)]
    names = ("readings", "logs", "answered", "error: median", "90 %", "worst", "held")
    lines = head(*names, "half / gap", "CPU s")
    lines.append(_line("all", every, lambda one: True))
    for family in ("ticks, gap > 10", "ticks, 2 to 10", "ticks, < 2", "noise"):
        lines.append(_line(family, every, lambda one, family=family: one.family == family))
    lines.append(_line("open loop", every, lambda one: not one.closed))
    lines.append(_line("closed loop", every, lambda one: one.closed))
    lines.append(_line("MuJoCo, with a load", pushed, lambda one: True))
    withheld = [one.reason for one in every if not one.is_given]
    counts = ", ".join(f"{name} {withheld.count(name)}" for name in sorted(set(withheld)))
    given = [one for one in (*every, *pushed) if one.is_given]
    far = sum(abs(one.error) > FAR for one in given)
    denied = sum(one.ticks > 4 and one.reason.startswith("gap of 0") for one in every)
    loops = [one.loop_detected for one in every if one.closed]
    alarms = [one.loop_detected for one in every if not one.closed]
    few = sum(one.few for one in every)
    lines += [
        "",
        f"Withheld: {counts or 'none'}; {few} logs turn less than {REVERSALS} times. Off by more"
        f" than {100 * FAR:.0f} %: {far}. Denied above four ticks: {denied}. A closed loop was"
        f" heard in {sum(loops)} of {len(loops)}, and in {sum(alarms)} of {len(alarms)} without.",
    ]
    return lines


def whole(count: int, first: int) -> list[str]:
    """The table of `identify` with no option; every other log rests at setpoints in a loop."""
    lines = head("seed", "readings", "truth", "verdict", "gap", "scenario", "CPU s")
    for seed in range(first, first + count):
        log = resting_log(seed) if seed % 2 else random_log(seed, PER_LOG)
        begun = time.process_time()
        found: Any = uz.identify(t=log.step, u=log.u, y=log.y)
        spent = time.process_time() - begun
        width = found.width
        gap = "-" if width is None else f"{width.value:.4g} [{width.low:.4g}, {width.high:.4g}]"
        family = "noise" if log.noise else _family(log.servo.gap / log.servo.quantum)
        family += ", setpoints" if seed % 2 else ""
        cells = (family, f"{log.servo.gap:.4g}", found.verdict, gap, _scenario(found))
        lines.append(row(str(seed), *cells, f"{spent:.1f}"))
    return lines


def _scenario(found: Any) -> str:
    """Whether the answer goes on."""
    try:
        parse(found.scenario())
    except uz.InputError:
        return "none"
    return "yes"


def table() -> str:
    """Both tables."""
    count = int(os.environ.get("SERVO_LOGS", "60"))
    first = int(os.environ.get("SERVO_FIRST", str(FRESH)))
    lines = [
        "## A servo behind gear play",
        "",
        f"{count} logs at commit {commit()}, seeds from {first}: motors of a damping of 2 to 30 1/s"
        " with friction (60 %, to .2 of the input's rms), a spring (25 %), an electrical pole"
        " (20 %), 100 Hz to 1 kHz, 1,000 to 12,000 samples, inputs 0 to 3 samples late, torques to"
        " .1, a loop in 40 %; gaps of .001 to .1 of the travel, encoders of .5 to 50 ticks a gap,"
        " in 22 % noise instead. In MuJoCo, a quarter as many, the gear pushes a light link whose"
        " friction is .002 to .15 of the input. Nothing is told. Half: half the 95 % interval; CPU:"
        " for 4,000 samples.",
        "",
        *predictor(count, first),
        "",
        "`uz.identify` with no option, odd seeds on loops that rest at three setpoints:",
        "",
        *whole(int(os.environ.get("SERVO_WHOLE", "6")), first),
        "",
    ]
    return "\n".join(lines)
