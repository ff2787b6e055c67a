"""Gaussian filters of `[x; d_r; d_l; extra]`: shared parameters, motion and estimate."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.interfaces import Estimate, Reading, build_estimate
from undeadzone.nonlinearities.sensor import Zone
from undeadzone.numerics.clip import clip
from undeadzone.numerics.gaussian import (
    Gaussian,
    Products,
    linearise,
    mirror_upper,
    truncate_to_range,
)
from undeadzone.observers.filtering.prior import Prior
from undeadzone.plants.system import System, hold_integral
from undeadzone.util.arrays import Floats


class Augmentation(NamedTuple):
    """Motion of the model with E further unknowns beside `[x; d]`.

    The first argument q of every function is the filter's `Params`.

    Attributes:
        params: numbers of its own, `Params.augmentation`.
        cov: covariance of the unknowns at first (E x E), with mean 0.
        change: change(q, x, extra, u) is (x+ - x, extra+ - extra).
        noise: noise(q, x, u) is the covariances (n x n, E x E) that a step adds to x and extra.
        alternative: alternative(q, belief) is (the estimate if some assumption is stronger than the
            filter takes it, its odds) (None: no assumption is).
        bilinear: bilinear(q, x, extra, u) is the nonlinear part of x+, as `predict` takes it (None:
            x+ itself).
        slope: slope(q) is the Jacobian of the change of `[x; d; extra]` that a prediction to first
            order takes (None: the exact one).
        disturbance: disturbance(q, extra) is its contribution to x' (n) [1/s] (None: that of the
            change of x+).
        entries: entries of the upper triangle of the covariance of `[x; d; extra]` that are not 0
            throughout (None: all).
        parameters: places of the model's parameters that the last unknowns change, and that an
            estimate shows.
        constants: how many of the last unknowns are errors of the model, which never change.
        zones: how many of the last unknowns are widths of actuators (`add_actuator_states`).
    """

    params: Any
    cov: Floats
    change: Callable[[Any, Any, Any, Any], tuple[Any, Any]]
    noise: Callable[[Any, Any, Any], tuple[Any, Any]]
    alternative: Callable[[Any, Gaussian], tuple[Gaussian, Any]] | None = None
    bilinear: Callable[[Any, Any, Any, Any], Products] | None = None
    slope: Callable[[Any], Any] | None = None
    disturbance: Callable[[Any, Any], Any] | None = None
    entries: ca.Sparsity | None = None
    parameters: tuple[int, ...] = ()
    constants: int = 0
    zones: int = 0


class ShapeLayout(NamedTuple):
    """Places of the doubts about the sensor's shape in a filter (`sensor_shape`).

    Attributes:
        first: place of the first of its unknowns in `[x; d; extra]`.
        learned: names of the doubts that are unknowns, p of each.
        fixed: names of those that have a column, p of each.
    """

    first: int = 0
    learned: tuple[str, ...] = ()
    fixed: tuple[str, ...] = ()


class Params(NamedTuple):
    """Parameters of a filter.

    Attributes:
        model, augmentation: numbers of the model and of the augmentation.
        R: variance of a reading on an active side (p) [z^2].
        gate: |y| that is surely not silent (p) [y].
        slope: slope m of the sensor (p).
        drift: variance that the widths gain each step (2p) [z^2].
        mean: mean of `[x; d; extra]` at first.
        cov: covariance of `[x; d; extra]` at first, see `to_upper_entries`.
        ranges: assumed ranges of all d_r, then of all d_l (2p x 2) [z].
        rate: from a change of x+ to the disturbance w, held over the step, that makes it (n x n)
            [1/s].
        lasting: steps for which a linearisation error keeps its sign, and for which a limit is not
            used again.
        doubt: of readings and assumptions, as `Doubt` (None: the filter knows no doubt).
        ends: of the range of the readings, as `RangeLimits` (None: they have none).
        zones: of the actuators' dead zones, as `Zones` (None: none is estimated).
        rest: steps for which an edge with censored samples is not used again.
        gaps: of a play ahead of the dead zone, as `Gaps` (None: there is none).
        shape: of the sensor, as `ShapeNumbers` (None: it is exact).
        level: of the noise, as `LevelNumbers` (None: it is as declared).
    """

    model: Any
    augmentation: Any
    R: Floats
    gate: Floats
    slope: Floats
    drift: Floats
    mean: Floats
    cov: Floats
    ranges: Floats
    rate: Floats
    lasting: Any = np.float64(1.0)
    doubt: Any = None
    ends: Any = None
    zones: Any = None
    rest: Any = np.float64(1.0)
    gaps: Any = None
    shape: Any = None
    level: Any = None


def build_filter_params(
    model: System, sensor: Zone, prior: Prior, augmentation: Augmentation
) -> Params:
    """Return the parameters of a filter that starts from the prior."""
    known = model.n + 2 * model.p
    count = len(augmentation.cov)
    cov = np.zeros((known + count,) * 2)
    cov[:known, :known] = np.diag(prior.std**2)
    widths, cov[model.n : known, model.n : known] = prior.width_moments()
    cov[known:, known:] = augmentation.cov
    rows, columns = covariance_entries(model, augmentation).get_triplet()
    return Params(
        model=model.params,
        augmentation=augmentation.params,
        R=prior.R,
        gate=prior.gate,
        slope=sensor.slope,
        drift=prior.drift,
        mean=np.concatenate([prior.mean[: model.n], widths, np.zeros(count)]),
        cov=cov[rows, columns],
        ranges=prior.ranges,
        rate=np.linalg.inv(hold_integral(model)),
    )


def covariance_entries(model: System, augmentation: Augmentation) -> ca.Sparsity:
    """Return the sparsity of the covariance's upper triangle that a filter stores."""
    if augmentation.entries is not None:
        return augmentation.entries
    return ca.Sparsity.upper(model.n + 2 * model.p + len(augmentation.cov))


