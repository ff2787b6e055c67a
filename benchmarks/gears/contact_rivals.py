"""What other filters make of the readings of servos behind gears, beside `contact`.

ANCHORS_FIRST: the first seed (20000), ANCHORS_LOOPS: how many servos (100).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

import undeadzone as uz
from benchmarks.gears.contact import LAST, Bench, bench, driven, geared, rows
from benchmarks.gears.mujoco_arms import Arm
from benchmarks.markdown import head, row
from undeadzone.compile.scalar_step import CompiledStepper
from undeadzone.numerics.gaussian import normal_cdf, normal_density
from undeadzone.numerics.runge_kutta import rk4_change
from undeadzone.observers.contact import DRIFT, JERK, unknown_torques
from undeadzone.observers.contact_filter.drive import FADING, LASTING
from undeadzone.plants.robots.arm import forward_dynamics
from undeadzone.plants.system import System
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.reader import convert
from undeadzone.util import tree
from undeadzone.util.arrays import Floats

SUBSTEPS = 2
NOTE = """MuJoCo's servos of `contact`, whose loops that filter closes; all filters read the same.
Smoothed: an extended Kalman filter of motor, link, half gap, payload and an unknown torque, with
the mean torque through the gap under its belief (the two-mass filter of the textbooks, which has
no `consistent`; inf: it was lost). `extended` is told a rigid arm whose encoder has a dead zone;
`kalman`, level and with the encoder at the link, a linear plant behind a play, so that what it
shows as z is the motor. Flagged: `consistent` is 0 in the end.
"""


class Estimated(NamedTuple):
    """What a filter shows along a record.

    Attributes:
        link: angle of the link (samples) [rad].
        half: half of the gap in the end [rad].
        std: its standard deviation.
        fits: whether the filter calls itself consistent in the end.
    """

    link: Floats
    half: float
    std: float
    fits: bool = True


Filter = Callable[[Floats, Floats], Estimated]  # readings and inputs (samples) -> what it shows


def smoothed(scenario: Mapping[str, Any]) -> Filter:
    """The two-mass filter with the mean torque through the gap."""
    resolved = resolve_scenario(convert({"title": "smoothed", **scenario}))
    first, variance = _prior(resolved.model, scenario)
    step = _extended_step(resolved.model, scenario)

    def along(y: Floats, u: Floats) -> Estimated:
        mean = np.concatenate([[y[0], y[0], 0.0, 0.0], first])
        start = np.concatenate([mean, np.diag(variance).ravel()])
        estimates = CompiledStepper(step, start, np.empty(0)).run(np.column_stack([y, u]))
        return Estimated(estimates[:, 0], estimates[-1, 1], np.sqrt(max(estimates[-1, 2], 0.0)))

    return along


def _prior(model: System, scenario: Mapping[str, Any]) -> tuple[Floats, Floats]:
    """Means of half gap, payload and torque, and variances of the whole state (7)."""
    ranges = np.array([scenario["observer"]["half"], scenario["observer"]["payload"]])
    widths = (ranges[:, 1] - ranges[:, 0]) / np.sqrt(12)
    motors, _, _ = unknown_torques(model, model.gears, float(ranges[1].mean()))
    stds = [0.02, ranges[0, 1], 0.05, 0.05, *widths, motors[0]]
    return np.append(ranges.mean(axis=1), 0.0), np.square(stds)


def _extended_step(model: System, scenario: Mapping[str, Any]) -> ca.Function:
    """next, [link, half, its variance] = step([mean; cov], [y; u], nothing)."""
    gears, Ts = model.gears, model.Ts
    assert gears is not None
    assert Ts is not None
    payload = float(np.mean(scenario["observer"]["payload"]))
    motors, loads, inertia = unknown_torques(model, gears, payload)
    Q = np.zeros(7)
    Q[2], Q[3] = JERK * Ts, Ts * LASTING * (loads[0] / inertia[0]) ** 2
    Q[4], Q[6] = DRIFT[0] ** 2 * Ts, 2 * Ts / FADING * motors[0] ** 2
    mean, packed = ca.SX.sym("mean", 7), ca.SX.sym("cov", 49)
    w, cov = ca.SX.sym("w", 2), ca.reshape(packed, 7, 7)
    gain = cov[:, 0] / (cov[0, 0] + scenario["sensor"]["noise"] ** 2)
    after = mean + gain * (w[0] - mean[0])
    left = cov - gain @ cov[0, :]
    x, spread = ca.SX.sym("x", 7), ca.SX.sym("spread")

    def rate(x: Any, _: float) -> Any:
        params = ca.SX(model.params)
        params[gears.names.index("half1")] = x[4]
        params[gears.names.index("payload")] = x[5]
        apart = gears.gear_angle(params, x[:4])
        pressed = _beyond(apart - x[4], spread) - _beyond(-apart - x[4], spread)
        closed = normal_cdf((apart - x[4]) / spread) + normal_cdf((-apart - x[4]) / spread)
        f = gears.gear_number(params, "contact")
        tau = f * (gears.stiffness * f * pressed + gears.damping * closed * (x[2] - x[3]))
        drive = w[1] + x[6] - gears.motor_friction_torque(params, x[2]) - tau
        swung = forward_dynamics(gears.arm, gears.link_params(params), x[1], x[3], tau)
        spun = drive / gears.gear_number(params, "inertia")
        return ca.vertcat(x[2], x[3], spun, swung, 0, 0, -x[6] / FADING)

    moved = x
    for _ in range(SUBSTEPS):
        moved = moved + rk4_change(rate, moved, Ts / SUBSTEPS)
    motion = ca.Function("motion", [x, spread, w], [moved, ca.jacobian(moved, x)])
    edge = ca.DM([1, -1, 0, 0, -1, 0, 0])
    wide = ca.sqrt(ca.fmax(edge.T @ left @ edge, 1e-12))
    ahead, F = motion(after, wide, w)
    later = F @ left @ F.T + ca.diag(Q)
    following = ca.vertcat(ahead, ca.vec((later + later.T) / 2))
    out = ca.vertcat(after[1], after[4], left[4, 4])
    state = ca.vertcat(mean, packed)
    return ca.Function("step", [state, w, ca.SX(0, 1)], [following, out])


def _beyond(edge: Any, spread: Any) -> Any:
    """The mean of max(e, 0) where e is normal."""
    return edge * normal_cdf(edge / spread) + spread * normal_density(edge / spread)


def zone(scenario: Mapping[str, Any]) -> Filter:
    """`extended` of the arm as one mass, told that its encoder has a dead zone."""
    gears, plant = scenario["plant"]["arm"]["gears"], scenario["plant"]
    own = plant["parameters"]
    rigid = {"I": gears["inertia"], "f1": gears["friction"], "b1": gears["viscous"]}
    added = {name: own[name] + more for name, more in rigid.items()}
    arm = {name: value for name, value in plant["arm"].items() if name != "gears"}
    widths = dict.fromkeys(("right", "left"), scenario["observer"]["half"])
    tables = {
        **scenario,
        "title": "zone",
        "plant": {**plant, "arm": arm, "parameters": {**own, **added}},
        "sensor": {**scenario["sensor"], "right": 0.03, "left": 0.03},
        "observer": {"method": "extended", **widths},
        "controller": {"method": "computed_torque", "bandwidth": 15.0},
    }
    return _online(tables)


def play(scenario: Mapping[str, Any]) -> Filter:
    """`kalman` of motor and link as one mass, linear, told that its encoder is behind a play."""
    gears, own = scenario["plant"]["arm"]["gears"], scenario["plant"]["parameters"]
    inertia = gears["inertia"] + own["I"] + own["m"] * own["c"] ** 2
    damping = (gears["viscous"] + own["b1"]) / inertia
    tables = {
        "title": "play",
        "plant": {"A": [[0, 1], [0, -damping]], "B": [[0], [1 / inertia]], "C": [[1, 0]]},
        "sensor": {**scenario["sensor"], "kind": "play", "right": 0.03, "left": 0.03},
        "observer": {"method": "kalman", "right": [0.0, 0.06], "left": [0.0, 0.06]},
        "simulation": {"time": "sampled", "duration": 1.0, "step": 1e-3},
        "reference": {"kind": "sine", "amplitude": 1.0, "frequency": 1.0},
    }
    return _online(tables)


def _online(tables: Mapping[str, Any]) -> Filter:
    """The observer of a scenario along readings."""
    converted = convert(tables)
    online = uz.Online(
        converted.observer,
        converted.plant,
        converted.sensor,
        converted.simulation.step,
        compiled=True,
    )

    def along(y: Floats, u: Floats) -> Estimated:
        online.restart()
        estimates, _ = online.update_many(y[:, None], u[:, None])
        half = (estimates.right[-1, 0] + estimates.left[-1, 0]) / 2
        fits = bool(estimates.consistent[-1].all())
        return Estimated(estimates.z[:, 0], half, estimates.width_std[-1, 0] / 2, fits)

    return along


def _rows(setup: Bench, filters: Mapping[str, Filter], arms: Sequence[tuple[int, Arm]]) -> Any:
    """What each filter makes of the same loops, that of the loop first: errors and scores."""
    where, last = tree.leaf_slices(setup.loop.outputs), round(LAST / 1e-3)
    found: dict[str, list[tuple[float, float, float, bool]]] = {}
    for seed, arm in arms:
        outputs = driven(setup, arm, seed)
        end, shows = outputs[-1], where.estimate
        half_gap = (end[shows.right][0] + end[shows.left][0]) / 2
        fits = bool(end[shows.consistent].all())
        own = outputs[:, shows.x][:, 1]
        estimates = {"`contact`": Estimated(own, half_gap, end[shows.width_std][0] / 2, fits)}
        for label, along in filters.items():
            estimates[label] = along(outputs[:, where.y][:, 0], outputs[:, where.u][:, 0])
        link, half = outputs[-last:, where.x][:, 1], arm.half[0]
        for label, estimate in estimates.items():
            off = float(np.sqrt(np.mean((estimate.link[-last:] - link) ** 2)))
            score = abs(estimate.half - half) / max(estimate.std, 1e-12)
            found.setdefault(label, []).append(
                (off, abs(estimate.half / half - 1), score, estimate.fits)
            )
    return found


def _cells(found: Sequence[tuple[float, float, float, bool]]) -> list[str]:
    """A row in its cells; what is no number counts as beyond all bounds."""
    off, error, score, fits = np.nan_to_num(np.array(found).T, nan=np.inf)
    return [
        f"{1e3 * np.median(off):.2f} ({1e3 * np.quantile(off, 0.95, method='higher'):.2f})",
        f"{np.mean(error <= 0.05):.2f}, {np.mean(error <= 0.1):.2f}",
        f"{100 * np.median(error):.1f} %",
        f"{np.mean(score <= 1.96):.2f}",
        f"{(score > 5).sum()} of {len(found)}",
        f"{(fits == 0).sum()}",
    ]


def table() -> str:
    """The table."""
    first = int(os.environ.get("ANCHORS_FIRST", "20000"))
    count = int(os.environ.get("ANCHORS_LOOPS", "100"))
    chosen = {one.label: one for one in rows()}
    hanging, level = chosen["servo, motor encoder"], chosen["servo, horizontal"]
    at_link = level._replace(scenario=geared(level.scenario, measured="link"))
    others = {"two masses, smoothed": smoothed, "`extended`, a dead zone": zone}
    cases = {
        "hanging, encoder at the motor": (hanging, others),
        "level, encoder at the motor": (level, others),
        "level, encoder at the link": (at_link, {"`kalman`, a play": play}),
    }
    columns = ("servo", "filter", "link^ [mrad]: median (95 %)", "gaps within 5 %, 10 %")
    more = ("gap's error, median", "95 % interval of the gap holds", "beyond 5 std", "flagged")
    lines = ["## Gears, and filters that do not know them\n", NOTE, *head(*columns, *more)]
    for name, (one, makers) in cases.items():
        filters = {label: make(one.scenario) for label, make in makers.items()}
        seeds = range(first, first + count)
        arms = [(seed, one.draw(np.random.default_rng(seed))) for seed in seeds]
        for label, found in _rows(bench(one.scenario), filters, arms).items():
            lines.append(row(name, label, *_cells(found)))
    return "\n".join([*lines, ""])
