"""Kernels of ensembles are made of vector instructions, whatever the order of the plant.

All that may vary varies.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from test_engines import small
from test_run_ensemble import NOISE, PLANT, WIDTHS, vary

from undeadzone_studies.ensemble.batch import prepare_batch

ARITHMETIC = r"(?:fadd|fsub|fmul|fdiv)(?: contract)?"


pytestmark = pytest.mark.usefixtures("own_cache")


def functions(code: str) -> dict[str, str]:
    """The body of each function of LLVM's text, by name."""
    return dict(re.findall(r'^define [^@]*@"?([^"(]+)"?\(.*?\{\n(.*?)^\}', code, re.M | re.S))


def counted(body: str) -> tuple[int, int]:
    """(vector, scalar) sums and products."""
    vector = rf"{ARITHMETIC} <\d+ x double>|call <\d+ x double> @llvm\.fma"
    scalar = rf"{ARITHMETIC} double|call double @llvm\.fma"
    return len(re.findall(vector, body)), len(re.findall(scalar, body))


def dense(n: int) -> dict[str, Any]:
    """A stable plant of order n without a zero."""
    rng = np.random.default_rng(n)
    A = rng.normal(size=(n, n))
    A -= (np.linalg.eigvals(A).real.max() + 1) * np.eye(n)
    return {
        "A": A.tolist(),
        "B": rng.normal(size=(n, 1)).tolist(),
        "C": rng.normal(size=(1, n)).tolist(),
    }


@pytest.mark.parametrize(
    ("time", "n"),
    [("sampled", 2), ("sampled", 4), ("sampled", 8), ("sampled", 12), ("continuous", 2)],
)
def test_kernels_are_vectorised(time: str, n: int) -> None:
    observer = {"method": "certified", "L": [1.0] + [0.0] * (n - 1), "gamma": 5.0}
    simulation = {"duration": 0.1, "step": 1e-3}
    scenario = small(time, plant=dense(n), observer=observer, simulation=simulation)
    batch = prepare_batch(vary(scenario, WIDTHS | PLANT | NOISE))
    entries = {f"plant.A[{i},{j}] (relative)" for i, j in np.ndindex(n, n)}
    assert entries <= set(batch.binding.names_of_columns)
    code = batch.kernel.block.text
    bodies = {name: body for name, body in functions(code).items() if any(counted(body))}
    # The lanes; in continuous time, those in which the side changes too.
    assert len(bodies) >= (2 if time == "continuous" else 1)
    for name, body in bodies.items():
        vector, scalar = counted(body)
        assert vector > 5 * scalar, name
        assert vector > n * n
