"""What candidates are worth: a statistic of a metric over runs, and their certificates' margin.

Candidates are lanes: options that differ in numbers alone share one kernel and the same runs. An
observer that computes in Python is run one by one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np

from undeadzone.analysis.certificate.passivity import certify
from undeadzone.ensemble import metrics
from undeadzone.ensemble.batch import Batch, prepare
from undeadzone.ensemble.binding import Lanes, bind
from undeadzone.ensemble.metrics import EDGES, width_error, widths_in_turn
from undeadzone.errors import InputError, UndeadzoneError
from undeadzone.interfaces import require_graph
from undeadzone.results.run import last_samples
from undeadzone.results.scales import LIMIT, plant_scales
from undeadzone.scenario.address import with_numbers
from undeadzone.scenario.ensemble_table import Vary
from undeadzone.scenario.problem import Problem, constant_gains, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.scenario.tune_table import Tune
from undeadzone.simulation.collect import tips
from undeadzone.simulation.exogenous import exogenous, random_disturbance
from undeadzone.simulation.loop import Outputs
from undeadzone.simulation.packed import changed_params, graph, pack_problem
from undeadzone.simulation.sample_by_sample import run_sample_by_sample
from undeadzone.simulation.simulate import close_problem
from undeadzone.statistics.intervals import QUANTILES
from undeadzone.util.arrays import Floats, Integers

Problems = tuple[Problem, ...]


class Frame(NamedTuple):
    """The scale of a scenario's scores: scenarios of different units or difficulty weigh alike.

    Attributes:
        zero: what counts as 0, in the unit of the metric
        one: what counts as 1, more than `zero`
    """

    zero: float = 0.0
    one: float = 1.0


class TestRuns(NamedTuple):
    """Runs on which candidates for the options of one scenario are tried.

    Attributes:
        batch: the runs of the first candidate, ready to be computed
        graph: what candidates must have to share its kernel
        runs: their numbers
        values: of what varies (runs x columns)
    """

    batch: Batch
    graph: str
    runs: Integers
    values: Floats

    @property
    def problem(self) -> Problem:
        """Return the problem of the first candidate."""
        return self.batch.problem

    @property
    def varied_values(self) -> dict[str, Floats]:
        """What [ensemble] varies: its values in the runs, by name."""
        return dict(zip(self.batch.binding.names, self.values.T, strict=True))

    def redrawn(self, runs: int, seed: int) -> TestRuns:
        """Return the same on other runs: the first `runs` of a seed; one if nothing differs among
        them.
        """
        binding, own = self.batch.binding._replace(seed=seed), self.batch.own._replace(seed=seed)
        count = runs if binding.columns or own.entries else 1
        values = binding.draw(0, count, runs)
        batch = self.batch._replace(binding=binding, own=own)
        return self._replace(batch=batch, runs=np.arange(count), values=values)

    def rows(self, candidates: Sequence[Problem], threads: int | None = None) -> Floats:
        """Return the metrics (candidates x runs x columns) of candidates.

        Those that the kernel does not serve get one of their own. Raises InputError.
        """
        groups: dict[str | None, list[int]] = {}
        for k, candidate in enumerate(candidates):
            groups.setdefault(self._other_graph(candidate), []).append(k)
        columns = len(self.batch.layout.columns) - self.values.shape[1]
        rows = np.empty((len(candidates), self.runs.size, columns))
        for other, chosen in groups.items():
            group, runs = [candidates[k] for k in chosen], self
            if other is not None:
                seed = self.batch.binding.seed
                runs = prepare_test_runs(group[0].scenario, group, self.runs.size, seed)
            rows[chosen] = runs._rows(group, threads).reshape(len(chosen), *rows.shape[1:])
        return rows

    def _other_graph(self, candidate: Problem) -> str | None:
        """None for a candidate that the kernel serves, else its graph."""
        form, binding = graph(candidate), self.batch.binding
        if form == self.graph:
            shared = np.delete(np.arange(binding.params.size), binding.indices)
            _, params = pack_problem(candidate, self.batch.loop)
            if np.array_equal(params[shared], binding.params[shared]):
                return None
        return form

    def _rows(self, candidates: list[Problem], threads: int | None) -> Floats:
        """Return the metrics of candidates that the kernel serves: candidate by candidate, run by
        run.
        """
        parts = []
        for candidate in candidates:
            state, params = pack_problem(candidate, self.batch.loop)
            binding = self.batch.binding._replace(state=state, params=params)
            parts.append(binding.lanes(self.values))
        lanes = Lanes(*map(np.concatenate, zip(*parts, strict=True)))
        return self.batch.measure(np.tile(self.runs, len(candidates)), lanes, threads)


def prepare_test_runs(
    scenario: Scenario, probes: Sequence[Problem], runs: int, seed: int
) -> TestRuns:
    """Test runs for a scenario whose candidates move the numbers that the probes move.

    Saltelli's design is not taken: its runs are not independent.

    Args:
        scenario: the first candidate
        probes: other candidates
        runs: how many
        seed: of what the runs draw

    Raises:
        InputError or a subclass
    """
    vary = scenario.ensemble or Vary()
    sampling = "sobol" if vary.sampling == "saltelli" else vary.sampling
    vary = msgspec.structs.replace(vary, runs=runs, seed=seed, sampling=sampling)
    scenario = msgspec.structs.replace(scenario, ensemble=vary)
    problem = resolve_scenario(scenario)
    form, loop = graph(problem), close_problem(problem)
    alike = [pack_problem(probe, loop)[1] for probe in probes if graph(probe) == form]
    slots = set(changed_params(loop, alike).tolist())
    for column in bind(problem, loop).columns:
        if slots & {slot for slot, _ in column.slots}:
            raise InputError(
                f"tune: [ensemble] varies {column.name}, which what is tuned decides; "
                "keep one of them"
            )
    none_yet = TestRuns(prepare(scenario, slots), form, np.empty(0, int), np.empty((0, 0)))
    return none_yet.redrawn(runs, seed)


class OneByOne(NamedTuple):
    """Runs of an observer that computes in Python: they differ in noise and disturbance alone.

    Attributes:
        problem: of the first candidate
        runs: how many: the first ones of the seed
        seed: of noise and disturbance
        varied_values: nothing, see `TestRuns.varied_values`
    """

    problem: Problem
    runs: int = 0
    seed: int = 0
    varied_values: Mapping[str, Floats] = {}

    def redrawn(self, runs: int, seed: int) -> OneByOne:
        """Return other runs: the first `runs` of a seed; one if nothing differs between them."""
        sensor = self.problem.sensor
        noisy = sensor.noise.any() or sensor.noise_before.any()
        differ = noisy or random_disturbance(self.problem)
        return OneByOne(self.problem, runs if differ else 1, seed)

    def rows(self, candidates: Sequence[Problem], threads: int | None = None) -> Floats:
        """Return the metrics (candidates x runs x columns) of candidates; threads: not used."""
        return np.stack([self._rows_of(candidate) for candidate in candidates])

    def _rows_of(self, candidate: Problem) -> Floats:
        """Return the metrics (runs x columns) of one candidate."""
        rows = []
        for run in range(self.runs):
            inputs = exogenous(candidate, run=run, seed=self.seed)
            rows.append(row(candidate, run_sample_by_sample(candidate, inputs)))
        return np.concatenate(rows)


def row(problem: Problem, out: Outputs) -> Floats:
    """Return the metrics (1 x columns) of one run, as `metrics.measured` accumulates them in the
    loop.
    """
    t = np.arange(len(out.z)) * problem.scenario.simulation.step
    tail = last_samples(t)
    r = problem.reference.output_at(t)
    error = out.z[:, problem.tracked] - r
    worst = np.abs(error).max(axis=1)
    tolerance = (problem.scenario.ensemble or Vary()).tolerance * np.abs(r).max()
    poses = tips(problem, out.x, out.estimate.x, t)

    def one_number(value: Any) -> Floats:
        return np.array([[value]])

    tally = metrics.Tally(
        tracking=one_number((error[tail] ** 2).sum()),
        estimation=one_number(((out.z - out.estimate.z)[tail] ** 2).sum()),
        peak=one_number(np.fmax.reduce(worst)),
        settled=one_number(t[worst > tolerance].max(initial=0.0)),
        silent=one_number((out.side == 0).sum()),
        effort=one_number((out.u**2).sum()),
        right=out.estimate.right[-1:],
        left=out.estimate.left[-1:],
        tip=np.empty((1, 0)),
        behind=np.empty((1, 0)),  # no observer that computes in Python knows a play
    )
    if poses:
        tally = tally._replace(tip=one_number(((poses["tip"] - poses["tip_r"])[tail] ** 2).sum()))
    states = np.hstack([out.x, out.estimate.x, out.estimate.right, out.estimate.left])[-1:]
    scales, length = plant_scales(problem), t.size - tail.start
    return metrics.rows(tally, states, scales, t.size, length, len(problem.tracked))


class Objective(NamedTuple):
    """Scenarios to be done well at once.

    Attributes:
        what: the table [tune]
        names: addresses of the numbers of a candidate
        scenarios: as they are, without a candidate's numbers
        frames: of each scenario
        threads: on which to compute; None: one per processor
        test_runs: of each scenario
    """

    what: Tune
    names: Sequence[str]
    scenarios: Sequence[Scenario]
    frames: Sequence[Frame]
    threads: int | None = None
    test_runs: tuple[TestRuns | OneByOne, ...] = ()

    def prepare_runs(self, probes: Floats, seed: int) -> Objective:
        """Return the objective on the first runs of a seed.

        Args:
            probes: candidates (rows) that move whatever others will move; the first one is possible
            seed: of the runs

        Raises:
            InputError or a subclass
        """
        scenarios = range(len(self.scenarios))
        return self._replace(test_runs=tuple(self._test_runs(k, probes, seed) for k in scenarios))

    def _test_runs(self, index: int, probes: Floats, seed: int) -> TestRuns | OneByOne:
        """Return the test runs of a scenario: on the lanes, unless its observer computes in
        Python.
        """
        first = resolve_scenario(self.scenario(index, probes[0]))
        _check_metric(self.what.metric, first)
        if first.observer.python is None:
            others = [self.problem(index, probe) for probe in probes[1:]]
            near = [problem for problem in others if problem is not None]
            return prepare_test_runs(first.scenario, near, self.what.runs, seed)
        vary = first.scenario.ensemble
        if vary is not None and vary.entries:
            require_graph(
                first.observer
            )  # no more than noise and disturbance can vary without a graph
        return OneByOne(first).redrawn(self.what.runs, seed)

    def scenario(self, index: int, point: Floats) -> Scenario:
        """Return a scenario with the numbers of a candidate."""
        values = dict(zip(self.names, point.tolist(), strict=True))
        return with_numbers(self.scenarios[index], values)

    def problem(self, index: int, point: Floats) -> Problem | None:
        """Return the problem of a candidate in a scenario; None where it is refused."""
        try:
            return resolve_scenario(self.scenario(index, point))
        except (UndeadzoneError, np.linalg.LinAlgError):
            return None

    def problems(self, points: Floats) -> list[Problems | None]:
        """Return the problems of each candidate, one per scenario; None where one is refused.

        Args:
            points: candidates x numbers
        """
        candidates: list[Problems | None] = []
        for point in points:
            each = [self.problem(k, point) for k in range(len(self.scenarios))]
            possible = tuple(problem for problem in each if problem is not None)
            candidates.append(possible if len(possible) == len(each) else None)
        return candidates

    def margins(self, candidates: Sequence[Problems | None]) -> Floats:
        """Return the least margin of each candidate's certificates.

        It is inf if no certificate is asked for, -inf for a candidate that is refused.
        """
        margins = np.full(len(candidates), np.inf)
        for k, problems in enumerate(candidates):
            if problems is None:
                margins[k] = -np.inf
            elif self.what.certified:
                margins[k] = min(map(certificate_margin, problems))
        return margins

    def costs(self, candidates: Sequence[Problems]) -> Floats:
        """What candidates (one or more) cost."""
        of_each = zip(*candidates, strict=True)
        return self.scores([self.losses(k, problems) for k, problems in enumerate(of_each)])

    def losses(self, index: int, candidates: Sequence[Problem]) -> Floats:
        """What each candidate loses in each run of a scenario (candidates x runs)."""
        runs = self.test_runs[index]
        return losses(self.what.metric, runs, runs.rows(candidates, self.threads))

    def scores(self, lost: Sequence[Floats]) -> Floats:
        """Return the mean over the scenarios of framed statistics.

        Args:
            lost: losses in each scenario (candidates x runs)
        """
        framed = []
        for each, frame in zip(lost, self.frames, strict=True):
            value = statistic(self.what.statistic, each)
            framed.append((value - frame.zero) / (frame.one - frame.zero))
        return np.mean(framed, axis=0)

    def redrawn(self, runs: int, seed: int) -> Objective:
        """Return the same on other runs: the first `runs` of a seed."""
        return self._replace(test_runs=tuple(each.redrawn(runs, seed) for each in self.test_runs))


def _check_metric(metric: str, problem: Problem) -> None:
    """Raise InputError for a metric that the runs of a problem do not have."""
    columns = metrics.columns(problem.plant, problem.sensor.kind)
    known = [name for name in columns if name != "diverged" and not name.startswith("d_")]
    for i in range(problem.plant.p):
        known += [f"d_{edge}_error[{i}]" for edge in EDGES]
    if metric not in known:
        raise InputError(f"tune.metric: {metric!r} is none of {', '.join(known)}")


def statistic(name: str, lost: Floats) -> Floats:
    """Return the mean, or the loss of one of the runs, along the last axis."""
    if name == "mean":
        return lost.mean(axis=-1)
    share = 1.0 if name == "worst" else QUANTILES[name]
    return np.sort(lost, axis=-1)[..., int(np.ceil(lost.shape[-1] * share)) - 1]


def losses(metric: str, runs: TestRuns | OneByOne, rows: Floats) -> Floats:
    """Return the size of a metric; above LIMIT, but finite, for runs that diverged: the faster, the
    more.

    Args:
        metric: a column of `metrics`, or the error of a width such as `d_right_error[0]`
        runs: on which the rows were computed
        rows: of metrics (... x columns)
    """
    problem, sensor = runs.problem, runs.problem.sensor
    names = metrics.columns(problem.plant, sensor.kind)
    columns = {name: rows[..., i] for i, name in enumerate(names)}
    if metric in columns:
        size = columns[metric]
    else:
        widths, geared = widths_in_turn(sensor), sensor.kind == "gears"
        size = np.abs(width_error(metric, columns, widths, runs.varied_values, geared))
    rate = _rate_of_divergence(columns, problem.scenario.simulation.step)
    return np.where(
        columns["diverged"] != 0,
        LIMIT * (1 + rate / (1 + rate)),
        np.minimum(np.nan_to_num(size, nan=LIMIT), LIMIT),
    )


def _rate_of_divergence(columns: Mapping[str, Floats], step: float) -> Floats:
    """How fast |z - r| has grown: the logarithm of its peak over the time that this took [1/s]."""
    with np.errstate(over="ignore", invalid="ignore"):
        growth = np.log1p(np.nan_to_num(columns["peak_tracking"], nan=0.0))
        return np.asarray(growth / np.maximum(columns["settling_time"], step))


def certificate_margin(problem: Problem) -> float:
    """Return the margin of the certificate; below 0 where the gains have none.

    Raises InputError.
    """
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
