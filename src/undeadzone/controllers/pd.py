"""PD law (42) of the paper: u = -k_p (y - y^) - k_d (y' - y^') + r(t).

The reference enters as a force.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from undeadzone.controllers.parts import require_square
from undeadzone.errors import InputError
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Controller, Estimate
from undeadzone.linalg.riccati import paper_riccati, require_weight
from undeadzone.plants.system import System
from undeadzone.registry import Options
from undeadzone.util.arrays import Array, Floats, require_number, require_vector


class PD(Options, frozen=True, kw_only=True, tag="pd"):
    """PD law (42) as printed, with k_p and k_d, or alpha B'P of (34) for a second-order plant.

    (34) is taken with A - L C. The law tracks nothing by itself: r is a force here.

    Attributes:
        k_p, k_d: gains of the innovation and of its derivative, one or one per output.
        alpha, Q: of (34), where k_p and k_d are not given.
        L: observer gain in (34) (2) [1/s] (default 0).
        filter_time: time constant of the filter that gives y' - y^' [s].
    """

    k_p: Array | None = None
    k_d: Array | None = None
    alpha: float = 10.0
    Q: Array = 1.0
    L: Array | None = None
    filter_time: float = 0.01

    def build(self, model: System) -> Controller:
        """Return the controller for a model with as many inputs as outputs.

        Raises InputError.
        """
        require_square("pd", model)
        if model.delay:
            raise InputError(
                "controller.method: 'pd' feeds back the innovation, which nothing foretells over "
                "plant.delay. Use state_feedback"
            )
        tau = require_number("controller.filter_time", self.filter_time, above=0.0)
        k_p, k_d = self._pd_gains(model)

        def init(p: Params) -> State:
            """Return the state at t = 0: a filtered innovation of 0."""
            return State(np.zeros(model.p))

        def step(p: Params, s: State, estimate: Estimate, target: Target) -> tuple[State, Any]:
            """Return the filter's derivative, or its next value if sampled, and u (m)."""
            lag = estimate.innovation - s.filtered
            u = -p.k_p * estimate.innovation - p.k_d * lag / p.tau + target.r
            return State(model.keep * s.filtered + p.rate * lag), u

        params = Params(k_p, k_d, np.float64(tau), np.float64(model.filtering(tau)))
        return Controller(params, init, step, rate=1.0 / tau)

    def _pd_gains(self, model: System) -> tuple[Floats, Floats]:
        """Return (k_p, k_d) (p each) as given, or by (34).

        Raises InputError, StructureError.
        """
        if self.k_p is None or self.k_d is None:
            K = self._riccati_gains(model)
            return K[0], K[1]
        k_p = require_vector("controller.k_p", self.k_p, model.p, "one per output")
        k_d = require_vector("controller.k_d", self.k_d, model.p, "one per output")
        return k_p, k_d

    def _riccati_gains(self, model: System) -> Floats:
        """Return `[k_p; k_d]` (2 x 1), alpha B'P of (34). Raises InputError, StructureError."""
        A, B, C = model.linear
        if (model.n, model.m) != (2, 1) or model.Ts is not None:
            raise InputError(
                "controller: pd needs k_p and k_d, except for a continuous second-order plant, "
                "where (34) gives them"
            )
        L = (
            np.zeros((2, 1))
            if self.L is None
            else require_vector("controller.L", self.L, 2)[:, None]
        )
        alpha = require_number("controller.alpha", self.alpha, above=0.0)
        return paper_riccati(A - L @ C, B, alpha, require_weight("controller.Q", self.Q, 2)).K.T


class Params(NamedTuple):
    """Parameters of the controller.

    Attributes:
        k_p, k_d: gains (p).
        tau: time constant of the filter [s].
        rate: rate of the filter [1/s], per step when sampled.
    """

    k_p: Floats
    k_d: Floats
    tau: Any
    rate: Any


class State(NamedTuple):
    """Filtered innovation (p)."""

    filtered: Any
