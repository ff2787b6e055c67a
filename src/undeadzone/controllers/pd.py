"""The paper's PD law (42): u = -k_p (y - y^) - k_d (y' - y^') + r(t), the reference entering as a force."""

from __future__ import annotations

from typing import Any, NamedTuple

import msgspec
import numpy as np

from undeadzone.errors import InputError
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Controller, Estimate
from undeadzone.linear.riccati import paper_riccati, weight
from undeadzone.plants.system import System
from undeadzone.support.arrays import Array, Floats, scalar, vector


class PD(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="method",
    tag="pd",
):
    """(42) as printed: k_p, k_d given, or for a second-order plant alpha B'P of (34) with A - L C (needs L here).

    filter_time: time constant [s] of the filter that gives y' - y^'. It tracks nothing by itself: r is a force here.
    """

    k_p: Array | None = None
    k_d: Array | None = None
    alpha: float = 10.0
    Q: Array = 1.0
    L: Array | None = None
    filter_time: float = 0.01

    def build(self, model: System) -> Controller:
        """The controller for a model with as many inputs as outputs. Raises InputError, StructureError."""
        if model.m != model.p:
            raise InputError(
                f"controller.method: 'pd' needs as many inputs as outputs, the plant has {model.m} and {model.p}"
            )
        tau = scalar("controller.filter_time", self.filter_time, above=0.0)
        if self.k_p is None or self.k_d is None:
            K = self._riccati_gains(model)
        else:
            K = np.stack(
                [
                    vector(f"controller.{name}", getattr(self, name), model.p, "one per output")
                    for name in ("k_p", "k_d")
                ]
            )
        rate = 1.0 / tau if model.Ts is None else -np.expm1(-model.Ts / tau)
        keep = 0.0 if model.Ts is None else 1.0

        def step(p: Params, s: State, estimate: Estimate, target: Target) -> tuple[State, Any]:
            lag = estimate.innovation - s.filtered
            u = -p.k_p * estimate.innovation - p.k_d * lag / p.tau + target.r
            return State(keep * s.filtered + p.rate * lag), u

        return Controller(
            Params(K[0], K[1], np.float64(tau), np.float64(rate)),
            lambda p: State(np.zeros(model.p)),
            step,
            rate=1.0 / tau,
        )

    def _riccati_gains(self, model: System) -> Floats:
        A, B, C = model.linear
        if (model.n, model.m) != (2, 1) or model.Ts is not None:
            raise InputError(
                "controller: pd needs k_p and k_d, except for a continuous second-order plant, where (34) gives them"
            )
        L = np.zeros((2, 1)) if self.L is None else vector("controller.L", self.L, 2)[:, None]
        solution = paper_riccati(
            A - L @ C,
            B,
            scalar("controller.alpha", self.alpha, above=0.0),
            weight("controller.Q", self.Q, 2),
        )
        return solution.K.T


class Params(NamedTuple):
    """k_p, k_d (p), the filter's time constant [s] and its rate (per step when sampled)."""

    k_p: Floats
    k_d: Floats
    tau: Any
    rate: Any


class State(NamedTuple):
    """The filtered innovation (p)."""

    filtered: Any
