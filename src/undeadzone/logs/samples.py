"""Samples from the lines of a CSV log, as they come in, put on the steps of a scenario.

Other steps are refused, gaps become missing samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from undeadzone.errors import FileError
from undeadzone.logs.kinds import Title
from undeadzone.logs.names import Layout, layout_of_titles
from undeadzone.logs.stamps import Stamps, is_ambiguous, over_midnight, stamps_of, to_seconds
from undeadzone.logs.text import (
    LARGEST,
    LONGEST_LINE,
    MARKS,
    OTHER,
    PREAMBLE,
    Dialect,
    Text,
    blocks_of,
    decimal_mark,
    dialect_of,
    flaw,
    is_content,
    lines_ahead,
    prose_ahead,
)
from undeadzone.util.arrays import Floats

Lines = npt.NDArray[np.int64]
Numbered = list[tuple[int, str]]  # lines with their numbers

MOST_UNREADABLE = 0.5  # share of the lines of a log that may be unreadable
FIRST = 10  # lines that tell the dialect, if as many have come
SEEN, FEWEST_SEEN = 2500, 3  # first and last lines, that show what columns do; fewer do not
TOLERANCE: Final = 0.01  # of the step: how far the usual time between samples may be from it
JITTER: Final = 0.25  # of the step: how far a sample may be from where it should be
LONGEST: Final = 100_000  # steps of a gap
MOST: Final = 10  # steps per sample, on average, in a block of samples
REPEATED: Final = 0.1  # share of the samples that may have the time of the one before
WATCHED: Final = 1000  # intervals whose median is compared with the step
# What can be wrong with a line: it holds bytes of 0, is too long, has too few or many values, one
# that is no number, no time, or a time that fits none of its neighbours; or it begins anew, in
# another time, and others follow it.
KINDS: Final = ("zero_bytes", "too_long", "values", "number", "no_time", "time", "jump")


class Samples(NamedTuple):
    """Samples of a log.

    Attributes:
        t: times (N) [s], or sample numbers; NaN if there is none or the line cannot be read.
        y: readings (N x p), NaN if one is missing.
        u: inputs (N x m), NaN if one is missing.
        lines: number of each line in the log (N).
    """

    t: Floats
    y: Floats
    u: Floats
    lines: Lines

    def select_rows(self, rows: Any) -> Samples:
        """Return some of the samples."""
        return Samples(*[part[rows] for part in self])

    @property
    def regular(self) -> Regular:
        """Return the same, once they are one step apart."""
        return Regular(self.t, self.y, self.u)


class Fault(NamedTuple):
    """Fault of a line.

    Attributes:
        line: its number.
        kind: one of `KINDS`.
        why: in words.
    """

    line: int
    kind: str
    why: str


class Faults:
    """Faults of the lines so far, by kind.

    Args:
        source: the log, for messages.
        strict: whether the first fault is an error.

    Attributes:
        counts: how many faults there were of each of `KINDS`.
        why: description of the first of them; empty if there is none.
    """

    SAVED: Final = ("counts", "why")

    def __init__(self, source: str, strict: bool) -> None:
        self.counts = np.zeros(len(KINDS), np.int64)
        self.why = ""
        self._line = 0  # of the first one
        self._source = source
        self._strict = strict

    def add(self, fault: Fault) -> None:
        """Count a fault. Raises FileError where `strict` is set."""
        if self._strict:
            raise FileError(f"{self._source}, line {fault.line}: {fault.why}")
        self.counts[KINDS.index(fault.kind)] += 1
        if not self.why or fault.line < self._line:
            self._line = fault.line
            self.why = f"line {fault.line}: {fault.why}"

    @property
    def unreadable(self) -> int:
        """Return the lines that could not be read."""
        return int(self.counts[: KINDS.index("jump")].sum())

    @property
    def by_kind(self) -> dict[str, int]:
        """Return the counts of the kinds that occurred."""
        return {KINDS[k]: int(self.counts[k]) for k in np.flatnonzero(self.counts)}


class LogReader:
    """The samples of a CSV log, from bytes as they come in.

    Args:
        source: the log, for messages.
        p, m: numbers of readings and inputs that the plant has; None: as many as are named.
        chosen: columns that the user names; see `names.parse_columns`. Without them a log must
            have a header.
        strict: whether a line that cannot be read is an error; else it is counted, and its
            sample is missing.
        live: whether lines come one by one: the dialect is then told by the header and one line,
            or by the first line alone, in whatever pieces they come.

    Attributes:
        layout: columns of the signals; None before the first sample.
        faults: the lines that could not be read.
        latest: these among the lines that came last.
        ahead: lines ahead of the header that were skipped.
    """

    SAVED: Final = ("_latest_time",)

    def __init__(
        self,
        source: str,
        p: int | None,
        m: int | None,
        chosen: Mapping[str, str],
        strict: bool = False,
        live: bool = False,
    ) -> None:
        self.layout: Layout | None = None
        self.faults = Faults(source, strict)
        self.latest: list[Fault] = []
        self.ahead = 0
        self._live = live
        self._source = source
        self._p = p
        self._m = m
        self._chosen = chosen
        self._text = Text(source)
        self._dialect: Dialect  # once the first lines are known
        self._remark = ""  # the last one ahead of all content, which may name the columns
        self._first: Numbered = []  # lines that wait for the dialect to be known
        self._stamps: Stamps | None = None  # how times are written that are no numbers
        self._plain_times = False  # whether they are numbers
        self._latest_time = math.nan  # [s], days counted, where times are of day
        self._count = 0  # lines read

    def feed(self, data: bytes, last: bool = False) -> Samples:
        """Return the samples in the lines that are whole now.

        Args:
            data: the bytes that came in.
            last: whether no more will come.

        Raises:
            FileError: this is no text, a column cannot be told, or a line cannot be read and
                `strict` is set.
        """
        self.latest = []
        numbered = self._first + self._number_lines(self._text.feed(data, last))
        if not numbered:
            return self._none()
        numbers, lines = zip(*numbered, strict=True)
        if self.layout is None:
            ahead = self._lines_ahead(lines[: PREAMBLE if self._live else SEEN])
            below = lines[ahead or 0 :]
            # Of a live log as few lines as possible determine the dialect.
            count = 1 + bool(dialect_of(below[:1]).heads) if self._live else FIRST
            self._dialect = dialect_of(below[:count])
            heads = self._dialect.heads
            titled = dialect_of([self._remark, *below[:count]])
            width = self._dialect.width
            if not heads and titled.titles and titled.width >= width:
                titles = titled.titles[:width]
                self._dialect = titled._replace(heads=0, width=width, titles=titles)
            # The header may follow, or its first line of numbers, or a line of units.
            waits = (ahead is None and len(lines) < PREAMBLE) or (heads and len(below) < 2)
            self._first = numbered if waits and not last else []
            if self._first:
                return self._none()
            self.ahead = ahead or 0
            numbers, lines = numbers[self.ahead + heads :], below[heads:]
        if not self._dialect.mark and (self._live or self.layout is None):
            rows, separator = map(self._dialect.cells, lines), self._dialect.separator
            mark, grouped = decimal_mark(rows, separator, self._live, self._source)
            self._dialect = self._dialect._replace(mark=mark, grouped=grouped)
        self.layout = self.layout or self._layout(lines)
        return self._samples(numbers, lines, self.layout)

    def _lines_ahead(self, lines: Sequence[str]) -> int | None:
        """Return the number of lines ahead of the header; None if a live log has not shown it yet.

        A live log arrives in pieces of any size. The answer is that of the shortest beginning that
        determines it, so that it does not depend on the pieces.
        """
        if not self._live:
            ahead = lines_ahead(lines)
            return prose_ahead(lines) if ahead is None else ahead
        by_number = self._chosen and all(name.isdigit() for name in self._chosen.values())
        if by_number and dialect_of(lines[:1]).heads == 0:
            return 0  # columns chosen by number need no header; times may be stamps
        answers = (lines_ahead(lines[: count + 1]) for count in range(len(lines)))
        return next((ahead for ahead in answers if ahead is not None), None)

    def _number_lines(self, lines: Sequence[str]) -> Numbered:
        """Return the lines with content, with their numbers."""
        first = self._count + 1
        self._count += len(lines)
        numbered = list(enumerate((line[: LONGEST_LINE + 1] for line in lines), first))
        content = [(k, line) for k, line in numbered if is_content(line)]
        if self.layout is None and not self._first:
            end = content[0][0] if content else math.inf
            ahead = [line.strip(MARKS) for k, line in numbered if k < end]
            self._remark = next(filter(None, reversed(ahead)), self._remark)
        return content

    def _layout(self, lines: Sequence[str]) -> Layout:
        """Return the columns of the signals.

        Raises:
            FileError: a column is not known; without a header any order would be a guess.
        """
        values = None if self._live else _values_of(self._dialect, lines)
        titles: Sequence[Title] | None = self._dialect.titles
        if titles is None:
            if not self._chosen and (values is None or self._p is not None):
                raise FileError(
                    f"{self._source}: without a header the order of columns is not known. Add one, "
                    't,y,u, or name the columns by number: columns="t=1,y=2,u=3"'
                )
            titles = [Title(str(k + 1), "") for k in range(self._dialect.width)]
        return layout_of_titles(titles, self._p, self._m, self._chosen, self._source, values)

    def _none(self) -> Samples:
        """Return samples of length 0."""
        inputs = 1 if self._m is None else self._m  # a signal has 0
        shapes = (np.empty(0), np.empty((0, self._p or 1)), np.empty((0, inputs)))
        return Samples(*shapes, np.empty(0, np.int64))

    def _samples(self, numbers: Sequence[int], lines: Sequence[str], layout: Layout) -> Samples:
        """Return the samples of lines with these numbers."""
        values = _at_once(lines, self._dialect, layout)
        if values is not None:
            self._plain_times = self._plain_times or bool(np.isfinite(values[:, 0]).any())
        else:
            if self._stamps is None and not self._plain_times:
                self._learn_stamps(numbers, lines, layout)
            values = self._one_by_one(numbers, lines, layout)
        samples = split_signals(values, layout, np.array(numbers, np.int64))
        return samples._replace(t=self._in_seconds(samples.t, layout))

    def _in_seconds(self, t: Floats, layout: Layout) -> Floats:
        """Return the times of a log (N) in seconds; sample numbers stay as they are."""
        if self._stamps is None:
            return to_seconds(t, layout.seconds)
        if not self._stamps.dated:
            t = over_midnight(t, self._latest_time)
            self._latest_time = float(np.append(self._latest_time, t[np.isfinite(t)])[-1])
        return t

    def _learn_stamps(self, numbers: Sequence[int], lines: Sequence[str], layout: Layout) -> None:
        """Find the format of the times from the first one that can be read. Raises FileError."""
        rows = zip(numbers, map(self._dialect.cells, lines), strict=True)
        whole = [(number, cells) for number, cells in rows if len(cells) == self._dialect.width]
        texts = [_stamp_text(cells, layout) for _, cells in whole]
        for k, text in enumerate(texts):
            value = self._dialect.parse_number(text)
            self._plain_times = value is not None and math.isfinite(value)
            if self._plain_times:
                return
            self._stamps = stamps_of([text])
            if self._stamps is None:
                continue
            if not self._live:
                self._stamps = stamps_of(texts[k:])
            if self._stamps is not None and is_ambiguous(text, self._stamps):
                raise FileError(
                    f"{self._source}, line {whole[k][0]}: it is not known which number of {text!r} "
                    "is the month. Write dates as 2026-04-03"
                )
            return

    def _one_by_one(self, numbers: Sequence[int], lines: Sequence[str], layout: Layout) -> Floats:
        """Read line by line: return the columns in use, NaN for an unreadable line.

        It is slower than reading a block at once, but finds the faults of each line.
        """
        values = np.full((len(lines), len(layout.columns)), np.nan)
        for row, line in enumerate(lines):
            found = self._row(numbers[row], line, layout)
            if isinstance(found, Fault):
                self.faults.add(found)
                self.latest.append(found)
            else:
                values[row] = found
        return values

    def _row(self, number: int, line: str, layout: Layout) -> list[float | None] | Fault:
        """Return the numbers of a line in the columns that are used, or why it cannot be read."""
        kind, why = flaw(line)
        if why:
            return Fault(number, kind, why)
        dialect = self._dialect
        cells = dialect.cells(line)
        if len(cells) != dialect.width:
            return Fault(number, "values", f"expected {dialect.width} values, found {len(cells)}")
        found = [dialect.parse_number(cells[k]) for k in layout.columns]
        if self._stamps is not None:
            found[0] = self._stamps.seconds(_stamp_text(cells, layout))
        if None in found:
            text = cells[layout.columns[found.index(None)]]
            why = f"expected a number or nothing, found {text!r:.40}"
            if dialect.is_open(text):
                why = f"it is not clear if the mark in {text!r:.40} is the decimal mark"
            return Fault(number, "number", why)
        return found


def split_signals(values: Floats, layout: Layout, lines: Lines) -> Samples:
    """Return the samples in the columns in use (N x K), with times as they are written.

    Args:
        values: numbers in `layout.columns`.
        layout: columns of the signals.
        lines: number of each line in the log (N).
    """
    first = int(layout.time is not None)
    t, y, u = np.split(values, [first, first + len(layout.readings)], axis=1)
    return Samples(t[:, 0] if first else np.full(len(values), np.nan), y, u, lines)


def _values_of(dialect: Dialect, lines: Sequence[str]) -> Floats | None:
    """Return the numbers of all columns (N x K) in the first and last lines; None for a few."""
    rows = list(map(dialect.cells, (*lines[:SEEN], *lines[SEEN:][-SEEN:])))
    columns = zip(*(row for row in rows if len(row) == dialect.width), strict=True)
    values = [numbers_of_texts(texts, dialect.parse_number) for texts in columns]
    return np.column_stack(values) if values and values[0].size >= FEWEST_SEEN else None


def numbers_of_texts(texts: Sequence[str], parse: Callable[[str], float | None]) -> Floats:
    """Return the numbers in the cells of a column, or its times [s]; NaN where there is none.

    Args:
        texts: in the cells.
        parse: returns the number in a cell, None if there is none.
    """
    values = list(map(parse, texts))
    stamps = stamps_of(texts) if 2 * values.count(None) > len(values) else None
    numbers = np.array(values if stamps is None else list(map(stamps.seconds, texts)), float)
    return numbers if stamps is None or stamps.dated else over_midnight(numbers, math.nan)


def _stamp_text(cells: Sequence[str], layout: Layout) -> str:
    """Return the text of a line's time stamp, behind that of a column of dates."""
    return " ".join(cells[k] for k in (layout.date, layout.time) if k is not None)


