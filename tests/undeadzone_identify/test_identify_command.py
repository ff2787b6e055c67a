"""Logs as users have them: dialects, units, gaps, columns, damage; the command, what it writes."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner
from scipy.io import savemat
from scipy.signal import lfilter

import undeadzone as uz
from requirements import import_package
from undeadzone.cli import group
from undeadzone.errors import FileError, InputError
from undeadzone.scenario.reader import read
from undeadzone_identify.logs.grid import find_quantum, shorten_log, to_grid
from undeadzone_identify.logs.log import log_from_arrays, read_log

ROWS = np.column_stack([0.5 * np.arange(5), [1, 2, 3, 4, 5.5], [0, 0, -0.25, 1, 2]])


def text_of(rows, separator=",", header="t [s],u [V],y [mm]", decimal="."):
    lines = [header.replace(",", separator)] if header else []
    for row in rows:
        lines.append(separator.join(f"{number:g}".replace(".", decimal) for number in row))
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    "text",
    [
        text_of(ROWS),
        "\ufeff" + text_of(ROWS),
        text_of(ROWS, ";", decimal=","),
        text_of(ROWS, "\t"),
        text_of(ROWS, ";", "time (s);u[0] [V];y (mm)"),
        "# a remark\n\n" + text_of(ROWS) + "\n",
        text_of(ROWS, " ", header="t,u,y"),
        text_of(ROWS, header="t,u,y\n[s],[V],[mm]"),
        text_of(ROWS[:, [2, 0, 1]], header="Y [mm],Time [s],U [V]"),
        text_of(ROWS).replace("\n", "\r\n"),
        text_of(np.column_stack([ROWS, ROWS[:, 1]]), header="t [s],u [V],y [mm],z_true [mm]"),
        text_of(ROWS * [1000, 1, 1], header="t [ms],u,y"),
    ],
)
def test_dialects_of_csv(tmp_path: Path, text: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text(text, encoding="utf-8")
    log = read_log(path)
    assert np.array_equal(np.column_stack([log.t, log.u, log.y]), ROWS)
    if "[mm]" in text or "(mm)" in text:
        assert log.output_units == ("mm",)


def test_other_encodings(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(text_of(ROWS, header="t [s],u [V],y [°]").encode("cp1252"))
    assert read_log(path).output_units == ("°",)
    path.write_bytes(text_of(ROWS).encode("utf-16"))
    assert read_log(path).y[-1] == 2
    path.write_bytes(bytes(range(256)))
    with pytest.raises(FileError, match="not CSV text"):
        read_log(path)


def test_columns_by_name_and_number(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(text_of(ROWS, header="t,first,second"))
    assert "read as --columns" in read_log(path).remarks[0], "what was chosen is said"
    with pytest.raises(FileError, match="Did you mean 'first'"):
        read_log(path, "u=firts,y=second")
    with pytest.raises(FileError, match="used twice"):
        read_log(path, "u=first,y=first")
    log = read_log(path, "u=first,y=3")
    assert log.inputs == ("first",)
    assert np.array_equal(log.y[:, 0], ROWS[:, 2])
    path.write_text(text_of(ROWS, header=""))
    assert "read as --columns" in read_log(path).remarks[0]
    assert np.array_equal(read_log(path, "t=1,u=2,y=3").u[:, 0], ROWS[:, 1])


def test_several_inputs_and_outputs_by_their_numbers(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t,y[1],u[0],u[1],y[0]\n0,1,2,3,4\n1,5,6,7,8\n")
    log = read_log(path)
    assert np.array_equal(log.y, [[4, 1], [8, 5]])
    assert np.array_equal(log.u, [[2, 3], [6, 7]])
    assert log.outputs == ("y[0]", "y[1]")


def test_missing_readings_are_accepted_and_missing_inputs_held(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t,u,y\n0,1,2\n1,2,\n2,3,NaN\n3,4,5\n")
    assert np.isnan(read_log(path).y[:, 0]).tolist() == [False, True, True, False]
    path.write_text("t,u,y\n0,1,2\n1,,3\n2,3,4\n")
    log = read_log(path)
    assert log.u[:, 0].tolist() == [1, 1, 3], "a command lasts until the next one"
    assert "1 inputs are missing" in log.remarks[0]
    with pytest.raises(FileError, match="line 3: input 'u' is missing"):
        read_log(path, strict=True)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no samples"),
        ("t,u,y\n", "no samples"),
        ("t,u,y\n0,1,2\n1,2\n", "line 3: expected 3 values, found 2"),
        ("t,u,y\n0,1,2\n1,x2,3\n", "line 3: expected a number or nothing, found 'x2'"),
        ("t,u,y\n0,1,2\n0,2,3\n", "line 3: time does not increase"),
        ("t [parsec],u,y\n0,1,2\n1,2,3\n", "unit of time"),
        ("1,2\n3,4\n", "without a header"),
        ("t,u,y\n0,1,1e60\n1,2,3\n", "line 2: expected a number or nothing, found '1e60'"),
        ("t,u,y\n0,1,2\nnan,2,3\n", "line 3: the time is missing"),
    ],
)
def test_what_is_wrong_with_a_file(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text(text)
    with pytest.raises(FileError, match=message):
        read_log(path, strict=True)


def test_lines_that_cannot_be_read_count_as_missing(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    rows = text_of(np.column_stack([0.5 * np.arange(8), np.arange(8), ROWS[:, 2][[0] * 8]]))
    lines = rows.splitlines()
    lines[3], lines[6] = "1,x2,3", "2.5,5"
    path.write_text("\n".join(lines))
    log = read_log(path)
    assert log.remarks == (
        f"{path}: 2 lines cannot be read and count as missing; line 4: expected a number or"
        " nothing, found 'x2'",
    )
    grid = to_grid([log])
    assert grid.ok.tolist() == [True, True, False, True, True, False, True, True]
    assert grid.u[:, 0].tolist() == [0, 1, 1, 3, 4, 4, 6, 7]  # held
    assert grid.remarks[0] == log.remarks[0]
    with pytest.raises(FileError, match="line 4: expected a number"):
        read_log(path, strict=True)
    path.write_text("\n".join([*lines[:3], "1,x", "y,2", "oops", *lines[3:5]]))
    with pytest.raises(FileError, match="4 lines of 7 cannot be read; line 4"):
        read_log(path)


def test_a_strict_command_stops_at_the_first_wrong_line(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t,u,y\n0,1,2\n1,x,3\n2,1,2\n")
    result = CliRunner().invoke(group, ["identify", str(path), "--strict"])
    assert isinstance(result.exception, FileError)
    assert "line 3: expected a number" in str(result.exception)


def test_files_of_arrays(tmp_path: Path) -> None:
    t, u, y = ROWS.T
    np.savez(tmp_path / "log.npz", t=t, u=u, y=y)
    savemat(tmp_path / "log.mat", {"t": t, "u": u, "y": y, "name": "x"})
    for name in ("log.npz", "log.mat"):
        log = read_log(tmp_path / name)
        assert np.array_equal(np.column_stack([log.t, log.u, log.y]), ROWS)
    np.savez(tmp_path / "bad.npz", t=np.array([{"a": 1}], dtype=object))
    with pytest.raises(FileError, match="cannot read"):
        read_log(tmp_path / "bad.npz")
    (tmp_path / "bad.mat").write_bytes(b"MATLAB 7.3 MAT-file" + bytes(200))
    with pytest.raises(FileError):
        read_log(tmp_path / "bad.mat")
    with pytest.raises(FileError, match="cannot read"):
        read_log(tmp_path / "none.csv")


def test_a_frame_with_times_of_day() -> None:
    pandas = import_package("pandas")
    times = pandas.to_datetime("2024-01-01") + pandas.to_timedelta(ROWS[:, 0], unit="s")
    log = read_log(pandas.DataFrame({"t": times, "u": ROWS[:, 1], "y": ROWS[:, 2]}))
    assert np.allclose(log.t, ROWS[:, 0])


# --- the grid


def test_gaps_become_missing_readings_and_long_ones_new_records() -> None:
    t = np.array([0, 1, 2, 5, 6, 7, 100, 101, 102.0]) * 0.1
    grid = to_grid([log_from_arrays(t, np.arange(9.0), np.arange(9.0) + 1)])
    assert grid.step == pytest.approx(0.1)
    assert grid.ok.sum() == 9
    assert grid.t.size == 11
    assert grid.start.tolist() == [0, 8]
    assert grid.u[3:5, 0].tolist() == [2.0, 2.0]


def test_printed_times_with_few_digits_are_regular() -> None:
    t = np.round(np.arange(500) / 60, 3)
    grid = to_grid([log_from_arrays(t, np.arange(500.0), np.arange(500.0))])
    assert grid.step == pytest.approx(1 / 60, rel=1e-4)
    assert grid.ok.all()


def test_irregular_readings_are_interpolated_between_near_ones_alone() -> None:
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.5, 1.5, 400))
    t[200:] += 50.0
    log = log_from_arrays(t, np.arange(400.0), np.sin(0.05 * t) + 2.0)
    for grid in (to_grid([log]), to_grid([log], 1.0)):
        assert grid.start.size == 2, "a gap is not bridged"
        assert 0.95 < grid.ok.sum() / 400 < 1.05
        assert np.abs(grid.y - np.sin(0.05 * grid.t) - 2.0)[grid.ok].max() < 0.001
        assert "--resample" in grid.remarks[-1]
    late = to_grid([log_from_arrays(t, np.arange(400.0), np.where(t % 20 < 10, 0.0, 3.0))], 1.0)
    assert np.unique(late.y).tolist() == [0, 3], "nothing lies between silence and a reading"


def test_times_sway_about_a_step_and_one_does_not_fit() -> None:
    rng = np.random.default_rng(0)
    t = np.cumsum(0.01 * (1 + 0.03 * rng.standard_normal(500)))
    t[300:] += 0.025
    grid = to_grid([log_from_arrays(t, t, t)])
    assert grid.ok.all()
    assert grid.start.tolist() == [0, 300]
    assert grid.step == pytest.approx(0.01, rel=0.01)


def test_quantum_and_long_logs() -> None:
    y = np.round(np.random.default_rng(0).standard_normal(4000) / 0.1) * 0.1
    assert find_quantum(y) == pytest.approx(0.1)
    assert find_quantum(np.random.default_rng(0).standard_normal(4000)) == 0.0
    grid = to_grid([log_from_arrays(0.1, np.arange(250000.0), np.arange(250000.0))])
    short = shorten_log(grid)
    assert short.t.size == 100_000
    assert short.start.tolist() == [0, 20_000, 40_000, 60_000, 80_000]
    t = np.cumsum(np.where(np.arange(2400) % 100, 1.0, 50.0))
    assert shorten_log(to_grid([log_from_arrays(t, t, t)])).start.size == 10


# --- the command


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of 800 samples with a zone of 0.5 / 0.3."""
    rng = np.random.default_rng(3)
    u = np.repeat(rng.standard_normal(80), 10)
    z = lfilter([0, 0.05, 0.03], [1, -1.6, 0.68], u) + 0.03 * rng.standard_normal(800)
    y = np.maximum(z - 0.5, 0) + np.minimum(z + 0.3, 0)
    path = tmp_path_factory.mktemp("logs") / "log.csv"
    path.write_text(text_of(np.column_stack([0.05 * np.arange(800), u, y])))
    return path


