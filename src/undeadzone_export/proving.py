"""Proofs about an exported observer, as files that `python -m undeadzone_proof` checks.

A search in floating point proposes V and the sets; docs/proof.md has the theorem. What is written
was checked: the checker has the last word.
"""

from __future__ import annotations

import decimal
import json
import os
from collections.abc import Iterator
from fractions import Fraction
from functools import partial
from typing import Any, Final, NamedTuple, cast

import numpy as np
from scipy.linalg import eigh

from undeadzone.analysis.certificate.passivity import certify
from undeadzone.analysis.dissipation import optimise_storage
from undeadzone.analysis.error_dynamics import balance_dynamics
from undeadzone.errors import InputError, ProofError
from undeadzone.linalg.matrices import symmetric_part
from undeadzone.observers.adaptive.adaptation_laws import Gradient
from undeadzone.scenario.problem import Problem, constant_gains, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.exogenous import random_disturbance
from undeadzone.simulation.simulate import simulate
from undeadzone.util.arrays import Floats
from undeadzone.util.files import write_text
from undeadzone_export import exported_step
from undeadzone_export.code import build_code
from undeadzone_export.source import Labels, Source, build_source
from undeadzone_proof import (
    WIDTHS,
    Gaps,
    begin_step,
    compare_plant,
    dual,
    list_names,
    measure_steps,
    state,
    verify,
)
from undeadzone_proof.source import Code as ProvedCode
from undeadzone_proof.source import Refused

FILE: Final = "proof.json"
ROOM: Final = 1 + 1e-6  # by which proposed numbers are larger than needed
DECAYS: Final = (0.2, 0.4, 0.6, 0.8, 0.95)  # shares of the fastest one, that are tried
FALLS: Final = ((0.05, 0.3), (0.2, 0.3), (0.5, 0.3), (0.2, 0.05), (0.05, 0.05))
SIGMAS: Final = 4.0  # of a random disturbance, that its bound spans
FAIR: Final = 1.25  # of the smallest set of any widths, that the chosen one may have
PASSES: Final = 3  # of a set's rounding, which grows with the set
RANGE: Final = 2.0  # of states and inputs, in multiples of the largest along the run


def prove(scenario: Scenario, file: str | os.PathLike[str] = FILE) -> str:
    """Write a proof about a scenario's certified observer.

    In continuous time V never rises. In sampled time the error stays in sets, whatever the C in
    double rounds. The file then contains that C, too.

    Args:
        scenario: a scenario whose observer is `certified`.
        file: path of the proof, which `python -m undeadzone_proof` checks.

    Returns:
        What is proved, in a sentence.

    Raises:
        InputError: the scenario is beyond the theorem, with the reason.
        ProofError: its gains have no proof.
        FileError: the file cannot be written.
    """
    problem = resolve_scenario(scenario)
    if problem.model.Ts is None:
        proof = _propose_continuous(problem)
    else:
        printed = build_code(exported_step.build_step(problem), single=False)
        text = build_source(printed, Labels("observer", scenario.title, "observer"))
        proof = propose_sampled(problem, text, single=False)
    write_text(proof_text(proof), file)
    return str(proof["statement"])


def require_theorem(problem: Problem) -> tuple[Floats, Floats]:
    """Return (L (n), gamma) of a scenario within the theorem [1/s].

    Raises:
        InputError: beyond it, with the reason.
    """
    options: Any = problem.scenario.observer
    model, plant, sensor = problem.model, problem.plant, problem.sensor
    gains = constant_gains(problem.observer, model)
    if options.__struct_config__.tag != "certified" or gains is None:
        raise InputError('proof: holds for observer.method = "certified" with constant gains')
    sampled = model.Ts is not None
    reasons = {
        "one output": model.p != 1,
        "a linear plant with as many states as its model": plant.nonlinear
        or plant.linear.A.shape != model.linear.A.shape,
        "observer.adaptation = gradient": not isinstance(options.adaptation, Gradient),
        "observer.silence = false": sampled and options.silence,
        "observer.width_max, a bound of the widths": sampled and options.width_max is None,
        'sensor.kind = "deadzone", without range, play and noise_before': sensor.kind != "deadzone"
        or sensor.moves
        or sensor.limits is not None
        or sensor.noise_before.any(),
        "neither delay, actuator nor operating point": plant.delay
        or problem.actuator is not None
        or problem.levels is not None,
        "gamma above 0": not gains[1].all(),
    }
    missing = [need for need, lacks in reasons.items() if lacks]
    if missing:
        raise InputError(f"proof: needs {missing[0]}")
    return gains[0][:, 0], gains[1]


