"""Servo behind gear play: tested first for an encoder's ticks, last for noisy readings.

Behind an encoder, or of exact readings, a predictor in physical coordinates tells play from
friction at once, so it is tried before anything else. Noisy readings of an integrating plant, and
of what nothing else explains, are tried when that is known. What it says stands in the zone's
place; what it withdraws is said, too.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np
from scipy.signal import lombscargle, ss2tf
from scipy.stats import t as student

from undeadzone.nonlinearities.sensor import DIRECTIONS
from undeadzone.util.arrays import Floats, shift_rows
from undeadzone.util.text import bracket_interval
from undeadzone_identify.logs.grid import Grid
from undeadzone_identify.logs.log import Options
from undeadzone_identify.models import plant
from undeadzone_identify.models.estimates import Interval, student_quantile
from undeadzone_identify.models.least_squares import Density, regress_residual
from undeadzone_identify.models.likelihood import dead_zone, root_mean_square
from undeadzone_identify.selection.adequacy import AT_SENSOR, Remainder, hat_columns
from undeadzone_identify.selection.alternatives import (
    EVEN,
    LEAST_GAP,
    WIDER,
    Element,
    Findings,
    impossible_words,
)
from undeadzone_identify.selection.decision import (
    LEAST,
    LIKELY,
    MEMORY,
    UNLIKELY,
    Case,
    Verdict,
    best_model_of,
    build_verdict,
)
from undeadzone_identify.selection.odds import Family, model_probabilities
from undeadzone_identify.servo.gap import (
    LONGEST,
    ServoGap,
    covariance_of,
    degrees_of_reversals,
    gap_offset_interval,
    identify_servo_gap,
    refit,
    servo_slopes,
)
from undeadzone_identify.servo.likelihood import RUBS, At, Servo, discretise_servo
from undeadzone_identify.servo.observations import (
    Observations,
    build_observations,
    reading_noise_rms,
)
from undeadzone_identify.servo.predictor import DEGREES

WITHOUT_PLAY = ("none", "friction")  # classes that exclude a play
LINEAR = (*WITHOUT_PLAY, "operating_point")
AT_MOTOR = (
    "an encoder on the motor's side of the gears shows a gap only through the load behind it: if"
    " the encoder is there, a gap behind it is not excluded"
)
WHERE_READ = (
    "the gap is one between motor and encoder; of an encoder at the motor's side it shows only"
    " as far as the load is felt (rho c >> q, rho the load's share of the inertia): ask where"
    " the encoder is"
)
BURSTS = (
    "the residual of a motor comes in bursts, as strikes of a load make that is free in a gap, or"
    " friction that changes: no gap is not certain. Record an encoder on either side of the gears"
)
WITHOUT_MEMORY = (
    "saturation",
    "input_zone",
    "input_curve",
    "filtered_zone",
)  # classes without memory (hysteresis) other than a dead zone of the sensor
UNDECIDED = ("other", "unclear", "undecided")  # classes that name no nonlinearity
EXPLAINED = (*MEMORY, *WITHOUT_PLAY, "jump")  # kept if they explain the log, but of no integrator
FEW_RETURNS = 3  # passages of 0: so few or fewer do not show a zone of the sensor
# Least ratio of the samples at 0 to those at any other reading, for a zone of the sensor. Of 886
# random servos without a zone 5 exceed it.
LONGER_AT_ZERO = 1.6
SETTLES = 40.0  # time constants a record, below which a plant may be an integrator in disguise
HALF_PERIODS = range(6, 60)  # that a motor's way may hold
TRIED = np.geomspace(0.7, 2.0, 12)  # widths of a zone of the input, over the level of friction
NATS = 3.0  # odds of 20 to 1
LEVEL = 0.02  # of a friction, by which it is uncertain at least: how a motor sticks is assumed
ROUNDED = 1.2  # times the rounding's rms: a residual below it is rounding


def to_observations(grid: Grid, options: Options) -> Observations | None:
    """Convert a log to the servo predictor's signals; None for several inputs or a sensor's
    zone.

    Args:
        grid: the records.
        options: of the user.
    """
    is_plain = options.kind in ("auto", "play") and options.place == "auto"
    if grid.u.shape[1] != 1 or not is_plain or options.right or options.left:
        return None
    u = shift_rows(grid.u[:, 0], total_delay(options), grid.start)
    log = build_observations(u, grid.y, grid.ok, grid.start, grid.step)
    return None if log is not None and log.ticks and _has_zone_at_zero(grid) else log


def identify_tick_servo(grid: Grid, options: Options) -> ServoGap | None:
    """Find the servo of a log of ticks; None for other logs."""
    log = to_observations(grid, options)
    return identify_servo_gap(log) if log is not None and log.ticks else None


def _has_zone_at_zero(grid: Grid) -> bool:
    """Return whether readings stay at 0 far longer than at any other value, as in a zone at 0.

    A control loop may come to rest at 0 without a zone. Therefore only passages count: stays at a
    value that end in the direction in which they began. If 0 has few passages, all stays count.

    Args:
        grid: records of an encoder, whose readings repeat exactly.
    """
    y = grid.y[grid.ok]
    starts = np.flatnonzero(np.diff(y, prepend=np.inf))  # sample at which each stay begins
    values, durations = y[starts], np.diff(starts, append=y.size)
    directions = np.pad(np.sign(np.diff(values)), 1)  # into each stay, and out of the last one
    is_counted = directions[1:] == directions[:-1]
    if np.count_nonzero(is_counted & (values == 0)) <= FEW_RETURNS:
        is_counted[1:] = True  # the first stay is not a return to its value
    if np.count_nonzero(is_counted & (values == 0)) <= FEW_RETURNS:
        return False
    levels, level_of_stay = np.unique(values[is_counted], return_inverse=True)
    samples = np.bincount(level_of_stay, durations[is_counted])
    return bool(samples[levels == 0] > LONGER_AT_ZERO * samples[levels != 0].max(initial=1))


def to_servo_options(options: Options, found: ServoGap) -> Options:
    """Return the options of the fit beside a servo: a known plant, first order, a fixed delay."""
    late = str(total_delay(options, found))
    return msgspec.structs.replace(options, order="1", integrators=0, delay=late)


def total_delay(options: Options, found: ServoGap | None = None) -> int:
    """Return the samples of the user's input delay plus the delay of a servo."""
    if found is None:
        return options.recorded_delay
    return options.recorded_delay + max(round(float(found.servo.theta[At.DELAY])), 0)


