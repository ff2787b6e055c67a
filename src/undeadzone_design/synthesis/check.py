"""Check of a scenario: certificate and rates of its gains, identifiability from its readings,
reasons.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np

from undeadzone.analysis.certificate.design_file import (
    Design,
    Knowledge,
    describe_design,
    describe_margin,
    format_gains,
)
from undeadzone.analysis.certificate.passivity import Certificate
from undeadzone.analysis.identifiability.indistinguishable import (
    describe_indistinguishable as in_words_of_truths,
)
from undeadzone.analysis.identifiability.linear import format_yes_no
from undeadzone.linalg.matrices import delta_form
from undeadzone.nonlinearities.sensor import DIRECTIONS, SHAPE
from undeadzone.plants.region import Box, build_box
from undeadzone.results.feedback import describe_feedback as share_in_words
from undeadzone.results.run import Run
from undeadzone.results.signals import output_names
from undeadzone.scenario.overrun import overrun_numbers
from undeadzone.scenario.problem import Problem, constant_gains, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.util import shown
from undeadzone.util.arrays import Floats, to_json_value, to_scalar_or_list
from undeadzone.util.shown import Block, Rows
from undeadzone.util.text import HALF_95, append_unit, label_with_unit
from undeadzone_design.certificate.polytopic import certify_on
from undeadzone_design.certificate.robust import l2_gain
from undeadzone_design.synthesis.assessment import (
    Assessment,
    Gains,
    assess_problem,
    find_determined_states,
)
from undeadzone_design.synthesis.shape_costs import compute_shape_costs


class Bounds(NamedTuple):
    """BIBO in numbers: int |z - z^|^2 <= V(0) + disturbance^2 int |w|^2 + noise^2 int |v|^2.

    It holds for every sequence of sides, w at the input and v on y. Each number is the least with
    the other signal absent.

    Attributes:
        disturbance: L2 gain from w to z - z^ [z/u].
        noise: L2 gain from v to z - z^ [z/y].
    """

    disturbance: float
    noise: float


class CertifiedNeighbour(NamedTuple):
    """Certified gains near to gains without a certificate.

    Attributes:
        L: gain of x^ (n x p) [1/s].
        gamma: gain of the widths (p) [1/s].
        margin: of their proof.
        rate: of the error along the reference [1/s].
    """

    L: Floats
    gamma: Floats
    margin: float
    rate: float

    def to_plain(self) -> dict[str, Any]:
        """Return the same gains for JSON."""
        return self._asdict() | {"L": self.L.tolist(), "gamma": self.gamma.tolist()}


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Check:
    """Certificate and rates of a scenario's own gains, and the identifiability from its
    readings.

    Attributes:
        scenario: whose gains were checked, as they stand.
        certified: whether one V proves convergence for every sequence of sides, None if the method
            has no constant gains. A nonlinear model is certified on the scenario's region.
        margin: of the proof (None without one).
        frequency: of that margin [rad/s] (None if there is no single one).
        l2_gain: bounds on z - z^ (None if not proved).
        rate: of the error along the reference [1/s] (None if there is none).
        time_constant: of the same [s] (None if the error does not decay).
        left_region: time at which a run of the scenario first leaves its region [s] (None if it
            does not).
        never: errors that stay along the reference, for any gains.
        states: which states the readings determine (n) (empty of a nonlinear model).
        known: of each output, which of right, left, width, centre are identifiable, their standard
            deviations [z], reasons and remedies (p).
        listens: share of a z 5 % larger than the model's that each z^ follows (p) (below a half the
            model alone determines z^). None: unknown.
        overrun: of each output behind a play, J a / f of its load: above 1 it coasts, None if
            unknown (p). Empty if no inertia is given.
        shape: of each output, the deviation of its width at the end of a run, and how much of it
            each assumption about the sensor's shape is (p) [z] (empty: the observer allows for
            none).
        reasons: for every 'no'.
        cures: what would help.
        nearest: certified gains near to those that are not (None if there are none).
        assessment: data of the report.
    """

    scenario: Scenario
    certified: bool | None = None
    margin: float | None = None
    frequency: float | None = None
    l2_gain: Bounds | None = None
    rate: float | None = None
    time_constant: float | None = None
    left_region: float | None = None
    never: tuple[str, ...] = ()
    states: tuple[bool, ...] = ()
    known: tuple[Knowledge, ...]
    listens: tuple[float | None, ...]
    overrun: tuple[float | None, ...] = ()
    shape: tuple[dict[str, float], ...] = ()
    reasons: tuple[str, ...]
    cures: tuple[str, ...]
    nearest: CertifiedNeighbour | None
    assessment: Assessment

    @property
    def drawn(self) -> tuple[str, str, str]:
        """Return module and functions that draw the check for `uz.plot`."""
        return "undeadzone_design.report.check_figures", "plot_check", "draw_check_panel"

    @property
    def affirmed(self) -> bool:
        """Return whether every question is answered with yes: the exit code of `undeadzone
        check`.

        That is: the gains are certified (observers without constant gains need not be), no run
        leaves the region, and every width can be identified.
        """
        covered = self.certified is not False and self.left_region is None
        return covered and all(one.right and one.left for one in self.known)

    @property
    def outputs(self) -> list[str]:
        """Return the names of the outputs: an arm's joints if each output is a joint, else
        numbers.
        """
        arm = self.assessment.problem.model.arm
        return output_names([] if arm is None else arm.chain.joints, len(self.known))

    def summary(self) -> dict[str, Any]:
        """Return the numbers, ready for JSON: lists for several outputs.

        None replaces numbers that are not finite. They are those of the command, see
        docs/json.md.
        """
        verdicts = [{name: getattr(one, name) for name in DIRECTIONS} for one in self.known]
        numbers: dict[str, Any] = {
            "title": self.scenario.title,
            **{name: getattr(self, name) for name in PROOF},
            "identifiable": to_scalar_or_list(verdicts),
            "std": to_scalar_or_list([one.std for one in self.known]),
            "second": to_scalar_or_list([one.second for one in self.known]),
            "listens": to_scalar_or_list(self.listens) if self.listens else None,
            **({"overrun": to_scalar_or_list(self.overrun)} if self.overrun else {}),
            **({"shape": to_scalar_or_list(list(self.shape))} if self.shape else {}),
            "reasons": self.reasons,
            "cures": self.cures,
            "nearest": None if self.nearest is None else self.nearest.to_plain(),
        }
        return dict(to_json_value(numbers))

    def blocks(self) -> list[Block]:
        """Return the tables that `undeadzone check` prints."""
        return describe_check(self)

    __repr__ = shown.format_result
    _repr_html_ = shown.result_to_html

    plot = shown.plot
    """Draw it."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the scenario, checked again when loaded: the data of figures contain
        functions.
        """
        return check, (self.scenario,)


REFUSED: Final = "not certified: "  # first words of the reason
PROOF: Final = (
    *("certified", "margin", "frequency", "l2_gain", "rate", "time_constant", "left_region"),
    *("never", "states"),
)  # verdict of `check` on the gains, None without one


def check(scenario: Scenario) -> Check:
    """Check a scenario: certificate and rates of its own gains, identifiability from its
    readings.

    Args:
        scenario: whose observer's gains are checked, as they stand.

    Raises:
        InputError: or a subclass, as `simulate` does.

    Example:
        >>> proved = uz.check(
        ...     uz.Scenario(plant=plant, sensor=sensor, reference=reference, observer=certified)
        ... )
        >>> proved.certified
        True

    See Also:
        design, simulate
    """
    problem = resolve_scenario(scenario)
    found = check_assessment(assess_problem(problem, listen=True))
    return dataclasses.replace(found, shape=compute_shape_costs(problem))


def check_assessment(assessment: Assessment) -> Check:
    """Return the check of an assessment."""
    problem = assessment.problem
    known = assessment.known
    proved, reasons = _prove_gains(assessment)
    near = None if assessment.gains is None else assessment.gains.nearest
    cures: list[str] = []
    for one in known:
        cures += one.cures
    return Check(
        scenario=problem.scenario,
        **proved,
        states=tuple(find_determined_states(problem, assessment.schedule)),
        known=tuple(known),
        listens=assessment.listens,
        overrun=_overrun_of_outputs(problem),
        reasons=(*reasons, *_list_output_reasons(known)),
        cures=tuple(cures),
        nearest=None if near is None else _to_certified_neighbour(near),
        assessment=assessment,
    )


def _overrun_of_outputs(problem: Problem) -> tuple[float | None, ...]:
    """Return the overrun number of each output, empty without an inertia."""
    step = problem.scenario.simulation.step
    parts = problem.reference, problem.tracked, problem.steps * step, step
    return tuple(overrun_numbers(problem.sensor, *parts) or ())


def _to_certified_neighbour(gains: Gains) -> CertifiedNeighbour:
    """Return gains with their margin and rate."""
    return CertifiedNeighbour(gains.L, gains.gamma, gains.certificate.margin, gains.rates.rate)


def _prove_gains(assessment: Assessment) -> tuple[dict[str, Any], list[str]]:
    """Return the proved properties of an assessment's gains, and the reasons of a refusal."""
    problem = assessment.problem
    gains = assessment.gains
    constant = constant_gains(problem.observer, problem.model)
    if constant is None:
        return {}, ["no certificate and no rate: the observer has no constant gains L, gamma"]
    if gains is not None:
        return _prove_on_linear_model(problem, gains)
    if problem.scenario.region is None:
        return {}, [
            "no certificate and no rate: the model is nonlinear. Certificates of such models hold "
            "on a declared [region]"
        ]
    return _prove_on_region(assessment, *constant)


