"""Why a control loop swings: calibrated evidence of all its records, in one table of weights.

The odds of a record are a logistic function of its features. `python -m benchmarks loop_weights`
fits the weights to loops of known cause and writes `loop.toml`.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from scipy.special import log_softmax

from undeadzone.errors import InputError
from undeadzone.logs.kinds import kind_of
from undeadzone.util.arrays import Flags, Floats
from undeadzone.util.files import read_table
from undeadzone_identify.logs.grid import Grid, find_sample_time, to_grid
from undeadzone_identify.logs.log import Log
from undeadzone_identify.models.estimates import Interval
from undeadzone_identify.models.likelihood import root_mean_square
from undeadzone_identify.models.valve import (
    LOW,
    LoopLog,
    Sizes,
    combine_sizes,
    find_orders,
)

NAMED = 0.9  # odds from which a cause is named
CAUSES = ("sticks", "tight_tuning", "external", "none")
FEATURES = {  # what is measured of a record, with the ends beyond which it counts no more
    "ellipse": (0.0, 1.0),  # width of PV over OP, in the range of OP
    "likelihood": (-3.7, 10.0),  # of a valve that sticks or plays: arcsinh of the gain in BIC
    "sines": (-6.0, 6.0),  # the same of an oscillation from outside
    "regularity": (-2.3, 3.0),  # ln r of Thornhill
    "line": (0.0, 1.0),  # share of the error's variance that one sine has
    "sensitivity": (-0.7, 3.0),  # ln |1 / (1 + C G)| at the period
}
ALIKE = 0.5  # correlation of the evidence of two records of a valve
PER_VALVE = 3.0  # odds that one valve of known cause supports: 20 to 1 for six or seven
LEAST, MOST = 200, 8640  # samples of a part that is asked; a day at 10 s is one
LEAST_SHAPE = 0.02  # width of the ellipse, in the range of OP
PARTS = 12  # of a valve's records that are asked at most, each of at most MOST samples
REPEATED, FLOOR = 0.5, 0.25  # share of held readings, and of the usual change, of stored exceptions
# share of the steps between two changes of PV that are whole holds; from 0.45 to 0.99 the holds of
# 78 logs of loops, each held for 1, 5 and 15 samples, are the same
REGULAR = 0.9
# quantiles of PV - SP on both sides of 0 where PV meets SP; from 0.0125 to 0.05 the same 39 of 41
# records do
BOTH = (0.025, 0.975)
LEVELS, END, LOUD = 20, 0.2, 0.8  # levels of OP, its share at an end, the noise's share of PV


class Swing(NamedTuple):
    """Evidence of a record of a loop.

    Attributes:
        begin: time of its first sample [s].
        features: in the order of FEATURES.
        sizes: pairs of S and J with weights [u].
        expected: S by the ellipse [u].
        gains: in BIC of stiction and of play over none.
        period: of the swing, inf without [s].
        error: rms of PV - SP, or of PV about its mean where it does not meet SP [y].
        share: the same in units of the rms of SP, or of that mean [1].
        travel: of the stem in a day, or in 86400 samples [u].
        limits, noise: whether OP rests at an end of its range, and PV is noise or few levels.
    """

    begin: float
    features: Floats
    sizes: Sizes
    expected: float
    gains: Floats
    period: float
    error: float
    share: float
    travel: float
    limits: bool
    noise: bool

    def number(self, name: str) -> float:
        """Return an attribute or a feature."""
        own = dict(zip(FEATURES, self.features, strict=True))
        return float(own[name] if name in own else getattr(self, name))


class LoopFindings(NamedTuple):
    """What all records of a loop say of its swing.

    Attributes:
        word: stiction, input_play, tight_tuning, external, limits, noise, none or undecided.
        odds: of the causes, largest first.
        stick, jump: S and J if the valve sticks, medians over the records [u].
        swings: the evidence of each record.
        is_met: whether PV meets a recorded SP, so that both have one unit.
        exception: deviation below which the historian stores no change of PV, 0: it stores all [y].
        is_thinned: whether the historian left out readings, as the last remark says.
        remarks: on changes of the log.
    """

    word: str
    odds: dict[str, float]
    stick: Interval
    jump: Interval
    swings: tuple[Swing, ...]
    is_met: bool
    exception: float
    is_thinned: bool
    remarks: tuple[str, ...]

    def median(self, name: str) -> float:
        """Return the median of a number or a feature over the records."""
        return float(np.median([one.number(name) for one in self.swings]))


def is_named_loop(grid: Grid | Log) -> bool:
    """Return whether the input has the name of a controller's output.

    Args:
        grid: the log.
    """
    return kind_of(grid.inputs[0], grid.input_unit) == "op"


def is_loop(log: Log) -> bool:
    """Return whether a log has the names of a control loop: OP, and PV or SP.

    Args:
        log: as it was read.
    """
    is_known = log.r.shape[1] > 0 or log.output_kinds[0] == "pv"
    return is_known and len(log.outputs) == 1 and is_named_loop(log)


def find_loop_cause(logs: list[Log]) -> LoopFindings:
    """Find why a loop swings, by all its records.

    Args:
        logs: of one loop.

    Raises:
        InputError: no record is long enough, or OP rests.
    """
    hold = max(map(_samples_of_hold, logs))
    whole = [_drop_held(log, hold) for log in logs]
    logs = whole if max(log.t.size for log in whole) >= LEAST else logs
    steps = list(map(find_sample_time, logs))
    resample = None if all(regular for _, regular in steps) else float(np.median(steps, axis=0)[0])
    told = [log._replace(remarks=()) for log in logs[1:]]
    grid = to_grid([logs[0], *told], resample)
    y, exception = _undo_exceptions(grid.y, grid.ok) if hold == 1 else (grid.y, 0.0)
    is_met = _is_met(grid)
    grid = grid._replace(y=y, r=grid.r[:, : int(is_met)])
    ends = np.append(grid.start[1:], grid.t.size)
    parts = []
    for first, end in zip(grid.start.tolist(), ends.tolist(), strict=True):
        parts += [slice(begin, min(begin + MOST, end)) for begin in range(first, end, MOST)]
    usable = [part for part in parts if _is_usable(grid, part)]
    if not usable:
        raise InputError(
            f"{logs[0].source}: no record of the loop has {LEAST} samples in which OP moves"
        )
    asked = usable[:: math.ceil(len(usable) / PARTS)]
    left = f"{len(asked)} of {len(usable)} parts of at most {MOST} samples were used"
    swings = tuple(_measure_swing(grid, part) for part in asked)
    odds = combine_odds(np.array([one.features for one in swings]))
    stick, jump = combine_sizes(
        [one.sizes for one in swings], float(np.median([one.expected for one in swings]))
    )
    stored = f"holds PV for {hold} samples" if hold > 1 else ""
    if exception:
        least = np.format_float_positional(exception, 2, fractional=False, trim="-")
        stored = f"stores changes of PV above {least} only (exception deviation)"
    remarks = [*grid.remarks, *[left] * (len(asked) < len(usable))]
    if logs[0].r.size and not is_met:
        remarks.append("PV stays on one side of SP: SP has another unit, or is not followed")
    if stored:
        remarks.append(f"the historian {stored}: set it to 0 and record again")
    word = _name_cause(odds, swings, bool(exception) or (hold > 1 and logs is not whole))
    word = "undecided" if stored and word == "noise" else word
    return LoopFindings(
        word, odds, stick, jump, swings, is_met, exception, bool(stored), tuple(remarks)
    )


def _is_met(grid: Grid) -> bool:
    """Return whether PV is on both sides of SP; else units differ, or nothing follows SP."""
    away = (grid.y[:, None] - grid.r)[grid.ok]
    away = away[np.isfinite(away)]
    return bool(away.size and np.prod(np.quantile(away, BOTH)) <= 0)


def _is_usable(grid: Grid, part: slice) -> bool:
    """Return whether a part has enough readings, also in a row, and OP moves in it."""
    ok = grid.ok[part]
    is_long = int(ok.sum()) >= LEAST and LOW in find_orders(ok)
    return is_long and bool(np.ptp(grid.u[part, 0]) > 0)


def _name_cause(odds: dict[str, float], swings: tuple[Swing, ...], is_blurred: bool) -> str:
    """Return the word of a cause that is likely enough, or of what PV and OP themselves show.

    Where the historian left out the shape of the swing no cause has a name.
    """
    top, share = next(iter(odds.items()))
    word = "undecided" if share < NAMED or is_blurred else top
    if word == "sticks":
        gains = np.sum([one.gains for one in swings], axis=0)
        return "input_play" if gains[1] > gains[0] else "stiction"
    for shown in ("limits", "noise"):
        is_shown = np.mean([getattr(one, shown) for one in swings]) > 0.5
        if is_shown and word in ("none", "undecided"):
            return shown
    return word


def combine_odds(features: Floats, table: dict[str, Any] | None = None) -> dict[str, float]:
    """Return the odds of the causes by the features of all records, largest first.

    Records of one valve are alike, so that n of them count as n / (1 + (n - 1) ALIKE). Odds end at
    PER_VALVE for each valve of known cause: with the rest any other cause may be the true one.

    Args:
        features: of each record (n x F).
        table: of weights; None: those that are fitted.
    """
    table = table or load_weights()
    prior, bias, weights = (np.array(table[name]) for name in ("prior", "bias", "weights"))
    terms = log_softmax(features @ weights.T + bias, axis=1) - np.log(prior)
    count = len(features)
    total = np.log(prior) + terms.mean(axis=0) * count / (1 + (count - 1) * ALIKE)
    shares = np.exp(log_softmax(total))
    wrong = 1 / (1 + PER_VALVE * min(table["valves"]))
    shares = (1 - wrong) * shares + wrong * (1 - shares) / (len(CAUSES) - 1)
    return {CAUSES[k]: float(shares[k]) for k in np.argsort(-shares)}


@cache
def load_weights() -> dict[str, Any]:
    """Return the fitted weights with the number of valves that they rest on."""
    return read_table(__file__)


def _samples_of_hold(log: Log) -> int:
    """Return for how many samples a historian holds each reading of a log; 1: it holds none."""
    between = np.diff(np.flatnonzero(np.diff(log.y[:, 0])))
    if between.size < LEVELS:
        return 1
    usual = int(np.median(between))
    return usual if np.mean(between % usual == 0) > REGULAR else 1


def _drop_held(log: Log, hold: int) -> Log:
    """Return a log with the samples alone at which a held reading changes."""
    first = int(np.argmax(np.diff(log.y[:, 0]) != 0)) + 1
    own = slice(first % hold, None, hold)
    return log._replace(t=log.t[own], u=log.u[own], y=log.y[own], r=log.r[own])


def _undo_exceptions(y: Floats, ok: Flags) -> tuple[Floats, float]:
    """Return readings between stored exceptions on a line, and the deviation of the historian.

    Times of change are exact, held readings between them are not. The deviation is 0 where all
    readings are stored.
    """
    change = np.abs(np.diff(y[ok]))
    moved = change[change > 0]
    few = moved.size < REPEATED * change.size and moved.size > LEVELS
    if not few or np.unique(y[ok]).size < REPEATED * moved.size:
        return y, 0.0
    least = float(np.quantile(moved, 0.05))
    if least < FLOOR * np.median(moved):
        return y, 0.0
    rows = np.flatnonzero(ok)[np.append(True, change > 0)]
    return np.interp(np.arange(y.size), rows, y[rows]), least


def _measure_swing(grid: Grid, part: slice) -> Swing:
    """Return the evidence of a part of the log."""
    u, y, ok = grid.u[part, 0], grid.y[part], grid.ok[part]
    middle = float(np.mean(y[ok]))
    goal = np.nan_to_num(grid.r[part, 0], nan=middle) if grid.r.size else np.full(y.size, middle)
    log = LoopLog(u, y, ok, goal)
    fits = log.fit_all()
    none, outside, *faults = (
        fits.bic[word] for word in ("none", "external", "stiction", "input_play")
    )
    shape = ellipse_width(log)
    regularity, sensitivity = np.log(np.maximum([log.regularity, fits.sensitivity()], 1e-3))
    gains = np.arcsinh(none - np.array([min(faults), outside]))
    features = [shape, *gains, regularity, log.line, sensitivity]
    rms = root_mean_square((y - goal)[ok])
    sizes = fits.weigh_sizes()
    at_end = max(np.mean(u == u.min()), np.mean(u == u.max()))
    noise = root_mean_square(np.diff(log.y[ok])) / math.sqrt(2)
    return Swing(
        float(grid.t[part][0]),
        np.clip(features, *np.transpose([*FEATURES.values()])),
        sizes._replace(stick=sizes.stick * log.range),
        max(shape, LEAST_SHAPE) * log.range,
        none - np.array(faults),
        log.period * grid.step,
        rms,
        rms / max(root_mean_square(goal), 1e-12),
        float(np.abs(np.diff(u)).sum()) / (u.size * grid.step) * 86400,
        bool(np.unique(u).size > LEVELS and at_end > END),
        bool(noise > LOUD or np.unique(y[ok]).size < LEVELS / 2),
    )


def ellipse_width(log: LoopLog) -> float:
    """Return how wide an ellipse PV over OP is, in the direction of OP, in the range of OP [1].

    A valve that does not follow leaves PV where it was while OP moves.

    Args:
        log: the loop.
    """
    u = log.u[log.ok]
    across = float(np.mean((u - u.mean()) * log.y[log.ok]))
    return math.sqrt(8 * max(float(u.var()) - across**2, 0.0))
