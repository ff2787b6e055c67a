"""Logs of lost motion as people record it: two positions, with and without a current, and motors.

Each log is one of a kind with its own sizes, noise and speeds, drawn by a seed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from benchmarks.identify.logs.strangers import dragged, rubbed, steps

Floats = NDArray[np.float64]


class MotionLog(NamedTuple):
    """Log with its truth.

    Attributes:
        columns: by their titles with units.
        right: verdicts that are right.
        lost: motion that is lost at a reversal [u]; None: it is none of two positions.
        gap: of the gears alone [u]; None where nothing tells it apart.
    """

    columns: dict[str, Floats]
    right: tuple[str, ...]
    lost: float | None = None
    gap: float | None = None


def _two_sines(t: Floats, rng: np.random.Generator, sizes: tuple[float, float]) -> Floats:
    """Return slow motion of two tones (N)."""
    first, second = rng.uniform(0, 2 * np.pi, 2)
    fast = sizes[1] * np.sin(2.3 * t + second)
    return np.asarray(sizes[0] * np.sin(0.7 * t + first) + fast)


def axis_at_rest(rng: np.random.Generator) -> MotionLog:
    """An axis that stops at each of 120 targets, where a camera looks."""
    gap, up = float(rng.uniform(0.05, 0.4)), np.arange(0.0, 30.5)
    u = np.concatenate([up, up[-2::-1], up[1:], up[-2::-1]])[:120]
    y = (1 + 2e-3 * rng.standard_normal()) * dragged(u, gap) + 0.004 * rng.standard_normal(u.size)
    return MotionLog({"t [s]": 1.0 * np.arange(u.size), "target [mm]": u, "camera [mm]": y},
                     ("play",), gap)  # fmt: skip


def two_encoders(rng: np.random.Generator) -> MotionLog:
    """Two encoders of 4096 counts a turn, on both sides of a gear."""
    gap, t, count = float(rng.uniform(0.3, 1.5)), 0.01 * np.arange(1500), 360 / 4096
    u = _two_sines(t, rng, (30.0, 12.0))
    motor, joint = (count * np.round(one / count) for one in (u, dragged(u, gap)))
    return MotionLog({"t [s]": t, "motor [deg]": motor, "joint [deg]": joint}, ("play",), gap)


def noisy_and_late(rng: np.random.Generator) -> MotionLog:
    """The same with noise behind the gear, which is read a sample late."""
    gap, t = float(rng.uniform(0.3, 1.5)), 0.01 * np.arange(1500)
    u = _two_sines(t, rng, (30.0, 12.0))
    y = dragged(np.append(u[0], u[:-1]), gap) + 0.03 * rng.standard_normal(u.size)
    return MotionLog({"t [s]": t, "motor [deg]": u, "joint [deg]": y}, ("play",), gap)


def wrong_ratio(rng: np.random.Generator) -> MotionLog:
    """A ratio that is off, and no gap."""
    t = 0.02 * np.arange(800)
    u = 20 * np.sin(0.9 * t + rng.uniform(0, 6))
    y = rng.uniform(0.5, 2) * u + 0.02 * rng.standard_normal(t.size)
    return MotionLog({"t [s]": t, "motor [deg]": u, "joint [deg]": y}, ("none",), 0.0)


def pulses_and_star(rng: np.random.Generator) -> MotionLog:
    """Sums of a mount's pulses, and the star that it follows, at irregular times."""
    gap, size = float(rng.uniform(300, 900)), 400
    t = np.cumsum(rng.uniform(0.7, 1.5, size))
    ways = 200 * np.sign(np.sin(2 * np.pi * np.arange(size) / 60))
    u = np.cumsum(np.round(250 * rng.standard_normal(size) + ways))
    y = 0.0075 * dragged(u, gap) + 0.4 * rng.standard_normal(size)
    return MotionLog({"t [s]": t, "pulses [ms]": u, "star [arcsec]": y}, ("play",), gap)


def axis_on_one_flank(rng: np.random.Generator) -> MotionLog:
    """An axis that its weight holds on one flank, whose gap nothing shows."""
    t = 0.05 * np.arange(600)
    u = 10 * np.sin(0.5 * t + rng.uniform(0, 6))
    y = u - 0.1 + 0.01 * rng.standard_normal(t.size)
    return MotionLog({"t [s]": t, "motor [mm]": u, "axis [mm]": y}, ("none",), 0.0)


def jittered(rng: np.random.Generator) -> MotionLog:
    """Two encoders read by a loop that waits, in milliseconds."""
    gap, t = float(rng.uniform(0.02, 0.1)), np.cumsum(0.01 + rng.exponential(0.004, 900))
    fine = np.arange(0, t[-1], 0.001)

    def moved(times: Floats) -> Floats:
        return np.asarray(np.sin(1.1 * times) + 0.4 * np.sin(2.9 * times + 1))

    y = np.interp(t - 0.008, fine, dragged(moved(fine), gap)) + 0.003 * rng.standard_normal(t.size)
    return MotionLog({"millis": 1e3 * t, "motor [rad]": moved(t), "joint [rad]": y}, ("play",), gap)


