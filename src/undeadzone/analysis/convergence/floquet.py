"""Decay rate of the error along a schedule of branches, and its steady state under disturbance.

The former are Floquet multipliers of (x~, d~), the latter mean squares of what noise, disturbance
and model error become in the estimate. docs/rates.md derives both. Mean squares take many candidate
gains at once, along the first axes of F (..., K, N, N).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from undeadzone.analysis.branch_schedule import Schedule, merge_equal_neighbours
from undeadzone.analysis.error_dynamics import branch_pattern, build_error_dynamics
from undeadzone.analysis.identifiability.linear import Unobservable, unobservable_changes
from undeadzone.linalg.matrices import Matrices
from undeadzone.util.arrays import Floats

NEUTRAL = 1e-9  # a multiplier with a smaller logarithm counts as constant
EXPONENTIAL_TERMS = 10  # of the exponential series, exact to rounding for arguments of norm 1/8
TINY = 1e-300
TERMS = 12  # of Taylor series whose terms shrink by 1/4 or more
PASSES = 30  # doublings of the number of passes until the steady state, at most


class Rates(NamedTuple):
    """Floquet multipliers of the error over a pass of a schedule, with decay rate and slow
    modes.

    Attributes:
        rate: -ln rho / T [1/s], rho the largest multiplier once those that unidentifiable
            directions keep on the unit circle are set apart (-inf: the error grows beyond all
            numbers).
        time_constant: 1 / rate [s], inf if the error does not decay.
        logs: logarithms of the multipliers, by falling real part.
        slow: what dies last, in (x~, [d~_r, d~_l] per output), largest entry 1 (n + 2p, m).
        never: the unidentifiable states and widths, whose errors stay.
        period: T [s].
        periodic: whether the schedule repeats by itself.
        gain: the largest factor by which one pass can multiply an error, in balanced units.
    """

    rate: float
    time_constant: float
    logs: np.ndarray
    slow: Floats
    never: tuple[str, ...]
    period: float
    periodic: bool
    gain: float


def error_decay_rates(
    linear: Matrices, L: Floats, gamma: Floats, schedule: Schedule, jump: bool = False
) -> Rates:
    """Return the rate of x~ -> 0, d~ -> 0 along a schedule, with the Floquet multipliers.

    A schedule that is not periodic is taken as repeated: the rate is then its mean over many such
    passes. Widths that are not adapted (gamma = 0), or that a jump sensor's readings do not hold,
    are left out of the error.

    Args:
        linear: A, B, C of the plant, of one step if sampled.
        L: observer gains (n x p) [1/s].
        gamma: adaptation gains, see `error_dynamics.adaptation` [1/s].
        schedule: of the sides.
        jump: whether the sensor jumps.
    """
    errors = build_error_dynamics(linear, L, gamma, schedule.Ts)
    n = linear.A.shape[0]
    schedule = merge_equal_neighbours(schedule)
    adapted = (np.abs(errors.gamma).sum(axis=0) > 0) & (not jump)
    part = np.concatenate([np.ones(n, bool), adapted])
    hidden = unobservable_changes(
        linear, schedule.branch_visits(), schedule.Ts, jump=jump
    ).restrict_to_part(part)
    units = hidden.scale[part]
    F, _ = error_matrices(errors.A[0], errors.C, errors.L, errors.gamma, schedule.sides)
    with np.errstate(over="ignore", invalid="ignore"):
        scaled = F[:, part][:, :, part] * units / units[:, None]
        M, size = matrix_product(span_transitions(scaled, schedule))
    if not np.isfinite(M).all():
        return _infinite_growth_rates(part.size, schedule)
    logs, ways, never = _multipliers_and_modes(M, size, hidden, part)
    # The modes that die last; a complex pair gives its real and its imaginary part.
    slowest = np.flatnonzero(logs.real > logs.real.max(initial=-np.inf) - 1e-7)
    ways = ways * units[:, None]
    slow = np.zeros((part.size, slowest.size))
    slow[part] = np.where(logs[slowest].imag < 0, ways[:, slowest].imag, ways[:, slowest].real)
    T = schedule.total_duration
    rate = -float(logs.real.max()) / T if logs.size else 0.0
    return Rates(
        rate,
        1 / rate if rate > 0 else np.inf,
        logs[np.argsort(-logs.real)],
        slow / slow[np.abs(slow).argmax(axis=0), np.arange(slowest.size)],
        never,
        T,
        schedule.periodic,
        float(np.linalg.norm(M, 2) * np.exp(size)),
    )


def _infinite_growth_rates(unknowns: int, schedule: Schedule) -> Rates:
    """Return the rates of an error that grows beyond all numbers in a pass."""
    none = np.zeros((unknowns, 0))
    T = schedule.total_duration
    periodic = schedule.periodic
    return Rates(-np.inf, np.inf, np.array([np.inf]), none, (), T, periodic, np.inf)


def _multipliers_and_modes(
    M: Floats, size: Floats, hidden: Unobservable, part: np.ndarray
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Return the multipliers of the monodromy matrix M e^size, eigenvectors, unidentifiable
    names.

    hidden: changes that no reading shows. part: the unknowns that M maps.

    Returns:
        Logarithms of the multipliers, complex, but for those that unidentifiable directions keep on
        the circle. Then their eigenvectors as columns, and descriptions of the directions kept.
    """
    count = hidden.basis.shape[1]
    U, V = np.split(np.linalg.svd(hidden.basis[part])[0], [count], axis=1)
    # M maps the hidden subspace (U) into itself, so that its multipliers are those of both blocks.
    multipliers, hidden_vectors = np.linalg.eig(U.T @ M @ U)
    stays = np.abs(np.log(np.maximum(np.abs(multipliers), TINY)) + size) < NEUTRAL
    never: tuple[str, ...] = ()
    if stays.any():
        staying = np.hstack([hidden_vectors[:, stays].real, hidden_vectors[:, stays].imag])
        never = hidden._replace(basis=hidden.basis @ staying).names_of_undetermined
    dying, vectors = np.linalg.eig(V.T @ M @ V)
    mu = np.append(multipliers[~stays], dying)
    logs = np.log(np.maximum(np.abs(mu), TINY)) + size + 1j * np.angle(mu)
    return logs, np.hstack([U @ hidden_vectors[:, ~stays], V @ vectors]), never


