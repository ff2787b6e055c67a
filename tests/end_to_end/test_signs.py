"""Signs, limits and constants that `make mutants` found unguarded: each test guards one."""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm
from test_identifiability import visiting

from scenes import PAPER_PLANT, linear
from undeadzone.analysis.branch_schedule import _count_samples, drop_rare_branches
from undeadzone.analysis.certificate.passivity import certify, is_defective
from undeadzone.analysis.certificate.robust import l2_gain
from undeadzone.analysis.convergence.falsify import falsify
from undeadzone.analysis.dissipation import _lyapunov_storage
from undeadzone.analysis.identifiability.disturbance import unknown_bias
from undeadzone.analysis.identifiability.linear import remedy_to_reach_edges
from undeadzone.analysis.identifiability.linearised_run import _assemble_run
from undeadzone.errors import InputError
from undeadzone.linalg.matrices import Matrices
from undeadzone.linalg.riccati import solve_riccati
from undeadzone.linalg.structure import output_chains, uncontrollable_modes, unobservable_modes
from undeadzone.nonlinearities.sensor import Sensor, resolve
from undeadzone.numerics.gaussian import Gaussian
from undeadzone.numerics.optimise import find_pareto_front, minimise_by_cmaes
from undeadzone.observers import Certified
from undeadzone.observers.adaptive.adaptation_laws import read_initial_widths
from undeadzone.observers.filtering.consistency import innovation_log_density
from undeadzone.observers.filtering.gaussian_filter import FAR, clip_to_ranges
from undeadzone.observers.filtering.prior import Assumptions, build_prior
from undeadzone.plants.system import sample_plant
from undeadzone.signals.exosystem import Random
from undeadzone_arena.observers.parts import interval_step


def test_the_largest_growth_is_that_of_the_worst_trajectory() -> None:
    """Of one switch, it is 1 + the rise."""
    proof = certify(PAPER_PLANT.linear, np.array([[1.0], [1.5]]), np.array([10.0]))
    attack = falsify(proof.dynamics, proof.V, trajectories=500, switches=1)
    assert attack.growth == pytest.approx(1 + attack.rise, rel=1e-12)


@pytest.mark.parametrize("Ts", [0.5, 2.0])
def test_the_start_of_the_search_proves_a_sampled_plant(Ts: float) -> None:
    """Poles near -1, where Tustin's rule with a wrong sign ends in another P."""
    F = np.array([[-0.9, 3.0], [0.0, -0.8]])
    P = _lyapunov_storage((F - np.eye(2)) / Ts, Ts)
    assert np.linalg.eigvalsh(P).min() > 0
    assert np.linalg.eigvalsh(F.T @ P @ F - P).max() < 0


def test_dropout_of_one_output_alone_counts() -> None:
    schedule = visiting([True, True], [True, True], 0.01)
    judged = drop_rare_branches(schedule, np.array([1 - 1e-12, 0.0]), 0.01, 1.0, 2)
    assert (judged.sides[:, 0] == 0).all()
    np.testing.assert_array_equal(judged.sides[:, 1], schedule.sides[:, 1])
    assert (schedule.sides[:, 0] != 0).any()


@pytest.mark.parametrize(("excess", "refuted"), [(0.9, False), (1.1, True), (0.5, False)])
def test_a_width_beyond_its_range_refutes_the_claims_and_gains_variance(
    excess: float, refuted: bool
) -> None:
    q: Any = SimpleNamespace(ranges=np.array([[0.0, 3.0]]))
    belief = Gaussian(ca.SX([0.0, 3.0 + excess]), ca.SX(np.diag([1.0, 1 / FAR**2])))
    shown, consistent = clip_to_ranges(1, q, belief, doubts=True)
    variance = 1 / FAR**2 + (excess**2 if refuted else 0.0)
    np.testing.assert_allclose(ca.DM(shown.mean).full().ravel(), [0.0, 3.0])
    np.testing.assert_allclose(np.diag(ca.DM(shown.cov).full()), [1.0, variance])
    assert bool(ca.DM(consistent)) is not refuted


def test_a_bound_of_widths_must_be_positive_for_each_output() -> None:
    with pytest.raises(InputError, match="must be positive, found -1"):
        read_initial_widths(0.0, [3.0, -1.0], 2)


