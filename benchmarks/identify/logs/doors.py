"""Logs as people have them: tables, sweeps, stairs, cut-offs, and effects too small to name."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from benchmarks.identify.logs.strangers import dragged, follow, lags, noisy, steps, walk, zone
from undeadzone.util.arrays import Floats

ANY_LOSS = ("loss", "input loss", "output loss")  # one band, wherever it is
THRESHOLD = (*ANY_LOSS, "input threshold", "output threshold", "low end")
GAPS = ("input reversal", "output reversal")


class Door(NamedTuple):
    """Log with its truth.

    Attributes:
        columns: by their titles.
        effects: those that are right; none: nothing is hidden.
        numbers: of these, by name: lower, upper or right, left, width, gap or level.
        size: the largest effect that hides, in the unit of its end.
    """

    columns: dict[str, Floats]
    effects: tuple[str, ...] = ()
    numbers: dict[str, float] = {}
    size: float = 0.0


def _of_edges(columns: dict[str, Floats], effects: tuple[str, ...], **edges: float) -> Door:
    """Return a log with edges, whose width is their distance."""
    numbers = dict(edges)
    if len(edges) > 1:
        numbers["width"] = edges["upper"] - edges["lower"]
    return Door(columns, effects, numbers, max(map(abs, edges.values())))


def _lag(target: Floats, share: float) -> Floats:
    """Return what follows a target by that share of the distance a sample (N)."""
    return follow(target, lambda at, goal: at + share * (goal - at), 0.0)[1:]


def converter(rng: np.random.Generator) -> Door:
    """Readings of a converter that starts late, a row each, without times."""
    edge = rng.uniform(0.08, 0.2)
    v = np.sort(rng.uniform(0, 3.1, 46)).round(3)
    read = np.maximum(v - edge, 0) * 1240 * (1 - 0.04 * np.maximum(v - 2.6, 0))
    code = np.round(read + 3 * rng.standard_normal(46) * (read > 0))
    return _of_edges({"V": v, "code": code}, THRESHOLD, upper=edge)


def drive_ramps(rng: np.random.Generator) -> Door:
    """Slow ramps of a drivetrain's voltage, both ways."""
    edge, u = rng.uniform(0.5, 1.2), np.r_[np.linspace(0, 5, 900), -np.linspace(0, 5, 900)]
    speed = _lag(9 * zone(u, edge, edge), 0.15)
    y = np.where(np.abs(speed) > 0.05, speed + 0.12 * rng.standard_normal(u.size), 0.0)
    columns = {"Timestamp (s)": 0.02 * np.arange(u.size), "Voltage (V)": u, "Velocity (rad/s)": y}
    return _of_edges(columns, ANY_LOSS, lower=-edge, upper=edge)


def wheel_sweep(rng: np.random.Generator) -> Door:
    """One slow sweep of a wheel's command; it bends at the ends."""
    u = np.arange(-254.0, 255.0)
    low, high, least = rng.uniform(30, 60), rng.uniform(30, 60), rng.uniform(10, 60)
    drive = zone(u, high, low)
    speed = np.sign(drive) * (least + 640 * np.tanh(np.abs(drive) / 150))
    y = np.round((speed + 4 * rng.standard_normal(u.size) * (drive != 0)) / 1.667) * 1.667
    columns = {"time": 1000 * np.arange(u.size), "motorCommand": u, "rpm": y}
    return _of_edges(columns, (*THRESHOLD,), lower=-low, upper=high)