def samples_of_text(reader: LogReader, path: Path, largest: int, most: float) -> Samples:
    """Return all samples of a CSV file, the oldest first.

    Args:
        reader: that has read nothing yet; afterwards it says what could not be read.
        path: of the file.
        largest: size of the file [bytes] beyond which it is refused.
        most: samples beyond which no more are read.

    Raises:
        FileError: as `LogReader.feed`, or it cannot be read.
    """
    blocks = []
    count = 0
    for data, last in blocks_of(path, largest):
        blocks.append(reader.feed(data, last))
        count += blocks[-1].t.size
        if count > most:
            break
    nonempty = [block for block in blocks if block.t.size] or blocks[-1:]
    return oldest_first(join_samples(nonempty))


def join_samples(blocks: Iterable[Samples]) -> Samples:
    """Join the samples of blocks."""
    return Samples(*list(map(np.concatenate, zip(*blocks, strict=True))))


def oldest_first(samples: Samples) -> Samples:
    """Return the samples in the order of time, if the log has the newest first throughout."""
    t = samples.t[np.isfinite(samples.t)]
    if t.size < 2 or not (np.diff(t) < 0).all():
        return samples
    return samples.select_rows(slice(None, None, -1))


def count_in_words(count: int) -> str:
    """Return a number of lines, in words."""
    return "1 line" if count == 1 else f"{count} lines"


