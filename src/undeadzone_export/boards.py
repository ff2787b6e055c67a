"""Flash, memory and time of an export on usual boards.

Flash is that of the object which the board's own compiler makes, where it is installed. All else is
estimated from the operations. The shares an operation were measured with gcc 12 -Os on exports of
50 to 12,000 operations: of the written operations, repeated parts once, code for a Cortex-M4F takes
7.8 to 10.5 bytes, for an AVR 30 to 33 (`python -m benchmarks code_size`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from undeadzone.util.files import read_table
from undeadzone_export.compiler import object_bytes

SPARED: Final = 0.75  # share of a board that an observer may take
STACK: Final = 0.3  # bytes of stack an operation that is written down, in single precision
LIBRARY: Final = 4_000  # [bytes] of arithmetic that the chip lacks, beside the object
HOPELESS: Final = 2.0  # flash of a board, so often estimated, from which nothing is compiled
WIDER: Final = 2.0  # bytes in double for one in single


class Board(NamedTuple):
    """Microcontroller board or chip.

    Attributes:
        name: as its users call it.
        flash, ram: [bytes].
        clock: [Hz].
        code: bytes an operation that is written down.
        cycles: of an operation in single and in double precision.
        has_double: whether its C computes in double at all.
        compiler: command of its compiler, with the options of the processor.
    """

    name: str
    flash: int
    ram: int
    clock: float
    code: float
    cycles: tuple[float, float]
    has_double: bool = True
    compiler: str = "unknown"


_TABLES: Final = read_table(__file__)
BOARDS: Final = [Board(**entry) for entry in _TABLES["boards"]]


class BoardFit(NamedTuple):
    """Cost of an export on a board.

    Attributes:
        board: its name.
        flash, ram: needs of the export [bytes], memory with stack.
        measured: whether flash is the compiled object's. It is estimated else.
        time: of a step [s].
        fits: whether flash and memory leave room, and a step half of the sample time.
        why: reasons why it does not fit (empty if it fits).
    """

    board: str
    flash: int
    measured: bool
    ram: int
    time: float
    fits: bool
    why: str


def fit_boards(report: Mapping[str, Any], files: tuple[tuple[str, str], ...]) -> list[BoardFit]:
    """Return the cost of an export on usual boards.

    Args:
        report: of the export: sizes, operations, code_operations, precision, step.
        files: name and text of each file of its C.
    """
    return [_fit_board(board, report, files) for board in BOARDS]


def _fit_board(
    board: Board, report: Mapping[str, Any], files: tuple[tuple[str, str], ...]
) -> BoardFit:
    """Return the cost of an export on one board."""
    is_double = report["precision"] == "double"
    wider = WIDER if is_double and board.has_double else 1.0
    count = sum(report["operations"].values())
    code = report["code_operations"]
    estimate = round(wider * board.code * code)
    is_near = estimate < HOPELESS * board.flash
    measured = object_bytes(board.compiler, files) if is_near else None
    flash = measured or estimate
    ram = round(sum(report["sizes"].values()) + wider * STACK * code)
    time = count * board.cycles[is_double] / board.clock
    faults = {
        "its double is single": is_double and not board.has_double,
        "flash": flash + LIBRARY > SPARED * board.flash,
        "memory": ram > SPARED * board.ram,
        "time": time > report["step"] / 2,
    }
    why = [name for name, is_found in faults.items() if is_found]
    return BoardFit(board.name, flash, measured is not None, ram, time, not why, ", ".join(why))


def board_table(found: list[BoardFit]) -> list[tuple[str, ...]]:
    """Return the boards as rows of text."""
    rows: list[tuple[str, ...]] = [
        ("board", "flash", "memory, estimated", "step, estimated", "fits")
    ]
    for fit in found:
        flash = f"{fit.flash / 1e3:.3g} kB" + ", estimated" * (not fit.measured)
        costs = (flash, f"{fit.ram / 1e3:.2g} kB", _time_text(fit.time))
        rows.append((fit.board, *costs, "yes" if fit.fits else f"NO: {fit.why}"))
    return rows


def _time_text(seconds: float) -> str:
    """Return a time as text in ms or microseconds."""
    return f"{1e3 * seconds:.3g} ms" if seconds >= 1e-3 else f"{1e6 * seconds:.3g} us"
