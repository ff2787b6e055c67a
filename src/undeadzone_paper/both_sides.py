"""Both sides of the paper's equations (1)-(42) along a run, and their largest difference.

As printed they are taken along the run of Theorem 4.1: observer (16), (17), adaptation (25), law
(29) with d - d^ given, plant (39), L of (40), started at x1 = 5 with d^ = d. As mended they are
taken along the repaired run, on the measured side.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.interfaces import Reading, require_graph
from undeadzone.linalg.matrices import Matrices, companion_form
from undeadzone.linalg.poles import observer_gain
from undeadzone.nonlinearities.sensor import saturation_bound, zone
from undeadzone.plants.options import linear_matrices
from undeadzone.results.run import Run
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.util.arrays import Floats
from undeadzone_paper import measures as m
from undeadzone_paper.evidence import NOMINAL, RESTING, Evidence
from undeadzone_paper.example import (
    ALPHA,
    L_PRINTED,
    L_REPAIRED,
    OMEGA,
    POLES,
    READINGS,
    D,
    example_as_printed,
    example_as_repaired,
)
from undeadzone_paper.trials import pole_error


class BothSides(NamedTuple):
    """Largest difference of both sides of an equation.

    Attributes:
        printed: as printed
        mended: as mended (None: not mended)
    """

    printed: float
    mended: float | None


class ErrorSignals(NamedTuple):
    """Signals of a run beside their estimates, a row for each sample, in one version of the paper.

    Attributes:
        x, x_hat: state and its estimate (N x 2)
        z, z_hat, y, u: output, reading, input, and the estimate of the output (N)
        d_hat: d^ (N x 2)
        side: the measured side (N)
        chi: [chi_r chi_l] of (8)-(10) as printed, [chi_r -chi_l] of the measured side as mended
        e: y~ = y - y^ (N), y^ of (17) as printed, by chi as mended
        push: B u, as far as it stays in x~' (N x 2)
    """

    x: Floats
    x_hat: Floats
    z: Floats
    z_hat: Floats
    y: Floats
    u: Floats
    d_hat: Floats
    side: Floats
    chi: Floats
    e: Floats
    push: Floats

    @property
    def x_error(self) -> Floats:
        """Return x~ = x - x^ (N x 2)."""
        return self.x - self.x_hat

    @property
    def d_error(self) -> Floats:
        """Return d~ = d - d^ of (21) (N x 2)."""
        return D - self.d_hat

    def take_off(self, widths: Floats | float) -> Floats:
        """Return chi_bar times widths, one for both sides or one for each (N)."""
        return np.asarray((self.chi * widths).sum(axis=1))


def compare_sides(evidence: Evidence) -> dict[int, BothSides]:
    """Compute both sides of every equation, by its number."""
    repaired = evidence.repaired[NOMINAL][0]
    linear = linear_matrices(example_as_printed(1.0).plant)
    p = _signals_as_printed(evidence.law[0], linear)
    q = _signals_as_mended(repaired)
    read = ErrorSignals._make(part[q.side != 0] for part in q)
    printed = {
        **_differences(p, linear, L_PRINTED, -1.0),
        **dict(zip((9, 10), _indicator_errors(p).T, strict=True)),
        **_differences_as_printed(p, linear),
        **_differences_of_V(p, linear),
        30: _error_at_zero_V(evidence.printed[NOMINAL][RESTING][0]),
    }
    mended = {
        **_differences(read, linear, L_REPAIRED, 1.0),
        **dict.fromkeys((5, 6, 8, 9, 10), _indicator_errors(q)),
        **_differences_as_mended(p, q, linear),
        30: _error_at_zero_V(repaired),
        36: m.lyapunov_rise(repaired),
    }
    largest = {number: m.largest_absolute(apart) for number, apart in mended.items()}
    return {
        number: BothSides(m.largest_absolute(printed[number]), largest.get(number))
        for number in sorted(printed)
    }


def _signals_as_printed(run: Run, linear: Matrices) -> ErrorSignals:
    """Return the signals of a run of one output with the indicators, y^ and L as printed."""
    sign = np.tanh(m.SHARPNESS * run.y)
    chi = np.hstack([1 + sign, 1 - sign]) / 2
    push = run.u * linear.B.T
    e = run.y[:, 0] - m.reading_estimate(run)
    return ErrorSignals._make([*_measured(run), chi, e, push])


def _signals_as_mended(run: Run) -> ErrorSignals:
    """Return the signals of a run of one output on the measured side: B u cancels in x~'."""
    chi = _signed_sides(run.side[:, 0])
    e = run.y[:, 0] - run.z_hat[:, 0] + (chi * run.d_hat).sum(axis=1)
    return ErrorSignals._make([*_measured(run), chi, e, 0.0 * run.x])


