"""Is it a servo whose encoder stands behind gear play? Asked first of ticks, last of noise.

Behind an encoder, or of exact readings, a predictor in physical coordinates tells play from
friction at once, so it is tried before anything else. Noisy readings of an integrating plant, and
of what nothing else explains, are tried when that is known. What it says stands in the zone's
place; what it withdraws is said, too.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np
from scipy.stats import t as student

from undeadzone.nonlinearities.sensor import DIRECTIONS
from undeadzone.util.arrays import Floats, later
from undeadzone.util.text import bracket_interval
from undeadzone_identify.logs.grid import Grid
from undeadzone_identify.logs.log import Options
from undeadzone_identify.models import plant
from undeadzone_identify.models.estimates import Interval, quantile
from undeadzone_identify.models.least_squares import Density
from undeadzone_identify.selection.alternatives import (
    EVEN,
    LEAST_GAP,
    Element,
    Found,
    excluded_words,
)
from undeadzone_identify.selection.decision import (
    LEAST,
    LIKELY,
    MEMORY,
    UNLIKELY,
    Case,
    Verdict,
    best_of,
    decide,
)
from undeadzone_identify.selection.odds import Family, odds_of
from undeadzone_identify.servo.gap import ServoGap, centre_of, servo_gap, slopes_of
from undeadzone_identify.servo.likelihood import At, Servo, discretise_servo
from undeadzone_identify.servo.observations import Observations, noise_of, read_observations
from undeadzone_identify.servo.predictor import DEGREES

DENYING = ("none", "friction")  # words by which there is no play
STATIC = (
    "saturation",
    "input_zone",
    "input_curve",
    "filtered_zone",
)  # words of what has no memory, beside the sensor's own zone
NAMELESS = ("other", "unclear", "undecided")  # words that name nothing
EXPLAINED = (*MEMORY, *DENYING, "jump")  # that stand where they explain, but of an integrator
FEW_RETURNS = 3  # to 0, that say nothing of a sensor's zone
SILENCES = 1.6  # times the count of any other reading: of 886 random servos 5 have more
SETTLES = 40.0  # time constants a record, below which a plant may be an integrator in disguise
WIDER, FREEDOM = 1.25, 60  # of a friction's interval, as of a gap's
LEVEL = 0.004  # of a friction, by which it is uncertain at least: how a motor sticks is assumed
MOVED = 1e-4  # of a number, for derivatives of the sampled plant


def observations_of(grid: Grid, options: Options) -> Observations | None:
    """Return a log as a servo's predictor hears it; None where it is not one input's, or a
    sensor's.

    Args:
        grid: the records.
        options: what the user said.
    """
    if grid.u.shape[1] != 1 or options.kind not in ("auto", "play"):
        return None
    if options.place != "auto" or options.right or options.left:
        return None
    u = later(grid.u[:, 0], late_of(options), grid.start)
    log = read_observations(u, grid.y, grid.ok, grid.start, grid.step)
    return None if log is not None and log.ticks and _falls_silent(grid) else log


def servo_of_ticks(grid: Grid, options: Options) -> ServoGap | None:
    """What a log of ticks says of a servo; None of other logs."""
    log = observations_of(grid, options)
    return servo_gap(log) if log is not None and log.ticks else None


def _falls_silent(grid: Grid) -> bool:
    """Return whether readings stay at 0 for far longer than at any other value: a sensor's zone.

    Those count that pass, as a loop may rest at 0; where few pass, all.
    """
    y = grid.y[grid.ok]
    first = np.flatnonzero(np.diff(y, prepend=np.inf))
    held, stays = y[first], np.diff(first, append=y.size)
    ways = np.pad(np.sign(np.diff(held)), 1)
    counted = ways[1:] == ways[:-1]
    if np.count_nonzero(counted & (held == 0)) <= FEW_RETURNS:
        counted[1:] = True  # the first stay is no return
    if np.count_nonzero(counted & (held == 0)) <= FEW_RETURNS:
        return False
    values, which = np.unique(held[counted], return_inverse=True)
    samples = np.bincount(which, stays[counted])
    return bool(samples[values == 0] > SILENCES * samples[values != 0].max(initial=1))


def with_servo_options(options: Options, found: ServoGap) -> Options:
    """Return options of the fit beside a servo, whose plant is known: of first order, its delay
    alone.
    """
    late = str(late_of(options, found))
    return msgspec.structs.replace(options, order="1", integrators=0, delay=late)


def late_of(options: Options, found: ServoGap | None = None) -> int:
    """Samples by which the user said that the input is late, and a servo's acts later."""
    said = 0 if options.delay == "auto" else int(options.delay)
    return said if found is None else said + max(round(float(found.servo.theta[At.DELAY])), 0)


