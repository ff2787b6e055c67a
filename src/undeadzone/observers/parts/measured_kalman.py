"""The Kalman filter on the measured side, for [x; d_r; d_l] and whatever else is unknown (docs/filters.md)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError, ShapeError
from undeadzone.interfaces import Estimate, Observer, Reading, estimate
from undeadzone.numerics.gaussian import (
    Gaussian,
    advance,
    linearise,
    mix,
    predict,
    symmetric,
    triangle,
    truncate,
    truncate_to,
    update,
)
from undeadzone.plants.system import System, held
from undeadzone.sensor import LEFT, RIGHT, Zone, offset, present
from undeadzone.support.arrays import Array, Floats, array, nonnegative, scalar, vector

DOUBT = 1.6448536269514722  # a silent sensor is heard where the belief contradicts it with more than 5 %
FLOOR = 1e-3  # least noise that is assumed, in declared ranges of the widths


class Prior(NamedTuple):
    """What is believed before the first reading of [x; d_r; d_l] (n + 2p), and of the sensor (p each).

    R: variance of a reading on an active side [z^2]; gate: |y| that is surely not silent [y]; drift: variance that the
    widths gain each step (2p) [z^2]; ranges: declared ones of all d_r, then all d_l (2p x 2) [z].
    """

    mean: Floats
    std: Floats
    R: Floats
    gate: Floats
    drift: Floats
    ranges: Floats


class Augmentation(NamedTuple):
    """The model's motion with E further unknowns beside [x; d], of mean 0 and covariance cov (E x E) at first.

    move(q, x, extra, u): (x+, extra+); noise(q, x, u): covariances (n x n, E x E) that a step adds to them; q: Params.
    small(q, belief): the belief if some claim is stronger than the filter takes it, and the log of its odds; None: there is none.
    bend(q, x, extra, u): (G (n x M), b (M)) as for `predict`; None: x+ itself.
    slope(q): the Jacobian of [x; d; extra] to take in a prediction to first order; None: the exact one.
    push(q, extra): what it adds to x' [1/s] (n); None: that of the change of x+.
    parameters: of the model, which the last unknowns change and an estimate shows.
    entries: of the upper triangle of the covariance of [x; d; extra], those that are not 0 throughout; None: all.
    """

    params: Any
    cov: Floats
    move: Callable[[Any, Any, Any, Any], tuple[Any, Any]]
    noise: Callable[[Any, Any, Any], tuple[Any, Any]]
    alternative: Callable[[Any, Gaussian], tuple[Gaussian, Any]] | None = None
    bilinear: Callable[[Any, Any, Any, Any], tuple[Any, Any]] | None = None
    slope: Callable[[Any], Any] | None = None
    disturbance: Callable[[Any, Any], Any] | None = None
    entries: ca.Sparsity | None = None
    parameters: tuple[int, ...] = ()


class Params(NamedTuple):
    """Numbers of the filter; mean and cov (a `triangle`) are those it starts from; rate (n x n): from a change of x+ to what held makes it [1/s]."""

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


class State(NamedTuple):
    """Mean and covariance (its `triangle`) before the reading, the last two readings, steps to wait per edge (2p), the last input."""

    mean: Any
    cov: Any
    last: Any
    previous: Any
    wait: Any
    u: Any


def prior(
    model: System, sensor: Zone, right: Array, left: Array | None, noise: Array | None, x_std: Array | None, drift: Array | None,
    floor: float = FLOOR, wear: float = 0.0, start: Array = 0.0,
) -> Prior:  # fmt: skip
    """The prior from declared ranges [lo, hi] of the widths: mean of the range, std of a uniform distribution over it.

    noise: default the sensor's, but at least `floor` of a range; x_std: default five times the largest width; drift: default `wear` times it;
    start: mean of x(0). Raises InputError, ShapeError.
    """
    Ts, p = sample_time(model), model.p
    ranges = declared(right, left, p)
    span, most = ranges[:, 1] - ranges[:, 0], ranges[:, 1].max()
    if noise is None:
        rms = sensor.rms
        least = floor * span.reshape(2, p).max(axis=0)
    else:
        rms = nonnegative("observer.noise", noise, p, "one per output")
        if not rms.all():
            raise InputError(
                "observer.noise: must be positive, found 0; leave it out for a sensor without noise"
            )
        least = np.zeros(p)
    spread = (
        np.full(model.n, 5 * most)
        if x_std is None
        else nonnegative("observer.x_std", x_std, model.n, "one per state")
    )
    growth = scalar("observer.drift", wear * most if drift is None else drift, least=0.0) ** 2 * Ts
    return Prior(
        np.concatenate(
            [vector("observer.start", start, model.n, "one per state"), ranges.mean(axis=1)]
        ),
        np.concatenate([spread, span / np.sqrt(12)]),
        np.maximum(rms, least) ** 2,
        np.maximum(sensor.threshold, 4 * rms * sensor.slope),
        np.full(2 * p, growth),
        ranges,
    )


def sample_time(model: System) -> float:
    """The model's sample time [s]. Raises InputError in continuous time."""
    if model.Ts is None:
        raise InputError(
            'observer: this filter works on samples; set simulation.time = "sampled" (simulation.step is the sample time)'
        )
    return model.Ts


