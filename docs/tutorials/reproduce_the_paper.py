# %% [markdown]
# # Reproduce the paper
#
# The package began with *Observer Based Control for a Class of Systems with Output Deadzone
# Nonlinearity*. Its example is a plant of order 2 whose sensor is silent between -1 and 1, and a
# reference of 5 sin 2 pi t. Here it runs as printed and as repaired.

# %%
import undeadzone as uz
from undeadzone_paper import example

printed = uz.simulate(example.example_as_printed(5.0))
printed

# %% [markdown]
# The output never leaves the dead zone, so the reading is 0 throughout, and the printed observer
# learns nothing. [The observer](../observer.md) tells which signs
# and terms are at fault.

# %%
repaired = uz.simulate(example.example_as_repaired(5.0))
repaired

# %%
import numpy as np

late = printed.t > printed.t[-1] - 4
print("as printed, largest |y| ", float(np.abs(printed.y[late]).max()))
print("as printed, rms z - r   ", round(float(printed.rms_tracking), 4))
print("repaired, rms z - r     ", round(float(repaired.rms_tracking), 6))
print("repaired, d_r^ and d_l^ ", np.round(repaired.d_hat[-1], 4))

# %% [markdown]
# ## All statements
#
# `undeadzone paper` computes every equation, statement and figure, and writes a report. In Python:

# %%
from undeadzone_paper import audit

paper = audit()
verdicts = [claim.verdict for claim in paper.claims]
for verdict in sorted(set(verdicts)):
    print(f"{verdicts.count(verdict):3}  {verdict}")

# %%
for claim in paper.claims[:5]:
    print(f"{claim.verdict:20} {claim.text.claim}")

# %% [markdown]
# [What the paper states](../paper.md) lists all of them, with the measured numbers.
