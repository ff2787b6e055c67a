"""Step that is exported, as one function: the observer alone, or with its controller."""

from __future__ import annotations

import difflib
import keyword
import re
import sys
from collections.abc import Callable, Iterable, Iterator
from itertools import accumulate, chain, product
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import (
    QUANTITIES,
    Estimate,
    Observer,
    require_graph,
    sample_branch,
    to_reading,
)
from undeadzone.nonlinearities.limits import Limits
from undeadzone.nonlinearities.sensor import present
from undeadzone.scenario.operating_point import Levels
from undeadzone.scenario.problem import Problem
from undeadzone.scenario.schema import Units
from undeadzone.simulation.close import Wiring, no_target
from undeadzone.simulation.loop import Driven
from undeadzone.util import tree
from undeadzone.util.arrays import Floats

_RESERVED = """
auto break case char const continue default do double else enum extern float for goto if inline
int long register restrict return short signed sizeof static struct switch typedef union
unsigned void volatile while bool true false class new delete this and or not
"""
_HEADERS = """
arduino assert complex ctype errno fenv float inttypes iso646 limits locale main malloc math memory
pthread setjmp signal stdalign stdarg stdatomic stdbool stddef stdint stdio stdlib stdnoreturn
string strings tgmath threads time uchar unistd wchar wctype avr numpy
"""
_KEYWORDS = frozenset(_RESERVED.split())
# Words of C and Python, and files that one with such a name would hide.
_FORBIDDEN = frozenset({*_KEYWORDS, *_HEADERS.split(), *keyword.kwlist, *sys.stdlib_module_names})


class Field(NamedTuple):
    """Array in a struct.

    Attributes:
        name: its name in C.
        size: how many numbers it holds.
        meaning: meaning of its entries, with their unit.
    """

    name: str
    size: int
    meaning: str


def to_identifier(text: str) -> str:
    """Convert a text to a name that files and symbols of any language accept.

    It has letters, digits and single underscores in lower case. An n comes before names that are a
    word of C or Python, a header of C or a module of Python, as math is.
    """
    name = re.sub(r"[^A-Za-z0-9]+", "_", text).strip("_").lower()
    if not name:
        return "observer"
    return f"n{name}" if name[0].isdigit() or name in _FORBIDDEN else name


def state_fields(state: Any, units: Units, drop: str = "") -> list[Field]:
    """Return the fields of a state, named after its tree.

    Args:
        state: tree of NumPy arrays.
        units: names of the scenario's units.
        drop: a prefix of the names in the tree to be left out.
    """
    sizes = {name: int(np.size(leaf)) for name, leaf in tree.iterate_leaves(state) if np.size(leaf)}
    shorts = [name.removeprefix(drop).strip(".") for name in sizes]
    known = state_meanings(units)
    unknown = "memory of the method"
    meanings = [known.get(short.rsplit(".", 1)[-1], unknown) for short in shorts]
    names = make_distinct([_to_member_name(short or "memory") for short in shorts])
    return list(map(Field, names, sizes.values(), meanings))


def _to_member_name(name: str) -> str:
    """Convert a name to the name of a field in C. Capitals are kept, since W and w may differ."""
    plain = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")
    return f"n{plain}" if plain[0].isdigit() or plain in _KEYWORDS else plain


def state_meanings(units: Units) -> dict[str, str]:
    """Return the meaning of a part of the state, with its unit, by the end of its name."""
    states = units.state if isinstance(units.state, str) else ", ".join(units.state)
    return {
        "held": f"the last finite input [{units.input}]",
        "line": f"inputs that have not acted yet, the oldest first [{units.input}]",
        "mean": "mean of the belief: state, then widths and other estimated numbers",
        "cov": "covariances of the belief, upper triangle column by column",
        "x": f"estimated state [{states}]",
        "right": f"estimated right width [{units.output}]",
        "left": f"estimated left width [{units.output}]",
        "W": "weights of the approximation",
    }


def estimate_meanings(units: Units) -> dict[str, str]:
    """Return the meaning of each field of an estimate, with its unit."""
    states = units.state if isinstance(units.state, str) else ", ".join(units.state)
    names = {"output": units.output, "input": units.input}
    names |= {"state": states, "rate": f"({states})/s"}
    meanings = {}
    for name, quantity in QUANTITIES.items():
        unit = names.get(quantity.unit)
        meanings[name] = quantity.meaning if unit is None else f"{quantity.meaning} [{unit}]"
    return meanings


