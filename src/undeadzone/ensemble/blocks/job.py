"""What is computed for an ensemble: a row of numbers for each run, in blocks of runs."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from typing import NamedTuple, Protocol

import undeadzone
from undeadzone.support.arrays import Floats


class Layout(NamedTuple):
    """`runs` rows of `columns`, in blocks of `block` runs (the last one may be shorter), and what determines them.

    problem: everything that the numbers depend on besides the number of runs and the versions of packages, by name.
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
    """Work cut into blocks: the rows of a block (its runs x columns) are a function of its index alone."""

    @property
    def layout(self) -> Layout:
        """What the blocks make up."""

    def block(self, index: int, threads: int | None = None) -> Floats:
        """The rows of one block, on that many threads (default: one per processor); callable from several threads."""


def versions() -> dict[str, str]:
    """The packages that decide the last bits of the results."""
    return {
        "undeadzone": undeadzone.__version__,
        **{name: _version(name) for name in ("casadi", "numba", "llvmlite", "numpy", "scipy")},
    }


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "missing"
