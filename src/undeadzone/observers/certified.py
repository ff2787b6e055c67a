"""The repaired observer: the innovation is formed on the side that the sensor itself shows (docs/observer.md)."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import msgspec
import numpy as np

from undeadzone.errors import InputError
from undeadzone.interfaces import Estimate, Observer, Reading, Traits, estimate
from undeadzone.observers.parts.gain import gains
from undeadzone.observers.parts.width_laws import GRADIENT, Adaptation, Edge, Gradient, Law
from undeadzone.observers.parts.widths import bounded_widths
from undeadzone.plants.system import System
from undeadzone.sensor import Zone, offset, present
from undeadzone.support.arrays import Array, Floats, vector


class Certified(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="method",
    tag="certified",
):
    """Measured-side adaptive observer; replaces (16)-(25).

    L: gains (n x p) [1/s x state/output]; default P^-1 C', which is always certified for a stable plant. gamma: adaptation
    gain [1/s], one or one per output, default 1. design: a file saved by `Design.save`, in place of L and gamma; its proof
    is checked again for the model. start: x^(0), one number or one per state; widths0: initial d_r^, d_l^ (p x 2) [z]; width_max: d_M per side
    (default: none), the estimates are projected onto [0, d_M]. silence: use also that a silent sensor bounds z (certified too; its kink is not located,
    so that the integration error falls as h^2 only). adaptation: another law for the widths than the gradient; with one
    that is not constant no certificate is claimed. Gains are continuous-time ones in either time.
    """

    L: Array | None = None
    gamma: Array | None = None
    design: str | None = None
    start: Array = 0.0
    widths0: Array = 0.0
    width_max: Array | None = None
    silence: bool = False
    adaptation: Adaptation = Gradient()

    def build(self, model: System, sensor: Zone) -> Observer:
        """The observer for a model, continuous or sampled. Raises InputError, ShapeError; ProofError for a design that does not hold."""
        p = model.p
        given = (self.L, 1.0 if self.gamma is None else self.gamma)
        if self.design is not None:
            if self.L is not None or self.gamma is not None:
                raise InputError(
                    "observer.design: it brings L and gamma; give either the design or these"
                )
            given = _designed(self.design, model)
        gamma = vector("observer.gamma", given[1], p, "one per output")
        if (gamma < 0).any():
            raise InputError(f"observer.gamma: must not be negative, found {gamma.min():g}")
        widths, limit = bounded_widths(self.widths0, self.width_max, p)
        start = vector("observer.start", self.start, model.n, "one per state")
        return measured_side(
            model,
            sensor,
            gains(given[0], model),
            gamma,
            start,
            widths,
            limit,
            self.silence,
            self.adaptation.law(model.Ts),
        )


def _designed(path: str, model: System) -> tuple[Floats, Floats]:
    from undeadzone.analysis.certificate.design_file import Design

    found = Design.load(path)
    found.require_proof(model.linear, model.Ts, f"observer.design: {path}")
    return found.L, found.gamma


class Params(NamedTuple):
    """Numbers of the observer; L and gamma are per step when the model is sampled."""

    model: Any
    L: Floats
    gamma: Floats
    x0: Floats
    right0: Floats
    left0: Floats
    limit: Floats
    slope: Floats
    threshold: Floats
    law: Any


class State(NamedTuple):
    """x^, the widths d_r^, d_l^, and their gains where the adaptation law moves them."""

    x: Any
    right: Any
    left: Any
    right_gain: Any
    left_gain: Any


def measured_side(
    model: System,
    sensor: Zone,
    L: Floats,
    gamma: Floats,
    start: Floats,
    widths: Floats,
    limit: Floats,
    silence: bool,
    law: Law = GRADIENT,
) -> Observer:
    """The observer itself; with gamma = 0 and true widths it is the known-width oracle."""
    jump = sensor.kind == "jump"
    Ts = model.Ts
    per_step = 1.0 if Ts is None else Ts
    keep = 0.0 if Ts is None else 1.0
    params = Params(
        model.params,
        L * per_step,
        gamma * per_step,
        start,
        widths[:, 0],
        widths[:, 1],
        limit,
        sensor.slope,
        sensor.threshold,
        law.numbers,
    )

    def init(p: Params) -> State:
        gain = p.gamma if law.gains else np.zeros(0)
        return State(p.x0, p.right0, p.left0, gain, gain)

    def project(p: Params, s: State) -> State:
        widths = (ca.fmax(ca.fmin(width, p.limit), 0.0) for width in (s.right, s.left))
        return State(
            s.x, *widths, *(law.reset(p.law, gain, p.gamma) for gain in (s.right_gain, s.left_gain))
        )

    def step(p: Params, s: State, u: Any, reading: Reading) -> tuple[State, Estimate]:
        z, side, y = model.output(p.model, s.x), reading.side, reading.y / p.slope
        active = side != 0
        # A silent sensor says -d_l <= z <= d_r (wider by the threshold); beyond an edge, that edge or z^ is wrong.
        slack = p.threshold / p.slope
        silent = ca.if_else(ca.logic_and(side == 0, present(y)), float(silence), 0.0)
        over, under = (
            silent * ca.fmax(z - s.right - slack, 0.0),
            silent * ca.fmin(z + s.left + slack, 0.0),
        )
        if jump:
            e = ca.if_else(active, y - z, 0.0)
            push_right = ca.if_else(side > 0, ca.fmin(y - s.right, 0.0), over)
            push_left = ca.if_else(side < 0, ca.fmin(-y - s.left, 0.0), -under)
            told_right, told_left = push_right != 0, push_left != 0
        else:
            e = ca.if_else(active, y - (z - offset(side, s.right, s.left)), -over - under)
            told_right, told_left = (
                ca.logic_or(side > 0, over > 0),
                ca.logic_or(side < 0, under < 0),
            )
            push_right, push_left = ca.if_else(told_right, -e, 0.0), ca.if_else(told_left, e, 0.0)
        soft = law.soften(p.law, ca.if_else(active, y, 0.0))
        change_right, gain_right = law.move(
            p.law, Edge(soft * push_right, told_right, s.right, p.right0, s.right_gain, p.gamma)
        )
        change_left, gain_left = law.move(
            p.law, Edge(soft * push_left, told_left, s.left, p.left0, s.left_gain, p.gamma)
        )
        moved = model.move(p.model, s.x, u) + p.L @ (soft * e)
        after = State(
            moved, keep * s.right + change_right, keep * s.left + change_left, gain_right, gain_left
        )
        if Ts is not None:
            after = project(p, after)
        return after, estimate(s.x, z, s.right, s.left, reading, p.slope, sensor.kind, e)

    traits = Traits(
        L=params.L,
        gamma=params.gamma,
        constant=law.numbers is None,
        width_max=limit,
        adapts=bool(gamma.any()),
    )
    return Observer(params, init, step, project, traits)
