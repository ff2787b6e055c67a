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
from typing import NamedTuple

import numpy as np

from undeadzone.compile import lanes
from undeadzone.util.arrays import Flags, Floats, Integers
from undeadzone_identify.models.estimates import perturb_each, run_lanes_along
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


def discretise_servo(theta: Floats, step: float, lag: bool) -> tuple[Floats, Floats, Floats]:
    """Discretise (z, v, d, i): return transitions of state and inputs, and the covariance.

    Args:
        theta: numbers by `At` (L x P); what is not there is -inf, the pole +inf.
        step: sample time [s].
        lag: whether the plant is z' = -p z + g u, without inertia.

    Returns:
        A (L x 4 x 4), B (L x 4 x 2) of u and of a torque, Q (L x 3 x 3).
    """
    p = np.exp(theta[:, At.DAMPING])
    g = theta[:, At.GAIN]
    pole, k = np.exp(theta[:, [At.POLE, At.SPRING]].T)
    electric = np.isfinite(pole)
    rate = np.where(electric, pole, 0.0)
    A = np.zeros((len(theta), 6, 6))
    row = 0 if lag else 1
    if lag:
        A[:, 0, 0] = -p
    else:
        A[:, 0, 1] = 1.0
        A[:, 1, 0] = -k
        A[:, 1, 1] = -p
    A[:, row, 2] = g
    A[:, row, 5] = g
    A[:, row, 3] = np.where(electric, g, 0.0)
    A[:, row, 4] = np.where(electric, 0.0, g)
    A[:, 2, 2] = -1 / SLOW_TIME
    A[:, 3, 3] = -rate
    A[:, 3, 4] = rate
    white = g**2 * np.exp(2 * theta[:, At.TORQUE]) * step
    slow = np.exp(2 * theta[:, At.SLOW]) * 2 / SLOW_TIME
    fastest = float(np.max(p + np.sqrt(k) + rate + 1 / SLOW_TIME))
    halvings = max(0, math.ceil(math.log2(fastest * step / COARSEST)))
    h = step / 2**halvings
    E = np.tile(np.eye(6), (len(theta), 1, 1))
    term = E
    for m in range(1, TERMS + 1):
        term = term @ (A * (h / m))
        E = E + term
    density = np.zeros((len(theta), 3, 3))
    density[:, row, row] = white
    density[:, 2, 2] = slow
    # Simpson's rule over h
    half = np.eye(3) + A[:, :3, :3] * (h / 2) + A[:, :3, :3] @ A[:, :3, :3] * (h * h / 8)
    whole = half @ half
    middle = half @ density @ half.transpose(0, 2, 1)
    Q = h / 6 * (density + 4 * middle + whole @ density @ whole.transpose(0, 2, 1))
    for _ in range(halvings):
        F = E[:, :3, :3]
        Q = Q + F @ Q @ F.transpose(0, 2, 1)
        E = E @ E
    if lag:  # the rate is that of the last sample
        E[:, 1] = (E[:, 0] - np.eye(6)[0]) / step
        E[:, :, 1] = 0.0
        Q[:, 1, :], Q[:, :, 1] = Q[:, 0, :] / step, Q[:, :, 0] / step
        Q[:, 1, 1] = Q[:, 0, 0] / step**2
    return E[:, :4, :4], E[:, :4, 4:], Q


