"""One graph on CasADi's virtual machine, compiled lanes and generated C: the same numbers."""

from __future__ import annotations

import hashlib
import json
import operator
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.scenes import scene, tables_of

import once
from undeadzone import registry
from undeadzone.compile import cache, interpret, kernel, lanes
from undeadzone.compile.lower import Arithmetic
from undeadzone.compile.machine import host_machine
from undeadzone.errors import InputError, ShapeError
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.simulate import prepare, simulate
from undeadzone.util import tree
from undeadzone.util.arrays import Floats

BOTH, SAMPLED, CONTINUOUS = ("continuous", "sampled"), ("sampled",), ("continuous",)
PLAIN: tuple[tuple[str, ...], dict[str, Any]] = (BOTH, {})  # for a method that is not listed below
OBSERVERS: dict[str, tuple[tuple[str, ...], dict[str, Any]]] = {
    "adaptive_inverse": (BOTH, {"law": "least_squares", "gain": 50.0, "poles": [-20.0]}),
    "auto": (BOTH, {"right": [0.1, 1.0]}),
    "censored": (SAMPLED, {"right": [0.1, 1.0]}),
    "certified": (BOTH, {"L": [1.0], "gamma": 10.0, "silence": True}),
    "contact": ((), {}),  # of arms with gears: tests/undeadzone/observers/test_contact.py
    "ekf": (SAMPLED, {"right": [0.1, 1.0]}),
    "extended": (SAMPLED, {"right": [0.1, 1.0], "disturbance": 0.1}),
    "full_state": (BOTH, {}),
    "fuzzy_residual": (BOTH, {"reach": 3.0, "rules": 3}),
    "high_gain": (BOTH, {"epsilon": 0.1, "gamma": 2.0}),
    "interval": (BOTH, {"right": [0.1, 1.0], "disturbance": 0.1}),
    "inverse_network": (BOTH, {"scale": 1.0}),
    "kalman": (SAMPLED, {"right": [0.1, 1.0]}),
    "luenberger": (BOTH, {"L": [1.0]}),
    "moving_horizon": ((), {}),  # in Python, not on a graph
    "oracle": (BOTH, {"L": [1.0]}),
    "particle_filter": ((), {}),  # in Python, not on a graph
    "printed": (CONTINUOUS, {"L": [1.0]}),
    "rbf_residual": (BOTH, {"reach": 3.0, "centres": 3, "filtered": False}),
    "robust_gradient": (BOTH, {"width_max": 1.0}),
    "super_twisting": (BOTH, {"lipschitz": 2.0}),
    "taylor_residual": (BOTH, {"reach": 3.0, "degree": 3, "leak": 0.1}),
    "tobit": (SAMPLED, {"right": [0.1, 1.0]}),
    "ukf": (SAMPLED, {"right": [0.1, 1.0]}),
    "walcott_zak": (BOTH, {"poles": [-4.0], "gamma": 2.0}),
}
CONTROLLERS: dict[str, tuple[tuple[str, ...], dict[str, Any]]] = {
    "barrier": (BOTH, {"bound": 2.0, "rate": 5.0}),
    "computed_torque": ((), {}),  # of robot arms: test_computed_torque.py
    "fuzzy_feedback": (BOTH, {"reach": 3.0, "rules": 3}),
    "gravity_pd": ((), {}),  # of robot arms: test_computed_torque.py
    "linear": (BOTH, {"numerator": [2.0, 5.0], "denominator": [0.05, 1.0]}),
    "lqg": (BOTH, {"Q": 2.0, "integral": 5.0}),
    "lqr": (SAMPLED, {"Q": 2.0}),
    "pd": (BOTH, {"k_p": 2.0, "k_d": 0.1}),
    "pid": (BOTH, {"k_p": 2.0, "k_i": 3.0, "k_d": 0.1, "limits": [-3.0, 3.0]}),
    "printed": (CONTINUOUS, {"L": [1.0]}),
    "rbf_feedback": (BOTH, {"reach": 3.0, "centres": 3}),
    "robust_adaptive": (BOTH, {"rate": 5.0}),
    "sliding_mode": (BOTH, {"gain": 1.0}),
    "state_feedback": (BOTH, {"alpha": 5.0, "robust": {"gain": 0.5}}),
    "taylor_feedback": (BOTH, {"reach": 3.0}),
}
FIRST_ORDER = tables_of("""
A = [[-1.0]]
B = [[1.0]]
C = [[1.0]]
x0 = [0.4]
""")
PENDULUM = tables_of("""
states = ["angle", "rate"]
inputs = ["torque"]
f = ["rate", "-9.81 * sin(angle) - 1.5 * rate + torque"]
h = ["angle"]
x0 = [0.3, 0.0]
""")
TWO_OUTPUTS = tables_of("""
A = [[-1.0, 0.5], [-0.5, -2.0]]
B = [[1.0, 0.0], [0.0, 1.0]]
C = [[1.0, 0.0], [0.2, 1.0]]
x0 = [0.5, -0.5]
""")


