"""Logs as they come: dialects, columns by name, steps and gaps; nothing is guessed in silence."""

from __future__ import annotations

import codecs
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest

from undeadzone.errors import FileError, InputError
from undeadzone.logs.kinds import is_regular_time, split_unit
from undeadzone.logs.names import (
    Layout,
    layout_of_titles,
    parse_columns,
)
from undeadzone.logs.samples import (
    LogReader,
    Samples,
    place_on_steps,
    samples_of_text,
)
from undeadzone.logs.stamps import stamps_of
from undeadzone.logs.text import Text, blocks_of, dialect_of


def titles(text: str) -> list:
    return [split_unit(part) for part in text.split(",")]


@pytest.mark.parametrize(
    ("text", "name", "unit"),
    [
        ("speed [rad/s]", "speed", "rad/s"),
        ("speed (rad/s)", "speed", "rad/s"),
        ("u[0]", "u[0]", ""),
        ("u[0] [1]", "u[0]", "1"),
        ("y [1]", "y", "1"),
        ("target pos (1)", "target pos (1)", ""),
        (' "t [ms]" ', "t", "ms"),
        ("y", "y", ""),
    ],
)
def test_units_in_brackets(text: str, name: str, unit: str) -> None:
    assert split_unit(text) == (name, unit)


@pytest.mark.parametrize(
    ("header", "p", "m", "columns"),
    [
        ("t,y,u", 1, 1, [0, 1, 2]),
        ("t,u,y", 1, 1, [0, 2, 1]),
        ("Time,INPUT,Output", 1, 1, [0, 2, 1]),
        ("u,z,y", 1, 1, [2, 0]),
        ("t,x[0],z[0],y[0],side[0],u[0]", 1, 1, [0, 3, 5]),
        ("t,y[1],y[0],u", 2, 1, [0, 2, 1, 3]),
        ("t,u1,u2,y", 1, 2, [0, 3, 1, 2]),
    ],
)
def test_usual_names(header: str, p: int, m: int, columns: list[int]) -> None:
    assert layout_of_titles(titles(header), p, m, {}, "log").columns == columns


@pytest.mark.parametrize(
    ("header", "columns", "words"),
    [
        ("time,first,second", None, "'first', 'second'"),
        ("t,yy,u", None, "Did you mean 'yy'"),
        ("t,y,y,u", None, "the log has 2"),
        ("t,y[0],y[1],u", None, "the log has 2"),
        ("t,angle,u", "y=angel", "Did you mean 'angle'"),
        ("t,angle,u", "y=u,u=u", "used twice"),
        ("t [days],y,u", None, "'days'"),
    ],
)
def test_names_that_do_not_tell_are_refused(header: str, columns: str | None, words: str) -> None:
    with pytest.raises(FileError, match=re.escape(words)):
        layout_of_titles(titles(header), 1, 1, parse_columns(columns), "log")


def test_columns_by_name_and_number() -> None:
    chosen = parse_columns("y=angle, u=2,t=time")
    assert layout_of_titles(titles("time,volt,angle"), 1, 1, chosen, "log").columns == [0, 2, 1]
    for wrong in ("y", "y=", "z=3", "y=1,y[0]=2", "y[3]=1,u=2"):
        with pytest.raises(InputError, match=r"^columns: "):
            layout_of_titles(titles("a,b,c"), 1, 1, parse_columns(wrong), "log")


def test_a_reference_is_found_beside_what_is_needed_and_never_in_its_place() -> None:
    """Where the plant is known nobody asks for one; who names it there is not refused."""
    for header in ("t,u,y,r", "time,setpoint,u,y", "t,u,y,Sollwert [deg]"):
        layout = layout_of_titles(titles(header), None, None, {}, "log")
        names = [one.name.lower() for one in titles(header)]
        assert names[layout.reference or 0] in ("r", "setpoint", "sollwert")
        assert layout.columns == [0, *layout.readings, *layout.inputs, layout.reference]
        assert f",r={names[layout.reference]}" in layout.columns_text.lower()
    assert layout_of_titles(titles("t,u,y,r"), 1, 1, {"r": "r"}, "log").columns == [0, 2, 1]
    for columns in ("y=r,u=u", "y=y,u=r"):
        chosen = parse_columns(columns)
        assert layout_of_titles(titles("t,u,y,r"), None, None, chosen, "log").reference is None
    with pytest.raises(FileError, match="used twice"):
        layout_of_titles(titles("t,u,y,r"), None, None, parse_columns("r=u"), "log")
    with pytest.raises(FileError, match="no name shows which column holds u"):
        layout_of_titles(titles("t,y,r"), 1, 1, {}, "log")  # a reference moves no known plant
    assert (
        layout_of_titles(
            titles("1,2,3,4"), None, None, parse_columns("t=1,y=4,u=2,r=3"), "log"
        ).reference
        == 2
    )


