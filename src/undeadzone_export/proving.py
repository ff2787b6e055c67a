"""Proofs about an exported observer, as files that `python -m undeadzone_proof` checks.

A search in floating point proposes V and the sets; docs/proof.md has the theorem. The checker
decides, so that only what it accepts is written.
"""

from __future__ import annotations

import contextlib
import decimal
import itertools
import json
import os
from collections.abc import Callable, Iterator
from fractions import Fraction
from functools import partial
from operator import itemgetter
from typing import Any, Final

import numpy as np
from scipy.linalg import block_diag, solve_discrete_lyapunov

from undeadzone.analysis.certificate.passivity import Certificate, certify
from undeadzone.compile.simplify import round_to_type
from undeadzone.errors import InputError, ProofError
from undeadzone.linalg.matrices import symmetric_part
from undeadzone.numerics.semidefinite import minimise_semidefinite, symmetric_matrix
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
from undeadzone_proof import state_theorem, verify_proof
from undeadzone_proof.source import Code, Refused
from undeadzone_proof.theorem import hold_exactly, map_step

FILE: Final = "proof.json"
ROOM: Final = 1 + 1e-5  # by which proposed numbers exceed those that are needed
SLACK: Final = 1e-6  # of the balanced inequality, which the exact one needs
# Of the plant's decay, that V may have on a side and in silence. With all twelve pairs of these and
# 0.1 the radius of 30 sets is the same or up to 14 % less.
DECAYS: Final = ((0.02, 0.03), (0.06, 0.1), (0.18, 0.3), (0.56, 0.3))
NEAR: Final = 1e-6  # of a state, that its set spans at least, at the start of the search
SPREAD: Final = 0.5  # of it, of the set at the start of the search
DIGITS: Final = 4  # of a bound that is printed
GROWTH: Final = 1.001  # of a set beyond what its roundings need, so that two passes do
PASSES: Final = 20  # of a set's rounding, which grows with the set, at most
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
    certificate = _certify(problem)
    sensor, n = problem.sensor, problem.plant.n
    options: Any = problem.scenario.observer
    Ts: Any = problem.model.Ts
    rounded = partial(round_to_type, real="float32" if single else "float64")
    threshold = rounded(sensor.threshold[0])
    widest = rounded(np.ravel(options.width_max)[0])
    noise = threshold * bool(sensor.noise[0] or sensor.quantum[0])
    own = {"name": text.prefix, "format": "float" if single else "double"}
    content = {
        "source": own | {"texts": [text.code, text.header]},
        "plant": problem.plant.continuous._asdict() | {"Ts": Ts},
        "sensor": {"slope": sensor.slope[0], "threshold": threshold, "width_max": widest},
        "bounds": _ranges_of_run(problem) | {"noise": noise, "reach": [Fraction(0)] * n},
    }
    proof = _to_exact(content)
    try:
        code = Code(proof, [text.code, text.header])
        proof |= {"constants": code.constants, "operations": code.lines["step"]}
        proof["start"] = code.begin()[:n]
        held = hold_exactly(proof["plant"])
        E, *_ = map_step(proof, code, held, "right")
        proof["gains"] = list(list(zip(*E, strict=True))[n])
        P = block_diag(certificate.P / certificate.W / Ts, 1 / (1 - float(E[n][n])))
        proof["storage"] = {"P": _to_exact(P)}
        for one in _search_sets(proof, code, held):
            fitted = _fit_set(proof, code, held, one)
            with contextlib.suppress(ProofError):
                return _finish(proof | fitted)
    except Refused as step:
        raise ProofError(f"proof: {step}") from None
    cure = ". In double it is less: --precision double" if single else ""
    raise ProofError(f"proof: no set was found that rounding does not leave{cure}")


def _ranges_of_run(problem: Problem) -> dict[str, Any]:
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
    ranges = {name: list(map(_round_up, size)) for name, size in sizes.items()}
    return ranges | {"disturbance": push}


def _read_modes(
    proof: dict[str, Any], code: Code, held: Any, reach: Any
) -> list[tuple[Floats, Floats]]:
    """Return the errors after a step by those before and by the world, on the right and in silence.

    Args:
        proof: its plant and bounds.
        code: the C.
        held: `hold_exactly` of the plant.
        reach: how far each estimate is from its state, at most.

    Returns:
        For each mode the matrix of a step, and the sizes of both widths and of what is outside.
    """
    reached = proof | {"bounds": proof["bounds"] | {"reach": reach}}
    D, modes = proof["sensor"]["width_max"], []
    for mode in ("right", "zone"):
        E, outside = map_step(reached, code, held, mode)
        sizes = np.array([D, D, *outside], float)
        modes.append((np.array(E, float), np.maximum(sizes, LEAST * sizes[2:].max())))
    return modes


def _search_sets(proof: dict[str, Any], code: Code, held: Any) -> list[dict[str, Any]]:
    """Return sets that no step leaves, the one of least radius first.

    Args:
        proof: its plant and bounds.
        code: the C.
        held: `hold_exactly` of the plant.
    """
    n = len(proof["plant"]["A"])
    silent, D = np.array(held, float)[:, :n], float(proof["sensor"]["width_max"])
    slowest = 1 - np.abs(np.linalg.eigvals(silent)).max()
    pushed = D * np.array(proof["gains"][:n], float)
    driven = np.outer(pushed, pushed) / (SPREAD * slowest)
    X = solve_discrete_lyapunov(silent / np.sqrt(1 - SPREAD * slowest), driven)
    start = block_diag(np.linalg.inv(X + NEAR * np.diag(np.diag(X))), np.eye(2) / D**2)
    modes = _read_modes(proof, code, held, list(map(_round_up, np.sqrt(np.diag(X)))))
    C = np.array([*proof["plant"]["C"][0], 0, 0], float)
    found = [_minimise_radius(C, modes, start, slowest * np.array(shares)) for shares in DECAYS]
    return sorted(itertools.chain(*found), key=itemgetter("size"))


