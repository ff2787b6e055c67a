"""proto"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import msgspec
import numpy as np
from scipy.linalg import expm, expm_frechet, logm, solve_discrete_lyapunov

from undeadzone.arrays import Array, nonnegative
from undeadzone.observers.interface import Observer
from undeadzone.observers.kalman import Extra, beliefs, filtering
from undeadzone.plant import System
from undeadzone.sensor import Zone


class Censored(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="method", tag="censored"):
    right: Array
    left: Array | None = None
    noise: Array | None = None
    x_std: Array | None = None
    drift: Array = 0.0
    disturbance: Array = 0.0
    correlation: float = 0.2
    washout: float | None = 0.3
    bias: Array = 0.0
    tolerance: float = 0.0
    level: float = 1.645
    period: float = 0.2
    silence: bool = True

    def build(self, model: System, sensor: Zone) -> Observer:
        b = beliefs(self, model, sensor)
        n, m, Ts = model.n, model.m, model.Ts
        rms = nonnegative("d", self.disturbance, m)
        bias = nonnegative("b", self.bias, m)
        tl = self.washout
        # continuous band pass
        F = np.array([[-1 / self.correlation, 0], [1 / tl if tl else 0, -1 / tl if tl else 0]])
        big = np.zeros((4, 4)); big[:2, :2] = -F; big[:2, 2:] = np.diag([2 / self.correlation, 0]); big[2:, 2:] = F.T
        e = expm(big * Ts)
        Fd = e[2:, 2:].T
        Qd = Fd @ e[:2, 2:]
        S = solve_discrete_lyapunov(Fd, Qd)
        var = S[0, 0] - 2 * S[0, 1] + S[1, 1]
        S, Qd = S / var, Qd / var
        entries = []
        if self.tolerance:
            top = np.hstack(model.linear[:2])
            blk = np.vstack([top, np.hstack([np.zeros((m, n)), np.eye(m)])])
            M = logm(blk).real / Ts
            for i in range(n):
                if np.isclose(np.abs(M[i]).sum(), 1) and np.isclose(M[i].max(), 1):
                    continue
                for j in range(n + m):
                    if abs(M[i, j]) > 1e-9:
                        E = np.zeros_like(M); E[i, j] = M[i, j]
                        D = expm_frechet(M * Ts, E * Ts, compute_expm=False)
                        entries.append(D[:n])
        K = len(entries)
        use_b, use_w = bool(bias.any()), bool(rms.any())
        params = P(Fd, Qd, rms, tuple(entries))

        def move(model, q, X, u):
            x, k = X[:n], n + 2 * b.right.size
            d = X[n:k]
            nxt = []
            if use_b:
                be = X[k:k + m]; k += m; u = u + be; nxt.append(be)
            if use_w:
                w = ca.reshape(X[k:k + 2 * m], 2, m); k += 2 * m
                u = u + (w[0, :] - w[1, :]).T
                nxt.append(ca.vec(q.extra.F @ w))
            th = X[k:]
            xn = model.move(q.model, x, u)
            for i in range(K):
                xn = xn + th[i] * (q.extra.D[i] @ ca.vertcat(x, u))
            return ca.vertcat(xn, d, *nxt, th)

        def noise(model, q, X, u):
            parts = []
            if use_b: parts.append(ca.SX(m, m))
            if use_w: parts += [q.extra.Q * q.extra.rms[i] ** 2 for i in range(m)]
            if K: parts.append(ca.SX(K, K))
            return ca.diagcat(*parts)

        blocks = []
        if use_b: blocks.append(np.diag(bias**2))
        if use_w: blocks += [S * r**2 for r in rms]
        if K: blocks.append(np.eye(K) * self.tolerance**2)
        from scipy.linalg import block_diag
        return filtering(model, sensor, b, Extra(params, move, noise, block_diag(*blocks) if blocks else np.zeros((0, 0))), (self.level, self.period) if self.silence else None)


class P(NamedTuple):
    F: Any
    Q: Any
    rms: Any
    D: Any
