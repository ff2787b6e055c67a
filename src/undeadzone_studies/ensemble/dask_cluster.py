"""Blocks computed by the workers of a Dask cluster, a batch per task.

A worker prepares a job once and keeps it. Tasks of a worker that dies are computed again by the
others. Whoever can reach the scheduler can run code on the workers and read their answers: the
cluster is trusted as this computer is.
"""

from __future__ import annotations

import asyncio
import functools
import logging
import pickle
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

from undeadzone.errors import ClusterError, InputError, UndeadzoneError
from undeadzone.util.arrays import Floats
from undeadzone.util.installed import package_versions
from undeadzone_studies.ensemble.job import Job, Pool, compute_blocks

REACH = 5.0  # [s] to connect to a scheduler


@contextmanager
def open_dask_pool(prepare: Callable[[], Job], cluster: str) -> Iterator[Pool]:
    """Provide the workers of a cluster.

    Args:
        prepare: gives the job (picklable, such as a `functools.partial` of a function of an
            importable module)
        cluster: address of the scheduler

    Raises:
        InputError: where distributed is missing
        ClusterError: if the cluster fails
    """
    payload = pickle.dumps(prepare)
    here = package_versions()
    with _open_client(cluster) as client:

        def require_work() -> None:
            """Raise ClusterError if the cluster has no worker."""
            if not client.nthreads():
                raise ClusterError(
                    f"{cluster}: no worker is there. Start some (dask worker {cluster})"
                )

        yield Pool(
            threads=lambda: sum(client.nthreads().values()),
            submit=lambda batch: client.submit(
                _compute_on_worker, payload, here, batch, pure=False
            ),
            failures=lambda: _convert_failures(cluster),
            require_work=require_work,
        )


def _compute_on_worker(
    payload: bytes, expected: dict[str, str], blocks: Sequence[int]
) -> tuple[float, list[Floats]]:
    """Return the seconds that blocks took, and their rows. Runs on a worker."""
    return compute_blocks(_prepare_once(payload, tuple(expected.items())), blocks)


@functools.lru_cache(maxsize=2)
def _prepare_once(payload: bytes, expected: tuple[tuple[str, str], ...]) -> Job:
    """Return the job, prepared once. Runs on a worker. Raises ClusterError if versions differ."""
    installed = package_versions()
    differences = []
    for name, version in expected:
        if installed[name] != version:
            differences.append(f"{name} {installed[name]} there, {version} here")
    if differences:
        raise ClusterError(
            f"a worker of the cluster has other versions: {', '.join(differences)}. "
            "The last bits would differ, so install the same"
        )
    return pickle.loads(payload)()


@contextmanager
def _open_client(cluster: str) -> Iterator[Any]:
    """Provide a client of the cluster at an address. Raises InputError, ClusterError."""
    try:
        from distributed import Client
    except ImportError:
        raise InputError(
            "cluster: the package distributed is missing: pip install 'undeadzone[dask]'"
        ) from None
    from distributed.utils import silence_logging_cmgr

    with ThreadPoolExecutor(1) as beside:  # a notebook's own thread has an event loop already
        beside.submit(asyncio.run, _reach(cluster)).result()
    with (
        silence_logging_cmgr(logging.CRITICAL),
        Client(cluster, timeout=REACH, set_as_default=False) as client,
    ):
        with _convert_failures(cluster):  # a worker that cannot read a task would die of it
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
    except Exception as error:  # any error of a server that is not a scheduler
        raise ClusterError(
            f"{cluster}: no Dask scheduler answers there: {str(error) or 'silence'}"
        ) from None
    await comm.close()


@contextmanager
def _convert_failures(where: str) -> Iterator[None]:
    """Convert failures of the cluster itself to ClusterError."""
    from distributed import CancelledError, KilledWorker

    try:
        yield
    except UndeadzoneError:
        raise
    except KilledWorker as error:
        workers = f"{error.allowed_failures + 1} workers"
        raise ClusterError(
            f"{where}: {workers} died one after the other at the same blocks, perhaps out of memory"
        ) from None
    except CancelledError:
        raise ClusterError(f"{where}: the scheduler has gone") from None
    except ImportError as error:
        raise ClusterError(
            f"{where}: {error.name} cannot be imported there. "
            "Install it on the scheduler and on every worker"
        ) from None
    except OSError as error:
        raise ClusterError(f"{where}: {error}") from None
