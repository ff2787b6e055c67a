"""A CSV log's bytes as they come in, cut into lines of text, and the dialect of these.

That is its separator, its decimal comma, its remarks, its header.
"""

from __future__ import annotations

import codecs
import csv
import io
import itertools
import math
import re
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple

from undeadzone.errors import FileError
from undeadzone.logs.kinds import Title, split_unit
from undeadzone.util.files import convert_read_errors, open_plain, require_small_archive

BLOCK: Final = 1 << 22  # bytes of a file that are read at once
LONGEST_LINE: Final = 65_536  # characters of a line; a longer one is no line of numbers
_MARKS: Final = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
REMARKS: Final = ("#", "%", "//")
MARKS: Final = "#%/ \t"  # about the text of a remark
# What stands in a cell whose number is missing; the last are errors of a sheet.
MISSING: Final = frozenset(
    (
        *("", "nan", "na", "n/a", "null", "none", "-", "--", "inf", "-inf", "+inf", "infinity"),
        *("?", "#div/0!", "#n/a", "#name?", "#null!", "#num!", "#ref!", "#value!"),
    )
)
LARGEST: Final = 1e50  # beyond this no unit makes sense
_BLANKS_BETWEEN: Final = re.compile(r"\d,\d+ +[-+]?\d")
# Groups of three digits, and what only such a number can be.
_THOUSANDS: Final = {
    ",": re.compile(r"[-+]?[1-9]\d{0,2}(?:,\d{3})+"),
    ".": re.compile(r"[-+]?[1-9]\d{0,2}(?:\.\d{3})+"),
}
_GROUPED: Final = {
    ".": re.compile(r"[-+]?[1-9]\d{0,2}(?:(?:,\d{3})+\.\d+|(?:,\d{3}){2,})"),
    ",": re.compile(r"[-+]?[1-9]\d{0,2}(?:(?:\.\d{3})+,\d+|(?:\.\d{3}){2,})"),
}
# Numbers that show the decimal mark: no group of three digits behind it, or groups ahead of it.
_TELLING: Final = {
    mark: re.compile(
        rf"(?!{_THOUSANDS[mark].pattern}$)[-+]?\d*\{mark}\d+(?:[eE][-+]?\d+)?|{grouped.pattern}"
    )
    for mark, grouped in _GROUPED.items()
}
_BLANKS: Final = re.compile(r"[ \t]+(?![ \t\[(])")  # a unit in brackets belongs to its name
_OPEN: Final = r'(?:^|[,;\t])"[^"\n]*'  # a cell in quotes that goes on in the next line
_OPENS: Final = re.compile(f"{_OPEN}$")
_BROKEN: Final = re.compile(rf'^(.*{_OPEN})\n([^"\n]*"(?=$|[,;\t]))', re.MULTILINE)
OTHER: Final = {".": ",", ",": "."}
_DOTTED: Final = re.compile(r"\d{1,2}\.\d{1,2}\.\d{2,4}\b")  # a date beside decimal commas
TELLING_MARK: Final = 5000  # lines that tell the decimal mark
PREAMBLE: Final = 60  # lines among which the header is looked for
_ESCAPED: Final = re.compile("[\udc80-\udcff]+")
_UNIT: Final = re.compile(
    r"\[.*\]|\(.*\)|[^\W\d_][^\d,;]{0,5}|[%°µ].{0,3}|"
)  # cell of a line of units


def blocks_of(path: Path, largest: int) -> Iterator[tuple[bytes, bool]]:
    """Yield the bytes of a file in blocks, each with whether it is the last. Raises FileError.

    Args:
        path: of the file.
        largest: size [bytes] beyond which it is refused.
    """
    with convert_read_errors(path), open_plain(path, largest) as file:
        if zipfile.is_zipfile(file):
            yield text_of_workbook(path, file, largest), True
            return
        file.seek(0)
        while True:
            data = file.read(BLOCK)
            yield data, not data
            if not data:
                return


