"""Check a proof about an observer in exact fractions, with the standard library alone.

docs/proof.md has the theorem. The file only proposes numbers: `source` reads the C, and every
inequality is computed here from the C's own constants.
"""

from __future__ import annotations

import json
import re
import sys
from fractions import Fraction
from math import nan
from pathlib import Path
from typing import Any

from undeadzone_proof.exact import (
    ONE,
    ZERO,
    Matrix,
    Refused,
    dual_form,
    extend_diagonal,
    hold_exactly,
    mix_matrices,
    multiply_matrices,
    require,
    require_positive,
    transpose_rows,
    upper_norm,
    upper_root,
)
from undeadzone_proof.source import Code, Form

WIDTHS = {1: "state->right[0]", -1: "state->left[0]"}


def weigh_sizes(row: list[Fraction], sizes: list[Fraction]) -> Fraction:
    """Return the largest sum of numbers of these sizes with these factors."""
    return sum(map(Fraction.__mul__, map(abs, row), sizes), ZERO)


def run_step(
    code: Code, ranges: dict[str, list[Any]], names: list[str], inputs: list[str]
) -> tuple[Matrix, list[Fraction]]:
    """Return the factors of some results of a step in its inputs, and bounds of their rounding.

    As a whole and in halves a step has the same factors. Widths stay in their range, and one that
    is not among the results stays as it is.
    """
    largest, rows = [ZERO] * len(names), list[Matrix]()
    for functions in (["step"], ["estimate", "advance"]):
        memory: Any = {key: Form(code, {key: ONE}, ZERO, *ends) for key, ends in ranges.items()}
        before = dict(memory)
        for function in functions:
            code.run_function(function, memory)
        for key in WIDTHS.values():
            inside = memory[key].low >= 0 and memory[key].high <= code.widest
            require(inside, "source: widths stay in their range")
            rests = memory[key].terms == before[key].terms and not memory[key].error
            require(key in names or rests, "source: a width without a reading rests")
        found = [memory[name] for name in names]
        require(all(form.terms.keys() <= {*inputs} for form in found), "source: known inputs alone")
        rows.append([[form.terms.get(key, ZERO) for key in inputs] for form in found])
        largest = [max(a, form.error) for a, form in zip(largest, found, strict=True)]
    require(rows[0] == rows[1], "source: its halves are the step")
    return rows[0], largest


def compare_step(
    proof: Any, code: Code, held: Any, reach: list[Fraction], side: int, ends: list[Any]
) -> tuple[Matrix, list[Fraction]]:
    """Return what a step makes of the error, of a reading's error and of disturbances.

    And bounds of all else, of rounding first of all.

    Args:
        proof: plant, sensor and bounds.
        code: the C.
        held: `hold` of the plant.
        reach: how far each estimate may be from its state.
        side: 1 right, -1 left, 0 neither. A row for each state, and for the width of a side.
        ends: least and largest reading, NaN for a missing one.
    """
    (C,), (Phi, Psi, lost) = proof["plant"]["C"], held
    X, U, has = proof["bounds"]["x"], proof["bounds"]["u"], abs(side)
    x, u = [f"state->x[{k}]" for k in range(len(X))], [f"in->u[{k}]" for k in range(len(U))]
    sizes = zip(x + u, [*map(Fraction.__add__, X, reach), *U], strict=True)
    ranges = {key: [-size, size] for key, size in sizes} | {"in->y[0]": ends}
    ranges |= {key: [ZERO, code.widest] for key in WIDTHS.values()}
    ranges |= {key.replace("in->u", "state->held"): [nan, nan] for key in u}
    names = [*x, *[WIDTHS.get(side, "")] * has]
    rows, box = run_step(code, ranges, names, [*names, "in->y[0]", *u])
    true = [[*row, *[ZERO] * has, *given] for row, given in zip(Phi, Psi, strict=True)]
    true += [[Fraction(key == WIDTHS.get(side)) for key in names + u]] * has
    seen = [proof["sensor"]["slope"] * y for y in [*C, *[Fraction(-side)] * has]]
    E = []
    for k, row in enumerate(rows):
        own, y, given = row[: len(names)], row[len(names)], row[len(names) + 1 :]
        known = [a + y * b for a, b in zip(own, seen, strict=True)] + given
        box[k] += weigh_sizes(mix_matrices([true[k]], [known])[0], [*X, *[code.widest] * has, *U])
        box[k] += lost * sum([*X, *U, *U])  # disturbances are no larger than inputs
        E.append([*own, -y, *true[k][len(names) :]])
    return E, box


