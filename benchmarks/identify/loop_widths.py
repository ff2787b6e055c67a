"""Widths of an actuator's zone, of both ends and of plays by `uz.identify`, in and out of a loop.

Every answer is kept in build/loops.jsonl with the commit of the code that gave it. LOOPS_LOGS: logs
of each kind, disturbance, in a loop or not (7); LOOPS_FIRST: seed of the first (0); LOOPS_MINUTES:
stop after so many and print what there is. LOOPS_COMMIT: print what that commit gave.
"""

from __future__ import annotations

import itertools
import os
from pathlib import Path

import numpy as np

import undeadzone as uz
from benchmarks.identify.answers import Outcome, complete
from benchmarks.identify.logs.loops import DISTURBANCES, KINDS, LoopLog, make
from benchmarks.markdown import head, row
from benchmarks.results import commit
from undeadzone_studies.statistics.intervals import proportion

STORED = Path("build/loops.jsonl")
WORDS = {"input zone": "input_zone", "play": "play", "both ends": "two_zones"}


def outcomes(of: str) -> list[Outcome]:
    """Every answer of a commit, after as many new ones as the time allows."""
    first, count = int(os.environ.get("LOOPS_FIRST", 0)), int(os.environ.get("LOOPS_LOGS", 7))
    seeds = [] if "LOOPS_COMMIT" in os.environ else range(first, first + count)
    return complete(
        STORED,
        of,
        ["seed", "kind", "disturbance", "closed"],
        list(itertools.product(seeds, KINDS, DISTURBANCES, (True, False))),
        lambda *key: outcome_of(make(*key), key[1]),
        os.environ.get("LOOPS_MINUTES", "inf"),
    )


def outcome_of(log: LoopLog, kind: str) -> Outcome:
    """What `identify` makes of a log, told its reference, beside its truth."""
    try:
        found = uz.identify(t=log.step, u=log.u, y=log.y, r=log.r)
    except uz.InputError as error:
        return {"verdict": "refused", "why": str(error), "widths": {}, "loop": 1, "answered": None}
    numbers, widths = found.numbers(), {}
    if numbers["verdict"] == WORDS[kind]:
        sides = {"right": 0, "left": 1}
        if kind == "play":
            widths["gap"] = [numbers["width"], float(log.gaps.sum())]
        for side, k in sides.items():
            if kind == "input zone":
                widths[f"input {side}"] = [numbers[side], float(log.input[k])]
            if kind == "both ends":
                at_input = numbers["input_widths"] or {}
                widths[f"input {side}"] = [at_input.get(side), float(log.input[k])]
                widths[f"sensor {side}"] = [numbers[side], float(log.sensor[k])]
    given = {name: pair for name, pair in widths.items() if pair[0] is not None}
    loop_numbers = {"loop": numbers["closed_loop"], "answered": numbers["answered"]}
    return {
        "verdict": numbers["verdict"],
        "widths": given,
        "order": numbers["order"],
        **loop_numbers,
    }


def cells(rows: list[Outcome], part: str) -> list[str]:
    """How many widths were given, how far they are off, how often and how narrowly they hold."""
    pairs = [
        pair
        for one in rows
        for pair in (one["widths"][name] for name in one["widths"] if name.startswith(part))
    ]
    if not pairs:
        return ["0", "-", "-", "-", "-"]
    errors = np.array([abs(interval[0] - truth) / truth for interval, truth in pairs])
    halves = np.array([(interval[2] - interval[1]) / 2 / truth for interval, truth in pairs])
    hits = sum(low <= truth <= high for (_, low, high), truth in pairs)
    value, low, high = proportion(hits, len(pairs))
    spread = f"{np.median(errors):.3f}", f"{np.quantile(errors, 0.9):.3f}"
    share_text = f"{value:.3f} [{low:.3f}, {high:.3f}]"
    return [str(len(pairs)), *spread, f"{np.median(halves):.3f}", share_text]


def table() -> str:
    """The section of RESULTS.md."""
    of = os.environ.get("LOOPS_COMMIT") or commit()
    every = outcomes(of)
    lines = head("log", "disturbance", "named", "of", "widths", "error", "90 %", "half", "held")
    parts = {"input zone": ("input",), "play": ("gap",), "both ends": ("input", "sensor")}
    for kind, closed in itertools.product(KINDS, (True, False)):
        for disturbance in (*DISTURBANCES, None):
            rows = [one for one in every if one["kind"] == kind and one["closed"] == closed]
            if disturbance is not None:
                rows = [one for one in rows if one["disturbance"] == disturbance]
            named = sum(one["verdict"] == WORDS[kind] for one in rows)
            where = "closed" if closed else "open"
            size = "all" if disturbance is None else f"{disturbance:g}"
            for part in parts[kind]:
                name = f"{kind}, {where}: {part}"
                lines.append(row(name, size, str(named), str(len(rows)), *cells(rows, part)))
    shares = {True: [], False: []}
    for one in every:
        shares[one["closed"]].append((one["answered"], one["loop"]))
    detected = {
        closed: sum(1 for share, _ in pairs if share is not None and share > 0.5)
        for closed, pairs in shares.items()
    }
    guessed = {
        closed: sum(1 for _, loop in pairs if loop <= 1e-3) for closed, pairs in shares.items()
    }
    lines += [
        "",
        f"A loop is detected with its reference in {detected[True]} of {len(shares[True])} closed"
        f" and {detected[False]} of {len(shares[False])} open ones, without it in {guessed[True]}"
        f" and {guessed[False]}.",
    ]
    return "\n".join(
        [
            "## Closed loops",
            "",
            f"{len(every)} logs at commit {of}: random plants of order 1 to 3, 700 to 5000 samples,"
            " a loop on y with random proportional and integral part or none, noise of .01 to .05"
            " of the reference's rms, a first-order disturbance of the input; nothing is told but"
            " the reference. Errors and half intervals in shares of the true width.",
            "",
            *lines,
            "",
        ]
    )
