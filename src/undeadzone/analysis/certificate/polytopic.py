"""The certificate of a nonlinear model on a box of states and inputs: one V for all its Jacobians.

Proofs are in docs/certificate.md. By the mean value theorem the error obeys x~' = A(t) x~ - L e,
A(t) in the convex hull of df/dx over the box, as long as x, x^ and u stay in it. V is sought at
some of these Jacobians, the vertices, and then proved for all: interval arithmetic bounds df/dx on
parts of the box, which are halved until the bound suffices or a Jacobian is found that V misses
(`subdivision`).
"""

from __future__ import annotations

import itertools

import numpy as np

from undeadzone.analysis.certificate.jacobian_bounds import Slopes, slopes_on
from undeadzone.analysis.certificate.passivity import Certificate, certify_dynamics
from undeadzone.analysis.certificate.subdivision import missed
from undeadzone.analysis.error_dynamics import Dynamics, adaptation
from undeadzone.errors import InputError, StructureError
from undeadzone.numerics.semidefinite import minimise, symmetric
from undeadzone.plants.region import Box
from undeadzone.plants.system import System
from undeadzone.support.arrays import Floats

PARTS = 200_000  # of the box that are looked at before a proof is given up
ROUNDS = 12  # searches for V, each with Jacobians that the last V missed
CORNERS = 16  # of the box that the first search takes
CURE = (
    "; the Jacobian there is singular: width identifiable, centre not: "
    "add a spring, gravity, an absolute reference pulse, or a known start"
)


def certify_on(
    model: System, L: Floats, gamma: Floats, box: Box, parts: int = PARTS
) -> Certificate:
    """Whether gains are certified while x, x^ and u stay in a box; of a sampled model too.

    Args:
        model: the model (n states, m inputs, p outputs).
        L: observer gains (n x p) [1/s].
        gamma: adaptation gains (p) [1/s].
        box: of [x, u] (n + m).
        parts: of the box that are looked at before the proof is given up.

    Returns:
        A certificate whose dynamics hold the vertices, and whose margin is that at them. A 'no'
        names the point of the box where there is no V, or says that the proof was given up.

    Raises:
        InputError: for a model that is not smooth on the box.
    """
    return _certified(model, L, gamma, box, slopes_on(model, box), parts)


def design_on(model: System, gamma: Floats, box: Box) -> Certificate:
    """Certified gains for a box: L = P^-1 C' with A'P + PA <= -2 w I for every Jacobian A.

    w is the largest of their sizes. For a linear model `passivity.passive_gain`.

    Args:
        model: the model, in continuous time.
        gamma: adaptation gains (p) [1/s].
        box: of [x, u] (n + m).

    Raises:
        InputError: for a sampled model.
        StructureError: where no V exists.
    """
    if model.Ts is not None:
        raise InputError(
            "design_on: takes a model in continuous time; "
            "`certify_on` then judges its gains in sampled time"
        )
    slopes = slopes_on(model, box)
    no_gain = _certified(model, np.zeros((model.n, model.p)), gamma, box, slopes, PARTS)
    if not no_gain.certified:
        raise StructureError(f"no gains can be certified on the region: {no_gain.reason}")
    P = _common_storage(no_gain.dynamics.A)
    if P is None:
        raise StructureError(
            "no gains were found on the region: the Jacobians are too far apart for the solver"
        )
    L = np.linalg.solve(P, model.linear.C.T)
    return _certified(model, L, gamma, box, slopes, PARTS)


def _common_storage(vertices: tuple[Floats, ...]) -> Floats | None:
    """P (n x n) of least trace with A'P + PA <= -2 w I at every vertex; None if none is found."""
    n = len(vertices[0])
    q = 2 * max(float(np.linalg.norm(A, 2)) for A in vertices)

    def blocks(x: Floats) -> list[Floats]:
        P = symmetric(x, n)
        return [P, *(-A.T @ P - P @ A - q * np.eye(n) for A in vertices)]

    trace = np.eye(n)[np.triu_indices(n)]
    entries = minimise(trace, blocks)
    return None if entries is None else symmetric(entries, n)


def _certified(
    model: System, L: Floats, gamma: Floats, box: Box, slopes: Slopes, parts: int
) -> Certificate:
    """`certify_on` with the model's Jacobian: vertices are added until V misses none."""
    points = _start(box)
    for _ in range(ROUNDS):
        points = points[_different(slopes.at(points))]
        vertices = tuple(slopes.at(points))
        errors = Dynamics(vertices, model.linear.C, L, adaptation(gamma, model.p), model.Ts)
        certificate = certify_dynamics(errors)
        if not certificate.certified:
            return certificate._replace(reason=_why(certificate, points, model.n))
        beyond = missed(certificate, slopes, box, parts)
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


def _start(box: Box) -> Floats:
    """The centre of a box, then corners of it, drawn if there are many."""
    size = box.low.size
    if 2**size <= CORNERS:
        corners = np.array(list(itertools.product((0.0, 1.0), repeat=size)))
    else:
        corners = np.random.default_rng(0).integers(2, size=(CORNERS, size)).astype(float)
    return np.vstack([(box.low + box.high) / 2, box.low + corners * (box.high - box.low)])


def _different(A: Floats) -> Floats:
    """The first of each set of equal matrices, as their numbers."""
    scale = max(float(np.abs(A).max()), 1e-300)
    rounded = np.round(A / scale, 12).reshape(len(A), -1)
    _, first = np.unique(rounded, axis=0, return_index=True)
    return np.sort(first)


def _why(certificate: Certificate, points: Floats, n: int) -> str:
    """The reason, with the point of the box that has it if one alone does.

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
    return f"at {_point(points[k], n)} {own[k].reason}{cure}"


def _point(point: Floats, n: int) -> str:
    """A point [x, u] in words."""
    x, u = _numbers(point[:n]), _numbers(point[n:])
    return f"x = [{x}], u = [{u}]"


def _numbers(values: Floats) -> str:
    """Numbers in four digits, without the sign of a zero."""
    return ", ".join(f"{value:.4g}" for value in values + 0.0)
