"""`--to st`: Structured Text gives the C's bits, by a reader of the standard's grammar and by iec2c."""

from __future__ import annotations

import functools
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from structured_text import Reader
from test_engines import OBSERVERS, PENDULUM, TWO_OUTPUTS, small
from test_export import EXPORTED
from tools import require
from undeadzone.compile import elementary
from undeadzone.compile.print_c import Style, functions
from undeadzone.compile.print_st import style_of
from undeadzone.exports import export, parts, plc, plc_files
from undeadzone.exports.code import Code, code
from undeadzone.exports.source import Labels, source
from undeadzone.exports.vectors import chosen, continued, recorded, reference
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.schema import Scenario

SAMPLES = 10_000
FLAGS = ["-std=c99", "-ffp-contract=off", "-fno-math-errno", "-w", "-O0"]
LABELS = Labels("o", "An arm (* of *) 30 °C", "observer")
CONFIGURATION = """
CONFIGURATION c
    RESOURCE r ON PLC
        TASK t (INTERVAL := T#10ms, PRIORITY := 0);
        PROGRAM i WITH t : o_test;
    END_RESOURCE
END_CONFIGURATION
"""


@pytest.fixture(autouse=True, scope="module")
def cheaper() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(export, "STEPS", 600)
        yield


class Made(NamedTuple):
    """An export: its graphs, C and Structured Text."""

    code: Code
    c: dict[str, str]
    blocks: str
    test: str
    units: list[plc.Unit]


def made(scenario: Scenario, single: bool, part: str = "observer", **options: Any) -> Made:
    """An export, without its folder."""
    problem = resolve_scenario(scenario)
    step = parts.build(problem, part, **options)
    printed = code(step, single)
    rows = recorded(problem, step)
    exported = plc.exported(printed, LABELS, reference(printed, chosen(rows, step.readings)))
    return Made(
        printed,
        source(printed, LABELS).files("o"),
        plc_files.text_of(exported.units, LABELS, printed),
        plc_files.text_of([exported.test], LABELS, printed),
        exported.units,
    )


def observer(method: str, **changes: Any) -> Scenario:
    return small("sampled", observer={"method": method} | OBSERVERS[method][1], **changes)


def corrupted(rows: Any, seed: int) -> Any:
    """Rows in which one number in ten is what no sensor should say."""
    random = np.random.default_rng(seed)
    wrong = [np.nan, np.inf, -np.inf, 1e30, -1e30, 3e38, 1e-30, -1e-42, 0.0, -0.0, 17.0, -300.0]
    bad = random.choice(wrong, rows.shape)
    stuck = np.roll(rows, 1, axis=0)
    kinds = random.random(rows.shape)
    return np.where(kinds < 0.07, bad, np.where(kinds < 0.1, stuck, rows))


@functools.cache
def run_of(plant: str = "") -> Any:
    """The inputs along a run of one of the plants, corrupted."""
    plants = {"": {}, "two": {"plant": TWO_OUTPUTS}}
    scenario = observer("certified", **plants[plant])
    problem = continued(scenario, SAMPLES)
    return corrupted(recorded(problem, parts.build(problem)), 7)


DRIVER = """
#include <stdio.h>
int main(int count, char **words) {{
    FILE *from = fopen(words[1], "rb"), *to = fopen(words[2], "wb");
    {real} row[{inputs}];
    (void)count;
    {start}
    while (fread(row, sizeof row, 1, from) == 1) {{
        {real} seen[{shown}];
        {step}
        fwrite(seen, sizeof seen, 1, to);
    }}
    return fclose(to);
}}
"""


def driven(text: str, made: Made, rows: Any, folder: Path, start: str, step: str, *more: str) -> Any:
    """Outputs and memory along rows, by a program of C; NaN, which ST has not, as the largest."""
    printed = made.code
    shown = printed.step.start.size + sum(field.size for field in printed.step.outputs)
    words = {"real": printed.real, "inputs": rows.shape[1], "shown": shown}
    (folder / "main.c").write_text(text + DRIVER.format(start=start, step=step, **words))
    program = folder / "program"
    subprocess.run(["gcc", *FLAGS, *more, "-o", program, folder / "main.c", "-lm"], check=True)
    rows.astype(printed.kind).tofile(folder / "rows")
    subprocess.run([program, folder / "rows", folder / "seen"], check=True)
    seen = np.fromfile(folder / "seen", printed.kind).reshape(len(rows), shown)
    return np.where(np.isnan(seen), np.finfo(seen.dtype).max, seen)


