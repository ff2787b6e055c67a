"""Design task: the model, the reference's branches, and the disturbances of the errors
(docs/rates.md).
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from undeadzone.analysis.branch_schedule import Schedule, merge_equal_neighbours, plan_schedule
from undeadzone.analysis.convergence import floquet
from undeadzone.analysis.convergence.floquet import TINY
from undeadzone.analysis.identifiability.linear import find_remedies, unobservable_changes
from undeadzone.errors import InputError
from undeadzone.feedforward.targets import moves, steady_state
from undeadzone.linalg.hold import discretise_noise, zoh
from undeadzone.linalg.matrices import Matrices, delta_form, state_response_sizes
from undeadzone.scenario.problem import Problem
from undeadzone.util.arrays import Floats, require_number

PER_POLE: Final = 49  # frequencies at which a candidate's margin is looked at, around each pole
# Of the schedule: the exosystem's state at a corner is that of the piece that follows.
NUDGE: Final = 1e-12


class Task(NamedTuple):
    """Design task, its states balanced: x = units x_balanced.

    Dynamics are in delta form if sampled (Ts). N = n + 2p errors (x~, d~). The reference's
    exosystem has k states, w' = S w.

    Attributes:
        model: the model as it is.
        linear: the model, balanced.
        A: its state matrix (n x n) [1/s].
        units: of the states (n).
        Ts: sample time [s] (None: continuous time).
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

    model: Matrices
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
        """Return the number of states."""
        return self.A.shape[0]

    @property
    def p(self) -> int:
        """Return the number of outputs."""
        return self.linear.C.shape[0]

    @property
    def pole_sizes(self) -> Floats:
        """Return the sizes of the plant's poles [1/s]."""
        return np.abs(_continuous_poles(self.A, self.Ts))


def build_task(problem: Problem, margin: float) -> Task:
    """Return the design task of a linear, stable scenario.

    Args:
        problem: the scenario's parts.
        margin: that its gains need, between 0 and 1.

    Raises:
        InputError: there is nothing to plan on.
    """
    model = problem.model
    Ts = problem.model.Ts
    margin = require_number("margin", margin)
    if not 0 < margin < 1:
        raise InputError(f"margin: must lie between 0 and 1, found {margin:g}")
    units = 1 / state_response_sizes(delta_form(model.linear, Ts).A.T, model.linear.C.T)
    linear = _balance_matrices(model.linear, units)
    flow = _balance_matrices(problem.flow.linear, units)
    horizon = problem.scenario.simulation.duration
    whole = plan_schedule(model, problem.reference, problem.tracked, problem.sensor, horizon)
    schedule = merge_equal_neighbours(whole)
    if not schedule.sides.any():
        cure = find_remedies(model.linear, schedule)[0].text
        raise InputError(
            f"reference: it never leaves the dead zone, so that all samples are censored; {cure}"
        )
    times = np.concatenate([[0.0], np.cumsum(whole.spans)[:-1]]) * (1.0 if Ts is None else Ts)
    S, model_errors, source = _build_storage_inputs(problem, flow, units)
    hidden = unobservable_changes(linear, schedule.branch_visits(), Ts)
    basis = np.linalg.qr(hidden.basis * hidden.scale[:, None])[0]
    task = Task(
        model=model.linear,
        linear=linear,
        A=delta_form(linear, Ts).A,
        units=units,
        Ts=Ts,
        step=problem.scenario.simulation.step,
        schedule=schedule,
        whole=whole,
        S=S,
        starts=problem.reference.state(times + NUDGE * whole.total_duration),
        model_errors=model_errors,
        source=source,
        hidden=basis,
        seen=np.linalg.svd(basis)[0][:, basis.shape[1] :],
        resolvents=np.empty((0, model.p, model.n)),
        margin=margin,
    )
    return add_frequencies(task, _margin_frequencies(task))


