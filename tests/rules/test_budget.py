"""The house stays small: syntax nodes of a room, files, and pages that say things once."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import node_budget
import pytest
import source_measures
from benchmarks.markdown import parted

import undeadzone

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

    `tests/rules/nodes.toml` holds the budgets. Raising one takes an entry in docs/decisions.md.
    """
    budget, nodes = node_budget.read_budget(), node_budget.measure_rooms()
    assert budget.keys() == {*nodes, node_budget.TOTAL}
    above, loose = node_budget.compare_budget(budget, nodes)
    assert not above
    assert not loose, "run python tests/rules/node_budget.py --lower"
    assert len(FILES) <= MOST_FILES


def test_rooms_of_the_tool_and_packages_beside_it_are_distinguished() -> None:
    assert node_budget.name_room("undeadzone/observers/parts/gain.py") == "observers"
    assert node_budget.name_room("undeadzone/errors.py") == node_budget.TOP
    assert node_budget.name_room("undeadzone_identify/logs/grid.py") == "undeadzone_identify"


def test_a_budget_falls_and_never_rises() -> None:
    budget = {"ends": 100, "cli": 200, "gone": 60, node_budget.TOTAL: 360}
    lowered = node_budget.lower_budget(budget, {"ends": 81, "cli": 210})
    assert lowered == {"ends": 90, "cli": 200, node_budget.TOTAL: 300}
    assert node_budget.compare_budget(budget, {"ends": 81, "cli": 210}) == (
        ["cli: 210 nodes, budget 200"],
        ["(total): 291 nodes, budget 360"],
    )


def test_a_new_room_takes_the_budget_of_a_removed_one() -> None:
    budget = {"ends": 100, "cli": 200, node_budget.TOTAL: 300}
    nodes = {"zones": 61, "limits": 30, "cli": 200}
    with pytest.raises(ValueError, match="limits, zones: a new room needs a budget"):
        node_budget.lower_budget(budget, nodes)
    split = node_budget.rename_rooms(budget, nodes, [("ends", "zones"), ("ends", "limits")])
    assert split == {"zones": 70, "limits": 30, "cli": 200, node_budget.TOTAL: 300}
    merged = node_budget.rename_rooms(budget, {"cli": 250}, [("ends", "cli")])
    assert merged == {"cli": 300, node_budget.TOTAL: 300}
    with pytest.raises(ValueError, match="still exists"):
        node_budget.rename_rooms(budget, nodes, [("cli", "zones")])


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
    text = (HOME / "docs" / "decisions.md").read_text(encoding="utf-8")
    entries = re.split(r"^\* ", text, flags=re.MULTILINE)[1:]
    long = [entry.splitlines()[0] for entry in entries if len(entry.strip().splitlines()) > 6]
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
