"""Nodes as C99: expressions with parentheses wherever precedence is not plain, and statements."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from typing import Final, NamedTuple

import numpy as np

from undeadzone.compile.elementary import FUNCTIONS, formula
from undeadzone.compile.graph import Node, Results, needed, uses
from undeadzone.compile.simplify import held

WIDTH: Final = 100  # columns of a line
LONGEST: Final = 150  # characters of an expression that is not split into locals
SMALL: Final = 300  # nodes up to which no sum or product stands in a selection (MISRA 12.1)
INDENT: Final = "    "
TYPES: Final = {
    "float64": "double",
    "float32": "float",
    "uint64": "uint64_t",
    "uint32": "uint32_t",
    "bool": "bool",
}
_SIGNS: Final = {
    **{"add": "+", "sub": "-", "mul": "*", "div": "/", "lt": "<", "le": "<=", "eq": "=="},
    **{"ne": "!=", "and": "&", "or": "|", "xor": "^", "shl": "<<", "shr": ">>"},
}
_OF_TRUTHS: Final = {"and": "&&", "or": "||", "ne": "!="}
_SUMS: Final = ("+", "-")
_ALIKE: Final = ("*", "&&", "||")  # what goes without parentheses in its own operands


class Style(NamedTuple):
    """How numbers and functions are written.

    Attributes:
        kind: NumPy's name of the type of numbers.
        prefix: what the names of the export's own functions begin with.
    """

    kind: str
    prefix: str

    @property
    def real(self) -> str:
        """The type of a number in C."""
        return TYPES[self.kind]


class Text(NamedTuple):
    """An expression.

    Attributes:
        text: the expression.
        sign: its outermost operator; empty: it needs no parentheses anywhere.
    """

    text: str
    sign: str = ""

    @property
    def inside(self) -> str:
        """It as a part of a selection."""
        return f"({self.text})" if self.sign else self.text

    def operand(self, sign: str, second: bool = False) -> str:
        """It as an operand; only sums of sums, products of products and the like go plain."""
        if self.sign == "neg" and not second:
            return self.text
        alike = sign in _ALIKE and self.sign == sign
        alike = alike or (sign in _SUMS and self.sign in _SUMS)
        return self.text if alike and not second else self.inside


def literal(value: float, kind: str) -> str:
    """A number; its text means these bits and no others, beyond the type its largest number."""
    return _number(held(value, kind), kind)


def _number(value: float, kind: str) -> str:
    """A number that its type holds."""
    sign, size = "-" if math.copysign(1.0, value) < 0 else "", abs(value)
    single = kind == "float32"
    short, limits = ("FLT", np.finfo(kind)) if single else ("DBL", np.finfo(kind))
    if not math.isfinite(value):
        text = "NAN" if math.isnan(value) else f"{sign}INFINITY"
        return text if single else f"(double){text}"
    if size == limits.max:
        return f"{sign}{short}_MAX"
    if single and size == limits.tiny:
        return f"{sign}FLT_MIN"
    text = str(np.float32(size)) if single else repr(size)
    whole = text if "." in text or "e" in text else f"{text}.0"
    return f"{sign}{whole}{'f' if single else ''}"


class _Expressions:
    """The expressions of nodes.

    Args:
        style: how numbers and functions are written.
        inputs: the expression of each input, by its name.

    Attributes:
        names: the locals that hold nodes.
        functions: those of the export that are used so far.
    """

    def __init__(self, style: Style, inputs: dict[str, str]) -> None:
        self.style, self.inputs = style, inputs
        self.names: dict[Node, str] = {}
        self.functions: set[str] = set()

    def text(self, node: Node) -> Text:
        """A node."""
        if node in self.names:
            return Text(self.names[node])
        if node.op == "input":
            return Text(self.inputs[node.text])
        if node.op == "const":
            return _constant(node)
        return self._composed(node, [self.text(arg) for arg in node.args])

    def _composed(self, node: Node, args: list[Text]) -> Text:
        """An instruction on its operands."""
        if node.op == "select":
            truth, yes, no = (arg.inside for arg in args)
            return Text(f"{truth} ? {yes} : {no}", "?")
        if node.op == "neg":
            return Text(f"-{args[0].operand('neg', second=True)}", "neg")
        if node.op == "not":
            return Text(f"!{args[0].inside}", "!")
        if node.op in ("call", "view"):
            return Text(f"{self._function(node)}({', '.join([arg.text for arg in args])})")
        signs = _OF_TRUTHS if node.args[0].kind == "bool" else _SIGNS
        sign = signs[node.op]
        return Text(f"{args[0].operand(sign)} {sign} {args[1].operand(sign, second=True)}", sign)

    def _function(self, node: Node) -> str:
        """The name of a function; if it is the export's own, it is noted as used."""
        name = node.text or ("number" if node.is_real else "bits")
        if node.op == "call" and name not in FUNCTIONS:  # of the C library, exact by IEEE 754
            return f"{name}f" if self.style.kind == "float32" else name
        self.functions.add(name)
        return f"{self.style.prefix}_{name}"


