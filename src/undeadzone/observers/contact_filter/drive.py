"""Plant model of the contact filter for an arm: all joints at once, or group by group.

A single filter for N joints has 3^N modes; filters of single joints have 3 N. Such a filter is that
of an arm of one link. The rest of the arm enters as parameters, which are constant in a sample:

    m (q'' - a0) = tau - tau0 - (friction - friction0) - slope (q - q0) - weight (payload - p0)

Here m = 1 / (M^-1)_ii is the inertia against the link's own torque while the other gears transmit
theirs. a0 = M^-1 (tau0 - h - friction0) is the acceleration if all joints are at their means, and
tau0 the mean of the torques over the sample. Two joints about nearly the same axis form a group
with 9 modes, for which m is a matrix. The uncertainty of the torques of other groups is process
noise of a link. Later readings of their motors correct it.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.numerics.gaussian import Gaussian, linearise, mix_gaussians
from undeadzone.numerics.runge_kutta import GAMMA, rosenbrock_change
from undeadzone.observers.contact_filter.modes import (
    CONSTANTS,
    LEAST,
    NONE,
    WEAR,
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
from undeadzone.plants.robots.geared import GEAR_NUMBERS, Geared, Gears, build_geared_arm

FADING = 0.2  # correlation time of the unknown torque of motors [s]
LASTING = 0.01  # time for which the unknown torque of links lasts [s]
SLOW = 0.05  # correlation time of an error in the position of another link [s]
PASSED = 0.6  # share of a correction of a motor's speed that an impulse of its gears caused
FAINT = 1e-4  # weight below which a filter is neglected
KNOWN = 1e-9  # variance of a known payload [kg^2]
OWN = ("f", "b", *GEAR_NUMBERS)  # of each joint


def build_drive(
    gears: Geared, Ts: float, substeps: int, apart: bool = False, further: tuple[str, ...] = ()
) -> Drive:
    """Return the functions of an arm with gears for the contact filter.

    Args:
        gears: the arm.
        Ts: sample time [s].
        substeps: integration steps in a sample.
        apart: whether it is an isolated group of joints of a larger arm.
        further: names of further constants that the filter estimates.
    """
    N = gears.joint_count
    layout = Layout(N, further)

    def rate(params: Any, x: Any, u: Any, contact: Contacts) -> tuple[Any, Any]:
        """Return x' (entries), and the torques through the gears (N) [N m]."""
        push = x[layout.slice_of("push")]
        dx, tau = gears.motion(
            substitute_estimates(layout, gears, params, x),
            x[: 4 * N],
            u + push,
            ca.vertcat(*contact),
        )
        moved = ca.SX.zeros(layout.entry_count)
        moved[: 4 * N] = dx
        moved[layout.slice_of("push")] = -push / FADING
        if WEAR in further:
            moved[layout.slice_of("half")] = x[layout.slice_of(WEAR)]
        return moved, tau

    def implicit(params: Any, x: Any, contact: Contacts, g: Any) -> Any:
        """Return the function b -> (I - g A)^-1 b (entries).

        A has the stiff contacts and friction. The system is reduced to the torques through the
        gears in contact, as many unknowns as there are contacts.
        """
        column = substitute_estimates(layout, gears, params, x)
        links = gears.link_params(column)
        body = gears.arm
        J = gears.gear_number(column, "inertia")
        K, D = gears.contact_stiffness(column)
        omega = x[layout.slice_of("motor_speed")]
        v = x[layout.slice_of("link_speed")]
        motor_slope = linearise(lambda speed: gears.motor_friction_torque(column, speed), omega)[1]
        link_slope = linearise(lambda speed: body.friction(links, speed), v)[1]
        M = ca.densify(body.mass(links, x[layout.slice_of("link")]))
        # Implicit friction adds its slope, times g, to the inertia.
        motors = J + g * ca.diag(motor_slope)
        bodies = M + g * ca.diag(ca.diag(link_slope))
        closed = [joint for joint, side in enumerate(contact) if not ca.SX(side).is_zero()]
        by_torque = solve_mass(bodies, ca.DM.eye(N)[:, closed])
        stiffness = (g * K + D)[closed]  # of a contact over the step, spring and damper
        compliance = g * by_torque[closed, :] + ca.diag((g / motors)[closed] + 1 / stiffness)

        def solve(b: Any) -> Any:
            """Return (I - g A)^-1 b (entries)."""
            theta, q, omega, v, *rest = ca.vertsplit(b, [0, N, 2 * N, 3 * N, 4 * N, b.numel()])
            omega = J * omega / motors
            v = solve_mass(bodies, M @ v)
            if closed:
                spring = (K * (theta - q))[closed]
                tau = solve_mass(compliance, spring / stiffness + (omega - v)[closed])
                omega[closed] -= g * tau / motors[closed]
                v += g * by_torque @ tau
            return ca.vertcat(theta + g * omega, q + g * v, omega, v, *rest)

        return solve

    def mobility(params: Any, x: Any) -> Any:
        """Return the change of [theta'; q'] by a unit impulse in each joint (2N x N)."""
        column = substitute_estimates(layout, gears, params, x)
        M = ca.densify(gears.arm.mass(gears.link_params(column), x[layout.slice_of("link")]))
        return ca.vertcat(-ca.diag(1 / gears.gear_number(column, "inertia")), ca.inv(M))

    motors = tuple(range(N))
    links = tuple(range(N, 2 * N))
    readings = {"motor": motors, "link": links, "both": (*links, *motors)}[gears.measured]
    return Drive(layout, rate, implicit, mobility, readings, Ts, substeps, apart)


