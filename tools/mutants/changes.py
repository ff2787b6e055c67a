"""The places of a file that can be changed, and the file with one of them changed."""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

BINARY: Final[dict[type[ast.operator], type[ast.operator]]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Pow: ast.Mult,
}
COMPARED: Final[dict[type[ast.cmpop], type[ast.cmpop]]] = {
    ast.Lt: ast.GtE,
    ast.LtE: ast.Gt,
    ast.Gt: ast.LtE,
    ast.GtE: ast.Lt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
NAMES: Final = {
    "max": "min",
    "min": "max",
    "maximum": "minimum",
    "minimum": "maximum",
    "fmax": "fmin",
    "fmin": "fmax",
    "sin": "cos",
    "cos": "sin",
    "any": "all",
    "all": "any",
    "real": "imag",
}
TOLERANCE: Final = 1e-5  # smaller constants are tolerances, of which twice as much is no mistake
PICTURES: Final = ("report/", "figures.py", "diagrams.py")  # their constants are looks alone
NEGATED: Final = (ast.Compare, ast.BoolOp, ast.UnaryOp)  # conditions that are changed themselves
SKIPPED: Final = (ast.Raise, ast.Assert, ast.AnnAssign, ast.JoinedStr, ast.arguments)


class Place(NamedTuple):
    """A place that can be changed.

    Attributes:
        file: relative to the folder of all packages.
        number: of the node, in the order of `ast.walk`.
        line: in the file, from 1.
        what: the change in words.
    """

    file: str
    number: int
    line: int
    what: str


def places(root: Path, file: str) -> list[Place]:
    """All places of a file."""
    tree = ast.parse((root / file).read_text(encoding="utf-8"))
    skipped = _skipped(tree)
    found = []
    for number, node in enumerate(ast.walk(tree)):
        if id(node) in skipped:
            continue
        looks = isinstance(node, ast.Constant) and any(part in file for part in PICTURES)
        changed = None if looks else _changed(node)
        if changed is not None:
            what = f"{_heading(node)} -> {_heading(changed)}"
            found.append(Place(file, number, node.lineno, what))
    return found


def mutant(root: Path, place: Place) -> ast.Module:
    """The tree of a file with one place changed."""
    tree = ast.parse((root / place.file).read_text(encoding="utf-8"))
    for number, node in enumerate(ast.walk(tree)):
        if number == place.number:
            changed = _changed(node)
            assert changed is not None
            node.__class__ = changed.__class__
            node.__dict__.update(changed.__dict__)
            break
    return ast.fix_missing_locations(tree)


def _heading(node: ast.AST) -> str:
    """The text of a node; of a statement with a body the first line."""
    return ast.unparse(node).partition("\n")[0]


def _skipped(tree: ast.Module) -> set[int]:
    """What is not changed: messages, annotations, which length of a shape is meant."""
    skipped = set()
    for node in ast.walk(tree):
        if isinstance(node, SKIPPED) and not _of_value(node):
            skipped |= {id(inner) for inner in ast.walk(node)}
        if isinstance(node, ast.Subscript) and _is_shape(node.value):
            skipped |= {id(inner) for inner in ast.walk(node.slice)}
        if isinstance(node, ast.FunctionDef) and node.returns is not None:
            skipped |= {id(inner) for inner in ast.walk(node.returns)}
    return skipped


def _is_shape(node: ast.expr) -> bool:
    """Whether a node is the shape of an array: most are square, and have one length alone."""
    return isinstance(node, ast.Attribute) and node.attr == "shape"


def _of_value(node: ast.AST) -> bool:
    """Whether an annotated assignment inside a function: its value is arithmetic as any other."""
    return isinstance(node, ast.AnnAssign) and node.value is not None and node.col_offset > 0


def _changed(node: ast.AST) -> ast.expr | ast.stmt | None:
    """A node changed; None where it is of no kind that is."""
    new = copy.copy(node)
    if isinstance(new, ast.If) and not isinstance(new.test, NEGATED) and not _for_types(new.test):
        new.test = ast.copy_location(ast.UnaryOp(ast.Not(), new.test), new.test)
        return new
    if isinstance(new, ast.IfExp):
        new.body, new.orelse = new.orelse, new.body
        return new
    if isinstance(new, ast.AugAssign) and type(new.op) in BINARY:
        new.op = BINARY[type(new.op)]()
        return new
    if isinstance(new, ast.BinOp) and type(new.op) in BINARY and not _text(new):
        new.op = BINARY[type(new.op)]()
        return new
    if isinstance(new, ast.Compare) and type(new.ops[0]) in COMPARED:
        new.ops = [COMPARED[type(new.ops[0])](), *new.ops[1:]]
        return new
    if isinstance(new, ast.BoolOp):
        new.op = ast.Or() if isinstance(new.op, ast.And) else ast.And()
        return new
    if isinstance(new, ast.UnaryOp) and isinstance(new.op, (ast.USub, ast.Not)):
        return _copied(new.operand)
    if isinstance(new, ast.Attribute) and new.attr in NAMES:
        new.attr = NAMES[new.attr]
        return new
    if isinstance(new, ast.Name) and new.id in NAMES and isinstance(new.ctx, ast.Load):
        new.id = NAMES[new.id]
        return new
    return _other_number(new)


def _for_types(test: ast.expr) -> bool:
    """Whether a branch is for a type checker alone."""
    return isinstance(test, ast.Name) and test.id == "TYPE_CHECKING"


def _copied(node: ast.expr) -> ast.expr:
    """A node of its own."""
    return copy.deepcopy(node)


def _other_number(node: ast.AST) -> ast.expr | None:
    """A constant changed: twice as much, or one more."""
    if not isinstance(node, ast.Constant) or type(node.value) not in (int, float):
        return None
    value = node.value
    if isinstance(value, float) and 0 < abs(value) < TOLERANCE:
        return None
    new = copy.copy(node)
    new.value = value + 1 if isinstance(value, int) or value == 0 else 2 * value
    return new


def _text(node: ast.BinOp) -> bool:
    """Whether an operation is on text."""
    return any(
        isinstance(side, ast.JoinedStr)
        or (isinstance(side, ast.Constant) and isinstance(side.value, str))
        for side in (node.left, node.right)
    )


def files(root: Path, rooms: tuple[str, ...]) -> Iterator[str]:
    """The files of rooms, relative to the folder of all packages."""
    for room in rooms:
        paths = [root / room] if room.endswith(".py") else sorted((root / room).rglob("*.py"))
        for path in paths:
            if path.name != "__init__.py":
                yield str(path.relative_to(root))