def _prove_on_linear_model(problem: Problem, gains: Gains) -> tuple[dict[str, Any], list[str]]:
    """Return the proved properties of constant gains on a linear model, and the reasons of a
    refusal.
    """
    proof = gains.certificate
    speed = gains.rates
    reasons = []
    if not proof.certified:
        reasons.append(f"{REFUSED}{proof.reason}")
    if speed.rate < 0:
        reasons.append("the error grows along the reference")
    knows_widths = problem.observer.traits.knows_widths or problem.sensor.kind == "jump"
    if not knows_widths and not gains.gamma.all():
        reasons.append(
            "gamma = 0: the widths are not corrected and keep the error that they begin with; "
            "rate and bounds leave it out"
        )
    return {
        "certified": proof.certified,
        "margin": to_json_value(proof.margin),
        "frequency": to_json_value(proof.frequency),
        "l2_gain": _compute_l2_gains(proof, problem) if proof.certified else None,
        "rate": to_json_value(speed.rate),
        "time_constant": to_json_value(speed.time_constant),
        "never": tuple(speed.never),
    }, reasons


def _prove_on_region(
    assessment: Assessment, L: Floats, gamma: Floats
) -> tuple[dict[str, Any], list[str]]:
    """Return the proved properties of constant gains on a nonlinear model's region, and
    reasons.
    """
    problem = assessment.problem
    region = problem.scenario.region
    assert region is not None
    ranges = build_box(region, problem.model)
    proof = certify_on(problem.model, L, gamma, ranges)
    reasons = [] if proof.certified else [f"{REFUSED}{proof.reason}"]
    return {
        "certified": proof.certified,
        "margin": to_json_value(proof.margin),
        "left_region": _exit_time(assessment.run, ranges),
    }, reasons


