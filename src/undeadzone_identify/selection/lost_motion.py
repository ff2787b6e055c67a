"""Motion lost between two positions: whether, how much, and its cause.

Asked before any plant is fitted, at the times of the readings. The answer stands if names or units
say that both columns are positions, or that one is a goal or pulses. All else is left to plants
with dynamics.
"""

from __future__ import annotations

import math
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from undeadzone.errors import FileError
from undeadzone.util.arrays import Flags, Floats
from undeadzone_identify.logs.grid import find_sample_time, printed_step
from undeadzone_identify.logs.log import Log, Options
from undeadzone_identify.models.estimates import Interval, student_quantile, variance_along
from undeadzone_identify.models.free_load import fit_free_load
from undeadzone_identify.models.least_squares import Density
from undeadzone_identify.models.lost_motion import (
    FEWEST_LATE,
    LostMotion,
    MotionFit,
    Positions,
    Structure,
    best_structure,
    is_white,
    motion_density,
    reversal_blocks,
)
from undeadzone_identify.selection.decision import LIKELY
from undeadzone_identify.selection.odds import Family, model_probabilities

FEWEST = 12  # samples that are fitted
MOST = 20_000  # samples that are fitted; of a longer log the first ones
LEAST_TURNS = 1  # reversals, below which both flanks were not seen
SMALL = 0.1  # of a gap, that the rms of coloured residuals may have
SHARE = 0.9  # of y, that a fit must explain
ASSUMED = 0.015  # of a gap behind lags, in whose place a servo has an inertia and sticks
LIKE_BEST = 3.0  # rms of the best fit, up to which another structure may be the true one
MOVING = 5  # samples before and after one that moves
GOALS = ("goal", "target", "command", "desired", "setpoint", "wanted", "demand")  # told, not read
PULSES = ("pulse", "pulses", "decguidedistance", "raguidedistance", "decduration", "raduration")
DRIVES = ("current", "torque", "effort", "load")  # of a servo, beside its goal
POSITIONS = ("position", "angle", "axis", "joint", "encoder", "motor", "link", "star", "camera")
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
    return _is_alike(log) or _has_goal(log) or _is_summed(log) or not _has_grid(log)


def _has_grid(log: Log) -> bool:
    """Return whether all times are multiples of one sample time, as the fit of a plant needs."""
    try:
        find_sample_time(log)
    except FileError:
        return False
    return True


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
    late = data.t.size >= FEWEST_LATE
    at_rest = np.zeros(1)
    straight, bent = (kinds[: 1 + late] for kinds in (STRAIGHT, BENT))
    fit, found = best_structure(data, straight)
    flat, curved = (best_structure(data, kinds, at_rest)[1] for kinds in (straight, bent))
    if curved.bic() < found.bic():
        bent_fit, bent_found = best_structure(data, bent)
        if bent_found.bic() < curved.bic():
            fit, found = bent_fit, bent_found
    is_goal, alike = _has_goal(log), _is_alike(log)
    white = is_white(found, quantum)
    others = [found]
    if not white and late and (alike or is_goal):
        fit, found, others = _add_lags(data, (fit, found))
        flat = min((MotionFit(data, found.structure).fit(at_rest), flat), key=LostMotion.bic)
    gap = _widest(fit, found, others)
    family = _family(found, flat, curved, quantum)
    free = fit_free_load(data) if _may_float(log, is_goal or is_summed, white) else None
    if free is not None:
        family = {
            word: min(one, free.rivals.get(word, one), key=attrgetter("bic"))
            for word, one in family.items()
        }
        if family["play"] is free.density:
            fit, found, gap = MotionFit(data, Structure()), free.found, free.gap
        else:
            free = None
    odds = model_probabilities([family])
    explained = 1 - found.rms**2 / max(float(np.var(data.y)), 1e-300)
    small = found.rms < SMALL * abs(found.gain) * found.gap
    white = white or free is not None  # whose motion in the gap is its own
    fits = explained > SHARE and (white or small)
    is_gap = odds["play"] > LIKELY and gap.low > 0
    word = "play" if is_gap else "none"
    vanishes = word == "none" and abs(found.gain) * gap.high < max(found.rms, quantum)
    if vanishes:  # where there is one it does not matter
        odds = {"none": 1 - odds["other"], "other": odds["other"]}
    sure = odds[word] > LIKELY
    if not fits or not sure:
        word = "unclear"
        odds = odds if fits else {}
    positions = alike or is_goal or is_summed
    stands = word != "unclear" and (positions or (is_gap and white and not _has_grid(log)))
    answer = LostMotionAnswer(
        verdict=word,
        gap=gap if is_gap else gap._replace(value=0.0, low=0.0),
        found=found,
        odds=odds,
        is_goal=is_goal,
        is_summed=is_summed,
        are_positions=positions,
        parts=None,
        reversals=int(reversal_blocks(data.u, found.gap)[-1]),
        gain_error=_gain_error(fit, found),
        log=log,
        data=data,
        quantum=quantum,
        reasons=[],
        remarks=[*log.remarks],
    )
    if free is not None:
        answer.remarks.append(FLOATS.format(100 * free.contact))
    return _described(_split(answer), explained, white), stands


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
    with np.errstate(over="ignore", under="ignore"):  # squares must be numbers, and not 0
        squares = np.ptp(u[there]) ** 2, np.ptp(y[there]) ** 2
    if not np.finfo(float).tiny < min(squares) <= max(squares) < np.inf:
        return None, False
    steps = printed_step(u[there]), printed_step(y[there])
    return Positions(t[there], u[there], y[there], *steps, _has_goal(log)), is_summed


