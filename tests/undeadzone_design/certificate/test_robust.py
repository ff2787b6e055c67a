"""Every extension of the certificate holds in simulation.

Where a number is claimed to be the least, it is nearly reached.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from benchmarks.design.random_designs import random_design, random_matrices
from scipy.linalg import expm
from scipy.optimize import minimize_scalar

from certificates import project, sector
from scenes import PAPER_PLANT, scene, tables_of
from undeadzone.analysis.certificate.passivity import certify, certify_dynamics, passive_gain
from undeadzone.analysis.error_dynamics import (
    Dynamics,
    adaptation_matrix,
    branch_pattern,
    build_error_dynamics,
)
from undeadzone.errors import InputError, ShapeError
from undeadzone.linalg.hold import zoh
from undeadzone.linalg.matrices import Matrices
from undeadzone.numerics.semidefinite import minimise_semidefinite
from undeadzone.simulation.simulate import simulate
from undeadzone.util.arrays import Floats
from undeadzone_design.certificate.driven import add_leakage, ultimate_bound
from undeadzone_design.certificate.robust import certified_radius, closed_loop, l2_gain
from undeadzone_design.convergence.falsify import SwitchMode, error_generator, falsify

PAPER = PAPER_PLANT.linear
B, C = PAPER.B, PAPER.C
L = np.array([[1.0], [1.5]])
SIDES = (1, 0, -1)


def paper(Ts: float | None = None, gains: Floats = L, gamma: Any = 10.0) -> Dynamics:
    return build_error_dynamics(
        PAPER if Ts is None else zoh(PAPER, Ts), gains, np.asarray(gamma), Ts
    )


def entry(Ts: float | None) -> Floats:
    """Where an input disturbance enters: B, or Bd / Ts."""
    return B if Ts is None else zoh(PAPER, Ts).B / Ts


def switched(
    errors: Dynamics,
    sides: Any,
    steps: int,
    h: float,
    E: Floats,
    w: Floats,
    noise: Floats,
    v: Floats,
    start: Floats,
    leak: float = 0.0,
    d0: Any = 0.0,
    limit: Any = None,
) -> Floats:
    """[x~; d~] (steps + 1 rows) along sides (steps x p), w (steps x q) and v (steps x p).

    They are held for each step. Continuous time is solved exactly over each h; leak:
    d~' = ... + leak Gamma (d0 - d~), d0 = d - d^0; limit: |d~| is clipped to it after each step.
    """
    n, p = errors.L.shape
    patterns, which = np.unique(np.asarray(sides)[:steps], axis=0, return_inverse=True)
    maps = [step_map(errors, one, h, E, noise, leak) for one in patterns]
    moves, drives = (np.stack(each) for each in zip(*maps, strict=True))
    given = np.hstack([w[:steps], v[:steps], np.broadcast_to(d0, (steps, 2 * p))])
    which = which.ravel()
    driven = np.einsum("kij,kj->ki", drives[which], given)
    path = np.empty((steps + 1, n + 2 * p))
    path[0] = start
    for k, move in enumerate(which):
        after = moves[move] @ path[k] + driven[k]
        if limit is not None:
            after[n:] = np.clip(after[n:], -limit, limit)
        path[k + 1] = after
    return path


def step_map(
    errors: Dynamics, sides: Floats, h: float, E: Floats, noise: Floats, leak: float
) -> tuple[Floats, Floats]:
    """What a step on certain sides makes of [x~; d~], and of [w; v; d0] held over it."""
    n, p = errors.L.shape
    S = branch_pattern(tuple(sides.astype(int)))
    active = np.diag(np.abs(sides))
    F = error_generator(errors, SwitchMode(np.ones(1), S, np.ones(p), h))
    F[n:, n:] -= leak * errors.gamma
    to_states = np.hstack([E, -errors.L @ active * noise, np.zeros((n, 2 * p))])
    of_w = np.zeros((2 * p, E.shape[1]))
    to_widths = np.hstack([of_w, errors.gamma @ S.T * noise, leak * errors.gamma])
    inputs = np.vstack([to_states, to_widths])
    if errors.Ts is not None:
        return np.eye(len(F)) + errors.Ts * F, errors.Ts * inputs
    size = len(F)
    still = np.zeros((inputs.shape[1], size + inputs.shape[1]))
    both = expm(h * np.block([[F, inputs], [still]]))
    return both[:size, :size], both[:size, size:]


def draw_levels(rng: np.random.Generator, choices: Any, steps: int, hold: int) -> Floats:
    """A random sequence of rows, each held for about `hold` steps."""
    choices = np.asarray(choices, float)
    picks = rng.integers(len(choices), size=steps)
    times = rng.integers(1, 2 * hold, size=steps)
    return choices[np.repeat(picks, times)[:steps]]


@pytest.mark.parametrize("Ts", [None, 0.01, 0.2])
@pytest.mark.parametrize("gains", [(1.0, 1.5), (2.0, 3.0), (-0.5, 0.4)])
def test_disturbance_and_noise_gains_hold(gains: tuple[float, float], Ts: float | None) -> None:
    """int |z|^2 <= V(0) + a^2 int |w|^2 + b^2 int |v|^2 for random sides, w, v.

    The worst w is a slow one on the silent side.
    """
    errors = paper(Ts, np.array(gains)[:, None], 2.0)
    E = entry(Ts)
    both = l2_gain(errors, E, np.array([0.3]))
    only_w = l2_gain(errors, E)
    only_v = l2_gain(errors, noise=np.array([0.3]))
    assert both.check.proved
    assert only_w.check.proved
    assert only_v.check.proved
    assert only_w.disturbance <= both.disturbance * (1 + 1e-6)
    assert only_v.noise <= both.noise * (1 + 1e-6)
    assert only_w.disturbance >= 1 - 1e-6  # the silent side is the plant, whose gain at 0 is 1
    rng = np.random.default_rng(0)
    h = Ts or 0.02
    for trial in range(6):
        steps = 3000
        sides = draw_levels(rng, [[s] for s in SIDES], steps, 1 + 10**trial % 997)
        w = draw_levels(rng, rng.normal(size=(5, 1)), steps, 1 + 7**trial % 211)
        v = (
            rng.normal(size=(steps, 1))
            if trial % 2
            else draw_levels(rng, [[1.0], [-1.0]], steps, 50)
        )
        start = rng.normal(size=4) * (trial % 3)
        for found, dist, noise in ((both, w, v), (only_w, w, 0 * v), (only_v, 0 * w, v)):
            path = switched(errors, sides, steps, h, E, dist, np.array([0.3]), noise, start)
            z2 = (path[:-1, 0] ** 2).sum() * h
            supply = found.V.evaluate_storage(start[None, :2], start[None, 2:])[0] + h * (
                found.disturbance**2 * (dist**2).sum() + found.noise**2 * (noise**2).sum()
            )
            assert z2 <= supply * (1 + (0.03 if Ts is None else 1e-9))


def test_the_disturbance_gain_is_reached() -> None:
    """(1, 1.5): the gain is 1; a constant force while the sensor is silent comes within 1 %."""
    errors = paper()
    found = l2_gain(errors, B)
    assert found.disturbance == pytest.approx(1.0, abs=1e-5)
    steps, h = 20_000, 0.02
    path = switched(
        errors,
        np.zeros((steps, 1)),
        steps,
        h,
        B,
        np.ones((steps, 1)),
        np.zeros(1),
        np.zeros((steps, 1)),
        np.zeros(4),
    )
    assert (path[:-1, 0] ** 2).sum() >= 0.99 * steps


def test_gains_without_correction_are_those_of_the_plant() -> None:
    found = l2_gain(paper(gains=0 * L), B, np.array([1.0]))
    assert found.disturbance == pytest.approx(1.0, abs=1e-4)
    assert found.noise < 2e-3


def test_gains_of_an_uncertified_observer_are_infinite() -> None:
    found = l2_gain(paper(gains=np.array([[12.0], [15.0]])), B)
    assert found.disturbance == np.inf
    assert not found.check.proved
    assert certified_radius(paper(gains=np.array([[12.0], [15.0]])), B, C) == 0
    assert ultimate_bound(paper(gains=np.array([[12.0], [15.0]])), 0.5, B).bound == np.inf


def test_gains_do_not_depend_on_units() -> None:
    errors, x, y = paper(), np.array([1e4, 1e-3]), 100.0
    other = build_error_dynamics(
        Matrices(PAPER.A * x / x[:, None], B / x[:, None], C * x / y),
        L * y / x[:, None],
        np.array([10.0]),
        None,
    )
    one = l2_gain(errors, B, np.array([0.3]))
    two = l2_gain(other, B / x[:, None], np.array([0.3 / y]))
    assert np.array(two[:2]) * y == pytest.approx(np.array(one[:2]), rel=1e-4)
    a = ultimate_bound(errors, 0.5, B, np.array([0.1]))
    b = ultimate_bound(other, np.full(2, 0.5 / y), B / x[:, None], np.array([0.1 / y]))
    assert b.bound * y == pytest.approx(a.bound, rel=1e-3)


@pytest.mark.parametrize("Ts", [None, 0.05])
@pytest.mark.parametrize("sigma", [0.0, 0.02, 0.2])
def test_ultimate_bound_holds_with_projection_and_with_leakage(
    sigma: float, Ts: float | None
) -> None:
    """|w| <= 1, |v| <= 0.1: the error ends below the bound, and V below its level."""
    errors = paper(Ts, gamma=[[5.0, 2.0]])
    E, noise, widths = entry(Ts), np.array([0.1]), np.array([0.4, 0.7])
    found = ultimate_bound(errors, widths, E, noise, sigma)
    assert found.check.proved
    assert 1.0 <= found.bound < 3.0  # the silent plant under a constant force alone ends at 1
    rng = np.random.default_rng(1)
    h = Ts or 0.05
    for trial in range(8):
        steps = 3000
        sides = draw_levels(rng, [[s] for s in SIDES], steps, 1 + 5**trial % 97)
        w = (
            draw_levels(rng, [[-1.0], [1.0]], steps, 1 + 3**trial % 157)
            if trial
            else np.ones((steps, 1))
        )
        v = draw_levels(rng, [[-1.0], [1.0]], steps, 10)
        start = np.concatenate([5 * rng.normal(size=2), widths * rng.choice([-1, 1], 2)])
        d0 = widths * rng.choice([-1, 1], 2)
        limit = widths if sigma == 0 else None
        path = switched(errors, sides, steps, h, E, w, noise, v, start, sigma, d0, limit)
        tail = path[-1500:]
        assert np.abs(tail[:, 0]).max() <= found.bound
        assert found.V.evaluate_storage(tail[:, :2], tail[:, 2:]).max() <= found.level


def test_leakage_alone_keeps_the_widths_as_good_as_their_first_guess() -> None:
    """Without disturbance, V ends below its value at x~ = 0, d~ = d - d0.

    For that x~ must be able to follow as fast as the leak.
    """
    errors = paper(gamma=1.0)
    found = ultimate_bound(errors, np.array([0.5, 0.5]), sigma=0.1)
    level = found.V.evaluate_storage(np.zeros((1, 2)), np.full((1, 2), 0.5))[0]
    assert found.check.proved
    assert found.level == pytest.approx(level, rel=0.1)


@pytest.mark.parametrize("Ts", [None, 0.1])
@pytest.mark.parametrize(
    "A",
    [
        [[0.0]],
        [[0.5]],
        [[0.0, 1.0], [-1.0, 0.0]],
        [[0.0, 1.0], [0.0, 0.0]],
        [[0.0, 0.0], [0.0, 0.0]],
    ],
)
@pytest.mark.parametrize("sigma", [0.0, 0.1])
def test_bounds_of_models_that_are_not_stable_are_infinite(
    A: list[list[float]], Ts: float | None, sigma: float
) -> None:
    n = len(A)
    flow = Matrices(np.array(A), np.ones((n, 1)), np.eye(1, n))
    model = flow if Ts is None else zoh(flow, Ts)
    errors = build_error_dynamics(model, np.ones((n, 1)), np.ones(1), Ts)
    bound = ultimate_bound(errors, 0.5, model.B, np.ones(1), sigma)
    assert (bound.bound, bound.level, bound.check.proved) == (np.inf, np.inf, False)
    gain = l2_gain(errors, model.B, np.ones(1))
    assert (gain.disturbance, gain.noise, gain.check.proved) == (np.inf, np.inf, False)
    assert not certify_dynamics(errors).certified


def test_an_unproved_bound_returns_the_storage_of_its_own_gamma() -> None:
    """The LMI of sampled leakage works with a larger Gamma; V is that of the dynamics."""
    errors = paper(0.05, np.array([[120.0], [150.0]]))
    bound = ultimate_bound(errors, 0.5, entry(0.05), sigma=0.2)
    assert bound.bound == np.inf
    assert (bound.V.gamma == errors.gamma).all()


@pytest.mark.parametrize("sigma", [-1.0, np.inf, np.nan])
def test_leakage_without_sense_is_refused(sigma: float) -> None:
    with pytest.raises(InputError, match="sigma: expected a number that is not negative"):
        ultimate_bound(paper(), 0.5, B, sigma=sigma)


def test_leakage_is_refused_where_it_is_not_covered() -> None:
    with pytest.raises(
        InputError, match="sigma: leakage is covered for a diagonal positive Gamma only"
    ):
        ultimate_bound(paper(gamma=np.array([[2.0, 1.0], [1.0, 2.0]])), 0.5, sigma=0.1)
    with pytest.raises(InputError, match="sigma: Ts sigma gamma must be below 1, found 2"):
        ultimate_bound(paper(0.1, gamma=10.0), 0.5, sigma=2.0)
    with pytest.raises(ShapeError, match=r"E: expected a matrix with 2 rows"):
        l2_gain(paper(), np.ones((3, 1)))


@pytest.mark.parametrize("Ts", [None, 0.02])
def test_v_falls_for_every_perturbation_within_the_certified_radius(Ts: float | None) -> None:
    """x~' = (A + E Delta F) x~, |Delta| <= r: V falls just below r, and can rise at 5 r."""
    rng = np.random.default_rng(3)
    linear = random_matrices(rng, 3, 1) if Ts is None else zoh(random_matrices(rng, 3, 1), Ts)
    errors = build_error_dynamics(linear, passive_gain(linear, Ts), np.ones(1), Ts)
    E, F = rng.normal(size=(3, 2)), rng.normal(size=(2, 3))
    radius = certified_radius(errors, E, F)
    assert radius > 0
    V = l2_gain(errors, E, output=F).V
    turns = [np.linalg.qr(rng.normal(size=(2, 2)))[0] for _ in range(12)]

    def perturbed(size: float) -> Dynamics:
        return errors._replace(A=tuple(errors.A[0] + size * E @ Delta @ F for Delta in turns))

    assert not falsify(perturbed(0.999 * radius), V, 5000, seed=1).broken
    assert falsify(perturbed(5 * radius), V, 5000, seed=1).broken


