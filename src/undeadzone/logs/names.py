"""Columns of a log and their signals: by the names of a user, else by the words and units of names
and by the behaviour of the columns.
"""

from __future__ import annotations

import difflib
import itertools
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
    TABLE,
    VAGUE,
    Title,
    add_unit,
    counts_rows,
    increases_evenly,
    is_regular_time,
    kind_of,
    rank_of,
    split_unit,
    split_words,
    time_rank,
)
from undeadzone.util.arrays import Flags, Floats, Integers, split_past

DATES: Final = ("date", "datum", "fecha", "day")  # beside a column of times of day
# Pairs of an input and a reading that are met more often than others, and by how much [rank].
PAIRS: Final = {
    ("goal", "position"): 0.3,
    ("drive", "speed"): 0.2,
    ("position", "force"): 13.0,
    ("drive", "force"): 13.0,
}
BY_HAND: Final = 40.0  # rank of a column of a table that runs evenly, as of an exact name
COMMON: Final = 4.0  # rank of an input and a reading of one name
EVEN_BY_HAND: Final = 1e-6  # of the range, as far as what is set by hand is uneven
HALF: Final = 0.5  # of the rows, in which a column of a table is set by hand
EVEN: Final = 1e-3  # of the range, up to which a column rests or runs evenly
FULL: Final = 0.5  # correlation from which names count in full, below as much less
BESIDE: Final = -7.0  # rank of what follows a goal of its name, at most
COPIED: Final = 1.0  # what a reading loses of which there is a copy: one of both is worked out
FIRST: Final = 0.05  # what an input gains that stands ahead of its reading
COPY: Final = 1 - 1e-9  # correlation of a column with its copy
SUM: Final = 0.999  # and of its changes with what it adds up
USED: Final = (0.005, 0.995)  # quantiles of a column beyond which values are cut
SINCE_2001: Final = 1e9  # [s] since 1970
LATEST: Final = 100.0  # of that, from which a time is in milliseconds or less
UNEVEN: Final = 0.005  # share of the steps of a clock that are longer or shorter by one
PAST: Final = 16  # the part of a log that counts as the past of a sample: at least one of these
LONGER: Final = (8, 32)  # samples whose means show what the noise of single ones hides
BLOCKS: Final = 32 * PAST  # such means, at least
RIDGE: Final = 1e-6  # of a mean square
USUAL: Final = {"y": ("y", "output", "measured"), "u": ("u", "input", "command")}
INDEXED: Final = re.compile(r"(?s)^(.*?)[\[_(]?(\d*)[\])]?$")
_PLAIN: Final = re.compile(r"[\w .\[\]()/%°#:+*-]+")  # names that an option may hold as they are
DIGIT: Final = "0123456789"
DIGITS: Final = (*DIGIT, "]", ")")  # how names with an index end
_PRINTED_NAMES: Final = 12  # names in a message


