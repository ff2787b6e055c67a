"""Cost of single precision: errors of the code in float against double, along a run."""

from __future__ import annotations

import ctypes
import math
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.compile import interpret
from undeadzone.compile.scalar_step import CompiledStepper
from undeadzone.util.arrays import Floats, to_json_value
from undeadzone.util.files import open_scratch
from undeadzone_export.code import Code
from undeadzone_export.compiler import compile_library, stack_bytes, write_sources
from undeadzone_export.exported_step import Field, field_slices, total_size
from undeadzone_export.source import Labels, Source, build_source
from undeadzone_export.template import call_words, fill_template

CHUNK = 500  # steps between two looks at the memory
MACHINE_STEPS = 2000  # of the comparison with CasADi's virtual machine
# bars of that: without elementary functions, and with
EXACT = 1e-13
CLOSE = 1e-9
SHARE_OF_STD = 0.1  # largest error of a width, relative to its standard deviation
SHARE_OF_WIDTH = 1e-3  # the same relative to the width, if no deviation is estimated
SMALLEST = 1e-6  # eigenvalue of a correlation matrix below which float is not enough

Options = tuple[str, ...]  # for the compiler


class Accuracy(NamedTuple):
    """Errors of the code against the graph, and of float against double.

    Attributes:
        machine: largest error of code in double against CasADi's virtual machine, relative to the
            size of each field (None in single precision).
        machine_bar: bound of that error.
        steps: number of steps that float ran beside double (0 in double precision).
        float_against_double: the largest error of float and the largest value, by field.
        sides_differ: at how many steps the measured side differs.
        smallest_correlation_eigenvalue: of a correlation matrix in double (None: no covariance).
        smallest_correlation_eigenvalue_in_float: the same in float.
        refusals: insufficient properties, with their numbers.
        stack: of a step on this computer [bytes] (None: not reported by the compiler).
    """

    machine: float | None
    machine_bar: float | None
    steps: int
    float_against_double: dict[str, dict[str, float]]
    sides_differ: int
    smallest_correlation_eigenvalue: float | None
    smallest_correlation_eigenvalue_in_float: float | None
    refusals: list[str]
    stack: int | None


class CompiledStep:
    """Exported code compiled for this computer, with its own memory.

    Args:
        code: nodes to print.
        folder: folder of the library.
        options: for the compiler.
        text: its C (None: printed here, which takes as long as to make the code).
    """

    def __init__(
        self, code: Code, folder: Path, options: Options = ("-O1",), text: Source | None = None
    ) -> None:
        text = text or build_source(code, Labels(f"run_{code.dtype_name}", "accuracy", "replica"))
        prefix = text.prefix
        files = text.texts_by_name()
        given = bool(code.step.params)
        files[f"{prefix}_run.c"] = fill_template("templates/runner.c", call_words(prefix, given))
        library = compile_library(write_sources(files, folder), folder / f"{prefix}.so", options)
        self._functions = ctypes.CDLL(str(library))
        self.stack = stack_bytes(folder, prefix)
        self.real = code.dtype_name
        self.state = np.zeros(total_size(code.structs["state"]), self.real)
        self.outputs = total_size(code.step.outputs)
        self.reset_memory()

    def reset_memory(self) -> None:
        """Reset the memory to its value at t = 0."""
        self._functions.start(_array_pointer(self.state))

    def __call__(self, rows: Floats) -> Floats:
        """Return the outputs along inputs (N x inputs) as float64 (N x outputs)."""
        given = np.ascontiguousarray(rows, self.real)
        out = np.empty((len(rows), self.outputs), self.real)
        count = ctypes.c_long(len(rows))
        self._functions.run(
            count, _array_pointer(given), _array_pointer(out), _array_pointer(self.state)
        )
        return out.astype(float)


def _array_pointer(values: Any) -> Any:
    """Return the address of an array."""
    return values.ctypes.data_as(ctypes.c_void_p)


def measure_accuracy(printed: Code, text: Source, rows: Floats) -> Accuracy:
    """Compare the code in double with the virtual machine, or that in float with the graph.

    Args:
        printed: the code.
        text: its C, whose elementary functions differ in the last bits.
        rows: the inputs along the scenario's own run, continued (steps x inputs).

    Raises:
        InputError: there is no C compiler.
    """
    with open_scratch() as scratch:
        compiled = CompiledStep(printed, scratch, text=text)
        if printed.single:
            return _compare_precisions(compiled, printed, rows)
        error = _machine_error(printed, compiled, rows[:MACHINE_STEPS])
    bar = CLOSE if text.functions else EXACT
    refusals = []
    if not error <= bar:
        refusals.append(f"the code in double differs from the graph by {error:.2g}, above {bar:g}")
    return Accuracy(error, bar, 0, {}, 0, None, None, refusals, compiled.stack)


