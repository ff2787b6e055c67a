"""Extended Kalman filter on the measured side, for nonlinear models of several outputs, robot arms among them (docs/methods/extended.md)."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import casadi as ca
import msgspec
import numpy as np

from undeadzone.errors import InputError
from undeadzone.interfaces import Observer, Traits
from undeadzone.observers.parts.augmented_state import presumed
from undeadzone.observers.parts.measured_kalman import Augmentation, Params, measured_filter, prior
from undeadzone.observers.parts.unknown_inputs import (
    Colour,
    coloured,
    correlation_time,
    named,
    unknowns,
)
from undeadzone.plants.system import System
from undeadzone.sensor import Zone
from undeadzone.support.arrays import Array, Floats, nonnegative


class Extended(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="method",
    tag="extended",
):
    """Kalman filter on the measured side whose model is linearised at the estimate, sample by sample; sampled time.

    right, left, noise, x_std, drift: as for `Kalman`. start: mean of x(0), one or one per state; with a small x_std, what homing tells.
    disturbance: rms of an unknown input [u], one or one per input (default: what moves z by half of the largest width in a quarter period; 0 is
    a claim): first-order noise of that correlation_time [s] (default: a 16th of the plant's period; 1/4 s if it only integrates). uncertain:
    standard deviations of named parameters of the model, which become constant unknowns. silence: hear that a silent sensor bounds z, and that
    widths lie in their ranges. blind: take every reading for z, as if there were no dead zone. joints: separate keeps one covariance per
    joint of an arm [q; q'] whose positions are measured, to which the disturbance is an acceleration and all that a joint does not know of
    the others: much cheaper, and less is claimed.
    """

    right: Array
    left: Array | None = None
    noise: Array | None = None
    start: Array = 0.0
    x_std: Array | None = None
    disturbance: Array | None = None
    correlation_time: float | None = None
    drift: float = 0.0
    uncertain: dict[str, float] = {}
    silence: bool = True
    blind: bool = False
    joints: Literal["coupled", "separate"] = "coupled"

    def build(self, model: System, sensor: Zone) -> Observer:
        """The filter for a sampled model. Raises InputError, ShapeError."""
        if sensor.kind == "jump" and not (self.silence or self.blind):
            raise InputError(
                "observer.silence: readings of a jump sensor only bound its widths, so that without silence nothing tells of them"
            )
        believed = prior(
            model,
            sensor,
            self.right,
            self.left,
            self.noise,
            self.x_std,
            self.drift,
            start=self.start,
        )
        n, Ts, flow = model.n, model.Ts, model.flow
        assert Ts is not None
        assert flow is not None
        if self.blind:
            none = np.zeros(2 * model.p)
            believed = believed._replace(
                mean=np.append(believed.mean[:n], none),
                std=np.append(believed.std[:n], none),
                drift=none,
            )
        correlation = correlation_time(self.correlation_time, flow, Ts)
        if self.disturbance is None:
            rms = presumed(model, believed.ranges.max(), correlation)
        else:
            rms = nonnegative("observer.disturbance", self.disturbance, model.m, "one per input")
        colour = coloured(correlation, None, Ts)
        if self.joints == "separate":
            if self.uncertain:
                raise InputError(
                    'observer.uncertain: a parameter binds the joints together; use joints = "coupled"'
                )
            augmentation = separate(model, colour, rms)
        else:
            augmentation = unknowns(
                model, colour, rms, np.zeros(model.m), 0.0, named(model, self.uncertain)
            )
            augmentation = augmentation._replace(
                parameters=tuple(model.names.index(name) for name in self.uncertain)
            )
        bounds = self.silence and not self.blind
        observer = measured_filter(
            model,
            sensor,
            believed,
            augmentation,
            max(1.0, correlation / Ts),
            bounds,
            order=1,
            blind=self.blind,
        )
        traits = Traits(
            adapts=not self.blind,
            uncertain=tuple(self.uncertain),
            start_std=None if self.x_std is None else believed.std[:n],
        )
        return observer._replace(traits=traits)


class Noise(NamedTuple):
    """Of the joints' accelerations a+ = F a + noise of covariance Q variance (N)."""

    F: Any
    Q: Any
    variance: Floats


def separate(model: System, colour: Colour, rms: Floats) -> Augmentation:
    """An unknown acceleration a of each joint, and covariances of [q_i; q_i'; d_ri; d_li; a_i] alone.

    The mean moves by the whole model, whose accelerations are taken once a sample; variance: of the accelerations that the disturbance makes where the
    model was linearised. Raises InputError for a model that is not [q; q'] with q measured, and for a joint without disturbance.
    """
    N, Ts, rate, flow = model.p, model.Ts, model.rate, model.flow
    if rate is None or flow is None or Ts is None or not mechanical(model):
        raise InputError(
            "observer.joints: separate joints need a nonlinear model of states [q; q'] that measures each position, such as a rigid arm's"
        )
    variance = flow.B[N:] ** 2 @ rms**2
    if not variance.all():
        raise InputError(
            "observer.disturbance: must be positive for separate joints: it stands for what a joint does not know of the others"
        )

    def move(q: Params, x: Any, extra: Any, u: Any) -> tuple[Any, Any]:
        position, v = x[:N], x[N:]
        a = rate(q.model, x, u)[N:] + extra
        return ca.vertcat(position + Ts * v + Ts**2 / 2 * a, v + Ts * a), q.augmentation.F * extra

    def slope(q: Params) -> Any:
        one = ca.SX.eye(5)
        one[0, 1], one[0, 4], one[1, 4], one[4, 4] = Ts, Ts**2 / 2, Ts, q.augmentation.F
        return ca.kron(one, ca.SX.eye(N))

    def noise(q: Params, x: Any, u: Any) -> tuple[Any, Any]:
        return ca.SX(2 * N, 2 * N), q.augmentation.Q * ca.diag(q.augmentation.variance)

    return Augmentation(
        Noise(colour.F[0, 0], colour.Q[0, 0], variance), np.diag(variance), move, noise, slope=slope,
        disturbance=lambda q, extra: ca.vertcat(ca.SX.zeros(N), extra),
        entries=ca.triu(ca.kron(ca.DM.ones(5, 5), ca.DM.eye(N))).sparsity(),
    )  # fmt: skip


def mechanical(model: System) -> bool:
    """Whether the states are [q; q'] and the outputs q, less a constant perhaps."""
    N = model.p
    if model.n != 2 * N or model.flow is None:
        return False
    A, B, C = model.flow
    return bool(
        (np.eye(N, 2 * N) == C).all() and (np.eye(N, 2 * N, N) == A[:N]).all() and not B[:N].any()
    )
