"""Steps of a single run: the virtual machine first, machine code once it is worth compiling."""

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from undeadzone.compile import cache, lanes
from undeadzone.compile.interpret import run_interpreted
from undeadzone.compile.kernel import build_graphs, print_kernel
from undeadzone.compile.lower import Arithmetic, build_portable_nodes
from undeadzone.compile.machine import ONE, Shape, host_machine
from undeadzone.compile.numpy_reference import reference_evaluator
from undeadzone.compile.scalar_step import BRIEF_RUN, CompiledStepper


def chaotic_step() -> ca.Function:
    """A logistic map: an error in the last bit soon shows."""
    s, w, p = (ca.SX.sym(name, 1) for name in "swp")
    following = p * s * (1 - s) + 1e-3 * w
    return ca.Function("step", [s, w, p], [following, ca.sin(following)])


def test_a_brief_run_changes_to_machine_code_with_the_same_bits(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    step, start, params = chaotic_step(), np.array([0.3]), np.array([3.7])
    monkeypatch.setattr(cache.cache_folder, "cache_directory", lambda: None)
    stepper = CompiledStepper(step, start, params, brief=True)
    w = np.random.default_rng(0).random((3 * BRIEF_RUN, 1))
    outputs = stepper.run(w[:BRIEF_RUN])
    assert stepper.engine.startswith("virtual machine")
    outputs = np.vstack([outputs, stepper.run(w[BRIEF_RUN:])])
    assert stepper.engine.startswith("compiled")
    expected, end = run_interpreted(step, start, w, params)
    np.testing.assert_array_equal(outputs, expected)
    np.testing.assert_array_equal(stepper.state, end)


def calling_step() -> ca.Function:
    """A step that calls a function twice, which calls another one twice."""
    w = ca.SX.sym("w", 2)
    options = {"never_inline": True}
    inner = ca.Function("inner", [w], [ca.sin(w) + w[0] * w[1]], ["w"], ["out"], options)
    middle = inner(inner(ca.vertcat(w[1], 0.5))) + ca.if_else(w[0] > 0, w, 3.0)
    outer = ca.Function("outer", [w], [middle, w[0] / 3], ["w"], ["out", "more"], options)
    s, given, p = ca.SX.sym("s", 2), ca.SX.sym("w", 1), ca.SX.sym("p", 1)
    one, third = outer(ca.vertcat(s[0], given))
    other, _ = outer(one)
    following = ca.if_else(given > p, 0.3 * other, s)
    results = [following, ca.vertcat(one, third)]
    return ca.Function("step", [s, given, p], results, ["s", "w", "p"], ["next", "out"])


def test_functions_that_are_called_are_compiled_once_with_the_same_bits() -> None:
    step, start, params = calling_step(), np.array([0.1, -0.2]), np.array([0.2])
    assert len(step.find_functions()) == 2
    w = np.random.default_rng(1).normal(size=(200, 1))
    expected, end = run_interpreted(step, start, w, params)
    stepper = CompiledStepper(step, start, params)
    stepper.settle()
    np.testing.assert_array_equal(stepper.run(w), expected)
    np.testing.assert_array_equal(stepper.state, end)
    shape = Shape((2, 1, 1), (), (), (0, 1, 2))
    graphs = build_graphs(step, (), shape, {}, {})
    text = print_kernel(graphs, shape, host_machine(), Arithmetic(), 1, ONE, "block").text
    assert text.count("define internal void @called") == 3  # two, and a piece


def test_lanes_and_portable_code_have_the_bits_of_a_step_with_calls() -> None:
    step, start, params = calling_step(), np.array([0.1, -0.2]), np.array([0.2])
    w = np.random.default_rng(2).normal(size=(50, 1))
    expected, _ = run_interpreted(step, start, w, params)
    kernel = lanes.build_kernel(step, width=8)
    outputs, _ = lanes.run_lanes(kernel, np.tile(start, (8, 1)), w, params)
    for lane in outputs:
        np.testing.assert_array_equal(lane, expected)
    evaluate = reference_evaluator(build_portable_nodes(step, "float64"))
    entries = {"s0": start[0], "s1": start[1], "w0": w[0, 0], "p0": params[0]}
    _, out = evaluate({name: np.float64(value) for name, value in entries.items()})
    np.testing.assert_allclose(out, expected[0], rtol=1e-14)


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UNDEADZONE_CACHE", str(tmp_path / "kernels"))
    monkeypatch.setattr(cache, "LONG", 0)
    cache.load_or_compile.cache_clear()


@pytest.mark.usefixtures("own_cache")
def test_code_of_no_effort_stays_if_better_code_is_not_worth_its_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    step, start, params = chaotic_step(), np.array([0.3]), np.array([3.7])
    monkeypatch.setattr(cache, "IN_PIECES", 1)
    first = CompiledStepper(step, start, params)
    first.settle()
    assert first.engine == "compiled"
    assert len(first._block._codes) == 1
    cache.load_or_compile.cache_clear()
    again = CompiledStepper(step, start, params)  # from the cache
    assert again.engine == "compiled"
    w = np.random.default_rng(0).random((50, 1))
    np.testing.assert_array_equal(again.run(w), run_interpreted(step, start, w, params)[0])


@pytest.mark.usefixtures("own_cache")
def test_code_of_no_effort_of_numbers_takes_less_of_the_stack_than_that_of_vectors(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A quarter of the stack, for the lines of the longest function."""
    step, start, params = chaotic_step(), np.array([0.3]), np.array([3.7])
    probe = CompiledStepper(step, start, params)
    probe.settle()
    longest = max(part.count("\n") for part in probe._block.text.split("\n}\n"))
    for bytes_of_line, codes in ((cache.NUMBER_BYTES, 2), (cache.NUMBER_BYTES - 1, 1)):
        monkeypatch.setattr(cache, "stack", lambda room=4 * longest * bytes_of_line: room)
        monkeypatch.setattr(cache, "read_cached_block", lambda *_: None)
        cache.load_or_compile.cache_clear()
        stepper = CompiledStepper(step, start, params)
        stepper.settle()
        assert len(stepper._block._codes) == codes
    assert cache.NUMBER_BYTES < cache.VECTOR_BYTES
