"""Every target of an export has the numbers of `Online`: orders to 20, two outputs, contacts.

The Python module and the FMUs are run beside `Online`, Structured Text beside the C, the page
beside the run that it shows. C and the Arduino library run their self-test, bit by bit.
"""

from __future__ import annotations

import functools
import importlib.util
import random
import subprocess
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final
from unittest.mock import patch

import numpy as np
from tests.browser import Browser, browser
from tests.undeadzone.compile.test_engines import OBSERVERS, TWO_OUTPUTS
from tests.undeadzone.observers.test_contact import SERVO
from tests.undeadzone_export import test_exporting as arduino
from tests.undeadzone_export import test_fmu as fmu
from tests.undeadzone_export import test_page as page
from tests.undeadzone_export import test_plc as plc

import undeadzone as uz
from tools.fuzz.case import Case
from tools.fuzz.valid import Table, scenario
from undeadzone.results.run import Run
from undeadzone.scenario.problem import plant_of_model, resolve_scenario, sensor_of_model
from undeadzone.scenario.reader import convert
from undeadzone.scenario.schema import Scenario
from undeadzone_export import exported_step, exporting
from undeadzone_export.selftest_vectors import record_inputs

CLOSE: Final = 1e-6  # of the size of a signal: elementary functions differ in the last bits
STEPS: Final = 300  # of each comparison
LARGE: Final = ("kalman", "censored", "auto", "extended", "luenberger", "certified", "ekf")


def case(draw: random.Random) -> Case:
    """A scenario, and the target that it is exported to."""
    name, make = draw.choice(list(SCENARIOS.items()))
    tables = make(draw)
    target = draw.choice(list(TARGETS))
    kind = f"{name}, {tables['observer']['method']}, {target}"
    return Case(kind, {}, call=functools.partial(_compared, tables, target))


def _contact(draw: random.Random) -> Table:
    """A servo behind gears with the filter of contacts."""
    tables = tomllib.loads(SERVO)
    tables["observer"]["starts"] = draw.choice((1, 1, 3))
    tables["plant"]["arm"]["gears"]["half"] = draw.uniform(0.01, 0.06)
    return tables


def _two_outputs(draw: random.Random) -> Table:
    """Two outputs, of which `auto` hears both."""
    right = [draw.uniform(0.1, 0.4), draw.uniform(0.5, 1.5)]
    poles = {"method": "state_feedback", "poles": [-5.0, -6.0]}
    return _loop(dict(TWO_OUTPUTS), {"method": "auto", "right": right}) | {"controller": poles}


def _large(draw: random.Random) -> Table:
    """A chain of lags of order 12 or 20, all of which act on the output."""
    order = draw.choice((12, 20))
    rates = [draw.uniform(0.5, 8.0) for _ in range(order)]
    A = [[0.0] * order for _ in range(order)]
    for i, rate in enumerate(rates):
        A[i][i] = -rate
        if i:
            A[i][i - 1] = 0.5 * rate
    C = [[2.0 ** -(order - 1 - i) if i else 1.0 for i in range(order)]]
    plant = {"A": A, "B": [[1.0]] + [[0.0]] * (order - 1), "C": C}
    method = draw.choice(LARGE)
    options = {"method": method} | OBSERVERS[method][1]
    options.pop("L", None)  # of one state
    return _loop(plant, options)


def _loop(plant: Table, observer: Table) -> Table:
    """A loop of these two."""
    return {
        "plant": plant,
        "sensor": {"right": 0.3, "left": 0.2, "noise": 0.01},
        "reference": {"kind": "sine", "amplitude": 1.0, "frequency": 0.5},
        "observer": observer,
        "controller": {"method": "lqr"},
        "simulation": {"duration": 3.0, "step": 0.01, "time": "sampled"},
    }


def _small(draw: random.Random) -> Table:
    """A sampled scenario of any kind."""
    tables = scenario(draw, in_python=False)
    tables["simulation"] = {"duration": 3.0, "step": 0.01, "time": "sampled"}
    return tables


SCENARIOS: Final[dict[str, Callable[[random.Random], Table]]] = {
    "small": _small,
    "two outputs": _two_outputs,
    "large": _large,
    "contact": _contact,
}


def _compared(tables: Table, target: str, folder: Path) -> None:
    """Export a scenario and compare what comes out."""
    tables["simulation"]["duration"] = STEPS * tables["simulation"]["step"]
    with patch.object(exporting, "STEPS", STEPS):
        TARGETS[target](convert(tables), folder / "out")


def _samples(of: Scenario) -> Iterator[tuple[Any, Any, Any, Any]]:
    """Readings, inputs, the estimate of `Online` and its side along a run with missing readings."""
    problem = resolve_scenario(of)
    rows = record_inputs(problem, exported_step.build_step(problem))
    step, substeps = of.simulation.step, of.simulation.substeps
    online = uz.Online(of.observer, plant_of_model(of), sensor_of_model(of), step, substeps)
    readings = online.model.p
    rows[7::50, 0] = np.nan
    for row in rows[:STEPS]:
        y, u = row[:readings], row[readings:]
        yield y, u, online.update(y, u), online.side


