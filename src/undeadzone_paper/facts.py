"""Numbers of the paper's example, each measured on the code and in closed form."""

from __future__ import annotations

from itertools import starmap
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.optimize import brentq

from undeadzone.analysis.certificate.passivity import certify
from undeadzone.linalg.matrices import Matrices
from undeadzone.linalg.poles import observer_gain
from undeadzone.plants.options import linear_matrices
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
from undeadzone_paper.measures import error_matrix, largest_absolute, printed_riccati
from undeadzone_paper.printed import LAST, run_family
from undeadzone_paper.trials import destabilising_alpha, rightmost_pole

REQUIRED: Final = -sum(POLES), POLES[0] * POLES[1]  # p, q of the polynomial s^2 + p s + q


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


Pairs = tuple[str, dict[str, tuple[Any, Any]]]  # where; measured and closed form, by what


def compute_facts() -> list[Fact]:
    """Compute all facts.

    Poles and gains of (40), gains of (34) with A - L C, the certificate of (12, 15), the answer to
    r as a force.
    """
    plants = {name: linear_matrices(reading.plant) for name, reading in READINGS.items()}
    one = plants["omega_n = 1"]
    groups = list(starmap(_pole_facts, plants.items()))
    groups += [_riccati_facts(one), _certificate_facts(one)]
    for amplitude in AMPLITUDES:
        groups += _response_facts(amplitude)
    facts: list[Fact] = []
    for where, pairs in groups:
        facts += [Fact(where, what, *map(float, pair)) for what, pair in pairs.items()]
    return facts


def _pole_facts(name: str, linear: Matrices) -> Pairs:
    """Compute the extreme poles of A - L C with (40), and the gains that (-4, -10) need."""
    a0, a1 = -linear.A[1]  # of the plant's polynomial s^2 + a1 s + a0
    l1, l2 = L_PRINTED
    roots = _quadratic_roots(a1 + l1, a0 + a1 * l1 + l2)
    poles = np.sort(np.linalg.eigvals(error_matrix(linear)).real)
    placed = observer_gain(linear, POLES, None).ravel()
    p, q = REQUIRED
    return name, {
        "rightmost pole of A - L C, (40)": (poles[1], roots[0]),
        "leftmost pole of A - L C, (40)": (poles[0], roots[1]),
        "l1 for poles -4, -10": (placed[0], p - a1),
        "l2 for poles -4, -10": (placed[1], q - a0 - a1 * (p - a1)),
    }


def _quadratic_roots(b: float, c: float) -> tuple[float, float]:
    """Return the real parts of the roots of s^2 + b s + c, the larger first."""
    root = np.sqrt(complex(b * b / 4 - c)).real
    return -b / 2 + root, -b / 2 - root


def _riccati_facts(linear: Matrices) -> Pairs:
    """Return facts on K of (34) with A - L C at (-4, -10) and alpha = 10.

    They are K, the rightmost pole of A - B K, and the alpha from which A - B K is unstable.

    The expected values come from spectral factorisation, a way that solves no Riccati equation. For
    A - L C = [[-l1, 1], [-1 - l2, -2]] with polynomial s^2 + p s + q, and Q = I, the closed loop
    has the polynomial s^2 + f s + g with

        g^2 = q^2 + 2 alpha (1 + l1^2),    f^2 - 2 g = p^2 - 2 q + 2 alpha.
    """
    drift = error_matrix(linear, L_POLES)
    K = printed_riccati(linear, drift).K[0]
    k1, k2 = _control_gain(ALPHA)
    # A - B K has the polynomial s^2 + (2 + k2) s + 1 + k1 with k2 > 0: unstable if k1 < -1.
    brink = brentq(lambda alpha: 1 + _control_gain(alpha)[0], 1.0, 100.0)
    pole = _quadratic_roots(2 + k2, 1 + k1)[0]
    where = "omega_n = 1, (34) with A - L C, L = (12, 15)"
    least = destabilising_alpha(linear, drift)
    return where, {
        "k1": (K[0], k1),
        "k2": (K[1], k2),
        "rightmost pole of A - B K": (rightmost_pole(linear, drift, ALPHA), pole),
        "alpha from which A - B K is unstable": (least, brink),
    }


