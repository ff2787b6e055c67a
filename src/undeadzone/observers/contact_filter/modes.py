"""Contact modes of motors and links with gaps in between, each joint in a mode of three.

A joint touches its right flank (1), runs free in the gap (0) or touches its left flank (-1). Each
combination is an extended Kalman filter of x = [theta; q; theta'; q'; a; c; friction; f; k; w;
payload] with constant contacts, and a probability. Here f is the friction of links, k the log of a
contact's frequency over the model's. A link leaves a flank when the torque through it changes its
sign. It reaches a flank by first passage (`numerics.first_passage`), which measures the gap.
Estimates that enter the same mode are merged by their moments (interacting multiple models, Blom
and Bar-Shalom 1988, with transitions that depend on the state). docs/methods/contact.md derives the
weights.

References:
    H. A. P. Blom, Y. Bar-Shalom (1988), doi:10.1109/9.1299
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.nonlinearities.sensor import present
from undeadzone.numerics.clip import clip
from undeadzone.numerics.first_passage import arrival_shares, chance_beyond, condition_on_edge
from undeadzone.numerics.gaussian import (
    Bound,
    Gaussian,
    from_upper_entries,
    mirror_upper,
    mix_gaussians,
    normal_cdf,
    predict_first_order,
    stack_updates,
    to_upper_entries,
    truncate_at_bounds,
    update_with_outliers,
)
from undeadzone.numerics.runge_kutta import GAMMA, rosenbrock_change
from undeadzone.observers.filtering.multiple_models import mean_of_models, share_step_graph
from undeadzone.util import tree
from undeadzone.util.arrays import Floats

Contacts = Sequence[Any]  # of each joint: 1, 0 or -1, or a symbol of 1 or -1
# Instructions above which a shared graph is called, not inlined, and twice that within one. It
# decides speed alone: with two unknowns a step takes 1.42 times as long at 2,500 and 1.26 times at
# 3,000; at 6,000 a function has more lines than the compiler optimises, and takes 2.3 times.
LONG = 3000
MOTION = ("motor", "link", "motor_speed", "link_speed")
CONSTANTS = ("half", "centre", "friction", "f")  # named as the plant's parameters
QUANTITIES = (*MOTION, *CONSTANTS, "firmness", "push")  # of each joint
WEAR = "wear"  # rate of a half gap, which no plant has
SMALL = 1e-6  # least probability that a link is in its gap
NONE = 1e-12  # probability below which no link enters a mode
LEAST = 1e-7  # probability of a mode below which it is dropped
WIDE = 4.0  # standard deviation above which a free link may be anywhere in the gap [half gaps]
FAR = 3.0  # distance above which the estimate contradicts a flank [standard deviations]
LOST = -1e6  # least log density
AWAY = 1000.0  # difference of log densities above which the worse filter has diverged
MOST = 60.0  # largest difference of log densities of modes
LATE = 0.95  # probability of being beyond a flank above which the estimate is truncated
SURE = 3.0  # distance from a flank above which it does not truncate [standard deviations]
BOUNDED = ("half", "friction", "f", "firmness", "payload")  # quantities with bounds
WALKING = ("half", "centre", "payload")  # random walks with a largest variance
RESTING = 0.1  # speed below which a motor may be at rest, or a link on its flank [rad/s]


class Layout(NamedTuple):
    """Places of the quantities in x, for N joints.

    Attributes:
        size: number of joints N.
        further: names of further constants of each joint that are estimated.
    """

    size: int
    further: tuple[str, ...] = ()

    def slice_of(self, name: str) -> slice:
        """Return the entries of a quantity in x."""
        if name == "payload":
            return slice(self.entry_count - 1, self.entry_count)
        first = self.names.index(name) * self.size
        return slice(first, first + self.size)

    def entries_of(self, names: Sequence[str]) -> list[int]:
        """Return the entries of some quantities in x."""
        return list(np.r_[*map(self.slice_of, names)])

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the quantities of each joint."""
        return (*QUANTITIES, *self.further)

    @property
    def entry_count(self) -> int:
        """Return the number of entries of x."""
        return len(self.names) * self.size + 1

    @property
    def contact_combinations(self) -> list[Contacts]:
        """Return every combination of contacts."""
        return list(itertools.product((1, 0, -1), repeat=self.size))

    def flank_row(self, joint: int, side: int) -> ca.DM:
        """Return the row of side (theta - q + c) - a of a joint (1 x entries)."""
        row = np.zeros((1, self.entry_count))
        for name, sign in (("motor", side), ("link", -side), ("centre", side), ("half", -1)):
            row[0, self.slice_of(name).start + joint] = sign
        return ca.sparsify(ca.DM(row))

    def flank_rows(self, joint: int) -> list[ca.DM]:
        """Return the rows of a joint's right and left flank."""
        return [self.flank_row(joint, side) for side in (1, -1)]