def _propose_continuous(problem: Problem) -> dict[str, Any]:
    """Return a checked proof that V never rises in continuous time. Raises ProofError."""
    L, gamma = require_theorem(problem)
    A, B, C = problem.plant.continuous
    found = certify(problem.plant.continuous, L[:, None], gamma)
    if not found.certified:
        raise ProofError(f"proof: {found.reason}")
    P, W = found.P / found.W, 1.0
    fall, cross = -A.T @ P - P @ A, P @ L - W * C[0]
    margin = 1 - cross @ np.linalg.solve(fall, cross) / (2 * W)
    content = {
        "plant": {"A": A, "B": B, "C": C},
        "L": L,
        "storage": {"P": P, "W": W, "margin": margin / ROOM},
    }
    return _finish(_to_exact(content))


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
    L, gamma = require_theorem(problem)
    plant, Ts = problem.plant.continuous, problem.model.Ts
    assert Ts is not None
    kind = "float" if single else "double"
    code = ProvedCode(text.code, text.header, text.prefix, kind)
    content = {
        "source": {"name": text.prefix, "format": kind, "texts": [text.code, text.header]},
        "plant": plant._asdict() | {"Ts": Ts},
        "sensor": _sensor_numbers(problem),
        "bounds": _ranges_of_run(problem),
    }
    proof = _to_exact(content)
    disturbance, noise = proof["bounds"].pop("disturbance"), proof["sensor"].pop("noise")
    proof["gains"] = _read_gains(proof, code)
    proof |= {"constants": code.constants, "operations": code.bodies["step"]}
    proof["storage"] = _choose_storage(problem, L, gamma, proof, noise, disturbance)
    gaps = compare_plant(proof)
    quiet = [Fraction(0)] * len(disturbance)
    proof["sets"] = [
        _propose_set(proof, code, gaps, name, wide, *outside)
        for name, wide, *outside in (
            ("any widths", True, noise, disturbance),
            ("known widths", False, noise, disturbance),
            ("rounding alone", False, Fraction(0), quiet),
        )
    ]
    return _finish(proof)


def _sensor_numbers(problem: Problem) -> dict[str, Any]:
    """Return slope, threshold, the bound of its error and that of the widths, of the sensor.

    Noise is bounded by the threshold, which the observer takes for silence.
    """
    sensor, options = problem.sensor, problem.scenario.observer
    is_noisy = sensor.noise[0] > 0 or sensor.quantum[0] > 0
    return {
        "slope": sensor.slope[0],
        "threshold": sensor.threshold[0],
        "noise": sensor.threshold[0] * is_noisy,
        "width_max": np.ravel(options.width_max)[0],  # type: ignore[attr-defined]
    }


def _ranges_of_run(problem: Problem) -> dict[str, Any]:
    """Return bounds of states, inputs and disturbance: what the scenario's own run needs, twice."""
    run = simulate(problem.scenario, check_step=False)
    random = random_disturbance(problem)
    if random is not None:
        push = SIGMAS * random[0]
    elif problem.disturbance is not None:
        push = np.abs(problem.disturbance.output_at(run.t)).max(axis=0)
    else:
        push = np.zeros(problem.plant.m)
    sizes = {"x": RANGE * np.abs(run.x), "u": RANGE * np.abs(run.u), "disturbance": push[None]}
    return {
        name: [_round_up(size, 2) for size in sizes.max(axis=0)] for name, sizes in sizes.items()
    }


def _read_gains(proof: dict[str, Any], code: ProvedCode) -> dict[str, Any]:
    """Return the numbers of a step that its C computes with."""
    quiet = [Fraction(0)] * len(proof["bounds"]["x"])
    threshold = proof["sensor"]["threshold"]
    found = []
    for ends in ([Fraction(0)] * 2, [threshold + 1, threshold + 2]):
        memory, ranges = begin_step(proof, quiet, ends)
        code.run("step", memory, ranges, proof["sensor"]["width_max"])
        found.append(memory)
    silent, right = found
    (x, u), width = list_names(proof), WIDTHS[1]
    g = 1 - right[width].terms[width]
    return {
        "M": [[silent[row].terms.get(name, Fraction(0)) for name in x] for row in x],
        "H": [[silent[row].terms.get(name, Fraction(0)) for name in u] for row in x],
        "l": [right[row].terms.get(width, Fraction(0)) for row in x],
        "c": [right[width].terms.get(name, Fraction(0)) / g for name in x],
        "g": g,
        "reading": -right[width].terms["in->y[0]"] / g,
    }


