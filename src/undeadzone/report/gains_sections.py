"""What the page of gains says in words and tables, section by section."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from undeadzone.analysis.certificate.design_file import Design, Knowledge
from undeadzone.analysis.certificate.passivity import Certificate
from undeadzone.analysis.identifiability.linear import DIRECTIONS
from undeadzone.report.html import (
    Html,
    folded,
    join,
    paragraph,
    table,
    tag,
    verdict_line,
    widths_known,
    yes_no,
)
from undeadzone.results.listening import in_words, on_trust
from undeadzone.support.text import label
from undeadzone.synthesis.assessment import Assessment, Attacks, Gains

SCORES: Final = {
    "rate": "rate along the reference [1/s]",
    "disturbance": "rms error per white disturbance of 1 per root second on the inputs",
    "mismatch": "rms error per relative error in the entries of A and B",
    "noise": "rms error per rms noise on z at every sample",
}


def verdict(of: Assessment) -> Html:
    """One line: certified or not, the rate, and whether every width can be known."""
    parts = []
    if of.gains is not None:
        proof = of.gains.certificate
        certified = f"certified, margin {proof.margin:.4g}"
        parts.append(yes_no(proof.certified, certified, "not certified"))
        parts.append((f"rate {of.gains.rates.rate:.4g} 1/s", ""))
    return verdict_line(*parts, widths_known(all(one.right and one.left for one in of.known)))


def gains_section(gains: Gains, design: Design | None) -> list[Html]:
    """The gains, the nearest certified ones if these are not, and how to use a design."""
    parts = [_gain_table(gains)]
    near = gains.nearest
    if near is not None:
        margin, rate = near.certificate.margin, near.rates.rate
        words = f"The nearest certified gains, with margin {margin:.4g} and rate {rate:.4g} 1/s:"
        parts.append(paragraph(words))
        parts.append(_gain_table(near))
    if design is not None:
        use = (
            'In a scenario: [observer] method = "certified", design = "design.toml". '
            "The proof is checked again when it is read."
        )
        parts.append(paragraph(use, "note"))
    return parts


def _gain_table(gains: Gains) -> Html:
    """L and gamma, a column for each output."""
    head = ("[1/s]", *(f"output {j}" for j in range(gains.gamma.size)))
    rows = [(f"L, x[{i}]", *map(float, row)) for i, row in enumerate(gains.L)]
    return table(head, [*rows, ("γ", *map(float, gains.gamma))])


def guarantee_section(gains: Gains, tried: Attacks | None) -> list[Html]:
    """What the certificate guarantees and how it was checked, or what is not guaranteed."""
    proof = gains.certificate
    if not proof.certified:
        return _no_guarantee(proof, tried)
    attempts = ""
    if tried is not None:
        count = f"{tried.attack.trajectories:,}"
        attempts = f" {count} random and adversarial trajectories did not make V rise."
    widths = ""
    if gains.dynamics.gamma.any():
        widths = " + the sum of w |d~|² / γ over the outputs"
    guarantee = (
        f"For an exact model without noise and disturbance, V = x~'P x~{widths} never rises, "
        "whatever the sides do and in whatever order, with projection and silence innovation too; "
        "x~ → 0, and each width error whose side is read again and again → 0."
    )
    head = ("P", *(f"x[{j}]" for j in range(len(proof.P))))
    rows = [(f"x[{i}]", *map(float, row)) for i, row in enumerate(proof.P)]
    checked = "Checked by eigenvalues alone, without the solver that found P:"
    return [
        paragraph(guarantee + attempts),
        table(head, rows),
        paragraph(f"W = {numbers(proof.W)}. {checked}"),
        table(("what", "value"), _checked(proof)),
    ]


def _no_guarantee(proof: Certificate, tried: Attacks | None) -> list[Html]:
    """Why nothing is guaranteed, and the cycle along which the error grows if one was found."""
    words = f"Nothing is guaranteed for every way in which the sides may change: {proof.reason}."
    parts = [paragraph(f"{words} That alone does not make the observer unstable.")]
    if tried is None or tried.cycle is None:
        return parts
    if "cycle" in {course.kind for course in tried.courses}:
        growth = f"{tried.cycle.factor:.4g} every {tried.cycle.seconds:.4g} s"
        parts.append(
            paragraph(
                "A periodic sequence of sides was found along which the error grows by "
                f"{growth}: these gains can diverge."
            )
        )
    return parts


def _checked(proof: Certificate) -> list[tuple[str, Any]]:
    """The numbers by which a certificate was checked."""
    inequality = proof.dynamics.inequality(proof.W)
    matrices = inequality.matrices(proof.P)
    values = np.concatenate([np.linalg.eigvalsh(M) for M in matrices])
    step = "" if proof.dynamics.Ts is None else " − Ts γ/2"
    at_infinity = proof.frequency is None or np.isinf(proof.frequency)
    return [
        ("eigenvalues of P, all positive", numbers(np.linalg.eigvalsh(proof.P))),
        ("eigenvalues of the inequality, all negative", numbers(np.sort(values))),
        ("greatest of them, scaled to a diagonal of −1", proof.check.lmi),
        ("bound on the rounding of the scaled ones", proof.check.rounding),
        (f"margin: least eigenvalue of the Hermitian part of 1 + G{step}", proof.margin),
        ("where [rad/s]", "ω → ∞" if at_infinity else proof.frequency),
    ]


def speed_section(gains: Gains) -> list[Html]:
    """How fast the error dies along the reference."""
    speed = gains.rates
    constant = speed.time_constant if np.isfinite(speed.time_constant) else None
    rows: list[tuple[str, Any]] = [
        ("rate along the reference, in the long run [1/s]", speed.rate),
        ("time constant [s]", constant),
        ("every error at 1 % of itself, in size √V, after [s] at the latest", gains.settled),
        ("one pass of the schedule [s]", speed.period),
        ("largest factor of one pass on an error, in balanced units", speed.gain),
    ]
    note = (
        "Where several errors die equally slowly, as where a rate is largest, it takes long before "
        "this rate is seen; the time to 1 % tells."
    )
    parts = [table(("what", "value"), rows), paragraph(note, "note")]
    if speed.rate <= 0:
        parts.append(paragraph("The error does not die along this reference.", "no"))
    if speed.never:
        errors = ", ".join(speed.never)
        stays = "These errors stay along this reference, whatever the gains"
        parts.append(paragraph(f"{stays}: {errors}."))
    return parts


def trust(listens: Sequence[float | None]) -> Html | None:
    """How strongly readings move each z^, marked where the model is taken on trust."""
    if not listens:
        return None
    return tag("span", in_words(listens), "mid" if on_trust(listens) else "")


def knowledge_section(of: Assessment) -> list[Html]:
    """Which widths an optimal estimator can know, how well, why not, and what would help."""
    unit, duration = of.problem.scenario.units.output, of.problem.scenario.simulation.duration
    rows = []
    for i, known in enumerate(of.known):
        rows.append((i, *(_known(known, name) for name in DIRECTIONS)))
    question = (
        "Whether an optimal estimator can know it, and its "
        f"{label('standard deviation', unit)} after {duration:g} s at the scenario's noise:"
    )
    head = ("output", "d_r", "d_l", "width d_r + d_l", "centre d_r − d_l")
    parts = [paragraph(question), table(head, rows)]
    if of.listens:
        parts.append(paragraph(join(["How strongly readings move z^:", trust(of.listens)])))
    for i, known in enumerate(of.known):
        where = f"Output {i}: " if len(of.known) > 1 else ""
        parts += [paragraph(f"{where}{reason}.") for reason in known.reasons]
        parts += [paragraph(f"{where}What would help: {cure}.") for cure in known.cures]
    return parts


def _known(known: Knowledge, name: str) -> Html:
    """Whether a direction can be known, with its deviation if that is."""
    yes = f"± {known.std[name]:.2g}" if name in known.std else "yes"
    return tag("span", *yes_no(getattr(known, name), yes))


def trade_section(design: Design) -> list[Html]:
    """The gains chosen beside the scenario's own and the fastest; all gains of the front."""
    points = {"chosen": design.best}
    if design.present is not None:
        points["yours"] = design.present
    if len(design.front) > 1:
        points["fastest"] = design.front[0]
    rows = []
    for name, words in SCORES.items():
        rows.append((words, *(getattr(point, name) for point in points.values())))
    parts = [table(("", *points), rows)]
    parts += [paragraph(f"{remark[:1].upper()}{remark[1:]}.") for remark in design.remarks]
    if len(design.front) > 1:
        parts.append(_front_table(design))
    return parts


def _front_table(design: Design) -> Html:
    """Every gain of the front and what it is worth."""
    rows = []
    for point in design.front:
        scores = [getattr(point, name) for name in SCORES]
        rows.append((numbers(np.ravel(point.L)), numbers(point.gamma), *scores))
    title = f"The {len(design.front)} gains of the front"
    return folded(title, table(("L", "γ", *SCORES), rows))


def numbers(values: Any) -> str:
    """Numbers to four digits, with commas."""
    return ", ".join(f"{value:.4g}" for value in np.atleast_1d(values))
