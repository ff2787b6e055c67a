"""The one figure that says most of a result, or its first panel on axes of one's own."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Protocol, TypeAlias, runtime_checkable

from undeadzone.errors import InputError
from undeadzone.report import run_figures
from undeadzone.report.style import plain, sheet, write
from undeadzone.results.run import Run

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from undeadzone.analysis.certificate.design_file import Design
    from undeadzone.ensemble.result import Ensemble
    from undeadzone.identification.outputs import IdentifiedOutputs
    from undeadzone.identification.result import Identified
    from undeadzone.results.estimation import Estimation
    from undeadzone.synthesis.check import Check
    from undeadzone.tuning.result import Tuned

NARROW = 2  # columns of a legend on axes of one's own
KINDS = (
    "a Run, an Ensemble, an Estimation, a Check, a Design, a Tuned, a Contest or what identify "
    "returns"
)


class Drawing(NamedTuple):
    """How a result is drawn.

    Attributes:
        whole: makes the first figure of its report.
        panel: draws the panel of it that says most.
    """

    whole: Callable[[], Figure]
    panel: Callable[[Axes], None]


@runtime_checkable
class Drawn(Protocol):
    """A result of another package, which says itself how it is drawn."""

    def drawing(self) -> Drawing:
        """How it is drawn."""


if TYPE_CHECKING:
    Result: TypeAlias = (
        Run | Ensemble | Estimation | Check | Design | Tuned | Identified | IdentifiedOutputs
        | Drawn
    )  # fmt: skip


def plot(
    result: Result, path: str | os.PathLike[str] | None = None, ax: Axes | None = None
) -> Figure:
    """Draw the first figure of a result's report.

    A Run: output, reading and estimate, errors, widths, V. An Ensemble: how its metrics are
    distributed, or, where every run diverged, its errors over time. An Estimation: readings,
    estimates, widths, innovations along a log. A Check and a Design: the certificate in the
    frequency domain; a Check without one what the readings can tell. A Tuned: every candidate, and
    the scenario before and after on held-out runs. A Contest: median and worst regret of every
    method. An identified log: the log, the fit, the sides.

    Args:
        result: one of these
        path: the file to write, a PNG, PDF or SVG by its suffix; None writes none
        ax: axes that take the panel that says most; None: a new figure with all panels

    Returns:
        The Matplotlib figure, that of `ax` where it is given.

    Raises:
        InputError: the result is none of these, or holds nothing that can be drawn
        FileError: the suffix is another one, or the file cannot be written
    """
    drawing = _drawing(result)
    if ax is None:
        figure = drawing.whole()
    else:
        drawing.panel(ax)
        legend = ax.get_legend()
        if legend is not None:
            legend.set_ncols(NARROW)
        figure = ax.figure  # type: ignore[assignment]
    if path is not None:
        write(figure, Path(path))
    return figure


def _drawing(result: Result) -> Drawing:
    """How a result is drawn. Raises InputError."""
    if isinstance(result, Drawn):
        return result.drawing()
    if isinstance(result, Run):
        return Drawing(
            lambda: run_figures.overview(result), lambda ax: run_figures.output(ax, result)
        )
    # imported here, so that whoever draws runs alone does not wait for them
    from undeadzone.analysis.certificate.design_file import Design
    from undeadzone.ensemble.result import Ensemble
    from undeadzone.report import log_page, proof_figures, tune_page
    from undeadzone.results.estimation import Estimation
    from undeadzone.synthesis.check import Check
    from undeadzone.tuning.result import Tuned

    if isinstance(result, Estimation):
        return Drawing(
            lambda: log_page.log_overview(result), lambda ax: log_page.output(ax, result)
        )
    if isinstance(result, Ensemble):
        return _of_ensemble(result)
    if isinstance(result, Check):
        return _of_check(result)
    if isinstance(result, Design):
        proof = proof_figures.proof_of(result)
        return Drawing(
            lambda: proof_figures.positive_realness(proof),
            lambda ax: proof_figures.least_real_part(ax, proof),
        )
    if isinstance(result, Tuned):
        return Drawing(
            lambda: tune_page.history(result), lambda ax: tune_page.candidates(ax, result)
        )
    return _of_identified(result)


def _of_ensemble(result: Ensemble) -> Drawing:
    """How an ensemble is drawn."""
    from undeadzone.report.ensemble_figures import distribution
    from undeadzone.report.ensemble_page import first_of_ensemble

    return Drawing(lambda: first_of_ensemble(result), lambda ax: distribution(ax, result))


def _of_check(result: Check) -> Drawing:
    """How a check is drawn: its certificate, or without one what can be known. Raises InputError.

    A jump sensor's widths have no ellipse.
    """
    import numpy as np

    from undeadzone.report.gain_figures import deviations, ellipses
    from undeadzone.report.proof_figures import least_real_part, nyquist

    gains, of = result.assessment.gains, result.assessment
    if gains is not None and np.isfinite(gains.certificate.margin):
        return Drawing(lambda: nyquist(gains), lambda ax: least_real_part(ax, gains.certificate))
    if of.problem.sensor.kind != "deadzone":
        raise InputError("plot: this check has no certificate, and nothing that can be drawn")
    return Drawing(lambda: ellipses(of), lambda ax: deviations(ax, of, 0))


def _of_identified(result: Identified | IdentifiedOutputs) -> Drawing:
    """How identified logs are drawn. Raises InputError for what is no result at all."""
    from undeadzone.identification.outputs import IdentifiedOutputs
    from undeadzone.identification.result import Identified
    from undeadzone.report.identify_figures import overview, signals

    if isinstance(result, Identified):
        return Drawing(lambda: overview(result), lambda ax: signals(ax, result))
    if isinstance(result, IdentifiedOutputs):
        first = result.outputs[0]
        return Drawing(lambda: _of_outputs(result), lambda ax: signals(ax, first))
    raise InputError(f"plot: expected {KINDS}, found {type(result).__name__}")


def _of_outputs(result: IdentifiedOutputs) -> Figure:
    """The log and the fit of each output, one below the other."""
    from undeadzone.report.identify_figures import signals

    figure, panels = sheet([[name] for name in result.names], "The log and its fits")
    for name, one in zip(result.names, result.outputs, strict=True):
        signals(panels[name], one, f" {plain(name)}")
    return figure
