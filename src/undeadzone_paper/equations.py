"""The paper's equations (1)-(42), figures 1-8, assumptions and letters, in words.

The words stand in `equations.toml` and `letters.toml`.

The paper's claims about them stand in `claims.toml`, and only there.
"""

from __future__ import annotations

from typing import Any, Final, Literal, NamedTuple

from undeadzone.util.files import read_table

Status = Literal["as printed", "corrected", "not used"]


class Equation(NamedTuple):
    """One equation of the paper.

    Attributes:
        number: its number
        what: its meaning
        where: the object of this package that holds it, or computes it
        status: whether it is used as printed, corrected, or not at all (but computed)
        reason: why
        compares: its two sides, in words
    """

    number: int
    what: str
    where: str
    status: Status
    reason: str
    compares: str


class Letter(NamedTuple):
    """One letter of the paper. `letters.toml` explains each entry.

    Attributes:
        paper: the letter
        meaning: its meaning, and its place
        ours: what this package calls it
        key: of the scenario
        c: field of the exported C code
    """

    paper: str
    meaning: str
    ours: str
    key: str
    c: str


def read_words(name: str) -> dict[str, Any]:
    """Read a file of words that lies beside this one."""
    return read_table(__file__, name)


def _by_number(words: dict[str, str]) -> dict[int, str]:
    """Return words by their number."""
    return {int(number): text for number, text in words.items()}


_WORDS: Final = read_words("equations.toml")
ASSUMPTIONS, DIAGRAMS, FIGURES = (
    _by_number(_WORDS[name]) for name in ("assumptions", "diagrams", "figures")
)
STAND_INS: Final = _WORDS["stand_ins"]
"""What stands in for printed shapes that do not agree, by equation."""
EQUATIONS: Final = tuple(Equation(**entry) for entry in _WORDS["equations"])

LETTERS_HEAD: Final = ("in the paper", "what it is", "here", "scenario key", "C field")


def read_letters() -> list[Letter]:
    """Read all letters from `letters.toml`."""
    return [Letter(**entry) for entry in read_words("letters.toml")["letter"]]
