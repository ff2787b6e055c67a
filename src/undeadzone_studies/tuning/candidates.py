"""Cost of candidates: a statistic of a metric over runs, and their certificates' margin.

Candidates are lanes: options that differ in numbers alone share one kernel and the same runs. An
observer that computes in Python is run one by one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import starmap
from typing import Any, NamedTuple

import msgspec
import numpy as np

from undeadzone.analysis.certificate.passivity import certify
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
from undeadzone.simulation.packed import Lanes, changed_params, graph, pack_problem
from undeadzone.simulation.sample_by_sample import run_sample_by_sample
from undeadzone.simulation.simulate import close_problem
from undeadzone.util.arrays import Floats, Integers
from undeadzone.util.text import suggest_name
from undeadzone_studies.ensemble import metrics
from undeadzone_studies.ensemble.batch import Batch, prepare_batch
from undeadzone_studies.ensemble.binding import bind_ensemble
from undeadzone_studies.ensemble.metrics import EDGES, interleave_widths, width_error
from undeadzone_studies.statistics.intervals import QUANTILES

Problems = tuple[Problem, ...]


class Frame(NamedTuple):
    """Scale of a scenario's scores: scenarios of different units or difficulty have equal
    weight.

    Attributes:
        zero: what counts as 0, in the unit of the metric
        one: what counts as 1, more than `zero`
    """

    zero: float = 0.0
    one: float = 1.0


class TestRuns(NamedTuple):
    """Runs to evaluate candidates for the options of a scenario.

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
    def first_problem(self) -> Problem:
        """Return the problem of the first candidate."""
        return self.batch.problem

    @property
    def values_by_name(self) -> dict[str, Floats]:
        """Return the values in the runs of the entries that [ensemble] varies, by name."""
        return dict(zip(self.batch.binding.names_of_columns, self.values.T, strict=True))

    def redraw_runs(self, runs: int, seed: int) -> TestRuns:
        """Return the same candidates on the first `runs` runs of a seed, or on one if all
        runs are equal.
        """
        binding = self.batch.binding._replace(seed=seed)
        own = self.batch.own._replace(seed=seed)
        count = runs if binding.columns or own.entries else 1
        values = binding.draw_columns(0, count, runs)
        batch = self.batch._replace(binding=binding, own=own)
        return self._replace(batch=batch, runs=np.arange(count), values=values)

    def simulate_candidates(
        self, candidates: Sequence[Problem], threads: int | None = None
    ) -> Floats:
        """Return the metrics (candidates x runs x columns) of candidates.

        Those that the kernel does not serve get one of their own. Raises InputError.
        """
        groups: dict[str | None, list[int]] = {}
        for k, candidate in enumerate(candidates):
            groups.setdefault(self._find_other_graph(candidate), []).append(k)
        columns = len(self.batch.layout.columns) - self.values.shape[1]
        rows = np.empty((len(candidates), self.runs.size, columns))
        for other, chosen in groups.items():
            group = [candidates[k] for k in chosen]
            runs = self
            if other is not None:
                seed = self.batch.binding.seed
                runs = prepare_test_runs(group[0].scenario, group, self.runs.size, seed)
            rows[chosen] = runs._simulate_on_kernel(group, threads).reshape(
                len(chosen), *rows.shape[1:]
            )
        return rows

    def _find_other_graph(self, candidate: Problem) -> str | None:
        """Return None for a candidate that the kernel can compute, else its graph."""
        form = graph(candidate)
        binding = self.batch.binding
        if form == self.graph:
            shared = np.delete(np.arange(binding.numbers.params.size), binding.numbers.indices)
            _, params = pack_problem(candidate, self.batch.loop)
            if np.array_equal(params[shared], binding.numbers.params[shared]):
                return None
        return form

    def _simulate_on_kernel(self, candidates: list[Problem], threads: int | None) -> Floats:
        """Return the metrics of candidates that the kernel can compute: candidate by
        candidate, run by run.
        """
        parts = []
        for candidate in candidates:
            state, params = pack_problem(candidate, self.batch.loop)
            numbers = self.batch.binding.numbers._replace(state=state, params=params)
            parts.append(numbers.to_lanes(self.values))
        lanes = Lanes(*map(np.concatenate, zip(*parts, strict=True)))
        return self.batch.measure_lanes(np.tile(self.runs, len(candidates)), lanes, threads)


