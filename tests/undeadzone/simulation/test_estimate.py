"""An observer along a log: as in the run that made it, smoothed exactly, and not to be fooled."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import msgspec
import numpy as np
import pytest

import undeadzone as uz
from commands import undeadzone as command
from requirements import import_package
from scenes import EXACT_SENSOR
from undeadzone.interfaces import require_graph
from undeadzone.scenario.reader import read_for_logs
from undeadzone.simulation.consistency import Consistency
from undeadzone.simulation.estimate import smooth
from undeadzone.simulation.log_diagnosis import what_would_fit
from undeadzone.simulation.online import build_observer
from undeadzone.util.arrays import Floats

PLANT = uz.Plant(second_order=uz.SecondOrder(zeta=0.5, omega_n=4.0, gain=16.0), x0=[1.0, 0.0])
SENSOR = uz.Sensor(right=1.3, left=0.6, noise=0.02)
KALMAN = uz.Kalman(right=[0.0, 2.0], disturbance=0.0)
LOGS_ALONE = """
title = "A load cell"
[plant]
second_order = { zeta = 0.5, omega_n = 4.0, gain = 16.0 }
[sensor]
noise = 0.02
[observer]
method = "kalman"
right = [0.0, 2.0]
disturbance = 0.0
[simulation]
step = 0.01
time = "sampled"
[units]
output = "N"
"""


def scenario(observer: object = KALMAN, **changes: object) -> uz.Scenario:
    parts = {
        "plant": PLANT,
        "sensor": SENSOR,
        "reference": uz.Sines(
            components=[
                uz.Tone(amplitude=3.0, frequency=0.5),
                uz.Tone(amplitude=1.0, frequency=0.2),
            ]
        ),
        "observer": observer,
        "controller": uz.StateFeedback(poles=[-5.0, -6.0]),
        "simulation": uz.Simulation(duration=10.0, time="sampled", step=0.01, seed=3),
    }
    return uz.Scenario(**(parts | changes))


@pytest.fixture(scope="module")
def run() -> uz.Run:
    return uz.simulate(scenario())


@pytest.fixture
def folder(tmp_path: Path, run: uz.Run) -> Path:
    run.save(tmp_path / "run.csv")
    run.save(tmp_path / "run.npz")
    (tmp_path / "log.toml").write_text(LOGS_ALONE)
    return tmp_path


def log(run: uz.Run, header: str = "t,y,u", **columns: np.ndarray) -> str:
    parts = {"t": run.t, "y": run.y[:, 0], "u": run.u[:, 0]} | columns
    rows = zip(*(part.tolist() for part in parts.values()), strict=True)
    return "\n".join([header, *(",".join(map(repr, row)) for row in rows)]) + "\n"


@pytest.mark.parametrize(
    "observer",
    [
        KALMAN,
        uz.Certified(gamma=2.0, width_max=3.0),
        uz.Censored(right=[0.0, 2.0], levels=1, tolerance=0.0),
        uz.ParticleFilter(right=[0.0, 2.0], particles=50),
    ],
)
def test_the_estimates_are_those_of_the_run_that_recorded_the_log(observer: object) -> None:
    recorded = uz.simulate(
        scenario(
            observer, simulation=uz.Simulation(duration=2.0, time="sampled", step=0.01, seed=3)
        )
    )
    result = uz.estimate(scenario(observer), t=recorded.t, y=recorded.y, u=recorded.u)
    np.testing.assert_allclose(result.x_hat, recorded.x_hat, rtol=0, atol=1e-10)
    np.testing.assert_allclose(result.d_hat, recorded.d_hat, rtol=0, atol=1e-10)
    np.testing.assert_array_equal(result.side, recorded.side)


def test_every_source_gives_the_same(run: uz.Run, folder: Path) -> None:
    pandas = import_package("pandas")
    arrays = uz.estimate(scenario(), y=run.y[:, 0], u=run.u[:, 0])
    frame = pandas.DataFrame({"u (V)": run.u[:, 0], "t": run.t, "y": run.y[:, 0]})
    for source in (folder / "run.csv", str(folder / "run.npz"), frame, run.to_pandas()):
        result = uz.estimate(folder / "log.toml", source)
        np.testing.assert_array_equal(result.x_hat, arrays.x_hat)
        assert result.consistent is True
        assert result.info.measured_step == pytest.approx(0.01)


def test_saved_and_loaded_exactly(run: uz.Run, tmp_path: Path) -> None:
    y = run.y.copy()
    y[100:130] = np.nan
    result = uz.estimate(scenario(), t=run.t, y=y, u=run.u)
    assert result.info.missing == 30
    for name in ("estimate.npz", "estimate.csv"):
        again = uz.Estimation.load(result.save(tmp_path / name))
        assert again.info == result.info
        assert again.columns().keys() == result.columns().keys()
        for column, values in result.columns().items():
            np.testing.assert_array_equal(again.columns()[column], values)
    assert result.unit("x_smooth[0]") == "1"
    assert result.to_pandas().shape == (len(run.t), len(result.columns()) - 1)


def test_blocks_are_what_single_samples_are(run: uz.Run) -> None:
    single = uz.Online(KALMAN, PLANT, SENSOR, 0.01)
    blocks = uz.Online(KALMAN, PLANT, SENSOR, 0.01)
    widths = [single.update(y, u).right for y, u in zip(run.y, run.u, strict=True)]
    cuts = (0, 3, 600, len(run.y))
    parts = []
    for start, end in itertools.pairwise(cuts):
        parts.append(blocks.update_many(run.y[start:end], run.u[start:end])[0].right)
    np.testing.assert_array_equal(np.concatenate(parts), widths)
    assert (blocks.samples, blocks.missing) == (single.samples, single.missing)
    np.testing.assert_array_equal(blocks.side, single.side)


def test_the_compiled_step_changes_no_bit(run: uz.Run, monkeypatch: pytest.MonkeyPatch) -> None:
    interpreted = uz.Online(KALMAN, PLANT, SENSOR, 0.01).update_many(run.y, run.u)[0]
    monkeypatch.setattr("undeadzone.compile.interpret.WORTH", 500)
    online = uz.Online(KALMAN, PLANT, SENSOR, 0.01)
    parts = [online.update_many(run.y[:400], run.u[:400])[0]]
    parts.append(online.update_many(run.y[400:], run.u[400:])[0])
    np.testing.assert_array_equal(np.concatenate([part.x for part in parts]), interpreted.x)


def batch(run: uz.Run, model: object, N: int, variance: float) -> np.ndarray:
    """The mean of [x(k); d] for all k by one least-squares problem over the whole log.

    Unknowns: x(0), d_r, d_l, and the input disturbance of each step; the sides are the filter's.
    """
    A, B, C = model.linear
    online = uz.Online(
        msgspec.structs.replace(KALMAN, disturbance=variance**0.5, x_std=10.0, glitches=0.0),
        PLANT,
        SENSOR,
        0.01,
    )
    e = online.update_many(run.y[:N], run.u[:N])[0].innovation[:, 0]
    size = 4 + N  # x(0), d_r, d_l, w
    mean = np.concatenate([np.zeros(2), [1.0, 1.0], np.zeros(N)])
    prior = np.concatenate([np.full(2, 10.0), np.full(2, 2 / 12**0.5), np.full(N, variance**0.5)])
    rows, values = [np.eye(size) / prior[:, None]], [mean / prior]
    to_x, constant = np.zeros((2, size)), np.zeros(2)
    to_x[:, :2] = np.eye(2)
    states = []
    for k in range(N):
        states.append((to_x.copy(), constant.copy()))
        if e[k] != 0:
            row = C[0] @ to_x
            row[2 if run.y[k, 0] > 0 else 3] += -1.0 if run.y[k, 0] > 0 else 1.0
            rows.append(row[None] / 0.02)
            values.append(np.array([(run.y[k, 0] - C[0] @ constant) / 0.02]))
        to_x = A @ to_x
        to_x[:, 4 + k] += B[:, 0]
        constant = A @ constant + B @ run.u[k]
    M, v = np.vstack(rows), np.concatenate(values)
    solution = np.linalg.lstsq(M, v, rcond=None)[0]
    cov = np.linalg.inv(M.T @ M)
    x = np.array([S @ solution + c for S, c in states])
    x_std = np.array([np.sqrt(np.diag(S @ cov @ S.T)) for S, _ in states])
    return np.hstack([x, x_std, np.tile(solution[2:4], (N, 1))])


@pytest.mark.parametrize("disturbance", [0.01, 0.5])
def test_smoothing_is_the_least_squares_of_the_whole_log(run: uz.Run, disturbance: float) -> None:
    options = msgspec.structs.replace(KALMAN, disturbance=disturbance, x_std=10.0, glitches=0.0)
    exact = msgspec.structs.replace(SENSOR, **EXACT_SENSOR)
    model, zone, observer = build_observer(options, PLANT, exact, 0.01, 10)
    N = 250
    smoothed = smooth(model, require_graph(observer), zone, run.y[:N], run.u[:N])
    expected = batch(run, model, N, disturbance**2)
    np.testing.assert_allclose(smoothed["x_smooth"], expected[:, :2], rtol=0, atol=2e-6)
    np.testing.assert_allclose(smoothed["x_smooth_std"], expected[:, 2:4], rtol=1e-3, atol=1e-7)
    np.testing.assert_allclose(smoothed["d_smooth"], expected[:, 4:], rtol=0, atol=2e-6)


def test_a_glitch_is_counted_and_moves_neither_filter_nor_smoother(run: uz.Run) -> None:
    y = run.y.copy()
    y[500] = 40.0
    clean = uz.estimate(scenario(), y=run.y, u=run.u)
    result = uz.estimate(scenario(), y=y, u=run.u)
    assert result.info.glitches == 1
    assert result.consistent
    assert result.z_smooth is not None
    assert clean.z_smooth is not None
    for one, other in ((result.z_hat, clean.z_hat), (result.z_smooth, clean.z_smooth)):
        rms, least = (float(np.sqrt(np.mean((z - run.z) ** 2))) for z in (one, other))
        assert rms <= 1.2 * least + 1e-6


def test_the_test_is_the_recursion_in_blocks() -> None:
    rng = np.random.default_rng(0)
    e = rng.normal(size=400) * (rng.random(400) < 0.7)
    whole, pieces = Consistency(0.01, 0.4), Consistency(0.01, 0.4)
    along = whole.add(e, np.ones(400))
    parts = [pieces.add(part, np.ones(part.size)) for part in np.split(e, [1, 50, 399])]
    np.testing.assert_allclose(np.concatenate(parts), along, rtol=0, atol=1e-14)
    a, b, m, n, B = np.exp(-0.01 / 0.8), np.exp(-0.01 / 3.2), 0.0, 0.0, 1.0
    for value in e:
        m, n = a * m + value, a**2 * n + (value != 0)
        B = b * B + (1 - b) * m**2 / n if n > 1 else B
    assert pytest.approx(B) == whole.B


def test_true_records_are_consistent() -> None:
    verdicts = []
    for seed in range(8):
        simulation = uz.Simulation(duration=10.0, time="sampled", step=0.01, seed=seed)
        run = uz.simulate(scenario(simulation=simulation))
        verdicts.append(uz.estimate(scenario(), y=run.y, u=run.u, smoothing=False).consistent)
    assert verdicts.count(True) >= 7


def wrong(run: uz.Run, change: str) -> tuple[Floats, Floats, uz.Scenario]:
    """Readings and inputs of a run, and a scenario, of which something is not as it was."""
    y, u, looked = run.y, run.u, scenario()
    plant = uz.Plant(second_order=uz.SecondOrder(zeta=0.5, omega_n=4.0, gain=20.0))
    finer = uz.Simulation(duration=1.0, time="sampled", step=0.001)
    return {
        "swapped": (u, y, looked),
        "sign": (-y, u, looked),
        "thousandfold": (1000 * y, u, looked),
        "millivolts": (y, 1000 * u, looked),
        "early": (y[:-10], u[10:], looked),
        "late": (y[5:], u[:-5], looked),
        "gain": (y, u, scenario(plant=plant)),
        "step": (y, u, scenario(simulation=finer)),
    }[change]


@pytest.mark.parametrize("change", ["swapped", "sign", "gain", "step", "thousandfold"])
def test_what_is_wrong_shows(run: uz.Run, change: str) -> None:
    y, u, looked = wrong(run, change)
    result = uz.estimate(looked, y=y, u=u)
    assert result.consistent is False
    assert result.info.reasons
    if change != "step":  # with times it is an error
        return
    with pytest.raises(uz.FileError, match=r"0\.01 s apart.*0\.001"):
        uz.estimate(looked, t=run.t, y=y, u=u)


WOULD_FIT = {
    "swapped": "readings and inputs are exchanged",
    "sign": "the inputs, or the readings, have the other sign",
    "thousandfold": "the readings are in another unit: times 0.001 they fit",
    "millivolts": "the inputs are in another unit: times 0.001 they fit",
    "early": "the inputs act 10 samples later: plant.delay = 10",
    "late": "the inputs act 5 samples earlier: the log has them late",
    "gain": None,
}


@pytest.mark.parametrize("change", WOULD_FIT)
def test_the_change_that_would_fit_is_suggested(run: uz.Run, change: str) -> None:
    y, u, looked = wrong(run, change)
    found = uz.estimate(looked, y=y, u=u, smoothing=False)
    words, expected = what_would_fit(looked, found), WOULD_FIT[change]
    if expected is None:
        assert words is None
    else:
        assert words is not None
        assert words.startswith(expected)


def test_of_a_log_that_fits_nothing_else_does(run: uz.Run) -> None:
    assert what_would_fit(scenario(), uz.estimate(scenario(), y=run.y, u=run.u)) is None
    short = uz.estimate(scenario(), y=run.y[:3], u=run.u[:3])
    assert what_would_fit(scenario(), short) is None


def test_without_a_test_or_readings_consistency_is_undecided(run: uz.Run) -> None:
    certified = uz.estimate(scenario(uz.Certified(gamma=2.0, width_max=3.0)), y=run.y, u=run.u)
    assert certified.consistent is None
    assert "innovation_std" in certified.info.reasons[0]
    still = uz.estimate(scenario(), y=0 * run.y[:60], u=0 * run.u[:60])
    assert still.consistent is None
    assert "0 readings" in still.info.reasons[0]


def test_silence_far_outside_the_zone_is_a_contradiction(run: uz.Run) -> None:
    """A jump sensor followed as a dead zone, and a sensor that gives 0 whatever z does."""
    jump = np.where((run.z > 1.3) | (run.z < -0.6), run.z + 0.01 * np.sin(99 * run.t)[:, None], 0.0)
    for y, u in ((jump, run.u), (0.0 * run.y, 3.0 * run.u)):
        result = uz.estimate(scenario(), t=run.t, y=y, u=u)
        assert result.consistent is False
        assert "although z^ lies far outside" in "; ".join(result.info.reasons)
        assert result.info.silent_outside > 0.05 * result.info.silent[0]
    true = uz.estimate(scenario(), t=run.t, y=run.y, u=run.u)
    assert true.info.silent_outside == 0


def test_wrong_arguments(run: uz.Run, folder: Path) -> None:
    for arguments, words in (
        ({}, "expected a file"),
        ({"y": run.y}, "expected a file"),
        ({"y": run.y, "u": run.u[:-1]}, "as many rows"),
        ({"y": [["a"]], "u": [[0.0]]}, "expected numbers"),
        ({"frame_or_path": folder / "run.csv", "y": run.y}, "found both"),
        ({"frame_or_path": 3}, "found int"),
        ({"frame_or_path": folder / "none.csv"}, "cannot read"),
    ):
        with pytest.raises(uz.InputError, match=words):
            uz.estimate(scenario(), **arguments)
    backwards = scenario(simulation=uz.Simulation(step=-0.01))
    with pytest.raises(uz.InputError, match=r"^simulation\.step: must be greater than 0"):
        uz.estimate(backwards, folder / "run.csv")
    headless = folder / "headless.csv"
    headless.write_text("0,1,2\n0.01,1,2\n")
    with pytest.raises(uz.FileError, match='columns="t=1'):
        uz.estimate(scenario(), headless)
    result = uz.estimate(scenario(), headless, columns="t=1,y=2,u=3")
    assert result.info.samples == 2


def test_a_scenario_for_logs_needs_no_loop(folder: Path) -> None:
    assert read_for_logs(folder / "log.toml").title == "A load cell"
    with pytest.raises(uz.InputError, match="missing"):
        uz.read(folder / "log.toml")
    oracle = (folder / "log.toml").read_text().replace('"kalman"\nright = [0.0, 2.0]', '"oracle"')
    (folder / "oracle.toml").write_text(oracle)
    with pytest.raises(uz.InputError, match=r"sensor\.right"):
        read_for_logs(folder / "oracle.toml")


def test_figure_and_page(run: uz.Run, tmp_path: Path) -> None:
    for observer in (KALMAN, uz.Certified(gamma=2.0, width_max=3.0)):
        y = run.y.copy()
        y[10:20] = np.nan
        result = uz.estimate(scenario(observer), y=y, u=run.u)
        uz.plot(result, tmp_path / "figure.png")
        assert (tmp_path / "figure.png").stat().st_size > 10_000


def test_command_estimate(folder: Path) -> None:
    done = command("estimate", folder / "log.toml", folder / "run.csv", "--out", folder / "out")
    assert done.returncode == 0, done.stderr
    assert "consistent  yes" in done.stdout
    names = {path.name for path in (folder / "out").iterdir()}
    assert names == {"estimate.npz", "estimate.csv", "figure.svg", "report.html"}
    done = command(
        "estimate", folder / "log.toml", folder / "run.csv", "--json", "--no-figures",
        "--columns", "t=t,y=u[0],u=y[0]",
    )  # fmt: skip
    assert done.returncode == 1
    numbers = json.loads(done.stdout)
    assert numbers["consistent"] is False
    assert numbers["would_fit"] == "readings and inputs are exchanged: name their columns"
    words = command(
        "estimate", folder / "log.toml", folder / "run.csv", "--no-figures",
        "--columns", "t=t,y=u[0],u=y[0]",
    )  # fmt: skip
    assert "would fit" in words.stdout
    assert "next" not in words.stdout  # a plant found in exchanged columns is no cure
    assert {"d_right", "d_left", "d_right_std", "d_left_std", "missing", "glitches"} <= set(numbers)


def test_command_watch_ends_with_a_verdict(folder: Path, run: uz.Run) -> None:
    scenario_path = folder / "log.toml"
    plain = command("watch", scenario_path, stdin=log(run))
    assert plain.returncode == 0
    assert "consistent  yes" in plain.stderr
    own = command("watch", scenario_path, stdin=(folder / "run.csv").read_text())
    assert own.stdout == plain.stdout
    assert command("watch", scenario_path, stdin=log(run, "t,u,y")).returncode == 1
    other = command("watch", scenario_path, stdin=log(run, t=2 * run.t))
    assert other.returncode == 2
    assert "0.02 s apart" in other.stderr
    assert len(other.stdout.splitlines()) == 40, "first samples are answered at once"
    units = command("watch", scenario_path, stdin=log(run, "t [s],y [mN],u"))
    assert units.returncode == 2
    assert "'mN'" in units.stderr


def test_command_watch_counts_what_it_cannot_read(folder: Path, run: uz.Run) -> None:
    lines = log(run).splitlines()
    lines[200] = "oops"
    spoilt = "\n".join(lines) + "\n"
    done = command("watch", folder / "log.toml", stdin=spoilt)
    assert done.returncode == 0
    assert f"{len(run.t)} samples, 1 missing (1 in gaps)" in done.stderr
    assert "1 line, counted as missing; line 201: expected 3 values, found 1" in done.stderr
    assert len(done.stdout.splitlines()) == len(run.t) + 1
    strict = command("watch", folder / "log.toml", "--strict", stdin=spoilt)
    assert strict.returncode == 2
    assert "line 201" in strict.stderr
