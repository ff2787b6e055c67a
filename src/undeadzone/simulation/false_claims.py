"""Claimed ranges that exclude the sensor's own widths: a simulation knows that they are false."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from undeadzone.analysis.identifiability.linear import Verdict
from undeadzone.ends.gaps import gaps_of
from undeadzone.observers.parts.prior import width_ranges
from undeadzone.scenario.problem import Problem

ROUNDING: Final = 1e-9  # share of a gap by which one that is told may miss it


def with_false_claims(problem: Problem, verdicts: Sequence[Verdict]) -> list[Verdict]:
    """The verdicts; a width outside of its claimed range is not known, as no reading corrects it.

    Args:
        problem: the scenario's parts.
        verdicts: on the widths of each output (p).
    """
    options: Any = problem.scenario.observer
    claims = {"right", "left"} <= set(getattr(options, "__struct_fields__", ()))
    if not claims or not problem.observer.traits.adapts:
        return list(verdicts)
    p = len(verdicts)
    ranges = width_ranges(options.right, options.left, p)
    judged = []
    for i, verdict in enumerate(verdicts):
        sides = {
            "right": (problem.sensor.right[i], ranges[i]),
            "left": (problem.sensor.left[i], ranges[p + i]),
        }
        for side, (width, (low, high)) in sides.items():
            if not low <= width <= high:
                reason = (
                    f"a false claim: the {side} width is {width:.4g}, observer.{side} says "
                    f"{low:.4g} to {high:.4g}"
                )
                found: dict[str, Any] = {side: False, "width": False, "centre": False}
                verdict = verdict._replace(**found, reasons=(*verdict.reasons, reason))
        judged.append(_with_false_gaps(problem, verdict, i))
    return judged


def _with_false_gaps(problem: Problem, verdict: Verdict, i: int) -> Verdict:
    """The verdict on output i; no width is known beside a gap that is told wrongly."""
    play, model = problem.sensor.play, problem.scenario.model
    if play is None or model is None or model.play is None:
        return verdict
    p = problem.model.p
    gaps, ranges = gaps_of(model.play, p, "model.play")
    low, high = gaps, gaps
    if ranges is not None:
        low, high = ranges.T.reshape(2, 2, p)
    true = np.stack([play.right, play.left])
    slack = ROUNDING * true
    if ((low - slack <= true) & (true <= high + slack))[:, i].all():
        return verdict
    reason = f"a false claim: model.play excludes the gaps of the sensor, {true[:, i].tolist()}"
    return Verdict(False, False, False, False, (*verdict.reasons, reason), verdict.std)
