"""The two shapes of every method: an observer (params, init, step) and a controller, and what passes between them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.feedforward.targets import Target
from undeadzone.sensor import Zone, inverse, present
from undeadzone.support.arrays import Floats


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


class Reading(NamedTuple):
    """What the sensor gives: y (p), NaN where missing, and its measured side (+1 right, -1 left, 0 silent).

    x (n): the true state, which only a simulation has (None elsewhere), for the reference line `full_state`.
    """

    y: Any
    side: Any
    x: Any = None


NONE = ca.SX(0, 1)


class Estimate(NamedTuple):
    """x^ (n), z^ = C x^ (p), widths d_r^, d_l^ (p each), the deadzone inverse y + chi_bar d^ of (26) (p), innovation (p).

    Where the observer knows how sure it is, the standard deviations of x^, d_r^, d_l^, d_r^ + d_l^ and the innovation; where it
    estimates what its model leaves out, that as w^ (n), x' = f(x, u) + w, and of that the parameters that it was told are uncertain as
    theta^ with their standard deviations; else these are empty.
    """

    x: Any
    z: Any
    right: Any
    left: Any
    z_inverse: Any
    innovation: Any
    x_std: Any = NONE
    right_std: Any = NONE
    left_std: Any = NONE
    width_std: Any = NONE
    innovation_std: Any = NONE
    w: Any = NONE
    theta: Any = NONE
    theta_std: Any = NONE


class Observer(NamedTuple):
    """An observer as pure functions on CasADi expressions.

    params: tree of NumPy arrays; init(params): the state at t = 0, a tree of NumPy arrays;
    step(params, state, u, reading): (the state's derivative, or its next value when the model is sampled, Estimate),
    where the estimate must not depend on u; project(params, state): the admissible state nearest to a given one;
    init, and step where the model is sampled, give one.
    """

    params: Any
    init: Callable[[Any], Any]
    step: Callable[[Any, Any, Any, Reading], tuple[Any, Estimate]]
    project: Callable[[Any, Any], Any] = lambda params, state: state


def estimate(
    x: Any, z: Any, right: Any, left: Any, reading: Reading, slope: Any, kind: str, innovation: Any
) -> Estimate:
    """An `Estimate` with its deadzone inverse; a missing sample is inverted to z^."""
    inverted = ca.if_else(
        present(reading.y), inverse(reading.y, reading.side, right, left, slope, kind), z
    )
    return Estimate(x, z, right, left, inverted, innovation)


class NumericObserver(NamedTuple):
    """An observer that computes in Python, one sample at a time, since no graph of fixed size holds it; sampled time.

    params: its numbers; start(seed): the state at t = 0; correct(state, reading): (state, Estimate), both of NumPy
    arrays; predict(state, u): the state at the next sample. States are values: nothing else is changed.
    """

    params: Any
    start: Callable[[int], Any]
    correct: Callable[[Any, Reading], tuple[Any, Estimate]]
    predict: Callable[[Any, Floats], Any]


def graph_of(observer: Observer | NumericObserver) -> Observer:
    """The observer if it is a graph. Raises InputError for one that computes in Python."""
    if isinstance(observer, NumericObserver):
        raise InputError(
            "observer.method: this one computes in Python, sample by sample: it runs in single simulations only, "
            "not in ensembles, compiled lanes, live use or generated C; use 'ekf', 'ukf', 'kalman' or 'censored' there"
        )
    return observer


def numeric_estimate(
    X: Floats,
    z: Floats,
    reading: Reading,
    sensor: Zone,
    e: Floats,
    std: Floats,
    width_std: Floats,
    e_std: Floats,
) -> Estimate:
    """An `Estimate` of numbers; X, std: [x; d_r; d_l] and its standard deviations (n + 2p); e, e_std: innovations and theirs."""
    ends = [X.size - 2 * z.size, X.size - z.size]
    (x, right, left), (x_std, right_std, left_std) = np.split(X, ends), np.split(std, ends)
    inverted = np.where(
        np.isfinite(reading.y),
        inverse(reading.y, reading.side, right, left, sensor.slope, sensor.kind),
        z,
    )
    return Estimate(
        x,
        z,
        right,
        left,
        inverted,
        e,
        x_std,
        right_std,
        left_std,
        width_std,
        e_std,
        *np.zeros((3, 0)),
    )
