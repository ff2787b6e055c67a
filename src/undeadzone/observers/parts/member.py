"""A filter as banks and watches take it: beside its estimate it says how well it foretold."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca

from undeadzone.interfaces import Estimate, Reading


class Step(NamedTuple):
    """What a filter makes of one sample.

    Attributes:
        state: its state at the next sample.
        estimate: what it shows.
        log: log of the density with which it foretold the reading, up to a constant (1).
        trust: probability that the reading was not wrong (p).
        fits: 1 where the widths lie in their claimed ranges, or may do so, else 0 (1).
        restarted: whether it lost its state and begins anew (1).
        opened: whether it opened its belief, for most readings were refused (1).
    """

    state: Any
    estimate: Estimate
    log: Any
    trust: Any
    fits: Any
    restarted: Any
    opened: Any


class Member(NamedTuple):
    """A filter as pure functions on CasADi expressions, before its readings are judged.

    Attributes:
        params: its numbers, `Params`.
        init: init(params) is the state at t = 0.
        step: step(params, state, u, reading) is a `Step`.
        smoothing: what a smoother of a whole log asks, `Smoothing`; None: nothing smooths it.
    """

    params: Any
    init: Callable[[Any], Any]
    step: Callable[[Any, Any, Any, Reading], Step]
    smoothing: Any = None


def log_density(e: Any, std: Any) -> Any:
    """The log of the density of the readings that were used, up to a constant.

    Args:
        e: innovations (p); one of 0 was not used.
        std: their standard deviations (p).
    """
    return ca.sum1(ca.if_else(e != 0, -((e / std) ** 2) / 2 - ca.log(std), 0.0))
