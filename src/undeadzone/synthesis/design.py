"""A design as a value: gains, their proof, what they are worth, what can be known; kept in TOML, proved again on load."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import msgspec
import numpy as np

from undeadzone.analysis.certificate.design_file import Design, Point
from undeadzone.analysis.certificate.passivity import certify
from undeadzone.analysis.convergence.floquet import rates
from undeadzone.controllers import StateFeedback
from undeadzone.errors import InputError, StructureError
from undeadzone.observers import Certified
from undeadzone.scenario.problem import Problem, constant_gains, resolve_scenario, systems
from undeadzone.scenario.schema import Scenario
from undeadzone.support.arrays import Floats
from undeadzone.synthesis.criteria import make_task
from undeadzone.synthesis.gain_search import (
    RATE,
    ROUNDS,
    STARTS,
    Candidate,
    Weights,
    balanced,
    candidate_of,
    fastest,
)
from undeadzone.synthesis.knowledge import determined, knowledge


def design(
    scenario: Scenario,
    maximise: Literal["knee", "rate"] | Weights = "knee",
    *,
    margin: float = 0.01,
    seed: int = 0,
    progress: Callable[[int], None] | None = None,
) -> Design:
    """Gains for a scenario's model along its reference: the knee of the trade, the fastest, or the best for given weights.

    Certified with `margin`. progress is called with the number of rounds just done, `rounds(maximise)` in all. Raises
    StructureError where no gains can be certified, InputError where there is nothing to plan on.
    """
    _, flow, _ = systems(scenario)
    if flow.nonlinear or scenario.sensor.kind == "jump":
        what = "plant: a nonlinear plant" if flow.nonlinear else "sensor.kind: a jump sensor"
        raise InputError(
            f"{what} has no automatic design; choose gains and judge them by simulation"
        )
    if not isinstance(scenario.controller, StateFeedback):
        raise InputError("controller.method: a design plans on z = r; use state_feedback")
    if reason := certify(flow.linear, np.zeros((flow.n, flow.p)), np.ones(flow.p)).reason:
        raise StructureError(f"plant: no gains can be certified: {reason}")
    problem = resolve_scenario(
        msgspec.structs.replace(
            scenario, observer=Certified(L=[[0.0] * flow.p] * flow.n, gamma=0.0)
        )
    )
    task = make_task(problem, margin)
    present = _present(scenario, problem)
    before = None if present is None else candidate_of(task, *present)
    linear = problem.model.linear
    if maximise == "knee":
        found = balanced(task, linear, before, seed, progress)
    else:
        found = fastest(
            task, linear, maximise if isinstance(maximise, Weights) else RATE, seed, progress
        )
    proof = found.certificate
    schedule = task.whole
    return Design(
        title=scenario.title,
        chosen=maximise
        if isinstance(maximise, str)
        else "rate / ("
        + " ".join(f"{name}^{power:g}" for name, power in maximise._asdict().items())
        + ")",
        seed=seed,
        Ts=problem.model.Ts,
        A=linear.A.tolist(),
        B=linear.B.tolist(),
        C=linear.C.tolist(),
        K=problem.controller.params.K.tolist(),
        P=proof.P.tolist(),
        W=proof.W.tolist(),
        margin=proof.margin,
        frequency=proof.frequency,
        never=list(rates(linear, found.best.L, found.best.gamma, schedule).never),
        states=determined(problem, schedule),
        remarks=list(found.remarks),
        best=_point(found.best),
        present=None if before is None else _point(before),
        identifiable=knowledge(problem, schedule, None),
        front=[_point(candidate) for candidate in found.front],
    )


def rounds(maximise: Literal["knee", "rate"] | Weights) -> int:
    """How many rounds `design` reports to its progress callback."""
    return STARTS + (ROUNDS if maximise == "knee" else 0)


def _present(scenario: Scenario, problem: Problem) -> tuple[Floats, Floats] | None:
    """The scenario's own gains, if they are certified."""
    if not isinstance(scenario.observer, Certified):
        return None
    gains = constant_gains(scenario.observer.build(problem.model, problem.sensor), problem.model)
    return (
        gains
        if gains is not None and certify(problem.model.linear, *gains, problem.model.Ts).certified
        else None
    )


def _point(candidate: Candidate) -> Point:
    numbers = candidate._asdict()
    return Point(**numbers | {"L": candidate.L.tolist(), "gamma": candidate.gamma.tolist()})
