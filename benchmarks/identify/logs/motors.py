"""Logs of motors as MuJoCo moves them: torque in, an encoder's angle out, a gap or none.

The motor's rotor turns a load through a second hinge. Its range is the gap: stiff ends, friction
at neither. A rigid shaft has no second hinge.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from undeadzone.util.arrays import Floats

INERTIA = 0.03  # of motor and load together [kg m^2]
STEP = 5e-3  # sample time [s]
COUNT = 1600  # samples
PARTS = 10  # steps of MuJoCo a sample
NOISE = 2e-4  # rms of the encoder's noise [rad]
TICK = 2 * math.pi / 8192  # of an encoder without noise [rad]
SINES = ((0.25, 0.7), (0.2, 1.9), (0.15, 3.3))  # amplitudes [N m], frequencies [Hz]
STIFFNESS = 60.0  # square of the loop's natural frequency [1/s^2]
MOST = 3.0  # torque of the loop [N m]

XML = """<mujoco><compiler angle="radian" autolimits="true"/>
<option timestep="{step}" integrator="implicitfast"><flag contact="disable" gravity="disable"/>
</option><worldbody><body name="rotor">
<inertial pos="0 0 0" mass="1" diaginertia="{rotor} {rotor} {rotor}"/>
<joint name="motor" type="hinge" axis="0 0 1" damping="{damping}" frictionloss="{friction}"/>
{load}</body></worldbody><actuator><motor joint="motor"/></actuator></mujoco>"""
LOAD = """<body name="load"><inertial pos="0 0 0" mass="1" diaginertia="{load} {load} {load}"/>
<joint name="gap" type="hinge" axis="0 0 1" range="{low} {high}" damping="5e-4"
solreflimit="0.004 1"/></body>"""


class Motor(NamedTuple):
    """A motor's joint, and how its log is recorded.

    Attributes:
        gap: between motor and load [rad]; 0: a rigid shaft.
        ratio: the load's inertia by the motor's.
        samples: time constant of motor and load together [samples].
        friction: that sticks [N m].
        at_load: whether the encoder is behind the gap.
        ticks: whether the encoder has ticks; else it is noisy.
        closed: whether a position loop makes the torque.
    """

    gap: float
    ratio: float
    samples: float
    friction: float
    at_load: bool
    ticks: bool
    closed: bool

    @property
    def damping(self) -> float:
        """Viscous friction [N m s/rad]."""
        return INERTIA / (self.samples * STEP)

    @property
    def xml(self) -> str:
        """The model in MuJoCo's language."""
        rotor, load = INERTIA, ""
        if self.gap:
            rotor = INERTIA / (1 + self.ratio)
            half = self.gap / 2
            load = LOAD.format(load=INERTIA - rotor, low=-half, high=half)
        step = STEP / PARTS
        return XML.format(
            step=step, rotor=rotor, load=load, damping=self.damping, friction=self.friction
        )


def random_motor(seed: int, with_gap: bool) -> Motor:
    """Draw a motor at random.

    Args:
        seed: of everything.
        with_gap: whether there is a gap.
    """
    draw = np.random.default_rng([31, seed])
    gap = 2 * math.exp(draw.uniform(math.log(3e-3), math.log(3e-2)))
    ratio, samples = 10 ** draw.uniform(-1, 1), 5 * 10 ** draw.uniform(0, 2)
    friction, ticks = float(draw.choice([0.0, 0.03])), bool(draw.random() < 0.5)
    closed, at_load = bool(seed % 2), bool(seed // 2 % 2)
    return Motor(gap * with_gap, ratio, samples, friction, at_load, ticks, closed)


def record(motor: Motor, seed: int) -> tuple[Floats, Floats]:
    """Record torque and angle of a motor (N each).

    Args:
        motor: which.
        seed: of phases and noise.
    """
    u, angles = record_both(motor, seed)
    return u, angles[:, int(motor.at_load)]


def record_both(motor: Motor, seed: int) -> tuple[Floats, Floats]:
    """Record the torque (N), and the angles of motor and load (N x 2), each by its own encoder.

    Args:
        motor: which; its loop has the encoder that it says.
        seed: of phases and noise.
    """
    import mujoco

    draw = np.random.default_rng([32, seed])
    phases = draw.uniform(0, 2 * math.pi, len(SINES))
    noise = 0.0 if motor.ticks else NOISE
    of_other = noise * np.random.default_rng([33, seed]).standard_normal(COUNT)
    model = mujoco.MjModel.from_xml_string(motor.xml)
    data = mujoco.MjData(model)
    u, y, rate, before = np.empty(COUNT), np.empty((COUNT, 2)), 0.0, 0.0
    own, other = int(motor.at_load), int(not motor.at_load)
    for k in range(COUNT):
        angle = float(data.qpos[0])
        both = [angle, angle + float(data.qpos[-1]) * bool(motor.gap)]
        both[own] += noise * draw.standard_normal()
        both[other] += of_other[k]
        y[k] = [TICK * round(one / TICK) for one in both] if motor.ticks else both
        u[k] = sum(
            size * math.sin(2 * math.pi * rate_of * k * STEP + phase)
            for (size, rate_of), phase in zip(SINES, phases, strict=True)
        )
        now = float(y[k, own])
        if motor.closed:
            rate += 0.3 * ((now - before) / STEP - rate)
            error = 3.0 * u[k] - now
            push = INERTIA * (STIFFNESS * error - 1.4 * math.sqrt(STIFFNESS) * rate)
            u[k] = min(max(push, -MOST), MOST)
        before = now
        # A step's torque acts about its start, half of it before.
        for data.ctrl[0], steps in ((u[k - min(k, 1) : k + 1].mean(), 1), (u[k], PARTS - 1)):
            mujoco.mj_step(model, data, steps)
    return u, y
