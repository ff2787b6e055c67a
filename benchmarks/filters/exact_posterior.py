"""The exact posterior of a dead zone: particles of the widths, each with particles of z.

Given the widths and on which branch of the zone z was, all is linear and Gaussian: particles carry
Kalman means (a covariance they share), are drawn from the exact predictive law of z, which is a
Gaussian cut at the edges, or three of them, and give an unbiased likelihood of the widths. Widths
are drawn from their range and from what filters say, and weighed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri

from benchmarks.filters.problems.exact_problems import RANGE, SAMPLES, Problem
from undeadzone.util.arrays import Floats

WIDTHS, PARTICLES = 300, 50  # drawn of the widths, and of z for each
EVERY = 10  # samples from one snapshot to the next
SURE = 1e-6  # chance that z is on another branch, below which nobody asks
DEAD = 20.0  # log of the odds at which widths are given up
LEAST = 1e-300


class Snapshot(NamedTuple):
    """The posterior after a reading, as weighted Gaussians of z and weighted widths.

    Attributes:
        z: means of z (particles).
        std: of z about each mean (particles).
        d: the widths d_r, d_l of each (particles x 2).
        weight: of each, of sum 1 (particles).
        log: of the likelihood of all readings so far.
    """

    z: Floats
    std: Floats
    d: Floats
    weight: Floats
    log: float

    def mean(self) -> Floats:
        """Of z, d_r, d_l (3)."""
        return np.append(self.weight @ self.z, self.weight @ self.d)

    def variance(self) -> Floats:
        """Of z, d_r, d_l (3)."""
        mean = self.mean()
        of_z = self.weight @ ((self.z - mean[0]) ** 2 + self.std**2)
        return np.append(of_z, self.weight @ (self.d - mean[1:]) ** 2)

    def within(self, low: Floats, high: Floats) -> Floats:
        """The chance that z, d_r, d_l lie in [low, high] (3)."""
        std = np.maximum(self.std, 1e-12)
        of_z = ndtr((high[0] - self.z) / std) - ndtr((low[0] - self.z) / std)
        inside = (self.d >= low[1:]) & (self.d <= high[1:])
        return np.append(self.weight @ of_z, self.weight @ inside)


class Cloud(NamedTuple):
    """Particles: M pairs of widths, J means of s each.

    Attributes:
        d: widths (M x 2).
        log: of the weight of each pair, its likelihood so far in it (M).
        mean: means of s (M x J x n + 1).
        weight: of each mean among those of its widths (M x J).
        cov: covariance of s, of all (n + 1 x n + 1).
    """

    d: Floats
    log: Floats
    mean: Floats
    weight: Floats
    cov: Floats


class ParticleUpdate(NamedTuple):
    """What a reading does: z of each particle is drawn, or read with noise, or left alone.

    Attributes:
        chance: density of the reading by each particle (M x J).
        e: innovation of each (M x J); None: none is moved.
        R: variance with which z is known then.
    """

    chance: Floats
    e: Floats | None
    R: float


def posterior(
    posed: Problem, guesses: Sequence[tuple[Floats, Floats]], seed: int, count: int = WIDTHS
) -> Iterator[Snapshot]:
    """Snapshots after each `EVERY`-th reading.

    Args:
        posed: the problem.
        guesses: means and standard deviations of d_r and d_l that some filter gives (2 each).
        seed: of all that is drawn.
        count: how many widths are drawn.
    """
    levels = []
    for i, factor in enumerate(posed.levels):
        rng = np.random.default_rng([seed, i])
        levels.append(_at_level(posed, factor, guesses, rng, count // len(posed.levels)))
    return map(_joined, zip(*levels, strict=True))


def _joined(parts: tuple[Snapshot, ...]) -> Snapshot:
    """One snapshot of several levels, each as likely as the others at first."""
    logs = np.array([part.log for part in parts])
    share = np.exp(logs - logs.max())
    share /= share.sum()
    return Snapshot(
        z=np.concatenate([part.z for part in parts]),
        std=np.concatenate([part.std for part in parts]),
        d=np.concatenate([part.d for part in parts]),
        weight=np.concatenate([w * part.weight for w, part in zip(share, parts, strict=True)]),
        log=float(logs.max() + np.log(np.mean(np.exp(logs - logs.max())))),
    )


def _at_level(
    posed: Problem,
    factor: float,
    guesses: Sequence[tuple[Floats, Floats]],
    rng: np.random.Generator,
    count: int,
) -> Iterator[Snapshot]:
    """The snapshots with the rms of the disturbance times a factor."""
    Q, cov = posed.at_level(factor)
    d, log = _drawn_widths(rng, guesses, count)
    cloud = Cloud(
        d=d,
        log=log - np.log(len(d)),
        mean=np.zeros((len(d), PARTICLES, len(cov))),
        weight=np.full((len(d), PARTICLES), 1 / PARTICLES),
        cov=cov,
    )
    for i in range(SAMPLES):
        cloud = _update_cloud(rng, posed, cloud, posed.y[i])
        if i % EVERY == EVERY - 1:
            yield _snapshot(cloud)
        cloud = cloud._replace(
            mean=cloud.mean @ posed.F.T + posed.G * posed.u[i],
            cov=posed.F @ cloud.cov @ posed.F.T + Q,
        )


def _drawn_widths(
    rng: np.random.Generator, guesses: Sequence[tuple[Floats, Floats]], count: int
) -> tuple[Floats, Floats]:
    """Widths (M x 2), a quarter of them from their ranges, and logs of what they weigh (M)."""
    low, high = RANGE
    prior = count // 4
    each = (count - prior) // max(len(guesses), 1)
    drawn, parts = [rng.uniform(low, high, (prior, 2))], []
    for mean, std in guesses:
        wide = np.maximum(1.5 * std, 0.004)
        ends = ndtr((low - mean) / wide), ndtr((high - mean) / wide)
        share = np.maximum(ends[1] - ends[0], 1e-12)
        at = np.clip(ends[0] + rng.uniform(size=(each, 2)) * share, 1e-12, 1 - 1e-12)
        drawn.append(np.clip(mean + wide * ndtri(at), low, high))
        parts.append((mean, wide, share))
    d = np.concatenate(drawn)
    density = np.full(len(d), prior / len(d))
    for mean, wide, share in parts:
        one = np.exp(-(((d - mean) / wide) ** 2) / 2) / np.sqrt(2 * np.pi) / wide / share
        density += each / len(d) * np.prod(one * (high - low), axis=1)
    return d, -np.log(density)


def _update_cloud(rng: np.random.Generator, posed: Problem, cloud: Cloud, y: float) -> Cloud:
    """The cloud after a reading."""
    update = (_ahead if posed.ahead else _behind)(rng, posed.noise, cloud, y)
    weight = cloud.weight * update.chance
    total = np.maximum(weight.sum(axis=1), LEAST)
    log = cloud.log + np.log(total)
    weight, mean, cov = weight / total[:, None], cloud.mean, cloud.cov
    if update.e is not None:
        S = cov[0, 0] + update.R
        K = cov[:, 0] / S
        mean = mean + update.e[:, :, None] * K
        cov = cov - S * np.outer(K, K)
    alive = log > log.max() - DEAD
    return _resampled(
        rng, Cloud(cloud.d[alive], log[alive], mean[alive], weight[alive], (cov + cov.T) / 2)
    )


def _ahead(rng: np.random.Generator, noise: float, cloud: Cloud, y: float) -> ParticleUpdate:
    """A reading with noise ahead of the zone: on a branch it is linear, and silence is a cut."""
    m, R = cloud.mean[:, :, 0], noise**2
    std = np.sqrt(cloud.cov[0, 0] + R)
    right, left = cloud.d[:, :1], cloud.d[:, 1:]
    if y != 0:
        e = y + (right if y > 0 else -left) - m
        return ParticleUpdate(_density(e, std), e, R)
    low, high = (-left - m) / std, (right - m) / std
    chance = _between(low, high)
    if _sure(cloud, chance, np.ones_like(chance)):
        return ParticleUpdate(chance, None, R)
    return ParticleUpdate(chance, std * _cut(rng, low, high), R)


def _behind(rng: np.random.Generator, noise: float, cloud: Cloud, y: float) -> ParticleUpdate:
    """A reading with noise behind the zone: z is on one of three branches."""
    m, R, V = cloud.mean[:, :, 0], noise**2, max(cloud.cov[0, 0], 1e-18)
    right, left = cloud.d[:, :1], cloud.d[:, 1:]
    std, narrow = np.sqrt(V), np.sqrt(V * R / (V + R))
    e_right, e_left = y + right - m, y - left - m
    at_right, at_left = e_right * V / (V + R), e_left * V / (V + R)  # of z, less m
    cuts = (right - m, -left - m)
    chances = [
        _density(e_right, np.sqrt(V + R)) * ndtr((at_right - cuts[0]) / narrow),
        _density(y, noise) * _between(cuts[1] / std, cuts[0] / std),
        _density(e_left, np.sqrt(V + R)) * ndtr((cuts[1] - at_left) / narrow),
    ]
    chance = np.maximum(sum(chances), LEAST)
    if _sure(cloud, chances[1], chance):
        return ParticleUpdate(chance, None, R)
    for branch, e in ((0, e_right), (2, e_left)):
        if _sure(cloud, chances[branch], chance):
            return ParticleUpdate(chance, e, R)
    at = rng.uniform(size=m.shape) * chance
    on_right, on_left = at < chances[0], at >= chances[0] + chances[1]
    middle = np.where(on_right, at_right, np.where(on_left, at_left, 0.0))
    spread = np.where(on_right | on_left, narrow, std)
    low = np.where(on_right, cuts[0], np.where(on_left, -np.inf, cuts[1]))
    high = np.where(on_right, np.inf, np.where(on_left, cuts[1], cuts[0]))
    e = middle + spread * _cut(rng, (low - middle) / spread, (high - middle) / spread)
    return ParticleUpdate(chance, e, 0.0)


def _sure(cloud: Cloud, branch: Floats, total: Floats) -> bool:
    """Whether z is surely on a branch, whose part of the chance is given."""
    other = (cloud.weight * (1 - branch / total)).sum(axis=1)
    return bool(np.exp(cloud.log - cloud.log.max()) @ other < SURE)


def _density(e: Floats | float, std: float) -> Floats:
    """Of a normal distribution; never 0."""
    return np.exp(-np.minimum((e / std) ** 2 / 2, 600.0)) / (np.sqrt(2 * np.pi) * std)


def _between(low: Floats, high: Floats) -> Floats:
    """The chance that a standard normal number lies there, exact in its tails; never 0."""
    flip = low > 0
    a, b = np.where(flip, -high, low), np.where(flip, -low, high)
    return np.maximum(ndtr(b) - ndtr(a), LEAST)


def _cut(rng: np.random.Generator, low: Floats, high: Floats) -> Floats:
    """Standard normal numbers between low and high."""
    flip = low > 0
    a, b = ndtr(np.where(flip, -high, low)), ndtr(np.where(flip, -low, high))
    number = ndtri(np.clip(a + rng.uniform(size=low.shape) * (b - a), LEAST, 1 - 1e-16))
    number = np.clip(np.where(flip, -number, number), low, high)
    return np.where(np.isfinite(number), number, 0.0)


def _resampled(rng: np.random.Generator, cloud: Cloud) -> Cloud:
    """The cloud with new particles for widths of which few count."""
    count = cloud.weight.shape[1]
    few = (cloud.weight**2).sum(axis=1) > 2 / count
    if not few.any():
        return cloud
    rows = np.arange(few.sum())[:, None]
    summed = np.cumsum(cloud.weight[few], axis=1)
    summed = summed / summed[:, -1:] + rows
    positions = (np.arange(count) + rng.uniform(size=(len(rows), 1))) / count + rows
    places = (
        np.searchsorted(summed.ravel(), positions.ravel()).reshape(positions.shape) - rows * count
    )
    mean, weight = cloud.mean.copy(), cloud.weight.copy()
    mean[few] = np.take_along_axis(mean[few], np.clip(places, 0, count - 1)[:, :, None], axis=1)
    weight[few] = 1 / count
    return cloud._replace(mean=mean, weight=weight)


def _snapshot(cloud: Cloud) -> Snapshot:
    """The cloud as it is."""
    share = np.exp(cloud.log - cloud.log.max())
    weight = cloud.weight * (share / share.sum())[:, None]
    count = cloud.weight.shape[1]
    std = np.sqrt(max(cloud.cov[0, 0], 0.0))
    return Snapshot(
        z=cloud.mean[:, :, 0].ravel(),
        std=np.full(weight.size, std),
        d=np.repeat(cloud.d, count, axis=0),
        weight=weight.ravel(),
        log=float(cloud.log.max() + np.log(share.sum())),
    )