def error_matrices(
    A: Floats, C: Floats, L: Floats, gamma: Floats, sides: Floats
) -> tuple[Floats, Floats]:
    """Return (F, G) of (x~, d~)' = F (x~, d~) + G v on each of K branch patterns, v noise on
    z.

    x~' = A x~ - L e, d~' = Gamma S'e with e = C x~ - S d~ + v on the active outputs, 0 on the
    silent ones.

    Args:
        A: the plant's matrix (n x n) (delta form if sampled, and then so are F and G [1/s]).
        C: its outputs (p x n).
        L: observer gains (..., n, p) [1/s].
        gamma: Gamma (..., 2p, 2p) [1/s].
        sides: +1, 0, -1 of each output (K x p).

    Returns:
        F (..., K, n + 2p, n + 2p), G (..., K, n + 2p, p).
    """
    n = A.shape[0]
    S = np.stack([branch_pattern(tuple(row)) for row in sides.astype(int)])
    active = np.abs(sides)
    rows = np.concatenate([C * active[:, :, None], -S], axis=2)
    to_states = -L[..., None, :, :] * active[:, None, :]
    to_widths = gamma[..., None, :, :] @ S.transpose(0, 2, 1)
    G = np.concatenate([to_states, to_widths], axis=-2)
    F = np.asarray(G @ rows)
    F[..., :n, :n] += A
    return F, G


def span_transitions(F: Floats, schedule: Schedule) -> Floats:
    """Return the transition matrix over each span: e^(F t), or (I + Ts F)^k (..., K, N, N)."""
    if schedule.Ts is None:
        return matrix_exponentials(F * schedule.spans[:, None, None])
    return matrix_powers(np.eye(F.shape[-1]) + schedule.Ts * F, schedule.spans.astype(int))


def matrix_product(factors: Floats) -> tuple[Floats, Floats]:
    """Return (M, s): the product ... F_2 F_1 F_0 of the factors is M e^s. No underflow.

    Args:
        factors: F_0, F_1, ... (..., K, N, N).
    """
    size = np.zeros(factors.shape[:-3])
    while factors.shape[-3] > 1:
        if factors.shape[-3] % 2:
            one = (*size.shape, 1, *factors.shape[-2:])
            identity = np.broadcast_to(np.eye(factors.shape[-1]), one)
            factors = np.concatenate([factors, identity], axis=-3)
        factors = factors[..., 1::2, :, :] @ factors[..., ::2, :, :]
        norms = np.maximum(np.abs(factors).max(axis=(-2, -1)), TINY)
        size = size + np.log(norms).sum(axis=-1)
        factors = factors / norms[..., None, None]
    return factors[..., 0, :, :], size


def matrix_exponentials(X: Floats) -> Floats:
    """Return e^X of many small matrices (..., K, N, N), by scaling, Taylor's series and
    squaring.
    """
    halvings = _count_halvings(X, 1.0)
    X = X / (2.0**halvings)[:, None, None]
    identity = np.eye(X.shape[-1])
    E = identity + X / EXPONENTIAL_TERMS
    for k in range(EXPONENTIAL_TERMS - 1, 0, -1):
        E = identity + X @ E / k
    return matrix_powers(E, 2**halvings)


