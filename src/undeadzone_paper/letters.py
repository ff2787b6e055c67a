"""The paper's letters beside those of this package, of scenario files and of exported C code."""

from __future__ import annotations

from typing import Final, NamedTuple

from undeadzone_paper.equations import read_words


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


HEAD: Final = ("in the paper", "what it is", "here", "scenario key", "C field")


def read_letters() -> list[Letter]:
    """Read all letters from `letters.toml`."""
    return [Letter(**entry) for entry in read_words("letters.toml")["letter"]]
