"""Filter of a signal without an input: modes that walk, and modes whose speed walks, at many rates.

The state of a mode is `[z; z']`. From sample to sample the mode may change (interacting multiple
models, Blom and Bar-Shalom 1988), and the readings choose: modes count by how well they foretell
them. Each reading is on a side of the zone, silent, or wrong, and every mode takes the mixture of
the three. docs/signal.md has the equations.

What is shown of z departs from a reading by at most its rms (limited translation, Efron and Morris
1971, doi:10.1080/01621459.1971.10482350), since a motion that ends at once leaves z between the
reading and its prediction.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.interfaces import (
    Estimate,
    Observer,
    Reading,
    build_estimate,
    drop_limit_readings,
)
from undeadzone.nonlinearities.sensor import Zone, present
from undeadzone.numerics.gaussian import (
    Gaussian,
    from_upper_entries,
    joseph_update,
    mirror_upper,
    mix_gaussians,
    normal_density,
    to_upper_entries,
    truncate_to_range,
)
from undeadzone.observers.filtering.innovation_tests import assumption_fields, is_repeated
from undeadzone.observers.filtering.prior import (
    SILENT,
    Assumptions,
    build_prior,
    outlier_probability,
    outlier_reach,
    prior_traits,
    require_sample_time,
)
from undeadzone.plants.system import System
from undeadzone.util.arrays import Floats
from undeadzone.util.text import HALF_95

# Motions of a step: those that noise may hide [its rms], and the fastest [largest reading].
# With half and double of each number down to START no answer of five worlds changes (six seeds
# each): 0.34 to 0.80 of the readings' rms for 0.36 to 0.79, held within 0.01, no false alarm.
WALKS = (1 / 16, 1 / 4, 1.0)
RAMPS = (1 / 128, 1 / 8, 2.0)
JUMPS = (0.5, 0.05)
STAY = 0.995  # probability that the mode of a sample is that of the next; else it is any
UNKNOWN = 0.1  # rms of a noise that is not declared, before the first reading [widest edge]
MOST = 1000.0  # readings that count in the noise's rms
LATELY = 64.0  # readings of which shares are taken
MANY = 0.05  # share of readings inside an edge from which the edge is another
RUN = 20.0  # readings in a row that repeat each other, from which a noisy sensor is stuck
START = 1e3  # deviation of the first z [outlier's reach]
FAR = 1e30  # span of wrong readings before the first, which so counts as right [z]
TINY = 1e-12  # least probability of a wrong reading: some number is always likeliest
LEAST = 1e-30  # sum of densities that divides; a float holds it
UPPER = ca.Sparsity.upper(2)  # of a covariance, as states hold it


class Mode(NamedTuple):
    """Gaussian belief of a mode about `[z; z' in a step]`, whose speed may be 0 for sure.

    Attributes:
        mean: (2).
        spread: covariance (see `to_upper_entries`).
    """

    mean: Any
    spread: Any


class State(NamedTuple):
    """State of the filter from sample to sample.

    Attributes:
        modes: their beliefs before the next reading (K).
        odds: probabilities of the modes (K).
        R: learnt variance of a reading outside the zone (1) [z^2].
        known: readings that it rests on (1).
        span: over which a wrong reading is spread, and a jump goes (1) [z].
        last: reading before (1) [y].
        same: readings in a row that repeat each other (1).
        refused: readings that were taken for wrong (1).
        inside: share of readings inside an edge, of late (1).
    """

    modes: tuple[Mode, ...]
    odds: Any
    R: Any
    known: Any
    span: Any
    last: Any
    same: Any
    refused: Any
    inside: Any


class Params(NamedTuple):
    """Numbers of the filter.

    Attributes:
        keep: 1 if the speed walks, 0 if z does (K).
        slow, fast: variances of z in a step (K) [variance of noise, square of the span].
        R, quiet: least variance of a reading outside and inside the zone (1) [z^2].
        start: variance of a reading outside it before the first one (1) [z^2].
        middle, least, most: of the ranges of the right and the left edge (2) [z].
        slope: of the sensor (1).
        glitch: probability of a wrong reading (1).
        reach: over which a wrong reading is spread at least (1) [z].
        noisy: 1 if a reading that repeats the one before counts as missing (1).
    """

    keep: Floats
    slow: Floats
    fast: Floats
    R: Floats
    quiet: Floats
    start: Floats
    middle: Floats
    least: Floats
    most: Floats
    slope: Floats
    glitch: Floats
    reach: Floats
    noisy: Floats


def build_signal_filter(options: Assumptions, model: System, sensor: Zone) -> Observer:
    """Return the filter of a signal. Raises InputError for a sensor with a play.

    Args:
        options: ranges of the edges, noise and glitches are used.
        model: the sampled signal.
        sensor: a dead zone, or a sensor that jumps.
    """
    if sensor.moves:
        raise InputError("sensor.kind: a signal without an input is read behind a zone, no play")
    prior = build_prior(options, model, sensor)
    behind = np.hypot(sensor.noise, sensor.quantum / np.sqrt(12)) / sensor.slope
    params = Params(
        keep=np.repeat([0.0, 1.0], [len(WALKS) + 1, len(RAMPS) + 1]),
        slow=np.array([*WALKS, 0.0, *RAMPS, 0.0]) ** 2,
        fast=np.array([*np.zeros(len(WALKS)), JUMPS[0], *np.zeros(len(RAMPS)), JUMPS[1]]) ** 2,
        R=prior.R,
        quiet=np.maximum(behind**2, 1e-2 * prior.R),
        start=np.where(prior.declared, prior.R, (UNKNOWN * prior.largest) ** 2),
        middle=prior.mean[2:],
        least=prior.ranges[:, 0],
        most=prior.ranges[:, 1],
        slope=sensor.slope,
        glitch=np.array([max(outlier_probability(options.glitches, 0.0), TINY)]),
        reach=outlier_reach(prior),
        noisy=1.0 * ((sensor.noise + sensor.noise_before > 0) & (sensor.quantum == 0)),
    )
    step = partial(step_signal, require_sample_time(model), sensor)
    return Observer(params, start_signal, step, traits=prior_traits(prior, options.x_std))


def start_signal(q: Params) -> State:
    """Return the state at t = 0."""
    count = q.keep.size
    first = Mode(np.zeros(2), np.array([(START * q.reach[0]) ** 2, 0.0, 0.0]))
    even = np.full(count, 1 / count)
    numbers = even, q.start, np.ones(1), q.reach + FAR, *np.zeros((4, 1))
    return State((first,) * count, *numbers)


def step_signal(
    Ts: float, sensor: Zone, q: Params, s: State, u: Any, reading: Reading
) -> tuple[State, Estimate]:
    """Return the next state, and the estimate after a reading."""
    reading = drop_limit_readings(reading, sensor.limits)
    there = present(reading.y)
    y = ca.if_else(there, reading.y, 0.0)
    repeated = there * is_repeated(q, y, s.last) * (y != 0)
    used = there * (1 - repeated)
    each = [
        read_signal(
            sensor,
            q,
            s,
            one,
            y,
            used,
            reading.side,
        )
        for one in s.modes
    ]
    beliefs, likely, e, S, shares = zip(*each, strict=True)
    e, S = ca.vertcat(*e), ca.vertcat(*S)
    odds = s.odds * ca.vertcat(*likely)
    odds = odds / ca.fmax(ca.sum1(odds), LEAST)
    outside, silent, wrong = ca.vertsplit(used * (ca.horzcat(*shares) @ odds))
    news = used * odds * ca.horzcat(*shares)[0, :].T * (s.R / S) ** 2
    known = s.known + ca.sum1(news)
    R = ca.fmax(q.R, s.R + ca.sum1(news * (e**2 - S)) / known)
    faded = ca.if_else(s.span < FAR, s.span * (1 - 1 / MOST), 0.0)
    span = ca.fmax(q.reach, ca.fmax(ca.fabs(y / q.slope), faded))
    other = (1 - STAY) / len(each)
    later = STAY * odds + other
    modes = []
    for k, stays in enumerate(np.eye(len(each))):
        shares_k = odds * (STAY * stays + other) / later[k]
        rate = q.slow[k] * R + q.fast[k] * span**2
        mixed = mix_gaussians(ca.vertsplit(shares_k), beliefs)
        modes.append(predict_signal(mixed, q.keep[k], rate))
    jumps = sensor.kind == "jump"
    inside = 0.0
    if jumps:
        least = ca.if_else(y > 0, q.least[0], q.least[1]) - SILENT * ca.sqrt(s.R)
        inside = used * (reading.side != 0) * (ca.fabs(y / q.slope) < least)
    after = State(
        tuple(modes),
        later,
        R,
        ca.fmin(known, MOST),
        ca.if_else(there, span, s.span),
        ca.if_else(there, y, s.last),
        ca.if_else(repeated, s.same + 1, ca.if_else(there, 0.0, s.same)),
        s.refused + (wrong > 0.5),
        s.inside + there * (inside - s.inside) / LATELY,
    )
    ratios = {"sensor": after.same[0] / RUN, "range": after.inside[0] / MANY}
    tests = assumption_fields(ratios)
    mean = ca.sum1(odds * e)
    z, cov = mix_gaussians(ca.vertsplit(odds), beliefs)
    z[1] /= Ts
    spare = (1.0 - jumps) * ca.if_else(z[0] > 0, *ca.vertsplit(ca.SX(q.most - q.middle)))
    far = HALF_95 * ca.sqrt(cov[0, 0]) + spare
    right, left = ca.vertsplit(ca.SX(q.middle))
    is_silent = silent > 0.5
    rms = ca.sqrt(s.R)
    read = e[0] + s.modes[0].mean[0]
    near = ca.if_else(outside > 0.5, ca.fmin(ca.fmax(z[0], read - rms), read + rms), z[0])
    shown = ca.if_else(is_silent, 0.0, near)
    innovation = ca.if_else(outside > 0.5, mean, 0.0)
    estimate = build_estimate(
        z,
        shown,
        right,
        left,
        reading,
        q.slope,
        sensor.kind,
        innovation,
    )
    right_std, left_std = ca.vertsplit(ca.SX(q.most - q.least) / np.sqrt(12))
    return after, estimate._replace(
        **tests,
        x_std=ca.sqrt(ca.vertcat(cov[0, 0] + spare**2 / 3, cov[1, 1] / Ts**2)),
        right_std=right_std,
        left_std=left_std,
        innovation_std=ca.sqrt(ca.sum1(odds * (S + (e - mean) ** 2))),
        refused=after.refused,
        noise=rms * q.slope,
        noise_assumed=ca.sqrt(q.R) * q.slope,
        low=ca.if_else(is_silent, -q.most[1], ca.fmin(z[0] - far, near)),
        high=ca.if_else(is_silent, q.most[0], ca.fmax(z[0] + far, near)),
        quality=tests["consistent"] * ca.if_else(outside > 0.5, 2.0, 1.0 * is_silent),
    )


def read_signal(
    sensor: Zone, q: Params, s: State, mode: Mode, y: Any, used: Any, side: Any
) -> tuple[Gaussian, Any, Any, Any, Any]:
    """Return a mode after a reading: the mixture of what the reading may be.

    Args:
        sensor: the sensor.
        q: numbers of the filter.
        s: state before it.
        mode: the mode.
        y: reading, 0 if it is missing (1) [y].
        used: whether it counts (1).
        side: measured side (1).

    Returns:
        (belief, density of the reading, innovation, its variance, the probabilities that it is on
        a side, silent, wrong (3)).
    """
    mean = mode.mean
    cov = from_upper_entries(mode.spread, UPPER)
    belief = Gaussian(mean, cov)
    h = ca.SX([[1.0, 0.0]])
    read = y / q.slope
    if sensor.kind != "jump":
        read += ca.if_else(y > 0, q.middle[0], -q.middle[1])
    e = read - mean[0]
    moved, S = joseph_update(
        belief,
        h,
        e,
        s.R,
        1.0,
    )
    shift, less, chance = truncate_to_range(mean[0], cov[0, 0], -q.most[1], q.most[0])
    cut = Gaussian(mean + shift * cov[:, 0], cov - mirror_upper(less * cov[:, 0] @ cov[0, :]))
    root = ca.sqrt(q.quiet)
    quiet = normal_density(y / q.slope / root) / root
    sided = 1.0
    if sensor.noise[0] == 0 and sensor.quantum[0] == 0:  # nothing moves a silent reading off 0
        quiet *= side == 0
        sided = side != 0
    right = 1 - q.glitch
    outside = right * sided * normal_density(e / ca.sqrt(S)) / ca.sqrt(S)
    wrong = q.glitch / ca.fmax(s.span, ca.fabs(e))
    each = ca.vertcat(used * outside, used * right * quiet * chance, used * wrong + (1 - used))
    likely = ca.fmax(ca.sum1(each), LEAST)
    shares = each / likely
    mixed = mix_gaussians(ca.vertsplit(shares), [moved, cut, belief])
    return mixed, likely, e, S, shares


def predict_signal(belief: Gaussian, keep: Any, rate: Any) -> Mode:
    """Return the belief of a mode at the next sample (keep: of its speed, rate: variance of z)."""
    F = ca.vertcat(ca.horzcat(1.0, keep), ca.horzcat(0.0, keep))
    Q = rate * ca.vertcat(ca.horzcat(1.0, 1.5 * keep), ca.horzcat(1.5 * keep, 3 * keep))
    return Mode(F @ belief.mean, to_upper_entries(F @ belief.cov @ F.T + Q, UPPER))
