"""CasADi's own virtual machine: one run, no compiler, nothing to wait for."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np

from undeadzone.support.arrays import Floats

CHUNK = 500


def run(
    step: ca.Function,
    state: Floats,
    exogenous: Floats,
    params: Floats,
    progress: Callable[[int], None] | None = None,
) -> tuple[Floats, Floats]:
    """(outputs (N x outputs), final state) of `step` along exogenous (N x inputs); progress is told of steps done."""
    total = exogenous.shape[0]
    outputs = np.empty((total, step.size1_out(1)))
    state = np.ascontiguousarray(state, float).copy()
    exogenous = np.ascontiguousarray(exogenous, float)
    start = 0
    for count in (min(CHUNK, total), 1):
        many = step.mapaccum(count) if count > 1 else step
        repeated, states = np.tile(params, (count, 1)), np.empty((count, state.size))
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


def mapped(function: ca.Function, count: int) -> Callable[[Floats, Floats], Floats]:
    """(rows (count x inputs), params) -> function(row, params) of each row (count x outputs)."""
    buffer, evaluate = function.map(count).buffer()

    def values(rows: Floats, params: Floats) -> Floats:
        given, repeated, found = (
            np.ascontiguousarray(rows, float),
            np.tile(params, (count, 1)),
            np.empty((count, function.size1_out(0))),
        )
        buffer.set_arg(0, given.data)
        buffer.set_arg(1, repeated.data)
        buffer.set_res(0, found.data)
        evaluate()
        return found

    return values


class Stepper:
    """One step at a time, in place: fill `w`, call, read `out`; `state` advances. Zero copies, for live use."""

    def __init__(self, step: ca.Function, state: Floats, params: Floats) -> None:
        self.state = np.array(state, float)
        self.w = np.zeros(step.size1_in(1))
        self.out = np.zeros(step.size1_out(1))
        self._params = np.array(params, float)
        self._next = np.empty_like(self.state)
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
