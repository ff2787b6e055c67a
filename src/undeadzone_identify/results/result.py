"""Result of `identify`: the answer with states, scenario and next log, for any number of
outputs.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import os
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from scipy.signal import dlsim

from undeadzone.errors import InputError
from undeadzone.util import shown
from undeadzone.util.arrays import Floats, to_json_value
from undeadzone.util.files import write_text
from undeadzone.util.shown import Block
from undeadzone_identify.logs.log import log_from_arrays, read_log
from undeadzone_identify.models.estimates import Interval
from undeadzone_identify.models.kalman_fit import smooth_with_deviation
from undeadzone_identify.models.plant import PlantSimulator
from undeadzone_identify.results.account import GRADES, MEASURED, Account
from undeadzone_identify.results.assemble import Answer
from undeadzone_identify.results.lines import command_along, measure_lines
from undeadzone_identify.results.model import (
    Predicted,
    Simulated,
    answer_to_control,
    answer_to_pandas,
    predict_log,
    simulate_answer,
)
from undeadzone_identify.results.next_log import NextLog, best_next_log
from undeadzone_identify.results.speech import account_of_answer
from undeadzone_identify.results.to_continuous import observer_matrices
from undeadzone_identify.results.to_scenario import scenario_text
from undeadzone_identify.results.words import answer_numbers, summarise_answer

WRITTEN = (
    "play",
    "both",
    "input_zone",
    "two_zones",
    "input_play",
    "filtered_zone",
)  # besides the sensor's zone, in a scenario

UNWRITTEN = {
    "input_curve": "a curve of the input has no widths, and no inverse is written for it",
    "input_rate": "a scenario has no limit of the input's rate",
}


class States(NamedTuple):
    """Hidden signals along the log.

    Attributes:
        t: times (N) [s].
        z: output ahead of the zone (N) [y], the disturbance included if one was found.
        z_std: its standard deviation (N) [y].
        x: states of the plant in observer form, the first is z without noise (N x n) [y].
    """

    t: Floats
    z: Floats
    z_std: Floats
    x: Floats


class HasNumbers(Protocol):
    """Answer with numbers for JSON."""

    def numbers(self) -> dict[str, Any]:
        """Return all numbers of the answer."""


def save_numbers(found: HasNumbers, path: str | os.PathLike[str]) -> Path:
    """Write all numbers as JSON.

    Args:
        found: the answer.
        path: the file.

    Returns:
        The path.

    Raises:
        FileError: it cannot be written.
    """
    text = json.dumps(found.numbers(), indent=2, allow_nan=False)
    return write_text(text + "\n", path)


class Summarised(Protocol):
    """Answer with an account and a summary."""

    @property
    def account(self) -> Account:
        """Return the account."""

    def summary(self) -> dict[str, Any]:
        """Return the answer in words."""


class Spoken:
    """Answer to a log that its account says in one line."""

    def headline(self: Summarised) -> str:
        """Return the finding in one line."""
        return self.account.headline()

    def blocks(self: Summarised) -> list[Block]:
        """Return the table that `undeadzone identify` prints."""
        return [self.summary()]

    __repr__ = shown.format_result
    _repr_html_ = shown.result_to_html
    plot = shown.plot
    """Draw it."""

    save = save_numbers


class SpokenWithoutPlant(Spoken):
    """Answer to a log without a plant.

    Attributes:
        zone: False, as a dead zone of the sensor takes a plant to tell.
        no_scenario: reason, for the message of `scenario`.
    """

    zone = False
    no_scenario = ""

    def scenario(self, title: str = "Identified log") -> str:
        """Raise InputError with the reason, as no plant was fitted."""
        raise InputError(f"scenario: {self.no_scenario}")


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Identified(Spoken):
    """Estimate of plant and dead zone from a log, with its products.

    Attributes:
        answer: every value; the properties below are its most used ones.
        spoken: account of the log where another instrument than the fits gave it.

    Example:
        >>> import numpy as np
        >>> from scipy.signal import lfilter
        >>> t = 0.05 * np.arange(1000)
        >>> u = 3 * np.sin(0.9 * t) + 2 * np.sin(2.3 * t)
        >>> z = lfilter([0, 0.1], [1, -0.9], u)
        >>> noise = 0.01 * np.random.default_rng(0).standard_normal(1000)
        >>> y = z - np.clip(z, -0.3, 0.5) + noise
        >>> found = uz.identify(t=t, u=u, y=y, order=1, delay=0)
        >>> found.verdict, round(found.right.value, 2), round(found.left.value, 2)
        ('dead_zone', 0.5, 0.3)
        >>> bool(np.abs(found.simulate(u).y - y).max() < 0.1)
        True

    See Also:
        identify, Plant, estimate
    """

    answer: Answer
    spoken: Account | None = None

    @functools.cached_property
    def account(self) -> Account:
        """Return effect, cost, remedy, what is not decided, and the largest that could hide."""
        return self.spoken or account_of_answer(self.answer)

    @property
    def verdict(self) -> str:
        """Return the class as a word: dead_zone, none, play, both, friction, input_zone,
        undecided, ...
        """
        return self.answer.verdict

    @property
    def recorded_delay(self) -> int:
        """Return the delay of the input in the recording in samples, -1 if recorded late."""
        return self.answer.case.options.recorded_delay

    @property
    def zone(self) -> bool:
        """Return whether the sensor has a dead zone."""
        return self.answer.zone

    @property
    def right(self) -> Interval | None:
        """Return d_r, for a play c_r [y], for an input zone b_r [u]: (value, low, high)."""
        return self.answer.right

    @property
    def left(self) -> Interval | None:
        """Return d_l, for a play c_l [y], for an input zone b_l [u]: (value, low, high)."""
        return self.answer.left

    @property
    def width(self) -> Interval | None:
        """Return the sum of both widths as (value, low, high)."""
        return self.answer.width

    @property
    def centre(self) -> Interval | None:
        """Return the centre (d_r - d_l)/2, of c or of b alike, as (value, low, high)."""
        return self.answer.centre

    @property
    def order(self) -> int:
        """Return the number of poles of the plant."""
        return self.answer.order

    @property
    def plant(self) -> dict[str, Any]:
        """Return the poles [1/s] and DC gains [y/u] of the plant."""
        return {"poles": self.answer.poles, "gain": self.answer.gain}

    @property
    def alternatives(self) -> dict[str, Any]:
        """Return the distance of each model from the best [nats per sample]."""
        return self.numbers()["alternatives"]

    def states(self) -> States:
        """Return z and the plant's states along the log, with standard deviations.

        Returns:
            The smoothed states where a disturbance was found ahead of the zone, else those of the
            simulation.
        """
        answer = self.answer
        scale = self.answer.scale
        t = answer.case.grid.t
        kalman = answer.found.kalman
        if answer.element is None and kalman and kalman[0].model != 0:
            smoothed, std = smooth_with_deviation(kalman[0])
            return States(t, smoothed.z * scale, std * scale, smoothed.x[:, : self.order] * scale)
        simulator, theta = answer.plant
        slope = simulator.z_gradient(theta, answer.z)
        if answer.element is None:
            objective = answer.fit.objective
            unseen = 0.0
            slope = slope[:, objective.free]
            V = objective.robust_covariance(theta).V
        else:
            slope = slope[:, : len(answer.element.V)]
            V = answer.element.V
            unseen = answer.element.disturbance_rms
        variance = np.maximum(np.einsum("tp,pq,tq->t", slope, V, slope), 0.0)
        x = _simulate_states(simulator, theta)
        if answer.verdict == "friction" and answer.servo is None:  # which holds more than a line
            x = np.column_stack([answer.z, np.full(x[:, 1:].shape, np.nan)])
        return States(t, answer.z * scale, np.sqrt(variance + unseen**2) * scale, x * scale)

    def scenario(self, title: str = "Identified log") -> str:
        """Return a scenario as TOML text, a direct input of `run`, `check`, `design` and
        `watch`.

        Args:
            title: of the scenario, of which code that is exported has its name.

        Returns:
            The text, with a remark for every number that says where it came from.

        Raises:
            InputError: no dead zone was found, or no plant in continuous time fits.
        """
        if self.verdict in UNWRITTEN:
            raise InputError(f"scenario: {UNWRITTEN[self.verdict]}")
        if self.account.grade == MEASURED:
            raise InputError(f"scenario: the {self.account.by.split(' (')[0]} has no plant")
        if not (self.answer.zone or self.answer.case.jump_edges or self.verdict in WRITTEN):
            raise InputError(f"scenario: the verdict is {self.verdict}: there is no zone to write")
        return scenario_text([self.answer], title)

    def simulate(self, u: Any) -> Simulated:
        """Simulate plant and nonlinearity from rest, without noise.

        Args:
            u: inputs (N) or (N x m), one row a sample time of the log.

        Returns:
            Times, the plant's output z and the reading y.

        Raises:
            InputError: other shapes, or a verdict without a model or with an unknown edge.

        Example:
            >>> found.simulate(np.ones(3)).y.shape
            (3,)
        """
        return simulate_answer(self.answer, u)

    def predict(
        self, source: Any = None, *, t: Any = None, u: Any = None, y: Any = None
    ) -> Predicted:
        """Predict each reading of a log from earlier readings, by the scenario's observer.

        Args:
            source: the log, as `identify` takes it, with the period of the first one.
            t: times (N) [s] in place of a log (None: one step apart).
            u: inputs (N) or (N x m).
            y: readings (N), NaN if one is missing.

        Returns:
            Predicted readings with standard deviations, and the output z with its own.

        Raises:
            InputError: no scenario, or arrays that do not fit it.

        Example:
            >>> later = found.predict(u=u, y=y)
            >>> bool(np.nanstd((later.y - y)[100:]) < 0.015)
            True

        See Also:
            estimate
        """
        if source is None:
            log = log_from_arrays(self.answer.case.grid.step if t is None else t, u, y)
        else:
            log = read_log(source)
        return predict_log(self.answer, self.scenario(), log)

    def to_control(self) -> Any:
        """Return the sampled plant as `control.StateSpace`, with the log's names of its signals.

        The dead zone is not part of it. A delay of the input is a chain of states.

        Example:
            >>> system = found.to_control()
            >>> system.dt, system.input_labels, system.nstates
            (0.05, ['u'], 1)

        See Also:
            from_control, Plant.to_control
        """
        return answer_to_control(self.answer)

    def to_pandas(self) -> Any:
        """Return the log and the hidden output as a DataFrame indexed by t (needs pandas).

        Returns:
            A column for each input, for the reading, for z and its standard deviation `z_std`.

        Example:
            >>> list(found.to_pandas().columns)
            ['u', 'y', 'z', 'z_std']

        See Also:
            Run.to_pandas
        """
        states = self.states()
        return answer_to_pandas(self.answer, states.z, states.z_std)

    def next_log(self) -> NextLog:
        """Return the input to record next: 30 s, within the amplitude and the rate of this
        log's.

        Returns:
            Times, inputs, and what they are for: the width whose interval narrows most, and the
            share that is left of it with both logs.

        Raises:
            InputError: nothing would be gained.
        """
        return best_next_log(self.answer, self.account)

    def numbers(self) -> dict[str, Any]:
        """Return all numbers of the answer, as `--json` prints."""
        numbers = answer_numbers(self.answer, self.account)
        lines = None  # errors without and with the few lines that compensate what is named
        if self.account.is_certain:
            lines = measure_lines(numbers, self.answer, command_along(self.answer))
        return to_json_value(numbers | {"lines": lines})

    def summary(self) -> dict[str, Any]:
        """Return the answer in words, as the command prints."""
        return summarise_answer(self.answer, self.account)

    drawn = ("undeadzone_identify.figures", "overview", "signals")


def _simulate_states(simulator: PlantSimulator, theta: Floats) -> Floats:
    """Simulate the states in observer form (N x n), scaled."""
    layout = simulator.layout
    F, B, _ = observer_matrices(theta[layout.denominator], theta[layout.numerators], layout)
    x0 = theta[layout.x0].reshape(layout.records, layout.n)
    system = (F, B, np.eye(layout.n), np.zeros(B.shape), 1.0)
    parts = zip(simulator.data.record_slices(), x0, strict=True)
    return np.vstack([dlsim(system, simulator.data.u[part], x0=state)[2] for part, state in parts])


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class IdentifiedOutputs(Spoken):
    """Answers for several outputs, each with a separate plant from all inputs.

    Attributes:
        names: of the outputs.
        outputs: their answers, in this order.
    """

    names: tuple[str, ...]
    outputs: tuple[Identified, ...]

    @property
    def verdict(self) -> str:
        """Return dead_zone if every output has a dead zone, else the first different
        verdict.
        """
        words = [one.verdict for one in self.outputs]
        return next((word for word in words if word != "dead_zone"), "dead_zone")

    @property
    def account(self) -> Account:
        """Return the account of the output of which least is known."""
        return max((one.account for one in self.outputs), key=lambda one: GRADES.index(one.grade))

    @property
    def recorded_delay(self) -> int:
        """Return the delay of the inputs in the recording in samples."""
        return self.outputs[0].recorded_delay

    @property
    def zone(self) -> bool:
        """Return whether every output has a dead zone."""
        return all(one.zone for one in self.outputs)

    def scenario(self, title: str = "Identified log") -> str:
        """Return a joint scenario as TOML text: the outputs' plants side by side, with the
        same inputs.

        Args:
            title: of the scenario.

        Returns:
            The text.

        Raises:
            InputError: an output has no dead zone, or no plant in continuous time fits.
        """
        for name, one in zip(self.names, self.outputs, strict=True):
            if one.verdict != "dead_zone":
                raise InputError(f"scenario: the verdict on {name} is {one.verdict}")
        return scenario_text([one.answer for one in self.outputs], title)

    def numbers(self) -> dict[str, Any]:
        """Return all numbers of the answers, as `--json` prints."""
        each = dict(zip(self.names, (one.numbers() for one in self.outputs), strict=True))
        return dict(to_json_value({"zone": self.zone, "verdict": self.verdict, "outputs": each}))

    def blocks(self) -> list[Block]:
        """Return the tables that `undeadzone identify` prints, one for each output."""
        each = zip(self.names, self.outputs, strict=True)
        return [{"output": name, **one.summary()} for name, one in each]

    drawn = ("undeadzone_identify.figures", "of_outputs", "plot_first_fit")
