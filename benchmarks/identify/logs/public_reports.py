"""Logs rebuilt after 25 kinds of public reports: what people measured, with the names they gave.

Thirteen are of two positions and motors (`logs.lost_motion`); the others are drives, sensors,
loops and machines in order. Every number is drawn by a seed.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.signal import lfilter

import undeadzone as uz
from benchmarks.identify.logs.lost_motion import KINDS as MOTIONS
from benchmarks.identify.logs.lost_motion import Floats
from benchmarks.identify.logs.servo import Servo, input_at_random, recorded
from benchmarks.identify.logs.strangers import steps, zone
from benchmarks.identify.logs.valves import make
from undeadzone_identify.results.assemble import WITHHELD


class Report(NamedTuple):
    """Log of a report with its truth.

    Attributes:
        columns: by their titles with units.
        right: verdicts that are right.
        width: of the zone, gap or stick band; None: there is none, or nothing tells it.
    """

    columns: dict[str, Floats]
    right: tuple[str, ...]
    width: float | None = None


def _lagged(u: Floats, step: float, lag: float) -> Floats:
    """Return u behind a lag of first order and a sample (N)."""
    keep = float(np.exp(-step / lag))
    return np.asarray(lfilter([0.0, 1 - keep], [1.0, -keep], u))


def driver_by_stairs(rng: np.random.Generator) -> Report:
    """A motor behind a driver that passes nothing below 2 V: staircase, speed in steps of .5."""
    levels = [0, 0.5, 1, 1.5, 2, 0, -0.5, -1, -1.5, -2, 0, 2, 4, 6, 8, 8.8, 0, -2, -4, -6, -8, -8.8]
    u, step = np.repeat(np.array(levels, float), 150), 0.02
    right, left = rng.uniform(1.5, 2.5, 2)
    speed = _lagged(35 * zone(u, right, left), step, 0.28)
    y = 0.5 * np.round((speed + 1.2 * rng.standard_normal(u.size) * (speed != 0)) / 0.5)
    columns = {"t [s]": step * np.arange(u.size), "voltage [V]": u, "speed [rpm]": y}
    return Report(columns, ("input_zone",), right + left)


def duty_and_speed(rng: np.random.Generator) -> Report:
    """A motor by duty cycle, logged in milliseconds by a microcontroller with a waiting loop."""
    size, right, left = 1500, rng.uniform(20, 60), rng.uniform(20, 60)
    t = np.cumsum(0.02 + 0.001 * rng.integers(0, 2, size))
    u = np.round(steps(rng, size, 40, -255, 255))
    speed = _lagged(1.8 * zone(u, right, left), 0.0205, 0.15) + 2 * rng.standard_normal(size)
    columns = {"millis": np.round(1e3 * t), "pwm": u, "rpm": np.round(speed)}
    return Report(columns, ("input_zone",), right + left)


def pump(rng: np.random.Generator) -> Report:
    """A pump whose flow goes with u |u|, and no zone anywhere."""
    size = 1200
    u = lfilter([1.0], [1.0, -0.9], rng.standard_normal(size))
    flow = _lagged(u * np.abs(u), 0.1, 1.2)
    y = flow / flow.std() + 0.02 * rng.standard_normal(size)
    return Report({"time": 0.1 * np.arange(size), "voltage": u, "flow": y}, ("input_curve",))


def averaging_sensor(rng: np.random.Generator) -> Report:
    """A zone in a sensor whose readings are means of five."""
    u = steps(rng, 1200, 40, -1, 1)
    z = _lagged(u, 0.1, 2.0)
    right, left = rng.uniform(0.3, 0.6, 2)
    read = zone(z / z.std(), right, left) + 0.02 * rng.standard_normal(u.size)
    y = lfilter(np.ones(5) / 5, [1.0], read)
    columns = {"time [s]": 0.1 * np.arange(u.size), "input": u, "reading": y}
    return Report(columns, ("filtered_zone", "dead_zone"), right + left)


def flow_cut_off(rng: np.random.Generator) -> Report:
    """A flow meter that reads 0 below its cut-off."""
    u, edge = steps(rng, 2000, 25, 0, 60), rng.uniform(1.2, 2.4)
    z = 0.12 * _lagged(u, 1.0, 6.0) + 0.03 * rng.standard_normal(u.size)
    y = np.where(z > edge, np.round(z, 2), 0.0)
    columns = {"t": 1.0 * np.arange(u.size), "valve [%]": u, "flow [l/min]": y}
    return Report(columns, ("jump",))


def load_cell(rng: np.random.Generator) -> Report:
    """A load cell of second order that shows nothing of small forces."""
    size, step, k = 4000, 0.002, 0
    force = np.zeros(size)
    while k < size:
        more = int(rng.integers(50, 400))
        force[k : k + more] = rng.normal(0, 3)
        k += more
    x, v, z = 0.0, 0.0, np.empty(size)
    for k in range(size):
        for _ in range(10):
            v += step / 10 * (-6 * v - 60 * x + 60 * force[k] + 4 * rng.standard_normal())
            x += step / 10 * v
        z[k] = x
    right, left = rng.uniform(0.4, 1.0, 2)
    columns = {"time": step * np.arange(size), "force command": force}
    columns["force measured"] = 0.002 * np.round(zone(z, right, left) / 0.002)
    return Report(columns, ("dead_zone",), right + left)


def loop_of(cause: str, right: tuple[str, ...]) -> Callable[[np.random.Generator], Report]:
    """A control loop as a historian exports it."""

    def one(rng: np.random.Generator) -> Report:
        loop = make(int(rng.integers(1000, 10000)), cause, 1200)
        t = 1.0 * np.arange(loop.op.size)
        columns = {"time": t, "OP": loop.op, "PV": loop.pv, "SP": loop.sp}
        return Report(columns, right, loop.stick or None)

    return one


def geared_motor(rng: np.random.Generator) -> Report:
    """A motor by its current, an encoder with ticks behind the gap."""
    size, step = 2000, 0.005
    servo = Servo(6.0, 8.0, 0.0, 0.0, 0.12, float(rng.uniform(0.02, 0.06)), 0.002, 1, 0.0, 0.0)
    u, torque = input_at_random(rng, size), 0.03 * rng.standard_normal(size)
    u, y = recorded(servo, step, u, torque, np.zeros(size), False)
    columns = {"t [s]": step * np.arange(size), "current [A]": u, "encoder [rad]": y}
    return Report(columns, ("play",), servo.gap)


def oven(rng: np.random.Generator) -> Report:
    """An oven in order: a linear plant, a thermometer with noise."""
    u = steps(rng, 1500, 60, 0, 100)
    y = 20 + 1.5 * _lagged(u, 2.0, 60.0) + 0.1 * rng.standard_normal(u.size)
    columns = {"time [s]": 2.0 * np.arange(u.size), "heater [%]": u, "temperature [degC]": y}
    return Report(columns, ("none", "operating_point"))


def _of_motion(name: str) -> Callable[[np.random.Generator], Report]:
    """Return the maker of a log of two positions or of a motor."""

    def one(rng: np.random.Generator) -> Report:
        log = MOTIONS[name](rng)
        return Report(log.columns, log.right, log.lost)

    return one


KINDS: dict[str, Callable[[np.random.Generator], Report]] = {
    **{name: _of_motion(name) for name in MOTIONS},
    "driver, by stairs": driver_by_stairs,
    "duty and speed": duty_and_speed,
    "pump, u |u|": pump,
    "sensor that averages": averaging_sensor,
    "flow cut-off": flow_cut_off,
    "load cell": load_cell,
    "loop, valve sticks": loop_of("stiction", ("stiction", "input_play")),
    "loop, valve with play": loop_of("dead band", ("stiction", "input_play")),
    "loop, from outside": loop_of("external", ("external",)),
    "loop, tuned too tightly": loop_of("tight tuning", ("tight_tuning",)),
    "geared motor": geared_motor,
    "oven in order": oven,
}


def judge_report(report: Report, path: Path) -> tuple[str, bool | None]:
    """Return whether the name is right, withheld or wrong without options, and its interval holds.

    Args:
        report: the log with its truth.
        path: where the file goes.
    """
    pd.DataFrame(report.columns).to_csv(path, index=False)
    try:
        found = uz.identify(str(path))
    except uz.InputError:
        return "withheld", None
    gap = found.answer.gap if isinstance(found, uz.IdentifiedMotion) else found.width
    if found.verdict not in report.right:
        is_named = found.verdict not in WITHHELD
        return "wrong" if is_named else "withheld", None
    if gap is None or report.width is None:
        return "right", None
    return "right", bool(gap.low <= report.width <= gap.high)
