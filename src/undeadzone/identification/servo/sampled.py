"""A servo's numbers, and what a lane of the predictor makes of them."""

from __future__ import annotations

import math

import numpy as np

from undeadzone.identification.servo.predictor import LATEST, NUMBERS, SURE
from undeadzone.support.arrays import Floats

# ln p, g, ln p_e, ln k, f, o, c, ln of the rms of white torque, of noise, of slow torque, delay,
# friction of the load
NAMES = (
    *("damping", "gain", "pole", "spring", "friction", "offset", "gap"),
    *("torque", "noise", "slow", "delay", "load"),
)
DAMPING, GAIN, POLE, SPRING, FRICTION, OFFSET, GAP, TORQUE, NOISE, SLOW, DELAY, LOAD = range(12)
SLOW_TIME = 0.5  # correlation time of the slow torque [s]
EARLIEST = -1  # delay of a log whose input was recorded after it had acted [samples]
COARSEST = 0.05  # of a step of the series, in rates
TERMS = 5  # of the series
FINEST = 1e-4  # rms of the readings: quantum of exact ones
AT_FIRST = 2.0  # standard deviation of v at first, in speeds that an input of 1 gives in a while


def discretised(theta: Floats, step: float, lag: bool) -> tuple[Floats, Floats, Floats]:
    """Transitions of (z, v, d, i), of u and torque, and the covariance of a sample.

    Args:
        theta: numbers by `NAMES` (L x P); what is not there is -inf, the pole +inf.
        step: sample time [s].
        lag: whether the plant is z' = -p z + g u, without inertia.

    Returns:
        A (L x 4 x 4), B (L x 4 x 2) of u and of a torque, Q (L x 3 x 3).
    """
    p, g, pole, k = (np.exp(theta[:, DAMPING]), theta[:, GAIN], *np.exp(theta[:, [POLE, SPRING]].T))
    electric = np.isfinite(pole)
    rate = np.where(electric, pole, 0.0)
    A = np.zeros((len(theta), 6, 6))
    row = 0 if lag else 1
    if lag:
        A[:, 0, 0] = -p
    else:
        A[:, 0, 1] = 1.0
        A[:, 1, 0], A[:, 1, 1] = -k, -p
    A[:, row, 2], A[:, row, 5] = g, g
    A[:, row, 3], A[:, row, 4] = np.where(electric, g, 0.0), np.where(electric, 0.0, g)
    A[:, 2, 2] = -1 / SLOW_TIME
    A[:, 3, 3], A[:, 3, 4] = -rate, rate
    white = g**2 * np.exp(2 * theta[:, TORQUE]) * step
    slow = np.exp(2 * theta[:, SLOW]) * 2 / SLOW_TIME
    fastest = float(np.max(p + np.sqrt(k) + rate + 1 / SLOW_TIME))
    halvings = max(0, math.ceil(math.log2(fastest * step / COARSEST)))
    h = step / 2**halvings
    E = np.tile(np.eye(6), (len(theta), 1, 1))
    term = E
    for m in range(1, TERMS + 1):
        term = term @ (A * (h / m))
        E = E + term
    density = np.zeros((len(theta), 3, 3))
    density[:, row, row], density[:, 2, 2] = white, slow
    # Simpson's rule over h
    half = np.eye(3) + A[:, :3, :3] * (h / 2) + A[:, :3, :3] @ A[:, :3, :3] * (h * h / 8)
    whole = half @ half
    middle = half @ density @ half.transpose(0, 2, 1)
    Q = h / 6 * (density + 4 * middle + whole @ density @ whole.transpose(0, 2, 1))
    for _ in range(halvings):
        F = E[:, :3, :3]
        Q = Q + F @ Q @ F.transpose(0, 2, 1)
        E = E @ E
    if lag:  # the rate is that of the last sample
        E[:, 1] = (E[:, 0] - np.eye(6)[0]) / step
        E[:, :, 1] = 0.0
        Q[:, 1, :], Q[:, :, 1] = Q[:, 0, :] / step, Q[:, :, 0] / step
        Q[:, 1, 1] = Q[:, 0, 0] / step**2
    return E[:, :4, :4], E[:, :4, 4:], Q


def lanes_of(
    theta: Floats, step: float, quantum: float, ticks: bool, free: bool, lag: bool
) -> Floats:
    """The numbers of the predictor's lanes (L x numbers).

    Args:
        theta: by `NAMES` (L x P).
        step: sample time [s].
        quantum: of the readings, scaled.
        ticks: whether the readings are ticks; else they are noisy.
        free: whether z is forgotten at reversals.
        lag: whether the plant is of first order.
    """
    A, B, Q = discretised(theta, step, lag)
    rows = np.zeros((len(theta), len(NUMBERS) + LATEST + 1))
    place = {name: k for k, name in enumerate(NUMBERS)}
    for i, name in enumerate(("a00", "a01", "a02", "a03")):
        rows[:, place[name]] = A[:, 0, i]
    for i, name in enumerate(("a10", "a11", "a12", "a13")):
        rows[:, place[name]] = A[:, 1, i]
    rows[:, place["a22"]], rows[:, place["a33"]] = A[:, 2, 2], A[:, 3, 3]
    for i, name in enumerate(("bz", "bv")):
        rows[:, place[name]] = B[:, i, 0]
    rows[:, place["bi"]] = B[:, 3, 0]
    rows[:, place["fz"]], rows[:, place["fv"]] = B[:, 0, 1], B[:, 1, 1]
    for name in ("q00", "q01", "q11", "q02", "q12", "q22"):
        rows[:, place[name]] = Q[:, int(name[1]), int(name[2])]
    quantum = max(quantum, FINEST)
    slow = np.exp(2 * theta[:, SLOW])
    for name, number in (("friction", FRICTION), ("load", LOAD), ("offset", OFFSET), ("gap", GAP)):
        rows[:, place[name]] = theta[:, number]
    rows[:, place["rms"]] = SURE * quantum if ticks else np.exp(theta[:, NOISE])
    rows[:, place["quantum"]] = quantum
    rows[:, place["step"]] = step
    rows[:, place["first_v"]] = AT_FIRST**2 * (theta[:, GAIN] ** 2 / np.exp(2 * theta[:, DAMPING]))
    rows[:, place["first_d"]] = slow
    rows[:, place["free"]] = float(free)
    late = np.clip(theta[:, DELAY] - EARLIEST, 0.0, LATEST)
    whole = np.minimum(late.astype(int), LATEST - 1)
    each = np.arange(len(theta))
    rows[each, len(NUMBERS) + whole] = 1 - (late - whole)
    rows[each, len(NUMBERS) + whole + 1] = late - whole
    return rows
