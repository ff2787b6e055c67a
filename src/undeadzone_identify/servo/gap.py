"""Gap of a servo's play with its interval, and the reasons for which none is reported.

The interval is as wide as the widest of what the log itself says (scores in cosines, sample by
sample, and between reversals) and of what twelve logs simulated with the fit say; these also take
off a bias. It reaches to the gaps of other structures that may be the true one. Where the crossings
say another gap, or the errors are none of a servo's, no gap is given.

Logs simulated with a fit: what the predictor makes of a gap that is known.

Ticks that come early have little variance, so they weigh more, and a torque that nobody
knows makes the gap a little too small. Logs with the plant, gap, torque and encoder of the fit show
by how much, and how far the gap scatters.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from scipy.signal import lfilter
from scipy.special import expit
from scipy.stats import chi2, kurtosis

from undeadzone.compile import lanes
from undeadzone.nonlinearities.play import apply_backlash
from undeadzone.nonlinearities.sensor import quantise
from undeadzone.util.arrays import Flags, Floats, Integers, shift_rows
from undeadzone_identify.models.estimates import (
    Interval,
    sandwich_covariance,
    student_quantile,
)
from undeadzone_identify.models.least_squares import regression_residual
from undeadzone_identify.models.measured import level_slopes
from undeadzone_identify.models.plant import mean_lag_products
from undeadzone_identify.servo import predictor
from undeadzone_identify.servo.crossings import GapCrossings, find_crossings
from undeadzone_identify.servo.likelihood import (
    DEAR,
    RUBS,
    SLOW_TIME,
    At,
    ErrorSlopes,
    Servo,
    ServoLikelihood,
    ServoStructure,
    build_lane_numbers,
    newton_terms,
)
from undeadzone_identify.servo.observations import (
    Observations,
    change_sides,
    reading_noise_rms,
    to_schmitt_ticks,
)
from undeadzone_identify.servo.predictor import LATEST, MEAN, NUMBERS
from undeadzone_identify.servo.search import search_servos

RUNS = 12
STEPS = 8  # of a climb from the fit


@cache
def _simulation_kernel() -> lanes.Kernel:
    """Build the compiled step of a servo and its play, with a separate torque for each lane."""
    state = ca.SX.sym("s", MEAN + 1)
    signals = ca.SX.sym("w", LATEST + 1 + 3)
    numbers = ca.SX.sym("p", len(NUMBERS) + LATEST + 1)
    lane = predictor.build_lane(numbers)
    begun, starts, torque = ca.vertsplit(signals[LATEST + 1 :])
    acting = ca.dot(lane.taps, signals[: LATEST + 1])
    contact = predictor.contact_share(lane, state[0], state[1], state[MEAN])
    pushed = lane.offset + torque
    x = predictor.step_motor(lane, ca.vertsplit(state[:MEAN]), acting, pushed, contact).x
    x = ca.if_else(starts, ca.vertcat(begun, 0, 0, 0), ca.vertcat(*x))
    level = ca.if_else(starts, begun, predictor.drag_load(lane, state[MEAN], x[0]))
    step = ca.Function("simulated", [state, signals, numbers], [ca.vertcat(x, level), level])
    own = LATEST + 1 + 2
    return lanes.build_kernel(step, exogenous=[own], width=16, fused=True)


def simulate_servo_logs(log: Observations, servo: Servo) -> list[Observations]:
    """Simulate RUNS logs of a servo with the input of a log.

    The torque of the motor has a white disturbance, and one of first order.

    Args:
        log: observations of the predictor.
        servo: fit of the servo.
    """
    theta = servo.theta
    size = log.u.size
    draw = np.random.default_rng(5)
    torque = math.exp(theta[At.TORQUE]) * draw.standard_normal((size, RUNS))
    decay = math.exp(-log.step / SLOW_TIME)
    white = math.sqrt(1 - decay * decay) * draw.standard_normal((size, RUNS))
    torque += math.exp(theta[At.SLOW]) * lfilter([1.0], [1.0, -decay], white, axis=0)
    rows = build_lane_numbers(theta[None], log, False, servo.structure.lag)
    signals = np.column_stack([log.kernel_inputs(log.ok)[:, : LATEST + 1], np.zeros((size, 3))])
    signals[log.start, LATEST + 1] = log.y[log.start]
    signals[log.start, LATEST + 2] = 1.0
    levels, _ = lanes.run_lanes(
        _simulation_kernel(), np.zeros(MEAN + 1), signals, rows[0], torque[:, None, :], threads=1
    )
    return [_record_levels(log, theta, level, draw) for level in levels[:, :, 0]]


def _record_levels(
    log: Observations, theta: Floats, level: Floats, draw: np.random.Generator
) -> Observations:
    """Return the log with simulated levels as read by its encoder, or with its noise."""
    if not log.ticks:
        return log._replace(y=level + math.exp(theta[At.NOISE]) * draw.standard_normal(level.size))
    y = quantise(level, log.quantum)
    side = change_sides(y, log.ok, log.start)
    return log._replace(y=y, side=side, boundary=y - side * log.quantum / 2)


def refit(log: Observations, one: Servo, fixed: Sequence[int] = ()) -> Servo:
    """Return a servo that is fitted to another log, with some numbers fixed."""
    return ServoLikelihood(log).maximise_from_starts([one], STEPS, fixed)[0]


# --- The gap, and when none is given

LONGEST = 20_000  # samples that are fitted
REVERSALS = 10  # crossings that a gap is read off, at least
WIDER = 1.25  # than by errors that are independent of what else is fitted
COLOURED = 0.06  # rms of slow torques in that of the input, from which their colour matters
ANY_COLOUR = 1.6  # wider where noisy readings are fitted with such torques, whatever their colour
HIDING = 0.5  # rms of slow torques, in that of the input, from which no gap is given
FLOOR = 0.05  # quanta, by which a gap is uncertain at least
LOOSE = 0.008  # of the gap, by which it is uncertain where a load rubs: how it does is assumed
DEGREES = 60  # of freedom at most
DISAGREES = 4.0  # standard errors by which crossings may say another gap
TICKS = 0.5  # quanta by which they may besides
NOISES = 2.0  # rms of the noise by which they may besides
LEAST_GAP = 3.0  # rms of the noise, below which friction that gives way is no other than a gap
CLOSE = 0.02  # of the gap, by which they may in any case
WIDEST = 0.5  # of the gap: half of an interval that is an answer
SETTLES = 3.0  # time constants of a log, below which a lag is an integrator
LOOKED = 4  # simulated logs whose crossings are looked at
SCATTERS = 0.5  # of the gap, by which no simulated log's may differ
HEAVY = 40.0  # kurtosis of errors that are no servo's
FAR = 8.0  # deviations beyond which one error is
INPUT_SHARE = 0.04  # share of the errors of noisy readings that past inputs may explain
SLOW_SHARE = 0.05  # of the rms of white torques, from which others are claimed
SHORT = 1 / 12  # of the time between reversals: correlation time of friction, as a filter's torque
CORRELATED = 0.01  # sum of the squared correlations of these errors, which is noticed
FOLLOWING = 20  # errors that may follow an error
CHANCE = 1e-4  # p below which they do
CLIP = 4.0  # deviations beyond which an error counts no more for that


class ServoGap(NamedTuple):
    """Gap of a servo's log, with its crossings and the reasons against it.

    Attributes:
        log: as the predictor hears it.
        servo: the likeliest one.
        gap: with its interval [y].
        crossings: one after another.
        reversals: of the readings.
        covariance: of the servo's free numbers.
        gained: nats of the log likelihood by which the gap is better than none.
        reasons: why no gap is given; empty if one is.
        is_servo: whether errors and crossings are those of a servo, be its gap known or not.
        has_bursts: whether large errors follow large ones, as behind strikes of a heavy load.
    """

    log: Observations
    servo: Servo
    gap: Interval
    crossings: GapCrossings
    reversals: int
    covariance: Floats
    gained: float
    reasons: tuple[str, ...]
    is_servo: bool
    has_bursts: bool

    @property
    def least_gap(self) -> float:
        """Return the gap below which none matters: an encoder's step, or the noise of readings."""
        log = self.log
        return (log.quantum if log.ticks else LEAST_GAP * reading_noise_rms(log)) * log.y_scale

    @property
    def is_gap_reported(self) -> bool:
        """Return whether the gap is reported, with certainty above 0."""
        return not self.reasons

    @property
    def has_few_reversals(self) -> bool:
        """Return whether too few reversals are the only reason against the gap."""
        return self.reversals < REVERSALS and len(self.reasons) == 1

    @property
    def is_integrating(self) -> bool:
        """Return whether z has no restoring force, or none that the log could show."""
        one = self.servo
        if not one.structure.lag:
            return "spring" not in one.structure.parts
        return math.exp(one.theta[At.DAMPING]) * self.log.step * self.log.u.size < SETTLES

    @property
    def gap_probability(self) -> float:
        """Return the posterior probability of a gap against none, by BIC."""
        used = max(int(np.count_nonzero(self.log.error_samples(False))), 2)
        return float(expit(self.gained - 0.5 * DEAR * math.log(used)))

    @property
    def motor_disturbance(self) -> tuple[float, float]:
        """Return rms [u] and correlation time [s] of the torque on the motor beside u and
        damping.

        Friction is a part of it, which changes its sign at each reversal.
        """
        log = self.log
        theta = self.servo.structure.disable_absent_parts(self.servo.theta)
        rubs = theta[RUBS].sum()
        slow = math.hypot(math.exp(theta[At.SLOW]), theta[At.OFFSET])
        white = math.exp(theta[At.TORQUE])
        rms = math.hypot(rubs, slow)
        if rms < SLOW_SHARE * white:
            return white * log.u_scale, 0.5 * log.seconds
        turning = log.busiest_part(LONGEST).u.size * log.seconds / max(self.reversals, 1)
        of_slow = SLOW_TIME * log.seconds / log.step
        time = (rubs**2 * SHORT * turning + slow**2 * of_slow) / rms**2
        return rms * log.u_scale, max(time, 0.5 * log.seconds)

    def fit_to_samples(self, among: Flags) -> Servo:
        """Fit the servo to a subset of the samples (N)."""
        return ServoLikelihood(self.log, among=among).maximise_from_starts([self.servo], STEPS)[0]

    def predict_readings(self, one: Servo) -> tuple[Floats, Floats, Integers]:
        """Return the predicted z, its noise-free reading and the contact (N each), scaled."""
        log = self.log
        z = ServoLikelihood(log).run_predictor(one.theta[None], one.structure.lag)[0][:, 2]
        half = one.theta[At.GAP] / 2
        before = shift_rows(log.y, 1, log.start)
        readings = quantise(apply_backlash(np, z, before, half, half), log.quantum)
        return z, readings, np.sign(readings - before).astype(int)

    def normalised_errors(self, one: Servo) -> Floats:
        """Return the counted prediction errors divided by their standard deviations (n)
        [1].
        """
        return servo_slopes(self.log, one).normalised

    @property
    def trend_remarks(self) -> list[str]:
        """Return the trends of the gap in words; none for noisy readings."""
        return self.crossings.describe_trends() if self.log.ticks else []


