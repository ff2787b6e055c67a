"""Comprehensions stay plain, and public names say what each argument and field is."""

from __future__ import annotations

import ast
import inspect
import re
from pathlib import Path

import once
import undeadzone
import undeadzone_arena
import undeadzone_design
import undeadzone_export
import undeadzone_identify
import undeadzone_paper
import undeadzone_studies

PACKAGES = (
    undeadzone,
    undeadzone_arena,
    undeadzone_design,
    undeadzone_export,
    undeadzone_identify,
    undeadzone_paper,
    undeadzone_studies,
)
FILES = [
    path
    for package in PACKAGES
    for path in sorted(Path(str(package.__file__)).parent.rglob("*.py"))
]
TEXTS = {str(path): path.read_text(encoding="utf-8") for path in FILES}
COMPREHENSIONS = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)
STRUCTS = {
    "msgspec.Struct",
    "Options",
    "Kind",
    "Coasts",
    "Assumptions",
    "JointClaims",
    "LearnedOptions",
    "FeedbackOptions",
}
ITEM = re.compile(r"^    ?(?:    )?([A-Za-z_][\w, ]*): ")


def tangled(text: str) -> list[int]:
    """The lines of comprehensions with two `for` or with a conditional expression inside."""
    lines = []
    for node in once.nodes(text):
        if not isinstance(node, COMPREHENSIONS):
            continue
        conditional = any(isinstance(inner, ast.IfExp) for inner in ast.walk(node))
        if len(node.generators) > 1 or conditional:
            lines.append(node.lineno)
    return lines


def nested(text: str) -> list[int]:
    """The lines of conditional expressions inside another one."""
    lines = []
    for node in once.nodes(text):
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


def test_comprehensions_hold_one_for_and_no_conditional() -> None:
    found = {path: tangled(text) for path, text in TEXTS.items()}
    assert not {path: lines for path, lines in found.items() if lines}


def test_conditional_expressions_are_not_nested() -> None:
    found = {path: nested(text) for path, text in TEXTS.items()}
    assert not {path: lines for path, lines in found.items() if lines}


def unexplained(text: str) -> dict[str, list[str]]:
    """The fields of each struct to which its docstring gives no line."""
    missing = {}
    for node in once.nodes(text):
        if isinstance(node, ast.ClassDef) and is_struct(node):
            lines = explained(ast.get_docstring(node) or "", "Attributes")
            missing[node.name] = [name for name in fields(node) if name not in lines]
    return {name: names for name, names in missing.items() if names}


def test_structs_explain_their_fields() -> None:
    found = {path: unexplained(text) for path, text in TEXTS.items()}
    assert not {path: names for path, names in found.items() if names}


def unsaid(found: object) -> set[str]:
    """The arguments of a public function to which its docstring gives no line."""
    if isinstance(found, type) or not callable(found):
        return set()
    code = found.__code__
    arguments = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
    return set(arguments) - explained(inspect.getdoc(found) or "", "Args")


def test_public_functions_explain_their_arguments() -> None:
    found = {}
    for package in (
        undeadzone, undeadzone_design, undeadzone_export, undeadzone_identify, undeadzone_studies
    ):  # fmt: skip
        found |= {name: unsaid(getattr(package, name)) for name in package.__all__}
    assert {"identify", "export", "simulate", "check", "tune"} <= found.keys()
    assert not {name: arguments for name, arguments in found.items() if arguments}


NAMES_ELSEWHERE = {  # in single words: of Python, of other packages, of files, and examples
    *("Class", "StateSpace", "__file__", "control", "csv", "dir", "format", "matplotlibrc"),
    *("d_left_error", "d_right_error", "module", "npz", "openat2", "parquet", "pyi", "pyproject"),
    *("scipy", "ss", "t_ms", "tf", "uz", "voltage"),
}


def defined(tree: ast.Module) -> set[str]:
    """Names that other files can mean: functions, classes, fields, attributes, module's names."""
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            names.add(node.attr)
    bodies = [tree, *(node for node in ast.walk(tree) if isinstance(node, ast.ClassDef))]
    for statement in (one for body in bodies for one in body.body):
        targets = statement.targets if isinstance(statement, ast.Assign) else []
        targets = [statement.target] if isinstance(statement, ast.AnnAssign) else targets
        for target in targets:
            names |= {one.id for one in ast.walk(target) if isinstance(one, ast.Name)}
    return names


def mentioned(tree: ast.Module) -> set[str]:
    """Names that a file uses, arguments, keywords and words of short texts among them."""
    names: set[str] = set()
    for node in ast.walk(tree):
        match node:
            case ast.Name(id=name) | ast.Attribute(attr=name) | ast.arg(arg=name):
                names.add(name)
            case ast.keyword(arg=str(name)):
                names.add(name)
            case ast.alias(name=name, asname=other):
                names |= {*name.split("."), other or name}
            case ast.Constant(value=str(text)) if len(text) < 60 and "\n" not in text:
                names |= set(re.findall(r"\w+", text))
    return names


def unknown_names(docstring: str, known: set[str]) -> set[str]:
    """Names in backticks that nothing has; phrases in backticks are none."""
    quoted = [one for one in re.findall(r"`([^`\n]+)`", docstring) if " " not in one.strip()]
    words = {word for one in quoted for word in re.findall(r"[A-Za-z_][A-Za-z_0-9]+", one)}
    return words - known - NAMES_ELSEWHERE


def test_names_in_docstrings_exist() -> None:
    """A renamed function is renamed in what is said of it."""
    trees = {name: ast.parse(text) for name, text in TEXTS.items()}
    everywhere = {part for name in TEXTS for part in Path(name).with_suffix("").parts}
    everywhere |= {name for tree in trees.values() for name in defined(tree)}
    stale = []
    for file, tree in trees.items():
        known = everywhere | mentioned(tree)
        for node in ast.walk(tree):
            if isinstance(node, ast.Module | ast.FunctionDef | ast.ClassDef):
                lost = unknown_names(ast.get_docstring(node) or "", known)
                stale += [f"{file}: {name}" for name in sorted(lost)]
    assert stale == []


def test_the_measures_see_what_they_should() -> None:
    assert tangled("x = [a for b in c for a in b]")
    assert tangled("x = {a: 1 if a else 2 for a in b}")
    assert not tangled("x = [a for a in b if a]")
    assert nested("x = 1 if a else 2 if b else 3")
    doc = "One.\n\nAttributes:\n    L: gains\n        (n x p): more.\n    x, y: both.\n"
    assert explained(doc, "Attributes") == {"L", "x", "y"}
