"""A step that finds where the sensor changes side inside it, so that its order survives the kink."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, TypeVar

import casadi as ca

from undeadzone.numerics.dense_output import DenseStep

NEWTON = 4  # iterations
CHANGES = 2  # of side that are located in a step


class Mode(Protocol):
    """A branch of the loop, with the side that is read on it (+1, 0, -1 per output)."""

    @property
    def side(self) -> Any:
        """The side that is read."""
        ...


Branch = TypeVar("Branch", bound=Mode)


class Crossing(NamedTuple):
    """What changed, per output: whether anything did, the side entered, which level was met, in which direction."""

    changed: Any
    side: Any
    upper: Any
    rising: Any


class StepAttempt(NamedTuple):
    """The end of a step with so many changes of side located, and whether there may be more that the next attempt finds."""

    end: ca.SX
    more: ca.SX


def located_step(
    arc: Callable[[ca.SX, Any, Any], DenseStep],
    levels: tuple[ca.SX, ca.SX],
    first: Branch,
    second: Callable[[Branch, Crossing], Branch],
    x: ca.SX,
) -> list[StepAttempt]:
    """A step from x: as if no side changed, with one simple change of side located, with `CHANGES` of them and turns of z.

    The first attempt that needs no more is right, or the last. The side is right above levels[0], left below levels[1]
    of z. An arc from (x, 0) runs on the branch `first`, to the earliest change; another runs from there on second(first,
    crossing), and so on. An excursion that ends before the step does is two changes. Branch-free, and the first attempt
    costs little more than its arc.
    """
    whole = arc(x, 0.0, first)
    attempts = [StepAttempt(whole.end, _perhaps(whole, levels, first.side))]
    for changes, full in ((1, False), (CHANGES, True)):
        mode, now, begin, end, found = first, whole, ca.SX(0.0), whole.end, ca.SX(0.0)
        for _ in range(changes):
            crossing, c = _earliest(now, levels, mode.side, full)
            split = ca.mmin(c)
            mode = second(
                mode, crossing._replace(changed=ca.logic_and(crossing.changed, c <= split))
            )
            begin = begin + (1.0 - begin) * split
            now = arc(now.at(split), begin, mode)
            found = ca.sum1(crossing.changed) > 0
            end = ca.if_else(found, now.end, end)
        if full:
            more = ca.SX(0.0)
        else:
            turns = ca.sum1(whole.slope(0.0) * whole.slope(1.0) < 0) > 0
            more = ca.logic_or(
                ca.logic_not(found), ca.logic_or(turns, _perhaps(now, levels, mode.side))
            )
        attempts.append(StepAttempt(end, more))
    return attempts


def _perhaps(arc: DenseStep, levels: tuple[ca.SX, ca.SX], side: ca.SX) -> ca.SX:
    """Whether the side may change on an arc: it is another at the end, or would be if z went on as it sets out for half of it."""
    return (
        ca.sum1(ca.logic_or(_beyond(arc.final, levels, side), _beyond(arc.onward, levels, side)))
        > 0
    )


def _beyond(z: ca.SX, levels: tuple[ca.SX, ca.SX], side: ca.SX) -> ca.SX:
    """Whether z lies where another side is read."""
    above, below = levels
    return ca.logic_or((z > above) != (side > 0), (z < below) != (side < 0))


def _earliest(
    arc: DenseStep, levels: tuple[ca.SX, ca.SX], side: ca.SX, full: bool
) -> tuple[Crossing, ca.SX]:
    """The first change of each output on an arc, and the fraction of the arc at which it is; 1 where there is none.

    full: mind where z turns; else it is taken to move one way.
    """
    above, below = levels
    z0, z1, s0, s1 = arc.output(0.0), arc.final, arc.slope(0.0), arc.slope(1.0)
    turns = s0 * s1 < 0 if full else ca.SX.zeros(s0.shape)
    turn = ca.if_else(turns, _secant(arc.slope, s0, s1), 1.0)
    peak = arc.output(turn)
    ends = _beyond(z1, levels, side)
    excursion = ca.logic_and(turns, ca.logic_and(ca.logic_not(ends), _beyond(peak, levels, side)))
    far = ca.if_else(excursion, peak, z1)

    enters_right, enters_left = (
        ca.logic_and(side <= 0, far > above),
        ca.logic_and(side >= 0, far < below),
    )
    leaves_right, leaves_left = (
        ca.logic_and(side > 0, far < above),
        ca.logic_and(side < 0, far > below),
    )
    silent = side == 0
    upper = ca.logic_or(leaves_right, ca.logic_and(silent, enters_right))
    changed = ca.logic_or(upper, ca.logic_or(leaves_left, enters_left))
    rising = ca.logic_or(leaves_left, ca.logic_and(silent, enters_right))
    through = above <= below  # nothing silent lies between
    entered = 1.0 * ca.logic_or(
        ca.logic_and(silent, enters_right), ca.logic_and(leaves_left, through)
    )
    entered -= 1.0 * ca.logic_or(
        ca.logic_and(silent, enters_left), ca.logic_and(leaves_right, through)
    )

    level = ca.if_else(upper, above, below)
    before = (s0 > 0) == rising  # z moves through the level as it does at first: ahead of the turn
    low, high = (
        ca.if_else(ca.logic_and(turns, ca.logic_not(before)), turn, 0.0),
        ca.if_else(ca.logic_and(turns, before), turn, 1.0),
    )
    # Between a turn and an end z is nearly a parabola, else nearly a line.
    part = ca.sqrt(ca.fmax((peak - level) / (peak - ca.if_else(before, z0, z1)), 0.0))
    guess = ca.if_else(
        turns,
        ca.if_else(before, turn * (1.0 - part), turn + (1.0 - turn) * part),
        (level - z0) / (z1 - z0),
    )
    c = _within(guess, low, high)
    for _ in range(NEWTON):
        c = _within(c - (arc.output(c) - level) / arc.slope(c), low, high)
    return Crossing(changed, entered, upper, rising), ca.if_else(changed, c, 1.0)


def _secant(slope: Callable[[Any], ca.SX], s0: ca.SX, s1: ca.SX) -> ca.SX:
    """Where a slope that changes its sign between 0 and 1 vanishes."""
    before, after = ca.SX.zeros(s0.shape), s0
    c = s0 / (s0 - s1)
    for _ in range(NEWTON):
        now = slope(c)
        moved = c - now * (c - before) / (now - after)
        before, after, c = c, now, ca.if_else(now == after, c, _within(moved, 0.0, 1.0))
    return c


def _within(c: ca.SX, low: Any, high: Any) -> ca.SX:
    return ca.fmin(ca.fmax(c, low), high)
