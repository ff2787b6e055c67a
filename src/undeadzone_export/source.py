"""C sources of an export: header, code, and the elementary functions in use."""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple

import numpy as np

import undeadzone
from undeadzone.compile import elementary, print_c
from undeadzone.compile.graph import Node, Results, required_nodes, to_condition
from undeadzone.compile.print_c import INDENT, SMALL, Body, Names, Style, build_body, c_literal
from undeadzone.compile.print_calls import Calls, Place
from undeadzone.compile.repeats import outline_parts, outline_repeats
from undeadzone.compile.simplify import round_to_type
from undeadzone.interfaces import ASSUMPTION_CHECKS
from undeadzone.util.text import to_one_line
from undeadzone_export.code import Code, count_operations
from undeadzone_export.exported_step import ExportedStep, Field, member_entries, name_entries
from undeadzone_export.template import fill_template


class Labels(NamedTuple):
    """Texts that the files of an export share.

    Attributes:
        prefix: what every symbol begins with.
        title: of the scenario.
        part: "observer" or "observer+controller".
    """

    prefix: str
    title: str
    part: str


class Source(NamedTuple):
    """Texts of the C files.

    Attributes:
        prefix: what every symbol begins with.
        header: the interface.
        code: init and step.
        math: the elementary functions (empty if none is used).
        functions: the names of those.
        operations: how many are written down, those of repeated parts once.
    """

    prefix: str
    header: str
    code: str
    math: str
    functions: list[str]
    operations: int

    def texts_by_name(self) -> dict[str, str]:
        """Return the texts by file name."""
        named = {f"{self.prefix}.h": self.header, f"{self.prefix}.c": self.code}
        return named | ({f"{self.prefix}_math.h": self.math} if self.math else {})


def build_source(code: Code, labels: Labels) -> Source:
    """Print the C of an export."""
    style = Style(code.dtype_name, labels.prefix)
    bodies = _print_bodies(code, style)
    used = bodies.functions
    functions = elementary.required_functions(used, code.dtype_name)
    step = code.step
    name = labels.prefix
    words = labels._asdict() | {
        "name": name,
        "upper": name.upper(),
        "title": _to_comment_line(labels.title),
        "version": undeadzone.__version__,
        "real": code.c_type,
        "step": c_literal(step.Ts, code.dtype_name),
        "hash": code.hash,
        "with_math": bool(used),
    }
    return Source(
        name,
        fill_template("templates/header.h", words | _header_words(code, name, style)),
        fill_template("templates/code.c", words | _code_words(code, name, style, bodies)),
        fill_template("templates/math.h", words | _elementary_words(functions, used, style))
        if used
        else "",
        functions,
        bodies.operations,
    )


class _Function(NamedTuple):
    """Function of a step: its results and their destination.

    Attributes:
        results: the nodes.
        out: index of the result that is the output (None: no output).
        targets: for each result, where each of its entries goes.
        locals: for each result, the local that holds each of its entries.
    """

    results: Results
    out: int | None
    targets: list[list[str]]
    locals: list[list[str]]


class _Bodies(NamedTuple):
    """Texts of a code's functions.

    Attributes:
        named: statements by function.
        parts: functions of repeated parts.
        operations: how many they all have.
    """

    named: dict[str, Body]
    parts: list[Body]
    operations: int

    @property
    def functions(self) -> set[str]:
        """Return the elementary functions that they call."""
        return set().union(*[each.functions for each in [*self.named.values(), *self.parts]])


def _print_bodies(code: Code, style: Style) -> _Bodies:
    """Print each function of a step, and the functions of repeated parts.

    A step calls its two halves. A short step is written once more as a whole, without calls.
    """
    step = code.step
    parts = outline_parts(code.parts)
    printed = set[str]()
    stored = [f"state->{name}[{k}]" for name, k in member_entries(step.state)]
    following = [f"next_{name}_{k}" for name, k in member_entries(step.state)]
    out = [f"out->{name}[{k}]" for name, k in member_entries(step.outputs)]
    output_names = [f"{name}_{k}" for name, k in member_entries(step.outputs)]
    in_place = dict(zip(stored, name_entries(s=stored), strict=True))
    functions = {}
    named = dict[str, Body]()
    inputs = _input_expressions(code)
    is_short = len(required_nodes(itertools.chain(*code.results))) <= SMALL
    if code.phases is None or is_short:
        whole = outline_repeats(code.results, parts)
        functions["step"] = _Function(whole, 1, [stored, out], [following, output_names])
    if code.phases is not None:
        first = outline_repeats(code.phases.estimate, parts)
        second = outline_repeats(code.phases.advance, parts)
        carry = [f"state->carry[{k}]" for k in _order_by_calls(first[1])]
        local = [f"carry_{k}" for k in range(code.carry_size)]
        inputs |= name_entries(c=carry)
        functions["estimate"] = _Function(first, 0, [out, carry], [output_names, local])
        functions["advance"] = _Function(second, None, [stored], [following])
        given = "state, params, in" if step.params else "state, in"
        halves = (f"estimate({given}, out)", f"advance({given})")
        named["step"] = Body([f"{INDENT}{style.prefix}_{call};" for call in halves], set())
    texts: list[Body] = []
    count = sum(sum(count_operations([part.results]).values()) for part in parts)
    for name, (results, place, targets, locals_) in functions.items():
        calls = Calls(parts, results, _places_in_arrays(results, inputs, targets, style))
        texts += calls.print_functions(parts, style, printed)
        known = local_meanings(results, step, place)
        names = Names(inputs, targets, locals_, known, in_place, calls)
        named[name] = build_body(results, style, names)
        count += sum(count_operations(results).values())
    return _Bodies(named, texts, count)


