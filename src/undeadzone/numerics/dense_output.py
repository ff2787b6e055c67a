"""Solutions over a step on one branch of the sensor, with dense output."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import casadi as ca

from undeadzone.numerics.runge_kutta import hermite, hermite_slope, rk4


class DenseStep(NamedTuple):
    """A solution on one branch over a step, or over what is left of it.

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


def runge_kutta(
    rate: Callable[[ca.SX, Any, Any], ca.SX],
    output: Callable[[ca.SX], ca.SX],
    states: int,
    h: ca.SX,
) -> Callable[[ca.SX, Any, Any], DenseStep]:
    """Arcs of x' = rate(x, c, mode) by RK4 with cubic dense output.

    Args:
        rate: the right-hand side at the fraction c of the step, on the branch `mode`.
        output: z = output(x).
        states: entries of x.
        h: length of the step [s].

    Returns:
        arc(x, c, mode): the solution from x at the fraction c of the step to its end.
    """
    point, direction = ca.SX.sym("x", states), ca.SX.sym("v", states)
    along = ca.jtimes(output(point), point, direction)
    slope = ca.Function("slope", [point, direction], [along], {"allow_free": True})

    def arc(x: ca.SX, start: Any, mode: Any) -> DenseStep:
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
            output=partial(hermite, *z),
            slope=partial(hermite_slope, *z),
        )

    return arc


def taylor(
    rate: Callable[[ca.SX, ca.SX, Any], ca.SX],
    output: Callable[[ca.SX], ca.SX],
    inputs: list[ca.SX],
    states: int,
    h: ca.SX,
) -> Callable[[ca.SX, Any, Any], DenseStep]:
    """Arcs of x' = rate(x, w, mode) by Taylor series of as many terms as there are `inputs`.

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
    x, dx = ca.SX.sym("x", states), ca.SX.sym("dx", states)
    w, dw = ca.SX.sym("w", inputs[0].shape[0]), ca.SX.sym("dw", inputs[0].shape[0])
    seen = ca.Function("seen", [x, dx], [ca.jtimes(output(x), x, dx)], {"allow_free": True})

    def arc(start: ca.SX, begin: Any, mode: Any) -> DenseStep:
        rest = 1.0 - begin
        along = ca.jtimes(rate(x, w, mode), ca.vertcat(x, w), ca.vertcat(dx, dw))
        follow = ca.Function("follow", [x, w, dx, dw], [along], {"allow_free": True})
        own = inputs if isinstance(begin, float) else _moved(inputs, begin, rest)
        terms = [start, h * rest * rate(start, own[0], mode)]
        for k in range(1, len(inputs)):
            terms.append(h * rest / (k + 1) * follow(start, own[0], terms[k], own[k]))
        z = [output(start), *(seen(start, term) for term in terms[1:])]
        onward = output(start + terms[1] / 2)
        return _series(terms, z, output, onward)

    return arc


def _series(
    terms: list[ca.SX], z: list[ca.SX], output: Callable[[ca.SX], ca.SX], onward: ca.SX
) -> DenseStep:
    """The step whose state and z are the polynomials of c with these coefficients."""
    end = _polynomial(terms, 1.0)
    slopes = [k * term for k, term in enumerate(z)][1:]
    return DenseStep(
        end=end,
        final=output(end),
        onward=onward,
        at=partial(_polynomial, terms),
        output=partial(_polynomial, z),
        slope=partial(_polynomial, slopes),
    )


def _moved(inputs: list[ca.SX], begin: Any, rest: Any) -> list[ca.SX]:
    """The coefficients of the inputs over the rest of a step after the fraction `begin`."""
    moved = []
    for k in range(len(inputs)):
        derivative = [math.comb(j, k) * inputs[j] for j in range(k, len(inputs))]
        moved.append(rest**k * _polynomial(derivative, begin))
    return moved


def _polynomial(terms: list[ca.SX], c: Any) -> ca.SX:
    """terms[0] + terms[1] c + ... by Horner's rule; at 1, the smallest first."""
    at_end = isinstance(c, float) and c == 1.0
    total = terms[-1]
    for term in terms[-2::-1]:
        total = term + (total if at_end else c * total)
    return total
