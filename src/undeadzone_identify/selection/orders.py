"""Fits of each order with a zone of the sensor, and the checks of a fit.

By BIC, by held-out data, by a curve over the residual, and against no zone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import chi2

from undeadzone.util.arrays import Flags, Floats, Integers, rows_since_start
from undeadzone_identify.models import zone_fit
from undeadzone_identify.models.estimates import variance_along
from undeadzone_identify.models.least_squares import (
    CHANCE,
    regress_residual,
    regression_residual,
)
from undeadzone_identify.models.likelihood import root_mean_square
from undeadzone_identify.models.plant import CREDIBLE, PlantSimulator, RecordData, lag_products
from undeadzone_identify.models.zone import WidthLimits

NEARLY_ZERO = 0.05  # a sampled pole below it is a delay in disguise
GAINED = 0.5  # of a log likelihood, from which a better fit is another one
BLOCKS = 5  # of held-out samples, spread over a record
LEAST_BLOCK = 150  # samples of the part that one of them ends
LAGS = 20
PAST_INPUTS = 8  # past inputs, of which one-step residuals should be free
FEEDBACK_LAGS = 3  # one-step residuals, or readings, to which a loop's input answers
ALONE = 1e-6  # share of an input's rms that its reference leaves, below which it makes all of it


class OrderFit(NamedTuple):
    """Fit of a single order.

    Attributes:
        n: the order.
        fit: of plant and zone.
        error: rms error of the held-out readings, simulated, scaled.
        share: 1 - that error / rms of these readings.
        white: whether the one-step residuals of the held-out readings are white.
    """

    n: int
    fit: zone_fit.ZoneFit
    error: float
    share: float
    white: bool


class HeldOutScore(NamedTuple):
    """Score of a fit on the held-out part of a log."""

    error: float
    share: float
    white: bool


def fit_orders(
    data: RecordData,
    orders: list[int],
    limits: WidthLimits,
    held_out: float,
    advance: Callable[[int], None],
    integrators: int = 0,
    starts: Sequence[OrderFit] = (),
) -> list[OrderFit]:
    """Fit every order to all data and validate the fits on held-out blocks.

    Args:
        data: the records.
        orders: the orders to try.
        limits: bounds of the widths.
        held_out: share of the samples that are held out.
        advance: called with 1 after each order.
        integrators: number of the plant's integrators.
        starts: fits to a part of the log, at which the fits start; none: from scratch.

    Returns:
        One entry an order; those without a stable fit are left out.
    """
    train = training_samples(data, held_out)
    start_by_order = {fit.n: fit for fit in starts}
    fits: list[OrderFit] = []
    for n in orders:
        if start_by_order and n not in start_by_order:
            continue
        simulator = PlantSimulator(data, n, integrators)
        start = start_by_order.get(n)
        fit = (
            zone_fit.fit_zone(simulator, limits)
            if start is None
            else zone_fit.refit_along(start.fit, data)
        )
        advance(1)
        if _has_finite_derivatives(fit):
            fits.append(OrderFit(n, fit, *validate_fit(fit, train)))
    return _improve_orders(fits, train) if fits else fits


def _improve_orders(fits: list[OrderFit], train: Flags) -> list[OrderFit]:
    """Return the orders, smaller ones begun again without poles that no continuous plant has.

    Args:
        fits: one an order.
        train: samples that are used where the rest checks (N).
    """
    fits, best = list(fits), fits.index(best_order(fits))
    for place in range(best, 0, -1):
        if has_continuous_poles(fits[place].fit):
            break
        fewer = fits[place - 1]
        begun = zone_fit.remove_odd_poles(fits[place].fit, fewer.fit.objective.simulator)
        fit = zone_fit.improve_fit(fewer.fit, begun)
        if fit.value >= fewer.fit.value + GAINED:
            fits[place - 1] = OrderFit(fewer.n, fit, *validate_fit(fit, train))
    return fits


def _has_finite_derivatives(fit: zone_fit.ZoneFit) -> bool:
    """Return whether a fit has a likelihood with finite derivatives."""
    return math.isfinite(fit.value) and all(
        np.isfinite(part).all() for part in fit.objective.quadratic_model(fit.theta)
    )


def training_samples(data: RecordData, held_out: float) -> Flags:
    """Return the flags of training samples (N); held-out blocks end equal parts of a record."""
    train = np.ones(data.y.size, bool)
    for part in data.record_slices():
        size = part.stop - part.start
        count = min(BLOCKS, max(1, size // LEAST_BLOCK))
        train[part] = np.arange(size) * count / size % 1 < 1 - held_out
    return train


def best_order(fits: list[OrderFit]) -> OrderFit:
    """Return the order of least BIC; orders with a pole at the limit come last."""
    inside = [one for one in fits if not is_fit_at_limit(one.fit)]
    return min(inside or fits, key=lambda one: one.fit.bic)


def order_to_report(fits: list[OrderFit]) -> OrderFit:
    """Return the best order, among equal predictions a plant that exists in continuous time."""
    best = best_order(fits)
    alike = list(filter(lambda one: has_continuous_poles(one.fit), credible_orders(fits)))
    return best if has_continuous_poles(best.fit) or not alike else best_order(alike)


def has_continuous_poles(fit: zone_fit.ZoneFit) -> bool:
    """Return whether a continuous-time plant has these poles: none near 0, none negative."""
    return are_continuous(fit.objective.simulator.plant_poles(fit.theta), NEARLY_ZERO)


def are_continuous(poles: Any, least: float) -> bool:
    """Return whether sampled poles are those of a plant in continuous time.

    Args:
        poles: of the sampled plant (n), complex.
        least: size of a pole up to which it counts as a delay.
    """
    real = np.abs(poles.imag) < 1e-9
    return bool(np.all(np.where(real, poles.real, np.abs(poles)) > least))


def is_fit_at_limit(fit: zone_fit.ZoneFit) -> bool:
    """Return whether a pole is so slow that with x(0) it equals an offset or a sine."""
    return fit.objective.simulator.is_at_limit(fit.theta)


def credible_orders(fits: list[OrderFit]) -> list[OrderFit]:
    """Return the orders with a held-out error within 2 % of the least."""
    inside = [one for one in fits if not is_fit_at_limit(one.fit)] or fits
    least = min(one.error for one in inside)
    return [one for one in inside if one.error <= CREDIBLE * least]


def validate_fit(fit: zone_fit.ZoneFit, train: Flags) -> HeldOutScore:
    """Fit the training part and score the fit on the rest.

    Args:
        fit: the fit to all data, from where the climb starts.
        train: samples that are used (N).

    Returns:
        Error, share and whiteness on the other samples.
    """
    trained = zone_fit.refit_likelihood(fit, train, 25)
    if not math.isfinite(trained.value):
        trained = fit
    data = fit.objective.data
    test = data.ok & ~train
    return score_held_out(
        data.y - zone_fit.mean_reading(trained), data, test, one_step_residuals(trained, test)
    )


def score_held_out(
    error: Floats, data: RecordData, test: Flags, one_step: tuple[Floats, Flags]
) -> HeldOutScore:
    """Score the errors of held-out readings.

    Args:
        error: y less its expectation (N).
        data: the records.
        test: the held-out readings (N).
        one_step: one-step residuals, and where they are known (N, N).
    """
    rms = root_mean_square(error[test])
    return HeldOutScore(rms, 1 - rms / max(float(data.y[test].std()), 1e-12), is_white(*one_step))


def one_step_residuals(fit: zone_fit.ZoneFit, among: Flags) -> tuple[Floats, Flags]:
    """Return residuals e_t - rho e_(t-1) and the flags of outside samples in a row (N, N)."""
    e = fit.unexplained
    ok = fit.objective.data.ok
    speaks = ok if fit.objective.kind == "behind" else ok & (fit.objective.readings.side != 0)
    return predict_one_step(e, speaks & among, speaks, fit.objective.data.start)


def predict_one_step(
    e: Floats, among: Flags, speaks: Flags, start: Integers
) -> tuple[Floats, Flags]:
    """Return residuals less their prediction from the previous sample, and the known flags (N,
    N).

    Args:
        e: residuals (N).
        among: those that are asked for (N).
        speaks: those that are known (N).
        start: first sample of each record (R).
    """
    use = among.copy()
    use[1:] &= speaks[:-1]
    use[start] = False
    at = np.flatnonzero(use)
    rho = float(e[at] @ e[at - 1] / max(float(e[at - 1] @ e[at - 1]), 1e-300))
    value = e.copy()
    value[1:] -= rho * e[:-1]
    return value, use


def is_white(value: Floats, use: Flags, lags: int = LAGS) -> bool:
    """Return whether residuals are white, by the Ljung-Box statistic at 1 %."""
    count = int(use.sum())
    if count < 3 * lags:
        return True
    squares = known_autocorrelation(value, use, lags) ** 2
    total = count * (count + 2) * np.sum(squares / (count - np.arange(1, lags + 1)))
    return bool(chi2.sf(total, lags) > 0.01)


def has_input_residual(fit: zone_fit.ZoneFit) -> bool:
    """Return whether past inputs explain one-step residuals: a delay, or too few poles."""
    value, use = one_step_residuals(fit, fit.objective.data.ok)
    lagged = _lag_columns(fit.objective.data.u)
    use = use & (rows_since_start(fit.objective.data.start, use.size) >= PAST_INPUTS)
    if use.sum() < 20 * PAST_INPUTS:
        return False
    _, _, share, chance = regress_residual(lagged[use], value[use])
    return (share > 0.03 and chance < 1e-3) or (share > 0.15 and chance < 0.01)


def loop_p_value(fit: zone_fit.ZoneFit, u: Floats) -> float:
    """Return p of the residuals' effect on the input, if the input is independent of readings
    [1].

    The reading of a sample comes before its input, which moves the plant in the next one.

    Args:
        fit: plant and zone.
        u: the inputs as they were recorded, or what else may answer (N x m).
    """
    value, inputs = _innovations(fit, u)
    lagged = _lag_columns(value[:, None], range(FEEDBACK_LAGS))
    inside = np.isfinite(inputs[0])
    chances = [regress_residual(lagged[inside], one[inside])[-1] for one in inputs]
    return min(1.0, len(chances) * min(chances))


def acts_at_once(fit: zone_fit.ZoneFit, u: Floats) -> bool:
    """Return whether a reading answers to the input of its own sample.

    The innovations of that input then have a correlation with the residual of the gain's sign;
    behind a controller it has the other sign.

    Args:
        fit: plant and zone.
        u: the input as it was recorded (N x 1).
    """
    value, (new,) = _innovations(fit, u)
    inside = np.isfinite(new)
    weights, _, _, chance = regress_residual(value[inside, None], new[inside])
    gain = float(fit.theta[fit.objective.layout.numerators].sum())
    return chance <= CHANCE and float(weights[0]) * gain > 0


def _innovations(fit: zone_fit.ZoneFit, u: Floats) -> tuple[Floats, list[Floats]]:
    """Return the residuals one step ahead, 0 if unknown (N), and the innovations of each input, NaN
    at the start of a record (N each).
    """
    value, use = one_step_residuals(fit, fit.objective.data.ok)
    inside = rows_since_start(fit.objective.data.start, value.size) >= PAST_INPUTS
    inputs = []
    for column in u.T:
        new = np.full(column.size, np.nan)
        new[inside] = regression_residual(_lag_columns(column[:, None])[inside], column[inside])
        inputs.append(new)
    return np.where(use, value, 0.0), inputs


def feedback_share(
    moved: Floats, y: Floats, ok: Flags, r: Floats, start: Integers
) -> tuple[float, float]:
    """Return the share of a signal's remainder that readings explain, and its p [1].

    Of an input beside its reference it is near 1 if a controller without noise makes it, near 0
    without a loop, and 0 if nothing is left: the reference alone makes the input.

    Args:
        moved: what may answer (N x m), NaN if it is missing; the column that does so most.
        y: readings (N).
        ok: whether there is a reading (N).
        r: what else makes it, now and before (N x k), NaN if it is missing.
        start: first sample of each record (R).
    """
    wanted = _lag_columns(r, range(PAST_INPUTS + 1))
    lagged = _lag_columns(y[:, None], range(FEEDBACK_LAGS))
    own = np.hstack([np.ones((y.size, 1)), _lag_columns(moved), wanted])
    known = np.isfinite(np.hstack([own, moved])).all(axis=1)
    known &= _lag_columns(1.0 * ok[:, None], range(FEEDBACK_LAGS)).all(axis=1)
    known &= rows_since_start(start, y.size) >= PAST_INPUTS
    found = [(0.0, 1.0)]
    for column in moved[known].T:
        left = regression_residual(own[known], column)
        reference = regression_residual(own[known], lagged[known])
        if np.std(left) > ALONE * np.std(column):
            found.append(regress_residual(reference, left)[2:])
    return min(reversed(found), key=lambda one: one[1])


def _lag_columns(columns: Floats, lags: range = range(1, PAST_INPUTS + 1)) -> Floats:
    """Return the past values of each column (N x lags K)."""
    return np.hstack([np.roll(columns, lag, axis=0) for lag in lags])


def known_autocorrelation(value: Floats, use: Flags, lags: int) -> Floats:
    """Return the autocorrelation at lags 1 to `lags` over known pairs (lags) [1]."""
    if not use.any():
        return np.zeros(lags)
    own, *others = lag_products(value, use, lags + 1)
    both = [max(int((use[lag:] & use[:-lag]).sum()), 1) for lag in range(1, lags + 1)]
    return np.array(others) / both / max(own / int(use.sum()), 1e-300)


# --- A zone against none


class ZoneTest(NamedTuple):
    """Result of the test of a zone against none.

    Attributes:
        chance: p of the readings if there is no zone.
        fit: the fit with a zone, perhaps a better one than before.
    """

    chance: float
    fit: zone_fit.ZoneFit


def compare_with_no_zone(fit: zone_fit.ZoneFit) -> ZoneTest:
    """Test whether the readings need a zone.

    Args:
        fit: plant and zone.

    Returns:
        p by the likelihood ratio, made robust; 0 where exact zeros in number show the zone.
    """
    objective = fit.objective
    if objective.kind != "behind":
        return ZoneTest(0.0, fit)
    linear = zone_fit.fit_linear(objective.simulator, objective.readings.ok)
    begun = linear.theta.copy()
    begun[objective.layout.widths] = zone_fit.widths_about_level(linear, 0.05)
    best = zone_fit.improve_fit(fit, begun)
    spread = best.objective.robust_covariance(best.theta)
    row = best.objective.width_weights(1.0, 1.0)
    robust, naive = (variance_along(V, row) for V in (spread.V, spread.naive))
    ratio = 2 * max(best.value - linear.value, 0.0) / max(1.0, robust / max(naive, 1e-300))
    chance = float(chi2.sf(ratio, 1))  # of the width; the level has its number in both
    return ZoneTest(chance, best)
