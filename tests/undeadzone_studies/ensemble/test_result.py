"""The result of an ensemble: what enters its statistics, files bit for bit, figures and page."""

from __future__ import annotations

import dataclasses
import json
import sys
import tracemalloc
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from undeadzone.errors import FileError, InputError
from undeadzone.scenario.schema import Units
from undeadzone.util.arrays import Floats
from undeadzone_studies.ensemble.metrics import LEVELS, error_bands, true_width
from undeadzone_studies.ensemble.result import Ensemble
from undeadzone_studies.ensemble.saved import Info
from undeadzone_studies.ensemble.words import _format_share
from undeadzone_studies.report.ensemble_page import draw_ensemble_figures, write_ensemble
from undeadzone_studies.statistics.intervals import describe, proportion

ENTRIES = ("sensor.right[0]", "plant.A[1,0] (relative)", "sensor.noise[0]")
NASTY = "<b>Ω & more</b>"
WIDTHS = [1.0, 1.0, 1.4, 0.5]  # right and left of two outputs


def ensemble(
    runs: int = 400,
    entries: tuple[str, ...] = ENTRIES,
    sampling: str = "random",
    diverge: float = 0.02,
    recorded: int = 50,
) -> Ensemble:
    """An ensemble with the shape of a real one.

    Its rms grows with the right width, with the mass and with the noise, in this order.
    """
    random = np.random.default_rng(runs)
    drawn = {
        "sensor.right[0]": random.uniform(0.3, 2.0, runs),
        "plant.A[1,0] (relative)": random.normal(1, 0.1, runs),
        "sensor.noise[0]": random.random(runs),
    }
    right, mass, noise = drawn.values()
    lost = random.random(runs) < diverge
    metrics = {
        "rms_tracking": 0.1 * (right + noise) * np.exp(2 * (mass - 1)),
        "rms_estimation": 0.1 * right,
        "peak_tracking": 5 + random.random(runs),
        "settling_time": 4 + 5 * noise,
        "silent_fraction": 0.1 * right,
        "rms_input": 100 + random.random(runs),
        "d_right[0]": right + 0.01 * random.standard_normal(runs),
        "d_left[0]": 0.7 + 0.01 * random.standard_normal(runs),
        "diverged": lost.astype(float),
    }
    for name in metrics.keys() - {"diverged"}:
        metrics[name] = np.where(lost, np.nan, metrics[name])
    info = Info(
        title=NASTY,
        method="certified",
        time="sampled",
        step=0.01,
        duration=10.0,
        seed=3,
        sampling=sampling,
        runs=runs,
        tolerance=0.02,
        tracked=[0],
        widths=[1.0, 0.7],
        scenario=f'title = "{NASTY}"',
        version="0",
        recorded=recorded,
        units=Units(output="mm", input="N"),
    )
    varied = {name: drawn[name] for name in entries}
    return Ensemble(varied, metrics, info, recorded_bands(recorded) if recorded else None)


def recorded_bands(lanes: int) -> Any:
    random, t = np.random.default_rng(0), np.linspace(0, 10, 40)
    r = np.broadcast_to(np.sin(t)[:, None], (lanes, 40, 1))
    z = r + np.exp(-t)[:, None] * random.standard_normal((lanes, 40, 1))
    z[0, 20:] = np.nan
    return error_bands(t, z, r, random.random((lanes, 40, 2)), np.ones((lanes, 2)), [0])


def with_metrics(result: Ensemble, **columns: Floats) -> Ensemble:
    return dataclasses.replace(result, metrics=result.metrics | columns)


def test_runs_that_diverged_are_counted_and_never_averaged() -> None:
    result = ensemble()
    lost = result.diverged
    assert 0 < lost.sum() < 20
    spoilt = dict(result.metrics)
    for name in spoilt.keys() - {"diverged"}:
        spoilt[name] = np.where(lost, 1e300, spoilt[name])
    spoilt = dataclasses.replace(result, metrics=spoilt)
    summary = result.summary()
    share = proportion(int(lost.sum()), 400)._asdict()
    assert summary["diverged"] == share | {"runs": np.flatnonzero(lost).tolist()}
    expected = describe(result.metrics["rms_tracking"][~lost])
    assert summary["metrics"]["rms_tracking"]["mean"] == expected["mean"]._asdict()
    for key in ("metrics", "sensitivities", "settled", "typical"):
        assert spoilt.summary()[key] == summary[key]


def test_runs_that_never_settled_take_for_ever() -> None:
    result = ensemble(diverge=0.0)
    late = result.metrics["settling_time"] > 8.0
    summary = result.summary()
    assert summary["settled"] == proportion(400 - int(late.sum()), 400)._asdict()
    time = summary["metrics"]["settling_time"]
    assert time["median"]["value"] == np.sort(result.metrics["settling_time"])[199]
    assert time["p99"] == {"value": None, "low": None, "high": None}
    assert time["mean"]["value"] is None