def substitute_estimates(layout: Layout, gears: Geared, params: Any, x: Any) -> Any:
    """Return the parameters of an arm with gears, with the estimates of a filter in their places.

    Args:
        layout: of the filter.
        gears: the arm.
        params: parameters of the model.
        x: estimate of the filter (entries).
    """
    N = gears.joint_count
    column = ca.SX(params)
    for name in (*CONSTANTS, *(name for name in layout.further if name != WEAR)):
        first = gears.names.index(f"{name}1")
        column[first : first + N] = x[layout.slice_of(name)]
    first = gears.names.index("contact1")
    column[first : first + N] *= ca.exp(x[layout.slice_of("firmness")])
    column[gears.names.index("payload")] = x[layout.slice_of("payload")]
    return column


def isolate_joints(gears: Geared, group: Sequence[int]) -> Geared:
    """Return a group of joints of an arm with gears as an arm of its own.

    Its parameters include the effect of the rest of the arm (see the module).

    Args:
        gears: the arm.
        group: the joints.
    """
    size = len(group)
    joints = list(group)

    def rest_entries(p: Any, name: str, columns: int) -> Any:
        """Return parameters that replace the rest of the arm (size x columns)."""
        names = _rest_names(size)[name]
        return ca.reshape(ca.vertcat(*(p[entry] for entry in names)), size, columns)

    def bias(p: Any, q: Any, _: Any) -> Any:
        """Return the bias torque of the links, the rest of the arm included [N m]."""
        by_angle = rest_entries(p, "slope", size) @ (q - rest_entries(p, "place", 1))
        by_payload = rest_entries(p, "weight", 1) * (p["payload"] - p["carried"])
        return rest_entries(p, "load", 1) + by_angle + by_payload

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
    own_gears = Gears(half=0.0, inertia=1.0, measured=gears.measured)
    isolated = build_geared_arm(link, own_gears, gears.rest)
    return isolated._replace(stiffness=gears.stiffness[joints], damping=gears.damping[joints])


def _rest_names(size: int) -> dict[str, list[str]]:
    """Return the names of the parameters that replace the rest of an arm, column by column."""
    joints = range(size)
    names = {name: [f"{name}_{joint}" for joint in joints] for name in ("load", "place", "weight")}
    for name in ("mass", "slope"):
        pairs = itertools.product(joints, joints)
        names[name] = [f"{name}_{row}_{column}" for column, row in pairs]
    return names


