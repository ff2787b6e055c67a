"""Error dynamics: switching, adaptation, and the scaling that solvers use.

Errors obey x~' = A x~ - L e, d~' = Gamma S'e with the innovation e = theta (C x~ - S d~), 0 <=
theta <= 1. The measured side determines S: +1 at d_r of an output read on the right, -1 at
d_l on the left, e = 0 inside the zone. Sampled: the same with (x~+ - x~)/Ts in place of x~', A =
(Ad - I)/Ts, L and Gamma per second (delta form).
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from undeadzone.analysis.dissipation import Inequality, build_quadratic_form
from undeadzone.errors import InputError
from undeadzone.linalg.matrices import Matrices, balance_states, delta_form, symmetric_part
from undeadzone.util.arrays import Floats, require_array, require_matrix, require_vector


class Dynamics(NamedTuple):
    """Error dynamics: n states (those of x~), p outputs.

    Attributes:
        A: the vertices (each n x n, delta form if sampled) [1/s].
        C: outputs of x~ (p x n).
        L: observer gains (n x p) [1/s].
        gamma: Gamma, adaptation gains (2p x 2p, [right, left] per output) [1/s].
        Ts: sample time [s] (None in continuous time).
    """

    A: tuple[Floats, ...]
    C: Floats
    L: Floats
    gamma: Floats
    Ts: float | None

    @property
    def largest_gain_steps(self) -> list[Floats]:
        """Return Ts S Gamma S' (p x p) for the branch patterns that no other pattern
        dominates.

        One zero matrix in continuous time.
        """
        p = self.C.shape[0]
        if self.Ts is None:
            return [np.zeros((p, p))]
        if not (self.gamma - np.diag(np.diag(self.gamma))).any():
            return [self.Ts * np.diag(np.diag(self.gamma).reshape(p, 2).max(axis=1))]
        patterns = list(map(branch_pattern, itertools.product((1, -1), repeat=p)))
        return [self.Ts * S @ self.gamma @ S.T for S in patterns]

    @property
    def groups(self) -> Floats:
        """Return Z (p x groups): outputs coupled by Gamma must share their weight, W = Z
        w.
        """
        p = self.C.shape[0]
        coupling = np.abs(self.gamma).reshape(p, 2, p, 2).sum(axis=(1, 3))
        linked = (coupling > 0) | np.eye(p, dtype=bool)
        reach = np.linalg.matrix_power(linked.astype(int), p) > 0
        return np.unique(reach, axis=0).T.astype(float)

    def inequality(self, W: Floats) -> Inequality:
        """Return V' < 0 for V = x~'P x~ + d~'(W Gamma^-1) d~, in (x~, e): affine in W and
        in P.

        Args:
            W: weights of the outputs (p).
        """
        return self.extend_inequality(W, np.zeros((self.L.shape[0], 0)), [])

    def extend_inequality(
        self, W: Floats, E: Floats, terms: list[tuple[int, int, Floats]], decay: float = 0.0
    ) -> Inequality:
        """Return `inequality` of x~' = A x~ - L e + E w with more terms in (x~, e, w).

        Args:
            W: weights of the outputs (p).
            E: how outside signals w enter x~' (n x q).
            terms: blocks to be added, see `dissipation.build_quadratic_form`.
            decay: rate [1/s] at which sqrt(x~'P x~) must fall besides.
        """
        n, p = self.L.shape
        supplies = []
        sizes = []
        for step in self.largest_gain_steps:
            own = [
                (0, 1, self.C.T * W),
                (1, 1, -2 * np.diag(W)),
                (1, 1, (W[:, None] * step + W * step) / 2),
            ]
            supply, size = build_quadratic_form([n, p, E.shape[1]], own + terms)
            supplies.append(supply)
            sizes.append(size)
        return Inequality(
            self.A, np.hstack([-self.L, E]), tuple(supplies), tuple(sizes), self.Ts, decay
        )


class Storage(NamedTuple):
    """Storage function V = x~'P x~ + d~'R d~ with R = W Gamma^-1.

    Attributes:
        P: weight of the state errors (n x n).
        W: weights of the outputs (p), each once per edge.
        gamma: Gamma (2p x 2p) [1/s].
    """

    P: Floats
    W: Floats
    gamma: Floats

    @property
    def R(self) -> Floats:
        """Return the weight (2p x 2p) of the width errors, or 0 if a width is not adapted."""
        rows = np.diag(self.gamma) > 0
        adapted = np.ix_(rows, rows)
        R = np.zeros_like(self.gamma)
        R[adapted] = np.linalg.inv(self.gamma[adapted])
        return np.asarray(np.repeat(self.W, 2)[:, None] * R)

    @property
    def visible_errors(self) -> tuple[np.ndarray, Floats]:
        """Return (mask of the entries e of `[x~; d~]` that enter V, M with V = e'M e)."""
        R = self.R
        n = len(self.P)
        widths = np.diag(R) > 0
        M = np.zeros((n + widths.sum(), n + widths.sum()))
        M[:n, :n] = self.P
        M[n:, n:] = R[np.ix_(widths, widths)]
        return np.concatenate([np.ones(n, bool), widths]), M

    def evaluate_storage(self, x_error: Floats, d_error: Floats) -> Floats:
        """Return V (N) along errors.

        Args:
            x_error: x - x^ (N x n).
            d_error: d - d^ (N x 2p, [right, left] of each output).
        """
        of_states = np.einsum("ki,ij,kj->k", x_error, self.P, x_error)
        return of_states + np.einsum("ki,ij,kj->k", d_error, self.R, d_error)


def identity_storage(errors: Dynamics) -> Storage:
    """Return V = |x~|^2 + d~'Gamma^-1 d~, used if no better V was found."""
    n, p = errors.L.shape
    return Storage(np.eye(n), np.ones(p), errors.gamma)


def build_error_dynamics(linear: Matrices, L: Floats, gamma: Floats, Ts: float | None) -> Dynamics:
    """Return the error dynamics of a model with n states and p outputs.

    Args:
        linear: A, B, C of the model (of one step if sampled).
        L: observer gains (n x p) [1/s].
        gamma: adaptation gains in any form of `adaptation` [1/s].
        Ts: sample time [s] (None in continuous time).

    Raises:
        InputError, ShapeError: for gains of the wrong kind.
    """
    n = linear.A.shape[0]
    p = linear.C.shape[0]
    L = require_matrix("L", L, n, p, "states x outputs")
    return Dynamics((delta_form(linear, Ts).A,), linear.C, L, adaptation_matrix(gamma, p), Ts)


def largest_growth_rate(A: Floats, Ts: float | None) -> float:
    """Return the largest growth rate [1/s] of x' = A x, or of x+ = x + Ts A x as (|z| - 1) /
    Ts.
    """
    poles = np.linalg.eigvals(A)
    if Ts is None:
        return float(poles.real.max())
    return float((np.abs(1 + Ts * poles).max() - 1) / Ts)


def adaptation_matrix(gamma: Floats, p: int) -> Floats:
    """Return Gamma (2p x 2p), [right, left] per output, from any of its accepted forms.

    Args:
        gamma: one number, one per output (p), one per edge (p x 2), or Gamma itself [1/s].
        p: how many outputs there are.

    Raises:
        InputError: if it is negative, or a full matrix is not symmetric and positive definite.
        ShapeError: if it has another shape.
    """
    gains = require_array("gamma", gamma)
    if gains.ndim == 2 and gains.shape == (2 * p, 2 * p):
        # Only rounding may make it asymmetric: V = d~'W Gamma^-1 d~ holds its symmetric part.
        rounding = 8 * np.finfo(float).eps * np.abs(gains).max()
        if np.abs(gains - gains.T).max() > rounding or np.linalg.eigvalsh(gains)[0] <= 0:
            raise InputError("gamma: a full matrix must be symmetric and positive definite")
        return symmetric_part(gains)
    if gains.ndim < 2:
        per_edge = np.repeat(require_vector("gamma", gains, p, "one per output"), 2)
    else:
        per_edge = require_matrix("gamma", gains, p, 2, "[right, left] per output").ravel()
    if (per_edge < 0).any():
        raise InputError(f"gamma: must not be negative, found {per_edge.min():g}")
    return np.diag(per_edge)


def branch_pattern(sides: tuple[int, ...]) -> Floats:
    """Return S (p x 2p) of the active branches: C x~ - S d~ is the innovation there.

    Args:
        sides: +1 (right), 0 (silent) or -1 (left) of each output.
    """
    S = np.zeros((len(sides), 2 * len(sides)))
    for i, side in enumerate(sides):
        if side:
            S[i, 2 * i + (side < 0)] = side
    return S


class Scaling(NamedTuple):
    """Units that are powers of two, so that scaling rounds nothing.

    Attributes:
        state: x = state x_scaled (n).
        output: e = output e_scaled (p).
        time: t = time t_scaled [s].
    """

    state: Floats
    output: Floats
    time: float

    def scale_dynamics(self, errors: Dynamics) -> Dynamics:
        """Return the error dynamics in scaled quantities."""
        x, y, t = self
        return Dynamics(
            tuple(t * A * x / x[:, None] for A in errors.A),
            errors.C * x / y[:, None],
            t * errors.L * y / x[:, None],
            t * errors.gamma,
            None if errors.Ts is None else errors.Ts / t,
        )

    def unscale_storage(self, P: Floats) -> Floats:
        """Return P in original quantities (n x n)."""
        return np.asarray(self.time * P / np.outer(self.state, self.state))

    def unscale_weights(self, W: Floats) -> Floats:
        """Return W in original quantities (p)."""
        return W / self.output**2


def _fastest_error_rate(A: Floats, errors: Dynamics) -> float:
    """Return the rate of the errors [1/s]: the fastest pole of A, or a size if all poles are
    0.
    """
    sizes = (
        np.abs(np.linalg.eigvals(A)).max(),
        np.linalg.norm(A),
        np.linalg.norm(errors.L @ errors.C),
        1.0,
    )
    return next(float(size) for size in sizes if size > 1e-100)


def balance_dynamics(errors: Dynamics) -> Scaling:
    """Return the scaling that balances rows and columns of x~ and e, coupled by L and C.

    Outputs that share a weight keep a common unit.
    """
    A = np.mean(errors.A, axis=0)
    n = A.shape[0]
    p = errors.C.shape[0]
    time = 2.0 ** -np.round(np.log2(_fastest_error_rate(A, errors)))
    joined = np.block([[time * A, time * errors.L], [errors.C, np.eye(p)]])
    scale = balance_states(joined)
    leaders = np.argmax(errors.groups, axis=0)  # one output of each group
    return Scaling(scale[:n], errors.groups @ scale[n:][leaders], float(time))
