"""Motion lost between two positions: whether, how much, and its cause.

Asked before any plant is fitted, at the times of the readings. The answer stands if names or units
say that both columns are positions, or that one is a goal or pulses, or if play alone, without
dynamics, leaves noise. All else is left to plants with dynamics. A goal that is held says nothing
while the axis is on its way: only the readings at rest are fitted. Fewer than `TURNS` reversals
give no number.
"""

from __future__ import annotations

import math
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from undeadzone.logs.kinds import split_words
from undeadzone.util.arrays import Flags, Floats
from undeadzone_identify.logs.grid import find_sample_time, printed_step
from undeadzone_identify.logs.log import Log, Options
from undeadzone_identify.looks.rows import rows_at_rest
from undeadzone_identify.models.estimates import (
    Interval,
    student_quantile,
    variance_along,
)
from undeadzone_identify.models.free_load import fit_free_load
from undeadzone_identify.models.least_squares import regression_residual
from undeadzone_identify.models.lost_motion import (
    FEWEST_LATE,
    HELD,
    LostMotion,
    MotionFit,
    Positions,
    Structure,
    best_structure,
    fit_plant,
    is_white,
    motion_density,
    reversal_blocks,
)
from undeadzone_identify.selection.decision import LIKELY
from undeadzone_identify.selection.odds import model_probabilities

FEWEST = 12  # samples that are fitted
MOST = 20_000  # samples that are fitted; of a longer log the first ones
TURNS = 3  # reversals, below which a lag, a zone and a gap look alike
HOLD = 6  # samples at one goal, from which it is held
PASTS = (2, 4, 8)  # samples after which the response of a plant ends that may be taken for play
CERTAIN = 0.99  # odds of play between signals that no name calls positions
ROWS = 8  # readings at rest that are fitted
PLACES = 3  # different goals at which they are
SMALL = 0.1  # of a gap, that the rms of coloured residuals may have
SHARE = 0.9  # of y, that a fit must explain
ASSUMED = 0.015  # of a gap behind lags, in whose place a servo has an inertia and sticks
LIKE_BEST = 3.0  # rms of the best fit, up to which another structure may be the true one
MOVING = 5  # samples before and after one that moves
PULSES = ("pulse", "guide distance", "guidedistance", "duration")
FLOATS = (
    "the load floats in its gap: it is at a flank in {:.0f} % of the samples, and strikes the other"
    " by its own motion. Lines that move the motor across at each turn help only if it is held"
)
STRAIGHT = (Structure(), Structure(late=True))
BENT = (Structure(bent=True), Structure(bent=True, late=True))
LAGGING = (Structure(lags=1, late=True), Structure(lags=2, late=True))


class Share(NamedTuple):
    """Parts of a servo's lost motion, separated by its current.

    Attributes:
        gap: of its gears [u].
        friction: 2 f / kp, the way between two stops of the motor by friction [u].
        stiffness: kp, current by position error [drive/u].
    """

    gap: Interval
    friction: Interval
    stiffness: float


class LostMotionAnswer(NamedTuple):
    """Answer to a log of two positions.

    Attributes:
        verdict: play, none or unclear.
        gap: motion lost at a reversal, with its 95 % interval [u].
        found: the fit that is shown.
        odds: of play, none and other.
        is_goal: whether u is a goal, so that friction of a servo counts in.
        is_summed: whether u is the sum of pulses.
        are_positions: whether names or units say that both signals are positions.
        is_at_rest: whether only the readings at rest are fitted.
        parts: gap and friction, where a current tells them apart.
        reversals: of u.
        gain_error: standard deviation of the gain [y/u].
        log: which log.
        data: the positions.
        quantum: of y [y].
        reasons: in words.
        remarks: cautions.
    """

    verdict: str
    gap: Interval
    found: LostMotion
    odds: dict[str, float]
    is_goal: bool
    is_summed: bool
    are_positions: bool
    is_at_rest: bool
    parts: Share | None
    reversals: int
    gain_error: float
    log: Log
    data: Positions
    quantum: float
    reasons: list[str]
    remarks: list[str]


def needs_motion_test(log: Log) -> bool:
    """Return whether the motion lost between two positions may be the answer to a log.

    Args:
        log: with one output.
    """
    named = _is_alike(log) or _has_goal(log) or _is_summed(log) or not find_sample_time(log)[1]
    return named or _follows(log)


def _follows(log: Log) -> bool:
    """Return whether the output of a log is nearly a straight line of its input, at once."""
    rows = np.column_stack([log.u[:, 0], log.y[:, 0]])
    there = rows[np.isfinite(rows).all(axis=1)]
    return bool(np.ptp(there, axis=0).all() and np.corrcoef(there.T)[0, 1] ** 2 > SHARE)


