"""Controllers of one's own: LTI, PID, LQG and a Python function, against theory and each other."""

from __future__ import annotations

from typing import Any

import control
import numpy as np
import pytest
import scipy.signal
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_continuous_are

import undeadzone as uz
from scenes import scene
from undeadzone.controllers.linear_controller import LinearController, Params
from undeadzone.errors import InputError, ShapeError
from undeadzone.interfaces import Estimate
from undeadzone.util.arrays import Floats

SAMPLED = {"duration": 4.0, "step": 0.01, "time": "sampled"}
CONTINUOUS = {"duration": 4.0, "step": 0.01}
STEP = {"kind": "step", "amplitude": 3.0, "time": 0.0}


def run(controller: Any, simulation: dict[str, Any] | None = None, **tables: Any) -> uz.Run:
    """A run of the paper's plant under a controller."""
    table = controller
    if not isinstance(controller, dict):
        table = {"method": "pid", "k_p": 1.0}
    scenario = scene(controller=table, simulation=simulation or SAMPLED, **tables)
    if not isinstance(controller, dict):
        scenario = scenario.replace("controller", controller)
    return uz.simulate(scenario, check_step=False)


def test_objects_of_other_packages_are_converted_to_their_numbers() -> None:
    numerator, denominator = [2.0, 5.0], [0.05, 1.0, 0.0]
    space = control.ss(control.tf(numerator, denominator))
    controller = LinearController(space)
    np.testing.assert_array_equal(np.asarray(controller.A), space.A)
    expected = run({"method": "linear", "numerator": numerator, "denominator": denominator})
    systems = [
        space,
        control.tf(numerator, denominator),
        scipy.signal.TransferFunction(numerator, denominator),
        scipy.signal.StateSpace(space.A, space.B, space.C, space.D),
    ]
    for system in systems:
        np.testing.assert_allclose(run(LinearController(system)).z, expected.z, atol=1e-9)


def test_a_sampled_system_keeps_its_sample_time() -> None:
    system = control.c2d(control.ss(control.tf([2.0, 5.0], [0.05, 1.0])), 0.01, "tustin")
    expected = run({"method": "linear", "numerator": [2.0, 5.0], "denominator": [0.05, 1.0]})
    np.testing.assert_allclose(run(LinearController(system)).z, expected.z, atol=1e-9)
    with pytest.raises(InputError, match=r"controller\.Ts: must be simulation\.step, 0\.02 s"):
        run(LinearController(system), SAMPLED | {"step": 0.02})
    with pytest.raises(InputError, match=r"controller\.Ts: .*sampled"):
        run(LinearController(system), CONTINUOUS)


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.floats(-5, 5), min_size=1, max_size=4),
    st.lists(st.floats(-5, 5), min_size=1, max_size=3),
    st.floats(1e-3, 0.3),
)
def test_tustin_keeps_the_frequency_response_at_warped_frequencies(
    poles: list[float], numerator: list[float], Ts: float
) -> None:
    from undeadzone.controllers.linear_controller import _discretise_tustin

    numerator = [1.0, *numerator[: len(poles)]]
    A, B, C, D = scipy.signal.tf2ss(numerator, np.poly(poles))
    discrete = _discretise_tustin(Params(A, B, C, D), Ts)
    for omega in (0.1, 1.0, 0.5 / Ts):
        s = 2j / Ts * np.tan(omega * Ts / 2)
        z = np.exp(1j * omega * Ts)
        np.testing.assert_allclose(response(discrete, z), response((A, B, C, D), s), rtol=1e-6)


def response(system: Any, s: complex) -> complex:
    """C (s I - A)^-1 B + D."""
    A, B, C, D = system
    return complex((C @ np.linalg.solve(s * np.eye(len(A)) - A, B) + D)[0, 0])


