"""Every order fitted to a record: edges never reached put away, glitches left out, delays found.

A delay of the input, in whole samples, is tried where a later input explains the log better.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from undeadzone.errors import InputError
from undeadzone.util.arrays import Floats, Integers
from undeadzone_identify.logs.log import MOST_LATE
from undeadzone_identify.logs.prepare import FAR_EDGE, Prepared
from undeadzone_identify.models.estimates import climb
from undeadzone_identify.models.plant import Simulator, delay_inputs, part_of
from undeadzone_identify.models.zone_fit import Fit, fit_linear, nearest
from undeadzone_identify.selection.orders import (
    OrderFit,
    at_limit,
    best_order,
    fit_orders,
    is_sampled,
)

GLITCH = 8.0  # standard deviations beyond which a reading is no reading
RARE = 0.01  # share of the readings that may be dropped as glitches
PROBES = (0, 1, 2, 3, 5, 7, 10, 14, 19, 25)  # samples
SCREENED = 2  # order of the linear plant
STEPS = 30  # of a climb
ROUGH = 0.3  # rms of what a linear plant leaves, at the start of a climb
CLEARLY = 20.0  # of BIC, by which a delay must be better than more poles
REACH = 6.0  # of BIC: odds of 20 to 1, within which a delay may be the true one


def drop_unvisited_edges(prepared: Prepared) -> tuple[Prepared, tuple[str, ...]]:
    """Return an edge that no reading passes is put far away, and named.

    Args:
        prepared: the log.

    Raises:
        InputError: the plant integrates, so that one edge alone tells nothing.
    """
    data, limits = prepared.data, prepared.limits
    if not data.silent_zeros or prepared.jumps is not None:
        return prepared, ()
    unreached = []
    bounds = {"right": limits.right, "left": limits.left}
    for name, sign in (("right", 1), ("left", -1)):
        free = bounds[name][0] != bounds[name][1]
        if free and not np.any(data.side[data.ok] == sign):
            unreached.append(name)
            bounds[name] = (FAR_EDGE, FAR_EDGE)
    if unreached and limits.tied:
        raise InputError(
            f"log: no reading lies beyond the {' or the '.join(unreached)} edge; z of an"
            " integrating plant has no zero, so nothing is known of the zone: record with a larger"
            " input"
        )
    changed = limits._replace(right=bounds["right"], left=bounds["left"])
    return prepared._replace(limits=changed), tuple(unreached)


class FittedOrders(NamedTuple):
    """Every order, fitted.

    Attributes:
        prepared: the log without glitches, its input shifted.
        fits: one an order.
        delay: samples by which the input acts late.
        alike: a fit with another delay that explains the log as well.
    """

    prepared: Prepared
    fits: list[OrderFit]
    delay: int
    alike: list[OrderFit]


def fit_with_delay(prepared: Prepared, advance: Callable[[int], None]) -> FittedOrders:
    """Return every order, fitted; once more where the input turns out to act later.

    Delay and starts of a long log are found in a part of it.

    Args:
        prepared: the log.
        advance: called with the number of steps just done.

    Raises:
        InputError: no stable plant fits.
    """
    part = part_of(prepared.data)
    if part is prepared.data:
        return _search_delay(prepared, advance)
    begun = _search_delay(prepared._replace(data=part), advance)
    if at_limit(best_order(begun.fits).pairs):  # perhaps since the part is short
        return _search_delay(prepared, advance)
    late = prepared._replace(data=delay_inputs(prepared.data, begun.delay))
    return _fit_every_order(late, advance, begun.fits)._replace(delay=begun.delay)


def _search_delay(prepared: Prepared, advance: Callable[[int], None]) -> FittedOrders:
    """Return `fitted_with_delay` with all samples. Raises InputError."""
    if prepared.options.delay != "auto":
        samples = int(prepared.options.delay)
        shifted = prepared._replace(data=delay_inputs(prepared.data, samples))
        return _fit_every_order(shifted, advance)._replace(delay=samples)
    found = _fit_every_order(prepared, advance)
    samples = likely_delay(found.fits)
    if not samples:
        return found
    late = _refine_delays(found, samples, advance)
    if not better_delay(found.fits, late.fits):
        return found._replace(alike=alike(found.fits, late.fits))
    return late._replace(prepared=late.prepared._replace(orders=prepared.orders))


def _refine_delays(found: FittedOrders, first: int, advance: Callable[[int], None]) -> FittedOrders:
    """Fits with the delay near the first one that serves best; a delay takes no more poles."""
    prepared, most = found.prepared, best_order(found.fits).n
    fewer = [n for n in prepared.orders if n <= most]
    shifted = prepared._replace(data=delay_inputs(prepared.data, first), orders=fewer)
    late = _fit_every_order(shifted, advance)
    more = refine_delay(late.fits, first) - first
    if more:
        shifted = late.prepared._replace(data=delay_inputs(late.prepared.data, more))
        warm = _fit_every_order(shifted, advance, later(late.fits, more))
        cold = _fit_every_order(shifted, advance)
        late = min((warm, cold), key=lambda one: best_order(one.fits).pairs.bic)
    return late._replace(delay=first + more)


def _fit_every_order(
    prepared: Prepared, advance: Callable[[int], None], begun: Sequence[OrderFit] = ()
) -> FittedOrders:
    """Return every order, fitted; once more where a few readings turn out to be glitches."""
    for _ in range(3):
        data, limits = prepared.data, prepared.limits
        held_out, integrators = prepared.options.held_out, prepared.options.integrators
        fits = fit_orders(data, prepared.orders, limits, held_out, advance, integrators, begun)
        if not fits:
            raise InputError(
                "log: no stable plant of these orders fits; try another --order, or another input"
            )
        glitches = _glitches(best_order(fits))
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


def _glitches(chosen: OrderFit) -> Integers:
    """Places of the few readings that the fit cannot have produced."""
    fit = chosen.singles
    ok = fit.objective.readings.ok
    density = fit.objective.at(fit.theta)[1].value
    normal = -0.5 * math.log(2 * math.pi) - math.log(fit.s)
    silent = ok & (fit.objective.readings.side == 0) & fit.objective.data.silent_zeros
    unusual = density - np.where(silent, 0.0, normal) < -0.5 * GLITCH**2
    places = np.flatnonzero(ok & unusual)
    return places if places.size <= RARE * ok.sum() else np.empty(0, int)


# --- Delays


def likely_delay(fits: list[OrderFit]) -> int:
    """Return the delay with which a linear plant of low order explains a log best.

    The zone disturbs these fits much alike; whether the delay is real is decided by fits with it.

    Args:
        fits: one an order, without a delay.

    Returns:
        Samples; 0 where none is better.
    """
    objective = fits[0].pairs.objective
    data, integrators = objective.data, objective.layout.integrators
    order = max(SCREENED, integrators + 1)
    left: dict[int, float] = {}

    def scan(samples: int) -> float:
        if samples not in left:
            fit = fit_linear(Simulator(delay_inputs(data, samples), order, integrators))
            left[samples] = fit.s
        return left[samples]

    best = min(PROBES, key=scan)
    while True:  # to the least next to it
        near = min((max(best - 1, 0), best, best + 1), key=scan)
        if near == best:
            return best
        best = near


def better_delay(fits: list[OrderFit], late: list[OrderFit]) -> bool:
    """Return whether fits with a delay are better by BIC; the delay counts as a number.

    Clearly better, where the poles without it are those of a plant in continuous time.

    Args:
        fits: one an order, without a delay.
        late: with it.
    """
    best = best_order(fits)
    margin = math.log(float(fits[0].pairs.objective.readings.ok.sum()))
    if is_sampled(best.pairs):
        margin += CLEARLY  # a fast pole looks much like a delay
    return best_order(late).pairs.bic + margin < best.pairs.bic


def refine_delay(late: list[OrderFit], samples: int) -> int:
    """By how many samples the input acts late, by BIC: as far from a delay as it gets better.

    Args:
        late: fits with a delay, one an order.
        samples: the delay.
    """
    best = best_order(late)
    smaller = [one.pairs for one in late if one.n <= best.n][-2:]
    known = {samples: best.pairs.bic}
    for direction in (-1, 1):
        trial = samples + direction
        while 0 <= trial <= MOST_LATE:
            known[trial] = min(_late(fit, trial - samples).bic for fit in smaller)
            if known[trial] >= known[trial - direction]:
                break
            trial += direction
    return min(known, key=lambda trial: known[trial])


def alike(fits: list[OrderFit], late: list[OrderFit]) -> list[OrderFit]:
    """What explains a log as well as its best fit, or nearly: the best fit with a delay, or none.

    Args:
        fits: those that were chosen, one an order.
        late: those with the delay that was not.
    """
    other = best_order(late)
    return [other] if other.pairs.bic < best_order(fits).pairs.bic + REACH else []


def later(fits: list[OrderFit], samples: int) -> list[OrderFit]:
    """Fits with the input later, from where they ended; their checks are those of before.

    Args:
        fits: one an order.
        samples: by how many.
    """
    moved = []
    for one in fits:
        singles = _late(one.singles, samples)
        pairs = singles if one.pairs is one.singles else _late(one.pairs, samples)
        moved.append(one._replace(singles=singles, pairs=pairs))
    return moved


def _late(fit: Fit, samples: int) -> Fit:
    """Return a fit with the input later, from two starts.

    One has the numerators with which z is nearest to what it was, the other the linear plant.
    """
    objective = fit.objective.along(delay_inputs(fit.objective.data, samples))
    poles = fit.theta[objective.layout.a]
    begun = [nearest(fit, objective.simulator, poles), _linear(fit, objective.simulator)]
    tops = [climb(objective, theta, STEPS) for theta in begun]
    return Fit(objective, *max(tops, key=lambda one: one.value))


def _linear(fit: Fit, simulator: Simulator) -> Floats:
    """Return the widths of a fit, and the linear plant with the gain that these take away."""
    layout = simulator.layout
    theta = fit.theta.copy()
    plant = fit_linear(simulator).theta
    theta[: layout.right] = plant[: layout.right]
    theta[layout.b] *= float(fit.z.std() / simulator.z(plant).std())
    theta[layout.right + 2] = math.log(ROUGH)
    return theta
