"""FMUs: the binary is loaded and its numbers are those of Online; state, time and refusals."""

from __future__ import annotations

import importlib.util
import subprocess
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from test_engines import OBSERVERS, small

import undeadzone as uz
from requirements import require
from scenes import scene
from undeadzone.errors import InputError
from undeadzone.interfaces import Estimate
from undeadzone.results.signals import quantity_unit
from undeadzone.scenario.schema import Scenario, Units
from undeadzone_export import compiler, exporting
from undeadzone_export.fmu.package import KINDS

if importlib.util.find_spec("fmpy"):
    import fmpy
    from fmpy.fmi2 import FMU2Slave
    from fmpy.fmi3 import FMU3Slave
    from fmpy.validation import validate_fmu

VERSIONS = ("fmu2", "fmu3")
METHODS = ("certified", "extended")
TUNABLE = {"certified": ("observer.gamma",), "extended": ()}
NAMES = {"x_hat": "x", "z_hat": "z", "w_hat": "w", "theta_hat": "theta"}


@pytest.fixture(autouse=True)
def tools() -> None:
    require("fmu", [] if importlib.util.find_spec("fmpy") else ["fmpy"])


def scenario(method: str, **changes: Any) -> Scenario:
    if method == "certified":
        return scene(simulation={"time": "sampled"}, units={"output": "rad"}, **changes)
    return small("sampled", observer={"method": method} | OBSERVERS[method][1])


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The folder of every FMU, named after method and version."""
    folder = tmp_path_factory.mktemp("fmu")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(exporting, "STEPS", 600)
        for method in METHODS:
            for version in VERSIONS:
                out = folder / f"{method}-{version}"
                done = uz.export(
                    scenario(method), version, out, tunable=TUNABLE[method], name="o", check=True
                )
                assert done.has_passed
                assert "every bit agrees" in done.report["self_test"]
        yield folder


class Unit:
    """One instance of an FMU, of either version."""

    def __init__(self, path: Path, start: float = 0.0, **parameters: float) -> None:
        self.description = fmpy.read_model_description(str(path))
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        self.is_2 = self.description.fmiVersion == "2.0"
        settings = {
            "guid": self.description.guid,
            "unzipDirectory": fmpy.extract(str(path)),
            "modelIdentifier": self.description.coSimulation.modelIdentifier,
            "instanceName": "one",
        }
        self.unit = FMU2Slave(**settings) if self.is_2 else FMU3Slave(**settings)
        self.unit.instantiate()
        if self.is_2:
            self.unit.setupExperiment(startTime=start)
            self.unit.enterInitializationMode()
        else:
            self.unit.enterInitializationMode(startTime=start)
        self.set(**parameters)
        self.unit.exitInitializationMode()

    def set(self, **values: float) -> None:
        names = [self.references[name if "[" in name else f"{name}[0]"] for name in values]
        setter = self.unit.setReal if self.is_2 else self.unit.setFloat64
        setter(names, list(values.values()))

    def missing(self, *flags: bool) -> None:
        references = [self.references[f"missing[{k}]"] for k in range(len(flags))]
        self.unit.setBoolean(references, list(flags))

    def get(self, *names: str) -> list[float]:
        references = [self.references[name] for name in names]
        getter = self.unit.getReal if self.is_2 else self.unit.getFloat64
        return list(getter(references))

    @property
    def outputs(self) -> list[str]:
        variables = self.description.modelVariables
        return [v.name for v in variables if v.causality == "output"]

    def step(self, now: float, length: float) -> None:
        self.unit.doStep(currentCommunicationPoint=now, communicationStepSize=length)

    def state(self) -> Any:
        return self.unit.getFMUState()

    def sample(self, k: int, Ts: float, y: float, u: float) -> list[float]:
        self.set(y=y, u=u)
        self.step(k * Ts, Ts)
        return self.get(*self.outputs)


def signals(count: int) -> tuple[Any, Any]:
    """Readings with a dead zone, and inputs."""
    t = np.arange(count)
    z = 3 * np.sin(0.05 * t)
    return np.sign(z) * np.maximum(np.abs(z) - 1, 0), np.cos(0.03 * t)


def online(method: str, **changes: Any) -> uz.Online:
    of = scenario(method, **changes)
    return uz.Online(of.observer, of.plant, of.sensor, of.simulation.step)


def expected(estimate: Estimate, side: Any, names: list[str]) -> list[float]:
    values = []
    for name in names:
        field, entry = name.removesuffix("]").split("[")
        part = side if field == "side" else getattr(estimate, NAMES.get(field, field))
        values.append(float(part[int(entry)]))
    return values


def path_of(built: Path, method: str, version: str) -> Path:
    return built / f"{method}-{version}" / "o.fmu"


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("method", METHODS)
def test_the_binary_gives_the_numbers_of_online(built: Path, method: str, version: str) -> None:
    path = path_of(built, method, version)
    assert validate_fmu(str(path)) == []
    unit, live = Unit(path), online(method)
    Ts = scenario(method).simulation.step
    bar = 0.0 if method == "certified" else 1e-8  # a belief that reopens magnifies
    for k, (y, u) in enumerate(zip(*signals(400), strict=True)):
        unit.missing(k % 50 == 7)
        actual = unit.sample(k, Ts, y, u)
        estimate = live.update(np.nan if k % 50 == 7 else y, u)
        reference = expected(estimate, live.side, unit.outputs)
        assert np.abs(np.subtract(actual, reference)).max() <= bar


def test_simulate_fmu_shows_each_estimate_one_row_later(built: Path) -> None:
    Ts, live = scenario("certified").simulation.step, online("certified")
    y, u = signals(100)
    given = np.zeros(100, dtype=[("time", float), ("y[0]", float), ("u[0]", float)])
    given["time"], given["y[0]"], given["u[0]"] = np.arange(100) * Ts, y, u
    reference = np.array([live.update(a, b).right[0] for a, b in zip(y, u, strict=True)])
    for version in VERSIONS:
        path = str(path_of(built, "certified", version))
        actual = fmpy.simulate_fmu(
            path, stop_time=99 * Ts, output_interval=Ts, input=given, output=["right[0]"]
        )["right[0]"]
        assert (actual[1:] == reference[: len(actual) - 1]).all()


@pytest.mark.parametrize("version", VERSIONS)
def test_states_are_saved_set_and_serialised_in_the_middle_of_a_run(
    built: Path, version: str
) -> None:
    path, Ts = path_of(built, "extended", version), scenario("extended").simulation.step
    unit, other = Unit(path), Unit(path)
    y, u = signals(200)
    for k in range(100):
        unit.sample(k, Ts, y[k], u[k])
    saved = unit.state()
    content = unit.unit.serializeFMUState(saved)
    first = [unit.sample(k, Ts, y[k], u[k]) for k in range(100, 200)]
    unit.unit.setFMUState(saved)
    assert first == [unit.sample(k, Ts, y[k], u[k]) for k in range(100, 200)]
    unit.unit.freeFMUState(saved)
    state = other.unit.deserializeFMUState(content)
    other.unit.setFMUState(state)
    assert first == [other.sample(k, Ts, y[k], u[k]) for k in range(100, 200)]
    for wrong in (content[:-1], b"x" + content[1:]):
        with pytest.raises(Exception, match=r"(?i)error|status"):
            other.unit.deserializeFMUState(wrong)


@pytest.mark.parametrize("version", VERSIONS)
def test_instances_do_not_know_each_other(built: Path, version: str) -> None:
    path, Ts = path_of(built, "certified", version), scenario("certified").simulation.step
    one, two, alone = Unit(path), Unit(path), Unit(path)
    y, u = signals(100)
    for k in range(100):
        mixed = one.sample(k, Ts, y[k], u[k])
        two.sample(k, Ts, -2 * y[k], u[k] + 1)
        assert mixed == alone.sample(k, Ts, y[k], u[k])
    one.unit.reset()
    fresh = Unit(path)
    assert one.get(*one.outputs) == fresh.get(*fresh.outputs)


@pytest.mark.parametrize("version", VERSIONS)
def test_a_jump_of_the_communication_point_is_refused(built: Path, version: str) -> None:
    """A state set goes back; a step that begins elsewhere does not."""
    path, Ts = path_of(built, "certified", version), scenario("certified").simulation.step
    unit = Unit(path)
    unit.sample(0, Ts, 0.1, 0.0)
    for later in (0, 3):
        with pytest.raises(Exception, match=r"(?i)error|status"):
            unit.sample(later, Ts, 0.1, 0.0)
    unit.sample(1, Ts * (1 + 1e-6), 0.1, 0.0)  # importers round


@pytest.mark.parametrize("version", VERSIONS)
def test_tunable_parameters_are_used(built: Path, version: str) -> None:
    path, Ts = path_of(built, "certified", version), scenario("certified").simulation.step
    of = scenario("certified")
    before = online("certified")
    tuned = msgspec.structs.replace(of.observer, gamma=7.0)
    after = uz.Online(tuned, of.plant, of.sensor, Ts)
    unit = Unit(path, observer_gamma=0.007)
    assert unit.get("observer_gamma[0]") == [0.007]
    y, u = signals(300)
    for k in range(300):
        actual = unit.sample(k, Ts, y[k], u[k])
        reference = expected(after.update(y[k], u[k]), after.side, unit.outputs)
        usual = expected(before.update(y[k], u[k]), before.side, unit.outputs)
        assert np.allclose(actual, reference, rtol=0, atol=1e-12)
    assert not np.allclose(actual, usual, rtol=0, atol=1e-6)


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("share", [0.3, 1.0, 2.5, 7.0])
def test_a_step_of_any_length_takes_the_samples_that_are_due(
    built: Path, version: str, share: float
) -> None:
    """Samples are counted: time, summed up with its rounding, takes none twice."""
    Ts, start = scenario("certified").simulation.step, 12.3
    unit, live = Unit(path_of(built, "certified", version), start), online("certified")
    now, sample_count, estimate = start, 0, None
    for step in range(300):
        y, u = 2 * np.sin(0.1 * step), np.cos(0.2 * step)
        unit.set(y=y, u=u)
        unit.step(now, share * Ts)
        while sample_count < (step + 1) * share - 1e-9:
            estimate = live.update(y, u)
            sample_count += 1
        now += share * Ts
        assert estimate is not None
        actual = unit.get("x_hat[0]", "right[0]", "left[0]")
        assert actual == [estimate.x[0], estimate.right[0], estimate.left[0]], step


def test_before_the_first_sample_the_prior_is_the_output(built: Path) -> None:
    for version in VERSIONS:
        unit, live = Unit(path_of(built, "extended", version)), online("extended")
        reference = expected(live.update(np.nan, np.nan), live.side, unit.outputs)
        assert np.allclose(unit.get(*unit.outputs), reference, rtol=0, atol=1e-10)
        assert (np.array(unit.get("right_std[0]")) > 0).all()


@pytest.mark.parametrize("version", VERSIONS)
def test_what_a_model_has_not_is_an_error(built: Path, version: str) -> None:
    unit = Unit(path_of(built, "certified", version))
    for wrong in ({"x_hat": 1.0}, {"observer_gamma": np.nan}, {"observer_gamma": 1e400}):
        with pytest.raises(Exception, match=r"(?i)error|status"):
            unit.set(**wrong)
    unit.references["nothing[0]"] = 99
    with pytest.raises(Exception, match=r"(?i)error|status"):
        unit.get("nothing[0]")
    for length in (np.nan, -1.0, np.inf):
        with pytest.raises(Exception, match=r"(?i)error|status"):
            unit.step(0.0, length)
    unit.set(y=np.nan)  # a reading that is not finite is missing
    unit.step(0.0, 1e-3)
    assert np.isfinite(unit.get(*unit.outputs)).all()


@pytest.mark.parametrize("version", VERSIONS)
def test_an_FMU_with_another_token_is_refused(built: Path, version: str, tmp_path: Path) -> None:
    mixed = tmp_path / "mixed.fmu"
    with zipfile.ZipFile(path_of(built, "certified", version)) as one:
        text = one.read("modelDescription.xml").decode()
        with zipfile.ZipFile(mixed, "w") as two:
            for name in one.namelist():
                two.writestr(name, one.read(name))
    unit = Unit(mixed)
    assert unit.description.guid in text
    settings = {
        "guid": "{other}",
        "unzipDirectory": fmpy.extract(str(mixed)),
        "modelIdentifier": "o",
        "instanceName": "one",
    }
    with pytest.raises(Exception, match="instantiate"):
        (FMU2Slave if version == "fmu2" else FMU3Slave)(**settings).instantiate()


@pytest.mark.parametrize("version", VERSIONS)
def test_the_sources_build_the_same_and_without_a_warning(
    built: Path, version: str, tmp_path: Path
) -> None:
    path = path_of(built, "certified", version)
    with zipfile.ZipFile(path) as archive:
        archive.extractall(tmp_path)
        names = archive.namelist()
    binary = tmp_path / next(name for name in names if name.startswith("binaries/"))
    sources = sorted((tmp_path / "sources").glob("*.c"))
    warnings = ["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Werror"]
    gcc = ["gcc", "-std=c99", "-ffp-contract=off", *warnings, "-fPIC"]
    subprocess.run([*gcc, "-shared", "-o", str(binary), *map(str, sources), "-lm"], check=True)
    rebuilt = tmp_path / "rebuilt.fmu"
    with zipfile.ZipFile(rebuilt, "w") as archive:
        for name in names:
            archive.write(tmp_path / name, name)
    Ts, (y, u) = scenario("certified").simulation.step, signals(60)
    one, two = Unit(path), Unit(rebuilt)
    for k in range(60):
        assert one.sample(k, Ts, y[k], u[k]) == two.sample(k, Ts, y[k], u[k])
    prefixed = f"-DFMI{version[-1]}_FUNCTION_PREFIX=o_"
    glue = str(tmp_path / "sources" / f"fmi{version[-1]}.c")
    subprocess.run([*gcc, prefixed, "-c", "-o", str(tmp_path / "o.o"), glue], check=True)
    symbols = subprocess.run(["nm", "-g", str(tmp_path / "o.o")], capture_output=True, text=True)
    assert f" T o_fmi{version[-1]}DoStep" in symbols.stdout


@pytest.mark.parametrize("version", VERSIONS)
def test_only_functions_of_FMI_are_visible(built: Path, version: str, tmp_path: Path) -> None:
    with zipfile.ZipFile(path_of(built, "certified", version)) as archive:
        name = next(name for name in archive.namelist() if name.startswith("binaries/"))
        archive.extract(name, tmp_path)
    command = ["nm", "-D", "--defined-only", str(tmp_path / name)]
    symbols = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    assert {
        word for word in symbols if "fmi" not in word and len(word) > 1 and word[0] == "o"
    } == set()
    assert f"fmi{version[-1]}DoStep" in symbols


def test_units_names_and_the_controller(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exporting, "STEPS", 600)
    of = scenario("certified")
    for version in VERSIONS:
        uz.export(of, version, tmp_path / version, part="observer+controller", name="o")
        path = str(tmp_path / version / "o.fmu")
        assert validate_fmu(path) == []
        variables = {v.name: v for v in fmpy.read_model_description(path).modelVariables}
        assert {"y[0]", "r[0]", "x_ref[1]", "u_ff[0]", "missing[0]", "u[0]"} <= set(variables)
        assert (variables["u[0]"].causality, variables["r[0]"].causality) == ("output", "input")
        assert (variables["right[0]"].unit, variables["u[0]"].unit) == ("rad", None)
        assert variables["right[0]"].variability == "discrete"


def test_every_quantity_has_a_unit_of_its_kind() -> None:
    """The widths of an actuator had none."""
    units = Units(output="mm", input="V", state=["mm", "mm/s"])
    kinds = {"right": 0, "actuator_right": 0, "x": 1, "w": 1, "theta": 0, "u_ff": 0}
    found_units = [quantity_unit(KINDS[name], k, units) for name, k in kinds.items()]
    assert found_units == ["mm", "V", "mm/s", "mm/s/s", "1", "V"]


@pytest.mark.parametrize("version", VERSIONS)
def test_single_precision_and_titles_of_all_kinds(
    version: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exporting, "STEPS", 600)
    nasty = 'a "<b>" & c*/\n\x00\ufffe\u202e'
    of = msgspec.structs.replace(scenario("certified"), title=nasty, units=uz.Units(output=nasty))
    uz.export(of, version, tmp_path / "fmu", precision="single", name="o")
    path = tmp_path / "fmu" / "o.fmu"
    assert validate_fmu(str(path)) == []
    unit, live, Ts = Unit(path), online("certified"), of.simulation.step
    for k, (y, u) in enumerate(zip(*signals(200), strict=True)):
        actual = unit.sample(k, Ts, y, u)
        reference = expected(live.update(y, u), live.side, unit.outputs)
        assert np.allclose(actual, reference, rtol=0, atol=1e-5)


def test_the_same_scenario_gives_the_same_FMU(
    built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exporting, "STEPS", 600)
    uz.export(
        scenario("certified"), "fmu3", tmp_path / "again", tunable=TUNABLE["certified"], name="o"
    )
    again = (tmp_path / "again" / "o.fmu").read_bytes()
    assert again == path_of(built, "certified", "fmu3").read_bytes()


def test_without_a_compiler_nothing_is_computed_or_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiler, "find_compiler", lambda: None)
    monkeypatch.setattr(exporting, "resolve_scenario", lambda _: pytest.fail("computed"))
    for version in VERSIONS:
        with pytest.raises(InputError, match="no C compiler"):
            uz.export(scenario("certified"), version, tmp_path / "fmu")
    assert list(tmp_path.iterdir()) == []
