"""Numbers of scenarios from logs, `fit`: coverage of intervals, flags of true and of wrong models.

FIT_RUNS: truths of each plant (20). FIT_CASES: part of the names of cases (all). FIT_FIRST:
the first seed. Logs are simulated here, by Runge-Kutta steps finer than the model's.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares

import undeadzone as uz
from benchmarks.markdown import head, row
from benchmarks.results import share
from undeadzone.scenario.reader import parse
from undeadzone.util.arrays import Floats
from undeadzone_identify.fitting.estimates import prepare_fit, read_logs
from undeadzone_identify.fitting.free import complete_tables
from undeadzone_identify.fitting.problem import FitProblem, build_model

Generator = np.random.Generator
REST = """
[simulation]
time = "sampled"
step = {step}
substeps = 2
[reference]
kind = "sine"
amplitude = 0.8
frequency = 0.5
[controller]
method = "pd"
[observer]
method = "extended"
right = [0.0, 1.0]
[disturbance]
kind = "random"
rms = {rms}
correlation_time = {lasting}
"""
PENDULUM = """
[plant]
states = ["angle", "rate"]
inputs = ["torque"]
f = ["rate", "-g / l * sin(angle) - damping * rate + torque / (mass * l ** 2)"]
h = ["angle"]
parameters = { g = 9.81, l = 1.0, mass = 1.0, damping = 1.5 }
[sensor]
right = 0.2
left = 0.2
noise_before = NOISE
"""
LINEAR = """
[plant]
transfer_function = {{ numerator = [{gain}], denominator = {denominator} }}
[sensor]
right = 0.3
left = 0.3
noise = {noise}
"""
TANKS = """
[plant]
states = ["h1", "h2"]
inputs = ["pump"]
f = [
  "k * pump - c1 * h1 / sqrt(sqrt(h1 ** 2 + 0.001))",
  "c1 * h1 / sqrt(sqrt(h1 ** 2 + 0.001)) - c2 * h2 / sqrt(sqrt(h2 ** 2 + 0.001))",
]
h = ["h2"]
parameters = { k = 0.04, c1 = 0.08, c2 = 0.08 }
[sensor]
right = 0.15
left = 9.0
noise = 0.004
[actuator]
right = 1.0
left = 0.0
"""
MOTOR = """
[plant]
A = [[-5.0]]
B = [[50.0]]
C = [[1.0]]
[sensor]
right = 0.0
left = 0.0
noise = 0.3
[actuator]
right = 0.5
left = 0.5
"""


class Case(NamedTuple):
    """Scenario with the truth of its free numbers, and logs of that truth.

    Attributes:
        text: of the scenario.
        free: ranges by address.
        truth: of these numbers.
        logs: u and y of each.
    """

    text: str
    free: dict[str, Any]
    truth: Floats
    logs: list[dict[str, Floats]]


def cut(z: Floats, right: float, left: float) -> Floats:
    """Return what a dead zone leaves of z."""
    return np.maximum(z - right, 0) + np.minimum(z + left, 0)


def colour(rng: Generator, count: int, step: float, rms: float, lasting: float) -> Floats:
    """Return a stationary first-order disturbance."""
    memory = np.exp(-step / lasting)
    white = rng.standard_normal(count) * rms
    for k in range(1, count):
        white[k] = memory * white[k - 1] + np.sqrt(1 - memory**2) * white[k]
    return white


def sines(rng: Generator, t: Floats, sizes: Any, frequencies: Any) -> Floats:
    """Return a sum of sines of random phases."""
    phases = rng.uniform(0, 2 * np.pi, len(sizes))
    waves = zip(sizes, frequencies, phases, strict=True)
    return np.asarray(sum(a * np.sin(2 * np.pi * f * t + b) for a, f, b in waves))


def move(change: Callable[[Any, Any], Any], x: Any, u: Floats, step: float, parts: int) -> Floats:
    """Return the states along inputs by Runge-Kutta steps, `parts` for each sample."""
    states = np.empty((len(u), len(x)))
    h = step / parts
    for k, now in enumerate(u):
        states[k] = x
        for _ in range(parts):
            a = change(x, now)
            b = change(x + h / 2 * a, now)
            c = change(x + h / 2 * b, now)
            x = x + h / 6 * (a + 2 * b + 2 * c + change(x + h * c, now))
    return states


def draw_pendulum(
    rng: Generator, far: bool = False, rms: float = 0.02, friction: float = 0.0, loud: float = 1.0
) -> Case:
    """Draw a pendulum: mass, damping, widths. Noise is ahead of the zone."""
    step, count, noise = 0.005, 4000, 0.002
    mass, damping, right, left = 0.0, 0.0, *rng.uniform(0.02, 0.4, 2)
    while min(mass - 0.25, damping - 0.15) < 0:
        mass, damping = rng.normal([1.0, 1.5], [0.4, 0.5])
    if far:
        mass, damping = rng.uniform([2.5, 0.3], [5.0, 0.6])
    sizes = 1.6 * max(1.0, mass) * np.array([2.5, 2.0, 1.5])
    u = sines(rng, step * np.arange(count), sizes, (0.17, 0.43, 0.71))

    def change(x: Any, torque: float) -> Any:
        """Return the derivative of angle and rate."""
        rubbing = damping * x[1] + friction * np.tanh(x[1] / 0.01)
        return np.array([x[1], -9.81 * np.sin(x[0]) - rubbing + torque / mass])

    z = move(change, np.zeros(2), u + colour(rng, count, step, rms, 0.5), step, 4)[:, 0]
    y = cut(z + loud * noise * rng.standard_normal(count), right, left)
    text = PENDULUM.replace("NOISE", str(noise)) + REST.format(step=step, rms=rms, lasting=0.5)
    free = {"plant.mass": (0.1, 10.0), "plant.damping": (0.02, 15.0)}
    free |= {"sensor.right": (0.0, 0.6), "sensor.left": (0.0, 0.6)}
    return Case(text, free, np.array([mass, damping, right, left]), [{"u": u, "y": y}])


def draw_linear(rng: Generator, poles: int) -> Case:
    """Draw a linear plant of order 2, or 3 with two logs: coefficients, gain, widths."""
    step, noise = ((0.02, 0.005), (0.01, 0.003))[poles - 2]
    zeta, omega = rng.uniform(0.15, 1.2), np.exp(rng.uniform(*np.log([2.0, 9.0])))
    slow = [1.0, 2 * zeta * omega, omega**2]
    lag = [1.0, np.exp(rng.uniform(*np.log([4.0, 25.0])))] if poles == 3 else [1.0]
    denominator = np.polymul(slow, lag)
    gain = rng.uniform(0.5, 2.0) * denominator[-1]
    right, left = rng.uniform(0.02, 0.5, 2)
    first = np.array([gain, *denominator[1:]])

    def change(x: Any, force: float) -> Any:
        """Return the derivative of the states of a companion form."""
        return np.append(x[1:], gain * force - denominator[:0:-1] @ x)

    logs = []
    for _ in range(poles - 1):
        u = sines(rng, step * np.arange(2000), (1.0, 0.8, 0.6), (0.11, 0.37, 0.9))
        x = np.append(rng.normal(0, 0.3), np.zeros(poles - 1))
        z = move(change, x, u + colour(rng, 2000, step, 0.02, 0.2), step, 4)[:, 0]
        logs.append({"u": u, "y": cut(z, right, left) + noise * rng.standard_normal(2000)})
    told = [5.0, 7.0, 25.0] if poles == 2 else [10.0, 17.0, 95.0, 250.0]
    text = LINEAR.format(gain=told[-1], denominator=[1.0, *told[1:]], noise=noise)
    text += REST.format(step=step, rms=0.02, lasting=0.2)
    free: dict[str, Any] = {"plant.transfer_function.numerator[0]": (told[-1] / 30, told[-1] * 30)}
    for i, value in enumerate(told[1:], 1):
        free[f"plant.transfer_function.denominator[{i}]"] = (value / 30, value * 10)
    free |= {"sensor.right": (0.0, 1.0), "sensor.left": (0.0, 1.0)}
    return Case(text, free, np.append(first, [right, left]), logs)


def draw_tanks(rng: Generator) -> Case:
    """Draw two tanks behind a pump with a dead zone: three coefficients, both widths."""
    k, c1, c2 = rng.uniform([0.02, 0.05, 0.05], [0.06, 0.12, 0.12])
    start, right = rng.uniform([0.3, 0.05], [2.0, 0.3])
    levels = rng.uniform(2.0, 6.0, 41) * (rng.random(41) > 0.25)
    u = np.repeat(levels, 75)[:3000]

    def flow(h: float) -> float:
        """Return the flow out of a tank over its coefficient."""
        return float(h / np.sqrt(np.sqrt(h * h + 1e-3)))

    def change(x: Any, pump: float) -> Any:
        """Return the derivative of both levels."""
        between = c1 * flow(x[0])
        return np.array([k * pump - between, between - c2 * flow(x[1])])

    pumped = cut(u, start, 0.0) + colour(rng, 3000, 1.0, 0.1, 20.0)
    z = move(change, np.full(2, 0.1), pumped, 1.0, 4)[:, 1]
    y = cut(z, right, 9.0) + 0.004 * rng.standard_normal(3000)
    free: dict[str, Any] = {
        "plant.k": (0.005, 0.2),
        "plant.c1": (0.01, 0.4),
        "plant.c2": (0.01, 0.4),
    }
    free |= {"actuator.right": (0.0, 3.0), "sensor.right": (0.0, 0.6)}
    text = TANKS + REST.format(step=1.0, rms=0.1, lasting=20.0)
    return Case(text, free, np.array([k, c1, c2, start, right]), [{"u": u, "y": y}])


def draw_motor(rng: Generator) -> Case:
    """Draw a motor whose actuator has a zone: pole, gain, widths, noise, disturbance."""
    pole, gain = np.exp(rng.uniform(*np.log([2.0, 15.0]))), rng.uniform(20.0, 80.0)
    right, left = rng.uniform(0.1, 2.0, 2)
    u = sines(rng, 0.01 * np.arange(3000), (2.5, 2.0, 1.5), (0.2, 0.53, 1.3))
    pushed = cut(u, right, left) + colour(rng, 3000, 0.01, 0.1, 0.1)
    z = move(lambda x, v: gain * v - pole * x, np.zeros(1), pushed, 0.01, 4)[:, 0]
    free = {"plant.A": (-5.0, -50.0, -0.2), "plant.B": (2.0, 500.0), "actuator.right": (0.0, 4.0)}
    free |= {"actuator.left": (0.0, 4.0), "sensor.noise": (0.6, 0.02, 5.0)}
    free |= {"disturbance.rms": (0.3, 0.005, 3.0)}
    truth = np.array([-pole, gain, right, left, 0.3, 0.1])
    y = z + 0.3 * rng.standard_normal(3000)
    return Case(
        MOTOR + REST.format(step=0.01, rms=0.1, lasting=0.1), free, truth, [{"u": u, "y": y}]
    )


CASES: dict[str, tuple[Callable[[Generator], Case], str]] = {
    "pendulum, near": (draw_pendulum, "free"),
    "pendulum, near, disturbed": (partial(draw_pendulum, rms=0.2), "free"),
    "pendulum, far, x(0) free": (partial(draw_pendulum, far=True), "free"),
    "pendulum, far, x(0) known": (partial(draw_pendulum, far=True), "known"),
    "linear, order 2": (partial(draw_linear, poles=2), "free"),
    "linear, order 3, two logs": (partial(draw_linear, poles=3), "free"),
    "two tanks": (draw_tanks, "free"),
    "motor, zone of the actuator": (draw_motor, "free"),
}
WRONG: dict[str, tuple[Callable[[Generator], Case], str]] = {
    "pendulum, Coulomb friction left out": (partial(draw_pendulum, friction=0.3), "free"),
    "pendulum, noise 1.3 times too small": (partial(draw_pendulum, loud=1.3), "free"),
}


def fit_output_error(case: Case, x0: str) -> tuple[Floats, Floats, bool]:
    """Return the numbers of SciPy's least squares along simulated readings, and their intervals."""
    problem = pose(case, x0)
    blind = [log._replace(y=np.full_like(log.y, np.nan)) for log in problem.logs]
    unsided = [np.zeros_like(side) for side in problem.sides]
    blind_problem = problem._replace(logs=tuple(blind), sides=tuple(unsided))
    y = problem.readings.ravel()
    names = [each.name for each in problem.free]

    def residuals(points: Floats) -> Floats:
        """Return simulated less measured readings of many points."""
        z = blind_problem.record_lanes(points).prediction.reshape(len(points), -1)
        values = problem.decode_points(points)
        widths = []
        for side in ("right", "left"):
            known = np.full(len(points), getattr(problem.zone, side)[0])
            address = f"sensor.{side}"
            widths.append(values[:, names.index(address)] if address in names else known)
        off = cut(z, *(width[:, None] for width in widths)) - y
        return np.nan_to_num(np.clip(off, -1e6, 1e6), nan=1e6)

    span = problem.high - problem.low
    steps = 1e-6 * span
    others = np.random.default_rng(1).uniform(problem.low, problem.high, (3, span.size))
    ends = []
    for start in [problem.start, *others]:
        inside = np.clip(start, problem.low + steps, problem.high - steps)
        bounds = (problem.low - 1e-9, problem.high + 1e-9)
        jacobian = partial(slope_of, residuals, steps)
        scale: dict[str, Any] = {"x_scale": span, "max_nfev": 60}
        first = partial(first_row, residuals)
        ends.append(least_squares(first, inside, jacobian, bounds=bounds, **scale))
    best = min(ends, key=lambda end: end.cost)
    cov = np.linalg.pinv(best.jac.T @ best.jac) * 2 * best.cost / (y.size - span.size)
    reach = 1.96 * np.sqrt(np.diag(cov))
    rows = problem.decode_points(np.stack([best.x, best.x - reach, best.x + reach]))
    return rows[0, : case.truth.size], rows[1:, : case.truth.size], True