def prepare_test_runs(
    scenario: Scenario, probes: Sequence[Problem], runs: int, seed: int
) -> TestRuns:
    """Prepare runs for a scenario whose candidates change the same numbers as the probes.

    Saltelli's design is not taken: its runs are not independent.

    Args:
        scenario: the first candidate
        probes: other candidates
        runs: how many
        seed: of the numbers that the runs draw

    Raises:
        InputError or a subclass
    """
    vary = scenario.ensemble or Vary()
    sampling = "sobol" if vary.sampling == "saltelli" else vary.sampling
    vary = msgspec.structs.replace(vary, runs=runs, seed=seed, sampling=sampling)
    scenario = msgspec.structs.replace(scenario, ensemble=vary)
    problem = resolve_scenario(scenario)
    form = graph(problem)
    loop = close_problem(problem)
    alike = [pack_problem(probe, loop)[1] for probe in probes if graph(probe) == form]
    slots = set(changed_params(loop, alike).tolist())
    for column in bind_ensemble(problem, loop).columns:
        if slots & {slot for slot, _ in column.slots}:
            raise InputError(
                f"tune: [ensemble] varies {column.name}, which the tuned numbers determine. "
                "Keep one of them"
            )
    none_yet = TestRuns(prepare_batch(scenario, slots), form, np.empty(0, int), np.empty((0, 0)))
    return none_yet.redraw_runs(runs, seed)


class OneByOne(NamedTuple):
    """Runs of an observer that computes in Python: they differ in noise and disturbance alone.

    Attributes:
        first_problem: of the first candidate
        runs: how many: the first ones of the seed
        seed: of noise and disturbance
        values_by_name: nothing, see `TestRuns.values_by_name`
    """

    first_problem: Problem
    runs: int = 0
    seed: int = 0
    values_by_name: Mapping[str, Floats] = {}

    def redraw_runs(self, runs: int, seed: int) -> OneByOne:
        """Return the first `runs` runs of a seed, or one if all runs are equal."""
        sensor = self.first_problem.sensor
        noisy = sensor.noise.any() or sensor.noise_before.any()
        differ = noisy or random_disturbance(self.first_problem)
        return OneByOne(self.first_problem, runs if differ else 1, seed)

    def simulate_candidates(
        self, candidates: Sequence[Problem], threads: int | None = None
    ) -> Floats:
        """Return the metrics (candidates x runs x columns) of candidates (threads: not used)."""
        return np.stack(list(map(self._simulate_candidate, candidates)))

    def _simulate_candidate(self, candidate: Problem) -> Floats:
        """Return the metrics (runs x columns) of one candidate."""
        rows = []
        for run in range(self.runs):
            inputs = exogenous(candidate, run=run, seed=self.seed)
            rows.append(metrics_from_outputs(candidate, run_sample_by_sample(candidate, inputs)))
        return np.concatenate(rows)


