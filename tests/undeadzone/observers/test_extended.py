"""The extended filter against the filters that it must be and an independent twin.

What it finds out about arms, and whether its claims hold.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pytest
from benchmarks.filters.arm_coverage import PULSES, START, sines, watch
from hypothesis import given, settings
from hypothesis import strategies as st

from scenes import EXACT_SENSOR, OnNumbers, centre_std, follow_together, random_plant, scene, seeds
from undeadzone.compile import interpret
from undeadzone.interfaces import Estimate
from undeadzone.nonlinearities import sensor
from undeadzone.nonlinearities.sensor import Sensor, Zone, resolve
from undeadzone.observers import Censored, Extended, Kalman
from undeadzone.observers.filtering.augmented_state import power_of_two_units
from undeadzone.plants.build import system
from undeadzone.plants.options import OneLink, Plant, TwoLink
from undeadzone.plants.system import System, sample_plant
from undeadzone.simulation.simulate import simulate
from undeadzone.util import tree
from undeadzone.util.arrays import Floats

TS = 2e-3
RANGE = [0.02, 0.15]
PRIOR = 0.13 / np.sqrt(12)
EXACT: dict[str, Any] = {"disturbance": 0.0}
SHAKEN: dict[str, Any] = {"disturbance": 0.5, "correlation_time": 0.1}


def zone(p: int = 1, Ts: float = TS, **options: Any) -> Zone:
    usual = {"right": 0.08, "left": 0.05, "noise": 1e-3} | EXACT_SENSOR
    return resolve(Sensor(**usual | options), p, Ts)


def arm(kind: Any = TwoLink, Ts: float = TS, **numbers: float) -> System:
    """A sampled arm with some friction."""
    return sample_plant(system(Plant(arm=kind(), parameters={"b1": 0.5} | numbers)), Ts, 1)


class Watched(NamedTuple):
    """An arm's states and what was estimated, a row per sample.

    extra: the last unknowns beside [x; d].
    """

    x: Floats
    estimate: Estimate
    extra: Floats

    def right(self, widths: Floats) -> Floats:
        """Errors of the last d_r^, d_l^ in their standard deviations."""
        error = np.concatenate([self.estimate.right[-1], self.estimate.left[-1]]) - widths.ravel()
        return np.asarray(
            error / np.concatenate([self.estimate.right_std[-1], self.estimate.left_std[-1]])
        )


def watcher(options: Extended, arm: System, where: Zone) -> Callable[..., Watched]:
    """How the filter watches an arm that follows a path by its true state.

    It is (path, seed, widths, x0, disturbance, params) -> `Watched`.
    """
    N, seen = arm.p, watch(options, arm, where)

    def run(
        path: Floats,
        seed: int,
        widths: Any,
        x0: Floats | None = None,
        disturbance: Floats | float = 0.0,
        params: Floats | None = None,
        noise: float = 1.0,
    ) -> Watched:
        rng = np.random.default_rng(seed)
        first = np.concatenate([path[0, : 2 * N] if x0 is None else x0, seen.filter])
        rows = np.hstack(
            [
                path,
                noise * rng.normal(size=(len(path), N)),
                np.broadcast_to(disturbance, (len(path), N)),
            ]
        )
        numbers = np.concatenate(
            [np.ravel(widths), arm.params if params is None else params, seen.numbers]
        )
        out, _ = interpret.run_interpreted(seen.step, first, rows, numbers)
        x, *parts = np.split(out, np.cumsum(seen.sizes), axis=1)
        return Watched(x, Estimate(*parts[:-1]), parts[-1][-1, 4 * N :])

    return run


# What scores do not widen, which `kalman` has none of.
KNOWN_TO_BOTH = ("x", "z", "right", "left", "innovation", "innovation_std", "refused", "restarts")


def agree(
    first: Estimate,
    second: Estimate,
    tolerance: float = 1e-9,
    names: Sequence[str] = Estimate._fields,
) -> None:
    for name in names:
        a, b = getattr(first, name), getattr(second, name)
        assert np.shape(a) == np.shape(b), name
        assert a == pytest.approx(b, rel=tolerance, abs=tolerance), name


# --- What it must be


@settings(max_examples=6)
@given(seeds, st.integers(1, 3), st.integers(1, 2), st.booleans())
def test_on_a_linear_plant_it_is_kalman_and_with_silence_and_disturbance_censored(
    seed: int, n: int, p: int, shaken: bool
) -> None:
    rng = np.random.default_rng(seed)
    model, where = sample_plant(random_plant(rng, n, 1, p), 0.02), zone(p, 0.02, noise=0.02)
    common: dict[str, Any] = {"right": [0.3, 2.0], "x_std": 2.0, "drift": 0.1}
    if shaken:
        common |= {"disturbance": 3.0, "levels": 1 + 2 * (n % 2), "bias": 0.5 * (n % 2)}
        twins: Any = Censored(**common, calibrated=0.0, tolerance=0.0), Extended(**common)
    else:
        twins = Kalman(**common, disturbance=0.0), Extended(**common, **EXACT, silence=False)
    pair = [options.build(model, where) for options in twins]
    readings = (
        (rng.normal(size=p) * rng.choice([0.0, 0.02, 3.0], p), rng.normal(size=1))
        for _ in range(40)
    )
    for states, both in follow_together(pair, model, where, readings):
        known = [tree.pack_tree(state.filter) for state in states]
        if not shaken:
            agree(both[0], both[1], names=KNOWN_TO_BOTH)
            assert known[0] == pytest.approx(known[1], rel=1e-9, abs=1e-9)
        else:
            agree(both[0], both[1]._replace(w=both[0].w))
            assert both[0].w == pytest.approx(both[1].w, abs=1e-9)


PENDULUMS = Plant(
    states=["a", "b", "v", "w"],
    f=[
        "v",
        "w",
        "-g * sin(a) - c * v + k * (b - a) + u",
        "-2 * g * sin(b) - c * w + k * (a - b) + u / 2",
    ],
    h=["a + 0.1 * sin(b)", "b - 0.2 * a ** 2"],
    parameters={"g": 9.0, "c": 0.4, "k": 2.0},
)


def pendulums(X: Any, u: float, Ts: float) -> Any:
    """One step of `PENDULUMS` for [x; d; p; g, k], by RK4 of the literal formulas.

    The disturbance and what is constant, too.
    """
    a, b = X[:2], X[2:4]
    g, k, force = 9.0 + X[9], 2.0 + X[10], u + X[8]

    def rate(s: Any) -> Any:
        (a, b), v = s[:2], s[2:]
        return np.array(
            [
                *v,
                -g * np.sin(a) - 0.4 * v[0] + k * (b - a) + force,
                -2 * g * np.sin(b) - 0.4 * v[1] + k * (a - b) + force / 2,
            ]
        )

    s = np.array([*a, *b])
    k1 = rate(s)
    k2 = rate(s + Ts / 2 * k1)
    k3 = rate(s + Ts / 2 * k2)
    k4 = rate(s + Ts * k3)
    return np.concatenate(
        [s + Ts / 6 * (k1 + 2 * k2 + 2 * k3 + k4), X[4:8], [np.exp(-Ts / 0.1) * X[8]], X[9:]]
    )


def reading(X: Any, side: Floats) -> Any:
    """What is read of [x; d; ...] on given sides, on the branch of each."""
    z = np.array([X[0] + 0.1 * np.sin(X[1]), X[1] - 0.2 * X[0] ** 2])
    return z - np.where(side > 0, X[4:6], 0.0) + np.where(side < 0, X[6:8], 0.0)


def slope(f: Callable[[Any], Any], X: Floats) -> Floats:
    """The Jacobian, by complex steps: to the last digits."""
    return np.stack([f(X + 1e-30j * e).imag / 1e-30 for e in np.eye(X.size)], axis=1)


@pytest.mark.parametrize(("blind", "seed"), [(False, 1), (False, 2), (True, 3)])
def test_it_is_the_textbook_extended_filter(blind: bool, seed: int) -> None:
    """A dense twin in NumPy: readings one after the other, each on its branch.

    `blind` takes every reading for z.
    """
    Ts = 0.02
    model, where, rng = (
        sample_plant(system(PENDULUMS), Ts, 1),
        zone(2, Ts),
        np.random.default_rng(seed),
    )
    options = Extended(
        right=RANGE,
        left=[0.0, 0.1],
        start=[0.1, -0.2, 0.5, 0.0],
        x_std=[0.1, 0.1, 0.3, 0.2],
        drift=0.01,
        silence=False,
        blind=blind,
        uncertain={"g": 0.5, "k": 0.2},
        glitches=0.0,
        **SHAKEN,
    )
    observer = options.build(model, where)
    step, state = OnNumbers(observer, model), observer.init(observer.params)
    widths = np.zeros(4) if blind else np.array([0.085, 0.085, 0.05, 0.05])
    spans = np.zeros(4) if blind else np.array([0.13, 0.13, 0.1, 0.1]) / np.sqrt(12)
    X, P = (
        np.array([0.1, -0.2, 0.5, 0.0, *widths, 0.0, 0.0, 0.0]),
        np.diag([0.1, 0.1, 0.3, 0.2, *spans, 0.5, 0.5, 0.2]) ** 2,
    )
    fade = np.exp(-Ts / 0.1)
    Q = np.diag([0, 0, 0, 0, *[0.0 if blind else 1e-4 * Ts] * 4, 0.25 * (1 - fade**2), 0, 0])
    for _ in range(60):
        y, u = rng.choice([-1.0, 0.0, 1.0], 2) * rng.uniform(0.1, 0.4, 2), rng.normal()
        side = np.sign(y)
        for i in range(2):
            if blind or side[i]:
                take = np.zeros(2) if blind else side
                h = slope(lambda X, take=take, i=i: reading(X, take)[i : i + 1], X)[0]
                K = P @ h / (h @ P @ h + 1e-6)
                X, P = X + K * (y[i] - reading(X, take)[i]), P - np.outer(K, h @ P)
                P = (P + P.T) / 2
        state, estimate = step(state, u, y, side)
        expected = X[:8].copy()
        if not blind:  # shown inside the claimed ranges
            expected[4:6], expected[6:] = np.clip(X[4:6], *RANGE), np.clip(X[6:8], 0.0, 0.1)
        assert np.concatenate([estimate.x, estimate.right, estimate.left]) == pytest.approx(
            expected, rel=1e-9, abs=1e-9
        )
        assert np.concatenate(
            [estimate.x_std, estimate.right_std, estimate.left_std]
        ) ** 2 == pytest.approx(np.diag(P)[:8], rel=1e-9, abs=1e-12)
        F = slope(lambda X, u=u: pendulums(X, u, Ts), X)
        X, P = pendulums(X, u, Ts), F @ P @ F.T + Q
        counted = np.concatenate([power_of_two_units(model), np.ones(7)])
        assert counted * state.filter.mean == pytest.approx(X, rel=1e-9, abs=1e-9)


def test_joints_that_do_not_touch_are_the_same_separate_as_coupled() -> None:
    """Two carts: one filter of 10 unknowns, or two of 5, to rounding.

    A torque on one is an acceleration of it.
    """
    carts = Plant(
        states=["a", "b", "v", "w"],
        inputs=["s", "t"],
        f=["v", "w", "s / m", "t / M"],
        h=["a", "b"],
        parameters={"m": 2.0, "M": 0.5},
    )
    model, where, rng = (
        sample_plant(system(carts), 0.01, 1),
        zone(2, 0.01),
        np.random.default_rng(4),
    )
    common: dict[str, Any] = {
        "right": RANGE,
        "x_std": 0.5,
        "disturbance": [0.3, 0.5],
        "correlation_time": 0.2,
        "drift": 0.01,
        "glitches": 0.0,
    }
    pair = [
        Extended(**common, joints=joints).build(model, where) for joints in ("coupled", "separate")
    ]  # type: ignore[arg-type]
    z = 0.4 * np.sin(np.array([0.03, 0.05]) * np.arange(300)[:, None])
    readings = (
        (y + 1e-3 * rng.normal(size=2), rng.normal(size=2)) for y in sensor.deadzone(z, 0.08, 0.05)
    )
    for last in follow_together(pair, model, where, readings):
        agree(*last[1])
    states, both = last
    assert (both[0].width_std < 0.5 * PRIOR).all()
    assert [len(state.filter.cov) for state in states] == [10 * 11 // 2, 2 * 5 * 6 // 2]


# --- What it finds out


@pytest.mark.parametrize("joints", ["coupled", "separate"])
def test_the_widths_of_two_links_in_a_vertical_plane(joints: Any) -> None:
    """20 s of sines through 0, an exact model: widths to 5 %.

    The centres by weight alone where the covariance knows of it.
    """
    model, widths = arm(Ts=1e-3), np.array([[0.05, 0.08], [0.08, 0.05]])
    options = EXACT
    if joints == "separate":
        options = {"joints": joints, "disturbance": 0.1, "correlation_time": 0.1}
    path = sines(20.0, 0.5, [2.0, 4.0], 1e-3)
    watched = watcher(
        Extended(right=RANGE, start=path[0, :4], x_std=[0.02, 0.02, 0.1, 0.1], **options),
        model,
        zone(2, 1e-3),
    )(path, 0, widths)
    width = watched.estimate.right[-1] + watched.estimate.left[-1]
    assert width == pytest.approx(widths.sum(axis=0), rel=0.05)
    assert (np.abs(watched.right(widths)) < 3).all()
    assert (np.abs(width - widths.sum(axis=0)) < 3 * watched.estimate.width_std[-1]).all()
    if joints == "coupled":
        assert np.concatenate(
            [watched.estimate.right[-1], watched.estimate.left[-1]]
        ) == pytest.approx(widths.ravel(), abs=2e-4)
        assert watched.estimate.z[5000:] == pytest.approx(watched.x[5000:, :2], abs=1e-3)


def test_homing_tells_the_centre_that_nothing_else_does() -> None:
    """One link on a table: no force tells where it points.

    Only a known start tells d_r from d_l.
    """
    model, widths = arm(OneLink, g=0.0), np.array([0.05, 0.08])
    path = sines(8.0, 0.5, [3.0], TS)
    homed, lost = (
        watcher(Extended(right=RANGE, x_std=[std, 0.01], start=[0.0, 1.5], **EXACT), model, zone())(
            path, 1, widths, x0=np.array([0.0, 1.5])
        )
        for std in (1e-4, 1.0)
    )
    for watched in (homed, lost):
        assert watched.estimate.right[-1] + watched.estimate.left[-1] == pytest.approx(
            [0.13], rel=0.01
        )
        assert watched.estimate.width_std[-1] < 1e-3
    assert centre_std(homed.estimate)[-1] < 1e-3
    assert np.array([homed.estimate.right[-1], homed.estimate.left[-1]]).ravel() == pytest.approx(
        widths, abs=1e-3
    )
    assert centre_std(lost.estimate)[-1] == pytest.approx([PRIOR / np.sqrt(2)], rel=0.02)


def test_an_unknown_payload_is_found_and_does_not_harm_the_widths() -> None:
    believed, widths, path = (
        arm(payload=0.6),
        np.array([[0.05, 0.08], [0.08, 0.05]]),
        sines(10.0, 0.5, PULSES, TS),
    )
    options: dict[str, Any] = {
        "right": RANGE,
        "start": path[0, :4],
        "x_std": [0.02, 0.02, 0.1, 0.1],
        "disturbance": 0.05,
        "correlation_time": 0.1,
    }
    loaded = believed.params + 0.5 * np.array([name == "payload" for name in believed.names])
    informed, untold, trusting = (
        watcher(Extended(**options, uncertain=uncertain, glitches=share), believed, zone(2))(
            path, 2, widths, params=loaded
        )
        for uncertain, share in (({"payload": 0.5}, 0.05), ({}, 0.05), ({}, 0.0))
    )
    assert informed.extra[-1] == pytest.approx(0.5, abs=0.01)
    assert (np.abs(informed.right(widths)) < 3).all()
    assert informed.estimate.consistent[-1] == 1
    # untold it is wrong, and knows it unless it takes all readings for right
    assert (np.abs(untold.right(widths)) < 3).all()
    assert untold.estimate.consistent[-1] == 0
    assert (np.abs(trusting.right(widths)) > 5).any()


def test_blind_settles_at_the_error_of_the_dead_zone() -> None:
    """An arm at rest beyond its edges reads z - d_r, z + d_l.

    So it is believed, where nothing knows of a dead zone.
    """
    model, widths = arm(), np.array([[0.05, 0.08], [0.08, 0.05]])
    rest = np.tile([0.4, -0.5, 0.0, 0.0, 0.0, 0.0], (1500, 1))
    options: dict[str, Any] = {
        "right": RANGE,
        "start": rest[0, :4],
        "x_std": 0.01,
        "disturbance": 20.0,
        "correlation_time": 100.0,
    }
    blind, seeing = (
        watcher(Extended(**options, blind=blind), model, zone(2))(rest, 3, widths)
        for blind in (True, False)
    )
    assert (blind.x - blind.estimate.x)[-1, :2] == pytest.approx([0.05, -0.05], rel=0.05)
    assert np.abs((seeing.x - seeing.estimate.x)[-1, :2]).max() < 0.02
    assert not np.any([blind.estimate.right, blind.estimate.left, blind.estimate.width_std])


def test_a_jump_sensor_of_velocities_bounds_its_widths() -> None:
    """Readings show z itself; that they are 0, or not, bounds each width.

    From both sides in the end.
    """
    flow = system(Plant(arm=TwoLink(measured="velocity"), parameters={"b1": 0.5}))
    model, widths, path = (
        sample_plant(flow, TS, 1),
        np.array([[0.3, 0.5], [0.4, 0.6]]),
        sines(8.0, 0.5, [2.0, 4.0], TS),
    )
    options = Extended(
        right=[0.0, 1.0], start=path[0, :4], x_std=0.02, correlation_time=0.02, **EXACT
    )
    watched = watcher(options, model, zone(2, kind="jump", noise=0.01))(path, 4, widths)
    assert np.concatenate([watched.estimate.right[-1], watched.estimate.left[-1]]) == pytest.approx(
        widths.ravel(), abs=0.05
    )
    assert (watched.estimate.right_std[-1] < 0.3 / np.sqrt(12)).all()
    assert (np.abs(watched.right(widths)) < 3).all()


# --- Whether its claims hold


@pytest.mark.parametrize(
    ("options", "rms", "payload"),
    [
        (EXACT, 0.0, 0.0),
        (SHAKEN, 0.5, 0.0),
        (SHAKEN | {"joints": "separate"}, 0.5, 0.0),
        (SHAKEN | {"uncertain": {"payload": 0.3}}, 0.5, 0.3),
    ],
    ids=["exact", "disturbed", "separate", "payload"],
)
def test_intervals_cover_the_truth_over_random_arms(
    options: dict[str, Any], rms: float, payload: float
) -> None:
    """2 standard deviations hold the truth in 95 %.

    At least in 88 % of 15 arms' 4 edges and 4 states, whose squared errors fit their variances.
    """
    Ts, runs = 4e-3, 15
    model, path, x_std = arm(Ts=Ts, payload=1.0), sines(4.0, 0.5, PULSES, Ts), START
    run = watcher(
        Extended(right=RANGE, start=path[0, :4], x_std=x_std, **options), model, zone(2, Ts)
    )
    fade, errors = np.exp(-Ts / 0.1), []
    for seed in range(runs):
        rng = np.random.default_rng([5, seed])
        widths = rng.uniform(*RANGE, (2, 2))
        w = [rms * rng.normal(size=2)]
        for shock in rng.normal(size=(len(path) - 1, 2)):
            w.append(fade * w[-1] + rms * np.sqrt(1 - fade**2) * shock)
        params = model.params + payload * rng.normal() * np.array(
            [name == "payload" for name in model.names]
        )
        watched = run(
            path, seed, widths, path[0, :4] + x_std * rng.normal(size=4), np.array(w), params
        )
        errors.append(
            np.concatenate(
                [
                    watched.right(widths),
                    ((watched.estimate.x - watched.x) / watched.estimate.x_std)[-1],
                ]
            )
        )
    assert (np.abs(errors) < 2).mean() > 0.88
    assert 0.5 < np.square(errors).mean() < 1.5


# --- In the loop


def test_lanes_and_the_virtual_machine_agree() -> None:
    scenario = scene(
        """
        plant.states = ["a", "b", "v", "w"]
        plant.inputs = ["s", "t"]
        plant.f = ["v", "w", "-sin(a) - v + 0.2 * b + s", "-2 * sin(b) - w + 0.2 * a + t"]
        plant.h = ["a", "b"]
        plant.x0 = [0.2, 0.0, 0.0, 0.0]
        sensor = { right = 0.08, left = 0.05, noise = 0.001 }
        reference = { kind = "sine", amplitude = [0.5, 0.4], frequency = 1.0 }
        controller = { method = "state_feedback", poles = [-5, -6, -7, -8] }
        simulation = { time = "sampled", step = 0.005, duration = 4.0, substeps = 1 }
        """,
        observer={
            "method": "extended",
            "right": RANGE,
            "start": [0.2, 0.0, 0.0, 0.0],
            "x_std": 0.05,
            "disturbance": 0.2,
            "silence": False,
            "joints": "separate",
        },
    )
    usual, compiled = (simulate(scenario, engine=engine) for engine in ("interpret", "lanes"))
    assert usual.d_hat == pytest.approx(compiled.d_hat, rel=1e-12)
    assert usual.x_hat == pytest.approx(compiled.x_hat, rel=1e-9, abs=1e-12)
    assert usual.d_hat[-1] == pytest.approx([0.08, 0.05] * 2, abs=0.03)
