"""Cases of the gallery: from a log to a width with an interval, a bench measurement, and C.

Each log goes through the commands that docs/cases.md shows.
`python -m benchmarks.end_to_end.cases FOLDER` writes the logs. CASES: names, by commas (all).
CASES_DAISY: the file robot_arm.dat of the DaISy data base, which is not shipped; without it that
row is left out.
"""

from __future__ import annotations

import ctypes
import json
import os
import re
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.end_to_end.machines import (
    CASES,
    Bench,
    Case,
    Correct,
    Measured,
    approach_from_both_sides,
    rms,
)
from benchmarks.identify.logs.strangers import zone
from benchmarks.markdown import head, row

SEED = 57
IMPOSED = (0.5, 0.3)  # on the flexible arm, in standard deviations of its acceleration
ARMS = {
    "geared_arm": ("arm with gaps in its gears", "two_link_gears.toml", 1e-3),
    "ur5": ("UR5, dead zones", "ur5.toml", 0.0),
}
EXAMPLES = Path(__file__).parents[2] / "examples"
NORMAL = 1.96


class Outcome(NamedTuple):
    """Answer to a log, and its use.

    Attributes:
        verdict: class of the nonlinearity, with its probability.
        found: intervals (value, low, high) [unit of the case]; as the bench measures.
        bench: the same, measured at the bench.
        errors: rms error at work without and with the compensation.
    """

    verdict: str
    found: list[tuple[float, float, float]]
    bench: Measured
    errors: tuple[float, float]


def daisy_case(path: Path) -> Case:
    """Return the flexible arm of the DaISy data base (96-009) behind a zone that is imposed.

    Args:
        path: of robot_arm.dat: torque and acceleration, 1024 lines.
    """
    torque, acceleration = np.loadtxt(path).T
    torque, z = torque - torque.mean(), acceleration - acceleration.mean()
    right, left = (share * float(z.std()) for share in IMPOSED)
    y = zone(z, right, left)

    def use(_: np.random.Generator, correct: Correct) -> float:
        """Return the rms error of the corrected reading."""
        return rms([correct(float(one)) for one in y] - z)

    return Case(
        "flexible arm (DaISy), imposed zone",
        "t [samples],torque,acceleration",
        "",
        "",
        lambda _: np.column_stack([np.arange(z.size), torque, y]),
        lambda _: (Bench(right, 0.0), Bench(left, 0.0)),
        use,
        ("--columns", "u=torque,y=acceleration"),
    )


def all_cases() -> dict[str, Case]:
    """Return the cases that have a log, by name."""
    path = os.environ.get("CASES_DAISY")
    return CASES | ({} if path is None else {"daisy": daisy_case(Path(path))})


def write_log(name: str, case: Case, folder: Path) -> Path:
    """Write the log of a case to a folder and return its path."""
    path, rng = folder / f"{name}.csv", np.random.default_rng(SEED)
    np.savetxt(path, case.record(rng), delimiter=",", header=case.columns, comments="", fmt="%.7g")
    return path


def run_command(*words: str | Path) -> str:
    """Run a command of the package and return its output. Raise RuntimeError if it is refused."""
    line = [sys.executable, "-m", "undeadzone", *map(str, words)]
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    if done.returncode > 1:
        raise RuntimeError(f"{' '.join(map(str, words))}: {done.stderr or done.stdout}")
    return done.stdout


def load_snippet(folder: Path) -> Correct:
    """Compile the C of a snippet and return its function."""
    text = (folder / "snippet.h").read_text(encoding="utf-8")
    (name,) = re.findall(r"^static float (\w+)\(float", text, re.MULTILINE)
    source, library = folder / "snippet.c", folder / "snippet.so"
    source.write_text(f'#include "snippet.h"\nfloat step(float x) {{ return {name}(x); }}\n')
    subprocess.run(["gcc", "-O1", "-shared", "-fPIC", "-o", library, source], check=True)
    step = ctypes.CDLL(str(library)).step
    step.restype, step.argtypes = ctypes.c_float, [ctypes.c_float]
    return lambda x: float(step(x))


