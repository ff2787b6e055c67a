"""Bootstrap particle filter on [x; d_r; d_l] (docs/methods/particle_filter.md)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.interfaces import Estimate, InPython, Observer, Reading, Traits, in_python
from undeadzone.nonlinearities.sensor import Zone
from undeadzone.observers.filtering.prior import Prior, glitch_reach, glitch_share
from undeadzone.observers.filtering.recovery import LIMIT
from undeadzone.plants.system import System
from undeadzone.util.arrays import Floats, Integers
from undeadzone_arena.observers.parts.joint_claims import (
    Defaults,
    JointClaims,
    JointPrior,
    joint_prior,
    numeric_estimate,
    read,
)

# A likelihood that few particles meet leaves copies of these few.
DEFAULTS = Defaults(noise=0.1, drift=0.1, x_std=0.5)
STREAM = 0x7061727469636C65  # of the random numbers, apart from those of noise and disturbance


class ParticleFilter(JointClaims, frozen=True, kw_only=True, tag="particle_filter"):
    """Bootstrap filter of Gordon, Salmond, Smith (1993) on [x; d_r; d_l]; sampled time.

    Systematic resampling of Kitagawa (1996), when fewer than half of the particles count,
    1 / sum w^2. Widths are drawn evenly from their range and stay in it. By default noise is at
    least 10 % of the range, drift 10 % and x_std 50 % of the largest width. Random numbers follow
    from simulation.seed. It runs in Python: in single runs only.

    Attributes:
        swing: rms, in largest widths, by which the default disturbance moves z in a quarter period.
        particles: how many particles.
    """

    swing: float = 0.3
    particles: int = 500

    def build(self, model: System, sensor: Zone) -> Observer:
        """Return the filter for a sampled model."""
        if not 2 <= self.particles <= 1_000_000:
            raise InputError(f"observer.particles: expected 2 to 1000000, found {self.particles}")
        prior = joint_prior(self, model, sensor, DEFAULTS)
        return bootstrap(model, sensor, prior, self.particles, glitch_share(self.glitches))


class State(NamedTuple):
    """M particles.

    Attributes:
        x: states (n x M).
        widths: [d_r; d_l] (2p x M).
        weights: weights, of sum 1 (M).
        sample: number of the sample.
        seed: seed of the random numbers.
    """

    x: Floats
    widths: Floats
    weights: Floats
    sample: int
    seed: int


class Vectorised(NamedTuple):
    """A model on M columns of numbers.

    Attributes:
        move: move(x, u) is x at the next sample (n x M).
        output: output(x) is z (p x M).
    """

    move: Callable[[Floats, Floats], Floats]
    output: Callable[[Floats], Floats]


class Setup(NamedTuple):
    """What the parts of one filter share.

    Attributes:
        model: the sampled model.
        sensor: the dead zone.
        prior: what it starts from.
        particles: how many there are.
        glitches: probability that a reading is wrong.
        columns: the model on as many columns.
    """

    model: System
    sensor: Zone
    prior: JointPrior
    particles: int
    glitches: float
    columns: Vectorised


def bootstrap(
    model: System, sensor: Zone, prior: JointPrior, count: int, glitches: float
) -> Observer:
    """Return the filter with `count` particles; glitches: probability that a reading is wrong."""
    setup = Setup(model, sensor, prior, count, glitches, vectorised(model, count))
    how = InPython(partial(start, setup), partial(correct, setup), partial(predict, setup))
    return in_python(how, model.p, Traits())


def start(setup: Setup, seed: int) -> State:
    """Return particles drawn from the prior."""
    return drawn(setup, seed, 0)._replace(sample=1)


def drawn(setup: Setup, seed: int, sample: int) -> State:
    """Return particles drawn from the prior at that sample."""
    n, p, count = setup.model.n, setup.model.p, setup.particles
    prior, _, ranges = setup.prior
    rng = _random(seed, 2 * sample)
    x = prior.mean[:n, None] + prior.std[:n, None] * rng.standard_normal((n, count))
    widths = rng.uniform(ranges[:, :1], ranges[:, 1:], (2 * p, count))
    return State(x, widths, even(count), sample, seed)


def correct(setup: Setup, s: State, reading: Reading) -> tuple[State, Estimate]:
    """Return (the particles weighed by a reading and perhaps resampled, the estimate).

    Particles that left all bounds are drawn anew.
    """
    sensor, R, p = setup.sensor, setup.prior.prior.R, setup.model.p
    if not (np.abs(s.x) < LIMIT).all():
        s = drawn(setup, s.seed, s.sample)
    seen = np.isfinite(reading.y)
    z = setup.columns.output(s.x)
    y = np.where(seen, reading.y / sensor.slope, 0.0)
    expected = np.asarray(read(sensor.kind, z, s.widths[:p], s.widths[p:]))
    residuals = (y[:, None] - expected) / np.sqrt(R)[:, None]
    if sensor.limits is not None:
        residuals = limited(residuals, reading.side)
    glitch = glitch_odds(setup.glitches, setup.prior.prior)
    weights = reweighted(s.weights, residuals[seen], glitch[seen])
    X = np.vstack([s.x, s.widths])
    mean, S = expected @ s.weights, R + weighted_variance(expected, s.weights)
    width_variance = weighted_variance(s.widths[:p] + s.widths[p:], weights)
    estimated = numeric_estimate(
        X @ weights,
        z @ weights,
        reading,
        sensor,
        np.where(seen & (np.abs(reading.side) < 2), y - mean, 0.0),
        np.sqrt(weighted_variance(X, weights)),
        np.sqrt(width_variance),
        np.sqrt(S),
    )
    return resampled(s._replace(weights=weights)), estimated


def limited(e: Floats, side: Floats) -> Floats:
    """Return residuals whose half squares are those of a reading that only bounds z at a limit.

    There the likelihood is the chance that the sensor reads at least, or at most, as much.

    Args:
        e: residuals, in standard deviations (p x M).
        side: measured sides (p), +2 or -2 at a limit.
    """
    from scipy.special import log_ndtr

    of_bound = np.sqrt(-2 * log_ndtr(-np.sign(side)[:, None] * e))
    return np.where((np.abs(side) == 2)[:, None], of_bound, e)


def resampled(s: State) -> State:
    """Return the particles, drawn anew where fewer than half of them count, 1 / sum w^2."""
    count = s.weights.size
    if 1.0 / (s.weights @ s.weights) >= count / 2:
        return s
    at = systematic(s.weights, _random(s.seed, 2 * s.sample).uniform())
    return s._replace(x=s.x[:, at], widths=s.widths[:, at], weights=even(count))


def predict(setup: Setup, s: State, u: Floats) -> State:
    """Return the particles at the next sample; widths are reflected at both ends of their range."""
    m, p, count = setup.model.m, setup.model.p, setup.particles
    prior, variance, ranges = setup.prior
    low, high = ranges[:, :1], ranges[:, 1:]
    rng = _random(s.seed, 2 * s.sample + 1)
    disturbance = np.sqrt(variance)[:, None] * rng.standard_normal((m, count))
    x = setup.columns.move(s.x, u[:, None] + disturbance)
    walk = np.sqrt(prior.drift)[:, None] * rng.standard_normal((2 * p, count))
    widths: Floats = s.widths + walk
    widths = high - np.abs(high - low - np.abs(widths - low))
    return s._replace(x=x, widths=widths, sample=s.sample + 1)


def even(count: int) -> Floats:
    """Return the same weight for every particle."""
    return np.full(count, 1.0 / count)


def systematic(weights: Floats, offset: float) -> Integers:
    """Which particle each of M becomes.

    Those at the M points (i + offset) / M of the weights' cumulative sum.
    """
    count = weights.size
    points = (np.arange(count) + offset) / count
    places = np.searchsorted(np.cumsum(weights), points)
    return np.minimum(places, count - 1)  # rounding may leave the sum below the last point


def glitch_odds(glitches: float, prior: Prior) -> Floats:
    """Return log density of a glitch over that of a regular reading without residual (p)."""
    reach = glitch_reach(prior)
    with np.errstate(divide="ignore"):
        odds: Floats = np.log(glitches / (1 - glitches) * np.sqrt(2 * np.pi * prior.R) / reach)
    return odds


def reweighted(weights: Floats, e: Floats, glitch: Floats) -> Floats:
    """Return the weights times exp(-e^2 / 2) + exp(glitch) of each reading, normalised.

    Unchanged if no particle is a number any more.

    Args:
        weights: of the particles (M).
        e: residuals of the readings that were seen, in standard deviations (seen x M).
        glitch: `glitch_odds` of these readings (seen).
    """
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        likelihood = np.logaddexp(-(e**2) / 2, glitch[:, None])
        logs = np.log(weights) + likelihood.sum(axis=0)
        likely = np.exp(logs - logs.max())
        likely = np.where(np.isfinite(likely), likely, 0.0)
    total = likely.sum()
    return likely / total if total > 0 else weights


def weighted_variance(rows: Floats, weights: Floats) -> Floats:
    """Return the weighted variance of each row."""
    return np.asarray((rows - (rows @ weights)[:, None]) ** 2 @ weights)


def _random(seed: int, purpose: int) -> np.random.Generator:
    """Return random numbers of their own for every seed and purpose."""
    return np.random.Generator(np.random.Philox(key=[seed, STREAM], counter=[0, purpose, 0, 0]))


def vectorised(model: System, count: int) -> Vectorised:
    """Return the model's motion and output on `count` columns of numbers."""
    params = model.params
    if not model.nonlinear:
        return Vectorised(
            lambda x, u: np.asarray(model.move(params, x, u)),
            lambda x: np.asarray(model.output(params, x)),
        )
    x, u = ca.SX.sym("x", model.n), ca.SX.sym("u", model.m)
    move = ca.Function("move", [x, u], [model.move(ca.SX(params), x, u)]).map(count)
    output = ca.Function("output", [x], [model.output(ca.SX(params), x)]).map(count)
    return Vectorised(lambda x, u: move(x, u).full(), lambda x: output(x).full())
