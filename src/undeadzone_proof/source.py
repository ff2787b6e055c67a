"""Read the C of an exported observer: what a step computes, and how far rounding moves it.

Numbers are forms: exact sums of what a step begins with, up to an error. Every operation as printed
adds the bound of its rounding to nearest.
"""

from __future__ import annotations

import re
from fractions import Fraction
from typing import Any, NamedTuple

TOKEN = re.compile(r"\s*(\d[\d.]*(?:e[+-]?\d+)?f?|[A-Za-z_]\w*(?:->\w+\[\d+\])?|&&|\|\||\S)")
FORMATS = {"double": (53, 1074, ""), "float": (24, 149, "f")}  # bits, least exponent, suffix
LEVELS = (("||",), ("&&",), ("<",), ("+", "-"), ("*", "/"))
GUARDS = ("STDC FP_CONTRACT OFF", 'GCC optimize("fp-contract=off")', "defined(__FAST_MATH__)")
PLAIN = r"(\s*(#(if|elif|endif|error|pragma|include)\b.*)?\n?)*"  # lines beside the functions


class Refused(Exception):
    """Step of a proof that does not hold."""


def require(truth: Any, step: str) -> None:
    """Raise Refused unless a step holds."""
    if not truth:
        raise Refused(step)


class Form(NamedTuple):
    """Number of the C: a sum of `terms` up to `error`, from `low` to `high`.

    `clipped`: the sum was moved towards an interval that has the true width.
    """

    terms: dict[str, Fraction]
    error: Fraction
    low: Fraction
    high: Fraction
    clipped: bool = False


