"""A sampled plant A(q) z = B(q) u + x(0), simulated over records, with exact gradients."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.signal import lfilter

from undeadzone.identification.climb import KeptClimbs
from undeadzone.identification.likelihood import Readings
from undeadzone.identification.log import Flags
from undeadzone.support.arrays import Floats, Integers

RINGING = 0.5  # the same for poles that ring: with x(0) they are a free sine, which is no offset
FAR = 1e100  # a coefficient beyond which no root can be computed
SLOW = 6.0  # poles slower than this many of their time constants a record are an offset in disguise


class Data(NamedTuple):
    """Records scaled to rms 1, one after another.

    Attributes:
        u: inputs (N x m), rms 1 each.
        y: readings (N), rms 1, 0 where missing.
        ok: whether there is a reading (N).
        start: first sample of each record (R).
        side: +1, 0, -1 (N).
        silent_zeros: whether readings inside the zone are exact zeros: noise ahead of the zone.
        u_scale, y_scale: what u (m) and y were divided by.
        climbs: those that were kept on disk; None: none are.
    """

    u: Floats
    y: Floats
    ok: Flags
    start: Integers
    side: Integers
    silent_zeros: bool
    u_scale: Floats
    y_scale: float
    climbs: KeptClimbs | None = None

    def readings(self, use: Flags | None = None) -> Readings:
        """What the likelihoods need; `use` (N): the samples that count, default all."""
        ok = self.ok if use is None else self.ok & use
        before = np.concatenate([[False], ok[:-1]])
        before[self.start] = False
        return Readings(self.y, self.side, ok, before)

    def records(self) -> list[slice]:
        """The samples of each record."""
        ends = np.append(self.start[1:], self.y.size)
        return [slice(int(a), int(b)) for a, b in zip(self.start, ends, strict=True)]


class Layout(NamedTuple):
    """Places of the numbers in theta = [a, b, x0, d_r, d_l, log s, atanh rho].

    Attributes:
        n: poles, and numerator terms from delay 1 of each input.
        m: inputs.
        records: records, each with n numbers for its initial state.
        integrators: how many of the poles are known to be integrators; a holds the others.
    """

    n: int
    m: int
    records: int
    integrators: int = 0

    @property
    def a(self) -> slice:
        """The denominator's free coefficients a_1, a_2, ..."""
        return slice(0, self.n - self.integrators)

    @property
    def b(self) -> slice:
        """The numerators, input by input."""
        return slice(self.a.stop, self.a.stop + self.n * self.m)

    @property
    def x0(self) -> slice:
        """The initial states, record by record."""
        return slice(self.b.stop, self.b.stop + self.n * self.records)

    @property
    def right(self) -> int:
        """d_r; d_l, log s and atanh rho follow."""
        return self.x0.stop

    def denominator(self, a: Floats) -> Floats:
        """The coefficients a_1 to a_n of the whole denominator, integrators included."""
        whole = np.append(1.0, a)
        for _ in range(self.integrators):
            whole = np.convolve(whole, [1.0, -1.0])
        return whole[1:]

    @property
    def size(self) -> int:
        """Numbers in theta."""
        return self.right + 4


class Simulator:
    """z and its gradient for one order, with the lagged inputs kept.

    Args:
        data: the records.
        n: number of poles.
        integrators: how many of them are integrators.
    """

    def __init__(self, data: Data, n: int, integrators: int = 0) -> None:
        self.data = data
        self.layout = Layout(n, data.u.shape[1], data.start.size, integrators)
        self.longest = max(part.stop - part.start for part in data.records())
        self.lagged = np.zeros((data.y.size, n * data.u.shape[1]))
        for part in data.records():
            for k in range(data.u.shape[1]):
                for j in range(n):
                    delayed = data.u[part.start : part.stop - 1 - j, k]
                    self.lagged[part.start + 1 + j : part.stop, n * k + j] = delayed

    def z(self, theta: Floats) -> Floats:
        """z (N) for parameters theta."""
        layout = self.layout
        denominator = np.append(1.0, layout.denominator(theta[layout.a]))
        drive = self.lagged @ theta[layout.b]
        x0 = theta[layout.x0].reshape(layout.records, layout.n)
        z = np.empty(drive.size)
        for part, state in zip(self.data.records(), x0, strict=True):
            own = drive[part].copy()
            count = min(layout.n, own.size)
            own[:count] += state[:count]
            z[part] = lfilter([1.0], denominator, own)
        return z

    def gradient(self, theta: Floats, z: Floats) -> Floats:
        """dz/dtheta (N x P), exact: one filter for a, one for x(0), one for each input."""
        layout = self.layout
        n, m = layout.n, layout.m
        moving = np.append(1.0, theta[layout.a])
        whole = np.append(1.0, layout.denominator(theta[layout.a]))
        slopes = np.zeros((z.size, layout.size))
        for r, part in enumerate(self.data.records()):
            size = part.stop - part.start
            by_a = lfilter([1.0], moving, z[part])
            sources = np.column_stack([self.data.u[part], np.eye(size, 1)])
            filtered = lfilter([1.0], whole, sources, axis=0)
            own = slopes[part]
            for i in range(layout.a.stop):
                own[i + 1 :, i] = -by_a[: size - 1 - i]
            for i in range(n):
                own[i:, layout.x0.start + n * r + i] = filtered[: size - i, -1]
                for k in range(m):
                    own[i + 1 :, layout.b.start + n * k + i] = filtered[: size - 1 - i, k]
        return slopes

    def gain(self, theta: Floats) -> Floats:
        """DC gain from each input to z (m); with integrators, to their input."""
        layout = self.layout
        numerators = theta[layout.b].reshape(layout.m, layout.n)
        return numerators.sum(axis=1) / (1 + theta[layout.a].sum())

    def poles(self, theta: Floats) -> Any:
        """Poles of the sampled plant (n), complex; integrators last."""
        moving = roots(theta[self.layout.a])
        return np.append(moving, np.ones(self.layout.integrators))

    def admissible(self, theta: Floats, margin: float = 1.0) -> bool:
        """Whether the poles are stable and settle, `margin` times over, within a record."""
        if not np.isfinite(theta).all():
            return False
        longest = self.longest
        poles = roots(theta[self.layout.a])
        slow = np.abs(np.angle(poles)) < 4 * np.pi / longest
        limit = np.where(slow, 1 - margin * SLOW / longest, 1 - margin * RINGING / longest)
        return bool(np.all(np.abs(poles) < limit))


def roots(a: Floats) -> Any:
    """Roots of z^n + a_1 z^(n-1) + ... + a_n (n): eigenvalues, complex where some are.

    Args:
        a: coefficients (n); of such as are not finite, all roots are infinite.
    """
    if not np.abs(a).max(initial=0.0) < FAR:
        return np.full(a.size, np.inf)
    companion = np.eye(a.size, k=-1)
    if a.size:
        companion[0] = -a
    return np.linalg.eigvals(companion)


def stabilised(a: Floats, radius: float = 0.98) -> Floats:
    """Denominator coefficients a_1.. with poles beyond `radius` moved onto it, for starts."""
    poles = roots(a)
    if not np.isfinite(poles).all():
        return np.zeros(a.size)
    size = np.abs(poles)
    moved = np.where(size > radius, poles / np.maximum(size, 1e-12) * radius, poles)
    return np.atleast_1d(np.real(np.poly(moved)))[1:]
