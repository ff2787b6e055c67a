"""Plants: constructors against each other, SciPy and python-control.

The exact hold; nonlinear plants against matrices; how fast a plant is.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
import scipy.signal
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from scenes import PAPER_PLANT, random_plant, response, scene, seeds, slopes, tables_of
from undeadzone.errors import InputError, ShapeError
from undeadzone.linalg.hold import zoh
from undeadzone.linalg.matrices import Matrices
from undeadzone.plants.build import initial_state, system
from undeadzone.plants.interop import from_control, from_scipy, to_scipy
from undeadzone.plants.options import (
    Plant,
    SecondOrder,
    TransferFunction,
    linear_matrices,
    to_control,
)
from undeadzone.plants.system import (
    System,
    fastest_pole,
    linearise_plant,
    moving_poles,
    sample_plant,
    time_scale,
)
from undeadzone.simulation.simulate import simulate
from undeadzone.util.arrays import Floats
from undeadzone_arena.gain_defaults import rate_or_default

FREQUENCIES = [0.0, 0.3, 1.0, 7.0, 200.0]
PENDULUM: dict[str, Any] = tables_of("""
f = ["rate", "-g / l * sin(angle) - b * rate + torque"]
h = ["angle"]
states = ["angle", "rate"]
inputs = ["torque"]
parameters = { g = 9.81, l = 0.5, b = 0.8 }
""")


def move(plant: System, x: Any, u: Any) -> Floats:
    """The plant's derivative or next value, in numbers."""
    return np.asarray(ca.DM(plant.move(plant.params, ca.SX(x), ca.SX(u)))).ravel()


@given(st.floats(0, 3), st.floats(0.1, 30), st.floats(0.1, 30))
def test_second_order_has_the_response_of_its_formula(
    zeta: float, omega: float, gain: float
) -> None:
    found = linear_matrices(Plant(second_order=SecondOrder(zeta=zeta, omega_n=omega, gain=gain)))
    for s in 1j * np.array(FREQUENCIES) + 0.01:
        assert response(found, s)[0, 0] == pytest.approx(
            gain / (s**2 + 2 * zeta * omega * s + omega**2)
        )


def test_the_papers_plant_in_every_form() -> None:
    forms = [
        Plant(A=[[0, 1], [-1, -2]], B=[[0], [1]], C=[[1, 0]]),
        Plant(second_order=SecondOrder(zeta=1.0, omega_n=1.0)),
        Plant(companion=[1.0, 2.0]),
        Plant(transfer_function=TransferFunction(numerator=[3.0], denominator=[3.0, 6.0, 3.0])),
    ]
    for form in forms:
        for found, expected in zip(linear_matrices(form), PAPER_PLANT.linear, strict=True):
            assert found.tolist() == expected.tolist()


@given(seeds, st.integers(1, 5))
def test_companion_has_its_polynomial_and_reads_the_first_state(seed: int, n: int) -> None:
    a = np.random.default_rng(seed).normal(size=n)
    A, B, C = linear_matrices(Plant(companion=a))
    assert np.poly(A) == pytest.approx([1.0, *a[::-1]], abs=1e-9)
    assert (B.ravel().tolist(), C.ravel().tolist()) == (
        [0.0] * (n - 1) + [1.0],
        [1.0] + [0.0] * (n - 1),
    )


def test_chain_of_integrators_integrates() -> None:
    A, B, C = linear_matrices(Plant(integrators=3))
    assert (C @ expm(A * 2.0) @ B)[0, 0] == pytest.approx(2.0**2 / 2)


