"""`identify`: from a log to plant, widths and verdict.

Of each output plants of every order are fitted with a dead zone of the sensor, and static maps in
its place. Then one hypothesis after another is tested. If the findings so far leave it open, its
model is fitted and compared, and its parameters are estimated. The last findings are the answer.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from undeadzone.errors import InformationError, InputError
from undeadzone.nonlinearities.sensor import offset
from undeadzone.util.answers import Answers
from undeadzone.util.installed import use_one_blas_thread
from undeadzone.util.progress import notebook_progress
from undeadzone_identify.logs.grid import Grid, find_sample_time, shorten_log, to_grid
from undeadzone_identify.logs.log import AT_ONCE, Log, Options, log_from_arrays
from undeadzone_identify.logs.loops import read_log_or_loop
from undeadzone_identify.logs.prepare import (
    PreparedLog,
    feasible_orders,
    find_silent_level,
    has_jump_edges,
    prepare_log,
    require_readings,
)
from undeadzone_identify.looks.first import Looks, look_at
from undeadzone_identify.models.chain import find_input_zero, fit_chains
from undeadzone_identify.models.elements import (
    MapModel,
    best_maps,
    fit_limits,
    fit_maps,
    has_strong_curve,
)
from undeadzone_identify.models.estimates import CachedMaxima, array_digest
from undeadzone_identify.models.kalman_fit import fit_kalman
from undeadzone_identify.models.least_squares import FittedModel
from undeadzone_identify.models.lost_motion import reversal_blocks
from undeadzone_identify.models.plant import PlantSimulator, longest_record_of
from undeadzone_identify.models.zone_fit import (
    ZoneFit,
    polish_fit,
    refit_busiest_part,
    refit_longest_record,
)
from undeadzone_identify.results.account import MEASURED, OPEN, Account
from undeadzone_identify.results.assemble import to_answer
from undeadzone_identify.results.at_rest import IdentifiedAtRest
from undeadzone_identify.results.loop import IdentifiedLoop
from undeadzone_identify.results.lost_motion import IdentifiedMotion
from undeadzone_identify.results.result import Identified, IdentifiedOutputs
from undeadzone_identify.results.seen import (
    account_of_looks,
    choose_account,
    needs_no_plant,
    rests_in_holds,
)
from undeadzone_identify.results.speech import EFFECT_OF, find_alike_at_input
from undeadzone_identify.selection import orders
from undeadzone_identify.selection.adequacy import (
    DEPENDS,
    find_remainders,
    largest_remainder,
)
from undeadzone_identify.selection.alternatives import (
    Findings,
    add_named_element,
    add_play,
    add_play_gap,
    deny_shaped_zone_without_width,
    has_a_model,
    has_hidden_readings,
    holds_more,
    may_have_shaped_zone,
    needs_an_element,
    with_adequacy,
    withhold_hidden_readings,
    without_needless,
)
from undeadzone_identify.selection.decision import (
    LEAST,
    MEMORY,
    Case,
    build_verdict,
    withdraw_zone_with_offset,
)
from undeadzone_identify.selection.delays import (
    delay_fits,
    drop_unvisited_edges,
    fit_with_delay,
    is_delay_better,
)
from undeadzone_identify.selection.location import find_zone_locations, is_rounding_play
from undeadzone_identify.selection.loop import LEAST as LEAST_OF_LOOP
from undeadzone_identify.selection.loop import (
    LoopFindings,
    find_loop_cause,
    is_loop,
    is_named_loop,
)
from undeadzone_identify.selection.lost_motion import (
    TURNS,
    find_lost_motion,
    is_motor_position,
    needs_motion_test,
    without_drive,
)
from undeadzone_identify.selection.servo import (
    UNDECIDED,
    add_servo,
    add_servo_element,
    has_no_gap,
    identify_tick_servo,
    needs_servo_test,
    to_servo_options,
    without_gap,
)
from undeadzone_identify.servo.gap import ServoGap

Found = Identified | IdentifiedOutputs | IdentifiedMotion | IdentifiedAtRest | IdentifiedLoop
TABLE = "rows of the log"
INTEGRATES = (
    "a torque or current moves a position, by their names, and no plant that settles explains it:"
    " taken to integrate, as with --integrators 1"
)


def identify(
    log: Any = None,
    *,
    t: Any = None,
    u: Any = None,
    y: Any = None,
    r: Any = None,
    order: str | int = "1-4",
    right: str | float | None = None,
    left: str | float | None = None,
    offset: str | float = 0,
    held_out: float = 0.3,
    noise: str = "auto",
    place: str = "auto",
    kind: str = "auto",
    delay: str | int = "auto",
    zero: float = 0.0,
    threshold: float | None = None,
    resample: float | None = None,
    integrators: int = 0,
    columns: str | None = None,
    strict: bool = False,
    progress: Callable[[int], None] | None = None,
    keep: Path | None = None,
    resume: bool = False,
) -> Identified | IdentifiedOutputs | IdentifiedMotion | IdentifiedAtRest | IdentifiedLoop:
    """Find plant and dead zone from a log, with intervals that hold (docs/identify.md).

    Args:
        log: path of a CSV, .npz, .mat or .jsonl file, a pandas DataFrame, or a list of
            these: several records of one plant.
        t: times (N) [s], or the step; with u and y, in place of `log`.
        u: inputs (N) or (N x m).
        y: readings (N) or (N x p); NaN if one is missing.
        r: the reference of a closed loop (N), NaN if it is missing; None: not recorded.
        order: orders of the plant to try, as 2 or "1-4".
        right: d_r if known, "0.2,1.0" for bounds, inf for no such edge [y].
        left: the same for d_l.
        offset: rms of a constant offset of the output [y], or "free".
        held_out: share of the log, in blocks over it, that checks the fit.
        noise: "before" the zone, "after" it, or "auto".
        place: where the user knows that the zone is: "sensor", "actuator" or "plant" (friction);
            or "auto".
        kind: "deadzone", "jump" (readings are not shifted), "play" or "auto".
        delay: samples by which the recording makes the input late, or "auto" to find how late it
            acts.
        zero: reading of the sensor inside its zone [y].
        threshold: |y| up to which a reading is silent [y]; default half the quantum.
        resample: step [s] for logs of irregular step.
        integrators: how many poles of the plant are integrators: 1 if a motor's position is
            read.
        columns: which column is which where names do not say it: `t=1,y=angle,u=voltage`.
        strict: whether a line that cannot be read is an error; else its sample is missing.
        progress: called with the number of steps just done; None: a bar in a notebook.
        keep: file that keeps the fits, to be deleted once the answer is; None: none.
        resume: whether to go on from `keep` of a stopped call.

    Returns:
        Verdict, widths with intervals, plant, states, scenario; of several outputs one such
        answer each; of two positions the motion that is lost between them; of a table or a slow
        sweep the map at rest; of OP, PV and SP why the loop swings. Each has an
        `account`: effect, cost, remedy, what is not decided.

    Raises:
        FileError: a log that cannot be read, or `keep`.
        InputError: a log from which nothing can be learnt, or an option that cannot be used.

    Example:
        >>> import numpy as np
        >>> rng = np.random.default_rng(1)
        >>> u = np.repeat(rng.normal(0.0, 2.0, 150), 10)
        >>> z = np.zeros(1500)
        >>> for k in range(1499):
        ...     z[k + 1] = 0.9 * z[k] + 0.1 * u[k]
        >>> y = np.where(z > 0.5, z - 0.5, np.where(z < -0.3, z + 0.3, 0.0))
        >>> y = y + rng.normal(0.0, 0.005, 1500)
        >>> found = uz.identify(t=0.05, u=u, y=y, order=1)
        >>> found.verdict
        'dead_zone'
        >>> found.right.low < 0.5 < found.right.high
        True

    See Also:
        estimate, export, simulate
    """
    options = Options(
        order=str(order),
        right=None if right is None else str(right),
        left=None if left is None else str(left),
        offset=str(offset),
        held_out=float(held_out),
        noise=noise,  # type: ignore[arg-type]
        place=place,  # type: ignore[arg-type]
        kind=kind,  # type: ignore[arg-type]
        delay=str(delay),
        zero=float(zero),
        threshold=threshold,
        resample=resample,
        integrators=int(integrators),
    ).require_usable()
    logs = [
        one._replace(y=one.y - options.zero)
        for one in _collect_logs(log, (t, u, y, r), columns, strict)
    ]
    with use_one_blas_thread(), notebook_progress(progress, "identifying", None) as advance:
        if keep is None:
            return _identify_logs(logs, options, advance)
        return _identify_with_cache(logs, options, advance, keep, resume)


def _identify_with_cache(
    logs: list[Log],
    options: Options,
    advance: Callable[[int], None],
    keep: Path,
    resume: bool,
) -> Found:
    """Return the answer, with the fits cached in a file meanwhile. Raise InputError."""
    answers = Answers(keep, _cache_key(logs, options), "fits", resume)
    climbs = CachedMaxima(answers)
    with answers.hold_file():
        try:
            return _identify_logs(logs, options, advance, climbs)
        except Exception as error:  # nothing was stopped, and what fails would fail again
            refused = error
        finally:
            climbs.stop_caching()
    answers.delete_file()
    raise refused


def _cache_key(logs: list[Log], options: Options) -> dict[str, Any]:
    """Return the data and options that a fit depends on, arrays as digests."""
    digests = [list(map(array_digest, (log.t, log.u, log.y))) for log in logs]
    return {"logs": digests, "options": msgspec.to_builtins(options)}


def _identify_logs(
    logs: list[Log],
    options: Options,
    advance: Callable[[int], None],
    cached_maxima: CachedMaxima | None = None,
) -> Found:
    """Identify the records: return the answer for one output, or the answers for several.

    Two positions of one log are first fitted with lost motion, which needs no plant. If that is not
    conclusive, a plant with a dead zone is fitted for each output. If no plant fits, the lost
    motion is the answer after all.

    Args:
        logs: records of the same plant.
        options: of the user.
        advance: called with the number of steps just done.
        cached_maxima: cache of the likelihoods' maxima (None: not cached).

    Raises:
        InputError: nothing can be learnt, or the records differ in their outputs.
    """
    names = logs[0].outputs
    for log in logs:
        if len(log.outputs) != len(names):
            raise InputError(f"{log.source}: has {len(log.outputs)} outputs, others {len(names)}")
    motion, looks, seen = None, Looks(), None
    is_conclusive = False  # the lost motion is the answer, whatever plant fits
    is_one = len(logs) == len(names) == 1
    with_drive, logs = logs, list(map(without_drive, logs))
    is_plain = msgspec.structs.replace(options, delay="auto") == Options()  # a map has no delay
    if is_one and is_plain:
        looks = look_at(logs[0])
        seen = account_of_looks(logs[0], looks)
    is_long = max(log.t.size for log in logs) >= LEAST_OF_LOOP
    if is_plain and is_long and all(map(is_loop, logs)) and not rests_in_holds(looks):
        return IdentifiedLoop(tuple(logs), find_loop_cause(logs))
    if is_one and is_named_loop(logs[0]) and not rests_in_holds(looks):
        looks, seen = Looks(), None  # a loop that swings is no map
    if is_one and looks.rests is None and needs_motion_test(with_drive[0]):
        motion, is_conclusive = find_lost_motion(with_drive[0], options)
        advance(1)
    is_seen = seen is not None and seen.grade == MEASURED
    if motion is not None and is_conclusive and (motion.are_positions or not is_seen):
        return IdentifiedMotion(motion)
    if seen is not None and needs_no_plant(seen, looks):
        return IdentifiedAtRest(logs[0], looks, seen)
    outputs = ([log.select_output(k) for log in logs] for k in range(len(names)))
    try:
        if motion is not None and motion.are_positions and not find_sample_time(logs[0])[1]:
            raise InputError("irregular steps, and no plant is fitted to positions between them")
        require_readings(sum(int(np.isfinite(log.y).sum(axis=0).max()) for log in logs))
        grids = (
            to_grid(records, options.resample)._replace(climbs=cached_maxima) for records in outputs
        )
        answers = [identify_output(grid, options, advance) for grid in grids]
        if len(answers) == 1 and answers[0].verdict in UNDECIDED and _may_integrate(logs, options):
            grid = to_grid(logs, options.resample)._replace(climbs=cached_maxima)
            answers = [_integrate_motor(grid, options, advance, answers[0])]
    except InputError as error:  # no plant fits, or an irregular step, which positions may have
        failure = error
    else:
        if len(answers) > 1:
            return IdentifiedOutputs(names, tuple(answers))
        (one,) = answers
        swing = _find_swing(logs, one) if is_plain and is_long else None
        if swing is not None:
            return IdentifiedLoop(tuple(logs), swing)
        spoken = choose_account(
            one.account, seen, looks, lambda: not find_alike_at_input(one.answer)
        )
        return dataclasses.replace(one, spoken=spoken)
    answers_no = isinstance(failure, InformationError) or not logs[0].has_clock  # a table
    if seen is None and is_one and is_plain and answers_no:
        seen = Account(OPEN, {}, TABLE, (logs[0].input_unit, logs[0].output_units[0]))
    if seen is not None:
        return IdentifiedAtRest(logs[0], looks, seen.with_doubts(f"no plant was fitted: {failure}"))
    if motion is None or not motion.are_positions:
        raise failure
    no_plant = f"no plant was fitted: {failure}"
    return IdentifiedMotion(motion._replace(reasons=[*motion.reasons, no_plant]))


def _find_swing(logs: list[Log], one: Identified) -> LoopFindings | None:
    """Return why a loop without a loop's names swings, if no plant is named but a cause is."""
    loop, servo = one.answer.loop, one.answer.servo
    is_open = one.verdict in UNDECIDED and servo is None
    is_fed_back = loop.is_closed or (loop.answered is None and logs[0].r.size > 0)
    if not (is_open and is_fed_back and logs[0].input_kinds in (("other",), ("op",))):
        return None  # names of a machine's input are no valve's
    try:
        found = find_loop_cause(logs)
    except InputError:  # OP rests, or too many readings are missing
        return None
    return found if found.word in EFFECT_OF else None


