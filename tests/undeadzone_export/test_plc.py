"""`--to st`: the bits of the C, by a reader of the standard's grammar and by iec2c."""

from __future__ import annotations

import functools
import re
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import pytest
from test_engines import CONTROLLERS, OBSERVERS, PENDULUM, TWO_OUTPUTS, small
from test_exporting import EXPORTED
from test_lower import A, B, calling_outputs, stateless

import once
import undeadzone as uz
from requirements import import_package, require
from scenes import tables_of
from structured_text import Reader, Refused
from undeadzone.compile import elementary, portable_maths
from undeadzone.compile.graph import Nodes
from undeadzone.compile.print_c import WIDTH, Expressions, Style, elementary_texts
from undeadzone.compile.print_st import ST, assign_number
from undeadzone.errors import InputError
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone_export import exported_step, exporting, plc, plcopen
from undeadzone_export.code import Code, build_code
from undeadzone_export.selftest_vectors import (
    choose_samples,
    continue_scenario,
    record_inputs,
    reference_vectors,
)
from undeadzone_export.source import Labels, build_source

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
        patch.setattr(exporting, "STEPS", 600)
        yield


class PrintedExport(NamedTuple):
    """An export: its graphs, C and Structured Text."""

    code: Code
    c: dict[str, str]
    blocks: str
    test: str
    units: list[plc.PlcUnit]