def _at_once(lines: Sequence[str], dialect: Dialect, layout: Layout) -> Floats | None:
    """Return the numbers of the columns that are used, read by NumPy; None if a line is not
    plain.
    """
    if dialect.separator == " " or any(len(line) > LONGEST_LINE for line in lines):
        return None
    if {line.count(dialect.separator) for line in lines} != {dialect.width - 1}:
        return None
    if dialect.separator != ",":
        other = OTHER.get(dialect.mark, ",")
        if any(other in line for line in lines):
            return None  # thousands, or nothing tells it
        lines = [line.replace(",", ".") for line in lines]
    try:
        values = np.loadtxt(
            lines, delimiter=dialect.separator, usecols=layout.columns, comments=None, ndmin=2
        )
    except ValueError:
        return None
    return None if (np.abs(values) > LARGEST).any() else values


class Regular(NamedTuple):
    """Samples one step apart.

    Attributes:
        t: times (N) [s].
        y: readings (N x p), NaN if one is missing.
        u: inputs (N x m), NaN if one is missing.
    """

    t: Floats
    y: Floats
    u: Floats


class Placed(NamedTuple):
    """A log on the steps of a scenario.

    Attributes:
        samples: one step apart; those in gaps are missing.
        gaps: how many samples were missing, between others.
        measured: the usual time between two samples [s]; None without times.
        repeated: how many samples had the time of the one before, and were left out.
    """

    samples: Regular
    gaps: int = 0
    measured: float | None = None
    repeated: int = 0


