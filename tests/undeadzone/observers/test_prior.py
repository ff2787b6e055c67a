"""The centre of a zone is its middle, wherever it stands; what a claim of it does."""

from __future__ import annotations

import functools
import json
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

import once
import undeadzone as uz
from documents import ROOT
from records import dead_zone, second_order
from scenes import PAPER_PLANT, linear, scene, tables_of
from undeadzone.analysis.certificate.design_file import Design
from undeadzone.cli import common
from undeadzone.errors import FileError, InputError
from undeadzone.nonlinearities.sensor import Sensor, resolve
from undeadzone.observers.filtering.augmented_state import white_disturbance_rms
from undeadzone.observers.filtering.prior import Assumptions, _read_branch_ranges, build_prior
from undeadzone.observers.filtering.prior import _read_noise as read_noise
from undeadzone.observers.filtering.unknown_inputs import read_time_span
from undeadzone.plants.build import system
from undeadzone.plants.options import Plant
from undeadzone.plants.system import sample_plant
from undeadzone.results.run import Run
from undeadzone.scenario.reader import convert
from undeadzone.simulation.simulate import simulate
from undeadzone.util.files import SCHEMA
from undeadzone_design.synthesis.check import check

RIGHT, LEFT, CENTRE = 1.0, 0.4, 0.3  # of a zone from -0.4 to 1.0
# What calls a formula a centre, or the other way round.
FORMULA = re.compile(r"\(?\b([dcb])_r\^? [-−] \1_l\b\^?\)?( ?/ ?2)?")
TEXTS = ("README.md", "KNOWN_GAPS.md", "docs", "examples", "src", "benchmarks")
BOTH = "(c_r - c_l + d_r - d_l)/2"  # the sum of two centres
# Where the earlier meaning is told of.
EARLIER = {"docs/versions.md", "src/undeadzone/scenario/schema.py"}
MOTOR = tables_of("""
A = [[0.0, 1.0], [0.0, -10.0]]
B = [[0.0], [50.0]]
C = [[1.0, 0.0]]
""")
MODEL = sample_plant(system(Plant(**MOTOR, x0=[0.0, 0.0])), 0.01)


def motor(**observer: Any) -> Any:
    return scene(
        """
        sensor = { right = 0.12, left = 0.12, noise = 0.002 }
        reference = { kind = "sine", amplitude = 1.5, frequency = 0.5 }
        controller = { method = "state_feedback" }
        simulation = { time = "sampled", step = 0.01, duration = 8.0 }
        """,
        schema=SCHEMA,
        plant=MOTOR | {"x0": [0.3, 0.0]},
        observer={"method": "kalman", "right": [0.0, 0.5]} | observer,
    )


def known(run: Run) -> tuple[bool, bool]:
    (verdict,) = run.info.identifiable
    return verdict["width"], verdict["right"] and verdict["left"] and verdict["centre"]


@pytest.mark.parametrize("centre", [0.0, [-0.1, 0.1], [[0.05, 0.2]]])
def test_the_prior_is_that_of_ranges_given_the_centre(centre: Any) -> None:
    """Of many draws from the ranges as Gaussians, weighed by the claim on (d_r - d_l)/2."""
    where = resolve(Sensor(right=0.1, left=0.1, noise=0.01), 1, 0.01)
    ranges = {"right": [0.2, 1.0], "left": [0.0, 0.6]}
    prior = build_prior(Assumptions(**ranges, x_std=1.0, drift=0.0), MODEL, where, centre=centre)
    mean, cov = prior.width_moments()
    low, high = np.broadcast_to(np.ravel(centre), 2)
    spread = max((high - low) / np.sqrt(12), 0.01)
    rng = np.random.default_rng(0)
    drawn = rng.normal([0.6, 0.3], np.array([0.8, 0.6]) / np.sqrt(12), (400_000, 2))
    off = ((drawn[:, 0] - drawn[:, 1]) / 2 - (low + high) / 2) / spread
    weight = np.exp(-(off**2) / 2)
    np.testing.assert_allclose(mean, np.average(drawn, axis=0, weights=weight), atol=5e-3)
    expected = np.cov(drawn.T, aweights=weight)
    np.testing.assert_allclose(cov, expected, atol=2e-3)
    if high == low:
        assert abs(cov[0, 0] - cov[0, 1]) < 1e-12  # d_r - d_l has no spread