@pytest.mark.parametrize("simulation", [CONTINUOUS, SAMPLED])
def test_pid_and_its_transfer_function_give_one_run(simulation: dict[str, Any]) -> None:
    """Errors in z^ alone: b = c = 1, so that all three terms act on r - z^."""
    k_p, k_i, k_d, tau = 4.0, 3.0, 0.5, 0.1
    numerator = np.polyadd([k_d, 0.0, 0.0], np.polymul([k_p, k_i], [tau, 1.0]))
    pid = {"method": "pid", "k_p": k_p, "k_i": k_i, "k_d": k_d, "filter_time": tau}
    one = run(pid | {"reference_weights": [1.0, 1.0]}, simulation, reference=STEP)
    lti = {"method": "linear", "numerator": numerator.tolist(), "denominator": [tau, 1.0, 0.0]}
    other = run(lti, simulation, reference=STEP)
    off = 1e-6 if simulation is CONTINUOUS else 0.02  # Tustin against hold
    assert np.abs(one.z - other.z).max() < off * np.abs(other.z).max()


def test_the_integral_follows_a_constant_in_spite_of_a_disturbance() -> None:
    pushed = {"kind": "step", "amplitude": 0.7, "time": 1.0}
    tables: dict[str, Any] = {
        "reference": STEP,
        "disturbance": pushed,
        "observer": {"method": "full_state"},
    }
    long = SAMPLED | {"duration": 20.0}
    for controller in (
        {"method": "pid", "k_p": 4.0, "k_i": 3.0},
        {"method": "lqg", "Q": 5.0, "integral": 10.0},
    ):
        assert run(controller, long, **tables).rms_tracking < 1e-3
    assert run({"method": "lqg", "Q": 5.0}, long, **tables).rms_tracking > 0.05


def test_anti_windup_shortens_the_overshoot() -> None:
    tables: dict[str, Any] = {"reference": STEP, "observer": {"method": "full_state"}}
    long = SAMPLED | {"duration": 20.0}
    pid = {"method": "pid", "k_p": 4.0, "k_i": 3.0, "limits": [-3.3, 3.3]}
    wound = run(pid | {"tracking_time": 1e6}, long, **tables)
    freed = run(pid, long, **tables)
    assert np.abs(freed.u).max() <= 3.3
    assert freed.z.max() - 3.0 < 0.5 * (wound.z.max() - 3.0)


def test_lqg_has_the_gain_of_the_riccati_equation() -> None:
    A, B = np.array([[0.0, 1.0], [-1.0, -2.0]]), np.array([[0.0], [1.0]])
    plant = uz.Plant(A=A, B=[0, 1], C=[1, 0])
    from undeadzone.plants.build import system

    K = uz.LQG(Q=2.0, R=0.5).build(system(plant)).K
    P = solve_continuous_are(A, B, 2.0 * np.eye(2), 0.5 * np.eye(1))
    np.testing.assert_allclose(K, 2.0 * B.T @ P, rtol=1e-9)


@pytest.mark.parametrize(
    "observer",
    [{"method": "certified"}, {"method": "moving_horizon", "right": [0, 2], "left": [0, 2]}],
)
def test_a_function_gives_the_run_of_the_same_law_as_a_graph(observer: dict[str, Any]) -> None:
    """For an observer on the graph and for one in Python."""
    scenario = scene(
        observer=observer,
        simulation=SAMPLED | {"duration": 0.5},
        controller={"method": "pid", "k_p": 2.0},
    )
    expected = uz.simulate(scenario)

    def law(t: float, estimate: Estimate, r: Floats) -> Floats:
        return 2.0 * (r - estimate.z)

    result = uz.simulate(scenario, controller=law)
    np.testing.assert_allclose(result.z, expected.z, atol=1e-12)
    np.testing.assert_allclose(result.u, expected.u, atol=1e-12)


def test_what_is_no_law_is_refused() -> None:
    scenario = scene(simulation=SAMPLED)
    with pytest.raises(ShapeError, match=r"controller: .*at t = 0 s"):
        uz.simulate(scenario, controller=lambda t, estimate, r: [1.0, 2.0])
    with pytest.raises(InputError, match=r"controller: every number must be finite"):
        uz.simulate(scenario, controller=lambda t, estimate, r: np.nan)
    with pytest.raises(InputError, match="expected a function"):
        uz.simulate(scenario, controller=uz.PID(k_p=1.0))  # type: ignore[arg-type]
    with pytest.raises(InputError, match="sampled"):
        uz.simulate(scene(), controller=lambda t, estimate, r: 0.0)
