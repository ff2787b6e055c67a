"""Numbers of the paper's example, each measured on the code and in closed form."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from scipy.optimize import brentq

from undeadzone.analysis.certificate.passivity import certify
from undeadzone.linalg.matrices import Matrices
from undeadzone.linalg.poles import observer_gain
from undeadzone.linalg.riccati import paper_riccati
from undeadzone.plants.build import system
from undeadzone.plants.options import linear_matrices
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.simulation.simulate import outputs_of, prepare
from undeadzone.util.arrays import Floats
from undeadzone_paper.example import (
    ALPHA,
    AMPLITUDES,
    L_POLES,
    L_PRINTED,
    OMEGA,
    POLES,
    READINGS,
    example_as_printed,
)
from undeadzone_paper.measures import largest_absolute
from undeadzone_paper.trials import destabilising_alpha, rightmost_pole

STEADY: Final = 4.0  # [s] at the end of a run, over which a steady amplitude is read


class Fact(NamedTuple):
    """Number as measured and in closed form.

    Attributes:
        where: the reading of the plant and the equation that it belongs to
        what: its meaning
        measured: as the code computes it
        closed_form: as theory has it
    """

    where: str
    what: str
    measured: float
    closed_form: float

    @property
    def relative_error(self) -> float:
        """Return |measured - closed form|, relative if the closed form is above 1."""
        return abs(self.measured - self.closed_form) / max(1.0, abs(self.closed_form))


def compute_facts() -> list[Fact]:
    """Compute all facts.

    Poles and gains of (40), gains of (34) with A - L C, the certificate of (12, 15), the answer to
    r as a force.
    """
    plants = {name: linear_matrices(reading.plant) for name, reading in READINGS.items()}
    rows = []
    for name, linear in plants.items():
        rows += _pole_facts(name, linear)
    rows += _riccati_facts(plants["omega_n = 1"])
    rows += _certificate_facts(plants["omega_n = 1"])
    for amplitude in AMPLITUDES:
        rows += _response_facts(amplitude)
    return rows


def _pole_facts(name: str, linear: Matrices) -> list[Fact]:
    """Compute the extreme poles of A - L C with (40), and the gains that (-4, -10) need."""
    a0, a1 = -linear.A[1]  # of the plant's polynomial s^2 + a1 s + a0
    l1, l2 = L_PRINTED
    roots = _quadratic_roots(a1 + l1, a0 + a1 * l1 + l2)
    poles = np.sort(np.linalg.eigvals(linear.A - np.array([L_PRINTED]).T @ linear.C).real)
    placed = observer_gain(linear, POLES, None).ravel()
    # of the required polynomial s^2 + p s + q
    p = -sum(POLES)
    q = POLES[0] * POLES[1]
    gains = (p - a1, q - a0 - a1 * (p - a1))
    return [
        Fact(name, "rightmost pole of A - L C, (40)", float(poles[1]), float(roots[0])),
        Fact(name, "leftmost pole of A - L C, (40)", float(poles[0]), float(roots[1])),
        Fact(name, "l1 for poles -4, -10", float(placed[0]), float(gains[0])),
        Fact(name, "l2 for poles -4, -10", float(placed[1]), float(gains[1])),
    ]


def _quadratic_roots(b: float, c: float) -> tuple[float, float]:
    """Return the real parts of the roots of s^2 + b s + c, the larger first."""
    root = np.sqrt(complex(b * b / 4 - c)).real
    return -b / 2 + root, -b / 2 - root


def _riccati_facts(linear: Matrices) -> list[Fact]:
    """Return facts on K of (34) with A - L C at (-4, -10) and alpha = 10.

    They are K, the rightmost pole of A - B K, and the alpha from which A - B K is unstable.

    The expected values come from spectral factorisation, a way that solves no Riccati equation. For
    A - L C = [[-l1, 1], [-1 - l2, -2]] with polynomial s^2 + p s + q, and Q = I, the closed loop
    has the polynomial s^2 + f s + g with

        g^2 = q^2 + 2 alpha (1 + l1^2),    f^2 - 2 g = p^2 - 2 q + 2 alpha.
    """
    A, B, C = linear
    drift = A - np.array([L_POLES]).T @ C
    K = paper_riccati(drift, B, ALPHA, np.eye(2)).K
    k1, k2 = _control_gain(ALPHA)
    # A - B K has the polynomial s^2 + (2 + k2) s + 1 + k1 with k2 > 0: unstable if k1 < -1.
    brink = brentq(lambda alpha: 1 + _control_gain(alpha)[0], 1.0, 100.0)
    pole = _quadratic_roots(2 + k2, 1 + k1)[0]
    where = "omega_n = 1, (34) with A - L C, L = (12, 15)"
    return [
        Fact(where, "k1", float(K[0, 0]), k1),
        Fact(where, "k2", float(K[0, 1]), k2),
        Fact(where, "rightmost pole of A - B K", rightmost_pole(linear, drift, ALPHA), pole),
        Fact(
            where, "alpha from which A - B K is unstable", destabilising_alpha(linear, drift), brink
        ),
    ]


def _control_gain(alpha: float) -> tuple[float, float]:
    """Return (k1, k2) of (34) with A - L C at (-4, -10), Q = I, in closed form."""
    l1 = L_POLES[0]
    p = -sum(POLES)
    q = POLES[0] * POLES[1]
    g = np.sqrt(q**2 + 2 * alpha * (1 + l1**2))
    f = np.sqrt(p**2 - 2 * q + 2 * alpha + 2 * g)
    k2 = (f - p) / 2
    return float((g - q) / 2 - k2 * l1), float(k2)


def _certificate_facts(linear: Matrices) -> list[Fact]:
    """Compute min Re(1 + G(jw)) for L = (12, 15), and compare its sign with the certificate.

    G = C (sI - A)^-1 L = (b s + a) / (s + 1)^2 with a = 2 l1 + l2, b = l1, v = w^2.
    """
    A, _, C = linear
    L = np.array([L_POLES]).T
    w = np.linspace(0.0, 20.0, 20001)  # [rad/s]
    G = C @ np.linalg.solve(1j * w[:, None, None] * np.eye(2) - A, L)
    sampled = 1 + G.real.ravel()
    a = 2 * L_POLES[0] + L_POLES[1]
    b = L_POLES[0]
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


def response_to_force(amplitude: float) -> tuple[Floats, dict[str, Floats]]:
    """Simulate the response from rest to the force u = amplitude sin 2 pi t, k_p = k_d = 0.

    Returns:
        Instants t [s], and z at them by reading of the plant.
    """
    problem = resolve_scenario(example_as_printed(amplitude))
    start = prepare(problem)
    loop = start.loop
    law: Any = loop.params.controller
    silent = loop.params._replace(controller=law._replace(k_p=0.0 * law.k_p, k_d=0.0 * law.k_d))
    outputs = {}
    for name, reading in READINGS.items():
        driven = loop._replace(params=silent._replace(plant=system(reading.plant).params))
        outputs[name] = outputs_of(start._replace(loop=driven)).z[:, 0]
    return np.arange(problem.steps + 1) * problem.scenario.simulation.step, outputs


def _response_facts(amplitude: float) -> list[Fact]:
    """Compute the steady amplitude with u = r, and the peak from rest if both poles are equal."""
    rows = []
    t, outputs = response_to_force(amplitude)
    for name, z in outputs.items():
        A, B, _ = linear_matrices(READINGS[name].plant)
        a0, a1 = -A[1]  # of the plant's polynomial s^2 + a1 s + a0
        force = amplitude * B[1, 0]
        where = f"{name}, u = {amplitude:g} sin 2 pi t"
        last = largest_absolute(z[t >= t[-1] - STEADY])
        steady = float(force / np.hypot(a0 - OMEGA**2, a1 * OMEGA))
        rows.append(Fact(where, "steady amplitude of z", last, steady))
        if np.isclose(a1**2, 4 * a0):
            peak = largest_absolute(_double_pole_response(force, a1 / 2, t))
            rows.append(Fact(where, "peak of |z| from rest", largest_absolute(z), peak))
    return rows


def _double_pole_response(force: float, w: float, t: Floats) -> Floats:
    """Return x of x'' + 2 w x' + w^2 x = force sin OMEGA t from rest, exactly (N)."""
    G = force / (w + 1j * OMEGA) ** 2
    # x = Im(G e^{j OMEGA t}) + (c + e t) e^{-w t} with x(0) = x'(0) = 0
    c = -G.imag
    e = w * c - (1j * OMEGA * G).imag
    return np.asarray((G * np.exp(1j * OMEGA * t)).imag + (c + e * t) * np.exp(-w * t))
