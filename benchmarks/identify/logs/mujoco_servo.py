"""Logs of a servo behind gear play as MuJoCo moves it: of no equation that identification knows.

A light link that friction holds follows a motor through two hinges, the second with a gap between
stiff ends (`gears.mujoco_arms`); the encoder is at the link.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from benchmarks.gears.mujoco_arms import STEP, Arm, Links, Twin
from benchmarks.identify.logs.servo import LATEST, Recorded, Servo, input_at_random, log_uniform

ROTOR = 1.0  # [kg m^2]
LIGHT = 0.1  # inertia of the link over the rotor's, for its friction in units of the input
FIRM = 3000.0  # natural frequency of a link at an end of the gap [rad/s]


def mujoco_log(seed: int) -> Recorded:
    """A log drawn at random, of 4,000 samples.

    Args:
        seed: of everything.
    """
    draw = np.random.default_rng([19, seed])
    step, count = 5e-3, 4000
    damping = log_uniform(draw, 2.0, 30.0)
    gain = damping * log_uniform(draw, 0.3, 3.0)
    friction = draw.uniform(0.02, 0.2) if draw.random() < 0.6 else 0.0
    closed, noisy = bool(draw.random() < 0.4), bool(draw.random() < 0.22)
    delay = int(draw.integers(0, LATEST + 1))
    command = input_at_random(draw, count)
    proportional = min(0.25 / ((delay + 1.5) * step), 2 * damping) * damping / gain
    if closed:
        command = command * 1.5 / proportional
    travel = float(np.ptp(command)) if closed else gain / damping * 20 * step
    gap = travel * log_uniform(draw, 3e-3, 0.1)
    quantum = 0.0 if noisy else gap / log_uniform(draw, 0.5, 50.0)
    rms = gap / log_uniform(draw, 3.0, 60.0) if noisy else 0.0
    kp = proportional if closed else 0.0
    noise = rms * draw.standard_normal(count)
    load = draw.uniform(0.002, 0.15)
    servo = Servo(damping, gain, 0.0, 0.0, friction, gap, quantum, delay, kp, 0.0, load)
    twin = Twin(_arm(servo), np.zeros(1), np.ones(1))
    u, y = np.empty(count), np.empty(count)
    late = deque([0.0] * delay)
    for k in range(count):
        reading = twin.state()[1] + noise[k]
        y[k] = quantum * np.floor(reading / quantum + 0.5) if quantum else reading
        u[k] = proportional * (command[k] - y[k]) if closed else command[k]
        late.append(u[k])
        twin.move(np.array([gain * ROTOR * late.popleft()]), step)
    return Recorded(step, u, y, servo, rms, closed)


def _arm(servo: Servo) -> Arm:
    """A servo as an arm of one link on a level plane, too light to coast."""
    torque = servo.gain * ROTOR
    inertia = LIGHT * servo.load * ROTOR
    links = Links(np.array([1e-6]), np.ones(1), np.zeros(1), np.array([inertia]), 0.0)
    return Arm(
        links,
        payload=0.0,
        rotor=np.array([ROTOR]),
        motor_friction=np.array([servo.friction * torque]),
        motor_viscous=np.array([servo.damping * ROTOR]),
        friction=np.array([servo.load * torque]),
        viscous=np.array([1e-9]),
        half=np.array([servo.gap / 2]),
        contact=FIRM,
        damping=1.0,
        stops=2 * STEP,
    )
