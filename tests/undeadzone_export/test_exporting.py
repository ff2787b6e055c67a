"""`uz.export` from end to end: every method that is a graph, the folder, self-test, refusals."""

from __future__ import annotations

import ctypes
import itertools
import json
import os
import re
import shutil
import subprocess
import zipfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_engines import CONTROLLERS, OBSERVERS, PENDULUM, TWO_OUTPUTS, small

import once
import undeadzone as uz
from requirements import require
from scenes import scene, tables_of
from undeadzone.compile import elementary, lanes, scalar_step
from undeadzone.compile.graph import LANES, Nodes, required_nodes
from undeadzone.errors import FileError, InputError
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone_export import accuracy, compiler, exported_step, exporting, selftest_vectors
from undeadzone_export.code import build_code, count_operations, split_phases
from undeadzone_export.source import Labels
from undeadzone_export.source import build_source as printed_source

FLAGS = ["-std=c99", "-ffp-contract=off", "-fno-math-errno"]
WARNINGS = [
    "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wdouble-promotion", "-Wshadow",
    "-Wfloat-equal", "-Werror",
]  # fmt: skip
SUFFIXES = (".c", ".h", ".ino", ".py", ".txt", ".st")
LEVELS = (["-O0"], ["-O2"], ["-O3", "-march=native"])
EXPORTED = [
    name for name, (times, _) in OBSERVERS.items() if "sampled" in times and name != "full_state"
]
DRIVEN = [name for name, (times, _) in CONTROLLERS.items() if "sampled" in times]
OWN = elementary.FUNCTIONS.keys() - {"fmin", "fmax", "sign", "floor", "ceil"}  # rounded otherwise


@pytest.fixture(autouse=True, scope="module")
def cheaper() -> Iterator[None]:
    """Runs of 600 steps: what 100 000 steps of optimised code show is tested once, below."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(exporting, "STEPS", 600)
        yield


@pytest.fixture(scope="module")
def joint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the paper's example in float; who changes a file takes a copy."""
    folder = tmp_path_factory.mktemp("joint") / "fw"
    uz.export(certified(), out=folder, name="joint")
    return folder


def built(folder: Path, name: str, options: list[str]) -> subprocess.CompletedProcess[str]:
    """The self-test compiled with options, and run."""
    words = ["program", *FLAGS, *options, f"{name}.c", f"{name}_test.c"]
    return subprocess.run([str(once.program(words, folder))], capture_output=True, text=True)


def assert_near_the_graph(report: dict[str, Any]) -> None:
    """Code in double is compared with the virtual machine; float with the graph in double."""
    if report["machine"] is None:
        assert report["float_against_double"].keys() >= {"x", "z"}
    else:
        assert report["machine"] <= report["machine_bar"]


SLOW = {"time": "sampled", "step": 0.01, "duration": 2.0}


def certified(**changes: Any) -> Scenario:
    """The paper's example, sampled."""
    return scene(simulation={"time": "sampled"}, **changes)


