"""`identify`: from a log to plant, widths and verdict."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from undeadzone.errors import InputError
from undeadzone.identification.answer import Answer, Evidence
from undeadzone.identification.excitation import FEW_VISITS, excitation
from undeadzone.identification.fit import polished
from undeadzone.identification.grid import Grid, shortened, to_grid
from undeadzone.identification.intervals import Interval, Widths, find_widths, lower_bound
from undeadzone.identification.kalman_likelihood import KalmanFit, fit_kalman
from undeadzone.identification.kalman_smoother import innovations
from undeadzone.identification.log import Log
from undeadzone.identification.no_zone import judge_no_zone
from undeadzone.identification.objective import Limits
from undeadzone.identification.options import Options
from undeadzone.identification.orders import (
    OrderFit,
    best_order,
    credible,
    fit_orders,
    hears_input,
    is_white,
    trained_part,
)
from undeadzone.identification.place import Place, find_place
from undeadzone.identification.plant_fit import Data
from undeadzone.identification.prepare import FAR_EDGE, Prepared, prepare
from undeadzone.identification.readers import log_of_arrays, read_log
from undeadzone.identification.residual_map import residual_map
from undeadzone.identification.result import Identified
from undeadzone.identification.static_rivals import better_rivals, static_rivals
from undeadzone.identification.verdict import Verdict, place_verdict, rescued, static_verdict

GLITCH = 8.0  # standard deviations beyond which a reading is no reading
RARE = 0.01  # share of the readings that may be dropped as glitches


def identify(
    log: Any = None,
    *,
    t: Any = None,
    u: Any = None,
    y: Any = None,
    order: str | int = "1-4",
    right: str | float | None = None,
    left: str | float | None = None,
    offset: str | float = 0.0,
    held_out: float = 0.3,
    noise: str = "auto",
    place: str = "auto",
    threshold: float | None = None,
    resample: float | None = None,
    integrators: int = 0,
    columns: str | None = None,
    progress: Callable[[int], None] | None = None,
) -> Identified:
    """Find plant and dead zone from a log, with intervals that hold (docs/identify.md).

    Args:
        log: path of a CSV, .npz or .mat file, a pandas DataFrame, or a list of these: several
            records of one plant.
        t: times (N) [s], or the step; with u and y, in place of `log`.
        u: inputs (N) or (N x m).
        y: readings (N); NaN where one is missing.
        order: orders of the plant to try, as 2 or "1-4".
        right: d_r if known, "0.2,1.0" for bounds, inf for no such edge [y].
        left: the same for d_l.
        offset: rms of a constant offset of the output [y], or "free".
        held_out: share of the log, at its end, that checks the fit.
        noise: "before" the zone, "after" it, or "auto".
        place: "sensor" where the user knows that the zone is there, or "auto".
        threshold: |y| up to which a reading is silent [y]; default half the quantum.
        resample: step [s] for logs of irregular step.
        integrators: how many poles of the plant are integrators: 1 where a motor's position is
            read.
        columns: which column is which where names do not say it: `t=1,y=angle,u=voltage`.
        progress: called with the number of steps just done.

    Returns:
        Verdict, widths with intervals, plant, states, scenario.

    Raises:
        FileError: a log that cannot be read.
        InputError: a log from which nothing can be learnt, or an option that cannot be used.
    """
    words = {"noise": ("before", "after", "auto"), "place": ("sensor", "auto")}
    for name, value in (("noise", noise), ("place", place)):
        if value not in words[name]:
            raise InputError(f"{name}: expected {', '.join(words[name])}; found {value!r}")
    options = Options(
        order=str(order),
        right=None if right is None else str(right),
        left=None if left is None else str(left),
        offset=str(offset),
        held_out=float(held_out),
        noise=noise,  # type: ignore[arg-type]
        place=place,  # type: ignore[arg-type]
        threshold=threshold,
        resample=resample,
        integrators=int(integrators),
    ).checked()
    logs = _logs(log, t, u, y, columns)
    return identify_grid(to_grid(logs, resample), options, progress or _ignore)


def _ignore(done: int) -> None:
    """Nothing to report to."""


def _logs(log: Any, t: Any, u: Any, y: Any, columns: str | None) -> list[Log]:
    """The logs that a user gave as files, frames or arrays. Raises InputError."""
    arrays = [value is not None for value in (t, u, y)]
    if log is None:
        if not all(arrays):
            raise InputError("identify: give a log, or t, u and y")
        return [log_of_arrays(t, u, y)]
    if any(arrays):
        raise InputError("identify: give a log, or t, u and y, not both")
    sources = log if isinstance(log, list | tuple) else [log]
    if not sources:
        raise InputError("identify: the list of logs is empty")
    return [read_log(source, columns) for source in sources]


def identify_grid(grid: Grid, options: Options, advance: Callable[[int], None]) -> Identified:
    """Find plant and dead zone from records on a regular grid.

    Args:
        grid: the records.
        options: what the user said.
        advance: called with the number of steps just done.

    Returns:
        The answer.

    Raises:
        InputError: nothing can be learnt.
    """
    grid = shortened(grid)
    prepared = prepare(grid, options)
    prepared, unreached = _without_unreached(prepared)
    prepared, fits = _fitted(prepared, options, advance)
    chosen = best_order(fits)
    pairs = polished(chosen.pairs)
    singles = pairs if chosen.pairs is chosen.singles else polished(chosen.singles)
    chosen = chosen._replace(singles=singles, pairs=pairs)
    data = prepared.data
    no_zone = judge_no_zone(chosen.pairs)
    if no_zone.fit is not chosen.pairs:
        chosen = chosen._replace(singles=no_zone.fit, pairs=no_zone.fit)
    residuals = residual_map(chosen.singles)
    rivals = static_rivals(chosen.singles)
    if fits[-1].n > chosen.n:  # another map may need more poles than the zone was given
        rivals = better_rivals(rivals, static_rivals(fits[-1].singles))
    advance(1)
    quantum = grid.quantum / data.y_scale
    verdict = static_verdict(data, chosen, no_zone, residuals, rivals, quantum)
    kalman: list[KalmanFit] = []
    place = None
    if verdict.word == "dead_zone":
        kalman, verdict, place = _place_and_disturbance(
            data, chosen, verdict, options, unreached, quantum, advance
        )
    elif options.place == "auto" and data.start.size == 1 and not (unreached or options.integrators):
        elsewhere = find_place(chosen.pairs)
        verdict_there = rescued(verdict, elsewhere, rivals)
        place = None if verdict_there is verdict else elsewhere
        verdict = verdict_there
    offset = options.offset_rms()
    widths = find_widths(
        chosen,
        credible(fits),
        kalman[0] if kalman else None,
        quantum,
        None if offset is None else offset / data.y_scale,
    )
    excited = excitation(
        data.readings(), chosen.pairs.z, widths.right.value, widths.left.value, data.silent_zeros
    )
    if kalman:
        chosen = chosen._replace(white=_white_after_filter(kalman[0], options.held_out))
    evidence = Evidence(
        grid,
        fits,
        chosen,
        kalman,
        no_zone,
        residuals,
        rivals,
        place,
        excited,
        widths,
        unreached,
    )
    advance(1)
    return Identified(_answer(prepared, options, evidence, verdict))


def _without_unreached(prepared: Prepared) -> tuple[Prepared, tuple[str, ...]]:
    """An edge that no reading passes is put far away, and named."""
    data, limits = prepared.data, prepared.limits
    if not data.silent_zeros:
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
            f"log: no reading lies beyond the {' or the '.join(unreached)} edge; z of an integrating "
            "plant has no zero, so nothing is known of the zone: record with a larger input"
        )
    changed = limits._replace(right=bounds["right"], left=bounds["left"])
    return prepared._replace(limits=changed), tuple(unreached)


def _fitted(
    prepared: Prepared, options: Options, advance: Callable[[int], None]
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


def _place_and_disturbance(
    data: Data,
    chosen: OrderFit,
    verdict: Verdict,
    options: Options,
    unreached: tuple[str, ...],
    quantum: float,
    advance: Callable[[int], None],
) -> tuple[list[KalmanFit], Verdict, Place | None]:
    """The third stage and the place of the zone, where they can be asked."""
    kalman = []
    if data.silent_zeros and chosen.pairs.objective.kind == "pairs":
        kalman = fit_kalman(chosen.pairs)
    advance(1)
    if options.place == "sensor" or data.start.size > 1 or unreached or options.integrators:
        return kalman, verdict, None
    place = find_place(chosen.pairs)
    advance(1)
    silenced = bool(kalman) and kalman[0].r > max(2 * quantum, 0.01)
    return kalman, place_verdict(verdict, place, silenced), place


def _white_after_filter(kalman: KalmanFit, held_out: float) -> bool:
    """Whether the filter's one-step errors on the held-out part are white, where it speaks."""
    data = kalman.objective.data
    use = data.ok & (data.side != 0) & ~trained_part(data, held_out)
    return is_white(innovations(kalman), use)