def group_entries(layout: Layout, group: Sequence[int]) -> list[int]:
    """Return the entries of a group's quantities in x of all joints, in the order of its own x."""
    places: list[int] = []
    for name in layout.names:
        places += [layout.slice_of(name).start + joint for joint in group]
    return [*places, layout.entry_count - 1]


def group_readings(group: Sequence[int], size: int, readings: int) -> list[int]:
    """Return the indices of a group's readings among all readings.

    Args:
        group: the joints.
        size: number of joints of the arm.
        readings: number of its readings.
    """
    return [first + joint for first, joint in itertools.product(range(0, readings, size), group)]


def group_numbers(q: Numbers, layout: Layout, group: Sequence[int]) -> Numbers:
    """Return the parameters of the filter of a group.

    Args:
        q: parameters of a filter of all joints.
        layout: its layout.
        group: the joints.
    """
    if len(group) == layout.size:
        return q
    entries = group_entries(layout, group)
    joints = list(group)
    return q._replace(
        Q=q.Q[entries],
        R=q.R[group_readings(group, layout.size, q.R.shape[0])],
        low=q.low[entries],
        high=q.high[entries],
        most=q.most[entries],
        torque=q.torque[joints],
        rest=q.rest[joints],
        least=q.least[joints],
    )


def contact_balance(drive: Drive, posterior: Posterior) -> Any:
    """Return the probability of the right flank less that of the left flank of each joint (N) [1].

    Args:
        drive: functions of the plant.
        posterior: posterior of one filter, or of several filters in sequence.
    """
    filters = len(posterior.chances) // len(drive.layout.contact_combinations)
    sides = filters * list(map(list, drive.layout.contact_combinations))
    return ca.DM(sides).T @ ca.vertcat(*posterior.chances)


def join_posteriors(
    layout: Layout, groups: Sequence[Sequence[int]], posteriors: Sequence[Posterior]
) -> Posterior:
    """Return the posterior of all joints, with independent groups.

    Each group estimates the payload. The estimates are averaged with the inverses of their
    variances as weights, and their errors count as fully correlated.

    Args:
        layout: layout of all joints.
        groups: joints of each filter.
        posteriors: posterior of each group.
    """
    if len(posteriors) == 1:
        return posteriors[0]
    mean = ca.SX(layout.entry_count, 1)
    cov = ca.SX(layout.entry_count, layout.entry_count)
    news = ca.SX(layout.entry_count, 1)
    readings = sum(group.e.numel() for group in posteriors)
    e = ca.SX(readings, 1)
    std = ca.SX(readings, 1)
    for group, posterior in zip(groups, posteriors, strict=True):
        entries = group_entries(layout, group)
        rows = group_readings(group, layout.size, readings)
        mean[entries] = posterior.whole.mean
        cov[entries, entries] = posterior.whole.cov
        news[entries] = posterior.news
        e[rows] = posterior.e
        std[rows] = posterior.std
    payloads = [posterior.whole.mean[-1] for posterior in posteriors]
    variances = [ca.fmax(posterior.whole.cov[-1, -1], KNOWN) for posterior in posteriors]
    total = sum(1 / variance for variance in variances)
    mean[-1] = sum(p / variance for p, variance in zip(payloads, variances, strict=True)) / total
    cov[-1, :] = 0
    cov[:, -1] = 0
    cov[-1, -1] = (sum(1 / ca.sqrt(variance) for variance in variances) / total) ** 2
    return Posterior((), (), Gaussian(mean, cov), news, e, std)


def mix_posteriors(posteriors: Sequence[Posterior], shares: tuple[Any, Any]) -> Posterior:
    """Return the mixture of the posteriors of K filters for the same joints.

    Args:
        posteriors: posterior of each filter (K).
        shares: weights of the filters before and after the readings (K each).
    """
    if len(posteriors) == 1:
        return posteriors[0]
    before, after = map(ca.vertsplit, shares)
    weights = normalise_weights([ca.if_else(share > FAINT, share, 0.0) for share in after])
    chances: list[Any] = []
    beliefs: list[Gaussian] = []
    for weight, posterior in zip(weights, posteriors, strict=True):
        chances += [weight * chance for chance in posterior.chances]
        beliefs += posterior.beliefs
    whole = mix_gaussians(weights, [posterior.whole for posterior in posteriors])
    news = mean_of_models(weights, [posterior.news for posterior in posteriors])
    innovation = mixture_innovation(before, posteriors)
    return Posterior(tuple(chances), tuple(beliefs), whole, news, *innovation)


