"""From the records of one output to the answer: fit, verdict, place, disturbance, widths."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np

from undeadzone.identification.answer import Evidence
from undeadzone.identification.climb import KeptClimbs
from undeadzone.identification.excitation import excitation
from undeadzone.identification.first_fit import fitted_with_delay, without_unreached
from undeadzone.identification.fit import Fit, polished
from undeadzone.identification.grid import Grid, shortened
from undeadzone.identification.intervals import find_widths
from undeadzone.identification.kalman_fit import KalmanFit, fit_kalman
from undeadzone.identification.kalman_smoother import innovations
from undeadzone.identification.no_zone import judge_no_zone
from undeadzone.identification.objective import Objective
from undeadzone.identification.options import Options
from undeadzone.identification.orders import (
    OrderFit,
    best_order,
    credible,
    is_white,
    trained_part,
)
from undeadzone.identification.place import find_place
from undeadzone.identification.plant_fit import Simulator
from undeadzone.identification.prepare import Prepared, prepare
from undeadzone.identification.records import longest_record, reduced
from undeadzone.identification.residual_map import residual_map
from undeadzone.identification.result import Identified
from undeadzone.identification.static_rivals import Density, better_rivals, static_rivals
from undeadzone.identification.to_answer import to_answer
from undeadzone.identification.unmodelled import unmodelled
from undeadzone.identification.verdict import (
    jump_verdict,
    place_verdict,
    rescued,
    saturated,
    static_verdict,
)


def identify_output(
    grid: Grid,
    options: Options,
    advance: Callable[[int], None],
    climbs: KeptClimbs | None = None,
) -> Identified:
    """Find plant and zone from records of one output on a regular grid.

    Args:
        grid: the records.
        options: what the user said.
        advance: called with the number of steps just done.
        climbs: those that are on disk; None: none are.

    Returns:
        The answer.

    Raises:
        InputError: nothing can be learnt.
    """
    grid = shortened(grid)
    prepared = prepare(grid, options)
    prepared = prepared._replace(data=prepared.data._replace(climbs=climbs))
    prepared, unreached = without_unreached(prepared)
    prepared, fits, delay = fitted_with_delay(prepared, options, advance)
    chosen = _polished(best_order(fits))
    data = prepared.data
    no_zone = judge_no_zone(chosen.pairs)
    if no_zone.fit is not chosen.pairs:
        chosen = chosen._replace(singles=no_zone.fit, pairs=no_zone.fit)
    residuals = residual_map(chosen.singles)
    rivals = _rivals(prepared, chosen, fits)
    advance(1)
    quantum = grid.quantum / data.y_scale
    if prepared.jumps is None:
        verdict = static_verdict(data, chosen, no_zone, residuals, rivals, quantum)
        verdict = saturated(verdict, prepared.ends)
    else:
        verdict = jump_verdict(data, chosen, residuals, rivals)
    if prepared.jumps is None and verdict.word == "jump" and _can_be_jump(prepared, options):
        as_jump = msgspec.structs.replace(options, kind="jump")
        return identify_output(grid, as_jump, advance, climbs)
    asks_place = _asks_place(prepared, options, unreached)
    kalman: list[KalmanFit] = []
    place = None
    is_jump = prepared.jumps is not None and verdict.word == "jump"
    if verdict.word == "dead_zone" or is_jump:
        if data.silent_zeros and chosen.pairs.objective.kind == "pairs":
            kalman = fit_kalman(chosen.pairs)
        advance(1)
        if asks_place:
            place = find_place(longest_record(chosen.pairs))
            silenced = bool(kalman) and kalman[0].r > max(2 * quantum, 0.01)
            verdict = place_verdict(verdict, place, silenced)
            advance(1)
    elif asks_place:
        elsewhere = find_place(longest_record(chosen.pairs))
        one = longest_record(chosen.singles)
        beside = rivals if one is chosen.singles else static_rivals(one)
        there = rescued(verdict, elsewhere, beside)
        place = None if there is verdict else elsewhere
        verdict = there
    if verdict.word in ("dead_zone", "other", "unclear"):
        verdict = unmodelled(verdict, chosen.pairs)
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
        grid=grid,
        orders=fits,
        chosen=chosen,
        kalman=kalman,
        no_zone=no_zone,
        residuals=residuals,
        rivals=rivals,
        place=place,
        excitation=excited,
        widths=widths,
        unreached=unreached,
        jumps=prepared.jumps,
        delay=delay,
    )
    advance(1)
    return Identified(to_answer(prepared, options, evidence, verdict))


def _polished(chosen: OrderFit) -> OrderFit:
    """The chosen order at the very top of both likelihoods."""
    pairs = polished(chosen.pairs)
    singles = pairs if chosen.pairs is chosen.singles else polished(chosen.singles)
    return chosen._replace(singles=singles, pairs=pairs)


def _rivals(prepared: Prepared, chosen: OrderFit, fits: list[OrderFit]) -> dict[str, Density]:
    """Static rivals, on the readings as they are."""
    rivals = static_rivals(_of_readings(prepared, reduced(chosen.singles)))
    if fits[-1].n > chosen.n:  # another map may need more poles than the zone was given
        larger = static_rivals(_of_readings(prepared, reduced(fits[-1].singles)))
        rivals = better_rivals(rivals, larger)
    return rivals


def _of_readings(prepared: Prepared, fit: Fit) -> Fit:
    """The fit with the readings of a jump sensor as they are, not less its edges."""
    if prepared.jumps is None:
        return fit
    old = fit.objective
    shift = prepared.jumps[0].value * (old.data.side > 0)
    shift = shift - prepared.jumps[1].value * (old.data.side < 0)
    data = old.data._replace(y=np.where(old.data.ok, old.data.y + shift, 0.0))
    simulator = Simulator(data, old.layout.n, old.layout.integrators)
    return fit._replace(objective=Objective(simulator, old.kind, old.limits))


def _can_be_jump(prepared: Prepared, options: Options) -> bool:
    """Whether the edges of a jump sensor can be read off."""
    return options.kind == "auto" and prepared.data.silent_zeros and not options.integrators


def _asks_place(prepared: Prepared, options: Options, unreached: tuple[str, ...]) -> bool:
    """Whether the place of the zone is asked."""
    known = options.place == "sensor" or prepared.jumps is not None
    return not (known or unreached or options.integrators)


def _white_after_filter(kalman: KalmanFit, held_out: float) -> bool:
    """Whether the filter's one-step errors on the held-out part are white, where it speaks."""
    data = kalman.objective.data
    use = data.ok & (data.side != 0) & ~trained_part(data, held_out)
    return is_white(innovations(kalman), use)
