"""Members of a bank that share a graph."""

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np
import pytest

from undeadzone.numerics.gaussian import Gaussian
from undeadzone.observers.filtering.multiple_models import share_step_graph

CALLED: list[int] = []


def corrected(belief: Gaussian, y: Any) -> Gaussian:
    """A Gaussian after a reading of its first entry."""
    CALLED.append(1)
    gain = belief.cov[:, 0] / (belief.cov[0, 0] + 1.0)
    return Gaussian(belief.mean + gain * (y - belief.mean[0]), belief.cov - gain @ belief.cov[0, :])


def evaluated(
    calls: Sequence[tuple[Any, ...]], y: Any, long: float
) -> tuple[ca.Function, list[Any]]:
    """The graph of all members, and its numbers at a reading of 0.7."""
    results = share_step_graph(corrected, calls, long)
    graph = ca.Function("all", [y], [ca.veccat(*one) for one in results])
    return graph, [np.asarray(one) for one in graph(0.7)]


@pytest.mark.parametrize("long", [0, 10**6])
def test_members_are_traced_once_and_inlined_if_they_are_short(long: int) -> None:
    y = ca.SX.sym("y")
    cov = ca.SX([[2.0, 0.5], [0.5, 1.0]]) * ca.exp(y)
    calls = [(Gaussian(ca.SX([k, 1.0]), k * cov), y) for k in (1.0, 2.0, 3.0)]
    CALLED.clear()
    graph, found = evaluated(calls, y, long)
    assert len(CALLED) == 1
    assert len(graph.find_functions()) == (1 if long == 0 else 0)
    alone = ca.Function("alone", [y], [ca.veccat(*corrected(*call)) for call in calls])
    for one, expected in zip(found, alone(0.7), strict=True):
        np.testing.assert_allclose(one, expected, rtol=1e-14)


def test_equal_entries_are_passed_once() -> None:
    """Of a covariance its triangle."""
    y, off = ca.SX.sym("y"), ca.SX.sym("off")
    cov = ca.vertcat(ca.horzcat(2.0, off), ca.horzcat(off, 1.0))
    calls = [(Gaussian(ca.vertcat(k * y, off), cov), y) for k in (1.0, 2.0)]
    results = share_step_graph(corrected, calls, 0)
    graph = ca.Function("all", [y, off], [ca.veccat(*one) for one in results])
    (member,) = graph.find_functions()
    assert member.nnz_in() == 5  # y is no mean of both: k y, off, 2, 1, y


def test_leaves_may_be_rows_and_sparse_matrices() -> None:
    y = ca.SX.sym("y")
    row, sparse = ca.horzcat(y, 2.0), ca.diag(ca.vertcat(y, 3.0))
    results = share_step_graph(lambda a, b: (2 * a, b @ b), [(row, sparse), (row + 1, sparse)], 0)
    graph = ca.Function("all", [y], [ca.densify(leaf) for leaf in sum(results, ())])
    found = [np.asarray(each) for each in graph(2.0)]
    np.testing.assert_array_equal(found[2], [[6.0, 6.0]])
    np.testing.assert_array_equal(found[3], [[4.0, 0.0], [0.0, 9.0]])