def text_of_workbook(path: Path, file: BinaryIO, largest: int) -> bytes:
    """Return the first sheet of an Excel workbook as a text with tabs.

    Args:
        path: of the file, for messages.
        file: its bytes.
        largest: size [bytes] beyond which it is refused.

    Raises:
        FileError: it is another archive, or larger.
    """
    import openpyxl

    require_small_archive(file, largest)
    try:
        sheet = openpyxl.load_workbook(file, read_only=True, data_only=True).worksheets[0]
        text = io.StringIO()
        csv.writer(text, "excel-tab").writerows(sheet.iter_rows(values_only=True))
    except Exception:  # of any type for another archive
        raise FileError(f"{path}: no Excel workbook, but another archive: save it as CSV") from None
    return text.getvalue().encode()


class Text:
    """Bytes in, whole lines out: UTF-8, UTF-16 with its mark, Windows' Western European.

    Lines are the same in whatever pieces the bytes come. A line that begins is kept up to one
    character more than `LONGEST_LINE`: that says enough of it, and an endless one fills no memory.

    Args:
        source: origin of the bytes, for messages.
    """

    def __init__(self, source: str) -> None:
        self._source = source
        self._decoder: codecs.IncrementalDecoder | None = None
        self._mark = b""  # a first byte, which may begin a mark
        self._rest = ""  # a line that has begun
        self._is_text = False  # whether a line with content came

    def feed(self, data: bytes, last: bool = False) -> list[str]:
        """Return the lines that are whole now, without their ends.

        Args:
            data: the bytes that came in.
            last: whether no more will come; then the line that has begun is whole.

        Raises:
            FileError: this is no text: the first line with content is none (`flaw`).
        """
        text = self._rest + self._decode(data, last)
        if last:
            text += "\n"
        pending = "\r" if text.endswith("\r") else ""
        text = text.removesuffix("\r").replace("\r\n", "\n").replace("\r", "\n")
        *lines, rest = _BROKEN.sub(r"\n\1 \2", text).split("\n")
        if lines and not last and _OPENS.search(lines[-1]):
            rest = f"{lines.pop()}\n{rest}"
        if not self._is_text:
            self._require_text(lines, rest)
        self._rest = rest[: LONGEST_LINE + 1] + pending
        return lines

    def _require_text(self, lines: Sequence[str], rest: str) -> None:
        """Raise FileError if the first line with content is not, or does not begin as, a text."""
        for k, line in enumerate((*lines, rest)):
            if not is_content(line[: LONGEST_LINE + 1]):
                continue
            _, why = flaw(line)
            if why:
                raise FileError(f"{self._source}: not CSV text ({why})")
            self._is_text = k < len(lines)
            return

    def _decode(self, data: bytes, last: bool) -> str:
        """Return the text of the bytes that came in."""
        if self._decoder is None:
            data = self._mark + data
            if len(data) < 2 and not last:
                self._mark = data
                return ""
            is_wide = data[:2] in _MARKS
            make = codecs.getincrementaldecoder("utf-16" if is_wide else "utf-8-sig")
            self._decoder = make("replace" if is_wide else "surrogateescape")
        text = self._decoder.decode(data, last)
        return text if text.isascii() else _ESCAPED.sub(_western, text)


def _western(found: re.Match[str]) -> str:
    """Return bytes that are no UTF-8, as Windows' Western European."""
    return found[0].encode("utf-8", "surrogateescape").decode("cp1252", "replace")


def flaw(line: str) -> tuple[str, str]:
    """Return why a line cannot contain numbers, as kind and words; else empty texts.

    Args:
        line: with content.
    """
    if "\0" in line[: LONGEST_LINE + 1]:
        return "zero_bytes", "it holds bytes of 0"
    if len(line) > LONGEST_LINE:
        return "too_long", f"a line of more than {LONGEST_LINE} characters"
    return "", ""


