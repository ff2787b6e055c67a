"""Figure, page and files of an estimation from a log."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from undeadzone.observers.filtering.consistency import FAR
from undeadzone.observers.filtering.prior import CHANCE
from undeadzone.report import html, ink
from undeadzone.report.style import (
    DASHED,
    create_panels,
    draw_width_lines,
    finish_panel,
    shade_gap,
    shade_zone,
)
from undeadzone.results.estimation import Estimation
from undeadzone.util.arrays import bounds_of_runs
from undeadzone.util.text import label_with_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_OVERVIEW = (
    "Reading and estimates over the estimated dead zone. Missing readings are shaded. Below, the "
    "widths, and the innovations over their standard deviations with the statistic B of the test "
    "of consistency."
)
_TEST = (
    "The test: a normalised innovation has mean 0 and rms 1 if model, step, columns and "
    "assumptions are right. B is the mean square of their sums over two quarter periods of the "
    "plant, about 1. "
    "A reading beyond 4.5 standard deviations is refused by the test."
)
STYLES: Final = {True: "yes", False: "no", None: "mid"}  # of an answer about consistency
POINTS = 20_000  # samples that a line shows at most
MOST_GAPS = 100  # that are shaded: more could not be distinguished


def write_estimation(
    result: Estimation,
    folder: Path,
    figures: bool,
    tables: bool,
    origin: html.Origin | None,
) -> list[Path]:
    """Write the files of an estimation from a log.

    Args:
        result: estimation from the log.
        folder: for the files (created if missing).
        figures: whether figure and page are wanted beside the signals.
        tables: whether the signals are wanted as `.csv` too.
        origin: data to compute the same again (None: unknown).

    Returns:
        The paths of the files.

    Raises:
        FileError: a file cannot be written.
    """
    written = [result.save(folder / "estimate.npz")]
    if tables:
        written.append(result.save(folder / "estimate.csv"))
    if figures:
        drawn = {"figure": log_overview(result)}
        text = partial(estimation_page, result, origin=origin)
        written += html.write_page(drawn, folder, text)
    return written


def estimation_page(
    result: Estimation, images: Mapping[str, bytes], origin: html.Origin | None = None
) -> str:
    """Return the page of an estimation from a log: figure, numbers, verdict.

    Args:
        result: estimation from the log.
        images: `log_overview` as SVG, under the name "figure".
        origin: data to compute the same again (None: unknown).
    """
    info = result.info
    blocks = result.blocks()
    pairs: Any = blocks[0]
    answer = html.build_tag("span", f"Consistent: {pairs['consistent']}", STYLES[info.consistent])
    pictures = html.encode_pictures(images, {"figure": _OVERVIEW}).values()
    first, *rest = html.answer_tables(blocks)
    return html.build_page(
        info.title,
        html.build_paragraph(answer),
        html.build_section("Along the log", first, *pictures, html.build_paragraph(_TEST, "note")),
        html.build_section("The log", *rest, html.fold_numbers(result.summary())),
        origin=origin,
    )


def log_overview(result: Estimation) -> Figure:
    """Return per output: reading and estimates over the estimated zone, widths, innovations."""
    rows = []
    for i in range(result.y.shape[1]):
        rows.append([f"output {i}"] * 2)
        rows.append([f"widths {i}", f"innovation {i}"])
    figure, panels = create_panels(rows, result.info.title, even=True)
    for i, name in enumerate(result.outputs):
        of = f" {name}" if len(result.outputs) > 1 else ""
        output(panels[f"output {i}"], result, i, of)
        _draw_log_widths(panels[f"widths {i}"], result, i, of)
        _draw_innovations(panels[f"innovation {i}"], result, i, of)
    return figure


def _drawn_window(result: Estimation) -> slice:
    """Return the samples that are drawn."""
    return slice(None, None, max(1, result.t.size // POINTS))


def output(axes: Axes, result: Estimation, i: int = 0, of: str = "") -> None:
    """Draw reading and estimates of output i over its estimated dead zone (of: its name)."""
    window = _drawn_window(result)
    t = result.t[window]
    right = result.info.d_right[i]
    left = result.info.d_left[i]
    if result.info.sensor == "play":
        shade_gap(axes, t, result.y[window, i], right, left)
    elif right > -left:
        at = result.info.output_level[i] if result.info.output_level else 0.0
        shade_zone(axes, right + at, left - at, result.z_hat[window, i])
    axes.plot(t, result.y[window, i], color=ink.READING, label="reading y")
    axes.plot(t, result.z_hat[window, i], color=ink.ESTIMATE, label="estimate ẑ")
    if result.z_smooth is not None:
        smooth = result.z_smooth[window, i]
        axes.plot(t, smooth, color=ink.TRUTH, linestyle=DASHED, label="with the whole log")
    _mark_missing(axes, result, i)
    title = f"Output{of}: the reading, and the observer's estimate"
    finish_panel(axes, title, label_with_unit("z, y", result.unit("z_hat")), legend=4)


def _mark_missing(axes: Axes, result: Estimation, i: int) -> None:
    """Shade the times of missing readings of output i."""
    first, last = bounds_of_runs(~np.isfinite(result.y[:, i]))
    if first.size > MOST_GAPS:
        return
    ends = np.minimum(last + 1, result.t.size - 1)
    for start, end in zip(result.t[first], result.t[ends], strict=True):
        axes.axvspan(start, end, color=ink.FORBIDDEN, linewidth=0)


def _draw_log_widths(axes: Axes, result: Estimation, i: int, of: str) -> None:
    """Draw the estimated widths of output i, with 95 % intervals."""
    window = _drawn_window(result)
    t = result.t[window]
    columns = slice(2 * i, 2 * i + 2)
    widths = result.d_hat[window, columns]
    std = None if result.d_std is None else result.d_std[window, columns]
    draw_width_lines(axes, t, widths, std)
    if result.d_smooth is not None:
        for column, colour in ((2 * i, ink.PRINTED), (2 * i + 1, ink.OTHER)):
            axes.plot(t, result.d_smooth[window, column], color=colour, linestyle=DASHED)
    settled = widths[len(widths) // 10 :]  # the start would stretch the axis
    low = float(np.nanmin(settled))
    high = float(np.nanmax(settled))
    room = 0.3 * (high - low) + 1e-12
    if np.isfinite(room):
        axes.set_ylim(low - room, high + room)
    band = ", 95 % intervals" if result.d_std is not None else ""
    finish_panel(axes, f"Widths{of}{band}", label_with_unit("d", result.unit("d_hat")))


def _draw_innovations(axes: Axes, result: Estimation, i: int, of: str) -> None:
    """Draw the normalised innovations of output i and the test statistic (without a test,
    innovations).
    """
    window = _drawn_window(result)
    t = result.t[window]
    innovation = result.innovation[window, i]
    used = innovation != 0
    if result.innovation_std is None or result.B is None:
        axes.plot(t[used], innovation[used], ".", color=ink.ESTIMATE, markersize=2, rasterized=True)
        finish_panel(
            axes,
            f"Innovations{of}: no test exists",
            label_with_unit("e", result.unit("y")),
            legend=0,
        )
        return
    normalised = innovation[used] / result.innovation_std[window, i][used]
    limited = np.clip(normalised, -2 * FAR, 2 * FAR)
    name = "innovation / its std"
    axes.plot(t[used], limited, ".", color=ink.ESTIMATE, markersize=2, label=name, rasterized=True)
    for bound in (-FAR, FAR):
        axes.axhline(bound, color=ink.REFERENCE, linewidth=0.8)
    axes.plot(t, np.minimum(result.B[window, i], 2 * FAR), color=ink.PRINTED, label="B")
    axes.axhline(CHANCE, color=ink.PRINTED, linewidth=0.8, linestyle=DASHED, label="usual limit")
    finish_panel(axes, f"Innovations{of} and their test", "standard deviations", legend=3)
