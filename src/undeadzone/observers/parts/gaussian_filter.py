"""Gaussian filters of [x; d_r; d_l; extra] share their numbers, their motion and their estimate."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.ends.sensor import Zone
from undeadzone.interfaces import Estimate, Reading, estimate
from undeadzone.numerics.gaussian import Gaussian, linearise
from undeadzone.observers.parts.prior import Prior
from undeadzone.plants.system import System, held
from undeadzone.support.arrays import Floats


class Augmentation(NamedTuple):
    """The model's motion with E further unknowns beside [x; d].

    The first argument q of every function is the filter's `Params`.

    Attributes:
        params: numbers of its own, `Params.augmentation`.
        cov: covariance of the unknowns at first (E x E); their mean is 0.
        change: change(q, x, extra, u) is (x+ - x, extra+ - extra).
        noise: noise(q, x, u) is the covariances (n x n, E x E) that a step adds to x and extra.
        alternative: alternative(q, belief) is (the belief if some claim is stronger than the filter
            takes it, the log of its odds); None: no claim is.
        bilinear: bilinear(q, x, extra, u) is (G (n x M), b (M)), as `predict` takes them; None: x+
            itself.
        slope: slope(q) is the Jacobian of the change of [x; d; extra] that a prediction to first
            order takes; None: the exact one.
        disturbance: disturbance(q, extra) is what it adds to x' (n) [1/s]; None: that of the change
            of x+.
        entries: entries of the upper triangle of the covariance of [x; d; extra] that are not 0
            throughout; None: all.
        parameters: places of the model's parameters that the last unknowns change, and that an
            estimate shows.
        constants: how many of the last unknowns are errors of the model, which never change.
        zones: how many of the last unknowns are widths of actuators (`further_constants`).
    """

    params: Any
    cov: Floats
    change: Callable[[Any, Any, Any, Any], tuple[Any, Any]]
    noise: Callable[[Any, Any, Any], tuple[Any, Any]]
    alternative: Callable[[Any, Gaussian], tuple[Gaussian, Any]] | None = None
    bilinear: Callable[[Any, Any, Any, Any], tuple[Any, Any]] | None = None
    slope: Callable[[Any], Any] | None = None
    disturbance: Callable[[Any, Any], Any] | None = None
    entries: ca.Sparsity | None = None
    parameters: tuple[int, ...] = ()
    constants: int = 0
    zones: int = 0


class Params(NamedTuple):
    """Numbers of a filter.

    Attributes:
        model, augmentation: numbers of the model and of the augmentation.
        R: variance of a reading on an active side (p) [z^2].
        gate: |y| that is surely not silent (p) [y].
        slope: slope m of the sensor (p).
        drift: variance that the widths gain each step (2p) [z^2].
        mean: mean of [x; d; extra] at first.
        cov: covariance of [x; d; extra] at first, its `triangle`.
        ranges: claimed ranges of all d_r, then of all d_l (2p x 2) [z].
        rate: from a change of x+ to the disturbance w, held over the step, that makes it (n x n)
            [1/s].
        lasting: steps for which a linearisation error keeps its sign, and for which a limit is not
            heard again.
        doubt: of readings and claims, as `Doubt`; None: the filter knows no doubt.
        ends: of the range of the readings, as `Ends`; None: they have none.
        zones: of the actuators' dead zones, as `Zones`; None: none is estimated.
        rest: steps for which a silent edge is not heard again.
        gaps: of a play ahead of the dead zone, as `Gaps`; None: there is none.
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
    lasting: Any = 1.0
    doubt: Any = None
    ends: Any = None
    zones: Any = None
    rest: Any = 1.0
    gaps: Any = None


def filter_numbers(model: System, sensor: Zone, prior: Prior, augmentation: Augmentation) -> Params:
    """The numbers of a filter that starts from the prior."""
    known = model.n + 2 * model.p
    count = len(augmentation.cov)
    cov = np.zeros((known + count,) * 2)
    cov[:known, :known] = np.diag(prior.std**2)
    widths, cov[model.n : known, model.n : known] = prior.widths()
    cov[known:, known:] = augmentation.cov
    rows, columns = kept_entries(model, augmentation).get_triplet()
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
        rate=np.linalg.inv(held(model)),
        lasting=np.asarray(1.0),
        rest=np.asarray(1.0),
    )


def kept_entries(model: System, augmentation: Augmentation) -> ca.Sparsity:
    """The entries of the covariance's upper triangle that a filter keeps."""
    if augmentation.entries is not None:
        return augmentation.entries
    return ca.Sparsity.upper(model.n + 2 * model.p + len(augmentation.cov))


