"""A design task: the model, the reference's sides, and what disturbs the errors (docs/rates.md)."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from undeadzone.analysis.convergence.floquet import TINY
from undeadzone.analysis.error_dynamics import delta
from undeadzone.analysis.identifiability.linear import cures, invisible
from undeadzone.analysis.side_schedule import Schedule, merged, planned
from undeadzone.errors import InputError
from undeadzone.feedforward.targets import steady_state
from undeadzone.linear.hold import sampled_noise, zoh
from undeadzone.linear.matrices import Matrices, sizes
from undeadzone.scenario.problem import Problem
from undeadzone.support.arrays import Floats

PER_POLE: Final = 49  # frequencies at which a candidate's margin is looked at, around each pole
# Of the schedule: the exosystem's state at a corner is that of the piece that follows.
NUDGE: Final = 1e-12


class Task(NamedTuple):
    """A design task, its states balanced: x = units x_balanced.

    Dynamics are in delta form if sampled (Ts). N = n + 2p errors (x~, d~); the reference's
    exosystem has k states, w' = S w.

    Attributes:
        linear: the model, balanced.
        A: its state matrix (n x n) [1/s].
        units: of the states (n).
        Ts: sample time [s]; None: continuous time.
        step: of the noise [s].
        schedule: the sides along the reference.
        whole: the same with the reference's corners (K spans).
        S: of the exosystem (k x k).
        starts: state of the exosystem at the start of each span of `whole` (K x k).
        model_errors: what each of J model errors adds to the errors' rates (J, N, k), driven by w.
        source: density of the white disturbance (N x N).
        hidden: basis of the errors that no reading shows (N x ...).
        seen: basis of the rest (N x ...).
        resolvents: C (s - A)^-1 at the frequencies at which the margin is looked at (f, p, n).
        margin: least margin of the certificate.
        room: largest gains that are tried, per step.
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
    model_errors: Floats
    source: Floats
    hidden: Floats
    seen: Floats
    resolvents: np.ndarray
    margin: float
    room: float = 0.5

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


def make_task(problem: Problem, margin: float) -> Task:
    """The design task of a linear, stable scenario.

    Args:
        problem: the scenario's parts.
        margin: that its gains need, between 0 and 1.

    Raises:
        InputError: there is nothing to plan on.
    """
    model, Ts = problem.model, problem.model.Ts
    if not 0 < margin < 1:
        raise InputError(f"margin: must lie between 0 and 1, found {margin:g}")
    units = 1 / sizes(delta(model.linear, Ts).T, model.linear.C.T)
    linear, flow = _balanced(model.linear, units), _balanced(problem.flow.linear, units)
    horizon = problem.scenario.simulation.duration
    whole = planned(model, problem.reference, problem.tracked, problem.sensor, horizon)
    schedule = merged(whole)
    if not schedule.sides.any():
        cure = cures(model.linear, schedule)[0].text
        raise InputError(
            f"reference: it never leaves the dead zone, so that the sensor says nothing; {cure}"
        )
    times = np.concatenate([[0.0], np.cumsum(whole.spans)[:-1]]) * (1.0 if Ts is None else Ts)
    S, model_errors, source = _driven(problem, flow, units)
    hidden = invisible(linear, schedule.visited(), Ts)
    basis = np.linalg.qr(hidden.basis * hidden.scale[:, None])[0]
    task = Task(
        linear=linear,
        A=delta(linear, Ts),
        units=units,
        Ts=Ts,
        step=problem.scenario.simulation.step,
        schedule=schedule,
        whole=whole,
        S=S,
        starts=problem.reference.state(times + NUDGE * whole.duration),
        model_errors=model_errors,
        source=source,
        hidden=basis,
        seen=np.linalg.svd(basis)[0][:, basis.shape[1] :],
        resolvents=np.empty((0, model.p, model.n)),
        margin=margin,
    )
    return watched(task, _frequencies(task))


def _balanced(linear: Matrices, units: Floats) -> Matrices:
    """The matrices for states measured in these units (n)."""
    A, B, C = linear
    return Matrices(A / units[:, None] * units, B / units[:, None], C * units)


def _frequencies(task: Task) -> Floats:
    """0 and the frequencies around each pole at which the margin is looked at [rad/s]."""
    near = np.tan(np.linspace(-1.5, 1.5, PER_POLE))
    around = [abs(s.imag) + abs(s.real) * near for s in _poles(task.A, task.Ts)]
    return np.abs(np.concatenate([[0.0], *around]))


def watched(task: Task, w: Floats) -> Task:
    """The task with its margin looked at also at frequencies w [rad/s]."""
    if task.Ts is None:
        s = 1j * w
    else:
        w = np.minimum(w, np.pi / task.Ts)
        s = np.expm1(1j * w * task.Ts) / task.Ts
    resolvents = task.linear.C @ np.linalg.inv(s[:, None, None] * np.eye(task.n) - task.A)
    return task._replace(resolvents=np.concatenate([task.resolvents, resolvents]))


def _driven(problem: Problem, flow: Matrices, units: Floats) -> tuple[Floats, Floats, Floats]:
    """(S, model_errors, source) of `Task`.

    Args:
        problem: the scenario's parts.
        flow: the balanced model in continuous time.
        units: of the states (n).
    """
    from scipy.linalg import expm

    n, p, Ts = problem.model.n, problem.model.p, problem.model.Ts
    Pi, Gamma = steady_state(problem.model, problem.reference, problem.tracked)
    target = np.vstack([Pi / units[:, None], Gamma])  # [x_ref; u_ff] = target w
    A, B, _ = flow
    S: Floats = problem.reference.S
    hold: Floats = np.eye(n)
    spread: Floats = B @ B.T
    if Ts is not None:
        S = (expm(S * Ts) - np.eye(S.shape[0])) / Ts
        hold = zoh(flow._replace(B=np.eye(n)), Ts).B / Ts
        _, spread = sampled_noise(A, spread, Ts)
    both = np.hstack([A, B])
    kinematic = _kinematic(A, B)
    entries = [(i, j) for i, j in np.argwhere(both) if not kinematic[i]]
    model_errors = np.zeros((len(entries), n + 2 * p, S.shape[0]))
    for k, (i, j) in enumerate(entries):
        model_errors[k, :n] = np.outer(hold[:, i], both[i, j] * target[j])
    source = np.zeros((n + 2 * p, n + 2 * p))
    source[:n, :n] = spread
    return S, model_errors, source


def _kinematic(A: Floats, B: Floats) -> np.ndarray:
    """Which rows of x' = A x + B u only say that one state is the derivative of another (n)."""
    one_state = np.count_nonzero(A, axis=1) == 1
    no_input = np.count_nonzero(B, axis=1) == 0
    return np.asarray(one_state & no_input & (np.diag(A) == 0))


def _poles(A: Floats, Ts: float | None) -> np.ndarray:
    """Poles [1/s] of A, or of a sampled A in delta form mapped back to continuous time."""
    poles = np.linalg.eigvals(A)
    if Ts is None:
        return np.asarray(poles)
    factors = 1 + Ts * poles
    growth = np.log(np.maximum(np.abs(factors), TINY)) / Ts
    return np.asarray(growth + 1j * np.angle(factors) / Ts)
