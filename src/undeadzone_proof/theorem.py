"""Check in exact fractions that no step of the C leads out of a set, or that V falls.

docs/proof.md has the theorem. The file proposes numbers; each inequality comes from the C itself.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

from undeadzone_proof.source import ONE, ZERO, Code, Row, make_identity, mix, require

SIDES = {"right": (1, "side"), "left": (-1, "side"), "zone": (0, "silent"), "none": (0, "silent")}
SERIES = Fraction(1, 1 << 100)


def weigh(row: Any, sizes: Any) -> Any:
    """Return the sum of products of two rows."""
    return sum((a * b for a, b in zip(row, sizes, strict=True) if a and b), ZERO)


def multiply(X: list[Row], Y: list[Row]) -> list[Row]:
    """Return the product of matrices."""
    columns = list(zip(*Y, strict=True))
    return [[weigh(row, column) for column in columns] for row in X]


def require_positive(M: list[Row], step: str) -> None:
    """Raise Refused unless a symmetric matrix has positive pivots."""
    require(list(map(list, zip(*M, strict=True))) == M, f"{step} (symmetric)")
    while M:
        (top, *rest), *rows = M
        require(top > 0, step)
        M = [[x - row[0] / top * y for x, y in zip(row[1:], rest, strict=True)] for row in rows]


def hold_exactly(plant: Any) -> list[Row]:
    """Return the first rows of e^M, M = [A, B; 0, 0] Ts, each entry within SERIES of it.

    Each term is cut at 2^-200. Behind the last one the sum is less than twice 16^100 / 100!.
    """
    n, m, cut = len(plant["A"]), len(plant["B"][0]), 1 << 200
    rows = [a + b for a, b in zip(plant["A"], plant["B"], strict=True)]
    M = mix(rows, rows, plant["Ts"], 0) + [[ZERO] * (n + m)] * m
    require(max(sum(map(abs, row)) for row in M) <= 16, "hold: a sample is short")
    total = term = make_identity(n + m)
    for k in range(1, 100):
        term = [[Fraction(int(x / k * cut), cut) for x in row] for row in multiply(term, M)]
        total = mix(total, term)
    return total[:n]


def map_step(proof: Any, code: Code, held: Any, mode: str) -> tuple[list[Row], Row, Any]:
    """Return what a step makes of the errors of states and widths, of a reading, of disturbances.

    And a bound of all else: rounding, and a plant that is not the C's. And one of the reading:
    rounding keeps the order, so that it never shows a side that the sum before did not.
    """
    (C,), bounds, sensor = proof["plant"]["C"], proof["bounds"], proof["sensor"]
    n, side, D, least = len(C), SIDES[mode][0], sensor["width_max"], Fraction(1, 1 << code.least)
    require(bounds["noise"] <= sensor["threshold"], "bounds: noise shows no side")
    largest = sensor["slope"] * weigh(map(abs, C), bounds["x"]) + bounds["noise"]
    wrong = bounds["noise"] + largest / (1 << code.bits) + least
    above, top = sensor["threshold"] + least, sensor["threshold"] + least + largest + wrong
    reading = (
        sorted((side * above, side * top)) if side else (-sensor["threshold"], sensor["threshold"])
    )
    near = [x + reach for x, reach in zip(bounds["x"], bounds["reach"], strict=True)]
    spans = [[(-x, x) for x in each] for each in (near, bounds["u"])]
    behind = code.run_step([(1, 1), *spans[0], (0, D), (0, D), reading, *spans[1]], mode != "none")
    sizes = [
        1,
        *bounds["x"],
        D,
        D,
        0,
        *(sum(each) for each in zip(bounds["u"], bounds["disturbance"], strict=True)),
    ]
    true = [[ZERO, *row[:n], ZERO, ZERO, ZERO, *row[n:]] for row in held]
    true += make_identity(len(sizes))[n + 1 : n + 3]
    slope = sensor["slope"]
    seen = [ZERO, *(slope * c for c in C), -slope * (side > 0), slope * (side < 0), -ONE]
    seen += [ZERO] * len(bounds["u"])
    E, box = list[Row](), list[Fraction]()
    for k, form in enumerate(behind):
        end = None
        if isinstance(form, dict):
            ((end, form),) = form.items()
        require(end == (D if k >= n else None), "source: widths are clipped to their range")
        y = form.row[n + 3]
        require(side or not y, "source: silence has no reading")
        rest = weigh(map(abs, mix(mix([true[k]], [form.row], 1, -1), [seen], 1, -y)[0]), sizes)
        box.append(form.error + SERIES * sum(sizes) * (k < n) + rest)
        E.append([*form.row[1 : n + 3], -y, *form.row[n + 4 :]])
    return E, box, wrong


def subtract_square(X: list[Row], F: list[Row], S: list[Row]) -> list[Row]:
    """Return X - F'S F, X with zeros behind its rows and columns."""
    square = multiply(list(map(list, zip(*F, strict=True))), multiply(S, F))
    behind = len(square) - len(X)
    wide = [row + [ZERO] * behind for row in X] + [[ZERO] * len(square)] * behind
    return mix(wide, square, 1, -1)


