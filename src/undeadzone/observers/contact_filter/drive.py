"""Plant model of the contact filter for an arm: all joints at once, or group by group.

At once N joints have 3^N modes; joint by joint they have 3 N. Each joint then has the filter of an
arm of one link, to which the rest of the arm is numbers of the sample: its link moves by

    m (q'' - a0) = tau - tau0 - (friction - friction0) - slope (q - q0) - weight (payload - p0)

with m = 1 / (M^-1)_ii, the inertia against its own torque while the other gears transmit
theirs. Two joints about nearly one axis make a group: m is then a matrix, and they have 9 modes.
a0 = M^-1 (tau0 - h - friction0) is its acceleration with all joints in the mean, and tau0 the mean
of the torques over the sample. By as much as the torques of the others are uncertain, a link is
pushed at random; later readings of their motors correct it.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca

from undeadzone.numerics.gaussian import Gaussian, linearise, mix_gaussians
from undeadzone.numerics.runge_kutta import GAMMA, rosenbrock_change
from undeadzone.observers.contact_filter.modes import (
    CONSTANTS,
    LEAST,
    NONE,
    QUANTITIES,
    Contacts,
    Drive,
    Layout,
    Numbers,
    Posterior,
    mixture_innovation,
    normalise_weights,
)
from undeadzone.observers.filtering.multiple_models import mean_of_models
from undeadzone.plants.robots.arm import Chain
from undeadzone.plants.robots.geared import Geared, Gears, build_geared_arm

FADING = 0.2  # correlation time of the unknown torque of motors [s]
LASTING = 0.01  # time for which the unknown torque of links lasts [s]
SLOW = 0.05  # time for which the place of another link is off [s]
PASSED = 0.6  # of what readings correct in the speed of a motor, the share that its gears caused
FAINT = 1e-4  # share below which a filter is not heard
KNOWN = 1e-9  # variance of a payload that is known [kg^2]
OWN = ("f", "b", "half", "centre", "inertia", "friction", "viscous", "contact")  # of each joint


def build_drive(gears: Geared, Ts: float, substeps: int, apart: bool = False) -> Drive:
    """Return the functions of an arm with gears that the filter needs.

    Args:
        gears: the arm.
        Ts: sample time [s].
        substeps: steps of integration in a sample.
        apart: whether it is one joint of several.
    """
    N, layout = gears.joint_count, Layout(gears.joint_count)

    def rate(params: Any, x: Any, u: Any, contact: Contacts) -> tuple[Any, Any]:
        """Return x' (entries), and the torques through the gears (N) [N m]."""
        push = x[layout.slice_of("push")]
        dx, tau = gears.motion(
            substitute_estimates(gears, params, x), x[: 4 * N], u + push, ca.vertcat(*contact)
        )
        constant = ca.SX.zeros(5 * N)
        return ca.vertcat(dx, constant, -push / FADING, 0.0), tau

    def implicit(params: Any, x: Any, contact: Contacts, g: Any) -> Any:
        """Return the function that solves for a column (I - g A)^-1 times a column (entries).

        The unknowns are reduced to the torques through the gears that are closed.
        """
        column = substitute_estimates(gears, params, x)
        links, body, J = gears.link_params(column), gears.arm, gears.gear_number(column, "inertia")
        K, D = gears.contact_stiffness(column)
        turning, v = x[layout.slice_of("motor_speed")], x[layout.slice_of("link_speed")]
        friction = linearise(lambda each: gears.motor_friction_torque(column, each), turning)[1]
        rubbing = linearise(lambda each: body.friction(links, each), v)[1]
        M = ca.densify(body.mass(links, x[layout.slice_of("link")]))
        motors, heavier = J + g * ca.diag(friction), M + g * ca.diag(ca.diag(rubbing))
        closed = [joint for joint, side in enumerate(contact) if not ca.SX(side).is_zero()]
        moved = solve_mass(heavier, ca.DM.eye(N)[:, closed])
        softened = (g * K + D)[closed]
        compliance = g * moved[closed, :] + ca.diag((g / motors)[closed] + 1 / softened)

        def solve(b: Any) -> Any:
            """Return (I - g A)^-1 b (entries)."""
            theta, q, spin, speed, *rest = ca.vertsplit(b, [0, N, 2 * N, 3 * N, 4 * N, b.numel()])
            spin, speed = J * spin / motors, solve_mass(heavier, M @ speed)
            if closed:
                wound = (K * (theta - q))[closed]
                tau = solve_mass(compliance, wound / softened + (spin - speed)[closed])
                spin[closed] -= g * tau / motors[closed]
                speed += g * moved @ tau
            return ca.vertcat(theta + g * spin, q + g * speed, spin, speed, *rest)

        return solve

    def mobility(params: Any, x: Any) -> Any:
        """Return the change of [theta'; q'] (2N x N) by a unit impulse in each joint."""
        column = substitute_estimates(gears, params, x)
        M = ca.densify(gears.arm.mass(gears.link_params(column), x[layout.slice_of("link")]))
        return ca.vertcat(-ca.diag(1 / gears.gear_number(column, "inertia")), ca.inv(M))

    motors, links = tuple(range(N)), tuple(range(N, 2 * N))
    readings = {"motor": motors, "link": links, "both": (*links, *motors)}[gears.measured]
    return Drive(layout, rate, implicit, mobility, readings, Ts, substeps, apart)


