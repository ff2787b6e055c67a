"""What filters assume of a sensor's shape: exact if told so, wide where edges, slope or time are
off.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from benchmarks.filters import sensor_shapes as shapes
from benchmarks.filters.problems.assumed_worlds import KINDS, problems

import undeadzone as uz
from documents import ROOT
from further import further
from scenes import EXACT_SENSOR, PAPER_PLANT
from undeadzone.interfaces import Estimate
from undeadzone.nonlinearities.sensor import Sensor, deadzone, resolve
from undeadzone.observers.filtering.sensor_shape import resolve_shape
from undeadzone.plants.system import sample_plant
from undeadzone.util.arrays import Floats

DOCS = ROOT / "docs"
TS, COUNT = 0.02, 600
PLANT = uz.Plant(A=[[-2.0]], B=[[2.0]], C=[[1.0]])
WIDTHS = {"right": 1.0, "left": 0.7, "noise": 0.02}
RANGE = [0.3, 2.0]
FILTERS: dict[str, Any] = {
    "auto": uz.Auto(right=RANGE),
    "censored": uz.Censored(right=RANGE, disturbance=0.5, levels=1),
    "kalman": uz.Kalman(right=RANGE),
    "extended": uz.Extended(right=RANGE),
}


def readings(noise: float = 0.02) -> tuple[Floats, Floats]:
    """Readings and inputs of the plant behind an exact sensor."""
    rng, t = np.random.default_rng(0), TS * np.arange(COUNT)
    u = 6 * np.sin(1.3 * t) + 3 * np.sin(3.1 * t + 1)
    keep, x, y = np.exp(-2 * TS), 0.0, np.empty(COUNT)
    for k in range(COUNT):
        y[k] = deadzone(x, 1.0, 0.7) + noise * rng.normal()
        x = keep * x + (1 - keep) * u[k]
    return y, u


def last_numbers(method: str, **sensor_options: Any) -> list[float]:
    """z, d_r, d_l and the deviations of x and of the width after all readings."""
    y, u = readings()
    online = uz.Online(FILTERS[method], PLANT, uz.Sensor(**WIDTHS, **sensor_options), TS)
    last, _ = online.update_many(y[:, None], u[:, None])
    return [
        float(part[-1, 0]) for part in (last.z, last.right, last.left, last.x_std, last.width_std)
    ]


@pytest.mark.parametrize("method", FILTERS)
def test_a_sensor_declared_exact_changes_nothing(method: str) -> None:
    observer = FILTERS[method].build(
        sample_plant(PAPER_PLANT, TS), resolve(Sensor(**WIDTHS, **EXACT_SENSOR), 1, TS)
    )
    assert observer.params.shape is None


def test_edges_are_round_by_default_as_the_page_of_filters_says() -> None:
    """By 7 % of the smaller middle of the ranges, 1.0 and 0.7."""
    prior: Any = SimpleNamespace(ranges=np.array([[0.5, 1.5], [0.2, 1.2]]))
    model = sample_plant(PAPER_PLANT, TS)
    sensor = resolve(Sensor(**WIDTHS), 1, TS)
    found = resolve_shape(sensor, prior, model, learns=False, blind=False)
    assert found.rounding == pytest.approx([0.049])
    assert "7 % of the smaller middle of the ranges" in (DOCS / "filters.md").read_text()
    blind = resolve_shape(sensor, prior, model, learns=False, blind=True)
    assert blind.rounding == [0.0]


@pytest.mark.parametrize("method", FILTERS)
def test_by_default_displayed_deviations_alone_are_wider(method: str) -> None:
    exact = last_numbers(method, **EXACT_SENSOR)
    informed, lost = last_numbers(method, rounding=0.0), last_numbers(method)
    assert informed[:3] == pytest.approx(exact[:3], rel=1e-9)  # slope and delay move no mean
    assert informed[4] > 1.1 * exact[4]
    assert lost[4] > informed[4]
    assert np.abs(np.array(lost[1:3]) - [1.0, 0.7]).max() < 3 * max(lost[4], 0.05)


def follow(options: Any, y: Floats, u: Floats, **sensor_options: Any) -> Estimate:
    """The estimates along readings, of a sensor of which that is told, and no more is doubted."""
    sensor = uz.Sensor(**(WIDTHS | EXACT_SENSOR | sensor_options))
    estimates, _ = uz.Online(options, PLANT, sensor, TS).update_many(y[:, None], u[:, None])
    return estimates


@pytest.mark.parametrize("method", FILTERS)
@pytest.mark.parametrize(("said", "true"), [(0.02, 0.02), (0.02, 0.1), (0.0, 0.02)])
def test_filters_learn_the_noise_of_their_readings(method: str, said: float, true: float) -> None:
    """Their deviations are those of a filter that knows it, even if no noise is declared."""
    y, u = readings(true)
    options = FILTERS[method] if method != "kalman" else uz.Kalman(right=RANGE, disturbance=0.1)
    told, found = (follow(options, y, u, noise=noise) for noise in (true, said))
    assert found.noise[-1, 0] == pytest.approx(true, rel=0.2)
    assert found.width_std[-1, 0] == pytest.approx(told.width_std[-1, 0], rel=0.2)
    assert found.consistent[-1, 0] == 1


@pytest.mark.parametrize("last", [np.nan, 1.0])
def test_missing_readings_and_repeats_are_no_evidence_of_noise(last: float) -> None:
    y, u = readings()
    y[400:] = y[400] * last
    noise = follow(FILTERS["auto"], y, u).noise[401:, 0]
    assert np.ptp(noise) < 1e-3 * noise[0]


@pytest.mark.parametrize(("name", "std", "units"), [("slope_std", 0.1, 0.1), ("lag", 0.04, 2.0)])
def test_the_displayed_deviation_is_how_far_a_mean_would_move(
    name: str, std: float, units: float
) -> None:
    """Against the same filter on the readings of a sensor that is a little other than that."""
    y, u = readings()
    options, small = uz.Kalman(right=RANGE, glitches=0.0), 1e-6
    plain, wide = follow(options, y, u), follow(options, y, u, **{name: std})
    keep, before = np.exp(-2 * TS), np.concatenate([[0.0], plain.z[:-1, 0]])
    ahead = (1 - keep) * (np.concatenate([[0.0], u[:-1]]) - before)
    read = np.abs(y) > 4 * 0.02  # what is silent stays so
    other = y if name == "slope_std" else -ahead
    moved = follow(options, np.where(read, y + small * other, y), u)
    for field in ("right", "left"):
        moves = units * (getattr(moved, field) - getattr(plain, field))[-1, 0] / small
        stds = [getattr(one, f"{field}_std")[-1, 0] for one in (wide, plain)]
        assert np.sqrt(stds[0] ** 2 - stds[1] ** 2) == pytest.approx(abs(moves), rel=0.02)


@pytest.mark.parametrize(
    "name", ["slope 1.1", *further("honest", "edges rounded 0.1", "mean of 3")]
)
@pytest.mark.parametrize("assumptions", ["told", *further("ranges alone")])
def test_intervals_hold_whatever_the_shape_is(name: str, assumptions: str) -> None:
    """Of those that take the sensor for exact few do, but where it is."""
    posed = problems(KINDS["both edges"], 1, 50, 5, ratios=(0.8, 1.25))
    y = shapes.SENSORS[name](np.random.default_rng(3), posed.z, posed.d, posed.noise)
    wide = shapes.solve(assumptions, posed._replace(y=y), {})
    sharp = shapes.solve(assumptions, posed._replace(y=y), shapes.EXACT)
    assert wide.verdict.covered().min() >= 0.84
    assert np.median(wide.rms / sharp.rms) < 1.03
    if name in ("edges rounded 0.1", "slope 1.1"):
        assert sharp.verdict.covered().min() < 0.6


@pytest.mark.parametrize("name", ["2 % repeat", "10 % repeat", "50 % repeat", "stuck for 100"])
def test_repeats_are_missing_and_a_stuck_sensor_is_named(name: str) -> None:
    posed = problems(KINDS["both edges"], 1, 40, 5, ratios=(0.8, 1.25))
    rng = np.random.default_rng(3)
    clean, spoilt = (
        shapes.solve("ranges alone", posed._replace(y=read(rng, posed.z, posed.d, posed.noise)), {})
        for read in (shapes.exact, shapes.SENSORS[name])
    )
    flagged = 1 - spoilt.consistent.mean()
    if name == "stuck for 100":
        assert flagged >= 0.4
        return
    assert flagged <= 0.15
    assert spoilt.verdict.covered().min() >= 0.92
    assert np.median(spoilt.verdict.stds[:, 2] / clean.verdict.stds[:, 2]) < 1.3
    assert np.median(spoilt.rms / clean.rms) < 1.2


def test_a_log_says_that_its_readings_repeat() -> None:
    y, u = readings()
    repeats = y.copy()
    repeats[1::10] = repeats[:-1:10]
    scenario = uz.Scenario(
        plant=PLANT,
        sensor=uz.Sensor(**WIDTHS),
        observer=FILTERS["auto"],
        reference=uz.Sine(amplitude=1.0, frequency=0.3),
        simulation=uz.Simulation(duration=1.0, time="sampled", step=TS),
    )
    remarks, quiet = (
        " ".join(uz.estimate(scenario, y=seen, u=u, smoothing=False).info.remarks)
        for seen in (repeats, y)
    )
    assert "10 % of the readings of output 0 repeat the one before" in remarks
    assert "polls faster" not in quiet