@given(seeds, st.integers(1, 5))
def test_transfer_function_has_the_response_of_scipys(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    num, den = rng.normal(size=rng.integers(1, n + 1)), rng.normal(size=n + 1)
    found = linear_matrices(
        Plant(transfer_function=TransferFunction(numerator=num, denominator=den))
    )
    _, expected = scipy.signal.freqresp((num, den), FREQUENCIES)
    assert [response(found, 1j * w)[0, 0] for w in FREQUENCIES] == pytest.approx(expected, rel=1e-6)


@given(seeds, st.integers(1, 4), st.integers(1, 3), st.floats(1e-4, 2.0))
def test_hold_equals_scipys_also_with_integrators(seed: int, n: int, m: int, Ts: float) -> None:
    A, B, C = random_plant(np.random.default_rng(seed), n, m, stable=False).linear
    A = A.copy()
    A[0] = 0.0
    found = zoh(Matrices(A, B, C), Ts)
    Ad, Bd, Cd, _, _ = scipy.signal.cont2discrete((A, B, C, np.zeros((1, m))), Ts)
    for ours, theirs in zip(found, (Ad, Bd, Cd), strict=True):
        assert ours == pytest.approx(theirs, rel=1e-12, abs=1e-12)


def test_interop_round_trips_and_refusals() -> None:
    import control

    plant = Plant(A=[[0, 1, 0], [0, 0, 1], [-1, -2, -3]], B=[[0, 1], [1, 0], [0, 2]], C=[[1, 0, 0]])
    for there, back in ((to_scipy, from_scipy), (to_control, from_control)):
        for found, expected in zip(
            linear_matrices(back(there(plant))), linear_matrices(plant), strict=True
        ):
            assert found.tolist() == expected.tolist()
    theirs = control.tf([2.0], [1.0, 3.0, 5.0])
    ours = linear_matrices(from_control(control.ss(theirs)))
    assert response(ours, 2j)[0, 0] == pytest.approx(theirs(2j))
    assert control.poles(to_control(plant)) == pytest.approx(
        np.linalg.eigvals(linear_matrices(plant).A)
    )
    assert from_scipy(to_scipy(plant), x0=[1, 2, 3]).x0 == [1, 2, 3]
    of_scipy = scipy.signal.TransferFunction([2.0], [1.0, 3.0, 5.0])
    for converted in (from_control(theirs), from_scipy(of_scipy)):
        assert response(linear_matrices(converted), 2j)[0, 0] == pytest.approx(theirs(2j))
    with pytest.raises(InputError, match=r"uz\.Plant\(A=\.\.\., B=\.\.\., C=\.\.\.\)"):
        from_control([[0, 1], [-1, -2]])
    with pytest.raises(InputError, match="no state space"):
        from_control(control.tf([1.0, 0.0, 0.0], [1.0, 1.0]))
    with pytest.raises(InputError, match=r"no sample time \(dt = True\)"):
        from_control(control.ss(control.tf([0.1], [1.0, -0.9], True)))
    with pytest.raises(InputError, match=r"sampled pole lies at -0\.5"):
        from_control(control.tf([0.1], [1.0, 0.5], 0.1))
    with pytest.raises(InputError, match="lies at 0, a delay"):
        from_control(control.tf([0.1], [1.0, 0.0], 0.1))
    with pytest.raises(InputError, match="D must be 0"):
        from_scipy(scipy.signal.StateSpace([[-1.0]], [[1.0]], [[1.0]], [[1.0]]))
    with pytest.raises(InputError, match="nonlinear"):
        to_control(Plant(**PENDULUM))


@given(st.integers(0, 10**6), st.integers(1, 4), st.integers(1, 2))
def test_a_discrete_system_is_the_hold_of_the_plant(seed: int, n: int, m: int) -> None:
    """Sampling with a step below the Nyquist bound of every pole, and back, changes nothing."""
    import control

    plant = random_plant(np.random.default_rng(seed), n, m)
    A, B, C = plant.linear
    step = 1.0 / np.abs(np.linalg.eigvals(A)).max()
    sampled = control.ss(A, B, C, np.zeros((len(C), m))).sample(step)
    found = linear_matrices(from_control(sampled))
    for ours, expected in zip(found, (A, B, C), strict=True):
        assert ours == pytest.approx(expected, rel=1e-6, abs=1e-6 * np.abs(expected).max())
    again = zoh(found, step)
    assert pytest.approx(np.asarray(sampled.A), abs=1e-9) == again.A


def test_formulas_equal_matrices_in_the_loop() -> None:
    formulas = {"f": ["v", "-x - 2 * v + u"], "h": ["x"], "states": ["x", "v"], "x0": [0.5, 0.0]}
    given_by_formulas, given_by_matrices = simulate(scene(plant=formulas)), simulate(scene())
    for name in ("x", "x_hat", "d_hat", "u", "r"):
        assert getattr(given_by_formulas, name) == pytest.approx(
            getattr(given_by_matrices, name), abs=1e-9
        )


def test_callables_equal_formulas_also_in_the_loop() -> None:
    g, l, b = (PENDULUM["parameters"][name] for name in "glb")
    callables = Plant(
        f=lambda x, u: ca.vertcat(x[1], -g / l * ca.sin(x[0]) - b * x[1] + u),
        h=lambda x: x[0],
        states=["angle", "rate"],
        x0=[0.3, 0.1],
    )
    formulas = Plant(**PENDULUM, x0=[0.3, 0.1])
    for one, other in zip(system(callables).linear, system(formulas).linear, strict=True):
        assert one == pytest.approx(other)
    tables: dict[str, Any] = tables_of("""
        observer = { method = "certified", L = [2.0, 3.0] }
        simulation = { duration = 0.3, step = 0.01 }
        """)
    reference = {"kind": "sine", "amplitude": 1.5, "frequency": 0.5}
    by_formulas = simulate(
        scene(plant=PENDULUM | {"x0": [0.3, 0.1]}, reference=reference, **tables)
    )
    scenario = scene(plant=PENDULUM, reference=reference, **tables)
    by_callables = simulate(
        type(scenario)(
            **{name: getattr(scenario, name) for name in scenario.__struct_fields__}
            | {"plant": callables}
        )
    )
    assert by_callables.x == pytest.approx(by_formulas.x, abs=1e-12)


def test_linearisation_is_that_of_the_pendulum() -> None:
    at_rest, upright = system(Plant(**PENDULUM)), system(Plant(**PENDULUM, x_eq=[np.pi, 0.0]))
    np.testing.assert_allclose(at_rest.linear.A, np.array([[0, 1], [-9.81 / 0.5, -0.8]]))
    np.testing.assert_allclose(upright.linear.A, np.array([[0, 1], [9.81 / 0.5, -0.8]]), rtol=1e-6)
    assert (at_rest.n, at_rest.m, at_rest.p, at_rest.nonlinear) == (2, 1, 1, True)


def test_sampled_nonlinear_plant_has_order_four_in_its_substeps() -> None:
    plant, Ts, start, u = system(Plant(**PENDULUM)), 0.5, np.array([2.0, -1.0]), 3.0
    exact = solve_ivp(
        lambda t, x: [x[1], -9.81 / 0.5 * np.sin(x[0]) - 0.8 * x[1] + u],
        (0, Ts),
        start,
        "DOP853",
        rtol=1e-13,
        atol=1e-13,
    ).y[:, -1]
    counts = np.array([8, 16, 32, 64])
    errors = [
        np.abs(move(sample_plant(plant, Ts, int(count)), start, u) - exact).max()
        for count in counts
    ]
    assert slopes(1.0 / counts, errors) == pytest.approx(4.0, abs=0.3)


def test_sampled_linear_plant_is_the_exact_hold() -> None:
    found = sample_plant(PAPER_PLANT, 0.2)
    Ad, Bd, _ = zoh(PAPER_PLANT.linear, 0.2)
    assert move(found, [1.0, 2.0], 3.0) == pytest.approx(Ad @ [1, 2] + 3 * Bd[:, 0], abs=1e-15)
    assert found.Ts == 0.2


def test_initial_state() -> None:
    chain = system(Plant(integrators=2))
    assert initial_state(Plant(integrators=2), chain).tolist() == [0, 0]
    assert initial_state(Plant(integrators=2, x0=[[1.0], [2.0]]), chain).tolist() == [1, 2]
    with pytest.raises(
        ShapeError, match=r"plant.x0: expected 2 numbers \(one per state\), found 3"
    ):
        initial_state(Plant(integrators=2, x0=[1, 2, 3]), chain)


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        (PENDULUM | {"h": lambda x: x[0]}, InputError, "both be formulas or both be callables"),
        ({"f": lambda x, u: x, "h": lambda x: x[0]}, InputError, "needs x0 or states"),
        (
            {"f": lambda x, u: x[0], "h": lambda x: x[0], "x0": [0.0, 0.0]},
            ShapeError,
            "plant.f: expected 2 derivatives",
        ),
    ],
)
def test_wrong_functions_of_a_program(
    options: dict[str, Any], error: type[Exception], words: str
) -> None:
    with pytest.raises(error, match=words):
        system(Plant(**options))


