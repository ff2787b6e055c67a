"""What the filter of contacts asks of an arm: of all its joints at once, or joint by joint.

At once N joints have 3^N modes; joint by joint they have 3 N. Each joint then has the filter of an
arm of one link, to which the rest of the arm is numbers of the sample: its link moves by

    m (q'' - a0) = tau - tau0 - (friction - friction0) - slope (q - q0) - weight (payload - p0)

with m = 1 / (M^-1)_ii, which is what a link feels of its own torque while the other gears transmit
theirs. a0 = M^-1 (tau0 - h - friction0) is its acceleration with all joints in the mean, and tau0
the mean of the torques over the sample. By as much as the torques of the others are uncertain, a
link is pushed at random.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.numerics.gaussian import Gaussian, linearise
from undeadzone.numerics.runge_kutta import rk4_change
from undeadzone.observers.parts.contact_modes import (
    CONSTANTS,
    NONE,
    QUANTITIES,
    Contacts,
    Drive,
    Layout,
    Modes,
    Numbers,
    Told,
)
from undeadzone.plants.robots.arm import Chain
from undeadzone.plants.robots.geared import Geared, Gears, geared_motion

FADING = 0.2  # correlation time of the unknown torque of motors [s]
LASTING = 0.01  # time for which the unknown torque of links lasts [s]
SOON = 1e-2  # time after which readings tell whether a joint touched [s]
SLOW = 0.05  # time for which the place of another link is off [s]
KNOWN = 1e-9  # variance of a payload that is known [kg^2]
REST = ("mass", "load", "slope", "place", "weight", "carried")  # what a joint knows of its arm
FREE = np.full(1, np.inf)


def drive_of(gears: Geared, Ts: float, substeps: int) -> Drive:
    """What the filter asks of an arm with gears.

    Args:
        gears: the arm.
        Ts: sample time [s].
        substeps: Runge-Kutta steps in a sample.
    """
    N, layout = gears.size, Layout(gears.size)

    def rate(params: Any, x: Any, u: Any, contact: Contacts) -> tuple[Any, Any]:
        push = x[layout.of("push")]
        column = believed(gears, params, x)
        dx, tau = gears.motion(column, x[: 4 * N], u + push, ca.DM(contact))
        constant = ca.SX.zeros(5 * N)
        return ca.vertcat(dx, constant, -push / FADING, 0.0), tau

    def mobility(params: Any, x: Any) -> Any:
        column = believed(gears, params, x)
        M = ca.densify(gears.arm.mass(gears.links(column), x[layout.of("link")]))
        return ca.vertcat(-ca.diag(1 / gears.number(column, "inertia")), ca.inv(M))

    motors, links = tuple(range(N)), tuple(range(N, 2 * N))
    readings = {"motor": motors, "link": links, "both": (*links, *motors)}[gears.measured]
    return Drive(layout, rate, mobility, readings, Ts, substeps)


def believed(gears: Geared, params: Any, x: Any) -> Any:
    """The parameters of an arm with gears, with what a filter makes of them.

    Args:
        gears: the arm.
        params: as the model says.
        x: unknowns of the filter.
    """
    N, layout = gears.size, Layout(gears.size)
    column = ca.SX(params)
    for name in CONSTANTS:
        first = gears.names.index(f"{name}1")
        column[first : first + N] = x[layout.of(name)]
    first = gears.names.index("contact1")
    column[first : first + N] *= ca.exp(x[layout.of("firmness")])
    column[gears.names.index("payload")] = x[layout.of("payload")]
    return column


def alone(gears: Geared, joint: int) -> Geared:
    """One joint of an arm with gears, as an arm of one link that knows the rest by numbers."""

    def bias(p: Any, q: Any, _: Any) -> Any:
        carried = p["weight"] * (p["payload"] - p["carried"])
        return p["load"] + p["slope"] * (q - p["place"]) + carried

    link = Chain(
        joints=gears.arm.chain.joints[joint : joint + 1],
        parameters=dict.fromkeys((*REST, "payload"), 1.0),
        mass=lambda p, _: p["mass"],
        bias=bias,
        points=lambda _, __: ca.SX.zeros(1, 3),
        turn=lambda _, __: ca.SX.eye(3),
        gravity=lambda _: ca.SX.zeros(3),
        plane=(0, 1),
        limits=np.array([[-np.inf, np.inf]]),
        torque=FREE,
        speed=FREE,
        friction=np.zeros((2, 1)),
    )
    one = geared_motion(link, Gears(half=0.0, inertia=1.0, measured=gears.measured), gears.rest)
    here = slice(joint, joint + 1)
    return one._replace(stiffness=gears.stiffness[here], damping=gears.damping[here])


def places(layout: Layout, joint: int) -> list[int]:
    """Where the quantities of one joint stand among those of all, in the order of `Layout(1)`."""
    return [*(layout.of(name).start + joint for name in QUANTITIES), layout.entries - 1]


def part_of(q: Numbers, layout: Layout, joint: int, count: int) -> Numbers:
    """The numbers of one of so many filters: all, or those of a joint."""
    if count == 1:
        return q
    here = places(layout, joint)
    return q._replace(
        Q=q.Q[here],
        R=q.R[joint::count],
        low=q.low[here],
        high=q.high[here],
        torque=q.torque[joint],
        rest=q.rest[joint],
        least=q.least[joint],
    )


def touching(drive: Drive, told: Told) -> Any:
    """The chance of the right flank less that of the left one, of each joint of a filter."""
    return ca.DM([list(mode) for mode in drive.layout.modes]).T @ ca.vertcat(*told.chances)


def together(layout: Layout, told: Sequence[Told]) -> Told:
    """What is known of all joints, as if what each does not know had no relation.

    Each joint has a payload of its own. One is shown: each counts by its variance, and their errors
    are taken to be one and the same.
    """
    if len(told) == 1:
        return told[0]
    mean, cov = ca.SX(layout.entries, 1), ca.SX(layout.entries, layout.entries)
    for joint, one in enumerate(told):
        here = places(layout, joint)
        mean[here], cov[here, here] = one.whole.mean, one.whole.cov
    payloads = [one.whole.mean[-1] for one in told]
    variances = [ca.fmax(one.whole.cov[-1, -1], KNOWN) for one in told]
    total = sum(1 / variance for variance in variances)
    mean[-1] = sum(p / variance for p, variance in zip(payloads, variances, strict=True)) / total
    cov[-1, :], cov[:, -1] = 0, 0
    cov[-1, -1] = (sum(1 / ca.sqrt(variance) for variance in variances) / total) ** 2
    e = ca.vec(ca.horzcat(*(one.e for one in told)).T)
    std = ca.vec(ca.horzcat(*(one.std for one in told)).T)
    return Told([], [], Gaussian(mean, cov), e, std)


def passed_on(
    gears: Geared, q: Numbers, were: Sequence[Modes], told: Sequence[Told], mean: Any
) -> list[Told]:
    """What the readings of one joint say of its contact, as free links of other joints feel it.

    A joint that touches or not has pushed its link and the others, in the ratio of (M^-1)_ij to
    (M^-1)_jj. As its modes gain and lose by its readings, so the others have moved.
    """
    N, layout, body = gears.size, Layout(gears.size), gears.arm
    links = gears.links(believed(gears, q.model, mean))
    D, L, order = ca.ldl(ca.densify(body.mass(links, mean[layout.of("link")])))
    inverse = ca.ldl_solve(ca.SX.eye(N), D, L, order)
    one = Layout(1)
    entries = [one.of(name).start for name in ("link", "link_speed")]
    news = []
    for modes, now in zip(were, told, strict=True):
        changes = ca.vertcat(*now.chances) - modes.chances
        means = ca.horzcat(*(belief.mean[entries] for belief in now.beliefs))
        news.append((means @ changes).T)
    ratio = inverse / ca.repmat(ca.diag(inverse).T, N, 1) - ca.DM.eye(N)
    shifts = ratio @ ca.vertcat(*news)
    free, after = one.modes.index((0,)), []
    for joint, now in enumerate(told):
        belief = now.beliefs[free]
        moved = ca.SX(belief.mean)
        moved[entries] += shifts[joint, :].T
        beliefs = list(now.beliefs)
        beliefs[free] = belief._replace(mean=moved)
        after.append(now._replace(beliefs=beliefs))
    return after


class Pressed(NamedTuple):
    """What is known of the torques through the gears.

    Attributes:
        chance: that a joint is in contact (N).
        mean: of the torque (N) [N m].
        variance: of the torque (N).
    """

    chance: Any
    mean: Any
    variance: Any


def pressed(drives: Sequence[Drive], parts: Sequence[Numbers], told: Sequence[Told]) -> Pressed:
    """The torques at the beginning of a sample; what stops a strike is as uncertain as that one.

    Args:
        drives: of each joint.
        parts: numbers of each joint.
        told: of each joint, after its readings.
    """
    each = []
    for drive, q, one in zip(drives, parts, told, strict=True):
        chance, mean, square = ca.SX(0.0), ca.SX(0.0), ca.SX(0.0)
        modes = zip(drive.layout.modes, one.chances, one.beliefs, strict=True)
        for contact, share, belief in modes:
            together = ca.SX(belief.mean)
            together[drive.layout.of("motor_speed")] = together[drive.layout.of("link_speed")]
            tau = drive.rate(q.model, belief.mean, 0.0, contact)[1]
            sudden = tau - drive.rate(q.model, together, 0.0, contact)[1]
            chance += share * abs(contact[0])
            mean += share * tau
            square += share * (tau**2 + (q.impact * sudden) ** 2)
        each.append((chance, mean, ca.fmax(square - mean**2, 0.0)))
    return Pressed(*(ca.vertcat(*column) for column in zip(*each, strict=True)))


def surroundings(
    gears: Geared,
    drives: Sequence[Drive],
    ones: Sequence[Geared],
    q: Numbers,
    parts: Sequence[Numbers],
    told: Sequence[Told],
    mean: Any,
    u: Any,
) -> list[Numbers]:
    """The numbers of each joint's filter in a sample: what it knows of the rest of its arm.

    Args:
        gears: the arm.
        drives: of each joint.
        ones: each joint `alone`.
        q: numbers of all.
        told: of each joint, after its readings.
        mean: of all unknowns.
        u: torque of the motors (N).
    """
    N, layout, body, Ts = gears.size, Layout(gears.size), gears.arm, drives[0].Ts
    params = believed(gears, q.model, mean)
    links = gears.links(params)
    place, turning, v = (mean[layout.of(name)] for name in ("link", "motor_speed", "link_speed"))
    held = body.friction(links, v)
    D, L, order = ca.ldl(ca.densify(body.mass(links, place)))
    inverse = ca.ldl_solve(ca.SX.eye(N), D, L, order)
    columns = [_column(gears, one, q.model, joint) for joint, one in enumerate(ones)]
    parts = [q._replace(model=one) for q, one in zip(parts, columns, strict=True)]
    now = pressed(drives, parts, told)
    push = u + mean[layout.of("push")] - gears.friction(params, turning)
    moved = _moved(gears, params, body.mass(links, place), now.chance)
    own = ca.diag(moved)
    tau = _lasting(gears, params, now, turning - v, inverse, push, body.bias(links, place, v) + held, drives[0])
    a = inverse @ (tau - body.bias(links, place, v) - held)
    carried = mean[layout.of("payload")]

    def needed(at: Any) -> Any:
        column = ca.SX(links)
        column[body.names.index("payload")] = at[N]
        return body.mass(column, at[:N]) @ a + body.bias(column, at[:N], v)

    slopes = moved @ linearise(needed, ca.vertcat(place, carried))[1] / ca.repmat(own, 1, N + 1)
    load = tau - held - a / own
    apart = 1 - ca.DM.eye(N)
    shaken = Ts * SOON * (apart * inverse**2) @ now.variance
    speed = QUANTITIES.index("link_speed")
    shaken += (apart * (moved / ca.repmat(own.T, N, 1)) ** 2) @ ca.vertcat(*(p.Q[speed] for p in parts))
    spans = ca.vertcat(*(_span(one.whole) for one in told))
    shaken += Ts * SLOW * own**2 * ((apart * slopes[:, :N] ** 2) @ spans)
    numbers = []
    for joint, one in enumerate(ones):
        column = columns[joint]
        known = (1 / own[joint], load[joint], slopes[joint, joint], place[joint], slopes[joint, N])
        for name, value in zip(REST, (*known, carried), strict=True):
            column[one.names.index(name)] = value
        Q = ca.SX(parts[joint].Q)
        Q[QUANTITIES.index("link_speed")] += shaken[joint]
        numbers.append(parts[joint]._replace(model=column, Q=Q))
    return numbers


def _moved(gears: Geared, params: Any, M: Any, touching: Any) -> Any:
    """Acceleration of each link by torques (N x N), others turning their motors where they touch."""
    N, inertia, rows = gears.size, gears.number(params, "inertia"), []
    for joint in range(N):
        turned = touching * inertia
        turned[joint] = 0.0
        D, L, order = ca.ldl(ca.densify(M + ca.diag(turned)))
        rows.append(ca.ldl_solve(ca.DM.eye(N)[:, joint], D, L, order).T)
    return ca.vertcat(*rows)


def _span(belief: Gaussian) -> Any:
    """The variance of a link, which is not beyond its flanks for long (1)."""
    layout = Layout(1)
    motor, link, half = (layout.of(name).start for name in ("motor", "link", "half"))
    bound = belief.mean[half] ** 2 + belief.cov[half, half] + belief.cov[motor, motor]
    return ca.fmin(belief.cov[link, link], bound)


def _column(gears: Geared, one: Geared, params: Any, joint: int) -> Any:
    """The parameters of one joint alone, without what it knows of the rest."""
    column = ca.SX(one.values)
    for place, name in enumerate(one.names):
        if name.endswith("1"):
            column[place] = params[gears.names.index(f"{name[:-1]}{joint + 1}")]
    return column


def _lasting(
    gears: Geared,
    params: Any,
    now: Pressed,
    closing: Any,
    inverse: Any,
    push: Any,
    needed: Any,
    drive: Drive,
) -> Any:
    """The mean torques through the gears over a sample (N), of joints that stay as they are.

    A joint that touches feels its own torque, and those of others by the chance that they touch.
    """
    N, h = gears.size, drive.Ts / drive.substeps
    frequency, inertia = (gears.number(params, name) for name in ("contact", "inertia"))
    K, damping = gears.stiffness * frequency**2, gears.damping * frequency
    others = inverse - ca.diag(ca.diag(inverse))
    first = now.mean / ca.fmax(now.chance, NONE)

    def rate(x: Any, _: float) -> Any:
        wound, faster = x[:N], x[N : 2 * N]
        tau = first + K * wound + damping * faster
        link = ca.diag(inverse) * tau + others @ (now.chance * tau) - inverse @ needed
        return ca.vertcat(closing + faster, (push - tau) / inertia - link, tau)

    total = ca.SX.zeros(3 * N)
    for _ in range(drive.substeps):
        total += rk4_change(rate, total, h)
    return now.chance * total[2 * N :] / drive.Ts