class Code:
    """Functions of the C by name, and the statements of a step."""

    def __init__(self, text: str, header: str, name: str, kind: str) -> None:
        """Read the text of the C and of its header.

        Raises Refused unless both have nothing but the observer, in its format.
        """
        fields = re.findall(r"(\w+) \w+\[\d+\];", header)
        macros = re.findall(r"#\s*define\s+(\w+)", header)
        plain = fields and {*fields} == {kind}
        require(plain and all(macro.startswith(name.upper()) for macro in macros), "source: header")
        self.bits, self.least, self.suffix = FORMATS[kind]
        text = re.sub(r"/\*.*?\*/", " ", text, flags=re.DOTALL)
        function = re.compile(rf"^void {name}_(\w+)\([^)]*\)\n{{\n(.*?)\n}}", re.DOTALL | re.M)
        require(all(guard in text for guard in GUARDS), "source: neither fused nor fast arithmetic")
        rest = [line.strip() for line in function.sub("", text).splitlines()]
        require(all(re.fullmatch(PLAIN, line) for line in rest), "source: nothing but functions")
        found = [(key, re.sub(r"\s+", " ", body)) for key, body in function.findall(text)]
        self.bodies = {key: [*filter(None, map(str.strip, b.split(";")))] for key, b in found}
        require(len(found) == len(self.bodies), "source: each function once")
        words = TOKEN.findall(" ".join(map(" ".join, self.bodies.values())))
        self.constants = [self.literal(word) for word in words if word[0].isdigit()]

    def literal(self, text: str) -> Fraction:
        """Return the number nearest to a literal, as a compiler takes it."""
        require(text.endswith("f") == bool(self.suffix), f"source: {text} has the format")
        x = Fraction(text.removesuffix("f"))
        e = x.numerator.bit_length() - x.denominator.bit_length()
        unit = Fraction(2) ** max(e - (x < Fraction(2) ** e) + 1 - self.bits, -self.least)
        return round(x / unit) * unit

    def run(
        self, name: str, memory: dict[str, Any], ranges: dict[str, list[Fraction]], wide: Fraction
    ) -> None:
        """Run a function on a memory of forms.

        Args:
            name: of the function.
            memory: forms by their names in C. The function stores its results there.
            ranges: the least and largest number for which each term may stand.
            wide: the largest true width.
        """
        self.memory, self.ranges, self.wide = memory, ranges, wide
        for line in self.bodies[name]:
            call = re.fullmatch(r"\w+_(estimate|advance)\(state, in(, out)?\)", line)
            made = re.fullmatch(r"(?:const (?:bool|float|double) )?([\w>\-\[\]]+) = (.*)", line)
            require(call or made or line == "(void)in", f"source: {line} is understood")
            if call:
                self.run(call[1], memory, ranges, wide)
            elif made:
                self.words = [*TOKEN.findall(made[2]), ""]
                memory[made[1]] = self.read_choice()
                require(self.words == [""], f"source: {line} is understood")

    def read_choice(self) -> Any:
        """Read `truth ? yes : no`, or an operation. An open truth must be one of a clip."""
        truth = self.read_operation()
        if self.words[0] != "?":
            return truth
        options = []
        for mark in "?:":
            require(self.words.pop(0) == mark, "source: a choice has two options")
            options.append(self.read_choice())
        if isinstance(truth, bool):
            return options[0] if truth else options[1]
        is_clip = isinstance(truth, list) and options in (truth, truth[::-1])
        require(is_clip, "source: a choice is known, or a clip")
        return self.clip(*truth, least=options == truth)

    def clip(self, a: Form, b: Form, least: bool) -> Form:
        """Return the lesser or greater of two forms, one a constant beyond all true widths."""
        moved, end = (a, b) if not b.terms.keys() - {""} else (b, a)
        at = end.low
        require(end.low == end.high, "source: the end of a clip is a constant")
        require(at >= self.wide if least else at <= 0, "source: a clip leaves true widths alone")
        pick = min if least else max
        return moved._replace(low=pick(moved.low, at), high=pick(moved.high, at), clipped=True)

    def read_operation(self, level: int = 0) -> Any:
        """Read operations of a level and above, from left to right."""
        if level == len(LEVELS):
            return self.read_atom()
        value = self.read_operation(level + 1)
        while self.words[0] in LEVELS[level]:
            value = self.apply(self.words.pop(0), value, self.read_operation(level + 1))
        return value

    def read_atom(self) -> Any:
        """Read a constant, a name, or what a sign or a parenthesis begins."""
        word = self.words.pop(0)
        if word == "(":
            value = self.read_choice()
            require(self.words.pop(0) == ")", "source: parentheses match")
            return value
        if word == "-":
            a = self.read_atom()
            require(not a.clipped, "source: no arithmetic behind a clip")
            return Form({key: -x for key, x in a.terms.items()}, a.error, -a.high, -a.low)
        if word[:1].isdigit():
            x = self.literal(word)
            return Form({"": x} if x else {}, Fraction(0), x, x)
        require(word in self.memory, f"source: {word} is known")
        return self.memory[word]

    def apply(self, sign: str, a: Any, b: Any) -> Any:
        """Return the result of an operation. A missing reading is None, and compares as false."""
        if sign in ("&&", "||"):
            require(isinstance(a, bool) and isinstance(b, bool), "source: truths are known")
            return a and b if sign == "&&" else a or b
        if sign == "<":
            if a is None or b is None or a.low >= b.high:
                return False
            return True if a.high < b.low else [a, b]
        require(a is not None and b is not None, "source: a missing reading is not used")
        require(not a.clipped and not b.clipped, "source: no arithmetic behind a clip")
        if sign in "+-":
            factor = Fraction(1 if sign == "+" else -1)
            names = dict.fromkeys([*a.terms, *b.terms])
            terms = {key: a.terms.get(key, 0) + factor * b.terms.get(key, 0) for key in names}
            exact = a.low == a.high == 0 or b.low == b.high == 0
            return self.round({k: x for k, x in terms.items() if x}, a.error + b.error, exact)
        number, other = (a, b) if sign == "*" and not a.terms.keys() - {""} else (b, a)
        require(number.low == number.high, "source: one factor is a constant")
        factor = number.low if sign == "*" else 1 / number.low
        terms = {key: factor * x for key, x in other.terms.items() if factor}
        return self.round(terms, abs(factor) * other.error, factor == 0)

    def round(self, terms: dict[str, Fraction], error: Fraction, exact: bool) -> Form:
        """Return the form of a result that is rounded to nearest, unless it is exact."""
        low, high = -error, error
        for name, x in terms.items():
            ends = [x * end for end in self.ranges[name]]
            low, high = low + min(ends), high + max(ends)
        size = max(-low, high)
        require(size < 1 << 120, "rounding: no overflow")
        wrong = Fraction(0) if exact else size / (1 << self.bits) + Fraction(1, 1 << self.least)
        return Form(terms, error + wrong, low - wrong, high + wrong)