class Drive(NamedTuple):
    """Functions of the plant for the filter; their first argument is `Numbers.model`.

    Attributes:
        layout: places of the quantities in x.
        rate: (model, x, u, contact) -> (x' (entries), torques through the gears (N)), for constant
            contacts.
        implicit: (model, x, contact, g) -> function that returns (I - g A)^-1 times a column
            (entries), with A the part of the Jacobian of `rate` by contacts and friction.
        mobility: (model, x) -> change of [theta'; q'] (2N x N) by a unit impulse from motor to link
            in each joint.
        readings: entry of x that each reading measures (p).
        Ts: sample time [s].
        substeps: integration steps in a sample.
        apart: whether the filter has a part of the joints; the effect of others is noise.
    """

    layout: Layout
    rate: Callable[[Any, Any, Any, Contacts], tuple[Any, Any]]
    implicit: Callable[[Any, Any, Contacts, Any], Callable[[Any], Any]]
    mobility: Callable[[Any, Any], Any]
    readings: tuple[int, ...]
    Ts: float
    substeps: int
    apart: bool


class Numbers(NamedTuple):
    """Parameters of the filter.

    Attributes:
        model: parameters of the plant.
        Q: process noise: variance that x gains in a sample (entries).
        R: variance of a reading (p) [rad^2].
        low, high: bounds of x (entries).
        most: largest variance of a random walk (entries).
        slack: variance of the position of a flank, by its unknown compliance (1) [rad^2].
        torque: standard deviation of the torque through the gears (N) [N m].
        leaving: probability in a sample that a link leaves a flank off which it is pulled [1].
        impact: relative standard deviation of an impulse [1].
        rest: variance that the speed of a motor at rest gains in a sample, over friction^2 (N).
        least: lower bound of the static friction (N) [N m].
    """

    model: Any
    Q: Floats
    R: Floats
    low: Floats
    high: Floats
    most: Floats
    slack: Any
    torque: Floats
    leaving: Any
    impact: Any
    rest: Floats
    least: Floats


class Modes(NamedTuple):
    """State of the filter: a probability and a Gaussian for each mode.

    Attributes:
        chances: probabilities of the modes (K), of sum 1.
        means: means of x in each mode (K of (entries)).
        covs: upper triangles of the covariances of x (K).
        begun: 1 once a sample without missing readings was read, else 0 (1).
    """

    chances: Any
    means: tuple[Any, ...]
    covs: tuple[Any, ...]
    begun: Any


class Posterior(NamedTuple):
    """Posterior of the modes after the readings of a sample.

    Attributes:
        chances: probabilities of the modes (K).
        beliefs: Gaussians of x in each mode (K).
        whole: Gaussian of x over all modes, by moments.
        news: change of its mean by the readings (entries).
        e, std: innovations and their standard deviations, over all modes (p).
        log: log predictive density of the readings.
    """

    chances: tuple[Any, ...]
    beliefs: tuple[Gaussian, ...]
    whole: Gaussian
    news: Any
    e: Any
    std: Any
    log: Any = 0.0


