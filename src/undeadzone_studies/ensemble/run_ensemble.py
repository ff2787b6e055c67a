"""Computation of a scenario's ensemble, block by block, and of the signals of one of its runs."""

from __future__ import annotations

import dataclasses
import functools
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import casadi as ca
import msgspec
import numpy as np

import undeadzone
from undeadzone.compile import interpret, lanes
from undeadzone.errors import FileError, InputError
from undeadzone.nonlinearities.sensor import Zone
from undeadzone.results.run import Run
from undeadzone.scenario.encoders import with_gaps
from undeadzone.scenario.ensemble_table import Vary
from undeadzone.scenario.problem import Problem
from undeadzone.scenario.reader import anchor_files, confine_files, parse
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.collect import collect
from undeadzone.simulation.loop import Params
from undeadzone.simulation.simulate import name_outputs
from undeadzone.util import toml, tree
from undeadzone.util.answers import require_same_problem
from undeadzone.util.arrays import Floats, Integers
from undeadzone.util.files import open_scratch
from undeadzone.util.progress import notebook_progress
from undeadzone_studies.ensemble import run_blocks, saved
from undeadzone_studies.ensemble.batch import Batch, prepare_batch
from undeadzone_studies.ensemble.journal import Store
from undeadzone_studies.ensemble.metrics import (
    EDGES,
    Bands,
    error_bands,
    interleave_widths,
    true_width,
)
from undeadzone_studies.ensemble.result import Ensemble
from undeadzone_studies.ensemble.saved import Info

RECORDED = 256  # runs whose signals make the bands
POINTS = 1000  # samples of a recorded trajectory, or a few more


def run_ensemble(
    scenario: Scenario,
    path: Path | str | None = None,
    *,
    resume: bool = False,
    workers: int | None = None,
    cluster: str | None = None,
    progress: Callable[[int], None] | None = None,
) -> Ensemble:
    """Run the scenario's [ensemble] and save the result at `path`, or keep it in memory
    without a path.

    Blocks of runs are kept in PATH.partial as they are done. The bits are the same wherever they
    are computed.

    Args:
        scenario: with a table [ensemble]
        path: of the result, `.npz` or `.parquet` (None: in memory)
        resume: continue what an interrupted call left there, and leave a finished file as it is
        workers: number of local processes that compute (default: this one)
        cluster: address of a Dask cluster that computes instead
        progress: called from this thread with the number of runs just done (None: a bar in a
            notebook)

    Returns:
        The ensemble. The columns of a saved one stay on disk and are read as they are used.

    Raises:
        InputError or a subclass: FileError if a file cannot be read or written, ClusterError if the
            cluster fails

    Example:
        >>> varied = {"sensor.right": uz.Distribution(uniform=(0.5, 1.5))}
        >>> ensemble = uz.run_ensemble(
        ...     msgspec.structs.replace(scenario, ensemble=uz.Vary(runs=8, entries=varied))
        ... )
        >>> len(ensemble.settled)
        8

    See Also:
        replay_run, tune
    """
    if path is not None:
        path = saved.require_ensemble_path(path)
    scenario = anchor_files(scenario, Path.cwd())  # for workers, and for replays from elsewhere
    batch = prepare_batch(scenario)
    is_here = workers is None and cluster is None  # then it need not be prepared again
    make = (lambda: batch) if is_here else functools.partial(prepare_batch, scenario)
    with notebook_progress(progress, "running", batch.layout.runs, "runs") as advance:
        compute = functools.partial(
            run_blocks.compute_job, make, workers=workers, cluster=cluster, progress=advance
        )
        if path is None:
            return _compute_in_memory(batch, compute)
        return _compute_on_disk(batch, compute, path, resume)


def _compute_on_disk(
    batch: Batch, compute: Callable[..., Store], path: Path, resume: bool
) -> Ensemble:
    """Return the ensemble whose blocks `compute` stores in a file beside the final file."""
    partial = path.with_name(f"{path.name}.partial")
    if resume and not partial.exists():
        finished = _load_finished(path, batch)
        if finished is not None:
            return finished
    store = compute(partial, resume=resume)
    with run_blocks.close_on_failure(store):
        _build_ensemble(batch, store).save(path)
    store.remove()
    return Ensemble.load(path)


def replay_run(result: Ensemble, run: int) -> Run:
    """Return a run of an ensemble with all its signals.

    Its states equal those in the ensemble to the last bit, if nothing has changed since
    (`deviation`).

    Args:
        result: the ensemble
        run: number of the run, from 0

    Returns:
        The run, as `simulate` returns it.

    Raises:
        InputError: or a subclass, for errors in the scenario.

    Example:
        >>> uz.replay_run(ensemble, 3).z.shape == run.z.shape
        True

    See Also:
        run_ensemble
    """
    return replay_in_batch(prepare_batch(parse(result.info.scenario)), run)


