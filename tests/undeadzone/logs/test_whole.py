"""JSON objects, one a line or in a document, are a log, as a CSV of the same columns is."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from undeadzone.errors import FileError
from undeadzone.logs.whole import of_json, of_npz
from undeadzone_identify.logs.log import read_log


def lines_of(rows: list[object]) -> str:
    return "\n".join(json.dumps(row) for row in rows)


@pytest.mark.parametrize(
    "write",
    [
        lambda rows: lines_of(rows) + "\n\n",
        json.dumps,
        lambda rows: json.dumps({"Ts": 0.1, "run": [{"up": rows[:20]}, {"down": rows[20:]}]}),
        lambda rows: json.dumps({key: [row[key] for row in rows] for key in rows[0]}),
    ],
)
def test_json_is_read_as_a_csv_of_the_same_columns(
    tmp_path: Path, write: Callable[[list[Any]], str]
) -> None:
    rows = [{"t [ms]": 0.1 * k, "u": k % 7 - 3.0, "y": 0.25 * k} for k in range(50)]
    lines, table = tmp_path / "log.json", tmp_path / "log.csv"
    lines.write_text(write(rows))
    pd.DataFrame(rows).to_csv(table, index=False)
    read, same = read_log(lines), read_log(table)
    for name in ("t", "u", "y"):
        assert np.array_equal(getattr(read, name), getattr(same, name))


def test_dates_are_seconds_and_missing_keys_are_missing_readings(tmp_path: Path) -> None:
    path = tmp_path / "log.ndjson"
    rows: list[object] = [
        {"time": f"2026-11-25T10:00:{k:02d}Z", "u": k, "y": None if k == 3 else -k, "note": "x"}
        for k in range(10)
    ]
    path.write_text(lines_of(rows).replace('"u": 5,', '"u": NaN,'))
    columns = {title.name: column for title, column in of_json(path)}
    assert set(columns) == {"time", "u", "y"}
    assert np.array_equal(np.diff(columns["time"]), np.ones(9))
    missing = [np.flatnonzero(np.isnan(columns[name])).tolist() for name in "yu"]
    assert missing == [[3], [5]]


def test_times_of_numpy_are_seconds_and_unknown_types_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.npz"
    t = np.datetime64("2026-11-30T10:00:00") + np.arange(50) * np.timedelta64(1, "ms")
    y = np.arange(50.0)
    words = np.array([f"\N{MINUS SIGN}{k}" for k in range(50)])
    np.savez(path, t=t, y=y, u=words, note=np.array(["a"] * 50))
    columns = {title.name: column for title, column in of_npz(path)}
    assert set(columns) == {"t", "y", "u"}
    assert np.allclose(columns["t"], 1e-3 * y, atol=1e-12)
    assert np.array_equal(columns["u"], -y)
    np.savez(path, t=t, y=y * 1j)
    with pytest.raises(FileError, match="y: expected numbers or times, found complex128"):
        of_npz(path)


@pytest.mark.parametrize(
    "text", ['{"t": 0}\n[1, 2]', '{"t": 0}\n{"t": ', '{"t": 0}\n' + "[" * 99999]
)
def test_a_line_that_is_no_object_is_named(tmp_path: Path, text: str) -> None:
    path = tmp_path / "log.jsonl"
    path.write_text(text)
    with pytest.raises(FileError, match="line 2: expected a JSON object"):
        of_json(path)


def test_rows_of_numbers_of_one_width_are_records_of_one_table(tmp_path: Path) -> None:
    path = tmp_path / "log.json"
    path.write_text(json.dumps({"a": [[0, 1], [1, 2], [2, 4]], "b": [[3, 5], [4, 6], [5, 7]]}))
    assert np.array_equal(of_json(path)[1][1], [1, 2, 4, 5, 6, 7])
    path.write_text('{"t": 0, "u": 1}')
    assert len(of_json(path)) == 2
    path.write_text(json.dumps({"a": [[[1, 2]] * 3], "b": [1, [2]], "c": 3}))
    with pytest.raises(FileError, match="holds no table"):
        of_json(path)