class Posture(NamedTuple):
    """Arm with all joints at their means.

    Attributes:
        gears: the arm.
        params: its parameters.
        q, v: angles [rad] and speeds [rad/s] of the links (N).
        closing: speeds of motors relative to links (N) [rad/s].
        push: torque of the motors less their friction (N) [N m].
        link_friction: friction and springs of the links (N) [N m].
        needed: torque at constant speed of the links: bias and friction (N) [N m].
        mass, inverse: M and M^-1 (N x N).
    """

    gears: Geared
    params: Any
    q: Any
    v: Any
    closing: Any
    push: Any
    link_friction: Any
    needed: Any
    mass: Any
    inverse: Any


def mean_posture(layout: Layout, gears: Geared, model: Any, mean: Any, u: Any) -> Posture:
    """Return the posture of an arm with all joints at their means.

    Args:
        layout: of the filter.
        gears: the arm.
        model: its parameters.
        mean: mean of x (entries).
        u: torque of the motors (N) [N m].
    """
    body = gears.arm
    params = substitute_estimates(layout, gears, model, mean)
    links = gears.link_params(params)
    q = mean[layout.slice_of("link")]
    v = mean[layout.slice_of("link_speed")]
    omega = mean[layout.slice_of("motor_speed")]
    friction = body.friction(links, v) + gears.return_torque(params, q)
    mass = ca.densify(body.mass(links, q))
    return Posture(
        gears=gears,
        params=params,
        q=q,
        v=v,
        closing=omega - v,
        push=u + mean[layout.slice_of("push")] - gears.motor_friction_torque(params, omega),
        link_friction=friction,
        needed=body.bias(links, q, v) + friction,
        mass=mass,
        inverse=solve_mass(mass, ca.DM.eye(gears.joint_count)),
    )


def apply_gear_impulses(
    groups: Sequence[Sequence[int]], posteriors: Sequence[Posterior], news: Any, arm: Posture
) -> list[Posterior]:
    """Return the posteriors of the groups after impulses in the gears of other groups.

    If readings correct the speed of a motor, its gears have transmitted another impulse than the
    predicted one, with the opposite effect on its link. Through M^-1 the impulse also moves the
    free links of other groups, which no reading shows. The own readings of links in contact show
    theirs.

    Args:
        groups: joints of each filter.
        posteriors: posterior of each group, after its own readings.
        news: change of the mean of x by the readings (entries).
        arm: posture at the mean.
    """
    layout = Layout(arm.gears.joint_count)
    inertia = arm.gears.gear_number(arm.params, "inertia")
    impulses = -PASSED * inertia * news[layout.slice_of("motor_speed")]
    speed_changes = (other_groups(groups, layout.size) * arm.inverse) @ impulses
    corrected = []
    for group, posterior in zip(groups, posteriors, strict=True):
        own = Layout(len(group))
        beliefs = list(posterior.beliefs)
        for place, contact in enumerate(own.contact_combinations):
            mean = ca.SX(beliefs[place].mean)
            for joint, side in enumerate(contact):
                if side == 0:
                    mean[own.slice_of("link_speed").start + joint] += speed_changes[group[joint]]
            beliefs[place] = Gaussian(mean, beliefs[place].cov)
        corrected.append(posterior._replace(beliefs=tuple(beliefs)))
    return corrected


def other_groups(groups: Sequence[Sequence[int]], size: int) -> ca.DM:
    """Return a matrix with 1 for joints of different groups, else 0 (size x size)."""
    apart = ca.DM.ones(size, size)
    for group in map(list, groups):
        apart[group, group] = 0
    return apart


