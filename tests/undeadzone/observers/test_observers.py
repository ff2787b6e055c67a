"""Observers on numbers: literal formulas, the error dynamics of docs/observer.md.

Where methods must coincide, and missing samples.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.linalg import solve_continuous_are

from scenes import PAPER_PLANT, OnNumbers, linear, random_plant, scene, seeds, tables_of
from undeadzone.analysis.certificate.passivity import certify
from undeadzone.errors import InputError, ShapeError
from undeadzone.nonlinearities import sensor
from undeadzone.nonlinearities.sensor import Sensor, Zone, resolve
from undeadzone.observers import Certified, Luenberger, Oracle
from undeadzone.plants.system import System, sample_plant
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.simulation.collect import certificate as certify_run
from undeadzone.simulation.simulate import simulate
from undeadzone.util.arrays import Floats
from undeadzone_paper.observer import Printed

L = np.array([1.0, 1.5])
ZONE = resolve(Sensor(right=1.3, left=0.6), 1, 1e-3)
NOTHING = float("nan")


def zone(p: int, **options: Any) -> Zone:
    return resolve(Sensor(**{"right": 1.0, "left": 1.0} | options), p, 1e-3)


def read(x: Floats, model: System, where: Zone, side: Floats) -> Floats:
    """What is read of x on given sides, true or not."""
    return np.asarray(
        sensor.branch(model.linear.C @ x, side, where.right, where.left, where.slope, where.kind)
    )


# --- certified ---


@given(seeds, st.integers(1, 4), st.integers(1, 2), st.booleans(), st.sampled_from([1.0, 2.5]))
def test_errors_of_certified_are_exactly_linear_on_every_side(
    seed: int, n: int, p: int, in_samples: bool, slope: float
) -> None:
    """x~' = A x~ - L e, d_r~' = gamma e on the right, d_l~' = -gamma e on the left.

    e = C x~ - S d~; sampled likewise with ^+.
    """
    rng = np.random.default_rng(seed)
    Ts = 0.05 if in_samples else 1.0
    flow = random_plant(rng, n, 1, p)
    model = sample_plant(flow, Ts) if in_samples else flow
    where = zone(p, right=rng.uniform(0.5, 2, p), left=rng.uniform(0.5, 2, p), slope=slope)
    gain, gamma = rng.normal(size=(n, p)), rng.uniform(0.1, 5, p)
    observer = Certified(L=gain, gamma=gamma, widths0=1.0).build(model, where)
    step = OnNumbers(observer, model)
    A, B, C = model.linear
    keep = 1.0 if in_samples else 0.0
    for _ in range(3):
        x, x_hat, u, side = (
            rng.normal(size=n) * 3,
            rng.normal(size=n) * 3,
            rng.normal(size=1),
            rng.integers(-1, 2, p).astype(float),
        )
        right, left = rng.uniform(5, 6, p), rng.uniform(5, 6, p)
        after, estimate = step((x_hat, right, left), u, read(x, model, where, side), side)
        x_error, right_error, left_error = x - x_hat, where.right - right, where.left - left
        e = np.where(side == 0, 0.0, C @ x_error - np.where(side > 0, right_error, -left_error))
        assert estimate.innovation == pytest.approx(e, abs=1e-12)
        assert A @ x + B @ u - after.x == pytest.approx(A @ x_error - Ts * gain @ e, abs=1e-12)
        least = 0.0 if in_samples else -np.inf  # a sampled step ends in the admissible set
        moved = (
            keep * right - Ts * gamma * e * (side > 0),
            keep * left + Ts * gamma * e * (side < 0),
        )
        assert after.right == pytest.approx(np.maximum(moved[0], least), abs=1e-12)
        assert after.left == pytest.approx(np.maximum(moved[1], least), abs=1e-12)
        assert estimate.z == pytest.approx(C @ x_hat)
        assert estimate.z_inverse[side != 0] == pytest.approx(
            (C @ x + where_offset(side, right_error, left_error))[side != 0]
        )
        assert (estimate.z_inverse[side == 0] == 0).all()


def where_offset(side: Floats, right_error: Floats, left_error: Floats) -> Floats:
    """z_I - z = d^ - d on the side read."""
    return np.where(side > 0, -right_error, left_error)


@given(seeds, st.integers(1, 4), st.booleans(), st.booleans())
def test_V_never_rises_in_sampled_time(seed: int, n: int, silence: bool, narrow: bool) -> None:
    """On certified designs, for the side that the true state gives, whatever the state does.

    Also while d^ is projected.
    """
    rng = np.random.default_rng(seed)
    Ts = float(rng.uniform(0.01, 0.5))
    model = sample_plant(random_plant(rng, n), Ts)
    where = zone(1, right=rng.uniform(0.2, 1.5), left=rng.uniform(0.2, 1.5))
    gamma = float(rng.uniform(0.1, 0.9)) / Ts
    limit = 1.6 if narrow else 100.0
    observer = Certified(
        L=None if seed % 2 else rng.normal(size=n),
        gamma=gamma,
        widths0=rng.uniform(0, 1.5, 2),
        width_max=limit,
        silence=silence,
    )
    built = observer.build(model, where)
    proof = certify(model.linear, built.params.L / Ts, built.params.gamma / Ts, Ts)
    assume(proof.certified)
    step, state = OnNumbers(built, model), built.init(built.params)
    values: list[float] = []
    x = rng.normal(size=n) * 2
    for _ in range(60):
        z = model.linear.C @ x
        errors = np.array([where.right - state.right, where.left - state.left]).ravel()
        values.append(proof.V.evaluate_storage((x - state.x)[None], errors[None])[0])
        u = 5 * rng.normal(size=1)
        y = sensor.deadzone(z, where.right, where.left)
        state, _ = step(state, u, y, sensor.side(y))
        x = model.linear.A @ x + model.linear.B @ u
        assert (
            0 <= min(state.right[0], state.left[0]) <= max(state.right[0], state.left[0]) <= limit
        )
    assert np.diff(values).max() <= 1e-13 * max(values)
    assert values[-1] < values[0]


def test_certified_with_true_widths_and_no_adaptation_is_the_oracle() -> None:
    tables: dict[str, Any] = {"sensor": {"right": 1.3, "left": 0.6, "noise": 0.05}}
    certified = simulate(
        scene(
            observer={"method": "certified", "L": L.tolist(), "gamma": 0.0, "widths0": [1.3, 0.6]},
            **tables,
        )
    )
    oracle = simulate(scene(observer={"method": "oracle", "L": L.tolist()}, **tables))
    for name in ("x", "x_hat", "d_hat", "innovation", "u"):
        assert (getattr(certified, name) == getattr(oracle, name)).all()
    assert (oracle.d_hat == [1.3, 0.6]).all()


def test_without_a_dead_zone_certified_is_luenbergers_observer() -> None:
    tables: dict[str, Any] = tables_of("""
        sensor = { right = 0.0, left = 0.0, slope = 2.0 }
        simulation = { time = "sampled", step = 0.01, duration = 3.0 }
        """)
    certified = simulate(
        scene(observer={"method": "certified", "L": L.tolist(), "gamma": 0.0}, **tables)
    )
    luenberger = simulate(scene(observer={"method": "luenberger", "L": L.tolist()}, **tables))
    assert certified.x_hat == pytest.approx(luenberger.x_hat, abs=1e-12)
    assert certified.z_inverse == pytest.approx(certified.z, abs=1e-12)


def test_silence_innovation_says_which_edge_is_violated() -> None:
    """e = -max(C x^ - d_r^, 0) - min(C x^ + d_l^, 0), wider by the threshold.

    The violated edge grows.
    """
    where = zone(1, right=1.0, left=1.0, threshold=0.1)
    step = OnNumbers(
        Certified(L=L, gamma=4.0, silence=True, widths0=[0.5, 0.4]).build(PAPER_PLANT, where),
        PAPER_PLANT,
    )
    for x_hat, e, right, left in (
        (0.55, 0.0, 0.0, 0.0),
        (0.8, -0.2, 0.8, 0.0),
        (-0.45, 0.0, 0.0, 0.0),
        (-1.5, 1.0, 0.0, 4.0),
    ):
        after, estimate = step((np.array([x_hat, 0.3]), 0.5, 0.4), 0.0, 0.0, 0.0)
        assert estimate.innovation == pytest.approx([e])
        assert (after.right, after.left) == (pytest.approx([right]), pytest.approx([left]))
        assert after.x == pytest.approx([0.3 + L[0] * e, -x_hat - 0.6 + L[1] * e])


@pytest.mark.parametrize("kind", ["deadzone", "jump"])
@pytest.mark.parametrize("in_samples", [False, True])
@pytest.mark.parametrize("silence", [False, True])
def test_a_missing_sample_leaves_a_pure_prediction(
    kind: str, in_samples: bool, silence: bool
) -> None:
    model = sample_plant(PAPER_PLANT, 0.1) if in_samples else PAPER_PLANT
    where = zone(1, kind=kind, right=0.1, left=0.1)
    for options in (
        Certified(L=L, gamma=4.0, silence=silence, widths0=0.1),
        Oracle(L=L, silence=silence),
        Luenberger(L=L),
    ):
        built = options.build(model, where)
        state = built.init(built.params)._replace(x=np.array([2.0, 1.0]))
        after, estimate = OnNumbers(built, model)(state, 3.0, NOTHING, 0.0)
        assert after.x == pytest.approx(model.linear.A @ [2.0, 1.0] + model.linear.B[:, 0] * 3.0)
        assert estimate.z_inverse == pytest.approx(2.0)
        assert estimate.innovation == pytest.approx(0.0)
        for name in ("right", "left"):
            if hasattr(after, name):
                assert getattr(after, name) == pytest.approx(
                    getattr(state, name) if in_samples else 0.0
                )


def test_a_jump_sensor_needs_no_width_for_its_estimate() -> None:
    """e = y - z^ outside, and the widths come down to the least reading seen.

    The silence innovation raises them.
    """
    where = zone(1, kind="jump", slope=2.0)
    step = OnNumbers(Certified(L=L, gamma=4.0, widths0=3.0).build(PAPER_PLANT, where), PAPER_PLANT)
    after, estimate = step((np.array([0.5, 0.0]), 3.0, 3.0), 0.0, 5.0, 1.0)
    assert (estimate.innovation, estimate.z_inverse) == (pytest.approx([2.0]), pytest.approx([2.5]))
    assert (after.right, after.left) == (pytest.approx([4 * (2.5 - 3.0)]), pytest.approx([0.0]))
    after, _ = step((np.array([0.5, 0.0]), 2.0, 3.0), 0.0, 5.0, 1.0)
    assert after.right == pytest.approx([0.0])
    after, _ = step((np.array([0.5, 0.0]), 2.0, 3.0), 0.0, -4.0, -1.0)
    assert after.left == pytest.approx([4 * (2.0 - 3.0)])
    silent = OnNumbers(
        Certified(L=L, gamma=4.0, widths0=3.0, silence=True).build(PAPER_PLANT, where), PAPER_PLANT
    )
    after, estimate = silent((np.array([2.5, 0.0]), 2.0, 3.0), 0.0, 0.0, 0.0)
    assert (after.right, after.left, estimate.innovation) == (
        pytest.approx([4 * 0.5]),
        pytest.approx([0.0]),
        pytest.approx([0.0]),
    )


def test_estimates_are_projected_into_their_bounds() -> None:
    observer = {
        "method": "certified",
        "L": L.tolist(),
        "gamma": 50.0,
        "widths0": 0.6,
        "width_max": 0.7,
    }
    run = simulate(scene(sensor={"right": 0.1, "left": 0.7}, observer=observer), check_step=False)
    assert run.d_hat.min() == 0.0
    assert run.d_hat.max() == 0.7


def test_default_gain_is_certified_in_either_time() -> None:
    for time in ("continuous", "sampled"):
        run = simulate(
            scene(observer={"method": "certified"}, simulation={"time": time, "step": 0.01}),
            check_step=False,
        )
        assert run.info.certified
        assert run.V is not None
        assert run.largest_rise_of_V is not None
        assert run.largest_rise_of_V < 1e-9


def test_a_list_of_gains_needs_one_output() -> None:
    with pytest.raises(
        ShapeError, match=r"observer.L: expected a 2 x 2 matrix .*, found a list of 2"
    ):
        Certified(L=L).build(linear([[0.0, 1.0], [-1.0, -2.0]], [[0.0], [1.0]], np.eye(2)), zone(2))


@pytest.mark.parametrize("time", ["continuous", "sampled"])
@pytest.mark.parametrize(
    ("A", "reason", "bound", "width"),
    [
        ([[0.0, 1.0], [0.0, -2.0]], "marginally stable", 0.1, 1.4),
        ([[0.0, 1.0], [0.0, 0.0]], "chain of integrators", 0.12, 1.4),
        ([[0.0, 1.0], [-4.0, 0.0]], "undamped mode", 0.01, 1.4),
        ([[0.0, 1.0], [-1.0, 0.6]], "growth rate 0.3", 0.01, 1.4),
        ([[0.0, 1.0], [1.0, -1.0]], "no gamma > 0 learns a width", 1.0, 0.6),
    ],
)
def test_a_model_that_is_not_stable_has_default_gains_and_a_reason_without_proof(
    time: str, A: list[list[float]], reason: str, bound: float, width: float
) -> None:
    """With an integrator alone the sum of the widths is found, with an odd number of unstable
    poles none: they stay where they begin.
    """
    scenario = scene(
        plant={"A": A, "B": [[0.0], [1.0]], "C": [[1.0, 0.0]]},
        sensor={"right": 0.8, "left": 0.6},
        observer={"method": "certified", "widths0": 0.3},
        controller={"method": "state_feedback", "poles": [-2.0, -2.5]},
        simulation={"time": time, "step": 0.02, "duration": 120.0},
    )
    run = simulate(scenario, check_step=False)
    assert not run.info.certified
    proof = certify_run(resolve_scenario(scenario))
    assert proof is not None
    assert reason in proof.reason
    assert np.abs(run.z - run.z_hat)[-1000:].max() < bound
    assert run.d_hat[-1].sum() == pytest.approx(width, abs=0.01)


# --- Luenberger ---


@pytest.mark.parametrize("Ts", [None, 0.1])
def test_luenberger_takes_the_reading_for_the_output(Ts: float | None) -> None:
    model = PAPER_PLANT if Ts is None else sample_plant(PAPER_PLANT, Ts)
    where = zone(1, slope=2.0)
    step = OnNumbers(Luenberger(L=L).build(model, where), model)
    after, estimate = step((np.array([0.5, -1.0]),), 3.0, 1.6, 1.0)
    e = 1.6 / 2 - 0.5
    assert after.x == pytest.approx(
        model.linear.A @ [0.5, -1.0] + 3 * model.linear.B[:, 0] + (Ts or 1.0) * L * e
    )
    assert (estimate.innovation, estimate.right, estimate.left) == (
        pytest.approx([e]),
        pytest.approx([0]),
        pytest.approx([0]),
    )
    assert estimate.z_inverse == pytest.approx([0.8])


@pytest.mark.parametrize("Ts", [None, 0.05])
def test_luenbergers_error_decays_at_its_poles(Ts: float | None) -> None:
    """Without a dead zone: x~(t) = e^{(A - L C) t} x~(0), python-control's acker giving L."""
    import control

    model = PAPER_PLANT if Ts is None else sample_plant(PAPER_PLANT, Ts)
    poles = np.array([-4.0, -10.0]) if Ts is None else np.exp(np.array([-4.0, -10.0]) * Ts)
    gain = np.asarray(control.acker(model.linear.A.T, model.linear.C.T, poles)).reshape(1, 2).T
    step = OnNumbers(
        Luenberger(poles=[-4.0, -10.0]).build(model, zone(1, right=0.0, left=0.0)), model
    )
    x, x_hat = np.array([1.0, 2.0]), np.array([-0.5, 0.3])
    after, _ = step((x_hat,), 0.0, x[0], np.sign(x[0]))
    assert model.linear.A @ x - after.x == pytest.approx(
        (model.linear.A - gain @ model.linear.C) @ (x - x_hat), rel=1e-9
    )