# --- What is found


def needs_servo_test(case: Case, found: Findings) -> bool:
    """Return whether a servo must be tested: for integrators, or if a residual remains."""
    word = found.verdict.word
    if found.element is not None or case.jump_edges is not None or case.unreached:
        return False
    if case.has_limits_as(word):
        return False
    if word in (*WITHOUT_MEMORY, "none") and _leaves_rounding_alone(case, found):
        return False  # a gap of 0.4 quanta or more would leave more
    if _has_likely_gap(case.servo, _likeliest_word(found)):
        return True
    log = to_observations(case.grid, case.options)
    explained, unlike = word in EXPLAINED, not case.chosen.white
    left = word in UNDECIDED or (explained and _share_of_verdict(case, found) < LEAST)
    left |= case.options.integrators > 0
    fit = case.chosen.fit
    slow = fit.objective.simulator.settling_constants(fit.theta) < SETTLES  # as an integrator does
    if log is None or not log.ticks:
        return log is not None and (left or unlike or (slow and word in LINEAR))
    return word in (*EXPLAINED, *UNDECIDED) and (left or (unlike and slow))


def _likeliest_word(found: Findings) -> str:
    """Return the class; if it is undecided, the most probable one if that has no memory."""
    decided, likeliest = found.verdict.word, next(iter(found.odds), "")
    return likeliest if decided == "undecided" and likeliest in WITHOUT_MEMORY else decided


