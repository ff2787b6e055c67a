"""Certificates on a region: true bounds on Jacobians, linear plants, closed forms, brute force."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from benchmarks.design.random_designs import random_design
from hypothesis import given, settings
from hypothesis import strategies as st

from scenes import PAPER_PLANT, linear, random_plant, scene, tables_of
from undeadzone.analysis.certificate.passivity import Certificate, certify, passive_gain
from undeadzone.analysis.error_dynamics import Dynamics
from undeadzone.compile.interval import Interval, build_enclosure
from undeadzone.errors import InputError, ShapeError, StructureError
from undeadzone.plants.build import system
from undeadzone.plants.options import ElasticJoint, Plant, TwoLink
from undeadzone.plants.region import Box, Region, build_box
from undeadzone.plants.system import System, sample_plant
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.util.arrays import Floats
from undeadzone_design.certificate.polytopic import (
    _entry_slopes,
    absolute_matrix,
    build_inequality_form,
    certify_on,
    design_on,
    halve_boxes,
    jacobian_on_box,
)
from undeadzone_design.synthesis.check import check

GRAVITY = 9.81
NONE = np.zeros((2, 1))
ONE = np.ones(1)
HANGING = -np.pi / 2

FORMULAS = [
    "sin(x) * cos(y) - tan(x / 4)",
    "exp(x) / (1 + y ** 2)",
    "sqrt(x ** 2 + 0.01) * tanh(y)",
    "x ** 3 - 2 * x * y",
    "log(2 + cos(x)) * atan(y)",
    "asin(x / 4) + acos(y / 4)",
    "sinh(x) - cosh(y)",
    "(x ** 2 + 1) ** 1.5 / (3 + sin(y))",
    "x ** -2 * y",
    "abs(x) + max(x, y) * min(x, 1)",
    "1 / (x - y)",
]


def pendulum(damping: float, gravity: float = GRAVITY) -> System:
    return system(
        Plant(f=["v", f"-{gravity} * sin(q) - {damping} * v + u"], h=["q"], states=["q", "v"])
    )


def ranges(*sides: float) -> Box:
    """The box with these half widths about 0."""
    return Box(-np.array(sides), np.array(sides))


def uniform(rng: np.random.Generator, within: Box, rows: int) -> Floats:
    return rng.uniform(within.low, within.high, (rows, within.low.size))


@pytest.mark.parametrize("formula", FORMULAS)
@settings(max_examples=60, deadline=None)
@given(
    corner=st.tuples(*2 * [st.floats(-3, 3)]),
    width=st.tuples(*2 * [st.floats(0, 2)]),
    seed=st.integers(0, 1000),
)
def test_an_enclosure_holds_every_value(
    formula: str, corner: tuple[float, ...], width: tuple[float, ...], seed: int
) -> None:
    """At the corners, where bounds are attained, and inside; against CasADi's own evaluation."""
    plant = system(Plant(f=[formula, "0 * x"], h=["x"], states=["x", "y"], x_eq=[1.0, 0.5]))
    w = ca.SX.sym("w", 2)
    function = ca.Function("f", [w], [ca.densify(plant.move(ca.SX(0, 1), w, ca.SX(1, 1)))[0]])
    low = np.clip(corner, -3, 3)
    high = np.minimum(low + width, 3)
    (bound,) = build_enclosure(function)([Interval(low[:, None], high[:, None])])
    points = np.vstack(
        [
            np.random.default_rng(seed).uniform(low, high, (200, 2)),
            [low, high, [low[0], high[1]], [high[0], low[1]]],
        ]
    )
    values = function(points.T).full().ravel()
    assert not bound.low[0, 0] > values[np.isfinite(values)].min(initial=np.inf)
    assert not bound.high[0, 0] < values[np.isfinite(values)].max(initial=-np.inf)


def test_an_enclosure_is_tight_where_a_variable_stands_once() -> None:
    x = ca.SX.sym("x", 2)
    function = ca.Function(
        "f", [x], [ca.vertcat(ca.sin(x[0]), ca.sqrt(x[1]) * ca.cos(x[0]), 1 / x[1], x[1] ** 2)]
    )
    (bound,) = build_enclosure(function)(
        [Interval(np.array([[0.5], [4.0]]), np.array([[2.0], [9.0]]))]
    )
    assert bound.low[:, 0] == pytest.approx([np.sin(0.5), 3 * np.cos(2.0), 1 / 9, 16], rel=1e-13)
    assert bound.high[:, 0] == pytest.approx([1, 3 * np.cos(0.5), 0.25, 81], rel=1e-13)
    with pytest.raises(InputError, match="no bounds are known for the function erf"):
        build_enclosure(ca.Function("f", [x], [ca.erf(x)]))