def build_transition(
    model: System,
    q: Params,
    augmentation: Augmentation,
    belief: Gaussian,
    plant_input: Callable[[Any], Any],
    input_variances: Any = None,
) -> tuple[Callable[[Any], Any], Any]:
    """Return the increment of `[x; d; extra]` over a step as a function, and its noise covariance.

    An uncertain input u with variances v adds B diag(v) B' to the covariance, B = d x+ / d u. The
    widths d are constant but for their drift.

    Args:
        model: the sampled model.
        q: parameters of the filter.
        augmentation: model of the further unknowns `extra`.
        belief: mean and covariance of `[x; d; extra]` before the step.
        plant_input: the plant's input (m), as a function of `[x; d; extra]`.
        input_variances: variances of the plant's input (m) (None: it is known).
    """
    n = model.n
    known = n + 2 * model.p
    u = plant_input(belief.mean)
    noise_x, noise_extra = augmentation.noise(q, belief.mean[:n], u)
    if input_variances is not None:
        change_by_input = partial(
            _state_change, augmentation, q, belief.mean[:n], belief.mean[known:]
        )
        _, B = linearise(change_by_input, u)
        noise_x += B @ ca.diag(input_variances) @ B.T

    def change(X: Any) -> Any:
        """Return the change of `[x; d; extra]` over a step (N)."""
        x, extra = augmentation.change(q, X[:n], X[known:], plant_input(X))
        return ca.vertcat(x, ca.SX(known - n, 1), extra)

    return change, ca.diagcat(noise_x, ca.diag(q.drift), noise_extra)


def _state_change(augmentation: Augmentation, q: Params, x: Any, extra: Any, u: Any) -> Any:
    """Return the change of x over a step under an input (n)."""
    return augmentation.change(q, x, extra, u)[0]


def to_estimate(
    model: System, sensor: Zone, q: Params, belief: Gaussian, reading: Reading, e: Any, e_std: Any
) -> Estimate:
    """Return the mean and covariance of `[x; d; extra]` as an `Estimate`.

    Args:
        model: the model.
        sensor: the dead zone, for its kind.
        q: the filter's numbers.
        belief: mean and covariance of `[x; d; extra]`.
        reading: the reading.
        e: innovations (p).
        e_std: standard deviations of the innovations (p).
    """
    mean, cov = belief
    n = model.n
    p = model.p
    known = n + 2 * p
    x = mean[:n]
    right = mean[n : n + p]
    left = mean[n + p : known]
    right_std, left_std, width_std = branch_deviations(cov[n:known, n:known])
    z = model.output(q.model, x)
    means = build_estimate(x, z, right, left, reading, q.slope, sensor.kind, e)
    return means._replace(
        x_std=ca.sqrt(ca.fmax(ca.diag(cov)[:n], 0.0)),
        right_std=right_std,
        left_std=left_std,
        width_std=width_std,
        innovation_std=e_std,
    )