def identify_servo_gap(log: Observations | None) -> ServoGap | None:
    """Find the gap of a servo's log; None if nothing moves or no servo fits.

    Args:
        log: as `build_observations` returns it; None: nothing moves.
    """
    if log is None:
        return None
    part = log.busiest_part(LONGEST)
    tops = search_servos(part)
    if not tops:
        return None
    best = tops[0]
    slopes = servo_slopes(part, best)
    if not all(np.isfinite(column).all() for column in slopes):
        return None
    spread = _GapUncertainty(part, best, slopes)
    logs = simulate_servo_logs(part, best)
    gaps = np.array([refit(one, best).theta[At.GAP] for one in logs])
    gap = _correct_gap_bias(part, best, spread, gaps, [one.theta[At.GAP] for one in tops])
    found = ServoGap(
        log=log,
        servo=best,
        gap=gap.scale_by(log.y_scale),
        crossings=_correct_crossing_bias(find_crossings(log, best), logs, best),
        reversals=spread.reversals,
        covariance=spread.covariance,
        gained=best.value - refit(part, best.replace_number(At.GAP, 0.0), [At.GAP]).value,
        reasons=(),
        is_servo=False,
        has_bursts=are_errors_in_bursts(slopes.normalised),
    )
    moved = _collect_motion_doubts(found, spread)
    odd = collect_odd_errors(part, slopes)
    reasons = (*moved, *_collect_gap_doubts(found, gaps), *odd)
    return found._replace(reasons=reasons, is_servo=not moved and not odd)


