"""Least squares of readings on a plant with an element, and densities to compare models.

A model returns the readings and their derivatives by its parameters. Everything else is shared by
all models.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Generic, NamedTuple, Protocol, Self, TypeVar

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.stats import f as fisher

from undeadzone.util.arrays import Floats, Integers
from undeadzone_identify.models import estimates
from undeadzone_identify.models.likelihood import log_unit_density, root_mean_square
from undeadzone_identify.models.plant import PlantSimulator, RecordData, mean_lag_products
from undeadzone_identify.models.zone import FAR

# rounds of the search for the best density, and steps of each
ROUNDS = 2
STEPS = 10
LONGEST_MEMORY = 11  # largest autoregressive order of the residuals, plus 1
TURNS = 4  # rounds of fitting an autoregression and maximising the likelihood with it
COSINES = 24
CHANCE = 1e-3  # p value below which a remainder is significant
LEAST_ODD = 1e-3  # rms of y, below which the scatter of residuals makes no reading an outlier


class Model(Protocol):
    """Plant and element; theta = [a, b, x0, the parameters of the element].

    Attributes:
        name: of the model.
        simulator: the plant, with its data.
        free: places of the numbers that are fitted.
        first, last: steps of a maximisation from every start (0: none), and further ones.
        gain: least gain of a step; two smaller gains in a row end a maximisation.
        has_level: whether a constant offset of the readings is fitted as well.
    """

    name: str
    simulator: PlantSimulator
    free: Integers
    first: int
    last: int
    gain: float
    has_level: bool

    def along(self, data: RecordData) -> Self:
        """Return the same model for other records."""

    def levels(self, theta: Floats) -> Floats:
        """Return the element's right and left width, in rms of its signal (2)."""

    def project_to_bounds(self, theta: Floats) -> Floats:
        """Restrict theta to admissible values; theta may be changed in place."""

    def output(self, theta: Floats) -> Floats:
        """Return z, the output of the plant (N)."""

    def noise_free_readings(self, z: Floats, theta: Floats) -> Floats:
        """Return the readings of z without noise (N)."""

    def slopes(self, theta: Floats) -> tuple[Floats, Floats]:
        """Return the readings (N), and their derivatives by the free parameters (N x free)."""


M = TypeVar("M", bound=Model)


class Density(NamedTuple):
    """Log densities of the readings under a model.

    Attributes:
        name: name of the model.
        value: log density of each reading (N), with autoregressive residuals.
        numbers: number of fitted parameters.
        rms: rms of the residuals, scaled.
    """

    name: str
    value: Floats
    numbers: int
    rms: float

    @property
    def bic(self) -> float:
        """Return the BIC, -2 L + p ln N."""
        return -2 * float(self.value.sum()) + self.numbers * math.log(self.value.size)


def build_gaussian_density(name: str, e: Floats, numbers: int, variance: float) -> Density:
    """Build the density of readings with white Gaussian residuals.

    Args:
        name: name of the model.
        e: residuals (N).
        numbers: number of fitted parameters.
        variance: variance of the residuals.
    """
    rms = math.sqrt(variance)
    return Density(name, log_unit_density(e / rms) - math.log(rms), numbers, rms)


