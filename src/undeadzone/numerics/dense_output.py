"""Solutions over a step with dense output, and steps that locate branch changes of the sensor.

On one branch of the sensor a step is smooth. If the side changes inside it, the branch is followed
up to there, so that the order survives the kink.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, Protocol, TypeVar

import casadi as ca

from undeadzone.numerics.clip import clip
from undeadzone.numerics.runge_kutta import hermite, hermite_slope, rk4

NEWTON = 4  # iterations
CHANGES = 2  # of side that are located in a step


class DenseStep(NamedTuple):
    """Solution on a branch over a step, or over the rest of a step.

    Attributes:
        end: the state at the end.
        final: z at the end.
        onward: z halfway, if it went on as it sets out.
        at: at(c) is the state at the fraction c of the solution.
        output: output(c) is z there.
        slope: slope(c) is dz/dc there.
    """

    end: ca.SX
    final: ca.SX
    onward: ca.SX
    at: Callable[[Any], ca.SX]
    output: Callable[[Any], ca.SX]
    slope: Callable[[Any], ca.SX]


def build_rk4_arcs(
    rate: Callable[[ca.SX, Any, Any], ca.SX],
    output: Callable[[ca.SX], ca.SX],
    states: int,
    h: ca.SX,
) -> Callable[[ca.SX, Any, Any], DenseStep]:
    """Return a solver for arcs of x' = rate(x, c, mode) by RK4 with cubic dense output.

    Args:
        rate: the right-hand side at the fraction c of the step, on the branch `mode`.
        output: z = output(x).
        states: entries of x.
        h: length of the step [s].

    Returns:
        arc(x, c, mode): the solution from x at the fraction c of the step to its end.
    """
    point = ca.SX.sym("x", states)
    direction = ca.SX.sym("v", states)
    along = ca.jtimes(output(point), point, direction)
    slope = ca.Function("slope", [point, direction], [along], {"allow_free": True})
    # As functions: Python takes long over each operation, and they are called often.
    names = ("x0", "dx0", "x1", "dx1", "h", "c")
    given = [ca.SX.sym(name, along.shape[0]) for name in names]
    cubic, tangent = (ca.Function("z", given, [f(*given)]) for f in (hermite, hermite_slope))

    def arc(x: ca.SX, start: Any, mode: Any) -> DenseStep:
        """Return the solution from x at the fraction `start` of the step to its end."""
        rest = 1.0 - start
        k1 = rate(x, start, mode)
        end = rk4(lambda state, c: rate(state, start + c * rest, mode), x, h * rest, k1)
        k5 = rate(end, 1.0, mode)
        z = (output(x), slope(x, k1), output(end), slope(end, k5), h * rest)
        return DenseStep(
            end=end,
            final=z[2],
            onward=output(x + h * rest / 2 * k1),
            at=partial(hermite, x, k1, end, k5, h * rest),
            output=partial(cubic, *z),
            slope=partial(tangent, *z),
        )

    return arc


def build_taylor_arcs(
    rate: Callable[[ca.SX, ca.SX, Any], ca.SX],
    output: Callable[[ca.SX], ca.SX],
    inputs: list[ca.SX],
    states: int,
    h: ca.SX,
) -> Callable[[ca.SX, Any, Any], DenseStep]:
    """Return a solver for arcs of x' = rate(x, w, mode) by Taylor series with a term for each
    input.

    Exact but for the terms left out.

    Args:
        rate: the right-hand side on the branch `mode`, affine in x and w.
        output: z = output(x), affine.
        inputs: the coefficients of w = inputs[0] + inputs[1] c + ... over the step.
        states: entries of x.
        h: length of the step [s].

    Returns:
        arc(x, c, mode): the solution from x at the fraction c of the step to its end.
    """
    x = ca.SX.sym("x", states)
    dx = ca.SX.sym("dx", states)
    w = ca.SX.sym("w", inputs[0].shape[0])
    dw = ca.SX.sym("dw", inputs[0].shape[0])
    seen = ca.Function("seen", [x, dx], [ca.jtimes(output(x), x, dx)], {"allow_free": True})

    def arc(start: ca.SX, begin: Any, mode: Any) -> DenseStep:
        """Return the solution from a state at the fraction `begin` of the step to its end."""
        rest = 1.0 - begin
        along = ca.jtimes(rate(x, w, mode), ca.vertcat(x, w), ca.vertcat(dx, dw))
        follow = ca.Function("follow", [x, w, dx, dw], [along], {"allow_free": True})
        own = inputs if isinstance(begin, float) else _shift_inputs(inputs, begin, rest)
        terms = [start, h * rest * rate(start, own[0], mode)]
        for k in range(1, len(inputs)):
            terms.append(h * rest / (k + 1) * follow(start, own[0], terms[k], own[k]))
        z = [output(start), *(seen(start, term) for term in terms[1:])]
        # State and z are the polynomials of c with these coefficients.
        end = _evaluate_polynomial(terms, 1.0)
        onward = output(start + terms[1] / 2)
        slopes = [k * term for k, term in enumerate(z)][1:]
        at, along, slope = (partial(_evaluate_polynomial, each) for each in (terms, z, slopes))
        return DenseStep(end, output(end), onward, at, along, slope)

    return arc


def _shift_inputs(inputs: list[ca.SX], begin: Any, rest: Any) -> list[ca.SX]:
    """Return the coefficients of the inputs over the rest of a step after the fraction
    `begin`.
    """
    moved = []
    for k in range(len(inputs)):
        derivative = [math.comb(j, k) * inputs[j] for j in range(k, len(inputs))]
        moved.append(rest**k * _evaluate_polynomial(derivative, begin))
    return moved


def _evaluate_polynomial(terms: list[ca.SX], c: Any) -> ca.SX:
    """Evaluate terms[0] + terms[1] c + ... by Horner's rule (at c = 1, the smallest term first)."""
    at_end = isinstance(c, float) and c == 1.0
    total = terms[-1]
    for term in terms[-2::-1]:
        total = term + (total if at_end else c * total)
    return total


