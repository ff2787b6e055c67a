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

from undeadzone.interfaces import Observer, estimate


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
        shown = estimate(x, z, p.width, p.width, reading, 1.0, sensor.kind, e)
        return moved, shown

    return Observer(Params(L, width), init, step)


# %% [markdown]
# `uz.Online` takes options with a `build`; a class with the two lines below is enough to try it.

# %%
import undeadzone as uz


class Told:
    """Options of the observer above."""

    def build(self, model, sensor):
        """The observer for a model."""
        return build(model, sensor, np.array([[2.0], [1.0]]) * model.Ts, np.array([0.7]))


plant = uz.Plant(A=[[0, 1], [-1, -2]], B=[0, 1], C=[1, 0])
online = uz.Online(Told(), plant, uz.Sensor(right=0.7, left=0.7), step=0.01)
for _ in range(500):
    shown = online.update(y=0.3, u=1.0)
print("z^ =", shown.z, " (the reading 0.3 and the width 0.7 make 1.0)")

# %% [markdown]
# In the package it becomes a file in `src/undeadzone/observers/` whose options are a
# `msgspec.Struct`; [the recipe](../../CONTRIBUTING.md) lists the seven steps. From then on the
# arena runs it against every other method.
