"""A reader of Structured Text, by the grammar of IEC 61131-3, which makes C of it.

It takes what an export prints and refuses everything else: every name is declared, once whatever
its capitals, and is no reserved word; types agree without conversion; inputs are not assigned.
Nothing here knows how the text was made.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

# Keywords, types and standard functions and blocks, which no name may be (tables 1, 10, 22 to 37).
WORDS = """
abs acos action add and any any_bit any_date any_int any_num any_real array asin at atan bool by
byte case concat configuration constant cos ctd ctu ctud date date_and_time delete dint div do dt
dword else elsif en end_action end_case end_configuration end_for end_function end_function_block
end_if end_program end_repeat end_resource end_step end_struct end_transition end_type end_var
end_while eno eq exit exp expt f_edge f_trig false find for from function function_block ge gt if
initial_step insert int ld le left len limit lint ln log lreal lt lword max mid min mod move mul mux
ne non_retain not of on or priority program r_edge r_trig read_only read_write real repeat replace
resource retain return right rol ror rs sel sema shl shr sin single sint sqrt sr st step string
struct sub tan task then time time_of_day to tod tof ton tp transition true trunc type udint uint
ulint until usint var var_access var_config var_external var_global var_in_out var_input var_output
var_temp while with word wstring xor
"""
RESERVED = frozenset(WORDS.split())
TYPES = {"REAL": "float", "LREAL": "double", "BOOL": "_Bool", "INT": "short"}
REALS = ("REAL", "LREAL")
TOKEN = re.compile(
    r"""\s+|\(\*.*?\*\)|(?P<real>L?REAL\#\d+\.\d+(?:E[+-]?\d+)?)|(?P<range>\d+\.\.\d+)
    |(?P<plain>\d+\.\d+(?:E[+-]?\d+)?)|(?P<int>\d+)
    |(?P<name>[A-Za-z_]\w*)|(?P<sign>:=|<>|<=|>=|[-+*/<>=()\[\],;:.])""",
    re.VERBOSE | re.DOTALL,
)
SECTIONS = {"VAR_INPUT": "input", "VAR_OUTPUT": "output", "VAR": "local"}


class Refused(Exception):
    """The text is not Structured Text as an export may print it."""


@dataclass
class Variable:
    """A declared variable: its name as written, its type, its section, how many entries."""

    name: str
    kind: str
    section: str
    size: int = 0
    start: list[str] = field(default_factory=list)


@dataclass
class Unit:
    """A unit: its keyword, its name as written, what it returns, its variables in small letters."""

    keyword: str
    name: str
    returns: str = ""
    variables: dict[str, Variable] = field(default_factory=dict)
    body: list[str] = field(default_factory=list)


def tokens_of(text: str) -> list[tuple[str, str]]:
    """(what it is, its text) of each token; comments and blanks are left out."""
    found, place = [], 0
    while place < len(text):
        match = TOKEN.match(text, place)
        if match is None:
            raise Refused(f"no token: {text[place : place + 40]!r}")
        if match.lastgroup is not None:
            found.append((match.lastgroup, match.group()))
        place = match.end()
    return [*found, ("end", "")]


class Reader:
    """Units of a text, and C of them.

    Args:
        text: the Structured Text.
        wide: the type in which expressions of REAL are computed; empty: float itself.
    """

    def __init__(self, text: str, wide: str = "") -> None:
        self.tokens, self.place, self.wide = tokens_of(text), 0, wide
        self.units: dict[str, Unit] = {}
        while self.tokens[self.place][0] != "end":
            self.read_unit()

    # --- Tokens

    def at(self, *words: str) -> bool:
        return self.tokens[self.place][1].upper() in words

    def next(self) -> str:
        self.place += 1
        return self.tokens[self.place - 1][1]

    def expect(self, word: str) -> str:
        if not self.at(word):
            near = " ".join(text for _, text in self.tokens[self.place - 5 : self.place + 5])
            raise Refused(f"expected {word}, near {near!r}")
        return self.next()

    def new_name(self) -> str:
        what, text = self.tokens[self.place]
        plain = what == "name" and "__" not in text and not text.endswith("_")
        if not plain or text.lower() in RESERVED:
            raise Refused(f"no name: {text!r}")
        return self.next()

    # --- Declarations

    def read_unit(self) -> None:
        keyword = self.next().upper()
        if keyword not in ("FUNCTION", "FUNCTION_BLOCK", "PROGRAM"):
            raise Refused(f"no unit begins with {keyword!r}")
        unit = Unit(keyword, self.new_name())
        if unit.name.lower() in self.units:
            raise Refused(f"{unit.name}: twice")
        if keyword == "FUNCTION":
            self.expect(":")
            unit.returns = self.elementary()
            unit.variables[unit.name.lower()] = Variable(unit.name, unit.returns, "result")
        while self.at(*SECTIONS):
            section = SECTIONS[self.next().upper()]
            while not self.at("END_VAR"):
                self.read_variable(unit, section)
            self.next()
        unit.body = self.statements(unit, f"END_{keyword}")
        self.expect(f"END_{keyword}")
        self.units[unit.name.lower()] = unit

    def elementary(self) -> str:
        kind = self.next().upper()
        if kind not in TYPES:
            raise Refused(f"no type: {kind}")
        return kind

    def read_variable(self, unit: Unit, section: str) -> None:
        names = [self.new_name()]
        while self.at(","):
            self.next()
            names.append(self.new_name())
        self.expect(":")
        size = 0
        if self.at("ARRAY"):
            self.next()
            self.expect("[")
            low, high = self.next().split("..")
            assert low == "0"
            size = int(high) + 1
            self.expect("]")
            self.expect("OF")
        if self.tokens[self.place][1].lower() in self.units:
            kind = self.next().lower()
            if self.units[kind].keyword != "FUNCTION_BLOCK":
                raise Refused(f"{kind} is no function block")
        else:
            kind = self.elementary()
        start = []
        if self.at(":="):
            self.next()
            start = self.start_of(Variable("", kind, section, size))
        self.expect(";")
        for name in names:
            if name.lower() in (*unit.variables, *self.units):
                raise Refused(f"{name}: twice in {unit.name}")
            unit.variables[name.lower()] = Variable(name, kind, section, size, start)

    def start_of(self, variable: Variable) -> list[str]:
        if not variable.size:
            return [self.constant(variable.kind)]
        self.expect("[")
        values = [self.constant(variable.kind)]
        while self.at(","):
            self.next()
            values.append(self.constant(variable.kind))
        self.expect("]")
        if len(values) != variable.size:
            raise Refused(f"{variable.name}: {len(values)} values for {variable.size}")
        return values

    def constant(self, kind: str) -> str:
        """A constant of a declaration: nothing is computed there."""
        sign = self.next() if self.at("-") else ""
        what, text = self.tokens[self.place]
        self.next()
        if kind == "BOOL" and text.upper() in ("TRUE", "FALSE") and not sign:
            return str(int(text.upper() == "TRUE"))
        if kind not in REALS or what != "plain":
            raise Refused(f"{sign}{text} is no {kind}")
        return f"{sign}{text}{'f' if kind == 'REAL' else ''}"

    # --- Statements

    def statements(self, unit: Unit, *ends: str) -> list[str]:
        lines = []
        while not self.at(*ends):
            lines += self.statement(unit)
        return lines

    def statement(self, unit: Unit) -> list[str]:
        if self.at("IF"):
            return self.choice(unit)
        what, text = self.tokens[self.place]
        variable = unit.variables.get(text.lower())
        if what != "name" or variable is None:
            raise Refused(f"{unit.name}: {text!r} is not declared")
        if variable.kind in self.units:
            return self.call_of_block(unit, variable)
        self.next()
        if variable.section == "input":
            raise Refused(f"{unit.name}: the input {text} is assigned")
        self.expect(":=")
        value = self.typed(unit, variable.kind)
        self.expect(";")
        return [f"{self.variable(unit, variable)} = {self.stored(value, variable.kind)};"]

    def choice(self, unit: Unit) -> list[str]:
        lines, word = [], "if"
        while self.at("IF", "ELSIF"):
            self.next()
            lines.append(f"{word} ({self.typed(unit, 'BOOL')}) {{")
            self.expect("THEN")
            lines += [*self.statements(unit, "ELSIF", "ELSE", "END_IF"), "}"]
            word = "else if"
        if self.at("ELSE"):
            self.next()
            lines += ["else {", *self.statements(unit, "END_IF"), "}"]
        self.expect("END_IF")
        self.expect(";")
        return lines

    def call_of_block(self, unit: Unit, instance: Variable) -> list[str]:
        self.next()
        self.expect("(")
        block, lines = self.units[instance.kind], []
        while not self.at(")"):
            given = block.variables.get(self.next().lower())
            if given is None or given.section != "input":
                raise Refused(f"{block.name} has no such input")
            self.expect(":=")
            value = self.stored(self.typed(unit, given.kind), given.kind)
            lines.append(f"{self.variable(unit, instance)}.{given.name.lower()} = {value};")
            if not self.at(")"):
                self.expect(",")
        self.next()
        self.expect(";")
        return [*lines, f"{block.name.lower()}_body(&{self.variable(unit, instance)});"]

    # --- Expressions, by rising precedence: (C, type)

    def typed(self, unit: Unit, kind: str) -> str:
        text, found = self.disjunction(unit)
        if found != kind:
            raise Refused(f"{unit.name}: {found} in place of {kind}: {text[:80]}")
        return text

    def stored(self, text: str, kind: str) -> str:
        return f"(float)({text})" if kind == "REAL" and self.wide else text

    def variable(self, unit: Unit, variable: Variable) -> str:
        inside = unit.keyword == "FUNCTION"
        return variable.name.lower() if inside else f"self->{variable.name.lower()}"

    def disjunction(self, unit: Unit) -> tuple[str, str]:
        return self.chain(unit, 0)

    LEVELS = (
        (("OR",), "BOOL", {"OR": "||"}),
        (("XOR",), "BOOL", {"XOR": "!="}),
        (("AND",), "BOOL", {"AND": "&&"}),
        (("=", "<>"), "ANY", {"=": "==", "<>": "!="}),
        (("<", ">", "<=", ">="), "ANY", {}),
        (("+", "-"), "NUMBER", {}),
        (("*", "/"), "NUMBER", {}),
    )

    def chain(self, unit: Unit, level: int) -> tuple[str, str]:
        """Operators of one level, from the left."""
        if level == len(self.LEVELS):
            return self.unary(unit)
        signs, takes, in_c = self.LEVELS[level]
        text, kind = self.chain(unit, level + 1)
        while self.at(*signs):
            sign = self.next().upper()
            other, its = self.chain(unit, level + 1)
            allowed = {"BOOL": ("BOOL",), "NUMBER": (*REALS, "INT"), "ANY": (*REALS, "INT", "BOOL")}
            if its != kind or kind not in allowed[takes]:
                raise Refused(f"{unit.name}: {kind} {sign} {its}: {text[:60]}")
            text = f"({text} {in_c.get(sign, sign)} {other})"
            kind = "BOOL" if takes == "ANY" else kind
        return text, kind

    def unary(self, unit: Unit) -> tuple[str, str]:
        if self.at("-"):
            self.next()
            text, kind = self.primary(unit)
            if kind not in REALS:
                raise Refused(f"-{kind}")
            return f"(-{text})", kind
        if self.at("NOT"):
            self.next()
            text, kind = self.primary(unit)
            if kind != "BOOL":
                raise Refused(f"NOT {kind}")
            return f"(!{text})", kind
        return self.primary(unit)

    def primary(self, unit: Unit) -> tuple[str, str]:
        what, text = self.tokens[self.place]
        self.next()
        if what == "real":
            kind, _, digits = text.partition("#")
            number = f"{digits}f" if kind == "REAL" else digits
            return (f"(({self.wide}){number})" if kind == "REAL" and self.wide else number), kind
        if what == "int":
            return text, "INT"
        if text == "(":
            inner, kind = self.disjunction(unit)
            self.expect(")")
            return f"({inner})", kind
        if text.upper() in ("TRUE", "FALSE"):
            return str(int(text.upper() == "TRUE")), "BOOL"
        if self.at("("):
            return self.call(unit, text)
        variable = unit.variables.get(text.lower())
        if what != "name" or variable is None:
            raise Refused(f"{unit.name}: {text!r} is not declared")
        return self.value_of(unit, variable)

    def value_of(self, unit: Unit, variable: Variable) -> tuple[str, str]:
        name, kind = self.variable(unit, variable), variable.kind
        if kind in self.units:
            self.expect(".")
            inner = self.units[kind].variables.get(self.next().lower())
            if inner is None or inner.section != "output":
                raise Refused(f"{kind} has no such output")
            name, kind = f"{name}.{inner.name.lower()}", inner.kind
        elif variable.size:
            self.expect("[")
            name = f"{name}[{self.typed(unit, 'INT')}]"
            self.expect("]")
        return (f"(({self.wide}){name})" if kind == "REAL" and self.wide else name), kind

    def call(self, unit: Unit, name: str) -> tuple[str, str]:
        self.next()
        given = [self.disjunction(unit)]
        while self.at(","):
            self.next()
            given.append(self.disjunction(unit))
        self.expect(")")
        if name.upper() == "SQRT":
            ((text, kind),) = given
            if kind not in REALS:
                raise Refused(f"SQRT of {kind}")
            narrow = kind == "REAL" and not self.wide
            return f"{'sqrtf' if narrow else 'sqrt'}({text})", kind
        function = self.units.get(name.lower())
        if function is None or function.keyword != "FUNCTION":
            raise Refused(f"{unit.name}: no function {name}")
        inputs = [each for each in function.variables.values() if each.section == "input"]
        if [each.kind for each in inputs] != [kind for _, kind in given]:
            raise Refused(f"{unit.name}: arguments of {name}")
        texts = [self.stored(text, kind) for text, kind in given]
        return f"{function.name.lower()}({', '.join(texts)})", function.returns

    # --- C

    def c(self) -> str:
        """The C of all units: NAME_body(&instance), NAME_init(&instance) of a block."""
        parts = ["#include <math.h>"]
        for name, unit in self.units.items():
            parts.append(_function(unit) if unit.keyword == "FUNCTION" else _block(name, unit))
        return "\n".join(parts)


def _function(unit: Unit) -> str:
    """A function of C."""
    known = unit.variables.values()
    given = ", ".join(f"{TYPES[v.kind]} {v.name.lower()}" for v in known if v.section == "input")
    own = [f"{TYPES[v.kind]} {v.name.lower()} = 0;" for v in known if v.section != "input"]
    name = unit.name.lower()
    # the result is a variable of the function's name, and so is a local beside the function
    body = [re.sub(rf"\b{name}\b(?! *\()", f"{name}_is", line) for line in [*own, *unit.body]]
    head = f"static {TYPES[unit.returns]} {name}({given})"
    return "\n".join([head, "{", *body, f"return {name}_is;", "}"])


def _block(name: str, unit: Unit) -> str:
    """A struct of C and its functions."""
    fields, starts = [], []
    for key, variable in unit.variables.items():
        kind = TYPES.get(variable.kind, variable.kind)
        fields.append(f"{kind} {key}{f'[{variable.size}]' if variable.size else ''};")
        if variable.kind not in TYPES:
            starts.append(f"{variable.kind}_init(&self->{key});")
        for place, value in enumerate(variable.start):
            entry = f"[{place}]" if variable.size else ""
            starts.append(f"self->{key}{entry} = {value};")
    return "\n".join(
        [
            "typedef struct {", *fields, f"}} {name};",
            f"static void {name}_init({name} *self) {{", "(void)self;", *starts, "}",
            f"static void {name}_body({name} *self) {{", *unit.body, "}",
        ]
    )  # fmt: skip
