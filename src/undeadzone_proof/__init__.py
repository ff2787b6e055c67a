"""Check a proof about the C of an observer in exact fractions, with the standard library alone.

docs/proof.md has the theorem. The file proposes numbers; each inequality comes from the C itself.
"""

from __future__ import annotations

import json
import re
import sys
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from math import nan
from pathlib import Path
from typing import Any

Row = list[Fraction]
FORMATS = {"double": (53, 1074), "float": (24, 149)}  # bits, and of the least number
GUARDS = ("STDC FP_CONTRACT OFF", 'GCC optimize("fp-contract=off")', "defined(__FAST_MATH__)")
TOKEN = re.compile(r"(\d[\d.]*(?:e[+-]?\d{1,3})?f?)|([a-z]\w*(?:->\w+\[\d+\])?)|(&&|\|\||\S)")
ASSIGNMENT = r"(?:const (?:bool|float|double) )?(\w+(?:->\w+\[\d+\])?) = ([^!=/]*)"
PYTHON = dict(zip(["(", "?", ":", "&&", "||", *")<+-*"], ["pick(", *",,&|)<+-*"], strict=True))
WIDTHS = ["state->right[0]", "state->left[0]"]
FAULTS = (LookupError, ValueError, TypeError, ArithmeticError, AttributeError, OSError, SyntaxError)
ZERO, ONE = Fraction(0), Fraction(1)
SERIES = Fraction(1, 1 << 100)


class Refused(Exception):
    """Step of a proof that does not hold."""


def require(truth: Any, step: str) -> None:
    """Raise Refused unless a step holds."""
    if not truth:
        raise Refused(step)


def weigh(row: Row, sizes: Row) -> Fraction:
    """Return the sum of products of two rows."""
    return sum(map(Fraction.__mul__, row, sizes), ZERO)


def multiply(X: list[Row], Y: list[Row]) -> list[Row]:
    """Return the product of matrices."""
    columns = list(map(list, zip(*Y, strict=True)))
    return [list(map(partial(weigh, row), columns)) for row in X]


def mix(X: list[Row], Y: list[Row], a: Fraction, b: Fraction) -> list[Row]:
    """Return a X + b Y."""
    pairs = zip(X, Y, strict=True)
    return [[a * x + b * y for x, y in zip(*rows, strict=True)] for rows in pairs]


def make_identity(n: int) -> list[Row]:
    """Return the identity matrix of n rows."""
    return [[ZERO] * k + [ONE] + [ZERO] * (n - 1 - k) for k in range(n)]


def select_entries(X: list[Row], keys: list[int]) -> list[Row]:
    """Return some rows and columns of a matrix."""
    return [[X[i][j] for j in keys] for i in keys]


def require_positive(M: list[Row], step: str) -> None:
    """Raise Refused unless a symmetric matrix has positive pivots."""
    require(list(map(list, zip(*M, strict=True))) == M, f"{step} (symmetric)")
    while M:
        (top, *rest), *rows = M
        require(top > 0, step)
        M = [[x - row[0] / top * y for x, y in zip(row[1:], rest, strict=True)] for row in rows]


@dataclass(frozen=True, eq=False)
class Number:
    """Number of the C: a sum of inputs times `terms` up to `error`, between `low` and `high`."""

    code: Code
    terms: dict[str, Fraction]
    error: Any
    low: Any
    high: Any

    def combine(self, other: Number, a: Fraction, b: Fraction, exact: Any) -> Number:
        """Return a times it and b times the other, rounded to nearest unless it is exact."""
        names = self.terms | other.terms
        require("clip" not in names, "source: nothing is computed from a clipped width")
        terms = {k: a * self.terms.get(k, 0) + b * other.terms.get(k, 0) for k in names}
        ends = [sorted((s * x.low, s * x.high)) for s, x in ((a, self), (b, other))]
        low, high = map(sum, zip(*ends, strict=True))
        size = max(-low, high)
        require(exact or size < 1 << 120, "rounding: no overflow, and no missing reading is used")
        new = 0 if exact else size / (1 << self.code.bits) + Fraction(1, 1 << self.code.least)
        error = abs(a) * self.error + abs(b) * other.error + new
        return Number(
            self.code, {k: x for k, x in terms.items() if x}, error, low - new, high + new
        )

    def __add__(self, other: Any) -> Any:
        """Return the rounded sum. 0 adds nothing, exactly."""
        exact = self.low == self.high == 0 or other.low == other.high == 0
        return self.combine(other, ONE, ONE, exact)

    def __neg__(self) -> Number:
        """Return the negative, exactly."""
        return self.combine(self, -ONE, ZERO, True)

    def __sub__(self, other: Any) -> Any:
        """Return the rounded difference."""
        return self + -other

    def __mul__(self, other: Any) -> Any:
        """Return the rounded product with a constant."""
        factor, form = (self, other) if self.low == self.high else (other, self)
        require(factor.low == factor.high, "source: one factor is a constant")
        return form.combine(form, factor.low, ZERO, not factor.low)

    def __lt__(self, other: Any) -> Any:
        """Return whether it is less: a truth, or both numbers if that is open. NaN is not."""
        if self.high < other.low or not self.low < other.high:
            return self.high < other.low
        return self, other


