"""Fit of plant and widths to a record, from several starts."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from undeadzone.util.arrays import Flags, Floats, rows_since_start
from undeadzone_identify.models.estimates import Maximum, best_maximum, maximise_likelihood
from undeadzone_identify.models.likelihood import dead_zone, unit_density
from undeadzone_identify.models.plant import (
    PlantSimulator,
    RecordData,
    busiest_stretches,
    longest_record_of,
    polynomial_roots,
    stabilise_poles,
)
from undeadzone_identify.models.zone import Kind, WidthLimits, ZoneObjective

SHARES = (0.15, 0.5, 1.2)  # start values of the widths [rms of y]
SLOWEST = (0.14, 0.05, 0.02, 0.007)  # start values of the slowest time constant [record length]


class ZoneFit(NamedTuple):
    """Fit of plant and zone to a record.

    Attributes:
        objective: the likelihood that was maximised.
        theta: parameters of its maximum (P).
        value: the log likelihood there.
    """

    objective: ZoneObjective
    theta: Floats
    value: float

    @property
    def z(self) -> Floats:
        """Return the output of the fitted plant (N), scaled."""
        return self.objective.simulator.simulate_z(self.theta)

    @property
    def right(self) -> float:
        """Return d_r, scaled."""
        return float(self.theta[self.objective.layout.right])

    @property
    def left(self) -> float:
        """Return d_l, scaled."""
        return float(self.theta[self.objective.layout.right + 1])

    @property
    def width(self) -> float:
        """Return d_r + d_l, scaled."""
        return self.right + self.left

    @property
    def disturbance_rms(self) -> float:
        """Return the rms of the disturbance of z, scaled."""
        return math.exp(float(self.theta[self.objective.layout.right + 2]))

    @property
    def rho(self) -> float:
        """Return the correlation of a disturbance ahead of the zone over a sample [1]; else 0."""
        return outside_correlation(self) if self.objective.kind == "ahead" else 0.0

    @property
    def bic(self) -> float:
        """Return the BIC, -2 L + p ln N.

        Samples ahead of a zone are taken as independent: p is the trace of J H^-1, which counts
        the parameters as the correlation of the scores does (Varin and Vidoni 2005).
        """
        numbers = float(self.objective.free.size)
        if self.objective.kind == "ahead" and math.isfinite(self.value):
            spread = self.objective.robust_covariance(self.theta)
            numbers = max(numbers, float(np.trace(spread.V @ np.linalg.pinv(spread.naive))))
        return -2 * self.value + numbers * math.log(int(self.objective.readings.ok.sum()))


def mean_reading(fit: ZoneFit) -> Floats:
    """Return E[y | z] (N), scaled: noise ahead of the zone makes its characteristic smooth."""
    z = fit.z
    right = fit.right
    left = fit.left
    s = fit.disturbance_rms
    if not fit.objective.limits.zone:
        return z - right
    if fit.objective.kind == "behind":
        return dead_zone(z, right, left)
    return s * (_mean_excess((z - right) / s) - _mean_excess((-left - z) / s))


def _mean_excess(x: Floats) -> Floats:
    """Return E max(x + e, 0) with e a unit Gaussian, for each x (N)."""
    return unit_density(x) + x * ndtr(x)


def fit_zone(simulator: PlantSimulator, limits: WidthLimits) -> ZoneFit:
    """Fit a plant and a zone, from several starts.

    Args:
        simulator: the plant of one order, with its data.
        limits: bounds of the widths.

    Returns:
        The fit of the largest maximum.
    """
    kind: Kind = "ahead" if simulator.data.silent_zeros else "behind"
    objective = ZoneObjective(simulator, kind, limits)
    starts = zone_starts(objective)
    clear_lead = 0.02 * objective.readings.ok.sum()
    maximum = best_maximum(objective, starts, 10, 120, clear_lead)
    if maximum is None:
        maximum = Maximum(objective.project_to_bounds(starts[0]), -math.inf)
    best = ZoneFit(objective, *maximum)
    return improve_fit(best, _centre_zone(objective, best.theta)) if limits.zone else best


def refit_likelihood(fit: ZoneFit, use: Flags | None = None, steps: int = 60) -> ZoneFit:
    """Fit again, or to other samples, starting at a fit.

    Args:
        fit: of the same plant.
        use: flags of the samples that count (N); None: all readings.
        steps: largest number of steps.
    """
    old = fit.objective
    objective = ZoneObjective(old.simulator, old.kind, old.limits, use)
    return ZoneFit(objective, *maximise_likelihood(objective, fit.theta, steps))


def improve_fit(fit: ZoneFit, theta: Floats) -> ZoneFit:
    """Return the better of a fit and of the one that starts from other parameters (P)."""
    maximum = maximise_likelihood(fit.objective, theta, 60)
    return ZoneFit(fit.objective, *maximum) if maximum.value > fit.value else fit


def remove_odd_poles(fit: ZoneFit, simulator: PlantSimulator) -> Floats:
    """Return the parameters of a fit reduced to the order of a simulator (P).

    The poles that are removed are the smallest real ones, then the smallest of all.
    """
    poles = polynomial_roots(fit.theta[fit.objective.layout.denominator]).astype(complex)
    order = np.lexsort((poles.real, np.abs(poles.imag) > 1e-9))
    kept = poles[order[poles.size - simulator.layout.denominator.stop :]]
    return nearest_numbers(fit, simulator, np.atleast_1d(np.real(np.poly(kept)))[1:])


def nearest_numbers(fit: ZoneFit, simulator: PlantSimulator, a: Floats) -> Floats:
    """Return parameters with new poles (P), with z as near as possible to that of a fit.

    Args:
        fit: the fit, of which zone and noise are kept.
        simulator: simulator of the result's order.
        a: denominator coefficients of the new poles.
    """
    layout = simulator.layout
    theta = np.zeros(layout.parameter_count)
    theta[layout.denominator] = a
    theta[layout.right :] = fit.theta[fit.objective.layout.right :]
    linear = slice(layout.numerators.start, layout.x0.stop)  # z is linear in b and x(0)
    columns = simulator.z_gradient(theta, fit.z)[:, linear]
    theta[linear] = np.linalg.lstsq(columns, fit.z, rcond=1e-10)[0]
    error = float(np.mean((columns @ theta[linear] - fit.z) ** 2))
    theta[layout.right + 2] = 0.5 * math.log(fit.disturbance_rms**2 + error)
    return theta


def fit_linear(simulator: PlantSimulator, use: Flags | None = None) -> ZoneFit:
    """Fit the output error without a zone, about a level: y = z - d_r."""
    level = (0.0, 0.0) if simulator.layout.integrators else (-math.inf, math.inf)
    objective = ZoneObjective(simulator, "behind", WidthLimits(right=level, zone=False), use)
    theta: Floats = np.zeros(objective.layout.parameter_count)
    a, b = fit_arx(simulator, objective.readings.ok)
    theta[objective.layout.denominator] = stabilise_poles(a)
    theta[objective.layout.numerators] = b
    if simulator.layout.integrators and a.size:
        theta = _start_with_slow_poles(objective, theta)
    above = simulator.simulate_z(theta) - simulator.data.y
    theta[objective.layout.right] = np.clip(above[objective.readings.ok].mean(), *level)
    theta[objective.layout.right + 2] = math.log(0.5)
    return ZoneFit(objective, *maximise_likelihood(objective, theta, 40))


def _start_with_slow_poles(objective: ZoneObjective, start: Floats) -> Floats:
    """Return the start of least squares (P), among a given one and some with slow poles.

    Noise hides the slow poles of an integrating plant in differences of its readings. For given
    poles the other parameters follow by linear least squares.

    Args:
        objective: likelihood of a linear plant.
        start: start from an ARX model of the differences (P).
    """
    simulator = objective.simulator
    layout = objective.layout
    use = objective.readings.ok
    y = simulator.data.y

    def residual_variance(theta: Floats) -> float:
        """Return the variance of the residuals of a plant."""
        return float(np.var((y - simulator.simulate_z(theta))[use]))

    best: Floats = start
    least = residual_variance(start)
    linear = slice(layout.numerators.start, layout.x0.stop)
    for share in SLOWEST:
        pole = math.exp(-1 / (share * simulator.longest))
        poles = pole ** (4.0 ** np.arange(layout.denominator.stop))
        theta = start.copy()
        theta[layout.denominator] = np.real(np.poly(poles))[1:]
        columns = simulator.z_gradient(theta, simulator.simulate_z(theta))[:, linear]
        theta[linear] = np.linalg.lstsq(columns[use], y[use], rcond=1e-10)[0]
        if simulator.has_settling_poles(theta) and residual_variance(theta) < least:
            best = theta
            least = residual_variance(theta)
    return best


def outside_correlation(fit: ZoneFit) -> float:
    """Return the correlation of e over a sample [1], from consecutive samples outside the zone.

    It is 0.05 if there are fewer than 10 of them.
    """
    readings = fit.objective.readings
    e = fit.objective.unexplained_readings(fit.theta)
    outside = readings.ok & (readings.side != 0)
    second = np.flatnonzero(outside & readings.before)
    second = second[outside[second - 1]]
    if second.size < 10:
        return 0.05
    rho = float(np.mean(e[second] * e[second - 1]) / np.mean(e[second] ** 2))
    return float(np.clip(rho, -0.9, 0.99)) or 0.05


def zone_starts(objective: ZoneObjective) -> list[Floats]:
    """Return start points (P each): a linear fit with several widths."""
    simulator = objective.simulator
    layout = objective.layout
    use = objective.readings.ok
    linear = fit_linear(simulator, use)
    starts = []
    halves = [*SHARES]
    if simulator.data.silent_zeros:
        inside_share = float(np.mean(objective.readings.side[use] == 0))
        halves.append(float(np.quantile(np.abs(linear.z), inside_share)))
    for share in halves:
        theta = linear.theta.copy()
        theta[layout.numerators] *= 1 + 0.9 * share
        theta[layout.right : layout.right + 2] = widths_about_level(linear, share)
        theta[layout.right + 2] = math.log(0.4)
        starts.append(theta)
    return starts


def widths_about_level(linear: ZoneFit, half: float) -> Floats:
    """Return d_r and d_l of a zone of a given half width about the level of a linear fit."""
    return half + linear.right * np.array([1.0, -1.0])


def fit_arx(simulator: PlantSimulator, use: Flags) -> tuple[Floats, Floats]:
    """Fit y_t on past y and u and a constant by least squares; for integrators, differences of y.

    Args:
        simulator: plant of the order, with the lagged inputs.
        use: flags of the samples that count (N).

    Returns:
        a (n), b (m n).
    """
    data = simulator.data
    layout = simulator.layout
    free = layout.denominator.stop
    y = data.y
    for _ in range(layout.integrators):
        y = y - np.roll(y, 1)
    past = [np.roll(y, i)[:, None] for i in range(1, free + 1)]
    usable = use & (rows_since_start(data.start, y.size) >= layout.n)
    for i in range(1, layout.n + 1):
        usable &= np.roll(use, i)
    matrix = np.hstack([*(-column for column in past), simulator.lagged, np.ones((y.size, 1))])
    solution = np.linalg.lstsq(matrix[usable], y[usable], rcond=1e-10)[0]
    return solution[:free], solution[free:-1]


def _centre_zone(objective: ZoneObjective, theta: Floats) -> Floats:
    """Return the parameters (P) with both widths equal to their mean, and x(0) = 0."""
    layout = objective.layout
    centred = theta.copy()
    centred[layout.right : layout.right + 2] = max(
        theta[layout.right : layout.right + 2].mean(), 1e-3
    )
    centred[layout.x0] = 0.0
    return centred


# --- Other records of the same plant


def refit_along(fit: ZoneFit, data: RecordData) -> ZoneFit:
    """Fit other records of the same plant, starting at a fit.

    Args:
        fit: fit of some records.
        data: the other records.
    """
    objective = fit.objective.objective_along(data)
    theta = objective.layout.at_rest(fit.objective.layout, fit.theta)
    return ZoneFit(objective, *maximise_likelihood(objective, theta, 60))


def refit_busiest_part(fit: ZoneFit) -> ZoneFit:
    """Fit the busiest part of a long log; a short log's fit is unchanged.

    Args:
        fit: of the log.
    """
    part = busiest_stretches(fit.objective.data)
    return fit if part is fit.objective.data else refit_along(fit, part)


def refit_longest_record(fit: ZoneFit) -> ZoneFit:
    """Fit the longest of several records, at most its busiest stretches.

    Args:
        fit: of one or several records.
    """
    record = longest_record_of(fit.objective.data)
    return fit if record is fit.objective.data else refit_along(fit, record)
