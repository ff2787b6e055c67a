"""The right name of a log, and how sure it is: ten truths, in open and in closed loop.

Every answer is kept in build/names.jsonl as soon as there is one, with the commit of the code that
gave it, and not computed again at that commit: a study of hours can be done in parts, and by
several processes at once, each with a NAMES_FIRST of its own. NAMES_LOGS: logs of each truth (40),
NAMES_FIRST: the first of them (1000). NAMES_MINUTES: stop after so many and print what there is.
NAMES_COMMIT: print what that commit gave, and compute nothing.
"""

from __future__ import annotations

import itertools
import os
import time
from pathlib import Path

import numpy as np

import undeadzone as uz
from benchmarks.identify.answers import Outcome, complete
from benchmarks.identify.logs.names import TRUTHS, NamedLog, make
from benchmarks.markdown import head, row
from benchmarks.results import commit, share
from undeadzone_identify.selection.decision import FEW
from undeadzone_studies.statistics.intervals import proportion

STORED = Path("build/names.jsonl")
FIGURE = Path(__file__).parents[1] / "names.svg"
NO_NAME = ("undecided", "unclear", "unreached", "refused")  # answers that name nothing
BINS = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0)  # of odds
SURE = 0.9  # odds above which no name may be wrong
MEASURED = {  # numbers of a truth whose intervals are counted
    "sensor": ("right", "left"),
    "input": ("right", "left"),
    "friction": ("right", "left"),
    "play": ("width",),
}


# --- Answers


def outcomes(of: str) -> list[Outcome]:
    """Every answer of a commit, after as many new ones as the time allows."""
    first, count = int(os.environ.get("NAMES_FIRST", "1000")), int(os.environ.get("NAMES_LOGS", 40))
    seeds = [] if "NAMES_COMMIT" in os.environ else range(first, first + count)
    return complete(
        STORED,
        of,
        ["seed", "truth"],
        list(itertools.product(seeds, TRUTHS)),
        lambda seed, truth: outcome_of(make(seed, truth)),
        os.environ.get("NAMES_MINUTES", "inf"),
    )


def outcome_of(log: NamedLog) -> Outcome:
    """What `identify` makes of a log, beside its truth."""
    began = time.process_time()
    known = {"truth": log.truth, "size": log.y.size, "closed": log.closed, "encoder": log.encoder}
    known["across"] = float(min(np.mean(log.y > 0), np.mean(log.y < 0)))
    try:
        found = uz.identify(t=log.step, u=log.u, y=log.y)
    except uz.InputError as error:
        return known | {"verdict": "refused", "why": str(error), "odds": {}, "widths": []}
    numbers = found.numbers()
    truth = {"right": log.widths[0], "left": log.widths[1], "width": sum(log.widths)}
    widths = [
        [numbers[name], truth[name]] for name in MEASURED.get(log.truth, ()) if numbers.get(name)
    ]
    spent = time.process_time() - began
    selected = {key: numbers.get(key, {}) for key in ("verdict", "odds", "reasons", "remarks")}
    return known | selected | {"widths": widths, "seconds": round(spent, 2)}


def right_word(one: Outcome) -> str:
    """The truth's word; there is none to find where a level is passed through 0 after all."""
    word = TRUTHS[one["truth"]]
    return "none" if word == "operating_point" and one["across"] > FEW else word


def is_right(one: Outcome) -> bool:
    """Whether the verdict is the truth's word."""
    return bool(one["verdict"] == right_word(one))


def is_wrong(one: Outcome) -> bool:
    """Whether another name is given."""
    return not is_right(one) and one["verdict"] not in NO_NAME


# --- Tables


def confusion(every: list[Outcome]) -> list[str]:
    """Verdicts by truth."""
    columns = [*TRUTHS.values(), *NO_NAME]
    words = [word for word in columns if any(one["verdict"] == word for one in every)]
    words += sorted({one["verdict"] for one in every} - set(words))
    lines = head("truth", *(word.replace("_", " ") for word in words), "named rightly")
    for truth in TRUTHS:
        rows = [one for one in every if one["truth"] == truth]
        counts = [sum(one["verdict"] == word for one in rows) for word in words]
        lines.append(
            row(truth, *(str(count or "") for count in counts), share(map(is_right, rows)))
        )
    return lines


