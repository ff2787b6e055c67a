"""Scenarios changed key by key, saved and read again, and the words of other tools in them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import undeadzone as uz
from scenes import scene, table
from undeadzone.errors import InputError, ShapeError
from undeadzone.scenario.reader import parse
from undeadzone.util import toml


def test_replace_changes_one_key_and_leaves_the_rest() -> None:
    before = scene()
    after = before.replace("sensor.right", 1.25)
    assert np.asarray(after.sensor.right) == 1.25
    assert toml.to_toml(after.replace("sensor.right", before.sensor.right)) == toml.to_toml(before)
    assert np.asarray(before.sensor.right) != 1.25


def test_replace_takes_one_entry_of_a_matrix() -> None:
    before = scene("""
        plant = { A = [[0, 1], [-1, -2]], B = [[0], [1]], C = [[1, 0]] }
        """)
    after = before.replace("plant.A[1,0]", -3.0)
    np.testing.assert_array_equal(after.plant.A, [[0, 1], [-3, -2]])
    with pytest.raises(InputError, match=r"plant\.A\[5,0\]: no such entry"):
        before.replace("plant.A[5,0]", 1.0)
    with pytest.raises(InputError, match=r"plant\.A: has no entry \[0\]"):
        before.replace("plant.A[0]", 1.0)


def test_tables_merge_unless_they_become_others() -> None:
    before = scene(observer={"method": "certified", "gamma": 7.0, "width_max": 4.0})
    same = before | {"observer": {"gamma": 8.0}}
    assert same.observer.width_max == 4.0
    other = before | {"observer": {"method": "luenberger", "poles": [-3.0, -4.0]}}
    assert isinstance(other.observer, uz.Luenberger)
    assert (before | {"observer": uz.Kalman(right=[0, 2], left=[0, 2])}).observer.right == [0, 2]
    assert (before | {"disturbance": None}).disturbance is None


@pytest.mark.parametrize(
    ("address", "value", "message"),
    [
        ("sensor.rigth", 1.0, r"sensor\.rigth: unknown key. Did you mean 'right'"),
        ("sensr.right", 1.0, "sensr: unknown key. Did you mean sensor"),
        ("sensor.right", "wide", r"sensor\.right: expected numbers"),
        ("sensor.right", float("nan"), r"sensor\.right: must be a finite number"),
        ("observer.method", "kalmann", r"observer\.method: unknown choice"),
        ("sensor right", 1.0, "expected a key such as"),
        ("simulation", 3, "simulation: expected a table"),
    ],
)
def test_what_cannot_be_is_named(address: str, value: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        scene().replace(address, value)


def test_a_saved_scenario_is_read_as_it_was(tmp_path: Path) -> None:
    before = scene(sensor={"right": 0.1 + 0.2, "left": 0.3})
    path = before.save(tmp_path / "mine.toml")
    assert toml.to_toml(uz.read(path)) == toml.to_toml(before)
    assert str(before) == path.read_text()


def test_plain_lists_and_matlab_matrices_are_accepted_if_unambiguous() -> None:
    full = uz.Plant(A=[[0, 1], [-1, -2]], B=[[0], [1]], C=[[1, 0]])
    for plant in (
        uz.Plant(A=[[0, 1], [-1, -2]], B=[0, 1], C=[1, 0]),
        uz.Plant(A="[0 1; -1 -2]", B="[0; 1]", C="[1, 0]"),
    ):
        expected, same = (uz.to_scipy(one) for one in (full, plant))
        for name in "ABC":
            np.testing.assert_array_equal(getattr(same, name), getattr(expected, name))
    with pytest.raises(ShapeError, match=r"plant\.B"):
        uz.to_scipy(uz.Plant(A=[[0, 1], [-1, -2]], B=[0, 1, 0], C=[1, 0]))


@pytest.mark.parametrize("text", ["0 1; 2", "[0 x]", "[1 2; 3]", "[]"])
def test_text_that_is_no_matrix_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"plant\.A"):
        uz.to_scipy(uz.Plant(A=text, B=[0, 1], C=[1, 0]))


def test_matlabs_matrix_without_quotes_is_explained() -> None:
    with pytest.raises(InputError, match=r"line 2, .*write A = \[\[0, 1\], \[-1, -2.5\]\]"):
        parse("[plant]\nA = [0 1; -1 -2.5]   # mine\n")
    with pytest.raises(InputError, match=r"line 1, column \d+: not valid TOML") as caught:
        parse("[plant\nA = 1\n")
    assert "write" not in str(caught.value)


@pytest.mark.parametrize(
    ("where", "key", "advice"),
    [
        ("simulation", "dt", r"simulation\.step"),
        ("simulation", "Ts", r"simulation\.step"),
        ("plant", "D", "feedthrough"),
        ("sensor", "upper", r"sensor\.right"),
        ("plant", "num", "numerator"),
    ],
)
def test_words_of_other_tools_are_explained(where: str, key: str, advice: str) -> None:
    data = table()
    data[where] = dict(data[where]) | {key: 1.0}
    with pytest.raises(InputError, match=rf"{where}\.{key}: unknown key. .*{advice}"):
        parse(toml.tomli_w.dumps(data))


def test_errors_name_the_file_and_editors_marks_are_skipped(tmp_path: Path) -> None:
    marked = tmp_path / "marked.toml"
    marked.write_bytes(b"\xef\xbb\xbf" + toml.to_toml(scene()).encode())
    assert uz.read(marked).title == scene().title
    wrong = tmp_path / "wrong.toml"
    wrong.write_text("[plant]\nq = 1\n")
    with pytest.raises(InputError, match=rf"^{wrong}: "):
        uz.read(wrong)