class LeastSquares(Generic[M]):
    """Least squares of the readings on a model.

    Args:
        model: the plant and the element.
        past: autoregressive coefficients of the residuals, which whiten them (lags).
    """

    longest = math.inf

    def __init__(self, model: M, past: Sequence[float] | Floats = ()) -> None:
        self.model = model
        self.past = np.asarray(past)
        self.data = model.simulator.data
        self.free = model.free
        self.gain = model.gain
        self.climbs = self.data.climbs
        self._count = int(self.data.ok.sum())
        self._whole = self._count == self.data.ok.size

    def reading_residual(self, theta: Floats) -> Floats:
        """Return the readings less their expectation (N); 0 if a reading is missing."""
        expected = self.model.noise_free_readings(self.model.output(theta), theta)
        return self._subtract_level(self.data.y - expected)

    def _subtract_level(self, columns: Floats) -> Floats:
        """Return columns less their mean, the best constant; 0 if a reading is missing."""
        present = np.ascontiguousarray(columns) if self._whole else columns[self.data.ok]
        centred = columns - (present.mean(axis=0) if self.model.has_level else 0.0)
        return centred if self._whole else np.where(self.data.ok, centred.T, 0.0).T

    def residual_and_slopes(self, theta: Floats) -> tuple[Floats, Floats]:
        """Return the residual (N) and derivatives by the free parameters (N x free)."""
        expected, slopes = self.model.slopes(theta)
        return self._subtract_level(self.data.y - expected), self._subtract_level(slopes)

    def residual_rms(self, theta: Floats) -> float:
        """Return the rms of the residual over the available readings, scaled."""
        return root_mean_square(self.reading_residual(theta)[self.data.ok])

    def total_log_likelihood(self, theta: Floats) -> float:
        """Return -N/2 ln(mean squared residual); -inf if theta is inadmissible."""
        if not self.model.simulator.has_settling_poles(theta):
            return -math.inf
        return self._value_of_residual(self.whiten(self.reading_residual(theta)))

    def _value_of_residual(self, e: Floats) -> float:
        """Return the log likelihood of an admissible plant with these residuals (N)."""
        square = e @ e
        if not square < FAR:
            return -math.inf
        return -0.5 * self._count * math.log(square / self._count + 1e-30)

    def quadratic_model(self, theta: Floats) -> tuple[float, Floats, Floats]:
        """Return log likelihood, score (F) and Gauss-Newton Hessian (F x F).

        The derivatives are by the F free parameters; theta must be admissible.
        """
        e, rows = map(self.whiten, self.residual_and_slopes(theta))
        variance, hessian = self._gauss_newton_hessian(e, rows)
        return self._value_of_residual(e), rows.T @ e / variance, hessian

    def whiten(self, columns: Floats) -> Floats:
        """Return signals (N, or N x K) less their prediction by the autoregression."""
        if not self.past.size:
            return columns
        white = columns.copy()
        for lag, coefficient in enumerate(self.past, 1):  # ten times as fast as a general filter
            white[lag:] -= coefficient * columns[:-lag]
        white[0] *= math.sqrt(max(1 - (self.past @ self.past), 0.0))
        return white

    def _gauss_newton_hessian(self, e: Floats, rows: Floats) -> tuple[float, Floats]:
        """Return the residual variance, and the Gauss-Newton Hessian (F x F) over it.

        Args:
            e: residuals (N).
            rows: derivatives of the residuals (N x F).
        """
        variance = float(e @ e) / self._count + 1e-30
        return variance, rows.T @ rows / variance + 1e-9 * np.eye(rows.shape[1])

    def project_to_bounds(self, theta: Floats) -> Floats:
        """Restrict theta to admissible values."""
        return self.model.project_to_bounds(theta)

    def robust_covariance(self, theta: Floats) -> estimates.EstimateCovariance:
        """Return the robust covariance (I1) of the free parameters (F x F)."""
        e, rows = map(self.whiten, self.residual_and_slopes(theta))
        variance, hessian = self._gauss_newton_hessian(e, rows)
        return estimates.sandwich_covariance(rows * e[:, None] / variance, hessian)

    def fit_from_starts(self, starts: Sequence[Floats]) -> FittedModel[M] | None:
        """Fit from several start points (P each); return the best fit, None without a fit."""
        maximum = estimates.best_maximum(self, starts, self.model.first, self.model.last)
        if maximum is None:
            return None
        return FittedModel(self, maximum.theta, self.best_density(maximum.theta))

    def minimise_prediction_errors(self, theta: Floats) -> tuple[LeastSquares[M], Floats]:
        """Minimise one-step prediction errors near theta.

        An autoregression predicts the disturbance from past residuals. The estimate is then
        consistent even if feedback makes the input depend on these (Ljung 1999, section 13.4).

        Returns:
            Least squares with that autoregression, and its parameters (P).
        """
        squares = self
        for _ in range(TURNS):
            squares = LeastSquares(
                self.model, self._fit_autoregressions(self.reading_residual(theta))[-1]
            )
            theta = estimates.maximise_likelihood(squares, theta, STEPS).theta
        return squares, theta

    def best_density(self, theta: Floats) -> Density:
        """Return the density of least BIC near the least-squares fit theta (P).

        Its parameters also maximise the likelihood with autoregressive residuals.
        """
        first = best = self.autoregressive_density(theta)
        for _ in range(ROUNDS):
            theta = estimates.maximise_likelihood(self.fit_coloured(theta), theta, STEPS).theta
            best = min(best, self.autoregressive_density(theta), key=lambda density: density.bic)
        return best._replace(rms=first.rms)

    @estimates.cache_latest
    def fit_coloured(self, theta: Floats) -> LeastSquares[M]:
        """Return least squares with the autoregression of the residuals of least BIC."""
        e = self.reading_residual(theta)
        candidates = [LeastSquares(self.model, past) for past in self._fit_autoregressions(e)]
        return min(candidates, key=lambda squares: squares._autoregression_bic(e))

    def _autoregression_bic(self, e: Floats) -> float:
        """Return the BIC of the residuals' autoregression."""
        return -2 * self._value_of_residual(self.whiten(e)) + self.past.size * math.log(self._count)

    def _fit_autoregressions(self, e: Floats) -> list[Floats]:
        """Return the coefficients of autoregressions of order 1, 2, ... by Yule and Walker."""
        r = mean_lag_products(e, self.data.ok, LONGEST_MEMORY)
        r[0] = r[0] * (1 + 1e-9) + 1e-15  # keeps the equations regular
        return [solve_toeplitz(r[:lags], r[1 : lags + 1]) for lags in range(1, LONGEST_MEMORY)]

    def autoregressive_density(self, theta: Floats) -> Density:
        """Return the density of the readings with autoregressive Gaussian residuals."""
        e = self.reading_residual(theta)
        coloured = self.fit_coloured(theta)
        innovation = coloured.whiten(e)
        variance = float(np.mean(innovation**2)) + 1e-12
        numbers = self.free.size + self.model.has_level + coloured.past.size + 1
        density = build_gaussian_density(self.model.name, innovation, numbers, variance)
        return density._replace(rms=root_mean_square(e))


