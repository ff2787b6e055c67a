"""Figures of gains: decay rate of the error as gains are scaled, and the trade-offs."""

from __future__ import annotations

from textwrap import fill
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from undeadzone.analysis.certificate.design_file import Design, Knowledge, Point
from undeadzone.analysis.certificate.passivity import Certificate
from undeadzone.analysis.certificate.weights import margin_of_weights
from undeadzone.analysis.convergence.floquet import error_decay_rates
from undeadzone.analysis.error_dynamics import Dynamics, branch_pattern, largest_growth_rate
from undeadzone.linalg.matrices import delta_form
from undeadzone.nonlinearities.sensor import DIRECTIONS
from undeadzone.report import ink
from undeadzone.report.style import axis_label, create_panels, finish_panel
from undeadzone.util.arrays import Floats
from undeadzone.util.text import HALF_95
from undeadzone_design.convergence.falsify import SwitchMode, error_generator
from undeadzone_design.synthesis.assessment import Assessment, Gains

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FACTORS: Final = np.linspace(0.0, 3.0, 1501)  # times the gains
CHOSEN: Final = 500  # index of the factor 1
EVERY: Final = 25  # of the factors: where rates are plotted
NAMES: Final = {"gamma": r"$\gamma$", "L": "$L$"}
ELLIPSE: Final = 2.447747  # of a 95 % ellipse
PRICES: Final = (("noise", "disturbance"), ("disturbance", "noise"))
LABELS: Final = {
    "noise": "error per rms noise at every sample",
    "disturbance": "error per white disturbance [$\\sqrt{s}$]",
}


def root_locus(of: Assessment, gains: Gains) -> Figure:
    """Return the poles of the error while every output is read, as gamma or L is scaled, and
    the rate.

    The rate is that along the reference. Sampled, poles z are drawn as (z - 1) / Ts, which tends
    to s as Ts -> 0. The unit circle is drawn so too.
    """
    dynamics = gains.dynamics
    scaled = ["gamma", "L"] if dynamics.gamma.any() else ["L"]
    title = "Poles of the error while every output is read, and the rate"
    figure, panels = create_panels([[*scaled, "rate"]], title, height=4.0)
    dots: Any = None
    for name in scaled:
        dots = _draw_locus_panel(panels[name], dynamics, name)
    _draw_rates(panels["rate"], of, gains, scaled)
    figure.colorbar(
        dots, ax=[*panels.values()], label="times the gain", shrink=0.7, aspect=30, pad=0.01
    )
    return figure


def _draw_locus_panel(axes: Axes, dynamics: Dynamics, name: str) -> Any:
    """Draw the poles as a gain is scaled, slow poles enlarged, and return the dots for a colour
    bar.
    """
    Ts = dynamics.Ts
    poles = np.stack(
        [_error_poles(dynamics, _scale_gain(dynamics, name, factor)) for factor in FACTORS]
    )
    silent = np.linalg.eigvals(dynamics.A[0])
    dots = _draw_locus(axes, poles, silent, name)
    _shade_unstable(axes, np.concatenate([poles.ravel(), silent]), Ts)
    slow = 1.5 * max(np.abs(silent).max(), np.abs(poles[CHOSEN].real).min())
    if slow > 0 and np.ptp(poles.real) > 8 * slow:
        _enlarge_slow(axes, poles, silent, name, Ts, slow)
    if Ts is None:
        x_label = "Re s [1/s]"
        y_label = "Im s [rad/s]"
    else:
        x_label = "Re (z − 1)/Ts [1/s]"
        y_label = "Im (z − 1)/Ts [1/s]"
    finish_panel(axes, f"{NAMES[name]} scaled", y_label, x_label, legend=3)
    return dots


def _draw_locus(axes: Axes, poles: np.ndarray, silent: np.ndarray, name: str) -> Any:
    """Draw poles (factors x poles) coloured by the factor of a gain, and the poles of a silent
    sensor.
    """
    factors = np.repeat(FACTORS, poles.shape[1])
    dots = axes.scatter(poles.real, poles.imag, c=factors, s=3, cmap="viridis", linewidths=0)
    dots.set_rasterized(True)  # thousands
    _mark_poles(axes, silent, "s", ink.TRUTH, "silent", fillstyle="none", markersize=8)
    _mark_poles(axes, poles[0], "x", ink.TRUTH, f"{NAMES[name]} = 0", markersize=6)
    _mark_poles(axes, poles[CHOSEN], "o", ink.PRINTED, "chosen", markersize=6)
    return dots


