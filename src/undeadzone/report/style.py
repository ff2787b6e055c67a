"""Common style of all figures: axes, sheets of panels, files and bytes."""

from __future__ import annotations

import contextlib
import functools
import io
import os
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from undeadzone.errors import FileError
from undeadzone.report import ink
from undeadzone.util.arrays import Floats
from undeadzone.util.files import replace_file
from undeadzone.util.text import HALF_95, escape_controls
from undeadzone.util.text import label_with_unit as label_with_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SUFFIXES: Final = (".png", ".pdf", ".svg")
DPI: Final = 110
FINE: Final = 200  # resolution of objects other than curves in an SVG: thousands of dots
FLOOR: Final = 1e-16  # least value on a logarithmic axis
SPANS: Final = 120  # of time, in each of which the largest sample is shown
DECADES: Final = 100.0  # beyond this ratio an axis has ticks at decades alone
LEGEND_ROOM: Final = 0.22  # share of an axis that a legend adds above it
ROOM: Final = (0.85, 0.2, 0.5, 0.6, 0.85, 0.8)  # left, right, below, above; between [inch]
DASHED: Final = (0, (4, 2))  # the style of a second line of one colour
COMMENT: Final = re.compile(rb" *<!--.*?-->\n", re.DOTALL)  # of an SVG
EDGE: Final = 0.1  # between the top of a figure and its title [inch]


@functools.cache
def _style_settings() -> Any:
    """Return Matplotlib's settings of the common style."""
    import matplotlib

    path = Path(__file__).parent / "figures.mplstyle"
    return matplotlib.rc_params_from_file(path, use_default_template=False)


def import_default_matplotlib() -> None:
    """Import Matplotlib with its defaults, independent of the working folder and the
    environment.

    A file `matplotlibrc` there would change figures, and may belong to a stranger. This is for the
    command line, whose process is its own: in a notebook the user's settings hold. No command reads
    the help and signatures of Matplotlib's setters, a quarter of its import: they are left out.
    """
    if "matplotlib" in sys.modules:
        return
    os.environ.pop("MPLBACKEND", None)
    with contextlib.chdir(Path(__file__).parent / "rc"):  # Matplotlib looks there first
        import matplotlib
        from matplotlib import artist

        matplotlib.get_backend()
        every: Any = artist.Artist
        artist.kwdoc = lambda artist: ""
        every._update_set_signature_and_docstring = classmethod(lambda cls: None)
        import matplotlib.figure


def create_panels(
    rows: list[list[str]], title: str, width: float = 10.0, height: float = 2.5, even: bool = False
) -> tuple[Figure, dict[str, Axes]]:
    """Return a figure of named panels and these panels by name.

    Args:
        rows: names of panels as they lie (a panel spans all cells that hold its name)
        title: of the figure (a dollar begins no formula)
        width: of the figure [inch]
        height: of one row [inch]
        even: whether fixed room is left around panels, as panels over time need it, in place of a
            layout by all labels, which takes longer than the lines
    """
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(_style_settings()):
        size = (width, height * len(rows) + 0.4)
        figure = Figure(figsize=size, layout=None if even else "constrained")
        figure.suptitle(
            escape_formulas(title), x=0.01, ha="left", y=1 - EDGE / size[1] if even else None
        )
        if even:
            _leave_room(figure, rows)
        vars(figure)["_repr_png_"] = functools.partial(
            figure_to_png, figure
        )  # so that a notebook shows it
        mosaic: Any = rows
        return figure, figure.subplot_mosaic(mosaic)


def _leave_room(figure: Figure, rows: list[list[str]]) -> None:
    """Place panels with fixed room around and between the panels."""
    (width, height) = figure.get_size_inches()
    (left, right, below, above, beside, between) = ROOM
    columns = len(rows[0])
    wide = (width - left - right - beside * (columns - 1)) / columns
    high = (height - below - above - between * (len(rows) - 1)) / len(rows)
    edges = left / width, below / height, 1 - right / width, 1 - above / height
    figure.subplots_adjust(*edges, beside / wide, between / high)


def finish_panel(
    axes: Axes, title: str, y_label: str = "", x_label: str = "t [s]", legend: int = 4
) -> None:
    """Write title, labels and legend of a panel that has its lines.

    Args:
        axes: the panel
        title, y_label, x_label: words
        legend: columns of the legend, which stands above the lines (0 leaves it out)
    """
    import matplotlib

    with matplotlib.rc_context(_style_settings()):
        axes.set_title(title)
        axes.set_xlabel(x_label)
        axes.set_ylabel(y_label)
        if legend:
            _make_room(axes)
            axes.legend(loc="upper right", ncols=legend, borderaxespad=0.2)


def _make_room(axes: Axes) -> None:
    """Raise the upper limit of a panel, so that a legend finds room above the lines."""
    low, high = axes.get_ylim()
    if axes.get_yscale() == "log":
        axes.set_ylim(low, high * (high / low) ** LEGEND_ROOM)
    else:
        axes.set_ylim(low, high + LEGEND_ROOM * (high - low))