def first_row(residuals: Callable[[Floats], Floats], point: Floats) -> Floats:
    """Return the residuals at a point."""
    return residuals(point[None])[0]


def slope_of(residuals: Callable[[Floats], Floats], steps: Floats, point: Floats) -> Floats:
    """Return the derivatives of residuals by central differences."""
    moves = np.diag(steps)
    return ((residuals(point + moves) - residuals(point - moves)) / (2 * steps[:, None])).T


def pose(case: Case, x0: Any) -> FitProblem:
    """Return the problem that `fit` solves."""
    scenario, _ = complete_tables(parse(case.text), case.free)
    model = build_model(scenario)
    logs = read_logs(scenario, model, case.logs, None, False)
    return prepare_fit(scenario, model, logs, case.free, x0, 1)


def fit_without_silence(case: Case, x0: str) -> tuple[Floats, Floats, bool]:
    """Return the same of an extended Kalman filter's likelihood, silent readings left out."""
    gate = 4 * parse(case.text).sensor.noise + 1e-9
    logs = []
    for log in case.logs:
        logs.append(log | {"y": np.where(np.abs(log["y"]) > gate, log["y"], np.nan)})
    return fit_fully(case._replace(logs=logs), x0)


def fit_fully(case: Case, x0: Any) -> tuple[Floats, Floats, bool]:
    """Return the numbers of `fit`, their intervals (2 x k), and whether no log contradicts them."""
    found = uz.fit(parse(case.text), case.logs, case.free, x0=x0, threads=1)
    rows = np.array([each[1:4] for each in found.numbers[: case.truth.size]])
    return rows[:, 0], rows[:, 1:].T, found.consistent