def substitute_estimates(gears: Geared, params: Any, x: Any) -> Any:
    """Return the parameters of an arm with gears, with a filter's estimates substituted.

    Args:
        gears: the arm.
        params: of the model.
        x: unknowns of the filter.
    """
    N, layout = gears.joint_count, Layout(gears.joint_count)
    column = ca.SX(params)
    for name in CONSTANTS:
        first = gears.names.index(f"{name}1")
        column[first : first + N] = x[layout.slice_of(name)]
    first = gears.names.index("contact1")
    column[first : first + N] *= ca.exp(x[layout.slice_of("firmness")])
    column[gears.names.index("payload")] = x[layout.slice_of("payload")]
    return column


def isolate_joints(gears: Geared, group: Sequence[int]) -> Geared:
    """Return some joints of an arm with gears as an arm of its own.

    Parameters stand for the rest of the arm.

    Args:
        gears: the arm.
        group: the joints.
    """
    size, here = len(group), list(group)

    def rest_entries(p: Any, name: str, columns: int) -> Any:
        """Return the entries that replace the rest of the arm (size x columns)."""
        names = _rest_names(size)
        return ca.reshape(ca.vertcat(*(p[each] for each in names[name])), size, columns)

    def bias(p: Any, q: Any, _: Any) -> Any:
        """Return the bias torque of the links, the rest of the arm included [N m]."""
        turned = rest_entries(p, "slope", size) @ (q - rest_entries(p, "place", 1))
        carried = rest_entries(p, "weight", 1) * (p["payload"] - p["carried"])
        return rest_entries(p, "load", 1) + turned + carried

    rest = dict.fromkeys(itertools.chain(*_rest_names(size).values()), 0.0)
    rest |= {f"mass_{joint}_{joint}": 1.0 for joint in range(size)}
    link = Chain(
        joints=tuple(gears.arm.chain.joints[joint] for joint in group),
        parameters={**rest, "carried": 0.0, "payload": 1.0},
        mass=lambda p, _: rest_entries(p, "mass", size),
        bias=bias,
        points=lambda _, __: ca.SX.zeros(1, 3),
        turn=lambda _, __: ca.SX.eye(3),
        gravity=lambda _: ca.SX.zeros(3),
        plane=(0, 1),
        **Chain.fields_without_limits(size),
    )
    one = build_geared_arm(link, Gears(half=0.0, inertia=1.0, measured=gears.measured), gears.rest)
    return one._replace(stiffness=gears.stiffness[here], damping=gears.damping[here])


def _rest_names(size: int) -> dict[str, list[str]]:
    """Return the names of the numbers that stand for the rest of an arm, column by column."""
    joints = range(size)
    each = {name: [f"{name}_{joint}" for joint in joints] for name in ("load", "place", "weight")}
    for name in ("mass", "slope"):
        each[name] = [f"{name}_{row}_{column}" for column, row in itertools.product(joints, joints)]
    return each


def group_entries(layout: Layout, group: Sequence[int]) -> list[int]:
    """Return the places of a group's quantities among all joints'.

    The order is that of the group's own layout.
    """
    places: list[int] = []
    for name in QUANTITIES:
        places += [layout.slice_of(name).start + joint for joint in group]
    return [*places, layout.entry_count - 1]


