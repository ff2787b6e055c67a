"""Honest verdicts for nonlinear plants: which widths the readings along one run tell, and why not.

docs/identifiability.md says how.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from undeadzone.analysis.identifiability.beforehand import beforehand
from undeadzone.analysis.identifiability.edges import (
    largest_deviations,
    rarely_exact,
    unreached,
    vague,
)
from undeadzone.analysis.identifiability.information import EXACT
from undeadzone.analysis.identifiability.linear import (
    DIRECTIONS,
    Invisible,
    Verdict,
    verdicts,
)
from undeadzone.analysis.identifiability.linearised_run import symmetric
from undeadzone.analysis.identifiability.observability import Observability, observability
from undeadzone.analysis.reading_levels import reading, reading_levels
from undeadzone.analysis.side_schedule import recorded
from undeadzone.plants.system import System
from undeadzone.sensor import Zone
from undeadzone.support.arrays import Floats

LIMIT = 1e9  # beyond this a state has diverged
SHARE = 1e-3  # of the largest change: less is not named
CURES = "a known start, an absolute reference pulse, a spring or gravity would tell"


def verdicts_along(
    model: System,
    x: Floats,
    u: Floats,
    z: Floats,
    sensor: Zone,
    step: float,
    bias: Floats | None = None,
    uncertain: Sequence[str] = (),
    prior: Floats | None = None,
    arrived: np.ndarray | None = None,
    centre: Floats | None = None,
) -> list[Verdict]:
    """What the readings along a run tell of each output's widths.

    A width is not known either where the expected deviation exceeds it. Only the part of a run
    before it diverges counts.

    Args:
        model: the plant (n states, m inputs, p outputs).
        x: states (N x n).
        u: inputs (N x m).
        z: outputs (N x p).
        sensor: the dead zone.
        step: time between two rows [s].
        bias: directions (m x b) of unknown constant inputs.
        uncertain: names of parameters that are unknown.
        prior: standard deviation of x(0) as far as it is known beforehand, infinite where it is
            not (n).
        arrived: whether each reading did (N x p); all of them if not given.
        centre: standard deviations of d_r - d_l as far as it is known beforehand (p), likewise.
    """
    if arrived is None:
        arrived = np.ones(z.shape, dtype=bool)
    diverged = np.flatnonzero(~(np.abs(np.hstack([x, u])).max(axis=1) < LIMIT))
    whole = slice(max(1, int(diverged[0])) if diverged.size else None)
    x, u, z, arrived = x[whole], u[whole], z[whole], arrived[whole]
    schedule = recorded(z, sensor, step, model.Ts, arrived)
    if sensor.kind == "jump":
        return verdicts(model.linear, schedule, jump=True)
    side = np.where(arrived, reading(z, sensor).side, 0.0)
    told = beforehand(model.n, model.p, prior, centre, float(np.sqrt(variance(sensor).min())))
    known = observability(model, x, u, side, step, variance(sensor), bias, uncertain, told)
    visited = np.stack([(side > 0).any(axis=0), (side < 0).any(axis=0)], axis=1)
    biases = 0 if bias is None else bias.shape[1]
    judged = []
    for i, (right, left) in enumerate(zip(sensor.right, sensor.left, strict=True)):
        std, most = known.std(i), largest_deviations(right, left, float(np.ptp(z[:, i])))
        reasons = (
            *unreached(schedule, visited, i),
            *_confounded(model, known, visited[i], i, biases, uncertain),
            *vague(std, most, right, left),
            *rarely_exact(schedule, i),
        )
        enough = {name: std[name] <= most[name] for name in DIRECTIONS}
        judged.append(Verdict(**enough, reasons=reasons, std=std))
    return judged


def variance(sensor: Zone) -> Floats:
    """Of a reading's noise (p), as noise of z; never 0."""
    level = reading_levels(sensor).max(axis=1)
    return np.maximum(sensor.rms, EXACT * np.where(level > 0, level, 1.0)) ** 2


def _confounded(
    model: System,
    known: Observability,
    visited: np.ndarray,
    i: int,
    biases: int,
    uncertain: Sequence[str],
) -> list[str]:
    """Why widths of output i stay unknown although their sides are visited."""
    hidden = known.hidden
    edges = [name for name, seen in zip(("right", "left"), visited, strict=True) if seen]
    lost = [name for name in edges if not hidden.width(i, name)]
    if not lost:
        return []
    width = len(edges) == 2 and hidden.width(i, "width")
    what = "centre" if width else " and ".join(f"{name} edge" for name in lost)
    whole = "centre" if width or len(edges) == 1 else "width"
    start = f"the {whole} is not identifiable: "
    number = np.arange(hidden.scale.size)  # of each constant: widths, then biases, then parameters
    of_bias = (number >= 2 * model.p) & (number < 2 * model.p + biases)
    if _caused_by(of_bias, hidden, i, edges):
        return [f"{start}constant input bias, {what} and bias cannot be told apart"]
    if _caused_by(number >= 2 * model.p + biases, hidden, i, edges):
        names = ", ".join(uncertain)
        return [f"{start}with {names} uncertain the {what} cannot be told from them"]
    rest = f"the {what} cannot be told from a shift of the state"
    if width:
        rest = "only the width d_r + d_l can be known"
    return [start + _state_shift(model, known, i, lost[0], what, rest)]


def _caused_by(part: np.ndarray, hidden: Invisible, i: int, edges: list[str]) -> bool:
    """Whether edges of output i would be known if these unknowns were (part: bool, one each)."""
    return bool(part.any()) and all(hidden.within(~part).width(i, name) for name in edges)


def _state_shift(
    model: System, known: Observability, i: int, lost: str, what: str, rest: str
) -> str:
    """Which shift of the state hides an edge (`lost`) of output i, in words.

    what: what is lost; rest: what can be known nevertheless.
    """
    hidden = known.hidden
    own = hidden.within(np.arange(hidden.scale.size) // 2 == i)
    alone = not own.width(i, lost)  # whether it can shift while other outputs' widths stay
    basis = own.basis if alone else hidden.basis
    row = 2 * i + (lost == "left")
    change = known.follow @ (hidden.scale * (basis @ basis[row]))
    change = np.where(np.abs(change) > SHARE * np.abs(change).max(), change, 0.0)
    if not change.any():
        return f"the {what}, bias and parameters cannot be told apart"
    names = " and ".join(_states(model)[j] for j in np.flatnonzero(change))
    if not alone:
        return (
            f"along this run {names} can shift together with edges of several outputs "
            "and no reading changes"
        )
    if symmetric(model, change):
        return (
            f"a change of {names} as a whole alters no motion (no gravity, no spring), "
            f"{rest}; {CURES}"
        )
    return (
        f"along this run {names} can shift with the edges and no reading changes, {rest}; "
        f"another motion may tell, else {CURES}"
    )


def _states(model: System) -> list[str]:
    """What the states are, in words."""
    joints = () if model.arm is None else model.arm.chain.joints
    if 2 * len(joints) != model.n:
        return [f"x[{j}]" for j in range(model.n)]
    positions = [f"the position of joint {name}" for name in joints]
    return positions + [f"the speed of joint {name}" for name in joints]
