"""Check in exact fractions that no step of the C leads out of a set, or that V falls.

docs/proof.md has the theorem. The file proposes numbers; each inequality comes from the C itself.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

from undeadzone_proof.source import ONE, ZERO, Code, Row, make_identity, mix, require, weigh

SIDES = {"right": (1, "side"), "left": (-1, "side"), "zone": (0, "silent"), "none": (0, "silent")}
SERIES = Fraction(1, 1 << 100)


def multiply(X: list[Row], Y: list[Row]) -> list[Row]:
    """Return the product of matrices."""
    columns = list(zip(*Y, strict=True))
    return [[weigh(row, column) for column in columns] for row in X]


def require_positive(M: list[Row], step: str) -> None:
    """Raise Refused unless a symmetric matrix has positive pivots, those of Bareiss in integers."""
    require(list(map(list, zip(*M, strict=True))) == M, f"{step} (symmetric)")
    scale, last = math.lcm(*(x.denominator for row in M for x in row)), 1
    whole = [[int(x * scale) for x in row] for row in M]
    while whole:
        (top, *rest), *rows = whole
        require(top > 0, step)
        whole = [
            [(top * x - row[0] * y) // last for x, y in zip(row[1:], rest, strict=True)]
            for row in rows
        ]
        last = top


def hold_exactly(plant: Any) -> list[Row]:
    """Return the first rows of e^M, M = [A, B; 0, 0] Ts, each entry within SERIES of it.

    Each term is cut at 2^-200. Behind the last one the sum is less than twice 16^100 / 100!.
    """
    n, m, cut = len(plant["A"]), len(plant["B"][0]), 1 << 200
    rows = [a + b for a, b in zip(plant["A"], plant["B"], strict=True)]
    M = mix(rows, rows, plant["Ts"], 0) + [[ZERO] * (n + m)] * m
    require(max(sum(map(abs, row)) for row in M) <= 16, "hold: a sample is short")
    whole = [[int(x * cut) for x in row] for row in M]
    total = term = [[int(x) * cut for x in row] for row in make_identity(n + m)]
    for k in range(1, 100):
        term = [[x // (k * cut) for x in row] for row in multiply(term, whole)]
        total = mix(total, term)
    return [[Fraction(x, cut) for x in row] for row in total[:n]]


def map_step(proof: Any, code: Code, held: Any, mode: str) -> tuple[list[Row], Row]:
    """Return the errors after a step by those before and by the world, and the size of the latter.

    Errors are those of states and widths. From outside come the error of a reading, disturbances,
    and in each state and in the width of this side all else: rounding, and a plant that is not the
    C's. Rounding keeps the order, so that it never shows a side that the sum before did not.
    """
    (C,), bounds, sensor = proof["plant"]["C"], proof["bounds"], proof["sensor"]
    n, side, D, slope = len(C), SIDES[mode][0], sensor["width_max"], sensor["slope"]
    least, low = Fraction(1, 1 << code.least), sensor["threshold"]
    require(bounds["noise"] <= low, "bounds: noise shows no side")
    largest = slope * weigh(map(abs, C), bounds["x"]) + bounds["noise"]
    wrong = bounds["noise"] + largest / (1 << code.bits) + least
    seen = sorted([side * (low + least), side * (low + least + largest + wrong)])
    near = [x + reach for x, reach in zip(bounds["x"], bounds["reach"], strict=True)]
    spans = [[(-x, x) for x in each] for each in (near, bounds["u"])]
    reading = seen if side else [-low, low]
    behind = code.step([(1, 1), *spans[0], (0, D), (0, D), reading, *spans[1]], mode != "none")
    pushed = list(map(sum, zip(bounds["u"], bounds["disturbance"], strict=True)))
    sizes = [1, *bounds["x"], D, D, 0, *pushed]
    unit = make_identity(len(sizes))
    true = [[ZERO, *row[:n], ZERO, ZERO, ZERO, *row[n:]] for row in held] + unit[n + 1 : n + 3]
    shown = [ZERO, *(slope * c for c in C), -slope * (side > 0), slope * (side < 0), -ONE]
    shown += [ZERO] * len(pushed)
    E, outside = list[Row](), [wrong, *bounds["disturbance"]]
    other = n + (side >= 0)
    for k, form in enumerate(behind):
        y = form.row[n + 3]
        require(form.end == (D if k >= n else None), "source: widths are clipped to their range")
        require(side or not y, "source: silence has no reading")
        (rest,) = mix(mix([true[k]], [form.row], 1, -1), [shown], 1, -y)
        box = form.error + SERIES * sum(sizes) * (k < n) + weigh(map(abs, rest), sizes)
        E.append([*form.row[1 : n + 3], -y, *form.row[n + 4 :]])
        if k != other:
            outside.append(box)
        else:
            resting = form.row == unit[k + 1] and not box
            require(resting, "source: a width without a reading rests")
    places = [row[:other] + row[other + 1 :] for row in make_identity(n + 2)]
    return [row + place for row, place in zip(E, places, strict=True)], outside


def subtract_square(X: list[Row], F: list[Row], S: list[Row]) -> list[Row]:
    """Return X - F'S F, X with zeros behind its rows and columns."""
    square = multiply(list(map(list, zip(*F, strict=True))), multiply(S, F))
    behind = len(square) - len(X)
    wide = [row + [ZERO] * behind for row in X] + [[ZERO] * len(square)] * behind
    return mix(wide, square, 1, -1)


