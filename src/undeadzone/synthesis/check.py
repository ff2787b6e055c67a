"""What a scenario's own gains are worth and what its readings can tell, with the reasons."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np

from undeadzone.analysis.certificate.design_file import Knowledge, describe_margin, format_gains
from undeadzone.analysis.certificate.passivity import Certificate
from undeadzone.analysis.certificate.polytopic import certify_on
from undeadzone.analysis.certificate.robust import l2_gain
from undeadzone.analysis.identifiability.indistinguishable import (
    describe_indistinguishable as in_words_of_truths,
)
from undeadzone.analysis.identifiability.linear import format_yes_no
from undeadzone.linalg.matrices import delta_form
from undeadzone.nonlinearities.sensor import DIRECTIONS
from undeadzone.plants.region import Box, box
from undeadzone.results.feedback import describe_feedback as share_in_words
from undeadzone.results.run import Run
from undeadzone.results.signals import output_names
from undeadzone.scenario.overrun import overrun_numbers
from undeadzone.scenario.problem import Problem, constant_gains, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.synthesis.assessment import Assessment, Gains, assess, determined_states
from undeadzone.util import shown
from undeadzone.util.arrays import Floats, finite, one_or_list
from undeadzone.util.shown import Block, Rows
from undeadzone.util.text import HALF_95, label, with_unit


class Bounds(NamedTuple):
    """BIBO in numbers: int |z - z^|^2 <= V(0) + disturbance^2 int |w|^2 + noise^2 int |v|^2.

    It holds for every sequence of sides, w at the input and v on y; each number is the least with
    the other signal absent.

    Attributes:
        disturbance: L2 gain from w to z - z^ [z/u].
        noise: L2 gain from v to z - z^ [z/y].
    """

    disturbance: float
    noise: float


class Nearest(NamedTuple):
    """Certified gains near to gains that are not.

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

    def plain(self) -> dict[str, Any]:
        """Return the same for JSON."""
        return self._asdict() | {"L": self.L.tolist(), "gamma": self.gamma.tolist()}


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Check:
    """What a scenario's own gains are worth, and what its readings can tell.

    Attributes:
        scenario: whose gains were checked, as they stand.
        certified: whether one V proves convergence for every sequence of sides; None where the
            method has no constant gains. A nonlinear model is certified on the scenario's region.
        margin: of the proof; None without one.
        frequency: where the margin is attained [rad/s]; None where there is no single one.
        l2_gain: bounds on z - z^; None if not proved.
        rate: of the error along the reference [1/s]; None where there is none.
        time_constant: of the same [s]; None where the error does not die.
        left_region: when a run of the scenario first leaves its region [s]; None if it does not.
        never: errors that stay along the reference, whatever the gains.
        states: which states the readings determine (n); empty of a nonlinear model.
        known: of each output, which of right, left, width, centre the readings can tell, their
            standard deviations [z], why not, and what would help (p).
        listens: the share of a z 5 % larger than the model says that each z^ follows (p); below a
            half the model is taken on trust. None: it cannot be told.
        overrun: of each output behind a play, J a / f of its load: above 1 it coasts; None: it
            cannot be told (p). Empty where no inertia is given.
        reasons: for every 'no'.
        cures: what would help.
        nearest: certified gains near to those that are not; None where there are none.
        assessment: what the report draws.
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
    reasons: tuple[str, ...]
    cures: tuple[str, ...]
    nearest: Nearest | None
    assessment: Assessment

    @property
    def affirmed(self) -> bool:
        """Return whether everything is answered with yes: the exit code of `undeadzone check`.

        That is: the gains are certified (observers without constant gains need not be), no run
        leaves the region, and every width can be identified.
        """
        covered = self.certified is not False and self.left_region is None
        return covered and all(one.right and one.left for one in self.known)

    @property
    def outputs(self) -> list[str]:
        """Return the names of the outputs: an arm's joints where it has one for each, else
        numbers.
        """
        arm = self.assessment.problem.model.arm
        return output_names([] if arm is None else arm.chain.joints, len(self.known))

    def summary(self) -> dict[str, Any]:
        """Return the numbers, ready for JSON: lists where there are several outputs.

        None stands where there is no finite number. They are those of `undeadzone check --json`,
        see docs/json.md.
        """
        verdicts = [{name: getattr(one, name) for name in DIRECTIONS} for one in self.known]
        numbers: dict[str, Any] = {
            "title": self.scenario.title,
            **{name: getattr(self, name) for name in PROOF},
            "identifiable": one_or_list(verdicts),
            "std": one_or_list([one.std for one in self.known]),
            "second": one_or_list([one.second for one in self.known]),
            "listens": one_or_list(self.listens) if self.listens else None,
            **({"overrun": one_or_list(self.overrun)} if self.overrun else {}),
            "reasons": self.reasons,
            "cures": self.cures,
            "nearest": None if self.nearest is None else self.nearest.plain(),
        }
        return dict(finite(numbers))

    def blocks(self) -> list[Block]:
        """Return the tables that `undeadzone check` prints."""
        return in_words(self)

    __repr__ = shown.in_text
    _repr_html_ = shown.in_notebook

    plot = shown.plot
    """Draw it."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Return checked again from its scenario: what the report draws holds functions."""
        return check, (self.scenario,)


