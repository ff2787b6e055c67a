"""Consistency of a record with an observer's assumptions: innovations, own tests, censored samples.

The means of normalised innovations over some periods of the plant are too large where something
lasts that the observer does not know of, such as a wrong model, another step, swapped columns. A
sensor that is silent while z^ lies far outside the estimated zone contradicts that zone.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Final, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.compile import interpret
from undeadzone.interfaces import (
    MOST_SQUARE,
    Estimate,
    describe_rejected_assumptions,
    list_rejected_assumptions,
)
from undeadzone.observers.filtering.consistency import FAR, Sums, accumulate_innovations
from undeadzone.observers.filtering.prior import CHANCE, HISTORY, SPAN
from undeadzone.util.arrays import Floats

MOST_REFUSED: Final = (
    0.05  # share of readings, or censored samples, that may contradict the assumptions
)
FEWEST: Final = 30  # readings that a test needs
FALSE_ALARMS: Final = 30 * 86400.0  # time between two false alarms [s]
PEAK: Final = (
    5.0  # mean excess of a peak over a high level [quarter periods] (`python -m benchmarks alarm`)
)
APART: Final = 40.0  # time between two peaks, extrapolated to a level of 0, likewise
ROUNDING: Final = 1e-6  # of the size of z, by which z^ may be off without any noise


class Verdict(NamedTuple):
    """Result of the test whether a record is consistent with the observer's assumptions.

    Attributes:
        consistent: the result (None without a result: the observer gives no innovation_std, or too
            few readings corrected it).
        B: mean square of the sums of innovations at the end, the largest of the outputs (usually
            1).
        square: mean square of the normalised innovations that were not rejected (usually 1).
        used: how many readings corrected the estimate.
        glitches: how many readings were taken for wrong, or lie beyond 4.5 standard deviations.
        silent_outside: how many readings are silent although z^ lies far outside the estimated
            zone.
        reasons: descriptions of the inconsistency, or of the missing result (empty if it is
            consistent).
        claims: names of the assumptions that a filter rejects, the most probable first.
    """

    consistent: bool | None
    B: float | None
    square: float | None
    used: int
    glitches: int
    silent_outside: int
    reasons: list[str]
    claims: list[str]


class Alarm:
    """Alarm by a flag that may be wrong for a while, with a declared rate of false alarms.

    `consistent` is 0 for some per cent of the time although all assumptions hold: tests look at
    the latest quarter periods again and again. The alarm adds these times up, less those in which
    the readings fit: a cumulative sum, whose peaks in true logs are exponential. Its limit is the
    peak that they reach once in a declared time.

    References:
        E. S. Page (1954), doi:10.1093/biomet/41.1-2.100

    Args:
        step: between two samples [s].
        quarter: quarter period of the plant [s].
        apart: time between two false alarms [s].

    Attributes:
        limit: samples without fit, less those with, that raise an alarm.
        count: how many alarms there were.
    """

    SAVED: Final = ("count", "_excess", "_samples", "_change")

    def __init__(self, step: float, quarter: float, apart: float = FALSE_ALARMS) -> None:
        chances = max(apart / (APART * quarter), math.e)
        self.limit = math.ceil(PEAK * quarter / step * math.log(chances))
        self.count = self._excess = self._samples = self._change = 0

    def add(self, fits: np.ndarray) -> None:
        """Add the next samples: whether the readings fit (N). An alarm begins the sum again."""
        self._samples += len(fits)
        for change in (1 - 2 * fits).tolist():
            self._excess = max(self._excess + change, 0) % self.limit
            self.count += change > self._excess
            self._change = change

    @property
    def is_due(self) -> bool:
        """Return whether the record as a whole does not fit: after an alarm. In a record too short
        for one the end decides.
        """
        return self.count > 0 or self._samples < self.limit * self._change


class Consistency:
    """The tests of one output, block after block.

    Args:
        step: between two samples [s].
        quarter_period: of the plant [s].
    """

    SAVED: Final = ("B", "used", "refused", "silent", "outside", "_sums", "_squares")

    def __init__(self, step: float, quarter_period: float) -> None:
        self.used = 0
        self.refused = 0
        self.silent = 0
        self.outside = 0
        self._graph = _graph()
        self._rates = np.exp(-step / quarter_period / np.array([SPAN, HISTORY]))
        self._squares = 0.0
        self.restart()

    def restart(self) -> None:
        """Restart the test as the observer restarts. The counts stay."""
        self.B = 1.0
        self._sums = np.array([0.0, 0.0, 1.0])  # total, count, ratio

    def add(self, innovation: Floats, std: Floats) -> Floats:
        """Return B after each of the next samples (N).

        Args:
            innovation: of the output (N), 0 if no reading was used.
            std: its standard deviation (N).
        """
        with np.errstate(invalid="ignore", divide="ignore"):
            nu = innovation / std
        used = (innovation != 0) & np.isfinite(nu)
        far = used & (np.abs(nu) > FAR)
        counted = used & ~far
        nu = np.where(counted, nu, 0.0)
        self.used += int(used.sum())
        self.refused += int(far.sum())
        self._squares = float(np.cumsum([self._squares, *nu * nu])[-1])  # as one by one
        if not nu.size:
            return np.empty(0)
        rows = np.column_stack([nu, counted])
        along, self._sums = interpret.run_interpreted(self._graph, self._sums, rows, self._rates)
        self.B = float(along[-1, 0])
        return along[:, 0]

    def add_silences(self, estimate: Estimate, i: int, silent: Floats, band: float) -> None:
        """Count the silent readings that contradict the zone that is estimated.

        This only counts if the observer makes no use of censored samples: else its innovation shows
        them.

        Args:
            estimate: along the samples.
            i: number of the output.
            silent: whether its reading is there and silent (N).
            band: by how much z may be outside a zone that is silent [z].
        """
        unused = silent.astype(bool) & (estimate.innovation[:, i] == 0)
        z, right, left = (part[unused, i] for part in (estimate.z, estimate.right, estimate.left))
        spread = estimate.innovation_std[unused, i]
        margin = band + ROUNDING * (np.abs(z) + np.abs(right) + np.abs(left))
        with np.errstate(invalid="ignore"):
            beyond_right = z - right - margin > FAR * (spread + estimate.right_std[unused, i])
            beyond_left = -z - left - margin > FAR * (spread + estimate.left_std[unused, i])
        self.silent += int(unused.sum())
        self.outside += int((beyond_right | beyond_left).sum())

    @property
    def square(self) -> float | None:
        """Return the mean square of the normalised innovations that count, or None without any."""
        count = self.used - self.refused
        return self._squares / count if count > 0 else None

    @property
    def most_square(self) -> float:
        """Return the limit of `square`: 1 and five deviations of the mean of so few squares."""
        count = max(self.used - self.refused, 1)
        return max(MOST_SQUARE, 1 + 5 * math.sqrt(2 / count))


class Own:
    """Results of a filter's own tests of its assumptions, block after block.

    Attributes:
        refused: readings that it took for wrong, so far.
        last: bits of the assumptions that it rejected last, and the most suspect one (2).
    """

    SAVED: Final = ("refused", "last", "_before")

    def __init__(self) -> None:
        self.last = np.zeros(2)  # bits of assumptions, and the most suspect one, when last rejected
        self.refused = 0
        self._before = 0  # refused before the filter began anew

    def restart(self) -> None:
        """Restart the test as the filter restarts. The counts stay."""
        self._before = self.refused

    def add(self, estimate: Estimate) -> None:
        """The next estimates, of a filter that judges itself."""
        fits = estimate.consistent[:, 0] > 0.5
        for k in np.flatnonzero(~fits)[-1:]:
            self.last = np.array([estimate.claims[k, 0], estimate.suspect[k, 0]])
        if fits.size:
            self.refused = self._before + int(estimate.refused[-1].sum())


def _graph() -> ca.Function:
    """Return the recursion of the sums as a graph: next, ratio = step(sums, `[nu; counted]`,
    rates).
    """
    sums = ca.SX.sym("s", 3)
    row = ca.SX.sym("w", 2)
    rates = ca.SX.sym("p", 2)
    after = accumulate_innovations(Sums(*ca.vertsplit(sums)), row[0], row[1], rates[0], rates[1])
    return ca.Function("sums", [sums, row, rates], [ca.vertcat(*after), after.ratio])


def verdict_of(
    tests: list[Consistency],
    own: Own | None,
    doubted: bool,
    widths: Floats,
    stds: Floats | None,
    diverged: bool,
    options: Collection[str],
) -> Verdict:
    """Return the verdict from the tests of all outputs.

    Args:
        tests: one for each output (none if the observer gives no innovation_std).
        own: results of the filter's own tests (None without them).
        doubted: whether the readings do not fit for longer than chance explains (`Alarm.is_due`).
        widths: the final widths (2p) [z].
        stds: their standard deviations (2p) [z] (None if the observer gives none).
        diverged: whether an estimate left all bounds.
        options: names of the keys that the method takes.
    """
    reasons = ["an estimate diverged"] if diverged else []
    margin = np.zeros_like(widths) if stds is None else 2 * stds
    if (widths < -margin - 1e-12).any():
        reasons.append("a width is negative")
    used = sum(test.used for test in tests)
    refused = sum(test.refused for test in tests)
    if own is not None:
        refused = max(refused, own.refused)
    if refused > MOST_REFUSED * used and refused > 1:
        reasons.append(f"{_share(refused, max(used, refused))} of the readings cannot be right")
    claims = list_rejected_assumptions(*own.last) if own is not None and doubted else []
    B = max((test.B for test in tests), default=None)
    if own is None and doubted:
        reasons.append(f"the innovations' means are too large for long: B = {B:.3g} > {CHANCE:g}")
    reasons += describe_rejected_assumptions(claims, options)
    for test in tests:
        reasons += _describe_contradictions(test)
    consistent: bool | None = not reasons
    if consistent and not tests:
        consistent = None
        reasons = ["the observer gives no innovation_std"]
    elif consistent and used < FEWEST:
        consistent = None
        reasons = [f"only {used} readings corrected the estimate"]
    squares = [test.square for test in tests if test.square is not None]
    return Verdict(
        consistent,
        B,
        max(squares, default=None),
        used,
        refused,
        sum(test.outside for test in tests),
        list(dict.fromkeys(reasons)),
        claims,
    )


def _share(count: int, of: int) -> str:
    """Return a share in percent."""
    return f"{100 * count / max(of, 1):.0f} %"


def _describe_contradictions(test: Consistency) -> list[str]:
    """Describe why the readings of one output contradict the assumptions, sums apart."""
    reasons = []
    if test.square is not None and test.square > test.most_square:
        reasons.append(
            f"the innovations are too large: their mean square is {test.square:.3g} times as "
            f"large as declared"
        )
    if test.outside > max(1.0, MOST_REFUSED * test.silent):
        reasons.append(
            f"{_share(test.outside, test.silent)} of the silent readings are silent although z^ "
            "lies far outside the estimated zone: a jump sensor, or no dead zone at all?"
        )
    return reasons
