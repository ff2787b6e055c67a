"""Figures of a choice: the Pareto front of rate, noise and disturbance, and what can be known of the widths."""

from __future__ import annotations

from textwrap import fill
from typing import TYPE_CHECKING, Final

import numpy as np

from undeadzone.analysis.certificate.design_file import Design, Knowledge, Point
from undeadzone.analysis.error_dynamics import delta, growth
from undeadzone.analysis.identifiability.linear import DIRECTIONS
from undeadzone.report.style import ESTIMATE, PRINTED, TRUTH, finish, label, sheet
from undeadzone.support.arrays import Floats
from undeadzone.synthesis.assessment import Assessment

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NORMAL: Final = 1.959964  # standard deviations of a 95 % interval
ELLIPSE: Final = 2.447747  # of a 95 % ellipse
PRICES: Final = (("noise", "disturbance"), ("disturbance", "noise"))
LABELS: Final = {
    "noise": "error per rms noise at every sample",
    "disturbance": "error per white disturbance [$\\sqrt{s}$]",
}


def front(design: Design) -> Figure:
    """Rate against noise gain and against disturbance gain, each coloured by the other; the gains chosen and the scenario's own."""
    figure, panels = sheet(
        [[price for price, _ in PRICES]],
        f"The trade: {len(design.front)} certified gains, none better than another in everything",
        height=4.2,
    )
    for price, other in PRICES:
        axes = panels[price]
        x, rate, colour = (
            np.array([getattr(point, name) for point in design.front])
            for name in (price, "rate", other)
        )
        dots = axes.scatter(x, rate, c=np.log10(colour), s=26, cmap="viridis_r", linewidths=0)
        _mark(axes, design.front[0], price, "^", TRUTH, "fastest")
        if design.present is not None:
            _mark(axes, design.present, price, "X", PRINTED, "yours")
        _mark(axes, design.best, price, "*", PRINTED, "chosen", 16)
        _log_ticks(axes)
        axes.margins(0.06)
        finish(
            axes, f"Rate against {price}", "rate along the reference [1/s]", LABELS[price], legend=3
        )
        bar = figure.colorbar(dots, ax=axes, shrink=0.8, pad=0.02)
        ticks = np.linspace(*dots.get_clim(), 5)
        bar.set_ticks(ticks.tolist(), labels=[f"{10**tick:.3g}" for tick in ticks])
        bar.set_label(f"{other} gain")
    return figure


def _log_ticks(axes: Axes) -> None:
    """A logarithmic axis of less than two decades, with plain numbers."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def _mark(
    axes: Axes, point: Point, price: str, marker: str, colour: str, name: str, size: float = 9
) -> None:
    axes.plot(
        [getattr(point, price)],
        [point.rate],
        marker,
        color=colour,
        markersize=size,
        markeredgecolor="white",
        label=name,
        zorder=5,
    )


def ellipses(of: Assessment) -> Figure:
    """The 95 % region of (d_r, d_l) of each output that an optimal estimator reaches after the scenario's duration.

    An ellipse about the truth, or an unbounded strip where only one direction can be known, with the reason in words.
    """
    outputs, sensor, unit = len(of.known), of.problem.sensor, of.problem.scenario.units.output
    names = [f"output {i}" for i in range(outputs)]
    title = f"What {of.problem.scenario.simulation.duration:g} s of readings tell of the widths"
    figure, panels = sheet([names], title, width=max(5.5, 4.6 * outputs), height=5.0)
    for i, (name, known) in enumerate(zip(names, of.known, strict=True)):
        truth = np.array([sensor.right[i], sensor.left[i]])
        axes, bounded = panels[name], known.right and known.left
        if bounded:
            _ellipse(axes, known)
            exact = " (no noise: readings are taken as all but exact)" * (
                not (sensor.noise[i] or sensor.noise_before[i])
            )
            words, off = f"Both can be known{exact}", " − truth"
        else:
            stable = (
                growth(delta(of.problem.model.linear, of.problem.model.Ts), of.problem.model.Ts) < 0
            )
            floor = np.array([of.schedule.high[i], -of.schedule.low[i]]) - (
                of.schedule.levels[i] - truth
            )
            _strip(axes, known, truth, floor if stable else np.zeros(2))
            words, off = "; ".join(known.reasons), ""
        axes.plot(
            *([0.0, 0.0] if bounded else truth), "+", color=TRUTH, markersize=10, label="truth"
        )
        axes.set_aspect("equal")
        words = f"Output {i}: {words}" if outputs > 1 else words[:1].upper() + words[1:]
        finish(
            axes,
            fill(words, 46),
            label(rf"$\hat d_l${off}", unit),
            label(rf"$\hat d_r${off}", unit),
            legend=2,
        )
    return figure


def _ellipse(axes: Axes, known: Knowledge) -> None:
    """The covariance of (d_r, d_l) follows from the deviations of both, of their sum and of their difference."""
    std = known.std
    cross = (std["width"] ** 2 - std["centre"] ** 2) / 4
    values, vectors = np.linalg.eigh([[std["right"] ** 2, cross], [cross, std["left"] ** 2]])
    angle = np.linspace(0.0, 2 * np.pi, 300)
    x, y = (
        ELLIPSE
        * vectors
        @ (np.sqrt(np.maximum(values, 0.0))[:, None] * np.stack([np.cos(angle), np.sin(angle)]))
    )
    axes.fill(x, y, color=ESTIMATE, alpha=0.25, linewidth=0)
    axes.plot(x, y, color=ESTIMATE, label="95 %")
    axes.ticklabel_format(scilimits=(-2, 3))
    size = 1.15 * max(np.abs(x).max(), np.abs(y).max())
    axes.set_xlim(-size, size)
    axes.set_ylim(-size, size)


def _strip(axes: Axes, known: Knowledge, truth: Floats, floor: Floats) -> None:
    """Where one direction g is known, g'd lies between two parallel lines. An edge not reached lies beyond all of z, at least."""
    size = 2.0 * max(float(truth.max()), 1e-12)
    x, y = np.meshgrid(*2 * (np.linspace(0.0, 1.5 * size, 901),))
    direction = next((name for name in ("right", "left", "width") if getattr(known, name)), None)
    if direction == "width":
        floor = np.zeros(2)
    region = np.maximum(0.0 if known.right else floor[0] - x, 0.0 if known.left else floor[1] - y)
    words = (
        f"only d_r > {floor[0]:.3g}, d_l > {floor[1]:.3g}" if floor.any() else "nothing is known"
    )
    if direction is not None:
        g = np.array(DIRECTIONS[direction])
        half = NORMAL * known.std[direction]
        region = np.maximum(
            region, np.abs(g[0] * (x - truth[0]) + g[1] * (y - truth[1])) - max(half, 0.004 * size)
        )
        words = f"95 %: {direction} ± {half:.2g}"
    axes.contourf(x, y, region, levels=[-np.inf, 0.0], colors=[ESTIMATE], alpha=0.25)
    axes.contour(x, y, region, levels=[0.0], colors=[ESTIMATE], linewidths=1.0)
    axes.plot([], [], color=ESTIMATE, label=words)
    axes.set_xlim(0.0, size)
    axes.set_ylim(0.0, size)