def build_lane_numbers(
    theta: Floats, step: float, quantum: float, ticks: bool, free: bool, lag: bool
) -> Floats:
    """Build the parameters of the predictor's lanes (L x numbers).

    Args:
        theta: by `At` (L x P).
        step: sample time [s].
        quantum: of the readings, scaled.
        ticks: whether the readings are ticks; else they are noisy.
        free: whether z is forgotten at reversals.
        lag: whether the plant is of first order.
    """
    A, B, Q = discretise_servo(theta, step, lag)
    rows = np.zeros((len(theta), len(NUMBERS) + LATEST + 1))
    for place, name in enumerate(PLANT):
        letter = name[0]
        at = name[1:]
        if letter in "bf":  # of u, or of a torque
            rows[:, place] = B[:, "zvdi".index(at[0]), "bf".index(letter)]
        else:
            rows[:, place] = (A if letter == "a" else Q)[:, int(at[0]), int(at[1])]
    quantum = max(quantum, FINEST)
    speed = theta[:, At.GAIN] ** 2 / np.exp(2 * theta[:, At.DAMPING])
    others = {
        "friction": theta[:, At.FRICTION],
        "load": theta[:, At.LOAD],
        "offset": theta[:, At.OFFSET],
        "gap": theta[:, At.GAP],
        "rms": SURE * quantum if ticks else np.exp(theta[:, At.NOISE]),
        "quantum": quantum,
        "step": step,
        "first_v": AT_FIRST**2 * speed,
        "first_d": np.exp(2 * theta[:, At.SLOW]),
        "free": float(free),
    }
    for name, value in others.items():
        rows[:, NUMBERS.index(name)] = value
    late = np.clip(theta[:, At.DELAY] - EARLIEST, 0.0, LATEST)
    whole = np.minimum(late.astype(int), LATEST - 1)
    each = np.arange(len(theta))
    rows[each, len(NUMBERS) + whole] = 1 - (late - whole)
    rows[each, len(NUMBERS) + whole + 1] = late - whole
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
    value: float

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

    def run_predictor(self, theta: Floats, lag: bool) -> Floats:
        """Run the predictor with several parameter sets (L x P); return `predictor.SEEN`
        (L x N x 4).
        """
        return self._run_kernel(self.kernel(), theta, lag)[0]

    def _run_kernel(self, kernel: lanes.Kernel, theta: Floats, lag: bool) -> tuple[Floats, Floats]:
        """Run a kernel; return its outputs and final states."""
        log = self.log
        rows = build_lane_numbers(theta, log.step, log.quantum, log.ticks, self.free, lag)
        return run_lanes_along(kernel, self.signals, rows)

    def log_likelihood_values(self, theta: Floats, lag: bool) -> Floats:
        """Return the log likelihoods of several parameter sets (L)."""
        return self._run_kernel(self.kernel("sums"), theta, lag)[1][:, -1]

    def error_slopes(
        self, points: Floats, free: Sequence[Integers], lag: bool
    ) -> list[ErrorSlopes]:
        """Return errors and derivatives at points (M x P) by the free parameters of each
        point.
        """
        moves = [slope_steps(theta)[own] for theta, own in zip(points, free, strict=True)]
        rows = [perturb_each(*one) for one in zip(points, free, moves, strict=True)]
        seen, _ = self._run_kernel(self.kernel("errors"), np.concatenate(rows), lag)
        found = []
        row = 0
        for steps in moves:
            count = steps.size
            own = seen[row : row + 1 + 2 * count].take(self.used, axis=1)
            slope = (own[1 : 1 + count] - own[1 + count :]) / (2 * steps[:, None, None])
            e, log_s = np.ascontiguousarray(own[0].T)
            de, dlog = np.ascontiguousarray(slope.transpose(2, 1, 0))
            found.append(ErrorSlopes(e, log_s, de, dlog))
            row += 1 + 2 * count
        return found

    def maximise_from_starts(
        self, starts: Sequence[Servo], steps: int, fixed: Sequence[int] = ()
    ) -> list[Servo]:
        """Find the maxima of the likelihood from several starts, in their order; lags
        apart.

        Args:
            starts: whose values are not needed.
            steps: of a climb at most.
            fixed: places of numbers that stay.
        """
        found = list(starts)
        for lag in (False, True):
            own = [k for k, one in enumerate(starts) if one.structure.lag == lag]
            if own:
                tops = self._maximise_same_kind([starts[k] for k in own], steps, fixed, lag)
                for k, top in zip(own, tops, strict=True):
                    found[k] = top
        return found

    def _maximise_same_kind(
        self, starts: list[Servo], steps: int, fixed: Sequence[int], lag: bool
    ) -> list[Servo]:
        """Find the maxima from starts that are all motors, or all first-order lags."""
        ticks = self.log.ticks
        free = [one.structure.free_places(ticks, self.free, fixed) for one in starts]
        theta = clip_servo_numbers(
            np.array([one.structure.disable_absent_parts(one.theta) for one in starts]), self.log
        )
        values = self.log_likelihood_values(theta, lag)
        idle = np.where(np.isfinite(values), 0, PATIENT)
        for _ in range(steps):
            going = np.flatnonzero(idle < PATIENT)
            if not going.size:
                break
            places = [free[k] for k in going]
            trials = []
            for k, slopes in zip(going, self.error_slopes(theta[going], places, lag), strict=True):
                trials.append(self._newton_trials(theta[k], slopes, free[k]))
            tried = clip_servo_numbers(np.concatenate(trials), self.log)
            reached = self.log_likelihood_values(tried, lag).reshape(going.size, -1)
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

    def _newton_trials(self, theta: Floats, slopes: ErrorSlopes, places: Integers) -> Floats:
        """Return the end points of damped Newton steps, bounds not applied (trials x P)."""
        scores, hessian = newton_terms(slopes)
        score = scores.sum(axis=0)
        diagonal = hessian.diagonal()
        scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1e-12))
        scaled = hessian * np.outer(scale, scale)
        if not np.isfinite(scaled).all() or not np.isfinite(score).all():
            return np.tile(theta, (DAMPINGS.size, 1))
        damped = scaled + DAMPINGS[:, None, None] * np.eye(places.size)
        try:
            found = np.linalg.solve(damped, (score * scale)[:, None])[:, :, 0] * scale
        except np.linalg.LinAlgError:
            found = np.tile(score * scale**2, (DAMPINGS.size, 1))
        longest = longest_steps(theta)[places]
        trials = np.tile(theta, (DAMPINGS.size, 1))
        trials[:, places] += np.clip(found, -longest, longest)
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


