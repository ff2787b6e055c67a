"""Every order fitted to a record: edges never reached put away, glitches left out, delays found."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from undeadzone.errors import InputError
from undeadzone.identification.delay import better_delay, delayed, likely_delay, refined_delay
from undeadzone.identification.options import Options
from undeadzone.identification.orders import OrderFit, at_limit, best_order, fit_orders
from undeadzone.identification.prepare import FAR_EDGE, Prepared
from undeadzone.identification.records import part_of

GLITCH = 8.0  # standard deviations beyond which a reading is no reading
RARE = 0.01  # share of the readings that may be dropped as glitches


def without_unreached(prepared: Prepared) -> tuple[Prepared, tuple[str, ...]]:
    """An edge that no reading passes is put far away, and named.

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


def fitted_with_delay(
    prepared: Prepared, options: Options, advance: Callable[[int], None]
) -> tuple[Prepared, list[OrderFit], int]:
    """Every order, fitted; once more where the input turns out to act later.

    Delay and starts of a long log are found in a part of it.

    Args:
        prepared: the log.
        options: what the user said.
        advance: called with the number of steps just done.

    Returns:
        The log (without glitches, its input shifted), a fit an order, and the delay in samples.

    Raises:
        InputError: no stable plant fits.
    """
    part = part_of(prepared.data)
    if part is prepared.data:
        return _searched(prepared, options, advance)
    _, begun, delay = _searched(prepared._replace(data=part), options, advance)
    if at_limit(best_order(begun)):  # perhaps since the part is short
        return _searched(prepared, options, advance)
    late = prepared._replace(data=delayed(prepared.data, delay))
    return *_fitted(late, options, advance, begun), delay


def _searched(
    prepared: Prepared, options: Options, advance: Callable[[int], None]
) -> tuple[Prepared, list[OrderFit], int]:
    """`fitted_with_delay` with all samples. Raises InputError."""
    if options.delay != "auto":
        samples = int(options.delay)
        data = delayed(prepared.data, samples)
        prepared, fits = _fitted(prepared._replace(data=data), options, advance)
        return prepared, fits, samples
    prepared, fits = _fitted(prepared, options, advance)
    samples = likely_delay(fits)
    if not samples:
        return prepared, fits, 0
    late = _fitted(prepared._replace(data=delayed(prepared.data, samples)), options, advance)
    if not better_delay(fits, late[1]):
        return prepared, fits, 0
    more = refined_delay(late[1])
    if more:
        samples += more
        data = delayed(prepared.data, samples)
        late = _fitted(prepared._replace(data=data), options, advance)
    return *late, samples


def _fitted(
    prepared: Prepared,
    options: Options,
    advance: Callable[[int], None],
    begun: Sequence[OrderFit] = (),
) -> tuple[Prepared, list[OrderFit]]:
    """Every order, fitted; once more where a few readings turn out to be glitches."""
    for _ in range(3):
        fits = fit_orders(
            prepared.data,
            prepared.orders,
            prepared.limits,
            options.held_out,
            advance,
            options.integrators,
            begun,
        )
        if not fits:
            raise InputError(
                "log: no stable plant of these orders fits; try another --order, or another input"
            )
        glitches = _glitches(best_order(fits))
        if not glitches.size:
            break
        ok = prepared.data.ok.copy()
        ok[glitches] = False
        remark = (
            f"{glitches.size} readings more than {GLITCH:g} standard deviations off are taken as"
            " missing"
        )
        data = prepared.data._replace(ok=ok, y=np.where(ok, prepared.data.y, 0.0))
        prepared = prepared._replace(data=data, remarks=[*prepared.remarks, remark])
    return prepared, fits


def _glitches(chosen: OrderFit) -> Any:
    """Places of the few readings that the fit cannot have produced."""
    fit = chosen.singles
    ok = fit.objective.readings.ok
    density = fit.objective.per_sample(fit.theta)
    normal = -0.5 * math.log(2 * math.pi) - math.log(fit.s)
    silent = ok & (fit.objective.readings.side == 0) & fit.objective.data.silent_zeros
    unusual = density - np.where(silent, 0.0, normal) < -0.5 * GLITCH**2
    places = np.flatnonzero(ok & unusual)
    return places if places.size <= RARE * ok.sum() else np.empty(0, int)