PAIRS = [(observer, "state_feedback") for observer in registry.OBSERVERS.list_tags()] + [
    ("certified", controller) for controller in registry.CONTROLLERS.list_tags()
]


def combinations() -> list[tuple[str, str, str]]:
    """(observer, controller, time) for every pair in every time that both know."""
    listed = []
    for observer, controller in PAIRS:
        for time in OBSERVERS.get(observer, PLAIN)[0]:
            if time in CONTROLLERS[controller][0]:
                listed.append((observer, controller, time))
    return listed


def small(time: str = "continuous", **changes: Any) -> Scenario:
    """A first-order loop of 300 steps that crosses the zone both ways."""
    base: dict[str, Any] = tables_of("""
        sensor = { right = 0.5, left = 0.3, noise = 0.01, noise_before = 0.01 }
        reference = { kind = "sine", amplitude = 2.0, frequency = 1.0 }
        controller = { method = "state_feedback", alpha = 5.0 }
        simulation = { duration = 3.0, step = 0.01 }
        """) | {
        "plant": FIRST_ORDER,
        "observer": {"method": "certified"} | OBSERVERS["certified"][1],
    }
    tables = base | changes
    return scene(**tables | {"simulation": tables["simulation"] | {"time": time}})


def parts(scenario: Scenario) -> tuple[ca.Function, Floats, Floats, Floats, list[str]]:
    """(step, states, exogenous, params, names of the params)."""
    loop, state, exogenous = prepare(resolve_scenario(scenario))
    return (
        loop.step,
        state,
        exogenous,
        tree.pack_tree(loop.params),
        tree.number_addresses(loop.params),
    )


def compiled(
    step: ca.Function, states: Floats, exogenous: Floats, params: Floats
) -> tuple[Floats, Floats]:
    """A single run on lanes, in the shape of `interpret.run`."""
    outputs, finals = lanes.run_lanes(lanes.build_kernel(step, width=8), states, exogenous, params)
    return outputs[0], finals[0]


def distance(values: Floats, expected: Floats) -> float:
    """The largest difference relative to the size of its signal (column).

    It is inf where NaN or infinity differ.
    """
    assert values.shape == expected.shape
    finite = np.isfinite(expected)
    if not np.array_equal(values[~finite], expected[~finite], equal_nan=True):
        return np.inf
    if not np.isfinite(values[finite]).all():
        return np.inf
    expected = np.where(finite, expected, 0.0)
    size = np.abs(expected).max(axis=0) + 1e-300
    return float((np.abs(np.where(finite, values, 0.0) - expected) / size).max())


def gap_of_engines(scenario: Scenario) -> float:
    """How far the compiled loop of a scenario is from the interpreted one, by `distance`."""
    loop = parts(scenario)[:4]
    expected, _ = interpret.run_interpreted(*loop)
    step, *numbers = loop
    found, _ = lanes.run_lanes(lanes.build_kernel(step, width=1), *numbers)
    return distance(found[0], expected)