def test_the_command_writes_a_scenario_that_runs(
    written: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    runner = CliRunner()
    words = ["identify", str(written), "--order", "2", "--place", "sensor"]
    result = runner.invoke(group, words)
    assert result.exception is None, result.output
    for words_of in ("right 0.", "left 0.", "passed", "remedy", "held out", "log.toml"):
        assert words_of in result.output
    answer = json.loads((tmp_path / "log-identify" / "identify.json").read_text())
    assert answer["zone"] is True
    assert answer["verdict"] == "dead_zone"
    for name, truth in (("right", 0.5), ("left", 0.3), ("width", 0.8), ("centre", 0.1)):
        value, low, high = answer[name]
        assert low < value < high
        assert low - 0.01 <= truth <= high + 0.01
    assert {"order", "alternatives", "held_out"} <= answer.keys()
    page = (tmp_path / "log-identify" / "report.html").read_text(encoding="utf-8")
    assert page.count("<img") == 3
    answered = page.index("How it was decided</h2>")
    assert page.index("right 0.") < page.index("odds") < answered < page.index("held out<")
    assert answer["order"] == 2
    problem = read(tmp_path / "log.toml")
    assert problem.simulation.step == 0.05
    assert problem.units.output == "mm"
    run = uz.simulate(problem)
    assert run.divergence_time is None
    assert abs(run.d_hat[-1, 0] - answer["right"][0]) < 0.1
    assert uz.estimate(tmp_path / "log.toml", written).consistent


def test_two_records_become_certified_gains_and_a_run(written: Path, tmp_path: Path) -> None:
    """From two logs of one plant to a scenario, to gains with a proof, to a run with them."""
    rows = np.loadtxt(written, delimiter=",", skiprows=1)
    halves = [tmp_path / "first.csv", tmp_path / "second.csv"]
    for path, part in zip(halves, (rows[:400], rows[400:]), strict=True):
        path.write_text(text_of(part))
    answer = uz.identify([str(path) for path in halves], order=2, place="sensor")
    assert answer.answer.case.grid.start.tolist() == [0, 400]
    (tmp_path / "both.toml").write_text(answer.scenario())
    problem = read(tmp_path / "both.toml")
    proved = uz.design(problem, "rate")
    assert proved.margin > 0
    observer = uz.Certified(L=proved.L, gamma=proved.gamma)
    simulation = msgspec.structs.replace(problem.simulation, duration=20.0)
    run = uz.simulate(msgspec.structs.replace(problem, observer=observer, simulation=simulation))
    assert run.divergence_time is None
    assert abs(run.d_hat[-1] - [answer.right.value, answer.left.value]).max() < 0.1


def test_the_command_says_no_and_bad_input(written: Path, tmp_path: Path) -> None:
    rows = np.loadtxt(written, delimiter=",", skiprows=1)
    z = lfilter([0, 0.05, 0.03], [1, -1.6, 0.68], rows[:, 1])
    rows[:, 2] = z + 0.02 * np.random.default_rng(1).standard_normal(800)
    path = tmp_path / "none.csv"
    path.write_text(text_of(rows))
    runner = CliRunner()
    arguments = ["identify", str(path), "--order", "2", "--out", str(tmp_path / "out")]
    result = runner.invoke(group, [*arguments, "--no-figures"], standalone_mode=False)
    assert result.return_value == 0, "a bound is an answer"
    assert "No dead zone" in result.output
    assert "at most" in result.output
    assert not (tmp_path / "out" / "none.toml").exists()
    with pytest.raises(InputError, match="order"):
        runner.invoke(
            group, [*arguments, "--order", "9"], standalone_mode=False, catch_exceptions=False
        )
