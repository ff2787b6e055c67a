"""Trees of arrays as one vector and back: NumPy and CasADi agree on order, names on places."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from undeadzone.util import tree


class Inner(NamedTuple):
    A: Any
    nothing: Any
    b: Any


class Outer(NamedTuple):
    first: Any
    inner: Any
    pair: Any


blocks = st.one_of(
    st.floats(-9, 9),
    arrays(float, array_shapes(max_dims=2, max_side=3), elements=st.floats(-9, 9)),
    st.just(np.empty(0)),
)
trees = st.builds(
    Outer, blocks, st.builds(Inner, blocks, st.none(), blocks), st.tuples(blocks, blocks)
)


def shape(leaf: Any) -> tuple[int, int]:
    """The shape that a leaf has in CasADi."""
    return ca.DM(leaf).shape if np.size(leaf) else (0, 1)


@given(trees)
def test_pack_and_unpack_are_inverse_and_casadi_stacks_alike(like: Outer) -> None:
    packed = tree.pack_tree(like)
    assert packed.size == tree.count_numbers(like) == len(tree.number_addresses(like))
    column, view = tree.create_symbols(like, "s")
    shapes = [leaf.shape for _, leaf in tree.iterate_leaves(view)]
    assert shapes == [shape(leaf) for _, leaf in tree.iterate_leaves(like)]
    stack = ca.Function("stack", [column], [tree.stack_leaves(view)])
    assert stack(packed).full().ravel().tolist() == packed.tolist()
    values = [
        ca.Function("leaf", [column], [leaf])(packed).full()
        for _, leaf in tree.iterate_leaves(view)
    ]
    again = tree.rebuild_tree(like, iter(values))
    assert isinstance(again, Outer)
    assert again.inner.nothing is None
    assert tree.pack_tree(again).tolist() == packed.tolist()


def test_names_address_each_number_in_packing_order() -> None:
    like = Outer(
        1.0,
        Inner(np.array([[1.0, 2.0], [3.0, 4.0]]), None, np.array([5.0])),
        (6.0, np.array([7.0, 8.0])),
    )
    expected = [
        "first",
        "inner.A[0,0]",
        "inner.A[1,0]",
        "inner.A[0,1]",
        "inner.A[1,1]",
        "inner.b[0]",
        "pair.0",
        "pair.1[0]",
        "pair.1[1]",
    ]
    assert tree.number_addresses(like) == expected
    assert tree.pack_tree(like).tolist() == [1, 1, 3, 2, 4, 5, 6, 7, 8]


def test_empty_trees() -> None:
    assert tree.pack_tree(None).size == tree.count_numbers(()) == 0
    assert tree.stack_leaves(None).shape == (0, 1)


def test_an_empty_leaf_beside_one_number_has_no_rows() -> None:
    """CasADi cuts a row of no columns out of a single entry."""
    view = tree.unpack_column((np.ones(1), np.empty(0)), ca.SX.sym("x", 1))
    assert [part.shape for part in view] == [(1, 1), (0, 1)]


def test_a_tree_needs_as_many_values_as_leaves() -> None:
    with pytest.raises(StopIteration):
        tree.rebuild_tree((1.0, 2.0), iter([1.0]))


def test_a_stack_holds_structural_zeros_too() -> None:
    """Engines exchange a function's numbers by position.

    An entry that CasADi leaves out would shift all that follow it.
    """
    stacked = tree.stack_leaves((ca.vertcat(ca.SX(2, 1), ca.SX.sym("a")), ca.SX.sym("b")))
    assert stacked.shape == (4, 1)
    assert stacked.nnz() == 4
