# %% [markdown]
# # To a board
#
# The observer of a sampled scenario becomes C99 without a library: no heap, no loop, single
# precision, with a test that compares every output bit.

# %%
from pathlib import Path

import undeadzone as uz

scenario = uz.Scenario(
    title="Arm joint",
    plant=uz.Plant(A=[[0, 1], [-1, -2]], B=[0, 1], C=[1, 0]),
    sensor=uz.Sensor(right=1.0, left=0.7, noise=0.01),
    reference=uz.Sine(amplitude=5.0, frequency=1.0),
    observer=uz.Certified(L=[-0.87, 0.76], gamma=7.7),
    controller=uz.StateFeedback(poles=[-8.0, -10.0]),
    simulation=uz.Simulation(time="sampled", step=0.001),
)
exported = uz.export(scenario, to="c", out="firmware", check=True)
print(*sorted(path.name for path in exported.files), sep="\n")

# %% [markdown]
# Single precision was compared with double along the scenario's own run:

# %%
for name, value in exported.report["accuracy"].items():
    print(name, value)

# %%
code = next(Path("firmware").glob("*.c")).read_text()
start = code.index("void arm_joint_step")
print(code[start : start + 1500])

# %% [markdown]
# The same observer runs in Python one sample at a time, for a test on a bench:

# %%
online = uz.Online(scenario.observer, scenario.plant, scenario.sensor, step=0.001)
estimate = online.update(y=0.3, u=1.0)
print(estimate.x, estimate.right, estimate.left)
