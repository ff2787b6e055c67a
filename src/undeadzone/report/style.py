"""One look for every figure: colour-blind-safe colours (Okabe and Ito), light axes, sheets of panels, files and bytes."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from undeadzone.errors import FileError
from undeadzone.support.arrays import Floats
from undeadzone.support.files import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TRUTH: Final = "#1a1a1a"
ESTIMATE: Final = "#0072b2"
READING: Final = "#e69f00"
REFERENCE: Final = "#009e73"
PRINTED: Final = "#d55e00"
OTHER: Final = "#cc79a7"
ZONE: Final = "#8a8f98"

SUFFIXES: Final = (".png", ".pdf", ".svg")
DPI: Final = 110
FLOOR: Final = 1e-16  # least value on a logarithmic axis

_STYLE: Final[Any] = {
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.edgecolor": "#6b7079",
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.xmargin": 0.0,
    "grid.color": "#e4e6ea",
    "grid.linewidth": 0.7,
    "xtick.color": "#4a4f57",
    "ytick.color": "#4a4f57",
    "lines.linewidth": 1.3,
    "lines.solid_capstyle": "round",
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "legend.handlelength": 1.8,
    "legend.columnspacing": 1.4,
    "figure.constrained_layout.h_pad": 0.08,
    "figure.constrained_layout.w_pad": 0.08,
    "figure.titlesize": 11.0,
    "figure.titleweight": "bold",
}


def sheet(
    rows: list[list[str]], title: str, width: float = 10.0, height: float = 2.5
) -> tuple[Figure, dict[str, Axes]]:
    """A figure of named panels, laid out as the rows of names say; `height` [inch] is that of one row."""
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(width, height * len(rows) + 0.4), layout="constrained")
        figure.suptitle(title, x=0.01, ha="left")
        mosaic: Any = rows
        return figure, figure.subplot_mosaic(mosaic)


def finish(
    axes: Axes, title: str, y_label: str = "", x_label: str = "t [s]", legend: int = 4
) -> None:
    """Title, labels and, above the lines, a legend of that many columns (0: none), for a panel that has its lines."""
    import matplotlib

    with matplotlib.rc_context(_STYLE):
        axes.set_title(title)
        axes.set_xlabel(x_label)
        axes.set_ylabel(y_label)
        if legend:
            low, high = axes.get_ylim()
            room = (
                high * (high / low) ** 0.22
                if axes.get_yscale() == "log"
                else high + 0.22 * (high - low)
            )
            axes.set_ylim(low, room)
            axes.legend(loc="upper right", ncols=legend, borderaxespad=0.2)


def label(words: str, unit: str) -> str:
    """An axis label: words and unit, the unit left out where it is 1."""
    return words if unit == "1" else f"{words} [{unit}]"


def shade_zone(axes: Axes, right: float, left: float) -> None:
    """The dead zone [-d_l, d_r] as a grey band."""
    axes.axhspan(-left, right, color=ZONE, alpha=0.18, linewidth=0, label="dead zone")


def plot_magnitude(
    axes: Axes, t: Floats, values: Floats, colour: str, name: str, bins: int = 120
) -> None:
    """|values| on a logarithmic axis: the samples faint, their largest in each of `bins` spans of time as the line.

    What lies far below nearly all of these largest is cut off, so that single zeros do not stretch the axis.
    """
    size = np.abs(values)
    starts = np.linspace(0, t.size, min(bins, t.size), endpoint=False).astype(int)
    peaks = np.maximum.reduceat(size, starts)
    floor = max(FLOOR, float(np.quantile(peaks, 0.03)) / 10)
    axes.set_yscale("log")
    axes.plot(t, np.maximum(size, floor), color=colour, alpha=0.22, linewidth=0.7)
    axes.plot(t[starts], np.maximum(peaks, floor), color=colour, label=name)


def write(figure: Figure, path: Path) -> Path:
    """Write a figure as PNG, PDF or SVG by suffix; nothing is left half-written. Raises FileError."""
    if path.suffix.lower() not in SUFFIXES:
        raise FileError(
            f"{path}: cannot write a figure with this name; it must end in {', '.join(SUFFIXES)}"
        )
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=DPI)
    return path


def png(figure: Figure) -> bytes:
    """The figure as PNG bytes."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI)
    return buffer.getvalue()
