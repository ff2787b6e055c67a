"""Least squares of readings on a plant and an element beside it, and how such models compare.

A model says what is read and how that changes with its numbers; all else is the same for each.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Generic, NamedTuple, Protocol, TypeVar

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.stats import f as fisher

from undeadzone.util.arrays import Floats, Integers
from undeadzone_identify.models import estimates
from undeadzone_identify.models.plant import Simulator, correlations
from undeadzone_identify.models.zone import FAR

ROUNDS, STEPS = 2, 10  # of the climb to the best density, each with a colour of its own
HEARD, TURNS = 11, 4  # residuals before one that foretell it, and rounds of that and of a climb
HATS = 8
COSINES = 24
SURE_SHARE = 0.1  # of the residual that a curve explains, from which it is another nonlinearity
LARGE_SHARE, LIKELY = 0.25, 0.01  # the same for a large share, of which p may be larger
CHANCE = 1e-3  # p from which a curve is real
LEAST_ODD = 1e-3  # rms of y: a model that leaves less is not wrong, and its readings are not odd


class Model(Protocol):
    """A plant and an element; theta = [a, b, x0, the numbers of the element].

    Attributes:
        name: of the model.
        simulator: the plant, with its data.
        free: places of the numbers that are fitted.
        first, last: steps of a climb from every start (0: all go to the end), and to the end.
        gain: two steps in a row that gain less end a climb.
        has_level: whether a constant beside its readings is fitted: a log may lie about any level.
    """

    name: str
    simulator: Simulator
    free: Integers
    first: int
    last: int
    gain: float
    has_level: bool

    def project(self, theta: Floats) -> Floats:
        """Return numbers brought back to where they make sense; these may be changed."""

    def output(self, theta: Floats) -> Floats:
        """Return z, the output of the plant (N)."""

    def readings(self, z: Floats, theta: Floats) -> Floats:
        """What is read of z without noise (N)."""

    def slopes(self, theta: Floats) -> tuple[Floats, Floats]:
        """Return the readings (N), and their derivatives by the free numbers (N x free)."""


M = TypeVar("M", bound=Model)


class Density(NamedTuple):
    """A model's account of the readings.

    Attributes:
        name: of the model.
        value: log density of each reading (N), residuals being first order.
        numbers: how many numbers were fitted.
        rms: of its residuals, scaled.
        strange: whether a curve over its z explains what it leaves: then it is not the map either.
    """

    name: str
    value: Floats
    numbers: int
    rms: float
    strange: bool = False

    @property
    def bic(self) -> float:
        """Return -2 L + p ln N."""
        return -2 * float(self.value.sum()) + self.numbers * math.log(self.value.size)


class LeastSquares(Generic[M]):
    """Least squares of the readings of a model.

    Args:
        model: the plant and the element.
        past: of the residuals before, what foretells one (lags); it is taken out of them.
    """

    longest = math.inf

    def __init__(self, model: M, past: Sequence[float] | Floats = ()) -> None:
        self.model = model
        self.past = np.asarray(past)
        self.data = model.simulator.data
        self.free, self.gain, self.climbs = model.free, model.gain, self.data.climbs
        self._count = int(self.data.ok.sum())
        self._whole = self._count == self.data.ok.size

    def residual(self, theta: Floats) -> Floats:
        """Return y less what is expected (N); 0 where a reading is missing."""
        expected = self.model.readings(self.model.output(theta), theta)
        return self._without_level(self.data.y - expected)

    def _without_level(self, columns: Floats) -> Floats:
        """Return less their mean, which is the best constant; 0 where a reading is missing."""
        there = np.ascontiguousarray(columns) if self._whole else columns[self.data.ok]
        left = columns - (there.mean(axis=0) if self.model.has_level else 0.0)
        return left if self._whole else np.where(self.data.ok, left.T, 0.0).T

    def rows(self, theta: Floats) -> tuple[Floats, Floats]:
        """Return residual (N) and derivatives of the reading by the free numbers (N x free)."""
        expected, slopes = self.model.slopes(theta)
        return self._without_level(self.data.y - expected), self._without_level(slopes)

    def rms(self, theta: Floats) -> float:
        """Return rms of what is left of the readings that there are."""
        return float(np.sqrt(np.mean(self.residual(theta)[self.data.ok] ** 2)))

    def value(self, theta: Floats) -> float:
        """Return minus N / 2 ln of the mean square of the residual; -inf where theta makes no
        sense.
        """
        if not self.model.simulator.admissible(theta):
            return -math.inf
        return self._value_of(self.whiten(self.residual(theta)))

    def _value_of(self, e: Floats) -> float:
        """Return the value of an admissible plant with these residuals (N)."""
        square = float(e @ e)
        if not square < FAR:
            return -math.inf
        return -0.5 * self._count * math.log(square / self._count + 1e-30)

    def quadratic(self, theta: Floats) -> tuple[float, Floats, Floats]:
        """Return (value, score, Gauss-Newton Hessian) of the free numbers of an admissible
        plant.
        """
        e, rows = (self.whiten(one) for one in self.rows(theta))
        variance, hessian = self._gauss_newton(e, rows)
        return self._value_of(e), rows.T @ e / variance, hessian

    def whiten(self, columns: Floats) -> Floats:
        """Return less what the samples before say of them."""
        if not self.past.size:
            return columns
        white = columns.copy()
        for lag, share in enumerate(self.past, 1):  # ten times as fast as a general filter
            white[lag:] -= share * columns[:-lag]
        white[0] *= math.sqrt(max(1 - float(self.past @ self.past), 0.0))
        return white

    def _gauss_newton(self, e: Floats, rows: Floats) -> tuple[float, Floats]:
        """Return variance of residuals, and the Hessian of half their squares over it, kept
        positive.
        """
        variance = float(e @ e) / self._count + 1e-30
        return variance, rows.T @ rows / variance + 1e-9 * np.eye(rows.shape[1])

    def project(self, theta: Floats) -> Floats:
        """Return numbers brought back to where they make sense."""
        return self.model.project(theta)

    def spread(self, theta: Floats) -> estimates.Spread:
        """Return (I1) of the free numbers."""
        e, rows = (self.whiten(one) for one in self.rows(theta))
        variance, hessian = self._gauss_newton(e, rows)
        return estimates.sandwich(rows * e[:, None] / variance, hessian)

    def best(self, starts: Sequence[Floats]) -> Fitted[M] | None:
        """Return the best fit from several starts; None where no start makes sense."""
        top = estimates.best_top(self, starts, self.model.first, self.model.last)
        return None if top is None else Fitted(self, top.theta, self.best_density(top.theta))

    def fit_predictions(self, theta: Floats) -> tuple[LeastSquares[M], Floats]:
        """Return least squares of prediction errors, and the numbers where they are least, near
        theta.

        What disturbs the plant is foretold from past residuals, so that an input that answers to
        these says nothing of the errors (Ljung 1999, section 13.4); no reference is needed.
        """
        squares = self
        for _ in range(TURNS):
            squares = LeastSquares(self.model, self._pasts(self.residual(theta))[-1])
            theta = estimates.climb(squares, theta, STEPS).theta
        return squares, theta

    def best_density(self, theta: Floats) -> Density:
        """Return the model's account of the readings where that is best, near least squares."""
        first = best = self.density(theta)
        ok, e, z = self.data.ok, self.residual(theta), self.model.output(theta)
        strange = first.rms > LEAST_ODD and is_strange(*curve_over(z[ok], e[ok]))
        for _ in range(ROUNDS):
            theta = estimates.climb(self.fit_coloured(theta), theta, STEPS).theta
            best = min(best, self.density(theta), key=lambda one: one.bic)
        return best._replace(rms=first.rms, strange=strange)

    @estimates.latest
    def fit_coloured(self, theta: Floats) -> LeastSquares[M]:
        """Return the same, with residuals that as many before them foretell as BIC takes."""
        e = self.residual(theta)
        every = [LeastSquares(self.model, past) for past in self._pasts(e)]
        return min(every, key=lambda one: one._cost(e))

    def _cost(self, e: Floats) -> float:
        """Return BIC of what foretells residuals."""
        return -2 * self._value_of(self.whiten(e)) + self.past.size * math.log(self._count)

    def _pasts(self, e: Floats) -> list[Floats]:
        """What foretells a residual from 1, 2, ... residuals before it (lags each)."""
        seen = correlations(e, self.data.ok, HEARD)
        seen[0] = seen[0] * (1 + 1e-9) + 1e-15
        return [solve_toeplitz(seen[:lags], seen[1 : lags + 1]) for lags in range(1, HEARD)]

    def density(self, theta: Floats) -> Density:
        """Return the model's account of the readings, residuals taken as autoregressive Gaussian
        noise.
        """
        e = self.residual(theta)
        coloured = self.fit_coloured(theta)
        innovation = coloured.whiten(e)
        variance = float(np.mean(innovation**2)) + 1e-12
        value = -0.5 * innovation**2 / variance - 0.5 * math.log(2 * math.pi * variance)
        numbers = self.free.size + self.model.has_level + coloured.past.size + 1
        return Density(self.model.name, value, numbers, float(np.sqrt(np.mean(e**2))))


