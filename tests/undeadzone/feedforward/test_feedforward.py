"""Feedforward: C x_ref = r exactly, and the plant follows when it starts on x_ref.

And the messages about what cannot be followed.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from scenes import PAPER_PLANT, linear, random_plant, response, seeds, tables_of
from undeadzone.errors import StructureError, TrackingError
from undeadzone.feedforward.flank_path import crossing
from undeadzone.feedforward.targets import invert_targets, linear_targets, regulator
from undeadzone.plants.build import system
from undeadzone.plants.options import Plant, SecondOrder, TransferFunction
from undeadzone.plants.system import System, sample_plant
from undeadzone.signals.exosystem import (
    Exosystem,
    Signal,
    Sine,
    Sines,
    Step,
    Tone,
    Trapezoid,
    build_exosystem,
)

T = np.linspace(0.0, 3.0, 301)
SINE = Sine(amplitude=5.0, frequency=1.0)


def exo(signal: Signal, channels: int = 1) -> Exosystem:
    return build_exosystem("reference", signal, channels)


def plant_of(**options: Any) -> System:
    return system(Plant(**options))


@given(seeds, st.integers(1, 5), st.integers(1, 3), st.integers(0, 1), st.floats(0.01, 1e4))
def test_regulator_equations_hold_for_random_plants(
    seed: int, n: int, q: int, extra: int, frequency: float
) -> None:
    """A Pi + B Gamma = Pi S, C Pi = Q: x_ref' = A x_ref + B u_ff and C x_ref = r for all time."""
    q = min(q, n)
    plant = random_plant(np.random.default_rng(seed), n, q + extra, q, stable=False)
    reference = exo(
        Sines(
            components=[
                Tone(amplitude=1.0, frequency=frequency),
                Tone(amplitude=2.0, frequency=2.1 * frequency, phase=1.0),
            ],
            offset=0.5,
        ),
        q,
    )
    target = linear_targets(plant, reference, list(range(q)), T)
    Pi, _, residual = regulator(plant.linear, reference.S, reference.Q)
    A, B, C = plant.linear
    w = reference.state(T)
    size = 1 + np.abs(target.x_ref).max()
    assert residual < 1e-8
    assert target.x_ref @ C.T == pytest.approx(reference.output_at(T), abs=1e-7)
    assert w @ (Pi @ reference.S).T == pytest.approx(
        target.x_ref @ A.T + target.u_ff @ B.T, abs=1e-7 * size
    )


@pytest.mark.parametrize(
    "signal", [SINE, Step(amplitude=2.0), Sine(amplitude=1.0, frequency=0.3, offset=2.0, phase=0.4)]
)
@pytest.mark.parametrize("unstable", [False, True])
def test_a_plant_started_on_x_ref_follows(signal: Signal, unstable: bool) -> None:
    plant = plant_of(companion=[-0.5 if unstable else 1.0, 2.0, 1.5])
    reference = exo(signal)
    A, B, _ = plant.linear

    def rate(t: float, x: Any) -> Any:
        return A @ x + B @ linear_targets(plant, reference, [0], np.array([t])).u_ff[0]

    start = linear_targets(plant, reference, [0], np.zeros(1)).x_ref[0]
    z = solve_ivp(rate, (0, 3), start, "DOP853", t_eval=T, rtol=1e-11, atol=1e-11).y[0]
    assert z == pytest.approx(reference.output_at(T)[:, 0], abs=1e-7)


def test_amplitude_of_the_feedforward_is_the_inverse_of_the_frequency_response() -> None:
    for frequency in (0.1, 1.0, 30.0, 1000.0):
        target = linear_targets(
            PAPER_PLANT,
            exo(Sine(amplitude=1.0, frequency=frequency)),
            [0],
            np.linspace(0, 1 / frequency, 401),
        )
        assert np.abs(target.u_ff).max() * abs(
            response(PAPER_PLANT.linear, 2j * np.pi * frequency)[0, 0]
        ) == pytest.approx(1.0, rel=1e-4)


@pytest.mark.parametrize("order", [2, 4, 6])
@pytest.mark.parametrize("frequency", [1e-2, 1.0, 1e3])
def test_chains_far_from_unit_scale_are_followed(order: int, frequency: float) -> None:
    reference = exo(Sine(amplitude=1e-3, frequency=frequency))
    t = np.linspace(0, 1 / frequency, 401)
    target = linear_targets(plant_of(integrators=order), reference, [0], t)
    assert target.x_ref[:, 0] == pytest.approx(reference.output_at(t)[:, 0], abs=1e-10)
    assert np.abs(target.u_ff).max() == pytest.approx(1e-3 * (2 * np.pi * frequency) ** order)


