"""The sheet of a log that an observer followed: widths, what was missing, the verdict."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from undeadzone.logs.samples import counted_lines
from undeadzone.results import sheet
from undeadzone.results.info import LogInfo
from undeadzone.results.sheet import Row
from undeadzone.results.signals import output_names
from undeadzone.support.shown import Block, Rows
from undeadzone.support.text import label


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
    if single:
        estimated = "" if info.adapts else " (not estimated)"
        shown |= sheet.in_text(row._replace(note=estimated) for row in widths(info, 0))
        for rows in gaps(info):
            shown |= sheet.in_text(rows)
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
        rows.append((name, *(row.found for row in widths(info, i)), _sides(info, i)))
    return rows


def _samples(info: LogInfo) -> str:
    """How many samples there are, and how many of them are missing."""
    text = f"{info.samples} samples, {info.missing} missing"
    if info.gaps:
        text += f" ({info.gaps} in gaps)"
    if info.measured_step is None:
        return text + "; without times the step is taken on trust"
    return text + f", {info.measured_step:g} s apart"


def widths(info: LogInfo, i: int) -> list[Row]:
    """The final widths of output i."""
    values, stds = (info.d_right[i], info.d_left[i]), None
    if info.d_right_std is not None and info.d_left_std is not None:
        stds = (info.d_right_std[i], info.d_left_std[i])
    return sheet.edges("d", "d", values, stds, info.units.output)


def gaps(info: LogInfo) -> list[list[Row]]:
    """The final gaps of the play ahead of each dead zone; nothing where none are estimated."""
    names = ("gap_right", "gap_left", "gap_right_std", "gap_left_std", "gap_std")
    if not info.play:
        return []
    each = np.array([info.play[name] for name in names], float).reshape(len(names), -1)
    unit = info.units.output
    return [sheet.gaps(one[:2], one[2:4], one[4], unit) for one in each.T.tolist()]


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
