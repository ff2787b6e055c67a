"""Filter of a signal without an input: modes that walk, and modes whose speed walks, at many rates.

The state of a mode is `[z; z']`. From sample to sample the mode may change (interacting multiple
models, Blom and Bar-Shalom 1988), and the readings choose: modes count by how well they foretell
them, lately and over the log. Each reading is on a side of the zone, silent, or wrong, and every
mode takes the mixture of the three. docs/signal.md has the equations.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.interfaces import Estimate, Observer, Reading, build_estimate
from undeadzone.nonlinearities.sensor import Zone, present
from undeadzone.numerics.gaussian import normal_density, truncate_to_range
from undeadzone.observers.filtering.innovation_tests import assumption_fields, is_repeated
from undeadzone.observers.filtering.prior import (
    SILENT,
    Assumptions,
    build_prior,
    outlier_probability,
    outlier_reach,
    prior_traits,
)
from undeadzone.plants.system import System
from undeadzone.util.arrays import Floats

# Motions of a step: those that noise may hide [its rms], and the fastest [largest reading].
WALKS = (1 / 16, 1 / 4, 1.0)
RAMPS = (1 / 128, 1 / 8, 2.0)
JUMPS = (0.5, 0.05)
STAY = 0.97  # probability that the mode of a sample is that of the next
LEARN = 1 / 500  # share of a sample in the frequencies of modes
RARE = 1e-3  # least of them
UNKNOWN = 0.1  # rms of a noise that is not declared, before the first reading [widest edge]
FEW = 10.0  # readings that a declared rms counts as
MOST = 1000.0  # readings that count in the noise's rms
LATELY = 64.0  # readings of which shares are taken
MANY = 0.05  # share of readings inside an edge from which the edge is another
RUN = 20.0  # readings in a row that repeat each other, from which a noisy sensor is stuck
FAKE = 0.02  # share of the outliers that are silent
BARELY = 0.02  # chance of the zone below which a silent sample is all that is known
ENOUGH = 0.95  # and from which it tells nothing new
START = 1e3  # deviation of the first z [outlier's reach]
FAR = 1e30  # span before the first reading, which is no wrong one [z]
TINY = 1e-12  # least probability of a wrong reading: some number is always likeliest
LEAST = 1e-30  # sum of densities that divides; a float holds it
SIGMAS = 1.96  # of the interval that is shown


class Belief(NamedTuple):
    """Gaussian belief about z [z] and z' [z/step], of each of K modes.

    Attributes:
        z, v: means (K).
        zz, zv, vv: variances and covariance (K).
    """

    z: Any
    v: Any
    zz: Any
    zv: Any
    vv: Any

    def shift_along(self, shift: Any, left: Any) -> Belief:
        """Return the belief after news of z (shift: of z, in its variances; left: share of its
        variance).
        """
        gained = self.zv**2 * (1 - left) / self.zz
        z, v = self.z + self.zz * shift, self.v + self.zv * shift
        return Belief(z, v, self.zz * left, self.zv * left, ca.fmax(self.vv - gained, 0.0))

    def split(self) -> list[Belief]:
        """Return the beliefs of the modes, one by one."""
        return [Belief(*parts) for parts in zip(*map(ca.vertsplit, self), strict=True)]


def mix_beliefs(shares: Sequence[Any], each: Sequence[Belief]) -> Belief:
    """Return mean and covariance of a mixture of beliefs, whose shares sum up to 1."""
    pairs = list(zip(shares, each, strict=True))
    z = sum(share * one.z for share, one in pairs)
    v = sum(share * one.v for share, one in pairs)
    return Belief(
        z,
        v,
        sum(share * (one.zz + (one.z - z) ** 2) for share, one in pairs),
        sum(share * (one.zv + (one.z - z) * (one.v - v)) for share, one in pairs),
        sum(share * (one.vv + (one.v - v) ** 2) for share, one in pairs),
    )


class State(NamedTuple):
    """State of the filter from sample to sample.

    Attributes:
        modes: their beliefs before the next reading.
        odds, often: probabilities of the modes, now and along the log (K).
        R: learnt variance of a reading outside the zone (1) [z^2].
        known: readings that it rests on (1).
        span: over which a wrong reading is spread, and a jump goes (1) [z].
        last: reading before (1) [y].
        same: readings in a row that repeat each other (1).
        refused: readings that were taken for wrong (1).
        inside: share of readings inside an edge, of late (1).
    """

    modes: Belief
    odds: Any
    often: Any
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
        known: readings that this rests on (1).
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
    known: Floats
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
        known=np.where(prior.declared, FEW, 1.0),
        middle=prior.mean[2:],
        least=prior.ranges[:, 0],
        most=prior.ranges[:, 1],
        slope=sensor.slope,
        glitch=np.array([max(outlier_probability(options.glitches, 0.0), TINY)]),
        reach=outlier_reach(prior),
        noisy=1.0 * ((sensor.noise + sensor.noise_before > 0) & (sensor.quantum == 0)),
    )
    step = partial(step_signal, model, sensor)
    return Observer(params, start_signal, step, traits=prior_traits(prior, options.x_std))


def start_signal(q: Params) -> State:
    """Return the state at t = 0."""
    none, even = np.zeros(q.keep.size), np.full(q.keep.size, 1 / q.keep.size)
    modes = Belief(none, none, none + (START * q.reach) ** 2, none, none)
    return State(modes, even, even, q.start, q.known, q.reach + FAR, *np.zeros((4, 1)))


def step_signal(
    model: System, sensor: Zone, q: Params, s: State, u: Any, reading: Reading
) -> tuple[State, Estimate]:
    """Return the next state, and the estimate after a reading."""
    assert model.Ts is not None
    there = present(reading.y)
    y = ca.if_else(there, reading.y, 0.0)
    repeated = there * is_repeated(q, y, s.last) * (y != 0) * (ca.fabs(reading.side) < 2)
    seen = read_signal(sensor, q, s, y, there * (1 - repeated), reading.side)
    known = s.known + seen.known
    R = ca.fmax(q.R, s.R + seen.error / known)
    faded = ca.if_else(s.span < FAR, s.span * (1 - 1 / MOST), 0.0)
    span = ca.fmax(q.reach, ca.fmax(ca.fabs(y / q.slope), faded))
    often = ca.fmax(s.often + LEARN * there * (seen.odds - s.often), RARE)
    modes, odds = predict_signal(q, seen, often / ca.sum1(often), R, span)
    after = State(
        modes,
        odds,
        often,
        R,
        ca.fmin(known, MOST),
        ca.if_else(there, span, s.span),
        ca.if_else(there, y, s.last),
        ca.if_else(repeated, s.same + 1, ca.if_else(there, 0.0, s.same)),
        s.refused + (seen.wrong > 0.5),
        s.inside + there * (seen.inside - s.inside) / LATELY,
    )
    ratios = {"sensor": after.same[0] / RUN, "range": after.inside[0] / MANY}
    tests = assumption_fields(ratios)
    estimate = show_signal(model.Ts, sensor, q, seen, reading)
    return after, estimate._replace(
        **tests,
        refused=after.refused,
        quality=estimate.quality * tests["consistent"],
        noise=ca.sqrt(s.R) * q.slope,
        noise_assumed=ca.sqrt(q.R) * q.slope,
    )


class Seen(NamedTuple):
    """Result of a reading.

    Attributes:
        modes, odds: as in `State`, after it.
        outside, silent, wrong: probabilities that it is on a side, silent, or wrong (1).
        error: square of its error on a side, as expected, less the learnt one (1) [z^2].
        known: information about that (1).
        e, std: innovation and its deviation, of the modes that the reading chose (1) [z].
        inside: whether it lies inside an edge of a sensor that jumps (1).
    """

    modes: Belief
    odds: Any
    outside: Any
    silent: Any
    wrong: Any
    error: Any
    known: Any
    e: Any
    std: Any
    inside: Any


def read_signal(sensor: Zone, q: Params, s: State, y: Any, used: Any, side: Any) -> Seen:
    """Return the modes after a reading, each the mixture of what the reading may be.

    Args:
        sensor: the sensor.
        q: numbers of the filter.
        s: state before it.
        y: reading, 0 if it is missing (1) [y].
        used: whether it counts (1).
        side: measured side, +2 and -2 at a limit (1).
    """
    m = s.modes
    limit = ca.fabs(side) > 1
    jumps = sensor.kind == "jump"
    read = y / q.slope + (0.0 if jumps else ca.if_else(y > 0, q.middle[0], -q.middle[1]))
    e = read - m.z
    S = m.zz + s.R
    share = s.R / S
    moved = m.shift_along(e / S, share)
    high = ca.if_else(limit, read + (side > 0) * q.reach, q.most[0])
    low = ca.if_else(limit, read - (side < 0) * q.reach, -q.most[1])
    shift, less, chance = truncate_to_range(m.z, m.zz, low, high)
    news = chance < ENOUGH
    lost = chance < BARELY
    inside = m.shift_along(
        ca.if_else(lost, ((low + high) / 2 - m.z) / m.zz, news * shift),
        ca.if_else(lost, (high - low) ** 2 / 12, m.zz * (1 - news * m.zz * less)) / m.zz,
    )
    root = ca.sqrt(q.quiet)
    quiet = ca.if_else(limit, 1 / q.reach, normal_density(y / q.slope / root) / root)
    sided = 1.0 * (side != 0)
    if sensor.noise[0] == 0 and sensor.quantum[0] == 0:  # nothing moves a silent reading off 0
        quiet *= 1 - sided * (1 - limit)
    else:
        sided = 1.0
    right = 1 - q.glitch
    outside = right * sided * (1 - limit) * normal_density(e / ca.sqrt(S)) / ca.sqrt(S)
    wrong = q.glitch * (1 / ca.fmax(s.span, ca.fabs(e)) + FAKE * quiet)
    each = used * outside, used * right * quiet * chance, used * wrong + (1 - used)
    likely = ca.fmax(sum(each), LEAST)
    shares = [one / likely for one in each]
    odds = s.odds * likely / ca.fmax(ca.sum1(s.odds * likely), LEAST)
    beyond, silent, refused = (used * ca.sum1(odds * one) for one in shares)
    mean = ca.sum1(odds * e)
    counted = used * odds * shares[0]
    least = ca.if_else(y > 0, q.least[0], q.least[1]) - SILENT * ca.sqrt(s.R)
    return Seen(
        mix_beliefs(shares, [moved, inside, m]),
        odds,
        beyond,
        silent,
        refused,
        ca.sum1(counted * ((read - moved.z) ** 2 + moved.zz - s.R)),
        ca.sum1(counted * share**2),
        ca.if_else(beyond > 0.5, mean, 0.0),
        ca.sqrt(ca.sum1(odds * (S + (e - mean) ** 2))),
        used * (side != 0) * (ca.fabs(read) < least) if jumps else ca.SX(1, 1),
    )


def predict_signal(q: Params, seen: Seen, often: Any, R: Any, span: Any) -> tuple[Belief, Any]:
    """Return the beliefs of the modes at the next sample, each from a mixture of all, and their
    probabilities.
    """
    before = ca.vertsplit(seen.odds)
    odds = STAY * seen.odds + (1 - STAY) * often
    stays = ca.horzsplit(STAY * np.eye(len(before)))
    pairs = zip(before, stays, strict=True)
    shares = [one * (stay + (1 - STAY) * often) / odds for one, stay in pairs]
    m = mix_beliefs(shares, seen.modes.split())
    rate = q.slow * R + q.fast * span**2
    moved = Belief(
        m.z + q.keep * m.v,
        q.keep * m.v,
        m.zz + q.keep * (2 * m.zv + m.vv) + rate,
        q.keep * (m.zv + m.vv + 1.5 * rate),
        q.keep * (m.vv + 3 * rate),
    )
    return moved, odds


def show_signal(Ts: float, sensor: Zone, q: Params, seen: Seen, reading: Reading) -> Estimate:
    """Return the estimate: z with its interval and quality, 0 of a silent reading."""
    whole = mix_beliefs(ca.vertsplit(seen.odds), seen.modes.split())
    silent = seen.silent > 0.5
    span = (q.most - q.middle) * (sensor.kind != "jump")
    spare = ca.if_else(whole.z > 0, span[0], span[1])
    far = SIGMAS * ca.sqrt(whole.zz) + spare
    state = ca.vertcat(whole.z, whole.v / Ts)
    z = ca.if_else(silent, 0.0, whole.z)
    right, left = ca.vertsplit(ca.SX(q.middle))
    shown = build_estimate(state, z, right, left, reading, q.slope, sensor.kind, seen.e)
    right_std, left_std = ca.vertsplit(ca.SX(q.most - q.least) / np.sqrt(12))
    bounded = ca.logic_or(silent, ca.fabs(reading.side) > 1)
    return shown._replace(
        x_std=ca.sqrt(ca.vertcat(whole.zz + spare**2 / 3, whole.vv / Ts**2)),
        right_std=right_std,
        left_std=left_std,
        innovation_std=seen.std,
        low=ca.if_else(silent, -q.most[1], whole.z - far),
        high=ca.if_else(silent, q.most[0], whole.z + far),
        quality=ca.if_else(seen.outside > 0.5, 2.0, 1.0 * bounded),
    )
