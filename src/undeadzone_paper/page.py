"""Files of the audit: its figures, and one page with all results."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from operator import itemgetter
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
    join_html,
)
from undeadzone.report.style import write_figure
from undeadzone.util.files import write_text
from undeadzone_paper.claims import HOW, Claim, claims_on, verdict_counts_text
from undeadzone_paper.diagrams import plot_diagrams
from undeadzone_paper.equations import (
    DIAGRAMS,
    FIGURES,
    LETTERS_HEAD,
    STAND_INS,
    read_letters,
    read_words,
)
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
    plot_pair,
    plot_silence,
    plot_theorem,
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

_PAGE: Final = read_words("page.toml")
_TEXTS: Final = _PAGE["texts"]
_CAPTIONS: Final = _PAGE["captions"]
_HEADS: Final = _PAGE["heads"]


def write_audit_figures(
    paper: Paper, folder: Path, progress: Callable[[int], None] | None
) -> dict[Path, Html]:
    """Write the figures as SVG. Raises FileError.

    Args:
        paper: the audit
        folder: folder of the files (created if needed)
        progress: called with 1 for each figure written

    Returns:
        The pictures of the page by their files: silence.svg, theorem.svg, figure_1.svg,
        figure_2.svg, figure_3.svg ... figure_8.svg, tracking.svg, V.svg for r = 5 sin,
        figure_3_2sin.svg ... for r = 2 sin.
    """
    pictures = {}
    for name, caption, figure in _draw_figures(paper):
        path = write_figure(figure, folder / f"{name}.svg")
        pictures[path] = encode_picture(path.read_bytes(), caption)
        if progress is not None:
            progress(1)
    return pictures


def _draw_figures(paper: Paper) -> Iterator[tuple[str, str, Figure]]:
    """Draw the figures one by one, each with its name and its caption on the page."""
    evidence = paper.evidence
    printed = evidence.printed[NOMINAL]
    repaired = evidence.repaired["begun"]
    force = plot_silence(*response_to_force(AMPLITUDES[0]))
    theorem = plot_theorem(evidence.law, repaired[0], evidence.theorem)
    yield "silence", _CAPTIONS["silence"], force
    yield "theorem", _CAPTIONS["theorem"], theorem
    for number in DIAGRAMS:
        caption = _caption(paper, number, "diagrams")
        yield f"figure_{number}", caption, plot_diagrams(number, LOOPS)
    captions = {f"figure_{number}": _caption(paper, number, "figures") for number in FIGURES}
    captions |= {name: _CAPTIONS[name] for name in ("tracking", "V")}
    trios = zip(printed[RESTING], printed[BEGUN], repaired, strict=True)
    for (amplitude, suffix), trio in zip(SUFFIXES.items(), trios, strict=True):
        reference = f"r = {amplitude:g} sin 2πt"
        for name, caption in captions.items():
            yield name + suffix, caption, plot_pair(name, RunTrio(*trio), reference)


def _caption(paper: Paper, number: int, kind: str) -> str:
    """Return the caption of a figure of the paper: its words, how it is drawn, and its claims."""
    words = add_hats((DIAGRAMS | FIGURES)[number])
    return f"Figure {number}: {words}, {_CAPTIONS[kind]}. {claims_text(number, paper.claims)}"


def write_audit_page(
    paper: Paper, pictures: dict[Path, Html], path: Path, origin: Origin | None
) -> Path:
    """Write one self-contained HTML page with all results. Raises FileError.

    Args:
        paper: the audit
        pictures: as `write_audit_figures` gave them
        path: of the page
        origin: data to compute the same again (None: unknown)
    """
    silence, theorem, *numbered = pictures.values()
    facts = [(*fact, fact.relative_error) for fact in paper.facts]
    again = sum(SUFFIXES[AMPLITUDES[1]] in path.name for path in pictures)
    text = build_page(
        "Output deadzone: the paper's example, as printed and repaired",
        build_paragraph(verdict_counts_text(paper.claims)),
        build_paragraph(_TEXTS["intro"], "note"),
        _outcome_table(paper),
        build_section("The paper's claims", *_claims_section(paper)),
        build_section(
            "As printed",
            *_variants_section(paper),
            silence,
        ),
        build_section(
            "Theorem 4.1 with its own law",
            build_paragraph(DEFINITION_OF_THEOREM),
            build_table(_HEADS["theorem"], count_theorem(paper.evidence.theorem)),
            theorem,
        ),
        build_section(
            "Figures 1-8",
            *numbered[:-again],
            fold_section("The same for the reference 2 sin 2πt", *numbered[-again:]),
        ),
        build_section("Equations (1)-(42)", *_equations_section(paper)),
        build_section("The paper's letters", build_table(LETTERS_HEAD, read_letters())),
        build_section("Numbers against their closed forms", build_table(_HEADS["facts"], facts)),
        origin=origin,
    )
    return write_text(text, path)


def _outcome_table(paper: Paper) -> Html:
    """Return a table of the example's numbers as printed and as repaired."""
    summary = paper.summary()
    columns = itemgetter(*_PAGE["columns"])(summary)
    rows = [
        (words, *(column.get(key) for column in columns)) for key, words in _PAGE["rows"].items()
    ]
    return build_table(("", *_PAGE["columns"].values()), rows)


def _claims_section(paper: Paper) -> list[Html]:
    """Return the rule of the verdicts and the table of claims."""
    rows = []
    for claim in paper.claims:
        text = claim.text
        cells = (
            build_tag("div", claim.verdict, _PAGE["verdicts"][claim.verdict]),
            build_tag("div", text.claim),
            build_tag("code", text.id),
        )
        quoted = f"\u201c{text.words}\u201d, {text.where}"
        rows.append((join_html(cells), quoted, claim.numbers_text, text.why))
    return [
        build_paragraph(HOW),
        build_table(_HEADS["claims"], rows),
    ]


def _variants_section(paper: Paper) -> list[Html]:
    """Return the results of the variants as printed, and the stand-ins for missing parts."""
    counts = [(READINGS[count.plant].words, *count) for count in paper.count_variants]
    leaving = [
        (*outcome.variant, outcome.steady, outcome.peak, outcome.diverged_at)
        for outcome in paper.variants
        if outcome.leaves_zone and outcome.variant.start.startswith("from rest")
    ]
    return [
        build_paragraph(_TEXTS["silence"]),
        build_table(_HEADS["counts"], counts),
        build_paragraph(f"Variants {DEFINITION}. {_TEXTS['brink']}", "note"),
        build_paragraph(_TEXTS["stand_ins"]),
        build_table(_HEADS["stand_ins"], STAND_INS.items()),
        fold_section(
            f"The {len(leaving)} variants that leave the zone from rest",
            build_table(_HEADS["variants"], leaving),
        ),
    ]


def claims_text(number: int, claims: list[Claim]) -> str:
    """Return the verdicts on the claims on a figure, as a sentence."""
    named = claims_on("figure", number, (claim.text for claim in claims))
    judged = (f"{claim.text.id} ({claim.verdict})" for claim in claims if claim.text.id in named)
    listed = ", ".join(judged)
    return f"Claims: {listed}." if named else "No claim names it."


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
    return [build_paragraph(_TEXTS["sides"]), build_table(_HEADS["equations"], rows)]
