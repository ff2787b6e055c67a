"""Comprehensions stay plain, and public names say what each argument and field is."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

import undeadzone

ROOT = Path(undeadzone.__file__).parent
FILES = sorted(path.relative_to(ROOT) for path in ROOT.rglob("*.py"))
COMPREHENSIONS = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)
STRUCTS = {"msgspec.Struct", "Claims", "JointClaims", "LearnedOptions", "FeedbackOptions"}
ITEM = re.compile(r"^    ?(?:    )?([A-Za-z_][\w, ]*): ")


def tangled(text: str) -> list[int]:
    """The lines of comprehensions with two `for` or with a conditional expression inside."""
    lines = []
    for node in ast.walk(ast.parse(text)):
        if not isinstance(node, COMPREHENSIONS):
            continue
        conditional = any(isinstance(inner, ast.IfExp) for inner in ast.walk(node))
        if len(node.generators) > 1 or conditional:
            lines.append(node.lineno)
    return lines


def nested(text: str) -> list[int]:
    """The lines of conditional expressions inside another one."""
    lines = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.IfExp):
            inner = [part for part in ast.walk(node) if isinstance(part, ast.IfExp)]
            if len(inner) > 1:
                lines.append(node.lineno)
    return lines


def explained(docstring: str, section: str) -> set[str]:
    """The names to which a section of a docstring gives a line: `x, x_hat: ...` gives two."""
    names: set[str] = set()
    inside = False
    for line in docstring.expandtabs().splitlines():
        if line.strip().endswith(":") and line.strip()[:-1] in (
            "Args",
            "Attributes",
            "Returns",
            "Raises",
        ):
            inside = line.strip() == f"{section}:"
            continue
        found = ITEM.match(line.replace("*", "")) if inside else None
        if found:
            names |= {name.strip() for name in found[1].split(",")}
    return names


def is_struct(node: ast.ClassDef) -> bool:
    """Whether a class is a msgspec struct: one itself, or made of another one's fields."""
    return any(ast.unparse(base) in STRUCTS for base in node.bases)


def fields(node: ast.ClassDef) -> list[str]:
    """The fields of a struct."""
    annotated = [item for item in node.body if isinstance(item, ast.AnnAssign)]
    return [item.target.id for item in annotated if isinstance(item.target, ast.Name)]


@pytest.mark.parametrize("path", FILES, ids=str)
def test_comprehensions_hold_one_for_and_no_conditional(path: Path) -> None:
    assert not tangled((ROOT / path).read_text(encoding="utf-8"))


@pytest.mark.parametrize("path", FILES, ids=str)
def test_conditional_expressions_are_not_nested(path: Path) -> None:
    assert not nested((ROOT / path).read_text(encoding="utf-8"))


@pytest.mark.parametrize("path", FILES, ids=str)
def test_structs_explain_their_fields(path: Path) -> None:
    missing = {}
    for node in ast.walk(ast.parse((ROOT / path).read_text(encoding="utf-8"))):
        if isinstance(node, ast.ClassDef) and is_struct(node):
            lines = explained(ast.get_docstring(node) or "", "Attributes")
            missing[node.name] = [name for name in fields(node) if name not in lines]
    assert not {name: names for name, names in missing.items() if names}


PUBLIC = sorted(undeadzone.__all__)


@pytest.mark.parametrize("name", PUBLIC)
def test_public_functions_explain_their_arguments(name: str) -> None:
    found = getattr(undeadzone, name)
    if isinstance(found, type) or not callable(found):
        return
    code = found.__code__
    arguments = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
    doc = "\n".join(line.removeprefix("    ") for line in (found.__doc__ or "").splitlines())
    assert set(arguments) <= explained(doc, "Args"), name


def test_the_measures_see_what_they_should() -> None:
    assert tangled("x = [a for b in c for a in b]")
    assert tangled("x = {a: 1 if a else 2 for a in b}")
    assert not tangled("x = [a for a in b if a]")
    assert nested("x = 1 if a else 2 if b else 3")
    doc = "One.\n\nAttributes:\n    L: gains\n        (n x p): more.\n    x, y: both.\n"
    assert explained(doc, "Attributes") == {"L", "x", "y"}
