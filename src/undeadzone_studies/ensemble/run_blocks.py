"""Compute the missing blocks of an ensemble, here or on a cluster, and store each block as it
arrives.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Generator
from contextlib import AbstractContextManager, closing
from pathlib import Path

from undeadzone.errors import InputError
from undeadzone.util import answers
from undeadzone.util.arrays import Floats
from undeadzone.util.progress import ignore_progress
from undeadzone_studies.ensemble import journal
from undeadzone_studies.ensemble.job import Job, yield_block_rows


def compute_job(
    prepare: Callable[[], Job],
    path: Path,
    *,
    resume: bool = False,
    workers: int | None = None,
    cluster: str | None = None,
    progress: Callable[[int], None] | None = None,
) -> journal.Store:
    """Compute a job and keep its rows in a store on disk.

    If something stops it (Ctrl-C, SIGTERM, an error), a message names the stored blocks. The bits
    do not depend on the computer that computes them.

    Args:
        prepare: gives the job (picklable if workers or a cluster compute)
        path: of the store
        resume: keep the blocks that an earlier run left there
        workers: number of local processes that compute (default: this one)
        cluster: address of a Dask cluster that computes instead
        progress: called with the number of runs just done

    Returns:
        The complete store: read its `map_columns()` inside `close_on_failure`, then `remove` it
        once they are elsewhere, or `close` it.

    Raises:
        InputError or a subclass: FileError, ClusterError
    """
    _require_one_backend(workers, cluster)
    job = prepare()
    store = journal.open_store(path, job.layout, resume)
    report = progress or ignore_progress
    with close_on_failure(store):
        if store.runs_done:
            report(store.runs_done)
        with closing(
            _compute_missing(prepare, job, store.missing_blocks, workers, cluster)
        ) as blocks:
            for block, rows in blocks:
                store.write_block(block, rows)
                report(len(rows))
    return store


def close_on_failure(store: journal.Store) -> AbstractContextManager[None]:
    """Close the store if an exception stops the work inside.

    The message of the exception then names the stored blocks. A store without runs is removed.
    """
    return answers.report_saved_on_stop(functools.partial(_leave_store, store))


def _require_one_backend(workers: int | None, cluster: str | None) -> None:
    """Raise InputError for both workers and a cluster, or for no number of workers."""
    both = workers is not None and cluster is not None
    if both or (workers is not None and workers < 1):
        raise InputError(
            "workers, cluster: expected a number of local processes, 1 or more, or an address, "
            f"found {workers} and {cluster}"
        )


def _compute_missing(
    prepare: Callable[[], Job],
    job: Job,
    blocks: list[int],
    workers: int | None,
    cluster: str | None,
) -> Generator[tuple[int, Floats], None, None]:
    """Yield (block, its rows) as they are computed."""
    if workers is not None:
        from undeadzone_studies.ensemble import local_workers

        with local_workers.open_local_pool(prepare, min(workers, max(1, len(blocks)))) as pool:
            yield from yield_block_rows(pool, blocks)
    elif cluster is not None:
        from undeadzone_studies.ensemble import dask_cluster

        with dask_cluster.open_dask_pool(prepare, cluster) as pool:
            yield from yield_block_rows(pool, blocks)
    else:
        for block in blocks:
            yield block, job.block(block)


def _leave_store(store: journal.Store) -> str:
    """Close a store, or remove an empty store, and describe its contents."""
    if not store.runs_done:
        store.remove()
        return ""
    store.close()
    runs = f"{store.runs_done} of {store.layout.runs} runs"
    return f"{runs} are kept in {store.path}; continue with resume=True"
