"""Result of `estimate`: the estimates of an observer from a log, without true values."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Sequence
from typing import Any, ClassVar, Final

import msgspec

from undeadzone.interfaces import describe_unknowns
from undeadzone.logs.samples import count_in_words
from undeadzone.results import files, sheet
from undeadzone.results.info import LogInfo
from undeadzone.results.sheet import Row
from undeadzone.results.signals import (
    LOG,
    last_values,
    output_names,
)
from undeadzone.util.arrays import to_json_value
from undeadzone.util.shown import Block, Rows
from undeadzone.util.text import label_with_unit


@dataclasses.dataclass(frozen=True, eq=False, init=False, repr=False)
class Estimation(files.SignalResult):
    """Estimates of an observer from a log, one row per sample.

    Each signal is an attribute, None if the method does not estimate it: those of a log, and those
    of observers (`results.signals.ESTIMATED`).

    Attributes:
        t: time (N) [s].
        y: reading (N x p) [y], NaN if it is missing.
        u: input (N x m), NaN if it is missing.
        side: measured side (N x p): +1 right, -1 left, 0 silent or missing, +2, -2 at a limit.
        x_hat: estimate of the state from the readings so far (N x n).
        z_hat: estimate of the true output (N x p) [z].
        d_hat: estimates [d_r^, d_l^] of each output (N x 2p) [z].
        z_inverse: the dead-zone inverse (26) (N x p) [z].
        innovation: what each reading adds to the prediction (N x p).
        info: counts, final widths, and whether the record is consistent.
        signals: all of them by name.
        x_std: standard deviation of x_hat (N x n).
        d_std: standard deviation of d_hat (N x 2p) [z].
        width_std: standard deviation of d_r^ + d_l^ (N x p) [z].
        innovation_std: standard deviation of the innovation (N x p).
        B: statistic of the test of consistency after each sample (N x p).
        w_hat: estimated effects that the observer's model leaves out (N x n), x' = f(x, u) + w.
        theta_hat: parameters of the model that the observer estimates (info.uncertain).
        theta_std: standard deviations of theta_hat.
        claims, suspect: bits of the assumptions that the readings reject, and number of the most
            probable (N x 1).
        c_hat: estimates [c_r^, c_l^] of the play ahead of each dead zone (N x 2p) [z].
        c_std: standard deviation of c_hat (N x 2p) [z].
        gap_std: standard deviation of c_r^ + c_l^ (N x p) [z].
        b_hat, b_std: estimates [b_r^, b_l^] of each actuator, and their deviations (N x 2m) [u].
        x_smooth, z_smooth, d_smooth: as x_hat, z_hat, d_hat, but from the whole log (of `kalman`,
            `censored`, `extended` and `auto`).
        x_smooth_std, d_smooth_std: their standard deviations.

    Example:
        >>> estimation.z_hat.shape == run.z.shape
        True

    See Also:
        estimate, Run
    """

    info: LogInfo

    layout: ClassVar = LOG

    @property
    def consistent(self) -> bool | None:
        """Return whether the innovations fit the assumptions of the observer, or None if that
        cannot be tested.
        """
        return self.info.consistent

    @property
    def outputs(self) -> list[str]:
        """Return the names of the outputs: an arm's joints if the counts agree, else
        numbers.
        """
        return output_names(self.info.joints, self.y.shape[1])

    def summary(self) -> dict[str, Any]:
        """Return the numbers of the log, ready for JSON (lists for several outputs)."""
        numbers = self.info.summary()
        numbers |= last_values(self.signals.arrays, "width_std")
        if found := self.signals.parameters(self.info.uncertain):
            numbers["parameters"] = found
        numbers["smoothed"] = self.z_smooth is not None
        return to_json_value(numbers)

    def blocks(self) -> list[Block]:
        """Return the tables that `undeadzone estimate` prints."""
        return blocks_from_log(self.info)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Estimation:
        """Read estimates saved as `.npz` or `.csv`, exactly as they were.

        Args:
            path: of the file.

        Raises:
            FileError: it cannot be read, or holds no estimates of a log.
        """
        return cls(*files.read_result(path, LOG, LogInfo))


FAULTS: Final = {  # by kind, after a number
    "zero_bytes": "with bytes of 0",
    "too_long": "too long",
    "values": "with too few or many values",
    "number": "with invalid numbers",
    "no_time": "without a time",
    "time": "whose time fits no neighbour",
    "jump": "at which time jumped and the observer began anew",
}


def blocks_from_log(info: LogInfo) -> list[Block]:
    """Return the summary of a log: pairs, and for several outputs a table with their rows."""
    single = len(info.d_right) == 1
    summary: dict[str, Any] = {
        "scenario": info.title,
        "observer": f"{info.method}, step {info.step:g} s",
        "log": _describe_samples(info),
    }
    if info.columns:
        summary["columns"] = info.columns
    if info.unreadable:
        lines = count_in_words(info.unreadable)
        summary["unreadable"] = f"{lines}, counted as missing; {info.why_unreadable}"
    if info.faults:
        summary["faults"] = ", ".join(f"{n} {FAULTS[kind]}" for kind, n in info.faults.items())
    if single:
        estimated = "" if info.adapts else " (not estimated)"
        summary |= sheet.rows_to_text(
            row._replace(note=estimated) for row in log_width_rows(info)[0]
        )
        for rows in [*log_gap_rows(info), *log_actuator_rows(info)]:
            summary |= sheet.rows_to_text(rows)
        summary["readings"] = _describe_branches(info, 0)
    elif not info.adapts:
        summary["widths"] = "not estimated"
    summary["consistent"] = _describe_consistency(info)
    if unknown := describe_unknowns(info.options):
        summary["not told"] = unknown
    if info.remarks:
        summary["remark"] = "; ".join(info.remarks)
    return [summary] if single else [summary, _log_output_rows(info)]


def _log_output_rows(info: LogInfo) -> Rows:
    """Return a row for each output: widths and number of readings per branch."""
    count = len(info.d_right)
    unit = info.units.output
    names = output_names(info.joints, count)
    what = "output" if names[0] == "0" else "joint"
    rows: list[Sequence[str]] = [
        (what, label_with_unit("d_right", unit), label_with_unit("d_left", unit), "readings"),
    ]
    for i, (name, edges) in enumerate(zip(names, log_width_rows(info), strict=True)):
        rows.append(
            (name, *(row.value_with_interval for row in edges), _describe_branches(info, i))
        )
    return rows


def _describe_samples(info: LogInfo) -> str:
    """Return the number of samples and of missing samples, as text."""
    text = f"{info.samples} samples, {info.missing} missing"
    if info.gaps:
        text += f" ({info.gaps} in gaps)"
    if info.measured_step is None:
        return text + ". Without times the step is taken on trust"
    return text + f", {info.measured_step:g} s apart"


def log_width_rows(info: LogInfo) -> list[list[Row]]:
    """Return the final widths of each output."""
    return sheet.build_width_rows(
        msgspec.structs.asdict(info), "d", info.units.output, None, info.ranges
    )


def log_gap_rows(info: LogInfo) -> list[list[Row]]:
    """Return the final gaps of the play ahead of each dead zone, empty if not estimated."""
    return sheet.build_width_rows(info.further, "gap", info.units.output)


def log_actuator_rows(info: LogInfo) -> list[list[Row]]:
    """Return the final widths of each actuator, empty if not estimated."""
    return sheet.build_width_rows(info.further, "b", info.units.input)


def _describe_branches(info: LogInfo, i: int) -> str:
    """Return the number of readings of output i on each branch, as text."""
    right = info.right[i]
    left = info.left[i]
    neither = "in the gap" if info.sensor == "gears" else "silent"
    text = f"{right} right, {left} left, {info.silent[i]} {neither}"
    if info.limited:
        text += f", {info.limited[i]} at a limit"
    sides = (("right", right, info.d_right), ("left", left, info.d_left))
    never = [name for name, count, edge in sides if count == 0 and edge[i] < math.inf]
    return f"{text}: the {' and the '.join(never)} edge is never passed" if never else text


def _describe_consistency(info: LogInfo) -> str:
    """Return whether the record is consistent with the observer's assumptions, with the
    reasons, as text.
    """
    if info.consistent is None:
        return f"cannot be tested: {'; '.join(info.reasons)}"
    if not info.consistent:
        return "NO: " + "; ".join(info.reasons)
    return f"yes (B = {info.B:.2f}; {info.glitches} of {info.used} readings taken for wrong)"