def replay_deviation(result: Ensemble, run: int) -> float:
    """Return the largest relative deviation of a run here and now from its stored row [1].

    Args:
        result: the ensemble
        run: number of the run, from 0

    Returns:
        The largest relative difference of its values and metrics (0: all bits are equal).

    Raises:
        InputError: or a subclass, for errors in the scenario.
    """
    saved_row = result.row(run)
    batch = prepare_batch(parse(result.info.scenario))
    values = batch.binding.draw_columns(run, 1, batch.layout.runs)
    here = batch.rows_of_runs(np.array([run]), values)[0]
    there = np.array([*saved_row["varied"].values(), *saved_row["metrics"].values()])
    differs = ~((here == there) | np.isnan(here) & np.isnan(there))
    with np.errstate(invalid="ignore"):
        size = np.abs(here - there)[differs] / np.abs(there[differs])
    return float(np.nan_to_num(size, nan=np.inf, posinf=np.inf).max(initial=0.0))


def replay_saved(path: Path, number: int, confine: Path | None) -> tuple[Run, float]:
    """Return a run of a saved ensemble, and its deviation from the run in the ensemble.

    Args:
        path: of the ensemble.
        number: of the run.
        confine: a folder outside of which the ensemble's scenario may name no file (None: any).

    Raises:
        InputError: or a subclass, for errors in the file or in its scenario.
    """
    ensemble = Ensemble.load(path)
    if confine is not None:
        confine_files(parse(ensemble.info.scenario), confine)
    return replay_run(ensemble, number), replay_deviation(ensemble, number)


def _compute_in_memory(batch: Batch, compute: Callable[[Path], Store]) -> Ensemble:
    """Return the result of a store in a temporary folder."""
    with open_scratch() as folder:
        store = compute(folder / "runs.partial")
        result = _build_ensemble(batch, store)
        varied = {name: np.array(column) for name, column in result.varied.items()}
        metrics = {name: np.array(column) for name, column in result.metrics.items()}
        store.remove()
    return dataclasses.replace(result, varied=varied, metrics=metrics)


def _load_finished(path: Path, batch: Batch) -> Ensemble | None:
    """Return the ensemble in a file, or None if unreadable.

    Raises InputError for another problem.
    """
    try:
        saved = Ensemble.load(path)
    except FileError:
        return None
    there = msgspec.structs.asdict(saved.info)
    here = msgspec.structs.asdict(_build_info(batch))
    require_same_problem(
        path, there, here, "leave resume=True out to replace it, or choose another name"
    )
    return saved


def _build_ensemble(batch: Batch, store: Store) -> Ensemble:
    """Return the result of a complete store. Its columns are those of the store, on disk."""
    columns = store.map_columns()
    info = _build_info(batch)
    varied = {name: columns.pop(name) for name in batch.binding.names_of_columns}
    return Ensemble(varied, columns, info, compute_bands(batch, info.recorded))


def _build_info(batch: Batch) -> Info:
    """Return the data of the result about the scenario and the computation."""
    problem = batch.problem
    scenario = problem.scenario
    vary = scenario.ensemble or Vary()
    return Info(
        title=scenario.title,
        method=str(type(scenario.observer).__struct_config__.tag),
        time=scenario.simulation.time,
        step=scenario.simulation.step,
        duration=scenario.simulation.duration,
        seed=batch.binding.seed,
        sampling=vary.sampling,
        runs=batch.layout.runs,
        tolerance=vary.tolerance,
        tracked=problem.tracked,
        widths=interleave_widths(problem.sensor),
        geared=problem.sensor.kind == "gears",
        scenario=toml.to_toml(scenario),
        version=undeadzone.__version__,
        recorded=min(RECORDED, batch.layout.runs),
        numbers=str(batch.layout.problem["numbers"]),
        units=scenario.units,
    )


def replay_in_batch(batch: Batch, run: int) -> Run:
    """Return run number `run` with all its signals. Raises InputError."""
    runs = batch.layout.runs
    if not 0 <= run < runs:
        raise InputError(f"run {run}: this ensemble has runs 0 to {runs - 1}")
    began = time.perf_counter()
    values = batch.binding.draw_columns(run, 1, runs)
    everything = list(range(tree.count_numbers(batch.loop.outputs)))
    outputs = _record_outputs(batch, np.array([run]), values, everything, every=1)
    problem = _problem_of_run(batch, values[0], f"run {run}")
    return collect(problem, name_outputs(batch.loop, outputs[0]), None, began)