def axis_label(words: str, unit: str) -> str:
    """Return a `label_with_unit` on a figure: the words may contain formulas, the unit is
    verbatim.
    """
    return label_with_unit(words, escape_formulas(unit))


def escape_formulas(text: str) -> str:
    """Return foreign text as Matplotlib shows it verbatim: no formula, no control characters."""
    return escape_controls(text).replace("$", r"\$")


def shade_zone(axes: Axes, right: float, left: float, z: Any = 0.0) -> None:
    """Shade the dead zone [-d_l, d_r] as a grey band, without an edge to the end of the z shown."""
    ends = np.array([-left, right])
    shown = np.where(np.isinf(ends), [np.min(z), np.max(z)], ends)
    axes.axhspan(*shown, color=ink.ZONE, alpha=0.18, linewidth=0, label="dead zone")


def shade_gap(axes: Axes, t: Floats, y: Floats, right: float, left: float) -> None:
    """Shade the possible z behind a play that reads y / m, as a grey band along the readings.

    Args:
        axes: the panel
        t: instants [s]
        y: readings in units of z, one for each instant
        right, left: gaps c_r, c_l [z]
    """
    band = axes.fill_between(t, y - left, y + right, color=ink.ZONE, alpha=0.18, linewidth=0)
    band.set_label("gap of the play")


def plot_magnitude(axes: Axes, t: Floats, values: Floats, colour: str, name: str) -> None:
    """Plot |values| on a logarithmic axis: samples faint, the largest in each span of time a
    line.

    Values far below nearly all of these largest ones are cut off, as single zeros would stretch the
    axis.

    Args:
        axes: the panel
        t: instants [s]
        values: a sample for each instant
        colour, name: of the line
    """
    from matplotlib.ticker import LogFormatter, NullLocator

    size = np.abs(values)
    starts = np.linspace(0, t.size, min(SPANS, t.size), endpoint=False).astype(int)
    peaks = np.maximum.reduceat(size, starts)
    floor = log_axis_floor(peaks)
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(LogFormatter())
    axes.yaxis.set_minor_formatter(LogFormatter())
    if peaks.max() > DECADES * floor:  # ticks between decades take as long as the lines
        axes.yaxis.set_minor_locator(NullLocator())
    faint = np.maximum(size, floor)
    axes.plot(t, faint, color=colour, alpha=0.22, linewidth=0.7, rasterized=True)
    axes.plot(t[starts], np.maximum(peaks, floor), color=colour, label=name)


def log_axis_floor(sizes: Floats) -> float:
    """Return the least value on a logarithmic axis: a tenth of nearly all of these sizes."""
    return max(FLOOR, float(np.quantile(sizes, 0.03)) / 10)


def write_figure(figure: Figure, path: Path) -> Path:
    """Write a figure as PNG, PDF or SVG by suffix, complete or not at all.

    Raises:
        FileError: the suffix is another one, or the file cannot be written
    """
    if path.suffix.lower() not in SUFFIXES:
        expected = ", ".join(SUFFIXES)
        raise FileError(f"{path}: cannot write a figure with this name. It must end in {expected}")
    with replace_file(path) as temporary:
        temporary.write_bytes(figure_to_bytes(figure, path.suffix.lower()[1:]))
    return path


def figure_to_png(figure: Figure) -> bytes:
    """Return the figure as PNG bytes."""
    return figure_to_bytes(figure, "png")


def figure_to_bytes(figure: Figure, kind: str) -> bytes:
    """Return the figure as bytes of a PNG, PDF or SVG, with its title (reproducible for SVG).

    An SVG has no comments: Matplotlib writes the source of each text into one.
    """
    import matplotlib

    buffer = io.BytesIO()
    dpi = FINE if kind == "svg" else DPI
    title = figure.get_suptitle().replace(r"\$", "$")  # as it is shown: `escape_formulas`
    about = {"Title": title} | ({"Date": None} if kind == "svg" else {})
    with matplotlib.rc_context({"svg.hashsalt": "undeadzone"}):
        figure.savefig(buffer, format=kind, dpi=dpi, metadata=about)
    drawn = buffer.getvalue()
    return COMMENT.sub(b"", drawn) if kind == "svg" else drawn


def draw_width_lines(axes: Axes, t: Floats, widths: Floats, std: Floats | None) -> None:
    """Draw a right and a left width, each with its 95 % intervals.

    The band does not stretch the axis: at first it is wide.

    Args:
        axes: to draw on.
        t: times (N) [s].
        widths: right and left estimates (N x 2).
        std: their standard deviations (N x 2) (None: there are none).
    """
    sides = (("right", ink.PRINTED), ("left", ink.OTHER))
    for k, (side, colour) in enumerate(sides):
        axes.plot(t, widths[:, k], color=colour, label=side)
    if std is None:
        return
    limits = axes.get_ylim()
    for k, (_, colour) in enumerate(sides):
        low = widths[:, k] - HALF_95 * std[:, k]
        high = widths[:, k] + HALF_95 * std[:, k]
        axes.fill_between(t, low, high, color=colour, alpha=0.18, linewidth=0)
    axes.set_ylim(*limits)
