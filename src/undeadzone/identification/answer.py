"""The answer to a log, as values: the verdict, the widths, the plant, and all that was computed."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from undeadzone.identification.excitation import Excitation
from undeadzone.identification.fit import Fit
from undeadzone.identification.grid import Grid
from undeadzone.identification.intervals import Interval, Widths
from undeadzone.identification.jump_edges import JumpEdge
from undeadzone.identification.kalman_fit import KalmanFit
from undeadzone.identification.kalman_likelihood import NAMES
from undeadzone.identification.no_zone import NoZone
from undeadzone.identification.options import Options
from undeadzone.identification.orders import OrderFit
from undeadzone.identification.place import Place
from undeadzone.identification.residual_map import ResidualMap
from undeadzone.identification.static_rivals import Density
from undeadzone.support.arrays import Floats


class Evidence(NamedTuple):
    """All that was computed, in the scale of the fit (rms of y is 1).

    Attributes:
        grid: the log on its grid.
        orders: every order.
        chosen: the order that was chosen.
        kalman: fits of (L3), best first.
        no_zone: the test of a zone against none.
        residuals: residual by z^.
        rivals: static rivals.
        place: where the zone is; None where that was not asked.
        excitation: samples and visits a side.
        widths: widths with intervals.
        unreached: edges that no reading passes.
        jumps: edges of a jump sensor, scaled; None for a dead zone.
        delay: samples by which the input acts late.
    """

    grid: Grid
    orders: list[OrderFit]
    chosen: OrderFit
    kalman: list[KalmanFit]
    no_zone: NoZone
    residuals: ResidualMap
    rivals: dict[str, Density]
    place: Place | None
    excitation: Excitation
    widths: Widths
    unreached: tuple[str, ...]
    jumps: tuple[JumpEdge, JumpEdge] | None
    delay: int


class Disturbance(NamedTuple):
    """What disturbs z.

    Attributes:
        rms: of all of it [y].
        correlation_time: [s]; None where it is white.
        white: rms of its white part [y]; None where that was not told apart.
        model: which model of the disturbance fits best; None where none was fitted.
        ahead: whether it acts ahead of the zone.
    """

    rms: float
    correlation_time: float | None
    white: float | None
    model: str | None
    ahead: bool


class Answer(NamedTuple):
    """What a log says.

    Attributes:
        verdict: dead_zone, none, saturation, jump, play, friction, input_zone, other, unclear or
            unreached.
        reasons: why, in words.
        right, left, width, centre: (value, low, high) with 95 % intervals [y]; None where the
            verdict allows no such number.
        order: poles of the plant.
        poles: of the plant (n) [1/s], complex.
        gain: DC gain from each input (m) [y/u].
        remarks: what was done to the log, and what to be careful about.
        options: what the user said.
        evidence: all that was computed.
    """

    verdict: str
    reasons: list[str]
    right: Interval | None
    left: Interval | None
    width: Interval | None
    centre: Interval | None
    order: int
    poles: Any
    gain: Floats
    remarks: list[str]
    options: Options
    evidence: Evidence

    @property
    def zone(self) -> bool:
        """Whether the sensor has a dead zone."""
        return self.verdict in ("dead_zone", "unreached")

    @property
    def fit(self) -> Fit:
        """The fit that every sample enters: (L2), or that of noise behind the zone."""
        return self.evidence.chosen.pairs

    @property
    def scale(self) -> float:
        """rms of y, by which the fit is scaled [y]."""
        return self.fit.objective.data.y_scale

    @property
    def disturbance(self) -> Disturbance:
        """What disturbs z."""
        rho = self.fit.rho
        time = -self.evidence.grid.step / math.log(rho) if 0.05 < rho < 1 else None
        best = self.evidence.kalman[0] if self.evidence.kalman else None
        ahead = self.fit.objective.kind != "behind"
        if best is None:
            return Disturbance(self.fit.s * self.scale, time, None, None, ahead)
        white = best.r * self.scale
        return Disturbance(self.fit.s * self.scale, time, white, NAMES[best.model], ahead)