def identical(a: Floats, b: Floats) -> bool:
    """Equal to the last bit and the sign of zero; every NaN is the same."""
    if a.shape != b.shape:
        return False
    same = (a == b) & (np.signbit(a) == np.signbit(b))
    return bool((same | np.isnan(a) & np.isnan(b)).all())


# --- The same loop on both engines


@pytest.mark.parametrize(("observer", "controller", "time"), combinations())
def test_every_observer_and_controller_runs_the_same(
    observer: str, controller: str, time: str
) -> None:
    """On plain steps, which compile in a fraction of the time that located ones take.

    Located ones follow with `certified`.
    """
    scenario = small(
        time,
        observer={"method": observer} | OBSERVERS.get(observer, PLAIN)[1],
        controller={"method": controller} | CONTROLLERS[controller][1],
        simulation={"duration": 3.0, "step": 1e-2, "switching": "plain"},
    )
    loop = parts(scenario)[:4]
    expected, results = interpret.run_interpreted(*loop), compiled(*loop)
    assert np.ptp(expected[0], axis=0).max() > 0.1
    assert max(map(distance, results, expected)) < 1e-13


@pytest.mark.parametrize("time", BOTH)
@pytest.mark.parametrize(
    "changes",
    [
        {"plant": TWO_OUTPUTS, "observer": {"method": "certified", "gamma": 5.0}},
        (
            tables_of("""
            observer = { method = "certified", L = [1.0, 0.0] }
            reference = { kind = "sine", amplitude = 1.0, frequency = 0.5 }
            simulation = { duration = 3.0, step = 0.01, substeps = 1 }
            """)
            | {"plant": PENDULUM}
        ),
        {"sensor": {"kind": "jump", "noise": 0.05}},
    ],
    ids=["two outputs", "nonlinear", "jump"],
)
def test_every_kind_of_plant_and_sensor_runs_the_same(changes: dict[str, Any], time: str) -> None:
    loop = parts(small(time, **changes))[:4]
    expected, results = interpret.run_interpreted(*loop), compiled(*loop)
    assert {-1.0, 0.0, 1.0} <= set(expected[0].ravel().tolist())
    assert max(map(distance, results, expected)) < 1e-13


@pytest.mark.parametrize("time", BOTH)
def test_without_elementary_functions_every_bit_agrees(time: str) -> None:
    loop = parts(small(time))[:4]
    assert all(map(identical, compiled(*loop), interpret.run_interpreted(*loop)))


