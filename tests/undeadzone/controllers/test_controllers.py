"""Controllers on numbers: which gain each choice gives, the laws written out, what is refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import solve_continuous_are, solve_continuous_lyapunov

from scenes import PAPER_PLANT, random_plant
from undeadzone.controllers import PD, Robust, StateFeedback
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Controller, Estimate
from undeadzone.plants.build import system
from undeadzone.plants.options import Plant
from undeadzone.plants.system import System, sample_plant
from undeadzone.util import tree
from undeadzone.util.arrays import Floats

TWO_INPUTS = random_plant(np.random.default_rng(3), 3, 2, 2)


def law(controller: Controller, model: System) -> Callable[..., tuple[Floats, Floats]]:
    """A controller's step on numbers.

    It is (state, x^, innovation, r, x_ref, u_ff) -> (next state or derivative, u).
    """
    p, params = tree.create_symbols(controller.params, "p")
    s, state = tree.create_symbols(controller.init(controller.params), "s")
    x, e, r, x_ref, u_ff = (
        ca.SX.sym("v", size) for size in (model.n, model.p, model.m, model.n, model.m)
    )
    none = ca.SX.zeros(model.p)
    after, u = controller.step(
        params, state, Estimate(x, none, none, none, none, e), Target(r, x_ref, u_ff)
    )
    function = ca.Function("law", [p, s, x, e, r, x_ref, u_ff], [tree.stack_leaves(after), u])
    numbers = tree.pack_tree(controller.params)

    def step(*values: Any) -> tuple[Floats, Floats]:
        after, u = function(numbers, *values)
        return after.full().ravel(), u.full().ravel()

    return step


def gain(options: StateFeedback, model: System) -> Floats:
    """K read off the law: u_ff - u for unit errors."""
    step = law(options.build(model), model)
    zero_u, zero_y = np.zeros(model.m), np.zeros(model.p)
    return np.stack(
        [
            -step([], column, zero_y, zero_u, np.zeros(model.n), zero_u)[1]
            for column in np.eye(model.n)
        ],
        axis=1,
    )


@pytest.mark.parametrize(
    "model",
    [PAPER_PLANT, TWO_INPUTS, sample_plant(PAPER_PLANT, 0.05), sample_plant(TWO_INPUTS, 0.05)],
)
def test_poles_are_placed_in_either_time(model: System) -> None:
    poles = -np.arange(3.0, 3.0 + model.n)
    K = gain(StateFeedback(poles=poles), model)
    expected = poles if model.Ts is None else np.exp(poles * model.Ts)
    assert np.sort(np.linalg.eigvals(model.linear.A - model.linear.B @ K).real) == pytest.approx(
        np.sort(expected), rel=1e-5
    )


def test_alpha_gives_the_papers_riccati_gain_with_A() -> None:
    A, B, _ = TWO_INPUTS.linear
    P = solve_continuous_are(A, B, 2.0 * np.eye(3), np.eye(2) / 14.0)
    np.testing.assert_allclose(
        gain(StateFeedback(alpha=7.0, Q=2.0), TWO_INPUTS), 7.0 * B.T @ P, rtol=1e-9
    )


def test_law_is_feedforward_less_feedback_on_the_error() -> None:
    K = np.array([[1.0, 2.0, 3.0], [0.0, -1.0, 0.5]])
    x, x_ref, u_ff = np.array([1.0, -2.0, 0.3]), np.array([0.5, 0.5, 0.5]), np.array([4.0, -1.0])
    _, u = law(StateFeedback(K=K).build(TWO_INPUTS), TWO_INPUTS)(
        [], x, np.zeros(2), np.zeros(2), x_ref, u_ff
    )
    assert u == pytest.approx(u_ff - K @ (x - x_ref))


def test_one_row_of_gains_may_be_a_plain_list() -> None:
    assert gain(StateFeedback(K=[3.0, 4.0]), PAPER_PLANT).tolist() == [[3, 4]]


def test_robust_term_is_bounded_smooth_and_zero_on_the_target() -> None:
    """-rho tanh(B'P (x^ - x_ref) / width), P of (A - BK)'P + P(A - BK) = -Q."""
    A, B, _ = PAPER_PLANT.linear
    K, rho, width = np.array([[3.0, 4.0]]), 2.0, 0.5
    P = solve_continuous_lyapunov((A - B @ K).T, -np.eye(2))
    step = law(
        StateFeedback(K=K, robust=Robust(gain=rho, width=width)).build(PAPER_PLANT), PAPER_PLANT
    )
    for x in (np.zeros(2), np.array([0.1, -0.2]), np.array([50.0, 50.0])):
        u = step([], x, 0, 0, np.zeros(2), 1.0)[1]
        assert u == pytest.approx(1.0 - K @ x - rho * np.tanh(B.T @ P @ x / width))
        assert abs(u - 1.0 + K @ x) <= rho + 1e-12


@pytest.mark.parametrize("Ts", [None, 0.02])
def test_pd_is_42_with_a_filtered_derivative(Ts: float | None) -> None:
    model = PAPER_PLANT if Ts is None else sample_plant(PAPER_PLANT, Ts)
    tau, e, filtered, r = 0.1, 2.0, 0.5, 3.0
    after, u = law(PD(k_p=4.0, k_d=0.7, filter_time=tau).build(model), model)(
        filtered, np.zeros(2), e, r, np.zeros(2), 0.0
    )
    derivative = (e - filtered) / tau
    assert u == pytest.approx([-4.0 * e - 0.7 * derivative + r])
    exact = derivative if Ts is None else e + (filtered - e) * np.exp(-Ts / tau)
    assert after == pytest.approx([exact])


def test_pd_gains_from_34_are_alpha_BP_with_A_less_LC() -> None:
    A, B, C = PAPER_PLANT.linear
    P = solve_continuous_are(A - np.array([[12.0], [15.0]]) @ C, B, np.eye(2), np.eye(1) / 20.0)
    params = PD(alpha=10.0, L=[12.0, 15.0]).build(PAPER_PLANT).params
    assert [*params.k_p, *params.k_d] == pytest.approx((10.0 * B.T @ P).ravel())


@pytest.mark.parametrize("Ts", [None, 0.01])
@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_without_a_choice_the_loop_is_faster_than_the_plant(unit: float, Ts: float | None) -> None:
    """Poles of A - B K lie left of half the speed, five mean poles, in any unit of time."""
    plant = system(Plant(A=[[0.0, unit], [-unit, -0.2 * unit]], B=[[0.0], [unit]], C=[[1.0, 0.0]]))
    model = plant if Ts is None else sample_plant(plant, Ts / unit)
    K = StateFeedback().build(model).K
    poles = np.linalg.eigvals(model.linear.A - model.linear.B @ K)
    rates = poles.real if Ts is None else np.log(np.abs(poles)) / Ts * unit
    assert rates.max() < -2.5 * unit * (1 - 1e-6)
    assert rates.min() > -10 * unit