def branch_deviations(cov: Any) -> tuple[Any, Any, Any]:
    """Return the standard deviations of d_r, of d_l, and of d_r + d_l (p each) [z].

    Args:
        cov: covariance of all d_r, then of all d_l (2p x 2p) [z^2].
    """
    p = cov.shape[0] // 2
    variances = ca.diag(cov)
    covariances = ca.diag(cov[:p, p:])
    std = ca.sqrt(ca.fmax(variances, 0.0))
    sum_variances = variances[:p] + variances[p:] + 2 * covariances
    return std[:p], std[p:], ca.sqrt(ca.fmax(sum_variances, 0.0))


def white_disturbance(model: System, variance: Floats) -> Augmentation:
    """Return the augmentation by an input disturbance that is white, without further unknowns.

    Args:
        model: the sampled model.
        variance: that of the disturbance (m) [u^2].
    """

    assert model.change is not None
    of_x = model.change

    def change(q: Params, x: Any, extra: Any, u: Any) -> tuple[Any, Any]:
        """Return (x+ - x, 0) over a step."""
        return of_x(q.model, x, u), extra

    def white_covariances(q: Params, x: Any, u: Any) -> tuple[Any, Any]:
        """Return the covariances that a step adds to x (n x n) and to extra (empty)."""
        _, B = linearise(lambda v: of_x(q.model, x, v), u)
        return B @ ca.diag(q.augmentation) @ B.T, ca.SX(0, 0)

    return Augmentation(variance, np.zeros((0, 0)), change, white_covariances)


# --- Displayed estimates


ROUNDING = 1e-12  # of a variance
FAR = 2.3  # standard deviations beyond its range from which a width contradicts the assumptions
BEYOND = 1.6  # the same for estimates from readings alone, without the range as prior
LEAST = 1e-30  # chance of a range that a belief leaves out; a float holds it
INSIDE = 6.0  # standard deviations beyond which an end of a range has no effect, to 1e-8 of one


class Setup(NamedTuple):
    """Options shared by the functions of a filter.

    Attributes:
        model: the sampled model.
        sensor: the dead zone.
        augmentation: the unknowns beside `[x; d]`.
        entries: entries of the covariance's upper triangle that are kept.
        bounds: whether it uses bounds: censored samples, and the assumed ranges.
        order: order of the prediction.
        blind: whether it takes every reading for z itself.
        doubts: whether a reading may be wrong.
        careful: whether censored samples move widths only as far as readings contained information
            on them.
        centred: whether an asymmetry is assumed, which couples the edges.
        shape: places of its unknowns of the sensor's shape.
    """

    model: System
    sensor: Zone
    augmentation: Augmentation
    entries: ca.Sparsity
    bounds: bool
    order: Literal[1, 2]
    blind: bool
    doubts: bool
    careful: bool
    centred: bool
    shape: ShapeLayout = ShapeLayout()

    @property
    def needs_partial_updates(self) -> bool:
        """Return whether a reading on a branch moves further widths in part.

        The part is the share of information in their own readings.
        """
        return (
            self.careful and self.doubts and self.bounds and self.is_plain_zone and not self.centred
        )

    @property
    def has_pace_test(self) -> bool:
        """Return whether readings that leave the zone undergo a pace test."""
        return self.doubts and self.is_plain_zone

    @property
    def has_pace(self) -> bool:
        """Return whether the filter keeps how z moves, for a pace test or for late readings."""
        return self.has_pace_test or "lag" in self.shape.fixed

    @property
    def is_plain_zone(self) -> bool:
        """Return whether the sensor is a dead zone alone, without jump or backlash."""
        return not self.is_jump_sensor and not self.sensor.moves

    @property
    def has_limits(self) -> bool:
        """Return whether readings at a limit of their range bound z.

        For a backlash they are missing.
        """
        return self.sensor.limits is not None and not self.sensor.moves

    @property
    def is_jump_sensor(self) -> bool:
        """Return whether the sensor is of the jump kind."""
        return self.sensor.kind == "jump"

    @property
    def is_backlash_sensor(self) -> bool:
        """Return whether the sensor is a backlash, with a constant reading inside the gap."""
        return self.sensor.kind == "play"

    @property
    def has_backlash_ahead(self) -> bool:
        """Return whether a backlash precedes the dead zone."""
        return self.sensor.play is not None