def _has_likely_gap(servo: ServoGap | None, decided: str) -> bool:
    """Return whether a servo has a likely gap that is not reported and that the class misses.

    A class without memory may stand for the gap of an integrating servo. Any other class that
    names no play is doubted only if too few reversals are the sole reason against the gap.

    Args:
        servo: fitted servo (None: not fitted).
        decided: class that is decided so far.
    """
    if servo is None or servo.gap_probability <= LIKELY:
        return False
    if decided in WITHOUT_MEMORY:
        return servo.is_integrating and servo.gap.low > 0
    return decided in (*WITHOUT_PLAY, *UNDECIDED) and servo.has_few_reversals


def _leaves_rounding_alone(case: Case, found: Findings) -> bool:
    """Return whether the verdict's model leaves no more than the rounding of the readings."""
    rounding = case.quantum / math.sqrt(12)
    return best_model_of(found.verdict.word, found.models).rms < ROUNDED * rounding


def _share_of_verdict(case: Case, found: Findings) -> float:
    """Return the share of the readings that the verdict's model explains [1]."""
    y = case.record_data.y[case.record_data.ok]
    return 1 - best_model_of(found.verdict.word, found.models).rms / max(float(y.std()), 1e-300)


def add_servo(case: Case, found: Findings) -> Findings:
    """Return the findings with a servo, or with the reasons against a servo."""
    servo = case.servo or identify_servo_gap(to_observations(case.grid, case.options))
    if servo is None:
        return found
    if has_no_gap(servo):
        return without_gap(case, servo, found)
    if servo.has_bursts and servo.is_integrating and found.verdict.word in LINEAR:
        return _withhold_servo(servo, found, BURSTS)
    if not servo.log.ticks:
        return _compare_noisy_servo(case, servo, found)
    word = found.verdict.word
    explained = word in EXPLAINED and _share_of_verdict(case, found) >= LEAST
    integrates = bool(servo.is_integrating or case.options.integrators)
    if servo.is_gap_reported:
        return found if explained and not integrates else add_servo_element(case, servo, found)
    denied = servo.is_integrating and servo.gap_probability > LIKELY and word in WITHOUT_PLAY
    if denied or _has_likely_gap(servo, _likeliest_word(found)):
        return _withhold_servo(servo, found, describe_servo(servo))
    if explained:
        return found
    if word == "unclear" and case.servo is not None and servo.gap.low <= 0:  # it has no gap
        return _withhold_servo(servo, found)
    of_another = word in UNDECIDED or (word in MEMORY and not case.options.integrators)  # plant
    return found if of_another else _withhold_servo(servo, found)


# --- A servo without a gap


def has_no_gap(servo: ServoGap) -> bool:
    """Return whether a servo explains the log, and a gap that matters is excluded.

    The servo integrates, or rubs beside a spring. A spring alone is a plant like others.

    Args:
        servo: whose gap is not given.
    """
    is_small = servo.gap.high < LEAST_GAP * servo.log.y_scale
    excluded = servo.gap_probability < UNLIKELY or servo.gap.high < servo.least_gap
    is_motor = servo.is_servo and not servo.has_bursts and not servo.is_gap_reported
    if not (is_motor and is_small and excluded):
        return False
    return servo.is_integrating or friction_of(servo) is not None


def friction_of(servo: ServoGap) -> Interval | None:
    """Return the friction of a servo without a gap [u]; None if it may be 0.

    Without a gap the load rubs whenever the motor does, so its friction is added.

    Args:
        servo: without a gap that matters.
    """
    if not servo.servo.structure.parts & {"friction", "load"}:
        return None
    value = float(servo.servo.theta[RUBS].sum())
    error = math.sqrt(max(covariance_of(servo, lambda theta: theta[RUBS].sum()), 0.0))
    degrees = degrees_of_reversals(servo.reversals)
    half = math.hypot(WIDER * student_quantile(degrees) * error, LEVEL * value)
    friction = Interval.from_half_width(value, half)
    return friction.scale_by(servo.log.u_scale) if friction.low > 0 else None


