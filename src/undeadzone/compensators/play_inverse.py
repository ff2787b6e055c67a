"""Inverse of an actuator's play: the command leads by the gap on the side to which it pushes."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.interfaces import Compensator, Estimate, Reading
from undeadzone.nonlinearities.actuator import Belief, Drive, pass_command
from undeadzone.plants.system import System
from undeadzone.registry import Options
from undeadzone.util.arrays import Array, Floats, require_nonnegative

HOLD = 0.1  # of half the gap: change of v that is not worth a crossing, unless it is given


class Numbers(NamedTuple):
    """Parameters: the believed actuator, and the change of v that moves nothing (m) [u]."""

    drive: Drive
    hold: Floats


class State(NamedTuple):
    """Level of the play by the model (m), and the last command (m) [u]."""

    level: Any
    command: Any


class PlayInverse(Options, frozen=True, kw_only=True, tag="play_inverse"):
    """Inverse u = v + c_r to push right, v - c_l to push left, sampled time only.

    The input of the plant is known, as the gaps are. While v stays within `hold` of it, the command
    rests, since each turn crosses the whole gap at once.

    Attributes:
        hold: change of v that does not turn the command, one or one per input [u] (default a tenth
            of half the gap).
    """

    hold: Array | None = None

    def build(self, model: System, belief: Belief | None) -> Compensator:
        """Return the compensator for a model. Raises InputError unless the actuator has play."""
        if belief is None or not belief.drive.is_play or model.Ts is None:
            raise InputError(
                "compensator.method: 'play_inverse' needs [actuator] kind = \"play\" and sampled "
                "time. Use 'inverse' for a dead zone"
            )
        drive = belief.drive
        usual = HOLD * (drive.gap_right + drive.gap_left) / 2
        given = usual if self.hold is None else self.hold
        hold = require_nonnegative("compensator.hold", given, model.m, "one per input")
        rest = np.zeros(model.m)

        def step(
            q: Numbers, s: State, v: Any, estimate: Estimate, reading: Reading
        ) -> tuple[State, Any]:
            """Return the next state, and the command u (m)."""
            more = v > s.level + q.hold
            less = v < s.level - q.hold
            u = ca.if_else(more, v + q.drive.gap_right, s.command)
            u = ca.if_else(less, v - q.drive.gap_left, u)
            level, _ = pass_command(ca, u, s.level, q.drive, model.Ts)
            return State(level, u), u

        return Compensator(Numbers(drive, hold), lambda q: State(rest, rest), step)
