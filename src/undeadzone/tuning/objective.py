"""What a candidate is worth: a statistic of a metric over runs, and its certificate's margin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from undeadzone.analysis.certificate.passivity import certify
from undeadzone.ensemble import metrics
from undeadzone.ensemble.bands import EDGES, true_width
from undeadzone.errors import InputError, UndeadzoneError
from undeadzone.results.scales import LIMIT
from undeadzone.scenario.problem import Problem, constant_gains, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.scenario.tune_table import Tune
from undeadzone.statistics.intervals import QUANTILES
from undeadzone.support.arrays import Floats
from undeadzone.tuning.candidates import TestRuns, prepare_test_runs
from undeadzone.tuning.one_by_one import OneByOne, one_by_one
from undeadzone.tuning.parameters import with_numbers

Problems = tuple[Problem, ...]


class Frame(NamedTuple):
    """The scale of a scenario's scores: scenarios of different units or difficulty weigh alike.

    Attributes:
        zero: what counts as 0, in the unit of the metric
        one: what counts as 1, more than `zero`
    """

    zero: float = 0.0
    one: float = 1.0


class Objective(NamedTuple):
    """Scenarios to be done well at once.

    Attributes:
        what: the table [tune]
        names: addresses of the numbers of a candidate
        scenarios: as they are, without a candidate's numbers
        test_runs: of each scenario
        frames: of each scenario
    """

    what: Tune
    names: tuple[str, ...]
    scenarios: tuple[Scenario, ...]
    test_runs: tuple[TestRuns | OneByOne, ...]
    frames: tuple[Frame, ...]

    def scenario(self, index: int, point: Floats) -> Scenario:
        """A scenario with the numbers of a candidate."""
        numbers = dict(zip(self.names, point.tolist(), strict=True))
        return with_numbers(self.scenarios[index], numbers)

    def problems(self, points: Floats) -> list[Problems | None]:
        """The problems of each candidate, one per scenario; None where one is refused.

        Args:
            points: candidates x numbers
        """
        return [self._problems_of(point) for point in points]

    def margins(self, candidates: Sequence[Problems | None]) -> Floats:
        """The least margin of each candidate's certificates.

        It is inf if no certificate is asked for, -inf for a candidate that is refused.
        """
        return np.array([self._margin(problems) for problems in candidates])

    def costs(self, candidates: Sequence[Problems], threads: int | None = None) -> Floats:
        """What candidates (one or more) cost."""
        lost = []
        for k in range(len(self.scenarios)):
            problems = [each[k] for each in candidates]
            lost.append(self.losses(k, problems, threads))
        return self.scores(lost)

    def losses(
        self, index: int, candidates: Sequence[Problem], threads: int | None = None
    ) -> Floats:
        """What each candidate loses in each run of a scenario (candidates x runs)."""
        runs = self.test_runs[index]
        return losses(self.what.metric, runs, runs.rows(candidates, threads))

    def scores(self, lost: Sequence[Floats]) -> Floats:
        """The mean over the scenarios of framed statistics.

        Args:
            lost: losses in each scenario (candidates x runs)
        """
        framed = []
        for each, frame in zip(lost, self.frames, strict=True):
            value = statistic(self.what.statistic, each)
            framed.append((value - frame.zero) / (frame.one - frame.zero))
        return np.mean(framed, axis=0)

    def _problems_of(self, point: Floats) -> Problems | None:
        """The problems of one candidate, one per scenario; None where one is refused."""
        problems = []
        for k in range(len(self.scenarios)):
            problem = _possible(self.scenario(k, point))
            if problem is not None:
                problems.append(problem)
        return tuple(problems) if len(problems) == len(self.scenarios) else None

    def _margin(self, problems: Problems | None) -> float:
        """The least margin of a candidate's certificates (`margins`)."""
        if problems is None:
            return -np.inf
        if not self.what.certified:
            return np.inf
        return min(map(certified_margin, problems))

    def redrawn(self, runs: int, seed: int) -> Objective:
        """The same on other runs: the first `runs` of a seed."""
        return self._replace(test_runs=tuple(each.redrawn(runs, seed) for each in self.test_runs))


