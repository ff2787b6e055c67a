"""Numbers of scenarios from logs, `fit`: coverage of intervals, flags of true and of wrong models.

FIT_RUNS: truths of each plant (20). FIT_CASES: part of the names of cases (all). FIT_FIRST:
the first seed. Logs are simulated here by eight Runge-Kutta steps a sample, but for the servo of
MuJoCo. `mujoco.sysid` is told MuJoCo's own model of a servo. It is the method of
FIT_CASES="encoder: mujoco.sysid", and needs `pip install mujoco[sysid]`.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

import undeadzone as uz
from benchmarks.identify.logs import motors
from benchmarks.identify.logs.strangers import zone as through
from benchmarks.identify.motors import by_sysid
from benchmarks.markdown import head, row
from benchmarks.results import share
from undeadzone.nonlinearities.actuator import resolve_actuator, through_zone
from undeadzone.plants.build import initial_state
from undeadzone.scenario.address import with_value
from undeadzone.scenario.reader import parse
from undeadzone.util.arrays import Floats
from undeadzone_identify.fitting.estimates import prepare_fit, read_logs
from undeadzone_identify.fitting.free import complete_tables
from undeadzone_identify.fitting.problem import FitProblem, build_model, resolve_zone

Generator = np.random.Generator
Truth = dict[str, float]
Logs = list[dict[str, Floats]]
BEFORE = 200  # samples ahead of a log whose x(0) is unknown
REST = """
[simulation]
time = "sampled"
step = {step}
substeps = {substeps}
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
noise_before = 0.002
"""
RUBBING = ("- damping * rate", "- damping * rate - 0.3 * tanh(rate / 0.01)")
LINEAR = """
[plant]
transfer_function = {{ numerator = [{gain}], denominator = {denominator} }}
[sensor]
right = 0.3
left = 0.3
noise = 0.005
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
SERVO = """
[plant.arm]
kind = "one_link"
[plant.arm.gears]
half = [0.03]
inertia = [0.015]
friction = [0.0]
viscous = [0.1]
contact = 300.0
measured = "motor"
[plant.parameters]
m = 1.0
l = 0.2
c = 0.0
I = 0.01
g = 0.0
[sensor]
right = 0.0
left = 0.0
noise = 2e-4
"""
ARM = """
[plant]
x0 = [-1.5, 0.2, 0.0, 0.0]
[plant.arm]
kind = "two_link"
[plant.parameters]
payload = 0.5
b1 = 2.0
b2 = 1.0
[sensor]
right = 0.05
left = 0.05
noise = 0.001
"""


class Case(NamedTuple):
    """Scenario, the truths of its free numbers, and what moves it.

    Attributes:
        text: of the scenario, without REST.
        rest: step, rms and correlation time of the disturbance.
        free: ranges by address; the entries of a list have one range.
        truth: draws the truth from random numbers.
        sizes, frequencies: of the sines in each input.
        count: samples of a log.
        logs: how many.
        x0: as of `fit`.
        wrong: what stands in the text in truth: pairs of words.
    """

    text: str
    rest: tuple[float, float, float]
    free: dict[str, Any]
    truth: Callable[[Generator], Truth]
    sizes: tuple[float, ...] = (1.0, 0.8, 0.6)
    frequencies: tuple[float, ...] = (0.17, 0.43, 0.71)
    count: int = 3000
    logs: int = 1
    x0: str = "free"
    wrong: tuple[str, str] = ("", "")

    def write_scenario(self, text: str, substeps: int = 2) -> Any:
        """Return the scenario of a text."""
        step, rms, lasting = self.rest
        return parse(text + REST.format(step=step, rms=rms, lasting=lasting, substeps=substeps))

    def record(self, rng: Generator) -> tuple[Truth, Logs]:
        """Return the truth and its logs."""
        truth = self.truth(rng)
        real = self.write_scenario(self.text.replace(*self.wrong), 8)
        for name, value in truth.items():
            real = with_value(real, name, value)
        return truth, [self.record_log(real, rng) for _ in range(self.logs)]

    def record_log(self, real: Any, rng: Generator) -> dict[str, Floats]:
        """Return a log of a true scenario."""
        plant = build_model(real)
        step, before = self.rest[0], BEFORE * (self.x0 == "free")
        t = step * np.arange(self.count + before)[:, None, None]
        phases = rng.uniform(0, 2 * np.pi, (plant.m, len(self.sizes)))
        waves = np.sin(2 * np.pi * np.array(self.frequencies) * t + phases)
        u = (np.array(self.sizes) * waves).sum(axis=2)
        w = colour(rng, u.shape, step, real.disturbance)
        pushed = u
        if real.actuator is not None:
            pushed = through_zone(np, u, resolve_actuator(real.actuator, plant.m))
        x, v = ca.SX.sym("x", plant.n), ca.SX.sym("v", plant.m)
        moved = x + plant.change(plant.params, x, v)
        move = ca.Function("move", [x, v], [moved, plant.read(plant.params, x)])
        start = initial_state(real.plant, plant)
        z = np.array(move.mapaccum(len(u))(start, (pushed + w).T)[1]).T
        zone = resolve_zone(real)
        ahead = z + zone.noise_before * rng.standard_normal(z.shape)
        seen = ahead if zone.kind == "gears" else through(ahead, zone.right, zone.left)
        y = seen + zone.noise * rng.standard_normal(z.shape)
        return {"u": u[before:], "y": y[before:]}


