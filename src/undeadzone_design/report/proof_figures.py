"""Figures of a certificate: positive realness over frequency, V along the worst trajectories."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from undeadzone.analysis.certificate.design_file import Design
from undeadzone.analysis.certificate.passivity import Certificate, recheck_proof
from undeadzone.analysis.certificate.weights import frequency_response
from undeadzone.analysis.error_dynamics import Dynamics, Storage, build_error_dynamics
from undeadzone.report import ink
from undeadzone.report.style import FLOOR, create_panels, finish_panel
from undeadzone.util.arrays import Floats
from undeadzone_design.convergence.falsify import SwitchMode
from undeadzone_design.convergence.trajectories import Trajectory
from undeadzone_design.synthesis.assessment import Attacks, Gains

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DRAWN_DESIGN: Final = (__name__, "of_design", "panel_of_design")  # for `uz.plot`
POINTS: Final = 2000  # frequencies of a curve
STYLES: Final[dict[str, dict[str, Any]]] = {
    "random": {"color": "#b9bec6", "linewidth": 0.8},
    "adversary": {"color": ink.PRINTED, "linewidth": 1.8},
    "fair adversary": {"color": ink.READING, "linewidth": 1.8},
    "reference": {"color": ink.ESTIMATE, "linewidth": 1.8},
}


def recheck_design(design: Design) -> Certificate:
    """Return the certificate of a design, checked again by eigenvalues alone."""
    errors = build_error_dynamics(design.model, design.L, design.gamma, design.Ts)
    V = Storage(np.array(design.P), np.array(design.W), errors.gamma)
    check = recheck_proof(errors, V.P, V.W)
    return Certificate(check.proved, "", design.margin, design.frequency, V, errors, check)


def of_design(design: Design) -> Figure:
    """Return the proof of a design over frequency."""
    return plot_positive_realness(recheck_design(design))


def panel_of_design(axes: Axes, design: Design) -> None:
    """Draw the least real part of a design's proof over frequency."""
    draw_least_real_part(axes, recheck_design(design))


def plot_positive_realness(proof: Certificate) -> Figure:
    """Return 1 + G(jw) and its real part over frequency.

    For several outputs the eigenvalues of its Hermitian part under the weights W. Sampled,
    1 + G - Ts gamma / 2 on the unit circle. The model must be stable: the margin finite.
    """
    w, worst_at, H = _response_curve(proof)
    what = "1 + G" if proof.dynamics.Ts is None else "1 + G − Ts γ/2"
    if H.shape[1] > 1:
        figure, panels = create_panels([["real"]], _realness_verdict(proof, worst_at), height=4.0)
        words = f"Eigenvalues of the Hermitian part of $W^{{1/2}}$({what})$W^{{-1/2}}$"
    else:
        worst = _response_under_weights(proof.dynamics, proof.W, np.array([worst_at]))[0]
        rows = [["curve", "real"]]
        if np.abs(H).max() > 15 * abs(proof.margin):
            rows = [["curve", "zoom", "real"]]
        figure, panels = create_panels(rows, _realness_verdict(proof, worst_at), height=4.0)
        _draw_nyquist_curves(panels, H[:, 0, 0], worst[0, 0], proof, what)
        words = f"Re ({what})"
    _draw_eigenvalues(panels["real"], w, H, proof.margin, worst_at)
    finish_panel(panels["real"], f"{words} over frequency", "", "ω [rad/s]", legend=0)
    return figure


def draw_least_real_part(axes: Axes, proof: Certificate) -> None:
    """Draw the real part of 1 + G, or the eigenvalues of its Hermitian part, over frequency."""
    w, worst_at, H = _response_curve(proof)
    _draw_eigenvalues(axes, w, H, proof.margin, worst_at)
    finish_panel(axes, _realness_verdict(proof, worst_at), "", "ω [rad/s]", legend=0)


def _realness_verdict(proof: Certificate, worst_at: float) -> str:
    """Return the least real part, its frequency [rad/s], and whether it certifies, as text."""
    at = "for ω → ∞" if np.isinf(worst_at) else f"at {worst_at:.4g} rad/s"
    verdict = "certified" if proof.certified else "not certified"
    return f"Positive realness: the least real part is {proof.margin:.4g} {at}; {verdict}"


