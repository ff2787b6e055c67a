"""The gate of labelled records: what is right, false, withheld, and what stops it."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from benchmarks.identify import labelled_records as bench

import undeadzone as uz
from undeadzone.errors import InputError

EXPECTED: dict[str, tuple[str, dict[str, float]]] = {
    "S_1": ("stiction", {"stiction": 0.95, "none": 0.05}),
    "N_2": ("undecided", {"none": 0.5, "stiction": 0.5}),
    "isdb_N_3": ("tight_tuning", {"tight_tuning": 0.9}),
    "servo": ("play", {"play": 1.0}),
    "N_4": ("refused", {}),
}
REQUESTED: dict[str, dict[str, Any]] = {}  # options by record


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Records whose answers are `EXPECTED`, one of them by a label of its own."""
    REQUESTED.clear()

    def identify(log: Path, **options: Any) -> Any:
        word, odds = EXPECTED[log.stem]
        REQUESTED[log.stem] = options
        if word == "refused":
            raise InputError("the reading never changes")
        reasons = SimpleNamespace(reasons=["so"])
        return SimpleNamespace(
            verdict=word, answer=reasons, width=None, numbers=lambda: {"odds": odds}
        )

    for name in (*EXPECTED, "without_label"):
        (tmp_path / f"{name}.csv").write_text("time,OP,PV\n")
    (tmp_path / "labels.csv").write_text("file,options,right\nservo.csv,integrators=1,play both\n")
    monkeypatch.setattr(uz, "identify", identify)
    monkeypatch.setenv("RECORDS_FOLDER", str(tmp_path))
    return tmp_path


def test_records_are_scored_by_their_labels_and_need_few_options(folder: Path) -> None:
    every = {one.kind: one for one in bench.records(folder)}
    assert set(every) == set(EXPECTED)
    right = {name for name, one in every.items() if one.is_right}
    assert right == {"S_1", "isdb_N_3", "servo"}
    assert not any(one.is_wrong for one in every.values())
    expected = {name: {} for name in EXPECTED} | {"servo": {"integrators": "1"}}
    assert expected == REQUESTED
    assert "| 5 | 3 | 2 | 0 | 0 |" in bench.table()


@pytest.mark.parametrize("odds", [{"stiction": 0.81, "none": 0.19}, {}])
def test_a_false_name_stops_the_gate(
    odds: dict[str, float], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A name beside which no odds stand is said for certain."""
    monkeypatch.setitem(EXPECTED, "N_2", ("stiction", odds))
    with pytest.raises(SystemExit, match="false names: N_2"):
        bench.table()
    monkeypatch.setitem(EXPECTED, "N_2", ("stiction", {"stiction": 0.79, "none": 0.21}))
    assert "WRONG" in bench.table()
