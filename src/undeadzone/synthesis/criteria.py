"""A design task, and what gains are worth in it: rate, and gains from disturbance, model error and noise (docs/rates.md)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.analysis.convergence.floquet import (
    NEUTRAL,
    TINY,
    error_matrices,
    product,
    transitions,
)
from undeadzone.analysis.convergence.mean_square import forced_mean_square, mean_squares
from undeadzone.analysis.error_dynamics import delta
from undeadzone.analysis.identifiability.linear import cures, invisible
from undeadzone.analysis.side_schedule import Schedule, merged, planned
from undeadzone.errors import InputError
from undeadzone.feedforward.targets import steady_state
from undeadzone.linear.hold import sampled_noise, zoh
from undeadzone.linear.matrices import Matrices
from undeadzone.linear.scaling import sizes
from undeadzone.scenario.problem import Problem
from undeadzone.support.arrays import Floats

PER_POLE = 49  # frequencies at which a candidate's margin is looked at, around each pole
NUDGE = (
    1e-12  # of the schedule: the exosystem's state at a corner is that of the piece that follows
)


class Task(NamedTuple):
    """A design task, its states balanced: x = units x_balanced. Dynamics are in delta form if sampled (Ts).

    schedule: the sides along the reference; whole: the same with the reference's corners, where `starts` (K x k) is the
    state of its exosystem w' = S w; push (J, N, k): the model errors, driven by w; source (N x N): white disturbance;
    hidden, seen: bases of the errors that no reading shows and of the rest; resolvents (f, p, n): C (s - A)^-1 at the
    frequencies at which the margin is looked at; step [s]: of the noise.
    """

    linear: Matrices
    A: Floats
    units: Floats
    Ts: float | None
    step: float
    schedule: Schedule
    whole: Schedule
    S: Floats
    starts: Floats
    push: Floats
    source: Floats
    hidden: Floats
    seen: Floats
    resolvents: np.ndarray
    margin: float

    @property
    def n(self) -> int:
        """Number of states."""
        return self.A.shape[0]

    @property
    def p(self) -> int:
        """Number of outputs."""
        return self.linear.C.shape[0]

    @property
    def poles(self) -> Floats:
        """Sizes of the plant's poles [1/s]."""
        return np.abs(_poles(self.A, self.Ts))


class Scores(NamedTuple):
    """What b candidates are worth (each b): rate [1/s], and the rms over the reference of their errors (C x~, d~) [z].

    disturbance: per unit of white input disturbance, 1 per root second on every input; mismatch: per unit of relative
    error in every entry of A and B that is not kinematic, independent; noise: per unit of rms noise on z at every sample.
    """

    rate: Floats
    disturbance: Floats
    mismatch: Floats
    noise: Floats


def make_task(problem: Problem, margin: float) -> Task:
    """The design task of a linear, stable scenario whose gains need that margin. Raises InputError if there is nothing to plan on."""
    model, Ts = problem.model, problem.model.Ts
    if not 0 < margin < 1:
        raise InputError(f"margin: must lie between 0 and 1, found {margin:g}")
    units = 1 / sizes(delta(model.linear, Ts).T, model.linear.C.T)
    linear, flow = (
        Matrices(A / units[:, None] * units, B / units[:, None], C * units)
        for A, B, C in (model.linear, problem.flow.linear)
    )
    horizon = problem.scenario.simulation.duration
    whole = planned(model, problem.reference, problem.tracked, problem.sensor, horizon)
    schedule = merged(whole)
    if not schedule.sides.any():
        raise InputError(
            f"reference: it never leaves the dead zone, so that the sensor says nothing; {cures(model.linear, schedule)[0].text}"
        )
    times = np.concatenate([[0.0], np.cumsum(whole.spans)[:-1]]) * (1.0 if Ts is None else Ts)
    S, push, source = _driven(problem, flow, units)
    hidden = invisible(linear, schedule.visited(), Ts)
    basis = np.linalg.qr(hidden.basis * hidden.scale[:, None])[0]
    task = Task(
        linear, delta(linear, Ts), units, Ts, problem.scenario.simulation.step, schedule, whole, S, problem.reference.state(times + NUDGE * whole.duration),
        push, source, basis, np.linalg.svd(basis)[0][:, basis.shape[1] :], np.empty((0, model.p, model.n)), margin,
    )  # fmt: skip
    near = np.tan(np.linspace(-1.5, 1.5, PER_POLE))
    return watched(
        task,
        np.abs(
            np.concatenate([[0.0], *(abs(s.imag) + abs(s.real) * near for s in _poles(task.A, Ts))])
        ),
    )


def watched(task: Task, w: Floats) -> Task:
    """The task with its margin looked at also at frequencies w [rad/s]."""
    if task.Ts is not None:
        w = np.minimum(w, np.pi / task.Ts)
    s = 1j * w if task.Ts is None else np.expm1(1j * w * task.Ts) / task.Ts
    resolvents = task.linear.C @ np.linalg.inv(s[:, None, None] * np.eye(task.n) - task.A)
    return task._replace(resolvents=np.concatenate([task.resolvents, resolvents]))


