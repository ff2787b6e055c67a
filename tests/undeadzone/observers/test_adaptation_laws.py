"""Adaptation laws: twins, and what each keeps of the certificate.

Convergence on the paper's example, and the price of a leak.
"""

from __future__ import annotations

import functools
from types import SimpleNamespace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenes import PAPER_PLANT, OnNumbers, scene, seeds, tables_of
from undeadzone.analysis.certificate.passivity import certify
from undeadzone.errors import InputError
from undeadzone.interfaces import Estimate
from undeadzone.nonlinearities import sensor
from undeadzone.nonlinearities.sensor import Sensor, resolve
from undeadzone.observers import Certified
from undeadzone.observers.adaptive.adaptation_laws import (
    Adaptation,
    EModification,
    Gradient,
    LeastSquares,
    Normalised,
    Sigma,
    e_modification_move,
    read_initial_widths,
)
from undeadzone.observers.adaptive.branch_observer import correct_jump
from undeadzone.observers.adaptive.output_error import read_adapted_widths
from undeadzone.plants.system import System, sample_plant
from undeadzone.simulation.simulate import simulate
from undeadzone.util.arrays import Floats

TRUTH = np.array([1.3, 0.6])
ZONE = resolve(Sensor(right=TRUTH[0], left=TRUTH[1]), 1, 1e-3)
TS = 0.02
SAMPLED = sample_plant(PAPER_PLANT, TS)
L, GAMMA = np.array([1.0, 1.5]), 10.0
SMALL = np.array([0.2, 0.1])  # |G| < 1: C (sI - A)^-1 L is 0.5 at s = 0 and falls


def random_state(rng: np.random.Generator, gained: bool) -> tuple[Any, Floats, float]:
    """(observer state (x^, d_r^, d_l^, gains), x, side) at random, x where that side is read.

    Widths inside the projection.
    """
    side = float(rng.integers(-1, 2))
    z = {
        1.0: TRUTH[0] + rng.exponential(),
        0.0: rng.uniform(-TRUTH[1], TRUTH[0]),
        -1.0: -TRUTH[1] - rng.exponential(),
    }[side]
    gains = rng.uniform(0.01, 1.0, (2, 1)) if gained else np.zeros((2, 0))
    return (
        (rng.normal(size=2) * 2, rng.uniform(0, 3, 1), rng.uniform(0, 3, 1), *gains),
        np.array([z, rng.normal() * 3]),
        side,
    )


def reading(x: Floats) -> Floats:
    return np.asarray(sensor.deadzone(x[:1], TRUTH[0], TRUTH[1]))


def rates(
    adaptation: Adaptation, gain: Floats, state: Any, x: Floats, side: float
) -> tuple[Any, Estimate, Floats]:
    """In continuous time: (the state's derivative, estimate, d/dt of x - x^ with u = 0)."""
    observer = Certified(L=gain, gamma=GAMMA, width_max=5.0, adaptation=adaptation).build(
        PAPER_PLANT, ZONE
    )
    after, estimate = OnNumbers(observer, PAPER_PLANT)(state, [0.0], reading(x), [side])
    return after, estimate, PAPER_PLANT.linear.A @ x - after.x


# --- Twins


def test_gradient_is_the_default() -> None:
    assert Certified() == Certified(adaptation=Gradient())


@given(seeds)
def test_laws_without_their_number_are_the_gradient(seed: int) -> None:
    state, x, side = random_state(np.random.default_rng(seed), gained=False)
    expected = rates(Gradient(), L, state, x, side)[0]
    for law in (Normalised(weight=0.0), Sigma(leak=0.0), EModification(leak=0.0)):
        assert all(
            np.array_equal(a, b)
            for a, b in zip(rates(law, L, state, x, side)[0], expected, strict=True)
        )


@given(seeds, st.floats(0.0, 3.0))
def test_least_squares_is_weighted_least_squares(seed: int, forgetting: float) -> None:
    """With x^ = x, d^ after N readings minimises a weighted sum of squares.

    It is sum w^(N-k) |d - d_k|^2 + w^N |d - d^(0)|^2 / (gamma Ts), w = e^(-forgetting Ts).
    """
    rng = np.random.default_rng(seed)
    law = LeastSquares(forgetting=forgetting)
    observer = Certified(
        L=[0.0, 0.0], gamma=GAMMA, widths0=0.5, width_max=9.0, adaptation=law
    ).build(SAMPLED, ZONE)
    step, state, x = OnNumbers(observer, SAMPLED), observer.init(observer.params), np.zeros(2)
    fade = np.exp(-forgetting * TS)
    weights, values = [1 / (GAMMA * TS)], [0.5]
    for _ in range(40):
        u, d = rng.normal(size=1), rng.uniform(1.0, 2.0)
        state, _ = step(state, u, x[:1] - d, [1.0])
        x = SAMPLED.linear.A @ x + SAMPLED.linear.B @ u
        weights, values = [*(fade * w for w in weights), 1.0], [*values, d]
        if sum(weights) * GAMMA * TS >= 1:  # the gain is not held at gamma
            assert state.right[0] == pytest.approx(np.average(values, weights=weights), rel=1e-10)
            assert state.right_gain[0] == pytest.approx(1 / sum(weights), rel=1e-10)
        else:
            return
    assert state.left_gain[0] == pytest.approx(GAMMA * TS)


