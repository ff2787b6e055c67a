"""Why a control loop swings, by OP, PV and SP of generated loops of known cause.

Every answer is kept in build/valves.jsonl with the commit of the code that gave it. VALVES_LOOPS:
how many loops (60); VALVES_FIRST: seed of the first (900), below those of `loop_weights`;
VALVES_FOLDER: loops of a folder that `undeadzone loops` ranks, killed half way and resumed (0),
each of VALVES_SAMPLES (8640: a day at one in 10 s).
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.identify.answers import Outcome, complete
from benchmarks.identify.logs.valves import CAUSES, ValveLoop, make
from benchmarks.markdown import head, row
from benchmarks.results import commit
from undeadzone.util.installed import use_one_blas_thread
from undeadzone_identify.logs.log import Log, log_from_arrays
from undeadzone_identify.selection.loop import NAMED, find_loop_cause
from undeadzone_studies.statistics.intervals import proportion

STORED = Path("build/valves.jsonl")
VALVE = ("stiction", "input_play")
WORDS = {
    "none": ("none",),
    "stiction": VALVE,
    "dead band": VALVE,
    "tight tuning": ("tight_tuning",),
    "external": ("external",),
}
WITHHELD = ("undecided", "noise", "limits")


def log_of_loop(loop: ValveLoop) -> Log:
    """A generated loop as a log of one sample a second."""
    log = log_from_arrays(1.0, loop.op, loop.pv, loop.sp)
    return log._replace(inputs=("OP",), outputs=("PV",), r=loop.sp[:, None])


def outcome_of_seed(seed: int) -> Outcome:
    """What is said of a loop by its seed, beside its truth."""
    loop: ValveLoop = make(seed)
    begin = time.process_time()
    with use_one_blas_thread():
        found = find_loop_cause([log_of_loop(loop)])
    return {
        "seconds": time.process_time() - begin,
        "cause": loop.cause,
        "S": loop.stick,
        "J": loop.jump,
        "verdict": found.word,
        "valve": found.odds["sticks"],
        "stick": list(found.stick),
        "jump": list(found.jump),
        "shape": found.median("ellipse"),
    }


def rank_folder(count: int, first: int, size: int) -> str:
    """Return CPU time and time of `undeadzone loops` on a folder, killed half way and resumed."""
    with TemporaryDirectory() as room:
        plant, kept = Path(room, "plant"), Path(room, "o", "loops.json.partial")
        plant.mkdir()
        for seed in range(first, first + count):
            columns = np.column_stack(make(seed, size=size)[:3])
            path = plant / f"FIC{seed}_0612.csv"
            np.savetxt(path, columns, "%.4f", ",", header="OP,PV,SP", comments="")
        words = [sys.executable, "-m", "undeadzone", "loops", "plant", "--workers=2", "--out=o"]
        begin = time.monotonic()
        with subprocess.Popen(words, cwd=room) as process:
            while not kept.exists() or kept.read_bytes().count(b"\n") <= count // 2:
                time.sleep(0.1)
            process.kill()
        before = kept.read_bytes().count(b"\n") - 1
        subprocess.run([*words, "--resume"], cwd=room, check=True)
        rows = json.loads(Path(room, "o", "loops.json").read_bytes())["loops"]
    elapsed = time.monotonic() - begin
    seconds = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    return (
        f"A folder of {count} of these loops, of {size} samples, by `undeadzone loops`, killed"
        f" after {before} answers and resumed: {len(rows)} lines with a page each, {seconds:.0f}"
        f" CPU s in all, {elapsed:.0f} s by two workers."
    )


def area_under_curve(score: list[float], is_so: list[bool]) -> float:
    """Share of pairs of a loop that is so and one that is not which a score puts in order."""
    so, value = np.array(is_so), np.array(score)
    above, below = value[so][:, None], value[~so]
    return float(np.mean((above > below) + 0.5 * (above == below)))


def table() -> str:
    """The section of RESULTS.md."""
    of, first = commit(), int(os.environ.get("VALVES_FIRST", 900))
    seeds = range(first, first + int(os.environ.get("VALVES_LOOPS", 60)))
    asked = complete(STORED, of, ["seed"], [(seed,) for seed in seeds], outcome_of_seed)
    every = [one for one in asked if one["seed"] in seeds]
    lines = head("cause", "loops", "named right", "no name", "other names")
    for cause in CAUSES:
        rows = [one for one in every if one["cause"] == cause]
        words = Counter(one["verdict"] for one in rows)
        right = sum(words.pop(word, 0) for word in WORDS[cause])
        unsure = sum(words.pop(word, 0) for word in WITHHELD)
        others = ", ".join(f"{word} {count}" for word, count in words.items())
        lines.append(row(cause, str(len(rows)), str(right), str(unsure), others))
    sticks = [one["S"] > 0 for one in every]
    faulty = [one for one in every if one["S"] > 0]
    false = sum(one["valve"] > NAMED for one in every if not one["S"])
    named = sum(one["verdict"] in VALVE for one in faulty)
    held = {}
    for letter, key in (("S", "stick"), ("J", "jump")):
        count = sum(one[key][1] <= one[letter] <= one[key][2] for one in faulty)
        value, low, high = proportion(count, len(faulty))
        held[letter] = f"{count} of {len(faulty)}, {value:.3f} [{low:.3f}, {high:.3f}]"
    errors = [abs(one["stick"][0] / one["S"] - 1) for one in faulty]
    over = [one["stick"][2] / one["stick"][1] for one in faulty]
    areas = [area_under_curve([one[key] for one in every], sticks) for key in ("valve", "shape")]
    lines += [
        "",
        f"Area under the curve of the odds of a valve: {areas[0]:.3f}; of the ellipse alone"
        f" {areas[1]:.3f}. False names above {NAMED:g}: {false}. Of {len(faulty)} valves that"
        f" stick or play {named} are named. Whether named or not, S lies in its interval in"
        f" {held['S']}, J in {held['J']}; S is off by {np.median(errors):.3f} of S in the median,"
        f" the ends of its interval a factor {np.median(over):.1f} apart."
        f" CPU s a loop: {np.mean([one['seconds'] for one in every]):.2f}.",
    ]
    if count := int(os.environ.get("VALVES_FOLDER", 0)):
        lines += ["", rank_folder(count, first, int(os.environ.get("VALVES_SAMPLES", 8640)))]
    about = (
        f"{len(every)} loops at commit {of}: 500 to 4000 samples, one lag or two or an integrator,"
        " delays of 1 to 11 samples, PI or PID, a third of them sluggish; valves by three accounts"
        " (Choudhury, Kano, He), S of 1 to 8 % of OP; noise and drift of 0.2 to 3 % of the range."
    )
    return "\n".join(["## Valves", "", about, "", *lines, ""])
