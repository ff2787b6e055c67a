"""The text of a kernel: a step for many lanes as a Python function that numba compiles."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import casadi as ca

from undeadzone.engine.emit import Code, helpers, straight_line

KINDS = ("int64", *["float64*"] * 5)  # of the arguments of a kernel
GROUP = 8  # lanes whose rare part is computed together


class Shape(NamedTuple):
    """What a kernel is compiled for.

    Attributes:
        width: lanes.
        sizes: of s, w and p.
        exogenous, params: entries of w and p that each lane has for itself.
        record: outputs that are kept.
    """

    width: int
    sizes: tuple[int, int, int]
    exogenous: tuple[int, ...]
    params: tuple[int, ...]
    record: tuple[int, ...]


class Rows(NamedTuple):
    """The first row of each part of a kernel's work array, which begins with the states.

    A lane's numbers stand in one array at constant distances: LLVM need not ask whether they
    overlap, and vectorises whatever their number.

    Attributes:
        width: lanes.
        params, own: a lane's own params and inputs.
        out: outputs.
        before: states before the step.
        flag: whether a rare part is needed.
        chosen: the numbers of the lanes that need one.
        few: all these rows again for a few such lanes.
        end: the number of rows.
    """

    width: int
    params: int
    own: int
    out: int
    before: int
    flag: int
    chosen: int
    few: int
    end: int

    def at(self, row: int) -> str:
        """Where lane j has its number of a row."""
        return f"work[{row * stride(self.width)} + j]"


def stride(width: int) -> int:
    """The numbers of a row of a work array.

    Rows whose distance is no power of 2 share no set of the cache.
    """
    return width + 8 if width > 1 else 1


def source(
    step: ca.Function,
    rare: Sequence[ca.Function],
    shape: Shape,
    w: Mapping[int, float],
    p: Mapping[int, float],
    fused: bool,
) -> tuple[str, int]:
    """The text of a kernel, and the rows of its work array.

    Args:
        step, rare, fused: as for `lanes.build`.
        shape: what it is compiled for.
        w, p: what is known of these inputs.
    """
    columns = [ca.SX.sym(name, size) for name, size in zip("swp", shape.sizes, strict=True)]
    inputs = [columns[0], _substituted(columns[1], w), _substituted(columns[2], p)]
    following, out, *flag = (ca.densify(ca.SX(value)) for value in step(*inputs))
    usual = straight_line(_graph(columns, [following, out[list(shape.record)], *flag]), fused)
    parts = []
    for part in rare:
        results = [ca.densify(ca.SX(value)) for value in part(*inputs)]
        parts.append(straight_line(_graph(columns, results), fused))
    rows = _rows(shape, parts)
    texts = [helpers(fused)]
    if parts:
        texts += [_rare(k, code, shape, rows) for k, code in enumerate(parts)]
        texts.append(_finish(parts, shape, rows))
    texts.append(_block(usual, parts, shape, rows))
    return "\n".join(texts), rows.end


def _substituted(column: ca.SX, known: Mapping[int, float]) -> ca.SX:
    """A column with the entries that are known in their places."""
    return ca.vertcat(*(known.get(i, column[i]) for i in range(column.numel())))


def _saved(parts: list[Code]) -> int:
    """How many of the first states rare parts need from before the step."""
    return max((1 + max(code.reads[0], default=-1) for code in parts), default=0)


def _rows(shape: Shape, parts: list[Code]) -> Rows:
    """The rows of a kernel with these rare parts."""
    sizes = [shape.sizes[0], len(shape.params), len(shape.exogenous), len(shape.record)]
    sizes.append(_saved(parts))
    sizes += [1, 1, sum(sizes) + 1] if parts else [0, 0, 0]
    return Rows(shape.width, *itertools.accumulate(sizes))


def _block(usual: Code, parts: list[Code], shape: Shape, rows: Rows) -> str:
    """The function that makes steps, `usual` being the code of one."""
    arrays = {
        "work": rows.end * stride(shape.width),
        "exogenous": f"steps * {shape.sizes[1]}",
        "params": shape.sizes[2],
        "own": f"steps * {len(shape.exogenous) * shape.width}",
        "outputs": f"steps * {len(shape.record) * shape.width}",
    }
    shaped = [f"{name} = carray({name}, {size})" for name, size in arrays.items()]
    loop = [
        *_shared(usual, shape),
        *_copied(shape, rows.own, "own", len(shape.exogenous)),
        f"for j in range({shape.width}):",
        *_indented(_lane(usual, parts, shape, rows)),
    ]
    if parts:
        loop.append("finish(k, work, exogenous, params)")
    loop += _copied(shape, rows.out, "outputs", len(shape.record))
    lines = [
        f"def block(steps, {', '.join(arrays)}):",
        *_indented([*shaped, *_steady(usual, shape)]),
        "    for k in range(steps):",
        *_indented(loop, 2),
    ]
    return "\n".join(lines)


def _lane(usual: Code, parts: list[Code], shape: Shape, rows: Rows) -> list[str]:
    """The step of lane j, `usual` being its code."""
    lines = [*_inputs(usual, shape, rows, 0), *usual.statements]
    for i in range(_saved(parts)):
        lines.append(f"{rows.at(rows.before + i)} = {rows.at(i)}")
    for i, name in enumerate(usual.results[0]):
        lines.append(f"{rows.at(i)} = {name}")
    for i, name in enumerate(usual.results[1]):
        lines.append(f"{rows.at(rows.out + i)} = {name}")
    if parts:
        lines.append(f"{rows.at(rows.flag)} = {usual.results[2][0]}")
    return lines


_FINISH = """
@njit(error_model="numpy")
def finish(k, work, exogenous, params):
    flags = work[{flag} * {apart} : {flag} * {apart} + {width}]
    count = 0
    for j in range({width}):
        count += flags[j] != 0.0
    if count:
        rarely(k, work, flags, exogenous, params)


