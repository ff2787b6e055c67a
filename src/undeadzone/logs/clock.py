"""Samples that come in live, put on the steps of a scenario: a wrong time ends nothing.

A line's time is judged by its neighbours, the last sample before it and the line after it:

* one step after the last sample: a sample, at once;
* some steps after it: a sample behind a gap, unless the line after it fits the last sample only;
* neither, but the line after it is one step later: a lasting jump (a clock that was set, a device
  that started again), from which all begins anew;
* else: a line that cannot be read.

So the first line, and each that is one step after the last sample, is answered at once. Any other
waits for the next line.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np

from undeadzone.logs.samples import (
    JITTER,
    LONGEST,
    TOLERANCE,
    Fault,
    Faults,
    Regular,
    Samples,
    fill_gaps,
    join_samples,
    require_step,
    usual_step,
    whole_steps,
)
from undeadzone.util.arrays import Floats

# After so many lines with times the usual step is compared with the scenario's, by this share.
TESTS: Final = {21: JITTER, 1001: TOLERANCE}


class Piece(NamedTuple):
    """Samples one step apart.

    Attributes:
        begins: whether they begin anew, after a jump in time.
        samples: the samples.
    """

    begins: bool
    samples: Regular


class Run(NamedTuple):
    """Lines one step apart.

    Attributes:
        rows: which they are.
        steps: how many steps the first is after the sample before.
        kind: `time`: no sample, as it fits no neighbour; `jump`: they begin anew; else empty.
    """

    rows: slice
    steps: float
    kind: str


class Clock:
    """Puts the lines of a live log on the steps of a scenario, block after block.

    The result does not depend on the blocks in which lines arrive.

    Args:
        step: of the scenario [s].
        source: the log, for messages.
        strict: whether the first fault is an error.

    Attributes:
        gaps: how many samples were missing altogether, between others.
        faults: the lines that are none, and the jumps.
        last: time of the last sample [s]; NaN before the first.
    """

    SAVED: Final = ("gaps", "faults", "last", "_count", "_first")

    def __init__(self, step: float, source: str, strict: bool) -> None:
        self.gaps = 0
        self.faults = Faults(source, strict)
        self.last = np.nan
        self._step = step
        self._source = source
        self._strict = strict
        self._count = 0  # samples so far, where there are no times
        self._waiting: Samples | None = None  # the line that waits for the next one
        self._first: Floats = np.empty(0)  # times of the first lines [s]

    @property
    def measured(self) -> float | None:
        """Return the usual time between two of the first lines [s]; None without times, or where
        quartiles differ, as of two loggers or of times that go to and fro."""
        intervals = np.diff(self._first)
        if intervals.size:
            short, long = np.quantile(intervals, [0.25, 0.75])
            if long - short > JITTER * abs(short):
                return None
        return usual_step(intervals[intervals > 0])

    def place_samples(
        self, samples: Samples, unread: Sequence[Fault], timed: bool, last: bool
    ) -> Iterator[Piece]:
        """Yield the samples one step apart, as far as they can be judged; those in gaps are
        missing.

        Args:
            samples: the next ones of the log.
            unread: the lines among them that cannot be read.
            timed: whether they have times in seconds.
            last: whether no more will come.

        Raises:
            FileError: they are another step apart, or one is a fault and `strict` is set. The
                good samples before it have been given out by then.
        """
        faults = list(unread)
        if timed:
            known = {fault.line for fault in faults}
            without = samples.lines[~np.isfinite(samples.t)].tolist()
            faults += [Fault(k, "no_time", "it has no time") for k in without if k not in known]
        if self._strict and faults:
            before = samples.lines < min(faults).line
            yield from self._place_counted(samples.select_rows(before), timed, last=False)
        for fault in sorted(faults):
            self.faults.add(fault)
        yield from self._place_counted(samples, timed, last)

    def _place_counted(self, samples: Samples, timed: bool, last: bool) -> Iterator[Piece]:
        """Yield the same of lines whose faults are counted already."""
        if not timed:
            t = (self._count + np.arange(len(samples.t))) * self._step
            self._count += len(t)
            yield Piece(False, samples.regular._replace(t=t))
            return
        samples = samples.select_rows(np.isfinite(samples.t))
        ends = np.subtract([*TESTS], self._first.size)
        inner = ends[(ends > 0) & (ends < len(samples.t))]
        for part in np.split(np.arange(len(samples.t)), inner):
            yield from self._judge_times(samples.select_rows(part), last=False)
            self._test(samples.t[part])
        if last:
            if 1 not in self._steps(self._first[:-1], self._first[1:]):
                require_step(self.measured, self._step, TOLERANCE, self._source)
            yield from self._judge_times(samples.select_rows(slice(0)), last=True)

    def _test(self, t: Floats) -> None:
        """Compare the usual step of the first lines. Raises FileError if it differs."""
        room = max(TESTS) - self._first.size
        self._first = np.append(self._first, t[:room])
        if t.size and room and self._first.size in TESTS:
            require_step(self.measured, self._step, TESTS[self._first.size], self._source)

    def _judge_times(self, samples: Samples, last: bool) -> Iterator[Piece]:
        """Yield the samples among lines with times, as far as they are certain."""
        if self._waiting is not None:
            samples = join_samples([self._waiting, samples])
            self._waiting = None
        runs: list[Run] = []
        missing = 0.0
        for run in self._runs(samples, last):
            ends = self._strict if run.kind == "time" else run.kind == "jump"
            if runs and (ends or missing > LONGEST):
                yield self._piece(samples, runs)
                runs = []
                missing = 0.0
            if run.kind:
                self.faults.add(self._fault(samples, run))
            if run.kind != "time":
                runs.append(run)
                missing += run.steps
        if runs:
            yield self._piece(samples, runs)

    def _runs(self, samples: Samples, last: bool) -> Iterator[Run]:
        """Yield the lines by kind, in order; the last line may have to wait for the next."""
        t = samples.t
        size = len(samples.t)
        k = 0
        ends = np.append(np.flatnonzero(self._steps(t[:-1], t[1:]) != 1) + 1, size)
        while k < size:
            steps = float(self._steps(self.last, t[k]))
            kind = ""
            end = k + 1
            if steps == 1 or np.isnan(self.last):
                end = int(ends[np.searchsorted(ends, k, side="right")])
            elif end < size or last:
                kind = self._kind(steps, t[k], t[end] if end < size else None)
            else:
                self._waiting = samples.select_rows(slice(k, size))
                return
            yield Run(slice(k, end), max(steps, 1.0), kind)
            if kind != "time":
                self.last = float(t[end - 1])
            k = end

    def _kind(self, steps: float, t: float, after: float | None) -> str:
        """Return the kind of a line not one step after the last sample: `jump`, `time` or a sample.

        Args:
            steps: from the last sample to it; 0 if it does not fit.
            t: its time [s].
            after: that of the line after it [s]; None: it is the last one.
        """
        if after is None:
            return "" if steps else "time"
        fits_last = self._steps(self.last, after)
        from_here = self._steps(t, after)
        if steps:
            return "time" if fits_last and not from_here else ""
        return "time" if fits_last or from_here != 1 else "jump"

    def _steps(self, before: float | Floats, t: float | Floats) -> Floats:
        """Return the number of steps from times to others (of any shape); 0 if they do not fit."""
        return whole_steps(np.subtract(t, before), self._step)

    def _piece(self, samples: Samples, runs: Sequence[Run]) -> Piece:
        """Join runs to a piece, with missing samples in the gaps."""
        rows = np.concatenate([np.arange(run.rows.start, run.rows.stop) for run in runs])
        lengths = [run.rows.stop - run.rows.start for run in runs]
        steps = np.ones(rows.size)
        steps[np.cumsum([0, *lengths[:-1]])] = [run.steps for run in runs]
        self.gaps += int(steps.sum()) - rows.size
        regular = samples.select_rows(rows).regular
        return Piece(runs[0].kind == "jump", fill_gaps(regular, steps, self._step))

    def _fault(self, samples: Samples, run: Run) -> Fault:
        """Return the fault in the time of a line."""
        k = run.rows.start
        where = f"t = {samples.t[k]:.9g} s"
        if run.kind == "jump":
            why = f"{where} after {self.last:.9g} s, and time goes on from there"
        else:
            why = (
                f"{where} fits neither the sample before nor the line after it. Expected a "
                f"multiple of the step, {self._step:g} s"
            )
        return Fault(int(samples.lines[k]), run.kind, why)
