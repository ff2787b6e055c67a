"""Proofs down to the bits: written, checked, changed, and attacked through the exported C.

`python -m benchmarks proofs --designs 50 --sequences 1000000 --seed 0`
"""

from __future__ import annotations

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
from undeadzone_export import proving
from undeadzone_export.code import build_code
from undeadzone_export.compiler import compile_library, write_sources
from undeadzone_export.exported_step import build_step
from undeadzone_export.source import Labels, build_source
from undeadzone_proof import FAULTS, state_theorem, to_numbers, verify_proof
from undeadzone_proof.source import Refused
from undeadzone_proof.theorem import hold_exactly

MARGINS = (1e-3, 1e-2, 0.1, 0.5)
SHORT, LONG = 200, 20000  # steps of a sequence; one in 200 is long
HARNESS = Path(__file__).with_name("proof_attack.c")


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
    """The result of sequences: largest |z - z^| and V; how many left the set."""

    _fields_ = [("seen", ctypes.c_double), ("fullest", ctypes.c_double), ("left", ctypes.c_long)]


def attack(proof: Any, sequences: int, seed: int) -> Attack:
    """Run sequences of the exported C inside a set."""
    bounds, (text, header) = proof["bounds"], proof["source"]["texts"]
    matrices = hold_exactly(proof["plant"]), proof["plant"]["C"], [bounds["x"]], proof["set"]["S"]
    scalars = [
        *proof["gains"],
        *proof["sensor"].values(),
        bounds["noise"],
        *bounds["disturbance"],
        *bounds["u"],
    ]
    numbers = [*itertools.chain(*itertools.chain(*matrices)), *scalars, proof["set"]["radius"]]
    setup = np.array(numbers, float)
    found = Attack()
    with tempfile.TemporaryDirectory() as name:
        files = {"observer.c": text, "observer.h": header, "attack.c": HARNESS.read_text()}
        size, kind = f"-DN={len(bounds['x'])}", f"-DREAL={proof['source']['format']}"
        options = ("-O3", "-march=native", "-std=gnu11", size, kind)
        library = compile_library(write_sources(files, Path(name)), Path(name, "a.so"), options)
        for count, steps in ((sequences, SHORT), (sequences // 200 + 32, LONG)):
            ctypes.CDLL(str(library)).attack(
                setup.ctypes.data_as(ctypes.c_void_p),
                ctypes.c_long(count),
                ctypes.c_long(steps),
                ctypes.c_ulonglong(seed),
                ctypes.byref(found),
            )
    return found


# Changes of a proof: the entry and its factor. The statement changes with it.
SAMPLED = """plant A 0 0 -1; plant A -1 -1 1.5; plant B 0 0 -1; plant C 0 0 -9; plant C 0 -1 -1;
    plant Ts 1.1; sensor slope 1.5; sensor width_max 0.5; sensor width_max 1.5; bounds x 0 1e9;
    bounds reach 0 0.9; gains 0 -1; gains 0 0.999; gains -2 1.001;
    storage P 0 0 -1; storage P -1 -1 -1; set S 0 0 -1; set S 0 0 0.5; set S -1 -1 1.1;
    set radius 0.99; set side decay 3; set side loud 2 0; set silent loud 0 -1; set side loud -1 0;
    set side clip 1 -1"""
CONTINUOUS = """plant A 0 0 -9; plant A -1 -1 -9; plant A 0 0 -99; plant A -1 -1 -99;
    plant C 0 0 -99; plant C 0 0 99; plant C 0 -1 -99; plant C 0 -1 99;
    gains L 0 -999; gains L 0 999; gains L -1 -999; gains L -1 999;
    storage P 0 0 -1; storage P 0 0 0; storage P 0 0 100; storage P -1 -1 -1; storage P -1 -1 100;
    storage W -1; storage W 0; storage W 100; storage margin 1.001; storage margin -1"""


def change_text(proof: Any) -> list[Any]:
    """Proofs with one bit of the C changed, a sign of its adaptation, an operation, a word."""
    changed = [copy.deepcopy(proof) for _ in range(4)]
    text = proof["source"]["texts"][0]
    number = max(re.findall(r"\d\.\d+(?:e[+-]\d+)?", text[text.index("_step(") :]), key=len)
    real = np.float32 if proof["source"]["format"] == "float" else np.float64
    near = str(np.nextafter(real(number), real(np.inf)))
    changed[0]["source"]["texts"][0] = text.replace(number, near)
    changed[1]["source"]["texts"][0] = text.replace("right_was_0 + ", "right_was_0 - ")
    lines = proof["operations"]
    changed[1]["operations"] = [x.replace("right_was_0 + ", "right_was_0 - ") for x in lines]
    changed[2]["operations"].pop()
    changed[3]["constants"][-1] += Fraction(1, 1 << 1074)
    return changed


def mutants(proof: Any) -> list[Any]:
    """All changes of a proof, each in a copy."""
    sampled = "source" in proof
    found = change_text(proof) if sampled else []
    for change in (SAMPLED if sampled else CONTINUOUS).split(";"):
        changed = copy.deepcopy(proof)
        *way, last, factor = (int(x) if re.fullmatch("-?\\d", x) else x for x in change.split())
        place = changed
        for key in way:
            place = place[key]
        place[last] *= Fraction(factor)
        found.append(changed | {"statement": state_theorem(changed)})
    return found


def is_refused(proof: Any) -> bool:
    """Whether the checker refuses a proof."""
    try:
        verify_proof(proof)
    except (Refused, *FAULTS):
        return True
    return False


class Tried(NamedTuple):
    """A design, its proof and what became of both.

    Attributes:
        kind: continuous, double or float
        margin: of the gains
        proved: the reason why not, or empty
        seconds: of the processor, to write and to check
        accepted: of each change, whether the checker accepts it
        ratio: of the set's radius to the largest error seen
        left: sequences that left the set
    """

    kind: str
    margin: float
    proved: str
    seconds: float = 0.0
    accepted: tuple[bool, ...] = ()
    ratio: float = 0.0
    left: int = 0


def try_design(seed: int, k: int, sequences: int) -> list[Tried]:
    """Prove the k-th design, change its proof, attack its set."""
    problem = resolve_scenario(random_scenario(seed, k))
    tried = []
    for kind in ("continuous",) if problem.model.Ts is None else ("double", "float"):
        own = kind, MARGINS[k // 12 % 4]
        write = partial(proving.propose_continuous, problem)
        if kind != "continuous":
            printed = build_code(build_step(problem), kind == "float")
            text = build_source(printed, Labels("observer", "design", "observer"))
            write = partial(proving.propose_sampled, problem, text, kind == "float")
        began = time.process_time()
        try:
            proof = write()
        except ProofError as error:
            tried.append(Tried(*own, str(error)))
            continue
        verify_proof(to_numbers(json.loads(proving.proof_text(proof))))
        seconds = time.process_time() - began
        accepted = tuple(not is_refused(each) for each in mutants(proof))
        ratio, left = 0.0, 0
        if kind != "continuous":
            found = attack(proof, sequences, k)
            ratio, left = float(proof["set"]["radius"]) / found.seen, found.left
        tried.append(Tried(*own, "", seconds, accepted, ratio, left))
    return tried


def table(designs: int = 50, sequences: int = 1_000_000, seed: int = 0) -> str:
    """Proofs, changes refused, and sets beside the largest errors seen, by kind and margin."""
    tried: list[Tried] = []
    each = -(-sequences // designs)  # two formats of every second design
    for k in range(designs):
        tried += try_design(seed, k, each)
        print(tried[-1], file=sys.stderr, flush=True)
    lines = [
        "## Proofs down to the bits\n",
        f"{designs} designs of orders 1 to 6, every second one sampled, in double and in float. "
        f"{each} sequences of sides, readings and disturbances attack each set ({SHORT} steps, one "
        f"in 200 {LONG}), begun without an error of the states. Of 16 the first is random, and "
        "each of the others is the one before with the sides, noise, disturbances, widths and "
        "roundings that its adjoint prefers. `seen` is the set's radius over the largest |z - z^|: "
        "median, largest.\n",
        *head(
            *("designs", "margin", "proved", "changes refused", "most CPU s", "sequences", "left"),
            "seen",
        ),
    ]
    for kind, margin in itertools.product(("continuous", "double", "float"), MARGINS):
        rows = [one for one in tried if (one.kind, one.margin) == (kind, margin)]
        proved = [one for one in rows if not one.proved]
        changes = list(itertools.chain(*(one.accepted for one in proved)))
        lines.append(
            row(
                *(kind, f"{margin:g}", f"{len(proved)} of {len(rows)}"),
                f"{changes.count(False)} of {len(changes)}",
                f"{max((one.seconds for one in proved), default=0):.2f}",
                f"{len(proved) * each * (kind != 'continuous'):,}",
                f"{sum(one.left for one in proved)}",
                spread([one.ratio for one in proved]),
            )
        )
    return "\n".join(lines) + "\n"


def spread(ratios: list[float]) -> str:
    """Median and largest."""
    return f"{np.median(ratios):.3g}, {max(ratios):.3g}" if any(ratios) else "-"
