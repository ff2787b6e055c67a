"""What mutants changed unnoticed: each test holds what a function promises."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.stats import truncnorm
from test_identifiability import visiting
from test_nonlinear import Trial, swinging

from scenes import PAPER_PLANT
from undeadzone.analysis.branch_schedule import noiseless_reading
from undeadzone.analysis.certificate.nearest import _resolvent_at
from undeadzone.analysis.dissipation import _least_eigenvalue_and_rounding
from undeadzone.analysis.error_dynamics import adaptation_matrix
from undeadzone.analysis.identifiability.flanks import flank_visits
from undeadzone.analysis.identifiability.information import ReadingConditions
from undeadzone.analysis.identifiability.linear import unobservable_changes
from undeadzone.analysis.identifiability.play_and_zone import _single_contact_reason, gap_prior_rows
from undeadzone.errors import InputError
from undeadzone.interfaces import Reading
from undeadzone.linalg.matrices import Matrices
from undeadzone.nonlinearities.sensor import Sensor, resolve
from undeadzone.numerics.gaussian import Bound, Gaussian, truncate_at_bounds
from undeadzone.observers.adaptive.adaptation_laws import LeastSquares
from undeadzone.observers.adaptive.output_error import read_adapted_widths
from undeadzone.observers.contact_filter.drive import (
    _link_mobility,
    _link_variance,
    build_drive,
    join_posteriors,
    mean_posture,
)
from undeadzone.observers.contact_filter.modes import Layout, Posterior, condition_on_impact
from undeadzone.observers.filtering.constant_states import add_friction_state
from undeadzone.observers.filtering.gaussian_filter import FAR, clip_to_ranges, width_excess_square
from undeadzone.observers.filtering.innovation_tests import (
    FORETOLD,
    score_squares,
    start_scores,
    update_scores,
)
from undeadzone.observers.filtering.motion_detection import update_line
from undeadzone.observers.filtering.prior import _read_branch_ranges
from undeadzone.plants.robots.build import build_two_link
from undeadzone.plants.robots.geared import Gears, build_geared_arm


def test_a_range_below_0_of_one_output_is_refused() -> None:
    with pytest.raises(InputError, match="0 <= lo < hi"):
        _read_branch_ranges("observer.right", [[-0.5, 1.0], [0.0, 1.0]], 2)


def of_scores(y: float, last: float, slope: float) -> Any:
    """Scores of one output after a reading that is not what was foretold."""
    doubt = SimpleNamespace(
        keep=0.5, stays=0.1, noisy=0, push=np.zeros((1, 1)), means=np.zeros(3), reach=100.0, run=9
    )
    q = SimpleNamespace(doubt=doubt, slope=slope)
    before = start_scores(1)._replace(last=np.array([last]))
    zero = ca.SX(1, 1)
    nu = ca.SX(FORETOLD + 1)
    return update_scores(q, before, nu, nu, zero, zero, Reading(ca.SX(y), ca.SX(1.0)), zero)


def test_where_readings_stay_is_told_in_units_of_z() -> None:
    """A sensor of slope 4 that is stuck at 8 rests at z = 2."""
    assert float(of_scores(8.0, 8.0, 4.0).rest) == pytest.approx(0.5 * 2.0)


@pytest.mark.parametrize(("y", "held"), [(8.0, 0.5), (0.0, 0.0)])
def test_a_silent_sensor_is_not_held_for_a_stuck_one(y: float, held: float) -> None:
    assert float(of_scores(y, y, 1.0).held) == held


def test_what_readings_alone_say_is_the_belief_without_its_prior() -> None:
    """A uniform prior's variance on [0, 2], readings that say 5 +- .1: 3 beyond the range."""
    low, high, told, noise = 0.0, 2.0, 5.0, 0.01
    prior = (high - low) ** 2 / 12
    variance = 1 / (1 / prior + 1 / noise)
    mean = variance * (1.0 / prior + told / noise)
    q: Any = SimpleNamespace(ranges=np.array([[low, high]]))
    belief = Gaussian(ca.SX([0.0, mean]), ca.diag(ca.SX([1.0, variance])))
    assert float(width_excess_square(1, q, belief)) == pytest.approx((told - high) ** 2)