def test_integrators_are_no_moving_poles() -> None:
    """Poles 0, 0, -2, -8: a quarter period of each that moves, and their geometric mean."""
    A = np.diag([0.0, 0.0, -2.0, -8.0])
    plant = system(Plant(A=A, B=np.ones((4, 1)), C=np.ones((1, 4))))
    assert sorted(moving_poles(plant)) == pytest.approx([2.0, 8.0])
    assert fastest_pole(plant) == pytest.approx(8.0)
    assert time_scale(plant.linear) == pytest.approx(np.pi / 2 / 4.0)
    slow = sample_plant(plant, 0.1)
    assert moving_poles(slow) == pytest.approx(moving_poles(plant))


def test_a_chain_of_integrators_has_a_rate_and_a_time_of_1() -> None:
    plant = system(Plant(integrators=3))
    assert moving_poles(plant).tolist() == [1.0]
    assert time_scale(plant.linear) == 1.0


def test_a_rate_is_the_users_or_a_multiple_of_the_fastest_pole() -> None:
    plant = system(Plant(companion=[4.0, 5.0]))
    assert rate_or_default(plant, "observer.gain", 7.0, 3.0) == 7.0
    assert rate_or_default(plant, "observer.gain", None, 3.0) == pytest.approx(12.0)
    with pytest.raises(InputError, match=r"observer.gain"):
        rate_or_default(plant, "observer.gain", -1.0, 3.0)


@pytest.mark.parametrize(("slope", "refused"), [(1e120, True), (1e90, False)])
def test_a_slope_whose_squares_overflow_is_not_linearised(slope: float, refused: bool) -> None:
    def build() -> System:
        return linearise_plant(
            "plant",
            np.zeros(0),
            lambda p, x, u: slope * x + u,
            lambda p, x: x,
            np.zeros(1),
            np.zeros(1),
        )

    if refused:
        with pytest.raises(InputError, match="cannot be linearised"):
            build()
    else:
        assert build().linear.A[0, 0] == slope