def objective(
    what: Tune,
    scenarios: Sequence[Scenario],
    frames: Sequence[Frame],
    names: Sequence[str],
    probes: Floats,
    runs: int,
    seed: int,
) -> Objective:
    """The objective on the first runs of a seed.

    Args:
        what: the table [tune]
        scenarios: to be done well at once
        frames: of each scenario
        names: addresses of the numbers of a candidate
        probes: candidates (rows) that move whatever others will move; the first one is possible
        runs: how many
        seed: of the runs

    Raises:
        InputError or a subclass
    """
    without_runs = Objective(what, tuple(names), tuple(scenarios), (), tuple(frames))
    test_runs = []
    for k in range(len(scenarios)):
        near = [without_runs.scenario(k, point) for point in probes]
        test_runs.append(_test_runs(what, near, runs, seed))
    return without_runs._replace(test_runs=tuple(test_runs))


def _test_runs(what: Tune, probes: list[Scenario], runs: int, seed: int) -> TestRuns | OneByOne:
    """The test runs of a scenario: on the lanes, unless its observer computes in Python."""
    first = resolve_scenario(probes[0])
    _check_metric(what.metric, first)
    if first.observer.python is not None:
        return one_by_one(first).redrawn(runs, seed)
    possible = [_possible(scenario) for scenario in probes[1:]]
    near = [problem for problem in possible if problem is not None]
    return prepare_test_runs(probes[0], near, runs, seed)


def statistic(name: str, lost: Floats) -> Floats:
    """The mean, or the loss of one of the runs, along the last axis."""
    if name == "mean":
        return lost.mean(axis=-1)
    share = 1.0 if name == "worst" else QUANTILES[name]
    return np.sort(lost, axis=-1)[..., int(np.ceil(lost.shape[-1] * share)) - 1]


def losses(metric: str, runs: TestRuns | OneByOne, rows: Floats) -> Floats:
    """The size of a metric; above LIMIT, but finite, for runs that diverged: the faster, the more.

    Args:
        metric: a column of `metrics`, or the error of a width such as `d_right_error[0]`
        runs: on which the rows were computed
        rows: of metrics (... x columns)
    """
    problem = runs.problem
    names = metrics.columns(problem.plant, problem.sensor.kind)
    columns = {name: rows[..., i] for i, name in enumerate(names)}
    if metric in columns:
        size = columns[metric]
    else:
        size = np.abs(_width_error(metric, runs, columns))
    rate = _rate_of_divergence(columns, problem.scenario.simulation.step)
    return np.where(
        columns["diverged"] != 0,
        LIMIT * (1 + rate / (1 + rate)),
        np.minimum(np.nan_to_num(size, nan=LIMIT), LIMIT),
    )


def _width_error(metric: str, runs: TestRuns | OneByOne, columns: Mapping[str, Floats]) -> Floats:
    """The final error of a width, d^ - d, in runs that vary it or not."""
    edge, _, index = metric.removeprefix("d_").partition("_error")
    nominal = float(getattr(runs.problem.sensor, edge)[int(index[1:-1])])
    return columns[f"d_{edge}{index}"] - true_width(f"{edge}{index}", nominal, runs.varied)


def _rate_of_divergence(columns: Mapping[str, Floats], step: float) -> Floats:
    """How fast |z - r| has grown: the logarithm of its peak over the time that this took [1/s]."""
    with np.errstate(over="ignore", invalid="ignore"):
        growth = np.log1p(np.nan_to_num(columns["peak_tracking"], nan=0.0))
        return np.asarray(growth / np.maximum(columns["settling_time"], step))


def certified_margin(problem: Problem) -> float:
    """The margin of the certificate; below 0 where the gains have none."""
    gains = constant_gains(problem.observer, problem.model)
    if gains is None:
        raise InputError(
            "tune.certified: this observer has no constant gains L and gamma to certify; "
            "leave certified out, or use method = certified"
        )
    if problem.model.nonlinear:
        raise InputError(
            "tune.certified: a nonlinear model has no certificate; leave certified out"
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
    """Raise InputError for a metric that the runs of a problem do not have."""
    known = []
    for name in metrics.columns(problem.plant, problem.sensor.kind):
        if name != "diverged" and not name.startswith("d_"):
            known.append(name)
    for i in range(problem.plant.p):
        known += [f"d_{edge}_error[{i}]" for edge in EDGES]
    if metric not in known:
        raise InputError(f"tune.metric: {metric!r} is none of {', '.join(known)}")
