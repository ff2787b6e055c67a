"""Loops of a plant: files of other shapes, all records of a valve, the ranked table."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import time
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from benchmarks.identify.logs.valves import make
from benchmarks.identify.valves import log_of_loop

import undeadzone as uz
from commands import COMMAND, undeadzone
from records import write_log
from undeadzone_identify.logs.loops import find_loops, read_loops, read_record
from undeadzone_identify.models.valve import Sizes, combine_sizes
from undeadzone_identify.selection import loop as selection

SIZE = 500
LOOP = make(25, "stiction", SIZE)
COLUMNS = {"op": LOOP.op, "pv": LOOP.pv, "sp": LOOP.sp}


# Header and line of a table: a name with _ is empty where nothing changed.
LINE, TAGGED = "{k},{op},{pv},{sp}", "time,FIC101.OP,FIC101.PV,FIC101.SP"
LONG = "{t},FIC101.MV,{op_}\n{t},FIC101.PV,{pv_}\n{t},FIC101.SV,{sp_}"
SHAPES = {
    "tags": (TAGGED, LINE),
    "iFIX": ("time,FIC101_MV.F_CV,FIC101_PV.F_CV,FIC101_SV.F_CV,FIC101.MODE", LINE + ",AUTO"),
    "Step 7": ("time,FIC101.MV#Value,FIC101.PV_Out#Value,FIC101.SP_INT#Value", LINE),
    "pcs7": ('"Datum","W1//F/P.MV.Value [%]","W1//F/P.PV.Value [t]","W1//F/P.SP.Value [t]"', LINE),
    "deltav": ("time,F/PID1/OUT.CV,F/PID1/PV.CV,F/PID1/SP.CV", "{t:%d-%b-%Y %X}" + LINE[3:]),
    "honeywell": ("Date,Time,F.PIDA.OP,F.PIDA.PV,F.PIDA.SP", "{t:%m/%d/%Y},{t:%X}" + LINE[3:]),
    "foxboro": ("time,CP01:F.OUT,CP01:F.MEAS,CP01:F.SPT", LINE),
    "phd": ("Tag,F.OP,F.PV,F.SP\nText,a,b,c\nUnits,%,t,t", "{t:%m/%d/%Y %I:%M:%S %p}" + LINE[3:]),
    "underscores": ("time,FIC101_OP [%],FIC101_PV [t/h],FIC101_SP [t/h]", LINE),
    "ahead": ("time,OP_FIC101,PV_FIC101,SP_FIC101", LINE),
    "blanks": ("time,FIC101.OP,FIC101.SP,FIC101.PV", "{k},{op_},{sp_},{pv}"),
    "lines": ("timestamp,tag,value", LONG.replace("_", "")),
    "changes": ("timestamp,tag,value", LONG),
    "status": ("Time,Tag,Quality,Value", LONG.replace(",{", ",Good,{")),
    "pairs": (
        "F.PV,,F.OP,,F.SP,",
        "{t:%d-%b-%y %X},{pv},{t:%d-%b-%y %X},{op},{t:%d-%b-%y %X},{sp}",
    ),
    "ahead of tags": (f"Station 4\nJune\n{TAGGED}", LINE),
    "one value a line": (TAGGED, '{k},{op},"",""\n{k},"",{pv},""\n{k},"","",{sp}'),
    "names in two columns": ("time,loop,signal,value", LONG.replace(".", ",").replace("_", "")),
    "two loops": (f"{TAGGED},FIC102.OP,FIC102.PV,FIC102.SP", LINE + ",{op},{pv},{sp}"),
    "German": ("Zeit;F Stellgröße;F Regelgröße;F Führungsgröße", LINE.replace(",", ";")),
    "German lines": ("Zeitstempel;Variable;Wert", LONG.replace(",", ";")),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_a_table_of_tags_is_read_at_the_first_call(shape: str, tmp_path: Path) -> None:
    head, line = SHAPES[shape]
    point = "," if ";" in head else "."
    path, lines, before = tmp_path / "table.csv", [head], dict.fromkeys(COLUMNS)
    for k in range(SIZE):
        now = {name: f"{x[k]:.6g}".replace(".", point) for name, x in COLUMNS.items()}
        new = {f"{name}_": text if text != before[name] else "" for name, text in now.items()}
        t = datetime(2024, 6, 13, 8) + timedelta(seconds=k)
        lines += re.findall(r"(?m)^.*[^,;]$", line.format(k=k, t=t, **now, **new))
        before = now
    path.write_text("\n".join(lines) + "\n", encoding="cp1252")
    log, *others = map(read_record, read_loops(path).values())
    assert len(others) == ("FIC102" in head)
    assert log.t[0] == (1718265600.0 if "{t" in line else 0.0)
    read = np.hstack([log.u, log.y, log.r, log.t[:, None] - log.t[0]])
    assert read == pytest.approx(np.column_stack([*COLUMNS.values(), range(SIZE)]), rel=1e-5)


def test_a_file_for_each_tag_is_a_loop(tmp_path: Path) -> None:
    for name, x in COLUMNS.items():
        write_log(tmp_path / f"FIC101.{name}_0612.csv", "time,value", 1.0, x)
    ((record,),) = find_loops(tmp_path).values()
    assert read_record(record).y[:, 0] == pytest.approx(COLUMNS["pv"])


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of two valves, of one of which there are two records."""
    folder = tmp_path_factory.mktemp("plant")
    for seed, cause, name in (
        (1, "stiction", "FIC1_0612"),
        (6, "stiction", "FIC1_0613"),
        (3, "none", "LIC2_0612"),
    ):
        one = make(seed, cause, SIZE)
        write_log(folder / f"{name}.csv", "time,OP,PV,SP", 1.0, one.op, one.pv, one.sp)
    return folder


