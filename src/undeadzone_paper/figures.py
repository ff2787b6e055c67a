"""Figures 3-8 of the paper as printed beside repaired, and why the sensor stays silent."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from undeadzone.report import ink
from undeadzone.report.style import finish, plot_magnitude, shade_zone, sheet
from undeadzone.results.run import Run
from undeadzone.util.arrays import Floats
from undeadzone_paper.equations import FIGURES
from undeadzone_paper.example import D
from undeadzone_paper.measures import reading_of_estimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

EARLY: Final = 6.0  # [s] shown where two oscillating signals lie on each other
DASHED: Final = (0, (4, 2))
# Of the readings of the plant.
_COLOURS: Final = (ink.PRINTED, ink.ESTIMATE, ink.REFERENCE, ink.READING)


class Trio(NamedTuple):
    """The runs of one reference.

    Attributes:
        resting: as printed, from rest
        begun: as printed, started outside the zone
        repaired: as repaired
    """

    resting: Run
    begun: Run
    repaired: Run


class Line(NamedTuple):
    """A signal of a run with the name and colour of its line."""

    name: str
    colour: str
    value: Callable[[Run], Floats]


_LINES: Final = {
    3: (
        Line("$y$", ink.TRUTH, lambda run: run.y[:, 0]),
        Line(r"$\hat y$", ink.ESTIMATE, reading_of_estimate),
    ),
    4: (Line(r"$\hat y - y$", ink.ESTIMATE, lambda run: reading_of_estimate(run) - run.y[:, 0]),),
    5: (
        Line("$x_1$", ink.TRUTH, lambda run: run.x[:, 0]),
        Line(r"$\hat x_1$", ink.ESTIMATE, lambda run: run.x_hat[:, 0]),
    ),
    6: (Line(r"$\hat x_1 - x_1$", ink.ESTIMATE, lambda run: run.x_hat[:, 0] - run.x[:, 0]),),
    7: (Line(r"$\hat x_2 - x_2$", ink.ESTIMATE, lambda run: run.x_hat[:, 1] - run.x[:, 1]),),
    8: (
        Line(r"$\hat d_r$", ink.ESTIMATE, lambda run: run.d_hat[:, 0]),
        Line(r"$\hat d_l$", ink.OTHER, lambda run: run.d_hat[:, 1]),
    ),
}


def figure(number: int, runs: Trio, reference: str) -> Figure:
    """Return one of figures 3-8, V(t) below it.

    Args:
        number: of the figure
        runs: that it shows
        reference: of these runs, in words
    """
    lines = _LINES[number]
    sketch, panels = sheet(
        [["printed", "repaired"], ["V printed", "V repaired"]],
        f"Figure {number}: {mathtext(FIGURES[number])}, {reference}",
    )
    axes = panels["printed"]
    _signals(axes, lines, runs.begun)
    _from_rest(axes, runs.resting, lines[0].value)
    start = f"As printed, started at $x_1$ = {runs.begun.x[0, 0]:g}"
    finish(axes, start, ", ".join(line.name for line in lines))
    _signals(panels["repaired"], lines, runs.repaired)
    finish(panels["repaired"], "Repaired")
    axes = panels["V printed"]
    axes.plot(runs.begun.t, _V(runs.begun), color=ink.TRUTH, label="started outside the zone")
    _from_rest(axes, runs.resting, _V)
    finish(axes, "V of (30), as printed", "V")
    plot_magnitude(panels["V repaired"], runs.repaired.t, _V(runs.repaired), ink.TRUTH, "V")
    finish(panels["V repaired"], "V of the certificate, repaired", "V", legend=0)
    return sketch


def mathtext(words: str) -> str:
    """Return words with x1 and y as symbols, and x^1 and y^ with their hats on."""
    plain = re.sub(r"\b([xy])(\d?)\b(?!\^)", r"$\1_{\2}$", words)
    return re.sub(r"([a-z])\^(\d?)", r"$\\hat{\1}_{\2}$", plain)


def _V(run: Run) -> Floats:
    """Return V of a run; nan where it has none."""
    return np.full(run.t.size, np.nan) if run.V is None else run.V


def _signals(axes: Axes, lines: tuple[Line, ...], run: Run) -> None:
    """The lines of a run: two oscillating ones early, an error or the widths over all of it."""
    widths = lines is _LINES[8]
    paired = len(lines) == 2 and not widths
    shown = run.t <= (EARLY if paired else run.t[-1])
    if widths:
        axes.axhline(D, color=ink.TRUTH, linewidth=3.0, alpha=0.25, label="truth")
    for line in lines:
        t, value = run.t[shown], line.value(run)[shown]
        dashes = DASHED if paired and line is lines[1] else "-"
        axes.plot(t, value, color=line.colour, label=line.name, linestyle=dashes)


def _from_rest(axes: Axes, run: Run, value: Callable[[Run], Floats]) -> None:
    """A thin line of what the same does from rest, as far as the panel goes."""
    shown = run.t <= axes.dataLim.x1
    axes.plot(run.t[shown], value(run)[shown], color=ink.PRINTED, linewidth=1.0, label="from rest")


def silence(t: Floats, outputs: Mapping[str, Floats]) -> Figure:
    """What u = r = 5 sin 2 pi t as a force does from rest, the small answers again larger.

    Args:
        t: instants [s]
        outputs: z at these instants, by reading of the plant
    """
    title = "Why the sensor says nothing: 5 sin 2πt as a force, from rest"
    sketch, panels = sheet([["all", "all", "inside"]], title, height=3.0)
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
    finish(everything, leaves, "output z", legend=5)
    finish(inside, "The three others, enlarged", legend=0)
    return sketch