def _count_halvings(X: Floats, spans: Floats | float) -> Any:
    """Return how often each span is halved so that a series of X (..., K, N, N) is short (K)."""
    norm = np.abs(X).sum(axis=-1).max(axis=-1).reshape(-1, X.shape[-3]).max(axis=0)
    return np.ceil(np.log2(np.maximum(8 * norm * spans, 1.0))).astype(int)


def matrix_powers(X: Floats, times: Floats) -> Floats:
    """Return X[..., k, :, :] to the power times[k] >= 0 (..., K, N, N), by squaring."""
    raised = np.broadcast_to(np.eye(X.shape[-1]), X.shape)
    while True:
        odd = times % 2 == 1
        if odd.any():
            raised = np.where(odd[:, None, None], raised @ X, raised)
        times = times // 2
        if not times.any():
            return np.asarray(raised)
        X = X @ X


class WeightedSpans(NamedTuple):
    """K spans of constant branches with S weighted sums along each.

    Attributes:
        Phi: the transition matrix (..., K, N, N).
        G: the sum of Phi_t'H Phi_t over the span (S, ..., K, N, N).
        GG: the sum over the span of G_t, which is that sum up to t, of the first H (S or less).
        length: of the span, in its unit (K, 1, 1).
    """

    Phi: Floats
    G: Floats
    GG: Floats
    length: Floats


def integrate_spans(
    F: Floats, weights: Sequence[Floats], schedule: Schedule, twice: int = 0
) -> WeightedSpans:
    """Return transition and weighted sums of each span for x' = F x (or x+ = (I + Ts F) x).

    Args:
        F: the dynamics in each span (..., K, N, N) [1/s].
        weights: S weights of x (..., N, N each).
        schedule: of the sides.
        twice: number of leading weights for which the sum of sums is computed.
    """
    H = np.stack([np.broadcast_to(weight, F.shape) for weight in weights])
    if schedule.Ts is not None:
        step = np.broadcast_to(np.eye(F.shape[-1]), F.shape) + schedule.Ts * F
        length = np.ones((F.shape[-3], 1, 1))
        return _repeat_spans(
            WeightedSpans(step, H, 0 * H[:twice], length), schedule.spans.astype(int)
        )
    halvings = _count_halvings(F, schedule.spans)
    h = (schedule.spans / 2.0**halvings)[:, None, None]
    # Taylor series over h: of Phi with terms (F h)^k / k!, of G and GG with derivatives of G_t.
    power = Phi = np.eye(F.shape[-1]) + 0 * F
    G = 0 * H
    GG = 0 * H[:twice]
    term = H + 0 * F
    for k in range(1, TERMS):
        coefficient = h / k
        power = power @ F * coefficient
        Phi = Phi + power
        G = G + coefficient * term
        GG = GG + coefficient * (h / (k + 1)) * term[:twice]
        term = coefficient * (_transpose_last(F) @ term + term @ F)
    whole = WeightedSpans(Phi, G, GG, h)
    for k in range(halvings.max(initial=0)):
        whole = _select_spans(halvings > k, _join_spans(whole, whole), whole)
    return whole


def mean_squares(
    F: Floats, Z: Floats, sources: Sequence[Floats], schedule: Schedule
) -> list[Floats]:
    """Return the mean of |Z x|^2 over a pass for each source.

    The pass is in the steady state of x' = F x + v with white noise v.

    Sampled, x+ = (I + Ts F) x + v, and the mean is over the samples. Large if x does not settle.

    Args:
        F: the dynamics in each span (..., K, N, N) [1/s].
        Z: rows of what counts (rows x N).
        sources: covariances of v (..., K, N, N), per second, or per step if sampled.
        schedule: of the sides.
    """
    over = integrate_spans(F, [Z.T @ Z], schedule, 1)
    means = []
    spreads = integrate_spans(
        _transpose_last(F), sources, schedule
    ).G  # contribution of one span to the covariance
    for source, spread in zip(sources, spreads, strict=True):
        covariance = _stationary_covariance(over.Phi, spread)
        total = (over.GG[0] * source).sum(axis=(-3, -2, -1))
        for k in range(F.shape[-3]):
            total = total + (over.G[0, ..., k, :, :] * covariance).sum(axis=(-2, -1))
            covariance = _covariance_after_span(over.Phi, covariance, k) + spread[..., k, :, :]
        means.append(np.asarray(total / schedule.spans.sum()))
    return means


def _stationary_covariance(Phi: Floats, spread: Floats) -> Floats:
    """Return the covariance (..., N, N) at the start of a pass after many passes, by doubling."""
    covariance: Floats = np.zeros(Phi.shape[:-3] + Phi.shape[-2:])
    for k in range(Phi.shape[-3]):
        covariance = _covariance_after_span(Phi, covariance, k) + spread[..., k, :, :]
    M = _total_transition(Phi)
    for _ in range(PASSES):
        covariance = covariance + M @ covariance @ _transpose_last(M)
        M = M @ M
        if not np.abs(M).max(initial=0.0) > 1e-9:
            break
    return covariance