def find_lost_motion(log: Log, options: Options) -> tuple[LostMotionAnswer | None, bool]:
    """Fit lost motion to two positions of a log.

    Args:
        log: with one output and one input; a second one is a servo's current or torque.
        options: of the user.

    Returns:
        The answer, None if nothing can be fitted, and whether it stands before plants are tried.
    """
    data, is_summed = positions_of(log, options)
    if data is None:
        return None, False
    quantum = data.quantum
    is_goal, alike = _has_goal(log), _is_alike(log)
    moving, data = data, _at_rest(data) if is_goal else data
    is_at_rest = data is not moving
    late = data.t.size >= FEWEST_LATE
    no_gap = np.zeros(1)
    straight, bent = (kinds[: 1 + late] for kinds in (STRAIGHT, BENT))
    found = best_structure(data, straight)
    flat, curved = (best_structure(data, kinds, no_gap) for kinds in (straight, bent))
    if curved.bic() < found.bic():
        found = min(found, best_structure(data, bent), key=LostMotion.bic)
    white = _is_noise(data, found)
    others = [found]
    if not white and late and (alike or is_goal):
        tried = [found, *(MotionFit(data, structure).fit() for structure in LAGGING)]
        found = min(tried, key=LostMotion.bic)
        others = [one for one in tried if one.rms < LIKE_BEST * found.rms]
        flat = min(best_structure(data, [found.structure], no_gap), flat, key=LostMotion.bic)
    positions = alike or is_goal or is_summed
    if not positions:  # what no name calls two positions may be any plant
        plants = [fit_plant(data, found, range(past)) for past in PASTS]
        flat = min(flat, *plants, key=LostMotion.bic)
    gap = _widest(data, found, others)
    least = quantum / math.sqrt(12)
    every = {"none": flat, "play": found, "other": curved}
    family = {word: motion_density(word, one, least) for word, one in every.items()}
    free = fit_free_load(data) if _may_float(log, is_goal or is_summed, white) else None
    if free is not None:
        family = {
            word: min(one, free.rivals.get(word, one), key=attrgetter("bic"))
            for word, one in family.items()
        }
        free = free if family["play"] is free.rivals["play"] else None
    if free is not None:
        found, gap, white = free.found, free.gap, True  # its motion in the gap is its own
    odds = model_probabilities([family])
    explained = 1 - found.rms**2 / max(float(np.var(data.y)), 1e-300)
    small = found.rms < SMALL * abs(found.gain) * found.gap
    fits = explained > SHARE and (white or small)
    reversals = int(reversal_blocks(data.u, found.gap)[-1])
    if reversals < TURNS:
        fits, gap = False, Interval(0.0, 0.0, float(np.ptp(data.u)))
    is_gap = odds["play"] > LIKELY and gap.low > 0
    word = "play" if is_gap else "none"
    least = max(found.rms, quantum)
    vanishes = word == "none" and abs(found.gain) * gap.high < least + 1e-6 * quantum
    if vanishes:  # where there is one it does not matter
        odds = {"none": 1 - odds["other"], "other": odds["other"]}
    sure = odds[word] > LIKELY
    if not fits or not sure:
        word = "unclear"
        odds = odds if fits else {}
    alone = found.structure == Structure() or not find_sample_time(log)[1]
    certain = white and alone and is_gap and odds.get("play", 0.0) > CERTAIN
    stands = word != "unclear" and (positions or certain)
    answer = LostMotionAnswer(
        verdict=word,
        gap=gap if is_gap else gap._replace(value=0.0, low=0.0),
        found=found,
        odds=odds,
        is_goal=is_goal,
        is_summed=is_summed,
        are_positions=positions,
        is_at_rest=is_at_rest,
        parts=None,
        reversals=reversals,
        gain_error=_gain_error(data, found),
        log=log,
        data=data,
        quantum=quantum,
        reasons=[],
        remarks=[*log.remarks],
    )
    if free is not None:
        answer.remarks.append(FLOATS.format(100 * free.contact))
    return _described(_split(answer), explained, white), stands


def _at_rest(data: Positions) -> Positions:
    """Return the readings at rest where a goal is held, in order; all where it never rests."""
    change = np.flatnonzero(np.diff(data.u, prepend=np.nan, append=np.nan))
    held = np.repeat(np.diff(change) >= HOLD, np.diff(change))
    rows = rows_at_rest(data.t[held], data.u[held], data.y[held], PLACES)
    if rows is None or rows.how != "holds" or rows.u.size < ROWS:
        return data
    times = np.linspace(data.t[0], data.t[-1], rows.u.size)
    return data._replace(t=times, u=rows.u, y=rows.y)


