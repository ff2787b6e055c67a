"""The house stays small: lines of code a room, files, and pages that say things once."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections import Counter
from pathlib import Path

from benchmarks.markdown import parted

import once
import undeadzone

ROOT = Path(undeadzone.__file__).parent
HOME = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"  # stand there in a wheel, and are no room
FILES = sorted(path for path in ROOT.rglob("*.py") if EXAMPLES not in path.parents)
MOST_CODE, MOST_FILES = 30_883, 268
# Lines of code of the packages beside the tool, which are none of it: what leaves a room for one of
# them is counted there.
BESIDE = {
    "undeadzone_arena": 4253,
    "undeadzone_export": 2483,
    "undeadzone_identify": 7918,
    "undeadzone_paper": 1622,
}
# Lines of code a room may have. Raising one takes an entry in docs/decisions.md; docstrings,
# comments and blank lines are free, so that nobody saves by saying less.
BUDGET = {
    "(root)": 387,
    "analysis": 3370,
    "cli": 1543,
    "compensators": 147,
    "compile": 3782,
    "controllers": 785,
    "ends": 420,
    "ensemble": 1832,
    "feedforward": 419,
    "linear": 399,
    "logs": 1206,
    "numerics": 841,
    "observers": 3798,
    "plants": 1608,
    "report": 2428,
    "results": 917,
    "scenario": 1432,
    "signals": 383,
    "simulation": 2200,
    "statistics": 265,
    "support": 897,
    "synthesis": 990,
    "tuning": 835,
}
SILENT = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
}
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


def code_lines(text: str) -> int:
    """The lines of a text that hold code: no docstrings, comments or blank lines."""
    held: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in SILENT:
            held.update(range(token.start[0], token.end[0] + 1))
    for node in once.nodes(text):
        if isinstance(node, DOCUMENTED) and ast.get_docstring(node, clean=False) is not None:
            first = node.body[0]
            held.difference_update(range(first.lineno, (first.end_lineno or first.lineno) + 1))
    return len(held)


TEXT = """'''A file.'''

# a remark
x = 1  # [m]


def f():
    '''Words.

    More.
    '''
    return (
        x
    )
"""


def test_lines_of_code_are_counted_without_words() -> None:
    assert code_lines(TEXT) == 5


def test_every_room_keeps_to_its_budget() -> None:
    """So an idea that is written twice is noticed when it is written."""
    used: Counter[str] = Counter()
    for path in FILES:
        inner = path.relative_to(ROOT).parts
        used[inner[0] if len(inner) > 1 else "(root)"] += code_lines(
            path.read_text(encoding="utf-8")
        )
    beyond = {
        room: f"{lines} of {BUDGET.get(room, 0)}"
        for room, lines in used.items()
        if lines > BUDGET.get(room, 0)
    }
    assert not beyond, f"lines of code beyond the budget: {beyond}"
    assert used.keys() == BUDGET.keys()
    assert sum(used.values()) <= MOST_CODE
    assert len(FILES) <= MOST_FILES


def test_the_packages_beside_the_tool_keep_to_theirs() -> None:
    used = {}
    for package in ROOT.parent.glob("undeadzone_*"):
        texts = [path.read_text(encoding="utf-8") for path in package.rglob("*.py")]
        used[package.name] = sum(map(code_lines, texts))
    assert used.keys() == BESIDE.keys()
    assert not {name: lines for name, lines in used.items() if lines > BESIDE[name]}


def test_the_page_of_the_house_names_what_is_there() -> None:
    """Every `room/file.name` of docs/house.md is in the code, and every room has a line there."""
    page = (HOME / "docs" / "house.md").read_text(encoding="utf-8")
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


def test_a_gap_is_one_line() -> None:
    """Grouped by who is hurt."""
    lines = (HOME / "KNOWN_GAPS.md").read_text(encoding="utf-8").splitlines()
    body = lines[lines.index(next(line for line in lines if line.startswith("## "))) :]
    assert all(line.startswith(("- ", "## ")) for line in body if line)
    assert max(map(len, lines)) <= 115


def test_every_table_of_results_names_the_commit_of_the_code_that_made_it() -> None:
    """`python -m benchmarks --write` does so; what decisions weighed was measured at the time."""
    sections = parted((HOME / "benchmarks" / "RESULTS.md").read_text(encoding="utf-8"))
    assert len(sections) > 40
    named = re.compile(r"\b(commit|[Aa]t) [0-9a-f]{7,8}\b")
    unnamed = [title for title, text in sections.items() if not named.search(text)]
    assert unnamed == ["## Numbers behind decisions"]