def test_without_a_header_the_user_says_the_columns() -> None:
    with pytest.raises(FileError, match="without a header the order"):
        LogReader("log", 1, 1, {}).feed(b"1,2,3\n", last=True)
    reader = LogReader("log", 1, 1, parse_columns("t=1,y=2,u=3"))
    samples = reader.feed(b"12:00:00,1,2\n12:00:01,3,4\n", last=True)
    assert np.diff(samples.t) == 1.0, "its times may be stamps"


@pytest.mark.parametrize(
    "lines",
    [
        ["t;y;u", "0,00;1,5;2,0"],
        ["t\ty\tu", "0.0\t1.5\t2"],
        ["t y u", "0,00 1,5 2,0"],
        ["t,y,u", "[s],[N],[V]", "0,1.5,2"],
        ['"t","y","u"', "0,1.5,2"],
        ["t,y,u", "0,1.5,2,"],
        ["t,y,u", "oops", "0,1.5,2"],
        ["t [s];y,z;u", "0,0;1,5;2"],
    ],
)
def test_dialects(lines: list[str]) -> None:
    dialect = dialect_of(lines)
    assert dialect.titles is not None
    assert [title.name[0] for title in dialect.titles] == ["t", "y", "u"]
    assert [dialect.parse_number(cell) for cell in dialect.cells(lines[-1])] == [0.0, 1.5, 2.0]


TEXT = "# a remark\r\nt [ms];y [N];u [V]\r\n0;1,5;2\r\n10;;3\r\n20;nan;3\r\nbad\r\n30;-1,5;4\r\n"


@pytest.mark.parametrize("size", [1, 2, 7, 1000])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_the_same_samples_in_whatever_pieces_they_come(size: int, encoding: str) -> None:
    reader = LogReader("log", 1, 1, {})
    data = TEXT.replace("remark", "rémark").encode(encoding)
    if size == 1 and encoding == "utf-16":
        size = 2  # its mark comes whole
    parts = []
    for start in range(0, len(data), size):
        parts.append(reader.feed(data[start : start + size]))
    parts.append(reader.feed(b"", last=True))
    t, y, u = (np.concatenate([part[k] for part in parts]) for k in range(3))
    np.testing.assert_array_equal(t, [0, 0.01, 0.02, np.nan, 0.03])
    np.testing.assert_array_equal(y[:, 0], [1.5, np.nan, np.nan, np.nan, -1.5])
    np.testing.assert_array_equal(u[:, 0], [2, 3, 3, np.nan, 4])
    assert reader.faults.unreadable == 1
    assert "line 6" in reader.faults.why


@pytest.mark.parametrize("size", [1, 3, 40, 1000])
@pytest.mark.parametrize("ahead", ["", "Logger 3\n\nserial no, 17 b\n", "Rig;A\nstart at noon\n"])
@pytest.mark.parametrize("units", ["", "[ms];[N];[V]\n"])
def test_lines_ahead_of_a_live_header_are_skipped(size: int, ahead: str, units: str) -> None:
    """As those of a whole file, with the same units, in whatever pieces they come."""
    head = "t;y;u\n" + units if units else "t_ms;y;u\n"
    data = f"{ahead}{head}0;1,5;2\n10;2,5;3\n20;nan;3\n".encode()
    read = {}
    for live, step in ((False, len(data)), (True, size)):
        reader = LogReader("log", 1, 1, {}, live=live)
        parts = [reader.feed(data[k : k + step]) for k in range(0, len(data), step)]
        parts.append(reader.feed(b"", last=True))
        read[live] = np.concatenate([np.column_stack([one.t, one.y, one.u]) for one in parts])
        assert reader.ahead == len([line for line in ahead.splitlines() if line])
        assert reader.faults.unreadable == 0
    np.testing.assert_array_equal(read[True], read[False])
    np.testing.assert_array_equal(read[True][:, 0], [0.0, 0.01, 0.02])


def test_a_live_sample_is_read_with_the_line_that_ends_it() -> None:
    """Lines ahead are waited for, samples are not."""
    reader = LogReader("log", 1, 1, {}, live=True)
    assert reader.feed(b"Logger 3\nt,y,u\n").t.size == 0
    assert reader.feed(b"0,1.5,2\n").t.tolist() == [0.0]
    assert reader.feed(b"1,1.5,2\n").t.tolist() == [1.0]