@pytest.mark.parametrize("time", BOTH)
def test_missing_samples_run_the_same(time: str) -> None:
    step, state, exogenous, params, _ = parts(small(time))
    instants = 3 if time == "continuous" else 1
    after = np.arange(1, instants + 1) * (exogenous.shape[1] // instants) - 1
    exogenous[50:80, after] = np.nan
    expected = interpret.run_interpreted(step, state, exogenous, params)
    assert np.isnan(expected[0]).any()
    assert np.isfinite(expected[1]).all()
    assert all(map(identical, compiled(step, state, exogenous, params), expected))


def test_simulate_takes_an_engine() -> None:
    scenario = small()
    progress: list[int] = []
    interpreted, run = (
        simulate(scenario),
        simulate(scenario, engine="lanes", progress=progress.append),
    )
    for name, column in interpreted.columns().items():
        assert identical(run.columns()[name], column), name
    assert run.info.integration_error == interpreted.info.integration_error
    assert sum(progress) == 301 + 601
    with pytest.raises(InputError, match="lane"):
        simulate(scenario, engine="lane")  # type: ignore[arg-type]


def generated(step: ca.Function, folder: Path) -> ca.Function:
    """A function as generated C, compiled."""
    generator = ca.CodeGenerator("step")
    generator.add(step)
    generator.generate(f"{folder}/")
    options = ["-O2", "-ffp-contract=off", "-fPIC", "-shared"]
    library = once.program(["step.so", *options, "step.c"], folder)
    return ca.external("step", str(library))


@pytest.mark.parametrize("scenario", [scene(), small("sampled")], ids=["paper", "sampled"])
def test_generated_C_runs_the_same(scenario: Scenario, tmp_path: Path) -> None:
    step, state, exogenous, params, _ = parts(scenario)
    results = interpret.run_interpreted(generated(step, tmp_path), state, exogenous, params)
    expected = interpret.run_interpreted(step, state, exogenous, params)
    assert max(map(distance, results, expected)) < 1e-15


# --- Every instruction


def first(function: Callable[[Any], Any]) -> Callable[[Any, Any], Any]:
    return lambda a, b: function(a)


UNARY: dict[str, Callable[[Any], Any]] = {
    "neg": operator.neg,
    "inv": lambda a: 1 / a,
    "sq": lambda a: a * a,
    "twice": lambda a: 2 * a,
    "fabs": ca.fabs,
    "sign": ca.sign,
    "not": ca.logic_not,
    "floor": ca.floor,
    "ceil": ca.ceil,
    "sqrt": ca.sqrt,
}
BINARY: dict[str, Callable[[Any, Any], Any]] = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": operator.truediv,
    "lt": operator.lt,
    "le": operator.le,
    "eq": operator.eq,
    "ne": operator.ne,
    "and": ca.logic_and,
    "or": ca.logic_or,
    "if_else_zero": lambda a, b: ca.if_else(a, b, 0),
    "fmin": ca.fmin,
    "fmax": ca.fmax,
    "copysign": ca.copysign,
    "fmod": ca.fmod,
    "remainder": ca.remainder,
}
OF_ONE = "exp expm1 log log1p erf sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh"
ELEMENTARY: dict[str, Callable[[Any, Any], Any]] = {
    "pow": operator.pow,
    "constpow": lambda a, b: a**1.7,
    "atan2": ca.atan2,
    "hypot": ca.hypot,
    **{name: first(getattr(ca, name)) for name in OF_ONE.split()},
}
USUAL = [0.0, -0.0, 1.0, -1.0, 0.5, -2.5, 3.0, 0.3]
SPECIAL = [*USUAL, 1e-9, 710.0, 1e308, 5e-324, -1e-310, np.inf, -np.inf, np.nan]


def lanes_once(step: ca.Function, states: Floats) -> Floats:
    """The outputs of one step from each row of states."""
    return lanes.run_lanes(
        lanes.build_kernel(step, width=8), states, np.empty((1, 0)), np.empty(0)
    )[0][:, 0]


def fused_once(step: ca.Function, states: Floats) -> Floats:
    """The same with sums of products rounded once."""
    kernel = lanes.build_kernel(step, width=8, fused=True)
    return lanes.run_lanes(kernel, states, np.empty((1, 0)), np.empty(0))[0][:, 0]


def machine_once(step: ca.Function, states: Floats) -> Floats:
    nothing = np.empty((1, 0)), np.empty(0)
    return np.array([interpret.run_interpreted(step, state, *nothing)[0][0] for state in states])


def stateless(inputs: list[ca.SX], outputs: list[ca.SX]) -> ca.Function:
    column = ca.vertcat(*inputs)
    return ca.Function("step", [column, ca.SX(0, 1), ca.SX(0, 1)], [column, ca.vertcat(*outputs)])


def test_every_instruction_means_the_same_for_every_kind_of_number() -> None:
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    exact = [f(a) for f in UNARY.values()] + [f(a, b) for f in BINARY.values()]
    step = stateless([a, b], exact + [f(a, b) for f in ELEMENTARY.values()])
    random = np.random.default_rng(0).normal(size=(100, 2)) * [2.0, 1.0]
    states = np.vstack([np.array(np.meshgrid(SPECIAL, SPECIAL)).reshape(2, -1).T, random])
    values, expected = lanes_once(step, states), machine_once(step, states)
    for i, name in enumerate([*UNARY, *BINARY]):
        assert identical(values[:, i], expected[:, i]), name
    with np.errstate(invalid="ignore"):
        near = np.abs(values - expected) <= 4 * np.spacing(np.abs(expected))
    close = near | (values == expected) | np.isnan(values) & np.isnan(expected)
    for i, name in enumerate([*UNARY, *BINARY, *ELEMENTARY]):
        assert close[:, i].all(), name


