"""Gaps with intervals: by least squares that simulated logs correct.

Noise behind a play leaves least squares consistent. A disturbance ahead of it does not: it makes
more turns, and the gap comes out too small. So logs with the plant, the gap and the disturbance of
the fit are simulated and fitted in the same way, and the numbers are moved until the mean of these
fits is the fit of the log (indirect inference: Gourieroux, Monfort and Renault 1993). The spread of
the fits is a second opinion on the interval.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from undeadzone.nonlinearities.sensor import DIRECTIONS, heaviest
from undeadzone.util.arrays import Floats
from undeadzone_identify.models import motion
from undeadzone_identify.models.elements import PlayFit, PlayModel
from undeadzone_identify.models.estimates import Interval, climb, quantile
from undeadzone_identify.models.least_squares import LeastSquares
from undeadzone_identify.models.plant import Ahead, Data, disturbance_ahead, shape_noise, white

RUNS = 24
ROUNDS = 3
STEPS = 8
MOST = 2.0  # factor of the disturbance in a round
STRONGEST = 0.2  # rms of a disturbance ahead, in rms of y, above which no gap is given
STRONGEST_OF_BOTH = 0.15  # the same where a dead zone follows, which makes y smaller
FINEST = 2e-4  # rms of y: no interval is narrower

# Weights of c_r, c_l, and of d_r, d_l after them.
ROWS: dict[str, tuple[float, ...]] = {
    **DIRECTIONS,
    "zone": (0.0, 0.0, 1.0, 1.0),
    "zone_right": (0.0, 0.0, 1.0, 0.0),
    "zone_left": (0.0, 0.0, 0.0, 1.0),
}


class Gap(NamedTuple):
    """A play, and perhaps the dead zone after it, in the scale of the fit.

    Attributes:
        fit: what was fitted.
        theta: its numbers after the correction.
        intervals: right, left, width, centre of the play; zone, the width of a dead zone, and
            zone_right, zone_left, its edges if the gap is even.
        V: covariance of the plant's numbers a and b.
        ahead: what disturbs z; None of an integrating plant, where it is not told apart.
        noise: rms of the readings' white noise.
        sure: whether the intervals hold; not where a disturbance ahead is too strong.
    """

    fit: PlayFit
    theta: Floats
    intervals: dict[str, Interval]
    V: Floats
    ahead: Ahead | None
    noise: float
    sure: bool


def find_gap(fit: PlayFit, quantum: float, in_loop: bool = False) -> Gap:
    """Return the numbers of a play with their intervals.

    Args:
        fit: least squares.
        quantum: of the readings, scaled; 0: none.
        in_loop: whether u answers to readings: then prediction errors are least, in the log and in
            simulated ones, and by how much that differs from simulation widens the intervals.

    Returns:
        Corrected numbers; of an integrating plant, whose disturbances add up, those of the fit.
    """
    data = fit.squares.data
    how = motion.sensing(data.y, data.ok, data.start, quantum)
    if fit.model.simulator.layout.integrators:
        return _as_fitted(fit, _noise(data, how, quantum))
    return _correct_bias(fit, _noise(data, how, quantum), quantum, in_loop)


def _noise(data: Data, how: motion.Sensing, quantum: float) -> float:
    """Return rms of the white noise of the readings besides rounding, scaled."""
    if not how.noise:
        return 0.0
    rms = motion.white_noise(data.y, data.ok, data.start)
    return math.sqrt(max(rms**2 - quantum**2 / 12, 0.0))


def _intervals(theta: Floats, model: PlayModel, halves: dict[str, float]) -> dict[str, Interval]:
    """Return values with their half intervals."""
    intervals = {}
    for name, row in ROWS.items():
        value = float(np.dot(row, theta[model.base :][: len(row)]))
        intervals[name] = Interval.around(value, math.hypot(halves[name], heaviest(row) * FINEST))
    return intervals


def _own_halves(fit: PlayFit) -> dict[str, float]:
    """Return half intervals by (I1)."""
    spread = fit.squares.spread(fit.theta)
    return {name: spread.half_width(fit.model.direction(*row)) for name, row in ROWS.items()}


def _as_fitted(fit: PlayFit, noise: float) -> Gap:
    """Return the numbers of the fit with intervals by (I1)."""
    count = fit.model.simulator.layout.b.stop
    V = fit.squares.spread(fit.theta).V[:count, :count]
    intervals = _intervals(fit.theta, fit.model, _own_halves(fit))
    return Gap(fit, fit.theta, intervals, V, None, noise, True)


# --- By least squares and simulated logs


def _correct_bias(fit: PlayFit, noise: float, quantum: float, in_loop: bool) -> Gap:
    """Return the numbers of the fit, moved to where simulated logs are fitted as the log was."""
    simulated, fit = fit, fit.predicting if in_loop else fit
    model, theta = fit.model, fit.theta
    halves, wider = _own_halves(fit), _own_halves(simulated)
    moved, fits, ahead = _match_simulations(fit, noise, quantum)
    scatter = np.cov(fits.T)
    for name, row in ROWS.items():
        weights = np.zeros(model.size)
        weights[model.base :][: len(row)] = row
        std = math.sqrt(max(float(weights @ scatter @ weights), 0.0) * (1 + 1 / RUNS))
        own = max(halves[name], wider[name], quantile(RUNS - 1) * std)
        apart = float(weights @ (simulated.theta - theta))
        halves[name] = math.hypot(own, float(weights @ (moved - theta)), apart)
    intervals = _intervals(moved, model, halves)
    count = model.simulator.layout.b.stop
    most = STRONGEST_OF_BOTH if model.zone else STRONGEST
    return Gap(fit, moved, intervals, scatter[:count, :count], ahead, noise, ahead.rms < most)


def ahead_of(fit: PlayFit) -> Ahead:
    """What disturbs z, by what least squares leave."""
    squares, layout = fit.squares, fit.model.simulator.layout
    return disturbance_ahead(layout, fit.theta, squares.residual(fit.theta), squares.data.ok)


def _match_simulations(fit: PlayFit, noise: float, quantum: float) -> tuple[Floats, Floats, Ahead]:
    """Return numbers whose simulated logs are fitted as the log was, those fits, and the
    disturbance.
    """
    layout, size = fit.model.simulator.layout, fit.squares.data.y.size
    ahead = ahead_of(fit)
    colour = white(RUNS, size, ahead.phi)
    behind = noise * np.random.default_rng(1).standard_normal((RUNS, size))
    left = _coloured_share(fit.squares.rms(fit.theta), noise)
    theta, rms = fit.theta, ahead.rms
    for _ in range(ROUNDS):
        w = shape_noise(layout, theta, colour)
        w *= rms / max(float(w.std()), 1e-300)
        fits, residuals = _refit_simulations(fit, theta, w, behind, quantum)
        remains = _coloured_share(float(np.sqrt(np.mean(residuals**2))), noise)
        rms *= min(math.sqrt(left / remains), MOST)
        theta = _move_theta(fit, theta, fit.theta - fits.mean(axis=0))
    gain = ahead.at_input / max(ahead.rms, 1e-300)
    return theta, fits, Ahead(rms, ahead.phi, rms * gain)


def _move_theta(fit: PlayFit, theta: Floats, step: Floats) -> Floats:
    """Return theta moved by a step; the widths alone where the plant would leave what is
    admissible.
    """
    trial = fit.model.project(theta + step)
    if math.isfinite(fit.squares.value(trial)):
        return trial
    of_widths = np.where(np.arange(step.size) < fit.model.base, 0.0, step)
    return fit.model.project(theta + of_widths)


def _coloured_share(rms: float, noise: float) -> float:
    """Return the mean square of a residual besides white noise."""
    return max(rms**2 - noise**2, 1e-8)


def _refit_simulations(
    fit: PlayFit, theta: Floats, ahead: Floats, behind: Floats, quantum: float
) -> tuple[Floats, Floats]:
    """Fits of logs simulated with theta (RUNS x P), and the rms of what each leaves (RUNS)."""
    model = fit.model
    z = model.output(theta)
    fits, residuals = [], []
    for w, e in zip(ahead, behind, strict=True):
        y = _round_readings(model.readings(z + w, theta) + e, quantum)
        squares = LeastSquares(model.of_readings(y), fit.squares.past)
        fits.append(climb(squares, theta, STEPS, 1e-3).theta)
        residuals.append(squares.rms(fits[-1]))
    return np.array(fits), np.array(residuals)


def _round_readings(y: Floats, quantum: float) -> Floats:
    """Return readings as they are recorded."""
    return quantum * np.round(y / quantum) if quantum else y
