"""Live use: one sample in, one estimate out, in microseconds."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from undeadzone.engine.interpret import Stepper
from undeadzone.interfaces import graph_of
from undeadzone.observers import Observer, ObserverOptions, Reading
from undeadzone.plants import build as plants
from undeadzone.plants.options import Plant
from undeadzone.plants.system import System, sampled
from undeadzone.scenario.problem import require_bounded_error, require_visible
from undeadzone.sensor import Sensor, present, resolve, side
from undeadzone.support import tree
from undeadzone.support.arrays import Array, Floats, scalar


class OnlineEstimate(NamedTuple):
    """One live estimate: the fields of `Estimate` as arrays (empty where the observer has none), and the side (p)."""

    x: Floats
    z: Floats
    right: Floats
    left: Floats
    z_inverse: Floats
    innovation: Floats
    x_std: Floats
    right_std: Floats
    left_std: Floats
    width_std: Floats
    innovation_std: Floats
    w: Floats
    theta: Floats
    theta_std: Floats
    side: Floats


class Online:
    """An observer fed one sample at a time: `Online(Certified(L=..., gamma=...), plant, sensor, step).update(y, u)`.

    plant: what the observer believes; sensor: kind, slope, noise and threshold (its widths are used by the oracle only);
    step: sample time [s]; a nonlinear plant moves by `substeps` Runge-Kutta steps in it. A reading that is NaN or infinite is
    missing: nothing is corrected, and `missing` counts it; an input that is not finite is taken to be the last one.
    Raises InputError and its kinds as a scenario would.
    """

    def __init__(
        self,
        observer: ObserverOptions,
        plant: Plant,
        sensor: Sensor,
        step: float,
        substeps: int = 10,
    ) -> None:
        Ts = scalar("step", step, above=0.0)
        system = plants.system(plant)
        require_visible(system, "plant")
        self.model = sampled(system, Ts, substeps)
        zone = resolve(sensor, self.model.p, Ts)
        built = graph_of(observer.build(self.model, zone))
        require_bounded_error(self.model, built, Ts)
        graph, state, params, sizes = _graph(self.model, built, zone.threshold)
        self.samples = 0
        self.missing = 0
        self._step = Stepper(graph, state, params)
        self._p, self._w, self._out = self.model.p, self._step.w, self._step.out
        ends = np.cumsum(sizes).tolist()
        self._cuts = [slice(end - size, end) for end, size in zip(ends, sizes, strict=True)]

    def update(self, y: Array, u: Array) -> OnlineEstimate:
        """The estimate from reading y (p) and all before it; u (m) acts from this sample to the next."""
        self._w[: self._p] = y
        self._w[self._p :] = u
        self._step()
        self.samples += 1
        out = self._out.copy()
        if out[-1]:
            self.missing += 1
        return OnlineEstimate(*[out[cut] for cut in self._cuts])

    def peek(self, y: Array) -> OnlineEstimate:
        """The estimate that `update(y, u)` would return, which does not depend on u; nothing advances."""
        state, samples, missing = self._step.state.copy(), self.samples, self.missing
        found = self.update(y, 0.0)
        self._step.state[:] = state
        self.samples, self.missing = samples, missing
        return found


def _graph(
    model: System, observer: Observer, threshold: Floats
) -> tuple[ca.Function, Floats, Floats, list[int]]:
    """(step(s, w, p) -> (next, out), state, params, sizes of out's parts) of an observer alone.

    w = [y; u]; out is the estimate, the side, and whether y was missing.
    """
    values = (observer.params, threshold)
    column, (params, eps) = tree.symbols(values, "p")
    state = (observer.init(observer.params), np.zeros(model.m))
    s_column, (s, held) = tree.symbols(state, "s")
    y, u = ca.SX.sym("y", model.p), ca.SX.sym("u", model.m)
    seen = ca.if_else(present(y), y, np.nan)
    used = ca.if_else(present(u), u, held)
    reading = Reading(seen, side(seen, eps))
    after, estimate = observer.step(params, s, used, reading)
    out = ca.vertcat(tree.stack(estimate), reading.side, ca.mmin(present(y)) == 0)
    function = ca.Function(
        "live",
        [s_column, ca.vertcat(y, u), column],
        [tree.stack((after, used)), out],
        {"cse": True},
    )
    return (
        function,
        tree.pack(state),
        tree.pack(values),
        [part.shape[0] for part in (*estimate, reading.side)],
    )
