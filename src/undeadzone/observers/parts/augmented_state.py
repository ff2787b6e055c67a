"""What filters that see the dead zone as one nonlinear function y / m = Dz(z; d_r, d_l) of [x; d_r; d_l] have in common."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import msgspec
import numpy as np

from undeadzone import sensor as sensors
from undeadzone.interfaces import Estimate, Observer, Reading
from undeadzone.linear.hold import sampled_noise
from undeadzone.numerics.gaussian import Gaussian, symmetric, triangle
from undeadzone.observers.parts.measured_kalman import (
    Augmentation,
    Params,
    Prior,
    declared,
    kept,
    motion,
    numbers,
    prior,
    sample_time,
    to_estimate,
    white,
)
from undeadzone.plants.system import System
from undeadzone.plants.time_scales import time_scale
from undeadzone.sensor import Zone, present
from undeadzone.support.arrays import Array, Floats, nonnegative, scalar

CROWD = 100  # readings
SWING = 0.5  # rms, in largest widths, by which a coloured disturbance moves z in a quarter period, unless it is given


class Declared(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the rivals of `Kalman` are told, in its words; what is not given follows from `Defaults`.

    right, left: declared ranges [lo, hi] of d_r and d_l [z], one or one per output (left: default that of right).
    noise: rms of a reading [z]. x_std: std of x(0) about 0, one or one per state. disturbance: rms of an input
    disturbance that is new at every sample [u], one or one per input (default: what moves z by `swing` times the largest
    width, rms, in a quarter period of the plant; in 1 s of a chain of integrators). drift: random walk of the widths
    [z / sqrt(s)].
    """

    right: Array
    left: Array | None = None
    noise: Array | None = None
    x_std: Array | None = None
    disturbance: Array | None = None
    swing: float = 0.1
    drift: float | None = None


class Defaults(NamedTuple):
    """A method's defaults: drift and x_std in largest widths; noise, the sensor's but at least this share of the declared range.

    Of more than `CROWD` readings in a quarter period, each has so much more noise that together they say no more: what
    is wrong with the model does not average out.
    """

    noise: float
    drift: float
    x_std: float


class Assumptions(NamedTuple):
    """The prior, variances of the input disturbance (m) [u^2], and the declared ranges of the widths (2p x 2) [z]."""

    prior: Prior
    variance: Floats
    ranges: Floats


def claims(
    given: Declared, model: System, sensor: Zone, habits: Defaults, stride: int = 1
) -> Assumptions:
    """What is believed of a sampled model that every stride-th reading is used of, defaults filled in. Raises InputError, ShapeError."""
    Ts = sample_time(model)
    readings = quarter_period(model) / (stride * Ts)
    ranges = declared(given.right, given.left, model.p)
    largest = float(ranges.max())
    drift = habits.drift * largest if given.drift is None else given.drift
    x_std = habits.x_std * largest if given.x_std is None else given.x_std
    believed = prior(
        model,
        sensor,
        given.right,
        given.left,
        given.noise,
        x_std,
        drift,
        habits.noise * max(1.0, readings / CROWD) ** 0.5,
    )
    swing = scalar("observer.swing", given.swing, least=0.0)
    if given.disturbance is None:
        return Assumptions(believed, agitation(model, swing * largest) ** 2, ranges)
    return Assumptions(
        believed,
        nonnegative("observer.disturbance", given.disturbance, model.m, "one per input") ** 2,
        ranges,
    )


def agitation(model: System, rms: float) -> Floats:
    """The rms (m) of a disturbance new at every sample that alone, in a quarter period of the plant, moves some z by that rms."""
    assert model.flow is not None
    A, B, C = model.flow
    span = quarter_period(model)
    reached = [np.diag(C @ sampled_noise(A, np.outer(b, b), span)[1] @ C.T).max() for b in B.T]
    return rms / np.sqrt(sample_time(model) * np.where(np.array(reached) > 0, reached, np.inf))


def presumed(model: System, largest: float, correlation: float) -> Floats:
    """The rms (m) of a disturbance of that correlation time [s] where none is given: as strong as a white one at low frequencies."""
    return agitation(model, SWING * largest) * np.sqrt(sample_time(model) / 2 / correlation)


def quarter_period(model: System) -> float:
    """`time_scale` [s] of a sampled model."""
    assert model.flow is not None
    return time_scale(model.flow)


class State(NamedTuple):
    """Mean and covariance (its `triangle`) of [x; d_r; d_l] before the reading."""

    mean: Any
    cov: Any


Sight = Callable[[Any], Any]  # from [x; d_r; d_l] to the reading y_i / m_i without noise
Correct = Callable[
    [Params, Gaussian, int, Sight, Any, Any, Any], tuple[Gaussian, Any, Any]
]  # (q, belief, i, sight, y_i / m_i, side_i, present)
Predict = Callable[[Gaussian, Callable[[Any], Any], Any], Gaussian]


def joint_filter(
    model: System, sensor: Zone, given: Assumptions, correct: Correct, predict: Predict
) -> Observer:
    """The filter as an observer: its readings one output after the other, by `correct`, then its motion, by `predict`."""
    n, p = model.n, model.p
    augmentation: Augmentation = white(model, given.variance)
    params, entries = numbers(model, sensor, given.prior, augmentation), kept(model, augmentation)

    def sight(q: Params, i: int, X: Any) -> Any:
        z, right, left = model.output(q.model, X[:n])[i], X[n + i], X[n + p + i]
        return read(sensor.kind, z, right, left)

    def step(q: Params, s: State, u: Any, reading: Reading) -> tuple[State, Estimate]:
        belief, innovations, variances = Gaussian(s.mean, symmetric(s.cov, entries)), [], []
        for i in range(p):
            seen = present(reading.y[i])
            y = ca.if_else(seen, reading.y[i], 0.0) / q.slope[i]
            belief, e, S = correct(q, belief, i, partial(sight, q, i), y, reading.side[i], seen)
            innovations.append(e)
            variances.append(S)
        after = predict(belief, *motion(model, q, augmentation, belief, u))
        found = to_estimate(
            model,
            sensor,
            q,
            belief,
            reading,
            ca.vertcat(*innovations),
            ca.sqrt(ca.vertcat(*variances)),
        )
        return State(after.mean, triangle(after.cov, entries)), found

    return Observer(params, lambda q: State(q.mean, q.cov), step)


def read(kind: str, z: Any, right: Any, left: Any) -> Any:
    """The reading y / m of z by a sensor of that kind, without noise."""
    return (sensors.jump if kind == "jump" else sensors.deadzone)(z, right, left)
