"""Kinds and ranks of columns, by the words and the units of their names, in a single table.

A name opens candidates: `names` compares them by what their columns do.
"""

from __future__ import annotations

import re
from typing import Final, NamedTuple

import numpy as np

from undeadzone.util.arrays import Floats

# Length of a unit of time [s]. A time that counts samples has no length of its own.
SECONDS: Final = {
    **dict.fromkeys(("", "s", "sec", "secs", "second", "seconds", "sekunden", "secondes"), 1.0),
    **dict.fromkeys(("ms", "msec", "millis", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "µs", "μs", "usec", "micros", "microseconds"), 1e-6),
    **dict.fromkeys(("ns", "nsec", "nanos", "nanoseconds"), 1e-9),
    **dict.fromkeys(("min", "mins", "minute", "minutes"), 60.0),
    **dict.fromkeys(("h", "hr", "hours"), 3600.0),
}
OF_TIME: Final = ("s", "sec", "second", "seconds")  # units that show a time by themselves
COUNTS: Final = ("sample", "samples", "step", "steps", "index", "row", "frame")
# Names of times, best first: alone, with a unit, and with words that say of what.
_TIMES: Final = tuple(
    map(
        re.compile,
        (
            r"^t$",
            r"^(times?|zeit|temps|tiempo|tempo)$",
            r"^((zeit)?stempel|time ?stamp|date ?time|clock|uhrzeit|heure|hora|elapsed( time)?)$",
            r"^(date|datum|fecha|secs?|seconds|[mun]s|[mu]sec|(milli|micro|nano)(s|seconds)|minutes)$",
            r"^(t|times?|timestamp|zeit|elapsed|elapsed time) "
            r"([mun]?s|[mu]?secs?|seconds|min(ute)?s?|h|hours)$",
            r"^(time|timestamp|stamp|zeit|temps|tiempo|tempo|elapsed)\b|\b(time|timestamp|stamp|zeit)$",
        ),
    )
)
VAGUE: Final = len(_TIMES) - 1  # rank from which a time must run as times do
# A unit at the end of a name: `motor_deg`, `force_N`. Letters that often mean something else are
# none.
_WITH_UNIT: Final = re.compile(
    r"(.*[^\W_])[_ ](N|Nm|V|A|K|W|(?i:deg|rad|mrad|arcsec|arcmin|mm|cm|um|inch|us|ms|ns|px|counts"
    r"|pct|percent|mv|ma|volts?|amps?|newtons?|pa|kpa|bar|psi|degc|celsius|kelvin|kg|rpm|lpm))"
)
_WORDS: Final = re.compile(r"[A-Z]+(?![a-zµμß-ÿ])|[A-ZÀ-Þ]?[^\W\d_A-Z]+|[A-Z]+|\d+|[°%]")

