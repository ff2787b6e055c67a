"""A filter of contacts: motors and links with gaps between them, each joint in one of three modes.

A joint touches its right flank (1), runs free in the gap (0) or touches its left flank (-1). Each
combination is an extended Kalman filter of x = [theta; q; theta'; q'; a; c; f; w; payload] with the
contacts held, and a chance. A link leaves a flank where the torque through it changes its sign; it
reaches one by first passage (`numerics.first_passage`), which is where the gap is measured. What
comes together in a mode is merged by its moments (interacting multiple models, Blom and Bar-Shalom
1988, with changes that hang on the state). docs/gears.md derives the weights.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.ends.sensor import present
from undeadzone.numerics.first_passage import arriving, at_edge, beyond
from undeadzone.numerics.gaussian import (
    Gaussian,
    advance,
    from_upper,
    mixed,
    symmetric,
    triangle,
    update_unless_glitch,
)
from undeadzone.numerics.runge_kutta import rk4_change
from undeadzone.support.arrays import Floats

Contact = tuple[int, ...]  # of each joint: 1, 0 or -1
LEAST = 1e-7  # chance of a mode below which it is dropped
MOST = 60.0  # largest difference of logs of chances
RESTING = 0.1  # speed below which a motor may be at rest [rad/s]
import os; LATE=float(os.environ.get("LATE","0.5"))


class Layout(NamedTuple):
    """Where each quantity stands in x, of N joints.

    Attributes:
        size: number of joints N.
    """

    size: int

    def of(self, name: str) -> slice:
        """The entries of one quantity."""
        names = ("motor", "link", "motor_speed", "link_speed", "half", "centre", "friction", "push")
        if name == "payload":
            return slice(8 * self.size, 8 * self.size + 1)
        first = names.index(name) * self.size
        return slice(first, first + self.size)

    @property
    def count(self) -> int:
        """How many numbers x has."""
        return 8 * self.size + 1

    @property
    def modes(self) -> list[Contact]:
        """Every combination of contacts."""
        return list(itertools.product((1, 0, -1), repeat=self.size))

    def edge(self, joint: int, side: int) -> ca.DM:
        """The row of side (theta - q + c) - a of a joint (1 x count)."""
        row = np.zeros((1, self.count))
        for name, sign in (("motor", side), ("link", -side), ("centre", side), ("half", -1)):
            row[0, self.of(name).start + joint] = sign
        return ca.sparsify(ca.DM(row))


class Drive(NamedTuple):
    """What the filter asks of the plant; its first argument is `Numbers.model`.

    Attributes:
        layout: where the quantities stand.
        rate: (numbers, x, u, contact) -> (x' (count), torques through the gears (N)), contacts
            locked.
        mobility: (numbers, x) -> change of [theta'; q'] (2N x N) by a unit impulse between motor
            and link of each joint, which takes from the motor.
        readings: entry of x that each reading gives (p).
        Ts: sample time [s].
        substeps: Runge-Kutta steps in a sample.
    """

    layout: Layout
    rate: Callable[[Any, Any, Any, Contact], tuple[Any, Any]]
    mobility: Callable[[Any, Any], Any]
    readings: tuple[int, ...]
    Ts: float
    substeps: int


class Numbers(NamedTuple):
    """The numbers of the filter.

    Attributes:
        model: those of the plant.
        mean, std: of x about the first reading, contacts unknown (count).
        Q: variance that x gains in a step (count).
        R: variance of a reading (p).
        low, high: between which x is known to lie (count).
        slack: variance of where a flank is: its compliance is not known (1) [rad^2].
        torque: deviation of the torque through the gears (N) [N m].
        leaving: chance per sample that a link leaves a flank which pulls.
        impact: share by which an impulse is off.
        rest: variance that the speed of a motor at rest gains in a step, over f^2 (N).
        least: friction that static friction has at least (N) [N m].
    """

    model: Any
    mean: Floats
    std: Floats
    Q: Floats
    R: Floats
    low: Floats
    high: Floats
    slack: Any
    torque: Floats
    leaving: Any
    impact: Any
    rest: Floats
    least: Floats


class Modes(NamedTuple):
    """The state: a chance and a belief for each mode.

    Attributes:
        chances: of the modes (K); their sum is 1.
        means: of x in each mode (K of (count)).
        covs: upper triangles of the covariances.
        begun: 1 once a whole sample was read (1).
    """

    chances: Any
    means: tuple[Any, ...]
    covs: tuple[Any, ...]
    begun: Any


class Told(NamedTuple):
    """What the readings of a sample make of the modes.

    Attributes:
        chances: of the modes (K).
        beliefs: about x in each mode.
        whole: the belief about x whatever the mode.
        e, std: innovations and their deviations, whatever the mode (p).
    """

    chances: list[Any]
    beliefs: list[Gaussian]
    whole: Gaussian
    e: Any
    std: Any


def start(drive: Drive, q: Numbers) -> Modes:
    """The modes before the first reading, as NumPy arrays: each link on the flank of its mode."""
    layout = drive.layout
    modes = layout.modes
    entries = ca.Sparsity.upper(layout.count)
    means, covs = [], []
    for mode in modes:
        belief = Gaussian(ca.SX(q.mean), ca.SX(ca.diag(q.std**2)))
        for joint, side in enumerate(mode):
            if side:
                h = layout.edge(joint, side)
                belief = at_edge(belief, h, h @ belief.mean, q.slack)
        means.append(np.asarray(ca.evalf(belief.mean)).ravel())
        covs.append(np.asarray(ca.evalf(triangle(belief.cov, entries))).ravel())
    even = np.full(len(modes), 1 / len(modes))
    return Modes(even, tuple(means), tuple(covs), np.zeros(1))


def beliefs_of(drive: Drive, s: Modes, y: Any) -> tuple[list[Gaussian], Any]:
    """The belief in each mode, and whether there is any: the first whole sample sets the angles.

    Args:
        drive: the plant.
        s: the state.
        y: readings (p).
    """
    layout, N = drive.layout, drive.layout.size
    entries = ca.Sparsity.upper(layout.count)
    whole = ca.mmin(present(y))
    first = ca.logic_and(s.begun < 0.5, whole)
    angle = ca.if_else(first, y[:N], 0.0)
    shift = ca.vertcat(angle, angle, ca.SX.zeros(layout.count - 2 * N))
    beliefs = []
    for mean, cov in zip(s.means, s.covs, strict=True):
        beliefs.append(Gaussian(mean + shift, symmetric(cov, entries)))
    return beliefs, ca.fmax(s.begun, whole)


def corrected(drive: Drive, q: Numbers, chances: Any, beliefs: list[Gaussian], y: Any) -> Told:
    """The modes after the readings of a sample; one that is no number is missing."""
    after, logs, innovations, variances = [], [], [], []
    for belief in beliefs:
        e, std, log = [], [], 0.0
        for row, entry in enumerate(drive.readings):
            seen = present(y[row])
            h = ca.DM(1, drive.layout.count)
            h[0, entry] = 1
            off = ca.if_else(seen, y[row] - belief.mean[entry], 0.0)
            told = update_unless_glitch(belief, h, off, q.R[row], seen, None, 0.0)
            belief = told.belief
            log += ca.if_else(seen, -((off / told.std) ** 2) / 2 - ca.log(told.std), 0.0)
            e.append(off)
            std.append(told.std)
        after.append(Gaussian(ca.fmax(ca.fmin(belief.mean, q.high), q.low), belief.cov))
        logs.append(log)
        innovations.append(ca.vertcat(*e))
        variances.append(ca.vertcat(*std) ** 2)
    before = ca.vertsplit(chances)
    best = ca.mmax(ca.vertcat(*(ca.if_else(w > 0, log, -1e300) for w, log in zip(before, logs))))
    weights = [w * ca.exp(ca.fmax(log - best, -MOST)) for w, log in zip(before, logs)]
    shares = normalised([ca.if_else(w < LEAST * sum(weights), 0.0, w) for w in weights])
    whole = mixed(shares, after)
    kept = [one_or_other(share > 0, belief, whole) for share, belief in zip(shares, after)]
    e = sum(w * one for w, one in zip(before, innovations))
    spread = sum(w * (v + (one - e) ** 2) for w, v, one in zip(before, variances, innovations))
    return Told(shares, kept, whole, e, ca.sqrt(spread))


def one_or_other(use: Any, one: Gaussian, other: Gaussian) -> Gaussian:
    """One belief, or another one."""
    return Gaussian(
        ca.if_else(use, one.mean, other.mean), from_upper(ca.if_else(use, one.cov, other.cov))
    )


def normalised(weights: list[Any]) -> list[Any]:
    """The weights over their sum."""
    total = ca.fmax(sum(weights), 1e-300)
    return [weight / total for weight in weights]


class Moving(NamedTuple):
    """A mode on its way to the next sample.

    Attributes:
        chance: of the mode.
        belief: about x.
        torque: through the gears (N) [N m].
        arrives: share that reaches the right and the left flank, for each joint in its gap.
    """

    chance: Any
    belief: Gaussian
    torque: Any
    arrives: Mapping[int, tuple[Any, Any]]


def predicted(drive: Drive, q: Numbers, told: Told, before: list[Gaussian], u: Any) -> list[Moving]:
    """The modes a sample later.

    Args:
        drive: the plant.
        q: the numbers.
        told: the modes after the readings.
        before: the beliefs before the readings, of which the chances beyond the edges count.
        u: torque of the motors (N).
    """
    moved = []
    steps = zip(drive.layout.modes, told.chances, told.beliefs, before, strict=True)
    for contact, chance, belief, earlier in steps:
        moved.append(_moved(drive, q, contact, chance, belief, earlier, u))
    for joint in range(drive.layout.size):
        moved = changed(drive, q, joint, moved)
    return moved


def _moved(
    drive: Drive, q: Numbers, contact: Contact, chance: Any, belief: Gaussian, before: Any, u: Any
) -> Moving:
    """One mode a sample later, contacts held."""
    layout, h = drive.layout, drive.Ts / drive.substeps

    def change(x: Any) -> Any:
        total = ca.SX.zeros(layout.count)
        for _ in range(drive.substeps):
            now = x + total
            total += rk4_change(lambda z, _: drive.rate(q.model, z, u, contact)[0], now, h)
        return total

    motors = layout.of("motor_speed")
    after = advance(belief, change, ca.diag(q.Q))
    speed = after.mean[motors]
    friction = ca.fmax(after.mean[layout.of("friction")], q.least)
    slack = ca.SX.zeros(layout.count)
    slack[motors] = q.rest * friction**2 * ca.exp(-((speed / RESTING) ** 2))
    after = Gaussian(after.mean, after.cov + ca.diag(slack))
    torque = drive.rate(q.model, after.mean, u, contact)[1]
    arrives = {}
    for joint, side in enumerate(contact):
        if not side:
            shares = []
            for edge in (layout.edge(joint, 1), layout.edge(joint, -1)):
                was, now = (beyond(one, edge, edge @ one.mean) for one in (before, after))
                shares.append(arriving(was, now))
            most = ca.fmax(sum(shares), 1.0)
            arrives[joint] = (shares[0] / most, shares[1] / most)
    return Moving(chance, after, torque, arrives)


def changed(drive: Drive, q: Numbers, joint: int, moved: list[Moving]) -> list[Moving]:
    """The modes after one joint has changed its contact, or kept it."""
    modes = drive.layout.modes
    by_contact = dict(zip(modes, moved, strict=True))
    for free in modes:
        if free[joint] == 0:
            sides = {side: (*free[:joint], side, *free[joint + 1 :]) for side in (1, 0, -1)}
            three = {side: by_contact[mode] for side, mode in sides.items()}
            for side, one in _exchanged(drive, q, joint, three).items():
                by_contact[sides[side]] = one
    return [by_contact[mode] for mode in modes]


def _exchanged(drive: Drive, q: Numbers, joint: int, three: dict[int, Moving]) -> dict[int, Moving]:
    """Right flank, gap and left flank of one joint after they exchanged what changes its contact."""
    gap, result = three[0], {}
    stays = {0: 1 - sum(gap.arrives[joint])}
    for side in (1, -1):
        pull = -side * three[side].torque[joint] / q.torque[joint]
        stays[side] = 1 - q.leaving * (1 + ca.erf(pull / math.sqrt(2))) / 2
    for side, share in zip((1, -1), gap.arrives[joint], strict=True):
        arrived = gap._replace(belief=struck(drive, q, joint, side, gap.belief))
        kept = three[side].chance * stays[side]
        result[side] = _merged([(kept, three[side]), (gap.chance * share, arrived)])
    parts = [(gap.chance * stays[0], gap)]
    parts += [(three[side].chance * (1 - stays[side]), three[side]) for side in (1, -1)]
    result[0] = _merged(parts)._replace(arrives=gap.arrives)
    return {side: result[side]._replace(arrives=three[side].arrives) for side in (1, 0, -1)}


def _merged(parts: list[tuple[Any, Moving]]) -> Moving:
    """What comes together in a mode, by its moments; where nothing comes, what was there."""
    total = sum(chance for chance, _ in parts)
    empty = total < 1e-12
    shares = [ca.if_else(empty, 0.0, chance / ca.fmax(total, 1e-300)) for chance, _ in parts]
    shares[0] = ca.if_else(empty, 1.0, shares[0])
    belief = mixed(shares, [one.belief for _, one in parts])
    torque = sum(share * one.torque for share, (_, one) in zip(shares, parts, strict=True))
    return Moving(total, belief, torque, parts[0][1].arrives)


def struck(drive: Drive, q: Numbers, joint: int, side: int, belief: Gaussian) -> Gaussian:
    """The belief of a link that has just struck a flank.

    In the mean it did so half a sample ago. Since then motor and link have moved on together, by as
    much as the impulse between them says; its size is not known, as restitution is not.
    """
    layout = drive.layout
    motor, link = layout.of("motor_speed").start + joint, layout.of("link_speed").start + joint
    h = layout.edge(joint, side)
    late = ca.DM(1, layout.count)
    late[0, motor], late[0, link] = -side * drive.Ts * LATE, side * drive.Ts * LATE
    row = h + late
    overlap = -late @ belief.mean
    at = at_edge(belief, row, row @ belief.mean, q.slack + overlap**2 / 3)
    direction = drive.mobility(q.model, at.mean)[:, joint]
    N = layout.size
    give = direction / (direction[N + joint] - direction[joint])  # a unit of theta' - q' less
    speeds = slice(2 * N, 4 * N)
    b = ca.SX.zeros(layout.count)
    b[speeds] = give
    closing = at.cov[motor, motor] + at.cov[link, link] - 2 * at.cov[motor, link]
    impulse = q.impact**2 * ((at.mean[motor] - at.mean[link]) ** 2 + closing)
    back = ca.SX.zeros(layout.count)
    back[: 2 * N] = give * (-late @ at.mean) * side
    return Gaussian(at.mean + back, from_upper(at.cov + (impulse * b) @ b.T))


def packed(drive: Drive, moved: list[Moving], s: Modes, begun: Any) -> Modes:
    """The state at the next sample; before a first whole sample it stays as it is."""
    entries = ca.Sparsity.upper(drive.layout.count)
    chances = ca.vertcat(*normalised([one.chance for one in moved]))
    means = [
        ca.if_else(begun > 0.5, one.belief.mean, old)
        for one, old in zip(moved, s.means, strict=True)
    ]
    covs = [
        ca.if_else(begun > 0.5, triangle(one.belief.cov, entries), old)
        for one, old in zip(moved, s.covs, strict=True)
    ]
    kept = ca.if_else(begun > 0.5, chances, s.chances)
    return Modes(kept, tuple(means), tuple(covs), begun)
