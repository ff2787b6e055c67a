# %% [markdown]
# # Add an observer
#
# A method is one file: equations on CasADi expressions, and options. What you write once runs on
# the virtual machine, compiled in ensembles, and as C on a board. This page makes a package of
# your own with a Luenberger observer that takes the width of the dead zone from its options. A
# method of this repository has the same first three steps
# ([contributing](../../CONTRIBUTING.md)).
#
# ## 1. Write the equations
#
# `Observer` holds the numbers, the state at t = 0, and one step. The step is a pure function. It
# returns the state's next value, or its derivative in continuous time, and the estimate. The
# estimate must not depend on u. `reading.side` is +1 right of the dead zone, -1 left of it, 0
# inside. At a limit of the sensor's range y is only a bound: `drop_limit_readings` makes it
# missing.

# %%
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

import undeadzone as uz
from undeadzone.interfaces import Observer, build_estimate, drop_limit_readings
from undeadzone.observers.adaptive.gain import innovation_gain


class Params(NamedTuple):
    """Numbers of the model, gain and width."""

    model: Any
    L: Any
    width: Any


def build_observer(model, sensor, L, width):
    """Return x^' = A x^ + B u + L e. The innovation e is 0 inside of the dead zone."""

    def init(p):
        return np.zeros(model.n)

    def step(p, x, u, reading):
        reading = drop_limit_readings(reading, sensor.limits)
        z = model.output(p.model, x)
        e = ca.if_else(reading.side != 0, reading.y - (z - p.width * reading.side), 0)
        estimate = build_estimate(x, z, p.width, p.width, reading, 1.0, sensor.kind, e)
        return model.move_with_correction(p.model, x, u, p.L @ e), estimate

    return Observer(Params(model.params, L, width), init, step)


# %% [markdown]
# ## 2. Declare the options
#
# `tag` is the name of the method. Each option has an entry under `Attributes:`, which the tool
# shows. The docstring of a published method cites its source. `build` takes a model, continuous
# or sampled, and the sensor. The two cells so far are the file `fixed_width.py`.


# %%
class FixedWidth(uz.Options, frozen=True, kw_only=True, tag="fixed_width"):
    """Luenberger observer of a sensor whose dead zone has a known width.

    Attributes:
        width: of the dead zone on each side [z].
        L: gains (n x p) [1/s] (default: certified gains).
    """

    width: float = 0.7
    L: Any = None

    def build(self, model, sensor):
        """Return the observer for a model."""
        L = innovation_gain(self.L, model) * model.per_step
        return build_observer(model, sensor, L, np.full(model.p, self.width))


# %% [markdown]
# ## 3. Compare it
#
# The options run in any scenario, and sample by sample. How large is the error with a wrong
# width, and with an observer that estimates the width?

# %%
scenario = uz.Scenario(
    title="A declared width",
    plant=uz.Plant(A=[[0, 1], [-1, -2]], B=[0, 1], C=[1, 0]),
    sensor=uz.Sensor(right=0.7, left=0.7, noise=0.01),
    reference=uz.Sine(amplitude=3.0, frequency=0.3),
    observer=FixedWidth(),
    simulation=uz.Simulation(time="sampled", step=0.01),
)
rivals = {
    "width 0.7": FixedWidth(),
    "width 0.5": FixedWidth(width=0.5),
    "auto": uz.Auto(right=[0.0, 2.0]),
}
for name, observer in rivals.items():
    run = uz.simulate(scenario | {"observer": observer})
    print(f"{name:9} rms z - z^ {run.rms_estimation:.4f}")

# %%
online = uz.Online(FixedWidth(L=[2.0, 1.0]), scenario.plant, scenario.sensor, step=0.01)
for _ in range(1000):
    estimate = online.update(y=0.3, u=1.0)
print("z^ =", estimate.z, " (the reading 0.3 and the width 0.7 make 1.0)")

# %% [markdown]
# ## 4. Register it
#
# `pyproject.toml` beside the file says where the method is. `undeadzone` finds it as soon as the
# package is installed.
#
# ```toml
# [build-system]
# requires = ["hatchling"]
# build-backend = "hatchling.build"
#
# [project]
# name = "fixed-width"
# version = "1.0"
# dependencies = ["undeadzone"]
#
# [project.entry-points."undeadzone.observers"]
# fixed_width = "fixed_width:FixedWidth"
# ```
#
# ## 5. Install and run it
#
# A scenario names the method, as any other:
#
# ```toml
# title = "A declared width"
# observer = { method = "fixed_width", width = 0.7 }
# plant = { A = [[0.0, 1.0], [-1.0, -2.0]], B = [[0.0], [1.0]], C = [[1.0, 0.0]] }
# sensor = { right = 0.7, left = 0.7, noise = 0.01 }
# reference = { kind = "sine", amplitude = 3.0, frequency = 0.3 }
# simulation = { duration = 5.0, step = 0.01, time = "sampled" }
# ```
#
# ```console
# $ pip install .
# $ undeadzone run scenario.toml
# ```
#
# `ensemble`, `tune`, `export` and `arena` take it too, and `uz.FixedWidth` is its class. A test
# runs these five steps in an empty folder. Controllers (`undeadzone.controllers`,
# `build(model)`), compensators (`undeadzone.compensators`, `build(model, belief)`), commands
# (`undeadzone.commands`, a click command) and names of `uz` (`undeadzone.names`) are registered
# the same way. An observer that has no graph of fixed size computes in Python:
# `undeadzone.interfaces.build_python_observer`.