@pytest.mark.parametrize("Ts", [None, 0.05])
def test_norm_bounded_plants_in_the_closed_loop(Ts: float | None) -> None:
    """A + E Delta F_A, B + E Delta F_B, |Delta| just below the certified radius.

    V of (x - x_ref, x~, d~) falls.
    """
    model = PAPER if Ts is None else zoh(PAPER, Ts)
    K, E = np.array([[1.0, 1.0]]), np.array([[0.0], [1.0]])
    F_A, F_B = np.array([[1.0, 2.0]]), np.array([[1.0]])
    nominal = closed_loop(model, [model], L, K, np.array([5.0]), Ts)
    F = np.hstack([F_A - F_B @ K, F_B @ K])
    radius = certified_radius(nominal, np.vstack([E, E]), F)
    assert 0.1 < radius < 1
    step = 1.0 if Ts is None else Ts
    plants = []
    for size in (-0.999 * step * radius, 0.999 * step * radius):
        plants.append(Matrices(model.A + size * E @ F_A, model.B + size * E @ F_B, C))
    V = l2_gain(nominal, np.vstack([E, E]), output=F).V
    assert not falsify(closed_loop(model, plants, L, K, np.array([5.0]), Ts), V, 5000).broken


@pytest.mark.parametrize("Ts", [None, 0.05])
def test_known_nonlinear_plant(Ts: float | None) -> None:
    """x'' = -x' - phi(x), slopes of phi in [0.2, 1]: one V falls; for [-0.1, 1] there is none.

    No linear part alone is stable. Sampled: the plant is x+ = x + Ts (...) itself.
    """
    linear = Matrices(np.array([[0.0, 1.0], [0.0, -1.0]]), B, C)
    errors = build_error_dynamics(linear, np.array([[0.5], [0.5]]), np.array([1.0]), None)._replace(
        Ts=Ts
    )
    found = sector(errors, -B, C, np.array([0.2]), np.array([1.0]))
    assert found.certified
    ends = errors._replace(A=tuple(linear.A - slope * B @ C for slope in (0.2, 1.0)))
    assert not falsify(ends, found.V, 5000).broken
    # Jacobian vertices: the same here, phi being one component.
    assert certify_dynamics(ends).certified
    assert not sector(errors, -B, C, np.array([-0.1]), np.array([1.0])).certified
    with pytest.raises(InputError, match="low: must not exceed high"):
        sector(errors, -B, C, np.array([1.0]), np.array([0.0]))


