"""Strangers and named truths, one log each: the word, what is said of it, and how sure it is."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.identify.logs.names import make
from benchmarks.identify.logs.servo import random_log
from benchmarks.identify.logs.strangers import ALL, STEP

import undeadzone as uz
from further import further
from records import identify_log

TABLE = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))


def answer_to(logs: str, truth: str, seed: int, options: dict[str, Any]) -> uz.Identified:
    """What `identify` makes of a log of a truth."""
    if logs == "strangers":
        log = ALL[truth].make(np.random.default_rng(seed))
        answer = uz.identify(t=STEP, u=log.u, y=log.y, **log.options | options)
        assert isinstance(answer, uz.Identified)
        return answer
    return identify_log(make(seed, truth) if logs == "names" else random_log(seed), **options)


@pytest.mark.parametrize(
    ("logs", "truth", "seed", "options", "words", "said", "odds"),
    [*TABLE["rows"], *further(*map(tuple, TABLE["further"]))],
)
def test_a_log_has_its_name(
    logs: str,
    truth: str,
    seed: int,
    options: dict[str, Any],
    words: list[str],
    said: str,
    odds: list[float],
) -> None:
    answer = answer_to(logs, truth, seed, options)
    numbers = answer.numbers()
    assert answer.verdict in words
    assert re.search(said, " ".join([*answer.answer.reasons, *numbers["remarks"]]))
    assert odds[0] <= max(numbers["odds"].values(), default=0.0) <= odds[1]
    assert answer.verdict not in ("none", "undecided", "unclear") or answer.width is None
