"""Contact sides of a joint's gears along a path, and the motion that would visit both.

A gap shows where the load crosses it: where the torque tau = M(q) a + h(q, v) that a link needs
changes sign. A joint that gravity holds on one flank is offset by half a gap that no reading tells
from its centre (docs/robots.md).
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from undeadzone.analysis.identifiability.linear import WidthIdentifiability
from undeadzone.plants.robots.arm import Arm, inverse_dynamics
from undeadzone.util.arrays import Flags, Floats, bounds_of_runs

SHARE = 0.02  # of the largest torque at a joint: a smaller one presses on no flank
FRICTION_SHARE = (
    0.2  # of a motor's friction: what its encoder tells of a smaller load is lost in that
)
LASTING = 0.05  # [s] that a torque must last to carry its link across
POSTURES = 721  # of a joint within a turn, among which one without torque is sought


class FlankVisits(NamedTuple):
    """Contact sides of a joint's gears along a path.

    Attributes:
        right, left: whether its load presses on that flank.
        changes: how often the flank changes.
    """

    right: bool
    left: bool
    changes: int


def flank_visits(tau: Floats, step: float, unheard: Floats) -> list[FlankVisits]:
    """Return the contact sides that each joint visits.

    Args:
        tau: torque that the links need along the path (N x joints) [N m].
        step: between two rows [s].
        unheard: of each joint, up to which no reading tells a load (joints) [N m].
    """
    least = np.maximum(SHARE * np.abs(tau).max(axis=0, initial=0.0), unheard)
    told = []
    for load, small in zip(tau.T, least, strict=True):
        pressed = 1 * _keep_lasting_runs(load > small, step) - 1 * _keep_lasting_runs(
            load < -small, step
        )
        flanks = pressed[pressed != 0]
        changes = int(np.count_nonzero(np.diff(flanks)))
        told.append(FlankVisits(bool((flanks > 0).any()), bool((flanks < 0).any()), changes))
    return told


def _keep_lasting_runs(flags: Flags, step: float) -> Flags:
    """Return the flags that belong to a run of at least LASTING seconds (N, bool)."""
    kept = np.zeros_like(flags)
    for first, last in zip(*bounds_of_runs(flags), strict=True):
        kept[first : last + 1] = (last + 1 - first) * step >= LASTING
    return kept


def torques_along_path(body: Arm, params: Floats, path: Floats) -> Floats:
    """Return the torque that links need along a path (N x joints) [N m].

    Args:
        body: the arm.
        params: its parameters.
        path: positions, speeds and accelerations of its joints (N x 3 x joints).
    """
    q, v, a = (ca.SX.sym(name, body.joint_count) for name in "qva")
    needed = ca.Function(
        "needed", [q, v, a], [inverse_dynamics(body, ca.SX(params), q, v, a)], {"cse": True}
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
        The position within the joint's limits; None where there is none.
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


def gap_identifiability(
    body: Arm, params: Floats, path: Floats, step: float, friction: Floats
) -> list[WidthIdentifiability]:
    """Return the identifiability of each joint's gap from readings along a path.

    Args:
        body: the arm.
        params: its parameters.
        path: positions, speeds and accelerations of its joints (N x 3 x joints).
        step: between two rows [s].
        friction: of the motors; 0 where encoders read the links (joints) [N m].
    """
    mean, tau, unheard = (
        path[:, 0].mean(axis=0),
        torques_along_path(body, params, path),
        FRICTION_SHARE * friction,
    )
    most, slides, verdicts = np.abs(tau).max(axis=0, initial=0.0), body.chain.slides, []
    for i, joint in enumerate(flank_visits(tau, step, unheard)):
        known = joint.right and joint.left
        why = (
            "" if known or most[i] >= unheard[i] else _friction_reason(most[i], friction[i], slides)
        )
        if not (known or why):
            why = _gap_reasons(
                torque_free_position(body, params, mean, i), "" if slides else " rad"
            )
        verdicts.append(
            WidthIdentifiability(known, known, known, known, reasons=(why,) if why else ())
        )
    return verdicts


def _friction_reason(most: float, friction: float, slides: bool) -> str:
    """Describe that a motor's friction hides the largest torque of its link."""
    unit = "" if slides else " N m"
    asks = f"its link asks for {most:.2g}{unit} at most"
    hides = f"friction of its motor, {friction:.2g}{unit}, hides"
    return f"{asks}, which {hides}: its gap cannot be known; turn it faster"


def _gap_reasons(place: float | None, unit: str) -> str:
    """Describe why a gap is not identifiable, and the remedy.

    place, unit: where gravity asks the joint for no torque.
    """
    what = "held on one flank: its gap cannot be known"
    if place is None:
        return f"{what}, nor does gravity change its load anywhere: turn it to and fro faster"
    return f"{what}; swing it through {place:.3g}{unit}, where it carries no load"