def _list_output_reasons(known: Sequence[Knowledge]) -> list[str]:
    """Return the reasons for incomplete identifiability of each output, with its number if
    several.
    """
    reasons = []
    for i, one in enumerate(known):
        prefix = f"output {i}: " if len(known) > 1 else ""
        reasons += [f"{prefix}{reason}" for reason in one.reasons]
    return reasons


def _compute_l2_gains(proof: Certificate, problem: Problem) -> Bounds | None:
    """Return the least L2 gains to z - z^, each with the other input absent, or None without a
    proof.

    They are those from a disturbance of the input and from noise on the reading.
    """
    model = problem.model
    disturbed = l2_gain(proof.dynamics, E=delta_form(model.linear, model.Ts).B)
    noisy = l2_gain(proof.dynamics, noise=1 / problem.sensor.slope)
    if not (disturbed.check.proved and noisy.check.proved):
        return None
    return Bounds(disturbed.disturbance, noisy.noise)


def _exit_time(run: Run | None, ranges: Box) -> float | None:
    """Return the time [s] at which state, estimate or input of a run first leave a box, or
    None.
    """
    assert run is not None
    outside = np.flatnonzero(ranges.is_outside(run.x, run.x_hat, run.u))
    return float(run.t[outside[0]]) if outside.size else None


