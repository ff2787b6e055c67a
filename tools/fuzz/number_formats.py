"""Logs whose numbers are known, as locales, spreadsheets, recorders and people write them.

A number may be read as what it is, or be missing, or the log be refused; it is never another one.
"""

from __future__ import annotations

import functools
import math
import random
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

from tools.fuzz.case import Case
from tools.fuzz.damage import bent
from undeadzone.logs.samples import LogReader, Samples, place_on_steps, samples_of_text
from undeadzone.logs.text import LARGEST
from undeadzone.logs.whole import read_whole
from undeadzone_identify.logs.grid import to_grid
from undeadzone_identify.logs.log import read_log

STEP: Final = 0.01
FILE: Final = "log.csv"
HEADS: Final = (
    ("t", "u", "y"),
    ("t [s]", "y [mm]", "u [V]"),
    ("y", "t", "u"),
    ("time", "u", "y", "note"),
    ("index", "t", "y", "u"),
)
GROUPS: Final = ("", "", "", "", ",", ".", " ", "'", "\u00a0", "\u202f", "\u2019", "_")
SEPARATORS: Final = (",", ",", ";", ";", "\t", "\t", " ", "|")
MINUS: Final = ("-", "-", "-", "-", "\u2212", "\u2013", "- ")
AROUND: Final = (*[("", "")] * 12, ('"', '"'), ("'", "'"), (" ", " "), ("+", ""), ("", " V"))
AROUND_RARELY: Final = (("$", ""), ("", "%"), ("", "k"), ("(", ")"), ("=", ""), ("0x", ""))
CODES: Final = ("utf-8", "utf-8", "utf-8", "utf-8-sig", "utf-16", "cp1252")


class Style(NamedTuple):
    """How numbers are written.

    Attributes:
        mark: the decimal mark.
        group: between thousands; empty: nothing.
        decimals: behind the mark; None: as many as it takes.
        exponent: letter and form of an exponent; empty: none.
        minus: of a negative number; "after" behind it.
        around: what stands before and behind it.
        share: of the numbers that have anything strange.
    """

    mark: str
    group: str
    decimals: int | None
    exponent: str
    minus: str
    around: tuple[str, str]
    share: float


def case(draw: random.Random) -> Case:
    """A log, read whole and live."""
    head, separator = draw.choice(HEADS), draw.choice(SEPARATORS)
    style = _style(draw, separator)
    plain = style._replace(group="", exponent="", minus="-", around=("", ""))
    times = style if draw.random() < 0.3 else plain
    # A recorder that writes times with a point, whatever the locale. If points stand between
    # thousands, 1.000 is a thousand to any reader.
    if style.group != "." and draw.random() < 0.2:
        times = plain._replace(mark=".")
    rows = _rows(draw)
    lines = [separator.join(head)]
    truth: dict[str, list[float]] = {"t": [], "y": [], "u": []}
    for k, row in enumerate(rows):
        cells = []
        for title in head:
            name = title[0]
            if name not in truth or title == "note":
                cells.append(str(k) if title == "index" else draw.choice(("ok", "x1", "good")))
                continue
            text, value = written(draw, row[name], times if name == "t" else style)
            truth[name].append(value)
            cells.append(text)
        lines.append(separator.join(cells))
    text = "\n".join(lines) + "\n"
    data = text.encode(draw.choice(CODES), "replace")
    kind = f"mark {style.mark}, between {separator!r}"
    if draw.random() < 0.3:  # nobody knows the numbers of a damaged log
        kind, data, truth = "bytes", bent(draw, data), {}
    return Case(kind, {FILE: data}, call=functools.partial(_read, truth))


def _style(draw: random.Random, separator: str) -> Style:
    """A way to write numbers, mostly one that there is.

    Left out is what nothing in a file can tell: cells that hold the separator, and points between
    the thousands of numbers without decimals, which are decimal marks to all others.
    """
    mark = draw.choice([mark for mark in ".," if mark != separator])
    group = draw.choice([group for group in GROUPS if group not in (mark, separator)])
    exponent = draw.choice(("",) * 6 + ("e", "E+", "d", "D+", "*10^"))
    around = draw.choice(AROUND if draw.random() < 0.9 else AROUND_RARELY)
    minus = draw.choice((*MINUS, "after") if draw.random() < 0.1 else MINUS)
    if separator == " ":  # a number is one cell
        minus, around = minus.strip(), (around[0].strip(), around[1].strip())
    decimals = draw.choice((None, 0, 1, 2, 3, 3, 3, 6) if group != "." else (1, 2, 3, 6))
    return Style(mark, group, decimals, exponent, minus, around, draw.choice((1.0, 1.0, 0.1)))


