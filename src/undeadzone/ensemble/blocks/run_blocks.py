"""Compute what is missing of an ensemble, here or on a cluster, and keep each block as it comes."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from undeadzone.ensemble.blocks import journal
from undeadzone.ensemble.blocks.job import Job
from undeadzone.errors import UndeadzoneError
from undeadzone.support.arrays import Floats


def run(
    prepare: Callable[[], Job],
    path: Path,
    *,
    resume: bool = False,
    workers: int | None = None,
    cluster: str | None = None,
    progress: Callable[[int], None] | None = None,
) -> journal.Store:
    """The complete store of a job at `path`: read its `columns` inside `keeping`, `remove` it once they are elsewhere, or `close` it.

    resume: keep the blocks that an earlier run left there. workers, cluster: compute on that many processes, or on the
    Dask cluster at that address; the bits are the same. progress: told of runs just done. What stops it (Ctrl-C, an
    error) says what is kept. Raises InputError and its kinds: FileError, ClusterError.
    """
    job = prepare()
    store = journal.start(path, job.layout, resume)
    tell = progress or (lambda runs: None)
    with keeping(store):
        if store.runs_done:
            tell(store.runs_done)
        with closing(_results(prepare, job, store.missing, workers, cluster)) as blocks:
            for block, rows in blocks:
                store.put(block, rows)
                tell(len(rows))
    return store


@contextmanager
def keeping(store: journal.Store) -> Iterator[None]:
    """Close the store if something stops what is done inside, which then says what is kept; an empty store is removed."""
    try:
        yield
    except KeyboardInterrupt:
        raise KeyboardInterrupt(_leave(store)) from None
    except UndeadzoneError as error:
        raise type(error)("; ".join(filter(None, (str(error), _leave(store))))) from None
    except BaseException as error:
        kept = _leave(store)
        if isinstance(
            error.__context__, KeyboardInterrupt
        ):  # Ctrl-C within a lock of the thread pool ends as a RuntimeError
            raise KeyboardInterrupt(kept) from None
        raise


def _results(
    prepare: Callable[[], Job],
    job: Job,
    blocks: list[int],
    workers: int | None,
    cluster: str | None,
) -> Generator[tuple[int, Floats], None, None]:
    if workers is not None or cluster is not None:
        from undeadzone.ensemble.blocks.dask_cluster import results

        yield from results(prepare, blocks, workers=workers, cluster=cluster)
        return
    for block in blocks:
        yield block, job.block(block)


def _leave(store: journal.Store) -> str:
    if not store.runs_done:
        store.remove()
        return ""
    store.close()
    return f"{store.runs_done} of {store.layout.runs} runs are kept in {store.path}; continue with --resume"