def _mark_poles(
    axes: Axes, poles: np.ndarray, marker: str, colour: str, name: str, **style: Any
) -> None:
    """Mark poles in the complex plane."""
    axes.plot(poles.real, poles.imag, marker, color=colour, label=name, **style)


def _enlarge_slow(
    axes: Axes, poles: np.ndarray, silent: np.ndarray, name: str, Ts: float | None, size: float
) -> None:
    """Enlarge the slow poles below the real axis (size: of the largest slow pole [1/s])."""
    bottom, top = axes.get_ylim()
    axes.set_ylim(1.6 * bottom, top)
    inset = axes.inset_axes((0.14, 0.06, 0.64, 0.3))
    _draw_locus(inset, poles, silent, name)
    near = np.concatenate([poles[poles.real > -2 * size], silent])
    _shade_unstable(inset, np.append(near, -2 * size), Ts)
    inset.set_xlim(-2 * size, 0.3 * size)
    inset.tick_params(labelsize=6.5, pad=1)
    axes.indicate_inset_zoom(inset, edgecolor=ink.ZONE)


def _scale_gain(dynamics: Dynamics, name: str, factor: float) -> Dynamics:
    """Return the dynamics with a gain, gamma or L, scaled."""
    return dynamics._replace(**{name: factor * getattr(dynamics, name)})


def _error_poles(dynamics: Dynamics, scaled: Dynamics) -> np.ndarray:
    """Return the poles of x~ and of the widths that `dynamics` adapts, under scaled gains.

    Every output is read on its right side.
    """
    outputs = dynamics.C.shape[0]
    S = branch_pattern((1,) * outputs)  # which width each output's reading holds
    F = error_generator(scaled, SwitchMode(np.ones(1), S, np.ones(outputs), 0.0))
    adapted = S.any(axis=0) & (np.diag(dynamics.gamma) > 0)
    selected = np.concatenate([np.ones(len(dynamics.A[0]), bool), adapted])
    return np.asarray(np.linalg.eigvals(F[np.ix_(selected, selected)]))


def _shade_unstable(axes: Axes, poles: np.ndarray, Ts: float | None) -> None:
    """Set limits that contain all poles and some of the unstable region, and shade that
    region.
    """
    size = max(np.ptp(poles.real), np.ptp(poles.imag), 1e-3 * np.abs(poles).max(), 1e-300)
    left = poles.real.min() - 0.08 * size
    right = max(poles.real.max(), 0.0) + 0.12 * size
    top = np.abs(poles.imag).max() + 0.15 * size
    x, y = np.meshgrid(np.linspace(left, right, 400), np.linspace(-2 * top, 2 * top, 400))
    growth = x if Ts is None else (np.abs(1 + Ts * (x + 1j * y)) - 1) / Ts
    axes.contourf(x, y, growth, levels=[0.0, np.inf], colors=[ink.FORBIDDEN], zorder=0)
    axes.contour(x, y, growth, levels=[0.0], colors=[ink.PRINTED], linewidths=1.0, zorder=1)
    axes.set_xlim(left, right)
    axes.set_ylim(-top, top)


def _draw_rates(axes: Axes, of: Assessment, gains: Gains, scaled: list[str]) -> None:
    """Draw the rate over the factor of each gain: a line if V proves it, else dots."""
    for name, colour in zip(scaled, (ink.ESTIMATE, ink.READING), strict=False):
        first = EVERY if name == "gamma" else 0  # with gamma = 0 the error holds no widths
        factors = FACTORS[first::EVERY]
        rate = np.array([_rate_at_scale(of, gains, name, factor) for factor in factors])
        proved = np.array(
            [_is_proved_with_scaled_gain(gains.certificate, name, factor) for factor in factors]
        )
        certified = np.where(proved, rate, np.nan)
        axes.plot(factors, rate, ":", color=colour, linewidth=1.4)
        axes.plot(factors, certified, color=colour, linewidth=2.0, label=f"{NAMES[name]} alone")
    axes.plot([1.0], [gains.rates.rate], "o", color=ink.PRINTED, markersize=6)
    axes.axhline(0.0, color=ink.TRUTH, linewidth=0.8)
    y_label = "rate along the reference [1/s]"
    finish_panel(axes, "Rate (dotted: not certified)", y_label, "times the gain", legend=2)