def group_couplings(groups: Sequence[Sequence[int]], arm: Posture) -> Any:
    """Return the coupling of each joint to those of other groups (N) [1].

    It is `plants.robots.geared.Coupling.ratio` in one posture, of groups of one or two joints.

    Args:
        groups: joints of each filter.
        arm: posture at the mean.
    """
    ratios = ca.SX(arm.gears.joint_count, 1)
    for group in map(list, groups):
        locked = arm.mass[group, group]
        free = arm.inverse[group, group]
        # Largest eigenvalue of locked free, by trace and determinant: (2 x 2) at most.
        mean = ca.trace(locked @ free) / len(group)
        square = mean**2 - ca.det(locked) * ca.det(free) if len(group) > 1 else 0.0
        ratios[group] = mean + ca.sqrt(ca.fmax(square, 0.0))
    return ratios


class GearTorques(NamedTuple):
    """Moments of the torques through the gears.

    Attributes:
        chance: probability that a joint is in contact (N) [1].
        mean: mean of the torque (N) [N m].
        variance: variance of the torque (N) [N^2 m^2].
    """

    chance: Any
    mean: Any
    variance: Any


def gear_torques(
    drives: Sequence[Drive], parts: Sequence[Numbers], posteriors: Sequence[Posterior]
) -> GearTorques:
    """Return the moments of the torques through the gears at the start of a sample.

    They are moments over the modes. In a mode, only the torque that stops an impact is uncertain,
    as much as the impulse. The torque of a lasting contact counts as known: a stiff contact
    corrects its error at once. Otherwise the variances of two joints would increase each other.

    Args:
        drives: functions of each group.
        parts: parameters of each group's filter.
        posteriors: posterior of each group, after its readings.

    Returns:
        Moments in the order of the groups.
    """
    moments = []
    for drive, q, posterior in zip(drives, parts, posteriors, strict=True):
        layout = drive.layout
        chance, mean, square = (ca.SX.zeros(layout.size) for _ in range(3))
        contacts = itertools.cycle(layout.contact_combinations)
        modes = zip(contacts, posterior.chances, posterior.beliefs, strict=False)
        for contact, share, belief in modes:
            # The impact is over when motor and link have the same speed.
            after_impact = ca.SX(belief.mean)
            after_impact[layout.slice_of("motor_speed")] = after_impact[
                layout.slice_of("link_speed")
            ]
            tau = drive.rate(q.model, belief.mean, 0.0, contact)[1]
            stopping = tau - drive.rate(q.model, after_impact, 0.0, contact)[1]
            chance += share * ca.DM(contact) ** 2
            mean += share * tau
            square += share * (tau**2 + (q.impact * stopping) ** 2)
        moments.append((chance, mean, ca.fmax(square - mean**2, 0.0)))
    return GearTorques(*itertools.starmap(ca.vertcat, zip(*moments, strict=True)))


