"""Why a control loop swings, by `uz.identify` of OP, PV and SP of loops of known cause.

Every answer is kept in build/valves.jsonl with the commit of the code that gave it. VALVES_LOOPS:
how many loops (100); VALVES_FIRST: seed of the first (0). VALVES_RECORDS: a folder of records in
place of these, whose names begin with S_ where the valve sticks and with N_ where it does not, or
hold _S_ or _N_; their columns are OP, PV and perhaps SP.
"""

from __future__ import annotations

import functools
import os
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np

import undeadzone as uz
from benchmarks.identify.answers import Outcome, complete
from benchmarks.identify.logs.valves import CAUSES, ValveLoop, make
from benchmarks.markdown import head, row
from benchmarks.results import commit
from undeadzone_studies.statistics.intervals import proportion

STORED = Path("build/valves.jsonl")
VALVE = ("stiction", "input_play")
WORDS = {
    "none": ("none", "operating_point"),
    "stiction": VALVE,
    "dead band": VALVE,
    "tight tuning": ("tight_tuning",),
    "external": ("external",),
}


def outcome_of(log: Path) -> Outcome:
    """What `identify` says of a log without any option."""
    try:
        numbers = uz.identify(log).numbers()
    except uz.InputError as error:
        return {"verdict": "refused", "why": str(error), "valve": 0.0, "width": None, "shape": 0.0}
    odds, loop = numbers["odds"], numbers["loop"]
    return {
        "verdict": numbers["verdict"],
        "why": numbers["reasons"],
        "valve": sum(odds.get(word, 0.0) for word in VALVE),
        "width": numbers["width"] if numbers["verdict"] in VALVE else None,
        "jump": loop["J"] if numbers["verdict"] == "stiction" else None,
        "shape": loop["shape"] if loop else 0.0,
    }


def outcome_of_seed(seed: int, folder: Path) -> Outcome:
    """The same of a loop by its seed, beside its truth."""
    loop: ValveLoop = make(seed)
    columns = [np.arange(loop.op.size), loop.op, loop.pv, loop.sp]
    path = folder / "loop.csv"
    np.savetxt(path, np.column_stack(columns), delimiter=",", header="t,OP,PV,SP", comments="")
    truth = {"cause": loop.cause, "account": loop.account, "S": loop.stick, "J": loop.jump}
    return truth | outcome_of(path)


def outcomes(of: str) -> list[Outcome]:
    """Every answer of a commit, after those that are asked for."""
    first, count = int(os.environ.get("VALVES_FIRST", 0)), int(os.environ.get("VALVES_LOOPS", 100))
    seeds = range(first, first + count)
    with tempfile.TemporaryDirectory() as folder:
        ask = functools.partial(outcome_of_seed, folder=Path(folder))
        every = complete(STORED, of, ["seed"], [(seed,) for seed in seeds], ask)
    return [one for one in every if one["seed"] in seeds]


def area_under_curve(score: list[float], is_so: list[bool]) -> float:
    """Share of pairs of a loop that is so and one that is not which a score puts in order."""
    so, value = np.array(is_so), np.array(score)
    above, below = value[so][:, None], value[~so]
    return float(np.mean((above > below) + 0.5 * (above == below)))


def records_table(folder: Path) -> str:
    """What is said of each record of a folder."""
    lines = head("record", "sticks", "verdict", "odds of the valve", "ellipse")
    scores: dict[str, list[float]] = {"valve": [], "shape": []}
    labels = []
    for path in sorted(folder.glob("*.csv")):
        one = outcome_of(path)
        labels.append("S_" in path.name)
        for name, of in scores.items():
            of.append(one[name])
        cells = f"{one['valve']:.2f}", f"{one['shape']:.2f}"
        lines.append(row(path.stem, "yes" if labels[-1] else "no", one["verdict"], *cells))
    areas = {name: area_under_curve(of, labels) for name, of in scores.items()}
    lines += ["", f"Area under the curve: odds {areas['valve']:.3f}, ellipse {areas['shape']:.3f}."]
    return "\n".join(["## Valves of records", "", *lines, ""])


def table() -> str:
    """The section of RESULTS.md."""
    if "VALVES_RECORDS" in os.environ:
        return records_table(Path(os.environ["VALVES_RECORDS"]))
    of = commit()
    every = outcomes(of)
    lines = head("cause", "loops", "named right", "undecided", "a valve, wrongly", "other names")
    for cause in CAUSES:
        rows = [one for one in every if one["cause"] == cause]
        words = Counter(one["verdict"] for one in rows)
        right = sum(words.pop(word, 0) for word in WORDS[cause])
        unsure = sum(words.pop(word, 0) for word in ("undecided", "unclear"))
        wrong = 0 if WORDS[cause] == VALVE else sum(words.pop(word, 0) for word in VALVE)
        others = ", ".join(f"{word} {count}" for word, count in words.items())
        lines.append(row(cause, str(len(rows)), str(right), str(unsure), str(wrong), others))
    sticks = [one["S"] > 0 for one in every]
    named = [one for one in every if one["S"] > 0 and one["width"]]
    covered = sum(one["width"][1] <= one["S"] <= one["width"][2] for one in named)
    value, low, high = proportion(covered, len(named))
    errors = [abs(one["width"][0] / one["S"] - 1) for one in named]
    halves = [(one["width"][2] - one["width"][1]) / 2 / one["S"] for one in named]
    lines += [
        "",
        f"Area under the curve of the odds of a valve: "
        f"{area_under_curve([one['valve'] for one in every], sticks):.3f}; of the ellipse alone "
        f"{area_under_curve([one['shape'] for one in every], sticks):.3f}. S lies in its interval "
        f"in {covered} of {len(named)}, {value:.3f} [{low:.3f}, {high:.3f}]; its error is "
        f"{np.median(errors):.3f} of S in the median, half the interval {np.median(halves):.2f}.",
    ]
    about = (
        f"{len(every)} loops at commit {of}: 500 to 4000 samples, one lag or two or an integrator,"
        " delays of 1 to 11 samples, PI or PID, a third of them sluggish; valves by three accounts"
        " (Choudhury, Kano, He), S of 1 to 8 % of OP; noise and drift of 0.2 to 3 % of the range."
    )
    return "\n".join(["## Valves", "", about, "", *lines, ""])
