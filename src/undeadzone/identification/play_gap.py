"""Gaps with intervals: least squares, corrected by what it makes of logs that are simulated.

Noise behind a play leaves least squares consistent. A disturbance ahead of it does not: it makes
more turns, and the gap comes out too small. So logs with the plant, the gap and the disturbance of
the fit are simulated and fitted in the same way, and the numbers are moved until the mean of these
fits is the fit of the log (indirect inference: Gourieroux, Monfort and Renault 1993). The spread of
the fits is a second opinion on the interval. Where each change of the readings shows motion, (L4)
finds the gap, and simulated logs show the little bias that it has.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from undeadzone.identification.ahead import Ahead, disturbance_ahead, shaped, white
from undeadzone.identification.intervals import Interval
from undeadzone.identification.long_run import quantile
from undeadzone.identification.motion import Sensing, sensing, white_noise
from undeadzone.identification.play_likelihood import (
    TickFit,
    disturbance_of,
    fit_ticks,
    simulated,
    ticks_of,
)
from undeadzone.identification.play_model import PlayFit, PlayModel
from undeadzone.support.arrays import Floats

RUNS = 24
ROUNDS = 3
STEPS = 8
MOST = 2.0  # factor of the disturbance in a round
STRONGEST = 0.2  # rms of a disturbance ahead, in rms of y, above which no gap is given
STRONGEST_OF_BOTH = 0.15  # the same where a dead zone follows, which makes y smaller
FINEST = 2e-4  # rms of y: no interval is narrower

ROWS = {
    "right": (1.0, 0.0, 0.0, 0.0),
    "left": (0.0, 1.0, 0.0, 0.0),
    "width": (1.0, 1.0, 0.0, 0.0),
    "centre": (0.5, -0.5, 0.0, 0.0),
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

    @property
    def model(self) -> PlayModel:
        """The model that was fitted."""
        return self.fit.model


def find_gap(
    fit: PlayFit, others: list[PlayFit], quantum: float, advance: Callable[[int], None]
) -> Gap:
    """The numbers of a play with their intervals.

    Args:
        fit: least squares.
        others: the same of other orders, without a dead zone.
        quantum: of the readings, scaled; 0: none.
        advance: called with the number of steps just done.

    Returns:
        Corrected numbers; of an integrating plant, whose disturbances add up, those of the fit.
    """
    model, theta = fit.model, fit.theta
    noise = noise_of(model, quantum)
    spread = model.spread(theta)
    halves = {name: spread.half_width(model.direction(*row)) for name, row in ROWS.items()}
    count = model.simulator.layout.b.stop
    if model.simulator.layout.integrators:
        advance(1)
        intervals = _intervals(theta, model, halves)
        return Gap(fit, theta, intervals, spread.V[:count, :count], None, noise, True)
    how = None if model.zone else ticks_of(model.data, quantum)
    if how is not None and (ticks := fit_ticks([fit, *others], how)) is not None:
        gap = _of_ticks(ticks, how)
        advance(1)
        return gap
    ahead = disturbance_ahead(model.simulator.layout, theta, model.residual(theta), model.data.ok)
    moved, fits, ahead = _matched(fit, noise, quantum, ahead)
    advance(1)
    scatter = np.cov(fits.T)
    for name, row in ROWS.items():
        weights = np.zeros(model.size)
        weights[model.base :] = row
        std = math.sqrt(max(float(weights @ scatter @ weights), 0.0) * (1 + 1 / RUNS))
        own = max(halves[name], quantile(RUNS - 1) * std)
        halves[name] = math.hypot(own, float(weights @ (moved - theta)))
    intervals = _intervals(moved, model, halves)
    most = STRONGEST_OF_BOTH if model.zone else STRONGEST
    return Gap(fit, moved, intervals, scatter[:count, :count], ahead, noise, ahead.rms < most)


def _of_ticks(fit: TickFit, how: Sensing) -> Gap:
    """The numbers by (L4), corrected by what it makes of simulated logs."""
    model, kalman = fit.play.model, fit.kalman
    found = simulated(fit, how, RUNS)
    moved = fit.theta
    bias = found.mean(axis=0) - moved[model.base : model.base + 2]
    moved[model.base : model.base + 2] -= bias
    moved = model.project(moved)
    spread = kalman.objective.spread(kalman.p)
    halves = dict.fromkeys(ROWS, 0.0)
    for name in ("right", "left", "width", "centre"):
        row = np.array(ROWS[name][:2])
        std = float(np.std(found @ row, ddof=1)) * math.sqrt(1 + 1 / RUNS)
        own = max(spread.half_width(kalman.direction(*row)), quantile(RUNS - 1) * std)
        halves[name] = math.hypot(own, float(row @ bias))
    intervals = _intervals(moved, model, halves)
    count = model.simulator.layout.b.stop
    ahead = disturbance_of(kalman)
    V, sure = spread.V[:count, :count], ahead.rms < STRONGEST
    return Gap(fit.play, moved, intervals, V, ahead, 0.0, sure)


def noise_of(model: PlayModel, quantum: float) -> float:
    """rms of the white noise of the readings besides rounding, scaled."""
    data = model.data
    if not sensing(data.y, data.ok, data.start, quantum).noise:
        return 0.0
    rms = white_noise(data.y, data.ok, data.start)
    return math.sqrt(max(rms**2 - quantum**2 / 12, 0.0))


def _matched(
    fit: PlayFit, noise: float, quantum: float, ahead: Ahead
) -> tuple[Floats, Floats, Ahead]:
    """Numbers whose simulated logs are fitted as the log was, those fits, and the disturbance."""
    model = fit.model
    layout = model.simulator.layout
    size = model.data.y.size
    colour = white(RUNS, size, ahead.phi)
    behind = noise * np.random.default_rng(1).standard_normal((RUNS, size))
    left = _unexplained(model.rms(fit.theta), noise)
    theta, rms = fit.theta, ahead.rms
    for _ in range(ROUNDS):
        w = shaped(layout, theta, colour)
        w *= rms / max(float(w.std()), 1e-300)
        fits, residuals = _refitted(model, theta, w, behind, quantum)
        remains = _unexplained(float(np.sqrt(np.mean(residuals**2))), noise)
        rms *= min(math.sqrt(left / remains), MOST)
        theta = _moved(model, theta, fit.theta - fits.mean(axis=0))
    gain = ahead.at_input / max(ahead.rms, 1e-300)
    return theta, fits, Ahead(rms, ahead.phi, rms * gain)


def _moved(model: PlayModel, theta: Floats, step: Floats) -> Floats:
    """theta moved by a step; the widths alone where the plant would leave what is admissible."""
    trial = model.project(theta + step)
    if math.isfinite(model.value(trial)):
        return trial
    of_widths = np.where(np.arange(step.size) < model.base, 0.0, step)
    return model.project(theta + of_widths)


def _unexplained(rms: float, noise: float) -> float:
    """The mean square of a residual besides white noise."""
    return max(rms**2 - noise**2, 1e-8)


def _refitted(
    model: PlayModel, theta: Floats, ahead: Floats, behind: Floats, quantum: float
) -> tuple[Floats, Floats]:
    """Fits of logs simulated with theta (RUNS x P), and the rms of what each leaves (RUNS)."""
    z = model.z(theta)
    fits, residuals = [], []
    for w, e in zip(ahead, behind, strict=True):
        y = model.readings(z + w, theta) + e
        if quantum:
            y = quantum * np.round(y / quantum)
        copy = model.of_readings(y)
        top = copy.climbed(theta, STEPS, 1e-3)
        fits.append(top.theta)
        residuals.append(copy.rms(top.theta))
    return np.array(fits), np.array(residuals)


def _intervals(theta: Floats, model: PlayModel, halves: dict[str, float]) -> dict[str, Interval]:
    """Values with their half intervals."""
    intervals = {}
    for name, row in ROWS.items():
        value = float(np.dot(row, theta[model.base :]))
        half = math.hypot(halves[name], FINEST)
        intervals[name] = Interval(value, value - half, value + half)
    return intervals
