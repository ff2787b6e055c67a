"""Parts of the filter of geared arms, on numbers that are known."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import casadi as ca
import numpy as np
import pytest

from undeadzone.numerics.gaussian import Gaussian
from undeadzone.observers.contact_filter.drive import (
    _link_mobility,
    _link_variances,
    build_drive,
    group_couplings,
    join_posteriors,
    mean_posture,
)
from undeadzone.observers.contact_filter.modes import (
    Layout,
    Posterior,
    _project_to_bounds,
    condition_on_impact,
)
from undeadzone.plants.robots.build import build_two_link
from undeadzone.plants.robots.geared import Gears, build_geared_arm, largest_couplings

GEARS = build_geared_arm(build_two_link(), Gears(half=0.05, inertia=[0.08, 0.03]))
ALONE = ((0,), (1,))  # a filter for each joint


@pytest.mark.parametrize("groups", [ALONE, ((0, 1),)])
def test_a_link_moves_the_motors_that_joints_of_other_filters_touch(groups: Any) -> None:
    mean = ca.DM([0.3, 0.8, 0.3, 0.8, *[0.0] * 17])
    arm = mean_posture(Layout(2), GEARS, GEARS.values, mean, ca.DM.zeros(2))
    moved = np.asarray(ca.evalf(_link_mobility(arm, groups, ca.SX([0.5, 1.0]))))
    mass = np.asarray(ca.evalf(ca.SX(arm.mass)))
    turned = [np.diag([0.0, 0.03]), np.diag([0.5 * 0.08, 0.0])]
    if groups != ALONE:  # contacts of both are in the filter itself
        turned = [np.zeros((2, 2))] * 2
    rows = [np.linalg.inv(mass + turned[k])[k] for k in range(2)]
    assert moved == pytest.approx(np.vstack(rows))


def test_payloads_of_joints_count_by_their_variance_and_err_alike() -> None:
    stds, payloads, posteriors = np.array([0.1, 0.3]), np.array([0.4, 0.8]), []
    for std, payload in zip(stds, payloads, strict=True):
        mean, cov = ca.SX(Layout(1).entry_count, 1), ca.SX.eye(Layout(1).entry_count)
        mean[-1], cov[-1, -1] = payload, std**2
        news, e, one = ca.SX(mean.shape[0], 1), ca.SX(0.0), ca.SX(1.0)
        posteriors.append(Posterior((), (), Gaussian(mean, cov), news, e, one))
    whole = join_posteriors(Layout(2), ALONE, posteriors).whole
    weights = stds**-2.0 / np.sum(stds**-2.0)
    assert float(whole.mean[-1]) == pytest.approx(weights @ payloads)
    assert float(whole.cov[-1, -1]) == pytest.approx((weights @ stds) ** 2)


def test_a_link_is_not_beyond_its_flanks_for_long() -> None:
    layout = Layout(1)
    motor, link, half = (layout.slice_of(name).start for name in ("motor", "link", "half"))
    mean, cov = ca.SX(layout.entry_count, 1), ca.SX.eye(layout.entry_count)
    mean[half], cov[half, half], cov[motor, motor], cov[link, link] = 0.3, 0.01, 0.02, 5.0
    bounded = _link_variances(Gaussian(mean, cov), 1)
    assert float(bounded) == pytest.approx(0.09 + 0.01 + 0.02)


@pytest.mark.parametrize("seed", range(5))
def test_a_mean_at_a_bound_is_the_most_probable_one(seed: int) -> None:
    """Else readings that ask for more than the bound move the rest of x, again and again."""
    layout, rng = Layout(1), np.random.default_rng(seed)
    size, firmness = layout.entry_count, layout.slice_of("firmness").start
    low, high = np.full(size, -1e300), np.full(size, 1e300)
    high[firmness] = 1.0
    root, mean = rng.normal(size=(size, size)), rng.normal(size=size)
    mean[firmness] = 1.0 + rng.uniform(0.5, 2.0)
    q: Any = SimpleNamespace(low=ca.DM(low), high=ca.DM(high))
    belief = Gaussian(ca.SX(mean), ca.SX(ca.DM(root @ root.T)))
    projected = np.asarray(ca.evalf(_project_to_bounds(layout, q, belief).mean)).ravel()
    # Independent: minimise |root^-1 (x - mean)|^2 with x = 1 at the bound, by least squares.
    free = np.delete(np.arange(size), firmness)
    whitened = np.linalg.inv(root)
    target = whitened @ mean - whitened[:, firmness]
    best = np.linalg.lstsq(whitened[:, free], target, rcond=None)[0]
    assert projected[firmness] == pytest.approx(1.0)
    assert projected[free] == pytest.approx(best, rel=1e-6, abs=1e-6)


def test_a_mean_within_its_bounds_and_a_known_one_stay() -> None:
    layout = Layout(1)
    size = layout.entry_count
    half = layout.slice_of("half").start
    low, high, mean = np.full(size, -1.0), np.full(size, 1.0), np.full(size, 0.5)
    cov = np.eye(size)
    q: Any = SimpleNamespace(low=ca.DM(low), high=ca.DM(high))
    stay = _project_to_bounds(layout, q, Gaussian(ca.SX(mean), ca.SX(ca.DM(cov)))).mean
    assert np.asarray(ca.evalf(stay)).ravel() == pytest.approx(mean)
    mean[half], cov[half, half] = 2.0, 0.0  # no variance to move along
    moved = _project_to_bounds(layout, q, Gaussian(ca.SX(mean), ca.SX(ca.DM(cov)))).mean
    mean[half] = 1.0
    assert np.asarray(ca.evalf(moved)).ravel() == pytest.approx(mean)


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


def test_the_coupling_in_a_posture_is_that_of_the_verdict() -> None:
    """Of joints alone, of a pair beside a third joint, and of all in one filter, which is 1."""
    rng = np.random.default_rng(4)
    root = rng.normal(size=(3, 3))
    mass, inverse = root @ root.T, np.linalg.inv(root @ root.T)
    body = SimpleNamespace(joint_count=3, mass=lambda _, __: mass)
    arm = SimpleNamespace(
        gears=SimpleNamespace(joint_count=3), mass=ca.SX(mass), inverse=ca.SX(inverse)
    )
    for groups in (((0,), (1,), (2,)), ((0, 2), (1,))):
        expected = largest_couplings(cast("Any", body), np.zeros(0), np.zeros((1, 3)), groups)
        found = ca.evalf(group_couplings(groups, cast("Any", arm)))
        assert np.asarray(found).ravel() == pytest.approx([each.ratio for each in expected])
    mass, inverse = mass[:2, :2], np.linalg.inv(mass[:2, :2])
    pair = SimpleNamespace(
        gears=SimpleNamespace(joint_count=2), mass=ca.SX(mass), inverse=ca.SX(inverse)
    )
    found = ca.evalf(group_couplings([(0, 1)], cast("Any", pair)))
    assert np.asarray(found).ravel() == pytest.approx([1.0, 1.0])
