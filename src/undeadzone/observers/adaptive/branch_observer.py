"""Observer with the innovation formed on the measured branch.

`certified` adapts the widths. With gamma = 0 and the true widths it is `oracle`.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.interfaces import Estimate, Observer, Reading, Traits, build_estimate
from undeadzone.nonlinearities.sensor import Zone, offset, present
from undeadzone.numerics.clip import clip
from undeadzone.observers.adaptive.adaptation_laws import GRADIENT, AdaptationLaw, BranchWidths
from undeadzone.observers.filtering.motion_detection import add_motion_detection
from undeadzone.observers.filtering.prior import silence_gate
from undeadzone.plants.system import System
from undeadzone.util.arrays import Floats


class Params(NamedTuple):
    """Parameters of the observer. L and gamma are per step if the model is sampled.

    Attributes:
        model: numbers of the model.
        L: gain of the innovation (n x p).
        gamma: adaptation gain (p).
        x0: x^ at first (n).
        right0, left0: widths at first (p) [z].
        limit: upper bound d_M of the widths (p) [z].
        slope: slope m of the sensor (p).
        threshold: |y| that counts as silent (p) [y] (of a play, how far a held reading may be off).
        law: numbers of the adaptation law.
    """

    model: Any
    L: Floats
    gamma: Floats
    x0: Floats
    right0: Floats
    left0: Floats
    limit: Floats
    slope: Floats
    threshold: Floats
    law: Any


class State(NamedTuple):
    """State: x^, the widths d_r^, d_l^, and their gains if the adaptation law changes gains."""

    x: Any
    right: Any
    left: Any
    right_gain: Any
    left_gain: Any


class Setup(NamedTuple):
    """Options shared by the functions of an observer.

    Attributes:
        model: the model.
        kind: kind of the sensor.
        ends: whether the readings have a range, whose limits bound z.
        silence: whether it uses that a silent sensor bounds z.
        law: the adaptation law.
    """

    model: System
    kind: str
    ends: bool
    silence: bool
    law: AdaptationLaw


class WidthDrive(NamedTuple):
    """Drive of the widths of a branch, and 1 if they are adapted (p)."""

    drive: Any
    adapted: Any


class Correction(NamedTuple):
    """Innovation of a reading, and the drives of the widths.

    Attributes:
        e: innovation (p).
        right, left: of the widths.
    """

    e: Any
    right: WidthDrive
    left: WidthDrive


def build_branch_observer(
    model: System,
    sensor: Zone,
    L: Floats,
    gamma: Floats,
    start: Floats,
    widths: Floats,
    limit: Floats,
    silence: bool,
    law: AdaptationLaw = GRADIENT,
) -> Observer:
    """Return the observer on the measured branch.

    With gamma = 0 and the true widths it is the known-width oracle.

    Args:
        model: the model, continuous or sampled.
        sensor: the dead zone.
        L: gain of the innovation (n x p) [1/s].
        gamma: adaptation gain (p) [1/s].
        start: x^(0) (n).
        widths: d^(0), [right, left] per output (p x 2) [z].
        limit: upper bound d_M of the widths (p) [z].
        silence: whether it uses that a silent sensor bounds z.
        law: the adaptation law.
    """
    setup = Setup(model, sensor.kind, sensor.limits is not None, silence, law)
    is_play = sensor.kind == "play"
    params = Params(
        model=model.params,
        L=L * model.per_step,
        gamma=gamma * model.per_step,
        x0=start,
        right0=widths[:, 0],
        left0=widths[:, 1],
        limit=limit,
        slope=sensor.slope,
        threshold=silence_gate(sensor, sensor.rms) if is_play else sensor.threshold,
        law=law.numbers,
    )

    def init(p: Params) -> State:
        """Return the state at t = 0."""
        gain = p.gamma if law.gains else np.zeros(0)
        return State(p.x0, p.right0, p.left0, gain, gain)

    traits = Traits(
        L=params.L,
        gamma=params.gamma,
        constant=law.numbers is None,
        width_max=limit,
        adapts=bool(gamma.any()),
        knows_widths=np.array_equal(widths, np.stack([sensor.right, sensor.left], axis=1)),
    )
    step = partial(step_branch_observer, setup)
    project = partial(project_branch_state, law)
    return add_motion_detection(Observer(params, init, step, project, traits), model, sensor)


def project_branch_state(law: AdaptationLaw, p: Params, s: State) -> State:
    """Return the state with widths clipped to [0, d_M], and gains reset if too small."""
    right = clip(s.right, 0.0, p.limit)
    left = clip(s.left, 0.0, p.limit)
    right_gain = law.reset(p.law, s.right_gain, p.gamma)
    left_gain = law.reset(p.law, s.left_gain, p.gamma)
    return State(s.x, right, left, right_gain, left_gain)


def step_branch_observer(
    setup: Setup, p: Params, s: State, u: Any, reading: Reading
) -> tuple[State, Estimate]:
    """Return the state's derivative, or its next value if sampled, and the estimate.

    With the innovation e on the measured branch and the law's factor s in (0, 1] on it,

        x^' = A x^ + B u + L s e,  d^' = law.move(s drive, ...),

    where x^' and d^' are next values if sampled. For a dead zone, drive is -e on the right branch
    and e on the left one. With x^ = x, e is d_r^ - d_r on the right and d_l - d_l^ on the left, so
    that widths approach theirs.

    Args:
        setup: options of the observer.
        p: its parameters.
        s: state.
        u: input (m).
        reading: of the sensor.
    """
    model = setup.model
    law = setup.law
    z = model.output(p.model, s.x)
    y = reading.y / p.slope
    active = reading.side != 0
    beyond_right, beyond_left = zone_violation(setup, p, s, z, reading)
    correct = correct_jump if setup.kind == "jump" else correct_deadzone
    correction = correct(s, z, y, reading.side, beyond_right, beyond_left)
    if setup.ends:
        correction = drop_limit_corrections(correction, reading.side, setup.kind == "jump")
    factor = law.soften(p.law, ca.if_else(active, y, 0.0))

    def width_change(branch: WidthDrive, width: Any, width0: Any, gain: Any) -> tuple[Any, Any]:
        """Return the derivative or next value of a branch's widths, and of their gain (p each)."""
        edge = BranchWidths(factor * branch.drive, branch.adapted, width, width0, gain, p.gamma)
        change, gain = law.move(p.law, edge)
        return model.keep * width + change, gain

    right, right_gain = width_change(correction.right, s.right, p.right0, s.right_gain)
    left, left_gain = width_change(correction.left, s.left, p.left0, s.left_gain)
    x = model.move_with_correction(p.model, s.x, u, p.L @ (factor * correction.e))
    after = State(x, right, left, right_gain, left_gain)
    if model.Ts is not None:
        after = project_branch_state(law, p, after)
    return after, build_estimate(
        s.x, z, s.right, s.left, reading, p.slope, setup.kind, correction.e
    )


