"""A design as a value: gains, their proof, what they are worth; kept in TOML, proved again on load."""

from __future__ import annotations

import os
import tomllib
from pathlib import Path

import msgspec

from undeadzone.analysis.certificate.passivity import recheck
from undeadzone.analysis.error_dynamics import dynamics
from undeadzone.errors import FileError, ProofError
from undeadzone.linear.matrices import Matrices
from undeadzone.support import toml
from undeadzone.support.arrays import Floats, matrix, vector
from undeadzone.support.files import reason, write_text

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
    identifiable: list[Knowledge]
    front: list[Point]

    @property
    def model(self) -> Matrices:
        """A, B, C as arrays."""
        n = len(self.A)
        return Matrices(
            matrix("A", self.A, n, n), matrix("B", self.B, n), matrix("C", self.C, None, n)
        )

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
            raise ProofError(
                f"{what}: the design is for {n} states and {p} outputs, the model has {model.C.shape[1]} and {model.C.shape[0]}"
            )
        found = recheck(
            dynamics(model, self.L, self.gamma, Ts),
            matrix("P", self.P, n, n),
            vector("W", self.W, p),
        )
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


class Knowledge(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What one output's readings can tell: verdicts, reasons for each 'no', cures, expected standard deviations [z]."""

    right: bool
    left: bool
    width: bool
    centre: bool
    reasons: list[str]
    cures: list[str]
    std: dict[str, float]
