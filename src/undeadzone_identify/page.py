"""HTML page of an identified log: the answer, its evidence, and the rival models."""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from undeadzone.report import html
from undeadzone_identify.chain import compensating_lines
from undeadzone_identify.figures import build_figures
from undeadzone_identify.results.at_rest import IdentifiedAtRest
from undeadzone_identify.results.loop import IdentifiedLoop
from undeadzone_identify.results.lost_motion import IdentifiedMotion
from undeadzone_identify.results.next_log import NextLog
from undeadzone_identify.results.result import Identified
from undeadzone_identify.selection.adequacy import DEPENDS

if TYPE_CHECKING:
    from collections.abc import Mapping

CAPTIONS = {
    "overview": "Output z^ of the fitted plant, reading y and the zone with its 95 % bands."
    " Shaded parts checked a fit of the others.",
    "residual_map": "Residual of the readings, by z^: a curve here is another nonlinearity.",
    "next": "The input that would narrow the widest interval most, from rest.",
    "hidden": "z^ with its 95 % band against the reading: inside the zone it is the product.",
}

# Lines that stand on the first screen; the others say how it was decided.
FIRST = re.compile(
    r"found|pays|remedy|not decided|at most|doubt|record next|input|shape|odds|plant|if it sticks"
    r"|cost|note"
)

OF_ELEMENT = {  # in place of these
    "overview": "Output z^ of the fitted plant, its reading without noise, and the reading y at "
    "the end of"
    " the log.",
    "element": "Left: readings by z^, and the path that the fitted element takes. Right: the "
    "residual of the readings. A curve there is another nonlinearity.",
    "crossings": "The gap that each reversal shows, with the printed interval shaded. A trend with"
    " duration is friction that is not fully held. One with y is a worn or an eccentric gear.",
}


OF_OTHERS = {  # in place of these, of answers without a plant
    IdentifiedMotion: {
        "overview": "Above: the second position and its fit. Below: its lag behind the first,"
        " by the first. The lines are both flanks of the gap.",
    },
    IdentifiedAtRest: {
        "overview": "Readings over commands at rest. The 95 % intervals of its edges are shaded.",
    },
    IdentifiedLoop: {
        "overview": "Left: PV over OP. A valve that does not follow draws an ellipse or a"
        " parallelogram, one that follows a line. Right: both over time.",
    },
}
SECTIONS = {  # titles of the pictures that only some answers have
    "hidden": "Hidden output",
    "element": "What it is",
    "crossings": "The gap at each crossing",
    "next": "What to record next",
}
OneAnswer: TypeAlias = Identified | IdentifiedMotion | IdentifiedAtRest | IdentifiedLoop


def write_identified(
    found_log: OneAnswer,
    folder: Path,
    source: str,
    origin: html.Origin | None = None,
    further: NextLog | None = None,
) -> list[Path]:
    """Write figures as SVG and report.html to a folder.

    Args:
        found_log: the answer.
        folder: where to.
        source: name of the log.
        origin: how to compute the same again; None: it cannot be.
        further: the proposed record; None: not asked.

    Returns:
        The files.

    Raises:
        FileError: a file cannot be written.
    """
    text = partial(build_identified_page, found_log, source=source, origin=origin)
    return html.write_page(build_figures(found_log, further), folder, text)


def build_identified_page(
    found_log: OneAnswer,
    images: Mapping[str, bytes],
    source: str,
    origin: html.Origin | None = None,
) -> str:
    """Build the HTML page of an answer.

    Args:
        found_log: the answer.
        images: SVGs by the names of `figures.build_figures`.
        source: name of the log.
        origin: how to compute the same again; None: it cannot be.

    Returns:
        HTML that needs nothing but itself.
    """
    first: list[tuple[str, str]] = []
    rest: list[tuple[str, str]] = []
    for name, text in _summary_rows(found_log.summary()):
        room = name != "note" or len(first) < html.MOST
        (first if room and FIRST.fullmatch(name) else rest).append((name, text))
    captions, tests = CAPTIONS | OF_OTHERS.get(type(found_log), {}), []
    if isinstance(found_log, Identified):
        captions |= {} if found_log.answer.element is None else OF_ELEMENT
        tests = [_residual_in_words(found_log)]
    shown = html.encode_pictures(images, captions)
    colour = "yes" if found_log.account.says_something else "no"
    return html.build_page(
        f"Identified: {source}",
        html.build_paragraph(html.build_tag("span", found_log.headline(), colour)),
        html.build_section(
            "The answer",
            html.build_table(("what", "value"), first),
            *html.pick_pictures(shown, "overview"),
        ),
        *(
            html.build_section(title, *html.pick_pictures(shown, name))
            for name, title in SECTIONS.items()
        ),
        html.build_section(
            "How it was decided",
            html.build_table(("what", "value"), rest),
            *tests,
            *html.pick_pictures(shown, "residual_map"),
        ),
        *_few_lines_section(found_log.numbers(), source),
        origin=origin,
    )


def _summary_rows(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """Return the rows of a summary: a row for each entry of a list."""
    rows: list[tuple[str, str]] = []
    for name, value in summary.items():
        for text in value if isinstance(value, list) else [value]:
            rows.append((name, text))
    return rows


def _few_lines_section(numbers: dict[str, Any], source: str) -> list[html.Html]:
    """Return the section with the few lines that compensate; empty if none help."""
    lines = compensating_lines(numbers, source)
    if not lines:
        return []
    parts = [html.build_tag("pre", text.rstrip()) for text in lines.values()]
    return [html.build_section("A few lines that compensate it", *parts)]


def _residual_in_words(found_log: Identified) -> html.Html:
    """Return the tests of no zone, and of the residual, in words."""
    answer = found_log.answer
    parts = [
        f"{DEPENDS[one.on]} {100 * one.share:.1f} % (p = {one.chance:.2g})"
        for one in answer.found.remainders
    ]
    words = f"Test of no zone at all: p = {answer.case.no_zone.chance:.2g}."
    if parts:
        words += f" Of the model's residual, each explains: {', '.join(parts)}."
    return html.build_paragraph(words)
