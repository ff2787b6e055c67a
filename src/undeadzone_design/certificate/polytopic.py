"""Certificate of a nonlinear model on a box of states and inputs: a common V for all Jacobians.

Proofs are in docs/certificate.md. By the mean value theorem the error obeys x~' = A(t) x~ - L e,
A(t) in the convex hull of df/dx over the box, as long as x, x^ and u stay in it. V is sought at
some of these Jacobians, the vertices, and then proved for all: interval arithmetic bounds df/dx on
parts of the box, which are halved until the bound suffices or a Jacobian is found that V misses. On
a part, A lies within the bound at the centre plus the bound on its derivatives times the way to the
part's edge.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable
from typing import NamedTuple

import casadi as ca
import numpy as np

from undeadzone.analysis.certificate.passivity import Certificate, certify_dynamics
from undeadzone.analysis.error_dynamics import Dynamics, adaptation_matrix
from undeadzone.compile.interval import Interval, build_enclosure
from undeadzone.errors import InputError, StructureError
from undeadzone.numerics.semidefinite import minimise_semidefinite, symmetric_matrix
from undeadzone.plants.region import Box
from undeadzone.plants.system import System
from undeadzone.util import tree
from undeadzone.util.arrays import Floats, Integers

PARTS = 200_000  # of the box that are looked at before a proof is given up
ROUNDS = 12  # searches for V, each with Jacobians that the last V missed
CORNERS = 16  # of the box that the first search takes
CURE = (
    ". The Jacobian there is singular: width identifiable, centre not: "
    "add a spring, gravity, an absolute reference pulse, or a known start"
)
AT_ONCE = 2048  # parts of the box in one evaluation
WORST = 8  # of the Jacobians that V misses are named
Bounds = Callable[[Box], Interval]


def certify_on(
    model: System, L: Floats, gamma: Floats, box: Box, parts: int = PARTS
) -> Certificate:
    """Certify gains while x, x^ and u stay in a box, for continuous and sampled models.

    Args:
        model: the model (n states, m inputs, p outputs).
        L: observer gains (n x p) [1/s].
        gamma: adaptation gains (p) [1/s].
        box: of [x, u] (n + m).
        parts: of the box that are looked at before the proof is given up.

    Returns:
        A certificate whose dynamics hold the vertices, and whose margin is that at them. If the
        result is 'no', the reason names a point of the box at which no V exists, or states that the
        proof was given up.

    Raises:
        InputError: for a model that is not smooth on the box.
    """
    return _certify_model(model, L, gamma, box, jacobian_on_box(model, box), parts)


def design_on(model: System, gamma: Floats, box: Box) -> Certificate:
    """Return certified gains for a box:

    L = P^-1 C' with A'P + PA <= -2 w I for every Jacobian A.

    w is the largest of their sizes. For a linear model `passivity.passive_gain`.

    Args:
        model: the model, in continuous time.
        gamma: adaptation gains (p) [1/s].
        box: of [x, u] (n + m).

    Raises:
        InputError: for a sampled model.
        StructureError: if no V exists.
    """
    if model.Ts is not None:
        raise InputError(
            "design_on: takes a model in continuous time; "
            "`certify_on` then judges its gains in sampled time"
        )
    slopes = jacobian_on_box(model, box)
    no_gain = _certify_model(model, np.zeros((model.n, model.p)), gamma, box, slopes, PARTS)
    if not no_gain.certified:
        raise StructureError(f"no gains can be certified on the region: {no_gain.reason}")
    P = _common_storage(no_gain.dynamics.A)
    if P is None:
        raise StructureError(
            "no gains were found on the region: the Jacobians are too far apart for the solver"
        )
    L = np.linalg.solve(P, model.linear.C.T)
    return _certify_model(model, L, gamma, box, slopes, PARTS)


def _common_storage(vertices: tuple[Floats, ...]) -> Floats | None:
    """Return P (n x n) of least trace with A'P + PA <= -2 w I at every vertex, or None."""
    n = len(vertices[0])
    q = 2 * max(float(np.linalg.norm(A, 2)) for A in vertices)

    def blocks(x: Floats) -> list[Floats]:
        """Return the matrices that must be positive semidefinite."""
        P = symmetric_matrix(x, n)
        return [P, *(-A.T @ P - P @ A - q * np.eye(n) for A in vertices)]

    trace = np.eye(n)[np.triu_indices(n)]
    entries = minimise_semidefinite(trace, blocks)
    return None if entries is None else symmetric_matrix(entries, n)