@pytest.mark.parametrize("Ts", [None, 1e-3])
def test_bounds_of_an_arms_jacobian_and_of_its_derivatives_hold(Ts: float | None) -> None:
    arm = system(
        Plant(
            arm=TwoLink(), parameters={"b1": 1.0, "f2": 0.3, "payload": 0.5}, x0=[HANGING, 0, 0, 0]
        )
    )
    arm = arm if Ts is None else sample_plant(arm, Ts, 1)
    about, size = np.array([HANGING, 0, 0, 0, 0, 0]), np.array([0.4, 0.4, 1, 1, 3, 3])
    slopes = jacobian_on_box(arm, Box(about - size, about + size))
    rng = np.random.default_rng(0)
    for share in (1.0, 0.1, 1e-3):
        part = Box(about - share * size, about + share * size)
        one = Box(part.low[None], part.high[None])
        points = uniform(rng, part, 1000)
        A = slopes.at(points)[:, *slopes.entries]
        bound, bends = (bounds(one) for bounds in slopes.bounds())
        assert (bound.low[0, 0] <= A.min(axis=0)).all()
        assert (bound.high[0, 0] >= A.max(axis=0)).all()
        step = 1e-6 * share * size
        for d in range(6):
            away = points + step * np.eye(6)[d]
            slope = (slopes.at(away)[:, *slopes.entries] - A) / step[d]
            slack = 1e-5 * np.abs(slope).max() + 1e-12 / step[d] * np.abs(A).max()
            assert (bends.low[0, d] <= slope.min(axis=0) + slack).all()
            assert (bends.high[0, d] >= slope.max(axis=0) - slack).all()
    constant = np.ones((4, 4), bool)
    constant[slopes.entries] = False
    assert np.ptp(slopes.at(points), axis=0)[constant] == pytest.approx(0, abs=1e-12)


def test_slopes_are_the_linearisation() -> None:
    for model in (
        pendulum(1.0),
        sample_plant(pendulum(1.0), 0.01, 10),
        PAPER_PLANT,
        sample_plant(PAPER_PLANT, 0.01),
    ):
        Ts = model.Ts
        expected = model.linear.A if Ts is None else (model.linear.A - np.eye(2)) / Ts
        assert jacobian_on_box(model, ranges(1, 1, 1)).at(np.zeros((1, 3)))[0] == pytest.approx(
            expected, abs=1e-8
        )


@pytest.mark.parametrize("seed", range(10))
def test_of_a_linear_plant_it_is_the_certificate(seed: int) -> None:
    rng = np.random.default_rng(seed)
    matrices, L, gamma, Ts = random_design(rng, 1 + seed % 4, 1)
    gamma = np.atleast_1d(np.max(gamma))
    for gains in (L, -3 * L, rng.normal(0, 10, L.shape)):
        plain = linear(matrices.A, matrices.B, matrices.C)._replace(Ts=Ts)
        expected = certify(matrices, gains, gamma, Ts)
        found = certify_on(plain, gains, gamma, ranges(*np.ones(plain.n + plain.m)))
        assert found.certified == expected.certified
        assert found.margin == pytest.approx(expected.margin, abs=1e-9)
        assert expected.certified or found.reason.endswith(expected.reason)


@pytest.mark.parametrize("damping", [0.5, 1.5, 4.0])
def test_the_pendulum_has_a_common_v_exactly_where_the_circle_criterion_says(
    damping: float,
) -> None:
    """x'' + b x' + k(t) x = 0, k in [k1, k2], has one quadratic V iff sqrt(k2) - sqrt(k1) < b.

    Here k = g cos q.
    """
    edge = np.arccos(max(1 - damping / np.sqrt(GRAVITY), 0.0) ** 2)
    found = [
        certify_on(pendulum(damping), NONE, ONE, ranges(share * edge, 5, 10))
        for share in (0.5, 0.99, 1.01)
    ]
    assert [one.certified for one in found] == [True, True, False]


