"""Check a proof about the C of an observer in exact fractions, with the standard library alone."""

from __future__ import annotations

import json
import re
import sys
from fractions import Fraction
from pathlib import Path
from typing import Any

from undeadzone_proof.source import Refused, require
from undeadzone_proof.theorem import check_continuous, check_sampled

FAULTS = (LookupError, ValueError, TypeError, ArithmeticError, AttributeError, OSError, SyntaxError)


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
    radius = to_words(proof["set"]["radius"])
    source, bounds = proof["source"], {k: to_words(x) for k, x in proof["bounds"].items()}
    return (
        f"{source['name']}.c in {source['format']} beside {plant}, {to_words(proof['sensor'])}: "
        f"begun by {source['name']}_init with x = {to_words(proof['start'])}, z^ stays within "
        f"{radius} of z, whatever widths up to {to_words(proof['sensor']['width_max'])}, "
        "sequence of sides, missing readings and roundings, while |x| <= "
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
