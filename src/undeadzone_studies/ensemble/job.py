"""Work of an ensemble: a row of numbers for each run, in blocks of runs.

Blocks are shared out among processes in batches of about a second. Few batches wait at a time.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple, Protocol

from undeadzone.util.arrays import Floats

LONGEST = 1.5  # [s] of a batch
SHORTEST = 0.1  # [s] of a batch: below it, the few ms for sharing out matter
LARGEST = 2**24  # [bytes] of a batch's rows
AHEAD = 2  # batches for each thread: one at work, one waiting
PATIENCE = 20.0  # [s] without a result until it matters whether anybody is at work


class Layout(NamedTuple):
    """Shape of the rows of a job, and the data that determine their numbers.

    Attributes:
        runs: number of rows
        columns: names of the columns
        block: runs in a block (the last block may be shorter)
        problem: everything that the numbers depend on besides the number of runs and the versions
            of packages, by name
    """

    runs: int
    columns: tuple[str, ...]
    block: int
    problem: dict[str, str | int | float]

    @property
    def number_of_blocks(self) -> int:
        """Return the number of blocks."""
        return -(-self.runs // self.block)

    def runs_in_block(self, block: int) -> range:
        """Return the runs of a block."""
        return range(block * self.block, min((block + 1) * self.block, self.runs))


class Work(Protocol):
    """Work cut into blocks: the result of a block depends on its index alone."""

    def block(self, index: int, threads: int | None = None) -> Any:
        """Return the result of one block, callable from several threads.

        Args:
            index: of the block
            threads: on which to compute (default: one per processor)
        """


class Job(Work, Protocol):
    """Work of an ensemble: the result of a block is its rows (runs x columns)."""

    @property
    def layout(self) -> Layout:
        """Return the layout of the blocks."""

    def block(self, index: int, threads: int | None = None) -> Floats:
        """Return the rows of one block, callable from several threads.

        Args:
            index: of the block
            threads: on which to compute (default: one per processor)
        """


class Pool(NamedTuple):
    """Processes that compute batches.

    Attributes:
        threads: the number of batches that they compute at once.
        submit: takes the blocks of a batch, returns a future of what `compute` returns.
        failures: a context that raises their own failures as ClusterError.
        require_work: raises ClusterError where nobody is at work.
    """

    threads: Callable[[], int]
    submit: Callable[[Sequence[int]], Any]
    failures: Callable[[], AbstractContextManager[None]]
    require_work: Callable[[], None]


def yield_block_rows(pool: Pool, blocks: Sequence[int]) -> Iterator[tuple[int, Floats]]:
    """Yield (block, its rows) as they are computed, in any order.

    Args:
        pool: who computes.
        blocks: to be computed.

    Raises:
        ClusterError: if the pool fails

    An exception in a block is raised here.
    """
    finished: SimpleQueue[Any] = SimpleQueue()
    running: dict[Any, Sequence[int]] = {}  # the blocks of each batch, by its future
    submitted = 0  # number of blocks
    # of a block: [s], [bytes]
    seconds = float("inf")
    size = 1
    while submitted < len(blocks) or running:
        with pool.failures():
            threads = max(1, pool.threads())
            while submitted < len(blocks) and len(running) < AHEAD * threads:
                count = batch_size(seconds, size, len(blocks) - submitted, threads)
                batch = blocks[submitted : submitted + count]
                submitted += len(batch)
                future = pool.submit(batch)
                running[future] = batch
                future.add_done_callback(finished.put)
            future = _wait_for_batch(pool, finished)
            elapsed, rows = future.result()
        batch = running.pop(future)
        seconds = max(elapsed, 1e-6) / len(batch)
        size = rows[0].nbytes
        yield from zip(batch, rows, strict=True)


def batch_size(seconds: float, size: int, left: int, threads: int) -> int:
    """Return the number of blocks in the next batch.

    It is about `LONGEST` of work, less towards the end so that all threads end together.

    Args:
        seconds: that a block takes [s]
        size: of the rows of a block [bytes]
        left: number of blocks that are in no batch yet
        threads: on which batches are computed
    """
    share = left // (AHEAD * threads)
    enough = max(share, int(SHORTEST / seconds))
    return max(1, min(int(LONGEST / seconds), LARGEST // size, enough))


def compute_blocks(job: Work, blocks: Sequence[int]) -> tuple[float, list[Any]]:
    """Return the seconds that blocks took, and their results."""
    began = time.perf_counter()
    rows = [job.block(block, threads=1) for block in blocks]
    return time.perf_counter() - began, rows


def _wait_for_batch(pool: Pool, finished: SimpleQueue[Any]) -> Any:
    """Return the next finished batch.

    Raises ClusterError if no batch comes and no worker runs.
    """
    while True:
        try:
            return finished.get(timeout=PATIENCE)
        except Empty:
            pool.require_work()
