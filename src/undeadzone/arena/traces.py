"""Runs worth seeing: of the best method, the worst, the paper's and the naive one, on the scenario where the best does as it usually does."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from undeadzone.arena.contest import Contest
from undeadzone.arena.leaderboard import CAP, FRAME, regrets
from undeadzone.errors import UndeadzoneError
from undeadzone.support.arrays import Floats

PAPER: Final = "printed"


class Trace(NamedTuple):
    """A run of one method: t [s]; true output, its estimate and its reference (N each), of the first tracked output; its d_r, d_l at t = 0."""

    method: str
    scenario: str
    t: Floats
    z: Floats
    z_hat: Floats
    r: Floats
    widths: Floats


def typical(contest: Contest) -> str:
    """The scenario on which the regret of the best method is nearest to its median, of those with a dead zone if there are any. There must be a contestant."""
    each = regrets(contest.results)[contest.contestants[0].method].mean(axis=1)
    distance = np.abs(each - np.nanmedian(each)) + np.array(
        [CAP * (scenario.sensor.kind != "deadzone") for scenario in contest.scenarios.values()]
    )
    return list(contest.scenarios)[int(np.nanargmin(distance))]


def traced(contest: Contest, title: str | None = None) -> list[Trace]:
    """Runs of the best, of the worst that never diverged, the paper's and the naive one on a scenario (default: the typical one); those applicable."""
    if not contest.contestants:
        return []
    title = typical(contest) if title is None else title
    kept = [
        row.method for row in contest.contestants if not row.diverged and not row.not_applicable
    ] or [contest.contestants[0].method]
    paper = [row.method for row in contest.rows if row.method == PAPER]
    found = []
    for method in dict.fromkeys([kept[0], kept[-1], *paper, FRAME[1]]):
        try:
            problem, out = contest.replay(method, title)
        except UndeadzoneError:
            continue
        t, i = np.arange(len(out.z)) * problem.scenario.simulation.step, problem.tracked[0]
        widths = np.array([problem.sensor.right[i], problem.sensor.left[i]])
        found.append(
            Trace(
                method,
                contest.scenarios[title].title,
                t,
                out.z[:, i],
                out.estimate.z[:, i],
                problem.reference.value(t)[:, 0],
                widths,
            )
        )
    return found
