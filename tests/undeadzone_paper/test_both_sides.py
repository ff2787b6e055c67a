"""Both sides of the paper's equations: what agrees as printed, what as mended, and V' itself."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from undeadzone_paper import Paper
from undeadzone_paper.both_sides import _error_at_zero_V, _signed_sides, compare_sides
from undeadzone_paper.equations import EQUATIONS

ROUNDING = 1e-12
AGREE = (1, 3, 4, 7, 14, 17, 18, 34, 38, 39)  # as printed


def test_every_equation_is_computed(paper: Paper) -> None:
    assert list(paper.sides) == [equation.number for equation in EQUATIONS]
    assert paper.sides == compare_sides(paper.evidence)


def test_only_these_equations_agree_as_printed(paper: Paper) -> None:
    agree = [number for number, sides in paper.sides.items() if sides.printed <= ROUNDING]
    assert tuple(agree) == AGREE


def test_what_is_mended_agrees(paper: Paper) -> None:
    mended = {number for number, sides in paper.sides.items() if sides.mended is not None}
    assert mended >= {*range(19, 25), 26, 27, 28}
    for number in mended:
        value = paper.sides[number].mended
        assert value is not None
        assert value <= ROUNDING, number


def test_the_law_of_the_observer_holds_along_the_run_that_is_judged(paper: Paper) -> None:
    """The run of Theorem 4.1 by differences of its own samples, not by its equations."""
    run = paper.evidence.law[0]
    x_moved = np.gradient(run.x_hat, run.t, axis=0)[1:-1]
    A = np.array([[0.0, 1.0], [-1.0, -2.0]])
    by_16 = run.x_hat @ A.T + np.outer(run.innovation[:, 0], [-1.25, -1.62])
    smooth = np.abs(x_moved - by_16[1:-1]).max(axis=1)
    assert np.median(smooth) < 1e-4
    assert np.quantile(smooth, 0.98) < 0.05 * np.abs(by_16).max()


def test_the_left_side_of_36_is_the_derivative_of_30_along_the_run(paper: Paper) -> None:
    """By differences of V where neither y nor y^ has a kink; C Q C' = 1."""
    run = paper.evidence.law[0]
    assert run.V is not None
    estimated = np.sign(run.z_hat[:, 0] - np.clip(run.z_hat[:, 0], *_edges(run.d_hat)))
    sides = np.stack([run.side[:, 0], estimated])
    smooth = (sides[:, 2:] == sides[:, :-2]).all(axis=0)
    V_moved = np.gradient(run.V, run.t)[1:-1]
    e = run.innovation[1:-1, 0]
    largest = np.abs(V_moved + e**2)[smooth].max()
    assert largest == pytest.approx(paper.sides[36].printed, rel=0.03)


def _edges(d_hat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return -d_hat[:, 1], d_hat[:, 0]


def test_35_and_36_agree_with_one_another_and_with_the_run_nowhere(paper: Paper) -> None:
    assert paper.sides[35].printed == pytest.approx(paper.sides[36].printed)
    for number in (31, 32, 33, 35, 36):
        assert paper.sides[number].printed > 100.0


def test_the_mended_indicator_is_that_of_the_side_that_was_read() -> None:
    read = _signed_sides(np.array([1.0, 0.0, -1.0]))
    np.testing.assert_array_equal(read, [[1.0, 0.0], [0.0, 0.0], [0.0, -1.0]])


@pytest.mark.parametrize(
    ("V", "unseen"), [([0.0, 1.0, 2.0], 0.3), ([1.0, 1.0, 1.0], 0.0), ([0.0, 0.0, 0.0], 9.0)]
)
def test_an_error_is_unseen_where_V_is_0_and_only_there(V: Any, unseen: float) -> None:
    error = np.array([[0.1, -0.3], [5.0, 0.0], [0.0, 9.0]])
    run: Any = SimpleNamespace(V=np.array(V), x=error, x_hat=0 * error)
    assert _error_at_zero_V(run) == unseen
