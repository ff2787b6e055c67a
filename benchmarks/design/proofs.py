"""Proofs down to the bits: written, checked, changed, and attacked through the exported C.

`python -m benchmarks.design.proofs --designs 50 --sequences 1000000 --seed 0`
"""

from __future__ import annotations

import argparse
import copy
import ctypes
import itertools
import json
import re
import sys
import tempfile
import time
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import undeadzone as uz
from benchmarks.design.random_designs import random_matrices
from benchmarks.markdown import head, row
from undeadzone.analysis.certificate.weights import margin_of_weights
from undeadzone.analysis.error_dynamics import build_error_dynamics
from undeadzone.errors import ProofError
from undeadzone.linalg.hold import zoh
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.util.arrays import Floats
from undeadzone_export import proving
from undeadzone_export.code import build_code
from undeadzone_export.compiler import compile_library, write_sources
from undeadzone_export.exported_step import build_step
from undeadzone_export.source import Labels, build_source
from undeadzone_proof import compare_step, list_sides, state_theorem, to_numbers, verify_proof
from undeadzone_proof.exact import Refused, hold_exactly
from undeadzone_proof.source import Code

OPTIONS = {"designs": 50, "sequences": 1_000_000, "seed": 0}
MARGINS = (1e-3, 1e-2, 0.1, 0.5)
SHORT = 200  # steps of a sequence
HARNESS = Path(__file__).with_name("proof_attack.c")
REFUSALS = (Refused, LookupError, ValueError, TypeError, ArithmeticError, AttributeError)