class Mode(Protocol):
    """Branch of the loop, with the side that is read on the branch (per output), as `Levels`
    count.
    """

    @property
    def side(self) -> Any:
        """Return the side that is read."""
        ...


Branch = TypeVar("Branch", bound=Mode)


class Levels(NamedTuple):
    """Levels of z between the sides (p each): side k is read above k of `above` and below
    none.

    Side -k is read below k of `below`. From the lowest of `below` to the highest of `above` they
    never fall.

    Attributes:
        above: from side 0 upwards.
        below: from side 0 downwards.
    """

    above: tuple[Any, ...]
    below: tuple[Any, ...]


class Crossing(NamedTuple):
    """Change of side, per output.

    Attributes:
        changed: whether anything did.
        side: the side entered.
        level: the level that was met.
        rising: whether z rose through it.
    """

    changed: Any
    side: Any
    level: Any
    rising: Any


class StepAttempt(NamedTuple):
    """Step with a given number of side changes located.

    Attributes:
        end: the state at its end.
        more: whether there may be more changes, which the next attempt finds.
    """

    end: ca.SX
    more: ca.SX


class _StepPath(NamedTuple):
    """Step along its changes of side: its end, and its last branch, arc and change."""

    end: ca.SX
    mode: Any
    arc: DenseStep
    changed: ca.SX


class _OutputPath(NamedTuple):
    """Outputs z (p) along an arc.

    Attributes:
        start, final: z at the beginning and at the end.
        slope: dz/dc at the beginning.
        turns: whether z turns back on the way.
        turn: the fraction of the arc at which it changes, 1 if it does not change.
        peak: z at the turn, or at the end.
    """

    start: ca.SX
    final: ca.SX
    slope: ca.SX
    turns: ca.SX
    turn: ca.SX
    peak: ca.SX