def applied(name: str, x: ca.SX, y: ca.SX) -> ca.SX:
    """An exact instruction of one or two operands."""
    return UNARY[name](x) if name in UNARY else BINARY[name](x, y)


@st.composite
def graphs(draw: st.DrawFn) -> ca.Function:
    """A random graph of the exact instructions over three inputs and constants.

    There are elementary functions at its end.
    """
    inputs = [ca.SX.sym(name) for name in "abc"]
    nodes = inputs + [ca.SX(draw(st.floats(allow_subnormal=False))) for _ in range(3)]
    for _ in range(draw(st.integers(5, 60))):
        name = draw(st.sampled_from([*UNARY, *BINARY]))
        x, y = (nodes[draw(st.integers(0, len(nodes) - 1))] for _ in range(2))
        nodes.append(applied(name, x, y))
    ends = []
    for node in nodes[6:10]:
        function = ELEMENTARY[draw(st.sampled_from(list(ELEMENTARY)))]
        ends.append(function(node, nodes[6]))
    return stateless(inputs, nodes[6:] + ends)


@settings(max_examples=10)
@given(graphs(), st.lists(st.tuples(*[st.floats()] * 3), min_size=1, max_size=20))
def test_random_graphs_mean_the_same(step: ca.Function, states: list[tuple[float, ...]]) -> None:
    values, expected = lanes_once(step, np.array(states)), machine_once(step, np.array(states))
    assert identical(values[:, :-4], expected[:, :-4])
    np.testing.assert_allclose(values, expected, rtol=1e-14, atol=0)


def test_an_unknown_instruction_is_named() -> None:
    a = ca.SX.sym("a")
    with pytest.raises(InputError, match="OP_ERFINV"):
        lanes.build_kernel(stateless([a], [ca.erfinv(a)]))


def test_structural_zeros_and_unused_inputs() -> None:
    s, w, p = ca.SX.sym("s", 2), ca.SX.sym("w", 3), ca.SX.sym("p", 2)
    following, out = ca.vertcat(ca.SX(1, 1), s[0] + w[2]), ca.vertcat(ca.SX(2, 1), p[1], 7.0)
    step = ca.Function("step", [s, w, p], [following, out])
    exogenous = np.arange(6.0).reshape(2, 3)
    outputs, finals = compiled(step, np.array([1.0, 2.0]), exogenous, np.array([3.0, 4.0]))
    assert outputs.tolist() == [[0.0, 0.0, 4.0, 7.0]] * 2
    assert finals.tolist() == [0.0, 5.0]


# --- Lanes

WIDTHS = np.linspace(0.2, 1.0, 19)


def shocks(steps: int) -> Floats:
    """What noise and disturbance each of the 19 runs has."""
    return np.random.default_rng(0).normal(size=(steps, 2, WIDTHS.size)) * [[0.01], [1.0]]


def varied(**options: Any) -> tuple[Floats, Floats]:
    """19 runs that differ in d_r, in noise and disturbance, and in x(0)."""
    step, state, exogenous, params, names = parts(small("sampled"))
    threads = options.pop("threads", None)
    own = shocks(len(exogenous))
    kernel = lanes.build_kernel(
        step, params=[names.index("sensor.right[0]")], exogenous=[5, 3], **options
    )
    states = np.tile(state, (WIDTHS.size, 1))
    states[:, 0] = WIDTHS
    return lanes.run_lanes(kernel, states, exogenous, params, own, WIDTHS[:, None], threads=threads)


