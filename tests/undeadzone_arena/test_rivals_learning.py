"""Rivals that learn the dead zone.

Adaptive inverse, gradient, networks as observers and as output feedback (docs/methods).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from test_engines import generated

from scenes import PAPER_PLANT, linear, random_plant, scene, seeds, tables_of
from undeadzone.compile import interpret
from undeadzone.errors import InputError, StepError, StructureError
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Estimate, Observer, Reading
from undeadzone.linalg.matrices import Matrices
from undeadzone.linalg.riccati import fast_gain
from undeadzone.nonlinearities import sensor
from undeadzone.nonlinearities.sensor import Sensor, Zone, resolve
from undeadzone.plants.system import System, fastest_pole, sample_plant
from undeadzone.results.run import Run
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.simulation.simulate import prepare, simulate
from undeadzone.util import tree
from undeadzone.util.arrays import Floats
from undeadzone_arena import (
    AdaptiveInverse,
    FuzzyFeedback,
    FuzzyResidual,
    InverseNetwork,
    RBFFeedback,
    RBFResidual,
    RobustGradient,
    TaylorFeedback,
    TaylorResidual,
)
from undeadzone_arena.approximators import (
    Basis,
    build_gaussians,
    build_jump_functions,
    build_monomials,
)
from undeadzone_arena.controllers.learned_feedback import derivative_rows, error_weights
from undeadzone_arena.gain_defaults import injection_gain
from undeadzone_arena.observers.parts import learned_residual

TWO = linear([[-1.0, 0.5], [-0.5, -2.0]], np.eye(2), [[1.0, 0.0], [0.2, 1.0]])
RIVALS: dict[str, Any] = {
    "adaptive_inverse": AdaptiveInverse(),
    "literal": AdaptiveInverse(silent="zero", law="least_squares", gain=20.0),
    "robust_gradient": RobustGradient(),
    "fuzzy_residual": FuzzyResidual(reach=5.0, rules=4),
    "rbf_residual": RBFResidual(reach=5.0, centres=4, filtered=False),
    "taylor_residual": TaylorResidual(reach=5.0, degree=3),
    "inverse_network": InverseNetwork(scale=1.0, leak=0.1),
}
FEEDBACK: dict[str, Any] = {
    "fuzzy_feedback": FuzzyFeedback(reach=[6.0, 40.0]),
    "rbf_feedback": RBFFeedback(reach=[6.0, 40.0]),
    "taylor_feedback": TaylorFeedback(reach=[6.0, 40.0]),
}


def zone(p: int = 1, **options: Any) -> Zone:
    return resolve(Sensor(**{"right": 1.0, "left": 1.0} | options), p, 1e-3)


class Numbers:
    """An observer run on numbers; `state` is packed."""

    def __init__(self, observer: Observer, model: System) -> None:
        self.like = observer.init(observer.params)
        self.state = tree.pack_tree(self.like)
        p, params = tree.create_symbols(observer.params, "p")
        s, state = tree.create_symbols(self.like, "s")
        u, y, side = ca.SX.sym("u", model.m), ca.SX.sym("y", model.p), ca.SX.sym("side", model.p)
        after, estimate = observer.step(params, state, u, Reading(y, side))
        self._function = ca.Function(
            "step", [p, s, u, y, side], [tree.stack_leaves(after), *estimate]
        )
        self._numbers = tree.pack_tree(observer.params)

    def __call__(self, u: Any, y: Any, side: Any) -> Estimate:
        """Put the next state, or the derivative, into `state`."""
        after, *parts = self._function(self._numbers, self.state, u, y, side)
        self.state = after.full().ravel()
        return Estimate(*(part.full().ravel() for part in parts))

    def part(self, name: str) -> Floats:
        """A field of the state as an array."""
        start = 0
        for path, leaf in tree.iterate_leaves(self.like):
            if path == name:
                return self.state[start : start + leaf.size].reshape(leaf.shape, order="F")
            start += leaf.size
        raise KeyError(name)


# --- Bases


def values(basis: Basis, v: Floats) -> Floats:
    return np.asarray(ca.DM(basis.phi(basis.params, ca.DM(v))).full().ravel())


@given(seeds, st.integers(1, 3), st.booleans())
def test_gaussians_are_products_over_a_grid(seed: int, k: int, normalised: bool) -> None:
    rng = np.random.default_rng(seed)
    reach, v = rng.uniform(0.5, 5, k), rng.normal(size=k) * 2
    functions = values(build_gaussians("key", reach, 4, 0.7, normalised), v)
    at = np.clip(v / reach, -1, 1) if normalised else v / reach
    axes = np.meshgrid(*[np.linspace(-1, 1, 4)] * k, indexing="ij")
    centres = np.stack(axes, axis=-1).reshape(-1, k)
    expected = np.exp(-(((at - centres) / (2 / 3 * 0.7)) ** 2).sum(axis=1) / 2)
    if normalised:
        expected /= expected.sum()
    assert functions == pytest.approx(expected)


def test_monomials_are_complete_and_clipped_at_the_edge_of_the_box() -> None:
    basis = build_monomials("key", np.array([2.0, 4.0]), 3)
    assert basis.size == math.comb(5, 3)
    expected = []
    for i in range(4):
        for j in range(4 - i):
            expected.append(0.5**i * 0.25**j)
    at_one = values(basis, np.array([1.0, 1.0]))
    assert sorted(at_one) == pytest.approx(sorted(expected))
    assert values(basis, np.array([3.0, -9.0])) == pytest.approx(
        values(basis, np.array([2.0, -4.0]))
    )


def test_jump_functions_jump_on_their_side_only() -> None:
    basis = build_jump_functions("key", 3)
    rise = 1 - np.exp(-0.5)
    assert values(basis, np.array([0.5, 1.0])) == pytest.approx([1, rise, rise**2, 0, 0, 0])
    assert values(basis, np.array([-0.5, -1.0])) == pytest.approx([0, 0, 0, -1, -rise, -(rise**2)])
    assert (values(basis, np.array([0.1, 0.0])) == 0).all()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (
            lambda: build_gaussians("key", np.ones(1), 1, 0.7, True),
            "key: a grid needs at least 2 centres per axis, found 1",
        ),
        (
            lambda: build_gaussians("key", np.ones(4), 5, 0.7, True),
            "key: the basis would have 625 functions, at most 200",
        ),
        (
            lambda: build_monomials("key", np.ones(1), 0),
            "key: the degree must be at least 1, found 0",
        ),
        (lambda: build_jump_functions("key", 0), "key: expected at least 1 function, found 0"),
    ],
)
def test_wrong_bases(make: Callable[[], Basis], words: str) -> None:
    with pytest.raises(InputError, match=words):
        make()


# --- One speed for any plant


@given(seeds, st.integers(1, 3), st.integers(1, 2), st.booleans(), st.booleans())
def test_a_speed_moves_every_pole_left_of_half_of_it(
    seed: int, n: int, p: int, stable: bool, in_samples: bool
) -> None:
    flow = random_plant(np.random.default_rng(seed), n, 1, p, stable)
    model = sample_plant(flow, 0.01) if in_samples else flow
    speed = 10 * fastest_pole(model)
    A, _, C = model.linear
    poles = np.linalg.eigvals(A - fast_gain(model.linear, speed, model.Ts) @ C)
    rates = np.log(np.abs(poles)) / 0.01 if in_samples else poles.real
    assert rates.max() < -speed / 2 * (1 - 1e-6)


def test_slow_poles_are_mirrored() -> None:
    """A - L C of the least gain: -1, -1 become -speed + 1, twice."""
    for model in (PAPER_PLANT, sample_plant(PAPER_PLANT, 1e-3)):
        A, _, C = model.linear
        polynomial = np.poly(A - fast_gain(model.linear, 20.0, model.Ts) @ C)
        pole = -19.0 if model.Ts is None else np.exp(-0.019)
        assert polynomial == pytest.approx(np.poly([pole, pole]), rel=1e-4)


def test_one_of_L_poles_speed() -> None:
    L = np.array([1.0, 2.0])
    assert injection_gain(
        sample_plant(PAPER_PLANT, 0.1), L, None, None, 1.0
    ).ravel() == pytest.approx(L * 0.1)
    assert injection_gain(PAPER_PLANT, None, [-4.0, -10.0], None, 1.0).ravel() == pytest.approx(
        [12, 15]
    )
    assert (
        injection_gain(PAPER_PLANT, None, None, 7.0, 1.0)
        == injection_gain(PAPER_PLANT, None, None, None, 7.0)
    ).all()
    with pytest.raises(
        InputError, match=r"observer: give one of L, poles, speed, found L and speed"
    ):
        injection_gain(PAPER_PLANT, L, None, 3.0, 1.0)
    with pytest.raises(InputError, match=r"observer.speed: must be greater than 0"):
        injection_gain(PAPER_PLANT, None, None, 0.0, 1.0)


# --- The adaptive inverse in Tao and Kokotovic's own form: x^ = xi + Phi d^, eta - zeta d^


def literal_filters(
    model: System, L: Floats, gated: bool, readings: list[tuple[Floats, Floats, Floats]]
) -> tuple[Floats, Floats, Floats]:
    """(xi, eta, zeta) along readings (u, y, side): signals that hold no estimate of d."""
    A, B, C = model.linear
    n, p = model.n, model.p
    xi, Phi = np.zeros(n), np.zeros((n, 2 * p))
    rows = []
    for u, y, side in readings:
        gate = np.diag((side != 0) * 1.0) if gated else np.eye(p)
        phi = np.zeros((p, 2 * p))
        for i in range(p):
            phi[i, 2 * i : 2 * i + 2] = [side[i] > 0, -1.0 * (side[i] < 0)]
        rows.append((xi, gate @ (y - C @ xi), gate @ (C @ Phi - phi)))
        xi = A @ xi + B @ u + L @ gate @ (y - C @ xi)
        Phi = A @ Phi - L @ gate @ (C @ Phi - phi)
    return tuple(np.array(part) for part in zip(*rows, strict=True))  # type: ignore[return-value]


def recorded(
    rng: np.random.Generator, model: System, where: Zone, steps: int
) -> list[tuple[Floats, Floats, Floats]]:
    """Readings of a plant that leaves the zone on both sides."""
    x, readings = rng.normal(size=model.n), []
    for k in range(steps):
        z = model.linear.C @ x
        y = sensor.deadzone(z, where.right, where.left)
        u = 8 * np.sin(0.3 * k + np.arange(model.m)) + rng.normal(size=model.m)
        readings.append((u, y, sensor.side(y)))
        x = model.linear.A @ x + model.linear.B @ u
    return readings


@settings(max_examples=30)
@given(seeds, st.integers(1, 3), st.integers(1, 2), st.booleans())
def test_adaptive_inverse_is_the_augmented_error_gradient(
    seed: int, n: int, p: int, gated: bool
) -> None:
    """Filtered signals without d^, then d+ = d + g zeta'eps / (1 + (1 + g) zeta'zeta).

    eps = eta - zeta d, x^ = xi + Phi d.
    """
    rng = np.random.default_rng(seed)
    Ts, gain = 0.1, 7.0
    model = sample_plant(random_plant(rng, n, 1, p), Ts)
    where = zone(p, right=0.3, left=0.2)
    L = fast_gain(model.linear, 5.0, Ts)
    readings = recorded(rng, model, where, 30)
    numbers = Numbers(
        AdaptiveInverse(
            L=L / Ts, gain=gain, silent="hold" if gated else "zero", widths0=0.1, width_max=0.5
        ).build(model, where),
        model,
    )
    d = np.full(2 * p, 0.1)
    for reading, (xi, eta, zeta) in zip(
        readings, zip(*literal_filters(model, L, gated, readings), strict=True), strict=True
    ):
        eps = eta - zeta @ d
        estimate = numbers(*reading)
        assert estimate.innovation == pytest.approx(eps, abs=1e-9)
        d = np.clip(
            d + gain * Ts * zeta.T @ (eps / (1 + (1 + gain * Ts) * (zeta**2).sum(axis=1))), 0, 0.5
        )
        assert numbers.part("W") == pytest.approx(d, abs=1e-9)
        assert numbers.part("x") - numbers.part("sensitivity") @ d == pytest.approx(
            _next(model, L, gated, xi, reading), abs=1e-9
        )


def _next(
    model: System, L: Floats, gated: bool, xi: Floats, reading: tuple[Floats, Floats, Floats]
) -> Floats:
    (A, B, C), (u, y, side) = model.linear, reading
    return np.asarray(
        A @ xi + B @ u + L @ (np.where(side == 0, 0.0, 1.0) * (y - C @ xi) if gated else y - C @ xi)
    )


@settings(max_examples=30)
@given(seeds, st.integers(1, 3), st.integers(1, 2))
def test_least_squares_is_the_batch_solution(seed: int, n: int, p: int) -> None:
    """min Ts sum |eta - zeta d|^2 + |d - d(0)|^2 / gain, without forgetting."""
    rng = np.random.default_rng(seed)
    Ts, gain = 0.1, 30.0
    model, where = sample_plant(random_plant(rng, n, 1, p), Ts), zone(p, right=0.3, left=0.2)
    L = fast_gain(model.linear, 5.0, Ts)
    readings = recorded(rng, model, where, 40)
    numbers = Numbers(
        AdaptiveInverse(
            L=L / Ts, law="least_squares", gain=gain, forgetting=0.0, widths0=50.0
        ).build(model, where),
        model,
    )
    for reading in readings:
        numbers(*reading)
    _, eta, zeta = literal_filters(model, L, True, readings)
    rows, goals = zeta.reshape(-1, 2 * p), eta.ravel()
    information = Ts * rows.T @ rows + np.eye(2 * p) / gain
    start = np.full(2 * p, 50.0)  # far from 0, where projection would act
    d = start + np.linalg.solve(information, Ts * rows.T @ (goals - rows @ start))
    assume(d.min() > 1)
    assert numbers.part("W") == pytest.approx(d, rel=1e-6)
    assert numbers.part("spread") == pytest.approx(np.linalg.inv(information), rel=1e-6, abs=1e-9)


def test_forgetting_leads_back_to_the_first_spread_and_not_beyond() -> None:
    model = sample_plant(PAPER_PLANT, 0.01)
    numbers = Numbers(
        AdaptiveInverse(law="least_squares", gain=40.0, forgetting=5.0).build(model, zone()), model
    )
    for k in range(800):
        numbers(0.0, 1.0 + np.sin(0.2 * k) if k < 300 else 1.0, 1.0)
        assert np.linalg.eigvalsh(numbers.part("spread")).min() > 0
        assert np.linalg.eigvalsh(numbers.part("spread")).max() < 40.0 * (1 + 1e-9)
    assert numbers.part("spread")[1, 1] == pytest.approx(40.0)


def test_one_jump_function_is_the_adaptive_inverse() -> None:
    common: dict[str, Any] = {"poles": [-5.0, -6.0], "gain": 9.0}
    for model in (PAPER_PLANT, sample_plant(PAPER_PLANT, 0.02)):
        inverse, network = (
            Numbers(o.build(model, zone()), model)
            for o in (AdaptiveInverse(**common), InverseNetwork(scale=1.0, functions=1, **common))
        )
        for one in (inverse, network):
            one.state = np.random.default_rng(1).uniform(0.5, 1, one.state.size)
        for y in (0.7, 0.0, -2.0):
            first, second = inverse(3.0, y, np.sign(y)), network(3.0, y, np.sign(y))
            for a, b in zip(first, second, strict=True):
                assert a == pytest.approx(b)
            assert inverse.state == pytest.approx(network.state)


def test_true_widths_that_do_not_move_are_the_oracle() -> None:
    tables: dict[str, Any] = tables_of("""
        sensor = { right = 1.3, left = 0.6, noise = 0.05 }
        simulation = { time = "sampled", step = 0.01, duration = 4.0 }
        """)
    inverse = simulate(
        scene(
            observer={
                "method": "adaptive_inverse",
                "L": [12.0, 15.0],
                "gain": 1e-12,
                "widths0": [1.3, 0.6],
            },
            **tables,
        )
    )
    oracle = simulate(scene(observer={"method": "oracle", "L": [12.0, 15.0]}, **tables))
    assert inverse.x_hat == pytest.approx(oracle.x_hat, abs=1e-9)


# --- Every rival


@pytest.mark.parametrize("name", RIVALS)
@pytest.mark.parametrize(
    "model",
    [PAPER_PLANT, sample_plant(PAPER_PLANT, 0.01), TWO, sample_plant(TWO, 0.01)],
    ids=["flow", "sampled", "two", "two sampled"],
)
def test_a_missing_sample_is_a_pure_prediction(name: str, model: System) -> None:
    where = zone(model.p)
    numbers = Numbers(RIVALS[name].build(model, where), model)
    rng = np.random.default_rng(0)
    numbers.state = np.abs(rng.normal(size=numbers.state.size))
    x = numbers.part("x")
    u = rng.normal(size=model.m)
    estimate = numbers(u, np.full(model.p, np.nan), np.zeros(model.p))
    assert numbers.part("x") == pytest.approx(model.linear.A @ x + model.linear.B @ u)
    assert estimate.z_inverse == pytest.approx(model.linear.C @ x)
    assert estimate.innovation == pytest.approx(0.0)


@pytest.mark.parametrize("name", RIVALS)
def test_estimates_do_not_depend_on_the_input_of_the_moment(name: str) -> None:
    for model in (PAPER_PLANT, sample_plant(PAPER_PLANT, 0.01)):
        one, other = (Numbers(RIVALS[name].build(model, zone()), model) for _ in range(2))
        one.state = other.state = np.linspace(0.1, 1, one.state.size)
        assert (
            np.concatenate(one(1.0, 0.5, 1.0)).tolist()
            == np.concatenate(other(-7.0, 0.5, 1.0)).tolist()
        )


@pytest.mark.parametrize("name", RIVALS)
def test_sampled_steps_tend_to_the_derivative(name: str) -> None:
    """(next - state) / Ts - derivative is of order Ts, for every state."""
    flow = Numbers(RIVALS[name].build(PAPER_PLANT, zone()), PAPER_PLANT)
    start = np.abs(np.random.default_rng(2).normal(size=flow.state.size))
    gaps = []
    for Ts in (1e-3, 1e-4):
        model = sample_plant(PAPER_PLANT, Ts)
        numbers = Numbers(RIVALS[name].build(model, zone()), model)
        flow.state, numbers.state = start, start
        flow(2.0, 0.8, 1.0)
        numbers(2.0, 0.8, 1.0)
        gaps.append(
            np.abs((numbers.state - start) / Ts - flow.state).max() / np.abs(flow.state).max()
        )
    assert gaps[1] < 0.2 * gaps[0] < 0.2


@pytest.mark.parametrize(
    "name", ["adaptive_inverse", "robust_gradient", "fuzzy_residual", "inverse_network"]
)
def test_a_continuous_run_is_integrated_well(name: str) -> None:
    run = simulate(
        scene(
            observer={"method": name}
            | ({"reach": 6.0} if "fuzzy" in name else {"scale": 1.0} if "network" in name else {})
        )
    )
    assert run.info.integration_error is not None
    assert run.info.integration_error < 1e-3


def test_one_of_them_as_generated_C(tmp_path: Path) -> None:
    observer = {"method": "inverse_network", "scale": 1.0}
    short = {"time": "sampled", "step": 0.01, "duration": 3.0}
    loop, state, exogenous = prepare(
        resolve_scenario(
            scene(
                observer=observer,
                controller={"method": "rbf_feedback", "reach": [6.0, 40.0]},
                simulation=short,
            )
        )
    )
    arguments = (state, exogenous, tree.pack_tree(loop.params))
    computed, expected = (
        interpret.run_interpreted(generated(loop.step, tmp_path), *arguments)[0],
        interpret.run_interpreted(loop.step, *arguments)[0],
    )
    assert np.isfinite(expected).all()
    np.testing.assert_allclose(computed, expected, rtol=1e-9, atol=1e-9)


# --- What they do on the paper's example (design/arena.md): sampled at 200 Hz, 20 s, d = 1


def arena(
    observer: dict[str, Any], controller: dict[str, Any] | None = None, **changes: Any
) -> Run:
    tables: dict[str, Any] = (
        tables_of("""
        plant.A = [[0.0, 1.0], [-1.0, -2.0]]
        plant.B = [[0.0], [1.0]]
        plant.C = [[1.0, 0.0]]
        plant.x0 = [1.0, 0.0]
        """)
        | changes
    )
    tables["simulation"] = {"time": "sampled", "step": 5e-3, "duration": 20.0} | changes.get(
        "simulation", {}
    )
    return simulate(
        scene(
            observer=observer,
            controller=controller or {"method": "state_feedback", "poles": [-10.0, -10.0]},
            **tables,
        )
    )


BLIND = {"method": "luenberger", "poles": [-20.0, -20.0]}
RESIDUALS: dict[str, dict[str, Any]] = {
    "fuzzy": {"method": "fuzzy_residual", "reach": 6.0},
    "rbf": {"method": "rbf_residual", "reach": 6.0},
    "taylor": {"method": "taylor_residual", "reach": 6.0},
    "network": {"method": "inverse_network", "scale": 1.0},
}


def test_what_takes_the_reading_for_the_output_settles_a_width_away() -> None:
    run = arena(BLIND)
    assert run.rms_estimation == pytest.approx(1.0, abs=0.1)
    assert run.rms_tracking == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("name", FEEDBACK)
def test_output_feedback_follows_with_the_wrong_output(name: str) -> None:
    """Blind, y follows r and z is d away.

    On a compensated reading, z follows. What it learns cannot help.
    """
    blind = arena(BLIND, {"method": name, "reach": [6.0, 40.0]})
    last, r = blind.last, blind.r[:, 0]
    outside = blind.side[last, 0] != 0
    assert np.sqrt(np.mean((blind.y[last, 0] - r[last])[outside] ** 2)) < 0.5
    assert blind.rms_tracking == pytest.approx(1.0, abs=0.15)
    seeing = arena({"method": "adaptive_inverse"}, {"method": name, "reach": [6.0, 40.0]})
    assert seeing.rms_tracking < 0.4 * blind.rms_tracking


def test_the_gated_inverse_is_right_where_the_literal_one_is_not() -> None:
    """Silence is not z = 0: taken for it, widths come out too small."""
    common = {"method": "adaptive_inverse", "poles": [-17.0, -17.0], "gain": 50.0, "width_max": 3.0}
    literal, gated = arena(common | {"silent": "zero"}), arena(common)
    assert gated.rms_tracking < 0.01 < 0.15 < literal.rms_tracking
    assert gated.widths == pytest.approx(np.ones((1, 2)), abs=0.01)
    assert literal.widths.max() < 0.95


@pytest.mark.parametrize("name", RESIDUALS)
def test_fast_poles_hide_the_residual(name: str) -> None:
    """As published it learns at slow poles and goes wrong at fast ones; filtered, it does not.

    As published, the error itself drives the weights.
    """
    published = RESIDUALS[name] | {"filtered": False, "gain": 12.0}
    slow, fast = (
        arena(published | {"poles": [-6.0, -6.0]}),
        arena(published | {"poles": [-20.0, -20.0]}),
    )
    assert slow.rms_estimation < 0.15
    assert slow.widths == pytest.approx(np.ones((1, 2)), abs=0.25)
    assert fast.rms_estimation > 0.7
    assert fast.widths.max() < 0.5
    assert arena(RESIDUALS[name]).rms_estimation < 0.15


def test_the_adaptive_inverse_is_near_the_oracle_where_only_the_width_is_unknown() -> None:
    bias = {"disturbance": {"kind": "step", "amplitude": 1.0}}
    wrong = tables_of("""
        model = { A = [[0.0, 1.0], [-0.9, -1.8]], B = [[0.0], [1.05]] }
        """)
    for changes in ({}, {"sensor": {"noise": 0.02}}, bias, wrong):
        oracle = arena({"method": "oracle", "L": [58.0, 840.0]}, **changes)
        assert (
            arena({"method": "adaptive_inverse"}, **changes).rms_tracking
            < 1.5 * oracle.rms_tracking + 0.02
        )
    asymmetric = arena({"method": "adaptive_inverse"}, sensor={"right": 1.4, "left": 0.5})
    assert asymmetric.widths.sum() == pytest.approx(1.9, abs=0.05)
    assert asymmetric.rms_tracking > 0.1  # the centre is learnt slowly: fast poles hide it


def test_a_robust_gradient_learns_from_guesses_of_zero() -> None:
    run = arena({"method": "robust_gradient", "width_max": 3.0})
    assert run.rms_tracking < 0.1
    assert run.widths == pytest.approx(np.ones((1, 2)), abs=0.1)


@pytest.mark.parametrize(
    "options",
    [
        {"method": "adaptive_inverse"},
        {"method": "inverse_network", "scale": 1.0},
        {"method": "rbf_residual", "reach": 3.0},
    ],
)
def test_two_outputs_and_third_order(options: dict[str, Any]) -> None:
    two: dict[str, Any] = tables_of("""
        sensor = { right = [0.5, 0.3], left = [0.4, 0.6] }
        reference = { kind = "sine", amplitude = [2.0, 2.5], frequency = 0.5, phase = [0.0, 1.0] }
        controller = { method = "state_feedback", poles = [-8.0, -9.0] }
        """) | {
        "plant": {
            "A": [[-1.0, 0.5], [-0.5, -2.0]],
            "B": np.eye(2).tolist(),
            "C": [[1.0, 0.0], [0.2, 1.0]],
            "x0": [0.5, -0.5],
        }
    }
    run = arena(options, **two)
    assert run.widths.sum(axis=1) == pytest.approx([0.9, 0.9], abs=0.12)
    third: dict[str, Any] = tables_of("""
        plant = { companion = [6.0, 11.0, 6.0], x0 = [0.5, 0.0, 0.0] }
        sensor = { right = 0.5, left = 0.5 }
        reference = { kind = "sine", amplitude = 2.0, frequency = 0.5 }
        controller = { method = "state_feedback", poles = [-8.0, -9.0, -10.0] }
        """)
    assert arena(options, **third).widths == pytest.approx(np.full((1, 2), 0.5), abs=0.1)


def test_a_nonlinear_plant_and_a_step_too_coarse_for_its_gain() -> None:
    pendulum: dict[str, Any] = tables_of("""
        plant.states = ["a", "v"]
        plant.f = ["v", "-9.81 * sin(a) - 1.5 * v + u"]
        plant.h = ["a"]
        plant.x0 = [0.3, 0.0]
        sensor = { right = 0.3, left = 0.3 }
        reference = { kind = "sine", amplitude = 1.2, frequency = 0.5 }
        controller = { method = "state_feedback", poles = [-6.0, -6.0] }
        simulation = { time = "sampled", substeps = 2 }
        """)
    run = arena({"method": "adaptive_inverse"}, **pendulum)
    assert run.rms_estimation < 0.03
    assert run.widths == pytest.approx(np.full((1, 2), 0.3), abs=0.03)
    with pytest.raises(
        StepError,
        match="is too coarse: the observer's adaptation has a mode at 939",
    ):
        arena({"method": "adaptive_inverse"}, **pendulum | {"simulation": {"time": "continuous"}})


# --- Output feedback


@settings(max_examples=20)
@given(seeds, st.integers(1, 4))
def test_relative_degree_counts_derivatives(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    a, r = rng.uniform(0.5, 2, n), int(rng.integers(1, n + 1))
    zeros = -rng.uniform(0.5, 2, n - r)
    A = np.eye(n, k=1)
    A[-1] = -a
    C = np.zeros((1, n))
    C[0, : n - r + 1] = np.poly(zeros)[::-1] if n > r else 1.0
    T = np.linalg.qr(rng.normal(size=(n, n)))[0]
    plant = Matrices(T @ A @ T.T, T @ np.eye(n)[:, -1:], C @ T.T)
    assert len(derivative_rows(plant)) == r + 1
    if n > r:
        C[0, : n - r + 1] = np.poly(-zeros)[::-1]
        with pytest.raises(StructureError, match=r"controller.method: the plant has zeros"):
            derivative_rows(plant._replace(C=C @ T.T))


@pytest.mark.parametrize("Ts", [None, 0.02])
def test_output_feedback_law_on_numbers(Ts: float | None) -> None:
    """b u = r'' - W'phi - L_2 e - c^2 E_1 - 2 c E_2, W' = gain phi (c E_1 + E_2) - leak W."""
    model = linear([[0.0, 1.0], [-3.0, -2.0]], [[0.0], [2.0]], [[1.0, 0.0]])
    model = model if Ts is None else sample_plant(model, Ts)
    reach, c, speed, gain, leak = np.array([2.0, 4.0]), 3.0, 10.0, 5.0, 0.1
    controller = TaylorFeedback(
        reach=reach, degree=2, speed=speed, bandwidth=c, gain=gain, leak=leak
    ).build(model)
    basis = build_monomials("key", reach, 2)
    x, W, z = np.array([0.7, -1.0]), np.linspace(-1, 1, 6), 0.4
    r, x_ref, u_ff = 0.5, np.array([0.5, 0.2]), 1.5
    p, params = tree.create_symbols(controller.params, "p")
    s, state = tree.create_symbols(controller.init(controller.params), "s")
    none = np.zeros(1)
    after, u = controller.step(
        params,
        state,
        Estimate(x, none, none, none, ca.SX(z), none),
        Target(np.array([r]), ca.SX(x_ref), ca.SX(u_ff)),
    )
    motion, force = (
        v.full().ravel()
        for v in ca.Function("law", [p, s], [tree.stack_leaves(after), u])(
            tree.pack_tree(controller.params), np.concatenate([x, W])
        )
    )
    e, E, phi = z - x[0], x - x_ref, values(basis, x)
    acceleration = (
        -3 * x_ref[0] - 2 * x_ref[1] + 2 * u_ff - speed**2 * e - c**2 * E[0] - 2 * c * E[1]
    )
    assert force == pytest.approx([(acceleration - W @ phi) / 2])
    learnt = gain * phi * (c * E[0] + E[1]) - leak * W
    if Ts is None:
        assert motion == pytest.approx(
            np.concatenate([[x[1] + 2 * speed * e, acceleration + speed**2 * e], learnt])
        )
    else:
        pole = np.exp(-speed * Ts)
        injected = np.array([2 * (1 - pole), (1 - pole) ** 2 / Ts]) * e
        assert motion == pytest.approx(
            np.concatenate(
                [
                    x[:1] + Ts * x[1] + Ts**2 / 2 * acceleration + injected[:1],
                    x[1:] + Ts * acceleration + injected[1:],
                    W + Ts * learnt,
                ]
            )
        )


@pytest.mark.parametrize("name", FEEDBACK)
def test_without_a_dead_zone_output_feedback_learns_an_unknown_plant(name: str) -> None:
    """The model knows b only; what is learnt lowers the tracking error."""
    changes: dict[str, Any] = tables_of("""
        sensor = { right = 0.0, left = 0.0 }
        reference = { kind = "sine", amplitude = 5.0, frequency = 0.3 }
        """)
    law = {"method": name, "reach": [6.0, 12.0]}
    learnt, ignorant = (arena(BLIND, law | gain, **changes) for gain in ({}, {"gain": 1e-9}))
    assert learnt.rms_tracking < 0.6 * ignorant.rms_tracking


def test_a_robust_term_needs_inputs_that_move_the_outputs() -> None:
    blocked = linear([[0.0, 1.0], [-1.0, -2.0]], [[0.0], [1.0]], [[0.0, 1.0]])
    with pytest.raises(
        StructureError, match=r"observer.rho: inputs cannot move every output in steady state"
    ):
        RobustGradient().build(blocked, zone())
    RobustGradient(rho=0.0).build(blocked, zone())


# --- Their parts


@pytest.mark.parametrize("order", [0, 1, 3])
def test_weights_of_the_error_put_all_poles_at_one_place(order: int) -> None:
    weights = error_weights(order, 4.0)
    assert weights.size == order
    s = np.array([1.0, 2.0])
    assert np.polynomial.Polynomial([*weights, 1.0])(s) == pytest.approx((s + 4.0) ** order)


def test_weights_of_the_adaptive_inverse_are_the_widths() -> None:
    observer = AdaptiveInverse(widths0=[[1.0, 0.4], [0.7, 0.2]]).build(TWO, zone(2))
    state = observer.init(observer.params)
    missing = Reading(ca.SX([np.nan, np.nan]), ca.SX.zeros(2))
    symbols = state._replace(x=ca.SX(state.x), W=ca.SX(state.W))
    _, estimate = observer.step(observer.params, symbols, ca.SX.zeros(TWO.m), missing)
    assert ca.DM(estimate.right).full()[:, 0].tolist() == [1.0, 0.7]
    assert ca.DM(estimate.left).full()[:, 0].tolist() == [0.4, 0.2]


def test_the_state_moves_with_weights_that_reach_their_bounds() -> None:
    """By the sensitivity times what each weight is moved."""
    setup: Any = SimpleNamespace(limited=True, compensator=SimpleNamespace(size=2))
    q: Any = SimpleNamespace(limit=ca.SX([3.0, 5.0]))
    sensitivity = np.arange(1.0, 9.0).reshape(2, 4)
    W = np.array([4.0, -1.0, 2.0, 7.0])  # two of each output; limits 3, 3, 5, 5
    state = learned_residual.LearnedState(
        ca.SX([10.0, 20.0]), ca.SX(W), ca.SX(sensitivity), ca.SX(0)
    )
    after = learned_residual.project_weights(setup, q, state)
    moved = np.array([-1.0, 1.0, 0.0, -2.0])
    np.testing.assert_allclose(ca.DM(after.W).full().ravel(), W + moved)
    expected = np.array([10.0, 20.0]) + sensitivity @ moved
    np.testing.assert_allclose(ca.DM(after.x).full().ravel(), expected)