def compute_bands(batch: Batch, runs: int) -> Bands:
    """Return the bands of the first `runs` runs."""
    p = batch.problem.plant.p
    positions = [f"z[{i}]" for i in range(p)]
    edges = [f"{EDGES[j % 2]}[{j // 2}]" for j in range(2 * p)]
    places = {name: i for i, name in enumerate(tree.number_addresses(batch.loop.outputs))}
    estimates = [f"estimate.{edge}" for edge in edges]
    entries = [places[name] for name in (*positions, *estimates)]
    values = batch.binding.draw_columns(0, runs, batch.layout.runs)
    every = max(1, len(batch.exogenous) // POINTS)
    outputs = _record_outputs(batch, np.arange(runs), values, entries, every)
    z = outputs[:, :, :p]
    d_hat = outputs[:, :, p:]
    t = batch.exogenous[::every, -2]
    params = np.array([batch.binding.numbers.pack_lane(row)[1] for row in values])
    varied = dict(zip(batch.binding.names_of_columns, values.T, strict=True))
    nominal = interleave_widths(batch.problem.sensor)
    geared = batch.problem.sensor.kind == "gears"
    true = [np.broadcast_to(true_width(edge, nominal, varied, geared), runs) for edge in edges]
    widths = np.stack(true, axis=1)
    scale = params[:, tree.leaf_slices(batch.loop.params).scale.reference, None]
    r = scale * batch.problem.reference.output_at(t)
    return error_bands(t, z, r, d_hat, widths, batch.problem.tracked)


def _record_outputs(
    batch: Batch, runs: Integers, values: Floats, outputs: list[int], every: int
) -> Floats:
    """Return some outputs of runs along their states (runs x N x chosen), on CasADi's virtual
    machine.

    Args:
        batch: the ensemble
        runs: their numbers
        values: of what varies (runs x columns)
        outputs: the chosen entries of the loop's packed outputs
        every: steps between two records
    """
    own = batch.binding.numbers.to_lanes(values)
    trails, finals = batch.execute_kernel(
        _record_trail(batch.kernel, every), runs, own, every=every
    )
    instants = batch.exogenous[::every, :-2].copy()
    params = batch.binding.numbers.params.copy()
    step = batch.loop.step
    s, w, p = (ca.SX.sym(name, step.size1_in(i)) for i, name in enumerate("swp"))
    show = interpret.build_stateless_step([ca.vertcat(s, w), p], step(s, w, p)[1][outputs])
    recorded = np.empty((len(runs), len(instants), len(outputs)))
    for lane, trail in enumerate(trails):
        states, _, drawn = np.split(trail, [s.numel(), finals.shape[1]], axis=1)
        instants[:, batch.own.entries] = drawn
        params[list(batch.binding.numbers.indices)] = own.params[lane]
        recorded[lane] = interpret.map_rows(show, np.hstack([states, instants]), params)
    return recorded


def _record_trail(kernel: lanes.Kernel, every: int) -> lanes.Kernel:
    """Return the kernel called for `every` steps at a time. It records state and drawn inputs.

    It records its states and own inputs before each call.
    """
    shape = kernel.shape
    states = shape.sizes[0]
    own = len(shape.exogenous)

    def block(steps: int, width: int, *arrays: Floats) -> None:
        """Compute the steps in pieces, and write state and drawn inputs at the start of
        each piece.
        """
        work, exogenous, params, inputs, outputs = arrays
        for k in range(0, steps, every):
            outputs[k, :states] = work[:states]
            outputs[k, states:] = inputs[k]
            count = min(every, steps - k)
            shared = exogenous[k : k + every]
            drawn = inputs[k : k + every]
            kernel.block(count, width, work, shared, params, drawn, outputs[:0])

    return kernel._replace(block=block, shape=shape._replace(record=tuple(range(states + own))))


def _problem_of_run(batch: Batch, values: Floats, what: str) -> Problem:
    """Return the problem with the plant, the sensor and the reference scale of one run."""
    _, packed = batch.binding.numbers.pack_lane(values)
    params: Params = tree.rebuild_tree(batch.loop.params, _unpack_leaves(batch.loop.params, packed))
    problem = batch.problem
    reference = problem.reference
    title = f"{problem.scenario.title}, {what}"
    plant = problem.plant._replace(params=params.plant)
    return problem._replace(
        scenario=msgspec.structs.replace(problem.scenario, title=title),
        plant=plant,
        sensor=with_gaps(_sensor_of_run(problem.sensor, params), plant),
        reference=reference._replace(Q=reference.Q * params.scale.reference),
    )


def _sensor_of_run(sensor: Zone, params: Params) -> Zone:
    """Return the sensor with the numbers of one run."""
    changes = {"noise": params.scale.after, "noise_before": params.scale.before}
    numbers = params.sensor._asdict()
    limits = numbers.pop("limits")
    if limits is not None:
        changes |= limits._asdict()
    gaps = {side: numbers.pop(f"gap_{side}") for side in ("right", "left")}
    if sensor.play is not None:
        changes["play"] = sensor.play._replace(**gaps)
    for name, value in numbers.items():
        if value.size:
            changes[name] = value
    return msgspec.structs.replace(sensor, **changes)


def _unpack_leaves(like: Any, numbers: Floats) -> Iterator[Floats]:
    """Yield the parts of packed numbers in the shapes of a tree's leaves."""
    start = 0
    for _, leaf in tree.iterate_leaves(like):
        yield numbers[start : start + np.size(leaf)].reshape(np.shape(leaf), order="F")
        start += np.size(leaf)