def test_a_lane_is_a_single_run_to_the_last_bit() -> None:
    step, state, exogenous, params, names = parts(small("sampled"))
    outputs, finals = varied()
    for i in (0, 7, 18):
        exogenous[:, [5, 3]] = shocks(len(exogenous))[:, :, i]
        params[names.index("sensor.right[0]")] = state[0] = WIDTHS[i]
        expected = interpret.run_interpreted(step, state, exogenous, params)
        assert identical(outputs[i], expected[0])
        assert identical(finals[i], expected[1])
    assert np.unique(finals[:, 0]).size == WIDTHS.size


@pytest.mark.parametrize(
    "options",
    [{"width": 1}, {"width": 8}, {"width": 8, "threads": 3}, {"width": 16, "threads": 1}],
    ids=str,
)
def test_neither_width_nor_threads_change_a_bit(options: dict[str, Any]) -> None:
    assert all(map(identical, varied(**options), varied()))


def test_neither_buffers_nor_what_is_recorded_change_a_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    outputs, finals = varied()
    monkeypatch.setattr(lanes, "BUFFER", 1)
    chosen, same = varied(record=[4, 0])
    assert identical(chosen, outputs[:, :, [4, 0]])
    assert identical(same, finals)
    nothing, same = varied(record=[])
    assert nothing.shape == (19, len(outputs[0]), 0)
    assert identical(same, finals)


def printed(step: ca.Function, **options: Any) -> str:
    """The text of a kernel; one that is taken from disk has none."""
    sizes = (step.size1_in(0), step.size1_in(1), step.size1_in(2))
    shape = kernel.Shape(sizes, (), (), tuple(range(step.size1_out(1))))
    options = {"arithmetic": Arithmetic(), "width": 16} | options
    return kernel.print_kernel(
        kernel.build_graphs(step, (), shape, {}, {}), shape, host_machine(), **options
    ).text


@pytest.mark.parametrize("time", BOTH)
def test_fused_lanes_agree_to_rounding(time: str) -> None:
    step, state, exogenous, params, _ = parts(small(time))
    assert "llvm.fma" in printed(step, arithmetic=Arithmetic(fused=True))
    outputs, finals = lanes.run_lanes(
        lanes.build_kernel(step, width=8, fused=True), state, exogenous, params
    )
    expected = interpret.run_interpreted(step, state, exogenous, params)
    assert distance(outputs[0], expected[0]) < 1e-13
    assert distance(finals[0], expected[1]) < 1e-13


def test_fused_lanes_do_not_depend_on_what_is_shared() -> None:
    step, state, exogenous, params, _ = parts(small("sampled"))
    shared = lanes.run_lanes(
        lanes.build_kernel(step, width=8, fused=True), state, exogenous, params
    )
    kernel = lanes.build_kernel(step, width=16, fused=True, params=range(params.size))
    own = lanes.run_lanes(kernel, state, exogenous, params, lane_params=np.tile(params, (3, 1)))
    assert all(identical(a[2], b[0]) for a, b in zip(own, shared, strict=True))


def test_a_product_is_fused_into_either_side_of_a_sum_or_difference() -> None:
    a, b, c = (ca.SX.sym(name) for name in "abc")
    states = np.array([[0.1, 10.0, -1.0], [1 / 3, 3.0, 1.0], [1.5, 2.0, 4.0]])
    results = []
    for expression in (a * b + c, c + a * b, a * b - c, c - a * b, a * a - c, a * b + b * c):
        step = stateless([a, b, c], [expression])
        results.append(fused_once(step, states)[:, 0])
        expected = machine_once(step, states)[:, 0]
        np.testing.assert_allclose(results[-1], expected, rtol=1e-15, atol=1e-15)
    # 0.1 is not 1/10, which only one rounding shows.
    assert np.float64(0.1 * 10.0 - 1.0) == 0.0
    assert results[0][0] == results[1][0] != 0.0