def one_way_stairs(rng: np.random.Generator) -> Door:
    """Stairs of a motor that turns one way only."""
    edge, pwm = rng.uniform(0.04, 0.09), np.clip((np.arange(2500) % 500 // 50) / 10, 0, 0.9)
    speed = _lag(240 * np.maximum(pwm - edge, 0), 0.35)
    read = speed + 2 * rng.standard_normal(2500) * (speed > 0.5)
    columns = {"t": 0.01 * np.arange(2500), "pwm": pwm, "speed [rad/s]": read.round(2)}
    return _of_edges(columns, THRESHOLD, upper=edge)


def input_zone_of_a_valve(rng: np.random.Generator) -> Door:
    """A steering valve in a loop: nothing moves below its edges, and the angle integrates."""
    right, left, size = rng.uniform(30, 60), rng.uniform(30, 60), 3000
    goal, angle = steps(rng, size, 100, -20, 20), 0.0
    u, y = np.empty(size), np.empty(size)
    for k in range(size):
        error = goal[k] - angle
        u[k] = np.clip(round(12 * error + 30 * np.sign(error) * (abs(error) > 0.3)), -255, 255)
        angle += 0.002 * float(zone(u[k : k + 1], right, left)[0])
        y[k] = angle + 0.02 * rng.standard_normal()
    columns = {"time": 0.02 * np.arange(size), "pwm": u, "wheel_angle [deg]": y}
    return Door(columns, ("input loss", "loss"), {"right": right, "left": left}, right)


def offset_wheel(rng: np.random.Generator) -> Door:
    """A wheel whose pulses rest about their middle."""
    half = rng.uniform(3, 7)
    u = np.round(steps(rng, 2000, 25, 20, 80))
    y = _lag(3 * zone(u - 50, half, half), 0.3) + 0.5 * rng.standard_normal(2000)
    columns = {"t": 0.02 * np.arange(2000), "command [%]": u, "speed [rpm]": y}
    return _of_edges(columns, ANY_LOSS, lower=50 - half, upper=50 + half)


def load_flip(rng: np.random.Generator) -> Door:
    """A servo that holds its goal while a load pulls it to either side."""
    gap = rng.uniform(10, 25)
    goals = np.resize(np.repeat([1947.0, 2047, 2147, 2047], [14, 55, 14, 55]), 400)
    side = np.cumprod(np.where(rng.random(400) < 0.06, -1, 1))
    at, out = goals[0], np.empty(400)
    for k in range(400):
        at += np.clip(0.8 * (goals[k] + gap / 2 * side[k] - at), -25, 25)
        out[k] = round(at + 0.4 * rng.standard_normal())
    columns = {"t": 0.1 * np.arange(400), "target pos": goals, "pos": out}
    return Door(columns, ("free play", *GAPS), {"gap": gap}, gap)


def noise_hold(rng: np.random.Generator) -> Door:
    """A stepper in order, whose encoder flickers."""
    goal = np.cumsum(np.where(np.arange(2000) % 150, 0, rng.choice([-400, -200, 200, 400], 2000)))
    y = np.floor(_lag(goal, 0.35) + 0.5 + 0.55 * rng.standard_normal(2000))
    return Door({"time [ms]": 5 * np.arange(2000), "target [counts]": goal, "measured [counts]": y})


def flow_bench(rng: np.random.Generator) -> Door:
    """A flow meter that is cut off below an edge; one sign."""
    edge, u = rng.uniform(0.5, 1.2), steps(rng, 2000, 25, 0, 100)
    z = _lag(0.05 * u, 0.12) + 0.05 * rng.standard_normal(2000)
    columns = {"time": 0.5 * np.arange(2000), "fan_pct": u, "flow": np.where(z > edge, z, 0)}
    return Door(columns, ("output threshold",), {"right": edge}, edge)


def impeller(rng: np.random.Generator) -> Door:
    """An impeller that loses its first flow."""
    edge, u = rng.uniform(0.6, 1.4), steps(rng, 2000, 25, 0, 100)
    z = _lag(0.05 * u, 0.18) + 0.03 * rng.standard_normal(2000)
    y = np.round(np.maximum(z - edge, 0) * 6.6) / 6.6
    columns = {"time": np.arange(2000.0), "valve_pct": u, "flow_lpm": y}
    return Door(columns, ("output loss",), {"right": edge}, edge)


def stepper_threshold(rng: np.random.Generator) -> Door:
    """A drive that passes nothing below a threshold, and all above it."""
    edge, u = rng.uniform(2, 4), steps(rng, 2000, 40, -10, 10).round(1)
    y = _lag(np.where(np.abs(u) >= edge, 20 * u, 0.0), 0.2) + 0.6 * rng.standard_normal(2000)
    columns = {"time [s]": 0.02 * np.arange(2000), "command [V]": u, "speed [rpm]": y}
    return _of_edges(columns, ("input threshold", *ANY_LOSS), lower=-edge, upper=edge)


def static_play(rng: np.random.Generator) -> Door:
    """Two positions with a gap between them, without dynamics."""
    gap, u = rng.uniform(0.2, 0.8), 3 * np.sin(0.02 * np.arange(1500))
    y = dragged(u, gap) + 0.01 * rng.standard_normal(1500)
    columns = {"t": 0.01 * np.arange(1500), "input [deg]": u, "output [deg]": y}
    return Door(columns, GAPS, {"gap": gap}, gap)


def focuser_table(rng: np.random.Generator) -> Door:
    """A focuser's readings up and down, a row each."""
    gap = float(np.round(rng.uniform(80, 250)))
    legs = [np.arange(k % 2 * 6, 7 - 7 * (k % 2) + k % 2, 1 - 2 * (k % 2)) for k in range(6)]
    u = 1000.0 * np.concatenate(legs)
    y = np.round(dragged(u, gap) + 4 * rng.standard_normal(u.size))
    return Door({"command": u, "position": y}, GAPS, {"gap": gap}, gap)


def plain_table(rng: np.random.Generator) -> Door:
    """A calibration with nothing hidden."""
    u = np.linspace(0, 10, 40)
    return Door({"mass [kg]": u, "reading": 812 + 341.5 * u + 1.2 * rng.standard_normal(40)})


def joint_torque(rng: np.random.Generator) -> Door:
    """A joint's torque and speed: friction by its level, and by its speed."""
    level, k = rng.uniform(2, 6), np.arange(3000)
    v = 1.2 * np.sin(0.011 * k) + 0.7 * np.sin(0.0047 * k)
    q = 0.01 * np.cumsum(v)
    torque = level * np.sign(v) + 1.5 * v + 4 * np.sin(q) + 0.4 * rng.standard_normal(3000)
    columns = {"time": 0.01 * k, "torque [Nm]": torque, "velocity [rad/s]": v}
    return Door(columns, ("friction",), {"level": level}, level)


def _small(
    sense: Callable[[Floats, float], Floats], at_input: bool, effects: tuple[str, ...], name: str
) -> Callable[[np.random.Generator], Door]:
    """Return the maker of a log whose effect is near what noise hides."""

    def one(rng: np.random.Generator) -> Door:
        size, u = float(np.exp(rng.uniform(np.log(0.004), np.log(0.08)))), walk(rng)
        y = lags(sense(u, size)) if at_input else sense(lags(u), size)
        columns = {"t": 0.01 * np.arange(u.size), "u": u, "y": noisy(rng, y)}
        return Door(columns, effects, {name: size}, size)

    return one


def _halved(v: Floats, width: float) -> Floats:
    """Return v through a zone of that width."""
    return zone(v, width / 2, width / 2)


KINDS: dict[str, Callable[[np.random.Generator], Door]] = {
    "converter": converter,
    "drive, ramps": drive_ramps,
    "wheel, one sweep": wheel_sweep,
    "one way, stairs": one_way_stairs,
    "steering valve": input_zone_of_a_valve,
    "wheel about an offset": offset_wheel,
    "load flips": load_flip,
    "encoder flickers": noise_hold,
    "flow bench": flow_bench,
    "impeller": impeller,
    "threshold of a drive": stepper_threshold,
    "play without dynamics": static_play,
    "focuser's table": focuser_table,
    "plain table": plain_table,
    "joint's torque": joint_torque,
}
SMALL: dict[str, Callable[[np.random.Generator], Door]] = {
    "small zone of the sensor": _small(_halved, False, ("output loss",), "width"),
    "small zone of the input": _small(_halved, True, ("input loss",), "width"),
    "small play": _small(dragged, False, GAPS, "gap"),
    "nothing hidden": _small(lambda v, _: v, False, (), "width"),
}
