"""Gap of a play with intervals: least squares, corrected by simulated logs.

Least squares are consistent with noise behind a play, but not with a disturbance ahead of it: it
causes more reversals, and the estimated gap is too small. So logs with the plant, the gap and the
disturbance of the fit are simulated and fitted in the same way. The parameters are corrected until
the mean of these fits equals the fit of the log (indirect inference: Gourieroux, Monfort and
Renault 1993). The scatter of the fits is a second estimate of the uncertainty.

References:
    C. Gourieroux, A. Monfort, E. Renault (1993), doi:10.1002/jae.3950080507
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from undeadzone.nonlinearities.sensor import DIRECTIONS, heaviest, quantise
from undeadzone.util.arrays import Floats
from undeadzone_identify.models.elements import PlayFit, PlayModel
from undeadzone_identify.models.estimates import (
    Interval,
    maximise_likelihood,
    student_quantile,
    variance_along,
)
from undeadzone_identify.models.least_squares import LeastSquares
from undeadzone_identify.models.likelihood import root_mean_square
from undeadzone_identify.models.motion import are_exact, white_noise_rms
from undeadzone_identify.models.plant import (
    InputDisturbance,
    RecordData,
    find_input_disturbance,
    first_order_noise,
    plant_response,
)

RUNS = 24  # simulated logs of a round
ROUNDS = 3  # corrections of the parameters
STEPS = 8  # steps of the fit to a simulated log
MOST = 2.0  # largest factor by which a round increases the disturbance
STRONGEST = 0.2  # largest rms of a disturbance ahead for which a gap is reported [rms of y]
STRONGEST_OF_BOTH = 0.15  # the same if a dead zone follows, which makes y smaller
FINEST = 2e-4  # least half interval [rms of y]

# Weights of c_r, c_l, d_r, d_l in each reported quantity.
ROWS: dict[str, tuple[float, ...]] = {
    **DIRECTIONS,
    "zone": (0.0, 0.0, 1.0, 1.0),
    "zone_right": (0.0, 0.0, 1.0, 0.0),
    "zone_left": (0.0, 0.0, 0.0, 1.0),
}


class PlayGap(NamedTuple):
    """Play, and perhaps the dead zone after it, in the scale of the fit.

    Attributes:
        fit: fit of the play.
        theta: its parameters after the correction (P).
        intervals: right, left, width, centre of the play; zone, the width of a dead zone, and
            zone_right, zone_left, its edges if the gap is even.
        V: covariance of the plant's parameters a and b.
        ahead: disturbance of z; None for an integrating plant, for which it is not identified.
        noise: rms of the readings' white noise.
        sure: whether the intervals are valid: the disturbance ahead is weak enough.
    """

    fit: PlayFit
    theta: Floats
    intervals: dict[str, Interval]
    V: Floats
    ahead: InputDisturbance | None
    noise: float
    sure: bool


def find_play_gap(fit: PlayFit, quantum: float, in_loop: bool) -> PlayGap:
    """Find the parameters of a play with their intervals.

    Args:
        fit: fit of least squares.
        quantum: quantum of the readings, scaled; 0: none.
        in_loop: whether feedback makes u depend on the readings. Then the log and the simulated
            logs are fitted by prediction errors, and the difference to simulation errors widens the
            intervals.

    Returns:
        Corrected parameters; those of the fit for an integrating plant, whose z drifts too far for
        a simulation.
    """
    noise = _unrounded_noise_rms(fit.squares.data, quantum)
    layout = fit.model.simulator.layout
    plant = slice(layout.numerators.stop)
    simulation_fit = fit
    own = _own_half_intervals(fit)
    if layout.integrators:
        V = fit.squares.robust_covariance(fit.theta).V[plant, plant]
        intervals = _gap_intervals(fit.theta, fit.model, own)
        return PlayGap(fit, fit.theta, intervals, V, None, noise, True)
    fit = fit.prediction_fit if in_loop else fit
    model = fit.model
    halves = _own_half_intervals(fit)
    corrected, fits, ahead = _match_simulated_fits(fit, noise, quantum)
    scatter = np.cov(fits.T)
    for name, row in ROWS.items():
        weights = np.zeros(model.size)
        weights[model.base :][: len(row)] = row
        std = math.sqrt(variance_along(scatter, weights) * (1 + 1 / RUNS))
        widest = max(halves[name], own[name], student_quantile(RUNS - 1) * std)
        halves[name] = math.hypot(
            widest,
            weights @ (corrected - fit.theta),
            weights @ (simulation_fit.theta - fit.theta),
        )
    intervals = _gap_intervals(corrected, model, halves)
    sure = ahead.rms < (STRONGEST_OF_BOTH if model.zone else STRONGEST)
    return PlayGap(fit, corrected, intervals, scatter[plant, plant], ahead, noise, sure)


def _unrounded_noise_rms(data: RecordData, quantum: float) -> float:
    """Return the rms of the white noise of the readings besides rounding, scaled."""
    if are_exact(data.y, data.ok, data.start):
        return 0.0
    rms = white_noise_rms(data.y, data.ok, data.start)
    return math.sqrt(max(rms**2 - quantum**2 / 12, 0.0))


def _gap_intervals(
    theta: Floats, model: PlayModel, halves: dict[str, float]
) -> dict[str, Interval]:
    """Return the quantities of ROWS with their 95 % intervals.

    Args:
        theta: parameters of the model (P).
        model: the model.
        halves: half intervals of the quantities.
    """
    intervals = {}
    for name, row in ROWS.items():
        half = math.hypot(halves[name], heaviest(row) * FINEST)
        value = float(np.dot(row, theta[model.base :][: len(row)]))
        intervals[name] = Interval.from_half_width(value, half)
    return intervals


def _own_half_intervals(fit: PlayFit) -> dict[str, float]:
    """Return the half intervals of the quantities of ROWS by the robust covariance (I1)."""
    spread = fit.squares.robust_covariance(fit.theta)
    return {name: spread.half_width(fit.model.play_weights(*row)) for name, row in ROWS.items()}


# --- By simulated logs


def _match_simulated_fits(
    fit: PlayFit, noise: float, quantum: float
) -> tuple[Floats, Floats, InputDisturbance]:
    """Correct the parameters until fits of simulated logs equal the fit of the log on average.

    Args:
        fit: fit of the log.
        noise: rms of the white noise of the readings, scaled.
        quantum: quantum of the readings, scaled.

    Returns:
        Corrected parameters (P), the fits of the last round (RUNS x P), and the disturbance.
    """
    layout = fit.model.simulator.layout
    size = fit.squares.data.y.size
    residual = fit.squares.reading_residual(fit.theta)
    ahead = find_input_disturbance(layout, fit.theta, residual, fit.squares.data.ok)
    colour = first_order_noise(RUNS, size, ahead.phi)
    behind = noise * np.random.default_rng(1).standard_normal((RUNS, size))
    target = _excess_power(fit.squares.residual_rms(fit.theta), noise)
    theta = fit.theta
    rms = ahead.rms
    for _ in range(ROUNDS):
        w = plant_response(layout, theta, colour)
        w *= rms / max(float(w.std()), 1e-300)
        fits, residuals = _refit_simulated(fit, theta, w, behind, quantum)
        simulated = _excess_power(root_mean_square(residuals), noise)
        rms *= min(math.sqrt(target / simulated), MOST)
        theta = _add_correction(fit, theta, fit.theta - fits.mean(axis=0))
    gain = ahead.at_input / max(ahead.rms, 1e-300)
    return theta, fits, InputDisturbance(rms, ahead.phi, rms * gain)


def _add_correction(fit: PlayFit, theta: Floats, step: Floats) -> Floats:
    """Return theta + step (P); only widths are changed if the plant would be inadmissible."""
    trial = fit.model.project_to_bounds(theta + step)
    if math.isfinite(fit.squares.total_log_likelihood(trial)):
        return trial
    width_step = np.where(np.arange(step.size) < fit.model.base, 0.0, step)
    return fit.model.project_to_bounds(theta + width_step)


def _excess_power(rms: float, noise: float) -> float:
    """Return the mean square of a residual without that of white noise, at least 1e-8."""
    return max(rms**2 - noise**2, 1e-8)


def _refit_simulated(
    fit: PlayFit, theta: Floats, ahead: Floats, behind: Floats, quantum: float
) -> tuple[Floats, Floats]:
    """Fit simulated logs, starting at the parameters of the simulation.

    Args:
        fit: fit of the log.
        theta: parameters of the simulation (P).
        ahead: disturbances of z (RUNS x N).
        behind: noise of the readings (RUNS x N).
        quantum: quantum of the readings, scaled.

    Returns:
        Parameters of the fits (RUNS x P), and the rms of their residuals (RUNS).
    """
    model = fit.model
    z = model.output(theta)
    fits = []
    residuals = []
    for w, e in zip(ahead, behind, strict=True):
        y = quantise(model.noise_free_readings(z + w, theta) + e, quantum)
        squares = LeastSquares(model.with_readings(y), fit.squares.past)
        fits.append(maximise_likelihood(squares, theta, STEPS, 1e-3).theta)
        residuals.append(squares.residual_rms(fits[-1]))
    return np.array(fits), np.array(residuals)