class Dialect(NamedTuple):
    """How a CSV text is written.

    Attributes:
        separator: between two cells: `;`, a tab, a comma, or " " for any number of blanks.
        width: cells in a line.
        titles: of the columns; None without a header.
        heads: lines before the numbers: none, the names, or names and units.
        mark: the decimal mark of all its numbers; "" if it is not known.
        grouped: whether some of its numbers surely have a mark between thousands.
    """

    separator: str
    width: int
    titles: tuple[Title, ...] | None
    heads: int
    mark: str = ""
    grouped: bool = False

    def cells(self, line: str) -> list[str]:
        """Return the cells of a line, without what surrounds them; one separator may end the
        line.
        """
        cells = split_cells(line, self.separator)
        if len(cells) == self.width + 1 and not cells[-1]:
            cells.pop()
        return cells

    def parse_number(self, cell: str) -> float | None:
        """Return the number in a cell, NaN for a missing one; None for an unreadable cell."""
        return None if self.is_open(cell) else parse_cell(cell, self.mark)

    def is_open(self, cell: str) -> bool:
        """Return whether the only mark in a cell may stand before decimals or between thousands."""
        other = OTHER.get(self.mark, ",")  # where nothing tells a mark, a point is one
        return (
            not self.grouped
            and _THOUSANDS[other].fullmatch(cell) is not None
            and (_GROUPED[OTHER[other]].fullmatch(cell) is None)
        )


def is_content(line: str) -> bool:
    """Return whether a line is neither empty nor a remark."""
    stripped = line.strip()
    return bool(stripped) and not stripped.startswith(REMARKS)


def dialect_of(lines: Sequence[str]) -> Dialect:
    """Return the dialect of a text.

    Args:
        lines: its first lines with content, at least one.
    """
    separator = _separator(lines)
    first = split_cells(lines[0], separator)
    units = _units_below(lines, separator)
    is_named = any(first) and (not _count_numbers(first) or _numbers_name(lines, separator))
    if not units and not is_named:
        return Dialect(separator, len(first), None, 0)
    titles = list(map(split_unit, first))
    for k, unit in enumerate(units):
        titles[k] = Title(titles[k].name, titles[k].unit or unit.strip("[]() "))
    heads = 2 if units else 1
    if titles[-1].name == "" and not any(_first_two(lines, separator)[1][len(titles) - 1 :]):
        titles.pop()
    return Dialect(separator, len(titles), tuple(titles), heads)


def _units_below(lines: Sequence[str], separator: str) -> list[str]:
    """Return the units in the line below the first, which names their columns; [] without."""
    first, units = _first_two(lines, separator)
    is_one = any(units) and len(units) == len(first) and not _count_numbers(units)
    is_named = any(first) and _count_numbers(first) < len(first)
    return units if is_one and is_named and all(map(_UNIT.fullmatch, units)) else []


def _numbers_name(lines: Sequence[str], separator: str) -> bool:
    """Return whether a first line of words and whole numbers names columns.

    Digits begin the cells below its words.
    """
    first, below = _first_two(lines, separator)
    words = list(map(str.isalpha, first))
    above = {cell[:1].isdigit() for cell in itertools.compress(below, words)}
    return above == {True} and all(cell.isalnum() for cell in first) and len(below) == len(first)


def _first_two(lines: Sequence[str], separator: str) -> tuple[list[str], list[str]]:
    """Return the cells of the first line and of the second."""
    return split_cells(lines[0], separator), split_cells("".join(lines[1:2]), separator)


def _count_numbers(cells: Sequence[str]) -> int:
    """Return the number of cells with a number, or with a word for a missing one."""
    return sum(parse_cell(cell, "") is not None for cell in cells if cell)


def split_cells(line: str, separator: str) -> list[str]:
    """Return the cells of a line, without blanks and quotes around them."""
    if separator == " ":  # of ASCII: others stand between thousands
        return _BLANKS.split(line.strip(" \t"))
    has_pairs = '"' in line and line.count('"') % 2 == 0  # a single one is no quote
    cells = next(csv.reader([line], delimiter=separator)) if has_pairs else line.split(separator)
    return [cell.strip().strip('"').strip() for cell in cells]


