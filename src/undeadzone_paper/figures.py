"""Figures 3-8 of the paper as printed and as repaired, and the output inside the zone."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from undeadzone.report import ink
from undeadzone.report.style import create_panels, finish_panel, plot_magnitude, shade_zone
from undeadzone.results.run import Run
from undeadzone.util.arrays import Floats
from undeadzone_paper.equations import FIGURES
from undeadzone_paper.example import D
from undeadzone_paper.measures import reading_estimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

EARLY: Final = 6.0  # [s] shown where two oscillating signals lie on each other
DASHED: Final = (0, (4, 2))
# Of the readings of the plant.
_COLOURS: Final = (ink.PRINTED, ink.ESTIMATE, ink.REFERENCE, ink.READING)


class RunTrio(NamedTuple):
    """Runs of one reference.

    Attributes:
        resting: as printed, from rest
        begun: as printed, started outside the zone
        repaired: as repaired
    """

    resting: Run
    begun: Run
    repaired: Run


class SignalLine(NamedTuple):
    """Signal of a run with the name and colour of its line."""

    name: str
    colour: str
    value: Callable[[Run], Floats]


_LINES: Final = {
    3: (
        SignalLine("$y$", ink.TRUTH, lambda run: run.y[:, 0]),
        SignalLine(r"$\hat y$", ink.ESTIMATE, reading_estimate),
    ),
    4: (
        SignalLine(r"$\hat y - y$", ink.ESTIMATE, lambda run: reading_estimate(run) - run.y[:, 0]),
    ),
    5: (
        SignalLine("$x_1$", ink.TRUTH, lambda run: run.x[:, 0]),
        SignalLine(r"$\hat x_1$", ink.ESTIMATE, lambda run: run.x_hat[:, 0]),
    ),
    6: (SignalLine(r"$\hat x_1 - x_1$", ink.ESTIMATE, lambda run: run.x_hat[:, 0] - run.x[:, 0]),),
    7: (SignalLine(r"$\hat x_2 - x_2$", ink.ESTIMATE, lambda run: run.x_hat[:, 1] - run.x[:, 1]),),
    8: (
        SignalLine(r"$\hat d_r$", ink.ESTIMATE, lambda run: run.d_hat[:, 0]),
        SignalLine(r"$\hat d_l$", ink.OTHER, lambda run: run.d_hat[:, 1]),
    ),
}


def plot_paper_figure(number: int, runs: RunTrio, reference: str) -> Figure:
    """Plot one of figures 3-8 with V(t) below.

    Args:
        number: of the figure
        runs: that it shows
        reference: of these runs, in words
    """
    lines = _LINES[number]
    sketch, panels = create_panels(
        [["printed", "repaired"], ["V printed", "V repaired"]],
        f"Figure {number}: {to_mathtext(FIGURES[number])}, {reference}",
    )
    axes = panels["printed"]
    _plot_lines(axes, lines, runs.begun)
    _plot_from_rest(axes, runs.resting, lines[0].value)
    start = f"As printed, started at $x_1$ = {runs.begun.x[0, 0]:g}"
    finish_panel(axes, start, ", ".join(line.name for line in lines))
    _plot_lines(panels["repaired"], lines, runs.repaired)
    finish_panel(panels["repaired"], "Repaired")
    axes = panels["V printed"]
    axes.plot(
        runs.begun.t, _values_of_V(runs.begun), color=ink.TRUTH, label="started outside the zone"
    )
    _plot_from_rest(axes, runs.resting, _values_of_V)
    finish_panel(axes, "V of (30), as printed", "V")
    plot_magnitude(
        panels["V repaired"], runs.repaired.t, _values_of_V(runs.repaired), ink.TRUTH, "V"
    )
    finish_panel(panels["V repaired"], "V of the certificate, repaired", "V", legend=0)
    return sketch


def to_mathtext(words: str) -> str:
    """Convert words to symbols: x1 and y, and x^1 and y^ with hats."""
    plain = re.sub(r"\b([xy])(\d?)\b(?!\^)", r"$\1_{\2}$", words)
    return re.sub(r"([a-z])\^(\d?)", r"$\\hat{\1}_{\2}$", plain)


def _values_of_V(run: Run) -> Floats:
    """Return V of a run (N), NaN if it has none."""
    return np.full(run.t.size, np.nan) if run.V is None else run.V


def _plot_lines(axes: Axes, lines: tuple[SignalLine, ...], run: Run) -> None:
    """Plot the lines of a run: oscillating pairs early, an error or the widths over all of it."""
    widths = lines is _LINES[8]
    paired = len(lines) == 2 and not widths
    shown = run.t <= (EARLY if paired else run.t[-1])
    if widths:
        axes.axhline(D, color=ink.TRUTH, linewidth=3.0, alpha=0.25, label="truth")
    for line in lines:
        t, value = run.t[shown], line.value(run)[shown]
        dashes = DASHED if paired and line is lines[1] else "-"
        axes.plot(t, value, color=line.colour, label=line.name, linestyle=dashes)


def _plot_from_rest(axes: Axes, run: Run, value: Callable[[Run], Floats]) -> None:
    """Plot a thin line of the run from rest, up to the end of the panel."""
    shown = run.t <= axes.dataLim.x1
    axes.plot(run.t[shown], value(run)[shown], color=ink.PRINTED, linewidth=1.0, label="from rest")


def plot_silence(t: Floats, outputs: Mapping[str, Floats]) -> Figure:
    """Plot the response from rest to the force u = 5 sin 2 pi t, small responses enlarged.

    Args:
        t: instants [s]
        outputs: z at these instants, by reading of the plant
    """
    title = "Why the sensor says nothing: 5 sin 2πt as a force, from rest"
    sketch, panels = create_panels([["all", "all", "inside"]], title, height=3.0)
    everything, inside = panels["all"], panels["inside"]
    early = t <= EARLY
    shade_zone(everything, D, D)
    shade_zone(inside, D, D)
    for (reading, z), colour in zip(outputs.items(), _COLOURS, strict=True):
        name = reading.replace("omega_n", r"$\omega_n$").replace(" pi", "π")
        everything.plot(t[early], z[early], color=colour, label=name)
        if np.abs(z).max() < D:
            inside.plot(t[early], z[early], color=colour, label=name)
    inside.set_ylim(-D / 2, D / 2)
    leaves = "Only with unity DC gain does the output leave the dead zone"
    finish_panel(everything, leaves, "output z", legend=5)
    finish_panel(inside, "The three others, enlarged", legend=0)
    return sketch
