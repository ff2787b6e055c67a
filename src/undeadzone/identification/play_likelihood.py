"""Gaps behind encoders and exact readings, by the likelihood of ticks and of what holds (L4).

A tick tells the contact and, nearly exactly, z. Between two ticks z stays where none would come:

    l - q / 2 - c_l <= z <= l + q / 2 + c_r,   l the reading, q the quantum.                   (L4)

So the filter of (L3) serves, with the reading that holds as the level of its silence. A disturbance
ahead of the play is part of it, and least squares need no correction. That a bound is heard by mean
and covariance leaves a small bias, which simulated logs show.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from undeadzone.identification.ahead import SETTLED, Ahead, disturbance_ahead, shaped, white
from undeadzone.identification.four_offsets import Moving, four_offsets
from undeadzone.identification.kalman_fit import KalmanFit, climbed
from undeadzone.identification.kalman_likelihood import (
    AT_INPUT,
    AT_OUTPUT,
    QUIETEST,
    WHITE,
    KalmanObjective,
    input_gain,
)
from undeadzone.identification.motion import Sensing, sensing
from undeadzone.identification.objective import Limits
from undeadzone.identification.offsets_along import moving, moving_with_disturbance
from undeadzone.identification.plant_fit import Data, Simulator
from undeadzone.identification.play_model import PlayFit, PlayModel
from undeadzone.support.arrays import Floats

FIRST, LAST, AGAIN = 30, 50, 10  # steps of climbs: with the first ticks, the final ones, simulated


class TickFit(NamedTuple):
    """A play by (L4).

    Attributes:
        play: the fit by least squares of the same order.
        kalman: plant, disturbance, c_r and c_l.
    """

    play: PlayFit
    kalman: KalmanFit

    @property
    def theta(self) -> Floats:
        """The numbers of the play's model; what (L4) does not fit stays."""
        model, numbers = self.play.model, self.kalman.objective.numbers
        theta = self.play.theta.copy()
        theta[: numbers.log_q] = self.kalman.p[: numbers.log_q]
        theta[model.base : model.base + 2] = self.kalman.right, self.kalman.left
        return theta


def ticks_of(data: Data, quantum: float) -> Sensing | None:
    """How the readings show motion, if each change does; None of noisy readings."""
    how = sensing(data.y, data.ok, data.start, quantum)
    return how if how.window == 1 else None


def fit_ticks(plays: list[PlayFit], how: Sensing) -> TickFit | None:
    """The play of least BIC by (L4) over orders and disturbances; None where none can be run.

    Args:
        plays: by least squares, of different orders; the data are those of the first.
        how: readings show motion.
    """
    data = plays[0].model.data
    fits = []
    for play in plays:
        layout = play.model.simulator.layout
        model = PlayModel(Simulator(data, layout.n, layout.integrators))
        fits += _of_order(PlayFit(model, play.theta, play.density), how)
    return min(fits, key=lambda one: one.kalman.bic, default=None)


def _of_order(play: PlayFit, how: Sensing) -> list[TickFit]:
    """(L4) of one order, for the three models of the disturbance."""
    model, theta = play.model, play.theta
    data, layout = model.data, model.simulator.layout
    ahead = disturbance_ahead(layout, theta, model.residual(theta), data.ok)
    heard = ticked(data, moving(model.simulator, theta, ahead.rms, QUIETEST), how)
    first = []
    for kind in (WHITE, AT_INPUT, AT_OUTPUT):
        objective = objective_of(heard, play, kind, how)
        widths = theta[model.base : model.base + 2]
        begun = objective.begun(theta, widths, max(ahead.rms, 2 * QUIETEST), 0.0, ahead.phi)
        if objective.admissible(begun):
            first.append(_fitted(objective, begun, FIRST))
    if not first:
        return []
    best = min(first, key=lambda one: one.bic)
    heard = ticked(data, moving_with_disturbance(best), how)
    fits = []
    for one in first:
        objective = objective_of(heard, play, one.model, how)
        fits.append(TickFit(play, _fitted(objective, one.p, LAST)))
    return fits


def objective_of(heard: Data, play: PlayFit, kind: int, how: Sensing) -> KalmanObjective:
    """(L4) of readings that were heard, for a model of the disturbance."""
    layout = play.model.simulator.layout
    return KalmanObjective(heard, layout, kind, Limits(), how.quantum / 2)


def _fitted(objective: KalmanObjective, p: Floats, steps: int) -> KalmanFit:
    """The top that a climb from p reaches."""
    top = climbed(objective, p, steps)
    return KalmanFit(objective, top.theta, top.value)


def ticked(data: Data, plant: Moving, how: Sensing) -> Data:
    """The readings with their contacts, ticks where z was when they came."""
    offsets = four_offsets(plant, data.u, data.y, data.ok, data.start, how)
    return data._replace(y=np.where(offsets.side != 0, offsets.heard, data.y), side=offsets.side)


def disturbance_of(fit: KalmanFit) -> Ahead:
    """The disturbance of a fit, as first-order noise at the first input."""
    numbers, phi = fit.objective.numbers, fit.phi
    a, b = fit.p[: numbers.moving], fit.p[numbers.moving : numbers.log_q]
    own = fit.q / math.sqrt(max(1 - phi**2, 1e-9))
    first = math.sqrt(input_gain(a, b[: numbers.n], numbers.n, phi))
    if fit.model == AT_OUTPUT:
        return Ahead(own, phi, own / first)
    every = math.sqrt(input_gain(a, b, numbers.n, phi)) if fit.model == WHITE else first
    return Ahead(own * every, phi, own * every / first)


def simulated(fit: TickFit, how: Sensing, runs: int) -> Floats:
    """c_r and c_l that (L4) finds in logs simulated with the fit (runs x 2)."""
    model, theta, kalman = fit.play.model, fit.theta, fit.kalman
    layout, size = model.simulator.layout, model.data.y.size
    ahead = disturbance_of(kalman)
    colour = white(runs, size, ahead.phi)
    at_output = kalman.model == AT_OUTPUT
    w = colour[:, SETTLED:] if at_output else shaped(layout, theta, colour)
    w = w * (ahead.rms / max(float(w.std()), 1e-300))
    plant, z = moving_with_disturbance(kalman), model.z(theta)
    found = []
    for one in w:
        y = model.readings(z + one, theta)
        if how.quantum:
            y = how.quantum * np.round(y / how.quantum)
        heard = ticked(model.of_readings(y).data, plant, how)
        again = _fitted(objective_of(heard, fit.play, kalman.model, how), kalman.p, AGAIN)
        found.append([again.right, again.left])
    return np.array(found)
