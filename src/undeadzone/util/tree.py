"""Nested named tuples of arrays, flattened to one vector and back.

A tree holds NumPy values or CasADi symbols; its leaves are arrays, numbers or None.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Iterator
from typing import Any

import casadi as ca
import numpy as np

from undeadzone.util.arrays import Floats


def append_field(tree: Any, name: str, value: Any) -> Any:
    """Return the named tuple, or an empty one, with one more field, the last one."""
    make: Any = namedtuple  # of names that are known at run time
    return make("Joined", [*getattr(tree, "_fields", ()), name])(*tree, value)


def drop_last_field(tree: Any, kind: Any) -> Any:
    """What `joined` was given: the named tuple of that kind without the last field."""
    return kind(*tree[:-1])


def leaves(tree: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every leaf in order with its dotted name; None holds nothing.

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
            yield from leaves(child, dotted)
    else:
        yield name, tree


def rebuild(like: Any, values: Iterator[Any]) -> Any:
    """Return a tree of the shape of `like` whose leaves are taken from `values` in order."""
    if like is None:
        return None
    if isinstance(like, tuple):
        children = [rebuild(child, values) for child in like]
        return type(like)(*children) if hasattr(like, "_fields") else tuple(children)
    return next(values)


def map_leaves(function: Callable[[Any], Any], tree: Any) -> Any:
    """Return the tree of what a function makes of each leaf."""
    return rebuild(tree, (function(leaf) for _, leaf in leaves(tree)))


def columns(like: Any, rows: Floats) -> Any:
    """Return the columns of packed rows (N x all) as a tree of the shape of the NumPy tree
    `like`.
    """
    return map_leaves(lambda part: rows[:, part], slices(like))


def pack(tree: Any) -> Floats:
    """Return all numbers of a NumPy tree as one vector (matrices column by column, as CasADi
    does).
    """
    parts = [np.ravel(np.asarray(leaf, float), order="F") for _, leaf in leaves(tree)]
    return np.concatenate(parts) if parts else np.empty(0)


def stack(tree: Any) -> ca.SX:
    """Return all entries of a CasADi tree as one column."""
    return ca.densify(ca.veccat(ca.SX(0, 1), *(leaf for _, leaf in leaves(tree))))


def substitute_symbol(tree: Any, symbol: ca.SX, value: ca.SX) -> Any:
    """Return a CasADi tree with an expression in the place of a symbol."""
    leaves_now = [leaf for _, leaf in leaves(tree)]
    return rebuild(tree, iter(ca.substitute(leaves_now, [symbol], [value])))


def size(tree: Any) -> int:
    """How many numbers the tree holds."""
    return sum(int(np.size(leaf)) for _, leaf in leaves(tree))


def slices(like: Any) -> Any:
    """Where each leaf of the NumPy tree `like` stands in its packed vector, as a tree of slices."""

    def pieces() -> Iterator[slice]:
        start = 0
        for _, leaf in leaves(like):
            end = start + int(np.size(leaf))
            yield slice(start, end)
            start = end

    return rebuild(like, pieces())


def unpack(like: Any, column: ca.SX) -> Any:
    """Return the entries of `column` (CasADi) in a tree of the shapes of the NumPy tree `like`."""
    pieces = []
    for (_, leaf), (_, part) in zip(leaves(like), leaves(slices(like)), strict=True):
        rows, columns = (*np.shape(leaf), 1, 1)[:2]
        piece = column[part]
        pieces.append(piece if rows and columns == 1 else ca.reshape(piece, rows, columns))
    return rebuild(like, iter(pieces))


def symbols(like: Any, name: str) -> tuple[ca.SX, Any]:
    """Return a fresh symbolic column and its tree view, shaped like the NumPy tree `like`."""
    column = ca.SX.sym(name, size(like))
    return column, unpack(like, column)


def names(tree: Any, prefix: str = "") -> list[str]:
    """Return an address for every number, in `pack` order: `plant.A[1,0]`, `sensor.right[0]`."""
    addresses = []
    for name, leaf in leaves(tree, prefix):
        shape = np.shape(leaf)
        if not shape:
            addresses.append(name)
            continue
        for index in np.ndindex(shape[::-1]):
            places = ",".join(map(str, index[::-1]))
            addresses.append(f"{name}[{places}]")
    return addresses