def group_readings(group: Sequence[int], size: int, readings: int) -> list[int]:
    """Return the places of a group's readings among all.

    Args:
        group: the joints.
        size: number of joints of the arm.
        readings: number of its readings.
    """
    return [first + joint for first, joint in itertools.product(range(0, readings, size), group)]


def group_numbers(q: Numbers, layout: Layout, group: Sequence[int]) -> Numbers:
    """Return the parameters of a filter: of a group, or all for a single filter."""
    if len(group) == layout.size:
        return q
    here, joints = group_entries(layout, group), list(group)
    return q._replace(
        Q=q.Q[here],
        R=q.R[group_readings(group, layout.size, q.R.shape[0])],
        low=q.low[here],
        high=q.high[here],
        most=q.most[here],
        torque=q.torque[joints],
        rest=q.rest[joints],
        least=q.least[joints],
    )


def contact_balance(drive: Drive, told: Posterior) -> Any:
    """Return the probability of the right less the left flank of each joint [1]."""
    filters = len(told.chances) // len(drive.layout.contact_combinations)
    sides = filters * [list(mode) for mode in drive.layout.contact_combinations]
    return ca.DM(sides).T @ ca.vertcat(*told.chances)


def join_posteriors(
    layout: Layout, groups: Sequence[Sequence[int]], told: Sequence[Posterior]
) -> Posterior:
    """Return the posterior of all joints, their groups taken as independent.

    Their payload errors count as a single error.

    Each group has a payload of its own. One is shown: each counts by its variance, and their errors
    are taken to be one and the same.

    Args:
        layout: of all joints.
        groups: joints of each filter.
        told: of each group.
    """
    if len(told) == 1:
        return told[0]
    mean, cov = ca.SX(layout.entry_count, 1), ca.SX(layout.entry_count, layout.entry_count)
    news, readings = ca.SX(layout.entry_count, 1), sum(one.e.numel() for one in told)
    e, std = ca.SX(readings, 1), ca.SX(readings, 1)
    for group, one in zip(groups, told, strict=True):
        here, seen = group_entries(layout, group), group_readings(group, layout.size, readings)
        mean[here], cov[here, here], news[here] = one.whole.mean, one.whole.cov, one.news
        e[seen], std[seen] = one.e, one.std
    payloads = [one.whole.mean[-1] for one in told]
    variances = [ca.fmax(one.whole.cov[-1, -1], KNOWN) for one in told]
    total = sum(1 / variance for variance in variances)
    mean[-1] = sum(p / variance for p, variance in zip(payloads, variances, strict=True)) / total
    cov[-1, :], cov[:, -1] = 0, 0
    cov[-1, -1] = (sum(1 / ca.sqrt(variance) for variance in variances) / total) ** 2
    return Posterior((), (), Gaussian(mean, cov), news, e, std)


def mix_posteriors(told: Sequence[Posterior], shares: tuple[Any, Any]) -> Posterior:
    """Return the mixture of the posteriors of a joint's filters, weighted by their shares.

    Args:
        told: of each filter (K).
        shares: before and after the readings (K each).
    """
    if len(told) == 1:
        return told[0]
    before, after = map(ca.vertsplit, shares)
    heard = normalise_weights([ca.if_else(share > FAINT, share, 0.0) for share in after])
    chances: list[Any] = []
    beliefs: list[Gaussian] = []
    for share, one in zip(heard, told, strict=True):
        chances += [share * chance for chance in one.chances]
        beliefs += one.beliefs
    whole = mix_gaussians(heard, [one.whole for one in told])
    news = mean_of_models(heard, [one.news for one in told])
    return Posterior(tuple(chances), tuple(beliefs), whole, news, *mixture_innovation(before, told))


class Posture(NamedTuple):
    """Arm with all its joints at the mean.

    Attributes:
        gears: the arm.
        params: its parameters.
        q, v: angles and speeds of the links (N).
        closing: speeds of motors against links (N).
        push: torque of the motors less their friction (N) [N m].
        rubbed: friction of the links (N).
        needed: torque that the links need to keep their speed (N).
        mass, inverse: M and M^-1 (N x N).
    """

    gears: Geared
    params: Any
    q: Any
    v: Any
    closing: Any
    push: Any
    rubbed: Any
    needed: Any
    mass: Any
    inverse: Any


