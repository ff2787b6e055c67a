"""A log that an observer followed, in words: widths, what was missing, the verdict."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from undeadzone.logs.samples import counted_lines
from undeadzone.simulation.gap_words import in_words as gaps_in_words
from undeadzone.simulation.log_info import LogInfo
from undeadzone.simulation.run_columns import output_names
from undeadzone.support.shown import Block, Rows
from undeadzone.support.text import label, with_deviation, with_unit

FAULTS: Final = {  # by kind, after a number
    "zero_bytes": "with bytes of 0",
    "too_long": "too long",
    "values": "with too few or many values",
    "number": "with what is no number",
    "no_time": "without a time",
    "time": "whose time fits no neighbour",
    "jump": "at which time jumped and the observer began anew",
}


def in_words(info: LogInfo) -> list[Block]:
    """What a log comes to: pairs, and of several outputs a table with their rows."""
    single = len(info.d_right) == 1
    shown: dict[str, Any] = {
        "scenario": info.title,
        "observer": f"{info.method}, step {info.step:g} s",
        "log": _samples(info),
    }
    if info.columns:
        shown["columns"] = info.columns
    if info.unreadable:
        lines = counted_lines(info.unreadable)
        shown["unreadable"] = f"{lines}, counted as missing; {info.why_unreadable}"
    if info.faults:
        shown["faults"] = ", ".join(f"{n} {FAULTS[kind]}" for kind, n in info.faults.items())
    if single:
        estimated = "" if info.adapts else " (not estimated)"
        unit = info.units.output
        shown["d_right"] = with_unit(_width(info.d_right, info.d_right_std, 0), unit) + estimated
        shown["d_left"] = with_unit(_width(info.d_left, info.d_left_std, 0), unit) + estimated
        if info.play:
            shown |= gaps_in_words(info.play, unit)
        shown["readings"] = _sides(info, 0)
    elif not info.adapts:
        shown["widths"] = "not estimated"
    shown["consistent"] = _verdict(info)
    if info.remarks:
        shown["remark"] = "; ".join(info.remarks)
    return [shown] if single else [shown, _rows(info)]


def _rows(info: LogInfo) -> Rows:
    """A row for each output: its widths and on which sides its readings are."""
    count, unit = len(info.d_right), info.units.output
    names = output_names(info.joints, count)
    what = "output" if names[0] == "0" else "joint"
    rows: list[Sequence[str]] = [
        (what, label("d_right", unit), label("d_left", unit), "readings"),
    ]
    for i, name in enumerate(names):
        right = _width(info.d_right, info.d_right_std, i)
        left = _width(info.d_left, info.d_left_std, i)
        rows.append((name, right, left, _sides(info, i)))
    return rows


def _samples(info: LogInfo) -> str:
    """How many samples there are, and how many of them are missing."""
    text = f"{info.samples} samples, {info.missing} missing"
    if info.gaps:
        text += f" ({info.gaps} in gaps)"
    if info.measured_step is None:
        return text + "; without times the step is taken on trust"
    return text + f", {info.measured_step:g} s apart"


def _width(values: Sequence[float], stds: Sequence[float] | None, i: int) -> str:
    """The final width of one edge of output i, with its standard deviation where known."""
    return f"{values[i]:.6g}" if stds is None else with_deviation(values[i], stds[i])


def _sides(info: LogInfo, i: int) -> str:
    """How many readings of output i are on each side."""
    right, left = info.right[i], info.left[i]
    text = f"{right} right, {left} left, {info.silent[i]} silent"
    if info.limited:
        text += f", {info.limited[i]} at a limit"
    never = [name for name, count in (("right", right), ("left", left)) if count == 0]
    return f"{text}: the {' and the '.join(never)} edge is never passed" if never else text


def _verdict(info: LogInfo) -> str:
    """Whether the record is consistent with what the observer claims, and why not."""
    if info.consistent is None:
        return f"cannot be tested: {'; '.join(info.reasons)}"
    if not info.consistent:
        return "NO: " + "; ".join(info.reasons)
    return f"yes (B = {info.B:.2f}; {info.glitches} of {info.used} readings taken for wrong)"
