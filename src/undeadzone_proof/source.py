"""Read the C of an observer: its text, literals, order of evaluation and roundings."""

from __future__ import annotations

import re
from fractions import Fraction
from math import nan
from typing import Any

Row = list[Any]  # of numbers
FORMATS = {"double": (53, 1074), "float": (24, 149)}  # bits, and of the least number
GUARDS = ("STDC FP_CONTRACT OFF", 'GCC optimize("fp-contract=off")', "defined(__FAST_MATH__)")
TOKEN = re.compile(r"(\d[\d.]*(?:e[+-]?\d{1,3})?f?)|([a-z]\w*(?:->\w+\[\d+\])?)|(&&|\|\||\S)")
ASSIGNMENT = r"(?:const (?:bool|float|double) )?(\w+(?:->\w+\[\d+\])?) = ([^!=/]*)"
CLIP = r"(\w+) = \((\w+) < (\S+)\) \? \2 : \3; const \w+ (\w+) = \((0\.0f?) < \1\) \? \1 : \5;"
PYTHON = dict(zip(["(", "?", ":", "&&", "||", *")<+-*%"], ["pick(", *",,&|)<+-*%"], strict=True))
ZERO, ONE = Fraction(0), Fraction(1)


class Refused(Exception):
    """Step of a proof that does not hold."""


def require(truth: Any, step: str) -> None:
    """Raise Refused unless a step holds."""
    if not truth:
        raise Refused(step)


def weigh(row: Any, sizes: Any) -> Any:
    """Return the sum of products of two rows."""
    return sum(a * b for a, b in zip(row, sizes, strict=True) if a and b)


def mix(X: list[Row], Y: list[Row], a: Any = 1, b: Any = 1) -> list[Row]:
    """Return a X + b Y."""
    pairs = zip(X, Y, strict=True)
    return [[a * x + b * y for x, y in zip(*rows, strict=True)] for rows in pairs]


def make_identity(n: int) -> list[Row]:
    """Return the identity matrix of n rows."""
    return [[ZERO] * k + [ONE] + [ZERO] * (n - 1 - k) for k in range(n)]


class Number:
    """Number of the C: a sum of 1 and the inputs, each times its factor, up to `error`."""

    def __init__(self, code: Any, row: Row, error: Any = ZERO, end: Any = None) -> None:
        """Take the factors of 1 and of the inputs. Ahead of a clip to [0, end] there is an end."""
        self.code, self.row, self.error, self.end = code, row, error, end
        self.constant = not (any(row[1:]) or error)

    def combine(self, other: Number, a: Any, b: Any) -> Number:
        """Return a times it and b times the other, exactly."""
        require(self.end == other.end is None, "source: behind a clip nothing is computed")
        row = [weigh((a, b), pair) for pair in zip(self.row, other.row, strict=True)]
        return Number(self.code, row, abs(a) * self.error + abs(b) * other.error)

    def round(self) -> Number:
        """Return it rounded to nearest."""
        size = max(map(abs, self.find_ends()))
        require(size < 1 << 120, "rounding: no overflow, and no missing reading is used")
        new = size / (1 << self.code.bits) + Fraction(1, 1 << self.code.least)
        return Number(self.code, self.row, self.error + new)

    def find_ends(self) -> tuple[Any, Any]:
        """Return its least and its largest value."""
        pairs = zip(self.row, self.code.ranges, strict=True)
        spans = [(c * low, c * high) for c, (low, high) in pairs if c]
        low, high = (sum(map(end, spans)) for end in (min, max))
        return low - self.error, high + self.error

    def __add__(self, other: Any) -> Any:
        """Return the rounded sum. 0 adds nothing, exactly."""
        exact = any(x.constant and not x.row[0] for x in (self, other))
        return self.combine(other, 1, 1) if exact else self.combine(other, 1, 1).round()

    def __neg__(self) -> Number:
        """Return the negative, exactly."""
        return self.combine(self, -1, 0)

    def __sub__(self, other: Any) -> Any:
        """Return the rounded difference."""
        return self + -other

    def __mul__(self, other: Any) -> Any:
        """Return the rounded product with a constant."""
        factor, form = (self, other) if self.constant else (other, self)
        require(factor.constant, "source: one factor is a constant")
        return form.combine(form, factor.row[0], 0).round()

    def __lt__(self, other: Any) -> Any:
        """Return whether it is less. NaN is not."""
        low, high = other.combine(self, 1, -1).find_ends()
        require(low > 0 or not high > 0, "source: choices are known, or clips to the range")
        return low > 0

    def __mod__(self, top: Any) -> Any:
        """Return the number ahead of a clip to [0, top]."""
        return Number(self.code, self.row, self.error, top.row[0])


