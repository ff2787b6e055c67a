"""Designs as values: gains, proof and scores, stored in TOML and proved again on load.

The proof is also described in words.
"""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from undeadzone.analysis.certificate.passivity import certify, margin_of_dynamics, recheck_proof
from undeadzone.analysis.error_dynamics import build_error_dynamics
from undeadzone.errors import FileError, InputError, ProofError, ShapeError
from undeadzone.linalg.matrices import Matrices
from undeadzone.util import shown, toml
from undeadzone.util.arrays import Floats, require_matrix, require_vector
from undeadzone.util.files import read_text, require_schema, unreadable_file, write_text
from undeadzone.util.own_files import mark_toml
from undeadzone.util.toml import OptionTable, require_short_keys

Matrix = list[list[float]]

TOLERANCE = 1e-6  # relative, by which a file's margin may differ from the recomputed one
STATED = (
    "read from a file, not recomputed: K, rate, disturbance, mismatch, noise, never, states, "
    "identifiable, and the gains of the front; undeadzone check judges them on a scenario"
)
UNITS: Final = {
    "rate": "1/s",
    "disturbance": "rms error per white disturbance",
    "mismatch": "per relative model error",
    "noise": "per rms noise",
}


class Point(OptionTable, frozen=True, kw_only=True):
    """Certified gains and their scores, see `synthesis.task.Scores`.

    Attributes:
        L: observer gains (n x p) [1/s].
        gamma: adaptation gains (p) [1/s].
        rate: at which the error dies along the reference [1/s].
        disturbance: rms of the errors (C x~, d~) over the reference [unit of z] per unit of white
            input disturbance, 1 per root second on every input.
        mismatch: the same per unit of relative error in every entry of A and B that is not
            kinematic, independent.
        noise: the same per unit of rms noise on z at every sample.
    """

    L: Matrix
    gamma: list[float]
    rate: float
    disturbance: float
    mismatch: float
    noise: float


class Design(OptionTable, frozen=True, kw_only=True):
    """Gains for a model A, B, C, and the proof P, W that V never rises.

    Attributes:
        title: of the scenario.
        chosen: how the gains were chosen: rate, knee, or the weights.
        seed: of the search.
        Ts: sample time [s] (A and B are then of one step). None: continuous time.
        A, B, C: the model (n x n, n x m, p x n).
        K: the state feedback that the gains were planned with (m x n).
        P, W: of the proof: weight of the state errors (n x n), weights of the outputs (p).
        margin: of the proof.
        frequency: frequency of that margin [rad/s] (None if there is no single one).
        never: errors that no gains can remove.
        states: which states the readings determine (n).
        remarks: results that are missing (`load` adds those that it could not recompute).
        best: the chosen gains and their scores.
        present: the scenario's own gains, if they are certified.
        identifiable: results of the readings, per output.
        front: the trade between rate and errors, by falling rate.
        schema: number of the meanings that the names in it have (docs/json.md).
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
    schema: int | None = None

    @property
    def model(self) -> Matrices:
        """Return A, B, C as arrays."""
        n = len(self.A)
        return Matrices(
            require_matrix("A", self.A, n, n),
            require_matrix("B", self.B, n),
            require_matrix("C", self.C, None, n),
        )

    @property
    def L(self) -> Floats:
        """Return the observer gains (n x p) [1/s]."""
        return require_matrix("best.L", self.best.L, len(self.A), len(self.C))

    @property
    def gamma(self) -> Floats:
        """Return the adaptation gains (p) [1/s]."""
        return require_vector("best.gamma", self.best.gamma, len(self.C))

    def require_proof(self, model: Matrices, Ts: float | None, what: str) -> None:
        """Prove the gains again for a model from P and W, by eigenvalues alone.

        Args:
            model: A, B, C that the gains are to be used with (of one step if sampled).
            Ts: its sample time [s] (None in continuous time).
            what: name of the caller that needs the proof, first in the error's message.

        Raises:
            ProofError: if the proof does not hold, or the model has another size.
        """
        n = len(self.A)
        p = len(self.C)
        if model.C.shape != (p, n):
            raise ProofError(
                f"{what}: the design is for {n} states and {p} outputs, "
                f"the model has {model.C.shape[1]} and {model.C.shape[0]}"
            )
        errors = build_error_dynamics(model, self.L, self.gamma, Ts)
        proof = recheck_proof(
            errors, require_matrix("P", self.P, n, n), require_vector("W", self.W, p)
        )
        if not proof.proved:
            raise ProofError(
                f"{what}: its proof does not hold (greatest eigenvalue of the inequality "
                f"{proof.lmi:.3g}, least of P {proof.P:.3g}, not negative and positive). "
                "The file was changed, or made for another model or sample time. Design again"
            )

    def blocks(self) -> list[shown.Block]:
        """Return the gains, their proof and their trade-off as a table."""
        return [describe_design(msgspec.to_builtins(self))]

    __repr__ = shown.format_result
    _repr_html_ = shown.result_to_html

    plot = shown.plot
    """Draw it."""

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the design as TOML, every number exactly.

        Args:
            path: of the file.

        Returns:
            The path.

        Raises:
            FileError: if it cannot be written.
        """
        return write_text(mark_toml(toml.to_toml(self)), path)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Design:
        """Read a design and prove it again: all that follows from A, B, C is recomputed.

        The proof, its margin and frequency, and whether `present` is certified, are recomputed.
        What depends on the reference cannot be: `remarks` then names it.

        Args:
            path: of the file.

        Returns:
            The design, its proof checked for its own model.

        Raises:
            FileError: if it cannot be read or is not a design.
            ShapeError: if a matrix has the wrong shape.
            ProofError: if the proof does not hold for its own model.
        """
        try:
            design = msgspec.convert(tomllib.loads(require_short_keys(read_text(path))), cls)
        except OSError as error:
            raise unreadable_file(path, error) from None
        except (ValueError, RecursionError, msgspec.ValidationError):
            # Nothing of it is quoted: a scenario may name a file that is not its author's.
            raise FileError(
                f"{path}: not a design saved by undeadzone. Write it with undeadzone design"
            ) from None
        require_schema(design.schema, path)
        return _recompute_design(design, str(path))