def start_modes(layout: Layout, mean: Floats, std: Floats, slack: float) -> Modes:
    """Return the modes before the first reading, each link on the flank of its mode.

    All are NumPy arrays.

    Args:
        layout: places of the quantities.
        mean, std: mean and standard deviation of x about the first reading, whatever the contacts
            (entries).
        slack: variance of the position of a flank [rad^2].
    """
    entries = ca.Sparsity.upper(layout.entry_count)
    means = []
    covs = []
    for mode in layout.contact_combinations:
        belief = Gaussian(ca.SX(mean), ca.SX(ca.diag(std**2)))
        for joint, side in enumerate(mode):
            if side:
                h = layout.flank_row(joint, side)
                belief = condition_on_edge(belief, h, h @ belief.mean, slack)
        means.append(np.asarray(ca.evalf(belief.mean)).ravel())
        covs.append(np.asarray(ca.evalf(to_upper_entries(belief.cov, entries))).ravel())
    return Modes(np.full(len(means), 1 / len(means)), tuple(means), tuple(covs), np.zeros(1))


def _mode_gaussians(drive: Drive, s: Modes, y: Any) -> list[Gaussian]:
    """Return the Gaussian of each mode (K).

    The first sample without missing readings sets the angles of motors and links.

    Args:
        drive: functions of the plant.
        s: state of the filter.
        y: readings (p), NaN if missing.
    """
    layout = drive.layout
    N = drive.layout.size
    whole = ca.mmin(present(y))
    entries = ca.Sparsity.upper(layout.entry_count)
    angle = ca.if_else(ca.logic_and(s.begun < 0.5, whole), y[:N], 0.0)
    shift = ca.vertcat(angle, angle, ca.SX.zeros(layout.entry_count - 2 * N))
    beliefs = []
    for mean, cov in zip(s.means, s.covs, strict=True):
        beliefs.append(Gaussian(mean + shift, from_upper_entries(cov, entries)))
    return beliefs


def correct_modes(drive: Drive, q: Numbers, s: Modes, y: Any) -> Posterior:
    """Return the posterior of the modes after the readings of a sample.

    The probabilities follow from Bayes' rule, by logarithms against underflow. A mode that becomes
    improbable is dropped, and has the mixture of the others as its Gaussian.

    Args:
        drive: functions of the plant.
        q: parameters of the filter.
        s: state of the filter.
        y: readings (p), NaN if missing.
    """
    beliefs = _mode_gaussians(drive, s, y)
    modes = []
    for contact, belief in zip(drive.layout.contact_combinations, beliefs, strict=True):
        modes.append(_correct_mode(drive, q, contact, belief, y))
    prior = ca.vertsplit(s.chances)
    possible = [ca.if_else(w > 0, mode.log, -1e300) for w, mode in zip(prior, modes, strict=True)]
    best = ca.mmax(ca.vertcat(*possible))
    logs = [ca.fmax(mode.log - best, -MOST) for mode in modes]
    joint = [w * ca.exp(log) for w, log in zip(prior, logs, strict=True)]
    weights = normalise_weights(joint)
    log = best + ca.log(ca.fmax(sum(joint), 1e-300))
    log = ca.if_else(log > LOST, log, LOST)  # this comparison replaces NaN, too
    shares = normalise_weights([ca.if_else(weight < LEAST, 0.0, weight) for weight in weights])
    whole = mix_gaussians(shares, [mode.belief for mode in modes])
    posterior = []
    for share, mode in zip(shares, modes, strict=True):
        posterior.append(select_gaussian(share > 0, mode.belief, whole))
    news = whole.mean - mean_of_models(prior, [belief.mean for belief in beliefs])
    return Posterior(
        tuple(shares), tuple(posterior), whole, news, *mixture_innovation(prior, modes), log
    )


def mixture_innovation(
    shares: Sequence[Any], modes: Sequence[Posterior | CorrectedMode]
) -> tuple[Any, Any]:
    """Return the innovation of a mixture and its standard deviation (p each).

    Args:
        shares: weights of the components (K).
        modes: components, with their innovations and standard deviations (K).
    """
    e = mean_of_models(shares, [mode.e for mode in modes])
    variances = [mode.std**2 + (mode.e - e) ** 2 for mode in modes]
    return e, ca.sqrt(mean_of_models(shares, variances))


