"""Step compiled for a single run: a call for each sample, or for several samples at a time."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable
from typing import Final

import casadi as ca
import numpy as np

from undeadzone.compile import cache
from undeadzone.compile.interpret import Stepper
from undeadzone.compile.kernel import build_graphs, print_kernel
from undeadzone.compile.lower import Arithmetic
from undeadzone.compile.machine import ONE, Shape, host_machine
from undeadzone.errors import InputError
from undeadzone.util.arrays import Floats

KINDS: Final = ("float64*",)
CALL_SAMPLES: Final = 128  # samples in a call
BRIEF_RUN: Final = 512  # samples up to which a brief run is not worth a compilation

# A call's memory holds the number of samples, p, s, and w and out of each sample.
_BLOCK: Final = """
define void @block(ptr noalias %memory) nounwind {{
  %samples = load double, ptr %memory
  %steps = fptosi double %samples to i64
  %p = getelementptr double, ptr %memory, i64 {p}
  %s = getelementptr double, ptr %memory, i64 {s}
  %w = getelementptr double, ptr %memory, i64 {w}
  %out = getelementptr double, ptr %memory, i64 {out}
  call void @steps(i64 %steps, i64 1, ptr %s, ptr %w, ptr %p, ptr %w, ptr %out)
  ret void
}}
"""


class CompiledStepper:
    """Machine code for `interpret.Stepper`: the same bits in a fraction of the time.

    All numbers stand in one array, so that a call takes one address. Parameters are run-time
    numbers: the code is compiled once for all of them and cached on disk. Until then the virtual
    machine runs the samples, then unoptimised code. The code is exchanged between two samples.

    Args:
        step: next, out = step(s, w, p).
        state: at the beginning (states).
        params: p.
        brief: for one run by `run`: the virtual machine runs `BRIEF_RUN` samples, code without
            optimisation runs the rest.

    Attributes:
        engine: engine that runs a sample: "compiled", "compiled, first form" while a faster one is
            made, "virtual machine" and the reason.

    Raises:
        InputError: an instruction cannot be compiled (of a brief run; others stay on the virtual
            machine).
    """

    def __init__(
        self, step: ca.Function, state: Floats, params: Floats, brief: bool = False
    ) -> None:
        # Number of samples, p, s, inputs and outputs of a call, one after the other.
        sizes = [
            1,
            params.size,
            state.size,
            CALL_SAMPLES * step.size1_in(1),
            CALL_SAMPLES * step.size1_out(1),
        ]
        starts = np.cumsum([0, *sizes]).tolist()
        self._memory = np.zeros(starts[-1])
        self._memory[0] = 1.0
        self._memory[starts[1] : starts[2]] = params
        self.state = self._memory[starts[2] : starts[3]]
        self.state[:] = state
        self._input_rows = self._memory[starts[3] : starts[4]].reshape(CALL_SAMPLES, -1)
        self._output_rows = self._memory[starts[4] : starts[5]].reshape(CALL_SAMPLES, -1)
        self.w = self._input_rows[0]
        self.out = self._output_rows[0]
        self._address = ctypes.c_void_p(self._memory.ctypes.data)
        self._recipe = _stepper_recipe(step, starts)
        # Number of samples that are left until `run` compiles the step.
        self._uncompiled_samples = BRIEF_RUN if brief else np.inf
        self._thread: threading.Thread | None = None
        block = cache.read_cached_block(self._recipe, KINDS)
        if block is not None:
            self._switch_code(block)
            self._uncompiled_samples = np.inf
            return
        self.engine = "virtual machine, while the step is compiled"
        self._call = self._build_interpreter_call(Stepper(step, state, params))
        if not brief:
            self._thread = threading.Thread(target=self._compile_in_thread, name="compile")
            self._thread.start()

    def _build_interpreter_call(self, machine: Stepper) -> Callable[[object], None]:
        """Return the call of the virtual machine on the same memory."""

        def call(_: object) -> None:
            """Run the samples of a call."""
            machine.state[:] = self.state
            for row, out in zip(
                self._input_rows[: int(self._memory[0])], self._output_rows, strict=False
            ):
                machine.w[:] = row
                machine()
                out[:] = machine.out
            self.state[:] = machine.state

        return call

    def _compile_in_thread(self) -> None:
        """Compile, and exchange the called code each time that better code is ready."""
        try:
            block = cache.load_or_compile(self._recipe, KINDS, True, cache.IN_PIECES)
        except InputError as error:
            self.engine = f"virtual machine: {error}"
            return
        self._switch_code(block)
        block.wait_until_best()
        self._switch_code(block)

    def _switch_code(self, block: cache.CompiledBlock) -> None:
        """Run the present code of a block from the next sample on."""
        function = ctypes.cast(block.c_function, ctypes.c_void_p).value
        assert function is not None
        # It holds the interpreter's lock, as a change of threads takes longer than a sample.
        self._call = ctypes.PYFUNCTYPE(None, ctypes.c_void_p)(function)
        self._block = block  # its code must outlive the call
        self.engine = "compiled" if block.has_best else "compiled, first form"

    def settle(self) -> None:
        """Wait until the fastest code runs the samples."""
        if self._thread is not None:
            self._thread.join()

    def __call__(self) -> None:
        """Evaluate `out` at the present state and `w`, then advance the state."""
        self._call(self._address)

    def run(self, w: Floats) -> Floats:
        """Run N samples: return their outputs (N x outputs), and advance the state.

        A call of the code runs up to `CALL_SAMPLES` of them. It reads their number and inputs from
        the shared memory and writes their outputs to it.

        Args:
            w: exogenous inputs, a row for each sample (N x inputs).
        """
        outputs = np.empty((len(w), self.out.size))
        for start in range(0, len(w), CALL_SAMPLES):
            if self._uncompiled_samples <= 0:
                self._switch_code(cache.load_or_compile(self._recipe, KINDS, True, 0))
                self._uncompiled_samples = np.inf
            rows = w[start : start + CALL_SAMPLES]
            self._uncompiled_samples -= len(rows)
            self._input_rows[: len(rows)] = rows
            self._memory[0] = len(rows)  # number of samples of the call
            self()
            outputs[start : start + len(rows)] = self._output_rows[: len(rows)]
        self._memory[0] = 1.0  # as `__call__` expects
        if len(w):
            self.out[:] = outputs[-1]
        return outputs


def _stepper_recipe(step: ca.Function, starts: list[int]) -> cache.Recipe:
    """Return the recipe of `block`, whose memory has parts that begin at `starts`."""
    sizes = (step.size1_in(0), step.size1_in(1), step.size1_in(2))
    shape = Shape(sizes, (), (), tuple(range(step.size1_out(1))))
    functions = build_graphs(step, (), shape, {}, {})

    def make() -> tuple[str, str]:
        """Return the text of the kernel and an empty note."""
        kernel = print_kernel(functions, shape, host_machine(), Arithmetic(), 1, ONE, "steps")
        _, p, s, w, out, _ = starts
        return kernel.text + _BLOCK.format(p=p, s=s, w=w, out=out), ""

    return cache.Recipe(f"{functions.usual.serialize()}\n{shape} {starts}", make)
