"""An observer that follows a log, from bytes or samples, and the summary of the log."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Final

import numpy as np

from undeadzone.errors import FileError
from undeadzone.interfaces import Estimate, describe_noise, require_graph
from undeadzone.logs.clock import Clock, Piece
from undeadzone.logs.names import Layout
from undeadzone.logs.range_ends import RunningEnds
from undeadzone.logs.samples import MOST_UNREADABLE, Faults, LogReader, Placed, Regular
from undeadzone.observers.filtering.prior import CHANCE
from undeadzone.plants.system import state_units, time_scale
from undeadzone.results.info import LogInfo
from undeadzone.results.signals import last_values, signals_from_estimate
from undeadzone.scenario.operating_point import resolve_levels
from undeadzone.scenario.problem import (
    describe_actuator,
    plant_of_model,
    sensor_of_model,
    with_units,
)
from undeadzone.scenario.schema import Scenario, Units
from undeadzone.simulation.consistency import FALSE_ALARMS, Alarm, Consistency, Own, verdict_of
from undeadzone.simulation.online import Online, build_observer
from undeadzone.simulation.sample_by_sample import numeric_along
from undeadzone.util.arrays import Floats, require_number

LIMIT = 1e12  # beyond this an estimate has diverged
FEWEST_REPEATS = 0.01  # share of the readings that may repeat the one before by chance


class Follower:
    """Follows a log, block after block.

    Args:
        scenario: its plant (or model), sensor, observer and step are used.
        live: whether samples come in block after block, which an observer that computes in Python
            does not take.
        apart: time between two false alarms [s].

    Attributes:
        model: the sampled model.
        zone: the dead zone.
        observer: as it is built for both.
        levels: at the operating point, from which the observer counts (None: all are 0).
        samples: how many came in.
        SAVED: names of the attributes that a saved state contains (`saved_state`).

    Raises:
        InputError: or a subclass, for errors in the scenario.
    """

    SAVED: Final = (
        "samples",
        "_online",
        "_tests",
        "_own",
        "alarm",
        "_counts",
        "_missing",
        "_repeats",
        "_latest_y",
        "_ends",
        "_diverged",
    )

    def __init__(self, scenario: Scenario, live: bool = False, apart: float = FALSE_ALARMS) -> None:
        simulation = scenario.simulation
        plant = plant_of_model(scenario)
        step = require_number("simulation.step", simulation.step, above=0.0)
        parts = (scenario.observer, plant, sensor_of_model(scenario), step, simulation.substeps)
        actuator = describe_actuator(scenario)
        self.model, self.zone, built = build_observer(*parts, actuator)
        if live:
            require_graph(built)
        self.observer = built
        point = scenario.operating_point
        self.levels = resolve_levels(point, self.model, self.zone.slope, range(self.model.p))
        self._scenario = with_units(scenario, self.model)
        self._numeric = built.python
        self._online = None if self._numeric else Online(*parts, actuator=actuator)
        self._times = step, time_scale(self.model.continuous)
        self._apart = apart
        self.begin()

    def begin(self) -> None:
        """Begin with another log: nothing of an earlier one is left."""
        self.samples = 0
        self._tests: list[Consistency] | None = None
        self._own: Own | None = None
        self.alarm = Alarm(*self._times, self._apart)
        # Of sides: right, left, silent, at a limit of the range.
        self._counts = np.zeros((4, self.model.p), int)
        self._missing = 0
        self._repeats = np.zeros(self.model.p, int)
        self._latest_y = np.full((1, self.model.p), np.nan)
        undeclared = 0 if self.zone.moves or self.zone.limits is not None else self.model.p
        self._ends = [RunningEnds() for _ in range(undeclared)]
        self._diverged = False
        self._last: Estimate | None = None
        if self._online is not None:
            self._online.restart()
            self._make_tests(self._online.latest)

    @property
    def digest(self) -> str:
        """Of all that the observer of a live log is but for its state."""
        assert self._online is not None
        levels = "" if self.levels is None else repr(self.levels)
        return self._online.digest + levels

    def go_on(self) -> None:
        """Go on from numbers that were read."""
        if self.samples and self._online is not None:
            self._last = Estimate(*[part.copy() for part in self._online.latest])

    def restart(self) -> None:
        """Restart the observer. The counts stay.

        Only of a log that comes in live.
        """
        assert self._online is not None
        self._online.restart()
        for test in self._tests or []:
            test.restart()
        if self._own is not None:
            self._own.restart()

    def to_deviations(self, samples: Regular) -> Regular:
        """Return samples in deviations from the operating point, in which the observer is."""
        if self.levels is None:
            return samples
        return samples._replace(y=samples.y - self.levels.y, u=samples.u - self.levels.u)

    def follow(
        self, samples: Regular, progress: Callable[[int], None] | None = None
    ) -> tuple[Estimate, Floats, Floats]:
        """Take the next samples of the log in.

        Args:
            samples: one step apart. An observer that computes in Python takes a whole log at once.
            progress: called with the number of steps just done.

        Returns:
            The estimates (a row for each sample in each field), the measured sides (N x p), and the
            statistic B after each sample (N x p, or N x 0 if no test exists).
        """
        samples = self.to_deviations(samples)
        if self._numeric is not None:
            along = self.zone, samples.y, samples.u, self._scenario.simulation.seed
            estimate, sides = numeric_along(self._numeric, *along, progress)
        else:
            assert self._online is not None
            estimate, sides = self._online.update_many(samples.y, samples.u)
        statistic = self._count(samples, estimate, sides)
        if self.levels is not None:
            estimate = self.levels.restore_estimate(estimate)
        return estimate, sides, statistic

    def _count(self, samples: Regular, estimate: Estimate, sides: Floats) -> Floats:
        """Count these samples, test their innovations, and return B after each (N x p or N x 0)."""
        self.samples += len(sides)
        present = np.isfinite(samples.y)
        rows = np.vstack([self._latest_y, samples.y])
        self._repeats += ((rows[1:] == rows[:-1]) & (np.abs(sides) == 1)).sum(axis=0)
        self._latest_y = rows[-1:]
        for i, ends in enumerate(self._ends):
            ends.add(samples.y[:, i], present[:, i])
        self._missing += int((~present).any(axis=1).sum())
        for row, side in enumerate((1, -1, 0)):
            self._counts[row] += (present & (sides == side)).sum(axis=0)
        self._counts[3] += (np.abs(sides) == 2).sum(axis=0)
        with np.errstate(invalid="ignore"):
            counted = estimate.x / state_units(self.model.continuous)  # as they show in z
            widths = np.hstack([estimate.right, estimate.left])
            widths = np.where(widths == np.inf, 0.0, widths)  # of edges that do not exist
            worst = np.abs(np.hstack([counted, estimate.z, widths]))
            self._diverged = self._diverged or not bool((worst < LIMIT).all())
        if len(sides):
            self._last = Estimate(*[field[-1] for field in estimate])
        return self._test(estimate, present & (sides == 0))

    def _test(self, estimate: Estimate, silent: Floats) -> Floats:
        """Test these estimates, and return B after each (N x p, or N x 0 without a test)."""
        if self._tests is None:
            self._make_tests(estimate)
        assert self._tests is not None
        if self._own is not None:
            self._own.add(estimate)
        along = np.empty((len(silent), len(self._tests)))
        band = self.zone.threshold / self.zone.slope
        for i, test in enumerate(self._tests):
            along[:, i] = test.add(estimate.innovation[:, i], estimate.innovation_std[:, i])
            if self.zone.kind == "deadzone" and self.zone.play is None:
                test.add_silences(estimate, i, silent[:, i], float(band[i]))
        fits = along <= CHANCE if self._own is None else estimate.consistent > 0.5
        self.alarm.add(np.all(fits, axis=1))
        return along

    def _make_tests(self, estimate: Estimate) -> None:
        """The tests that estimates like this one allow."""
        outputs = estimate.innovation_std.shape[-1]
        self._tests = [Consistency(*self._times) for _ in range(outputs)]
        self._own = Own() if estimate.claims.shape[-1] else None

    def info(
        self,
        source: str,
        layout: Layout | None,
        grid: Placed | Clock,
        faults: Faults | None = None,
    ) -> LogInfo:
        """Return the facts about the log as a whole.

        Args:
            source: the log.
            layout: places of its columns (None for arrays).
            grid: what came of putting it on the scenario's steps.
            faults: faults of its lines (absent for arrays).

        Raises:
            FileError: there are no samples.
        """
        faults = faults or Faults(source, strict=False)
        unreadable = faults.unreadable
        if self._last is None:
            seen = f" that can be read; {faults.why}" if faults.why else ""
            raise FileError(f"{source}: no samples{seen}. Give lines of times, readings and inputs")
        last = self._last
        scenario = self._scenario
        given = last.right_std.size > 0
        stds = np.concatenate([last.right_std, last.left_std]) if given else None
        widths = np.concatenate([last.right, last.left])
        options = list(scenario.observer.__struct_fields__)
        tests = self._tests or []
        verdict = verdict_of(
            tests, self._own, self.alarm.is_due, widths, stds, self._diverged, options
        )
        if unreadable > MOST_UNREADABLE * (self.samples - grid.gaps + unreadable):
            reason = "most of its lines cannot be read"
            verdict = verdict._replace(consistent=False, reasons=[*verdict.reasons, reason])
        if verdict.consistent is False and grid.gaps:
            reason = "the inputs in its gaps are not known, and were taken as constant"
            verdict = verdict._replace(reasons=[*verdict.reasons, reason])
        p = self.model.p
        last_row = Estimate(*[field[None] for field in last])
        right, left, silent, limited = self._counts.tolist()
        return LogInfo(
            title=scenario.title,
            method=str(type(scenario.observer).__struct_config__.tag),
            source=source,
            columns="" if layout is None else layout.columns_text,
            step=scenario.simulation.step,
            measured_step=grid.measured,
            samples=self.samples,
            missing=self._missing,
            gaps=grid.gaps,
            unreadable=unreadable,
            why_unreadable=faults.why,
            faults=faults.by_kind,
            right=right,
            left=left,
            silent=silent,
            d_right=last.right.tolist(),
            d_left=last.left.tolist(),
            d_right_std=None if stds is None else stds[:p].tolist(),
            d_left_std=None if stds is None else stds[p:].tolist(),
            adapts=self.observer.traits.adapts,
            ranges=self.observer.traits.ranges_in_turn,
            threshold=self.zone.threshold.tolist(),
            uncertain=list(self.observer.traits.uncertain),
            joints=[] if self.model.arm is None else list(self.model.arm.chain.joints),
            units=scenario.units,
            limited=limited if self.zone.limits is not None else [],
            sensor=self.zone.kind,
            further=last_values(
                signals_from_estimate(last_row), "c_hat", "c_std", "gap_std", "b_hat", "b_std"
            ),
            remarks=[*self._remarks(), *_repeated_times(grid)],
            options=options,
            output_level=[] if self.levels is None else self.levels.z.tolist(),
            **verdict._asdict(),
        )

    def _remarks(self) -> list[str]:
        """Return remarks on the sensor besides its widths, from the readings.

        They stick at the end of a range of which the scenario does not know, or repeat one another.
        """
        remarks = self._repeated_readings()
        last = self._last
        if last is not None and (louder := describe_noise(last.noise, last.noise_assumed)):
            remarks.append(f"noise: {louder}")
        for i, running in enumerate(self._ends):
            ends = running.find_range_ends()
            if ends.has_ends:
                remarks.append(
                    f"{ends.number} readings of output {i} stick at an end of their range, where "
                    f"they only bound z: set sensor.range = {ends.range_text}"
                )
        return remarks

    def _repeated_readings(self) -> list[str]:
        """Return remarks on noisy readings that repeat the previous one."""
        zone = self.zone
        remarks = []
        noisy = ((zone.noise > 0) | (zone.noise_before > 0)) & (zone.quantum == 0)
        active = self._counts[:2].sum(axis=0)
        # Readings at an end of their range repeat as well, and have a remark of their own.
        ended = [i for i, running in enumerate(self._ends) if running.find_range_ends().has_ends]
        noisy[ended] = False
        for i in np.flatnonzero(noisy & (self._repeats > FEWEST_REPEATS * active)):
            share = 100 * self._repeats[i] / active[i]
            remarks.append(
                f"{share:.0f} % of the readings of output {i} repeat the one before: the logger "
                "polls faster than the sensor answers. They count as missing"
            )
        return remarks


def _repeated_times(placed: Placed | Clock) -> list[str]:
    """Describe how many samples have the time of the previous one, empty if none has."""
    if not isinstance(placed, Placed) or not placed.repeated:
        return []
    return [f"{placed.repeated} samples have the time of the one before, and are left out"]


def require_units(layout: Layout, units: Units, source: str) -> None:
    """Raise FileError where header and scenario name different units: numbers stay as they are."""
    for signal, named, expected in (
        ("y", layout.reading_titles, units.output),
        ("u", layout.input_titles, units.input),
    ):
        for _, unit in named:
            if "1" not in (unit, expected) and unit and unit != " ".join(expected.split()):
                key = "output" if signal == "y" else "input"
                raise FileError(
                    f"{source}: {signal} is in {unit!r}, but units.{key} of the scenario is "
                    f"{expected!r}: numbers are never converted. Bring both to one unit"
                )


# --- A log that comes in live


class LiveLog:
    """A CSV log whose lines come in live: faults in some of them do not end it.

    Args:
        source: the log, for messages.
        scenario: for its step and its units.
        follower: of the same scenario, which takes the samples in.
        chosen: columns that the user names (see `names.parse_columns`).
        strict: whether the first fault is an error.

    Attributes:
        clock: which puts its lines on the steps of the scenario.
        reader: of its lines.
    """

    def __init__(
        self,
        source: str,
        scenario: Scenario,
        follower: Follower,
        chosen: Mapping[str, str],
        strict: bool,
    ) -> None:
        p = follower.model.p
        m = follower.model.m
        self.clock = Clock(scenario.simulation.step, source, strict)
        self.reader = LogReader(source, p, m, chosen, live=True)
        self._source = source
        self._units = scenario.units

    def pieces(self, data: bytes, last: bool) -> Iterator[Piece]:
        """Yield the samples in the lines that are whole now, so far as they can be judged.

        Args:
            data: the bytes that came in.
            last: whether no more will come.

        Raises:
            FileError: the log cannot be the one that the scenario describes, or `strict` is set and
                a line is faulty. The good lines before it are yielded first.
        """
        begun = self.reader.layout is not None
        samples = self.reader.feed(data, last)
        layout = self.reader.layout
        if layout is None:
            return
        if not begun:
            require_units(layout, self._units, self._source)
        for piece in self.clock.place_samples(samples, self.reader.latest, layout.has_times, last):
            if piece.samples.t.size:
                yield piece

    def info(self, follower: Follower) -> LogInfo:
        """Return the facts about the log as a whole. Raises FileError."""
        return follower.info(self._source, self.reader.layout, self.clock, self.clock.faults)
