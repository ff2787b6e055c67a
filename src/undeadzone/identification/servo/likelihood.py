"""The likelihood of a servo's log, and climbs from many starts side by side.

The prediction errors (S3) are Student's of 6 degrees of freedom, so that a tick that was missed
costs little. Every start has lanes of its own for its derivatives, and its trials are damped in
six ways at once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from undeadzone.compile import lanes
from undeadzone.identification.servo import predictor, sampled
from undeadzone.identification.servo.heard import Heard
from undeadzone.identification.servo.predictor import DEGREES
from undeadzone.identification.servo.sampled import (
    DAMPING,
    DELAY,
    EARLIEST,
    FRICTION,
    GAIN,
    GAP,
    LOAD,
    NAMES,
    NOISE,
    OFFSET,
    POLE,
    SLOW,
    SPRING,
    TORQUE,
)
from undeadzone.support.arrays import Flags, Floats, Integers

DAMPINGS = np.array([1e-6, 1e-2, 0.1, 1.0, 30.0, 1000.0])
CAREFUL = 1.2  # weight of an error in the Hessian at most
OF_SPREAD = 1.6  # curvature of ln S: 2 nu / (nu + 3), a little more
DEAR = 2.5  # nats of BIC a number, in ln N: errors of ticks are not independent
GAINED = 1e-3  # nats below which a climb is done
PATIENT = 2  # steps that gain so little
PARTS = {"friction": FRICTION, "load": LOAD, "spring": SPRING, "pole": POLE, "slow": SLOW}
NONE = {FRICTION: 0.0, LOAD: 0.0, SPRING: -math.inf, POLE: math.inf, SLOW: -math.inf}
ALWAYS = (DAMPING, GAIN, OFFSET, TORQUE, DELAY)


class Structure(NamedTuple):
    """What a servo has.

    Attributes:
        parts: of friction, friction of the load, spring, pole and slow.
        lag: whether it is a plant of first order instead of a motor.
    """

    parts: frozenset[str]
    lag: bool = False

    def free(self, ticks: bool, free: bool, fixed: Sequence[int] = ()) -> Integers:
        """The places of its numbers that are fitted."""
        places = [*ALWAYS, *(PARTS[name] for name in self.parts)]
        if not free:
            places.append(GAP)
        if not ticks:
            places.append(NOISE)
        return np.array(sorted(set(places) - set(fixed)))

    def of(self, theta: Floats) -> Floats:
        """Numbers of which those that are not there have no effect."""
        own = theta.copy()
        for name, place in PARTS.items():
            if name not in self.parts:
                own[place] = NONE[place]
        return own


class Servo(NamedTuple):
    """Numbers of a structure with their log likelihood."""

    structure: Structure
    theta: Floats
    value: float


class Slopes(NamedTuple):
    """Errors, logs of their deviations, and derivatives of both.

    Attributes:
        e, log_s: of the errors that count (n).
        de, dlog: their derivatives by the free numbers (n x free).
    """

    e: Floats
    log_s: Floats
    de: Floats
    dlog: Floats


class Likelihood:
    """The log likelihood of a log.

    Args:
        log: as the predictor hears it.
        free: whether z is forgotten at each reversal, so that no gap is assumed.
        among: the samples whose errors may count (N); None: all.
    """

    def __init__(self, log: Heard, free: bool = False, among: Flags | None = None) -> None:
        self.log, self.free = log, free
        counted = log.counted(free) if among is None else log.counted(free) & among
        self.used = np.flatnonzero(counted)
        self.signals = log.signals(counted)
        self.kernel = predictor.ticks if log.ticks else predictor.noise

    def run(self, theta: Floats, lag: bool) -> Floats:
        """What the predictor sees (L x N x `predictor.SEEN`) with numbers (L x P)."""
        return self._run(self.kernel(), theta, lag)[0]

    def _run(self, kernel: lanes.Kernel, theta: Floats, lag: bool) -> tuple[Floats, Floats]:
        """Outputs and final states of a kernel."""
        log = self.log
        rows = sampled.lanes_of(theta, log.step, log.quantum, log.ticks, self.free, lag)
        states, _, numbers = kernel.shape.sizes
        at_first, none = np.zeros(states), np.zeros(numbers)
        return lanes.run(kernel, at_first, self.signals, none, lane_params=rows, threads=1)

    def values(self, theta: Floats, lag: bool) -> Floats:
        """The log likelihoods of numbers (L x P)."""
        return self._run(self.kernel("sums"), theta, lag)[1][:, -1]

    def slopes(self, points: Floats, free: Sequence[Integers], lag: bool) -> list[Slopes]:
        """Errors and derivatives at points (M x P) by the free numbers of each."""
        rows = []
        for theta, places in zip(points, free, strict=True):
            moves = np.zeros((places.size, theta.size))
            moves[np.arange(places.size), places] = steps_of(theta)[places]
            rows += [theta[None], theta + moves, theta - moves]
        seen, _ = self._run(self.kernel("errors"), np.concatenate(rows), lag)
        found, row = [], 0
        for theta, places in zip(points, free, strict=True):
            count = places.size
            own = seen[row : row + 1 + 2 * count].take(self.used, axis=1)
            twice = 2 * steps_of(theta)[places][:, None, None]
            slope = (own[1 : 1 + count] - own[1 + count :]) / twice
            e, log_s = np.ascontiguousarray(own[0].T)
            de, dlog = np.ascontiguousarray(slope.transpose(2, 1, 0))
            found.append(Slopes(e, log_s, de, dlog))
            row += 1 + 2 * count
        return found

    def climbed(
        self, starts: Sequence[Servo], steps: int, fixed: Sequence[int] = ()
    ) -> list[Servo]:
        """Where climbs from several starts end, in their order; the lags among them apart.

        Args:
            starts: whose values are not needed.
            steps: of a climb at most.
            fixed: places of numbers that stay.
        """
        found = list(starts)
        for lag in (False, True):
            own = [k for k, one in enumerate(starts) if one.structure.lag == lag]
            if own:
                tops = self._climbed([starts[k] for k in own], steps, fixed, lag)
                for k, top in zip(own, tops, strict=True):
                    found[k] = top
        return found

    def _climbed(
        self, starts: list[Servo], steps: int, fixed: Sequence[int], lag: bool
    ) -> list[Servo]:
        """`climbed`, of motors alone or of lags alone."""
        ticks = self.log.ticks
        free = [one.structure.free(ticks, self.free, fixed) for one in starts]
        theta = bounded(np.array([one.structure.of(one.theta) for one in starts]), self.log)
        values = self.values(theta, lag)
        idle = np.where(np.isfinite(values), 0, PATIENT)
        for _ in range(steps):
            going = np.flatnonzero(idle < PATIENT)
            if not going.size:
                break
            places = [free[k] for k in going]
            trials = []
            for k, slopes in zip(going, self.slopes(theta[going], places, lag), strict=True):
                trials.append(self._trials(theta[k], slopes, free[k]))
            tried = np.concatenate(trials)
            reached = self.values(tried, lag).reshape(going.size, -1)
            best = np.argmax(np.nan_to_num(reached, nan=-np.inf), axis=1)
            for row, k in enumerate(going):
                gained = reached[row, best[row]] - values[k]
                idle[k] = 0 if gained > GAINED else idle[k] + 1
                if gained > 0:
                    theta[k] = tried[row * DAMPINGS.size + best[row]]
                    values[k] = reached[row, best[row]]
                else:
                    idle[k] = PATIENT
        pairs = zip(starts, theta, values, strict=True)
        return [Servo(one.structure, numbers, float(value)) for one, numbers, value in pairs]

    def _trials(self, theta: Floats, slopes: Slopes, places: Integers) -> Floats:
        """Where damped steps lead (trials x P)."""
        score, hessian = newton(slopes)
        diagonal = np.diag(hessian).copy()
        diagonal[~(diagonal > 0)] = 1e-12
        scale = 1 / np.sqrt(diagonal)
        scaled = hessian * np.outer(scale, scale)
        if not np.isfinite(scaled).all() or not np.isfinite(score).all():
            return np.tile(theta, (DAMPINGS.size, 1))
        damped = scaled + DAMPINGS[:, None, None] * np.eye(places.size)
        right = np.tile((score * scale)[:, None], (DAMPINGS.size, 1, 1))
        try:
            found = np.linalg.solve(damped, right)[:, :, 0] * scale
        except np.linalg.LinAlgError:
            found = np.tile(score * scale**2, (DAMPINGS.size, 1))
        longest = reach_of(theta)[places]
        trials = np.tile(theta, (DAMPINGS.size, 1))
        trials[:, places] += np.clip(found, -longest, longest)
        return bounded(trials, self.log)

    def bic(self, one: Servo) -> float:
        """BIC, with numbers that are dear."""
        count = one.structure.free(self.log.ticks, self.free).size
        return -2 * one.value + DEAR * count * math.log(max(self.used.size, 2))


def scores(slopes: Slopes) -> Floats:
    """Derivatives of the log density of each error (n x free)."""
    inverse = np.exp(-slopes.log_s)
    r = slopes.e * inverse
    weight = (DEGREES + 1) / (DEGREES + r * r)
    of_errors = -slopes.de * (inverse * weight * r)[:, None]
    return np.asarray(of_errors + slopes.dlog * (weight * r * r - 1)[:, None])


def newton(slopes: Slopes) -> tuple[Floats, Floats]:
    """The score, and a positive Hessian of minus the log likelihood."""
    inverse = np.exp(-slopes.log_s)
    r = slopes.e * inverse
    weight = (DEGREES + 1) / (DEGREES + r * r)
    scaled = slopes.de * inverse[:, None]
    hessian = scaled.T @ (scaled * np.minimum(weight, CAREFUL)[:, None])
    hessian += OF_SPREAD * slopes.dlog.T @ (slopes.dlog * np.minimum(weight, 1.0)[:, None])
    return scores(slopes).sum(axis=0), hessian


def steps_of(theta: Floats) -> Floats:
    """By how much each number is moved for derivatives (P)."""
    steps = np.full(len(NAMES), 2e-3)
    steps[GAIN] = 1e-3 * abs(theta[GAIN]) + 1e-9
    for place in (FRICTION, LOAD):
        steps[place] = 1e-3 + 0.01 * abs(theta[place])
    steps[GAP] = 0.005 * theta[GAP] + 1e-6
    steps[DELAY] = 0.02
    return steps


def reach_of(theta: Floats) -> Floats:
    """By how much each number may change in a step (P)."""
    reach = np.ones(len(NAMES))
    reach[GAIN] = 0.5 * abs(theta[GAIN]) + 0.02
    reach[[FRICTION, LOAD]] = 0.1
    reach[OFFSET] = 0.3
    reach[GAP] = 0.5 * theta[GAP] + 0.02
    reach[DELAY] = 1.0
    return reach


def bounded(theta: Floats, log: Heard) -> Floats:
    """Numbers within bounds (L x P); what is not there stays so."""
    own = theta.T.copy()
    own[DAMPING] = np.clip(own[DAMPING], math.log(0.02), math.log(min(1.5 / log.step, 2000.0)))
    for place, low, high in (
        (POLE, math.log(5.0), math.log(1.5 / log.step)),
        (SPRING, -12.0, math.log(0.25 / log.step**2)),
        (TORQUE, -14.0, 5.0),
        (NOISE, -16.0, 2.0),
        (SLOW, -10.0, 3.0),
    ):
        there = np.isfinite(own[place])
        own[place, there] = np.clip(own[place, there], low, high)
    own[[FRICTION, LOAD]] = np.maximum(own[[FRICTION, LOAD]], 0.0)
    own[GAP] = np.maximum(own[GAP], 1e-7)
    earliest = 0.0 if log.closed else EARLIEST  # in a loop u answers to the reading of its sample
    own[DELAY] = np.clip(own[DELAY], earliest, predictor.LATEST + EARLIEST - 1e-6)
    return np.ascontiguousarray(own.T)
