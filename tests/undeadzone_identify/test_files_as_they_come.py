"""Columns and times of files as they come: a table of headers, and what is read of each."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import openpyxl
import pytest

from requirements import import_package
from undeadzone.errors import FileError
from undeadzone.logs import names
from undeadzone.logs.kinds import kind_of, split_unit
from undeadzone_identify.logs.grid import to_grid
from undeadzone_identify.logs.log import read_log
from undeadzone_identify.logs.prepare import select_readings

RNG = np.random.default_rng(5)
SIZE = 200
HELD = np.repeat(RNG.integers(-9, 10, SIZE // 10), 10).astype(float)  # a command
FOLLOWS = np.convolve(HELD, [0, 0.4, 0.3, 0.2, 0.1])[:SIZE] + 0.05 * RNG.standard_normal(SIZE)
# Columns by a letter: time, command, reading, noise, constant, count, drift, flag, count down.
COLUMNS = {
    "t": 0.02 * np.arange(SIZE),
    "m": 20.0 * np.arange(SIZE),
    "u": HELD,
    "y": FOLLOWS,
    "x": RNG.standard_normal(SIZE),
    "c": np.full(SIZE, 7.0),
    "n": np.arange(SIZE) + 1.0,
    "d": 12.4 - 0.001 * np.arange(SIZE) + 0.01 * RNG.standard_normal(SIZE),
    "-": 2.0 * HELD + 0.3 * RNG.standard_normal(SIZE),
    "i": 0.02 * np.cumsum(FOLLOWS),
    "v": 1.5 + 0.1 * FOLLOWS,
    "f": 1.0 * (FOLLOWS > 0),
    "N": SIZE - np.arange(SIZE),
    "k": np.cumsum(20.0 + (RNG.random(SIZE) < 0.1)),
}
SHAPES = tomllib.loads(Path(__file__).with_name("titles.toml").read_text(encoding="utf-8"))["rows"]


def text_of(header: str, columns: list[np.ndarray]) -> str:
    """Return a CSV text with this header."""
    between = ";" if ";" in header else ","
    rows = (between.join(f"{value:.6g}" for value in row) for row in np.column_stack(columns))
    return "\n".join([header, *rows, ""])


@pytest.mark.parametrize(("header", "does", "u", "y", "kinds"), SHAPES)
def test_columns(header: str, does: str, u: str, y: str, kinds: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(text_of(header, [COLUMNS[one] for one in does]))
    log = read_log(path)
    assert log.has_clock is not {"t", "m"}.isdisjoint(does)
    assert np.allclose(np.diff(log.t), 0.02 if log.has_clock else 1.0)
    assert np.allclose(log.u[:, 0], COLUMNS["u"])
    assert np.allclose(log.y[:, 0], COLUMNS["y"], atol=1e-4)
    assert log.inputs[0] == (u or log.inputs[0])
    assert log.outputs[0] == (y or log.outputs[0])
    if kinds:
        assert [log.input_kinds[0], log.output_kinds[0]] == kinds.split()
    if {u, y} != {"u", "y"}:
        option = log.remarks[0].split('--columns "')[1].split('"')[0]
        again = read_log(path, option)
        assert np.array_equal(again.y, log.y), "the option that is printed reads the same"
        assert np.array_equal(again.u, log.u)
        assert np.array_equal(again.t, log.t)


@pytest.mark.parametrize("factor", [0.5, 2.0])
@pytest.mark.parametrize(
    "name", ["EVEN", "FIRST", "PAST", "RIDGE", "FULL", "COMMON", "BESIDE", "BY_HAND"]
)
def test_constants_at_half_and_double_choose_the_same(
    name: str, factor: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(names, name, factor * getattr(names, name))
    for header, does, u, y, _ in SHAPES:
        titles = [split_unit(cell) for cell in re.split("[,;]", header)]
        values = np.column_stack([COLUMNS[one] for one in does])
        layout = names.layout_of_titles(titles, None, None, {}, "log", values)
        if u and y:
            assert layout.inputs[0] == does.index("u"), header
            assert layout.readings == [does.index("y")], header


ROWS = list(zip(COLUMNS["t"], COLUMNS["u"], COLUMNS["y"], strict=True))


@pytest.mark.parametrize(
    ("lines", "outputs", "words"),
    [
        (["".join(f"{name} 2026-01-01 00:00:{row[0]:05.2f} {x:g}\n"
                  for name, x in zip(("cmd", "pos"), row[1:], strict=True)) for row in ROWS],
         "pos", "u=cmd"),
        (["time_s,topic,value\n", *(f"{t:g},a/cmd,{u:g}\n{t + 0.003:g},a/angle,{y:g}\n"
                                   for t, u, y in ROWS)], "a/angle", "t=time_s,y=a/angle,u=a/cmd"),
        (["[key]; [value]\n", *(f"{k}.Variable; {name}\n{k}.Data;\n"
                                + "".join(f"; {1e3 * row[0]:g}; {row[k]:g}\n" for row in ROWS)
                                for k, name in ((1, "X.cmd"), (2, "X.pos")))], "X.pos", "u=X.cmd"),
        (["t,duty,speed,command\n", *(f"{t:g},{u:g},{y:g},idle\n" for t, u, y in ROWS)],
         "speed", "u=duty"),
        (["t,cmd,speed\ns,%,rpm\n", *(f"{t:g},{u:g},{y:g}\n" for t, u, y in ROWS)],
         "speed", "u=cmd"),
        (["x-axis,1,2\nsecond,Volt,Volt\n", *(f"{t:g},{u:g},{y:g}\n" for t, u, y in ROWS)],
         "2", "t=x-axis,y=2,u=1"),
        (["ready\n", *(f"00:00:{t:06.3f} -> PWM: {u:g}, wheel speed = {y:g} rad/s\n"
                       for t, u, y in ROWS)], "wheel speed", "t=time,y=wheel speed,u=PWM"),
        (["t,note,duty,speed\n", *(f'"{t:.2f}";"a\nb";"{u:.1f}";"{y:.4f}"\n'.replace(".", ",")
                              .replace(";", ",") for t, u, y in ROWS)],
         "speed", "not 'note'"),
        (["Log 2, begun\n" * 40, "t,u,y\n", *(f"{t:g},{u:g},{y:g}\n" for t, u, y in ROWS)],
         "y", "40 lines ahead of the header skipped"),
        (["t,duty,speed,\n", *(f"{t:g},{u:g},{y:g},{u - y:g}\n" for t, u, y in ROWS)],
         "speed", "u=duty"),
    ],
)  # fmt: skip
def test_other_tables(lines: list[str], outputs: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("".join(lines))
    log = read_log(path)
    assert log.outputs == (outputs,)
    assert any(words in remark for remark in log.remarks)
    assert np.allclose(log.u[:, 0], HELD, atol=1e-4)
    assert np.allclose(log.y[:, 0], FOLLOWS, atol=1e-3)
    assert np.allclose(np.diff(log.t), 0.02, atol=1e-6)


def test_even_commands_of_a_table_are_no_times(tmp_path: Path) -> None:
    """They are the command, beside the numbers of rows or a reading in volts."""
    path = tmp_path / "table.csv"
    rows = (f"{2 * k},{0.02 * k * k},{k}\n" for k in range(24))
    path.write_text("distance_mm,south_mV,trial\n" + "".join(rows))
    log = read_log(path)
    assert log.inputs == ("distance_mm",)
    assert not log.has_clock


def test_the_first_sheet_of_a_workbook(tmp_path: Path) -> None:
    book = openpyxl.Workbook()
    for row in (("t", "cmd", "speed"), *ROWS):
        book.worksheets[0].append(row)
    book.create_sheet("figures")
    book.save(path := tmp_path / "log.xlsx")
    assert np.allclose(read_log(path).y[:, 0], FOLLOWS, atol=1e-3)


def test_columns_of_lists_and_dates_in_parquet(tmp_path: Path) -> None:
    arrow = import_package("pyarrow")
    times = np.datetime64("2026-01-01") + (1e9 * COLUMNS["t"]).astype("timedelta64[ns]")
    signals = {"action": HELD, "observation.state": FOLLOWS}
    columns = {name: list(np.column_stack([x, -x])) for name, x in signals.items()}
    path = tmp_path / "log.parquet"
    import_package("pyarrow.parquet").write_table(arrow.table({"time": times, **columns}), path)
    log = read_log(path, "t=time,u=action[1],y=observation.state[1]")
    assert np.allclose(log.u[:, 0], -HELD)
    assert np.allclose(log.t, COLUMNS["t"])
    path.write_bytes(b"no table")
    with pytest.raises(FileError, match="cannot read"):
        read_log(path)


def test_uneven_whole_times_are_milliseconds_and_the_next_pair_is_named(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(text_of("a;b;c;d", [COLUMNS[one] for one in "kuyx"]).partition("\n")[2])
    log = read_log(path)
    assert 0.01 < np.median(np.diff(log.t)) < 0.03
    assert 'read as --columns "t=1,y=3,u=2"; next best: t=1,y=' in log.remarks[0]


def test_times_since_1970_have_the_unit_that_puts_them_after_2001() -> None:
    values = np.column_stack([1.6e18 + 1e6 * COLUMNS["m"], HELD, FOLLOWS])
    titles = [*map(split_unit, "tuy")]
    assert names.layout_of_titles(titles, None, None, {}, "log", values).seconds == 1e-9


def test_where_fewer_than_two_columns_vary_the_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    for header, does in (("t,a", "tu"), ("alone", "u")):
        path.write_text(text_of(header, [COLUMNS[one] for one in does]))
        with pytest.raises(FileError, match="no name shows which column holds"):
            read_log(path)


def test_a_position_is_no_speed_and_a_current_a_torque() -> None:
    for name, unit, kind in (
        *(("current position", "", "position"), ("position", "rpm", "speed")),
        ("present current", "mA", "torque"),
        ("MV", "", "op"),
        *(("target speed", "rpm", "goal"), ("LIC7.SP", "", "sp"), ("x", "", "other")),
    ):
        assert kind_of(name, unit) == kind, name


# --- times

RESTARTED = np.tile(0.02 * np.arange(SIZE // 2), 2)


def shifted(k: int, by: float) -> np.ndarray:
    """Return the times with one that is wrong."""
    t = COLUMNS["t"].copy()
    t[k] += by
    return t


@pytest.mark.parametrize(
    ("t", "samples", "records", "words"),
    [
        (shifted(50, -0.021), SIZE - 1, 1, "1 samples have a missing or wrong time"),
        (shifted(50, 100.0), SIZE - 1, 1, "1 samples have a missing or wrong time"),
        (shifted(50, np.nan), SIZE - 1, 1, "1 samples have a missing or wrong time"),
        (RESTARTED, SIZE, 2, "each session is a record"),
        (COLUMNS["t"] % 0.5, SIZE, -(-SIZE // 25), "each session is a record"),
        (np.floor(COLUMNS["t"] * 10) / 10, SIZE, 1, "spread evenly"),
        (COLUMNS["t"] + 14.0 * (np.arange(SIZE) > 70), SIZE, 2, None),
    ],
)
def test_times(
    t: np.ndarray, samples: int, records: int, words: str | None, tmp_path: Path
) -> None:
    path = tmp_path / "log.csv"
    path.write_text(text_of("t,u,y", [t, HELD, FOLLOWS]))
    log = read_log(path)
    grid = to_grid([log])
    assert log.t.size == samples
    assert grid.start.size == records
    assert grid.ok.sum() == samples
    assert grid.step == pytest.approx(0.02, rel=0.01)
    assert words is None or any(words in remark for remark in log.remarks)
    if words is not None and "session" not in words and "spread" not in words:
        with pytest.raises(FileError, match="time"):
            read_log(path, strict=True)


def test_times_at_random_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(text_of("t,u,y", [np.random.default_rng(0).uniform(size=SIZE), HELD, FOLLOWS]))
    with pytest.raises(FileError, match="time does not increase"):
        read_log(path)


# --- outliers


@pytest.mark.parametrize(
    ("make", "left_out"),
    [
        (lambda y: y.put([700, 2100], [-3e4, 5e4]), 2),  # alone in silence
        (lambda y: y.put([1410], [y[1410] + 4e4]), 1),  # alone on a slope
        (lambda y: y.put([720], [150.0]), 0),  # a passage of an edge
        (lambda y: None, 0),
    ],
)
def test_an_outlier_decides_no_edge(
    make: Callable[[np.ndarray], None], left_out: int, tmp_path: Path
) -> None:
    """A scale with one sign of load, silent below its cut-off."""
    u = np.repeat(np.maximum(np.random.default_rng(1).uniform(-9, 9, 40), 0), 60)
    z = np.convolve(u, np.full(20, 0.05))[: u.size]
    y = np.where(z > 0.8, np.round(4120 * (z - 0.8)), 0.0)
    make(y)
    path = tmp_path / "log.csv"
    path.write_text(text_of("t,u,y", [0.0125 * np.arange(u.size), u, y]))
    grid = to_grid([read_log(path)])
    remarks: list[str] = []
    used = select_readings(grid, remarks)
    spikes = [int(one.split()[0]) for one in remarks if "far from" in one]
    assert sum(spikes) == left_out
    assert (grid.y[used.ok] >= 0).all()