@pytest.mark.parametrize("method", ["kalman", "censored", "auto", "extended"])
def test_with_a_declared_centre_both_edges_of_an_integrator_become_known(method: str) -> None:
    run = simulate(motor(method=method, centre=0.0))
    assert known(run) == (True, True)
    assert run.info.identifiable[0]["reasons"][-1].endswith("from the declared centre alone")
    np.testing.assert_allclose(run.widths, 0.12, atol=0.01)
    assert run.rms_estimation < 0.01


def test_an_undeclared_centre_of_an_integrator_stays_unknown() -> None:
    assert known(simulate(motor())) == (True, False)
    assert "observer.centre" in check(motor()).cures[0]
    assert check(motor(centre=0.0)).cures == ()


def test_a_vague_centre_is_known_as_well_as_it_is_declared() -> None:
    run = simulate(motor(centre=[-0.05, 0.05]))
    assert known(run) == (True, True)
    deviation = run.info.identifiable[0]["std"]["centre"]
    assert deviation == pytest.approx(0.1 / np.sqrt(12), rel=1e-3)
    assert known(simulate(motor(centre=[-0.225, 0.225]))) == (True, False)  # wider than the zone


@pytest.mark.parametrize(("x_std", "tells"), [([0.01, 0.1], True), ([1.0, 1.0], False)])
def test_homing_tells_the_centre_of_a_linear_plant(x_std: list[float], tells: bool) -> None:
    """A known start counts, a vague one does not; its deviation is that of the position."""
    run = simulate(motor(x_std=x_std))
    assert known(run) == (True, tells)
    if tells:
        verdict = run.info.identifiable[0]
        assert verdict["std"]["centre"] == pytest.approx(x_std[0], rel=0.05)
        assert verdict["reasons"][-1].endswith("from the declared start alone")


# --- One word, one meaning


@functools.cache
def identified() -> Any:
    """What `identify` makes of a log behind a zone from -0.4 to 1.0."""
    rng = np.random.default_rng(0)
    u = np.repeat(rng.standard_normal(150), 10)
    z = second_order(u) + 0.01 * rng.standard_normal(1500)
    y = dead_zone(z, RIGHT, LEFT)
    return uz.identify(t=0.05, u=u, y=y, order=2, delay=0)


def test_identify_gives_the_middle_in_python_and_in_json() -> None:
    found = identified()
    assert found.verdict == "dead_zone"
    assert found.centre.value == pytest.approx(CENTRE, abs=0.01)
    assert found.centre.value == pytest.approx(
        (found.right.value - found.left.value) / 2, rel=1e-12
    )
    assert json.loads(json.dumps(found.numbers()))["centre"] == list(found.centre)


def test_gears_have_the_same_centre_as_the_zone_that_they_are() -> None:
    text = (ROOT / "examples/two_link_gears.toml").read_text(encoding="utf-8")
    tables = tomllib.loads(text)
    tables["plant"]["arm"]["gears"] |= {"half": (RIGHT + LEFT) / 2, "centre": CENTRE}
    plant = system(convert(tables).plant)
    assert plant.gears is not None
    right, left = (np.asarray(each).ravel() for each in plant.gears.gap_widths(plant.params))
    np.testing.assert_allclose(right, RIGHT)
    np.testing.assert_allclose(left, LEFT)


def test_a_declared_centre_is_the_middle_of_the_zone_that_filters_begin_with() -> None:
    where = resolve(Sensor(right=RIGHT, left=LEFT, noise=0.01), 1, 0.01)
    ranges = Assumptions(right=[0.0, 2.0], left=[0.0, 2.0], x_std=1.0, drift=0.0)
    (right, left), _ = build_prior(ranges, MODEL, where, centre=CENTRE).width_moments()
    assert (right - left) / 2 == pytest.approx(CENTRE, rel=1e-12)


def formulas() -> Iterator[tuple[str, str]]:
    """Each formula of a difference that stands in a line with the word centre, and where."""
    for name in TEXTS:
        path = ROOT / name
        files = [path] if path.is_file() else path.rglob("*")
        for file in files:
            where = file.relative_to(ROOT).as_posix()
            if file.suffix not in (".md", ".py", ".toml", ".js", ".jinja", ".h", ".c", ".html"):
                continue
            if where in EARLIER or file.name == "live.html":
                continue
            text = file.read_text(encoding="utf-8").replace(BOTH, "")
            for line in text.splitlines():
                if re.search(r"\bcentres?\b", line, re.IGNORECASE):
                    yield from ((where, each.group()) for each in FORMULA.finditer(line))


