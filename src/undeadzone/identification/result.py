"""What `identify` returns: the answer with what can be made of it."""

from __future__ import annotations

import dataclasses
import json
import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from undeadzone.errors import InputError
from undeadzone.identification.answer import Answer
from undeadzone.identification.element import Element
from undeadzone.identification.intervals import Interval
from undeadzone.identification.kalman_smoother import smoothed_with_spread
from undeadzone.identification.plant_fit import Simulator
from undeadzone.identification.summary import numbers
from undeadzone.identification.to_scenario import scenario_text
from undeadzone.identification.words import in_words
from undeadzone.support import shown
from undeadzone.support.arrays import Floats, finite
from undeadzone.support.files import write_text
from undeadzone.support.shown import Block

WRITTEN = ("play", "both", "input_zone")  # verdicts besides the sensor's zone that a scenario has


class States(NamedTuple):
    """Hidden signals along the log.

    Attributes:
        t: times (N) [s].
        z: output ahead of the zone (N) [y], the disturbance included where one was found.
        z_std: its standard deviation (N) [y].
        x: states of the plant in observer form, the first is z without noise (N x n) [y].
    """

    t: Floats
    z: Floats
    z_std: Floats
    x: Floats


@dataclasses.dataclass(frozen=True, eq=False)
class Identified:
    """What a log says of plant and dead zone, and what can be made of it.

    Attributes:
        answer: every value; the properties below are its most used ones.
    """

    answer: Answer

    @property
    def verdict(self) -> str:
        """One word: dead_zone, none, saturation, jump, play, both, friction, input_zone, ..."""
        return self.answer.verdict

    @property
    def zone(self) -> bool:
        """Whether the sensor has a dead zone."""
        return self.answer.zone

    @property
    def right(self) -> Interval | None:
        """d_r, of a play c_r [y], of an input zone b_r [u]: (value, low, high)."""
        return self.answer.right

    @property
    def left(self) -> Interval | None:
        """d_l, of a play c_l [y], of an input zone b_l [u]: (value, low, high)."""
        return self.answer.left

    @property
    def width(self) -> Interval | None:
        """The sum of both as (value, low, high)."""
        return self.answer.width

    @property
    def centre(self) -> Interval | None:
        """Half of their difference as (value, low, high)."""
        return self.answer.centre

    @property
    def order(self) -> int:
        """Poles of the plant."""
        return self.answer.order

    @property
    def plant(self) -> dict[str, Any]:
        """Poles [1/s] and DC gains [y/u] of the plant."""
        return {"poles": self.answer.poles, "gain": self.answer.gain}

    @property
    def alternatives(self) -> dict[str, Any]:
        """Nats per sample by which other models are behind the best."""
        return dict(self.numbers()["alternatives"])

    def states(self) -> States:
        """z and the plant's states along the log, with deviations.

        Returns:
            The smoothed states where a disturbance was found ahead of the zone, else those of the
            simulation.
        """
        if self.answer.element is not None:
            return self._states_of(self.answer.element)
        kalman = self.answer.evidence.kalman
        n = self.answer.order
        t = self.answer.evidence.grid.t
        if kalman and kalman[0].model != 0:
            smoothed, std = smoothed_with_spread(kalman[0])
            z = smoothed.z * self.answer.scale
            return States(t, z, std * self.answer.scale, smoothed.x[:, :n] * self.answer.scale)
        objective = self.answer.fit.objective
        slope = objective.simulator.gradient(self.answer.fit.theta, self.answer.fit.z)[
            :, objective.free
        ]
        V = objective.spread(self.answer.fit.theta).V
        variance = np.einsum("tp,pq,tq->t", slope, V, slope)
        std = np.sqrt(np.maximum(variance, 0.0))
        return States(
            t,
            self.answer.fit.z * self.answer.scale,
            std * self.answer.scale,
            self._simulated_states(objective.simulator, self.answer.fit.theta),
        )

    def _states_of(self, element: Element) -> States:
        """z and states behind an element, simulated; the deviation holds what disturbs z."""
        simulator, scale = element.simulator, self.answer.scale
        slope = simulator.gradient(element.theta, element.z)[:, : len(element.V)]
        variance = np.einsum("tp,pq,tq->t", slope, element.V, slope)
        rms = element.rms if element.ahead is None else element.ahead.rms
        std = np.sqrt(np.maximum(variance, 0.0) + rms**2)
        x = self._simulated_states(simulator, element.theta)
        return States(self.answer.evidence.grid.t, element.z * scale, std * scale, x)

    def _simulated_states(self, simulator: Simulator, theta: Floats) -> Floats:
        """States of the simulation in observer form (N x n) [y]."""
        layout, data = simulator.layout, simulator.data
        F = np.eye(layout.n, k=1)
        F[:, 0] = -layout.denominator(theta[layout.a])
        drive = data.u @ theta[layout.b].reshape(layout.m, layout.n)
        x0 = theta[layout.x0].reshape(layout.records, layout.n)
        x = np.empty((data.y.size, layout.n))
        for part, state in zip(data.records(), x0, strict=True):
            now = state
            for t in range(part.start, part.stop):
                x[t] = now
                now = F @ now + drive[t]
        return x * self.answer.scale

    def scenario(self) -> str:
        """A scenario as TOML text, which `run`, `check`, `design` and `watch` take as it is.

        Returns:
            The text, with a remark for every number that says where it came from.

        Raises:
            InputError: no dead zone was found, or no plant in continuous time fits.
        """
        known = self.answer.zone or self.answer.evidence.jumps is not None
        if not known and self.verdict not in WRITTEN:
            raise InputError(
                f"scenario: the verdict is {self.answer.verdict}: there is no zone to write"
            )
        return scenario_text([self.answer])

    def numbers(self) -> dict[str, Any]:
        """All numbers of the answer, as `--json` prints them."""
        return dict(finite(numbers(self.answer)))

    def summary(self) -> dict[str, Any]:
        """The answer in words, as the command prints it."""
        return in_words(self.answer)

    def blocks(self) -> list[Block]:
        """The table that `undeadzone identify` prints."""
        return [self.summary()]

    __repr__ = shown.in_text
    _repr_html_ = shown.in_notebook

    plot = shown.plot
    """Draw it."""

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write all numbers as JSON.

        Args:
            path: the file.

        Returns:
            The path.

        Raises:
            FileError: it cannot be written.
        """
        text = json.dumps(self.numbers(), indent=2, allow_nan=False)
        return write_text(text + "\n", Path(path))
