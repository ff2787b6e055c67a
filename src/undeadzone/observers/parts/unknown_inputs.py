"""What may be wrong besides the widths, as states of a filter: input disturbance, bias, tolerance of the model (docs/filters.md)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.linear.hold import sampled_noise
from undeadzone.linear.matrices import Matrices
from undeadzone.numerics.gaussian import Gaussian, update
from undeadzone.observers.parts.measured_kalman import Augmentation, Params
from undeadzone.plants.system import System, held
from undeadzone.plants.time_scales import time_scale
from undeadzone.support.arrays import Floats, scalar

SMALL = 0.01  # bias of a calibrated input, relative to that of another

BRIEF = 0.25  # correlation time, in quarter periods of the plant, unless it is given


class Colour(NamedTuple):
    """A disturbance of unit rms, C p with p+ = F p + noise of covariance Q; cov: that of p at all times (k x k, C: k)."""

    F: Floats
    Q: Floats
    cov: Floats
    C: Floats


class Numbers(NamedTuple):
    """Run-time numbers.

    F, Q, variance: of the disturbances; slopes, values, held: as in `Tolerance`; rest: the state under each unit bias (n x biases);
    bias: their rms; odds: the log of those that they are `SMALL`.
    """

    F: Floats
    Q: Floats
    variance: Floats
    slopes: Floats
    values: Floats
    held: Floats
    rest: Floats
    bias: Floats
    odds: Any


def coloured(correlation: float, washout: float | None, Ts: float) -> Colour:
    """First-order noise p_1' = -p_1 / correlation + white noise, sampled exactly.

    With a washout, p_1 - p_2 with p_2' = (p_1 - p_2) / washout instead: it has no constant part.
    """
    from scipy.linalg import solve_discrete_lyapunov

    a, b = 1 / correlation, 0.0 if washout is None else 1 / washout
    F, W, C = (
        np.array([[-a, 0.0], [b, -b]]),
        np.diag([2 * (a + b), 0.0]),
        np.array([1.0, -1.0]),
    )  # 2 (a + b): unit rms
    if washout is None:
        F, W, C = F[:1, :1], W[:1, :1], C[:1]
    Fd, Q = sampled_noise(F, W, Ts)
    return Colour(Fd, (Q + Q.T) / 2, solve_discrete_lyapunov(Fd, Q), C)


def span(key: str, value: Any, Ts: float) -> float:
    """A time that samples resolve [s]. Raises InputError."""
    found = scalar(f"observer.{key}", value, above=0.0)
    if not 0.1 * Ts <= found <= 1e6 * Ts:
        raise InputError(
            f"observer.{key}: must lie between 0.1 and 1e6 sample times of {Ts:g} s, found {found:.4g} s"
        )
    return found


def correlation_time(given: float | None, flow: Matrices, Ts: float) -> float:
    """That of a disturbance [s]; default: a 16th of the plant's period. Raises InputError."""
    return span("correlation_time", BRIEF * time_scale(flow) if given is None else given, Ts)


class Tolerance(NamedTuple):
    """Relative standard deviations (K) of what is uncertain, and d[Ad, Bd] per relative change of each (Kn x (n + m)).

    entries: their rows and columns in [A, B], values: themselves; held: `plant.held`. For a nonlinear plant what is
    uncertain are its parameters, and there is no matrix: changed(params, theta) has them as theta (K) changes them.
    """

    std: Floats
    slopes: Floats
    entries: tuple[tuple[int, int], ...] = ()
    values: Floats = np.zeros(0)
    held: Floats = np.zeros((0, 0))
    changed: Callable[[Any, Any], Any] = lambda params, theta: params * (1 + theta)


def named(model: System, given: dict[str, float]) -> Tolerance:
    """Named parameters of a nonlinear plant, of absolute standard deviations. Raises InputError."""
    std = {
        name: scalar(f"observer.uncertain.{name}", value, above=0.0)
        for name, value in given.items()
    }
    if unknown := sorted(set(std) - set(model.names)):
        raise InputError(
            f"observer.uncertain.{unknown[0]}: unknown parameter; the model has {', '.join(model.names) or 'none with a name'}"
        )
    pick = ca.DM(len(model.names), len(std))
    for k, name in enumerate(std):
        pick[model.names.index(name), k] = 1
    return Tolerance(
        np.array([*std.values()]),
        np.zeros((0, model.n + model.m)),
        changed=lambda params, theta: params + pick @ theta,
    )


