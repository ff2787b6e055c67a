"""What is computed for an ensemble: a row of numbers for each run, in blocks of runs."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from undeadzone.support.arrays import Floats


class Layout(NamedTuple):
    """The shape of the rows of a job, and what determines their numbers.

    Attributes:
        runs: number of rows
        columns: names of the columns
        block: runs in a block; the last block may be shorter
        problem: everything that the numbers depend on besides the number of runs and the versions
            of packages, by name
    """

    runs: int
    columns: tuple[str, ...]
    block: int
    problem: dict[str, str | int | float]

    @property
    def blocks(self) -> int:
        """The number of blocks."""
        return -(-self.runs // self.block)

    def within(self, block: int) -> slice:
        """The runs of a block."""
        return slice(block * self.block, min((block + 1) * self.block, self.runs))


class Job(Protocol):
    """Work cut into blocks: the rows of a block (runs x columns) depend on its index alone."""

    @property
    def layout(self) -> Layout:
        """What the blocks make up."""

    def block(self, index: int, threads: int | None = None) -> Floats:
        """The rows of one block; callable from several threads.

        Args:
            index: of the block
            threads: on which to compute; default: one per processor
        """