def test_least_squares_gain_in_continuous_time() -> None:
    """g' = forgetting g - g^2 where active, forgetting g elsewhere, never above gamma."""
    law, state = LeastSquares(forgetting=0.5), (np.zeros(2), [1.0], [1.0], [4.0], [4.0])
    after, _, _ = rates(law, L, state, np.array([2.0, 0.0]), 1.0)
    assert (after.right_gain, after.left_gain) == (0.5 * 4.0 - 16.0, 0.5 * 4.0)
    after, _, _ = rates(law, L, (*state[:3], [GAMMA], [GAMMA]), np.array([2.0, 0.0]), 1.0)
    assert (after.right_gain, after.left_gain) == (5.0 - 100.0, 0.0)


def test_least_squares_gain_is_reset_when_it_has_become_small() -> None:
    observer = Certified(L=L, gamma=GAMMA, adaptation=LeastSquares(reset=0.2)).build(SAMPLED, ZONE)
    step, state = OnNumbers(observer, SAMPLED), observer.init(observer.params)
    gains = []
    for _ in range(60):
        state, _ = step(state, [0.0], [1.0], [1.0])
        gains.append(float(state.right_gain[0]) / TS)
    assert min(gains) >= 0.2 * GAMMA
    assert sum(abs(gain - GAMMA) < 1e-12 for gain in gains) >= 2
    assert gains[0] == pytest.approx(GAMMA / (1 + GAMMA * TS))


# --- What becomes of V


class Change(NamedTuple):
    """How V = x~'P x~ + |d~|^2 / gamma changes in continuous time.

    Attributes:
        P: of the certificate, for d~ of weight 1.
        x_error, d_error: x~ and d~.
        innovation: C x~ as it is read.
        rise: V'.
    """

    P: Floats
    x_error: Floats
    d_error: Floats
    innovation: Floats
    rise: float


def change_of_V(law: Any, seed: int) -> Change:
    """What becomes of V at a random state and side."""
    proof = certify(PAPER_PLANT.linear, L[:, None], np.array([GAMMA]))
    assert proof.certified
    P = proof.P / float(np.ravel(proof.W)[0])
    state, x, side = random_state(np.random.default_rng(seed), gained=False)
    after, estimate, x_rate = rates(law, L, state, x, side)
    x_error, d_error = x - state[0], TRUTH - np.concatenate(state[1:3])
    d_rate = np.concatenate([after.right, after.left])
    rise = 2 * x_error @ P @ x_rate - 2 / GAMMA * d_error @ d_rate
    return Change(P, x_error, d_error, estimate.innovation, float(rise))


def inequality(P: Floats) -> Floats:
    """M of V' <= [x~; e]'M [x~; e] under the gradient law."""
    A, C = PAPER_PLANT.linear.A, PAPER_PLANT.linear.C
    return np.block([[A.T @ P + P @ A, C.T - P @ L[:, None]], [C - L[None, :] @ P, -2 * np.eye(1)]])


@given(seeds, st.floats(0.0, 5.0))
def test_normalising_keeps_the_certificate(seed: int, weight: float) -> None:
    """V of the gradient law falls for every state and side."""
    of_V = change_of_V(Normalised(weight=weight), seed)
    assert of_V.rise <= 1e-9 * (1 + of_V.x_error @ of_V.P @ of_V.x_error)


def bounded_real(model: System, gain: Floats, bound: float) -> Floats:
    """P with [[A'P A - P + C'C, -A'P L], [., L'P L - bound]] < 0.

    It comes from iterating the Riccati equation with a little added to C'C.
    """
    A, C = model.linear.A, model.linear.C
    P = constant = C.T @ C + 1e-4 * np.eye(2)
    for _ in range(20_000):
        P = (
            A.T @ P @ A
            + constant
            + A.T
            @ P
            @ gain
            @ np.linalg.solve(bound * np.eye(1) - gain.T @ P @ gain, gain.T @ P @ A)
        )
    whole = np.block(
        [[A.T @ P @ A - P + C.T @ C, -A.T @ P @ gain], [-gain.T @ P @ A, gain.T @ P @ gain - bound]]
    )
    assert np.linalg.eigvalsh(whole)[-1] < 0
    return P


