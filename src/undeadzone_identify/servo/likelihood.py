"""Likelihood of a servo's log, maximised from many starts side by side.

The prediction errors (S3) are Student's of 6 degrees of freedom, so that a tick that was missed
costs little. Every start has lanes of its own for its derivatives, and its trials are damped in
six ways at once.

A servo's numbers, and the results of a lane of the predictor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import IntEnum
from itertools import starmap
from typing import Any, NamedTuple

import numpy as np

from undeadzone.compile import lanes
from undeadzone.util.arrays import Flags, Floats, Integers
from undeadzone_identify.models.estimates import (
    central_differences,
    damped_newton_step,
    perturb_each,
    run_lanes_along,
)
from undeadzone_identify.servo import predictor
from undeadzone_identify.servo.observations import Observations
from undeadzone_identify.servo.predictor import DEGREES, LATEST, NUMBERS, PLANT, SURE

# ln p, g, ln p_e, ln k, f, o, c, ln of the rms of white torque, of noise, of slow torque, delay,
# friction of the load
At = IntEnum(
    "At", "DAMPING GAIN POLE SPRING FRICTION OFFSET GAP TORQUE NOISE SLOW DELAY LOAD", start=0
)
SLOW_TIME = 0.5  # correlation time of the slow torque [s]
EARLIEST = -1  # delay of a log whose input was recorded after it had acted [samples]
COARSEST = 0.05  # of a step of the series, in rates
TERMS = 5  # of the series
FINEST = 1e-4  # rms of the readings: quantum of exact ones
AT_FIRST = 2.0  # standard deviation of v at first, in speeds that an input of 1 gives in a while


def discretise_servo(
    theta: Floats, step: float, lag: bool | Flags
) -> tuple[Floats, Floats, Floats]:
    """Discretise (z, v, d, i): return transitions of state and inputs, and the covariance.

    Both follow from one exponential.

    References:
        C. F. Van Loan (1978), doi:10.1109/TAC.1978.1101743

    Args:
        theta: numbers by `At` (L x P); what is not there is -inf, the pole +inf.
        step: sample time [s].
        lag: whether the plant is z' = -p z + g u, without inertia; of all, or of each (L).

    Returns:
        A (L x 4 x 4), B (L x 4 x 2) of u and of a torque, Q (L x 3 x 3).
    """
    each, lag = np.arange(len(theta)), np.broadcast_to(lag, len(theta))
    row = np.where(lag, 0, 1)
    p = np.exp(theta[:, At.DAMPING])
    g = theta[:, At.GAIN]
    pole, k = np.exp(theta[:, [At.POLE, At.SPRING]].T)
    electric = np.isfinite(pole)
    rate = np.where(electric, pole, 0.0)
    A = np.zeros((len(theta), 9, 9))  # states, both inputs, and the covariance beside them
    A[:, 0, 1] = ~lag
    A[:, 1, 0] = np.where(lag, 0.0, -k)
    A[each, row, row] = -p
    A[each, row, 2] = A[each, row, 5] = g
    A[each, row, 3] = g * electric
    A[each, row, 4] = g * ~electric
    A[:, 2, 2] = -1 / SLOW_TIME
    A[:, 3, 3] = -rate
    A[:, 3, 4] = rate
    A[:, 6:, 6:] = -A[:, :3, :3].transpose(0, 2, 1)
    A[each, row, 6 + row] = g**2 * np.exp(2 * theta[:, At.TORQUE]) * step
    A[:, 2, 8] = np.exp(2 * theta[:, At.SLOW]) * 2 / SLOW_TIME
    fastest = np.max(p + np.sqrt(k) + rate + 1 / SLOW_TIME)
    halvings = max(0, math.ceil(math.log2(fastest * step / COARSEST)))
    E = term = np.tile(np.eye(9), (len(theta), 1, 1))
    for m in range(1, TERMS + 1):
        term = term @ (A * (step / 2**halvings / m))
        E = E + term
    for _ in range(halvings):
        E = E @ E
    Q = E[:, :3, 6:] @ E[:, :3, :3].transpose(0, 2, 1)
    # the rate of a lag is that of the last sample
    E[lag, 1] = (E[lag, 0] - np.eye(9)[0]) / step
    E[lag, :, 1] = 0.0
    Q[lag, 1] = Q[lag, 0] / step
    Q[lag, :, 1] = Q[lag, :, 0] / step
    return E[:, :4, :4], E[:, :4, 4:6], Q


def build_lane_numbers(theta: Floats, log: Observations, free: bool, lag: bool | Flags) -> Floats:
    """Build the parameters of the predictor's lanes (L x numbers).

    Args:
        theta: by `At` (L x P).
        log: as the predictor hears it.
        free: whether z is forgotten at reversals.
        lag: whether the plant is of first order; of all, or of each (L).
    """
    A, B, Q = discretise_servo(theta, log.step, lag)
    rows = np.zeros((len(theta), len(NUMBERS) + LATEST + 1))
    for place, (kind, row, column) in enumerate(map(list, PLANT)):
        rows[:, place] = {"a": A, "b": B, "q": Q}[kind][:, int(row), int(column)]
    quantum = max(log.quantum, FINEST)
    speed = theta[:, At.GAIN] ** 2 / np.exp(2 * theta[:, At.DAMPING])
    seen = ("friction", "load", "offset", "gap")
    others: dict[str, Any] = {name: theta[:, At[name.upper()]] for name in seen}
    others |= {
        "rms": SURE * quantum if log.ticks else np.exp(theta[:, At.NOISE]),
        "quantum": quantum,
        "step": log.step,
        "first_v": AT_FIRST**2 * speed,
        "first_d": np.exp(2 * theta[:, At.SLOW]),
        "free": float(free),
    }
    for name, value in others.items():
        rows[:, NUMBERS.index(name)] = value
    late = np.clip(theta[:, At.DELAY] - EARLIEST, 0.0, LATEST)
    rows[:, len(NUMBERS) :] = np.maximum(1 - np.abs(late[:, None] - np.arange(LATEST + 1)), 0.0)
    return rows


# --- The likelihood of a log

DAMPINGS = np.array([1e-6, 1e-2, 0.1, 1.0, 30.0, 1000.0])
CAREFUL = 1.2  # weight of an error in the Hessian at most
OF_SPREAD = 1.6  # curvature of ln S: 2 nu / (nu + 3), a little more
DEAR = 2.5  # nats of BIC a number, in ln N: errors of ticks are not independent
GAINED = 1e-3  # nats below which a climb is done
PATIENT = 2  # steps that gain so little
RUBS = [At.FRICTION, At.LOAD]
PARTS = {name: At[name.upper()] for name in ("friction", "load", "spring", "pole", "slow")}
NONE = dict.fromkeys(RUBS, 0.0)
NONE |= {At.SPRING: -math.inf, At.POLE: math.inf, At.SLOW: -math.inf}
# steps for derivatives, absolute and relative, and the longest ones of a climb
STEPS = np.tile([2e-3, 0.0, 1.0, 0.0], (len(At), 1))
STEPS[At.GAIN] = 1e-9, 1e-3, 0.02, 0.5
STEPS[RUBS] = 1e-3, 0.01, 0.1, 0.0
STEPS[At.OFFSET] = 2e-3, 0.0, 0.3, 0.0
STEPS[At.GAP] = 1e-6, 0.005, 0.02, 0.5
STEPS[At.DELAY] = 0.02, 0.0, 1.0, 0.0
ALWAYS = (At.DAMPING, At.GAIN, At.OFFSET, At.TORQUE, At.DELAY)


class ServoStructure(NamedTuple):
    """Structure of a servo: the parts that it contains.

    Attributes:
        parts: of friction, load (friction of it), spring, pole and slow.
        lag: whether it is a plant of first order instead of a motor.
    """

    parts: frozenset[str]
    lag: bool = False

    def free_places(self, ticks: bool, free: bool, fixed: Sequence[int] = ()) -> Integers:
        """Return the places of the parameters that are fitted."""
        places = [*ALWAYS, *(PARTS[name] for name in self.parts)]
        if not free:
            places.append(At.GAP)
        if not ticks:
            places.append(At.NOISE)
        return np.array(sorted(set(places) - set(fixed)))

    def disable_absent_parts(self, theta: Floats) -> Floats:
        """Return the parameters, with no effect of absent parts."""
        own = theta.copy()
        for name, place in PARTS.items():
            if name not in self.parts:
                own[place] = NONE[place]
        return own


class Servo(NamedTuple):
    """Parameters of a servo structure with their log likelihood."""

    structure: ServoStructure
    theta: Floats
    value: float = -math.inf

    def replace_number(self, place: int, value: float) -> Servo:
        """Return a servo with a single parameter replaced."""
        theta = self.theta.copy()
        theta[place] = value
        return self._replace(theta=theta)


class ErrorSlopes(NamedTuple):
    """Prediction errors, logarithms of their deviations, and derivatives of both.

    Attributes:
        e, log_s: of the errors that count (n).
        de, dlog: their derivatives by the free numbers (n x free).
    """

    e: Floats
    log_s: Floats
    de: Floats
    dlog: Floats

    @property
    def normalised(self) -> Floats:
        """Return the errors divided by their standard deviations (n) [1]."""
        return self.e * np.exp(-self.log_s)


class ServoLikelihood:
    """Log likelihood of a servo's log.

    Args:
        log: as the predictor hears it.
        free: whether z is forgotten at each reversal, so that no gap is assumed.
        among: the samples whose errors may count (N); None: all.
    """

    def __init__(self, log: Observations, free: bool = False, among: Flags | None = None) -> None:
        self.log = log
        self.free = free
        counted = log.error_samples(free) if among is None else log.error_samples(free) & among
        self.used = np.flatnonzero(counted)
        self.signals = log.kernel_inputs(counted)
        self.kernel = predictor.tick_predictor if log.ticks else predictor.noise_predictor

    def run_predictor(self, theta: Floats, lag: bool | Flags) -> Floats:
        """Run the predictor with several parameter sets (L x P); return `predictor.SEEN`
        (L x N x 4).
        """
        return self._run_kernel(self.kernel(), theta, lag)[0]

    def _run_kernel(
        self, kernel: lanes.Kernel, theta: Floats, lag: bool | Flags
    ) -> tuple[Floats, Floats]:
        """Run a kernel; return its outputs and final states."""
        rows = build_lane_numbers(theta, self.log, self.free, lag)
        return run_lanes_along(kernel, self.signals, rows)

    def log_likelihood_values(self, theta: Floats, lag: bool | Flags) -> Floats:
        """Return the log likelihoods of several parameter sets (L)."""
        return self._run_kernel(self.kernel(True), theta, lag)[1][:, -1]

    def error_slopes(
        self, points: Floats, free: Sequence[Integers], lag: Sequence[bool] | Flags
    ) -> list[ErrorSlopes]:
        """Return errors and derivatives at points (M x P) by the free parameters of each
        point.
        """
        moves = [step_sizes(*one)[0] for one in zip(points, free, strict=True)]
        rows = list(starmap(perturb_each, zip(points, free, moves, strict=True)))
        counts = list(map(len, rows))
        seen, _ = self._run_kernel(self.kernel(), np.concatenate(rows), np.repeat(lag, counts))
        found = []
        for steps, own in zip(moves, np.split(seen, np.cumsum(counts)[:-1]), strict=True):
            used = own.take(self.used, axis=1)[..., :2]
            e, log_s = np.ascontiguousarray(used[0].T)
            slope = central_differences(used[1:], steps)
            de, dlog = np.ascontiguousarray(slope.transpose(2, 1, 0))
            found.append(ErrorSlopes(e, log_s, de, dlog))
        return found

    def maximise_from_starts(
        self, starts: Sequence[Servo], steps: int, fixed: Sequence[int] = ()
    ) -> list[Servo]:
        """Find the maxima of the likelihood from several starts, in their order.

        Args:
            starts: whose values are not needed.
            steps: of a climb at most.
            fixed: places of numbers that stay.
        """
        if not starts:
            return []
        lag = np.array([one.structure.lag for one in starts])
        free = [one.structure.free_places(self.log.ticks, self.free, fixed) for one in starts]
        theta = clip_servo_numbers(
            np.array([one.structure.disable_absent_parts(one.theta) for one in starts]), self.log
        )
        values = self.log_likelihood_values(theta, lag)
        idle = np.where(np.isfinite(values), 0, PATIENT)
        for _ in range(steps):
            going = np.flatnonzero(idle < PATIENT)
            if not going.size:
                break
            every = self.error_slopes(theta[going], [free[k] for k in going], lag[going])
            pairs = zip(going, every, strict=True)
            trials = [self._newton_trials(theta[k], slopes, free[k]) for k, slopes in pairs]
            tried = clip_servo_numbers(np.concatenate(trials), self.log)
            of_trials = np.repeat(lag[going], DAMPINGS.size)
            reached = self.log_likelihood_values(tried, of_trials).reshape(going.size, -1)
            best = np.argmax(np.nan_to_num(reached, nan=-np.inf), axis=1)
            place = np.arange(going.size) * DAMPINGS.size + best
            gained = reached.flat[place] - values[going]
            better = gained > 0
            idle[going] = np.where(gained > GAINED, 0, idle[going] + 1)
            idle[going[~better]] = PATIENT
            theta[going[better]] = tried[place[better]]
            values[going[better]] += gained[better]
        found = zip(starts, theta, values, strict=True)
        return [Servo(one.structure, numbers, float(value)) for one, numbers, value in found]

    def _newton_trials(self, theta: Floats, slopes: ErrorSlopes, places: Integers) -> Floats:
        """Return the end points of damped Newton steps, bounds not applied (trials x P)."""
        scores, hessian = newton_terms(slopes)
        score = scores.sum(axis=0)
        moves = np.array([damped_newton_step(score, hessian, one) for one in DAMPINGS])
        longest = step_sizes(theta, places)[1]
        trials = np.tile(theta, (DAMPINGS.size, 1))
        trials[:, places] += np.clip(moves, -longest, longest)
        return trials

    def bic(self, one: Servo) -> float:
        """Return the BIC, with a raised penalty per parameter."""
        count = one.structure.free_places(self.log.ticks, self.free).size
        return -2 * one.value + DEAR * count * math.log(max(self.used.size, 2))


def newton_terms(slopes: ErrorSlopes) -> tuple[Floats, Floats]:
    """Return the scores of the errors (n x free), and a positive Hessian of -log likelihood."""
    inverse = np.exp(-slopes.log_s)
    r = slopes.e * inverse
    weight = (DEGREES + 1) / (DEGREES + r * r)
    of_errors = slopes.de * (-inverse * weight * r)[:, None]
    scores = of_errors + slopes.dlog * (weight * r * r - 1)[:, None]
    scaled = slopes.de * inverse[:, None]
    hessian = scaled.T @ (scaled * np.minimum(weight, CAREFUL)[:, None])
    hessian += OF_SPREAD * slopes.dlog.T @ (slopes.dlog * np.minimum(weight, 1.0)[:, None])
    return scores, hessian


def step_sizes(theta: Floats, places: Integers) -> Floats:
    """Return the steps of some numbers for derivatives, and the longest of a climb (2 x free)."""
    absolute, relative = STEPS[places, ::2], STEPS[places, 1::2]
    return np.asarray((absolute + relative * np.abs(theta[places])[:, None]).T)


def clip_servo_numbers(theta: Floats, log: Observations) -> Floats:
    """Clip the parameters to their bounds (L x P); absent parts stay absent."""
    # in a loop u answers to the reading of its sample
    earliest = 0.0 if log.is_closed_loop else EARLIEST
    ends = {
        At.DAMPING: (math.log(0.02), math.log(min(1.5 / log.step, 2000.0))),
        At.POLE: (math.log(5.0), math.log(1.5 / log.step)),
        At.SPRING: (-12.0, math.log(0.25 / log.step**2)),
        At.GAP: (1e-7, math.inf),
        At.TORQUE: (-14.0, 5.0),
        At.NOISE: (-16.0, 2.0),
        At.SLOW: (-10.0, 3.0),
        At.DELAY: (earliest, predictor.LATEST + EARLIEST - 1e-6),
    }
    ends |= dict.fromkeys(RUBS, (0.0, math.inf))
    own = theta.copy()
    for place, (low, high) in ends.items():
        own[:, place] = np.clip(theta[:, place], low, high)
    return np.where(np.isfinite(theta), own, theta)
