"""What it would gain to weigh colours of the disturbance beside its levels; nothing was adopted.

A bank of each level in two colours: first-order noise, and the same without a constant part. In
slow loops slow gusts with a constant part hide the centre, which is most of what z^ is off by.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

import msgspec
import numpy as np

from benchmarks.arena.regret import RANGE, TOLERANCE, loop
from benchmarks.markdown import head, row
from undeadzone.controllers import StateFeedback
from undeadzone.nonlinearities.sensor import Sensor
from undeadzone.observers import Censored
from undeadzone.observers.filtering import multiple_models
from undeadzone.observers.filtering.consistency import Member
from undeadzone.observers.filtering.multiple_models import build_multiple_models
from undeadzone.observers.filtering.prior import Assumptions
from undeadzone.plants.options import Plant
from undeadzone.scenario.schema import Model, Scenario, Simulation
from undeadzone.signals.exosystem import Random, Sines, Step, Tone
from undeadzone.util.arrays import Floats
from undeadzone_arena.contest.leaderboard import FRAME, compute_regrets
from undeadzone_arena.contest.methods import METHODS, Method
from undeadzone_arena.contest.trials import score_methods

COUNT = int(os.environ.get("COLOURS", "48"))
WASHOUTS = (4.0, 10.0)  # time constants, in correlation times of the disturbance
ALTERNATIVES = ("washout 4", "washout 10", "no bias")
TONES = (0.3, 2.0)  # [Hz]
DRAWS = 4000  # bootstrap samples
GUSTS = ("first order", "two tones", "constant")  # of each third loop
CORRELATION, SLOW = 0.3, 1.0  # of gusts as claimed, in loops and slow loops [s]


def table() -> str:
    """Regret of `censored` and of both banks, and their difference by kind of gust."""
    names = ("gust", "other", "median, plain", "with it", "worst", "", "mean difference")
    lines = [f"## Colours of the disturbance, on {COUNT} random closed loops\n", *head(*names)]
    kinds = {"all": slice(None)} | {name: slice(k, None, 3) for k, name in enumerate(GUSTS)}
    lines += _rows(grounds(), CORRELATION, kinds)
    slow = {str(seed): slow_loop(np.random.default_rng(seed)) for seed in range(COUNT)}
    lines += _rows(slow, SLOW, {"slow": slice(None)})
    note = (
        "Washout: every level in both colours, the time constant in correlation times; twice the "
        "operations of `censored`. No bias: the unknown constant is claimed to be none. Slow: as "
        "many plants of second order at 1 kHz, under two slow tones and a constant."
    )
    return "\n".join([*lines, "", note, ""])


def _rows(grounds: dict[str, Scenario], correlation: float, kinds: dict[str, slice]) -> list[str]:
    """The rows of a family of loops."""
    with both_colours():
        found = compute_regrets(score_methods(entrants(correlation), grounds, (0,)))
    plain, lines = np.ravel(found["plain"]), []
    for other in ALTERNATIVES:
        for kind, which in kinds.items():
            one, two = plain[which], np.ravel(found[other])[which]
            cells = [f"{x:.3f}" for x in (np.median(one), np.median(two), one.max(), two.max())]
            lines.append(row(kind, other, *cells, _mean(two - one)))
    return lines


def entrants(correlation: float) -> dict[str, Method]:
    """The lines of the regret, `censored`, and its alternatives."""
    methods = {name: METHODS[name] for name in FRAME} | {"plain": Method(Censored)}
    for name, washout in zip(ALTERNATIVES, WASHOUTS, strict=False):
        fixed = {"observer.washout_time": correlation * washout}
        methods[name] = Method(Censored, fixed=fixed)
    return methods | {ALTERNATIVES[-1]: Method(Censored, fixed={"observer.bias": 0.0})}


def slow_loop(rng: np.random.Generator) -> Scenario:
    """A slow plant of second order at 1 kHz, under slow gusts with a constant part."""
    rate, damping = rng.uniform(0.5, 1.5), rng.uniform(0.4, 1.5)
    A = np.array([[0.0, 1.0], [-(rate**2), -2 * damping * rate]])
    B = np.array([[0.0], [rate**2]])
    wrong = np.hstack([A, B])
    wrong[-1] *= 1 + TOLERANCE * rng.normal(size=3)
    assumed_rms = float(np.exp(rng.uniform(np.log(0.3), np.log(1.5))))
    right, left = map(float, rng.uniform(*RANGE, 2))
    size, slow = rng.uniform(2.5, 6.0), rng.uniform(0.1, 0.3)
    tones = [(0.8 * size, slow), (0.2 * size, 2.3 * slow)]
    gust = float(np.exp(rng.uniform(np.log(0.05), np.log(0.3))))
    constant = assumed_rms * float(rng.choice([-1, 1]) * rng.uniform(0.2, 0.8))
    return Scenario(
        plant=Plant(A=A.tolist(), B=B.tolist(), C=[[1.0, 0.0]]),
        model=Model(A=wrong[:, :2].tolist(), B=wrong[:, 2:].tolist()),
        sensor=Sensor(right=right, left=left, noise=float(rng.uniform(0.005, 0.1))),
        reference=_sum(tones),
        disturbance=_sum([(assumed_rms, gust), (0.6 * assumed_rms, 1.7 * gust)], constant),
        declared=Assumptions(
            right=list(RANGE), disturbance=assumed_rms, correlation_time=SLOW, tolerance=TOLERANCE
        ),
        controller=StateFeedback(),
        simulation=Simulation(time="sampled", step=1e-3, duration=25.0),
    )


def _sum(tones: Sequence[tuple[float, float]], offset: float = 0.0) -> Sines:
    """Tones (amplitude, frequency [Hz]) about an offset."""
    parts = [Tone(amplitude=float(size), frequency=float(rate)) for size, rate in tones]
    return Sines(components=parts, offset=offset)


def grounds() -> dict[str, Scenario]:
    """Random loops under gusts as claimed, of two tones, and constant ones."""
    scenarios = {}
    for seed in range(COUNT):
        rng = np.random.default_rng(seed)
        scenario = loop(rng)
        assert isinstance(scenario.disturbance, Random)
        rms = float(scenario.disturbance.rms)
        if GUSTS[seed % 3] == "two tones":
            slow = float(np.exp(rng.uniform(*np.log(TONES))))
            tones = _sum([(1.2 * rms, slow), (0.74 * rms, 1.7 * slow)])
            scenario = msgspec.structs.replace(scenario, disturbance=tones)
        if GUSTS[seed % 3] == "constant":
            step = Step(amplitude=rms * float(rng.choice([-1, 1])))
            scenario = msgspec.structs.replace(scenario, disturbance=step)
        scenarios[str(seed)] = scenario
    return scenarios


@contextmanager
def both_colours() -> Iterator[None]:
    """`censored` with a washout weighs every level in both colours."""
    multiple_models.build_multiple_models = _of_both
    try:
        yield
    finally:
        multiple_models.build_multiple_models = build_multiple_models


def _of_both(member: Member, variants: Sequence[Callable[[Any], Any]]) -> Member:
    """The bank of all variants; with a washout, of each in first order too."""
    F = member.params.augmentation.F
    if len(F) == 1:
        return build_multiple_models(member, variants)
    decay = np.diag(F)
    plain = np.diag(decay), np.diag([1 - decay[0] ** 2, 0.0])
    return build_multiple_models(
        member, [*variants, *(partial(_recoloured, plain, one) for one in variants)]
    )


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