# --- In words


def describe_check(found: Check) -> list[Block]:
    """Return the check of a scenario's gains as pairs, and for several outputs as a table."""
    scenario = found.scenario
    names = found.outputs
    summary: dict[str, Any] = {
        "scenario": scenario.title,
        "observer": f"{scenario.observer.__struct_config__.tag}, {scenario.simulation.time} time",
        **_describe_certificate(found),
        **_describe_bounds(found),
        **_describe_decay(found),
    }
    if found.listens:
        summary["listens"] = share_in_words(found.listens)
    if found.overrun:
        summary["overrun"] = _describe_coasting(found.overrun)
    if len(names) == 1:
        summary |= _describe_output(scenario, found.known[0])
    if found.shape:
        summary["shape"] = _describe_shape(found)
    if alike := in_words_of_truths([one.second for one in found.known]):
        summary["same readings"] = alike
    if reasons := [reason for reason in found.reasons if not reason.startswith(REFUSED)]:
        summary["why"] = reasons
    if found.cures:
        summary["cure"] = list(found.cures)
    if len(names) == 1:
        return [summary]
    duration = scenario.simulation.duration
    note = label_with_unit(f"±: 95 % at best after {duration:g} s", scenario.units.output)
    return [summary, _identifiability_rows(found), note]


def _describe_shape(found: Check) -> list[str]:
    """Return how much of each width's interval is the sensor's shape, in words."""
    lines = []
    for name, costs in zip(found.outputs, found.shape, strict=True):
        of = f"output {name}: " if len(found.shape) > 1 else ""
        parts = [f"{key} {HALF_95 * costs[key]:.2g}" for key in SHAPE]
        whole = append_unit(f"{HALF_95 * costs['width']:.2g}", found.scenario.units.output)
        lines.append(f"{of}width ± {whole} at the end of a run, of which {', '.join(parts)}")
    return [*lines, "roots of variances. Set sensor keys to 0 for an exact sensor"]


def _identifiability_rows(found: Check) -> Rows:
    """Return a row for each output: its identifiability, with the least possible deviations."""
    table: list[Sequence[str]] = [("identifiable", *DIRECTIONS)]
    for name, known in zip(found.outputs, found.known, strict=True):
        table.append((name, *(_format_identifiability(known, each) for each in DIRECTIONS)))
    return table


def _format_identifiability(known: Knowledge, name: str) -> str:
    """Return whether a direction is identifiable, and its deviation."""
    if not getattr(known, name):
        return "NO"
    std = to_json_value(known.std.get(name))
    return "yes" if std is None else f"yes, ± {HALF_95 * std:.2g}"


