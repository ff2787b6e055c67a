"""Information of noisy readings on x(0), d and a bias along a schedule, backward in time.

docs/identifiability.md derives it. The unknowns are `[x(0); d; beta]`, d = [right, left] per
output.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.analysis.branch_schedule import Schedule, merge_equal_neighbours
from undeadzone.analysis.error_dynamics import branch_pattern
from undeadzone.analysis.identifiability.disturbance import InputModel
from undeadzone.analysis.identifiability.linear import (
    Unobservable,
    share_widths,
    unobservable_changes,
)
from undeadzone.linalg.hold import discretise_noise
from undeadzone.linalg.matrices import Matrices, symmetric_part
from undeadzone.util.arrays import Floats

NO_WIDTH = 1e-8  # edge below which there is none: information of it would not be solved for
EXACT = 1e-6  # of an edge: the least rms that a reading is taken to have
BLURRED = 1e-4  # the same beside process noise, whose vague directions rounding would hide


class Stretch(NamedTuple):
    """Effect of a stretch of time on information: before = H + Phi' (after^-1 + Q)^-1 Phi.

    Attributes:
        Phi: the transition (N x N).
        Q: covariance that process noise adds (N x N).
        H: the observability Gramian of the stretch's readings (N x N).
    """

    Phi: Floats
    Q: Floats
    H: Floats


class Deviations(NamedTuple):
    """Standard deviations that an optimal estimator reaches, or inf if not identifiable.

    Attributes:
        widths: of `right`, `left`, `width`, `centre` of each output [unit of z].
        covariance: of `[x(0); d; beta]`, its unidentifiable part left out (n + 2p + b square).
        hidden: changes of the unknowns that no reading shows.
    """

    widths: list[dict[str, float]]
    covariance: Floats
    hidden: Unobservable


class ReadingConditions(NamedTuple):
    """Readings and prior information about the widths.

    Attributes:
        noise: rms of the noise of z (p).
        step: time between two readings [s].
        duration: for how long there are readings [s].
        arrive: share of each output's readings that arrive (p) (None: all of them).
        bias: directions (n x b) of unknown constant inputs (None: there is none).
        colour: a random input with its own states, which come after x and start at its own rms
            (None: there is none).
        prior: prior information on `[x(0); d]` (k x n + 2p, `prior_rows`) (None: nothing).
        gaps_known: whether the gaps of a play ahead of the zone are.
        process: covariance (n x n) of white process noise, per second, or per step if the schedule
            is sampled (None: there is none).
    """

    noise: Floats
    step: float
    duration: float
    arrive: Floats | None = None
    bias: Floats | None = None
    colour: InputModel | None = None
    prior: Floats | None = None
    gaps_known: bool = False
    process: Floats | None = None


def optimal_deviations(
    linear: Matrices, schedule: Schedule, readings: ReadingConditions
) -> Deviations:
    """Return the standard deviations from noisy readings along whole passes of the schedule.

    The only further prior is `prior`.

    Args:
        linear: A, B, C of the plant, of one step if sampled.
        schedule: of the sides.
        readings: the readings.
    """
    states_of_plant = linear.A.shape[0]
    known = readings.prior
    colour = readings.colour
    visited = schedule.branch_visits(states_of_plant)
    prior: Floats = np.zeros(states_of_plant)
    if colour is not None:
        linear, readings = _augment_disturbance(linear, schedule.Ts, colour, readings)
        prior = np.r_[prior, 1 / colour.rms**2]
    n = linear.A.shape[0]
    p = linear.C.shape[0] // schedule.repeats
    fisher = information_matrix(linear, schedule, readings)
    fisher[np.arange(n), np.arange(n)] += prior
    hidden = unobservable_changes(
        linear, visited, schedule.Ts, readings.bias, repeats=schedule.repeats
    )
    if known is not None:
        rows = np.zeros((len(known), n + 2 * p))
        rows[:, :states_of_plant] = known[:, :states_of_plant]
        rows[:, n:] = known[:, states_of_plant:]
        fisher[: n + 2 * p, : n + 2 * p] += rows.T @ rows
        hidden = hidden.exclude_known(rows)
    units = np.outer(hidden.scale, hidden.scale)
    seen = np.linalg.svd(hidden.basis)[0][
        :, hidden.basis.shape[1] :
    ]  # a basis of the known directions
    covariance = units * (seen @ _invert_semidefinite(seen.T @ (fisher * units) @ seen) @ seen.T)
    widths = [hidden.std_of_widths(i, covariance) for i in range(p)]
    return Deviations(widths, covariance, hidden)


def _augment_disturbance(
    linear: Matrices, Ts: float | None, colour: InputModel, readings: ReadingConditions
) -> tuple[Matrices, ReadingConditions]:
    """Return the model of `[x; w]` and its readings, with process noise and bias."""
    n, b = colour.B.shape
    own = colour.A
    white = colour.Q
    if Ts is not None:
        own, white = discretise_noise(colour.A, colour.Q, Ts)
    A = np.block([[linear.A, colour.B], [np.zeros((b, n)), own]])
    C = np.hstack([linear.C, np.zeros((linear.C.shape[0], b))])
    process = np.zeros((n + b, n + b))
    process[:n, :n] = 0.0 if readings.process is None else readings.process
    process[n:, n:] = white
    bias = None if readings.bias is None else pad_states(readings.bias, b)
    return Matrices(A, pad_states(linear.B, b), C), readings._replace(process=process, bias=bias)


def pad_states(B: Floats, more: int) -> Floats:
    """Return inputs of n states as inputs of n + more states, the last of which they do not
    move.
    """
    return np.vstack([B, np.zeros((more, B.shape[1]))])


def information_matrix(linear: Matrices, schedule: Schedule, readings: ReadingConditions) -> Floats:
    """Return the information matrix (n + 2p + b square) of `[x(0); d; beta]`.

    Without process noise it is exact: the observability Gramian of the switched system divided by
    the noise. Arguments as of `deviations`.
    """
    bias = readings.bias
    process = readings.process
    step = readings.step
    least = (EXACT if process is None else BLURRED) * edge_scale(schedule.levels)
    variance = np.maximum(readings.noise, least) ** 2
    if readings.arrive is not None:
        variance = variance / readings.arrive
    n = linear.A.shape[0]
    p = linear.C.shape[0]
    B = np.zeros((n, 0)) if bias is None else bias
    shared = share_widths(p, schedule.repeats)
    constant = n + shared.shape[1]
    size = constant + B.shape[1]
    # [x; d; beta]' = F [x; d; beta], with white noise of covariance Q.
    F = np.zeros((size, size))
    Q = np.zeros((size, size))
    F[:n, :n] = linear.A
    F[:n, constant:] = B
    if process is not None:
        Q[:n, :n] = process
    one_step = F + np.diag(np.r_[np.zeros(n), np.ones(size - n)])  # of a sampled model
    once = identity_stretch(size)
    for sides, span in zip(*merge_equal_neighbours(schedule)[:2], strict=True):
        of_states = linear.C * np.abs(sides)[:, None]
        S = branch_pattern(tuple(sides.astype(int))) @ shared
        rows = np.hstack([of_states, -S, np.zeros((p, B.shape[1]))])
        if schedule.Ts is None:
            stretch = _continuous_stretch(F, Q, rows.T / (variance * step) @ rows, span, step)
        else:
            stretch = repeat_stretch(Stretch(one_step, Q, rows.T / variance @ rows), round(span))
        once = chain_stretches(once, stretch)
    passes = readings.duration / schedule.total_duration * (1 + 1e-12)
    return repeat_stretch(once, max(1, int(passes))).H


def edge_scale(levels: Floats) -> Floats:
    """Return the larger edge of each output (p) [z], or 1 if an output has no width."""
    level = levels.max(axis=1)
    return np.where(level > NO_WIDTH, level, 1.0)


def chain_stretches(first: Stretch, second: Stretch) -> Stretch:
    """Return the first stretch followed by the second."""
    mixed = np.eye(first.Q.shape[0]) + first.Q @ second.H
    Phi, Q = np.hsplit(np.linalg.solve(mixed, np.hstack([first.Phi, first.Q])), 2)
    H = first.H + first.Phi.T @ second.H @ Phi
    Q = second.Q + second.Phi @ Q @ second.Phi.T
    return Stretch(second.Phi @ Phi, symmetric_part(Q), symmetric_part(H))


def repeat_stretch(once: Stretch, times: int) -> Stretch:
    """Return a stretch repeated `times` >= 1 times, by doubling."""
    whole = identity_stretch(len(once.Q))
    while True:
        if times & 1:
            whole = chain_stretches(whole, once)
        times >>= 1
        if not times:
            return whole
        once = chain_stretches(once, once)


def identity_stretch(size: int) -> Stretch:
    """Return a stretch of no time for `size` unknowns."""
    none = np.zeros((size, size))
    return Stretch(np.eye(size), none, none)


def _continuous_stretch(F: Floats, Q: Floats, H: Floats, span: float, step: float) -> Stretch:
    """Return the stretch of x' = F x + w for `span` [s]: short parts, then doubling.

    Within a part readings come before process noise: with Q, a part holds one reading (every `step`
    [s]) at most. Q: covariance of w. H: information of readings per second.
    """
    readings = span / step if Q.any() else 1.0
    parts = max(1.0, float(np.linalg.norm(F, 1)) * span, readings)
    halvings = int(np.ceil(np.log2(parts)))
    part = span / 2**halvings
    Phi, gained = discretise_noise(F, Q, part)
    _, information = discretise_noise(F.T, H, part)
    return repeat_stretch(Stretch(Phi, gained, information), 2**halvings)


def _invert_semidefinite(information: Floats) -> Floats:
    """Return the inverse of a positive semidefinite matrix, infinite if rounding leaves
    nothing.
    """
    tiny = np.finfo(float).tiny
    unit = np.sqrt(np.maximum(np.diag(information), tiny))
    scale = np.outer(unit, unit)
    with np.errstate(over="ignore"):  # a direction of no information at all
        values, vectors = np.linalg.eigh(information / scale)
    return np.asarray((vectors / np.maximum(values, tiny)) @ vectors.T / scale)
