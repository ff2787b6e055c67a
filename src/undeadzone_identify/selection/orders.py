"""Each order fitted with a zone of the sensor, and how such a fit is checked.

By BIC, by what it says of held-out data, by a curve over what it leaves, and against no zone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from undeadzone.util.arrays import Flags, Floats, Integers, since_start
from undeadzone_identify.models import zone_fit
from undeadzone_identify.models.least_squares import (
    CHANCE,
    HATS,
    explain_residual,
    hats,
    unexplained_by,
)
from undeadzone_identify.models.plant import CREDIBLE, Data, Simulator, products
from undeadzone_identify.models.zone import Limits

NEARLY_ZERO = 0.05  # a sampled pole below it is a delay in disguise
GAINED = 0.5  # of a log likelihood, from which a better fit is another one
BLOCKS = 5  # of held-out samples, spread over a record
LEAST_BLOCK = 150  # samples of the part that one of them ends
LAGS = 20
HEARD = 8  # past inputs, of which one-step residuals should be free
ANSWERED = 3  # one-step residuals, or readings, to which a loop's input answers
ALONE = 1e-6  # share of an input's rms that its reference leaves, below which it makes all of it
SHARE = 0.05  # of the residual's variance that a curve explains, from which it is real


class OrderFit(NamedTuple):
    """One order.

    Attributes:
        n: the order.
        singles: fit of (L1), or of noise behind the zone.
        pairs: fit of (L2); the same as singles for noise behind the zone.
        error: rms error of the held-out readings, simulated, scaled.
        share: 1 - that error / rms of these readings.
        white: whether the one-step residuals of the held-out readings are white.
    """

    n: int
    singles: zone_fit.Fit
    pairs: zone_fit.Fit
    error: float
    share: float
    white: bool


class HeldOut(NamedTuple):
    """How a fit of the first part of a log does on the rest."""

    error: float
    share: float
    white: bool


def fit_orders(
    data: Data,
    orders: list[int],
    limits: Limits,
    held_out: float,
    advance: Callable[[int], None],
    integrators: int = 0,
    begun: Sequence[OrderFit] = (),
) -> list[OrderFit]:
    """Return every order, fitted to all data and checked on blocks of them.

    Args:
        data: the records.
        orders: the orders to try.
        limits: of the widths.
        held_out: share of the samples that checks.
        advance: called with 1 after each order.
        integrators: of the plant.
        begun: fits of a part of the log, from where those of all of it start; none: from scratch.

    Returns:
        One entry an order; those without a stable fit are left out.
    """
    train = training_samples(data, held_out)
    known = {one.n: one for one in begun}
    fits: list[OrderFit] = []
    for n in orders:
        if known and n not in known:
            continue
        singles, pairs = _stages(Simulator(data, n, integrators), limits, known.get(n))
        advance(1)
        if _says_something(singles) and _says_something(pairs):
            fits.append(OrderFit(n, singles, pairs, *validate(pairs, train)))
    return _less_odd(fits, train) if fits else fits


def _less_odd(fits: list[OrderFit], train: Flags) -> list[OrderFit]:
    """Return the orders, the best climbed on, and without its poles that no plant in time has.

    Args:
        fits: one an order.
        train: samples that are used where the rest checks (N).
    """
    fits, best = list(fits), fits.index(best_order(fits))
    fits[best] = _climb_again(fits[best], fits[best].pairs.theta, train)
    for place in range(best, 0, -1):
        if is_sampled(fits[place].pairs):
            break
        fewer = fits[place - 1]
        begun = zone_fit.less_odd(fits[place].pairs, fewer.pairs.objective.simulator)
        fits[place - 1] = _climb_again(fewer, begun, train)
    return fits


def _climb_again(one: OrderFit, theta: Floats, train: Flags) -> OrderFit:
    """Return the fits of an order, or those that a climb from other numbers leads to."""
    pairs = zone_fit.better(one.pairs, theta)
    if pairs.value < one.pairs.value + GAINED:
        return one
    singles = pairs if one.pairs is one.singles else zone_fit.better(one.singles, pairs.theta)
    return OrderFit(one.n, singles, pairs, *validate(pairs, train))


def _stages(
    simulator: Simulator, limits: Limits, begun: OrderFit | None
) -> tuple[zone_fit.Fit, zone_fit.Fit]:
    """Return the fits of singles and of pairs; one and the same with noise behind the zone."""
    data = simulator.data
    if begun is not None:
        singles = zone_fit.move_records(begun.singles, data)
        return singles, zone_fit.move_records(begun.pairs, data) if data.silent_zeros else singles
    singles = zone_fit.fit_zone(simulator, "singles" if data.silent_zeros else "behind", limits)
    paired = data.silent_zeros and math.isfinite(singles.value)
    return singles, zone_fit.refit(singles, "pairs") if paired else singles


def _says_something(fit: zone_fit.Fit) -> bool:
    """Return whether a fit has a likelihood whose derivatives do not overflow."""
    if not math.isfinite(fit.value):
        return False
    return all(np.isfinite(part).all() for part in fit.objective.quadratic(fit.theta))


def training_samples(data: Data, held_out: float) -> Flags:
    """Return the samples that are no held-out ones (N): these are the ends of equal parts of a
    record.
    """
    train = np.ones(data.y.size, bool)
    for part in data.records():
        size = part.stop - part.start
        count = min(BLOCKS, max(1, size // LEAST_BLOCK))
        train[part] = np.arange(size) * count / size % 1 < 1 - held_out
    return train


def best_order(fits: list[OrderFit]) -> OrderFit:
    """Return the order of least BIC of (L2), those with a pole at the limit of what is allowed
    last.
    """
    inside = [one for one in fits if not at_limit(one.pairs)]
    return min(inside or fits, key=lambda one: one.pairs.bic)


def order_to_write(fits: list[OrderFit]) -> OrderFit:
    """Return the best order; of those that predict alike, one that a plant in continuous time
    has.
    """
    best = best_order(fits)
    alike = list(filter(lambda one: is_sampled(one.pairs), credible(fits)))
    return best if is_sampled(best.pairs) or not alike else best_order(alike)


def is_sampled(fit: zone_fit.Fit) -> bool:
    """Return whether a plant in continuous time has these poles: none at 0 nearly, none
    negative.
    """
    poles = fit.objective.simulator.poles(fit.theta)
    real = np.abs(poles.imag) < 1e-9
    return bool(np.all(np.where(real, poles.real, np.abs(poles)) > NEARLY_ZERO))


def at_limit(fit: zone_fit.Fit) -> bool:
    """Return whether a pole is as slow as is allowed, so that with x(0) it is an offset or a
    sine.
    """
    return fit.objective.simulator.at_limit(fit.theta)


def credible(fits: list[OrderFit]) -> list[OrderFit]:
    """Return the orders whose held-out error is within 2 % of the least."""
    inside = [one for one in fits if not at_limit(one.pairs)] or fits
    least = min(one.error for one in inside)
    return [one for one in inside if one.error <= CREDIBLE * least]


def validate(fit: zone_fit.Fit, train: Flags) -> HeldOut:
    """Return a fit of the training part, checked on the rest.

    Args:
        fit: the fit to all data, from where the climb starts.
        train: samples that are used (N).

    Returns:
        Error, share and whiteness on the other samples.
    """
    trained = zone_fit.refit(fit, fit.objective.kind, train, 25)
    if not math.isfinite(trained.value):
        trained = fit
    data = fit.objective.data
    test = data.ok & ~train
    return judge_errors(
        data.y - zone_fit.mean_reading(trained), data, test, innovations(trained, test)
    )


def judge_errors(error: Floats, data: Data, test: Flags, one_step: tuple[Floats, Flags]) -> HeldOut:
    """What errors of held-out readings say of a fit.

    Args:
        error: y less what is expected (N).
        data: the records.
        test: the held-out readings (N).
        one_step: one-step residuals, and where they are known (N, N).
    """
    rms = float(np.sqrt(np.mean(error[test] ** 2)))
    return HeldOut(rms, 1 - rms / max(float(data.y[test].std()), 1e-12), is_white(*one_step))


def innovations(fit: zone_fit.Fit, among: Flags) -> tuple[Floats, Flags]:
    """Return one-step residuals e_t - rho e_(t-1) and where they are known: speaking in a row (N,
    N).
    """
    readings = fit.objective.readings
    e = fit.objective.residuals(fit.theta)
    ok = fit.objective.data.ok
    speaks = ok if fit.objective.kind == "behind" else ok & (readings.side != 0)
    rho = fit.rho if fit.objective.kind == "pairs" else None
    return one_step(e, speaks & among, speaks, fit.objective.data.start, rho)


def one_step(
    e: Floats, among: Flags, speaks: Flags, start: Integers, rho: float | None = None
) -> tuple[Floats, Flags]:
    """Return residuals less what those of the sample before say of them, and where both are known
    (N, N).

    Args:
        e: residuals (N).
        among: those that are asked for (N).
        speaks: those that are known (N).
        start: first sample of each record (R).
        rho: correlation over one sample; None: of the residuals themselves.
    """
    use = among.copy()
    use[1:] &= speaks[:-1]
    use[start] = False
    if rho is None:
        at = np.flatnonzero(use)
        rho = float(e[at] @ e[at - 1] / max(float(e[at - 1] @ e[at - 1]), 1e-300))
    value = e.copy()
    value[1:] -= rho * e[:-1]
    return value, use


def is_white(value: Floats, use: Flags, lags: int = LAGS) -> bool:
    """Return whether residuals are white, by Ljung and Box's sum of squared correlations at 1 %."""
    count = int(use.sum())
    if count < 3 * lags:
        return True
    squares = correlation(value, use, lags) ** 2
    total = count * (count + 2) * float(np.sum(squares / (count - np.arange(1, lags + 1))))
    return bool(chi2.sf(total, lags) > 0.01)


