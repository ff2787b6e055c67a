"""What further mutants changed unnoticed: as in test_signs.py, each test guards one line."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.stats import norm
from test_identifiability import visiting

from scenes import PAPER_PLANT, linear
from undeadzone.analysis.branch_schedule import drop_rare_branches, schedule_of_record
from undeadzone.analysis.certificate.passivity import certify
from undeadzone.analysis.convergence import trajectories
from undeadzone.analysis.convergence.floquet import integrate_spans
from undeadzone.analysis.convergence.trajectories import worst_settling_time
from undeadzone.analysis.dissipation import Inequality, check_inequality
from undeadzone.analysis.identifiability import nonlinear
from undeadzone.analysis.identifiability.information import ReadingConditions, optimal_deviations
from undeadzone.analysis.identifiability.sensor_and_actuator import sensor_actuator_identifiability
from undeadzone.errors import InputError, StructureError
from undeadzone.interfaces import Estimate, Reading
from undeadzone.linalg import riccati
from undeadzone.linalg.matrices import Matrices
from undeadzone.linalg.poles import pole_placement_gain
from undeadzone.nonlinearities.sensor import Sensor, resolve
from undeadzone.numerics.dense_output import Levels, _find_crossing
from undeadzone.numerics.gaussian import TAIL
from undeadzone.observers import Kalman
from undeadzone.observers.adaptive.adaptation_laws import e_modification_move
from undeadzone.observers.adaptive.branch_observer import correct_jump
from undeadzone.observers.filtering.augmented_state import white_disturbance_rms
from undeadzone.observers.filtering.consistency import LOST, widen_intervals
from undeadzone.observers.filtering.constant_states import information_shares, subtract_friction
from undeadzone.observers.filtering.innovation_tests import start_scores
from undeadzone.observers.filtering.measurement_update import reject_impossible
from undeadzone.observers.filtering.prior import _read_noise as claimed_noise
from undeadzone.observers.filtering.unknown_inputs import read_time_span
from undeadzone.plants.system import sample_plant
from undeadzone_arena.observers.parts import learned_residual
from undeadzone_arena.observers.parts.boxes import cut_box
from undeadzone_arena.observers.parts.joint_claims import (
    CROWD,
    JointAssumptions,
    JointDefaults,
    build_joint_prior,
    glitch_probability,
)

ZONE = resolve(Sensor(right=1.0, left=1.0), 1, 0.01)


@pytest.mark.parametrize(("lost", "state"), [("right", "x[0]"), ("left", "x[1]")])
def test_the_state_that_shifts_is_that_of_the_lost_edge(
    monkeypatch: pytest.MonkeyPatch, lost: str, state: str
) -> None:
    """Of output 1: its right edge hides behind x[0], its left one behind x[1]."""
    monkeypatch.setattr(nonlinear, "symmetric", lambda model, change: False)
    hidden: Any = SimpleNamespace(scale=np.ones(4), basis=np.eye(4)[:, 2:])
    hidden.restrict_to_part = lambda part: SimpleNamespace(
        basis=hidden.basis, is_width_known=lambda i, name: False
    )
    known: Any = SimpleNamespace(hidden=hidden, follow=np.eye(2, 4, k=2))
    model: Any = SimpleNamespace(arm=None, n=2)
    words = nonlinear._describe_state_shift(model, known, 1, lost, "edge", "rest")
    assert f"along this run {state} can shift with the edges" in words


@pytest.mark.parametrize("larger", [0, 1])
def test_readings_without_noise_are_as_exact_as_the_larger_edge(larger: int) -> None:
    stds = []
    for levels in ([1.0, 1.0], [8.0, 8.0], np.eye(2)[larger] * 7 + 1):
        schedule = visiting([True], [True])._replace(levels=np.array([levels]))
        known = optimal_deviations(
            PAPER_PLANT.linear, schedule, ReadingConditions(np.zeros(1), 0.01, 15.0)
        )
        stds.append(known.widths[0]["width"])
    assert stds[1] == pytest.approx(8 * stds[0], rel=1e-9)
    assert stds[2] == pytest.approx(stds[1], rel=1e-9)


def test_a_recorded_side_changes_half_way_between_two_samples() -> None:
    sensor = resolve(Sensor(right=1.0, left=1.0), 1, 0.1)
    z = np.array([0.0, 0.0, 0.0, 3.0, 3.0, -3.0, -3.0])[:, None]
    schedule = schedule_of_record(z, sensor, 0.1, None)
    np.testing.assert_allclose(schedule.sides[:, 0], [0.0, 1.0, -1.0])
    np.testing.assert_allclose(schedule.spans, [0.25, 0.2, 0.15], rtol=1e-12)


def test_a_side_is_lost_by_its_own_readings() -> None:
    """Of 100 readings on the right and 2 on the left, half are missing."""
    sides, spans = np.array([[1.0], [0.0], [-1.0]]), np.array([1.0, 0.5, 0.02])
    schedule = visiting([True], [True])._replace(sides=sides, spans=spans)
    judged = drop_rare_branches(schedule, np.array([0.5]), 0.01, spans.sum(), 2)
    np.testing.assert_array_equal(judged.sides[:, 0], [1.0, 0.0, 0.0])


def test_a_filter_that_is_lost_knows_no_more_than_the_prior() -> None:
    """About what is shown: prior edges at 1 and 2 with deviations 0.3 and 0.4, shown at 1.4, 1.7.

    The two are independent. A state of deviation 2 about 0 is shown at 1.5.
    """
    doubt = SimpleNamespace(std=np.array([2.0, 2.0, 0.3, 0.4]), most=10.0, limit=10.0, keep=0.5)
    q: Any = SimpleNamespace(doubt=doubt, mean=np.array([0.0, 0.0, 1.0, 2.0]))
    one, none = ca.SX(1.0), ca.SX(0, 1)
    record: Any = SimpleNamespace(
        ratio=one,
        offset=0 * one,
        share=one * (LOST + 0.1),
        constant=none,
        opened=none,
        scores=start_scores(1),
    )
    blind = Estimate(*[ca.SX(0.0)] * len(Estimate._fields))._replace(
        x=ca.SX([1.5, 0.0]), right=ca.SX(1.4), left=ca.SX(1.7), x_std=ca.SX([0.0, 0.0])
    )
    found = widen_intervals(SimpleNamespace(n=2, p=1), q, record, blind)  # type: ignore[arg-type]
    values = [float(std) for std in (found.right_std, found.left_std, found.width_std)]
    assert values == pytest.approx([0.5, 0.5, np.sqrt(0.5)], rel=1e-12)
    assert ca.DM(found.x_std).full()[:, 0] == pytest.approx([2.5, 2.0])


def test_a_bias_that_does_nothing_tells_as_much_of_an_actuator() -> None:
    drive: Any = SimpleNamespace(slope_right=1.0, slope_left=1.0)
    modes, schedule = np.array([[1.0], [-1.0], [0.0]]), visiting([True], [True])
    without, with_bias = (
        sensor_actuator_identifiability(PAPER_PLANT.linear, schedule, modes, drive, bias)
        for bias in (None, np.zeros((2, 1)))
    )
    assert without.inputs == with_bias.inputs
    assert without.inputs[0].width
    assert without.outputs == with_bias.outputs


def test_the_chance_of_a_glitch_is_that_of_bayes() -> None:
    """A reading of a Gaussian, or one that is evenly spread over reach and tails."""
    e, std, share, reach = np.array([0.3, 2.0]), np.array([0.5, 0.4]), 0.1, 5.0
    doubt: Any = SimpleNamespace(glitch=np.log(share / (1 - share)), reach=np.full(2, reach))
    wrong, right = share / (reach + TAIL * std), (1 - share) * norm.pdf(e, scale=std)
    np.testing.assert_allclose(
        glitch_probability(doubt, e, std), wrong / (wrong + right), rtol=1e-12
    )


def test_unknown_friction_is_taken_off_what_drives() -> None:
    """It stands ahead of `after` other unknowns."""
    sensor: Any = SimpleNamespace(friction_std=np.array([0.1]))
    X = np.array([1.0, 2.0, 0.5, 7.0])
    given = subtract_friction(sensor, 1, lambda X: 10.0, -1.0)(X)
    assert given == 10.5


def test_one_output_without_noise_is_no_claim() -> None:
    assert claimed_noise([0.1, 0.2], 2).tolist() == [0.1, 0.2]
    with pytest.raises(InputError, match="must be positive, found 0"):
        claimed_noise([0.1, 0.0], 2)


def test_a_time_is_resolved_from_a_tenth_of_a_sample_on() -> None:
    for time in (0.101, 0.99e6):
        assert read_time_span("washout", time * 0.02, 0.02) == time * 0.02
    for time in (0.099, 1.01e6):
        with pytest.raises(InputError, match=r"between 0\.1 and 1e6 sample times"):
            read_time_span("washout", time * 0.02, 0.02)


def test_unknowns_behind_gaps_are_taken_for_told() -> None:
    """One other unknown, a gap of which half the variance is left, two widths of an actuator."""
    model: Any = SimpleNamespace(n=1, p=1)
    cov = ca.SX(np.diag([1.0, 0.75, 1.0, 3.0, 0.5, 5.0, 6.0]))
    zones = SimpleNamespace(middle=np.zeros(2))
    doubt = SimpleNamespace(std=np.ones(3))
    q: Any = SimpleNamespace(doubt=doubt, gaps=SimpleNamespace(std=np.ones(1)), zones=zones)
    told = ca.DM(information_shares(q, model, cov)).full()[:, 0]
    np.testing.assert_allclose(told, [1.0, 0.5, 0.0, 1.0, np.sqrt(0.5), 1.0, 1.0])


def test_fast_poles_are_placed_as_accurately_as_slow_ones() -> None:
    K = pole_placement_gain(
        np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]]), np.array([-1e5, -2e5]), "K"
    )
    np.testing.assert_allclose(K, [[2e10, 3e5]], rtol=1e-12)


def test_a_filter_whose_claims_are_refuted_gains_the_offset() -> None:
    """The state that is known worst gains all of it, another one as much as it is unknown."""
    doubt = SimpleNamespace(std=np.array([2.0, 1.0, 0.3, 0.4]), most=10.0, limit=10.0, keep=0.5)
    q: Any = SimpleNamespace(doubt=doubt, mean=np.zeros(4))
    one, none = ca.SX(1.0), ca.SX(0, 1)
    record: Any = SimpleNamespace(
        ratio=16.0 * one,
        offset=0.3 * one,
        share=0 * one,
        constant=none,
        opened=none,
        scores=start_scores(1),
    )
    shown = Estimate(*[ca.SX(0.0)] * len(Estimate._fields))._replace(
        x=ca.SX([0.0, 0.0]), right_std=ca.SX(0.1), x_std=ca.SX([0.0, 0.0])
    )
    found = widen_intervals(SimpleNamespace(n=2, p=1), q, record, shown)  # type: ignore[arg-type]
    assert ca.DM(found.x_std).full()[:, 0] == pytest.approx([0.3, 0.15])
    assert float(found.right_std) == pytest.approx(0.5)  # root of (4 * 0.1)^2 + 0.3^2


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


@pytest.mark.parametrize(("edge", "after"), [(0.0, -1.0), (0.1, 0.0)])
def test_a_zone_of_no_width_is_crossed_at_once(edge: float, after: float) -> None:
    levels = Levels((ca.SX(edge),), (ca.SX(-edge),))
    crossing = _find_crossing(ca.SX(-1.0), levels, ca.SX(1.0))
    assert float(crossing[1]) == after
    assert bool(ca.DM(crossing[0]))


def test_a_leak_grows_with_the_way_from_the_first_width() -> None:
    edge: Any = SimpleNamespace(drive=2.0, width=3.0, width0=1.0, gamma=4.0)
    assert float(e_modification_move(0.25, edge)[0]) == 4 * (2 - 0.25 * 2 * (3 - 1))


def test_a_reading_beyond_all_numbers_is_trusted_in_nothing() -> None:
    trusted = reject_impossible(
        ca.SX([0.7, 0.7]), Reading(ca.SX([0.9e300, 1.1e300]), ca.SX([1.0, 1.0]))
    )
    assert ca.DM(trusted).full()[:, 0].tolist() == [0.7, 0.0]


def test_no_edge_lies_below_0() -> None:
    with pytest.raises(InputError, match=r"observer\.right: a range \[lo, hi\] must have 0 <= lo"):
        Kalman(right=[-1.0, 2.0], left=[0.0, 2.0]).build(sample_plant(PAPER_PLANT, 0.01), ZONE)


@pytest.mark.parametrize("window", [2, 4])
def test_a_fair_adversary_takes_each_full_mode_in_every_window(
    monkeypatch: pytest.MonkeyPatch, window: int
) -> None:
    """Though the third mode, which is none, is the one that it likes best."""
    monkeypatch.setattr(trajectories, "_value", lambda V, errors: np.abs(errors).sum(axis=1))
    maps = np.array([0.5, 0.6, 1.1])[:, None, None] * np.eye(2)
    moves = trajectories._Moves(maps, np.array([0, 1]), window)
    V: Any = None
    taken = trajectories._adversary_modes(V, np.ones(2), moves, fair=True)
    for one in taken.reshape(-1, window):
        assert set(one) >= {0, 1}
    assert set(trajectories._adversary_modes(V, np.ones(2), moves, fair=False)) == {2}


@pytest.mark.parametrize("Ts", [None, 0.02])
def test_a_pass_lasts_as_long_as_its_schedule(Ts: float | None) -> None:
    schedule = visiting([True], [True], Ts)
    errors: Any = SimpleNamespace(A=np.zeros((1, 2, 2)), Ts=Ts, C=np.ones((1, 2)))
    modes = trajectories._modes_of_schedule(errors, schedule, 2 * schedule.total_duration)
    lengths = schedule.spans * (Ts or 1.0)
    assert [mode.seconds for mode in modes[:6]] == pytest.approx([*lengths, *lengths])


def test_what_does_not_move_grows_as_time_and_its_square() -> None:
    schedule = visiting([True], [True])
    still = integrate_spans(np.zeros((3, 2, 2)), [np.eye(2)], schedule, 1)
    for k, t in enumerate(schedule.spans):
        np.testing.assert_allclose(still.G[0, k], t * np.eye(2), rtol=1e-12)
        np.testing.assert_allclose(still.GG[0, k], t**2 / 2 * np.eye(2), rtol=1e-12)


def test_errors_may_need_many_passes_to_settle() -> None:
    """A schedule of 1.5 ms, passed thousands of times; the count is the least that suffices."""
    found = certify(PAPER_PLANT.linear, np.array([[1.0], [1.5]]), np.array([10.0]))
    usual = visiting([True], [True])
    brief = usual._replace(spans=usual.spans / 1000)
    slow = worst_settling_time(found.dynamics, found.V, usual)
    fast = worst_settling_time(found.dynamics, found.V, brief)
    assert slow is not None
    assert fast is not None
    assert fast / brief.total_duration > 1000
    assert fast == pytest.approx(slow, rel=0.5)


def test_the_margin_that_a_check_shows_is_that_of_the_worst_matrix() -> None:
    """Two supplies, -1 and -0.1 off the diagonal: eigenvalues -1 + 0.9 and -1 + 0.1."""
    A = (np.array([[-1.0, 0.0], [0.0, -1.0]]),)
    supplies = tuple(2 * np.array([[0.0, c], [c, 0.0]]) for c in (0.9, 0.1))
    sizes = tuple(np.abs(supply) for supply in supplies)
    proof = check_inequality(Inequality(A, np.zeros((2, 0)), supplies, sizes, None, 0.0), np.eye(2))
    assert proof.proved
    assert proof.lmi == pytest.approx(-0.1, rel=1e-12)


def test_a_gain_of_which_some_entries_are_not_finite_is_refused() -> None:
    """The square of the last entry of A overflows, which spoils one entry of K."""
    A, B = np.array([[0.0, 1.0], [1.0, 1e200]]), np.array([[0.0], [1.0]])
    with np.errstate(all="ignore"), pytest.raises(StructureError, match="too far apart"):
        pole_placement_gain(A, B, np.array([-1.0, -2.0], complex), "controller.poles")


def test_a_refinement_that_does_not_halve_the_residual_is_not_taken(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Newton's step is bent such that the residual falls to 0.8 of what it was."""
    A, B = np.array([[-1.0]]), np.array([[1.0]])
    exact = np.sqrt(2) - 1
    monkeypatch.setattr(riccati, "_solution", lambda equation: np.array([[exact + 1e-3]]))
    monkeypatch.setattr(riccati, "storage_of", lambda *_: np.array([[-2e-4]]))
    found = riccati.solve_riccati(Matrices(A, B, np.eye(1)), np.eye(1), np.eye(1))
    assert found.P[0, 0] == exact + 1e-3
    monkeypatch.setattr(riccati, "storage_of", lambda *_: np.array([[-6e-4]]))
    found = riccati.solve_riccati(Matrices(A, B, np.eye(1)), np.eye(1), np.eye(1))
    assert found.P[0, 0] == exact + 1e-3 - 6e-4