def place_on_steps(samples: Samples, timed: bool, step: float, source: str) -> Placed:
    """Return the samples of a whole log, put on the steps of a scenario.

    Args:
        samples: of the log.
        timed: whether they have times in seconds.
        step: of the scenario [s].
        source: the log, for messages.

    Raises:
        FileError: they are another step apart, irregular, or go back in time.
    """
    if not timed:
        return Placed(samples.regular._replace(t=np.arange(len(samples.t)) * step))
    samples, repeated = without_repeats(samples)
    readable = np.isfinite(samples.t)  # what cannot be read shows as a gap in the others' times
    read = samples.select_rows(readable)
    if not read.t.size:
        return Placed(read.regular)
    lines_between = np.diff(np.flatnonzero(readable))  # 1 where all could be read
    require_increasing(read, source)
    intervals = np.append(step, np.diff(read.t))  # of the first sample a step
    measured = usual_step((intervals[1:] / lines_between)[:WATCHED])
    require_step(measured, step, TOLERANCE, source)
    steps = _placeable(intervals, step, read, source)
    gaps = int(steps.sum()) - read.t.size
    return Placed(fill_gaps(read.regular, steps, step), gaps, measured, repeated)


def without_repeats(samples: Samples) -> tuple[Samples, int]:
    """Return samples without repeated times, and the count of the repeated ones.

    If more than a tenth do, times are written too coarsely: then all stay, and are refused.

    Args:
        samples: of a log, in its order.
    """
    again = np.append(False, np.diff(samples.t) == 0)
    count = int(again.sum())
    if not 0 < count <= REPEATED * samples.t.size:
        return samples, 0
    return samples.select_rows(~again), count


