"""Steps of a single run: the virtual machine first, machine code once it is worth compiling."""

import casadi as ca
import numpy as np
import pytest

from undeadzone.compile import cache
from undeadzone.compile.interpret import run_interpreted
from undeadzone.compile.scalar_step import BEGUN, CompiledStepper


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
    w = np.random.default_rng(0).random((3 * BEGUN, 1))
    outputs = stepper.run(w[:BEGUN])
    assert stepper.engine.startswith("virtual machine")
    outputs = np.vstack([outputs, stepper.run(w[BEGUN:])])
    assert stepper.engine.startswith("compiled")
    expected, end = run_interpreted(step, start, w, params)
    np.testing.assert_array_equal(outputs, expected)
    np.testing.assert_array_equal(stepper.state, end)