def summary(every: list[Outcome]) -> list[str]:
    """What is promised of all logs, and of some."""
    parts = {
        "all": every,
        "open loop": [one for one in every if not one["closed"]],
        "closed loop": [one for one in every if one["closed"]],
        "noise": [one for one in every if not one["encoder"]],
        "encoder": [one for one in every if one["encoder"]],
        "up to 1000 samples": [one for one in every if one["size"] <= 1000],
        "more": [one for one in every if one["size"] > 1000],
    }
    lines = head(
        "logs", "named rightly", "named wrongly", "wrongly with odds above 0.9", "widths held"
    )
    for name, rows in parts.items():
        sure = [is_wrong(one) and first_odds(one) > SURE for one in rows]
        cells = [share(map(is_right, rows)), share(map(is_wrong, rows)), share(sure)]
        lines.append(row(name, *cells, share(covers(rows))))
    return lines


def covers(rows: list[Outcome]) -> list[bool]:
    """Whether intervals under the right name hold the truth."""
    widths = [width for one in rows if is_right(one) for width in one["widths"]]
    return [low <= truth <= high for (_, low, high), truth in widths]


def first_odds(one: Outcome) -> float:
    """The odds of the verdict's own word; an operating point is one without a zone."""
    words = {"operating_point": "none"}
    return float(one["odds"].get(words.get(one["verdict"], one["verdict"]), 0.0))


def calibration(every: list[Outcome]) -> list[tuple[float, int, int]]:
    """(mean odds, how often right, of how many) of every word of every log, by odds."""
    pairs = []
    for one in every:
        truth = {"operating_point": "none"}.get(right_word(one), right_word(one))
        pairs += [(odds, word == truth) for word, odds in one["odds"].items()]
    odds, right = np.array([pair[0] for pair in pairs]), np.array([pair[1] for pair in pairs])
    rows = []
    for low, high in itertools.pairwise(BINS):
        inside = (odds >= low) & (odds < high if high < 1 else odds <= high)
        if inside.any():
            rows.append((float(odds[inside].mean()), int(right[inside].sum()), int(inside.sum())))
    return rows


def draw(rows: list[tuple[float, int, int]]) -> None:
    """How often words of some odds are right."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.5, 4))
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color="0.7", lw=1)
    for odds, right, count in rows:
        value, low, high = proportion(right, count)
        axes.plot([odds, odds], [low, high], color="C0", lw=1)
        axes.plot(odds, value, "o", color="C0", ms=4)
    axes.set(xlabel="odds that are printed", ylabel="how often the word is the truth")
    figure.savefig(FIGURE, bbox_inches="tight")


def table() -> str:
    """The section of RESULTS.md."""
    of = os.environ.get("NAMES_COMMIT") or commit()
    every = outcomes(of)
    rows = calibration(every)
    draw(rows)
    seconds = [one["seconds"] for one in every if "seconds" in one]
    lines = [
        "## Names",
        "",
        f"{len(every)} logs at commit {of}: random plants of order 1 to 3 (for friction a mass),"
        " with 200 to 20,000 samples. Half of them are in a closed loop with PI control. The"
        " measurement noise has an rms of 0.01 to 0.06 of the reference's, ahead of a sensor's"
        " zone or behind it, or the sensor is an encoder with a quantum of 0.03 of it. Half of the"
        " inputs are disturbed. `identify` has no option. If an operating point is passed through"
        f" 0 in {100 * FEW:g} % of the readings, `none` is right."
        f" CPU: {np.median(seconds):.1f} s (median), {np.mean(seconds):.1f} s (mean) a log.",
        "",
        *confusion(every),
        "",
        *summary(every),
        "",
        "Odds of words (`names.svg`), and how often these are the truth:",
        "",
        *head("odds", "right"),
        *[row(f"{odds:.3f}", share([True] * n + [False] * (m - n))) for odds, n, m in rows],
        "",
    ]
    return "\n".join(lines)
