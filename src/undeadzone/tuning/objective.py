"""What a candidate is worth: a statistic of a metric over the same runs for all of them, and the margin of its certificate."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from undeadzone.analysis.certificate.passivity import certify
from undeadzone.ensemble import metrics
from undeadzone.ensemble.bands import EDGES, true_width
from undeadzone.errors import InputError, UndeadzoneError
from undeadzone.interfaces import NumericObserver
from undeadzone.scenario.problem import Problem, constant_gains, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.scenario.tune_table import Tune
from undeadzone.simulation.run import LIMIT
from undeadzone.statistics.intervals import QUANTILES
from undeadzone.support.arrays import Floats
from undeadzone.tuning.candidates import TestRuns, bench
from undeadzone.tuning.one_by_one import OneByOne, singles
from undeadzone.tuning.parameters import with_numbers

Problems = tuple[Problem, ...]


class Frame(NamedTuple):
    """Scores are counted from `zero` (0) to `one` (1), so that scenarios of different units or difficulty weigh alike."""

    zero: float = 0.0
    one: float = 1.0


class Objective(NamedTuple):
    """The scenarios to be done well at once, each with its bench and frame; names: of the numbers of a candidate."""

    what: Tune
    names: tuple[str, ...]
    scenarios: tuple[Scenario, ...]
    benches: tuple[TestRuns | OneByOne, ...]
    frames: tuple[Frame, ...]

    def scenario(self, index: int, point: Floats) -> Scenario:
        """A scenario with the numbers of a candidate."""
        return with_numbers(
            self.scenarios[index], dict(zip(self.names, point.tolist(), strict=True))
        )

    def problems(self, points: Floats) -> list[Problems | None]:
        """The problems of each candidate (candidates x numbers), one per scenario; None where one is refused."""
        return [self._each(point) for point in points]

    def margins(self, candidates: Sequence[Problems | None]) -> Floats:
        """The least margin of each candidate's certificates: inf if none is asked for, -inf where refused."""
        wanted = self.what.certified
        found = [
            -np.inf
            if problems is None
            else min(map(certified_margin, problems))
            if wanted
            else np.inf
            for problems in candidates
        ]
        return np.array(found)

    def costs(self, candidates: Sequence[Problems], threads: int | None = None) -> Floats:
        """What candidates cost, each at least one."""
        return self.scores(
            [
                self.losses(k, problems, threads)
                for k, problems in enumerate(zip(*candidates, strict=True))
            ]
        )

    def losses(
        self, index: int, candidates: Sequence[Problem], threads: int | None = None
    ) -> Floats:
        """What each candidate loses in each run of a scenario (candidates x runs)."""
        given = self.benches[index]
        return losses(self.what.metric, given, given.rows(candidates, threads))

    def scores(self, lost: Sequence[Floats]) -> Floats:
        """The mean of the framed statistics of losses (candidates x runs) in each scenario."""
        framed = [
            (statistic(self.what.statistic, each) - frame.zero) / (frame.one - frame.zero)
            for each, frame in zip(lost, self.frames, strict=True)
        ]
        return np.mean(framed, axis=0)

    def _each(self, point: Floats) -> Problems | None:
        found = (_possible(self.scenario(k, point)) for k in range(len(self.scenarios)))
        possible = tuple(problem for problem in found if problem is not None)
        return possible if len(possible) == len(self.scenarios) else None

    def redrawn(self, runs: int, seed: int) -> Objective:
        """The same on other runs."""
        return self._replace(benches=tuple(given.redrawn(runs, seed) for given in self.benches))


def objective(
    what: Tune,
    scenarios: Sequence[Scenario],
    frames: Sequence[Frame],
    names: Sequence[str],
    probes: Floats,
    runs: int,
    seed: int,
) -> Objective:
    """The objective on the first `runs` runs of a seed; probes: candidates that move whatever others will move, the first one possible.

    Raises InputError and its kinds.
    """
    found = Objective(what, tuple(names), tuple(scenarios), (), tuple(frames))
    each = ([found.scenario(k, point) for point in probes] for k in range(len(scenarios)))
    return found._replace(benches=tuple(_bench(what, near, runs, seed) for near in each))


def _bench(what: Tune, probes: list[Scenario], runs: int, seed: int) -> TestRuns | OneByOne:
    first = resolve_scenario(probes[0])
    _check_metric(what.metric, first)
    if isinstance(first.observer, NumericObserver):
        return singles(first).redrawn(runs, seed)
    near = [problem for scenario in probes[1:] if (problem := _possible(scenario)) is not None]
    return bench(probes[0], near, runs, seed)


def statistic(name: str, lost: Floats) -> Floats:
    """The mean, or the loss of one of the runs, along the last axis."""
    if name == "mean":
        return lost.mean(axis=-1)
    share = 1.0 if name == "worst" else QUANTILES[name]
    return np.sort(lost, axis=-1)[..., int(np.ceil(lost.shape[-1] * share)) - 1]


def losses(metric: str, given: TestRuns | OneByOne, found: Floats) -> Floats:
    """The size of a metric in rows of metrics (... x columns); above LIMIT, but finite, for runs that diverged: the faster, the more."""
    problem = given.problem
    column = {name: found[..., i] for i, name in enumerate(metrics.columns(problem.plant))}
    if metric in column:
        size = column[metric]
    else:
        edge, _, index = metric.removeprefix("d_").partition("_error")
        nominal = float(getattr(problem.sensor, edge)[int(index[1:-1])])
        size = np.abs(
            column[f"d_{edge}{index}"] - true_width(f"{edge}{index}", nominal, given.varied)
        )
    with np.errstate(over="ignore", invalid="ignore"):
        rate = np.log1p(np.nan_to_num(column["peak_tracking"], nan=0.0)) / np.maximum(
            column["settling_time"], problem.scenario.simulation.step
        )
    return np.where(
        column["diverged"] != 0,
        LIMIT * (1 + rate / (1 + rate)),
        np.minimum(np.nan_to_num(size, nan=LIMIT), LIMIT),
    )


def certified_margin(problem: Problem) -> float:
    """The margin of the certificate; below 0 where the gains have none."""
    gains = constant_gains(problem.observer, problem.model)
    if gains is None or problem.model.nonlinear:
        why = (
            "a nonlinear model has no certificate"
            if gains is not None
            else "this observer has no constant gains L and gamma to certify"
        )
        raise InputError(
            f"tune.certified: {why}; leave certified out{', or use method = certified' * (gains is None)}"
        )
    proof = certify(problem.model.linear, *gains, problem.model.Ts)
    return proof.margin if proof.certified else min(proof.margin, -1e-9)


def _possible(scenario: Scenario) -> Problem | None:
    """The problem of a candidate; None where it is refused."""
    try:
        return resolve_scenario(scenario)
    except (UndeadzoneError, np.linalg.LinAlgError):
        return None


def _check_metric(metric: str, problem: Problem) -> None:
    errors = [f"d_{edge}_error[{i}]" for i in range(problem.plant.p) for edge in EDGES]
    known = [
        name
        for name in metrics.columns(problem.plant)
        if name != "diverged" and not name.startswith("d_")
    ] + errors
    if metric not in known:
        raise InputError(f"tune.metric: {metric!r} is none of {', '.join(known)}")
