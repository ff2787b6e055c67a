"""(L3): the likelihood of a record through the measured-side Kalman filter."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from undeadzone.compile import lanes
from undeadzone.identification.fit import Fit
from undeadzone.identification.kalman_step import kernel
from undeadzone.identification.long_run import Spread, above, sandwich
from undeadzone.identification.objective import Limits
from undeadzone.identification.plant_fit import Data, Layout, roots
from undeadzone.support.arrays import Floats

WHITE, AT_INPUT, AT_OUTPUT = 0, 1, 2  # models of the disturbance
NAMES = ("white at the input", "first order at the input", "first order at the output")
QUIETEST = 1e-3  # least rms of white noise ahead of the zone, in rms of y
STEP = 1e-4  # of a number, for differences


class Numbers(NamedTuple):
    """Places in [a, b, ln q, ln r, d_r, d_l, (atanh phi)].

    Attributes:
        n, m: order of the plant, inputs.
        model: of the disturbance.
        integrators: of the plant; a holds the other poles.
    """

    n: int
    m: int
    model: int
    integrators: int = 0

    @property
    def moving(self) -> int:
        """Coefficients of the denominator without its integrators."""
        return self.n - self.integrators

    @property
    def log_q(self) -> int:
        """ln q; ln r, d_r, d_l and atanh phi follow."""
        return self.moving + self.n * self.m

    @property
    def lane_q(self) -> int:
        """q^2 among the numbers of a lane; r^2, d_r, d_l, phi, variances at first, slack follow."""
        return self.n * (1 + self.m)

    @property
    def size(self) -> int:
        """How many numbers there are."""
        return self.log_q + 4 + (self.model > 0)


class KalmanObjective:
    """(L3) of a record for one order and one model of the disturbance.

    Args:
        data: the records.
        layout: order, inputs and integrators of the plant.
        model: WHITE, AT_INPUT or AT_OUTPUT.
        limits: of the widths.
        slack: by how much what a play passes on may be beside a reading that holds.
    """

    def __init__(
        self, data: Data, layout: Layout, model: int, limits: Limits, slack: float = 0.0
    ) -> None:
        self.data = data
        self.layout = layout
        self.numbers = Numbers(layout.n, layout.m, model, layout.integrators)
        self.limits = limits
        self.slack = slack
        starts = np.zeros(data.y.size)
        starts[data.start] = 1.0
        rows = [data.u, data.y, data.side, data.ok, starts]
        self.exogenous = np.column_stack(rows)
        free = np.ones(self.numbers.size, bool)
        widths = self.numbers.log_q + 2
        free[widths] = limits.right[0] != limits.right[1]
        free[widths + 1] = limits.left[0] != limits.left[1] and not limits.tied
        self.free = np.flatnonzero(free)
        self._last: tuple[Floats, Floats, Floats] | None = None
        self._known: tuple[Floats, Spread] | None = None

    def admissible(self, p: Floats) -> bool:
        """Whether the filter can be run with these numbers."""
        numbers = self.numbers
        if not np.isfinite(p).all():
            return False
        log_q, log_r, right, left = p[numbers.log_q : numbers.log_q + 4]
        if right + left < 0 or abs(log_q) > 25 or abs(log_r) > 25:
            return False
        if numbers.model and abs(p[-1]) > 4:
            return False
        poles = roots(p[: numbers.moving])
        return bool(np.abs(poles).max(initial=0.0) < 1 - 1e-4)

    def lane(self, p: Floats) -> Floats:
        """The numbers of `kalman_step.kernel` for p."""
        numbers = self.numbers
        log_q, log_r, right, left = p[numbers.log_q : numbers.log_q + 4]
        left = right if self.limits.tied else left
        q = math.exp(log_q)
        r = max(math.exp(log_r), QUIETEST)
        phi = math.tanh(p[-1]) if numbers.model else 0.0
        at_first = q * q / max(1 - phi * phi, 1e-4)
        tail = [q * q, r * r, right, left, phi, 5.0, at_first, self.slack]
        a = self.layout.denominator(p[: numbers.moving])
        return np.concatenate([a, p[numbers.moving : numbers.log_q], tail])

    def densities(self, points: Floats) -> Floats:
        """Log densities of the samples (points x N) for several sets of numbers (points x P)."""
        logs = self.outputs(points)[:, :, 0]
        return np.nan_to_num(logs, nan=-1e3, posinf=-1e3, neginf=-1e3)

    def outputs(self, points: Floats, moments: bool = False) -> Floats:
        """Outputs of `kalman_step.kernel` (points x N x outputs) for several sets of numbers."""
        numbers = self.numbers
        rows = np.array([self.lane(p) for p in points])
        compiled = kernel(numbers.n, numbers.m, numbers.model, moments)
        size = numbers.n + (numbers.model > 0)
        state = np.zeros(size + size * (size + 1) // 2)
        outputs, _ = lanes.run(
            compiled,
            np.tile(state, (len(rows), 1)),
            self.exogenous,
            np.zeros(rows.shape[1]),
            lane_params=rows,
            threads=1,
        )
        return outputs

    def scores(self, p: Floats) -> tuple[Floats, Floats]:
        """Log densities (N) and their derivatives by the free numbers (N x free)."""
        if self._last is not None and np.array_equal(self._last[0], p):
            return self._last[1], self._last[2]
        points, steps = self._around(p)
        values = self.densities(points)
        count = self.free.size
        slopes = (values[1 : 1 + count] - values[1 + count :]) / (2 * steps[:, None])
        self._last = (p.copy(), values[0], slopes.T)
        return values[0], slopes.T

    def _around(self, p: Floats) -> tuple[Floats, Floats]:
        """p, then p with each free number a little larger, then a little smaller; the steps."""
        steps = STEP * np.maximum(np.abs(p[self.free]), 0.05)
        points = np.tile(p, (1 + 2 * self.free.size, 1))
        for place, (index, step) in enumerate(zip(self.free, steps, strict=True)):
            points[1 + place, index] += step
            points[1 + self.free.size + place, index] -= step
        return points, steps

    def value(self, p: Floats) -> float:
        """The log likelihood; -inf where p makes no sense."""
        if not self.admissible(p):
            return -math.inf
        return float(self.scores(p)[0].sum())

    def quadratic(self, p: Floats) -> tuple[float, Floats, Floats]:
        """(value, score, outer products of the scores) of the free numbers."""
        values, slopes = self.scores(p)
        hessian = slopes.T @ slopes + 1e-9 * np.eye(self.free.size)
        return float(values.sum()), slopes.sum(axis=0), hessian

    def start(self, fit: Fit, share: float) -> Floats:
        """Numbers from a fit of (L2), that share of its disturbance coming from the model."""
        right = fit.objective.layout.right
        widths = fit.theta[right : right + 2]
        white = math.sqrt(1 - share) * fit.s
        return self.begun(fit.theta, widths, math.sqrt(share) * fit.s, white, fit.rho)

    def begun(
        self, plant: Floats, widths: Floats, disturbance: float, white: float, rho: float
    ) -> Floats:
        """Numbers where a climb starts.

        Args:
            plant: a, b, ...
            widths: d_r, d_l.
            disturbance: rms of what it makes of z.
            white: rms of white noise.
            rho: correlation of the disturbance over one sample, as far as it is known.
        """
        numbers = self.numbers
        p = np.zeros(numbers.size)
        p[: numbers.log_q] = plant[: numbers.log_q]
        white = max(white, 2 * QUIETEST)
        phi = min(max(rho, 0.5), 0.99)
        gain = math.sqrt(self._gain(p, phi if numbers.model == AT_INPUT else 0.0))
        root = math.sqrt(1 - phi * phi)
        if numbers.model == AT_OUTPUT:
            log_q = math.log(disturbance * root)
        elif numbers.model == AT_INPUT:
            log_q = math.log(disturbance * root / gain)
        else:
            log_q = math.log(disturbance / gain)
        p[numbers.log_q : numbers.log_q + 2] = log_q, math.log(white)
        p[numbers.log_q + 2 : numbers.log_q + 4] = widths
        if numbers.model:
            p[-1] = math.atanh(phi)
        return p

    def _gain(self, p: Floats, phi: float) -> float:
        """Variance at z of unit noise at the inputs, first order with that correlation."""
        moving = self.numbers.moving
        return input_gain(p[:moving], p[moving : self.numbers.log_q], self.numbers.n, phi)

    def spread(self, p: Floats) -> Spread:
        """(I1) of the free numbers, with a numerical Hessian; the last one is kept."""
        if self._known is None or not np.array_equal(self._known[0], p):
            self._known = (p.copy(), self._spread(p))
        return self._known[1]

    def _spread(self, p: Floats) -> Spread:
        """`spread`, computed."""
        _, scores = self.scores(p)
        outer = scores.T @ scores
        scale = 1 / np.sqrt(np.diag(outer) + 1e-12)
        steps = np.minimum(3e-2 * scale, 0.05)
        points, inner = [], []
        for index, step in zip(self.free, steps, strict=True):
            for sign in (1.0, -1.0):
                moved = p.copy()
                moved[index] += sign * step
                around, small = self._around(moved)
                points.append(around[1:])
                inner.append(small)
        totals = self.densities(np.concatenate(points)).sum(axis=1)
        hessian = np.empty_like(outer)
        count = self.free.size
        for place, step in enumerate(steps):
            score = []
            for part in (2 * place, 2 * place + 1):
                block = totals[part * 2 * count : (part + 1) * 2 * count]
                score.append((block[:count] - block[count:]) / (2 * inner[part]))
            hessian[place] = -(score[0] - score[1]) / (2 * step)
        if not np.isfinite(hessian).all():
            hessian = outer
        return sandwich(scores, above(hessian, outer))


def input_gain(a: Floats, b: Floats, n: int, phi: float) -> float:
    """Variance at z of unit noise at the inputs, first order with correlation phi.

    Args:
        a: denominator a_1, a_2, ...
        b: numerators from delay 1, input by input (m n).
        n: order.
        phi: correlation over one sample.

    Returns:
        The sum of squares of the response; at least 1e-12.
    """
    from scipy.signal import lfilter

    total = 0.0
    for numerator in b.reshape(-1, n):
        impulse = np.zeros(5000)
        impulse[0] = math.sqrt(1 - phi * phi)
        shaped = lfilter([1.0], [1.0, -phi], impulse)
        total += float(np.sum(lfilter(np.append(0.0, numerator), np.append(1.0, a), shaped) ** 2))
    return max(total, 1e-12)
