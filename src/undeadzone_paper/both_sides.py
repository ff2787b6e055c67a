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
from undeadzone.linalg.riccati import paper_riccati
from undeadzone.nonlinearities.sensor import resolve, saturation_bound
from undeadzone.plants.build import system
from undeadzone.plants.options import linear_matrices
from undeadzone.results.run import Run
from undeadzone.scenario.schema import Scenario
from undeadzone.util.arrays import Floats
from undeadzone_paper import measures as m
from undeadzone_paper.evidence import RESTING, Evidence
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
from undeadzone_paper.trials import SHARPNESS, pole_error

SIGMA: Final = 1.0  # of (25)
STAND_INS: Final = {
    "(22)-(24) L C chi_bar d~": "L (chi_bar d~), as in (20): C would multiply a scalar",
    "(30)-(36) y~ M y~'": "y~ C M C' y~ for every n x n matrix M, and C P L for P L C, as in (25)",
}


class BothSides(NamedTuple):
    """Difference of both sides of an equation.

    Attributes:
        compares: the two sides, in words
        printed: their largest difference as printed
        mended: the same as mended (None: not mended)
    """

    compares: str
    printed: float
    mended: float | None


class ErrorSignals(NamedTuple):
    """Signals of a run beside their estimates, a row for each sample.

    Attributes:
        x, x_hat: state and its estimate (N x 2)
        z, z_hat, y, y_hat, u: output, reading, input, and estimates of the former (N)
        e: y~ = y - y^ (N)
        d_hat: d^ (N x 2)
        side: the measured side (N)
    """

    x: Floats
    x_hat: Floats
    z: Floats
    z_hat: Floats
    y: Floats
    y_hat: Floats
    u: Floats
    e: Floats
    d_hat: Floats
    side: Floats

    @property
    def x_error(self) -> Floats:
        """Return x~ = x - x^ (N x 2)."""
        return self.x - self.x_hat

    @property
    def d_error(self) -> Floats:
        """Return d~ = d - d^ of (21) (N x 2)."""
        return D - self.d_hat

    @property
    def chi(self) -> Floats:
        """Return [chi_r chi_l] of (8)-(10) (N x 2)."""
        sign = np.tanh(SHARPNESS * self.y)
        return np.stack([(1 + sign) / 2, (1 - sign) / 2], axis=1)

    @property
    def mended_chi(self) -> Floats:
        """Return [chi_r -chi_l] of the measured side (N x 2)."""
        return np.stack([1.0 * (self.side > 0), -1.0 * (self.side < 0)], axis=1)


def compare_sides(evidence: Evidence) -> dict[int, BothSides]:
    """Compute both sides of every equation, by its number."""
    theorem = evidence.law[0]
    repaired = evidence.repaired[0]
    linear = linear_matrices(example_as_printed(1.0).plant)
    printed = _signals_of(theorem)
    mended = _signals_of(repaired)
    compared = {
        **_sides_of_sensor(printed, mended),
        **_sides_of_observer(printed, mended, linear),
        **_sides_of_errors(printed, mended, linear),
        **_sides_of_law(printed, mended, linear),
        **_sides_of_V(printed, linear, m.lyapunov_rise(repaired)),
        30: _sides_of_positivity(evidence.printed[RESTING][0], repaired),
        **_sides_of_example(printed, linear),
    }
    return dict(sorted(compared.items()))


def _signals_of(run: Run) -> ErrorSignals:
    """Return the signals of a run of one output."""
    y_hat = m.reading_estimate(run)
    return ErrorSignals(
        run.x,
        run.x_hat,
        run.z[:, 0],
        run.z_hat[:, 0],
        run.y[:, 0],
        y_hat,
        run.u[:, 0],
        run.y[:, 0] - y_hat,
        run.d_hat,
        run.side[:, 0],
    )


def _compare(words: str, left: Floats, right: Any, mended: float | None = None) -> BothSides:
    """Return the largest difference of two sides as printed, beside that as mended."""
    return BothSides(words, m.largest_absolute(left - right), mended)


def _sum_over_sides(chi: Floats, widths: Floats | float) -> Floats:
    """Return chi_bar times widths, one for both sides or one for each (N)."""
    return np.asarray((chi * widths).sum(axis=1))


