"""What a scenario's own gains are worth and what its readings can tell, with the reasons."""

from __future__ import annotations

from typing import Any

import numpy as np

from undeadzone.analysis.certificate.passivity import Certificate
from undeadzone.analysis.certificate.polytopic import certify_on
from undeadzone.analysis.certificate.robust import l2_gain
from undeadzone.analysis.identifiability.linear import DIRECTIONS
from undeadzone.plants.region import Box, box
from undeadzone.scenario.problem import Problem, constant_gains, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.run import Run
from undeadzone.support.arrays import finite
from undeadzone.synthesis.assessment import Assessment, assess
from undeadzone.synthesis.knowledge import determined


def check(scenario: Scenario) -> dict[str, Any]:
    """What a scenario's own gains are worth, ready for JSON; lists where there are several outputs.

    certified (None where the method has no constant gains), margin, frequency [rad/s]; l2_gain {disturbance, noise}:
    BIBO in numbers, int |z - z^|^2 <= V(0) + disturbance^2 int |w|^2 + noise^2 int |v|^2 for every sequence of sides, w
    at the input and v on y (each the least with the other absent; None if not proved); rate [1/s], time_constant [s],
    never: errors that stay; states: which are determined (none are listed of a nonlinear model); identifiable {right, left, width, centre}, std of the same
    [z]; reasons for every 'no', cures. A nonlinear model is certified on the scenario's region; left_region [s]: when a run of the
    scenario first leaves that, None if it does not. Numbers that are not finite are None. Raises InputError and its kinds, as `simulate` does.
    """
    return summary(assess(resolve_scenario(scenario)))


def summary(of: Assessment) -> dict[str, Any]:
    """What `check` says of an account."""
    problem, schedule, known, gains = of.problem, of.schedule, of.known, of.gains
    absent: dict[str, Any] = dict.fromkeys(
        ("certified", "margin", "frequency", "l2_gain", "rate", "time_constant", "left_region")
    )
    found = {
        "title": problem.scenario.title,
        **absent,
        "never": [],
        "states": determined(problem, schedule),
    }
    reasons = []
    constant = constant_gains(problem.observer, problem.model)
    if constant is None:
        reasons.append("no certificate and no rate: the observer has no constant gains L, gamma")
    elif gains is not None:
        proof, speed = gains.certificate, gains.rates
        found |= {
            "certified": proof.certified,
            "margin": proof.margin,
            "frequency": proof.frequency,
            "l2_gain": _bounded(proof, problem) if proof.certified else None,
            "rate": speed.rate,
            "time_constant": speed.time_constant,
            "never": list(speed.never),
        }
        reasons += [f"not certified: {proof.reason}"] * (not proof.certified) + [
            "the error grows along the reference"
        ] * (speed.rate < 0)
    elif problem.scenario.region is None:
        reasons.append(
            "no certificate and no rate: the model is nonlinear; certificates of such models hold on a declared [region]"
        )
    else:
        within = box(problem.scenario.region, problem.model)
        proof = certify_on(problem.model, *constant, within)
        found |= {
            "certified": proof.certified,
            "margin": proof.margin,
            "left_region": _left(of.run, within),
        }
        reasons += [f"not certified: {proof.reason}"] * (not proof.certified)
    several = len(known) > 1
    identifiable = [{name: getattr(k, name) for name in DIRECTIONS} for k in known]
    std = [k.std for k in known]
    reasons += [
        f"output {i}: {reason}" if several else reason
        for i, k in enumerate(known)
        for reason in k.reasons
    ]
    told = {
        "identifiable": identifiable if several else identifiable[0],
        "std": std if several else std[0],
        "reasons": reasons,
        "cures": [cure for k in known for cure in k.cures],
    }
    return dict(finite(found | told))


def _bounded(proof: Certificate, problem: Problem) -> dict[str, float] | None:
    """The least L2 gains from the input's disturbance and from noise on the reading to z - z^, each alone; None if one has no proof."""
    model = problem.model
    push = l2_gain(proof.dynamics, E=model.linear.B / (model.Ts or 1.0))
    noisy = l2_gain(proof.dynamics, noise=1 / problem.sensor.slope)
    return (
        {"disturbance": push.disturbance, "noise": noisy.noise}
        if push.check.proved and noisy.check.proved
        else None
    )


def _left(run: Run | None, within: Box) -> float | None:
    """The time [s] at which state, estimate or input of a run first leave a box; None if they stay."""
    assert run is not None
    outside = np.flatnonzero(within.left(run.x, run.x_hat, run.u))
    return float(run.t[outside[0]]) if outside.size else None
