"""The C of an observer, read as what it computes: forms, whose errors grow with each rounding."""

from __future__ import annotations

import re
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from undeadzone_proof.exact import ZERO, Refused, require

TOKEN = re.compile(r"(\d[\d.]*(?:e[+-]?\d{1,3})?f?)|([a-z]\w*(?:->\w+\[\d+\])?)|(&&|\|\||\S)")
PYTHON = dict(zip(["(", "?", ":", "&&", "||", *")<+-*/"], ["pick(", *",,&|)<+-*/"], strict=True))
FORMATS = {"double": (53, 1074, ""), "float": (24, 149, "f")}  # bits, least exponent, suffix
GUARDS = ("STDC FP_CONTRACT OFF", 'GCC optimize("fp-contract=off")', "defined(__FAST_MATH__)")
PLAIN = r"(#(if|elif|endif|error|pragma|include)\b.*)?"  # a line beside the functions


@dataclass(frozen=True, eq=False)
class Clipped:
    """Number of the C: a sum of `terms` up to `error`, moved to `low` to `high`."""

    code: Code
    terms: dict[str, Fraction]
    error: Fraction
    low: Fraction
    high: Fraction


class Form(Clipped):
    """Number of the C: a sum of `terms` up to `error`. Operations round to nearest."""

    def __add__(self, other: Form) -> Form:
        """Return the rounded sum. 0 adds nothing, exactly."""
        names = self.terms | other.terms
        terms = {key: self.terms.get(key, ZERO) + other.terms.get(key, ZERO) for key in names}
        exact = self.low == self.high == 0 or other.low == other.high == 0
        ends = self.low + other.low, self.high + other.high
        return self.code.make_form(terms, self.error + other.error, *ends, exact)

    def __neg__(self) -> Form:
        """Return the negative, exactly."""
        terms = {key: -x for key, x in self.terms.items()}
        return Form(self.code, terms, self.error, -self.high, -self.low)

    def __sub__(self, other: Form) -> Form:
        """Return the rounded difference."""
        return self + -other

    def __mul__(self, other: Form) -> Form:
        """Return the rounded product with a constant."""
        factor, form = (self, other) if self.low == self.high else (other, self)
        x = factor.low
        require(x == factor.high, "source: one factor is a constant")
        terms = {key: x * each for key, each in form.terms.items()}
        low, high = sorted((x * form.low, x * form.high))
        return self.code.make_form(terms, abs(x) * form.error, low, high, not x)

    def __truediv__(self, other: Form) -> Form:
        """Return the rounded quotient by a constant."""
        return self * Form(self.code, {}, ZERO, 1 / other.low, 1 / other.high)

    def __lt__(self, other: Clipped) -> Any:
        """Return whether it is less: a truth, or both if that is open. NaN is not."""
        if self.high < other.low or not self.low < other.high:
            return self.high < other.low
        return self, other


