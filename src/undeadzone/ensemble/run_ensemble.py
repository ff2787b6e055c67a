"""From a scenario with an [ensemble] to its result: computed block by block, kept on the way, put together at the end."""

from __future__ import annotations

import dataclasses
import functools
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

import undeadzone
from undeadzone.ensemble.batch import Batch, prepare
from undeadzone.ensemble.blocks import run_blocks as execute
from undeadzone.ensemble.blocks import table_file as storage
from undeadzone.ensemble.blocks.journal import Store
from undeadzone.ensemble.replay import recorded_bands, replay
from undeadzone.ensemble.result import Ensemble, Info
from undeadzone.errors import FileError
from undeadzone.scenario.ensemble_table import Vary
from undeadzone.scenario.reader import anchored, parse
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.run import Run
from undeadzone.support import toml

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
    """Run the scenario's [ensemble] and save it at `path` (.npz, .parquet), or keep it in memory without one.

    Blocks are kept in PATH.partial as they are done. resume: continue what an interrupted call left there, and leave a
    finished file as it is. workers, cluster: compute on that many processes, or on the Dask cluster at that address; the
    bits are the same. progress: told of runs just done, from this thread. Raises InputError and its kinds: FileError, ClusterError.
    """
    if path is not None:
        storage.require(Path(path))
    scenario = anchored(scenario, Path.cwd())  # for workers, and for replays from elsewhere
    fleet = prepare(scenario)
    make = (
        (lambda: fleet)
        if workers is None and cluster is None
        else functools.partial(prepare, scenario)
    )
    if path is None:
        with tempfile.TemporaryDirectory() as folder:
            store = execute.run(
                make,
                Path(folder) / "runs.partial",
                workers=workers,
                cluster=cluster,
                progress=progress,
            )
            found = _result(fleet, store)
            varied, kept = (
                {name: np.array(column) for name, column in part.items()}
                for part in (found.varied, found.metrics)
            )
            store.remove()
            return dataclasses.replace(found, varied=varied, metrics=kept)
    path = Path(path)
    partial = path.with_name(f"{path.name}.partial")
    if resume and not partial.exists() and (finished := _finished(path, fleet)) is not None:
        return finished
    store = execute.run(
        make, partial, resume=resume, workers=workers, cluster=cluster, progress=progress
    )
    with execute.keeping(store):
        _result(fleet, store).save(path)
    store.remove()
    return Ensemble.load(path)


def replay_run(result: Ensemble, run: int) -> Run:
    """A run of an ensemble with all its signals, its states to the last bit what they were there (`deviation` tells). Raises InputError."""
    return replay(prepare(parse(result.info.scenario)), run)


def deviation(result: Ensemble, run: int) -> float:
    """How far what a run leaves here and now lies from what it left in the ensemble, relative to it; 0: to the last bit. Raises InputError."""
    kept = result.row(run)
    fleet = prepare(parse(result.info.scenario))
    found = fleet.rows(np.array([run]), fleet.binding.draw(run, 1, fleet.layout.runs))[0]
    expected = np.array([*kept["varied"].values(), *kept["metrics"].values()])
    differs = ~((found == expected) | np.isnan(found) & np.isnan(expected))
    with np.errstate(invalid="ignore"):
        size = np.abs(found - expected)[differs] / np.abs(expected[differs])
    return float(np.nan_to_num(size, nan=np.inf, posinf=np.inf).max(initial=0.0))


def _finished(path: Path, fleet: Batch) -> Ensemble | None:
    """What a file holds if that is what would be computed."""
    try:
        found = Ensemble.load(path)
    except FileError:
        return None
    return found if found.info == _info(fleet) else None


def _result(fleet: Batch, store: Store) -> Ensemble:
    """The result of a complete store; its columns are those of the store, on disk."""
    columns, info = store.columns(), _info(fleet)
    varied = {name: columns.pop(name) for name in fleet.binding.names}
    return Ensemble(varied, columns, info, recorded_bands(fleet, info.recorded))


def _info(fleet: Batch) -> Info:
    problem, scenario = fleet.problem, fleet.problem.scenario
    vary = scenario.ensemble or Vary()
    return Info(
        title=scenario.title,
        method=str(type(scenario.observer).__struct_config__.tag),
        time=scenario.simulation.time,
        step=scenario.simulation.step,
        duration=scenario.simulation.duration,
        seed=fleet.binding.seed,
        sampling=vary.sampling,
        runs=fleet.layout.runs,
        tolerance=vary.tolerance,
        tracked=problem.tracked,
        widths=np.stack([problem.sensor.right, problem.sensor.left], axis=1).ravel().tolist(),
        scenario=toml.dumps(scenario),
        version=undeadzone.__version__,
        recorded=min(RECORDED, fleet.layout.runs),
        numbers=str(fleet.layout.problem["numbers"]),
        units=scenario.units,
    )
