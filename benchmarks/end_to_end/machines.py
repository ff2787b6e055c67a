"""Machines of the gallery, simulated in plain NumPy, without the models of the package.

Each has a log, a measurement at the bench as a person makes it (weights, a dial gauge, a command
that is raised until something moves), and work to do with and without a correction.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import lfilter

from benchmarks.identify.logs.strangers import zone
from benchmarks.identify.logs.valves import Process, run_loop
from undeadzone.util.arrays import Floats

ZONE, GAP = (0.8, 0.5), 0.8  # of the load cell [N], of the two encoders [deg]
BAND = (31.0, 22.0)  # of the speed controller, from 1500 us [us]
LOST, STAR = 9.0, 720.0  # of the hobby servo [us], of the mount [ms of pulses]
TURN = 0.09  # of the hobby servo's horn in a microsecond [deg]
SKY = 0.0075  # motion of the star in a millisecond of pulses [arcsec]
DEAD_BAND = 5.0  # of the valve [% of OP]
LOOP = Process((0.9, 0.0), 0.2, 2, 0.4, 12.0, 0.0)  # flow behind the valve, and its PI controller

Correct = Callable[[float], float]
Measured = tuple["Bench", ...]


class Bench(NamedTuple):
    """Width that a person measures at the machine.

    Attributes:
        value: of the width.
        error: two standard errors of it, or the step of the command that was raised.
    """

    value: float
    error: float


class Case(NamedTuple):
    """A machine, its log and its tests.

    Attributes:
        title: of its row.
        columns: of its log.
        unit: of the width.
        error_unit: of the error at work.
        record: returns the log (N x columns) of a generator.
        measure: returns the widths (right, left) or the gap, measured at the bench.
        use: returns the rms error of the machine at work with a correction.
        options: of `identify`.
    """

    title: str
    columns: str
    unit: str
    error_unit: str
    record: Callable[[np.random.Generator], Floats]
    measure: Callable[[np.random.Generator], Measured]
    use: Callable[[np.random.Generator, Correct], float]
    options: tuple[str, ...] = ()


def rms(error: Any) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(error))))


def follow_with_gap(u: Floats, gap: float) -> Floats:
    """Return the position of a part that a driver at u moves through a gap (N)."""
    position, y = float(u[0]), np.empty_like(u)
    for k, driver in enumerate(u):
        position = min(max(position, driver - gap / 2), driver + gap / 2)
        y[k] = position
    return y


def hold_levels(rng: np.random.Generator, count: int, hold: int, size: float) -> Floats:
    """Return random levels between -size and size, each held for some samples (count)."""
    return np.repeat(rng.uniform(-size, size, -(-count // hold)), hold)[:count]


# --- Load cell


def swing(force: Floats, step: float) -> Floats:
    """Return the force in a beam of 1 Hz, damping ratio 0.4, in semi-implicit steps (N)."""
    fine, omega, z, v = 50, 6.0, 0.0, 0.0
    found = np.empty_like(force)
    for k, pull in enumerate(force):
        found[k] = z
        for _ in range(fine):
            v += step / fine * (omega**2 * (pull - z) - 0.8 * omega * v)
            z += step / fine * v
    return found


def record_cell(rng: np.random.Generator) -> Floats:
    """Return two minutes of force command and reading at 50 Hz."""
    force = hold_levels(rng, 6000, 60, 6.0)
    y = zone(swing(force, 0.02), *ZONE) + 0.02 * rng.standard_normal(6000)
    return np.column_stack([0.02 * np.arange(6000), force, y])


def weigh(rng: np.random.Generator) -> Measured:
    """Return both widths from 20 known weights a side, by a straight line through each."""
    found = []
    for side, width in zip((1, -1), ZONE, strict=True):
        weights = np.linspace(1.5, 6.0, 20)
        y = weights - width + 0.02 * rng.standard_normal(20)
        (slope, level), V = np.polyfit(side * weights, side * y, 1, cov=True)
        found.append(Bench(float(-side * level / slope), 2 * float(np.sqrt(V[1, 1]) / slope)))
    return tuple(found)


def weigh_at_work(rng: np.random.Generator, correct: Correct) -> float:
    """Return the rms error of the corrected reading of a load that moves [N]."""
    z = swing(hold_levels(rng, 3000, 60, 6.0), 0.02)
    y = zone(z, *ZONE) + 0.02 * rng.standard_normal(3000)
    return rms([correct(float(one)) for one in y] - z)


# --- Speed controller of a motor, driven by pulses


def record_speed(rng: np.random.Generator) -> Floats:
    """Return a minute of pulses, from 1500 us [us], and speed [rpm] at 50 Hz."""
    pulse = np.round(hold_levels(rng, 3000, 40, 200.0))
    keep = np.exp(-0.02 / 0.15)
    rpm = lfilter([0.0, 1.0 - keep], [1.0, -keep], 0.4 * zone(pulse, *BAND))
    return np.column_stack([0.02 * np.arange(3000), pulse, rpm + 0.4 * rng.standard_normal(3000)])


def raise_until_it_turns(rng: np.random.Generator) -> Measured:
    """Return both edges [us]: by 1 us more until the mean speed of 50 readings is 3 std from 0."""
    edges = []
    for side in (1, -1):
        pulse, threshold = 0.0, 3 * 0.4 / np.sqrt(50)
        while abs(0.4 * zone(side * pulse, *BAND) + threshold / 3 * rng.normal()) < threshold:
            pulse += 1.0
        edges.append(Bench(pulse, 1.0))
    return tuple(edges)


def turn_at_work(_: np.random.Generator, correct: Correct) -> float:
    """Return the rms error of the static speed at commanded speeds of 60 rpm and less [rpm]."""
    reference = 60.0 * np.sin(0.05 * np.arange(1000))
    pulses = np.array([correct(float(one)) for one in reference / 0.4])
    return rms(0.4 * zone(pulses, *BAND) - reference)


# --- Two positions


def record_encoders(rng: np.random.Generator) -> Floats:
    """Return two minutes of both encoders [deg], 0.01 and 0.02 deg a count, at 20 Hz."""
    t = 0.05 * np.arange(2400)
    motor = 40.0 * np.sin(0.19 * t) + 15.0 * np.sin(0.69 * t)
    joint = follow_with_gap(motor, GAP) + 0.01 * rng.standard_normal(2400)
    return np.column_stack([t, np.round(motor / 0.01) * 0.01, np.round(joint / 0.02) * 0.02])


def record_servo(rng: np.random.Generator) -> Floats:
    """Return 150 photographs of a servo's horn at rest: pulse [us] and angle [deg]."""
    pulse = np.round(rng.uniform(-400.0, 400.0, 150))
    horn = TURN * follow_with_gap(pulse, LOST) + 0.05 * rng.standard_normal(150)
    return np.column_stack([2.0 * np.arange(150), pulse, horn])


