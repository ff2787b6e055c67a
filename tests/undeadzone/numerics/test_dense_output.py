"""Taylor arcs and steps with several changes of side: accuracy, order, coincidence with RK4."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

from scenes import scene, slopes, tables_of
from undeadzone.numerics.dense_output import (
    DenseStep,
    Levels,
    _find_crossing,
    _find_slope_zero,
    _shift_inputs,
    build_rk4_arcs,
    build_taylor_arcs,
)
from undeadzone.results.run import Run
from undeadzone.simulation.simulate import simulate

TWO = tables_of("""
plant.A = [[0.0, 1.0, 0.0], [-2.0, -1.5, 0.3], [0.1, 0.0, -3.0]]
plant.B = [[0.0, 0.0], [1.0, 0.0], [0.0, 2.0]]
plant.C = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
sensor = { right = [0.6, 0.4], left = [0.5, 0.7] }
reference = { kind = "sine", amplitude = [2.0, 1.5], frequency = 0.5 }
# Gains as slow as the plant: the short RK4 steps are the truth.
observer = { method = "certified", gamma = 4.0, L = [[1.0, 0.0], [1.5, 0.0], [0.0, 1.0]] }
controller = { method = "state_feedback", alpha = 5.0 }
""")
GRAZING = tables_of("""
reference = { kind = "sine", amplitude = 1.002, frequency = 1.0 }
plant = { A = [[0, 1], [-1, -2]], B = [[0], [1]], C = [[1, 0]] }
""")


def run(order: int, step: float, duration: float = 3.0, **changes: Any) -> Run:
    simulation = {"duration": duration, "step": step, "order": order}
    return simulate(scene(**changes | {"simulation": simulation}), check_step=False)


def gap(run: Run, truth: Run) -> float:
    """The largest difference of x, x^ and d^ at the instants that both have."""
    every = round((len(truth.t) - 1) / (len(run.t) - 1))
    gaps = []
    for name in ("x", "x_hat", "d_hat"):
        difference = getattr(run, name) - getattr(truth, name)[::every]
        gaps.append(float(np.abs(difference).max()))
    return max(gaps)


def numbers(expression: Any) -> list[float]:
    return np.array(ca.DM(expression)).ravel().tolist()


def falling(x: ca.SX, c: Any, mode: Any) -> ca.SX:
    """x' = -x, whose solution is e^-t."""
    return -x


@pytest.mark.parametrize(
    "arc",
    [
        build_rk4_arcs(falling, lambda x: 2 * x, 1, ca.SX(0.1)),
        build_taylor_arcs(falling, lambda x: 2 * x, [ca.SX(0.0)] * 5, 1, ca.SX(0.1)),
    ],
    ids=["runge_kutta", "taylor"],
)
def test_dense_output_follows_the_solution(arc: Any) -> None:
    """Over the last three quarters of a step of 0.1 s, z = 2 x."""
    step: DenseStep = arc(ca.SX(1.0), ca.SX(0.25), None)
    assert numbers(step.end) == pytest.approx([np.exp(-0.075)], abs=1e-6)
    assert numbers(step.final) == pytest.approx([2 * np.exp(-0.075)], abs=1e-6)
    assert numbers(step.onward) == pytest.approx([2 * (1 - 0.075 / 2)])
    for c in (0.0, 0.3, 1.0):
        assert numbers(step.at(c)) == pytest.approx([np.exp(-0.075 * c)], abs=1e-6)
        assert numbers(step.output(c)) == pytest.approx([2 * np.exp(-0.075 * c)], abs=1e-6)
        assert numbers(step.slope(c)) == pytest.approx([-0.15 * np.exp(-0.075 * c)], abs=1e-5)


def test_inputs_over_the_rest_of_a_step_are_the_same_polynomial() -> None:
    """1 + 2 c + 3 c^2 after c = 0.4, as a polynomial of the fraction of what is left."""
    moved = np.array(
        [numbers(a)[0] for a in _shift_inputs([ca.SX(1), ca.SX(2), ca.SX(3)], 0.4, 0.6)]
    )
    for c in (0.0, 0.5, 1.0):
        total = 0.4 + 0.6 * c
        assert moved @ c ** np.arange(3) == pytest.approx(1 + 2 * total + 3 * total**2)


