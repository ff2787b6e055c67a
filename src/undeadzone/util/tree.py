"""Nested named tuples of arrays, flattened to one vector and back.

A tree holds NumPy values or CasADi symbols. Its leaves are arrays, numbers or None.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Iterator
from typing import Any

import casadi as ca
import numpy as np

from undeadzone.util.arrays import Floats


def append_field(tree: Any, name: str, value: Any) -> Any:
    """Return the named tuple (None counts as empty) with a field appended."""
    make: Any = namedtuple  # of names that are known at run time
    return make("Joined", [*getattr(tree, "_fields", ()), name])(*tree, value)


def drop_last_field(tree: Any, kind: Any) -> Any:
    """Return the named tuple of a kind without the last field: the inverse of `append_field`."""
    return kind(*tree[:-1])


def iterate_leaves(tree: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every leaf in order with its dotted name (None has no leaves).

    Args:
        tree: the tree.
        name: put before every name.
    """
    if tree is None:
        return
    if isinstance(tree, tuple):
        fields = getattr(tree, "_fields", range(len(tree)))
        for field, child in zip(fields, tree, strict=True):
            dotted = f"{name}.{field}" if name else str(field)
            yield from iterate_leaves(child, dotted)
    else:
        yield name, tree


def rebuild_tree(like: Any, values: Iterator[Any]) -> Any:
    """Return a tree of the shape of `like` whose leaves are taken from `values` in order."""
    if like is None:
        return None
    if isinstance(like, tuple):
        children = [rebuild_tree(child, values) for child in like]
        return type(like)(*children) if hasattr(like, "_fields") else tuple(children)
    return next(values)


def map_leaves(function: Callable[[Any], Any], tree: Any) -> Any:
    """Return the tree with a function applied to each leaf."""
    return rebuild_tree(tree, (function(leaf) for _, leaf in iterate_leaves(tree)))


def unpack_columns(like: Any, rows: Floats) -> Any:
    """Return the columns of packed rows (N x all) as a tree of the shape of the NumPy tree
    `like`.
    """
    return map_leaves(lambda part: rows[:, part], leaf_slices(like))


def pack_tree(tree: Any) -> Floats:
    """Return all numbers of a NumPy tree as a vector (matrices column by column, as in CasADi)."""
    parts = [np.ravel(np.asarray(leaf, float), order="F") for _, leaf in iterate_leaves(tree)]
    return np.concatenate(parts) if parts else np.empty(0)


def stack_leaves(tree: Any) -> ca.SX:
    """Return all entries of a CasADi tree as a column."""
    return ca.densify(ca.veccat(ca.SX(0, 1), *(leaf for _, leaf in iterate_leaves(tree))))


def substitute_symbol(tree: Any, symbol: ca.SX, value: ca.SX) -> Any:
    """Return a CasADi tree with an expression in the place of a symbol."""
    leaves_now = [leaf for _, leaf in iterate_leaves(tree)]
    return rebuild_tree(tree, iter(ca.substitute(leaves_now, [symbol], [value])))


def count_numbers(tree: Any) -> int:
    """Return the count of all numbers in the tree."""
    return sum(int(np.size(leaf)) for _, leaf in iterate_leaves(tree))


def leaf_slices(like: Any) -> Any:
    """Return the slice of each leaf of the NumPy tree `like` in its packed vector, as a tree."""

    def pieces() -> Iterator[slice]:
        """Yield the slice of each leaf in order."""
        start = 0
        for _, leaf in iterate_leaves(like):
            end = start + int(np.size(leaf))
            yield slice(start, end)
            start = end

    return rebuild_tree(like, pieces())


def unpack_column(like: Any, column: ca.SX) -> Any:
    """Return the entries of `column` (CasADi) in a tree of the shapes of the NumPy tree
    `like`.
    """
    pieces = []
    for (_, leaf), (_, part) in zip(
        iterate_leaves(like), iterate_leaves(leaf_slices(like)), strict=True
    ):
        rows, columns = (*np.shape(leaf), 1, 1)[:2]
        piece = column[part]
        pieces.append(piece if rows and columns == 1 else ca.reshape(piece, rows, columns))
    return rebuild_tree(like, iter(pieces))


def create_symbols(like: Any, name: str) -> tuple[ca.SX, Any]:
    """Return a fresh symbolic column and its tree view, shaped like the NumPy tree `like`."""
    column = ca.SX.sym(name, count_numbers(like))
    return column, unpack_column(like, column)


def number_addresses(tree: Any) -> list[str]:
    """Return an address for every number, in `pack_tree` order:

    `plant.A[1,0]`, `sensor.right[0]`.
    """
    addresses = []
    for name, leaf in iterate_leaves(tree):
        shape = np.shape(leaf)
        if not shape:
            addresses.append(name)
            continue
        for index in np.ndindex(shape[::-1]):
            places = ",".join(map(str, index[::-1]))
            addresses.append(f"{name}[{places}]")
    return addresses