def by_c(made: Made, rows: Any, folder: Path) -> Any:
    """Outputs and memory of the exported C."""
    for name, text in made.c.items():
        (folder / name).write_text(text)
    params = "&params, " if made.code.step.params else ""
    declared = "static o_state state; static o_in in; static o_out out; o_init(&state);"
    if params:
        declared += " static o_params params; o_params_default(&params);"
    memory = made.code.step.start.size
    step = (
        f"memcpy(&in, row, sizeof row); o_step(&state, {params}&in, &out); "
        f"memcpy(seen, &out, sizeof out); memcpy((char *)seen + sizeof out, &state, {memory} * "
        "sizeof(seen[0]));"
    )
    return driven('#include <string.h>\n#include "o.c"\n', made, rows, folder, declared, step)


def in_c(made: Made, name: str, real: str) -> tuple[str, str]:
    """Statements that start and step an instance of the block; `real` makes a field of a name."""
    block = made.units[-1].variables
    inputs = [each.name for each in block["VAR_INPUT"] if each.kind != "BOOL"]
    shown = [each.name for each in block["VAR_OUTPUT"]]
    shown += [each.name for each in block["VAR"] if each.start]
    count = sum(field.size for field in made.code.step.inputs)
    lines = [f"{real.format(text)} = row[{k}];" for k, text in enumerate(inputs[:count])]
    lines.append(name)
    lines += [f"seen[{k}] = {real.format(text)};" for k, text in enumerate(shown)]
    return "", "\n".join(lines)


def by_reader(made: Made, rows: Any, folder: Path, wide: str = "") -> Any:
    """Outputs and memory of the Structured Text, as the reader's C has them."""
    _, step = in_c(made, "fb_o_body(&block);", "block.{}")
    step = re.sub(r"block\.(\w+)", lambda match: f"block.{match[1].lower()}", step)
    start = "static fb_o block; fb_o_init(&block);"
    return driven(Reader(made.blocks, wide).c(), made, rows, folder, start, step)


def by_iec2c(made: Made, rows: Any, folder: Path) -> Any:
    """Outputs and memory of the Structured Text, as the C of the compiler has them."""
    found = shutil.which("iec2c")
    assert found is not None
    library = Path(found).resolve().parent / "lib"
    (folder / "u.st").write_text(made.blocks + made.test + CONFIGURATION)
    command = [found, "-I", library, "-T", folder, folder / "u.st"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    _, step = in_c(made, "FB_O_body__(&block);", "block.{}")
    step = re.sub(r"block\.(\w+)", lambda match: f"block.{match[1].upper()}.value", step)
    text = '#include "POUS.h"\n#include "POUS.c"\nTIME __CURRENT_TIME; BOOL __DEBUG;\n'
    include = f"-I{library / 'C'}"
    start = "static FB_O block; FB_O_init__(&block, 0);"
    return driven(text, made, rows, folder, start, step, include, "-std=gnu99")


def assert_same_bits(first: Any, second: Any) -> None:
    """All bits, the sign of zero included."""
    word = f"u{first.itemsize}"
    differ = first.view(word) != second.view(word)
    assert not differ.any(), (np.argwhere(differ)[:5], first[differ][:5], second[differ][:5])


@pytest.mark.parametrize("single", [True, False], ids=["REAL", "LREAL"])
@pytest.mark.parametrize("method", [name for name in EXPORTED if name != "auto"])
def test_every_observer_has_the_bits_of_the_c(method: str, single: bool, tmp_path: Path) -> None:
    each, rows = made(observer(method), single), run_of()
    expected = by_c(each, rows, tmp_path)
    assert_same_bits(by_reader(each, rows, tmp_path), expected)
    if shutil.which("iec2c"):
        assert_same_bits(by_iec2c(each, rows, tmp_path), expected)