def pick(first: Any, *options: Any) -> Any:
    """Return an expression in parentheses, or one of two options."""
    require(not options or isinstance(first, bool), "source: a choice has a truth")
    return options[not first] if options else first


class Code:
    """Functions of the C by name, as statements, and its constants in order."""

    def __init__(self, proof: Any, texts: list[str]) -> None:
        """Read C and header. Raises Refused unless they have an observer and nothing else."""
        name, kind, n = proof["source"]["name"], proof["source"]["format"], len(proof["plant"]["A"])
        self.bits, self.least = FORMATS[kind]
        self.states = list(map("state->x[{}]".format, range(n)))
        self.states += ["state->right[0]", "state->left[0]"]
        self.inputs = list(map("in->u[{}]".format, range(len(proof["plant"]["B"][0]))))
        self.ranges: Any = []
        text, header = (re.sub(r"/\*.*?\*/", "", each, flags=re.DOTALL) for each in texts)
        head, first, rest = text.partition(f"\nvoid {name}_")
        foreign = rf'#\s*(define|undef|include)\s+(?!{name.upper()}_|"{name}\.h"|<std|<math)'
        require(not re.search(foreign, text + header), "source: no foreign macros")
        require({kind} == {*re.findall(r"(\w+) \w+\[\d+\];", header)}, "source: one format")
        require(all(guard in head for guard in GUARDS), "source: arithmetic is as written")
        function = re.compile(rf"^void {name}_(\w+)\([^)]*\)\n{{\n([^}}#]*;)\n}}\n", re.M)
        require(not function.sub("", first + rest).strip(), "source: functions alone")
        found = {key: " ".join(each.split()) for key, each in function.findall(first + rest)}
        self.lines = {key: each.removesuffix(";").split("; ") for key, each in found.items()}
        words = [word for each in found.values() for word, *_ in TOKEN.findall(each) if word]
        self.numbers = {word: self.read_literal(word) for word in words}
        self.constants = list(map(self.numbers.get, words))

    def read_literal(self, text: str) -> Fraction:
        """Return the number nearest to a literal, as a compiler takes it."""
        require(text.endswith("f") == (self.bits == 24), f"source: {text} has the format")
        x = Fraction(text.removesuffix("f"))
        e = x.numerator.bit_length() - x.denominator.bit_length()
        unit = Fraction(2) ** max(e - (x < Fraction(2) ** e) + 1 - self.bits, -self.least)
        return round(x / unit) * unit

    def run(self, name: str, ranges: Any, known: Any) -> list[Any]:
        """Return the states behind a function, from ranges of 1 and inputs, and what is known."""
        self.ranges = ranges
        one = make_identity(len(ranges))[0]
        numbers = {key: Number(self, [x * each for each in one]) for key, x in self.numbers.items()}
        memory: Any = known | numbers
        for line in re.sub(CLIP, r"\4 = \2 % \3;", "; ".join(self.lines[name])).split("; "):
            made: Any = re.fullmatch(ASSIGNMENT, line)
            require(made and not re.search("<[^()]*<", line), f"source: {line} is understood")
            tokens = TOKEN.findall(made[2])
            parts = [
                f"m[{number or name!r}]" if number or name else PYTHON.get(sign, "!")
                for number, name, sign in tokens
            ]
            scope = {"__builtins__": {}, "m": memory, "pick": pick}
            try:
                memory[made[1]] = eval(f"pick({''.join(parts)})", scope)
            except (LookupError, TypeError, AttributeError, SyntaxError):
                raise Refused(f"source: {line} is understood") from None
        return [memory[key] for key in self.states]

    def begin(self) -> list[Any]:
        """Return the states behind init."""
        return [each.row[0] for each in self.run("init", [(1, 1)], {})]

    def step(self, ranges: Any, reading: bool) -> list[Any]:
        """Return the states behind a step from ranges of 1, states, reading and inputs."""
        one, *rows = make_identity(len(ranges))
        lost = Number(self, one, nan)
        known = dict.fromkeys(map("state->held[{}]".format, range(len(self.inputs))), lost)
        names = [*self.states, "in->y[0]", *self.inputs]
        known |= {key: Number(self, row) for key, row in zip(names, rows, strict=True)}
        return self.run("step", ranges, known if reading else known | {"in->y[0]": lost})