@pytest.mark.parametrize(("times", "gained"), [(0.9, False), (1.1, True)])
@pytest.mark.parametrize("std", [0.1, 10.0])
def test_a_width_far_beyond_its_range_refutes_its_claim(
    times: float, gained: bool, std: float
) -> None:
    q: Any = SimpleNamespace(ranges=np.array([[0.0, 2.0]]))
    excess = times * FAR * std
    belief = Gaussian(ca.SX([0.0, 2.0 + excess]), ca.diag(ca.SX([1.0, std**2])))
    after, _ = clip_to_ranges(1, q, belief, doubts=True)
    assert float(after.mean[1]) == 2.0
    assert float(after.cov[1, 1]) == pytest.approx(std**2 + gained * excess**2)


def test_a_bound_that_is_no_fake_cuts_as_a_truncated_normal() -> None:
    mean, std, end = 0.3, 0.8, 0.5
    belief = Gaussian(ca.SX([mean]), ca.SX([[std**2]]))
    bound = Bound(ca.SX([[1.0]]), mean - end, 1.0)
    after = truncate_at_bounds(belief, [bound], 0.0, 10.0).belief
    exact = truncnorm(-np.inf, (end - mean) / std, mean, std)
    assert float(after.mean) == pytest.approx(exact.mean(), rel=1e-9)
    assert float(after.cov) == pytest.approx(exact.var(), rel=1e-9)


def test_a_line_goes_through_the_first_two_readings() -> None:
    sensor: Any = SimpleNamespace(noise=np.array([0.1]))
    q: Any = SimpleNamespace(gains=(0.01, 0.0001), window=50.0)
    level, slope, known = ca.SX(1, 1), ca.SX(1, 1), ca.SX(1, 1)
    for y in (2.0, 5.0, 8.0):
        state: Any = SimpleNamespace(level=level, slope=slope, known=known)
        level, slope, known = update_line(sensor, q, state, ca.SX(y), ca.SX(1.0))
        assert float(level) == pytest.approx(y)
    assert float(slope) == pytest.approx(3.0)
    assert float(known) == 3.0


def test_a_line_rests_on_one_reading_less_where_one_is_missing() -> None:
    sensor: Any = SimpleNamespace(noise=np.array([0.1]))
    q: Any = SimpleNamespace(gains=(0.01, 0.0001), window=50.0)
    state: Any = SimpleNamespace(level=ca.SX(8.0), slope=ca.SX(3.0), known=ca.SX(3.0))
    level, slope, known = update_line(sensor, q, state, ca.SX(0.0), ca.SX(0.0))
    assert [float(level), float(slope), float(known)] == [11.0, 3.0, 2.0]


def test_a_jump_sensor_adapts_no_width_of_any_output() -> None:
    model: Any = SimpleNamespace(p=2)
    sensor: Any = SimpleNamespace(kind="jump")
    with pytest.raises(InputError, match="Leave gamma out"):
        read_adapted_widths([1.0, 0.0], 0.0, None, model, sensor)


def test_least_squares_are_never_set_back_unless_asked() -> None:
    assert LeastSquares().reset == 0.0


def test_friction_of_one_of_two_loads_that_is_not_known_becomes_an_unknown() -> None:
    inner: Any = SimpleNamespace(
        cov=np.zeros((0, 0)),
        bilinear=None,
        constants=0,
        _replace=lambda **changes: changes,
    )
    sensor: Any = SimpleNamespace(friction_std=np.array([0.3, 0.0]))
    found: Any = add_friction_state(inner, sensor)
    assert np.diag(found["cov"]) == pytest.approx([0.09, 0.0])