def without_gap(case: Case, servo: ServoGap, found: Findings) -> Findings:
    """Findings on a servo whose gap is excluded: friction with its level, or nothing.

    Args:
        case: the log.
        servo: that explains it without a gap.
        found: so far.
    """
    friction = friction_of(servo)
    other = find_repetition(servo) or (friction and find_input_zone(servo))
    if other:
        return _withhold_servo(servo, found, other)
    word = "none" if friction is None else "friction"
    models, odds = found.models, {word: 1.0}
    share = servo.gap_probability
    if share < UNLIKELY:  # else the gap is below the encoder's steps or noise, whatever its odds
        odds = {word: 1 - share, "play": share}
    if not servo.log.ticks:  # whose densities compare with those of other models
        density = _servo_family(case, servo)["play"]
        models = (*models, {"none": case.rivals["none"], word: density._replace(name=word)})
        odds = model_probabilities(models, impossible_words(case))
        if odds.get(word, 0.0) <= LIKELY:
            return found
    is_small = f"a gap between motor and encoder, if there is one, is below {servo.gap.high:.3g}"
    holds = "a motor explains the readings without friction"
    if friction is not None:
        level = bracket_interval(friction.value, friction.low, friction.high, ".4g")
        spring = "" if servo.is_integrating else " and a spring"
        holds = f"a motor with friction{spring} explains the readings: {level} of the input"
    verdict = build_verdict(word, holds, is_small).add_cautions(AT_MOTOR)
    return found._replace(
        verdict=verdict,
        models=models,
        odds=odds,
        plays=None,
        friction=friction,
        element=build_servo_element(case, servo)._replace(
            kind=word, widths=dict.fromkeys(DIRECTIONS)
        ),
        delay=total_delay(case.options, servo),
    )


# --- A servo with a gap


def _compare_noisy_servo(case: Case, servo: ServoGap, found: Findings) -> Findings:
    """Return the findings on noisy readings: a servo if its density is the largest."""
    models = (*found.models, _servo_family(case, servo))
    odds = model_probabilities(models, impossible_words(case))
    best = best_model_of("play", models) is models[-1]["play"]
    likely = min(odds.get("play", 0.0), servo.gap_probability) > LIKELY
    if not (best and likely) or _depends_on_position(servo):
        return found
    if servo.is_gap_reported:
        return add_servo_element(case, servo, found)._replace(models=models, odds=odds)
    if found.verdict.word in MEMORY:  # whose gap may be known otherwise
        return found
    return _withhold_servo(servo, found)


def _depends_on_position(servo: ServoGap) -> bool:
    """Return whether the errors of a servo depend on where it is: then it is none."""
    z, errors = _errors_by_position(servo)
    columns = hat_columns(z, AT_SENSOR)
    share, chance = regress_residual(columns - columns.mean(axis=0), errors)[2:]
    return Remainder("output", share, chance, errors[:0]).is_real


def find_repetition(servo: ServoGap) -> str | None:
    """Return the finding that the errors of a servo repeat themselves along its way, or None.

    Magnets pull a motor to their places, and an eccentric gear pushes it once a turn. Of periods
    that the way holds a few times to many the likeliest is tested, by the chance that one of all
    explains as much of white errors.

    Args:
        servo: without a gap.
    """
    z, errors = _errors_by_position(servo)
    way = max(float(np.ptp(z)), 1e-300)
    rates = np.pi * np.array(HALF_PERIODS) / way
    shares = lombscargle(z, errors, rates, normalize=True, floating_mean=True)
    share = shares.max()
    chance = len(HALF_PERIODS) * math.exp(-0.5 * errors.size * share)  # of two columns
    if not Remainder("repetition", share, chance, errors[:0]).is_real:
        return None
    period = 2 * np.pi / rates[np.argmax(shares)] * servo.log.y_scale
    return (
        f"the residual of a motor repeats itself every {period:.3g} of its way "
        f"({100 * share:.0f} % of"
        " it), as cogging or an eccentric gear does: no gap is not certain. Record with a larger"
        " input"
    )


