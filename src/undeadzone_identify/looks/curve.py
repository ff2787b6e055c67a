"""A map at rest as a smooth curve: how far it bends, how far its ways lie apart, and its limits.

The curve is the polynomial of the least price. Where the command came from both sides, each way is
shifted by half of their distance, which is one more number of the same fit. A line between limits
is asked beside it: a curve may be one whose limits are round.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Legendre
from numpy.polynomial.legendre import legvander

from undeadzone.util.arrays import Floats
from undeadzone_identify.looks.edges import DEARER, PLACES, Levels, price
from undeadzone_identify.looks.rows import LEVELS, Rows
from undeadzone_identify.models.estimates import Interval, student_quantile

TINY = 1e-9
EXPLAINED = 0.98  # of the variance, by a curve or beside a flat part
DEGREES = range(1, 7)  # of the polynomials that may be the curve


class Curve(NamedTuple):
    """Smooth curve through rows at rest.

    Attributes:
        departure: the largest from the line through all levels [y]; 0 where a line is the curve.
        distance: of the way up beyond the way down [u]; None where the command came from one side.
        hides: the widest dead band that is not excluded at 95 % [u].
        free: rows more than numbers of the fit.
    """

    departure: Interval
    distance: Interval | None
    hides: float
    free: int


class _Fit(NamedTuple):
    """Least squares of a curve: price, design (R x k), coefficients (k), their covariance, loss."""

    price: float
    design: Floats
    c: Floats
    covariance: Floats
    loss: float

    def measure(self, row: Floats) -> Interval:
        """Return a linear function of the coefficients with its 95 % interval."""
        reach = student_quantile(self.design.shape[0] - self.c.size)
        value = float(row @ self.c)
        error = reach * math.sqrt(row @ self.covariance @ row)
        return Interval(value, value - error, value + error)


def fit_curve(rows: Rows, taken_up: float = 0.0) -> Curve | None:
    """Fit the curve of rows at rest; None with too few rows, or with too large a rest.

    A gap is taken up after a turn. A second fit leaves out the rows of that travel, and has the
    ways put together.

    Args:
        rows: of a map, in the order of their record.
        taken_up: distance of the ways by a fit before [u].
    """
    has_ways = min(np.unique(rows.u[rows.came == way]).size for way in (-1, 1)) >= LEVELS
    known = (rows.came != 0) | (not has_ways)  # before the first change neither way is
    turned = np.diff(rows.came, prepend=rows.came[:1]) != 0
    last = np.maximum.accumulate(np.where(turned, np.arange(turned.size) - 1, 0))
    known &= np.abs(rows.u - rows.u[last]) >= taken_up
    u, y, came = (one[known] for one in rows[:3])
    u = u - came * taken_up / 2
    half = float(np.ptp(u)) / 2
    height = float(np.ptp(y))
    x = (u - u.min()) / half - 1
    v = (y - y.min()) / height
    fits = []
    for degree in DEGREES:
        powers = legvander(x, degree)
        slope = Legendre(np.linalg.lstsq(powers, v)[0]).deriv()(x)
        design = np.column_stack([powers, *[-came * slope / 2] * has_ways])
        gram = design.T @ design
        if np.linalg.matrix_rank(gram, hermitian=True) < len(gram) or len(gram) >= x.size:
            break
        fits.append(_fit(design, np.linalg.inv(gram), v))
    if not fits:
        return None
    best = min(fits, key=lambda one: one.price)
    if best.loss > (1 - EXPLAINED) * np.var(v):
        return None
    degree = best.c.size - has_ways - 1
    levels = legvander((np.unique(rows.u[known]) - u.min()) / half - 1, degree)
    line = levels[:, :2]
    bent = np.zeros((line.shape[0], best.c.size))
    bent[:, 2 : degree + 1] = levels[:, 2:] - line @ np.linalg.lstsq(line, levels[:, 2:])[0]
    widest = int(np.argmax(np.abs(bent @ best.c)))
    distance = None
    if has_ways:
        distance = best.measure(np.eye(best.c.size)[-1]).place(taken_up, half)
        if distance.low > 0 and not taken_up:
            return fit_curve(rows, distance.value)
    return Curve(
        best.measure(np.sign(bent[widest] @ best.c) * bent[widest]).scale_by(height),
        distance,
        half * _widest_hidden(best, x, v, degree),
        x.size - best.c.size,
    )


def fit_limits(levels: Levels) -> dict[str, Interval]:
    """Fit a line between limits: return where they are met, lower and upper; {} if a curve fits.

    That is a polynomial of as many numbers that leaves less. Two levels or more are at a limit.

    Args:
        levels: of a map, in units of its ranges.
    """
    x, v, w = levels
    places = np.linspace(0.0, 1.0, 2 * PLACES - 1)
    low, high = places[np.array(np.triu_indices(places.size, 4))]
    lines = _centre_rows(np.clip(x, low[:, None], high[:, None]), w)
    about = _centre_rows(v, w)
    curves = [np.polyval(np.polyfit(x, v, degree, w=w), x) for degree in (1, 2, 3)]
    least = np.mean((w * (v - curves)) ** 2, axis=1)
    explained = (lines @ about) ** 2 / np.sum(lines**2, axis=1)
    loss = np.mean(about**2) - explained / x.size
    count = (low > 0) + 1 * (high < 1)
    rests_below = (low == 0) | (low >= x[1])
    rests_above = (high == 1) | (high <= x[-2])
    is_line = rests_below & rests_above & (loss < least[count])
    prices = np.where(is_line, price(loss, x.size, count), np.inf)
    best = int(np.argmin(prices))
    near = prices < prices[best] + DEARER
    return {
        name: Interval(float(at[best]), float(at[near].min()), float(at[near].max()))
        for name, at, end in (("lower", low, 0), ("upper", high, 1))
        if near.any() and at[best] != end
    }


def _centre_rows(rows: Floats, w: Floats) -> Floats:
    """Return rows (... x n) less their means by weights w**2, times w (n)."""
    mean = rows @ w**2 / np.sum(w**2)
    return (rows.T - mean).T * w


def _widest_hidden(best: _Fit, x: Floats, v: Floats, degree: int) -> float:
    """Return the widest dead band between two levels that the rows do not exclude (scaled).

    A band shifts all that lies beyond it by its width times the slope. The shift is one more number
    of the fit.
    """
    order = np.argsort(x)[::-1]
    ends = np.flatnonzero(np.diff(x[order]))  # the last rows beyond each edge
    edges = x[order][ends + 1]
    q = np.linalg.qr(best.design).Q
    beyond = np.cumsum(np.column_stack([np.ones_like(v), v, q])[order], axis=0)[ends]
    power = np.maximum(beyond[:, 0] - np.sum(beyond[:, 2:] ** 2, axis=1), TINY)
    shift = (beyond[:, 1] - beyond[:, 2:] @ (q.T @ v)) / power
    error = student_quantile(x.size - best.c.size) * np.sqrt(best.loss / power)
    slope = np.abs(Legendre(best.c[: degree + 1]).deriv()(edges))
    return float(np.max((np.abs(shift) + error) / np.maximum(slope, TINY)))


def _fit(design: Floats, inverse: Floats, v: Floats) -> _Fit:
    """Fit readings by columns, of whose products the inverse is given."""
    c = inverse @ (design.T @ v)
    rows, numbers = design.shape
    loss = float(np.sum((v - design @ c) ** 2)) / (rows - numbers)
    return _Fit(float(price(loss, rows, numbers)), design, c, loss * inverse, loss)