TABLE: Final = 160  # rows that someone has written down, at most
EXACT: Final = 20.0  # rank of names without doubt
REFERENCE: Final = 10.0  # rank of what a loop follows, which drives no plant by itself
# Rows of a pattern, the kind that it shows ("" if it shows none) and a rank: the largest drives,
# the least is read. The first row that fits a name decides.
_TABLE: Final = tuple(
    (re.compile(pattern), kind, rank)
    for pattern, kind, rank in (
        (r"^(u|input|in|control|eingang|entrée|entrada|ingresso)( \d+)?$", "", EXACT),
        (r"^(y|output|out|ausgang|sortie|salida|sa[ií]da|uscita)( \d+)?$", "", -EXACT),
        (
            r"^(op|co|mv|controller output|stellgr(ö|oe)(ß|ss)e)$|\w op$|\bpid\b.*\bout\b",
            "op",
            EXACT,
        ),
        (r"\bpv\b|^process (value|variable)$|^regelgr(ö|oe)(ß|ss)e$", "pv", -EXACT),
        (r"^u \w+$", "", 17.0),
        (r"^y \w+$", "", -17.0),
        (r"^(command|cmd)$", "goal", 18.0),
        (r"^(reading|measured|measurement|istwert|mesure)$", "", -18.0),
        (
            r"\bbatt|\bvbat|supply|counter\b|star mass\b|\bcalculated\b|\bsnr\b|delta|\bdt\b"
            r"|^stat(e|us) \d|moving|\bpin\b|\bbus\b|\bvcc\b|\berror?\b|\bwanted time\b|\bindex\b"
            r"|^(integral|derivative|proportional)$"
            r"|\bid\b|^(n|no|nr|samples?|trial|test|run|point|row|measurement|record"
            r"|prueba|ensayo|essai|versuch|messung)"
            r"( (no|nr|number))?$",
            "aside",
            0.0,
        ),
        (r"\bsp\b|^sv$", "sp", REFERENCE),
        (
            r"^(r|ref|reference|set ?point|sollwert|consigne|consigna|referencia|riferimento"
            r"|führungsgr(ö|oe)(ß|ss)e)$",
            "goal",
            REFERENCE,
        ),
        (r"\bdec ?(guide|pulse)|\bcontrol (signal|output|effort|value)\b|\bctrl\b", "drive", 16.5),
        (r"\b(measured|actual|real) volt|\bvolt\w* (measured|actual|real)\b", "drive", -4.0),
        (r"\bout(put)? volt", "drive", 0.0),  # of a driver, or of a sensor
        (r"\b(angle|steer\w*|yaw|pitch|roll|turn) rate\b", "speed", -8.0),
        (r"^(esc|servo)( signal)?( \d+)?$|^(m|motor|left|right|drive|set) power$", "drive", 15.0),
        (
            r"\b(motor|control|pwm|volt\w*|torque|force|valve|duty|throttle) (command|cmd)\b",
            "drive",
            16.0,
        ),
        (
            r"\b(goal|target\w*|desired|set ?point|ref(erence)?|wanted|demand(ed)?|command(ed)?|cmd"
            r"|set|sp|actions?|des|requested|ziel)\b|\bsoll|consigne|consigna|vorgabe",
            "goal",
            12.0,
        ),
        (
            r"torque|\btau|\bcurrent\b(?! (pos|angle|speed|vel|temp|val))|effort|moment\b|strom\b"
            r"|courant|couple\b|\bamps?\b|ampere|\biq\b|\bq axis\b",
            "torque",
            8.0,
        ),
        (
            r"measured|\bactual\b|\bpresent\b|sensor|infrared|ultrasonic|sonar\b|\bcell\b|\badc|feedback|\bfb\b|reading|\bhx\b|response|\bist\b"
            r"|\braw\b(?! d)|\bcode\b|\bацп\b|observ|mesur|gemessen",
            "",
            -12.0,
        ),
        (r"\bpulses$", "position", -8.0),  # that an encoder counts
        (
            r"pwm|^input signal\b|steer|volt|spannung|tension|duty|throttle|joystick|pulse"
            r"|guide distance|valve|ventil|vanne|heater|heiz|chauff|pump|\bfan\b|\bdac\b|stick\b"
            r"|drive\b",
            "drive",
            14.0,
        ),
        (r"^q( \d+)?$", "position", 0.0),  # a joint's coordinate, or a flow that is set
        (r"^[flpt]c?v \d", "op", 14.0),  # tags of ISA-5.1: valves, and transmitters
        (r"^[flpt]i?t \d", "pv", -12.0),
        (r"^t \d+$", "", -8.0),  # temperatures
        (r"^dec( raw|$)", "position", -9.0),
        (r"^ra( raw|$)", "position", -8.5),
        (
            r"speed|veloc|\bvel\b|\be?rpm\b|drehzahl|geschw|vitesse|omega|\bd ?d?q\b|\bqd\b|gyro|"
            r"tach|\bupm\b|\[(k?rpm|upm|[^]]*/s)\]",
            "speed",
            -8.1,
        ),
        (
            r"accel|beschl|thrust|flow|level|pressure|\bpres\b|\btemp|durchfl|druck|stand\b|niveau|débit|pression|"
            r"volume|weight|gewicht|poids",
            "",
            -8.0,
        ),
        (r"displac|\bhub\b|\bweg\b|course|plunger", "position", 6.0),
        (
            r"load (pos|ang|enc)\w*|joint|\blink|\baxis|\bstar\b|camera|\bdial|\bscale\b|wheel",
            "position",
            -10.0,
        ),
        (
            r"force|kraft|\bload\b|last\b|newton|applied|stimulus",
            "force",
            4.0,
        ),
        (r"\bconc\b|concentration|\bpp[mb]\b", "", REFERENCE),
        (r"\bmot(or)?\b|\btheta m\b", "position", 6.0),
        (
            r"\bpos|position|angle|winkel|encoder|\benc\b|theta|\bphi\b|distance|height|"
            r"tilt|lage\b|stellung|auslenk|pitch|roll\b|yaw|ticks|^obs\w* state|"
            r"\[(deg|rad|mrad|°|mm|cm|m|in|um|µm|px|ticks|counts|arcsec|arcmin)\]",
            "position",
            -8.0,
        ),
        (r"\[(m?a|nm)\]", "torque", 8.0),
        (r"\[(k?n|kip|lbf?|kg)\]", "force", 4.0),
        (r"\[([um]?v|volts?|%|pct|percent)\]", "drive", 5.0),
    )
)


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


