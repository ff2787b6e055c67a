"""Proofs about an exported observer, as files that `python -m undeadzone_proof` checks.

A search in floating point proposes V and the sets; docs/proof.md has the theorem. The checker
decides, so that only what it accepts is written.
"""

from __future__ import annotations

import decimal
import json
import os
from collections.abc import Callable, Iterator
from fractions import Fraction
from functools import partial
from typing import Any, Final

import numpy as np
from scipy.linalg import block_diag, eigh

from undeadzone.analysis.certificate.passivity import Certificate, certify
from undeadzone.analysis.dissipation import Inequality, optimise_storage
from undeadzone.analysis.error_dynamics import balance_dynamics, largest_growth_rate
from undeadzone.compile.simplify import round_to_type
from undeadzone.errors import InputError, ProofError
from undeadzone.linalg.matrices import symmetric_part
from undeadzone.observers.certified import Certified
from undeadzone.scenario.problem import Problem, constant_gains, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.exogenous import random_disturbance
from undeadzone.simulation.simulate import simulate
from undeadzone.util.arrays import Floats
from undeadzone.util.files import write_text
from undeadzone_export.code import build_code
from undeadzone_export.exported_step import build_step
from undeadzone_export.source import Labels, Source, build_source
from undeadzone_proof import (
    bound_reading_error,
    compare_step,
    list_sides,
    reach_states,
    state_theorem,
    verify_proof,
)
from undeadzone_proof.exact import ZERO, Refused, dual_form, hold_exactly, require
from undeadzone_proof.source import Code

FILE: Final = "proof.json"
ROOM: Final = 1 + 1e-6  # by which proposed numbers exceed those that are needed
DECAYS: Final = (0.2, 0.4, 0.6, 0.8, 0.95)  # shares of the fastest decay of V, that are tried
FALLS: Final = ((0.05, 0.3), (0.2, 0.3), (0.5, 0.8))  # shares of decay and margin, of candidates
FAIR: Final = 1.25  # of the smallest set of any widths, that the chosen one may have
PASSES: Final = 8  # of a set's rounding, which grows with the set, at most
LEAST: Final = 1e-9  # of the largest bound from outside, that the others count as, at least
SIGMAS: Final = 4.0  # of a random disturbance, that its bound spans
RANGE: Final = 2.0  # of states and inputs, in multiples of the largest along the run
NEEDS: Final[dict[str, Callable[[Any], bool]]] = {
    "a certified observer of one output, with a gradient law": lambda problem: (
        isinstance(problem.scenario.observer, Certified)
        and problem.observer.traits.constant
        and problem.model.p == 1
    ),
    "a linear plant with the states of its model": lambda problem: (
        problem.plant.linear.A.shape == problem.model.linear.A.shape and not problem.plant.nonlinear
    ),
    "observer.width_max, a bound of the widths": lambda problem: (
        problem.model.Ts is None or problem.scenario.observer.width_max is not None
    ),
    "a sensor without noise_before": lambda problem: not problem.sensor.noise_before.any(),
    "an actuator without a zone": lambda problem: problem.actuator is None,
}


def prove(scenario: Scenario, file: str | os.PathLike[str] = FILE) -> str:
    """Write a proof about a scenario's certified observer.

    In continuous time V falls. In sampled time the error stays in sets, whatever the C in double
    rounds; the file then contains that C.

    Args:
        scenario: a scenario whose observer is `certified`.
        file: path of the proof, which `python -m undeadzone_proof` checks.

    Returns:
        What is proved, in words.

    Raises:
        InputError: the scenario is beyond the theorem, with the reason.
        ProofError: its gains have no proof.
        FileError: the file cannot be written.
    """
    problem = resolve_scenario(scenario)
    if problem.model.Ts is None:
        proof = propose_continuous(problem)
    else:
        printed = build_code(build_step(problem), single=False)
        text = build_source(printed, Labels("observer", scenario.title, "observer"))
        proof = propose_sampled(problem, text, single=False)
    write_text(proof_text(proof), file)
    return str(proof["statement"])


