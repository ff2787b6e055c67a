"""Linear motors from slow to fast rates of recording: is a gap named where there is none?

Only the time constant in samples and the length of the log in samples can matter, so these are
varied over two decades and one. The input is a sum of sines about the motor's own time, or steps
of a length that knows nothing of it. TIME_LOGS: of each (1); TIME_FIRST: the first seed (1).
"""

from __future__ import annotations

import itertools
import os
import time

import numpy as np

import undeadzone as uz
from benchmarks.identify.logs.strangers import STEP, driven_motor, sines, steps
from benchmarks.markdown import head, row

CONSTANTS = (5.0, 16.0, 50.0, 160.0, 500.0)  # samples
SIZES = (1000, 3000, 10_000)  # samples
NO_NAME = ("undecided", "unclear", "refused")
GAPS = ("play", "both", "input_play")


def identify_motor(
    samples: float, size: int, stepped: bool, seed: int
) -> tuple[str, float, float, float]:
    """Return the word of a motor's log, the odds of a gap, the time constant and CPU seconds."""
    rng, begun = np.random.default_rng(seed), time.process_time()
    u = steps(rng, size) if stepped else sines(rng, size, samples)
    y = driven_motor(u, samples)
    y += 0.003 * y.std() * rng.standard_normal(size)
    try:
        found = uz.identify(t=STEP, u=u, y=y, integrators=1)
    except uz.InputError:
        return "refused", 0.0, np.nan, time.process_time() - begun
    assert isinstance(found, uz.Identified)
    odds = found.numbers()["odds"]
    poles = [pole.real for pole in found.answer.poles if pole.real < 0]
    fitted = -1 / (max(poles) * STEP) if poles else np.nan
    gap = max((odds.get(word, 0.0) for word in GAPS), default=0.0)
    return found.verdict, gap, fitted, time.process_time() - begun


def table() -> str:
    """Return the section of RESULTS.md."""
    count, first = (int(os.environ.get(f"TIME_{k}", 1)) for k in ("LOGS", "FIRST"))
    names = ("time constant, samples", "samples of the log", "none", "withheld", "a gap")
    lines, gaps, total = head(*names, "its odds at most", "time constant off", "CPU s"), 0, 0
    for samples, size in itertools.product(CONSTANTS, SIZES):
        seeds = itertools.product((False, True), range(first, first + count))
        every = [identify_motor(samples, size, stepped, seed) for stepped, seed in seeds]
        words = [one[0] for one in every]
        none = sum(word in ("none", "operating_point") for word in words)
        gap, total = sum(word in GAPS for word in words), total + len(words)
        gaps += gap
        off = [abs(one[2] / samples - 1) for one in every if one[0] == "none"]
        numbers = (none, sum(word in NO_NAME for word in words), gap)
        errors = (f"{max(one[1] for one in every):.2f}", f"{np.median(off):.3f}" if off else "-")
        spent = f"{np.mean([one[3] for one in every]):.1f}"
        cells = (f"{samples:g}", str(size), *map(str, numbers), *errors, spent)
        lines.append(row(*cells))
    remark = f"A gap is named in {gaps} of {total} logs of linear motors, one integrator told."
    return "\n".join(["## Time constants", "", remark, "", *lines, ""])
