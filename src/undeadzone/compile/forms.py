"""What a kernel is compiled for, and how it computes its lanes."""

from __future__ import annotations

from typing import Final, NamedTuple

# Instructions of a step beyond which groups go alone, and beyond which in the order of the graph.
PAIRED: Final = 350
LARGE: Final = 700


class Shape(NamedTuple):
    """What a kernel is compiled for.

    Attributes:
        sizes: of s, w and p.
        exogenous, params: entries of w and p that each lane has for itself.
        record: outputs that are kept.
    """

    sizes: tuple[int, int, int]
    exogenous: tuple[int, ...]
    params: tuple[int, ...]
    record: tuple[int, ...]


class Form(NamedTuple):
    """How the lanes of a kernel are computed; it changes no bit.

    Attributes:
        lanes: of a vector; 1 for plain numbers.
        streams: groups side by side, so that one works while the other waits.
        slots: each use of a shared number has an entry of a table for itself, which becomes an
            operand of its instruction (AVX-512).
        registers: numbers of a group that may wait for their use; 0 for the order of the graph.
        branches: instructions of one condition that are worth a branch, of groups that go alone; 0
            for no branches.
    """

    lanes: int
    streams: int
    slots: bool
    registers: int
    branches: int = 0


ONE: Final = Form(1, 1, False, 0, 60)  # for a single run
