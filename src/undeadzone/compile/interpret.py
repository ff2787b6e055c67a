"""CasADi's own virtual machine: a single run without a compiler and without waiting."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Final

import casadi as ca
import numpy as np

from undeadzone.util.arrays import Floats

if TYPE_CHECKING:
    from undeadzone.compile.lanes import Kernel

CHUNK = 50  # steps in one call of the virtual machine: to chain more takes longer than it saves
# Steps of the virtual machine that take about as long as a compilation, of any graph: 15,000 to
# 45,000. The kernel serves later runs with other numbers, too.
WORTH: Final = 20_000
FEW: Final = 8  # rows from which on they are run at once


def run_interpreted(
    step: ca.Function,
    state: Floats,
    exogenous: Floats,
    params: Floats,
    progress: Callable[[int], None] | None = None,
) -> tuple[Floats, Floats]:
    """Run next, out = step(s, w, p) along N steps.

    Args:
        step: the graph.
        state: at the beginning (states).
        exogenous: w of each step (N x inputs).
        params: p.
        progress: called with the number of steps done.

    Returns:
        The outputs (N x outputs) and the final state.
    """
    total = exogenous.shape[0]
    outputs = np.empty((total, step.size1_out(1)))
    state = np.ascontiguousarray(state, float).copy()
    exogenous = np.ascontiguousarray(exogenous, float)
    start = 0
    for count in (min(CHUNK, total), 1):
        many = step.mapaccum(count) if count > 1 else step
        repeated = np.tile(params, (count, 1))
        states = np.empty((count, state.size))
        buffer, evaluate = many.buffer()
        buffer.set_arg(0, state.data)
        buffer.set_arg(2, repeated.data)
        buffer.set_res(0, states.data)
        while total - start >= count and start < total:
            buffer.set_arg(1, exogenous[start : start + count].data)
            buffer.set_res(1, outputs[start : start + count].data)
            evaluate()
            state[:] = states[-1]
            start += count
            if progress is not None:
                progress(count)
    return outputs, state


def build_stateless_step(inputs: list[ca.SX], value: ca.SX) -> ca.Function:
    """Return a step without a state. Its output is a value of a row and of params (inputs)."""
    nothing = ca.SX(0, 1)
    return ca.Function("stateless", [nothing, *inputs], [nothing, value])


def map_rows(step: ca.Function, rows: Floats, params: Floats) -> Floats:
    """Return the outputs of a step without a state at many rows of inputs (N x outputs)."""
    return run_interpreted(step, np.empty(0), rows, params)[0]


class Stepper:
    """Single step at a time, in place and without copies, for scalar steps.

    Fill `w`, call, read `out`. `state` advances. No code is compiled.

    Args:
        step: next, out = step(s, w, p).
        state: at the beginning (states).
        params: p.
    """

    engine: Final = "virtual machine"

    def __init__(self, step: ca.Function, state: Floats, params: Floats) -> None:
        self.state = np.array(state, float)
        self.w = np.zeros(step.size1_in(1))
        self.out = np.zeros(step.size1_out(1))
        self._step = step
        self._params = np.array(params, float)
        self._next = np.empty_like(self.state)
        self._count = 0  # rows so far
        self._kernel: Kernel | None = None
        self._buffer, self._evaluate = step.buffer()
        self._buffer.set_arg(0, self.state.data)
        self._buffer.set_arg(1, self.w.data)
        self._buffer.set_arg(2, self._params.data)
        self._buffer.set_res(0, self._next.data)
        self._buffer.set_res(1, self.out.data)

    def __call__(self) -> None:
        """Evaluate `out` at the present state and `w`, then advance the state."""
        self._evaluate()
        self.state[:] = self._next

    def settle(self) -> None:
        """Return at once."""

    def run(self, w: Floats) -> Floats:
        """Return the outputs along w (N x outputs) and advance the state.

        Many rows are worth a compilation, after which every bit stays as it was.
        """
        if len(w) < FEW:
            outputs: Floats = np.empty((len(w), self.out.size))
            for k, row in enumerate(w):
                self.w[:] = row
                self()
                outputs[k] = self.out
            return outputs
        self._count += len(w)
        if self._count <= WORTH:
            outputs, self.state[:] = run_interpreted(self._step, self.state, w, self._params)
        else:
            from undeadzone.compile import lanes

            self._kernel = self._kernel or lanes.build_kernel(self._step, width=1)
            outputs, self.state[:] = lanes.run_single_lane(
                self._kernel, self.state, w, self._params
            )
        self.out[:] = outputs[-1]
        return outputs
