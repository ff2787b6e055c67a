"""Arms behind gears as MuJoCo moves them: a plant that is not made of our own equations.

Each joint is two hinges at one place. The first is the motor, with armature, Coulomb and viscous
friction; the second is the gap, limited to both sides by a stiff contact. Friction of the link
is that of a tendon over both.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
STEP = 1e-4  # of MuJoCo [s]
FIRM = "0.99 0.99 0.0001"  # solimp of a gap's ends


class Arm(NamedTuple):
    """Numbers of a planar arm of N joints, in SI units; q1 from the x axis, gravity along -y.

    Attributes:
        mass, length, centre, inertia: of the links; centre of mass from the joint.
        gravity: along -y.
        payload: at the tip.
        rotor: inertia of the motors as felt at their joints.
        motor_friction, motor_viscous: of the motors.
        friction, viscous: of the links.
        half: of the gaps.
        contact: natural frequency that MuJoCo's limits aim at [rad/s].
        damping: its damping ratio.
    """

    mass: Floats
    length: Floats
    centre: Floats
    inertia: Floats
    gravity: float
    payload: float
    rotor: Floats
    motor_friction: Floats
    motor_viscous: Floats
    friction: Floats
    viscous: Floats
    half: Floats
    contact: float
    damping: float


def model_of(arm: Arm) -> str:
    """The arm in MuJoCo's words (MJCF)."""
    bodies, tendons, motors = "", "", ""
    limit = f"{-(arm.contact**2)} {-2 * arm.damping * arm.contact}"
    for i, half in enumerate(arm.half):
        at = 0.0 if i == 0 else arm.length[i - 1]
        bodies += (
            f'<body pos="{at} 0 0"><inertial pos="{arm.centre[i]} 0 0" mass="{arm.mass[i]}" '
            f'diaginertia="1e-4 {arm.inertia[i]} {arm.inertia[i]}"/>'
            f'<joint name="m{i}" type="hinge" axis="0 0 1" armature="{arm.rotor[i]}" '
            f'frictionloss="{arm.motor_friction[i]}" damping="{arm.motor_viscous[i]}"/>'
            f'<joint name="g{i}" type="hinge" axis="0 0 1" limited="true" range="{-half} {half}" '
            f'solreflimit="{limit}" solimplimit="{FIRM}"/>'
        )
        tendons += (
            f'<fixed frictionloss="{arm.friction[i]}" damping="{arm.viscous[i]}">'
            f'<joint joint="m{i}" coef="1"/><joint joint="g{i}" coef="1"/></fixed>'
        )
        motors += f'<motor joint="m{i}" gear="1"/>'
    if arm.payload > 0:
        bodies += (
            f'<body pos="{arm.length[-1]} 0 0"><inertial pos="0 0 0" mass="{arm.payload}" '
            'diaginertia="1e-9 1e-9 1e-9"/></body>'
        )
    return (
        '<mujoco><compiler angle="radian" autolimits="false"/>'
        f'<option timestep="{STEP}" gravity="0 {-arm.gravity} 0" integrator="implicitfast" '
        'cone="elliptic" iterations="50" tolerance="1e-10"/>'
        f"<worldbody>{bodies}{'</body>' * len(arm.half)}</worldbody>"
        f"<tendon>{tendons}</tendon><actuator>{motors}</actuator></mujoco>"
    )


class Twin:
    """An arm that MuJoCo moves.

    Args:
        arm: its numbers.
        q: angles of the links at first (N), at rest.
        flank: on which each begins, 1 or -1 (N).
    """

    def __init__(self, arm: Arm, q: Floats, flank: Floats) -> None:
        self._model: Any = mujoco.MjModel.from_xml_string(model_of(arm))
        self._data: Any = mujoco.MjData(self._model)
        self._data.qpos[0::2], self._data.qpos[1::2] = q + flank * arm.half, -flank * arm.half
        mujoco.mj_forward(self._model, self._data)

    def state(self) -> Floats:
        """[theta; q; theta'; q'] (4 N)."""
        angles, speeds = self._data.qpos, self._data.qvel
        parts = [angles[0::2], angles[0::2] + angles[1::2]]
        return np.concatenate([*parts, speeds[0::2], speeds[0::2] + speeds[1::2]])

    def move(self, u: Floats, time: float) -> None:
        """Move under torques u (N) that last for so long [s]."""
        self._data.ctrl[:] = u
        for _ in range(round(time / STEP)):
            mujoco.mj_step(self._model, self._data)


def two_link(rng: np.random.Generator, **changes: Any) -> Arm:
    """A random arm of two links: half gaps 20 to 80 mrad, payload to 1 kg, unknown friction."""
    known = Arm(
        mass=np.array([3.0, 2.0]),
        length=np.array([0.4, 0.3]),
        centre=np.array([0.2, 0.15]),
        inertia=np.array([0.04, 0.015]),
        gravity=9.81,
        payload=float(rng.uniform(0, 1)),
        rotor=np.array([0.08, 0.03]),
        motor_friction=np.array([0.3, 0.1]) * rng.uniform(0, 2, 2),
        motor_viscous=np.array([0.4, 0.2]) * rng.uniform(0.7, 1.3, 2),
        friction=np.array([0.1, 0.03]) * rng.uniform(0, 2, 2),
        viscous=np.array([0.05, 0.02]) * rng.uniform(0.5, 1.5, 2),
        half=rng.uniform(0.02, 0.08, 2),
        contact=float(rng.uniform(300, 800)),
        damping=float(rng.uniform(0.2, 0.9)),
    )
    return known._replace(**changes)


def servo(rng: np.random.Generator, **changes: Any) -> Arm:
    """A random servo with a hanging arm: half gap 8 to 40 mrad, payload to 0.4 kg."""
    known = Arm(
        mass=np.array([0.35]),
        length=np.array([0.25]),
        centre=np.array([0.125]),
        inertia=np.array([0.0018]),
        gravity=9.81,
        payload=float(rng.uniform(0, 0.4)),
        rotor=np.array([0.012]),
        motor_friction=0.08 * rng.uniform(0, 2, 1),
        motor_viscous=0.05 * rng.uniform(0.7, 1.3, 1),
        friction=0.02 * rng.uniform(0, 2, 1),
        viscous=0.01 * rng.uniform(0.5, 1.5, 1),
        half=rng.uniform(0.008, 0.04, 1),
        contact=float(rng.uniform(300, 800)),
        damping=float(rng.uniform(0.2, 0.9)),
    )
    return known._replace(**changes)