def check_step(proof: Any, code: Code, one: Any, side: int, E: Matrix, box: list[Fraction]) -> None:
    """Check that a step on a side does not lead out of a set.

    Args:
        proof, code: as of `compare_step`.
        one: the set.
        side: of the step.
        E, box: result of `compare_step`.
    """
    k = len(box)
    own = {"L": [row[k - 1] for row in E[:-1]], "gamma": 1 - E[-1][k - 1]}
    require(side < 1 or own == proof["gains"], "gains: those of the C")
    P, R, decay, loud = (proof["storage"][key] for key in ("P", "R", "decay", "loud"))
    V, K, D = (one[key] for key in ("V", "K", "width"))
    outside = [bound_reading_error(proof, code, one), *one["disturbance"]]
    whole = extend_diagonal(P, [R] * abs(side))
    room = extend_diagonal(mix_matrices(whole, whole, 1 - decay, 0), loud)
    require_positive(
        mix_matrices(room, multiply_matrices(transpose_rows(E), whole, E)),
        "decay: V falls, but for noise",
    )
    push = upper_norm([[abs(x) for x in row] for row in whole], box)
    rest = (1 - decay) * K**2 + weigh_sizes(loud, [x**2 for x in outside])
    require(push <= K and rest <= (K - push) ** 2, "set: K absorbs what a step adds")
    w = R * D**2
    if code.widest <= D:
        require(K**2 + 2 * w <= V, "set: V has room for any widths")
    elif side:
        *c, kept = E[-1][:k]
        g, own = 1 - kept, one["K1"]
        require(0 < g <= 1 and own > 0, "set: widths move towards the reading")
        h, d = (
            upper_root(R * dual_form(P, c)) / g,
            upper_root(R) * (box[-1] + weigh_sizes(E[-1][k:], outside)) / g,
        )
        require(own**2 * (1 - g * (h + d / own) ** 2) >= K**2, "set: K1 absorbs what widths take")
        require((h * own + d) ** 2 + w + K**2 <= V, "set: V has room for the widths")
        rest = upper_root(V - w)
        require(h * rest + d <= w / upper_root(w), "set: widths follow the states")
        require(g * h * upper_root(w) <= (1 - g) * (V - w) / rest, "set: widths follow slowly")


def bound_reading_error(proof: Any, code: Code, one: Any) -> Fraction:
    """Return a bound of a reading's error in a set: noise, and rounding to the format.

    Rounding keeps the order, so that it never shows a side that the sum before did not.
    """
    largest = proof["sensor"]["slope"] * weigh_sizes(proof["plant"]["C"][0], proof["bounds"]["x"])
    rounding = (largest + one["noise"]) / (1 << code.bits) + Fraction(1, 1 << code.least)
    return Fraction(one["noise"] + rounding)


def list_sides(proof: Any, code: Code, one: Any) -> list[tuple[int, list[Any]]]:
    """Return each side with its least and largest reading, and a missing reading."""
    threshold = proof["sensor"]["threshold"]
    above = threshold + max(threshold / (1 << code.bits), Fraction(1, 1 << code.least))
    largest = proof["sensor"]["slope"] * weigh_sizes(proof["plant"]["C"][0], proof["bounds"]["x"])
    top = max(above, largest + bound_reading_error(proof, code, one))
    sides = [(1, [above, top]), (0, [-threshold, threshold]), (0, [nan, nan])]
    return [*sides, (-1, [-top, -above])]


def reach_states(P: Matrix, V: Fraction) -> list[Fraction]:
    """Return how far each estimate may be from its state where x~'P x~ <= V."""
    n = len(P)
    units = [[Fraction(i == k) for i in range(n)] for k in range(n)]
    return [upper_root(V * dual_form(P, unit)) for unit in units]


def check_code(proof: Any, texts: list[str]) -> None:
    """Check a sampled observer: its C, and that no step leads out of a set."""
    own, storage, widest = proof["source"], proof["storage"], proof["sensor"]["width_max"]
    code = Code(texts, own["name"], own["format"], widest)
    require(code.bodies["step"] == proof["operations"], "operations: those of the C")
    require(code.constants == proof["constants"], "constants: those of the C")
    known = proof["sensor"]["threshold"] in (0, *code.constants)
    require(known, "sensor: its threshold is that of the C")
    start = dict[str, Any]()
    code.run_function("init", start)
    ends = [start[key].low for key in WIDTHS.values()]
    require(min(ends) >= 0 and max(ends) <= widest, "source: widths begin in their range")
    P, (C,) = storage["P"], proof["plant"]["C"]
    require_positive(P, "storage: P > 0")
    require(storage["R"] > 0 and 0 < storage["decay"] < 1, "storage: signs")
    require(min(storage["loud"]) >= 0, "storage: signs of what noise adds")
    held = hold_exactly(*(proof["plant"][key] for key in ("A", "B", "Ts")))
    for one in proof["sets"]:
        bounds = [one["noise"], *one["disturbance"], *proof["bounds"]["x"], *proof["bounds"]["u"]]
        require(min(bounds) >= 0 and min(one["V"], one["K"], one["width"]) > 0, "set: signs")
        require(one["noise"] <= proof["sensor"]["threshold"], "set: noise shows no side")
        pairs = zip(one["disturbance"], proof["bounds"]["u"], strict=True)
        require(all(x <= y for x, y in pairs), "set: disturbances are no larger than inputs")
        reach = reach_states(P, one["V"])
        for side, between in list_sides(proof, code, one):
            step = compare_step(proof, code, held, reach, side, between)
            check_step(proof, code, one, side, *step)
        inside = one["V"] * dual_form(P, C) <= one["radius"] ** 2 and one["radius"] > 0
        require(inside, "set: its radius contains V")


