"""Figures of a certificate: root locus of the modes, positive realness over frequency, V along the worst trajectories."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from undeadzone.analysis.certificate.passivity import margin
from undeadzone.analysis.convergence.falsify import Mode, generator
from undeadzone.analysis.convergence.floquet import rates
from undeadzone.analysis.error_dynamics import Dynamics, pattern
from undeadzone.report.style import ESTIMATE, FLOOR, PRINTED, READING, TRUTH, ZONE, finish, sheet
from undeadzone.support.arrays import Floats
from undeadzone.synthesis.assessment import Assessment, Attacks, Gains

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FACTORS: Final = np.linspace(0.0, 3.0, 1501)  # times the gains
CHOSEN: Final = 500  # where the factor is 1
EVERY: Final = 25  # of the factors: where rates are shown
FORBIDDEN: Final = "#f3d9cc"  # where a pole is unstable, or 1 + G not positive real
NAMES: Final = {"gamma": r"$\gamma$", "L": "$L$"}


def root_locus(of: Assessment, found: Gains) -> Figure:
    """Eigenvalues of the error while every output is read, as gamma or L is scaled, and the rate along the reference.

    Sampled, eigenvalues z are drawn as (z - 1) / Ts, which tends to s as Ts -> 0; the unit circle is drawn so too.
    """
    given = found.dynamics
    scaled = ["gamma", "L"] if given.gamma.any() else ["L"]
    names = (
        ("Re s [1/s]", "Im s [rad/s]")
        if given.Ts is None
        else ("Re (z − 1)/Ts [1/s]", "Im (z − 1)/Ts [1/s]")
    )
    figure, panels = sheet(
        [[*scaled, "rate"]],
        "Poles of the error while every output is read, and the rate",
        height=4.0,
    )
    dots: Any = None
    for what in scaled:
        poles = np.stack([_poles(given, _scaled(given, what, factor)) for factor in FACTORS])
        silent = np.linalg.eigvals(given.A[0])
        axes = panels[what]
        dots = _locus(axes, poles, silent, what)
        _forbid_unstable(axes, np.concatenate([poles.ravel(), silent]), given.Ts)
        slow = 1.5 * max(np.abs(silent).max(), np.abs(poles[CHOSEN].real).min())
        if slow > 0 and np.ptp(poles.real) > 8 * slow:
            _slow(axes, poles, silent, what, given.Ts, slow)
        finish(axes, f"{NAMES[what]} scaled", names[1], names[0], legend=3)
    _rates(panels["rate"], of, found, scaled)
    figure.colorbar(
        dots, ax=[*panels.values()], label="times the gain", shrink=0.7, aspect=30, pad=0.01
    )
    return figure


def _locus(axes: Axes, poles: np.ndarray, silent: np.ndarray, what: str) -> Any:
    dots = axes.scatter(
        poles.real,
        poles.imag,
        c=np.repeat(FACTORS, poles.shape[1]),
        s=3,
        cmap="viridis",
        linewidths=0,
    )
    axes.plot(
        silent.real, silent.imag, "s", color=TRUTH, fillstyle="none", markersize=8, label="silent"
    )
    axes.plot(
        poles[0].real, poles[0].imag, "x", color=TRUTH, markersize=6, label=f"{NAMES[what]} = 0"
    )
    axes.plot(
        poles[CHOSEN].real, poles[CHOSEN].imag, "o", color=PRINTED, markersize=6, label="chosen"
    )
    return dots


def _slow(
    axes: Axes, poles: np.ndarray, silent: np.ndarray, what: str, Ts: float | None, size: float
) -> None:
    """The slow poles enlarged, below the real axis."""
    bottom, top = axes.get_ylim()
    axes.set_ylim(1.6 * bottom, top)
    inset = axes.inset_axes((0.14, 0.06, 0.64, 0.3))
    _locus(inset, poles, silent, what)
    near = np.concatenate([poles[poles.real > -2 * size], silent])
    _forbid_unstable(inset, np.append(near, -2 * size), Ts)
    inset.set_xlim(-2 * size, 0.3 * size)
    inset.tick_params(labelsize=6.5, pad=1)
    axes.indicate_inset_zoom(inset, edgecolor=ZONE)


def _scaled(given: Dynamics, what: str, factor: float) -> Dynamics:
    return given._replace(**{what: factor * getattr(given, what)})


def _poles(given: Dynamics, at: Dynamics) -> np.ndarray:
    """Eigenvalues of x~ and of the widths that `given` adapts, with every output read, under the gains `at`."""
    outputs = given.C.shape[0]
    S = pattern((1,) * outputs)
    F = generator(at, Mode(np.ones(1), S, np.ones(outputs), 0.0))
    kept = np.concatenate(
        [np.ones(len(given.A[0]), bool), S.any(axis=0) & (np.diag(given.gamma) > 0)]
    )
    return np.asarray(np.linalg.eigvals(F[np.ix_(kept, kept)]))


def _forbid_unstable(axes: Axes, poles: np.ndarray, Ts: float | None) -> None:
    """Limits that hold all poles and some of the unstable region, which is shaded."""
    size = max(np.ptp(poles.real), np.ptp(poles.imag), 1e-3 * np.abs(poles).max(), 1e-300)
    left, right = poles.real.min() - 0.08 * size, max(poles.real.max(), 0.0) + 0.12 * size
    top = np.abs(poles.imag).max() + 0.15 * size
    x, y = np.meshgrid(np.linspace(left, right, 400), np.linspace(-2 * top, 2 * top, 400))
    growth = x if Ts is None else (np.abs(1 + Ts * (x + 1j * y)) - 1) / Ts
    axes.contourf(x, y, growth, levels=[0.0, np.inf], colors=[FORBIDDEN], zorder=0)
    axes.contour(x, y, growth, levels=[0.0], colors=[PRINTED], linewidths=1.0, zorder=1)
    axes.set_xlim(left, right)
    axes.set_ylim(-top, top)


def _rates(axes: Axes, of: Assessment, found: Gains, scaled: list[str]) -> None:
    """The rate over the factor of each gain: a line where V proves it, dots elsewhere."""
    linear, jump, proof = (
        of.problem.model.linear,
        of.problem.sensor.kind == "jump",
        found.certificate,
    )
    for what, colour in zip(scaled, (ESTIMATE, READING), strict=False):
        factors = FACTORS[
            EVERY if what == "gamma" else 0 :: EVERY
        ]  # without gamma the widths are no part of the error
        gains: list[tuple[Floats, Floats]] = [
            (found.L, k * found.gamma) if what == "gamma" else (k * found.L, found.gamma)
            for k in factors
        ]
        rate = np.array([rates(linear, L, gamma, of.schedule, jump).rate for L, gamma in gains])
        proved = np.array(
            [
                proof.margin > -np.inf and margin(_scaled(proof.dynamics, what, k), proof.W)[0] > 0
                for k in factors
            ]
        )
        axes.plot(factors, rate, ":", color=colour, linewidth=1.4)
        axes.plot(
            factors,
            np.where(proved, rate, np.nan),
            color=colour,
            linewidth=2.0,
            label=f"{NAMES[what]} alone",
        )
    axes.plot([1.0], [found.rates.rate], "o", color=PRINTED, markersize=6)
    axes.axhline(0.0, color=TRUTH, linewidth=0.8)
    finish(
        axes,
        "Rate (dotted: not certified)",
        "rate along the reference [1/s]",
        "times the gain",
        legend=2,
    )


def nyquist(found: Gains) -> Figure:
    """1 + G(jw) and its real part; for several outputs the eigenvalues of its Hermitian part under the weights W.

    Sampled, 1 + G - Ts gamma / 2 on the unit circle. The model must be stable: the margin finite.
    """
    given, proof = found.certificate.dynamics, found.certificate
    poles = np.abs(np.linalg.eigvals(given.A[0]))
    w = np.geomspace(
        1e-2 * poles.min(),
        min(1e2 * poles.max(), np.inf if given.Ts is None else np.pi / given.Ts),
        2000,
    )
    worst_at = np.inf if proof.frequency is None else proof.frequency
    H, worst = _response(given, proof.W, w), _response(given, proof.W, np.array([worst_at]))[0]
    p = H.shape[1]
    what = "1 + G" if given.Ts is None else "1 + G − Ts γ/2"
    at = "for ω → ∞" if np.isinf(worst_at) else f"at {worst_at:.4g} rad/s"
    curve, zoomed = H[:, 0, 0], np.abs(H).max() > 15 * abs(proof.margin)
    rows = [["curve", *(["zoom"] if zoomed else []), "real"]] if p == 1 else [["real"]]
    verdict = "certified" if proof.certified else "not certified"
    figure, panels = sheet(
        rows,
        f"Positive realness: the least real part is {proof.margin:.4g} {at}; {verdict}",
        height=4.0,
    )
    if p == 1:
        _curve(panels["curve"], curve, worst[0, 0])
        finish(panels["curve"], f"Nyquist curve of {what}", "Im", "Re", legend=0)
        for k, name in ((0, "ω = 0"), (-1, "ω → ∞" if given.Ts is None else "ω = π/Ts")):
            if abs(curve[0] - curve[-1]) > 0.2 * np.abs(curve).max():
                panels["curve"].annotate(
                    name,
                    (curve[k].real, curve[k].imag),
                    (4, 4),
                    textcoords="offset points",
                    fontsize=8,
                )
    if "zoom" in panels:
        _curve(panels["zoom"], curve, worst[0, 0])
        _near(panels["zoom"], curve, worst[0, 0], abs(proof.margin))
        finish(panels["zoom"], "The same, enlarged", "", "Re", legend=0)
    _eigenvalues(panels["real"], w, H, proof.margin, worst_at)
    words = (
        f"Re ({what})"
        if p == 1
        else f"Eigenvalues of the Hermitian part of $W^{{1/2}}$({what})$W^{{-1/2}}$"
    )
    finish(panels["real"], f"{words} over frequency", "", "ω [rad/s]", legend=0)
    return figure


def _eigenvalues(axes: Axes, w: Floats, H: np.ndarray, least: float, worst_at: float) -> None:
    """Eigenvalues of Herm H over frequency; the least of them, which stands out, must stay above the shaded part."""
    values = np.linalg.eigvalsh((H + H.conj().transpose(0, 2, 1)) / 2)
    top, bottom = max(1.5, min(float(values.max()), 5 * abs(least), 10.0)) * 1.1, min(0.0, least)
    low = bottom - 0.12 * (top - bottom)
    axes.set_xscale("log")
    axes.axhspan(low, 0.0, color=FORBIDDEN, linewidth=0)
    axes.plot(w, values[:, 1:], color=ESTIMATE, alpha=0.35)
    axes.plot(w, values[:, 0], color=ESTIMATE)
    if w[0] <= worst_at <= w[-1]:
        axes.plot([worst_at], [least], "o", color=PRINTED, clip_on=False, zorder=5)
    else:
        axes.axhline(least, color=PRINTED, linestyle=":")
    axes.set_ylim(low, top)


def _response(given: Dynamics, W: Floats, w: Floats) -> np.ndarray:
    """W^(1/2) (1 + G - Ts S Gamma S'/2) W^(-1/2) at frequencies w [rad/s]; inf is allowed."""
    A, Ts, root = given.A[0], given.Ts, np.sqrt(W)
    H = np.tile((np.eye(root.size) - given.steps[0] / 2).astype(complex), (w.size, 1, 1))
    finite = np.isfinite(w)
    s = 1j * w[finite] if Ts is None else np.expm1(1j * w[finite] * Ts) / Ts
    H[finite] += (
        given.C
        * root[:, None]
        @ np.linalg.solve(
            s[:, None, None] * np.eye(len(A)) - A, (given.L / root)[None].astype(complex)
        )
    )
    return H


def _curve(axes: Axes, curve: np.ndarray, worst: complex) -> None:
    size = max(np.ptp(curve.real), np.abs(curve).max(), 1e-9)
    left = min(0.0, curve.real.min()) - 0.15 * size
    axes.axvspan(left, 0.0, color=FORBIDDEN, linewidth=0)
    axes.axvline(0.0, color=PRINTED, linewidth=1.0)
    axes.plot(curve.real, -curve.imag, color=ESTIMATE, alpha=0.3)
    axes.plot(curve.real, curve.imag, color=ESTIMATE)
    axes.plot([worst.real], [worst.imag], "o", color=PRINTED, zorder=5)
    axes.set_xlim(left, curve.real.max() + 0.12 * size)
    top = max(1.1 * float(np.abs(curve.imag).max()), 0.3 * size)
    axes.set_ylim(-top, top)


def _near(axes: Axes, curve: np.ndarray, worst: complex, size: float) -> None:
    """Limits around the worst point, some times `size` wide."""
    near = curve[np.abs(curve.real - worst.real) < 4 * size]
    tall = max(float(np.abs(near.imag - worst.imag).max(initial=0.0)), size)
    axes.set_xlim(worst.real - 3 * size, worst.real + 6 * size)
    axes.set_ylim(worst.imag - tall, worst.imag + tall)


STYLES: Final[dict[str, dict[str, Any]]] = {
    "random": {"color": "#b9bec6", "linewidth": 0.8},
    "adversary": {"color": PRINTED, "linewidth": 1.8},
    "fair adversary": {"color": READING, "linewidth": 1.8},
    "reference": {"color": ESTIMATE, "linewidth": 1.8},
}


def courses(found: Gains, tried: Attacks) -> Figure:
    """V along random, adversarial and planned switching; where V can be made to rise, the attack, and a growing cycle if found."""
    extra = {course.kind: course for course in tried.courses if course.kind not in STYLES}
    verdict = "never rises" if not tried.attack.broken else "can be made to rise"
    rows = [["V"] * max(1, len(extra)), [*extra]] if extra else [["V"]]
    figure, panels = sheet(
        rows,
        f"V {verdict}: {tried.attack.trajectories:,} random and adversarial trajectories tried",
        height=3.6,
    )
    titles = {
        "attack": f"The attack: {_words(tried.attack.mode)}",
        "cycle": "A cycle of sides along which the error grows for ever",
    }
    axes, drawn = panels["V"], set[str]()
    axes.set_yscale("log")
    for course in tried.courses:
        if course.kind in STYLES:
            value = np.where(course.V > FLOOR, course.V, np.nan)
            axes.plot(
                course.t,
                value,
                label=None if course.kind in drawn else course.kind,
                **STYLES[course.kind],
            )
            drawn.add(course.kind)
    t = tried.courses[0].t
    axes.plot(
        t,
        np.exp(-2 * found.rates.rate * t),
        color=TRUTH,
        linewidth=1.0,
        linestyle="--",
        label=r"$e^{-2\,rate\,t}$",
    )
    axes.set_xlim(0.0, t[-1])
    finish(axes, "V / V(0) from one random error", "", legend=5)
    for kind, course in extra.items():
        axes, large = panels[kind], course.V.max() > 10
        axes.axhline(1.0 if large else 0.0, color=TRUTH, linewidth=0.8)
        axes.plot(
            course.t, course.V if large else 100 * (course.V - 1), color=PRINTED, linewidth=1.8
        )
        axes.set_yscale("log" if large else "linear")
        finish(axes, titles[kind], "V / V(0)" if large else "rise of V [%]", legend=0)
    return figure


def _words(mode: Mode) -> str:
    """The sides that a mode reads, in words, and for how long."""
    sides = [{1: "right", 0: "silent", -1: "left"}[int(row.sum())] for row in mode.S]
    outputs = (
        sides[0]
        if len(sides) == 1
        else ", ".join(f"output {i} {side}" for i, side in enumerate(sides))
    )
    return f"{outputs} for {mode.seconds:.3g} s"