def check_mode(proof: Any, step: Any, mode: str) -> None:
    """Check that a step of a mode does not lead out of the set, and that V falls."""
    (E, box, wrong), (side, name) = step, SIDES[mode]
    S, P, one, D = (
        proof["set"]["S"],
        proof["storage"]["P"],
        proof["set"][name],
        proof["sensor"]["width_max"],
    )
    toward, back = one["clip"]
    n = len(box) - 2
    k, other = n + (side < 0), n + (side >= 0)
    unit = make_identity(len(E[0]))
    require(E[other] == unit[other] and not box[other], "source: a width without a reading rests")
    require(side < 1 or [row[n] for row in E] == proof["gains"], "gains: those of the C")
    keys = [*range(n), k][: n + abs(side)]
    own = [row[: len(keys)] for row in P[: len(keys)]]
    require_positive(own, "storage: P > 0")
    falls = subtract_square(own, [[E[i][j] for j in keys] for i in keys], own)
    require_positive(falls, f"storage: V falls, {mode}")
    F = [[*row, Fraction(i == k)] for i, row in enumerate(E)]
    M = subtract_square(mix(S, S, 1 - one["decay"], 0), F, S)
    for i, x in zip([k, other, *range(n + 2, len(M) - 1)], one["loud"], strict=True):
        M[i][i] += x
    for i, x in enumerate(F[k]):
        sector = ((toward + back) * x - back * (i == k)) / 2
        M[i][-1] += sector
        M[-1][i] += sector
    require_positive(M, f"set: V stays, {mode}")
    signs = (
        min(*one["loud"], toward, back, one["push"]) >= 0 and max(one["push"], one["decay"]) <= 1
    )
    require(signs, "set: signs")
    most = weigh([weigh(map(abs, row), box) for row in S], box)
    require(most <= one["push"] ** 2, f"set: rounding, {mode}")
    sizes = [D, D, wrong, *proof["bounds"]["disturbance"]]
    outside = weigh(one["loud"], [size * size for size in sizes])
    require(1 - one["decay"] + outside <= (1 - one["push"]) ** 2, f"set: V stays below 1, {mode}")


def check_sampled(proof: Any, texts: list[str]) -> None:
    """Check a sampled observer: its C, and that no step leads out of the set."""
    code, one, D = Code(proof, texts), proof["set"], proof["sensor"]["width_max"]
    n, S = len(proof["plant"]["A"]), one["S"]
    require(code.step == proof["operations"], "operations: those of the C")
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
    (cross,) = mix(multiply([L], P), C, ONE, -W)
    fall = mix(PA, list(map(list, zip(*PA, strict=True))), -ONE, -ONE)
    bordered = [[*row, x] for row, x in zip(fall, cross, strict=True)]
    require_positive([*bordered, [*cross, 2 * (1 - margin) * W]], "inequality: V falls")