def zone_violation(setup: Setup, p: Params, s: State, z: Any, reading: Reading) -> tuple[Any, Any]:
    """Return the excess of z^ over both breakpoints at a sample inside the zone (p each) [z].

    The first is >= 0 (right), the second <= 0 (left). Both are 0 outside the zone.

    A sample inside the zone implies -d_l <= z <= d_r, wider by the threshold. For a play without
    contact z - y / m takes the place of z. If z^ is beyond a breakpoint, it or the width is wrong.
    """
    z = z - reading.level / p.slope
    margin = p.threshold / p.slope
    is_inside = ca.logic_and(reading.side == 0, present(reading.y))
    use = ca.if_else(is_inside, float(setup.silence), 0.0)
    over = use * ca.fmax(z - s.right - margin, 0.0)
    under = use * ca.fmin(z + s.left + margin, 0.0)
    return over, under


def correct_jump(s: State, z: Any, y: Any, side: Any, over: Any, under: Any) -> Correction:
    """Return the correction by a jump sensor's reading y / m = z, a bound on its breakpoint."""
    e = ca.if_else(side != 0, y - z, 0.0)
    right = ca.if_else(side > 0, ca.fmin(y - s.right, 0.0), over)
    left = ca.if_else(side < 0, ca.fmin(-y - s.left, 0.0), -under)
    return Correction(e, WidthDrive(right, right != 0), WidthDrive(left, left != 0))


def correct_deadzone(s: State, z: Any, y: Any, side: Any, over: Any, under: Any) -> Correction:
    """Return the innovation and the drives of both widths for a dead zone's reading (p each).

    Outside the zone the innovation is y - (z - chi_bar d). In the zone it draws z back to the edge
    that z passed, and that edge outwards.

    Args:
        s: state with the widths d_r, d_l.
        z: estimated output (p).
        y: reading over the slope m (p).
        side: of the reading: +1, 0 or -1 (p).
        over, under: by which z lies beyond the right edge (>= 0) and the left one (<= 0) (p).
    """
    e = ca.if_else(side != 0, y - (z - offset(side, s.right, s.left)), -over - under)
    adapt_right = ca.logic_or(side > 0, over > 0)
    adapt_left = ca.logic_or(side < 0, under < 0)
    right = ca.if_else(adapt_right, -e, 0.0)
    left = ca.if_else(adapt_left, e, 0.0)
    return Correction(e, WidthDrive(right, adapt_right), WidthDrive(left, adapt_left))


def drop_limit_corrections(correction: Correction, side: Any, jump: bool) -> Correction:
    """Return the correction without readings at a limit that bound z only.

    At the upper limit the reading is a lower bound of z, so that an innovation below 0 contains no
    information. At the lower limit the signs are reversed. There a jump sensor does not show that z
    is beyond any edge but 0.
    """
    above = ca.logic_and(side > 1, correction.e < 0)
    below = ca.logic_and(side < -1, correction.e > 0)
    is_informative = ca.logic_not(ca.logic_or(above, below))
    adapts = ca.logic_and(is_informative, ca.fabs(side) < 2) if jump else is_informative
    right, left = (
        WidthDrive(ca.if_else(adapts, branch.drive, 0.0), ca.logic_and(adapts, branch.adapted))
        for branch in (correction.right, correction.left)
    )
    return Correction(ca.if_else(is_informative, correction.e, 0.0), right, left)