GEARS = build_geared_arm(build_two_link(), Gears(half=0.05, inertia=[0.08, 0.03]))


def test_a_link_moves_the_motors_that_others_touch() -> None:
    mean = ca.DM([0.3, 0.8, 0.3, 0.8, *[0.0] * 17])
    arm = mean_posture(GEARS, GEARS.values, mean, ca.DM.zeros(2))
    moved = np.asarray(ca.evalf(_link_mobility(arm, ca.SX([0.5, 1.0]))))
    mass = np.asarray(ca.evalf(ca.SX(arm.mass)))
    first = np.linalg.inv(mass + np.diag([0.0, 0.03]))[0]
    second = np.linalg.inv(mass + np.diag([0.5 * 0.08, 0.0]))[1]
    assert moved == pytest.approx(np.vstack([first, second]))


def test_payloads_of_joints_count_by_their_variance_and_err_alike() -> None:
    stds, payloads, told = np.array([0.1, 0.3]), np.array([0.4, 0.8]), []
    for std, payload in zip(stds, payloads, strict=True):
        mean, cov = ca.SX(Layout(1).entry_count, 1), ca.SX.eye(Layout(1).entry_count)
        mean[-1], cov[-1, -1] = payload, std**2
        told.append(
            Posterior((), (), Gaussian(mean, cov), ca.SX(mean.shape[0], 1), ca.SX(0.0), 1.0)
        )
    whole = join_posteriors(Layout(2), told).whole
    weights = stds**-2.0 / np.sum(stds**-2.0)
    assert float(whole.mean[-1]) == pytest.approx(weights @ payloads)
    assert float(whole.cov[-1, -1]) == pytest.approx((weights @ stds) ** 2)


def test_a_link_is_not_beyond_its_flanks_for_long() -> None:
    layout = Layout(1)
    motor, link, half = (layout.slice_of(name).start for name in ("motor", "link", "half"))
    mean, cov = ca.SX(layout.entry_count, 1), ca.SX.eye(layout.entry_count)
    mean[half], cov[half, half], cov[motor, motor], cov[link, link] = 0.3, 0.01, 0.02, 5.0
    assert float(_link_variance(Gaussian(mean, cov))) == pytest.approx(0.09 + 0.01 + 0.02)


@pytest.mark.parametrize("joint", [0, 1])
def test_a_link_that_struck_half_a_sample_ago_has_the_gap_that_was_foretold(joint: int) -> None:
    """It is as far beyond its flank as motor and link have closed since then."""
    layout, step = Layout(2), 1e-3
    mean = ca.DM.zeros(layout.entry_count)
    mean[layout.slice_of("half")] = 0.05
    mean[layout.slice_of("motor_speed").start + joint] = 2.0
    mean[layout.slice_of("link_speed").start + joint] = -1.0
    mean[layout.slice_of("motor").start + joint] = 0.05 + 3.0 * step / 2
    belief = Gaussian(ca.SX(mean), 1e-4 * ca.SX.eye(layout.entry_count))
    q: Any = SimpleNamespace(model=GEARS.values, slack=1e-8, impact=0.3)
    after = condition_on_impact(build_drive(GEARS, step, 1), q, joint, 1, belief)
    assert float(after.mean[layout.slice_of("half").start + joint]) == pytest.approx(
        0.05, abs=1e-12
    )


def test_scores_of_small_inputs_are_normal_numbers_too() -> None:
    many = start_scores(1)._replace(count=np.array([1e6]), lift=np.ones(1), rise=np.ones(1))
    few = many._replace(lift_square=np.full(1, 0.25), rise_square=np.full(1, 4.0))
    found = score_squares(few)
    assert float(found["slope"]) == pytest.approx(4.0)
    assert float(found["dynamics"]) == pytest.approx(0.25)


