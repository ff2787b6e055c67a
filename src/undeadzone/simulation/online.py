"""Live use: one sample in, one estimate out, in microseconds."""

from __future__ import annotations

import hashlib
import warnings
from typing import TYPE_CHECKING, Any, Final, NamedTuple, cast

import casadi as ca
import numpy as np

from undeadzone.compile.interpret import Stepper
from undeadzone.errors import ShapeError
from undeadzone.interfaces import (
    Estimate,
    Observer,
    Reading,
    require_graph,
    sample_branch,
    to_reading,
)
from undeadzone.nonlinearities.actuator import ActuatorModel, believe_actuator
from undeadzone.nonlinearities.sensor import Sensor, Zone, present
from undeadzone.plants import build as plants
from undeadzone.plants.options import Plant
from undeadzone.plants.system import System, plant_pace, sample_plant
from undeadzone.registry import ObserverOptions
from undeadzone.scenario.encoders import group_coupled_joints, resolve_sensor
from undeadzone.scenario.messages import require_kind, require_words
from undeadzone.scenario.overrun import overrun_along
from undeadzone.scenario.problem import require_visible, watching
from undeadzone.util import tree
from undeadzone.util.arrays import Array, Floats, fill_masked, require_number
from undeadzone.util.installed import use_one_blas_thread

if TYPE_CHECKING:
    from undeadzone.compile.scalar_step import CompiledStepper


class Out(NamedTuple):
    """Outputs of a step: the estimate, the measured side (p), and 1 if a reading was missing."""

    estimate: Estimate
    side: Any
    missing: Any


class ObserverGraph(NamedTuple):
    """Graph of an observer alone, and its parts.

    Attributes:
        step: step(s, w, p) -> (next, out).
        out: shapes of its outputs.
        s, w, p: columns of the state, of `[y; u]` and of the params.
        state, params: the observer's own, as trees.
        used: the input, the last one if it is missing (m).
        reading: the reading.
        start, numbers: values of s and p.
    """

    step: ca.Function
    out: Out
    s: ca.SX
    w: ca.SX
    p: ca.SX
    state: Any
    params: Any
    used: ca.SX
    reading: Reading
    start: Floats
    numbers: Floats


def observer_graph(model: System, observer: Observer, sensor: Zone) -> ObserverGraph:
    """Return the graph of an observer alone.

    Args:
        model: the sampled model.
        observer: the observer.
        sensor: the dead zone, for its threshold and its range.
    """
    values = (observer.params, (sensor.threshold, sensor.limits))
    p, (params, levels) = tree.create_symbols(values, "p")
    start = (observer.init(observer.params), np.zeros(model.m))
    s, (state, last_input) = tree.create_symbols(start, "s")
    y, u = ca.SX.sym("y", model.p), ca.SX.sym("u", model.m)
    used = ca.if_else(present(u), u, last_input)
    w, reading = ca.vertcat(y, u), to_reading(y, *levels)
    after, estimate = observer.step(params, state, used, reading)
    out = Out(estimate, sample_branch(reading, estimate), ca.mmin(present(y)) == 0)
    results = [tree.stack_leaves((after, used)), tree.stack_leaves(out)]
    step = ca.Function("live", [s, w, p], results, {"cse": True})
    shapes: Out = tree.map_leaves(lambda part: np.zeros(part.shape[0]), out)
    symbols = (s, w, p, state, params, used, reading)
    return ObserverGraph(step, shapes, *symbols, tree.pack_tree(start), tree.pack_tree(values))


