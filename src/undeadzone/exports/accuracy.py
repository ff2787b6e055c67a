"""What single precision costs: the code in float beside the same in double, along a run."""

from __future__ import annotations

import ctypes
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.compile import interpret
from undeadzone.exports.code import Code
from undeadzone.exports.compiler import shared_library, stack_bytes
from undeadzone.exports.fields import Field
from undeadzone.exports.source import Labels, source
from undeadzone.support.arrays import Floats

CHUNK = 500  # steps between two looks at the memory
MACHINE_STEPS = 2000  # of the comparison with CasADi's virtual machine
EXACT, CLOSE = 1e-13, 1e-9  # bars of that: without elementary functions, and with
SHARE_OF_STD = 0.1  # largest error of a width, relative to its standard deviation
SHARE_OF_WIDTH = 1e-3  # the same relative to the width, where no deviation is estimated
SMALLEST = 1e-6  # eigenvalue of a correlation matrix below which float is not enough

_RUNNER = """#include "{prefix}.h"
#include <string.h>
void run(long steps, const {prefix}_in *in, {prefix}_out *out, {prefix}_state *state);
void start({prefix}_state *state);
void start({prefix}_state *state)
{{
    {prefix}_init(state);
}}
void run(long steps, const {prefix}_in *in, {prefix}_out *out, {prefix}_state *state)
{{
{params}    for (long k = 0; k < steps; k++) {{
        {prefix}_step(state, {argument}&in[k], &out[k]);
    }}
}}
"""


class Row(NamedTuple):
    """A line of the accuracy table.

    Attributes:
        name: field of the output.
        error: largest difference of float and double.
        size: largest value.
    """

    name: str
    error: float
    size: float


class Accuracy(NamedTuple):
    """How near the code comes to the graph, and float to double.

    Attributes:
        machine: largest error of the code in double against CasADi's virtual machine, relative to
            the size of each field.
        machine_bar: what it must stay below.
        steps: how many steps float ran beside double; 0 in double precision.
        rows: the largest errors of float, by field.
        sides: at how many steps the measured side differs.
        eigenvalue: smallest eigenvalue of a correlation matrix in double; None: no covariance.
        eigenvalue_in_float: the same in float.
        refusals: what is not good enough, with its number.
        stack: of a step on this computer [bytes]; None: the compiler does not tell.
    """

    machine: float
    machine_bar: float
    steps: int
    rows: list[Row]
    sides: int
    eigenvalue: float | None
    refusals: list[str]
    stack: int | None = None
    eigenvalue_in_float: float | None = None


class Compiled:
    """The exported code compiled for this computer, with its own memory.

    Args:
        code: what is printed.
        folder: where the library goes.
    """

    def __init__(self, code: Code, folder: Path) -> None:
        prefix = f"run_{code.kind}"
        text = source(code, Labels(prefix, "accuracy", "replica"))
        params = f"    {prefix}_params params;\n    {prefix}_params_default(&params);\n"
        runner = _RUNNER.format(
            prefix=prefix,
            params=params if code.step.params else "",
            argument="&params, " if code.step.params else "",
        )
        (folder / f"{prefix}.h").write_text(text.header)
        (folder / f"{prefix}.c").write_text(text.code)
        (folder / f"{prefix}_math.h").write_text(text.math)
        (folder / f"{prefix}_run.c").write_text(runner)
        files = [folder / f"{prefix}.c", folder / f"{prefix}_run.c"]
        library = ctypes.CDLL(str(shared_library(files, folder / f"{prefix}.so")))
        self._run = library.run
        self.stack = stack_bytes(folder, prefix)
        self.real = code.kind
        carried = 0 if code.phases is None else code.phases.carried
        self.memory = code.step.start.size
        self.state = np.zeros(self.memory + carried, self.real)
        self.outputs = sum(field.size for field in code.step.outputs)
        library.start(_address(self.state))

    def __call__(self, rows: Floats) -> Floats:
        """The outputs along inputs (N x inputs), as float64 (N x outputs)."""
        given = np.ascontiguousarray(rows, self.real)
        out = np.empty((len(rows), self.outputs), self.real)
        self._run(ctypes.c_long(len(rows)), _address(given), _address(out), _address(self.state))
        return out.astype(float)