def dial_gauge(rng: np.random.Generator) -> MotionLog:
    """Twenty-five readings of a dial gauge, to a hundredth."""
    gap, up = float(rng.uniform(0.05, 0.2)), np.arange(0.0, 6.5)
    u = np.concatenate([up, up[-2::-1], up[1:], up[-2::-1]])
    y = np.round(dragged(u, gap), 2)
    return MotionLog({"t [s]": 10.0 * np.arange(u.size), "goal [mm]": u, "dial [mm]": y},
                     ("play",), gap)  # fmt: skip


def goal_servo(rng: np.random.Generator, current: bool = False) -> MotionLog:
    """A proportional loop with friction and a gap, encoder behind the gap, slow goals."""
    gap, stuck = float(rng.uniform(0.01, 0.05)), float(rng.uniform(0.002, 0.01))
    step, size, rate, damping = 0.005, 4600, 30.0, 1.2
    t = step * np.arange(size)
    u = 0.8 + 0.25 * np.sin(2 * np.pi * 0.33 * t)
    u += 0.06 * np.sin(2 * np.pi * 0.11 * t + rng.uniform(0, 6))

    def push(goal: float, x: float, v: float) -> float:
        return rate**2 * (goal - x) - 2 * damping * rate * v

    motor = rubbed(u, rate**2 * stuck, push, step, 20, float(u[0]))
    y = 1e-4 * np.round(1e4 * dragged(motor, gap))
    columns = {"t [s]": t, "goal [rad]": u, "position [rad]": y}
    if current:
        noise = 0.002 * rng.standard_normal(size)
        columns["current [A]"] = rate**2 * (u - motor) / 2000 + noise
    return MotionLog(columns, ("play",), gap + 2 * stuck, gap if current else None)


def goal_and_current(rng: np.random.Generator) -> MotionLog:
    """The same with the motor's current as a third column."""
    return goal_servo(rng, current=True)


def continuous_servo(rng: np.random.Generator) -> MotionLog:
    """Pulses about 1500 us in, speed out, and a dead band between."""
    size, step = 1800, 0.02
    u = np.round(np.repeat(rng.uniform(1240, 1760, size // 30), 30))
    drive = 0.02 * (np.maximum(u - 1531, 0) + np.minimum(u - 1478, 0))
    y = lfilter([0, step / 0.1], [1, step / 0.1 - 1], drive) + 0.02 * rng.standard_normal(size)
    return MotionLog({"t [s]": step * np.arange(size), "pwm [us]": u, "speed [rad/s]": y},
                     ("input_zone",))  # fmt: skip


def torque_and_friction(rng: np.random.Generator) -> MotionLog:
    """A joint pushed by a torque against friction, on which it sticks; no gap."""
    step, lag, gain = 0.01, 0.12, 2.5
    u = steps(rng, 3000, 35)
    friction = gain * rng.uniform(0.2, 0.45) / lag
    y = rubbed(u, friction, lambda torque, _, v: (gain * torque - v) / lag, step, 50)
    columns = {
        "t [s]": step * np.arange(u.size),
        "torque [Nm]": u,
        "q [rad]": 1e-4 * np.round(1e4 * y),
    }
    return MotionLog(columns, ("friction",))


def linear_motor(rng: np.random.Generator, noise: float = 2e-4) -> MotionLog:
    """Torque and encoder of one inertia with viscous friction: no gap and no Coulomb friction."""
    step, size, inertia = 0.005, 1200, 0.03
    lag = step * float(np.exp(rng.uniform(np.log(5), np.log(500))))
    t = step * np.arange(size)
    u = np.zeros(size)
    for amplitude, rate in ((0.25, 0.7), (0.2, 1.9), (0.15, 3.3)):
        u += amplitude * np.sin(2 * np.pi * rate * t + rng.uniform(0, 6))
    keep = np.exp(-step / lag)
    v = lfilter([0, lag / inertia * (1 - keep)], [1, -keep], u)
    moved = lag * (1 - keep) * v + lag / inertia * (step - lag * (1 - keep)) * u
    q = np.append(0.0, np.cumsum(moved)[:-1])
    columns = {"t [s]": t, "torque [Nm]": u, "q [rad]": q + noise * rng.standard_normal(size)}
    return MotionLog(columns, ("none",))


KINDS: dict[str, Callable[[np.random.Generator], MotionLog]] = {
    "axis at rest, camera": axis_at_rest,
    "two encoders, counts": two_encoders,
    "two encoders, noisy and late": noisy_and_late,
    "two encoders, jittered times": jittered,
    "wrong ratio, no gap": wrong_ratio,
    "pulses and star": pulses_and_star,
    "held on one flank": axis_on_one_flank,
    "dial gauge": dial_gauge,
    "goal and position": goal_servo,
    "goal, position and current": goal_and_current,
    "continuous servo": continuous_servo,
    "torque against friction": torque_and_friction,
    "linear motor": linear_motor,
}
