"""Files of the audit: its figures, and one page with all results."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Final

from undeadzone.report.html import (
    Html,
    Origin,
    build_page,
    build_paragraph,
    build_section,
    build_table,
    build_tag,
    encode_picture,
    fold_section,
)
from undeadzone.report.style import write_figure
from undeadzone.util.files import write_text
from undeadzone_paper.claims import HOW, verdict_counts_text
from undeadzone_paper.equations import FIGURES
from undeadzone_paper.evidence import BEGUN, RESTING
from undeadzone_paper.example import AMPLITUDES, READINGS
from undeadzone_paper.facts import response_to_force
from undeadzone_paper.figures import RunTrio, plot_paper_figure, plot_silence
from undeadzone_paper.observer import STAND_INS
from undeadzone_paper.printed import DEFINITION

if TYPE_CHECKING:
    from undeadzone_paper.audit import Paper

_COLOURS: Final = {
    "holds": "yes",
    "holds after repair": "mid",
    "does not hold": "no",
    "not shown": "no",
}


def write_audit_figures(
    paper: Paper, folder: Path, progress: Callable[[int], None] | None = None
) -> list[Path]:
    """Write silence.svg, and figures 3-8 for r = 5 sin and for r = 2 sin. Raises FileError.

    Args:
        paper: the audit
        folder: where the files go; created if needed
        progress: called with 1 for each numbered figure written

    Returns:
        silence.svg; figure_3.svg ... figure_8.svg for r = 5 sin; figure_3_2sin.svg ... for 2 sin.
    """
    evidence = paper.evidence
    written = [
        write_figure(plot_silence(*response_to_force(AMPLITUDES[0])), folder / "silence.svg")
    ]
    trios = zip(evidence.printed[RESTING], evidence.printed[BEGUN], evidence.repaired, strict=True)
    for amplitude, trio in zip(AMPLITUDES, trios, strict=True):
        suffix = "" if amplitude == AMPLITUDES[0] else f"_{amplitude:g}sin"
        for number in FIGURES:
            drawn = plot_paper_figure(number, RunTrio(*trio), f"r = {amplitude:g} sin 2πt")
            written.append(write_figure(drawn, folder / f"figure_{number}{suffix}.svg"))
            if progress is not None:
                progress(1)
    return written


def write_audit_page(
    paper: Paper, images: list[Path], path: Path, origin: Origin | None = None
) -> Path:
    """Write one self-contained HTML page with all results. Raises FileError.

    Args:
        paper: the audit
        images: as `write_figures` gave them
        path: of the page
        origin: what it takes to get the same again; None: nobody can
    """
    silent, *numbered = images
    intro = (
        "What the paper's second-order example does when it is run as printed, what was repaired, "
        "and what then holds of what it claims."
    )
    caption = "Each reading of the plant with the reference acting as a force, from rest."
    text = build_page(
        "Output deadzone: the paper's example, as printed and repaired",
        build_paragraph(verdict_counts_text(paper.claims)),
        build_paragraph(intro, "note"),
        _outcome_table(paper),
        build_section("The paper's claims", *_claims_section(paper)),
        build_section(
            "As printed", *_variants_section(paper), encode_picture(silent.read_bytes(), caption)
        ),
        build_section("Figures 3-8", *_figures_section(numbered)),
        build_section("Numbers against their closed forms", _facts_table(paper)),
        build_section("Where each equation went", _equations_table(paper)),
        origin=origin,
    )
    return write_text(text, path)


_REPAIRED: Final = {
    "repaired": "repaired, 5 sin",
    "repaired_2sin": "repaired, 2 sin",
    "repaired_sampled": "repaired, 5 sin, sampled at 100 Hz",
}
_WORDS: Final = {
    "rms_tracking": "rms of z − r, last 2 s",
    "rms_estimation": "rms of z − z^, last 2 s",
    "d_right": "d_r^ at the end (true 1)",
    "d_left": "d_l^ at the end (true 1)",
    "silent_fraction": "share of silent samples",
    "rate": "rate of d^ → d [1/s]",
    "largest_rise_of_V": "largest rise of V, relative",
    "integration_error": "integration error (against half the step)",
}


def _outcome_table(paper: Paper) -> Html:
    """Return a table of the example's numbers as printed and as repaired."""
    summary = paper.summary()
    printed = summary["printed"]
    absent = [None] * len(_REPAIRED)
    rows = [
        ("largest |z|, last 4 s", printed["max_abs_z"], *absent),
        ("largest |y|", printed["max_abs_y"], *absent),
    ]
    for key, words in _WORDS.items():
        repaired = [summary[column][key] for column in _REPAIRED]
        rows.append((words, printed.get(key), *repaired))
    return build_table(("", "as printed, 5 sin, from rest", *_REPAIRED.values()), rows)


