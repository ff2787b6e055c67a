"""Files as the programs of the trades write them: names, units of time, lines ahead, commas."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from requirements import import_package
from undeadzone.errors import FileError
from undeadzone.logs.kinds import split_unit
from undeadzone.logs.names import Layout, layout_of_titles
from undeadzone.logs.samples import LogReader, Samples, place_on_steps, samples_of_text


def columns_of(header: str, **chosen: str) -> Layout:
    """Return the columns that a header of cells between commas names."""
    return layout_of_titles([*map(split_unit, header.split(","))], None, None, chosen, "log")


def read(path: Path, text: str) -> tuple[LogReader, Samples]:
    """Return the reader of a log with this text, and its samples."""
    path.write_text(text)
    reader = LogReader(str(path), None, None, {})
    return reader, samples_of_text(reader, path, 10**8, math.inf)


@pytest.mark.parametrize(
    ("header", "y", "u", "r"),
    [
        ("time,OP,PV,SP", "PV", "OP", "SP"),
        ("t,FIC101.PV,FIC101.OP,FIC101.SP", "FIC101.PV", "FIC101.OP", "FIC101.SP"),
        ("time,output,pv,setpoint", "pv", "output", "setpoint"),
        ("time,input,output", "output", "input", None),
        ("t,u,output,speed", "output", "u", None),
        ("time,voltage,rpm,direction", "rpm", "voltage", None),
        ("t [s],pwm,speed [rad/s]", "speed", "pwm", None),
        ("t [s],desired [rad],position [rad]", "position", "desired", None),
        ("Time[ms],Tick,Present Position,Goal Position", "Present Position", "Goal Position", None),
        ("t,dec [px],decpulse [ms],ra [px],rapulse [ms]", "dec", "decpulse", None),
        ("t,displacement [mm],force [N],velocity", "force", "displacement", None),
        ("millis,heater,temperature", "temperature", "heater", None),
        ("t,process_value,valve", "process_value", "valve", None),
        ("t,motor_deg,joint_deg", "joint_deg", "motor_deg", None),
        ("t,pwm_us,rpm", "rpm", "pwm_us", None),
        ("t,pulses_ms,star_arcsec", "star_arcsec", "pulses_ms", None),
        ("t,target_mm,camera_mm", "camera_mm", "target_mm", None),
        ("t_ms,u_V,y_mm,ref_mm", "y_mm", "u_V", "ref_mm"),
        ("t,displacement_mm,force_N", "force_N", "displacement_mm", None),
        ("t,force_command,reading", "reading", "force_command", None),
        ("t,commanded_angle,measured_angle", "measured_angle", "commanded_angle", None),
        ("t,y,y_mm,u", "y", "u", None),  # the name itself comes before a name with a unit
    ],
)
def test_names_of_the_trade(header: str, y: str, u: str, r: str | None) -> None:
    layout = columns_of(header)
    names = [split_unit(cell).name for cell in header.split(",")]
    assert layout.readings == [names.index(y)]
    assert layout.inputs == [names.index(u)]
    assert layout.reference == (None if r is None else names.index(r))
    assert layout.time == 0


def test_a_unit_at_the_end_of_a_name_is_carried() -> None:
    layout = columns_of("t_ms,motor_deg,joint_deg [rad]")
    assert layout.seconds == 1e-3
    assert layout.input_titles == [("motor_deg", "deg")]
    assert layout.reading_titles == [("joint_deg", "rad")], "brackets are the clearer word"
    shaft = columns_of("theta_m,u_n,y", **{"u[0]": "u_n"})
    assert shaft.input_titles == [("u_n", "")], "n is no newton"


@pytest.mark.parametrize(
    "header",
    [
        "t,u,measured_angle,measured_height",
        "t,left_rpm,right_rpm",
        "t,u,y_mm,y_deg",
        "t,u,level,flow",
        "t,op,pressure,temperature",
    ],
)
def test_two_readings_or_none_are_never_guessed(header: str) -> None:
    with pytest.raises(FileError, match=r"which column holds y.*Name it by columns=.y"):
        columns_of(header)


def test_the_nearest_name_ends_the_sentence() -> None:
    with pytest.raises(FileError, match=r"Did you mean 'inptu'\? Name it by columns=.u=NAME"):
        columns_of("t,inptu,y")


@pytest.mark.parametrize(
    ("name", "seconds"),
    [
        *[("t_ms", 1e-3), ("time_ms", 1e-3), ("millis", 1e-3), ("ms", 1e-3), ("timeMs", 1e-3)],
        *[("us", 1e-6), ("micros", 1e-6), ("t_us", 1e-6), ("time [ms]", 1e-3), ("minutes", 60.0)],
        *[("t_min", 60.0), ("time", 1.0), ("t_s", 1.0), ("timestamp", 1.0), ("time [min]", 60.0)],
    ],
)
def test_units_of_time_in_names(name: str, seconds: float) -> None:
    layout = columns_of(f"{name},u,y")
    assert (layout.time, layout.seconds) == (0, seconds)


def test_lines_ahead_of_the_header_are_skipped_and_counted(tmp_path: Path) -> None:
    rows = "".join(f"{35 * k},{k % 7},{k % 5},0,,,\n" for k in range(40))
    head = "GRAPH,3,,,,,\n-1,32,AB-1(2.0),Goal,#00ff00,0,\nTime[ms],Tick,position,goal,,,\n"
    reader, samples = read(tmp_path / "a.csv", head + rows)
    assert reader.ahead == 2
    assert samples.t[1] == pytest.approx(0.035)
    noted = "Pump 7, second run\nBegun 12:30\n\nt,u,y\n0.1,1,2\n0.2,1,2\n0.3,1,2\n"
    assert read(tmp_path / "b.csv", noted)[0].ahead == 2


@pytest.mark.parametrize(
    ("head", "ahead", "names"),
    [
        ("=~=~= log 2022.12.05 19:00:24 =~=~=\n", 1, "123"),
        ("KVLCC2 (free running)\nZig-zag manoeuvre : 20 / -20\n\n", 2, "123"),
        ("t [s]  y (mm) u [V]\n", 0, "tyu"),
    ],
)
def test_text_above_numbers_names_them_only_if_it_is_as_wide(
    tmp_path: Path, head: str, ahead: int, names: str
) -> None:
    rows = "".join(f"{0.1 * k:.1f} {0.3 * min(k % 14, 7):g}  {k % 14}\n" for k in range(60))
    reader, samples = read(tmp_path / "a.log", head + rows)
    assert (reader.ahead, reader.faults.why) == (ahead, "")
    assert reader.layout is not None
    assert reader.layout.reading_titles[0].name == names[1]
    assert samples.u[:8, 0].tolist() == [*range(8)]


def test_an_index_without_a_name_is_the_time_if_it_is_one(tmp_path: Path) -> None:
    rows = [f"2026-01-01 00:00:{k:02d},{k % 3},{k % 4}\n" for k in range(20)]
    _, samples = read(tmp_path / "a.csv", ",u,y\n" + "".join(rows))
    assert np.diff(samples.t) == pytest.approx(1.0)
    _, samples = read(tmp_path / "b.csv", ",u,y\n" + "".join(f"{k},1,2\n" for k in range(20)))
    assert np.isnan(samples.t).all(), "a count is no time"


def test_a_frame_whose_index_has_no_name() -> None:
    pandas = import_package("pandas")
    from undeadzone.logs.whole import samples_of

    index = pandas.date_range("2026-01-01", periods=20, freq="20ms")
    frame = pandas.DataFrame({"u": np.arange(20.0), "y": np.arange(20.0)}, index=index)
    samples, _ = samples_of(frame, None, None, {}, "frame")
    assert np.diff(samples.t) == pytest.approx(0.02)


def test_a_time_that_comes_twice_is_counted() -> None:
    t = np.insert(np.arange(40) / 10, 7, 0.6)
    samples = Samples(t, t[:, None], t[:, None], np.arange(41))
    placed = place_on_steps(samples, True, 0.1, "log")
    assert (placed.repeated, placed.gaps, placed.samples.t.size) == (1, 0, 40)
    coarse = samples._replace(t=np.floor(t * 5) / 5)
    with pytest.raises(FileError, match="time does not increase"):
        place_on_steps(coarse, True, 0.1, "log")


@pytest.mark.parametrize(
    ("cell", "time", "value"),
    [
        ("1,301.5", "0.0{}", 1301.5),
        ("1,301", "0,0{}", 1.301),
        ("1.301,5", "0,0{}", 1301.5),
        ("1,301", "13.06.2024 08:00:00,0{}", 1.301),
    ],
)
def test_one_decimal_mark_for_a_file(cell: str, time: str, value: float, tmp_path: Path) -> None:
    rows = "".join(f"{time.format(k)}\t{cell}\t995\n" for k in range(10))
    _, samples = read(tmp_path / "a.csv", "t\tu\ty\n" + rows)
    assert (samples.u == value).all()
    assert samples.t[9] - samples.t[0] == pytest.approx(0.09, rel=1e-5)


def test_a_mark_that_may_be_either_counts_as_unreadable(tmp_path: Path) -> None:
    """Times have a point; a recorder writes them so whatever the locale of the readings."""
    rows = "".join(f"0.0{k}\t{3 * k}\t{'1,301' if k == 4 else 995}\n" for k in range(10))
    reader, samples = read(tmp_path / "a.csv", "t\tu\ty\n" + rows)
    assert np.flatnonzero(np.isnan(samples.y)).tolist() == [4]
    assert "it is not clear if the mark in '1,301' is the decimal mark" in reader.faults.why
    groups = rows.replace("0.09\t27", "0.09\t2,027.5")
    _, samples = read(tmp_path / "b.csv", "t\tu\ty\n" + groups)
    assert samples.y[4] == 1301


def test_live_a_mark_that_nothing_tells_yet_is_missing() -> None:
    reader = LogReader("stdin", 1, 1, {}, live=True)
    lines = ("t\tu\ty", "0\t1,301\t995", "1\t2\t995", "2\t0,5\t995", "3\t1,301\t995", "")
    fed = [reader.feed(f"{line}\n".encode()) for line in lines]
    assert np.concatenate([part.u.ravel() for part in fed]) == pytest.approx(
        [math.nan, 2, 0.5, 1.301], nan_ok=True
    )


def test_blanks_between_thousands_are_no_separators(tmp_path: Path) -> None:
    """A narrow blank, as locales write it, in a file of columns between plain ones."""
    rows = "".join(f"0.0{k} {3 * k} 1\u202f995.0\n" for k in range(10))
    reader, samples = read(tmp_path / "a.csv", "t u y\n" + rows)
    assert np.isnan(samples.y).all()
    assert "expected a number or nothing" in reader.faults.why


def test_a_comma_that_may_be_either_is_refused(tmp_path: Path) -> None:
    rows = "".join(f"{k}\t1,30{k}\t995\n" for k in range(10))
    with pytest.raises(FileError, match=r"it is not known whether 1,300 is 1300 or 1\.300"):
        read(tmp_path / "a.csv", "t\tu\ty\n" + rows)
