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
from undeadzone_proof import (
    Code,
    Refused,
    hold,
    list_modes,
    map_step,
    require,
    state_theorem,
    verify_proof,
)

FILE: Final = "proof.json"
ROOM: Final = 1 + 1e-5  # by which proposed numbers exceed those that are needed
SLACK: Final = 1e-6  # of the balanced inequality, which the exact one needs
SIDES: Final = (0.06, 0.02, 0.18, 0.56)  # of the plant's decay, that V may have on a side
SILENCES: Final = (0.003, 0.03, 0.2, 0.5)  # of it, that V may have in silence
NEAR: Final = 1e-6  # of a state, that its set spans at least, at the start of the search
QUIET: Final = 0.4  # of a step's decay, that rounding may take
SPREAD: Final = 0.5  # of it, of the set at the start of the search
PASSES: Final = 4  # of a set's rounding, which grows with the set, at most
LEAST: Final = 1e-9  # of the largest bound from outside, that the others count as, at least
MODES: Final = ("right", "left", "silent")
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
    rounded = partial(round_to_type, real="float32" if single else "float64")
    threshold = rounded(sensor.threshold[0])
    widest = rounded(np.ravel(options.width_max)[0])
    noise = threshold * bool(sensor.noise[0] or sensor.quantum[0])
    own = {"name": text.prefix, "format": "float" if single else "double"}
    content = {
        "source": own | {"texts": [text.code, text.header]},
        "plant": problem.plant.continuous._asdict() | {"Ts": problem.model.Ts},
        "sensor": {"slope": sensor.slope[0], "threshold": threshold, "width_max": widest},
        "bounds": _ranges_of_run(problem) | {"noise": noise, "reach": [Fraction(0)] * n},
    }
    proof = _to_exact(content)
    try:
        code = Code([text.code, text.header], *own.values(), proof["sensor"]["width_max"])
        proof |= {"constants": code.constants, "operations": code.bodies["step"]}
        held = hold(proof["plant"])
        E, _ = map_step(proof, code, held, *list_modes(proof, code)[0][1:4])
        proof["gains"] = [row[n] for row in E]
        R = 1 / (1 - float(E[n][n]))
        P = certificate.P / certificate.W / problem.model.Ts
        proof["storage"] = _to_exact({"P": P, "R": R})
        for one in _search_sets(proof, code, held):
            fitted = _fit_set(proof, code, held, one)
            with contextlib.suppress(ProofError):
                return _finish(proof | fitted)
    except Refused as step:
        raise ProofError(f"proof: {step}") from None
    raise ProofError("proof: no set was found that rounding does not leave")


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
    ranges = {name: [_round_up(x, 2) for x in size] for name, size in sizes.items()}
    return ranges | {"disturbance": push}


def _read_modes(proof: dict[str, Any], code: Code, held: Any) -> dict[str, Any]:
    """Return E, the bounds of all else, and of widths, readings and disturbances, by mode."""
    modes = {}
    for name, *mode, wrong in list_modes(proof, code)[:3]:
        E, box = (np.array(each, float) for each in map_step(proof, code, held, *mode))
        outside = np.array([wrong, *proof["bounds"]["disturbance"]], float)
        outside = np.maximum(outside, LEAST * outside.max())
        modes[name] = E, box, np.array([code.widest, code.widest, *outside], float)
    return modes


def _search_sets(proof: dict[str, Any], code: Code, held: Any) -> list[dict[str, Any]]:
    """Return sets that no exact step leaves, the one of least radius first.

    Args:
        proof: its plant and bounds.
        code: the C.
        held: `hold` of the plant.
    """
    n = len(proof["plant"]["A"])
    modes = _read_modes(proof, code, held)
    E, _, (D, *_) = modes["right"]
    silent = modes["silent"][0][:n, :n]
    slowest = 1 - np.abs(np.linalg.eigvals(silent)).max()
    driven = np.outer(E[:n, n], E[:n, n]) * D**2 / (SPREAD * slowest)
    X = solve_discrete_lyapunov(silent / np.sqrt(1 - SPREAD * slowest), driven)
    start = block_diag(np.linalg.inv(X + NEAR * np.diag(np.diag(X))), np.eye(2) / D**2)
    reach = [_round_up(x, 4) for x in np.sqrt(np.diag(X))]
    modes = _read_modes(proof | {"bounds": proof["bounds"] | {"reach": reach}}, code, held)
    tried: list[tuple[float, float, Any]] = []
    for shares in ((SIDES[:1], SILENCES), (SIDES[1:], ())):
        near = [one[1] for one in sorted(tried, key=itemgetter(0))[:1]] or SILENCES
        for share in itertools.product(shares[0], shares[1] or near):
            one = _minimise_radius(proof, modes, slowest * np.array(share), start)
            tried += [] if one is None else [(one.pop("size"), share[1], one)]
    return [one for *_, one in sorted(tried, key=itemgetter(0))]