class _Storage(NamedTuple):
    """Candidate of V, with the bounds that follow from it in floating point.

    Attributes:
        content: its entries in the file.
        any, known: radii of the sets of any and of known widths, roughly.
    """

    content: dict[str, Any]
    any: float
    known: float


def _choose_storage(
    problem: Problem,
    L: Floats,
    gamma: Floats,
    proof: dict[str, Any],
    noise: Fraction,
    disturbance: list[Fraction],
) -> dict[str, Any]:
    """Return the V with a small set of known widths whose set of any widths is among the smallest.

    Raises ProofError.
    """
    found = [
        one
        for P in _search_storages(problem, L, gamma)
        for share in DECAYS
        if (one := _measure_storage(proof, P, share, noise, disturbance)) is not None
    ]
    if not found:
        raise ProofError("proof: no V for the numbers of the C, their margin is too small for it")
    bar = FAIR * min(one.any for one in found)
    best = min((one for one in found if one.any <= bar), key=lambda one: one.known)
    return cast(dict[str, Any], _to_exact(best.content))


def _search_storages(problem: Problem, L: Floats, gamma: Floats) -> Iterator[Floats]:
    """Iterate over P of V with W = 1: the certificate's, and those of least C P^-1 C'.

    Raises ProofError if the gains have no certificate.
    """
    Ts = problem.model.Ts
    assert Ts is not None
    found = certify(problem.model.linear, L[:, None], gamma, Ts)
    if not found.certified:
        raise ProofError(f"proof: {found.reason}")
    yield found.P / found.W / Ts
    errors = found.dynamics
    scaling = balance_dynamics(errors)
    scaled = scaling.scale_dynamics(errors)
    n = len(L)
    M = problem.model.linear.A
    P = found.P
    fastest = eigh(P - M.T @ P @ M, P, eigvals_only=True)[0] / (2 * Ts) * scaling.time
    for decay, slack in FALLS:
        family = partial(
            scaled.extend_inequality,
            E=np.zeros((n, 0)),
            terms=[(1, 1, np.array([[2 * slack * found.margin]]))],
            decay=decay * fastest,
        )
        solution = optimise_storage(
            lambda q, family=family: family(np.ones(1)),
            np.array([-1.0]),
            np.zeros(1),
            lambda P, q: [P - q[0] * scaled.C.T @ scaled.C],
        )
        if solution is not None:
            unit = scaling.unscale_weights(np.ones(1))[0] * Ts
            yield symmetric_part(scaling.unscale_storage(solution.P) / unit)


def _measure_storage(
    proof: dict[str, Any], P: Floats, share: float, noise: Fraction, disturbance: list[Fraction]
) -> _Storage | None:
    """Return a candidate of V with a share of its fastest decay, or None if V does not fall."""
    gains = {key: np.array(value, float) for key, value in proof["gains"].items()}
    M, l, c, g, reading = (gains[key] for key in ("M", "l", "c", "g", "reading"))
    n = len(P)
    whole = np.block([[P, np.zeros((n, 1))], [np.zeros((1, n)), 1 / g]])
    loop = np.block([[M - np.outer(l, c), l[:, None]], [g * c, 1 - g]])
    try:
        decay = share * min(
            eigh(P - M.T @ P @ M, P, eigvals_only=True)[0],
            eigh(whole - loop.T @ whole @ loop, whole, eigvals_only=True)[0],
        )
    except np.linalg.LinAlgError:
        return None
    push = reading * np.append(l, -g)
    cross = loop.T @ whole @ push
    fall = (1 - decay) * whole - loop.T @ whole @ loop
    loud = push @ whole @ push + cross @ np.linalg.solve(fall, cross)
    own = M.T @ P @ l - c
    margin = (2 - g - l @ P @ l - own @ np.linalg.solve(P - M.T @ P @ M, own)) / 2
    if not min(decay, margin) > 0:
        return None
    B = np.array(proof["plant"]["B"], float)
    x = np.array(proof["bounds"]["x"], float)
    pushes = np.sqrt(np.einsum("ij,ik,kj->j", B, P, B)) * np.array(disturbance, float)
    step = float(proof["plant"]["Ts"]) * pushes.sum()
    step += 2.0 ** -(24 if proof["source"]["format"] == "float" else 53) * np.sqrt(x @ abs(P) @ x)
    K = _absorbing(decay, loud, step, float(noise))
    seen = np.sqrt(c @ np.linalg.solve(P, c))
    wide = 2 * float(proof["sensor"]["width_max"]) ** 2 / g
    numbers = {"margin": margin / ROOM, "decay": decay, "noise": loud * ROOM}
    storage = {"P": P, "W": 1.0} | {key: float(value) for key, value in numbers.items()}
    return _Storage(storage, seen * np.sqrt(K**2 + wide), seen * K * (1 + seen**2 / g))