def test_sector_is_sharper_than_a_lipschitz_bound() -> None:
    errors = paper(gamma=1.0)
    assert certified_radius(errors, B, C) == pytest.approx(1.0, abs=1e-4)
    assert sector(errors, B, C, np.array([-3.0]), np.array([0.0])).certified
    assert sector(errors, B, C, np.array([-0.99]), np.array([0.99])).certified
    assert not sector(errors, B, C, np.array([-1.01]), np.array([1.01])).certified


def test_v_falls_along_a_nonlinear_closed_loop() -> None:
    """The real loop with a hardening spring, slopes in [1, 1 + 0.9]: V of the sector falls."""
    plant = tables_of("""
        f = ["x2", "-2 * x2 - x1 - 0.9 * tanh(x1) + u"]
        h = ["x1"]
        states = ["x1", "x2"]
        x0 = [3.0, -2.0]
        """)
    run = simulate(
        scene(
            """
            observer.method = "certified"
            observer.L = [1.0, 1.5]
            observer.gamma = 5.0
            observer.widths0 = [0.2, 0.3]
            observer.width_max = 3.0
            controller = { method = "state_feedback", poles = [-2.0, -3.0] }
            simulation = { duration = 6.0 }
            """,
            plant=plant,
        )
    )
    errors = paper(gamma=5.0)
    found = sector(errors, -B, C, np.array([0.0]), np.array([0.9]))
    assert found.certified
    V = found.V.evaluate_storage(run.x - run.x_hat, np.array([1.0, 1.0]) - run.d_hat)
    assert V[-1] < 0.05 * V[0]
    assert np.diff(V).max() <= 1e-9 * V[0]