@njit(error_model="numpy")
def rarely(k, work, flags, exogenous, params):
    chosen, few = work[{chosen} * {apart} : {few} * {apart}], work[{few} * {apart} :]
    count = 0
    for j in range({width}):
        chosen[count] = j
        count += flags[j] != 0.0
    for first in range(0, count, {group}):
        some = chosen[first : min(first + {group}, count)]
        for row in range({params}, {flag} + 1):
            for m in range(some.size):
                few[row * {apart} + m] = work[row * {apart} + int(some[m])]
{calls}
        for row in range({next}):
            for m in range(some.size):
                work[row * {apart} + int(some[m])] = few[row * {apart} + m]

"""


_AGAIN = """        again = 0
        for m in range(some.size):
            again += few[{flag} * {apart} + m] != 0.0
        if again:
            rare{part}(k, few, exogenous, params)"""


def _finish(parts: list[Code], shape: Shape, rows: Rows) -> str:
    """The functions that compute rare parts for the lanes that need them, a few at a time."""
    numbers = rows._asdict()
    numbers["apart"] = stride(shape.width)
    numbers["group"] = min(shape.width, GROUP)
    numbers["next"] = len(parts[0].results[0])
    calls = ["        rare0(k, few, exogenous, params)"]
    for k in range(1, len(parts)):
        calls.append(_AGAIN.format(part=k, **numbers))
    return _FINISH.format(calls="\n".join(calls), **numbers)


def _rare(part: int, code: Code, shape: Shape, rows: Rows) -> str:
    """A rare part of the step, of those of the first lanes of a work array whose flag is set."""
    following, (flag,) = code.results
    lane = [
        *_inputs(code, shape, rows, rows.before),
        *code.statements,
        f"flagged = {rows.at(rows.flag)} != 0.0",
    ]
    for i, name in enumerate(following):
        lane.append(f"{rows.at(i)} = select(flagged, {name}, {rows.at(i)})")
    lane.append(f"{rows.at(rows.flag)} = {flag}")
    body = [
        *_steady(code, shape),
        *_shared(code, shape),
        f"for j in range({min(shape.width, GROUP)}):",
        *_indented(lane),
    ]
    lines = [
        '@njit(error_model="numpy")',
        f"def rare{part}(k, work, exogenous, params):",
        *_indented(body),
        "",
    ]
    return "\n".join(lines)


def _steady(code: Code, shape: Shape) -> list[str]:
    """The params that all lanes share."""
    return [f"p{i} = params[{i}]" for i in code.reads[2] if i not in shape.params]


def _shared(code: Code, shape: Shape) -> list[str]:
    """The exogenous inputs of step k that all lanes share."""
    return [
        f"w{i} = exogenous[k * {shape.sizes[1]} + {i}]"
        for i in code.reads[1]
        if i not in shape.exogenous
    ]


def _inputs(code: Code, shape: Shape, rows: Rows, states: int) -> list[str]:
    """What lane j reads, its state from row `states` on."""
    s, w, p = code.reads
    lines = [f"s{i} = {rows.at(states + i)}" for i in s]
    for i in w:
        if i in shape.exogenous:
            lines.append(f"w{i} = {rows.at(rows.own + shape.exogenous.index(i))}")
    for i in p:
        if i in shape.params:
            lines.append(f"p{i} = {rows.at(rows.params + shape.params.index(i))}")
    return lines


def _copied(shape: Shape, row: int, array: str, count: int) -> list[str]:
    """Rows from `row` on filled from `own`, or copied to `outputs`, at step k.

    Of indices into a part of an array, unlike those that k multiplies, LLVM knows the sign, and so
    vectorises.
    """
    if count == 0:
        return []
    inside = f"work[({row} + i) * {stride(shape.width)} + j]"
    outside = f"part[i * {shape.width} + j]"
    target, value = (inside, outside) if array == "own" else (outside, inside)
    size = count * shape.width
    return [
        f"part = {array}[k * {size} : (k + 1) * {size}]",
        f"for i in range({count}):",
        f"    for j in range({shape.width}):",
        f"        {target} = {value}",
    ]


def _graph(columns: list[ca.SX], results: list[ca.SX]) -> ca.Function:
    """The function of s, w and p with these results."""
    names = [f"result{i}" for i in range(len(results))]
    return ca.Function("graph", columns, results, ["s", "w", "p"], names)


def _indented(lines: list[str], depth: int = 1) -> list[str]:
    """Lines moved to the right."""
    return [f"{'    ' * depth}{line}" for line in lines]