def clip_belief(setup: Setup, q: Params, belief: Gaussian) -> tuple[Gaussian, Any]:
    """Return the Gaussian that an estimate shows, and 1 if its widths may lie in their ranges.

    Its widths lie in their assumed ranges, and it is the mixture of both if some assumption may be
    stronger.
    """
    limited, chance = limit_widths(setup, q, belief)
    alone = width_excess_square(setup.model.n, q, belief) if setup.bounds else 0.0
    if setup.augmentation.alternative is not None:
        stronger, odds = setup.augmentation.alternative(q, belief)
        stronger, likelier = limit_widths(setup, q, stronger)
        share = likelier * odds / (likelier * odds + chance)
        limited = mix_two_gaussians(stronger, limited, share)
    if setup.blind:
        return limited, 1.0
    return clip_to_ranges(setup.model.n, q, limited, setup.doubts, alone)


def mix_two_gaussians(stronger: Gaussian, weaker: Gaussian, share: Any) -> Gaussian:
    """Return the mixture of two Gaussians. Its deviations cover 95 % of the mixture at +-1.96.

    A mixture of a narrow and a wide belief has more in its tails than a Gaussian of its variance.
    If the wide one, of chance b, is much wider, 95 % of the mixture lie within 1.96 deviations of
    variance h^2 of the wide one's, Phi(1.96 h) = 1 - 0.025 / b. h^2 is at most b (2 - b). This
    bound is used. A Gaussian would have b.

    Args:
        stronger: the estimate if the stronger assumption is true.
        weaker: the belief if it is not.
        share: chance of the stronger one.
    """
    narrow = share**2
    gap = stronger.mean - weaker.mean
    cov = narrow * stronger.cov + (1 - narrow) * weaker.cov + share * (1 - share) * gap @ gap.T
    return Gaussian(share * stronger.mean + (1 - share) * weaker.mean, mirror_upper(cov))


def width_excess_square(n: int, q: Params, belief: Gaussian) -> Any:
    """Return the largest squared excess of a width over its range by readings alone (1) [z^2].

    The value is 0 if the readings allow the ranges.

    A belief is the product of its prior, of the variance of a uniform distribution over the range,
    and of the likelihood of the readings. A prior that is divided out pulls no mean into the range.
    """
    count = q.ranges.shape[0]
    low = q.ranges[:, 0]
    high = q.ranges[:, 1]
    mean = belief.mean[n : n + count]
    variance = ca.diag(belief.cov)[n : n + count]
    learnt = (high - low) ** 2 / 12 - variance
    more = 1 + variance / ca.fmax(learnt, variance)
    excess = ca.fmax(more * ca.fabs(mean - (low + high) / 2) - (high - low) / 2, 0.0)
    return ca.mmax(ca.if_else(excess**2 > BEYOND**2 * more * variance, excess**2, 0.0))


def clip_to_ranges(
    n: int, q: Params, belief: Gaussian, doubts: bool, alone: Any = 0.0
) -> tuple[Gaussian, Any]:
    """Return the Gaussian with clipped width means, and 1 if the ranges are possible.

    A width `FAR` beyond its range contradicts some assumption: its variance gains the square of the
    excess.

    Args:
        n: number of states.
        q: the filter's numbers.
        belief: about `[x; d; extra]`.
        doubts: whether the variance gains anything.
        alone: what variances of states and widths gain at least, see `width_excess_square`.
    """
    count = q.ranges.shape[0]
    widths = belief.mean[n : n + count]
    inside = clip(widths, *ca.horzsplit(q.ranges))
    excess = widths - inside
    variances = ca.diag(belief.cov)[n : n + count]
    gained = ca.fmax(ca.if_else(excess**2 > FAR**2 * variances, excess**2, 0.0), alone)
    mean = ca.vertcat(belief.mean[:n], inside, belief.mean[n + count :])
    cov = belief.cov
    if doubts:
        rest = cov.shape[0] - n - count
        cov = cov + ca.diagcat(alone * ca.SX.eye(n), ca.diag(gained), ca.SX(rest, rest))
    return Gaussian(mean, cov), ca.sum1(gained) == 0


def limit_widths(setup: Setup, q: Params, belief: Gaussian) -> tuple[Gaussian, Any]:
    """Return the result of `truncate_to_ranges` if the filter uses bounds.

    Otherwise return the Gaussian and probability 1.
    """
    if not setup.bounds:
        return belief, 1.0
    return truncate_to_ranges(q, setup.model.n, belief)


