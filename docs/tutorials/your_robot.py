# %% [markdown]
# # Your robot's URDF
#
# The joints of an arm are read through a dead zone about their reference. Its URDF says the rest.
# This arm has two joints; yours may have six or seven.

# %%
import undeadzone as uz

urdf = """
<robot name="arm">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0 0 -0.2"/><mass value="2"/>
    <inertia ixx="0.03" iyy="0.03" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="lower"><inertial><origin xyz="0 0 -0.15"/><mass value="1"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="tip"/>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="60" velocity="5"/>
    <dynamics damping="0.4"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/>
    <origin xyz="0 0 -0.4"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="25" velocity="5"/><dynamics damping="0.2"/></joint>
  <joint name="hand" type="fixed"><parent link="lower"/><child link="tip"/>
    <origin xyz="0 0 -0.3"/></joint>
</robot>
"""
with open("arm.urdf", "w") as file:
    file.write(urdf)

# %%
start = [0.3, -0.6, 0.0, 0.0]
scenario = uz.Scenario(
    title="An arm from a URDF",
    plant=uz.Plant(arm=uz.URDF(path="arm.urdf", tip="tip"), x0=start),
    sensor=uz.Sensor(right=[0.05, 0.08], left=[0.03, 0.06], noise=0.001),
    reference=uz.Sines(
        components=[uz.Tone(amplitude=[0.4, 0.5], frequency=0.4, phase=[0.0, 1.0])],
    ),
    observer=uz.Extended(right=[0.0, 0.15], start=start, x_std=0.01, noise=0.002, disturbance=0.1),
    controller=uz.ComputedTorque(bandwidth=12.0),
    simulation=uz.Simulation(time="sampled", step=0.002, duration=8.0, substeps=1),
)
run = uz.simulate(scenario)
for joint, (right, left) in zip(run.outputs, run.widths, strict=True):
    print(f"{joint}: d_r^ {right:.4f}, d_l^ {left:.4f}")
print("rms tip error [mm]", 1e3 * run.rms_tip)

# %%
run

# %% [markdown]
# [Robots](../robots.md) tells how paths of the tip, payloads and torque limits are given, and
# `undeadzone run examples/two_link.toml` writes a page with the arm in motion.