def locate_side_changes(
    arc: Callable[[ca.SX, Any, Any], DenseStep],
    levels: Levels,
    first: Branch,
    second: Callable[[Branch, Crossing], Branch],
    x: ca.SX,
) -> list[StepAttempt]:
    """Return steps from x with no side change, with a simple change located, and with
    `CHANGES` changes.

    The last attempt also takes turning points of z into account. The result is the first attempt
    that needs no further one, else the last. An excursion that ends before the step does is two
    changes. Branch-free, and the first attempt costs little more than its arc.

    Args:
        arc: arc(x, c, mode) is the solution on a branch from x at the fraction c of the step.
        levels: of z between the sides.
        first: the branch at the beginning of the step, followed to the earliest change.
        second: second(mode, crossing) is the branch after a change of side.
        x: the state at the beginning of the step.

    Returns:
        The attempts, cheapest first.
    """
    whole = arc(x, 0.0, first)

    def follow(changes: int, turning: bool) -> _StepPath:
        """Follow the step with the given number of changes located in sequence."""
        mode = first
        now = whole
        end = whole.end
        begin = ca.SX(0.0)
        changed = ca.SX(0.0)
        for _ in range(changes):
            crossing, c = _find_first_crossing(now, levels, mode.side, turning)
            split = ca.mmin(c)
            at_split = ca.logic_and(crossing.changed, c <= split)
            mode = second(mode, crossing._replace(changed=at_split))
            begin = begin + (1.0 - begin) * split
            now = arc(now.at(split), begin, mode)
            changed = ca.sum1(crossing.changed) > 0
            end = ca.if_else(changed, now.end, end)
        return _StepPath(end, mode, now, changed)

    unchanged = StepAttempt(whole.end, _can_change_side(whole, levels, first.side))
    simple = follow(changes=1, turning=False)
    turns = ca.sum1(whole.slope(0.0) * whole.slope(1.0) < 0) > 0
    again = ca.logic_or(turns, _can_change_side(simple.arc, levels, simple.mode.side))
    more = ca.logic_or(ca.logic_not(simple.changed), again)
    full = follow(changes=CHANGES, turning=True)
    return [unchanged, StepAttempt(simple.end, more), StepAttempt(full.end, ca.SX(0.0))]


def _can_change_side(arc: DenseStep, levels: Levels, side: ca.SX) -> ca.SX:
    """Return whether the side may change on an arc.

    It may if it is another at the end, or would be if z went on for half of the arc as it sets
    out.
    """
    final = _is_on_other_side(arc.final, levels, side)
    onward = _is_on_other_side(arc.onward, levels, side)
    return ca.sum1(ca.logic_or(final, onward)) > 0


def _is_on_other_side(z: ca.SX, levels: Levels, side: ca.SX) -> ca.SX:
    """Return whether z lies in the range of a different side (p)."""
    other = ca.SX(0.0)
    for k, (above, below) in enumerate(zip(*levels, strict=True)):
        other = ca.logic_or(other, (z > above) != (side > k))
        other = ca.logic_or(other, (z < below) != (side < -k))
    return other


def _find_first_crossing(
    arc: DenseStep, levels: Levels, side: ca.SX, turning: bool
) -> tuple[Crossing, ca.SX]:
    """Return the first change of each output on an arc, and the fraction of the arc at the
    change.

    The fraction is 1 if there is no change. With `turning`, turning points of z are taken into
    account, else z is assumed to move one way.
    """
    course = _build_output_path(arc, turning)
    ends = _is_on_other_side(course.final, levels, side)
    returns = ca.logic_and(ca.logic_not(ends), _is_on_other_side(course.peak, levels, side))
    excursion = ca.logic_and(course.turns, returns)
    farthest = ca.if_else(excursion, course.peak, course.final)
    crossing = _find_crossing(farthest, levels, side)
    c = _solve_crossing(arc, course, crossing)
    return crossing, ca.if_else(crossing.changed, c, 1.0)