def order_of(servo: Servo) -> int:
    """Return poles of a servo."""
    return (1 if servo.structure.lag else 2) + ("pole" in servo.structure.parts)


# --- What is found


def may_be_servo(case: Case, found: Found) -> bool:
    """Return whether a servo behind a play is asked for: of integrators, or where something is
    left.
    """
    if found.element is not None or case.jumps is not None or case.unreached:
        return False
    word = found.verdict.word
    if _is_likely(case.servo, _likeliest_word(found)):
        return True
    log = observations_of(case.grid, case.options)
    explained, unlike = word in EXPLAINED, not case.chosen.white
    left = word in NAMELESS or (explained and _share(case, found) < LEAST)
    left |= case.options.integrators > 0
    if log is None or not log.ticks:
        return log is not None and (left or unlike)
    fit = case.chosen.pairs
    slow = fit.objective.simulator.settles(fit.theta) < SETTLES  # as an integrator does
    return word in (*EXPLAINED, *NAMELESS) and (left or (unlike and slow))


def _likeliest_word(found: Found) -> str:
    """Return the verdict's word, or that of the largest odds where these are of static models."""
    word, top = found.verdict.word, next(iter(found.odds), "")
    return top if word == "undecided" and top in STATIC else word


def _is_likely(servo: ServoGap | None, word: str) -> bool:
    """Return whether a play that is not given is likely where a word denies or names none."""
    if servo is None or servo.odds <= LIKELY:
        return False
    if word in STATIC:
        return servo.integrates and servo.gap.low > 0
    return word in (*DENYING, *NAMELESS) and servo.turns_too_seldom


def _share(case: Case, found: Found) -> float:
    """Return share of the readings that the model of the verdict explains."""
    y = case.data.y[case.data.ok]
    return 1 - best_of(found.verdict.word, found.models).rms / max(float(y.std()), 1e-300)


def with_servo(case: Case, found: Found) -> Found:
    """What is found with a servo, or why nothing is."""
    servo = case.servo or servo_gap(observations_of(case.grid, case.options))
    if servo is None:
        return found
    if has_no_gap(servo):
        return without_gap(case, servo, found)
    if not servo.log.ticks:
        return _likelier(case, servo, found)
    word = found.verdict.word
    explained = word in EXPLAINED and _share(case, found) >= LEAST
    integrates = bool(servo.integrates or case.options.integrators)
    if servo.is_given:
        return found if explained and not integrates else name_servo(case, servo, found)
    denied = servo.integrates and servo.odds > LIKELY and word in DENYING
    if denied or _is_likely(servo, _likeliest_word(found)):
        return _withhold_servo(servo, found, in_words(servo))
    if explained:
        return found
    if word == "unclear" and case.servo is not None and servo.gap.low <= 0:  # it has no gap
        return _withhold_servo(servo, found)
    of_another = word in NAMELESS or (word in MEMORY and not case.options.integrators)  # plant
    return found if of_another else _withhold_servo(servo, found)


# --- A servo without a gap


def has_no_gap(servo: ServoGap) -> bool:
    """Return whether an integrating servo holds the log, and a gap that matters is excluded.

    Args:
        servo: whose gap is not given.
    """
    alone = len(servo.reasons) == 1 and servo.gap.low <= 0
    is_small = servo.gap.high < LEAST_GAP * servo.log.y_scale
    is_below_steps = servo.gap.high < servo.log.quantum * servo.log.y_scale
    excluded = servo.odds < UNLIKELY or is_below_steps
    return alone and is_small and servo.integrates and excluded


def friction_of(servo: ServoGap) -> Interval | None:
    """Return the friction of a servo's motor [u]; None where it may be 0.

    Args:
        servo: with or without a gap.
    """
    free = list(servo.servo.structure.free(servo.log.ticks, False))
    if "friction" not in servo.servo.structure.parts or At.FRICTION not in free:
        return None
    place, value = free.index(At.FRICTION), float(servo.servo.theta[At.FRICTION])
    error = math.sqrt(max(float(servo.covariance[place, place]), 0.0))
    degrees = float(np.clip(servo.reversals - 1, 2, FREEDOM))
    half = math.hypot(WIDER * quantile(degrees) * error, LEVEL * value)
    friction = Interval.around(value, half)
    return friction.scale_interval(servo.log.u_scale) if friction.low > 0 else None