def degrees_of_reversals(reversals: int) -> float:
    """Return the degrees of freedom of what each reversal shows once."""
    return float(np.clip(reversals - 1, 2, DEGREES))


def gap_offset_interval(found: ServoGap, level: float) -> Interval | None:
    """Return the offset (c_r - c_l) / 2 of a gap, if z = 0 at u = 0 [y]; None if integrating.

    Args:
        found: the gap.
        level: the first reading [y].
    """
    one = found.servo
    if found.is_integrating:
        return None
    rest = _rest_position(one.structure, one.theta)
    variance = covariance_of(found, lambda theta: _rest_position(one.structure, theta))
    half = WIDER * student_quantile(degrees_of_reversals(found.reversals)) * math.sqrt(variance)
    return Interval.from_half_width(-rest * found.log.y_scale - level, half * found.log.y_scale)


def covariance_of(found: ServoGap, quantity: Callable[[Floats], Any]) -> Any:
    """Return the variance of a number of a servo, or the covariance of several (K x K).

    Args:
        found: whose numbers have a covariance.
        quantity: of the servo's numbers (P).
    """
    one = found.servo
    free = one.structure.free_places(found.log.ticks, False)
    slopes = level_slopes(quantity, one.theta, free)
    return slopes @ found.covariance @ slopes.T


