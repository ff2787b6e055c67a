"""The search for the best numbers: the whole box, then down the slope, then around the best."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator
from typing import Any, Final, Literal, NamedTuple

import numpy as np

from undeadzone.numerics.optimise import evolve
from undeadzone.scenario.tune_table import Tune
from undeadzone.support.answers import Answers
from undeadzone.support.arrays import Floats
from undeadzone.tuning.objective import Objective, Problems
from undeadzone.tuning.parameters import Parameter

# To either side, as a share of a range: wide enough that a reading which changes its side makes no
# jump of the slope.
REACH: Final = 1 / 256
GLOBAL: Final = 0.5  # share of the budget for the search of the whole box
PATIENCE: Final = 3  # candidates drawn for each that may be simulated: others lack the certificate
WIDE: Final = 0.25  # first steps of the evolution through the box, as a share of a range
NARROW: Final = 0.03  # likewise around the best
FORBIDDEN: Final = 1e200  # cost of a candidate without certificate; one refused costs more

Stage = Literal["start", "global", "gradient", "local"]


class SimulatedCandidate(NamedTuple):
    """A candidate that was simulated.

    Attributes:
        point: its numbers
        cost: on the runs tuned on; inf where it was refused
        margin: of its certificate; inf if none was asked for
        stage: of the search that came upon it
    """

    point: tuple[float, ...]
    cost: float
    margin: float
    stage: Stage


class Evaluation(NamedTuple):
    """What candidates are worth, or the slopes of it.

    Attributes:
        cost: of each, inf where one was not simulated
        margin: of their certificates, inf where none is asked for
    """

    cost: Floats
    margin: Floats


Evaluate = Callable[[Floats], Evaluation]  # of shares of the ranges (candidates x numbers)


class BudgetSpentError(Exception):
    """The budget is spent."""


class Search(NamedTuple):
    """A search under way.

    Attributes:
        objective: what is to be made small
        parameters: what is tuned
        candidates: those simulated so far, in order; the list grows
        threads: default one per processor
        progress: called with the number of candidates just simulated
        kept: what candidates of an earlier run cost, on disk; None: nothing is kept
    """

    objective: Objective
    parameters: tuple[Parameter, ...]
    candidates: list[SimulatedCandidate]
    threads: int | None
    progress: Callable[[int], None] | None
    kept: Answers | None = None

    @property
    def what(self) -> Tune:
        """The table [tune]."""
        return self.objective.what

    @property
    def best(self) -> SimulatedCandidate:
        """The cheapest candidate with the certificate, else that of the largest margin."""
        certified = [each for each in self.candidates if each.margin >= self.what.margin]
        if certified:
            return min(certified, key=lambda candidate: candidate.cost)
        return max(self.candidates, key=lambda candidate: candidate.margin)

    @property
    def best_shares(self) -> Floats:
        """Where the best candidate lies in the ranges."""
        pairs = zip(self.parameters, self.best.point, strict=True)
        return np.array([parameter.share(value) for parameter, value in pairs])

    def evaluate(self, u: Floats, stage: Stage, until: float = 1.0) -> Evaluation:
        """What candidates are worth; those that may be simulated are, and are kept.

        Args:
            u: shares of the ranges (candidates x numbers)
            stage: of the search
            until: share of the budget that this stage may spend up to

        Raises:
            BudgetSpentError: before anything is simulated
        """
        points = values_at(self.parameters, u)
        problems = self.objective.problems(points)
        margin = self.objective.margins(problems)
        cost = np.full(len(u), np.inf)
        chosen, possible = [], []
        for k, each in enumerate(problems):
            enough = stage in ("start", "gradient") or margin[k] >= self.what.margin
            if each is not None and enough:
                chosen.append(k)
                possible.append(each)
        if len(self.candidates) + len(chosen) > max(until * self.what.budget, 1):
            raise BudgetSpentError
        if chosen:
            cost[chosen] = self._costs(points[chosen], possible)
        for k in chosen:
            point = tuple(points[k].tolist())
            self.candidates.append(
                SimulatedCandidate(point, float(cost[k]), float(margin[k]), stage)
            )
        if self.progress is not None:
            self.progress(len(chosen))
        return Evaluation(cost, margin)

    def _costs(self, points: Floats, problems: list[Problems]) -> Floats:
        """What candidates cost, computed or kept."""
        if self.kept is None:
            return self.objective.costs(problems, self.threads)

        def compute(missing: list[int]) -> Iterator[tuple[int, float]]:
            wanted = [problems[k] for k in missing]
            costs = self.objective.costs(wanted, self.threads)
            yield from zip(missing, costs.tolist(), strict=True)

        return np.array(self.kept.of(points.tolist(), compute))

    def run(self, start: Floats, seed: int) -> None:
        """Spend the budget from a start, given as shares of the ranges."""
        what = self.what
        self.evaluate(start[None], "start")
        with contextlib.suppress(BudgetSpentError):
            explore = functools.partial(self.evaluate, stage="global", until=GLOBAL)
            _explore(explore, what, start, seed)
        with contextlib.suppress(BudgetSpentError):
            if what.statistic == "mean" and not any(p.whole for p in self.parameters):
                descend = functools.partial(self.evaluate, stage="gradient")
                _descend(descend, what, self.best_shares, abs(self.best.cost) or 1.0)
        with contextlib.suppress(BudgetSpentError):
            polish = functools.partial(self.evaluate, stage="local")
            _polish(polish, what, self.best_shares, seed)


def values_at(parameters: tuple[Parameter, ...], u: Floats) -> Floats:
    """The numbers of candidates at shares u of the ranges (candidates x numbers)."""
    return np.stack([p.value(u[:, i]) for i, p in enumerate(parameters)], axis=1)


def gradient(evaluate: Evaluate, u: Floats) -> tuple[Evaluation, Evaluation]:
    """(what u is worth, its slopes) by differences over REACH to either side within the box [0, 1].

    All candidates are evaluated in one call. Where a neighbour is refused, u itself stands in for
    it.
    """
    shifts = REACH * np.vstack([np.zeros(u.size), np.eye(u.size), -np.eye(u.size)])
    sides = np.clip(u + shifts, 0.0, 1.0)
    worth = evaluate(sides)
    refused = ~np.isfinite(worth.cost)
    sides[refused] = u
    ahead, behind = np.split(sides[1:], 2)
    reach = np.diagonal(ahead - behind)
    cost = _slopes(worth.cost, refused, reach)
    margin = _slopes(worth.margin, refused, reach)
    return Evaluation(worth.cost[:1], worth.margin[:1]), Evaluation(cost, margin)


def _slopes(values: Floats, refused: Floats, reach: Floats) -> Floats:
    """The slopes of values at u, ahead of it and behind it (1 + 2 d); 0 where `reach` (d) is 0."""
    ahead, behind = np.split(np.where(refused, values[0], values)[1:], 2)
    with np.errstate(invalid="ignore"):
        slopes = (ahead - behind) / np.where(reach > 0, reach, np.inf)
        return np.nan_to_num(slopes, posinf=0.0, neginf=0.0)


def _explore(evaluate: Evaluate, what: Tune, start: Floats, seed: int) -> None:
    """The whole box: a grid for one number, else evolution from the start with wide steps."""
    if start.size == 1:
        evaluate(np.linspace(0.0, 1.0, _cells(what) + 1)[:, None])
    else:
        _evolve(evaluate, what, start, seed, WIDE)


def _descend(evaluate: Evaluate, what: Tune, start: Floats, size: float) -> None:
    """Down the slope within the box and the certificate; size: of the cost, which it divides."""
    from scipy.optimize import minimize

    least = what.margin + 1e-6  # so that rounding does not cost the certificate

    @functools.cache
    def at(point: bytes) -> tuple[Evaluation, Evaluation]:
        return gradient(evaluate, np.frombuffer(point))

    def cost(u: Floats) -> tuple[float, Floats]:
        worth, slopes = at(u.tobytes())
        return min(float(worth.cost[0]) / size, FORBIDDEN), slopes.cost / size

    def spare_margin(u: Floats) -> Floats:
        worth, _ = at(u.tobytes())
        return np.maximum(worth.margin - least, -1e3)

    def margin_slopes(u: Floats) -> Floats:
        _, slopes = at(u.tobytes())
        return slopes.margin[None]

    options: dict[str, Any] = {
        "x0": start,
        "jac": True,
        "bounds": [(0.0, 1.0)] * start.size,
        "options": {"ftol": 1e-5},
    }
    if not what.certified:
        minimize(cost, method="L-BFGS-B", **options)
        return
    certificate = {"type": "ineq", "fun": spare_margin, "jac": margin_slopes}
    minimize(cost, method="SLSQP", constraints=[certificate], **options)


def _polish(evaluate: Evaluate, what: Tune, best: Floats, seed: int) -> None:
    """Around the best, without slopes: between its neighbours on the grid, or by evolution.

    The former is for one number, the latter takes narrow steps.
    """
    if best.size > 1:
        _evolve(evaluate, what, best, seed + 1, NARROW)
        return
    cells = _cells(what)
    for u in best + np.linspace(-1.0, 1.0, cells // 2) / cells:
        evaluate(np.clip([[u]], 0.0, 1.0))


def _cells(what: Tune) -> int:
    """The cells of the grid over the range of a single number."""
    return max(int(GLOBAL * what.budget) - 2, 1)


def _evolve(evaluate: Evaluate, what: Tune, start: Floats, seed: int, spread: float) -> None:
    """Evolution until the budget of this stage is spent; spread: of its first steps.

    Candidates without the certificate are not simulated, which costs nothing of the budget.
    """

    def cost(u: Floats) -> Floats:
        return _penalised(evaluate(u), what.margin)

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


def _penalised(worth: Evaluation, least: float) -> Floats:
    """The cost of candidates; beyond FORBIDDEN by the lack of margin, for those that lack it."""
    lack = np.clip(least - worth.margin, 0.0, 1e6)
    return np.where(worth.margin < least, FORBIDDEN * (1 + lack), worth.cost)
