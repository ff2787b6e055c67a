"""A design as a value: gains, their proof, what they are worth, what can be known; kept in TOML, proved again on load."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from undeadzone import toml
from undeadzone.arrays import Floats, matrix, vector
from undeadzone.controllers import StateFeedback
from undeadzone.design.errordynamics import dynamics
from undeadzone.design.floquet import rates
from undeadzone.design.known import Known, determined, knowledge
from undeadzone.design.passivity import certify, recheck
from undeadzone.design.synthesis import RATE, ROUNDS, STARTS, Candidate, Weights, assess, balanced, fastest
from undeadzone.design.task import make_task
from undeadzone.errors import FileError, InputError, ProofError, StructureError
from undeadzone.files import reason, write_text
from undeadzone.observers import Certified
from undeadzone.plant import Matrices
from undeadzone.problem import Problem, constant_gains, resolve_scenario, systems
from undeadzone.scenario import Scenario

Matrix = list[list[float]]


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
        return write_text(toml.dumps(self), Path(path))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Design:
        """Read a design and prove it again. Raises FileError, ShapeError, or ProofError if the proof does not hold for its own model."""
        try:
            with open(path, "rb") as file:
                found = msgspec.convert(tomllib.load(file), cls)
        except OSError as error:
            raise FileError(f"{path}: cannot read: {reason(error)}") from None
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
    problem = resolve_scenario(msgspec.structs.replace(scenario, observer=Certified(L=[[0.0] * flow.p] * flow.n, gamma=0.0)))
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
        identifiable=knowledge(problem, schedule, None),
        front=[_point(candidate) for candidate in found.front],
    )


def rounds(maximise: Literal["knee", "rate"] | Weights) -> int:
    """How many rounds `design` reports to its progress callback."""
    return STARTS + (ROUNDS if maximise == "knee" else 0)


def _present(scenario: Scenario, problem: Problem) -> tuple[Floats, Floats] | None:
    """The scenario's own gains, if they are certified."""
    if not isinstance(scenario.observer, Certified):
        return None
    gains = constant_gains(scenario.observer.build(problem.model, problem.sensor), problem.model)
    return gains if gains is not None and certify(problem.model.linear, *gains, problem.model.Ts).certified else None


def _point(candidate: Candidate) -> Point:
    numbers = candidate._asdict()
    return Point(**numbers | {"L": candidate.L.tolist(), "gamma": candidate.gamma.tolist()})
