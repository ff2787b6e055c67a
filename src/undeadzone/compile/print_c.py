"""Nodes as text: expressions, with parentheses where precedence is not plain, and statements.

The language is C99, or another one by its `Grammar`.
"""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Callable, Iterable
from typing import Final, NamedTuple

import numpy as np

from undeadzone.compile.elementary import FUNCTIONS, OF_WORDS, FunctionSet, build_elementary
from undeadzone.compile.graph import LANGUAGES, Node, Results, count_uses, required_nodes
from undeadzone.compile.schedule import order_depth_first
from undeadzone.compile.simplify import round_to_type

WIDTH: Final = 100  # columns of a line
LONGEST: Final = 150  # characters of an expression that is not split into locals
SMALL: Final = 300  # nodes up to which no sum or product stands in a selection (MISRA 12.1)
INDENT: Final = "    "
TYPES, _SIGNS, _OF_TRUTHS = LANGUAGES["c"].values()
_SUMS: Final = ("+", "-")
_ALIKE: Final = ("*", "&&", "||", "AND", "OR")  # go without parentheses in their own operands
_BREAKS: Final = ("+", "-", "*", "/", "?", ":", "=", *_ALIKE[1:])


class Grammar(NamedTuple):
    """Differences between the target languages.

    Attributes:
        types: of values, by NumPy's names.
        number_operators: operators on numbers and words, by instruction.
        boolean_operators: operators on truth values, by instruction.
        negation: text before a truth value that is negated.
        own: functions that an export brings along.
        constant: function that writes a constant.
        library: the name of a function that every compiler has, in a type of numbers.
        apart: of nodes in order, those that a local holds, however they are used.
        statement: what fills the local of a node.
    """

    types: dict[str, str]
    number_operators: dict[str, str]
    boolean_operators: dict[str, str]
    negation: str
    own: FunctionSet
    constant: Callable[[Node], Text]
    library: Callable[[str, str], str]
    apart: Callable[[list[Node]], set[Node]]
    statement: Callable[[str, Node, Expressions], list[str]]


class Text(NamedTuple):
    """Expression with its outermost operator.

    Attributes:
        text: the expression.
        sign: its outermost operator (empty: it needs no parentheses anywhere).
    """

    text: str
    sign: str = ""

    @property
    def in_parentheses(self) -> str:
        """Return the expression as a part of a selection."""
        return f"({self.text})" if self.sign else self.text

    def as_operand(self, sign: str, second: bool = False) -> str:
        """Return the expression as an operand. Only sums in sums and products in products
        lack parentheses.
        """
        if self.sign == "neg" and not second:
            return self.text
        alike = sign in _ALIKE and self.sign == sign
        alike = alike or (sign in _SUMS and self.sign in _SUMS)
        return self.text if alike and not second else self.in_parentheses


def c_literal(value: float, kind: str) -> str:
    """Return the text of a number, clipped to the type's range. The text represents exactly
    these bits.
    """
    return _c_number(round_to_type(value, kind), kind)


def _c_number(value: float, kind: str) -> str:
    """Return the text of a number that its type can represent."""
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


class Expressions:
    """Writer of the expressions of nodes.

    Args:
        style: how numbers and functions are written.
        inputs: the expression of each input, by its name.

    Attributes:
        names: the locals that hold nodes.
        functions: those of the export that are used so far.
        read: the inputs whose expressions were written.
        calls: what writes the calls of repeated parts.
    """

    calls: Callable[[str, Node, Expressions], list[str]]

    def __init__(self, style: Style, inputs: dict[str, str]) -> None:
        self.style, self.inputs = style, inputs
        self.read: set[str] = set()
        self.names: dict[Node, str] = {}
        self.functions: set[str] = set()
        self._written: dict[Node, Text] = {}

    def write_node(self, node: Node) -> Text:
        """Return the expression of a node, written once. Locals among its operands are
        named before.
        """
        if node in self.names:
            return Text(self.names[node])
        if node not in self._written:
            self._written[node] = self._write_expression(node)
        return self._written[node]

    def _write_expression(self, node: Node) -> Text:
        """Return the expression of a node that is not a local."""
        if node.op == "input":
            self.read.add(node.text)
            return Text(self.inputs[node.text])
        if node.op == "const":
            return self.style.language.constant(node)
        return self._compose_instruction(node, list(map(self.write_node, node.args)))

    def _compose_instruction(self, node: Node, args: list[Text]) -> Text:
        """Return the expression of an instruction on its operands."""
        if node.op == "select":
            truth, yes, no = (arg.in_parentheses for arg in args)
            return Text(f"{truth} ? {yes} : {no}", "?")
        if node.op == "neg":
            return Text(f"-{args[0].as_operand('neg', second=True)}", "neg")
        language = self.style.language
        if node.op == "not":
            return Text(f"{language.negation}{args[0].in_parentheses}", "!")
        if node.op in ("call", "view"):
            return Text(f"{self._function_name(node)}({', '.join([arg.text for arg in args])})")
        operators = (
            language.boolean_operators if node.args[0].kind == "bool" else language.number_operators
        )
        sign = operators[node.op]
        return Text(
            f"{args[0].as_operand(sign)} {sign} {args[1].as_operand(sign, second=True)}", sign
        )

    def _function_name(self, node: Node) -> str:
        """Return the name of a function, and record the export's own functions as used."""
        name, language = node.text or ("number" if node.is_real else "bits"), self.style.language
        if node.op == "call" and name not in language.own.functions:  # exact by IEEE 754
            return language.library(name, self.style.kind)
        self.functions.add(name)
        return f"{self.style.prefix}_{name}"


