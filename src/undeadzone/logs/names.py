"""Columns of a log, and which is which: by names that a user gives, else by usual ones of t, y, u.

A title holds a name and a unit, which gives the length of a unit of time.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from undeadzone.errors import FileError, InputError
from undeadzone.util.arrays import Floats

# Length of a unit of time [s]. A time that counts samples has no length of its own.
SECONDS: Final = {
    **dict.fromkeys(("", "s", "sec", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "millis", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "µs", "μs", "usec", "micros", "microseconds"), 1e-6),
    **dict.fromkeys(("ns", "nanos", "nanoseconds"), 1e-9),
    **dict.fromkeys(("min", "mins", "minute", "minutes"), 60.0),
    **dict.fromkeys(("h", "hr", "hours"), 3600.0),
}
COUNTS: Final = ("sample", "samples")
TIMES: Final = (
    *("t", "time", "times", "zeit", "temps", "tiempo", "timestamp", "seconds", "sec"),
    *("datetime", "date_time", "date time", "date/time", "clock", "uhrzeit", "heure", "hora"),
    *("date", "datum", "fecha"),
)
DATES: Final = ("date", "datum", "fecha", "day")  # beside a column of times of day
READINGS: Final = ("y", "output", "out", "reading", "measured", "measurement")
INPUTS: Final = ("u", "input", "in", "command", "control")
REFERENCES: Final = (
    *("r", "reference", "ref", "setpoint", "set_point", "set point", "sollwert", "consigne"),
    *("consigna", "target", "desired", "sp"),
)
# Names of the trades: of process control first, of physics where none of these is there. Those of
# one tuple say the same of a column, so that two of them leave it open.
OF_READINGS: Final = (
    ("pv", "process value", "process variable"),
    ("dec", "decrawdistance"),  # of a mount: the axis whose pulses change direction
    (
        *("flow", "level", "pressure", "temperature", "temp", "position", "speed", "rpm"),
        *("present position", "actual position", "measured position", "present speed"),
    ),
    (
        *("joint", "link", "load", "joint position", "joint angle", "link position", "link angle"),
        *("joint encoder", "link encoder", "load encoder", "load position", "load angle"),
    ),
    ("axis", "star", "camera", "dial", "scale"),
    (
        *("encoder", "encoder position", "encoder angle", "angle", "q", "theta"),
        *("motor encoder", "motor position", "motor angle"),  # beside a current or torque
    ),
)
GOALS: Final = ("goal", "goal position", "target position", "commanded position", "goal speed")
DRIVES: Final = ("current", "motor current", "present current", "torque", "motor torque", "effort")
OF_INPUTS: Final = (
    ("op", "co", "mv", "controller output", "output", "out"),
    ("dec pulse", "decpulse", "decguidedistance"),  # signed, as a duration is not
    ("valve", "heater", "pwm", "duty", "duty cycle", "voltage"),
    GOALS,
    ("desired", "target", "wanted"),  # where nothing else drives
    ("pulses", "pulse", "motor", "motor position", "motor angle", "motor encoder"),
    DRIVES,  # where neither a goal nor another position is
)
TEST_MACHINE: Final = ("displacement", "force")  # of two such columns the first drives
# First or last words of names that no trade has: `force_command`, `measured_angle`.
MEASURED: Final = frozenset(("reading", "measured", "measurement", "actual"))
COMMANDED: Final = frozenset(("command", "commanded", "cmd", "input"))
# A unit at the end of a name: `motor_deg`, `force_N`. Letters that often mean something else, and
# units of speed, which would make a speed of a position, are none.
_WITH_UNIT: Final = re.compile(
    r"(.*[^\W_])[_ ](N|Nm|V|A|K|(?i:deg|rad|mrad|arcsec|arcmin|mm|cm|um|inch|us|ms|ns|px|counts"
    r"|pct|percent|mv|ma|volts?|amps?|newtons?|pa|kpa|bar|psi|degc|celsius|kelvin))"
)
_TIME_WITH_UNIT: Final = re.compile(r"(?:t|time|times|timestamp|elapsed|elapsed time) (\S+)")
_NAME_WITH_UNIT: Final = re.compile(r"(?:.* )?(\S+)")
_ITSELF_A_TIME: Final = frozenset(
    unit for unit in SECONDS if unit not in ("", "s", "min", "h", "hr", "sec", "seconds")
)
INDEXED: Final = re.compile(r"^(.*?)[\[_(]?(\d+)[\])]?$")
_PRINTED_NAMES: Final = 12  # names in a message


class Title(NamedTuple):
    """Title of a column in a header: its name, its unit ("" if none)."""

    name: str
    unit: str


def split_unit(text: str) -> Title:
    """Name and unit of a header: `speed [rad/s]` or `speed (rad/s)`.

    An index is no unit: `u[0]`, `pos (1)`. `[1]` after a space is: `u[0] [1]` has no dimension.
    """
    title = text.strip().strip("\"'").strip()
    for opening, closing in (("[", "]"), ("(", ")")):
        start = title.rfind(opening)
        if start <= 0 or not title.endswith(closing):
            continue
        inside = title[start + 1 : -1].strip()
        of_no_dimension = inside == "1" and opening == "[" and title[start - 1] == " "
        if of_no_dimension or not inside.isdigit():
            return Title(title[:start].strip(), inside)
    return Title(title, "")


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
        of_the_trade: whether a name of a trade decided on a column, which the user should know.
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
    of_the_trade: bool = False

    @property
    def has_current(self) -> bool:
        """Return whether the second input is the current or torque of a servo that has a goal."""
        plain = [_plain(title.name) for title in self.input_titles]
        return len(plain) == 2 and plain[0] in GOALS and plain[1] in DRIVES

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
    titles: Sequence[Title], p: int | None, m: int | None, chosen: Mapping[str, str], source: str
) -> Layout:
    """Return the columns of the signals of a log with a header.

    Args:
        titles: of its header.
        p, m: numbers of readings and inputs that the plant has; None: as many as are named, and
            the reference if there is one.
        chosen: columns that the user names; see `parse_columns`.
        source: the log, for messages.

    Raises:
        FileError: a column is not known, or is used twice; names near it are listed.
    """
    _refuse_others(chosen, p, m)
    header = _Header(titles, chosen, source)
    time = header.find_time_column()
    readings = header.signals("y", p, READINGS)
    inputs = header.signals("u", m, INPUTS, readings)
    if m is None and not _of_signal(chosen, "u"):
        inputs = inputs + header.drive_of_servo(inputs, [*readings, time])
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
    """

    titles: Sequence[Title]
    chosen: Mapping[str, str]
    source: str

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
        y, u = ([_add_unit(self.titles[k]) for k in columns] for columns in (readings, inputs))
        for signal, titles in (("y", y), ("u", u)):
            roles.append(f"{signal} from {', '.join(repr(title.name) for title in titles)}")
        columns_text = ", ".join(roles)
        named = bool(_of_signal(self.chosen, "y"))
        known = {*READINGS, *INPUTS}
        is_trade = not named and any(
            (INDEXED.match(title.name) or [title.name] * 2)[1].lower() not in known
            for title in (*y, *u)
        )
        return Layout(time, date, readings, inputs, seconds, y, u, columns_text, None, is_trade)

    def with_reference(self, layout: Layout) -> Layout:
        """Return the layout with the reference: a column that is nothing else. Raises FileError."""
        same = [self.find_equal_names(name) for name in REFERENCES]
        tags = [_plain(title.name).endswith(" sp") for title in self.titles]
        same.append([k for k, is_tag in enumerate(tags) if is_tag])
        if "r" in self.chosen:
            same = [[self.column_of_name("r")]]
            if same[0][0] in layout.columns:
                raise self.require_distinct(same[0][0])
        for one in same:
            if len(one) == 1 and one[0] not in layout.columns:
                columns_text = f"{layout.columns_text}, r from {self.titles[one[0]].name!r}"
                return layout._replace(reference=one[0], columns_text=columns_text)
        return layout

    def require_distinct(self, column: int) -> FileError:
        """That one column would have two parts."""
        name = self.titles[column].name
        return FileError(f"{self.source}: column {name!r} would be used twice")

    def find_time_column(self) -> int | None:
        """Return the number of the column of times; None if there is none. Raises FileError."""
        if "t" in self.chosen:
            return self.column_of_name("t")
        for name in TIMES:
            same = self.find_exact_names(name)
            if len(same) > 1:
                many = f"several columns are named {name!r}"
                raise FileError(f'{self.source}: {many}; columns="t=NUMBER"')
            if same:
                return same[0]
        return next((k for k, title in enumerate(self.titles) if _is_time_with_unit(title)), None)

    def signals(
        self, signal: str, count: int | None, usual: Sequence[str], others: Sequence[int] = ()
    ) -> list[int]:
        """Return the numbers of the columns of a signal. Raises FileError.

        Args:
            signal: y or u.
            count: how many there are; None: as many as are named.
            usual: names without doubt.
            others: columns that are something else.
        """
        if signal == "y" and self.is_driven_by_output():
            usual = [name for name in usual if name not in OF_INPUTS[0]]
        if count is None:
            count = len(_of_signal(self.chosen, signal)) or self.count_columns(usual)
        required = [f"{signal}[{i}]" for i in range(count)]
        named = [key for key in required if key in self.chosen]
        if named and len(named) < count:
            missing = next(key for key in required if key not in self.chosen)
            raise InputError(f"columns: {missing} is missing. Expected {count} of {signal}")
        if named:
            return [self.column_of_name(key) for key in required]
        for name in usual:
            columns = self.usual(name, count)
            if len(columns) == count:
                return columns
            if columns:
                raise FileError(
                    f"{self.source}: expected {count} of {signal}, the log has {len(columns)}: "
                    f"{_list_columns([self.titles[k] for k in columns])}. Name it by "
                    f'columns="{required[0]}=NAME"'
                )
        if columns := self.of_the_trade(signal, count, others):
            return columns
        require_table(self.source)
        hint = self.hint_near_names(usual) or "."
        raise FileError(
            f"{self.source}: no name shows which column holds {signal}. There are "
            f"{_list_columns(self.titles)}{hint} Name it "
            f'by columns="{self.to_be_named()}"{self.example()}'
        )

    def is_driven_by_output(self) -> bool:
        """Return whether `output` is a controller's: beside a reading, and nothing else drives."""
        drives = any(self.usual(name, 1) for name in INPUTS) or _of_signal(self.chosen, "u")
        return not drives and bool(self.of_the_trade("y", 1, ()))

    def of_the_trade(self, signal: str, count: int, others: Sequence[int]) -> list[int]:
        """Return the columns that bear a name of a trade; none if they are too many or few."""
        plain = [_plain(title.name) for title in self.titles]
        for names in OF_READINGS if signal == "y" else OF_INPUTS:
            same = [k for k, name in enumerate(plain) if name in names and k not in others]
            if not same and len(names[0]) == 2:  # a tag of the plant: FIC101.PV
                same = [k for k, name in enumerate(plain) if name.split(" ")[-1] == names[0]]
            if same:
                return same if len(same) == count else []
        pair = [k for k, name in enumerate(plain) if name in TEST_MACHINE]
        if len(pair) == 2 and count == 1:
            return pair[-1:] if signal == "y" else pair[:1]
        words = MEASURED if signal == "y" else COMMANDED
        ends = [{name.split(" ")[0], name.split(" ")[-1]} for name in plain]
        same = [k for k, end in enumerate(ends) if end & words and k not in others]
        return same if len(same) == count else []

    def drive_of_servo(self, inputs: Sequence[int], others: Sequence[int | None]) -> list[int]:
        """Return the column of the current of a servo that follows a position; none for others."""
        named = [_plain(self.titles[k].name) for k in inputs]
        if len(named) != 1 or named[0] not in GOALS:
            return []
        plain = [_plain(title.name) for title in self.titles]
        same = [k for k, name in enumerate(plain) if name in DRIVES and k not in others]
        return same if len(same) == 1 else []

    def to_be_named(self) -> str:
        """Return the names that are missing for signals without a known column: y=NAME,u=NAME."""
        assignments = [f"{signal}={name}" for signal, name in self.chosen.items()]
        for signal, usual in (("y", READINGS), ("u", INPUTS)):
            named = any(self.usual(name, 1) for name in usual) or self.of_the_trade(signal, 1, ())
            if not named and not _of_signal(self.chosen, signal):
                assignments.append(f"{signal}=NAME")
        return ",".join(assignments).replace("[0]", "")

    def example(self) -> str:
        """Return an example of columns, if names have brackets, which a shell wants quoted."""
        indexed = [title.name for title in self.titles if title.name.endswith("]")]
        if len(indexed) < 2:
            return ""
        return f', as in columns="y={indexed[0]},u={indexed[1]}"'

    def count_columns(self, usual: Sequence[str]) -> int:
        """How many columns a signal seems to have: those with an index, else one."""
        for name in usual:
            if self.find_equal_names(name):
                return 1
            if indexed := self.usual(name, 1):
                return len(indexed)
        return 1

    def usual(self, name: str, count: int) -> list[int]:
        """Return the columns of a usual name, by their places in the file.

        They are those of the name itself if there are enough, else those with an index in its
        order (`y[0]`, `y[1]`), else again those of the name; empty if there are none.

        Args:
            name: of the signal, in small letters.
            count: channels of the signal.
        """
        same = self.find_equal_names(name)
        if same and (count == 1 or len(same) > 1):
            return same
        indexed = []
        for k, title in enumerate(self.titles):
            match = INDEXED.match(title.name.lower())
            if match and match[1] == name:
                indexed.append((int(match[2]), k))
        return [k for _, k in sorted(indexed)] or same

    def find_exact_names(self, name: str) -> list[int]:
        """Return the columns of that name, be they written large or small."""
        return [k for k, title in enumerate(self.titles) if title.name.lower() == name.lower()]

    def find_equal_names(self, name: str) -> list[int]:
        """Return the columns of that name; if there is none, those of that name with a unit."""
        with_unit = (k for k, title in enumerate(self.titles) if _plain(title.name) == name.lower())
        return self.find_exact_names(name) or list(with_unit)

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


