"""A small job for the tests of journal and cluster.

Run as a program it computes one: python -m tests.jobs PATH RUNS SECONDS.
"""

from __future__ import annotations

import functools
import logging
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from undeadzone.util.arrays import Floats
from undeadzone_studies.ensemble import run_blocks
from undeadzone_studies.ensemble.job import Layout


def stop_program(number: int, program: str, *arguments: object) -> tuple[int, str, str]:
    """Run a program of Python, stop its group by a signal once it prints a line.

    Args:
        number: of the signal.
        program: its text.
        arguments: its words.

    Returns:
        Its exit status, the rest of what it prints, what it prints on stderr.
    """
    with subprocess.Popen(
        [sys.executable, "-c", program, *map(str, arguments)],
        cwd=Path(__file__).parents[1],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as running:
        assert running.stdout is not None
        running.stdout.readline()
        os.killpg(running.pid, number)
        said, noise = running.communicate()
    return running.returncode, said, noise


class Sines(NamedTuple):
    """Rows of sines, and of what float64 has besides numbers.

    Attributes:
        layout: of the rows
        seconds: that each block takes [s]
        trace: a folder in which each block leaves a file
        deadly: the block that kills its process, once
        wrong: the block that raises
    """

    layout: Layout
    seconds: float = 0.0
    trace: Path | None = None
    deadly: int = -1
    wrong: int = -1

    def block(self, index: int, threads: int | None = None) -> Floats:
        if self.trace is not None:
            began = self.trace / str(index)
            if index == self.deadly and not began.exists():
                began.touch()
                os.kill(os.getpid(), signal.SIGKILL)
            began.touch()
        if index == self.wrong:
            raise ArithmeticError("a block that fails")
        time.sleep(self.seconds)
        runs = self.layout.runs_in_block(index)
        k = np.arange(runs.start, runs.stop)[:, None]
        rows = np.sin(k * (1.0 + np.arange(len(self.layout.columns))))
        rows[k[:, 0] % 7 == 3, 0] = np.nan
        rows[k[:, 0] % 7 == 4, 0] = -0.0
        return rows


def layout(runs: int, block: int = 10, columns: int = 3, **problem: str | int) -> Layout:
    names = tuple(f"column {i}" for i in range(columns))
    return Layout(runs, names, block, {"scenario": "a = 1\nb = 2\n", "seed": 0} | problem)


def sines(
    runs: int,
    seconds: float = 0.0,
    trace: Path | None = None,
    deadly: int = -1,
    wrong: int = -1,
    block: int = 10,
) -> Sines:
    return Sines(layout(runs, block), seconds, trace, deadly, wrong)


def local_cluster(workers: int) -> Any:
    """A cluster of Dask on this computer."""
    from distributed import LocalCluster

    return LocalCluster(
        n_workers=workers,
        threads_per_worker=2,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        silence_logs=logging.CRITICAL,
    )


def main(path: str, runs: str, seconds: str, block: str = "10") -> None:
    """Compute or continue a job.

    It prints the runs done at each block, and at the end the largest resident size [kB].
    """
    make = functools.partial(sines, int(runs), float(seconds), block=int(block))
    run_blocks.compute_job(make, Path(path), resume=True, progress=say).close()
    say(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)


def say(number: int) -> None:
    """A line on stdout, at once."""
    sys.stdout.write(f"{number}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main(*sys.argv[1:])