def numbers(key: str, value: Any, kinds: str) -> Floats:
    """Return an array of floats, possibly with NaN and infinity.

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
        columns_text: these columns, as the text of `parse_columns`.
        reference: number of the column of the reference; None: there is none, or it is not needed.
        is_certain: whether names without doubt or the user decided.
        unused: names of other columns, for messages.
        next_text: the pair of columns that would be next, as `columns_text`; "" if there is none.
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
    unused: str = ""
    next_text: str = ""

    @property
    def has_current(self) -> bool:
        """Return whether the second input is the current or torque of a servo that has a goal."""
        return list(itertools.starmap(kind_of, self.input_titles)) == ["goal", "torque"]

    @property
    def driving(self) -> list[int]:
        """Return the columns of the inputs, and behind them that of a reference."""
        return self.inputs + ([] if self.reference is None else [self.reference])

    @property
    def columns(self) -> list[int]:
        """Return the columns in use: a time, the readings, the inputs and a reference."""
        first = [] if self.time is None else [self.time]
        return first + self.readings + self.driving

    @property
    def has_times(self) -> bool:
        """Return whether it has times in seconds."""
        return self.time is not None and self.seconds is not None


def parse_columns(text: str | None) -> dict[str, str]:
    """Return the columns that a text names, by signal.

    Args:
        text: `y=angle,u=voltage,r=goal`, `t=1,y[0]=2,y[1]=3,u=4`; None: nothing is named.

    Returns:
        A column's name or number (from 1) by `t`, `y[0]`, ..., `u[0]`, ...; `y` means `y[0]`.

    Raises:
        InputError: it is written otherwise.
    """
    chosen: dict[str, str] = {}
    for part in filter(None, (text or "").split(",")):
        key, equals, name = map(str.strip, part.partition("="))
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
    header = _Header(titles, chosen, source, values, values is not None and p is m is None)
    time = header.find_time_column()
    y, u, after = header.find_signals(time, p, m)
    r = []
    if m is None:
        u = u + ([] if _of_signal(chosen, "u") else header.drive_of_servo(y, u))
        r = header.find_reference([*time, *y, *u], y[0])
    return header.layout({"t": time, "y": y, "u": u, "r": r}, {"t": time} | after)


class _Header(NamedTuple):
    """Titles of the columns, and the columns that the user names.

    Attributes:
        titles: of the columns (K).
        chosen: columns that the user names; see `parse_columns`.
        source: the log, for messages.
        values: numbers in the columns (N x K); None: they are not known.
        is_open: whether what the columns do decides what names leave open.
    """

    titles: Sequence[Title]
    chosen: Mapping[str, str]
    source: str
    values: Floats | None
    is_open: bool

    @property
    def kinds(self) -> list[str]:
        """Return what each column may hold, by its name and unit (K)."""
        return list(itertools.starmap(kind_of, self.titles))

    def layout(self, roles: Mapping[str, list[int]], after: Mapping[str, list[int]]) -> Layout:
        """Return a layout, once no column is used twice and the unit of time is known.

        Args:
            roles: columns of t, y, u and r.
            after: those that would be next.
        """
        used = list(itertools.chain.from_iterable(roles.values()))
        for column in used:
            if used.count(column) > 1:
                name = self.titles[column].name
                raise FileError(f"{self.source}: column {name!r} would be used twice")
        time, y, u, r = roles.values()
        dated = [k for k, title in enumerate(self.titles) if title.name.lower() in DATES]
        titles = [add_unit(self.titles[k]) for k in (*y, *u)]
        certain = all(abs(rank_of(title)) == EXACT for title in titles)
        left = [title for k, title in enumerate(self.titles) if k not in used and title.name]
        return Layout(
            time[0] if time else None,
            next((k for k in dated if time and k not in used), None),
            list(y),
            list(u),
            self.seconds(time[0]) if time else 1.0,
            titles[: len(y)],
            titles[len(y) :],
            self.option(roles),
            r[0] if r else None,
            certain or bool(_of_signal(self.chosen, "y")),
            _list_columns(left),
            self.option(after) if "y" in after else "",
        )

    def option(self, roles: Mapping[str, list[int]]) -> str:
        """Return columns as the text of `parse_columns`.

        Args:
            roles: columns of t, y, u and r.
        """
        parts = []
        for key, columns in roles.items():
            keys = [f"{key}[{i}]" for i in range(len(columns))] if columns[1:] else [key]
            names = map(self.printed_name, columns)
            parts += [f"{one}={name}" for one, name in zip(keys, names, strict=False)]
        return ",".join(parts)

    def seconds(self, k: int) -> float | None:
        """Return the length of a unit of time [s]; None if it counts samples. Raises FileError.

        Without a unit, whole numbers unevenly apart are the milliseconds of a microcontroller, and
        times since 1970 have the unit that puts them after 2001.
        """
        title = self.titles[k]
        unit = _seconds(title, self.source)
        if unit != 1.0 or not self.is_open or self.values is None or add_unit(title).unit:
            return unit
        since = float(np.nanmax(self.values[:, k])) / SINCE_2001
        if since > LATEST:
            return 1e-3 ** round(np.log10(since) / 3)
        steps = np.diff(self.values[:, k])
        usual = np.median(steps[steps > 0]) if (steps > 0).any() else 0.0
        is_whole = not (steps % 1).any() and np.abs(self.values[:, k]).max() < SINCE_2001
        uneven = np.mean(np.abs(steps - usual) == 1) > UNEVEN
        return 1e-3 if is_whole and uneven and usual > 1 else unit

    def printed_name(self, k: int) -> str:
        """Return the name of a column in the form of an option, else its number (from 1)."""
        name = self.titles[k].name
        is_plain = _PLAIN.fullmatch(name) and len(self.find_equal_names(name)) == 1
        return name if is_plain else str(k + 1)

    def find_reference(self, used: Sequence[int], y: int) -> list[int]:
        """Return the column of the reference; an empty list without one."""
        if "r" in self.chosen:
            return [self.column_of_name("r")]
        kinds = self.kinds
        has_goal = "goal" in [kinds[k] for k in used]  # beside which another is another's
        goals = [
            k
            for k, title in enumerate(self.titles)
            if kinds[k] in ("sp", "goal")
            and k not in used
            and (self.values is None or self.values[:, k].any())  # of a text no number is known
            and (rank_of(title) == REFERENCE or not has_goal)
        ]
        near = self.likeness()[:, y]
        return sorted(goals, key=lambda k: near[k] - rank_of(self.titles[k]))[-1:]

    def find_time_column(self) -> list[int]:
        """Return the column of times; none if there is none. Raises FileError."""
        if "t" in self.chosen:
            return [self.column_of_name("t")]
        ranks = np.where(self.moves(), list(map(time_rank, self.titles)), -1)
        best = np.flatnonzero((ranks >= 0) & (ranks == ranks[ranks >= 0].min(initial=99)))
        if self.values is not None:
            change = np.diff(self.values[:, best], axis=0)
            runs = np.maximum(np.mean(change >= 0, axis=0), np.mean(change <= 0, axis=0)) > 0.9
            best = best[runs] if runs.any() else best[:1][ranks[best[:1]] < VAGUE]
            unknown = [k for k in self.may_count() if not self.titles[k].unit]
            if not best.size and self.moves().sum() > 2:
                best = np.array([k for k in unknown if is_regular_time(self.values[:, k])], int)
        if best.size > 1 and not self.is_open:
            many = f"several columns are named {self.titles[best[0]].name!r}"
            raise FileError(f'{self.source}: {many}; columns="t=NUMBER"')
        named = list(map(self.column_of_name, self.chosen))
        return list(itertools.filterfalse(named.__contains__, best.tolist()))[:1]

    def find_signals(
        self, time: list[int], p: int | None, m: int | None
    ) -> tuple[list[int], list[int], dict[str, list[int]]]:
        """Return the columns of readings, of inputs, and the next pair by signal. Raises FileError.

        Args:
            time: number of the column of times.
            p, m: numbers of readings and inputs; None: as many as are named.
        """
        y, u = self.columns_named("y", p), self.columns_named("u", m)
        ranks = self.ranks(y + u)
        used = [*y, *u, *time]
        free = np.array([k not in used and time_rank(t) < 0 for k, t in enumerate(self.titles)])
        if m == 0:  # of a sensor alone
            j = int(np.argmin(np.where(free, ranks, np.inf)))
            if not (y or (free[j] and (ranks[j] < 0 or free.sum() == 1))):
                raise self.require_name("y")
            return y or self.group("y", j, p), [], {}
        read, stays = free, 0 * ranks
        if self.is_open and self.values is not None:
            x = np.nan_to_num(self.values)
            commands = ~self.moves() & x.any(axis=0) & (len(x) >= TABLE)  # that stay at a value
            stays = np.where(commands, ranks, 0.0)
            free = self.free_of_counts(free, self.values, len(y + u))
            changes = free & ~(_have_two_values(x) & (np.abs(ranks) < EXACT))
            read = changes if changes.any() else free
        shown, fits = self.behaviour(bool(time))
        exact = np.abs(ranks) >= EXACT
        shown = np.where(np.logical_or.outer(exact, exact), 1.0, shown)
        names = np.subtract.outer(ranks, ranks) * np.minimum(shown / FULL, 1.0)
        scores = np.round(names + self.likeness() + fits, 6)  # copies are equal
        every = np.arange(ranks.size)
        rows = np.isin(every, u[:1]) if u else free
        asked = read & (ranks < EXACT)  # a column with an input's own name is no reading
        read = asked if asked.any() else read
        columns = np.isin(every, y[:1]) if y else read
        scores[~(rows[:, None] & columns) | np.eye(every.size, dtype=bool)] = -np.inf
        i, j = map(int, np.unravel_index(np.argmax(scores), scores.shape))
        best = scores[i, j]
        if not y + u and ranks[i] <= 0 < stays.max():
            i = int(np.argmax(stays))  # a command that stays, beside readings alone
        for signal, given, k, rivals in (("y", y, j, scores[i]), ("u", u, i, scores[:, j])):
            is_tie = np.sum(rivals > best - 0.001) > 1 and not self.titles[k].name.endswith(DIGITS)
            is_alike = not y + u and ranks[i] <= ranks[j]
            is_unknown = not self.is_open and (ranks[k] == 0 or is_tie or is_alike)
            if not given and (is_unknown or best == -np.inf):
                if is_tie and abs(ranks[k]) >= EXACT:
                    self.group(signal, k, p if signal == "y" else m)
                raise self.require_name(signal)
        scores[i, j] = -np.inf
        after = np.unravel_index(np.argmax(scores), scores.shape)
        pair = {
            key: [int(k)]
            for key, k in zip("yu", after[::-1], strict=True)
            if scores.max() > -np.inf
        }
        return y or self.group("y", j, p), u or self.group("u", i, m), pair

    def free_of_counts(self, free: Flags, values: Floats, given: int) -> Flags:
        """Return the columns that are left for signals (K).

        Constants, counts, and what is recorded beside input and reading are none, as long as enough
        others are left.

        Args:
            free: columns that may be signals (K).
            values: numbers in the columns (N x K).
            given: number of columns that the user names.
        """
        counts = np.isin(np.arange(free.size), self.may_count())
        counts &= np.array(list(map(increases_evenly, values.T)))
        unnamed = np.array(self.titles)[:, 0] == ""  # in a sheet, what is worked out
        aside = (np.array(self.kinds) == "aside") | unnamed
        exact = np.abs(list(map(rank_of, self.titles))) >= EXACT
        for out in (~self.moves(), counts, aside):
            fewer = free & (~out | exact)
            if fewer.sum() + given > 1:
                free = fewer
        return free

    def moves(self) -> Flags:
        """Return which columns are not constant, as far as their values are known (K)."""
        if self.values is None:
            return np.ones(len(self.titles), bool)
        return np.asarray(np.nanmax(self.values, axis=0) > np.nanmin(self.values, axis=0))

    def may_count(self) -> list[int]:
        """Return the columns that may be a time or an index; in a table only those without a name.

        Any other even column of a table is a command, if it does not count the rows beside another.
        """
        free = [k for k, title in enumerate(self.titles) if not rank_of(title)]
        if self.values is None or len(self.values) >= TABLE:
            return free
        beside = np.sum(_evenness(_scaled(self.values), EVEN_BY_HAND) > HALF) > 1
        rows = [bool(beside and counts_rows(one)) for one in self.values.T]
        return [k for k in free if rows[k] or not self.titles[k].name.strip(DIGIT)]

    def ranks(self, given: list[int]) -> Floats:
        """Return the rank of each column (K), by its name and by the names of its neighbours."""
        ranks = np.array(list(map(rank_of, self.titles)))
        ranks[[title.name.lower() in ("y", "u") for title in self.titles]] *= 1.01
        words = [split_words(title.name) for title in self.titles]
        outputs = np.array([one.rstrip(DIGIT + " ") in ("output", "out") for one in words])
        drives = (ranks > 17) | np.isin(np.arange(ranks.size), given)
        if not drives.any() and ((ranks < 0) & ~outputs).any():
            ranks[outputs] = EXACT  # a controller's
        for one, other in itertools.permutations(range(len(words)), 2):
            more = {*words[one].split()} - {*words[other].split()}
            is_longer = len(words[one].split()) == len(words[other].split()) + len(more)
            is_goal = is_longer and kind_of(" ".join(more)) == "goal"
            if more and is_goal and self.kinds[other] != "torque":
                ranks[other] = min(ranks[other], BESIDE)  # the same without the words of a goal
        if not self.is_open:
            ranks[ranks == REFERENCE] = 0.0
        return ranks

    def likeness(self) -> Floats:
        """Return how well names and kinds of an input (row) and a reading fit (K x K)."""
        words = [{*split_words(title.name).split(" ")} for title in self.titles]
        common = [
            [len(one & other) / min(len(one), len(other)) for other in words] for one in words
        ]
        kinds = self.kinds
        pairs = [[PAIRS.get((one, other), 0.0) for other in kinds] for one in kinds]
        return COMMON * np.array(common) + np.array(pairs)

    def behaviour(self, has_times: bool) -> tuple[Floats, Floats]:
        """Return how much an input (row) explains of a reading, and how well the pair fits (K x K).

        An input explains its reading, at once or by its past, and moves by itself: it rests or
        runs evenly. Nothing is caused by its copy, or by what adds it up.

        Args:
            has_times: whether there are times; without them a table of rests has no past.
        """
        if self.values is None or not self.is_open:
            alike = np.ones((len(self.titles), len(self.titles)))
            return alike, alike
        x = _scaled(self.values)
        shown = np.abs(x.T @ x) / len(x)
        derived = _copies(x)
        copied = np.sum(derived, axis=0) > 1
        shown = fits = np.maximum(shown, _smoothness(x))
        if len(x) >= (2 * PAST if has_times else TABLE):
            at_all, gains = _explained(x)
            longer = [means for size in LONGER if len(means := _means(x, size)) >= BLOCKS]
            every = np.array([gains, *(_explained(means)[1] for means in longer)])
            sums = np.abs(_scaled(x[1:]).T @ _scaled(np.diff(self.values, axis=0))) / len(x)
            adds: Flags = np.asarray(sums > SUM)
            derived |= adds | adds.T | np.any(adds, axis=0, keepdims=True).T
            shown = np.maximum.reduce([shown, at_all, at_all.T / 2, gains])  # slopes show what adds
            fits = shown * (1 + gains) * (1 - every.max(axis=(0, 1))[:, None])
        tables = len(x) < TABLE
        weight, tolerance = (1.0, EVEN) if has_times and not tables else (BY_HAND, EVEN_BY_HAND)
        evenness = _evenness(x, tolerance, rests=tables or has_times)
        even = weight * np.subtract.outer(*[evenness * (evenness > HALF)] * 2)
        shown, fits = np.where(derived, 0.0, [shown, fits * (1 + even)])
        return shown, fits + FIRST * np.triu(np.ones_like(fits)) - COPIED * copied

    def columns_named(self, signal: str, count: int | None) -> list[int]:
        """Return the columns that the user names for y or u. Raises InputError if one lacks."""
        named = _of_signal(self.chosen, signal)
        required = [f"{signal}[{i}]" for i in range(count or len(named))] if named else []
        for key in required:
            if key not in self.chosen:
                count = len(required)
                raise InputError(f"columns: {key} is missing. Expected {count} of {signal}")
        return list(map(self.column_of_name, required))

    def group(self, signal: str, column: int, count: int | None) -> list[int]:
        """Return the columns of a signal: all that differ by an index alone, or a single column.

        Raises FileError if they are not as many as expected.

        Args:
            signal: y or u.
            column: one of them.
            count: how many there must be; None: any number.
        """
        found = [INDEXED.findall(title.name.lower())[0] for title in self.titles]
        same = [k for k, (stem, _) in enumerate(found) if stem == found[column][0]]
        same.sort(key=lambda k: int(found[k][1] or 0))
        is_vector = abs(rank_of(self.titles[column])) == EXACT
        if not is_vector or (count is None and not found[column][1]):
            same = [column]
        if count not in (None, len(same)):
            raise FileError(
                f"{self.source}: expected {count} of {signal}, the log has {len(same)}: "
                f"{_list_columns([self.titles[k] for k in same])}. Name it by "
                f'columns="{signal}[0]=NAME"'
            )
        return same

    def drive_of_servo(self, y: list[int], u: list[int]) -> list[int]:
        """Return the column of the current of a servo that follows a position; none for others."""
        kinds = self.kinds
        if [kinds[k] for k in u + y[:1]] != ["goal", "position"]:
            return []
        moves = self.moves()
        same = [k for k, kind in enumerate(kinds) if kind == "torque" and moves[k] and k not in y]
        near = self.likeness()[:, y[0]]
        return sorted(same, key=lambda k: near[k])[-1:]

    def require_name(self, signal: str) -> FileError:
        """That no name shows which column holds a signal."""
        require_table(self.source)
        hint = self.hint_near_names(USUAL[signal]) or "."
        chosen = [f"{key}={name}" for key, name in self.chosen.items()]
        columns = ",".join([*chosen, f"{signal}=NAME"]).replace("[0]", "")
        alone = ", or hand a sensor alone to watch (plant.kind)" * (len(self.titles) < 3)
        return FileError(
            f"{self.source}: no name shows which column holds {signal}. There are "
            f'{_list_columns(self.titles)}{hint} Name it by columns="{columns}"{alone}'
        )

    def find_equal_names(self, name: str) -> list[int]:
        """Return the columns of a name, of the whole name or else of its words without a unit."""
        names = [(title.name.lower(), split_words(title.name)) for title in self.titles]
        lower = split_unit(name).name.lower()
        for same in (name.lower(), lower, split_words(lower)):
            if found := [k for k, one in enumerate(names) if same in one]:
                return found
        return []

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


def _scaled(values: Floats) -> Floats:
    """Return columns (N x K) about their means with rms 1, the few values beyond the rest cut."""
    values = np.where(np.isfinite(values).any(axis=0), values, 0.0)
    x = np.nan_to_num(values - np.nanmean(values, axis=0))
    ends = np.quantile(x, USED, axis=0)
    x = np.where(np.ptp(ends, axis=0) > 0, np.clip(x, *ends), x)
    spread = x.std(axis=0)
    moves = spread > (1 - COPY) * np.nanmax(np.abs(values), axis=0)
    return np.where(moves, x, 0.0) / np.where(moves, spread, 1.0)


def _have_two_values(x: Floats) -> Flags:
    """Return which of many columns (N x K) have two values only (K)."""
    low = x == x.min(axis=0)
    high = x == x.max(axis=0)
    return np.asarray((low | high).all(axis=0) & (len(x) > 2 * PAST))


def _copies(x: Floats) -> Flags:
    """Return the pairs of columns (N x K) that differ by scale and offset alone (K x K)."""
    return np.asarray((np.abs(x.T @ x) / len(x) > COPY) | np.eye(x.shape[1], dtype=bool))


def _evenness(x: Floats, tolerance: float, rests: bool = True) -> Floats:
    """Return the share of the rows in which columns (N x K) run evenly, or rest.

    Args:
        x: columns.
        tolerance: share of the range, up to which they do.
        rests: whether a rest counts.
    """
    least = tolerance * np.ptp(x, axis=0)
    steps = np.diff(x, axis=0)
    runs = rests | (np.abs(steps[1:]) > least)
    return np.asarray(np.mean((np.abs(np.diff(steps, axis=0)) <= least) & runs, axis=0))


def _smoothness(x: Floats) -> Floats:
    """Return how well columns (row) show others as any curve of theirs (von Neumann 1941) (K x K).

    Args:
        x: columns about their means, with rms 1 (N x K).
    """
    steps = [np.diff(x[np.argsort(one, kind="stable")], axis=0) for one in x.T]
    return np.clip(1 - np.mean(np.square(steps), axis=1) / 2, 0, 1)


def _means(x: Floats, size: int) -> Floats:
    """Return columns as means over so many samples, each with rms 1."""
    count = len(x) // size
    return _scaled(x[: count * size].reshape(count, size, -1).mean(axis=1))


def _explained(x: Floats) -> tuple[Floats, Floats]:
    """Return how well columns (row) explain others: by their present and past (a correlation), and
    how much of the error of another's own forecast their past saves (Granger 1969) (K x K).

    Each half is explained by what the other half teaches. The past is that of `split_past`.

    Args:
        x: columns about their means (N x K).
    """
    count = x.shape[1]
    means = split_past(x, PAST)
    products = [half.T @ half for half in np.array_split(np.hstack(means), 2)]
    of = np.arange(count)[:, None] + count * np.arange(len(means))
    power, alone, own, both = np.zeros((4, count, count))
    for taught, asked in (products, products[::-1]):
        for j in range(count):
            power[:, j] += asked[j, j]
            alone[:, j] += _errors(taught, asked, of, j)
            pair = np.hstack([of[:, 1:], np.broadcast_to(of[j, 1:], (count, len(means) - 1))])
            both[:, j] += _errors(taught, asked, pair, j)
    own[:] = np.diagonal(both)
    share = np.clip(1 - (alone + RIDGE) / (power + RIDGE), 0, 1)
    return np.sqrt(share), np.clip(1 - (both + RIDGE) / (own + RIDGE), 0, 1)


def _errors(taught: Floats, asked: Floats, used: Integers, j: int) -> Floats:
    """Return the squared errors of a signal from others by weights of the other half (K).

    Args:
        taught, asked: products of all signals, of the half that teaches and the one that is asked.
        used: signals that explain it, for each of K choices (K x P).
        j: the signal.
    """
    squares = (used[:, :, None], used[:, None])
    inner = taught[squares] + RIDGE * (1 + np.trace(taught) / len(taught)) * np.eye(used.shape[1])
    weights = np.linalg.solve(inner, taught[used, j][..., None])[..., 0]
    spread = np.einsum("ik,ikl,il->i", weights, asked[squares], weights)
    return np.asarray(asked[j, j] - 2 * (weights * asked[used, j]).sum(axis=1) + spread)


def _seconds(title: Title, source: str) -> float | None:
    """Return the length of a unit of time [s]; None if it counts samples. Raises FileError."""
    unit = title.unit.lower()
    words = split_words(add_unit(title).name).split(" ")
    if not unit:
        named = {*words[-1:]} & {*SECONDS, *COUNTS} or {*words[:1]} & {*SECONDS}
        unit = (add_unit(title).unit or "".join(named)).lower()
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
