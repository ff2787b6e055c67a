"""Self-contained HTML page of sections, tables and figures.

Plain strings are escaped, and a page fetches nothing.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from html import escape
from itertools import starmap
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from undeadzone import __version__
from undeadzone.report.style import write_figure
from undeadzone.util.files import read_table, write_text
from undeadzone.util.shown import Block
from undeadzone.util.text import escape_controls

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LONG: Final = 40  # characters of an interval at most
MOST: Final = 6  # lines of the table that a page begins with
NARROW: Final = 4  # columns of a table beside which a picture may stand
_HAT: Final = "\u0302"
_TILDE: Final = "\u0303"
_ERRORS: Final = re.compile(r"\b([xyzd])~")
_ESTIMATES: Final = re.compile(r"\b([xyzdwu])\^(?![\d(])")
_EDGES: Final = re.compile(r"\b([bcd])_([rl])(\^?)(?!\w)")


class Html(NamedTuple):
    """Piece of finished HTML. A value of a different type is text, and escaped at its use."""

    text: str


def format_html(value: Any) -> str:
    """Return the HTML of a value.

    An `Html` stays as it is, numbers have four digits, None is a dash, a list has a line for each
    entry, the rest is escaped text with `symbols`.
    """
    if isinstance(value, Html):
        return value.text
    if value is None:
        return "&ndash;"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return escape(f"{value:.4g}")
    if isinstance(value, list):
        return "<br>".join(map(format_html, value))
    return typeset_symbols(escape_html(str(value)))


def escape_html(text: str) -> str:
    """Return a text of several lines as escaped HTML."""
    return escape("\n".join(map(escape_controls, text.split("\n"))))


def typeset_symbols(text: str) -> str:
    """Return letters as in the figures: z^, x~, d_r, c_l^ with hats, tildes and indices."""
    text = _ESTIMATES.sub(rf"\1{_HAT}", text)
    text = _ERRORS.sub(rf"\1{_TILDE}", text)
    return _EDGES.sub(_typeset_edge, text)


def _typeset_edge(found: re.Match[str]) -> str:
    """Return the letter of an edge, or of its estimate."""
    hat = _HAT if found[3] else ""
    return f"{found[1]}{hat}<sub>{found[2]}</sub>"


def join_html(parts: Iterable[Any]) -> Html:
    """Return pieces joined by line ends."""
    return Html("\n".join(map(format_html, parts)))


def build_tag(name: str, content: Any, style: str = "") -> Html:
    """Return an element, with a class of the page's style sheet."""
    attribute = f' class="{escape(style)}"' if style else ""
    return Html(f"<{name}{attribute}>{format_html(content)}</{name}>")


def build_paragraph(text: Any, style: str = "") -> Html:
    """Return a paragraph."""
    return build_tag("p", text, style)


def build_section(title: str, *parts: Any) -> Html:
    """Return a heading, linked from the table of contents, and its contents.

    If the page is wide enough, a picture stands beside a narrow table. Without contents there is no
    section.
    """
    if not parts:
        return Html("")
    heading = Html(f'<h2 id="{_section_anchor(title)}">{format_html(title)}</h2>')
    return join_html([heading, build_tag("div", join_html(parts), "parts")])


def _section_anchor(title: str) -> str:
    """Return the address of a section within its page."""
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")


def fold_section(title: str, *parts: Any) -> Html:
    """Return a part that opens on a click."""
    return build_tag("details", join_html([build_tag("summary", title), *parts]))


def build_table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> Html:
    """Return a table. Columns of numbers are set right, a single long line is set upright.

    Args:
        head: the columns' names
        rows: a value for each column, see `html` (an empty row is left out)
    """
    cells = [row for row in rows if row[1:] != (None,) * (len(row) - 1) or len(row) == 1]
    if len(cells) == 1 and len(head) > NARROW:
        head, cells = ("what", "value"), list(zip(head, cells[0], strict=True))
    numeric = [all(map(_is_number_cell, column)) for column in zip(*cells, strict=True)]
    names = build_tag("tr", join_html(build_tag("th", name) for name in head))
    body = join_html(_table_row(row, numeric) for row in cells)
    inner = f"<thead>{names.text}</thead><tbody>{body.text}</tbody>"
    narrow = " narrow" * (len(head) <= NARROW)
    return Html(f'<div class="wide{narrow}"><table>{inner}</table></div>')