REFUSED: Final = "not certified: "  # what the reason begins with
PROOF: Final = (
    *("certified", "margin", "frequency", "l2_gain", "rate", "time_constant", "left_region"),
    *("never", "states"),
)  # what `check` says of the gains, None where it cannot


def check(scenario: Scenario) -> Check:
    """What a scenario's own gains are worth, and what its readings can tell.

    Args:
        scenario: whose observer's gains are checked, as they stand.

    Raises:
        InputError: or a subclass, as `simulate` does.
    """
    return check_assessment(assess(resolve_scenario(scenario), listen=True))


def check_assessment(assessment: Assessment) -> Check:
    """What `check` says of an assessment."""
    problem, known = assessment.problem, assessment.known
    proved, reasons = _proof(assessment)
    near = None if assessment.gains is None else assessment.gains.nearest
    cures: list[str] = []
    for one in known:
        cures += one.cures
    return Check(
        scenario=problem.scenario,
        **proved,
        states=tuple(determined_states(problem, assessment.schedule)),
        known=tuple(known),
        listens=assessment.listens,
        overrun=_overrun(problem),
        reasons=(*reasons, *_reasons_of_outputs(known)),
        cures=tuple(cures),
        nearest=None if near is None else _nearest(near),
        assessment=assessment,
    )


def _overrun(problem: Problem) -> tuple[float | None, ...]:
    """Return the overrun number of each output; nothing where no inertia is given."""
    step = problem.scenario.simulation.step
    parts = problem.reference, problem.tracked, problem.steps * step, step
    return tuple(overrun_numbers(problem.sensor, *parts) or ())


def _nearest(gains: Gains) -> Nearest:
    """Return gains and what they are worth."""
    return Nearest(gains.L, gains.gamma, gains.certificate.margin, gains.rates.rate)


def _proof(assessment: Assessment) -> tuple[dict[str, Any], list[str]]:
    """What is proved of an assessment's gains, and the reasons where it is not."""
    problem, gains = assessment.problem, assessment.gains
    constant = constant_gains(problem.observer, problem.model)
    if constant is None:
        return {}, ["no certificate and no rate: the observer has no constant gains L, gamma"]
    if gains is not None:
        return _proof_of_linear(problem, gains)
    if problem.scenario.region is None:
        return {}, [
            "no certificate and no rate: the model is nonlinear; certificates of such models hold "
            "on a declared [region]"
        ]
    return _proof_on_region(assessment, *constant)


def _proof_of_linear(problem: Problem, gains: Gains) -> tuple[dict[str, Any], list[str]]:
    """What is proved of constant gains on a linear model, and the reasons where it is not."""
    proof, speed = gains.certificate, gains.rates
    reasons = []
    if not proof.certified:
        reasons.append(f"{REFUSED}{proof.reason}")
    if speed.rate < 0:
        reasons.append("the error grows along the reference")
    told = problem.observer.traits.told or problem.sensor.kind == "jump"
    if not told and not gains.gamma.all():
        reasons.append(
            "gamma = 0: the widths are not corrected and keep the error that they begin with; "
            "rate and bounds leave it out"
        )
    return {
        "certified": proof.certified,
        "margin": finite(proof.margin),
        "frequency": finite(proof.frequency),
        "l2_gain": _bounded_gains(proof, problem) if proof.certified else None,
        "rate": finite(speed.rate),
        "time_constant": finite(speed.time_constant),
        "never": tuple(speed.never),
    }, reasons


def _proof_on_region(
    assessment: Assessment, L: Floats, gamma: Floats
) -> tuple[dict[str, Any], list[str]]:
    """What is proved of constant gains on a nonlinear model's region, and the reasons if not."""
    problem = assessment.problem
    region = problem.scenario.region
    assert region is not None
    ranges = box(region, problem.model)
    proof = certify_on(problem.model, L, gamma, ranges)
    reasons = [] if proof.certified else [f"{REFUSED}{proof.reason}"]
    return {
        "certified": proof.certified,
        "margin": finite(proof.margin),
        "left_region": _exit_time(assessment.run, ranges),
    }, reasons


def _reasons_of_outputs(known: Sequence[Knowledge]) -> list[str]:
    """Why not all is known of each output, which is named where there are several."""
    reasons = []
    for i, one in enumerate(known):
        prefix = f"output {i}: " if len(known) > 1 else ""
        reasons += [f"{prefix}{reason}" for reason in one.reasons]
    return reasons