@pytest.mark.parametrize("options", [{}, {"L": L, "poles": [-1.0, -2.0]}])
def test_luenberger_needs_one_choice(options: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="observer: luenberger needs exactly one of L, poles"):
        Luenberger(**options).build(PAPER_PLANT, ZONE)


# --- as printed ---


@given(seeds, st.booleans(), st.sampled_from([-1.0, 1.0]))
def test_printed_is_the_papers_text_with_its_stand_ins(
    seed: int, feed: bool, left_sign: float
) -> None:
    """(16)-(17), (25) by hand, P of (34) with A - L C from SciPy alone."""
    rng = np.random.default_rng(seed)
    A, B, C = PAPER_PLANT.linear
    gain, sigma, alpha, sharpness = np.array([12.0, 15.0]), 0.7, 10.0, 3.0
    P = solve_continuous_are(A - np.outer(gain, C[0]), B, np.eye(2), np.eye(1) / (2 * alpha))
    options = Printed(
        L=gain,
        sigma=sigma,
        alpha=alpha,
        sharpness=sharpness,
        widths0=[1.0, 1.0],
        feed_input=feed,
        left_sign=left_sign,
    )
    built = options.build(PAPER_PLANT, ZONE)
    x_hat, d, u, y = 3 * rng.normal(size=2), rng.uniform(0.5, 2, 2), rng.normal(), rng.normal()
    after, estimate = OnNumbers(built, PAPER_PLANT)((x_hat, d[0], d[1]), u, y, np.sign(y))
    y_hat = x_hat[0] - np.clip(x_hat[0], -d[1], d[0])
    chi = (1 + np.array([1, -1]) * np.tanh(sharpness * y)) / 2
    rate = -sigma * (y - y_hat) * (C @ P @ gain)[0] * chi * [1, -left_sign]
    assert estimate.innovation == pytest.approx([y - y_hat])
    assert after.x == pytest.approx(A @ x_hat + gain * (y - y_hat) + feed * B[:, 0] * u)
    assert [after.right[0], after.left[0]] == pytest.approx(rate)
    start = built.init(built.params)
    assert (start.x.tolist(), start.right.tolist(), start.left.tolist()) == ([0, 0], [1], [1])


