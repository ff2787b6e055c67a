"""CPU time of `undeadzone identify` with its page, by the length of the log."""

from __future__ import annotations

import contextlib
import os
import tempfile
import time
from pathlib import Path

import undeadzone as uz
from benchmarks.identify.logs.random_plants import Log, make
from benchmarks.markdown import head, row
from undeadzone.errors import InputError
from undeadzone_identify.page import write_identified

SIZES = (2_000, 10_000, 30_000, 100_000)
FAMILY, SEED = "coloured", 3


def seconds(log: Log, folder: Path) -> tuple[float, float, uz.Identified]:
    """CPU time [s] of the answer, and of figures, page and scenario; the answer."""
    began = time.process_time()
    answer = uz.identify(t=log.step, u=log.u, y=log.y)
    assert isinstance(answer, uz.Identified)
    found = time.process_time()
    write_identified(answer, folder, "log.csv")
    with contextlib.suppress(InputError):  # of a plant whose input acts late
        answer.scenario()
    return found - began, time.process_time() - found, answer


def table() -> str:
    """The section of RESULTS.md. IDENTIFY_LONGEST: the longest log (100 000)."""
    longest = int(os.environ.get("IDENTIFY_LONGEST", SIZES[-1]))
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        seconds(make(SEED, FAMILY, 500), Path(folder))  # compiles and imports
        for size in [size for size in SIZES if size <= longest]:
            log = make(SEED, FAMILY, size)
            found, with_plots, answer = seconds(log, Path(folder))
            assert answer.right is not None
            half = f"{answer.right.half_width:.4f}"
            off = f"{answer.right.value - log.right:+.4f}"
            rows.append(row(str(size), f"{found:.1f}", f"{with_plots:.1f}", half, off))
    lines = [
        "## Time of an identification",
        "",
        f"Logs of the family `{FAMILY}`, orders 1 to 4, all rivals; CPU seconds of one thread.",
        "",
        *head("samples", "answer [s]", "page and scenario [s]", "half interval of d_r", "error"),
        *rows,
        "",
    ]
    return "\n".join(lines)