def mean_posture(gears: Geared, model: Any, mean: Any, u: Any) -> Posture:
    """Return the posture of an arm at the mean.

    Args:
        gears: the arm.
        model: its parameters.
        mean: of all unknowns.
        u: torque of the motors (N).
    """
    layout, params, body = (
        Layout(gears.joint_count),
        substitute_estimates(gears, model, mean),
        gears.arm,
    )
    links = gears.link_params(params)
    q, turning, v = (mean[layout.slice_of(name)] for name in ("link", "motor_speed", "link_speed"))
    rubbed, mass = body.friction(links, v), ca.densify(body.mass(links, q))
    return Posture(
        gears,
        params,
        q,
        v,
        turning - v,
        u + mean[layout.slice_of("push")] - gears.motor_friction_torque(params, turning),
        rubbed,
        body.bias(links, q, v) + rubbed,
        mass,
        solve_mass(mass, ca.DM.eye(gears.joint_count)),
    )


def apply_gear_impulses(
    groups: Sequence[Sequence[int]], told: Sequence[Posterior], news: Any, arm: Posture
) -> list[Posterior]:
    """Return the groups' posteriors after gear impulses inferred from all readings.

    Where readings correct the speed of a motor, its gears have given its link another impulse than
    was taken for the mean, opposite to that of the motor. Links of other groups that are free went
    with it unseen; those in contact are held by their own readings.

    Args:
        groups: joints of each filter.
        told: of each group, after its own readings.
        news: by how much the readings moved the means of all unknowns.
        arm: all joints in the mean.
    """
    layout, inertia = Layout(arm.gears.joint_count), arm.gears.gear_number(arm.params, "inertia")
    impulses = -PASSED * inertia * news[layout.slice_of("motor_speed")]
    gained = (other_groups(groups, layout.size) * arm.inverse) @ impulses
    each = []
    for group, one in zip(groups, told, strict=True):
        own, beliefs = Layout(len(group)), list(one.beliefs)
        for place, contact in enumerate(own.contact_combinations):
            mean = ca.SX(beliefs[place].mean)
            for joint, side in enumerate(contact):
                if side == 0:
                    mean[own.slice_of("link_speed").start + joint] += gained[group[joint]]
            beliefs[place] = Gaussian(mean, beliefs[place].cov)
        each.append(one._replace(beliefs=tuple(beliefs)))
    return each


def other_groups(groups: Sequence[Sequence[int]], size: int) -> ca.DM:
    """Return 1 where two joints are of different groups, 0 elsewhere (size x size)."""
    apart = ca.DM.ones(size, size)
    for group in map(list, groups):
        apart[group, group] = 0
    return apart


def group_couplings(groups: Sequence[Sequence[int]], arm: Posture) -> Any:
    """Return the coupling of each joint to those of other groups (N) [1].

    It is `plants.robots.geared.Coupling.ratio` in one posture, of groups of one or two joints.

    Args:
        groups: joints of each filter.
        arm: all joints in the mean.
    """
    ratios = ca.SX(arm.gears.joint_count, 1)
    for group in map(list, groups):
        held, free = arm.mass[group, group], arm.inverse[group, group]
        mean = ca.trace(held @ free) / len(group)
        apart = mean**2 - ca.det(held) * ca.det(free) if len(group) > 1 else 0.0
        ratios[group] = mean + ca.sqrt(ca.fmax(apart, 0.0))
    return ratios


class GearTorques(NamedTuple):
    """Moments of the torques through the gears.

    Attributes:
        chance: that a joint is in contact (N).
        mean: of the torque (N) [N m].
        variance: of the torque (N).
    """

    chance: Any
    mean: Any
    variance: Any