@pytest.mark.parametrize("Ts", [None, 0.01])
def test_uncertain_plant_in_the_closed_loop(Ts: float | None) -> None:
    """Stiffness, damping and gain within 20 %: one V over (x - x_ref, x~, d~).

    No sequence of plants and sides makes it rise.
    """
    model = PAPER if Ts is None else zoh(PAPER, Ts)
    K = np.array([[1.0, 1.0]])

    def corners(spread: float) -> list[Matrices]:
        plants = []
        for a, b, c in itertools.product((-1, 1), repeat=3):
            A = np.array([[0, 1], [-(1 + a * spread), -2 * (1 + b * spread)]])
            plants.append(Matrices(A, B * (1 + c * spread), C))
        return plants if Ts is None else [zoh(plant, Ts) for plant in plants]

    found = certify_dynamics(closed_loop(model, corners(0.2), L, K, np.array([5.0]), Ts))
    assert found.certified
    assert not falsify(found.dynamics, found.V, 10_000).broken
    assert not certify_dynamics(
        closed_loop(model, corners(0.9), L, K, np.array([5.0]), Ts)
    ).certified
    alone = certify_dynamics(closed_loop(model, [model], L, K, np.array([5.0]), Ts))
    assert alone.certified
    assert alone.margin <= certify(model, L, np.array([5.0]), Ts).margin + 1e-6


