"""From the signals of a run to a `Run`: its verdicts, its certificate, the tip of an arm."""

from __future__ import annotations

import time

import numpy as np

from undeadzone.analysis.certificate.passivity import Certificate, certify
from undeadzone.analysis.identifiability.linear import DIRECTIONS, Verdict, unknown_bias, verdicts
from undeadzone.analysis.side_schedule import recorded
from undeadzone.feedforward.targets import flat_targets
from undeadzone.plants.robots.arm import evaluate_rows
from undeadzone.scenario.problem import Problem, constant_gains
from undeadzone.simulation.loop import Outputs
from undeadzone.simulation.run import FRAMES, Info, Run
from undeadzone.support.arrays import Floats


def verdicts_of_run(problem: Problem, signal: Outputs) -> list[Verdict]:
    """What a run's readings tell of each output's widths; of a nonlinear plant along the run, given what the observer is told of its start."""
    sensor, disturbance, step = (
        problem.sensor,
        problem.scenario.disturbance,
        problem.scenario.simulation.step,
    )
    if not problem.plant.nonlinear:
        schedule = recorded(signal.z, sensor, step, problem.model.Ts)
        return verdicts(
            problem.model.linear,
            schedule,
            unknown_bias(disturbance, problem.model.linear.B),
            sensor.kind == "jump",
        )
    from undeadzone.analysis.identifiability.nonlinear import verdicts_along

    observer, bias = problem.scenario.observer, unknown_bias(disturbance, np.eye(problem.plant.m))
    uncertain = tuple(getattr(observer, "uncertain", ()))

    def given(start_std: Floats | None) -> list[Verdict]:
        return verdicts_along(
            problem.plant,
            signal.x,
            signal.u,
            signal.z,
            sensor,
            step,
            bias,
            uncertain,
            start_std,
        )

    start = getattr(observer, "x_std", None) if hasattr(observer, "start") else None
    alone = given(None)
    if start is None:
        return alone
    homed = given(np.broadcast_to(np.asarray(start, float), problem.plant.n))
    return [_homed(*pair) for pair in zip(alone, homed, strict=True)]


def _homed(alone: Verdict, homed: Verdict) -> Verdict:
    """The verdict with a declared start, which says what nothing else tells."""
    gained = [name for name in DIRECTIONS if getattr(homed, name) and not getattr(alone, name)]
    return homed._replace(
        reasons=(
            *homed.reasons,
            *[f"{', '.join(gained)} from the declared start alone"] * bool(gained),
        )
    )


def tips(problem: Problem, x: Floats, x_hat: Floats, t: Floats) -> dict[str, Floats]:
    """Where an arm's tip is, is believed to be, and should be (N x 2 or 3 each) [m]; nothing without an arm."""
    body = problem.plant.arm
    if body is None or problem.path is None:
        return {}
    x_ref = flat_targets(problem.flow, problem.path, problem.tracked, t).x_ref
    places = {
        "tip": (problem.plant, x),
        "tip_hat": (problem.model, x_hat),
        "tip_r": (problem.model, x_ref),
    }
    return {
        name: evaluate_rows(body.tip, system.params, q[:, : body.size])
        for name, (system, q) in places.items()
    }


def _poses(problem: Problem, x: Floats, t: Floats) -> dict[str, Floats]:
    body = problem.plant.arm
    if body is None:
        return {}
    frames = np.searchsorted(t, np.arange(0, t[-1] + 1e-9, 1 / FRAMES) - 1e-9)
    return {"poses": evaluate_rows(body.points, problem.plant.params, x[frames, : body.size])}


def certificate(problem: Problem) -> Certificate | None:
    """The proof that V never rises, for observers with constant gains L, gamma on a linear model; else None."""
    gains = constant_gains(problem.observer, problem.model)
    return (
        None
        if gains is None or problem.model.nonlinear
        else certify(problem.model.linear, *gains, problem.model.Ts)
    )


def collect(problem: Problem, signal: Outputs, error: float | None, began: float) -> Run:
    """The run whose signals these are, begun at that reading of the performance counter; error: of the integration."""
    scenario = problem.scenario
    t = np.arange(problem.steps + 1) * scenario.simulation.step
    d_hat, d_std = (
        np.stack(pair, axis=2).reshape(t.size, -1)
        for pair in ((signal.right, signal.left), (signal.right_std, signal.left_std))
    )
    optional = {
        "x_std": signal.x_std,
        "d_std": d_std,
        "width_std": signal.width_std,
        "innovation_std": signal.innovation_std,
        "w_hat": signal.w_hat,
    }
    optional |= {"theta_hat": signal.theta_hat, "theta_std": signal.theta_std}
    truth = np.stack([problem.sensor.right, problem.sensor.left], axis=1).ravel()
    proof = certificate(problem)
    V = None
    if proof is not None and proof.certified:
        # A width that is wrong and not adapted disturbs for ever: no V. A jump sensor's widths do not enter.
        d_error = truth - d_hat if problem.sensor.kind == "deadzone" else np.zeros_like(d_hat)
        adapted = np.repeat(problem.observer.params.gamma > 0, 2)
        V = (
            proof.V.value(signal.x - signal.x_hat, d_error)
            if (adapted | (d_error == 0)).all()
            else None
        )
    return Run(
        t=t, x=signal.x, z=signal.z, y=signal.y, side=signal.side, x_hat=signal.x_hat, z_hat=signal.z_hat, d_hat=d_hat,
        z_inverse=signal.z_inverse, innovation=signal.innovation, u=signal.u,
        r=problem.reference.value(t), V=V,
        info=Info(
            title=scenario.title,
            method=str(type(scenario.observer).__struct_config__.tag),
            time=scenario.simulation.time,
            step=scenario.simulation.step,
            tracked=problem.tracked,
            widths=truth.tolist(),
            threshold=problem.sensor.threshold.tolist(),
            certified=None if proof is None else proof.certified,
            integration_error=error,
            identifiable=[verdict._asdict() | {"reasons": list(verdict.reasons)} for verdict in verdicts_of_run(problem, signal)],
            seconds=time.perf_counter() - began,
            units=scenario.units,
            uncertain={name: float(np.ravel(problem.plant.params)[problem.plant.names.index(name)]) for name in getattr(scenario.observer, "uncertain", {})},
            joints=[] if problem.plant.arm is None else list(problem.plant.arm.chain.joints),
        ),
        **tips(problem, signal.x, signal.x_hat, t),
        **_poses(problem, signal.x, t),
        **{name: value for name, value in optional.items() if value.size},
    )  # fmt: skip