def gear_torques(
    drives: Sequence[Drive], parts: Sequence[Numbers], told: Sequence[Posterior]
) -> GearTorques:
    """Return the torques through the gears at the start of a sample, group by group.

    The torque that stops a strike is as uncertain as the strike.

    A torque within a contact has no variance: the stiff contact corrects it at once, while the
    variances of two joints that take it for lasting would drive each other up.

    Args:
        drives: of each joint.
        parts: numbers of each joint.
        told: of each joint, after its readings.
    """
    each = []
    for drive, q, one in zip(drives, parts, told, strict=True):
        chance, mean, square = (ca.SX.zeros(drive.layout.size) for _ in range(3))
        modes = zip(
            itertools.cycle(drive.layout.contact_combinations),
            one.chances,
            one.beliefs,
            strict=False,
        )
        for contact, share, belief in modes:
            together = ca.SX(belief.mean)
            together[drive.layout.slice_of("motor_speed")] = together[
                drive.layout.slice_of("link_speed")
            ]
            tau = drive.rate(q.model, belief.mean, 0.0, contact)[1]
            sudden = tau - drive.rate(q.model, together, 0.0, contact)[1]
            chance += share * ca.DM(contact) ** 2
            mean += share * tau
            square += share * (tau**2 + (q.impact * sudden) ** 2)
        each.append((chance, mean, ca.fmax(square - mean**2, 0.0)))
    return GearTorques(*(ca.vertcat(*column) for column in zip(*each, strict=True)))


def update_group_numbers(
    groups: Sequence[Sequence[int]],
    ones: Sequence[Geared],
    drives: Sequence[Drive],
    parts: Sequence[Numbers],
    told: Sequence[Posterior],
    arm: Posture,
) -> list[Numbers]:
    """Return the parameters of each group's filter, with data about the rest of its arm.

    Args:
        groups: joints of each filter.
        ones: each group isolated.
        drives: of each group.
        parts: numbers of each group.
        told: of each group, after its readings.
        arm: all joints in the mean.
    """
    gears, N, body = arm.gears, arm.gears.joint_count, arm.gears.arm
    links, names = gears.link_params(arm.params), body.names
    carried = links[names.index("payload")]
    known = []
    for group, one, part in zip(groups, ones, parts, strict=True):
        known.append(part._replace(model=_group_parameters(gears, one, part.model, group)))
    now = gear_torques(drives, known, told)
    order = [*itertools.chain(*groups)]
    now = GearTorques(*(_sort_rows(column, order) for column in now))
    moved, tau = _link_mobility(arm, groups, now.chance), _mean_gear_torques(arm, now, drives[0])
    a = arm.inverse @ (tau - arm.needed)

    def needed(at: Any) -> Any:
        """Return the torques of the links at angles and payload (N) [N m]."""
        column = ca.SX(links)
        column[names.index("payload")] = at[N]
        return body.mass(column, at[:N]) @ a + body.bias(column, at[:N], arm.v)

    answers = moved @ linearise(needed, ca.vertcat(arm.q, carried))[1]
    loads, spans = ca.SX(N, 1), ca.SX(N, 1)
    for group, part, belief in zip(groups, parts, told, strict=True):
        here = list(group)
        loads[here] = part.Q[Layout(len(group)).slice_of("link_speed")]
        spans[here] = _link_variances(belief.whole, len(group))
    apart = other_groups(groups, N)
    uncertain = Uncertain(now.variance, loads, spans)
    shaken = _coupling_variance(arm.inverse, moved, answers[:, :N], apart, uncertain, drives[0].Ts)
    after = []
    for group, one, part in zip(groups, ones, known, strict=True):
        here, size = list(group), len(group)
        mass = solve_mass(moved[here, here], ca.DM.eye(size))
        slope = mass @ answers[here, :]
        rest = {
            "mass": mass,
            "load": tau[here] - arm.rubbed[here] - mass @ a[here],
            "slope": slope[:, here],
            "place": arm.q[here],
            "weight": slope[:, N],
        }
        for name, places in _rest_names(size).items():
            for place, value in zip(places, ca.vertsplit(ca.vec(rest[name])), strict=True):
                part.model[one.names.index(place)] = value
        part.model[one.names.index("carried")] = carried
        Q = ca.SX(part.Q)
        Q[Layout(size).slice_of("link_speed")] += shaken[here]
        after.append(part._replace(Q=Q))
    return after


def _sort_rows(column: Any, order: Sequence[int]) -> Any:
    """Return a column whose rows stood in another order."""
    after = ca.SX(len(order), 1)
    after[list(order)] = column
    return after


def _group_parameters(gears: Geared, one: Geared, params: Any, group: Sequence[int]) -> Any:
    """Return the parameters of an isolated group, without data about the rest of the arm."""
    column = ca.SX(one.values)
    for place, joint in enumerate(group):
        for name in OWN:
            column[one.names.index(f"{name}{place + 1}")] = params[
                gears.names.index(f"{name}{joint + 1}")
            ]
    return column


