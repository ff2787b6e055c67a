"""The four offsets along a log whose plant was fitted."""

from __future__ import annotations

import math

import numpy as np

from undeadzone.identification.four_offsets import Moving, Offsets, four_offsets
from undeadzone.identification.kalman_fit import KalmanFit
from undeadzone.identification.kalman_likelihood import input_gain
from undeadzone.identification.kalman_step import matrices
from undeadzone.identification.motion import sensing, turns_between, white_noise
from undeadzone.identification.plant_fit import Simulator
from undeadzone.support.arrays import Floats

QUIETEST = 1e-3  # least noise and disturbance that the filter is told, in rms of y
AT_FIRST = 5.0  # standard deviation of a state at first, in rms of y


def along(simulator: Simulator, theta: Floats, rms: float, quantum: float) -> Offsets:
    """The four offsets, with a fitted plant taken for known.

    Args:
        simulator: the plant, with its data.
        theta: its numbers.
        rms: of what the fit leaves.
        quantum: of the readings, scaled.
    """
    data = simulator.data
    z = simulator.z(np.append(theta[: simulator.layout.right], np.zeros(4)))
    longest = turns_between(z) / 8
    how = sensing(data.y, data.ok, data.start, quantum, longest)
    plant = moving(simulator, theta, rms, white_noise(data.y, data.ok, data.start))
    return four_offsets(plant, data.u, data.y, data.ok, data.start, how)


def moving(simulator: Simulator, theta: Floats, rms: float, noise: float) -> Moving:
    """A fitted plant as the filter of the four offsets takes it.

    Args:
        simulator: the plant.
        theta: its numbers.
        rms: of what the fit leaves: white noise at the inputs makes as much of z.
        noise: rms of the readings' white noise.
    """
    layout = simulator.layout
    numbers = np.concatenate([layout.denominator(theta[layout.a]), theta[layout.b], np.zeros(5)])
    F, B, G, H = matrices(layout.n, layout.m, 0, numbers)
    power = 1.0
    if not layout.integrators:
        power = input_gain(theta[layout.a], theta[layout.b], layout.n, 0.0)
    q = max(rms, QUIETEST) / math.sqrt(max(power, 1e-9))
    return Moving(F, B, H[0], q**2 * G, AT_FIRST**2 * np.eye(layout.n), max(noise, QUIETEST))


def moving_with_disturbance(fit: KalmanFit) -> Moving:
    """A plant of (L3), with its disturbance, as the filter of the four offsets takes it."""
    numbers, lane = fit.objective.numbers, fit.objective.lane(fit.p)
    F, B, G, H = matrices(numbers.n, numbers.m, numbers.model, lane)
    q2, r2, *_, first_w, _ = lane[numbers.lane_q :]
    at_first = np.full(F.shape[0], AT_FIRST**2)
    at_first[numbers.n :] = first_w
    return Moving(F, B, H[0], q2 * G, np.diag(at_first), math.sqrt(r2))