def test_the_options_of_deploy_md_are_those_of_the_function(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("CC")  # its stack is that of -O1
    done = uz.export(certified(), to="c", out=tmp_path / "fw", precision="single", part="observer",
                     tunable=("observer.gamma",), name="joint")  # fmt: skip
    assert sorted(path.name for path in done.files) == sorted(
        path.name for path in (tmp_path / "fw").iterdir()
    )
    assert {path.name for path in done.files} == {
        "joint.h", "joint.c", "joint_test.c", "Makefile", "CMakeLists.txt", "README.md",
        "manifest.json",
    }  # fmt: skip
    assert done.has_passed
    assert 0 < done.report["stack"] < 500
    manifest = json.loads((tmp_path / "fw" / "manifest.json").read_text())
    assert sorted(manifest["files"]) == sorted(path.name for path in done.files)
    assert manifest["hash"] == done.report["hash"]
    assert done.report["hash"] in (tmp_path / "fw" / "joint.h").read_text()


CASES = [(observer, precision) for precision in exporting.PRECISIONS for observer in EXPORTED]
# Here auto is the graph of censored.
CASES = [case for case in CASES if case[0] != "auto"]
THROUGHOUT = ("certified", "extended")  # are built at every level of optimisation
IN_FLOAT = (*THROUGHOUT, "kalman", "censored", "ekf", "adaptive_inverse", "interval")
CASES = [case for case in CASES if case[1] == "double" or case[0] in IN_FLOAT]


@pytest.mark.parametrize(("observer", "precision"), CASES)
def test_every_observer(observer: str, precision: str, tmp_path: Path) -> None:
    scenario = small("sampled", observer={"method": observer} | OBSERVERS[observer][1])
    done = uz.export(scenario, out=tmp_path / "fw", precision=precision, name="o")
    assert_near_the_graph(done.report["accuracy"])
    assert done.report["refusals"] == []
    for options in LEVELS if observer in THROUGHOUT else [["-O0"]]:
        result = built(tmp_path / "fw", "o", [*options, *WARNINGS])
        assert result.returncode == 0, (options, result.stdout)


def test_auto_is_exported_as_what_it_chooses() -> None:
    hashes = set()
    for method in ("auto", "censored"):
        scenario = small("sampled", observer={"method": method, "right": [0.1, 1.0]})
        hashes.add(build_code(exported_step.build_step(resolve_scenario(scenario)), True).hash)
    assert len(hashes) == 1


@pytest.mark.parametrize("controller", DRIVEN)
def test_every_controller(controller: str, tmp_path: Path) -> None:
    scenario = small("sampled", controller={"method": controller} | CONTROLLERS[controller][1])
    done = uz.export(scenario, out=tmp_path / "fw", part="observer+controller", name="c")
    assert_near_the_graph(done.report["accuracy"])
    assert not done.report["two_phase"]
    assert built(tmp_path / "fw", "c", ["-O0", *WARNINGS]).returncode == 0


def test_make_builds_the_self_test_and_it_passes(joint: Path, tmp_path: Path) -> None:
    shutil.copytree(joint, tmp_path / "fw")
    subprocess.run(["make", "-s", "-C", str(tmp_path / "fw"), "CC=gcc"], check=True)
    result = subprocess.run([str(tmp_path / "fw" / "joint_test")], capture_output=True, text=True)
    assert (result.returncode, "every bit agrees" in result.stdout) == (0, True)


@pytest.mark.parametrize(
    "changes",
    [
        {"plant": TWO_OUTPUTS, "observer": {"method": "certified", "gamma": 5.0}},
        (tables_of("""
            observer = { method = "certified", L = [1.0, 0.0] }
            reference = { kind = "sine", amplitude = 1.0, frequency = 0.5 }
            simulation = { duration = 3.0, step = 0.01, substeps = 1 }
            """) | {"plant": PENDULUM}),
        {"sensor": {"kind": "jump", "noise": 0.05}},
        {"sensor": {"dropout": 0.2, "quantum": 0.01}},
    ],
    ids=["two outputs", "nonlinear", "jump", "dropout"],
)  # fmt: skip
@pytest.mark.parametrize("part", exported_step.PARTS)
def test_every_kind_of_plant_and_sensor(changes: dict[str, Any], part: str, tmp_path: Path) -> None:
    done = uz.export(
        small("sampled", **changes), out=tmp_path / "fw", part=part, name="o", check=True
    )
    assert_near_the_graph(done.report["accuracy"])
    assert "every bit agrees" in done.report["self_test"]


def test_certified_has_the_bits_of_online(tmp_path: Path) -> None:
    scenario = certified()
    problem = resolve_scenario(scenario)
    step = exported_step.build_step(problem)
    rows = selftest_vectors.record_inputs(problem, step)
    rows[37, 0] = np.nan
    values = accuracy.CompiledStep(build_code(step, False), tmp_path)(rows)
    online = uz.Online(scenario.observer, scenario.plant, scenario.sensor, scenario.simulation.step)
    places = accuracy.field_slices(step.outputs)
    for k, row in enumerate(rows):
        estimate = online.update(row[:1], row[1:])
        for name in ("x", "z", "right", "left", "z_inverse", "innovation"):
            assert (values[k, places[name]] == getattr(estimate, name)).all(), (k, name)
        assert (values[k, places["side"]] == online.side).all()


def test_a_stored_state_goes_on_with_the_same_bits(tmp_path: Path) -> None:
    problem = resolve_scenario(certified())
    step = exported_step.build_step(problem)
    printed = build_code(step, False)
    rows = selftest_vectors.record_inputs(problem, step)[:200]
    runner = accuracy.CompiledStep(printed, tmp_path)
    whole = runner(rows)
    runner.reset_memory()
    runner(rows[:120])
    stored = runner.state.copy()
    head = "int go_on(void *state, const void *stored, const char *hash)"
    body = "{ return run_float64_resume(state, stored, hash); }"
    text = f'#include "run_float64.h"\n{head};\n{head}\n{body}\n'
    (tmp_path / "resume.c").write_text(text)
    library = compiler.compile_library([str(tmp_path / "resume.c")], tmp_path / "resume.so")
    resume = ctypes.CDLL(str(library)).go_on
    places = [array.ctypes.data_as(ctypes.c_void_p) for array in (runner.state, stored)]
    runner.reset_memory()
    start = runner.state.copy()
    for wrong in ("", printed.hash[:-1], printed.hash + "0", "0" * 16):
        assert resume(*places, wrong.encode()) == 0
        assert np.array_equal(runner.state, start)
    assert resume(*places, printed.hash.encode()) == 1
    assert np.array_equal(runner(rows[120:]), whole[120:])


def test_observer_and_controller_give_the_input_of_the_loop(tmp_path: Path) -> None:
    problem = resolve_scenario(certified())
    step = exported_step.build_step(problem, "observer+controller")
    rows = selftest_vectors.record_inputs(problem, step)
    alone = exported_step.build_step(problem)
    expected = selftest_vectors.record_inputs(problem, alone)[:, 1]
    values = accuracy.CompiledStep(build_code(step, False), tmp_path)(rows)[:, 0]
    assert np.abs(values - expected).max() < 1e-12 * np.abs(expected).max()


def test_a_drive_limit_limits_u(tmp_path: Path) -> None:
    problem = resolve_scenario(certified())
    limited = problem._replace(plant=problem.plant._replace(limit=np.array([0.5])))
    step = exported_step.build_step(limited, "observer+controller")
    rows = selftest_vectors.record_inputs(
        problem, exported_step.build_step(problem, "observer+controller")
    )
    values = accuracy.CompiledStep(build_code(step, False), tmp_path)(rows)[:, 0]
    assert np.abs(values).max() == 0.5


def test_tunable_numbers_are_parameters(tmp_path: Path) -> None:
    names = ("observer.gamma", "sensor.threshold", "observer.gamma")  # once is enough
    done = uz.export(certified(), out=tmp_path / "fw", tunable=names, name="joint", check=True)
    text = (tmp_path / "fw" / "joint.h").read_text()
    assert "float observer_gamma[1];" in text
    assert "float sensor_threshold[1];" in text
    assert "leaves what was proved" in text
    assert done.has_passed
    problem = resolve_scenario(certified(sensor={"threshold": 0.3}))
    step = exported_step.build_step(resolve_scenario(certified()), tunable=("sensor.threshold",))
    rows = selftest_vectors.record_inputs(problem, step)
    expected = accuracy.CompiledStep(
        build_code(exported_step.build_step(problem), False), tmp_path
    )(rows)
    tuned = accuracy.CompiledStep(
        build_code(step._replace(defaults=np.array([0.3])), False), tmp_path / "fw"
    )
    assert (tuned(rows) == expected).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"tunable": ("observer.gama",)}, "Did you mean observer.gamma"),
        ({"tunable": ("observer.left0",)}, "changes nothing"),
        ({"to": "fmu9"}, "to: found 'fmu9'. Did you mean 'fmu"),
        ({"precision": "half"}, "precision: found 'half'. Expected one of"),
        ({"part": "controller"}, "part: expected one of"),
        ({"name": "Arm"}, "name: expected a letter"),
        ({"name": "int"}, "name: expected a letter"),
        ({"name": "a b"}, "name: expected a letter"),
    ],
)
def test_what_cannot_be_exported_is_refused(
    changes: dict[str, Any], message: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        uz.export(certified(), out=tmp_path / "fw", **changes)
    assert list(tmp_path.iterdir()) == []


def test_continuous_scenarios_and_observers_in_python_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r'Set simulation\.time = "sampled"'):
        uz.export(scene(), out=tmp_path / "fw")
    for observer in ({"method": "moving_horizon"}, {"method": "full_state"}):
        options = (
            observer | {"right": [0.1, 1.0]} if observer["method"] != "full_state" else observer
        )
        with pytest.raises(InputError, match=r"observer\.method"):
            uz.export(small("sampled", observer=options), out=tmp_path / "fw")