@pytest.mark.parametrize(
    ("side", "z", "expected"),
    [
        (0, 0.5, (0, None, None, None)),
        (0, 1.5, (1, 1, 1.0, 1)),
        (0, -2.5, (1, -1, -2.0, 0)),
        (1, 0.5, (1, 0, 1.0, 0)),
        (-1, 0.5, (1, 0, -2.0, 1)),
        (1, -2.5, (1, 0, 1.0, 0)),
        (1, 4.5, (1, 2, 4.0, 1)),
        (0, 4.5, (1, 1, 1.0, 1)),
        (2, 4.5, (0, None, None, None)),
        (2, 3.0, (1, 1, 4.0, 0)),
        (-1, -9.0, (1, -2, -5.0, 0)),
        (-2, 3.0, (1, -1, -5.0, 1)),
    ],
)
def test_the_change_of_side_is_the_first_one_on_the_way(
    side: int, z: float, expected: tuple[float | None, ...]
) -> None:
    """Right above 1, left below -2, limits at 4 and -5: changed, side entered, level, rising."""
    levels = Levels((ca.SX(1.0), ca.SX(4.0)), (ca.SX(-2.0), ca.SX(-5.0)))
    crossing = _find_crossing(ca.SX(z), levels, ca.SX(side))
    for value, truth in zip(crossing, expected, strict=True):
        assert truth is None or numbers(value) == [truth]


def test_where_a_slope_vanishes() -> None:
    root = _find_slope_zero(lambda c: ca.SX(1.0) - 4 * c**2, ca.SX(1.0), ca.SX(-3.0))
    assert numbers(root) == pytest.approx([0.5], abs=0.01)


@pytest.mark.parametrize("changes", [{}, TWO, GRAZING], ids=["paper", "two outputs", "grazing"])
def test_long_taylor_steps_equal_short_runge_kutta_steps(changes: dict[str, Any]) -> None:
    truth = run(4, 2.5e-4, **changes)
    assert np.ptp(truth.side) > 0
    assert gap(run(12, 1e-2, **changes), truth) < 5e-11
    assert gap(run(4, 1e-2, **changes), truth) > 1e-8


def test_the_order_is_the_requested_one() -> None:
    truth = run(16, 1e-2)
    steps = (0.06, 0.03)
    for order in (5, 6, 7):
        errors = [gap(run(order, step), truth) for step in steps]
        assert slopes(steps, errors)[0] == pytest.approx(order, abs=0.8)


def test_order_4_of_the_series_would_be_runge_kutta_for_a_constant_input() -> None:
    """On a linear branch, with nothing from outside, RK4 is the Taylor polynomial of order 4.

    One term more is more accurate.
    """
    still = {"reference": {"kind": "step", "amplitude": 0.0}}
    truth = run(12, 1e-2, **still)
    assert gap(run(5, 1e-1, **still), truth) < gap(run(4, 1e-1, **still), truth) / 3


@pytest.mark.parametrize(
    "disturbance",
    [
        {"kind": "sine", "amplitude": 0.5, "frequency": 0.7},
        {"kind": "random", "rms": 0.3, "correlation_time": 0.2},
    ],
    ids=str,
)
def test_disturbances_enter_the_series(disturbance: dict[str, Any]) -> None:
    """A random one is a line over each step of its own grid, so that both must have the same."""
    truth = run(4, 1e-2, disturbance=disturbance)
    series = run(8, 1e-2, disturbance=disturbance)
    assert gap(series, truth) < 2e-6
    simulation = {"duration": 3.0, "step": 1e-2, "order": 8}
    finer = simulate(scene(disturbance=disturbance, simulation=simulation))
    assert finer.info.integration_error is not None
    assert finer.info.integration_error < 1e-9


def test_an_excursion_within_a_step_is_seen() -> None:
    """z passes the edge by 0.001 at its largest, and is back before a long step ends."""
    silent = run(12, 1e-3, **GRAZING, sensor={"right": 3.0, "left": 3.0})
    sensor = {"right": float(silent.z.max()) - 1e-3, "left": 3.0}
    truth = run(4, 2.5e-4, **GRAZING, sensor=sensor)
    coarse = run(12, 5e-2, **GRAZING, sensor=sensor)
    assert 0.0 < (truth.side == 1).mean() < 0.05
    assert not (coarse.side == 1).any()
    assert float(np.abs(truth.d_hat[-1] - truth.d_hat[0]).max()) > 1e-4
    assert gap(coarse, truth) < 1e-9


@pytest.mark.parametrize(("edge", "after"), [(0.0, -1.0), (0.1, 0.0)])
def test_a_zone_of_no_width_is_crossed_at_once(edge: float, after: float) -> None:
    levels = Levels((ca.SX(edge),), (ca.SX(-edge),))
    crossing = _find_crossing(ca.SX(-1.0), levels, ca.SX(1.0))
    assert float(crossing[1]) == after
    assert bool(ca.DM(crossing[0]))
