# %% [markdown]
# # From a log to widths
#
# You have a record of a real plant and no model. Here a second-order plant moves under a random
# input; its sensor has a dead zone that we pretend not to know.

# %%
import numpy as np
from scipy.signal import lfilter

import undeadzone as uz

rng = np.random.default_rng(0)
step = 0.05
u = np.repeat(rng.standard_normal(150), 10)
z = lfilter([0, 0.05, 0.03], [1, -1.6, 0.68], u) + 0.03 * rng.standard_normal(1500)
y = np.maximum(z - 0.5, 0) + np.minimum(z + 0.3, 0)
print(f"{np.mean(y == 0):.0%} of the readings are 0")

# %% [markdown]
# `identify` answers: is there a dead zone, how wide is each side, which plant is behind it.

# %%
answer = uz.identify(t=step, u=u, y=y, order="1-2")
for name, text in answer.summary().items():
    print(f"{name:12} {text}")

# %% [markdown]
# The command line does the same with a file, and draws it: `undeadzone identify log.csv --order
# 1-2`.

# %%
table = np.column_stack([step * np.arange(y.size), u, y])
np.savetxt("log.csv", table, delimiter=",", header="t,u,y", comments="", fmt="%.6g")

# %% [markdown]
# The answer holds 95 % intervals, the hidden output along the log, and a scenario.

# %%
states = answer.states()
inside = (z < 0.5) & (z > -0.3)
print("rms error of z inside the zone:", np.std((states.z - z)[inside]))
print("of the reading:                ", np.std((y - z)[inside]))

# %%
with open("identified.toml", "w") as file:
    file.write(answer.scenario())
scenario = uz.read("identified.toml")
print(uz.check(scenario))
