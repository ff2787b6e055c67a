"""Runs: what must hold of any simulation, V along them, disturbances and noise.

What goes wrong in a run is reported.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import msgspec
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from scenes import PAPER_PLANT, scene, tables_of
from undeadzone.errors import InputError
from undeadzone.observers import Certified, Luenberger
from undeadzone.results.run import Run
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.simulation import exogenous
from undeadzone.simulation.simulate import compare, labels, simulate

IDLE: dict[str, Any] = {"method": "state_feedback", "K": [0.0, 0.0]}
NO_REFERENCE: dict[str, Any] = {"kind": "step", "amplitude": 0.0}
CERTIFIED: dict[str, Any] = {
    "method": "certified",
    "L": [1.0, 1.5],
    "gamma": 10.0,
    "widths0": [0.2, 0.2],
    "width_max": 3.0,
}


def test_the_repaired_example_tracks_and_finds_its_widths() -> None:
    """20 s of the paper's example: rms below 1e-3, d^ within 1e-3.

    V never rises beyond the integration error.
    """
    run = simulate(scene(simulation={"duration": 20.0}))
    assert run.rms_tracking < 1e-3
    assert run.rms_estimation < 1e-3
    assert run.widths == pytest.approx(np.array([[1.0, 1.0]]), abs=1e-3)
    assert run.info.certified
    assert run.info.integration_error is not None
    assert run.info.integration_error < 1e-8
    assert run.largest_rise_of_V is not None
    assert run.largest_rise_of_V <= run.info.integration_error
    assert run.V is not None
    assert run.V[-1] < 1e-6 * run.V[0]
    assert run.silent_fraction == pytest.approx(0.15, abs=0.02)
    assert run.fully_identifiable


@pytest.mark.parametrize("silence", [False, True])
def test_V_never_rises_exactly_in_sampled_time(silence: bool) -> None:
    run = simulate(
        scene(
            """
            sensor = { right = 1.3, left = 0.6 }
            simulation = { time = "sampled", step = 0.01, duration = 10.0 }
            """,
            observer=CERTIFIED | {"silence": silence},
        )
    )
    assert run.info.certified
    assert run.V is not None
    assert np.diff(run.V).max() <= 1e-13 * run.V[0]
    assert run.widths == pytest.approx(np.array([[1.3, 0.6]]), abs=0.05)


def test_without_input_the_plant_follows_its_exponential() -> None:
    run = simulate(scene(controller=IDLE, reference=NO_REFERENCE))
    expected = np.array([expm(PAPER_PLANT.linear.A * t) @ [0.5, 0.0] for t in run.t])
    assert run.x == pytest.approx(expected, abs=1e-12)
    assert (run.u == 0).all()
    assert (run.y == 0).all()
    assert run.silent_fraction == 1.0
    assert (run.d_hat == 0.2).all()


def test_records_agree_with_each_other() -> None:
    run = simulate(scene(sensor={"right": 1.3, "left": 0.6, "slope": 2.0}))
    z = run.x[:, :1]
    assert run.z == pytest.approx(z)
    assert run.y == pytest.approx(2 * (z - np.clip(z, -0.6, 1.3)))
    assert run.side.ravel().tolist() == np.sign(run.y).ravel().tolist()
    assert run.z_hat == pytest.approx(run.x_hat[:, :1])
    right, left = run.d_hat.T
    inverse = (
        run.y[:, 0] / 2
        + np.where(run.side[:, 0] > 0, right, 0)
        - np.where(run.side[:, 0] < 0, left, 0)
    )
    assert run.z_inverse[:, 0] == pytest.approx(inverse)
    assert run.r[:, 0] == pytest.approx(5 * np.sin(2 * np.pi * run.t))
    assert run.t == pytest.approx(np.arange(2001) * 1e-3)
    assert (run.innovation[run.side == 0] == 0).all()


def test_disturbance_enters_at_the_input() -> None:
    """Against SciPy, with nothing else acting."""
    disturbance = tables_of("""
        kind = "sines"
        components = [
            { amplitude = 2.0, frequency = 0.7 },
            { amplitude = 1.0, frequency = 3.0, phase = 0.4 },
        ]
        offset = 0.3
        """)
    run = simulate(scene(controller=IDLE, reference=NO_REFERENCE, disturbance=disturbance))
    A, B, _ = PAPER_PLANT.linear

    def rate(t: float, x: Any) -> Any:
        return A @ x + B[:, 0] * (
            2 * np.sin(2 * np.pi * 0.7 * t) + np.sin(2 * np.pi * 3 * t + 0.4) + 0.3
        )

    expected = solve_ivp(
        rate, (0, 2), [0.5, 0.0], "DOP853", t_eval=run.t, rtol=1e-12, atol=1e-12
    ).y.T
    assert run.x == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("time", ["continuous", "sampled"])
def test_random_disturbance_has_its_rms_and_seed(time: str) -> None:
    """x = w filtered: B = C = 1 with a fast pole reads the disturbance itself."""
    tables: dict[str, Any] = tables_of("""
        plant = { A = [[-100.0]], B = [[100.0]], C = [[1.0]] }
        observer = { method = "luenberger", L = [0.0] }
        disturbance = { kind = "random", rms = 2.0, correlation_time = 0.2 }
        """) | {"reference": NO_REFERENCE, "controller": IDLE | {"K": [0.0]}}

    def run(seed: int) -> Run:
        return simulate(
            scene(
                **tables, simulation={"duration": 100.0, "step": 0.01, "time": time, "seed": seed}
            ),
            check_step=False,
        )

    first, again, other = run(1), run(1), run(2)
    assert first.x.std() == pytest.approx(2.0, rel=0.15)
    assert (first.x == again.x).all()
    assert np.abs(np.corrcoef(first.x[:, 0], other.x[:, 0])[0, 1]) < 0.2


def test_noise_before_the_zone_moves_the_reading_only_outside() -> None:
    run = simulate(
        scene("""
            sensor = { noise_before = 0.1 }
            simulation = { time = "sampled", step = 0.01, duration = 10.0 }
            """)
    )
    outside = np.abs(run.z) > 1.5
    noise = run.y - (run.z - np.clip(run.z, -1, 1))
    assert noise[outside].std() == pytest.approx(0.1, abs=0.02)
    assert (noise[np.abs(run.z) < 0.5] == 0).all()


def test_integration_error_is_computed_on_request() -> None:
    assert simulate(scene(), check_step=False).info.integration_error is None
    assert (
        simulate(scene(simulation={"time": "sampled", "step": 0.01})).info.integration_error is None
    )


def test_progress_counts_every_step() -> None:
    counts: list[int] = []
    simulate(scene(simulation={"duration": 1.3, "step": 1e-3}), progress=counts.append)
    assert sum(counts) == 1301 + 2601


def test_corners_of_a_reference_on_the_grid_are_felt_in_the_step_that_follows() -> None:
    """A step at 1 s: the plant's input jumps, and the error stays that of a smooth run."""
    run = simulate(scene(reference={"kind": "step", "amplitude": 3.0, "time": 1.0}))
    assert run.r[999:1001, 0].tolist() == [0, 3]
    assert run.info.integration_error is not None
    assert run.info.integration_error < 1e-9


