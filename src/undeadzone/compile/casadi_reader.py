"""Reader of a CasADi SX function, instruction by instruction, into nodes or values of any kind."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any, Final, NamedTuple, Protocol

import casadi as ca

from undeadzone.compile.graph import LANES, STEADY, Node, Nodes, Results
from undeadzone.errors import InputError

# CasADi's numbers of instructions as words: add of OP_ADD.
_WORDS: Final = {getattr(ca, word): word[3:].lower() for word in dir(ca) if word[:3] == "OP_"}
ARITHMETIC: Final = ("add", "sub", "mul", "div", "neg")
COMPARISONS: Final = ("lt", "le", "eq", "ne")
# Functions that a call names, of one number and of two.
OF_ONE: Final = (
    *("exp", "expm1", "log", "log1p", "erf", "sin", "cos", "tan", "asin", "acos", "atan"),
    *("sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "sqrt", "fabs", "floor", "ceil", "sign"),
)
OF_TWO: Final = ("pow", "atan2", "hypot", "copysign", "fmod", "remainder", "fmin", "fmax")
_SAME: Final = ("assign", "lift")
_KNOWN: Final = {
    *(*ARITHMETIC, *COMPARISONS, *OF_ONE, *OF_TWO, *_SAME),
    *("inv", "sq", "twice", "constpow", "not", "and", "or", "if_else_zero"),
}


class Line(NamedTuple):
    """Instruction of a CasADi function.

    Attributes:
        word: its name, "call" of a function, or "part", a result of a call.
        operands: numbers of earlier lines.
        leaf: name and entry of an input, value of a constant, function that is called, number of a
            result.
    """

    word: str
    operands: tuple[int, ...] = ()
    leaf: Any = None


class Program(NamedTuple):
    """CasADi function as a list of instructions, each of which needs earlier instructions
    only.

    Attributes:
        title: of the function.
        lines: the instructions.
        results: the lines that each output consists of.
    """

    title: str
    lines: list[Line]
    results: list[list[int]]


def read_program(function: ca.Function) -> Program:
    """Return the instructions of a function with dense outputs.

    Every line is assigned once, unlike the places of CasADi's work vector.
    """
    lines: list[Line] = []
    holds: dict[int, int] = {}  # the line that a place of the work vector holds
    results = [[0] * function.nnz_out(i) for i in range(function.n_out())]
    for k in range(function.n_instructions()):
        word = _WORDS[function.instruction_id(k)]
        sources = function.instruction_input(k)
        targets = function.instruction_output(k)
        if word == "output":
            results[targets[0]][targets[1]] = holds[sources[0]]
            continue
        if word == "input":
            line = Line(word, leaf=(function.name_in(sources[0]), sources[1]))
        elif word == "const":
            line = Line(word, leaf=function.instruction_constant(k))
        else:
            line = Line(word, tuple(holds[source] for source in sources))
        if word == "call":
            line = line._replace(leaf=function.instructions_sx()[k].which_function())
            call = len(lines)
            lines.append(line)
            parts = [Line("part", (call,), number) for number in range(len(targets))]
        else:
            parts = [line]
        for target, part in zip(targets, parts, strict=True):
            holds[target] = len(lines)
            lines.append(part)
    return Program(function.name(), lines, results)


def read_constants(function: ca.Function) -> list[float]:
    """Return the constants of a function, those of functions that it calls apart."""
    count = range(function.n_instructions())
    places = [k for k in count if function.instruction_id(k) == ca.OP_CONST]
    return list(map(function.instruction_constant, places))


def count_instructions(function: ca.Function) -> int:
    """Return the number of instructions of a function, those of each call among them."""
    counts_by_function: dict[int, int] = {}

    def count_with_calls(called: ca.Function) -> int:
        """Return the number of instructions of a function and of those that it calls."""
        key = called.__hash__()
        if key not in counts_by_function:
            lines = read_program(called).lines
            calls = [line.leaf for line in lines if line.word == "call"]
            counts_by_function[key] = len(lines) - len(calls) + sum(map(count_with_calls, calls))
        return counts_by_function[key]

    return count_with_calls(function)


def evaluate_program(
    of: Program,
    read: Callable[[str, int], Any],
    constant: Callable[[float], Any],
    apply: Callable[..., Any],
    call: Callable[[ca.Function, list[Any]], list[Any] | None] = lambda called, given: None,
) -> list[list[Any]]:
    """Evaluate the outputs of a function with values of any kind.

    Args:
        of: the function.
        read: (name of an input, entry) -> its value.
        constant: a number -> its value.
        apply: (word, values of the operands) -> the value of an instruction.
        call: (function of one input, its values) -> the values of all its results (None: they are
            evaluated, too).
    """

    def evaluate(called: ca.Function, given: list[Any]) -> list[Any]:
        """Evaluate a function that is called."""
        key = called.__hash__()
        if key not in programs:
            programs[key] = read_program(called)
        own = evaluate_program(programs[key], lambda _, k: given[k], constant, apply, call)
        return [*itertools.chain(*own)]

    programs: dict[int, Program] = {}
    values: list[Any] = []
    for word, operands, leaf in of.lines:
        if word == "input":
            values.append(read(*leaf))
        elif word == "const":
            values.append(constant(leaf))
        elif word == "call":
            given = [values[operand] for operand in operands]
            values.append(call(leaf, given) or evaluate(leaf, given))
        elif word == "part":
            values.append(values[operands[0]][leaf])
        else:
            values.append(apply(word, *[values[operand] for operand in operands]))
    return [[values[place] for place in result] for result in of.results]


class Rules(Protocol):
    """Rules that build nodes from instructions on numbers, implemented in `simplify`."""

    nodes: Nodes
    real: str

    def build_instruction(self, word: str, *args: Node) -> Node:
        """Return the node of an instruction on numbers. Truths are 1 or 0."""

    def build_constant(self, value: float) -> Node:
        """Return the node of a constant."""


def build_nodes(
    function: ca.Function,
    rules: Rules,
    call: Callable[[ca.Function, list[Node]], list[Node] | None] = lambda called, given: None,
) -> Results:
    """Return the results of a function as nodes, whether or not lanes share its inputs.

    Args:
        function: with dense outputs. Its inputs named p are steady.
        rules: what makes the nodes.
        call: as of `evaluate_program`.

    Raises:
        InputError: names an instruction that cannot be compiled.
    """
    lines = read_program(function)
    for line in lines.lines:
        if line.word not in (*_KNOWN, "input", "const", "call", "part"):
            raise InputError(
                f"{lines.title}: no code can be made of the instruction OP_{line.word.upper()}. "
                "Run this graph on the engine 'interpret'"
            )

    def read(name: str, entry: int) -> Node:
        """Return the node of an input entry."""
        level = STEADY if name.startswith("p") else LANES
        return rules.nodes.intern_input(f"{name}{entry}", level, rules.real)

    def apply(word: str, *args: Node) -> Node:
        """Return the node of an instruction on nodes."""
        if word in _SAME:
            return args[0]
        if word == "sq":
            return rules.build_instruction("mul", args[0], args[0])
        if word == "twice":
            return rules.build_instruction("mul", rules.build_constant(2.0), args[0])
        if word == "inv":
            return rules.build_instruction("div", rules.build_constant(1.0), args[0])
        return rules.build_instruction("pow" if word == "constpow" else word, *args)

    return evaluate_program(lines, read, rules.build_constant, apply, call)
