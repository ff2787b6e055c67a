"""Logs simulated with a fit: what the predictor makes of a gap that is known.

Ticks that come early are heard with little variance, so they weigh more, and a torque that nobody
knows makes the gap a little too small. Logs with the plant, gap, torque and encoder of the fit show
by how much, and how far the gap scatters.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache

import casadi as ca
import numpy as np
from scipy.signal import lfilter

from undeadzone.compile import lanes
from undeadzone.identification.servo import predictor, sampled
from undeadzone.identification.servo.heard import Heard, changes
from undeadzone.identification.servo.likelihood import Likelihood, Servo
from undeadzone.identification.servo.predictor import LATEST, MEAN, NUMBERS
from undeadzone.identification.servo.sampled import GAP, NOISE, SLOW, SLOW_TIME, TORQUE
from undeadzone.support.arrays import Floats

RUNS = 12
STEPS = 8  # of a climb from the fit


@cache
def _kernel() -> lanes.Kernel:
    """A servo and its play, with a torque of each lane's own."""
    state = ca.SX.sym("s", MEAN + 1)
    signals = ca.SX.sym("w", LATEST + 1 + 3)
    numbers = ca.SX.sym("p", len(NUMBERS) + LATEST + 1)
    lane = predictor.Lane(numbers)
    begun, starts, torque = ca.vertsplit(signals[LATEST + 1 :])
    acting = ca.dot(lane.taps, signals[: LATEST + 1])
    contact = predictor.contact_of(lane, state[0], state[1], state[MEAN])
    pushed = lane.offset + torque
    x = predictor.moved(lane, ca.vertsplit(state[:MEAN]), acting, pushed, contact).x
    x = [ca.if_else(starts, first, one) for first, one in zip([begun, 0, 0, 0], x, strict=True)]
    level = ca.if_else(starts, begun, predictor.pulled(lane, state[MEAN], x[0]))
    step = ca.Function("simulated", [state, signals, numbers], [ca.vertcat(*x, level), level])
    own = LATEST + 1 + 2
    return lanes.build(step, exogenous=[own], width=16, fused=True)


def simulated(log: Heard, one: Servo, runs: int = RUNS) -> list[Heard]:
    """Logs of a servo with the log's input.

    Args:
        log: as the predictor hears it.
        one: the servo.
        runs: how many.
    """
    theta, size = one.theta, log.u.size
    draw = np.random.default_rng(5)
    torque = math.exp(theta[TORQUE]) * draw.standard_normal((size, runs))
    keep = math.exp(-log.step / SLOW_TIME)
    white = math.sqrt(1 - keep * keep) * draw.standard_normal((size, runs))
    torque += math.exp(theta[SLOW]) * lfilter([1.0], [1.0, -keep], white, axis=0)
    rows = sampled.lanes_of(theta[None], log.step, log.quantum, log.ticks, False, one.structure.lag)
    signals = np.column_stack([log.signals(log.ok)[:, : LATEST + 1], np.zeros((size, 3))])
    signals[log.start, LATEST + 1] = log.y[log.start]
    signals[log.start, LATEST + 2] = 1.0
    levels, _ = lanes.run(
        _kernel(), np.zeros(MEAN + 1), signals, rows[0], torque[:, None, :], threads=1
    )
    return [_recorded(log, theta, level, draw) for level in levels[:, :, 0]]


def _recorded(log: Heard, theta: Floats, level: Floats, draw: np.random.Generator) -> Heard:
    """Levels as the log's encoder reads them, or with its noise."""
    if not log.ticks:
        return log._replace(y=level + math.exp(theta[NOISE]) * draw.standard_normal(level.size))
    y = log.quantum * np.round(level / log.quantum) if log.quantum else level
    side = changes(y, log.ok, log.start)
    return log._replace(y=y, side=side, boundary=y - side * log.quantum / 2)


def refitted(logs: Sequence[Heard], one: Servo) -> Floats:
    """The gaps that climbs from a servo find in logs (runs)."""
    gaps = []
    for log in logs:
        top = Likelihood(log).climbed([one], STEPS)[0]
        gaps.append(top.theta[GAP])
    return np.array(gaps)