def _minimise_radius(
    proof: dict[str, Any], modes: dict[str, Any], decays: Floats, start: Floats
) -> dict[str, Any] | None:
    """Return the set of least radius that no exact step leaves, or None.

    V is the same seen from the left: in x~ and d~r - d~l it has one matrix, in d~r + d~l another.

    Args:
        proof: its plant.
        modes: what a step does (`_read_modes`).
        decays: of V on a side and in silence.
        start: a V, in whose coordinates it is sought.
    """
    n, (D, *_) = len(start) - 2, modes["right"][2]
    m, w = n + 1, len(modes["right"][2]) - 2
    entries = m * (m + 1) // 2
    turn = block_diag(np.eye(n), np.array([[1, 1], [-1, 1]]) / np.sqrt(2))
    T = turn @ np.linalg.inv(np.linalg.cholesky(turn.T @ start @ turn).T)
    inverse = np.linalg.inv(T)
    kick = inverse[:, [n]] / np.linalg.norm(inverse[:, n])  # of a clip, in the coordinates of T
    signals = block_diag(T[n:] / D, np.eye(w + 1))
    clip, own = signals[-1] / np.linalg.norm(inverse[:, n]), D * signals[0]
    c = T.T @ np.append(np.array(proof["plant"]["C"][0], float), [0, 0])
    c /= np.linalg.norm(c)
    corners = inverse[:, n:] @ np.array([[D, D], [D, -D]])

    steps = []
    for name, decay in zip(("right", "silent"), decays, strict=True):
        E, box, sizes = modes[name]
        rounding = inverse * box * np.sqrt(len(box)) / (QUIET * decay)
        own_columns = E @ block_diag(T, np.diag(sizes[2:]))
        steps.append(
            (
                np.hstack([inverse @ own_columns, kick]),
                np.append(own_columns[n], 0) + clip,
                decay,
                rounding,
            )
        )

    def blocks(x: Floats) -> list[Floats]:
        """Return the matrices that must be positive semidefinite."""
        P = block_diag(symmetric_matrix(x[:entries], m), x[entries])
        multipliers = x[entries + 1 : -1].reshape(2, w + 4)
        found = [
            *(1 - np.einsum("ik,ij,jk->k", corners, P, corners)).reshape(2, 1),
            np.block([[P - SLACK * np.eye(n + 2), c[:, None]], [c[None], x[-1:, None]]]),
            multipliers.ravel(),
        ]
        for (F, row, decay, rounding), (*loud, toward, back) in zip(
            steps, multipliers, strict=True
        ):
            sector = np.outer(clip, (toward + back) * row - back * own)
            M = (
                (signals.T * [*loud, 0]) @ signals
                + (sector + sector.T) / 2
                - SLACK * np.eye(len(clip))
            )
            M += (block_diag((1 - decay) * P, np.zeros((w + 1, w + 1))) - F.T @ P @ F) / decay
            found += [M, np.array([1 - sum(loud), 1 - np.sum(rounding * (P @ rounding))])]
        return found

    x = minimise_semidefinite(np.append(np.zeros(entries + 1 + 2 * (w + 4)), 1.0), blocks)
    if x is None or np.linalg.eigvalsh(blocks(x)[2])[0] < -SLACK / 2:
        return None
    S = inverse.T @ block_diag(symmetric_matrix(x[:entries], m), x[entries]) @ inverse
    mirror = block_diag(-np.eye(n), [[0, 1], [1, 0]])
    multipliers = np.maximum(x[entries + 1 : -1].reshape(2, w + 4), LEAST) * decays[:, None]
    right, silent = (
        {"decay": a, "loud": loud[:-2] / modes[name][2] ** 2, "clip": loud[-2:]}
        for name, a, loud in zip(("right", "silent"), decays, multipliers, strict=True)
    )
    left = right | {"loud": right["loud"][[1, 0, *range(2, w + 2)]]}
    S = symmetric_part(S + mirror @ S @ mirror) / 2
    return {"size": x[-1], "S": S, "right": right, "left": left, "silent": silent}


def _fit_set(proof: dict[str, Any], code: Code, held: Any, one: dict[str, Any]) -> dict[str, Any]:
    """Return a set large enough for rounding, and how far it reaches.

    Args:
        proof: its plant and bounds.
        code: the C.
        held: `hold` of the plant.
        one: the set without rounding.
    """
    c = np.array([*proof["plant"]["C"], *np.eye(len(proof["bounds"]["x"]))], float)
    for _ in range(PASSES):
        reach = np.sqrt(np.diag(c @ np.linalg.inv(one["S"])[:-2, :-2] @ c.T))
        one["radius"], *reach = [_round_up(ROOM * x, 4) for x in reach]
        bounds = proof["bounds"] | {"reach": reach}
        scales = [1.0]
        for name, (_, box, sizes) in _read_modes(proof | {"bounds": bounds}, code, held).items():
            decay, push = one[name]["decay"], ROOM * np.sqrt(box @ np.abs(one["S"]) @ box)
            one[name]["push"] = push
            rest = ROOM * one[name]["loud"] @ sizes**2 - push**2
            scales.append((decay / (push + np.sqrt(push**2 + max(0, decay * rest)))) ** 2)
        if min(scales) == 1:
            break
        one["S"] *= min(scales) / ROOM
        for name in MODES:
            one[name]["loud"] = one[name]["loud"] * min(scales) / ROOM
            one[name]["clip"] = one[name]["clip"] * min(scales) / ROOM
    return {"set": _to_exact(one), "bounds": bounds}


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
