"""Live use: one sample in, one estimate out, in microseconds."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, Final

import casadi as ca
import numpy as np

from undeadzone.catalogue import ObserverOptions
from undeadzone.ends.actuator import ActuatorModel, believed
from undeadzone.ends.sensor import Sensor, Zone, resolve
from undeadzone.engine.interpret import Stepper
from undeadzone.errors import InputError, ShapeError
from undeadzone.interfaces import Estimate, Observer, graph_of
from undeadzone.observers.parts.actuated import built as behind
from undeadzone.observers.parts.motion import require_hearer
from undeadzone.plants import build as plants
from undeadzone.plants.options import Plant
from undeadzone.plants.system import System, sampled
from undeadzone.plants.time_scales import pace
from undeadzone.scenario.problem import require_visible
from undeadzone.scenario.time_step import require_bounded_error
from undeadzone.simulation.observer_graph import BlockRunner, Out, observer_graph
from undeadzone.support import tree
from undeadzone.support.arrays import Array, Floats, scalar

if TYPE_CHECKING:
    from undeadzone.engine.live import CompiledStepper

FEW = 8  # samples in a block from which on it is run at once


class Online:
    """An observer fed one sample at a time.

    `Online(Auto(...), plant, sensor, step).update(y, u)` gives an `Estimate`. A reading that is NaN
    or infinite is missing: nothing is corrected. An input that is not finite is the last one.

    Args:
        observer: options of the observer.
        plant: the plant as the observer knows it.
        sensor: kind, slope, noise, threshold and range; its widths are used by the oracle only.
        step: sample time [s].
        substeps: Runge-Kutta steps in a sample, of a nonlinear plant.
        compiled: whether the step is compiled for this processor: the same bits in a fraction of
            the time. The first time this takes up to some seconds; the result is kept on disk.
        actuator: what is known of the actuator between u and the plant; widths that are ranges are
            estimated; None: there is none.

    Attributes:
        model: the sampled model.
        engine: what computes a sample: "compiled", or "virtual machine" and why it is not compiled.
        latest: the estimate from the last sample, as views that the next sample overwrites;
            NaN before the first.
        samples: how many samples came in.
        missing: how many of them had a reading missing.
        side: measured side of the last reading (p): +1 right, -1 left, 0 silent or missing; twice
            that at a limit of the range.

    Raises:
        InputError: or a subclass, as a scenario would.
    """

    KEPT: Final = ("samples", "missing", "state")

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
        self.model, zone, built = built_for(observer, plant, sensor, step, substeps, actuator)
        graph, state, params, shapes = observer_graph(self.model, graph_of(built), zone)
        self.samples = 0
        self.missing = 0
        self._step, self._blocks, self.engine = _engine(graph, state, params, compiled)
        self._p, self._w, self._out = self.model.p, self._step.w, self._step.out
        where: Out = tree.slices(shapes)
        self._where = where
        self.latest = Estimate(*[self._out[part] for part in where.estimate])
        self._entries, self._last = self._w.data, self._out.data
        self._is_single = (self.model.p, self.model.m) == (1, 1)
        self._graph, self._start, self._params = graph, state, params
        self.restart()

    def restart(self) -> None:
        """Begin anew, as if no sample had come in; what was counted stays."""
        self._step.state[:] = self._start
        self._out[:] = np.nan
        self._out[self._where.side] = 0.0

    @property
    def digest(self) -> str:
        """Of all that the observer is, whatever it has seen."""
        numbers = np.concatenate([self._start, self._params])
        return hashlib.sha256(self._graph.serialize().encode() + numbers.tobytes()).hexdigest()

    @property
    def state(self) -> Floats:
        """The observer's state and what it gave last, as one vector; it may be set."""
        return np.concatenate([self._step.state, self._out])

    @state.setter
    def state(self, numbers: Floats) -> None:
        self._step.state[:], self._out[:] = np.split(numbers, [self._step.state.size])

    @property
    def side(self) -> Floats:
        """Measured side of the last reading (p)."""
        return self._out[self._where.side].copy()

    def update(self, y: Array, u: Array) -> Estimate:
        """Take one sample in, give one estimate out.

        Args:
            y: reading (p); NaN or infinite: missing.
            u: input (m) that acts from this sample to the next; not finite: as before.

        Returns:
            The estimate from this reading and all before it, as NumPy arrays; empty where the
            observer estimates nothing.
        """
        self.update_into(y, u)
        out = self._out.copy()
        return Estimate(*[out[part] for part in self._where.estimate])

    def update_into(self, y: Array, u: Array) -> None:
        """Take one sample in; `latest` then holds the estimate, and nothing is copied.

        Args:
            y: reading (p); NaN or infinite: missing. Numbers of Python are the fastest.
            u: input (m) that acts from this sample to the next; not finite: as before.
        """
        if self._is_single and type(y) is float and type(u) is float:
            self._entries[0] = y
            self._entries[1] = u
        else:
            try:
                self._w[: self._p] = y
                self._w[self._p :] = u
            except (ValueError, TypeError):
                raise ShapeError(
                    f"sample: expected y and u with {self._p} and {self._w.size - self._p} "
                    f"numbers, found {y!r:.40} and {u!r:.40}"
                ) from None
        self._step()
        self.samples += 1
        if self._last[-1]:
            self.missing += 1

    def update_many(self, y: Floats, u: Floats) -> tuple[Estimate, Floats]:
        """Take a block of samples in, give their estimates out, as `update` does one by one.

        A record of a million samples takes about a second, after a compilation that is kept on
        disk.

        Args:
            y: readings (N x p); NaN or infinite: missing.
            u: inputs (N x m).

        Returns:
            The estimates, a row for each sample in each field, and the measured sides (N x p).
        """
        w = np.hstack([y, u])
        if self._blocks is not None and len(w) >= FEW:
            out = self._blocks.run(self._step.state, w)
        else:
            out = self._step.run(w)
        if len(w):
            self._out[:] = out[-1]
        self.samples += len(w)
        self.missing += int(out[:, -1].sum())
        sides = out[:, self._where.side]
        return Estimate(*[out[:, part] for part in self._where.estimate]), sides

    def peek(self, y: Array) -> Estimate:
        """The estimate that `update(y, u)` would return; nothing advances.

        It does not depend on u.

        Args:
            y: reading (p).
        """
        before = self._step.state.copy(), self._out.copy(), self.samples, self.missing
        estimate = self.update(y, 0.0)
        self._step.state[:], self._out[:], self.samples, self.missing = before
        return estimate


