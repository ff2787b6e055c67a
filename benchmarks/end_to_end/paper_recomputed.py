"""Ten verdicts on the paper, drawn by a seed, computed again without a line of the audit's code.

Everything here is NumPy and SciPy: the equations are written out once more, runs are integrated
side by side by another step, and verdicts follow from the limits that `claims.toml` states. Filter
and identification are others than the package's; they need not give its numbers, but its verdicts.
"""

from __future__ import annotations

import random
import tomllib
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, solve_continuous_are
from scipy.optimize import least_squares
from scipy.signal import lfilter

Floats = NDArray[np.float64]

SEED: Final = 58
DRAWN: Final = 10
CLAIMS: Final = Path(__file__).parents[2] / "src" / "undeadzone_paper" / "claims.toml"
A: Final = np.array([[0.0, 1.0], [-1.0, -2.0]])
CHAIN: Final = np.array([[0.0, 1.0], [0.0, 0.0]])  # (15)
B: Final = np.array([0.0, 1.0])
C: Final = np.array([1.0, 0.0])
L_40: Final = np.array([-1.25, -1.62])
L_MENDED: Final = np.array([1.0, 1.5])
ALPHA, K_S, TAU, GAMMA, D_M = 10.0, 100.0, 0.01, 10.0, 3.0
W: Final = 2 * np.pi
LAST: Final = 2.0  # [s]
GONE: Final = 1e12


class Again(NamedTuple):
    """A claim's number as printed in the worst case, and as repaired; None: there is none."""

    printed: float | None
    repaired: float | None

    def verdict(self, limit: float, announced: bool) -> str:
        """Return the verdict that follows from the numbers and the limit."""
        if self.printed is not None and self.printed <= limit:
            return "holds"
        if announced:
            return "not shown"
        mended = self.repaired is not None and self.repaired <= limit
        return "holds after repair" if mended else "does not hold"


def draw_claims() -> list[str]:
    """Return the names of the claims that the seed selects."""
    with CLAIMS.open("rb") as file:
        return random.Random(SEED).sample(sorted(tomllib.load(file)), DRAWN)


def riccati(drift: Floats) -> Floats:
    """P of drift'P + P drift - 2 alpha P B B'P = -I (2 x 2)."""
    return solve_continuous_are(drift, B[:, None], np.eye(2), np.eye(1) / (2 * ALPHA))


def dead(z: Floats, right: Any, left: Any) -> Floats:
    """The reading of z."""
    return z - np.maximum(np.minimum(z, right), -left)


def integrate(
    f: Callable[[float, Floats, int], Floats],
    s: Floats,
    step: float,
    duration: float,
    project: Callable[[Floats], Floats] = lambda s: s,
) -> tuple[Floats, Floats, Floats]:
    """Instants of the last 2 s, states there (N x runs x n), and which runs ran away.

    f(t, s, k) is the derivative in step k, by Heun's third-order method.
    """
    count, states_so_far = round(duration / step), []
    gone = np.zeros(len(s), dtype=bool)
    with np.errstate(all="ignore"):
        for k in range(count + 1):
            if k * step >= duration - LAST - 1e-9:
                states_so_far.append(s.copy())
            t = k * step
            a = f(t, s, k)
            b = f(t + step / 3, s + step / 3 * a, k)
            c = f(t + 2 * step / 3, s + 2 * step / 3 * b, k)
            s = project(s + step / 4 * (a + 3 * c))
            away = ~(np.abs(s).max(axis=1) < GONE)
            gone |= away
            s[away] = 0.0
    states = np.array(states_so_far)
    t = duration - LAST + step * np.arange(len(states))
    return t, states, gone


def rms(values: Floats) -> Floats:
    """Root mean square of each run."""
    return np.sqrt(np.mean(values**2, axis=0))


class Ends(NamedTuple):
    """Runs side by side: x1, x2, x^1, x^2, d_r^, d_l^ over the last 2 s, and which diverge."""

    t: Floats
    s: Floats
    gone: NDArray[np.bool_]
    amplitude: Floats


