"""Numbers of the paper's example, each measured on the code and put beside its closed form."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np

from undeadzone.analysis.certificate.passivity import certify
from undeadzone.linear.matrices import Matrices
from undeadzone.linear.poles import observer_gain
from undeadzone.linear.riccati import paper_riccati
from undeadzone.paper.example import (
    ALPHA,
    AMPLITUDES,
    L_POLES,
    L_PRINTED,
    OMEGA,
    POLES,
    READINGS,
    printed,
)
from undeadzone.plants.build import matrices, system
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.simulation.simulate import prepare, run_loop
from undeadzone.support.arrays import Floats

STEADY: Final = 4.0  # [s] at the end of a run, over which a steady amplitude is read


class Fact(NamedTuple):
    """A number as measured and in closed form; where: the plant's reading and equation it belongs to."""

    where: str
    what: str
    measured: float
    closed_form: float

    @property
    def error(self) -> float:
        """Measured against closed form, relative where that is above 1."""
        return abs(self.measured - self.closed_form) / max(1.0, abs(self.closed_form))


def facts() -> list[Fact]:
    """All of them: poles and gains of (40), gains of (34) as printed, the answer to r as a force, the certificate of (12, 15)."""
    plants = {name: matrices(reading.plant) for name, reading in READINGS.items()}
    return [
        *(fact for name, linear in plants.items() for fact in _poles(name, linear)),
        *_riccati(plants["omega_n = 1"]),
        *_certificate(plants["omega_n = 1"]),
        *(fact for amplitude in AMPLITUDES for fact in _responses(amplitude)),
    ]


def _poles(name: str, linear: Matrices) -> list[Fact]:
    """The rightmost and leftmost pole of A - L C with (40), and the gains that (-4, -10) need."""
    (a0, a1), (l1, l2) = -linear.A[1], L_PRINTED
    roots = _quadratic(a1 + l1, a0 + a1 * l1 + l2)
    poles = np.sort(np.linalg.eigvals(linear.A - np.array([L_PRINTED]).T @ linear.C).real)
    need = observer_gain(linear, POLES, None).ravel()
    total, product = -sum(POLES), POLES[0] * POLES[1]
    wanted = (total - a1, product - a0 - a1 * (total - a1))
    lines = zip(
        ("rightmost pole of A - L C, (40)", "leftmost pole of A - L C, (40)"),
        poles[::-1],
        roots,
        strict=True,
    )
    gains = zip(("l1 for poles -4, -10", "l2 for poles -4, -10"), need, wanted, strict=True)
    return [
        Fact(name, what, float(measured), float(closed))
        for what, measured, closed in (*lines, *gains)
    ]


def _quadratic(b: float, c: float) -> tuple[float, float]:
    """The real parts of the roots of s^2 + b s + c, the larger first."""
    root = np.sqrt(complex(b * b / 4 - c)).real
    return -b / 2 + root, -b / 2 - root


def _riccati(linear: Matrices) -> list[Fact]:
    """K of (34) as printed, with A - L C at (-4, -10), used for control: it destabilises.

    In closed form by spectral factorisation: for A - L C = [[-l1, 1], [-1 - l2, -2]], Q = I, the Riccati loop's polynomial
    s^2 + f s + g has g^2 = q^2 + 2 alpha (1 + l1^2), f^2 - 2 g = p^2 - 2 q + 2 alpha, where A - L C has s^2 + p s + q.
    """
    A, B, C = linear
    K = paper_riccati(A - np.array([L_POLES]).T @ C, B, ALPHA, np.eye(2)).K
    rightmost = float(np.linalg.eigvals(A - B @ K).real.max())
    l1, p, q = L_POLES[0], -sum(POLES), POLES[0] * POLES[1]
    g = np.sqrt(q**2 + 2 * ALPHA * (1 + l1**2))
    f = np.sqrt(p**2 - 2 * q + 2 * ALPHA + 2 * g)
    k2 = (f - p) / 2
    k1 = (g - q) / 2 - k2 * l1
    where = "omega_n = 1, (34) with A - L C"
    return [
        Fact(where, "k1", float(K[0, 0]), k1),
        Fact(where, "k2", float(K[0, 1]), k2),
        Fact(where, "rightmost pole of A - B K", rightmost, _quadratic(2 + k2, 1 + k1)[0]),
    ]


