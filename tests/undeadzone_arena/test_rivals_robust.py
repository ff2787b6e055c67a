"""Rivals that are robust by construction.

What each promises, where it coincides with another, and what a dead zone makes of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import casadi as ca
import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_engines import generated

from scenes import (
    PAPER_PLANT,
    OnNumbers,
    linear,
    random_plant,
    response,
    scene,
    seeds,
    slopes,
    tables_of,
)
from undeadzone.compile import interpret
from undeadzone.errors import InputError, StructureError
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Estimate, Observer, Reading
from undeadzone.linalg.matrices import companion_form
from undeadzone.linalg.poles import state_gain
from undeadzone.linalg.structure import output_chains
from undeadzone.nonlinearities.sensor import Sensor, Zone, deadzone, resolve, side
from undeadzone.nonlinearities.sensor import jump as jump_sensor
from undeadzone.numerics.runge_kutta import rk4
from undeadzone.observers import HighGain
from undeadzone.observers.full_state import FullState
from undeadzone.plants.build import system
from undeadzone.plants.options import Plant
from undeadzone.plants.system import System, sample_plant
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.simulate import outputs_of, prepare, simulate
from undeadzone.util import tree
from undeadzone.util.arrays import Floats
from undeadzone_arena import Interval, SlidingMode, SuperTwisting, WalcottZak
from undeadzone_arena.observers.parts import interval_step
from undeadzone_arena.observers.parts.boxes import Bounds, Boxes, cut_box
from undeadzone_arena.observers.parts.interval_step import coupling_mask
from undeadzone_arena.observers.parts.modal_form import build_modes, mode_rotation
from undeadzone_arena.observers.super_twisting import differentiator_gains
from undeadzone_arena.observers.walcott_zak import SlidingLaw, sliding_direction, sliding_term

POLES = [-20.0, -21.0]


def zone(p: int = 1, **options: Any) -> Zone:
    return resolve(Sensor(**{"right": 1.0, "left": 1.0} | options), p, 1e-3)


def stepper(
    observer: Observer, model: System
) -> tuple[Floats, Callable[..., tuple[Floats, Estimate]]]:
    """(the packed state at first, step on numbers).

    The step is (state, u, y, side) -> (next state or derivative, estimate).
    """
    run = OnNumbers(observer, model)

    def step(*values: Any) -> tuple[Floats, Estimate]:
        after, estimate = run(*values)
        return tree.pack_tree(after), estimate

    return tree.pack_tree(observer.init(observer.params)), step


# --- Interval observer


def outside(estimate: Estimate, x: Floats, right: Floats, left: Floats) -> float:
    """How far the truth lies beyond the nearest end of its interval, the worst of all.

    A negative number lies inside.
    """
    truth, middle = (
        np.concatenate(parts)
        for parts in ((x, right, left), (estimate.x, estimate.right, estimate.left))
    )
    half = np.sqrt(3) * np.concatenate([estimate.x_std, estimate.right_std, estimate.left_std])
    return float((np.abs(truth - middle) - half).max())


@settings(max_examples=25)
@given(
    seeds,
    st.integers(1, 4),
    st.integers(1, 2),
    st.booleans(),
    st.booleans(),
    st.sampled_from([0.0, 0.05]),
    st.sampled_from([0.0, 0.3]),
)
def test_interval_holds_the_truth_of_any_plant(
    seed: int, n: int, p: int, stable: bool, jump: bool, noise: float, disturbance: float
) -> None:
    """Unknown widths, bounded noise before and after the zone, the worst disturbance.

    Samples are missing, and unstable plants run in closed loop.
    """
    rng = np.random.default_rng(seed)
    p, Ts, m = min(n, p), 0.02, 1.7
    flow = random_plant(rng, n, 1, p, stable)
    model = sample_plant(flow, Ts)
    K = np.zeros((1, n)) if stable else state_gain(model.linear, -np.linspace(1, 2, n), Ts)
    right, left, x = rng.uniform(0.3, 2, p), rng.uniform(0.3, 2, p), rng.uniform(-3, 3, n)
    kind = "jump" if jump else "deadzone"
    where = zone(
        p, right=right, left=left, kind=kind, slope=m, noise=noise / 6, noise_before=noise / 12
    )
    given_L = {} if seed % 2 else {"poles": -np.linspace(2, 4, n)}
    built = Interval(right=[0.3, 2.0], disturbance=disturbance, x_max=3.0, **given_L).build(
        model, where
    )
    state, step = stepper(built, model)
    amplitude = 8 / max(np.abs(response(flow.linear, [3j])).max(), 1e-3)
    worst, size = -np.inf, 1.0
    for k in range(150):
        read = (jump_sensor if jump else deadzone)(
            model.linear.C @ x + rng.uniform(-noise, noise, p) / 2, right, left, m
        )
        y = read + rng.uniform(-noise, noise, p) if rng.uniform() < 0.9 else np.full(p, np.nan)
        u = amplitude * np.sin(3 * k * Ts) - K @ x
        state, estimate = step(state, u, y, side(y, where.threshold))
        size = max(size, float(np.abs(x).max()))
        worst = max(worst, outside(estimate, x, right, left))
        x = model.linear.A @ x + model.linear.B @ (u + rng.choice([-disturbance, disturbance]))
    assert worst <= 1e-9 * size


def bounded(time: str, **observer: Any) -> tuple[Any, Scenario]:
    """(outputs, scenario) of the paper's loop with a sinusoidal disturbance.

    Its noise is uniform within six rms.
    """
    tables: dict[str, Any] = {
        "sensor": {"right": 1.4, "left": 0.6, "noise": 0.005},
        "disturbance": {"kind": "sine", "amplitude": 0.2, "frequency": 0.4},
        "observer": {"method": "interval", "right": [0.3, 2.0], "disturbance": 0.2} | observer,
        "simulation": {"duration": 6.0, "step": 2e-3, "time": time},
    }
    scenario = scene(**tables)
    start = prepare(resolve_scenario(scenario))
    loop, exogenous = start.loop, start.exogenous
    instants = 3 if time == "continuous" else 1
    after = tree.number_addresses(loop.instant).index("after[0]") + np.arange(
        instants
    ) * tree.count_numbers(loop.instant)  # standard normal draws
    exogenous[:, after] = np.random.default_rng(0).uniform(-6, 6, (len(exogenous), 1))
    return outputs_of(start), scenario


@pytest.mark.parametrize("time", ["continuous", "sampled"])
def test_interval_holds_the_truth_in_closed_loop_and_learns(time: str) -> None:
    outputs, _ = bounded(time)
    estimate = outputs.estimate
    halves = [np.sqrt(3) * std for std in (estimate.x_std, estimate.right_std, estimate.left_std)]
    for truth, middle, half in zip(
        (outputs.x, 1.4, 0.6), (estimate.x, estimate.right, estimate.left), halves, strict=True
    ):
        assert (np.abs(truth - middle) <= half + 1e-6).all()
    assert halves[1][0] == pytest.approx(0.85)
    assert max(halves[1][-1], halves[2][-1]) < 0.6
    assert estimate.right[-1] == pytest.approx(1.4, abs=0.15)


@pytest.mark.parametrize("time", ["continuous", "sampled"])
def test_interval_without_disturbance_finds_the_widths(time: str) -> None:
    run = simulate(
        scene(
            """
            observer = { method = "interval", right = [0.3, 2.0] }
            sensor = { right = 1.4, left = 0.6 }
            """,
            simulation={"time": time, "duration": 12.0},
        )
    )
    assert run.widths == pytest.approx(np.array([[1.4, 0.6]]), abs=0.01)
    assert run.d_std is not None
    assert run.d_std[-1].max() * np.sqrt(3) < 0.03
    assert run.rms_tracking < 0.01


def test_interval_starts_anew_where_declared_bounds_contradict_each_other() -> None:
    model = sample_plant(PAPER_PLANT, 0.01)
    built = Interval(right=[0.3, 2.0], x_max=1.0).build(model, zone())
    state, step = stepper(built, model)
    for _ in range(500):
        state, known = step(state, 0.0, 0.0, 0.0)
    assert known.x_std.max() < 0.2
    _, fresh = step(state, 0.0, 50.0, 1.0)  # a rest state cannot read 50
    assert np.isfinite(np.concatenate(fresh)).all()
    assert fresh.right_std * np.sqrt(3) == pytest.approx([0.85])
    assert fresh.x_std.max() * np.sqrt(3) >= 1.0


def test_interval_is_as_wide_as_the_worst_disturbance_makes_it() -> None:
    """Of first order and unread, the bound is met: |x - x^| = w (1 - e^(-a t)) / a."""
    a, Ts, bound = 0.7, 0.1, 0.3
    model = sample_plant(linear([[-a]], [[1.0]], [[1.0]]), Ts)
    state, step = stepper(
        Interval(right=[0.3, 2.0], x_max=0.0, disturbance=bound).build(model, zone()), model
    )
    x = np.zeros(1)
    for k in range(50):
        state, estimate = step(state, 1.0, np.nan, 0.0)
        half = estimate.x_std[0] * np.sqrt(3)
        assert abs(x - estimate.x)[0] == pytest.approx(half, abs=1e-12)
        assert half == pytest.approx(bound * (1 - np.exp(-a * k * Ts)) / a, abs=1e-12)
        x = model.linear.A @ x + model.linear.B[:, 0] * (1.0 - bound)


@pytest.mark.parametrize("Ts", [None, 0.05])
def test_interval_of_an_oscillator_decays_as_it_does(Ts: float | None) -> None:
    """A box in fixed coordinates would grow: |a| - |w| < 0 here."""
    flow = linear([[0.0, 1.0], [-25.0, -0.4]], [[0.0], [1.0]], [[1.0, 0.0]])
    model = flow if Ts is None else sample_plant(flow, Ts)
    state, step = stepper(Interval(right=[0.3, 2.0], x_max=[0.2, 1.0]).build(model, zone()), model)
    h = 0.01 if Ts is None else Ts
    first = step(state, 0.0, np.nan, 0.0)[1].x_std
    for _ in range(round(10 / h)):
        if Ts is None:
            state = rk4(lambda s, c: step(s, 0.0, np.nan, 0.0)[0], state, h)
        else:
            state, _ = step(state, 0.0, np.nan, 0.0)
    last = step(state, 0.0, np.nan, 0.0)[1].x_std
    assert (np.abs(np.log(last / first) + 0.2 * 10) < 0.8).all()


@given(seeds, st.integers(1, 6), st.booleans(), st.booleans())
def test_boxes_shrink_as_fast_as_the_poles_allow(
    seed: int, n: int, in_samples: bool, defective: bool
) -> None:
    """|Phi' S Phi| has the spectral radius (abscissa) of F.

    The bounds decay as the error does, oscillating and multiple poles included.
    """
    rng = np.random.default_rng(seed)
    F = rng.normal(size=(n, n))
    if defective:
        change = rng.normal(size=(n, n)) + 3 * np.eye(n)
        F = np.linalg.solve(change, (np.eye(n) * rng.choice([-0.5, 0.5]) + np.eye(n, k=1)) @ change)
    form = build_modes(F, 10.0 ** rng.uniform(-1, 1, n), 0.1 if in_samples else None)
    rounding = 1e-8 * max(1.0, float(np.linalg.norm(F))) * np.linalg.cond(form.T)
    assert np.linalg.norm(form.T @ form.S @ form.inverse - F) < rounding
    angle = rng.uniform(0, 6, len(form.pairs))
    turn = form.turn if in_samples else 0.0
    now = ca.DM(mode_rotation(form.pairs, n, ca.SX(angle))).full()
    ahead = ca.DM(mode_rotation(form.pairs, n, ca.SX(angle + turn))).full()
    seen = ahead.T @ form.S @ now
    expected = np.linalg.eigvals(F)
    tolerance = 0.05 if defective else 1e-6  # multiple poles are known to the n-th root of rounding
    if in_samples:
        radius = np.abs(np.linalg.eigvals(np.abs(seen))).max()
        assert radius == pytest.approx(np.abs(expected).max(), abs=tolerance)
    else:
        shrinking = np.diag(np.diag(form.S))
        between = np.abs(np.triu(seen, 1)) * _beside(form.pairs, n)
        abscissa = np.linalg.eigvals(shrinking + between).real.max()
        assert abscissa == pytest.approx(expected.real.max(), abs=tolerance)


def _beside(pairs: list[int], n: int) -> Floats:
    """1 but within oscillating modes, which turn by themselves."""
    mask: Floats = np.ones((n, n))
    for i in pairs:
        mask[i, i + 1] = 0.0
    return mask


def test_interval_on_generated_C(tmp_path: Path) -> None:
    loop, state, exogenous = prepare(
        resolve_scenario(
            scene("""
                observer = { method = "interval", right = [0.3, 2.0], disturbance = 0.1 }
                simulation = { duration = 1.0, time = "sampled" }
                """)
        )
    )
    params = tree.pack_tree(loop.params)
    computed, expected = (
        interpret.run_interpreted(f, state, exogenous, params)[0]
        for f in (generated(loop.step, tmp_path), loop.step)
    )
    np.testing.assert_allclose(computed, expected, rtol=1e-12, atol=1e-12)


# --- Sliding modes


@pytest.mark.parametrize("a", [[1.0, 2.0], [6.0, 11.0, 6.0]])
@pytest.mark.parametrize("disturbance", [0.0, 1.0])
def test_super_twisting_converges_in_finite_time_with_the_order_of_its_theory(
    a: list[float], disturbance: float
) -> None:
    """Without a dead zone the k-th derivative is known to Ts^(r-k) after a finite time.

    That holds whatever the input does (Levant 2003).
    """
    flow, n = system(Plant(companion=a)), len(a)
    errors = []
    steps = [4e-3, 2e-3, 1e-3]
    for Ts in steps:
        model = sample_plant(flow, Ts)
        state, step = stepper(
            SuperTwisting(lipschitz=20.0).build(model, zone(right=0.0, left=0.0)), model
        )
        x, worst = np.ones(n), np.zeros(n)
        for k in range(round(3 / Ts)):
            u, y = np.sin(2 * k * Ts), model.linear.C @ x
            state, estimate = step(state, u, y, np.sign(y))
            if k * Ts > 2:
                worst = np.maximum(worst, np.abs(x - estimate.x))
            x = model.linear.A @ x + model.linear.B[:, 0] * (u + disturbance * np.sin(5 * k * Ts))
        errors.append(worst)
    for k in range(n):
        assert slopes(steps, [error[k] for error in errors]) == pytest.approx(n - k, abs=0.25)
    assert errors[-1][0] < 1e-4


def test_super_twisting_of_two_outputs_and_its_linear_part() -> None:
    rng = np.random.default_rng(5)
    flow = random_plant(rng, 4, 1, 2)
    model = sample_plant(flow, 1e-3)
    for options in ({}, {"speed": 3.0}):
        state, step = stepper(
            SuperTwisting(lipschitz=[400.0, 400.0], **options).build(
                model, zone(2, right=0.0, left=0.0)
            ),
            model,
        )
        x = rng.normal(size=4)
        for k in range(4000):
            u, y = np.sin(2e-3 * k), model.linear.C @ x
            state, estimate = step(state, u, y, np.sign(y))
            x = model.linear.A @ x + model.linear.B[:, 0] * u
        assert model.linear.C @ x == pytest.approx(estimate.z, abs=2e-2)


@given(seeds, st.integers(2, 5), st.integers(1, 2), st.booleans())
def test_on_the_sliding_mode_errors_decay(seed: int, n: int, p: int, in_samples: bool) -> None:
    """C G = I, and what the injection cannot reach is stable."""
    rng = np.random.default_rng(seed)
    p = min(p, n - 1)
    flow = random_plant(rng, n, 1, p)
    model = sample_plant(flow, 1e-3) if in_samples else flow
    rates = np.abs(np.linalg.eigvals(flow.linear.A)).max() * np.linspace(1.5, 2.5, n)
    try:
        law = WalcottZak(poles=-rates).build(model, zone(p)).params
    except StructureError:  # nearly unobservable
        return
    A, _, C = model.linear
    G = law.law.G
    assert pytest.approx(np.eye(p), abs=1e-8) == C @ G
    hidden = np.linalg.svd(C)[2][p:].T
    poles = np.linalg.eigvals(hidden.T @ (np.eye(n) - G @ C) @ (A - law.L @ C) @ hidden)
    assert (np.abs(poles).max() < 1) if in_samples else (poles.real.max() < 0)


@pytest.mark.parametrize("units", [[1.0, 1.0], [1e3, 1e-3], [0.01, 5.0]])
def test_walcott_zaks_direction_does_not_depend_on_units_of_states(units: list[float]) -> None:
    A, B, C = PAPER_PLANT.linear
    L, unit = np.array([[3.0], [2.0]]), np.array(units)
    known = sliding_direction(PAPER_PLANT, L, None)
    A, B, C = A * unit / unit[:, None], B / unit[:, None], C * unit
    scaled = system(Plant(A=A.tolist(), B=B.tolist(), C=C.tolist()))
    found = sliding_direction(scaled, L / unit[:, None], None)
    np.testing.assert_allclose(found * unit[:, None], known, rtol=1e-9)
    np.testing.assert_allclose(C @ found, np.eye(1), rtol=1e-12)


def test_walcott_zak_injection_saturates() -> None:
    built = WalcottZak(poles=POLES, rho=3.0, boundary=0.5).build(PAPER_PLANT, zone())
    state, step = stepper(built, PAPER_PLANT)
    for e in (0.1, -0.4, 0.7, -20.0):
        derivative, estimate = step(state, 0.0, e, np.sign(e))
        expected = built.params.L[:, 0] * e + 3.0 * built.params.law.G[:, 0] * np.clip(
            e / 0.5, -1, 1
        )
        assert derivative[:2] == pytest.approx(expected)
        assert estimate.innovation == pytest.approx([e])


@pytest.mark.parametrize("time", ["continuous", "sampled"])
def test_where_rivals_coincide_with_luenberger(time: str) -> None:
    """rho = 0; and high gain with the same L."""
    tables: dict[str, Any] = {
        "sensor": {"right": 1.3, "left": 0.6, "slope": 2.0, "noise": 0.02},
        "simulation": {"time": time, "duration": 1.0},
    }
    luenberger = simulate(scene(observer={"method": "luenberger", "poles": POLES}, **tables))
    sliding = simulate(
        scene(observer={"method": "walcott_zak", "poles": POLES, "rho": 0.0}, **tables)
    )
    assert sliding.x_hat == pytest.approx(luenberger.x_hat, abs=1e-10)
    fast = simulate(scene(observer={"method": "high_gain", "epsilon": 0.05}, **tables))
    same = simulate(
        scene(observer={"method": "luenberger", "L": [2 / 0.05, 1 / 0.05**2]}, **tables)
    )
    assert fast.x_hat == pytest.approx(same.x_hat, abs=1e-10)


# --- High gain


@given(seeds, st.integers(1, 4), st.integers(1, 2), st.sampled_from([1e-3, 1.0, 1e3]))
def test_high_gain_puts_all_poles_at_one_place_in_any_units(
    seed: int, n: int, p: int, unit_of_time: float
) -> None:
    """In coordinates epsilon^k z_i^(k), epsilon (A - L C) tends to chains with poles at -1.

    Their first columns are binomials.
    """
    rng = np.random.default_rng(seed)
    p = min(n, p)
    A, B, C = random_plant(rng, n, 1, p).linear
    unit = 10.0 ** rng.uniform(-2, 2, n)
    plant = linear(A * unit / unit[:, None] / unit_of_time, B / unit[:, None], C * unit)
    O, rows = output_chains(plant.linear.A, plant.linear.C)
    assert sorted(map(len, rows))[-1] == -(-n // p)
    epsilon = 1e-3 * unit_of_time
    L = HighGain(epsilon=epsilon).build(plant, zone(p)).params.L
    scale, expected = np.zeros(n), np.zeros((n, n))
    for chain in rows:
        scale[chain] = epsilon ** np.arange(len(chain))
        expected[chain, chain[0]] = [math.comb(len(chain), k) for k in range(1, len(chain) + 1)]
    T = scale[:, None] * O
    assert epsilon * T @ L @ plant.linear.C @ np.linalg.inv(T) == pytest.approx(
        expected, rel=1e-5, abs=1e-4
    )


def test_high_gain_poles_of_the_papers_plant() -> None:
    L = HighGain(epsilon=1e-4).build(PAPER_PLANT, zone()).params.L
    assert np.poly(PAPER_PLANT.linear.A - L @ PAPER_PLANT.linear.C) == pytest.approx(
        np.poly([-1e4, -1e4]), rel=1e-3
    )
    assert HighGain().build(sample_plant(PAPER_PLANT, 0.1), zone()).params.L[0] == pytest.approx(
        2 / 0.4 * 0.1
    )  # no faster than four samples


# --- What a dead zone makes of them


NAIVE: list[dict[str, Any]] = [
    {"method": "luenberger", "poles": POLES},
    {"method": "walcott_zak", "poles": POLES, "rho": 10.0},
    {"method": "super_twisting", "lipschitz": 200.0},
    {"method": "high_gain", "epsilon": 0.02},
]
LOOP: dict[str, Any] = tables_of("""
controller = { method = "state_feedback", poles = [-10.0, -11.0] }
simulation = { duration = 6.0, step = 0.002, time = "sampled" }
""")


@pytest.mark.parametrize("observer", NAIVE, ids=lambda observer: observer["method"])
def test_naive_observers_settle_a_width_away_from_the_output(observer: dict[str, Any]) -> None:
    """z - z^ ends near d, however good the correction: the reading is exact of the wrong thing."""
    run = simulate(scene(observer=observer, **LOOP))
    assert run.rms_estimation == pytest.approx(1.0, abs=0.1)
    active = run.side[run.last, 0] != 0
    gap = ((run.z - run.z_hat) * run.side)[run.last, 0][active]
    assert np.median(gap) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("observer", NAIVE[1:], ids=lambda observer: observer["method"])
def test_with_known_widths_they_are_right(observer: dict[str, Any]) -> None:
    run = simulate(scene(observer=observer | {"widths0": 1.0}, **LOOP))
    assert run.rms_estimation < 0.02


@pytest.mark.parametrize(
    "observer",
    [
        tables_of("""
            method = "walcott_zak"
            poles = [-8.4, -8.5]
            rho = 7.7
            boundary = 0.36
            gamma = 22.0
            width_max = 3.0
            """),
        {"method": "high_gain", "epsilon": 0.145, "gamma": 22.0, "width_max": 3.0},
    ],
    ids=lambda observer: observer["method"],
)
@pytest.mark.parametrize("time", ["continuous", "sampled"])
def test_with_slow_poles_widths_are_learnt(observer: dict[str, Any], time: str) -> None:
    run = simulate(
        scene(
            observer=observer,
            **LOOP | {"simulation": {"duration": 12.0, "step": 2e-3, "time": time}},
        )
    )
    assert run.widths == pytest.approx(np.ones((1, 2)), abs=0.03)
    assert run.rms_tracking < 0.03


def test_finite_time_convergence_hides_the_widths() -> None:
    """Super-twisting takes e to 0 whatever d is: nothing is left to learn from."""
    run = simulate(
        scene(
            observer={
                "method": "super_twisting",
                "lipschitz": 200.0,
                "gamma": 10.0,
                "width_max": 3.0,
            },
            **LOOP,
        )
    )
    assert run.widths.max() < 0.2


# --- Sliding-mode controller


def law(options: SlidingMode, model: System, x: Any, x_ref: Any, u_ff: Any) -> Floats:
    built = options.build(model)
    none = ca.SX.zeros(model.p)
    _, u = built.step(
        built.params,
        None,
        Estimate(ca.SX(x), none, none, none, none, none),
        Target(ca.SX(0.0), ca.SX(x_ref), ca.SX(u_ff)),
    )
    return np.asarray(ca.evalf(ca.SX(u)).full().ravel())


def test_sliding_mode_is_slotine_and_lis_law() -> None:
    """u = [r'' + a1 v + a0 z - l (v - r') - k S - ks sat(S / ph)] / b for second order.

    S = v - r' + l (z - r).
    """
    a0, a1, b, l, k, ks, ph = 3.0, 0.7, 2.0, 6.0, 4.0, 5.0, 0.5
    plant = linear([[0, 1], [-a0, -a1]], [[0], [b]], [[1, 0]])
    r, dr, ddr = 0.25, 0.1, -0.4
    options = SlidingMode(gain=ks / b, poles=[-l], rate=k, boundary=ph / b)
    for z, v in ((0.3, 0.2), (0.26, 0.1), (-4.0, 3.0)):
        S = v - dr + l * (z - r)
        expected = (ddr + a1 * v + a0 * z - l * (v - dr) - k * S - ks * np.clip(S / ph, -1, 1)) / b
        assert law(
            options, plant, [z, v], [r, dr], [(ddr + a1 * dr + a0 * r) / b]
        ) == pytest.approx([expected])


@pytest.mark.parametrize("Ts", [None, 0.01])
@pytest.mark.parametrize(("n", "m"), [(1, 1), (3, 1), (3, 2), (4, 2)])
def test_on_the_plane_errors_have_the_poles(n: int, m: int, Ts: float | None) -> None:
    flow = random_plant(np.random.default_rng(n + m), n, m, 1, stable=False)
    model = flow if Ts is None else sample_plant(flow, Ts)
    poles = -np.linspace(2, 4, n - m)
    G = SlidingMode(gain=1.0, poles=poles).build(model).params.G
    A, B, _ = model.linear
    assert pytest.approx(np.eye(m), abs=1e-9) == G @ B
    placed = np.linalg.eigvals((np.eye(n) - B @ G) @ A)
    placed = np.sort(placed[np.argsort(-np.abs(placed))][: n - m].real)
    assert placed == pytest.approx(np.sort(poles if Ts is None else np.exp(poles * Ts)), rel=1e-5)


@pytest.mark.parametrize("n", [2, 3])
def test_sliding_mode_suppresses_a_disturbance_below_its_gain(n: int) -> None:
    """s reaches its layer and rests at d / (rate + gain / boundary) under a constant d.

    Above the gain it leaves the layer.
    """
    model, d, rate = (
        sample_plant(random_plant(np.random.default_rng(n), n, stable=False), 1e-3),
        2.0,
        5.0,
    )
    for gain, boundary, rest in ((4.0, 0.02, d / (rate + 200)), (1.0, 0.02, (d - 1.0) / rate)):
        built = SlidingMode(
            gain=gain, poles=-np.linspace(4, 5, n - 1), rate=rate, boundary=boundary
        ).build(model)
        x, none = ca.SX.sym("x", n), ca.SX.zeros(1)
        _, u = built.step(
            built.params,
            None,
            Estimate(x, none, none, none, none, none),
            Target(none, ca.SX.zeros(n), none),
        )
        control, now = ca.Function("control", [x], [u]), np.ones(n)
        for _ in range(4000):
            now = model.linear.A @ now + model.linear.B[:, 0] * (float(control(now)) + d)
        assert float(built.params.G[0] @ now) * 1e-3 == pytest.approx(rest, rel=0.05)


def test_sliding_mode_drives_a_nonlinear_plant() -> None:
    pendulum = tables_of("""
        states = ["angle", "rate"]
        inputs = ["torque"]
        f = ["rate", "-9.81 * sin(angle) - 1.5 * rate + torque"]
        h = ["angle"]
        x0 = [0.3, 0.0]
        """)
    run = simulate(
        scene(
            """
            sensor = { right = 0.0, left = 0.0 }
            observer = { method = "high_gain", epsilon = 0.05 }
            controller = { method = "sliding_mode", gain = 1.0, poles = [-5.0], rate = 5.0 }
            reference = { kind = "sine", amplitude = 1.5, frequency = 0.5 }
            simulation = { duration = 5.0, step = 0.005 }
            """,
            plant=pendulum,
        )
    )
    assert run.rms_tracking < 1e-6


# --- Full state, and what is refused


def test_full_state_is_the_truth_and_needs_it() -> None:
    built = FullState().build(PAPER_PLANT, zone(right=1.3, left=0.6))
    x = ca.SX([2.0, -1.0])
    _, estimate = built.step(built.params, None, ca.SX(0.0), Reading(ca.SX(0.7), ca.SX(1.0), x))
    assert [
        float(ca.evalf(ca.SX(part[0])))
        for part in (estimate.x, estimate.z, estimate.right, estimate.left, estimate.z_inverse)
    ] == [2, 2, 1.3, 0.6, 2]
    with pytest.raises(InputError, match="'full_state' needs the true state"):
        built.step(built.params, None, ca.SX(0.0), Reading(ca.SX(0.7), ca.SX(1.0)))


@pytest.mark.parametrize(
    "options", [WalcottZak(gamma=1.0), HighGain(gamma=1.0), SuperTwisting(gamma=1.0)]
)
def test_widths_of_a_jump_sensor_cannot_be_adapted(options: Any) -> None:
    with pytest.raises(
        InputError, match=r"observer\.gamma: readings of a jump sensor only bound its widths"
    ):
        options.build(PAPER_PLANT, zone(kind="jump"))
    msgspec.structs.replace(options, gamma=0.0).build(PAPER_PLANT, zone(kind="jump"))


def test_super_twisting_of_an_unstable_plant_needs_its_linear_part() -> None:
    tables: dict[str, Any] = tables_of("""
        plant = { companion = [-1.0, 0.5] }
        simulation = { duration = 1.0, time = "sampled" }
        """)
    with pytest.raises(StructureError, match=r"observer\.L: the model is unstable"):
        simulate(scene(observer={"method": "super_twisting"}, **tables))
    simulate(scene(observer={"method": "super_twisting", "speed": 4.0}, **tables))


def test_canonical_coordinates_of_a_chain_are_its_states() -> None:
    chains = output_chains(*companion_form([0.0, 0.0, 0.0])[::2])
    assert chains.O.tolist() == np.eye(3).tolist()
    assert chains.rows == [[0, 1, 2]]


# --- Their parts


def test_modes_drive_others_but_not_themselves() -> None:
    assert (coupling_mask([1], 4) == np.triu(_beside([1], 4), 1)).all()


def test_a_box_is_cut_to_what_its_output_allows() -> None:
    """Against the ends of many points of the box; an output that it cannot have leaves it empty."""
    rng = np.random.default_rng(6)
    x, radius, frame = rng.normal(size=2), np.array([1.0, 0.5]), np.array([[1.0, 1.0], [0.0, 1.0]])
    c = np.array([[1.0, 0.5]])
    low = float(c[0] @ x) + 0.6
    points = rng.uniform(-1, 1, (200_000, 2)) * radius
    z = (x + points @ frame.T) @ c[0]
    retained = points[z >= low]

    def cut_to(low: float, high: float) -> tuple[Floats, Floats]:
        middle, size = cut_box(ca.SX(x), ca.SX(radius), ca.SX(frame), ca.SX(c), low, high)
        return ca.DM(middle).full()[:, 0], ca.DM(size).full()[:, 0]

    middle, size = cut_to(low, low + 5.0)
    shift = np.linalg.solve(frame, middle - x)
    assert shift - size == pytest.approx(retained.min(axis=0), abs=0.02)
    assert shift + size == pytest.approx(retained.max(axis=0), abs=0.02)
    assert cut_to(low + 9.0, low + 9.5)[1].min() < 0


@pytest.mark.parametrize("kind", ["deadzone", "jump"])
def test_a_reading_bounds_widths_and_output(kind: str) -> None:
    """z in [1, 4], d_r in [0.5, 2], noise 0.1, y on the right: z - d_r, or z itself."""
    shared = interval_step.IntervalSetup(PAPER_PLANT, [], kind, ends=False)
    numbers = interval_step.IntervalParams(*[None] * 13)._replace(
        noise=ca.SX(0.1), slack=ca.SX(0.1)
    )
    on = interval_step.SureSides(*map(ca.SX, (1, 0, 1, 0, 1, 0)))
    before = Bounds(ca.SX(0.5), ca.SX(2.0))
    boxes, z, y = Boxes(None, None, before, before), Bounds(ca.SX(1.0), ca.SX(4.0)), ca.SX(2.6)
    right, left = interval_step.width_bounds(shared, numbers, boxes, z, y, on)
    bounds = interval_step.reading_bounds(shared, numbers, right, left, y, on)
    high = 2.0 if kind == "jump" else 4.0 - 2.6 + 0.1
    widths = [float(ca.DM(value)) for value in (*right, *left)]
    assert widths == pytest.approx([0.5, high, 0.5, 2.0])
    offset = np.zeros(2) if kind == "jump" else np.array([0.5, high])
    output = [float(ca.DM(value)) for value in bounds]
    assert output == pytest.approx(2.6 + offset + [-0.1, 0.1])


@pytest.mark.parametrize(
    ("r", "expected"), [(1, [1.1]), (2, [1.5, 1.1]), (3, [2.0, 1.5 * 2.0**0.5, 1.1])]
)
def test_gains_of_the_differentiator_are_levants(r: int, expected: list[float]) -> None:
    """The non-recursive form of 1.1, 1.5, 2: lambda_k = L_k lambda_(k-1)^((r-k)/(r-k+1))."""
    assert differentiator_gains(r) == pytest.approx(expected)


@pytest.mark.parametrize(("e", "expected"), [(0.25, 1.5), (5.0, 3.0), (-5.0, -3.0)])
def test_the_sliding_term_saturates(e: float, expected: float) -> None:
    numbers = SlidingLaw(np.array([[1.0], [2.0]]), np.array([3.0]), np.array([0.5]))
    term = ca.DM(sliding_term(numbers, ca.SX(e))).full()[:, 0]
    assert term == pytest.approx([expected, 2 * expected])


def test_boxes_grow_by_what_their_modes_drive_in_each_other(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of upper triangular S and no rotation: |S_ij| r_j above the diagonal, S_ii r_i on it."""
    monkeypatch.setattr(interval_step, "radius_increase", lambda q, phi, z: np.zeros(3))
    setup: Any = SimpleNamespace(pairs=[], model=SimpleNamespace(n=3))
    S = np.array([[-1.0, 4.0, -0.5], [0.0, -2.0, 3.0], [0.0, 0.0, -5.0]])
    r = np.array([0.1, 0.2, 0.3])
    boxes = interval_step.Boxes(np.zeros(3), ca.SX(r), None, None)
    q: Any = SimpleNamespace(S=S)
    grown = interval_step.boxes_rate(setup, q, boxes, ca.SX.eye(3), None)
    expected = np.abs(np.triu(S, 1)) @ r + np.diag(S) * r
    np.testing.assert_allclose(ca.DM(grown.radius).full().ravel(), expected, rtol=1e-14)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_end_of_a_box_moves_as_far_as_the_bounds_say(sign: float) -> None:
    """One state in [-1, 1] of which z in [0.5, 9] is known; then z in [10, 11], which none has."""

    def of(lo: float, hi: float) -> tuple[float, float]:
        low, high = sorted((sign * lo, sign * hi))
        zero, one = ca.SX.zeros(1), ca.SX.ones(1)
        x, radius = cut_box(zero, one, ca.SX.eye(1), ca.SX.ones(1, 1), low, high)
        return float(x), float(radius)

    assert of(0.5, 9.0) == pytest.approx((0.75 * sign, 0.25))
    assert of(10.0, 11.0) == pytest.approx((1.0 * sign, -1.0))


def test_an_end_of_a_box_moves_as_far_as_other_entries_let_it() -> None:
    """z = x_0 + 2 x_1 >= 2 in the unit box: x_0 may be anything from 0, x_1 from 1/2."""
    none, row = ca.SX.zeros(2), ca.SX([[1.0, 2.0]])
    x, radius = cut_box(none, ca.SX.ones(2), ca.SX.eye(2), row, 2.0, 9.0)
    low = ca.DM(x - radius).full().ravel()
    np.testing.assert_allclose(low, [0.0, 0.5])
    np.testing.assert_allclose(ca.DM(x + radius).full().ravel(), [1.0, 1.0])
