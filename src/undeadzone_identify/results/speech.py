"""Account of the fits of a log: what is named, or else the likeliest number with its doubts.

A fit without the name that it would deserve still has a number. It counts if data that had no part
in the fit are simulated better with it than by a straight plant, by a paired comparison.
"""

from __future__ import annotations

import math
from itertools import compress
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import entropy

from undeadzone.util.arrays import Flags, Floats
from undeadzone.util.files import read_table
from undeadzone_identify.models.elements import FEWEST, limited_zone_map
from undeadzone_identify.models.least_squares import FittedModel
from undeadzone_identify.models.likelihood import root_mean_square
from undeadzone_identify.models.measured import measure_fit
from undeadzone_identify.results.account import (
    BOUNDED,
    INDICATED,
    NAMED,
    OPEN,
    SHOWS,
    Account,
    Buys,
    Numbers,
)
from undeadzone_identify.results.assemble import ODDS_OF, WITHHELD, Answer
from undeadzone_identify.selection.alternatives import (
    APART,
    MEASURED,
    OF_INPUT,
    fit_of,
    gain_and_spread,
    held_out_residual,
    level_of_friction,
    measure_word,
)
from undeadzone_identify.selection.decision import MEMORY, UNLIKELY, VALVE
from undeadzone_identify.selection.lost_motion import LostMotionAnswer
from undeadzone_identify.selection.widths import SIDES

DYNAMICS = "plant and nonlinearity, fitted together"
REPEATS = "the command is a sine, or nearly: more than one model follows it"
LEAST_ORDER = 3.0  # numbers of the least plant with memory: gain, lag, level
LOBE = 3  # periods in a record, below which the lobe of a line by Hann reaches a constant
NO_BETTER = "a straight plant simulates held-out readings about as well"
OTHER_END = "a band of the input, or friction, simulates held-out readings about as well"
BOTH_POSITIONS = "one position along the other"
_TABLES = read_table(__file__)
EFFECT_OF, NAMES = _TABLES["effect_of"], _TABLES["names"]
SIZES = ("width", "gap", "level")
OTHERS = 2  # effects that are printed beside the first
LOSS = "output loss"
CLOSE = 1.05  # of the rms, up to which a zone of the input simulates as well as one of the sensor
LAST, MOVES = 20, 0.1  # samples of a hold, and share of the largest reading, that show motion
EXPLAINED = 0.5  # share of the held-out readings, from which a straight plant bounds an effect


def account_of_answer(answer: Answer) -> Account:
    """Return the account of a log of one output by the fits of its plant.

    Args:
        answer: to the log.
    """
    grid = answer.case.grid
    units = (grid.input_unit, grid.output_unit)
    word = answer.verdict
    if word in WITHHELD:
        return _account_of_fits(answer, units)
    if word == "operating_point":
        limits = _find_limits(answer)
        limits.pop("output loss", None)  # whose edges were not met
        return _open(answer, units)._replace(grade=BOUNDED if limits else OPEN, limits=limits)
    effects: dict[str, Numbers] = {}
    if word in EFFECT_OF:
        effects[EFFECT_OF[word]] = _named_numbers(answer)
    if answer.found.friction is not None:
        effects["friction"] = {"level": answer.found.friction}
    element = answer.element
    if element is not None and element.input:
        known = filter(element.input.get, (*SIDES, "width"))
        effects["input loss"] = {name: element.input[name] for name in known}
    if element is not None and element.zone is not None:
        effects["output loss"] = {"width": element.zone}
    buys = _buys_of_word(answer) if answer.servo is None else None
    never = () if element is None else tuple(filter(element.lacks_edge, SIDES))
    unmet = answer.case.unreached or never
    alike = find_alike_at_input(answer)
    is_better = buys is None or buys.is_worth
    is_weak = buys is not None and not (is_better or buys.is_seen)
    limits = _find_limits(answer) if is_weak or not effects else {}
    is_real = not is_better, bool(alike), _repeats_itself(answer)
    found = Account(
        NAMED,
        effects,
        DYNAMICS,
        units,
        buys,
        unmet=unmet,
        limits=limits,
    )
    found = found.with_doubts(*compress((NO_BETTER, OTHER_END, REPEATS), is_real))
    if is_weak:
        return found._replace(grade=BOUNDED, effects={}, buys=None, others=effects)
    if not found.doubts:
        return found._replace(name=NAMES[word])
    others = {EFFECT_OF[one.word]: one.numbers for one in alike}
    return found._replace(grade=(BOUNDED, INDICATED)[bool(effects)], others=others)


