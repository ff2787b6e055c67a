"""Candidates run by run, for observers that compute in Python: runs and metrics as on lanes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from undeadzone.ensemble import metrics
from undeadzone.ensemble.metrics import Tally
from undeadzone.interfaces import graph_of
from undeadzone.results.run import last_samples
from undeadzone.results.scales import plant_scales
from undeadzone.scenario.ensemble_table import Vary
from undeadzone.scenario.problem import Problem
from undeadzone.simulation.collect import tips
from undeadzone.simulation.exogenous import exogenous, random_disturbance
from undeadzone.simulation.loop import Outputs
from undeadzone.simulation.sample_by_sample import run_sample_by_sample
from undeadzone.support.arrays import Floats


class OneByOne(NamedTuple):
    """Runs that differ in their noise and random disturbance alone.

    Attributes:
        problem: of the first candidate
        runs: how many: the first ones of the seed
        seed: of noise and disturbance
    """

    problem: Problem
    runs: int
    seed: int

    @property
    def varied(self) -> dict[str, Floats]:
        """Nothing: see `candidates.TestRuns.varied`."""
        return {}

    def redrawn(self, runs: int, seed: int) -> OneByOne:
        """Other runs: the first `runs` of a seed; one if nothing differs between them."""
        sensor = self.problem.sensor
        noisy = sensor.noise.any() or sensor.noise_before.any()
        differ = noisy or random_disturbance(self.problem)
        return OneByOne(self.problem, runs if differ else 1, seed)

    def rows(self, candidates: Sequence[Problem], threads: int | None = None) -> Floats:
        """The metrics (candidates x runs x columns) of candidates; threads: not used."""
        return np.stack([self._rows_of(candidate) for candidate in candidates])

    def _rows_of(self, candidate: Problem) -> Floats:
        """The metrics (runs x columns) of one candidate."""
        rows = []
        for run in range(self.runs):
            inputs = exogenous(candidate, run=run, seed=self.seed)
            rows.append(row(candidate, run_sample_by_sample(candidate, inputs)))
        return np.concatenate(rows)


def one_by_one(problem: Problem) -> OneByOne:
    """The runs of a problem, none yet. Raises InputError if [ensemble] varies anything."""
    vary = problem.scenario.ensemble
    if vary is not None and vary.entries:
        graph_of(problem.observer)
    return OneByOne(problem, 0, 0)


def row(problem: Problem, out: Outputs) -> Floats:
    """The metrics (1 x columns) of one run, as `metrics.measured` accumulates them in the loop."""
    t = np.arange(len(out.z)) * problem.scenario.simulation.step
    tail = last_samples(t)
    r = problem.reference.value(t)
    error = out.z[:, problem.tracked] - r
    worst = np.abs(error).max(axis=1)
    tolerance = (problem.scenario.ensemble or Vary()).tolerance * np.abs(r).max()
    poses = tips(problem, out.x, out.estimate.x, t)
    tip: Floats = np.empty((1, 0))
    if poses:
        tip = _one_number(((poses["tip"] - poses["tip_r"])[tail] ** 2).sum())
    tally = Tally(
        tracking=_one_number((error[tail] ** 2).sum()),
        estimation=_one_number(((out.z - out.estimate.z)[tail] ** 2).sum()),
        peak=_one_number(np.fmax.reduce(worst)),
        settled=_one_number(t[worst > tolerance].max(initial=0.0)),
        silent=_one_number((out.side == 0).sum()),
        effort=_one_number((out.u**2).sum()),
        right=out.estimate.right[-1:],
        left=out.estimate.left[-1:],
        tip=tip,
        behind=np.empty((1, 0)),  # no observer that computes in Python knows a play
    )
    states = np.hstack([out.x, out.estimate.x, out.estimate.right, out.estimate.left])[-1:]
    scales, length = plant_scales(problem), t.size - tail.start
    return metrics.rows(tally, states, scales, t.size, length, len(problem.tracked))


def _one_number(value: Any) -> Floats:
    """A number of one run (1 x 1)."""
    return np.array([[value]])
