"""Example runs of the best, the worst, the paper's and the naive method.

They are shown on the scenario on which the best method has its typical regret.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from undeadzone.errors import UndeadzoneError
from undeadzone.util.arrays import Floats
from undeadzone_arena.contest.contest import Contest
from undeadzone_arena.contest.leaderboard import CAP, NAIVE, compute_regrets

PAPER: Final = "printed"


class Trace(NamedTuple):
    """Run of one method: the first tracked output.

    Attributes:
        method: its name.
        scenario: its title.
        t: time (N) [s].
        z: true output (N) [z].
        z_hat: its estimate (N) [z].
        r: its reference (N) [z].
        widths: d_r, d_l at t = 0 [z].
    """

    method: str
    scenario: str
    t: Floats
    z: Floats
    z_hat: Floats
    r: Floats
    widths: Floats


def typical_scenario(contest: Contest) -> str:
    """Return the scenario on which the best method's regret is nearest to its median.

    It is one of those with a dead zone if there are any. There must be a contestant.
    """
    each = compute_regrets(contest.results)[contest.contestants[0].method].mean(axis=1)
    other_sensor = [scenario.sensor.kind != "deadzone" for scenario in contest.scenarios.values()]
    distance = np.abs(each - np.nanmedian(each)) + CAP * np.array(other_sensor)
    return list(contest.scenarios)[int(np.nanargmin(distance))]


def trace_runs(contest: Contest, title: str | None = None) -> list[Trace]:
    """Run the best, the worst that never diverged, the paper's and the naive method.

    Those that are not applicable are left out.

    Args:
        contest: whose methods.
        title: of the scenario (None: the typical one).
    """
    if not contest.contestants:
        return []
    title = typical_scenario(contest) if title is None else title
    traces = []
    for method in _methods_to_trace(contest):
        try:
            traces.append(_trace_run(contest, method, title))
        except UndeadzoneError:
            continue
    return traces


def _methods_to_trace(contest: Contest) -> list[str]:
    """Return the methods whose runs are shown, each once."""
    contestants = contest.contestants
    eligible = [row.method for row in contestants if not row.diverged and not row.not_applicable]
    if not eligible:
        eligible = [contestants[0].method]
    paper = [row.method for row in contest.rows if row.method == PAPER]
    return list(dict.fromkeys([eligible[0], eligible[-1], *paper, NAIVE]))


def _trace_run(contest: Contest, method: str, title: str) -> Trace:
    """Run a method on a scenario. Raises InputError if the method is not applicable."""
    problem, out = contest.replay(method, title)
    t = np.arange(len(out.z)) * problem.scenario.simulation.step
    i = problem.tracked[0]
    return Trace(
        method=method,
        scenario=contest.scenarios[title].title,
        t=t,
        z=out.z[:, i],
        z_hat=out.estimate.z[:, i],
        r=problem.reference.output_at(t)[:, 0],
        widths=np.array([problem.sensor.right[i], problem.sensor.left[i]]),
    )
