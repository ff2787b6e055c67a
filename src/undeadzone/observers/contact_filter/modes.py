"""Contact modes of motors and links with gaps in between, each joint in a mode of three.

A joint touches its right flank (1), runs free in the gap (0) or touches its left flank (-1). Each
combination is an extended Kalman filter of x = [theta; q; theta'; q'; a; c; friction; f; k; w;
payload] with the contacts held, f the friction of links, k the log of a contact's frequency over
the model's, and a chance. A link leaves a flank when the torque through it changes its sign; it
reaches one by first passage (`numerics.first_passage`), and then the gap is measured. Estimates
that meet in a mode are merged by their moments (interacting multiple models, Blom and Bar-Shalom
1988, with changes that hang on the state). docs/methods/contact.md derives the weights.

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
LONG = 4000  # instructions of a shared graph from which on calls of it stay calls
MOTION = ("motor", "link", "motor_speed", "link_speed")
CONSTANTS = ("half", "centre", "friction", "f")  # named as the plant's parameters
QUANTITIES = (*MOTION, *CONSTANTS, "firmness", "push")  # of each joint
SMALL = 1e-6  # least chance that a link is in its gap
NONE = 1e-12  # chance below which nothing comes to a mode
LEAST = 1e-7  # chance of a mode below which it is dropped
WIDE = 4.0  # half gaps of deviation beyond which a free link may be anywhere in the gap
FAR = 3.0  # deviations beyond which a belief off an edge says little of it
LOST = -1e6  # log of a density that is as good as none
AWAY = 1000.0  # by which the log of a density is less where a filter ran away
MOST = 60.0  # largest difference of logs of chances
LATE = 0.95  # chance under the uncut belief of being beyond a flank, from which it is cut
SURE = 3.0  # deviations from a flank beyond which it cuts nothing
WALKING = ("half", "centre", "payload")  # what changes slowly, up to a largest deviation
RESTING = 0.1  # speed below which a motor may be at rest, or a link on its flank [rad/s]


class Layout(NamedTuple):
    """Places of the quantities in x, for N joints.

    Attributes:
        size: number of joints N.
    """

    size: int

    def slice_of(self, name: str) -> slice:
        """Return the entries of a quantity in x."""
        if name == "payload":
            return slice(self.entry_count - 1, self.entry_count)
        first = QUANTITIES.index(name) * self.size
        return slice(first, first + self.size)

    @property
    def entry_count(self) -> int:
        """Return the number of entries of x."""
        return len(QUANTITIES) * self.size + 1

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
    """Functions of the plant for the filter; the first argument is `Numbers.model`.

    Attributes:
        layout: places of the quantities.
        rate: (numbers, x, u, contact) -> (x' (entries), torques through the gears (N)), contacts
            locked.
        implicit: (numbers, x, contact, g) -> function that returns (I - g A)^-1 times a column
            (entries), with A the part of the Jacobian of `rate` that contacts and friction make.
        mobility: (numbers, x) -> change of [theta'; q'] (2N x N) by a unit impulse between motor
            and link of each joint, which takes from the motor.
        readings: entry of x that each reading gives (p).
        Ts: sample time [s].
        substeps: steps of integration in a sample.
        apart: whether it is one joint of several, whose effects on its link count as noise.
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
        model: those of the plant.
        Q: variance that x gains in a step (entries).
        R: variance of a reading (p).
        low, high: between which x is known to lie (entries).
        most: largest variance to which x drifts (entries).
        slack: variance of the place of a flank: its compliance is not known (1) [rad^2].
        torque: deviation of the torque through the gears (N) [N m].
        leaving: chance per sample that a link leaves a flank which pulls.
        impact: share by which an impulse is off.
        rest: variance that the speed of a motor at rest gains in a step, over f^2 (N).
        least: friction that static friction has at least (N) [N m].
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
        chances: of the modes (K); their sum is 1.
        means: of x in each mode (K of (entries)).
        covs: upper triangles of the covariances.
        begun: 1 once a whole sample was read (1).
    """

    chances: Any
    means: tuple[Any, ...]
    covs: tuple[Any, ...]
    begun: Any


class Posterior(NamedTuple):
    """Posterior of the modes after the readings of a sample.

    Attributes:
        chances: of the modes (K).
        beliefs: about x in each mode.
        whole: the belief about x over all modes.
        news: by how much the readings moved its mean (entries).
        e, std: innovations and their deviations, over all modes (p).
        log: log of how well the modes foretold the readings.
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
        mean, std: of x about the first reading, contacts unknown (entries).
        slack: variance of the place of a flank [rad^2].
    """
    entries = ca.Sparsity.upper(layout.entry_count)
    means, covs = [], []
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
    """Return the Gaussian of each mode. The first whole sample sets the angles.

    Args:
        drive: the plant.
        s: the state.
        y: readings (p).
    """
    layout, N, whole = drive.layout, drive.layout.size, ca.mmin(present(y))
    entries = ca.Sparsity.upper(layout.entry_count)
    angle = ca.if_else(ca.logic_and(s.begun < 0.5, whole), y[:N], 0.0)
    shift = ca.vertcat(angle, angle, ca.SX.zeros(layout.entry_count - 2 * N))
    beliefs = []
    for mean, cov in zip(s.means, s.covs, strict=True):
        beliefs.append(Gaussian(mean + shift, from_upper_entries(cov, entries)))
    return beliefs


def correct_modes(drive: Drive, q: Numbers, s: Modes, y: Any) -> Posterior:
    """Return the modes after the readings of a sample. A reading that is no number is missing."""
    beliefs, each = _mode_gaussians(drive, s, y), []
    for contact, belief in zip(drive.layout.contact_combinations, beliefs, strict=True):
        each.append(_correct_mode(drive, q, contact, belief, y))
    before = ca.vertsplit(s.chances)
    alive = [ca.if_else(w > 0, one.log, -1e300) for w, one in zip(before, each, strict=True)]
    best = ca.mmax(ca.vertcat(*alive))
    logs = [ca.fmax(one.log - best, -MOST) for one in each]
    likely = [w * ca.exp(log) for w, log in zip(before, logs, strict=True)]
    weights, log = normalise_weights(likely), best + ca.log(ca.fmax(sum(likely), 1e-300))
    log = ca.if_else(log > LOST, log, LOST)  # also of a filter that overflows
    shares = normalise_weights([ca.if_else(weight < LEAST, 0.0, weight) for weight in weights])
    whole = mix_gaussians(shares, [one.belief for one in each])
    kept = []
    for share, one in zip(shares, each, strict=True):
        kept.append(select_gaussian(share > 0, one.belief, whole))
    news = whole.mean - mean_of_models(before, [belief.mean for belief in beliefs])
    return Posterior(
        tuple(shares), tuple(kept), whole, news, *mixture_innovation(before, each), log
    )


def mixture_innovation(
    shares: Sequence[Any], each: Sequence[Posterior | CorrectedMode]
) -> tuple[Any, Any]:
    """Return the innovation of a mixture and its standard deviation (p each), by weights (K)."""
    e = mean_of_models(shares, [one.e for one in each])
    variances = [one.std**2 + (one.e - e) ** 2 for one in each]
    return e, ca.sqrt(mean_of_models(shares, variances))


class CorrectedMode(NamedTuple):
    """Mode after the readings of a sample.

    Attributes:
        belief: about x.
        log: log of how well it foretold them.
        e, std: innovations and their deviations (p).
    """

    belief: Gaussian
    log: Any
    e: Any
    std: Any


def _correct_mode(
    drive: Drive, q: Numbers, contact: Contacts, foretold: Gaussian, y: Any
) -> CorrectedMode:
    """Return a mode after the readings, with its entries within their bounds."""
    belief, log, readings = foretold, ca.SX(0.0), []
    for row, entry in enumerate(drive.readings):
        seen = present(y[row])
        h = ca.DM(1, drive.layout.entry_count)
        h[0, entry] = 1
        e = ca.if_else(seen, y[row] - belief.mean[entry], 0.0)
        told = update_with_outliers(belief, h, e, q.R[row], seen, None, 0.0)
        belief = told.belief
        log += ca.if_else(seen, -((e / told.std) ** 2) / 2 - ca.log(told.std), 0.0)
        readings.append(told)
    for one, sign in ((belief, 1), (foretold, -1)):
        log += sign * _log_gap_probability(drive.layout, contact, one, q.slack)
    bounded = Gaussian(ca.fmax(ca.fmin(belief.mean, q.high), q.low), belief.cov)
    columns = stack_updates(readings)
    return CorrectedMode(bounded, log, columns.e, columns.std)


def _log_gap_probability(layout: Layout, contact: Contacts, belief: Gaussian, slack: Any) -> Any:
    """Return the log probability that the links in their gaps are between their flanks.

    By as much as readings raise it, they speak for a mode whose belief is uncut.
    """
    log = ca.SX(0.0)
    for joint, side in enumerate(contact):
        if side == 0:
            out = sum(_flank_probabilities(layout, joint, belief, slack))
            log += ca.log(ca.fmax(1 - out, SMALL))
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
    """Return the weights divided by their sum."""
    total = ca.fmax(sum(weights), 1e-300)
    return [weight / total for weight in weights]


def replace_diverged(told: Sequence[Posterior]) -> list[Posterior]:
    """Return the filters of a joint, with a diverged filter replaced by the most likely.

    Args:
        told: of each filter (K).
    """
    best = told[0]
    for one in told[1:]:
        best = _select_posterior(one.log > best.log, one, best)
    return [_select_posterior(one.log < best.log - AWAY, best, one) for one in told]


def _select_posterior(use: Any, one: Posterior, other: Posterior) -> Posterior:
    """Return the first of two posteriors if a condition holds, or the second if not."""
    pairs = zip(tree.iterate_leaves(one), tree.iterate_leaves(other), strict=True)
    chosen: Posterior = tree.rebuild_tree(one, (ca.if_else(use, a, b) for (_, a), (_, b) in pairs))
    return chosen


class Mode(NamedTuple):
    """Mode between two samples.

    Attributes:
        chance: of the mode.
        belief: about x.
    """

    chance: Any
    belief: Gaussian


def predict_modes(drive: Drive, q: Numbers, told: Posterior, u: Any) -> tuple[Mode, ...]:
    """Return the modes a sample later: links leave flanks, all move, links reach flanks.

    Args:
        drive: the plant.
        q: the numbers.
        told: the modes after the readings.
        u: torque of the motors (N).
    """
    modes = drive.layout.contact_combinations
    now = [Mode(*each) for each in zip(told.chances, told.beliefs, strict=True)]
    signs = [
        _leaving_probabilities(drive, q, mode, one, u) for mode, one in zip(modes, now, strict=True)
    ]
    for joint in range(drive.layout.size):
        now, signs = _leave_flanks(drive, q, joint, now, signs)
    after = _move_modes(drive, q, now, u)
    each = zip(modes, now, after, strict=True)
    arrivals = [_arrival_shares(drive.layout, q.slack, *ways) for ways in each]
    for joint in range(drive.layout.size):
        after, arrivals = _reach_flanks(drive, q, joint, after, arrivals)
    return tuple(after)


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
    """Return the places of a joint's right flank, gap and left flank among the modes.

    Each entry is for a combination of the remaining joints.
    """
    modes = layout.contact_combinations
    free = [mode for mode in modes if mode[joint] == 0]
    return [
        {side: modes.index((*one[:joint], side, *one[joint + 1 :])) for side in (1, 0, -1)}
        for one in free
    ]


def _leave_flanks(
    drive: Drive, q: Numbers, joint: int, modes: list[Mode], leaving: list[Any]
) -> tuple[list[Mode], list[Any]]:
    """Return the modes, and the leaving shares, after a joint has left its flanks."""
    after, shares = list(modes), list(leaving)
    for places in _flank_places(drive.layout, joint):
        gap, parts, left = places[0], [], []
        for side in (1, -1):
            here = modes[places[side]]
            share = leaving[places[side]][joint]
            after[places[side]] = here._replace(chance=here.chance * (1 - share))
            parts.append(here._replace(chance=here.chance * share))
            left.append(leaving[places[side]])
        parts = [
            *_separate_gap_mode(drive, q, joint, modes[gap], sum(one.chance for one in parts)),
            *parts,
        ]
        left = [leaving[gap], leaving[gap], *left]
        after[gap], weights = _merge_modes(parts)
        shares[gap] = mean_of_models(weights, left)
    return after, shares


def _separate_gap_mode(drive: Drive, q: Numbers, joint: int, gap: Mode, come: Any) -> list[Mode]:
    """Return a gap's mode in two parts, untruncated and truncated to the gap.

    The untruncated part gives the first passage. Yet a link that has not arrived is in the gap: a
    new part would be merged with one that has long been elsewhere, and go with it. So it is cut by
    the share of new parts, and wholly, once, if hardly any of the uncut belief is in the gap.
    """
    belief = gap.belief
    bounds = [Bound(h, h @ belief.mean, 1.0) for h in drive.layout.flank_rows(joint)]
    inside = truncate_at_bounds(belief, bounds, q.slack, SURE).belief
    late = sum(_flank_probabilities(drive.layout, joint, belief, q.slack)) > LATE
    share = ca.if_else(late, 1.0, come / ca.fmax(gap.chance + come, NONE))
    return [gap._replace(chance=gap.chance * (1 - share)), Mode(gap.chance * share, inside)]


def _move_modes(drive: Drive, q: Numbers, now: Sequence[Mode], u: Any) -> list[Mode]:
    """Return the modes a sample later, with the contacts unchanged.

    Modes of which the same joints are in contact share a graph, in which the flank is a symbol.
    """
    after: dict[int, Mode] = {}
    modes = drive.layout.contact_combinations
    for free in dict.fromkeys(tuple(side == 0 for side in mode) for mode in modes):
        alike = [k for k, mode in enumerate(modes) if tuple(side == 0 for side in mode) == free]

        def move(sides: Any, q: Numbers, one: Mode, u: Any, free: Any = free) -> Mode:
            """Return a mode a sample later."""
            flanks = zip(ca.vertsplit(sides), free, strict=True)
            contact = [side * (1 - is_free) for side, is_free in flanks]
            return _move_mode(drive, q, contact, one, u)

        calls = [(ca.SX(ca.DM(modes[k])), q, now[k], u) for k in alike]
        after |= zip(alike, share_step_graph(move, calls, LONG), strict=True)
    return [after[k] for k in range(len(modes))]


def _move_mode(drive: Drive, q: Numbers, contact: Contacts, one: Mode, u: Any) -> Mode:
    """Return a mode a sample later, with the contacts unchanged."""
    layout, (mean, cov), Q = drive.layout, one.belief, ca.SX(q.Q)
    motors = layout.slice_of("motor_speed")
    friction = ca.fmax(mean[layout.slice_of("friction")], q.least)
    Q[motors] += q.rest * friction**2 * _rest_weight(mean[motors])  # which takes whatever there is
    for name in WALKING:
        here = layout.slice_of(name)
        Q[here] *= ca.fmax(1 - ca.diag(cov[here, here]) / q.most[here], 0.0)
    return Mode(
        one.chance,
        predict_first_order(one.belief, _sample_motion(drive, q, contact, u), ca.diag(Q)),
    )


def _arrival_shares(layout: Layout, slack: Any, contact: Contacts, start: Mode, end: Mode) -> Any:
    """Return the shares of a mode that reach the right and the left flank (N x 2) [1].

    An untruncated belief much wider than the gap has no information on the place inside it.
    """
    shares = ca.SX.zeros(layout.size, 2)
    for joint in range(layout.size):
        if contact[joint] == 0:
            before, now = (
                _flank_probabilities(layout, joint, one.belief, slack) for one in (start, end)
            )
            across = layout.flank_row(joint, 1)
            most = WIDE * end.belief.mean[layout.slice_of("half")][joint]
            lost = across @ end.belief.cov @ across.T > most**2 + slack
            shares[joint, :] = ca.horzcat(*arrival_shares(before, now, lost))
    return shares


def _reach_flanks(
    drive: Drive, q: Numbers, joint: int, modes: list[Mode], arrivals: list[Any]
) -> tuple[list[Mode], list[Any]]:
    """Return the modes, and the arriving shares, after a joint has reached its flanks."""
    after, shares = list(modes), list(arrivals)
    for places in _flank_places(drive.layout, joint):
        gap, share = modes[places[0]], arrivals[places[0]][joint, :]
        after[places[0]] = gap._replace(chance=gap.chance * (1 - ca.sum2(share)))
        for side, arrived in zip((1, -1), ca.horzsplit(share), strict=True):
            place = places[side]
            new = Mode(gap.chance * arrived, condition_on_impact(drive, q, joint, side, gap.belief))
            after[place], (kept, come) = _merge_modes([modes[place], new])
            shares[place] = kept * arrivals[place] + come * arrivals[places[0]]
    return after, shares


def _merge_modes(parts: list[Mode]) -> tuple[Mode, list[Any]]:
    """Return the mode merged from parts by their moments, and the share of each part.

    If no part arrives, the first one stays.
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

    In the mean it did so half a sample ago. Since then motor and link have moved on together, by as
    much as the impulse between them moves them; its size is not known, as restitution is not. Joint
    by joint, if both move alike, the gap is left as it is: a link that rests on a flank leaves it
    and comes back for reasons that are not modelled, and soon seemed to cross a gap of nothing.
    """
    layout, x = drive.layout, belief.mean
    motor, link = (
        layout.slice_of("motor_speed").start + joint,
        layout.slice_of("link_speed").start + joint,
    )
    late = ca.DM(1, layout.entry_count)
    late[0, motor], late[0, link] = -side * drive.Ts / 2, side * drive.Ts / 2
    row = layout.flank_row(joint, side) + late
    excess = row @ x
    wild = ca.fmax(ca.fabs(excess) - FAR * ca.sqrt(ca.fmax(row @ belief.cov @ row.T, 0.0)), 0.0)
    moved = ca.SX.ones(layout.entry_count) if drive.apart else None
    if moved is not None:
        moved[layout.slice_of("half").start + joint] = 1 - _rest_weight(x[motor] - x[link])
    at = condition_on_edge(belief, row, excess, q.slack + (late @ x) ** 2 / 3 + wild**2, moved)
    direction = drive.mobility(q.model, at.mean)[:, joint]
    N = layout.size
    give = direction / (direction[N + joint] - direction[joint])  # a unit of theta' - q' less
    b = ca.vertcat(ca.SX.zeros(2 * N), give, ca.SX.zeros(layout.entry_count - 4 * N))
    closing = at.cov[motor, motor] + at.cov[link, link] - 2 * at.cov[motor, link]
    impulse = q.impact**2 * ((at.mean[motor] - at.mean[link]) ** 2 + closing)
    back = ca.vertcat(give * (-late @ at.mean) * side, ca.SX.zeros(layout.entry_count - 2 * N))
    return Gaussian(at.mean + back, mirror_upper(at.cov + (impulse * b) @ b.T))


def _rest_weight(speed: Any) -> Any:
    """Return the degree of rest at a speed, from 0 to 1 [1]."""
    return ca.exp(-((speed / RESTING) ** 2))


def pack_modes(drive: Drive, moved: Sequence[Mode], s: Modes, y: Any) -> Modes:
    """Return the state at the next sample, unchanged before a first whole sample."""
    entries, begun = (
        ca.Sparsity.upper(drive.layout.entry_count),
        ca.fmax(s.begun, ca.mmin(present(y))),
    )

    def kept(new: Any, old: Any) -> Any:
        """Return the new value after a first whole sample, or the old value before."""
        return ca.if_else(begun > 0.5, new, old)

    chances = ca.vertcat(*normalise_weights([one.chance for one in moved]))
    means = map(kept, [one.belief.mean for one in moved], s.means)
    covs = map(kept, [to_upper_entries(one.belief.cov, entries) for one in moved], s.covs)
    return Modes(kept(chances, s.chances), tuple(means), tuple(covs), begun)