class CorrectedMode(NamedTuple):
    """Mode after the readings of a sample.

    Attributes:
        belief: Gaussian of x.
        log: log predictive density of the readings, up to a constant.
        e, std: innovations and their standard deviations (p).
    """

    belief: Gaussian
    log: Any
    e: Any
    std: Any


def _correct_mode(
    drive: Drive, q: Numbers, contact: Contacts, predicted: Gaussian, y: Any
) -> CorrectedMode:
    """Return a mode after the readings, with the mean of x within its bounds.

    The readings are independent, so the Kalman update takes one after the other.

    Args:
        drive: functions of the plant.
        q: parameters of the filter.
        contact: contacts of the mode (N).
        predicted: Gaussian of x before the readings.
        y: readings (p), NaN if missing.
    """
    belief = predicted
    log = ca.SX(0.0)
    updates = []
    for row, entry in enumerate(drive.readings):
        is_present = present(y[row])
        h = ca.DM(1, drive.layout.entry_count)
        h[0, entry] = 1
        e = ca.if_else(is_present, y[row] - belief.mean[entry], 0.0)
        update = update_with_outliers(belief, h, e, q.R[row], is_present, None, 0.0)
        belief = update.belief
        log += ca.if_else(is_present, -((e / update.std) ** 2) / 2 - ca.log(update.std), 0.0)
        updates.append(update)
    # Free links are between their flanks. Readings that make this more probable support the mode.
    for gaussian, sign in ((belief, 1), (predicted, -1)):
        log += sign * _log_gap_probability(drive.layout, contact, gaussian, q.slack)
    columns = stack_updates(updates)
    return CorrectedMode(_project_to_bounds(drive.layout, q, belief), log, columns.e, columns.std)


def _project_to_bounds(layout: Layout, q: Numbers, belief: Gaussian) -> Gaussian:
    """Return the Gaussian with the most probable mean within the bounds of x.

    The other entries move with the bounded one, as their covariance has it. If they did not,
    readings that ask for a softer contact than its bound would move the link instead, ever farther
    into its flank.

    References:
        B. O. S. Teixeira and others (2009), doi:10.1080/00207170802370033

    Args:
        layout: places of the quantities in x.
        q: parameters of the filter.
        belief: Gaussian of x.
    """
    mean, cov = belief
    for entry in layout.entries_of((*BOUNDED, *layout.further)):
        beyond = mean[entry] - clip(mean[entry], q.low[entry], q.high[entry])
        mean -= beyond / ca.fmax(cov[entry, entry], NONE) * cov[:, entry]
    # Each move may take an entry past a bound again, and a known one has no variance to move by.
    return Gaussian(clip(mean, q.low, q.high), cov)


def _log_gap_probability(layout: Layout, contact: Contacts, belief: Gaussian, slack: Any) -> Any:
    """Return the log probability that the free links of a mode are between their flanks.

    Args:
        layout: places of the quantities in x.
        contact: contacts of the mode (N).
        belief: Gaussian of x, not truncated at the flanks.
        slack: variance of the position of a flank [rad^2].
    """
    log = ca.SX(0.0)
    for joint, side in enumerate(contact):
        if side == 0:
            outside = sum(_flank_probabilities(layout, joint, belief, slack))
            log += ca.log(ca.fmax(1 - outside, SMALL))
    return log


def _flank_probabilities(layout: Layout, joint: int, belief: Gaussian, slack: Any) -> list[Any]:
    """Return the probabilities that a link is beyond its right and left flank [1].

    The Gaussian is not truncated.
    """
    return [chance_beyond(belief, h, h @ belief.mean, slack) for h in layout.flank_rows(joint)]


def select_gaussian(use: Any, one: Gaussian, other: Gaussian) -> Gaussian:
    """Return the first of two Gaussians if a condition holds, or the second if not."""
    return Gaussian(
        ca.if_else(use, one.mean, other.mean), mirror_upper(ca.if_else(use, one.cov, other.cov))
    )


def normalise_weights(weights: list[Any]) -> list[Any]:
    """Return the weights (K) divided by their sum."""
    total = ca.fmax(sum(weights), 1e-300)
    return [weight / total for weight in weights]