def test_a_run_that_half_the_step_changes_is_no_result() -> None:
    coarse = scene(simulation={"duration": 6.0, "step": 0.2})
    run = simulate(coarse)
    assert run.info.integration_share is not None
    assert run.info.integration_share > 0.01
    assert run.inexact
    assert run.summary()["inexact"]
    assert not simulate(scene(simulation={"duration": 6.0, "step": 0.02})).inexact
    assert not simulate(coarse, check_step=False).inexact  # nobody asked


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_no_choice_of_units_makes_a_run_diverge(unit: float) -> None:
    """The same plant with its time in other units: z'' is 1e18 times as large, nothing diverges."""
    plant = {"companion": [unit**-3, 3 * unit**-2, 3 / unit], "x0": [0.5, 0.0, 0.0]}
    run = simulate(
        scene(
            plant=plant,
            reference={"kind": "sine", "amplitude": 5.0, "frequency": 0.1 / unit},
            controller={"method": "state_feedback", "poles": [-2 / unit, -2.2 / unit, -2.5 / unit]},
            observer={"method": "certified", "L": [0.5 / unit, 0.0, 0.0], "gamma": 1 / unit},
            simulation={"duration": 10 * unit, "step": 0.01 * unit},
        )
    )
    assert run.divergence_time is None
    lost = dataclasses.replace(run, z=run.z * 1e14)
    assert lost.divergence_time is not None