def declared(right: Array, left: Array | None, p: int) -> Floats:
    """The declared ranges of all d_r, then all d_l (2p x 2); left: default that of right. Raises InputError, ShapeError."""
    return np.concatenate(
        [
            _ranges("observer.right", right, p),
            _ranges("observer.left", right if left is None else left, p),
        ]
    )


def _ranges(key: str, value: Array, p: int) -> Floats:
    found = array(key, value)
    if found.shape not in ((2,), (p, 2)):
        raise ShapeError(
            f"{key}: expected the declared range [lo, hi], or one per output ({p} x 2), found {' x '.join(map(str, found.shape)) or 'one number'}"
        )
    found = np.broadcast_to(found, (p, 2))
    if (found[:, 0] < 0).any() or (found[:, 0] >= found[:, 1]).any():
        raise InputError(f"{key}: a range [lo, hi] must have 0 <= lo < hi, found {found.tolist()}")
    return found


def measured_filter(
    model: System, sensor: Zone, prior: Prior, augmentation: Augmentation, lasting: float = 1.0, bounds: bool = False,
    order: Literal[1, 2] = 2, blind: bool = False,
) -> Observer:  # fmt: skip
    """The filter as an observer.

    lasting: steps for which a linearisation error keeps its sign, and for which a silent edge is not heard again;
    bounds: hear what bounds: a silent sensor, and the declared ranges; order: of the prediction; blind: take every reading for z itself.
    """
    n, p = model.n, model.p
    jump = sensor.kind == "jump"
    params = numbers(model, sensor, prior, augmentation)
    size, entries = params.mean.size, kept(model, augmentation)

    def init(q: Params) -> State:
        return State(q.mean, q.cov, np.zeros(p), np.zeros(p), np.zeros(2 * p), np.zeros(model.m))

    def beyond(q: Params, i: int, side: Any, X: Any) -> Any:
        """How far z_i is beyond the edge of that side: the reading on it; with side 0, z_i itself."""
        return model.output(q.model, X[:n])[i] - offset(side, X[n + i], X[n + p + i])

    def correct(q: Params, belief: Gaussian, y: Any, side: Any) -> tuple[Gaussian, Any, Any]:
        """(belief, innovations, their standard deviations) after the readings on the sides that are sure, one output at a time."""
        innovations, stds = [], []
        for i in range(p):
            active = side[i] != 0
            expected, h = linearise(partial(beyond, q, i, 0.0 if jump else side[i]), belief.mean)
            e = ca.if_else(active, y[i] / q.slope[i] - expected, 0.0)
            belief, S = update(belief, h, e, q.R[i], active)
            innovations.append(e)
            stds.append(ca.sqrt(S))
        return belief, ca.vertcat(*innovations), ca.vertcat(*stds)

    def use_bounds(
        q: Params, belief: Gaussian, quiet: Any, side: Any, wait: Any
    ) -> tuple[Gaussian, Any]:
        """(belief, steps to wait) given that z is inside the edges of a silent sensor, and of a jump sensor beyond the edge that it is on."""
        waits: list[Any] = []
        for edge in (RIGHT, LEFT):
            for i in range(p):
                outside = (side[i] == edge) if jump else 0.0
                told = ca.logic_and(ca.logic_or(quiet[i], outside), wait[len(waits)] <= 0)
                excess, h = linearise(partial(beyond, q, i, edge), belief.mean)
                sign, slack = (
                    edge * (1 - 2 * outside),
                    ca.if_else(quiet[i], q.gate[i] / q.slope[i], 0.0),
                )
                belief, used = truncate(
                    belief, sign * h, sign * excess - slack, q.R[i], told, DOUBT
                )
                waits.append(ca.if_else(used, lasting, wait[len(waits)] - 1))
        return belief, ca.vertcat(*waits)

    def bent(q: Params, u: Any, X: Any) -> tuple[Any, Any]:
        assert augmentation.bilinear is not None
        G, b = augmentation.bilinear(q, X[:n], X[n + 2 * p :], u)
        return ca.vertcat(G, ca.SX(size - n, b.shape[0])), b

    def step(q: Params, s: State, u: Any, reading: Reading) -> tuple[State, Estimate]:
        seen = present(reading.y)
        y = ca.if_else(seen, reading.y, 0.0)
        if blind:
            side = seen
        else:
            side = reading.side if jump else sure_side(y, s.last, s.previous, q.gate)
        belief, e, e_std = correct(q, Gaussian(s.mean, symmetric(s.cov, entries)), y, side)
        wait = s.wait
        if bounds:
            belief, wait = use_bounds(
                q, belief, ca.logic_and(seen, ca.fabs(y) <= q.gate), side, wait
            )
        move, Q = motion(model, q, augmentation, belief, u)
        if order == 1:
            after = advance(
                belief, move, Q, None if augmentation.slope is None else augmentation.slope(q)
            )
        else:
            after = predict(
                belief,
                move,
                Q,
                lasting,
                None if augmentation.bilinear is None else partial(bent, q, u),
            )
        told = believed(q, n, augmentation, belief, bounds)
        found = to_estimate(model, sensor, q, told, reading, e, e_std)
        if len(augmentation.cov):
            x, extra = told.mean[:n], told.mean[n + 2 * p :]
            if augmentation.disturbance is None:
                w = q.rate @ (augmentation.move(q, x, extra, s.u)[0] - model.move(q.model, x, s.u))
            else:
                w = augmentation.disturbance(q, extra)
            found = found._replace(w=w)
        if count := len(augmentation.parameters):
            spread = ca.sqrt(ca.fmax(ca.diag(told.cov)[-count:], 0.0))
            found = found._replace(
                theta=q.model[list(augmentation.parameters)] + told.mean[-count:], theta_std=spread
            )
        return State(after.mean, triangle(after.cov, entries), y, s.last, wait, u), found

    return Observer(params, init, step)


