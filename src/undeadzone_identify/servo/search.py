"""Search of the servo structure: from runs without a gap to the likeliest parameters.

Runs between two reversals know of no gap, so they come first: z is forgotten at every reversal, and
plant, friction and delay are climbed to from many starts. With a strong torque each tick forgets
the ticks before it, so that the top is broad; then the torque is left free. Each reversal then has
a gap of its own, whose median starts the climbs with a gap. Parts of the servo are added and taken
away as long as BIC gets better.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
from scipy.signal import lfilter, ss2tf

from undeadzone.util.arrays import Floats, shift_rows
from undeadzone_identify.servo.crossings import find_crossings
from undeadzone_identify.servo.likelihood import (
    PARTS,
    At,
    Servo,
    ServoLikelihood,
    ServoStructure,
    discretise_servo,
)
from undeadzone_identify.servo.observations import (
    REACH,
    Observations,
    reading_noise_rms,
    to_schmitt_ticks,
)

MOST = 3000  # samples of a search
TURNS = 4  # reversals of a search, at least
POLES = 5  # rates of damping where climbs begin
SPRINGS = (0.1, 3.0)  # in squared rates of damping
FRICTIONS = (0.02, 0.15)  # rms of the input
DELAYS = (0.5, 3.0)  # samples
TORQUES = (0.3, 0.05)  # rms of the input
RUBBING = ServoStructure(frozenset({"friction", "spring"}))
EXCHANGED = (0.95, 0.5, -0.5)  # share of a gap that may be friction's; below 0 of a friction
# steps of climbs
FIRST = 4
THEN = 6
LAST = 12
BEAM = 4  # climbs of a structure that go on
ROUNDS = 4  # in which parts are added or taken away
WINDOWS = 60  # over which motion is compared
MEMORY = 0.5  # least gap, in quanta, where climbs begin
ALTERNATIVES = 6  # structures that are climbed with all samples
REACHED = 30.0  # of BIC, within which a structure may be the true one


def search_servos(log: Observations) -> list[Servo]:
    """Search the likeliest structures within `REACHED` of BIC, best first, on all samples.

    Args:
        log: as the predictor hears it.

    Returns:
        Servos climbed to their top; nothing if no start leads anywhere.
    """
    ticked = log if log.ticks else to_schmitt_ticks(log)
    begun = fit_without_gap(ticked.busiest_part(MOST, TURNS))
    if not begun:
        return []
    fits = fit_with_gap(
        log.busiest_part(MOST, TURNS), [_set_median_gap(log, ticked, one) for one in begun]
    )
    if not fits:
        return []
    likelihood = ServoLikelihood(log)
    tops = likelihood.maximise_from_starts(fits, 3 * LAST)
    exchanged = exchange_gap_and_friction(min(tops, key=likelihood.bic))
    exchanged = likelihood.maximise_from_starts(exchanged, 3 * LAST, (At.TORQUE,))
    tops += likelihood.maximise_from_starts(exchanged, 3 * LAST)
    return _likely_structures(likelihood, tops)


# --- Without a gap


def fit_without_gap(log: Observations) -> list[Servo]:
    """Fit a few structures that assume no gap; return the best servos, best first."""
    likelihood = ServoLikelihood(log, free=True)
    if likelihood.used.size < 3 * len(At):
        return []
    tops = likelihood.maximise_from_starts(initial_servos(log), FIRST, (At.TORQUE,))
    tops = _best_of_structures(tops, BEAM)
    weaker = [one.replace_number(At.TORQUE, math.log(TORQUES[-1])) for one in tops]
    tops += likelihood.maximise_from_starts(weaker, THEN, (At.TORQUE,))
    tops = likelihood.maximise_from_starts(tops, LAST)
    return sorted(_best_of_structures(tops, 2), key=likelihood.bic)


def _best_of_structures(tops: Sequence[Servo], count: int = 1) -> list[Servo]:
    """Return the likeliest servos of each structure."""
    found: list[Servo] = []
    for one in sorted(tops, key=lambda top: -top.value):
        same = [other for other in found if other.structure == one.structure]
        if math.isfinite(one.value) and len(same) < count:
            found.append(one)
    return found


def _likely_structures(likelihood: ServoLikelihood, tops: Sequence[Servo]) -> list[Servo]:
    """Return the likeliest servo of each structure within `REACHED` of BIC, best first."""
    ranked = sorted(_best_of_structures(tops), key=likelihood.bic)
    return [one for one in ranked if likelihood.bic(one) <= likelihood.bic(ranked[0]) + REACHED]


def initial_servos(log: Observations) -> list[Servo]:
    """Return the start points of fits without a gap; gains follow from the motion over
    windows.
    """
    span = log.u.size * log.step
    rates = np.geomspace(max(0.5, 4 / span), min(0.5 / log.step, 150.0), POLES)
    found = []
    motor = ServoStructure(frozenset({"friction"}))
    for rate, late in itertools.product(rates, DELAYS):
        for friction, share in zip(FRICTIONS, SPRINGS, strict=True):
            found.append(_initial_servo(log, motor, rate, 0.0, friction, late))
            found.append(_initial_servo(log, RUBBING, rate, share * rate**2, FRICTIONS[0], late))
    lagging = ServoStructure(frozenset(), lag=True)
    return found + [_initial_servo(log, lagging, rate, 0.0, 0.0, DELAYS[0]) for rate in rates]


def _initial_servo(
    log: Observations,
    structure: ServoStructure,
    rate: float,
    spring: float,
    friction: float,
    late: float,
) -> Servo:
    """Return a start point with the gain that suits its other parameters."""
    theta = structure.disable_absent_parts(np.zeros(len(At)))
    theta[At.DAMPING] = math.log(rate)
    theta[At.GAIN] = 1.0
    if spring:
        theta[At.SPRING] = math.log(spring)
    theta[At.GAP] = max(MEMORY * log.quantum, 1e-6)
    theta[At.TORQUE] = math.log(TORQUES[0])
    theta[At.DELAY] = late
    z = _frictionless_output(log, theta, structure.lag)
    wide = max(5, log.u.size // WINDOWS)
    moved = np.column_stack([np.diff(z[::wide]), np.ones(z[::wide].size - 1)])
    gain = np.linalg.lstsq(moved, np.diff(log.y[::wide]), rcond=None)[0][0]
    theta[At.GAIN] = gain if abs(gain) > 1e-9 else 1.0
    theta[At.FRICTION] = friction
    return Servo(structure, theta)


def _frictionless_output(log: Observations, theta: Floats, lag: bool) -> Floats:
    """Return z of a servo without friction (N)."""
    A, B, _ = discretise_servo(theta[None], log.step, lag)
    numerator, denominator = ss2tf(A[0, :2, :2], B[0, :2, :1], [[1.0, 0.0]], [[0.0]])
    late = shift_rows(log.u, 1 + round(theta[At.DELAY]), log.start)
    return lfilter(numerator[0, 1:], denominator, late)


# --- The gap


def _set_median_gap(log: Observations, ticked: Observations, one: Servo) -> Servo:
    """Return a servo with the median gap of its reversals."""
    gap = find_crossings(ticked, one, free=True).median_gap / ticked.y_scale
    if log.ticks:
        return one.replace_number(At.GAP, max(gap, MEMORY * log.quantum, 1e-4))
    rms = reading_noise_rms(log)
    return one.replace_number(At.GAP, max(gap - 2 * REACH * rms, rms)).replace_number(
        At.NOISE, math.log(rms)
    )


def fit_with_gap(log: Observations, begun: Sequence[Servo]) -> list[Servo]:
    """Fit structures with a gap; return the likeliest within `REACHED` of BIC, best first.

    Args:
        log: as the predictor hears it, or a part.
        begun: where climbs begin.
    """
    likelihood = ServoLikelihood(log)
    first = [
        one.replace_number(At.TORQUE, math.log(x)) for one, x in itertools.product(begun, TORQUES)
    ]
    first = likelihood.maximise_from_starts(first, THEN, (At.TORQUE,))
    fits = _best_of_structures(likelihood.maximise_from_starts(first, LAST))
    for _ in range(ROUNDS):
        if not fits:
            return []
        best = min(fits, key=likelihood.bic)
        own, known = best.structure, {one.structure for one in fits}
        trials = neighbour_servos(best, log.step)
        trials = [x for x in trials if x.structure not in known or x.structure.parts < own.parts]
        more = likelihood.maximise_from_starts(trials, THEN, (At.TORQUE,))
        fits = _best_of_structures(fits + likelihood.maximise_from_starts(more, LAST))
        if min(fits, key=likelihood.bic).structure == own:
            break
    return _likely_structures(likelihood, fits)[:ALTERNATIVES]


def neighbour_servos(one: Servo, step: float) -> list[Servo]:
    """Return the start points of servos with a part added or removed."""
    found = []
    for name, place in PARTS.items():
        if one.structure.lag and name in ("friction", "load", "spring"):
            continue
        structure = one.structure._replace(parts=one.structure.parts ^ {name})
        numbers = [one.theta] if name in one.structure.parts else []
        if numbers and name == "pole":
            numbers.append(_exchange_pole(one.theta, step))
        for value in [] if numbers else _part_start_values(name, one, step):
            more = one.replace_number(place, value).theta
            if name == "load":  # of what rubbed at the motor
                more[At.FRICTION] = max(more[At.FRICTION] - value, 0.0)
            if name == "pole":  # what a pole is late
                more[At.DELAY] = max(more[At.DELAY] - math.exp(-value) / step, 0.0)
            numbers.append(more)
        every = list(map(structure.disable_absent_parts, numbers))
        found += [Servo(structure, theta) for theta in every]
    return found


def exchange_gap_and_friction(one: Servo) -> list[Servo]:
    """Return the start points of a servo with a spring that exchange gap for friction.

    In slow motion against a spring friction loses 2 f g / k at each reversal, as a gap does. So a
    climb may end with all of it in one of them, and slow torques take the rest. They have neither
    these nor a pole.

    Args:
        one: a servo; nothing if it has no spring.
    """
    if one.structure.lag or "spring" not in one.structure.parts:
        return []
    gap, friction = one.theta[At.GAP], one.theta[At.FRICTION]
    to_level = math.exp(one.theta[At.SPRING]) / (2 * abs(float(one.theta[At.GAIN])) + 1e-300)
    found = []
    for share in EXCHANGED:
        theta = RUBBING.disable_absent_parts(one.theta)
        moved = share * gap if share > 0 else share * friction / to_level
        theta[At.FRICTION] += to_level * moved
        theta[At.GAP] -= moved
        found.append(Servo(RUBBING, theta))
    return found


def _exchange_pole(theta: Floats, step: float) -> Floats:
    """Return the parameters of a motor whose damping is the old pole; the rest is a delay."""
    own = theta.copy()
    own[At.DAMPING] = np.logaddexp(theta[At.POLE], theta[At.SPRING] - theta[At.DAMPING])
    slower = theta[At.POLE] - theta[At.DAMPING]
    own[At.GAIN] *= math.exp(slower)
    own[At.SPRING] += slower
    own[At.DELAY] += math.exp(-theta[At.DAMPING]) / step
    return own


def _part_start_values(name: str, one: Servo, step: float) -> list[float]:
    """Return the start values of an added part, each of them the start of a climb.

    A climb reaches the nearest top of the likelihood alone, so the values are spread over what the
    part can be beside the servo's present numbers. Friction is a share of the input's rms. A spring
    counts in squared rates of damping: with 1e-3 it acts slower than the log shows, with 3 the
    servo swings. A pole lies between ten samples and one, beyond which it is a delay. A slow torque
    is a share of the input's rms.
    """
    rubs = np.array([0.003, 0.02, 0.1])
    values = {
        "friction": rubs,
        "load": rubs,
        "spring": 2 * one.theta[At.DAMPING] + np.log([1e-3, *SPRINGS]),
        "pole": np.log(np.array([0.1, 0.3, 0.8]) / step),
        "slow": np.log([0.03, 0.2]),
    }
    return values[name].tolist()
