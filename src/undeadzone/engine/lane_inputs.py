"""What a run on lanes is given: checked, and in the shapes of its kernel."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from undeadzone.engine.forms import Shape
from undeadzone.errors import ShapeError
from undeadzone.support.arrays import Floats, Integers, shape_text

# (first step, steps), asked for in order -> steps x own inputs x lanes
Source = Callable[[int, int], Floats]
Supply = Callable[[Integers], Source]  # lane numbers -> their source


class Inputs(NamedTuple):
    """What a run is given, checked.

    Attributes:
        states: at the beginning (lanes x states).
        exogenous: w of each step (N x inputs).
        params: p.
        own_params: entries of p that differ by lane (lanes x own params).
        supply: of the entries of w that differ by lane.
    """

    states: Floats
    exogenous: Floats
    params: Floats
    own_params: Floats
    supply: Supply


def checked(
    shape: Shape,
    states: Floats,
    exogenous: Floats,
    params: Floats,
    lane_exogenous: Floats | Supply | None,
    lane_params: Floats | None,
) -> Inputs:
    """The arguments of `run` in the shapes of a kernel. Raises ShapeError."""
    own = None if callable(lane_exogenous) else lane_exogenous
    lanes = _lanes(
        ("states", states, 2, 0),
        ("lane_exogenous", own, 3, 2),
        ("lane_params", lane_params, 2, 0),
    )
    total = len(exogenous)
    states_each, entries_w, entries_p = shape.sizes
    expected = (lanes, states_each) if np.ndim(states) > 1 else (states_each,)
    states = np.broadcast_to(_shaped("states", states, *expected), (lanes, states_each))
    exogenous = np.ascontiguousarray(_shaped("exogenous", exogenous, total, entries_w))
    params = np.ascontiguousarray(_shaped("params", params, entries_p))
    if lane_params is None:
        lane_params = np.empty((lanes, 0))
    own_params = _shaped("lane_params", lane_params, lanes, len(shape.params))
    if callable(lane_exogenous):
        return Inputs(states, exogenous, params, own_params, lane_exogenous)
    if own is None:
        own = np.empty((total, 0, lanes))
    own = _shaped("lane_exogenous", own, total, len(shape.exogenous), lanes)
    return Inputs(states, exogenous, params, own_params, _held(own))


def _held(inputs: Floats) -> Supply:
    """A supply from an array (N x own inputs x lanes)."""

    def of_lanes(lanes: Integers) -> Source:
        return partial(_steps_of_lanes, inputs, lanes)

    return of_lanes


def _steps_of_lanes(inputs: Floats, lanes: Integers, first: int, count: int) -> Floats:
    """Some steps of some lanes of an array (N x own inputs x lanes)."""
    if not inputs.size:
        return np.empty((count, 0, lanes.size))
    return inputs[first : first + count, :, lanes]


def _lanes(*sources: tuple[str, Any, int, int]) -> int:
    """The number of lanes that arrays agree on.

    Args:
        sources: name, value, dimensions when it has lanes, axis of lanes.
    """
    counts = {}
    for name, value, dimensions, axis in sources:
        if np.ndim(value) == dimensions:
            counts[name] = np.shape(value)[axis]
    if len(set(counts.values())) > 1 or 0 in counts.values():
        listed = ", ".join(f"{count} in {name}" for name, count in counts.items())
        raise ShapeError(f"lanes: expected one number of lanes, 1 or more, found {listed}")
    return next(iter(counts.values()), 1)


def _shaped(name: str, value: Floats, *shape: int) -> Floats:
    """An array of a given shape. Raises ShapeError for another one."""
    numbers = np.asarray(value, float)
    if numbers.shape != shape:
        present = shape_text(numbers.shape) or "one number"
        raise ShapeError(f"{name}: expected {shape_text(shape)}, found {present}")
    return numbers
