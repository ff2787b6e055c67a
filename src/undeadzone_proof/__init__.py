"""Check a proof about an observer in exact fractions, with the standard library alone.

docs/proof.md has the theorem. The file only proposes numbers: every inequality is computed here,
from the constants of the C that `source` reads.
"""

from __future__ import annotations

import json
import re
from fractions import Fraction as F
from math import isqrt
from pathlib import Path
from typing import Any

from undeadzone_proof.source import Code, Form, Refused, require

Matrix = list[list[F]]
WIDTHS = {1: "state->right[0]", -1: "state->left[0]"}


def root(x: F) -> F:
    """Return an upper bound of the square root of x, close to it."""
    shift = max(0, 64 + (x.denominator.bit_length() - x.numerator.bit_length()) // 2)
    return F(isqrt((x.numerator << 2 * shift) // x.denominator) + 1, 1 << shift)


def mix(X: Matrix, Y: Matrix, a: F | int = 1, b: F | int = -1) -> Matrix:
    """Return a X + b Y."""
    return [[a * x + b * y for x, y in zip(*rows, strict=True)] for rows in zip(X, Y, strict=True)]


def turn(X: Matrix) -> Matrix:
    """Return a matrix with rows and columns exchanged."""
    return list(map(list, zip(*X, strict=True)))


def times(X: Matrix, *others: Matrix) -> Matrix:
    """Return the product of matrices."""
    for Y in others:
        X = [[sum(map(F.__mul__, row, each), F(0)) for each in turn(Y)] for row in X]
    return X


def border(X: Matrix, b: list[F], corner: F) -> Matrix:
    """Return [[X, b], [b', corner]]."""
    return [[*row, x] for row, x in zip(X, b, strict=True)] + [[*b, corner]]


def pivots(M: Matrix) -> list[F]:
    """Return the pivots of elimination, as far as they are positive, and the next one."""
    require(M == turn(M), "matrices are symmetric")
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


def square(P: Matrix, x: list[F]) -> F:
    """Return x'P x."""
    return times([x], P, turn([x]))[0][0]


def dual(P: Matrix, c: list[F]) -> F:
    """Return c'P^-1 c of a positive definite P."""
    return -pivots(border(P, c, F(0)))[-1]


def hold(A: Matrix, B: Matrix, Ts: F) -> tuple[Matrix, Matrix, F]:
    """Return e^(A Ts), the integral of e^(A s) B over a sample, and a bound of their errors.

    Terms are cut at 2^-200. Behind the last one each is at most half of the one before.
    """
    n, size, k = len(A), max(sum(map(abs, row), F(0)) for row in A) * Ts, 0
    require(size < 99, "hold: a sample is short enough for a series")
    term = [[F(i == j) for j in range(n)] for i in range(n)]
    total, part = mix(term, term), mix(term, term)
    bound, cut, error = F(1), F(0), F(0)  # largest row of the term, of what it lacks, of the sum's
    while bound > F(1, 1 << 150) or 2 * size > k + 1:
        total, part = mix(total, term, 1, 1), mix(part, term, 1, Ts / (k + 1))
        k, error, bound = k + 1, error + cut, bound * size / (k + 1)
        cut = cut * size / k + F(n, 1 << 200)
        term = [[F(int(x * Ts / k * (1 << 200)), 1 << 200) for x in r] for r in times(term, A)]
    largest = max(abs(x) for row in B for x in row)
    return total, times(part, B), (error + cut + 2 * bound) * max(F(1), n * Ts * largest)


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
    whole = border(P, [F(0)] * len(P), W / g)
    loop = [*mix(M, times(turn([l]), [c])), [g * x for x in c]]
    loop = [[*row, x] for row, x in zip(loop, [*l, 1 - g], strict=True)]
    push = [reading * x for x in [*l, -g]]  # of an error of the reading
    fall = mix(whole, times(turn(loop), whole, loop), 1 - decay)
    cross = times([push], whole, loop)[0]
    corner = proof["storage"]["noise"] - square(whole, push)
    require_positive(border(fall, cross, corner), "decay: on a branch, with noise")


def steps(proof: Any, code: Code, reach: list[F], side: int, ends: list[F] | None) -> list[F]:
    """Return bounds of the rounding of each state, and of the width of a side, in one step.

    The C must compute what the gains say, as a whole and in halves.

    Args:
        proof: the gains and ranges.
        code: the C.
        reach: how far each estimate may be from its state.
        side: 1 right, -1 left, 0 neither.
        ends: least and largest reading (None: it is missing).
    """
    M, H, l, c, g, reading = (proof["gains"][key] for key in ("M", "H", "l", "c", "g", "reading"))
    bounds, widest = proof["bounds"], proof["sensor"]["width_max"]
    x = [f"state->x[{k}]" for k in range(len(M))]
    u = [f"in->u[{j}]" for j in range(len(H[0]))]
    sizes = [*map(F.__add__, bounds["x"], reach), *bounds["u"]]
    ranges = {name: [-size, size] for name, size in zip(x + u, sizes, strict=True)}
    ranges |= {WIDTHS[1]: [F(0), widest], WIDTHS[-1]: [F(0), widest], "": [F(1), F(1)]}
    ranges |= {"in->y[0]": ends} if ends else {}
    expected = {name: {name: F(1)} for name in WIDTHS.values()}
    if side:
        row = {name: side * g * each for name, each in zip(x, c, strict=True)}
        expected[WIDTHS[side]] = row | {WIDTHS[side]: 1 - g, "in->y[0]": -side * g * reading}
    for name, own, given, each in zip(x, M, H, l, strict=True):
        row = [a - abs(side) * each * b for a, b in zip(own, c, strict=True)] + given
        expected[name] = dict(zip(x + u, row, strict=True))
        if side:
            expected[name] |= {WIDTHS[side]: side * each, "in->y[0]": each * reading}
    largest = dict.fromkeys(expected, F(0))
    for names in (["step"], ["estimate", "advance"]):
        memory: dict[str, Any] = {name.replace("in->u", "state->held"): None for name in u}
        memory["in->y[0]"] = None
        memory |= {name: Form({name: F(1)}, F(0), *pair) for name, pair in ranges.items()}
        for name in names:
            code.run(name, memory, ranges, widest)
        for name, terms in expected.items():
            form = memory[name]
            require(form.terms == {k: v for k, v in terms.items() if v}, f"gains: {name} of the C")
            largest[name] = max(largest[name], form.error)
    other = {WIDTHS[k] for k in WIDTHS if k != side}
    require(not any(largest[name] for name in other), "source: a width without a reading rests")
    return [largest[name] for name in [*x, *[WIDTHS[side]][: abs(side)]]]


def check_set(proof: Any, code: Code, one: Any) -> None:
    """Check that no step leads out of a set of errors."""
    A, B, (C,), Ts = (proof["plant"][key] for key in ("A", "B", "C", "Ts"))
    l, c, g, reading = (proof["gains"][key] for key in ("l", "c", "g", "reading"))
    P, W, decay = (proof["storage"][key] for key in ("P", "W", "decay"))
    slope, threshold, widest = (proof["sensor"][key] for key in ("slope", "threshold", "width_max"))
    X, U = proof["bounds"]["x"], proof["bounds"]["u"]
    V, K, D, noise, pushes = (one[key] for key in ("V", "K", "width", "noise", "disturbance"))
    require(0 <= noise <= threshold, "set: noise alone never shows a side")
    n = len(A)
    Phi, Psi, lost = hold(A, B, Ts)
    sizes = [[[abs(x) for x in row] for row in Y] for Y in (A, B)]
    _, most, more = hold(*sizes, Ts)
    late = mix(most, sizes[1], 1, -Ts)  # of a disturbance within a sample
    stray = [sum((x + more) * y for x, y in zip(row, pushes, strict=True)) for row in late]
    plain, given = mix(Phi, proof["gains"]["M"]), mix(Psi, proof["gains"]["H"])
    ratio = slope * reading
    seen = [ratio * x - y for x, y in zip(C, c, strict=True)]
    units = [[F(i == k) for i in range(n)] for k in range(n)]
    reach = [root(V * dual(P, unit)) for unit in units]
    top = slope * sum(map(F.__mul__, map(abs, C), X)) + noise
    above = threshold + max(threshold / (1 << code.bits), F(1, 1 << code.least))
    sides = [(1, [above, max(top, above)]), (-1, [-max(top, above), -above])]
    pushed = sum(Ts * y * root(square(P, b)) for b, y in zip(turn(B), pushes, strict=True))
    wrong = F(0)  # of a width in a step, at most
    for side, ends in [*sides, (0, [-threshold, threshold]), (0, None)]:
        box = steps(proof, code, reach, side, ends)
        whole = border(P, [F(0)] * n, W / g) if side else P
        for i in range(n):
            row = [x - abs(side) * l[i] * y for x, y in zip(plain[i], seen, strict=True)]
            box[i] += sum(map(F.__mul__, map(abs, row), X)) + abs(side * l[i] * (1 - ratio)) * widest
            box[i] += sum(map(F.__mul__, map(abs, given[i]), U)) + lost * sum(X + U) + stray[i]
        if side:
            box[n] += g * (sum(map(F.__mul__, map(abs, seen), X)) + abs(1 - ratio) * widest)
            wrong = max(wrong, box[n])
        push = pushed + root(square([[abs(x) for x in row] for row in whole], box))
        loud = proof["storage"]["noise"] * noise**2 * abs(side)
        require(K >= push and (1 - decay) * K**2 + loud <= (K - push) ** 2, "set: K absorbs a step")
    w = W / g * D**2
    if D >= widest:
        require(V >= K**2 + 2 * w, "set: V has room for any widths")
    else:
        h, K1 = root(W / g * dual(P, c)), one["K1"]
        d = root(W / g) * (wrong / g + reading * noise)
        require(V > w and K1 > 0 and K1**2 * (1 - g * (h + d / K1) ** 2) >= K**2, "set: K1")
        require((h * K1 + d) ** 2 + w + K**2 <= V, "set: V has room for the widths")
        rest = root(V - w)
        require(h * rest + d <= w / root(w), "set: widths follow the states")
        require(g * h * root(w) <= (1 - g) * (V - w) / rest, "set: widths follow slowly")
    require(one["radius"] ** 2 >= V * dual(P, C), "set: the radius contains V")


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


def show(numbers: list[F]) -> str:
    """Return numbers in decimals."""
    return ", ".join(f"{float(x):.4g}" for x in numbers)


def to_fractions(value: Any) -> Any:
    """Return the content of a file with its fractions as numbers."""
    if isinstance(value, dict):
        return {key: to_fractions(each) for key, each in value.items()}
    if isinstance(value, list):
        return list(map(to_fractions, value))
    return F(value) if re.fullmatch(r"-?\d+(/\d+)?", value) else value


def verify(proof: Any, folder: Path, source: str | None = None) -> str:
    """Return the statement of a proof that holds.

    Args:
        proof: content of the file.
        folder: where it lies.
        source: path of the C (None: the one that the file names or contains).

    Raises:
        Refused: with the first step that does not hold.
    """
    proof = to_fractions(proof)
    if "source" in proof:
        own = proof["source"]
        path = Path(source) if source else folder / f"{own['name']}.c"
        texts = own.get("texts") if source is None else None
        text, header = texts or [each.read_text() for each in (path, path.with_suffix(".h"))]
        code = Code(text, header, own["name"], own["format"])
        require(code.bodies["step"] == proof["operations"], "operations: those of the C")
        require(code.constants == proof["constants"], "constants: those of the C")
        check_decay(proof)
        for one in proof["sets"]:
            check_set(proof, code, one)
    else:
        check_continuous(proof)
    require(proof["statement"] == state(proof), "statement: it says what is proved")
    return state(proof)


def main(arguments: list[str]) -> int:
    """Check a file, print what it proves or the first step that fails. Return the exit code."""
    try:
        proof = json.loads(Path(arguments[0]).read_text(encoding="utf-8"))
        print(verify(proof, Path(arguments[0]).parent, *arguments[1:2]))  # noqa: T201
    except Refused as step:
        print(f"refused: {step}")  # noqa: T201
        return 1
    except (KeyError, ValueError, TypeError, IndexError, ArithmeticError, OSError) as error:
        print(f"refused: not a proof: {error!r}")  # noqa: T201
        return 1
    return 0