def _constant(node: Node) -> Text:
    """What is written down."""
    if node.kind == "bool":
        return Text("true" if node.value else "false")
    if not node.is_real:
        number = int(node.text)
        return Text(f"{number}u" if number < 256 else f"0x{number:x}u")
    text = _number(float(node.text), node.kind)
    return Text(text, "neg" if text.startswith("-") else "")


# --- Statements


class Names(NamedTuple):
    """What inputs and results are called.

    Attributes:
        inputs: the expression of each input, by its name.
        results: for each result, where each of its entries goes (an lvalue).
        locals: for each result, the local that holds each of its entries.
        meanings: further names of locals.
    """

    inputs: dict[str, str]
    results: list[list[str]]
    locals: list[list[str]]
    meanings: dict[Node, str]


class Body(NamedTuple):
    """The statements of a function.

    Attributes:
        lines: the statements, indented and wrapped.
        functions: the export's own functions that they call.
    """

    lines: list[str]
    functions: set[str]


def body(results: Results, style: Style, names: Names) -> Body:
    """The statements that compute results and store them."""
    labels: dict[Node, str] = {}  # the first result of a node names it
    for nodes, wanted in zip(results, names.locals, strict=True):
        for node, name in zip(nodes, wanted, strict=True):
            if node.args:
                labels.setdefault(node, name)
    expressions = _Expressions(style, names.inputs)
    lines = _locals(results, expressions, names.meanings | labels)
    if lines:
        lines.append("")
    for nodes, targets in zip(results, names.results, strict=True):
        for node, target in zip(nodes, targets, strict=True):
            lines += _wrapped(f"{target} = {expressions.text(node).text};")
    return Body(lines, expressions.functions)


def _locals(results: Results, expressions: _Expressions, labels: dict[Node, str]) -> list[str]:
    """The statements that make the locals; `expressions` knows their names from then on."""
    counts = uses(results)
    order = sorted(counts, key=lambda node: node.number)
    apart = _apart(order)
    lines: list[str] = []
    for node in order:
        if not node.args:
            continue
        text = expressions.text(node).text
        if counts[node] > 1 or node in labels or node in apart or len(text) > LONGEST:
            name = labels.get(node, f"v{node.number}")
            lines += _wrapped(f"const {TYPES[node.kind]} {name} = {text};")
            expressions.names[node] = name
    return lines


def _apart(order: list[Node]) -> set[Node]:
    """What is computed before a selection, not inside it."""
    apart: set[Node] = set()
    small = len(order) <= SMALL
    for node in order:
        for arg in node.args[1:] if node.op == "select" else ():
            if arg.op == "select" or arg.text in FUNCTIONS or (small and arg.op in _SIGNS):
                apart.add(arg)
    return apart


def _wrapped(statement: str) -> list[str]:
    """A statement in lines of at most `WIDTH` columns, broken before operators and after commas."""
    line = INDENT + statement
    lines: list[str] = []
    while len(line) > WIDTH:
        cut = _break(line)
        if cut < 0:
            break
        lines.append(line[:cut].rstrip())
        line = 2 * INDENT + line[cut:].lstrip()
    return [*lines, line]


def _break(line: str) -> int:
    """Where to break a line that is too long; -1: nowhere."""
    start = 2 * len(INDENT) + 4
    best = -1
    for sign in ("+", "-", "*", "/", "?", ":", "&&", "||", "="):
        best = max(best, line.rfind(f" {sign} ", start, WIDTH - 1))
    comma = line.rfind(", ", start, WIDTH - 1)
    return max(best, comma + 1 if comma >= 0 else -1)


# --- Elementary functions

_VIEW: Final = """/** {meaning} */
static inline {to} {prefix}_{name}({of} x)
{{
    {to} same;
    (void)memcpy(&same, &x, sizeof same);
    return same;
}}"""


def functions(names: Iterable[str], used: set[str], style: Style) -> list[str]:
    """The texts of elementary functions, ahead of them those of a number's bits that are used.

    Args:
        names: of the functions, each after those that it calls.
        used: the functions that other code calls.
        style: how numbers and functions are written.
    """
    texts, called = [], set(used)
    for name in names:
        shape = formula(name, style.kind)
        expressions = _Expressions(style, {text: text for text in shape.inputs})
        lines = _locals([[shape.result]], expressions, {})
        lines += _wrapped(f"return {expressions.text(shape.result).text};")
        arguments = ", ".join(f"{style.real} {text}" for text in shape.inputs)
        head = f"static {style.real} {style.prefix}_{name}({arguments})"
        texts.append("\n".join([_commented(name), head, "{", *lines, "}"]))
        called |= expressions.functions
    word = "uint32_t" if style.kind == "float32" else "uint64_t"
    views = {
        "bits": ("The bits of a number.", word, style.real),
        "number": ("The number that has these bits.", style.real, word),
    }
    heads = []
    for name, (meaning, to, of) in views.items():
        if name in called:
            heads.append(
                _VIEW.format(meaning=meaning, to=to, of=of, name=name, prefix=style.prefix)
            )
    return heads + texts


def _commented(name: str) -> str:
    """The comment of a function."""
    return f"/** {str(FUNCTIONS[name].__doc__).strip()} */"


def inputs_of(results: Results) -> set[str]:
    """The names of the inputs on which results depend."""
    return {node.text for node in needed(itertools.chain(*results)) if node.op == "input"}
