"""A declared set of states and inputs, on which a nonlinear model's certificate holds."""

from __future__ import annotations

from typing import NamedTuple

import msgspec
import numpy as np

from undeadzone.errors import InputError, ShapeError
from undeadzone.plants.system import System
from undeadzone.support.arrays import Array, Floats, array


class Region(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where a nonlinear model is certified: x (n x 2) and u (m x 2), a range [lo, hi] per state and input (u: by default the torque limits)."""

    x: Array
    u: Array | None = None


class Box(NamedTuple):
    """Ranges of x, then of u: low <= [x; u] <= high (n + m each)."""

    low: Floats
    high: Floats

    def left(self, x: Floats, x_hat: Floats, u: Floats) -> np.ndarray:
        """Whether state, estimate (N x n) or input (N x m) lie outside, or are no numbers (N)."""
        both = np.stack([np.hstack([x, u]), np.hstack([x_hat, u])])
        return np.asarray(~((both >= self.low) & (both <= self.high)).all(axis=(0, 2)))


def box(region: Region, model: System) -> Box:
    """The box of a region for a model. Raises InputError, ShapeError that name the key."""
    if not model.nonlinear:
        raise InputError(
            "region: the model is linear, and its certificate holds everywhere; remove the region"
        )
    if region.u is not None:
        inputs = _ranges("region.u", region.u, model.m, "one [lo, hi] per input")
    elif model.limit is not None and np.isfinite(model.limit).all():
        inputs = np.stack([-model.limit, model.limit], axis=1)
    else:
        raise InputError(
            "region.u: missing; give a range [lo, hi] per input, this model has no torque limits to take in its place"
        )
    return Box(
        *np.vstack([_ranges("region.x", region.x, model.n, "one [lo, hi] per state"), inputs]).T
    )


def _ranges(key: str, value: Array, size: int, why: str) -> Floats:
    found = array(key, value)
    if found.shape == (2,) and size == 1:
        found = found[None]
    if found.shape != (size, 2):
        raise ShapeError(
            f"{key}: expected {size} x 2 numbers ({why}), found {' x '.join(map(str, found.shape)) or 'one number'}"
        )
    if (wrong := np.flatnonzero(found[:, 0] >= found[:, 1])).size:
        raise InputError(
            f"{key}[{wrong[0]}]: a range [lo, hi] must have lo < hi, found {found[wrong[0]].tolist()}"
        )
    return found
