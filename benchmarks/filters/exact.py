"""Filters beside the exact posterior: what their estimates lose, and how often intervals hold.

The rms of an error is that of the exact posterior and what a filter adds to it. The latter is the
distance of the two means, which two independent clouds of particles give without the noise of
either. So a few problems are enough: what the truth happens to be does not enter.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from benchmarks.filters import coverage
from benchmarks.filters.exact_posterior import EVERY, posterior
from benchmarks.filters.problems.exact_problems import (
    NOISE,
    RANGE,
    SAMPLES,
    STEP,
    Problem,
    problems,
)
from benchmarks.filters.rivals.plain_filters import (
    Track,
    filterpy_unscented,
    hearing,
    matching,
    tobit,
    tracked,
)
from benchmarks.markdown import head, row
from undeadzone.nonlinearities.sensor import Sensor
from undeadzone.observers import Auto, Censored
from undeadzone.util.arrays import Floats

ORDERS = (1, 2)
LEVELS = (4.0, 1.0, 0.25)  # of the disturbance that `Censored` weighs by default
COLUMNS = ("noise", "claims", "filter", "z", "widths", "coverage of z", "d_r", "d_l")
CLOUDS = 2  # of particles a problem
LOUD = (0.06, 0.14)  # least and largest rms, 5 to 12 % of the mean half width [z]


class World(NamedTuple):
    """Problems that are solved together.

    Attributes:
        ahead: whether the noise stands ahead of the zone.
        kinds: of the disturbance.
        levels: factors on its rms, of which no filter knows which is true.
        filters: name: tracks of problems of one order.
        noise: least and largest rms [z].
    """

    ahead: bool
    kinds: tuple[str, ...]
    levels: tuple[float, ...]
    filters: dict[str, Callable[[list[Problem]], list[Track]]]
    noise: tuple[float, float] = NOISE


class Score(NamedTuple):
    """Of one filter on one problem, z and both widths, each a mean over the snapshots.

    Attributes:
        lost: squared distance from the exact mean (3).
        variance: of the exact posterior (3).
        covered: exact chance that its 95 % interval holds the truth (3).
    """

    lost: Floats
    variance: Floats
    covered: Floats


def informed(posed: Problem, levels: int = 1) -> Censored:
    """`Censored` told all; a constant disturbance is a bias."""
    constant = np.isinf(posed.correlation)
    return Censored(
        right=list(RANGE),
        x_std=[0.5] * posed.order,
        disturbance=0.0 if constant else posed.disturbance,
        bias=posed.disturbance if constant else 0.0,
        correlation_time=None if constant else posed.correlation,
        calibrated=0.0,
        tolerance=0.0,
        drift=0.0,
        levels=levels,
    )


def weighing(posed: Problem) -> Censored:
    """`Censored` that weighs levels of the disturbance."""
    return informed(posed, len(LEVELS))


def ranges_alone(posed: Problem) -> Auto:
    """`Auto` told the ranges of the widths alone."""
    return Auto(right=list(RANGE))


def by_graph(options: Callable[[Problem], Any]) -> Callable[[list[Problem]], list[Track]]:
    """Tracks of one of our observers, one lane a problem."""

    def track(posed: list[Problem]) -> list[Track]:
        built = []
        for one in posed:
            place = "noise_before" if one.ahead else "noise"
            configured = options(one)
            known = {place: one.noise} | coverage.exact_shape_if_known(configured)
            sensor = Sensor(right=RANGE[1], left=RANGE[1], **known)
            built.append(coverage.built_for(configured, one.model, sensor, STEP))
        own = np.stack([np.stack([one.y, one.u], axis=1) for one in posed], axis=2)
        out = coverage.run_observers(built, coverage.step_of(built[0], ESTIMATES), own)
        sampled = out[:, EVERY - 1 :: EVERY]
        return [Track(one[:, :3], one[:, 3:]) for one in sampled]

    return track


ESTIMATES = coverage.selected("z right left x_std right_std left_std")


def one_by_one(track: Callable[[Problem], Track]) -> Callable[[list[Problem]], list[Track]]:
    """Tracks of a filter in Python."""
    return lambda posed: [track(one) for one in posed]


PLAIN = {
    "Kalman filter with `uz.deadzone_update`": one_by_one(
        lambda posed: tracked(posed, hearing(posed))
    ),
    "moment matching at every sample": one_by_one(lambda posed: tracked(posed, matching(posed))),
    "Tobit Kalman filter": one_by_one(lambda posed: tracked(posed, tobit(posed))),
    "FilterPy's UKF": one_by_one(filterpy_unscented),
}
INFORMED = {"`censored`": by_graph(informed), **PLAIN}
ALONE = {"`auto`, ranges alone": by_graph(ranges_alone)}
LEVELLED = {"`censored`": by_graph(weighing)}


def worlds() -> dict[tuple[str, str], World]:
    """The worlds by where the noise stands and what is claimed."""
    return {
        ("ahead", "all"): World(True, ("coloured", "white", "constant"), (1.0,), INFORMED | ALONE),
        ("behind", "all"): World(False, ("coloured", "white"), (1.0,), INFORMED | ALONE),
        ("ahead", "level unknown"): World(True, ("coloured",), LEVELS, LEVELLED),
        ("behind", "level unknown"): World(False, ("coloured",), LEVELS, LEVELLED),
        ("behind, loud", "all"): World(
            False, ("coloured", "white"), (1.0,), {"`censored`": INFORMED["`censored`"]}, LOUD
        ),
    }


def scores(world: World, count: int, seed: int) -> dict[str, list[Score]]:
    """The scores of every filter on `count` problems of each kind and order."""
    found: dict[str, list[Score]] = {name: [] for name in world.filters}
    for order, kind in itertools.product(ORDERS, world.kinds):
        posed = problems(kind, world.ahead, order, count, seed, world.levels, world.noise)
        tracks = {name: track(posed) for name, track in world.filters.items()}
        for k, one in enumerate(posed):
            each = {name: track[k] for name, track in tracks.items()}
            for name, score in scored(one, each, seed).items():
                found[name].append(score)
    return found


def scored(posed: Problem, tracks: dict[str, Track], seed: int) -> dict[str, Score]:
    """The scores of tracks of one problem."""
    first = next(iter(tracks.values()))
    guesses = [(first.mean[at, 1:], first.std[at, 1:]) for at in (-1, -30)]
    clouds = [posterior(posed, guesses, 2 * seed + i) for i in range(CLOUDS)]
    sums = {name: Score(np.zeros(3), np.zeros(3), np.zeros(3)) for name in tracks}
    for at, (one, other) in enumerate(zip(*clouds, strict=True)):
        means = one.mean(), other.mean()
        variance = (one.variance() + other.variance()) / 2 + (means[0] - means[1]) ** 2 / 4
        for name, track in tracks.items():
            away = track.mean[at] - means[0], track.mean[at] - means[1]
            reach = 1.96 * track.std[at]
            ends = track.mean[at] - reach, track.mean[at] + reach
            covered = (one.within(*ends) + other.within(*ends)) / 2
            sums[name] = Score(
                sums[name].lost + away[0] * away[1],
                sums[name].variance + variance,
                sums[name].covered + covered,
            )
    snapshots = SAMPLES // EVERY
    return {name: Score(*(part / snapshots for part in sum_)) for name, sum_ in sums.items()}


def cells(each: list[Score]) -> list[str]:
    """The scores in the cells of a row."""
    lost, variance, covered = (np.mean(part, axis=0) for part in zip(*each, strict=True))
    of_z = np.sqrt(1 + lost[0] / variance[0])
    of_widths = np.sqrt(1 + lost[1:].sum() / variance[1:].sum())
    return [f"{of_z:.3f}", f"{of_widths:.3f}", *(f"{share:.2f}" for share in covered)]


def table(count: int = 3, seed: int = 0) -> str:
    """The table, from `count` problems of each order and kind of disturbance."""
    lines = ["## Filters beside the exact posterior\n", *head(*COLUMNS)]
    for (noise, assumptions), world in worlds().items():
        for name, each in scores(world, count, seed).items():
            lines.append(row(noise, assumptions, name, *cells(each)))
    note = (
        "Rms of errors over that of the exact posterior: root of 1 + (squared distance of the "
        "means) / (exact variance), each a mean over snapshots and problems. Coverage: the exact "
        f"chance of 95 % intervals. {count} problems of each of the orders {ORDERS} and kinds of "
        "disturbance a row (noise ahead of the zone: coloured, white, constant; behind: coloured, "
        f"white), {SAMPLES * STEP:g} s at {1 / STEP:g} Hz. `auto` is told ranges of the widths, "
        "the exact posterior all. Level unknown: the rms of a coloured disturbance is 4, 1 or 1/4 "
        "times the claim, for the exact posterior too. Loud: noise of 5 to 12 % of a half width."
    )
    return "\n".join([*lines, "", note, ""])
