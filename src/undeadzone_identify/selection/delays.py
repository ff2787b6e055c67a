"""Fits of every order to a record: unvisited edges removed, glitches excluded, delays found.

A delay of the input, in whole samples, is tried where a later input explains the log better.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from undeadzone.errors import InputError
from undeadzone.util.arrays import Floats, Integers
from undeadzone_identify.logs.log import MOST_LATE
from undeadzone_identify.logs.prepare import FAR_EDGE, SIDES, PreparedLog
from undeadzone_identify.models.estimates import maximise_likelihood
from undeadzone_identify.models.likelihood import LOG_ROOT
from undeadzone_identify.models.plant import PlantSimulator, busiest_stretches, delay_inputs
from undeadzone_identify.models.zone_fit import ZoneFit, fit_linear, nearest_numbers
from undeadzone_identify.selection.orders import (
    OrderFit,
    best_order,
    fit_orders,
    has_continuous_poles,
    is_fit_at_limit,
)

GLITCH = 8.0  # standard deviations beyond which a reading is no reading
RARE = 0.01  # share of the readings that may be dropped as glitches
PROBES = (0, 1, 2, 3, 5, 7, 10, 14, 19, 25)  # samples
SCREENED = 2  # order of the linear plant
STEPS = 30  # of a climb
ROUGH = 0.3  # rms of what a linear plant leaves, at the start of a climb
CLEARLY = 20.0  # of BIC, by which a delay must be better than more poles
REACH = 6.0  # of BIC: odds of 20 to 1, within which a delay may be the true one


def drop_unvisited_edges(prepared: PreparedLog) -> tuple[PreparedLog, tuple[str, ...]]:
    """Move an edge that no reading passes far away, and list its name.

    Args:
        prepared: the log.

    Raises:
        InputError: the plant integrates, so that one edge alone tells nothing.
    """
    data = prepared.data
    limits = prepared.limits
    if not data.silent_zeros or prepared.jumps is not None:
        return prepared, ()
    unreached = []
    for name, sign in SIDES.items():
        low, high = getattr(limits, name)
        if low != high and not np.any(data.side[data.ok] == sign):
            unreached.append(name)
    if unreached and limits.tied:
        raise InputError(
            f"log: no reading lies beyond the {' or the '.join(unreached)} edge: z of an"
            " integrating plant has no zero, so nothing is known of the zone: record with a larger"
            " input"
        )
    far: dict[str, Any] = dict.fromkeys(unreached, (FAR_EDGE, FAR_EDGE))
    return prepared._replace(limits=limits._replace(**far)), tuple(unreached)


class FittedOrders(NamedTuple):
    """Fits of every order.

    Attributes:
        prepared: the log without glitches, its input shifted.
        fits: one an order.
        delay: samples by which the input acts late.
        alike: a fit with another delay that explains the log as well.
    """

    prepared: PreparedLog
    fits: list[OrderFit]
    delay: int
    alike: list[OrderFit]


def fit_with_delay(prepared: PreparedLog, advance: Callable[[int], None]) -> FittedOrders:
    """Fit every order, and again if the input turns out to act later.

    Delay and starts of a long log are found in a part of it.

    Args:
        prepared: the log.
        advance: called with the number of steps just done.

    Raises:
        InputError: no stable plant fits.
    """
    part = busiest_stretches(prepared.data)
    if part is prepared.data:
        return _search_delay(prepared, advance)
    begun = _search_delay(prepared._replace(data=part), advance)
    if is_fit_at_limit(best_order(begun.fits).fit):  # perhaps since the part is short
        return _search_delay(prepared, advance)
    late = prepared._replace(data=delay_inputs(prepared.data, begun.delay))
    return _fit_without_glitches(late, advance, begun.fits)._replace(delay=begun.delay)


def _search_delay(prepared: PreparedLog, advance: Callable[[int], None]) -> FittedOrders:
    """Fit with all samples as in `fit_with_delay`. Raise InputError."""
    if prepared.options.delay != "auto":
        samples = int(prepared.options.delay)
        shifted = prepared._replace(data=delay_inputs(prepared.data, samples))
        return _fit_without_glitches(shifted, advance)._replace(delay=samples)
    found = _fit_without_glitches(prepared, advance)
    samples = likely_delay(found.fits)
    if not samples:
        return found
    late = _fit_near_delay(found, samples, advance)
    if not is_delay_better(found.fits, late.fits):
        return found._replace(alike=find_equivalents(found.fits, late.fits))
    return late._replace(prepared=late.prepared._replace(orders=prepared.orders))


def _fit_near_delay(
    found: FittedOrders, first: int, advance: Callable[[int], None]
) -> FittedOrders:
    """Fit with the best delay near a first guess; the delay allows no more poles."""
    prepared = found.prepared
    most = best_order(found.fits).n
    fewer = [n for n in prepared.orders if n <= most]
    shifted = prepared._replace(data=delay_inputs(prepared.data, first), orders=fewer)
    late = _fit_without_glitches(shifted, advance)
    more = refine_delay(late.fits, first) - first
    if more:
        shifted = late.prepared._replace(data=delay_inputs(late.prepared.data, more))
        warm = _fit_without_glitches(shifted, advance, delay_fits(late.fits, more))
        cold = _fit_without_glitches(shifted, advance)
        late = min((warm, cold), key=lambda one: best_order(one.fits).fit.bic)
    return late._replace(delay=first + more)


def _fit_without_glitches(
    prepared: PreparedLog, advance: Callable[[int], None], begun: Sequence[OrderFit] = ()
) -> FittedOrders:
    """Fit every order, and again if a few readings turn out to be glitches."""
    for _ in range(3):
        data = prepared.data
        limits = prepared.limits
        held_out = prepared.options.held_out
        integrators = prepared.options.integrators
        fits = fit_orders(data, prepared.orders, limits, held_out, advance, integrators, begun)
        if not fits:
            raise InputError(
                "log: no stable plant of these orders fits. Try --integrators 1 if y is a "
                "position, another --order, or another input"
            )
        glitches = _find_glitches(best_order(fits))
        if not glitches.size:
            break
        ok = data.ok.copy()
        ok[glitches] = False
        remark = (
            f"{glitches.size} readings more than {GLITCH:g} standard deviations off are taken as"
            " missing"
        )
        prepared = prepared._replace(
            data=data._replace(ok=ok, y=np.where(ok, data.y, 0.0)),
            remarks=[*prepared.remarks, remark],
        )
    return FittedOrders(prepared, fits, 0, [])


def _find_glitches(chosen: OrderFit) -> Integers:
    """Find the few readings that the fit cannot have produced."""
    fit = chosen.fit
    ok = fit.objective.readings.ok
    density = fit.objective.z_and_terms(fit.theta)[1].value
    normal = -LOG_ROOT - math.log(fit.disturbance_rms)
    silent = ok & (fit.objective.readings.side == 0) & fit.objective.data.silent_zeros
    unusual = density - np.where(silent, 0.0, normal) < -0.5 * GLITCH**2
    places = np.flatnonzero(ok & unusual)
    return places if places.size <= RARE * ok.sum() else np.empty(0, int)


# --- Delays


def likely_delay(fits: list[OrderFit]) -> int:
    """Find the delay with which a linear plant of low order explains a log best [samples].

    The zone disturbs these fits much alike; whether the delay is real is decided by fits with it.

    Args:
        fits: one an order, without a delay.

    Returns:
        Samples; 0 if none is better.
    """
    objective = fits[0].fit.objective
    data = objective.data
    integrators = objective.layout.integrators
    order = max(SCREENED, integrators + 1)

    @cache
    def scan(samples: int) -> float:
        """Return the residual rms of a linear plant with a delay, scaled."""
        delayed = PlantSimulator(delay_inputs(data, samples), order, integrators)
        return fit_linear(delayed).disturbance_rms

    return _descend(min(PROBES, key=scan), scan)


def _descend(best: int, cost: Callable[[int], float]) -> int:
    """Return the delay that costs less than those next to it, from one on."""
    while True:
        near = min((max(best - 1, 0), best, min(best + 1, MOST_LATE)), key=cost)
        if near == best:
            return best
        best = near


def is_delay_better(fits: list[OrderFit], late: list[OrderFit]) -> bool:
    """Return whether fits with a delay are better by BIC; the delay counts as a parameter.

    Clearly better, where the poles without it are those of a plant in continuous time.

    Args:
        fits: one an order, without a delay.
        late: with it.
    """
    best = best_order(fits)
    margin = math.log(fits[0].fit.objective.readings.ok.sum())
    if has_continuous_poles(best.fit):
        margin += CLEARLY  # a fast pole looks much like a delay
    return best_order(late).fit.bic + margin < best.fit.bic


def refine_delay(late: list[OrderFit], samples: int) -> int:
    """Refine the delay by BIC, in steps of a sample while it falls.

    Args:
        late: fits with a delay, one an order.
        samples: the delay.
    """
    best = best_order(late)
    smaller = [one.fit for one in late if one.n <= best.n][-2:]

    @cache
    def scan(trial: int) -> float:
        """Return the BIC of fits with a delay."""
        if trial == samples:
            return best.fit.bic
        return min(_refit_with_delay(fit, trial - samples).bic for fit in smaller)

    return _descend(samples, scan)


def find_equivalents(fits: list[OrderFit], late: list[OrderFit]) -> list[OrderFit]:
    """Find fits that explain a log nearly as well as the chosen fit: the best with a delay, or
    none.

    Args:
        fits: those that were chosen, one an order.
        late: those with the delay that was not.
    """
    other = best_order(late)
    return [other] if other.fit.bic < best_order(fits).fit.bic + REACH else []


def delay_fits(fits: list[OrderFit], samples: int) -> list[OrderFit]:
    """Move the input of fits to later samples and refit; the held-out checks stay.

    Args:
        fits: one an order.
        samples: by how many.
    """
    return [one._replace(fit=_refit_with_delay(one.fit, samples)) for one in fits]


def _refit_with_delay(fit: ZoneFit, samples: int) -> ZoneFit:
    """Fit with a later input, from two starts.

    One has the numerators with which z is nearest to what it was, the other the linear plant.
    """
    objective = fit.objective.objective_along(delay_inputs(fit.objective.data, samples))
    poles = fit.theta[objective.layout.denominator]
    begun = [
        nearest_numbers(fit, objective.simulator, poles),
        _start_from_linear(fit, objective.simulator),
    ]
    tops = [maximise_likelihood(objective, theta, STEPS) for theta in begun]
    return ZoneFit(objective, *max(tops, key=lambda one: one.value))


def _start_from_linear(fit: ZoneFit, simulator: PlantSimulator) -> Floats:
    """Return a start: the widths of a fit, and the linear plant with its gain restored."""
    layout = simulator.layout
    theta = fit.theta.copy()
    plant = fit_linear(simulator).theta
    theta[: layout.right] = plant[: layout.right]
    theta[layout.numerators] *= fit.z.std() / simulator.simulate_z(plant).std()
    theta[layout.log_s] = math.log(ROUGH)
    return theta
