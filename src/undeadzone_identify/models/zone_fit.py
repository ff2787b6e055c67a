"""Fit of plant and widths to a record, from several starts."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from undeadzone.util.arrays import Flags, Floats, Integers, rows_since_start
from undeadzone_identify.models.estimates import Maximum, best_maximum, maximise_likelihood
from undeadzone_identify.models.likelihood import (
    ZoneNoise,
    expected_reading,
    mean_beyond_edges,
)
from undeadzone_identify.models.plant import (
    PlantSimulator,
    RecordData,
    busiest_stretches,
    delay_by_each,
    longest_record_of,
    polynomial_roots,
    stabilise_poles,
)
from undeadzone_identify.models.zone import Kind, WidthLimits, ZoneObjective

SHARES = (0.15, 0.5, 1.2)  # start values of the widths [rms of y]
SLOWEST = (0.14, 0.05, 0.02, 0.007)  # start values of the slowest time constant [record length]
FEW = 3  # least number of runs on a side, per parameter, for the ARX model of a side


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
    def unexplained(self) -> Floats:
        """Return the readings that the plant does not explain (N), scaled."""
        return self.objective.unexplained_readings(self.theta)

    @property
    def zone_noise(self) -> ZoneNoise:
        """Return widths and rms of the disturbance, scaled."""
        return self.objective.zone_noise(self.theta)

    @property
    def right(self) -> float:
        """Return d_r, scaled."""
        return self.zone_noise.right

    @property
    def left(self) -> float:
        """Return d_l, scaled."""
        return self.zone_noise.left

    @property
    def width(self) -> float:
        """Return d_r + d_l, scaled."""
        return self.right + self.left

    @property
    def disturbance_rms(self) -> float:
        """Return the rms of the disturbance of z, scaled."""
        return self.zone_noise.s

    @property
    def rho(self) -> float:
        """Return the correlation of a disturbance ahead of the zone over a sample [1]; else 0."""
        return outside_correlation(self) if self.objective.kind == "ahead" else 0.0

    @property
    def bic(self) -> float:
        """Return the BIC, -2 L + p ln N.

        Samples ahead of a zone are taken as independent: p is the trace of J H^-1, which counts
        the parameters as the correlation of the scores does.

        References:
            C. Varin, P. Vidoni (2005), doi:10.1093/biomet/92.3.519
        """
        numbers: float = self.objective.free.size
        if self.objective.kind == "ahead" and math.isfinite(self.value):
            spread = self.objective.robust_covariance(self.theta)
            numbers = max(numbers, float(np.trace(spread.V @ np.linalg.pinv(spread.naive))))
        return -2 * self.value + numbers * math.log(int(self.objective.readings.ok.sum()))


def mean_reading(fit: ZoneFit) -> Floats:
    """Return E[y | z] (N), scaled: noise ahead of the zone makes its characteristic smooth."""
    if fit.objective.kind == "behind":
        return expected_reading(fit.z, fit.zone_noise, fit.objective.limits.zone)
    return mean_beyond_edges(fit.z, fit.zone_noise)


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


def refit_likelihood(fit: ZoneFit, use: Flags, steps: int) -> ZoneFit:
    """Fit to other samples, starting at a fit.

    Args:
        fit: of the same plant.
        use: flags of the samples that count (N).
        steps: largest number of steps.
    """
    old = fit.objective
    objective = ZoneObjective(old.simulator, old.kind, old.limits, use)
    return ZoneFit(objective, *maximise_likelihood(objective, fit.theta, steps))


def improve_fit(fit: ZoneFit, theta: Floats) -> ZoneFit:
    """Return the better of a fit and a fit that starts from other parameters (P)."""
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
    error = np.mean((columns @ theta[linear] - fit.z) ** 2)
    theta[layout.log_s] = 0.5 * math.log(fit.disturbance_rms**2 + error)
    return theta


def polish_fit(fit: ZoneFit) -> ZoneFit:
    """Return the fit after up to three Newton steps with the numerical Hessian."""
    objective = fit.objective
    theta = fit.theta
    value = fit.value
    if objective.kind == "behind":
        return fit
    for _ in range(3):
        step = np.linalg.solve(
            objective.negative_hessian(theta), objective.total_score(theta)[objective.free]
        )
        trial = theta.copy()
        trial[objective.free] += step
        trial = objective.project_to_bounds(trial)
        gain = objective.total_log_likelihood(trial) - value
        if gain > 0:
            theta = trial
            value += gain
        if not gain >= 1e-6:
            break
    return ZoneFit(objective, theta, value)


def fit_linear(simulator: PlantSimulator, use: Flags | None = None) -> ZoneFit:
    """Fit the output error without a zone, about a level: y = z - d_r."""
    level = (0.0, 0.0) if simulator.layout.integrators else (-math.inf, math.inf)
    objective = ZoneObjective(simulator, "behind", WidthLimits(right=level, zone=False), use)
    theta: Floats = np.zeros(objective.layout.parameter_count)
    a, b, _ = fit_arx(simulator, None, use)
    theta[objective.layout.denominator] = stabilise_poles(a)
    theta[objective.layout.numerators] = b
    if simulator.layout.integrators and a.size:
        theta = _start_with_slow_poles(objective, theta)
    above = simulator.simulate_z(theta) - simulator.data.y
    theta[objective.layout.right] = np.clip(above[objective.readings.ok].mean(), *level)
    theta[objective.layout.log_s] = math.log(0.5)
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
    e = fit.unexplained
    outside = readings.ok & (readings.side != 0)
    second = np.flatnonzero(outside & readings.before)
    second = second[outside[second - 1]]
    if second.size < 10:
        return 0.05
    rho = np.mean(e[second] * e[second - 1]) / np.mean(e[second] ** 2)
    return float(np.clip(rho, -0.9, 0.99)) or 0.05


def zone_starts(objective: ZoneObjective) -> list[Floats]:
    """Return start points (P each): ARX models of both sides, a linear fit with several widths."""
    layout = objective.layout
    use = objective.readings.ok
    linear = fit_linear(objective.simulator, use)
    by_branch = start_by_branch(objective)
    starts = [] if by_branch is None else [by_branch]
    halves = [*SHARES]
    if objective.simulator.data.silent_zeros:
        inside_share = np.mean(objective.readings.side[use] == 0)
        halves.append(float(np.quantile(np.abs(linear.z), inside_share)))
    for share in halves:
        theta = linear.theta.copy()
        theta[layout.numerators] *= 1 + 0.9 * share
        theta[layout.widths] = widths_about_level(linear, share)
        theta[layout.log_s] = math.log(0.4)
        starts.append(theta)
    return starts


def widths_about_level(linear: ZoneFit, half: float) -> Floats:
    """Return d_r and d_l of a zone of a given half width about the level of a linear fit."""
    return half + linear.right * np.array([1.0, -1.0])


def start_by_branch(objective: ZoneObjective) -> Floats | None:
    """Return a start point (P) from an ARX model on runs outside the zone; None if they are few.

    The model has a constant for each side. Behind A(q), their difference is the width.
    """
    layout = objective.layout
    if layout.integrators:
        return None  # differences of the readings contain no constants
    a, b, levels = fit_arx(objective.simulator, objective.readings.side, objective.readings.ok)
    if levels is None:
        return None
    gain = 1 + a.sum()
    if abs(gain) < 1e-9:
        return None
    right, left = levels / gain
    width = np.clip(left - right, 0.02, 6.0)
    shift = (left + right) / 2
    theta = np.zeros(layout.parameter_count)
    theta[layout.denominator] = stabilise_poles(a)
    theta[layout.numerators] = b
    theta[layout.widths] = np.maximum(width / 2 + shift * np.array([-1.0, 1.0]), 0.02)
    theta[layout.log_s] = math.log(0.2)
    return theta


def fit_arx(
    simulator: PlantSimulator, side: Integers | None, use: Flags | None
) -> tuple[Floats, Floats, Floats | None]:
    """Fit y_t on past y and u by least squares; for integrators, differences of y.

    Args:
        simulator: plant of the order, with the lagged inputs.
        side: side of each sample (N): only runs of n + 1 samples outside the zone on one side
            count, and each side has a constant. None: all samples count, with one constant.
        use: flags of the samples that count (N).

    Returns:
        a (n), b (m n), and the constants of right and left (2); None without sides, or if too few
        runs are outside the zone.
    """
    data = simulator.data
    layout = simulator.layout
    n = layout.n
    free = layout.denominator.stop
    valid = data.ok if use is None else data.ok & use
    y = data.y
    for _ in range(layout.integrators):
        y = y - np.roll(y, 1)
    past = delay_by_each(y[:, None], free)
    sides = np.ones(y.size) if side is None else side
    usable = valid & (rows_since_start(data.start, y.size) >= n)
    for i in range(1, n + 1):
        usable &= np.roll(valid, i) & (np.roll(sides, i) == sides)
    ends = [usable & (sides > 0)] if side is None else [usable & (sides > 0), usable & (sides < 0)]
    inputs = simulator.lagged.shape[1]
    if side is not None and min(end.sum() for end in ends) < FEW * (n + inputs):
        return np.zeros(free), np.zeros(inputs), None
    usable = np.any(ends, axis=0)
    matrix = np.column_stack([-past, simulator.lagged, *ends])[usable]
    solution = np.linalg.lstsq(matrix, y[usable], rcond=1e-10)[0]
    levels = None if side is None else solution[-2:]
    return solution[:free], solution[free : free + inputs], levels


def _centre_zone(objective: ZoneObjective, theta: Floats) -> Floats:
    """Return the parameters (P) with both widths equal to their mean, and x(0) = 0."""
    layout = objective.layout
    centred = theta.copy()
    centred[layout.widths] = max(theta[layout.widths].mean(), 1e-3)
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
