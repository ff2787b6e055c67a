"""Quantities that vary from run to run, in the terms of a scenario's [ensemble] table.

An entry is an address and a distribution.
"""

from __future__ import annotations

from typing import Final, Literal, NamedTuple

import numpy as np

from undeadzone.errors import InputError
from undeadzone.scenario.address_table import Table
from undeadzone.util.arrays import LARGEST, Floats, require_number
from undeadzone.util.toml import OptionTable

POSITIVE: Final = float(np.finfo(float).tiny)
KINDS: Final = ("uniform", "normal", "log_normal")
REACH: Final = 8.3  # standard deviations; the numbers drawn never lie further out


class Distribution(OptionTable, frozen=True, kw_only=True):
    """Distribution of a number that varies: exactly one of uniform, normal and log_normal.

    A normal distribution is cut off at impossible values, such as a width below 0. The probability
    cut off is spread over the rest.

    Attributes:
        uniform: [low, high].
        normal: [mean, standard deviation].
        log_normal: [median, standard deviation of the logarithm].
        relative: the number drawn is a factor on the nominal value, which must not be 0.
        shared: one draw for all entries that the address names (else a draw for each).
    """

    uniform: tuple[float, float] | None = None
    normal: tuple[float, float] | None = None
    log_normal: tuple[float, float] | None = None
    relative: bool = False
    shared: bool = False


class Vary(OptionTable, frozen=True, kw_only=True):
    """Many runs of the scenario.

    A key in quotes is the address of what varies: `"sensor.right" = { uniform = [0.3, 2.0] }`.
    Addresses are:

    The numbers of the sensor: `sensor.right`, `left`, `slope`, `threshold`, `noise`,
    `noise_before`, `sensor.range[1]`, and `range[0]` by a factor alone (`relative`), with several
    outputs `range[0,1]`. Those of the plant: `plant.A[1,0]`, `B`, `C` in continuous time, in
    whatever form the plant is given, `plant.parameters.NAME`, `plant.x0[0]`. The signals:
    `reference.scale`, a factor on the whole reference, or `reference.amplitude` of a sine, step or
    trapezoid about 0, likewise `disturbance.scale`, `disturbance.amplitude` (a bias is a step at
    time 0), `disturbance.rms`. And the numbers of observer and controller by their names in the
    loop, such as `observer.L[0,0]`, `observer.gamma[0]` [1/s], `controller.K[0,1]`, and
    `observer.model.A[1,0]` for the model of the observer alone.

    Without an index, or with `:` for one, an address names several entries. `+` joins addresses:
    `"plant.A[1,:] + plant.B[1,:]"` with `relative` and `shared` divides the second equation by a
    mass. `sensor` and `plant` are the truth: observer, controller and feedforward stay as designed
    for the nominal plant or [model], sensor and noise. But `oracle` knows the widths,
    `certified` the threshold, and all the range. A width beyond `width_max` is not refused.

    Attributes:
        runs: number of runs.
        sampling: random, latin_hypercube (it depends on the number of runs), sobol (best with a
            power of 2), or saltelli (the design for Sobol indices, whose runs are a multiple of the
            varied entries plus 2).
        seed: seed of the random numbers (default: that of [simulation]).
        tolerance: share of the largest |r| within which z - r has settled [1].
        entries: the distributions, by address. A key with a dot directly in [ensemble] is one of
            them.
    """

    runs: int = 10_000
    sampling: Literal["random", "latin_hypercube", "sobol", "saltelli"] = "random"
    seed: int | None = None
    tolerance: float = 0.02
    entries: dict[str, Distribution] = {}


class ValidatedDistribution(NamedTuple):
    """A distribution that has been checked.

    Attributes:
        kind: uniform, normal or log_normal.
        first, second: the two numbers, as in `Distribution`.
        least: least value, at which a normal distribution is cut off.
    """

    kind: str
    first: float
    second: float
    least: float

    def quantile(self, u: Floats) -> Floats:
        """Return the values below which the shares u, between 0 and 1, of the distribution lie."""
        from scipy.special import ndtr, ndtri

        first = self.first
        second = self.second
        if self.kind == "uniform":
            return first + u * (second - first)
        if self.kind == "log_normal":
            return np.asarray(first * np.exp(second * ndtri(u)))
        below = ndtr((self.least - first) / second) if second > 0 else 0.0
        return np.maximum(first + second * ndtri(below + u * (1 - below)), self.least)


TABLE: Final = Table(
    "ensemble", Distribution, "a distribution", '"sensor.right" = { uniform = [0.3, 2.0] }'
)


def spread(address: str, distribution: Distribution, least: float) -> ValidatedDistribution:
    """Return the distribution of a number, checked.

    Args:
        address: address of the number.
        distribution: the distribution in words.
        least: the least value that the number can have.

    Raises:
        InputError: that names the key.
    """
    kind, first, second = _numbers(address, distribution)
    key = f"{TABLE.entry_name(address)}.{kind}"
    if kind == "uniform" and first > second:
        raise InputError(
            f"{key}: expected [low, high] with low <= high, found [{first:g}, {second:g}]"
        )
    if kind != "uniform" and second < 0:
        raise InputError(f"{key}: the standard deviation must not be negative, found {second:g}")
    if kind == "log_normal":
        _require_range(key, first, second)
    if first < least:
        limit = "must not be negative" if least == 0 else "must be positive"
        what = "low" if kind == "uniform" else "mean"
        raise InputError(f"{key}: this {limit}, found {what} = {first:g}")
    return ValidatedDistribution(kind, first, second, least)


def _numbers(address: str, distribution: Distribution) -> tuple[str, float, float]:
    """Return the kind of a distribution and its two numbers. Raises InputError."""
    key = TABLE.entry_name(address)
    kinds = [kind for kind in KINDS if getattr(distribution, kind) is not None]
    if len(kinds) != 1:
        present = " and ".join(kinds) or "none"
        raise InputError(
            f"{key}: expected exactly one of uniform, normal, log_normal, found {present}"
        )
    (kind,) = kinds
    pair = getattr(distribution, kind)
    if np.shape(pair) != (2,):
        raise InputError(f"{key}.{kind}: expected two numbers, found {pair!r:.60}")
    first, second = (require_number(f"{key}.{kind}[{i}]", number) for i, number in enumerate(pair))
    return kind, first, second


def _require_range(key: str, median: float, deviation: float) -> None:
    """Raise InputError unless a log-normal distribution has values to compute with."""
    if median <= 0:
        raise InputError(
            f"{key}: the median must be positive, found {median:g}. "
            "For a negative number vary a factor on it (relative = true)"
        )
    if np.log(median) + REACH * deviation > np.log(LARGEST):
        raise InputError(
            f"{key}: expected a smaller standard deviation of the logarithm, found {deviation:g}: "
            f"values would exceed {LARGEST:g}"
        )
