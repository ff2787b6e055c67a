"""The comparison with frozen answers: what counts as a move, and that a wrong change is found."""

from __future__ import annotations

import json
from collections.abc import Iterator
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import pytest
from tests.reference import ask, command, families, fields, records, stored
from tests.reference.compare import BETTER, MOVED, SAME, WORSE, Case, compare_case, judge

from undeadzone_identify.models import lost_motion

# Cheap ones of each kind: a log with its truth, a scenario, a command of its own.
SENTINELS = [
    ("lost_motion", "dial gauge"),
    ("lost_motion", "two encoders, counts"),
    ("run", "firmware"),
    ("commands", "arm"),
]
LARGEST = 300_000  # of all files [bytes]
INTERVAL = [0.5, 0.4, 0.6]


@pytest.mark.parametrize(
    ("field", "before", "after", "truth", "how"),
    [
        ("rate", 1.0, 1.0005, None, SAME),
        ("rate", 1.0, 1.002, None, MOVED),
        ("rate", 1.0, 1.002, 1.1, BETTER),
        ("rate", 1.0, 1.002, 0.9, WORSE),
        ("rate", 1.0, None, 1.0, WORSE),
        ("rate", None, 1.0, None, MOVED),
        ("order", 2, 3, None, MOVED),
        ("certified", True, False, None, MOVED),
        ("poles", [-1.0, 2.0], [-1.0, 2.001], None, SAME),
        ("poles", [-1.0, 2.0], [-1.0, 2.1], None, MOVED),
        ("poles", [-1.0, 2.0], [-1.0], None, MOVED),
        ("odds.play", 0.97, 0.98, 1.0, SAME),
        ("odds.play", 0.9, 0.8, 1.0, WORSE),
        ("false_odds", 0.9, 0.1, 0.0, BETTER),
        ("width", INTERVAL, [0.51, 0.41, 0.61], 0.5, SAME),  # a tenth of the interval is 0.02
        ("width", INTERVAL, [0.53, 0.43, 0.63], None, MOVED),
        ("width", INTERVAL, [0.53, 0.43, 0.63], 0.5, WORSE),
        ("width", INTERVAL, [0.5, 0.45, 0.55], 0.5, BETTER),  # narrower, and holds it
        ("width", INTERVAL, [0.5, 0.3, 0.7], 0.5, WORSE),
        ("width", [0.5, 0.47, 0.53], [0.5, 0.4, 0.6], 0.55, BETTER),  # holds it, at last
        ("width", INTERVAL, [0.5, 0.47, 0.53], 0.55, WORSE),
        ("width", INTERVAL, None, 0.5, WORSE),
        ("width", INTERVAL, None, 0.7, BETTER),  # none is better than a false one
        ("width", [0.5, None, 0.6], [0.5, None, 0.6], 0.5, SAME),
        ("width", [0.5, None, 0.6], [0.5, 0.4, 0.6], 0.5, BETTER),
        ("word", "right", "withheld", None, WORSE),
        ("word", "wrong", "withheld", None, BETTER),
        ("word", "withheld", "right", None, BETTER),
        ("holds", None, True, None, BETTER),
        ("holds", None, False, None, WORSE),
        ("verdict", "play", "none", ["play"], MOVED),
        ("error", None, "TypeError: so", None, WORSE),
        ("error", "TypeError: so", None, None, BETTER),
        ("error", "TypeError: so", "ValueError: so", None, MOVED),
    ],
)
def test_field_moves_for_better_or_for_worse(
    field: str, before: Any, after: Any, truth: Any, how: str
) -> None:
    assert judge(field, before, after, truth) == how


def test_numbers_are_judged_by_their_truth_only_under_the_right_name() -> None:
    assert judge("width", 0.5, 0.6, 0.7, is_right=False) == MOVED


def test_moved_verdict_counts_the_numbers_of_its_case() -> None:
    before = Case({"verdict": "play", "word": "right", "width": 0.5, "odds.play": 0.9}, {})
    after = Case({"verdict": "none", "word": "wrong", "odds.none": 0.9}, {})
    moves = compare_case("names/play 1", before, after)
    assert [(one.how, one.field, one.after) for one in moves] == [
        (MOVED, "verdict", "none"),
        (WORSE, "word", "wrong"),
        (MOVED, "other fields that moved", 3),
    ]
    assert command.sum_up(moves) == WORSE
    assert str(moves[1]) == "worse   names/play 1  word: right -> wrong"


def test_odds_that_are_left_out_are_small() -> None:
    assert not compare_case("a", Case({"odds.none": 0.015}, {}), Case({}, {}))
    assert compare_case("a", Case({"odds.none": 0.5}, {}), Case({}, {}))


def test_moved_truth_is_shown_unless_the_case_failed() -> None:
    before, after = Case({}, {"width": 1.0}), Case({}, {"width": 2.0})
    assert [one.field for one in compare_case("a", before, after)] == ["truth"]
    failed = compare_case("a", before, Case({"error": "ValueError: so"}, {}))
    assert [one.field for one in failed] == ["error"]


