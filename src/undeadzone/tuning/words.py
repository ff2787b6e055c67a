"""What tuning found, in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from undeadzone.results.sheet import number


def in_words(summary: Mapping[str, Any]) -> dict[str, Any]:
    """What tuning found, by what it is about.

    Args:
        summary: of a `Tuned`.
    """
    shown: dict[str, Any] = {
        "scenario": summary["titles"][0],
        "made small": (
            f"{summary['statistic']} of {summary['metric']}, {summary['runs']} runs, "
            f"{summary['evaluations']} candidates of {summary['budget']}"
        ),
    }
    for parameter in summary["parameters"]:
        name = parameter["name"]
        shown[name] = f"{parameter['value']:.6g} (from {parameter['start']:.6g})"
        if name in summary["at_edge"]:
            shown[name] += ", at the end of its range: a wider one may do better"
    shown |= _gained(summary)
    if summary["margin"] is not None:
        yes_no = "yes" if summary["certified"] else "NO"
        shown["certified"] = f"{yes_no}, margin {summary['margin']:.4g}"
    return shown


def _gained(summary: Mapping[str, Any]) -> dict[str, str]:
    """What tuning gained, on the runs tuned on and on those held out."""
    held_out, tuning = summary["held_out"], summary["tuning"]
    first = held_out["scenarios"][0]
    before, after, runs = first["before"], first["after"], first["runs"]
    drawn = f"{runs} runs" if runs > 1 else "one run: nothing differs between them"
    verdict = "better" if summary["improved"] else "NO improvement that chance could not explain"
    costs = [number(tuning[name], none="?") for name in ("before", "after")]
    shown = {
        "runs tuned on": " -> ".join(costs),
        "held-out runs": f"{_interval(before['value'])} -> {_interval(after['value'])}, {drawn}",
        "change": f"{_interval(held_out['change'])}: {verdict}",
    }
    lost = before["diverged"]["value"], after["diverged"]["value"]
    if any(lost):
        shown["diverged"] = f"{100 * lost[0]:.3g} % -> {100 * lost[1]:.3g} % of the held-out runs"
    return shown


def _interval(interval: Mapping[str, float | None]) -> str:
    """A value and its interval, an end of which may be unknown."""
    value, low, high = (number(interval[name], none="?") for name in ("value", "low", "high"))
    return f"{value} ({low} to {high})"