def test_a_folder_is_replaced_only_if_it_is_an_export(tmp_path: Path) -> None:
    out = tmp_path / "fw"
    uz.export(certified(), out=out, name="joint", precision="double")
    uz.export(certified(), out=out, name="other", precision="double")
    assert not (out / "joint.c").exists()
    (out / "manifest.json").write_text("{}")
    before = sorted(path.name for path in out.iterdir())
    with pytest.raises(FileError, match="is not replaced"):
        uz.export(certified(), out=out, name="third", precision="double")
    assert sorted(path.name for path in out.iterdir()) == before
    file = tmp_path / "file"
    file.write_text("mine")
    with pytest.raises(FileError, match="is a file"):
        uz.export(certified(), out=file)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "fw"]


def test_a_flipped_sign_fails_the_self_test(joint: Path, tmp_path: Path) -> None:
    out = shutil.copytree(joint, tmp_path / "fw")
    path = out / "joint.c"
    text = path.read_text()
    start = text.index("void joint_estimate(")
    signs = [match.start() for match in re.finditer(r" [+-] ", text[start:])]
    assert len(signs) > 8
    for sign in signs:
        place = start + sign + 1
        flipped = "-" if text[place] == "+" else "+"
        path.write_text(text[:place] + flipped + text[place + 1 :])
        assert built(out, "joint", ["-O0"]).returncode == 1, text[place - 60 : place + 40]