def check_mode(proof: Any, step: Any, mode: str) -> None:
    """Check that a step of a mode does not lead out of the set, and that V falls."""
    (E, outside), (side, name) = step, SIDES[mode]
    S, P, D = proof["set"]["S"], proof["storage"]["P"], proof["sensor"]["width_max"]
    decay, loud, clip = (proof["set"][name][key] for key in ("decay", "loud", "clip"))
    n = len(E) - 2
    k = n + (side < 0)
    require(side < 1 or [row[n] for row in E] == proof["gains"], "gains: those of the C")
    keys = [*range(n), k][: n + abs(side)]
    own = [row[: len(keys)] for row in P[: len(keys)]]
    require_positive(own, "storage: P > 0")
    falls = subtract_square(own, [[E[i][j] for j in keys] for i in keys], own)
    require_positive(falls, f"storage: V falls, {mode}")
    F = [[*row, row[-1]] for row in E]
    M = subtract_square(mix(S, S, 1 - decay, 0), F, S)
    for i, x in zip([k, 2 * n + 1 - k, *range(n + 2, len(M) - 1)], loud, strict=True):
        M[i][i] += x
    for i, x in enumerate(F[k]):
        sector = (sum(clip) * x - clip[1] * (i == k)) / 2
        M[i][-1] += sector
        M[-1][i] += sector
    require_positive(M, f"set: V stays, {mode}")
    require(min(*loud, *clip) >= 0 and decay <= 1, "set: signs")
    most = weigh(loud, [x * x for x in (D, D, *outside)])
    require(most <= decay, f"set: V stays below 1, {mode}")


def check_sampled(proof: Any, texts: list[str]) -> None:
    """Check a sampled observer: its C, and that no step leads out of the set."""
    code, one, D = Code(proof, texts), proof["set"], proof["sensor"]["width_max"]
    n, S = len(proof["plant"]["A"]), one["S"]
    *states, right, left = code.begin()
    require(states == proof["start"], "start: that of the C")
    require(min(right, left) >= 0 and max(right, left) <= D, "start: widths in their range")
    require(code.lines["step"] == proof["operations"], "operations: those of the C")
    require(code.constants == proof["constants"], "constants: those of the C")
    rows = proof["plant"]["C"] + make_identity(n)
    for c, most in zip(rows, [one["radius"], *proof["bounds"]["reach"]], strict=True):
        c = [*c, ZERO, ZERO]
        bordered = [[*row, x] for row, x in zip(S, c, strict=True)] + [[*c, most * most]]
        require(most > 0, "set: signs")
        require_positive(bordered, "set: radius and reach contain it")
    begin = sum(map(abs, S[n][n:] + S[n + 1][n:])) * D * D
    require(begin <= 1, "set: it contains all widths")
    held = hold_exactly(proof["plant"])
    for mode in SIDES:
        check_mode(proof, map_step(proof, code, held, mode), mode)


def check_continuous(proof: Any) -> None:
    """Check a continuous observer: V falls in silence, on branches, and on all between."""
    A, C, L = proof["plant"]["A"], proof["plant"]["C"], proof["gains"]["L"]
    P, W, margin = proof["storage"]["P"], proof["storage"]["W"], proof["storage"]["margin"]
    require(W > 0 and margin > 0, "storage: W and the margin are above 0")
    require_positive(P, "storage: P > 0")
    PA = multiply(P, A)
    (cross,) = mix(multiply([L], P), C, 1, -W)
    fall = mix(PA, list(map(list, zip(*PA, strict=True))), -1, -1)
    bordered = [[*row, x] for row, x in zip(fall, cross, strict=True)]
    require_positive([*bordered, [*cross, 2 * (1 - margin) * W]], "inequality: V falls")
