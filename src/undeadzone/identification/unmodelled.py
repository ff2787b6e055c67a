"""What a linear plant behind a zone does not hold, by name: a spring that bends, an offset."""

from __future__ import annotations

import math

import numpy as np
from scipy.signal import lfilter

from undeadzone.identification.fit import Fit
from undeadzone.identification.long_run import long_run_covariance, quantile
from undeadzone.identification.orders import innovations
from undeadzone.identification.residual_map import explained
from undeadzone.identification.verdict import Verdict
from undeadzone.support.arrays import Floats

SHARE, CHANCE = 0.03, 1e-3  # of the one-step residual, and p, from which a spring is named
WELL_INSIDE = 2.0  # rms of the noise between z^ and an edge
SURE = 0.999  # level of the interval of an offset that must not hold 0
RELEVANT = 0.1  # of the residual's rms, below which an offset is no matter


def unmodelled(verdict: Verdict, fit: Fit) -> Verdict:
    """The verdict dead_zone or other, with what the model lacks.

    Args:
        verdict: so far.
        fit: plant and zone.

    Returns:
        `other` where the readings inside the zone lie about another value than 0; a caution where
        the plant's stiffness depends on z.
    """
    offset = offset_inside(fit)
    if offset is not None:
        value = offset * fit.objective.data.y_scale
        reason = (
            f"the readings inside the zone lie about {value:.4g}, not 0: a constant offset behind"
            f" the zone; take it away by --zero {value:.4g}"
        )
        return Verdict("other", [reason], [])
    if verdict.word == "other":
        return verdict
    share, chance, slope = cubic_share(fit)
    if share > SHARE and chance < CHANCE:
        how = "stiffer" if slope < 0 else "softer"
        caution = (
            f"the cube of z^ as a force explains {100 * share:.0f} % of the one-step residual: the"
            f" plant is weakly nonlinear, {how} far from 0; its resonance depends on the amplitude,"
            " and the widths may be off by more than their intervals"
        )
        return Verdict(verdict.word, verdict.reasons, [*verdict.cautions, caution])
    return verdict


def offset_inside(fit: Fit) -> float | None:
    """The mean reading well inside the zone, scaled; None where it is 0 or cannot be told.

    Args:
        fit: plant and zone; with noise behind the zone, else silence is exactly 0.
    """
    if fit.objective.kind != "behind":
        return None
    z, margin = fit.z, WELL_INSIDE * fit.s
    inside = fit.objective.readings.ok & (z < fit.right - margin) & (z > -fit.left + margin)
    y = fit.objective.data.y[inside]
    if y.size < 50:
        return None
    mean = float(y.mean())
    covariance, degrees = long_run_covariance((y - mean)[:, None])
    half = quantile(degrees, SURE) * math.sqrt(float(covariance[0, 0])) / y.size
    return mean if abs(mean) > max(half, RELEVANT * fit.s) else None


def cubic_share(fit: Fit) -> tuple[float, float, float]:
    """How much of the one-step residual a cubic spring explains.

    To first order a spring kappa z^3 beside the input changes z by -kappa G z^3, with G the plant
    from its first input. What changes of the plant's own numbers could do is taken out first.

    Args:
        fit: plant and zone.

    Returns:
        The share, p, and the coefficient of G z^3: negative for a spring that gets stiffer.
    """
    objective = fit.objective
    value, use = innovations(fit, objective.data.ok)
    slope = objective.simulator.gradient(fit.theta, fit.z)[:, objective.free]
    side = objective.data.side
    columns = np.column_stack([slope, 1.0 * (side > 0), -1.0 * (side < 0), _cube(fit)])
    whitened = columns.copy()
    whitened[1:] -= fit.rho * columns[:-1]
    rows = whitened[use]
    if len(rows) < 10 * columns.shape[1]:
        return 0.0, 1.0, 0.0
    others, cube = rows[:, :-1], rows[:, -1]
    cube = cube - others @ np.linalg.lstsq(others, cube, rcond=1e-10)[0]
    coefficients, _, share, chance = explained(cube[:, None], value[use])
    return share, chance, float(coefficients[0])


def _cube(fit: Fit) -> Floats:
    """G z^3 along the records (N)."""
    layout = fit.objective.layout
    denominator = np.append(1.0, layout.denominator(fit.theta[layout.a]))
    numerator = np.append(0.0, fit.theta[layout.b][: layout.n])
    out = np.empty(fit.z.size)
    for part in fit.objective.data.records():
        out[part] = lfilter(numerator, denominator, fit.z[part] ** 3)
    return out
