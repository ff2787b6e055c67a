"""The paper's equations (1)-(42) and figures 1-8.

Each equation is listed with its meaning, its place in the code, as printed or corrected, and the
changes. The paper's claims about them stand in `claims.toml`, and only there.
"""

from __future__ import annotations

from typing import Final, Literal, NamedTuple

Status = Literal["as printed", "corrected", "not used"]


class Equation(NamedTuple):
    """One equation of the paper.

    Attributes:
        number: its number
        what: its meaning
        where: the object of this package that holds it, or computes it
        status: whether it is used as printed, corrected, or not at all (but computed)
        reason: why
    """

    number: int
    what: str
    where: str
    status: Status
    reason: str


ASSUMPTIONS: Final = {
    1: "d_r > 0 and -d_l < 0",
    2: "the initial d^ is d",
    3: "the slope m is positive and set to 1",
    4: "y = Dz(x) is measured, the states x are not",
}
DIAGRAMS: Final = {
    1: "system with output dead zone",
    2: "adaptive observer with the estimate of the dead zone",
}
FIGURES: Final = {
    3: "observer output y^ and reading y",
    4: "error y^ - y",
    5: "observer state x^1 and state x1",
    6: "error x^1 - x1",
    7: "error x^2 - x2",
    8: "width estimates d^",
}