def _is_summed(log: Log) -> bool:
    """Return whether the input is single pulses, whose sum is the position: no runs about 0."""
    u = log.u[:, 0]
    alternates = float(np.mean(u[1:] * u[:-1])) < 0.8 * float(np.mean(u**2))
    return _is_named(log.inputs[0], PULSES) and alternates


def drive_of(log: Log) -> Floats | None:
    """Return the current or torque (N) of a servo that is the second input of a log, else None."""
    if log.u.shape[1] != 2 or not _is_named(log.inputs[1], DRIVES):
        return None
    return log.u[:, 1]


def without_drive(log: Log) -> Log:
    """Return a log without the current of a servo, which drives nothing that its goal does not."""
    if drive_of(log) is None or not _has_goal(log):
        return log
    return log._replace(u=log.u[:, :1], inputs=log.inputs[:1])


def _is_named(name: str, words: tuple[str, ...]) -> bool:
    """Return whether a column's name contains one of some words."""
    plain = name.lower().replace("_", " ")
    return any(word in plain for word in words)


def _has_goal(log: Log) -> bool:
    """Return whether the input is the goal of a servo."""
    return _is_named(log.inputs[0], GOALS)


def _is_alike(log: Log) -> bool:
    """Return whether both signals are positions: of one unit, or by their names."""
    units = (log.input_unit, log.output_units[0])
    if units[0] == units[1] != "1":
        return True
    both = _is_named(log.inputs[0], (*POSITIONS, *GOALS)) and _is_named(log.outputs[0], POSITIONS)
    return units == ("1", "1") and both


def is_motor_position(log: Log) -> bool:
    """Return whether names say that a torque or current moves a position.

    Args:
        log: with one output.
    """
    plain = log.outputs[0].lower() in ("q", "theta")
    is_position = plain or _is_named(log.outputs[0], POSITIONS)
    return log.u.shape[1] == 1 and _is_named(log.inputs[0], DRIVES[:3]) and is_position


def _add_lags(
    data: Positions, best: tuple[MotionFit, LostMotion]
) -> tuple[MotionFit, LostMotion, list[LostMotion]]:
    """Return the best fit with lags as well, and all fits that may be the true one."""
    every = [best]
    for structure in LAGGING:
        one = MotionFit(data, structure)
        every.append((one, one.fit()))
    fit, found = min(every, key=lambda pair: pair[1].bic())
    like = [one for _, one in every if one.rms < LIKE_BEST * found.rms]
    return fit, found, like


def _widest(fit: MotionFit, found: LostMotion, others: list[LostMotion]) -> Interval:
    """Return the gap's interval: the best fit's, and of all that may be true as far again."""
    gap = fit.interval(found)
    gaps = [one.gap for one in others]
    more = max(gaps) - min(gaps) + (ASSUMED * gap.value if found.structure.lags else 0.0)
    low = min(gap.low, min(gaps)) - more
    return Interval(gap.value, max(low, 0.0), max(gap.high, max(gaps)) + more)


def _may_float(log: Log, has_goal: bool, white: bool) -> bool:
    """Return whether a load may float in the gap between two positions that are read."""
    alike = _is_alike(log) and not has_goal and not white
    return alike and log.t.size >= FEWEST_LATE and _has_grid(log)