def _recompute_design(design: Design, path: str) -> Design:
    """Return a design with all results that its file allows to recompute. Remarks name the
    rest.

    Raises:
        InputError: for an invalid sample time.
        ProofError: if its proof, its margin or the certificate of `present` does not hold.
    """
    if design.Ts is not None and not 0 < design.Ts < np.inf:
        raise InputError(f"{path}: Ts: expected a sample time above 0 s, found {design.Ts:g}")
    design.require_proof(design.model, design.Ts, path)
    n = len(design.A)
    p = len(design.C)
    errors = build_error_dynamics(design.model, design.L, design.gamma, design.Ts)
    margin, frequency = margin_of_dynamics(errors, require_vector("W", design.W, p))
    if not abs(design.margin - margin) <= TOLERANCE * max(1.0, abs(margin)):
        raise ProofError(
            f"{path}: margin: {design.margin:.6g} in the file, its gains have {margin:.6g}. "
            "The file was changed, design again"
        )
    _require_sizes(design, n, p)
    present = design.present
    if present is not None:
        gains = (
            require_matrix("present.L", present.L, n, p),
            require_vector("present.gamma", present.gamma, p),
        )
        if not certify(design.model, *gains, design.Ts).certified:
            raise ProofError(
                f"{path}: present: the file lists these gains as certified, they are not. "
                "The file was changed, design again"
            )
    remarks = [remark for remark in design.remarks if remark != STATED]
    return msgspec.structs.replace(
        design, margin=margin, frequency=frequency, remarks=[*remarks, STATED]
    )


def _require_sizes(design: Design, n: int, p: int) -> None:
    """Raise ShapeError if an entry of the file does not fit n states and p outputs."""
    require_matrix("K", design.K, design.model.B.shape[1], n)
    stated = {"states": (len(design.states), n), "identifiable": (len(design.identifiable), p)}
    for key, (length, expected) in stated.items():
        if length != expected:
            raise ShapeError(f"{key}: expected {expected} entries, found {length}")
    for i, point in enumerate(design.front):
        require_matrix(f"front[{i}].L", point.L, n, p)
        require_vector(f"front[{i}].gamma", point.gamma, p)


class Knowledge(OptionTable, frozen=True, kw_only=True):
    """Identifiability of the dead zone of a single output, as stored in a file.

    Attributes:
        right, left: whether they determine d_r, d_l.
        width, centre: whether they determine d_r + d_l, (d_r - d_l)/2.
        reasons: why not, for each 'no'.
        cures: what would turn a 'no' into a 'yes'.
        std: expected standard deviation of each, by its name [unit of z].
        second: another truth with the same readings (None: none far from it, or not looked for).
        crossings: strikes at the ends of a gap of gears that show (None: there are no gears).
        narrowed: as of `WidthIdentifiability`, of a run.
    """

    right: bool
    left: bool
    width: bool
    centre: bool
    reasons: list[str]
    cures: list[str]
    std: dict[str, float]
    second: dict[str, Any] | None = None
    crossings: int | None = None
    narrowed: bool = False


def describe_design(design: Mapping[str, Any]) -> dict[str, Any]:
    """Describe the gains of a design, their proof and their trade-off.

    Args:
        design: the fields of a `Design`, as its file has them.
    """
    best = design["best"]
    summary: dict[str, Any] = {
        "scenario": design["title"],
        "chosen": f"{design['chosen']}, seed {design['seed']}",
        "L": format_gains(best["L"]),
        "gamma": format_gains(best["gamma"]),
        "certified": describe_margin(design["margin"], design["frequency"]),
        "rate": f"{best['rate']:.4g} 1/s along the reference",
        "proof P": list(map(format_gains, design["P"])),
        "proof W": format_gains(design["W"]),
        "trade": _describe_trade_off(best, design["present"]),
    }
    if design["remarks"]:
        summary["remark"] = design["remarks"]
    return summary


def describe_margin(margin: float, frequency: float | None) -> str:
    """Describe the margin of a proof and the frequency of that margin [rad/s]."""
    where = "for large frequencies"
    if frequency is not None and math.isfinite(frequency):
        where = f"at {frequency:.4g} rad/s"
    return f"yes, margin {margin:.4g} {where}: V never rises, on any side"


def format_gains(gains: list[Any]) -> str:
    """Format gains as in a scenario, to six digits.

    One column is written as a plain list, one number as itself.
    """
    words = []
    for row in gains:
        if not isinstance(row, list):
            words.append(f"{row:.6g}")
        elif len(row) == 1 and not isinstance(row[0], list):
            words.append(f"{row[0]:.6g}")
        else:
            words.append(format_gains(row))
    single = len(words) == 1 and not isinstance(gains[0], list)
    return words[0] if single else f"[{', '.join(words)}]"


def _describe_trade_off(best: Mapping[str, Any], present: Mapping[str, Any] | None) -> list[str]:
    """Describe the scores of the gains beside the scores of the present gains, if known."""
    lines = []
    for name, unit in UNITS.items():
        words = f"{name} {best[name]:.4g} {unit}"
        if present is not None:
            words += f"; yours {present[name]:.4g}"
        lines.append(words)
    return lines