def test_a_run_that_diverged_has_not_settled() -> None:
    result = ensemble(diverge=0.5)
    assert not (result.settled & result.diverged).any()
    assert result.summary()["settled"]["value"] == result.settled.mean()


def test_the_worst_runs_come_first() -> None:
    result = with_metrics(
        ensemble(8, diverge=0.0),
        rms_tracking=np.array([3.0, 1, 7, 7, 2, np.nan, 5, 0]),
        diverged=np.eye(8)[5],
    )
    assert result.worst(count=4) == [5, 2, 3, 6]
    assert result.worst(count=100) == [5, 2, 3, 6, 0, 4, 1, 7]
    assert result.typical() == 0
    assert [row["run"] for row in result.summary()["worst"]] == result.worst(count=10)
    row = result.row(2)
    assert row["varied"]["sensor.right[0]"] == result.varied["sensor.right[0]"][2]
    assert row["metrics"]["rms_tracking"] == 7
    with pytest.raises(InputError, match="expected 0 to 7"):
        result.row(8)
    words = "no_such: is not a column of this ensemble. There are sensor"
    with pytest.raises(InputError, match=words):
        result.worst("no_such")
    with pytest.raises(InputError, match=r"d_up_error\[0\]: is not a column"):
        result.column("d_up_error[0]")


def test_errors_of_widths_are_differences_from_the_truth_of_each_run() -> None:
    result = ensemble(diverge=0.0)
    right = result.metrics["d_right[0]"] - result.varied["sensor.right[0]"]
    left = result.metrics["d_left[0]"] - 0.7
    np.testing.assert_array_equal(result.column("d_right_error[0]"), right)
    np.testing.assert_array_equal(result.column("d_left_error[0]"), left)
    largest = np.maximum(np.abs(right), np.abs(left))
    np.testing.assert_array_equal(result.column("d_error"), largest)


@pytest.mark.parametrize(
    ("words", "right", "left"),
    [
        ("sensor.right[1]", [2.0, 3.0], 0.5),
        ("sensor.right[1] (relative)", [2.8, 4.2], 0.5),
        ("sensor.right[0]", 1.4, 0.5),
        ("sensor.right + sensor.left", [2.0, 3.0], [2.0, 3.0]),
        ("sensor.left[:] (relative)", 1.4, [1.0, 1.5]),
        ("plant.x0[1]", 1.4, 0.5),
        ("plant.parameters.half2", 1.4, 0.5),
    ],
)
def test_true_widths_are_found_in_whatever_words_they_vary(
    words: str, right: Any, left: Any
) -> None:
    varied = {words: np.array([2.0, 3.0])}
    np.testing.assert_allclose(true_width("right[1]", WIDTHS, varied, False), right)
    np.testing.assert_allclose(true_width("left[1]", WIDTHS, varied, False), left)


def test_the_most_influential_entry_comes_first() -> None:
    found = ensemble(2000).sensitivities()
    assert list(found) == ["sensor.right[0]", "plant.A[1,0] (relative)", "sensor.noise[0]"]
    assert found["sensor.right[0]"].partial.low > 0.5
    assert found["sensor.right[0]"].floor is not None
    assert found["sensor.right[0]"].total_order is None
    assert ensemble(entries=()).sensitivities() == {}


def test_saltellis_blocks_that_repeat_values_enter_the_indices_only() -> None:
    """Blocks A, B, AB_1, AB_2 of y = 2 x_1 + x_2, whose variance shares are 0.8 and 0.2.

    Rows of AB are not independent of A and B.
    """
    n = 512
    A, B = np.random.default_rng(1).random((2, n, 2))
    AB_1 = np.column_stack([B[:, 0], A[:, 1]])
    AB_2 = np.column_stack([A[:, 0], B[:, 1]])
    X = np.concatenate([A, B, AB_1, AB_2])
    result = ensemble(4 * n, ("sensor.right[0]", "sensor.noise[0]"), "saltelli", diverge=0.0)
    result = with_metrics(result, rms_tracking=X @ [2.0, 1.0])
    result = dataclasses.replace(result, varied=dict(zip(result.varied, X.T, strict=True)))
    for one, share in zip(result.sensitivities().values(), (0.8, 0.2), strict=True):
        assert one.total_order is not None
        assert one.first_order.low <= share <= one.first_order.high
        assert one.total_order.low <= share <= one.total_order.high
    mean = describe(X[: 2 * n] @ [2.0, 1.0])["mean"]
    assert result.summary()["metrics"]["rms_tracking"]["mean"] == mean._asdict()
    assert result.summary()["diverged"]["high"] == proportion(0, 2 * n).high


