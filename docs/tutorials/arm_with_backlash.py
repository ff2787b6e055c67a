# %% [markdown]
# # An arm with backlash
#
# The encoder of a joint sits at the motor, and the gear behind it has a gap. The encoder is right,
# and the link is somewhere within the gap. Here is one link, whose gap we pretend not to know.

# %%
import undeadzone as uz

GAP = 0.1  # [rad], in all
scenario = uz.Scenario(
    title="One link behind a gear with a gap",
    plant=uz.Plant(
        arm=uz.OneLink(
            torque_max=60.0,
            gears=uz.Gears(
                half=[GAP / 2], inertia=[0.08], friction=[0.3], viscous=[0.4], measured="motor"
            ),
        ),
        x0=[-0.6, 0.0],
    ),
    model=uz.Model(parameters={"half1": 0.0}),  # the controller's model has no gap
    sensor=uz.Sensor(right=0.0, left=0.0, noise=0.001),
    reference=uz.Sines(
        components=[
            uz.Tone(amplitude=[1.0], frequency=0.5),
            uz.Tone(amplitude=[0.5], frequency=1.3),
        ]
    ),
    observer=uz.Contact(half=[0.0, 0.15], starts=1),  # all that it knows of the gap
    controller=uz.ComputedTorque(bandwidth=14.0),
    simulation=uz.Simulation(time="sampled", step=0.001, duration=8.0, substeps=4),
)
run = uz.simulate(scenario)
run

# %% [markdown]
# The motor feels each strike of the link on a flank. From these strikes the observer estimates the
# gap, and where the link is between them. On a slower path the link never crosses its gap, and the
# answer is that the gap cannot be known.

# %%
import msgspec
import numpy as np

late = run.t > 6.0
print("gap, true", GAP, "estimated", round(float(run.d_hat[-1].sum()), 4))
print("95 % interval half width", round(1.96 * float(run.width_std[-1, 0]), 4))
print("link, rms error [mrad]  ", round(1e3 * float(np.std((run.z_hat - run.z)[late])), 2))
print("encoder, rms error [mrad]", round(1e3 * float(np.std((run.y - run.z)[late])), 2))

# %% [markdown]
# The same arm if the gap is ignored: every state is measured, of the motor.

# %%
blind = msgspec.structs.replace(scenario, observer=uz.FullState(), title="The gap is ignored")
print(f"rms of link - reference, {1e3 * run.rms_tracking:.2f} mrad with the gap estimated,")
print(f"{1e3 * uz.simulate(blind).rms_tracking:.2f} mrad with the gap ignored")

# %% [markdown]
# `undeadzone arm robot.urdf --gears` writes such a scenario for an arm from its URDF, and
# [robots](../robot_gears.md#gears) lists the assumptions. [Cases](../cases.md) has a two-link arm.