def _c_constant(node: Node) -> Text:
    """Return the text of a constant."""
    if node.kind == "bool":
        return Text("true" if node.constant_value else "false")
    if not node.is_real:
        number = int(node.text)
        return Text(f"{number}u" if number < 256 else f"0x{number:x}u")
    text = _c_number(float(node.text), node.kind)
    return Text(text, "neg" if text.startswith("-") else "")


# --- Statements


class Names(NamedTuple):
    """Names of inputs and results.

    Attributes:
        inputs: the expression of each input, by its name.
        results: for each result, where each of its entries goes (an lvalue).
        locals: for each result, the local that holds each of its entries.
        meanings: further names of locals.
        in_place: the input that is stored in the place of a result, by that lvalue. Its expression
            is a local.
        calls: writer of the calls of repeated parts (None: there are none).
    """

    inputs: dict[str, str]
    results: list[list[str]]
    locals: list[list[str]]
    meanings: dict[Node, str]
    in_place: dict[str, str]
    calls: Callable[[str, Node, Expressions], list[str]] | None = None


class Body(NamedTuple):
    """Statements of a function.

    Attributes:
        lines: the statements, indented and wrapped.
        functions: the export's own functions that they call.
    """

    lines: list[str]
    functions: set[str]


def build_body(results: Results, style: Style, names: Names) -> Body:
    """Return the statements that compute results and store them.

    In long bodies an input is read at its first use, and a result is stored once it is computed and
    the value that it overwrites is used no more. So fewer values are alive at a time.
    """
    labels: dict[Node, str] = {}  # the first result of a node names it
    for nodes, local_names in zip(results, names.locals, strict=True):
        for node, name in zip(nodes, local_names, strict=True):
            if node.args:
                labels.setdefault(node, name)
    expressions = Expressions(style, names.inputs)
    if names.calls is not None:
        expressions.calls = names.calls
    found = find_locals(results, expressions, names.meanings | labels)
    end, used = len(found), _uses_of_inputs(found, results)
    number = {local.node: k for k, local in enumerate(found)}
    short = len(required_nodes(itertools.chain(*results))) <= SMALL
    ahead, behind = defaultdict[int, list[str]](list), defaultdict[int, list[str]](list)
    for nodes, targets in zip(results, names.results, strict=True):
        for node, target in zip(nodes, targets, strict=True):
            text = expressions.write_node(node).text
            last = max(used.get(names.in_place.get(target, ""), [0]))
            at = end if short else max(number.get(node, end), last)
            behind[at] += wrap_statement(f"{target} = {text};") if text != target else []
    for place, name in names.in_place.items():
        if name in expressions.read:
            first = 0 if short else min(used[name])
            ahead[first] += wrap_statement(
                f"const {style.real_type} {names.inputs[name]} = {place};"
            )
    if short and ahead[0]:
        ahead[0].append("")
    lines: list[str] = []
    for k, local in enumerate(found):
        lines += [*ahead[k], *local.lines, *behind[k]]
    lines += [*ahead[end], ""] if found else ahead[end]
    return Body([*lines, *behind[end]], expressions.functions)


def _uses_of_inputs(found: list[Local], results: Results) -> dict[str, list[int]]:
    """Return the numbers of the locals that use each input, by input name.

    The number of locals stands for a use by a result.
    """
    at, used = {local.node: k for k, local in enumerate(found)}, defaultdict[str, list[int]](list)
    for node in reversed(required_nodes(itertools.chain(*results))):
        for arg in node.args:
            place = at.get(node, len(found))
            at.setdefault(arg, place)  # a part of the expression that uses it
            if arg.op == "input":
                used[arg.text].append(place)
    for node in itertools.chain(*results):
        if node.op == "input":
            used[node.text].append(len(found))
    return used


class Local(NamedTuple):
    """Local variable that holds a node.

    Attributes:
        name: its name.
        node: the node that it stores.
        lines: the statement that fills it.
    """

    name: str
    node: Node
    lines: list[str]