def print_export(
    scenario: Scenario, single: bool, part: str = "observer", **options: Any
) -> PrintedExport:
    """An export, without its folder."""
    problem = resolve_scenario(scenario)
    step = exported_step.build_step(problem, part, **options)
    printed = build_code(step, single)
    rows = record_inputs(problem, step)
    exported = plc.export_plc(
        printed, LABELS, reference_vectors(printed, choose_samples(rows, step.readings))
    )
    return PrintedExport(
        printed,
        build_source(printed, LABELS).texts_by_name(),
        plcopen.st_text(exported.units, LABELS, printed),
        plcopen.st_text([exported.test], LABELS, printed),
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
    changes = {"plant": TWO_OUTPUTS, "observer": {"method": "certified", "gamma": 5.0}}
    scenario = small("sampled", **changes) if plant == "two" else observer("certified")
    problem = continue_scenario(scenario, SAMPLES)
    return corrupted(record_inputs(problem, exported_step.build_step(problem)), 7)


DOMAINS = {"log1p": "x > -1", "pow": "x > 0", "acosh": "x >= 1", "atanh": "x > -1 && x < 1"}


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


def driven(
    text: str, export: PrintedExport, rows: Any, folder: Path, start: str, step: str, *more: str
) -> Any:
    """Outputs and memory along rows, by a program of C; NaN, which ST has not, as the largest."""
    printed = export.code
    recorded = printed.step.start.size + sum(field.size for field in printed.step.outputs)
    words = {"real": printed.c_type, "inputs": rows.shape[1], "shown": recorded}
    (folder / "main.c").write_text(text + DRIVER.format(start=start, step=step, **words))
    program = once.program(["program", *FLAGS, *more, "main.c"], folder)
    rows.astype(printed.dtype_name).tofile(folder / "rows")
    subprocess.run([program, folder / "rows", folder / "seen"], check=True)
    seen = np.fromfile(folder / "seen", printed.dtype_name).reshape(len(rows), recorded)
    return np.where(np.isnan(seen), np.finfo(seen.dtype).max, seen)


def by_c(export: PrintedExport, rows: Any, folder: Path) -> Any:
    """Outputs and memory of the exported C."""
    for name, text in export.c.items():
        (folder / name).write_text(text)
    params = "&params, " if export.code.step.params else ""
    declared = "static o_state state; static o_in in; static o_out out; o_init(&state);"
    if params:
        declared += " static o_params params; o_params_default(&params);"
    memory = export.code.step.start.size
    step = (
        f"memcpy(&in, row, sizeof row); o_step(&state, {params}&in, &out); "
        f"memcpy(seen, &out, sizeof out); memcpy((char *)seen + sizeof out, &state, {memory} * "
        "sizeof(seen[0]));"
    )
    return driven('#include <string.h>\n#include "o.c"\n', export, rows, folder, declared, step)


def step_of(export: PrintedExport, call: str, form: str, letters: Callable[[str], str]) -> str:
    """Statements that step an instance; `form` and `letters` make a field of a name."""
    block = export.units[-1].variables
    inputs = [each.name for each in block["VAR_INPUT"] if each.kind != "BOOL"]
    variables = [each.name for each in block["VAR_OUTPUT"]]
    variables += [each.name for each in block["VAR"] if each.start]
    count = sum(field.size for field in export.code.step.inputs)

    def member(name: str) -> str:
        return f"block.{form.format(letters(name))}"

    lines = [f"{member(name)} = row[{k}];" for k, name in enumerate(inputs[:count])]
    lines.append(call)
    lines += [f"seen[{k}] = {member(name)};" for k, name in enumerate(variables)]
    return "\n".join(lines)


def by_reader(export: PrintedExport, rows: Any, folder: Path, wide: str = "") -> Any:
    """Outputs and memory of the Structured Text, as the reader's C has them."""
    step = step_of(export, "fb_o_body(&block);", "{}", str.lower)
    start = "static fb_o block; fb_o_init(&block);"
    return driven(Reader(export.blocks, wide).c(), export, rows, folder, start, step)


def by_iec2c(export: PrintedExport, rows: Any, folder: Path) -> Any:
    """Outputs and memory of the Structured Text, as the C of the compiler has them."""
    found = shutil.which("iec2c")
    assert found is not None
    library = Path(found).resolve().parent / "lib"
    (folder / "u.st").write_text(export.blocks + export.test + CONFIGURATION)
    command = [found, "-I", library, "-T", folder, folder / "u.st"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    step = step_of(export, "FB_O_body__(&block);", "{}.value", str.upper)
    text = '#include "POUS.h"\n#include "POUS.c"\nTIME __CURRENT_TIME; BOOL __DEBUG;\n'
    include = f"-I{library / 'C'}"
    start = "static FB_O block; FB_O_init__(&block, 0);"
    return driven(text, export, rows, folder, start, step, include, "-std=gnu99")


def assert_same_bits(first: Any, second: Any) -> None:
    """All bits, the sign of zero included."""
    word = f"u{first.itemsize}"
    differ = first.view(word) != second.view(word)
    assert not differ.any(), (np.argwhere(differ)[:5], first[differ][:5], second[differ][:5])


PRECISIONS = pytest.mark.parametrize("single", [True, False], ids=["REAL", "LREAL"])


@PRECISIONS
def test_calls_that_the_graph_keeps_have_the_bits_of_the_c(single: bool, tmp_path: Path) -> None:
    step = stateless([A, B], calling_outputs())
    printed = build_code(step, single)
    exported = plc.export_plc(printed, LABELS, reference_vectors(printed, np.zeros((1, 2))))
    each = PrintedExport(
        printed,
        build_source(printed, LABELS).texts_by_name(),
        plcopen.st_text(exported.units, LABELS, printed),
        plcopen.st_text([exported.test], LABELS, printed),
        exported.units,
    )
    assert each.blocks.count("FUNCTION_BLOCK fb_o_shared_") == 2
    rows = np.random.default_rng(5).normal(size=(500, 2))
    assert_same_bits(by_reader(each, rows, tmp_path), by_c(each, rows, tmp_path))


@PRECISIONS
@pytest.mark.parametrize("method", [name for name in EXPORTED if name != "auto"])
def test_every_observer_has_the_bits_of_the_c(method: str, single: bool, tmp_path: Path) -> None:
    """Outputs and memory along 10,000 corrupted samples."""
    each, rows = print_export(observer(method), single), run_of()
    assert_same_bits(by_reader(each, rows, tmp_path), by_c(each, rows, tmp_path))


@PRECISIONS
@pytest.mark.parametrize("method", [name for name in EXPORTED if name != "auto"])
def test_the_compiler_matiec_gives_the_same_bits(method: str, single: bool, tmp_path: Path) -> None:
    """Its iec2c is in no registry: who has it in PATH runs this."""
    require("plc", [] if shutil.which("iec2c") else ["iec2c"])
    each, rows = print_export(observer(method), single), run_of()
    assert_same_bits(by_iec2c(each, rows, tmp_path), by_c(each, rows, tmp_path))


@PRECISIONS
@pytest.mark.parametrize(
    "changes",
    [
        {"sensor": {"kind": "jump", "noise": 0.05}},
        {"sensor": {"range": [-3.0, 3.0]}},
        {"sensor": {"play": [0.2, 0.2]},
         "observer": {"method": "kalman"} | OBSERVERS["kalman"][1]},
        {"plant": TWO_OUTPUTS, "observer": {"method": "certified", "gamma": 5.0}},
        (tables_of("""
            observer = { method = "certified", L = [1.0, 0.0] }
            reference = { kind = "sine", amplitude = 1.0, frequency = 0.5 }
            simulation = { duration = 3.0, step = 0.01, substeps = 1 }
            """) | {"plant": PENDULUM}),
    ],
    ids=["jump", "range", "play", "two outputs", "nonlinear"],
)  # fmt: skip
def test_every_kind_of_plant_and_sensor(
    changes: dict[str, Any], single: bool, tmp_path: Path
) -> None:
    each = print_export(small("sampled", **changes), single)
    rows = run_of("two" if changes.get("plant") is TWO_OUTPUTS else "")
    assert_same_bits(by_reader(each, rows, tmp_path), by_c(each, rows, tmp_path))


@pytest.mark.parametrize("controller", ["state_feedback", "pid"])
def test_with_its_controller_and_tunable_numbers(controller: str, tmp_path: Path) -> None:
    options = {"method": controller} | CONTROLLERS[controller][1]
    tunable = ("observer.gamma", "sensor.threshold")
    scenario = small("sampled", controller=options)
    each = print_export(scenario, True, "observer+controller", tunable=tunable)
    problem = resolve_scenario(scenario)
    rows = corrupted(record_inputs(problem, each.code.step), 3)
    assert_same_bits(by_reader(each, rows, tmp_path), by_c(each, rows, tmp_path))
    assert "observer_gamma_0 : REAL := 0." in each.blocks


@pytest.mark.parametrize("wide", ["double", "long double"])
@pytest.mark.parametrize("method", ["certified", "kalman"])
def test_real_has_floats_bits_where_expressions_are_wider(
    method: str, wide: str, tmp_path: Path
) -> None:
    """Compilers that keep products of REAL in LREAL or in 80 bits round where a value is stored."""
    each, rows = print_export(observer(method), True), run_of()
    assert_same_bits(by_reader(each, rows, tmp_path, wide), by_c(each, rows, tmp_path))


@pytest.mark.parametrize("method", ["certified", "kalman"])
def test_readings_that_are_marked_missing_stop_no_plc(method: str, tmp_path: Path) -> None:
    """No operation is invalid and none divides by zero, so that no exception is raised."""
    problem = resolve_scenario(observer(method))
    rows = record_inputs(problem, exported_step.build_step(problem))
    rows[::10, 0] = 3e38  # what `missing` makes of a reading
    each = print_export(observer(method), True)
    text = f"#include <fenv.h>\n{Reader(each.blocks).c()}"
    step = step_of(each, "fb_o_body(&block);", "{}", str.lower)
    step += "if (fetestexcept(FE_INVALID | FE_DIVBYZERO)) { return 1; }"
    start = "static fb_o block; fb_o_init(&block);"
    seen = driven(text, each, rows, tmp_path, start, step)
    assert len(seen) == len(rows)


def selftested(text: str, folder: Path, cycles: int) -> tuple[int, ...]:
    """(done, passed, failures) of the self-test's program after some cycles."""
    main = f"""
    #include <stdio.h>
    int main(void) {{
        static o_test test; o_test_init(&test);
        for (int k = 0; k < {cycles}; k++) {{ o_test_body(&test); }}
        return printf("%d %d %d", test.done, test.passed, test.failures) < 0;
    }}
    """
    (folder / "t.c").write_text(Reader(text).c() + main)
    program = once.program(["t", *FLAGS, "t.c"], folder)
    printed = subprocess.run([program], capture_output=True, text=True, check=True).stdout
    return tuple(map(int, printed.split()))


@PRECISIONS
def test_the_self_test_passes_and_notices_every_sign(single: bool, tmp_path: Path) -> None:
    each = print_export(observer("certified"), single)
    samples = len(choose_samples(np.zeros((200, 2)), 1))
    assert selftested(each.blocks + each.test, tmp_path, samples - 1)[:2] == (0, 0)
    assert selftested(each.blocks + each.test, tmp_path, samples + 5) == (1, 1, 0)
    signs = [match.start() + 1 for match in re.finditer(r" [+-] ", each.blocks)]
    assert len(signs) > 8
    for place in signs:
        flipped = "-" if each.blocks[place] == "+" else "+"
        text = each.blocks[:place] + flipped + each.blocks[place + 1 :]
        assert selftested(text + each.test, tmp_path, samples)[1] == 0, each.blocks[place - 40 :][
            :80
        ]


def test_reset_starts_anew_and_hold_remembers_nothing(tmp_path: Path) -> None:
    each, rows = print_export(observer("kalman"), True), run_of()[:200]
    expected = by_c(each, np.vstack([rows, rows]), tmp_path)
    expected = np.vstack([expected[:200], by_c(each, rows, tmp_path)])
    step = step_of(each, "block.hold = 1; fb_o_body(&block); block.hold = 0; fb_o_body(&block);",
                   "{}", str.lower)  # fmt: skip
    step = f"static int k; block.reset = k++ == 200; {step}"
    step = step.replace("block.hold = 0;", "block.hold = 0; block.reset = k == 201;")
    start = "static fb_o block; fb_o_init(&block);"
    text = Reader(each.blocks).c()
    assert_same_bits(driven(text, each, np.vstack([rows, rows]), tmp_path, start, step), expected)


@PRECISIONS
def test_elementary_functions_have_the_bits_of_the_c(single: bool, tmp_path: Path) -> None:
    """Without bits of numbers: by exact products and sums."""
    kind, real = ("float32", "float") if single else ("float64", "double")
    random, limits = np.random.default_rng(1), np.finfo(kind)
    powers = random.uniform(np.log2(limits.smallest_subnormal) + 1, np.log2(limits.max), 3000)
    values = [2.0**powers, -(2.0**powers), random.uniform(-100, 100, 3000), np.arange(-40.0, 40.0)]
    edges = [
        0.0,
        -0.0,
        np.inf,
        -np.inf,
        float(limits.max),
        float(limits.smallest_subnormal),
        7999.0,
    ]
    np.concatenate([*values, edges]).astype(kind).tofile(tmp_path / "values")
    names = list(elementary.FUNCTIONS)
    style = Style(kind, "o", ST)
    units = [plc.function_unit(name, style) for name in portable_maths.OWN.functions]
    labels, printed = LABELS, print_export(observer("certified"), single).code
    text = Reader(plcopen.st_text(units, labels, printed)).c()
    theirs = "\n".join(elementary_texts(names, set(names), Style(kind, "c")))
    calls = []
    for name in names:
        second = ", y" if len(elementary.build_elementary(name, kind).inputs) == 2 else ""
        if name == "erf_by_exp":
            second = ", c_exp(-(x * x))"
        call = f'check("{name}", o_{name}(x{second}), c_{name}(x{second}), x, y);'
        calls.append(f"if ({DOMAINS.get(name, '1')}) {{ {call} }}")
    main = f"""
    #include <stdio.h>
    #include <stdbool.h>
    #include <stdint.h>
    #include <string.h>
    #include <float.h>
    {theirs}
    static int wrong;
    static {real} seen({real} a) {{
        const {real} most = {"FLT_MAX" if single else "DBL_MAX"};
        return isnan(a) ? most : (a > most ? most : (a < -most ? -most : a));
    }}
    static void check(const char *name, {real} a, {real} b, {real} x, {real} y) {{
        a = seen(a); b = seen(b);
        if (memcmp(&a, &b, sizeof a)) {{
            wrong++;
            if (wrong < 20) printf("%s(%a, %a) = %a, not %a\\n", name, x, y, a, b);
        }}
    }}
    int main(void) {{
        static {real} all[20000];
        FILE *from = fopen("values", "rb");
        const size_t count = fread(all, sizeof all[0], 20000, from);
        for (size_t k = 0; k < count; k++) {{
            const {real} x = all[k], y = all[(k * 37 + 11) % count];
            {" ".join(calls)}
        }}
        return wrong != 0 || count < 9000;
    }}
    """
    (tmp_path / "f.c").write_text(text + main)
    program = once.program(["f", *FLAGS, "f.c"], tmp_path)
    done = subprocess.run([program], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stdout


def test_the_folder_has_text_xml_and_a_self_test(tmp_path: Path) -> None:
    done = uz.export(observer("certified"), "st", tmp_path / "plc", name="left", check=True)
    assert done.has_passed
    assert done.report["precision"] == "single"
    assert done.report["structured_text"]["blocks"] == 1
    assert {path.name for path in done.files} == {
        "left.st", "left_test.st", "left.xml", "README.md", "manifest.json",
    }  # fmt: skip
    text = "".join((tmp_path / "plc" / name).read_text() for name in ("left.st", "left_test.st"))
    assert set(Reader(text).units) == {"fb_left", "left_test"}
    readme = (tmp_path / "plc" / "README.md").read_text()
    assert "fb_left" in readme
    assert "`done` is TRUE" in readme
    assert "SPDX-License-Identifier" in (tmp_path / "plc" / "left.xml").read_text()
    again = uz.export(observer("certified"), "st", tmp_path / "again", name="left")
    for first, second in zip(done.files, again.files, strict=True):
        assert first.read_bytes() == second.read_bytes()


def test_a_choice_is_one_line_where_that_fits() -> None:
    lines = print_export(observer("kalman"), single=True).blocks.splitlines()
    choices = [line for line in lines if re.fullmatch(r" *IF .* THEN .* ELSE .* END_IF;", line)]
    assert choices
    assert max(map(len, choices)) <= WIDTH
    apart = [k for k, line in enumerate(lines) if line.strip() == "ELSE"]
    for k in apart:  # of IF, two assignments, ELSE and END_IF, where each takes a line
        whole = " ".join(line.strip() for line in lines[k - 2 : k + 3])
        if whole.endswith("END_IF;") and whole.startswith("IF"):
            assert len(whole) > WIDTH - 4, whole


@pytest.mark.parametrize("method", ["certified", "kalman"])
def test_the_xml_is_plcopens_and_holds_the_text(method: str, tmp_path: Path) -> None:
    """Each element, attribute and type is of the schema; the statements are those of the text."""
    Project = import_package("plcopen").Project
    parsers = import_package("xsdata.formats.dataclass.parsers")

    uz.export(observer(method), "st", tmp_path, name="o")
    strict = parsers.config.ParserConfig(
        fail_on_unknown_properties=True,
        fail_on_unknown_attributes=True,
        fail_on_converter_warnings=True,
    )
    project = parsers.XmlParser(config=strict).from_path(tmp_path / "o.xml", Project)
    pous = {pou.name: pou for pou in project.types.pous.pou}
    text = (tmp_path / "o.st").read_text() + (tmp_path / "o_test.st").read_text()
    units = Reader(text).units
    assert list(pous) == [unit.name for unit in units.values()]
    for name, pou in pous.items():
        statements = pou.body[0].st.w3_org_1999_xhtml_element.text
        assert f"{statements}\nEND_" in text
        unit = units[name.lower()]
        groups = [*pou.interface.input_vars, *pou.interface.output_vars, *pou.interface.local_vars]
        declared = [each.name.lower() for group in groups for each in group.variable]
        assert declared == [key for key in unit.variables if key != name.lower()]
    assert len([name for name in pous if "_part_" in name]) == (6 if method == "censored" else 0)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("v", "end_if"),
        ("REAL#", "LREAL#"),
        ("read_0 := y_0;", "y_0 := read_0;"),
        ("x_was_0 : REAL", "X_0 : REAL"),
        ("IF NOT hold", "IF hold - 1"),
        ("END_FUNCTION_BLOCK", "END_PROGRAM"),
        ("(u_0 < ", "(SIN(u_0) < "),
        (" AND ", " && "),
    ],
)
def test_the_reader_refuses_what_the_standard_does_not_know(before: str, after: str) -> None:
    text = print_export(observer("certified"), True).blocks
    assert before in text
    with pytest.raises(Refused):
        Reader(text.replace(before, after, 1) if before != "v" else text.replace("v7 ", "mod "))


def test_no_two_names_differ_by_capitals_alone() -> None:
    assert exported_step.make_distinct(["W_0", "w_0", "x_0", "W_0"], str.lower) == [
        "W_0",
        "w_0_2",
        "x_0",
        "W_0_3",
    ]


def test_what_the_language_lacks_is_refused() -> None:
    node = Nodes().intern(
        "call", Nodes().intern_constant(1.0), Nodes().intern_constant(2.0), text="fmod"
    )
    with pytest.raises(InputError, match="Structured Text has no function fmod"):
        Expressions(Style("float64", "o", ST), {}).write_node(node)


def test_numbers_mean_their_bits() -> None:
    values = [0.1, -0.0, 1e-300, 1e300, 5e-324, 1.7976931348623157e308, 123456789.0, 3.5e38]
    for value in values:
        found = None
        for line in assign_number("v", value, "float64"):
            numbers = [float(text) for text in re.findall(r"LREAL#([-\d.E+]+)", line)]
            assert all(1.1e-38 < number < 3.5e38 for number in numbers if number)
            found = numbers[0] if found is None else found * numbers[0]
        sign = -1.0 if "= -" in assign_number("v", value, "float64")[0] else 1.0
        assert found is not None
        assert np.float64(sign * found).tobytes() == np.float64(value).tobytes()


def test_titles_and_units_of_strangers_stay_comments(tmp_path: Path) -> None:
    wild = "*) END_VAR (* ]]> </xhtml> \ufffe $N \u00b0"
    scenario = observer("certified", title=wild, units={"output": wild, "state": wild})
    uz.export(scenario, "st", tmp_path, name="o")
    text = (tmp_path / "o.st").read_text() + (tmp_path / "o_test.st").read_text()
    assert text.isascii()
    assert list(Reader(text).units) == ["fb_o", "o_test"]
    root = ElementTree.parse(tmp_path / "o.xml").getroot()
    assert len(list(root.iter("{http://www.plcopen.org/xml/tc6_0201}pou"))) == 2