def _answer(prepared: Prepared, options: Options, evidence: Evidence, verdict: Verdict) -> Answer:
    """The answer in the units of the log."""
    chosen = evidence.chosen
    simulator = chosen.pairs.objective.simulator
    data = prepared.data
    poles = simulator.poles(chosen.pairs.theta).astype(complex)
    with np.errstate(divide="ignore"):
        rates = np.log(poles) / evidence.grid.step
    gain = simulator.gain(chosen.pairs.theta) * data.y_scale / data.u_scale
    gain /= evidence.grid.step**options.integrators
    remarks = [*prepared.remarks, *verdict.cautions]
    shown: dict[str, Interval | None] = dict.fromkeys(("right", "left", "width", "centre"))
    word = verdict.word
    if word == "dead_zone":
        remarks += evidence.widths.remarks
        heard = hears_input(chosen.pairs)
        if heard:
            remarks.append(
                "past inputs explain part of the one-step residual: a delay, or too few poles; the"
                " plant model does not fit, and the intervals are doubled; try a higher --order, or"
                " shift the input by the delay"
            )
        shown = _shown(evidence, options, data.y_scale, 2.0 if heard else 1.0)
        if evidence.unreached:
            word = "unreached"
            remarks += [
                f"no reading lies beyond the {name} edge: record with a larger input, or say"
                f" --{name} inf if there is none"
                for name in evidence.unreached
            ]
        if chosen.pairs.objective.limits.tied:
            remarks.append(
                "z of an integrating plant has no zero of its own: it counts from the middle of the"
                " zone, so both edges are half of the width; the place of the zone is not asked"
            )
        for name in ("right", "left"):
            edge = shown[name]
            if edge is not None and edge.value < 0:
                remarks.append(
                    f"d_{name} is negative: the zone does not hold z = 0, as after an offset of the"
                    " input or of the output; the width is not touched by that"
                )
        for name, visits in zip(("right", "left"), evidence.excitation.visits, strict=True):
            if 0 < visits < FEW_VISITS:
                remarks.append(f"the {name} edge is passed {visits} times only: hardly known")
    return Answer(
        word,
        verdict.reasons,
        shown["right"],
        shown["left"],
        shown["width"],
        shown["centre"],
        chosen.n,
        rates,
        gain,
        remarks,
        options,
        evidence,
    )


def _shown(
    evidence: Evidence, options: Options, scale: float, wider: float
) -> dict[str, Interval | None]:
    """The widths in the units of the log; an edge never reached has a lower bound alone."""
    widths: Widths = evidence.widths
    shown: dict[str, Interval | None] = {}
    for name in ("right", "left", "width", "centre"):
        interval = getattr(widths, name).scaled(scale)
        half = wider * interval.half
        shown[name] = Interval(interval.value, interval.value - half, interval.value + half)
    for name in ("right", "left"):
        low, high = options.bounds("right" if name == "right" else "left")
        if low == high:
            shown[name] = None if low == math.inf else Interval(low, low, high)
        if low == math.inf:
            shown["width"] = shown["centre"] = None
    if evidence.chosen.pairs.objective.limits.tied:
        shown["centre"] = None
    for name in evidence.unreached:
        bound = lower_bound(evidence.chosen.singles, name) * scale
        shown[name] = Interval(bound, bound, math.inf)
        shown["width"] = shown["centre"] = None
    return shown