def _order_by_calls(carried: list[Node]) -> list[int]:
    """Return where carried numbers go: those of a call side by side, as its results are."""

    def place_of(k: int) -> tuple[int, ...]:
        """Return a key that sorts the results of a call side by side, others first."""
        node = carried[k]
        return (node.args[0].number, int(node.text)) if node.op == "part" else ()

    order = sorted(range(len(carried)), key=place_of)
    return np.argsort(order).tolist()


def _places_in_arrays(
    results: Results, inputs: dict[str, str], targets: list[list[str]], style: Style
) -> dict[Node, Place]:
    """Return the inputs and results that stand in an array.

    Args:
        results: the nodes.
        inputs: the expression of each input.
        targets: where each of them goes.
        style: how numbers are written.
    """
    places: dict[Node, Place] = {}
    memory = f"({style.real_type} *)state"
    carry = "state->carry"
    for node in required_nodes(itertools.chain(*results)):
        if node.op == "input" and node.text[0] == "s":
            places[node] = Place(memory.replace("(", "(const "), int(node.text[1:]), "")
        elif node.op == "input" and node.text[0] == "c":
            places[node] = Place(carry, _index_in(inputs[node.text]), "")
    read = {node.text for node in places}
    for nodes, entries in zip(results, targets, strict=True):
        for k, (node, target) in enumerate(zip(nodes, entries, strict=True)):
            if node.op == "part" and target.startswith(carry):
                places.setdefault(node, Place(carry, _index_in(target), target))
            elif node.op == "part" and target.startswith("state->") and f"s{k}" not in read:
                places.setdefault(node, Place(memory, k, target))
    return places


def _index_in(entry: str) -> int:
    """Return the index in the expression of an entry of an array."""
    return int(entry[entry.rindex("[") + 1 : -1])


def _input_expressions(code: Code) -> dict[str, str]:
    """Return the C expression of each entry of the inputs. States are read into locals."""
    step = code.step
    return name_entries(
        s=[f"{name}_was_{k}" for name, k in member_entries(step.state)],
        w=[f"in->{name}[{k}]" for name, k in member_entries(step.inputs)],
        p=[f"params->{name}[{k}]" for name, k in member_entries(step.params)],
    )


def _elementary_words(names: list[str], used: set[str], style: Style) -> dict[str, Any]:
    """Return the template words of the header with the elementary functions.

    Args:
        names: of the functions, each after those that it calls.
        used: every function that the code calls, those of a number's bits included.
        style: how numbers and functions are written.
    """
    texts = "\n\n".join(print_c.elementary_texts(names, used, style))
    return {"functions": texts, "with_bits": "memcpy" in texts}


def _header_words(code: Code, name: str, style: Style) -> dict[str, Any]:
    """Return the template words of the header: structs and prototypes with their meanings."""
    structs = [
        _struct_definition(f"{name}_{struct}", _STRUCTS[struct], fields, style)
        for struct, fields in code.structs.items()
    ]
    prototypes = [
        f"/** {_MEANINGS[function]} */\n{text};\n"
        for function, text in function_signatures(code, name).items()
    ]
    return {
        "structs": "\n".join(structs),
        "prototypes": "\n".join(prototypes),
        "claims": "\n".join(_assumption_macros(code, name.upper())),
    }


def _assumption_macros(code: Code, upper: str) -> list[str]:
    """Return macros for the bits of `claims`, or none if `claims` is not an output."""
    if not any(field.name == "claims" for field in code.step.outputs):
        return []
    macros = [
        f"#define {upper}_CLAIM_{name.upper()} {1 << k} /**< {check.words} */"
        for k, (name, check) in enumerate(ASSUMPTION_CHECKS.items())
    ]
    return [
        "/* bits of out->claims[0], a whole number; suspect counts them from 1 */",
        *macros,
        "",
    ]


_STRUCTS = {
    "state": "Memory from sample to sample.",
    "in": "One sample.",
    "out": "Inputs at this sample.",
    "params": "Tunable numbers. Whoever changes them leaves what was proved of the design.",
}


def _to_comment_line(text: str) -> str:
    """Return a text on one line that cannot end a comment."""
    line = to_one_line(text).replace("\\", "/")  # first: it makes new slashes
    return line.replace("*/", "* /").replace("/*", "/ *")