def without_gap(case: Case, servo: ServoGap, found: Found) -> Found:
    """What is found of a servo whose gap is excluded: friction with its level, or nothing.

    Args:
        case: the log.
        servo: that explains it without a gap.
        found: so far.
    """
    friction = friction_of(servo)
    word = "none" if friction is None else "friction"
    models, odds = found.models, {word: 1.0}
    if servo.odds < UNLIKELY:  # else the gap is below the steps of the encoder, whatever its odds
        odds = {word: 1 - servo.odds, "play": servo.odds}
    if not servo.log.ticks:  # whose densities compare with those of other models
        density = _family(case, servo)["play"]
        models = (*models, {"none": case.rivals["none"], word: density._replace(name=word)})
        odds = odds_of(models, excluded_words(case))
        if odds.get(word, 0.0) <= LIKELY:
            return found
    is_small = f"a gap between motor and encoder, if there is one, is below {servo.gap.high:.3g}"
    holds = "a motor explains the readings without friction"
    if friction is not None:
        level = bracket_interval(friction.value, friction.low, friction.high, ".4g")
        holds = f"a motor with friction explains the readings: {level} of the input"
    return found._replace(
        verdict=decide(word, holds, is_small),
        models=models,
        odds=odds,
        plays=None,
        friction=friction,
        element=element_of(case, servo)._replace(kind=word, widths=dict.fromkeys(DIRECTIONS)),
        delay=late_of(case.options, servo),
    )


# --- A servo with a gap


def _likelier(case: Case, servo: ServoGap, found: Found) -> Found:
    """What is found of noisy readings: a servo where its density is the largest."""
    models = (*found.models, _family(case, servo))
    odds = odds_of(models, excluded_words(case))
    best = best_of("play", models) is models[-1]["play"]
    if not best or min(odds.get("play", 0.0), servo.odds) <= LIKELY:
        return found
    if servo.is_given:
        return name_servo(case, servo, found)._replace(models=models, odds=odds)
    if found.verdict.word in MEMORY:  # whose gap may be known otherwise
        return found
    return _withhold_servo(servo, found)


def _family(case: Case, servo: ServoGap) -> Family:
    """Return a servo beside a plant without a zone, by the readings that its rivals were compared
    on.
    """
    log, none = servo.log, case.rivals["none"]
    own = np.full(case.data.y.size, np.nan)
    errors = slopes_of(log, servo.servo)
    each = student.logpdf(errors.e * np.exp(-errors.log_s), DEGREES) - errors.log_s
    own[log.counted_samples(False)] = each + math.log(case.data.y_scale / log.y_scale)
    compared = plant.part_of(case.data._replace(y=np.arange(own.size, dtype=float)))
    value = own[compared.y.astype(int)]
    there = compared.ok & np.isfinite(value)
    value = np.where(there, value, none.value)
    numbers = servo.servo.structure.free(log.ticks, False).size
    rms = float(errors.e.std()) * log.y_scale / case.data.y_scale
    return {"none": none, "play": Density("play", value, numbers, rms)}


def _withhold_servo(servo: ServoGap, found: Found, *named: str) -> Found:
    """What is found where a servo's gap is not given, with the reasons of that; it has no odds."""
    verdict = decide("undecided", *named, *servo.reasons)
    return found._replace(verdict=verdict, odds={}, plays=None)


def odds_of_gap(servo: ServoGap) -> dict[str, float]:
    """Of a gap against none."""
    return {"play": servo.odds, "none": 1 - servo.odds}


def name_servo(case: Case, servo: ServoGap, found: Found) -> Found:
    """What is found with a servo behind a play.

    Args:
        case: the log.
        servo: with its gap.
        found: so far.
    """
    word = "play" if servo.odds > LIKELY else "undecided"
    verdict = Verdict(word, [in_words(servo)], _cautions(servo))
    element = element_of(case, servo)
    late = late_of(case.options, servo)
    return found._replace(verdict=verdict, odds=odds_of_gap(servo), element=element, delay=late)


def in_words(servo: ServoGap) -> str:
    """What servo it is."""
    one = servo.servo
    name = "a lag of first order" if one.structure.lag else "a motor"
    names = {"pole": "an electrical pole", "slow": "slow torques", "friction": "friction"}
    names |= {"spring": "a spring", "load": "friction of the load"}
    parts = [names[part] for part in sorted(one.structure.parts)]
    with_parts = f" with {', '.join(parts)}" if parts else ""
    return (
        f"{name}{with_parts} behind gear play explains the readings;"
        f" {servo.crossings.gap.size} crossings say a gap of {servo.crossings.median:.4g} one by"
        f" one (median, +- {2 * servo.crossings.error:.2g})"
    )


def _cautions(servo: ServoGap) -> list[str]:
    """What to know of the gap."""
    return [
        "the gap is one between motor and encoder; of an encoder at the motor's side it shows only"
        " as far as the load is felt (rho c >> q, rho the load's share of the inertia): ask where"
        " the encoder is",
        *servo.trends,
    ]