def replace_diverged(posteriors: Sequence[Posterior]) -> list[Posterior]:
    """Return the posteriors of K filters, with those that diverged replaced by the most likely.

    Args:
        posteriors: posteriors of the filters (K).
    """
    best = posteriors[0]
    for posterior in posteriors[1:]:
        best = _select_posterior(posterior.log > best.log, posterior, best)
    return [
        _select_posterior(posterior.log < best.log - AWAY, best, posterior)
        for posterior in posteriors
    ]


def _select_posterior(use: Any, one: Posterior, other: Posterior) -> Posterior:
    """Return the first of two posteriors if a condition holds, or the second if not."""
    pairs = zip(tree.iterate_leaves(one), tree.iterate_leaves(other), strict=True)
    chosen: Posterior = tree.rebuild_tree(one, (ca.if_else(use, a, b) for (_, a), (_, b) in pairs))
    return chosen


class Mode(NamedTuple):
    """Mode between two samples.

    Attributes:
        chance: probability of the mode.
        belief: Gaussian of x.
    """

    chance: Any
    belief: Gaussian


def predict_modes(drive: Drive, q: Numbers, posterior: Posterior, u: Any) -> tuple[Mode, ...]:
    """Return the modes at the next sample: links leave flanks, all move, links reach flanks.

    Args:
        drive: functions of the plant.
        q: parameters of the filter.
        posterior: modes after the readings.
        u: torque of the motors (N) [N m].
    """
    contacts = drive.layout.contact_combinations
    modes = list(itertools.starmap(Mode, zip(posterior.chances, posterior.beliefs, strict=True)))
    leaving = [
        _leaving_probabilities(drive, q, contact, mode, u)
        for contact, mode in zip(contacts, modes, strict=True)
    ]
    before = modes
    for joint in range(drive.layout.size):
        modes, leaving = _leave_flanks(drive, q, joint, modes, leaving)
    modes = _keep_half(drive.layout, before, modes)
    moved = before = _move_modes(drive, q, modes, u)
    arrivals = [
        _arrival_shares(drive.layout, q.slack, contact, start, end)
        for contact, start, end in zip(contacts, modes, moved, strict=True)
    ]
    for joint in range(drive.layout.size):
        moved, arrivals = _reach_flanks(drive, q, joint, moved, arrivals)
    return tuple(_keep_half(drive.layout, before, moved))


def _keep_half(layout: Layout, before: Sequence[Mode], after: Sequence[Mode]) -> list[Mode]:
    """Return the modes after links have come and gone, with the mean of the half gaps as before.

    Without a reading nothing is learnt: by the law of total expectation the mean of a half gap over
    all modes stays. Gaussians that are truncated, or merged at a flank, have it only nearly, and
    what they miss adds up from sample to sample. The rest of x moves as the covariance has it.

    Args:
        layout: places of the quantities in x.
        before, after: the modes.
    """
    half = layout.slice_of("half")
    means = [
        sum(mode.chance * mode.belief.mean[half] for mode in modes) for modes in (before, after)
    ]
    kept = []
    for chance, (mean, cov) in after:
        variances = cov[half, half] + NONE * ca.DM.eye(layout.size)
        shift = cov[:, half] @ ca.solve(variances, means[0] - means[1])
        kept.append(Mode(chance, Gaussian(mean + shift, cov)))
    return kept


def _sample_motion(drive: Drive, q: Numbers, contact: Contacts, u: Any) -> Callable[[Any], Any]:
    """Return the change of x over a sample as a function, with the contacts unchanged."""
    h = drive.Ts / drive.substeps

    def change(x: Any) -> Any:
        """Return the change of x over a sample (entries)."""
        total = ca.SX.zeros(drive.layout.entry_count)
        for _ in range(drive.substeps):
            now = x + total
            solve = drive.implicit(q.model, now, contact, GAMMA * h)
            total += rosenbrock_change(
                lambda z: drive.rate(q.model, z, u, contact)[0], solve, now, h
            )
        return total

    return change