def update_group_numbers(
    groups: Sequence[Sequence[int]],
    isolated: Sequence[Geared],
    drives: Sequence[Drive],
    parts: Sequence[Numbers],
    posteriors: Sequence[Posterior],
    arm: Posture,
) -> list[Numbers]:
    """Return the parameters of each group's filter for the next sample.

    They contain the effect of the rest of the arm (see the module), and its uncertainty as process
    noise.

    Args:
        groups: joints of each filter.
        isolated: each group as an arm of its own.
        drives: functions of each group.
        parts: parameters of each group's filter, from those of all joints.
        posteriors: posterior of each group, after its readings.
        arm: posture at the mean.
    """
    gears = arm.gears
    N = gears.joint_count
    body = gears.arm
    links = gears.link_params(arm.params)
    names = body.names
    payload = links[names.index("payload")]
    own_parts = []
    for group, own, part in zip(groups, isolated, parts, strict=True):
        own_parts.append(part._replace(model=_group_parameters(gears, own, part.model, group)))
    torques = gear_torques(drives, own_parts, posteriors)
    order = [*itertools.chain(*groups)]
    torques = GearTorques(*(column[np.argsort(order).tolist()] for column in torques))
    mobility = _link_mobility(arm, groups, torques.chance)
    tau = _mean_gear_torques(arm, torques, drives[0])
    a = arm.inverse @ (tau - arm.needed)

    def inverse_dynamics(at: Any) -> Any:
        """Return the torques of the links for a, at angles and payload (N + 1) (N) [N m]."""
        column = ca.SX(links)
        column[names.index("payload")] = at[N]
        return body.mass(column, at[:N]) @ a + body.bias(column, at[:N], arm.v)

    # Accelerations (N) by angles and payload (N + 1).
    responses = mobility @ linearise(inverse_dynamics, ca.vertcat(arm.q, payload))[1]
    loads = ca.SX(N, 1)
    spans = ca.SX(N, 1)
    for group, part, posterior in zip(groups, parts, posteriors, strict=True):
        joints = list(group)
        loads[joints] = part.Q[Layout(len(group)).slice_of("link_speed")]
        spans[joints] = _link_variances(posterior.whole, len(group))
    apart = other_groups(groups, N)
    variances = CouplingVariances(torques.variance, loads, spans)
    noise = _coupling_variance(
        arm.inverse, mobility, responses[:, :N], apart, variances, drives[0].Ts
    )
    after = []
    for group, own, part in zip(groups, isolated, own_parts, strict=True):
        joints = list(group)
        size = len(group)
        mass = solve_mass(mobility[joints, joints], ca.DM.eye(size))
        slope = mass @ responses[joints, :]
        rest = {
            "mass": mass,
            "load": tau[joints] - arm.link_friction[joints] - mass @ a[joints],
            "slope": slope[:, joints],
            "place": arm.q[joints],
            "weight": slope[:, N],
        }
        for name, entries in _rest_names(size).items():
            for entry, value in zip(entries, ca.vertsplit(ca.vec(rest[name])), strict=True):
                part.model[own.names.index(entry)] = value
        part.model[own.names.index("carried")] = payload
        Q = ca.SX(part.Q)
        Q[Layout(size).slice_of("link_speed")] += noise[joints]
        after.append(part._replace(Q=Q))
    return after


def _group_parameters(gears: Geared, isolated: Geared, params: Any, group: Sequence[int]) -> Any:
    """Return the parameters of an isolated group, those of the rest of the arm still missing.

    Args:
        gears: the arm.
        isolated: the group as an arm of its own.
        params: parameters of the arm.
        group: the joints.
    """
    column = ca.SX(isolated.values)
    for place, joint in enumerate(group):
        for name in OWN:
            entry = isolated.names.index(f"{name}{place + 1}")
            column[entry] = params[gears.names.index(f"{name}{joint + 1}")]
    return column


def solve_mass(M: Any, right: Any) -> Any:
    """Return M^-1 times a matrix `right`, with M symmetric and positive definite."""
    return ca.ldl_solve(right, *ca.ldl(M))


def _link_mobility(arm: Posture, groups: Sequence[Sequence[int]], touching: Any) -> Any:
    """Return the mobility of the links: accelerations per torque (N x N) [1/(kg m^2) or 1/kg].

    A contact is stiff, so that a motor in contact moves with its link. Its inertia at the link is
    added to the mass matrix in proportion to the probability of contact. The motors of a row's own
    group are left out: the group's filter integrates these contacts itself.

    Args:
        arm: posture at the mean.
        groups: joints of each filter.
        touching: probability that a joint is in contact (N).
    """
    N = arm.gears.joint_count
    inertia = arm.gears.gear_number(arm.params, "inertia")
    mobility = ca.SX(N, N)
    for group in map(list, groups):
        added_inertia = touching * inertia
        added_inertia[group] = 0.0
        mobility[group, :] = solve_mass(arm.mass + ca.diag(added_inertia), ca.DM.eye(N)[:, group]).T
    return mobility


