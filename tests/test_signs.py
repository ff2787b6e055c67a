"""Signs, limits and constants that `make mutants` found unguarded: each test guards one."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from scenes import PAPER_PLANT
from test_identifiability import visiting
from undeadzone.analysis.certificate.passivity import certify
from undeadzone.analysis.convergence.falsify import falsify
from undeadzone.analysis.dissipation import _lyapunov
from undeadzone.analysis.side_schedule import arriving
from undeadzone.errors import InputError
from undeadzone.numerics.gaussian import Gaussian
from undeadzone.observers.parts.shown_belief import FAR, clipped
from undeadzone.observers.parts.widths import bounded_widths


def test_the_largest_growth_is_that_of_the_worst_trajectory() -> None:
    """Of one switch, it is 1 + the rise."""
    proof = certify(PAPER_PLANT.linear, np.array([[1.0], [1.5]]), np.array([10.0]))
    attack = falsify(proof.dynamics, proof.V, trajectories=500, switches=1)
    assert attack.growth == pytest.approx(1 + attack.rise, rel=1e-12)


@pytest.mark.parametrize("Ts", [0.5, 2.0])
def test_the_start_of_the_search_proves_a_sampled_plant(Ts: float) -> None:
    """Poles near -1, where Tustin's rule with a wrong sign ends in another P."""
    F = np.array([[-0.9, 3.0], [0.0, -0.8]])
    P = _lyapunov((F - np.eye(2)) / Ts, Ts)
    assert np.linalg.eigvalsh(P).min() > 0
    assert np.linalg.eigvalsh(F.T @ P @ F - P).max() < 0


def test_dropout_of_one_output_alone_counts() -> None:
    schedule = visiting([True, True], [True, True], 0.01)
    judged = arriving(schedule, np.array([1 - 1e-12, 0.0]), 0.01, 1.0, 2)
    assert (judged.sides[:, 0] == 0).all()
    np.testing.assert_array_equal(judged.sides[:, 1], schedule.sides[:, 1])
    assert (schedule.sides[:, 0] != 0).any()


@pytest.mark.parametrize(("excess", "refuted"), [(0.9, False), (1.1, True), (0.5, False)])
def test_a_width_beyond_its_range_refutes_the_claims_and_gains_variance(
    excess: float, refuted: bool
) -> None:
    setup: Any = SimpleNamespace(model=SimpleNamespace(n=1), doubts=True)
    q: Any = SimpleNamespace(ranges=np.array([[0.0, 3.0]]))
    belief = Gaussian(ca.SX([0.0, 3.0 + excess]), ca.SX(np.diag([1.0, 1 / FAR**2])))
    shown, consistent = clipped(setup, q, belief)
    variance = 1 / FAR**2 + (excess**2 if refuted else 0.0)
    np.testing.assert_allclose(ca.DM(shown.mean).full().ravel(), [0.0, 3.0])
    np.testing.assert_allclose(np.diag(ca.DM(shown.cov).full()), [1.0, variance])
    assert bool(ca.DM(consistent)) is not refuted


def test_a_bound_of_widths_must_be_positive_for_each_output() -> None:
    with pytest.raises(InputError, match="must be positive, found -1"):
        bounded_widths(0.0, [3.0, -1.0], 2)
