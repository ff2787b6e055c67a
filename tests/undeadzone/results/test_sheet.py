"""One table of signals, and one sheet for the numbers of a result."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

from scenes import scene
from undeadzone.interfaces import QUANTITIES, Estimate
from undeadzone.results import sheet
from undeadzone.results.signals import (
    ESTIMATED,
    LOG,
    RUN,
    SERIES,
    SIGNALS,
    Layout,
    Signals,
    last_values,
    signal_unit,
    signals_from_columns,
    signals_from_estimate,
)
from undeadzone.scenario.schema import Units
from undeadzone.simulation.simulate import simulate
from undeadzone.util.arrays import Floats

N = 5
UNITS = Units(output="rad", input="V", state=["rad", "rad/s"])


def signals(layout: Layout) -> dict[str, Floats]:
    """Every signal of a layout, with other numbers in each column."""
    table = {}
    for k, name in enumerate(layout.names):
        shape = (N,) if name in SERIES else (N, 4)
        table[name] = 10.0 * k + np.arange(np.prod(shape), dtype=float).reshape(shape)
    return table


@pytest.mark.parametrize("layout", [RUN, LOG])
def test_columns_and_back(layout: Layout) -> None:
    given = signals(layout)
    columns = Signals(layout, given).columns()
    assert len(columns) == sum(1 if name in SERIES else 4 for name in layout.names)
    again = signals_from_columns(columns, layout)
    assert again.keys() == given.keys()
    for name, value in given.items():
        np.testing.assert_array_equal(again[name], value)


def test_every_quantity_is_a_signal_of_runs_or_of_none() -> None:
    named = {quantity.signal for quantity in QUANTITIES.values()} - {""}
    assert named == set(ESTIMATED)
    assert named <= set(RUN.names)
    assert named - set(LOG.names) == {"consistent", "refused", "restarts"}


def test_a_signal_holds_its_fields_in_turn_and_only_what_is_estimated() -> None:
    parts = {name: np.full((N, 2), float(k)) for k, name in enumerate(Estimate._fields)}
    found = signals_from_estimate(Estimate(**parts))
    assert found.keys() == ESTIMATED.keys()
    right, left = (Estimate._fields.index(name) for name in ("gap_right", "gap_left"))
    np.testing.assert_array_equal(found["c_hat"][0], [right, left, right, left])
    without = signals_from_estimate(Estimate(**parts)._replace(gap_right=np.zeros((N, 0))))
    assert ESTIMATED.keys() - without.keys() == {"c_hat"}
    known = signals_from_estimate(Estimate(**parts)._replace(gap_right_std=np.zeros((N, 0))))
    assert ESTIMATED.keys() - known.keys() == {"c_hat", "c_std"}


def test_final_rows_by_their_kind() -> None:
    last = {
        "c_hat": np.array([[1.0, 2.0, 3.0, 4.0]]),
        "gap_std": np.array([[0.5]]),
        "refused": np.array([[2.0, 3.0]]),
        "consistent": np.array([[1.0]]),
    }
    assert last_values(last, "c_hat", "gap_std", "b_hat", "refused", "consistent") == {
        "gap_right": [1.0, 3.0],
        "gap_left": [2.0, 4.0],
        "gap_std": 0.5,
        "refused": 5,
        "consistent": True,
    }


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("x[1]", "rad/s"),
        ("w_hat[1]", "rad/s/s"),
        ("b_right[0]", "V"),
        ("gap_left_std[0]", "rad"),
        ("d_right_smooth[0]", "rad"),
        ("consistent[0]", "1"),
        ("tip[0]", "m"),
        ("t", "s"),
        ("V", "1"),
    ],
)
def test_units(name: str, unit: str) -> None:
    assert signal_unit(name, UNITS) == unit


def test_signals_refuse_what_is_missing_and_what_is_strange() -> None:
    given = signals(LOG)
    with pytest.raises(TypeError, match="z_hat is missing"):
        Signals(LOG, {name: value for name, value in given.items() if name != "z_hat"})
    with pytest.raises(TypeError, match="tip is not a signal"):
        Signals(LOG, given | {"tip": given["t"]})
    assert set(SIGNALS) == {*RUN.names, *LOG.names}


def test_signals_are_attributes_also_of_a_copy() -> None:
    run = simulate(scene(simulation={"duration": 0.1}))
    for one in (run, copy.copy(run), pickle.loads(pickle.dumps(run))):
        assert one.z.shape == one.z_hat.shape
        assert one.gap_std is None
        assert "gap_std" in dir(one)
        assert not hasattr(one, "B")


def test_a_row_is_defined_once_for_text_and_json() -> None:
    found = {"gap_right": 0.25, "gap_left": 0.5, "gap_std": 0.015}
    found |= {"gap_right_std": 0.01, "gap_left_std": 0.02}
    ((right, left, both),) = sheet.build_width_rows(found, "gap", "rad", (0.24, 0.51))
    assert right.value_in_words == "0.250 [0.230, 0.270] rad (true 0.24)"
    assert left.value_with_interval == "0.500 [0.461, 0.539]"
    assert sheet.rows_to_text([both]) == {
        "gap_right + gap_left": "0.750 [0.721, 0.779] rad (true 0.75)"
    }
    rms = sheet.Row("rms z - r", 0.123456, key="rms", form=".4g", note=" (last 2 s)")
    assert sheet.rows_to_json([rms]) == {"rms": 0.123456}
    assert rms.value_in_words == "0.1235 (last 2 s)"
    assert rms._replace(value=float("inf")).value_in_words == "nan (last 2 s)"


@pytest.mark.parametrize(
    ("low", "high", "words"),
    [
        ("", "", "2"),
        ("1", "", "2 (1 or more)"),
        ("", "3", "2 (3 or less)"),
        ("1", "3", "2 [1, 3]"),
        ("2", "2", "2"),
    ],
)
def test_intervals(low: str, high: str, words: str) -> None:
    assert sheet.format_bounds("2", low, high) == words
