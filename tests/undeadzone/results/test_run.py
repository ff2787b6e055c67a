"""Runs on disk: exact round trips, complete or absent files, and messages about other ones."""

from __future__ import annotations

import csv
import json
import os
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from scenes import scene
from undeadzone.errors import FileError, InputError
from undeadzone.results.files import drop_computing_time
from undeadzone.results.run import Run, blocks_from_run
from undeadzone.results.signals import RUN
from undeadzone.simulation.simulate import simulate


@pytest.fixture(scope="module")
def run() -> Run:
    """Two outputs, three units that need care in a CSV header, non-ASCII text."""
    return simulate(
        scene("""
            title = 'Zweiachs-Prüfstand, "Ω"'
            plant.A = [[0.0, 1.0], [-1.0, -2.0]]
            plant.B = [[0.0], [1.0]]
            plant.C = [[1.0, 0.0], [0.0, 1.0]]
            plant.x0 = [2.0, 0.0]
            sensor = { right = [1.0, 0.5], left = [0.8, 0.4], noise = [0.0, 0.1] }
            observer = { method = "certified", gamma = [5.0, 2.0] }
            simulation = { duration = 0.5 }
            units = { output = "µm, relative", input = "N·m", state = ["m", "m/s [fast]"] }
            """)
    )


def same(one: Run, other: Run) -> bool:
    arrays = all(
        (a is None and b is None) or (a.dtype == b.dtype and np.array_equal(a, b, equal_nan=True))
        for a, b in ((getattr(one, n), getattr(other, n)) for n in RUN.names)
    )
    return arrays and drop_computing_time(one.info) == drop_computing_time(other.info)


@pytest.mark.parametrize("suffix", [".npz", ".csv"])
def test_the_same_scenario_gives_the_same_file(tmp_path: Path, suffix: str) -> None:
    """To the last byte: how long a run took is not in it."""
    runs = [simulate(scene(simulation={"duration": 0.1})) for _ in range(2)]
    assert runs[0].info.seconds != runs[1].info.seconds
    files = [run.save(tmp_path / f"{k}{suffix}") for k, run in enumerate(runs)]
    assert files[0].read_bytes() == files[1].read_bytes()


@pytest.mark.parametrize("suffix", [".npz", ".csv"])
def test_saved_and_loaded_runs_are_the_same_to_the_last_bit(
    run: Run, tmp_path: Path, suffix: str
) -> None:
    assert run.V is not None
    for name, original in (("full", run), ("bare", replace(run, V=None))):
        path = original.save(tmp_path / f"{name}{suffix}")
        assert same(Run.load(path), original)


@pytest.mark.parametrize("suffix", [".npz", ".csv"])
def test_numbers_that_are_none_survive(run: Run, tmp_path: Path, suffix: str) -> None:
    z = run.z.copy()
    z[3], z[4, 0], z[5] = np.nan, np.inf, -0.0
    broken = replace(run, z=z, info=msgspec.structs.replace(run.info, integration_error=None))
    assert same(Run.load(broken.save(tmp_path / f"broken{suffix}")), broken)


def test_csv_is_one_table_with_names_and_units(run: Run, tmp_path: Path) -> None:
    with open(run.save(tmp_path / "run.csv"), encoding="utf-8", newline="") as file:
        assert json.loads(file.readline().removeprefix("# "))["title"] == run.info.title
        header, *rows = list(csv.reader(file))
    assert header[:4] == ["t [s]", "x[0] [m]", "x[1] [m/s [fast]]", "z[0] [µm, relative]"]
    assert {"d_right[1] [µm, relative]", "u[0] [N·m]", "side[0] [1]", "V [1]"} <= set(header)
    assert all(len(row) == len(header) for row in rows)
    assert len(rows) == run.t.size
    assert [float(row[0]) for row in rows] == run.t.tolist()


def test_columns_name_every_signal_once(run: Run) -> None:
    columns = run.columns()
    for i, name in enumerate(["d_right[0]", "d_left[0]", "d_right[1]", "d_left[1]"]):
        assert (columns[name] == run.d_hat[:, i]).all()
    assert (columns["x_hat[1]"] == run.x_hat[:, 1]).all()
    assert len(columns) == 1 + 2 + 2 + 2 + 2 + 2 + 2 + 4 + 2 + 2 + 1 + 1 + 1


def test_to_pandas(run: Run) -> None:
    frame = run.to_pandas()
    assert frame.index.name == "t"
    assert frame.index.tolist() == run.t.tolist()
    assert list(frame.columns) == list(run.columns())[1:]
    assert (frame["z[1]"] == run.z[:, 1]).all()


def test_summary_is_json_whatever_the_run(run: Run) -> None:
    summary = json.loads(json.dumps(run.summary(), allow_nan=False))
    assert summary["d_right"] == run.d_hat[-1, [0, 2]].tolist()
    assert len(summary["identifiable"]) == 2
    nothing = np.full_like(run.z, np.nan)
    assert run.V is not None
    lost = replace(
        run,
        z=nothing,
        d_hat=run.d_hat * np.nan,
        V=run.V * np.inf,
        info=msgspec.structs.replace(run.info, integration_error=float("inf")),
    )
    summary = json.loads(json.dumps(lost.summary(), allow_nan=False))
    assert [
        summary[key]
        for key in ("rms_tracking", "rms_estimation", "integration_error", "largest_rise_of_V")
    ] == [None] * 4
    assert summary["d_left"] == [None, None]