def test_wherever_a_formula_is_called_centre_it_is_the_middle() -> None:
    found = list(formulas())
    assert {"docs/notation.md", "docs/json.md", "docs/scenario.md"} <= {where for where, _ in found}
    for where, formula in found:
        words = re.sub(r"[dcb]_r\^?", str(RIGHT), formula.replace("−", "-"))
        words = re.sub(r"[dcb]_l\^?", str(LEFT), words)
        assert eval(words) == pytest.approx(CENTRE), f"{where}: {formula}"


def test_no_exported_signal_is_called_centre() -> None:
    """They have right and left; a reader takes half of the difference."""
    names = uz.Estimate._fields
    assert {"right", "left"} <= set(names)
    assert not [name for name in names if "centre" in name]
    for path in (ROOT / "src/undeadzone_export").rglob("*.*"):
        if path.suffix != ".pyc":
            assert "centre" not in path.read_text(encoding="utf-8"), path


# --- Files of an earlier schema


def claiming(centre: Any, **top: Any) -> dict[str, Any]:
    """The tables of a scenario with a claimed centre."""
    text = (ROOT / "examples/motor_position.toml").read_text(encoding="utf-8")
    data = top | tomllib.loads(text)
    data["observer"]["centre"] = centre
    return data


@pytest.mark.parametrize("schema", [1, 2, 4])
def test_another_schema_is_refused(schema: int, tmp_path: Path) -> None:
    """Up to 2 a centre was d_r - d_l."""
    with pytest.raises(InputError, match=f"schema: expected 3, found {schema}. Up to schema 2"):
        convert(claiming(0.1, schema=schema))
    assert convert(claiming([-0.1, 0.3])).observer.centre.tolist() == [-0.1, 0.3]
    run = simulate(motor(centre=[-0.05, 0.05]))
    info = msgspec.structs.replace(run.info, schema=schema)
    for suffix in ("npz", "csv"):
        old = Run(info, run.signals).save(tmp_path / f"run.{suffix}")
        with pytest.raises(FileError, match=f"{suffix}: expected schema = 3, found {schema}"):
            Run.load(old)
    designed = msgspec.structs.replace(once.design(scene(), "rate"), schema=schema)
    with pytest.raises(FileError, match=f"expected schema = 3, found {schema}"):
        Design.load(designed.save(tmp_path / "design.toml"))


def test_files_and_json_count_their_schemas_alike() -> None:
    assert SCHEMA == common.SCHEMA == 3


@pytest.mark.parametrize(("noise", "rms"), [(0.0, 3e-3), (1e-4, 1e-4)])
def test_a_range_sets_the_noise_of_an_exact_sensor_alone(noise: float, rms: float) -> None:
    """The wider range: that of an edge which does not exist hid a declared noise."""
    model = sample_plant(PAPER_PLANT, 0.01)
    sensor = resolve(Sensor(right=0.5, left=0.5, noise=noise), 1, 0.01)
    for right, left in (([0.0, 1.0], [0.0, 3.0]), ([0.0, 3.0], [0.0, 1.0])):
        prior = build_prior(Assumptions(right=right, left=left), model, sensor)
        np.testing.assert_allclose(prior.R, rms**2)


def test_one_output_without_noise_is_refused() -> None:
    assert read_noise([0.1, 0.2], 2).tolist() == [0.1, 0.2]
    with pytest.raises(InputError, match="must be positive, found 0"):
        read_noise([0.1, 0.0], 2)


def test_a_time_is_resolved_from_a_tenth_of_a_sample_on() -> None:
    for time in (0.101, 0.99e6):
        assert read_time_span("correlation", time * 0.02, 0.02) == time * 0.02
    for time in (0.099, 1.01e6):
        with pytest.raises(InputError, match=r"between 0\.1 and 1e6 sample times"):
            read_time_span("correlation", time * 0.02, 0.02)


def test_the_default_disturbance_is_that_of_the_output_that_it_moves_most() -> None:
    both = []
    for C in ([[1.0, 0.0], [0.0, 0.1]], [[2.0, 0.0], [0.0, 0.1]], [[1.0, 0.0], [0.0, 0.05]]):
        plant = linear([[-1.0, 0.0], [0.0, -1.0]], [[1.0], [1.0]], C)
        both.append(float(white_disturbance_rms(sample_plant(plant, 0.01), 1.0)[0]))
    assert both[1] == pytest.approx(both[0] / 2)
    assert both[2] == pytest.approx(both[0])


def test_a_range_below_0_of_one_output_is_refused() -> None:
    with pytest.raises(InputError, match="0 <= lo < hi"):
        _read_branch_ranges("observer.right", [[-0.5, 1.0], [0.0, 1.0]], 2)