def test_careless_options_fail_loudly_or_change_nothing(joint: Path, tmp_path: Path) -> None:
    out = shutil.copytree(joint, tmp_path / "fw")
    sources = [str(out / "joint.c"), str(out / "joint_test.c")]
    regrouped = ["-fassociative-math", "-fno-signed-zeros", "-fno-trapping-math"]
    for careless in (["-ffast-math"], regrouped):
        fast = ["gcc", *FLAGS, "-O2", *careless, "-o", str(out / "p"), *sources]
        refused = subprocess.run(fast, capture_output=True, text=True)
        assert refused.returncode != 0
        assert "compile without -ffast-math" in refused.stderr
    for options in (["-ffinite-math-only"], ["-std=gnu11", "-march=native", "-ffp-contract=fast"]):
        assert built(out, "joint", ["-O2", *options]).returncode == 0, options


def test_nothing_is_undefined(tmp_path: Path) -> None:
    """gcc's sanitizer stays silent, conversions of numbers to integers included."""
    scenario = small("sampled", observer={"method": "extended"} | OBSERVERS["extended"][1])
    uz.export(scenario, out=tmp_path / "fw", name="o")
    checks = ["-fsanitize=undefined,float-cast-overflow", "-fno-sanitize-recover=all"]
    assert built(tmp_path / "fw", "o", ["-O1", *checks]).returncode == 0


def test_no_constant_overflows_or_vanishes(tmp_path: Path) -> None:
    scenario = small("sampled", observer={"method": "censored"} | OBSERVERS["censored"][1])
    step = exported_step.build_step(resolve_scenario(scenario))
    assert exporting.constants_beyond_float(build_code(step, True)) == [
        "-1e+300: -3.3572615e+38f",
        "1e+100: 2.2533617e+38f",
        "1e+300: 3.3572615e+38f",
    ]
    texts = {node.text for node in required_nodes(itertools.chain(*build_code(step, True).results))}
    assert "nan" not in texts


def test_the_object_holds_no_data_and_calls_no_library(tmp_path: Path) -> None:
    uz.export(small("sampled", observer={"method": "extended"} | OBSERVERS["extended"][1]),
              out=tmp_path / "fw", name="o")  # fmt: skip
    target = tmp_path / "o.o"
    subprocess.run(
        ["gcc", *FLAGS, "-O2", "-c", "-o", str(target), str(tmp_path / "fw" / "o.c")], check=True
    )
    symbols = subprocess.run(["nm", str(target)], capture_output=True, text=True, check=True).stdout
    kinds = {line.split()[-2] for line in symbols.splitlines()}
    assert not kinds & {"U", "D", "B", "d", "b"}, symbols


def test_float_that_is_not_enough_is_refused_with_its_number(tmp_path: Path) -> None:
    """A width that moves by less than float's last digit at each sample stands still in float."""
    slow = {"method": "certified", "L": [1.0, 1.5], "gamma": 1e-3, "widths0": [3.99, 3.99]}
    scenario = scene(simulation={"time": "sampled", "step": 1e-5, "duration": 0.01}, observer=slow)
    step = exported_step.build_step(resolve_scenario(scenario))
    rows = np.tile([5.0, 0.0], (100_000, 1))
    printed = build_code(step, True)
    text = printed_source(printed, Labels("o", "slow", "observer"))
    result = accuracy.measure_accuracy(printed, text, rows)
    assert len(result.refusals) == 1
    assert re.match(r"float is not enough: right is wrong by 0\.00\d+", result.refusals[0])


# What makes float no choice, and the reason that the report has.
NO_FLOAT = [
    (accuracy, "SHARE_OF_WIDTH", 0.0, "float is not enough: right"),
    (compiler, "find_compiler", lambda: None, "float was not measured: no C compiler"),
]