def _certify_model(
    model: System, L: Floats, gamma: Floats, box: Box, slopes: ModelJacobian, parts: int
) -> Certificate:
    """Return `certify_on` for the model's Jacobian: vertices are added until V covers all
    points.
    """
    points = _start_points(box)
    for _ in range(ROUNDS):
        points = points[_first_of_equal_matrices(slopes.at(points))]
        vertices = tuple(slopes.at(points))
        errors = Dynamics(vertices, model.linear.C, L, adaptation_matrix(gamma, model.p), model.Ts)
        certificate = certify_dynamics(errors)
        if not certificate.certified:
            return certificate._replace(reason=_failure_reason(certificate, points, model.n))
        beyond = find_missed_points(certificate, slopes, box, parts)
        if not beyond.size:
            return certificate
        points = np.vstack([points, beyond])
        if np.isnan(points).any():
            break
    reason = (
        f"not proved: one V serves the Jacobians at {len(errors.A)} points, "
        "but not surely on all of the region"
    )
    return certificate._replace(certified=False, reason=reason)


def _start_points(box: Box) -> Floats:
    """Return the centre of a box, then its corners, drawn at random if many (K x (n + m))."""
    size = box.low.size
    if 2**size <= CORNERS:
        corners = np.array(list(itertools.product((0.0, 1.0), repeat=size)))
    else:
        corners = np.random.default_rng(0).integers(2, size=(CORNERS, size)).astype(float)
    return np.vstack([(box.low + box.high) / 2, box.low + corners * (box.high - box.low)])


def _first_of_equal_matrices(A: Floats) -> Floats:
    """Return the index of the first of each set of equal matrices, ascending."""
    scale = max(float(np.abs(A).max()), 1e-300)
    rounded = np.round(A / scale, 12).reshape(len(A), -1)
    _, first = np.unique(rounded, axis=0, return_index=True)
    return np.sort(first)


def _failure_reason(certificate: Certificate, points: Floats, n: int) -> str:
    """Describe the failure, with the point of the box that causes it, if a single point does.

    The centre, which comes first, is named before the worst.
    """
    errors = certificate.dynamics
    own = [certify_dynamics(errors._replace(A=(A,))) for A in errors.A]
    failing = [k for k, one in enumerate(own) if not one.certified]
    if not failing:
        least = certificate.margin
        margin = f" (largest margin found {least:.4g})" if np.isfinite(least) else ""
        return (
            f"each Jacobian on the region has a V, but they share none{margin}: "
            "more damping or a smaller region would help"
        )
    k = failing[0]
    if k != 0:
        k = min(failing, key=lambda k: own[k].margin)
    singular = np.linalg.svd(errors.A[k], compute_uv=False)
    cure = CURE if singular[-1] < 1e-9 * singular[0] else ""
    return f"at {_format_point(points[k], n)} {own[k].reason}{cure}"


def _format_point(point: Floats, n: int) -> str:
    """Format a point [x, u] as text."""
    x = _format_four_digits(point[:n])
    u = _format_four_digits(point[n:])
    return f"x = [{x}], u = [{u}]"


def _format_four_digits(values: Floats) -> str:
    """Format numbers with four digits, without the sign of a zero."""
    return ", ".join(f"{value:.4g}" for value in values + 0.0)