def answer_tables(*results: Sequence[Block]) -> list[Html]:
    """Return what a command prints as tables, the lines that a page begins with first.

    Args:
        results: blocks of a result, the first of them pairs, and of those to be compared with it.
    """
    columns: list[Any] = [blocks[0] for blocks in results]
    others: list[Any] = [*results[0][1:]]
    head = ("what", "value", *["compared with"] * (len(columns) - 1))
    rows = [(name, *(column.get(name) for column in columns)) for name in columns[0]]
    parts = [build_table(head, part) for part in filter(None, (rows[:MOST], rows[MOST:]))]
    for block in others:
        is_text = isinstance(block, str)
        parts.append(build_paragraph(block) if is_text else build_table(block[0], block[1:]))
    return parts


def fold_numbers(summary: Mapping[str, Any]) -> Html:
    """Return every number of a result's summary by its name in JSON; they show on a click."""
    return fold_section("All numbers", build_table(("name", "value"), _name_numbers("", summary)))


def _name_numbers(name: str, value: Any) -> list[tuple[str, Any]]:
    """Return the numbers in a value, each with its dotted name."""
    if isinstance(value, Mapping):
        entries = {f"{name}.{key}": each for key, each in value.items()}
    elif isinstance(value, list | tuple):
        entries = {f"{name}[{k}]": each for k, each in enumerate(value)}
    else:
        return [(name.removeprefix("."), value)]
    named: list[tuple[str, Any]] = []
    for entry in entries.items():
        named += _name_numbers(*entry)
    return named


def verdict_line(*parts: tuple[str, str]) -> Html:
    """Return a line of words, each with a class of the page's style sheet."""
    spans = [build_tag("span", words, style).text for words, style in parts]
    return Html("<p>" + "; ".join(spans) + ".</p>")


def choose_verdict(good: bool, yes: str = "yes", no: str = "no") -> tuple[str, str]:
    """Return the words for a good or a bad result, and their class."""
    return (yes, "yes") if good else (no, "no")


def widths_verdict(all_of_them: bool) -> tuple[str, str]:
    """Return whether every width is identifiable, for a verdict."""
    return choose_verdict(all_of_them, "every width can be known", "not every width can be known")


def _table_row(cells: Sequence[Any], numeric: Sequence[bool]) -> Html:
    """Return a row of a table (numeric: flags of the columns with numbers alone)."""
    styles = list(starmap(_cell_style, zip(cells, numeric, strict=True)))
    parts = [build_tag("td", cell, style) for cell, style in zip(cells, styles, strict=True)]
    return build_tag("tr", join_html(parts))


def _cell_style(cell: Any, numeric: bool) -> str:
    """Return the class of a cell: of a column of numbers, of words that stay in one line, or
    none.
    """
    if numeric:
        return "number"
    interval = isinstance(cell, str) and len(cell) < LONG and re.search(r"\]$| to \S+\)$", cell)
    return "whole" if interval else ""


def _is_number_cell(cell: Any) -> bool:
    """Return whether a cell may stand in a column of numbers."""
    return cell is None or (isinstance(cell, int | float) and not isinstance(cell, bool))


def source_html(text: str) -> Html:
    """Return a verbatim text, such as a scenario, as escaped HTML."""
    return Html(f"<pre>{escape_html(text)}</pre>")