def _mean_gear_torques(arm: Posture, start: GearTorques, drive: Drive) -> Any:
    """Return the mean torques through the gears over a sample with constant contacts (N) [N m].

    The twist of each gear is integrated as if the joint were in contact. The torques of other
    joints count by the probability of their contact.

    Args:
        arm: posture at the mean.
        start: torques at the start of the sample.
        drive: functions of a group, for the sample time.
    """
    gears = arm.gears
    N = gears.joint_count
    Ts = drive.Ts
    inertia = gears.gear_number(arm.params, "inertia")
    K, damping = gears.contact_stiffness(arm.params)
    own = ca.diag(arm.inverse)
    others = arm.inverse - ca.diag(own)
    first = start.mean / ca.fmax(start.chance, NONE)  # torque of a joint in contact

    def rate(x: Any) -> Any:
        """Return the rate of gear twist, change of relative speed, and impulse (3N)."""
        twist = x[:N]
        speed = x[N : 2 * N]
        tau = first + K * twist + damping * speed
        link = own * tau + others @ (start.chance * tau) - arm.inverse @ arm.needed
        return ca.vertcat(arm.closing + speed, (arm.push - tau) / inertia - link, tau)

    h = Ts / drive.substeps
    g = GAMMA * h
    touching = ca.fmax(start.chance, LEAST)
    stiffness = g * K + damping  # of a contact over the step, spring and damper
    compliance = ca.diag(touching * (1 / stiffness + g / inertia + g * own))
    compliance += g * (touching @ touching.T) * others

    def solve(b: Any) -> Any:
        """Return (I - g A)^-1 b (3N), with A the Jacobian of the rate."""
        twist = b[:N]
        speed = b[N : 2 * N]
        impulse = b[2 * N :]
        tau = solve_mass(compliance, touching * (speed + K * twist / stiffness))
        speed = (tau - K * twist) / stiffness
        return ca.vertcat(twist + g * speed, speed, impulse + g * tau)

    total = ca.SX.zeros(3 * N)
    for _ in range(drive.substeps):
        total += rosenbrock_change(rate, solve, total, h)
    return start.chance * total[2 * N :] / Ts


class CouplingVariances(NamedTuple):
    """Variances of quantities of a joint that move the links of other joints.

    Attributes:
        torque: variance of the torque through the gears (N) [N^2 m^2].
        load: variance that its own unknown torque adds to a link's speed in a sample (N)
            [(rad/s)^2].
        span: variance of the angle of each link (N) [rad^2].
    """

    torque: Any
    load: Any
    span: Any


def _coupling_variance(
    inverse: Any, mobility: Any, responses: Any, apart: Any, of: CouplingVariances, Ts: float
) -> Any:
    """Return the variance that other groups add to each link speed in a sample (N) [(rad/s)^2].

    An error of a gear torque lasts for a sample, since readings correct it. An error of a link
    angle lasts for SLOW, so it counts as white noise of that intensity.

    Args:
        inverse: M^-1 (N x N).
        mobility: acceleration of each link by torques (N x N).
        responses: acceleration of each link by the angles of links (N x N).
        apart: 1 for joints of different groups, else 0 (N x N).
        of: variances of the joints.
        Ts: sample time [s].
    """
    N = apart.shape[0]
    by_torque = (apart * inverse**2) @ of.torque
    # A load at link j moves link i by mobility_ij / mobility_jj times as much as link j.
    by_load = (apart * (mobility / ca.repmat(ca.diag(mobility).T, N, 1)) ** 2) @ of.load
    by_angle = (apart * responses**2) @ of.span
    return by_load + Ts * (Ts * by_torque + SLOW * by_angle)


def _link_variances(belief: Gaussian, size: int) -> Any:
    """Return the variances of the link angles (size) [rad^2], limited by the gap.

    Whatever the estimate, a link is between its flanks.

    Args:
        belief: Gaussian of x of the group.
        size: number of joints of the group.
    """
    layout = Layout(size)
    variances = ca.diag(belief.cov)
    motor, link, half = map(layout.slice_of, ("motor", "link", "half"))
    bound = belief.mean[half] ** 2 + variances[half] + variances[motor]
    return ca.fmin(variances[link], bound)
