"""Blocks computed by the workers of a Dask cluster.

A task is a batch of blocks of about a second, and few tasks wait at a time. A worker prepares a job
once and keeps it. Tasks of a worker that dies are computed again by the others.
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

LONGEST = 1.5  # [s] of a task
SHORTEST = 0.1  # [s] of a task: below it, the few ms that scheduling takes are no longer few
LARGEST = 2**24  # [bytes] of a task's rows
AHEAD = 2  # tasks for each thread of the cluster: one at work, one waiting
REACH = 5.0  # [s] to connect to a scheduler
PATIENCE = 20.0  # [s] without a result until it matters that no worker is there
# Run by each worker: Ctrl-C is for this process, which then stops its workers.
DEAF = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"


def results(
    prepare: Callable[[], Job],
    blocks: Sequence[int],
    *,
    workers: int | None = None,
    cluster: str | None = None,
) -> Iterator[tuple[int, Floats]]:
    """(block, its rows) as they are computed, in any order.

    Args:
        prepare: gives the job; picklable, such as a `functools.partial` of a function of an
            importable module
        blocks: to be computed
        workers: number of local processes that compute
        cluster: address of the cluster that computes, if no local processes do

    Raises:
        InputError: for anything but one of `workers` and `cluster`, or where distributed is missing
        ClusterError: where the cluster fails

    What a block raises on a worker is raised here.
    """
    one_of_both = (workers is None) != (cluster is None)
    if not one_of_both or (workers is not None and workers < 1):
        raise InputError(
            "workers, cluster: expected a number of local processes, 1 or more, or an address; "
            f"found {workers} and {cluster}"
        )
    where = cluster if cluster is not None else f"{workers} local workers"
    payload = pickle.dumps(prepare)
    with _client(where, workers, cluster) as client:
        yield from _balanced(where, client, payload, blocks)


def batch_size(seconds: float, size: int, left: int, threads: int) -> int:
    """The number of blocks in the next task.

    It is about `LONGEST` of work, less towards the end so that all threads end together.

    Args:
        seconds: that a block takes [s]
        size: of the rows of a block [bytes]
        left: number of blocks that are in no task yet
        threads: of the cluster
    """
    share = left // (AHEAD * threads)
    enough = max(share, int(SHORTEST / seconds))
    return max(1, min(int(LONGEST / seconds), LARGEST // size, enough))


def _balanced(
    where: str, client: Any, payload: bytes, blocks: Sequence[int]
) -> Iterator[tuple[int, Floats]]:
    """(block, its rows) as they are computed: each thread has a task at work and one that waits."""
    here = versions()
    finished: SimpleQueue[Any] = SimpleQueue()
    running: dict[Any, Sequence[int]] = {}  # the blocks of each task, by its future
    submitted = 0  # number of blocks
    seconds, size = float("inf"), 1  # of a block: [s], [bytes]
    while submitted < len(blocks) or running:
        with _one_line(where):
            threads = max(1, sum(client.nthreads().values()))
            while submitted < len(blocks) and len(running) < AHEAD * threads:
                count = batch_size(seconds, size, len(blocks) - submitted, threads)
                batch = blocks[submitted : submitted + count]
                submitted += len(batch)
                future = client.submit(_compute, payload, here, batch, pure=False)
                running[future] = batch
                future.add_done_callback(finished.put)
            future = _next(where, client, finished)
            elapsed, rows = future.result()
        batch = running.pop(future)
        seconds = max(elapsed, 1e-6) / len(batch)
        size = rows[0].nbytes
        yield from zip(batch, rows, strict=True)


def _next(where: str, client: Any, finished: SimpleQueue[Any]) -> Any:
    """The next task that is done. Raises ClusterError where none comes and no worker is there."""
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
    """On a worker: the job, prepared once. Raises ClusterError where versions differ."""
    installed = versions()
    differences = []
    for name, version in expected:
        if installed[name] != version:
            differences.append(f"{name} {installed[name]} there, {version} here")
    if differences:
        raise ClusterError(
            f"a worker of the cluster has other versions: {', '.join(differences)}; "
            "the last bits would differ, so install the same"
        )
    return pickle.loads(payload)()


@contextmanager
def _client(where: str, workers: int | None, cluster: str | None) -> Iterator[Any]:
    """A client of local workers or of a cluster. Raises InputError, ClusterError."""
    try:
        import distributed  # noqa: F401
    except ImportError:
        raise InputError(
            "workers, cluster: the package distributed is missing; pip install 'undeadzone[dask]'"
        ) from None
    if workers is not None:
        with _local_client(workers) as client:
            yield client
    else:
        with _remote_client(where, str(cluster)) as client:
            yield client


@contextmanager
def _local_client(workers: int) -> Iterator[Any]:
    """A client of workers on this computer, one thread each."""
    from distributed import Client, LocalCluster

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


@contextmanager
def _remote_client(where: str, cluster: str) -> Iterator[Any]:
    """A client of the cluster at an address. Raises ClusterError."""
    from distributed import Client
    from distributed.utils import silence_logging_cmgr

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

    options = Security().get_connection_args("client")
    try:
        hands = connect(cluster, timeout=REACH, **options)
        comm = await asyncio.wait_for(hands, 2 * REACH)
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
        workers = f"{error.allowed_failures + 1} workers"
        raise ClusterError(
            f"{where}: {workers} died one after the other at the same blocks; out of memory?"
        ) from None
    except CancelledError:
        raise ClusterError(f"{where}: the scheduler has gone") from None
    except ImportError as error:
        raise ClusterError(
            f"{where}: {error.name} cannot be imported there; "
            "install it on the scheduler and on every worker"
        ) from None
    except OSError as error:
        raise ClusterError(f"{where}: {error}") from None
