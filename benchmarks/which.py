"""Dead zone, play, both or neither: named by one filter with four offsets, and by `uz.identify`.

WHICH_LOOPS: loops of each of the 8 kinds (50). WHICH_LOGS: logs of each kind and family whose plant
is identified too (3).
"""

from __future__ import annotations

import os

import numpy as np

from benchmarks.markdown import head, row
from benchmarks.which_logs import KINDS, NOISE, closed_loop
from undeadzone.identification.four_offsets import Offsets, four_offsets
from undeadzone.identification.motion import Sensing
from undeadzone.statistics.intervals import proportion

TWO_SIDED = 1.96
WINDOW = 20  # readings, a 25th of the reference's period


def offsets(kind: str, a0: float, seed: int) -> tuple[Offsets, np.ndarray]:
    """What the filter finds in a loop, and the true widths."""
    loop = closed_loop(kind, a0, seed)
    whole = np.ones(loop.y.size, bool)
    start = np.zeros(1, int)
    found = four_offsets(loop.plant, loop.u, loop.y, whole, start, Sensing(NOISE, 0.0, WINDOW))
    return found, np.append(loop.widths, 0.0)


def known_plant() -> list[str]:
    """The table of loops with a known plant."""
    count = int(os.environ.get("WHICH_LOOPS", "50"))
    lines = head(
        "A", "what is there", "named rightly", "error of play, dead zone, rest", "coverage of these"
    )
    right, hits = 0, np.zeros((0, 3))
    for a0, name in ((1.0, "nonsingular"), (0.0, "singular")):
        for kind in KINDS:
            first = 1000 * (KINDS.index(kind) + len(KINDS) * int(a0))  # every loop a fresh one
            answers = [offsets(kind, a0, first + seed) for seed in range(count)]
            errors = np.array([abs(found.widths - truth) for found, truth in answers])
            stds = np.array([found.std for found, _ in answers])
            named = sum(found.name == kind for found, _ in answers)
            held = errors < TWO_SIDED * stds
            right, hits = right + named, np.vstack([hits, held])
            middle = ", ".join(f"{error:.4f}" for error in np.median(errors, axis=0))
            covered = ", ".join(f"{share:.2f}" for share in held.mean(axis=0))
            words = kind.replace("_", " ")
            lines.append(row(name, words, f"{named} of {count}", middle, covered))
    low = proportion(right, 8 * count)
    lines += [
        "",
        f"Named rightly: {right} of {8 * count} [{low.low:.3f}, 1]."
        f" Coverage over all: {hits.mean():.3f} of {hits.size} intervals.",
    ]
    return lines


def table() -> str:
    """Both tables."""
    lines = [
        "## Which is it: dead zone, play, both or neither",
        "",
        "One Kalman filter with an offset for each (sign of y, direction of y), plant known: z'' ="
        " -a0 z - 2 z' + u on 5 sin 1.3 t, 100 Hz, 30 s, noise 0.01, white disturbance 0.5, gaps"
        " and zones of 0.2 to 1 a side. Errors are medians of |error|, widths c_r + c_l, d_r + d_l,"
        " and b1 - b2 - b3 + b4, which must be 0; 95 % intervals.",
        "",
        *known_plant(),
        "",
    ]
    return "\n".join(lines)