def find_input_zone(servo: ServoGap) -> str | None:
    """Return the finding that a dead zone of the input explains a motor as well as friction, or
    None.

    A valve that overlaps makes a cylinder rest as friction does, but it brakes nothing. The motor
    is fitted again without friction, behind zones of several widths.

    Args:
        servo: without a gap, with friction.
    """
    if not servo.is_integrating:
        return None
    one, log = servo.servo, servo.log.busiest_part(LONGEST)
    level = one.structure.disable_absent_parts(one.theta)[RUBS].sum()
    middle = one.theta[At.OFFSET]
    structure = one.structure._replace(parts=one.structure.parts - {"friction", "load"})
    theta = structure.disable_absent_parts(one.theta)
    theta[At.OFFSET] = 0.0
    gained = []
    for width in level * TRIED:
        zoned = log._replace(u=dead_zone(log.u + middle, width, width))
        begun = Servo(structure, theta, one.value)
        gained.append(refit(zoned, begun).value - one.value)
    if max(gained) < -NATS:
        return None
    how = "better than" if max(gained) > NATS else "as well as"
    return (
        f"a dead zone of the input, as of a valve that overlaps, explains the readings {how}"
        " friction. An integrating plant has no class of it: measure it by slow ramps of the input"
        " about rest"
    )


def _errors_by_position(servo: ServoGap) -> tuple[Floats, Floats]:
    """Return the predicted position at each error of a servo (N), and the errors (N)."""
    counted, one = servo.log.error_samples(False), servo.servo
    return servo.predict_readings(one)[0][counted], servo.normalised_errors(one)


def _servo_family(case: Case, servo: ServoGap) -> Family:
    """Return a servo and a plant without a zone, on the readings of the rival models."""
    log, none = servo.log, case.rivals["none"]
    own = np.full(case.record_data.y.size, np.nan)
    errors = servo_slopes(log, servo.servo)
    each = student.logpdf(errors.normalised, DEGREES) - errors.log_s
    own[log.error_samples(False)] = each + math.log(case.record_data.y_scale / log.y_scale)
    compared = plant.busiest_stretches(
        case.record_data._replace(y=np.arange(own.size, dtype=float))
    )
    value = own[compared.y.astype(int)]
    there = compared.ok & np.isfinite(value)
    value = np.where(there, value, none.value)
    numbers = servo.servo.structure.free_places(log.ticks, False).size
    rms = float(errors.e.std()) * log.y_scale / case.record_data.y_scale
    return {"none": none, "play": Density("play", value, numbers, rms)}


def _withhold_servo(servo: ServoGap, found: Findings, *named: str) -> Findings:
    """Return the findings if a servo's gap is not reported, with the reasons."""
    verdict = build_verdict("undecided", *named, *servo.reasons)
    return found._replace(verdict=verdict, odds={}, plays=None)


def add_servo_element(case: Case, servo: ServoGap, found: Findings) -> Findings:
    """Return the findings with a servo behind a play.

    Args:
        case: the log.
        servo: with its gap.
        found: so far.
    """
    word = "play" if servo.gap_probability > LIKELY else "undecided"
    verdict = Verdict(word, [describe_servo(servo)], [WHERE_READ, *servo.trend_remarks])
    element = build_servo_element(case, servo)
    late = total_delay(case.options, servo)
    odds = {"play": servo.gap_probability, "none": 1 - servo.gap_probability}
    return found._replace(verdict=verdict, odds=odds, element=element, delay=late)


def describe_servo(servo: ServoGap) -> str:
    """Describe the parts and the gap of a servo in words."""
    name = "a lag of first order" if servo.servo.structure.lag else "a motor"
    names = {"pole": "an electrical pole", "slow": "slow torques", "friction": "friction"}
    names |= {"spring": "a spring", "load": "friction of the load"}
    parts = [names[part] for part in sorted(servo.servo.structure.parts)]
    with_parts = f" with {', '.join(parts)}" if parts else ""
    return (
        f"{name}{with_parts} behind gear play explains the readings."
        f" Median gap over {servo.crossings.gap.size} reversals:"
        f" {servo.crossings.median_gap:.4g} (+- {2 * servo.crossings.median_error:.2g})"
    )