def find_locals(results: Results, expressions: Expressions, labels: dict[Node, str]) -> list[Local]:
    """Return the locals, each after the locals that it needs. `expressions` gets their names.

    Args:
        results: the nodes.
        expressions: how they are written.
        labels: names of some nodes, which then have a local.
    """
    language = expressions.style.language
    counts = count_uses(results)
    order = sorted(counts, key=lambda node: node.number)
    apart = language.apart(order) | labels.keys()
    if len(order) > SMALL:
        order = order_depth_first(order, list(itertools.chain(*results)))
    found: list[Local] = []
    for node in order:
        if node.op == "input" or node in expressions.names:  # result of a call
            continue
        often = node.op == "apply" or (bool(node.args) and counts[node] > 1)
        if often or node in apart or len(expressions.write_node(node).text) > LONGEST:
            name = labels.get(node, f"v{node.number}")
            found.append(Local(name, node, language.statement(name, node, expressions)))
            expressions.names[node] = name
    return found


def local_statements(found: list[Local]) -> list[str]:
    """Return the statements that fill locals."""
    return list(itertools.chain(*[local.lines for local in found]))


def _c_declaration(name: str, node: Node, expressions: Expressions) -> list[str]:
    """Return the declaration of a local in C, or a call."""
    if node.op == "apply":
        return expressions.calls(name, node, expressions)
    return wrap_statement(f"const {TYPES[node.kind]} {name} = {expressions.write_node(node).text};")


def _nodes_before_selections(order: list[Node]) -> set[Node]:
    """Return the nodes that are computed before a selection and not inside it."""
    apart: set[Node] = set()
    small = len(order) <= SMALL
    for node in order:
        for arg in node.args[1:] if node.op == "select" else ():
            if arg.op == "select" or arg.text in FUNCTIONS or (small and arg.op in _SIGNS):
                apart.add(arg)
    return apart


def wrap_statement(statement: str, indent: str = INDENT) -> list[str]:
    """Return a statement in lines of at most `WIDTH` columns, split before operators and after
    commas.
    """
    line = indent + statement
    lines: list[str] = []
    while len(line) > WIDTH:
        cut = _break_column(line)
        if cut < 0:
            break
        lines.append(line[:cut].rstrip())
        line = indent + INDENT + line[cut:].lstrip()
    return [*lines, line]


def _break_column(line: str) -> int:
    """Return the column at which to split a line that is too long, or -1."""
    start = 2 * len(INDENT) + 4
    places = [line.rfind(f" {sign} ", start, WIDTH - 1) for sign in _BREAKS]
    comma = line.rfind(", ", start, WIDTH - 1)
    return max(*places, comma + 1 if comma >= 0 else -1)


def _c_library_name(name: str, kind: str) -> str:
    """Return the name of a C library function in a type of numbers."""
    return f"{name}f" if kind == "float32" else name


C: Final = Grammar(
    TYPES,
    _SIGNS,
    _OF_TRUTHS,
    "!",
    OF_WORDS,
    _c_constant,
    _c_library_name,
    apart=_nodes_before_selections,
    statement=_c_declaration,
)


class Style(NamedTuple):
    """Style of numbers and functions.

    Attributes:
        kind: NumPy's name of the type of numbers.
        prefix: first part of the names of the export's own functions.
        language: its grammar.
    """

    kind: str
    prefix: str
    language: Grammar = C

    @property
    def real_type(self) -> str:
        """Return the name of the type of numbers."""
        return self.language.types[self.kind]


# --- Elementary functions

_VIEW: Final = """/** {meaning} */
static inline {to} {prefix}_{name}({of} x)
{{
    {to} same;
    (void)memcpy(&same, &x, sizeof same);
    return same;
}}"""


def elementary_texts(names: Iterable[str], used: set[str], style: Style) -> list[str]:
    """Return the texts of elementary functions, after the bit-access functions that they use.

    Args:
        names: of the functions, each after those that it calls.
        used: the functions that other code calls.
        style: how numbers and functions are written.
    """
    texts, called = [], set(used)
    for name in names:
        part = build_elementary(name, style.kind)
        expressions = Expressions(style, {node.text: node.text for node in part.inputs})
        lines = local_statements(find_locals([part.results], expressions, {}))
        lines += wrap_statement(f"return {expressions.write_node(part.results[0]).text};")
        arguments = ", ".join(f"{style.real_type} {node.text}" for node in part.inputs)
        head = f"static {style.real_type} {style.prefix}_{name}({arguments})"
        texts.append("\n".join([_function_comment(name), head, "{", *lines, "}"]))
        called |= expressions.functions
    word = TYPES["uint32" if style.kind == "float32" else "uint64"]
    heads = []
    for name, meaning, to, of in (
        ("bits", "The bits of a number.", word, style.real_type),
        ("number", "The number that has these bits.", style.real_type, word),
    ):
        if name in called:
            view = _VIEW.format(meaning=meaning, to=to, of=of, name=name, prefix=style.prefix)
            heads.append(view)
    return heads + texts


def _function_comment(name: str) -> str:
    """Return the comment of a function."""
    return f"/** {str(FUNCTIONS[name].__doc__).strip()} */"
