"""Approximators that are linear in their weights, W'phi(v): the phi of neural, fuzzy and Taylor networks."""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from itertools import product
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.support.arrays import Floats

LARGEST = 200  # functions in a basis; each is computed at every step


class Basis(NamedTuple):
    """phi(params, v): the `size` functions at a point v (k) on CasADi expressions; params: NumPy arrays."""

    params: Any
    phi: Callable[[Any, Any], Any]
    size: int


class Grid(NamedTuple):
    """reach (k): the box |v_i| <= reach_i; centres in [-1, 1] on each axis; overlap: standard deviation of a Gaussian, in spacings."""

    reach: Floats
    centres: Floats
    overlap: Any


def gaussians(key: str, reach: Floats, count: int, overlap: float, normalised: bool) -> Basis:
    """Products of Gaussians on a grid of `count` centres per axis over the box.

    Radial basis functions (Broomhead and Lowe 1988), which fade beyond the box. Normalised, they sum to 1: fuzzy rules
    with Gaussian membership, singleton fuzzifier, product inference and centre average (Wang and Mendel 1992), and v
    is brought into the box first. Raises InputError.
    """
    if count < 2:
        raise InputError(f"{key}: a grid needs at least 2 centres per axis, found {count}")

    def phi(p: Grid, v: Any) -> Any:
        spacing = 2 / (count - 1)
        scaled = _inside(v / p.reach) if normalised else v / p.reach
        axes = [
            ca.exp(-(((x - p.centres) / (spacing * p.overlap)) ** 2) / 2)
            for x in ca.vertsplit(scaled)
        ]
        return reduce(ca.kron, [axis / ca.sum1(axis) if normalised else axis for axis in axes])

    return _checked(
        key,
        Basis(Grid(reach, np.linspace(-1, 1, count), np.float64(overlap)), phi, count**reach.size),
    )


def monomials(key: str, reach: Floats, degree: int) -> Basis:
    """Every product of powers of v_i / reach_i of total degree up to `degree`, brought into the box first (Taylor network). Raises InputError."""
    if degree < 1:
        raise InputError(f"{key}: the degree must be at least 1, found {degree}")
    powers = [
        power for power in product(range(degree + 1), repeat=reach.size) if sum(power) <= degree
    ]

    def phi(reach: Any, v: Any) -> Any:
        scaled = ca.vertsplit(_inside(v / reach))
        return ca.vertcat(
            *(_product(x**k for x, k in zip(scaled, power, strict=True)) for power in powers)
        )

    return _checked(key, Basis(reach, phi, len(powers)))


def jumps(key: str, count: int) -> Basis:
    """Selmic and Lewis's jump functions (1 - e^(-|y|))^k, k < count, for y on the right and, negative, on the left; v = [y; side]. Raises InputError."""
    if count < 1:
        raise InputError(f"{key}: expected at least 1 function, found {count}")

    def phi(params: Any, v: Any) -> Any:
        rise = 1 - ca.exp(-ca.fabs(v[0]))
        one_side = ca.vertcat(*(rise**k for k in range(count)))
        return ca.vertcat((v[1] > 0) * one_side, -(v[1] < 0) * one_side)

    return _checked(key, Basis(None, phi, 2 * count))


def _inside(v: Any) -> Any:
    return ca.fmax(ca.fmin(v, 1.0), -1.0)


def _product(factors: Any) -> Any:
    return reduce(lambda a, b: a * b, factors, ca.SX(1.0))


def _checked(key: str, basis: Basis) -> Basis:
    if basis.size > LARGEST:
        raise InputError(
            f"{key}: the basis would have {basis.size} functions, at most {LARGEST} are computed; use fewer per axis"
        )
    return basis