def mean_square_of_forced_error(
    F: Floats, Z: Floats, push: Floats, S: Floats, starts: Floats, schedule: Schedule
) -> Floats:
    """Return the mean over a pass of sum_j |Z x_j|^2 for x_j' = F x_j + push_j w, w' = S w.

    The value is that of the steady state.

    The pass is taken as repeated. F, push and S are in delta form if sampled.

    Args:
        F: the dynamics in each span (..., K, N, N) [1/s].
        Z: rows of what counts (rows x N).
        push: how w drives each x_j (J, N, k).
        S: of the exosystem (k x k) [1/s].
        starts: w at the start of each span (K, k).
        schedule: of the sides.
    """
    N, k = push.shape[1:]
    weight = np.zeros((N + k, N + k))
    weight[:N, :N] = Z.T @ Z
    total = np.zeros(F.shape[:-3])
    for E in push:
        over = integrate_spans(_augment_exosystem(F, E, S), [weight], schedule)
        x: Floats = np.zeros((*F.shape[:-3], N))
        for span, w in enumerate(starts):
            x = _state_after_span(x, w, over.Phi[..., span, :, :])
        # x is now the contribution of one pass. In the steady state x = (remainder of x) + that.
        once = np.eye(N) - _total_transition(over.Phi[..., :N, :N])
        x = (np.linalg.pinv(once, rcond=1e-12) @ x[..., None])[..., 0]
        for span, w in enumerate(starts):
            both = np.concatenate([x, np.broadcast_to(w, (*x.shape[:-1], k))], axis=-1)
            G = over.G[0, ..., span, :, :]
            total = total + (both[..., None, :] @ G @ both[..., None])[..., 0, 0]
            x = _state_after_span(x, w, over.Phi[..., span, :, :])
    return np.asarray(total / schedule.spans.sum())


def _augment_exosystem(F: Floats, E: Floats, S: Floats) -> Floats:
    """Return the dynamics (..., K, N + k, N + k) of (x, w): x' = F x + E w, w' = S w."""
    N, k = E.shape
    joined = np.zeros((*F.shape[:-2], N + k, N + k))
    joined[..., :N, :N] = F
    joined[..., :N, N:] = E
    joined[..., N:, N:] = S
    return joined


def _state_after_span(x: Floats, w: Floats, Phi: Floats) -> Floats:
    """Return x (..., N) at the end of a span that starts with x and w (k).

    Phi is the transition of (x, w).
    """
    N = x.shape[-1]
    return np.asarray((Phi[..., :N, :N] @ x[..., None] + Phi[..., :N, N:] @ w[:, None])[..., 0])


def _repeat_spans(one: WeightedSpans, times: Floats) -> WeightedSpans:
    """Return each span repeated `times` (K), by doubling."""
    identity = np.broadcast_to(np.eye(one.Phi.shape[-1]), one.Phi.shape)
    whole = WeightedSpans(identity, 0 * one.G, 0 * one.GG, 0 * one.length)
    while True:
        odd = times % 2 == 1
        if odd.any():
            whole = _select_spans(odd, _join_spans(whole, one), whole)
        times = times // 2
        if not times.any():
            return whole
        one = _join_spans(one, one)


def _select_spans(which: np.ndarray, new: WeightedSpans, old: WeightedSpans) -> WeightedSpans:
    """Return the new spans selected by `which` (K), and the old spans elsewhere."""
    if which.all():
        return new
    pairs = zip(new, old, strict=True)
    return WeightedSpans(*[np.where(which[:, None, None], *pair) for pair in pairs])


def _join_spans(a: WeightedSpans, b: WeightedSpans) -> WeightedSpans:
    """Return span a followed by span b."""
    Pt = _transpose_last(a.Phi)
    return WeightedSpans(
        b.Phi @ a.Phi,
        a.G + Pt @ b.G @ a.Phi,
        a.GG + b.length * a.G[: len(a.GG)] + Pt @ b.GG @ a.Phi,
        a.length + b.length,
    )


def _covariance_after_span(Phi: Floats, covariance: Floats, k: int) -> Floats:
    """Return a covariance (..., N, N) at the end of span k."""
    return np.asarray(Phi[..., k, :, :] @ covariance @ _transpose_last(Phi[..., k, :, :]))


def _total_transition(Phi: Floats) -> Floats:
    """Return the transition over all spans (..., N, N)."""
    M, size = matrix_product(Phi)
    return np.asarray(M * np.exp(size)[..., None, None])


def _transpose_last(M: Floats) -> Floats:
    """Return the matrices transposed."""
    return np.swapaxes(M, -1, -2)