def _innovation_by_errors(s: ErrorSignals, C: Floats, chi: Floats) -> Floats:
    """Return C x~ - chi_bar d~, the right side of (28) (N)."""
    return np.asarray(s.x_error @ C[0] - _sum_over_sides(chi, s.d_error))


def _branch_flags(values: Floats, edge: float) -> Floats:
    """Return 1 above the edge, and 1 below minus the edge, else 0 (N x 2)."""
    return np.stack([values > edge, values < -edge], axis=1) * 1.0


def _saturation_by_branches(z: Floats, right: Floats | float, left: Floats | float) -> Floats:
    """Return Sat of (4), branch by branch."""
    return np.where(z > right, right, np.where(z < -left, -left, z))


def _sides_of_sensor(p: ErrorSignals, q: ErrorSignals) -> dict[int, BothSides]:
    """Return the largest difference of both sides of (1)-(13) and (21), by equation number.

    Args:
        p: signals of the run as printed.
        q: signals of the repaired run.
    """
    sat = _saturation_by_branches(p.z, D, D)
    branches = np.where(p.z > D, p.z - D, np.where(p.z < -D, p.z + D, 0.0))
    outside = p.side != 0
    read = q.side != 0
    sign = np.sign(p.y)
    branch = _branch_flags(p.z, D)
    offset = _sum_over_sides(p.chi, D)
    mended_offset = _sum_over_sides(q.mended_chi, D)
    mended_side = _branch_flags(q.side, 0.0)
    mended_branch = _branch_flags(q.z, D)
    side_error = m.largest_absolute(mended_side - mended_branch)
    offset_error = m.largest_absolute((q.y - (q.z - mended_offset))[read])
    of_z = _branch_flags(p.z, 0.0)
    mended_sat = m.largest_absolute((np.abs(q.z - q.y) - np.abs(mended_offset))[read])
    return {
        1: _compare("y that was read, and Dz(x) by branches", p.y, branches),
        2: BothSides(
            "largest |Sat x|, and the least d_M of the bound",
            max(0.0, m.largest_absolute(sat) - abs(D - D)),  # |d_r - d_l| as printed, here 0
            max(0.0, m.largest_absolute(sat) - saturation_bound(D, D)),
        ),
        3: _compare("y that was read, and x - Sat(x)", p.y, (p.z - sat)),
        4: _compare("x - y that was read, and Sat(x) by branches", p.z - p.y, sat),
        5: _compare("chi_r, and whether x > d_r", of_z[:, 0], branch[:, 0], side_error),
        6: _compare("chi_l, and whether x < -d_l", of_z[:, 1], branch[:, 1], side_error),
        7: BothSides(
            "sgn y, and the side, outside the zone",
            m.largest_absolute((sign - p.side)[outside]),
            None,
        ),
        8: _compare("tanh(k_s y), and sgn y", np.tanh(SHARPNESS * p.y), sign, side_error),
        9: _compare("chi_r, and whether x > d_r", p.chi[:, 0], branch[:, 0], side_error),
        10: _compare("chi_l, and whether x < -d_l", p.chi[:, 1], branch[:, 1], side_error),
        11: _compare("y, and x - chi_l d_l - chi_r d_r", p.y, (p.z - offset), offset_error),
        12: _compare("y, and x - chi_bar d", p.y, (p.z - offset), offset_error),
        13: _compare("|Sat|, and |chi_bar d|", np.abs(sat), np.abs(offset), mended_sat),
        21: _compare("chi_bar d, and Sat x", offset, sat, offset_error),
    }