def _certify(problem: Problem) -> Certificate:
    """Return the certificate of a scenario within the theorem. Raises InputError, ProofError."""
    for need, holds in NEEDS.items():
        if not holds(problem):
            raise InputError(f"proof: needs {need}")
    gains = constant_gains(problem.observer, problem.model)
    assert gains is not None
    found = certify(problem.model.linear, *gains, problem.model.Ts)
    if not found.certified:
        raise ProofError(f"proof: {found.reason}")
    return found


def propose_continuous(problem: Problem) -> dict[str, Any]:
    """Return a checked proof that V falls in continuous time. Raises InputError, ProofError."""
    found = _certify(problem)
    A, B, C = problem.plant.continuous
    L = found.dynamics.L[:, 0]
    P = found.P / found.W
    cross = P @ L - C[0]
    margin = 1 - cross @ np.linalg.solve(-A.T @ P - P @ A, cross) / 2
    content = {"plant": {"A": A, "B": B, "C": C}, "gains": {"L": L}}
    return _finish(content | {"storage": {"P": P, "W": 1.0, "margin": margin / ROOM}})


def propose_sampled(problem: Problem, text: Source, single: bool) -> dict[str, Any]:
    """Return a checked proof about the C of a sampled observer, which it contains.

    Args:
        problem: the checked parts of the scenario.
        text: the C.
        single: whether its numbers are float.

    Raises:
        InputError: the scenario is beyond the theorem.
        ProofError: the gains have no proof.
    """
    found = _certify(problem)
    sensor, n = problem.sensor, problem.plant.n
    options: Any = problem.scenario.observer
    rounded = partial(round_to_type, real="float32" if single else "float64")
    threshold = rounded(sensor.threshold[0])
    widest = rounded(np.ravel(options.width_max)[0])
    bounds, disturbance = _ranges_of_run(problem)
    own = {"name": text.prefix, "format": "float" if single else "double"}
    content = {
        "source": own | {"texts": [text.code, text.header]},
        "plant": problem.plant.continuous._asdict() | {"Ts": problem.model.Ts},
        "sensor": {"slope": sensor.slope[0], "threshold": threshold, "width_max": widest},
        "bounds": bounds,
        "storage": {"P": np.eye(n)},
    }
    proof = _to_exact(content)
    try:
        code = Code(
            [text.code, text.header], text.prefix, own["format"], proof["sensor"]["width_max"]
        )
        proof |= {"constants": code.constants, "operations": code.bodies["step"]}
        noise = threshold * bool(sensor.noise[0] or sensor.quantum[0])
        outside = [(noise, disturbance), (noise, disturbance), (0.0, 0 * disturbance)]
        names = ("any widths", "known widths", "rounding alone")
        sets = [
            {"name": name, "noise": noise, "disturbance": push, "width": widest}
            for name, (noise, push) in zip(names, outside, strict=True)
        ]
        proof["sets"] = _to_exact(sets)
        held = hold_exactly(*(proof["plant"][key] for key in ("A", "B", "Ts")))
        right, silent, *_ = (
            compare_step(proof, code, held, [ZERO] * n, *side)
            for side in list_sides(proof, code, proof["sets"][0])[:2]
        )
        proof["gains"] = {"L": [row[n] for row in right[0][:-1]], "gamma": 1 - right[0][-1][n]}
        proof["storage"] = _choose_storage(found, proof, code, right, silent)
        proof["sets"] = [one for one in proof["sets"] if _fit_set(proof, code, held, one)]
    except Refused as step:
        raise ProofError(f"proof: {step}") from None
    return _finish(proof)


def _ranges_of_run(problem: Problem) -> tuple[dict[str, list[Fraction]], Floats]:
    """Return bounds of states and inputs, twice those of the run, and of the disturbances."""
    run = simulate(problem.scenario, check_step=False)
    random = random_disturbance(problem)
    if random is not None:
        push = SIGMAS * random[0]
    elif problem.disturbance is not None:
        push = np.abs(problem.disturbance.output_at(run.t)).max(axis=0)
    else:
        push = np.zeros(problem.plant.m)
    sizes = {name: RANGE * np.abs(each).max(axis=0) for name, each in (("x", run.x), ("u", run.u))}
    return {name: [_round_up(x, 2) for x in size] for name, size in sizes.items()}, push