class InequalityForm(NamedTuple):
    """Matrix -M of the certificate as a function of the K varying entries c of A.

    -M = identity - sum (c - mean)_k slope_k, in coordinates (N of them) that make it so.

    Attributes:
        mean: of c at the vertices (K).
        identity: the identity, as rounded (N x N).
        slope: of each entry (K x N x N).
        size: |slope_k|, no less than +-slope_k (K x N x N).
        rounding: of the identity, and of each slope per unit of c (K).
    """

    mean: Floats
    identity: Floats
    slope: Floats
    size: Floats
    rounding: tuple[float, Floats]

    def certificate_depth(self, c: Floats) -> Floats:
        """Return the least eigenvalue of -M minus rounding for every c (rows), or -inf if
        unbounded.
        """
        return self.depth_within(c, np.zeros_like(c), np.zeros((len(c), 0, self.mean.size)))

    def depth_within(self, c: Floats, loose: Floats, turns: Floats) -> Floats:
        """Return the least `certificate_depth` within +-loose and turns of c (rows).

        Args:
            c: the middle (rows x K).
            loose: by how much each entry may be off, alone (rows x K).
            turns: by how much all entries may be off together, in each direction (rows x D x K).
        """
        c = c - self.mean
        total = np.abs(c) + loose + np.abs(turns).sum(axis=1)  # magnitude of each entry at most
        bounded = np.isfinite(total).all(axis=1)
        together = absolute_matrix(np.tensordot(turns[bounded], self.slope, 1)).sum(axis=1)
        M = self.identity - np.tensordot(c[bounded], self.slope, 1)
        M = M - np.tensordot(loose[bounded], self.size, 1) - together
        of_identity, of_slopes = self.rounding
        least = np.full(len(c), -np.inf)
        least[bounded] = np.linalg.eigvalsh(M)[:, 0] - of_identity - total[bounded] @ of_slopes
        return least


def absolute_matrix(M: Floats) -> Floats:
    """Return (M^2)^(1/2) of symmetric matrices, no less than +-M."""
    values, vectors = np.linalg.eigh((M + M.swapaxes(-1, -2)) / 2)
    return (vectors * np.abs(values)[..., None, :]) @ vectors.swapaxes(-1, -2)


def build_inequality_form(
    certificate: Certificate, entries: tuple[Integers, Integers]
) -> InequalityForm:
    """Return the certificate's M as a function of some entries of A.

    Args:
        certificate: with V that is proved at the vertices.
        entries: rows and columns of these entries (K each).
    """
    errors = certificate.dynamics
    P = certificate.P
    mean = np.mean(errors.A, axis=0)
    inequality = errors.inequality(certificate.W)._replace(A=(mean,))
    (M,) = inequality.lmi_matrices(P)
    (size,) = inequality.term_magnitudes(P)
    T = np.linalg.inv(np.linalg.cholesky(-M)).T  # T'(-M) T = I
    slopes = _entry_slopes(P, len(M), errors.Ts, entries)
    slope = T.T @ slopes @ T
    unit = 8 * (len(M) + len(slopes) + 4) * np.finfo(float).eps
    around = [np.linalg.norm(np.abs(T.T) @ np.abs(part) @ np.abs(T)) for part in (size, *slopes)]
    rounding = unit * (around[0] + len(M)), unit * np.array(around[1:])
    return InequalityForm(mean[entries], -T.T @ M @ T, slope, absolute_matrix(slope), rounding)


def _entry_slopes(
    P: Floats, N: int, Ts: float | None, entries: tuple[Integers, Integers]
) -> Floats:
    """Return the derivatives dM/dA_ij (K x N x N) of the inequality's matrix.

    M has PA + A'P in its first n rows. In sampled time sqrt(Ts) PA stands in its last n columns as
    well: the Schur complement of Ts A'PA.

    Args:
        P: storage (n x n).
        N: rows of M.
        Ts: sample time [s] (None: continuous).
        entries: rows i and columns j of A (K each).
    """
    n = len(P)
    slopes = np.zeros((entries[0].size, N, N))
    places = ((0, 1.0), (N - n, np.sqrt(Ts or 0.0)))
    for slope, i, j in zip(slopes, *entries, strict=True):
        for start, share in places:
            slope[j, start : start + n] += share * P[i]
            slope[start : start + n, j] += share * P[i]
    return slopes