def _balance_matrices(linear: Matrices, units: Floats) -> Matrices:
    """Return the matrices for states measured in these units (n)."""
    A, B, C = linear
    return Matrices(A / units[:, None] * units, B / units[:, None], C * units)


def _margin_frequencies(task: Task) -> Floats:
    """Return 0 and the frequencies around each pole for the test of the margin [rad/s]."""
    near = np.tan(np.linspace(-1.5, 1.5, PER_POLE))
    around = [abs(s.imag) + abs(s.real) * near for s in _continuous_poles(task.A, task.Ts)]
    return np.abs(np.concatenate([[0.0], *around]))


def add_frequencies(task: Task, w: Floats) -> Task:
    """Return the task with its margin tested also at frequencies w [rad/s]."""
    if task.Ts is None:
        s = 1j * w
    else:
        w = np.minimum(w, np.pi / task.Ts)
        s = np.expm1(1j * w * task.Ts) / task.Ts
    resolvents = task.linear.C @ np.linalg.inv(s[:, None, None] * np.eye(task.n) - task.A)
    return task._replace(resolvents=np.concatenate([task.resolvents, resolvents]))


def _build_storage_inputs(
    problem: Problem, flow: Matrices, units: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return (S, model_errors, source) of `Task`.

    Args:
        problem: the scenario's parts.
        flow: the balanced model in continuous time.
        units: of the states (n).
    """
    n = problem.model.n
    p = problem.model.p
    Ts = problem.model.Ts
    Pi, Gamma = steady_state(problem.model, problem.reference, problem.tracked)
    target = np.vstack([Pi / units[:, None], Gamma])  # [x_ref; u_ff] = target w
    A, B, _ = flow
    S = moves(problem.reference.S, Ts)
    hold: Floats = np.eye(n)
    spread: Floats = B @ B.T
    if Ts is not None:
        hold = zoh(flow._replace(B=np.eye(n)), Ts).B / Ts
        _, spread = discretise_noise(A, spread, Ts)
    both = np.hstack([A, B])
    kinematic = _find_kinematic_rows(A, B)
    entries = [(i, j) for i, j in np.argwhere(both) if not kinematic[i]]
    model_errors = np.zeros((len(entries), n + 2 * p, S.shape[0]))
    for k, (i, j) in enumerate(entries):
        model_errors[k, :n] = np.outer(hold[:, i], both[i, j] * target[j])
    source = np.zeros((n + 2 * p, n + 2 * p))
    source[:n, :n] = spread
    return S, model_errors, source


def _find_kinematic_rows(A: Floats, B: Floats) -> np.ndarray:
    """Return a mask of the rows of x' = A x + B u that only define a state as a derivative
    (n).
    """
    one_state = np.count_nonzero(A, axis=1) == 1
    no_input = np.count_nonzero(B, axis=1) == 0
    return np.asarray(one_state & no_input & (np.diag(A) == 0))


def _continuous_poles(A: Floats, Ts: float | None) -> np.ndarray:
    """Return poles [1/s] of A, or of a sampled A in delta form mapped back to continuous time."""
    poles = np.linalg.eigvals(A)
    if Ts is None:
        return np.asarray(poles)
    factors = 1 + Ts * poles
    growth = np.log(np.maximum(np.abs(factors), TINY)) / Ts
    return np.asarray(growth + 1j * np.angle(factors) / Ts)


# --- Gains as points of a search


REACH: Final = 5.0  # times the plant's fastest pole: the largest gains in L that are tried
SPEED: Final = (0.01, 100.0)  # gamma between these times the plant's slowest and fastest pole
NEAR_BOUND: Final = 1e-3  # share of a bound, within which a point touches it
WEIGHT: Final = 3.0  # largest logarithm of the ratio of two storage weights


class Scores(NamedTuple):
    """Scores of b candidates (b each): rate, and rms over the reference of (C x~, d~) [z].

    Attributes:
        rate: of the error [1/s].
        disturbance: rms per unit of white input disturbance, 1 per root second on every input.
        mismatch: rms per unit of relative error in every entry of A and B that is not kinematic,
            independent of each other.
        noise: rms per unit of rms noise on z at every sample.
    """

    rate: Floats
    disturbance: Floats
    mismatch: Floats
    noise: Floats


def score_gains(
    task: Task, L: Floats, gamma: Floats, mismatch: bool = True, gains: bool = True
) -> Scores:
    """Return the scores of b candidates, nan for scores that are not requested.

    Args:
        task: the design task.
        L: balanced gains (b, n, p).
        gamma: gains of the widths (b, p).
        mismatch: whether to score model errors.
        gains: whether to score disturbance and noise.
    """
    n = task.n
    p = task.p
    Gamma = np.repeat(gamma, 2, axis=1)[:, :, None] * np.eye(2 * p)
    F, G = floquet.error_matrices(task.A, task.linear.C, L, Gamma, task.schedule.sides)
    rate = (
        -_slowest_multiplier(
            task, *floquet.matrix_product(floquet.span_transitions(F, task.schedule))
        )
        / task.schedule.total_duration
    )
    disturbance = noise = model = np.full(rate.shape, np.nan)
    Z = np.zeros((3 * p, F.shape[-1]))  # the errors that count: C x~, then d~
    Z[:p, :n] = task.linear.C
    Z[p:, n:] = np.eye(2 * p)
    if gains:
        per_sample = task.step if task.Ts is None else task.Ts**2
        sources = (
            np.broadcast_to(task.source, F.shape),
            G @ np.swapaxes(G, -1, -2) * per_sample,
        )
        disturbance, noise = map(np.sqrt, floquet.mean_squares(F, Z, sources, task.schedule))
    if mismatch:
        F, _ = floquet.error_matrices(task.A, task.linear.C, L, Gamma, task.whole.sides)
        squares = floquet.mean_square_of_forced_error(
            F, Z, task.model_errors, task.S, task.starts, task.whole
        )
        model = np.sqrt(squares)
    return Scores(rate, disturbance, model, noise)


def shrink_to_certified(task: Task, L: Floats, gamma: Floats, W: Floats) -> Floats:
    """Return L shrunk towards 0 as far as the margin requires (b, n, p): docs/rates.md.

    1 + G - Ts gamma / 2 >= margin is linear in L, and holds at L = 0 since Ts gamma <= 1.

    Args:
        task: the design task.
        L: balanced gains (b, n, p).
        gamma: gains of the widths (b, p).
        W: storage weights (b, p).
    """
    room = 1 - task.margin - (0.0 if task.Ts is None else task.Ts / 2 * gamma)
    rows = np.sqrt(W / room)[:, None, :, None]
    columns = np.sqrt(W * room)[:, None, None, :]
    response = (task.resolvents @ L[:, None]) * rows / columns
    hermitian = (response + np.swapaxes(response, -1, -2).conj()) / 2
    if task.p == 1:
        eigenvalues: Floats = hermitian[..., 0, 0].real
    else:
        eigenvalues = np.linalg.eigvalsh(hermitian)[..., 0]
    least = eigenvalues.min(axis=1)
    return np.asarray(L * np.minimum(1.0, 1.0 / np.maximum(-least, floquet.TINY))[:, None, None])


def _slowest_multiplier(task: Task, M: Floats, size: Floats) -> Floats:
    """Return the largest ln |multiplier| of errors that can decay (b).

    Those apart that unidentifiable errors keep on the unit circle.

    Args:
        task: the design task.
        M: transition of the errors over the schedule (b, N, N), but for a factor.
        size: logarithm of that factor (b).
    """
    own = _log_eigenvalues(task.seen.T @ M @ task.seen).max(axis=-1) + size
    if not task.hidden.shape[1]:
        return own
    logs = _log_eigenvalues(task.hidden.T @ M @ task.hidden) + size[:, None]
    return np.maximum(own, np.where(np.abs(logs) < floquet.NEUTRAL, -np.inf, logs).max(axis=-1))


def _log_eigenvalues(M: Floats) -> Floats:
    """Return ln |eigenvalue| of matrices (b, N, N)."""
    return np.log(np.maximum(np.abs(np.linalg.eigvals(M)), floquet.TINY))


class Candidate(NamedTuple):
    """Gains with their `Scores`.

    Attributes:
        L: gain of x^ (n x p) [1/s].
        gamma: gain of the widths (p) [1/s].
        rate: of the error [1/s].
        disturbance, mismatch, noise: errors per unit of each [z].
    """

    L: Floats
    gamma: Floats
    rate: float
    disturbance: float
    mismatch: float
    noise: float


def score_candidate(task: Task, L: Floats, gamma: Floats) -> Candidate:
    """Return gains L (n x p), gamma (p) [1/s] with their scores in a task."""
    values = score_gains(task, (L / task.units[:, None])[None], gamma[None])
    return Candidate(L, gamma, *(float(value[0]) for value in values))


def score_point(task: Task, point: Floats) -> Candidate:
    """Return the gains at a point (d), with their scores."""
    L, gamma = to_certified_gains(task, point[None])
    return score_candidate(task, task.units[:, None] * L[0], gamma[0])


def to_certified_gains(task: Task, points: Floats) -> tuple[Floats, Floats]:
    """Return the certified gains at points.

    Args:
        task: the design task.
        points: (b, d), each [asinh L / slowest pole, ln gamma, ln of all but the first storage
            weight].

    Returns:
        L, balanced (b, n, p), and gamma (b, p).
    """
    n = task.n
    p = task.p
    L = task.pole_sizes.min() * np.sinh(points[:, : n * p].reshape(-1, n, p))
    gamma = np.exp(points[:, n * p : n * p + p])
    W = np.exp(np.hstack([np.zeros((len(points), 1)), points[:, n * p + p :]]))  # storage weights
    return shrink_to_certified(task, L, gamma, W), gamma


def to_search_point(task: Task, gains: Candidate) -> Floats:
    """Return the point whose `to_certified_gains` are these gains, as near as the box allows."""
    L = gains.L / task.units[:, None]
    gamma = np.maximum(gains.gamma, 1e-300)
    shares = np.arcsinh(L / task.pole_sizes.min()).ravel()
    point = np.concatenate([shares, np.log(gamma), np.zeros(task.p - 1)])
    return np.clip(point, *search_box(task))


def search_box(task: Task) -> tuple[Floats, Floats]:
    """Return the least and greatest points of the search (d each).

    Steps of simulation and sampling bound the gains too.
    """
    slow = float(task.pole_sizes.min())
    quick = float(task.pole_sizes.max())
    step = task.step if task.Ts is None else task.Ts
    reach = float(np.arcsinh(min(REACH * quick, task.room / step) / slow))
    least, greatest = np.log([SPEED[0] * slow, min(SPEED[1] * quick, task.room / step)])
    sizes = task.n * task.p, task.p, task.p - 1
    return np.repeat([-reach, least, -WEIGHT], sizes), np.repeat([reach, greatest, WEIGHT], sizes)


def list_gains_at_limit(task: Task, point: Floats) -> str:
    """Return the names of gains at a point (d) that are the largest that the step allows, empty if
    none.
    """
    _, greatest = search_box(task)
    size = task.n * task.p
    quick = float(task.pole_sizes.max())
    step = task.step if task.Ts is None else task.Ts
    at_bound = np.abs(point) > greatest - NEAR_BOUND * np.abs(greatest)
    names = []
    if at_bound[:size].any() and REACH * quick > task.room / step:
        names.append("L")
    if at_bound[size : size + task.p].any() and SPEED[1] * quick > task.room / step:
        names.append("gamma")
    return " and ".join(names)