def _minimise_radius(
    C: Floats, modes: list[tuple[Floats, Floats]], start: Floats, decays: Floats
) -> Iterator[dict[str, Any]]:
    """Iterate over the set of least radius that no step leaves, if there is one.

    V is the same seen from the left: in x~ and d~r - d~l it has one matrix, in d~r + d~l another.

    Args:
        C: how z^ depends on states and widths.
        modes: result of `_read_modes`.
        start: a V, in whose coordinates it is sought.
        decays: of V on a side and in silence.
    """
    n, m, D = len(C) - 2, len(C) - 1, modes[0][1][0]
    w = len(modes[0][1]) + 2
    entries = m * (m + 1) // 2
    turn = block_diag(np.eye(n), np.array([[1, 1], [-1, 1]]) / np.sqrt(2))
    T = turn @ np.linalg.inv(np.linalg.cholesky(turn.T @ start @ turn).T)
    inverse = np.linalg.inv(T)
    # x~, widths, what comes from outside and the clip of a width, in units of their sizes
    units = [
        block_diag(T, np.diag(sizes[2:]), 1 / np.linalg.norm(inverse[:, n])) for _, sizes in modes
    ]
    signals = units[0][n : n + 2] / D
    steps = [
        np.column_stack([E, E[:, -1]]) @ unit for (E, _), unit in zip(modes, units, strict=True)
    ]
    c = C @ T / np.linalg.norm(C @ T)
    corners = inverse[:, n:] @ np.array([[D, D], [D, -D]])

    def split_variables(x: Floats) -> tuple[Floats, Floats]:
        """Return P and the multipliers of both modes."""
        P = block_diag(symmetric_matrix(x[:entries], m), x[entries])
        return P, x[entries + 1 : -1].reshape(2, w)

    def blocks(x: Floats) -> list[Floats]:
        """Return the matrices that must be positive semidefinite."""
        P, multipliers = split_variables(x)
        bordered = np.block([[P - SLACK * np.eye(n + 2), c[:, None]], [c, x[-1:]]])
        found = [bordered, multipliers.ravel(), 1 - np.sum(corners * (P @ corners), axis=0)]
        for F, unit, decay, (*loud, toward, back) in zip(
            steps, units, decays, multipliers, strict=True
        ):
            local = inverse @ F
            M = -local.T @ P @ local
            M[: n + 2, : n + 2] += (1 - decay) * P
            sector = np.outer(unit[-1], (toward + back) * F[n] - back * unit[n])
            weights = np.diag([*np.zeros(n + 2), *loud[2:], 0.0])
            M = M / decay + weights + (signals.T * loud[:2]) @ signals + symmetric_part(sector)
            found += [M - SLACK * np.eye(len(M)), np.array([1 - sum(loud)])]
        return found

    x = minimise_semidefinite(np.append(np.zeros(entries + 1 + 2 * w), 1.0), blocks)
    if x is not None and np.linalg.eigvalsh(blocks(x)[0])[0] > -SLACK / 2:
        P, multipliers = split_variables(x)
        S = inverse.T @ P @ inverse
        mirror = block_diag(-np.eye(n), [[0, 1], [1, 0]])
        weights = np.maximum(multipliers, LEAST) * decays[:, None]
        side, silent = (
            {"decay": decay, "loud": each[:-2] / sizes**2, "clip": each[-2:]}
            for decay, each, (_, sizes) in zip(decays, weights, modes, strict=True)
        )
        S = symmetric_part(S + mirror @ S @ mirror) / 2
        yield {"size": x[-1], "S": S, "side": side, "silent": silent}


def _fit_set(proof: dict[str, Any], code: Code, held: Any, one: dict[str, Any]) -> dict[str, Any]:
    """Return a set large enough for the roundings within, and its reach.

    Args:
        proof: its plant and bounds.
        code: the C.
        held: `hold_exactly` of the plant.
        one: the set with the roundings of another.
    """
    c = np.array([*proof["plant"]["C"], *np.eye(len(proof["bounds"]["x"]))], float)
    S, names, scale = one["S"], ("side", "silent"), 1.0
    for _ in range(PASSES):
        most = np.sqrt(np.diag(c @ np.linalg.inv(S)[:-2, :-2] @ c.T) / scale)
        radius, *reach = map(_round_up, ROOM * most)
        modes = _read_modes(proof, code, held, reach)
        needed = min(
            one[name]["decay"] / (ROOM * one[name]["loud"] @ sizes**2)
            for (_, sizes), name in zip(modes, names, strict=True)
        )
        if min(needed, 1.0) >= scale:
            break
        scale = needed / GROWTH
    for name in names:
        one[name]["loud"] *= scale
        one[name]["clip"] *= scale
    content = {"S": S * scale, "radius": radius, "side": one["side"], "silent": one["silent"]}
    return {"set": _to_exact(content), "bounds": proof["bounds"] | {"reach": reach}}


def _round_up(number: Any) -> Fraction:
    """Return a number with a few digits, not below it."""
    context = decimal.Context(prec=DIGITS, rounding=decimal.ROUND_UP)
    return Fraction(context.create_decimal(float(number)))


def _to_exact(value: Any) -> Any:
    """Return the content of a proof with its numbers as fractions."""
    if isinstance(value, dict):
        return {key: _to_exact(each) for key, each in value.items()}
    if isinstance(value, list | np.ndarray):
        return list(map(_to_exact, value))
    return Fraction(value) if isinstance(value, int | float) else value


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
