"""Logs of a servo whose encoder is behind gear play, by a simulator that shares nothing with fits.

A motor with viscous friction, friction that sticks, perhaps a spring and an electrical pole turns
a gear with play. Each sample is cut into `PARTS`, over which motion is integrated by trapezoids;
friction stops what would turn within a part (Karnopp 1985).
"""

from __future__ import annotations

import functools
import math
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.compile import lanes
from undeadzone.util.arrays import Floats

PARTS = 20  # of a sample
LATEST = 3  # samples by which the input is late at most
LIMIT = 6.0  # of the controller, in rms of its feedforward


class Servo(NamedTuple):
    """One servo and how its log is recorded.

    Attributes:
        damping: viscous, as a rate [1/s].
        gain: acceleration of a unit of input.
        spring: stiffness as the square of a rate [1/s^2]; 0: an integrator.
        pole: electrical, as a rate [1/s]; 0: none.
        friction: that sticks, in units of the input.
        gap: of the play.
        quantum: of the encoder; 0: readings are not rounded.
        delay: of the input [samples].
        proportional: gain of the loop; 0: open.
        rate: gain of the loop on the rate.
        load: friction of what the gear pushes, in units of the input.
    """

    damping: float
    gain: float
    spring: float
    pole: float
    friction: float
    gap: float
    quantum: float
    delay: int
    proportional: float
    rate: float
    load: float = 0.0


class Recorded(NamedTuple):
    """A log with its truth.

    Attributes:
        step: sample time [s].
        u: input (N).
        y: readings (N).
        servo: what made it.
        noise: rms of the readings' noise.
        closed: whether a loop was closed.
    """

    step: float
    u: Floats
    y: Floats
    servo: Servo
    noise: float
    closed: bool


@functools.cache
def kernel() -> lanes.Kernel:
    """One sample: the reading and the input that answers to it, then motion until the next."""
    state = ca.SX.sym("s", 6 + LATEST)
    signals = ca.SX.sym("w", 3)
    p = ca.SX.sym("p", 13)
    z, v, current, level, before, slope = ca.vertsplit(state[:6])
    late = ca.vertsplit(state[6:])
    command, torque, noise = ca.vertsplit(signals)
    damping, gain, spring, pole, friction, gap, quantum, delay, kp, kd = ca.vertsplit(p[:10])
    load, closed, step = ca.vertsplit(p[10:])
    y = level + noise
    y = ca.if_else(quantum > 0, quantum * ca.floor(y / ca.fmax(quantum, 1e-12) + 0.5), y)
    slope = slope + 0.2 * ((y - before) / step - slope)
    by_loop = ca.fmax(-LIMIT, ca.fmin(LIMIT, kp * (command - y) - kd * slope))
    u = ca.if_else(closed > 0, by_loop, command)
    queue = [u, *late]
    acting = queue[LATEST]
    for samples in range(LATEST):
        acting = ca.if_else(delay == samples, queue[samples], acting)
    h = step / PARTS
    for _ in range(PARTS):
        current = ca.if_else(pole > 0, current + h * pole * (acting - current), acting)
        push = current + torque - spring * z / gain
        sign = ca.if_else(v == 0, ca.sign(push), ca.sign(v))
        pushes = sign * (z - level) >= gap / 2 * (1 - 1e-9)
        rubs = friction + ca.if_else(pushes, load, 0.0)
        stays = ca.logic_and(v == 0, ca.fabs(push) <= rubs)
        faster = v + h * (gain * (push - sign * rubs) - damping * v)
        turns = ca.logic_and(rubs > 0, faster * sign < 0)
        faster = ca.if_else(ca.logic_or(stays, turns), 0.0, faster)
        z = z + 0.5 * h * (v + faster)
        v = faster
        level = ca.fmax(ca.fmin(level, z + gap / 2), z - gap / 2)
    following = ca.vertcat(z, v, current, level, y, slope, *queue[:-1])
    step_of = ca.Function("servo", [state, signals, p], [following, ca.vertcat(u, y)])
    return lanes.build_kernel(step_of, width=8)


def recorded(
    servo: Servo, step: float, command: Floats, torque: Floats, noise: Floats, closed: bool
) -> tuple[Floats, Floats]:
    """u and y of a servo that begins at rest (N, N).

    Args:
        servo: with its encoder.
        step: sample time [s].
        command: the input, or the reference of a loop (N).
        torque: that disturbs, in units of the input (N).
        noise: of the readings (N).
        closed: whether a loop is closed.
    """
    signals = np.column_stack([command, torque, noise])
    numbers = np.array([*servo, 1.0 * closed, step])
    outputs, _ = lanes.run_lanes(kernel(), np.zeros(6 + LATEST), signals, numbers, threads=1)
    return outputs[0, :, 0], outputs[0, :, 1]


# --- At random