def test_v_falls_along_a_mismatched_closed_loop() -> None:
    """The real loop, its plant a corner of the certified box, released with nothing to follow."""
    corner = [[0.0, 1.0], [-1.2, -1.6]]
    run = simulate(
        scene(
            """
            reference = { kind = "sine", amplitude = 0.0, frequency = 1.0 }
            observer.method = "certified"
            observer.L = [1.0, 1.5]
            observer.gamma = 5.0
            observer.widths0 = [0.2, 0.2]
            observer.width_max = 3.0
            controller = { method = "state_feedback", K = [[1.0, 1.0]] }
            simulation = { duration = 5.0 }
            """,
            plant={"A": corner, "B": [[0.0], [1.2]], "C": [[1.0, 0.0]], "x0": [5.0, -3.0]},
            model={"A": PAPER.A.tolist(), "B": B.tolist()},
        )
    )
    plants = []
    for a, b, c in itertools.product((-0.2, 0.2), (-0.4, 0.4), (-0.2, 0.2)):
        plants.append(Matrices(np.array([[0, 1], [-1 - a, -2 - b]]), B * (1 + c), C))
    found = certify_dynamics(closed_loop(PAPER, plants, L, np.array([[1.0, 1.0]]), np.array([5.0])))
    assert found.certified
    V = found.V.evaluate_storage(
        np.hstack([run.x, run.x - run.x_hat]), np.array([1.0, 1.0]) - run.d_hat
    )
    assert np.diff(V).max() <= 1e-9 * V[0]
    assert V[-1] < 0.1 * V[0]


