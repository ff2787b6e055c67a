"""C by hand (loop.c), compiled for this CPU when first asked for."""

from __future__ import annotations

import ctypes
import functools
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.workload import Result, Work

SOURCE = Path(__file__).with_name("loop.c")
FLAGS = ("-O3", "-march=native", "-fopenmp", "-shared", "-fPIC", "-Wno-psabi")
FOLDING = (
    "-ffinite-math-only",
    "-fno-signed-zeros",
)  # so that a product with a known 0 is left out


@functools.cache
def compiled(n: int, step: str, width: int, known: str = "") -> ctypes.CDLL:
    """The library for n states. Raises ImportError where gcc is missing or cannot compile it."""
    more = (*FOLDING, f"-DKNOWN={known}") if known else ()
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder, "loop.so")
        try:
            subprocess.run(
                [
                    "gcc",
                    *FLAGS,
                    *more,
                    f"-DN={n}",
                    f"-DSTEP={step}",
                    f"-DW={width}",
                    str(SOURCE),
                    "-o",
                    str(library),
                ],
                check=True,
            )
        except (OSError, subprocess.CalledProcessError) as failed:
            raise ImportError("gcc") from failed
        return ctypes.CDLL(str(library))


def prepare(
    work: Work, *, step: str = "located", width: int = 64, known: bool = False, threads: int = 1
) -> Callable[[], Result]:
    """step: plain, located or sampled; width: lanes of a block, 1 for one trajectory at a time; known: all numbers when compiled."""
    runs, steps = len(work.states), len(work.targets)
    plant = (work.A.ravel(), work.B, work.C)
    numbers = np.concatenate(
        [*plant, *plant, work.L, [work.gamma, work.limit], work.K, [work.step]]
    )
    library = compiled(
        len(work.B), step, width, ",".join(map(repr, numbers.tolist())) if known else ""
    )

    def run() -> Result:
        states, sums = work.states.copy(), np.empty(runs)
        loop, targets, *arrays = (
            ctypes.c_void_p(array.ctypes.data)
            for array in (numbers, work.targets, states, work.widths, sums)
        )
        library.run(
            loop,
            ctypes.c_long(steps),
            ctypes.c_long(steps - work.tail),
            targets,
            ctypes.c_long(runs),
            *arrays,
            ctypes.c_int(threads),
        )
        return Result(states, np.sqrt(sums / work.tail))

    return run