def _nonempty_fields(parts: Any, meanings: dict[str, str]) -> list[Field]:
    """Return the fields of a named tuple of arrays, without the empty arrays."""
    named = zip(parts._fields, map(np.size, parts), strict=True)
    return [Field(name, int(size), meanings[name]) for name, size in named if size]


def total_size(fields: list[Field]) -> int:
    """Return the number of entries of all fields together."""
    return sum(field.size for field in fields)


def field_slices(fields: list[Field]) -> dict[str, slice]:
    """Return the slice of each field among the numbers of a struct."""
    ends = accumulate(field.size for field in fields)
    pairs = zip(fields, ends, strict=True)
    return {field.name: slice(end - field.size, end) for field, end in pairs}


def field_entries(fields: list[Field]) -> Iterator[tuple[Field, int]]:
    """Iterate over (field, entry) of every number, in order."""
    return chain.from_iterable(product([field], range(field.size)) for field in fields)


def member_entries(fields: list[Field]) -> list[tuple[str, int]]:
    """Return (name of the field, entry) of every number, in order."""
    return [(field.name, k) for field, k in field_entries(fields)]


def name_entries(**inputs: Iterable[Any]) -> dict[str, Any]:
    """Return the values of the inputs of a step by their names in the graph: s0, s1, w0.

    Args:
        **inputs: arrays for the entries of s, of w, and so on.
    """
    named: dict[str, Any] = {}
    for name, each in inputs.items():
        named |= {f"{name}{k}": one for k, one in enumerate(each)}
    return named


def make_distinct(bases: list[str], key: Callable[[str], str] = str) -> list[str]:
    """Return the names with a number appended to each that occurred before.

    Args:
        bases: the names.
        key: key of a name that must be distinct.
    """
    used: set[str] = set()
    names = []
    for base in bases:
        name = base
        count = 2
        while key(name) in used:
            name = f"{base}_{count}"
            count = count + 1
        used.add(key(name))
        names.append(name)
    return names


PARTS = ("observer", "observer+controller")


class ExportedStep(NamedTuple):
    """One sample of the exported part.

    Attributes:
        function: step(s, w, p) -> (next, out), the numbers that are not tunable folded in.
        start: the state at t = 0.
        state, inputs, outputs, params: the fields of the structs (params are the tunable numbers).
        defaults: values of the tunable numbers.
        readings: number of entries of w that are readings. They come first.
        acting: the entries of w that are inputs u of the plant (none with a controller).
        Ts: sample time [s].
        at_rest: w at the operating point.
    """

    function: ca.Function
    start: Floats
    state: list[Field]
    inputs: list[Field]
    outputs: list[Field]
    params: list[Field]
    defaults: Floats
    readings: int
    acting: list[int]
    Ts: float
    at_rest: Floats


class _StepNumbers(NamedTuple):
    """All numbers of the step that can be tuned. The field names are used in `--tunable`."""

    observer: Any
    sensor: Any
    controller: Any
    compensator: Any


class _SensorNumbers(NamedTuple):
    """Numbers of the sensor that the step uses: the threshold of the zone (p) and the range."""

    threshold: Any
    limits: Limits | None


class _ObserverMemory(NamedTuple):
    """State of the observer, and the last finite input (m)."""

    observer: Any
    held: Any