def _engine(
    graph: ca.Function, state: Floats, params: Floats, compiled: bool
) -> tuple[Stepper | CompiledStepper, BlockRunner | None, str]:
    """What runs single samples, what runs blocks (None: the same), and how it is called."""
    engine = "virtual machine"
    if compiled:
        from undeadzone.engine.live import CompiledStepper

        try:
            return CompiledStepper(graph, state, params), None, "compiled"
        except InputError as error:
            engine = f"virtual machine: {error}"
    return Stepper(graph, state, params), BlockRunner(graph, params), engine


def built_for(
    observer: ObserverOptions,
    plant: Plant,
    sensor: Sensor,
    step: float,
    substeps: int,
    actuator: ActuatorModel | None = None,
) -> tuple[System, Zone, Observer]:
    """The sampled model, the checked sensor, and the observer built for both.

    Args:
        observer: options of the observer.
        plant: the plant as the observer knows it.
        sensor: the sensor in a user's words.
        step: sample time [s].
        substeps: Runge-Kutta steps in a sample, of a nonlinear plant.
        actuator: what is known of the actuator; None: there is none.

    Raises:
        InputError: or a subclass, as a scenario would.
    """
    Ts = scalar("step", step, above=0.0)
    system = plants.system(plant)
    require_visible(system, "plant")
    model = sampled(system, Ts, substeps)
    zone = resolve(sensor, model.p, Ts, pace(system.linear))
    require_hearer(observer, zone)
    built = behind(observer, model, zone, believed(actuator, model.m))
    require_bounded_error(model, built, Ts)
    return model, zone, built