def test_bands_are_quantiles_of_all_recorded_runs() -> None:
    """Of 100 runs with |z - r| = 1, ..., 100 and one that is lost after the first instant."""
    z = np.arange(1.0, 101.0)[:, None, None] * np.array([1.0, -1.0])[:, None]
    z[0, 1] = np.nan
    t, r = np.array([0.0, 1.0]), np.zeros((100, 2, 1))
    widths = np.tile([1.0, 0.7], (100, 1))
    quantiles = error_bands(t, z, r, np.ones((100, 2, 2)), widths, [0]).quantiles
    assert list(quantiles) == ["tracking[0]", "d_right[0]", "d_left[0]"]
    expected = [[1, 5, 50, 95, 99], [2, 6, 51, 96, 100]]
    np.testing.assert_array_equal(quantiles["tracking[0]"], expected)
    np.testing.assert_allclose(quantiles["d_left[0]"], np.full((2, len(LEVELS)), 0.3))
    z[1:3, 1] = np.nan
    quantiles = error_bands(t, z, r, z, z[:, 0], [0]).quantiles
    assert quantiles["tracking[0]"][1, -1] == np.inf


def everything(result: Ensemble) -> dict[str, Floats]:
    """Columns and bands by name."""
    columns = {**result.varied, **result.metrics}
    if result.bands is not None:
        columns |= result.bands.quantiles | {"t": result.bands.t}
    return columns


def assert_same(one: Ensemble, other: Ensemble) -> None:
    ours, theirs = everything(one), everything(other)
    assert list(ours) == list(theirs)
    for name, column in ours.items():
        assert np.array_equal(column, theirs[name], equal_nan=True), name
    assert list(one.varied) == list(other.varied)
    assert one.info == other.info


@pytest.mark.parametrize("suffix", [".npz", ".parquet"])
@pytest.mark.parametrize("kind", [{}, {"entries": (), "recorded": 0}, {"runs": 1}])
def test_a_saved_ensemble_comes_back_to_the_last_bit(
    suffix: str, kind: dict[str, Any], tmp_path: Path
) -> None:
    result = ensemble(**kind)
    path = result.save(tmp_path / f"runs{suffix}")
    loaded = Ensemble.load(path)
    assert_same(result, loaded)
    assert loaded.summary() == result.summary()
    assert loaded.save(tmp_path / f"again{suffix}").read_bytes() == path.read_bytes()
    assert sorted(found.name for found in tmp_path.iterdir()) == [f"again{suffix}", f"runs{suffix}"]


