"""The Kalman filter that also hears silence, with coloured disturbance, bias and model tolerance (docs/filters.md)."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import msgspec
import numpy as np
from scipy.linalg import block_diag, expm, expm_frechet, solve_discrete_lyapunov

from undeadzone.arrays import Array, Floats, nonnegative, scalar
from undeadzone.errors import InputError
from undeadzone.observers.filtering import Extension, Params, measured_filter, prior
from undeadzone.observers.interface import Observer
from undeadzone.plant import Matrices, System
from undeadzone.sensor import Zone


class Censored(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="method", tag="censored"):
    """`Kalman` that also uses that a silent sensor bounds z, and knows what else may be wrong; sampled time.

    right, left, noise, x_std, drift: as for `Kalman`. disturbance: rms of a coloured input disturbance [u], one or one
    per input, that keeps its sign for correlation_time [s] (default: a quarter period of the plant) and has no constant part
    beyond washout_time [s] (default: 1.5 correlation_time). bias: rms of an unknown constant at the input [u].
    tolerance: relative rms error of the model: of every entry of A and B but in rows that only say x_i' = x_j, or of
    some, as { "A[1,0]" = 0.1 }; of every parameter of a nonlinear plant. silence: false ignores the silent samples.
    """

    right: Array
    left: Array | None = None
    noise: Array | None = None
    x_std: Array | None = None
    drift: float = 0.0
    disturbance: Array = 0.0
    correlation_time: float | None = None
    washout_time: float | None = None
    bias: Array = 0.0
    tolerance: float | dict[str, float] = 0.0
    silence: bool = True

    def build(self, model: System, sensor: Zone) -> Observer:
        """The filter for a sampled model. Raises InputError, ShapeError."""
        believed = prior(model, sensor, self.right, self.left, self.noise, self.x_std, self.drift)
        assert model.Ts is not None
        assert model.flow is not None
        correlation = time_scale(model.flow) if self.correlation_time is None else scalar("observer.correlation_time", self.correlation_time, above=0.0)
        washout = 1.5 * correlation if self.washout_time is None else scalar("observer.washout_time", self.washout_time, above=0.0)
        for key, value in (("correlation_time", correlation), ("washout_time", washout)):
            if not 0.1 * model.Ts <= value <= 1e6 * model.Ts:
                raise InputError(f"observer.{key}: must lie between 0.1 and 1e6 sample times of {model.Ts:g} s, found {value:.4g} s")
        rms, bias = (nonnegative(f"observer.{key}", getattr(self, key), model.m, "one per input") for key in ("disturbance", "bias"))
        extension = unknowns(model, band_pass(correlation, washout, model.Ts), rms, bias, tolerances(model, self.tolerance))
        return measured_filter(model, sensor, believed, extension, max(1.0, correlation / model.Ts), self.silence)


class BandPass(NamedTuple):
    """p+ = F p + noise of covariance Q (2 x 2); p_1 - p_2 has unit rms and no constant part; cov: stationary."""

    F: Floats
    Q: Floats
    cov: Floats


class Numbers(NamedTuple):
    """Run-time numbers: F, Q and variances of the disturbance, `Tolerance.slopes`, the state (n) at rest under each unit bias."""

    F: Floats
    Q: Floats
    variance: Floats
    slopes: Floats
    rest: Floats


def band_pass(correlation: float, washout: float, Ts: float) -> BandPass:
    """p_1' = -p_1 / correlation + white noise, p_2' = (p_1 - p_2) / washout, sampled exactly, scaled to unit rms of p_1 - p_2."""
    F = np.array([[-1 / correlation, 0.0], [1 / washout, -1 / washout]])
    intensity = 2 * (1 / correlation + 1 / washout)  # makes E (p_1 - p_2)^2 = 1
    # van Loan (1978): exp [[-F, W], [0, F']] Ts = [[., Fd^-1 Q], [0, Fd']]
    both = expm(np.block([[-F, np.diag([intensity, 0.0])], [np.zeros((2, 2)), F.T]]) * Ts)
    Fd = both[2:, 2:].T
    Q = Fd @ both[:2, 2:]
    return BandPass(Fd, (Q + Q.T) / 2, solve_discrete_lyapunov(Fd, Q))


def time_scale(flow: Matrices) -> float:
    """A quarter period pi / (2 |pole|) [s], geometric mean over the poles that are not integrators. Raises InputError if all are."""
    rates = np.abs(np.linalg.eigvals(flow.A))
    moving = rates[rates > 1e-6 * np.linalg.norm(flow.A, 2)]
    if not moving.size:
        raise InputError("observer.correlation_time: missing; a chain of integrators has no time scale of its own, give one in seconds")
    return float(np.pi / 2 * np.exp(-np.log(moving).mean()))


class Tolerance(NamedTuple):
    """Relative standard deviations (K) of what is uncertain, and d[Ad, Bd] per relative change of each (Kn x (n + m)).

    For a nonlinear plant these are its parameters, and there is no matrix.
    """

    std: Floats
    slopes: Floats


def tolerances(model: System, given: float | dict[str, float]) -> Tolerance:
    """The uncertain entries of the plant's A and B, or its parameters. Raises InputError."""
    assert model.Ts is not None
    assert model.flow is not None
    n, m = model.n, model.m
    if model.nonlinear:
        if isinstance(given, dict):
            raise InputError("observer.tolerance: a nonlinear plant takes one number, for all of its parameters")
        std = scalar("observer.tolerance", given, least=0.0)
        return Tolerance(np.full(np.size(model.params) if std else 0, std), np.zeros((0, n + m)))
    AB = np.hstack(model.flow[:2])
    names = {f"{name}[{i},{j}]": (i, j + (n if name == "B" else 0)) for name, columns in (("A", n), ("B", m)) for i in range(n) for j in range(columns)}
    if not isinstance(given, dict):
        free = np.flatnonzero(~((np.count_nonzero(AB, axis=1) == 1) & (AB.max(axis=1) == 1.0)))
        given = {name: given for name, (i, j) in names.items() if i in free and AB[i, j] != 0.0}
    found = []
    for name, value in given.items():
        std = scalar(f"observer.tolerance.{name}", value, least=0.0)
        if name not in names or AB[names[name]] == 0.0:
            uncertain = ", ".join(name for name, at in names.items() if AB[at] != 0.0)
            raise InputError(f"observer.tolerance.{name}: expected an entry of A or B that is not 0: {uncertain}")
        if std:
            found.append((std, names[name]))
    square = np.vstack([AB, np.zeros((m, n + m))]) * model.Ts
    slopes = [expm_frechet(square, square * _unit(at, square.shape), compute_expm=False)[:n] for _, at in found]
    return Tolerance(np.array([std for std, _ in found]), np.concatenate([np.zeros((0, n + m)), *slopes]))