_TABLE: Final[tuple[tuple[int, str, str, Status, str], ...]] = (
    (
        1,
        "dead zone by branches",
        "nonlinearities.sensor.deadzone",
        "as printed",
        "with d_l > 0 (A1)",
    ),
    (
        2,
        "bound on the width",
        "nonlinearities.sensor.saturation_bound",
        "corrected",
        "d_r + d_l <= d_M",
    ),
    (
        3,
        "dead zone = x - Sat x",
        "nonlinearities.sensor.deadzone",
        "as printed",
        "times the slope m",
    ),
    (4, "saturation", "nonlinearities.sensor.saturation", "as printed", "with d_l > 0"),
    (
        5,
        "indicator chi_r",
        "nonlinearities.sensor.side",
        "corrected",
        "x > 0 is not x > d_r; the side of the measured y is used",
    ),
    (
        6,
        "indicator chi_l",
        "nonlinearities.sensor.side",
        "corrected",
        "as (5); silence is a third value",
    ),
    (7, "sgn y", "nonlinearities.sensor.side", "corrected", "0 within the noise threshold"),
    (
        8,
        "tanh(k_s y) for sgn",
        "nonlinearities.sensor.indicators",
        "as printed",
        "offered, and used by the observer as printed",
    ),
    (9, "smooth chi_r", "nonlinearities.sensor.indicators", "as printed", "as (8)"),
    (10, "smooth chi_l", "nonlinearities.sensor.indicators", "as printed", "as (8)"),
    (
        11,
        "y = x - chi_l d_l - chi_r d_r",
        "nonlinearities.sensor.branch",
        "corrected",
        "y = z - chi_r d_r + chi_l d_l with d_l > 0, outside the zone only",
    ),
    (
        12,
        "y = x - chi_bar d",
        "nonlinearities.sensor.offset",
        "corrected",
        "chi_bar = [chi_r, -chi_l]",
    ),
    (
        13,
        "|Sat| = |chi_bar d| <= d_M",
        "nonlinearities.sensor.saturation_bound",
        "corrected",
        "with d_M >= d_r + d_l",
    ),
    (
        14,
        "x' = A x + B u, y = Dz(C x)",
        "simulation.close.close",
        "as printed",
        "any A, B, C, several outputs, nonlinear plants too",
    ),
    (
        15,
        "A, B, C: chain of integrators",
        "linalg.matrices.companion_form",
        "corrected",
        "(39) is not in this class; last row -a; no certificate exists for a pure chain, n >= 2",
    ),
    (
        16,
        "observer x^' = A x^ + L (y - y^)",
        "observers.adaptive.branch_observer.build_branch_observer",
        "corrected",
        "B u was missing, L is n x 1: as printed in undeadzone_paper.observer",
    ),
    (
        17,
        "y^ = C x^ - Sat(C x^)",
        "undeadzone_paper.observer.Printed",
        "as printed",
        "the repaired observer takes the measured side, not that of the estimate",
    ),
    (
        18,
        "(16) with (17) inserted",
        "observers.adaptive.branch_observer.build_branch_observer",
        "corrected",
        "as (16)",
    ),
    (
        19,
        "(18) by indicators",
        "observers.adaptive.branch_observer.build_branch_observer",
        "corrected",
        "needs one and the same side for plant and observer: the measured one",
    ),
    (
        20,
        "(19) in errors",
        "observers.adaptive.branch_observer.build_branch_observer",
        "corrected",
        "as (19)",
    ),
    (
        21,
        "d~ = d - d^, chi_bar",
        "analysis.certificate.passivity.Certificate",
        "corrected",
        "chi_bar = [chi_r, -chi_l]",
    ),
    (
        22,
        "state error, first form",
        "analysis.certificate.passivity.certify",
        "corrected",
        "B u cancels once the observer has it. L chi_bar d~, not L C chi_bar d~",
    ),
    (
        23,
        "state error, second form",
        "analysis.certificate.passivity.certify",
        "corrected",
        "as (22)",
    ),
    (
        24,
        "state error, third form",
        "analysis.certificate.passivity.certify",
        "corrected",
        "as (22), and a sign flips from (23)",
    ),
    (
        25,
        "adaptation of d^",
        "observers.adaptive.branch_observer.build_branch_observer",
        "corrected",
        "shapes disagree; d^_r' = -gamma e on the right, d^_l' = gamma e on the left",
    ),
    (
        26,
        "dead zone inverse",
        "nonlinearities.sensor.inverse",
        "corrected",
        "y + chi_bar d^, C would multiply a scalar",
    ),
    (
        27,
        "output error by indicators",
        "observers.adaptive.branch_observer.build_branch_observer",
        "corrected",
        "the innovation e, on the measured side",
    ),
    (
        28,
        "output error = C x~ - chi_bar d~",
        "analysis.certificate.passivity.certify",
        "corrected",
        "with chi_bar of (21); before (22) y~ is said to be C x~ alone",
    ),
    (
        29,
        "adaptive controller",
        "controllers.state_feedback.StateFeedback",
        "corrected",
        "y~ is scalar, d~ unknown, u_ff - K (x^ - x_ref): as printed in undeadzone_paper.law",
    ),
    (
        30,
        "Lyapunov function",
        "analysis.certificate.passivity.Certificate",
        "corrected",
        "of the state error: x~'P x~ + |d~|^2 / gamma",
    ),
    (
        31,
        "V', first form",
        "undeadzone_paper.both_sides.compare_sides",
        "not used",
        "chi_bar d~' and the jumps of y~ are left out",
    ),
    (
        32,
        "V', regrouped",
        "undeadzone_paper.both_sides.compare_sides",
        "not used",
        "a sign of d~ d~' / sigma flips",
    ),
    (
        33,
        "V' with the control law",
        "undeadzone_paper.both_sides.compare_sides",
        "not used",
        "a cross term is dropped, the sign flips back, u does not act on x~ at all",
    ),
    (
        34,
        "Riccati equation",
        "linalg.riccati.paper_riccati",
        "corrected",
        "with A for control, in place of A - L C",
    ),
    (
        35,
        "V' simplified",
        "undeadzone_paper.both_sides.compare_sides",
        "not used",
        "off by a factor 2. V' is now one matrix inequality, see (36)",
    ),
    (
        36,
        "V' = -y~'Q y~",
        "analysis.certificate.passivity.certify",
        "corrected",
        "the inequality M < 0, which implies x~ -> 0, and d~ -> 0 if both sides are visited",
    ),
    (
        37,
        "second-order plant",
        "plants.options.SecondOrder",
        "corrected",
        "omega_n^2 x for omega_n x. All readings in paper.example.READINGS",
    ),
    (
        38,
        "the same as a state equation",
        "undeadzone_paper.example.example_as_printed",
        "as printed",
        "omega_n = 1, though the text says 2 pi",
    ),
    (
        39,
        "its A, B, C",
        "undeadzone_paper.example.example_as_printed",
        "as printed",
        "the default plant",
    ),
    (
        40,
        "observer gain",
        "linalg.poles.observer_gain",
        "corrected",
        "computed from the poles, for any observable plant",
    ),
    (
        41,
        "observer of the example",
        "undeadzone_paper.observer.Printed",
        "corrected",
        "-x^1 - 2 x^2 for -x^2 - 2 x^2, and L (y - y^) of (16)",
    ),
    (
        42,
        "PD law",
        "controllers.pd.PD",
        "as printed",
        "its right half, the left half has the other sign, y' - y^' filtered, r is a force",
    ),
)


def _build_equation(number: int, what: str, where: str, status: Status, reason: str) -> Equation:
    """Build a row of the table with the full name of its object.

    Names of the tool lack its package.
    """
    if not where.startswith("undeadzone_"):
        where = f"undeadzone.{where}"
    return Equation(number, what, where, status, reason)


EQUATIONS: Final = tuple(_build_equation(*row) for row in _TABLE)