class Online:
    """An observer fed one sample at a time.

    `Online(Auto(...), plant, sensor, step).update(y, u)` gives an `Estimate`. A reading that is NaN
    or infinite is missing: nothing is corrected. An input that is not finite is the last one.

    Args:
        observer: options of the observer.
        plant: the plant as the observer knows it.
        sensor: kind, slope, noise, threshold and range (its widths are used by the oracle only).
        step: sample time [s].
        substeps: Runge-Kutta steps in a sample, of a nonlinear plant.
        compiled: whether the step is compiled for this processor: the same bits in a fraction of
            the time. The first time this takes up to some seconds, in which the virtual machine
            runs the samples. The result is cached on disk.
        actuator: model of the actuator between u and the plant, whose widths are estimated if they
            are ranges (None: there is none).

    Attributes:
        model: the sampled model.
        engine: engine that computes a sample: "compiled", "compiled, first form", while a faster
            one is made (or "virtual machine" and the reason).
        latest: the estimate from the last sample, as views that the next sample overwrites (NaN
            before the first).
        samples: how many samples came in.
        missing: how many of them had a reading missing.
        side: measured side of the last reading (p): +1 right, -1 left, 0 silent or missing (twice
            that at a limit of the range).

    Raises:
        InputError: or a subclass, as a scenario would.

    Example:
        >>> online = uz.Online(observer, plant, sensor, step=0.01)
        >>> estimate = online.update(y=0.3, u=1.0)
        >>> online.samples
        1

    See Also:
        estimate, export, deadzone_update
    """

    SAVED: Final = ("samples", "missing", "state")

    def __init__(
        self,
        observer: ObserverOptions,
        plant: Plant,
        sensor: Sensor,
        step: float,
        substeps: int = 10,
        compiled: bool = False,
        actuator: ActuatorModel | None = None,
    ) -> None:
        self._arguments = observer, plant, sensor, step, substeps, compiled, actuator
        self.model, zone, built = build_observer(observer, plant, sensor, step, substeps, actuator)
        self._graph = observer_graph(self.model, require_graph(built), zone)
        self.samples = 0
        self.missing = 0
        self._step = _stepper(self._graph, compiled)
        self._p, self._w, self._out = self.model.p, self._step.w, self._step.out
        self._where: Out = tree.leaf_slices(self._graph.out)
        self.latest = Estimate(*[self._out[part] for part in self._where.estimate])
        self._entries = cast("memoryview[float]", self._w.data)
        self._last = self._out.data
        self._is_single = (self.model.p, self.model.m) == (1, 1)
        self._load = zone if zone.inertia.any() and not self.model.nonlinear else None
        self.restart()

    def restart(self) -> None:
        """Restart as if no sample had come in. The counts stay."""
        self._step.state[:] = self._graph.start
        self._out[:] = np.nan
        self._out[self._where.side] = 0.0

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the constructor's arguments and the saved state, for pickle."""
        return Online, self._arguments, {name: getattr(self, name) for name in self.SAVED}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the saved state of another object."""
        for name, value in state.items():
            setattr(self, name, value)

    @property
    def engine(self) -> str:
        """Return what computes a sample."""
        return self._step.engine

    def settle(self) -> None:
        """Wait until the fastest code computes the samples, of which no bit changes."""
        self._step.settle()

    @property
    def digest(self) -> str:
        """Return a digest of the observer's graph and numbers, the same after any samples."""
        numbers = np.concatenate([self._graph.start, self._graph.numbers])
        graph = self._graph.step.serialize().encode()
        return hashlib.sha256(graph + numbers.tobytes()).hexdigest()

    @property
    def state(self) -> Floats:
        """Return the observer's state and its last output as one vector, which may be set."""
        return np.concatenate([self._step.state, self._out])

    @state.setter
    def state(self, numbers: Floats) -> None:
        size = self._step.state.size + self._out.size
        try:
            given = np.reshape(np.asarray(numbers, float), size)
        except (ValueError, TypeError):
            raise ShapeError(
                f"state: expected the {size} numbers that `state` gave, found {numbers!r:.60}"
            ) from None
        self._step.state[:], self._out[:] = np.split(given, [self._step.state.size])

    @property
    def side(self) -> Floats:
        """Return measured side of the last reading (p)."""
        return self._out[self._where.side].copy()

    def update(self, y: Array, u: Array) -> Estimate:
        """Return the estimate after the next sample.

        Args:
            y: reading (p) (NaN or infinite: missing).
            u: input (m) that acts from this sample to the next (not finite: as before).

        Returns:
            The estimate from this reading and all before it, as NumPy arrays, empty if the observer
            estimates nothing.
        """
        self.update_into(y, u)
        out = self._out.copy()
        return Estimate(*[out[part] for part in self._where.estimate])

    def update_into(self, y: Array | float, u: Array | float) -> None:
        """Take one sample in. `latest` then holds the estimate, and nothing is copied.

        Args:
            y: reading (p) (NaN or infinite: missing). Numbers of Python are the fastest.
            u: input (m) that acts from this sample to the next (not finite: as before).
        """
        if self._is_single and type(y) is float and type(u) is float:
            self._entries[0] = y
            self._entries[1] = u
        else:
            try:
                self._w[: self._p] = fill_masked(y)
                self._w[self._p :] = fill_masked(u)
            except (ValueError, TypeError):
                raise ShapeError(
                    f"sample: expected y and u with {self._p} and {self._w.size - self._p} "
                    f"numbers, found {y!r:.40} and {u!r:.40}"
                ) from None
        self._step()
        self.samples += 1
        if self._last[-1]:
            self.missing += 1
        if self._load is not None:
            self._warn(self._out[None, self._where.estimate.x], self._w[None, self._p :])

    def _warn(self, x: Floats, u: Floats) -> None:
        """Warn, once, of a load that coasts through its gap, where `simulate` would refuse."""
        assert self._load is not None
        number = overrun_along(self._load, self.model.continuous, x, np.nan_to_num(u)).max(
            initial=0.0
        )
        if number > 1:
            self._load = None
            warnings.warn(
                f"sensor.load_inertia: the overrun number J a / f reaches {number:.3g}. Above 1 "
                "the load coasts through its gap, and gaps come out wrong (docs/play.md)",
                stacklevel=3,
            )

    def update_many(self, y: Floats, u: Floats) -> tuple[Estimate, Floats]:
        """Return the estimates after each of a block of samples, as `update` does one by one.

        A record of a million samples takes about a second, after a compilation that is kept on
        disk.

        Args:
            y: readings (N x p) (NaN or infinite: missing).
            u: inputs (N x m).

        Returns:
            The estimates, a row for each sample in each field, and the measured sides (N x p).
        """
        try:
            columns = self._p, self._w.size - self._p
            pairs = zip((y, u), columns, strict=True)
            w = np.hstack([np.reshape(fill_masked(one), (len(y), many)) for one, many in pairs])
        except (ValueError, TypeError):
            raise ShapeError(
                f"samples: expected y and u with {self._p} and {self._w.size - self._p} columns, "
                f"and as many rows, found {np.shape(y)} and {np.shape(u)}"
            ) from None
        out = self._step.run(w)
        self.samples += len(w)
        self.missing += int(out[:, -1].sum())
        if self._load is not None:
            self._warn(out[:, self._where.estimate.x], u)
        sides = out[:, self._where.side]
        return Estimate(*[out[:, part] for part in self._where.estimate]), sides