def _certificate(linear: Matrices) -> list[Fact]:
    """min Re(1 + G(jw)), G = C (sI - A)^-1 L for L = (12, 15), and whether the certificate's search agrees on its sign.

    G = (b s + a) / (s + 1)^2 with a = 2 l1 + l2, b = l1; v = w^2.
    """
    A, _, C = linear
    L = np.array([L_POLES]).T
    w = np.linspace(0.0, 20.0, 20001)
    sampled = 1 + (C @ np.linalg.solve(1j * w[:, None, None] * np.eye(2) - A, L)).real.ravel()
    a, b = 2 * L_POLES[0] + L_POLES[1], L_POLES[0]
    # Re G = (a + (2 b - a) v) / (1 + v)^2; its derivative vanishes at v = (2 b - 3 a) / (2 b - a).
    v = (2 * b - 3 * a) / (2 * b - a)
    least = 1 + (a + (2 * b - a) * v) / (1 + v) ** 2
    proof = certify(linear, L, np.array([2.0]))
    where = "omega_n = 1, L = (12, 15)"
    return [
        Fact(where, "min Re(1 + G(jw))", float(sampled.min()), float(least)),
        Fact(where, "w of that minimum [rad/s]", float(w[sampled.argmin()]), float(np.sqrt(v))),
        Fact(where, "certified (1: yes)", float(proof.certified), float(least > 0)),
    ]


def forced(amplitude: float) -> tuple[Floats, dict[str, Floats]]:
    """(t [s], z by reading of the plant) from rest with u = amplitude sin 2 pi t: r as a force, k_p = k_d = 0."""
    problem = resolve_scenario(printed(amplitude))
    loop, state, exogenous = prepare(problem)
    law: Any = loop.params.controller
    silent = loop.params._replace(controller=law._replace(k_p=0.0 * law.k_p, k_d=0.0 * law.k_d))
    found = {}
    for name, reading in READINGS.items():
        here = loop._replace(params=silent._replace(plant=system(reading.plant).params))
        found[name] = run_loop(here, state, exogenous).z[:, 0]
    return np.arange(problem.steps + 1) * problem.scenario.simulation.step, found


def _responses(amplitude: float) -> list[Fact]:
    """Steady amplitude (and peak from rest where both poles are equal) with u = r."""
    found = []
    t, outputs = forced(amplitude)
    for name, z in outputs.items():
        A, B, _ = matrices(READINGS[name].plant)
        (a0, a1), force = -A[1], amplitude * B[1, 0]
        where = f"{name}, u = {amplitude:g} sin 2 pi t"
        steady = force / np.hypot(a0 - OMEGA**2, a1 * OMEGA)
        found.append(
            Fact(
                where,
                "steady amplitude of z",
                float(np.abs(z[t >= t[-1] - STEADY]).max()),
                float(steady),
            )
        )
        if np.isclose(a1**2, 4 * a0):
            found.append(
                Fact(
                    where,
                    "peak of |z| from rest",
                    float(np.abs(z).max()),
                    float(np.abs(_from_rest(force, a1 / 2, t)).max()),
                )
            )
    return found


def _from_rest(force: float, w: float, t: Floats) -> Floats:
    """x of x'' + 2 w x' + w^2 x = force sin OMEGA t from rest, exactly."""
    G = force / (w + 1j * OMEGA) ** 2
    # x = Im(G e^{j OMEGA t}) + (c + e t) e^{-w t} with x(0) = x'(0) = 0
    c = -G.imag
    e = w * c - (1j * OMEGA * G).imag
    return np.asarray((G * np.exp(1j * OMEGA * t)).imag + (c + e * t) * np.exp(-w * t))