@given(seeds, st.floats(0.01, 0.3))
def test_sampled_targets_are_exact_at_the_samples(seed: int, Ts: float) -> None:
    plant = sample_plant(random_plant(np.random.default_rng(seed), 3), Ts)
    A, B, C = plant.linear
    t = Ts * np.arange(200)
    reference = exo(Sine(amplitude=2.0, frequency=0.4 / (10 * Ts), phase=0.5, offset=1.0))
    target = linear_targets(plant, reference, [0], t)
    size = 1 + np.abs(target.x_ref).max()
    assert target.x_ref[1:] == pytest.approx(
        target.x_ref[:-1] @ A.T + target.u_ff[:-1] @ B.T, abs=1e-7 * size
    )
    assert target.x_ref @ C.T == pytest.approx(reference.output_at(t), abs=1e-7)


def test_tracked_output_is_the_requested_one() -> None:
    plant = linear([[0.0, 1.0], [-1.0, -2.0]], [[0.0], [1.0]], [[1.0, 0.0], [0.0, 1.0]])
    target = linear_targets(plant, exo(SINE), [1], T)
    assert target.x_ref[:, 1] == pytest.approx(exo(SINE).output_at(T)[:, 0], abs=1e-9)


@pytest.mark.parametrize(
    ("numerator", "signal", "where"),
    [
        ([1.0, 0.0, 4.0], Sine(amplitude=1.0, frequency=1 / np.pi), r"0\+2j"),
        ([1.0, 0.0], Step(amplitude=1.0), "0"),
        ([1.0, 0.0], Sine(amplitude=1.0, frequency=1.0, offset=1.0), "0"),
        ([1.0, 0.0], Trapezoid(amplitude=1.0, rise=1.0, hold=1.0), "0"),
    ],
)
@pytest.mark.parametrize("Ts", [None, 0.05])
def test_a_zero_on_the_spectrum_is_named(
    numerator: list[float], signal: Signal, where: str, Ts: float | None
) -> None:
    plant = plant_of(
        transfer_function=TransferFunction(numerator=numerator, denominator=[1.0, 3.0, 3.0, 1.0])
    )
    if Ts is not None and len(numerator) == 3:
        return  # sampling moves complex zeros off the axis
    with pytest.raises(
        TrackingError, match=f"^reference: .* a zero of the plant at s = {where} lies"
    ):
        linear_targets(plant if Ts is None else sample_plant(plant, Ts), exo(signal), [0], T)


def test_a_zero_elsewhere_is_no_obstacle() -> None:
    plant = plant_of(
        transfer_function=TransferFunction(
            numerator=[1.0, 0.0, 4.0], denominator=[1.0, 3.0, 3.0, 1.0]
        )
    )
    reference = exo(Sine(amplitude=1.0, frequency=1.01 / np.pi))
    target = linear_targets(plant, reference, [0], T)
    assert target.x_ref @ plant.linear.C.T == pytest.approx(reference.output_at(T), abs=1e-7)


def test_more_outputs_than_inputs_cannot_follow() -> None:
    plant = linear([[0.0, 1.0], [-1.0, -2.0]], [[0.0], [1.0]], np.eye(2))
    with pytest.raises(
        TrackingError,
        match=r"^tracked: the plant has 1 input and cannot make 2 outputs follow. Name at most 1",
    ):
        linear_targets(plant, exo(SINE, 2), [0, 1], T)


PENDULUM: dict[str, Any] = tables_of("""
f = ["rate", "-g * sin(angle) - b * rate + torque"]
h = ["angle"]
states = ["angle", "rate"]
inputs = ["torque"]
parameters = { g = 9.81, b = 0.8 }
""")


def test_inversion_of_a_pendulum_is_that_by_hand() -> None:
    reference = exo(Sine(amplitude=2.5, frequency=0.7, offset=0.3))
    r, dr, ddr = (reference.output_at(T, order)[:, 0] for order in range(3))
    target = invert_targets(plant_of(**PENDULUM), reference, [0], T, np.zeros(2))
    assert target.x_ref == pytest.approx(np.stack([r, dr], axis=1), abs=1e-10)
    assert target.u_ff[:, 0] == pytest.approx(ddr + 9.81 * np.sin(r) + 0.8 * dr, abs=1e-9)