def _repeats_itself(answer: Answer) -> bool:
    """Return whether the input excites less than any plant and an element need.

    A plant with k numbers needs an input that is persistently exciting of order k. The least plant
    with memory has three: gain, lag and level. A sine is so of order 2, whatever its length. A
    servo's gap is seen where it is crossed.
    """
    if answer.servo is not None and answer.verdict in MEMORY:
        return False
    return sum(map(order_of_excitation, answer.case.grid.u.T)) < LEAST_ORDER


def order_of_excitation(u: Floats) -> float:
    """Return the effective order to which an input is persistently exciting.

    It is the effective rank of the input's covariance: the number of spectral lines, by the entropy
    of the power in them, and two for each. Hann's window alone makes 2.38 lines of one. A line of
    few periods does not count: the order is infinite, as the record ends before it repeats.

    Args:
        u: input (N).

    References:
        J. C. Willems, P. Rapisarda, I. Markovsky, B. De Moor (2005),
        doi:10.1016/j.sysconle.2004.09.003
        O. Roy, M. Vetterli (2007), effective rank
    """
    line = np.square([0.5, 1.0, 0.5])
    power = np.abs(np.fft.rfft((u - u.mean()) * np.hanning(u.size))) ** 2
    order = 2 * np.exp(entropy(power) - entropy(line))
    return float(order) if np.argmax(power) >= LOBE else math.inf


def account_of_motion(motion: LostMotionAnswer) -> Account:
    """Return the account of the motion that is lost between two positions.

    Args:
        motion: the answer to a log of two positions.
    """
    units = (motion.log.input_unit, motion.log.output_units[0])
    found = Account(NAMED, {}, BOTH_POSITIONS, units)
    if motion.verdict == "play":
        numbers, name = {"gap": motion.gap}, NAMES["play"]
        if motion.parts is not None:
            numbers = {"gap": motion.parts.gap, "friction": motion.parts.friction}
        elif motion.is_goal:
            name = "Lost motion, gap and friction together"
        return found._replace(effects={"input reversal": numbers}, name=name)
    if motion.verdict == "none":
        return found._replace(grade=BOUNDED, limits={"input reversal": motion.gap.high})
    return found._replace(grade=OPEN, doubts=tuple(motion.reasons))


def _open(answer: Answer, units: tuple[str, str]) -> Account:
    """Return the account without a number, with the reasons and what remains possible."""
    words = [word for word in answer.found.odds if word in EFFECT_OF][:OTHERS]
    others: dict[str, Numbers] = {EFFECT_OF[word]: {} for word in words}
    return Account(
        OPEN,
        {},
        DYNAMICS,
        units,
        others=others,
        doubts=tuple(answer.reasons),
    )


def find_alike_at_input(answer: Answer) -> list[Compared]:
    """Return the elements of the input that simulate as well as a zone of the sensor, if named."""
    named = _compare(answer, answer.verdict) if EFFECT_OF.get(answer.verdict) == LOSS else None
    if named is None:
        return []
    return [
        other
        for word in ("input_zone", "friction")
        if (other := _compare(answer, word, named.error.size)) is not None
        and other.rms < CLOSE * named.rms
        and named.deviations_before(other) < APART
    ]


def _named_numbers(answer: Answer) -> Numbers:
    """Return the numbers of a named class: both sides and the width, a gap, or those of a loop."""
    word = answer.verdict
    if word == "saturation":
        fit = fit_of(answer.case, answer.found, word)
        return {} if fit is None else _find_ends(fit, answer.scale)
    names = (*SIDES, "width")
    there = {name: getattr(answer, name) for name in names if getattr(answer, name) is not None}
    if word in (*MEMORY, *VALVE):
        there = {"gap": there["width"]} if "width" in there else {}
    return there


