"""What a scenario's own gains are worth and what its readings can tell, with the reasons."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from undeadzone.analysis.certificate.design_file import Knowledge
from undeadzone.analysis.certificate.passivity import Certificate
from undeadzone.analysis.certificate.polytopic import certify_on
from undeadzone.analysis.certificate.robust import l2_gain
from undeadzone.ends.sensor import DIRECTIONS
from undeadzone.linear.matrices import delta
from undeadzone.plants.region import Box, box
from undeadzone.results.run import Run
from undeadzone.results.signals import output_names
from undeadzone.scenario.overrun import overrun_numbers
from undeadzone.scenario.problem import Problem, constant_gains, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.support.arrays import Floats, finite, one_or_list
from undeadzone.support.shown import Block, Shown
from undeadzone.synthesis.assessment import Assessment, Gains, assess, determined
from undeadzone.synthesis.words import in_words


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


@dataclasses.dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Check(Shown):
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
        """Whether everything is answered with yes: the exit code of `undeadzone check`.

        That is: the gains are certified (observers without constant gains need not be), no run
        leaves the region, and every width can be identified.
        """
        covered = self.certified is not False and self.left_region is None
        return covered and all(one.right and one.left for one in self.known)

    @property
    def outputs(self) -> list[str]:
        """The names of the outputs: an arm's joints where it has one for each, else numbers."""
        arm = self.assessment.problem.model.arm
        return output_names([] if arm is None else arm.chain.joints, len(self.known))

    def summary(self) -> dict[str, Any]:
        """The numbers, ready for JSON: lists where there are several outputs.

        None stands where there is no finite number. They are those of `undeadzone check --json`,
        see docs/json.md.
        """
        verdicts = [{name: getattr(one, name) for name in DIRECTIONS} for one in self.known]
        numbers: dict[str, Any] = {"title": self.scenario.title}
        numbers |= {name: getattr(self, name) for name in PROOF}
        numbers |= {
            "l2_gain": None if self.l2_gain is None else self.l2_gain._asdict(),
            "never": list(self.never),
            "states": list(self.states),
            "identifiable": one_or_list(verdicts),
            "std": one_or_list([one.std for one in self.known]),
            "second": one_or_list([one.second for one in self.known]),
            "listens": one_or_list(self.listens) if self.listens else None,
            **({"overrun": one_or_list(self.overrun)} if self.overrun else {}),
            "reasons": list(self.reasons),
            "cures": list(self.cures),
            "nearest": None if self.nearest is None else _plain(self.nearest),
        }
        return dict(finite(numbers))

    def blocks(self) -> list[Block]:
        """The tables that `undeadzone check` prints."""
        return in_words(self.summary(), self.scenario, self.outputs)

    def __reduce__(self) -> tuple[Any, ...]:
        """Checked again from its scenario: what the report draws holds functions."""
        return check, (self.scenario,)


PROOF: Final = (
    "certified",
    "margin",
    "frequency",
    "l2_gain",
    "rate",
    "time_constant",
    "left_region",
)  # what `check` says of the gains, None where it cannot


def check(scenario: Scenario) -> Check:
    """What a scenario's own gains are worth, and what its readings can tell.

    Args:
        scenario: whose observer's gains are checked, as they stand.

    Raises:
        InputError: or a subclass, as `simulate` does.
    """
    return checked(assess(resolve_scenario(scenario), listen=True))


def checked(assessment: Assessment) -> Check:
    """What `check` says of an assessment."""
    problem, known = assessment.problem, assessment.known
    proved, reasons = _proof(assessment)
    near = None if assessment.gains is None else assessment.gains.nearest
    cures: list[str] = []
    for one in known:
        cures += one.cures
    return Check(
        scenario=problem.scenario,
        **{name: _known(value) for name, value in proved.items()},
        states=tuple(determined(problem, assessment.schedule)),
        known=tuple(known),
        listens=assessment.listens,
        overrun=_overrun(problem),
        reasons=(*reasons, *_reasons_of_outputs(known)),
        cures=tuple(cures),
        nearest=None if near is None else _nearest(near),
        assessment=assessment,
    )


def _overrun(problem: Problem) -> tuple[float | None, ...]:
    """The overrun number of each output; nothing where no inertia is given."""
    step = problem.scenario.simulation.step
    parts = problem.reference, problem.tracked, problem.steps * step, step
    return tuple(overrun_numbers(problem.sensor, *parts) or ())


def _known(value: Any) -> Any:
    """A value; None for a number that is not finite."""
    return finite(value) if isinstance(value, float) else value


def _nearest(gains: Gains) -> Nearest:
    """Gains and what they are worth."""
    return Nearest(gains.L, gains.gamma, gains.certificate.margin, gains.rates.rate)


def _plain(near: Nearest) -> dict[str, Any]:
    """Gains for JSON."""
    return near._asdict() | {"L": near.L.tolist(), "gamma": near.gamma.tolist()}


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
        reasons.append(f"not certified: {proof.reason}")
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
        "margin": proof.margin,
        "frequency": proof.frequency,
        "l2_gain": _bounded(proof, problem) if proof.certified else None,
        "rate": speed.rate,
        "time_constant": speed.time_constant,
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
    reasons = [] if proof.certified else [f"not certified: {proof.reason}"]
    return {
        "certified": proof.certified,
        "margin": proof.margin,
        "left_region": _left(assessment.run, ranges),
    }, reasons


def _reasons_of_outputs(known: Sequence[Knowledge]) -> list[str]:
    """Why not all is known of each output, which is named where there are several."""
    reasons = []
    for i, one in enumerate(known):
        prefix = f"output {i}: " if len(known) > 1 else ""
        reasons += [f"{prefix}{reason}" for reason in one.reasons]
    return reasons


def _bounded(proof: Certificate, problem: Problem) -> Bounds | None:
    """The least L2 gains to z - z^, each with the other input absent; None if one has no proof.

    They are those from a disturbance of the input and from noise on the reading.
    """
    model = problem.model
    disturbed = l2_gain(proof.dynamics, E=delta(model.linear, model.Ts).B)
    noisy = l2_gain(proof.dynamics, noise=1 / problem.sensor.slope)
    if not (disturbed.check.proved and noisy.check.proved):
        return None
    return Bounds(disturbed.disturbance, noisy.noise)


def _left(run: Run | None, ranges: Box) -> float | None:
    """The time [s] at which state, estimate or input of a run first leave a box; None: never."""
    assert run is not None
    outside = np.flatnonzero(ranges.left(run.x, run.x_hat, run.u))
    return float(run.t[outside[0]]) if outside.size else None
