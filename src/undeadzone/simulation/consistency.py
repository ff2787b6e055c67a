"""Whether an observer's innovations are what it claims: the test of batch means along a record.

The means of normalised innovations over some periods of the plant are too large where something
lasts that the observer does not know of, such as a wrong model, another step, swapped columns.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from undeadzone.observers.parts.doubt import HISTORY, SPAN
from undeadzone.observers.parts.judged_filter import FAR
from undeadzone.support.arrays import Floats

LIMIT: Final = 2.2  # of B; a few of a hundred true records exceed it
MOST_REFUSED: Final = 0.05  # share of the readings that may be refused
MOST_SQUARE: Final = 1.5  # mean square of the normalised innovations that were not refused
FEWEST: Final = 30  # readings that a test needs
MOST_OF_THE_TIME: Final = 0.5  # share of the record during which B may exceed its limit


class Verdict(NamedTuple):
    """Whether a record is consistent with what the observer claims.

    Attributes:
        consistent: the answer; None where there is none: the observer gives no innovation_std, or
            too few readings corrected it.
        B: the test's statistic at the end, the largest of the outputs; 1 is usual.
        square: mean square of the normalised innovations that were not refused; 1 is usual.
        used: how many readings corrected the estimate.
        refused: how many of them lie beyond 4.5 standard deviations.
        reasons: why not, or why there is no answer, in words; empty if it is consistent.
    """

    consistent: bool | None
    B: float | None
    square: float | None
    used: int
    refused: int
    reasons: list[str]


class Consistency:
    """The test of one output's innovations, block after block.

    m := a m + nu, n := a^2 n + used, and where n > 1, B := b B + (1 - b) m^2 / n.

    Args:
        step: between two samples [s].
        quarter_period: of the plant [s].
    """

    def __init__(self, step: float, quarter_period: float) -> None:
        self.B = 1.0
        self.used = 0
        self.refused = 0
        self._a = float(np.exp(-step / (SPAN * quarter_period)))
        self._b = float(np.exp(-step / (HISTORY * quarter_period)))
        self._m = 0.0
        self._n = 0.0
        self._squares = 0.0
        self._tested = 0  # samples at which B was renewed
        self._exceeded = 0  # of them, those at which it was beyond its limit

    def add(self, innovation: Floats, std: Floats) -> Floats:
        """B after each of the next samples (N).

        Args:
            innovation: of the output (N); 0 where no reading was used.
            std: its standard deviation (N).
        """
        with np.errstate(invalid="ignore", divide="ignore"):
            nu = innovation / std
        used = (innovation != 0) & np.isfinite(nu)
        refused = used & (np.abs(nu) > FAR)
        counted = used & ~refused
        nu = np.where(counted, nu, 0.0)
        self.used += int(used.sum())
        self.refused += int(refused.sum())
        self._squares += float(nu @ nu)
        return self._recursion(nu.tolist(), counted.tolist())

    @property
    def square(self) -> float | None:
        """The mean square of the normalised innovations that count; None: there is none."""
        count = self.used - self.refused
        return self._squares / count if count else None

    @property
    def exceeded(self) -> float:
        """The share of the tested samples at which B was beyond its limit."""
        return self._exceeded / max(1, self._tested)

    def _recursion(self, nus: list[float], counted: list[bool]) -> Floats:
        """B after each sample (N)."""
        a, b, m, n, B = self._a, self._b, self._m, self._n, self.B
        aa, rest = a * a, 1 - b
        along = []
        for nu, is_counted in zip(nus, counted, strict=True):
            m = a * m + nu
            n = aa * n + is_counted
            if n > 1:
                B = b * B + rest * m * m / n
                self._tested += 1
                if B > LIMIT:
                    self._exceeded += 1
            along.append(B)
        self._m, self._n, self.B = m, n, B
        return np.array(along)


def verdict_of(
    tests: list[Consistency], widths: Floats, stds: Floats | None, diverged: bool
) -> Verdict:
    """What the tests of all outputs come to.

    Args:
        tests: one for each output; none where the observer gives no innovation_std.
        widths: the final widths (2p) [z].
        stds: their standard deviations (2p) [z]; None where the observer gives none.
        diverged: whether an estimate left all bounds.
    """
    reasons = ["an estimate diverged"] if diverged else []
    margin = np.zeros_like(widths) if stds is None else 2 * stds
    if (widths < -margin - 1e-12).any():
        reasons.append("a width is negative")
    for test in tests:
        reasons += _reasons(test)
    used = sum(test.used for test in tests)
    consistent = None
    if reasons:
        consistent = False
    elif not tests:
        reasons = ["the observer gives no innovation_std"]
    elif used < FEWEST:
        reasons = [f"only {used} readings corrected the estimate"]
    else:
        consistent = True
    squares = [test.square for test in tests if test.square is not None]
    return Verdict(
        consistent,
        max((test.B for test in tests), default=None),
        max(squares, default=None),
        used,
        sum(test.refused for test in tests),
        list(dict.fromkeys(reasons)),
    )


def _reasons(test: Consistency) -> list[str]:
    """Why the innovations of one output are not what was claimed; empty if they are."""
    reasons = []
    if test.refused > MOST_REFUSED * test.used and test.refused > 1:
        share = 100 * test.refused / test.used
        reasons.append(f"{share:.0f} % of the readings lie beyond {FAR:g} standard deviations")
    if test.B > LIMIT:
        reasons.append(f"the innovations' means are too large: B = {test.B:.3g} > {LIMIT:g}")
    elif test.exceeded > MOST_OF_THE_TIME:
        share = 100 * test.exceeded
        reasons.append(f"B exceeded {LIMIT:g} during {share:.0f} % of the record")
    if test.square is not None and test.square > MOST_SQUARE:
        reasons.append(
            f"the innovations are too large: their mean square is {test.square:.3g} times as "
            "large as claimed"
        )
    return reasons