def _stepper(graph: ObserverGraph, compiled: bool) -> Stepper | CompiledStepper:
    """Return the stepper that runs the samples."""
    parts = (graph.step, graph.start, graph.numbers)
    if compiled:
        from undeadzone.compile.scalar_step import CompiledStepper

        return CompiledStepper(*parts)
    return Stepper(*parts)


@use_one_blas_thread()
def build_observer(
    observer: ObserverOptions,
    plant: Plant,
    sensor: Sensor,
    step: float,
    substeps: int,
    actuator: ActuatorModel | None = None,
) -> tuple[System, Zone, Observer]:
    """Return the sampled model, the checked sensor, and the observer built for both.

    Args:
        observer: options of the observer.
        plant: the plant as the observer knows it.
        sensor: the sensor in a user's words.
        step: sample time [s].
        substeps: Runge-Kutta steps in a sample, of a nonlinear plant.
        actuator: model of the actuator (None: there is none).

    Raises:
        InputError: or a subclass, as a scenario would.
    """
    require_words("sensor", sensor, Sensor)
    require_words("plant", plant, Plant)
    require_kind("observer", observer, ObserverOptions)
    require_kind("actuator", actuator, ActuatorModel | None)
    Ts = require_number("step", step, above=0.0)
    system = plants.system(plant)
    require_visible(system, "plant")
    model = sample_plant(system, Ts, substeps)
    zone = resolve_sensor(sensor, system, Ts, plant_pace(system.linear))
    belief = believe_actuator(actuator, model.m)
    if system.gears is not None:
        start = plants.initial_state(plant, system)[
            system.gears.joint_count : 2 * system.gears.joint_count
        ]
        observer = group_coupled_joints(observer, system, start[None])
    return model, zone, watching(observer, model, zone, belief, Ts)