def test_a_plant_is_ranked_with_a_page_for_each_loop(plant: Path, tmp_path: Path) -> None:
    """`identify` of the files of a valve has the numbers of its line."""
    out = tmp_path / "ranked"
    result = undeadzone("loops", plant, "--out", out, "--workers", 2)
    assert result.returncode == 0, result.stderr
    rows = json.loads((out / "loops.json").read_text())["loops"]
    assert rows[0]["cost"] >= rows[1]["cost"]
    last, first = sorted(rows, key=lambda row: row["odds"]["sticks"])
    assert last["verdict"] not in ("stiction", "input_play")
    assert (last["loop"], len(first["records"])) == ("LIC2", 2)
    found = uz.identify(sorted(map(str, plant.glob("FIC1*")))).numbers()
    assert found["loop"]["S"] == pytest.approx(first["S"])
    assert found["odds"] == pytest.approx(first["odds"])
    assert (out / first["page"]).exists()
    assert first["page"] in (out / "report.html").read_text()


def test_a_killed_ranking_is_resumed(plant: Path, tmp_path: Path) -> None:
    out, words = tmp_path / "o", ("loops", plant, "--no-figures", "--out", tmp_path / "o")
    kept = out / "loops.json.partial"
    with subprocess.Popen([*COMMAND, *map(str, words)]) as process:
        while not (kept.exists() and kept.read_bytes().count(b"\n") > 1):
            assert process.poll() is None
            time.sleep(0.002)
        process.kill()
    assert process.returncode == -signal.SIGKILL
    first = kept.read_text()
    assert undeadzone(*words, "--resume").returncode == 0
    rows = json.loads((out / "loops.json").read_text())["loops"]
    assert {row["loop"] for row in rows} == {"FIC1", "LIC2"}
    assert json.dumps(next(row for row in rows if row["loop"] == "FIC1")) in first
    assert not kept.exists()


@pytest.mark.parametrize(("seed", "cause"), [(1, "stiction"), (3, "none")])
def test_a_loop_without_names_has_its_cause_where_no_plant_has_a_name(
    seed: int, cause: str
) -> None:
    loop = make(seed, cause, SIZE)
    found = uz.identify(t=np.arange(SIZE), u=loop.op, y=loop.pv, r=loop.sp)
    assert found.verdict == cause
    assert isinstance(found, uz.IdentifiedLoop) == (cause == "stiction")


def test_a_record_that_shows_nothing_has_no_say_in_the_size() -> None:
    """Records of small swings, whose pairs end below S, pulled the median down."""
    stick = np.geomspace(0.01, 5.0, 40)
    telling = np.exp(-0.5 * (np.log(stick / 2) / 0.1) ** 2)
    ratio, flat = np.zeros(40), np.full(40, 1 / 40)
    one = Sizes(stick, ratio, telling / telling.sum())
    alone = combine_sizes([one] * 3, 2.0)[0]
    more = combine_sizes([*[one] * 3, *[Sizes(0.3 * stick, ratio, flat)] * 9], 2.0)[0]
    assert more == pytest.approx(alone, rel=0.02)


def test_a_pv_that_stands_still_is_said() -> None:
    still = log_of_loop(LOOP._replace(pv=0 * LOOP.pv))
    assert selection.find_loop_cause([still]).word == "noise"


@pytest.mark.parametrize("kept", ["stores changes of PV above", "holds PV for 3 samples"])
def test_what_a_historian_left_out_is_named_with_its_cure(kept: str, tmp_path: Path) -> None:
    shown = LOOP.pv.copy()
    for k in range(1, SIZE):
        rests = k % 3 if "hold" in kept else abs(LOOP.pv[k] - shown[k - 1]) < 0.15 * np.ptp(LOOP.pv)
        shown[k] = shown[k - 1] if rests else LOOP.pv[k]
    path = tmp_path / "loop.csv"
    write_log(path, "time,OP,PV,SP", 1.0, LOOP.op, shown, LOOP.sp)
    said = undeadzone("identify", path, "--no-figures", "--out", tmp_path / "o").stdout
    assert "if it sticks  S " in said
    assert re.search(rf"doubt +the historian {kept}.*: set it to 0 and record again", said)


@pytest.mark.parametrize(("count", "share"), [(1, 0.95), (1, 0.05), (8, 0.95)])
def test_odds_of_a_loop_end_where_the_number_of_valves_ends(count: int, share: float) -> None:
    """One valve of known cause supports odds of 3, ten of 30."""
    most = selection.PER_VALVE * min(selection.load_weights()["valves"])
    wide = float(share > 0.5)
    row = [wide, 10.0 * wide - 3.0, 0.0, -1.0, 0.0, 0.0]
    odds = selection.combine_odds(np.array([row] * count))
    assert sum(odds.values()) == pytest.approx(1.0)
    assert max(odds.values()) <= most / (1 + most) + 1e-9
    assert (odds["sticks"] > 0.5) == (share > 0.5)


def test_a_folder_without_tables_is_refused(tmp_path: Path) -> None:
    with pytest.raises(uz.InputError, match="holds no tables"):
        find_loops(tmp_path)
    assert undeadzone("loops", tmp_path).returncode == 2