def _address(values: Any) -> Any:
    """Where an array begins."""
    return values.ctypes.data_as(ctypes.c_void_p)


def measure(double: Code, single: Code | None, rows: Floats, functions: bool) -> Accuracy:
    """Compare the code in double with the virtual machine, and in float with that in double.

    Args:
        double: the code in double.
        single: the code in float; None: the export is in double.
        rows: the inputs along the scenario's own run, continued (steps x inputs).
        functions: whether the code uses elementary functions, which differ in the last bits.

    Raises:
        InputError: there is no C compiler.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        replica = Compiled(double, folder)
        error = _against_machine(double, replica, rows[:MACHINE_STEPS])
        bar = CLOSE if functions else EXACT
        refusals = []
        if not error <= bar:
            refusals.append(
                f"the code in double differs from the graph by {error:.2g}, above {bar:g}"
            )
        plain = Accuracy(error, bar, 0, [], 0, None, refusals, replica.stack)
        if single is None:
            return plain
        rounded = Compiled(single, folder)
        plain = plain._replace(stack=rounded.stack)
        return _beside(plain, Compiled(double, folder), rounded, single, rows)


def _against_machine(code: Code, replica: Compiled, rows: Floats) -> float:
    """The largest error of the compiled code against CasADi, relative to each field."""
    step = code.step
    function = step.function
    expected, _ = interpret.run(_three_inputs(function), step.start, rows, step.defaults)
    values = replica(rows)
    if not np.array_equal(np.isnan(values), np.isnan(expected)):
        return float("inf")
    gap = np.nan_to_num(np.abs(values - expected), posinf=np.inf)
    size = np.nan_to_num(np.abs(expected))
    shares = []
    for place in places_of(step.outputs).values():
        shares.append(gap[:, place].max() / (size[:, place].max() + 1e-300))
    return float(max(shares))


def _three_inputs(function: ca.Function) -> ca.Function:
    """The function as the virtual machine's runner wants it: dense outputs."""
    s, w, p = (ca.SX.sym(name, function.size1_in(k)) for k, name in enumerate("swp"))
    results = [ca.densify(result) for result in function(s, w, p)]
    return ca.Function("step", [s, w, p], results)


def _beside(
    plain: Accuracy, double: Compiled, single: Compiled, code: Code, rows: Floats
) -> Accuracy:
    """Float beside double, on inputs that float holds exactly."""
    rows = rows.astype(np.float32).astype(float)
    errors = np.zeros(double.outputs)
    sizes = np.zeros(double.outputs)
    judge = _Judge(code.step.outputs)
    eigenvalues: list[Floats] = []
    for start in range(0, len(rows), CHUNK):
        piece = rows[start : start + CHUNK]
        exact, rounded = double(piece), single(piece)
        judge.look(exact, rounded)
        errors = np.maximum(errors, _gap(exact, rounded).max(axis=0))
        sizes = np.maximum(sizes, np.nan_to_num(np.abs(exact)).max(axis=0))
        pair = [smallest_eigenvalue(code.step.state, one.state) for one in (double, single)]
        eigenvalues.append(np.array(pair, float))
    table = []
    for field, places in judge.places.items():
        table.append(Row(field, float(errors[places].max()), float(sizes[places].max())))
    least = np.min(eigenvalues, axis=0)  # in double and in float; NaN where there is no covariance
    refusals = plain.refusals + judge.refusals()
    for eigenvalue, real, bar in zip(least, ("double", "float"), (SMALLEST, 0.0), strict=True):
        if eigenvalue < bar:
            refusals.append(
                f"float is not enough: a correlation matrix has an eigenvalue of {eigenvalue:.2g} "
                f"in {real}, below {bar:g}; use --precision double"
            )
    has_covariance = bool(np.isfinite(least).all())
    in_double, in_float = map(float, least) if has_covariance else (None, None)
    return plain._replace(
        steps=len(rows),
        rows=table,
        sides=judge.sides,
        eigenvalue=in_double,
        refusals=refusals,
        eigenvalue_in_float=in_float,
    )


