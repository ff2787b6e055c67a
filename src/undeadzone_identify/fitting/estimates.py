"""Maximum likelihood estimates of numbers of a scenario from logs, `fit`."""

from __future__ import annotations

import functools
import hashlib
import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from undeadzone.errors import InputError
from undeadzone.logs.names import parse_columns
from undeadzone.nonlinearities.sensor import Zone
from undeadzone.plants import build as plants
from undeadzone.plants.system import System, state_units
from undeadzone.scenario.address import stem, with_value
from undeadzone.scenario.operating_point import resolve_levels
from undeadzone.scenario.reader import read_for_logs
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.estimate import read_any_log
from undeadzone.util import toml
from undeadzone.util.answers import open_answers
from undeadzone.util.arrays import Floats, hold_last, shift_rows
from undeadzone.util.progress import notebook_progress
from undeadzone_identify.fitting.checks import FLAGGED, check_scores, score_readings
from undeadzone_identify.fitting.free import (
    DELAY,
    EXAMPLE,
    FreeNumber,
    Sizes,
    build_free_number,
    complete_tables,
    expand_address,
    find_numbers,
    free_within,
)
from undeadzone_identify.fitting.intervals import LINKED, Intervals, estimate_intervals
from undeadzone_identify.fitting.problem import (
    KNOWN,
    LOST,
    FitProblem,
    Log,
    build_model,
    build_problem,
    resolve_zone,
)
from undeadzone_identify.fitting.result import Fitted, FittedNumber, FittedSignals
from undeadzone_identify.fitting.search import Peaks, search_maximum

FARTHEST: Final = 6.0  # x(0) from the scenario's, in the largest output
FEWEST: Final = 20  # readings for each number
LATEST: Final = 1000  # samples of a delay
ALIKE: Final = 2.0  # nats, within which another answer fits as well
APART: Final = 3.0  # deviations, from which it is another answer
FIRST_ROW: Final = np.zeros(1, int)  # of a log

Free = Mapping[str, Any] | Sequence[str] | str
Start = Literal["free", "known"]


def fit(
    scenario: Scenario | str | os.PathLike[str],
    logs: Any,
    free: Free,
    *,
    columns: str | None = None,
    strict: bool = False,
    x0: Start = "free",
    seed: int = 1,
    threads: int | None = None,
    keep: Path | None = None,
    resume: bool = False,
    progress: Callable[[int], None] | None = None,
) -> Fitted:
    """Estimate numbers of a scenario from logs by maximum likelihood, silence included.

    Args:
        scenario: a scenario, or the path of its file, which needs no [reference] and no
            [controller]. [plant], [sensor], [actuator] and [disturbance] generate the log.
            [observer] is not used.
        logs: a log or several of one plant: paths, DataFrames, or tables of arrays t, u, y.
        free: addresses of the numbers, as `plant.mass,sensor.right=0..0.5`, a list, or a table with
            the range of each: None, (lo, hi), (start, lo, hi) or (start, lo, hi, std) with a normal
            prior. Without an index an address stands for all entries. Default ranges: a tenth to
            tenfold of a positive number, 3 times the size about a signed one, 0 to the largest
            output for a width, a thirtieth to thirtyfold of a noise.
        columns: names or numbers of the columns: `y=angle,u=voltage`.
        strict: whether a line that cannot be read is an error (else its sample is missing).
        x0: "free": x(0) of each log is estimated too; "known": it is the scenario's.
        seed: of the starts of the search.
        threads: of the lanes (default: one per processor); the numbers do not depend on it.
        keep: file that keeps the stages of the search (None: none).
        resume: continue a stopped search from `keep`.
        progress: called with the number of steps just done (None: a bar in a notebook).

    Returns:
        The scenario with its numbers, intervals, and tests of the answer.

    Raises:
        FileError: a log cannot be read, or its step is not that of the scenario.
        InputError: or a subclass, for an address, a range, or a scenario that cannot be fitted.

    Example:
        >>> t = np.arange(0.0, 20.0, 0.02)
        >>> log = {"t": t, "u": run.u, "y": run.y}
        >>> fitted = uz.fit(scenario, log, {"sensor.right": (0.0, 3.0)})  # doctest: +SKIP

    See Also:
        identify, estimate, tune
    """
    if not isinstance(scenario, Scenario):
        scenario = read_for_logs(scenario)
    asked = parse_free(free)
    scenario, besides = complete_tables(scenario, asked)
    model = build_model(scenario)
    read = read_logs(scenario, model, logs, columns, strict)
    delays = _list_delays(scenario, asked)
    described = functools.partial(_describe_fit, scenario, asked, read, x0, seed)
    found = []
    with (
        notebook_progress(progress, "fitting", None) as advance,
        open_answers(keep, described, "stages", resume) as answers,
    ):
        for delay in delays:
            moved = [each._replace(u=shift_rows(each.u, delay, FIRST_ROW)) for each in read]
            every = asked | dict.fromkeys(besides)
            problem = prepare_fit(scenario, model, moved, every, x0, threads)
            peaks = search_maximum(problem, seed, advance, answers, f"delay {delay}")
            found.append((problem, peaks, delay))
        best = max(found, key=lambda each: each[1].values[0])
        return build_answer(*best, besides, advance)