def check_continuous(proof: Any) -> None:
    """Check a continuous observer: V falls in silence, on branches, and on all between."""
    A, (C,), L = proof["plant"]["A"], proof["plant"]["C"], proof["gains"]["L"]
    P, W, margin = (proof["storage"][key] for key in ("P", "W", "margin"))
    require_positive(P, "storage: P > 0")
    require(W > 0 and margin > 0, "storage: W and the margin are above 0")
    cross = [a - W * b for a, b in zip(multiply_matrices([L], P)[0], C, strict=True)]
    fall = mix_matrices(multiply_matrices(P, A), multiply_matrices(transpose_rows(A), P), -1)
    whole = [
        *([*row, x] for row, x in zip(fall, cross, strict=True)),
        [*cross, 2 * (1 - margin) * W],
    ]
    require_positive(whole, "inequality: V falls")


def to_words(value: Any) -> str:
    """Return a part of the file in decimals, a fraction where these are not exact."""
    if isinstance(value, dict):
        return ", ".join(f"{key} = {to_words(each)}" for key, each in value.items())
    if isinstance(value, list):
        return f"[{', '.join(map(to_words, value))}]"
    short = repr(float(value))
    return short if value in (float(value), Fraction(short)) else str(value)


def state_theorem(proof: Any) -> str:
    """Return what is proved, in words."""
    plant = f"x' = A x + B u, z = C x with {to_words(proof['plant'])}"
    if "source" not in proof:
        storage = proof["storage"]
        return (
            f"{plant}: for every sequence of sides and every gamma > 0 the observer with "
            f"{to_words(proof['gains'])} has a V that falls faster than "
            f"{to_words(storage['margin'])} times 2 W e^2, W = {to_words(storage['W'])}."
        )
    source, bounds = proof["source"], proof["bounds"]
    sets = [
        f"{one['name']}: |z - z^| <= {to_words(one['radius'])}, "
        f"|d - d^| <= {to_words(one['width'])} (readings wrong by {to_words(one['noise'])}, "
        f"disturbances of {to_words(one['disturbance'])})"
        for one in proof["sets"]
    ]
    sensor, *most = map(to_words, (proof["sensor"], bounds["x"], bounds["u"]))
    return (
        f"{source['name']}.c in {source['format']} beside {plant}, {sensor}: while "
        f"|x| <= {most[0]} and |u| <= {most[1]}, no sequence of sides, missing "
        f"readings and roundings moves the error out of a set. {'; '.join(sets)}."
    )


def to_numbers(value: Any) -> Any:
    """Return the content of a file with its fractions as numbers."""
    if isinstance(value, dict):
        return {key: to_numbers(each) for key, each in value.items()}
    if isinstance(value, list):
        return list(map(to_numbers, value))
    return Fraction(value) if re.fullmatch(r"-?\d+(/\d+)?", value) else value


def verify_proof(proof: Any, source: Path | None = None) -> str:
    """Return the statement of a proof that holds.

    Args:
        proof: content of the file, its fractions as numbers.
        source: path of the C (None: the proof contains it).

    Raises:
        Refused: with the first step that does not hold.
    """
    if "source" in proof:
        files = [source, source.with_suffix(".h")] if source else []
        texts = [file.read_text(encoding="utf-8") for file in files]
        check_code(proof, texts or proof["source"]["texts"])
    else:
        check_continuous(proof)
    require(proof["statement"] == state_theorem(proof), "statement: it says what is proved")
    return state_theorem(proof)


def main(arguments: list[str]) -> int:
    """Check a file, print what it proves or the first step that fails. Return the exit code."""
    try:
        file, *given = map(Path, arguments)
        proof = to_numbers(json.loads(file.read_text(encoding="utf-8")))
        own = proof.get("source", {"texts": []})
        beside = [] if "texts" in own else [file.with_name(f"{own['name']}.c")]
        words = verify_proof(proof, *(given or beside))
    except Refused as step:
        words = f"refused: {step}"
    except (LookupError, ValueError, TypeError, ArithmeticError, AttributeError, OSError) as error:
        words = f"refused: no proof, {error!r}"
    sys.stdout.write(f"{words}\n")
    return int(words.startswith("refused"))
