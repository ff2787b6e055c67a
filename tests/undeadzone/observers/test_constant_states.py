"""Unknown constants of filters: friction, gaps and widths of an actuator."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from undeadzone.interfaces import Estimate
from undeadzone.numerics.gaussian import Gaussian
from undeadzone.observers.filtering.constant_states import (
    add_friction_state,
    information_shares,
    subtract_friction,
)
from undeadzone.observers.filtering.gaussian_filter import add_unknown_estimates


def test_unknown_friction_is_subtracted_from_the_drive() -> None:
    """It stands ahead of `after` other unknowns."""
    sensor: Any = SimpleNamespace(friction_std=np.array([0.1]))
    X = np.array([1.0, 2.0, 0.5, 7.0])
    given = subtract_friction(sensor, 1, lambda X: 10.0, -1.0)(X)
    assert given == 10.5


def test_unknowns_behind_gaps_count_as_known() -> None:
    """One other unknown, a gap of which half the variance is left, two widths of an actuator."""
    model: Any = SimpleNamespace(n=1, p=1)
    cov = ca.SX(np.diag([1.0, 0.75, 1.0, 3.0, 0.5, 5.0, 6.0]))
    zones = SimpleNamespace(middle=np.zeros(2))
    doubt = SimpleNamespace(std=np.ones(3))
    q: Any = SimpleNamespace(doubt=doubt, gaps=SimpleNamespace(std=np.ones(1)), zones=zones)
    shares = ca.DM(information_shares(q, model, cov)).full()[:, 0]
    np.testing.assert_allclose(shares, [1.0, 0.5, 0.0, 1.0, np.sqrt(0.5), 1.0, 1.0])


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


def test_a_parameter_is_reported_with_its_deviation() -> None:
    """The second of two, beside one state, two widths and 7 +- 0.2 of its change."""
    augmentation = SimpleNamespace(cov=np.zeros((0, 0)), parameters=(1,))
    setup: Any = SimpleNamespace(
        model=SimpleNamespace(n=1, p=1), augmentation=augmentation, shape=SimpleNamespace(first=4)
    )
    q: Any = SimpleNamespace(model=np.array([5.0, 3.0]))
    belief = Gaussian(ca.SX([1.0, 0.1, 0.1, 7.0]), ca.SX(np.diag([1.0, 4.0, 9.0, 0.04])))
    nothing = Estimate(*[np.zeros(0)] * len(Estimate._fields))
    found = add_unknown_estimates(setup, q, nothing, belief, ca.SX(0.0))
    assert float(found.theta) == 10.0
    assert float(found.theta_std) == pytest.approx(0.2)