def parse_free(free: Free) -> dict[str, Any]:
    """Return the ranges of free numbers by address. Raises InputError."""
    if isinstance(free, str):
        free = re.split(r",(?![^\[]*\])", free)
    if not isinstance(free, Mapping):
        free = dict(_parse_number(part) for part in free if part.strip())
    if not free:
        raise InputError(f"free: nothing to fit. Name a number: {EXAMPLE}")
    return dict(free)


def _parse_number(text: str) -> tuple[str, Any]:
    """Return an address and its range from ADDRESS[=lo..hi]. Raises InputError."""
    address, there, bounds = map(str.strip, text.partition("="))
    if not there:
        return address, None
    try:
        low, high = map(float, bounds.split(".."))
    except ValueError:
        raise InputError(
            "free: expected ADDRESS or ADDRESS=lo..hi, such as sensor.right=0..0.5, found "
            f"{text!r:.60}"
        ) from None
    return address, (low, high)


def read_logs(
    scenario: Scenario, model: System, logs: Any, columns: str | None, strict: bool
) -> list[Log]:
    """Return the logs on the steps of a scenario, about its operating point.

    Raises FileError or InputError.
    """
    several = logs if isinstance(logs, list | tuple) else [logs]
    if not several:
        raise InputError("logs: expected one log at least")
    slope = resolve_zone(scenario).slope
    levels = resolve_levels(scenario.operating_point, model, slope, range(model.p))
    chosen = parse_columns(columns)
    found = []
    for each in several:
        if isinstance(each, Mapping):
            each = {name: each.get(name) for name in ("t", "u", "y")}
        read = read_any_log(scenario, model, each, chosen, strict)
        t, y, u = read.placed.samples[:3]
        u = np.nan_to_num(hold_last(u))
        if levels is not None:
            u = u - levels.u
            y = y - levels.y
        found.append(Log(read.source, t, y, u, np.zeros_like(y)))
    return found


def _list_delays(scenario: Scenario, asked: dict[str, Any]) -> list[int]:
    """Return the delays to be tried, and take them from what is free. Raises InputError."""
    if DELAY not in asked:
        return [scenario.plant.delay]
    low, high = asked.pop(DELAY) or (0, 0)
    if not asked or not 0 <= low < high <= LATEST:
        raise InputError(
            f"free: {DELAY}: expected a range of whole samples, as {DELAY}=0..5. And name another "
            f"number besides, such as {EXAMPLE}"
        )
    return list(range(int(low), int(high) + 1))


def _describe_fit(
    scenario: Scenario, asked: dict[str, Any], logs: Sequence[Log], x0: str, seed: int
) -> dict[str, Any]:
    """Return all data that the stages of a search depend on."""
    data = b"".join(np.hstack(each[2:4]).tobytes() for each in logs)
    return {
        "scenario": toml.to_toml(scenario),
        "free": {name: str(given) for name, given in asked.items()},
        "logs": hashlib.blake2b(data, digest_size=16).hexdigest(),
        "x0": x0,
        "seed": seed,
    }


def prepare_fit(
    scenario: Scenario,
    model: System,
    logs: Sequence[Log],
    asked: Mapping[str, Any],
    x0: Start = "free",
    threads: int | None = None,
) -> FitProblem:
    """Return the problem of fitting numbers of a scenario to logs.

    Args:
        scenario: with every table that is needed.
        model: its sampled plant.
        logs: the logs, their inputs as late as they act.
        asked: ranges by address.
        x0, threads: as of `fit`.

    Raises:
        InputError: or a subclass.
    """
    known = find_numbers(scenario, model)
    zone = resolve_zone(scenario)
    sizes = _measure_sizes(zone, logs)
    numbers: dict[str, FreeNumber] = {}
    for address, given in asked.items():
        for name in expand_address(address, known):
            if name in numbers:
                raise InputError(f"free: {name} is named twice. Keep one address that names it")
            numbers[name] = build_free_number(name, known[name].value or 0.0, given, sizes)
    readings = sum(np.isfinite(record.y).sum() for record in logs)
    if readings < FEWEST * len(numbers):
        raise InputError(
            f"logs: {readings} readings for {len(numbers)} numbers, fewer than {FEWEST} for each"
        )
    start = plants.initial_state(scenario.plant, model)
    largest = sizes.z / 2 * state_units(model.continuous, model.Ts)  # of x
    reach = FARTHEST * largest
    fitted = x0 == "free" and model.nonlinear
    initial = []
    for k, i in np.ndindex(len(logs) * fitted, model.n):
        name = f"x0[{i}]" + f" of log {k + 1}" * (len(logs) > 1)
        ends = start[i] - reach[i], start[i] + reach[i], start[i], largest[i]
        initial.append(free_within(name, *map(float, ends)))
    spread = np.full(model.n, KNOWN) if fitted or x0 == "known" else largest
    return build_problem(scenario, logs, list(numbers.values()), spread, initial, threads)