def build_servo_element(case: Case, servo: ServoGap) -> Element:
    """Build the element of a servo's play, with its plant without friction.

    Args:
        case: the log.
        servo: with its gap.
    """
    grid, data, one = case.grid, case.record_data, servo.servo
    u = shift_rows(grid.u[:, 0], total_delay(case.options, servo), grid.start)
    own = data._replace(
        u=u[:, None] / data.u_scale,
        y=np.where(grid.ok, grid.y / data.y_scale, 0.0),
        ok=grid.ok,
        start=grid.start,
        side=np.zeros(grid.y.size, int),
        climbs=None,
    )
    free = int(servo.is_integrating)
    order = len(_places_of_states(one))
    simulator = plant.PlantSimulator(own, order, free)
    layout = simulator.layout
    count = layout.numerators.stop
    theta = np.zeros(layout.parameter_count)
    scale = data.input_scale / data.y_scale
    theta[:count] = to_sampled_plant(servo, one.theta, scale)
    z, readings, side = servo.predict_readings(one)
    of_log, level = servo.log.y_scale / data.y_scale, float(own.y[own.ok][0])
    centre = gap_offset_interval(servo, float(grid.y[grid.ok][0]))
    rest = 0.0 if centre is None else centre.value / data.y_scale  # z = 0 at u = 0
    z, readings = z * of_log + level + rest, readings * of_log + level
    left = (own.y - readings)[own.ok]
    return Element(
        kind="play",
        fit=servo,
        simulator=simulator,
        theta=theta,
        V=covariance_of(servo, lambda numbers: to_sampled_plant(servo, numbers, scale)),
        z=z,
        readings=readings,
        side=side,
        widths=_servo_widths(case, servo, centre),
        ahead=None,
        noise=(not servo.log.ticks) * reading_noise_rms(servo.log) * of_log,
        degrees=max(servo.reversals - 1, 2),
        rms=root_mean_square(left),
        remarks=[f"z of an integrating plant has no zero of its own: {EVEN}"] if free else [],
    )


def _servo_widths(
    case: Case, servo: ServoGap, centre: Interval | None
) -> dict[str, Interval | None]:
    """Return the play's widths [y]; an output offset widens its sides and its centre."""
    width, even = servo.gap, servo.gap.scale_by(0.5)
    offset = math.inf if case.offset_prior is None else case.offset_prior * case.record_data.y_scale
    if centre is not None:
        centre = Interval.from_half_width(centre.value, math.hypot(centre.half_width, offset))
    around = centre or Interval(0.0, 0.0, 0.0)
    half = math.hypot(even.half_width, around.half_width)
    right, left = (
        Interval.from_half_width(even.value + way * around.value, half) for way in (1, -1)
    )
    return {"right": right, "left": left, "width": width, "centre": centre}


def _places_of_states(one: Servo) -> list[int]:
    """Return the places of the states of a servo's plant among z, v, d and i."""
    return [0, *[1] * (not one.structure.lag), *[3] * ("pole" in one.structure.parts)]


def to_sampled_plant(servo: ServoGap, theta: Floats, scale: float) -> Floats:
    """Return a without its integrators and b of a servo's sampled plant, without friction.

    Args:
        servo: whose structure and step count.
        theta: its numbers.
        scale: of the units of b: that of u over that of y.
    """
    one, log = servo.servo, servo.log
    A, B, _ = discretise_servo(theta[None], log.step, one.structure.lag)
    places = _places_of_states(one)
    F, b = A[0][np.ix_(places, places)], B[0, places, 0]
    numerator, whole = ss2tf(F, b[:, None], np.eye(1, b.size), np.zeros((1, 1)))
    if servo.is_integrating:
        whole = np.polydiv(whole, [1.0, -1.0])[0]
    in_units = log.y_scale / log.u_scale * scale
    return np.append(whole[1:], numerator[0, 1:] * in_units)
