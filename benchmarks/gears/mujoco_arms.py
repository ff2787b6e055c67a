"""Arms behind gears as MuJoCo moves them: a plant that is not made of our own equations.

Links are planar, or those of a URDF that MuJoCo reads. Each joint is two hinges at one place. The
first is the motor, with armature, Coulomb and viscous friction; the second is the gap, limited to
both sides by a stiff contact. Friction of the link is that of a tendon over both.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
UR5 = Path(__file__).parents[2] / "examples" / "ur5.urdf"
STEP = 1e-4  # of MuJoCo [s]
PULLEY = 0.02  # of the inertia of a motor, behind its belt
RINGING = 0.01  # damping ratio of a motor on its belt
FIRM = [0.99, 0.99, 0.0001, 0.5, 2.0]  # solimp of a gap's ends


class Links(NamedTuple):
    """A planar arm of N joints, in SI units; q1 from the x axis, gravity along -y.

    Attributes:
        mass, length, centre, inertia: of the links; centre of mass from the joint.
        gravity: along -y.
    """

    mass: Floats
    length: Floats
    centre: Floats
    inertia: Floats
    gravity: float


class Arm(NamedTuple):
    """Numbers of an arm of N joints, in SI units.

    Attributes:
        links: of a planar arm, or the file of an arm in space (URDF).
        payload: at the tip.
        rotor: inertia of the motors as felt at their joints.
        motor_friction, motor_viscous: of the motors.
        friction, viscous: of the links.
        half: of the gaps.
        contact: natural frequency that MuJoCo's limits aim at [rad/s].
        damping: its damping ratio.
        stops: time in which friction stops what slides [s].
        belt: stiffness in series between each motor and its gap (N) [N m/rad]; None: there is none.
        oil: viscous drag between motor and link in the gap [N m s/rad].
    """

    links: Links | Path
    payload: float
    rotor: Floats
    motor_friction: Floats
    motor_viscous: Floats
    friction: Floats
    viscous: Floats
    half: Floats
    contact: float
    damping: float
    stops: float = 0.02
    belt: Floats | None = None
    oil: float = 0.0


def planar(links: Links) -> Any:
    """The links as MuJoCo's specification, without motors and gaps."""
    spec = mujoco.MjSpec()
    spec.option.gravity = [0.0, -links.gravity, 0.0]
    body, at = spec.worldbody, 0.0
    for i, inertia in enumerate(links.inertia):
        body = body.add_body(name=f"link{i}", pos=[at, 0.0, 0.0], mass=links.mass[i])
        body.ipos, body.inertia = [links.centre[i], 0.0, 0.0], [1e-4, inertia, inertia]
        body.explicitinertial = True
        body.add_joint(name=f"q{i}", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0.0, 0.0, 1.0])
        at = links.length[i]
    body.add_body(name="tip", pos=[at, 0.0, 0.0])
    return spec


def in_space(path: Path) -> Any:
    """The arm of a file as MuJoCo's specification, free of its limits."""
    spec = mujoco.MjSpec.from_file(str(path))
    spec.compiler.fusestatic = False
    for joint in spec.joints:
        joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE
    return spec


def model_of(arm: Arm) -> Any:
    """The arm with its motors, gaps and payload as MuJoCo's model."""
    spec = planar(arm.links) if isinstance(arm.links, Links) else in_space(arm.links)
    spec.compiler.degree = False
    spec.option.timestep, spec.option.iterations, spec.option.tolerance = STEP, 50, 1e-10
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    limit = [-(arm.contact**2), -2 * arm.damping * arm.contact]
    stops = [arm.stops, 1.0]
    for i, motor in enumerate(list(spec.joints)):
        motor.armature = arm.rotor[i]
        motor.frictionloss, motor.damping = arm.motor_friction[i], [arm.motor_viscous[i], 0, 0]
        motor.solref_friction = stops
        if arm.belt is not None:
            belt = motor.parent.add_joint(name=f"b{i}", type=motor.type, axis=motor.axis)
            belt.stiffness, belt.armature = [arm.belt[i], 0, 0], PULLEY * arm.rotor[i]
            belt.damping = [2 * RINGING * np.sqrt(arm.belt[i] * arm.rotor[i]), 0, 0]
            limit = [-(arm.contact**2) / PULLEY, -2 * arm.damping * arm.contact / PULLEY**0.5]
        gap = motor.parent.add_joint(name=f"g{i}", type=motor.type, axis=motor.axis)
        gap.damping = [arm.oil, 0, 0]
        gap.limited, gap.range = mujoco.mjtLimited.mjLIMITED_TRUE, [-arm.half[i], arm.half[i]]
        gap.solref_limit, gap.solimp_limit = limit, FIRM
        both = spec.add_tendon(name=f"t{i}", frictionloss=arm.friction[i])
        both.damping, both.solref_friction = [arm.viscous[i], 0, 0], stops
        for joint in motor.parent.joints:
            both.wrap_joint(joint.name, 1.0)
        drive = spec.add_actuator(name=f"u{i}", target=motor.name)
        drive.trntype = mujoco.mjtTrn.mjTRN_JOINT
    if arm.payload > 0:
        tip = spec.bodies[-1]
        tip.mass, tip.ipos, tip.inertia = arm.payload, [0.0] * 3, [1e-9] * 3
        tip.explicitinertial = True
    return spec.compile()


