"""How far z can move from one reading to the next: what comes out of silence beyond that is wrong.

The mathematics is in docs/filters.md, "Readings that are wrong".
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.interfaces import Reading
from undeadzone.numerics.gaussian import linearise
from undeadzone.observers.parts.gaussian_filter import Params, motion
from undeadzone.observers.parts.measured_reading import Heard
from undeadzone.observers.parts.shown_belief import Setup
from undeadzone.observers.parts.smoothing import slope_at
from undeadzone.observers.parts.unknown_actuator import entering
from undeadzone.sensor import LEFT, RIGHT


class Pace(NamedTuple):
    """What is kept of how z moves; empty where nobody asks.

    Attributes:
        ahead: by how much z moves until the next reading (p) [z].
        variance: of that (p) [z^2].
        since: steps since z was last inside of an edge, right edges, then left ones (2p); 0 where
            it was beyond it at the last reading that was believed.
    """

    ahead: Any
    variance: Any
    since: Any


def resting(setup: Setup) -> Pace:
    """Nothing is known of z so far."""
    p = setup.model.p if setup.paced else 0
    return Pace(np.zeros(p), np.zeros(p), np.zeros(2 * p))


def surprise(setup: Setup, q: Params, pace: Pace, y: Any, side: Any, R: Any) -> list[Any]:
    """Log of the density of each reading given the silence before it, over that without (p).

    z was inside of the edge since[] steps ago, by a reading within the gate, and moved by so many
    times what it moves in a step. A reading beyond that needs a motion as many deviations off; or
    the silence was fake.

    Args:
        setup: the filter.
        q: its numbers.
        pace: of z.
        y: reading, 0 where it is missing (p) [y].
        side: the sides that are sure (p).
        R: variances of the readings (p) [z^2].
    """
    p = setup.model.p
    if not setup.paced:
        return [0.0] * p
    each = []
    for i in range(p):
        steps = ca.if_else(side[i] > 0, pace.since[i], pace.since[p + i])
        gone = side[i] * (y[i] / q.slope[i] - steps * pace.ahead[i])
        over = ca.fmax(gone - q.gate[i] / q.slope[i], 0.0)
        off = over**2 / (steps**2 * pace.variance[i] + R[i])
        each.append(ca.if_else(steps > 0, ca.fmax(-off / 2, q.doubt.fake), 0.0))
    return each


def moved_on(
    setup: Setup, q: Params, pace: Pace, heard: Heard, u: Any, side: Any, reading: Reading
) -> Pace:
    """The pace at the next reading.

    Args:
        setup: the filter.
        q: its numbers.
        pace: at this one.
        heard: what is known after this one.
        u: the input from now on (m).
        side: the sides on which readings were used (p).
        reading: what was read.
    """
    if not setup.paced:
        return pace
    belief, n = heard.belief, setup.model.n
    drive, doubt = entering(q.zones, belief, u)
    change, Q = motion(setup.model, q, setup.augmentation, belief, drive, doubt)
    E = slope_at(setup, q, belief, u)
    _, h = linearise(lambda X: setup.model.output(q.model, X[:n]), belief.mean)
    believed = heard.trust > 0.5
    since = []
    for k, edge in enumerate((RIGHT, LEFT)):
        before, silence = ca.vertsplit(pace.since, setup.model.p)[k], heard.silence[k]
        across = ca.logic_and(side == -edge, believed)
        beyond = ca.logic_or(ca.logic_and(side == edge, believed), reading.side == 2 * edge)
        later = ca.if_else(ca.logic_or(before == 0, beyond), 0.0, before + 1)
        since.append(ca.if_else(ca.logic_or(silence, across), 1.0, later))
    return Pace(
        ahead=h @ change(belief.mean),
        variance=ca.fmax(ca.diag(h @ (E @ belief.cov @ E.T + Q) @ h.T), 0.0),
        since=ca.vertcat(*since),
    )