def _measured(run: Run) -> tuple[Floats, ...]:
    """Return x, x^, z, z^, y, u, d^ and the measured side of a run of one output."""
    outputs = (signal[:, 0] for signal in (run.z, run.z_hat, run.y, run.u))
    return run.x, run.x_hat, *outputs, run.d_hat, run.side[:, 0]


def _signed_sides(side: Floats) -> Floats:
    """Return [chi_r -chi_l] of a side (N x 2)."""
    return np.stack([1.0 * (side > 0), -1.0 * (side < 0)], axis=1)


def _indicator_errors(s: ErrorSignals) -> Floats:
    """Return the differences of the indicators from the branches of x, (9) and (10) (N x 2)."""
    return np.abs(s.chi) - _branch_flags(s.z, D)


def _branch_flags(values: Floats, edge: float) -> Floats:
    """Return 1 above the edge, and 1 below minus the edge, else 0 (N x 2)."""
    return np.stack([values > edge, values < -edge], axis=1) * 1.0


def _differences(
    s: ErrorSignals, linear: Matrices, L: tuple[float, ...], sign: float
) -> dict[int, Floats]:
    """Return left less right side of each equation that has the same form printed and mended.

    In (22)-(24) L chi_bar d~ stands for L C chi_bar d~.

    Args:
        s: signals of either version
        linear: A, B, C
        L: gains of the observer
        sign: of the last term of (24), which is that of (23) as mended
    """
    A, _, C = linear
    offset = s.take_off(D)
    sat = np.clip(s.z, -D, D)
    off = s.take_off(s.d_error)
    seen = s.x_error @ C[0]
    innovation = s.e - (s.z - s.z_hat - off)
    in_states = s.e - (seen - off)
    in_errors = np.outer(seen - off, L)
    moved = s.x_error @ A.T + s.push - np.outer(s.e, L)
    drift = m.error_matrix(linear, L)
    return {
        **dict.fromkeys((11, 12), s.y - (s.z - offset)),
        13: np.abs(sat) - np.abs(offset),
        **dict.fromkeys((18, 19), np.outer(innovation, L)),
        20: np.outer(in_states, L),
        21: offset - sat,
        22: moved - (s.x @ A.T + s.push - s.x_hat @ A.T - in_errors),
        23: moved - (s.x_error @ A.T + s.push - in_errors),
        24: moved - (s.x_error @ drift.T + s.push + sign * np.outer(off, L)),
        26: s.y + s.take_off(s.d_hat) - (s.z - off),
        27: innovation,
        28: in_states,
    }


def _differences_as_printed(p: ErrorSignals, linear: Matrices) -> dict[int, Any]:
    """Return left less right side of equations that are printed in a form of their own."""
    A, B, C = linear
    drift = m.error_matrix(linear)
    P = m.printed_riccati(linear, drift).P
    sat = np.clip(p.z, -D, D)
    estimated = np.clip(p.z_hat, -p.d_hat[:, 1], p.d_hat[:, 0])
    sign = np.sign(p.y)
    above = _branch_flags(p.z, 0.0) - _branch_flags(p.z, D)
    step = float(C[0] @ P @ L_PRINTED) * p.chi
    residual = drift.T @ P + P @ drift - 2 * ALPHA * P @ B @ B.T @ P + np.eye(len(A))
    slope = A - [[0.0, 1.0], [0.0, -3.0]]  # of (41)
    return {
        1: p.y - np.where(p.z > D, p.z - D, np.where(p.z < -D, p.z + D, 0.0)),
        2: np.maximum(0.0, np.abs(sat) - abs(D - D)),  # |d_r - d_l|, here 0
        **dict.fromkeys((3, 4, 14, 17), p.y - (p.z - sat)),
        5: above[:, 0],
        6: above[:, 1],
        7: (sign - p.side)[p.side != 0],
        8: np.tanh(m.SHARPNESS * p.y) - sign,
        15: A - companion_form(np.zeros(len(A))).A,
        16: motion_at_truth(example_as_printed(1.0), p),
        18: np.outer(p.e - (p.z - sat - p.z_hat + estimated), L_PRINTED),
        25: _largest_rise(step, p),
        29: ALPHA * float(B[:, 0] @ P @ L_PRINTED) * (p.take_off(p.d_error) + p.e),
        34: residual,
        37: -np.array([OMEGA, 2 * OMEGA]) - OF_38,  # omega_n = 2 pi, zeta = 1
        38: A[1] - OF_38,
        39: B[:, 0] - [0.0, 1.0],
        40: pole_error(linear, L_PRINTED),
        41: p.x_hat @ slope.T,
        42: 2 * ALPHA * np.outer(p.e, B[:, 0] @ P),  # its halves have opposite signs
    }