def _build_output_path(arc: DenseStep, turning: bool) -> _OutputPath:
    """Return the outputs z along an arc. Without `turning`, z is assumed to be monotone."""
    start = arc.output(0.0)
    final = arc.final
    s0 = arc.slope(0.0)
    s1 = arc.slope(1.0)
    turns = s0 * s1 < 0 if turning else ca.SX.zeros(s0.shape)
    turn = ca.if_else(turns, _find_slope_zero(arc.slope, s0, s1), 1.0)
    return _OutputPath(start, final, s0, turns, turn, arc.output(turn))


def _find_crossing(z: ca.SX, levels: Levels, side: ca.SX) -> Crossing:
    """Return the change of an output from `side` to the next side on the way to z."""
    outermost = len(levels.above)
    up = next_level(levels, side, ca.SX(1.0))
    down = next_level(levels, side, ca.SX(0.0))
    rises = ca.logic_and(side < outermost, z > up)
    falls = ca.logic_and(side > -outermost, z < down)
    way = 1.0 * rises - 1.0 * falls
    nothing_silent = levels.above[0] <= levels.below[0]
    skipped = ca.logic_and(side + way == 0, nothing_silent)
    changed = ca.logic_or(rises, falls)
    return Crossing(changed, side + way + skipped * way, ca.if_else(rises, up, down), rises)


def next_level(levels: Levels, side: ca.SX, rising: ca.SX) -> ca.SX:
    """Return the level that z meets first when leaving a side (p).

    Args:
        levels: between the sides.
        side: that z leaves (p).
        rising: whether z rises (p).
    """
    level = ca.SX(0.0)
    for k, (above, below) in enumerate(zip(*levels, strict=True)):
        of_above = ca.if_else(rising, side == k, side == k + 1)
        of_below = ca.if_else(rising, side == -k - 1, side == -k)
        level = ca.if_else(of_above, above, ca.if_else(of_below, below, level))
    return level


def _solve_crossing(arc: DenseStep, course: _OutputPath, crossing: Crossing) -> ca.SX:
    """Return the fraction of an arc at which z reaches the level, by Newton's method from a
    guess.
    """
    z0 = course.start
    z1 = course.final
    turn = course.turn
    turns = course.turns
    # z moves through the level as it does at first: ahead of the turn.
    before = (course.slope > 0) == crossing.rising
    low = ca.if_else(ca.logic_and(turns, ca.logic_not(before)), turn, 0.0)
    high = ca.if_else(ca.logic_and(turns, before), turn, 1.0)
    # Between a turn and an end z is nearly a parabola, else nearly a line.
    end = ca.if_else(before, z0, z1)
    level = crossing.level
    part = ca.sqrt(ca.fmax((course.peak - level) / (course.peak - end), 0.0))
    parabola = ca.if_else(before, turn * (1.0 - part), turn + (1.0 - turn) * part)
    line = (level - z0) / (z1 - z0)
    c = clip(ca.if_else(turns, parabola, line), low, high)
    for _ in range(NEWTON):
        c = clip(c - (arc.output(c) - level) / arc.slope(c), low, high)
    return c


def _find_slope_zero(slope: Callable[[Any], ca.SX], s0: ca.SX, s1: ca.SX) -> ca.SX:
    """Return the zero between 0 and 1 of a slope that changes its sign, by the secant method."""
    before = ca.SX.zeros(s0.shape)
    after = s0
    c = s0 / (s0 - s1)
    for _ in range(NEWTON):
        now = slope(c)
        moved = c - now * (c - before) / (now - after)
        settled = now == after
        before = c
        after = now
        c = ca.if_else(settled, c, clip(moved, 0.0, 1.0))
    return c
