"""A run in words: errors, estimates, proof, and what its readings can tell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from undeadzone.analysis.identifiability.linear import DIRECTIONS
from undeadzone.analysis.identifiability.words import yes_no
from undeadzone.results.gap_words import in_words as gaps_in_words
from undeadzone.results.info import Info
from undeadzone.results.listening_words import in_words as listening_in_words
from undeadzone.support.shown import Block, Rows
from undeadzone.support.text import label, with_deviation, with_unit


class Errors(NamedTuple):
    """Errors of one output over the end of a run.

    Attributes:
        tracking: rms of z - r; None where the output is not tracked.
        estimation: rms of z - z^.
    """

    tracking: float | None
    estimation: float


def in_words(
    info: Info, summary: Mapping[str, Any], outputs: Mapping[str, Errors], last: float
) -> list[Block]:
    """What a run came to: pairs, and of several outputs a table with their rows.

    Args:
        info: of the run.
        summary: of the run.
        outputs: errors of each output by its name.
        last: time over which errors are measured, at the end [s].
    """
    single = len(outputs) == 1
    shown = _errors(info, summary, last, single) | _proof(summary) | _identifiable(info, outputs)
    if summary["diverged_at"] is not None:
        shown["DIVERGED"] = f"at {summary['diverged_at']:g} s"
    elif summary["inexact"]:
        share = info.integration_share
        assert share is not None
        shown["NOT EXACT"] = (
            f"half the step changes the run by {100 * share:.3g} % of the largest |z|: these are "
            "no results; use a smaller simulation.step"
        )
    return [shown] if single else [shown, _rows(info, summary, outputs)]


def _errors(info: Info, summary: Mapping[str, Any], last: float, single: bool) -> dict[str, Any]:
    """The errors of a run, its estimates and how often it was silent; single: has one output."""
    when = f"(last {last:g} s)"
    shown: dict[str, Any] = {
        "scenario": info.title,
        "observer": f"{info.method}, {info.time} time, step {info.step:g} s",
    }
    for name, key in (("rms z - r", "rms_tracking"), ("rms z - z^", "rms_estimation")):
        shown[name] = f"{with_unit(_number(summary[key]), info.units.output)} {when}"
    if "rms_behind_play" in summary:
        behind = with_unit(_number(summary["rms_behind_play"]), info.units.output)
        shown["rms y/m - r"] = f"{behind} {when}"
    if summary.get("rms_tip") is not None:
        shown["rms tip"] = f"{summary['rms_tip']:.4g} m from its path {when}"
    if single:
        shown |= _widths(summary, ("d_right", "d_left"), info.widths, info.units.output)
    if len(info.actuator) == 2 and "b_right" in summary:
        shown |= _widths(summary, ("b_right", "b_left"), info.actuator, info.units.input)
    if single and "gap_std" in summary:
        shown |= gaps_in_words(summary, info.units.output, info.gaps)
    for name, parameter in summary.get("parameters", {}).items():
        estimate, std, true = (parameter[key] for key in ("estimate", "std", "true"))
        shown[name] = f"{with_deviation(estimate, std)} (true {true:g})"
    quiet = "holding" if info.sensor == "play" else "silent"
    shown[quiet] = f"{100 * summary['silent_fraction']:.1f} % of the time"
    if info.listens:
        shown["listens"] = listening_in_words(info.listens)
    return shown


def _widths(
    summary: Mapping[str, Any], keys: tuple[str, str], true: Sequence[float], unit: str
) -> dict[str, str]:
    """The final widths of one dead zone beside the true ones."""
    shown = {}
    for key, width in zip(keys, true, strict=True):
        found = _width(summary[key], summary[f"{key}_std"])
        shown[key] = f"{with_unit(found, unit)} (true {width:.6g})"
    return shown


def _rows(info: Info, summary: Mapping[str, Any], outputs: Mapping[str, Errors]) -> Rows:
    """A row for each output: its errors, widths, and what its readings tell."""
    unit = info.units.output
    heads = [label(name, unit) for name in ("rms z - r", "rms z - z^", "d_right", "d_left")]
    what = "joint" if info.joints and list(info.joints) == list(outputs) else "output"
    rows: list[Sequence[str]] = [(what, *heads[:3], "true", heads[3], "true", "identifiable")]
    for i, (name, errors) in enumerate(outputs.items()):
        tracking = "" if errors.tracking is None else f"{errors.tracking:.4g}"
        widths: list[str] = []
        for key, true in (("d_right", info.widths[2 * i]), ("d_left", info.widths[2 * i + 1])):
            std = summary[f"{key}_std"]
            widths += [_width(summary[key][i], None if std is None else std[i]), f"{true:.6g}"]
        verdict = info.identifiable[i]
        told = "yes" if all(verdict[each] for each in DIRECTIONS) else yes_no(verdict)
        rows.append((name, tracking, f"{errors.estimation:.4g}", *widths, told))
    return rows


def _proof(summary: Mapping[str, Any]) -> dict[str, Any]:
    """What is proved of a run, and how exactly it was integrated."""
    shown: dict[str, Any] = {}
    certified, rise = summary["certified"], summary["largest_rise_of_V"]
    if certified is False:
        shown["certificate"] = "none found for these gains; undeadzone check says why"
    elif certified:
        words = "holds for an exact model without noise or disturbance"
        if rise is not None:
            words += f"; along this run V rose by at most {rise:.1g} of its peak"
        shown["certificate"] = words
    error = summary["integration_error"]
    if error is not None:
        shown["integration"] = f"error {error:.2g} (against half the step)"
    return shown


def _identifiable(info: Info, outputs: Mapping[str, Errors]) -> dict[str, Any]:
    """What the readings tell of the widths of one output; of several, why not all of them."""
    if len(outputs) == 1:
        verdict = info.identifiable[0]
        return {"identifiable": "; ".join([yes_no(verdict), *verdict["reasons"]])}
    why = []
    for name, verdict in zip(outputs, info.identifiable, strict=True):
        why += [f"{name}: {reason}" for reason in verdict["reasons"]]
    return {"why": why} if why else {}


def _width(value: float | None, std: float | None) -> str:
    """The final estimate of an edge, with its deviation where known."""
    return _number(value, ".6g") if std is None else with_deviation(value, std)


def _number(value: float | None, form: str = ".4g") -> str:
    """A number; nan where there is none."""
    return "nan" if value is None else format(value, form)