class Fitted(NamedTuple, Generic[M]):
    """A model that was fitted: its numbers and its account of the readings."""

    squares: LeastSquares[M]
    theta: Floats
    density: Density

    @property
    def model(self) -> M:
        """Return the plant and the element."""
        return self.squares.model

    @property
    def predicting(self) -> Fitted[M]:
        """Return the same model where its prediction errors are least."""
        squares, theta = self.squares.fit_predictions(self.theta)
        return self._replace(squares=squares, theta=theta)

    @property
    def bic(self) -> float:
        """Return -2 L + p ln N of the numbers that were fitted, by which orders are compared."""
        return self.squares.density(self.theta).bic


# --- What is left, as a curve


def is_strange(share: float, chance: float) -> bool:
    """Return whether a curve explains so much of a residual, and so surely, that the model is
    wrong.
    """
    sure = share > SURE_SHARE and chance < CHANCE
    return sure or (share > LARGE_SHARE and chance < LIKELY)


def curve_over(z: Floats, residual: Floats) -> tuple[float, float]:
    """Return the share of a residual that a curve over z explains, and p of it.

    Args:
        z: output of the plant (N).
        residual: what a model leaves (N).

    Returns:
        Share and p.
    """
    centres = np.unique(np.quantile(z, np.linspace(0.01, 0.99, HATS)))
    _, _, share, chance = explain_residual(hats(z, centres), residual)
    return share, chance


