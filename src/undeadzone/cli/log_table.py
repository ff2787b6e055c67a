"""What `watch` and `estimate` print of a log."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from undeadzone.cli.common import Command

if TYPE_CHECKING:
    from undeadzone.simulation.log_info import LogInfo


def strict_option(command: Command) -> Command:
    """Add --strict."""
    return click.option(
        "--strict", is_flag=True, help="Stop at the first line that cannot be read."
    )(command)


def columns_option(command: Command) -> Command:
    """Add --columns."""
    return click.option(
        "--columns",
        default=None,
        metavar="y=NAME,u=NAME",
        help="Columns by name or number: t=1,y=angle,u=voltage; several: y[0]=a,y[1]=b.",
    )(command)


def log_pairs(info: LogInfo) -> dict[str, Any]:
    """The table of a log, for `print_pairs`."""
    from undeadzone.logs.samples import counted_lines

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
    widths = "" if info.adapts else " (not estimated)"
    shown["d_right"] = _width(info, info.d_right, info.d_right_std) + widths
    shown["d_left"] = _width(info, info.d_left, info.d_left_std) + widths
    shown["readings"] = _sides(info)
    shown["consistent"] = _verdict(info)
    if info.remarks:
        shown["remark"] = "; ".join(info.remarks)
    return shown


def exit_code(info: LogInfo) -> int:
    """1 where the record is not consistent, else 0."""
    return 1 if info.consistent is False else 0


def _samples(info: LogInfo) -> str:
    """How many samples there are, and how many of them are missing."""
    text = f"{info.samples} samples, {info.missing} missing"
    if info.gaps:
        text += f" ({info.gaps} in gaps)"
    if info.measured_step is None:
        return text + "; without times the step is taken on trust"
    return text + f", {info.measured_step:g} s apart"


def _width(info: LogInfo, values: list[float], stds: list[float] | None) -> str:
    """The final widths of one edge, with their standard deviations."""
    unit = "" if info.units.output == "1" else f" {info.units.output}"
    texts = []
    for i, value in enumerate(values):
        text = f"{value:.6g}"
        if stds is not None:
            text += f" ± {stds[i]:.2g}"
        texts.append(text)
    return ", ".join(texts) + unit


def _sides(info: LogInfo) -> str:
    """How many readings are on each side of each output."""
    texts = []
    limited = info.limited or [0] * len(info.right)
    for right, left, silent, at in zip(info.right, info.left, info.silent, limited, strict=True):
        text = f"{right} right, {left} left, {silent} silent"
        if info.limited:
            text += f", {at} at a limit"
        never = [name for name, count in (("right", right), ("left", left)) if count == 0]
        if never:
            text += f": the {' and the '.join(never)} edge is never passed"
        texts.append(text)
    return "; ".join(texts)


def _verdict(info: LogInfo) -> str:
    """Whether the record is consistent with what the observer claims, and why not."""
    if info.consistent is None:
        return f"cannot be tested: {'; '.join(info.reasons)}"
    if not info.consistent:
        return "NO: " + "; ".join(info.reasons)
    return f"yes (B = {info.B:.2f}; {info.glitches} of {info.used} readings taken for wrong)"
