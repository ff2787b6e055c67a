"""What most of the recorded runs do over time: quantiles at each instant of the tracking error and of the errors of the widths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from undeadzone.ensemble.addresses import matching
from undeadzone.support.arrays import Floats

LEVELS: Final = (0.01, 0.05, 0.5, 0.95, 0.99)
EDGES: Final = ("right", "left")


class Bands(NamedTuple):
    """t [s] (N); quantiles: N x len(LEVELS) of |z - r| as `tracking[i]`, of d^ - d as `d_right[i]`, `d_left[i]`, i the output."""

    t: Floats
    quantiles: dict[str, Floats]


def bands(
    t: Floats, z: Floats, r: Floats, d_hat: Floats, widths: Floats, tracked: Sequence[int]
) -> Bands:
    """Of recorded runs: z (lanes x N x p), r (lanes x N x k), d_hat (lanes x N x 2p) against the true widths (lanes x 2p).

    A signal that is no number any more counts as infinitely far off, so that a band is one of all runs.
    """
    found = {f"tracking[{i}]": np.abs(z[:, :, i] - r[:, :, k]) for k, i in enumerate(tracked)}
    found |= {
        f"d_{EDGES[j % 2]}[{j // 2}]": d_hat[:, :, j] - widths[:, None, j]
        for j in range(d_hat.shape[2])
    }
    return Bands(
        t,
        {
            name: _quantiles(np.where(np.isnan(values), np.inf, values))
            for name, values in found.items()
        },
    )


def true_width(name: str, nominal: float, varied: Mapping[str, Floats]) -> Floats:
    """The true width of an edge such as `right[0]`: a number, or a column where it varies, in whatever words (`uncertain.UncertainNumber`)."""
    for words, column in varied.items():
        address = words.removesuffix(" (relative)")
        if any(matching(part, [f"sensor.{name}"]) for part in address.split(" + ")):
            return column * nominal if address != words else column
    return np.asarray(nominal)


def _quantiles(values: Floats) -> Floats:
    """Each quantile is the value of a run: nothing is interpolated between a number and infinity."""
    return np.quantile(values, LEVELS, axis=0, method="inverted_cdf").T