def solve_mass(M: Any, right: Any) -> Any:
    """Return M^-1 times a matrix."""
    return ca.ldl_solve(right, *ca.ldl(M))


def _link_mobility(arm: Posture, groups: Sequence[Sequence[int]], touching: Any) -> Any:
    """Return the acceleration of each link by torques (N x N).

    Motors of joints of other groups in contact turn with their links.

    So a link answers to its own contact, which lasts longer than a stiff contact takes.
    """
    N, inertia = arm.gears.joint_count, arm.gears.gear_number(arm.params, "inertia")
    rows = ca.SX(N, N)
    for group in map(list, groups):
        turned = touching * inertia
        turned[group] = 0.0
        rows[group, :] = solve_mass(arm.mass + ca.diag(turned), ca.DM.eye(N)[:, group]).T
    return rows


def _mean_gear_torques(arm: Posture, now: GearTorques, drive: Drive) -> Any:
    """Return the mean torques through the gears over a sample (N) [N m].

    Contacts stay unchanged.

    A joint that touches feels its own torque, and those of others by the chance that they touch.
    """
    gears, N, Ts = arm.gears, arm.gears.joint_count, drive.Ts
    inertia = gears.gear_number(arm.params, "inertia")
    K, damping = gears.contact_stiffness(arm.params)
    own = ca.diag(arm.inverse)
    others = arm.inverse - ca.diag(own)
    first = now.mean / ca.fmax(now.chance, NONE)

    def rate(x: Any) -> Any:
        """Return the rate of gear twist, speed difference and impulse (3N)."""
        wound, faster = x[:N], x[N : 2 * N]
        tau = first + K * wound + damping * faster
        link = own * tau + others @ (now.chance * tau) - arm.inverse @ arm.needed
        return ca.vertcat(arm.closing + faster, (arm.push - tau) / inertia - link, tau)

    h = Ts / drive.substeps
    g, touching = GAMMA * h, ca.fmax(now.chance, LEAST)
    softened = g * K + damping
    compliance = ca.diag(touching * (1 / softened + g / inertia + g * own))
    compliance += g * (touching @ touching.T) * others

    def solve(b: Any) -> Any:
        """Return (I - g A)^-1 b (3N), with A the Jacobian of the rate."""
        wound, faster, impulse = b[:N], b[N : 2 * N], b[2 * N :]
        tau = solve_mass(compliance, touching * (faster + K * wound / softened))
        faster = (tau - K * wound) / softened
        return ca.vertcat(wound + g * faster, faster, impulse + g * tau)

    total = ca.SX.zeros(3 * N)
    for _ in range(drive.substeps):
        total += rosenbrock_change(rate, solve, total, h)
    return now.chance * total[2 * N :] / Ts


class Uncertain(NamedTuple):
    """Variances of the coupling between joints.

    Attributes:
        torque: through the gears (N) [N^2 m^2].
        load: gain of the speed of each link in a sample by its own unknown torque (N).
        span: of the angle of each link (N) [rad^2].
    """

    torque: Any
    load: Any
    span: Any


def _coupling_variance(
    inverse: Any, moved: Any, answers: Any, apart: Any, of: Uncertain, Ts: float
) -> Any:
    """Return the variance of each link speed by the uncertain coupling of links (N) [(rad/s)^2].

    The variance is that gained in a sample.

    What their torques are off by counts for the sample alone, as it is made up for.

    Args:
        inverse: M^-1.
        moved: the acceleration of each link by torques (N x N).
        answers: the acceleration of each link by the angle of another (N x N).
        apart: 1 where two joints are of different groups (N x N).
        of: the uncertain entry.
        Ts: sample time [s].
    """
    N = apart.shape[0]
    pushed = (apart * inverse**2) @ of.torque
    loaded = (apart * (moved / ca.repmat(ca.diag(moved).T, N, 1)) ** 2) @ of.load
    tilted = (apart * answers**2) @ of.span
    return loaded + Ts * (Ts * pushed + SLOW * tilted)


def _link_variances(belief: Gaussian, size: int) -> Any:
    """Return the variances of links (size) [rad^2], bounded by their flanks."""
    layout, variances = Layout(size), ca.diag(belief.cov)
    motor, link, half = (layout.slice_of(name) for name in ("motor", "link", "half"))
    bound = belief.mean[half] ** 2 + variances[half] + variances[motor]
    return ca.fmin(variances[link], bound)