class Code:
    """Functions of the C by name, as statements, and its constants in order."""

    def __init__(self, proof: Any, texts: list[str]) -> None:
        """Read C and header. Raises Refused unless they have an observer and nothing else."""
        name, kind = proof["source"]["name"], proof["source"]["format"]
        self.bits, self.least = FORMATS[kind]
        self.widest = proof["sensor"]["width_max"]
        text, header = (re.sub(r"/\*.*?\*/", "", each, flags=re.DOTALL) for each in texts)
        head, first, rest = text.partition(f"\nvoid {name}_")
        foreign = rf'#\s*(define|undef|include)\s+(?!{name.upper()}_|"{name}\.h"|<std|<math)'
        require(not re.search(foreign, text + header), "source: no foreign macros")
        require({kind} == {*re.findall(r"(\w+) \w+\[\d+\];", header)}, "source: one format")
        for guard in GUARDS:
            require(guard in head, "source: arithmetic is as written")
        function = re.compile(rf"^void {name}_(\w+)\([^)]*\)\n{{\n([^}}#]*;)\n}}\n", re.M)
        require(not function.sub("", first + rest).strip(), "source: functions alone")
        found = dict(function.findall(first + rest))
        self.bodies = {
            key: " ".join(each.split()).rstrip(";").split("; ") for key, each in found.items()
        }
        words = [word for each in found.values() for word, *_ in TOKEN.findall(each) if word]
        self.numbers = {word: self.read_literal(word) for word in words}
        self.constants = [self.numbers[word].low for word in words]

    def read_literal(self, text: str) -> Number:
        """Return the number nearest to a literal, as a compiler takes it."""
        require(text.endswith("f") == (self.bits == 24), f"source: {text} has the format")
        x = Fraction(text.removesuffix("f"))
        e = x.numerator.bit_length() - x.denominator.bit_length()
        unit = Fraction(2) ** max(e - (x < Fraction(2) ** e) + 1 - self.bits, -self.least)
        x = round(x / unit) * unit
        return Number(self, {"": x} if x else {}, ZERO, x, x)

    def pick(self, truth: Any, one: Any = None, other: Any = None) -> Any:
        """Return an expression in parentheses, or the option that a truth picks.

        An open truth must be one of a clip by a constant that leaves true widths alone.
        """
        if one is None or isinstance(truth, bool):
            return truth if one is None else (one if truth else other)
        require({id(one), id(other)} == {*map(id, truth)}, "source: choices are known, or clips")
        end, moved = sorted((one, other), key=lambda each: each.low < each.high)
        least = one is truth[0]
        spared = end.low >= self.widest if least else end.low <= 0
        require(end.low == end.high and spared, "source: clips spare true widths")
        nearer: Any = min if least else max
        low, high = nearer(moved.low, end.low), nearer(moved.high, end.low)
        return replace(moved, terms=moved.terms | {"clip": ONE}, low=low, high=high)

    def run_function(self, name: str, ranges: dict[str, tuple[Any, Any]]) -> dict[str, Any]:
        """Return all numbers by their names in the C behind a function, from ranges of inputs."""
        memory: Any = dict(self.numbers)
        memory |= {k: Number(self, {k: ONE}, ZERO, *x) for k, x in ranges.items()}
        for line in self.bodies[name]:
            made: Any = re.fullmatch(ASSIGNMENT, line)
            require(made and not re.search("<[^()]*<", line), f"source: {line} is understood")
            parts = [
                f"m[{a or b!r}]" if a or b else PYTHON[c] for a, b, c in TOKEN.findall(made[2])
            ]
            scope = {"__builtins__": {}, "m": memory, "pick": self.pick}
            memory[made[1]] = eval(f"pick({''.join(parts)})", scope)
        return memory


def hold_exactly(plant: Any) -> list[Row]:
    """Return the first rows of e^M, M = [A, B; 0, 0] Ts, each entry within SERIES of it.

    Each term is cut at 2^-200. Behind the last one the sum is less than twice 16^100 / 100!.
    """
    n, m, cut = len(plant["A"]), len(plant["B"][0]), 1 << 200
    rows = [a + b for a, b in zip(plant["A"], plant["B"], strict=True)]
    M = mix(rows, rows, plant["Ts"], ZERO) + [[ZERO] * (n + m)] * m
    require(max(sum(map(abs, row)) for row in M) <= 16, "hold: a sample is short")
    total = term = make_identity(n + m)
    for k in range(1, 100):
        term = [[Fraction(int(x / k * cut), cut) for x in row] for row in multiply(term, M)]
        total = mix(total, term, ONE, ONE)
    return total[:n]


