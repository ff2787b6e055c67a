"""One self-contained HTML page of sections, tables and figures.

Plain strings are escaped, and a page fetches nothing.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from undeadzone import __version__
from undeadzone.report.style import png
from undeadzone.simulation.listening_words import in_words
from undeadzone.simulation.run import Run
from undeadzone.support.text import printable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_CSS: Final = """
:root { color-scheme: light dark; --text: #1d2129; --soft: #5c6370; --paper: #fdfdfc; \
--line: #dfe2e7; --head: #f1f3f5; --link: #0072b2;
        --yes: #00704f; --mid: #8a5a00; --no: #b03a00; }
@media (prefers-color-scheme: dark) { :root { --text: #e4e6ea; --soft: #a0a7b4; --paper: #15181d; \
--line: #343a43; --head: #20252c; --link: #6cb8e6;
        --yes: #4fc79b; --mid: #e6b450; --no: #ff8a57; } }
body { margin: 2.5rem auto; max-width: 72rem; padding: 0 1.2rem; background: var(--paper); \
color: var(--text);
       font: 16px/1.55 system-ui, sans-serif; }
h1 { font-size: 1.7rem; line-height: 1.25; margin-bottom: .3rem; } \
h2 { font-size: 1.25rem; margin-top: 2.6rem; border-bottom: 1px solid var(--line); }
p { max-width: 52rem; } .note { color: var(--soft); font-size: .9rem; } a { color: var(--link); }
.wide { overflow-x: auto; } \
table { border-collapse: collapse; font-size: .88rem; margin: 1rem 0; }
th, td { text-align: left; vertical-align: top; padding: .35rem .7rem; \
border-bottom: 1px solid var(--line); } th { background: var(--head); }
td.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
.yes { color: var(--yes); font-weight: 600; } .mid { color: var(--mid); font-weight: 600; } \
.no { color: var(--no); font-weight: 600; }
figure { margin: 1.2rem 0; } \
img { max-width: 100%; background: #fff; border: 1px solid var(--line); border-radius: 6px; }
figcaption { color: var(--soft); font-size: .9rem; max-width: 52rem; } \
details { margin: 1rem 0; } summary { cursor: pointer; }
"""  # a line that ends in a backslash goes on in the next


class Html(NamedTuple):
    """A piece of finished HTML; any other value is text, and escaped where it is used."""

    text: str


def html(value: Any) -> str:
    """The HTML of a value.

    An `Html` stays as it is, numbers have five digits, None is a dash, the rest is escaped text.
    """
    if isinstance(value, Html):
        return value.text
    if value is None:
        return "&ndash;"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return escape(f"{value:.5g}")
    return escape("\n".join(map(printable, str(value).split("\n"))))


def join(parts: Iterable[Any]) -> Html:
    """Pieces one after another."""
    return Html("\n".join(map(html, parts)))


def tag(name: str, content: Any, style: str = "") -> Html:
    """One element, with a class of the page's style sheet."""
    attribute = f' class="{escape(style)}"' if style else ""
    return Html(f"<{name}{attribute}>{html(content)}</{name}>")


def paragraph(text: Any, style: str = "") -> Html:
    """A paragraph."""
    return tag("p", text, style)


def section(title: str, *parts: Any) -> Html:
    """A heading and what stands under it."""
    return join([tag("h2", title), *parts])


def folded(title: str, *parts: Any) -> Html:
    """A part that opens on a click."""
    return tag("details", join([tag("summary", title), *parts]))


def table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> Html:
    """A table; numbers are set right.

    Args:
        head: the columns' names
        rows: a value for each column; see `html`
    """
    names = tag("tr", join(tag("th", name) for name in head))
    body = join(_row(row) for row in rows)
    inner = f"<thead>{names.text}</thead><tbody>{body.text}</tbody>"
    return Html(f'<div class="wide"><table>{inner}</table></div>')


def _row(cells: Sequence[Any]) -> Html:
    """A row of a table."""
    return tag("tr", join(tag("td", cell, _cell_style(cell)) for cell in cells))


def _cell_style(cell: Any) -> str:
    """The class of a cell: that of numbers, or none."""
    is_number = isinstance(cell, int | float) and not isinstance(cell, bool)
    return "number" if is_number else ""


def picture(image: bytes, caption: str) -> Html:
    """A PNG image, embedded, with its caption."""
    data = base64.b64encode(image).decode("ascii")
    img = f'<img alt="{html(caption)}" src="data:image/png;base64,{data}">'
    return Html(f"<figure>{img}{tag('figcaption', caption).text}</figure>")


def page(title: str, *parts: Any) -> str:
    """A whole document that needs nothing but itself."""
    head = (
        '<meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{html(title)}</title><style>{_CSS}</style>"
    )
    origin = paragraph(f"Written by undeadzone {__version__}.", "note")
    body = join([tag("h1", title), *parts, origin])
    return (
        f'<!doctype html>\n<html lang="en"><head>{head}</head>\n'
        f"<body>\n{body.text}\n</body></html>\n"
    )


_OVERVIEW: Final = (
    "Output, reading and estimate; errors; widths against the truth; "
    "the Lyapunov function where there is one."
)


def run_page(
    run: Run, figures: Sequence[Figure], rival: Run | None = None, first: Sequence[Any] = ()
) -> str:
    """The page of one run.

    It shows what comes first, the run's figures, its numbers, and what its readings can tell.

    Args:
        run: what is shown
        figures: of the run; see `figures.overview`
        rival: a run beside whose numbers those of the run stand
        first: pieces of HTML above the figures
    """
    reasons: list[str] = []
    for verdict in run.info.identifiable:
        reasons += verdict["reasons"]
    return page(
        run.info.title,
        *first,
        *(picture(png(figure), _OVERVIEW) for figure in figures),
        section("Numbers", _numbers_table(run, rival)),
        section(
            "Widths, and what these readings can tell of them",
            _widths_table(run),
            *map(paragraph, reasons),
        ),
    )


def _numbers_table(run: Run, rival: Run | None) -> Html:
    """The numbers of a run, beside those of a rival if there is one."""
    columns = [_numbers(run)]
    if rival is not None:
        columns.append(_numbers(rival))
    head = ("what", "value", "compared with")[: 1 + len(columns)]
    return table(head, [(name, *(column[name] for column in columns)) for name in columns[0]])


def _widths_table(run: Run) -> Html:
    """The estimated and the true widths of each output, and which of them readings can tell."""
    unit = run.info.units.output
    rows = []
    verdicts = zip(run.outputs, run.widths, run.info.identifiable, strict=True)
    for i, (name, (right, left), verdict) in enumerate(verdicts):
        true_right, true_left = run.info.widths[2 * i : 2 * i + 2]
        known = [verdict[key] for key in ("right", "left", "width", "centre")]
        rows.append((name, float(right), true_right, float(left), true_left, *known))
    estimates = (f"d_r^ [{unit}]", "true", f"d_l^ [{unit}]", "true")
    knowledge = ("right known", "left", "d_r + d_l", "d_r − d_l")
    return table(("output", *estimates, *knowledge), rows)


def _numbers(run: Run) -> dict[str, Any]:
    """The numbers of a run, in words."""
    unit = run.info.units.output
    numbers: dict[str, Any] = {
        "observer": run.name,
        "time": f"{run.info.time}, step {run.info.step:g} s, {run.t[-1]:g} s",
        "diverged at [s]": run.diverged_at,
        f"rms of z − r, last 2 s [{unit}]": run.rms_tracking,
        f"rms of z − z^, last 2 s [{unit}]": run.rms_estimation,
    }
    if run.rms_tip is not None:
        numbers["rms distance of the tip from its path, last 2 s [m]"] = run.rms_tip
    return numbers | {
        "share of silent samples": run.silent_fraction,
        "how strongly readings move z^": in_words(run.info.listens) if run.info.listens else None,
        "certificate found for these gains": run.info.certified,
        "largest rise of V above an earlier value, relative to its largest": run.largest_rise_of_V,
        "integration error (against half the step)": run.info.integration_error,
    }
