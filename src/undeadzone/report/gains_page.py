"""The page of gains, given or designed.

It says what was asked, what is guaranteed, how fast, what can be known, and what the trade is.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from undeadzone.analysis.certificate.design_file import Design
from undeadzone.report.gains_sections import (
    gains_section,
    guarantee_section,
    knowledge_section,
    numbers,
    speed_section,
    trade_section,
    verdict,
)
from undeadzone.report.html import Html, Origin, page, paragraph, section, table
from undeadzone.report.locus_figures import root_locus
from undeadzone.report.pictures import images_of, pick, pictures, write_figures
from undeadzone.report.proof_figures import courses, nyquist
from undeadzone.report.trade_figures import ellipses, front
from undeadzone.support.arrays import listed
from undeadzone.support.files import write_text
from undeadzone.support.text import counted, label
from undeadzone.synthesis.assessment import Assessment, Attacks

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CAPTIONS: Final = {
    "root_locus": "Poles of the error while every output is read, as one of the gains is scaled "
    "from 0 to 3 times its value; squares: while the sensor is silent. Right: the rate along the "
    "reference, which is what counts.",
    "nyquist": "The certificate in the frequency domain: V exists where the curve stays out of the "
    "shaded half plane.",
    "lyapunov": "V from one random error. An adversary switches to what leaves V largest: it may "
    "keep the sensor silent, and then nothing is learnt, but V never rises under certified gains. "
    "A fair adversary must read every output on both sides again and again. What cannot be known "
    "stays.",
    "ellipse": "Where 95 % of the estimates of an optimal estimator lie at the end of the "
    "scenario; a strip where a direction cannot be known.",
    "front": "Gains none of which is better than another one in everything; all are certified.",
}


def figures(
    of: Assessment, tried: Attacks | None, design: Design | None = None
) -> dict[str, Figure]:
    """The figures that apply, by name.

    Args:
        of: the assessment of the gains
        tried: attempts to break them, if any were made
        design: where the gains come from, if they were designed
    """
    gains = of.gains
    drawn: dict[str, Figure] = {}
    if design is not None and len(design.front) > 1:
        drawn["front"] = front(design)
    if gains is not None:
        if np.isfinite(gains.certificate.margin):
            drawn["nyquist"] = nyquist(gains)
        drawn["root_locus"] = root_locus(of, gains)
        if tried is not None:
            drawn["lyapunov"] = courses(gains, tried)
    if of.problem.sensor.kind == "deadzone":
        drawn["ellipse"] = ellipses(of)
    return drawn


def write_gains(
    of: Assessment,
    tried: Attacks | None,
    folder: Path,
    design: Design | None = None,
    origin: Origin | None = None,
) -> list[Path]:
    """Write the figures as SVG and report.html to a folder. Raises FileError.

    Args:
        of, tried, design: see `figures`
        folder: where the files go; created if needed
        origin: what it takes to get the same again; None: nobody can

    Returns:
        The paths of the files.
    """
    written = write_figures(figures(of, tried, design), folder)
    text = gains_page(of, tried, images_of(written), design, origin)
    return [*written.values(), write_text(text, folder / "report.html")]


def gains_page(
    of: Assessment,
    tried: Attacks | None,
    images: Mapping[str, bytes],
    design: Design | None = None,
    origin: Origin | None = None,
) -> str:
    """The page of an assessment.

    Args:
        of, tried, design, origin: see `write_gains`
        images: SVGs by the names of `figures`
    """
    shown = pictures(images, CAPTIONS)
    sections = [section("What was asked", _asked(of, design))]
    if of.gains is None:
        sections.append(section("No rate", paragraph(_why_no_rate(of))))
    else:
        guarantee = [*guarantee_section(of.gains, tried), *pick(shown, "nyquist", "lyapunov")]
        speed = [*speed_section(of.gains), *pick(shown, "root_locus")]
        sections.append(section("The gains", *gains_section(of.gains, design)))
        sections.append(section("What is guaranteed", *guarantee))
        sections.append(section("How fast", *speed))
    knowledge = [*knowledge_section(of), *pick(shown, "ellipse")]
    sections.append(section("What can be known", *knowledge))
    if design is not None:
        trade = [*trade_section(design), *pick(shown, "front")]
        sections.append(section("The trade", *trade))
    kind = "Check" if design is None else "Design"
    title = f"{kind}: {of.problem.scenario.title}"
    return page(title, verdict(of), *sections, origin=origin)


def _why_no_rate(of: Assessment) -> str:
    """Why the observer has no constant gains on a linear model."""
    if of.problem.model.nonlinear:
        return (
            "The model is nonlinear: gains can be certified on a declared [region], as check.json "
            "tells; frequencies and rates are for linear models."
        )
    return "The observer has no constant gains L, gamma."


def _asked(of: Assessment, design: Design | None) -> Html:
    """The plant, the sensor, the reference and what was wanted."""
    scenario, model = of.problem.scenario, of.problem.model
    unit = scenario.units.output
    sizes = (
        f"{counted(model.n, 'state')}, {counted(model.m, 'input')}, {counted(model.p, 'output')}"
    )
    poles = np.linalg.eigvals(of.problem.flow.linear.A) + 0.0
    simulation = scenario.simulation
    rows: list[tuple[str, Any]] = [
        ("plant", f"{sizes}; poles {listed(poles.tolist())} 1/s"),
        ("time", "continuous" if model.Ts is None else f"sampled every {model.Ts:g} s"),
        *_sensor_rows(of, unit),
        ("reference", label(_reference(of), unit)),
        ("side schedule", _schedule(of)),
        ("duration", f"{simulation.duration:g} s, a sample every {simulation.step:g} s"),
    ]
    if design is not None:
        rows.append(("wanted", f"{design.chosen}; seed {design.seed}"))
    return table(("what", "value"), rows)


def _sensor_rows(of: Assessment, unit: str) -> list[tuple[str, str]]:
    """The sensor and its noise."""
    sensor = of.problem.sensor
    widths = f"d_r = {numbers(sensor.right)}, d_l = {numbers(sensor.left)}"
    silent = f"silent below |y| = {numbers(sensor.threshold)}"
    noise = f"{numbers(sensor.noise)} after the zone, {numbers(sensor.noise_before)} before it"
    return [
        (label("sensor", unit), f"{sensor.kind}: {widths}, {silent}"),
        ("noise, rms", noise),
    ]


def _reference(of: Assessment) -> str:
    """The kind of the reference, and over which ranges the outputs move."""
    ends = zip(of.schedule.low, of.schedule.high, strict=True)
    reach = ", ".join(f"{low:.4g} to {high:.4g}" for low, high in ends)
    kind = type(of.problem.scenario.reference).__name__.lower()
    return f"{kind}; the outputs move over {reach}"


def _schedule(of: Assessment) -> str:
    """How many spans the schedule of sides has, in what time."""
    schedule = of.schedule
    again = ", then the same again" if schedule.periodic else ""
    return f"{counted(len(schedule.spans), 'span')} in {schedule.duration:.4g} s{again}"
