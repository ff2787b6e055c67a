"""Gap of a play with intervals: least squares, corrected by simulated logs.

Noise behind a play leaves least squares consistent. A disturbance ahead of it does not: it makes
more turns, and the gap comes out too small. So logs with the plant, the gap and the disturbance of
the fit are simulated and fitted in the same way, and the numbers are moved until the mean of these
fits is the fit of the log (indirect inference: Gourieroux, Monfort and Renault 1993). The spread of
the fits is a second opinion on the interval.

References:
    C. Gourieroux, A. Monfort, E. Renault (1993), doi:10.1002/jae.3950080507
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from undeadzone.nonlinearities.sensor import DIRECTIONS, heaviest
from undeadzone.util.arrays import Floats
from undeadzone_identify.models import motion
from undeadzone_identify.models.elements import PlayFit, PlayModel
from undeadzone_identify.models.estimates import Interval, maximise_likelihood, student_quantile
from undeadzone_identify.models.least_squares import LeastSquares
from undeadzone_identify.models.plant import (
    InputDisturbance,
    RecordData,
    find_input_disturbance,
    first_order_noise,
    plant_response,
)

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


class PlayGap(NamedTuple):
    """Play, and perhaps the dead zone after it, in the scale of the fit.

    Attributes:
        fit: of the play.
        theta: its numbers after the correction.
        intervals: right, left, width, centre of the play; zone, the width of a dead zone, and
            zone_right, zone_left, its edges if the gap is even.
        V: covariance of the plant's numbers a and b.
        ahead: disturbance of z; None of an integrating plant, which does not separate it.
        noise: rms of the readings' white noise.
        sure: whether the intervals hold; not where a disturbance ahead is too strong.
    """

    fit: PlayFit
    theta: Floats
    intervals: dict[str, Interval]
    V: Floats
    ahead: InputDisturbance | None
    noise: float
    sure: bool


def find_play_gap(fit: PlayFit, quantum: float, in_loop: bool = False) -> PlayGap:
    """Find the parameters of a play with their intervals.

    Args:
        fit: least squares.
        quantum: of the readings, scaled; 0: none.
        in_loop: whether u answers to readings: then prediction errors are least, in the log and in
            simulated ones, and by how much that differs from simulation widens the intervals.

    Returns:
        Corrected numbers; of an integrating plant, whose disturbances add up, those of the fit.
    """
    data = fit.squares.data
    how = motion.detect_motion_rule(data.y, data.ok, data.start, quantum)
    if fit.model.simulator.layout.integrators:
        return _uncorrected_gap(fit, _unrounded_noise_rms(data, how, quantum))
    return _indirect_inference_gap(fit, _unrounded_noise_rms(data, how, quantum), quantum, in_loop)


def _unrounded_noise_rms(data: RecordData, how: motion.MotionRule, quantum: float) -> float:
    """Return the rms of the white noise of the readings besides rounding, scaled."""
    if not how.noise:
        return 0.0
    rms = motion.white_noise_rms(data.y, data.ok, data.start)
    return math.sqrt(max(rms**2 - quantum**2 / 12, 0.0))


def _gap_intervals(
    theta: Floats, model: PlayModel, halves: dict[str, float]
) -> dict[str, Interval]:
    """Return the widths with their half intervals."""
    intervals = {}
    for name, row in ROWS.items():
        value = float(np.dot(row, theta[model.base :][: len(row)]))
        intervals[name] = Interval.from_half_width(
            value, math.hypot(halves[name], heaviest(row) * FINEST)
        )
    return intervals


def _own_half_intervals(fit: PlayFit) -> dict[str, float]:
    """Return half intervals by the robust covariance (I1)."""
    spread = fit.squares.robust_covariance(fit.theta)
    return {name: spread.half_width(fit.model.play_weights(*row)) for name, row in ROWS.items()}


def _uncorrected_gap(fit: PlayFit, noise: float) -> PlayGap:
    """Return the parameters of the fit with intervals by (I1)."""
    count = fit.model.simulator.layout.numerators.stop
    V = fit.squares.robust_covariance(fit.theta).V[:count, :count]
    intervals = _gap_intervals(fit.theta, fit.model, _own_half_intervals(fit))
    return PlayGap(fit, fit.theta, intervals, V, None, noise, True)


# --- By least squares and simulated logs


def _indirect_inference_gap(fit: PlayFit, noise: float, quantum: float, in_loop: bool) -> PlayGap:
    """Return the fit's parameters, moved until fits of simulated logs equal the fit of the
    log.
    """
    simulated, fit = fit, fit.prediction_fit if in_loop else fit
    model, theta = fit.model, fit.theta
    halves, wider = _own_half_intervals(fit), _own_half_intervals(simulated)
    moved, fits, ahead = _match_simulated_fits(fit, noise, quantum)
    scatter = np.cov(fits.T)
    for name, row in ROWS.items():
        weights = np.zeros(model.size)
        weights[model.base :][: len(row)] = row
        std = math.sqrt(max(float(weights @ scatter @ weights), 0.0) * (1 + 1 / RUNS))
        own = max(halves[name], wider[name], student_quantile(RUNS - 1) * std)
        apart = float(weights @ (simulated.theta - theta))
        halves[name] = math.hypot(own, float(weights @ (moved - theta)), apart)
    intervals = _gap_intervals(moved, model, halves)
    count = model.simulator.layout.numerators.stop
    most = STRONGEST_OF_BOTH if model.zone else STRONGEST
    return PlayGap(fit, moved, intervals, scatter[:count, :count], ahead, noise, ahead.rms < most)


def play_disturbance(fit: PlayFit) -> InputDisturbance:
    """Return the disturbance of z that explains the least-squares residual."""
    squares, layout = fit.squares, fit.model.simulator.layout
    return find_input_disturbance(
        layout, fit.theta, squares.reading_residual(fit.theta), squares.data.ok
    )


def _match_simulated_fits(
    fit: PlayFit, noise: float, quantum: float
) -> tuple[Floats, Floats, InputDisturbance]:
    """Match fits of simulated logs to the fit of the log; return parameters, fits,
    disturbance.
    """
    layout, size = fit.model.simulator.layout, fit.squares.data.y.size
    ahead = play_disturbance(fit)
    colour = first_order_noise(RUNS, size, ahead.phi)
    behind = noise * np.random.default_rng(1).standard_normal((RUNS, size))
    left = _excess_power(fit.squares.residual_rms(fit.theta), noise)
    theta, rms = fit.theta, ahead.rms
    for _ in range(ROUNDS):
        w = plant_response(layout, theta, colour)
        w *= rms / max(float(w.std()), 1e-300)
        fits, residuals = _refit_simulated(fit, theta, w, behind, quantum)
        remains = _excess_power(float(np.sqrt(np.mean(residuals**2))), noise)
        rms *= min(math.sqrt(left / remains), MOST)
        theta = _move_numbers(fit, theta, fit.theta - fits.mean(axis=0))
    gain = ahead.at_input / max(ahead.rms, 1e-300)
    return theta, fits, InputDisturbance(rms, ahead.phi, rms * gain)


def _move_numbers(fit: PlayFit, theta: Floats, step: Floats) -> Floats:
    """Return theta moved by a step; only the widths move if the plant would be inadmissible."""
    trial = fit.model.project_to_bounds(theta + step)
    if math.isfinite(fit.squares.total_log_likelihood(trial)):
        return trial
    of_widths = np.where(np.arange(step.size) < fit.model.base, 0.0, step)
    return fit.model.project_to_bounds(theta + of_widths)


def _excess_power(rms: float, noise: float) -> float:
    """Return the mean square of a residual besides white noise."""
    return max(rms**2 - noise**2, 1e-8)


def _refit_simulated(
    fit: PlayFit, theta: Floats, ahead: Floats, behind: Floats, quantum: float
) -> tuple[Floats, Floats]:
    """Return fits of logs simulated with theta (RUNS x P), and their residual rms (RUNS)."""
    model = fit.model
    z = model.output(theta)
    fits, residuals = [], []
    for w, e in zip(ahead, behind, strict=True):
        y = _round_to_quantum(model.noise_free_readings(z + w, theta) + e, quantum)
        squares = LeastSquares(model.with_readings(y), fit.squares.past)
        fits.append(maximise_likelihood(squares, theta, STEPS, 1e-3).theta)
        residuals.append(squares.residual_rms(fits[-1]))
    return np.array(fits), np.array(residuals)


def _round_to_quantum(y: Floats, quantum: float) -> Floats:
    """Round readings to the quantum."""
    return quantum * np.round(y / quantum) if quantum else y