def draw_motor(rng: Generator) -> tuple[motors.Motor, Truth]:
    """Draw a motor with a gap, and return it with its numbers."""
    gap, ratio, samples = np.exp(rng.uniform(*np.log([[0.01, 0.5, 60], [0.04, 2.0, 200]])))
    motor = motors.Motor(gap, ratio, samples, 0.0, False, False, False)
    rotor = motors.INERTIA / (1 + ratio)
    values = [gap / 2, rotor, motor.damping, motors.INERTIA - rotor, 0.005]
    return motor, dict(zip(GEARED, map(float, values), strict=True))


class Servo(Case):
    """Servo with a gap behind its encoder, as MuJoCo moves it, without a disturbance."""

    def record(self, rng: Generator) -> tuple[Truth, Logs]:
        """Return the truth and its log."""
        motor, truth = draw_motor(rng)
        u, y = motors.record(motor, int(rng.integers(2**31)))
        del truth["disturbance.rms"]
        return truth, [{"u": u, "y": y}]


def colour(rng: Generator, shape: Any, step: float, disturbance: Any) -> Floats:
    """Return a stationary first-order disturbance."""
    memory = np.exp(-step / disturbance.correlation_time)
    fresh = np.sqrt(1 - memory**2)
    white = rng.standard_normal(shape) * disturbance.rms
    white[0] /= fresh
    return np.asarray(lfilter([fresh], [1.0, -memory], white, axis=0))


def draw(low: Any, high: Any, names: Any, rng: Generator, signs: Any = 1.0) -> Truth:
    """Draw numbers between two ends, evenly in their logarithms."""
    values = signs * np.exp(rng.uniform(np.log(low), np.log(high)))
    return dict(zip(names, values.tolist(), strict=True))


def linear(order: int) -> Case:
    """Return the case of order 2, or 3 with two logs."""
    told = [5.0, 7.0, 25.0] if order == 2 else [10.0, 17.0, 95.0, 250.0]
    bottom = "plant.transfer_function.denominator"
    names = ["plant.transfer_function.numerator[0]", *(f"{bottom}[{i + 1}]" for i in range(order))]
    told[0] = told[-1]
    free = {name: (value / 30, value * 30) for name, value in zip(names, told, strict=True)}
    free |= WIDTHS

    def truth(rng: Generator) -> Truth:
        """Draw damping, frequency, a lag, gain and widths."""
        zeta, omega, lag, gain = np.exp(rng.uniform(*np.log([[0.15, 2, 4, 0.5], [1.2, 9, 25, 2]])))
        last = np.polymul([1.0, 2 * zeta * omega, omega**2], [1.0, lag][: order - 1])
        values = [gain * last[-1], *last[1:], *rng.uniform(0.02, 0.5, 2)]
        return dict(zip(free, values, strict=True))

    text = LINEAR.format(gain=told[0], denominator=[1.0, *told[1:]])
    return Case(text, (0.03 - 0.01 * (order - 1), 0.02, 0.2), free, truth, logs=order - 1)