def test_projection_in_the_metric_of_v_never_raises_it() -> None:
    """For a full Gamma, clipping each width by itself can raise V; projection cannot."""
    linear = random_matrices(np.random.default_rng(0), 3, 1)
    found = certify(linear, passive_gain(linear, None), np.array([[1.0, 0.9], [0.9, 1.0]]))
    assert found.certified
    rng = np.random.default_rng(0)
    limit, clipped = np.array([1.0, 1.0]), 0
    for _ in range(200):
        d, d_hat = rng.uniform(0, 1, 2), rng.normal(0.5, 1.0, 2)
        nearest = project(d_hat, found.V, limit)
        points = d_hat, nearest, np.clip(d_hat, 0, limit)
        before, after, naive = found.V.evaluate_storage(np.zeros((3, 3)), d - np.array(points))
        assert ((nearest >= 0) & (nearest <= limit)).all()
        assert after <= before * (1 + 1e-9)
        clipped += naive > before * (1 + 1e-9)
    assert clipped > 0
    diagonal = certify(linear, passive_gain(linear, None), np.array([[1.0, 5.0]])).V
    assert project(np.array([1.5, -0.2]), diagonal, limit) == pytest.approx([1.0, 0.0], abs=1e-9)


@pytest.mark.parametrize("threshold", [0.0, 0.5, 2.0])
def test_any_silence_threshold_is_certified(threshold: float) -> None:
    """|y| <= threshold counts as silence: V still never rises, in the real loop."""
    run = simulate(
        scene(
            sensor={"right": 1.0, "left": 0.7, "threshold": threshold}, simulation={"duration": 3.0}
        )
    )
    assert run.info.certified
    assert run.largest_rise_of_V is not None
    assert run.largest_rise_of_V < 1e-9
    assert run.V is not None
    assert run.V[-1] < run.V[0]


def test_noise_below_the_threshold_obeys_the_noise_gain() -> None:
    """Bounded noise, |v| <= threshold: no false side in the real loop.

    So int |z~|^2 <= V(0) + b^2 int |v|^2.
    """
    Ts, noise = 0.01, 0.02
    run = simulate(
        scene(
            sensor={"noise": noise, "threshold": 6 * noise},
            simulation={"time": "sampled", "step": Ts, "duration": 40.0},
        )
    )
    found = l2_gain(paper(Ts), noise=np.array([1.0]))
    v = run.y - np.where(run.z > 1, run.z - 1, np.where(run.z < -1, run.z + 1, 0.0))
    assert np.abs(v).max() < 6 * noise
    V0 = found.V.evaluate_storage((run.x - run.x_hat)[:1], np.array([1.0, 1.0]) - run.d_hat[:1])[0]
    assert Ts * ((run.z - run.z_hat) ** 2).sum() <= V0 + found.noise**2 * Ts * (v**2).sum()


@pytest.mark.parametrize("seed", range(6))
def test_gamma_of_any_kind_is_not_broken(seed: int) -> None:
    rng = np.random.default_rng(seed)
    linear, gains, gamma, Ts = random_design(rng, 3, 1 + seed % 2)
    found = certify(linear, gains, gamma, Ts)
    assert found.certified
    assert not falsify(found.dynamics, found.V, 5000, seed=seed).broken


def frequencies(errors: Dynamics) -> Floats:
    """Frequencies [rad/s], dense about the poles, up to infinity or pi / Ts."""
    poles, Ts = np.linalg.eigvals(errors.A[0]), errors.Ts
    size = np.abs(poles)
    near = [np.abs(s.imag + np.abs(s.real) * np.linspace(-3, 3, 61)) for s in poles]
    wide = np.geomspace(size.min() / 1e3, size.max() * 1e4, 600)
    w = np.sort(np.concatenate([[0.0], wide, *near]))
    return np.append(w, 1e12) if Ts is None else np.append(w[w * Ts < np.pi], np.pi / Ts)


