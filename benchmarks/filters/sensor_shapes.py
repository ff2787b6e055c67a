"""Sensors with a shape, or more noise than declared: what these do to the filters.

Every problem is solved by a filter that takes the sensor for exact and by the one that allows for
a shape, as it does by default.
`python -m benchmarks sensor_shapes --count 32 --orders 2` is a short one.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import msgspec
import numpy as np

from benchmarks.filters.glitches import Outcome, doubting, from_ranges, frozen, observe
from benchmarks.filters.problems.assumed_worlds import KINDS, problems
from benchmarks.filters.problems.random_plants import Problems
from benchmarks.markdown import head, row
from undeadzone.interfaces import Observer
from undeadzone.nonlinearities.sensor import deadzone
from undeadzone.observers import Extended, Kalman
from undeadzone.util.arrays import Floats

ORDERS = (1, 2, 3)
EXACT = {"rounding": np.zeros(1), "slope_std": np.zeros(1), "lag": np.zeros(1)}
COLUMNS = (
    "sensor",
    "claims",
    "exact: lowest",
    "flagged",
    "shape: d_r",
    "d_l",
    "width",
    "centre",
    "z",
    "lowest",
    "flagged",
    "rms of z, median",
    "of all",
    "deviation of a width",
    "over that of the rms told",
)

Read = Callable[[np.random.Generator, Floats, Floats, Floats], Floats]
"""(generator, z (samples x K), d (K x 2), noise (K)) -> readings (samples x K)."""


Sensor = Callable[[Floats, Floats], Floats]
"""(z (samples x K), d (K x 2)) -> readings without noise."""


def noisy(sensor: Sensor, times: float = 1.0) -> Read:
    """The readings of a sensor, with so many times the noise that is declared."""

    def read(rng: np.random.Generator, z: Floats, d: Floats, noise: Floats) -> Floats:
        return np.asarray(sensor(z, d) + times * noise * rng.normal(size=z.shape))

    return read


def sharp(z: Floats, d: Floats) -> Floats:
    """An exact dead zone."""
    return np.asarray(deadzone(z, *d.T))


exact = noisy(sharp)


def humming(rng: np.random.Generator, z: Floats, d: Floats, noise: Floats) -> Floats:
    """A tone of 0.07 mean half widths, peak, that repeats after 12 samples."""
    tone = np.sin(np.arange(len(z)) * np.pi / 6)[:, None]
    return exact(rng, z, d, noise) + 0.07 * d.mean(axis=1) * tone


def jittering(rng: np.random.Generator, z: Floats, d: Floats, noise: Floats) -> Floats:
    """Edges that are elsewhere at each sample, by a tenth of the mean half width."""
    return exact(rng, z + 0.1 * d.mean(axis=1) * rng.normal(size=z.shape), d, noise)


def rounded(share: float, z: Floats, d: Floats) -> Floats:
    """Edges rounded over a share of the mean half width."""
    p = share * d.mean(axis=1)
    right, left = (z - d[:, 0]) / p, (-z - d[:, 1]) / p
    return np.asarray(p * (np.logaddexp(0.0, right) - np.logaddexp(0.0, left)))


def averaged(count: int, z: Floats, d: Floats) -> Floats:
    """The mean of the last readings."""
    y = sharp(z, d)
    first = np.repeat(y[:1], count - 1, axis=0)
    sums = np.cumsum(np.vstack([np.zeros_like(y[:1]), first, y]), axis=0)
    return np.asarray((sums[count:] - sums[:-count]) / count)


def lagging(samples: float, z: Floats, d: Floats) -> Floats:
    """A filter of first order behind the zone."""
    y, keep = sharp(z, d), np.exp(-1 / samples)
    for k in range(1, len(y)):
        y[k] = keep * y[k - 1] + (1 - keep) * y[k]
    return y


def growing(share: float, z: Floats, d: Floats) -> Floats:
    """Widths that grow by a share of themselves until the end."""
    size = np.linspace(1 - share, 1.0, len(z))[:, None]
    return np.asarray(deadzone(z, d[:, 0] * size, d[:, 1] * size))


def repeating(share: float) -> Read:
    """Readings of which some repeat the one before."""

    def read(rng: np.random.Generator, z: Floats, d: Floats, noise: Floats) -> Floats:
        y, again = exact(rng, z, d, noise), rng.uniform(size=z.shape) < share
        for k in range(1, len(y)):
            y[k] = np.where(again[k], y[k - 1], y[k])
        return y

    return read


def stuck(rng: np.random.Generator, z: Floats, d: Floats, noise: Floats) -> Floats:
    """A sensor that is stuck for 100 samples from the middle on."""
    return frozen(rng, exact(rng, z, d, noise))


SENSORS: dict[str, Read] = {
    "honest": exact,
    "edges rounded 0.1": noisy(partial(rounded, 0.1)),
    "slope 1.05": noisy(lambda z, d: 1.05 * sharp(z, d)),
    "slope 1.1": noisy(lambda z, d: 1.1 * sharp(z, d)),
    "mean of 3": noisy(partial(averaged, 3)),
    "mean of 8": noisy(partial(averaged, 8)),
    "lag of 3 samples": noisy(partial(lagging, 3.0)),
    "2 % repeat": repeating(0.02),
    "10 % repeat": repeating(0.1),
    "50 % repeat": repeating(0.5),
    "stuck for 100": stuck,
    "widths grow 20 %": noisy(partial(growing, 0.2)),
    "edges rounded 0.3": noisy(partial(rounded, 0.3)),
    "noise x 3": noisy(sharp, 3.0),
    "noise x 5": noisy(sharp, 5.0),
    "hum": humming,
    "edges jitter": jittering,
}


class Assuming(NamedTuple):
    """Options of a filter whose sensor is assumed to have some shape."""

    options: Any
    shape: dict[str, Any]

    def build(self, model: Any, sensor: Any) -> Observer:
        """Return the filter."""
        built: Observer = self.options.build(model, msgspec.structs.replace(sensor, **self.shape))
        return built


ASSUMPTIONS: dict[str, Any] = {
    "told": doubting,
    "ranges alone": from_ranges,
    "`extended`": partial(from_ranges, options=Extended),
    "`kalman`": partial(from_ranges, options=Kalman),
}
USUAL = ("told", "ranges alone")


def solve(assumptions: str, posed: Problems, shape: dict[str, Any]) -> Outcome:
    """Return what a filter makes of problems.

    Args:
        assumptions: one of `ASSUMPTIONS`.
        posed: the problems.
        shape: what is assumed of the sensor; {}: what is by default.
    """
    return observe(lambda known, k: Assuming(ASSUMPTIONS[assumptions](known, k), shape), posed)


def tell_rms(posed: Problems) -> Problems:
    """The problems with the rms of readings outside the zone as the declared noise."""
    right = deadzone(posed.z, *posed.d.T)
    return posed._replace(noise=np.std(posed.y - right, axis=0, where=right != 0))


class Pooled(NamedTuple):
    """Outcomes of several orders: shares held (5), flagged, errors of z and deviations (K)."""

    covered: Floats
    flagged: float
    rms: Floats
    std: Floats


def _pool(outcomes: Sequence[Outcome], sizes: Floats) -> Pooled:
    """Return outcomes of all orders as one; errors over half widths `sizes` (K)."""
    covered = np.mean([one.verdict.covered() for one in outcomes], axis=0)
    flagged = 1 - np.mean([one.consistent.mean() for one in outcomes])
    rms = np.concatenate([one.rms for one in outcomes]) / sizes
    return Pooled(
        covered, float(flagged), rms, np.concatenate([one.verdict.stds[:, 2] for one in outcomes])
    )


def table(
    count: int = 48,
    seed: int = 7,
    orders: Sequence[int] = ORDERS,
    assumptions: Sequence[str] = USUAL,
    sensors: Sequence[str] = tuple(SENSORS),
) -> str:
    """The table, from `count` problems of each order a row."""
    kind, alike = KINDS["both edges"], (0.8, 1.25)
    posed = [problems(kind, order, count, seed, ratios=alike) for order in orders]
    sizes = np.concatenate([one.d.mean(axis=1) for one in posed])
    lines = ["## Sensors with a shape\n", *head(*COLUMNS)]
    for name in sensors:
        read = []
        for one in posed:
            rng = np.random.default_rng([seed, len(one.models[0].A)])
            read.append(one._replace(y=SENSORS[name](rng, one.z, one.d, one.noise)))
        for assumed in assumptions:
            sharp = _pool([solve(assumed, one, EXACT) for one in read], sizes)
            wide = _pool([solve(assumed, one, {}) for one in read], sizes)
            told = _pool([solve(assumed, tell_rms(one), EXACT) for one in read], sizes)
            of_all = np.sqrt(np.mean(wide.rms**2) / np.mean(sharp.rms**2))
            lines.append(
                row(
                    name,
                    assumed,
                    f"{sharp.covered.min():.2f}",
                    f"{sharp.flagged:.2f}",
                    *(f"{share:.2f}" for share in wide.covered),
                    f"{wide.covered.min():.2f}",
                    f"{wide.flagged:.2f}",
                    f"{np.median(wide.rms / sharp.rms):.2f}",
                    f"{of_all:.2f}",
                    f"{np.median(wide.std / sharp.std):.2f}",
                    f"{np.median(sharp.std / told.std):.2f}",
                )
            )
            print(lines[-1], file=sys.stderr, flush=True)
    note = (
        f"{count * len(orders)} problems of orders {tuple(orders)} a row, seed {seed}, whose z "
        "reaches both edges. Lowest: share of 95 % intervals that hold the truth in the end, the "
        "least of d_r, d_l, width, centre and z. The three columns before the last are over those "
        "of the filter that takes the sensor for exact, and the last is its deviation over that of "
        "the same filter told the rms of its readings outside the zone."
    )
    return "\n".join([*lines, "", note, ""])