def test_a_jacobian_that_neither_corner_nor_centre_shows_is_found() -> None:
    """The stiffest pendulum, q = 0, is no corner of -0.4 <= q <= 1.2.

    With it the circle criterion fails for this damping.
    """
    off = Box(np.array([-0.4, -1, -1]), np.array([1.2, 1, 1]))
    at = np.sqrt(GRAVITY) * (np.sqrt(np.cos([0.0, 0.4])) - np.sqrt(np.cos(1.2)))
    assert not certify_on(pendulum(float(at.mean())), NONE, ONE, off).certified
    assert certify_on(pendulum(1.01 * float(at[0])), NONE, ONE, off).certified


def rises(found: Certificate, model: System, within: Box, seed: int, rows: int = 20_000) -> Floats:
    """V' (V+ - V per Ts if sampled) over V at random states, estimates, inputs, widths and sides.

    A random share theta of the innovation is left.
    """
    rng = np.random.default_rng(seed)
    w = ca.SX.sym("w", model.n + model.m)
    move = ca.Function("move", [w], [model.move(ca.SX(model.params), w[: model.n], w[model.n :])])
    at = uniform(rng, within, rows)
    x, u = at[:, : model.n], at[:, model.n :]
    estimate = uniform(rng, within, rows)[:, : model.n]
    estimate = x + (estimate - x) * 10 ** rng.uniform(-3, 0, (rows, 1))
    error = x - estimate
    d = rng.normal(size=(rows, 2 * model.p)) * 10 ** rng.uniform(-3, 1, (rows, 1))
    moved, guessed = (move(np.hstack([state, u]).T).full().T for state in (x, estimate))
    S = np.zeros((rows, model.p, 2 * model.p))
    for i in range(model.p):
        side = rng.integers(0, 2, rows)
        S[np.arange(rows), i, 2 * i + side] = 1 - 2 * side
    e = rng.choice([0.0, 0.3, 1.0], (rows, model.p)) * (
        error @ model.linear.C.T - np.einsum("kij,kj->ki", S, d)
    )
    errors, V = found.dynamics, found.V
    change = np.einsum("kij,ki->kj", S, e) @ errors.gamma
    value = V.evaluate_storage(error, d)
    if model.Ts is not None:
        error_next = moved - guessed - model.Ts * e @ errors.L.T
        return (V.evaluate_storage(error_next, d + model.Ts * change) - value) / model.Ts / value
    of_states = 2 * np.einsum("ki,ij,kj->k", error, V.P, moved - guessed - e @ errors.L.T)
    return (of_states + 2 * np.einsum("ki,ij,kj->k", d, V.R, change)) / value


@pytest.mark.parametrize("Ts", [None, 1e-3, 0.05])
def test_v_falls_inside_the_region_for_all_states_sides_and_inputs(Ts: float | None) -> None:
    elastic = system(
        Plant(arm=ElasticJoint(), parameters={"b1": 1.0, "b2": 0.5}, x0=[HANGING, HANGING, 0, 0])
    )
    about = np.array([HANGING, HANGING, 0, 0, 0])
    reach = np.array([1.5, 1.2, 9, 9, 20])
    cases: list[tuple[System, Any, Box]] = [
        (pendulum(1.5), [[0.5], [0.3]], ranges(1.1, 5, 10)),
        (elastic, [[0.4], [0.3], [0.1], [0.2]], Box(about - reach, about + reach)),
    ]
    for k, (model, L, within) in enumerate(cases):
        plant = model if Ts is None or (k and Ts > 0.01) else sample_plant(model, Ts, 2)
        found = certify_on(plant, np.array(L), np.array([5.0]), within)
        assert found.certified, found.reason
        assert rises(found, plant, within, k).max() < 1e-9
        spoilt = found._replace(dynamics=found.dynamics._replace(L=found.dynamics.L - 60.0))
        assert rises(spoilt, plant, within, k).max() > 0.1


