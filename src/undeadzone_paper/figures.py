"""Figures 3-8 of the paper as printed and as repaired, of tracking, of V, and of Theorem 4.1."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from undeadzone.report import ink
from undeadzone.report.style import create_panels, finish_panel, plot_magnitude, shade_zone
from undeadzone.results.run import Run
from undeadzone.util.arrays import Floats
from undeadzone_paper.equations import FIGURES
from undeadzone_paper.example import D
from undeadzone_paper.measures import reading_estimate
from undeadzone_paper.printed import RIGHT, Outcome
from undeadzone_paper.theorem import ESTIMATED, GIVEN, select_outcomes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

EARLY: Final = 6.0  # [s] shown where two oscillating signals lie on each other
LEAST: Final = 1e-6  # error on a logarithmic axis
DASHED: Final = (0, (4, 2))
# Of the readings of the plant.
_COLOURS: Final = (ink.PRINTED, ink.ESTIMATE, ink.REFERENCE, ink.READING)


class RunTrio(NamedTuple):
    """Runs of one reference.

    Attributes:
        resting: as printed, from rest
        begun: as printed, started outside the zone
        repaired: as repaired, started there too
    """

    resting: Run
    begun: Run
    repaired: Run


class SignalLine(NamedTuple):
    """Signal of a run with the name and colour of its line."""

    name: str
    colour: str
    value: Callable[[Run], Any]


Y_HAT: Final = "\u0177"
X1 = "x\u2081"
X1_HAT = "x\u0302\u2081"
X2 = "x\u2082"
X2_HAT = "x\u0302\u2082"
D_HAT: Final = "d\u0302"


def _line_of_error(estimate: SignalLine, truth: SignalLine) -> SignalLine:
    """Return the line of an estimate less the truth."""
    name = f"{estimate.name} \u2212 {truth.name}"
    return SignalLine(name, ink.ESTIMATE, lambda run: estimate.value(run) - truth.value(run))


def _line_of(name: str, colour: str, field: str, column: int = 0) -> SignalLine:
    """Return the line of a column of a run's signal."""
    return SignalLine(name, colour, lambda run: getattr(run, field)[:, column])


_READING: Final = _line_of("y", ink.TRUTH, "y")
_READING_HAT: Final = SignalLine(Y_HAT, ink.ESTIMATE, reading_estimate)
_FIRST: Final = _line_of(X1, ink.TRUTH, "x")
_FIRST_HAT: Final = _line_of(X1_HAT, ink.ESTIMATE, "x_hat")
_FIRST_ERROR: Final = _line_of_error(_FIRST_HAT, _FIRST)
_SECOND_ERROR: Final = _line_of_error(
    _line_of(X2_HAT, ink.ESTIMATE, "x_hat", 1), _line_of(X2, ink.TRUTH, "x", 1)
)
_OUTPUT: Final = _line_of("z", ink.TRUTH, "z")
_V: Final = SignalLine("V", ink.TRUTH, lambda run: run.V)
_WIDTHS: Final = (
    _line_of(f"{D_HAT} right", ink.ESTIMATE, "d_hat"),
    _line_of(f"{D_HAT} left", ink.OTHER, "d_hat", 1),
)
_LINES: Final = {
    "figure_3": (_READING, _READING_HAT),
    "figure_4": (_line_of_error(_READING_HAT, _READING),),
    "figure_5": (_FIRST, _FIRST_HAT),
    "figure_6": (_FIRST_ERROR,),
    "figure_7": (_SECOND_ERROR,),
    "figure_8": _WIDTHS,
    "tracking": (_OUTPUT, _line_of("\u03b8 desired", ink.REFERENCE, "r")),
    "V": (_V,),
}
_TITLES: Final = {
    **{f"figure_{number}": f"Figure {number}: {words}" for number, words in FIGURES.items()},
    "tracking": "Output z and desired trajectory",
    "V": "V(t), of (30) as printed, of the certificate as repaired",
}


def plot_pair(name: str, runs: RunTrio, reference: str) -> Figure:
    """Plot signals as printed and as repaired, and the first of them from rest as printed.

    Args:
        name: figure_3 to figure_8; tracking, z beside the desired trajectory; or V
        runs: that it shows
        reference: of these runs, in words
    """
    title = f"{add_hats(_TITLES[name])}, {reference}"
    sketch, panels = create_panels([["printed", "repaired"]], title)
    lines = _LINES[name]
    axes, mended = panels.values()
    _plot_lines(axes, lines, runs.begun)
    window = runs.resting.t <= axes.dataLim.x1
    t, value = runs.resting.t[window], lines[0].value(runs.resting)[window]
    axes.plot(t, value, color=ink.PRINTED, linewidth=1.0, label="from rest")
    start = f"started at {X1} = {runs.begun.x[0, 0]:g}"
    finish_panel(axes, f"As printed, {start}", ", ".join(line.name for line in lines))
    if name == "V":
        plot_magnitude(mended, runs.repaired.t, _V.value(runs.repaired), ink.TRUTH, "V")
    else:
        _plot_lines(mended, lines, runs.repaired)
    finish_panel(mended, f"Repaired, {start}", "V" * (name == "V"))
    return sketch


