"""Figures of how fast an error dies: its poles and its rate as gains are scaled."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from undeadzone.analysis.certificate.passivity import Certificate
from undeadzone.analysis.certificate.weights import margin
from undeadzone.analysis.convergence.falsify import Mode, generator
from undeadzone.analysis.convergence.floquet import rates
from undeadzone.analysis.error_dynamics import Dynamics, pattern
from undeadzone.report.style import (
    ESTIMATE,
    FORBIDDEN,
    PRINTED,
    READING,
    TRUTH,
    ZONE,
    finish,
    sheet,
)
from undeadzone.synthesis.assessment import Assessment, Gains

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FACTORS: Final = np.linspace(0.0, 3.0, 1501)  # times the gains
CHOSEN: Final = 500  # where the factor is 1
EVERY: Final = 25  # of the factors: where rates are shown
NAMES: Final = {"gamma": r"$\gamma$", "L": "$L$"}


def root_locus(of: Assessment, gains: Gains) -> Figure:
    """Poles of the error while every output is read, as gamma or L is scaled, and the rate.

    The rate is that along the reference. Sampled, poles z are drawn as (z - 1) / Ts, which tends
    to s as Ts -> 0; the unit circle is drawn so too.
    """
    dynamics = gains.dynamics
    scaled = ["gamma", "L"] if dynamics.gamma.any() else ["L"]
    title = "Poles of the error while every output is read, and the rate"
    figure, panels = sheet([[*scaled, "rate"]], title, height=4.0)
    dots: Any = None
    for name in scaled:
        dots = _locus_panel(panels[name], dynamics, name)
    _rates(panels["rate"], of, gains, scaled)
    figure.colorbar(
        dots, ax=[*panels.values()], label="times the gain", shrink=0.7, aspect=30, pad=0.01
    )
    return figure


def _locus_panel(axes: Axes, dynamics: Dynamics, name: str) -> Any:
    """The poles as one gain is scaled, slow ones enlarged; returns the dots for a colour bar."""
    Ts = dynamics.Ts
    poles = np.stack([_poles(dynamics, _scaled(dynamics, name, factor)) for factor in FACTORS])
    silent = np.linalg.eigvals(dynamics.A[0])
    dots = _locus(axes, poles, silent, name)
    _forbid_unstable(axes, np.concatenate([poles.ravel(), silent]), Ts)
    slow = 1.5 * max(np.abs(silent).max(), np.abs(poles[CHOSEN].real).min())
    if slow > 0 and np.ptp(poles.real) > 8 * slow:
        _enlarge_slow(axes, poles, silent, name, Ts, slow)
    if Ts is None:
        x_label, y_label = "Re s [1/s]", "Im s [rad/s]"
    else:
        x_label, y_label = "Re (z − 1)/Ts [1/s]", "Im (z − 1)/Ts [1/s]"
    finish(axes, f"{NAMES[name]} scaled", y_label, x_label, legend=3)
    return dots


def _locus(axes: Axes, poles: np.ndarray, silent: np.ndarray, name: str) -> Any:
    """Poles (factors x poles) coloured by the factor of a gain, and those of a silent sensor."""
    factors = np.repeat(FACTORS, poles.shape[1])
    dots = axes.scatter(poles.real, poles.imag, c=factors, s=3, cmap="viridis", linewidths=0)
    dots.set_rasterized(True)  # thousands
    without, chosen = poles[0], poles[CHOSEN]
    axes.plot(
        silent.real, silent.imag, "s", color=TRUTH, fillstyle="none", markersize=8, label="silent"
    )
    axes.plot(
        without.real, without.imag, "x", color=TRUTH, markersize=6, label=f"{NAMES[name]} = 0"
    )
    axes.plot(chosen.real, chosen.imag, "o", color=PRINTED, markersize=6, label="chosen")
    return dots


def _enlarge_slow(
    axes: Axes, poles: np.ndarray, silent: np.ndarray, name: str, Ts: float | None, size: float
) -> None:
    """Enlarge the slow poles below the real axis; size [1/s]: of the largest of them."""
    bottom, top = axes.get_ylim()
    axes.set_ylim(1.6 * bottom, top)
    inset = axes.inset_axes((0.14, 0.06, 0.64, 0.3))
    _locus(inset, poles, silent, name)
    near = np.concatenate([poles[poles.real > -2 * size], silent])
    _forbid_unstable(inset, np.append(near, -2 * size), Ts)
    inset.set_xlim(-2 * size, 0.3 * size)
    inset.tick_params(labelsize=6.5, pad=1)
    axes.indicate_inset_zoom(inset, edgecolor=ZONE)


def _scaled(dynamics: Dynamics, name: str, factor: float) -> Dynamics:
    """The dynamics with one gain, gamma or L, scaled."""
    return dynamics._replace(**{name: factor * getattr(dynamics, name)})


def _poles(dynamics: Dynamics, scaled: Dynamics) -> np.ndarray:
    """Poles of x~ and of the widths that `dynamics` adapts, under scaled gains.

    Every output is read on its right side.
    """
    outputs = dynamics.C.shape[0]
    S = pattern((1,) * outputs)  # which width each output's reading holds
    F = generator(scaled, Mode(np.ones(1), S, np.ones(outputs), 0.0))
    adapted = S.any(axis=0) & (np.diag(dynamics.gamma) > 0)
    kept = np.concatenate([np.ones(len(dynamics.A[0]), bool), adapted])
    return np.asarray(np.linalg.eigvals(F[np.ix_(kept, kept)]))


def _forbid_unstable(axes: Axes, poles: np.ndarray, Ts: float | None) -> None:
    """Limits that hold all poles and some of the unstable region, which is shaded."""
    size = max(np.ptp(poles.real), np.ptp(poles.imag), 1e-3 * np.abs(poles).max(), 1e-300)
    left = poles.real.min() - 0.08 * size
    right = max(poles.real.max(), 0.0) + 0.12 * size
    top = np.abs(poles.imag).max() + 0.15 * size
    x, y = np.meshgrid(np.linspace(left, right, 400), np.linspace(-2 * top, 2 * top, 400))
    growth = x if Ts is None else (np.abs(1 + Ts * (x + 1j * y)) - 1) / Ts
    axes.contourf(x, y, growth, levels=[0.0, np.inf], colors=[FORBIDDEN], zorder=0)
    axes.contour(x, y, growth, levels=[0.0], colors=[PRINTED], linewidths=1.0, zorder=1)
    axes.set_xlim(left, right)
    axes.set_ylim(-top, top)


def _rates(axes: Axes, of: Assessment, gains: Gains, scaled: list[str]) -> None:
    """The rate over the factor of each gain: a line where V proves it, dots elsewhere."""
    for name, colour in zip(scaled, (ESTIMATE, READING), strict=False):
        first = EVERY if name == "gamma" else 0  # with gamma = 0 the error holds no widths
        factors = FACTORS[first::EVERY]
        rate = np.array([_rate(of, gains, name, factor) for factor in factors])
        proved = np.array([_proved(gains.certificate, name, factor) for factor in factors])
        certified = np.where(proved, rate, np.nan)
        axes.plot(factors, rate, ":", color=colour, linewidth=1.4)
        axes.plot(factors, certified, color=colour, linewidth=2.0, label=f"{NAMES[name]} alone")
    axes.plot([1.0], [gains.rates.rate], "o", color=PRINTED, markersize=6)
    axes.axhline(0.0, color=TRUTH, linewidth=0.8)
    y_label = "rate along the reference [1/s]"
    finish(axes, "Rate (dotted: not certified)", y_label, "times the gain", legend=2)


def _rate(of: Assessment, gains: Gains, name: str, factor: float) -> float:
    """The rate [1/s] along the reference with one gain scaled."""
    L, gamma = gains.L, gains.gamma
    if name == "L":
        L = factor * L
    else:
        gamma = factor * gamma
    jump = of.problem.sensor.kind == "jump"
    return rates(of.problem.model.linear, L, gamma, of.schedule, jump).rate


def _proved(proof: Certificate, name: str, factor: float) -> bool:
    """Whether the weights of a certificate prove it with one gain scaled, too."""
    if not proof.margin > -np.inf:
        return False
    return margin(_scaled(proof.dynamics, name, factor), proof.W)[0] > 0