def _sides_of_observer(p: ErrorSignals, q: ErrorSignals, linear: Matrices) -> dict[int, BothSides]:
    """Compare both sides of (14)-(20), as printed along p, as mended along q."""
    A, _, C = linear
    L = np.array(L_PRINTED)
    L_mended = np.array(L_REPAIRED)
    z_sat = _saturation_by_branches(p.z, D, D)
    estimated_sat = _saturation_by_branches(p.z_hat, p.d_hat[:, 0], p.d_hat[:, 1])
    of_18 = p.z - z_sat - p.z_hat + estimated_sat
    of_19 = p.z - p.z_hat - _sum_over_sides(p.chi, D) + _sum_over_sides(p.chi, p.d_hat)
    of_20 = _innovation_by_errors(p, C, p.chi)
    e = _innovation_on_side(q)
    read = q.side != 0
    mended = _innovation_by_errors(q, C, q.mended_chi)
    mended_difference = m.largest_absolute(np.outer(e - mended, L_mended)[read])
    moved = "x^', and its right side"
    return {
        14: BothSides(
            "y that was read, and C x - Sat(C x)", m.largest_absolute(p.y - p.z + z_sat), None
        ),
        15: _compare(
            "A of (39), and A of (15)",
            A,
            companion_form(np.zeros(len(A))).A,
            m.largest_absolute(A - companion_form(-A[-1]).A),
        ),
        16: BothSides(
            "x^', and x', if x^ = x and d^ = d",
            motion_at_truth(example_as_printed(1.0), p),
            motion_at_truth(example_as_repaired(1.0), p),
        ),
        17: _compare("y^, and y, if x^ = x and d^ = d", p.y, (p.z - z_sat)),
        18: BothSides(moved, m.largest_absolute(np.outer(p.e - of_18, L)), mended_difference),
        19: BothSides(moved, m.largest_absolute(np.outer(p.e - of_19, L)), mended_difference),
        20: BothSides(moved, m.largest_absolute(np.outer(p.e - of_20, L)), mended_difference),
    }


def motion_at_truth(scenario: Scenario, s: ErrorSignals) -> float:
    """Return the largest |x^' - x'| of an observer with x^ = x and d^ = d, by its own graph.

    Args:
        scenario: of the observer and the plant
        s: signals at whose x, u and y both are taken
    """
    model = system(scenario.plant)
    sensor = resolve(scenario.sensor, 1, scenario.simulation.step)
    observer = require_graph(scenario.observer.build(model, sensor))
    x = ca.SX.sym("x", 2)
    u = ca.SX.sym("u")
    y = ca.SX.sym("y")
    side = ca.SX.sym("side")
    widths = np.array([D])
    state = observer.init(observer.params)._replace(x=x, right=widths, left=widths)
    moved, _ = observer.step(observer.params, state, u, Reading(y, side))
    apart = moved.x - model.move(model.params, x, u)
    function = ca.Function("apart", [x, u, y, side], [apart])
    values = function.map(len(s.u))(s.x.T, s.u[None], s.y[None], s.side[None])
    return m.largest_absolute(np.asarray(values))


def _innovation_on_side(q: ErrorSignals) -> Floats:
    """Return y - y^ on the measured side (N), 0 inside the zone."""
    y_hat = q.z_hat - _sum_over_sides(q.mended_chi, q.d_hat)
    return np.where(q.side != 0, q.y - y_hat, 0.0)


def _state_error_forms(
    s: ErrorSignals, linear: Matrices, L: Floats, chi: Floats, feed: float
) -> tuple[Floats, Floats, Floats]:
    """Return (22), (23) and (24) of x~' (N x 2), with L chi_bar d~ for L C chi_bar d~.

    Args:
        s: the signals
        linear: A, B, C
        L: gains of the observer
        chi: the indicators that are taken (N x 2)
        feed: 1 if B u stays in these equations, 0 if it cancels
    """
    A, B, C = linear
    push = feed * np.outer(s.u, B[:, 0])
    offset = np.outer(_sum_over_sides(chi, s.d_error), L)
    seen = np.outer(s.x_error @ C[0], L)
    first = s.x @ A.T + push - s.x_hat @ A.T - (seen - offset)
    second = s.x_error @ A.T + push - (seen - offset)
    third = s.x_error @ (A - np.outer(L, C[0])).T + push - offset
    return first, second, third