METHODS = {
    "fit": fit_fully,
    "EKF likelihood, silence left out": fit_without_silence,
    "output error (SciPy)": fit_output_error,
}


def measure_case(draw: Callable[[Generator], Case], x0: str, method: Any, runs: int) -> list[Any]:
    """Return (held, relative errors, whether a log contradicts, CPU s) of each truth."""
    rows = []
    for seed in range(runs):
        case = draw(np.random.default_rng(9000 + int(os.environ.get("FIT_FIRST", "0")) + seed))
        begin = time.process_time()
        value, (low, high), consistent = method(case, x0)
        spent = time.process_time() - begin
        held = (low <= case.truth) & (case.truth <= high)
        rows.append((held, np.abs(value / case.truth - 1), not consistent, spent))
    return rows


def table() -> str:
    """The tables of true scenarios and of wrong ones."""
    runs = int(os.environ.get("FIT_RUNS", "20"))
    chosen = os.environ.get("FIT_CASES", "")
    lines = ["## Numbers of a scenario from logs", ""]
    heads = ("plant", "method", "held", "each number", "median error", "worst", "flagged", "CPU s")
    lines += head(*heads)
    for name, (draw, x0) in (CASES | WRONG).items():
        for words, method in METHODS.items():
            if chosen not in f"{name}: {words}" or (name in WRONG and words != "fit"):
                continue
            rows = measure_case(draw, x0, method, runs)
            held, errors, flagged, spent = map(np.array, zip(*rows, strict=True))
            each = " ".join(f"{part:.2f}" for part in held.mean(axis=0))
            middle = f"{np.median(errors):.2g}", f"{errors.max():.2g}"
            cells = [name, words, f"{held.mean():.3f}", each, *middle, share(flagged.tolist())]
            lines.append(row(*cells, f"{np.median(spent):.2f}"))
            print(lines[-1], file=sys.stderr, flush=True)
    return "\n".join(lines)