@pytest.mark.parametrize("unit", [1e-9, 1e-3, 1e3, 1e9])
def test_a_slow_plant_is_as_observable_as_a_fast_one(unit: float) -> None:
    A, B, C = PAPER_PLANT.linear
    assert unobservable_modes(unit * A, C) == []
    assert uncontrollable_modes(unit * A, B) == []
    hidden = unobservable_modes(unit * np.diag([-1.0, -2.0]), np.array([[1.0, 0.0]]))
    assert np.allclose(hidden, [-2.0 * unit])


def test_an_observer_that_adapts_one_of_two_outputs_adapts() -> None:
    model = linear([[-1.0, 0.5], [-0.5, -2.0]], np.eye(2), np.eye(2))
    sensor = resolve(Sensor(right=np.array([0.5, 0.4]), left=0.3), 2, 1e-2)
    for gamma, adapts in (([5.0, 0.0], True), ([0.0, 0.0], False)):
        assert Certified(gamma=gamma).build(model, sensor).traits.adapts is adapts


def test_a_gain_to_three_times_the_output_is_three_times_the_gain() -> None:
    found = certify(PAPER_PLANT.linear, np.array([[1.0], [1.5]]), np.array([10.0]))
    C = PAPER_PLANT.linear.C
    one, three = (
        l2_gain(found.dynamics, np.array([[0.0], [1.0]]), np.ones(1), size * C) for size in (1, 3)
    )
    assert three.disturbance == pytest.approx(3 * one.disturbance, rel=0.01)
    assert three.noise == pytest.approx(3 * one.noise, rel=0.01)


@pytest.mark.parametrize("part", ["steps", "outputs"])
def test_a_run_ends_where_one_entry_of_a_derivative_is_not_finite(part: str) -> None:
    steps, outputs = np.zeros((5, 2, 4)), np.zeros((5, 1, 4))
    {"steps": steps, "outputs": outputs}[part][3, 0, 1] = np.nan
    cut = _assemble_run(steps, outputs, np.arange(5), 1e-9)
    assert len(cut.steps) == len(cut.outputs) == 3