def test_v_falls_along_trajectories_with_random_sides() -> None:
    """The sampled observer beside its plant, sides drawn at will, while both are in the region."""
    model, within = sample_plant(pendulum(1.5), 0.01, 1), ranges(1.1, 5, 10)
    found = certify_on(model, np.array([[0.5], [0.3]]), np.array([5.0]), within)
    w = ca.SX.sym("w", 3)
    move = ca.Function("move", [w], [model.move(ca.SX(model.params), w[:2], w[2])])
    rng = np.random.default_rng(0)
    x = rng.normal(0, 0.2, (200, 2))
    guess = rng.normal(0, 0.2, (200, 2))
    d = rng.normal(0, 0.3, (200, 2))
    inside, last, first = np.ones(200, bool), np.inf, found.V.evaluate_storage(x - guess, d)
    side, u = rng.integers(-1, 2, 200), np.zeros((200, 1))
    for k in range(1500):
        u = rng.normal(0, 3, (200, 1)) if k % 20 == 0 else u
        side = np.where(rng.uniform(size=200) < 0.05, rng.integers(-1, 2, 200), side)
        V = found.V.evaluate_storage(x - guess, d)
        inside &= ~within.is_outside(x, guess, u)
        assert (V[inside] <= np.broadcast_to(last, 200)[inside] * (1 + 1e-12)).all()
        last = V
        S = np.stack([side == 1, -1.0 * (side == -1)], axis=1)
        e = np.abs(side) * ((x - guess)[:, 0] - (S * d).sum(axis=1))
        x, guess = (move(np.hstack([state, u]).T).full().T for state in (x, guess))
        guess, d = guess + 0.01 * e[:, None] * found.dynamics.L.T, d + 0.01 * 5.0 * S * e[:, None]
    assert inside.sum() > 50
    assert (last[inside] < 0.05 * first[inside]).mean() > 0.9


@pytest.mark.parametrize("sampling", [None, 1e-3])
def test_an_elastic_joint_is_certified_while_its_link_hangs(sampling: float | None) -> None:
    """Gravity holds the absolute angles of motor and link while the link is below the horizontal.

    Above, it does not.
    """

    def judged(reach: float, gravity: float = GRAVITY) -> Certificate:
        joint = system(
            Plant(
                arm=ElasticJoint(),
                parameters={"b1": 0.5, "b2": 0.5, "g": gravity},
                x0=[HANGING, HANGING, 0, 0],
            )
        )
        joint = joint if sampling is None else sample_plant(joint, sampling, 1)
        about, size = np.array([HANGING, HANGING, 0, 0, 0]), np.array([2.0, reach, 10, 10, 20])
        return certify_on(joint, np.zeros((4, 1)), ONE, Box(about - size, about + size))

    assert judged(1.2).certified
    above, table = judged(1.7), judged(1.2, 0.0)
    assert not above.certified
    assert "at x = [" in above.reason
    assert "unstable" in above.reason
    assert not table.certified
    assert "width identifiable, centre not: add a spring, gravity, an absolute" in table.reason
    assert "reference pulse, or a known start" in table.reason


def test_a_rigid_arm_has_none_on_a_table_and_some_where_it_hangs() -> None:
    def judged(gravity: float, size: float, damping: float) -> Certificate:
        arm = system(
            Plant(
                arm=TwoLink(),
                parameters={"b1": damping, "b2": damping, "g": gravity},
                x0=[HANGING, 0, 0, 0],
            )
        )
        about = np.array([HANGING, 0, 0, 0, 0, 0])
        return certify_on(arm, np.zeros((4, 2)), np.ones(2), Box(about - size, about + size))

    table, hanging = judged(0.0, 0.3, 1.0), judged(GRAVITY, 0.05, 5.0)
    assert not table.certified
    assert "of the widths only their sum can be known" in table.reason
    assert "a known start" in table.reason
    assert hanging.certified, hanging.reason


def test_an_inverted_pendulum_has_none() -> None:
    found = certify_on(pendulum(1.5, -GRAVITY), NONE, ONE, ranges(0.3, 1, 1))
    assert not found.certified
    assert found.reason.startswith("at x = [0, 0], u = [0] the model is unstable")


def test_a_proof_that_needs_too_many_parts_is_not_certified() -> None:
    found = certify_on(pendulum(1.5), NONE, ONE, ranges(1.25, 5, 10), parts=3)
    assert not found.certified
    assert "not proved: one V serves the Jacobians at" in found.reason


def test_designed_gains_are_certified_and_those_of_a_linear_plant_are_the_passive_ones() -> None:
    plant = random_plant(np.random.default_rng(3), 3)
    gains = design_on(plant, ONE, ranges(1, 1, 1, 1)).dynamics.L
    assert gains == pytest.approx(passive_gain(plant.linear, None), rel=1e-4)
    found = design_on(pendulum(1.5), ONE, ranges(1.2, 5, 10))
    assert found.certified
    assert np.linalg.norm(found.dynamics.L) > 0
    with pytest.raises(
        StructureError, match=r"no gains can be certified on the region: at x = \[0, 0\]"
    ):
        design_on(pendulum(1.5, -GRAVITY), ONE, ranges(0.3, 1, 1))
    with pytest.raises(InputError, match="continuous time"):
        design_on(sample_plant(pendulum(1.5), 0.01), ONE, ranges(0.3, 1, 1))