def truncate_to_ranges(q: Params, n: int, belief: Gaussian) -> tuple[Gaussian, Any]:
    """Return the Gaussian with the mean conditional on every width in its assumed range.

    The covariance stays: that of a Gaussian truncated after it was matched to a uniform
    distribution would be too small. But the variance of a width never exceeds that of its range,
    however long it drifted. Right edges go first, and left ones do: the mean of both treats them
    alike. Nothing is truncated if every edge of a range is farther than `INSIDE` away.

    Returns:
        (belief, the chance that every width lies in its range, above 0).
    """
    mean, P = belief
    p = q.ranges.shape[0] // 2
    chance = 1.0
    for i in range(p):
        both = (n + i, n + p + i)
        pair = Gaussian(mean[both, :], P[both, both])
        ranges = q.ranges[(i, p + i), :]
        one, first = _truncate_pair(pair, ranges, (0, 1))
        other, second = _truncate_pair(pair, ranges, (1, 0))
        far = _is_inside(pair, ranges)
        mean = mean + P[:, both] @ (ca.logic_not(far) * (one + other) / 2)
        chance *= ca.if_else(far, 1.0, ca.sqrt(ca.fmax(first * second, LEAST)))
    return Gaussian(mean, _limit_variances(q, n, P)), chance


def _is_inside(pair: Gaussian, ranges: Any) -> Any:
    """Return 1 if each width lies more than `INSIDE` deviations within its range."""
    scale = ca.sqrt(0.5 / ca.diag(pair.cov))
    least = INSIDE / np.sqrt(2)
    low = (ranges[:, 0] - pair.mean) * scale
    high = (ranges[:, 1] - pair.mean) * scale
    return ca.mmin(ca.logic_and(low < -least, high > least))


def _truncate_pair(pair: Gaussian, ranges: Any, order: tuple[int, int]) -> tuple[Any, Any]:
    """Return the moves of a mean along the columns of two widths truncated in order.

    Returns:
        (numbers by which the columns of the covariance move it (2), the chance).
    """
    (m, P) = pair
    (i, j) = order
    shift, lost, chance = truncate_to_range(m[i], P[i, i], ranges[i, 0], ranges[i, 1])
    after = m[j] + shift * P[i, j]
    variance = P[j, j] - lost * P[i, j] ** 2
    second, _, likewise = truncate_to_range(after, variance, ranges[j, 0], ranges[j, 1])
    moves = {i: shift - lost * P[i, j] * second, j: second}
    return ca.vertcat(moves[0], moves[1]), chance * likewise


def _limit_variances(q: Params, n: int, cov: Any) -> Any:
    """Return the covariance with limited width variances.

    The limit is that of a uniform distribution over the range.
    """
    count = q.ranges.shape[0]
    most = (1 + ROUNDING) * (q.ranges[:, 1] - q.ranges[:, 0]) ** 2 / 12
    variances = ca.diag(cov)[n : n + count]
    shrunk = ca.if_else(variances > most, ca.sqrt(most / variances), 1.0)
    scale = ca.vertcat(ca.SX.ones(n), shrunk, ca.SX.ones(cov.shape[0] - n - count))
    return cov * (scale @ scale.T)


def add_unknown_estimates(
    setup: Setup, q: Params, estimated: Estimate, belief: Gaussian, u: Any
) -> Estimate:
    """Return the estimate with w and theta if the filter estimates them (u: the last input)."""
    augmentation = setup.augmentation
    model = setup.model
    n = setup.model.n
    if len(augmentation.cov):
        extra = belief.mean[n + 2 * model.p :]
        if augmentation.disturbance is None:
            x = belief.mean[:n]
            assert model.change is not None
            w = q.rate @ (augmentation.change(q, x, extra, u)[0] - model.change(q.model, x, u))
        else:
            w = augmentation.disturbance(q, extra)
        estimated = estimated._replace(w=w)
    count = len(augmentation.parameters)
    if count:
        part = slice(setup.shape.first - count, setup.shape.first)
        theta = q.model[list(augmentation.parameters)] + belief.mean[part]
        theta_std = ca.sqrt(ca.fmax(ca.diag(belief.cov)[part], 0.0))
        estimated = estimated._replace(theta=theta, theta_std=theta_std)
    return estimated
