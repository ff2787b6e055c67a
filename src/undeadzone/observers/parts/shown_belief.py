"""What a measured-side filter shows of its belief: widths in their claimed ranges, w, theta."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import casadi as ca

from undeadzone.ends.sensor import Zone
from undeadzone.interfaces import Estimate
from undeadzone.numerics.gaussian import Gaussian, from_upper, truncate_to
from undeadzone.observers.parts.gaussian_filter import Augmentation, Params
from undeadzone.plants.system import System

ROUNDING = 1e-12  # of a variance
FAR = 4.5  # standard deviations beyond its range from which a width refutes its claims


class Setup(NamedTuple):
    """What the parts of one filter share.

    Attributes:
        model: the sampled model.
        sensor: the dead zone.
        augmentation: the unknowns beside [x; d].
        entries: entries of the covariance's upper triangle that are kept.
        bounds: whether it uses what bounds: a silent sensor, and the claimed ranges.
        order: order of the prediction.
        blind: whether it takes every reading for z itself.
        doubts: whether a reading may be wrong.
        careful: whether silence moves widths only as far as readings have told of them.
        centred: whether a centre is claimed, which binds the edges together.
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

    @property
    def apart(self) -> bool:
        """Whether a reading on one edge moves other widths only as far as theirs told of them."""
        return self.careful and self.doubts and self.bounds and self.plain and not self.centred

    @property
    def paced(self) -> bool:
        """Whether readings that leave silence are asked how far z can move."""
        return self.doubts and self.plain

    @property
    def plain(self) -> bool:
        """Whether the sensor is a dead zone alone, neither of the jump kind nor with a play."""
        return not self.jump and not self.sensor.moves

    @property
    def limited(self) -> bool:
        """Whether readings at a limit of their range bound z; of a play they are missing."""
        return self.sensor.limits is not None and not self.sensor.moves

    @property
    def jump(self) -> bool:
        """Whether the sensor is of the jump kind."""
        return self.sensor.kind == "jump"

    @property
    def play(self) -> bool:
        """Whether the sensor is a play, which holds its reading in place of 0."""
        return self.sensor.kind == "play"

    @property
    def both(self) -> bool:
        """Whether a play stands ahead of the dead zone."""
        return self.sensor.play is not None


def shown_belief(setup: Setup, q: Params, belief: Gaussian) -> tuple[Gaussian, Any]:
    """The belief that an estimate shows, and whether its widths may lie in their ranges.

    Its widths lie in their claimed ranges, and it is the mixture of both if some claim may be
    stronger.
    """
    limited, chance = limit_widths(setup, q, belief)
    if setup.augmentation.alternative is not None:
        stronger, odds = setup.augmentation.alternative(q, belief)
        stronger, likelier = limit_widths(setup, q, stronger)
        share = 1 / (1 + ca.exp(ca.fmin(chance - likelier - odds, 700.0)))
        limited = ambiguous(stronger, limited, share)
    if setup.blind:
        return limited, 1.0
    return clipped(setup.model.n, q, limited, setup.doubts)


def ambiguous(stronger: Gaussian, weaker: Gaussian, share: Any) -> Gaussian:
    """The mixture of both beliefs, with deviations whose +-1.96 hold 95 % of it.

    A mixture of a narrow and a wide belief has more in its tails than a Gaussian of its variance.
    If the wide one, of chance b, is much wider, 95 % of the mixture lie within 1.96 deviations of
    variance h^2 of the wide one's, Phi(1.96 h) = 1 - 0.025 / b. h^2 is at most b (2 - b), which is
    taken; a Gaussian would have b.

    Args:
        stronger: the belief if the stronger claim is true.
        weaker: the belief if it is not.
        share: chance of the stronger one.
    """
    narrow, gap = share**2, stronger.mean - weaker.mean
    cov = narrow * stronger.cov + (1 - narrow) * weaker.cov + share * (1 - share) * gap @ gap.T
    return Gaussian(share * stronger.mean + (1 - share) * weaker.mean, from_upper(cov))


