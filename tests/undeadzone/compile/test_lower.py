"""Graphs rewritten for C, their replica in NumPy, the compiled C, CasADi: the same bits."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_engines import BINARY, ELEMENTARY, SPECIAL, UNARY

from undeadzone.compile.casadi_reader import count_instructions
from undeadzone.compile.graph import required_nodes
from undeadzone.compile.lower import build_portable_nodes
from undeadzone.compile.numpy_reference import reference_evaluator
from undeadzone.compile.print_c import WIDTH, c_literal, wrap_statement
from undeadzone.compile.simplify import round_to_type
from undeadzone.errors import InputError
from undeadzone.plants.build import system
from undeadzone.plants.options import Plant
from undeadzone.plants.system import sample_plant
from undeadzone.util.arrays import Floats
from undeadzone_export.accuracy import CompiledStep
from undeadzone_export.code import build_code, count_operations, split_phases
from undeadzone_export.exported_step import ExportedStep, Field
from undeadzone_export.source import Labels, build_source


@pytest.fixture(autouse=True)
def quiet() -> Iterator[None]:
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        yield


def stateless(inputs: list[ca.SX], outputs: list[ca.SX]) -> ExportedStep:
    """A step without memory: outputs of inputs."""
    w, out = ca.vertcat(*inputs), ca.vertcat(*outputs)
    function = ca.Function(
        "step",
        [ca.SX(0, 1), w, ca.SX(0, 1)],
        [ca.SX(0, 1), ca.densify(out)],
        ["s", "w", "p"],
        ["next", "out"],
    )
    none = np.empty(0)
    fields = [Field("a", len(inputs), "inputs")], [Field("b", out.shape[0], "outputs")]
    return ExportedStep(function, none, [], *fields, [], none, len(inputs), [], 1.0, none)


def by_replica(step: ExportedStep, rows: Floats, single: bool) -> Floats:
    """The outputs by NumPy, a row for each row of inputs."""
    real = np.float32 if single else np.float64
    code = build_code(step, single)
    evaluate = reference_evaluator(code.results, code.parts)
    values = []
    for row in rows.astype(real):
        entries = {f"w{k}": value for k, value in enumerate(row)}
        values.append(np.array(evaluate(entries)[1], real).astype(float))
    return np.array(values)


def by_machine(step: ExportedStep, rows: Floats) -> Floats:
    """The outputs by CasADi."""
    return np.array([step.function([], row, [])[1].full().ravel() for row in rows])


def same(a: Floats, b: Floats) -> Any:
    """Where numbers are equal; NaN equals NaN, -0 equals 0."""
    return (a == b) | (np.isnan(a) & np.isnan(b))


def operations(single: bool, *outputs: ca.SX) -> dict[str, int]:
    """Return the operations of each kind in a step of A and B."""
    return count_operations(build_code(stateless([A, B], [*outputs]), single).results)


def test_erf_shares_the_exponential_of_its_square_in_single() -> None:
    x = A * B
    outputs = ca.erf(x), ca.erf(-x), ca.exp(-(x**2)), ca.erf(B)
    counts = operations(True, *outputs)
    assert (counts["erf_by_exp"], counts["erf"], counts["exp"]) == (2, 1, 1)
    assert "erf_by_exp" not in operations(False, *outputs)
    assert "erf_by_exp" not in operations(True, ca.erf(x), ca.exp(-(A**2)))
    rows = np.random.default_rng(2).uniform(-2, 2, size=(200, 2)).astype(np.float32).astype(float)
    step = stateless([A, B], [*outputs])
    assert np.abs(by_replica(step, rows, True) - by_machine(step, rows)).max() < 1e-6


def test_minus_one_times_a_number_is_no_product() -> None:
    assert operations(True, B + A * ca.SX(-1.0)) == {"add": 1}
    assert operations(True, ca.mtimes(ca.SX([[-1.0, 1.0]]), ca.vertcat(A, B))) == {"add": 1}


def calling_outputs() -> list[ca.SX]:
    """Results of a function that stays a call, called twice, and that calls another one twice."""
    w, options = ca.SX.sym("w", 3), {"never_inline": True}
    wave = ca.sin(w[0]) * w[1] + ca.exp(-(w[0] ** 2)) + ca.erf(w[0])
    inner = ca.Function(
        "inner", [w], [ca.vertcat(wave, w[2] / 3, w[0], 2.0)], ["w"], ["o"], options
    )
    deeper = inner(ca.vertcat(w[0], inner(w)[0], 0.5))
    outer = ca.Function("outer", [w], [deeper + w[1], ca.if_else(w[0] > 0, 1.0, w[1])],
                        ["w"], ["o", "more"], options)  # fmt: skip
    first, more = outer(ca.vertcat(A, B, 0.1))
    second, _ = outer(ca.vertcat(first[0], more, B))
    return [first, second, more, inner(ca.vertcat(B, A, 1.0))]


@pytest.mark.parametrize("single", [True, False], ids=["single", "double"])
def test_calls_that_the_graph_keeps_are_functions_of_the_same_bits(
    single: bool, tmp_path: Path
) -> None:
    step = stateless([A, B], calling_outputs())
    assert {one.name() for one in step.function.find_functions()} == {"inner", "outer"}
    code = build_code(step, single)
    assert [part.name for part in code.parts] == ["shared_0", "shared_1"]
    rows = np.random.default_rng(3).uniform(-2, 2, size=(100, 2)).astype(np.float32).astype(float)
    values = by_replica(step, rows, single)
    assert np.abs(values - by_machine(step, rows)).max() < (1e-5 if single else 1e-13)
    assert same(CompiledStep(code, tmp_path)(rows), values).all()
    text = build_source(code, Labels("o", "", "observer")).code
    assert text.count("static void o_shared_1(") == 1
    assert text.count("static void o_shared_0") == 2  # one for each of its callers
    assert code.operations["sin"] == 5


def test_instructions_of_a_call_count_at_each_call() -> None:
    x = ca.SX.sym("x")
    inner = ca.Function("kept", [x], [ca.sin(x) + x], {"never_inline": True})
    once, twice = (
        count_instructions(ca.Function("f", [x], [whole])) for whole in (inner(x), inner(inner(x)))
    )
    own = count_instructions(inner)
    assert own == inner.n_instructions() - 1  # that of the output is not counted
    assert twice - once == own + 1  # and the one that takes the result of a call


def test_a_call_with_a_number_that_may_be_missing_is_written_out() -> None:
    """A function computes with numbers alone; NaN would show in none of its comparisons."""
    w, options = ca.SX.sym("w", 2), {"never_inline": True}
    seen = ca.if_else(w[0] == w[0], w[0] + w[1], -w[1])
    called = ca.Function("called", [w], [seen], ["w"], ["o"], options)
    reading = ca.if_else(ca.fabs(A) < 1e300, A, np.nan)
    step = stateless([A, B], [called(ca.vertcat(reading, B))])
    assert not build_code(step, False).parts
    rows = np.array([[np.nan, 2.0], [1.0, 2.0]])
    assert same(by_replica(step, rows, False), by_machine(step, rows)).all()


def test_no_call_passes_from_the_first_half_of_a_step_to_the_second() -> None:
    results = build_portable_nodes(
        ca.Function("f", [A, B], [calling_outputs()[0] * B, A], ["s", "w"], ["next", "out"]),
        "float64", [],
    )  # fmt: skip
    phases = split_phases(results, {"w0"})
    assert {node.op for node in phases.estimate[1]}.isdisjoint({"apply"})


A, B = ca.SX.sym("a"), ca.SX.sym("b")
EXACT = [f(A) for f in UNARY.values()] + [f(A, B) for f in BINARY.values()]
CLOSE = [f(A, B) for f in ELEMENTARY.values()]
NAMES = [*UNARY, *BINARY, *ELEMENTARY]


def pairs() -> Floats:
    special = np.array(np.meshgrid(SPECIAL, SPECIAL)).reshape(2, -1).T
    random = np.random.default_rng(0).normal(size=(100, 2)) * [2.0, 1.0]
    return np.vstack([special, random])


def test_every_instruction_means_the_same_as_on_the_machine() -> None:
    rows = pairs()
    exact = same(
        by_replica(stateless([A, B], EXACT), rows, False),
        by_machine(stateless([A, B], EXACT), rows),
    )
    assert [name for k, name in enumerate(NAMES[: len(EXACT)]) if not exact[:, k].all()] == []


def test_elementary_functions_are_near_those_of_the_machine() -> None:
    step = stateless([A, B], CLOSE)
    rows = np.random.default_rng(1).uniform(-3, 3, size=(500, 2))
    values, expected = by_replica(step, rows, False), by_machine(step, rows)
    size = np.maximum(np.abs(expected), 1e-3)
    near = same(values, expected) | (np.abs(values - expected) < 1e-14 * size)
    assert [name for k, name in enumerate(ELEMENTARY) if not near[:, k].all()] == []


@pytest.mark.parametrize("single", [True, False], ids=["single", "double"])
def test_compiled_C_gives_the_bits_of_the_replica(single: bool, tmp_path: Path) -> None:
    step = stateless([A, B], EXACT + CLOSE)
    rows = pairs()
    if single:
        rows = rows.astype(np.float32).astype(float)
    printed = CompiledStep(build_code(step, single), tmp_path)
    equal = same(printed(rows), by_replica(step, rows, single))
    assert [name for k, name in enumerate(NAMES) if not equal[:, k].all()] == []


SAFE = ("neg", "fabs", "sign", "not", "floor", "ceil", "add", "sub", "mul", "lt", "le", "eq", "ne",
        "and", "or", "if_else_zero", "fmin", "fmax")  # fmt: skip


@st.composite
def finite_graphs(draw: st.DrawFn) -> ExportedStep:
    """A random graph whose values all stay finite, with conditions that multiply and select."""
    inputs = [ca.SX.sym(name) for name in "abc"]
    constants = st.sampled_from([0.0, 1.0, -1.0, 0.5, 1.001, 0.999, 3.0, 1e300])
    nodes = inputs + [ca.SX(draw(constants)) for _ in range(2)]
    for _ in range(draw(st.integers(3, 40))):
        name = draw(st.sampled_from(SAFE))
        x, y = (nodes[draw(st.integers(0, len(nodes) - 1))] for _ in range(2))
        node = UNARY[name](x) if name in UNARY else BINARY[name](x, y)
        nodes.append(ca.fmax(ca.fmin(node, 8.0), -8.0) if name in ("add", "sub", "mul") else node)
    return stateless(inputs, nodes[5:])


VALUES = st.floats(-4, 4, width=32) | st.sampled_from([0.0, 1.0, -1.0])


@settings(max_examples=60, deadline=None)
@given(finite_graphs(), st.lists(st.tuples(VALUES, VALUES, VALUES), min_size=1, max_size=8))
def test_rewriting_keeps_every_bit(step: ExportedStep, rows: list[tuple[float, ...]]) -> None:
    table = np.array(rows)
    assert same(by_replica(step, table, False), by_machine(step, table)).all()


@settings(max_examples=40, deadline=None)
@given(finite_graphs(), st.lists(st.tuples(VALUES, VALUES, VALUES), min_size=1, max_size=4))
def test_a_missing_value_means_what_NaN_means(
    step: ExportedStep, rows: list[tuple[float, ...]]
) -> None:
    """The first input is NaN below 0: conditions take the place of NaN, the values stay."""
    a, b, c = (ca.SX.sym(name) for name in "abc")
    seen = ca.if_else(a > 0, a, np.nan)
    outputs = step.function([], ca.vertcat(seen, b, c), [])[1]
    missing = stateless([a, b, c], [outputs])
    table = np.array(rows)
    values, expected = by_replica(missing, table, False), by_machine(missing, table)
    assert (same(values, expected) | np.isnan(expected)).all()


def test_no_NaN_is_computed_with() -> None:
    y, z = ca.SX.sym("y"), ca.SX.sym("z")
    there = ca.logic_and(y < 1e300, y > -1e300)
    seen = ca.if_else(there, y, np.nan)
    inside = ca.if_else(ca.logic_and(seen < 1e300, seen > -1e300), seen - z, 0.0)
    results = build_portable_nodes(stateless([y, z], [inside]).function, "float64")
    assert "nan" not in [node.text for node in required_nodes(itertools.chain(*results))]
    assert count_operations(results)["select"] <= 2


def test_a_split_step_computes_the_same() -> None:
    a, u = ca.SX.sym("a"), ca.SX.sym("u")
    state = ca.SX.sym("s", 2)
    heavy = ca.sin(a * state[0]) + state[1]
    function = ca.Function(
        "step",
        [state, ca.vertcat(a, u), ca.SX(0, 1)],
        [ca.vertcat(heavy * u, heavy), ca.vertcat(heavy)],
        ["s", "w", "p"],
        ["next", "out"],
    )
    results = build_portable_nodes(function, "float64")
    phases = split_phases(results, {"w1"})
    entries = {"s0": 0.3, "s1": 2.0, "w0": 1.7, "w1": -0.4}
    entries = {key: np.float64(value) for key, value in entries.items()}
    following, out = reference_evaluator(results)(entries)
    first, carry = reference_evaluator(phases.estimate)(entries)
    entries |= {f"c{k}": value for k, value in enumerate(carry)}
    (later,) = reference_evaluator(phases.advance)(entries)
    assert phases.carried == 1
    assert (first, later) == (out, following)


def test_increments_hold_a_slow_drift_that_float_would_lose(tmp_path: Path) -> None:
    """A plant that moves by 5e-7 of itself in a sample, as the product samples it."""
    slow = sample_plant(system(Plant(A=[[-0.05]], B=[[10.0]], C=[[1.0]])), 1e-5)
    x, u = ca.SX.sym("x"), ca.SX.sym("u")
    moved = slow.move(slow.params, x, u)
    function = ca.Function(
        "step", [x, u, ca.SX(0, 1)], [moved, x], ["s", "w", "p"], ["next", "out"]
    )
    fields = [Field("x", 1, "")], [Field("u", 1, "")], [Field("x", 1, "")]
    step = ExportedStep(
        function, np.array([1.0]), *fields, [], np.empty(0), 0, [0], 1e-5, np.zeros(1)
    )
    rows = np.sin(np.arange(100_000) * 1e-3)[:, None].astype(np.float32).astype(float)
    exact = CompiledStep(build_code(step, False), tmp_path)(rows)
    rounded = CompiledStep(build_code(step, True), tmp_path)(rows)
    A, B = np.float32(slow.linear.A[0, 0]), np.float32(slow.linear.B[0, 0])
    naive = np.float32(1.0)
    for row in rows[:, 0]:
        naive = A * naive + B * np.float32(row)
    error = abs(float(rounded[-1, 0] - exact[-1, 0]))
    assert error < 1e-5
    assert error < 0.1 * abs(float(naive) - exact[-1, 0])


@given(st.floats(allow_nan=False))
def test_a_literal_means_its_number(value: float) -> None:
    for kind, real in (("float32", np.float32), ("float64", np.float64)):
        text = c_literal(value, kind)
        limits = {
            "FLT_MAX": np.finfo(np.float32).max,
            "FLT_MIN": np.finfo(np.float32).tiny,
            "DBL_MAX": np.finfo(float).max,
        }
        size = text.lstrip("-")
        number = limits[size] if size in limits else real(size.removesuffix("f"))
        sign = -1 if text.startswith("-") else 1
        rounded = round_to_type(value, kind)
        assert real(number) * sign == rounded
        assert np.isfinite(rounded)
        assert (rounded == 0) == (value == 0)


def test_an_unknown_instruction_is_named() -> None:
    with pytest.raises(InputError, match="OP_ERFINV"):
        build_code(stateless([A], [ca.erfinv(A)]), True)


def test_long_statements_are_wrapped_at_the_last_place_that_fits() -> None:
    """Nothing but blanks is added; a line is as long as it can be."""
    names = [f"operand_{k}" for k in range(40)]
    text = "x = " + " + ".join(names[:20]) + f" * call({', '.join(names[20:])});"
    lines = wrap_statement(text)
    assert " ".join(line.strip() for line in lines) == text
    assert max(map(len, lines)) <= WIDTH
    assert min(map(len, lines[:-1])) > WIDTH - 2 * len(" + operand_10")