def require_increasing(samples: Samples, source: str) -> None:
    """Raise FileError where a time is missing or does not increase.

    Args:
        samples: of the log.
        source: the log, for messages.
    """
    before = np.append(-np.inf, samples.t[:-1])
    for k in np.flatnonzero(~((samples.t > before) & (samples.t < np.inf)))[:1]:
        why = "the time is missing or not finite"
        if np.isfinite(samples.t[k]):
            why = (
                f"time does not increase: {samples.t[k]:.9g} s after {before[k]:.9g} s. Sort the "
                "lines, or give each run by itself"
            )
        raise FileError(f"{source}, line {samples.lines[k]}: {why}")


def whole_steps(intervals: Floats, step: float) -> Floats:
    """Return the number of steps in intervals (of any shape); 0 if they do not fit.

    Args:
        intervals: between samples [s].
        step: of the scenario [s].
    """
    steps = np.rint(intervals / step)
    off = np.abs(intervals - steps * step)
    fits = (steps >= 1) & (steps <= LONGEST) & (off <= JITTER * step)
    return np.asarray(np.where(fits, steps, 0.0))


def _placeable(intervals: Floats, step: float, samples: Samples, source: str) -> Floats:
    """How many steps each sample is after the one before (N). Raises FileError.

    Args:
        intervals: from the sample before to each (N) [s].
        step: of the scenario [s].
        samples: of the log.
        source: the log, for messages.
    """
    steps = whole_steps(intervals, step)
    bad = np.flatnonzero(steps == 0)
    if bad.size:
        k = int(bad[0])
        raise FileError(
            f"{source}, line {samples.lines[k]}: t = {samples.t[k]:.9g} s is {intervals[k]:.6g} s "
            f"after the sample before. Expected a multiple of the step, {step:g} s, and at most "
            f"{LONGEST} of them: bring the log onto regular steps (never by interpolating "
            "readings), or split it"
        )
    if steps.sum() > LONGEST + MOST * samples.t.size:
        raise FileError(f"{source}: consists of gaps: {steps.sum():.0f} missing steps")
    return steps


