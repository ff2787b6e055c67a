"""The graph of an observer alone, and how it runs along blocks of samples."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.engine import interpret
from undeadzone.interfaces import Estimate, Observer, received
from undeadzone.plants.system import System
from undeadzone.sensor import Zone, present
from undeadzone.support import tree
from undeadzone.support.arrays import Floats

PATIENCE: Final = 100_000  # samples in blocks, after which the step is compiled


class Out(NamedTuple):
    """What a step gives: the estimate, the measured side (p), and 1 where a reading was missing."""

    estimate: Estimate
    side: Any
    missing: Any


def observer_graph(
    model: System, observer: Observer, sensor: Zone
) -> tuple[ca.Function, Floats, Floats, Out]:
    """The graph of an observer alone.

    Args:
        model: the sampled model.
        observer: the observer.
        sensor: the dead zone, for its threshold and its range.

    Returns:
        The function step(s, w, p) -> (next, out) with w = [y; u], its packed state, its packed
        params, and the shapes of out.
    """
    values = (observer.params, (sensor.threshold, sensor.limits))
    column, (params, levels) = tree.symbols(values, "p")
    state = (observer.init(observer.params), np.zeros(model.m))
    s_column, (s, held) = tree.symbols(state, "s")
    y, u = ca.SX.sym("y", model.p), ca.SX.sym("u", model.m)
    used = ca.if_else(present(u), u, held)
    reading = received(y, *levels)
    after, estimate = observer.step(params, s, used, reading)
    side = estimate.contact if estimate.contact.shape[0] else reading.side
    out = Out(estimate, side, ca.mmin(present(y)) == 0)
    function = ca.Function(
        "live",
        [s_column, ca.vertcat(y, u), column],
        [tree.stack((after, used)), tree.stack(out)],
        {"cse": True},
    )
    shapes: Out = tree.rebuild(out, (np.zeros(part.shape[0]) for _, part in tree.leaves(out)))
    return function, tree.pack(state), tree.pack(values), shapes


class BlockRunner:
    """Runs an observer's graph along blocks of samples.

    A long record is worth a compilation, after which every bit stays as it was.

    Args:
        step: the graph, next, out = step(s, w, p).
        params: p.
    """

    def __init__(self, step: ca.Function, params: Floats) -> None:
        self._step, self._params = step, params
        self._count = 0  # samples so far
        self._kernel: Any = None

    def run(self, state: Floats, w: Floats) -> Floats:
        """The outputs along w (N x inputs), a row each; the state is moved in place."""
        self._count += len(w)
        if self._kernel is None and self._count > PATIENCE:
            from undeadzone.engine import lanes

            self._kernel = lanes.build(self._step, width=1)
        if self._kernel is None:
            outputs, state[:] = interpret.run(self._step, state, w, self._params)
            return outputs
        from undeadzone.engine import lanes

        every, finals = lanes.run(self._kernel, state, w, self._params)
        state[:] = finals[0]
        return np.asarray(every[0])
