"""Interface between a filter and a smoother of a whole log: moments of each sample and display.

A filter is a bank of members, one at least, whose beliefs a smoother improves one by one. The
mathematics is in docs/filter_extensions.md, "Smoothing".
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from undeadzone.interfaces import Estimate, Reading
from undeadzone.numerics.gaussian import Gaussian


class Moments(NamedTuple):
    """Moments of `[x; d; extra]` (N) at a sample, by a member of a filter.

    Attributes:
        before: mean and covariance before the reading.
        read: after the readings on sure sides.
        bounded: also after the bounds of censored samples and limits.
        rows: rows of the readings, which have moved `before` to `read` along cov rows' (p x N).
        edges: rows of the edges, likewise (2p x N).
        slope: I + slope is the Jacobian of the motion to the next sample (N x N).
        log: log of the density with which the readings were foretold.
        restarted: 1 if the estimate was lost, so that the next one is the prior.
        doubted: by how much a deviation of each doubt about the sensor's shape moves the mean
            before the reading, and after it (2 of N x their number).
    """

    before: Gaussian
    read: Gaussian
    bounded: Gaussian
    rows: Any
    edges: Any
    slope: Any
    log: Any
    restarted: Any
    doubted: tuple[Any, Any]


class Smoothing(NamedTuple):
    """Functions of a filter for a smoother.

    Attributes:
        moments: moments(q, s, u, reading) are the `Moments` of its members.
        odds: odds(s) is the log of the odds of its members before a sample (K).
        record: record(s) is the record for tests of its innovations (empty for a member).
        mixture_estimate: mixture_estimate(q, beliefs, wide, share, record) is the estimate from the
            beliefs of its members, as likely as `share` (K), with covariances that the sensor's
            shape adds to each (empty: none).
    """

    moments: Callable[[Any, Any, Any, Reading], tuple[Moments, ...]]
    odds: Callable[[Any], Any]
    record: Callable[[Any], Any]
    mixture_estimate: Callable[[Any, Sequence[Gaussian], Sequence[Any], Any, Any], Estimate]