def test_printed_is_for_one_linear_output_in_continuous_time() -> None:
    for model in (
        sample_plant(PAPER_PLANT, 0.1),
        linear(np.diag([-1.0, -2.0]), np.ones((2, 1)), np.eye(2)),
    ):
        with pytest.raises(InputError, match=r"observer.method: 'printed' is defined for"):
            Printed(L=L).build(model, zone(model.p))


def test_estimates_do_not_depend_on_the_input_of_the_moment() -> None:
    """The loop relies on it: the controller needs the estimate before it gives u."""
    for options in (Certified(L=L), Oracle(L=L), Luenberger(L=L), Printed(L=L)):
        built = options.build(PAPER_PLANT, ZONE)
        step = OnNumbers(built, PAPER_PLANT)
        state = built.init(built.params)._replace(x=np.array([0.4, 0.2]))
        for one, other in zip(
            step(state, 1.0, 0.5, 1.0)[1], step(state, -7.0, 0.5, 1.0)[1], strict=True
        ):
            assert one.tolist() == other.tolist()


def test_an_observer_that_adapts_one_of_two_outputs_adapts() -> None:
    model = linear([[-1.0, 0.5], [-0.5, -2.0]], np.eye(2), np.eye(2))
    sensor = resolve(Sensor(right=np.array([0.5, 0.4]), left=0.3), 2, 1e-2)
    for gamma, adapts in (([5.0, 0.0], True), ([0.0, 0.0], False)):
        assert Certified(gamma=gamma).build(model, sensor).traits.adapts is adapts