def fill_gaps(samples: Regular, steps: Floats, step: float) -> Regular:
    """Return samples with missing ones in their gaps.

    Args:
        samples: in order.
        steps: how many steps each is after the one before (N), at least 1.
        step: [s].

    Returns:
        Samples one step apart; readings and inputs in gaps are NaN.
    """
    total = int(steps.sum())
    if total == samples.t.size:
        return samples
    at = np.cumsum(steps).astype(int) - 1
    following = np.searchsorted(at, np.arange(total))
    behind = np.arange(total) - at[following]  # steps before the next sample, 0 at samples
    full = Regular(*[part[following] for part in samples])
    full.y[behind < 0] = full.u[behind < 0] = np.nan
    return full._replace(t=full.t + behind * step)


def usual_step(intervals: Floats) -> float | None:
    """Return the mean of the intervals about their lower median [s]; None if there are none.

    Gaps only lengthen intervals, and the rounding of times lets those of one step differ.
    """
    if not intervals.size:
        return None
    usual = np.quantile(intervals, 0.5, method="lower")
    return float(np.mean(intervals[np.abs(intervals - usual) <= JITTER * usual]))


def require_step(usual: float | None, step: float, tolerance: float, source: str) -> None:
    """Raise FileError if the step of a log differs from the step of the scenario.

    Args:
        usual: time between its samples [s]; None: not known.
        step: of the scenario [s].
        tolerance: how far one may be from the other, as a share of the step.
        source: the log.
    """
    if usual is not None and abs(usual - step) > tolerance * step:
        raise FileError(
            f"{source}: its samples are {usual:.6g} s apart, but the scenario's step is {step:g} "
            f"s: set simulation.step = {usual:.6g} if the log is right{_unit_hint(usual / step)}"
        )


def _unit_hint(ratio: float) -> str:
    """Return the remedy for steps that differ by a power of 1000: perhaps times in another unit."""
    for power, unit in ((1000.0, "ms"), (1e6, "us"), (1e9, "ns")):
        if abs(ratio / power - 1) < TOLERANCE:
            return f". If its times are in {unit}, say so in the header: t [{unit}]"
    return ""