def slope_steps(theta: Floats) -> Floats:
    """Return the step of each parameter for numerical derivatives (P)."""
    steps = np.full(len(At), 2e-3)
    steps[At.GAIN] = 1e-3 * abs(theta[At.GAIN]) + 1e-9
    steps[RUBS] = 1e-3 + 0.01 * np.abs(theta[RUBS])
    steps[At.GAP] = 0.005 * theta[At.GAP] + 1e-6
    steps[At.DELAY] = 0.02
    return steps


def longest_steps(theta: Floats) -> Floats:
    """Return the largest change of each parameter in a Newton step (P)."""
    reach = np.ones(len(At))
    reach[At.GAIN] = 0.5 * abs(theta[At.GAIN]) + 0.02
    reach[RUBS] = 0.1
    reach[At.OFFSET] = 0.3
    reach[At.GAP] = 0.5 * theta[At.GAP] + 0.02
    reach[At.DELAY] = 1.0
    return reach


def clip_servo_numbers(theta: Floats, log: Observations) -> Floats:
    """Clip the parameters to their bounds (L x P); absent parts stay absent."""
    own = theta.T.copy()
    for place, low, high in (
        (At.DAMPING, math.log(0.02), math.log(min(1.5 / log.step, 2000.0))),
        (At.POLE, math.log(5.0), math.log(1.5 / log.step)),
        (At.SPRING, -12.0, math.log(0.25 / log.step**2)),
        (At.TORQUE, -14.0, 5.0),
        (At.NOISE, -16.0, 2.0),
        (At.SLOW, -10.0, 3.0),
    ):
        there = np.isfinite(own[place])
        own[place, there] = np.clip(own[place, there], low, high)
    own[RUBS] = np.maximum(own[RUBS], 0.0)
    own[At.GAP] = np.maximum(own[At.GAP], 1e-7)
    earliest = (
        0.0 if log.is_closed_loop else EARLIEST
    )  # in a loop u answers to the reading of its sample
    own[At.DELAY] = np.clip(own[At.DELAY], earliest, predictor.LATEST + EARLIEST - 1e-6)
    return np.ascontiguousarray(own.T)