def _response_curve(proof: Certificate) -> tuple[Floats, float, np.ndarray]:
    """Return frequencies, that of the least real part (inf without one), and the responses."""
    w = _curve_frequencies(proof.dynamics)
    worst_at = np.inf if proof.frequency is None else proof.frequency
    return w, worst_at, _response_under_weights(proof.dynamics, proof.W, w)


def _curve_frequencies(errors: Dynamics) -> Floats:
    """Return frequencies [rad/s] about all poles, up to the Nyquist frequency if sampled."""
    poles = np.abs(np.linalg.eigvals(errors.A[0]))
    highest = np.inf if errors.Ts is None else np.pi / errors.Ts
    return np.geomspace(1e-2 * poles.min(), min(1e2 * poles.max(), highest), POINTS)


def _response_under_weights(errors: Dynamics, W: Floats, w: Floats) -> np.ndarray:
    """Return W^(1/2) (1 + G - Ts S Gamma S'/2) W^(-1/2) at frequencies w <= inf [rad/s]."""
    Ts = errors.Ts
    root = np.sqrt(W)
    at_infinity = np.eye(root.size) - errors.largest_gain_steps[0] / 2
    H = frequency_response(errors.A[0], errors.C * root[:, None], errors.L / root, at_infinity, Ts)
    return H.response_values(w if Ts is None else 2 / Ts * np.tan(w * Ts / 2))


def _draw_nyquist_curves(
    panels: dict[str, Axes], curve: np.ndarray, worst: complex, proof: Certificate, what: str
) -> None:
    """Draw the curve of a single output, enlarged around its worst point if that is too small."""
    axes = panels["curve"]
    _draw_nyquist_curve(axes, curve, worst)
    finish_panel(axes, f"Nyquist curve of {what}", "Im", "Re", legend=0)
    if abs(curve[0] - curve[-1]) > 0.2 * np.abs(curve).max():
        _name_point(axes, curve[0], "ω = 0")
        continuous = proof.dynamics.Ts is None
        _name_point(axes, curve[-1], "ω → ∞" if continuous else "ω = π/Ts")
    if "zoom" in panels:
        _draw_nyquist_curve(panels["zoom"], curve, worst)
        _zoom_to_worst(panels["zoom"], curve, worst, abs(proof.margin))
        finish_panel(panels["zoom"], "The same, enlarged", "", "Re", legend=0)


def _name_point(axes: Axes, point: complex, name: str) -> None:
    """Write a name beside a point of the complex plane."""
    place = (point.real, point.imag)
    axes.annotate(name, place, (4, 4), textcoords="offset points", fontsize=8)


def _draw_nyquist_curve(axes: Axes, curve: np.ndarray, worst: complex) -> None:
    """Draw a curve and its mirror image in the complex plane, with shaded left half."""
    size = max(np.ptp(curve.real), np.abs(curve).max(), 1e-9)
    left = min(0.0, curve.real.min()) - 0.15 * size
    axes.axvspan(left, 0.0, color=ink.FORBIDDEN, linewidth=0)
    axes.axvline(0.0, color=ink.PRINTED, linewidth=1.0)
    axes.plot(curve.real, -curve.imag, color=ink.ESTIMATE, alpha=0.3)
    axes.plot(curve.real, curve.imag, color=ink.ESTIMATE)
    axes.plot([worst.real], [worst.imag], "o", color=ink.PRINTED, zorder=5)
    axes.set_xlim(left, curve.real.max() + 0.12 * size)
    top = max(1.1 * float(np.abs(curve.imag).max()), 0.3 * size)
    axes.set_ylim(-top, top)


def _zoom_to_worst(axes: Axes, curve: np.ndarray, worst: complex, size: float) -> None:
    """Set limits around the worst point, some times `size` wide."""
    near = curve[np.abs(curve.real - worst.real) < 4 * size]
    tall = max(float(np.abs(near.imag - worst.imag).max(initial=0.0)), size)
    axes.set_xlim(worst.real - 3 * size, worst.real + 6 * size)
    axes.set_ylim(worst.imag - tall, worst.imag + tall)