def responses(errors: Dynamics, E: Floats, w: Floats) -> tuple[np.ndarray, np.ndarray]:
    """C (s - A)^-1 L and C (s - A)^-1 E at frequencies, in delta form if sampled."""
    s = 1j * w if errors.Ts is None else np.expm1(1j * errors.Ts * w) / errors.Ts
    resolvent = errors.C @ np.linalg.inv(s[:, None, None] * np.eye(len(E)) - errors.A[0])
    return resolvent @ errors.L, resolvent @ E


def squared_gain(errors: Dynamics, E: Floats, noise: float, weight: float, w: Floats) -> Floats:
    """mu that a weight needs at each frequency, whatever P is (Kalman, Yakubovich, Popov).

    With a = weight (2 - Ts gamma) + 2 weight Re G - |G|^2 it is (weight noise)^2 / a for noise, and
    |H|^2 (a + |weight - conj G|^2) / a for w.
    """
    G, H = responses(errors, E, w)
    G, step = G[:, 0, 0], max(float(pattern[0, 0]) for pattern in errors.largest_gain_steps)
    a = weight * (2 - step) + 2 * weight * G.real - np.abs(G) ** 2
    if noise:
        above = np.full(a.shape, (weight * noise) ** 2)
    else:
        above = np.square(np.abs(H)).sum(axis=(1, 2)) * (a + np.abs(weight - G.conj()) ** 2)
    return np.where(a > 0, above / np.where(a > 0, a, 1.0), 1e200 * (1 - a))


def least_gain(errors: Dynamics, E: Floats, noise: float) -> float:
    """What no V = x~'P x~ + d~'R d~ can go below, one output, from w by E or else from v by noise.

    From below: only some frequencies count, and more of them around the worst.
    """
    w = frequencies(errors)
    for _ in range(3):

        def squared(log_weight: float, w: Floats = w) -> float:
            return float(np.log(squared_gain(errors, E, noise, np.exp(log_weight), w).max()))

        size = np.log(np.abs(responses(errors, E, w)[0]).max())
        grid = size + np.linspace(-12, 12, 33)
        values = [squared(log_weight) for log_weight in grid]
        k = int(np.argmin(values))
        span = (grid[max(k - 1, 0)], grid[min(k + 1, 32)])
        finer = minimize_scalar(squared, bounds=span, method="bounded", options={"xatol": 1e-9})
        worst = squared_gain(errors, E, noise, np.exp(finer.x), w).argsort()[-6:]
        ends = [w[np.maximum(worst - 1, 0)], w[np.minimum(worst + 1, w.size - 1)]]
        w = np.unique(np.concatenate([w, np.linspace(*ends, 40).ravel()]))
    return float(np.exp(min(finer.fun, values[k]) / 2))


@pytest.mark.parametrize("seed", range(2))
def test_l2_gains_are_least_within_one_percent(seed: int) -> None:
    """30 random designs, all seeds together: every second one has noise, the others w."""
    rng = np.random.default_rng(seed)
    for k in range(15):
        model, gains, gamma, Ts = random_design(rng, int(rng.integers(1, 5)), 1)
        errors = build_error_dynamics(model, gains, gamma, Ts)
        E = model.B if Ts is None else model.B / Ts
        size = float(10 ** rng.uniform(-2, 2))
        if k % 2:
            found = l2_gain(errors, noise=np.array([size]))
            reached, least = found.noise, least_gain(errors, E, size)
        else:
            found = l2_gain(errors, E)
            reached, least = found.disturbance, least_gain(errors, E, 0.0)
        assert found.check.proved
        assert least * (1 - 1e-6) <= reached <= 1.01 * least


@pytest.mark.parametrize(
    ("a", "c", "gain", "noise", "least"),
    [(-5.37, 0.383, 0.056, 4.57, 0.018180), (-0.2, 1.0, 0.5, 1.0, 0.79057)],
)
def test_noise_gains_that_were_too_large_or_missing(
    a: float, c: float, gain: float, noise: float, least: float
) -> None:
    """w^2 N^2 / (2 w (1 + Re G) - |G|^2), by hand: once 227 times too large, once none."""
    plant = Matrices(np.array([[a]]), np.ones((1, 1)), np.array([[c]]))
    errors = build_error_dynamics(plant, np.array([[gain]]), np.ones(1), None)
    found = l2_gain(errors, noise=np.array([noise]))
    assert found.check.proved
    assert least * 0.999 <= found.noise <= 1.01 * least