def _bounded_gains(proof: Certificate, problem: Problem) -> Bounds | None:
    """Return the least L2 gains to z - z^, each with the other input absent; None if one has no
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
    """Return the time [s] at which state, estimate or input of a run first leave a box; None:
    never.
    """
    assert run is not None
    outside = np.flatnonzero(ranges.is_outside(run.x, run.x_hat, run.u))
    return float(run.t[outside[0]]) if outside.size else None


# --- In words


def in_words(found: Check) -> list[Block]:
    """What was found of a scenario's gains: pairs, and of several outputs a table."""
    scenario, names = found.scenario, found.outputs
    shown: dict[str, Any] = {
        "scenario": scenario.title,
        "observer": f"{scenario.observer.__struct_config__.tag}, {scenario.simulation.time} time",
        **_describe_certificate(found),
        **_bounds(found),
        **_speed(found),
    }
    if found.listens:
        shown["listens"] = share_in_words(found.listens)
    if found.overrun:
        shown["overrun"] = _coasting(found.overrun)
    if len(names) == 1:
        shown |= _describe_output(scenario, found.known[0])
    if told := in_words_of_truths([one.second for one in found.known]):
        shown["same readings"] = told
    if reasons := [reason for reason in found.reasons if not reason.startswith(REFUSED)]:
        shown["why"] = reasons
    if found.cures:
        shown["cure"] = list(found.cures)
    if len(names) == 1:
        return [shown]
    duration = scenario.simulation.duration
    note = label(f"±: 95 % at best after {duration:g} s", scenario.units.output)
    return [shown, _rows(found), note]


def _rows(found: Check) -> Rows:
    """Return a row for each output: what its readings tell, with the least deviations they
    allow.
    """
    table: list[Sequence[str]] = [("identifiable", *DIRECTIONS)]
    for name, known in zip(found.outputs, found.known, strict=True):
        table.append((name, *(_describe_knowledge(known, each) for each in DIRECTIONS)))
    return table


def _describe_knowledge(known: Knowledge, name: str) -> str:
    """Return whether a direction can be known, and how well."""
    if not getattr(known, name):
        return "NO"
    std = finite(known.std.get(name))
    return "yes" if std is None else f"yes, ± {HALF_95 * std:.2g}"


def _describe_certificate(found: Check) -> dict[str, str]:
    """Return whether the gains are certified, and whether a run stays where they are."""
    shown = {}
    on_region = found.scenario.region is not None
    if found.certified and on_region:
        shown["certified"] = (
            f"yes on the region, margin {found.margin:.4g}: V never rises while x, x^ and u "
            "stay in it, whatever the sides do"
        )
    elif found.certified:
        assert found.margin is not None
        shown["certified"] = describe_margin(found.margin, found.frequency)
    elif found.certified is False:
        refused = [reason for reason in found.reasons if reason.startswith(REFUSED)]
        why = "; ".join(reason.removeprefix(REFUSED) for reason in refused)
        shown["certified"] = f"NO: {why}"
    if on_region and found.certified is not None:
        left = found.left_region
        shown["region"] = "a run of the scenario stays in it"
        if left is not None:
            shown["region"] = f"LEFT at {left:.4g} s of a run of the scenario: no claim from there"
    return shown


def _bounds(found: Check) -> dict[str, str]:
    """Return certified gains near to those that are not, and bounds of those that are."""
    shown, near = {}, found.nearest
    if near is not None:
        gains = f"L = {format_gains(near.L.tolist())}, gamma = {format_gains(near.gamma.tolist())}"
        shown["nearest certified"] = f"{gains}: margin {near.margin:.3g}, rate {near.rate:.4g} 1/s"
        shown["faster ones"] = (
            "undeadzone design finds certified gains by their rate and what they trade for it"
        )
    if found.l2_gain is not None:
        shown["bounded"] = (
            f"L2 gain to z - z^ {found.l2_gain.disturbance:.4g} from the input's disturbance, "
            f"{found.l2_gain.noise:.4g} from noise on y"
        )
    return shown


def _speed(found: Check) -> dict[str, str]:
    """How fast the error dies, and which errors stay."""
    shown = {}
    if found.rate is not None:
        after = "the error does not die"
        if found.time_constant is not None:
            after = f"time constant {found.time_constant:.4g} s"
        shown["rate"] = f"{found.rate:.4g} 1/s along the reference, {after}"
    if found.never:
        shown["stays"] = (
            f"{', '.join(found.never)}: these errors stay along this reference, whatever the gains"
        )
    return shown


def _coasting(overrun: Sequence[float | None]) -> str:
    """Return whether what is behind a play rests in its gap."""
    told = ", ".join(f"{number:.3g}" for number in overrun if finite(number) is not None)
    if not told:
        return "cannot be told: the reference has corners"
    return f"J a / f = {told}: below 1 the load rests against its contact"


def _describe_output(scenario: Scenario, one: Knowledge) -> dict[str, str]:
    """What the readings tell of a single output, and how well at best."""
    shown = {"identifiable": format_yes_no(msgspec.structs.asdict(one))}
    kept = {name: std for name, std in one.std.items() if finite(std) is not None}
    known = [f"{name} ± {HALF_95 * std:.2g}" for name, std in kept.items()]
    if known:
        duration = scenario.simulation.duration
        words = with_unit(", ".join(known), scenario.units.output)
        shown["known to"] = f"{words} (95 %) after {duration:g} s at best"
    return shown
