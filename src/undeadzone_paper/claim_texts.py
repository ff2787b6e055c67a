"""The paper's claims in words: the quantity that tests each, and the limit on that quantity."""

from __future__ import annotations

from typing import Final, NamedTuple

from undeadzone_paper.evidence import DISTURBANCE, MISMATCH, NOISE, SLOPE


class Text(NamedTuple):
    """A claim in words.

    Attributes:
        id: its name in this audit
        where: where the paper makes it
        claim: what it says
        quantity: what tests it
        limit: what the quantity must not exceed
        why: the reason for the verdict
        announced: whether the quantity counts what the paper announces and no figure shows
        ours: whether the quantity and its limit are this audit's reading, not a figure's claim
    """

    id: str
    where: str
    claim: str
    quantity: str
    limit: float
    why: str
    announced: bool = False
    ours: bool = False


TEXTS: Final = (
    Text(
        id="decomposition",
        where="(11), (12)",
        claim="The dead zone is z minus the widths, switched by the indicators",
        quantity="largest |y - (z - chi_bar d)| outside the zone",
        limit=1e-12,
        why=(
            "With d_l > 0 (A1) the left branch needs chi_bar = [chi_r, -chi_l]; inside the zone y "
            "= 0 and no such form holds."
        ),
    ),
    Text(
        id="width-bound",
        where="(2), (13)",
        claim="d_M bounds what the zone takes off",
        quantity="largest |Sat z| beyond the least d_M that (2) allows",
        limit=0.0,
        why="|d_r - d_l| is 0 for a symmetric zone; d_r + d_l is the width.",
    ),
    Text(
        id="indicators",
        where="(5)-(10)",
        claim="tanh(k_s y) with a large k_s stands for the branch indicators",
        quantity="largest error of an indicator",
        limit=1e-3,
        why=(
            "At y = 0 both are 1/2: silence counts as half of each side. A three-valued measured "
            "side has no such error."
        ),
    ),
    Text(
        id="unit-slope",
        where="A3",
        claim="m = 1 is no loss of generality",
        quantity=f"largest change of d^ when m = {SLOPE:g} instead",
        limit=1e-6,
        why="True once y is divided by m, which must then be known.",
    ),
    Text(
        id="observer-poles",
        where="(40)",
        claim="L = (-1.25, -1.62) puts the observer's poles at -4, -10",
        quantity="largest distance of a pole [1/s]",
        limit=1e-6,
        why=(
            "With (39) that needs L = (12, 15). A - L C of (40) is unstable; (12, 15) in turn is "
            "stable, yet has no certificate."
        ),
    ),
    Text(
        id="riccati-gain",
        where="(34), (42)",
        claim="The Riccati equation with A - L C gives a stabilising control gain",
        quantity="rightmost pole of A - B K [1/s]",
        limit=0.0,
        why=(
            "It does with the printed L of (40). With L = (12, 15), which the poles need, A - B K "
            "is unstable: for control the equation must hold A, not A - L C."
        ),
    ),
    Text(
        id="switching",
        where="abstract",
        claim="The switching function removes the error that the dead zone makes in the observer",
        quantity="rms of x^1 - x1, last 2 s, relative to an observer that takes y for z",
        limit=0.01,
        why="It does on the measured side, and with B u in the observer.",
    ),
    Text(
        id="reading-tracked",
        where="Theorem 4.1, figures 3 and 4",
        claim="y^ tracks y asymptotically",
        quantity="rms of y^ - y, last 2 s",
        limit=1e-3,
        why=(
            "From rest y^ = y = 0 says nothing; started at x1 = 5 it depends on the sign "
            "convention of d_l whether the loop diverges."
        ),
    ),
    Text(
        id="state-1",
        where="figures 5 and 6",
        claim="x^1 tracks x1 asymptotically",
        quantity="rms of x^1 - x1, last 2 s",
        limit=1e-3,
        why="(16) lacks B u: from rest x^ stays 0 while x moves.",
    ),
    Text(
        id="state-2",
        where="figure 7",
        claim="x^2 tracks x2 asymptotically",
        quantity="rms of x^2 - x2, last 2 s",
        limit=1e-3,
        why="As for x1.",
    ),
    Text(
        id="displacements",
        where="figures 5 and 6",
        claim="Sudden changes of the state error become rarer as the zone is cancelled",
        quantity="share of the last 5 s in which x^1 - x1 changes faster than 0.1/s",
        limit=0.0,
        why="As printed the error is x1 itself, for ever.",
    ),
    Text(
        id="widths",
        where="(25), (26)",
        claim="d^ converges to d",
        quantity="largest |d^ - d|, last 2 s",
        limit=1e-3,
        why=(
            "As printed d^ stays where it is from rest, and runs away from d when started outside "
            "the zone."
        ),
    ),
    Text(
        id="implied",
        where="section 3",
        claim="Once y^ tracks y, the widths are exact",
        quantity="largest |d^ - d| of a run with y^ = y from the start",
        limit=1e-3,
        why=(
            "No observer has this: inside the zone y^ = y = 0 whatever d^ is. The reference must "
            "cross both edges."
        ),
    ),
    Text(
        id="adaptation-bounded",
        where="figure 8",
        claim="The adaptation is bounded",
        quantity="largest |d^|",
        limit=3.0,
        why="V and the projection onto [0, d_M], d_M = 3, keep it so.",
    ),
    Text(
        id="lyapunov",
        where="(30)-(36)",
        claim="V never rises",
        quantity="largest rise of V above an earlier value, relative to its largest",
        limit=1e-9,
        why=(
            "(30) takes the output error for the state error. The certificate's V falls in "
            "continuous and in sampled time."
        ),
    ),
    Text(
        id="cancelled",
        where="(12), (26)",
        claim="Adding chi_bar d^ to y cancels the dead zone",
        quantity="rms of y + chi_bar d^ - z outside the zone",
        limit=1e-3,
        why="It does once d^ is right.",
    ),
    Text(
        id="cancelled-in-total",
        where="section 3",
        claim="The effect of the dead zone is eliminated in total",
        quantity="rms of y + chi_bar d^ - z, last 2 s",
        limit=1e-3,
        why=(
            "Inside the zone y = 0 tells nothing of z, and no inverse can; only the model's z^ "
            "bridges the gap."
        ),
    ),
    Text(
        id="tracking",
        where="section 4, conclusions",
        claim="The output follows the reference",
        quantity="rms of z - r, last 2 s",
        limit=1e-3,
        why=(
            "In (42) r is a force: from rest the plant never leaves the zone. Feedforward through "
            "x_ref and u_ff makes z follow r."
        ),
    ),
    Text(
        id="bounded",
        where="abstract, Theorem 4.1",
        claim="Bounded inputs give bounded signals (BIBO)",
        quantity="whether a run diverges (1: yes)",
        limit=0.0,
        why=(
            "As printed with a signed d_l, started at x1 = 5, the loop diverges. Repaired it "
            "never does, nor under noise, mismatch, disturbance."
        ),
    ),
    Text(
        id="robust-noise",
        where="conclusions",
        claim="Robust against noise (our measure)",
        quantity=f"largest |d^ - d|, last 2 s, with rms {NOISE:g} on y",
        limit=0.05,
        ours=True,
        why="A reading below the threshold counts as silence.",
    ),
    Text(
        id="robust-model",
        where="conclusions",
        claim="Robust against model errors (our measure)",
        quantity=(
            f"largest |d^ - d|, last 2 s, with {MISMATCH:.0%} off in stiffness, damping or input "
            "gain"
        ),
        limit=0.05,
        ours=True,
        why=(
            "Signals stay bounded, but d^ takes up the model's error; that of the input gain "
            "weighs most."
        ),
    ),
    Text(
        id="robust-disturbance",
        where="section 3",
        claim="Robust against disturbances (our measure)",
        quantity=f"largest |d^ - d|, last 2 s, with {DISTURBANCE:g} sin(0.6 pi t) at the input",
        limit=0.05,
        ours=True,
        why=(
            "Signals stay bounded, but an unknown input looks like a moving edge: a small L "
            "trusts the model."
        ),
    ),
    Text(
        id="practical",
        where="introduction",
        claim="Simple enough for practical use",
        quantity="operations of one observer step",
        limit=1000.0,
        why=(
            "A thousand are about 10 us on a microcontroller of 100 MHz. That other methods are "
            "too complex is not shown."
        ),
    ),
    Text(
        id="slow-or-unstable",
        where="conclusions",
        claim="Convergence can be too slow, depending on the tuning",
        quantity="rate of d^ -> d [1/s], with the paper's poles for 'as printed'",
        limit=0.1,
        why=(
            "Fast observer poles hide the widths from the innovation: L = (12, 15) against (1, "
            "1.5)."
        ),
    ),
    Text(
        id="compared",
        where="conclusions",
        claim="Compared with fuzzy logic, neural networks and sliding mode control",
        quantity="of the three, those that no figure shows",
        limit=0.0,
        announced=True,
        why=("The paper holds no comparison, and this audit cannot add what was not specified."),
    ),
    Text(
        id="manipulator",
        where="abstract, conclusions",
        claim="Compensates a robotic manipulator",
        quantity="manipulators announced that no figure shows",
        limit=0.0,
        announced=True,
        why="The example is one linear second-order plant.",
    ),
    Text(
        id="effort",
        where="conclusions",
        claim="Control effort was analysed",
        quantity="analyses announced that no figure shows",
        limit=0.0,
        announced=True,
        why="No figure shows u.",
    ),
)