def believed(
    q: Params, n: int, augmentation: Augmentation, belief: Gaussian, bounds: bool
) -> Gaussian:
    """The belief that is shown: widths inside their declared ranges, and the mixture of both if some claim may be stronger."""
    limited = partial(in_declared_ranges, q, n) if bounds else lambda belief: (belief, 0.0)
    found, chance = limited(belief)
    if augmentation.alternative is None:
        return found
    small, odds = augmentation.alternative(q, belief)
    small, likelier = limited(small)
    return mix(small, found, 1 / (1 + ca.exp(ca.fmin(chance - likelier - odds, 700.0))))


def in_declared_ranges(q: Params, n: int, belief: Gaussian) -> tuple[Gaussian, Any]:
    """(the belief with the mean that it has if every width lies in its declared range, the log of the chance of that).

    The covariance stays: that of a Gaussian cut where it was matched to a uniform distribution would claim too much.
    """
    found, log = belief, 0.0
    for i in range(q.ranges.shape[0]):
        found, chance = truncate_to(found, n + i, q.ranges[i, 0], q.ranges[i, 1])
        log += chance
    return Gaussian(found.mean, belief.cov), log


def numbers(model: System, sensor: Zone, prior: Prior, augmentation: Augmentation) -> Params:
    """The numbers of a filter that starts from the prior."""
    known = model.n + 2 * model.p
    first = np.zeros((known + len(augmentation.cov),) * 2)
    first[:known, :known], first[known:, known:] = np.diag(prior.std**2), augmentation.cov
    mean = np.concatenate([prior.mean, np.zeros(len(augmentation.cov))])
    return Params(
        model.params, augmentation.params, prior.R, prior.gate, sensor.slope, prior.drift, mean, first[tuple(kept(model, augmentation).get_triplet())],
        prior.ranges, np.linalg.inv(held(model)),
    )  # fmt: skip