def record_mount(rng: np.random.Generator) -> Floats:
    """Return five minutes of guiding: time, pulses in all [ms], star [arcsec], irregular."""
    t = np.cumsum(rng.uniform(0.7, 1.5, 300))
    pulses = np.cumsum(hold_levels(rng, 300, 12, 700.0))
    star = SKY * follow_with_gap(pulses, STAR) + 0.15 * rng.standard_normal(300)
    return np.column_stack([t, pulses, star])


def approach_from_both_sides(
    gap: float, noise: float, unit: float = 1.0
) -> Callable[[np.random.Generator], Measured]:
    """Return the measurement of a gap: 20 positions, each from above and from below.

    Args:
        gap: in units of the input.
        noise: rms of a reading of the output.
        unit: of output for one of the input.
    """

    def measure(rng: np.random.Generator) -> Measured:
        """Return the mean difference of both approaches."""
        apart = (gap * unit + noise * np.sqrt(2) * rng.standard_normal(20)) / unit
        return (Bench(float(apart.mean()), 2 * float(apart.std(ddof=1)) / np.sqrt(20)),)

    return measure


def move_at_work(
    gap: float, size: float, unit: float = 1.0
) -> Callable[[np.random.Generator, Correct], float]:
    """Return the work of a drive with a gap: the rms error along a path that turns round.

    Args:
        gap: in units of the input.
        size: of the path, likewise.
        unit: of output for one of the input.
    """

    def use(_: np.random.Generator, correct: Correct) -> float:
        """Return the rms of position less command, the constant offset of one flank apart."""
        reference = size * np.sin(0.02 * np.arange(1500))
        reference = reference + 0.4 * size * np.sin(0.071 * np.arange(1500))
        driver = np.array([correct(float(one)) for one in reference])
        error = (follow_with_gap(driver, gap) - reference)[300:]
        return unit * rms(error - np.mean(error))

    return use


