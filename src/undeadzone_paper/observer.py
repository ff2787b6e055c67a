"""Observer of the paper as printed, (16)-(17), (25), with minimal repairs of its shapes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from undeadzone.errors import InputError
from undeadzone.interfaces import Estimate, Observer, Reading, Traits, build_estimate
from undeadzone.linalg.riccati import paper_riccati, require_weight
from undeadzone.nonlinearities.sensor import Zone, indicators, saturation
from undeadzone.observers.adaptive.adaptation_laws import to_width_pairs
from undeadzone.observers.adaptive.gain import innovation_gain
from undeadzone.plants.system import System
from undeadzone.registry import Options
from undeadzone.util.arrays import Array, Floats, require_number


class Printed(Options, frozen=True, kw_only=True, tag="printed"):
    """As printed: x^' = A x^ + L (y - y^), y^ = C x^ - Sat(C x^), d^' = -sigma y~ (C P L) chi.

    P is that of (34) with A - L C.

    Attributes:
        L: gains (n).
        sigma: adaptation gain.
        alpha, Q: of (34).
        sharpness: k_s of (8).
        widths0: d^(0) = right, left [z] (A2 sets it to the truth).
        feed_input: add the B u that (16) lacks.
        left_sign: -1 as printed, +1 with a signed d_l.
    """

    L: Array
    sigma: float = 1.0
    alpha: float = 10.0
    Q: Array = 1.0
    sharpness: float = 100.0
    widths0: Array = 0.0
    feed_input: bool = False
    left_sign: float = -1.0

    def build(self, model: System, sensor: Zone) -> Observer:
        """Build the observer for a continuous-time linear model of one output."""
        if model.Ts is not None or model.nonlinear or model.p != 1:
            raise InputError(
                "observer.method: 'printed' is defined for a linear plant of one output in "
                "continuous time (simulation.time)"
            )
        params = self._observer_numbers(model)

        def init(p: PrintedParams) -> PrintedState:
            """Return the state at t = 0."""
            return PrintedState(np.zeros(model.n), p.right0, p.left0)

        def step(
            p: PrintedParams, s: PrintedState, u: Any, reading: Reading
        ) -> tuple[PrintedState, Estimate]:
            """Return the state's derivative and the estimate."""
            z = model.output(p.model, s.x)
            y_hat = z - saturation(z, s.right, s.left)
            e = reading.y - y_hat
            chi_r, chi_l = indicators(reading.y, p.sharpness)
            rate = -p.sigma * e * p.cpl
            x = model.move(p.model, s.x, p.feed_input * u) + p.L @ e
            change = PrintedState(x, rate * chi_r, p.left_sign * -rate * chi_l)
            return change, build_estimate(
                s.x, z, s.right, s.left, reading, sensor.slope, sensor.kind, e
            )

        return Observer(params, init, step, traits=Traits(L=params.L))

    def _observer_numbers(self, model: System) -> PrintedParams:
        """Return the observer's numbers. Raises InputError, ShapeError, StructureError."""
        L, _, P, right, left = printed_gains(self, model, "observer", "widths0")
        return PrintedParams(
            model=model.params,
            L=L,
            cpl=model.linear.C @ P @ L,
            feed_input=np.float64(self.feed_input),
            right0=right,
            left0=left,
            **read_numbers(self, "observer", "sigma", "sharpness", "left_sign"),
        )


def printed_gains(options: Any, model: System, table: str, widths: str) -> tuple[Any, ...]:
    """Return L (n x 1), alpha, P of (34) with A - L C, and widths right (1), left (1).

    Args:
        options: of the observer or the law as printed, with L, alpha and Q
        model: the model
        table: of the options in a scenario, named in errors
        widths: the option that has the widths

    Raises:
        InputError, ShapeError, StructureError: options that the model cannot take
    """
    A, B, C = model.linear
    L = innovation_gain(options.L, model, f"{table}.L")
    alpha = require_number(f"{table}.alpha", options.alpha, above=0.0)
    Q = require_weight(f"{table}.Q", options.Q, model.n)
    given = getattr(options, widths)
    pairs = to_width_pairs(f"{table}.{widths}", 0.0 if given is None else given, 1)
    return L, alpha, paper_riccati(A - L @ C, B, alpha, Q).P, *pairs.T


def read_numbers(options: Any, table: str, *names: str) -> dict[str, Any]:
    """Return the options of these names, one number each. Raises InputError, ShapeError.

    Args:
        options: of the observer or the law as printed
        table: of the options in a scenario, named in errors
        names: of the options
    """
    return {
        name: np.float64(require_number(f"{table}.{name}", getattr(options, name)))
        for name in names
    }


class PrintedParams(NamedTuple):
    """Numbers of the observer: cpl = C P L, the rest as in `Printed`."""

    model: Any
    L: Floats
    sigma: Any
    cpl: Floats
    sharpness: Any
    feed_input: Any
    left_sign: Any
    right0: Floats
    left0: Floats


class PrintedState(NamedTuple):
    """State x^ and the widths d_r^, d_l^."""

    x: Any
    right: Any
    left: Any