class Code:
    """Functions of the C by name, as statements, and its constants in order."""

    def __init__(self, texts: list[str], name: str, kind: str, widest: Fraction) -> None:
        """Read C and header.

        Raises Refused unless they have an observer in a format, and nothing else.
        """
        self.bits, self.least, self.suffix = FORMATS[kind]
        self.widest = widest
        text, header = (re.sub(r"/\*.*?\*/", "", each, flags=re.DOTALL) for each in texts)
        macros = re.findall(r"#\s*define\s+(\w+)", header)
        require(all(each.startswith(name.upper()) for each in macros), "source: no foreign macros")
        require({kind} == {*re.findall(r"(\w+) \w+\[\d+\];", header)}, "source: one format")
        require(all(guard in text for guard in GUARDS), "source: neither fused nor fast arithmetic")
        function = re.compile(rf"^void {name}_(\w+)\([^)]*\)\n{{\n(.*?)\n}}$", re.DOTALL | re.M)
        first = text.index(f"\nvoid {name}_")
        require(text.rindex("#endif") < first, "source: conditions end before functions")
        rest = function.sub("", text).splitlines()
        require(all(re.fullmatch(PLAIN, line) for line in rest), "source: functions alone")
        self.bodies: dict[str, list[str]] = {}
        for key, body in function.findall(text):
            require(key not in self.bodies, "source: each function once")
            self.bodies[key] = [" ".join(line.split()) for line in body.split(";")[:-1]]
        words = TOKEN.findall(" ".join(map(" ".join, self.bodies.values())))
        self.numbers = {word: self.make_number(word) for word, *_ in words if word}
        self.constants = [self.numbers[word].low for word, *_ in words if word]
        self.steps = {key: list(map(self.translate, body)) for key, body in self.bodies.items()}

    def make_number(self, text: str) -> Form:
        """Return the number nearest to a literal, as a compiler takes it."""
        require(text.endswith("f") == bool(self.suffix), f"source: {text} has the format")
        x = Fraction(text.removesuffix("f"))
        e = x.numerator.bit_length() - x.denominator.bit_length()
        unit = Fraction(2) ** max(e - (x < Fraction(2) ** e) + 1 - self.bits, -self.least)
        x = round(x / unit) * unit
        return Form(self, {"": x} if x else {}, ZERO, x, x)

    def make_form(
        self,
        terms: dict[str, Fraction],
        error: Fraction,
        low: Fraction,
        high: Fraction,
        exact: bool,
    ) -> Form:
        """Return the form of a result from `low` to `high`, rounded unless it is exact."""
        size = max(-low, high)
        require(size < 1 << 120, "rounding: no overflow, and no missing reading is used")
        wrong = ZERO if exact else size / (1 << self.bits) + Fraction(1, 1 << self.least)
        kept = {key: x for key, x in terms.items() if x}
        return Form(self, kept, error + wrong, low - wrong, high + wrong)

    def pick_option(self, truth: Any, *options: Clipped) -> Any:
        """Return an expression, or the option that a truth picks.

        An open truth must be one of a clip by a constant that leaves true widths alone.
        """
        if not options or isinstance(truth, bool):
            return options[not truth] if options else truth
        require({*truth} == {*options}, "source: choices are known, or clips")
        end, moved = sorted(options, key=lambda each: each.low < each.high)
        least = options == truth
        require(end.low == end.high, "source: a clip has a constant end")
        require(
            end.low >= self.widest if least else end.low <= 0, "source: clips spare true widths"
        )
        nearer = min if least else max
        low, high = (nearer(each, end.low) for each in (moved.low, moved.high))
        return Clipped(self, moved.terms, moved.error, low, high)

    def translate(self, line: str) -> tuple[str, Any]:
        """Return what a statement assigns and the code of its value, or the function it calls."""
        call = re.fullmatch(r"\w+_(estimate|advance)\(state, in(, out)?\)", line)
        made = re.fullmatch(r"(?:const (?:bool|float|double) )?(\w+(?:->\w+\[\d+\])?) = (.*)", line)
        if call or line == "(void)in":
            return call[1] if call else "", None
        if made is None or re.search("<[^()]*<", line):
            raise Refused(f"source: {line} is understood")
        parts = []
        for number, word, sign in TOKEN.findall(made[2]):
            require(not sign or sign in PYTHON, f"source: {line} is understood")
            parts.append(PYTHON[sign] if sign else f"m[{number or word!r}]")
        try:
            return made[1], compile(f"pick({''.join(parts)})", line, "eval")
        except SyntaxError:
            raise Refused(f"source: {line} is understood") from None

    def run_function(self, name: str, memory: dict[str, Any]) -> None:
        """Run a function on forms by their names in the C, in which its results go."""
        memory |= self.numbers
        for target, value in self.steps[name]:
            if value is not None:
                words = {"__builtins__": {}, "m": memory, "pick": self.pick_option}
                memory[target] = eval(value, words)
            elif target:
                self.run_function(target, memory)
