"""Boxes of states and bounds of widths that hold whatever is not contradicted, on CasADi expressions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca

from undeadzone.support import tree

FAR = 1e300  # a bound that bounds nothing


class Bounds(NamedTuple):
    """[lo, hi], one per output."""

    lo: Any
    hi: Any


class Boxes(NamedTuple):
    """x^ (n); the half-widths of the box of zeta, x = x^ + T Phi zeta (n); bounds of d_r and d_l."""

    x: Any
    radius: Any
    right: Bounds
    left: Bounds


def each(f: Callable[..., Any], *boxes: Boxes) -> Boxes:
    """f on every part."""
    return tree.rebuild(
        boxes[0], map(f, *((leaf for _, leaf in tree.leaves(box)) for box in boxes))
    )


def meet(a: Bounds, b: Bounds) -> Bounds:
    """What lies in both."""
    return Bounds(ca.fmax(a.lo, b.lo), ca.fmin(a.hi, b.hi))


def cut(x: Any, radius: Any, frame: Any, c: Any, lo: Any, hi: Any) -> tuple[Any, Any]:
    """(x^, half-widths) of the smallest box that holds what of a box has c x in [lo, hi]; a half-width below 0 where nothing has."""
    row = (c @ frame).T
    size, z = ca.fabs(row), c @ x
    others = size.T @ radius - 2 * size * radius  # what else is in z, less the entry's own share
    up = ca.fmax(lo - z - others, 0.0) / ca.fmax(
        size, 1 / FAR
    )  # by which the ends of an entry move
    down = ca.fmax(z - hi - others, 0.0) / ca.fmax(size, 1 / FAR)
    shift = (ca.fmin(up, 2 * radius) - ca.fmin(down, 2 * radius)) / 2
    return x + frame @ (ca.sign(row) * shift), ca.fmax(radius - (up + down) / 2, -radius)