def _rest_position(structure: ServoStructure, theta: Floats) -> float:
    """Return the value of z at rest for u = 0, from the first reading, scaled."""
    stiffness = math.exp(theta[At.DAMPING if structure.lag else At.SPRING])
    return float(theta[At.GAIN] * theta[At.OFFSET]) / stiffness


def servo_slopes(log: Observations, one: Servo) -> ErrorSlopes:
    """Return the counted errors of a servo and their derivatives by its free parameters."""
    free = one.structure.free_places(log.ticks, False)
    return ServoLikelihood(log).error_slopes(one.theta[None], [free], [one.structure.lag])[0]


class _GapUncertainty:
    """Uncertainty of a gap by the log itself."""

    def __init__(self, log: Observations, one: Servo, slopes: ErrorSlopes) -> None:
        place = list(one.structure.free_places(log.ticks, False)).index(At.GAP)
        spread = sandwich_covariance(*newton_terms(slopes))
        self.covariance = spread.V
        turned = np.cumsum((log if log.ticks else to_schmitt_ticks(log)).reversal_ticks)
        self.reversals = int(turned[-1])
        used = ServoLikelihood(log).used
        shares = spread.scores @ spread.naive[:, place]  # of the gap, by each error
        runs = np.bincount(turned[used], shares)
        whole = float(runs @ runs)
        of_runs = max(whole + float(runs[1:] @ runs[:-1]), 0.5 * whole)
        few = runs.size / max(runs.size - 1, 1)
        variances = spread.V[place, place], float(shares @ shares), of_runs * few
        self.error = math.sqrt(max(*variances, 0.0))


def _correct_gap_bias(
    log: Observations, one: Servo, spread: _GapUncertainty, gaps: Floats, others: list[float]
) -> Interval:
    """Return the gap less the bias of simulated logs, with its interval, scaled."""
    gap = float(one.theta[At.GAP])
    least = log.quantum if log.ticks else reading_noise_rms(log)
    reach = 4 * spread.error + 0.2 * least
    middle = np.median(gaps)
    bias = float(np.mean(np.clip(gaps, middle - reach, middle + reach))) - gap
    loose = LOOSE * gap * ("load" in one.structure.parts)
    error = math.hypot(max(spread.error, float(np.std(gaps, ddof=1))), FLOOR * least, loose)
    quantile = student_quantile(degrees_of_reversals(spread.reversals))
    apart = max(abs(other - gap) for other in others)
    half = math.hypot(WIDER * quantile * error, bias, apart)
    half *= ANY_COLOUR if not log.ticks and _slow_torque_rms(one) > COLOURED else 1.0
    return Interval.from_half_width(max(gap - bias, 0.0), half)


def _slow_torque_rms(one: Servo) -> float:
    """Return the rms of slow torques, in units of the input's rms."""
    return math.exp(one.structure.disable_absent_parts(one.theta)[At.SLOW])


def _correct_crossing_bias(
    crossings: GapCrossings, logs: list[Observations], one: Servo
) -> GapCrossings:
    """Return the crossings less the bias of the crossings of simulated logs."""
    medians = [find_crossings(log, one).median_gap for log in logs[:LOOKED]]
    known = [gap for gap in medians if math.isfinite(gap)] or [math.nan]
    shift = float(np.median(known)) - float(one.theta[At.GAP]) * logs[0].y_scale
    return crossings._replace(gap=crossings.gap - shift) if math.isfinite(shift) else crossings