def _gap(exact: Floats, rounded: Floats) -> Floats:
    """|float - double|; 0 where both are NaN, infinite where one is."""
    same = np.isnan(exact) & np.isnan(rounded)
    gap = np.where(same, 0.0, np.abs(exact - rounded))
    return np.where(np.isnan(gap), np.inf, gap)


def places_of(fields: list[Field]) -> dict[str, slice]:
    """Where each field stands among the numbers of a struct."""
    places: dict[str, slice] = {}
    start = 0
    for field in fields:
        places[field.name] = slice(start, start + field.size)
        start += field.size
    return places


class _Judge:
    """Collects the errors of the widths along a run."""

    def __init__(self, outputs: list[Field]) -> None:
        self.places = places_of(outputs)
        self.sides = 0
        self.worst: dict[str, float] = {}
        self.width = 0.0

    def look(self, exact: Floats, rounded: Floats) -> None:
        """Take in the outputs of some steps."""
        side = self.places["side"]
        self.sides += int((exact[:, side] != rounded[:, side]).any(axis=1).sum())
        for name in ("right", "left"):
            if name not in self.places:
                continue
            place = self.places[name]
            error = _gap(exact[:, place], rounded[:, place])
            self.width = max(self.width, float(np.abs(exact[:, place]).max()))
            std = self.places.get(f"{name}_std")
            if std is not None:
                error = error / np.maximum(np.abs(exact[:, std]), 1e-30)
            self.worst[name] = max(self.worst.get(name, 0.0), float(error.max()))

    def refusals(self) -> list[str]:
        """The widths whose errors are too large, in words."""
        texts = []
        for name, worst in self.worst.items():
            claimed = f"{name}_std" in self.places
            bar = SHARE_OF_STD if claimed else SHARE_OF_WIDTH * max(self.width, 1e-30)
            if not worst <= bar:
                of = " of its standard deviation" if claimed else ""
                texts.append(
                    f"float is not enough: {name} is wrong by {worst:.2g}{of}, above {bar:.2g}; "
                    "use --precision double"
                )
        return texts


def smallest_eigenvalue(fields: list[Field], state: Any) -> float | None:
    """The smallest eigenvalue of the correlation matrices in a memory; None: there are none.

    Args:
        fields: the fields of the memory.
        state: its numbers.
    """
    sizes = {field.name: field.size for field in fields}
    start, values = 0, []
    for field in fields:
        part = np.asarray(state[start : start + field.size], float)
        start += field.size
        if field.name.endswith("cov"):
            matrix = _symmetric(part, sizes.get(field.name[:-3] + "mean", 0))
            std = np.sqrt(np.abs(np.diagonal(matrix)))
            std[std == 0] = 1.0
            values.append(float(np.linalg.eigvalsh(matrix / np.outer(std, std))[0]))
    return min(values) if values else None


def _symmetric(column: Floats, size: int) -> Floats:
    """The symmetric matrix of an upper triangle, whole or of uncoupled groups of equal size."""
    blocks = 2 * column.size // size - 1
    entries = ca.triu(ca.kron(ca.DM.ones(blocks, blocks), ca.DM.eye(size // blocks))).sparsity()
    rows, columns = entries.get_triplet()
    matrix = np.zeros((size, size))
    matrix[rows, columns] = column
    matrix[columns, rows] = column
    return matrix