def plot_theorem(runs: tuple[Run, ...], repaired: Run, outcomes: Sequence[Outcome]) -> Figure:
    """Plot Theorem 4.1 with its own law (29).

    Args:
        runs: with d - d^ given, and with it estimated, started outside the zone with d^ = d
        repaired: the example as repaired, started there
        outcomes: of every reading of the theorem
    """
    title = "Theorem 4.1 with its own law (29): d \u2212 d\u0302 given, and estimated"
    sketch, panels = create_panels([["state", "widths", "readings"]], title, height=3.0)
    names = {GIVEN: ink.PRINTED, ESTIMATED: ink.OTHER}
    shown = zip((*runs, repaired), (names | {"repaired": ink.ESTIMATE}).items(), strict=True)
    for run, (name, colour) in shown:
        error = _FIRST_ERROR.value(run)
        panels["state"].plot(run.t, error, color=colour, linewidth=1.0, label=name)
        off = np.abs(run.d_hat - D).max(axis=1)
        panels["widths"].plot(run.t, off, color=colour, label=name)
    words = f"{_FIRST_ERROR.name}, (39), L of (40)"
    finish_panel(panels["state"], words, "error of the state", legend=2)
    words = f"Largest |{D_HAT} \u2212 d|, which began at 0"
    finish_panel(panels["widths"], words, "error [z]", legend=2)
    readings = panels["readings"]
    readings.set_yscale("log")
    for name, colour in names.items():
        errors = sorted(outcome.worst_error for outcome in select_outcomes(outcomes, name))
        finite = np.array(errors)[np.isfinite(errors)]
        readings.plot(np.arange(finite.size) + 1, np.maximum(finite, LEAST), ".", color=colour)
    readings.axhline(RIGHT, color=ink.ZONE, linewidth=1.0, label="right up to here")
    words = "Error of each reading at its end"
    finish_panel(readings, words, "error", "reading, sorted; missing: diverged", 3)
    return sketch


def add_hats(words: str) -> str:
    """Return words with letters in place of x1, x^1, y^ and d^."""
    letters = {
        "x^1": X1_HAT,
        "x^2": X2_HAT,
        "x1": X1,
        "x2": X2,
        "y^": Y_HAT,
        "d^": D_HAT,
        "omega_n": "\u03c9\u2099",
        " pi": "π",
    }
    for plain, letter in letters.items():
        words = words.replace(plain, letter)
    return words


def _plot_lines(axes: Axes, lines: tuple[SignalLine, ...], run: Run) -> None:
    """Plot the lines of a run: oscillating pairs early, an error or the widths over all of it."""
    paired = len(lines) == 2 and lines is not _WIDTHS
    window = run.t <= (EARLY if paired else run.t[-1])
    if lines is _WIDTHS:
        axes.axhline(D, color=ink.TRUTH, linewidth=3.0, alpha=0.25, label="truth")
    for line, dashes in zip(lines, ("-", DASHED if paired else "-"), strict=False):
        value = line.value(run)[window]
        axes.plot(run.t[window], value, color=line.colour, label=line.name, linestyle=dashes)


def plot_silence(t: Floats, outputs: Mapping[str, Floats]) -> Figure:
    """Plot the response from rest to the force u = 5 sin 2 pi t, small responses enlarged.

    Args:
        t: instants [s]
        outputs: z at these instants, by reading of the plant
    """
    title = "Why the sensor is silent: 5 sin 2πt as a force, from rest"
    sketch, panels = create_panels([["all", "all", "inside"]], title, height=3.0)
    everything, inside = panels.values()
    early = t <= EARLY
    for axes in panels.values():
        shade_zone(axes, D, D)
        for (reading, z), colour in zip(outputs.items(), _COLOURS, strict=True):
            if axes is everything or np.abs(z).max() < D:
                axes.plot(t[early], z[early], color=colour, label=add_hats(reading))
    inside.set_ylim(-D / 2, D / 2)
    leaves = "Only with unity DC gain does the output leave the dead zone"
    finish_panel(everything, leaves, "output z", legend=5)
    finish_panel(inside, "The three others, enlarged", legend=0)
    return sketch