def test_strict_stops_at_a_line_that_cannot_be_read() -> None:
    reader = LogReader("log", 1, 1, {}, strict=True)
    with pytest.raises(FileError, match="line 6"):
        reader.feed(TEXT.encode(), last=True)


def test_a_block_read_at_once_is_what_its_lines_are_one_by_one() -> None:
    rng = np.random.default_rng(0)
    rows = [",".join(map(repr, row)) for row in rng.normal(size=(200, 3)).tolist()]
    whole = LogReader("log", 1, 1, {})
    single = LogReader("log", 1, 1, {})
    text = "t,y,u\n" + "\n".join(rows) + "\n"
    at_once = whole.feed(text.encode(), last=True)
    spoilt = single.feed((text + "1,x,2\n").encode(), last=True)  # goes line by line
    for one, other in zip(at_once[:3], spoilt[:3], strict=True):
        np.testing.assert_array_equal(one, other[:-1])
    assert (whole.faults.unreadable, single.faults.unreadable) == (0, 1)


FOREIGN = [  # header, times of two lines .25 s apart, or the second after midnight
    ("timestamp", "2026-11-21T18:53:06Z", "2026-11-21T18:53:06.25Z"),
    ("timestamp", "2026-11-21 23:59:59.875", "2026-11-22 00:00:00.125"),
    ("time", "2026-11-21T19:53:06+01:00", "2026-11-21T18:53:06.250Z"),
    ("datetime", "21.11.2026 18:53:06", "21.11.2026 18:53:06.25"),
    ("datetime", "11/21/2026 6:53:06 PM", "11/21/2026 6:53:06.25 PM"),
    ("datetime", "21/11/2026 18:53:06", "21/11/2026 18:53:06.25"),
    ("date;time", "2026-11-21;18:53:06", "2026-11-21;18:53:06.25"),
    ("time", "23:59:59.875", "00:00:00.125"),
    ("time", "18:53:06,75", "18:53:07,00"),
    ("timestamp", "1795287186.5", "1795287186.75"),
    ("timestamp", "1795287186500", "1795287186750"),
    ("timestamp", "1795287186500000", "1795287186750000"),
    ("timestamp", "1795287186500000000", "1795287186750000000"),
    ("t [ms]", "500", "750"),
]


@pytest.mark.parametrize(("header", "one", "two"), FOREIGN)
@pytest.mark.parametrize("is_newest_first", [False, True])
@pytest.mark.parametrize("is_live", [False, True])
def test_times_as_loggers_write_them(
    header: str, one: str, two: str, is_newest_first: bool, is_live: bool, tmp_path: Path
) -> None:
    lines = [f"{one};1;2", f"{two};3;4"]
    if is_newest_first and (is_live or (header == "time" and two.startswith("00"))):
        return  # a stream has one order; midnight backwards is a log of one day
    text = "\n".join([f"{header};y;u", *(lines[::-1] if is_newest_first else lines)]) + "\n"
    path = tmp_path / "log.csv"
    path.write_text(text)
    reader = LogReader("log", 1, 1, {}, live=is_live)
    samples = samples_of_text(reader, path, 10_000, 10)
    assert reader.faults.unreadable == 0
    assert np.diff(samples.t) == pytest.approx([0.25], abs=1e-6)
    assert samples.y[:, 0].tolist() == [1.0, 3.0]
    assert samples.u[:, 0].tolist() == [2.0, 4.0]


@pytest.mark.parametrize(
    ("date", "seconds"),
    [("1970-01-02", 86_400.0), ("2000-03-01T00:00:01", 951_868_801.0), ("2026-02-30", None)],
)
def test_dates_count_from_1970(date: str, seconds: float | None) -> None:
    found = stamps_of([date])
    assert found is not None
    assert found.seconds(date) == seconds


def test_only_a_fall_of_nearly_a_day_is_midnight() -> None:
    reader = LogReader("log", 1, 1, {})
    lines = [f"{time},1,2" for time in ("03:00:00", "21:00:00", "03:00:01", "23:59:59", "00:00:00")]
    samples = reader.feed("\n".join(["t,y,u", *lines, ""]).encode(), last=True)
    assert samples.t.tolist() == [10_800.0, 75_600.0, 10_801.0, 86_399.0, 86_400.0]


def test_what_nothing_tells_is_refused() -> None:
    with pytest.raises(
        FileError, match=r"line 2: it is not known which number of '3/4/2026 1:00:00'"
    ):
        LogReader("log", 1, 1, {}).feed(b"t,y,u\n3/4/2026 1:00:00,1,2\n", last=True)
    for odd in ("12:60:00", "24:00:00", "13:00:00 PM", "3 o'clock", "2026-13-01", "18:53"):
        reader = LogReader("log", 1, 1, {})
        samples = reader.feed(f"t,y,u\n18:52:00,1,2\n{odd},1,2\n".encode(), last=True)
        assert (samples.t.size, reader.faults.unreadable) == (2, 0 if odd == "18:53" else 1), odd


