"""The paper's claims in short, each with the quantity that tests it and the limit that the quantity must not exceed.

The verdict follows from the two measured numbers and the limit alone: it holds as printed, holds after repair, or does
not hold.
"""

from __future__ import annotations

from typing import Any, Final, Literal, NamedTuple

import numpy as np

from undeadzone.paper.evidence import DISTURBANCE, MISMATCH, NOISE, SLOPE, Evidence
from undeadzone.paper.trials import measure
from undeadzone.support.arrays import finite

Verdict = Literal["holds", "holds after repair", "does not hold"]


class Text(NamedTuple):
    """A claim in words: where the paper makes it, the quantity that tests it, its limit, and why it is as it is."""

    id: str
    where: str
    claim: str
    quantity: str
    limit: float
    why: str


class Claim(NamedTuple):
    """A claim and the values of its quantity, as printed (by case; the worst counts) and repaired; infinite: diverges."""

    text: Text
    printed: dict[str, float]
    repaired: float

    @property
    def verdict(self) -> Verdict:
        """What the numbers say."""
        if max(self.printed.values()) <= self.text.limit:
            return "holds"
        return "holds after repair" if self.repaired <= self.text.limit else "does not hold"

    @property
    def measured(self) -> str:
        """The numbers in words."""
        printed = ", ".join(
            f"{_words(value)} {case}".strip() for case, value in self.printed.items()
        )
        return f"{self.text.quantity}: as printed {printed}; repaired {_words(self.repaired)}; limit {self.text.limit:g}"

    def summary(self) -> dict[str, Any]:
        """The claim ready for JSON; values that are not finite become None."""
        numbers = {"printed": finite(max(self.printed.values())), "repaired": finite(self.repaired)}
        return {
            **self.text._asdict(),
            **numbers,
            "measured": self.measured,
            "verdict": self.verdict,
        }


