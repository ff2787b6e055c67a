"""What a scenario's own gains are worth and what its readings can tell, with the reasons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from undeadzone.analysis.certificate.design_file import Knowledge
from undeadzone.analysis.certificate.passivity import Certificate
from undeadzone.analysis.certificate.polytopic import certify_on
from undeadzone.analysis.certificate.robust import l2_gain
from undeadzone.analysis.identifiability.linear import DIRECTIONS
from undeadzone.plants.region import Box, box
from undeadzone.scenario.problem import Problem, constant_gains, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.run import Run
from undeadzone.support.arrays import Floats, finite
from undeadzone.synthesis.assessment import Assessment, Gains, assess
from undeadzone.synthesis.knowledge import determined

PROOF = (
    "certified",
    "margin",
    "frequency",
    "l2_gain",
    "rate",
    "time_constant",
    "left_region",
)  # what `check` says of the gains, None where it cannot


def check(scenario: Scenario) -> dict[str, Any]:
    """What a scenario's own gains are worth, ready for JSON; lists where there are several outputs.

    Args:
        scenario: whose observer's gains are checked, as they stand.

    Returns:
        Numbers that are not finite are None. By key:

        - certified: whether one V proves convergence for every sequence of sides; None where the
            method has no constant gains. A nonlinear model is certified on the scenario's region.
        - margin, frequency [rad/s]: of the proof.
        - l2_gain {disturbance, noise}: BIBO in numbers, int |z - z^|^2 <= V(0) + disturbance^2
            int |w|^2 + noise^2 int |v|^2 for every sequence of sides, w at the input and v on y
            (each the least with the other absent; None if not proved).
        - rate [1/s], time_constant [s]: of the error along the reference.
        - never: errors that stay.
        - states: which are determined (none are listed of a nonlinear model).
        - identifiable {right, left, width, centre}: what the readings can tell.
        - std: standard deviations of the same [z].
        - listens: the share of a z 5 % larger than the model says that z^ follows; below a half the
            model is taken on trust.
        - reasons: for every 'no'.
        - cures: what would help.
        - left_region [s]: when a run of the scenario first leaves the region, None if it does not.

    Raises:
        InputError: or a subclass, as `simulate` does.
    """
    return summary(assess(resolve_scenario(scenario), listen=True))


def summary(assessment: Assessment) -> dict[str, Any]:
    """What `check` says of an assessment."""
    problem, known = assessment.problem, assessment.known
    proved, reasons = _proof(assessment)
    several = len(known) > 1
    identifiable = [{name: getattr(one, name) for name in DIRECTIONS} for one in known]
    std = [one.std for one in known]
    cures: list[str] = []
    for one in known:
        cures += one.cures
    return dict(
        finite(
            {
                "title": problem.scenario.title,
                **dict.fromkeys(PROOF),
                "never": [],
                "states": determined(problem, assessment.schedule),
                **proved,
                "identifiable": identifiable if several else identifiable[0],
                "std": std if several else std[0],
                "listens": _listens(assessment),
                "reasons": reasons + _reasons_of_outputs(known),
                "cures": cures,
            }
        )
    )


def _listens(assessment: Assessment) -> Any:
    """How strongly readings move each z^; None where it was not measured."""
    listens = list(assessment.listens)
    return listens if len(listens) > 1 else next(iter(listens), None)


def affirmed(summary: Mapping[str, Any]) -> bool:
    """Whether `check` says yes to everything.

    That is: the gains are certified (observers without constant gains need not be), no run leaves
    the region, and every width can be identified.

    Args:
        summary: what `check` said.
    """
    identifiable = summary["identifiable"]
    verdicts = identifiable if isinstance(identifiable, list) else [identifiable]
    covered = summary["certified"] is not False and summary["left_region"] is None
    return covered and all(verdict["right"] and verdict["left"] for verdict in verdicts)


def _proof(assessment: Assessment) -> tuple[dict[str, Any], list[str]]:
    """What is proved of an assessment's gains, and the reasons where it is not."""
    problem, gains = assessment.problem, assessment.gains
    constant = constant_gains(problem.observer, problem.model)
    if constant is None:
        return {}, ["no certificate and no rate: the observer has no constant gains L, gamma"]
    if gains is not None:
        return _proof_of_linear(problem, gains)
    if problem.scenario.region is None:
        return {}, [
            "no certificate and no rate: the model is nonlinear; certificates of such models hold "
            "on a declared [region]"
        ]
    return _proof_on_region(assessment, *constant)


def _proof_of_linear(problem: Problem, gains: Gains) -> tuple[dict[str, Any], list[str]]:
    """What is proved of constant gains on a linear model, and the reasons where it is not."""
    proof, speed = gains.certificate, gains.rates
    reasons = []
    if not proof.certified:
        reasons.append(f"not certified: {proof.reason}")
    if speed.rate < 0:
        reasons.append("the error grows along the reference")
    return {
        "certified": proof.certified,
        "margin": proof.margin,
        "frequency": proof.frequency,
        "l2_gain": _bounded(proof, problem) if proof.certified else None,
        "rate": speed.rate,
        "time_constant": speed.time_constant,
        "never": list(speed.never),
    }, reasons


def _proof_on_region(
    assessment: Assessment, L: Floats, gamma: Floats
) -> tuple[dict[str, Any], list[str]]:
    """What is proved of constant gains on a nonlinear model's region, and the reasons if not."""
    problem = assessment.problem
    region = problem.scenario.region
    assert region is not None
    ranges = box(region, problem.model)
    proof = certify_on(problem.model, L, gamma, ranges)
    reasons = [] if proof.certified else [f"not certified: {proof.reason}"]
    return {
        "certified": proof.certified,
        "margin": proof.margin,
        "left_region": _left(assessment.run, ranges),
    }, reasons


def _reasons_of_outputs(known: Sequence[Knowledge]) -> list[str]:
    """Why not all is known of each output, which is named where there are several."""
    reasons = []
    for i, one in enumerate(known):
        prefix = f"output {i}: " if len(known) > 1 else ""
        reasons += [f"{prefix}{reason}" for reason in one.reasons]
    return reasons


def _bounded(proof: Certificate, problem: Problem) -> dict[str, float] | None:
    """The least L2 gains to z - z^, each with the other input absent; None if one has no proof.

    They are those from a disturbance of the input and from noise on the reading.
    """
    model = problem.model
    disturbed = l2_gain(proof.dynamics, E=model.linear.B / (model.Ts or 1.0))
    noisy = l2_gain(proof.dynamics, noise=1 / problem.sensor.slope)
    if not (disturbed.check.proved and noisy.check.proved):
        return None
    return {"disturbance": disturbed.disturbance, "noise": noisy.noise}


def _left(run: Run | None, ranges: Box) -> float | None:
    """The time [s] at which state, estimate or input of a run first leave a box; None: never."""
    assert run is not None
    outside = np.flatnonzero(ranges.left(run.x, run.x_hat, run.u))
    return float(run.t[outside[0]]) if outside.size else None
