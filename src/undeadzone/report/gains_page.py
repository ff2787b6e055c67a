"""The page of gains, given or designed: what was asked, what is guaranteed, how fast, what can be known, the trade."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from undeadzone.analysis.certificate.design_file import Design, Knowledge
from undeadzone.analysis.identifiability.linear import DIRECTIONS
from undeadzone.report.html import Html, folded, page, paragraph, picture, section, table, tag
from undeadzone.report.proof_figures import courses, nyquist, root_locus
from undeadzone.report.style import label, write
from undeadzone.report.trade_figures import ellipses, front
from undeadzone.support.arrays import listed
from undeadzone.support.files import write_text
from undeadzone.synthesis.assessment import Assessment, Attacks, Gains

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CAPTIONS: Final = {
    "root_locus": "Poles of the error while every output is read, as one of the gains is scaled from 0 to 3 times its value; squares: while the sensor "
    "is silent. Right: the rate along the reference, which is what counts.",
    "nyquist": "The certificate in the frequency domain: V exists where the curve stays out of the shaded half plane.",
    "lyapunov": "V from one random error. An adversary switches to what leaves V largest: it may keep the sensor silent, and then nothing is learnt, but V "
    "never rises under certified gains. A fair adversary must read every output on both sides again and again. What cannot be known stays.",
    "ellipse": "Where 95 % of the estimates of an optimal estimator lie at the end of the scenario; a strip where a direction cannot be known.",
    "front": "Gains none of which is better than another one in everything; all are certified.",
}
SCORES: Final = {
    "rate": "rate along the reference [1/s]",
    "disturbance": "rms error per white disturbance of 1 per root second on the inputs",
    "mismatch": "rms error per relative error in the entries of A and B",
    "noise": "rms error per rms noise on z at every sample",
}


def figures(
    of: Assessment, tried: Attacks | None, design: Design | None = None
) -> dict[str, Figure]:
    """The figures that apply, by name."""
    found, drawn = of.gains, dict[str, "Figure"]()
    if design is not None and len(design.front) > 1:
        drawn["front"] = front(design)
    if found is not None:
        if np.isfinite(found.certificate.margin):
            drawn["nyquist"] = nyquist(found)
        drawn["root_locus"] = root_locus(of, found)
        if tried is not None:
            drawn["lyapunov"] = courses(found, tried)
    if of.problem.sensor.kind == "deadzone":
        drawn["ellipse"] = ellipses(of)
    return drawn


def write_gains(
    of: Assessment, tried: Attacks | None, folder: Path, design: Design | None = None
) -> list[Path]:
    """Write the figures as PNG and report.html to a folder. Raises FileError."""
    written = {
        name: write(figure, folder / f"{name}.png")
        for name, figure in figures(of, tried, design).items()
    }
    text = gains_page(
        of, tried, {name: path.read_bytes() for name, path in written.items()}, design
    )
    return [*written.values(), write_text(text, folder / "report.html")]


def gains_page(
    of: Assessment, tried: Attacks | None, images: Mapping[str, bytes], design: Design | None = None
) -> str:
    """The page of an account; images: PNGs by the names of `figures`."""
    title = of.problem.scenario.title
    shown = {
        name: picture(images[name], caption) for name, caption in CAPTIONS.items() if name in images
    }
    sections = [section("What was asked", _asked(of, design))]
    if of.gains is None:
        why = "The observer has no constant gains L, gamma."
        if of.problem.model.nonlinear:
            why = "The model is nonlinear: gains can be certified on a declared [region], as check.json tells; frequencies and rates are for linear models."
        sections.append(section("No rate", paragraph(why)))
    else:
        sections.append(section("The gains", *_gains(of.gains, design)))
        sections.append(
            section(
                "What is guaranteed",
                *_guarantee(of.gains, tried),
                *_pick(shown, "nyquist", "lyapunov"),
            )
        )
        sections.append(section("How fast", *_speed(of.gains), *_pick(shown, "root_locus")))
    sections.append(section("What can be known", *_knowledge(of), *_pick(shown, "ellipse")))
    if design is not None:
        sections.append(section("The trade", *_trade(design), *_pick(shown, "front")))
    return page(f"{'Design' if design else 'Check'}: {title}", _verdict(of), *sections)


def _pick(shown: Mapping[str, Html], *names: str) -> list[Html]:
    return [shown[name] for name in names if name in shown]


def _verdict(of: Assessment) -> Html:
    known = all(k.right and k.left for k in of.known)
    parts = [_yes(known, "every width can be known" if known else "not every width can be known")]
    if of.gains is not None:
        proved = of.gains.certificate.certified
        parts.insert(
            0,
            _yes(
                proved,
                f"certified, margin {of.gains.certificate.margin:.4g}"
                if proved
                else "not certified",
            ),
        )
        parts.insert(1, tag("span", f"rate {of.gains.rates.rate:.4g} 1/s"))
    return Html("<p>" + "; ".join(part.text for part in parts) + ".</p>")


def _yes(good: bool, words: str) -> Html:
    return tag("span", words, "yes" if good else "no")


def _asked(of: Assessment, design: Design | None) -> Html:
    problem, scenario = of.problem, of.problem.scenario
    model, sensor, unit = problem.model, problem.sensor, problem.scenario.units.output
    poles = np.linalg.eigvals(problem.flow.linear.A) + 0.0
    reach = ", ".join(
        f"{low:.4g} to {high:.4g}"
        for low, high in zip(of.schedule.low, of.schedule.high, strict=True)
    )
    rows: list[tuple[str, Any]] = [
        (
            "plant",
            f"{_count(model.n, 'state')}, {_count(model.m, 'input')}, {_count(model.p, 'output')}; poles {listed(poles.tolist())} 1/s",
        ),
        ("time", "continuous" if model.Ts is None else f"sampled every {model.Ts:g} s"),
        (
            label("sensor", unit),
            f"{sensor.kind}: d_r = {_numbers(sensor.right)}, d_l = {_numbers(sensor.left)}, silent below |y| = {_numbers(sensor.threshold)}",
        ),
        (
            "noise, rms",
            f"{_numbers(sensor.noise)} after the zone, {_numbers(sensor.noise_before)} before it",
        ),
        (
            "reference",
            label(
                f"{type(scenario.reference).__name__.lower()}; the outputs move over {reach}", unit
            ),
        ),
        (
            "side schedule",
            f"{_count(len(of.schedule.spans), 'span')} in {of.schedule.duration:.4g} s{', then the same again' if of.schedule.periodic else ''}",
        ),
        (
            "duration",
            f"{scenario.simulation.duration:g} s, a sample every {scenario.simulation.step:g} s",
        ),
    ]
    if design is not None:
        rows.append(("wanted", f"{design.chosen}; seed {design.seed}"))
    return table(("what", "value"), rows)


def _gains(found: Gains, design: Design | None) -> list[Html]:
    parts = [_gain_table(found)]
    if found.nearest is not None:
        near = found.nearest
        parts.append(
            paragraph(
                f"The nearest certified gains, with margin {near.certificate.margin:.4g} and rate {near.rates.rate:.4g} 1/s:"
            )
        )
        parts.append(_gain_table(near))
    if design is not None:
        parts.append(
            paragraph(
                'In a scenario: [observer] method = "certified", design = "design.toml". The proof is checked again when it is read.',
                "note",
            )
        )
    return parts


def _gain_table(found: Gains) -> Html:
    rows = [(f"L, x[{i}]", *map(float, row)) for i, row in enumerate(found.L)]
    return table(
        ("[1/s]", *(f"output {j}" for j in range(found.gamma.size))),
        [*rows, ("γ", *map(float, found.gamma))],
    )


def _guarantee(found: Gains, tried: Attacks | None) -> list[Html]:
    proof, given = found.certificate, found.certificate.dynamics
    if not proof.certified:
        parts = [
            paragraph(
                f"Nothing is guaranteed for every way in which the sides may change: {proof.reason}. That alone does not make the observer unstable."
            )
        ]
        if (
            tried is not None
            and tried.cycle is not None
            and "cycle" in {course.kind for course in tried.courses}
        ):
            growth = f"{tried.cycle.factor:.4g} every {tried.cycle.seconds:.4g} s"
            parts.append(
                paragraph(
                    f"A periodic sequence of sides was found along which the error grows by {growth}: these gains can diverge."
                )
            )
        return parts
    attempts = (
        ""
        if tried is None
        else f" {tried.attack.trajectories:,} random and adversarial trajectories did not make V rise."
    )
    values = np.concatenate(
        [np.linalg.eigvalsh(M) for M in given.inequality(proof.W).matrices(proof.P)]
    )
    checked = (
        ("eigenvalues of P, all positive", _numbers(np.linalg.eigvalsh(proof.P))),
        ("eigenvalues of the inequality, all negative", _numbers(np.sort(values))),
        ("greatest of them, scaled to a diagonal of −1", proof.check.lmi),
        ("bound on the rounding of the scaled ones", proof.check.rounding),
        (
            "margin: least eigenvalue of the Hermitian part of 1 + G"
            + ("" if given.Ts is None else " − Ts γ/2"),
            proof.margin,
        ),
        (
            "where [rad/s]",
            "ω → ∞" if proof.frequency is None or np.isinf(proof.frequency) else proof.frequency,
        ),
    )
    widths = " + the sum of w |d~|² / γ over the outputs" if found.dynamics.gamma.any() else ""
    return [
        paragraph(
            f"For an exact model without noise and disturbance, V = x~'P x~{widths} never rises, whatever the sides do and in whatever order, with projection "
            f"and silence innovation too; x~ → 0, and each width error whose side is read again and again → 0.{attempts}"
        ),
        table(
            ("P", *(f"x[{j}]" for j in range(len(proof.P)))),
            [(f"x[{i}]", *map(float, row)) for i, row in enumerate(proof.P)],
        ),
        paragraph(
            f"W = {_numbers(proof.W)}. Checked by eigenvalues alone, without the solver that found P:"
        ),
        table(("what", "value"), checked),
    ]


def _speed(found: Gains) -> list[Html]:
    speed = found.rates
    rows: list[tuple[str, Any]] = [
        ("rate along the reference, in the long run [1/s]", speed.rate),
        ("time constant [s]", speed.time_constant if np.isfinite(speed.time_constant) else None),
        ("every error at 1 % of itself, in size √V, after [s] at the latest", found.settled),
        ("one pass of the schedule [s]", speed.period),
        ("largest factor of one pass on an error, in balanced units", speed.gain),
    ]
    note = "Where several errors die equally slowly, as where a rate is largest, it takes long before this rate is seen; the time to 1 % tells."
    parts = [table(("what", "value"), rows), paragraph(note, "note")]
    if speed.rate <= 0:
        parts.append(paragraph("The error does not die along this reference.", "no"))
    if speed.never:
        parts.append(
            paragraph(
                f"These errors stay along this reference, whatever the gains: {', '.join(speed.never)}."
            )
        )
    return parts


def _knowledge(of: Assessment) -> list[Html]:
    def cell(known: Knowledge, name: str) -> Any:
        if not getattr(known, name):
            return tag("span", "no", "no")
        return tag("span", f"± {known.std[name]:.2g}" if name in known.std else "yes", "yes")

    unit, duration = of.problem.scenario.units.output, of.problem.scenario.simulation.duration
    rows = [(i, *(cell(known, name) for name in DIRECTIONS)) for i, known in enumerate(of.known)]
    parts = [
        paragraph(
            f"Whether an optimal estimator can know it, and its standard deviation [{unit}] after {duration:g} s at the scenario's noise:"
        ),
        table(("output", "d_r", "d_l", "width d_r + d_l", "centre d_r − d_l"), rows),
    ]
    for i, known in enumerate(of.known):
        where = f"Output {i}: " if len(of.known) > 1 else ""
        parts += [paragraph(f"{where}{reason}.") for reason in known.reasons]
        parts += [paragraph(f"{where}What would help: {cure}.") for cure in known.cures]
    return parts


def _trade(design: Design) -> list[Html]:
    points = (
        {"chosen": design.best}
        | ({"yours": design.present} if design.present else {})
        | ({"fastest": design.front[0]} if len(design.front) > 1 else {})
    )
    rows = [
        (words, *(getattr(point, name) for point in points.values()))
        for name, words in SCORES.items()
    ]
    parts = [
        table(("", *points), rows),
        *(paragraph(f"{remark[:1].upper()}{remark[1:]}.") for remark in design.remarks),
    ]
    if len(design.front) > 1:
        head = ("L", "γ", *SCORES)
        numbers = [
            (_numbers(np.ravel(p.L)), _numbers(p.gamma), *(getattr(p, name) for name in SCORES))
            for p in design.front
        ]
        parts.append(folded(f"The {len(design.front)} gains of the front", table(head, numbers)))
    return parts


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'s' * (number != 1)}"


def _numbers(values: Any) -> str:
    return ", ".join(f"{value:.5g}" for value in np.atleast_1d(values))
