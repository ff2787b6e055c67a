"""The audit on paper: its figures as files, and one page that holds everything."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Final

from undeadzone.observers.printed import STAND_INS
from undeadzone.paper.equations import EQUATIONS, FIGURES
from undeadzone.paper.evidence import BEGUN, RESTING
from undeadzone.paper.example import AMPLITUDES, READINGS
from undeadzone.paper.facts import forced
from undeadzone.paper.figures import Trio, figure, silence
from undeadzone.paper.printed import DEFINITION
from undeadzone.report.html import Html, folded, page, paragraph, picture, section, table, tag
from undeadzone.report.style import write
from undeadzone.support.files import write_text

if TYPE_CHECKING:
    from undeadzone.paper.audit import Paper

_COLOURS: Final = {"holds": "yes", "holds after repair": "mid", "does not hold": "no"}


def write_figures(
    paper: Paper, folder: Path, progress: Callable[[int], None] | None = None
) -> list[Path]:
    """silence.png; figure_3.png ... figure_8.png for r = 5 sin, figure_3_2sin.png ... for r = 2 sin. Raises FileError."""
    written = [write(silence(*forced(AMPLITUDES[0])), folder / "silence.png")]
    runs = zip(
        AMPLITUDES,
        paper.evidence.printed[RESTING],
        paper.evidence.printed[BEGUN],
        paper.evidence.repaired,
        strict=True,
    )
    for amplitude, *trio in runs:
        for number in FIGURES:
            name = (
                f"figure_{number}.png"
                if amplitude == AMPLITUDES[0]
                else f"figure_{number}_{amplitude:g}sin.png"
            )
            written.append(
                write(figure(number, Trio(*trio), f"r = {amplitude:g} sin 2πt"), folder / name)
            )
            if progress is not None:
                progress(1)
    return written


def write_report(paper: Paper, images: list[Path], path: Path) -> Path:
    """One self-contained HTML page with everything; images as `write_figures` gave them. Raises FileError."""
    silent, *numbered = images
    return write_text(
        page(
            "Output deadzone: the paper's example, as printed and repaired",
            paragraph(
                "What the paper's second-order example does when it is run as printed, what was repaired, and what then holds of what it claims.",
                "note",
            ),
            _outcome(paper),
            section("The paper's claims", *_claims(paper)),
            section(
                "As printed",
                *_as_printed(paper),
                picture(
                    silent.read_bytes(),
                    "Each reading of the plant with the reference acting as a force, from rest.",
                ),
            ),
            section("Figures 3-8", *_figures(numbered)),
            section("Numbers against their closed forms", _facts(paper)),
            section("Where each equation went", _equations()),
        ),
        path,
    )


def _outcome(paper: Paper) -> Html:
    summary = paper.summary()
    printed = summary["printed"]
    columns = [
        ("repaired, 5 sin", "repaired"),
        ("repaired, 2 sin", "repaired_2sin"),
        ("repaired, 5 sin, sampled at 100 Hz", "repaired_sampled"),
    ]
    rows = [
        ("largest |z|, last 4 s", printed["max_abs_z"], *([None] * 3)),
        ("largest |y|", printed["max_abs_y"], *([None] * 3)),
        *(
            (words, printed.get(key), *(summary[column][key] for _, column in columns))
            for key, words in _WORDS.items()
        ),
    ]
    return table(("", "as printed, 5 sin, from rest", *(name for name, _ in columns)), rows)


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


def _claims(paper: Paper) -> list[Html]:
    counts = Counter(claim.verdict for claim in paper.claims)
    rows = [
        (
            c.text.claim,
            c.text.where,
            c.measured,
            tag("span", c.verdict, _COLOURS[c.verdict]),
            c.text.why,
        )
        for c in paper.claims
    ]
    return [
        paragraph(
            f"Of {len(rows)} claims {counts['holds']} hold as printed, {counts['holds after repair']} after repair, {counts['does not hold']} do not hold. "
            "A verdict is computed: the measured number against its limit, as printed first (the worst case counts), then repaired."
        ),
        table(("claim", "where", "measured", "verdict", "why"), rows),
    ]


def _as_printed(paper: Paper) -> list[Html]:
    counts = [(READINGS[c.plant].words, *c) for c in paper.counts]
    leaving = [
        (*o.variant, o.steady, o.peak, o.diverged_at)
        for o in paper.variants
        if o.leaves_zone and o.variant.start.startswith("from rest")
    ]
    return [
        paragraph(
            "In (42) the reference enters as a force. From rest, with d^(0) = d and the observer of (16), the loop is then the plant alone: its output stays "
            "inside the dead zone, y is 0 for ever, and the sensor has nothing to say. Of the four readings of the plant only that of unity DC gain comes out."
        ),
        table(
            ("equation", "plant", "start", "variants", "leave the zone", "move d^", "diverge"),
            counts,
        ),
        paragraph(
            "Variants "
            + DEFINITION
            + ". Some of those with unity DC gain are at the brink: their counts change by two with the step.",
            "note",
        ),
        paragraph("The least that makes the printed equations agree in shape:"),
        table(
            ("equation", "stand-in"),
            [
                *STAND_INS.items(),
                ("(30) P", "the scalar C P C' stands for the n x n matrix beside the scalar y~"),
            ],
        ),
        folded(
            f"The {len(leaving)} variants that leave the zone from rest",
            table(
                (
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
                ),
                leaving,
            ),
        ),
    ]


def _figures(images: list[Path]) -> list[Html]:
    half = len(images) // 2
    captions = {
        number: f"Figure {number}: {words}, as printed (left) and repaired (right); V(t) below."
        for number, words in FIGURES.items()
    }
    shown = [
        picture(image.read_bytes(), caption)
        for image, caption in zip(images, [*captions.values()] * 2, strict=True)
    ]
    return [*shown[:half], folded("The same for the reference 2 sin 2πt", *shown[half:])]


def _facts(paper: Paper) -> Html:
    return table(
        ("where", "what", "measured", "closed form", "difference"),
        [(*fact, fact.error) for fact in paper.facts],
    )


def _equations() -> Html:
    return table(("number", "what", "where in the code", "status", "reason"), EQUATIONS)
