"""Random linear problems whose posterior can be computed exactly, but for Monte Carlo."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import expm, solve_discrete_lyapunov

from benchmarks.filters.problems.random_plants import companion, polynomial
from undeadzone.linalg.matrices import Matrices
from undeadzone.nonlinearities.sensor import deadzone
from undeadzone.util.arrays import Floats

STEP, SAMPLES = 0.01, 500
RANGE = (0.3, 2.0)  # declared range of the widths, from which they are drawn evenly
NOISE = (0.003, 0.1)  # least and largest rms [z]
REACHES = ("grazing", "both edges", "inside")
KINDS = ("coloured", "white", "constant")  # disturbances


class Problem(NamedTuple):
    """A plant of order n behind a dead zone; s = [x; w], w its disturbance, z = s_0.

    Attributes:
        model: the plant in continuous time.
        F, G: s+ = F s + G u + noise, sampled (n + 1 x n + 1, n + 1).
        Q: covariance of the noise (n + 1 x n + 1).
        P: covariance of s at first; its mean is 0 (n + 1 x n + 1).
        levels: factors on the rms of w, each as likely as the others: one of them is true.
        ahead: whether the noise stands ahead of the zone, else behind it.
        noise: its rms [z].
        correlation: time of w [s]; inf of a constant.
        frequency: of the plant [rad/s].
        u, y, z: inputs, readings, true outputs (samples each).
        d: the widths d_r, d_l (2).
    """

    model: Matrices
    F: Floats
    G: Floats
    Q: Floats
    P: Floats
    levels: tuple[float, ...]
    ahead: bool
    noise: float
    correlation: float
    frequency: float
    u: Floats
    y: Floats
    z: Floats
    d: Floats

    @property
    def order(self) -> int:
        """Of the plant."""
        return len(self.F) - 1

    @property
    def disturbance(self) -> float:
        """Rms of w, as it is claimed."""
        return float(np.sqrt(self.P[-1, -1]))

    def at_level(self, factor: float) -> tuple[Floats, Floats]:
        """Q and P with the rms of w times a factor."""
        P = self.P.copy()
        P[-1, -1] *= factor**2
        return self.Q * factor**2, P


def problems(
    kind: str,
    ahead: bool,
    order: int,
    count: int,
    seed: int,
    levels: tuple[float, ...] = (1.0,),
    noise: tuple[float, float] = NOISE,
) -> list[Problem]:
    """Problems with a disturbance of one kind, reaching as `REACHES` says in turn.

    Args:
        kind: one of `KINDS`.
        ahead: whether the noise stands ahead of the zone.
        order: of the plants.
        count: how many.
        seed: of everything random.
        levels: factors on the rms of the disturbance, of which one is drawn.
        noise: least and largest rms [z].
    """
    rng = np.random.default_rng([seed, order, KINDS.index(kind), ahead])
    reaches = [REACHES[k % len(REACHES)] for k in range(count)]
    return [_problem(rng, kind, reach, ahead, order, levels, noise) for reach in reaches]


def _problem(
    rng: np.random.Generator,
    kind: str,
    reach: str,
    ahead: bool,
    order: int,
    levels: tuple[float, ...],
    noise: tuple[float, float],
) -> Problem:
    """One problem."""
    frequency, damping = rng.uniform(1.0, 6.0), rng.uniform(0.2, 1.5)
    poles = [-frequency]
    if order == 2:
        poles = list(np.roots([1.0, 2 * damping * frequency, frequency**2]))
    a = polynomial(poles)
    model = companion(a, a[0] * rng.uniform(0.5, 2.0))
    quarter = np.pi / 2 / frequency
    brief = 0.25 * quarter * rng.uniform(0.5, 2.0)
    correlation = {"coloured": brief, "white": 0.1 * STEP, "constant": np.inf}[kind]
    F, G = _sampled(model, np.exp(-STEP / correlation))
    rms, Q = _disturbance(F, correlation, rng.uniform(0.1, 0.4), model)
    d = rng.uniform(*RANGE, 2)
    u = _input(rng, model, frequency, _amplitude(rng, reach, d))
    posed = Problem(
        model=model,
        F=F,
        G=G,
        Q=Q,
        P=np.diag([*[0.25] * order, rms**2]),
        levels=levels,
        ahead=ahead,
        noise=float(np.exp(rng.uniform(*np.log(noise)))),
        correlation=correlation,
        frequency=frequency,
        u=u,
        y=np.empty(SAMPLES),
        z=np.empty(SAMPLES),
        d=d,
    )
    return _run(rng, posed, rng.choice(levels))


def _sampled(model: Matrices, fade: float) -> tuple[Floats, Floats]:
    """F and G with the disturbance at the input, which keeps the share `fade` of itself."""
    n = len(model.A)
    transition = expm(np.block([[model.A, model.B], [np.zeros((1, n + 1))]]) * STEP)
    F = np.block([[transition[:n]], [np.zeros((1, n)), np.full((1, 1), fade)]])
    return F, np.append(transition[:n, n], 0.0)


def _disturbance(
    F: Floats, correlation: float, share: float, model: Matrices
) -> tuple[float, Floats]:
    """Rms of a disturbance that moves z by `share`, rms, and the noise that drives it."""
    Q = np.zeros_like(F)
    if np.isinf(correlation):
        gain = abs(np.linalg.solve(model.A, model.B)[0, 0])
        return share / gain, Q
    Q[-1, -1] = 1 - F[-1, -1] ** 2
    rms = share / np.sqrt(solve_discrete_lyapunov(F, Q)[0, 0])
    return rms, Q * rms**2


def _amplitude(rng: np.random.Generator, reach: str, d: Floats) -> float:
    """How far z swings."""
    if reach == "grazing":
        return float(d.max() * rng.uniform(0.85, 1.2))
    if reach == "inside":
        return float(d.min() * rng.uniform(0.3, 0.9))
    return float(rng.uniform(2.0, 4.0))


def _input(rng: np.random.Generator, model: Matrices, frequency: float, amplitude: float) -> Floats:
    """Two tones that swing z so far."""
    tones = frequency * np.exp(rng.uniform(np.log(0.2), np.log(1.2), 2))
    u, t = np.zeros(SAMPLES), np.arange(SAMPLES) * STEP
    for tone, share, phase in zip(tones, (0.7, 0.3), rng.uniform(0, 2 * np.pi, 2), strict=True):
        gain: Any = np.linalg.solve(1j * tone * np.eye(len(model.A)) - model.A, model.B)[0, 0]
        u += amplitude * share * np.sin(tone * t + phase) / abs(gain)
    return u


def _run(rng: np.random.Generator, posed: Problem, level: float) -> Problem:
    """The problem with its readings."""
    Q, P = posed.at_level(level)
    s, shake = rng.normal(size=len(P)) * np.sqrt(np.diag(P)), np.sqrt(np.diag(Q))
    for i in range(SAMPLES):
        posed.z[i] = s[0]
        v = posed.noise * rng.normal()
        posed.y[i] = deadzone(s[0] + v * posed.ahead, *posed.d) + v * (not posed.ahead)
        s = posed.F @ s + posed.G * posed.u[i] + shake * rng.normal(size=len(s))
    return posed