def test_boxes_grow_by_what_their_modes_drive_in_each_other(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of upper triangular S and no rotation: |S_ij| r_j above the diagonal, S_ii r_i on it."""
    monkeypatch.setattr(interval_step, "radius_increase", lambda q, phi, z: np.zeros(3))
    setup: Any = SimpleNamespace(pairs=[], model=SimpleNamespace(n=3))
    S = np.array([[-1.0, 4.0, -0.5], [0.0, -2.0, 3.0], [0.0, 0.0, -5.0]])
    r = np.array([0.1, 0.2, 0.3])
    boxes = interval_step.Boxes(np.zeros(3), ca.SX(r), None, None)
    q: Any = SimpleNamespace(S=S)
    grown = interval_step.boxes_rate(setup, q, boxes, ca.SX.eye(3), None)
    expected = np.abs(np.triu(S, 1)) @ r + np.diag(S) * r
    np.testing.assert_allclose(ca.DM(grown.radius).full().ravel(), expected, rtol=1e-14)


def test_a_gain_that_is_not_asked_for_is_0() -> None:
    dynamics = certify(PAPER_PLANT.linear, np.array([[1.0], [1.5]]), np.array([10.0])).dynamics
    assert l2_gain(dynamics, noise=np.ones(1)).disturbance == 0.0
    assert l2_gain(dynamics, E=np.array([[0.0], [1.0]])).noise == 0.0


def test_a_random_disturbance_leaves_no_bias() -> None:
    gusts = Random(rms=1.0, correlation_time=0.1)
    assert unknown_bias(gusts, np.ones((2, 1)), 10.0) is None
    assert unknown_bias(None, np.ones((2, 1)), 10.0) is None


def test_an_evolution_begins_at_its_start() -> None:
    low, high, start = np.array([-10.0, 100.0]), np.array([30.0, 108.0]), np.array([20.0, 101.0])
    tried: list[Any] = []

    def cost(points: Any) -> Any:
        tried.append(points)
        return np.zeros(len(points))

    minimise_by_cmaes(cost, low, high, seed=3, size=40, rounds=1, start=start, spread=0.01)
    np.testing.assert_allclose(tried[0].mean(axis=0), start, atol=0.01 * 40)


@given(st.integers(0, 2**32 - 1))
def test_an_output_that_is_the_derivative_of_another_one_is_not_counted_twice(seed: int) -> None:
    rng = np.random.default_rng(seed)
    A, first = rng.normal(size=(4, 4)), rng.normal(size=4)
    chains = output_chains(A, np.stack([first, first @ A]))
    rows = chains.O / np.linalg.norm(chains.O, axis=1, keepdims=True)
    assert rows.shape == (4, 4)
    assert np.linalg.cond(rows) < 1e8


def test_newton_refines_a_riccati_solution() -> None:
    """States in units from 1e-4 to 1e4: Schur's method alone leaves 8e-7."""
    rng = np.random.default_rng(8)
    scale = 10 ** rng.uniform(-4, 4, 5)
    A = rng.normal(size=(5, 5)) * scale[:, None] / scale
    B = rng.normal(size=(5, 1)) * scale[:, None]
    Q = np.diag(10 ** rng.uniform(-3, 3, 5))
    assert solve_riccati(Matrices(A, B, np.zeros((0, 5))), Q, np.array([[1e-6]])).residual < 1e-8


def test_the_least_noise_is_a_share_of_the_wider_range() -> None:
    model = sample_plant(PAPER_PLANT, 0.01)
    sensor = resolve(Sensor(right=0.5, left=0.5), 1, 0.01)
    for right, left in (([0.0, 1.0], [0.0, 3.0]), ([0.0, 3.0], [0.0, 1.0])):
        claimed = build_prior(
            Assumptions(right=right, left=left), model, sensor, floor=0.1, wear=0.0
        )
        np.testing.assert_allclose(claimed.R, 0.3**2)


@pytest.mark.parametrize("Ts", [None, 0.1, 2.0])
@pytest.mark.parametrize("chain", [True, False])
def test_a_chain_of_integrators_is_defective_beside_any_other_pole(
    Ts: float | None, chain: bool
) -> None:
    A = np.diag([0.0, 0.0, -0.3])
    A[0, 1] = float(chain)
    assert is_defective(A, Ts) is chain
    if Ts is not None:  # a pole at z = -1 of two states, which a sign would take for one at z = 3
        flip = np.array([[-2.0, float(chain)], [0.0, -2.0]]) / Ts
        assert is_defective(flip, Ts) is chain


def test_the_likelihood_of_innovations_is_the_normal_density() -> None:
    e, std = np.array([0.3, -1.2, 0.0]), np.array([0.5, 3.0, 1.0])
    expected = norm.logpdf(e[:2], scale=std[:2]).sum() + np.log(2 * np.pi)
    assert float(innovation_log_density(ca.DM(e), ca.DM(std))) == pytest.approx(expected)


def test_an_evolution_takes_no_point_that_is_not_finite() -> None:
    def costs(points: Any) -> Any:
        both = np.stack([1 - points[:, 0], points[:, 0]], axis=1)
        both[points[:, 0] > 0.5, 1] = np.inf
        return both

    _, values = find_pareto_front(costs, np.zeros(1), np.ones(1), 1, np.array([[0.2]]), rounds=5)
    assert np.isfinite(values).all()
    assert len(values) > 1


@pytest.mark.parametrize("mean", [0.3, -0.3])
def test_a_swing_that_cures_reaches_both_edges(mean: float) -> None:
    still = visiting([True], [True])._replace(
        low=np.array([mean]), mean=np.array([mean]), high=np.array([mean])
    )
    swing, about = map(
        float, re.findall(r"of (\S+) about (\S+) reaches", remedy_to_reach_edges(still, 0).text)[0]
    )
    assert about == mean
    assert mean + swing > 1.0
    assert mean - swing < -1.0


def test_a_period_that_samples_never_meet_is_none() -> None:
    assert _count_samples(0.5, 0.1, 30.0) == (5, True)
    assert _count_samples(0.25, 0.1, 30.0) == (5, True)
    assert _count_samples(np.pi / 10, 0.1, 30.0) == (300, False)
