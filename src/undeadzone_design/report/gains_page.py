"""Page of gains, given or designed: problem, guarantee, rate, identifiability and trade-off.

It shows the problem, the guarantee, the rate, the identifiable parameters and the trade-off.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from itertools import starmap
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from undeadzone.analysis.certificate.design_file import Design
from undeadzone.analysis.certificate.passivity import Certificate
from undeadzone.report import html
from undeadzone.report.run_page import gain_tables
from undeadzone.util.arrays import list_numbers
from undeadzone.util.text import count_noun, label_with_unit
from undeadzone_design.report.gain_figures import plot_ellipses, plot_front, root_locus
from undeadzone_design.report.proof_figures import plot_courses, plot_positive_realness
from undeadzone_design.synthesis.assessment import Assessment, Attacks, Gains
from undeadzone_design.synthesis.check import (
    Check,
    describe_design_and_check,
    list_design_numbers,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CAPTIONS: Final = {
    "root_locus": "Poles of the error while every output is read, as one of the gains is scaled "
    "from 0 to 3 times its value. Squares: while the sensor is silent. Right: the rate along the "
    "reference, which is what counts.",
    "nyquist": "The certificate in the frequency domain: V exists if the curve stays out of the "
    "shaded half plane.",
    "lyapunov": "V from one random error. An adversary switches to what leaves V largest: it may "
    "keep the sensor silent, and then nothing is learnt, but V never rises under certified gains. "
    "A fair adversary must read every output on both sides again and again. What cannot be known "
    "stays.",
    "ellipse": "Region of 95 % of the estimates of an optimal estimator at the end of the "
    "scenario. A strip if a direction cannot be known.",
    "front": "Gains without a better one in everything. All are certified.",
}


def draw_gain_figures(
    of: Assessment, tried: Attacks | None, design: Design | None = None
) -> dict[str, Figure]:
    """Return the applicable figures, by name.

    Args:
        of: the assessment of the gains
        tried: attempts to break them, if any were made
        design: design that the gains come from, if any
    """
    gains = of.gains
    drawn: dict[str, Figure] = {}
    if design is not None and len(design.front) > 1:
        drawn["front"] = plot_front(design)
    if gains is not None:
        if np.isfinite(gains.certificate.margin):
            drawn["nyquist"] = plot_positive_realness(gains.certificate)
        drawn["root_locus"] = root_locus(of, gains)
        if tried is not None:
            drawn["lyapunov"] = plot_courses(gains, tried)
    if of.problem.sensor.kind == "deadzone":
        drawn["ellipse"] = plot_ellipses(of)
    return drawn


def write_gains(
    found: Check,
    tried: Attacks | None,
    folder: Path,
    design: Design | None = None,
    origin: html.Origin | None = None,
) -> list[Path]:
    """Write the figures as SVG and report.html to a folder. Raises FileError.

    Args:
        found: the check of the gains
        tried, design: see `figures`
        folder: folder of the files (created if needed)
        origin: data to compute the same again (None: unknown)

    Returns:
        The paths of the files.
    """

    text = partial(gains_page, found, tried, design=design, origin=origin)
    return html.write_page(
        draw_gain_figures(found.assessment, tried, design),
        folder,
        text,
    )


def gains_page(
    found: Check,
    tried: Attacks | None,
    images: Mapping[str, bytes],
    design: Design | None = None,
    origin: html.Origin | None = None,
) -> str:
    """Return the page of a check.

    Args:
        found, tried, design, origin: see `write_gains`
        images: SVGs by the names of `figures`
    """
    of = found.assessment
    pictures = html.encode_pictures(images, CAPTIONS)
    # The first picture is the front of a design, else the proof.
    leads = list(map(pictures.pop, list(pictures)[:1]))
    if design is None:
        blocks, numbers = found.blocks(), found.summary()
    else:
        blocks = describe_design_and_check(design, found)
        numbers = list_design_numbers(design, found)
    first, *rest = html.answer_tables(blocks)
    sections = [html.build_section("The answer", first, *leads)]
    if of.gains is not None:
        guarantee = [
            *guarantee_section(of.gains, tried),
            *html.pick_pictures(pictures, "nyquist", "lyapunov"),
        ]
        speed = [*speed_section(of.gains), *html.pick_pictures(pictures, "root_locus")]
        sections.append(html.build_section("The gains", *gains_section(of.gains, design)))
        sections.append(html.build_section("What is guaranteed", *guarantee))
        sections.append(html.build_section("How fast", *speed))
    knowledge = [*rest, *html.pick_pictures(pictures, "ellipse")]
    sections.append(html.build_section("Identifiable widths", *knowledge))
    asked = _problem_section(of), html.fold_numbers(numbers)
    sections.append(html.build_section("What was asked", *asked))
    kind = "Check" if design is None else "Design"
    title = f"{kind}: {of.problem.scenario.title}"
    return html.build_page(title, gains_verdict(of), *sections, origin=origin)


def _problem_section(of: Assessment) -> html.Html:
    """Return what follows from the scenario: poles, where the sensor is silent, the sides."""
    model = of.problem.model
    unit = of.problem.scenario.units.output
    counts = ((model.n, "state"), (model.m, "input"), (model.p, "output"))
    sizes = ", ".join(starmap(count_noun, counts))
    poles = np.linalg.eigvals(of.problem.flow.linear.A) + 0.0
    rows: list[tuple[str, Any]] = [
        ("plant", f"{sizes}; poles {list_numbers(poles.tolist())} 1/s"),
        (label_with_unit("silent below |y|", unit), list_numbers(of.problem.sensor.threshold)),
        ("reference", label_with_unit(_describe_reference(of), unit)),
        ("side schedule", _describe_schedule(of)),
    ]
    return html.build_table(("what", "value"), rows)


def _describe_reference(of: Assessment) -> str:
    """Return the kind of the reference, and the ranges of the outputs, as text."""
    ends = zip(of.schedule.low, of.schedule.high, strict=True)
    reach = ", ".join(f"{low:.4g} to {high:.4g}" for low, high in ends)
    kind = type(of.problem.scenario.reference).__name__.lower()
    return f"{kind}. The outputs move over {reach}"


def _describe_schedule(of: Assessment) -> str:
    """Return the number of spans in the schedule of branches, and its duration, as text."""
    schedule = of.schedule
    again = ", then the same again" if schedule.periodic else ""
    return f"{count_noun(len(schedule.spans), 'span')} in {schedule.total_duration:.4g} s{again}"


def gains_verdict(of: Assessment) -> html.Html:
    """Return a line: certified or not, and whether every width is identifiable."""
    parts = [html.widths_verdict(all(one.right and one.left for one in of.known))]
    if of.gains is not None:
        proof = of.gains.certificate
        certified = f"certified, margin {proof.margin:.4g}"
        parts.insert(
            0,
            html.choose_verdict(
                proof.certified,
                certified,
                "not certified",
            ),
        )
    return html.verdict_line(*parts)


def gains_section(gains: Gains, design: Design | None) -> list[html.Html]:
    """Return the gains, the nearest certified gains if these are not, and the use of a design."""
    parts = _gain_tables(gains)
    near = gains.nearest
    if near is not None:
        margin = near.certificate.margin
        rate = near.rates.rate
        words = f"The nearest certified gains, with margin {margin:.4g} and rate {rate:.4g} 1/s:"
        parts.append(html.build_paragraph(words))
        parts += _gain_tables(near)
    if design is not None:
        use = (
            'In a scenario: [observer] method = "certified", design = "design.toml". '
            "The proof is checked again when it is read."
        )
        parts.append(html.build_paragraph(use, "note"))
    return parts


def _gain_tables(gains: Gains) -> list[html.Html]:
    """Return L and gamma, a column for each output."""
    lists = {"L": gains.L.tolist(), "gamma": gains.gamma.tolist()}
    return gain_tables(lists, list(map(str, range(gains.gamma.size))))


def guarantee_section(gains: Gains, tried: Attacks | None) -> list[html.Html]:
    """Return the guarantee of the certificate and its check, or the gap in the guarantee."""
    proof = gains.certificate
    if not proof.certified:
        return _explain_no_guarantee(proof, tried)
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
    note = "Checked by eigenvalues alone, without the solver that found P:"
    return [
        html.build_paragraph(guarantee + attempts),
        html.build_table(head, rows),
        html.build_paragraph(f"W = {list_numbers(proof.W)}. {note}"),
        html.build_table(("what", "value"), _certificate_rows(proof)),
    ]


def _explain_no_guarantee(proof: Certificate, tried: Attacks | None) -> list[html.Html]:
    """Return the reason that nothing is guaranteed, and a cycle along which the error grows,
    if found.
    """
    words = f"Nothing is guaranteed for every way in which the sides may change: {proof.reason}."
    parts = [html.build_paragraph(f"{words} That alone does not make the observer unstable.")]
    if tried is None or tried.cycle is None:
        return parts
    if "cycle" in {course.kind for course in tried.courses}:
        found = "A periodic sequence of sides was found along which the error grows by"
        growth = f"{tried.cycle.factor:.4g} every {tried.cycle.seconds:.4g} s"
        parts.append(html.build_paragraph(f"{found} {growth}: these gains can diverge."))
    return parts


def _certificate_rows(proof: Certificate) -> list[tuple[str, Any]]:
    """Return the numbers by which a certificate was checked."""
    inequality = proof.dynamics.inequality(proof.W)
    matrices = inequality.lmi_matrices(proof.P)
    values = np.concatenate(list(map(np.linalg.eigvalsh, matrices)))
    step = "" if proof.dynamics.Ts is None else " − Ts γ/2"
    at_infinity = proof.frequency is None or np.isinf(proof.frequency)
    return [
        ("eigenvalues of P, all positive", list_numbers(np.linalg.eigvalsh(proof.P))),
        ("eigenvalues of the inequality, all negative", list_numbers(np.sort(values))),
        ("greatest of them, scaled to a diagonal of −1", proof.check.lmi),
        ("bound on the rounding of the scaled ones", proof.check.rounding),
        (f"margin: least eigenvalue of the Hermitian part of 1 + G{step}", proof.margin),
        ("where [rad/s]", "ω → ∞" if at_infinity else proof.frequency),
    ]


def speed_section(gains: Gains) -> list[html.Html]:
    """Return the decay of the error along the reference, beside its rate."""
    speed = gains.rates
    rows: list[tuple[str, Any]] = [
        ("every error at 1 % of itself, in size √V, after [s] at the latest", gains.settled),
        ("one pass of the schedule [s]", speed.period),
        ("largest factor of one pass on an error, in balanced units", speed.gain),
    ]
    note = (
        "Where several errors die equally slowly, as where a rate is largest, it takes long "
        "before this rate is seen, unlike the time to 1 %."
    )
    return [html.build_table(("what", "value"), rows), html.build_paragraph(note, "note")]
