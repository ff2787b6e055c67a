"""From a scenario to its ensemble: computed and kept block by block, then put together."""

from __future__ import annotations

import dataclasses
import functools
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

import undeadzone
from undeadzone.ensemble.batch import Batch, prepare
from undeadzone.ensemble.blocks import run_blocks, table_file
from undeadzone.ensemble.blocks.journal import Store
from undeadzone.ensemble.info import Info
from undeadzone.ensemble.replay import recorded_bands, replay
from undeadzone.ensemble.result import Ensemble
from undeadzone.errors import FileError
from undeadzone.results.run import Run
from undeadzone.scenario.ensemble_table import Vary
from undeadzone.scenario.reader import anchored, parse
from undeadzone.scenario.schema import Scenario
from undeadzone.support import toml
from undeadzone.support.progress import in_notebook

RECORDED = 256  # runs whose signals make the bands


def run_ensemble(
    scenario: Scenario,
    path: Path | str | None = None,
    *,
    resume: bool = False,
    workers: int | None = None,
    cluster: str | None = None,
    progress: Callable[[int], None] | None = None,
) -> Ensemble:
    """Run the scenario's [ensemble] and save it at `path`, or keep it in memory without one.

    Blocks of runs are kept in PATH.partial as they are done. The bits are the same wherever they
    are computed.

    Args:
        scenario: with a table [ensemble]
        path: of the result, `.npz` or `.parquet`; None: in memory
        resume: continue what an interrupted call left there, and leave a finished file as it is
        workers: number of local processes that compute; default: this one
        cluster: address of a Dask cluster that computes instead
        progress: called from this thread with the number of runs just done; None: a bar in a
            notebook

    Returns:
        The ensemble; the columns of a saved one stay on disk and are read as they are used.

    Raises:
        InputError or a subclass: FileError where a file cannot be read or written, ClusterError
            where the cluster fails
    """
    if path is not None:
        table_file.require(Path(path))
    scenario = anchored(scenario, Path.cwd())  # for workers, and for replays from elsewhere
    batch = prepare(scenario)
    make = functools.partial(prepare, scenario)
    if workers is None and cluster is None:
        make = functools.partial(_as_it_is, batch)
    with in_notebook(progress, "running", batch.layout.runs, "runs") as advance:
        compute = functools.partial(
            run_blocks.run, make, workers=workers, cluster=cluster, progress=advance
        )
        if path is None:
            return _in_memory(batch, compute)
        return _on_disk(batch, compute, Path(path), resume)


def _on_disk(batch: Batch, compute: Callable[..., Store], path: Path, resume: bool) -> Ensemble:
    """The ensemble whose blocks `compute` keeps beside the file that it becomes."""
    partial = path.with_name(f"{path.name}.partial")
    if resume and not partial.exists():
        finished = _finished(path, batch)
        if finished is not None:
            return finished
    store = compute(partial, resume=resume)
    with run_blocks.keeping(store):
        _result(batch, store).save(path)
    store.remove()
    return Ensemble.load(path)


def replay_run(result: Ensemble, run: int) -> Run:
    """A run of an ensemble with all its signals.

    Its states are to the last bit what they were in the ensemble, if nothing has changed since
    (`deviation`).

    Args:
        result: the ensemble
        run: number of the run, from 0

    Returns:
        The run, as `simulate` returns it.

    Raises:
        InputError: or a subclass, for what is wrong with the scenario.
    """
    return replay(prepare(parse(result.info.scenario)), run)


def deviation(result: Ensemble, run: int) -> float:
    """How far a run here and now lies from what it was in the ensemble.

    Args:
        result: the ensemble
        run: number of the run, from 0

    Returns:
        The largest relative difference of its values and metrics; 0: none differs by a bit.

    Raises:
        InputError: or a subclass, for what is wrong with the scenario.
    """
    kept = result.row(run)
    batch = prepare(parse(result.info.scenario))
    values = batch.binding.draw(run, 1, batch.layout.runs)
    here = batch.rows(np.array([run]), values)[0]
    there = np.array([*kept["varied"].values(), *kept["metrics"].values()])
    differs = ~((here == there) | np.isnan(here) & np.isnan(there))
    with np.errstate(invalid="ignore"):
        size = np.abs(here - there)[differs] / np.abs(there[differs])
    return float(np.nan_to_num(size, nan=np.inf, posinf=np.inf).max(initial=0.0))


def _as_it_is(batch: Batch) -> Batch:
    """The batch: it need not be prepared again where it is computed in this process."""
    return batch


def _in_memory(batch: Batch, compute: Callable[[Path], Store]) -> Ensemble:
    """The result of a store in a folder that is gone afterwards."""
    with tempfile.TemporaryDirectory() as folder:
        store = compute(Path(folder) / "runs.partial")
        result = _result(batch, store)
        varied = {name: np.array(column) for name, column in result.varied.items()}
        metrics = {name: np.array(column) for name, column in result.metrics.items()}
        store.remove()
    return dataclasses.replace(result, varied=varied, metrics=metrics)


def _finished(path: Path, batch: Batch) -> Ensemble | None:
    """What a file holds if that is what would be computed."""
    try:
        saved = Ensemble.load(path)
    except FileError:
        return None
    return saved if saved.info == _info(batch) else None


def _result(batch: Batch, store: Store) -> Ensemble:
    """The result of a complete store; its columns are those of the store, on disk."""
    columns = store.columns()
    info = _info(batch)
    varied = {name: columns.pop(name) for name in batch.binding.names}
    return Ensemble(varied, columns, info, recorded_bands(batch, info.recorded))


def _info(batch: Batch) -> Info:
    """What the result says of the scenario and of how it was computed."""
    problem = batch.problem
    scenario = problem.scenario
    vary = scenario.ensemble or Vary()
    widths = np.stack([problem.sensor.right, problem.sensor.left], axis=1)
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
        widths=widths.ravel().tolist(),
        scenario=toml.dumps(scenario),
        version=undeadzone.__version__,
        recorded=min(RECORDED, batch.layout.runs),
        numbers=str(batch.layout.problem["numbers"]),
        units=scenario.units,
    )
