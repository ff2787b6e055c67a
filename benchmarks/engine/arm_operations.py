"""Operations of one sample: of a UR5's dynamics, of its filters and of its controllers."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import casadi as ca

from benchmarks.markdown import row
from undeadzone.controllers import LQR, ComputedTorque
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Estimate, Reading
from undeadzone.nonlinearities import sensor
from undeadzone.nonlinearities.sensor import Sensor, resolve
from undeadzone.observers import Extended
from undeadzone.plants.build import system
from undeadzone.plants.options import URDF, Plant
from undeadzone.plants.robots.arm import forward_dynamics
from undeadzone.plants.system import System, sample_plant
from undeadzone.util import tree
from undeadzone_arena import GravityPD

UR5 = Path(__file__).parents[2] / "examples" / "ur5.urdf"
STEP = 1e-3  # [s]
FILTERS: dict[str, dict[str, Any]] = {
    "`extended`, separate joints, silence not heard": {"joints": "separate", "silence": False},
    "`extended`, separate joints": {"joints": "separate"},
    "`extended`": {},
}
CONTROLLERS = {
    "`lqr`": LQR(),
    "`gravity_pd`": GravityPD(k_p=200.0, k_d=2.0),
    "`computed_torque`": ComputedTorque(bandwidth=10.0),
}


def table() -> str:
    """Every count."""
    if importlib.util.find_spec("adam") is None:
        return "## Operations of a six-joint arm\n\nNot counted: adam-robotics is not installed.\n"
    arm = sample_plant(system(Plant(arm=URDF(path=str(UR5)))), STEP, 1)
    lines = [
        "## Operations of a six-joint arm\n",
        row("UR5, one sample", "operations"),
        row("---", "---"),
        row("forward dynamics of the links", str(dynamics(arm))),
    ]
    for label, options in FILTERS.items():
        configured = Extended(right=[0.02, 0.15], x_std=0.02, disturbance=0.5, **options)
        lines.append(row(label, str(watching(arm, configured))))
    for label, options in CONTROLLERS.items():
        lines.append(row(label, str(driving(arm, options))))
    return "\n".join([*lines, ""])


def dynamics(arm: System) -> int:
    """Numbers of the file known, payload and friction 0."""
    assert arm.arm is not None
    q, v, u = (ca.SX.sym(name, arm.p) for name in "qvu")
    return _operations([q, v, u], [forward_dynamics(arm.arm, arm.params, q, v, u)])


def _operations(inputs: list[Any], outputs: list[Any]) -> int:
    """Instructions of a graph."""
    return int(ca.Function("counted", inputs, outputs, {"cse": True}).n_instructions())


def watching(arm: System, options: Extended) -> int:
    """Of one step of a filter."""
    where = resolve(Sensor(right=0.15, left=0.15, noise=1e-3), arm.p, STEP)
    observer = options.build(arm, where)
    numbers, params = tree.create_symbols(observer.params, "p")
    column, state = tree.create_symbols(observer.init(observer.params), "s")
    u, y = ca.SX.sym("u", arm.m), ca.SX.sym("y", arm.p)
    after, estimate = observer.step(params, state, u, Reading(y, sensor.side(y, where.threshold)))
    return _operations([column, u, y, numbers], [tree.stack_leaves(after), ca.vertcat(*estimate)])


def driving(arm: System, options: Any) -> int:
    """The law alone, what is planned before the run being given."""
    controller = options.build(arm)
    numbers, params = tree.create_symbols(controller.params, "p")
    x, x_ref = ca.SX.sym("x", arm.n), ca.SX.sym("x_ref", arm.n)
    u_ff, r = ca.SX.sym("u_ff", arm.m), ca.SX.sym("r", arm.p)
    plan = ca.SX.sym("plan", controller.plan_size)
    none = ca.SX(0, 1)
    estimate = Estimate(x, none, none, none, none, none, w=none)
    _, u = controller.step(params, None, estimate, Target(r, x_ref, u_ff, plan))
    return _operations([x, x_ref, u_ff, r, plan, numbers], [u])