def run_printed(
    x0: list[tuple[float, float]],
    amplitude: list[float],
    sign: list[float],
    width: float = 1.0,
    step: float = 1e-3,
) -> Ends:
    """(16) without B u, (17), (25), (42) on (39); sign: +1 with d_l > 0, -1 with a signed d_l."""
    P = riccati(A - np.outer(L_40, C))
    k_p, k_d = ALPHA * B @ P
    cpl = C @ P @ L_40
    r, signs = np.array(amplitude), np.array(sign)

    def f(t: float, s: Floats, k: int) -> Floats:
        x, xh, d, lowpass = s[:, :2], s[:, 2:4], s[:, 4:6], s[:, 6]
        y = dead(x[:, 0], 1.0, 1.0)
        e = y - dead(xh[:, 0], d[:, 0], d[:, 1])
        u = -k_p * e - k_d * (e - lowpass) / TAU + r * np.sin(W * t)
        switch = np.tanh(K_S * y)
        moved = x @ A.T + np.outer(u, B)
        followed = xh @ A.T + np.outer(e, L_40)
        right = -e * cpl * (1 + switch) / 2
        left = -signs * e * cpl * (1 - switch) / 2
        return np.column_stack([moved, followed, right, left, (e - lowpass) / TAU])

    s = np.zeros((len(x0), 7))
    s[:, :2], s[:, 4:6] = x0, width
    t, states, gone = integrate(f, s, step, 20.0)
    return Ends(t, states, gone, r)


class Conditions(NamedTuple):
    """Of a repaired run: plant's start, amplitude of r, model, disturbance and noise."""

    x0: tuple[float, float] = (0.5, 0.0)
    amplitude: float = 5.0
    stiffness: float = 1.0
    damping: float = 2.0
    gain: float = 1.0
    gust: float = 0.0
    noise: float = 0.0


def run_repaired(runs: list[Conditions], step: float = 1e-3) -> Ends:
    """e on the measured side, B u in the observer, widths projected, u_ff - K (x^ - x_ref)."""
    table = np.array([[*run.x0, *run[1:]] for run in runs])
    _, _, r, a0, a1, b, gust, noise = table.T
    model = np.array([[[0.0, 1.0], [-p, -q]] for p, q in zip(a0, a1, strict=True)])
    K = []
    for drift, gain in zip(model, b, strict=True):
        push = np.array([[0.0], [gain]])
        P = solve_continuous_are(drift, push, np.eye(2), np.eye(1) / (2 * ALPHA))
        K.append(ALPHA * push[:, 0] @ P)
    feedback = np.array(K)
    shaken = np.random.default_rng(SEED).standard_normal((round(20.0 / step) + 1, len(runs)))

    def f(t: float, s: Floats, k: int) -> Floats:
        x, xh, d = s[:, :2], s[:, 2:4], s[:, 4:6]
        y = dead(x[:, 0], 1.0, 1.0) + noise * shaken[k]
        right, left = y > 4 * noise, y < -4 * noise
        e = np.where(right, y - xh[:, 0] + d[:, 0], np.where(left, y - xh[:, 0] - d[:, 1], 0.0))
        ref = np.column_stack([r * np.sin(W * t), r * W * np.cos(W * t)])
        forward = (-(W**2) * ref[:, 0] + a1 * ref[:, 1] + a0 * ref[:, 0]) / b
        u = forward - ((xh - ref) * feedback).sum(axis=1)
        moved = x @ A.T + np.outer(u + gust * np.sin(0.6 * np.pi * t), B)
        followed = np.einsum("kij,kj->ki", model, xh) + np.outer(e, L_MENDED)
        followed[:, 1] += b * u
        return np.column_stack([moved, followed, -GAMMA * e * right, GAMMA * e * left])

    def project(s: Floats) -> Floats:
        s[:, 4:] = np.clip(s[:, 4:], 0.0, D_M)
        return s

    s = np.zeros((len(runs), 6))
    s[:, :2], s[:, 4:] = table[:, :2], 0.2
    t, states, gone = integrate(f, s, step, 20.0, project)
    return Ends(t, states, gone, r)


