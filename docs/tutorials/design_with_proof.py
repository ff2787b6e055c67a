# %% [markdown]
# # A design with a proof
#
# `certified` has constant gains. For these, one quadratic function V of all errors, of states and
# widths, can be shown never to rise, whatever the sensor's side does. `check` proves it for gains
# that you have; `design` finds gains and writes the proof down.

# %%
import undeadzone as uz

scenario = uz.Scenario(
    title="The paper's plant",
    plant=uz.Plant(A=[[0, 1], [-1, -2]], B=[0, 1], C=[1, 0], x0=[0.5, 0]),
    sensor=uz.Sensor(right=1.0, left=0.7, noise=0.005),
    reference=uz.Sine(amplitude=5.0, frequency=1.0),
    observer=uz.Certified(L=[12.0, 15.0], gamma=2.0),
    controller=uz.StateFeedback(poles=[-8.0, -10.0]),
)
checked = uz.check(scenario)
print(checked.certified, *checked.reasons, sep="\n")

# %% [markdown]
# These gains make A - L C fast, but nothing can be proved of them. `design` finds others.

# %%
design = uz.design(scenario)
design

# %% [markdown]
# A design is a file that is proved again whenever it is read.

# %%
design.save("design.toml")
proved = scenario | {"observer": uz.Certified(design="design.toml")}
run = uz.simulate(proved)
print("rms z - z^", run.rms_estimation, " largest rise of V", run.largest_rise_of_V)