def _family(found: LostMotion, flat: LostMotion, curved: LostMotion, quantum: float) -> Family:
    """Return the densities of lost motion, of none, and of a curve in its place."""
    least = quantum / math.sqrt(12)
    densities: dict[str, Density] = {}
    for word, one in (("none", flat), ("play", found), ("other", curved)):
        densities[word] = motion_density(word, one, least)
    return densities


def _gain_error(fit: MotionFit, found: LostMotion) -> float:
    """Return the standard deviation of the gain [y/u]."""
    ahead = fit.delay_and_lag(np.array([found.delay, found.lag]))
    spread = math.sqrt(float(np.sum((ahead - ahead.mean()) ** 2)))
    return max(found.colour, 1.0) ** 2 * found.rms / max(spread, 1e-300)


# --- Gap and friction of a servo, by its current


def moving_samples(y: Floats, quantum: float) -> Flags:
    """Return the samples with motion of a position in a single direction (N).

    Args:
        y: the position (N).
        quantum: of it.
    """
    change = np.zeros(y.size)
    change[MOVING:-MOVING] = y[2 * MOVING :] - y[: -2 * MOVING]
    ways = np.where(np.abs(change) > 2 * quantum, np.sign(change), 0.0)
    run = np.convolve(ways, np.ones(4 * MOVING + 1), "same")
    return np.asarray(np.abs(run) == 4 * MOVING + 1)


def _split(answer: LostMotionAnswer) -> LostMotionAnswer:
    """Return the answer with gap and friction told apart, where a servo's current is known.

    While the link moves the motor is half a gap ahead, and i = kp (u - y / R) - kp s c / 2 + i_0,
    s the way. The current alone has noise that matters, so least squares of it has no bias.
    """
    drive = drive_of(answer.log)
    if drive is None or not answer.is_goal or answer.verdict != "play":
        return answer
    there = np.isin(answer.log.t, answer.data.t)
    i, found = drive[there], answer.found
    y = (answer.data.y - found.level) / found.gain
    use = moving_samples(answer.data.y, answer.quantum) & np.isfinite(i)
    way = np.sign(np.gradient(y))[use]
    columns = np.column_stack([(answer.data.u - y)[use], way, np.ones(way.size)])
    if way.size < FEWEST or np.linalg.matrix_rank(columns) < 3:
        return answer
    kp, step, offset = np.linalg.lstsq(columns, i[use], rcond=None)[0]
    left = i[use] - columns @ np.array([kp, step, offset])
    inverse = np.linalg.inv(columns.T @ columns)
    blocks = np.cumsum(np.diff(way, prepend=way[0]) != 0)
    scores = [np.bincount(blocks, column * left) for column in columns.T]
    sums = np.column_stack(scores)
    count = len(sums)
    V = inverse @ (sums.T @ sums) @ inverse * count / max(count - 3, 1)
    V = np.maximum(V, inverse * float(left @ left) / way.size)
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
    return Interval(*(max(end, 0.0) for end in one))


# --- In words


def _described(answer: LostMotionAnswer, explained: float, white: bool) -> LostMotionAnswer:
    """Return the answer with its reasons and remarks."""
    found, reasons, remarks = answer.found, [], list(answer.remarks)
    about = f"{100 * explained:.4g} % of y by one position, {answer.reversals} reversals"
    if answer.verdict == "play":
        reasons.append(f"what turns round loses motion: {about}")
        if answer.parts is not None:
            reasons.append("gap and friction are told apart by the current of a proportional loop")
        elif answer.is_goal:
            reasons.append(
                "gap of the gears and friction of the servo (2 f / kp) lose motion alike: their sum"
                " is known. Record the current as a third column to tell them apart"
            )
    elif answer.verdict == "none":
        reasons.append(f"one position follows the other: {about}")
        remarks.append(
            "a load that holds the axis on one flank, as gravity does, hides a gap: reverse it"
        )
    else:
        reasons.append(
            f"lost motion explains {100 * max(explained, 0.0):.3g} % of y, and what it leaves"
            f" {'is noise' if white else 'depends on the past'}: nothing is named"
        )
    if answer.reversals <= LEAST_TURNS:
        remarks.append("the log turns round once or never: record more reversals")
    if found.structure.bent:
        remarks.append("the scale is not straight: a curve between both positions was fitted too")
    if found.structure.lags:
        remarks.append("the intervals hold for slow goals: a servo's dynamics count as lags")
    if answer.is_summed:
        remarks.append("the input is the sum of all pulses before a reading")
    return answer._replace(reasons=reasons, remarks=remarks)
