# %% [markdown]
# # Add an observer
#
# A method is one file: options, and a pure function on CasADi expressions. What you write once runs
# on the virtual machine, compiled in ensembles, and as C on a board. Here is a whole observer: a
# Luenberger observer that believes a width it is told.

# %%
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.interfaces import Observer, build_estimate


class Params(NamedTuple):
    """Gain and width."""

    L: Any
    width: Any


def build(model, sensor, L, width):
    """x^' = A x^ + B u + L e, e = y - (C x^ less the width) on the right, likewise on the left."""

    def init(p):
        return np.zeros(model.n)

    def step(p, x, u, reading):
        z = model.output(model.params, x)
        expected = z - p.width * reading.side
        e = ca.if_else(reading.side != 0, reading.y - expected, 0)
        moved = model.move(model.params, x, u) + p.L @ e
        shown = build_estimate(x, z, p.width, p.width, reading, 1.0, sensor.kind, e)
        return moved, shown

    return Observer(Params(L, width), init, step)


# %% [markdown]
# Its options are a struct whose `build` makes the observer; `tag` is the name of the method. That
# is enough to run it in any scenario, and sample by sample.

# %%
import msgspec

import undeadzone as uz


class Told(msgspec.Struct, frozen=True, tag_field="method", tag="told"):
    """Options of the observer above: its width."""

    width: float = 0.7

    def build(self, model, sensor):
        """The observer for a model."""
        gains = np.array([[2.0], [1.0]]) * model.Ts
        return build(model, sensor, gains, np.array([self.width]))


scenario = uz.Scenario(
    title="A width that is told",
    plant=uz.Plant(A=[[0, 1], [-1, -2]], B=[0, 1], C=[1, 0]),
    sensor=uz.Sensor(right=0.7, left=0.7, noise=0.01),
    reference=uz.Sine(amplitude=3.0, frequency=0.3),
    observer=Told(),
    simulation=uz.Simulation(time="sampled", step=0.01),
)
print(uz.simulate(scenario))

# %% [markdown]
# What does it cost to be told a wrong width? And what does an observer get that is told none?

# %%
rivals = {"told 0.7": Told(), "told 0.5": Told(width=0.5), "auto": uz.Auto(right=[0.0, 2.0])}
for name, observer in rivals.items():
    run = uz.simulate(scenario | {"observer": observer})
    print(f"{name:9} rms z - z^ {run.rms_estimation:.4f}")

# %%
online = uz.Online(Told(), scenario.plant, scenario.sensor, step=0.01)
for _ in range(500):
    shown = online.update(y=0.3, u=1.0)
print("z^ =", shown.z, " (the reading 0.3 and the width 0.7 make 1.0)")

# %% [markdown]
# In the package it becomes a file in `src/undeadzone/observers/`;
# [the recipe](../../CONTRIBUTING.md) lists the seven steps. From then on scenario files and every
# command know it, and the arena runs it against every other method.
