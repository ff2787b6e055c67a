# %% [markdown]
# # Your own plant, from python-control
#
# You have a plant in python-control and a sensor that reads 0 near the middle. Five lines say what
# an observer makes of it.

# %%
import control

import undeadzone as uz

motor = control.tf([2.0], [0.05, 1.0, 2.0])
scenario = uz.Scenario(
    title="Motor with a position spring",
    plant=uz.from_control(motor),
    sensor=uz.Sensor(right=0.4, left=0.25, noise=0.005),
    reference=uz.Sine(amplitude=1.5, frequency=0.5),
    observer=uz.Auto(right=[0.0, 1.0]),
    controller=uz.LQG(Q=5.0, integral=20.0),
    simulation=uz.Simulation(time="sampled", step=0.01, duration=12.0),
)
run = uz.simulate(scenario)
print(run)

# %% [markdown]
# The sensor's own widths are used by the simulation alone. The observer `auto` is told only that
# each lies between 0 and 1.

# %%
run

# %% [markdown]
# What if the right edge were further out? A scenario is a value; `replace` gives another one.

# %%
for width in (0.2, 0.8, 1.2):
    other = scenario.replace("sensor.right", width) | {"observer": {"right": [0.0, 1.5]}}
    summary = uz.simulate(other).summary()
    shown = f"{summary['d_right']:.4f} +- {summary['d_right_std']:.4f}"
    print(f"d_r = {width}: {shown}, rms z - r {summary['rms_tracking']:.3g}")

# %% [markdown]
# Your own controller is a system of python-control, or a function.

# %%
pi = uz.LinearController(control.tf([0.6, 2.0], [1.0, 0.0]))
print(uz.simulate(scenario | {"controller": pi}).summary()["rms_tracking"])


def law(t, estimate, r):
    """Proportional feedback of the estimated output."""
    return 3.0 * (r - estimate.z)


print(uz.simulate(scenario, controller=law).summary()["rms_tracking"])
