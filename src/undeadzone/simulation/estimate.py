"""Estimation along a recorded log by an observer, `estimate`, and smoothing.

Smoothing is of fixed interval: the estimates of each sample given the whole log. The filter runs
forward. Adjoint variables run backward through its stored moments (modified Bryson-Frazier form:
Bierman 1973, "Fixed interval smoothing with discrete measurements", Int. J. Control 18). Its result
is that of the equations of Rauch, Tung and Striebel (1965), but it inverts no motion.
docs/filter_extensions.md, "Smoothing", lists the exact and the approximate parts.

References:
    H. E. Rauch, F. Tung, C. T. Striebel (1965), doi:10.2514/3.3166
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.compile import interpret
from undeadzone.errors import FileError, InputError
from undeadzone.interfaces import Estimate, Observer
from undeadzone.logs.names import Layout, parse_columns
from undeadzone.logs.samples import Faults, Placed, place_on_steps
from undeadzone.logs.whole import read_whole, samples_of_arrays
from undeadzone.nonlinearities.sensor import Zone
from undeadzone.numerics.adjoint import LaterInformation, smooth_backward
from undeadzone.numerics.gaussian import Gaussian
from undeadzone.observers.filtering.multiple_models import LEAST
from undeadzone.observers.filtering.smoothing import Moments
from undeadzone.plants.system import System
from undeadzone.results.estimation import Estimation
from undeadzone.results.signals import LOG, SMOOTHED, Signals, signals_from_estimate
from undeadzone.scenario.operating_point import restore_signals
from undeadzone.scenario.reader import read_for_logs
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.follower import Follower, require_units
from undeadzone.simulation.online import ObserverGraph, observer_graph
from undeadzone.util import tree
from undeadzone.util.arrays import Array, Floats, shift_rows
from undeadzone.util.files import LARGEST_RUN
from undeadzone.util.progress import notebook_progress

LARGEST_LOG: Final = 20_000_000  # samples; beyond this the memory of most machines


def estimate(
    scenario: Scenario | str | os.PathLike[str],
    frame_or_path: Any = None,
    *,
    t: Array | None = None,
    u: Array | None = None,
    y: Array | None = None,
    columns: str | None = None,
    strict: bool = False,
    smoothing: bool = True,
    delay: int = 0,
    progress: Callable[[int], None] | None = None,
) -> Estimation:
    """Let an observer follow a log.

    Args:
        scenario: a scenario, or the path of its file, which needs no [reference], no [controller]
            and no widths of the sensor. Its plant (or model), sensor, observer and step are used,
            in sampled time.
        frame_or_path: the log: a CSV file (any dialect), .npz, .mat, or a pandas DataFrame with
            columns t, y, u (or give arrays).
        t: times (N) [s] (None: one step apart).
        u: inputs (N) or (N x m).
        y: readings (N) or (N x p), NaN if one is missing.
        columns: names or numbers of the columns if the header does not show them:
            `y=angle,u=voltage`.
        strict: whether a line that cannot be read is an error (else its sample is missing).
        smoothing: whether `kalman`, `censored`, `extended` and `auto` are smoothed too, with the
            whole log.
        delay: samples by which the inputs act later than the log has them, beside a delay of the
            plant; negative: earlier, since the log has them late.
        progress: called with the number of samples just done (None: a bar in a notebook).

    Returns:
        The estimates along the log, the final widths, and whether the record is consistent.

    Raises:
        FileError: the log cannot be read, its columns are unknown, or its step is another one.
        InputError: or a subclass, for errors in the scenario or the arrays.

    Example:
        >>> estimation = uz.estimate(scenario, t=run.t, u=run.u, y=run.y)
        >>> estimation.summary()["consistent"]
        True

    See Also:
        simulate, Online, identify
    """
    if not isinstance(scenario, Scenario):
        scenario = read_for_logs(scenario)
    follower = Follower(scenario)
    chosen = parse_columns(columns)
    if frame_or_path is None:
        if y is None or u is None:
            raise InputError("estimate: expected a file, a DataFrame, or arrays y and u")
        step = scenario.simulation.step
        model = follower.model
        samples, _ = samples_of_arrays({"t": t, "y": y, "u": u}, model.p, model.m)
        log = _Log("arrays", place_on_steps(samples, t is not None, step, "arrays"))
    elif t is not None or y is not None or u is not None:
        raise InputError("estimate: expected a log or arrays, found both")
    else:
        log = _read_any_log(scenario, follower, frame_or_path, chosen, strict)
    regular = log.placed.samples
    if regular.t.size > LARGEST_LOG:
        raise FileError(
            f"{log.source}: more than {LARGEST_LOG} samples. Give it to undeadzone watch, or split "
            "it"
        )
    regular = regular._replace(u=shift_rows(regular.u, delay, np.zeros(1, int)))
    with notebook_progress(progress, "estimating", None) as advance:
        estimated, sides, B = follower.follow(regular, advance)
        given = {
            name: value
            for name, value in signals_from_estimate(estimated).items()
            if name in LOG.names
        }
        signals = {"t": regular.t, "y": regular.y, "u": regular.u, "side": sides} | given
        if B.size:
            signals["B"] = B
        if smoothing and follower.observer.smoothing is not None and regular.t.size:
            parts = follower.model, follower.observer, follower.zone
            inner = follower.to_deviations(regular)
            smoothed = smooth(*parts, inner.y, inner.u, advance)
            signals |= restore_signals(follower.levels, smoothed)
    info = follower.info(log.source, log.layout, log.placed, log.faults)
    return Estimation(info, Signals(LOG, signals))


class _Log(NamedTuple):
    """A log as it was read.

    Attributes:
        source: its name in messages.
        placed: its samples, one step apart.
        layout: its columns (None: it has none).
        faults: the lines that cannot be read (None for arrays).
    """

    source: str
    placed: Placed
    layout: Layout | None = None
    faults: Faults | None = None


def _read_any_log(
    scenario: Scenario, follower: Follower, log: Any, chosen: Mapping[str, str], strict: bool
) -> _Log:
    """Return a log from a file or a DataFrame."""
    p, m = follower.model.p, follower.model.m
    read = read_whole(log, p, m, chosen, strict, LARGEST_RUN, LARGEST_LOG)
    if read.layout is not None:
        require_units(read.layout, scenario.units, read.source)
    timed = read.layout is not None and read.layout.has_times
    on_steps = place_on_steps(read.samples, timed, scenario.simulation.step, read.source)
    return _Log(read.source, on_steps, read.layout, read.faults)


# --- Looking back

BLOCK = 5000  # samples whose moments are in memory at once
SMOOTHED_FIELDS = ("x", "z", "right", "left", "x_std", "right_std", "left_std")  # of an estimate


class _Ahead(NamedTuple):
    """Information in the samples after a block.

    Attributes:
        later: of the block's end, a member each: of its belief, then of each doubt.
        odds: log of the odds of the members (K).
        worst: record (None at the end of the log).
    """

    later: list[list[LaterInformation]]
    odds: Floats
    worst: Any


class _Graphs(NamedTuple):
    """The functions of one filter.

    Attributes:
        step: step(s, w, p) is (next state, `[estimate; s]`).
        moments: of a row `[s; w]`, those of its members. A step without a state, like `estimate`.
        estimate: of a row `[beliefs; what the sensor's shape adds; share; record]`, to the
            quantities in `SMOOTHED_FIELDS`.
        filter: the filter itself.
        causal: places of `SMOOTHED_FIELDS` among its outputs.
        like: `Moments` of the members, of arrays of their shapes.
        odds, record: where these stand in the state.
    """

    step: ca.Function
    moments: ca.Function
    estimate: ca.Function
    filter: ObserverGraph
    causal: list[Any]
    like: tuple[Moments, ...]
    odds: Any
    record: Any


def smooth(
    model: System,
    observer: Observer,
    sensor: Zone,
    y: Floats,
    u: Floats,
    progress: Callable[[int], None] | None = None,
) -> dict[str, Floats]:
    """Return the smoothed signals along a log: estimates of each sample given the whole log.

    Args:
        model: the sampled model.
        observer: a filter that is built for it, with `smoothing`.
        sensor: the dead zone, for its threshold and its range.
        y: readings (N x p), NaN if one is missing.
        u: inputs (N x m), NaN if the last one is held.
        progress: called with the number of samples just done.
    """
    graphs = _graphs(model, observer, sensor)
    w = np.hstack([y, u])
    starts = [graphs.filter.start]
    numbers = graphs.filter.numbers
    for first in range(0, len(w), BLOCK):
        _, state = interpret.run_interpreted(
            graphs.step, starts[-1], w[first : first + BLOCK], numbers
        )
        starts.append(state)
    nothing = []
    for one in graphs.like:
        size, doubts = one.doubted[0].shape
        nothing.append([LaterInformation.no_information(size) for _ in range(1 + doubts)])
    ahead = _Ahead(nothing, np.zeros(len(nothing)), None)
    pieces = []
    for k in range(len(starts) - 2, -1, -1):
        part = w[k * BLOCK : (k + 1) * BLOCK]
        rows, ahead = _block(graphs, starts[k], part, ahead)
        pieces.append(rows)
        if progress is not None:
            progress(len(part))
    return _arrange_smoothed(model, np.vstack(pieces[::-1]))


def _graphs(model: System, observer: Observer, sensor: Zone) -> _Graphs:
    """Return the functions of a filter along a log."""
    known = observer_graph(model, observer, sensor)
    smoothing = observer.smoothing
    inputs = [known.s, known.w, known.p]
    following, given = known.step(*inputs)
    every = smoothing.moments(known.params, known.state, known.used, known.reading)
    like = tree.map_leaves(lambda leaf: np.zeros(ca.SX(leaf).shape), every)
    init = observer.init(observer.params)
    record = smoothing.record(init)
    beliefs = [Gaussian(np.zeros(one.before.mean.shape), one.before.cov) for one in like]
    wide = []
    for one in like:
        size = one.bounded.mean.size if one.doubted[0].size else 0
        wide.append(np.zeros((size, size)))
    row, (seen, more, share, record_symbols) = tree.create_symbols(
        (tuple(beliefs), tuple(wide), np.zeros(len(like)), record), "r"
    )
    smoothed: Estimate = smoothing.mixture_estimate(known.params, seen, more, share, record_symbols)
    out = tuple(getattr(smoothed, name) for name in SMOOTHED_FIELDS)
    where = tree.leaf_slices((init, np.zeros(model.m)))[0]
    of_estimate = tree.leaf_slices(known.out).estimate
    return _Graphs(
        ca.Function("watched", inputs, [following, ca.vertcat(given, known.s)]),
        interpret.build_stateless_step(
            [ca.vertcat(known.s, known.w), known.p], ca.cse(tree.stack_leaves(every))
        ),
        interpret.build_stateless_step([row, known.p], ca.cse(tree.stack_leaves(out))),
        known,
        [getattr(of_estimate, name) for name in SMOOTHED_FIELDS],
        like,
        smoothing.odds(where) if len(like) > 1 else None,
        smoothing.record(where),
    )


def _block(graphs: _Graphs, start: Floats, w: Floats, ahead: _Ahead) -> tuple[Floats, _Ahead]:
    """Return a block of samples, given the information of the later ones.

    Args:
        graphs: of the filter.
        start: its state before the block.
        w: readings and inputs (B x p + m).
        ahead: information of the samples after the block.

    Returns:
        The smoothed quantities of each sample (B x outputs), and the information for the samples
        before.
    """
    numbers = graphs.filter.numbers
    watched, final = interpret.run_interpreted(graphs.step, start, w, numbers)
    estimates, before_each = np.split(watched, [-start.size], axis=1)
    states = np.vstack([before_each[1:], final])  # after each sample
    moments = interpret.map_rows(graphs.moments, np.hstack([before_each, w]), numbers)
    every = _arrays(graphs.like, moments)
    beliefs = []
    wide = []
    before = []
    for one, later in zip(every, ahead.later, strict=True):
        mean, cov, first = smooth_backward(one, later[0])
        beliefs += [mean, np.swapaxes(cov, 1, 2).reshape(len(w), -1)]
        added, firsts = _smooth_doubts(one, later[1:])
        wide.append(added.reshape(len(w), -1))
        before.append([first, *firsts])
    logs = np.column_stack([one.log for one in every])
    shares, odds = _shares(graphs, states, logs, ahead.odds)
    records, worst = _records(graphs, states, ahead.worst)
    rows = np.hstack([*beliefs, *wide, shares, records])
    smoothed = interpret.map_rows(graphs.estimate, rows, numbers)
    # If the estimate cannot be smoothed, that of the filter is used.
    lost = ~np.isfinite(smoothed).all(axis=1)
    smoothed[lost] = np.hstack([estimates[lost, part] for part in graphs.causal])
    return smoothed, _Ahead(before, odds, worst)


def _smooth_doubts(
    one: Moments, later: list[LaterInformation]
) -> tuple[Floats, list[LaterInformation]]:
    """Return the covariance that the sensor's shape adds, and the information about each column.

    A smoothed mean is linear in the means of the filter, and so are its derivatives.

    Args:
        one: moments of a member, with arrays of a row a sample.
        later: information of the samples after the block on each column.
    """
    shape = (*one.bounded.mean.shape, len(later))
    before, after = (part.reshape(shape) for part in one.doubted)
    added = np.zeros(one.bounded.cov.shape) if later else np.zeros((len(one.log), 0))
    firsts = []
    for k, known in enumerate(later):
        moved = one._replace(
            before=one.before._replace(mean=before[:, :, k]),
            read=one.read._replace(mean=after[:, :, k]),
            bounded=one.bounded._replace(mean=after[:, :, k]),
        )
        column, _, first = smooth_backward(moved, known)
        added += column[:, :, None] * column[:, None, :]
        firsts.append(first)
    return added, firsts


def _arrays(like: tuple[Moments, ...], known: Floats) -> tuple[Moments, ...]:
    """Return the moments of each member at each sample, from rows of packed numbers."""
    leaves = []
    columns = tree.iterate_leaves(tree.unpack_columns(like, known))
    for (_, leaf), (_, values) in zip(tree.iterate_leaves(like), columns, strict=True):
        if leaf.shape[1] > 1:
            values = np.swapaxes(values.reshape(len(known), *leaf.shape[::-1]), 1, 2)
        leaves.append(values)
    every: tuple[Moments, ...] = tree.rebuild_tree(like, iter(leaves))
    return every


def _shares(graphs: _Graphs, states: Floats, logs: Floats, odds: Floats) -> tuple[Floats, Floats]:
    """Return the probability of each member at each sample (B x K), and the odds before.

    Args:
        graphs: of the filter.
        states: after each sample (B x S).
        logs: of the densities with which members foretold each sample (B x K).
        odds: log of the odds from the samples after the block (K).
    """
    if graphs.odds is None:
        return np.ones((len(logs), 1)), odds
    shares = np.empty(logs.shape)
    for k in range(len(logs) - 1, -1, -1):
        total = states[k, graphs.odds] + odds
        share = np.exp(total - total.max())
        shares[k] = share / share.sum()
        odds = odds + logs[k]
        odds = np.maximum(odds - odds.max(), math.log(LEAST))
    return shares, odds


def _records(graphs: _Graphs, states: Floats, worst: Any) -> tuple[Floats, Any]:
    """Return the worst record from each sample on (B x numbers), and that of the whole block.

    Args:
        graphs: of the filter.
        states: after each sample (B x S).
        worst: from the samples after the block (numbers) (None: there are none).
    """
    places = [part for _, part in tree.iterate_leaves(graphs.record)]
    if not places:
        return np.empty((len(states), 0)), None
    records = np.hstack([states[:, part] for part in places])
    for k in range(len(records) - 1, -1, -1):
        if worst is not None:
            records[k] = np.where(np.abs(records[k]) < np.abs(worst), worst, records[k])
        worst = records[k]
    return records, worst


def _arrange_smoothed(model: System, values: Floats) -> dict[str, Floats]:
    """Return the smoothed signals by name, right and left of each output in turn."""
    n = model.n
    p = model.p
    ends = np.cumsum([n, p, p, p, n, p])
    x, z, right, left, x_std, right_std, left_std = np.split(values, ends, axis=1)
    d = np.stack([right, left], axis=2).reshape(len(values), -1)
    d_std = np.stack([right_std, left_std], axis=2).reshape(len(values), -1)
    return dict(zip(SMOOTHED, (x, z, d, x_std, d_std), strict=True))