@functools.cache
def p_least_squares() -> Floats:
    """P of least squares with a small gain."""
    return bounded_real(SAMPLED, SMALL[:, None] * TS, 1 - GAMMA * TS)


@given(seeds, st.floats(0.0, 2.0), st.floats(0.0, 0.9), st.booleans())
def test_least_squares_with_a_small_gain_has_a_certificate_of_its_own(
    seed: int, forgetting: float, reset: float, silence: bool
) -> None:
    """V = x~'P x~ + sum d~^2 / g does not rise in a sample.

    That holds whatever the state, the side, what is forgotten and reset.
    """
    rng = np.random.default_rng(seed)
    law = LeastSquares(forgetting=forgetting, reset=reset)
    observer = Certified(
        L=SMALL, gamma=GAMMA, width_max=5.0, adaptation=law, silence=silence
    ).build(SAMPLED, ZONE)
    (x_hat, right, left, g, h), x, side = random_state(rng, gained=True)
    g, h = (GAMMA * TS * np.maximum(gain, reset) for gain in (g, h))
    after, _ = OnNumbers(observer, SAMPLED)((x_hat, right, left, g, h), [0.0], reading(x), [side])

    def V(x_error: Floats, d: Floats, gains: Floats) -> float:
        return float(x_error @ p_least_squares() @ x_error + ((TRUTH - d) ** 2 / gains).sum())

    before = V(x - x_hat, np.concatenate([right, left]), np.concatenate([g, h]))
    later = V(
        SAMPLED.linear.A @ x - after.x,
        np.concatenate([after.right, after.left]),
        np.concatenate([after.right_gain, after.left_gain]),
    )
    assert later <= before * (1 + 1e-9)


@given(seeds, st.floats(0.01, 1.0))
def test_a_leak_bounds_V_without_projection(seed: int, leak: float) -> None:
    """V' <= [x~; e]'M [x~; e] - leak |d~|^2 + leak |d - d^(0)|^2, W = 1."""
    P, x_error, d_error, innovation, rise = change_of_V(Sigma(leak=leak), seed)
    both = np.concatenate([x_error, innovation])
    bound = both @ inequality(P) @ both - leak * d_error @ d_error + leak * TRUTH @ TRUTH
    assert rise <= bound + 1e-9 * (1 + both @ both)


@functools.cache
def small_leak() -> float:
    """A leak by the error with M + leak D diag(C'C, 3) < 0."""
    C, M = PAPER_PLANT.linear.C, inequality(change_of_V(Sigma(leak=0.1), 0).P)
    spread = TRUTH.max() * np.block(
        [[C.T @ C, np.zeros((2, 1))], [np.zeros((1, 2)), 3 * np.eye(1)]]
    )
    return next(
        leak for leak in 0.9 ** np.arange(200) if np.linalg.eigvalsh(M + leak * spread)[-1] < 0
    )


@given(seeds)
def test_a_small_enough_leak_by_the_error_keeps_V(seed: int) -> None:
    """If |d - d^(0)| <= D, V falls for every state and side."""
    of_V = change_of_V(EModification(leak=small_leak()), seed)
    assert of_V.rise <= 1e-9 * (1 + of_V.x_error @ of_V.x_error)


# --- In the loop


def run(adaptation: dict[str, Any], **observer: Any) -> Any:
    options = {
        "method": "certified",
        "L": [1.0, 1.5],
        "gamma": 10.0,
        "width_max": 3.0,
        "widths0": [0.2, 0.2],
        "adaptation": adaptation,
    } | observer
    return simulate(
        scene(observer=options, simulation={"duration": 20.0, "step": 2e-3}), check_step=False
    )


@pytest.mark.parametrize(
    "adaptation",
    [
        {"method": "gradient"},
        {"method": "normalised", "weight": 0.1},
        {"method": "least_squares", "forgetting": 1.0},
        {"method": "least_squares", "reset": 0.3},
        {"method": "e_modification", "leak": 0.05},
    ],
)
def test_widths_of_the_papers_example_are_found(adaptation: dict[str, Any]) -> None:
    outcome = run(adaptation)
    assert outcome.d_hat[-1] == pytest.approx([1.0, 1.0], abs=0.02)
    assert outcome.rms_estimation < 0.02
    assert outcome.info.certified is (True if adaptation["method"] == "gradient" else None)


