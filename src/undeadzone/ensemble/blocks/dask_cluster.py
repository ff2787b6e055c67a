"""Blocks computed by the workers of a Dask cluster: each task a batch of about a second, few tasks waiting at a time.

A worker prepares a job once and keeps it. Tasks of a worker that dies are computed again by the others.
"""

from __future__ import annotations

import asyncio
import functools
import logging
import pickle
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from queue import Empty, SimpleQueue
from typing import Any

from undeadzone.ensemble.blocks.job import Job, versions
from undeadzone.errors import ClusterError, InputError, UndeadzoneError
from undeadzone.support.arrays import Floats

LONGEST, SHORTEST = (
    1.5,
    0.1,
)  # [s] of a task: below the latter, the few ms that scheduling takes are no longer few
LARGEST = 2**24  # [bytes] of a task's rows
AHEAD = 2  # tasks for each thread of the cluster: one at work, one waiting
REACH = 5.0  # [s] to connect to a scheduler
DEAF = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"  # Ctrl-C is for this process, which then stops its workers
PATIENCE = 20.0  # [s] without a result until it matters that no worker is there


def results(
    prepare: Callable[[], Job],
    blocks: Sequence[int],
    *,
    workers: int | None = None,
    cluster: str | None = None,
) -> Iterator[tuple[int, Floats]]:
    """(block, its rows) as they are computed, in any order, by that many local processes or the cluster at an address.

    prepare: picklable, such as a `functools.partial` of a function of an importable module. Raises InputError and
    ClusterError; what a block raises on a worker is raised here.
    """
    if (workers is None) == (cluster is None) or (workers is not None and workers < 1):
        raise InputError(
            f"workers, cluster: expected a number of local processes, 1 or more, or an address; found {workers} and {cluster}"
        )
    where = cluster if cluster is not None else f"{workers} local workers"
    payload = pickle.dumps(prepare)
    with _client(where, workers, cluster) as client:
        yield from _balanced(where, client, payload, blocks)


def batch_size(seconds: float, size: int, left: int, threads: int) -> int:
    """Blocks for the next task, given seconds and bytes of each: about `LONGEST` of work, less towards the end so that all end together."""
    share = left // (AHEAD * threads)
    return max(1, min(int(LONGEST / seconds), LARGEST // size, max(share, int(SHORTEST / seconds))))


def _balanced(
    where: str, client: Any, payload: bytes, blocks: Sequence[int]
) -> Iterator[tuple[int, Floats]]:
    here = versions()
    finished: SimpleQueue[Any] = SimpleQueue()
    running: dict[Any, Sequence[int]] = {}
    given, seconds, size = 0, float("inf"), 1
    while given < len(blocks) or running:
        with _one_line(where):
            threads = max(1, sum(client.nthreads().values()))
            while given < len(blocks) and len(running) < AHEAD * threads:
                batch = blocks[
                    given : given + batch_size(seconds, size, len(blocks) - given, threads)
                ]
                given += len(batch)
                future = client.submit(_compute, payload, here, batch, pure=False)
                running[future] = batch
                future.add_done_callback(finished.put)
            future = _next(where, client, finished)
            elapsed, rows = future.result()
        batch = running.pop(future)
        seconds, size = max(elapsed, 1e-6) / len(batch), rows[0].nbytes
        yield from zip(batch, rows, strict=True)


def _next(where: str, client: Any, finished: SimpleQueue[Any]) -> Any:
    while True:
        try:
            return finished.get(timeout=PATIENCE)
        except Empty:
            if not client.nthreads():
                raise ClusterError(
                    f"{where}: no worker is there; start some (dask worker {where})"
                ) from None


def _compute(
    payload: bytes, expected: dict[str, str], blocks: Sequence[int]
) -> tuple[float, list[Floats]]:
    """On a worker: the seconds that blocks took, and their rows."""
    job = _prepared(payload, tuple(expected.items()))
    began = time.perf_counter()
    rows = [job.block(block, threads=1) for block in blocks]
    return time.perf_counter() - began, rows


@functools.lru_cache(maxsize=2)
def _prepared(payload: bytes, expected: tuple[tuple[str, str], ...]) -> Job:
    found = versions()
    if differ := [
        f"{name} {found[name]} there, {version} here"
        for name, version in expected
        if found[name] != version
    ]:
        raise ClusterError(
            f"a worker of the cluster has other versions: {', '.join(differ)}; the last bits would differ, so install the same"
        )
    return pickle.loads(payload)()


@contextmanager
def _client(where: str, workers: int | None, cluster: str | None) -> Iterator[Any]:
    try:
        from distributed import Client, LocalCluster
        from distributed.utils import silence_logging_cmgr
    except ImportError:
        raise InputError(
            "workers, cluster: the package distributed is missing; pip install 'undeadzone[dask]'"
        ) from None
    if cluster is None:
        options = {
            "host": "127.0.0.1",
            "dashboard_address": "127.0.0.1:0",
            "silence_logs": logging.CRITICAL,
            "preload": [DEAF],
        }
        with (
            LocalCluster(n_workers=workers, threads_per_worker=1, **options) as local,
            Client(local, set_as_default=False) as client,
        ):
            yield client
        return
    with ThreadPoolExecutor(1) as beside:  # a notebook's own thread has an event loop already
        beside.submit(asyncio.run, _reach(cluster)).result()
    with (
        silence_logging_cmgr(logging.CRITICAL),
        Client(cluster, timeout=REACH, set_as_default=False) as client,
    ):
        with _one_line(where):  # a worker that cannot read a task would die of it
            client.run_on_scheduler(exec, "import undeadzone")
            client.run(exec, "import undeadzone")
        yield client


async def _reach(cluster: str) -> None:
    """Shake hands with a scheduler: a `Client` that fails to do so leaves tracebacks behind."""
    from distributed.comm import connect
    from distributed.security import Security

    try:
        comm = await asyncio.wait_for(
            connect(cluster, timeout=REACH, **Security().get_connection_args("client")), 2 * REACH
        )
    except Exception as error:  # whatever a server that is no scheduler makes of it
        raise ClusterError(
            f"{cluster}: no Dask scheduler answers there: {str(error) or 'silence'}"
        ) from None
    await comm.close()


@contextmanager
def _one_line(where: str) -> Iterator[None]:
    """Failures of the cluster itself as ClusterError."""
    from distributed import CancelledError, KilledWorker

    try:
        yield
    except UndeadzoneError:
        raise
    except KilledWorker as error:
        raise ClusterError(
            f"{where}: {error.allowed_failures + 1} workers died one after the other at the same blocks; out of memory?"
        ) from None
    except CancelledError:
        raise ClusterError(f"{where}: the scheduler has gone") from None
    except ImportError as error:
        raise ClusterError(
            f"{where}: {error.name} cannot be imported there; install it on the scheduler and on every worker"
        ) from None
    except OSError as error:
        raise ClusterError(f"{where}: {error}") from None