def _describe_certificate(found: Check) -> dict[str, str]:
    """Return whether the gains are certified, and whether a run stays in the certified region."""
    summary = {}
    on_region = found.scenario.region is not None
    if found.certified and on_region:
        summary["certified"] = (
            f"yes on the region, margin {found.margin:.4g}: V never rises while x, x^ and u "
            "stay in it, on any side"
        )
    elif found.certified:
        assert found.margin is not None
        summary["certified"] = describe_margin(found.margin, found.frequency)
    elif found.certified is False:
        refused = [reason for reason in found.reasons if reason.startswith(REFUSED)]
        why = "; ".join(reason.removeprefix(REFUSED) for reason in refused)
        summary["certified"] = f"NO: {why}"
    if on_region and found.certified is not None:
        left = found.left_region
        summary["region"] = "a run of the scenario stays in it"
        if left is not None:
            summary["region"] = (
                f"LEFT at {left:.4g} s of a run of the scenario: nothing is proved from there"
            )
    return summary


def _describe_bounds(found: Check) -> dict[str, str]:
    """Return certified gains near to uncertified gains, and L2 bounds of certified gains."""
    summary = {}
    near = found.nearest
    if near is not None:
        gains = f"L = {format_gains(near.L.tolist())}, gamma = {format_gains(near.gamma.tolist())}"
        summary["nearest certified"] = (
            f"{gains}: margin {near.margin:.3g}, rate {near.rate:.4g} 1/s"
        )
        summary["faster ones"] = (
            "undeadzone design finds certified gains by their rate and its price"
        )
    if found.l2_gain is not None:
        summary["bounded"] = (
            f"L2 gain to z - z^ {found.l2_gain.disturbance:.4g} from the input's disturbance, "
            f"{found.l2_gain.noise:.4g} from noise on y"
        )
    return summary


def _describe_decay(found: Check) -> dict[str, str]:
    """Return the decay rate of the error, and the errors that stay."""
    summary = {}
    if found.rate is not None:
        after = "the error does not die"
        if found.time_constant is not None:
            after = f"time constant {found.time_constant:.4g} s"
        summary["rate"] = f"{found.rate:.4g} 1/s along the reference, {after}"
    if found.never:
        summary["stays"] = (
            f"{', '.join(found.never)}: these errors stay along this reference, with any gains"
        )
    return summary


def _describe_coasting(overrun: Sequence[float | None]) -> str:
    """Return whether the load behind a backlash rests in its gap."""
    numbers = ", ".join(f"{number:.3g}" for number in overrun if to_json_value(number) is not None)
    if not numbers:
        return "unknown: the reference has corners"
    return f"J a / f = {numbers}: below 1 the load rests against its contact"


def _describe_output(scenario: Scenario, one: Knowledge) -> dict[str, str]:
    """Return the identifiability of a single output, and its deviations at best."""
    summary = {"identifiable": format_yes_no(msgspec.structs.asdict(one))}
    deviations = {name: std for name, std in one.std.items() if to_json_value(std) is not None}
    known = [f"{name} ± {HALF_95 * std:.2g}" for name, std in deviations.items()]
    if known:
        duration = scenario.simulation.duration
        words = append_unit(", ".join(known), scenario.units.output)
        summary["known to"] = f"{words} (95 %) after {duration:g} s at best"
    return summary


# --- A design with its check


def list_design_numbers(design: Design, found: Check) -> dict[str, Any]:
    """Return the numbers of a design for JSON, its gains first, and those of its check."""
    numbers = msgspec.to_builtins(design)
    known = found.summary()
    del known["nearest"]  # those found are certified
    return dict(numbers.pop("best") | numbers | known)


def describe_design_and_check(design: Design, found: Check) -> list[Block]:
    """Return a design and the results of its check as text."""
    first, *others = found.blocks()
    assert isinstance(first, dict)
    findings = {name: words for name, words in first.items() if name != "observer"}
    own = describe_design(msgspec.to_builtins(design))
    return [
        own | {name: findings.pop(name) for name in own if name in findings} | findings,
        *others,
    ]