def _machine_error(code: Code, replica: CompiledStep, rows: Floats) -> float:
    """Return the largest error of the compiled code against CasADi, relative to each field."""
    step = code.step
    expected, _ = interpret.run_interpreted(step.function, step.start, rows, step.defaults)
    values = replica(rows)
    if not np.array_equal(np.isnan(values), np.isnan(expected)):
        return float("inf")
    gap = np.nan_to_num(np.abs(values - expected), posinf=np.inf)
    size = _signal_size(expected)
    places = field_slices(step.outputs).values()
    return float(max(gap[:, at].max() / (size[:, at].max() + 1e-300) for at in places))


def _compare_precisions(single: CompiledStep, code: Code, rows: Floats) -> Accuracy:
    """Compare float with the graph in double on inputs that float represents exactly."""
    step = code.step
    rows = rows.astype(np.float32).astype(float)
    double = CompiledStepper(step.function, step.start, step.defaults, brief=True)
    runs = []
    pairs = []
    for piece in np.split(rows, range(CHUNK, len(rows), CHUNK)):
        runs.append([double.run(piece), single(piece)])
        pairs.append([smallest_eigenvalue(step.state, one.state) for one in (double, single)])
    exact, rounded = np.concatenate(runs, axis=1)
    places = field_slices(code.step.outputs)
    gap = _precision_gap(exact, rounded)
    size = _signal_size(exact)
    table = {
        field: {"error": float(gap[:, place].max()), "size": float(size[:, place].max())}
        for field, place in places.items()
    }
    least = np.min(np.array(pairs, float), axis=0)  # NaN without a covariance
    refusals = _width_refusals(places, gap, size)
    for eigenvalue, real, bar in zip(least, ("double", "float"), (SMALLEST, 0.0), strict=True):
        if eigenvalue < bar:
            refusals.append(
                f"float is not enough: a correlation matrix has an eigenvalue of {eigenvalue:.2g} "
                f"in {real}, below {bar:g}"
            )
    in_double, in_float = to_json_value(least.tolist())
    differ = int((gap[:, places["side"]] != 0).any(axis=1).sum())
    return Accuracy(
        None, None, len(rows), table, differ, in_double, in_float, refusals, single.stack
    )


def _precision_gap(exact: Floats, rounded: Floats) -> Floats:
    """Return |float - double|: 0 if both are NaN, infinite if one is."""
    same = np.isnan(exact) & np.isnan(rounded)
    gap = np.where(same, 0.0, np.abs(exact - rounded))
    return np.where(np.isnan(gap), np.inf, gap)


def _signal_size(values: Floats) -> Floats:
    """Return the absolute values, with 0 for NaN."""
    return np.nan_to_num(np.abs(values))


def _width_refusals(places: dict[str, slice], gap: Floats, size: Floats) -> list[str]:
    """Return a sentence for each width whose error is too large.

    Args:
        places: where each field stands among the outputs.
        gap: errors of float (steps x outputs).
        size: sizes of the outputs in double (steps x outputs).
    """
    widths = [name for name in ("right", "left") if name in places]
    widest = max([float(size[:, places[name]].max()) for name in widths], default=0.0)
    texts = []
    for name in widths:
        std = places.get(f"{name}_std")
        scale: Floats | float = 1.0
        bar, of = SHARE_OF_WIDTH * max(widest, 1e-30), ""
        if std is not None:
            scale, bar = np.maximum(size[:, std], 1e-30), SHARE_OF_STD
            of = " of its standard deviation"
        worst = float((gap[:, places[name]] / scale).max())
        if not worst <= bar:
            texts.append(
                f"float is not enough: {name} is wrong by {worst:.2g}{of}, above {bar:.2g}"
            )
    return texts


def smallest_eigenvalue(fields: list[Field], state: Any) -> float | None:
    """Return the smallest eigenvalue of the correlation matrices in a memory [1], or None.

    Args:
        fields: the fields of the memory.
        state: its numbers.
    """
    places = field_slices(fields)
    values = []
    for name, place in places.items():
        if name.endswith("cov"):
            mean = places[name.removesuffix("cov") + "mean"]
            matrix = _from_triangle(np.asarray(state[place], float), mean.stop - mean.start)
            if not np.isfinite(matrix).all():
                return -math.inf
            std = np.sqrt(np.abs(np.diagonal(matrix)))
            std[std == 0] = 1.0
            values.append(float(np.linalg.eigvalsh(matrix / np.outer(std, std))[0]))
    return min(values) if values else None


def _from_triangle(column: Floats, size: int) -> Floats:
    """Return the symmetric matrix of an upper triangle, whole or of uncoupled equal groups."""
    blocks = 2 * column.size // size - 1
    entries = ca.triu(ca.kron(ca.DM.ones(blocks, blocks), ca.DM.eye(size // blocks))).sparsity()
    rows, columns = entries.get_triplet()
    matrix = np.zeros((size, size))
    matrix[rows, columns] = matrix[columns, rows] = column
    return matrix
