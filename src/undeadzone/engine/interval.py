"""Bounds on what a CasADi SX graph can be on boxes of its inputs: interval arithmetic, rounded outwards (Moore 1966)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np

from undeadzone.engine.graph import listed
from undeadzone.errors import InputError
from undeadzone.support.arrays import Floats

PAD = 16 * np.finfo(float).eps  # relative error of NumPy's elementary functions, amply
SMOOTH = "a condition, sign, abs, min or max changes within the bounds; only smooth functions can be bounded"


class Interval(NamedTuple):
    """low <= value <= high, entry by entry."""

    low: Floats
    high: Floats


Bound = Callable[..., Interval]


def enclosure(function: ca.Function) -> Callable[[Sequence[Interval]], list[Interval]]:
    """(an interval (entries x boxes) per input) -> bounds on each output (entries x boxes), true for every point of a box.

    Raises InputError for instructions without bounds, and in the call where a condition or a kink is not decided on a whole box.
    """
    graph = listed(function)
    inputs = {
        function.name_in(i) + str(k): (i, k)
        for i in range(function.n_in())
        for k in range(function.nnz_in(i))
    }
    if unknown := [
        node.op
        for node in graph.nodes
        if node.op not in _BOUNDS and node.op not in (ca.OP_INPUT, ca.OP_CONST)
    ]:
        raise InputError(f"no bounds are known for the function {_name(unknown[0])}")

    def bounds(given: Sequence[Interval]) -> list[Interval]:
        shape = np.broadcast_shapes(*(part.low.shape[1:] for part in given))
        found: list[Interval] = []
        with np.errstate(all="ignore"):
            for node in graph.nodes:
                if node.op == ca.OP_INPUT:
                    i, k = inputs[node.text]
                    found.append(Interval(given[i].low[k], given[i].high[k]))
                elif node.op == ca.OP_CONST:
                    found.append(Interval(np.array(float(node.text)), np.array(float(node.text))))
                else:
                    found.append(_BOUNDS[node.op](*(found[operand] for operand in node.operands)))
        return [
            Interval(
                *(
                    np.stack([np.broadcast_to(found[k][side], shape) for k in row])
                    for side in range(2)
                )
            )
            for row in graph.results
        ]

    return bounds


def _name(op: int) -> str:
    return next(
        name.removeprefix("OP_").lower()
        for name in dir(ca)
        if name.startswith("OP_") and getattr(ca, name) == op
    )


def _outward(low: Floats, high: Floats) -> Interval:
    """Wider by a rounding; what is not a number has no bound."""
    return Interval(
        np.where(np.isnan(low), -np.inf, np.nextafter(low, -np.inf)),
        np.where(np.isnan(high), np.inf, np.nextafter(high, np.inf)),
    )


def _sum(a: Floats, b: Floats, towards: float) -> Floats:
    """a + b, rounded towards an infinity where it is not exact."""
    total = a + b
    part = total - a
    exact = (a - (total - part)) + (b - part) == 0
    return np.where(np.isnan(total), towards, np.where(exact, total, np.nextafter(total, towards)))


def _add(a: Interval, b: Interval) -> Interval:
    return Interval(_sum(a.low, b.low, -np.inf), _sum(a.high, b.high, np.inf))


def _negative(a: Interval) -> Interval:
    return Interval(-a.high, -a.low)


def _product(a: Interval, b: Interval) -> Interval:
    ends = [
        x * y for x in a for y in b
    ]  # 0 times infinity is no number, but then another end is 0, or both infinities are
    found = _outward(
        np.fmin(np.fmin(*ends[:2]), np.fmin(*ends[2:])),
        np.fmax(np.fmax(*ends[:2]), np.fmax(*ends[2:])),
    )
    something = ~(((a.low == 0) & (a.high == 0)) | ((b.low == 0) & (b.high == 0)))
    return Interval(np.where(something, found.low, 0.0), np.where(something, found.high, 0.0))


def _inverse(a: Interval) -> Interval:
    away = (a.low > 0) | (a.high < 0)
    found = _outward(1 / a.high, 1 / a.low)
    return Interval(np.where(away, found.low, -np.inf), np.where(away, found.high, np.inf))


def _square(a: Interval) -> Interval:
    size = _size(a)
    return Interval(
        np.maximum(np.nextafter(size.low**2, -np.inf), 0.0), np.nextafter(size.high**2, np.inf)
    )


def _size(a: Interval) -> Interval:
    """|a|"""
    least = np.maximum(np.maximum(a.low, -a.high), 0.0)
    return Interval(least, np.maximum(-a.low, a.high))


def _rising(
    function: Callable[[Floats], Floats], least: float = -np.inf, greatest: float = np.inf
) -> Bound:
    """Bounds of a function that rises on its domain [least, greatest]; none beyond."""

    def bound(a: Interval) -> Interval:
        low, high = function(a.low), function(a.high)
        inside = (a.low >= least) & (a.high <= greatest)
        found = _outward(low - PAD * np.abs(low), high + PAD * np.abs(high))
        return Interval(np.where(inside, found.low, -np.inf), np.where(inside, found.high, np.inf))

    return bound


def _falling(bound: Bound) -> Bound:
    return lambda a: _negative(bound(a))


def _periodic(function: Callable[[Floats], Floats], top: float) -> Bound:
    """Bounds of a wave of period 2 pi between -1 and 1 that is 1 at `top` and -1 half a period later."""

    def reaches(a: Interval, at: float) -> np.ndarray:
        slack = 1e-12 * (1 + np.maximum(np.abs(a.low), np.abs(a.high)))
        return np.floor((a.high + slack - at) / (2 * np.pi)) >= np.ceil(
            (a.low - slack - at) / (2 * np.pi)
        )

    def bound(a: Interval) -> Interval:
        ends = function(a.low), function(a.high)
        endless = ~(np.isfinite(a.low) & np.isfinite(a.high))
        low = np.where(
            reaches(a, top + np.pi) | endless, -1.0, np.maximum(np.minimum(*ends) - PAD, -1.0)
        )
        high = np.where(reaches(a, top) | endless, 1.0, np.minimum(np.maximum(*ends) + PAD, 1.0))
        return Interval(low, high)

    return bound


_exp, _log = _rising(np.exp), _rising(np.log, least=np.nextafter(0, 1))
_sin, _cos = _periodic(np.sin, np.pi / 2), _periodic(np.cos, 0.0)


def _tan(a: Interval) -> Interval:
    return _product(_sin(a), _inverse(_cos(a)))


def _power(a: Interval, b: Interval) -> Interval:
    """a^b: whole numbers b by products, others as exp(b log a)."""
    number = float(np.ravel(b.low)[0])
    if (
        not ((b.low == number) & (b.high == number)).all()
        or number != round(number)
        or not 1 <= abs(number) <= 16
    ):
        return _exp(_product(b, _log(a)))
    found = _whole(a, round(abs(number)))
    return found if number > 0 else _inverse(found)


def _whole(a: Interval, power: int) -> Interval:
    if power == 1:
        return a
    even = _square(_whole(a, power // 2))
    return even if power % 2 == 0 else _product(a, even)


def _hull(pick: Callable[[Floats, Floats], Floats]) -> Bound:
    return lambda a, b: Interval(pick(a.low, b.low), pick(a.high, b.high))


def _decided(yes: np.ndarray, no: np.ndarray) -> Interval:
    """1 where yes, 0 where no. Raises InputError where neither."""
    if not np.all(yes | no):
        raise InputError(SMOOTH)
    return Interval(np.where(yes, 1.0, 0.0), np.where(yes, 1.0, 0.0))


def _equal(a: Interval, b: Interval) -> tuple[np.ndarray, np.ndarray]:
    return (a.low == a.high) & (b.low == b.high) & (a.low == b.low), (a.high < b.low) | (
        a.low > b.high
    )


def _sign(a: Interval) -> Interval:
    positive = _decided(a.low > 0, a.high < 0).low
    return Interval(2 * positive - 1, 2 * positive - 1)


def _gated(condition: Interval, value: Interval) -> Interval:
    return Interval(*(np.where(condition.low == 0, 0.0, side) for side in value))


_BOUNDS: dict[int, Bound] = {
    ca.OP_ASSIGN: lambda a: a,
    ca.OP_ADD: _add,
    ca.OP_SUB: lambda a, b: _add(a, _negative(b)),
    ca.OP_NEG: _negative,
    ca.OP_TWICE: lambda a: Interval(2 * a.low, 2 * a.high),
    ca.OP_MUL: _product,
    ca.OP_DIV: lambda a, b: _product(a, _inverse(b)),
    ca.OP_INV: _inverse,
    ca.OP_SQ: _square,
    ca.OP_FABS: _size,
    ca.OP_SIGN: _sign,
    ca.OP_POW: _power,
    ca.OP_CONSTPOW: _power,
    ca.OP_SQRT: _rising(np.sqrt, least=0.0),
    ca.OP_EXP: _exp,
    ca.OP_LOG: _log,
    ca.OP_SIN: _sin,
    ca.OP_COS: _cos,
    ca.OP_TAN: _tan,
    ca.OP_ASIN: _rising(np.arcsin, -1.0, 1.0),
    ca.OP_ACOS: _falling(_rising(lambda a: -np.arccos(a), -1.0, 1.0)),
    ca.OP_ATAN: _rising(np.arctan),
    ca.OP_SINH: _rising(np.sinh),
    ca.OP_COSH: lambda a: _rising(np.cosh)(_size(a)),
    ca.OP_TANH: _rising(np.tanh),
    ca.OP_FMIN: _hull(np.minimum),
    ca.OP_FMAX: _hull(np.maximum),
    ca.OP_LT: lambda a, b: _decided(a.high < b.low, a.low >= b.high),
    ca.OP_LE: lambda a, b: _decided(a.high <= b.low, a.low > b.high),
    ca.OP_EQ: lambda a, b: _decided(*_equal(a, b)),
    ca.OP_NE: lambda a, b: _decided(*_equal(a, b)[::-1]),
    ca.OP_NOT: lambda a: _decided(a.high == 0, a.low != 0),
    ca.OP_AND: lambda a, b: Interval(a.low * b.low, a.high * b.high),
    ca.OP_OR: _hull(np.maximum),
    ca.OP_IF_ELSE_ZERO: _gated,
}