def _search_storages(found: Certificate) -> Iterator[Floats]:
    """Iterate over P of V with W = 1: the certificate's, and those of least C P^-1 C'."""
    Ts = found.dynamics.Ts
    assert Ts is not None
    yield found.P / found.W / Ts
    scaling = balance_dynamics(found.dynamics)
    errors = scaling.scale_dynamics(found.dynamics)
    fastest = -largest_growth_rate(errors.A[0], errors.Ts)
    for decay, slack in FALLS:
        terms = [(1, 1, np.array([[2 * slack * found.margin]]))]
        inequality = errors.extend_inequality(
            np.ones(1), np.zeros((len(errors.L), 0)), terms, decay * fastest
        )
        solution = optimise_storage(
            partial(_same, inequality),
            -np.ones(1),
            np.zeros(1),
            lambda P, q: [P - q[0] * errors.C.T @ errors.C],
        )
        if solution is not None:
            unit = scaling.unscale_weights(np.ones(1))[0] * Ts
            yield symmetric_part(scaling.unscale_storage(solution.P) / unit)


def _same(inequality: Inequality, q: Floats) -> Inequality:
    """Return the inequality, whatever the multiplier."""
    return inequality


def _choose_storage(
    found: Certificate, proof: dict[str, Any], code: Code, right: Any, silent: Any
) -> dict[str, Any]:
    """Return V with a small set of known widths, whose set of any widths is among the smallest.

    Args:
        found: the certificate of the gains.
        proof: its sets and gains.
        code: the C.
        right, silent: `compare_step` on the right side and in silence.

    Raises:
        Refused: V falls for no candidate, by the numbers of the C.
    """
    one, n, g = proof["sets"][0], len(silent[1]), float(proof["gains"]["gamma"])
    outside = _list_outside(proof, code, one)
    box = np.array(right[1], float)
    c = np.array(right[0][-1][:n], float) / g
    trials = []
    for P in _search_storages(found):
        modes = [
            (np.array(right[0], float), block_diag(P, 1 / g)),
            (np.array(silent[0], float), P),
        ]
        falls = [whole - (F := E[:, : len(whole)]).T @ whole @ F for E, whole in modes]
        fastest = min(_least_ratio(fall, mode[1]) for fall, mode in zip(falls, modes, strict=True))
        if not fastest > 0:
            continue
        h = np.sqrt(c @ np.linalg.solve(P, c))
        push = np.sqrt(box @ np.abs(modes[0][1]) @ box)
        for decay in fastest * np.array(DECAYS):
            loud = np.zeros(len(outside))
            for (E, whole), fall in zip(modes, falls, strict=True):
                own, given = np.split(E, [len(whole)], axis=1)
                cross = own.T @ whole @ given
                rest = given.T @ whole @ given
                rest = rest + cross.T @ np.linalg.solve(fall - decay * whole, cross)
                loud = np.maximum(loud, np.abs(rest) @ outside / outside * ROOM)
            K = _absorbing(decay, loud @ outside**2, push)
            wide = h * np.hypot(K, np.sqrt(2 / g) * float(one["width"]))
            storage = {"P": P, "R": 1 / g, "decay": decay, "loud": loud}
            trials.append((wide, h * K * (1 + h**2 / g), storage))
    require(trials, "V falls, by the numbers of the C")
    fair = FAIR * min(wide for wide, *_ in trials)
    _, _, storage = min((one for one in trials if one[0] <= fair), key=lambda one: one[1])
    return dict(_to_exact(storage))


def _list_outside(proof: dict[str, Any], code: Code, one: dict[str, Any]) -> Floats:
    """Return bounds of a reading's error and of disturbances in a set, above 0."""
    bounds = np.array([bound_reading_error(proof, code, one), *one["disturbance"]], float)
    return np.maximum(bounds, LEAST * bounds.max())