class Compared(NamedTuple):
    """Model of a class, compared on data that had no part in its fit.

    Attributes:
        word: of the class.
        fit: with all data.
        error: of the held-out readings, 0 elsewhere (N), scaled.
        test: those readings (N).
        numbers: in the unit of their end.
    """

    word: str
    fit: FittedModel[Any]
    error: Floats
    test: Flags
    numbers: Numbers

    @property
    def rms(self) -> float:
        """Return the rms of the held-out errors, scaled, but for a common factor."""
        return root_mean_square(self.error)

    def deviations_before(self, other: Compared) -> float:
        """Return by how many standard deviations it is better than another model."""
        gain, spread = gain_and_spread(self.error, other.error)
        return gain / max(spread, 1e-300)

    def is_hardly_before(self, other: Compared) -> bool:
        """Return whether another model simulates held-out data about as well."""
        return self.deviations_before(other) < APART and SHOWS * other.rms < self.rms

    def is_curve_for_zone(self, other: Compared) -> bool:
        """Return whether it is a curve where another model has a zone with a single side."""
        ends = [EFFECT_OF[one.word].split()[0] for one in (self, other)]
        is_curve = EFFECT_OF[self.word].endswith("shape") and ends[0] == ends[1]
        return is_curve and len({*SIDES} & other.numbers.keys()) == 1

    def compare_to(self, line: Compared, scale: float) -> Buys:
        """Return the held-out errors of both, in units of the log."""
        size = scale * math.sqrt(self.test.size / max(self.test.sum(), 1))
        return Buys(line.rms * size, self.rms * size, self.deviations_before(line))

    @property
    def is_positive(self) -> bool:
        """Return whether no number of it may be 0, and no edge lies on the other side."""
        sides = [one.high > 0 for name, one in self.numbers.items() if name in SIDES]
        sizes = [self.numbers[name].low > 0 for name in SIZES if name in self.numbers]
        return all(sides) and all(sizes)


def _compare(answer: Answer, word: str, readings: int | None = None) -> Compared | None:
    """Return a class's model on held-out data; None without a fit of it to the same readings.

    Args:
        answer: with the fits.
        word: of the class.
        readings: number of samples that the fit has; None: any.
    """
    fit = fit_of(answer.case, answer.found, ODDS_OF.get(word, word), readings)
    if fit is None:
        return None
    e, test = held_out_residual(fit, answer.case.options.held_out)
    return Compared(
        word,
        fit,
        np.where(test, e, 0.0),
        test,
        _numbers_of_word(answer, word, fit),
    )


def _numbers_of_word(answer: Answer, word: str, fit: FittedModel[Any]) -> Numbers:
    """Return the numbers of a class that is not named, in the unit of its end."""
    if word == "saturation":
        return _find_ends(fit, answer.scale)
    if word not in MEASURED:
        return {}
    measured = measure_word(answer.case, fit, word)[0]
    known = {name: one for name, one in measured.items() if one is not None and name != "centre"}
    if word == "friction":
        level = level_of_friction(measured)
        return {} if level is None else {"level": level}
    if word in MEMORY or word == "input_play":
        return {"gap": known["width"]}
    unmet = _unmet_sides(answer, word, known)
    unknown = unmet | ({"width"} if unmet else set())
    return {name: one for name, one in known.items() if name not in unknown}


def _find_ends(fit: FittedModel[Any], scale: float) -> Numbers:
    """Return the limits of the readings that a fit to a saturation reaches [y]."""
    read = fit.model.noise_free_readings(fit.model.output(fit.theta), fit.theta)
    ends = measure_fit(fit, levels=lambda theta: theta[-2:]).scale_by(scale)  # behind a zone, too
    known = {"upper": ends["right"], "lower": ends["left"].scale_by(-1)}
    reached = zip(known, (read.max(), read.min()), strict=True)
    return {name: known[name] for name, end in reached if np.count_nonzero(read == end) >= FEWEST}


def _unmet_sides(answer: Answer, word: str, widths: Numbers) -> set[str]:
    """Return the sides of a zone beyond whose edges the log never was."""
    samples = dict(zip(SIDES, answer.excitation.samples, strict=True))
    if word in OF_INPUT:
        u = answer.case.grid.u[:, 0]
        for name, beyond in zip(SIDES, (u, -u), strict=True):
            edge = widths.get(name)
            samples[name] = 0 if edge is None else int(np.count_nonzero(beyond > edge.value))
    return {name for name, count in samples.items() if count < FEWEST}