def _sides_of_errors(p: ErrorSignals, q: ErrorSignals, linear: Matrices) -> dict[int, BothSides]:
    """Compare both sides of (22)-(24), (27), (28), as printed along p, as mended along q."""
    A, B, C = linear
    L = np.array(L_PRINTED)
    L_mended = np.array(L_REPAIRED)
    moved = p.x @ A.T + np.outer(p.u, B[:, 0]) - (p.x_hat @ A.T + np.outer(p.e, L))
    printed = _state_error_forms(p, linear, L, p.chi, 1.0)
    e = _innovation_on_side(q)
    read = q.side != 0
    moved_mended = q.x_error @ A.T - np.outer(e, L_mended)
    first, second, third = _state_error_forms(q, linear, L_mended, q.mended_chi, 0.0)
    twice = 2 * np.outer(_sum_over_sides(q.mended_chi, q.d_error), L_mended)
    mended = (first, second, third + twice)  # the sign of the last term is that of (23)
    compared = {
        number: _compare(
            "x~', and its right side", moved, form, m.largest_absolute((moved_mended - same)[read])
        )
        for number, form, same in zip((22, 23, 24), printed, mended, strict=True)
    }
    of_28 = _innovation_by_errors(p, C, p.chi)
    of_28_mended = _innovation_by_errors(q, C, q.mended_chi)
    same = m.largest_absolute((e - of_28_mended)[read])
    return {
        **compared,
        27: _compare("y~, and C (x - x^) - chi_bar (d - d^)", p.e, of_28, same),
        28: _compare("y~, and C x~ - chi_bar d~", p.e, of_28, same),
    }


def _sides_of_law(p: ErrorSignals, q: ErrorSignals, linear: Matrices) -> dict[int, BothSides]:
    """Compare both sides of (25), (26), (29), (42), as printed along p, as mended along q."""
    _, B, C = linear
    P = _printed_P(linear)
    L = np.array(L_PRINTED)
    # With x^ = x: y~ = -chi_bar d~, on the measured side.
    of_widths = _sum_over_sides(p.mended_chi, p.d_error)[:, None]
    printed_step = SIGMA * of_widths * float(C[0] @ P @ L) * p.chi
    mended_step = of_widths * p.mended_chi
    restored = p.y + _sum_over_sides(p.chi, p.d_hat)
    of_26 = p.z - _sum_over_sides(p.chi, p.d_error)
    read = q.side != 0
    mended = q.y + _sum_over_sides(q.mended_chi, q.d_hat)
    of_26_mended = q.z - _sum_over_sides(q.mended_chi, q.d_error)
    unknown = ALPHA * float(B[:, 0] @ P @ L) * (_sum_over_sides(p.chi, p.d_error) + p.e)
    halves = 2 * ALPHA * m.largest_absolute(np.outer(p.e, B[:, 0] @ P))
    return {
        25: BothSides(
            "rise of |d~|^2 / 2 by d^' with x^ = x, and 0 [1/s]",
            _largest_rise(printed_step, p.d_error),
            _largest_rise(mended_step, p.d_error),
        ),
        26: _compare(
            "y + chi_bar d^, and C {x - (d - d^) chi_bar}",
            restored,
            of_26,
            m.largest_absolute((mended - of_26_mended)[read]),
        ),
        29: BothSides(
            "u with d - d^ given, and by (28) with x^ = x", m.largest_absolute(unknown), None
        ),
        42: BothSides("alpha B'P [y~ y~], and -k_p y~ - k_d y~", halves, None),
    }


def _largest_rise(step: Floats, error: Floats) -> float:
    """Return the largest rate at which d^' = step makes |d~|^2 / 2 rise, at least 0."""
    return max(0.0, float(-_sum_over_sides(step, error).min()))


def _sides_of_positivity(resting: Run, repaired: Run) -> BothSides:
    """Compare 0 and the largest |x~| at samples with V = 0, for (30) and for the certificate.

    V proves convergence of x^ only if it is positive definite: V = 0 implies x~ = 0. (30) is a form
    in y~, which is 0 inside the zone whatever x~ is.

    Args:
        resting: run of the printed observer from rest.
        repaired: run of the repaired observer, with V of its certificate.
    """

    def error_at_zero_V(run: Run) -> float:
        """Return the largest |x~| among samples with V = 0; a run without V counts as V = 0."""
        is_zero = (np.zeros(run.t.size) if run.V is None else run.V) == 0.0
        return m.largest_absolute((run.x - run.x_hat)[is_zero]) if is_zero.any() else 0.0

    return BothSides("|x~| where V = 0, and 0", error_at_zero_V(resting), error_at_zero_V(repaired))


def _printed_P(linear: Matrices) -> Floats:
    """Return P of (34) with A - L C, L of (40) (2 x 2)."""
    A, B, C = linear
    drift = A - np.outer(L_PRINTED, C[0])
    return paper_riccati(drift, B, ALPHA, np.eye(len(A))).P


