"""Main figure of a result, or its most informative panel on given axes."""

from __future__ import annotations

import os
from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Protocol, TypeAlias

from undeadzone.errors import InputError
from undeadzone.report.style import write_figure
from undeadzone.util.files import to_path
from undeadzone.util.installed import list_registered_places, load_registered

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from undeadzone.analysis.certificate.design_file import Design
    from undeadzone.results.estimation import Estimation
    from undeadzone.results.run import Run

FIGURES = "undeadzone.figures"  # entry points of packages that draw results of the tool
NARROW = 2  # columns of a legend on axes of one's own
KINDS = (
    "a Run, an Ensemble, an Estimation, a Check, a Design, a Tuned, a Contest or what identify "
    "returns"
)


# By class: the module that draws it, its first figure, its most informative panel.
DRAWN: Final = {
    "results.run.Run": (".run_figures", "overview", "output"),
    "results.estimation.Estimation": (".log_page", "log_overview", "output"),
}


class Drawing(NamedTuple):
    """Drawing functions of a result.

    Attributes:
        whole: makes the first figure of its report.
        panel: draws its most informative panel.
    """

    whole: Callable[[], Figure]
    panel: Callable[[Axes], None]


class DrawableResult(Protocol):
    """Result of a further package, which names its own drawing functions."""

    @property
    def drawn(self) -> tuple[str, str, str]:
        """Return a module, its function that makes a figure of a result, and its
        `panel(axes, result)`.
        """


if TYPE_CHECKING:
    Result: TypeAlias = Run | Estimation | Design | DrawableResult


def plot(
    result: Result, path: str | os.PathLike[str] | None = None, ax: Axes | None = None
) -> Figure:
    """Draw the first figure of a result's report.

    A Run: output, reading and estimate, errors, widths, V. An Ensemble: distributions of its
    metrics or, if every run diverged, its errors over time. An Estimation: readings, estimates,
    widths, innovations along a log. A Check and a Design: the certificate in the frequency domain,
    and for a Check without one the parameters that the readings determine. A Tuned: every
    candidate, and the scenario before and after on held-out runs. A Contest: median and worst
    regret of every method. An identified log: the log, the fit, the sides.

    Args:
        result: one of these
        path: the file to write, a PNG, PDF or SVG by its suffix (None writes none)
        ax: axes that take the most informative panel (None: a new figure with all panels)

    Returns:
        The Matplotlib figure, that of `ax` if it is given.

    Raises:
        InputError: the result has another type, or contains nothing that can be drawn
        FileError: the suffix is another one, or the file cannot be written

    Example:
        >>> figure = uz.plot(run, folder / "run.svg")
        >>> (folder / "run.svg").exists()
        True

    See Also:
        simulate, estimate
    """
    drawing = _find_drawing(result)
    if ax is None:
        figure = drawing.whole()
    else:
        drawing.panel(ax)
        legend = ax.get_legend()
        if legend is not None:
            legend.set_ncols(NARROW)
        figure = ax.figure  # type: ignore[assignment]
    if path is not None:
        write_figure(figure, to_path(path))
    return figure


def _find_drawing(result: Any) -> Drawing:
    """Return the drawing functions of a result. Raises InputError for an unknown type.

    What draws is imported late, so that whoever draws runs alone does not wait for the rest.
    """
    kind = f"{type(result).__module__}.{type(result).__qualname__}".removeprefix("undeadzone.")
    drawn = DRAWN.get(kind) or getattr(result, "drawn", None)
    if drawn is None and kind in list_registered_places(FIGURES):
        drawn = load_registered(FIGURES, kind)
    if drawn is None:
        raise InputError(f"plot: expected {KINDS}, found {type(result).__name__}")
    module, whole, panel = drawn
    draws = import_module(module, "undeadzone.report")
    return Drawing(
        lambda: getattr(draws, whole)(result), lambda ax: getattr(draws, panel)(ax, result)
    )