def _collect_logs(
    log: Any, arrays: tuple[Any, ...], columns: str | None, strict: bool
) -> list[Log]:
    """Read the logs that a user gave as files, frames or arrays t, u, y, r. Raise InputError."""
    given = [value is not None for value in arrays]
    if log is None:
        if not all(given[:3]):
            raise InputError("identify: give a log, or t, u and y")
        return [log_from_arrays(*arrays)]
    if any(given):
        raise InputError("identify: give a log, or t, u and y, not both")
    sources = log if isinstance(log, list | tuple) else [log]
    if not sources:
        raise InputError("identify: the list of logs is empty")
    return [read_log_or_loop(source, columns, strict) for source in sources]


# --- One output

FAR_OFF = 3.0  # rms of its changes, that an input is from 0 at least to count from elsewhere
ASIDE = 0.1  # share of readings on either side of 0, beside such an input


class Hypothesis(NamedTuple):
    """Hypothesis of a nonlinearity in a log, tested after the previous findings.

    Attributes:
        name: in words.
        is_open: tests if the previous findings leave it open.
        update_findings: fits its model and returns the findings with it.
    """

    name: str
    is_open: Callable[[Case, Findings], bool]
    update_findings: Callable[[Case, Findings], Findings]


def _may_integrate(logs: list[Log], options: Options) -> bool:
    """Return whether a plant may integrate without being declared to: a motor's by its names."""
    plain = options.kind == options.place == "auto" and not options.integrators
    return plain and is_motor_position(logs[0])