@st.composite
def sums(draw: st.DrawFn) -> ca.Function:
    """A random graph of sums, products and limits.

    Parts of it count only where an input is larger than another.
    """
    inputs = [ca.SX.sym(name) for name in "abc"]
    nodes = inputs + [ca.SX(draw(st.floats(-3.0, 3.0))) for _ in range(3)]
    names = [*2 * ["add", "sub", "mul"], "neg", "sq", "twice", "fmin", "fmax", "where"]
    for _ in range(draw(st.integers(5, 30))):
        name = draw(st.sampled_from(names))
        x, y = (nodes[draw(st.integers(0, len(nodes) - 1))] for _ in range(2))
        if name == "where":
            i, j = draw(st.permutations(range(3)))[:2]
            nodes.append(ca.if_else(inputs[i] > inputs[j], x, draw(st.sampled_from([0.0, y]))))
        else:
            nodes.append(applied(name, x, y))
    return stateless(inputs, nodes[3:])


@settings(max_examples=15)
@given(sums(), st.lists(st.tuples(*[st.floats(-2.0, 2.0)] * 3), min_size=1, max_size=20))
def test_fused_sums_mean_the_same_to_rounding(
    step: ca.Function, states: list[tuple[float, ...]]
) -> None:
    fused = fused_once(step, np.array(states))
    plain = machine_once(step, np.array(states))
    largest = np.abs(plain).max(axis=1, keepdims=True)
    finite = np.isfinite(largest[:, 0]) & (largest[:, 0] < 1e6)
    np.testing.assert_array_less((np.abs(fused - plain) / (1 + largest) ** 2)[finite], 1e-12)


def test_lanes_are_computed_by_vector_instructions(folder: Path) -> None:
    """Of a kernel that is compiled here; one that is kept has no text."""
    step = parts(small("sampled"))[0]
    exogenous, params = range(step.size1_in(1)), range(step.size1_in(2))
    built = lanes.build_kernel(step, params=params, exogenous=exogenous, width=32)
    assert re.search(r"fmul <\d+ x double>", built.block.text)


def test_progress_counts_the_steps_of_all_lanes() -> None:
    step, state, exogenous, params, _ = parts(small("sampled"))
    done: list[int] = []
    kernel = lanes.build_kernel(step, width=8)
    lanes.run_lanes(kernel, np.tile(state, (19, 1)), exogenous, params, progress=done.append)
    assert sum(done) == 19 * len(exogenous)


def test_misuse_is_named() -> None:
    step, state, exogenous, params, _ = parts(small("sampled"))
    kernel = lanes.build_kernel(step, width=8, params=[1])
    for error, match, arguments in (
        (ShapeError, "lanes", (np.tile(state, (2, 1)), exogenous, params, None, np.ones((3, 1)))),
        (ShapeError, "lane_params", (state, exogenous, params)),
        (ShapeError, "states", (state[1:], exogenous, params, None, np.ones((3, 1)))),
        (ShapeError, "exogenous", (state, exogenous[:, 1:], params, None, np.ones((3, 1)))),
        (ShapeError, "params", (state, exogenous, params[1:], None, np.ones((3, 1)))),
    ):
        with pytest.raises(error, match=match):
            lanes.run_lanes(kernel, *arguments)
    with pytest.raises(InputError, match="record"):
        lanes.build_kernel(step, record=[99])


# --- Kernels on disk


def doubled(factor: float = 2.0) -> tuple[float, bool]:
    """(factor * 3 computed by a kernel, whether it was taken from disk)."""
    a = ca.SX.sym("a")
    cache.load_or_compile.cache_clear()
    kernel = lanes.build_kernel(stateless([a], [a * factor]), width=8)
    outputs, _ = lanes.run_lanes(kernel, np.array([3.0]), np.empty((1, 0)), np.empty(0))
    return float(outputs[0, 0, 0]), not kernel.block.text