@pytest.mark.parametrize(("module", "name", "value", "reason"), NO_FLOAT)
def test_double_is_taken_where_float_is_no_choice(
    module: Any, name: str, value: Any, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Float that is asked for is refused, and a refusal writes nothing."""
    monkeypatch.setattr(module, name, value)
    done = uz.export(certified(), out=tmp_path / "fw", name="joint")
    assert done.has_passed
    assert done.report["precision"] == "double"
    assert done.report["float_refusals"][0].startswith(reason)
    assert "const double" in (tmp_path / "fw" / "joint.c").read_text(encoding="utf-8")
    refused = uz.export(certified(), out=tmp_path / "no", precision="single", name="joint")
    assert refused.report["refusals"][0].startswith(reason)
    assert refused.report["refusals"][0].endswith("; use --precision double")
    assert refused.files == []
    assert not (tmp_path / "no").exists()


def test_a_self_test_that_fails_is_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And what an earlier export wrote stays."""
    before = uz.export(certified(), out=tmp_path / "fw", name="joint").files
    texts = [path.read_bytes() for path in before]
    monkeypatch.setattr(compiler, "run_selftest", lambda files: (False, "x differs"))
    done = uz.export(certified(), out=tmp_path / "fw", name="other", check=True)
    assert done.report["refusals"] == ["the self-test fails: x differs"]
    assert done.files == []
    assert [path.read_bytes() for path in before] == texts
    assert sorted((tmp_path / "fw").iterdir()) == sorted(before)


CENSORED = {"method": "censored", "right": [0.0, 2.0], "disturbance": 0.1, "correlation_time": 0.02}
COLOURED = ["observer.correlation_time", "observer.disturbance", "observer.tolerance"]
# An observer, another one that is named, the keys that the other lacks, and one that it keeps.
OTHER_METHODS = [
    (CENSORED | {"tolerance": 0.1}, "kalman", COLOURED, ("right", [0.0, 2.0])),
    (CENSORED | {"tolerance": 0.1}, "certified", COLOURED, ("width_max", [2.0])),
    (CENSORED, "censored levels=1 glitches=0.0", [], ("levels", 1)),
    (
        {"method": "certified", "gamma": 9.0},
        "kalman right=[0,2]",
        ["observer.gamma"],
        ("left", None),
    ),
]


@pytest.mark.parametrize(("observer", "method", "dropped", "kept"), OTHER_METHODS)
def test_another_method_rewrites_the_table_of_the_observer(
    observer: dict[str, Any], method: str, dropped: list[str], kept: tuple[str, Any], tmp_path: Path
) -> None:
    """With a line for each key that it drops."""
    scenario = scene(simulation=SLOW, observer=observer)
    changed, keys = exporting.change_method(scenario, method)
    assert changed.observer.__struct_config__.tag == method.split()[0]
    assert keys == dropped
    value = getattr(changed.observer, kept[0])
    assert value is None if kept[1] is None else np.array_equal(value, kept[1])
    done = uz.export(scenario, out=tmp_path / "fw", method=method)
    assert done.has_passed
    assert done.report["dropped"] == dropped


@pytest.mark.parametrize(
    ("method", "words"),
    [
        ("kalmann", r"observer\.method: unknown choice 'kalmann'. Did you mean 'kalman'"),
        ("", r"observer\.method"),
        ("kalman right=[", "expected NAME or 'NAME KEY=VALUE'"),
        ("kalman rigth=1", r"observer\.rigth: unknown key"),
    ],
)
def test_a_method_that_does_not_exist_is_refused(method: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(uz.InputError, match=words):
        uz.export(certified(), out=tmp_path / "fw", method=method)
    assert not (tmp_path / "fw").exists()


def test_two_uncoupled_groups_have_a_smaller_triangle() -> None:
    full = accuracy.smallest_eigenvalue(
        [vectors_field("mean", 2), vectors_field("cov", 3)], [0, 0, 1, 0.5, 1]
    )
    apart = accuracy.smallest_eigenvalue(
        [vectors_field("mean", 2), vectors_field("cov", 2)], [0, 0, 4, 9]
    )
    assert full == pytest.approx(0.5)
    assert apart == pytest.approx(1.0)


def vectors_field(name: str, size: int) -> Any:
    return exported_step.Field(name, size, "")


def test_an_arduino_library_has_its_layout(tmp_path: Path) -> None:
    done = uz.export(
        certified(title='Arm */ "joint"\n'), to="arduino", out=tmp_path / "lib", name="joint"
    )
    files = {str(path.relative_to(tmp_path / "lib")) for path in done.files}
    assert files == {
        "library.properties", "src/joint.h", "src/joint.c",
            "src/proof.json",
        "examples/joint_example/joint_example.ino", "examples/joint_test/joint_test.ino",
        "examples/joint_test/joint_test.c", "README.md", "manifest.json",
    }  # fmt: skip
    sketch = tmp_path / "sketch.cpp"
    text = (tmp_path / "lib" / "examples" / "joint_example" / "joint_example.ino").read_text()
    sketch.write_text(ARDUINO + text)
    command = [
        "g++",
        "-Wall",
        "-Werror",
        "-fsyntax-only",
        "-I",
        str(tmp_path / "lib" / "src"),
        str(sketch),
    ]
    subprocess.run(command, check=True)


ARDUINO = """
struct Port { void begin(long); void println(float); void println(const char *);
              operator bool() const { return true; } };
extern Port Serial; extern int A0; int analogRead(int); unsigned long micros();
"""
PORT = """
#include <cstdio>
Port Serial;
void Port::begin(long) {}
void Port::println(const char *text) { puts(text); }
int main() { setup(); return 0; }
"""


def test_an_arduino_sketch_runs_the_self_test(tmp_path: Path) -> None:
    lib = tmp_path / "lib"
    uz.export(certified(), to="arduino", out=lib, name="joint")
    example = lib / "examples" / "joint_test"
    sketch = tmp_path / "sketch.cpp"
    sketch.write_text(ARDUINO + (example / "joint_test.ino").read_text() + PORT)
    sources = [lib / "src" / "joint.c", example / "joint_test.c"]
    include = ["-I", lib / "src"]
    for source in sources:
        command = ["gcc", *FLAGS, *WARNINGS, "-DARDUINO=1", *include, "-c", source]
        subprocess.run(command, check=True, cwd=tmp_path)
    objects = [tmp_path / "joint.o", tmp_path / "joint_test.o"]
    subprocess.run(["g++", *include, "-o", tmp_path / "p", sketch, *objects], check=True)
    printed = subprocess.run([tmp_path / "p"], capture_output=True, text=True, check=True).stdout
    assert "joint_test: every bit agrees" in printed.splitlines()


def test_the_same_scenario_gives_the_same_files(joint: Path, tmp_path: Path) -> None:
    uz.export(certified(), out=tmp_path / "one", name="joint")
    for path in sorted((tmp_path / "one").iterdir()):
        assert path.read_bytes() == (joint / path.name).read_bytes(), path.name
    changed = uz.export(
        certified(observer={"method": "certified", "gamma": 9.0}),
        out=tmp_path / "one",
        name="joint",
    )
    other = json.loads((joint / "manifest.json").read_text())
    assert changed.report["hash"] != other["hash"]


def test_the_header_names_units_and_the_version(tmp_path: Path) -> None:
    units = {"output": "mm", "input": "V", "state": ["mm", "mm/s"]}
    uz.export(certified(units=units), out=tmp_path / "fw", name="joint")
    text = (tmp_path / "fw" / "joint.h").read_text()
    assert f'#define JOINT_VERSION "{uz.__version__}"' in text
    for words in (
        "float x[2]; /**< estimated state [mm, mm/s] */",
        "float right[1]; /**< estimated right width [mm] */",
        "float held[1]; /**< the last finite input [V] */",
        "float y[1]; /**< readings of the sensor; one that is not finite is missing [mm] */",
    ):
        assert words in text


@pytest.mark.parametrize("to", ["c", "arduino", "fmu2", "python", "st"])
def test_every_file_of_code_names_its_licence(to: str, tmp_path: Path) -> None:
    uz.export(certified(), to, out=tmp_path / "out", name="joint")
    texts = {path: path.read_bytes() for path in (tmp_path / "out").rglob("*") if path.is_file()}
    for package in (tmp_path / "out").rglob("*.fmu"):
        with zipfile.ZipFile(package) as archive:
            texts = {Path(name): archive.read(name) for name in archive.namelist()}
    code = [path for path in texts if path.suffix in SUFFIXES]
    assert code
    assert [
        path for path in code if b"SPDX-License-Identifier: BSD-3-Clause" not in texts[path]
    ] == []


def test_no_path_of_this_machine_is_in_a_file(joint: Path) -> None:
    for path in joint.iterdir():
        text = path.read_text()
        assert str(joint) not in text
        assert os.getcwd() not in text


def test_the_long_run_of_float(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """100 000 steps of `certified`: the widths stay within 1e-4 (measured: 1.8e-5)."""
    monkeypatch.setattr(exporting, "STEPS", 100_000)
    monkeypatch.delenv("CC")
    report = uz.export(certified(), out=tmp_path / "fw", name="joint").report["accuracy"]
    assert report["steps"] >= 100_000
    assert report["machine"] is None
    for name in ("right", "left"):
        assert report["float_against_double"][name]["error"] < 1e-4


@pytest.mark.parametrize(("precision", "steps"), [("single", 100_000), ("double", 2_000)])
def test_a_run_is_continued_as_far_as_it_is_compared(
    precision: str, steps: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With large filters the run takes most of the time of an export in double."""
    requested: list[int] = []

    def record_steps(scenario: Scenario, steps: int) -> Any:
        requested.append(steps)
        return selftest_vectors.continue_scenario(scenario, 0)

    monkeypatch.setattr(exporting, "STEPS", 100_000)
    monkeypatch.setattr(exporting, "continue_scenario", record_steps)
    uz.export(certified(), out=tmp_path / "fw", precision=precision, name="joint")
    assert requested == [steps]


def test_a_run_that_ends_by_itself_is_not_continued() -> None:
    scenario = certified()
    longer = selftest_vectors.continue_scenario(scenario, 5000)
    assert longer.steps == 5000
    assert (
        selftest_vectors.continue_scenario(scenario, 10).steps == resolve_scenario(scenario).steps
    )
    huge = selftest_vectors.continue_scenario(scenario, 10**9)
    assert huge.steps == resolve_scenario(scenario).steps


@pytest.mark.parametrize("controller", [False, True])
def test_cppcheck_finds_nothing_in_certified(controller: bool, tmp_path: Path) -> None:
    """Its checks, and its MISRA add-on but for 2.5: the step and the hash are for the user."""
    require("emulator", [] if shutil.which("cppcheck") else ["cppcheck"])
    part = exported_step.PARTS[int(controller)]
    uz.export(certified(), out=tmp_path / "fw", name="joint", part=part)
    source = str(tmp_path / "fw" / "joint.c")
    options = ["--std=c99", "--enable=warning,style,portability", "--addon=misra"]
    hushed = ["--suppress=missingIncludeSystem", "--suppress=misra-c2012-2.5"]
    command = ["cppcheck", "-q", *options, *hushed, "--error-exitcode=1", source]
    result = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert result.returncode == 0, result.stdout + result.stderr


@pytest.mark.parametrize("observer", [name for name in EXPORTED if name != "auto"])
def test_exported_C_has_the_bits_of_lanes_and_of_a_live_step(observer: str, tmp_path: Path) -> None:
    """Where no elementary function is used, those of the simulation itself."""
    problem = resolve_scenario(
        small("sampled", observer={"method": observer} | OBSERVERS[observer][1])
    )
    step = exported_step.build_step(problem)
    printed = build_code(step, False)
    rows = selftest_vectors.record_inputs(problem, step)
    rows[50:60, 0] = np.nan
    in_c = accuracy.CompiledStep(printed, tmp_path)(rows)
    function = step.function
    kernel = lanes.build_kernel(function, portable=True, width=8)
    states = np.tile(step.start, (8, 1))
    in_lanes, _ = lanes.run_lanes(kernel, states, rows, step.defaults)
    for lane in in_lanes:
        np.testing.assert_array_equal(lane, in_c)
    if not elementary.called_functions(printed.results) & OWN:
        stepper = scalar_step.CompiledStepper(function, step.start, step.defaults)
        np.testing.assert_array_equal(stepper.run(rows), in_c)


def test_boards_say_what_fits_and_what_would(tmp_path: Path) -> None:
    slow = scene(simulation=SLOW)
    small = uz.export(slow, out=tmp_path / "small").report
    assert all(board["fits"] for board in small["boards"])
    assert "leaner" not in small
    observer = {"method": "auto", "right": [0.0, 2.0]}
    large = uz.export(scene(simulation=SLOW, observer=observer), out=tmp_path / "large").report
    of = {board["board"]: board for board in large["boards"]}
    assert of["Arduino Uno"]["why"] == "flash, memory, time"
    assert of["Cortex-M4F (STM32F4)"]["fits"]
    assert "Arduino Uno" in large["leaner"]["certified"]
    double = uz.export(slow, out=tmp_path / "double", precision="double").report
    reasons = {board["board"]: board["why"] for board in double["boards"]}
    assert reasons["Arduino Uno"] == "its double is single"
    assert reasons["ESP32"] == ""
    assert "boards" not in uz.export(slow, "python", out=tmp_path / "module").report


def test_long_code_stores_each_state_behind_its_last_use() -> None:
    """And reads it ahead of its first, so that little is alive at a time."""
    observer = {"method": "censored", "right": [0.0, 2.0], "levels": 1}  # nothing is repeated
    step = exported_step.build_step(resolve_scenario(small("sampled", observer=observer)))
    printed = build_code(step, single=True)
    text = printed_source(printed, Labels("o", "long", "observer")).code
    lines = {}
    for name in ("estimate", "advance"):
        body = text[text.index(f"void o_{name}(") :].split("\n}\n")[0]
        lines[name] = [line for line in body.splitlines() if " = " in line]
    pattern = re.compile(r"const float (\w+_was_\d+) = (state->.*);")
    reads = [k for k, line in enumerate(lines["estimate"]) if pattern.search(line)]
    assert len(reads) > 40
    assert max(reads) > 0.4 * len(lines["estimate"])
    stored = {}
    for number, line in enumerate(lines["advance"]):
        target = line.split(" = ")[0].strip()
        if target.startswith("state->"):
            stored[target] = number
    assert len(stored) == len(printed.results[0])
    assert sum(k < 0.9 * len(lines["advance"]) for k in stored.values()) > len(stored) / 2
    found = [match for line in lines["advance"] if (match := pattern.search(line))]
    assert found
    for match in found:
        used = re.compile(rf"    const .* = .*\b{match[1]}\b")
        users = [k for k, other in enumerate(lines["advance"]) if used.search(other)]
        assert max(users, default=0) <= stored[match[2]]


def test_repeated_parts_are_written_once_and_called(tmp_path: Path) -> None:
    """Three members share functions: a third of the text, and every bit of the reference."""
    sizes, steps = {}, {}
    for levels in (1, 3):
        observer = {"method": "censored", "right": [0.0, 2.0], "levels": levels}
        scenario = small("sampled", observer=observer)
        steps[levels] = build_code(exported_step.build_step(resolve_scenario(scenario)), True)
        text = printed_source(steps[levels], Labels("o", "bank", "observer"))
        sizes[levels] = len(text.code)
        calls = re.findall(r"^    o_(part_\d+)\(", text.code, re.M)
        assert set(Counter(calls).values()) == ({3} if levels == 3 else set())
        assert text.operations < sum(count_operations(steps[levels].results).values()) * 1.05
    assert sizes[3] < 1.6 * sizes[1]
    rows = np.random.default_rng(2).normal(size=(300, 2)) * 3
    rows[::7, 0] = np.nan
    compiled = accuracy.CompiledStep(steps[3], tmp_path)
    vectors = selftest_vectors.reference_vectors(steps[3], rows)
    given = selftest_vectors.bit_words(compiled(rows.astype(np.float32)), "float32")
    np.testing.assert_array_equal(given, vectors.outputs)
    memory = compiled.state[: steps[3].step.start.size]
    assert selftest_vectors.bit_checksum(memory, "float32") == vectors.states[-1]


def test_the_fewest_numbers_pass_from_estimate_to_advance() -> None:
    """What out does not need is computed where less has to be carried."""
    nodes = Nodes()
    reading, late = (nodes.intern_input(name, LANES) for name in ("w0", "w1"))
    states = [nodes.intern_input(f"s{k}", LANES) for k in range(3)]
    difference = nodes.intern("add", reading, states[0])
    wide = [nodes.intern("mul", difference, state) for state in states]
    following = [nodes.intern("add", one, late) for one in wide]
    phases = split_phases([following, [difference]], {"w1"})
    assert phases.carried == 1
    assert phases.estimate == [[difference], [difference]]


def test_the_stack_is_the_deepest_chain_of_calls(tmp_path: Path) -> None:
    (tmp_path / "o.c").write_text(
        "static void o_low(void)\n{\n    return;\n}\n\n"
        "static void o_mid(void)\n{\n    o_low();\n}\n\n"
        "void o_step(void)\n{\n    o_mid();\n    o_low();\n}\n"
    )
    frames = (("o_step", 8), ("o_mid.isra.0", 100), ("o_low", 30), ("o_init", 999))
    text = "".join(f"o.c:1:2:{name}\t{size}\tstatic\n" for name, size in frames)
    (tmp_path / "o.su").write_text(text)
    assert compiler.stack_bytes(tmp_path, "o") == 138
    (tmp_path / "o.su").write_text("")
    assert compiler.stack_bytes(tmp_path, "o") is None


def test_a_run_that_diverges_early_is_followed_to_there_without_compiling(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of 100,000 samples the first are enough; the step of a large plant compiles for long."""
    unstable = scene(
        """
        plant.A = [[0.0, 1.0], [1.0, 0.0]]
        plant.B = [[0.0], [1.0]]
        plant.C = [[1.0, 0.0]]
        plant.x0 = [1, 0]
        controller = { method = "pid", k_p = 0.0 }
        """,
        simulation=SLOW | {"step": 0.05, "duration": 1000.0},
    )
    problem = resolve_scenario(unstable)
    step = exported_step.build_step(problem)
    monkeypatch.setattr(scalar_step.cache, "read_cached_block", lambda *_: None)
    monkeypatch.setattr(scalar_step.cache, "load_or_compile", lambda *_: pytest.fail("compiled"))
    rows = selftest_vectors.record_inputs(problem, step)
    assert 250 < len(rows) < 350
    assert 5e5 < np.abs(rows).max() <= selftest_vectors.DIVERGED


def test_a_self_test_has_missing_extreme_small_and_no_readings() -> None:
    """Of two readings beside an input, up to 5 and 0.5 in size along the run."""
    rows = np.column_stack([np.linspace(-5, 4, 500), np.linspace(0.5, 0.2, 500), np.ones(500)])
    chosen = selftest_vectors.choose_samples(rows, 2)
    assert np.isnan(chosen[:, :2]).any(axis=0).all()
    assert not np.isnan(chosen[:, 2]).any()
    for reading in ([15.0, 3.0], [-15.0, -3.0], [0.0, 0.0], [5e-3, 1e-3]):
        assert (np.abs(chosen[:, :2] - reading) < 1e-12).all(axis=1).any(), reading