def test_a_glitch_in_a_log_of_numbers_is_no_time_of_day() -> None:
    reader = LogReader("log", 1, 1, {})
    samples = reader.feed(b"t,y,u\n0,1,2\n12:00:01,1,2\n2,1,2\n", last=True)
    assert reader.faults.unreadable == 1
    assert samples.t[[0, 2]].tolist() == [0.0, 2.0]


def test_what_is_no_text(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="not CSV text"):
        Text("log").feed(b"PK\x02\x04\0\0")
    with zipfile.ZipFile(tmp_path / "log.csv", "w"):
        pass
    with pytest.raises(FileError, match="no Excel workbook, but another archive: save it as CSV"):
        next(blocks_of(tmp_path / "log.csv", 100))
    with pytest.raises(FileError, match="not CSV text"):
        Text("log").feed(b"1" * 100_000)
    assert Text("log").feed(b"# " + b"1" * 100_000 + b"\n1\n") == ["# " + "1" * 100_000, "1"]
    assert Text("log").feed(codecs.BOM_UTF8 + "µ\n".encode()) == ["µ"]


def samples(t: list[float]) -> Samples:
    times = np.array(t, float)
    column = np.arange(len(t), dtype=float)[:, None]
    return Samples(times, column, column, np.arange(1, len(t) + 1))


def test_gaps_become_missing_samples() -> None:
    t = [5.0, 5.1, 5.2, 5.5, np.nan, 5.7]  # of a line that could not be read nan
    found = place_on_steps(samples(t), True, 0.1, "log")
    np.testing.assert_allclose(found.samples.t, [5.0, 5.1, 5.2, 5.3, 5.4, 5.5, 5.6, 5.7])
    y = [0, 1, 2, np.nan, np.nan, 3, np.nan, 5]
    np.testing.assert_array_equal(found.samples.y[:, 0], y)
    assert found.gaps == 3
    assert found.measured == pytest.approx(0.1)


@pytest.mark.parametrize("t", [[np.nan, np.nan], [np.nan, 5.0, np.nan]])
def test_of_one_time_or_none_no_step_is_measured(t: list[float]) -> None:
    found = place_on_steps(samples(t), True, 0.1, "log")
    np.testing.assert_array_equal(found.samples.t, [time for time in t if time == time])
    assert (found.gaps, found.measured) == (0, None)


@pytest.mark.parametrize(
    ("t", "words"),
    [
        ([0, 1, 2], "1 s apart"),
        ([0, 0.001, 0.002], "0.001 s apart"),
        ([0, 100, 200], r"t \[ms\]"),
        ([0, 0.1, 0.2, 0.15], "does not increase"),
        ([0, 0.1, 0.2, 0.35], "multiple of the step"),
        ([0, 0.1, 0.2, 1e6], "at most"),
    ],
)
def test_other_steps_are_refused(t: list[float], words: str) -> None:
    with pytest.raises(FileError, match=words):
        place_on_steps(samples(t), True, 0.1, "log")


def test_a_gap_in_every_line_does_not_fill_the_memory() -> None:
    steps = np.ones(4001)
    steps[2001:] = 90_000
    with pytest.raises(FileError, match="gaps"):
        place_on_steps(samples((0.1 * np.cumsum(steps)).tolist()), True, 0.1, "log")


def test_without_times_samples_are_one_step_apart() -> None:
    found = place_on_steps(samples([np.nan] * 4), False, 0.5, "log")
    np.testing.assert_array_equal(found.samples.t, [0.0, 0.5, 1.0, 1.5])


def test_a_layout_says_what_it_took() -> None:
    layout: Layout = layout_of_titles(titles("t [ms],y [N],u [V]"), 1, 1, {}, "log")
    assert layout.columns_text == "t=t,y=y,u=u"
    units = [title.unit for title in (*layout.reading_titles, *layout.input_titles)]
    assert (layout.seconds, units) == (1e-3, ["N", "V"])


@pytest.mark.parametrize(
    ("values", "regular"),
    [
        ([0.0, 1.0, 2.0, 3.0], False),
        ([1.0, 2.0, 3.0], False),
        ([0.0, 1.0, 2.01, 3.01], True),
        ([2.0, 3.0, 4.0], True),
        ([0.0, 0.1, 0.5], False),
        ([0.0, 0.1], False),
    ],
)
def test_times_are_regular_and_no_count(values: list[float], regular: bool) -> None:
    assert is_regular_time(np.array(values)) is regular