def test_least_squares_alone_grows_deaf() -> None:
    """Its gain falls as 1 / t: slower in the end than with forgetting."""
    deaf, awake = (
        run({"method": "least_squares"}),
        run({"method": "least_squares", "forgetting": 1.0}),
    )
    assert np.abs(deaf.d_hat[-1] - 1.0).max() > 3 * np.abs(awake.d_hat[-1] - 1.0).max()


def test_a_leak_leaves_the_bias_that_theory_predicts() -> None:
    """With x^ = x: d~ rests near leak / (a + leak) of d - d^(0).

    a is the share of time that an edge is active.
    """
    leak, gamma = 0.2, 0.5
    outcome = simulate(
        scene(
            """
            plant = { A = [[0.0, 1.0], [-1.0, -2.0]], B = [[0.0], [1.0]], C = [[1.0, 0.0]] }
            simulation = { duration = 60.0, step = 0.005 }
            """,
            observer={
                "method": "certified",
                "L": [0.0, 0.0],
                "gamma": gamma,
                "widths0": 0.2,
                "adaptation": {"method": "sigma", "leak": leak},
            },
        ),
        check_step=False,
    )
    last = outcome.t > 50.0
    share = (outcome.side[last, 0] > 0).mean()
    assert (1.0 - outcome.d_hat[last, 0]).mean() == pytest.approx(
        leak / (share + leak) * 0.8, rel=0.02
    )


def test_a_leak_by_the_error_leaves_the_truth_alone_and_sigma_does_not() -> None:
    exact = {"widths0": [1.0, 1.0], "L": [0.0, 0.0]}
    plant = tables_of("""
        A = [[0.0, 1.0], [-1.0, -2.0]]
        B = [[0.0], [1.0]]
        C = [[1.0, 0.0]]
        """)
    truth, started = {}, {}
    for method in ("sigma", "e_modification"):
        options = {
            "method": "certified",
            "gamma": 10.0,
            "adaptation": {"method": method, "leak": 0.1},
        }
        truth[method] = simulate(scene(plant=plant, observer=options | exact), check_step=False)
        started[method] = simulate(
            scene(
                plant=plant,
                observer=options | exact | {"widths0": [0.2, 0.2]},
                simulation={"duration": 10.0},
            ),
            check_step=False,
        )
    assert truth["e_modification"].d_hat == pytest.approx(1.0, abs=1e-9)
    assert started["e_modification"].d_hat[-1] == pytest.approx([1.0, 1.0], abs=1e-3)
    assert np.abs(started["sigma"].d_hat[-1] - 1.0).min() > 0.05


# --- Wrong input


def test_a_bound_of_widths_must_be_positive_for_each_output() -> None:
    with pytest.raises(InputError, match="must be positive, found -1"):
        read_initial_widths(0.0, [3.0, -1.0], 2)


@pytest.mark.parametrize(
    ("y", "side", "right", "left"), [(0.8, 1, -0.2, 0), (-0.3, -1, 0, -0.2), (1.4, 1, 0, 0)]
)
def test_a_jump_sensor_moves_the_edge_that_its_reading_contradicts(
    y: float, side: int, right: float, left: float
) -> None:
    edges: Any = SimpleNamespace(right=1.0, left=0.5)
    found = correct_jump(edges, 0.1, y, side, ca.SX(0.0), ca.SX(0.0))
    moved = [found.e, found.right.drive, found.left.drive]
    assert [float(one) for one in moved] == pytest.approx([y - 0.1, right, left])
    adapted = [found.right.adapted, found.left.adapted]
    assert [bool(ca.DM(one)) for one in adapted] == [right != 0, left != 0]


def test_a_leak_grows_with_the_way_from_the_first_width() -> None:
    edge: Any = SimpleNamespace(drive=2.0, width=3.0, width0=1.0, gamma=4.0)
    assert float(e_modification_move(0.25, edge)[0]) == 4 * (2 - 0.25 * 2 * (3 - 1))


def test_a_jump_sensor_adapts_no_width_of_any_output() -> None:
    model: Any = SimpleNamespace(p=2)
    sensor: Any = SimpleNamespace(kind="jump")
    with pytest.raises(InputError, match="Leave gamma out"):
        read_adapted_widths([1.0, 0.0], 0.0, None, model, sensor)


def test_least_squares_are_never_reset_by_default() -> None:
    assert LeastSquares().reset == 0.0