class FittedModel(NamedTuple, Generic[M]):
    """Fitted model: its parameters and its density of the readings."""

    squares: LeastSquares[M]
    theta: Floats
    density: Density

    @property
    def model(self) -> M:
        """Return the plant with its element."""
        return self.squares.model

    @property
    def prediction_fit(self) -> FittedModel[M]:
        """Return the same model with parameters of least one-step prediction errors."""
        squares, theta = self.squares.minimise_prediction_errors(self.theta)
        return self._replace(squares=squares, theta=theta)

    @property
    def bic(self) -> float:
        """Return the BIC of the fitted parameters, -2 L + p ln N, to compare orders."""
        return self.squares.autoregressive_density(self.theta).bic


# --- Remainders as curves


def hat_functions(z: Floats, centres: Floats) -> Floats:
    """Return the hat functions (linear splines) of z (N) about K centres (N x K)."""
    return np.column_stack([np.interp(z, centres, row) for row in np.eye(centres.size)])


def regression_residual(columns: Floats, target: Floats) -> Floats:
    """Return the residual of targets (n, or n x k) regressed on columns (n x m)."""
    return target - columns @ np.linalg.lstsq(columns, target, rcond=1e-10)[0]


def regress_residual(columns: Floats, residual: Floats) -> tuple[Floats, Floats, float, float]:
    """Fit a residual by functions in least squares.

    Args:
        columns: values of K functions (N x K).
        residual: residual of a model (N).

    Returns:
        Coefficients (K), their standard deviations (K), the share of the residual's power that
        they explain, and the p value of a Wald test that all are 0, by (I1).
    """
    coefficients = np.linalg.lstsq(columns, residual, rcond=None)[0]
    e = residual - columns @ coefficients
    share = 1 - float(e @ e) / max(float(residual @ residual), 1e-300)
    normal = columns.T @ columns + 1e-9 * np.eye(columns.shape[1])
    spread = estimates.sandwich_covariance(columns * e[:, None], normal, COSINES)
    # The test uses the covariance under its hypothesis, that all coefficients are 0.
    null = estimates.sandwich_covariance(columns * residual[:, None], normal, COSINES)
    count = columns.shape[1]
    wald = coefficients @ np.linalg.pinv(null.V) @ coefficients
    degrees = max(COSINES - count + 1, 1)
    statistic = wald * degrees / (COSINES * count)
    std = np.sqrt(np.maximum(np.diag(spread.V), 0.0))
    return coefficients, std, share, float(fisher.sf(statistic, count, degrees))


def describe_p_value(chance: float) -> str:
    """Describe a p value in words, as `p = 0.02`, or `p < 0.001` if it is smaller."""
    return "p < 0.001" if chance < 1e-3 else f"p = {chance:.2g}"
