"""Search for the parameters of observer and controller that minimise a metric over many runs.

The search has three stages: global in the box of allowed values, along the gradient, and local
around the best candidate. Points are shares of the allowed ranges, from 0 to 1.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import chain, product
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from undeadzone.errors import InputError
from undeadzone.numerics.optimise import minimise_by_cmaes
from undeadzone.scenario.address import find_option_numbers
from undeadzone.scenario.reader import digests
from undeadzone.scenario.schema import Scenario
from undeadzone.scenario.tune_table import Tune
from undeadzone.util import toml
from undeadzone.util.answers import MemoryAnswers, open_answers
from undeadzone.util.arrays import Floats, require_number, require_seed, require_series
from undeadzone.util.progress import notebook_progress
from undeadzone_studies.tuning.candidates import Frame, Objective, Problems
from undeadzone_studies.tuning.parameters import (
    Parameter,
    fill_default_gains,
    numbers_of_address,
    require_parameters,
    values_at_shares,
)
from undeadzone_studies.tuning.result import SimulatedCandidate, Tuned, choose_best, validate_best

PLACES: Final = (0.0, 0.3, 0.7, 1.0)  # shares of a range at which a scenario is probed first
# Step of the differences, as a share of a range. It is so wide that readings which change branch
# between two points cause no discontinuity of the slope.
REACH: Final = 1 / 256
GLOBAL: Final = 0.5  # share of the budget for the global stage
PATIENCE: Final = 3  # candidates that are drawn for each simulated one: others lack the certificate
WIDE: Final = 0.25  # standard deviation of the first global steps, as a share of a range
NARROW: Final = 0.03  # the same of the local stage
FORBIDDEN: Final = 1e200  # least cost of a candidate without certificate

Stage = Literal["start", "global", "gradient", "local"]


def tune(
    scenarios: Scenario | Sequence[Scenario],
    what: Tune | None = None,
    *,
    frames: Sequence[Frame] | None = None,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
    keep: Path | None = None,
    resume: bool = False,
) -> Tuned:
    """Tune one scenario, or several at once with the same numbers in each.

    Candidates are lanes and meet the same runs. Half of the budget searches the box by CMA-ES,
    Hansen and Ostermeier (2001), or on a grid for a single number. Then, for the mean, which is
    smooth, L-BFGS-B (SLSQP under the certificate) follows gradients whose differences are lanes
    too. The rest goes to CMA-ES around the best, which needs no slope if different runs become the
    median or the worst. The same seed gives the same numbers with any number of threads.

    References:
        N. Hansen, A. Ostermeier (2001), doi:10.1162/106365601750190398

    Args:
        scenarios: one, or several whose mean is made small
        what: numbers and their bounds, metric, statistic, budget (default: the [tune] of the first
            scenario)
        frames: values that count as 0 and as 1 in each scenario (default: the metric itself)
        threads: number of threads (default: one per processor)
        progress: called with the number of candidates just tried (None: a bar in a notebook)
        keep: file that keeps the costs of candidates, to be deleted once the result is saved (None:
            none)
        resume: continue a stopped search from the costs in `keep`

    Returns:
        The tuned scenarios, every candidate, and the score of the numbers on held-out runs.

    Raises:
        InputError or a subclass: by key of [tune], FileError for `keep`

    Example:
        >>> gamma = uz.Range(between=(1.0, 50.0), log=True)
        >>> tuned = uz.tune(
        ...     uz.Scenario(
        ...         plant=plant,
        ...         sensor=sensor,
        ...         reference=reference,
        ...         observer=certified,
        ...         simulation=simulation,
        ...         tune=uz.Tune(runs=2, budget=4, entries={"observer.gamma": gamma}),
        ...     )
        ... )
        >>> 1.0 <= tuned.values[0] <= 50.0
        True

    See Also:
        run_ensemble, design
    """
    scenarios = (scenarios,) if isinstance(scenarios, Scenario) else tuple(scenarios)
    what = _require_tune(scenarios, what)
    scenarios = tuple([fill_default_gains(scenario, what) for scenario in scenarios])
    frames = _require_frames(scenarios, frames)
    seed = _require_tuning_seed(scenarios[0], what)
    tuned = require_parameters(what, scenarios)
    start = np.array([p.share_of_range(p.start) for p in tuned])
    together = [np.full(start.size, share) for share in PLACES]
    probes = [start, *_move_singly(start, [PLACES] * start.size), *together]
    points = values_at_shares(tuned, np.stack(probes))
    names = [p.name for p in tuned]
    on = Objective(what, names, scenarios, frames, threads).prepare_runs(points, seed)
    with (
        notebook_progress(progress, "tuning", what.budget, "candidates") as advance,
        open_answers(
            keep, functools.partial(_describe_search, on, seed), "candidates", resume
        ) as known_costs,
    ):
        search = Search(on, tuned, [], advance, known_costs)
        search.spend_budget(start, seed)
        return validate_best(on, tuned, search.candidates, seed)


def _describe_search(on: Objective, seed: int) -> dict[str, Any]:
    """Return all data that the cost of a candidate depends on, without the budget."""
    return {
        "scenarios": list(map(toml.to_toml, on.scenarios)),
        "files": list(map(digests, on.scenarios)),
        "tune": msgspec.to_builtins(msgspec.structs.replace(on.what, budget=0, held_out=0)),
        "frames": list(map(list, on.frames)),
        "seed": seed,
    }


def _move_singly(start: Floats, places: Sequence[Sequence[float] | Floats]) -> list[Floats]:
    """Return points (n each) in which one entry of a start differs.

    Args:
        start: the start (n).
        places: values of each entry.
    """
    moves = chain.from_iterable(product([i], values) for i, values in enumerate(places))
    return [np.where(np.arange(start.size) == i, value, start) for i, value in moves]


def _require_tune(scenarios: tuple[Scenario, ...], options: Tune | None) -> Tune:
    """Return the tuning options. Raises InputError."""
    if not scenarios:
        raise InputError("tune: expected at least one scenario, found none")
    options = options or scenarios[0].tune or Tune()
    for key, least in (("runs", 1), ("held_out", 1), ("budget", 4)):
        if getattr(options, key) < least:
            raise InputError(f"tune.{key}: expected {least} or more, found {getattr(options, key)}")
    require_number("tune.margin", options.margin, least=0.0)
    return options


def _require_frames(
    scenarios: tuple[Scenario, ...], frames: Sequence[Frame] | None
) -> Sequence[Frame]:
    """Return a frame for each scenario. Raises InputError."""
    if frames is None:
        return [Frame()] * len(scenarios)
    sound = all(np.isfinite(frame).all() and frame.zero < frame.one for frame in frames)
    if len(frames) != len(scenarios) or not sound:
        raise InputError(
            f"frames: expected one for each of {len(scenarios)} scenarios, with zero below one, "
            f"found {list(frames)!r:.80}"
        )
    return frames


def _require_tuning_seed(scenario: Scenario, options: Tune) -> int:
    """Return the seed of the runs tuned on. Raises InputError.

    It is that of [tune], else of [ensemble], else of [simulation].
    """
    if options.seed is not None:
        return require_seed("tune.seed", options.seed)
    if scenario.ensemble is not None and scenario.ensemble.seed is not None:
        return require_seed("ensemble.seed", scenario.ensemble.seed)
    return require_seed("simulation.seed", scenario.simulation.seed)


class Evaluation(NamedTuple):
    """Costs and margins of candidates, or their slopes.

    Attributes:
        cost: cost of each candidate, inf if it was not simulated
        margin: margin of its certificate, inf if none is required
    """

    cost: Floats
    margin: Floats


Evaluate = Callable[[Floats], Evaluation]  # of shares of the ranges (candidates x numbers)


class BudgetSpentError(Exception):
    """Error of a search without budget left."""


class Search(NamedTuple):
    """State of a running search.

    Attributes:
        objective: objective to minimise
        parameters: tuned numbers
        candidates: those simulated so far, in order (the list grows)
        progress: called with the number of candidates just simulated
        known_costs: costs of candidates, of an earlier run too
    """

    objective: Objective
    parameters: tuple[Parameter, ...]
    candidates: list[SimulatedCandidate]
    progress: Callable[[int], None]
    known_costs: MemoryAnswers

    @property
    def cheapest_candidate(self) -> SimulatedCandidate:
        """Return the cheapest candidate with the certificate, else that of largest margin."""
        return choose_best(self.candidates, self.objective.what.margin)

    @property
    def best_shares(self) -> Floats:
        """Return the best candidate as shares of the ranges (n)."""
        pairs = zip(self.parameters, self.cheapest_candidate.values, strict=True)
        return np.array([parameter.share_of_range(value) for parameter, value in pairs])

    def evaluate_candidates(self, u: Floats, stage: Stage, until: float = 1.0) -> Evaluation:
        """Return the costs and margins of candidates, and record all simulated candidates.

        Args:
            u: shares of the ranges (candidates x numbers)
            stage: of the search
            until: share of the budget that this stage may spend up to

        Raises:
            BudgetSpentError: before anything is simulated
        """
        options = self.objective.what
        points = values_at_shares(self.parameters, u)
        problems = self.objective.candidate_problems(points)
        margin = self.objective.candidate_margins(problems)
        cost = np.full(len(u), np.inf)
        chosen = []
        allowed = []
        for k, each in enumerate(problems):
            is_allowed = stage in ("start", "gradient") or margin[k] >= options.margin
            if each is not None and is_allowed:
                chosen.append(k)
                allowed.append(each)
        if len(self.candidates) + len(chosen) > max(until * options.budget, 1):
            raise BudgetSpentError
        if chosen:
            cost[chosen] = self._compute_costs(points[chosen], allowed)
        for k in chosen:
            point = tuple(points[k].tolist())
            candidate = SimulatedCandidate(point, float(cost[k]), float(margin[k]), stage)
            self.candidates.append(candidate)
        self.progress(len(chosen))
        return Evaluation(cost, margin)

    def _compute_costs(self, points: Floats, problems: list[Problems]) -> Floats:
        """Return the costs of candidates, computed or from the file."""

        def compute(missing: list[int]) -> Iterator[tuple[int, float]]:
            """Yield the missing costs by index."""
            costs = self.objective.candidate_costs([problems[k] for k in missing])
            yield from zip(missing, costs.tolist(), strict=True)

        return np.array(self.known_costs.compute_missing(points.tolist(), compute))

    def spend_budget(self, start: Floats, seed: int) -> None:
        """Search from a start, given as shares of the ranges, until the budget is spent."""
        options = self.objective.what
        self.evaluate_candidates(start[None], "start")
        with contextlib.suppress(BudgetSpentError):
            explore = functools.partial(self.evaluate_candidates, stage="global", until=GLOBAL)
            if start.size == 1:
                explore(np.linspace(0.0, 1.0, _count_grid_cells(options) + 1)[:, None])
            else:
                _evolve_candidates(explore, options, start, seed, WIDE)
        with contextlib.suppress(BudgetSpentError):
            if options.statistic == "mean" and not any(p.whole for p in self.parameters):
                descend = functools.partial(self.evaluate_candidates, stage="gradient")
                _descend_slope(
                    descend, options, self.best_shares, abs(self.cheapest_candidate.cost) or 1.0
                )
        with contextlib.suppress(BudgetSpentError):
            polish = functools.partial(self.evaluate_candidates, stage="local")
            _search_near_best(polish, options, self.best_shares, seed)


def difference_gradient(evaluate: Evaluate, u: Floats) -> tuple[Evaluation, Evaluation]:
    """Return the evaluation of a point u (n), and its slopes by differences over REACH.

    All candidates are evaluated in one call. Neighbours stay in the box [0, 1]; u replaces a
    neighbour that cannot be simulated.
    """
    shifts = REACH * np.vstack([np.zeros(u.size), np.eye(u.size), -np.eye(u.size)])
    sides = np.clip(u + shifts, 0.0, 1.0)
    worth = evaluate(sides)
    refused = ~np.isfinite(worth.cost)
    sides[refused] = u
    ahead, behind = np.split(sides[1:], 2)
    reach = np.diagonal(ahead - behind)
    cost = _difference_slopes(worth.cost, refused, reach)
    margin = _difference_slopes(worth.margin, refused, reach)
    return Evaluation(worth.cost[:1], worth.margin[:1]), Evaluation(cost, margin)


def _difference_slopes(values: Floats, refused: Floats, reach: Floats) -> Floats:
    """Return the slopes (n) of values at u, at n points ahead and n points behind it.

    Args:
        values: the values (1 + 2 n).
        refused: flags of the points that were not simulated (1 + 2 n).
        reach: distances of the points ahead from those behind (n); the slope is 0 if it is 0.
    """
    ahead, behind = np.split(np.where(refused, values[0], values)[1:], 2)
    with np.errstate(invalid="ignore"):
        slopes = (ahead - behind) / np.where(reach > 0, reach, np.inf)
        return np.nan_to_num(slopes, posinf=0.0, neginf=0.0)


def _descend_slope(evaluate: Evaluate, options: Tune, start: Floats, size: float) -> None:
    """Minimise the cost by its gradient: L-BFGS-B, or SLSQP if certificates are required.

    Args:
        evaluate: evaluates candidates.
        options: the [tune] table.
        start: start point, as shares of the ranges (n).
        size: typical cost, by which the cost is scaled.
    """
    from scipy.optimize import minimize

    least = options.margin + 1e-6  # rounding must not lose the certificate

    @functools.cache
    def evaluate_point(point: bytes) -> tuple[Evaluation, Evaluation]:
        """Return the evaluation of a point and its slopes."""
        return difference_gradient(evaluate, np.frombuffer(point))

    def cost(u: Floats) -> tuple[float, Floats]:
        """Return the scaled cost of a point and its slopes."""
        evaluation, slopes = evaluate_point(u.tobytes())
        return min(float(evaluation.cost[0]) / size, FORBIDDEN), slopes.cost / size

    certificate = {
        "type": "ineq",
        "fun": lambda u: np.maximum(evaluate_point(u.tobytes())[0].margin - least, -1e3),
        "jac": lambda u: evaluate_point(u.tobytes())[1].margin[None],
    }
    method: dict[str, Any] = {"method": "L-BFGS-B"}
    if options.certified:
        method = {"method": "SLSQP", "constraints": [certificate]}
    box = [(0.0, 1.0)] * start.size
    minimize(cost, start, jac=True, bounds=box, options={"ftol": 1e-5}, **method)


def _search_near_best(evaluate: Evaluate, options: Tune, best: Floats, seed: int) -> None:
    """Search around the best candidate without slopes.

    One parameter is searched on a finer grid between the neighbours of the best one, several
    parameters by CMA-ES with narrow steps.

    Args:
        evaluate: evaluates candidates.
        options: the [tune] table.
        best: best candidate, as shares of the ranges (n).
        seed: seed of the evolution.
    """
    if best.size > 1:
        _evolve_candidates(evaluate, options, best, seed + 1, NARROW)
        return
    cells = _count_grid_cells(options)
    for u in best + np.linspace(-1.0, 1.0, cells // 2) / cells:
        evaluate(np.clip([[u]], 0.0, 1.0))


def _count_grid_cells(options: Tune) -> int:
    """Return the number of grid cells over the range of a single number."""
    return max(int(GLOBAL * options.budget) - 2, 1)


def _evolve_candidates(
    evaluate: Evaluate, options: Tune, start: Floats, seed: int, spread: float
) -> None:
    """Search by CMA-ES until the budget of this stage is spent.

    Candidates without the certificate are not simulated, and do not count for the budget.

    Args:
        evaluate: evaluates candidates.
        options: the [tune] table.
        start: start point, as shares of the ranges (n).
        seed: seed of the evolution.
        spread: standard deviation of its first steps, as a share of a range.
    """

    def cost(u: Floats) -> Floats:
        """Return the penalised costs of candidates."""
        return _penalise_margin(evaluate(u), options.margin)

    size = 4 + int(3 * np.log(start.size))
    low = np.zeros(start.size)
    high = np.ones(start.size)
    rounds = PATIENCE * options.budget // size
    minimise_by_cmaes(cost, low, high, seed, size, rounds, start, spread)


def _penalise_margin(evaluation: Evaluation, least: float) -> Floats:
    """Return the costs of candidates; FORBIDDEN and more if the margin is below the least one."""
    lack = np.clip(least - evaluation.margin, 0.0, 1e6)
    return np.where(evaluation.margin < least, FORBIDDEN * (1 + lack), evaluation.cost)


class Sweep(NamedTuple):
    """Costs of a scenario over a grid.

    Attributes:
        axes: values by address
        cost: the statistic of the metric (an axis for each number) (inf if a point is refused)
        margin: of the certificate, in the same shape (inf if none was required)
    """

    axes: dict[str, Floats]
    cost: Floats
    margin: Floats


def sweep(
    scenario: Scenario,
    grid: Mapping[str, npt.ArrayLike],
    what: Tune | None = None,
    *,
    seed: int = 0,
    threads: int | None = None,
) -> Sweep:
    """Evaluate a scenario at every point of a grid, on runs drawn as its [ensemble] specifies.

    Args:
        scenario: with or without the tables [tune] and [ensemble]
        grid: values by address, such as {"observer.gamma": [1.0, 10.0]}. The first point must be
            possible
        what: metric, statistic, number of runs, whether certificates are required (default: the
            [tune] of the scenario)
        seed: of the runs, unless `what` has one
        threads: number of threads (default: one per processor)

    Returns:
        The axes, and cost and margin at every point.

    Raises:
        InputError: or a subclass, for errors in the scenario.
    """
    what = what or scenario.tune or Tune()
    axes = _resolve_axes(scenario, grid)
    meshes = np.meshgrid(*axes.values(), indexing="ij")
    points = np.stack([mesh.ravel() for mesh in meshes], axis=1)
    seed = require_seed("seed", seed if what.seed is None else what.seed)
    places = [axis[[0, axis.size // 2, -1]] for axis in axes.values()]
    probes = np.stack(_move_singly(points[0], places))
    on = Objective(what, list(axes), [scenario], [Frame()], threads).prepare_runs(probes, seed)
    candidates = on.candidate_problems(points)
    possible = {k: problems for k, problems in enumerate(candidates) if problems is not None}
    cost = np.full(len(points), np.inf)
    cost[[*possible]] = on.candidate_costs([*possible.values()])
    shape = meshes[0].shape
    return Sweep(axes, cost.reshape(shape), on.candidate_margins(candidates).reshape(shape))


def _resolve_axes(scenario: Scenario, grid: Mapping[str, npt.ArrayLike]) -> dict[str, Floats]:
    """Return the values of each number that the addresses of a grid stand for.

    Raises InputError.
    """
    known = find_option_numbers(scenario)
    axes: dict[str, Floats] = {}
    for address, values in grid.items():
        axes |= dict.fromkeys(numbers_of_address(address, known), require_series(address, values))
    if not axes:
        raise InputError(
            "sweep: nothing to sweep. Give values by address, such as "
            "{'observer.gamma': [1.0, 10.0]}"
        )
    return axes
