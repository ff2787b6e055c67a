"""Boxes of states and bounds of widths that contain all consistent values, in CasADi."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca

from undeadzone.util import tree

FAR = 1e300  # a bound that bounds nothing


class Bounds(NamedTuple):
    """Bounds [lo, hi], one pair per output."""

    lo: Any
    hi: Any


class Boxes(NamedTuple):
    """Box of states and bounds of the widths.

    Attributes:
        x: midpoint x^ (n).
        radius: half-widths (n) of the box of zeta, where x = x^ + T Phi zeta.
        right, left: bounds of d_r and d_l.
    """

    x: Any
    radius: Any
    right: Bounds
    left: Bounds


def map_boxes(f: Callable[..., Any], *boxes: Boxes) -> Boxes:
    """Apply f to every part: f(part of the first, part of the second, ...)."""
    columns = []
    for box in boxes:
        columns.append([leaf for _, leaf in tree.iterate_leaves(box)])
    return tree.rebuild_tree(boxes[0], map(f, *columns))


def intersect_bounds(a: Bounds, b: Bounds) -> Bounds:
    """Return the intersection of two bounds."""
    return Bounds(ca.fmax(a.lo, b.lo), ca.fmin(a.hi, b.hi))


def cut_box(x: Any, radius: Any, frame: Any, c: Any, lo: Any, hi: Any) -> tuple[Any, Any]:
    """Return the smallest box that contains the part of a box with c x in [lo, hi].

    Args:
        x: midpoint of the box (n).
        radius: half-widths of zeta (n).
        frame: T Phi (n x n).
        c: row of C (1 x n).
        lo, hi: bounds of c x.

    Returns:
        (midpoint, half-widths). A half-width is below 0 if no point of the box has such a c x.
    """
    row = (c @ frame).T
    size = ca.fabs(row)
    z = c @ x
    # contribution of the other entries to z: all of them, less the entry's own share
    others = size.T @ radius - 2 * size * radius
    # how far the lower and the upper end of an entry move
    up = ca.fmax(lo - z - others, 0.0) / ca.fmax(size, 1 / FAR)
    down = ca.fmax(z - hi - others, 0.0) / ca.fmax(size, 1 / FAR)
    shift = (ca.fmin(up, 2 * radius) - ca.fmin(down, 2 * radius)) / 2
    return x + frame @ (ca.sign(row) * shift), ca.fmax(radius - (up + down) / 2, -radius)