def random_scenario(seed: int, k: int) -> uz.Scenario:
    """The k-th design: order 1 to 6, every second one sampled, its margin one of MARGINS."""
    rng = np.random.default_rng([seed, k])
    n = 1 + k // 2 % 6
    gain = 0.0
    while abs(gain) < 0.2:
        A, B, C = random_matrices(rng, n, 1, 0.7)
        gain = float((C @ np.linalg.solve(-A, B))[0, 0])
    plant = uz.Plant(A=A, B=B, C=C / gain)
    sampled = k % 2 == 1
    fastest = np.abs(np.linalg.eigvals(A)).max()
    Ts = 10 ** rng.uniform(-2, -0.7) / fastest
    gamma = np.array([fastest * rng.uniform(0.5, 3.0)])
    L = rng.normal(size=(n, 1))
    linear = zoh(uz.Matrices(A, B, C / gain), Ts) if sampled else uz.Matrices(A, B, C / gain)

    def margin_of(size: float) -> float:
        """The margin with gains of a size."""
        errors = build_error_dynamics(linear, L * size, gamma, Ts if sampled else None)
        return margin_of_weights(errors, np.ones(1))[0]

    low, high = 0.0, 1e3 * fastest
    if margin_of(high) > margin_of(-high):  # on one side any gain may do
        L = -L
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if margin_of(middle) > MARGINS[k // 12 % 4] else (low, middle)
    return uz.Scenario(
        plant=plant,
        sensor=uz.Sensor(right=1.0, left=0.6, noise=0.01 * (k % 3)),
        reference=uz.Sine(amplitude=4.0, frequency=0.02 * fastest),
        disturbance=uz.Sine(amplitude=0.05, frequency=0.1 * fastest) if k % 4 == 3 else None,
        observer=uz.Certified(L=L * low, gamma=gamma, width_max=2.0),
        simulation=uz.Simulation(
            time="sampled" if sampled else "continuous", step=Ts, duration=400 * Ts
        ),
    )


class Attack(ctypes.Structure):
    """The result of sequences: largest |z - z^|, V of the set, and |d - d^|; how many left it."""

    _fields_ = [(name, ctypes.c_double) for name in ("seen", "fullest", "width")] + [
        ("left", ctypes.c_long)
    ]


def split(matrix: Any) -> Floats:
    """Fractions as the sums of two doubles."""
    exact = [Fraction(x) for row in matrix for x in row]
    high = np.array(exact, float)
    return np.stack([high, [float(x - Fraction(y)) for x, y in zip(exact, high, strict=True)]])


def attack(proof: Any, one: Any, sequences: int, steps: int, seed: int) -> Attack:
    """Run sequences of the exported C inside a set."""
    held = hold_exactly(*(proof["plant"][key] for key in ("A", "B", "Ts")))
    text, header = proof["source"]["texts"]
    n = len(held[0])
    Psi = held[1]
    own = [*proof["plant"]["C"], proof["bounds"]["x"], *proof["storage"]["P"]]
    scalars = [*proof["sensor"].values(), one["noise"], *one["disturbance"], *proof["bounds"]["u"]]
    scalars += [proof["storage"]["R"], one["V"], one["radius"], one["width"]]
    numbers = np.concatenate(
        [split(held[0]).ravel(), split(Psi).ravel(), *map(np.array, own), scalars]
    )
    setup = np.array(numbers, float)
    kind = proof["source"]["format"]
    code = Code(proof["source"]["texts"], "observer", kind, proof["sensor"]["width_max"])
    E, _ = compare_step(proof, code, held, [Fraction(0)] * n, *list_sides(proof, code, one)[0])
    loop, c = np.array(E, float), np.append(np.array(proof["plant"]["C"][0], float), 0)
    pushes = loop[:, n + 1 :]
    signs = np.empty((steps, 2))
    for k in range(steps):
        signs[-1 - k] = np.sign(c @ pushes)
        pushes = loop[:, : n + 1] @ pushes
    found = Attack()
    with tempfile.TemporaryDirectory() as name:
        files = {"observer.c": text, "observer.h": header, "attack.c": HARNESS.read_text()}
        options = ("-O2", "-std=gnu11", f"-DN={n}", f"-DREAL={kind}")
        library = compile_library(write_sources(files, Path(name)), Path(name, "a.so"), options)
        signs = np.ascontiguousarray(signs)
        ctypes.CDLL(str(library)).attack(
            setup.ctypes.data_as(ctypes.c_void_p),
            ctypes.c_long(sequences),
            ctypes.c_long(steps),
            int("any" not in one["name"]),
            signs.ctypes.data_as(ctypes.c_void_p),
            ctypes.c_ulonglong(seed),
            ctypes.byref(found),
        )
    return found


# Changes of a proof: entry, factor, what is added, whether the statement changes with it.
BIT = 1 + 2.0**-52
SAMPLED: tuple[tuple[tuple[Any, ...], float, float, bool], ...] = (
    (("plant", "A", 0, 0), -1, 0, True),
    (("plant", "A", -1, -1), 1.001, 0, True),
    (("plant", "A", 0, 0), BIT, 0, False),
    (("plant", "B", 0, 0), 1.01, 0, True),
    (("plant", "C", 0, 0), 1.01, 0, True),
    (("plant", "Ts"), 1.001, 0, True),
    (("sensor", "slope"), 1.01, 0, True),
    (("sensor", "threshold"), 1, 1e-3, True),
    (("sensor", "width_max"), 0.5, 0, True),
    (("bounds", "x", 0), 1.01, 0, True),
    (("bounds", "u", 0), 2, 0, True),
    (("gains", "L", 0), -1, 0, True),
    (("gains", "gamma"), BIT, 0, True),
    (("storage", "P", 0, 0), -1, 0, True),
    (("storage", "P", 0, 0), 0.5, 0, True),
    (("storage", "R"), -1, 0, True),
    (("storage", "decay"), 10, 0, True),
    (("storage", "loud", 0), 0, 0, True),
    (("sets", -1, "radius"), 0.99, 0, True),
    (("sets", -1, "V"), 0.99, 0, True),
    (("sets", -1, "K"), 0.99, 0, True),
    (("sets", -1, "noise"), 1, 1e-3, True),
    (("constants", 5), BIT, 2.0**-1074, True),
)
CONTINUOUS: tuple[tuple[tuple[Any, ...], float, float, bool], ...] = (
    (("plant", "A", 0, 0), -1, 0, False),
    (("plant", "A", 0, 0), -9, 0, True),
    (("plant", "A", -1, -1), 1.001, 0, False),
    (("plant", "A", 0, 0), BIT, 0, False),
    (("plant", "B", 0, 0), BIT, 0, False),
    (("plant", "B", 0, 0), -1, 0, False),
    (("plant", "C", 0, 0), BIT, 0, False),
    (("plant", "C", 0, 0), -1, 0, False),
    (("plant", "C", 0, 0), 100, 0, True),
    (("gains", "L", 0), -1, 0, False),
    (("gains", "L", 0), BIT, 0, False),
    (("gains", "L", -1), 1.001, 0, False),
    (("gains", "L", -1), 1000, 0, True),
    (("storage", "P", 0, 0), -1, 0, True),
    (("storage", "P", 0, 0), 0, 0, True),
    (("storage", "P", 0, 0), 100, 0, True),
    (("storage", "W"), -1, 0, True),
    (("storage", "W"), 100, 0, True),
    (("storage", "margin"), 1.00001, 0, True),
    (("storage", "margin"), BIT, 0, False),
)


def change_text(proof: Any) -> list[Any]:
    """Proofs with one bit of the C changed, a sign of its adaptation, an operation, a word."""
    changed = [copy.deepcopy(proof) for _ in range(4)]
    text = proof["source"]["texts"][0]
    number = max(re.findall(r"\d\.\d+(?:e[+-]\d+)?", text[text.index("_step(") :]), key=len)
    near = repr(float(np.nextafter(float(number), np.inf)))
    changed[0]["source"]["texts"][0] = text.replace(number, near)
    changed[1]["source"]["texts"][0] = text.replace("right_was_0 + ", "right_was_0 - ")
    old = changed[1]["operations"]
    changed[1]["operations"] = [x.replace("right_was_0 + ", "right_was_0 - ") for x in old]
    changed[2]["operations"].pop()
    changed[3]["statement"] += " Always."
    return changed


def mutants(proof: Any) -> list[Any]:
    """All changes of a proof, each in a copy."""
    sampled = "source" in proof
    found = change_text(proof) if sampled else []
    for path, factor, shift, restated in SAMPLED if sampled else CONTINUOUS:
        changed = copy.deepcopy(proof)
        *way, last = path
        place = changed
        for key in way:
            place = place[key]
        place[last] = place[last] * Fraction(factor) + Fraction(shift)
        if restated:
            changed["statement"] = state_theorem(changed)
        found.append(changed)
    return found


def is_refused(proof: Any) -> bool:
    """Whether the checker refuses a proof."""
    try:
        verify_proof(proof)
    except REFUSALS:
        return True
    return False


class Tried(NamedTuple):
    """A design, its proof and what became of both.

    Attributes:
        order: of the plant
        kind: continuous, double or float
        margin: of the gains
        quiet: whether nothing comes from outside
        proved: the reason why not, or empty
        seconds: of the processor, to write and to check
        mutants: how many
        accepted: numbers of those that were not refused
        ratios: of a set's radius to the largest error seen, by the set's name
        left: sequences that left a set
    """

    order: int
    kind: str
    margin: float
    quiet: bool
    proved: str
    seconds: float = 0.0
    mutants: int = 0
    accepted: tuple[int, ...] = ()
    ratios: dict[str, float] = {}
    left: int = 0


def try_design(seed: int, k: int, sequences: int) -> list[Tried]:
    """Prove the k-th design, change its proof, attack its sets."""
    problem = resolve_scenario(random_scenario(seed, k))
    quiet = not problem.sensor.noise.any() and problem.disturbance is None
    own = problem.plant.n, MARGINS[k // 12 % 4], quiet
    tried = []
    for kind in ("continuous",) if problem.model.Ts is None else ("double", "float"):
        single = kind == "float"
        if kind == "continuous":
            write = partial(proving.propose_continuous, problem)
        else:
            printed = build_code(build_step(problem), single)
            text = build_source(printed, Labels("observer", "design", "observer"))
            write = partial(proving.propose_sampled, problem, text, single)
        began = time.process_time()
        try:
            proof = write()
        except ProofError as error:
            tried.append(Tried(own[0], kind, *own[1:], str(error)))
            continue
        verify_proof(to_numbers(json.loads(proving.proof_text(proof))))
        seconds = time.process_time() - began
        every = [] if single else mutants(proof)
        accepted = tuple(i for i, each in enumerate(every) if not is_refused(each))
        sets = proof.get("sets", [])
        found = {one["name"]: attack(proof, one, sequences, SHORT, k) for one in sets}
        ratios = {one["name"]: float(one["radius"]) / found[one["name"]].seen for one in sets}
        left = sum(each.left for each in found.values())
        tried.append(Tried(own[0], kind, *own[1:], "", seconds, len(every), accepted, ratios, left))
    return tried


def table(designs: int = 50, sequences: int = 1_000_000, seed: int = 0) -> str:
    """Proofs, changes refused, and sets beside the largest errors seen, by kind and margin."""
    tried: list[Tried] = []
    each = -(-sequences // designs // 3)  # two formats of every second design, three sets
    for k in range(designs):
        tried += try_design(seed, k, each)
        print(tried[-1], file=sys.stderr, flush=True)
    lines = [
        "## Proofs down to the bits\n",
        f"{designs} designs of orders 1 to 6, every second one sampled, in double and in float. "
        f"Sequences of sides, readings and disturbances attack each set ({each} of "
        f"{SHORT} steps: random, on one side with the worst signs, greedy in |z - z^| and in V), "
        "begun without an error of the states, of any widths or known ones. `seen` is the set's "
        "radius over the largest |z - z^|: median, largest; `quiet` designs have neither noise nor "
        "disturbances.\n",
        *head(
            *("designs", "margin", "proved", "changes refused", "most CPU s", "sequences", "left"),
            *("any widths: seen, quiet", "noisy", "known widths: seen", "rounding alone: seen"),
        ),
    ]
    for kind, margin in itertools.product(("continuous", "double", "float"), MARGINS):
        rows = [one for one in tried if (one.kind, one.margin) == (kind, margin)]
        proved = [one for one in rows if not one.proved]
        changes = sum(one.mutants for one in proved)
        refused = changes - sum(len(one.accepted) for one in proved)
        count = sum(len(one.ratios) for one in proved) * each
        cells = [
            _spread(
                [one.ratios[name] for one in proved if name in one.ratios and one.quiet in which]
            )
            for name, which in (
                ("any widths", (True,)),
                ("any widths", (False,)),
                ("known widths", (True, False)),
                ("rounding alone", (True, False)),
            )
        ]
        lines.append(
            row(
                *(kind, f"{margin:g}", f"{len(proved)} of {len(rows)}", f"{refused} of {changes}"),
                f"{max((one.seconds for one in proved), default=0):.2f}",
                *(f"{count:,}", f"{sum(one.left for one in proved)}", *cells),
            )
        )
    return "\n".join(lines) + "\n"


def _spread(ratios: list[float]) -> str:
    """Median and largest."""
    return f"{np.median(ratios):.3g}, {max(ratios):.3g}" if ratios else "-"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    for name, default in OPTIONS.items():
        parser.add_argument(f"--{name}", type=int, default=default)
    print(table(**vars(parser.parse_args())))
