"""Operations of a UR5's dynamics, of the filters that watch it and of the controllers that drive it, one sample of each."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import casadi as ca

from benchmarks.coverage import row
from undeadzone import sensor
from undeadzone.controllers import LQR, ComputedTorque, GravityPD
from undeadzone.feedforward.targets import Target
from undeadzone.observers import Estimate, Extended, Reading
from undeadzone.plants.build import system
from undeadzone.plants.options import Plant
from undeadzone.plants.robots.arm import acceleration
from undeadzone.plants.robots.options import URDF
from undeadzone.plants.system import System, sampled
from undeadzone.sensor import Sensor, resolve
from undeadzone.support import tree

UR5 = Path(__file__).parents[1] / "examples" / "ur5.urdf"
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
    if importlib.util.find_spec("adam") is None:
        return "## Operations of a six-joint arm\n\nNot counted: adam-robotics is not installed.\n"
    arm = sampled(system(Plant(arm=URDF(path=str(UR5)))), STEP, 1)
    counts = {"forward dynamics of the links": dynamics(arm)}
    counts |= {
        label: watching(arm, Extended(right=[0.02, 0.15], x_std=0.02, disturbance=0.5, **options))
        for label, options in FILTERS.items()
    }
    counts |= {label: driving(arm, options) for label, options in CONTROLLERS.items()}
    lines = [row(label, str(count)) for label, count in counts.items()]
    return "\n".join(
        [
            "## Operations of a six-joint arm\n",
            row("UR5, one sample", "operations"),
            row("---", "---"),
            *lines,
            "",
        ]
    )


def dynamics(arm: System) -> int:
    """Numbers of the file known, payload and friction 0."""
    assert arm.arm is not None
    q, v, u = (ca.SX.sym(name, arm.p) for name in "qvu")
    return int(
        ca.Function(
            "dynamics", [q, v, u], [acceleration(arm.arm, arm.params, q, v, u)], {"cse": True}
        ).n_instructions()
    )


def watching(arm: System, options: Extended) -> int:
    where = resolve(Sensor(right=0.15, left=0.15, noise=1e-3), arm.p, STEP)
    observer = options.build(arm, where)
    numbers, params = tree.symbols(observer.params, "p")
    column, state = tree.symbols(observer.init(observer.params), "s")
    u, y = ca.SX.sym("u", arm.m), ca.SX.sym("y", arm.p)
    after, estimate = observer.step(params, state, u, Reading(y, sensor.side(y, where.threshold)))
    step = ca.Function(
        "watching",
        [column, u, y, numbers],
        [tree.stack(after), ca.vertcat(*estimate)],
        {"cse": True},
    )
    return int(step.n_instructions())


def driving(arm: System, options: Any) -> int:
    """The law alone, what is planned before the run being given."""
    controller = options.build(arm)
    numbers, params = tree.symbols(controller.params, "p")
    x, x_ref, u_ff, r, plan = (
        ca.SX.sym(*given)
        for given in [
            ("x", arm.n),
            ("x_ref", arm.n),
            ("u_ff", arm.m),
            ("r", arm.p),
            ("plan", controller.planned),
        ]
    )
    none = ca.SX(0, 1)
    _, u = controller.step(
        params,
        None,
        Estimate(x, none, none, none, none, none, w=none),
        Target(r, x_ref, u_ff, plan),
    )
    return int(
        ca.Function(
            "driving", [x, x_ref, u_ff, r, plan, numbers], [u], {"cse": True}
        ).n_instructions()
    )


if __name__ == "__main__":
    print(table())
