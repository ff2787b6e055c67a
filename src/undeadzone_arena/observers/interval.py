"""Interval observer: boxes that contain state and widths.

They hold whatever bounded noise and disturbance do.
"""

from __future__ import annotations

import numpy as np

from undeadzone.errors import InputError
from undeadzone.interfaces import Observer
from undeadzone.linalg.matrices import Matrices, state_response_sizes
from undeadzone.nonlinearities.sensor import Zone
from undeadzone.observers.filtering.prior import FLOOR, read_width_ranges
from undeadzone.plants.system import System, fastest_pole
from undeadzone.registry import Options
from undeadzone.util.arrays import Array, Floats, require_nonnegative, require_number
from undeadzone_arena.gain_defaults import injection_gain
from undeadzone_arena.observers.parts.boxes import FAR, Bounds, Boxes
from undeadzone_arena.observers.parts.interval_step import IntervalParams, build_interval_observer
from undeadzone_arena.observers.parts.modal_form import build_modes

NOISE = 6.0  # bound that is assumed of a Gaussian noise, in rms


class Interval(Options, frozen=True, kw_only=True, tag="interval"):
    """Gouze, Rapaport and Hadj-Sadok (2000), and Mazenc and Bernard (2011): guaranteed bounds.

    Their midpoints are the estimates. x_std, ... are half the intervals' widths / sqrt(3), the
    standard deviation of a uniform distribution. If assumed bounds contradict each other, the boxes
    are restarted.

    References:
        F. Mazenc, O. Bernard (2011), doi:10.1016/j.automatica.2010.10.019

    Attributes:
        right, left: assumed ranges [lo, hi] of d_r and d_l, one or one per output [z] (left
            defaults to that of right).
        noise: bound of the noise of a reading, one or one per output [y] (default six times the
            sensor's rms).
        noise_before: bound of the noise ahead of the sensor, one or one per output [z] (default six
            times the sensor's rms).
        disturbance: bound of the input disturbance, one or one per input [u].
        x_max: bound of |x(0)|, one or one per state (default five times the largest width).
        L: gain (n x p) [1/s] (default 0 for a stable plant).
        poles: poles of A - L C (n) [1/s], in place of L.
        speed: speed of A - L C [1/s], in place of L (default twice the fastest pole for a plant
            that is not stable).
        contraction: rate at which bounds follow a reading, in continuous time [1/s] (default ten
            times the fastest pole).
    """

    right: Array
    left: Array | None = None
    noise: Array | None = None
    noise_before: Array | None = None
    disturbance: Array = 0.0
    x_max: Array | None = None
    L: Array | None = None
    poles: Array | None = None
    speed: float | None = None
    contraction: float | None = None

    def build(self, model: System, sensor: Zone) -> Observer:
        """Build the observer for a linear model, continuous or sampled."""
        if model.nonlinear:
            raise InputError(
                "observer.method: 'interval' bounds linear plants only. Use 'censored' for a "
                "nonlinear one"
            )
        n = model.n
        p = model.p
        ranges = read_width_ranges(self.right, self.left, p)
        after, before = self._noise_bounds(sensor, p)
        disturbance = require_nonnegative(
            "observer.disturbance", self.disturbance, model.m, "one per input"
        )
        x_max = 5 * ranges.max() if self.x_max is None else self.x_max
        start = require_nonnegative("observer.x_max", x_max, n, "one per state")
        flow = model.continuous
        L = self._gain_or_zero(model, flow)
        form = build_modes(
            model.linear.A - L @ model.linear.C,
            1 / state_response_sizes(flow.A.T, flow.C.T),
            model.Ts,
        )
        rounding = FLOOR * np.ptp(ranges, axis=1).reshape(2, p).max(axis=0)
        noise = after / sensor.slope + before + rounding
        radius = np.abs(form.inverse) @ start
        params = IntervalParams(
            model=model.params,
            L=L,
            slope=sensor.slope,
            T=form.T,
            inverse=form.inverse,
            S=form.S,
            turn=form.turn,
            pace=np.float64(self._contraction_rate(model)),
            disturbance=disturbance,
            noise=noise,
            sure=np.where(after > sensor.threshold, after, -FAR),
            slack=np.maximum(after, sensor.threshold) / sensor.slope + noise,
            start=Boxes(np.zeros(n), radius, Bounds(*ranges[:p].T), Bounds(*ranges[p:].T)),
        )
        return build_interval_observer(model, form.pairs, params, sensor)

    def _noise_bounds(self, sensor: Zone, p: int) -> tuple[Floats, Floats]:
        """Return the bounds of the noise after (p) [y] and before the sensor (p) [z]."""
        after = NOISE * sensor.noise
        before = NOISE * sensor.noise_before
        if self.noise is not None:
            after = require_nonnegative("observer.noise", self.noise, p, "one per output")
        if self.noise_before is not None:
            before = require_nonnegative(
                "observer.noise_before", self.noise_before, p, "one per output"
            )
        return after, before

    def _gain_or_zero(self, model: System, flow: Matrices) -> Floats:
        """Return L (n x p), per step when sampled.

        It is 0 for a stable plant if no option is given.
        """
        stable = np.linalg.eigvals(flow.A).real.max() < -1e-9 * np.linalg.norm(flow.A, 2)
        if self.L is self.poles is self.speed is None and stable:
            return np.zeros((model.n, model.p))
        return injection_gain(model, self.L, self.poles, self.speed, 2.0)

    def _contraction_rate(self, model: System) -> float:
        """Return the rate at which bounds follow a reading [1/s], or 1 when sampled."""
        if model.Ts is not None:
            return 1.0
        if self.contraction is None:
            return 10 * fastest_pole(model)
        return require_number("observer.contraction", self.contraction, least=0.0)
