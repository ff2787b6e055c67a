"""Gaps of an arm's gears that the readings of a run determine, and why others cannot be known.

A gap shows when a load crosses it: a link that arrives at the other flank strikes its motor. Each
joint has to meet three conditions. Its link has to cross the gap. The strike has to show in the
readings of the encoder, against its noise and the unknown torque of the motor. And its coupling to
others must be weak enough to tell their effects on its link, in their gaps, from its own: joint by
joint they were noise, a gap of zero foretold best, and a Panda's gaps came out as zero
(docs/robot_gears.md). A joint that moves with one that is lost for its coupling is lost, too: the
second gap of an xArm came out 4.2 deviations off. Of a link that others push to and fro most
crossings have to show: it was lost by its filter where it floats, and the first gap of a Kinova
came out 14 deviations off. No motor may be too light for the sample time: friction of 0.4 N m on
1.4e-4 kg m^2 made the filters of an xArm chaotic, and two gaps of other joints came out 13 and 14
deviations off.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np

from undeadzone.analysis.identifiability.linear import WidthIdentifiability
from undeadzone.plants.robots.arm import Arm, evaluate_rows
from undeadzone.plants.robots.geared import EVEN, Geared, largest_couplings
from undeadzone.util.arrays import Flags, Floats, bounds_of_runs

SHARE = 0.02  # of the largest torque at a joint: a smaller one presses on no flank
LASTING = 0.05  # [s] that a torque must last to carry its link across
POSTURES = 721  # of a joint within a turn, among which one without torque is sought
COUPLED = 8.0  # coupling above which joint by joint a gap cannot be known
DETECTED = 3.0  # deviations of the innovations by which a strike shows
UNRESOLVED = 5.0  # sample times, over the time in which friction of a motor fades, at most
FLOATING = 0.7  # share of crossings that show, below which a coupled link floats
WINDOW = 0.15  # [s] for which a strike is looked for
SETTLED = 1e-6  # change of a variance by a sample, relative, below which it no longer changes
REASONS = {  # why a gap cannot be known, by the first condition that a joint does not meet
    "light": "friction stops the light motor of {light} (inertia {inertia:.2g}) within "
    "{samples:.2g} samples, which disturbs every filter: no gap can be known. Check its inertia "
    "and friction, or sample faster",
    "coupled": "turns about nearly the same axis as {partner} (coupling {ratio:.3g}): joint by "
    "joint its gap cannot be known; give observer.groups = [{group}], or move where their axes are "
    "apart",
    "with a lost one": "moves with {partner} (coupling {ratio:.3g}), whose own gap cannot be known "
    "for its coupling, as this one. Move to a posture in which its axis is apart from all others",
    "floating": "{quiet} of {crossed} crossings show no strike: its link floats in the gap, and "
    "joint by joint it is lost: its gap cannot be known. Turn it faster, or load it",
    "known": "",
    "hidden": "a strike changes the speed of its motor by {jump:.2g} {angle}/s at most, which "
    f"noise and unknown torque hide ({{shown:.2g}} of {DETECTED:g} deviations): its gap cannot be "
    "known. Turn it faster",
    "not crossed": "its link never crossed the gap: its gap cannot be known. Turn it faster",
}


def flank_visits(tau: Floats, step: float) -> Flags:
    """Return whether the load of each joint presses on its right and on its left flank
    (joints x 2).

    Args:
        tau: torque that the links need along the path (N x joints) [N m].
        step: between two rows [s].
    """
    least = SHARE * np.abs(tau).max(axis=0, initial=0.0)
    pressed = np.stack([tau > least, tau < -least], axis=2)
    lasting = [[_lasts(flank, step) for flank in joint.T] for joint in np.moveaxis(pressed, 1, 0)]
    return np.array(lasting, bool).reshape(len(least), 2)


def _lasts(flags: Flags, step: float) -> bool:
    """Return whether flags (N) have a run of at least LASTING seconds."""
    first, last = bounds_of_runs(flags)
    return bool(((last + 1 - first) * step >= LASTING).any())


def torques_along_path(gears: Geared, params: Floats, path: Floats) -> Floats:
    """Return the torque that links need along a path (N x joints) [N m].

    Args:
        gears: the arm.
        params: its parameters.
        path: positions, speeds and accelerations of its joints (N x 3 x joints).
    """
    q, v, a = (ca.SX.sym(name, gears.joint_count) for name in "qva")
    needed = ca.Function(
        "needed", [q, v, a], [gears.link_torque(ca.SX(params), q, v, a)], {"cse": True}
    )
    return np.asarray(needed.map(len(path))(*(path[:, k].T for k in range(3)))).T


def torque_free_position(body: Arm, params: Floats, q: Floats, i: int) -> float | None:
    """Return the position of joint i, nearest to q_i, without torque from gravity [rad], or
    None.

    Args:
        body: the arm.
        params: its parameters.
        q: the posture, in which the other joints stay (joints) [rad].
        i: the joint.

    Returns:
        The position within the joint's limits; None without one.
    """
    low, high = np.clip(body.chain.limits[i], q[i] - np.pi, q[i] + np.pi)
    places = np.linspace(low, high, POSTURES)
    postures = np.repeat(q[:, None], POSTURES, axis=1)
    postures[i] = places
    still = np.zeros_like(postures)
    columns = np.repeat(params[:, None], POSTURES, axis=1)
    load = np.asarray(body.bias.map(POSTURES)(columns, postures, still))[i]
    falls = np.flatnonzero(load[:-1] * load[1:] < 0)
    if not falls.size:
        return None
    share = load[falls] / (load[falls] - load[falls + 1])
    zeros = places[falls] + share * (places[falls + 1] - places[falls])
    return float(zeros[np.abs(zeros - q[i]).argmin()])


class StrikeDetector(NamedTuple):
    """Listener to the strikes of an arm's links.

    Attributes:
        groups: joints that one filter holds; the others are noise to it.
        torque: rms of the unknown torque of the motors (joints) [N m].
        lasting: correlation time of that torque [s].
        jerk: variance that the speed of a motor gains in a second besides [rad^2 / s^3].
        noise: rms of the readings of the motors (joints) [rad].
        crossing: w, of the way on which motors are led across a gap [1/s].
    """

    groups: Sequence[Sequence[int]]
    torque: Floats
    lasting: float
    jerk: float
    noise: Floats
    crossing: float


class Crossings(NamedTuple):
    """Times at which a link struck the other flank of its gap.

    Attributes:
        rows: of the motion (K).
        speeds: at which the gap closed (K) [rad/s].
    """

    rows: np.ndarray
    speeds: Floats


def list_crossings(gears: Geared, params: Floats, x: Floats) -> list[Crossings]:
    """Return the crossings of each joint's gap along a motion.

    Args:
        gears: the arm.
        params: its parameters.
        x: states (N x 4 joints).
    """
    N = gears.joint_count
    half, centre = (np.ravel(gears.gear_number(params, name)) for name in ("half", "centre"))
    ahead = x[:, :N] - x[:, N : 2 * N] + centre
    closing = np.abs(x[:, 2 * N : 3 * N] - x[:, 3 * N :])
    sides = 1 * (ahead >= half) - 1 * (ahead <= -half)
    found = []
    for i in range(N):
        touching = np.flatnonzero(sides[:, i])
        across = touching[1:][np.diff(sides[touching, i]) != 0]
        found.append(Crossings(across, closing[np.maximum(across - 1, 0), i]))
    return found


class MotorFilter(NamedTuple):
    """Filter of a motor's angle, speed and unknown torque by its readings, once it has settled.

    Attributes:
        A: step of the three (3 x 3).
        gain: of the readings (3).
        std: of an innovation [rad].
    """

    A: Floats
    gain: Floats
    std: float


def motor_filter(
    inertia: float, torque: float, noise: float, detector: StrikeDetector, Ts: float
) -> MotorFilter:
    """Return the filter of a motor.

    Args:
        inertia: of the motor [kg m^2].
        torque: rms of its unknown torque [N m].
        noise: rms of a reading [rad].
        detector: the listener.
        Ts: sample time [s].
    """
    fade = np.exp(-Ts / detector.lasting)
    A = np.array([[1.0, Ts, Ts**2 / 2], [0.0, 1.0, Ts], [0.0, 0.0, fade]])
    pushed = (1 - fade**2) * (torque / inertia) ** 2
    Q = np.diag([0.0, detector.jerk * Ts, pushed])
    P = np.diag([noise**2, 1.0, (torque / inertia) ** 2])
    before = np.inf
    while abs(P[0, 0] - before) > SETTLED * P[0, 0]:
        before = P[0, 0]
        gain = P[:, 0] / (P[0, 0] + noise**2)
        P = A @ (P - np.outer(gain, P[0])) @ A.T + Q
    variance = P[0, 0] + noise**2
    return MotorFilter(A, P[:, 0] / variance, float(np.sqrt(variance)))


def strike_response(
    inertia: float, torque: float, noise: float, detector: StrikeDetector, Ts: float
) -> float:
    """Return by how many deviations a unit jump of a motor's speed shows in its readings [s/rad].

    It is the matched filter's ratio of signal to noise, of the innovations of `motor_filter`, which
    has the arguments.
    """
    listener = motor_filter(inertia, torque, noise, detector, Ts)
    jump = np.array([0.0, 1.0, 0.0])
    energy = 0.0
    for _ in range(round(WINDOW / Ts)):
        jump = listener.A @ jump
        energy += (jump[0] / listener.std) ** 2
        jump = jump - listener.gain * jump[0]
    return float(np.sqrt(energy))


def gap_identifiability(
    gears: Geared,
    params: Floats,
    x: Floats,
    path: Floats,
    step: float,
    detector: StrikeDetector,
    narrow: Callable[[int], bool],
) -> list[WidthIdentifiability]:
    """Return the identifiability of each joint's gap from the readings of a run.

    A motor that crosses a gap faster than planned is driven by a belief in a wider one: it counts
    as fast as planned, with both poles at -w and a top speed of 2 half w / e.

    Args:
        gears: the arm.
        params: its parameters.
        x: states along the run (N x 4 joints).
        path: positions, speeds and accelerations of its joints (N x 3 x joints).
        step: between two rows [s].
        detector: the listener.
        narrow: whether the readings narrow the gap of a joint that crosses it, yet strikes unheard.
    """
    body = gears.arm
    links = gears.link_params(params)
    tau = torques_along_path(gears, params, path)
    inertia = np.ravel(gears.gear_number(params, "inertia"))
    half = np.ravel(gears.gear_number(params, "half"))
    coupling = largest_couplings(body, links, path[:, 0], detector.groups)
    visits = flank_visits(tau, step)
    friction = np.ravel(gears.gear_number(params, "friction"))
    fading = friction * step / (inertia * gears.rest)
    lightest = int(np.argmax(fading))
    behind = link_inertias(gears, params, x[:, inertia.size : 2 * inertia.size])
    verdicts = []
    for i, found in enumerate(list_crossings(gears, params, x)):
        planned = 2 * half[i] * detector.crossing / np.e
        link = behind[found.rows, i]
        strikes = link / (inertia[i] + link) * np.fmin(found.speeds, planned)
        if gears.measured == "motor":
            unit = strike_response(
                inertia[i], detector.torque[i], detector.noise[i], detector, step
            )
        else:  # an encoder at the link tells where it is
            unit = np.inf
        detected = int(np.count_nonzero(unit * strikes >= DETECTED))
        ratio, partner = coupling[i].ratio, coupling[i].partner
        jump = float(strikes.max(initial=0.0))
        cases = {
            "light": fading[lightest] > UNRESOLVED,
            "coupled": ratio > COUPLED,
            "with a lost one": ratio > EVEN and coupling[partner].ratio > COUPLED,
            "floating": detected < FLOATING * found.rows.size and detected and ratio > EVEN,
            "known": detected,
            "hidden": found.rows.size,
            "not crossed": visits[i].all(),
        }
        case = next((name for name, holds in cases.items() if holds), None)
        if case is None:
            place = torque_free_position(body, links, path[:, 0].mean(axis=0), i)
            why = _gap_reasons(place, "" if body.chain.slides else " rad")
        else:
            why = REASONS[case].format(
                light=body.chain.joints[lightest],
                inertia=inertia[lightest],
                samples=1 / max(fading[lightest], UNRESOLVED),
                partner=body.chain.joints[partner],
                ratio=ratio,
                group=sorted((i, partner)),
                quiet=found.rows.size - detected,
                crossed=found.rows.size,
                jump=jump,
                shown=unit * jump,
                angle="m" if body.chain.slides else "rad",
            )
        known = not why
        whys = (why,) if why else ()
        verdict = WidthIdentifiability(known, known, known, known, whys, crossings=detected)
        verdicts.append(verdict._replace(narrowed=case == "hidden" and narrow(i)))
    return verdicts


def link_inertias(gears: Geared, params: Floats, q: Floats) -> Floats:
    """Return the inertia that each motor feels behind its gears (K x N) [kg m^2].

    The gears of the other joints are taken to be closed: so they are nearly always.

    Args:
        gears: the arm.
        params: its parameters.
        q: postures (K x N).
    """
    motors = np.ravel(gears.gear_number(params, "inertia"))
    M = evaluate_rows(gears.arm.mass, gears.link_params(params), q)
    together = np.linalg.inv(M.reshape(-1, motors.size, motors.size) + np.diag(motors))
    return 1 / np.diagonal(together, axis1=1, axis2=2) - motors


def _gap_reasons(place: float | None, unit: str) -> str:
    """Describe why a gap is not identifiable, and the remedy.

    place, unit: position without torque by gravity.
    """
    what = "held on one flank: its gap cannot be known"
    if place is None:
        return f"{what}, and gravity changes its load nowhere: turn it to and fro faster"
    return f"{what}. Swing it through {place:.3g}{unit}, at which it carries no load"