def test_one_stable_pole_does_not_make_the_sampled_gain_of_34_stable() -> None:
    plant = Matrices(np.diag([3.0, 0.1]), np.array([[1.0], [1.0]]), np.eye(2))
    with pytest.raises(StructureError, match="does not stabilise"):
        riccati.paper_feedback(plant, 1.0, np.eye(2), 1.0)


@pytest.mark.parametrize("times", [1, 4])
def test_the_noise_of_crowded_readings_grows_with_their_root(times: int) -> None:
    """`times` CROWD readings in a quarter period of the paper's plant, pi / 2 s."""
    plant = linear([[0.0, 1.0], [-1.0, -2.0]], [[0.0], [1.0]], [[1.0, 0.0]])
    model = sample_plant(plant, np.pi / 2 / (times * CROWD))
    sensor = resolve(Sensor(right=1.0, left=1.0), 1, 1e-2)
    claims, defaults = JointAssumptions(right=[0.0, 2.0]), JointDefaults(0.1, 0.0, 1.0)
    found = build_joint_prior(claims, model, sensor, defaults)
    np.testing.assert_allclose(found.prior.R, 0.04 * times, rtol=1e-9)


def test_the_default_disturbance_is_that_of_the_output_that_it_moves_most() -> None:
    both = []
    for C in ([[1.0, 0.0], [0.0, 0.1]], [[2.0, 0.0], [0.0, 0.1]], [[1.0, 0.0], [0.0, 0.05]]):
        plant = linear([[-1.0, 0.0], [0.0, -1.0]], [[1.0], [1.0]], C)
        both.append(float(white_disturbance_rms(sample_plant(plant, 0.01), 1.0)[0]))
    assert both[1] == pytest.approx(both[0] / 2)
    assert both[2] == pytest.approx(both[0])


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


def test_the_state_moves_with_weights_that_reach_their_bounds() -> None:
    """By the sensitivity times what each weight is moved."""
    setup: Any = SimpleNamespace(limited=True, compensator=SimpleNamespace(size=2))
    q: Any = SimpleNamespace(limit=ca.SX([3.0, 5.0]))
    sensitivity = np.arange(1.0, 9.0).reshape(2, 4)
    W = np.array([4.0, -1.0, 2.0, 7.0])  # two of each output; limits 3, 3, 5, 5
    state = learned_residual.LearnedState(
        ca.SX([10.0, 20.0]), ca.SX(W), ca.SX(sensitivity), ca.SX(0)
    )
    after = learned_residual.project_weights(setup, q, state)
    moved = np.array([-1.0, 1.0, 0.0, -2.0])
    np.testing.assert_allclose(ca.DM(after.W).full().ravel(), W + moved)
    expected = np.array([10.0, 20.0]) + sensitivity @ moved
    np.testing.assert_allclose(ca.DM(after.x).full().ravel(), expected)