def score(
    task: Task, L: Floats, gamma: Floats, mismatch: bool = True, gains: bool = True
) -> Scores:
    """What candidates L (b, n, p), balanced, and gamma (b, p) are worth; nan for what is not asked."""
    Gamma = np.repeat(gamma, 2, axis=1)[:, :, None] * np.eye(2 * task.p)
    F, G = error_matrices(task.A, task.linear.C, L, Gamma, task.schedule.sides)
    rate = -_slowest(task, *product(transitions(F, task.schedule))) / task.schedule.duration
    disturbance = noise = model = np.full(rate.shape, np.nan)
    Z = np.zeros((3 * task.p, F.shape[-1]))
    Z[: task.p, : task.n], Z[task.p :, task.n :] = task.linear.C, np.eye(2 * task.p)
    if gains:
        sources = (
            np.broadcast_to(task.source, F.shape),
            G @ np.swapaxes(G, -1, -2) * (task.step if task.Ts is None else task.Ts**2),
        )
        disturbance, noise = map(np.sqrt, mean_squares(F, Z, sources, task.schedule))
    if mismatch:
        F, _ = error_matrices(task.A, task.linear.C, L, Gamma, task.whole.sides)
        model = np.sqrt(forced_mean_square(F, Z, task.push, task.S, task.starts, task.whole))
    return Scores(rate, disturbance, model, noise)


def certified(task: Task, L: Floats, gamma: Floats, W: Floats) -> Floats:
    """L (b, n, p) shrunk towards 0 as far as the margin asks, for storage weights W (b, p): docs/rates.md.

    1 + G - Ts gamma / 2 >= margin is linear in L, and holds at L = 0 since Ts gamma <= 1.
    """
    room = 1 - task.margin - (0.0 if task.Ts is None else task.Ts / 2 * gamma)
    response = (
        (task.resolvents @ L[:, None])
        * np.sqrt(W / room)[:, None, :, None]
        / np.sqrt(W * room)[:, None, None, :]
    )
    hermitian = (response + np.swapaxes(response, -1, -2).conj()) / 2
    least = (
        hermitian[..., 0, 0].real if task.p == 1 else np.linalg.eigvalsh(hermitian)[..., 0]
    ).min(axis=1)
    return np.asarray(L * np.minimum(1.0, 1.0 / np.maximum(-least, TINY))[:, None, None])


def _slowest(task: Task, M: Floats, size: Floats) -> Floats:
    """The largest ln |multiplier|, those apart that unidentifiable errors keep on the unit circle."""
    own = (
        np.log(np.maximum(np.abs(np.linalg.eigvals(task.seen.T @ M @ task.seen)), TINY)).max(
            axis=-1
        )
        + size
    )
    if not task.hidden.shape[1]:
        return own
    kept = (
        np.log(np.maximum(np.abs(np.linalg.eigvals(task.hidden.T @ M @ task.hidden)), TINY))
        + size[:, None]
    )
    return np.maximum(own, np.where(np.abs(kept) < NEUTRAL, -np.inf, kept).max(axis=-1))


def _driven(problem: Problem, flow: Matrices, units: Floats) -> tuple[Floats, Floats, Floats]:
    """(S, push, source) of `Task`: what the reference's state drives through model errors, and the white disturbance."""
    from scipy.linalg import expm

    n, p, Ts = problem.model.n, problem.model.p, problem.model.Ts
    Pi, Gamma = steady_state(problem.model, problem.reference, problem.tracked)
    target = np.vstack([Pi / units[:, None], Gamma])
    A, B, _ = flow
    both = np.hstack([A, B])
    kinematic = (
        (np.count_nonzero(A, axis=1) == 1) & (np.count_nonzero(B, axis=1) == 0) & (np.diag(A) == 0)
    )
    S = problem.reference.S
    hold: Floats = np.eye(n)
    spread: Floats = B @ B.T
    if Ts is not None:
        S = (expm(S * Ts) - np.eye(S.shape[0])) / Ts
        hold = zoh(flow._replace(B=np.eye(n)), Ts).B / Ts
        _, spread = sampled_noise(A, spread, Ts)
    entries = [(i, j) for i, j in np.argwhere(both) if not kinematic[i]]
    push = np.zeros((len(entries), n + 2 * p, S.shape[0]))
    for k, (i, j) in enumerate(entries):
        push[k, :n] = np.outer(hold[:, i], both[i, j] * target[j])
    source = np.zeros((n + 2 * p, n + 2 * p))
    source[:n, :n] = spread
    return S, push, source


def _poles(A: Floats, Ts: float | None) -> np.ndarray:
    """Poles [1/s] of A, or of a sampled A in delta form mapped back to continuous time."""
    poles = np.linalg.eigvals(A)
    return np.asarray(
        poles
        if Ts is None
        else np.log(np.maximum(np.abs(1 + Ts * poles), TINY)) / Ts
        + 1j * np.angle(1 + Ts * poles) / Ts
    )
