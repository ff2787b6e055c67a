"""HTML page of an identified log: the answer, its evidence, and the rival models."""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from undeadzone.report import html
from undeadzone.util.text import HALF_95, format_with_interval, label_with_unit
from undeadzone_identify.chain import compensating_lines
from undeadzone_identify.figures import build_figures, lost_motion
from undeadzone_identify.results.lost_motion import IdentifiedMotion
from undeadzone_identify.results.next_log import NextLog
from undeadzone_identify.results.result import Identified
from undeadzone_identify.results.words import (
    OPEN,
    crossing_columns,
    describe_rivals,
    headline,
)
from undeadzone_identify.selection.adequacy import DEPENDS
from undeadzone_identify.selection.orders import OrderFit, is_fit_at_limit

if TYPE_CHECKING:
    from collections.abc import Mapping

CAPTIONS = {
    "overview": "Output z^ of the fitted plant, reading y and the zone with its 95 % bands;"
    " shaded parts checked a fit of the others. Below: which side each reading shows.",
    "residual_map": "What the zone leaves of the readings, by z^: a curve here is another"
    " nonlinearity.",
    "residual": "Correlation of the one-step residual, and of it with past inputs, with 95 % bands"
    " for white residuals: what stands out is not in the model.",
    "profiles": "How much the log likelihood falls as one width is held elsewhere; the"
    " printed interval is shaded. Under a coloured disturbance it is wider than the curve alone.",
    "next": "The input that would tell most of what is known least, from rest.",
    "hidden": "z^ with its 95 % band against the reading: inside the zone it is the product.",
}

# Lines that stand on the first screen; the others say how it was decided.
FIRST = re.compile(
    r"[bcdf]_(right|left)|([bcd] )?width|friction|possible|input|shape|odds|plant|note"
)

OF_ELEMENT = {  # in place of these
    "overview": "Output z^ of the fitted plant, what is read of it, and the reading y at the end of"
    " the log. Below: in which contact the play is, or on which side of its zone the input.",
    "element": "Left: readings by z^, and the path that the fitted element takes. Right: what it"
    " leaves of the readings; a curve there is something that it does not hold.",
    "crossings": "The gap that each reversal shows, with the printed interval shaded. A trend with"
    " duration is friction that is not fully held; one with y is a worn or an eccentric gear.",
}


OF_POSITIONS = {
    "overview": "Above: the second position and its fit. Below: what it lags behind the first, by"
    " the first; the lines are both flanks of the gap.",
}