def parse_cell(cell: str, mark: str) -> float | None:
    """Return the number in a cell, NaN for a missing one; None for an unreadable cell.

    Args:
        cell: its text.
        mark: the decimal mark, `.` or `,`; "" for either.
    """
    cell = cell.replace("\N{MINUS SIGN}", "-")
    if cell.lower() in MISSING:
        return math.nan
    other = OTHER.get(mark, "")
    if other and other in cell:
        is_grouped = _GROUPED[mark].fullmatch(cell) or _THOUSANDS[other].fullmatch(cell)
        if is_grouped is None:
            return None
        cell = cell.replace(other, "")
    if mark != "." and cell.count(",") == 1:
        cell = cell.replace(",", ".")
    try:
        value = float(cell)
    except ValueError:
        return None
    return None if abs(value) > LARGEST or "_" in cell else value


def decimal_mark(
    rows: Iterable[Sequence[str]], separator: str, live: bool, source: str
) -> tuple[str, bool]:
    """Return the decimal mark of all numbers of a text, "" if no line shows it, and whether
    some surely have the other mark between thousands.

    Where no number shows it, a semicolon between cells or a dotted date does: both belong to
    decimal commas.

    Args:
        rows: the cells of lines with numbers, of which the first tell it.
        separator: between two cells.
        live: whether more lines come, which cannot be waited for.
        source: the text, for messages.

    Raises:
        FileError: each comma may stand before decimals or between thousands.
    """
    cells = list(itertools.chain.from_iterable(itertools.islice(rows, TELLING_MARK)))
    counts = {mark: len([*filter(shape.fullmatch, cells)]) for mark, shape in _TELLING.items()}
    mark = "," if counts[","] > counts["."] else "."
    if counts[mark]:
        return mark, any(map(_GROUPED[mark].fullmatch, cells))
    open_one = next(filter(_THOUSANDS[","].fullmatch, cells), "")
    if open_one and (separator == ";" or any(map(_DOTTED.match, cells))):
        return ",", False
    if open_one and not live:
        whole = open_one.replace(",", "")
        decimal = open_one.replace(",", ".")
        raise FileError(
            f"{source}: it is not known whether {open_one} is {whole} or {decimal}. Write "
            "numbers with a decimal point, and nothing between thousands"
        )
    return "", False


def lines_ahead(lines: Sequence[str]) -> int | None:
    """Return the number of lines of other content ahead of the header.

    None: no line is a header so far. The header has two names or more, no number, and as many
    cells as most lines behind it.

    Args:
        lines: the first lines with content.
    """
    for k, line in enumerate(lines[:PREAMBLE]):
        separator = _separator(lines[k:])
        cells = split_cells(line, separator)
        named = list(filter(None, cells))
        count = _count_numbers(cells)
        if k == 0 and count == len(named):
            return 0
        names = (_units_below, _numbers_name) if count else ()
        is_head = not names or any(one(lines[k:], separator) for one in names)
        if len({*named}) < max(2, len(named)) or not is_head:
            continue
        rows = map(Dialect(separator, len(cells), None, 0).cells, lines[k + 1 :])
        alike = [row for row in rows if len(row) == len(cells) and _count_numbers(row)]
        if alike and 2 * len(alike) >= len(lines) - k - 1:
            return k
    return None


def prose_ahead(lines: Sequence[str]) -> int:
    """Return the number of lines of text ahead of rows of numbers without titles.

    It is 0 if the first line has as many cells as most rows of numbers, or if these are few.

    Args:
        lines: the first lines with content, of which none is a header by `lines_ahead`.
    """
    separator = _separator(lines)
    rows = [list(filter(None, split_cells(line, separator))) for line in lines]
    widths = [len(row) * (_count_numbers(row) == len(row)) for row in rows]
    usual = max(widths, key=widths.count)
    is_prose = usual and len(rows[0]) != usual and 2 * widths.count(usual) >= len(rows)
    return widths.index(usual) if is_prose else 0


def _separator(lines: Sequence[str]) -> str:
    """Return the separator: of `;`, tab, `,` the most frequent in the lines, else blanks.

    Commas in numbers with blanks between are decimal commas.
    """
    best = " "
    most = 0
    for candidate in (";", "\t", ","):
        holding = [line for line in lines if candidate in line]
        if candidate == ",":
            holding = [line for line in holding if not _BLANKS_BETWEEN.search(line)]
        if len(holding) > most:
            best = candidate
            most = len(holding)
    return best
