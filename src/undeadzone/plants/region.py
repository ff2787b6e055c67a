"""Declared set of states and inputs, the domain of a nonlinear model's certificate."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.errors import InputError, ShapeError
from undeadzone.plants.system import System
from undeadzone.util.arrays import Array, Floats, describe_shape, require_array
from undeadzone.util.toml import OptionTable


class Region(OptionTable, frozen=True, kw_only=True):
    """Domain on which a nonlinear model is certified.

    Attributes:
        x: a range [lo, hi] of each state (n x 2).
        u: a range [lo, hi] of each input (m x 2) (default: the torque limits of an arm).
    """

    x: Array
    u: Array | None = None


class Box(NamedTuple):
    """Ranges of x, then of u: low <= `[x; u]` <= high.

    Attributes:
        low, high: the bounds (n + m).
    """

    low: Floats
    high: Floats

    def is_outside(self, x: Floats, x_hat: Floats, u: Floats) -> np.ndarray:
        """Return whether state, estimate (N x n) or input (N x m) lie outside, or are not numbers
        (N).
        """
        both = np.stack([np.hstack([x, u]), np.hstack([x_hat, u])])
        return np.asarray(~((both >= self.low) & (both <= self.high)).all(axis=(0, 2)))


def build_box(region: Region, model: System) -> Box:
    """Return the box of a region for a model.

    Raises:
        InputError: or a subclass, that names the key.
    """
    if not model.nonlinear:
        raise InputError(
            "region: the model is linear, and its certificate holds everywhere. Remove the region"
        )
    inputs = _input_ranges(region, model)
    states = _require_ranges("region.x", region.x, model.n, "one [lo, hi] per state")
    return Box(*np.vstack([states, inputs]).T)


def _input_ranges(region: Region, model: System) -> Floats:
    """Return the ranges of the inputs (m x 2): those of the region, or the model's torque
    limits.
    """
    if region.u is not None:
        return _require_ranges("region.u", region.u, model.m, "one [lo, hi] per input")
    if model.limit is not None and np.isfinite(model.limit).all():
        return np.stack([-model.limit, model.limit], axis=1)
    raise InputError(
        "region.u: missing. Give a range [lo, hi] per input, "
        "this model has no torque limits to take in its place"
    )


def _require_ranges(key: str, value: Array, size: int, why: str) -> Floats:
    """Return the checked ranges [lo, hi] (size x 2)."""
    ranges = require_array(key, value)
    if ranges.shape == (2,) and size == 1:
        ranges = ranges[None]
    if ranges.shape != (size, 2):
        shape = describe_shape(ranges.shape)
        raise ShapeError(f"{key}: expected {size} x 2 numbers ({why}), found {shape}")
    wrong = np.flatnonzero(ranges[:, 0] >= ranges[:, 1])
    if wrong.size:
        first = wrong[0]
        raise InputError(
            f"{key}[{first}]: a range [lo, hi] must have lo < hi, found {ranges[first].tolist()}"
        )
    return ranges