def write_identified(
    found_log: Identified,
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
    found_log: Identified,
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
    answer = found_log.answer
    head = html.build_paragraph(
        html.build_tag("span", headline(answer), "no" if found_log.verdict in OPEN else "yes")
    )
    first: list[tuple[str, str]] = []
    rest: list[tuple[str, str]] = []
    for name, text in _summary_rows(found_log.summary()):
        room = name != "note" or len(first) < html.MOST
        (first if room and FIRST.fullmatch(name) else rest).append((name, text))
    captions = CAPTIONS if answer.element is None else CAPTIONS | OF_ELEMENT
    shown = html.encode_pictures(images, captions)
    return html.build_page(
        f"Identified: {source}",
        head,
        *map(html.build_paragraph, answer.reasons),
        html.build_section(
            "The answer",
            html.build_table(("what", "value"), first),
            *html.pick_pictures(shown, "overview"),
        ),
        html.build_section("Hidden output", *html.pick_pictures(shown, "hidden")),
        html.build_section("What it is", *html.pick_pictures(shown, "element")),
        *_crossings_section(found_log, shown),
        *([html.build_section("What to record next", shown["next"])] if "next" in shown else []),
        html.build_section(
            "How it was decided",
            html.build_table(("what", "value"), rest),
            *_rivals_table(found_log),
            *html.pick_pictures(shown, "residual_map"),
        ),
        *_fit_sections(found_log, shown),
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


def write_identified_motion(
    found: IdentifiedMotion, folder: Path, source: str, origin: html.Origin | None = None
) -> list[Path]:
    """Write the figure of two positions as SVG and report.html to a folder.

    Args:
        found: the answer.
        folder: where to.
        source: name of the log.
        origin: how to compute the same again; None: it cannot be.

    Returns:
        The files.

    Raises:
        FileError: a file cannot be written.
    """
    text = partial(_build_motion_page, found, source=source, origin=origin)
    return html.write_page({"overview": lost_motion(found)}, folder, text)


def _build_motion_page(
    found: IdentifiedMotion,
    images: Mapping[str, bytes],
    source: str,
    origin: html.Origin | None = None,
) -> str:
    """Build the HTML page of two positions."""
    head = html.build_tag("span", found.headline(), "no" if found.verdict in OPEN else "yes")
    shown = html.encode_pictures(images, CAPTIONS | OF_POSITIONS)
    return html.build_page(
        f"Identified: {source}",
        html.build_paragraph(head),
        html.build_section(
            "The answer",
            html.build_table(("what", "value"), _summary_rows(found.summary())),
            *html.pick_pictures(shown, "overview"),
        ),
        *_few_lines_section(found.numbers(), source),
        origin=origin,
    )


def _crossings_section(found_log: Identified, shown: dict[str, html.Html]) -> list[html.Html]:
    """Return the section with every crossing of a servo's gap; empty without a servo."""
    columns = crossing_columns(found_log.answer)
    if not columns:
        return []
    columns = columns | {"side": np.where(columns["side"] > 0, "right", "left")}
    heads = ("t [s]", "to the", "speed", "duration [s]", "y", "gap")
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    return [
        html.build_section(
            "The gap at each crossing",
            *html.pick_pictures(shown, "crossings"),
            html.build_table(heads, rows),
        )
    ]


def _fit_sections(found_log: Identified, shown: dict[str, html.Html]) -> list[html.Html]:
    """Return the sections on stages and orders of the sensor-zone fit; empty for other
    elements.
    """
    if found_log.answer.element is not None:
        return []
    return [
        html.build_section(
            "How sure are the widths?",
            _stages_table(found_log),
            *html.pick_pictures(shown, "profiles"),
        ),
        html.build_section(
            "Order and residual", _orders_table(found_log), *html.pick_pictures(shown, "residual")
        ),
    ]


def _rivals_table(found_log: Identified) -> list[html.Html]:
    """Return the table of all models with their probabilities, and the residual test in words."""
    answer = found_log.answer
    parts = [
        f"{DEPENDS[one.on]} {100 * one.share:.1f} % (p = {one.chance:.2g})"
        for one in answer.found.remainders
    ]
    words = f"Test of no zone at all: p = {answer.case.no_zone.chance:.2g}."
    if parts:
        words += f" Of what the model leaves, each explains: {', '.join(parts)}."
    rivals = describe_rivals(answer)
    return [
        html.build_table(("what may be there", "odds", "behind, nats a reading"), rivals),
        html.build_paragraph(words),
    ]


def _stages_table(found_log: Identified) -> html.Html:
    """Return the table of widths by stage of the fit."""
    answer = found_log.answer
    if answer.case.jump_edges is not None:
        return html.build_paragraph(
            "The edges of a jump sensor come from the least readings of their passages; plant and"
            " likelihoods take them as known."
        )
    names = {
        "L1": "single samples",
        "L2": "Kalman filter",
    }
    rows = []
    for name, (right, left) in answer.widths.stages.items():
        halves = answer.widths.halves[name]
        cells = []
        for edge, value in (("right", right), ("left", left)):
            std = halves[edge] * answer.scale / HALF_95
            cells.append(format_with_interval(value * answer.scale, std))
        rows.append((names[name], *cells))
    unit = answer.case.grid.output_unit
    heads = [label_with_unit(edge, unit) for edge in ("d_r", "d_l")]
    return html.build_table(("likelihood of", *heads), rows)


def _orders_table(found_log: Identified) -> html.Html:
    """Return the table of the orders that were tried."""
    answer = found_log.answer
    least = min(one.fit.bic for one in answer.case.fitted.fits)
    rows = []
    for one in answer.case.fitted.fits:
        rows.append(
            (
                one.n,
                one.fit.bic - least,
                one.error * answer.scale,
                one.fit.right * answer.scale,
                one.fit.left * answer.scale,
                _order_remark(found_log, one),
            )
        )
    return html.build_table(
        ("order", "BIC above the least", "held-out error", "d_r", "d_l", ""), rows
    )


def _order_remark(found_log: Identified, one: OrderFit) -> str:
    """Return a remark on an order: chosen, or too slow for the log; empty otherwise."""
    if one.n == found_log.order:
        return "chosen"
    return "a pole does not settle within the log" if is_fit_at_limit(one.fit) else ""
