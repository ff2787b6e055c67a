"""Honest verdicts for nonlinear plants: which widths the readings along one run tell, and why not (docs/identifiability.md)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from undeadzone.analysis.identifiability.information import EXACT
from undeadzone.analysis.identifiability.linear import DIRECTIONS, Verdict, unreached, verdicts
from undeadzone.analysis.identifiability.observability import (
    Observability,
    observability,
    symmetric,
)
from undeadzone.analysis.side_schedule import reading_levels, recorded
from undeadzone.plants.system import System
from undeadzone.sensor import Zone, zone
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
) -> list[Verdict]:
    """What the readings along a run of states x (N x n), inputs u (N x m) and outputs z (N x p), `step` [s] apart, tell of each output's widths.

    bias: directions (m x b) of unknown constant inputs; uncertain: names of parameters that are unknown; prior (n): standard deviation
    of x(0) as far as it is known beforehand, infinite where it is not. A width is not known either where the expected
    deviation exceeds it. Only the part of a run before it diverges counts.
    """
    diverged = np.flatnonzero(~(np.abs(np.hstack([x, u])).max(axis=1) < LIMIT))
    whole = slice(max(1, int(diverged[0])) if diverged.size else None)
    schedule = recorded(z[whole], sensor, step, model.Ts)
    if sensor.kind == "jump":
        return verdicts(model.linear, schedule, jump=True)
    side = zone(z[whole], *reading_levels(sensor).T)
    found = observability(
        model, x[whole], u[whole], side, step, variance(sensor), bias, uncertain, prior
    )
    visited = np.stack([(side > 0).any(axis=0), (side < 0).any(axis=0)], axis=1)
    biases = 0 if bias is None else bias.shape[1]
    given = []
    for i, (right, left) in enumerate(zip(sensor.right, sensor.left, strict=True)):
        std, swing = found.std(i), float(np.ptp(z[whole, i]))
        most = {
            name: float(size) or swing
            for name, size in (
                ("right", right),
                ("left", left),
                ("width", right + left),
                ("centre", right + left),
            )
        }
        vague = [
            f"{name} {std[name]:.3g}" for name in DIRECTIONS if most[name] < std[name] < np.inf
        ]
        said = [
            f"practically not: noise leaves larger deviations than the widths ({right:.3g}, {left:.3g}) to {', '.join(vague)}"
        ] * bool(vague)
        why = (
            *unreached(schedule, visited, i),
            *_confounded(model, found, visited[i], i, biases, uncertain),
            *said,
        )
        given.append(
            Verdict(**{name: std[name] <= most[name] for name in DIRECTIONS}, reasons=why, std=std)
        )
    return given


def variance(sensor: Zone) -> Floats:
    """Of a reading's noise (p), as noise of z; never 0."""
    level = reading_levels(sensor).max(axis=1)
    return np.maximum(sensor.rms, EXACT * np.where(level > 0, level, 1.0)) ** 2


def _confounded(
    model: System,
    found: Observability,
    visited: np.ndarray,
    i: int,
    biases: int,
    uncertain: Sequence[str],
) -> list[str]:
    """Why widths of output i stay unknown although their sides are visited."""
    hidden, columns = found.hidden, np.arange(found.hidden.scale.size)
    edges = [name for name, seen in zip(("right", "left"), visited, strict=True) if seen]
    lost = [name for name in edges if not hidden.width(i, name)]
    if not lost:
        return []
    width = len(edges) == 2 and hidden.width(i, "width")
    what = "centre" if width else " and ".join(f"{name} edge" for name in lost)
    left = (
        "only the width d_r + d_l can be known"
        if width
        else f"the {what} cannot be told from a shift of the state"
    )
    start = f"the {'centre' if width or len(edges) == 1 else 'width'} is not identifiable: "
    for some, words in (
        (
            (columns >= 2 * model.p) & (columns < 2 * model.p + biases),
            f"constant input bias, {what} and bias cannot be told apart",
        ),
        (
            columns >= 2 * model.p + biases,
            f"with {', '.join(uncertain)} uncertain the {what} cannot be told from them",
        ),
    ):
        if some.any() and all(hidden.within(~some).width(i, name) for name in edges):
            return [start + words]
    own = hidden.within(columns // 2 == i)
    alone = not own.width(i, lost[0])
    basis = own.basis if alone else hidden.basis
    change = found.follow @ (hidden.scale * (basis @ basis[2 * i + (lost[0] == "left")]))
    change = np.where(np.abs(change) > SHARE * np.abs(change).max(), change, 0.0)
    if not change.any():
        return [f"{start}the {what}, bias and parameters cannot be told apart"]
    names = " and ".join(_states(model)[j] for j in np.flatnonzero(change))
    if not alone:
        return [
            f"{start}along this run {names} can shift together with edges of several outputs and no reading changes"
        ]
    if symmetric(model, change):
        return [
            f"{start}a change of {names} as a whole alters no motion (no gravity, no spring), {left}; {CURES}"
        ]
    return [
        f"{start}along this run {names} can shift with the edges and no reading changes, {left}; another motion may tell, else {CURES}"
    ]


def _states(model: System) -> list[str]:
    """What the states are, in words."""
    joints = () if model.arm is None else model.arm.chain.joints
    if 2 * len(joints) != model.n:
        return [f"x[{j}]" for j in range(model.n)]
    return [f"the {what} of joint {name}" for what in ("position", "speed") for name in joints]
