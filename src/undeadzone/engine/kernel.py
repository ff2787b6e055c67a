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
    """width: lanes; sizes: of s, w and p; exogenous, params: entries of w and p that each lane has for itself; record: outputs that are kept."""

    width: int
    sizes: tuple[int, int, int]
    exogenous: tuple[int, ...]
    params: tuple[int, ...]
    record: tuple[int, ...]


class Rows(NamedTuple):
    """The first row of each part of a kernel's work array: states, own params, own inputs, outputs, states before the step, flag.

    If there are rare parts, the numbers of the lanes that need them follow, and all these rows again for a few such lanes.
    A lane's numbers stand in one array at constant distances: LLVM need not ask whether they overlap, and vectorises
    whatever their number.
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
    """The numbers of a row of a work array: rows whose distance is no power of 2 share no set of the cache."""
    return width + 8 if width > 1 else 1


def source(
    step: ca.Function,
    rare: Sequence[ca.Function],
    shape: Shape,
    w: Mapping[int, float],
    p: Mapping[int, float],
    fused: bool,
) -> tuple[str, int]:
    """(the text of the kernel, the rows of its work array), w and p being what is known of its inputs."""
    columns = [ca.SX.sym(name, size) for name, size in zip("swp", shape.sizes, strict=True)]
    given = [
        columns[0],
        *(
            ca.vertcat(*(known.get(i, column[i]) for i in range(column.numel())))
            for column, known in zip(columns[1:], (w, p), strict=True)
        ),
    ]
    following, out, *flag = (ca.densify(ca.SX(value)) for value in step(*given))
    usual = straight_line(_graph(columns, [following, out[list(shape.record)], *flag]), fused)
    codes = [
        straight_line(_graph(columns, [ca.densify(ca.SX(value)) for value in part(*given)]), fused)
        for part in rare
    ]
    saved = max((1 + max(code.reads[0], default=-1) for code in codes), default=0)
    sizes = [shape.sizes[0], len(shape.params), len(shape.exogenous), len(shape.record), saved]
    rows = Rows(
        shape.width,
        *itertools.accumulate([*sizes, *((1, 1, sum(sizes) + 1) if codes else (0, 0, 0))]),
    )
    lane = [
        *_inputs(usual, shape, rows, 0),
        *usual.statements,
        *(f"{rows.at(rows.before + i)} = {rows.at(i)}" for i in range(saved)),
        *(f"{rows.at(i)} = {name}" for i, name in enumerate(usual.results[0])),
        *(f"{rows.at(rows.out + i)} = {name}" for i, name in enumerate(usual.results[1])),
    ]
    loop = [
        *_shared(usual, shape),
        *_copied(shape, rows.own, "own", len(shape.exogenous)),
        f"for j in range({shape.width}):",
    ]
    arrays = {
        "work": rows.end * stride(shape.width),
        "exogenous": f"steps * {shape.sizes[1]}",
        "params": shape.sizes[2],
        "own": f"steps * {len(shape.exogenous) * shape.width}",
        "outputs": f"steps * {len(shape.record) * shape.width}",
    }
    shaped = [f"{name} = carray({name}, {size})" for name, size in arrays.items()]
    head = [
        f"def block(steps, {', '.join(arrays)}):",
        *_indented([*shaped, *_steady(usual, shape)]),
    ]
    texts = [helpers(fused)]
    if codes:
        numbers = rows._asdict() | {
            "apart": stride(shape.width),
            "group": min(shape.width, GROUP),
            "next": len(codes[0].results[0]),
        }
        texts += [_rare(k, code, shape, rows) for k, code in enumerate(codes)]
        calls = [
            _AGAIN.format(part=k, **numbers) if k else f"        rare{k}(k, few, exogenous, params)"
            for k in range(len(codes))
        ]
        texts.append(_FINISH.format(calls="\n".join(calls), **numbers))
        lane.append(f"{rows.at(rows.flag)} = {usual.results[2][0]}")
    loop += _indented(lane)
    if codes:
        loop.append("finish(k, work, exogenous, params)")
    loop += _copied(shape, rows.out, "outputs", len(shape.record))
    return "\n".join([*texts, *head, "    for k in range(steps):", *_indented(loop, 2)]), rows.end


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


def _rare(part: int, code: Code, shape: Shape, rows: Rows) -> str:
    """A rare part of the step, of those of the first lanes of a work array whose flag is set."""
    (following, (flag,)), lane = (
        code.results,
        [*_inputs(code, shape, rows, rows.before), *code.statements],
    )
    chosen = [
        f"flagged = {rows.at(rows.flag)} != 0.0",
        *(
            f"{rows.at(i)} = select(flagged, {name}, {rows.at(i)})"
            for i, name in enumerate(following)
        ),
    ]
    body = [
        *_steady(code, shape),
        *_shared(code, shape),
        f"for j in range({min(shape.width, GROUP)}):",
        *_indented([*lane, *chosen, f"{rows.at(rows.flag)} = {flag}"]),
    ]
    return "\n".join(
        [
            '@njit(error_model="numpy")',
            f"def rare{part}(k, work, exogenous, params):",
            *_indented(body),
            "",
        ]
    )


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
    return [
        *(f"s{i} = {rows.at(states + i)}" for i in s),
        *(
            f"w{i} = {rows.at(rows.own + shape.exogenous.index(i))}"
            for i in w
            if i in shape.exogenous
        ),
        *(f"p{i} = {rows.at(rows.params + shape.params.index(i))}" for i in p if i in shape.params),
    ]


def _copied(shape: Shape, row: int, array: str, count: int) -> list[str]:
    """Rows from `row` on filled from, or copied to, the part of step k of an array.

    Of indices into a part, unlike those that k multiplies, LLVM knows the sign, and so vectorises.
    """
    inside, outside = (
        f"work[({row} + i) * {stride(shape.width)} + j]",
        f"part[i * {shape.width} + j]",
    )
    size = count * shape.width
    return [
        f"part = {array}[k * {size} : (k + 1) * {size}]",
        f"for i in range({count}):",
        f"    for j in range({shape.width}):",
        f"        {f'{inside} = {outside}' if array == 'own' else f'{outside} = {inside}'}",
    ] * bool(count)


def _graph(columns: list[ca.SX], results: list[ca.SX]) -> ca.Function:
    return ca.Function(
        "graph", columns, results, ["s", "w", "p"], [f"result{i}" for i in range(len(results))]
    )


def _indented(lines: list[str], depth: int = 1) -> list[str]:
    return [f"{'    ' * depth}{line}" for line in lines]
