"""Source trees as the rules measure them: each file is read, parsed and walked once.

`test_language.py`, `node_budget.py` and `tests/test_budget.py` share this module.
"""

from __future__ import annotations

import ast
import functools
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

HOME = Path(__file__).resolve().parents[2]
SRC = HOME / "src"
OUTSIDE = frozenset({"examples", "test", "tests"})  # folders that are no part of a package
UNCOUNTED_FIELDS = frozenset({"annotation", "returns", "ctx"})
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
DOCUMENTED = (ast.Module, ast.ClassDef, *FUNCTIONS)
COMPREHENSIONS = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)
COLLECTED = frozenset(
    {*DOCUMENTED, *COMPREHENSIONS, ast.Assign, ast.Call, ast.Constant, ast.IfExp, ast.JoinedStr}
    | {ast.Raise, ast.keyword}
)


class Source(NamedTuple):
    """One file of Python.

    Attributes:
        path: path from the root of the tree, with slashes.
        text: contents.
        size: number of syntax nodes, as `count_nodes` counts them.
        found: nodes of the types in `COLLECTED`, by type.
    """

    path: str
    text: str
    size: int
    found: dict[type[ast.AST], list[Any]]

    def select(self, *kinds: type[ast.AST]) -> list[Any]:
        """Return the collected nodes of the given types."""
        return [node for kind in kinds for node in self.found.get(kind, ())]


@functools.cache
def read_sources(root: Path = SRC) -> tuple[Source, ...]:
    """Read all Python files below a folder of packages, or of one package.

    Examples and tests are left out. Paths begin with the name of the package.
    """
    home = root.parent if (root / "__init__.py").exists() else root
    paths = [path.relative_to(home) for path in sorted(root.rglob("*.py"))]
    return tuple(
        parse_source(path.as_posix(), (home / path).read_text(encoding="utf-8"))
        for path in paths
        if OUTSIDE.isdisjoint(path.parts)
    )


def parse_source(path: str, text: str) -> Source:
    """Parse a text and walk its syntax tree once."""
    size, found = 0, dict[type[ast.AST], list[Any]]()
    for node in walk_counted(ast.parse(text)):
        size += 1
        kind = type(node)
        if kind in COLLECTED:
            found.setdefault(kind, []).append(node)
    for nodes in found.values():
        nodes.sort(key=lambda node: getattr(node, "lineno", 0))
    return Source(path, text, size, found)


def walk_counted(tree: ast.AST) -> Iterator[Any]:
    """Yield the syntax nodes that count: no docstrings, imports, annotations or contexts."""
    waiting: list[Any] = [tree]
    while waiting:
        node = waiting.pop()
        kind = type(node)
        if kind is ast.Import or kind is ast.ImportFrom:
            continue
        if kind is ast.Expr and type(node.value) is ast.Constant:
            continue
        yield node
        if kind is ast.JoinedStr:  # Python 3.12 adds empty texts to formats
            waiting += [part for part in node.values if getattr(part, "value", None) != ""]
            continue
        for field in node._fields:
            if field in UNCOUNTED_FIELDS:
                continue
            value = getattr(node, field, None)
            if type(value) is list:
                waiting += [part for part in value if isinstance(part, ast.AST)]
            elif isinstance(value, ast.AST):
                waiting.append(value)


def count_nodes(text: str) -> int:
    """Count the syntax nodes of a text, without docstrings, imports and annotations.

    A name, a constant, an operator, a call and a statement are one node each. Line breaks, comments
    and the length of names change nothing.
    """
    return sum(1 for _ in walk_counted(ast.parse(text)))


def count_code_lines(source: Source) -> int:
    """Count the lines that contain code: no docstrings, comments or blank lines."""
    lines = set()
    for number, line in enumerate(source.text.splitlines(), 1):
        code = line.strip()
        if code and not code.startswith("#"):
            lines.add(number)
    for node in source.select(ast.Constant, ast.JoinedStr):  # "#" and blank lines of strings
        lines.update(range(node.lineno, node.end_lineno + 1))
    for node in source.select(*DOCUMENTED):
        if ast.get_docstring(node, clean=False) is not None:
            first = node.body[0]
            lines.difference_update(range(first.lineno, first.end_lineno + 1))
    return len(lines)
