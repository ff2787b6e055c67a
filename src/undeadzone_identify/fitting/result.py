"""Result of `fit`: the scenario with its numbers, their intervals, and the tests of the answer."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

import undeadzone
from undeadzone.scenario.reader import anchor_files
from undeadzone.scenario.schema import Scenario
from undeadzone.util import shown, toml
from undeadzone.util.arrays import Floats, to_json_value
from undeadzone.util.files import to_path, write_text
from undeadzone.util.own_files import mark_toml
from undeadzone_identify.fitting.checks import FLAGGED

HEAD: Final = ("number", "value", "95 % interval", "before", "")
NAMES: Final = {
    "size": "readings are {times:.2g} times as far from their prediction as the scenario has it: "
    "free sensor.noise and disturbance.rms, or the plant lacks something",
    "mean": "readings are off their prediction to one side: an offset is missing",
    "white": "errors of the prediction last: the plant has too few states, a delay, or a "
    "disturbance of another correlation time",
    "shape": "errors of the prediction depend on input or output: a nonlinearity is missing",
}


class FittedNumber(NamedTuple):
    """Fitted number with its interval.

    Attributes:
        name: its address, or x(0) of a log.
        value: the estimate.
        low, high: ends of the 95 % interval.
        least, most: ends of its range.
        start: value in the scenario.
        shown: whether the logs determine it, and not its range alone.
        note: what limits the knowledge of it (empty: nothing).
    """

    name: str
    value: float
    low: float
    high: float
    least: float
    most: float
    start: float
    shown: bool
    note: str = ""

    def format_interval(self) -> str:
        """Return the interval as text."""
        return f"[{self.low:.5g}, {self.high:.5g}]"


class FittedSignals(NamedTuple):
    """Signals along the logs, one after the other.

    Attributes:
        t: times (N) [s].
        y: readings (N x p).
        prediction: of each reading from those before it (N x p).
        scores: normal scores of the readings (N x p).
    """

    t: Floats
    y: Floats
    prediction: Floats
    scores: Floats


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Fitted:
    """Numbers of a scenario that logs determine.

    Attributes:
        scenario: the scenario with the numbers found.
        numbers: fitted numbers, those of x(0) last.
        correlations: of their errors (k x k).
        directions: in columns, combinations of the numbers in deviations of their own, from the
            least known one on (k x k).
        log_likelihood: at the maximum.
        checks: probability of each test of the answer under a true scenario, by name.
        consistent: whether no test contradicts the scenario.
        others: values of further answers that fit the logs as well, by name.
        besides: addresses that were free without being asked for.
        delay: samples by which the inputs act late.
        signals: along the logs.
    """

    scenario: Scenario
    numbers: tuple[FittedNumber, ...]
    correlations: Floats
    directions: Floats
    log_likelihood: float
    checks: dict[str, float]
    consistent: bool
    others: tuple[dict[str, float], ...]
    besides: tuple[str, ...]
    delay: int
    signals: FittedSignals

    @property
    def drawn(self) -> tuple[str, str, str]:
        """Return module and functions that draw it for `uz.plot`."""
        return "undeadzone_identify.fitting.page", "plot_fit", "plot_readings"

    @property
    def by_address(self) -> dict[str, FittedNumber]:
        """Return the fitted numbers by name."""
        return {each.name: each for each in self.numbers}

    @property
    def agreement(self) -> str:
        """Return whether the logs contradict the scenario, with the reasons."""
        least = min(self.checks.values())
        if self.consistent:
            return f"The log does not contradict this scenario (p = {least:.2g})."
        bound = FLAGGED / len(self.checks)
        times = float(np.sqrt(np.nanmean(self.signals.scores**2)))
        reasons = []
        for name, chance in self.checks.items():
            if chance < bound:
                reasons.append(f"{NAMES[name].format(times=times)} ({name}, p = {chance:.2g})")
        return (
            f"The log contradicts this scenario: {'; '.join(reasons)}. The intervals are those of "
            "the nearest such model."
        )

    def describe_numbers(self) -> list[list[str]]:
        """Return the numbers as rows of text, below their head."""
        rows = [list(HEAD)]
        for each in self.numbers:
            value, start = f"{each.value:.6g}", f"{each.start:.6g}"
            rows.append([each.name, value, each.format_interval(), start, each.note])
        return rows

    def blocks(self) -> list[shown.Block]:
        """Return the tables that `undeadzone fit` prints."""
        words: dict[str, Any] = {"scenario": self.scenario.title, "tests": self.agreement}
        if self.besides:
            words["free besides"] = f"{', '.join(self.besides)}: the scenario has no value"
        if self.delay:
            words["delay"] = f"{self.delay} samples"
        for other in self.others:
            listed = ", ".join(f"{name} = {value:.5g}" for name, value in other.items())
            words["another answer"] = f"fits the log as well: {listed}"
        return [words, self.describe_numbers()]

    __repr__ = shown.format_result
    _repr_html_ = shown.result_to_html

    plot = shown.plot
    """Draw it."""

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the scenario with the numbers found as TOML, their intervals in its head.

        Args:
            path: of the file.

        Returns:
            The path.

        Raises:
            FileError: if it cannot be written.
        """
        path = to_path(path)
        lines = [f"# Fitted by undeadzone {undeadzone.__version__}. {self.agreement}"]
        for each in self.numbers:
            lines.append(
                f"# {each.name}: {each.value:.6g} {each.format_interval()} {each.note}".rstrip()
            )
        here = Path(os.path.relpath(Path(), path.parent))
        text = toml.to_toml(anchor_files(self.scenario, here))
        return write_text(mark_toml("\n".join([*lines, text])), path)

    def summary(self) -> dict[str, Any]:
        """Return all results, ready for JSON."""
        names = [each.name for each in self.numbers]
        summary = {
            "title": self.scenario.title,
            "numbers": [each._asdict() for each in self.numbers],
            "correlations": dict(zip(names, self.correlations.tolist(), strict=True)),
            "tests": self.checks,
        }
        same = ("log_likelihood", "consistent", "others", "besides", "delay")
        return dict(to_json_value(summary | {name: getattr(self, name) for name in same}))
