"""Edges of the dead zone that a schedule does not reach: why not, and what would reach them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.analysis.side_schedule import Schedule

RARE = 0.1  # share of exact readings beyond the edges, below which a verdict says so
MARGIN = 0.05  # by which a cure passes an edge, relative to the edge


class Cure(NamedTuple):
    """The smallest change of the reference that makes an output reach its edges.

    Attributes:
        output: which output.
        factor: by which its deviation from its mean grows; None if that is not the cure.
        shift: what is added to it; None if that is not the cure.
        text: the cure in words; alone where no reference helps.
    """

    output: int
    factor: float | None
    shift: float | None
    text: str


def unreached(schedule: Schedule, visited: np.ndarray, i: int) -> list[str]:
    """Why edges of output i are not visited, in words; nothing for an edge that is.

    Args:
        schedule: of the sides.
        visited: whether each [right, left] side is visited (p x 2).
        i: the output.
    """
    right, left = schedule.levels[i]
    high, low = schedule.high[i], schedule.low[i]
    reasons = []
    if not visited[i, 0]:
        stays = f"stays below d_r, {high:.4g} against {right:.4g}" if right - high >= 0 else ""
        reasons.append(_unreached("right", "d_r", stays))
    if not visited[i, 1]:
        stays = f"stays above -d_l, {low:.4g} against {-left:.4g}" if left + low >= 0 else ""
        reasons.append(_unreached("left", "-d_l", stays))
    return reasons


def rarely_exact(schedule: Schedule, i: int) -> list[str]:
    """That most readings of output i beyond its edges are at a limit of the range, in words."""
    share = 1.0 if schedule.exact is None else float(schedule.exact[i])
    if share >= RARE:
        return []
    if share == 0:
        return ["no reading beyond the edges is exact: all are at a limit of sensor.range"]
    return [
        f"only {100 * share:.2g} % of the readings beyond the edges are exact: the others are at a "
        "limit of sensor.range, where they only bound z"
    ]


def _unreached(name: str, edge: str, stays: str) -> str:
    """Why an edge is not visited; stays: where the output stays instead, empty if it passes it."""
    if stays:
        return f"the {name} edge is never reached: the output {stays}"
    return (
        f"the {name} edge is hardly reached: "
        f"too few readings arrive from beyond {edge} to tell it from the state"
    )


def largest_deviations(right: float, left: float, swing: float) -> dict[str, float]:
    """The largest deviation with which each of `DIRECTIONS` counts as known: that of its own size.

    Args:
        right, left: widths of the output [z].
        swing: of the output, which counts where the widths are 0 [z].
    """
    both = right + left
    sizes = {"right": right, "left": left, "width": both, "centre": both}
    return {name: float(size) or swing for name, size in sizes.items()}


def vague(std: dict[str, float], most: dict[str, float], right: float, left: float) -> list[str]:
    """Why widths are not known although readings tell them: deviations that exceed `most`.

    Args:
        std: expected deviations by name [z].
        most: the largest ones, of `largest_deviations` [z].
        right, left: widths of the output [z].
    """
    larger = []
    for name, limit in most.items():
        if limit < std[name] < np.inf:
            larger.append(f"{name} {std[name]:.3g}")
    if not larger:
        return []
    return [
        "practically not: noise and disturbances leave larger deviations than the widths "
        f"({right:.3g}, {left:.3g}) to {', '.join(larger)}"
    ]


def reaching(schedule: Schedule, i: int) -> Cure:
    """The smallest change of output i that reaches both of its edges, with a margin."""
    right, left = schedule.levels[i] * (1 + MARGIN)
    low, mean, high = schedule.low[i], schedule.mean[i], schedule.high[i]
    mean = 0.0 if abs(mean) <= 1e-9 * (high - low) else mean
    if high - low <= 1e-9 * max(abs(high), abs(low), right, left):
        swing = max(right - mean, mean + left)
        text = f"let output {i} move: a swing of {swing:.4g} about {mean:.4g} reaches both edges"
        return Cure(i, None, None, text)
    factor = max((right - mean) / (high - mean), (mean + left) / (mean - low), 1.0)
    shift = max(right - high, 0.0) - max(low + left, 0.0)
    by_factor = (factor - 1) * max(high - mean, mean - low)  # how far the factor moves the output
    if high - low >= right + left and abs(shift) < by_factor * (1 - 1e-9):
        return Cure(i, None, shift, f"shift output {i} by {shift:.4g}: it then reaches both edges")
    text = (
        f"make the swing of output {i} about its mean, {mean:.4g}, {factor:.4g} times as large: "
        "it then reaches both edges"
    )
    return Cure(i, factor, None, text)