def widths_off(runs: Ends) -> Floats:
    """Largest |d^ - d| of each run, last 2 s."""
    off = np.abs(runs.s[:, :, 4:6] - 1.0).max(axis=(0, 2))
    return np.where(runs.gone, np.inf, off)


def state_off(runs: Ends, i: int) -> Floats:
    """Rms of x^ - x of each run, last 2 s."""
    return np.where(runs.gone, np.inf, rms(runs.s[:, :, 2 + i] - runs.s[:, :, i]))


def reference_off(runs: Ends) -> Floats:
    """Rms of z - r of each run, last 2 s."""
    r = np.outer(np.sin(W * runs.t), runs.amplitude)
    return np.where(runs.gone, np.inf, rms(runs.s[:, :, 0] - r))


def run_theorem() -> Floats:
    """Largest |x^ - x| or |d^ - d|, last 2 s, of 2 x 64 readings of Theorem 4.1; inf: diverged."""
    choices = list(
        product((True, False), (A, CHAIN), ("(40)", "poles"), (0.0, 1.0), (1.0, -1.0), (0.01, 5.0),
                (1.0, 0.2))
    )  # fmt: skip
    plants, gains, numbers = [], [], []
    for given, plant, name, feed, left, x1, width in choices:
        # Poles -4, -10: s^2 + 14 s + 40 = s^2 + (l1 - a22) s + l2 - l1 a22 - a21.
        l1 = 14.0 + plant[1, 1]
        L = L_40 if name == "(40)" else np.array([l1, 40.0 + plant[1, 0] + l1 * plant[1, 1]])
        P = riccati(plant - np.outer(L, C))
        plants.append(plant)
        gains.append(L)
        numbers.append([given, feed, left, x1, width, B @ P @ C, B @ P @ L, C @ P @ L])
    matrices, L = np.array(plants), np.array(gains)
    given, feed, left, x1, width, of_y, of_d, cpl = np.array(numbers).T

    def f(t: float, s: Floats, k: int) -> Floats:
        x, xh, d = s[:, :2], s[:, 2:4], s[:, 4:]
        y = dead(x[:, 0], 1.0, 1.0)
        e = y - dead(xh[:, 0], d[:, 0], d[:, 1])
        switch = np.tanh(K_S * y)
        chi = np.column_stack([(1 + switch) / 2, left * (1 - switch) / 2])
        width_term = np.where(given > 0, (chi * (1.0 - d)).sum(axis=1), -e)
        u = -ALPHA * (of_y * e + of_d * width_term) + 5.0 * np.sin(W * t)
        moved = np.einsum("kij,kj->ki", matrices, x)
        moved[:, 1] += u
        followed = np.einsum("kij,kj->ki", matrices, xh) + L * e[:, None]
        followed[:, 1] += feed * u
        return np.column_stack([moved, followed, -(e * cpl)[:, None] * chi])

    s = np.zeros((len(choices), 6))
    s[:, 0], s[:, 4:] = x1, width[:, None]
    _, states, gone = integrate(f, s, 2e-3, 20.0)
    apart = np.abs(states[:, :, 2:4] - states[:, :, :2]).max(axis=(0, 2))
    off = np.abs(states[:, :, 4:] - 1.0).max(axis=(0, 2))
    return np.where(gone | (np.abs(states).max(axis=(0, 2)) > 1e6), np.inf, np.maximum(apart, off))


def sampled_log() -> tuple[Floats, Floats]:
    """u and y of 20 s at 100 Hz: the repaired loop, its model's gain 10 % off, rms 0.02 on y."""
    step, b = 0.01, 1.1
    power = expm(np.block([[A, B[:, None]], [np.zeros((1, 3))]]) * step)
    P = solve_continuous_are(A, b * B[:, None], np.eye(2), np.eye(1) / (2 * ALPHA))
    K = ALPHA * b * B @ P
    noise = 0.02 * np.random.default_rng(SEED).standard_normal(2001)
    x, xh, d = np.array([0.5, 0.0]), np.zeros(2), np.array([0.2, 0.2])
    inputs, readings = [], []
    for k, shake in enumerate(noise):
        y = float(dead(x[:1], 1.0, 1.0)[0]) + shake
        right, left = y > 0.08, y < -0.08
        e = y - xh[0] + d[0] if right else y - xh[0] - d[1] if left else 0.0
        t = k * step
        ref = 5.0 * np.array([np.sin(W * t), W * np.cos(W * t)])
        u = (-(W**2) * ref[0] + 2 * ref[1] + ref[0]) / b - K @ (xh - ref)
        inputs.append(u)
        readings.append(y)
        x = power[:2, :2] @ x + power[:2, 2] * u
        xh = power[:2, :2] @ xh + b * power[:2, 2] * u + step * L_MENDED * e
        d = np.clip(d + step * GAMMA * e * np.array([-1.0 * right, 1.0 * left]), 0.0, D_M)
    return np.array(inputs), np.array(readings)