def test_what_is_not_smooth_or_bends_the_output_is_refused() -> None:
    kinked = system(Plant(f=["v", "-q - v - 0.1 * abs(v - 2) + u"], h=["q"], states=["q", "v"]))
    with pytest.raises(
        InputError,
        match="region: the model cannot be certified on it: a condition, sign, abs, min or max",
    ):
        certify_on(kinked, NONE, ONE, ranges(1, 3, 1))
    assert certify_on(kinked, NONE, ONE, ranges(1, 1, 1)).certified
    # The Jacobian of this one is constant wherever it exists.
    jumping = system(Plant(f=["v", "-q - v - 0.1 * sign(v) + u"], h=["q"], states=["q", "v"]))
    with pytest.raises(InputError, match="a condition, sign, abs, min or max"):
        certify_on(jumping, NONE, ONE, ranges(1, 3, 1))
    bent = system(Plant(f=["v", "-q - v + u"], h=["sin(q)"], states=["q", "v"]))
    with pytest.raises(InputError, match="outputs that are affine"):
        certify_on(bent, NONE, ONE, ranges(1, 1, 1))
    rubbing = system(
        Plant(
            arm=ElasticJoint(),
            parameters={"f1": 0.5, "b1": 0.5, "b2": 0.5},
            x0=[HANGING, HANGING, 0, 0],
        )
    )
    about = np.array([HANGING, HANGING, 0, 0, 0])
    near = Box(about - 0.5, about + 0.5)
    assert certify_on(rubbing, np.zeros((4, 1)), ONE, near).certified  # smooth Coulomb friction


def test_errors_of_regions_name_the_key() -> None:
    model = pendulum(1.0)
    assert build_box(Region(x=[[-1, 1], [-2, 2]], u=[-3, 3]), model).high.tolist() == [1, 2, 3]
    assert build_box(
        Region(x=[[-1, 1], [-2, 2]]), model._replace(limit=np.array([4.0]))
    ).low.tolist() == [-1, -2, -4]
    with pytest.raises(InputError, match="region: the model is linear"):
        resolve_scenario(
            scene("""
            region = { x = [[-1, 1], [-2, 2]], u = [-3, 3] }
            """)
        )
    with pytest.raises(InputError, match=r"region\.u: missing"):
        build_box(Region(x=[[-1, 1], [-2, 2]]), model)
    with pytest.raises(
        ShapeError,
        match=r"region\.x: expected 2 x 2 numbers \(one \[lo, hi\] per state\), found 1 x 2",
    ):
        build_box(Region(x=[[-1, 1]], u=[-3, 3]), model)
    with pytest.raises(
        InputError,
        match=r"region\.x\[1\]: a range \[lo, hi\] must have lo < hi, found \[2.0, -2.0\]",
    ):
        build_box(Region(x=[[-1, 1], [2, -2]], u=[-3, 3]), model)


def test_check_judges_a_nonlinear_scenario_on_its_region() -> None:
    table: dict[str, Any] = tables_of("""
        plant.f = ["v", "-9.81 * sin(q) - 1.5 * v + u"]
        plant.h = ["q"]
        plant.states = ["q", "v"]
        plant.x0 = [0.1, 0.0]
        sensor = { right = 0.12, left = 0.05 }
        reference = { kind = "sine", amplitude = 0.5, frequency = 0.5 }
        observer = { method = "certified", L = [1.0, 0.0], gamma = 5.0 }
        controller = { method = "state_feedback", alpha = 10.0 }
        """)

    def judged(region: Any) -> dict[str, Any]:
        return check(scene(**table, region=region)).summary()

    silent = judged(None)
    wide = judged({"x": [[-1, 1], [-4, 4]], "u": [-20, 20]})
    narrow = judged({"x": [[-0.3, 1], [-4, 4]], "u": [-20, 20]})
    assert silent["certified"] is None
    assert any("declared [region]" in reason for reason in silent["reasons"])
    assert (wide["certified"], wide["left_region"]) == (True, None)
    assert narrow["certified"] is True
    assert 0 < narrow["left_region"] < 2


