"""What most recorded runs do over time: quantiles of tracking and width errors at each instant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from undeadzone.scenario.address import matching
from undeadzone.support.arrays import Floats

LEVELS: Final = (0.01, 0.05, 0.5, 0.95, 0.99)
EDGES: Final = ("right", "left")


class Bands(NamedTuple):
    """Quantiles of the recorded runs over time, by name; i is the output.

    Attributes:
        t: instants (N) [s]
        quantiles: N x len(LEVELS) each: of |z - r| as `tracking[i]`, of the errors d^ - d of the
            widths as `d_right[i]` and `d_left[i]`
    """

    t: Floats
    quantiles: dict[str, Floats]


def bands(
    t: Floats, z: Floats, r: Floats, d_hat: Floats, widths: Floats, tracked: Sequence[int]
) -> Bands:
    """The bands of recorded runs.

    A signal that is no number any more counts as infinitely far off, so that a band is one of all
    runs.

    Args:
        t: instants (N) [s]
        z: outputs (lanes x N x p)
        r: references (lanes x N x k)
        d_hat: estimated widths (lanes x N x 2p), right and left of each output in turn
        widths: true widths (lanes x 2p) in the same order
        tracked: the outputs that follow the k references
    """
    errors = {}
    for k, i in enumerate(tracked):
        errors[f"tracking[{i}]"] = np.abs(z[:, :, i] - r[:, :, k])
    for j in range(d_hat.shape[2]):
        name = f"d_{EDGES[j % 2]}[{j // 2}]"
        errors[name] = d_hat[:, :, j] - widths[:, None, j]
    return Bands(t, {name: _quantiles(error) for name, error in errors.items()})


def true_width(name: str, nominal: float, varied: Mapping[str, Floats]) -> Floats:
    """The true width of an edge in each run: a number, or a column (runs) where it varies.

    Args:
        name: the edge, such as `right[0]`
        nominal: its width in the scenario
        varied: columns by the names of `uncertain.UncertainNumber`, in whatever words they name the
            edge
    """
    for words, column in varied.items():
        address = words.removesuffix(" (relative)")
        if any(matching(part, [f"sensor.{name}"]) for part in address.split(" + ")):
            relative = address != words
            return column * nominal if relative else column
    return np.asarray(nominal)


def _quantiles(values: Floats) -> Floats:
    """The quantiles at each instant (N x levels) of values (lanes x N).

    Each is the value of a run: nothing is interpolated between a number and infinity.
    """
    bounded = np.where(np.isnan(values), np.inf, values)
    return np.quantile(bounded, LEVELS, axis=0, method="inverted_cdf").T