def has_time(titles: Sequence[Title]) -> bool:
    """Return whether a name is that of a column of times.

    Args:
        titles: of the columns.
    """
    return any(title.name.lower() in TIMES or _is_time_with_unit(title) for title in titles)


def _add_unit(title: Title) -> Title:
    """Return a title with the unit at the end of its name, unless it has another."""
    found = _WITH_UNIT.fullmatch(title.name)
    return Title(title.name, found[2]) if found and not title.unit else title


def _plain(name: str) -> str:
    """Return the words of a name without a unit at their end."""
    found = _WITH_UNIT.fullmatch(name)
    return _split_words(found[1] if found else name)


def _split_words(name: str) -> str:
    """Return a name in small letters, with blanks between its words."""
    apart = re.sub(r"([a-z])(Ms|Us|Ns)$", r"\1 \2", name)
    return " ".join(re.sub(r"[_.\-/\s]+", " ", apart).lower().split())


def _is_time_with_unit(title: Title) -> bool:
    """Return whether a name contains a time and its unit: `t_ms`, `millis`."""
    name = _split_words(title.name)
    found = _TIME_WITH_UNIT.fullmatch(name)
    return name in _ITSELF_A_TIME or (found is not None and found[1] in SECONDS)


def _seconds(title: Title, source: str) -> float | None:
    """Return the length of a unit of time [s]; None if it counts samples. Raises FileError."""
    unit = title.unit.lower()
    found = _NAME_WITH_UNIT.fullmatch(_split_words(title.name))
    if not unit and found is not None and found[1] in SECONDS:
        unit = found[1]
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