def _draw_eigenvalues(axes: Axes, w: Floats, H: np.ndarray, least: float, worst_at: float) -> None:
    """Draw the eigenvalues of Herm H over frequency.

    The least of them, which stands out, must stay above the shaded part.
    """
    values = np.linalg.eigvalsh((H + H.conj().transpose(0, 2, 1)) / 2)
    top = max(1.5, min(float(values.max()), 5 * abs(least), 10.0)) * 1.1
    bottom = min(0.0, least)
    low = bottom - 0.12 * (top - bottom)
    axes.set_xscale("log")
    axes.axhspan(low, 0.0, color=ink.FORBIDDEN, linewidth=0)
    axes.plot(w, values[:, 1:], color=ink.ESTIMATE, alpha=0.35)
    axes.plot(w, values[:, 0], color=ink.ESTIMATE)
    if w[0] <= worst_at <= w[-1]:
        axes.plot([worst_at], [least], "o", color=ink.PRINTED, clip_on=False, zorder=5)
    else:
        axes.axhline(least, color=ink.PRINTED, linestyle=":")
    axes.set_ylim(low, top)


def plot_courses(gains: Gains, tried: Attacks) -> Figure:
    """Return V along random, adversarial and planned switching.

    Where V can be made to rise, the attack, and a growing cycle if one was found.
    """
    rising = {course.kind: course for course in tried.courses if course.kind not in STYLES}
    rows = [["V"] * max(1, len(rising))]
    if rising:
        rows.append([*rising])
    verdict = "can be made to rise" if tried.attack.broken else "never rises"
    count = f"{tried.attack.trajectories:,} random and adversarial trajectories tried"
    figure, panels = create_panels(rows, f"V {verdict}: {count}", height=3.6)
    _draw_decay(panels["V"], gains, tried)
    titles = {
        "attack": f"The attack: {_describe_mode(tried.attack.mode)}",
        "cycle": "A cycle of sides along which the error grows for ever",
    }
    for kind, course in rising.items():
        _draw_rise(panels[kind], course, titles[kind])
    return figure


def _draw_decay(axes: Axes, gains: Gains, tried: Attacks) -> None:
    """Draw V relative to its start along every trajectory from the same random error."""
    axes.set_yscale("log")
    named = set[str]()
    for course in tried.courses:
        if course.kind not in STYLES:
            continue
        value = np.where(course.V > FLOOR, course.V, np.nan)
        name = None if course.kind in named else course.kind
        axes.plot(course.t, value, label=name, **STYLES[course.kind])
        named.add(course.kind)
    t = tried.courses[0].t
    decay = np.exp(-2 * gains.rates.rate * t)
    axes.plot(t, decay, color=ink.TRUTH, linewidth=1.0, linestyle="--", label=r"$e^{-2\,rate\,t}$")
    axes.set_xlim(0.0, t[-1])
    finish_panel(axes, "V / V(0) from one random error", "", legend=5)


def _draw_rise(axes: Axes, course: Trajectory, title: str) -> None:
    """Draw V along a trajectory on which V rises: in percent if little, else logarithmic."""
    if course.V.max() > 10:
        level = 1.0
        value = course.V
        scale = "log"
        y_label = "V / V(0)"
    else:
        level = 0.0
        value = 100 * (course.V - 1)
        scale = "linear"
        y_label = "rise of V [%]"
    axes.axhline(level, color=ink.TRUTH, linewidth=0.8)
    axes.plot(course.t, value, color=ink.PRINTED, linewidth=1.8)
    axes.set_yscale(scale)
    finish_panel(axes, title, y_label, legend=0)


def _describe_mode(mode: SwitchMode) -> str:
    """Return the branches that a mode reads, and their duration, as text."""
    names = {1: "right", 0: "silent", -1: "left"}
    sides = [names[int(row.sum())] for row in mode.S]
    outputs = sides[0]
    if len(sides) > 1:
        outputs = ", ".join(f"output {i} {side}" for i, side in enumerate(sides))
    return f"{outputs} for {mode.seconds:.3g} s"
