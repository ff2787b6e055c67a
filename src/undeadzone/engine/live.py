"""A step compiled for one run: a call for each sample, or for some at a time."""

from __future__ import annotations

import ctypes
from typing import Final

import casadi as ca
import numpy as np

from undeadzone.engine import cache
from undeadzone.engine.emit import helpers, straight_line
from undeadzone.support.arrays import Floats

ROWS: Final = 128  # samples in a call

_BLOCK: Final = """
def block(memory):
    memory = carray(memory, {size})
    for k in range(int(memory[0])):
        w, out = {w} + k * {inputs}, {out} + k * {outputs}
        {lines}
"""


class CompiledStepper:
    """`interpret.Stepper` in machine code: the same bits, a fraction of the time.

    All numbers stand in one array, so that a call takes one address. It is compiled once, whatever
    the numbers, and kept on disk.

    Args:
        step: next, out = step(s, w, p).
        state: at the beginning (states).
        params: p.

    Raises:
        InputError: an instruction that cannot be compiled.
    """

    def __init__(self, step: ca.Function, state: Floats, params: Floats) -> None:
        sizes = [1, params.size, state.size, ROWS * step.size1_in(1), ROWS * step.size1_out(1)]
        starts = np.cumsum([0, *sizes]).tolist()
        self._memory = np.zeros(starts[-1])
        self._memory[0] = 1.0
        self._memory[starts[1] : starts[2]] = params
        self.state = self._memory[starts[2] : starts[3]]
        self.state[:] = state
        self._rows = self._memory[starts[3] : starts[4]].reshape(ROWS, -1)
        self._outs = self._memory[starts[4] : starts[5]].reshape(ROWS, -1)
        self.w, self.out = self._rows[0], self._outs[0]
        self._block = cache.load(_source(step, starts), ("float64*",))
        function = ctypes.cast(self._block.function, ctypes.c_void_p).value
        assert function is not None
        # It holds the interpreter's lock, as a change of threads takes longer than a sample.
        self._call = ctypes.PYFUNCTYPE(None, ctypes.c_void_p)(function)
        self._address = ctypes.c_void_p(self._memory.ctypes.data)

    def __call__(self) -> None:
        """Evaluate `out` at the present state and `w`, then advance the state."""
        self._call(self._address)

    def run(self, w: Floats) -> Floats:
        """The outputs along w (N x inputs), a row each; the state advances."""
        outputs = np.empty((len(w), self.out.size))
        for start in range(0, len(w), ROWS):
            rows = w[start : start + ROWS]
            self._rows[: len(rows)] = rows
            self._memory[0] = len(rows)
            self()
            outputs[start : start + len(rows)] = self._outs[: len(rows)]
        self._memory[0] = 1.0
        if len(w):
            self.out[:] = outputs[-1]
        return outputs


def _source(step: ca.Function, starts: list[int]) -> str:
    """The text of `block`; its memory is the count, p, s, and w and out of each sample."""
    columns = [ca.SX.sym(name, step.size1_in(k)) for k, name in enumerate("swp")]
    results = [ca.densify(result) for result in step(*columns)]
    code = straight_line(ca.Function("live", columns, results, ["s", "w", "p"], ["next", "out"]))
    _, p, s, w, out, size = starts
    lines = [f"s{i} = memory[{s + i}]" for i in code.reads[0]]
    lines += [f"w{i} = memory[w + {i}]" for i in code.reads[1]]
    lines += [f"p{i} = memory[{p + i}]" for i in code.reads[2]]
    lines += code.statements
    lines += [f"memory[{s + i}] = {name}" for i, name in enumerate(code.results[0])]
    lines += [f"memory[out + {i}] = {name}" for i, name in enumerate(code.results[1])]
    text = _BLOCK.format(
        size=size,
        w=w,
        out=out,
        inputs=step.size1_in(1),
        outputs=step.size1_out(1),
        lines="\n        ".join(lines),
    )
    return helpers(False) + text