def _integrate_motor(
    grid: Grid, options: Options, advance: Callable[[int], None], first: Identified
) -> Identified:
    """Return the answer of a motor that integrates its torque, if one names something."""
    try:
        again = identify_output(grid, msgspec.structs.replace(options, integrators=1), advance)
    except InputError:
        return first
    if again.verdict in UNDECIDED:
        return first
    answer = again.answer
    return Identified(answer._replace(remarks=[INTEGRATES, *answer.remarks]))


def identify_output(grid: Grid, options: Options, advance: Callable[[int], None]) -> Identified:
    """Find plant and zone from records of a single output on a regular grid.

    Args:
        grid: the records.
        options: of the user.
        advance: called with the number of steps just done.

    Returns:
        The answer.

    Raises:
        InputError: nothing can be learnt.
    """
    grid, options = _count_from_silence(_count_from_zone(grid, options), options)
    servo = None if is_named_loop(grid) else identify_tick_servo(grid, options)
    if servo is not None:
        is_plain = options.integrators > 0 and servo.is_integrating and has_no_gap(servo)
        if servo.is_gap_reported or is_plain:
            advance(1)
            return _identify_servo(grid, options, advance, servo)
    shortened = shorten_log(grid, options.integrators)
    case = _fit_zone_and_maps(shortened, options, advance)._replace(servo=servo)
    if _acts_at_once(case):
        at_once = msgspec.structs.replace(options, delay=AT_ONCE)
        return identify_output(case.grid, at_once, advance)
    found = _begin_findings(case)
    if found.verdict.word == "jump" and _has_unread_edges(case):
        as_jump = msgspec.structs.replace(options, kind="jump")
        return identify_output(case.grid, as_jump, advance)
    for hypothesis in HYPOTHESES:
        if hypothesis.is_open(case, found):
            found = hypothesis.update_findings(case, found)
            advance(1)
    return Identified(to_answer(case, found))


