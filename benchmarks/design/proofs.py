"""Proofs down to the bits: written, checked, changed, and attacked through the exported C.

`python -m benchmarks.design.proofs --designs 50 --sequences 1000000 --seed 0`
"""

from __future__ import annotations

import argparse
import copy
import ctypes
import sys
import tempfile
import time
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import undeadzone as uz
from benchmarks.design.random_designs import random_matrices
from benchmarks.markdown import head, row
from undeadzone.analysis.certificate.weights import margin_of_weights
from undeadzone.analysis.error_dynamics import build_error_dynamics
from undeadzone.linalg.hold import zoh
from undeadzone.util.arrays import Floats
from undeadzone_export import proving
from undeadzone_export.code import build_code
from undeadzone_export.compiler import compile_library, write_sources
from undeadzone_export.exported_step import build_step
from undeadzone_export.source import Labels, build_source
from undeadzone.scenario.problem import resolve_scenario
from undeadzone_proof import compare_step, hold, list_sides, state, verify
from undeadzone_proof.exact import Refused
from undeadzone_proof.source import Code

OPTIONS = {"designs": 50, "sequences": 1_000_000, "seed": 0}
MARGINS = (1e-3, 1e-2, 0.1, 0.5)
SHORT, LONG = 200, 20_000  # steps of a sequence, and of one that reaches the floor
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


if __name__ == "__main__":
    for k in range(int(sys.argv[1]), int(sys.argv[2])):
        sc = random_scenario(0, k)
        try:
            pr = resolve_scenario(sc)
            if pr.model.Ts is None:
                t = time.process_time()
                p = proving._propose_continuous(pr)
                print(k, pr.plant.n, float(p["storage"]["margin"]), time.process_time() - t)
                continue
            for single in (False, True):
                text = build_source(build_code(build_step(pr), single), Labels("observer", "x", "observer"))
                t = time.process_time()
                p = proving.propose_sampled(pr, text, single)
                print(k, pr.plant.n, MARGINS[k // 12 % 4], [float(s["radius"]) for s in p["sets"]], float(p["storage"]["decay"]), time.process_time() - t, flush=True)
        except Exception as e:
            print(k, "FAILED", type(e), str(e)[:300])