def _collect_gap_doubts(found: ServoGap, gaps: Floats) -> list[str]:
    """Collect the reasons for which the gap itself is not known."""
    gap = found.gap
    reasons = []
    fitted = found.servo.theta[At.GAP] * found.log.y_scale
    if gap.low <= 0:
        reasons.append(
            f"a gap between motor and encoder, if there is one, is below {gap.high:.3g} (an encoder"
            " at the motor's side shows little of the gap behind it)"
        )
    elif not found.log.ticks and gap.high < found.least_gap:
        reasons.append(
            f"a gap would be below {gap.high:.3g}, within the noise of the readings: friction that"
            " gives way before it slides looks the same"
        )
    elif gap.half_width > WIDEST * gap.value:
        reasons.append(
            f"the gap lies between {gap.low:.3g} and {gap.high:.3g}, which is hardly known. Record"
            " for longer, or with more reversals"
        )
    if gap.low > 0 and np.max(np.abs(gaps * found.log.y_scale - fitted)) > SCATTERS * fitted:
        reasons.append("logs simulated with the fit do not lead back to its gap")
    return reasons


def _collect_motion_doubts(found: ServoGap, spread: _GapUncertainty) -> list[str]:
    """Collect the reasons for which the motion is hardly a servo's, be there a gap or not."""
    log = found.log
    crossings = found.crossings
    reasons = []
    if found.reversals < REVERSALS:
        reasons.append(
            f"the readings turn {found.reversals} times, and each crossing shows the gap once:"
            f" {REVERSALS} are the least. Record with an input that reverses more often"
        )
    if _slow_torque_rms(found.servo) > HIDING:
        reasons.append("slow torques are as strong as half of the input: they hide the gap")
    fitted = found.servo.theta[At.GAP] * log.y_scale
    margin = TICKS * log.quantum if log.ticks else NOISES * reading_noise_rms(log)
    error = math.hypot(spread.error * log.y_scale, crossings.median_error)
    allowed = DISAGREES * error + margin * log.y_scale + CLOSE * fitted
    if abs(crossings.median_gap - fitted) > allowed:
        reasons.append(
            f"the crossings one by one give a gap of {crossings.median_gap:.4g}, all together"
            f" {fitted:.4g}: the motor's motion is not fully held"
        )
    return reasons


def are_errors_in_bursts(errors: Floats) -> bool:
    """Return whether squares of errors follow from squares before them (McLeod and Li 1983).

    Args:
        errors: of predictions, divided by their standard deviations (n).
    """
    squares = np.clip(errors - errors.mean(), -CLIP, CLIP) ** 2
    portmanteau = squares.size * sum_squared_correlations(squares)
    return bool(chi2.sf(portmanteau, FOLLOWING) < CHANCE)


def sum_squared_correlations(values: Floats) -> float:
    """Return the sum of the squared autocorrelations at lags 1 to `FOLLOWING` of values (n)."""
    seen = mean_lag_products(values, np.ones(values.size, bool), 1 + FOLLOWING)
    return float(np.sum(seen[1:] ** 2)) / max(seen[0] ** 2, 1e-300)  # values may all be equal


def collect_odd_errors(log: Observations, slopes: ErrorSlopes) -> list[str]:
    """Collect the reasons for which the errors do not fit a servo.

    Args:
        log: as the predictor hears it.
        slopes: with the errors.
    """
    r = slopes.normalised
    r = r - r.mean()
    reasons = []
    if np.abs(r).max() > FAR and kurtosis(r, fisher=False) > HEAVY:
        reasons.append("a few readings are far from what any servo does")
    if log.ticks:
        return reasons
    squares = sum_squared_correlations(np.clip(r, -CLIP, CLIP))
    if squares > CORRELATED and chi2.sf(r.size * squares, FOLLOWING) < CHANCE:
        reasons.append("errors follow from errors before them: no model of a motor explains them")
    used = np.flatnonzero(log.error_samples(False))
    past = log.kernel_inputs(log.ok)[used, 1 : LATEST + 1]
    left = regression_residual(past - past.mean(axis=0), r)
    if 1 - (left @ left) / max(r @ r, 1e-300) > INPUT_SHARE:
        reasons.append("past inputs explain errors: no model of a motor explains them")
    return reasons
