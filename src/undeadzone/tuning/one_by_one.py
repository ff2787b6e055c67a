"""Candidates run by run, for observers that compute in Python: slow, but the same runs and the same metrics as on the lanes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from undeadzone.ensemble import metrics
from undeadzone.ensemble.metrics import Tally
from undeadzone.interfaces import NumericObserver, graph_of
from undeadzone.scenario.ensemble_table import Vary
from undeadzone.scenario.problem import Problem
from undeadzone.simulation import exogenous as inputs
from undeadzone.simulation import sample_by_sample as live
from undeadzone.simulation.collect import tips
from undeadzone.simulation.loop import Outputs
from undeadzone.simulation.run import last_samples
from undeadzone.support.arrays import Floats


class OneByOne(NamedTuple):
    """The first `runs` runs of a seed, which differ in their noise and random disturbance alone."""

    problem: Problem
    runs: int
    seed: int

    @property
    def varied(self) -> dict[str, Floats]:
        """Nothing: see `candidates.TestRuns.varied`."""
        return {}

    def redrawn(self, runs: int, seed: int) -> OneByOne:
        """Other runs: the first `runs` of a seed; one if nothing differs between them."""
        alike = not (
            self.problem.sensor.noise.any()
            or self.problem.sensor.noise_before.any()
            or inputs.random_disturbance(self.problem)
        )
        return OneByOne(self.problem, 1 if alike else runs, seed)

    def rows(self, candidates: Sequence[Problem], threads: int | None = None) -> Floats:
        """The metrics (candidates x runs x columns) of candidates."""
        return np.stack(
            [
                np.concatenate([self._row(candidate, run) for run in range(self.runs)])
                for candidate in candidates
            ]
        )

    def _row(self, candidate: Problem, run: int) -> Floats:
        assert isinstance(candidate.observer, NumericObserver)
        return row(
            candidate,
            live.run_sample_by_sample(
                candidate, candidate.observer, inputs.exogenous(candidate, run=run, seed=self.seed)
            ),
        )


def singles(problem: Problem) -> OneByOne:
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
    place = tips(problem, out.x, out.estimate.x, t)
    tolerance = (problem.scenario.ensemble or Vary()).tolerance * np.abs(r).max()
    tally = Tally(
        tracking=np.array([[(error[tail] ** 2).sum()]]),
        estimation=np.array([[((out.z - out.estimate.z)[tail] ** 2).sum()]]),
        peak=np.array([[np.fmax.reduce(worst)]]),
        settled=np.array([[t[worst > tolerance].max(initial=0.0)]]),
        silent=np.array([[(out.side == 0).sum()]]),
        effort=np.array([[(out.u**2).sum()]]),
        right=out.estimate.right[-1:],
        left=out.estimate.left[-1:],
        tip=np.array([[((place["tip"] - place["tip_r"])[tail] ** 2).sum()]])
        if place
        else np.empty((1, 0)),
    )
    states = np.hstack([out.x, out.estimate.x, out.estimate.right, out.estimate.left])[-1:]
    return metrics.rows(tally, states, t.size, t.size - tail.start, len(problem.tracked))