def informed(q: Params, model: System, cov: Any) -> Any:
    """How far readings have told of each width: its correlation with what they said (N).

    The root of the share that they took from its prior variance; 1 for all that is not a width.

    Args:
        q: the filter's numbers.
        model: the model.
        cov: covariance of [x; d; extra] (N x N).
    """
    n, known = model.n, model.n + 2 * model.p
    first = q.doubt.std[n:known] ** 2
    told = ca.sqrt(ca.fmax(1 - ca.diag(cov)[n:known] / first, 0.0))
    return ca.vertcat(ca.SX.ones(n), told, _informed_of_gaps(q, cov, known))


def _informed_of_gaps(q: Params, cov: Any, known: int) -> Any:
    """`informed` of the unknowns after the widths, of which there are `known` with the state."""
    rest = cov.shape[0] - known
    if q.gaps is None or not q.gaps.std.shape[0]:
        return ca.SX.ones(rest)
    after = 0 if q.zones is None else q.zones.middle.shape[0]
    count = q.gaps.std.shape[0]
    variance = ca.diag(cov)[cov.shape[0] - after - count : cov.shape[0] - after]
    told = ca.sqrt(ca.fmax(1 - variance / q.gaps.std**2, 0.0))
    return ca.vertcat(ca.SX.ones(rest - after - count), told, ca.SX.ones(after))


def motion(
    model: System,
    q: Params,
    augmentation: Augmentation,
    belief: Gaussian,
    drive: Callable[[Any], Any],
    doubt: Any = None,
) -> tuple[Callable[[Any], Any], Any]:
    """(the change of [x; d; extra] over a step, the covariance that it adds).

    Args:
        model: the model.
        q: the filter's numbers.
        augmentation: the further unknowns.
        belief: mean and covariance of [x; d; extra].
        drive: what enters the plant (m), as a function of [x; d; extra].
        doubt: variance of what enters (m); None: it is known.
    """
    n = model.n
    known = n + 2 * model.p
    u = drive(belief.mean)
    noise_x, noise_extra = augmentation.noise(q, belief.mean[:n], u)
    if doubt is not None:
        here = partial(_moved, augmentation, q, belief.mean[:n], belief.mean[known:])
        _, B = linearise(here, u)
        noise_x += B @ ca.diag(doubt) @ B.T

    def change(X: Any) -> Any:
        x, extra = augmentation.change(q, X[:n], X[known:], drive(X))
        return ca.vertcat(x, ca.SX(known - n, 1), extra)

    return change, ca.diagcat(noise_x, ca.diag(q.drift), noise_extra)


def _moved(augmentation: Augmentation, q: Params, x: Any, extra: Any, u: Any) -> Any:
    """The change of x over a step under an input."""
    return augmentation.change(q, x, extra, u)[0]


def to_estimate(
    model: System, sensor: Zone, q: Params, belief: Gaussian, reading: Reading, e: Any, e_std: Any
) -> Estimate:
    """The belief about [x; d; extra] as an `Estimate`.

    Args:
        model: the model.
        sensor: the dead zone, for its kind.
        q: the filter's numbers.
        belief: mean and covariance of [x; d; extra].
        reading: what was read.
        e: innovations (p).
        e_std: standard deviations of the innovations (p).
    """
    mean, cov = belief
    n, p = model.n, model.p
    known = n + 2 * p
    x, right, left = mean[:n], mean[n : n + p], mean[n + p : known]
    variance = ca.diag(cov)
    between = ca.diag(cov[n : n + p, n + p : known])
    width_variance = variance[n : n + p] + variance[n + p : known] + 2 * between
    std = ca.sqrt(ca.fmax(variance, 0.0))
    z = model.output(q.model, x)
    means = estimate(x, z, right, left, reading, q.slope, sensor.kind, e)
    return means._replace(
        x_std=std[:n],
        right_std=std[n : n + p],
        left_std=std[n + p : known],
        width_std=ca.sqrt(ca.fmax(width_variance, 0.0)),
        innovation_std=e_std,
    )


def white(model: System, variance: Floats) -> Augmentation:
    """An input disturbance that is new at every sample, and nothing else unknown beside [x; d].

    Args:
        model: the sampled model.
        variance: that of the disturbance (m) [u^2].
    """

    assert model.change is not None
    of_x = model.change

    def change(q: Params, x: Any, extra: Any, u: Any) -> tuple[Any, Any]:
        return of_x(q.model, x, u), extra

    def noise(q: Params, x: Any, u: Any) -> tuple[Any, Any]:
        _, B = linearise(lambda v: of_x(q.model, x, v), u)
        return B @ ca.diag(q.augmentation) @ B.T, ca.SX(0, 0)

    return Augmentation(variance, np.zeros((0, 0)), change, noise)