def kept(model: System, augmentation: Augmentation) -> ca.Sparsity:
    """The entries of the covariance's upper triangle that a filter keeps."""
    return (
        ca.Sparsity.upper(model.n + 2 * model.p + len(augmentation.cov))
        if augmentation.entries is None
        else augmentation.entries
    )


def motion(
    model: System, q: Params, augmentation: Augmentation, belief: Gaussian, u: Any
) -> tuple[Callable[[Any], Any], Any]:
    """(the motion of [x; d; extra] over a step, the covariance that it adds)."""
    n, known = model.n, model.n + 2 * model.p
    noise_x, noise_extra = augmentation.noise(q, belief.mean[:n], u)

    def move(X: Any) -> Any:
        x, extra = augmentation.move(q, X[:n], X[known:], u)
        return ca.vertcat(x, X[n:known], extra)

    return move, ca.diagcat(noise_x, ca.diag(q.drift), noise_extra)


def to_estimate(
    model: System, sensor: Zone, q: Params, belief: Gaussian, reading: Reading, e: Any, e_std: Any
) -> Estimate:
    """The belief as an `Estimate`; e, e_std: innovations and their standard deviations."""
    mean, cov = belief
    n, p, known = model.n, model.p, model.n + 2 * model.p
    x, right, left = mean[:n], mean[n : n + p], mean[n + p : known]
    variance = ca.diag(cov)
    both = (
        variance[n : n + p] + variance[n + p : known] + 2 * ca.diag(cov[n : n + p, n + p : known])
    )
    std = ca.sqrt(ca.fmax(variance, 0.0))
    found = estimate(x, model.output(q.model, x), right, left, reading, q.slope, sensor.kind, e)
    return found._replace(
        x_std=std[:n], right_std=std[n : n + p], left_std=std[n + p : known], width_std=ca.sqrt(ca.fmax(both, 0.0)), innovation_std=e_std
    )  # fmt: skip


def white(model: System, variance: Floats) -> Augmentation:
    """Nothing unknown beside [x; d], but an input disturbance that is new at every sample, of that variance (m)."""

    def move(q: Params, x: Any, extra: Any, u: Any) -> tuple[Any, Any]:
        return model.move(q.model, x, u), extra

    def noise(q: Params, x: Any, u: Any) -> tuple[Any, Any]:
        _, B = linearise(lambda v: model.move(q.model, x, v), u)
        return B @ ca.diag(q.augmentation) @ B.T, ca.SX(0, 0)

    return Augmentation(variance, np.zeros((0, 0)), move, noise)


def sure_side(y: Any, last: Any, previous: Any, gate: Any) -> Any:
    """The side on which a reading may be taken for z - d_r or z + d_l with noise of mean 0 (p).

    A reading far beyond the gate, or one that the two before it announced: both beyond the gate, their straight line
    too, and y not across 0. To ask only whether y itself is beyond a threshold would select noise of one sign.
    """

    def sure(a: Any, b: Any, c: Any) -> Any:
        announced = ca.logic_and(
            ca.logic_and(b > gate, c > gate), ca.logic_and(2 * b - c > gate, a > 0)
        )
        return ca.logic_or(a > 2 * gate, announced)

    return 1.0 * sure(y, last, previous) - 1.0 * sure(-y, -last, -previous)