def add_unit(title: Title) -> Title:
    """Return a title with the unit at the end of its name, unless it has a unit already."""
    found = _WITH_UNIT.fullmatch(title.name)
    return Title(title.name, found[2]) if found and not title.unit else title


def split_words(name: str) -> str:
    """Return a name in small letters, with blanks between its words and no unit at their end."""
    found = _WITH_UNIT.fullmatch(name)
    return " ".join(_WORDS.findall(found[1] if found else name)).lower()


def kind_of(name: str, unit: str = "") -> str:
    """Return the kind of quantity in a column, of the kinds in the table, or "other".

    The kinds are goal, position, speed, torque, drive, op, pv, sp, force, and aside of what is
    recorded beside input and reading.

    Args:
        name: of the column.
        unit: of the column; "" or "1" if it has none.
    """
    rows = _rows_of(Title(name, unit))
    return next((kind for _, kind, _ in rows if kind), "other")


def rank_of(title: Title) -> float:
    """Return how likely a column drives (> 0) or is read (< 0) by its name; 0: nothing is known."""
    return next((rank for _, _, rank in _rows_of(title)), 0.0)


def _rows_of(title: Title) -> list[tuple[re.Pattern[str], str, float]]:
    """Return the rows of the table that fit a title."""
    title = add_unit(title)
    words = split_words(title.name)
    texts = (words, f"{words} [{title.unit.lower()}]")
    return [row for row in _TABLE if any(map(row[0].search, texts))]


def time_rank(title: Title) -> int:
    """Return the rank of a name among the names of times, 0 the best; -1 for any other name."""
    words = " ".join(_WORDS.findall(title.name)).lower()
    by_unit = len(_TIMES) if title.unit.lower() in OF_TIME else -1
    return next((k for k, name in enumerate(_TIMES) if name.search(words)), by_unit)


def increases_evenly(values: Floats) -> bool:
    """Return whether values increase from 0 or later by about equal steps, as times and indices do.

    So do those of a log with the newest first.

    Args:
        values: of a column (N).
    """
    values = values[np.isfinite(values)]
    between = np.diff(values)
    between *= np.sign(between.sum())
    is_rising = between.size > 1 and values.min() >= 0 and np.mean(between > 0) > 0.98
    return bool(
        is_rising and np.quantile(between, 0.9, method="higher") <= 1.5 * np.median(between)
    )


def is_regular_time(values: Floats) -> bool:
    """Return whether values increase regularly, and do not just count from 0 or 1.

    Args:
        values: of a column (N).
    """
    return increases_evenly(values) and not counts_rows(values)


def counts_rows(values: Floats) -> bool:
    """Return whether values are the numbers of their rows, from 0 or 1 on.

    Args:
        values: of a column (N).
    """
    return bool((np.diff(values) == 1).all()) and values[0] in (0, 1)
