# %% [markdown]
# # A pendulum with unknown mass and damping
#
# You know the equations of a plant, but not all of its numbers, and its sensor has a dead zone.
# Here a pendulum of 2.5 kg moves under a torque. We record it, and pretend to know only its length.

# %%
import numpy as np

import undeadzone as uz

STEP, G = 0.01, 9.81
rng = np.random.default_rng(0)
t = STEP * np.arange(1000)
phases = rng.uniform(0, 2 * np.pi, 3)
torque = sum(
    size * np.sin(2 * np.pi * f * t + phase)
    for size, f, phase in zip((10.0, 8.0, 6.0), (0.17, 0.43, 0.71), phases, strict=True)
)


def record(mass, damping, right, left):
    """Simulate the reading of a pendulum, by ten steps in each sample."""
    angle, rate, angles = 0.0, 0.0, []
    for push in torque + 0.02 * rng.standard_normal(t.size):
        angles.append(angle)
        for _ in range(10):
            rate += STEP / 10 * (-G * np.sin(angle) - damping * rate + push / mass)
            angle += STEP / 10 * rate
    z = np.array(angles) + 0.002 * rng.standard_normal(t.size)
    return np.maximum(z - right, 0) + np.minimum(z + left, 0)


y = record(mass=2.5, damping=0.8, right=0.12, left=0.05)
print(f"{np.mean(y == 0):.0%} of the readings are 0")

# %% [markdown]
# The scenario has the equations, and a first guess of each number. Mass, damping and both widths
# are far off.

# %%
scenario = uz.Scenario(
    title="Pendulum",
    plant=uz.Plant(
        states=["angle", "rate"],
        inputs=["torque"],
        f=["rate", "-g / l * sin(angle) - damping * rate + torque / (mass * l ** 2)"],
        h=["angle"],
        parameters={"g": 9.81, "l": 1.0, "mass": 1.0, "damping": 1.5},
    ),
    sensor=uz.Sensor(right=0.2, left=0.2, noise_before=0.002),
    disturbance=uz.Random(rms=0.02, correlation_time=0.02),
    reference=uz.Sine(amplitude=0.8, frequency=0.5),
    observer=uz.Extended(right=[0.0, 0.4]),
    simulation=uz.Simulation(time="sampled", step=STEP),
)

# %% [markdown]
# `fit` finds the numbers under which the readings are most likely. A silent reading counts too: it
# shows that the angle is inside the zone. The command line does the same with files:
# `undeadzone fit pendulum.toml log.csv --free plant.mass,plant.damping,sensor.right,sensor.left`.

# %%
log = {"t": t, "u": torque, "y": y}
free = [
    "plant.mass",
    "plant.damping",
    "disturbance.rms",
    "sensor.right=0..0.5",
    "sensor.left=0..0.5",
]
fitted = uz.fit(scenario, log, free)
print(fitted)

# %% [markdown]
# The answer is a scenario with these numbers. The last lines of the table are the start of the log,
# which is estimated as well.

# %%
print(fitted.scenario.plant.parameters)
fitted

# %% [markdown]
# Is the model right? `fit` tests the readings against their prediction. A model without damping
# fits as well as it can, but the log contradicts it.

# %%
frictionless = scenario.replace(
    "plant.parameters", {"g": 9.81, "l": 1.0, "mass": 1.0, "damping": 0.0}
)
wrong = uz.fit(frictionless, log, ["plant.mass", "sensor.right=0..0.5", "sensor.left=0..0.5"])
print(wrong.agreement)