def _unit(at: tuple[int, int], shape: tuple[int, ...]) -> Floats:
    found = np.zeros(shape)
    found[at] = 1.0
    return found


def unknowns(model: System, band: BandPass, rms: Floats, bias: Floats, tolerance: Tolerance) -> Extension:
    """Bias, disturbance and tolerance states of those inputs and entries that have any: extra = [bias; p_1; p_2; theta]."""
    n, count = model.n, tolerance.std.size
    biased, shaken = (np.eye(model.m)[:, size > 0] for size in (bias, rms))
    ends = np.cumsum([0, biased.shape[1], 2 * shaken.shape[1], count]).tolist()
    difference = np.kron([1.0, -1.0], np.eye(shaken.shape[1]))
    variance = rms[rms > 0] ** 2
    # The tolerance acts on x less the rest that a bias leads to: else estimates of theta would seem to tell bias from centre.
    rest = np.linalg.lstsq(np.eye(n) - model.linear.A, model.linear.B @ biased, rcond=None)[0]

    def move(q: Params, x: Any, extra: Any, u: Any) -> tuple[Any, Any]:
        constant, low_pass, theta = ca.vertsplit(extra, ends)
        moving = u + shaken @ difference @ low_pass
        total = moving + biased @ constant
        if model.nonlinear:
            after = model.move(q.model * (1 + theta) if count else q.model, x, total)
        else:
            regressor = q.extension.slopes @ ca.vertcat(x - q.extension.rest @ constant, moving)
            after = model.move(q.model, x, total) + ca.reshape(regressor, n, count) @ theta
        return after, ca.vertcat(constant, ca.kron(q.extension.F, ca.SX.eye(shaken.shape[1])) @ low_pass, theta)

    def noise(q: Params, x: Any, u: Any) -> tuple[Any, Any]:
        static = [ca.SX(size, size) for size in (biased.shape[1], count)]
        return ca.SX(n, n), ca.diagcat(static[0], ca.kron(q.extension.Q, ca.diag(q.extension.variance)), static[1])

    cov = block_diag(np.diag(bias[bias > 0] ** 2), np.kron(band.cov, np.diag(variance)), np.diag(tolerance.std**2))
    return Extension(Numbers(band.F, band.Q, variance, tolerance.slopes, rest), cov, move, noise)