def _least_ratio(X: Floats, Y: Floats) -> float:
    """Return the largest t with X >= t Y, or NaN if Y is not positive definite."""
    try:
        return float(eigh(X, Y, eigvals_only=True)[0])
    except np.linalg.LinAlgError:
        return np.nan


def _absorbing(decay: Any, loud: Any, push: Any) -> float:
    """Return the least K with sqrt((1 - decay) K^2 + loud) + push <= K."""
    rest = push**2 * (1 - decay) + decay * loud
    return float((push + np.sqrt(rest)) / decay)


def _fit_set(proof: dict[str, Any], code: Code, held: Any, one: dict[str, Any]) -> bool:
    """Set the numbers of a set that no step leaves: of any widths, or the least one.

    Returns whether it exists, and has no widths that the C cannot have.

    Args:
        proof: its plant, gains and V.
        code: the C.
        held: `hold` of the plant.
        one: the set's name and the bounds of what comes from outside.
    """
    storage, any_widths = proof["storage"], one is proof["sets"][0]
    P, R, decay, loud = (np.array(each, float) for each in storage.values())
    outside, g, n = _list_outside(proof, code, one), float(proof["gains"]["gamma"]), len(P)
    seen = ROOM * float(dual_form(storage["P"], proof["plant"]["C"][0]))  # |z - z^|^2 / V, at most
    room = 2 * R * float(code.widest) ** 2
    guess: Any = float(room * any_widths) * 1.01
    for _ in range(PASSES):
        reach = reach_states(storage["P"], Fraction(guess))
        K: Any = 0.0
        wrong: Any = 0.0
        c = np.zeros(n)
        for side, ends in list_sides(proof, code, one)[:2]:  # the left mirrors the right
            E, box = compare_step(proof, code, held, reach, side, ends)
            size = np.array(box, float)
            push = np.sqrt(size @ np.abs(block_diag(P, R) if side else P) @ size)
            K = max(K, _absorbing(decay, loud @ outside**2, push) * ROOM)
            if side:
                own, given = np.split(np.array(E[-1], float), [n + 1])
                wrong = np.sqrt(R) * (size[-1] + np.abs(given) @ outside) / g
                c = own[:n] / g
        h = np.sqrt(R * (c @ np.linalg.solve(P, c)))
        own = ROOM * np.roots([1 - g * h**2, -2 * g * h * wrong, -g * wrong**2 - K**2]).max()
        rest = ROOM * np.hypot(h * own + wrong, K)
        width = _round_up(ROOM * (h * rest + wrong) / np.sqrt(R), 4)
        V = K**2 + room if any_widths else rest**2 + R * float(width) ** 2
        if guess >= V * ROOM and (any_widths or width < code.widest):
            least = {} if any_widths else {"K1": own, "width": width}
            one |= _to_exact(least | {"K": K, "V": V * ROOM})
            one["radius"] = _round_up(ROOM * np.sqrt(V * seen), 4)
            return True
        guess = 1.01 * V
    return False


def _round_up(number: Any, digits: int) -> Fraction:
    """Return a number with a few digits, not below it."""
    context = decimal.Context(prec=digits, rounding=decimal.ROUND_UP)
    return Fraction(context.create_decimal(float(number)))


def _to_exact(value: Any) -> Any:
    """Return the content of a proof with its numbers as fractions."""
    if isinstance(value, dict):
        return {key: _to_exact(each) for key, each in value.items()}
    if isinstance(value, list | np.ndarray):
        return [_to_exact(each) for each in value]
    return Fraction(float(value)) if isinstance(value, float | np.floating) else value


def _finish(content: dict[str, Any]) -> dict[str, Any]:
    """Return a proof with its statement, checked. Raises ProofError."""
    proof = _to_exact(content)
    proof["statement"] = state_theorem(proof)
    try:
        verify_proof(proof)
    except Refused as step:
        raise ProofError(f"proof: {step}, not by the numbers that were found") from None
    return dict(proof)


def proof_text(proof: dict[str, Any]) -> str:
    """Return the text of a proof's file."""
    return json.dumps(proof, indent=1, default=str) + "\n"
