"""What observers and controllers say of themselves is what their graphs do."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import undeadzone as uz
from scenes import PAPER_PLANT
from undeadzone.interfaces import COLUMNS, Estimate, Observer, Reading
from undeadzone.nonlinearities.sensor import Zone, resolve
from undeadzone.plants.system import System, sample_plant
from undeadzone.util import tree

CONTINUOUS = PAPER_PLANT
SAMPLED = sample_plant(PAPER_PLANT, 0.01)


def zone(model: System) -> Zone:
    return resolve(uz.Sensor(right=1.0, left=0.7, slope=2.0), model.p, model.Ts)


def slopes(observer: Observer, model: System) -> tuple[np.ndarray, np.ndarray]:
    """Change of x^' (or x^+) and of d_r^' by a reading on the right, by differentiation."""
    state = observer.init(observer.params)
    column, symbols = tree.create_symbols(state, "s")
    y = ca.SX.sym("y", model.p)
    after, _ = observer.step(observer.params, symbols, np.zeros(model.m), Reading(y, np.ones(1)))
    width = getattr(after, "right", ca.SX.zeros(model.p))
    change = ca.Function("change", [column, y], [ca.jacobian(after.x, y), ca.jacobian(width, y)])
    inside = np.full(column.shape[0], 0.3)
    return tuple(np.array(part) for part in change(inside, 5.0))


@pytest.mark.parametrize("model", [CONTINUOUS, SAMPLED], ids=["continuous", "sampled"])
@pytest.mark.parametrize(
    "options",
    [
        uz.Certified(L=[-0.87, 0.76], gamma=7.7),
        uz.Oracle(L=[-0.87, 0.76]),
        uz.Luenberger(L=[-0.87, 0.76]),
        uz.HighGain(epsilon=0.1, gamma=3.0),
    ],
    ids=lambda options: type(options).__name__,
)
def test_gains_are_those_of_the_graph(options: uz.Certified, model: System) -> None:
    observer = options.build(model, zone(model))
    by_reading, width_by_reading = slopes(observer, model)
    traits, slope = observer.traits, 2.0
    assert traits.L is not None
    np.testing.assert_allclose(by_reading * slope, traits.L, rtol=1e-12)
    gamma = np.zeros(1) if traits.gamma is None else traits.gamma
    np.testing.assert_allclose(width_by_reading[:, 0] * slope, -gamma, rtol=1e-12)


@pytest.mark.parametrize(
    ("options", "constant"),
    [
        (uz.Certified(), True),
        (uz.Oracle(), True),
        (uz.Certified(adaptation=uz.Sigma(leak=0.1)), False),
        (uz.Certified(adaptation=uz.LeastSquares()), False),
        (uz.HighGain(), False),
        (uz.Luenberger(poles=[-3.0, -4.0]), False),
    ],
)
def test_only_the_gradient_law_is_constant(options: uz.Certified, constant: bool) -> None:
    assert options.build(CONTINUOUS, zone(CONTINUOUS)).traits.constant is constant


@pytest.mark.parametrize(
    ("options", "adapts"),
    [
        (uz.Luenberger(poles=[-3.0, -4.0]), False),
        (uz.Oracle(), False),
        (uz.FullState(), False),
        (uz.Certified(gamma=0.0), False),
        (uz.Certified(gamma=1.0), True),
        (uz.AdaptiveInverse(), True),
    ],
)
def test_who_adapts_says_so(options: uz.Certified, adapts: bool) -> None:
    assert options.build(CONTINUOUS, zone(CONTINUOUS)).traits.adapts is adapts


def test_a_bound_of_the_widths_is_a_trait() -> None:
    bounded = uz.Certified(width_max=3.0).build(CONTINUOUS, zone(CONTINUOUS))
    np.testing.assert_array_equal(bounded.traits.width_max, [3.0])


def test_columns_name_every_field_once() -> None:
    assert len(set(COLUMNS)) == len(Estimate._fields)
    assert not {"x", "z", "y", "u", "t", "side"} & set(COLUMNS)


@pytest.mark.parametrize("model", [CONTINUOUS, SAMPLED], ids=["continuous", "sampled"])
def test_state_feedback_says_its_gain(model: System) -> None:
    controller = uz.StateFeedback(poles=[-8.0, -10.0]).build(model)
    assert controller.K is not None
    poles = np.linalg.eigvals(model.linear.A - model.linear.B @ controller.K)
    expected = [-10.0, -8.0] if model.Ts is None else np.exp(np.array([-10.0, -8.0]) * model.Ts)
    np.testing.assert_allclose(sorted(poles.real), expected, rtol=1e-9)


def test_a_filter_says_its_rate() -> None:
    controller = uz.PD(k_p=1.0, k_d=1.0, filter_time=0.05).build(CONTINUOUS)
    assert controller.rate == pytest.approx(20.0)
