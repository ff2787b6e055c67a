"""Law (29) as printed: its numbers, d - d^ given and estimated, and what it refuses."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
import scipy.linalg as sl

from documents import EXAMPLES
from undeadzone.errors import InputError, UndeadzoneError
from undeadzone.plants.build import system
from undeadzone.plants.options import Plant
from undeadzone.results.run import Run
from undeadzone.scenario.reader import read
from undeadzone.scenario.schema import Simulation
from undeadzone.simulation.simulate import simulate
from undeadzone_paper.law import PrintedLaw

EXAMPLE = EXAMPLES / "paper_printed.toml"
A, B, C = np.array([[0.0, 1.0], [-1.0, -2.0]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])
L = np.array([[-1.25], [-1.62]])


def _short_run(**changes: Any) -> Run:
    scenario = read(EXAMPLE)
    law = msgspec.structs.replace(scenario.controller, **changes)
    short = msgspec.structs.replace(
        scenario, controller=law, simulation=Simulation(duration=3.0, step=2e-3)
    )
    return simulate(short, check_step=False)


def _law_by_hand(run: Run, given: bool, sign: float, left: float) -> np.ndarray:
    """u of (29), B'P C' y~ for B'P y~, B'P L for B'P L C."""
    P = sl.solve_continuous_are(A - L @ C, B, np.eye(2), np.eye(1) / 20)
    d, z_hat = run.d_hat, run.z_hat[:, 0]
    y = run.y[:, 0]
    e = y - (z_hat - np.maximum(np.minimum(z_hat, d[:, 0]), -d[:, 1]))
    chi = np.stack([1 + np.tanh(100 * y), left * (1 - np.tanh(100 * y))], axis=1) / 2
    mismatch = (chi * (1 - d)).sum(axis=1) if given else -e
    feedback = 10 * ((B.T @ P @ C.T).item() * e + (B.T @ P @ L).item() * mismatch)
    return -sign * feedback + 5 * np.sin(2 * np.pi * run.t)


@pytest.mark.parametrize(
    ("changes", "given", "sign", "left"),
    [
        ({}, True, 1.0, 1.0),
        ({"widths": None}, False, 1.0, 1.0),
        ({"sign": -1.0}, True, -1.0, 1.0),
        ({"left_sign": 1.0}, True, 1.0, -1.0),
    ],
)
def test_u_is_that_of_29(changes: dict[str, Any], given: bool, sign: float, left: float) -> None:
    run = _short_run(**changes)
    np.testing.assert_allclose(
        run.u[:, 0], _law_by_hand(run, given, sign, left), rtol=1e-6, atol=1e-6
    )


def test_the_example_ends_with_wrong_widths() -> None:
    run = simulate(read(EXAMPLE), check_step=False)
    assert run.divergence_time is None
    assert np.abs(run.d_hat[-1] - 1.0).max() > 5.0


def test_it_is_refused_where_it_is_not_defined() -> None:
    law = PrintedLaw(L=[-1.25, -1.62])
    sampled = msgspec.structs.replace(
        read(EXAMPLE), simulation=Simulation(time="sampled", step=1e-2)
    )
    with pytest.raises(InputError, match="continuous time"):
        simulate(sampled)
    two = system(Plant(A=A.tolist(), B=np.eye(2).tolist(), C=np.eye(2).tolist()))
    with pytest.raises(InputError, match="one input and one output"):
        law.build(two)
    for wrong in ({"alpha": 0.0}, {"widths": [1.0, 2.0, 3.0]}, {"L": [1.0]}, {"Q": -1.0}):
        with pytest.raises(UndeadzoneError, match=f"controller.{next(iter(wrong))}"):
            msgspec.structs.replace(law, **wrong).build(system(read(EXAMPLE).plant))