def metrics_from_outputs(problem: Problem, out: Outputs) -> Floats:
    """Return the metrics (1 x columns) of a run, as `metrics.add_metrics` accumulates in the
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
        """Return a number as an array (1 x 1)."""
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
    scales = plant_scales(problem)
    length = t.size - tail.start
    return metrics.metric_rows(tally, states, scales, t.size, length, len(problem.tracked))


class Objective(NamedTuple):
    """Scenarios to be tuned together.

    Attributes:
        what: the table [tune]
        names: addresses of the numbers of a candidate
        scenarios: as they are, without a candidate's numbers
        frames: of each scenario
        threads: number of threads (None: one per processor)
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
            probes: candidates (rows) that move all numbers that others will move. The first one
                must be possible
            seed: of the runs

        Raises:
            InputError or a subclass
        """
        scenarios = range(len(self.scenarios))
        return self._replace(
            test_runs=tuple(self._build_test_runs(k, probes, seed) for k in scenarios)
        )

    def _build_test_runs(self, index: int, probes: Floats, seed: int) -> TestRuns | OneByOne:
        """Return the test runs of a scenario: on the lanes, unless its observer computes
        in Python.
        """
        first = resolve_scenario(self.candidate_scenario(index, probes[0]))
        _require_metric(self.what.metric, first)
        if first.observer.python is None:
            others = [self.candidate_problem(index, probe) for probe in probes[1:]]
            near = [problem for problem in others if problem is not None]
            return prepare_test_runs(first.scenario, near, self.what.runs, seed)
        vary = first.scenario.ensemble
        if vary is not None and vary.entries:
            require_graph(
                first.observer
            )  # no more than noise and disturbance can vary without a graph
        return OneByOne(first).redraw_runs(self.what.runs, seed)

    def candidate_scenario(self, index: int, point: Floats) -> Scenario:
        """Return a scenario with the numbers of a candidate."""
        values = dict(zip(self.names, point.tolist(), strict=True))
        return with_numbers(self.scenarios[index], values)

    def candidate_problem(self, index: int, point: Floats) -> Problem | None:
        """Return the problem of a candidate in a scenario, or None if refused."""
        try:
            return resolve_scenario(self.candidate_scenario(index, point))
        except (UndeadzoneError, np.linalg.LinAlgError):
            return None

    def candidate_problems(self, points: Floats) -> list[Problems | None]:
        """Return the problems of each candidate, one per scenario, or None for a refused
        candidate.

        Args:
            points: candidates x numbers
        """
        candidates: list[Problems | None] = []
        for point in points:
            each = [self.candidate_problem(k, point) for k in range(len(self.scenarios))]
            possible = tuple(problem for problem in each if problem is not None)
            candidates.append(possible if len(possible) == len(each) else None)
        return candidates

    def candidate_margins(self, candidates: Sequence[Problems | None]) -> Floats:
        """Return the least margin of each candidate's certificates.

        It is inf if no certificate is required, -inf for a candidate that is refused.
        """
        margins = np.full(len(candidates), np.inf)
        for k, problems in enumerate(candidates):
            if problems is None:
                margins[k] = -np.inf
            elif self.what.certified:
                margins[k] = min(map(certificate_margin, problems))
        return margins

    def candidate_costs(self, candidates: Sequence[Problems]) -> Floats:
        """Return the costs of candidates."""
        of_each = zip(*candidates, strict=True)
        return self.mean_scores(list(starmap(self.candidate_losses, enumerate(of_each))))

    def candidate_losses(self, index: int, candidates: Sequence[Problem]) -> Floats:
        """Return the losses of each candidate in each run of a scenario (candidates x
        runs).
        """
        runs = self.test_runs[index]
        return metric_losses(
            self.what.metric, runs, runs.simulate_candidates(candidates, self.threads)
        )

    def mean_scores(self, lost: Sequence[Floats]) -> Floats:
        """Return the mean over the scenarios of framed statistics.

        Args:
            lost: losses in each scenario (candidates x runs)
        """
        framed = []
        for each, frame in zip(lost, self.frames, strict=True):
            value = loss_statistic(self.what.statistic, each)
            framed.append((value - frame.zero) / (frame.one - frame.zero))
        return np.mean(framed, axis=0)

    def redraw_test_runs(self, runs: int, seed: int) -> Objective:
        """Return the same objective on the first `runs` runs of a different seed."""
        return self._replace(
            test_runs=tuple(each.redraw_runs(runs, seed) for each in self.test_runs)
        )


def _require_metric(metric: str, problem: Problem) -> None:
    """Raise InputError for a metric that the runs of a problem do not have."""
    columns = metrics.metric_names(problem.plant, problem.sensor.kind)
    known = [name for name in columns if name != "diverged" and not name.startswith("d_")]
    for i in range(problem.plant.p):
        known += [f"d_{edge}_error[{i}]" for edge in EDGES]
    if metric not in known:
        advice = suggest_name(metric, known, "Expected one of")
        raise InputError(f"tune.metric: found {metric!r}. {advice}")


def loss_statistic(name: str, lost: Floats) -> Floats:
    """Return the mean, or the loss of one of the runs, along the last axis."""
    if name == "mean":
        return lost.mean(axis=-1)
    share = 1.0 if name == "worst" else QUANTILES[name]
    return np.sort(lost, axis=-1)[..., int(np.ceil(lost.shape[-1] * share)) - 1]


def metric_losses(metric: str, runs: TestRuns | OneByOne, rows: Floats) -> Floats:
    """Return the size of a metric, finite but above LIMIT for runs that diverged, the more the
    faster.

    Args:
        metric: a column of `metrics`, or the error of a width such as `d_right_error[0]`
        runs: on which the rows were computed
        rows: of metrics (... x columns)
    """
    problem = runs.first_problem
    sensor = runs.first_problem.sensor
    names = metrics.metric_names(problem.plant, sensor.kind)
    columns = {name: rows[..., i] for i, name in enumerate(names)}
    if metric in columns:
        size = columns[metric]
    else:
        widths = interleave_widths(sensor)
        geared = sensor.kind == "gears"
        size = np.abs(width_error(metric, columns, widths, runs.values_by_name, geared))
    rate = _divergence_rate(columns, problem.scenario.simulation.step)
    return np.where(
        columns["diverged"] != 0,
        LIMIT * (1 + rate / (1 + rate)),
        np.minimum(np.nan_to_num(size, nan=LIMIT), LIMIT),
    )


def _divergence_rate(columns: Mapping[str, Floats], step: float) -> Floats:
    """Return the growth rate of |z - r|: the logarithm of its peak over the time of growth
    [1/s].
    """
    with np.errstate(over="ignore", invalid="ignore"):
        growth = np.log1p(np.nan_to_num(columns["peak_tracking"], nan=0.0))
        return np.asarray(growth / np.maximum(columns["settling_time"], step))


def certificate_margin(problem: Problem) -> float:
    """Return the margin of the certificate, below 0 for gains without a certificate.

    Raises InputError.
    """
    gains = constant_gains(problem.observer, problem.model)
    if gains is None:
        raise InputError(
            "tune.certified: this observer has no constant gains L and gamma to certify. "
            "Leave certified out, or use method = certified"
        )
    if problem.model.nonlinear:
        raise InputError(
            "tune.certified: a nonlinear model has no certificate. Leave certified out"
        )
    proof = certify(problem.model.linear, *gains, problem.model.Ts)
    return proof.margin if proof.certified else min(proof.margin, -1e-9)