def _claims_section(paper: Paper) -> list[Html]:
    """Return the rule of the verdicts and the table of claims."""
    rows = []
    for claim in paper.claims:
        text = claim.text
        verdict = build_tag("span", claim.verdict, _COLOURS[claim.verdict])
        quoted = f"\u201c{text.words}\u201d, {text.where}"
        rows.append((text.claim, quoted, claim.numbers_text, verdict, text.why))
    return [
        build_paragraph(HOW),
        build_table(("claim", "in the paper", "measured", "verdict", "why"), rows),
    ]


_SILENCE: Final = (
    "In (42) the reference enters as a force. From rest, with d^(0) = d and the observer of (16), "
    "the loop is then the plant alone: its output stays inside the dead zone, y is 0 for ever, and "
    "the sensor has nothing to say. Of the four readings of the plant only that of unity DC gain "
    "comes out."
)
_SCALAR_P: Final = "the scalar C P C' stands for the n x n matrix beside the scalar y~"
_BRINK: Final = (
    "Some of those with unity DC gain are at the brink: their counts change by two with the step."
)
_VARIANT: Final = (
    "plant",
    "start",
    "L",
    "B u",
    "sigma",
    "PD sign",
    "d_l sign",
    "max |z|, last 4 s",
    "peak |z|",
    "diverged at [s]",
)


def _variants_section(paper: Paper) -> list[Html]:
    """Return the results of the variants as printed, and the stand-ins for missing parts."""
    head = ("equation", "plant", "start", "variants", "leave the zone", "move d^", "diverge")
    counts = [(READINGS[count.plant].words, *count) for count in paper.counts]
    stand_ins = [*STAND_INS.items(), ("(30) P", _SCALAR_P)]
    leaving = []
    for outcome in paper.variants:
        if outcome.leaves_zone and outcome.variant.start.startswith("from rest"):
            numbers = (outcome.steady, outcome.peak, outcome.diverged_at)
            leaving.append((*outcome.variant, *numbers))
    return [
        build_paragraph(_SILENCE),
        build_table(head, counts),
        build_paragraph(f"Variants {DEFINITION}. {_BRINK}", "note"),
        build_paragraph("The least that makes the printed equations agree in shape:"),
        build_table(("equation", "stand-in"), stand_ins),
        fold_section(
            f"The {len(leaving)} variants that leave the zone from rest",
            build_table(_VARIANT, leaving),
        ),
    ]


def _figures_section(images: list[Path]) -> list[Html]:
    """Return figures 3-8 of the first reference, and folded those of the second."""
    half = len(images) // 2
    captions = [
        f"Figure {number}: {words}, as printed (left) and repaired (right); V(t) below."
        for number, words in FIGURES.items()
    ]
    shown = []
    for image, caption in zip(images, captions * 2, strict=True):
        shown.append(encode_picture(image.read_bytes(), caption))
    return [*shown[:half], fold_section("The same for the reference 2 sin 2πt", *shown[half:])]


def _facts_table(paper: Paper) -> Html:
    """Return a table of numbers as measured and in closed form."""
    head = ("where", "what", "measured", "closed form", "difference")
    return build_table(head, [(*fact, fact.relative_error) for fact in paper.facts])


def _equations_table(paper: Paper) -> Html:
    """Return a table of the paper's equations, their places in the code, and their claims."""
    rows = []
    for entry in paper.summary()["equations"]:
        *cells, claims = entry.values()
        rows.append((*cells, ", ".join(claims)))
    head = ("number", "what", "where in the code", "status", "what was changed", "claims")
    return build_table(head, rows)
