"""Files of the audit: its figures, and one page with all results."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple, TypeAlias

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
    join_html,
)
from undeadzone.report.style import write_figure
from undeadzone.util.files import write_text
from undeadzone_paper.claims import HOW, Claim, claims_on, verdict_counts_text
from undeadzone_paper.diagrams import plot_diagrams
from undeadzone_paper.equations import DIAGRAMS, FIGURES, LETTERS_HEAD, STAND_INS, read_letters
from undeadzone_paper.evidence import BEGUN, NOMINAL, RESTING
from undeadzone_paper.example import (
    AMPLITUDES,
    READINGS,
    example_as_printed,
    example_as_repaired,
)
from undeadzone_paper.facts import response_to_force
from undeadzone_paper.figures import (
    RunTrio,
    add_hats,
    plot_paper_figure,
    plot_silence,
    plot_theorem,
    plot_tracking,
    plot_V,
)
from undeadzone_paper.printed import DEFINITION
from undeadzone_paper.theorem import DEFINITION as DEFINITION_OF_THEOREM
from undeadzone_paper.theorem import count_theorem

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from undeadzone_paper.audit import Paper

LOOPS: Final = {
    "As printed, observer (16), (17), law (42)": example_as_printed(AMPLITUDES[0]),
    "Repaired": example_as_repaired(AMPLITUDES[0]),
}
"""Loops whose block diagrams are drawn, by what their panels say."""

SUFFIXES: Final = dict(zip(AMPLITUDES, ("", "_2sin"), strict=True))  # of names of figures

_COLOURS: Final = {
    "holds": "yes",
    "holds after repair": "mid",
    "does not hold": "no",
    "not shown": "no",
}


class Drawn(NamedTuple):
    """Figure of the audit with its name and its caption on the page."""

    name: str
    caption: str
    figure: Figure


Pictures: TypeAlias = dict[Path, Html]  # the pictures of the page by the files of their figures


def write_audit_figures(
    paper: Paper, folder: Path, progress: Callable[[int], None] | None
) -> Pictures:
    """Write the figures as SVG. Raises FileError.

    Args:
        paper: the audit
        folder: folder of the files (created if needed)
        progress: called with 1 for each figure written

    Returns:
        Pictures of silence.svg, theorem.svg, figure_1.svg, figure_2.svg, figure_3.svg ...
        figure_8.svg, tracking.svg, V.svg for r = 5 sin, figure_3_2sin.svg ... for r = 2 sin.
    """
    pictures = {}
    for name, caption, figure in _draw_figures(paper):
        path = write_figure(figure, folder / f"{name}.svg")
        pictures[path] = encode_picture(path.read_bytes(), caption)
        if progress is not None:
            progress(1)
    return pictures


def _draw_figures(paper: Paper) -> Iterator[Drawn]:
    """Draw the figures one by one."""
    evidence = paper.evidence
    printed = evidence.printed[NOMINAL]
    repaired = evidence.repaired[NOMINAL]
    force = plot_silence(*response_to_force(AMPLITUDES[0]))
    theorem = plot_theorem(evidence.law, repaired[0], evidence.theorem)
    yield Drawn("silence", _CAPTIONS["silence"], force)
    yield Drawn("theorem", _CAPTIONS["theorem"], theorem)
    for number, words in DIAGRAMS.items():
        caption = f"Figure {number}: {words}, {_CAPTIONS['diagrams']}. "
        caption += claims_text(number, paper.claims)
        yield Drawn(f"figure_{number}", caption, plot_diagrams(number, LOOPS))
    trios = zip(printed[RESTING], printed[BEGUN], repaired, strict=True)
    for (amplitude, suffix), trio in zip(SUFFIXES.items(), trios, strict=True):
        runs = RunTrio(*trio)
        reference = f"r = {amplitude:g} sin 2πt"
        for number, words in FIGURES.items():
            caption = f"Figure {number}: {add_hats(words)}, {_CAPTIONS['figures']}. "
            caption += claims_text(number, paper.claims)
            name = f"figure_{number}{suffix}"
            yield Drawn(name, caption, plot_paper_figure(number, runs, reference))
        tracking = plot_tracking(runs, reference)
        yield Drawn(f"tracking{suffix}", _CAPTIONS["tracking"], tracking)
        yield Drawn(f"V{suffix}", "V.", plot_V(runs, reference))


_CAPTIONS: Final = {
    "silence": "Each reading of the plant with the reference acting as a force, from rest.",
    "theorem": "Error of the state and of the widths from x1 = 5 with d^ = d, and what is left of "
    "each reading in the end.",
    "diagrams": "drawn from the loop's graph: an arrow ends at the block that depends on it",
    "figures": "as printed (left) and repaired (right)",
    "tracking": "z beside the desired trajectory, as in the text of figures 3 and 4.",
}


def write_audit_page(paper: Paper, pictures: Pictures, path: Path, origin: Origin | None) -> Path:
    """Write one self-contained HTML page with all results. Raises FileError.

    Args:
        paper: the audit
        pictures: as `write_audit_figures` gave them
        path: of the page
        origin: data to compute the same again (None: unknown)
    """
    intro = (
        "What the paper's second-order example does when it is run as printed, what was repaired, "
        "and what then holds of what it claims."
    )
    silence, theorem, *numbered = pictures.values()
    again = sum(SUFFIXES[AMPLITUDES[1]] in path.name for path in pictures)
    text = build_page(
        "Output deadzone: the paper's example, as printed and repaired",
        build_paragraph(verdict_counts_text(paper.claims)),
        build_paragraph(intro, "note"),
        _outcome_table(paper),
        build_section("The paper's claims", *_claims_section(paper)),
        build_section(
            "As printed",
            *_variants_section(paper),
            silence,
        ),
        build_section("Theorem 4.1 with its own law", *_theorem_section(paper), theorem),
        build_section(
            "Figures 1-8",
            *numbered[:-again],
            fold_section("The same for the reference 2 sin 2πt", *numbered[-again:]),
        ),
        build_section("Equations (1)-(42)", *_equations_section(paper)),
        build_section("The paper's letters", build_table(LETTERS_HEAD, read_letters())),
        build_section("Numbers against their closed forms", _facts_table(paper)),
        origin=origin,
    )
    return write_text(text, path)


_REPAIRED: Final = {
    "repaired": "repaired, 5 sin",
    "repaired_2sin": "repaired, 2 sin",
    "repaired_sampled": "repaired, 5 sin, sampled at 100 Hz",
}
_WORDS: Final = {
    "max_abs_z": "largest |z|, last 4 s",
    "max_abs_y": "largest |y|",
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
    columns = [summary[name] for name in ("printed", *_REPAIRED)]
    rows = [(words, *(column.get(key) for column in columns)) for key, words in _WORDS.items()]
    return build_table(("", "as printed, 5 sin, from rest", *_REPAIRED.values()), rows)


def _claims_section(paper: Paper) -> list[Html]:
    """Return the rule of the verdicts and the table of claims."""
    rows = []
    for claim in paper.claims:
        text = claim.text
        cells = (
            build_tag("div", claim.verdict, _COLOURS[claim.verdict]),
            build_tag("div", text.claim),
            build_tag("code", text.id),
        )
        quoted = f"\u201c{text.words}\u201d, {text.where}"
        rows.append((join_html(cells), quoted, claim.numbers_text, text.why))
    return [
        build_paragraph(HOW),
        build_table(("claim", "in the paper", "measured", "why"), rows),
    ]


_SILENCE: Final = (
    "In (42) the reference enters as a force. From rest, with d^(0) = d and the observer of (16), "
    "the loop is then the plant alone: its output stays inside the dead zone, y is 0 for ever, and "
    "the sensor has nothing to say. Of the four readings of the plant only that of unity DC gain "
    "comes out."
)
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
    counts = [(READINGS[count.plant].words, *count) for count in paper.count_variants]
    leaving = [
        (*outcome.variant, outcome.steady, outcome.peak, outcome.diverged_at)
        for outcome in paper.variants
        if outcome.leaves_zone and outcome.variant.start.startswith("from rest")
    ]
    return [
        build_paragraph(_SILENCE),
        build_table(head, counts),
        build_paragraph(f"Variants {DEFINITION}. {_BRINK}", "note"),
        build_paragraph("The least that makes the printed equations agree in shape:"),
        build_table(("equation", "stand-in"), STAND_INS.items()),
        fold_section(
            f"The {len(leaving)} variants that leave the zone from rest",
            build_table(_VARIANT, leaving),
        ),
    ]


_THEOREM_HEAD: Final = (
    "d - d^",
    "law",
    "plant",
    "readings",
    "diverge",
    "end right",
    "leave d^ = d",
)


def _theorem_section(paper: Paper) -> list[Html]:
    """Return the counts of Theorem 4.1 with its own law."""
    return [
        build_paragraph(DEFINITION_OF_THEOREM),
        build_table(_THEOREM_HEAD, count_theorem(paper.evidence.theorem)),
    ]


def claims_text(number: int, claims: list[Claim]) -> str:
    """Return the verdicts on the claims on a figure, as a sentence."""
    named = claims_on("figure", number, (claim.text for claim in claims))
    verdicts = {claim.text.id: claim.verdict for claim in claims}
    listed = ", ".join(f"{name} ({verdicts[name]})" for name in named)
    return f"Claims: {listed}." if named else "No claim names it."


def _facts_table(paper: Paper) -> Html:
    """Return a table of numbers as measured and in closed form."""
    head = ("where", "what", "measured", "closed form", "difference")
    return build_table(head, [(*fact, fact.relative_error) for fact in paper.facts])


_SIDES: Final = (
    "Both sides of each equation along a run, and their largest difference: as printed along that "
    "of Theorem 4.1 from x1 = 5, with d - d^ given; mended along the repaired run. A difference of "
    "rounding, 1e-12 or less, is none."
)


def _equations_section(paper: Paper) -> list[Html]:
    """Return the paper's equations: both sides, their places in the code, and their claims."""
    rows = [
        (
            "({number}) {what}".format_map(entry),
            *itemgetter("compares", "printed", "mended")(entry),
            "{status}: {reason}".format_map(entry),
            entry["where"],
            ", ".join(entry["claims"]),
        )
        for entry in paper.summary()["equations"]
    ]
    head = ("equation", "both sides", "as printed", "mended", "used", "in the code", "claims")
    return [build_paragraph(_SIDES), build_table(head, rows)]
