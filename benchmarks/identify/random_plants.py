"""Coverage and errors of `uz.identify` over random plants, and its verdicts on other maps.

Every answer is kept in build/identify.jsonl as soon as there is one, and not computed again: a
study of hours can be done in parts, and by several processes at once, each with an IDENTIFY_FIRST
of its own. IDENTIFY_SEEDS: logs a family (10), IDENTIFY_FIRST: the first of them (100).
IDENTIFY_MINUTES: stop after so many and print what there is. IDENTIFY_ONLY: families, with commas
between. Remove the file to begin anew, as after a change of the estimator.
"""

from __future__ import annotations

import math
import os
import random
import time
from pathlib import Path

import numpy as np

import undeadzone as uz
from benchmarks.identify.answers import Outcome, complete
from benchmarks.identify.logs.random_plants import (
    FAMILIES,
    MAPS,
    OPTIONS,
    SAMPLES,
    Log,
    make,
    mapped,
)
from undeadzone_identify.models.estimates import Interval, maximise_likelihood
from undeadzone_identify.models.zone import ZoneObjective
from undeadzone_identify.models.zone_fit import ZoneFit
from undeadzone_studies.statistics.intervals import proportion

STORED = Path("build/identify.jsonl")


def families() -> list[str]:
    """The families that are asked for."""
    only = os.environ.get("IDENTIFY_ONLY")
    return only.split(",") if only else [*FAMILIES, *MAPS]


def outcomes() -> list[Outcome]:
    """Every answer that there is, after as many new ones as the time allows."""
    first = int(os.environ.get("IDENTIFY_FIRST", "100"))
    pending = []
    for seed in range(first, first + int(os.environ.get("IDENTIFY_SEEDS", "10"))):
        shuffled = random.sample(families(), len(families()))  # two processes seldom take the same
        pending += [(family, seed) for family in shuffled]
    minutes = os.environ.get("IDENTIFY_MINUTES", "inf")
    return complete(STORED, None, ["family", "seed"], pending, outcome_of, minutes)


def outcome_of(family: str, seed: int) -> Outcome:
    """What `identify` makes of a log, beside its truth."""
    log = mapped(seed, family) if family in MAPS else make(seed, family)
    began = time.process_time()
    answer = uz.identify(t=log.step, u=log.u, y=log.y, **OPTIONS.get(family, {}))
    assert isinstance(answer, uz.Identified)
    spent = time.process_time() - began
    whole = answer.answer
    return {
        "family": family,
        "seed": seed,
        "seconds": round(spent, 2),
        "verdict": answer.verdict,
        "true_order": log.n,
        "order": answer.order,
        "true": [log.right, log.left],
        "delay": whole.found.delay,
        "right": None if family == "motor" else triple(answer.right),
        "left": None if family == "motor" else triple(answer.left),
        "width": triple(answer.width),
        "least_squares": least_squares(answer, log) if answer.zone else None,
        "remarks": whole.remarks,
    }


def triple(interval: Interval | None) -> list[float] | None:
    """Value and ends of an interval; none where there is none, or one without an end."""
    if interval is None or not math.isfinite(interval.high):
        return None
    return [interval.value, interval.low, interval.high]


def least_squares(answer: uz.Identified, log: Log) -> list[float]:
    """The edges by least squares through the zone, from where the likelihood ended."""
    old = answer.answer.fit
    objective = ZoneObjective(old.objective.simulator, "behind", old.objective.limits)
    fit = ZoneFit(objective, *maximise_likelihood(objective, old.theta, 60))
    scale = answer.answer.scale
    return [fit.right * scale, fit.left * scale]


def edges(rows: list[Outcome]) -> list[tuple[list[float], float, float | None]]:
    """(interval, truth, least squares) of every edge that was found."""
    every = []
    for one in rows:
        for k, name in enumerate(("right", "left")):
            if one[name] is not None:
                squares = one["least_squares"]
                every.append((one[name], one["true"][k], squares and squares[k]))
    return every


def covered(inside: list[bool]) -> str:
    """A share with its 95 % interval."""
    if not inside:
        return "-"
    _, low, high = proportion(sum(inside), len(inside))
    return f"{np.mean(inside):.3f} [{low:.2f}, {high:.2f}]"


def middle(values: list[float]) -> str:
    """Median and 90 % quantile."""
    if not values:
        return "-"
    return f"{np.median(values):.4f} / {np.quantile(values, 0.9):.4f}"


def family_row(family: str, rows: list[Outcome]) -> str:
    """One line of the table of coverage."""
    zones = [one for one in rows if one["width"] or one["right"] or one["left"]]
    every = edges(zones)
    errors = [abs(interval[0] - truth) for interval, truth, _ in every]
    if family == "motor":  # whose edges are not known, only the width
        errors = [abs(one["width"][0] - sum(one["true"])) for one in zones]
    squares = [abs(ls - truth) for _, truth, ls in every if ls is not None]
    covers = [interval[1] <= truth <= interval[2] for interval, truth, _ in every]
    widths = [
        one["width"][1] <= sum(one["true"]) <= one["width"][2] for one in zones if one["width"]
    ]
    halves = [0.5 * (interval[2] - interval[1]) for interval, _, _ in every]
    right_order = sum(one["order"] == one["true_order"] for one in zones)
    seconds = float(np.median([one["seconds"] for one in rows]))
    half = f"{np.median(halves):.4f}" if halves else "-"
    return (
        f"| {family} | {len(zones)} of {len(rows)} | {middle(errors)} | {middle(squares)}"
        f" | {covered(covers)} | {covered(widths)} | {half} | {right_order} | {seconds:.1f} |"
    )


def verdict_row(family: str, rows: list[Outcome]) -> str:
    """One line of the table of verdicts."""
    words: dict[str, int] = {}
    for one in rows:
        words[one["verdict"]] = words.get(one["verdict"], 0) + 1
    counts = ", ".join(f"{word} {count}" for word, count in sorted(words.items()))
    return f"| {family} | {counts} |"


def table() -> str:
    """The section of RESULTS.md."""
    every = outcomes()
    rows = {name: [one for one in every if one["family"] == name] for name in families()}
    present = {name: some for name, some in rows.items() if some}
    zones = {name: some for name, some in present.items() if name not in (*MAPS, "none")}
    together = [one for some in zones.values() for one in some]
    lines = [
        "## Identification from logs",
        "",
        f"Random plants of order 1 to 3, {SAMPLES} samples, order chosen by the tool; widths in rms"
        " of z, shares with 95 % intervals. Errors: median / 90 %, beside those of least squares"
        " through the zone. IDENTIFY_SEEDS sets the number of logs; the study is done in parts.",
        "",
        "| family | zone found | error of an edge | by least squares | edges held | widths held"
        " | half-width | order right | CPU [s] |",
        "|---|---|---|---|---|---|---|---|---|",
        *[family_row(name, some) for name, some in zones.items()],
        *([family_row("all", together)] if together else []),
        "",
        "| truth | verdicts |",
        "|---|---|",
        *[verdict_row(name, some) for name, some in present.items()],
        "",
    ]
    return "\n".join(lines)