def _rate_at_scale(of: Assessment, gains: Gains, name: str, factor: float) -> float:
    """Return the rate [1/s] along the reference with a gain scaled."""
    scaled = gains._replace(**{name: factor * getattr(gains, name)})
    jump = of.problem.sensor.kind
    return error_decay_rates(
        of.problem.model.linear, scaled.L, scaled.gamma, of.schedule, jump == "jump"
    ).rate


def _is_proved_with_scaled_gain(proof: Certificate, name: str, factor: float) -> bool:
    """Return whether the weights of a certificate also prove it with a gain scaled."""
    if not proof.margin > -np.inf:
        return False
    return margin_of_weights(_scale_gain(proof.dynamics, name, factor), proof.W)[0] > 0


def plot_front(design: Design) -> Figure:
    """Return rate against noise gain and against disturbance gain, each coloured by the
    opposite gain.

    The gains chosen, the fastest and the scenario's own are marked.
    """
    count = f"{len(design.front)} certified gains"
    title = f"The trade: {count}, none better than another in everything"
    figure, panels = create_panels([[price for price, _ in PRICES]], title, height=4.2)
    for price, other in PRICES:
        axes = panels[price]
        x = _front_scores(design, price)
        rate = _front_scores(design, "rate")
        colour = np.log10(_front_scores(design, other))
        dots = axes.scatter(x, rate, c=colour, s=26, cmap="viridis_r", linewidths=0)
        _mark_front_point(axes, design.front[0], price, "^", ink.TRUTH, "fastest")
        if design.present is not None:
            _mark_front_point(axes, design.present, price, "X", ink.PRINTED, "yours")
        _mark_front_point(axes, design.best, price, "*", ink.PRINTED, "chosen", 16)
        _use_log_ticks(axes)
        axes.margins(0.06)
        y_label = "rate along the reference [1/s]"
        finish_panel(axes, f"Rate against {price}", y_label, LABELS[price], legend=3)
        bar = figure.colorbar(dots, ax=axes, shrink=0.8, pad=0.02)
        ticks = np.linspace(*dots.get_clim(), 5)
        bar.set_ticks(ticks.tolist(), labels=[f"{10**tick:.3g}" for tick in ticks])
        bar.set_label(f"{other} gain")
    return figure


def _front_scores(design: Design, name: str) -> Floats:
    """Return the scores of the gains of the front in one respect."""
    return np.array([getattr(point, name) for point in design.front])


