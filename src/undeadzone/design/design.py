"""A design as a value: gains, their proof, what they are worth, what can be known; made, judged, kept in TOML, proved again on load."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from undeadzone import toml
from undeadzone.arrays import Floats, matrix, vector
from undeadzone.controllers import StateFeedback
from undeadzone.design.errordynamics import dynamics
from undeadzone.design.floquet import rates
from undeadzone.design.identifiability import DIRECTIONS, cures, invisible, unknown_bias, verdicts
from undeadzone.design.information import deviations
from undeadzone.design.passivity import certify, recheck
from undeadzone.design.schedule import Schedule, planned, recorded
from undeadzone.design.synthesis import RATE, ROUNDS, STARTS, Candidate, Weights, assess, balanced, fastest
from undeadzone.design.task import make_task
from undeadzone.errors import FileError, InputError, ProofError, StructureError
from undeadzone.files import replacing
from undeadzone.observers import Certified
from undeadzone.plant import Matrices
from undeadzone.problem import Problem, constant_gains, resolve_scenario, systems
from undeadzone.run import finite
from undeadzone.scenario import Scenario
from undeadzone.signals import Random

Matrix = list[list[float]]


class Known(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What one output's readings can tell: verdicts, reasons for each 'no', cures, expected standard deviations [z]."""

    right: bool
    left: bool
    width: bool
    centre: bool
    reasons: list[str]
    cures: list[str]
    std: dict[str, float]


