"""Gaussian beliefs that are cut by bounds."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.stats import truncnorm

from undeadzone.numerics.gaussian import Bound, Gaussian, truncate_at_bounds


def test_a_bound_that_is_no_fake_cuts_as_a_truncated_normal() -> None:
    mean, std, end = 0.3, 0.8, 0.5
    belief = Gaussian(ca.SX([mean]), ca.SX([[std**2]]))
    bound = Bound(ca.SX([[1.0]]), mean - end, 1.0)
    after = truncate_at_bounds(belief, [bound], 0.0, 10.0).belief
    exact = truncnorm(-np.inf, (end - mean) / std, mean, std)
    assert float(after.mean) == pytest.approx(exact.mean(), rel=1e-9)
    assert float(after.cov) == pytest.approx(exact.var(), rel=1e-9)


def test_an_unused_bound_leaves_the_likelihood_at_1() -> None:
    belief = Gaussian(ca.SX([0.0]), ca.SX([[1.0]]))
    silent = Bound(ca.SX([[1.0]]), 0.0, 0.0)
    assert float(truncate_at_bounds(belief, [silent], 0.0, 10.0, fake=ca.SX(-3.0)).likely) == 1.0
