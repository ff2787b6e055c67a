"""Where the sensors of an arm should read 0, so that its motion passes both edges of each zone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from undeadzone.analysis.identifiability.edges import MARGIN
from undeadzone.analysis.identifiability.linear import Verdict
from undeadzone.analysis.side_schedule import reading_levels
from undeadzone.scenario.problem import Problem
from undeadzone.support.arrays import Floats


def with_cures(problem: Problem, verdicts: Sequence[Verdict], z: Floats) -> list[Verdict]:
    """The verdicts on an arm, each with a cure where the motion passes one edge or none.

    Args:
        problem: the scenario's parts.
        verdicts: on the widths of each output (p).
        z: the outputs along the run (N x p).
    """
    options = problem.scenario.plant.arm
    if options is None or getattr(options, "measured", "") == "velocity":
        return list(verdicts)
    offset = np.broadcast_to(np.asarray(options.reference, float), z.shape[1])
    levels = reading_levels(problem.sensor)
    cured = []
    for i, verdict in enumerate(verdicts):
        where = "plant.arm.reference" + (f"[{i}]" if z.shape[1] > 1 else "")
        cure = _cure(where, z[:, i], float(offset[i]), *map(float, levels[i]))
        cured.append(verdict._replace(reasons=(*verdict.reasons, *cure)))
    return cured


def _cure(where: str, z: Floats, offset: float, right: float, left: float) -> list[str]:
    """What to do with the position at which a sensor reads 0; nothing where both edges are passed.

    Args:
        where: its key.
        z: the output along the run (N).
        offset: the position.
        right, left: from where on the sensor reads something, its threshold included.
    """
    if not np.isfinite(z).all():
        return []
    least, most = float(z.min()), float(z.max())
    if least < -left and most > right:
        return []
    lowest = least + offset + left * (1 + MARGIN)
    highest = most + offset - right * (1 + MARGIN)
    if lowest < highest:
        return [
            f"{where} = {(lowest + highest) / 2:.4g} would do, as any from {lowest:.4g} to "
            f"{highest:.4g}: there the sensor reads 0, and this motion passes both edges"
        ]
    return [
        f"this motion, {most - least:.3g} wide, is too narrow for both edges of a zone of "
        f"{right + left:.3g}, whatever {where} is: move further"
    ]
