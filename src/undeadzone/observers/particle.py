"""Bootstrap particle filter on [x; d_r; d_l] (docs/methods/particle_filter.md)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.interfaces import NumericObserver, Reading, numeric_estimate
from undeadzone.observers.parts.augmented_state import Assumptions, Declared, Defaults, claims, read
from undeadzone.plants.system import System
from undeadzone.sensor import Zone
from undeadzone.support.arrays import Floats

HABITS = Defaults(
    noise=0.1, drift=0.1, x_std=0.5
)  # a likelihood that few particles meet leaves copies of these few
STREAM = 0x7061727469636C65  # of the random numbers, apart from those of noise and disturbance


class ParticleFilter(
    Declared,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="method",
    tag="particle_filter",
):
    """Bootstrap filter of Gordon, Salmond, Smith (1993) on [x; d_r; d_l], systematic resampling of Kitagawa (1996); sampled time.

    right, left, noise, x_std, disturbance, swing, drift: as for `EKF`, but widths are drawn evenly from their range and stay in it, and by
    default noise is at least 10 % of the range, drift 10 % and x_std 50 % of the largest width. particles: how many; they are resampled when
    fewer than half of them count, 1 / sum w^2. Random numbers follow from simulation.seed. It runs in Python: in single runs only.
    """

    swing: float = 0.3
    particles: int = 500

    def build(self, model: System, sensor: Zone) -> NumericObserver:
        """The filter for a sampled model. Raises InputError, ShapeError."""
        if not 2 <= self.particles <= 1_000_000:
            raise InputError(f"observer.particles: expected 2 to 1000000, found {self.particles}")
        return bootstrap(model, sensor, claims(self, model, sensor, HABITS), self.particles)


class State(NamedTuple):
    """M particles: x (n x M), widths (2p x M), weights (M, sum 1); the sample's number; the seed."""

    x: Floats
    widths: Floats
    weights: Floats
    sample: int
    seed: int


def bootstrap(model: System, sensor: Zone, given: Assumptions, count: int) -> NumericObserver:
    """The filter with `count` particles."""
    n, p, m = model.n, model.p, model.m
    believed, variance, ranges = given
    low, high = ranges[:, :1], ranges[:, 1:]
    move, output = _vectorised(model, count)
    even = np.full(count, 1.0 / count)

    def start(seed: int) -> State:
        rng = _random(seed, 0)
        x = believed.mean[:n, None] + believed.std[:n, None] * rng.standard_normal((n, count))
        return State(x, rng.uniform(low, high, (2 * p, count)), even, 1, seed)

    def correct(s: State, reading: Reading) -> tuple[State, Any]:
        seen = np.isfinite(reading.y)
        z = output(s.x)
        expected = np.asarray(read(sensor.kind, z, s.widths[:p], s.widths[p:]))
        residuals = np.where(seen, reading.y / sensor.slope, 0.0)[:, None] - expected
        weights = _weighted(s.weights, (residuals / np.sqrt(believed.R)[:, None])[seen])
        X = np.vstack([s.x, s.widths])
        mean, S = expected @ s.weights, believed.R + _variance(expected, s.weights)
        both = np.sqrt(_variance(s.widths[:p] + s.widths[p:], weights))
        innovation = np.where(seen, reading.y / sensor.slope - mean, 0.0)
        found = numeric_estimate(
            X @ weights,
            z @ weights,
            reading,
            sensor,
            innovation,
            np.sqrt(_variance(X, weights)),
            both,
            np.sqrt(S),
        )
        if 1.0 / (weights @ weights) < count / 2:
            at = systematic(weights, _random(s.seed, 2 * s.sample).uniform())
            return s._replace(x=s.x[:, at], widths=s.widths[:, at], weights=even), found
        return s._replace(weights=weights), found

    def predict(s: State, u: Floats) -> State:
        rng = _random(s.seed, 2 * s.sample + 1)
        x = move(s.x, u[:, None] + np.sqrt(variance)[:, None] * rng.standard_normal((m, count)))
        widths: Floats = s.widths + np.sqrt(believed.drift)[:, None] * rng.standard_normal(
            (2 * p, count)
        )
        widths = high - np.abs(
            high - low - np.abs(widths - low)
        )  # reflected at both ends of the range
        return s._replace(x=x, widths=widths, sample=s.sample + 1)

    return NumericObserver(believed, start, correct, predict)


def systematic(weights: Floats, offset: float) -> Any:
    """Which particle each of M becomes: those at the M points (i + offset) / M of the weights' cumulative sum."""
    count = weights.size
    found = np.searchsorted(np.cumsum(weights), (np.arange(count) + offset) / count)
    return np.minimum(found, count - 1)  # rounding of the sum


def _weighted(weights: Floats, e: Floats) -> Floats:
    """weights exp(-|e|^2 / 2), e a column for each, normalised; unchanged if no particle is a number any more."""
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        logs = np.log(weights) - (e**2).sum(axis=0) / 2
        found = np.exp(logs - logs.max())
        found = np.where(np.isfinite(found), found, 0.0)
    return found / found.sum() if found.sum() > 0 else weights


def _variance(rows: Floats, weights: Floats) -> Floats:
    """The weighted variance of each row."""
    return np.asarray((rows - (rows @ weights)[:, None]) ** 2 @ weights)


def _random(seed: int, purpose: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(key=[seed, STREAM], counter=[0, purpose, 0, 0]))


def _vectorised(
    model: System, count: int
) -> tuple[Callable[[Floats, Floats], Floats], Callable[[Floats], Floats]]:
    """The model's motion and output on `count` columns of numbers."""
    if not model.nonlinear:
        return lambda x, u: np.asarray(model.move(model.params, x, u)), lambda x: np.asarray(
            model.output(model.params, x)
        )
    x, u = ca.SX.sym("x", model.n), ca.SX.sym("u", model.m)
    move = ca.Function("move", [x, u], [model.move(ca.SX(model.params), x, u)]).map(count)
    output = ca.Function("output", [x], [model.output(ca.SX(model.params), x)]).map(count)
    return lambda x, u: move(x, u).full(), lambda x: output(x).full()