def test_the_depth_of_v_is_the_least_eigenvalue_of_its_inequality() -> None:
    """At any A between and beyond the vertices; over a range it is no more than at any A inside."""
    found = certify_on(pendulum(1.5), np.array([[0.5], [0.3]]), np.array([5.0]), ranges(1.1, 5, 10))
    entries = np.array([1]), np.array([0])  # the stiffness
    of_A = build_inequality_form(found, entries)
    inequality = found.dynamics.inequality(found.W)
    rng = np.random.default_rng(0)
    stiffness = rng.uniform(-12, 0, 50)
    for c, depth in zip(stiffness, of_A.certificate_depth(stiffness[:, None]), strict=True):
        A = found.dynamics.A[0].copy()
        A[1, 0] = c
        (M,) = inequality._replace(A=(A,)).lmi_matrices(found.P)
        assert (depth > 0) == (np.linalg.eigvalsh(-M)[0] > 0)
    middle, loose, turns = np.array([[-8.0]]), np.array([[0.1]]), np.array([[[0.3], [0.2]]])
    within = of_A.depth_within(middle, loose, turns)[0]
    inside = rng.uniform(-8.6, -7.4, (200, 1))
    assert within <= of_A.certificate_depth(inside).min()
    assert of_A.depth_within(middle, np.array([[np.inf]]), turns)[0] == -np.inf


def test_the_size_of_a_symmetric_matrix_bounds_it_from_both_sides() -> None:
    M = np.random.default_rng(0).normal(size=(5, 4, 4))
    M = M + M.swapaxes(1, 2)
    for sign in (1, -1):
        assert np.linalg.eigvalsh(absolute_matrix(M) - sign * M).min() > -1e-12


def test_halves_of_a_box_are_cut_across_the_side_of_most_effect() -> None:
    whole = ranges(2, 1)
    low, high = whole.low[None], whole.high[None]
    effect = np.array([[0.1, 0.3]])
    lows, highs = halve_boxes(low, (low + high) / 2, high, effect, whole)
    assert lows.tolist() == [[-2, -1], [-2, 0]]
    assert highs.tolist() == [[2, 0], [2, 1]]
    narrow = Box(np.array([-0.5, -1.0]), np.array([0.5, 1.0]))
    low, high = narrow.low[None], narrow.high[None]
    lows, _ = halve_boxes(low, (low + high) / 2, high, np.array([[np.inf, 0.0]]), whole)
    assert lows.tolist() == [[-0.5, -1], [-0.5, 0]]  # no bound: the longest against the box


@pytest.mark.parametrize("Ts", [None, 0.04])
def test_slopes_by_the_entries_of_A_are_those_of_the_inequality(Ts: float | None) -> None:
    """M is affine in A, sampled too: a step of 1 in an entry gives its slope, sqrt(Ts) and all."""
    rng = np.random.default_rng(0)
    A, L, P = rng.normal(size=(3, 3)), rng.normal(size=(3, 1)), rng.normal(size=(3, 3))
    P = P + P.T
    errors = Dynamics((A,), np.eye(1, 3), L, np.eye(2), Ts)
    rows, columns = np.array([0, 2, 1]), np.array([1, 2, 0])
    (M,) = errors.inequality(np.ones(1)).lmi_matrices(P)
    slopes = _entry_slopes(P, len(M), Ts, (rows, columns))
    for slope, i, j in zip(slopes, rows, columns, strict=True):
        moved = A.copy()
        moved[i, j] += 1.0
        (other,) = errors._replace(A=(moved,)).inequality(np.ones(1)).lmi_matrices(P)
        assert slope == pytest.approx(other - M, abs=1e-12)


@pytest.mark.parametrize("turns", [0, 10**4, 10**7])
def test_a_wave_s_top_near_the_end_of_an_interval_is_inside(turns: int) -> None:
    """Reduction by 2 pi errs by more than the last bit for large angles; the bound may not."""
    x = ca.SX.sym("x")
    for function, top in ((ca.sin, np.pi / 2), (ca.cos, 0.0)):
        angle = 2 * np.pi * turns + top
        short = 0.3e-12 * (1 + angle)
        waves = build_enclosure(ca.Function("wave", [x], [function(x)]))
        for sign, end in ((1.0, "high"), (-1.0, "low")):
            place = angle + (np.pi if sign < 0 else 0.0)
            for low, high in ((place - 0.5, place + short), (place - short, place + 0.5)):
                (bound,) = waves([Interval(np.array([[low]]), np.array([[high]]))])
                assert float(getattr(bound, end)[0, 0]) == sign