def test_measures_of_a_run_by_hand(run: Run) -> None:
    t = np.arange(0, 5, 0.5)
    error = np.where(t >= 3.0 - 1e-9, 0.3, 9.0)[:, None]
    column = np.zeros((t.size, 1))
    by_hand = replace(
        run,
        t=t,
        z=column + error,
        r=column,
        z_hat=column,
        x=column,
        x_hat=column,
        u=column,
        side=column,
        V=np.array([3.0, 1.0, 1.3, 1.2, 1.5] + [0.0] * 5),
        d_hat=np.hstack([column, column + 2]),
        info=msgspec.structs.replace(run.info, tracked=[0], scales=[]),
    )
    assert by_hand.rms_tracking == pytest.approx(np.sqrt((4 * 0.09 + 81) / 5))
    assert by_hand.rms_estimation == by_hand.rms_tracking
    assert by_hand.largest_rise_of_V == pytest.approx(0.5 / 3)
    assert by_hand.widths.tolist() == [[0, 2]]
    assert by_hand.silent_fraction == 1.0
    assert by_hand.divergence_time is None
    assert replace(by_hand, u=np.where(t[:, None] > 2.2, 1e13, 0)).divergence_time == 2.5
    assert replace(by_hand, x=np.where(t[:, None] > 1.2, np.nan, 0)).divergence_time == 1.5


def test_saving_creates_folders_and_replaces_files(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "new" / "folder" / "run.npz"
    run.save(path)
    path.write_text("old")
    run.save(path)
    assert same(Run.load(path), run)
    assert os.listdir(path.parent) == ["run.npz"]


def test_nothing_is_left_of_a_file_that_cannot_be_finished(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = run.save(tmp_path / "run.npz")

    def stop(file: Any, **arrays: Any) -> None:
        file.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", stop)
    with pytest.raises(FileError, match=r"run.npz: cannot write: No space left on device"):
        run.save(path)
    assert os.listdir(tmp_path) == ["run.npz"]
    assert same(Run.load(path), run)


def test_unwritable_paths(run: Run, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "folder.npz").mkdir()
    for path in ("file/run.npz", "folder.npz", "nul\0.npz", f"{'long' * 100}.csv"):
        with pytest.raises(FileError, match="cannot write"):
            run.save(tmp_path / path)
    for path in ("run.txt", "run"):
        with pytest.raises(InputError, match=r"the name must end in .npz or .csv"):
            run.save(tmp_path / path)
    assert sorted(os.listdir(tmp_path)) == ["file", "folder.npz"]


def spoil(run: Run, tmp_path: Path) -> dict[str, bytes]:
    """Files that are not runs."""
    whole = run.save(tmp_path / "whole.npz").read_bytes()
    table = run.save(tmp_path / "whole.csv").read_bytes()
    with zipfile.ZipFile(tmp_path / "other.npz", "w") as archive:
        archive.writestr("readme.txt", "nothing here")
    np.save(tmp_path / "array.npy", np.zeros(3))
    return {
        "empty.npz": b"",
        "text.npz": b"hello, world\n",
        "half.npz": whole[: len(whole) // 2],
        "flipped.npz": whole[:2000] + bytes(byte ^ 255 for byte in whole[2000:2400]) + whole[2400:],
        "other.npz": (tmp_path / "other.npz").read_bytes(),
        "array.npz": (tmp_path / "array.npy").read_bytes(),
        "empty.csv": b"",
        "text.csv": b"hello, world\n1,2\n",
        "binary.csv": whole[:500],
        "half.csv": table[: len(table) - 40],
        "headless.csv": table.partition(b"\n")[2],
        "narrow.csv": b"\n".join(
            line.rpartition(b",")[0] if i > 1 else line for i, line in enumerate(table.splitlines())
        ),
        "rowless.csv": b"\n".join(table.splitlines()[:2]) + b"\n",
    }


def test_files_that_are_not_runs(run: Run, tmp_path: Path) -> None:
    for name, contents in spoil(run, tmp_path).items():
        (tmp_path / name).write_bytes(contents)
        with pytest.raises(FileError, match=f"{name}: not a run saved by undeadzone"):
            Run.load(tmp_path / name)
    for name in ("missing.npz", "missing.csv", "."):
        with pytest.raises(FileError, match="cannot read"):
            Run.load(tmp_path / name)


@pytest.mark.parametrize(("sensor", "word"), [("play", "holding"), ("dead_zone", "silent")])
def test_a_play_holds_and_another_sensor_is_silent(run: Run, sensor: str, word: str) -> None:
    other = replace(run, info=msgspec.structs.replace(run.info, sensor=sensor))
    block = blocks_from_run(other)[0]
    assert isinstance(block, dict)
    assert block.keys() & {"holding", "silent"} == {word}
