"""What several tests share: the paper's scenario, observers on numbers, random plants."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import casadi as ca
import numpy as np
from hypothesis import strategies as st

from undeadzone.interfaces import Estimate, Observer, Reading
from undeadzone.linalg.matrices import Matrices
from undeadzone.nonlinearities.sensor import Sensor, Zone, resolve, side
from undeadzone.plants.build import system
from undeadzone.plants.options import Plant
from undeadzone.plants.system import System
from undeadzone.scenario.reader import convert
from undeadzone.scenario.schema import Scenario
from undeadzone.util import tree
from undeadzone.util.arrays import Floats

PAPER = """
title = "Paper example"
plant = { A = [[0.0, 1.0], [-1.0, -2.0]], B = [[0.0], [1.0]], C = [[1.0, 0.0]], x0 = [0.5, 0.0] }
sensor = { right = 1.0, left = 1.0 }
reference = { kind = "sine", amplitude = 5.0, frequency = 1.0 }
controller = { method = "state_feedback", alpha = 10.0 }
simulation = { duration = 2.0, step = 1e-3 }

[observer]
method = "certified"
L = [1.0, 1.5]
gamma = 10.0
widths0 = [0.2, 0.2]
width_max = 3.0
"""

seeds = st.integers(0, 2**32 - 1)
"""Of whatever a test draws."""

EXACT_SENSOR: dict[str, Any] = {"rounding": 0.0, "slope_std": 0.0, "lag": 0.0}
"""What a sensor is told whose edges are sharp, whose slope is known, and which is never late."""


def tables_of(text: str) -> dict[str, Any]:
    """Tables of a scenario, as its file has them."""
    return tomllib.loads(text)


COUPLED = tables_of("""
plant.A = [[-1.0, 0.4], [0.3, -2.0]]
plant.B = [[1.0, 0.2], [0.0, 1.5]]
plant.C = [[1.0, 0.3], [0.0, 1.0]]
sensor = { right = [0.5, 0.2], left = [0.3, 0.6] }
reference = { kind = "sine", amplitude = [2.0, 1.5], frequency = 0.5, phase = [0.0, 1.0] }
observer = { method = "certified", gamma = [2.0, 3.0], L = [[0.2, 0.0], [0.1, 0.3]] }
""")
"""A plant whose two inputs and outputs act on each other, with its observer."""


def table(text: str = "", **changes: Any) -> dict[str, Any]:
    """The tables of `PAPER` with those of a text and with changes.

    Those of `sensor` and `simulation` are merged, other tables replaced (None: dropped).
    """
    data = tables_of(PAPER)
    for key, value in (tables_of(text) | changes).items():
        if key in ("sensor", "simulation"):
            data[key] = data[key] | value
        else:
            data[key] = value
    return {key: value for key, value in data.items() if value is not None}


def scene(text: str = "", **changes: Any) -> Scenario:
    """The scenario of `table`."""
    return convert(table(text, **changes))


def linear(A: Any, B: Any, C: Any) -> System:
    """A linear `System`."""
    return system(Plant(A=A, B=B, C=C))


PAPER_PLANT = linear([[0.0, 1.0], [-1.0, -2.0]], [[0.0], [1.0]], [[1.0, 0.0]])


def zone(p: int = 1, **options: Any) -> Zone:
    """A sensor of p outputs at 20 Hz whose edges and slope are known."""
    return resolve(Sensor(**{"right": 1.0, "left": 1.0} | EXACT_SENSOR | options), p, 0.05)


def random_plant(
    rng: np.random.Generator, n: int, m: int = 1, p: int = 1, stable: bool = True
) -> System:
    """A random linear plant; stable: with poles left of about -0.2."""
    A = rng.normal(size=(n, n))
    if stable:
        A = A - (np.linalg.eigvals(A).real.max() + 0.2 + rng.uniform()) * np.eye(n)
    return linear(A, rng.normal(size=(n, m)), rng.normal(size=(p, n)))


def response(plant: Matrices, s: Any) -> Any:
    """C (sI - A)^-1 B at one s or at many (one matrix each)."""
    A, B, C = plant
    return C @ np.linalg.solve(np.asarray(s)[..., None, None] * np.eye(A.shape[0]) - A, B)


class OnNumbers:
    """An observer's step as a function of numbers.

    Args:
        observer: a graph.
        model: the plant that it watches.
    """

    def __init__(self, observer: Observer, model: System) -> None:
        self._like = observer.init(observer.params)
        p, params = tree.create_symbols(observer.params, "p")
        s, state = tree.create_symbols(self._like, "s")
        u, y, side = ca.SX.sym("u", model.m), ca.SX.sym("y", model.p), ca.SX.sym("side", model.p)
        after, estimate = observer.step(params, state, u, Reading(y, side))
        results = [*(leaf for _, leaf in tree.iterate_leaves(after)), *estimate]
        rows = [ca.vec(ca.densify(ca.SX(result)).T) for result in results]
        self._ends = np.cumsum([row.numel() for row in rows])[:-1]
        self._function = ca.Function("step", [p, s, u, y, side], [ca.vertcat(*rows)])
        # Without a buffer, conversions take longer than the step.
        self._buffer, self._evaluate = self._function.buffer()
        self._given = [np.zeros(self._function.numel_in(k)) for k in range(5)]
        self._given[0][:] = tree.pack_tree(observer.params)
        self._out = np.zeros(self._function.numel_out(0))
        for k, values in enumerate(self._given):
            self._buffer.set_arg(k, values.data)
        self._buffer.set_res(0, self._out.data)

    def __call__(self, state: Any, u: Any, y: Any, side: Any) -> tuple[Any, Estimate]:
        """(next state or derivative, estimate)."""
        for place, value in zip(self._given[1:], (tree.pack_tree(state), u, y, side), strict=True):
            place[:] = np.ravel(value)
        self._evaluate()
        parts = iter(np.split(self._out.copy(), self._ends))
        return tree.rebuild_tree(self._like, parts), Estimate(*parts)


def centre_std(estimate: Estimate) -> Floats:
    """The standard deviations of (d_r - d_l) / 2."""
    sums = 2 * estimate.right_std**2 + 2 * estimate.left_std**2
    return np.asarray(np.sqrt(sums - estimate.width_std**2) / 2)


def follow_together(
    pair: Sequence[Observer], model: System, where: Zone, signals: Iterable[tuple[Floats, Floats]]
) -> Iterator[tuple[list[Any], list[Estimate]]]:
    """States and estimates of observers after each reading and input."""
    steps = [OnNumbers(observer, model) for observer in pair]
    states = [observer.init(observer.params) for observer in pair]
    for y, u in signals:
        seen = side(y, where.threshold)
        both = [step(state, u, y, seen) for step, state in zip(steps, states, strict=True)]
        states = [after for after, _ in both]
        yield states, [estimate for _, estimate in both]


def slopes(steps: Any, errors: Any) -> Floats:
    """The orders that successive errors show: log(e_i / e_{i+1}) / log(h_i / h_{i+1})."""
    orders: Floats = np.diff(np.log(np.asarray(errors))) / np.diff(np.log(np.asarray(steps)))
    return orders
