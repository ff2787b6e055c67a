"""What it would gain to weigh colours of the disturbance beside its levels; nothing was adopted.

A bank of each level in two colours: first-order noise, and the same without a constant part.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

import msgspec
import numpy as np

from benchmarks.closed_loops import loop
from benchmarks.markdown import head, row
from undeadzone.observers import Censored, censored
from undeadzone.observers.parts.judged_filter import Member
from undeadzone.observers.parts.model_bank import bank
from undeadzone.scenario.schema import Scenario
from undeadzone.signals.exosystem import Random, Sines, Step, Tone
from undeadzone.support.arrays import Floats
from undeadzone_arena.contest.leaderboard import FRAME, regrets
from undeadzone_arena.contest.methods import METHODS, Method
from undeadzone_arena.contest.trials import score

COUNT = int(os.environ.get("COLOURS", "48"))
WASHOUTS = (4.0, 10.0)  # time constants, in correlation times of the disturbance
TONES = (0.3, 2.0)  # [Hz]
DRAWS = 4000  # bootstrap samples
GUSTS = ("first order", "two tones", "constant")  # of each third loop


def table() -> str:
    """Regret of `censored` and of both banks, and their difference by kind of gust."""
    with both_colours():
        found = regrets(score(entrants(), grounds(), (0,)))
    plain = np.ravel(found["plain"])
    lines = [
        f"## Colours of the disturbance, on {COUNT} random closed loops\n",
        *head("gust", "washout", "median, plain", "both colours", "worst", "", "mean difference"),
    ]
    kinds = {"all": slice(None)} | {name: slice(k, None, 3) for k, name in enumerate(GUSTS)}
    for washout in WASHOUTS:
        both = np.ravel(found[f"both, {washout:g}"])
        for kind, which in kinds.items():
            one, other = plain[which], both[which]
            numbers = (np.median(one), np.median(other), one.max(), other.max())
            cells = [f"{number:.3f}" for number in numbers]
            lines.append(row(kind, f"{washout:g}", *cells, _mean(other - one)))
    note = "Washout in correlation times. Twice the operations of `censored`."
    return "\n".join([*lines, "", note, ""])


def entrants() -> dict[str, Method]:
    """The lines of the regret, `censored`, and with a washout: in both colours."""
    methods = {name: METHODS[name] for name in FRAME} | {"plain": Method(Censored)}
    for washout in WASHOUTS:
        fixed = {"observer.washout_time": 0.3 * washout}
        methods[f"both, {washout:g}"] = Method(Censored, fixed=fixed)
    return methods


def grounds() -> dict[str, Scenario]:
    """Random loops under gusts as claimed, of two tones, and constant ones."""
    made = {}
    for seed in range(COUNT):
        rng = np.random.default_rng(seed)
        scenario = loop(rng)
        assert isinstance(scenario.disturbance, Random)
        rms = float(scenario.disturbance.rms)
        if GUSTS[seed % 3] == "two tones":
            slow = float(np.exp(rng.uniform(*np.log(TONES))))
            tones = [(1.2 * rms, slow), (0.74 * rms, 1.7 * slow)]
            parts = [Tone(amplitude=size, frequency=rate) for size, rate in tones]
            scenario = msgspec.structs.replace(scenario, disturbance=Sines(components=parts))
        if GUSTS[seed % 3] == "constant":
            step = Step(amplitude=rms * float(rng.choice([-1, 1])))
            scenario = msgspec.structs.replace(scenario, disturbance=step)
        made[str(seed)] = scenario
    return made


@contextmanager
def both_colours() -> Iterator[None]:
    """`censored` with a washout weighs every level in both colours."""
    censored.bank = _of_both
    try:
        yield
    finally:
        censored.bank = bank


def _of_both(member: Member, variants: Sequence[Callable[[Any], Any]]) -> Member:
    """The bank of all variants; with a washout, of each in first order too."""
    F = member.params.augmentation.F
    if len(F) == 1:
        return bank(member, variants)
    decay = np.diag(F)
    plain = np.diag(decay), np.diag([1 - decay[0] ** 2, 0.0])
    return bank(member, [*variants, *(partial(_recoloured, plain, one) for one in variants)])


def _recoloured(plain: tuple[Floats, Floats], variant: Callable[[Any], Any], q: Any) -> Any:
    """The numbers of a variant with first-order noise."""
    q = variant(q)
    return q._replace(augmentation=q.augmentation._replace(F=plain[0], Q=plain[1]))


def _mean(gained: Floats) -> str:
    """A mean with its 95 % bootstrap interval."""
    draws = np.random.default_rng(0).choice(gained, (DRAWS, gained.size)).mean(axis=1)
    low, high = np.quantile(draws, [0.025, 0.975])
    return f"{gained.mean():+.4f} [{low:+.4f}, {high:+.4f}]"


if __name__ == "__main__":
    print(table())