def _control_gain(alpha: float) -> tuple[float, float]:
    """Return (k1, k2) of (34) with A - L C at (-4, -10), Q = I, in closed form."""
    l1 = L_POLES[0]
    p, q = REQUIRED
    g = np.sqrt(q**2 + 2 * alpha * (1 + l1**2))
    f = np.sqrt(p**2 - 2 * q + 2 * alpha + 2 * g)
    k2 = (f - p) / 2
    return (g - q) / 2 - k2 * l1, k2


def _certificate_facts(linear: Matrices) -> Pairs:
    """Compute min Re(1 + G(jw)) for L = (12, 15), and compare its sign with the certificate.

    G = C (sI - A)^-1 L = (l1 s + 2 l1 + l2) / (s + 1)^2, and v = w^2.
    """
    A, _, C = linear
    L = np.array([L_POLES]).T
    l1, l2 = L_POLES
    w = np.linspace(0.0, 20.0, 20001)  # [rad/s]
    G = C @ np.linalg.solve(1j * w[:, None, None] * np.eye(2) - A, L)
    sampled = 1 + G.real.ravel()
    # Re G = (2 l1 + l2 - l2 v) / (1 + v)^2; its derivative vanishes at v = 3 + 4 l1 / l2.
    v = 3 + 4 * l1 / l2
    least = 1 + (2 * l1 + l2 - l2 * v) / (1 + v) ** 2
    proof = certify(linear, L, np.array([2.0]))
    where = "omega_n = 1, L = (12, 15)"
    return where, {
        "min Re(1 + G(jw))": (sampled.min(), least),
        "w of that minimum [rad/s]": (w[sampled.argmin()], np.sqrt(v)),
        "certified (1: yes)": (proof.certified, least > 0),
    }


def response_to_force(amplitude: float) -> tuple[Floats, dict[str, Floats]]:
    """Simulate the response from rest to the force u = amplitude sin 2 pi t, k_p = k_d = 0.

    Returns:
        Instants t [s], and z at them by reading of the plant.
    """
    silent = example_as_printed(amplitude) | {"controller": {"k_p": 0.0, "k_d": 0.0}}
    rest = {"plant": {"x0": [0.0, 0.0]}}
    scenarios = [silent | {"plant": reading.plant} | rest for reading in READINGS.values()]
    responses = [outputs.z[:, 0] for outputs in run_family(scenarios, None)]
    t = np.arange(responses[0].size) * silent.simulation.step
    return t, dict(zip(READINGS, responses, strict=True))


def _response_facts(amplitude: float) -> list[Pairs]:
    """Compute the steady amplitude with u = r, and the peak from rest if both poles are equal."""
    groups: list[Pairs] = []
    t, outputs = response_to_force(amplitude)
    for name, z in outputs.items():
        A, B, _ = linear_matrices(READINGS[name].plant)
        a0, a1 = -A[1]  # of the plant's polynomial s^2 + a1 s + a0
        force = amplitude * B[1, 0]
        where = f"{name}, u = {amplitude:g} sin 2 pi t"
        last = largest_absolute(z[t >= t[-1] - LAST])
        steady = force / np.hypot(a0 - OMEGA**2, a1 * OMEGA)
        pairs = {"steady amplitude of z": (last, steady)}
        if np.isclose(a1**2, 4 * a0):
            peak = largest_absolute(_double_pole_response(force, a1 / 2, t))
            pairs["peak of |z| from rest"] = largest_absolute(z), peak
        groups.append((where, pairs))
    return groups


def _double_pole_response(force: float, w: float, t: Floats) -> Floats:
    """Return x of x'' + 2 w x' + w^2 x = force sin OMEGA t from rest, exactly (N)."""
    s = 1j * OMEGA
    G = force / (w + s) ** 2
    return np.asarray((G * (np.exp(s * t) - (1 + (w + s) * t) * np.exp(-w * t))).imag)