def _buys_of_word(answer: Answer) -> Buys | None:
    """Return the held-out errors of the named class and of a straight plant; None if unknown."""
    if answer.verdict in ("none", "saturation"):
        return None
    named = _compare(answer, answer.verdict)
    if named is None or (line := _compare(answer, "none", named.error.size)) is None:
        return None
    return named.compare_to(line, answer.scale)


def _account_of_fits(answer: Answer, units: tuple[str, str]) -> Account:
    """Return the likeliest effect as an indication, else bounds where a straight plant holds."""
    line = _compare(answer, "none")
    if line is None:
        return _open(answer, units)
    there = (_compare(answer, word) for word in EFFECT_OF if word not in answer.found.denied)
    counting = [one for one in there if one is not None and _counts(answer, one, line)]
    if not counting:
        return _bound(answer, units, line)
    best, *_ = counting = sorted(counting, key=lambda one: one.rms)
    close = [one for one in counting if best.is_hardly_before(one)]
    first = next((one for one in close if one.numbers and not best.is_curve_for_zone(one)), best)
    others: dict[str, Numbers] = {}
    for one in close:
        effect = EFFECT_OF[one.word]
        if effect != EFFECT_OF[first.word] and len(others) < OTHERS:
            others.setdefault(effect, one.numbers)
    effects = {EFFECT_OF[first.word]: first.numbers}
    gain = first.compare_to(line, answer.scale)
    return Account(
        INDICATED,
        effects,
        DYNAMICS,
        units,
        gain,
        others,
        tuple(answer.reasons),
    )


def _counts(answer: Answer, one: Compared, line: Compared) -> bool:
    """Return whether a model is worth its number: by held-out data, or by odds without a line.

    It has the readings of the straight plant, and one element alone: a class may be fitted to a
    part.
    """
    is_double = getattr(one.fit.model, "shape", None) is limited_zone_map
    if is_double or one.error.size != line.error.size or not one.is_positive:
        return False
    own, odds = one.compare_to(line, answer.scale), answer.found.odds
    is_likely = odds.get("none", 1.0) < UNLIKELY < odds.get(one.word, 0.0)
    is_worth = own.is_seen and (own.is_worth or is_likely)
    return is_worth and not _moves_below_friction(answer, one)


def _moves_below_friction(answer: Answer, one: Compared) -> bool:
    """Return whether holds of commands below a friction's level end in motion, twice or more."""
    u, y = answer.case.grid.u[:, 0], answer.case.grid.y
    cut = np.flatnonzero(np.diff(u, append=np.nan))
    held = cut[np.diff(cut, prepend=-1) > LAST]
    level = one.numbers["level"].value if "level" in one.numbers else 0.0
    moves = np.abs(y[held]) > MOVES * np.abs(y).max()
    return int(np.sum(moves & (np.abs(u[held]) < level))) > 1


def _bound(answer: Answer, units: tuple[str, str], line: Compared) -> Account:
    """Return bounds of what could hide where a straight plant explains the log, else nothing."""
    y = line.fit.squares.data.y[line.test]
    left = line.error[line.test].std() / (y.std() or 1e-300)
    found = _open(answer, units)
    if left > 1 - EXPLAINED or any(one.is_real for one in answer.found.remainders):
        said = f"the input explains {100 * max(1 - left, 0.0):.0f} % of the held-out readings"
        return found.with_doubts(said)
    limits = _find_limits(answer)
    return found._replace(grade=BOUNDED if limits else OPEN, others={}, limits=limits)


def _find_limits(answer: Answer) -> dict[str, float]:
    """Return the upper ends of the intervals of all classes that were fitted, by effect."""
    limits: dict[str, float] = {}
    for word in ("input_zone", "input_play", "dead_zone", "play"):
        fit = fit_of(answer.case, answer.found, word)
        if fit is None or word in answer.found.denied:
            continue
        numbers = _numbers_of_word(answer, word, fit)
        widest = numbers.get("width", numbers.get("gap"))
        if widest is not None and 0 < (top := widest.high - min(widest.value, 0.0)) < math.inf:
            limits[EFFECT_OF[word]] = float(top)
    return limits
