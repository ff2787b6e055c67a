"""One step of the loop in continuous time.

It is plain Runge-Kutta, or has its changes of side located inside the step.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca

from undeadzone.errors import InputError
from undeadzone.numerics.dense_output import (
    Crossing,
    DenseStep,
    Levels,
    StepAttempt,
    located_step,
    met,
    runge_kutta,
    taylor,
)
from undeadzone.numerics.runge_kutta import rk4
from undeadzone.simulation.loop import HELD, RUNGE_KUTTA, Exogenous, State
from undeadzone.simulation.wiring import Mode, Wiring
from undeadzone.support import tree


def plain_step(
    wiring: Wiring, like: State, instant: Exogenous, start: ca.SX, columns: list[ca.SX]
) -> ca.SX:
    """The state after an RK4 step that takes the side at each stage anew; noise is held.

    Its error is of order h^2 where the side changes.

    Args:
        wiring: the parts of the loop.
        like: a state of the right shapes.
        instant: exogenous inputs of the right shapes.
        start: the state at the step's start, as a column.
        columns: the exogenous inputs at the step's start, middle and end.
    """

    def rate(column: ca.SX, c: float) -> ca.SX:
        admissible = column if column is start else wiring.admissible(like, column)
        s = tree.unpack(like, admissible)
        w = wiring.exogenous(instant, exogenous_at(columns, c, wiring.plant.p))
        return tree.stack(wiring.move(s, w, wiring.mode(s, w))[0])

    return wiring.admissible(like, rk4(rate, start, wiring.p.h))


def exogenous_at(columns: list[ca.SX], c: Any, p: int) -> ca.SX:
    """The exogenous inputs at a fraction of the step: quadratic, but for those that are held.

    Args:
        columns: the inputs at the step's start, middle and end.
        c: the fraction: 0.0, 0.5 or 1.0, or a CasADi expression.
        p: number of outputs.
    """
    first, middle, last = (column[: -HELD * p] for column in columns)
    held = columns[0][-HELD * p :]
    if isinstance(c, float):
        return ca.vertcat(columns[round(2 * c)][: -HELD * p], held)
    curvature = 2 * (first + last) - 4 * middle
    slope = 4 * middle - 3 * first - last
    return ca.vertcat(first + c * (slope + c * curvature), held)


def located_steps(
    wiring: Wiring,
    like: State,
    instant: Exogenous,
    start: ca.SX,
    columns: list[ca.SX],
    order: int,
) -> list[StepAttempt]:
    """Attempts at a step with its changes of side located (`dense_output.located_step`).

    A change of zone that leaves the side as it is (noise beyond the threshold) is not located.

    Args:
        wiring: the parts of the loop.
        like: a state of the right shapes.
        instant: exogenous inputs of the right shapes.
        start: the state at the step's start, as a column.
        columns: the exogenous inputs at three instants, or their Taylor coefficients.
        order: RUNGE_KUTTA, or that of a Taylor series.

    Raises:
        InputError: a Taylor series was asked for, and the loop is not linear on its branches.
    """
    noise = wiring.exogenous(instant, columns[0])
    right, left = wiring.widths(noise)
    arc = _dense_step(wiring, like, instant, start, columns, order)
    before = wiring.mode(tree.unpack(like, start), noise)
    edges = wiring.levels(noise)

    def after(mode: Mode, crossing: Crossing) -> Mode:
        edge = met(edges, mode.side, crossing.rising)
        return entered(mode, crossing, edge, right, left)

    levels = Levels(*(tuple(edge - noise.before for edge in part) for part in edges))
    attempts = located_step(arc, levels, before, after, start)
    return [attempt._replace(end=wiring.admissible(like, attempt.end)) for attempt in attempts]


def entered(mode: Mode, crossing: Crossing, edge: ca.SX, right: ca.SX, left: ca.SX) -> Mode:
    """The branch after a crossing.

    Args:
        mode: the branch before it.
        crossing: which outputs crossed, and in which direction.
        edge: the level of z that was crossed (p) [z].
        right, left: d_r, d_l (p) [z].
    """
    # On an edge itself, motion decides which zone follows.
    rising = 1.0 * (edge >= right) - 1.0 * (edge < -left)
    falling = 1.0 * (edge > right) - 1.0 * (edge <= -left)
    zone = ca.if_else(crossing.rising, rising, falling)
    return Mode(
        ca.if_else(crossing.changed, zone, mode.zone),
        ca.if_else(crossing.changed, crossing.side, mode.side),
    )


def _dense_step(
    wiring: Wiring,
    like: State,
    instant: Exogenous,
    start: ca.SX,
    columns: list[ca.SX],
    order: int,
) -> Callable[[ca.SX, Any, Any], DenseStep]:
    """A step on a fixed branch that can be evaluated inside: RK4, or a Taylor series."""
    size, h = start.shape[0], wiring.p.h
    x, w = ca.SX.sym("x", size), ca.SX.sym("w", columns[0].shape[0])
    branch_taken = Mode(*(ca.SX.sym(name, wiring.plant.p) for name in Mode._fields))
    s, inputs = tree.unpack(like, x), wiring.exogenous(instant, w)
    derivative = tree.stack(wiring.move(s, inputs, branch_taken)[0])
    evaluate = ca.Function("rate", [x, w, *branch_taken], [derivative], {"allow_free": True})

    def output(column: ca.SX) -> ca.SX:
        return wiring.plant.output(wiring.p.plant, tree.unpack(like, column).plant)

    def rate(column: ca.SX, c: Any, mode: Mode) -> ca.SX:
        admissible = column if column is start else wiring.admissible(like, column)
        return evaluate(admissible, exogenous_at(columns, c, wiring.plant.p), *mode)

    def rate_of_series(column: ca.SX, series: ca.SX, mode: Mode) -> ca.SX:
        return evaluate(column, series, *mode)

    if order == RUNGE_KUTTA:
        return runge_kutta(rate, output, size, h)
    nonlinear_rate = any(ca.which_depends(derivative, ca.vertcat(x, w), 2, True))
    if nonlinear_rate or any(ca.which_depends(output(x), x, 2, True)):
        raise InputError(
            "simulation.order: above 4 only for a plant, an observer and a controller that are "
            "linear on each side of the zone; use 4"
        )
    return taylor(rate_of_series, output, columns, size, h)