def _acts_at_once(case: Case) -> bool:
    """Return whether the input moves the reading of its own sample."""
    is_open = case.options.delay == "auto" and not case.fitted.delay and case.jump_edges is None
    if not is_open or case.recorded.u.shape[1] > 1 or is_named_loop(case.grid):
        return False
    if not orders.acts_at_once(case.chosen.fit, case.recorded.u):
        return False
    return is_delay_better([case.chosen], delay_fits([case.chosen], -1))


def _count_from_zone(grid: Grid, options: Options) -> Grid:
    """Return the records with an input that counts from the middle of its zone.

    Only where it is never near 0 while readings lie about 0, as pulses of 1500 us that mean rest.
    """
    u = grid.u[:, 0]
    y = grid.y[grid.ok]
    is_about_zero = np.quantile(y, ASIDE) < 0 < np.quantile(y, 1 - ASIDE)
    near = abs(np.median(u)) < FAR_OFF * u.std()
    if grid.u.shape[1] > 1 or near or u.min() * u.max() <= 0 or not is_about_zero:
        return grid
    data = longest_record_of(prepare_log(grid, options).data)
    zero = find_input_zero(PlantSimulator(data, 2, options.integrators)) * data.input_scale
    words = f"the input is never near 0: it counts from {zero:.6g}"
    return grid._replace(u=grid.u - zero, zero=zero, remarks=[*grid.remarks, words])