def reacts_to_input(fit: zone_fit.Fit) -> bool:
    """Return whether past inputs explain one-step residuals: a delay, or too few poles."""
    value, use = innovations(fit, fit.objective.data.ok)
    lagged = _lagged_values(fit.objective.data.u)
    use = use & (since_start(fit.objective.data.start, use.size) >= HEARD)
    if use.sum() < 20 * HEARD:
        return False
    _, _, share, chance = explain_residual(lagged[use], value[use])
    return (share > 0.03 and chance < 1e-3) or (share > 0.15 and chance < 0.01)


def loop_chance(fit: zone_fit.Fit, u: Floats) -> float:
    """Return p of what one-step residuals so far say of the input, if it does not answer to
    readings.

    The reading of a sample comes before its input, which moves the plant in the next one.

    Args:
        fit: plant and zone.
        u: the inputs as they were recorded, or what else may answer (N x m).
    """
    value, use = innovations(fit, fit.objective.data.ok)
    heard = _lagged_values(np.where(use, value, 0.0)[:, None], range(ANSWERED))
    inside = since_start(fit.objective.data.start, value.size) >= HEARD
    left = [
        unexplained_by(_lagged_values(column[:, None])[inside], column[inside]) for column in u.T
    ]
    chances = [explain_residual(heard[inside], one)[-1] for one in left]
    return min(1.0, len(chances) * min(chances))


