"""How often claimed 95 % intervals of `extended` hold the truth over random two-link arms.

Its errors in closed loop stand below.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import msgspec
import numpy as np

from benchmarks.filters.coverage import Verdict, covariance, verdict
from benchmarks.markdown import row
from undeadzone.compile import lanes
from undeadzone.interfaces import Estimate, Reading
from undeadzone.nonlinearities import sensor
from undeadzone.nonlinearities.sensor import Sensor, Zone, resolve
from undeadzone.observers import Extended
from undeadzone.plants.build import system
from undeadzone.plants.options import Plant, TwoLink
from undeadzone.plants.robots.arm import inverse_dynamics
from undeadzone.plants.system import System, sample_plant
from undeadzone.scenario.reader import read
from undeadzone.signals import noise as noises
from undeadzone.simulation.simulate import simulate
from undeadzone.util import tree
from undeadzone.util.arrays import Floats

STEP, DURATION, CORRELATION = 4e-3, 4.0, 0.1  # [s]
RANGE = (0.02, 0.15)  # [rad] declared range of the widths, from which they are drawn evenly
NOISE = 1e-3  # [rad]
START = np.array([0.02, 0.02, 0.05, 0.05])  # [rad, rad/s] rms of what is not known of the state
PULSES = np.array([2.0, 3.0])  # [rad/s] of the joints' sines
EXAMPLE = Path(__file__).parents[2] / "examples" / "two_link.toml"


COLUMNS = (
    "claimed",
    "true",
    "d_r",
    "d_l",
    "width",
    "centre",
    "q",
    "NEES",
    "NIS",
    "rms error of width, of centre [mrad]",
)


class Case(NamedTuple):
    """Assumptions of the filter, and the true world beside them.

    Attributes:
        assumed, true: both in words
        options: of the filter
        disturbance: its rms [N m]
        payload: rms of its error [kg]
        amplitude: of the joints' sines [rad]
    """

    assumed: str
    true: str
    options: dict[str, Any]
    disturbance: float = 0.0
    payload: float = 0.0
    amplitude: float = 0.5


SHAKEN: dict[str, Any] = {"disturbance": 0.5, "correlation_time": CORRELATION}
EXACT = SHAKEN | {"disturbance": 0.0}
SEPARATE, LOADED = SHAKEN | {"joints": "separate"}, {"uncertain": {"payload": 0.3}}
CASES = (
    Case("exact model", "the same", EXACT),
    Case("0.5 N m", "the same", SHAKEN, 0.5),
    Case("0.5 N m, separate joints", "the same", SEPARATE, 0.5),
    Case("0.5 N m, payload 1 +- 0.3 kg", "the same", SHAKEN | LOADED, 0.5, 0.3),
    Case("payload 1 +- 0.3 kg", "the same", EXACT | LOADED, 0.0, 0.3),
    Case("0.5 N m", "payload off by 0.3 kg rms, too", SHAKEN, 0.5, 0.3),
    Case("0.5 N m, separate joints", "payload off by 0.3 kg rms, too", SEPARATE, 0.5, 0.3),
    Case("exact model, sines of 0.12 rad", "the same", EXACT, amplitude=0.12),
    Case("0.5 N m, sines of 0.12 rad", "the same", SHAKEN, 0.5, amplitude=0.12),
)


class Watch(NamedTuple):
    """An arm held on a path by its true state, and the filter that watches it.

    Attributes:
        step: next, out = step(s, w, p) with s = [x; filter], w = [q, q', q'' of the path; noise
            over its rms; disturbance], p = [d_r; d_l; arm; filter], out = [x; estimate; mean]
        filter: its first state
        numbers: its parameters
        sizes: of x and of the parts of the estimate
    """

    step: ca.Function
    filter: Floats
    numbers: Floats
    sizes: tuple[int, ...]


def watch(options: Extended, arm: System, where: Zone) -> Watch:
    """The graph; the torque is computed from the true state and parameters."""
    observer, N = options.build(arm, where), arm.p
    first = observer.init(observer.params)
    column, state = tree.create_symbols(first, "s")
    numbers, params = tree.create_symbols(observer.params, "o")
    x, path = ca.SX.sym("x", 2 * N), ca.SX.sym("path", 3 * N)
    noise, w = ca.SX.sym("e", N), ca.SX.sym("w", N)
    widths, truth = ca.SX.sym("d", 2 * N), ca.SX.sym("p", len(arm.params))
    assert arm.arm is not None
    q, v, a = ca.vertsplit(path, N)
    commanded = a + 100 * (q - x[:N]) + 20 * (v - x[N:])
    u = inverse_dynamics(arm.arm, truth, x[:N], x[N:], commanded)
    read = sensor.jump if where.kind == "jump" else sensor.deadzone
    y = read(arm.output(truth, x), widths[:N], widths[N:]) + noise * where.noise
    after, estimate = observer.step(params, state, u, Reading(y, sensor.side(y, where.threshold)))
    inputs = [
        ca.vertcat(x, column),
        ca.vertcat(path, noise, w),
        ca.vertcat(widths, truth, numbers),
    ]
    outputs = [
        ca.vertcat(arm.move(truth, x, u + w), tree.stack_leaves(after)),
        ca.vertcat(x, *estimate, state.filter.mean),
    ]
    names = (["s", "w", "p"], ["next", "out"])
    step = ca.Function("watch", inputs, outputs, *names, {"cse": True})
    sizes = (2 * N, *(part.shape[0] for part in estimate))
    return Watch(step, tree.pack_tree(first), tree.pack_tree(observer.params), sizes)


def sines(seconds: float, amplitude: float, pulses: Any, step: float) -> Floats:
    """Positions, speeds and accelerations of joints that move as amplitude sin(pulse t)."""
    t, pulses = np.arange(0.0, seconds, step)[:, None], np.asarray(pulses)
    q = amplitude * np.sin(pulses * t)
    v = amplitude * pulses * np.cos(pulses * t)
    a = -amplitude * pulses**2 * np.sin(pulses * t)
    return np.hstack([q, v, a])


def observe(case: Case, count: int, seed: int) -> Verdict:
    """The verdict on `count` arms, a lane each: their joints are the problems."""
    rng = np.random.default_rng([seed, CASES.index(case)])
    path = sines(DURATION, case.amplitude, PULSES, STEP)
    arm = sample_plant(
        system(Plant(arm=TwoLink(), parameters={"b1": 0.5, "payload": 1.0})), STEP, 1
    )
    where = resolve(Sensor(right=RANGE[1], left=RANGE[1], noise=NOISE), 2, STEP)
    options = Extended(right=RANGE, start=path[0, :4], x_std=START, **case.options)
    watched = watch(options, arm, where)
    kernel = lanes.build_kernel(
        watched.step, exogenous=range(6, 10), params=range(4 + len(arm.params))
    )
    d, params = rng.uniform(*RANGE, (count, 4)), np.tile(arm.params, (count, 1))
    params[:, arm.names.index("payload")] += case.payload * rng.normal(size=count)
    w_rms = np.full(2, case.disturbance)
    disturbances = [
        noises.stationary_first_order_noise(seed, len(path), w_rms, CORRELATION, STEP, run)
        for run in range(count)
    ]
    noise = rng.normal(size=(len(path), 2, count))
    own = np.concatenate([noise, np.stack(disturbances, axis=2)], axis=1)
    x0 = path[0, :4] + START * rng.normal(size=(count, 4))
    states = np.hstack([x0, np.tile(watched.filter, (count, 1))])
    numbers = np.concatenate([np.zeros(4), arm.params, watched.numbers])
    shared = np.pad(path, ((0, 0), (0, 4)))
    out, _ = lanes.run_lanes(kernel, states, shared, numbers, own, np.hstack([d, params]))
    x, *parts = np.split(out, np.cumsum(watched.sizes), axis=2)
    estimate = Estimate(*parts[:-1])
    last = Estimate(*(part[:, -1] for part in parts[:-1]))
    used = estimate.innovation != 0
    return verdict(
        np.stack([d[:, :2], d[:, 2:], x[:, -1, :2]], axis=2).reshape(-1, 3),
        np.stack([last.right, last.left, last.z], axis=2).reshape(-1, 3),
        covariance(last.right_std.ravel(), last.left_std.ravel(), last.width_std.ravel()),
        last.x_std[:, :2].ravel(),
        estimate.innovation[used] / estimate.innovation_std[used],
    )


def closed_loop() -> list[str]:
    """Errors of the joints' angles on the example's path; the controller sees the estimate."""
    scenario = read(EXAMPLE)
    assert isinstance(scenario.observer, Extended)
    separate = msgspec.structs.replace(
        scenario.observer, joints="separate", disturbance=2.0, uncertain={}
    )
    watching = {
        "as in the file": scenario.observer,
        "separate joints, 2 N m claimed, no parameter uncertain": separate,
        "blind": scenario.compare,
    }
    error_of = "rms error of the joints' angles, second half [mrad]"
    lines = [row("`examples/two_link.toml`", error_of), row("---", "---")]
    for label, observer in watching.items():
        run = simulate(msgspec.structs.replace(scenario, observer=observer, compare=None))
        error = (run.x_hat - run.x)[len(run.t) // 2 :, :2]
        lines.append(row(label, f"{1e3 * np.sqrt(np.mean(error**2)):.2g}"))
    return lines


def table(count: int = 400, seed: int = 0) -> str:
    """Both tables."""
    lines = [
        "## Coverage of claimed 95 % intervals: `extended` on two links\n",
        row(*COLUMNS),
        row(*["---"] * len(COLUMNS)),
    ]
    for case in CASES:
        judged = observe(case, count, seed)
        shares = [f"{share:.3f}" for share in judged.covered()]
        width, centre = 1e3 * np.sqrt(np.mean(judged.errors[:, 2:4] ** 2, axis=0))
        ratios = (f"{judged.nees():.3g}", f"{judged.nis:.3g}")
        lines.append(row(case.assumed, case.true, *shares, *ratios, f"{width:.2g}, {centre:.2g}"))
    note = f"{count} arms a row; {DURATION:g} s at {1 / STEP:g} Hz."
    return "\n".join([*lines, "", note, "", *closed_loop(), ""])
