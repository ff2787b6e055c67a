"""Likelihood of plant and dead zone in all parameters, with scores and a Hessian."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np

from undeadzone.nonlinearities import sensor
from undeadzone.util.arrays import Flags, Floats, Integers
from undeadzone_identify.models import estimates, likelihood
from undeadzone_identify.models.plant import PlantSimulator, RecordData

Kind = Literal["ahead", "behind"]
FAR = 1e8  # outputs beyond this end a trial


class WidthLimits(NamedTuple):
    """Prior limits of the widths.

    Attributes:
        right, left: least and largest value [rms of y]; equal ones fix a width.
        zone: whether there is a zone; else minus d_r is a constant offset of y.
        tied: whether d_l = d_r, since the centre of the zone is not identifiable.
    """

    right: tuple[float, float] = (-np.inf, np.inf)
    left: tuple[float, float] = (-np.inf, np.inf)
    zone: bool = True
    tied: bool = False

    @property
    def free(self) -> list[bool]:
        """Return whether d_r, and d_l, is a free parameter."""
        is_left_fixed = self.tied or not self.zone or self.left[0] == self.left[1]
        return [self.right[0] != self.right[1], not is_left_fixed]

    def clip_widths(self, right: float, left: float) -> tuple[float, float]:
        """Clip widths to these limits."""
        right = min(max(right, self.right[0]), self.right[1])
        if self.tied:
            return right, right
        return right, min(max(left, self.left[0]), self.left[1])


class ZoneObjective:
    """Log likelihood of theta = [a, b, x0, d_r, d_l, log s].

    Args:
        simulator: linear plant with its data.
        kind: whether noise enters ahead of the zone (L1), or behind it.
        limits: prior limits of the widths.
        use: flags of the samples that count (N); default all readings.
    """

    gain = 1e-4
    longest = math.inf

    def __init__(
        self,
        simulator: PlantSimulator,
        kind: Kind,
        limits: WidthLimits | None = None,
        use: Flags | None = None,
    ) -> None:
        self.simulator = simulator
        self.layout = simulator.layout
        self.data: RecordData = simulator.data
        self.climbs = self.data.climbs
        self.kind = kind
        self.limits = limits or WidthLimits()
        self.readings = self.data.select_readings(use)
        rms = likelihood.root_mean_square(self.data.y[self.data.ok])
        self.x0_weight = 1 / (3 * rms + 1e-12) ** 2
        free = np.ones(self.layout.parameter_count, bool)
        free[self.layout.widths] = self.limits.free
        self.free: Integers = np.flatnonzero(free)

    def objective_along(self, data: RecordData) -> ZoneObjective:
        """Return the same likelihood for other records."""
        return ZoneObjective(self.simulator.simulator_along(data), self.kind, self.limits)

    def zone_noise(self, theta: Floats) -> likelihood.ZoneNoise:
        """Return widths and rms in theta."""
        right, left, log_s = theta[self.layout.right :]
        return likelihood.ZoneNoise(float(right), float(left), math.exp(min(log_s, 50.0)))

    def is_admissible(self, theta: Floats) -> bool:
        """Return whether the widths, the noise and the poles of theta are admissible."""
        right, left, log_s = theta[self.layout.right :]
        if (self.limits.zone and right + left < 0) or abs(log_s) > 30:
            return False
        return self.simulator.has_settling_poles(theta)

    def density_terms(self, theta: Floats, z: Floats) -> likelihood.DensityTerms:
        """Return log densities of the samples and their derivatives."""
        noise = self.zone_noise(theta)
        if self.kind == "behind":
            return likelihood.densities_behind(self.readings, z, noise, self.limits.zone)
        return likelihood.single_densities(self.readings, z, noise)

    @estimates.cache_latest
    def z_and_terms(self, theta: Floats) -> tuple[Floats, likelihood.DensityTerms]:
        """Return z (N) and the density terms of theta; the latest result is cached."""
        z = self.simulator.simulate_z(theta)
        return z, self.density_terms(theta, z)

    def total_log_likelihood(self, theta: Floats) -> float:
        """Return the log likelihood with the prior of x(0); -inf if theta is inadmissible."""
        if not (self.is_admissible(theta) and np.abs(self.simulator.simulate_z(theta)).max() < FAR):
            return -math.inf
        total = self.z_and_terms(theta)[1].value.sum() - self._initial_state_penalty(theta)
        return total if math.isfinite(total) else -math.inf

    def _initial_state_penalty(self, theta: Floats) -> float:
        """Return minus the log prior of x(0)."""
        x0 = theta[self.layout.x0]
        return 0.5 * self.x0_weight * float(x0 @ x0)

    def project_to_bounds(self, theta: Floats) -> Floats:
        """Restrict the widths of a trial to their limits."""
        widths = self.layout.widths
        theta[widths] = self.limits.clip_widths(*theta[widths])
        return theta

    def sample_scores(self, theta: Floats) -> tuple[Floats, Floats, Floats]:
        """Return log densities (N), scores (N x P) and dz/dtheta (N x P).

        Scores by constant parameters are 0.
        """
        z, terms = self.z_and_terms(theta)
        slope = self.simulator.z_gradient(theta, z)
        scores = terms.slopes[:, likelihood.Z : likelihood.Z + 1] * slope
        scores[:, self.layout.right :] += terms.slopes[:, likelihood.RIGHT :]
        scores[0, self.layout.x0] -= self.x0_weight * theta[self.layout.x0]
        if self.limits.tied:
            scores[:, self.layout.right] += scores[:, self.layout.right + 1]
        scores[:, np.delete(np.arange(self.layout.parameter_count), self.free)] = 0.0
        return terms.value, scores, slope

    def total_score(self, theta: Floats) -> Floats:
        """Return the derivative of the log likelihood by theta (P)."""
        return self.sample_scores(theta)[1].sum(axis=0)

    def quadratic_model(self, theta: Floats) -> tuple[float, Floats, Floats]:
        """Return log likelihood, score (F), and an approximate negative Hessian (F x F).

        The Hessian is that of Gauss and Newton for samples outside the zone, and the outer product
        of the scores for samples inside.
        """
        values, scores, slope = self.sample_scores(theta)
        rows, inside = self._gauss_newton_rows(theta, slope)
        hessian = rows.T @ rows
        log_s = self.layout.log_s
        inside_scores = scores[inside]
        by_inside = (inside_scores[:, log_s] ** 2).sum()
        inside_scores[:, log_s] = 0.0
        hessian += inside_scores.T @ inside_scores
        # The information of a Gaussian sample on log s is 2.
        outside_count = np.count_nonzero(self.readings.ok) - np.count_nonzero(inside)
        hessian[log_s, log_s] = 2 * outside_count + by_inside
        x0 = np.r_[self.layout.x0]
        hessian[x0, x0] += self.x0_weight
        value = values.sum() - self._initial_state_penalty(theta)
        free = self.free
        return value, scores.sum(axis=0)[free], hessian[np.ix_(free, free)]

    def _gauss_newton_rows(self, theta: Floats, slope: Floats) -> tuple[Floats, Flags]:
        """Return scaled derivatives of samples outside the zone (M x P), and flags inside (N).

        Args:
            theta: parameters (P).
            slope: dz/dtheta (N x P).
        """
        ok = self.readings.ok
        side = self.branch_sides(theta)
        outside = ok & (side != 0)
        change = slope.copy()
        right, left = change.T[self.layout.widths]
        right -= side > 0
        left += side < 0
        if self.limits.tied:
            right += left
        return change[outside] / self.zone_noise(theta).s, ok & ~outside & (self.kind != "behind")

    def branch_sides(self, theta: Floats) -> Integers | Floats:
        """Return +1, 0, -1 (N): of the readings, or of z if noise is behind the zone."""
        if self.kind != "behind":
            return self.readings.side
        z = self.z_and_terms(theta)[0]
        return sensor.zone(z, *self.zone_noise(theta)[:2]) if self.limits.zone else np.ones(z.size)

    @estimates.cache_latest
    def robust_covariance(self, theta: Floats) -> estimates.EstimateCovariance:
        """Return the robust covariance (I1) of the free parameters of theta; cached."""
        _, scores, _ = self.sample_scores(theta)
        return estimates.sandwich_covariance(scores[:, self.free], self.negative_hessian(theta))

    def negative_hessian(self, theta: Floats) -> Floats:
        """Return minus the Hessian of the log likelihood, made positive definite (F x F).

        It consists of central differences of the score over 0.01 standard deviations. The score is
        discontinuous at the edges if noise enters behind the zone. Then the Gauss-Newton matrix is
        returned.

        Args:
            theta: parameters (P).
        """
        _, _, approximate = self.quadratic_model(theta)
        approximate = approximate + 1e-12 * np.eye(self.free.size)
        if self.kind == "behind":
            return approximate
        steps = 1e-2 * (1 / np.sqrt(np.diag(approximate)))
        _, *points = estimates.perturb_each(theta, self.free, steps)
        if self.limits.tied:
            for point in points:
                point[self.layout.right + 1] = point[self.layout.right]
        rows = approximate.copy()
        pairs = zip(points[: steps.size], points[steps.size :], strict=True)
        for place, (upper, lower) in enumerate(pairs):
            if self.is_admissible(upper) and self.is_admissible(lower):
                difference = self.total_score(upper) - self.total_score(lower)
                rows[place] = -difference[self.free] / (2 * steps[place])
        return estimates.raise_eigenvalues(rows)

    def width_weights(self, right: float, left: float) -> Floats:
        """Return c (F) with c' theta_free = right d_r + left d_l, so (1, 1) for the width."""
        layout, tied = self.layout, self.limits.tied
        size = layout.parameter_count
        return estimates.weight_row(self.free, size, layout.right, (right, left), tied)

    def unexplained_readings(self, theta: Floats) -> Floats:
        """Return the residual (N): e outside the zone, y - Dz(z) for noise behind."""
        z = self.simulator.simulate_z(theta)
        noise = self.zone_noise(theta)
        if self.kind != "behind":
            return likelihood.zone_residual(self.readings, z, noise)
        return self.readings.y - likelihood.expected_reading(z, noise, self.limits.zone)