def identify(u: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Widths and their deviations by least squares of the readings; the plant is unknown, too."""

    def misfit(p: Floats) -> Floats:
        a0, a1, b, right, left, *start = p
        flow = np.array([[0.0, 1.0, 0.0], [-a0, -a1, b], [0.0, 0.0, 0.0]])
        power = expm(flow * 0.01)
        Ad, Bd = power[:2, :2], power[:2, 2]
        trace, det = Ad.trace(), np.linalg.det(Ad)
        # z = C (q - Ad)^-1 (Bd u), and the same of the start
        numerator = np.array([0.0, Bd[0], Ad[0, 1] * Bd[1] - Ad[1, 1] * Bd[0]])
        pulse = np.zeros_like(u)
        pulse[0] = 1.0
        begun = [start[0], Ad[0, 1] * start[1] - Ad[1, 1] * start[0]]
        poles = [1.0, -trace, det]
        z = lfilter(numerator, poles, u) + lfilter(begun, poles, pulse)
        return dead(z, right, left) - y

    found = least_squares(misfit, [0.7, 1.6, 1.2, 0.6, 0.6, 0.3, 0.1], x_scale="jac")
    variance = 2 * found.cost / (y.size - found.x.size)
    deviation = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)) * variance)
    return found.x[3:5], deviation[3:5]


def filter_in_loop(gust: float, noise: float) -> float:
    """Largest |d^ - d|, last 2 s, of a Kalman filter on the measured side, in the loop at 100 Hz.

    Its state is [x1; x2; d_r; d_l]. As docs/methods/simple_observers.md says, without a declared
    disturbance the filter assumes a white one, which moves z by a fifth of the largest width (3) in
    a quarter period. With a declared disturbance of 0 it trusts its model.
    """
    step = 0.01
    plant = expm(np.block([[A, B[:, None]], [np.zeros((1, 3))]]) * step)
    F, G = np.eye(4), np.zeros(4)
    F[:2, :2], G[:2] = plant[:2, :2], plant[:2, 2]
    K = ALPHA * B @ riccati(A)
    m, S = np.array([0.0, 0.0, 1.55, 1.55]), np.diag([1.0, 1.0, 0.7, 0.7])
    doubt = 3 * (0.2 * 3.0) ** 2 / (np.pi / 2) ** 3 if gust else 0.0
    drift = np.diag([0.0, doubt * step, 0.0, 0.0])
    R = max(noise, 1e-3) ** 2
    x, off = np.array([0.5, 0.0]), 0.0
    shaken = noise * np.random.default_rng(SEED + 1).standard_normal(2001)
    for k, shake in enumerate(shaken):
        t = k * step
        y = float(dead(x[:1], 1.0, 1.0)[0]) + shake
        if abs(y) > 4 * noise:
            H = np.array([1.0, 0.0, -1.0 * (y > 0), 1.0 * (y < 0)])
            gain = S @ H / (H @ S @ H + R)
            m = m + gain * (y - H @ m)
            S = S - np.outer(gain, H @ S)
        m[2:] = np.clip(m[2:], 0.1, 3.0)
        if t >= 20.0 - LAST:
            off = max(off, float(np.abs(m[2:] - 1.0).max()))
        ref = 5.0 * np.array([np.sin(W * t), W * np.cos(W * t)])
        u = -(W**2) * ref[0] + 2 * ref[1] + ref[0] - K @ (m[:2] - ref)
        pushed = u + gust * np.sin(0.6 * np.pi * (t + step / 2))
        x = plant[:2, :2] @ x + plant[:2, 2] * pushed
        m, S = F @ m + G * u, F @ S @ F.T + drift
    return off


def recompute() -> dict[str, Again]:
    """Return the numbers of the selected claims."""
    rest, outside = (0.0, 0.0), (5.0, 0.0)
    printed = run_printed(
        [rest, rest, outside, outside, outside], [5.0, 2.0, 5.0, 2.0, 5.0], [1, 1, 1, 1, -1]
    )
    unaware = run_printed([rest, outside], [5.0, 5.0], [1, 1], width=0.2)
    mismatches = [Conditions(**{key: value}) for key, value in MISMATCHES]
    nominal = [Conditions(), Conditions(amplitude=2.0)]
    others = [Conditions(noise=0.02), Conditions(gust=1.0), *mismatches]
    runs = run_repaired([*nominal, *others])
    mended = Ends(runs.t, runs.s[:, :2], runs.gone[:2], runs.amplitude[:2])
    angles = np.pi * np.array([0.0, 0.5, 1.0, 1.5])
    starts = [
        (radius * np.cos(angle), radius * np.sin(angle))
        for radius in (0.1, 10.0, 1000.0)
        for angle in angles
    ]
    far = run_printed(starts, [5.0] * 12, [1.0] * 12, step=5e-3)
    far_mended = run_repaired([Conditions(x0=start) for start in starts], step=5e-3)
    off, deviation = identify(*sampled_log())
    error = float(np.abs(off - 1.0).max())
    theorem = run_theorem()
    ends = [state_off(mended, 0), state_off(mended, 1), widths_off(mended)]
    largest_value = np.abs(np.clip(np.linspace(-5, 5, 1001), -1, 1)).max()
    in_noise, in_gust = widths_off(runs)[2:4]
    filtered = [filter_in_loop(0.0, 0.02) / in_noise, filter_in_loop(1.0, 0.0) / in_gust]
    return {
        "state-2": Again(float(state_off(printed, 1).max()), float(state_off(mended, 1).max())),
        "filtering": Again(float(max(filtered)), None),
        "global": Again(float(widths_off(far).max()), float(widths_off(far_mended).max())),
        "unknown-width": Again(float(widths_off(unaware).max()), float(widths_off(mended)[0])),
        "theorem": Again(float(theorem.max()), float(max(end.max() for end in ends))),
        "width-bound": Again(
            max(0.0, largest_value - abs(1.0 - 1.0)), max(0.0, largest_value - (1.0 + 1.0))
        ),
        "bounded": Again(float(printed.gone.any()), float(runs.gone.any())),
        "tracking": Again(float(reference_off(printed).max()), float(reference_off(mended).max())),
        "predetermined": Again(error, None),
        "physical": Again(float(1.96 * deviation.max()), None),
    }


MISMATCHES: Final = (
    ("stiffness", 0.9),
    ("stiffness", 1.1),
    ("damping", 1.8),
    ("damping", 2.2),
    ("gain", 0.9),
    ("gain", 1.1),
)


def verdicts() -> dict[str, tuple[Again, str]]:
    """Return the numbers and the verdict of each selected claim."""
    with CLAIMS.open("rb") as file:
        texts = tomllib.load(file)
    again = recompute()
    found = {}
    for name in draw_claims():
        limit, announced = texts[name]["limit"], texts[name].get("announced", False)
        found[name] = again[name], again[name].verdict(limit, announced)
    return found


def table() -> str:
    """Return the numbers and verdicts of the selected claims as Markdown."""
    lines = [
        f"## Ten verdicts on the paper, computed again (drawn by the seed {SEED})\n",
        "| claim | as printed | repaired | verdict |",
        "|---|---|---|---|",
    ]
    for name, (again, verdict) in verdicts().items():
        printed, repaired = ("" if value is None else f"{value:.3g}" for value in again)
        lines.append(f"| {name} | {printed} | {repaired} | {verdict} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(table())
