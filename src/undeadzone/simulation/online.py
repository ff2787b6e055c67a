"""Live use: one sample in, one estimate out, in microseconds."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.engine.interpret import Stepper
from undeadzone.interfaces import Estimate, Observer, Reading, graph_of
from undeadzone.observers import ObserverOptions
from undeadzone.plants import build as plants
from undeadzone.plants.options import Plant
from undeadzone.plants.system import System, sampled
from undeadzone.scenario.problem import require_visible
from undeadzone.scenario.time_step import require_bounded_error
from undeadzone.sensor import Sensor, present, resolve, side
from undeadzone.support import tree
from undeadzone.support.arrays import Array, Floats, scalar


class Online:
    """An observer fed one sample at a time.

    `Online(Auto(...), plant, sensor, step).update(y, u)` gives an `Estimate`. A reading that is NaN
    or infinite is missing: nothing is corrected. An input that is not finite is the last one.

    Args:
        observer: options of the observer.
        plant: the plant as the observer knows it.
        sensor: kind, slope, noise and threshold; its widths are used by the oracle only.
        step: sample time [s].
        substeps: Runge-Kutta steps in a sample, of a nonlinear plant.

    Attributes:
        model: the sampled model.
        samples: how many samples came in.
        missing: how many of them had a reading missing.
        side: measured side of the last reading (p): +1 right, -1 left, 0 silent or missing.

    Raises:
        InputError: or a subclass, as a scenario would.
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
        graph, state, params, shapes = _graph(self.model, built, zone.threshold)
        self.samples = 0
        self.missing = 0
        self.side = np.zeros(self.model.p)
        self._step = Stepper(graph, state, params)
        self._p, self._w, self._out = self.model.p, self._step.w, self._step.out
        self._where: _Out = tree.slices(shapes)

    def update(self, y: Array, u: Array) -> Estimate:
        """Take one sample in, give one estimate out.

        Args:
            y: reading (p); NaN or infinite: missing.
            u: input (m) that acts from this sample to the next; not finite: as before.

        Returns:
            The estimate from this reading and all before it, as NumPy arrays; empty where the
            observer estimates nothing.
        """
        self._w[: self._p] = y
        self._w[self._p :] = u
        self._step()
        self.samples += 1
        out = self._out.copy()
        self.side = out[self._where.side]
        if out[-1]:
            self.missing += 1
        return Estimate(*[out[part] for part in self._where.estimate])

    def peek(self, y: Array) -> Estimate:
        """The estimate that `update(y, u)` would return; nothing advances.

        It does not depend on u.

        Args:
            y: reading (p).
        """
        before = self._step.state.copy(), self.samples, self.missing, self.side
        estimate = self.update(y, 0.0)
        self._step.state[:], self.samples, self.missing, self.side = before
        return estimate


class _Out(NamedTuple):
    """What a step gives: the estimate, the measured side (p), and 1 where a reading was missing."""

    estimate: Estimate
    side: Any
    missing: Any


def _graph(
    model: System, observer: Observer, threshold: Floats
) -> tuple[ca.Function, Floats, Floats, _Out]:
    """The graph of an observer alone.

    Args:
        model: the sampled model.
        observer: the observer.
        threshold: |y| that counts as silent (p).

    Returns:
        The function step(s, w, p) -> (next, out) with w = [y; u], its packed state, its packed
        params, and the shapes of out.
    """
    values = (observer.params, threshold)
    column, (params, silent) = tree.symbols(values, "p")
    state = (observer.init(observer.params), np.zeros(model.m))
    s_column, (s, held) = tree.symbols(state, "s")
    y, u = ca.SX.sym("y", model.p), ca.SX.sym("u", model.m)
    seen = ca.if_else(present(y), y, np.nan)
    used = ca.if_else(present(u), u, held)
    reading = Reading(seen, side(seen, silent))
    after, estimate = observer.step(params, s, used, reading)
    out = _Out(estimate, reading.side, ca.mmin(present(y)) == 0)
    function = ca.Function(
        "live",
        [s_column, ca.vertcat(y, u), column],
        [tree.stack((after, used)), tree.stack(out)],
        {"cse": True},
    )
    shapes: _Out = tree.rebuild(out, (np.zeros(part.shape[0]) for _, part in tree.leaves(out)))
    return function, tree.pack(state), tree.pack(values), shapes