class Twin:
    """An arm that MuJoCo moves.

    Args:
        arm: its numbers.
        q: angles of the links at first (N), at rest.
        flank: on which each begins, 1 or -1 (N).
    """

    def __init__(self, arm: Arm, q: Floats, flank: Floats) -> None:
        self._model: Any = model_of(arm)
        self._data: Any = mujoco.MjData(self._model)
        self._hinges = 2 if arm.belt is None else 3
        self._data.qpos[0 :: self._hinges] = q + flank * arm.half
        self._data.qpos[self._hinges - 1 :: self._hinges] = -flank * arm.half
        mujoco.mj_forward(self._model, self._data)

    def state(self) -> Floats:
        """[theta; q; theta'; q'] (4 N)."""
        hinges = np.reshape([self._data.qpos, self._data.qvel], (2, -1, self._hinges))
        return np.ravel([[each[:, 0], each.sum(axis=1)] for each in hinges])

    def load(self, payload: float) -> None:
        """Change the payload at the tip [kg]."""
        self._model.body_mass[-1] = payload
        mujoco.mj_setConst(self._model, mujoco.MjData(self._model))

    def rub(self, friction: float) -> None:
        """Change Coulomb friction of the motors [N m]."""
        self._model.dof_frictionloss[0 :: self._hinges] = friction

    def wear(self, half: Floats) -> None:
        """Change the half gaps (N)."""
        self._model.jnt_range[self._hinges - 1 :: self._hinges] = np.outer(half, [-1.0, 1.0])

    def pull(self, torque: Floats) -> None:
        """Pull the links, besides gravity (N) [N m]."""
        self._data.qfrc_applied[:] = np.repeat(torque, self._hinges)

    def move(self, u: Floats, time: float) -> None:
        """Move under torques u (N) that last for so long [s]."""
        self._data.ctrl[:] = u
        for _ in range(round(time / STEP)):
            mujoco.mj_step(self._model, self._data)


def two_link(rng: np.random.Generator) -> Arm:
    """A random arm of two links: half gaps 20 to 80 mrad, payload to 1 kg, unknown friction."""
    links = Links(
        mass=np.array([3.0, 2.0]),
        length=np.array([0.4, 0.3]),
        centre=np.array([0.2, 0.15]),
        inertia=np.array([0.04, 0.015]),
        gravity=9.81,
    )
    return Arm(
        links,
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


def servo(rng: np.random.Generator, gravity: float = 9.81) -> Arm:
    """A random servo with a hanging arm: half gap 8 to 40 mrad, payload to 0.4 kg."""
    links = Links(
        mass=np.array([0.35]),
        length=np.array([0.25]),
        centre=np.array([0.125]),
        inertia=np.array([0.0018]),
        gravity=gravity,
    )
    return Arm(
        links,
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


def ur5(rng: np.random.Generator) -> Arm:
    """A random UR5: half gaps 10 to 40 mrad, payload to 1 kg, unknown friction."""
    return Arm(
        UR5,
        payload=float(rng.uniform(0, 1)),
        rotor=np.array([1.5, 1.5, 0.6, 0.2, 0.2, 0.02]),
        motor_friction=np.array([2.0, 2.0, 1.0, 0.3, 0.3, 0.1]) * rng.uniform(0, 2, 6),
        motor_viscous=np.array([2.0, 2.0, 1.0, 0.3, 0.3, 0.05]) * rng.uniform(0.7, 1.3, 6),
        friction=np.array([0.2, 0.2, 0.1, 0.03, 0.03, 0.005]) * rng.uniform(0, 2, 6),
        viscous=np.array([0.1, 0.1, 0.05, 0.02, 0.02, 0.003]) * rng.uniform(0.5, 1.5, 6),
        half=rng.uniform(0.01, 0.04, 6),
        contact=float(rng.uniform(300, 800)),
        damping=float(rng.uniform(0.2, 0.9)),
    )
