"""Gap of a joint's gears by a whole log, which is replayed with each gap that was declared.

A strike that hides in noise and unknown torque says nothing alone. Many say something together: the
readings of a motor are foretold with each of `GAPS` gaps, and the squares of what was foretold
wrongly are compared, window by window. If two gaps foretell equally well, the sum of the windows'
differences over the root of the sum of their squares is a normal deviate, whatever the model has
wrong in a window. That is Vuong's test of two models. Its square stands in place of twice the log
odds.

References:
    Q. H. Vuong (1989), doi:10.2307/1912557
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from scipy.signal import savgol_filter

from undeadzone.analysis.identifiability.flanks import (
    MotorFilter,
    StrikeDetector,
    link_inertias,
    motor_filter,
    torques_along_path,
)
from undeadzone.plants.robots.geared import Geared
from undeadzone.util.arrays import Floats

GAPS = 31  # with which a log is replayed
SUBSTEPS = 4  # of a sample
SMOOTHED = 13  # samples, over which the readings of a motor are a parabola
WINDOW = 0.05  # [s]; half and twice as long windows narrow as many gaps of the ten robots
LEAST = 1e-5  # half of the narrowest gap [rad]
ROUNDING = 1e-5  # of a sum of squared differences: of gaps that foretell the same
BEGINS = 0.2  # [s] in which the filters begin


def replay_gap(
    gears: Geared,
    params: Floats,
    i: int,
    log: tuple[Floats, Floats, Floats],
    detector: StrikeDetector,
    limits: tuple[Floats, float],
    step: float,
) -> tuple[float, float]:
    """Return mean and standard deviation of a joint's gap by the readings of its motor [rad].

    Its link moves by its motor, as it was read, and by the load on its planned path. All other
    links follow theirs.

    Args:
        gears: the model.
        params: its parameters.
        i: the joint.
        log: readings of the motors [rad] and their torques [N m] (N x joints each), and positions,
            speeds and accelerations of the joints as planned (N x 3 x joints).
        detector: whose filter foretells the readings.
        limits: declared range of half the gap (2) [rad], and the standard deviation of friction
            over its mean (1).
        step: between two rows [s].
    """
    y = log[0][:, i]
    u = log[1][:, i]
    v, a = log[2][:, 1:, i].T
    centre, J, friction, viscous, rubs = (
        float(gears.gear_number(params, name)[i])
        for name in ("centre", "inertia", "friction", "viscous", "f")
    )
    turned = savgol_filter(y, SMOOTHED, 2, 0, step)
    omega = savgol_filter(y, SMOOTHED, 2, 1, step)
    needed = torques_along_path(gears, params, log[2])[:, i]
    link = link_inertias(gears, params, log[2][:, 0])[:, i]
    # A link that gets what it needs follows its path, but for its friction, which turns with it.
    pull = link * a - needed + rubs * _slide(gears, v)
    lost = friction * _slide(gears, omega)
    spun = (u - lost - viscous * omega) / J
    rows = np.stack(
        [
            turned + centre,  # motor, from the middle of the gap [rad]
            omega,
            link,  # inertia [kg m^2]
            pull,  # torque at the link [N m]
            y,
            spun,  # acceleration of the motor without its link [rad/s^2]
            limits[1] * lost / J,  # that by a deviation of friction
        ]
    )
    declared = np.linspace(limits[0][0], limits[0][1], GAPS)
    gap = np.append(np.fmax(declared, LEAST), LEAST)  # the last column is friction's
    told = np.append(np.ones(GAPS), 0.0)
    place = rows[0, 0] - np.sign(needed[0]) * gap
    speed = np.full_like(gap, v[0])
    heard = np.outer([y[0], omega[0], 0.0], told)
    first = np.column_stack([place, speed, *heard])
    K, D = (float(each[i]) for each in gears.contact_stiffness(params))
    listener = motor_filter(J, detector.torque[i], detector.noise[i], detector, step)
    sample = _build_sample(gears, (gap, told, J, K, D, rubs), listener, step)
    count = len(y) - 1
    wrong = sample.mapaccum(count)(first, rows[:, :-1], rows[:2, 1:])[1]
    return weigh_gaps(np.asarray(wrong).T / listener.std, 2 * gap[:-1], round(WINDOW / step))


def _build_sample(
    gears: Geared,
    numbers: tuple[Floats, Floats, float, float, float, float],
    listener: MotorFilter,
    step: float,
) -> ca.Function:
    """Return the sample of a replay: link and filter with each gap, from one reading to the next.

    Args:
        gears: the model.
        numbers: halves of the gaps [rad], whether each one has a link (both gaps + 1), inertia of
            the motor [kg m^2], stiffness [N m/rad] and damping [N m s/rad] of the contact, friction
            of the link [N m].
        listener: filter of the motor.
        step: between two readings [s].
    """
    gap, told, J, K, D, rubs = numbers
    h = step / SUBSTEPS
    s = ca.SX.sym("s", gap.size, 5)
    before = ca.SX.sym("before", 7)
    after = ca.SX.sym("after", 2)
    _, _, m, given, read, rate, by_friction = ca.vertsplit(before)
    angle = s[:, 0]
    speed = s[:, 1]
    torque = 0.0
    for part in (np.arange(SUBSTEPS) + 1) / SUBSTEPS:
        motor, turning = ca.vertsplit(before[:2] + part * (after - before[:2]))
        xi = motor - angle
        closed = ca.fabs(xi) > gap
        pressed = closed * (K * (xi - ca.sign(xi) * gap) + D * turning)
        stiff = closed * (D + h * K)
        free = given - rubs * _slide(gears, speed)
        speed = (m * speed + h * (free + pressed)) / (m + h * stiff)
        angle += h * speed
        torque += (pressed - stiff * speed) / SUBSTEPS
    e = told * read - s[:, 2]
    driven = told * (rate - torque / J) + (1 - told) * by_friction
    heard = (s[:, 2:] + e @ listener.gain[None]) @ listener.A.T
    heard += driven @ np.array([[step**2 / 2, step, 0.0]])
    return ca.Function("sample", [s, before, after], [ca.horzcat(angle, speed, heard), e])


def _slide(gears: Geared, speed: Any) -> Any:
    """Return Coulomb's friction at speeds, over its level."""
    return speed / (speed**2 + gears.rest**2) ** 0.5


def weigh_gaps(wrong: Floats, gap: Floats, window: int) -> tuple[float, float]:
    """Return mean and standard deviation of a gap by what was foretold wrongly [rad].

    Args:
        wrong: errors over their deviations with each gap, and their change by a deviation of
            friction (N x (gaps + 1)).
        gap: the gaps [rad].
        window: in samples.
    """
    told = wrong[:, :-1]
    by_friction = wrong[:, -1]
    fitted = by_friction @ told / (1 + by_friction @ by_friction)
    told = told - np.outer(by_friction, fitted)
    count = len(wrong) // window - round(BEGINS / WINDOW)
    sums = (told[-count * window :] ** 2).reshape(count, window, gap.size).sum(axis=1)
    more = sums - sums[:, [sums.sum(axis=0).argmin()]]
    power = np.fmax((more**2).sum(axis=0), ROUNDING)
    weight = np.exp(-(more.sum(axis=0) ** 2) / power / 2)
    weight /= weight.sum()
    mean = weight @ gap
    between = (gap[1] - gap[0]) ** 2 / 12  # two gaps of the grid
    variance = weight @ (gap - mean) ** 2 + between
    return float(mean), float(np.sqrt(variance))