def explained_by_readings(
    moved: Floats, y: Floats, ok: Flags, r: Floats, start: Integers
) -> tuple[float, float]:
    """Return the share that readings have of what is left of a signal, and p of it.

    Of an input beside its reference it is near 1 where a controller without noise makes it, near 0
    without a loop, and 0 where nothing is left: the reference alone makes the input.

    Args:
        moved: what may answer (N x m), NaN where it is missing; the column that does so most.
        y: readings (N).
        ok: whether there is a reading (N).
        r: what else makes it, now and before (N x k), NaN where it is missing.
        start: first sample of each record (R).
    """
    wanted, heard = _lagged_values(r, range(HEARD + 1)), _lagged_values(y[:, None], range(ANSWERED))
    own = np.hstack([np.ones((y.size, 1)), _lagged_values(moved), wanted])
    known = np.isfinite(np.hstack([own, moved])).all(axis=1)
    known &= _lagged_values(1.0 * ok[:, None], range(ANSWERED)).all(axis=1)
    known &= since_start(start, y.size) >= HEARD
    found = [(0.0, 1.0)]
    for column in moved[known].T:
        left, said = unexplained_by(own[known], column), unexplained_by(own[known], heard[known])
        if np.std(left) > ALONE * np.std(column):
            found.append(explain_residual(said, left)[2:])
    return min(reversed(found), key=lambda one: one[1])