def clipped(n: int, q: Params, belief: Gaussian, doubts: bool) -> tuple[Gaussian, Any]:
    """The belief with every width's mean in its claimed range, and whether it may lie there.

    A width `FAR` beyond its range refutes some claim: its variance gains the square of the excess.

    Args:
        n: number of states.
        q: the filter's numbers.
        belief: about [x; d; extra].
        doubts: whether the variance gains anything.
    """
    count = q.ranges.shape[0]
    widths = belief.mean[n : n + count]
    inside = ca.fmax(ca.fmin(widths, q.ranges[:, 1]), q.ranges[:, 0])
    excess = widths - inside
    variances = ca.diag(belief.cov)[n : n + count]
    refuted = excess**2 > FAR**2 * variances
    mean = ca.vertcat(belief.mean[:n], inside, belief.mean[n + count :])
    cov = belief.cov
    if doubts:
        rest = cov.shape[0] - n - count
        gained = ca.diag(ca.if_else(refuted, excess**2, 0.0))
        cov = cov + ca.diagcat(ca.SX(n, n), gained, ca.SX(rest, rest))
    return Gaussian(mean, cov), ca.logic_not(ca.mmax(refuted))


def limit_widths(setup: Setup, q: Params, belief: Gaussian) -> tuple[Gaussian, Any]:
    """`within_ranges` where the filter uses bounds, else the belief as it is, of chance 1."""
    if not setup.bounds:
        return belief, 0.0
    return within_ranges(q, setup.model.n, belief)


def within_ranges(q: Params, n: int, belief: Gaussian) -> tuple[Gaussian, Any]:
    """The belief with the mean that it has if every width lies in its claimed range.

    The covariance stays: that of a Gaussian cut where it was matched to a uniform distribution
    would claim too much. But no width is less known than its range says, however long it drifted.

    Returns:
        (belief, the log of the chance that every width lies in its range).
    """
    cut = belief
    log_chance = 0.0
    for i in range(q.ranges.shape[0]):
        cut, chance = truncate_to(cut, n + i, q.ranges[i, 0], q.ranges[i, 1])
        log_chance += chance
    return Gaussian(cut.mean, _no_wider(q, n, belief.cov)), log_chance


def _no_wider(q: Params, n: int, cov: Any) -> Any:
    """A covariance whose widths deviate by no more than a uniform distribution over their range."""
    count = q.ranges.shape[0]
    most = (1 + ROUNDING) * (q.ranges[:, 1] - q.ranges[:, 0]) ** 2 / 12
    variances = ca.diag(cov)[n : n + count]
    shrunk = ca.if_else(variances > most, ca.sqrt(most / variances), 1.0)
    scale = ca.vertcat(ca.SX.ones(n), shrunk, ca.SX.ones(cov.shape[0] - n - count))
    return cov * (scale @ scale.T)


def with_unknowns(
    setup: Setup, q: Params, estimated: Estimate, shown: Gaussian, u: Any
) -> Estimate:
    """The estimate with w and theta where there are such unknowns; u: the last input."""
    augmentation, model, n = setup.augmentation, setup.model, setup.model.n
    if len(augmentation.cov):
        extra = shown.mean[n + 2 * model.p :]
        if augmentation.disturbance is None:
            x = shown.mean[:n]
            assert model.change is not None
            w = q.rate @ (augmentation.change(q, x, extra, u)[0] - model.change(q.model, x, u))
        else:
            w = augmentation.disturbance(q, extra)
        estimated = estimated._replace(w=w)
    count = len(augmentation.parameters)
    if count:
        theta = q.model[list(augmentation.parameters)] + shown.mean[-count:]
        theta_std = ca.sqrt(ca.fmax(ca.diag(shown.cov)[-count:], 0.0))
        estimated = estimated._replace(theta=theta, theta_std=theta_std)
    return estimated