def test_json_becomes_rows() -> None:
    value = {
        "schema": 3,
        "poles": [[-1.0, 0.5], [-1.0, -0.5]],
        "width": [0.123456789, 0.1, None],
        "x0": [1.0, 2.0, 3.0],
        "gap": {"value": 1.0, "low": 0.5, "high": None},
        "odds": {"play": 0.99, "none": 1e-5},
        "reasons": ["so"],
        "empty": None,
        "states": ["rad", "rad/s"],
        "front": [{"rate": float(k), "of": [k]} for k in range(20)],
        "boards": [{"board": "Uno", "fits": True}],
        "claims": [{"id": "a", "works": True, "words": "so"}],
    }
    assert fields.flatten(value) == {
        "poles": [-1.0, 0.5, -1.0, -0.5],
        "width": [0.123457, 0.1, None],
        **{"x0.0": 1.0, "x0.1": 2.0, "x0.2": 3.0},
        "gap": [1.0, 0.5, None],
        "odds.play": 0.99,
        "states": "rad, rad/s",
        **{"front.rate.count": 20, "front.rate.lowest": 0.0, "front.rate.highest": 19.0},
        **{"front.of.count": 20, "front.of.lowest": 0.0, "front.of.highest": 19.0},
        **{"boards.0.board": "Uno", "boards.0.fits": True},
        "claims.a.works": True,
    }


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--write", " ", "--only", "arm"], "the reason is missing"),
        (["--compare", "--only", "nothing of this"], "no case matches"),
        (["--compare", "--jobs", "0"], "expected 1 or more"),
    ],
)
def test_bad_input_is_refused(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command.main(words) == command.REFUSED
    assert message in capsys.readouterr().err


@pytest.mark.parametrize("words", [[], ["--write"], ["--compare", "--write", "so"]])
def test_one_of_compare_and_write_is_needed(words: list[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        command.main(words)
    assert ended.value.code == command.REFUSED


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder in the place of the frozen answers."""
    monkeypatch.setattr(stored, "FOLDER", tmp_path / "answers")
    monkeypatch.setattr(command, "commit", lambda: "abc")
    return tmp_path / "answers"


def answering(monkeypatch: pytest.MonkeyPatch, **answers: dict[str, Any]) -> None:
    """Put one family, `drawn`, whose cases have these fields, in the place of all."""

    def of_case(name: str) -> fields.Answer:
        return fields.Answer(answers[name], {"word": ["right"]})

    drawn = {"drawn": families.Family(of_case, lambda: answers)}
    monkeypatch.setattr(ask, "FAMILIES", drawn)
    monkeypatch.setattr(families, "FAMILIES", drawn)


def test_reasons_are_kept_and_a_part_is_written_over(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    answering(monkeypatch, a={"rate": 1.0}, b={"rate": 2.0})
    assert command.main(["--write", "first", "--jobs", "1"]) == command.DONE
    assert command.main(["--compare", "--jobs", "1"]) == command.DONE
    answering(monkeypatch, a={"rate": 3.0}, c={"rate": 4.0})
    assert command.main(["--compare", "--jobs", "1", "--json"]) == command.DIFFERS
    text = capsys.readouterr().out
    found = json.loads(text[text.index("{") :])
    assert found["families"]["drawn"] | {"cpu": 0.0} == {
        **{"n": 3, "same": 0, "better": 0, "worse": 0, "moved": 3, "cpu": 0.0}
    }
    titles = [(one["case"], one["field"], one["after"]) for one in found["moves"]]
    assert titles == [("drawn/a", "rate", 3.0), ("drawn/c", "case", "new"),
                      ("drawn/b", "case", "gone")]  # fmt: skip
    assert command.main(["--write", "second", "--only", "a", "--jobs", "1"]) == command.DONE
    frozen = stored.read_frozen("drawn", folder)
    assert [row[1:] for row in frozen.written] == [["abc", "first"], ["abc", "second (--only a)"]]
    assert {name: one.fields["rate"] for name, one in frozen.cases.items()} == {"a": 3.0, "b": 2.0}


def test_failing_case_is_stored(monkeypatch: pytest.MonkeyPatch) -> None:
    answering(monkeypatch, a={"rate": 1.0})
    every = ask.ask_cases([("drawn", "a"), ("drawn", "of no family")])
    assert every["drawn", "a"].fields == {"rate": 1.0}
    assert every["drawn", "of no family"].fields == {"error": "KeyError: 'of no family'"}


def test_dying_process_loses_its_own_case_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    def answers(chosen: list[ask.Name], jobs: int) -> Iterator[tuple[ask.Name, Case]]:
        for one in chosen:
            if one[1] == "deadly":
                raise BrokenProcessPool
            yield one, Case({"rate": 1.0}, {})

    monkeypatch.setattr(ask, "_answers_of_pool", answers)
    every = ask.ask_cases([("drawn", name) for name in ("a", "deadly", "b")], jobs=2)
    assert every["drawn", "deadly"].fields == {"error": ask.DIED}
    assert every["drawn", "a"].fields == every["drawn", "b"].fields == {"rate": 1.0}


def test_records_that_are_not_there_are_skipped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(records, "FOLDER", tmp_path / "nowhere")
    assert command.main(["--compare", "--only", "records"]) == command.DONE
    assert "the records are not there" in capsys.readouterr().err


def test_all_cases_are_frozen_with_a_reason() -> None:
    for family, one in families.FAMILIES.items():
        frozen = stored.read_frozen(family)
        assert frozen.written, family
        assert all(len(row) == 3 and all(row) for row in frozen.written), family
        if not one.find_obstacle():
            assert set(frozen.cases) == set(one.list_cases()), family
    assert sum(path.stat().st_size for path in stored.FOLDER.iterdir()) < LARGEST


def test_sentinels_answer_as_frozen() -> None:
    moves = command.find_moves(ask.ask_cases(SENTINELS), is_whole=False)
    assert sum(len(every) for every in moves.values()) == len(SENTINELS)
    assert not [str(move) for every in moves.values() for one in every for move in one]


def test_wrong_sign_is_found(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    squares = lost_motion._sum_squares_by_start
    monkeypatch.setattr(lost_motion, "_sum_squares_by_start", lambda found: -squares(found))
    words = ["--compare", "--only", "lost_motion/d*", "--jobs", "1"]
    assert command.main(words) == command.DIFFERS
    assert "worse   lost_motion/dial gauge  word: right -> wrong" in capsys.readouterr().out