def tolerances(model: System, given: float | dict[str, float]) -> Tolerance:
    """The uncertain entries of the plant's A and B, or its parameters. Raises InputError."""
    assert model.Ts is not None
    assert model.flow is not None
    n, m = model.n, model.m
    if model.nonlinear:
        if isinstance(given, dict):
            raise InputError(
                "observer.tolerance: a nonlinear plant takes one number, for all of its parameters"
            )
        std = scalar("observer.tolerance", given, least=0.0)
        return Tolerance(np.full(np.size(model.params) if std else 0, std), np.zeros((0, n + m)))
    AB = np.hstack(model.flow[:2])
    names = {
        f"{name}[{i},{j}]": (i, j + (n if name == "B" else 0))
        for name, columns in (("A", n), ("B", m))
        for i in range(n)
        for j in range(columns)
    }
    if not isinstance(given, dict):
        free = np.flatnonzero(~((np.count_nonzero(AB, axis=1) == 1) & (AB.max(axis=1) == 1.0)))
        given = {name: given for name, (i, j) in names.items() if i in free and AB[i, j] != 0.0}
    found = []
    for name, value in given.items():
        std = scalar(f"observer.tolerance.{name}", value, least=0.0)
        if name not in names or AB[names[name]] == 0.0:
            uncertain = ", ".join(name for name, at in names.items() if AB[at] != 0.0)
            raise InputError(
                f"observer.tolerance.{name}: expected an entry of A or B that is not 0: {uncertain}"
            )
        if std:
            found.append((std, names[name]))
    from scipy.linalg import expm_frechet

    square = np.vstack([AB, np.zeros((m, n + m))]) * model.Ts
    slopes = [
        expm_frechet(square, square * _unit(at, square.shape), compute_expm=False)[:n]
        for _, at in found
    ]
    entries = tuple(at for _, at in found)
    return Tolerance(
        np.array([std for std, _ in found]),
        np.concatenate([np.zeros((0, n + m)), *slopes]),
        entries,
        np.array([AB[at] for at in entries]),
        held(model),
    )


def _unit(at: tuple[int, int], shape: tuple[int, ...]) -> Floats:
    found = np.zeros(shape)
    found[at] = 1.0
    return found


def unknowns(
    model: System,
    colour: Colour,
    rms: Floats,
    bias: Floats,
    calibrated: float,
    tolerance: Tolerance,
) -> Augmentation:
    """Bias, disturbance and tolerance states of those inputs and entries that have any: extra = [bias; p; theta]."""
    from scipy.linalg import block_diag

    n, count = model.n, tolerance.std.size
    biased, shaken = (np.eye(model.m)[:, size > 0] for size in (bias, rms))
    ends = np.cumsum([0, biased.shape[1], colour.C.size * shaken.shape[1], count]).tolist()
    disturbing = shaken @ np.kron(colour.C, np.eye(shaken.shape[1]))
    variance = rms[rms > 0] ** 2
    # The tolerance acts on x less the rest that a bias leads to: else estimates of theta would seem to tell bias from centre.
    rest = np.linalg.lstsq(np.eye(n) - model.linear.A, model.linear.B @ biased, rcond=None)[0]

    def move(q: Params, x: Any, extra: Any, u: Any) -> tuple[Any, Any]:
        constant, shaped, theta = ca.vertsplit(extra, ends)
        moving = u + disturbing @ shaped
        total = moving + biased @ constant
        if model.nonlinear:
            after = model.move(tolerance.changed(q.model, theta) if count else q.model, x, total)
        else:
            regressor = q.augmentation.slopes @ ca.vertcat(
                x - q.augmentation.rest @ constant, moving
            )
            after = model.move(q.model, x, total) + ca.reshape(regressor, n, count) @ theta
        return after, ca.vertcat(
            constant, ca.kron(q.augmentation.F, ca.SX.eye(shaken.shape[1])) @ shaped, theta
        )

    def bend(q: Params, x: Any, extra: Any, u: Any) -> tuple[Any, Any]:
        """theta_i a_i [x; u] in the rows of A and B, held over the step."""
        constant, shaped, theta = ca.vertsplit(extra, ends)
        moved = ca.vertcat(x - q.augmentation.rest @ constant, u + disturbing @ shaped)
        rows = sorted({row for row, _ in tolerance.entries})
        b = ca.SX(len(rows), 1)
        for k, (row, column) in enumerate(tolerance.entries):
            b[rows.index(row)] += theta[k] * q.augmentation.values[k] * moved[column]
        return q.augmentation.held[:, rows], b

    def noise(q: Params, x: Any, u: Any) -> tuple[Any, Any]:
        static = [ca.SX(size, size) for size in (biased.shape[1], count)]
        return ca.SX(n, n), ca.diagcat(
            static[0], ca.kron(q.augmentation.Q, ca.diag(q.augmentation.variance)), static[1]
        )

    def small(q: Params, belief: Gaussian) -> tuple[Gaussian, Any]:
        """(the belief if the bias is `SMALL`, the log of its odds): what a reading of it as 0 leaves (docs/filters.md)."""
        odds = q.augmentation.odds
        for i in range(ends[1]):
            at, R = n + 2 * model.p + i, q.augmentation.bias[i] ** 2 / (1 / SMALL**2 - 1)
            e = -belief.mean[at]
            belief, S = update(belief, ca.SX.eye(belief.mean.shape[0])[at, :], e, R, 1.0)
            odds = odds + ca.log(R / S) / 2 - e**2 / S / 2 - np.log(SMALL)
        return belief, odds

    odds = np.log(calibrated / (1 - calibrated)) if calibrated else np.float64(0.0)
    numbers = Numbers(
        colour.F,
        colour.Q,
        variance,
        tolerance.slopes,
        tolerance.values,
        tolerance.held,
        rest,
        bias[bias > 0],
        odds,
    )
    cov = block_diag(
        np.diag(bias[bias > 0] ** 2),
        np.kron(colour.cov, np.diag(variance)),
        np.diag(tolerance.std**2),
    )
    return Augmentation(
        numbers,
        cov,
        move,
        noise,
        small if calibrated and bias.any() else None,
        bend if tolerance.entries else None,
    )
