"""What readings can tell of x, d_r, d_l along a schedule of sides, and what change of the reference would tell more.

Proofs in docs/identifiability.md. The unknowns are [x(0); d; beta], d = [right, left] per output, beta a constant input bias.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.analysis.error_dynamics import delta, pattern
from undeadzone.analysis.side_schedule import Schedule
from undeadzone.linear.matrices import Matrices
from undeadzone.linear.scaling import sizes
from undeadzone.signals.exosystem import Disturbance, Step
from undeadzone.support.arrays import Floats

TOLERANCE = 1e-11  # of singular values of balanced, normalised matrices; the rounding of a sampled model comes on top
PRESENT = 1e-7  # see `Invisible`
MARGIN = 0.05  # by which a cure passes an edge, relative to the edge
DIRECTIONS = {"right": (1.0, 0.0), "left": (0.0, 1.0), "width": (1.0, 1.0), "centre": (1.0, -1.0)}


class Invisible(NamedTuple):
    """Changes of the unknowns that no reading shows: orthonormal columns of `basis` (n + 2p + b, k), times `scale` by rows.

    present: least component of a unit vector that counts.
    """

    basis: Floats
    scale: Floats
    n: int
    present: float = PRESENT

    def state(self, i: int) -> bool:
        """Whether state i is determined nevertheless."""
        return not bool((np.abs(self.basis[i]) > self.present).any())

    def width(self, i: int, name: str) -> bool:
        """Whether `right`, `left`, `width` = d_r + d_l or `centre` = d_r - d_l of output i is determined nevertheless."""
        first = self.n + 2 * i
        return not bool(
            (
                np.abs(np.array(DIRECTIONS[name]) @ self.basis[first : first + 2]) > self.present
            ).any()
        )

    def within(self, part: np.ndarray) -> Invisible:
        """Those that leave every unknown outside `part` (bool) as it is."""
        return self._replace(basis=self.basis @ _null(self.basis[~part], self.present))

    @property
    def names(self) -> tuple[str, ...]:
        """What is not determined, in words."""
        outputs = range((self.scale.size - self.n) // 2)
        found = [f"x[{i}]" for i in range(self.n) if not self.state(i)]
        for i in outputs:
            lost = [name for name in DIRECTIONS if not self.width(i, name)]
            found += [
                f"{name}[{i}]"
                for name in (
                    ["centre"]
                    if lost and "width" not in lost
                    else [name for name in lost if name in ("right", "left")]
                )
            ]
        return tuple(found)


class Verdict(NamedTuple):
    """Whether readings determine d_r, d_l, d_r + d_l and d_r - d_l of one output; the reason for each 'no' in words.

    std: the deviation that an optimal estimator reaches of each, by name, where noise is taken into account.
    """

    right: bool
    left: bool
    width: bool
    centre: bool
    reasons: tuple[str, ...]
    std: dict[str, float] | None = None


class Cure(NamedTuple):
    """The smallest change of the reference that makes an output reach its edges, in words too.

    The output's deviation from its mean times `factor`, or the output plus `shift`; neither where no reference helps.
    """

    output: int
    factor: float | None
    shift: float | None
    text: str


def invisible(
    linear: Matrices,
    visited: np.ndarray,
    Ts: float | None = None,
    bias: Floats | None = None,
    jump: bool = False,
) -> Invisible:
    """The changes of [x(0); d; beta] that no reading shows, given which [right, left] sides are visited (p x 2, bool).

    They solve A x + B_b beta in U, C_i x = d_ri and C_i x = -d_li on the visited sides, where U is the subspace that the
    visited outputs do not observe: when and for how long a side is visited makes no difference. Sampled (Ts), A and
    bias = B_b (n x b, like B) are those of one step. A jump sensor's readings do not hold d at all.
    """
    A, C = delta(linear, Ts), linear.C
    n, p = A.shape[0], C.shape[0]
    B = np.zeros((n, 0)) if bias is None else bias
    state = 1 / sizes(A.T, C.T)
    A, C, B = A / state[:, None] * state, C * state, B / state[:, None]
    rounding = 0.0 if Ts is None else 1e3 * np.finfo(float).eps / Ts
    rate, output, drive = (
        max(float(np.linalg.norm(A, 2)), 1e6 * rounding, 1e-300),
        np.linalg.norm(C, axis=1),
        np.maximum(np.linalg.norm(B, axis=0), 1e-300),
    )
    A, C, B, tolerance = A / rate, C / output[:, None], B / drive, TOLERANCE + rounding / rate
    U = _unobservable(A, C[visited.any(axis=1)], tolerance)
    beyond = np.eye(n) - U @ U.T
    rows = [np.hstack([beyond @ A, np.zeros((n, 2 * p)), beyond @ B])]
    for sides in (visited[:, 0] * 1, visited[:, 1] * -1):
        S = 0 * pattern(tuple(sides)) if jump else pattern(tuple(sides))
        rows.append(np.hstack([C * np.abs(sides)[:, None], -S, np.zeros((p, B.shape[1]))]))
    return Invisible(
        _null(np.vstack(rows), tolerance),
        np.concatenate([state, np.repeat(output, 2), rate / drive]),
        n,
    )


def verdicts(
    linear: Matrices, schedule: Schedule, bias: Floats | None = None, jump: bool = False
) -> list[Verdict]:
    """What the readings along a schedule tell of each output's widths; bias: directions (n x b) of unknown constant inputs."""
    visited = schedule.visited(linear.A.shape[0])
    if jump:
        return [
            Verdict(
                bool(r),
                bool(l),
                bool(r and l),
                bool(r and l),
                tuple(unreached(schedule, visited, i)),
            )
            for i, (r, l) in enumerate(visited)
        ]
    hidden = invisible(linear, visited, schedule.Ts, bias)
    reasons = [
        (*unreached(schedule, visited, i), *_confounded(linear, schedule, bias, i))
        for i in range(visited.shape[0])
    ]
    return [
        Verdict(**{name: hidden.width(i, name) for name in DIRECTIONS}, reasons=why, std=None)
        for i, why in enumerate(reasons)
    ]