def _count_from_silence(grid: Grid, options: Options) -> tuple[Grid, Options]:
    """Return readings that count from the one that comes back as inside a zone, as by `zero`."""
    value = 0.0 if options.zero else find_silent_level(grid)
    if not value:
        return grid, options
    words = f"the reading {value:.6g} comes back exactly: readings count from it"
    shifted = grid._replace(y=grid.y - value, remarks=[*grid.remarks, words])
    return shifted, msgspec.structs.replace(options, zero=value)


def _identify_servo(
    grid: Grid, options: Options, advance: Callable[[int], None], servo: ServoGap
) -> Identified:
    """Return the answer for a servo behind a play, with a fit of its order. Raise InputError."""
    case = _fit_zone_and_maps(grid, to_servo_options(options, servo), advance)
    case = case._replace(options=options)
    named = add_servo_element if servo.is_gap_reported else without_gap
    return Identified(to_answer(case, named(case, servo, _begin_findings(case))))


def _fit_zone_and_maps(grid: Grid, options: Options, advance: Callable[[int], None]) -> Case:
    """Fit the log with a zone of the sensor and with static maps. Raise InputError."""
    prepared, unreached = drop_unvisited_edges(prepare_log(grid, options))
    fitted = fit_with_delay(prepared, advance)
    chosen = orders.order_to_report(fitted.fits)
    chosen = chosen._replace(fit=polish_fit(chosen.fit))
    no_zone = orders.compare_with_no_zone(chosen.fit)
    if no_zone.fit is not chosen.fit:
        chosen = chosen._replace(fit=no_zone.fit)
    fits = {one.n: one for one in fitted.fits} | {chosen.n: chosen}
    maps = {}  # behind plants of each order, on the readings as they are
    least, jump_gains = math.inf, True  # a jump takes the longest to fit: while an order gains
    for n, one in sorted(fits.items()):
        maps[n] = fit_maps(_raw_part(fitted.prepared, one), jump_gains)
        if jump_gains:
            bic = maps[n]["jump"].density.bic
            least, jump_gains = bic, bic < least
    limited = None
    if prepared.ends.has_ends and prepared.jumps is None:
        limited = _fit_limits(grid, fitted.prepared)
    suited = min(maps, key=lambda n: min(one.density.bic for one in maps[n].values()))
    found = [*maps.values()]
    if fitted.delay and options.delay == "auto":  # of a zone, which a strong curve misleads
        (early,) = delay_fits([fits[suited]], -fitted.delay)
        rivals = fit_maps(_raw_part(fitted.prepared, early), may_jump=False)
        if has_strong_curve(rivals):
            found.append(rivals)
    advance(1)
    return Case(
        grid=grid,
        options=options,
        recorded=prepared.data,
        unreached=unreached,
        fitted=fitted,
        chosen=chosen,
        no_zone=no_zone,
        maps=best_maps(itertools.chain(*(one.values() for one in found))),
        limited=limited,
        suited=fits[suited],
        advance=advance,
    )