def test_the_same_graph_compiles_once_and_a_changed_one_again(folder: Path) -> None:
    assert doubled() == (6.0, False)
    kernels = list(folder.glob("*.kernel"))
    assert doubled() == (6.0, True)
    assert list(folder.iterdir()) == kernels
    assert doubled(2.5) == (7.5, False)
    assert len(list(folder.glob("*.kernel"))) == 2


def test_another_machine_or_version_compiles_again(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    doubled()
    monkeypatch.setattr(cache, "_host_description", lambda: "LLVM 99 on another processor")
    assert doubled() == (6.0, False)
    assert len(list(folder.glob("*.kernel"))) == 2


def test_a_damaged_file_costs_a_compilation_and_no_more(folder: Path) -> None:
    doubled()
    (kernel,) = folder.glob("*.kernel")
    whole = kernel.read_bytes()
    head, _, code = whole.partition(b"\n")[2].partition(b"\n")
    note, _ = json.loads(head)
    rest = json.dumps([note, ["nowhere"]]).encode() + b"\n" + code  # calls what is not there
    missing = hashlib.sha256(rest).hexdigest().encode() + b"\n" + rest
    turned = whole[:-1] + bytes([whole[-1] ^ 1])
    for damaged in (b"", whole[:100], whole[:-1], turned, b"no kernel", missing):
        assert damaged != whole
        kernel.write_bytes(damaged)
        assert doubled() == (6.0, False)
        assert doubled() == (6.0, True)


HERE = Path(__file__).parent


def path_of_tests() -> dict[str, str]:
    """Return the environment, with the folders of tests on the path of Python."""
    folders = [str(folder) for folder in (HERE, HERE.parents[1], HERE.parents[2])]
    present = os.environ.get("PYTHONPATH")
    return os.environ | {"PYTHONPATH": os.pathsep.join([*folders, *([present] if present else [])])}


IN_A_PROCESS = """
import sys
import casadi as ca, numpy as np
from test_engines import BINARY, ELEMENTARY, SPECIAL, UNARY, lanes_once, stateless
a, b = ca.SX.sym("a"), ca.SX.sym("b")
of_one = [f(a) for f in UNARY.values()]
of_two = [f(a, b) for f in (BINARY | ELEMENTARY).values()]
step = stateless([a, b], of_one + of_two)
values = lanes_once(step, np.array(np.meshgrid(SPECIAL, SPECIAL)).reshape(2, -1).T)
print(values.tobytes().hex())
"""


def test_a_kernel_from_disk_has_every_bit_of_one_that_was_just_compiled(folder: Path) -> None:
    def run_kernel() -> str:
        return subprocess.run(
            [sys.executable, "-c", IN_A_PROCESS],
            capture_output=True,
            text=True,
            check=True,
            env=path_of_tests(),
        ).stdout

    compiled = run_kernel()
    assert len(list(folder.iterdir())) == 1
    assert run_kernel() == compiled
    assert len(list(folder.iterdir())) == 1


def test_processes_may_compile_the_same_kernel_at_once(folder: Path) -> None:
    code = "from test_engines import doubled; print(doubled()[0])"
    racing = [
        subprocess.Popen(
            [sys.executable, "-c", code],
            stdout=subprocess.PIPE,
            text=True,
            env=path_of_tests(),
        )
        for _ in range(2)
    ]
    assert [process.communicate()[0] for process in racing] == ["6.0\n"] * 2
    assert [path.suffix for path in folder.iterdir()] == [".kernel"]
    assert doubled() == (6.0, True)


def test_other_arguments_are_refused() -> None:
    a, flat = ca.SX.sym("a"), np.zeros(100)
    block = lanes.build_kernel(stateless([a], [a]), width=8).block
    for wrong in (np.zeros(100, np.float32), np.zeros(200)[::2]):
        with pytest.raises(TypeError, match="expected a contiguous array of float64"):
            block(1, flat, wrong, flat, flat, flat)


def test_a_folder_that_cannot_be_written_is_done_without(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("UNDEADZONE_CACHE", str(tmp_path / "file" / "kernels"))
    assert doubled() == (6.0, False)