def _words(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else "diverges"


def judge(evidence: Evidence) -> list[Claim]:
    """Every claim with what was measured for it."""
    numbers = measure(evidence)
    return [Claim(text, *numbers[text.id]) for text in TEXTS]


TEXTS: Final = (
    Text(
        "decomposition",
        "(11), (12)",
        "The dead zone is z minus the widths, switched by the indicators",
        "largest |y - (z - chi_bar d)| outside the zone",
        1e-12,
        "With d_l > 0 (A1) the left branch needs chi_bar = [chi_r, -chi_l]; inside the zone y = 0 and no such form holds.",
    ),
    Text(
        "width-bound",
        "(2), (13)",
        "d_M bounds what the zone takes off",
        "largest |Sat z| beyond the least d_M that (2) allows",
        0.0,
        "|d_r - d_l| is 0 for a symmetric zone; d_r + d_l is the width.",
    ),
    Text(
        "indicators",
        "(5)-(10)",
        "tanh(k_s y) with a large k_s stands for the branch indicators",
        "largest error of an indicator",
        1e-3,
        "At y = 0 both are 1/2: silence counts as half of each side. A three-valued measured side has no such error.",
    ),
    Text(
        "unit-slope",
        "A3",
        "m = 1 is no loss of generality",
        f"largest change of d^ when m = {SLOPE:g} instead",
        1e-6,
        "True once y is divided by m, which must then be known.",
    ),
    Text(
        "observer-poles",
        "(40)",
        "L = (-1.25, -1.62) puts the observer's poles at -4, -10",
        "largest distance of a pole [1/s]",
        1e-6,
        "With (39) that needs L = (12, 15). A - L C of (40) is unstable; (12, 15) in turn is stable, yet has no certificate.",
    ),
    Text(
        "riccati-gain",
        "(34), (42)",
        "The Riccati equation with A - L C gives a stabilising control gain",
        "rightmost pole of A - B K [1/s]",
        0.0,
        "With L = (12, 15), the gain that the poles need. For control the equation must hold A, not A - L C.",
    ),
    Text(
        "switching",
        "abstract",
        "The switching function removes the error that the dead zone makes in the observer",
        "rms of x^1 - x1, last 2 s, relative to an observer that takes y for z",
        0.01,
        "It does on the measured side, and with B u in the observer.",
    ),
    Text(
        "reading-tracked",
        "Theorem 4.1, figures 3 and 4",
        "y^ tracks y asymptotically",
        "rms of y^ - y, last 2 s",
        1e-3,
        "From rest y^ = y = 0 says nothing; started at x1 = 5 it depends on the sign convention of d_l whether the loop diverges.",
    ),
    Text(
        "state-1",
        "figures 5 and 6",
        "x^1 tracks x1 asymptotically",
        "rms of x^1 - x1, last 2 s",
        1e-3,
        "(16) lacks B u: from rest x^ stays 0 while x moves.",
    ),
    Text(
        "state-2",
        "figure 7",
        "x^2 tracks x2 asymptotically",
        "rms of x^2 - x2, last 2 s",
        1e-3,
        "As for x1.",
    ),
    Text(
        "displacements",
        "figures 5 and 6",
        "Sudden changes of the state error become rarer as the zone is cancelled",
        "share of the last 5 s in which x^1 - x1 changes faster than 0.1/s",
        0.0,
        "As printed the error is x1 itself, for ever.",
    ),
    Text(
        "widths",
        "(25), (26)",
        "d^ converges to d",
        "largest |d^ - d|, last 2 s",
        1e-3,
        "As printed d^ stays where it is from rest, and runs away from d when started outside the zone.",
    ),
    Text(
        "implied",
        "section 3",
        "Once y^ tracks y, the widths are exact",
        "largest |d^ - d| of a run with y^ = y from the start",
        1e-3,
        "No observer has this: inside the zone y^ = y = 0 whatever d^ is. The reference must cross both edges.",
    ),
    Text(
        "adaptation-bounded",
        "figure 8",
        "The adaptation is bounded",
        "largest |d^|",
        3.0,
        "V and the projection onto [0, d_M], d_M = 3, keep it so.",
    ),
    Text(
        "lyapunov",
        "(30)-(36)",
        "V never rises",
        "largest rise of V above an earlier value, relative to its largest",
        1e-9,
        "(30) takes the output error for the state error. The certificate's V falls in continuous and in sampled time.",
    ),
    Text(
        "cancelled",
        "(12), (26)",
        "Adding chi_bar d^ to y cancels the dead zone",
        "rms of y + chi_bar d^ - z outside the zone",
        1e-3,
        "It does once d^ is right.",
    ),
    Text(
        "cancelled-in-total",
        "section 3",
        "The effect of the dead zone is eliminated in total",
        "rms of y + chi_bar d^ - z, last 2 s",
        1e-3,
        "Inside the zone y = 0 tells nothing of z, and no inverse can; only the model's z^ bridges the gap.",
    ),
    Text(
        "tracking",
        "section 4, conclusions",
        "The output follows the reference",
        "rms of z - r, last 2 s",
        1e-3,
        "In (42) r is a force: from rest the plant never leaves the zone. Feedforward through x_ref and u_ff makes z follow r.",
    ),
    Text(
        "bounded",
        "abstract, Theorem 4.1",
        "Bounded inputs give bounded signals (BIBO)",
        "whether a run diverges (1: yes)",
        0.0,
        "As printed with a signed d_l, started at x1 = 5, the loop diverges. Repaired it never does, nor under noise, mismatch, disturbance.",
    ),
    Text(
        "robust-noise",
        "conclusions",
        "Robust against noise",
        f"largest |d^ - d|, last 2 s, with rms {NOISE:g} on y",
        0.05,
        "A reading below the threshold counts as silence.",
    ),
    Text(
        "robust-model",
        "conclusions",
        "Robust against model errors",
        f"largest |d^ - d|, last 2 s, with {MISMATCH:.0%} off in stiffness, damping or input gain",
        0.05,
        "Signals stay bounded, but d^ takes up the model's error; that of the input gain weighs most.",
    ),
    Text(
        "robust-disturbance",
        "section 3",
        "Robust against disturbances",
        f"largest |d^ - d|, last 2 s, with {DISTURBANCE:g} sin(0.6 pi t) at the input",
        0.05,
        "Signals stay bounded, but an unknown input looks like a moving edge: a small L trusts the model.",
    ),
    Text(
        "practical",
        "introduction",
        "Simple enough for practical use",
        "operations of one observer step",
        1000.0,
        "A thousand are about 10 us on a microcontroller of 100 MHz. That other methods are too complex is not shown.",
    ),
    Text(
        "slow-or-unstable",
        "conclusions",
        "Convergence can be too slow, depending on the tuning",
        "rate of d^ -> d [1/s], with the paper's poles for 'as printed'",
        0.1,
        "Fast observer poles hide the widths from the innovation: L = (12, 15) against (1, 1.5).",
    ),
    Text(
        "compared",
        "conclusions",
        "Compared with fuzzy logic, neural networks and sliding mode control",
        "of the three, those that no figure shows",
        0.0,
        "Not shown: the paper holds no comparison, and this audit cannot add what was not specified.",
    ),
    Text(
        "manipulator",
        "abstract, conclusions",
        "Compensates a robotic manipulator",
        "manipulators announced that no figure shows",
        0.0,
        "Not shown: the example is one linear second-order plant.",
    ),
    Text(
        "effort",
        "conclusions",
        "Control effort was analysed",
        "analyses announced that no figure shows",
        0.0,
        "Not shown.",
    ),
)