def _rows(draw: random.Random) -> list[dict[str, float]]:
    """Times, readings and inputs of any size."""
    size = 10.0 ** draw.choice((-3, 0, 1, 3, 3, 4, 6))
    first = draw.choice((0.0, 0.0, 1.0, 1234.5))
    rows = []
    for k in range(draw.choice((1, 3, 12, 40))):
        y = size * draw.choice((draw.uniform(-1, 1), draw.uniform(0, 2), 1.301, 0.995, 0.0))
        u = size * draw.uniform(-5, 5) if draw.random() < 0.8 else float(draw.randrange(3000))
        rows.append({"t": round(first + STEP * k, 6), "y": y, "u": u})
    return rows


def written(draw: random.Random, value: float, style: Style) -> tuple[str, float]:
    """A number in a style, and which number that is."""
    power = 0
    if style.exponent and draw.random() < style.share:
        power = math.floor(math.log10(abs(value))) if value else 0
    digits = 6 if style.decimals is None else style.decimals
    mantissa = f"{abs(value) / 10.0**power:.{digits}f}"
    whole, _, decimals = mantissa.partition(".")
    if style.decimals is None:
        decimals = decimals.rstrip("0")
    if style.group and draw.random() < style.share:
        whole = f"{int(whole):,}".replace(",", style.group)
    text = whole + (style.mark + decimals if decimals else "")
    exact = float(mantissa) * 10.0**power
    if power:
        sign = "+" if style.exponent.endswith("+") and power >= 0 else ""
        text += f"{style.exponent.rstrip('+')}{sign}{power:02d}"
    if value < 0 and exact:
        text = f"{text}-" if style.minus == "after" else style.minus + text
        exact = -exact
    before, behind = style.around if draw.random() < style.share else ("", "")
    if before == "(" and exact > 0:
        before, behind = "", ""
    if before == "(":
        text = text.lstrip("-\u2212\u2013 ").rstrip("-")
    scale = {"%": 0.01, "k": 1000.0}.get(behind, 1.0)
    if before == "0x":
        return hex(int(abs(exact))), float(int(abs(exact)))
    return f"{before}{text}{behind}", exact * scale


def _read(truth: dict[str, list[float]], folder: Path) -> None:
    """Read the log in each way in which a log is read; compare what comes of it."""
    path = folder / FILE
    refused: list[Exception] = []
    for read in (_identified, _mended, _estimated, _live):
        try:
            samples = list(read(path))
        except Exception as error:
            refused.append(error)
            continue
        for sample in samples:
            if truth:
                _compare(read.__name__, sample, truth)
    for error in refused:  # any that is no refusal is a fault
        raise error


def _identified(path: Path) -> Iterator[tuple[int, float, float, float]]:
    """What `identify` reads, ahead of the mending of times and inputs."""
    samples = read_whole(path, None, None, {}, False, 10**6).samples
    return _rows_of(samples)


def _mended(path: Path) -> Iterator[tuple[int, float, float, float]]:
    """Nothing: mended times and inputs differ from those that were written."""
    to_grid([read_log(path)])
    reader = LogReader("log", 1, 1, {})
    samples = samples_of_text(reader, path, 10**6, math.inf)
    place_on_steps(samples, bool(reader.layout and reader.layout.time), STEP, "log")
    return iter(())


def _estimated(path: Path) -> Iterator[tuple[int, float, float, float]]:
    """What `estimate` reads."""
    samples = samples_of_text(LogReader("log", 1, 1, {}), path, 10**6, math.inf)
    return _rows_of(samples)


def _live(path: Path) -> Iterator[tuple[int, float, float, float]]:
    """What `watch` reads, line by line."""
    reader = LogReader("stdin", 1, 1, {}, live=True)
    data = path.read_bytes()
    for piece in (*data.splitlines(keepends=True), b""):
        samples = reader.feed(piece, last=not piece)
        yield from _rows_of(samples)


def _rows_of(samples: Samples) -> Iterator[tuple[int, float, float, float]]:
    """Line, time, reading and input of each sample."""
    for t, y, u, line in zip(*samples, strict=True):
        yield int(line), float(t), float(y[0]), float(u[0])


def _compare(
    who: str, sample: tuple[int, float, float, float], truth: dict[str, list[float]]
) -> None:
    """Raise AssertionError for a number that is another one than was written."""
    row = sample[0] - 2  # the header is line 1
    for name, found in zip("tyu", sample[1:], strict=True):
        expected = truth[name][row]
        is_missing = not math.isfinite(found) or abs(expected) > LARGEST
        close = math.isclose(found, expected, rel_tol=1e-9, abs_tol=1e-12)
        assert is_missing or close, f"{who} {name}: {found!r} for {expected!r} in line {sample[0]}"