def _absorbing(decay: float, loud: float, push: float, noise: float) -> float:
    """Return the least K with sqrt((1 - decay) K^2 + loud noise^2) + push <= K."""
    rest = push**2 * (1 - decay) + decay * loud * noise**2
    return float((push + np.sqrt(rest)) / decay)


def _propose_set(
    proof: dict[str, Any],
    code: ProvedCode,
    gaps: Gaps,
    name: str,
    wide: bool,
    noise: Fraction,
    disturbance: list[Fraction],
) -> dict[str, Any]:
    """Return a set of errors that no step leaves.

    Args:
        proof: its plant, gains and V.
        code: the C.
        gaps: between both.
        name: of the set.
        wide: whether it has any widths, or those that follow from the states.
        noise: bound of a reading's error.
        disturbance: bounds of the disturbances at the inputs.
    """
    storage, g = proof["storage"], float(proof["gains"]["g"])
    decay, loud = float(storage["decay"]), float(storage["noise"])
    widest = proof["sensor"]["width_max"]
    h = np.sqrt(float(dual(storage["P"], proof["gains"]["c"])) / g)
    one = {"name": name, "noise": noise, "disturbance": disturbance, "width": widest}
    one["V"] = 2 * widest**2 / proof["gains"]["g"] if wide else Fraction(0)
    for _ in range(PASSES):
        measured = measure_steps(proof, code, gaps, one)
        K = ROOM * max(
            _absorbing(decay, loud, float(push), float(noise) * abs(side))
            for side, push, _ in measured
        )
        V = K**2 + 2 * float(widest) ** 2 / g
        if not wide:
            wrong = max(float(wrong) for *_, wrong in measured)
            d = (wrong / g + float(proof["gains"]["reading"] * noise)) / np.sqrt(g)
            own = ROOM * max(np.roots([1 - g * h**2, -2 * g * h * d, -g * d**2 - K**2]))
            rest = ROOM * np.hypot(h * own + d, K)
            w = ROOM * (h * rest + d)
            V = rest**2 + w**2
            one |= {"K1": Fraction(own), "width": Fraction(w * np.sqrt(g))}
        one |= {"K": Fraction(K), "V": Fraction(V * ROOM)}
    (C,) = proof["plant"]["C"]
    return one | {
        "radius": Fraction(_round_up(np.sqrt(float(one["V"] * dual(storage["P"], C))), 4))
    }


def _round_up(number: float, digits: int) -> Fraction:
    """Return a number with a few digits, not below it."""
    context = decimal.Context(prec=digits, rounding=decimal.ROUND_UP)
    return Fraction(context.create_decimal(float(number)))


def _to_exact(value: Any) -> Any:
    """Return the content of a proof with its numbers as fractions."""
    if isinstance(value, dict):
        return {key: _to_exact(each) for key, each in value.items()}
    if isinstance(value, list | np.ndarray):
        return [_to_exact(each) for each in value]
    return Fraction(value) if isinstance(value, float) else value


def _finish(proof: dict[str, Any]) -> dict[str, Any]:
    """Return a proof with its statement, checked. Raises ProofError."""
    proof["statement"] = state(proof)
    try:
        verify(proof)
    except Refused as step:
        raise ProofError(f"proof: {step} (fails for the numbers that were found)") from None
    return proof


def proof_text(proof: dict[str, Any]) -> str:
    """Return the text of a proof's file."""
    return json.dumps(proof, indent=1, default=str) + "\n"
