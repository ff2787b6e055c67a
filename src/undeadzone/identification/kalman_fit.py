"""The fit of (L3): three models of the disturbance, best first."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from undeadzone.identification.climb import Top, climb
from undeadzone.identification.fit import Fit
from undeadzone.identification.kalman_likelihood import (
    AT_INPUT,
    AT_OUTPUT,
    QUIETEST,
    WHITE,
    KalmanObjective,
)
from undeadzone.identification.records import part_of
from undeadzone.support.arrays import Floats

SHARES = (0.2, 0.8)  # of the disturbance in what (L2) left, at the starts


class KalmanFit(NamedTuple):
    """A fit of (L3).

    Attributes:
        objective: what was maximised.
        p: where its top is.
        value: the log likelihood there.
    """

    objective: KalmanObjective
    p: Floats
    value: float

    @property
    def bic(self) -> float:
        """-2 L + P ln N."""
        count = int(self.objective.data.ok.sum())
        return -2 * self.value + self.objective.free.size * math.log(count)

    @property
    def model(self) -> int:
        """The model of the disturbance."""
        return self.objective.numbers.model

    @property
    def right(self) -> float:
        """d_r, scaled."""
        return float(self.p[self.objective.numbers.log_q + 2])

    @property
    def left(self) -> float:
        """d_l, scaled."""
        tied = self.objective.limits.tied
        return self.right if tied else float(self.p[self.objective.numbers.log_q + 3])

    @property
    def r(self) -> float:
        """rms of white noise ahead of the zone, scaled."""
        return max(math.exp(float(self.p[self.objective.numbers.log_q + 1])), QUIETEST)

    @property
    def q(self) -> float:
        """rms of what drives the disturbance, scaled."""
        return math.exp(float(self.p[self.objective.numbers.log_q]))

    @property
    def phi(self) -> float:
        """Correlation of the disturbance over one sample."""
        return math.tanh(float(self.p[-1])) if self.model else 0.0

    def direction(self, right: float = 0.0, left: float = 0.0) -> Floats:
        """The row of right d_r + left d_l over the free numbers."""
        row = np.zeros(self.objective.numbers.size)
        widths = self.objective.numbers.log_q + 2
        row[widths : widths + 2] = right, left
        if self.objective.limits.tied:
            row[widths] += left
        return row[self.objective.free]


def fit_kalman(fit: Fit) -> list[KalmanFit]:
    """(L3) for the three models of the disturbance, best first by BIC.

    Args:
        fit: that of (L2), where the climbs start; of a long log in a part of it.

    Returns:
        One fit a model; empty where none could be run.
    """
    data, layout = fit.objective.data, fit.objective.layout
    part = part_of(data)
    fits = []
    for model in (WHITE, AT_INPUT, AT_OUTPUT):
        objective = KalmanObjective(part, layout, model, fit.objective.limits)
        begun = [objective.start(fit, share) for share in SHARES]
        tops = [climbed(objective, p, 12) for p in begun if objective.admissible(p)]
        if not tops:
            continue
        best = max(tops, key=lambda top: top.value)
        top = climbed(objective, best.theta, 50)
        if part is not data:
            objective = KalmanObjective(data, layout, model, fit.objective.limits)
            top = climbed(objective, top.theta, 50)
        fits.append(KalmanFit(objective, top.theta, top.value))
    return sorted(fits, key=lambda one: one.bic)


def climbed(objective: KalmanObjective, p: Floats, steps: int) -> Top:
    """The top that a climb from p reaches."""
    longest = np.full(objective.numbers.size, np.inf)
    longest[objective.numbers.log_q : objective.numbers.log_q + 2] = 1.0
    return climb(
        objective.value,
        objective.quadratic,
        p,
        objective.free,
        steps,
        2e-3,
        longest=longest[objective.free],
        kept=objective.data.climbs,
    )
