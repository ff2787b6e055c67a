"""The barrier: the law of Tee, Ge and Tay, V that falls, a bound that is kept."""

from __future__ import annotations

from typing import Any

import casadi as ca
import msgspec
import numpy as np
import pytest

from undeadzone.errors import InputError, StepError
from undeadzone.observers.full_state import FullState
from undeadzone.plants.build import system
from undeadzone.plants.options import Plant
from undeadzone.results.run import Run
from undeadzone.scenario.schema import Simulation
from undeadzone.signals.exosystem import Sine
from undeadzone.simulation.simulate import simulate
from undeadzone_arena.controllers.barrier import Barrier, BarrierParams, barrier_backstepping
from undeadzone_paper.example import example_as_repaired

BOUND = 0.6


def _params(r: int, bound: float = BOUND, rate: float = 3.0) -> BarrierParams:
    return BarrierParams(
        np.eye(r), np.zeros(r), np.float64(1.0), np.float64(bound), np.float64(rate)
    )


def _evaluate(p: BarrierParams, z: Any, reference: Any) -> float:
    law = barrier_backstepping(p, ca.SX(ca.DM(z)), ca.SX(ca.DM(reference)))
    return float(ca.Function("f", [], [law])()["o0"])


def test_of_second_order_it_is_the_law_of_the_literature() -> None:
    p, (z1, z2), (r0, r1, r2) = _params(2), (0.7, -1.2), (0.3, 0.4, -2.0)
    e1 = z1 - r0
    e2 = z2 - (r1 - 3.0 * e1)
    by_hand = r2 - 3.0 * (z2 - r1) - 3.0 * e2 - e1 / (BOUND**2 - e1**2)
    assert _evaluate(p, [z1, z2], [r0, r1, r2]) == pytest.approx(by_hand)


@pytest.mark.parametrize("r", [1, 2, 3, 4])
def test_V_falls_at_its_rate(r: int) -> None:
    """Along a chain of r integrators V' = -rate (e_1^2 / room + e_2^2 + ...), by differences."""
    p, rng = _params(r), np.random.default_rng(r)
    for _ in range(3):
        reference = rng.normal(size=r + 1)
        z = reference[:r] + np.append(rng.uniform(-0.9, 0.9) * BOUND, rng.normal(size=r - 1))
        control = _evaluate(p, z, reference)
        h = 1e-6
        after = z + h * np.append(z[1:], control)
        reference_after = reference + h * np.append(reference[1:], 0.0)
        errors = _errors(p, z, reference)
        V_moved = (_V(_errors(p, after, reference_after)) - _V(errors)) / h
        room = BOUND**2 - errors[0] ** 2
        falling = -3.0 * (errors[0] ** 2 / room + (errors[1:] ** 2).sum())
        assert V_moved == pytest.approx(falling, rel=1e-3, abs=1e-3)


def _errors(p: BarrierParams, z: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """e_1, ..., e_r: each next one is a derivative less what the law of lower order wants."""
    errors = [z[0] - reference[0]]
    errors += [z[i] - _evaluate(_params(i), z[:i], reference[: i + 1]) for i in range(1, z.size)]
    return np.array(errors)


def _V(errors: np.ndarray) -> float:
    room = BOUND**2 - errors[0] ** 2
    return float(np.log(BOUND**2 / room) / 2 + (errors[1:] ** 2).sum() / 2)


def _disturbed_run(bound: float, **changes: Any) -> Run:
    scenario = msgspec.structs.replace(
        example_as_repaired(5.0),
        observer=FullState(),
        controller=Barrier(bound=bound, rate=5.0),
        disturbance=Sine(amplitude=30.0, frequency=0.7),
        **changes,
    )
    return simulate(scenario, check_step=False)


@pytest.mark.parametrize(
    "simulation", [Simulation(duration=8.0), Simulation(duration=8.0, time="sampled", step=5e-3)]
)
def test_the_bound_is_satisfied_where_the_law_without_barrier_violates_it(
    simulation: Simulation,
) -> None:
    bounded = _disturbed_run(BOUND, simulation=simulation)
    left = _disturbed_run(1e6, simulation=simulation)
    late = bounded.t > 2.0
    assert np.abs(bounded.z - bounded.r)[late].max() < BOUND
    assert np.abs(left.z - left.r)[late].max() > BOUND


def test_what_cannot_be_is_refused() -> None:
    plant = system(example_as_repaired(5.0).plant)
    with pytest.raises(InputError, match=r"controller\.bound"):
        Barrier(bound=0.0).build(plant)
    two = Plant(A=np.diag([-1.0, -2.0]).tolist(), B=np.eye(2).tolist(), C=np.eye(2).tolist())
    with pytest.raises(InputError, match="one input and one output, found 2 and 2"):
        Barrier(bound=1.0).build(system(two))
    with pytest.raises(StepError, match=r"too coarse for controller\.rate"):
        _disturbed_run(BOUND, simulation=Simulation(time="sampled", step=0.05))