def test_a_damaged_parquet_is_refused_or_means_the_same(tmp_path: Path) -> None:
    path = ensemble().save(tmp_path / "runs.parquet")
    whole, first, refused = path.read_bytes(), Ensemble.load(path), 0
    for place in range(5, len(whole), len(whole) // 300):
        changed = bytearray(whole)
        changed[place] ^= 0x10
        path.write_bytes(changed)
        try:
            other = Ensemble.load(path)
        except FileError:
            refused += 1
            continue
        assert other.info == first.info
        for name in (*first.varied, *first.metrics):
            assert np.array_equal(other.column(name), first.column(name), equal_nan=True)
    assert refused > 150


def test_parquet_is_a_table_for_other_tools(tmp_path: Path) -> None:
    import pandas as pd

    result = ensemble()
    frame = pd.read_parquet(result.save(tmp_path / "runs.parquet"))
    assert list(frame) == [*result.varied, *result.metrics]
    np.testing.assert_array_equal(frame["rms_tracking"], result.metrics["rms_tracking"])


def test_columns_of_a_loaded_file_stay_on_disk(tmp_path: Path) -> None:
    runs = 200_000
    path = ensemble(runs).save(tmp_path / "runs.npz")
    tracemalloc.start()
    try:
        loaded = Ensemble.load(path)
        for name in loaded.quantities:
            describe(loaded.sample(name))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert isinstance(loaded.metrics["rms_tracking"], np.memmap)
    assert peak < 6 * 8 * runs  # bytes: six columns of the twelve


def test_without_pyarrow_the_message_says_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = ensemble().save(tmp_path / "runs.parquet")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    words = r"pip install 'undeadzone\[parquet\]'"
    with pytest.raises(InputError, match=words):
        ensemble().save(tmp_path / "other.parquet")
    with pytest.raises(InputError, match=words):
        Ensemble.load(path)
    assert [found.name for found in tmp_path.iterdir()] == ["runs.parquet"]


def test_files_that_are_no_ensemble_are_refused(tmp_path: Path) -> None:
    good = ensemble().save(tmp_path / "runs.npz").read_bytes()
    np.savez(tmp_path / "other.npz", a=np.ones(3))
    at = good.index(ensemble().metrics["rms_input"].tobytes()[:64])
    (tmp_path / "torn.npz").write_bytes(good[: len(good) // 2])
    (tmp_path / "bent.npz").write_bytes(good[:at] + bytes([good[at] ^ 1]) + good[at + 1 :])
    (tmp_path / "text.npz").write_text("runs", encoding="utf-8")
    (tmp_path / "text.parquet").write_text("runs", encoding="utf-8")
    for name in ("other.npz", "torn.npz", "bent.npz", "text.npz", "text.parquet"):
        with pytest.raises(FileError, match=name.replace(".", r"\.")):
            Ensemble.load(tmp_path / name)
    with pytest.raises(FileError, match="cannot read"):
        Ensemble.load(tmp_path / "missing.npz")
    with pytest.raises(InputError, match=r"must end in \.npz or \.parquet"):
        ensemble().save(tmp_path / "runs.csv")
    with pytest.raises(FileError, match="cannot write"):
        ensemble().save(tmp_path / "text.npz" / "runs.npz")


LOST = {name: np.full(100, np.nan) for name in ensemble(100).metrics} | {"diverged": np.ones(100)}
ALIKE = {name: np.ones(100) for name in ensemble(100).metrics} | {"diverged": np.zeros(100)}
ALL = {"distributions", "over_time", "tornado", "influence"}
CASES = {
    "usual": (ensemble(), ALL),
    "saltelli": (ensemble(500, sampling="saltelli", diverge=0.0), ALL),
    "one entry": (ensemble(entries=ENTRIES[:1]), ALL),
    "nothing varies": (ensemble(entries=(), recorded=0), {"distributions"}),
    "one run": (ensemble(1, diverge=0.0), {"distributions", "over_time"}),
    "all lost": (with_metrics(ensemble(100), **LOST), {"over_time"}),
    "all alike": (with_metrics(ensemble(100), **ALIKE), {"distributions", "over_time"}),
    "never settles": (with_metrics(ensemble(), settling_time=np.full(400, 9.99)), ALL),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", CASES)
def test_every_ensemble_has_its_page_and_its_figures(name: str, tmp_path: Path) -> None:
    result, expected = CASES[name]
    summary = result.summary()
    json.dumps(summary, allow_nan=False)
    *images, page = write_ensemble(result, summary, tmp_path)
    assert {path.stem for path in images} == expected
    text = page.read_text(encoding="utf-8")
    assert text.count("<img") == len(expected)
    assert NASTY not in text
    assert "&lt;b&gt;Ω &amp; more&lt;/b&gt;" in text
    assert "http" not in text.replace("http://www.w3.org", "")
    for row in summary["worst"]:
        assert f'<td class="number">{row["run"]}</td>' in text


def test_figures_show_what_the_summary_says() -> None:
    result = ensemble(2000)
    summary = result.summary()
    drawn = draw_ensemble_figures(result, summary)
    marks: set[str] = set()
    for axes in drawn["distributions"].axes:
        if axes.get_legend():
            marks |= {text.get_text() for text in axes.get_legend().get_texts()}
    rms = summary["metrics"]["rms_tracking"]
    for name, key in (("median", "median"), ("95 %", "p95"), ("99 %", "p99")):
        assert f"{name} {rms[key]['value']:.3g}" in marks
    labels = [text.get_text() for text in drawn["tornado"].axes[0].get_yticklabels()]
    assert labels == list(summary["sensitivities"])
    for figure in drawn.values():
        for axes in figure.axes:
            assert axes.get_xlabel() or axes.get_ylabel() or axes.get_title(loc="left")


def test_units_and_words() -> None:
    info = msgspec.structs.replace(ensemble().info, units=Units(output="mm", input="N"))
    result = dataclasses.replace(ensemble(), info=info)
    units = {
        "rms_tracking": "mm",
        "settling_time": "s",
        "silent_fraction": "1",
        "rms_input": "N",
        "rms_tip": "m",
        "sensor.right[0]": "mm",
        "sensor.right[0] (relative)": "1",
        "plant.x0[0]": "1",
    }
    assert {name: result.unit(name) for name in units} == units


def test_shares_at_0_and_1_have_one_bound() -> None:
    share = {"value": 0.0, "low": 0.0, "high": 0.03}
    assert _format_share(share) == "0 % (3 % or less)"
    assert _format_share({"value": 1.0, "low": 0.97, "high": 1.0}) == "100 % (97 % or more)"
    assert _format_share({"value": 0.5, "low": 0.4, "high": 0.6}) == "50 % [40 %, 60 %]"