def test_inversion_of_two_coupled_outputs() -> None:
    plant = plant_of(
        f=["-a + b ** 2 + u", "-b ** 3 + a * b + v"],
        h=["a + b ** 3", "b"],
        states=["a", "b"],
        inputs=["u", "v"],
    )
    reference = exo(Sine(amplitude=[1.0, 0.5], frequency=0.5, phase=[0.0, 1.0]), 2)
    target = invert_targets(plant, reference, [0, 1], T, np.zeros(2))
    (r, s), (dr, ds) = reference.output_at(T).T, reference.output_at(T, 1).T
    a, b, da = r - s**3, s, dr - 3 * s**2 * ds
    assert target.x_ref == pytest.approx(np.stack([a, b], axis=1), abs=1e-9)
    assert target.u_ff == pytest.approx(
        np.stack([da + a - b**2, ds + b**3 - a * b], axis=1), abs=1e-9
    )


def test_inversion_agrees_with_the_regulator_equations_on_a_linear_plant() -> None:
    formulas = plant_of(f=["v", "-x - 2 * v + u"], h=["x"], states=["x", "v"])
    by_inversion = invert_targets(formulas, exo(SINE), [0], T, np.zeros(2))
    by_regulator = linear_targets(PAPER_PLANT, exo(SINE), [0], T)
    for one, other in zip(by_inversion, by_regulator, strict=True):
        assert one == pytest.approx(other, abs=1e-9)


@pytest.mark.parametrize(
    ("changes", "channels", "words"),
    [
        ({"h": ["rate"]}, 1, "has zero dynamics .relative degrees .1. add up to 1, not to n = 2"),
        (
            {"h": ["0 * torque + angle", "rate"]},
            2,
            "^tracked: a nonlinear plant with 1 input needs 1 tracked output",
        ),
        ({"h": ["sin(angle)"]}, 1, "cannot follow it at t = "),
    ],
)
def test_inversion_says_what_it_cannot_do(
    changes: dict[str, Any], channels: int, words: str
) -> None:
    changes = {"h": [text.replace("0 * torque + ", "") for text in changes["h"]]}
    with pytest.raises(TrackingError, match=words):
        invert_targets(
            plant_of(**PENDULUM | changes),
            exo(Sine(amplitude=2.0, frequency=0.5), channels),
            list(range(channels)),
            T,
            np.zeros(2),
        )


def test_dc_gain_is_unity_only_if_requested() -> None:
    """u_ff for a constant r is r / G(0)."""
    for gain, expected in ((1.0, 4 * np.pi**2 * 3.0), (4 * np.pi**2, 3.0)):
        plant = plant_of(second_order=SecondOrder(zeta=1.0, omega_n=2 * np.pi, gain=gain))
        assert linear_targets(plant, exo(Step(amplitude=3.0)), [0], T).u_ff[0, 0] == pytest.approx(
            expected
        )


def test_inversion_of_fast_and_large_references() -> None:
    """Accelerations of 1e6: the Newton iteration stops at rounding, not at a fixed residual."""
    for frequency in (1.0, 30.0, 300.0):
        t = np.linspace(0, 1 / frequency, 501)
        reference = exo(Sine(amplitude=1.0, frequency=frequency))
        r, dr, ddr = (reference.output_at(t, order)[:, 0] for order in range(3))
        target = invert_targets(plant_of(**PENDULUM), reference, [0], t, np.zeros(2))
        assert target.u_ff[:, 0] == pytest.approx(
            ddr + 9.81 * np.sin(r) + 0.8 * dr, rel=1e-9, abs=1e-9 * np.abs(ddr).max()
        )


def test_a_plant_in_small_units_has_other_equilibria() -> None:
    """A zero at s = 0 belongs to the plant. Its units neither make one nor hide one."""
    model = sample_plant(PAPER_PLANT, 0.01).linear
    small = model._replace(C=1e-9 * model.C)
    found = crossing(small, 3.0, 0.01, "observer.search")
    assert found.gain == pytest.approx(1e9 * crossing(model, 3.0, 0.01, "observer.search").gain)
    rate = model._replace(C=np.array([[0.0, 1e9]]))  # z is a rate: 0 at rest
    with pytest.raises(StructureError, match="a zero at s = 0"):
        crossing(rate, 3.0, 0.01, "observer.search")