def list_modes(proof: Any, code: Code) -> list[tuple[str, int, Any, Any, Fraction]]:
    """Return each mode of a step: name, side, least and largest reading, bound of its error.

    Rounding keeps the order, so that it never shows a side that the sum before did not.
    """
    (C,), sensor, least = proof["plant"]["C"], proof["sensor"], Fraction(1, 1 << code.least)
    threshold, noise = sensor["threshold"], proof["bounds"]["noise"]
    require(noise <= threshold, "bounds: noise shows no side")
    largest = sensor["slope"] * weigh(list(map(abs, C)), proof["bounds"]["x"]) + noise
    wrong = noise + largest / (1 << code.bits) + least
    above, top = threshold + least, threshold + least + largest + wrong
    silent = [("silent", 0, -threshold, threshold, wrong), ("silent", 0, nan, nan, wrong)]
    return [("side", 1, above, top, wrong), ("side", -1, -top, -above, wrong), *silent]


def map_step(
    proof: Any, code: Code, held: Any, side: int, low: Any, high: Any
) -> tuple[list[Row], Row]:
    """Return what a step makes of the errors of states and widths, of a reading, of disturbances.

    And a bound of all else: rounding, and a plant that is not the C's.
    """
    (C,) = proof["plant"]["C"]
    bounds = proof["bounds"]
    X, U = bounds["x"], bounds["u"]
    D = code.widest
    n = len(C)
    x = list(map("state->x[{}]".format, range(n)))
    u = list(map("in->u[{}]".format, range(len(U))))
    largest = zip(x + u, [*map(Fraction.__add__, X, bounds["reach"]), *U], strict=True)
    ranges: Any = {key: (-size, size) for key, size in largest} | {"in->y[0]": (low, high)}
    ranges |= dict.fromkeys(map("state->held[{}]".format, range(len(U))), (nan, nan))
    ranges |= dict.fromkeys(WIDTHS, (ZERO, D))
    behind = code.run_function("step", ranges)
    sizes = [*X, D, D, *map(Fraction.__add__, U, bounds["disturbance"])]
    true = [[*row[:n], ZERO, ZERO, *row[n:]] for row in held]
    true += make_identity(len(sizes))[n : n + 2]
    signed = [*C, Fraction(-(side > 0)), Fraction(side < 0), *[ZERO] * len(u)]
    seen = mix([signed], [signed], proof["sensor"]["slope"], ZERO)[0]
    E, box = list[Row](), list[Fraction]()
    for k, name in enumerate(x + WIDTHS):
        form = behind[name]
        ok = form.terms.keys() <= {*x, *WIDTHS, *u, "in->y[0]", *["clip"] * (k >= n)}
        require(ok, "source: a step depends on the inputs alone")
        require(k < n or (form.low >= 0 and form.high <= D), "source: widths stay in their range")
        *row, y = (form.terms.get(key, ZERO) for key in [*x, *WIDTHS, *u, "in->y[0]"])
        require(side or not y, "source: silence has no reading")
        rest = [a - b - y * c for a, b, c in zip(true[k], row, seen, strict=True)]
        lost = form.error + SERIES * sum(sizes) * (k < n)
        box.append(lost + weigh(list(map(abs, rest)), sizes))
        E.append([*row[: n + 2], -y, *row[n + 2 :]])
    return E, box


def subtract_square(X: list[Row], F: list[Row], S: list[Row]) -> list[Row]:
    """Return X - F'S F, X with zeros behind its rows and columns."""
    square = multiply(list(map(list, zip(*F, strict=True))), multiply(S, F))
    behind = len(square) - len(X)
    wide = [row + [ZERO] * behind for row in X] + [[ZERO] * len(square)] * behind
    return mix(wide, square, ONE, -ONE)


