"""The one shape of every controller: params, init, step."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from undeadzone.feedforward import Target
from undeadzone.observers.interface import Estimate


class Controller(NamedTuple):
    """A controller as pure functions on CasADi expressions.

    params: tree of NumPy arrays; init(params): the state at t = 0 (None: no state);
    step(params, state, estimate, target): (the state's derivative, or its next value when the model is sampled, u).
    """

    params: Any
    init: Callable[[Any], Any]
    step: Callable[[Any, Any, Estimate, Target], tuple[Any, Any]]
