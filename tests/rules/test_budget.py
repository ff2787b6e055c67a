"""The house stays small: syntax nodes of a room, files, and pages that say things once."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import node_budget
import pytest
import source_measures
from benchmarks.markdown import parted
from node_budget import Budget

import undeadzone
from requirements import needs, require

ROOT = Path(undeadzone.__file__).parent
HOME = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"  # stand there in a wheel, and are no room
FILES = sorted(path for path in ROOT.rglob("*.py") if EXAMPLES not in path.parents)
MOST_FILES = 235
CODE = """'''A file.'''

import os  # imports are free

# a remark
x: int = 1  # [m]


def f(a: float) -> float:
    '''Words.

    More.
    '''
    return (
        a
    )
"""


def test_words_imports_and_annotations_have_no_nodes() -> None:
    """Module, assignment, x, 1; function, its arguments and a; return and a."""
    assert source_measures.count_nodes(CODE) == 9
    assert source_measures.count_nodes("x = 1\ndef f(a): return a") == 9
    assert source_measures.count_nodes("x, y = 1, 2") > source_measures.count_nodes("x = 1")


def test_every_room_keeps_to_its_budget() -> None:
    """So an idea that is written twice is noticed when it is written.

    `tests/rules/nodes.toml` holds the budgets, of the folders beside src too.
    """
    budget, nodes = node_budget.read_budget(), node_budget.measure_rooms()
    assert budget.src.keys() == nodes.src.keys()
    assert budget.beside.keys() == nodes.beside.keys()
    assert min(nodes.beside.values()) > 500, "a folder of node_budget.FOLDERS is gone"
    above, loose = node_budget.compare_budget(budget, nodes)
    assert not above
    assert not loose, "run python tests/rules/node_budget.py --lower"
    assert len(FILES) <= MOST_FILES


def test_no_budget_rises_but_by_what_another_room_gives() -> None:
    """The table of the working tree has no higher sum than any version of the main line in git."""
    history = node_budget.read_history()
    require("git", [] if history else ["the history of nodes.toml"])
    assert not node_budget.find_raises(history, node_budget.read_budget())


def test_rooms_of_the_tool_and_packages_beside_it_are_distinguished() -> None:
    assert node_budget.name_room("undeadzone/observers/parts/gain.py") == "observers"
    assert node_budget.name_room("undeadzone/errors.py") == node_budget.TOP
    assert node_budget.name_room("undeadzone_identify/logs/grid.py") == "undeadzone_identify"


BUDGET = Budget(src={"ends": 100, "cli": 200}, beside={"tests": 50, "fuzz": 20})
ROOMS = Budget(src={"ends": 81, "cli": 195}, beside={"tests": 45, "fuzz": 20})


def test_a_lowered_budget_falls_and_never_rises() -> None:
    nodes = {"ends": 81, "cli": 210}
    lowered = node_budget.lower_budget({"ends": 100, "cli": 200, "gone": 60}, nodes)
    assert lowered == {"ends": 90, "cli": 200}
    beside = {"tests": 30, "fuzz": 21}
    assert node_budget.compare_budget(BUDGET, Budget(nodes, beside)) == (
        ["cli: 210 nodes, budget 200", "fuzz: 21 nodes, budget 20"],
        ["tests: 30 nodes, budget 50"],
    )


def test_a_new_room_takes_the_budget_of_a_removed_one() -> None:
    nodes = Budget({"zones": 61, "cli": 200}, ROOMS.beside)
    with pytest.raises(ValueError, match="zones: a new room needs a budget"):
        node_budget.lower_budget(BUDGET.src, nodes.src)
    moved = node_budget.move_budget(BUDGET, nodes, "ends=zones:100")
    assert node_budget.lower_budget(moved.src, nodes.src) == {"zones": 70, "cli": 200}


@pytest.mark.parametrize(
    ("moves", "change"),
    [
        (["ends=cli:15"], {"src": {"ends": 85, "cli": 215}}),
        (["tests=fuzz:50"], {"beside": {"tests": 0, "fuzz": 70}}),
        (["cli=ends:30", "ends=cli:10"], {"src": {"ends": 120, "cli": 180}}),
    ],
)
def test_moved_budgets_have_the_same_sum(
    moves: list[str], change: dict[str, dict[str, int]]
) -> None:
    budget = BUDGET
    for move in moves:
        budget = node_budget.move_budget(budget, ROOMS, move)
    assert budget == BUDGET._replace(**change)
    assert budget.sums == BUDGET.sums
    assert not node_budget.find_raises([BUDGET], budget)


@pytest.mark.parametrize(
    ("move", "message"),
    [
        ("ends=cli:101", "expected 1 to 100 nodes"),
        ("ends=cli:-5", "expected 1 to 100 nodes"),
        ("ends=cli:0", "expected 1 to 100 nodes"),
        ("ends=zones:5", "two rooms of src"),
        ("ends=cli", "two rooms of src"),
        ("doors=cli:5", "two rooms of src"),
        ("tests=cli:5", "two rooms of src or two beside it"),
    ],
)
def test_a_move_from_nothing_or_across_src_is_refused(move: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        node_budget.move_budget(BUDGET, ROOMS, move)


@pytest.mark.parametrize(
    ("change", "raised"),
    [
        ({"src": {"ends": 110, "cli": 200}}, ["src: 310 nodes, 300 before: lower rooms by 10"]),
        ({"src": {"ends": 110, "cli": 190}}, []),
        ({"src": {"ends": 110, "cli": 200}, "beside": {"tests": 40, "fuzz": 20}},
         ["src: 310 nodes, 300 before: lower rooms by 10"]),
        ({"beside": {"tests": 51, "fuzz": 20}}, ["beside: 71 nodes, 70 before: lower rooms by 1"]),
    ],
)  # fmt: skip
def test_a_raise_is_found_unless_its_side_of_src_pays(
    change: dict[str, dict[str, int]], raised: list[str]
) -> None:
    higher = Budget({"ends": 500}, {"tests": 500})
    assert node_budget.find_raises([higher, BUDGET, higher], BUDGET._replace(**change)) == raised


@needs("git", "git")
def test_the_script_refuses_a_raise_before_and_after_its_commit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(node_budget, "TABLE", tmp_path / "nodes.toml")
    monkeypatch.setattr(node_budget, "measure_rooms", lambda: ROOMS)

    def commit() -> None:
        node_budget.run_git(["git", "add", "."])
        who = ["-c", "user.name=a", "-c", "user.email=a@b.invalid", "-c", "commit.gpgsign=false"]
        node_budget.run_git(["git", *who, "commit", "-qm", "Budgets"])

    node_budget.run_git(["git", "init", "-q"])
    node_budget.TABLE.write_text('"ends" = 1\n\n"cli" = 1\n')  # before the freeze
    assert node_budget.read_history() == []
    commit()
    node_budget.write_budget(BUDGET)
    commit()
    assert node_budget.read_budget() == BUDGET
    assert node_budget.read_history() == [BUDGET]
    assert node_budget.main(["--move", "cli=ends:5"]) == 0
    commit()
    raised = BUDGET._replace(src={"ends": 145, "cli": 195})
    node_budget.write_budget(raised)
    assert node_budget.main([]) == 1
    assert "src: 340 nodes, 300 before: lower rooms by 40" in capsys.readouterr().err
    commit()
    assert node_budget.main([]) == 1
    assert len(node_budget.read_history()) == 3
    assert node_budget.main(["--move", "tests=fuzz:2", "--lower"]) == 0
    lowered = Budget({"ends": 90, "cli": 195}, {"tests": 48, "fuzz": 20})
    assert node_budget.read_budget() == lowered
    with pytest.raises(SystemExit):
        node_budget.main(["--move", "cli=ends:196"])


def test_the_architecture_page_names_existing_code() -> None:
    """Names of docs/architecture.md are in the code, and every package has a line there."""
    page = (HOME / "docs" / "architecture.md").read_text(encoding="utf-8")
    assert len(page.splitlines()) <= 200
    named = set(re.findall(r"`((?:\w+/)*\w+)\.([A-Z_]\w+(?:\.\w+)?|[a-z_]\w*)`", page))
    assert len(named) > 50
    missing = []
    for place, name in sorted(named):
        first = place.split("/")[0]
        root = ROOT.parent if first.startswith("undeadzone_") else ROOT
        if not (root / first).is_dir() and not (root / f"{first}.py").exists():
            continue  # `pyproject.toml`, `Online.update`
        path = root / f"{place}.py"
        if not path.exists() or not defines(path, name):
            missing.append(f"{place}.{name}")
    assert not missing
    rooms = {path.relative_to(ROOT).parts[0] for path in FILES if path.parent != ROOT}
    assert {room for room in rooms if f"| `{room}` |" not in page} == set()


def defines(path: Path, name: str) -> bool:
    """Whether a file defines a name, such as `run` or `Online.update`."""
    body = ast.parse(path.read_text(encoding="utf-8")).body
    for part in name.split("."):
        found = [node for node in body if part in names_of(node)]
        if not found:
            return False
        body = getattr(found[0], "body", [])
    return True


def names_of(node: ast.stmt) -> list[str]:
    """What a statement defines."""
    if isinstance(node, ast.ClassDef | ast.FunctionDef):
        return [node.name]
    if isinstance(node, ast.AnnAssign):
        return [ast.unparse(node.target)]
    if isinstance(node, ast.Assign):
        return [ast.unparse(target) for target in node.targets]
    return []


def test_a_decision_is_a_reason_and_no_report() -> None:
    """Six lines at most; numbers stand in benchmarks/RESULTS.md."""
    pages = sorted((HOME / "docs").glob("decisions*.md"))
    text = "".join(page.read_text(encoding="utf-8") for page in pages)
    entries = re.findall(r"^\* .*(?:\n  .*)*", text, flags=re.MULTILINE)
    long = [entry.splitlines()[0] for entry in entries if len(entry.splitlines()) > 6]
    assert len(entries) > 30
    assert not long


def test_known_gaps_stay_short() -> None:
    """Limits by symptom, at most 75 lines; figures belong to the results of the benchmarks."""
    lines = (HOME / "KNOWN_GAPS.md").read_text(encoding="utf-8").splitlines()
    body = lines[lines.index(next(line for line in lines if line.startswith("## "))) :]
    assert all(line.startswith(("- ", "  ", "## ")) for line in body if line)
    assert max(map(len, lines)) <= 120
    assert sum(map(bool, lines)) <= 75


def test_every_table_of_results_names_the_commit_of_its_code() -> None:
    """`python -m benchmarks --write` does so; what decisions weighed was measured at the time."""
    sections = parted((HOME / "benchmarks" / "RESULTS.md").read_text(encoding="utf-8"))
    assert len(sections) > 40
    named = re.compile(r"\b(commit|[Aa]t) [0-9a-f]{7,8}\b")
    unnamed = [title for title, text in sections.items() if not named.search(text)]
    summary = "## Summary: best and worst figure of each subject"
    assert set(unnamed) <= {summary, "## Numbers behind decisions"}