def _leaving_probabilities(drive: Drive, q: Numbers, contact: Contacts, mode: Mode, u: Any) -> Any:
    """Return the probability that each link leaves its flank in the sample (N) [1].

    A link leaves if the torque through the gears pulls it off its flank in the middle of the
    sample. It counts as free for the whole sample: if it were freed at the end, each crossing of
    the gap would be late.

    Args:
        drive: functions of the plant.
        q: parameters of the filter.
        contact: contacts of the mode (N).
        mode: the mode.
        u: torque of the motors (N) [N m].
    """
    x = mode.belief.mean
    end = x + _sample_motion(drive, q, contact, u)(x)
    before, after = (drive.rate(q.model, each, u, contact)[1] for each in (x, end))
    pull = -ca.DM(contact) * (before + after) / 2  # mean torque away from the flank [N m]
    # P(pull > 0) of a Gaussian torque with standard deviation q.torque.
    return q.leaving * normal_cdf(pull / q.torque)


def _flank_places(layout: Layout, joint: int) -> list[dict[int, int]]:
    """Return the modes of a joint's right flank, gap and left flank, as indices by contact.

    There is an entry for each combination of the contacts of other joints.
    """
    contacts = layout.contact_combinations
    free = [contact for contact in contacts if contact[joint] == 0]
    return [
        {side: contacts.index((*before[:joint], side, *before[joint + 1 :])) for side in (1, 0, -1)}
        for before in free
    ]


def _leave_flanks(
    drive: Drive, q: Numbers, joint: int, modes: list[Mode], leaving: list[Any]
) -> tuple[list[Mode], list[Any]]:
    """Return modes and leaving probabilities after a joint has left its flanks.

    Args:
        drive: functions of the plant.
        q: parameters of the filter.
        joint: the joint.
        modes: modes before (K).
        leaving: probability that each joint leaves its flank, by mode (K of (N)).
    """
    after = list(modes)
    probabilities = list(leaving)
    for places in _flank_places(drive.layout, joint):
        gap = places[0]
        arriving = []
        arriving_leave = []
        for side in (1, -1):
            flank = modes[places[side]]
            share = leaving[places[side]][joint]
            after[places[side]] = flank._replace(chance=flank.chance * (1 - share))
            arriving.append(flank._replace(chance=flank.chance * share))
            arriving_leave.append(leaving[places[side]])
        arriving_chance = sum(mode.chance for mode in arriving)
        parts = [*_separate_gap_mode(drive, q, joint, modes[gap], arriving_chance), *arriving]
        after[gap], weights = _merge_modes(parts)
        probabilities[gap] = mean_of_models(weights, [leaving[gap], leaving[gap], *arriving_leave])
    return after, probabilities


def _separate_gap_mode(
    drive: Drive, q: Numbers, joint: int, gap: Mode, arriving: Any
) -> list[Mode]:
    """Return the mode of a free joint in two parts, untruncated and truncated to the gap.

    First passage is computed from an untruncated Gaussian. Yet a link that has not reached a flank
    is in its gap. A part that arrives in the mode must not be merged with a Gaussian that has left
    the gap long ago. So the truncated part has the share of the arriving probability, or all if
    hardly any of the untruncated Gaussian is in the gap.

    Args:
        drive: functions of the plant.
        q: parameters of the filter.
        joint: the joint.
        gap: the mode.
        arriving: probability that arrives in the mode.
    """
    belief = gap.belief
    bounds = [Bound(h, h @ belief.mean, 1.0) for h in drive.layout.flank_rows(joint)]
    inside = truncate_at_bounds(belief, bounds, q.slack, SURE).belief
    late = sum(_flank_probabilities(drive.layout, joint, belief, q.slack)) > LATE
    share = ca.if_else(late, 1.0, arriving / ca.fmax(gap.chance + arriving, NONE))
    return [gap._replace(chance=gap.chance * (1 - share)), Mode(gap.chance * share, inside)]


