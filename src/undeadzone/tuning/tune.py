"""Tuning: the numbers of observer and controller that make a metric small over many runs, judged on others."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np

from undeadzone.analysis.certificate.passivity import certify
from undeadzone.errors import InputError, StructureError, UndeadzoneError
from undeadzone.numerics.optimise import evolve
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.scenario.tune_table import TABLE, Tune
from undeadzone.support.arrays import Floats, scalar
from undeadzone.tuning.objective import Frame, certified_margin, objective
from undeadzone.tuning.parameters import Parameter, numbers, parameters, with_numbers
from undeadzone.tuning.result import Stage, Trial, Tuned, judged

REACH: Final = (
    1 / 256
)  # of a range, to either side: wide enough that a reading which changes its side makes no jump of the slope
GLOBAL: Final = 0.5  # share of the budget for the search of the whole box
PATIENCE: Final = (
    3  # candidates drawn for each that may be simulated, at most: the others lack the certificate
)
WIDE, NARROW = (
    0.25,
    0.03,
)  # first steps of the evolution, as shares of a range: through the box, around the best
FORBIDDEN: Final = (
    1e200  # cost of a candidate without the certificate; one that is refused costs more
)


class Judged(NamedTuple):
    """cost of candidates, inf where one was not simulated; margin of their certificates, inf where none is asked for."""

    cost: Floats
    margin: Floats


Judge = Callable[
    [Floats], Judged
]  # shares of the ranges (candidates x numbers) -> what they are worth


class _SpentError(Exception):
    """The budget is spent."""


def tune(
    scenarios: Scenario | Sequence[Scenario],
    what: Tune | None = None,
    *,
    frames: Sequence[Frame] | None = None,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> Tuned:
    """Tune one scenario, or several at once with the same numbers in each; what: default the [tune] of the first.

    frames: what counts as 0 and as 1 in each scenario, whose mean is made small. Candidates are lanes and meet the same
    runs. Half of the budget searches the box by CMA-ES, Hansen and Ostermeier (2001), or on a grid for a single number.
    Then, for the mean, which is smooth, L-BFGS-B (SLSQP under the certificate) follows gradients whose differences are
    lanes too. What is left goes to CMA-ES around the best, which needs no slope where runs take turns as the median or
    the worst. The same seed gives the same numbers, whatever the threads. progress: told of candidates just tried.
    Raises InputError and its kinds, by key of [tune].
    """
    scenarios = (scenarios,) if isinstance(scenarios, Scenario) else tuple(scenarios)
    what, frames, seed = _checked(scenarios, what, frames)
    found = _parameters(what, scenarios)
    start = np.array([p.share(p.start) for p in found])
    on = objective(
        what,
        scenarios,
        frames,
        [p.name for p in found],
        _values(found, _probes(start)),
        what.runs,
        seed,
    )
    trials: list[Trial] = []

    def judge(u: Floats, stage: Stage, until: float = 1.0) -> Judged:
        points = _values(found, u)
        candidates = on.problems(points)
        margin, cost = on.margins(candidates), np.full(len(u), np.inf)
        allowed = [
            k
            for k, problems in enumerate(candidates)
            if problems is not None and (stage in ("start", "gradient") or margin[k] >= what.margin)
        ]
        if len(trials) + len(allowed) > max(until * what.budget, 1):
            raise _SpentError
        if allowed:
            cost[allowed] = on.costs(
                [problems for k in allowed if (problems := candidates[k]) is not None], threads
            )
        trials.extend(
            Trial(tuple(points[k].tolist()), float(cost[k]), float(margin[k]), stage)
            for k in allowed
        )
        if progress is not None:
            progress(len(allowed))
        return Judged(cost, margin)

    def best() -> Floats:
        return np.array(
            [p.share(value) for p, value in zip(found, _best(what, trials).point, strict=True)]
        )

    judge(start[None], "start")
    with contextlib.suppress(_SpentError):
        _explore(functools.partial(judge, stage="global", until=GLOBAL), what, start, seed)
    with contextlib.suppress(_SpentError):
        if what.statistic == "mean" and not any(p.whole for p in found):
            _descend(
                functools.partial(judge, stage="gradient"),
                what,
                best(),
                abs(_best(what, trials).cost) or 1.0,
            )
    with contextlib.suppress(_SpentError):
        _polish(functools.partial(judge, stage="local"), what, best(), seed)
    return judged(on, found, trials, _best(what, trials), seed, threads)


def gradient(judge: Callable[[Floats], Judged], u: Floats) -> tuple[Judged, Judged]:
    """(what u is worth, its slopes) by differences over REACH to either side within the box [0, 1], all candidates of one call.

    Where a neighbour is refused, u itself stands in for it.
    """
    sides = np.clip(
        u + REACH * np.vstack([np.zeros(u.size), np.eye(u.size), -np.eye(u.size)]), 0.0, 1.0
    )
    worth = judge(sides)
    refused = ~np.isfinite(worth.cost)
    sides[refused] = u
    ahead, behind = np.split(sides[1:], 2)
    reach = np.diagonal(ahead - behind)

    def slopes(values: Floats) -> Floats:
        ahead, behind = np.split(np.where(refused, values[0], values)[1:], 2)
        with np.errstate(invalid="ignore"):
            return np.nan_to_num(
                (ahead - behind) / np.where(reach > 0, reach, np.inf), posinf=0.0, neginf=0.0
            )

    return Judged(worth.cost[:1], worth.margin[:1]), Judged(
        slopes(worth.cost), slopes(worth.margin)
    )


def _explore(judge: Judge, what: Tune, start: Floats, seed: int) -> None:
    """The whole box: a grid for one number, else evolution from the start with wide steps."""
    if start.size == 1:
        judge(np.linspace(0.0, 1.0, _cells(what) + 1)[:, None])
    else:
        _evolve(judge, what, start, seed, WIDE)


def _descend(judge: Judge, what: Tune, start: Floats, size: float) -> None:
    """Down the slope within the box and the certificate; size: of the cost, which is divided by it."""
    from scipy.optimize import minimize

    @functools.cache
    def at(point: bytes) -> tuple[Judged, Judged]:
        return gradient(judge, np.frombuffer(point))

    def cost(u: Floats) -> tuple[float, Floats]:
        worth, slope = at(u.tobytes())
        return min(float(worth.cost[0]) / size, FORBIDDEN), slope.cost / size

    given = {
        "x0": start,
        "jac": True,
        "bounds": [(0.0, 1.0)] * start.size,
        "options": {"ftol": 1e-5},
    }
    if not what.certified:
        minimize(cost, method="L-BFGS-B", **given)
        return
    least = what.margin + 1e-6  # so that rounding does not cost the certificate
    kept = {
        "type": "ineq",
        "fun": lambda u: np.maximum(at(u.tobytes())[0].margin - least, -1e3),
        "jac": lambda u: at(u.tobytes())[1].margin[None],
    }
    minimize(cost, method="SLSQP", constraints=[kept], **given)


def _polish(judge: Judge, what: Tune, best: Floats, seed: int) -> None:
    """Around the best, without slopes: between its neighbours on the grid for one number, else evolution with narrow steps."""
    if best.size > 1:
        _evolve(judge, what, best, seed + 1, NARROW)
        return
    for u in best + np.linspace(-1.0, 1.0, _cells(what) // 2) / _cells(what):
        judge(np.clip([[u]], 0.0, 1.0))


def _cells(what: Tune) -> int:
    """Of the grid over the range of a single number."""
    return max(int(GLOBAL * what.budget) - 2, 1)


def _evolve(judge: Judge, what: Tune, start: Floats, seed: int, spread: float) -> None:
    """Until the budget of this stage is spent; candidates without the certificate are not simulated, which costs nothing of it."""

    def cost(u: Floats) -> Floats:
        found = judge(u)
        return np.where(
            found.margin < what.margin,
            FORBIDDEN * (1 + np.clip(what.margin - found.margin, 0.0, 1e6)),
            found.cost,
        )

    size = 4 + int(3 * np.log(start.size))
    evolve(
        cost,
        np.zeros(start.size),
        np.ones(start.size),
        seed % 2**32,
        size,
        PATIENCE * what.budget // size,
        start,
        spread,
    )


def _best(what: Tune, trials: Sequence[Trial]) -> Trial:
    """The cheapest trial with the certificate; where none has it, that of the largest margin."""
    kept = [trial for trial in trials if trial.margin >= what.margin]
    return (
        min(kept, key=lambda trial: trial.cost)
        if kept
        else max(trials, key=lambda trial: trial.margin)
    )


def _values(found: Sequence[Parameter], u: Floats) -> Floats:
    return np.stack([p.value(u[:, i]) for i, p in enumerate(found)], axis=1)


def _probes(start: Floats) -> Floats:
    """The start; each number alone, and all of them, at places that are no accident: what these move, every candidate moves."""
    places = (0.0, 0.3, 0.7, 1.0)
    alone = [
        np.where(np.arange(start.size) == i, u, start) for i in range(start.size) for u in places
    ]
    return np.vstack([start, *alone, *(np.full(start.size, u) for u in places)])


def _checked(
    scenarios: tuple[Scenario, ...], what: Tune | None, frames: Sequence[Frame] | None
) -> tuple[Tune, Sequence[Frame], int]:
    """(what, frames, seed). Raises InputError."""
    if not scenarios:
        raise InputError("tune: expected at least one scenario, found none")
    what = what or scenarios[0].tune or Tune()
    for key, least in (("runs", 1), ("held_out", 1), ("budget", 4)):
        if getattr(what, key) < least:
            raise InputError(f"tune.{key}: expected {least} or more, found {getattr(what, key)}")
    scalar("tune.margin", what.margin, least=0.0)
    frames = [Frame()] * len(scenarios) if frames is None else frames
    if len(frames) != len(scenarios) or not all(
        np.isfinite(frame).all() and frame.zero < frame.one for frame in frames
    ):
        raise InputError(
            f"frames: expected one for each of {len(scenarios)} scenarios, with zero below one, found {list(frames)!r:.80}"
        )
    vary = scenarios[0].ensemble
    given = scenarios[0].simulation.seed if vary is None or vary.seed is None else vary.seed
    seed = given if what.seed is None else what.seed
    if not 0 <= seed < 2**63 - 1:
        raise InputError(f"tune.seed: expected a whole number, 0 or more, found {seed}")
    return what, frames, seed


def _parameters(what: Tune, scenarios: tuple[Scenario, ...]) -> tuple[Parameter, ...]:
    """What is tuned, in every scenario, from a start that can be run. Raises InputError and its kinds."""
    found = parameters(what.entries, scenarios[0])
    start = {p.name: p.start for p in found}
    for scenario in scenarios:
        resolve_scenario(scenario)
        if missing := start.keys() - numbers(scenario).keys():
            raise InputError(
                f"{TABLE.entry_name(min(missing))}: scenario {scenario.title!r} has no such number"
            )
        try:
            problem = resolve_scenario(with_numbers(scenario, start))
        except UndeadzoneError as error:
            words = ", ".join(f"{name} = {value:g}" for name, value in start.items())
            raise InputError(f"tune: cannot start from {words}: {error}") from None
        if what.certified:
            certified_margin(problem)
            n, p = problem.model.n, problem.model.p
            if reason := certify(
                problem.model.linear, np.zeros((n, p)), np.ones(p), problem.model.Ts
            ).reason:
                raise StructureError(f"tune.certified: no gains can be certified: {reason}")
    return found
