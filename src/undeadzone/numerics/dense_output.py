"""Solutions over a step on one branch of the sensor, with dense output: by Runge-Kutta, or by Taylor series."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca

from undeadzone.numerics.runge_kutta import hermite, hermite_slope, rk4


class DenseStep(NamedTuple):
    """A solution on one branch over a step, or what is left of it: its end; the state, z and dz/dc at a fraction c of it.

    final: z at the end; onward: z halfway if it went on as it sets out.
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
    """Arcs (x, start c, mode) of x' = rate(x, c, mode) by RK4 with cubic dense output; z = output(x)."""
    point, direction = ca.SX.sym("x", states), ca.SX.sym("v", states)
    slope = ca.Function(
        "slope",
        [point, direction],
        [ca.jtimes(output(point), point, direction)],
        {"allow_free": True},
    )

    def arc(x: ca.SX, start: Any, mode: Any) -> DenseStep:
        rest = 1.0 - start
        k1 = rate(x, start, mode)
        end = rk4(lambda state, c: rate(state, start + c * rest, mode), x, h * rest, k1)
        k5 = rate(end, 1.0, mode)
        z = (output(x), slope(x, k1), output(end), slope(end, k5), h * rest)
        return DenseStep(
            end,
            z[2],
            output(x + h * rest / 2 * k1),
            lambda c: hermite(x, k1, end, k5, h * rest, c),
            lambda c: hermite(*z, c),
            lambda c: hermite_slope(*z, c),
        )

    return arc


def taylor(
    rate: Callable[[ca.SX, ca.SX, Any], ca.SX],
    output: Callable[[ca.SX], ca.SX],
    inputs: list[ca.SX],
    states: int,
    h: ca.SX,
) -> Callable[[ca.SX, Any, Any], DenseStep]:
    """Arcs (x, start c, mode) of x' = rate(x, w, mode), affine in x and w, by Taylor series of as many terms as there are `inputs`.

    inputs: the coefficients of w = inputs[0] + inputs[1] c + ... over the step; z = output(x), affine. Exact but for the
    terms left out.
    """
    x, dx = ca.SX.sym("x", states), ca.SX.sym("dx", states)
    w, dw = ca.SX.sym("w", inputs[0].shape[0]), ca.SX.sym("dw", inputs[0].shape[0])
    seen = ca.Function("seen", [x, dx], [ca.jtimes(output(x), x, dx)], {"allow_free": True})

    def arc(start: ca.SX, begin: Any, mode: Any) -> DenseStep:
        rest = 1.0 - begin
        follow = ca.Function(
            "follow",
            [x, w, dx, dw],
            [ca.jtimes(rate(x, w, mode), ca.vertcat(x, w), ca.vertcat(dx, dw))],
            {"allow_free": True},
        )
        own = (
            inputs
            if isinstance(begin, float)
            else [_moved(inputs, k, begin, rest) for k in range(len(inputs))]
        )
        terms = [start, h * rest * rate(start, own[0], mode)]
        for k in range(1, len(inputs)):
            terms.append(h * rest / (k + 1) * follow(start, own[0], terms[k], own[k]))
        z = [output(start), *(seen(start, term) for term in terms[1:])]
        steep = [k * term for k, term in enumerate(z)][1:]
        end = _polynomial(terms, 1.0)
        return DenseStep(
            end,
            output(end),
            output(start + terms[1] / 2),
            lambda c: _polynomial(terms, c),
            lambda c: _polynomial(z, c),
            lambda c: _polynomial(steep, c),
        )

    return arc


def _moved(inputs: list[ca.SX], k: int, begin: Any, rest: Any) -> ca.SX:
    """Coefficient k of the inputs over what is left of the step after the fraction `begin`."""
    return rest**k * _polynomial(
        [math.comb(j, k) * inputs[j] for j in range(k, len(inputs))], begin
    )


def _polynomial(terms: list[ca.SX], c: Any) -> ca.SX:
    """terms[0] + terms[1] c + ... by Horner's rule; at 1, the smallest first."""
    total = terms[-1]
    for term in terms[-2::-1]:
        total = term + (total if isinstance(c, float) and c == 1.0 else c * total)
    return total