def _move_modes(drive: Drive, q: Numbers, before: Sequence[Mode], u: Any) -> list[Mode]:
    """Return the modes (K) at the next sample, with constant contacts.

    Modes in which the same joints are in contact share a graph, in which the flank is a symbol.
    """
    after: dict[int, Mode] = {}
    modes = drive.layout.contact_combinations
    for free in dict.fromkeys(tuple(side == 0 for side in mode) for mode in modes):
        alike = [k for k, mode in enumerate(modes) if tuple(side == 0 for side in mode) == free]

        def move(sides: Any, q: Numbers, one: Mode, u: Any, free: Any = free) -> Mode:
            """Return a mode at the next sample."""
            flanks = zip(ca.vertsplit(sides), free, strict=True)
            contact = [side * (1 - is_free) for side, is_free in flanks]
            return _move_mode(drive, q, contact, one, u)

        calls = [(ca.SX(ca.DM(modes[k])), q, before[k], u) for k in alike]
        after |= zip(alike, share_step_graph(move, calls, 2 * LONG), strict=True)
    return [after[k] for k in range(len(modes))]


def _move_mode(drive: Drive, q: Numbers, contact: Contacts, mode: Mode, u: Any) -> Mode:
    """Return a mode at the next sample, with constant contacts.

    It is the prediction of an extended Kalman filter. Static friction of a motor at rest balances
    an unknown torque, which its process noise models.

    Args:
        drive: functions of the plant.
        q: parameters of the filter.
        contact: contacts of the mode (N), numbers or symbols.
        mode: the mode.
        u: torque of the motors (N) [N m].
    """
    layout = drive.layout
    (mean, cov) = mode.belief
    Q = ca.SX(q.Q)
    motors = layout.slice_of("motor_speed")
    friction = ca.fmax(mean[layout.slice_of("friction")], q.least)
    Q[motors] += q.rest * friction**2 * _rest_weight(mean[motors])
    walking = layout.entries_of(WALKING)
    # A random walk slows down as its variance approaches the largest one.
    Q[walking] *= ca.fmax(1 - ca.diag(cov)[walking] / q.most[walking], 0.0)
    motion = _sample_motion(drive, q, contact, u)
    return Mode(mode.chance, predict_first_order(mode.belief, motion, ca.diag(Q)))


def _arrival_shares(layout: Layout, slack: Any, contact: Contacts, start: Mode, end: Mode) -> Any:
    """Return the probabilities that links reach the right and the left flank (N x 2) [1].

    Args:
        layout: places of the quantities in x.
        slack: variance of the position of a flank [rad^2].
        contact: contacts of the mode (N).
        start, end: the mode at the start and at the end of the sample.
    """
    shares = ca.SX.zeros(layout.size, 2)
    for joint in range(layout.size):
        if contact[joint] == 0:
            before, now = (
                _flank_probabilities(layout, joint, mode.belief, slack) for mode in (start, end)
            )
            across = layout.flank_row(joint, 1)
            # A Gaussian much wider than the gap has no information on the position inside it.
            widest = WIDE * end.belief.mean[layout.slice_of("half")][joint]
            is_vague = across @ end.belief.cov @ across.T > widest**2 + slack
            shares[joint, :] = ca.horzcat(*arrival_shares(before, now, is_vague))
    return shares


def _reach_flanks(
    drive: Drive, q: Numbers, joint: int, modes: list[Mode], arrivals: list[Any]
) -> tuple[list[Mode], list[Any]]:
    """Return modes and arrival probabilities after a joint has reached its flanks.

    Args:
        drive: functions of the plant.
        q: parameters of the filter.
        joint: the joint.
        modes: modes before (K).
        arrivals: probabilities to reach the right and left flank, by mode (K of (N x 2)).
    """
    after = list(modes)
    shares = list(arrivals)
    for places in _flank_places(drive.layout, joint):
        gap = modes[places[0]]
        share = arrivals[places[0]][joint, :]
        after[places[0]] = gap._replace(chance=gap.chance * (1 - ca.sum2(share)))
        for side, arrived in zip((1, -1), ca.horzsplit(share), strict=True):
            place = places[side]
            new = Mode(gap.chance * arrived, condition_on_impact(drive, q, joint, side, gap.belief))
            after[place], (old_share, new_share) = _merge_modes([modes[place], new])
            shares[place] = old_share * arrivals[place] + new_share * arrivals[places[0]]
    return after, shares