def _differences_as_mended(p: ErrorSignals, q: ErrorSignals, linear: Matrices) -> dict[int, Any]:
    """Return left less right side of equations that are mended in a form of their own."""
    A = linear.A
    sat = np.abs(np.clip(p.z, -D, D))
    return {
        2: np.maximum(0.0, sat - saturation_bound(D, D)),
        15: A - companion_form(-A[-1]).A,
        16: motion_at_truth(example_as_repaired(1.0), p),
        25: _largest_rise(_signed_sides(p.side), p),
        37: linear_matrices(READINGS["omega_n = 1"].plant).A[1] - OF_38,
        40: pole_error(linear, observer_gain(linear, POLES, None).ravel()),
        41: p.x_hat @ (A - [[0.0, 1.0], [-1.0, -2.0]]).T,
    }


OF_38: Final = np.array([-1.0, -2.0])  # coefficients


def _largest_rise(step: Floats, p: ErrorSignals) -> float:
    """Return the largest rate at which (25) makes |d~|^2 / 2 rise with x^ = x, at least 0 [1/s].

    Then y~ = -chi_bar d~, on the measured side.

    Args:
        step: d^' per y~, each width's
        p: signals along which d~ is taken
    """
    of_widths = (_signed_sides(p.side) * p.d_error).sum(axis=1)
    return max(0.0, float(-(of_widths * (step * p.d_error).sum(axis=1)).min()))


def motion_at_truth(scenario: Scenario, s: ErrorSignals) -> float:
    """Return the largest |x^' - x'| of an observer with x^ = x and d^ = d, by its own graph.

    Args:
        scenario: of the observer and the plant
        s: signals at whose x, u and y both are taken
    """
    problem = resolve_scenario(scenario)
    model = problem.plant
    observer = require_graph(problem.observer)
    x = ca.SX.sym("x", 2)
    u, y, side = map(ca.SX.sym, ("u", "y", "side"))
    widths = np.array([D])
    state = observer.init(observer.params)._replace(x=x, right=widths, left=widths)
    moved, _ = observer.step(observer.params, state, u, Reading(y, side))
    apart = moved.x - model.move(model.params, x, u)
    function = ca.Function("apart", [x, u, y, side], [apart])
    values = function.map(len(s.u))(s.x.T, s.u[None], s.y[None], s.side[None])
    return m.largest_absolute(np.asarray(values))


def _error_at_zero_V(run: Run) -> float:
    """Return the largest |x~| among samples with V = 0.

    V proves convergence of x^ only if it is positive definite: V = 0 implies x~ = 0. (30) is a form
    in y~, which is 0 inside the zone whatever x~ is.
    """
    return float(np.abs((run.x - run.x_hat)[run.V == 0.0]).max(initial=0.0))


def _differences_of_V(p: ErrorSignals, linear: Matrices) -> dict[int, Floats]:
    """Return V' along p less the right sides of (31)-(36).

    For y~ M y~' with a matrix M stands y~ C M C' y~, as for P in (30). For y~ P L C chi_bar d~
    stands y~ C P L chi_bar d~, and sigma of (25) is 1.
    """
    A, B, C = linear
    c = C[0]
    drift = m.error_matrix(linear)
    P = m.printed_riccati(linear, drift).P
    size = float(c @ P @ c)
    gain = float(c @ P @ L_PRINTED)
    d_moved = -gain * p.e[:, None] * p.chi  # d^', so that d~' = -d^'
    of_widths = -(p.d_error * d_moved).sum(axis=1)  # d~ d~' / sigma
    offset = p.take_off(p.d_error)
    y_moved = np.where(p.side != 0, p.x[:, 1], 0.0)
    side = zone(p.z_hat, *p.d_hat.T)
    z_hat_moved = (p.x_hat @ A.T + np.outer(p.e, L_PRINTED))[:, 0]
    y_hat_moved = np.abs(side) * z_hat_moved - (_signed_sides(side) * d_moved).sum(axis=1)
    V_moved = 2 * size * p.e * (y_moved - y_hat_moved) + of_widths
    form = p.x_error @ drift.T + p.push - np.outer(offset, L_PRINTED)
    square = float(c @ drift.T @ P @ c + c @ drift @ P @ c)
    push = float(c @ P @ B[:, 0])
    cross = 2 * p.e * gain * offset
    fall = -float(c @ c) * p.e**2  # -y~ C Q C' y~ with Q = I
    return {
        31: V_moved - (2 * size * (p.x_error @ c) * (form @ c) + of_widths),
        32: V_moved - (square * p.e**2 + 2 * p.e * p.u * push - cross - of_widths),
        33: V_moved - ((square - 2 * ALPHA * push**2) * p.e**2 - cross + of_widths),
        # -2 d~ (y~ P L C chi_bar - d~' / sigma), as printed
        35: V_moved - (fall - cross + 2 * of_widths),
        36: V_moved - fall,
    }
