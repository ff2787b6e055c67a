"""A run in words: errors, estimates, proof, and what its readings can tell."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from undeadzone.analysis.identifiability.words import yes_no
from undeadzone.simulation.listening_words import in_words as listening_in_words
from undeadzone.simulation.run_info import Info
from undeadzone.support.text import with_deviation


def in_words(info: Info, summary: Mapping[str, Any], last: float) -> dict[str, Any]:
    """What a run came to, by what it is about.

    Args:
        info: of the run.
        summary: of the run.
        last: time over which errors are measured, at the end [s].
    """
    shown = _errors(info, summary, last) | _proof(summary) | _identifiable(info)
    if summary["diverged_at"] is not None:
        shown["DIVERGED"] = f"at {summary['diverged_at']:g} s"
    elif summary["inexact"]:
        share = info.integration_share
        assert share is not None
        shown["NOT EXACT"] = (
            f"half the step changes the run by {100 * share:.3g} % of the largest |z|: these are "
            "no results; use a smaller simulation.step"
        )
    return shown


def _errors(info: Info, summary: Mapping[str, Any], last: float) -> dict[str, Any]:
    """The errors of a run, its estimates and how often it was silent."""
    unit, when = info.units.output, f"(last {last:g} s)"
    shown: dict[str, Any] = {
        "scenario": info.title,
        "observer": f"{info.method}, {info.time} time, step {info.step:g} s",
        "rms z - r": f"{_number(summary['rms_tracking'])} {unit} {when}",
        "rms z - z^": f"{_number(summary['rms_estimation'])} {unit} {when}",
    }
    if summary.get("rms_tip") is not None:
        shown["rms tip"] = f"{summary['rms_tip']:.4g} m from its path {when}"
    shown["d_right"] = _widths(summary, "d_right", info.widths[0::2])
    shown["d_left"] = _widths(summary, "d_left", info.widths[1::2])
    for name, parameter in summary.get("parameters", {}).items():
        estimate, std, true = (parameter[key] for key in ("estimate", "std", "true"))
        shown[name] = f"{with_deviation(estimate, std)} (true {true:g})"
    quiet = "holding" if info.sensor == "play" else "silent"
    shown[quiet] = f"{100 * summary['silent_fraction']:.1f} % of the time"
    if info.listens:
        shown["listens"] = listening_in_words(info.listens)
    return shown


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


def _identifiable(info: Info) -> dict[str, Any]:
    """What the readings of a run tell of each output's widths."""
    shown: dict[str, Any] = {}
    several = len(info.identifiable) > 1
    for i, verdict in enumerate(info.identifiable):
        output = info.joints[i] if len(info.joints) == len(info.identifiable) else f"output {i}"
        where = f" of {output}" if several else ""
        shown[f"identifiable{where}"] = "; ".join([yes_no(verdict), *verdict["reasons"]])
    return shown


def _widths(summary: Mapping[str, Any], key: str, true: list[float]) -> str:
    """The final estimates of one edge of each output, with deviations where known, and the truth.

    Args:
        summary: of the run.
        key: d_right or d_left.
        true: the true widths (p).
    """
    widths, truth = _listed(summary[key]), ", ".join(f"{width:.6g}" for width in true)
    if summary[f"{key}_std"] is None:
        return f"{', '.join(_number(width, '.6g') for width in widths)} (true {truth})"
    stds = _listed(summary[f"{key}_std"])
    return f"{', '.join(map(with_deviation, widths, stds))} (true {truth})"


def _listed(value: Any) -> list[Any]:
    """The numbers of all outputs, which are no list where there is one."""
    return value if isinstance(value, list) else [value]


def _number(value: float | None, form: str = ".4g") -> str:
    """A number; nan where there is none."""
    return "nan" if value is None else format(value, form)