def hats(z: Floats, centres: Floats) -> Floats:
    """Return hat functions of z (N x K), one at each centre."""
    return np.column_stack([np.interp(z, centres, row) for row in np.eye(centres.size)])


def unexplained_by(columns: Floats, target: Floats) -> Floats:
    """What columns leave of a target (n), or of several (n x k)."""
    return np.asarray(target - columns @ np.linalg.lstsq(columns, target, rcond=1e-10)[0])


def explain_residual(columns: Floats, residual: Floats) -> tuple[Floats, Floats, float, float]:
    """Return a residual by functions, by least squares.

    Args:
        columns: the functions (N x K).
        residual: what is to be explained (N).

    Returns:
        Coefficients, their deviations, the share explained, and p of a Wald test by (I1).
    """
    coefficients = np.linalg.lstsq(columns, residual, rcond=None)[0]
    left = residual - columns @ coefficients
    share = 1 - float(left @ left) / max(float(residual @ residual), 1e-300)
    normal = columns.T @ columns + 1e-9 * np.eye(columns.shape[1])
    spread = estimates.sandwich(columns * left[:, None], normal, COSINES)
    null = estimates.sandwich(columns * residual[:, None], normal, COSINES)
    count = columns.shape[1]
    wald = float(coefficients @ np.linalg.pinv(null.V) @ coefficients)
    degrees = max(COSINES - count + 1, 1)
    statistic = wald * degrees / (COSINES * count)
    std = np.sqrt(np.maximum(np.diag(spread.V), 0.0))
    return coefficients, std, share, float(fisher.sf(statistic, count, degrees))
