"""Approximators that are linear in their weights, W'phi(v): neural, fuzzy and Taylor networks."""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from itertools import product
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.util.arrays import Floats, require_number

LARGEST = 200  # functions in a basis; each is computed at every step


class Basis(NamedTuple):
    """Basis functions phi of a point v.

    Attributes:
        params: what phi needs (NumPy arrays).
        phi: phi(params, v) is the column of functions at v (k), on CasADi expressions.
        size: number of functions.
    """

    params: Any
    phi: Callable[[Any, Any], Any]
    size: int


class Grid(NamedTuple):
    """Gaussians on a grid over the box |v_i| <= reach_i.

    Attributes:
        reach: half the sides of the box (k) [units of v].
        centres: on each axis, in [-1, 1].
        overlap: standard deviation of a Gaussian, in spacings of the grid.
    """

    reach: Floats
    centres: Floats
    overlap: Any


def build_gaussians(key: str, reach: Floats, count: int, overlap: float, normalised: bool) -> Basis:
    """Build products of Gaussians on a grid over the box |v_i| <= reach_i.

    Radial basis functions (Broomhead and Lowe 1988), which fade beyond the box. Normalised, they
    sum to 1: fuzzy rules with Gaussian membership, singleton fuzzifier, product inference and
    centre average (Wang and Mendel 1992), and v is brought into the box first.

    References:
        L.-X. Wang, J. M. Mendel (1992), doi:10.1109/72.159070

    Args:
        key: of the count, named in errors, as is `overlap` beside it.
        reach: half the sides of the box (k).
        count: centres per axis.
        overlap: standard deviation of a Gaussian, in spacings of the grid.
        normalised: make the functions sum to 1.

    Raises:
        InputError: fewer than 2 centres per axis, too many functions, or no positive overlap.
    """
    overlap = require_number(f"{key.partition('.')[0]}.overlap", overlap, above=0.0)
    if count < 2:
        raise InputError(f"{key}: a grid needs at least 2 centres per axis, found {count}")
    spacing = 2 / (count - 1)

    def phi(p: Grid, v: Any) -> Any:
        """Return the Gaussians at v (k)."""
        scaled = v / p.reach
        if normalised:
            scaled = clip_to_box(scaled)
        width = spacing * p.overlap
        axes = [ca.exp(-(((x - p.centres) / width) ** 2) / 2) for x in ca.vertsplit(scaled)]
        if normalised:
            axes = [axis / ca.sum1(axis) for axis in axes]
        return reduce(ca.kron, axes)

    grid = Grid(reach, np.linspace(-1, 1, count), np.float64(overlap))
    return _require_small_basis(key, Basis(grid, phi, count**reach.size))


def build_monomials(key: str, reach: Floats, degree: int) -> Basis:
    """Build all products of powers of v_i / reach_i up to a total degree (Taylor network).

    v is brought into the box |v_i| <= reach_i first.

    Args:
        key: named in errors.
        reach: half the sides of the box (k).
        degree: the greatest total degree.

    Raises:
        InputError: a degree below 1, or too many functions.
    """
    if degree < 1:
        raise InputError(f"{key}: the degree must be at least 1, found {degree}")
    tuples = product(range(degree + 1), repeat=reach.size)
    powers = [power for power in tuples if sum(power) <= degree]

    def phi(reach: Any, v: Any) -> Any:
        """Return the monomials at v (k)."""
        scaled = ca.vertsplit(clip_to_box(v / reach))
        return ca.vertcat(*(_monomial_value(scaled, power) for power in powers))

    return _require_small_basis(key, Basis(reach, phi, len(powers)))


def build_jump_functions(key: str, count: int) -> Basis:
    """Build Selmic and Lewis's jump functions (1 - e^(-|y|))^k, k < count, of v = `[y; side]`.

    They act on the right side and, negative, on the left.

    References:
        R. R. Selmic, F. L. Lewis (2000), doi:10.1109/9.847098

    Args:
        key: named in errors.
        count: functions per side.

    Raises:
        InputError: no function, or too many.
    """
    if count < 1:
        raise InputError(f"{key}: expected at least 1 function, found {count}")

    def phi(params: Any, v: Any) -> Any:
        """Return the jump functions at v (2 count)."""
        rise = 1 - ca.exp(-ca.fabs(v[0]))
        one_side = ca.vertcat(*(rise**k for k in range(count)))
        return ca.vertcat((v[1] > 0) * one_side, -(v[1] < 0) * one_side)

    return _require_small_basis(key, Basis(None, phi, 2 * count))


def clip_to_box(v: Any) -> Any:
    """Clip v to the box |v_i| <= 1."""
    return ca.fmax(ca.fmin(v, 1.0), -1.0)


def _monomial_value(v: list[Any], powers: tuple[int, ...]) -> Any:
    """Return v_1^powers_1 v_2^powers_2 ..."""
    value = ca.SX(1.0)
    for x, power in zip(v, powers, strict=True):
        value = value * x**power
    return value


def _require_small_basis(key: str, basis: Basis) -> Basis:
    """Return the basis if small enough to compute at every step, or raise InputError."""
    if basis.size > LARGEST:
        raise InputError(
            f"{key}: the basis would have {basis.size} functions, at most {LARGEST} are computed. "
            "Use fewer per axis"
        )
    return basis