def build_step(
    problem: Problem, part: str = "observer", tunable: tuple[str, ...] = ()
) -> ExportedStep:
    """Build the exported step of a problem.

    Args:
        problem: the checked parts of a sampled scenario.
        part: "observer", or "observer+controller".
        tunable: numbers that stay parameters, such as "observer.gamma" or "sensor.threshold".

    Returns:
        The step.

    Raises:
        InputError: a continuous scenario, an observer without a graph, an unknown part or number.
    """
    if problem.model.Ts is None:
        raise InputError(
            'simulation.time: "continuous" cannot be exported, a controller chip takes samples. '
            'Set simulation.time = "sampled"'
        )
    if part not in PARTS:
        raise InputError(f"part: expected one of {', '.join(PARTS)}, found {part!r}")
    observer = require_graph(problem.observer)
    closed = part != "observer"
    numbers = _StepNumbers(
        observer.params,
        _SensorNumbers(problem.sensor.threshold, problem.sensor.limits),
        problem.controller.params if closed else None,
        problem.compensator.params if closed and problem.compensator else None,
    )
    column, params, defaults = fold_numbers(numbers, tunable)
    traced = _trace_loop if closed else _trace_observer
    step = traced(problem, observer, tree.unpack_column(numbers, column))
    following = tree.stack_leaves(step.following)
    out = tree.stack_leaves(step.out)
    columns = [step.state, ca.vertcat(*step.inputs), params.symbols]
    names = ["s", "w", "p"], ["next", "out"]
    function = ca.Function("step", columns, [following, out], *names, {"cse": True})
    require_effect(ca.vertcat(following, out), params, tunable)
    p = problem.model.p
    m = problem.model.m
    inputs = [_y_field(p, problem.scenario.units), *step.input_fields]
    return ExportedStep(
        function=function,
        start=tree.pack_tree(step.memory),
        state=state_fields(step.memory, problem.scenario.units, "" if closed else "observer"),
        inputs=inputs,
        outputs=step.output_fields,
        params=params.fields,
        defaults=defaults,
        readings=p,
        acting=[] if closed else list(range(p, p + m)),
        Ts=problem.model.Ts,
        at_rest=_inputs_at_rest(problem.levels, inputs),
    )


def _inputs_at_rest(levels: Levels | None, fields: list[Field]) -> Floats:
    """Return the inputs of a step at the operating point: 0 for those that have no level."""
    known = {}
    if levels is not None:
        known = {"y": levels.y, "u": levels.u, "r": levels.r, "u_ff": levels.u}
    return np.concatenate([known.get(field.name, np.zeros(field.size)) for field in fields])


class _TracedStep(NamedTuple):
    """Step as expressions, with the fields of its inputs and outputs.

    Attributes:
        memory: the state at t = 0, a tree.
        state: the state as a column.
        inputs: columns.
        following, out: trees.
        input_fields: those of all inputs but the readings.
        output_fields: those of `out`.
    """

    memory: Any
    state: ca.SX
    inputs: list[ca.SX]
    following: Any
    out: Any
    input_fields: list[Field]
    output_fields: list[Field]


def _trace_observer(problem: Problem, observer: Observer, params: _StepNumbers) -> _TracedStep:
    """Trace the observer alone.

    An input that is not finite is replaced by the last finite one.
    """
    model = problem.model
    at_rest = np.zeros(model.m) if problem.levels is None else problem.levels.u
    memory = _ObserverMemory(observer.init(observer.params), at_rest)
    column, s = tree.create_symbols(memory, "s")
    y = ca.SX.sym("y", model.p)
    u = ca.SX.sym("u", model.m)
    used = ca.if_else(present(u), u, s.held)
    levels = problem.levels
    acting, counted = (used, y) if levels is None else (used - levels.u, y - levels.y)
    reading = to_reading(counted, *params.sensor)
    after, estimate = observer.step(params.observer, s.observer, acting, reading)
    following = _ObserverMemory(after, used)
    estimate = _shown_estimate(problem, estimate)
    out = (estimate, sample_branch(reading, estimate))
    fields = [_u_field(problem)] if model.m else []
    output_fields = _estimate_fields(problem, estimate)
    return _TracedStep(memory, column, [y, u], following, out, fields, output_fields)


def _trace_loop(problem: Problem, observer: Observer, params: Any) -> _TracedStep:
    """Trace observer, controller and compensator.

    The input u is limited as the plant's drives are.
    """
    model = problem.model
    controller = problem.controller
    compensator = problem.compensator
    memory = Driven(
        observer.init(observer.params),
        controller.init(controller.params),
        None if compensator is None else compensator.init(compensator.params),
    )
    column, s = tree.create_symbols(memory, "s")
    y = ca.SX.sym("y", model.p)
    like = no_target(problem)
    t_column, target = tree.create_symbols(like, "target")
    levels = problem.levels
    counted = y
    if levels is not None:
        counted = y - levels.y
        target = target._replace(r=target.r - levels.r, u_ff=target.u_ff - levels.u)
    reading = to_reading(counted, *params.sensor)
    own = observer, controller, params, compensator
    following, u, estimate = Wiring(problem.plant, problem.sensor.kind, *own).advance_controller(
        s, reading, target
    )
    if levels is not None:
        u = u + levels.u
    estimate = _shown_estimate(problem, estimate)
    out = u, estimate, sample_branch(reading, estimate)
    output_fields = [_u_field(problem), *_estimate_fields(problem, estimate)]
    fields = _target_fields(like, problem.scenario.units)
    return _TracedStep(memory, column, [y, t_column], following, out, fields, output_fields)