def _struct_definition(name: str, meaning: str, fields: list[Field], style: Style) -> str:
    """Return the definition of a struct, with a blank line after it."""
    members = [
        f"{INDENT}{style.real_type} {field.name}[{field.size}];"
        f" /**< {_to_comment_line(field.meaning)} */"
        for field in fields
    ]
    head = [f"/** {meaning} */", "typedef struct", "{"]
    return "\n".join([*head, *members, f"}} {name};", ""])


def function_signatures(code: Code, prefix: str) -> dict[str, str]:
    """Return the declarations of the functions of an export, without semicolons."""
    has_params = bool(code.step.params)
    params = f"const {prefix}_params *params, " * has_params
    given = f"{prefix}_state *state, {params}const {prefix}_in *in"
    arguments = {"params_default": f"{prefix}_params *params"} if has_params else {}
    arguments |= {"init": f"{prefix}_state *state", "step": f"{given}, {prefix}_out *out"}
    if code.phases is not None:
        arguments |= {"estimate": arguments["step"], "advance": given}
    return {key: f"void {prefix}_{key}({each})" for key, each in arguments.items()}


_LIBRARY = ("NAN", "fabs", "sqrt", "fmod", "remainder", "copysign")
_MEANINGS = {
    "params_default": "The numbers of the design.",
    "init": "Start anew.",
    "step": "One sample: the estimate from this reading and all before it, then on to the next.",
    "estimate": "The first half of a step: out, which does not depend on in->u. May be repeated.",
    "advance": "The second half, once in->u is known; both together give the bits of a step.",
}


def _code_words(code: Code, name: str, style: Style, bodies: _Bodies) -> dict[str, Any]:
    """Return the template words of the code: its headers and functions."""
    step = code.step
    values = [*code.step.start.tolist(), *[0.0] * code.carry_size]
    start = _store_statements("state", code.structs["state"], values, style)
    defaults = _store_statements("params", step.params, step.defaults.tolist(), style)
    parts = {"params_default": defaults, "init": start}
    for part, body in bodies.named.items():
        parts[part] = [*_void_casts(body, bool(step.params)), *body.lines]
    functions = ["\n".join(repeat.lines) for repeat in bodies.parts]
    for part, signature in function_signatures(code, name).items():
        functions.append("\n".join([signature, "{", *parts[part], "}"]))
    text = "\n".join(functions)
    return {
        "functions": "\n\n".join(functions),
        "with_limits": "FLT_M" in text or "DBL_M" in text,
        "with_functions": any(word in text for word in _LIBRARY),
        "with_truths": any(word in text for word in ("bool ", "true", "false")),
    }


def _void_casts(part: Body, params: bool) -> list[str]:
    """Return statements for arguments that a body does not read."""
    text = "\n".join(part.lines)
    arguments = ["in", *["params"] * params]
    return [f"{INDENT}(void){word};" for word in arguments if f"{word}->" not in text]


def _store_statements(
    target: str, fields: list[Field], values: list[float], style: Style
) -> list[str]:
    """Return statements that store numbers."""
    return [
        f"{INDENT}{target}->{name}[{k}] = {c_literal(value, style.kind)};"
        for (name, k), value in zip(member_entries(fields), values, strict=True)
    ]


# --- Names for locals whose meaning shows in the nodes: is there a reading, which side it shows

HUGE = 1e299  # what `sensor.present` compares with is larger


def local_meanings(results: Results, step: ExportedStep, out: int | None) -> dict[Node, str]:
    """Return names for locals.

    Args:
        results: the nodes.
        step: the step, for the names of its inputs and outputs.
        out: index of the result that is the output (None: no output).
    """
    order = required_nodes(itertools.chain(*results))
    names = _presence_names(order, step)
    if out is not None:
        for (name, k), node in zip(member_entries(step.outputs), results[out], strict=True):
            sides = [truth for truth in map(to_condition, node.args) if truth is not None]
            if name == "side" and node.op == "sub" and len(sides) == 2:
                names |= {sides[0]: f"is_right_{k}", sides[1]: f"is_left_{k}"}
                names |= _either_name(order, set(sides), f"is_active_{k}")
    return names


def _either_name(order: list[Node], truths: set[Node], name: str) -> dict[Node, str]:
    """Return the name of the node that is true if either of two conditions is."""
    for node in order:
        if node.op == "or" and set(node.args) == truths:
            return {node: name}
    return {}


def _presence_names(order: list[Node], step: ExportedStep) -> dict[Node, str]:
    """Return names of the conditions that an input is finite: -1e300 < w and w < 1e300."""
    inputs = name_entries(w=[f"{name}_{k}" for name, k in member_entries(step.inputs)])
    names: dict[Node, str] = {}
    for node in order:
        if node.op != "and":
            continue
        compared = set(map(_input_in_comparison, node.args))
        text = compared.pop()
        if not compared and text in inputs:
            names[node] = f"has_{inputs[text]}"
    return names


def _input_in_comparison(node: Node) -> str:
    """Return the name of the input in w < huge or -huge < w, or an empty name."""
    if node.op != "lt":
        return ""
    bounds = [abs(arg.constant_value or 0.0) >= round_to_type(HUGE, arg.kind) for arg in node.args]
    return "".join(arg.text for arg in node.args if any(bounds) and arg.op == "input")