def run_case(name: str, case: Case, folder: Path) -> Outcome:
    """Run the commands of a case: log, identify, snippet, compiled and used.

    Args:
        name: of the case.
        case: the machine.
        folder: for its files.
    """
    log, out = write_log(name, case, folder), folder / name
    run_command("identify", log, "--out", out, "--no-figures", *case.options)
    run_command("export", out / "identify.json", "--to", "snippet", "--out", out / "few")
    answer = json.loads((out / "identify.json").read_text(encoding="utf-8"))
    sides = [answer["right"], answer["left"]]
    if "play" in answer["verdict"]:
        motion = answer.get("lost_motion")
        sides = [motion["gap"] if motion else answer["width"]]
    correct = load_snippet(out / "few")
    return Outcome(
        f"{answer['verdict']}, {100 * max(answer['odds'].values()):.3g} %",
        [(one[0], one[1], one[2]) for one in sides],
        case.measure(np.random.default_rng(SEED + 1)),
        (
            case.use(np.random.default_rng(SEED + 2), float),
            case.use(np.random.default_rng(SEED + 2), correct),
        ),
    )


def run_arm(example: str, noise: float) -> list[Outcome]:
    """Run an arm with and without the observer, and return the outcome of each joint.

    Args:
        example: name of its file.
        noise: of an encoder at the bench, with the link clamped; 0: widths as they were set.
    """
    found = json.loads(run_command("run", EXAMPLES / example, "--no-figures", "--json"))
    text = (EXAMPLES / example).read_text(encoding="utf-8")
    true = _read_true_widths(text)
    rng = np.random.default_rng(SEED + 1)
    errors = 1e3 * found["compare"]["rms_tip"], 1e3 * found["rms_tip"]
    outcomes = []
    for k, width in enumerate(true):
        value = found["d_right"][k] + found["d_left"][k]
        half = NORMAL * found["width_std"][k]
        bench = approach_from_both_sides(width, noise)(rng) if noise else (Bench(width, 0.0),)
        outcomes.append(Outcome("estimated", [(value, value - half, value + half)], bench, errors))
    return outcomes


def _read_true_widths(text: str) -> list[float]:
    """Return the width of each joint that an example sets."""
    given: dict[str, Any] = tomllib.loads(text)
    if gears := given["plant"]["arm"].get("gears"):
        return [2.0 * half for half in gears["half"]]
    both = zip(given["sensor"]["right"], given["sensor"]["left"], strict=True)
    return [right + left for right, left in both]


def _row_of(title: str, outcome: Outcome, unit: str, error_unit: str) -> str:
    """Return the row of an outcome."""
    intervals = [f"{value:.4g} [{low:.4g}, {high:.4g}]" for value, low, high in outcome.found]
    bench = " / ".join(
        f"{one.value:.4g}" + f" +- {one.error:.2g}" * bool(one.error) for one in outcome.bench
    )
    without, with_it = (f"{one:.3g}" for one in outcome.errors)
    return row(
        title,
        outcome.verdict,
        f"{' / '.join(intervals)} {unit}".strip(),
        f"{bench} {unit}".strip(),
        f"{without} -> {with_it} {error_unit}".strip(),
    )


def table() -> str:
    """Return the section of RESULTS.md."""
    cases = all_cases()
    names = os.environ.get("CASES", ",".join([*cases, *ARMS])).split(",")
    lines = [
        "## Cases\n",
        *head("machine", "answer", "95 % interval", "at the bench", "rms error at work"),
    ]
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            if name in cases:
                outcome = run_case(name, cases[name], Path(folder))
                case = cases[name]
                lines.append(_row_of(case.title, outcome, case.unit, case.error_unit))
                continue
            title, example, noise = ARMS[name]
            for k, outcome in enumerate(run_arm(example, noise)):
                lines.append(_row_of(f"{title}, joint {k + 1}", outcome, "rad", "mm"))
    return "\n".join([*lines, ""])


def write_logs(folder: Path) -> None:
    """Write the logs of all cases to a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, case in all_cases().items():
        print(write_log(name, case, folder))


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("python -m benchmarks.end_to_end.cases FOLDER writes the gallery's logs")
    write_logs(Path(sys.argv[1]))