class Point(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Certified gains L (n x p), gamma (p) [1/s] and what they are worth: see `task.Scores`."""

    L: Matrix
    gamma: list[float]
    rate: float
    disturbance: float
    mismatch: float
    noise: float


class Design(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Gains for a model A, B, C (of one step if Ts [s] is set), and the proof P, W that V never rises.

    chosen: how (rate, knee, or the weights); K: the state feedback it was planned with; margin, frequency [rad/s]: of the
    proof; best: L, gamma and what they are worth; present: the scenario's own gains, if they are certified; identifiable:
    per output; states: which are determined; never: errors that no gains can remove; front: the trade, by falling rate;
    remarks: what could not be had.
    """

    title: str
    chosen: str
    seed: int
    Ts: float | None = None
    A: Matrix
    B: Matrix
    C: Matrix
    K: Matrix
    P: Matrix
    W: list[float]
    margin: float
    frequency: float | None = None
    never: list[str]
    states: list[bool]
    remarks: list[str]
    best: Point
    present: Point | None = None
    identifiable: list[Known]
    front: list[Point]

    @property
    def model(self) -> Matrices:
        """A, B, C as arrays."""
        n = len(self.A)
        return Matrices(matrix("A", self.A, n, n), matrix("B", self.B, n), matrix("C", self.C, None, n))

    @property
    def L(self) -> Floats:
        """Observer gains (n x p) [1/s]."""
        return matrix("best.L", self.best.L, len(self.A), len(self.C))

    @property
    def gamma(self) -> Floats:
        """Adaptation gains (p) [1/s]."""
        return vector("best.gamma", self.best.gamma, len(self.C))

    def require_proof(self, model: Matrices, Ts: float | None, what: str) -> None:
        """Prove the gains again for a model from P and W, by eigenvalues alone. Raises ProofError."""
        n, p = len(self.A), len(self.C)
        if model.C.shape != (p, n):
            raise ProofError(f"{what}: the design is for {n} states and {p} outputs, the model has {model.C.shape[1]} and {model.C.shape[0]}")
        found = recheck(dynamics(model, self.L, self.gamma, Ts), matrix("P", self.P, n, n), vector("W", self.W, p))
        if not found.proved:
            raise ProofError(
                f"{what}: its proof does not hold (greatest eigenvalue of the inequality {found.lmi:.3g}, least of P {found.P:.3g}; "
                "they must be negative and positive): the file was changed, or made for another model or sample time; design again"
            )

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write it as TOML, every number exactly. Raises FileError."""
        path = Path(path)
        with replacing(path) as temporary:
            temporary.write_text(toml.dumps(msgspec.to_builtins(self)), encoding="utf-8")
        return path

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Design:
        """Read a design and prove it again. Raises FileError, ShapeError, or ProofError if the proof does not hold for its own model."""
        try:
            with open(path, "rb") as file:
                found = msgspec.convert(tomllib.load(file), cls)
        except OSError as error:
            raise FileError(f"{path}: cannot read: {os.strerror(error.errno) if error.errno else error}") from None
        except (tomllib.TOMLDecodeError, UnicodeDecodeError, msgspec.ValidationError) as error:
            raise FileError(f"{path}: not a design saved by undeadzone ({error})") from None
        found.require_proof(found.model, found.Ts, str(path))
        return found


def design(
    scenario: Scenario,
    maximise: Literal["knee", "rate"] | Weights = "knee",
    *,
    margin: float = 0.01,
    seed: int = 0,
    progress: Callable[[int], None] | None = None,
) -> Design:
    """Gains for a scenario's model along its reference: the knee of the trade, the fastest, or the best for given weights.

    Certified with `margin`. progress is called with the number of rounds just done, `rounds(maximise)` in all. Raises
    StructureError where no gains can be certified, InputError where there is nothing to plan on.
    """
    _, flow, _ = systems(scenario)
    if flow.nonlinear or scenario.sensor.kind == "jump":
        what = "plant: a nonlinear plant" if flow.nonlinear else "sensor.kind: a jump sensor"
        raise InputError(f"{what} has no automatic design; choose gains and judge them by simulation")
    if not isinstance(scenario.controller, StateFeedback):
        raise InputError("controller.method: a design plans on z = r; use state_feedback")
    if reason := certify(flow.linear, np.zeros((flow.n, flow.p)), np.ones(flow.p)).reason:
        raise StructureError(f"plant: no gains can be certified: {reason}")
    problem = resolve_scenario(msgspec.structs.replace(scenario, observer=Certified()))
    task = make_task(problem, margin)
    present = _present(scenario, problem)
    before = None if present is None else assess(task, *present)
    linear = problem.model.linear
    if maximise == "knee":
        found = balanced(task, linear, before, seed, progress)
    else:
        found = fastest(task, linear, maximise if isinstance(maximise, Weights) else RATE, seed, progress)
    proof = found.certificate
    schedule = task.whole
    return Design(
        title=scenario.title,
        chosen=maximise if isinstance(maximise, str) else "rate / (" + " ".join(f"{name}^{power:g}" for name, power in maximise._asdict().items()) + ")",
        seed=seed,
        Ts=problem.model.Ts,
        A=linear.A.tolist(),
        B=linear.B.tolist(),
        C=linear.C.tolist(),
        K=problem.controller.params.K.tolist(),
        P=proof.P.tolist(),
        W=proof.W.tolist(),
        margin=proof.margin,
        frequency=proof.frequency,
        never=list(rates(linear, found.best.L, found.best.gamma, schedule).never),
        states=determined(problem, schedule),
        remarks=list(found.remarks),
        best=_point(found.best),
        present=None if before is None else _point(before),
        identifiable=knowledge(problem, schedule),
        front=[_point(candidate) for candidate in found.front],
    )


def rounds(maximise: Literal["knee", "rate"] | Weights) -> int:
    """How many rounds `design` reports to its progress callback."""
    return STARTS + (ROUNDS if maximise == "knee" else 0)


def check(scenario: Scenario) -> dict[str, Any]:
    """What a scenario's own gains are worth, ready for JSON; lists where there are several outputs.

    certified (null where the method has no constant gains), margin, frequency [rad/s]; rate [1/s], time_constant [s],
    never: errors that stay; states: which are determined; identifiable {right, left, width, centre}, std of the same [z];
    reasons for every 'no', cures.
    """
    problem = resolve_scenario(scenario)
    schedule = plan(problem)
    known = knowledge(problem, schedule)
    absent: dict[str, Any] = dict.fromkeys(("certified", "margin", "frequency", "rate", "time_constant"))
    summary = {"title": scenario.title, **absent, "never": [], "states": determined(problem, schedule)}
    reasons = []
    gains = constant_gains(problem.observer, problem.model)
    if gains is None or problem.model.nonlinear:
        what = "the model is nonlinear" if problem.model.nonlinear else "the observer has no constant gains L, gamma"
        reasons.append(f"no certificate and no rate: {what}")
    else:
        proof = certify(problem.model.linear, *gains, problem.model.Ts)
        speed = rates(problem.model.linear, *gains, schedule, problem.sensor.kind == "jump")
        summary |= {
            "certified": proof.certified,
            "margin": proof.margin,
            "frequency": proof.frequency,
            "rate": speed.rate,
            "time_constant": speed.time_constant,
            "never": list(speed.never),
        }
        reasons += [f"not certified: {proof.reason}"] * (not proof.certified) + ["the error grows along the reference"] * (speed.rate < 0)
    several = len(known) > 1
    identifiable = [{name: getattr(k, name) for name in DIRECTIONS} for k in known]
    std = [{name: finite(value) for name, value in k.std.items()} for k in known]
    reasons += [f"output {i}: {reason}" if several else reason for i, k in enumerate(known) for reason in k.reasons]
    return {key: finite(value) for key, value in summary.items()} | {
        "identifiable": identifiable if several else identifiable[0],
        "std": std if several else std[0],
        "reasons": reasons,
        "cures": [cure for k in known for cure in k.cures],
    }


def plan(problem: Problem) -> Schedule:
    """The sides along the reference where the controller makes z follow it, else along a simulated run."""
    if isinstance(problem.scenario.controller, StateFeedback):
        return planned(problem.model, problem.reference, problem.tracked, problem.sensor, problem.scenario.simulation.duration)
    from undeadzone.simulation import simulate

    run = simulate(problem.scenario, check_step=False)
    return recorded(run.z, problem.sensor, run.info.step, problem.model.Ts)


def knowledge(problem: Problem, schedule: Schedule) -> list[Known]:
    """What can be known of each output, and how well after the scenario's duration with its sensor noise.

    A step, or the offset of sines, as disturbance counts as an unknown bias; a random one as white process noise of its
    low-frequency density, 2 rms^2 times its correlation time.
    """
    model, sensor, scenario = problem.model, problem.sensor, problem.scenario
    linear, jump = model.linear, sensor.kind == "jump"
    bias, process = unknown_bias(scenario.disturbance, linear.B), None
    if isinstance(scenario.disturbance, Random):
        density = 2 * np.asarray(scenario.disturbance.rms, float) ** 2 * scenario.disturbance.correlation_time
        process = linear.B * np.broadcast_to(density, model.m) @ linear.B.T / (1.0 if model.Ts is None else model.Ts)
    noise = np.hypot(sensor.noise_before, sensor.noise / sensor.slope)
    found = verdicts(linear, schedule, bias, jump)
    help_ = cures(linear, schedule, bias, jump)
    std = [{} for _ in found] if jump else deviations(linear, schedule, noise, scenario.simulation.step, scenario.simulation.duration, bias, process).widths
    return [
        Known(**verdict._asdict() | {"reasons": list(verdict.reasons)}, cures=[cure.text for cure in help_ if cure.output == i], std=std[i])
        for i, verdict in enumerate(found)
    ]


def determined(problem: Problem, schedule: Schedule) -> list[bool]:
    """Which states the readings along a schedule determine."""
    linear = problem.model.linear
    bias = unknown_bias(problem.scenario.disturbance, linear.B)
    hidden = invisible(linear, schedule.visited(problem.model.n), schedule.Ts, bias, problem.sensor.kind == "jump")
    return [hidden.state(i) for i in range(problem.model.n)]


def _present(scenario: Scenario, problem: Problem) -> tuple[Floats, Floats] | None:
    """The scenario's own gains, if they are certified."""
    if not isinstance(scenario.observer, Certified):
        return None
    gains = constant_gains(scenario.observer.build(problem.model, problem.sensor), problem.model)
    return gains if gains is not None and certify(problem.model.linear, *gains, problem.model.Ts).certified else None


def _point(candidate: Candidate) -> Point:
    numbers = candidate._asdict()
    return Point(**numbers | {"L": candidate.L.tolist(), "gamma": candidate.gamma.tolist()})