def _use_log_ticks(axes: Axes) -> None:
    """Set a logarithmic axis of less than two decades, with plain numbers."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def _mark_front_point(
    axes: Axes, point: Point, price: str, marker: str, colour: str, name: str, size: float = 9
) -> None:
    """Mark a point of the front (price: the quantity on the axis to the right)."""
    place = [getattr(point, price)], [point.rate]
    on_top: Any = {"markeredgecolor": "white", "zorder": 5}
    axes.plot(*place, marker, color=colour, markersize=size, label=name, **on_top)


def plot_ellipses(of: Assessment) -> Figure:
    """Return the 95 % region of (d_r, d_l) of each output that an optimal estimator reaches in
    the end.

    An ellipse about the truth, or an unbounded strip where only one direction can be known, with
    the reason in words.
    """
    outputs = len(of.known)
    names = [f"output {i}" for i in range(outputs)]
    title = f"What {of.problem.scenario.simulation.duration:g} s of readings show of the widths"
    figure, panels = create_panels([names], title, width=max(5.5, 4.6 * outputs), height=5.0)
    for i, name in enumerate(names):
        draw_width_region(panels[name], of, i)
    return figure


def draw_width_region(axes: Axes, of: Assessment, i: int) -> None:
    """Draw the 95 % region of the widths of output i, with its title and labels."""
    known = of.known[i]
    sensor = of.problem.sensor
    unit = of.problem.scenario.units.output
    truth = np.array([sensor.right[i], sensor.left[i]])
    if known.right and known.left:
        _draw_ellipse(axes, known)
        words = "Both can be known"
        off = " − truth"
        if not (sensor.noise[i] or sensor.noise_before[i]):
            words += " (no noise: readings are taken as all but exact)"
        axes.plot(0.0, 0.0, "+", color=ink.TRUTH, markersize=10, label="truth")
    else:
        _shade_strip(axes, known, truth, _width_lower_bounds(of, i, truth))
        words = "; ".join(known.reasons)
        off = ""
        axes.plot(*truth, "+", color=ink.TRUTH, markersize=10, label="truth")
    if known.second is not None:
        other = np.array([known.second["right"], known.second["left"]])
        place = other - truth if known.right and known.left else other
        axes.plot(*place, "x", color=ink.TRUTH, markersize=8, label="another, same readings")
    axes.set_aspect("equal")
    title = words[:1].upper() + words[1:]
    if len(of.known) > 1:
        title = f"Output {i}: {words}"
    y_label, x_label = (axis_label(rf"$\hat d_{edge}${off}", unit) for edge in "lr")
    finish_panel(axes, fill(title, 46), y_label, x_label, legend=2)


def _width_lower_bounds(of: Assessment, i: int, truth: Floats) -> Floats:
    """Return the lower bound of (d_r, d_l) of output i implied by an unreached edge, or 0.

    Censored samples imply it only for a stable model, whose output is known in the end.
    """
    model = of.problem.model
    schedule = of.schedule
    if not largest_growth_rate(delta_form(model.linear, model.Ts).A, model.Ts) < 0:
        return np.zeros(2)
    return np.array([schedule.high[i], -schedule.low[i]]) - (schedule.levels[i] - truth)


def _draw_ellipse(axes: Axes, known: Knowledge) -> None:
    """Draw the ellipse of 95 % about the truth, limits included."""
    x, y = ellipse_border(known.std)
    axes.fill(x, y, color=ink.ESTIMATE, alpha=0.25, linewidth=0)
    axes.plot(x, y, color=ink.ESTIMATE, label="95 %")
    axes.ticklabel_format(style="plain")  # a factor would stand beneath the title
    axes.locator_params(axis="x", nbins=4)
    size = 1.15 * max(np.abs(x).max(), np.abs(y).max())
    axes.set_xlim(-size, size)
    axes.set_ylim(-size, size)


def ellipse_border(std: dict[str, float]) -> Floats:
    """Return the border (2 x points) of the 95 % ellipse of (d_r, d_l) about the truth.

    The covariance follows from the deviations of both, of the width and of the centre.
    """
    cross = std["width"] ** 2 / 4 - std["centre"] ** 2
    values, vectors = np.linalg.eigh([[std["right"] ** 2, cross], [cross, std["left"] ** 2]])
    angle = np.linspace(0.0, 2 * np.pi, 300)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    semi_axes = np.sqrt(np.maximum(values, 0.0))[:, None]
    return np.asarray(ELLIPSE * vectors @ (semi_axes * circle))


def _shade_strip(axes: Axes, known: Knowledge, truth: Floats, floor: Floats) -> None:
    """Shade the region of widths that readings leave open if at most one direction is known.

    If a direction g is known, g'd lies between two parallel lines. An edge that was not reached
    lies at least beyond all of z.
    """
    size = 2.0 * max(float(truth.max()), 1e-12)
    grid = np.linspace(0.0, 1.5 * size, 901)
    x, y = np.meshgrid(grid, grid)
    direction = next((name for name in ("right", "left", "width") if getattr(known, name)), None)
    if direction == "width":
        floor = np.zeros(2)
    beyond_right = 0.0 if known.right else floor[0] - x
    beyond_left = 0.0 if known.left else floor[1] - y
    region = np.maximum(beyond_right, beyond_left)  # negative inside
    if direction is not None:
        g = np.array(DIRECTIONS[direction])
        half = HALF_95 * known.std[direction]
        distance = np.abs(g[0] * (x - truth[0]) + g[1] * (y - truth[1]))
        region = np.maximum(region, distance - max(half, 0.004 * size))
        words = f"95 %: {direction} ± {half:.2g}"
    elif floor.any():
        words = f"only d_r > {floor[0]:.3g}, d_l > {floor[1]:.3g}"
    else:
        words = "nothing is known"
    axes.contourf(x, y, region, levels=[-np.inf, 0.0], colors=[ink.ESTIMATE], alpha=0.25)
    axes.contour(x, y, region, levels=[0.0], colors=[ink.ESTIMATE], linewidths=1.0)
    axes.plot([], [], color=ink.ESTIMATE, label=words)
    axes.set_xlim(0.0, size)
    axes.set_ylim(0.0, size)
