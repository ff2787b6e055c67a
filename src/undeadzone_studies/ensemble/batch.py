"""Runs of an ensemble on the lanes engine: a row of values and metrics for each run."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from undeadzone.compile import lanes
from undeadzone.results.run import last_samples
from undeadzone.results.scales import plant_scales
from undeadzone.scenario.ensemble_table import Vary
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.exogenous import exogenous as exogenous_inputs
from undeadzone.simulation.loop import Loop
from undeadzone.simulation.packed import Lanes
from undeadzone.simulation.simulate import close_problem
from undeadzone.util import toml, tree
from undeadzone.util.arrays import Floats, Integers
from undeadzone_studies.ensemble import metrics
from undeadzone_studies.ensemble.binding import (
    Binding,
    RunNoise,
    bind_ensemble,
    build_run_noise,
)
from undeadzone_studies.ensemble.job import Layout
from undeadzone_studies.ensemble.metrics import LoopWithMetrics, Tally

BLOCK = 16 * lanes.WIDTH  # runs that are computed, and kept, together


class Batch(NamedTuple):
    """Runs of a scenario, ready to be computed: a `Job`.

    Attributes:
        layout: number of runs, names of the columns, size of a block
        problem: the scenario, checked and built, at its nominal numbers
        loop: plant, sensor, observer and controller as one graph
        binding: what varies, bound to the loop
        measured: the loop with its metrics
        kernel: the same, compiled
        exogenous: inputs that all runs share (N x inputs) (the last two columns are time [s] and 1
            in the tail, else 0)
        params: nominal, packed. The last one is the tolerance [z]
        own: what each run draws for itself
        tail: number of samples in the last 2 s
    """

    layout: Layout
    problem: Problem
    loop: Loop
    binding: Binding
    measured: LoopWithMetrics
    kernel: lanes.Kernel
    exogenous: Floats
    params: Floats
    own: RunNoise
    tail: int

    def block(self, index: int, threads: int | None = None) -> Floats:
        """Return the rows of one block, on that many threads (default: one per processor)."""
        runs = np.array(self.layout.runs_in_block(index))
        values = self.binding.draw_columns(int(runs[0]), runs.size, self.layout.runs)
        return self.rows_of_runs(runs, values, threads)

    def rows_of_runs(self, runs: Integers, values: Floats, threads: int | None = None) -> Floats:
        """Return the values and metrics of runs (runs x columns).

        Args:
            runs: their numbers
            values: of what varies (runs x columns)
            threads: default one per processor
        """
        return np.hstack(
            [values, self.measure_lanes(runs, self.binding.numbers.to_lanes(values), threads)]
        )

    def measure_lanes(self, runs: Integers, own: Lanes, threads: int | None = None) -> Floats:
        """Return the metrics of lanes (lanes x metrics).

        Args:
            runs: the number of the run whose noise each lane has
            own: the states and params of each lane
            threads: default one per processor
        """
        _, finals = self.execute_kernel(self.kernel, runs, own, threads=threads)
        states, tallied = np.split(finals, [own.states.shape[1]], axis=1)
        tally: Tally = tree.unpack_columns(self.measured.tally, tallied)
        samples = len(self.exogenous)
        tracked = len(self.problem.tracked)
        scales = plant_scales(self.problem)
        return metrics.metric_rows(tally, states, scales, samples, self.tail, tracked)

    def execute_kernel(
        self, kernel: lanes.Kernel, runs: Integers, own: Lanes, **options: Any
    ) -> tuple[Floats, Floats]:
        """Return the records of a kernel for lanes, and their last states with the tally.

        Args:
            kernel: that of the batch, or one that is called in its place
            runs, own: as of `measure_lanes`
            options: of `lanes.run`
        """
        nothing_yet = np.zeros((len(own.states), tree.count_numbers(self.measured.tally)))
        start = np.hstack([own.states, nothing_yet])
        noise = self.own.noise_supply(runs)
        return lanes.run_lanes(
            kernel, start, self.exogenous, self.params, noise, own.params, **options
        )


def prepare_batch(scenario: Scenario, moved: Iterable[int] = ()) -> Batch:
    """Return the batch of a scenario's [ensemble].

    Args:
        scenario: with or without the table [ensemble]
        moved: packed params that each lane has for itself though they do not vary

    Raises:
        InputError or a subclass
    """
    problem = resolve_scenario(scenario)
    loop = close_problem(problem)
    binding = bind_ensemble(problem, loop)
    indices = tuple(sorted({*binding.numbers.indices, *moved}))
    binding = binding._replace(numbers=binding.numbers._replace(indices=indices))
    vary = problem.scenario.ensemble or Vary()
    measured = metrics.add_metrics(loop, problem)
    shared = exogenous_inputs(problem, run=None)
    t = np.arange(len(shared)) * scenario.simulation.step
    tail = np.zeros(t.size)
    tail[last_samples(t)] = 1.0
    largest = np.abs(problem.reference.output_at(t)).max()
    params = np.append(binding.numbers.params, vary.tolerance * largest)
    own = build_run_noise(problem, loop, binding)
    kernel = lanes.build_kernel(
        measured.step,
        measured.rare,
        exogenous=own.entries,
        params=binding.numbers.indices,
        record=[],
        known_exogenous=constant_zero_inputs(shared, own.entries),
        known_params=constant_params(params, binding.numbers.indices),
        fused=True,
    )
    names = (*binding.names_of_columns, *metrics.metric_names(problem.plant, problem.sensor.kind))
    exogenous = np.column_stack([shared, t, tail])
    digest = hashlib.sha256(exogenous.tobytes() + params.tobytes()).hexdigest()
    layout = Layout(
        vary.runs, names, BLOCK, {"scenario": toml.to_toml(scenario), "numbers": digest}
    )
    return Batch(
        layout, problem, loop, binding, measured, kernel, exogenous, params, own, int(tail.sum())
    )


def constant_zero_inputs(shared: Floats, own: tuple[int, ...]) -> dict[int, float]:
    """Return the exogenous inputs that are 0 throughout and for all runs.

    A kernel that knows them is shorter.

    Args:
        shared: inputs that all runs share (N x inputs)
        own: the inputs that each run has for itself
    """
    columns = enumerate(shared.T)
    return {i: 0.0 for i, column in columns if i not in own and not column.any()}


def constant_params(params: Floats, varied: tuple[int, ...]) -> dict[int, float]:
    """Return the zeros and ones among the constant packed params (which shorten a kernel, too)."""
    values = enumerate(params.tolist())
    return {i: value for i, value in values if i not in varied and value in (0.0, 1.0)}