def _merge_modes(parts: list[Mode]) -> tuple[Mode, list[Any]]:
    """Return the mode merged from K parts by their moments, and the share of each part (K).

    If all parts are improbable, the first one has the share 1.
    """
    total = sum(part.chance for part in parts)
    empty = total < NONE
    shares = [ca.if_else(empty, 0.0, part.chance / ca.fmax(total, NONE)) for part in parts]
    shares[0] = ca.if_else(empty, 1.0, shares[0])
    return Mode(total, mix_gaussians(shares, [part.belief for part in parts])), shares


def condition_on_impact(
    drive: Drive, q: Numbers, joint: int, side: int, belief: Gaussian
) -> Gaussian:
    """Return the Gaussian of a link that has just struck a flank.

    On average it did so half a sample ago. Since then motor and link have moved with the speeds
    after the impulse between them. The impulse is uncertain, since restitution is unknown.

    If joints are filtered separately, the gap is not updated by impacts at low speed: a link that
    rests on a flank leaves it and returns by effects that are not modelled, as if its gap were 0.

    Args:
        drive: functions of the plant.
        q: parameters of the filter.
        joint: the joint.
        side: the flank, +1 right or -1 left.
        belief: Gaussian of x before.
    """
    layout = drive.layout
    x = belief.mean
    motor = layout.slice_of("motor_speed").start + joint
    link = layout.slice_of("link_speed").start + joint
    late = ca.DM(1, layout.entry_count)
    late[0, motor] = -side * drive.Ts / 2
    late[0, link] = side * drive.Ts / 2
    # The flank was reached at [flank row + late] x = 0: now less half a sample of relative motion.
    row = layout.flank_row(joint, side) + late
    excess = row @ x
    contradiction = ca.fmax(
        ca.fabs(excess) - FAR * ca.sqrt(ca.fmax(row @ belief.cov @ row.T, 0.0)), 0.0
    )
    moved = ca.SX.ones(layout.entry_count) if drive.apart else None
    if moved is not None:
        moved[layout.slice_of("half").start + joint] = 1 - _rest_weight(x[motor] - x[link])
    at = condition_on_edge(
        belief, row, excess, q.slack + (late @ x) ** 2 / 3 + contradiction**2, moved
    )
    direction = drive.mobility(q.model, at.mean)[:, joint]
    N = layout.size
    # Change of the speeds by the impulse that reduces theta' - q' by a unit.
    unit = direction / (direction[N + joint] - direction[joint])
    b = ca.vertcat(ca.SX.zeros(2 * N), unit, ca.SX.zeros(layout.entry_count - 4 * N))
    closing = at.cov[motor, motor] + at.cov[link, link] - 2 * at.cov[motor, link]
    impulse = q.impact**2 * ((at.mean[motor] - at.mean[link]) ** 2 + closing)
    since = ca.vertcat(unit * (-late @ at.mean) * side, ca.SX.zeros(layout.entry_count - 2 * N))
    return Gaussian(at.mean + since, mirror_upper(at.cov + (impulse * b) @ b.T))


def _rest_weight(speed: Any) -> Any:
    """Return a weight that is 1 at rest and 0 far above RESTING, for a speed [rad/s]."""
    return ca.exp(-((speed / RESTING) ** 2))


def pack_modes(drive: Drive, moved: Sequence[Mode], s: Modes, y: Any) -> Modes:
    """Return the state at the next sample, unchanged until a sample has no missing readings.

    Args:
        drive: functions of the plant.
        moved: modes at the next sample (K).
        s: state before.
        y: readings (p), NaN if missing.
    """
    entries = ca.Sparsity.upper(drive.layout.entry_count)
    begun = ca.fmax(s.begun, ca.mmin(present(y)))

    def select(new: Any, old: Any) -> Any:
        """Return the new value once the filter has begun, else the old value."""
        return ca.if_else(begun > 0.5, new, old)

    chances = ca.vertcat(*normalise_weights([mode.chance for mode in moved]))
    means = map(select, [mode.belief.mean for mode in moved], s.means)
    covs = map(select, [to_upper_entries(mode.belief.cov, entries) for mode in moved], s.covs)
    return Modes(select(chances, s.chances), tuple(means), tuple(covs), begun)