def check_mode(proof: Any, step: Any, mode: str, side: int, wrong: Fraction) -> None:
    """Check that a step of a mode does not lead out of the set, and that V falls."""
    (E, box), S, one, own = step, proof["set"]["S"], proof["set"][mode], proof["storage"]["P"]
    toward, back = one["clip"]
    n = len(box) - 2
    k, other = n + (side < 0), n + (side >= 0)
    rests = E[other] == make_identity(len(E[0]))[other] and not box[other]
    require(rests, "source: a width without a reading rests")
    gains = list(list(zip(*E, strict=True))[n])
    require(side < 1 or gains == proof["gains"], "gains: those of the C")
    keys = [*range(n), k] if side else [*range(n)]
    P = select_entries(own, [*range(len(keys))])
    require_positive(P, "storage: P > 0")
    falls = subtract_square(P, select_entries(E, keys), P)
    require_positive(falls, f"storage: V falls, {mode}")
    F = [[*row, Fraction(i == k)] for i, row in enumerate(E)]
    M = subtract_square(mix(S, S, 1 - one["decay"], ZERO), F, S)
    for i, x in zip([k, other, *range(n + 2, len(M) - 1)], one["loud"], strict=True):
        M[i][i] += x
    for i, x in enumerate(F[k]):
        sector = ((toward + back) * x - back * (i == k)) / 2
        M[i][-1] += sector
        M[-1][i] += sector
    require_positive(M, f"set: V stays, {mode}")
    D, push = proof["sensor"]["width_max"], one["push"]
    signs = min(*one["loud"], toward, back, push) >= 0 and max(push, one["decay"]) <= 1
    require(signs, "set: signs")
    most = weigh([weigh(list(map(abs, row)), box) for row in S], box)
    require(most <= push**2, f"set: rounding, {mode}")
    sizes = [D, D, wrong, *proof["bounds"]["disturbance"]]
    outside = weigh(one["loud"], list(map(Fraction.__mul__, sizes, sizes)))
    require(1 - one["decay"] + outside <= (1 - push) ** 2, f"set: V stays below 1, {mode}")


def check_sampled(proof: Any, texts: list[str]) -> None:
    """Check a sampled observer: its C, and that no step leads out of the set."""
    code, one, reach = Code(proof, texts), proof["set"], proof["bounds"]["reach"]
    D, S, n = code.widest, one["S"], len(reach)
    require(code.bodies["step"] == proof["operations"], "operations: those of the C")
    require(code.constants == proof["constants"], "constants: those of the C")
    start = code.run_function("init", {})
    for key in WIDTHS:
        within = start[key].low >= 0 and start[key].high <= D
        require(within, "source: widths begin in their range")
    rows = proof["plant"]["C"] + make_identity(n)
    for c, most in zip(rows, [one["radius"], *reach], strict=True):
        c = [*c, ZERO, ZERO]
        bordered = [[*row, x] for row, x in zip(S, c, strict=True)] + [[*c, most * most]]
        require(most > 0, "set: signs")
        require_positive(bordered, "set: radius and reach contain it")
    begin = sum(map(abs, S[n][n:] + S[n + 1][n:])) * D * D
    require(begin <= 1, "set: it contains all widths")
    held = hold_exactly(proof["plant"])
    for mode, side, *ends, wrong in list_modes(proof, code):
        check_mode(proof, map_step(proof, code, held, side, *ends), mode, side, wrong)


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
        margin, W = to_words(proof["storage"]["margin"]), to_words(proof["storage"]["W"])
        return (
            f"{plant}: for every sequence of sides and every gamma > 0 the observer with "
            f"{to_words(proof['gains'])} has a V that falls faster than {margin} times 2 W e^2, "
            f"W = {W}."
        )
    source, bounds = proof["source"], {k: to_words(x) for k, x in proof["bounds"].items()}
    return (
        f"{source['name']}.c in {source['format']} beside {plant}, {to_words(proof['sensor'])}: "
        f"begun with x^ = x and any widths, z^ stays within {to_words(proof['set']['radius'])} of "
        "z, whatever the sequence of sides, missing readings and roundings, while |x| <= "
        f"{bounds['x']}, |u| <= {bounds['u']}, readings are wrong by {bounds['noise']} and "
        f"disturbances are at most {bounds['disturbance']}."
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
        texts = proof["source"].get("texts")
        if source:
            texts = [source.read_text("utf-8"), source.with_suffix(".h").read_text("utf-8")]
        check_sampled(proof, texts)
    else:
        check_continuous(proof)
    require(proof["statement"] == state_theorem(proof), "statement: it differs from what is proved")
    return state_theorem(proof)


def main(arguments: list[str]) -> int:
    """Check a file, print what it proves or the first step that fails. Return the exit code."""
    try:
        file, *given = map(Path, arguments)
        proof = to_numbers(json.loads(file.read_text("utf-8")))
        own = proof.get("source", {"texts": []})
        beside = [] if "texts" in own else [file.with_name(f"{own['name']}.c")]
        words = verify_proof(proof, *(given or beside))
    except Refused as step:
        words = f"refused: {step}"
    except FAULTS as error:
        words = f"refused: no proof, {error!r}"
    sys.stdout.write(f"{words}\n")
    return int(words.startswith("refused"))
