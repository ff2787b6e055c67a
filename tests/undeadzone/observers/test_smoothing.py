"""Looking back: the smoother is that of Rauch, Tung and Striebel, and its intervals hold."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
from benchmarks.filters.glitches import doubting, from_ranges
from benchmarks.filters.smoothing import part
from click.testing import CliRunner
from test_estimate import LOGS_ALONE, scenario

import undeadzone as uz
from further import further
from scenes import EXACT_SENSOR
from undeadzone.cli import group
from undeadzone.interfaces import require_graph
from undeadzone.numerics.adjoint import LaterInformation, smooth_backward
from undeadzone.simulation.estimate import smooth
from undeadzone.simulation.online import build_observer
from undeadzone.util.arrays import Floats

ASSUMPTIONS = {"right": [0.0, 2.0], "disturbance": 0.0, "drift": 0.0, "glitches": 0.0}
PENDULUM = uz.Plant(
    states=["q", "v"],
    inputs=["u"],
    f=["v", "-9.81 * sin(q) - 0.4 * v + 8 * u"],
    h=["q"],
    x0=[0.3, 0.0],
)


def gaussian(rng: np.random.Generator, count: int, size: int) -> Floats:
    """Random covariances (count x size x size)."""
    roots = rng.normal(size=(count, size, size))
    return roots @ np.swapaxes(roots, 1, 2) / size


def moments(rng: np.random.Generator, count: int, size: int) -> Any:
    """Moments of a filter whose beliefs are moved along rows, and at times in any way."""
    slope = 0.3 * rng.normal(size=(count, size, size))
    rows, edges = rng.normal(size=(count, 1, size)), rng.normal(size=(count, 2, size))
    parts: dict[str, list[Any]] = {name: [] for name in ("before", "read", "bounded")}
    mean, P = rng.normal(size=size), gaussian(rng, 1, size)[0]
    for k in range(count):
        parts["before"].append((mean, P))
        for name, along in (("read", rows[k]), ("bounded", edges[k])):
            K = P @ along.T
            weight = 0.5 * np.linalg.inv(along @ K + np.eye(len(along)))
            share = np.ones(size) if k % 3 else rng.uniform(size=size)
            mean = mean + share * (K @ weight @ rng.normal(size=len(along)))
            P = P - share[:, None] * (K @ weight @ K.T) * share
            parts[name].append((mean, P))
        F = np.eye(size) + slope[k]
        mean, P = F @ mean, F @ P @ F.T + 0.1 * np.eye(size)
    beliefs = {}
    for name, known in parts.items():
        means, covs = zip(*known, strict=True)
        beliefs[name] = SimpleNamespace(mean=np.array(means), cov=np.array(covs))
    restarted = np.zeros((count, 1))
    restarted[count // 2] = 1.0
    return SimpleNamespace(**beliefs, rows=rows, edges=edges, slope=slope, restarted=restarted)


def rauch(known: Any) -> tuple[Floats, Floats]:
    """The smoothed means and covariances by their own equations."""
    mean, cov = known.bounded.mean.copy(), known.bounded.cov.copy()
    for k in range(len(mean) - 2, -1, -1):
        if known.restarted[k, 0]:
            continue
        F = np.eye(mean.shape[1]) + known.slope[k]
        gain = cov[k] @ F.T @ np.linalg.inv(known.before.cov[k + 1])
        mean[k] += gain @ (mean[k + 1] - known.before.mean[k + 1])
        cov[k] += gain @ (cov[k + 1] - known.before.cov[k + 1]) @ gain.T
    return mean, cov


def test_adjoints_give_what_rauch_tung_and_striebel_give() -> None:
    known = moments(np.random.default_rng(0), 40, 4)
    mean, cov, _ = smooth_backward(known, LaterInformation.no_information(4))
    for found, expected in zip((mean, cov), rauch(known), strict=True):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8)


def test_where_all_is_linear_and_sure_both_filters_smooth_alike() -> None:
    run = uz.simulate(scenario())
    found = []
    exact = msgspec.structs.replace(scenario().sensor, **EXACT_SENSOR)
    bare = {"bias": 0.0, "tolerance": 0.0, "levels": 1, "silence": False}
    for options in (
        uz.Kalman(**ASSUMPTIONS),
        uz.Censored(**ASSUMPTIONS, **bare),
        uz.Extended(**ASSUMPTIONS),
    ):
        if isinstance(options, uz.Extended):
            options = msgspec.structs.replace(options, silence=False)
        parts = (options, scenario().plant, exact, 0.01, 10)
        model, zone, observer = build_observer(*parts)
        found.append(smooth(model, require_graph(observer), zone, run.y, run.u))
    for other in found[1:]:
        for name, one in found[0].items():
            np.testing.assert_allclose(other[name], one, rtol=0, atol=1e-8)


@pytest.mark.parametrize("method", ["kalman", "censored", "auto", "extended"])
def test_smoothing_ends_where_the_filter_does(method: str) -> None:
    observer = {
        "kalman": uz.Kalman(right=[0.0, 2.0], disturbance=0.2),
        "censored": uz.Censored(right=[0.0, 2.0]),
        "auto": uz.Auto(right=[0.0, 2.0]),
        "extended": uz.Extended(right=[0.0, 2.0], bias=0.0),
    }[method]
    run = uz.simulate(scenario())
    y = run.y.copy()
    y[300:310] = np.nan
    y[500] = 40.0
    found = uz.estimate(scenario(observer=observer), t=run.t, y=y, u=run.u)
    assert found.x_smooth is not None
    assert found.d_smooth is not None
    assert found.x_smooth_std is not None
    np.testing.assert_allclose(found.x_smooth[-1], found.x_hat[-1], rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.d_smooth[-1], found.d_hat[-1], rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.x_smooth_std[-1], found.x_std[-1], rtol=1e-6)
    errors = [np.sqrt(np.mean((x - run.x) ** 2)) for x in (found.x_hat, found.x_smooth)]
    assert errors[1] < 0.5 * errors[0]
    assert (np.abs(found.x_smooth - run.x) < 4 * found.x_smooth_std).all()


SWING = scenario(
    uz.Extended(right=[0.0, 0.5]),
    plant=PENDULUM,
    sensor=uz.Sensor(right=0.2, left=0.1, noise=0.005),
    reference=uz.Sine(amplitude=0.8, frequency=0.4),
    controller=uz.StateFeedback(poles=[-4.0, -5.0]),
)
TWO_OUTPUTS = scenario(
    plant=uz.Plant(
        A=[[0, 1, 0], [-4, -1, 1], [0, 0, -2]],
        B=[[0, 0], [4, 0], [0, 2]],
        C=[[1, 0, 0], [0, 0, 1]],
        x0=[1.0, 0.0, -1.0],
    ),
    sensor=uz.Sensor(right=[0.8, 0.5], left=[0.4, 0.3], noise=0.02),
    reference=uz.Sine(amplitude=[3.0, 2.0], frequency=0.3),
    controller=uz.StateFeedback(poles=[-4.0, -5.0, -6.0]),
)


@pytest.mark.parametrize(("looked", "share"), [(SWING, 0.8), (TWO_OUTPUTS, 0.3)])
def test_plants_are_smoothed(looked: uz.Scenario, share: float) -> None:
    """A nonlinear one, and one of two outputs."""
    run = uz.simulate(looked)
    found = uz.estimate(looked, t=run.t, y=run.y, u=run.u)
    errors = [np.sqrt(np.mean((z - run.z) ** 2)) for z in (found.z_hat, found.z_smooth)]
    assert errors[1] < share * errors[0]
    assert np.mean(np.abs(found.x_smooth - run.x) < 2 * found.x_smooth_std + 1e-9) > 0.9
    true = np.stack([looked.sensor.right, looked.sensor.left], axis=-1).ravel()
    np.testing.assert_allclose(found.d_smooth[0], true, atol=0.02)


def test_readings_that_are_no_numbers_leave_numbers() -> None:
    run = uz.simulate(scenario())
    y = 1e200 * run.y
    found = uz.estimate(scenario(observer=uz.Auto(right=[0.0, 2.0])), t=run.t, y=y, u=run.u)
    for signal in (found.x_smooth, found.z_smooth, found.d_smooth, found.d_smooth_std):
        assert np.isfinite(signal).all()


def test_the_command_smooths_by_default(tmp_path: Path) -> None:
    path, log = tmp_path / "mine.toml", tmp_path / "log.csv"
    path.write_text(LOGS_ALONE.replace('"kalman"', '"censored"'))
    run = uz.simulate(scenario())
    rows = zip(run.t[:50].tolist(), run.y[:50, 0].tolist(), run.u[:50, 0].tolist(), strict=True)
    lines = [f"{t!r},{y!r},{u!r}" for t, y, u in rows]
    log.write_text("\n".join(["t,y,u", *lines]))
    for options, smoothed in (((), True), (("--causal",), False)):
        arguments = ["estimate", str(path), str(log), "--json", "--no-figures", *options]
        result = CliRunner().invoke(group, arguments)
        assert json.loads(result.stdout)["smoothed"] is smoothed


@pytest.mark.parametrize(
    ("assumptions", "kind", "seed"),
    [(doubting, "both edges", 11), *further((from_ranges, "30 % missing", 13))],
)
def test_it_is_better_than_the_filter_and_as_honest(assumptions: Any, kind: str, seed: int) -> None:
    rms, covered = part(assumptions, kind, 2, seed)[::-1]
    assert (rms[:, 1] <= 1.02 * rms[:, 0]).all()
    z, widths = covered[:, :, 0].mean(axis=0), covered[:, :, 1:].mean(axis=(0, 2))
    assert z[2] > 0.93
    assert abs(widths[2] - widths[1]) < 0.05


def test_looking_back_says_how_far_a_mean_would_move_with_the_sensor() -> None:
    """Against the smoother of the readings of a sensor whose slope is a little other."""
    run, small, std = uz.simulate(scenario()), 1e-6, 0.1
    options = uz.Kalman(right=[0.0, 2.0], disturbance=0.0, glitches=0.0)

    def looked_back(y: Floats, **sensor_options: float) -> uz.Estimation:
        sensor = msgspec.structs.replace(scenario().sensor, **(EXACT_SENSOR | sensor_options))
        return uz.estimate(scenario(observer=options, sensor=sensor), t=run.t, y=y, u=run.u)

    plain, wide = looked_back(run.y), looked_back(run.y, slope_std=std)
    read = np.abs(run.y) > 0.08  # what is silent stays so
    moved = looked_back(np.where(read, (1 + small) * run.y, run.y))
    for k in (0, 50, -1):
        gained = np.sqrt(wide.d_smooth_std[k] ** 2 - plain.d_smooth_std[k] ** 2)
        moves = std * np.abs(moved.d_smooth[k] - plain.d_smooth[k]) / small
        np.testing.assert_allclose(gained, moves, rtol=0.01)
        of_x = np.sqrt(wide.x_smooth_std[0] ** 2 - plain.x_smooth_std[0] ** 2)
        np.testing.assert_allclose(
            of_x, std * np.abs(moved.x_smooth[0] - plain.x_smooth[0]) / small, rtol=0.05
        )