def _is_noise(data: Positions, found: LostMotion) -> bool:
    """Return whether a fit leaves noise, also while u is still: moves hide what depends on rest."""
    still = np.diff(data.u, prepend=np.nan) == 0
    quiet = found._replace(residual=found.residual[still])
    return is_white(found, data.quantum) and (still.mean() < HELD or is_white(quiet, data.quantum))


def positions_of(log: Log, options: Options) -> tuple[Positions | None, bool]:
    """Return two positions, and whether the first is a sum of pulses; None for other logs.

    Args:
        log: with one output.
        options: of the user.
    """
    plain = options.kind in ("auto", "play") and options.place == "auto" and not options.integrators
    has_options = options.right or options.left or options.resample or options.delay != "auto"
    inputs = log.u.shape[1]
    if not plain or has_options or inputs > 2 or (inputs == 2 and drive_of(log) is None):
        return None, False
    t, u, y = log.t, log.u[:, 0], log.y[:, 0]
    is_summed = _is_summed(log)
    if is_summed:  # what was told after a reading moves the next one
        u = np.append(0.0, np.cumsum(u)[:-1])
    there = np.isfinite(u) & np.isfinite(y)
    there[np.cumsum(there) > MOST] = False
    if there.sum() < FEWEST:
        return None, False
    ranges = np.ptp(u[there]), np.ptp(y[there])
    if not 1e-150 < min(ranges) <= max(ranges) < 1e150:  # squares must be numbers, and not 0
        return None, False
    steps = printed_step(u[there]), printed_step(y[there])
    return Positions(t[there], u[there], y[there], *steps, _has_goal(log)), is_summed


def _is_summed(log: Log) -> bool:
    """Return whether the input is single pulses, whose sum is the position: no runs about 0."""
    u = log.u[:, 0]
    alternates = float(np.mean(u[1:] * u[:-1])) < 0.8 * float(np.mean(u**2))
    name = split_words(log.inputs[0])
    return alternates and any(word in name for word in PULSES)


def drive_of(log: Log) -> Floats | None:
    """Return the current or torque (N) of a servo that is the second input of a log, else None."""
    return log.u[:, 1] if log.input_kinds[1:] == ("torque",) else None


def without_drive(log: Log) -> Log:
    """Return a log without the current of a servo, which drives nothing that its goal does not."""
    if drive_of(log) is None or not _has_goal(log):
        return log
    return log._replace(u=log.u[:, :1], inputs=log.inputs[:1])


def _has_goal(log: Log) -> bool:
    """Return whether the input is the goal of a servo."""
    return log.input_kinds[0] in ("goal", "sp") and log.output_kinds[0] != "speed"


def _is_alike(log: Log) -> bool:
    """Return whether both signals are positions: of one unit, or by their names."""
    units = (log.input_unit, log.output_units[0])
    kinds = {log.input_kinds[0], log.output_kinds[0]}
    if units[0] == units[1] != "1":
        return not kinds & {"speed", "torque"}
    return units == ("1", "1") and kinds <= {"goal", "position"} and "position" in kinds


def is_motor_position(log: Log) -> bool:
    """Return whether names say that a torque or current moves a position.

    Args:
        log: with one output.
    """
    return log.input_kinds == ("torque",) and log.output_kinds == ("position",)


def _widest(data: Positions, found: LostMotion, others: list[LostMotion]) -> Interval:
    """Return the gap's interval: the best fit's, and of all that may be true as far again."""
    gap = MotionFit(data, found.structure).interval(found)
    gaps = [one.gap for one in others]
    more = max(gaps) - min(gaps) + (ASSUMED * gap.value if found.structure.lags else 0.0)
    low = min(gap.low, min(gaps)) - more
    return Interval(gap.value, max(low, 0.0), max(gap.high, max(gaps)) + more)


def _may_float(log: Log, has_goal: bool, white: bool) -> bool:
    """Return whether a load may float in the gap between two positions that are read."""
    alike = _is_alike(log) and not has_goal and not white
    return alike and log.t.size >= FEWEST_LATE and find_sample_time(log)[1]


def _gain_error(data: Positions, found: LostMotion) -> float:
    """Return the standard deviation of the gain [y/u]."""
    fit = MotionFit(data, found.structure)
    ahead = fit.delay_and_lag(np.array([found.delay, found.lag]))
    spread = float(ahead.std()) * math.sqrt(ahead.size)
    return max(found.colour, 1.0) ** 2 * found.rms / max(spread, 1e-300)


