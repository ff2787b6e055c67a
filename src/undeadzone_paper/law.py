"""Control law (29) of the paper as printed, with minimal repairs of its shapes."""

from __future__ import annotations

from typing import Any, NamedTuple

from undeadzone.errors import InputError
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Controller, Estimate
from undeadzone.nonlinearities.sensor import indicators, saturation
from undeadzone.plants.system import System
from undeadzone.registry import Options
from undeadzone.util.arrays import Array, Floats
from undeadzone_paper.observer import printed_gains, read_numbers


class PrintedLaw(Options, frozen=True, kw_only=True, tag="printed"):
    """As printed: u = -alpha B'P y~ - alpha B'P L C chi (d - d^) + r(t), P of (34) with A - L C.

    It needs d - d^, which no reading gives.

    Attributes:
        L: observer gains (n) in (29) and (34).
        widths: d = right, left [z], as the proof of Theorem 4.1 knows it (default: chi (d - d^) is
            taken from (28) with x^ = x, which makes it -(y - y^)).
        alpha, Q: of (34).
        sharpness: k_s of (8).
        sign: 1 as printed, -1 for the sign of the left half of (42).
        left_sign: -1 as printed, +1 with a signed d_l.
    """

    L: Array
    widths: Array | None = None
    alpha: float = 10.0
    Q: Array = 1.0
    sharpness: float = 100.0
    sign: float = 1.0
    left_sign: float = -1.0

    def build(self, model: System) -> Controller:
        """Build the controller for a continuous linear model with a single input and output."""
        if model.Ts is not None or model.nonlinear or (model.m, model.p) != (1, 1):
            raise InputError(
                "controller.method: 'printed' is defined for a linear plant of one input and one "
                "output in continuous time (simulation.time)"
            )
        given = self.widths is not None

        def step(p: LawParams, s: Any, estimate: Estimate, target: Target) -> tuple[Any, Any]:
            """Return the unchanged state, and u (1)."""
            e = estimate.innovation
            width_term = -e
            if given:
                chi_r, chi_l = indicators(_reading_of(estimate), p.sharpness)
                missing_r = p.right - estimate.right
                missing_l = p.left - estimate.left
                width_term = chi_r * missing_r - p.left_sign * chi_l * missing_l
            return s, -p.sign * (p.of_reading * e + p.of_widths * width_term) + target.r

        return Controller(self._law_numbers(model), lambda p: None, step)

    def _law_numbers(self, model: System) -> LawParams:
        """Return the law's numbers. Raises InputError, ShapeError, StructureError."""
        L, alpha, P, right, left = printed_gains(self, model, "controller", "widths")
        _, B, C = model.linear
        return LawParams(
            of_reading=alpha * (B.T @ P @ C.T)[0],
            of_widths=alpha * (B.T @ P @ L)[0],
            right=right,
            left=left,
            **read_numbers(self, "controller", "sharpness", "sign", "left_sign"),
        )


class LawParams(NamedTuple):
    """Numbers of the law.

    Attributes:
        of_reading, of_widths: alpha B'P C' and alpha B'P L (1).
        right, left: d as it is given (1) [z].
        sharpness, sign, left_sign: as in `PrintedLaw`.
    """

    of_reading: Floats
    of_widths: Floats
    right: Floats
    left: Floats
    sharpness: Any
    sign: Any
    left_sign: Any


def _reading_of(estimate: Estimate) -> Any:
    """Return y = y~ + y^, with y^ of (17) (1)."""
    z = estimate.z
    return estimate.innovation + z - saturation(z, estimate.right, estimate.left)