def _sides_of_V(p: ErrorSignals, linear: Matrices, rise: float) -> dict[int, BothSides]:
    """Compare both sides of (30)-(36) along p. `rise` is that of the certificate's V.

    For y~ M y~' with a matrix M stands y~ C M C' y~, as for P in (30). For y~ P L C chi_bar d~
    stands y~ C P L chi_bar d~.
    """
    A, B, C = linear
    P = _printed_P(linear)
    L = np.array(L_PRINTED)
    c = C[0]
    drift = A - np.outer(L, c)
    size = float(c @ P @ c)
    gain = float(c @ P @ L)
    d_moved = -SIGMA * gain * p.e[:, None] * p.chi  # d^', so that d~' = -d^'
    of_widths = -_sum_over_sides(p.d_error, d_moved) / SIGMA  # d~ d~' / sigma
    offset = _sum_over_sides(p.chi, p.d_error)
    y_moved = np.where(p.side != 0, p.x[:, 1], 0.0)
    estimated_side = 1.0 * (p.z_hat > p.d_hat[:, 0]) - 1.0 * (p.z_hat < -p.d_hat[:, 1])
    x_hat_moved = p.x_hat @ A.T + np.outer(p.e, L)
    y_hat_moved = np.where(
        estimated_side > 0,
        x_hat_moved[:, 0] - d_moved[:, 0],
        np.where(estimated_side < 0, x_hat_moved[:, 0] + d_moved[:, 1], 0.0),
    )
    V_moved = 2 * size * p.e * (y_moved - y_hat_moved) + of_widths
    form = p.x_error @ drift.T + np.outer(p.u, B[:, 0]) - np.outer(offset, L)
    of_31 = 2 * size * (p.x_error @ c) * (form @ c) + of_widths
    square = float(c @ drift.T @ P @ c + c @ drift @ P @ c)
    push = float(c @ P @ B[:, 0])
    cross = p.e * gain * offset
    of_32 = square * p.e**2 + 2 * p.e * p.u * push - 2 * cross - of_widths
    of_33 = (square - 2 * ALPHA * push**2) * p.e**2 - 2 * cross + of_widths
    Q = np.eye(len(A))
    # -2 d~ (y~ P L C chi_bar - d~' / sigma), as printed
    of_35 = -float(c @ Q @ c) * p.e**2 - 2 * cross + 2 * of_widths
    of_36 = -float(c @ Q @ c) * p.e**2
    residual = drift.T @ P + P @ drift - 2 * ALPHA * P @ B @ B.T @ P + Q
    label = "V' along the run, and its right side"
    return {
        31: _compare(label, V_moved, of_31),
        32: _compare(label, V_moved, of_32),
        33: _compare(label, V_moved, of_33),
        34: BothSides("left side, and -Q", m.largest_absolute(residual), None),
        35: _compare(label, V_moved, of_35),
        36: _compare(label, V_moved, of_36, rise),
    }


def _sides_of_example(p: ErrorSignals, linear: Matrices) -> dict[int, BothSides]:
    """Compare both sides of (37)-(41)."""
    A, B, _ = linear
    of_37 = -np.array([OMEGA, 2 * OMEGA])  # omega_n = 2 pi, zeta = 1
    mended = linear_matrices(READINGS["omega_n = 1"].plant).A[1]
    of_41 = np.stack([p.x_hat[:, 1], -p.x_hat[:, 1] - 2 * p.x_hat[:, 1]], axis=1)
    mended_41 = np.stack([p.x_hat[:, 1], -p.x_hat[:, 0] - 2 * p.x_hat[:, 1]], axis=1)
    moved = p.x_hat @ A.T
    of_38 = [-1.0, -2.0]
    return {
        37: _compare(
            "its coefficients, and those of (38)", of_37, of_38, m.largest_absolute(mended - of_38)
        ),
        38: _compare("its coefficients, and A of (39)", A[1], of_38),
        39: _compare("B, and that of (38)", B[:, 0], [0.0, 1.0]),
        40: BothSides(
            "poles of A - L C, and (-4, -10)",
            pole_error(linear, L_PRINTED),
            pole_error(linear, observer_gain(linear, POLES, None).ravel()),
        ),
        41: _compare(
            "A x^, and its right side", moved, of_41, m.largest_absolute(moved - mended_41)
        ),
    }