def _entry_bounds(
    bounds: Bounds, bends: Bounds, low: Floats, centre: Floats, high: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return bounds on the entries c of A on parts of the box.

    By the bounds at their centres and on the derivatives.

    Returns:
        c at the centres and half width of the bounds there (parts x K). c changes by +-turns
        towards each side, and half width of the bounds on turns (parts x (n + m) x K).
    """
    reach = np.nextafter(np.maximum(high - centre, centre - low), np.inf)[:, :, None]
    middle, loose = _middle_and_half_width(bounds(Box(centre, centre)))
    turns, doubt = _middle_and_half_width(bends(Box(low, high)))
    return middle[:, 0], loose[:, 0], turns * reach, doubt * reach


def find_missed_points(
    certificate: Certificate, slopes: ModelJacobian, box: Box, parts: int
) -> Floats:
    """Return points of a box whose Jacobians the certificate's V misses or nearly misses.

    Args:
        certificate: with V that is proved at its vertices.
        slopes: the model's Jacobian and its bounds.
        box: of [x, u] (n + m).
        parts: of the box that are looked at, at most.

    Returns:
        Points (K x (n + m)) (none if V is proved on the box, NaN if that is open).
    """
    bounds, bends = slopes.bounds()
    if not slopes.entries[0].size:
        return np.zeros((0, box.low.size))
    of_A = build_inequality_form(certificate, slopes.entries)
    vertices = np.array(certificate.dynamics.A)[:, *slopes.entries]
    enough = float(of_A.certificate_depth(vertices).min()) / 2
    weight = np.linalg.norm(of_A.slope, axis=(1, 2))
    low = box.low[None]
    high = box.high[None]
    while low.size and parts > 0:
        later_low = low[:-AT_ONCE]
        later_high = high[:-AT_ONCE]
        low = low[-AT_ONCE:]
        high = high[-AT_ONCE:]
        parts -= len(low)
        centre = (low + high) / 2
        c, loose, turns, doubt = _entry_bounds(bounds, bends, low, centre, high)
        open_ = ~(of_A.depth_within(c, loose + doubt.sum(axis=1), turns) > 0)
        low = low[open_]
        high = high[open_]
        centre = centre[open_]
        depth = of_A.certificate_depth(c[open_])
        short = depth < enough
        if short.any():
            return centre[short][np.argsort(depth[short])[:WORST]]
        effect = (np.abs(turns) + doubt)[open_] @ weight
        low, high = halve_boxes(low, centre, high, effect, box)
        low = np.vstack([later_low, low])
        high = np.vstack([later_high, high])
    return np.full((int(low.size > 0), box.low.size), np.nan)


def halve_boxes(
    low: Floats, centre: Floats, high: Floats, effect: Floats, box: Box
) -> tuple[Floats, Floats]:
    """Return (low, high) of both halves of each part, cut across the side of most effect on M.

    If an effect has no bound, the side that is longest relative to the box is cut.
    """
    bounded = np.isfinite(effect).all(axis=1, keepdims=True)
    share = np.where(bounded, effect, (high - low) / (box.high - box.low))
    k = np.arange(len(low))
    split = np.argmax(share, axis=1)
    # upper ends of the lower halves, lower of the upper
    below = high.copy()
    above = low.copy()
    below[k, split] = above[k, split] = centre[k, split]
    return np.vstack([low, above]), np.vstack([below, high])


def _middle_and_half_width(bound: Interval) -> tuple[Floats, Floats]:
    """Return (middle, half width) of bounds, not finite if unbounded."""
    with np.errstate(invalid="ignore"):
        middle = (bound.low + bound.high) / 2
        return middle, np.nextafter(np.maximum(bound.high - middle, middle - bound.low), np.inf)


class ModelJacobian(NamedTuple):
    """Jacobian A = df/dx (delta form if sampled) of a model with n states, m inputs, with
    bounds.

    Attributes:
        at: points [x, u] (N x (n + m)) -> A there (N x n x n).
        entries: rows and columns of the entries of A that vary (K each).
        bounds: makes two functions of boxes (N rows), which takes time: the first bounds these
            entries (N x 1 x K), the second their derivatives (N x (n + m) x K).
    """

    at: Callable[[Floats], Floats]
    entries: tuple[Integers, Integers]
    bounds: Callable[[], tuple[Bounds, Bounds]]


def jacobian_on_box(model: System, box: Box) -> ModelJacobian:
    """Return the Jacobian of a model, with bounds on parts of a box.

    Args:
        model: the model, its outputs affine in the state.
        box: of [x, u] (n + m).

    Raises:
        InputError: if the output bends (the bounds raise it if the model is not smooth).
    """
    n = model.n
    p, params = tree.create_symbols(model.params, "p")
    w = ca.SX.sym("w", n + model.m)  # [x, u]
    moved = model.move(params, w[:n], w[n:])
    z = model.output(params, w[:n])
    if any(ca.which_depends(z, w, 2, True)):
        raise InputError("region: a certificate needs outputs that are affine in the state")
    A = ca.densify(ca.jacobian(moved, w)[:, :n])
    A = A if model.Ts is None else (A - np.eye(n)) / model.Ts
    varying = np.flatnonzero(ca.which_depends(ca.vec(A), w, 1, True))
    columns, rows = np.divmod(varying, n)
    numbers = tree.pack_tree(model.params)[:, None]

    def slopes_function(*values: ca.SX) -> ca.Function:
        """Return a CasADi function of (p, [x, u])."""
        return ca.Function("slopes", [p, w], list(values), {"cse": True})

    everything = slopes_function(moved, A)

    def jacobian_at_points(points: Floats) -> Floats:
        """Return the Jacobian at points [x, u] (N x n x n)."""
        repeated = np.broadcast_to(numbers, (numbers.size, len(points)))
        side_by_side = everything(repeated, points.T)[1].full()
        return side_by_side.reshape(n, len(points), n).transpose(1, 0, 2)

    @functools.cache
    def bounds() -> tuple[Bounds, Bounds]:
        """Return functions that bound the varying entries and their derivatives over
        boxes.
        """
        some = ca.vec(A)[varying.tolist()]
        whole = [Interval(numbers, numbers), Interval(box.low[:, None], box.high[:, None])]
        try:
            build_enclosure(everything)(whole)  # raises if the model is not smooth
            bends = ca.densify(ca.jacobian(some, w))
            return _bounds_over_boxes(slopes_function(some), numbers), _bounds_over_boxes(
                slopes_function(bends), numbers
            )
        except InputError as error:
            raise InputError(f"region: the model cannot be certified on it: {error}") from None

    return ModelJacobian(jacobian_at_points, (rows, columns), bounds)


def _bounds_over_boxes(function: ca.Function, numbers: Floats) -> Bounds:
    """Return bounds on a function of (p, [x, u]) over boxes of [x, u], a box per row.

    numbers: values of p, as a column. A value (r x c) comes back as (c x r) for each box.
    """
    bound = build_enclosure(function)
    shape = (-1, *function.size_out(0)[::-1])

    def bounds(part: Box) -> Interval:
        """Return the interval of the function over each box."""
        (value,) = bound([Interval(numbers, numbers), Interval(part.low.T, part.high.T)])
        return Interval(value.low.T.reshape(shape), value.high.T.reshape(shape))

    return bounds
