"""What a scenario's own gains are worth and what its readings can tell, with the reasons."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from undeadzone.arrays import finite
from undeadzone.controllers import StateFeedback
from undeadzone.design.floquet import rates
from undeadzone.design.identifiability import DIRECTIONS, cures, invisible, unknown_bias, verdicts
from undeadzone.design.information import deviations
from undeadzone.design.passivity import Certificate, certify
from undeadzone.design.robust import l2_gain
from undeadzone.design.schedule import Schedule, planned, recorded
from undeadzone.design.vertices import certify_on
from undeadzone.problem import Problem, constant_gains, resolve_scenario
from undeadzone.region import Box, box
from undeadzone.scenario import Scenario
from undeadzone.signals import Random


class Known(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What one output's readings can tell: verdicts, reasons for each 'no', cures, expected standard deviations [z]."""

    right: bool
    left: bool
    width: bool
    centre: bool
    reasons: list[str]
    cures: list[str]
    std: dict[str, float]


def check(scenario: Scenario) -> dict[str, Any]:
    """What a scenario's own gains are worth, ready for JSON; lists where there are several outputs.

    certified (None where the method has no constant gains), margin, frequency [rad/s]; l2_gain {disturbance, noise}:
    BIBO in numbers, int |z - z^|^2 <= V(0) + disturbance^2 int |w|^2 + noise^2 int |v|^2 for every sequence of sides, w
    at the input and v on y (each the least with the other absent; None if not proved); rate [1/s], time_constant [s],
    never: errors that stay; states: which are determined; identifiable {right, left, width, centre}, std of the same
    [z]; reasons for every 'no', cures. A nonlinear model is certified on the scenario's region; left_region [s]: when a run of the
    scenario first leaves that, None if it does not. Numbers that are not finite are None. Raises InputError and its kinds, as `simulate` does.
    """
    problem = resolve_scenario(scenario)
    schedule = plan(problem)
    known = knowledge(problem, schedule)
    absent: dict[str, Any] = dict.fromkeys(("certified", "margin", "frequency", "l2_gain", "rate", "time_constant", "left_region"))
    summary = {"title": scenario.title, **absent, "never": [], "states": determined(problem, schedule)}
    reasons = []
    gains = constant_gains(problem.observer, problem.model)
    if gains is None:
        reasons.append("no certificate and no rate: the observer has no constant gains L, gamma")
    elif problem.model.nonlinear and scenario.region is None:
        reasons.append("no certificate and no rate: the model is nonlinear; certificates of such models hold on a declared [region]")
    elif problem.model.nonlinear and scenario.region is not None:
        within = box(scenario.region, problem.model)
        proof = certify_on(problem.model, *gains, within)
        summary |= {"certified": proof.certified, "margin": proof.margin, "left_region": _left(scenario, within)}
        reasons += [f"not certified: {proof.reason}"] * (not proof.certified)
    else:
        proof = certify(problem.model.linear, *gains, problem.model.Ts)
        speed = rates(problem.model.linear, *gains, schedule, problem.sensor.kind == "jump")
        summary |= {
            "certified": proof.certified,
            "margin": proof.margin,
            "frequency": proof.frequency,
            "l2_gain": _bounded(proof, problem) if proof.certified else None,
            "rate": speed.rate,
            "time_constant": speed.time_constant,
            "never": list(speed.never),
        }
        reasons += [f"not certified: {proof.reason}"] * (not proof.certified) + ["the error grows along the reference"] * (speed.rate < 0)
    several = len(known) > 1
    identifiable = [{name: getattr(k, name) for name in DIRECTIONS} for k in known]
    std = [k.std for k in known]
    reasons += [f"output {i}: {reason}" if several else reason for i, k in enumerate(known) for reason in k.reasons]
    told = {
        "identifiable": identifiable if several else identifiable[0],
        "std": std if several else std[0],
        "reasons": reasons,
        "cures": [cure for k in known for cure in k.cures],
    }
    return dict(finite(summary | told))


def _bounded(proof: Certificate, problem: Problem) -> dict[str, float] | None:
    """The least L2 gains from the input's disturbance and from noise on the reading to z - z^, each alone; None if one has no proof."""
    model = problem.model
    push = l2_gain(proof.dynamics, E=model.linear.B / (model.Ts or 1.0))
    noisy = l2_gain(proof.dynamics, noise=1 / problem.sensor.slope)
    return {"disturbance": push.disturbance, "noise": noisy.noise} if push.check.proved and noisy.check.proved else None


def _left(scenario: Scenario, within: Box) -> float | None:
    """The time [s] at which state, estimate or input first leave a box; None if they stay."""
    from undeadzone.simulation import simulate

    run = simulate(scenario, check_step=False)
    outside = np.flatnonzero(within.left(run.x, run.x_hat, run.u))
    return float(run.t[outside[0]]) if outside.size else None


def plan(problem: Problem) -> Schedule:
    """The sides along the reference where the controller makes z follow it, else along a simulated run."""
    if isinstance(problem.scenario.controller, StateFeedback):
        return planned(problem.model, problem.reference, problem.tracked, problem.sensor, problem.scenario.simulation.duration)
    from undeadzone.simulation import simulate

    run = simulate(problem.scenario, check_step=False)
    return recorded(run.z, problem.sensor, run.info.step, problem.model.Ts)


def knowledge(problem: Problem, schedule: Schedule) -> list[Known]:
    """What can be known of each output, and how well after the scenario's duration with its sensor noise.

    A step, or the offset of sines, as disturbance counts as an unknown bias; a random one as white process noise of its
    low-frequency density, 2 rms^2 times its correlation time.
    """
    model, sensor, scenario = problem.model, problem.sensor, problem.scenario
    linear, jump = model.linear, sensor.kind == "jump"
    bias, process = unknown_bias(scenario.disturbance, linear.B), None
    if isinstance(scenario.disturbance, Random):
        density = 2 * np.asarray(scenario.disturbance.rms, float) ** 2 * scenario.disturbance.correlation_time
        process = linear.B * np.broadcast_to(density, model.m) @ linear.B.T / (1.0 if model.Ts is None else model.Ts)
    found = verdicts(linear, schedule, bias, jump)
    help_ = cures(linear, schedule, bias, jump)
    std = [{} for _ in found] if jump else deviations(linear, schedule, sensor.rms, scenario.simulation.step, scenario.simulation.duration, bias, process).widths
    return [
        Known(**verdict._asdict() | {"reasons": list(verdict.reasons), "std": std[i]}, cures=[cure.text for cure in help_ if cure.output == i])
        for i, verdict in enumerate(found)
    ]


def determined(problem: Problem, schedule: Schedule) -> list[bool]:
    """Which states the readings along a schedule determine."""
    linear = problem.model.linear
    bias = unknown_bias(problem.scenario.disturbance, linear.B)
    hidden = invisible(linear, schedule.visited(problem.model.n), schedule.Ts, bias, problem.sensor.kind == "jump")
    return [hidden.state(i) for i in range(problem.model.n)]