def _lagged_values(columns: Floats, lags: range = range(1, HEARD + 1)) -> Floats:
    """Return the last values of each column (N x lags K)."""
    return np.hstack([np.roll(columns, lag, axis=0) for lag in lags])


def correlation(value: Floats, use: Flags, lags: int) -> Floats:
    """Return autocorrelation at lags 1 to `lags` over pairs that are both known (lags)."""
    if not use.any():
        return np.zeros(lags)
    own, *others = products(value, use, lags + 1)
    both = [max(int((use[lag:] & use[:-lag]).sum()), 1) for lag in range(1, lags + 1)]
    return np.array(others) / both / max(own / int(use.sum()), 1e-300)


# --- What the zone leaves


class ResidualMap(NamedTuple):
    """The residual y - E[y | z^] by z^.

    Attributes:
        centres: places of the hat functions (K) [scaled z].
        curve, std: mean residual there, and its standard deviation (K) [scaled y].
        share, chance: share of the residual's variance that the curve explains, and its p.
        moving_share, moving_chance: the same for a curve times the direction of z^: a memory.
    """

    centres: Floats
    curve: Floats
    std: Floats
    share: float
    chance: float
    moving_share: float
    moving_chance: float

    @property
    def strange(self) -> bool:
        """Return whether a map of z^ explains what a dead zone leaves."""
        return self.share > SHARE and self.chance < CHANCE

    @property
    def remembers(self) -> bool:
        """Return whether the residual depends on the direction of z^."""
        return self.moving_share > SHARE and self.moving_chance < CHANCE


def residual_map(fit: zone_fit.Fit) -> ResidualMap:
    """What the fit leaves, by z^ and by its direction.

    Args:
        fit: plant and zone of a record.

    Returns:
        The curve, how much it explains and how surely.
    """
    z = fit.z
    ok = fit.objective.readings.ok
    residual = fit.objective.readings.y - zone_fit.mean_reading(fit)
    centres = np.unique(np.quantile(z[ok], np.linspace(0.01, 0.99, HATS)))
    curves = hats(z, centres)
    speed = np.diff(z, prepend=z[0])
    moving = curves * np.tanh(speed / (speed.std() + 1e-300))[:, None]
    curve, std, share, chance = explain_residual(curves[ok], residual[ok])
    _, _, moving_share, moving_chance = explain_residual(moving[ok], residual[ok])
    return ResidualMap(centres, curve, std, share, chance, moving_share, moving_chance)


# --- A zone against none


class NoZone(NamedTuple):
    """The test's outcome.

    Attributes:
        chance: p of what was seen if there is no zone.
        fit: the fit with a zone, perhaps a better one than before.
    """

    chance: float
    fit: zone_fit.Fit


def judge_no_zone(fit: zone_fit.Fit) -> NoZone:
    """Return whether the readings need a zone at all.

    Args:
        fit: plant and zone.

    Returns:
        p by the likelihood ratio, made robust; 0 where exact zeros in number show the zone.
    """
    objective = fit.objective
    if objective.kind != "behind":
        return NoZone(0.0, fit)
    linear = zone_fit.fit_linear(objective.simulator, objective.readings.ok)
    begun, widths = linear.theta.copy(), slice(objective.layout.right, objective.layout.right + 2)
    begun[widths] = zone_fit.about_level(linear, 0.05)
    best = zone_fit.better(fit, begun)
    spread = best.objective.spread(best.theta)
    row = best.objective.direction(1.0, 1.0)
    robust, naive = float(row @ spread.V @ row), float(row @ spread.naive @ row)
    ratio = 2 * max(best.value - linear.value, 0.0) / max(1.0, robust / max(naive, 1e-300))
    chance = float(chi2.sf(ratio, 1))  # of the width; the level has its number in both
    return NoZone(chance, best)