def _require_close(shown: Any, wanted: Any, of: str) -> None:
    """Raise an AssertionError unless two tables (samples x numbers) agree."""
    shown, wanted = np.asarray(shown, float), np.asarray(wanted, float)
    assert shown.shape == wanted.shape, f"{of}: {shown.shape} in place of {wanted.shape}"
    size = np.maximum(np.nanmax(np.abs(wanted), axis=0, initial=0.0), 1e-30)
    assert np.array_equal(np.isnan(shown), np.isnan(wanted)), f"{of}: NaN differ"
    far = float(np.nanmax(np.abs(shown - wanted) / size, initial=0.0))
    assert far < CLOSE, f"{of}: differs by {far:.1e}"


def _python(of: Scenario, out: Path) -> None:
    """The module that compiles the C."""
    uz.export(of, "python", out, name="o")
    spec = importlib.util.spec_from_file_location("o", out / "o.py")
    assert spec is not None
    assert spec.loader is not None
    module: Any = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    one = module.Instance()
    shown, wanted = [], []
    for y, u, estimate, side in _samples(of):
        given = {"y": y, "u": u}
        told = one.update(*[given[name] for name, _ in module.INPUTS])
        shown.append(np.concatenate(told))
        values = estimate._asdict() | {"side": side}
        wanted.append(np.concatenate([np.ravel(values[fmu.NAMES.get(n, n)]) for n in told._fields]))
    _require_close(shown, wanted, "module")


def _fmu(version: str) -> Callable[[Scenario, Path], None]:
    """An FMU of a version."""

    def compared(of: Scenario, out: Path) -> None:
        uz.export(of, version, out, name="o")
        unit, step = fmu.Unit(out / "o.fmu"), of.simulation.step
        shown, wanted = [], []
        for k, (y, u, estimate, side) in enumerate(_samples(of)):
            missing = np.isnan(y).tolist()
            unit.missing(*missing)
            unit.set(**{f"y[{i}]": 0.0 if missing[i] else v for i, v in enumerate(y)})
            unit.set(**{f"u[{i}]": v for i, v in enumerate(u) if f"u[{i}]" in unit.references})
            unit.step(k * step, step)
            shown.append(unit.get(*unit.outputs))
            wanted.append(fmu.expected(estimate, side, unit.outputs))
        _require_close(shown, wanted, "FMU")

    return compared


def _st(of: Scenario, out: Path) -> None:
    """Structured Text, whose bits are those of the C."""
    out.mkdir()
    each = plc.print_export(of, True)
    problem = resolve_scenario(of)
    rows = plc.corrupted(record_inputs(problem, each.code.step), 3)
    plc.assert_same_bits(plc.by_reader(each, rows, out), plc.by_c(each, rows, out))


def _c(precision: str) -> Callable[[Scenario, Path], None]:
    """C, whose self-test compares every bit."""

    def compared(of: Scenario, out: Path) -> None:
        done = uz.export(of, "c", out, precision=precision, check=True)
        assert "every bit agrees" in done.report["self_test"], done.report["self_test"]
        if precision == "double":
            assert done.has_passed, done.report["refusals"]

    return compared


def _arduino(of: Scenario, out: Path) -> None:
    """The Arduino library and its sketch, which runs the self-test."""
    uz.export(of, "arduino", out, name="o")
    test = out / "examples" / "o_test"
    sketch = out / "sketch.cpp"
    sketch.write_text(arduino.ARDUINO + (test / "o_test.ino").read_text() + arduino.PORT)
    include = ["-I", str(out / "src")]
    for source in (out / "src" / "o.c", test / "o_test.c"):
        command = ["gcc", *arduino.FLAGS, "-DARDUINO=1", *include, "-c", str(source)]
        subprocess.run(command, check=True, cwd=out)
    words = ["g++", *include, "-o", "p", "sketch.cpp", "o.o", "o_test.o"]
    subprocess.run(words, check=True, cwd=out)
    said = subprocess.run([out / "p"], capture_output=True, text=True, check=True).stdout
    assert "o_test: every bit agrees" in said.splitlines(), said[-300:]


def _page(of: Scenario, out: Path) -> None:
    """The page, in which the loop runs."""
    out.mkdir()
    if browser() is None:
        return
    with Browser(out) as opened:
        page.open_page(opened, of, out)
        run = uz.simulate(of)
        assert isinstance(run, Run)
        assert page.largest_gap(opened, run) < CLOSE


TARGETS: Final[dict[str, Callable[[Scenario, Path], None]]] = {
    "c in float": _c("single"),
    "c in double": _c("double"),
    "python": _python,
    "fmu2": _fmu("fmu2"),
    "fmu3": _fmu("fmu3"),
    "st": _st,
    "arduino": _arduino,
    "page": _page,
}
