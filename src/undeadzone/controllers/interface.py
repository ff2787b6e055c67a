"""The one shape of every controller: params, init, step."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from undeadzone.arrays import Floats
from undeadzone.feedforward import Target
from undeadzone.observers.interface import Estimate


class Plan(NamedTuple):
    """What a controller computes from the whole reference before a run, with NumPy: gains, accelerations.

    size: numbers per instant; params: tree of NumPy arrays; along(params, targets (a row per instant)): (instants x size), whose
    rows `step` finds in `target.plan`.
    """

    size: int
    params: Any
    along: Callable[[Any, Target], Floats]


class Controller(NamedTuple):
    """A controller as pure functions on CasADi expressions.

    params: tree of NumPy arrays; init(params): the state at t = 0 (None: no state);
    step(params, state, estimate, target): (the state's derivative, or its next value when the model is sampled, u).
    plan: what it computes ahead, if anything.
    """

    params: Any
    init: Callable[[Any], Any]
    step: Callable[[Any, Any, Estimate, Target], tuple[Any, Any]]
    plan: Plan | None = None

    @property
    def planned(self) -> int:
        """How many numbers per instant it computes ahead."""
        return 0 if self.plan is None else self.plan.size
