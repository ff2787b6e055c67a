"""Further unknowns of a filter that never change: widths of an actuator, friction of a load."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from undeadzone.observers.parts.gaussian_filter import Augmentation
from undeadzone.support.arrays import Floats


def with_constants(inner: Augmentation, variance: Floats) -> Augmentation:
    """The motion with further unknowns of mean 0, the last ones, that never change.

    Its u is what enters the plant.

    Args:
        inner: the motion without them.
        variance: of each of them at first.
    """
    count, known = variance.size, len(inner.cov)
    cov = np.zeros((known + count, known + count))
    cov[:known, :known] = inner.cov
    cov[known:, known:] = np.diag(variance)

    def change(q: Any, x: Any, extra: Any, u: Any) -> tuple[Any, Any]:
        moved, changed = inner.change(q, x, extra[:known, :], u)
        return moved, ca.vertcat(changed, ca.SX(count, 1))

    def noise(q: Any, x: Any, u: Any) -> tuple[Any, Any]:
        of_x, of_extra = inner.noise(q, x, u)
        return of_x, ca.diagcat(of_extra, ca.SX(count, count))

    changes: dict[str, Any] = {}
    if inner.bilinear is not None:
        bend = inner.bilinear
        changes["bilinear"] = lambda q, x, extra, u: bend(q, x, extra[:known, :], u)
    if inner.disturbance is not None:
        pushed = inner.disturbance
        changes["disturbance"] = lambda q, extra: pushed(q, extra[:known, :])
    constants = inner.constants + count
    return inner._replace(cov=cov, change=change, noise=noise, constants=constants, **changes)