WIDTHS = {"sensor.right": (0.0, 1.0), "sensor.left": (0.0, 1.0)}
SWUNG = {"plant.parameters.mass": (0.1, 10.0), "plant.parameters.damping": (0.02, 15.0), **WIDTHS}
NEAR = partial(draw, [0.5, 0.6, 0.02, 0.02], [2.0, 3.0, 0.4, 0.4], SWUNG)
FAR = partial(draw, [2.5, 0.3, 0.02, 0.02], [5.0, 0.6, 0.4, 0.4], SWUNG)
PUMPED = {f"plant.parameters.{name}": (0.005, 0.5) for name in ("k", "c1", "c2")}
PUMPED |= {"actuator.right": (0.0, 3.0), "sensor.right": (0.0, 0.6)}
DRIVEN: dict[str, Any] = {"plant.A[0,0]": (-5.0, -50.0, -0.2), "plant.B[0,0]": (2.0, 500.0)}
DRIVEN |= {"actuator.right": (0.0, 4.0), "actuator.left": (0.0, 4.0)}
DRIVEN |= {"sensor.noise": (0.6, 0.02, 5.0), "disturbance.rms": (0.3, 0.005, 3.0)}
GEARED = {"plant.arm.gears.half[0]": (0.0, 0.1), "plant.arm.gears.inertia[0]": (0.002, 0.1)}
GEARED |= {"plant.arm.gears.viscous[0]": (0.001, 0.5), "plant.parameters.I": (0.001, 0.1)}
GEARED |= {"disturbance.rms": (2e-4, 0.2)}
near = Case(PENDULUM, (0.005, 0.02, 0.5), SWUNG, NEAR, (4.0, 3.2, 2.4), count=4000)
far = near._replace(truth=FAR, sizes=(15.0, 12.0, 9.0))
CASES = {
    "pendulum, near": near,
    "pendulum, far, x(0) free": far,
    "pendulum, far, x(0) known": far._replace(x0="known"),
    "linear, order 2": linear(2),
    "linear, order 3, two logs": linear(3),
    "two tanks": Case(
        TANKS,
        (1.0, 0.1, 20.0),
        PUMPED,
        partial(draw, [0.02, 0.05, 0.05, 0.3, 0.05], [0.06, 0.12, 0.12, 2.0, 0.3], PUMPED),
        (4.0, 3.0, 2.0),
        (0.002, 0.0053, 0.011),
    ),
    "motor, zone of the actuator": Case(
        MOTOR,
        (0.01, 0.1, 0.1),
        DRIVEN,
        partial(
            draw,
            [2, 20, 0.1, 0.1, 0.3, 0.1],
            [15, 80, 2, 2, 0.3, 0.1],
            DRIVEN,
            signs=[-1] + 5 * [1],
        ),
        (2.5, 2.0, 1.5),
        (0.2, 0.53, 1.3),
    ),
    "servo, torque and motor encoder": Case(
        SERVO,
        (0.005, 0.005, 0.05),
        GEARED,
        lambda rng: draw_motor(rng)[1],
        (0.25, 0.2, 0.15),
        (0.7, 1.9, 3.3),
        1600,
    ),
    "servo of MuJoCo, torque and motor encoder": Servo(SERVO, (0.005, 0.005, 0.05), GEARED, dict),
    "arm of two links, payload": Case(
        ARM,
        (0.01, 0.05, 0.2),
        {"plant.parameters.payload": (0.0, 2.0)},
        partial(draw, [0.1], [1.0], ["plant.parameters.payload"]),
        (3.0, 2.0, 1.0),
        count=1500,
    ),
}
WRONG = {
    "pendulum, Coulomb friction left out": near._replace(wrong=RUBBING),
    "pendulum, noise 1.3 times too small": near._replace(wrong=("0.002", "0.0026")),
}


def pose(case: Case, logs: Logs) -> FitProblem:
    """Return the problem that `fit` solves."""
    scenario, _ = complete_tables(case.write_scenario(case.text), case.free)
    model = build_model(scenario)
    x0: Any = case.x0
    return prepare_fit(
        scenario, model, read_logs(scenario, model, logs, None, False), case.free, x0, 1
    )


