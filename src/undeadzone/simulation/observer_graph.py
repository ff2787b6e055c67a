"""The graph of an observer alone, and how it runs along blocks of samples."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.ends.sensor import Zone, present
from undeadzone.engine import interpret
from undeadzone.interfaces import Estimate, Observer, Reading, received
from undeadzone.plants.system import System
from undeadzone.support import tree
from undeadzone.support.arrays import Floats

PATIENCE: Final = 20_000  # samples in blocks (`lanes.WORTH`), after which the step is compiled


class Out(NamedTuple):
    """What a step gives: the estimate, the measured side (p), and 1 where a reading was missing."""

    estimate: Estimate
    side: Any
    missing: Any


class Symbols(NamedTuple):
    """The symbols of an observer's graph.

    Attributes:
        s, w, p: columns of the state, of [y; u] and of the params.
        state, params: the observer's own, as trees.
        used: the input, the last one where it is missing (m).
        reading: what is read.
        start, numbers: values of s and p.
    """

    s: ca.SX
    w: ca.SX
    p: ca.SX
    state: Any
    params: Any
    used: ca.SX
    reading: Reading
    start: Floats
    numbers: Floats


def symbols(model: System, observer: Observer, sensor: Zone) -> Symbols:
    """Fresh symbols for the graph of an observer.

    Args:
        model: the sampled model.
        observer: the observer.
        sensor: the dead zone, for its threshold and its range.
    """
    values = (observer.params, (sensor.threshold, sensor.limits))
    column, (params, levels) = tree.symbols(values, "p")
    start = (observer.init(observer.params), np.zeros(model.m))
    s_column, (s, held) = tree.symbols(start, "s")
    y, u = ca.SX.sym("y", model.p), ca.SX.sym("u", model.m)
    used = ca.if_else(present(u), u, held)
    w, reading = ca.vertcat(y, u), received(y, *levels)
    return Symbols(
        s_column, w, column, s, params, used, reading, tree.pack(start), tree.pack(values)
    )


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
    known = symbols(model, observer, sensor)
    used, reading = known.used, known.reading
    after, estimate = observer.step(known.params, known.state, used, reading)
    side = estimate.contact if estimate.contact.shape[0] else reading.side
    out = Out(estimate, side, ca.mmin(present(known.w[: model.p])) == 0)
    function = ca.Function(
        "live",
        [known.s, known.w, known.p],
        [tree.stack((after, used)), tree.stack(out)],
        {"cse": True},
    )
    shapes: Out = tree.rebuild(out, (np.zeros(part.shape[0]) for _, part in tree.leaves(out)))
    return function, known.start, known.numbers, shapes


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