def element_of(case: Case, servo: ServoGap) -> Element:
    """Return the element of a servo's play, with its plant without friction.

    Args:
        case: the log.
        servo: with its gap.
    """
    grid, data, one = case.grid, case.data, servo.servo
    u = later(grid.u[:, 0], late_of(case.options, servo), grid.start)
    own = data._replace(
        u=u[:, None] / data.u_scale,
        y=np.where(grid.ok, grid.y / data.y_scale, 0.0),
        ok=grid.ok,
        start=grid.start,
        side=np.zeros(grid.y.size, int),
        climbs=None,
    )
    free = int(servo.integrates)
    simulator = plant.Simulator(own, order_of(one), free)
    layout = simulator.layout
    count = layout.b.stop
    theta = np.zeros(layout.size)
    scale = float(data.u_scale[0]) / data.y_scale
    theta[:count] = plant_without_friction(servo, one.theta, scale)
    z, readings, side = servo.predict_readings(one)
    of_log, level = servo.log.y_scale / data.y_scale, float(own.y[own.ok][0])
    centre = centre_of(servo, float(grid.y[grid.ok][0]))
    rest = 0.0 if centre is None else centre.value / data.y_scale  # z = 0 at u = 0
    z, readings = z * of_log + level + rest, readings * of_log + level
    left = (own.y - readings)[own.ok]
    return Element(
        kind="play",
        fit=servo,
        simulator=simulator,
        theta=theta,
        V=_covariance(servo, scale, count),
        z=z,
        readings=readings,
        side=side,
        widths=_widths(case, servo, centre),
        ahead=None,
        noise=0.0 if servo.log.ticks else noise_of(servo.log) * servo.log.y_scale / data.y_scale,
        degrees=max(servo.reversals - 1, 2),
        rms=math.sqrt(float(np.mean(left**2))),
        remarks=[f"z of an integrating plant has no zero of its own: {EVEN}"] if free else [],
    )


def _widths(case: Case, servo: ServoGap, centre: Interval | None) -> dict[str, Interval | None]:
    """Return the play's widths [y]; what an offset of the output leaves of its sides and its
    centre.
    """
    width, even = servo.gap, servo.gap.scale_interval(0.5)
    if centre is None:
        return {"right": even, "left": even, "width": width, "centre": None}
    offset = math.inf if case.offset is None else case.offset * case.data.y_scale
    centre = Interval.around(centre.value, math.hypot(centre.half, offset))
    half = math.hypot(even.half, centre.half)
    right = Interval.around(even.value + centre.value, half)
    left = Interval.around(even.value - centre.value, half)
    return {"right": right, "left": left, "width": width, "centre": centre}


def plant_without_friction(servo: ServoGap, theta: Floats, scale: float) -> Floats:
    """Return a without its integrators and b of a servo's sampled plant, without friction.

    Args:
        servo: whose structure and step count.
        theta: its numbers.
        scale: of the units of b: that of u over that of y.
    """
    one, log = servo.servo, servo.log
    A, B, _ = discretise_servo(theta[None], log.step, one.structure.lag)
    places = [0] if one.structure.lag else [0, 1]
    places += [3] if "pole" in one.structure.parts else []
    F, b = A[0][np.ix_(places, places)], B[0, places, 0]
    poles = np.linalg.eigvals(F)
    whole = np.real(np.poly(F))
    markov = [float((np.linalg.matrix_power(F, k) @ b)[0]) for k in range(len(places))]
    numerator = np.convolve(whole, markov)[: len(places)]
    if servo.integrates:
        nearest = int(np.argmin(np.abs(poles - 1)))
        whole = np.real(np.poly(np.delete(poles, nearest)))
    in_units = log.y_scale / log.u_scale * scale
    return np.concatenate([np.atleast_1d(whole)[1:], numerator * in_units])


def _covariance(servo: ServoGap, scale: float, count: int) -> Floats:
    """Return the covariance of a and b, from that of the servo's numbers."""
    free = servo.servo.structure.free(servo.log.ticks, False)
    theta = servo.servo.theta
    rows = np.zeros((count, free.size))
    for column, place in enumerate(free):
        move = np.zeros(theta.size)
        move[place] = MOVED * max(abs(theta[place]), 1.0 if place != At.GAIN else 0.0)
        more = plant_without_friction(servo, theta + move, scale)
        less = plant_without_friction(servo, theta - move, scale)
        rows[:, column] = (more - less) / (2 * move[place])
    return np.asarray(rows @ servo.covariance @ rows.T)