def test_a_bound_that_is_not_heard_is_as_likely_as_not() -> None:
    belief = Gaussian(ca.SX([0.0]), ca.SX([[1.0]]))
    silent = Bound(ca.SX([[1.0]]), 0.0, 0.0)
    assert float(truncate_at_bounds(belief, [silent], 0.0, 10.0, fake=ca.SX(-3.0)).likely) == 1.0


@pytest.mark.parametrize(("side", "seen"), [(0, "right"), (1, "left")])
def test_an_output_that_is_read_in_one_contact_alone_is_told_so(side: int, seen: str) -> None:
    """Beyond one of both edges suffices."""
    schedule: Any = None
    read = np.zeros((2, 2), bool)
    read[side, 1] = True
    (words,) = _single_contact_reason(schedule, read, 0)
    assert f"while it moves {seen} alone" in words


def test_what_follows_a_state_that_diverged_tells_nothing() -> None:
    """One of two states leaves all bounds where readings tell; inputs and the other stay small."""
    trial = swinging("pendulum")
    row = 300 + int(np.flatnonzero(trial.side[300:, 0])[0])
    whole = trial._replace(x=trial.x.copy())
    whole.x[row:, 0] = 1e12
    before = Trial(trial.model, trial.x[:row], trial.u[:row], trial.z[:row], trial.sensor)
    assert whole.verdicts()[0].std == before.verdicts()[0].std


def test_the_resolvent_of_samples_reaches_its_limit() -> None:
    A = np.array([[-1.0, 2.0], [0.0, -3.0]])
    assert _resolvent_at(A, np.inf, 0.1) == pytest.approx(_resolvent_at(A, 1e9, 0.1), abs=1e-6)


def test_readings_of_a_play_end_at_both_ends_of_their_range() -> None:
    """On the way down y = z + left, and ends at -1."""
    sensor = resolve(Sensor(kind="play", right=0.4, left=0.3, range=[-1.0, 1.0]), 1, 0.01)
    z = np.array([[0.0], [-1.2], [-1.4], [0.0], [1.3], [1.5]])
    limited = noiseless_reading(z, sensor).limited[:, 0]
    assert limited.tolist() == [False, False, True, False, False, True]


def test_a_load_of_one_sign_presses_on_one_flank() -> None:
    tau = np.concatenate([np.zeros(500), np.ones(500), np.zeros(500)])[:, None]
    (found,) = flank_visits(tau, 0.01, np.array([0.1]))
    assert found == (True, False, 0)


def test_gaps_that_are_known_have_no_error_in_any_output() -> None:
    linear = Matrices(-np.eye(2), np.eye(2), np.eye(2))
    readings = ReadingConditions(np.full(2, 0.1), 0.01, 1.0, gaps_known=True)
    rows = gap_prior_rows(linear, readings, 1.0)
    gaps = np.eye(2 + 6 * 2)[2:6]
    assert (rows @ gaps.T).any(axis=0).all()
    for gap in gaps:
        assert (rows == gap).all(axis=1).sum() == 1


def test_a_jump_tells_nothing_of_widths_by_its_readings() -> None:
    hidden = unobservable_changes(PAPER_PLANT.linear, np.array([[True, True]]), jump=True)
    assert not hidden.is_width_known(0, "right")
    assert not hidden.is_width_known(0, "left")
    seen = unobservable_changes(
        PAPER_PLANT.linear, visiting([True], [True]).branch_visits(2), jump=False
    )
    assert seen.is_width_known(0, "right")


def test_no_edge_may_have_a_negative_gain() -> None:
    with pytest.raises(InputError, match="must not be negative, found -1"):
        adaptation_matrix([[-1.0, 2.0]], 1)


def test_the_bound_on_rounding_grows_with_what_is_summed() -> None:
    bounds = [
        _least_eigenvalue_and_rounding(np.eye(3), size * np.ones((3, 3)))[1]
        for size in (1.0, 100.0, 1000.0)
    ]
    assert bounds[0] > 3 * np.finfo(float).eps
    assert bounds[2] > 5 * bounds[1] > 25 * bounds[0]