def _fit_limits(grid: Grid, prepared: PreparedLog) -> FittedModel[MapModel] | None:
    """Fit limits to all readings of a log that sticks at them; None if that leaves anything."""
    data, ends = prepared.data, prepared.ends
    y = np.where(prepared.at_ends, grid.y / data.y_scale, data.y)
    scaled = (ends.low / data.y_scale, ends.high / data.y_scale)
    every = data._replace(y=y, ok=data.ok | prepared.at_ends)
    orders = feasible_orders(int(every.ok.sum()), prepared.options)
    fit: FittedModel[Any] | None = fit_limits(every, orders, prepared.options.integrators, scaled)
    if fit is None or fit.density.rms > (1 - LEAST) * y[every.ok].std():
        return None
    remainders = find_remainders(fit, raw=DEPENDS)
    return fit if largest_remainder(remainders, "saturation") is None else None


def _begin_findings(case: Case) -> Findings:
    """Return the findings with the static maps alone."""
    reversals = reversal_blocks(case.grid.u[:, 0], 0.0)[-1]
    is_one_way = reversals < TURNS and case.options.kind != "play"
    denied = frozenset((*MEMORY, "input_play") if is_one_way else ())  # lost at reversals
    begun = Findings(build_verdict("unclear"), case.fitted.delay, (), {}, denied=denied)
    return begun.add_models(case, case.rivals)


def _raw_part(prepared: PreparedLog, one: orders.OrderFit) -> ZoneFit:
    """Return the fit of an order to the busiest part, with the raw readings of a jump sensor."""
    fit = refit_busiest_part(one.fit)
    if prepared.jumps is None:
        return fit
    data = fit.objective.data
    shift = offset(data.side, *[edge.value for edge in prepared.jumps])
    whole = data._replace(y=np.where(data.ok, data.y + shift, 0.0))
    return fit._replace(objective=fit.objective.objective_along(whole))