# --- Gap and friction of a servo, by its current


def moving_samples(y: Floats, quantum: float) -> Flags:
    """Return the samples amid steady motion of a position, forwards or backwards (N).

    Args:
        y: the position (N).
        quantum: of it.
    """
    change = np.zeros(y.size)
    change[MOVING:-MOVING] = y[2 * MOVING :] - y[: -2 * MOVING]
    ways = np.where(np.abs(change) > 2 * quantum, np.sign(change), 0.0)
    run = np.convolve(ways, np.ones(4 * MOVING + 1), "same")
    return np.abs(run) == 4 * MOVING + 1


def _split(answer: LostMotionAnswer) -> LostMotionAnswer:
    """Return the answer with gap and friction told apart, where a servo's current is known.

    While the link moves the motor is half a gap ahead, and i = kp (u - y / R) - kp s c / 2 + i_0,
    s the way. The current alone has noise that matters, so least squares of it has no bias.
    """
    drive = drive_of(answer.log)
    if drive is None or answer.is_at_rest or not answer.is_goal or answer.verdict != "play":
        return answer
    there = np.isin(answer.log.t, answer.data.t)
    i, found = drive[there], answer.found
    y = (answer.data.y - found.level) / found.gain
    use = moving_samples(answer.data.y, answer.quantum) & np.isfinite(i)
    way = np.sign(np.gradient(y))[use]
    columns = np.column_stack([(answer.data.u - y)[use], way, np.ones(way.size)])
    if way.size < FEWEST or np.linalg.matrix_rank(columns) < 3:
        return answer
    (kp, step, _), (power,) = np.linalg.lstsq(columns, i[use], rcond=None)[:2]
    left = regression_residual(columns, i[use])
    inverse = np.linalg.inv(columns.T @ columns)
    turns = np.flatnonzero(np.diff(way, prepend=np.nan))
    sums = np.add.reduceat((columns @ inverse) * left[:, None], turns)
    count = turns.size
    V = sums.T @ sums * count / max(count - 3, 1)
    V = np.maximum(V, inverse * power / way.size)
    if kp <= 3 * math.sqrt(V[0, 0]):
        return answer
    slope = np.array([2 * step / kp**2, -2 / kp, 0.0])
    half = student_quantile(max(count - 3.0, 2.0)) * math.sqrt(variance_along(V, slope))
    gap = Interval.from_half_width(float(-2 * step / kp), half)
    total = answer.gap
    around = max(total.high - total.value, total.value - total.low)
    rest = Interval.from_half_width(total.value - gap.value, math.hypot(half, around))
    return answer._replace(parts=Share(_not_negative(gap), _not_negative(rest), float(kp)))


def _not_negative(one: Interval) -> Interval:
    """Return an interval cut at 0."""
    return Interval(*np.maximum(one, 0.0).tolist())


# --- In words


def _described(answer: LostMotionAnswer, explained: float, white: bool) -> LostMotionAnswer:
    """Return the answer with its reasons and remarks."""
    found, reasons, remarks = answer.found, [], list(answer.remarks)
    about = f"{100 * explained:.4g} % of y by one position, {answer.reversals} reversals"
    if answer.is_at_rest:
        about += f", by the {answer.data.t.size} readings at rest"
    if answer.reversals < TURNS:
        reasons.append(
            f"the log turns round {answer.reversals} times: below {TURNS} reversals lost motion, a"
            " lag and a zone look alike"
        )
    elif answer.verdict == "play":
        reasons.append(f"what turns round loses motion: {about}")
        if answer.parts is not None:
            reasons.append("gap and friction are separated by the current of a proportional loop")
        elif answer.is_goal:
            reasons.append(
                "gap of the gears and friction of the servo (2 f / kp) lose motion alike: their sum"
                " is known. Record the current as a third column to separate them"
            )
    elif answer.verdict == "none":
        reasons.append(f"one position follows the other: {about}")
        remarks.append(
            "a load that holds the axis on one flank, as gravity does, hides a gap: reverse it"
        )
    else:
        reasons.append(
            f"lost motion explains {100 * max(explained, 0.0):.3g} % of y, and its residual"
            f" {'is noise' if white else 'depends on the past'}: nothing is named"
        )
    if found.structure.bent:
        remarks.append("the scale is not straight: a curve between both positions was fitted too")
    if found.structure.lags:
        remarks.append("the intervals hold for slow goals: a servo's dynamics count as lags")
    if answer.is_summed:
        remarks.append("the input is the sum of all pulses before a reading")
    return answer._replace(reasons=reasons, remarks=remarks)
