"""Gains for a scenario, found under a certificate: the function `design`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, get_args

import msgspec
import numpy as np

from undeadzone.analysis.certificate.design_file import Design, Point
from undeadzone.analysis.certificate.passivity import certify
from undeadzone.analysis.convergence.floquet import error_decay_rates
from undeadzone.controllers import StateFeedback
from undeadzone.errors import InputError, StructureError
from undeadzone.observers import Certified
from undeadzone.plants.system import System
from undeadzone.scenario.problem import Problem, constant_gains, resolve_scenario, systems
from undeadzone.scenario.schema import Scenario
from undeadzone.util.arrays import Floats, require_number, require_seed
from undeadzone.util.files import SCHEMA
from undeadzone.util.progress import notebook_progress
from undeadzone_design.synthesis import gain_search
from undeadzone_design.synthesis.assessment import assess_identifiability, find_determined_states
from undeadzone_design.synthesis.task import Candidate, build_task, score_candidate

AIMS = Literal["knee", "rate"]
Aim = AIMS | gain_search.Weights


def design(
    scenario: Scenario,
    maximise: Aim = "knee",
    *,
    margin: float = 0.01,
    seed: int = 0,
    progress: Callable[[int], None] | None = None,
) -> Design:
    """Find gains L, gamma for a scenario's model along its reference, with a proof.

    Args:
        scenario: whose plant (or model), sensor and reference are planned on.
        maximise: "knee" of the trade between rate, disturbance and noise, "rate" alone, or
            `Weights`, the best for rate / (disturbance^a mismatch^b noise^c).
        margin: least margin of the certificate, between 0 and 1.
        seed: of the search. The same seed gives the same gains.
        progress: called with the number of rounds just done, `count_design_rounds` in all (None: a
            bar in a notebook).

    Returns:
        The gains, their proof, their scores, and the identifiability.

    Raises:
        StructureError: no gains can be certified.
        InputError: or a subclass, if there is nothing to plan on.

    Example:
        >>> found = uz.design(
        ...     uz.Scenario(
        ...         plant=uz.Plant(A=[[-1.0]], B=[1.0], C=[1.0]),
        ...         sensor=sensor,
        ...         reference=reference,
        ...         observer=uz.Certified(),
        ...     ),
        ...     maximise="rate",
        ... )
        >>> found.margin > 0
        True

    See Also:
        check, Certified
    """
    _require_aim(maximise)
    _, flow, _ = systems(scenario)
    _require_linear_task(scenario, flow)
    reason = why_not_certifiable(flow)
    if reason:
        raise StructureError(f"plant: no gains can be certified: {reason}")
    seed = require_seed("seed", seed)
    neutral = Certified(L=[[0.0] * flow.p] * flow.n, gamma=0.0)
    try:
        problem = resolve_scenario(msgspec.structs.replace(scenario, observer=neutral))
    except InputError as error:  # its remedy may be another method
        own = ". A design is of 'certified' alone, others need none" * ("'certified'" in str(error))
        raise type(error)(f"{error}{own}") from None
    task = build_task(problem, margin)
    present = _find_present_gains(scenario, problem)
    before = None if present is None else score_candidate(task, *present)
    with notebook_progress(progress, "designing", count_design_rounds(maximise)) as advance:
        if maximise == "knee":
            result = gain_search.find_balanced(task, before, seed, advance)
        else:
            weights = maximise if isinstance(maximise, gain_search.Weights) else gain_search.RATE
            result = gain_search.find_fastest(task, weights, seed, advance)
    never = error_decay_rates(task.model, result.best.L, result.best.gamma, task.whole).never
    return Design(
        title=scenario.title,
        chosen=_format_aim(maximise),
        seed=seed,
        Ts=problem.model.Ts,
        **_to_proof_fields(problem, result),
        never=list(never),
        states=find_determined_states(problem, task.whole),
        remarks=list(result.remarks),
        best=_to_point(result.best),
        present=None if before is None else _to_point(before),
        identifiable=assess_identifiability(problem, task.whole, None),
        front=list(map(_to_point, result.front)),
        schema=SCHEMA,
    )


def count_design_rounds(maximise: Aim) -> int:
    """Return the number of rounds that `design` reports to its progress callback."""
    return gain_search.STARTS + (gain_search.ROUNDS if maximise == "knee" else 0)


def why_not_certifiable(flow: System) -> str:
    """Return the reason why no gains can be certified for a linear model, empty if some can.

    Args:
        flow: the model in continuous time.
    """
    if flow.nonlinear:
        return ""
    return certify(flow.linear, np.zeros((flow.n, flow.p)), np.ones(flow.p)).reason


def apply_design(scenario: Scenario, design: Design) -> Scenario:
    """Return the scenario with the gains of a design."""
    base_options = scenario.observer if isinstance(scenario.observer, Certified) else Certified()
    observer = msgspec.structs.replace(base_options, L=design.L, gamma=design.gamma, design=None)
    return msgspec.structs.replace(scenario, observer=observer)


def _require_aim(maximise: Aim) -> None:
    """Raise InputError for an unknown aim."""
    if isinstance(maximise, gain_search.Weights):
        for name, power in maximise._asdict().items():
            require_number(f"maximise.{name}", power, least=0.0)
    elif maximise not in get_args(AIMS):
        raise InputError(
            f"maximise: expected 'knee', 'rate' or uz.Weights(...), found {maximise!r:.40}"
        )


def _require_linear_task(scenario: Scenario, flow: System) -> None:
    """Raise InputError for a scenario without automatic design."""
    if flow.nonlinear or scenario.sensor.kind == "jump":
        what = "plant: a nonlinear plant" if flow.nonlinear else "sensor.kind: a jump sensor"
        raise InputError(
            f"{what} has no automatic design. Choose gains and judge them by simulation"
        )
    if not isinstance(scenario.controller, StateFeedback):
        raise InputError("controller.method: a design plans on z = r. Use state_feedback")


def _find_present_gains(scenario: Scenario, problem: Problem) -> tuple[Floats, Floats] | None:
    """Return the scenario's own gains if they are certified, else None."""
    if not isinstance(scenario.observer, Certified):
        return None
    model = problem.model
    gains = constant_gains(scenario.observer.build(model, problem.sensor), model)
    if gains is None or not certify(model.linear, *gains, model.Ts).certified:
        return None
    return gains


def _to_proof_fields(problem: Problem, result: gain_search.Synthesis) -> dict[str, Any]:
    """Return the model of a design and the proof of its gains, for its file."""
    A, B, C = problem.model.linear
    certificate = result.certificate
    return {
        "A": A.tolist(),
        "B": B.tolist(),
        "C": C.tolist(),
        "K": problem.controller.params.K.tolist(),
        "P": certificate.P.tolist(),
        "W": certificate.W.tolist(),
        "margin": certificate.margin,
        "frequency": certificate.frequency,
    }


def _format_aim(maximise: Aim) -> str:
    """Return the maximised quantity as text."""
    if isinstance(maximise, str):
        return maximise
    powers = [f"{name}^{power:g}" for name, power in maximise._asdict().items()]
    return f"rate / ({' '.join(powers)})"


def _to_point(candidate: Candidate) -> Point:
    """Return a candidate as a point of a design file."""
    numbers = candidate._asdict()
    return Point(**numbers | {"L": candidate.L.tolist(), "gamma": candidate.gamma.tolist()})