def encode_picture(image: bytes, caption: str) -> Html:
    """Return an SVG image, embedded, with its caption.

    If the page is narrower than three quarters of it, it is scrolled: its words stay legible.
    """
    width = re.search(rb'<svg[^>]* width="([\d.]+)pt"', image)
    assert width is not None
    least = round(float(width[1]))  # as many px as the image has pt: at three quarters
    data = base64.b64encode(image).decode("ascii")
    img = (
        f'<img alt="{escape(escape_controls(caption))}" src="data:image/svg+xml;base64,{data}" '
        f'style="min-width:{least}px;max-width:{round(least / 0.75)}px">'
    )
    content = f'<div class="wide">{img}</div>{build_tag("figcaption", caption).text}'
    return Html(f'<figure style="flex-basis:{least}px">{content}</figure>')


class Origin(NamedTuple):
    """Origin of a result: the data to compute it again.

    Attributes:
        command: that was given (empty if there was none).
        scenario: its text, as given (empty if there is none).
        seed: of every random number (None: there is none, or several).
    """

    command: str = ""
    scenario: str = ""
    seed: int | None = None


def build_page(title: str, *parts: Any, origin: Origin | None = None) -> str:
    """Return a whole document that needs no further files.

    It begins with its contents, and ends with how to get the same again and with its symbols.

    Args:
        title: of the page.
        parts: pieces of HTML or text, most of them a `section`.
        origin: data to compute the same again (None: unknown).
    """
    head = (
        '<meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape_html(title)}</title><style>\n{_style_sheet()}</style>"
    )
    again = [] if origin is None else [_reproduction_section(origin)]
    below = join_html([*parts, *again, _LEGEND])
    body = join_html(
        [
            build_tag("h1", title),
            _table_of_contents(below),
            below,
            build_paragraph(_WRITTEN, "note"),
        ]
    )
    return (
        f'<!doctype html>\n<html lang="en"><head>{head}</head>\n'
        f"<body>\n{body.text}\n</body></html>\n"
    )


def _style_sheet() -> str:
    """Return the style sheet of a page."""
    return (Path(__file__).parent / "page.css").read_text(encoding="utf-8")


def _table_of_contents(below: Html) -> Html:
    """Return links to the sections."""
    found = re.findall(r'<h2 id="([^"]+)">(.*?)</h2>', below.text)
    links = [f'<a href="#{anchor}">{words}</a>' for anchor, words in found]
    return Html(f"<nav>{' '.join(links)}</nav>")


def _reproduction_section(origin: Origin) -> Html:
    """Return the section on computing the same result again."""
    rows: list[tuple[str, Any]] = []
    if origin.command:
        rows.append(("command", Html(f"<code>{escape_html(origin.command)}</code>")))
    rows.append(("undeadzone", __version__))
    if origin.seed is not None:
        rows.append(("seed", str(origin.seed)))
    parts = [build_table(("what", "value"), rows)]
    if origin.scenario:
        parts.append(fold_section("The scenario", source_html(origin.scenario)))
    return build_section("The same again", *parts)


_WRITTEN: Final = f"Written by undeadzone {__version__}."
_LEGEND: Final = build_section(
    "Symbols",
    build_table(("symbol", "meaning"), read_table(__file__)["symbols"]),
    build_paragraph("In figures: grey the dead zone, pale the truth.", "note"),
)


def write_page(
    drawn: Mapping[str, Figure], folder: Path, text: Callable[[dict[str, bytes]], str]
) -> list[Path]:
    """Write figures as SVG and a page that shows them, report.html, and return their paths.

    Raises FileError.

    Args:
        drawn: figures by name.
        folder: folder of the files (created if needed).
        text: text(images) is the page, images the SVGs by name.
    """
    files = {name: write_figure(figure, folder / f"{name}.svg") for name, figure in drawn.items()}
    images = {name: path.read_bytes() for name, path in files.items()}
    return [*files.values(), write_text(text(images), folder / "report.html")]


def encode_pictures(images: Mapping[str, bytes], captions: Mapping[str, str]) -> dict[str, Html]:
    """Return figures (SVG) by name, each with its caption."""
    return {name: encode_picture(image, captions[name]) for name, image in images.items()}


def pick_pictures(pictures: Mapping[str, Html], *names: str) -> list[Html]:
    """Return the existing pictures of these names."""
    return [pictures[name] for name in names if name in pictures]