# --- Valve in a control loop


class Valve:
    """A valve with a dead band, whose position is 50 % at first."""

    def __init__(self, correct: Correct) -> None:
        self.correct, self.position = correct, 50.0

    def __call__(self, op: float) -> float:
        corrected = self.correct(op)
        self.position = min(
            max(self.position, corrected - DEAD_BAND / 2), corrected + DEAD_BAND / 2
        )
        return self.position


def record_valve(rng: np.random.Generator) -> Floats:
    """Return 100 minutes of a flow loop, one sample a second: OP, PV, SP [%]."""
    set_point = 50.0 + hold_levels(rng, 6000, 300, 8.0)
    op, pv = run_loop(LOOP, Valve(float), set_point, 0.02, 0.05, np.zeros(6000), rng)
    return np.column_stack([np.arange(6000), op, pv, set_point])


def stroke(rng: np.random.Generator) -> Measured:
    """Return the dead band [%]: in manual, OP by 0.1 up until the flow moves, then down again."""
    valve, edges = Valve(float), []
    valve(60.0)
    for side in (-1, 1):
        op = start = valve.position + side * -DEAD_BAND / 2  # in contact with the other flank
        rest = valve.position
        while abs(valve(op) - rest + 0.02 / np.sqrt(50) * rng.normal()) < 0.02:
            op += side * 0.1
        edges.append(abs(op - start))
        valve(op + side * 5.0)
    return (Bench(float(np.mean(edges)), 0.1),)


def control_at_work(rng: np.random.Generator, correct: Correct) -> float:
    """Return the rms of SP - PV at one set point, 40 minutes [%]."""
    set_point = np.full(3000, 50.0)
    _, pv = run_loop(LOOP, Valve(correct), set_point, 0.02, 0.05, np.zeros(3000), rng)
    return rms((pv - set_point)[600:])


CASES = {
    "load_cell": Case(
        "load cell, dead zone of its amplifier",
        "t,force_command,reading",
        "N",
        "N",
        record_cell,
        weigh,
        weigh_at_work,
    ),
    "speed_controller": Case(
        "motor controller driven by pulses",
        "t,pulse_us,rpm",
        "us",
        "rpm",
        record_speed,
        raise_until_it_turns,
        turn_at_work,
    ),
    "hobby_servo": Case(
        "hobby servo, photographs of its horn",
        "t,target_us,camera_deg",
        "us",
        "deg",
        record_servo,
        approach_from_both_sides(LOST, 0.05, TURN),
        move_at_work(LOST, 300.0, TURN),
    ),
    "two_encoders": Case(
        "encoders of motor and joint",
        "t,motor_deg,joint_deg",
        "deg",
        "deg",
        record_encoders,
        approach_from_both_sides(GAP, 0.01),
        move_at_work(GAP, 40.0),
    ),
    "mount": Case(
        "telescope mount, pulses and star",
        "t,pulses_ms,star_arcsec",
        "ms",
        "arcsec",
        record_mount,
        approach_from_both_sides(STAR, 0.15, SKY),
        move_at_work(STAR, 4000.0, SKY),
    ),
    "valve": Case(
        "valve in a flow loop",
        "t,OP,PV,SP",
        "% of OP",
        "%",
        record_valve,
        stroke,
        control_at_work,
    ),
}
