"""Bootstrap particle filter on `[x; d_r; d_l]` (docs/methods/nonlinear_filters.md)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.interfaces import (
    Estimate,
    Observer,
    PythonObserver,
    Reading,
    Traits,
    build_python_observer,
)
from undeadzone.nonlinearities.sensor import Zone
from undeadzone.observers.filtering.prior import Prior, outlier_probability, outlier_reach
from undeadzone.observers.filtering.recovery import LIMIT
from undeadzone.plants.system import System
from undeadzone.util.arrays import Floats, Integers
from undeadzone_arena.observers.parts.joint_claims import (
    JointAssumptions,
    JointDefaults,
    JointPrior,
    build_joint_prior,
    numeric_estimate,
    zone_reading,
)

# A likelihood that few particles meet leaves copies of these few.
DEFAULTS = JointDefaults(noise=0.1, drift=0.1, x_std=0.5)
STREAM = 0x7061727469636C65  # of the random numbers, apart from those of noise and disturbance


class ParticleFilter(JointAssumptions, frozen=True, kw_only=True, tag="particle_filter"):
    """Bootstrap filter of Gordon, Salmond, Smith (1993) on `[x; d_r; d_l]`, sampled time.

    Systematic resampling of Kitagawa (1996), when fewer than half of the particles count,
    1 / sum w^2. Widths are drawn evenly from their range and stay in it. By default noise is at
    least 10 % of the range, drift 10 % and x_std 50 % of the largest width. Random numbers follow
    from simulation.seed. It runs in Python: in single runs only.

    References:
        N. J. Gordon, D. J. Salmond, A. F. M. Smith (1993), doi:10.1049/ip-f-2.1993.0015
        G. Kitagawa (1996), doi:10.1080/10618600.1996.10474692

    Attributes:
        swing: rms, in largest widths, by which the default disturbance moves z in a quarter period.
        particles: how many particles.
    """

    swing: float = 0.3
    particles: int = 500

    def build(self, model: System, sensor: Zone) -> Observer:
        """Build the filter for a sampled model."""
        if not 2 <= self.particles <= 1_000_000:
            raise InputError(f"observer.particles: expected 2 to 1000000, found {self.particles}")
        prior = build_joint_prior(self, model, sensor, DEFAULTS)
        count = self.particles
        glitches = outlier_probability(self.glitches)
        columns = vectorise_model(model, count)
        setup = ParticleSetup(model, sensor, prior, count, glitches, columns)
        how = PythonObserver(
            partial(start_particles, setup),
            partial(correct_particles, setup),
            partial(predict_particles, setup),
        )
        return build_python_observer(how, model.p, Traits())


class ParticleState(NamedTuple):
    """State of M particles.

    Attributes:
        x: states (n x M).
        widths: `[d_r; d_l]` (2p x M).
        weights: weights, of sum 1 (M).
        sample: number of the sample.
        seed: seed of the random numbers.
    """

    x: Floats
    widths: Floats
    weights: Floats
    sample: int
    seed: int


class VectorModel(NamedTuple):
    """Model on M columns of numbers.

    Attributes:
        move: move(x, u) is x at the next sample (n x M).
        output: output(x) is z (p x M).
    """

    move: Callable[[Floats, Floats], Floats]
    output: Callable[[Floats], Floats]


class ParticleSetup(NamedTuple):
    """Fixed parts of one filter.

    Attributes:
        model: the sampled model.
        sensor: the dead zone.
        prior: prior at its start.
        particles: how many there are.
        glitches: probability that a reading is wrong.
        columns: the model on as many columns.
    """

    model: System
    sensor: Zone
    prior: JointPrior
    particles: int
    glitches: float
    columns: VectorModel


def start_particles(setup: ParticleSetup, seed: int) -> ParticleState:
    """Return particles drawn from the prior at t = 0."""
    return draw_particles(setup, seed, 0)._replace(sample=1)


def draw_particles(setup: ParticleSetup, seed: int, sample: int) -> ParticleState:
    """Draw particles from the prior at a sample."""
    n = setup.model.n
    p = setup.model.p
    count = setup.particles
    prior, _, ranges = setup.prior
    rng = _random_generator(seed, 2 * sample)
    x = prior.mean[:n, None] + prior.std[:n, None] * rng.standard_normal((n, count))
    widths = rng.uniform(ranges[:, :1], ranges[:, 1:], (2 * p, count))
    return ParticleState(x, widths, equal_weights(count), sample, seed)


def correct_particles(
    setup: ParticleSetup, s: ParticleState, reading: Reading
) -> tuple[ParticleState, Estimate]:
    """Return the particles weighted by a reading, resampled if needed, and the estimate.

    Particles that left all bounds are drawn anew.
    """
    sensor = setup.sensor
    R = setup.prior.prior.R
    p = setup.model.p
    if not (np.abs(s.x) < LIMIT).all():
        s = draw_particles(setup, s.seed, s.sample)
    seen = np.isfinite(reading.y)
    z = setup.columns.output(s.x)
    y = np.where(seen, reading.y / sensor.slope, 0.0)
    expected = np.asarray(zone_reading(sensor.kind, z, s.widths[:p], s.widths[p:]))
    residuals = (y[:, None] - expected) / np.sqrt(R)[:, None]
    if sensor.limits is not None:
        residuals = residuals_at_limits(residuals, reading.side)
    glitch = glitch_odds(setup.glitches, setup.prior.prior)
    weights = update_particle_weights(s.weights, residuals[seen], glitch[seen])
    X = np.vstack([s.x, s.widths])
    mean = expected @ s.weights
    S = R + particle_variance(expected, s.weights)
    width_variance = particle_variance(s.widths[:p] + s.widths[p:], weights)
    estimated = numeric_estimate(
        X @ weights,
        z @ weights,
        reading,
        sensor,
        np.where(seen & (np.abs(reading.side) < 2), y - mean, 0.0),
        np.sqrt(particle_variance(X, weights)),
        np.sqrt(width_variance),
        np.sqrt(S),
    )
    return resample_particles(s._replace(weights=weights)), estimated


def residuals_at_limits(e: Floats, side: Floats) -> Floats:
    """Return the residuals, adapted for a reading that only bounds z at a limit (p x M) [1].

    There the likelihood is the chance that the sensor reads at least, or at most, as much.

    Args:
        e: residuals, in standard deviations (p x M).
        side: measured sides (p), +2 or -2 at a limit.
    """
    from scipy.special import log_ndtr

    of_bound = np.sqrt(-2 * log_ndtr(-np.sign(side)[:, None] * e))
    return np.where((np.abs(side) == 2)[:, None], of_bound, e)


def resample_particles(s: ParticleState) -> ParticleState:
    """Sample new particles if fewer than half of the old count, 1 / sum w^2."""
    count = s.weights.size
    if 1.0 / (s.weights @ s.weights) >= count / 2:
        return s
    at = systematic_indices(s.weights, _random_generator(s.seed, 2 * s.sample).uniform())
    return s._replace(x=s.x[:, at], widths=s.widths[:, at], weights=equal_weights(count))


def predict_particles(setup: ParticleSetup, s: ParticleState, u: Floats) -> ParticleState:
    """Return the particles at the next sample.

    Widths are reflected at both ends of their range.
    """
    m = setup.model.m
    p = setup.model.p
    count = setup.particles
    prior, variance, ranges = setup.prior
    low = ranges[:, :1]
    high = ranges[:, 1:]
    rng = _random_generator(s.seed, 2 * s.sample + 1)
    disturbance = np.sqrt(variance)[:, None] * rng.standard_normal((m, count))
    x = setup.columns.move(s.x, u[:, None] + disturbance)
    walk = np.sqrt(prior.drift)[:, None] * rng.standard_normal((2 * p, count))
    widths: Floats = s.widths + walk
    widths = high - np.abs(high - low - np.abs(widths - low))
    return s._replace(x=x, widths=widths, sample=s.sample + 1)


def equal_weights(count: int) -> Floats:
    """Return the same weight for every particle (M) [1]."""
    return np.full(count, 1.0 / count)


def systematic_indices(weights: Floats, offset: float) -> Integers:
    """Return the indices of the particles to copy (M).

    Those at the M points (i + offset) / M of the weights' cumulative sum.
    """
    count = weights.size
    points = (np.arange(count) + offset) / count
    places = np.searchsorted(np.cumsum(weights), points)
    return np.minimum(places, count - 1)  # rounding may leave the sum below the last point


def glitch_odds(glitches: float, prior: Prior) -> Floats:
    """Return the log density ratio of a glitch to a reading without residual (p) [1]."""
    reach = outlier_reach(prior)
    with np.errstate(divide="ignore"):
        odds: Floats = np.log(glitches / (1 - glitches) * np.sqrt(2 * np.pi * prior.R) / reach)
    return odds


def update_particle_weights(weights: Floats, e: Floats, glitch: Floats) -> Floats:
    """Return the weights times exp(-e^2 / 2) + exp(glitch) per reading, normalised (M) [1].

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


def particle_variance(rows: Floats, weights: Floats) -> Floats:
    """Return the weighted variance of each row."""
    return np.asarray((rows - (rows @ weights)[:, None]) ** 2 @ weights)


def _random_generator(seed: int, purpose: int) -> np.random.Generator:
    """Return a random generator for a seed and a purpose."""
    return np.random.Generator(np.random.Philox(key=[seed, STREAM], counter=[0, purpose, 0, 0]))


def vectorise_model(model: System, count: int) -> VectorModel:
    """Return the model's motion and output on `count` columns of numbers."""
    params = model.params
    if not model.nonlinear:
        return VectorModel(
            lambda x, u: np.asarray(model.move(params, x, u)),
            lambda x: np.asarray(model.output(params, x)),
        )
    x = ca.SX.sym("x", model.n)
    u = ca.SX.sym("u", model.m)
    move = ca.Function("move", [x, u], [model.move(ca.SX(params), x, u)]).map(count)
    output = ca.Function("output", [x], [model.output(ca.SX(params), x)]).map(count)
    return VectorModel(lambda x, u: move(x, u).full(), lambda x: output(x).full())