def test_a_run_that_diverges_says_when() -> None:
    run = simulate(
        scene("""
            controller = { method = "state_feedback", K = [-200.0, -30.0] }
            simulation = { duration = 10.0 }
            """)
    )
    assert run.divergence_time is not None
    assert 0.5 < run.divergence_time < 5
    sizes = np.abs(run.x[run.t < run.divergence_time - 1e-9]) / run.info.scales[: run.x.shape[1]]
    assert sizes.max() <= 1e12
    summary = run.summary()
    assert summary["diverged_at"] == run.divergence_time
    assert summary["rms_tracking"] is None or np.isfinite(summary["rms_tracking"])


def test_an_edge_never_reached_is_reported() -> None:
    run = simulate(
        scene("""
            reference = { kind = "sine", amplitude = 1.0, frequency = 1.0, offset = 4.0 }
            sensor = { left = 2.9 }
            simulation = { duration = 3.0 }
            """)
    )
    (verdict,) = run.info.identifiable
    assert not run.fully_identifiable
    assert (verdict["right"], verdict["left"]) == (True, False)
    assert "never reached" in " ".join(verdict["reasons"])


def test_chain_of_integrators_is_answered_with_the_centre() -> None:
    """Class (15) for n = 2: the width is found, the centre is not, and the run says why."""
    run = simulate(
        scene("""
            plant = { integrators = 2, x0 = [0.5, 0.0] }
            observer = { method = "certified", L = [3.0, 2.0], gamma = 1.0 }
            simulation = { duration = 3.0 }
            """)
    )
    (verdict,) = run.info.identifiable
    assert (verdict["width"], verdict["centre"]) == (True, False)
    assert "the centre is not identifiable" in " ".join(verdict["reasons"])
    assert not run.info.certified
    assert run.V is None


def test_two_observers_are_compared_on_one_scenario() -> None:
    naive = Luenberger(L=[1.0, 1.5])
    scenario = msgspec.structs.replace(scene(simulation={"duration": 2.0}), compare=naive)
    steps: list[int] = []
    first, second = compare(scenario, progress=steps.append)
    alone = simulate(msgspec.structs.replace(scenario, observer=naive))
    assert (first.observer_name, second.observer_name) == ("certified", "luenberger")
    assert (first.info.method, second.info.method) == ("certified", "luenberger")
    assert np.array_equal(first.x, simulate(scenario).x)
    assert np.array_equal(second.x, alone.x)
    assert sum(steps) == 2 * (2001 + 4001)


def test_without_a_rival_there_is_nothing_to_compare() -> None:
    with pytest.raises(InputError, match=r"compare: this scenario has no \[compare\]. Name there"):
        compare(scene())


def test_labels_prefer_a_switch_and_fall_back_to_the_method() -> None:
    plain, silent = Certified(gamma=2.0), Certified(gamma=3.0, silence=True)
    assert labels(plain, Luenberger()) == ("certified", "luenberger")
    assert labels(plain, Certified(gamma=3.0)) == (
        "certified, gamma = 2.0",
        "certified, gamma = 3.0",
    )
    assert labels(plain, silent) == ("certified", "certified, silence")
    assert labels(plain, plain) == ("certified", "certified")


@pytest.mark.parametrize("order", [4, 8])
def test_true_widths_of_a_drifting_zone_do_not_depend_on_the_order(order: int) -> None:
    """Taylor series hold `order` columns an input where Runge-Kutta holds three instants."""
    options = {"duration": 2.0, "step": 0.01, "time": "continuous"}
    drifting = {"right": 1.0, "left": 0.7, "drift": 0.1}
    plain = resolve_scenario(scene(sensor=drifting, simulation=options))
    series = resolve_scenario(scene(sensor=drifting, simulation=options | {"order": order}))
    expected = exogenous.widths(plain, exogenous.exogenous(plain))
    np.testing.assert_array_equal(exogenous.widths(series, exogenous.exogenous(series)), expected)
    assert np.ptp(expected[:, 0]) > 0.01
