"""Dead zone, play, both or neither: named by `uz.identify`.

WHICH_LOGS: logs of each kind and family (3).
"""

from __future__ import annotations

import os

import numpy as np

import undeadzone as uz
from benchmarks.identify.logs.zone_or_play import FAMILIES, WHERE, open_log
from benchmarks.markdown import head, row
from undeadzone_studies.statistics.intervals import proportion

VERDICTS = {"neither": "none"}  # of `identify`, where its word is another one


def identified(kind: str, family: str, seed: int) -> tuple[bool, list[tuple[float, float]]]:
    """Whether `identify` names a log rightly; errors and half intervals of the widths it gives."""
    log = open_log(kind, family, seed)
    found = uz.identify(t=log.step, u=log.u, y=log.y)
    numbers = found.numbers()
    if found.verdict != VERDICTS.get(kind, kind):
        return False, []
    columns = {"play": (0, "width"), "both": (0, "width"), "dead_zone": (1, "width")}
    columns["input_zone"] = (1, "width")
    errors = []
    for place, name in [columns[kind]] if kind in columns else []:
        errors.append(_error(numbers[name], log.widths[place]))
    if kind == "both":
        errors.append(_error(numbers["zone_width"], log.widths[1]))
    return True, [error for error in errors if error is not None]


def _error(interval: list[float] | None, truth: float) -> tuple[float, float] | None:
    """|error| and half interval; None where no width is given."""
    if interval is None:
        return None
    value, low, high = interval
    return abs(value - truth), (high - low) / 2


def unknown_plant() -> list[str]:
    """The table of logs whose plant is identified."""
    count = int(os.environ.get("WHICH_LOGS", "3"))
    lines = head("readings", "what is there", "named rightly", "widths", "median error", "held")
    right, hits = 0, []
    for family in FAMILIES:
        for kind in WHERE:
            first = 1000 * (WHERE.index(kind) + len(WHERE) * list(FAMILIES).index(family))
            answers = [identified(kind, family, first + seed) for seed in range(count)]
            named = sum(is_right for is_right, _ in answers)
            errors = [error for _, several in answers for error in several]
            covers = [error < half for error, half in errors]
            right, hits = right + named, hits + covers
            cells = ["-", "-", "-"]
            if errors:
                middle = float(np.median([error for error, _ in errors]))
                cells = [str(len(errors)), f"{middle:.4f}", f"{np.mean(covers):.2f}"]
            words = kind.replace("_", " ")
            lines.append(row(family, words, f"{named} of {count}", *cells))
    total = count * len(WHERE) * len(FAMILIES)
    share, cover = proportion(right, total), proportion(sum(hits), len(hits))
    lines += [
        "",
        f"Named rightly: {right} of {total} [{share.low:.2f}, {share.high:.2f}]. 95 % intervals of"
        f" widths hold in {cover.value:.2f} [{cover.low:.2f}, {cover.high:.2f}] of {len(hits)}.",
    ]
    return lines


def table() -> str:
    """The section of RESULTS.md."""
    lines = [
        "## Which is it: dead zone, play, both or neither",
        "",
        "`uz.identify` on 1500 samples in open loop, nothing known: random plants of order 1 to 3,"
        " z of rms 1, gaps of 0.1 to 0.8, zones of 0.15 to 0.6 a side. Readings: with noise of 0.01"
        " to 0.06, the same with a disturbance of the input (rms 0.1 at z), or an encoder of 0.05"
        " with such a disturbance of 0.05. Widths: how many were given; both: gap and zone.",
        "",
        *unknown_plant(),
        "",
    ]
    return "\n".join(lines)
