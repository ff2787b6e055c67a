"""When an uncertain position reaches an edge for the first time, and what is known where it does.

A position that is watched sample by sample stays short of an edge for as long as nothing is heard.
To cut the belief at the edge in every sample is wrong: each cut takes a tail from what is cut
already, so that it narrows as if every sample were news. The belief of one that has not arrived is
therefore left uncut, F_k is the chance beyond the edge under it, and of what has not arrived

    (F_k - F_(k-1)) / (1 - F_(k-1))

arrives in sample k: exact where the motion up to the edge is known, whatever the belief.
"""

from __future__ import annotations

import math
from typing import Any

import casadi as ca

from undeadzone.numerics.gaussian import Gaussian, update_unless_glitch

LEAST = 1e-9  # least chance of what has not arrived


def beyond(belief: Gaussian, h: Any, excess: Any) -> Any:
    """The chance that excess + h (x - x^) > 0.

    Args:
        belief: of x (N).
        h: row of the edge (1 x N).
        excess: by which the mean x^ lies beyond it.
    """
    std = ca.sqrt(ca.fmax(h @ belief.cov @ h.T, 0.0) + LEAST**2)
    return (1 + ca.erf(excess / std / math.sqrt(2))) / 2


def arriving(before: Any, now: Any) -> Any:
    """The share of what has not reached an edge that does so in a sample, between 0 and 1.

    Args:
        before, now: chances beyond the edge under the uncut belief, a sample ago and now.
    """
    return ca.fmax(now - before, 0.0) / ca.fmax(1 - before, LEAST)


def at_edge(belief: Gaussian, h: Any, excess: Any, R: Any) -> Gaussian:
    """The belief of what has just arrived: excess + h (x - x^) + v = 0.

    Args:
        belief: of x (N), uncut.
        h: row of the edge (1 x N).
        excess: by which the mean x^ lies beyond it.
        R: variance of v.
    """
    return update_unless_glitch(belief, h, -excess, R, 1.0, None, 0.0).belief