def _has_unread_edges(case: Case) -> bool:
    """Return whether the edges of a jump sensor can be read off but were not."""
    is_open = case.options.kind == "auto" and case.jump_edges is None
    return is_open and not case.options.integrators and has_jump_edges(case.record_data)


# --- Hypotheses, in the order of their tests


def _has_no_jump(case: Case, found: Findings) -> bool:
    """Return whether the log was not treated as that of a jump sensor."""
    return case.jump_edges is None


def _has_zone_with_zeros(case: Case, found: Findings) -> bool:
    """Return whether the sensor has a zone with exact zeros inside, so that (L2) applies."""
    has_zone = found.verdict.word == ("jump" if case.jump_edges else "dead_zone")
    return has_zone and case.record_data.silent_zeros


def _add_kalman_fit(case: Case, found: Findings) -> Findings:
    """Add the Kalman-filter likelihood (L2) and the disturbance that it separates."""
    return found._replace(kalman=fit_kalman(case.chosen.fit))


def _needs_zone_location(case: Case, found: Findings) -> bool:
    """Return whether the location of the zone is unknown and can be tested."""
    known = case.options.place == "sensor" or case.jump_edges
    return not (known or case.unreached or case.options.integrators)


def _add_zone_locations(case: Case, found: Findings) -> Findings:
    """Add models of friction, of a zone of the input, and of two zones."""
    fit = refit_longest_record(case.suited.fit)
    places = find_zone_locations(fit, case.quantum, case.fitted.prepared.orders)
    if "none" not in places:  # no plant alone settles within the record: nothing to compare with
        return found
    recorded = longest_record_of(case.recorded)
    chains = fit_chains(fit, places, recorded, case.fitted.prepared.orders)
    by_word = {
        word: one for word, one in chains.by_word.items() if not is_rounding_play(one, case.quantum)
    }
    models: dict[str, Any] = {**places, **by_word}
    found = found._replace(places=places, chains=by_word, shaped=chains.shaped)
    return found.add_models(case, {word: one.density for word, one in models.items()})


def _may_be_servo(case: Case, found: Findings) -> bool:
    """Return whether a servo must be tested: in a control loop of a process there is none."""
    return not is_named_loop(case.grid) and needs_servo_test(case, found)


def _has_play_verdict(case: Case, found: Findings) -> bool:
    """Return whether the verdict is a play, or a play with a dead zone."""
    return found.element is None and found.verdict.word in MEMORY and found.plays is not None


def _needs_remainder_test(case: Case, found: Findings) -> bool:
    """Return whether a linear plant with a zone may be an incomplete model."""
    return found.verdict.word in ("dead_zone", "other", "unclear")


def _add_remainder(case: Case, found: Findings) -> Findings:
    """Add effects that a linear plant with a zone does not contain, by name."""
    return found._replace(verdict=withdraw_zone_with_offset(found.verdict, case.chosen.fit))


HYPOTHESES = (
    Hypothesis("friction, or a zone of the input", _needs_zone_location, _add_zone_locations),
    Hypothesis("a play, or a play and a dead zone", _has_no_jump, add_play),
    Hypothesis("a servo behind a play", _may_be_servo, add_servo),
    Hypothesis(
        "a shaped zone without a width", may_have_shaped_zone, deny_shaped_zone_without_width
    ),
    Hypothesis("if a larger model simulates better", holds_more, without_needless),
    Hypothesis("the widths of a play", _has_play_verdict, add_play_gap),
    Hypothesis("noise that falls silent in the zone", _has_zone_with_zeros, _add_kalman_fit),
    Hypothesis("a spring that bends, or an offset", _needs_remainder_test, _add_remainder),
    Hypothesis("residual of the likeliest model", has_a_model, with_adequacy),
    Hypothesis("readings stored on change", has_hidden_readings, withhold_hidden_readings),
    Hypothesis("the numbers of the named class", needs_an_element, add_named_element),
)