def random_log(seed: int, size: int | None = None) -> Recorded:
    """A log of a servo drawn at random.

    Args:
        seed: of everything.
        size: samples; None: drawn, 1,000 to 12,000.
    """
    draw = np.random.default_rng([77, seed])
    step = log_uniform(draw, 1e-3, 1e-2)
    count = int(log_uniform(draw, 1000, 12000)) if size is None else size
    damping = log_uniform(draw, 2.0, min(30.0, 0.2 / step))
    gain = damping * log_uniform(draw, 0.3, 3.0)
    spring = log_uniform(draw, 3.0, 100.0) if draw.random() < 0.25 else 0.0
    pole = log_uniform(draw, 60.0, min(300.0, 0.8 / step)) if draw.random() < 0.2 else 0.0
    friction = draw.uniform(0.02, 0.2) if draw.random() < 0.6 else 0.0
    closed = bool(draw.random() < 0.4)
    delay = int(draw.integers(0, LATEST + 1))
    command = input_at_random(draw, count)
    if draw.random() < 0.3:
        command = command + draw.uniform(-0.1, 0.1) * (not closed)
    torque = torque_at_random(draw, count, step)
    ideal = Servo(damping, gain, spring, pole, friction, 0.0, 0.0, delay, 0.0, 0.0)
    quiet = np.zeros(count)
    _, free = recorded(ideal, step, command, torque, quiet, False)
    travel = float(np.ptp(free - np.linspace(free[0], free[-1], count)))
    if closed:  # as quick as damping and lateness allow
        late = (delay + 1.5) * step + (1 / pole if pole else 0.0)
        pace = min(0.25 / late, 2 * damping)
        ideal = ideal._replace(
            proportional=pace * damping / gain, rate=0.3 * pace / gain if pace > damping else 0.0
        )
        command = command * (1.5 / ideal.proportional)
        travel = float(np.ptp(command))
    gap = travel * log_uniform(draw, 1e-3, 0.1)
    noisy = draw.random() < 0.22
    quantum = 0.0 if noisy else gap / log_uniform(draw, 0.5, 50.0)
    rms = gap / log_uniform(draw, 3.0, 60.0) if noisy else 0.0
    servo = ideal._replace(gap=gap, quantum=quantum)
    u, y = recorded(servo, step, command, torque, rms * draw.standard_normal(count), closed)
    return Recorded(step, u, y, servo, rms, closed)


def resting_log(seed: int, size: int | None = None) -> Recorded:
    """A log of a servo in a loop that rests at three setpoints, 0 among them, drawn at random.

    Args:
        seed: of everything.
        size: samples; None: 2500.
    """
    draw = np.random.default_rng([5, seed])
    step, count = 5e-3, size or 2500
    damping = log_uniform(draw, 2.0, 20.0)
    gain = damping * log_uniform(draw, 0.3, 3.0)
    friction = draw.uniform(0.02, 0.1) if draw.random() < 0.5 else 0.0
    pace = min(0.25 / (1.5 * step), 2 * damping)
    proportional = pace * damping / gain
    rate = 0.3 * pace / gain if pace > damping else 0.0
    moves = int(draw.integers(12, 30))
    ends = np.cumsum(draw.uniform(0.4, 1.6, moves)) / moves
    levels = np.cumsum(draw.integers(1, 3, moves + 1)) % 3 - 1.0  # never the same twice
    at = np.searchsorted(ends, np.arange(count) / count).clip(0, moves)
    command = levels[at] * 1.5 / proportional
    gap = float(np.ptp(command)) * log_uniform(draw, 5e-3, 0.05)
    quantum = gap / log_uniform(draw, 2.0, 20.0)
    torque = 0.02 * np.cumsum(draw.standard_normal(count)) / math.sqrt(count)
    noisy = draw.random() < 0.3
    rms = gap / log_uniform(draw, 4.0, 40.0) if noisy else 0.0
    quantum = 0.0 if noisy else quantum
    servo = Servo(damping, gain, 0.0, 0.0, friction, gap, quantum, 0, proportional, rate)
    noise = rms * draw.standard_normal(count)
    u, y = recorded(servo, step, command, torque, noise, True)
    return Recorded(step, u, y, servo, rms, True)


def log_uniform(draw: Any, low: float, high: float) -> float:
    """A number whose logarithm is uniform."""
    return float(math.exp(draw.uniform(math.log(low), math.log(high))))


def input_at_random(draw: Any, size: int) -> Floats:
    """Steps, smoothed steps, or sines of an rms of 1 that reverse 12 to 60 times (N)."""
    turns = log_uniform(draw, 12.0, min(60.0, size / 40))
    kind = draw.integers(3)
    t = np.arange(size) / size
    if kind == 2:
        rates = turns / 2 * np.array([1.0, draw.uniform(0.2, 0.5), draw.uniform(1.5, 2.5)])
        sines = np.sin(2 * np.pi * (rates[:, None] * t + draw.random((3, 1))))
        u = np.array([1.0, 0.5, 0.4]) @ sines
    else:
        ends = np.cumsum(draw.uniform(0.4, 1.6, int(turns))) / turns
        levels = draw.uniform(0.4, 1.5, ends.size + 1) * (-1.0) ** np.arange(ends.size + 1)
        u = levels[np.searchsorted(ends, t)]
        if kind == 1:
            wide = max(3, int(size / turns / 4))
            u = np.convolve(np.pad(u, wide, mode="edge"), np.ones(wide) / wide, "same")[wide:-wide]
    return np.asarray(u / np.std(u))


def torque_at_random(draw: Any, size: int, step: float) -> Floats:
    """A disturbing torque of up to .1, white or of a correlation time of .1 s (N)."""
    white = draw.standard_normal(size)
    rms = draw.uniform(0.0, 0.1)
    if draw.random() < 0.5:
        return np.asarray(rms * white)
    keep = math.exp(-step / 0.1)
    slow = np.empty(size)
    now = 0.0
    for k in range(size):
        now = keep * now + math.sqrt(1 - keep * keep) * white[k]
        slow[k] = now
    return rms * slow
