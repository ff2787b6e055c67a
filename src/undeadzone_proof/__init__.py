"""Check a proof about an observer in exact fractions, with the standard library alone.

docs/proof.md has the theorem. The file only proposes numbers: every inequality is computed here,
from the constants of the C that `source` reads.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterable
from fractions import Fraction
from math import isqrt
from pathlib import Path
from typing import Any, NamedTuple

from undeadzone_proof.source import Code, Form, Refused, require

Matrix = list[list[Fraction]]
WIDTHS = {1: "state->right[0]", -1: "state->left[0]"}


def root(x: Fraction) -> Fraction:
    """Return an upper bound of the square root of x, close to it."""
    shift = max(0, 64 + (x.denominator.bit_length() - x.numerator.bit_length()) // 2)
    return Fraction(isqrt((x.numerator << 2 * shift) // x.denominator) + 1, 1 << shift)


def mix(X: Matrix, Y: Matrix, a: Fraction | int = 1, b: Fraction | int = -1) -> Matrix:
    """Return a X + b Y."""
    return [[a * x + b * y for x, y in zip(*rows, strict=True)] for rows in zip(X, Y, strict=True)]


def turn(X: Matrix) -> Matrix:
    """Return a matrix with rows and columns exchanged."""
    return list(map(list, zip(*X, strict=True)))


def times(X: Matrix, *others: Matrix) -> Matrix:
    """Return the product of matrices."""
    for Y in others:
        X = [[sum(map(Fraction.__mul__, row, each), Fraction(0)) for each in turn(Y)] for row in X]
    return X


def border(X: Matrix, b: list[Fraction], corner: Fraction) -> Matrix:
    """Return [[X, b], [b', corner]]."""
    return [[*row, x] for row, x in zip(X, b, strict=True)] + [[*b, corner]]


def pivots(M: Matrix) -> list[Fraction]:
    """Return the pivots of elimination, as far as they are positive, and the next one."""
    require(turn(M) == M, "matrices are symmetric")
    found = [M[0][0]]
    while found[-1] > 0 and len(M) > 1:
        top = M[0]
        M = [[x - row[0] / top[0] * y for x, y in zip(row, top, strict=True)][1:] for row in M[1:]]
        found.append(M[0][0])
    return found


def require_positive(M: Matrix, step: str) -> None:
    """Raise Refused unless a matrix is positive definite."""
    found = pivots(M)
    require(len(found) == len(M) and found[-1] > 0, step)


def square(P: Matrix, x: list[Fraction]) -> Fraction:
    """Return x'P x."""
    return times([x], P, turn([x]))[0][0]


def dual(P: Matrix, c: list[Fraction]) -> Fraction:
    """Return c'P^-1 c of a positive definite P."""
    return -pivots(border(P, c, Fraction(0)))[-1]


def hold(A: Matrix, B: Matrix, Ts: Fraction) -> tuple[Matrix, Matrix, Fraction]:
    """Return e^(A Ts), the integral of e^(A s) B over a sample, and a bound of their errors.

    Terms are cut at 2^-200. Behind the last one each is at most half of the one before.
    """
    n, size, k = len(A), max(sum(map(abs, row), Fraction(0)) for row in A) * Ts, 0
    require(size < 99, "hold: a sample is short enough for a series")
    term = [[Fraction(i == j) for j in range(n)] for i in range(n)]
    total, part = mix(term, term), mix(term, term)
    bound, cut, error = (
        Fraction(1),
        Fraction(0),
        Fraction(0),
    )  # largest row of the term, of what it lacks, of the sum's
    while bound > Fraction(1, 1 << 150) or 2 * size > k + 1:
        total, part = mix(total, term, 1, 1), mix(part, term, 1, Ts / (k + 1))
        k, error, bound = k + 1, error + cut, bound * size / (k + 1)
        cut = cut * size / k + Fraction(n, 1 << 200)
        term = [
            [Fraction(int(x * Ts / k * (1 << 200)), 1 << 200) for x in r] for r in times(term, A)
        ]
    largest = max(abs(x) for row in B for x in row)
    return total, times(part, B), (error + cut + 2 * bound) * max(Fraction(1), n * Ts * largest)


def check_continuous(proof: Any) -> None:
    """Check the inequality of the continuous observer: silence, branches, and all between."""
    A, (c,), (L, P) = proof["plant"]["A"], proof["plant"]["C"], (proof["L"], proof["storage"]["P"])
    W, margin = proof["storage"]["W"], proof["storage"]["margin"]
    require_positive(P, "storage: P > 0")
    require(W > 0 and margin > 0, "storage: W and the margin are above 0")
    PA = times(P, A)
    cross = [x - W * y for x, y in zip(times([L], P)[0], c, strict=True)]
    whole = border(mix(PA, turn(PA), -1), cross, 2 * (1 - margin) * W)
    require_positive(whole, "inequality: V falls for every mixture")


def check_decay(proof: Any) -> None:
    """Check the inequalities of the sampled loop: silence, branches, and all between."""
    M, l, c, g, reading = (proof["gains"][key] for key in ("M", "l", "c", "g", "reading"))
    P, W, margin, decay = (proof["storage"][key] for key in ("P", "W", "margin", "decay"))
    require_positive(P, "storage: P > 0")
    require(W > 0 and margin > 0 and 0 < decay < 1 and 0 < g <= 1, "storage: signs")
    PM = times(P, M)
    fall = mix(P, times(turn(M), PM))
    cross = [x - W * y for x, y in zip(times([l], PM)[0], c, strict=True)]
    corner = (2 - g - 2 * margin) * W - square(P, l)
    require_positive(border(fall, cross, corner), "inequality: V falls for every mixture")
    require_positive(mix(fall, P, 1, -decay), "decay: in silence")
    whole = border(P, [Fraction(0)] * len(P), W / g)
    loop = [*mix(M, times(turn([l]), [c])), [g * x for x in c]]
    loop = [[*row, x] for row, x in zip(loop, [*l, 1 - g], strict=True)]
    push = [reading * x for x in [*l, -g]]  # of an error of the reading
    fall = mix(whole, times(turn(loop), whole, loop), 1 - decay)
    cross = times([push], whole, loop)[0]
    corner = proof["storage"]["noise"] - square(whole, push)
    require_positive(border(fall, cross, corner), "decay: on a branch, with noise")


def list_names(proof: Any) -> tuple[list[str], list[str]]:
    """Return the names in C of the states and of the inputs."""
    bounds = proof["bounds"]
    x = [f"state->x[{k}]" for k in range(len(bounds["x"]))]
    return x, [f"in->u[{k}]" for k in range(len(bounds["u"]))]


def begin_step(
    proof: Any, reach: list[Fraction], ends: list[Fraction]
) -> tuple[dict[str, Any], dict[str, list[Fraction]]]:
    """Return the memory and the ranges with which a step begins.

    Args:
        proof: the bounds.
        reach: how far each estimate may be from its state.
        ends: least and largest reading (none: it is missing).
    """
    bounds, (x, u) = proof["bounds"], list_names(proof)
    sizes = [*map(Fraction.__add__, bounds["x"], reach), *bounds["u"]]
    ranges = {name: [-size, size] for name, size in zip(x + u, sizes, strict=True)}
    ranges |= {name: [Fraction(0), proof["sensor"]["width_max"]] for name in WIDTHS.values()}
    ranges |= {"": [Fraction(1), Fraction(1)]} | ({"in->y[0]": ends} if ends else {})
    memory: dict[str, Any] = {name.replace("in->u", "state->held"): None for name in u}
    memory["in->y[0]"] = None
    for name, pair in ranges.items():
        memory[name] = Form({name: Fraction(1)}, Fraction(0), *pair)
    return memory, ranges


def expect_terms(proof: Any, side: int) -> dict[str, dict[str, Fraction]]:
    """Return the terms of the next states and widths on a side, as the theorem has them."""
    M, H, l, c, g, reading = (proof["gains"][key] for key in ("M", "H", "l", "c", "g", "reading"))
    x, u = list_names(proof)
    expected = {name: {name: Fraction(1)} for name in WIDTHS.values()}
    for name, own, given, each in zip(x, M, H, l, strict=True):
        row = [a - abs(side) * each * b for a, b in zip(own, c, strict=True)] + given
        expected[name] = dict(zip(x + u, row, strict=True))
        if side:
            expected[name] |= {WIDTHS[side]: side * each, "in->y[0]": each * reading}
    if side:
        follow = {name: side * g * each for name, each in zip(x, c, strict=True)}
        follow |= {WIDTHS[side]: 1 - g, "in->y[0]": -side * g * reading}
        expected[WIDTHS[side]] = follow
    return expected


def bound_rounding(
    proof: Any, code: Code, reach: list[Fraction], side: int, ends: list[Fraction]
) -> list[Fraction]:
    """Return bounds of the rounding of each state, and of the width of a side, in one step.

    The C must compute what the gains say, as a whole and in its two halves.

    Args:
        proof: the gains and bounds.
        code: the C.
        reach, ends: as of `begin_step`.
        side: 1 right, -1 left, 0 neither.
    """
    expected, widest = expect_terms(proof, side), proof["sensor"]["width_max"]
    largest = dict.fromkeys(expected, Fraction(0))
    for names in (["step"], ["estimate", "advance"]):
        memory, ranges = begin_step(proof, reach, ends)
        for name in names:
            code.run(name, memory, ranges, widest)
        for name, terms in expected.items():
            form = memory[name]
            require(form.terms == {k: v for k, v in terms.items() if v}, f"gains: {name} of the C")
            largest[name] = max(largest[name], form.error)
        for name in WIDTHS.values():
            require(memory[name].low >= 0 and memory[name].high <= widest, "source: widths' ranges")
    rest = [largest[name] for key, name in WIDTHS.items() if key != side]
    require(not any(rest), "source: a width without a reading rests")
    return [largest[name] for name in [*list_names(proof)[0], *[WIDTHS.get(side, "")][: abs(side)]]]


class Gaps(NamedTuple):
    """Between plant and code: in a state's step, per state, per input; of what e^(A Ts) lacks.

    `late`: of a disturbance that does not rest within a sample, per input.
    """

    states: Matrix
    inputs: Matrix
    late: Matrix
    lost: Fraction


def compare_plant(proof: Any) -> Gaps:
    """Return the gaps between a plant, held over a sample, and the numbers of the C."""
    A, B, Ts = (proof["plant"][key] for key in ("A", "B", "Ts"))
    Phi, Psi, lost = hold(A, B, Ts)
    sizes = [[[abs(x) for x in row] for row in X] for X in (A, B)]
    _, most, more = hold(*sizes, Ts)
    late = [[x + more for x in row] for row in mix(most, sizes[1], 1, -Ts)]
    return Gaps(mix(Phi, proof["gains"]["M"]), mix(Psi, proof["gains"]["H"]), late, lost)


def weigh(row: Iterable[Fraction], sizes: Iterable[Fraction]) -> Fraction:
    """Return the largest sum of numbers with these factors and sizes."""
    return sum((abs(x) * size for x, size in zip(row, sizes, strict=True)), Fraction(0))


def measure_steps(
    proof: Any, code: Code, gaps: Gaps, one: Any
) -> list[tuple[int, Fraction, Fraction]]:
    """Return (side, bound of what moves the error in a step, of what moves its width) by side.

    The first bound is in the norm of V. Noise of the reading is in neither.
    """
    B, (C,), Ts = (proof["plant"][key] for key in ("B", "C", "Ts"))
    l, c, g, reading = (proof["gains"][key] for key in ("l", "c", "g", "reading"))
    P, W = proof["storage"]["P"], proof["storage"]["W"]
    slope, threshold, widest = (proof["sensor"][key] for key in ("slope", "threshold", "width_max"))
    X, U, pushes = proof["bounds"]["x"], proof["bounds"]["u"], one["disturbance"]
    ratio = slope * reading
    seen = [ratio * x - y for x, y in zip(C, c, strict=True)]
    reach = [
        root(one["V"] * dual(P, [Fraction(i == k) for i in range(len(P))])) for k in range(len(P))
    ]
    above = threshold + max(
        threshold / (1 << code.bits), Fraction(1, 1 << code.least)
    )  # the next number
    top = max(slope * weigh(C, X) + one["noise"], above)
    pushed = sum(Ts * y * root(square(P, b)) for b, y in zip(turn(B), pushes, strict=True))
    found = []
    for side, *ends in [(1, above, top), (-1, -top, -above), (0, -threshold, threshold), (0,)]:
        box = bound_rounding(proof, code, reach, side, ends)
        whole = border(P, [Fraction(0)] * len(P), W / g) if side else P
        for i, gap in enumerate(gaps.states):
            row = [x - abs(side) * l[i] * y for x, y in zip(gap, seen, strict=True)]
            box[i] += weigh(row, X) + abs(side * l[i] * (1 - ratio)) * widest
            box[i] += weigh(gaps.inputs[i], U) + weigh(gaps.late[i], pushes)
            box[i] += gaps.lost * sum(X + U)
        if side:
            box[-1] += g * (weigh(seen, X) + abs(1 - ratio) * widest)
        largest = square([[abs(x) for x in row] for row in whole], box)
        found.append((side, pushed + root(largest), box[-1] * abs(side)))
    return found


def check_set(proof: Any, code: Code, gaps: Gaps, one: Any) -> None:
    """Check that no step leads out of a set of errors."""
    (C,), (c, g, reading) = (
        proof["plant"]["C"],
        (proof["gains"][key] for key in ("c", "g", "reading")),
    )
    P, W, decay, loud = (proof["storage"][key] for key in ("P", "W", "decay", "noise"))
    V, K, D, noise = (one[key] for key in ("V", "K", "width", "noise"))
    require(min(V, K, D) > 0 and 0 <= noise <= proof["sensor"]["threshold"], "set: noise is silent")
    require(min(one["disturbance"]) >= 0, "set: its bounds are no less than 0")
    measured = measure_steps(proof, code, gaps, one)
    for side, push, _ in measured:
        after = (1 - decay) * K**2 + loud * noise**2 * abs(side)
        require(push <= K and after <= (K - push) ** 2, "set: K absorbs what a step adds")
    w = W / g * D**2
    if proof["sensor"]["width_max"] <= D:
        require(K**2 + 2 * w <= V, "set: V has room for any widths")
    else:
        h, own = root(W / g * dual(P, c)), one["K1"]
        d = root(W / g) * (max(wrong for *_, wrong in measured) / g + reading * noise)
        require(own > 0 and own**2 * (1 - g * (h + d / own) ** 2) >= K**2, "set: K1 absorbs widths")
        require((h * own + d) ** 2 + w + K**2 <= V, "set: V has room for the widths")
        rest = root(V - w)
        require(h * rest + d <= w / root(w), "set: widths follow the states")
        require(g * h * root(w) <= (1 - g) * (V - w) / rest, "set: widths follow slowly")
    require(
        one["radius"] > 0 and one["radius"] ** 2 >= V * dual(P, C), "set: its radius contains V"
    )


def state(proof: Any) -> str:
    """Return what is proved, in a sentence."""
    if "source" not in proof:
        return (
            f"V = x~'P x~ + (W / gamma) |d~|^2 never rises, for every sequence of sides and every "
            f"gamma > 0, and its fall bounds {2 * float(proof['storage']['margin']):.4g} W e^2."
        )
    sets = [
        f"{one['name']} (input disturbance up to {show(one['disturbance'])}, readings wrong by up "
        f"to {show([one['noise']])}, |d - d^| <= {show([one['width']])}): "
        f"|z - z^| <= {show([one['radius']])}"
        for one in proof["sets"]
    ]
    source, bounds = proof["source"], proof["bounds"]
    return (
        f"{source['name']}.c in {source['format']}: while |x| <= {show(bounds['x'])} and |u| <= "
        f"{show(bounds['u'])}, no sequence of sides, missing readings and roundings moves the "
        f"error out of a set in which it is. {'; '.join(sets)}."
    )


def show(numbers: list[Fraction]) -> str:
    """Return numbers in decimals."""
    return ", ".join(f"{float(x):.4g}" for x in numbers)


def to_fractions(value: Any) -> Any:
    """Return the content of a file with its fractions as numbers."""
    if isinstance(value, dict):
        return {key: to_fractions(each) for key, each in value.items()}
    if isinstance(value, list):
        return list(map(to_fractions, value))
    return Fraction(value) if re.fullmatch(r"-?\d+(/\d+)?", value) else value


def verify(proof: Any, source: Path | None = None) -> str:
    """Return the statement of a proof that holds.

    Args:
        proof: content of the file, its fractions as numbers.
        source: path of the C (None: the proof contains it).

    Raises:
        Refused: with the first step that does not hold.
    """
    if "source" not in proof:
        check_continuous(proof)
    else:
        own, widest = proof["source"], proof["sensor"]["width_max"]
        files = [source, source.with_suffix(".h")] if source else []
        texts = [file.read_text(encoding="utf-8") for file in files] or own["texts"]
        code = Code(*texts, own["name"], own["format"])
        require(code.bodies["step"] == proof["operations"], "operations: those of the C")
        require(code.constants == proof["constants"], "constants: those of the C")
        start = dict[str, Any]()
        code.run("init", start, {"": [Fraction(1), Fraction(1)]}, widest)
        ends = [start[name].low for name in WIDTHS.values()]
        require(min(ends) >= 0 and max(ends) <= widest, "source: widths begin in their range")
        check_decay(proof)
        gaps = compare_plant(proof)
        for one in proof["sets"]:
            check_set(proof, code, gaps, one)
    require(proof["statement"] == state(proof), "statement: it says what is proved")
    return state(proof)


def main(arguments: list[str]) -> int:
    """Check a file, print what it proves or the first step that fails. Return the exit code."""
    try:
        file, *given = map(Path, arguments)
        proof = to_fractions(json.loads(file.read_text(encoding="utf-8")))
        own = proof.get("source", {"texts": ""})
        beside = [] if "texts" in own else [file.with_name(f"{own['name']}.c")]
        words = verify(proof, *(given or beside))
    except Refused as step:
        words = f"refused: {step}"
    except (KeyError, ValueError, TypeError, IndexError, ArithmeticError, OSError) as error:
        words = f"refused: not a proof: {error!r}"
    sys.stdout.write(f"{words}\n")
    return int(words.startswith("refused"))
