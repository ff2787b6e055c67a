"""Columns of a log, and which is which: by names that a user gives, else by the words and units
of names and by what the columns do.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from undeadzone.errors import FileError, InputError
from undeadzone.logs.kinds import (
    COUNTS,
    EXACT,
    REFERENCE,
    SECONDS,
    Title,
    add_unit,
    increases_evenly,
    is_regular_time,
    kind_of,
    rank_of,
    split_unit,
    split_words,
    time_rank,
)
from undeadzone.util.arrays import Floats

DATES: Final = ("date", "datum", "fecha", "day")  # beside a column of times of day
# Pairs of an input and a reading that are met more often than others, and by how much [rank].
PAIRS: Final = {("goal", "position"): 0.3, ("drive", "speed"): 0.2, ("position", "force"): 13.0}
# What a pair of columns adds to the difference of their ranks: common words, what one explains of
# the other, values that last in the input, changes that come first, its place in the file.
ALIKE, EXPLAINED, LASTING, EARLIER, AHEAD = 1.0, 0.5, 0.4, 0.3, 0.1
LAGS: Final = range(1, 4)  # samples, by which a reading may follow its input
INDEXED: Final = re.compile(r"^(.*?)[\[_(]?(\d+)[\])]?$")
_PLAIN: Final = re.compile(r"[\w .\[\]()/%°#:+*-]+")  # names that an option may hold as they are
_PRINTED_NAMES: Final = 12  # names in a message


def numbers(key: str, value: Any, kinds: str) -> Floats:
    """Return an array of floats, NaN and infinite ones among them.

    Args:
        key: name for messages.
        value: anything that NumPy makes an array of.
        kinds: NumPy's letters of the types that count as numbers.

    Raises:
        InputError: for rows of different lengths, and values that are not numbers.
    """
    try:
        array = np.asarray(value)
    except ValueError:
        raise InputError(f"{key}: expected numbers in a rectangular list") from None
    if array.dtype.kind not in kinds:
        raise InputError(f"{key}: expected numbers, found {array.dtype}")
    return array.astype(float)


class Layout(NamedTuple):
    """Columns of the signals of a log.

    Attributes:
        time: number of the column of times; None: there are none.
        date: number of the column of dates, if times of day have one of their own.
        readings: numbers of the columns of the readings (p).
        inputs: numbers of the columns of the inputs (m).
        seconds: length of a unit of time [s]; None if times count samples.
        reading_titles, input_titles: titles of these columns.
        columns_text: in words, the column of each signal.
        reference: number of the column of the reference; None: there is none, or it is not needed.
        is_certain: whether names without doubt or the user decided.
        option: how the user sets the columns, and which are not used.
    """

    time: int | None
    date: int | None
    readings: list[int]
    inputs: list[int]
    seconds: float | None
    reading_titles: list[Title]
    input_titles: list[Title]
    columns_text: str
    reference: int | None = None
    is_certain: bool = True
    option: str = ""

    @property
    def has_current(self) -> bool:
        """Return whether the second input is the current or torque of a servo that has a goal."""
        return [kind_of(*title) for title in self.input_titles] == ["goal", "torque"]

    @property
    def driving(self) -> list[int]:
        """Return the columns of the inputs, and behind them that of the reference, if there is
        one.
        """
        return self.inputs + ([] if self.reference is None else [self.reference])

    @property
    def columns(self) -> list[int]:
        """Return the columns that are used: the time if there is one, readings, what drives."""
        first = [] if self.time is None else [self.time]
        return first + self.readings + self.driving

    @property
    def has_times(self) -> bool:
        """Return whether it has times in seconds."""
        return self.time is not None and self.seconds is not None


def parse_columns(text: str | None) -> dict[str, str]:
    """Return the columns that a text names, by signal.

    Args:
        text: `y=angle,u=voltage,r=wanted`, `t=1,y[0]=2,y[1]=3,u=4`; None: nothing is named.

    Returns:
        A column's name or number (from 1) by `t`, `y[0]`, ..., `u[0]`, ...; `y` means `y[0]`.

    Raises:
        InputError: it is written otherwise.
    """
    chosen: dict[str, str] = {}
    for part in filter(None, (text or "").split(",")):
        key, equals, name = (piece.strip() for piece in part.partition("="))
        if not equals or not name or not re.fullmatch(r"[tr]|[yu](\[\d+\])?", key):
            raise InputError(
                "columns: expected t=NAME, y=NAME, u=NAME, r=NAME or y[0]=NAME, with commas, "
                f"found {part!r}"
            )
        if key in ("y", "u"):
            key += "[0]"
        if key in chosen:
            raise InputError(f"columns: {key} is named twice")
        chosen[key] = name
    return chosen


def layout_of_titles(
    titles: Sequence[Title],
    p: int | None,
    m: int | None,
    chosen: Mapping[str, str],
    source: str,
    values: Floats | None = None,
) -> Layout:
    """Return the columns of the signals of a log with a header.

    Args:
        titles: of its header.
        p, m: numbers of readings and inputs that the plant has; None: as many as are named, and
            the reference if there is one.
        chosen: columns that the user names; see `parse_columns`.
        source: the log, for messages.
        values: numbers in the columns (N x K), which decide what names leave open; None: what
            names leave open is refused.

    Raises:
        FileError: a column is not known, or is used twice; names near it are listed.
    """
    _refuse_others(chosen, p, m)
    if values is not None:  # a column without numbers is as good as a constant one
        values = np.where(np.isfinite(values).any(axis=0), values, 0.0)
    header = _Header(titles, chosen, source, values)
    time = header.find_time_column()
    readings, inputs = header.find_signals(time, p, m)
    layout = header.layout(time, readings, inputs)
    return layout if m is not None else header.with_reference(layout)


def layout_of_numbers(
    width: int, p: int | None, m: int | None, chosen: Mapping[str, str], source: str
) -> Layout:
    """Return the columns of a log without a header, which the user names by number.

    Args:
        width: how many columns there are.
        p, m: numbers of readings and inputs that the plant has; None: as many as are named.
        chosen: columns that the user names by number; see `parse_columns`.
        source: the log, for messages.

    Raises:
        FileError: nothing is named: any order would be a guess; or a number is none of theirs.
    """
    if not chosen:
        raise FileError(
            f"{source}: without a header the order of columns is not known. Add one, t,y,u, or "
            'name the columns by number: columns="t=1,y=2,u=3"'
        )
    titles = [Title(str(k + 1), "") for k in range(width)]
    return layout_of_titles(titles, p, m, chosen, source)


class _Header(NamedTuple):
    """Titles of the columns, and the columns that the user names.

    Attributes:
        titles: of the columns.
        chosen: columns that the user names; see `parse_columns`.
        source: the log, for messages.
        values: numbers in the columns (N x K); None: they are not asked.
    """

    titles: Sequence[Title]
    chosen: Mapping[str, str]
    source: str
    values: Floats | None = None

    def layout(self, time: int | None, readings: list[int], inputs: list[int]) -> Layout:
        """Return a layout, once no column is used twice and the unit of time is known."""
        used = readings + inputs + ([] if time is None else [time])
        for column in used:
            if used.count(column) > 1:
                raise self.require_distinct(column)
        seconds: float | None = 1.0
        date = None
        roles = []
        if time is not None:
            seconds = _seconds(self.titles[time], self.source)
            dated = [k for k, title in enumerate(self.titles) if title.name.lower() in DATES]
            date = next((k for k in dated if k not in used), None)
            roles.append(f"t from {self.titles[time].name!r}")
        y, u = ([add_unit(self.titles[k]) for k in columns] for columns in (readings, inputs))
        for signal, titles in (("y", y), ("u", u)):
            roles.append(f"{signal} from {', '.join(repr(title.name) for title in titles)}")
        certain = all(abs(rank_of(title)) == EXACT for title in (*y, *u))
        is_certain = bool(_of_signal(self.chosen, "y")) or certain
        keys = [f"y[{i}]" if y[1:] else "y" for i in range(len(y))]
        keys += [f"u[{i}]" if u[1:] else "u" for i in range(len(u))] + ["t"] * (time is not None)
        parts = [f"{key}={self.printed_name(k)}" for key, k in zip(keys, used, strict=True)]
        option = f'--columns "{",".join(parts)}"'
        text = ", ".join(roles)
        left = [title for k, title in enumerate(self.titles) if k not in used and title.name]
        option = f"{option} sets them" + (f". Not used: {_list_columns(left)}" if left else "")
        return Layout(time, date, readings, inputs, seconds, y, u, text, None, is_certain, option)

    def printed_name(self, k: int) -> str:
        """Return the name of a column as an option may hold it, else its number (from 1)."""
        name = self.titles[k].name
        is_plain = _PLAIN.fullmatch(name) and not name.isdigit()
        return name if is_plain and len(self.find_equal_names(name)) == 1 else str(k + 1)

    def with_reference(self, layout: Layout) -> Layout:
        """Return the layout with the reference: a column that is nothing else. Raises FileError."""
        if "r" in self.chosen:
            found = [self.column_of_name("r")]
            if found[0] in layout.columns:
                raise self.require_distinct(found[0])
        else:
            near = self.likeness()[:, layout.readings[0]]
            goals = [k for k, title in enumerate(self.titles) if kind_of(*title) in ("sp", "goal")]
            open_ones = [k for k in goals if k not in layout.columns]
            found = sorted(open_ones, key=lambda k: near[k] + 5 * (rank_of(self.titles[k]) < 12))
        if not found:
            return layout
        columns_text = f"{layout.columns_text}, r from {self.titles[found[-1]].name!r}"
        return layout._replace(reference=found[-1], columns_text=columns_text)

    def require_distinct(self, column: int) -> FileError:
        """That one column would have two parts."""
        name = self.titles[column].name
        return FileError(f"{self.source}: column {name!r} would be used twice")

    def find_time_column(self) -> int | None:
        """Return the number of the column of times; None if there is none. Raises FileError."""
        if "t" in self.chosen:
            return self.column_of_name("t")
        ranks = [time_rank(title) for title in self.titles]
        named = [rank for rank in ranks if rank >= 0]
        best = [k for k, rank in enumerate(ranks) if named and rank == min(named)]
        if self.values is not None:
            rising = {k for k, x in enumerate(self.values.T) if np.mean(np.diff(x) >= 0) > 0.9}
            unknown = [k for k in rising if not rank_of(self.titles[k])]
            best = [k for k in best if k in rising] or best
            if not best and len(self.titles) > 2:
                best = [k for k in unknown if is_regular_time(self.values[:, k])]
            best = best[:1]
        if len(best) > 1:
            many = f"several columns are named {self.titles[best[0]].name!r}"
            raise FileError(f'{self.source}: {many}; columns="t=NUMBER"')
        return best[0] if best else None

    def find_signals(
        self, time: int | None, p: int | None, m: int | None
    ) -> tuple[list[int], list[int]]:
        """Return the numbers of the columns of readings and of inputs. Raises FileError.

        Args:
            time: number of the column of times.
            p, m: numbers of readings and inputs; None: as many as are named.
        """
        y, u = self.columns_named("y", p), self.columns_named("u", m)
        ranks = self.ranks(y + u, m is not None)
        used = {*y, *u, time}
        is_open = np.array([k not in used and time_rank(t) < 0 for k, t in enumerate(self.titles)])
        if self.values is not None:
            varies = np.nanmax(self.values, axis=0) > np.nanmin(self.values, axis=0)
            counts = [increases_evenly(x) for x in self.values.T]
            for kept in (varies, ~(np.array(counts) & (ranks == 0))):
                fewer = is_open & (kept | (np.abs(ranks) == EXACT))
                is_open = fewer if fewer.sum() + bool(y) + bool(u) > 1 else is_open
        scores = ranks[:, None] - ranks + self.likeness() + self.behaviour()
        for axis, given in enumerate((u, y)):
            rows = np.isin(np.arange(ranks.size), given[:1]) if given else is_open
            scores = np.where(rows[:, None] if axis == 0 else rows, scores, -np.inf)
        np.fill_diagonal(scores, -np.inf)
        i, j = np.unravel_index(int(np.argmax(scores)), scores.shape)
        best = scores[i, j]
        is_unknown = self.values is None or best == -np.inf
        for signal, given, k, count, usual in (("y", y, j, p, "output"), ("u", u, i, m, "input")):
            rivals = np.delete(scores[i] if signal == "y" else scores[:, j], k)
            tie = rivals.max(initial=-np.inf) > best - 1e-3 and not self.group(int(k), count)
            if not given and is_unknown and (tie or best == -np.inf or ranks[k] == 0):
                raise self.require_names(signal, usual)
        if not y:
            y = self.group(int(j), p) or [int(j)]
        if not u:
            u = self.group(int(i), m) or [int(i)]
            u = u + (self.drive_of_servo(u, y, time) if m is None else [])
        return y, u

    def ranks(self, given: list[int], is_known_plant: bool) -> Floats:
        """Return the rank of each column (K), by its name and by those beside it."""
        ranks = np.array([rank_of(title) for title in self.titles])
        ranks += (
            0.01 * np.array([title.name.lower() in ("y", "u") for title in self.titles]) * ranks
        )
        outputs = np.array([split_words(title.name) in ("output", "out") for title in self.titles])
        driven = (ranks > 17) | np.isin(np.arange(ranks.size), given)
        if outputs.any() and not driven.any() and ((ranks < 0) & ~outputs).any():
            ranks[outputs] = EXACT  # a controller's
        if is_known_plant:
            ranks[ranks == REFERENCE] = 0.0
        return ranks

    def likeness(self) -> Floats:
        """Return how well names and kinds of an input (row) and a reading fit (K x K)."""
        words = [{*split_words(title.name).split(" ")} for title in self.titles]
        kinds = [kind_of(*title) for title in self.titles]
        out = np.zeros((len(words), len(words)))
        for i, one in enumerate(words):
            for j, other in enumerate(words):
                common = len(one & other) / max(len(one | other), 1)
                out[i, j] = ALIKE * common + PAIRS.get((kinds[i], kinds[j]), 0.0)
        return out

    def behaviour(self) -> Floats:
        """Return how well what the columns do fits an input (row) and a reading (K x K)."""
        if self.values is None:
            return np.zeros((len(self.titles), len(self.titles)))
        levels = self.values - np.nanmean(self.values, axis=0)
        changes = np.diff(levels, axis=0, prepend=levels[:1])
        lasting = np.mean(changes == 0, axis=0)
        x, dx = (np.nan_to_num(part / np.fmax(np.nanstd(part, axis=0), 1e-300)) for part in
                 (levels, changes))  # fmt: skip
        explained = np.maximum(*(np.abs(x.T @ part) / len(x) for part in (x, dx)))
        after = np.mean([(dx[:-k].T @ dx[k:] / len(x)) ** 2 for k in LAGS], axis=0)
        ahead = np.sign(np.arange(len(lasting)) - np.arange(len(lasting))[:, None])
        return (
            EXPLAINED * explained
            + LASTING * (lasting[:, None] - lasting)
            + EARLIER * (after - after.T) / (after + after.T + 1e-3)
            + AHEAD * ahead
        )

    def columns_named(self, signal: str, count: int | None) -> list[int]:
        """Return the columns that the user names for y or u. Raises InputError if one lacks."""
        named = _of_signal(self.chosen, signal)
        required = [f"{signal}[{i}]" for i in range(count or len(named))] if named else []
        missing = [key for key in required if key not in self.chosen]
        if missing:
            count = len(required)
            raise InputError(f"columns: {missing[0]} is missing. Expected {count} of {signal}")
        return [self.column_of_name(key) for key in required]

    def group(self, column: int, count: int | None) -> list[int]:
        """Return the columns of one signal without doubt that differ by an index (`y[0]`).

        Raises FileError if they are not as many as expected.

        Args:
            column: one of them.
            count: how many there must be; None: any number.
        """
        titles = [title.name.lower() for title in self.titles]
        match = INDEXED.match(titles[column])
        rank = rank_of(self.titles[column])
        if abs(rank) != EXACT:
            if (count or 1) > 1:
                signal = "y" if rank < 0 else "u"
                raise self.require_names(signal, signal)
            return []
        found = [INDEXED.match(title) for title in titles]
        same = {
            int(other[2]): k
            for k, other in enumerate(found)
            if match is not None and other is not None and other[1] == match[1]
        }
        columns = [same[index] for index in sorted(same)] or [
            k for k, title in enumerate(titles) if title == titles[column]
        ]
        if count is not None and len(columns) != count:
            signal = "y" if rank < 0 else "u"
            raise FileError(
                f"{self.source}: expected {count} of {signal}, the log has {len(columns)}: "
                f"{_list_columns([self.titles[k] for k in columns])}. Name it by "
                f'columns="{signal}[0]=NAME"'
            )
        return columns if count is not None or same else []

    def drive_of_servo(self, u: list[int], y: list[int], time: int | None) -> list[int]:
        """Return the column of the current of a servo that follows a position; none for others."""
        kinds = [kind_of(*title) for title in self.titles]
        if [kinds[u[0]], kinds[y[0]], len(u)] != ["goal", "position", 1]:
            return []
        near = self.likeness()[:, y[0]]
        same = [k for k, kind in enumerate(kinds) if kind == "torque" and k not in (*u, *y, time)]
        if self.values is not None:
            same = [k for k in same if np.nanstd(self.values[:, k]) > 0]
        best = [k for k in same if near[k] >= max(near[same]) - 1e-9]
        return best if len(best) == 1 else []

    def require_names(self, signal: str, usual: str) -> FileError:
        """That no name shows which column holds a signal."""
        require_table(self.source)
        names = ("y", "measured", usual) if signal == "y" else ("u", usual, "command")
        hint = self.hint_near_names(names) or "."
        assignments = [f"{key}={name}" for key, name in self.chosen.items()]
        for other in ("y", "u"):
            ranks = [rank_of(title) * (1 if other == "u" else -1) for title in self.titles]
            if not _of_signal(self.chosen, other) and (other == signal or max(ranks) <= 0):
                assignments.append(f"{other}=NAME")
        columns = ",".join(assignments).replace("[0]", "")
        return FileError(
            f"{self.source}: no name shows which column holds {signal}. There are "
            f'{_list_columns(self.titles)}{hint} Name it by columns="{columns}"'
        )

    def find_equal_names(self, name: str) -> list[int]:
        """Return the columns of that name; if there is none, those of that name with a unit."""
        lower = split_unit(name).name.lower()
        exact = [k for k, title in enumerate(self.titles) if title.name.lower() == name.lower()]
        near = [k for k, title in enumerate(self.titles) if title.name.lower() == lower]
        words = split_words(name)
        return exact or near or [
            k for k, title in enumerate(self.titles) if split_words(title.name) == words
        ]  # fmt: skip

    def column_of_name(self, key: str) -> int:
        """Return the column of a chosen name or number (from 1).

        Raises FileError with the nearest.
        """
        name = self.chosen[key]
        exact = [k for k, title in enumerate(self.titles) if title.name == name]
        same = exact or self.find_equal_names(name)
        if len(same) == 1:
            return same[0]
        if not same and name.isdigit() and 1 <= int(name) <= len(self.titles):
            return int(name) - 1
        how = "several columns are named" if same else "no column"
        raise FileError(
            f"{self.source}: columns, {key}: {how} {name!r}. "
            f"There are {_list_columns(self.titles)}"
            f"{self.hint_near_names([name])}"
        )

    def hint_near_names(self, names: Sequence[str]) -> str:
        """Return a hint at the names of columns that are near some names."""
        lower = {title.name.lower(): title.name for title in self.titles}
        for name in names:
            near = difflib.get_close_matches(name.lower(), lower, 1)
            if near:
                return f". Did you mean {lower[near[0]]!r}?"
        return ""


def _seconds(title: Title, source: str) -> float | None:
    """Return the length of a unit of time [s]; None if it counts samples. Raises FileError."""
    unit = title.unit.lower()
    last = split_words(add_unit(title).name).split(" ")[-1]
    if not unit:
        unit = (add_unit(title).unit or (last if last in (*SECONDS, *COUNTS) else "")).lower()
    if unit in COUNTS:
        return None
    if unit not in SECONDS:
        raise FileError(
            f"{source}: unit of time not understood: {title.unit!r}. Use s, ms, us, min, h or "
            "samples"
        )
    return SECONDS[unit]


def _refuse_others(chosen: Mapping[str, str], p: int | None, m: int | None) -> None:
    """Raise InputError for a signal that the plant does not have."""
    known = ["t", "r"]  # a reference moves no plant: who does not ask for it may have it named
    for signal, count in (("y", p), ("u", m)):
        count = len(_of_signal(chosen, signal)) if count is None else count
        known += [f"{signal}[{i}]" for i in range(count)]
    for key in chosen:
        if key not in known:
            raise InputError(f"columns: the plant has no {key}. It has {', '.join(known[2:])}")


def require_table(source: str) -> None:
    """Raise FileError for the path of a scenario, which is no log."""
    if source.endswith(".toml"):
        raise FileError(f"{source}: this is a scenario, no log. The log is a table with t, u, y")


def _of_signal(chosen: Mapping[str, str], signal: str) -> list[str]:
    """Return the keys of a signal among those that the user names."""
    return [key for key in chosen if key.startswith(signal + "[")]


def _list_columns(titles: Sequence[Title]) -> str:
    """Return the names of columns, for a message."""
    names = ", ".join(repr(title.name) for title in titles[:_PRINTED_NAMES])
    return names + (", ..." if len(titles) > _PRINTED_NAMES else "")
