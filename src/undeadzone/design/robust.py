"""The certificate under disturbance, noise, leakage, an uncertain plant and known nonlinearities; proofs in docs/certificate.md.

Every function takes the error dynamics (`errordynamics.dynamics`, or `closed_loop` with a controller) and returns a
value that carries its P, W and the check of its own LMI by eigenvalues. All of them hold sampled too, for a plant
that is given in sampled form.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from undeadzone.arrays import Floats, vector
from undeadzone.design.dissipation import LEAST, Check, Inequality, check, optimise, quadratic
from undeadzone.design.errordynamics import Dynamics, adaptation, balance, delta, growth
from undeadzone.errors import InputError
from undeadzone.plant import Matrices

SLACK = 1e-3  # how far a minimised gain is raised so that its proof is strict


class Gain(NamedTuple):
    """int |z|^2 <= V(0) + disturbance^2 int |w|^2 + noise^2 int |v|^2 for every side sequence; inf where nothing is proved."""

    disturbance: float
    noise: float
    P: Floats
    W: Floats
    check: Check


def l2_gain(given: Dynamics, E: Floats | None = None, noise: Floats | None = None, output: Floats | None = None) -> Gain:
    """The paper's BIBO claim as numbers: the least sum of squared gains from w (x' = ... + E w, n x q) and v to z = output x~.

    noise: the size of the noise v_i on each active reading (p), None for none, so that v has unit size; E likewise.
    output (rows x n): C by default. Noise that wakes a silent sensor counts with its distance to the edge.
    """
    scaling = balance(given)
    scaled = scaling.dynamics(given)
    n, p, groups = *given.L.shape, given.groups
    E = np.zeros((n, 0)) if E is None else E * scaling.time / scaling.state[:, None]
    z = (given.C if output is None else output) * scaling.state
    v = np.zeros((p, 0)) if noise is None else np.diag(vector("noise", noise, p) / scaling.output)
    sizes = [max(float(np.linalg.norm(M)), 1e-300) if M.size else 1.0 for M in (E, z, v)]
    E, z, v = E / sizes[0], z / sizes[1], v / sizes[2]
    q, r = E.shape[1], v.shape[1]
    inputs = np.hstack([E, np.zeros((n, r))])

    def family(weights: Floats, mu: Floats) -> Inequality:
        W = groups @ weights
        through = np.hstack([np.zeros((p, q)), W[:, None] * v])
        terms = [(0, 0, z.T @ z), (1, 2, through), (2, 2, -np.diag(np.r_[np.full(q, mu[0]), np.full(r, mu[1])]))]
        return scaled.extended(W, inputs, terms)

    used = np.array([q > 0, r > 0])
    cost = np.r_[np.zeros(groups.shape[1]), used * np.array([sizes[0], sizes[2]]) ** 2]
    start = np.ones(cost.size)
    positive: Callable[[Floats, Floats], list[Floats]] = lambda P, q: [q - LEAST]
    least = optimise(lambda q: family(q[:-2], q[-2:]), cost / max(cost.max(), 1e-300), start, lambda P, q: [q - LEAST, 1e8 - q])
    if least is not None:
        mu = np.maximum(least.q[-2:], LEAST) * (1 + SLACK) + LEAST
        deep = optimise(
            lambda q: family(q, mu), np.zeros(groups.shape[1]), np.maximum(least.q[:-2], LEAST), positive, deep=True,
            done=lambda found: check(family(found.q, mu), found.P).proved, passes=4,
        )  # fmt: skip
        if deep is not None and (proof := check(family(deep.q, mu), deep.P)).proved:
            gains = np.sqrt(mu) * sizes[1] * used * np.array([sizes[0], sizes[2]])
            size = sizes[1] ** 2
            return Gain(float(gains[0]), float(gains[1]), size * scaling.storage(deep.P), size * scaling.weights(groups @ deep.q), proof)
    return Gain(np.inf, np.inf, np.eye(n), np.ones(p), Check(False, np.inf, -np.inf, 0.0))