def fit_output_error(case: Case, logs: Logs) -> tuple[Floats, Floats, bool]:
    """Return the numbers of SciPy's least squares along simulated readings, and their intervals."""
    problem = pose(case, logs)
    y = problem.whole.y.ravel()
    blind = [each._replace(y=np.nan * each.y, side=0 * each.side) for each in problem.logs]
    unseen = problem._replace(logs=tuple(blind))
    told = {f"sensor.{side}": getattr(problem.zone, side)[0] for side in ("right", "left")}

    def residuals(point: Floats) -> Floats:
        """Return simulated less measured readings."""
        z = unseen.record_lanes(point[None]).prediction.ravel()
        values = problem.decode_points(point[None])[0]
        found = told | dict(zip((each.name for each in problem.free), values, strict=True))
        off = through(z, found["sensor.right"], found["sensor.left"]) - y
        return np.clip(np.nan_to_num(off, nan=1e6), -1e6, 1e6)

    span = problem.high - problem.low
    rule: dict[str, Any] = {"bounds": (problem.low - 1e-9, problem.high + 1e-9), "max_nfev": 60}
    starts = np.random.default_rng(1).uniform(problem.low, problem.high, (4, span.size))
    starts[0] = problem.start
    ends = [least_squares(residuals, start, x_scale=span, **rule) for start in starts]
    best = min(ends, key=lambda end: end.cost)
    cov = np.linalg.pinv(best.jac.T @ best.jac) * 2 * best.cost / (y.size - span.size)
    rows = problem.decode_points(best.x + np.outer([0.0, -1.96, 1.96], np.sqrt(np.diag(cov))))
    return rows[0], rows[1:], True


def fit_without_silence(case: Case, logs: Logs) -> tuple[Floats, Floats, bool]:
    """Return the same of an extended Kalman filter's likelihood, silent readings left out."""
    gate = 4 * case.write_scenario(case.text).sensor.noise + 1e-9
    used = [each | {"y": np.where(np.abs(each["y"]) > gate, each["y"], np.nan)} for each in logs]
    return fit_fully(case, used)


def fit_fully(case: Case, logs: Logs) -> tuple[Floats, Floats, bool]:
    """Return the numbers of `fit`, their intervals (2 x k), and whether no log contradicts them."""
    x0: Any = case.x0
    found = uz.fit(case.write_scenario(case.text), logs, case.free, x0=x0, threads=1)
    rows = np.array([each[1:4] for each in found.numbers])
    return rows[:, 0], rows[:, 1:].T, found.consistent


def fit_by_sysid(case: Case, logs: Logs) -> tuple[Floats, Floats, bool]:
    """Return the half gap of `mujoco.sysid`, told MuJoCo's own model of the motor."""
    (log,) = logs
    motor = motors.Motor(0.02, 1.0, 100.0, 0.0, False, False, False)
    gap = by_sysid(log["u"], log["y"], motor).gap
    value, low, high = np.array(gap)[:, None] / 2
    return value, np.stack([low, high]), True


RIVAL = "mujoco.sysid"
METHODS = {
    "fit": fit_fully,
    "EKF likelihood, silence left out": fit_without_silence,
    "output error (SciPy)": fit_output_error,
}


def measure_case(case: Case, method: Any, runs: int) -> list[Any]:
    """Return (held, relative errors, whether a log contradicts, CPU s) of each truth."""
    rows = []
    first = 9000 + int(os.environ.get("FIT_FIRST", "0"))
    for seed in range(first, first + runs):
        truth, logs = case.record(np.random.default_rng(seed))
        begin = time.process_time()
        value, (low, high), consistent = method(case, logs)
        spent = time.process_time() - begin
        true = np.array([*truth.values()])[: len(value)]  # a rival may find fewer numbers
        k = slice(true.size)
        held = (low[k] <= true) & (true <= high[k])
        rows.append((held, np.abs(value[k] / true - 1), not consistent, spent))
    return rows


def table() -> str:
    """The tables of true scenarios and of wrong ones."""
    runs = int(os.environ.get("FIT_RUNS", "20"))
    chosen = os.environ.get("FIT_CASES", "")
    methods = {RIVAL: fit_by_sysid} if chosen.endswith(RIVAL) else METHODS
    lines = ["## Numbers of a scenario from logs", ""]
    heads = ("plant", "method", "held", "each number", "median error", "worst", "flagged", "CPU s")
    lines += head(*heads)
    for name, case in (CASES | WRONG).items():
        for words, method in methods.items():
            if chosen not in f"{name}: {words}" or (name in WRONG and words != "fit"):
                continue
            rows = measure_case(case, method, runs)
            held, errors, flagged, spent = map(np.array, zip(*rows, strict=True))
            each = " ".join(f"{part:.2f}" for part in held.mean(axis=0))
            middle = f"{np.median(errors):.2g}", f"{errors.max():.2g}"
            cells = [name, words, f"{held.mean():.3f}", each, *middle, share(flagged.tolist())]
            lines.append(row(*cells, f"{np.median(spent):.2f}"))
            print(lines[-1], file=sys.stderr, flush=True)
    return "\n".join(lines)