def _shown_estimate(problem: Problem, estimate: Estimate) -> Estimate:
    """Return the estimate from its operating point on, without a side on which an edge does not
    exist.
    """
    if problem.levels is not None:
        estimate = problem.levels.restore_estimate(estimate)
    for side, absent in zip(("right", "left"), problem.sensor.absent, strict=True):
        if absent.any():
            names = (side, f"{side}_std", "width_std")
            estimate = estimate._replace(**dict.fromkeys(names, ca.SX(0, 1)))
    return estimate


def _u_field(problem: Problem) -> Field:
    """Return the field of the input u."""
    unit = problem.scenario.units.input
    return Field("u", problem.model.m, f"input until the next sample [{unit}]")


def _y_field(size: int, units: Units) -> Field:
    """Return the field of the readings y."""
    meaning = f"readings of the sensor; one that is not finite is missing [{units.output}]"
    return Field("y", size, meaning)


def _target_fields(like: Target, units: Units) -> list[Field]:
    """Return the fields of the controller's target."""
    meanings = {
        "r": f"reference of the tracked outputs [{units.output}]",
        "x_ref": "state that belongs to it",
        "u_ff": f"input that belongs to it [{units.input}]",
        "plan": "numbers that the controller computed ahead",
    }
    return _nonempty_fields(like, meanings)


def _estimate_fields(problem: Problem, estimate: Estimate) -> list[Field]:
    """Return the fields of an estimate and of the measured side."""
    sizes = Estimate(*(np.zeros(ca.SX(part).numel()) for part in estimate))
    limits = "" if problem.sensor.limits is None else "; +2, -2 at a limit of the range"
    side = Field("side", problem.model.p, f"measured side: +1, -1, 0{limits}")
    return [*_nonempty_fields(sizes, estimate_meanings(problem.scenario.units)), side]


# --- The numbers of a step that stay parameters; all others are folded in


class TunableNumbers(NamedTuple):
    """Tunable numbers as symbols and as fields."""

    symbols: ca.SX
    fields: list[Field]


def fold_numbers(numbers: Any, tunable: tuple[str, ...]) -> tuple[ca.SX, TunableNumbers, Floats]:
    """Return all numbers as a column of constants and symbols, the tunable ones, their values."""
    places = dict(tree.iterate_leaves(tree.leaf_slices(numbers)))
    values = tree.pack_tree(numbers)
    column = ca.SX(ca.DM(values))
    symbols = [ca.SX(0, 1)]
    fields: list[Field] = []
    defaults: list[Floats] = [np.empty(0)]
    for name in tunable:
        place = _find_tunable(name, places)
        size = place.stop - place.start
        symbol = ca.SX.sym(name.replace(".", "_"), size)
        column[place] = symbol
        if name == "sensor.threshold" and "observer.threshold" in places:
            column[places["observer.threshold"]] = symbol  # the same number, held by the observer
        symbols.append(symbol)
        defaults.append(values[place])
        meaning = f"{name}, as one sample uses it (gains per sample, not per second)"
        fields.append(Field(name.replace(".", "_"), size, meaning))
    return column, TunableNumbers(ca.vertcat(*symbols), fields), np.concatenate(defaults)


def _find_tunable(name: str, places: dict[str, slice]) -> slice:
    """Return the slice of a tunable number. Raises InputError with the nearest names."""
    known = sorted(key for key, place in places.items() if place.stop > place.start)
    if name in known:
        return places[name]
    nearest = difflib.get_close_matches(name, known, 3, 0.4) or known
    raise InputError(f"tunable: no number {name!r}. Did you mean {', '.join(nearest)}?")


def require_effect(every: ca.SX, params: TunableNumbers, tunable: tuple[str, ...]) -> None:
    """Raise InputError if no result depends on a tunable number."""
    for name, place in zip(tunable, field_slices(params.fields).values(), strict=True):
        if not ca.depends_on(every, params.symbols[place]):
            raise InputError(f"tunable: {name} changes nothing in a step of this observer")