def _measure_sizes(zone: Zone, logs: Sequence[Log]) -> Sizes:
    """Return the sizes from which default ranges follow."""
    y = np.concatenate([record.y for record in logs])
    u = np.concatenate([record.u for record in logs])
    largest = np.nanmax(np.abs(y), initial=0.0) + max(*zone.right, *zone.left)
    rms = [np.sqrt(np.nanmean(part**2)) or 1.0 for part in (y, u)]
    return Sizes(2 * float(largest) or 1.0, *map(float, rms))


def build_answer(
    problem: FitProblem,
    peaks: Peaks,
    delay: int,
    besides: Sequence[str],
    tick: Callable[[int], None],
) -> Fitted:
    """Return the answer at the best end of the searches. Raises InputError if all diverged."""
    point, value = peaks.points[0], float(peaks.values[0])
    if value < LOST * len(problem.whole.y) / 2:
        raise InputError(
            "log: the scenario diverges along it from every start. Give narrower ranges, or "
            "another start"
        )
    intervals = estimate_intervals(problem, point, value)
    tick(1)
    values = problem.decode_points(point[None])[0]
    scores = score_readings(problem, point)
    prediction = problem.record_lanes(point[None]).prediction[0]
    t, y, u, _ = problem.whole[1:]
    checks = check_scores(u, prediction, scores)
    ends = zip(values.tolist(), intervals.low.tolist(), intervals.high.tolist(), strict=True)
    numbers = []
    for i, (number, end) in enumerate(zip(problem.free, ends, strict=True)):
        reach = number[1:4]
        note = _note_number(problem, intervals, values, i)
        numbers.append(FittedNumber(number.name, *end, *reach, bool(intervals.shown[i]), note))
    return Fitted(
        scenario=_write_numbers(problem, values, delay),
        numbers=tuple(numbers),
        correlations=intervals.correlations,
        directions=intervals.directions,
        log_likelihood=value,
        checks=checks,
        consistent=min(checks.values()) >= FLAGGED / len(checks),
        others=_find_other_answers(problem, peaks, intervals),
        besides=tuple(besides),
        delay=delay,
        signals=FittedSignals(t, y, prediction, scores),
    )


def _note_number(problem: FitProblem, found: Intervals, values: Floats, i: int) -> str:
    """Return what limits the knowledge of a number, empty if nothing does."""
    number = problem.free[i]
    low, high = found.low[i], found.high[i]
    for side, edge in ((1, "right"), (-1, "left")):
        if stem(number.name) == f"sensor.{edge}" and side not in problem.whole.side:
            return f"no reading passed the {edge} edge: only d_{edge[0]} > {low:.4g} follows"
    if found.shown[i]:
        at_end = values[i] in (low, high)
        return f"at the end of its range: {low:.4g} to {high:.4g}" * at_end
    words = f"the log does not determine it: any value from {low:.4g} to {high:.4g} does"
    row = found.correlations[i] * (np.arange(len(values)) != i)
    k = int(np.argmax(np.abs(row)))
    if abs(row[k]) > LINKED:
        kinds = [["difference", "sum"], ["ratio", "product"]]
        kind = kinds[int(problem.is_log[[i, k]].all())][int(row[k] < 0)]
        words += f"; only the {kind} with {problem.free[k].name} is known"
    return words


def _find_other_answers(
    problem: FitProblem, peaks: Peaks, found: Intervals
) -> tuple[dict[str, float], ...]:
    """Return further peaks that fit as well and are more than deviations away, by name."""
    scale = np.maximum(found.std, 1e-3 * problem.span)
    off = np.abs((peaks.points - peaks.points[0]) / scale).max(axis=1)
    far = peaks.points[(off > APART) & (peaks.values > peaks.values[0] - ALIKE)]
    names = [each.name for each in problem.free]
    values = problem.decode_points(far).tolist()
    return tuple(dict(zip(names, each, strict=True)) for each in values)


def _write_numbers(problem: FitProblem, values: Floats, delay: int) -> Scenario:
    """Return the scenario with fitted numbers, x(0) too if there is one log."""
    found = dict(zip((each.name for each in problem.free), values.tolist(), strict=True))
    start = [found.pop(each.name) for each in problem.free if each.is_start]
    scenario = problem.scenario
    for name, value in found.items():
        scenario = with_value(scenario, name, value)
    if len(start) == problem.model.n:
        scenario = with_value(scenario, "plant.x0", start)
    return with_value(scenario, DELAY, delay) if delay != scenario.plant.delay else scenario
