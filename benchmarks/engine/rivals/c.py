"""C by hand (loop.c), compiled for this CPU when first asked for."""

from __future__ import annotations

import ctypes
import functools
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.engine.work.paper_loop import Result, Work

SOURCE = Path(__file__).with_name("loop.c")
FLAGS = ("-O3", "-march=native", "-fopenmp", "-shared", "-fPIC", "-Wno-psabi")
# so that a product with a known 0 is left out
FOLDING = ("-ffinite-math-only", "-fno-signed-zeros")


@functools.cache
def compiled(n: int, step: str, width: int, known: str = "") -> ctypes.CDLL:
    """The library for n states. Raises ImportError where gcc is missing or cannot compile it."""
    flags = [*FLAGS, f"-DN={n}", f"-DSTEP={step}", f"-DW={width}"]
    if known:
        flags += [*FOLDING, f"-DKNOWN={known}"]
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder, "loop.so")
        try:
            subprocess.run(["gcc", *flags, str(SOURCE), "-o", str(library)], check=True)
        except (OSError, subprocess.CalledProcessError) as failed:
            raise ImportError("gcc") from failed
        return ctypes.CDLL(str(library))


def prepare(
    work: Work,
    *,
    step: str = "located",
    width: int = 64,
    known: bool = False,
    threads: int = 1,
) -> Callable[[], Result]:
    """The work made ready.

    Args:
        work: what is done
        step: plain, located or sampled
        width: lanes of a block, 1 for one trajectory at a time
        known: all numbers are known when compiled
        threads: on which it runs
    """
    runs, steps = len(work.states), len(work.targets)
    plant = (work.A.ravel(), work.B, work.C)
    # of the plant, of the observer's model, of the observer, of the controller
    observer = (work.L, [work.gamma, work.limit])
    numbers = np.concatenate([*plant, *plant, *observer, work.K, [work.step]])
    written = ",".join(map(repr, numbers.tolist())) if known else ""
    library = compiled(len(work.B), step, width, written)

    def run() -> Result:
        states, sums = work.states.copy(), np.empty(runs)
        arrays = (numbers, work.targets, states, work.widths, sums)
        loop, targets, *others = (ctypes.c_void_p(array.ctypes.data) for array in arrays)
        library.run(
            loop,
            ctypes.c_long(steps),
            ctypes.c_long(steps - work.tail),
            targets,
            ctypes.c_long(runs),
            *others,
            ctypes.c_int(threads),
        )
        return Result(states, np.sqrt(sums / work.tail))

    return run