def supplies(errors: Dynamics, reading: Floats, unit: float, q: Floats, G: Any) -> np.ndarray:
    """The supply rate in (e, v) at frequencies, G = -C(s - A)^-1 L, by q = [weights, mu].

    (frequencies, patterns, 2p, 2p), Hermitian; unit: z in units of it.
    """
    p = len(reading)
    W = np.diag(errors.groups @ q[:-1])
    across = G.conj().transpose(0, 2, 1)
    of_e = (W @ G + across @ W + across @ G / unit**2 - 2 * W)[:, None]
    of_e = of_e + np.stack([(W @ step + step @ W) / 2 for step in errors.largest_gain_steps])
    phi = np.zeros((*of_e.shape[:2], 2 * p, 2 * p), complex)
    phi[..., :p, :p] = of_e
    phi[..., :p, p:] = phi[..., p:, :p] = W @ np.diag(reading)
    phi[..., p:, p:] = -q[-1] * np.eye(p)
    return phi


def least_gain_over_weights(errors: Dynamics, reading: Floats, unit: float) -> float:
    """The same for noise on several outputs: no P, the weights and mu of a semidefinite program.

    unit: about the gain, so that the solver's mu is about 1. Frequencies are added where violated.
    """
    size = 2 * len(reading)
    G = -responses(errors, errors.L, frequencies(errors))[0]
    chosen = np.arange(0, len(G), 40)
    for _ in range(6):

        def blocks(q: Floats, G: Any = G[chosen]) -> list[Floats]:
            phi = supplies(errors, reading, unit, q, G).reshape(-1, size, size)
            real = [np.block([[-M.real, M.imag], [-M.imag, -M.real]]) for M in phi]
            return [q - 1e-9, *real]

        q = minimise_semidefinite(np.append(np.zeros(errors.groups.shape[1]), 1.0), blocks)
        assert q is not None
        worst = np.linalg.eigvalsh(supplies(errors, reading, unit, q, G))[..., -1].max(axis=1)
        chosen = np.union1d(chosen, np.argsort(worst)[-6:])
    return float(np.sqrt(q[-1])) * unit


def test_l2_gains_of_two_outputs_are_least() -> None:
    """Where all side patterns have one inequality: of several, which share P, less is known."""
    rng = np.random.default_rng(3)
    for _ in range(12):
        model, gains, gamma, Ts = random_design(rng, 3, 2)
        errors, reading = build_error_dynamics(model, gains, gamma, Ts), np.exp(rng.normal(size=2))
        if len(errors.largest_gain_steps) > 1 or not certify_dynamics(errors).certified:
            continue
        found = l2_gain(errors, noise=reading)
        assert found.check.proved
        least = least_gain_over_weights(errors, reading, found.noise)
        assert least * (1 - 1e-4) <= found.noise <= 1.01 * least


def test_sampled_leakage_asks_for_a_larger_gamma() -> None:
    """d~+ = (1 - eps)(d~ + g / (1 - eps) S'e) + eps delta: the LMI is for g / (1 - eps)."""
    errors = paper(0.05, gamma=np.array([[4.0, 2.0]]))
    gamma = np.diag(add_leakage(errors, 0.5).gamma)
    assert gamma == pytest.approx([4.0 / (1 - 0.1), 2.0 / (1 - 0.05)])
    assert (add_leakage(paper(None), 0.5).gamma == paper(None).gamma).all()


def test_a_gain_to_three_times_the_output_is_three_times_the_gain() -> None:
    found = certify(PAPER_PLANT.linear, np.array([[1.0], [1.5]]), np.array([10.0]))
    C = PAPER_PLANT.linear.C
    one, three = (
        l2_gain(found.dynamics, np.array([[0.0], [1.0]]), np.ones(1), size * C) for size in (1, 3)
    )
    assert three.disturbance == pytest.approx(3 * one.disturbance, rel=0.01)
    assert three.noise == pytest.approx(3 * one.noise, rel=0.01)


def test_a_gain_that_is_not_requested_is_0() -> None:
    dynamics = certify(PAPER_PLANT.linear, np.array([[1.0], [1.5]]), np.array([10.0])).dynamics
    assert l2_gain(dynamics, noise=np.ones(1)).disturbance == 0.0
    assert l2_gain(dynamics, E=np.array([[0.0], [1.0]])).noise == 0.0


def test_no_edge_may_have_a_negative_gain() -> None:
    with pytest.raises(InputError, match="must not be negative, found -1"):
        adaptation_matrix([[-1.0, 2.0]], 1)