def cures(
    linear: Matrices, schedule: Schedule, bias: Floats | None = None, jump: bool = False
) -> list[Cure]:
    """What would turn the 'no' of `verdicts` into a 'yes'; nothing where there is none."""
    visited = schedule.visited(linear.A.shape[0])
    help_ = (
        "no reference can: {}, or add a sensor without a dead zone; or assume the centre, d_r - d_l"
    )
    found = []
    for i in range(visited.shape[0]):
        if not visited[i].all():
            found.append(_reach(schedule, i))
        if not jump:
            found += [
                Cure(i, None, None, help_.format(remedy))
                for remedy in _confounded(linear, schedule, bias, i).values()
            ]
    return found


def unknown_bias(disturbance: Disturbance | None, B: Floats) -> Floats | None:
    """The columns of B (n x b) on which a step or the offset of sines disturbs for ever, unknown to the observer; None if there is none."""
    level = (
        disturbance.amplitude
        if isinstance(disturbance, Step)
        else getattr(disturbance, "offset", 0.0)
    )
    biased = np.broadcast_to(np.asarray(level, float).ravel() != 0, B.shape[1:])
    return B[:, biased] if biased.any() else None


def _confounded(
    linear: Matrices, schedule: Schedule, bias: Floats | None, i: int
) -> dict[str, str]:
    """Why widths of output i stay unknown although their sides are visited, and the remedy: {reason: remedy}."""
    visited = schedule.visited(linear.A.shape[0])
    edges = [name for name, seen in zip(("right", "left"), visited[i], strict=True) if seen]

    def known(bias: Floats | None) -> bool:
        hidden = invisible(linear, visited, schedule.Ts, bias)
        return all(hidden.width(i, name) for name in edges)

    if known(bias):
        return {}
    what = "centre" if len(edges) == 2 else f"{edges[0]} edge"
    if known(None):
        return {
            f"the centre is not identifiable: constant input bias, {what} and bias cannot be told apart": "calibrate the input"
        }
    left = (
        "only the width d_r + d_l can be known"
        if len(edges) == 2
        else f"the {what} cannot be told from a shift of the state"
    )
    return {
        f"the centre is not identifiable: A is singular (an integrator), {left}": "let the plant pass a place where z is known"
    }


def unreached(schedule: Schedule, visited: np.ndarray, i: int) -> list[str]:
    """Why each edge of output i that is not visited (p x 2, [right, left]) is not, in words."""
    reasons = []
    for name, edge, seen, room, peak, level, word in (
        (
            "right",
            "d_r",
            visited[i, 0],
            schedule.levels[i, 0] - schedule.high[i],
            schedule.high[i],
            schedule.levels[i, 0],
            "below",
        ),
        (
            "left",
            "-d_l",
            visited[i, 1],
            schedule.levels[i, 1] + schedule.low[i],
            schedule.low[i],
            -schedule.levels[i, 1],
            "above",
        ),
    ):
        if not seen and room >= 0:
            reasons.append(
                f"the {name} edge is never reached: the output stays {word} {edge}, {peak:.4g} against {level:.4g}"
            )
        elif not seen:
            reasons.append(
                f"the {name} edge is hardly reached: too few samples lie beyond {edge} to tell it from the state"
            )
    return reasons


def _reach(schedule: Schedule, i: int) -> Cure:
    right, left = schedule.levels[i] * (1 + MARGIN)
    low, mean, high = schedule.low[i], schedule.mean[i], schedule.high[i]
    mean = 0.0 if abs(mean) <= 1e-9 * (high - low) else mean
    up, down = max(right - high, 0.0), max(low + left, 0.0)
    if high - low <= 1e-9 * max(abs(high), abs(low), right, left):
        return Cure(
            i,
            None,
            None,
            f"let output {i} move: a swing of {max(right - mean, mean + left):.4g} about {mean:.4g} reaches both edges",
        )
    factor = max((right - mean) / (high - mean), (mean + left) / (mean - low), 1.0)
    shift = up - down
    if high - low >= right + left and abs(shift) < (factor - 1) * max(high - mean, mean - low) * (
        1 - 1e-9
    ):
        return Cure(i, None, shift, f"shift output {i} by {shift:.4g}: it then reaches both edges")
    return Cure(
        i,
        factor,
        None,
        f"make the swing of output {i} about its mean, {mean:.4g}, {factor:.4g} times as large: it then reaches both edges",
    )


def _unobservable(A: Floats, C: Floats, tolerance: float) -> Floats:
    """Orthonormal basis of the largest A-invariant subspace in the kernel of C."""
    U = _null(C, tolerance)
    while U.shape[1]:
        stays = _null(A @ U - U @ (U.T @ A @ U), tolerance)
        if stays.shape[1] == U.shape[1]:
            break
        U = U @ stays
    return U


def _null(M: Floats, tolerance: float) -> Floats:
    """Orthonormal basis of the kernel of a matrix whose entries are of order 1."""
    if not M.size:
        return np.eye(M.shape[1])
    _, singular, rotation = np.linalg.svd(M)
    return np.asarray(rotation[int((singular > tolerance).sum()) :].T)
