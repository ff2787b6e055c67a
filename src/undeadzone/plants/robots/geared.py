"""Arms whose motors move their links through gears with a gap: two masses a joint.

theta is a motor's angle at the joint's side of its gears, q the link's, a half of the gap:

    xi = theta - q + c
    tau = K Dz(xi, a) + D (theta' - q')  where |xi| > a, else 0
    J theta'' + b_m theta' + f_m sat(theta') = u - tau
    M(q) q'' + h(q, q') + friction + spring = tau

A belt, a shaft or a flexspline of stiffness k in series with the contact takes its share of xi: K
becomes s K and D becomes s^2 D, with s = 1 / (1 + K / k).

The gap is in the transmission, not in the sensor: an encoder at either side reads linearly, and
the flank that touches follows from motion, gravity and torque (Nordin and Gutman 2002).

References:
    M. Nordin, P.-O. Gutman (2002), doi:10.1016/S0005-1098(02)00047-X
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.linalg.matrices import spectral_radius
from undeadzone.plants.robots.arm import (
    Arm,
    Chain,
    build_arm,
    change_arm_numbers,
    forward_dynamics,
    inverse_dynamics,
)
from undeadzone.util.arrays import (
    Array,
    Floats,
    require_nonnegative,
    require_number,
    require_positive,
    require_vector,
)
from undeadzone.util.toml import OptionTable

PLACES = 50  # of a motion at which masses are looked at
EVEN = 2.0  # coupling up to which what other joints do to a link is mere noise
GEAR_CHECKS = {  # of the numbers of gears that are parameters
    "half": require_nonnegative,
    "centre": require_vector,
    "inertia": require_positive,
    "friction": require_nonnegative,
    "viscous": require_nonnegative,
    "contact": require_positive,
    "asymmetry": require_vector,
    "pull": require_vector,
    "spring": require_vector,
    "hardening": require_vector,
    "spring_at": require_vector,
    "drag": require_nonnegative,
}
GEAR_NUMBERS = (*GEAR_CHECKS, "winding")
TINY = 1e-3  # speed at which friction is linear, over that at which it fades


class Gears(OptionTable, frozen=True, kw_only=True):
    """Gears with a gap between motors and links, each array a number or a value per joint (N).

    Attributes:
        half: half of the gap, as the link can turn to either side while the motor is held [rad].
        inertia: of the motor as felt at the joint, gear ratio squared times the rotor's [kg m^2].
        centre: c, by which the motor's encoder reads less than the link's angle if the link stands
            in the middle of the gap [rad].
        contact: natural frequency of motor against link in contact, all joints at 0, no payload
            [rad/s].
        damping: ratio of damping in contact.
        friction: Coulomb friction of the motor [N m].
        viscous: viscous friction of the motor [N m s/rad].
        stiffness: of a belt, a shaft or a flexspline in series with the contact, as its datasheet
            has it [N m/rad] (default: infinite). Its parameter is `winding`, 1 / stiffness.
        asymmetry: friction of the motor is larger by so much to the right, and smaller to the left
            [N m].
        pull, spring, hardening: the link is pulled back by pull + spring d + hardening d^3, with
            d = q - spring_at: a return spring, a hose, or a gravity that bends, of either sign
            [N m, N m/rad, N m/rad^3].
        spring_at: position about which the spring is given [rad].
        drag: viscous drag between motor and link, of oil in the gap [N m s/rad].
        measured: place of the encoder: at the motor, at the link, or one at both.
    """

    half: Array
    inertia: Array
    centre: Array = 0.0
    contact: Array = 400.0
    damping: float = 0.7
    friction: Array = 0.0
    viscous: Array = 0.0
    stiffness: Array | None = None
    asymmetry: Array = 0.0
    pull: Array = 0.0
    spring: Array = 0.0
    hardening: Array = 0.0
    spring_at: Array = 0.0
    drag: Array = 0.0
    measured: Literal["motor", "link", "both"] = "motor"


class Geared(NamedTuple):
    """Arm with gears, as pure functions of expressions.

    The state is x = `[theta; q; theta'; q']` (4 N). The parameters stand in a column in the order
    of `names`: half gaps, centres, friction and payload may be numbers or states of a filter.

    Attributes:
        arm: the links, with payload and friction. Its parameters come first in the column.
        names: names of the parameters: those of the arm, then half1, half2, ..., centre1, ...
        values: their values.
        stiffness: of the contacts, by their squared frequency (N) [kg m^2].
        damping: of the contacts, by their frequency (N) [kg m^2].
        rest: speed below which the motors' Coulomb friction fades [rad/s].
        measured: place of the encoders.
    """

    arm: Arm
    names: tuple[str, ...]
    values: Floats
    stiffness: Floats
    damping: Floats
    rest: float
    measured: Literal["motor", "link", "both"]

    @property
    def joint_count(self) -> int:
        """Return the number of joints."""
        return self.arm.joint_count

    def link_params(self, params: Any) -> Any:
        """Return the parameters of `arm` in a column of parameters."""
        return params[: len(self.arm.names)]

    def gear_number(self, params: Any, name: str) -> Any:
        """Return a number of the gears, such as "half", in a column of parameters (N)."""
        first = self.names.index(f"{name}1")
        return params[first : first + self.joint_count]

    def follow(self, params: Any) -> Geared:
        """Return the gears with contacts of the same frequency and ratio of damping at the
        inertias in a column of parameters.
        """
        payload = self.arm.names.index("payload")
        links = ca.vertcat(params[:payload], 0.0, self.link_params(params)[payload + 1 :])
        link = ca.diag(self.arm.mass(links, ca.DM.zeros(self.joint_count)))
        motor = self.gear_number(params, "inertia")
        reduced = motor * link / (motor + link)
        return self._replace(stiffness=reduced, damping=self.damping / self.stiffness * reduced)

    def gear_angle(self, params: Any, x: Any) -> Any:
        """Return xi, by which the motors are ahead of their links (N) [rad] (|xi| > half in
        contact).
        """
        N = self.joint_count
        return x[:N] - x[N : 2 * N] + self.gear_number(params, "centre")

    def gap_widths(self, params: Any) -> tuple[Any, Any]:
        """Return (right, left), the largest lead and lag of each link relative to its
        motor [rad].

        right = half + centre, left = half - centre. Of encoders at motors and links (2 N) those at
        the motors come last, with 0.
        """
        half = self.gear_number(params, "half")
        centre = self.gear_number(params, "centre")
        motors = ca.DM.zeros(self.joint_count if self.measured == "both" else 0)
        return ca.vertcat(half + centre, motors), ca.vertcat(half - centre, motors)

    def motor_friction_torque(self, params: Any, turning: Any) -> Any:
        """Return the torque of friction at motors of these speeds (N) [N m]."""
        sliding = turning / ca.sqrt(turning**2 + self.rest**2)
        viscous = self.gear_number(params, "viscous") * turning
        leaning = self.gear_number(params, "asymmetry") * sliding**2
        return viscous + self.gear_number(params, "friction") * sliding + leaning

    def return_torque(self, params: Any, q: Any) -> Any:
        """Return the torque by which springs pull the links back (N) [N m]."""
        pull, spring, hardening, place = (
            self.gear_number(params, name) for name in ("pull", "spring", "hardening", "spring_at")
        )
        turned = q - place
        return pull + turned * (spring + hardening * turned**2)

    def link_torque(self, params: Any, q: Any, v: Any, a: Any) -> Any:
        """Return the torque that the links need for an acceleration (N) [N m]."""
        needed = inverse_dynamics(self.arm, self.link_params(params), q, v, a)
        return needed + self.return_torque(params, q)

    def contact_stiffness(self, params: Any) -> tuple[Any, Any]:
        """Return K [N m/rad] and D [N m s/rad] of gears in contact, with springs in series (N
        each).
        """
        frequency = self.gear_number(params, "contact")
        K = self.stiffness * frequency**2
        share = 1 / (1 + K * self.gear_number(params, "winding"))
        return share * K, share**2 * self.damping * frequency

    def gear_torque(self, params: Any, x: Any, contact: Any = None) -> Any:
        """Return tau, the torque of the gears on the links (N) [N m]. contact: as of
        `motion`.
        """
        N = self.joint_count
        half = self.gear_number(params, "half")
        xi = self.gear_angle(params, x)
        K, D = self.contact_stiffness(params)
        if contact is None:
            closed = ca.fabs(xi) > half
            pressed = ca.fmax(xi - half, 0.0) + ca.fmin(xi + half, 0.0)
        else:
            closed = contact * contact
            pressed = closed * xi - contact * half
        closing = x[2 * N : 3 * N] - x[3 * N :]
        return K * pressed + (D * closed + self.gear_number(params, "drag")) * closing

    def motion(
        self, params: Any, x: Any, u: Any, contact: Any = None, load: Any = 0.0
    ) -> tuple[Any, Any]:
        """Return (x' (4 N), tau (N)).

        Args:
            params: column of the parameters.
            x: state (4 N).
            u: torque at the motors (N), an unknown one included.
            contact: None for the true law, or each joint's mode (N): 1 on the right flank, where
                tau > 0, 0 in the gap, -1 on the left flank. On a flank motor and link are locked
                both ways, tau = K (xi - mode half) + D (theta' - q'), linear in x and half.
            load: further torque at the links (N).
        """
        N = self.joint_count
        q = x[N : 2 * N]
        turning = x[2 * N : 3 * N]
        v = x[3 * N :]
        tau = self.gear_torque(params, x, contact)
        spun = (u - self.motor_friction_torque(params, turning) - tau) / self.gear_number(
            params, "inertia"
        )
        acting = tau + load - self.return_torque(params, q)
        swung = forward_dynamics(self.arm, self.link_params(params), q, v, acting)
        return ca.vertcat(turning, v, spun, swung), tau

    def holding_torque(self, params: Any, q: Any) -> Any:
        """Return the torque that holds links still at q (N) [N m]."""
        still = ca.DM.zeros(self.joint_count)
        return self.arm.bias(self.link_params(params), q, still) + self.return_torque(params, q)

    def motors_at_rest(self, params: Any, q: Any) -> Any:
        """Return the motor angles that hold links still at q (N) [rad], on the flanks that
        carry the load.
        """
        tau = self.holding_torque(params, q)
        K = self.contact_stiffness(params)[0]
        flank = ca.sign(tau) * self.gear_number(params, "half")
        return q - self.gear_number(params, "centre") + flank + tau / K


class Coupling(NamedTuple):
    """Coupling of a joint to the joints of other groups.

    Attributes:
        ratio: factor by which its group's links are heavier with the others held than free (1: no
            coupling).
        partner: the joint outside of its group that it is coupled to most.
    """

    ratio: float
    partner: int


def largest_couplings(
    body: Arm, links: Floats, postures: Floats, groups: Sequence[Sequence[int]]
) -> list[Coupling]:
    """Return the largest coupling of each joint to other groups, over postures (N).

    Args:
        body: the links.
        links: their parameters.
        postures: angles of the joints along a motion (K x N), of which at most `PLACES` count.
        groups: joints that belong together.
    """
    few = np.unique(np.linspace(0, len(postures) - 1, PLACES).astype(int))
    found = [Coupling(1.0, joint) for joint in range(body.joint_count)]
    for q in postures[few]:
        M = np.asarray(body.mass(links, q))
        inverse = np.linalg.inv(M)
        shares = np.abs(inverse) / np.sqrt(np.outer(np.diag(inverse), np.diag(inverse)))
        for group in map(list, groups):
            here = np.ix_(group, group)
            ratio = spectral_radius(M[here] @ inverse[here])
            others = [joint for joint in range(body.joint_count) if joint not in group]
            for joint in group:
                if others and ratio > found[joint].ratio:
                    partner = others[int(np.argmax(shares[joint, others]))]
                    found[joint] = Coupling(ratio, partner)
    return found


def fastest_contact(gears: Geared, params: Floats, postures: Floats) -> float:
    """Return the fastest mode of an arm at rest with all its gears in contact [1/s].

    Args:
        gears: the arm.
        params: its parameters.
        postures: angles of the joints, of which the fastest counts (K x N).
    """
    N = gears.joint_count
    body = gears.arm
    links = gears.link_params(params)
    inertia = np.ravel(gears.gear_number(params, "inertia"))
    K, D = (np.diag(np.ravel(each)) for each in gears.contact_stiffness(params))
    slow = np.full(N, TINY * gears.rest)
    fastest = 0.0
    rubbing = np.diag(np.ravel(np.asarray(ca.DM(body.friction(links, slow)))) / slow)
    friction = np.ravel(np.asarray(ca.DM(gears.motor_friction_torque(params, slow)))) / slow
    turned = np.hstack([np.zeros((2 * N, 2 * N)), np.eye(2 * N)])
    for q in postures:
        W = np.linalg.inv(np.asarray(body.mass(links, q)))
        motors = np.hstack([-K, K, -D - np.diag(friction), D]) / inertia[:, None]
        moved = W @ np.hstack([K, -K, D, -D - rubbing])
        A = np.vstack([turned, motors, moved])
        fastest = max(fastest, spectral_radius(A))
    return fastest


def build_geared_arm(
    chain: Chain,
    gears: Gears,
    rest: float = 0.05,
    changes: Mapping[str, float] = MappingProxyType({}),
    key: str = "plant",
) -> Geared:
    """Return an arm of links behind gears.

    Args:
        chain: the links.
        gears: between motors and links.
        rest: speed [rad/s] below which Coulomb friction fades, f v / sqrt(v^2 + rest^2).
        changes: other values of parameters, by name.
        key: name of the plant in messages.

    Raises:
        InputError: or a subclass, that names the key.
    """
    body = build_arm(chain, rest)
    gear_numbers = _require_gear_numbers(gears, body.joint_count, f"{key}.arm.gears")
    names = body.names
    for name in gear_numbers:
        names += tuple(f"{name}{i + 1}" for i in range(body.joint_count))
    values = change_arm_numbers(
        names, np.concatenate([body.values, *gear_numbers.values()]), changes, key
    )
    damping = require_number(f"{key}.arm.gears.damping", gears.damping, least=0.0)
    first_motor = names.index("inertia1")
    motor_inertia = require_positive(
        f"{key}.parameters.inertia",
        values[first_motor : first_motor + body.joint_count],
        body.joint_count,
    )
    link_inertia = np.diag(
        np.asarray(body.mass(_drop_payload(body, values), np.zeros(body.joint_count)))
    )
    # Motor and link vibrate against each other with the inertia J_m J_l / (J_m + J_l) and the
    # contact's damping ratio zeta: stiffness J w^2, damping 2 zeta J w at the frequency w.
    reduced_inertia = motor_inertia * link_inertia / (motor_inertia + link_inertia)
    return Geared(
        body, names, values, reduced_inertia, 2 * damping * reduced_inertia, rest, gears.measured
    )


def _require_gear_numbers(gears: Gears, N: int, key: str) -> dict[str, Floats]:
    """Return each number of the gears that is a parameter (N each).

    Raises InputError, ShapeError.
    """
    why = f"one per joint, there are {N}"
    numbers = {}
    for name, check in GEAR_CHECKS.items():
        numbers[name] = check(f"{key}.{name}", getattr(gears, name), N, why)
    if gears.stiffness is None:
        return numbers | {"winding": np.zeros(N)}
    return numbers | {"winding": 1 / require_positive(f"{key}.stiffness", gears.stiffness, N, why)}


def _drop_payload(body: Arm, values: Floats) -> Floats:
    """Return the parameters of the links, without payload."""
    links = values[: len(body.names)].copy()
    links[body.names.index("payload")] = 0.0
    return links
