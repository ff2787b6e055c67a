"""Prior of a filter: its assumptions about state, widths and sensor before the first reading."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from undeadzone.errors import InputError, ShapeError
from undeadzone.interfaces import Traits
from undeadzone.linalg.hold import zoh
from undeadzone.nonlinearities.limits import require_pairs
from undeadzone.nonlinearities.play import largest_gap
from undeadzone.nonlinearities.sensor import Zone
from undeadzone.plants.system import System, state_units, time_scale
from undeadzone.util.arrays import (
    Array,
    Floats,
    require_array,
    require_nonnegative,
    require_number,
    require_ranges,
    require_vector,
)
from undeadzone.util.toml import OptionTable

FLOOR = 1e-3  # noise of a sensor without any, in assumed ranges of the widths
SILENT = 4.0  # noise, in its rms, that is surely not beyond it
HOLD = 6.0  # the same for a held play, which affects many readings, hold after hold
REACH = 5.0  # default standard deviation of x(0) as it appears in z, in largest widths


class Prior(NamedTuple):
    """Mean and spread of `[x; d_r; d_l]` (n + 2p) before the first reading.

    The sensor's noise is included.

    Attributes:
        mean: mean of `[x; d_r; d_l]` (n + 2p).
        std: standard deviations of them (n + 2p).
        R: variance of a reading on an active side (p) [z^2].
        gate: |y| that is surely not silent (p) [y].
        drift: variance that the widths gain each step (2p) [z^2].
        worn: the same in squares of a range's extent (0 if a drift is assumed).
        ranges: assumed ranges of all d_r, then of all d_l (2p x 2) [z].
        asymmetry: mean and standard deviation of each d_r - d_l (p x 2) [z] (None: only the
            consequences of the ranges).
        largest: width that the ranges allow, or gap of a play ahead of the zone [z].
        declared: whether a noise is declared (p).
    """

    mean: Floats
    std: Floats
    R: Floats
    gate: Floats
    drift: Floats
    worn: float
    ranges: Floats
    asymmetry: Floats | None = None
    largest: float = 0.0
    declared: Any = True

    def width_moments(self) -> tuple[Floats, Floats]:
        """Return mean (2p) and covariance (2p x 2p) of `[d_r; d_l]`, asymmetry included."""
        n = self.mean.size - len(self.ranges)
        mean = self.mean[n:]
        cov = np.diag(self.std[n:] ** 2)
        if self.asymmetry is None:
            return mean, cov
        p = len(self.asymmetry)
        for i, (assumed, std) in enumerate(self.asymmetry):
            h = np.eye(2 * p)[i] - np.eye(2 * p)[p + i]
            gain = cov @ h / (h @ cov @ h + std**2)
            mean = mean + gain * (assumed - h @ mean)
            cov = cov - np.outer(gain, h @ cov)
        return mean, (cov + cov.T) / 2


def build_prior(
    assumptions: Any,
    model: System,
    sensor: Zone,
    *,
    floor: float = 0.0,
    reach: float = REACH,
    wear: float = 0.0,
    start: Array = 0.0,
    centre: Array | None = None,
    silence: bool = False,
) -> Prior:
    """Return the prior from the assumed ranges [lo, hi] of the widths.

    A width has the mean of its range, and the standard deviation of a uniform distribution over it.
    An edge that does not exist has the other's, as an unknown that no reading concerns.

    Args:
        assumptions: options with right, left (None: those of right), noise (None: the sensor's, but
            at least `floor`, and `FLOOR` for a sensor without noise), x_std (None: the deviation
            that appears as `reach` times the largest width, `state_units`) and drift (None: `wear`
            times the extent of each range in 1 / |pole|, which is 2 / pi quarter periods: a narrow
            range implies that the width stays in it), as of `Assumptions`.
        model: the sampled model.
        sensor: the dead zone.
        floor: least noise, as a share of the assumed range.
        reach: standard deviation of x(0), in largest widths, if none is assumed.
        wear: drift, in extents of the range per 1 / sqrt(|pole|), if none is assumed.
        start: mean of x(0), one number or one per state.
        centre: assumed range of (d_r - d_l)/2, or its value (None: no assumption).
        silence: whether censored samples are used. Then noise ahead of the zone, which never brings
            a reading out of the zone, is not gated: it selected the readings, but the censored
            samples too.

    Raises:
        InputError, ShapeError: for an impossible assumption, or a model in continuous time.
    """
    Ts = require_sample_time(model)
    p = model.p
    ranges = read_width_ranges(assumptions.right, assumptions.left, p)
    absent = sensor.absent.ravel()
    ranges = np.where(absent[:, None], np.roll(ranges, p, axis=0), ranges)
    span = ranges[:, 1] - ranges[:, 0]
    largest = max(ranges[:, 1].max(), largest_gap(sensor.play))
    if assumptions.noise is None:
        rms = sensor.rms
        gate_rms = np.hypot(sensor.noise, sensor.quantum / np.sqrt(12)) / sensor.slope
        least = np.where(rms > 0, floor, max(floor, FLOOR)) * span.reshape(2, p).max(axis=0)
    else:
        rms = gate_rms = _read_noise(assumptions.noise, p)
        least = np.zeros(p)
    if assumptions.x_std is None:
        spread = reach * largest * state_units(model.continuous, Ts)
    else:
        spread = require_nonnegative("observer.x_std", assumptions.x_std, model.n, "one per state")
    drift = assumptions.drift
    worn = 0.0
    if drift is None:
        worn = wear**2 * np.pi / 2 * Ts / time_scale(model.continuous, Ts)
    growth = require_number("observer.drift", 0.0 if drift is None else drift, least=0.0) ** 2 * Ts
    x0 = require_vector("observer.start", start, model.n, "one per state")
    return Prior(
        mean=np.concatenate([x0, ranges.mean(axis=1)]),
        std=np.concatenate([spread, span / np.sqrt(12)]),
        R=np.maximum(rms, least) ** 2,
        gate=silence_gate(sensor, gate_rms if silence else rms),
        drift=growth + worn * span**2,
        worn=worn,
        ranges=ranges,
        asymmetry=None if centre is None else _asymmetries(centre, ranges, p),
        largest=largest,
        declared=rms > 0,
    )


def silence_gate(sensor: Zone, rms: Floats) -> Floats:
    """Return the abs(y) that is surely not silent (p) [y].

    For a backlash: the error bound of a held reading.

    Args:
        sensor: the dead zone.
        rms: of a reading (p) [z].
    """
    noise = rms * sensor.slope
    return HOLD * noise if sensor.kind == "play" else np.maximum(sensor.threshold, SILENT * noise)


def prior_traits(prior: Prior, x_std: Array | None) -> Traits:
    """Return the traits of a filter's prior: a start and asymmetries, if assumed.

    Args:
        prior: of the filter.
        x_std: as assumed (None: a default, which is not an assumption).
    """
    n = prior.mean.size - len(prior.ranges)
    return Traits(
        start_std=None if x_std is None else prior.std[:n],
        centre_std=None if prior.asymmetry is None else prior.asymmetry[:, 1] / 2,
        ranges=prior.ranges,
    )


def _asymmetries(assumed: Array, ranges: Floats, p: int) -> Floats:
    """Return mean and standard deviation of each d_r - d_l (p x 2).

    That is twice the centre, which is assumed. A range stands for the uniform distribution over it.
    Raises InputError, ShapeError.
    """
    value = require_array("observer.centre", assumed)
    if value.ndim == 0:
        value = np.full(2, float(value))
    if value.shape not in ((2,), (p, 2)):
        raise ShapeError(
            "observer.centre: expected the range [lo, hi] of (d_r - d_l)/2, its value, or one "
            f"range per output ({p} x 2), found {' x '.join(map(str, value.shape))}"
        )
    low, high = np.broadcast_to(value, (p, 2)).T
    least = (ranges[:p, 0] - ranges[p:, 1]) / 2
    most = (ranges[:p, 1] - ranges[p:, 0]) / 2
    if (low > high).any() or (high < least).any() or (low > most).any():
        raise InputError(
            "observer.centre: a range [lo, hi] of (d_r - d_l)/2 must have lo <= hi and overlap "
            f"the range of those of d_r and d_l, {least.tolist()} to {most.tolist()}, found "
            f"{value.tolist()}"
        )
    low = 2 * low
    high = 2 * high
    return np.stack([(low + high) / 2, (high - low) / np.sqrt(12)], axis=1)


def _read_noise(noise: Array, p: int) -> Floats:
    """Return the assumed rms of a reading (p) [z]. Raises InputError for 0."""
    rms = require_nonnegative("observer.noise", noise, p, "one per output")
    if not rms.all():
        raise InputError(
            "observer.noise: must be positive, found 0. Leave it out for a sensor without noise"
        )
    return rms


def require_sample_time(model: System) -> float:
    """Return the model's sample time [s]. Raises InputError in continuous time."""
    if model.Ts is None:
        raise InputError(
            'observer: this filter works on samples. Set simulation.time = "sampled" '
            "(simulation.step is the sample time)"
        )
    return model.Ts


def read_width_ranges(right: Array, left: Array | None, p: int) -> Floats:
    """Return the assumed ranges of all d_r, then of all d_l (2p x 2) [z].

    Args:
        right, left: [lo, hi], or one per output (p x 2) (left None: those of right).
        p: number of outputs.

    Raises:
        InputError, ShapeError: unless 0 <= lo < hi.
    """
    of_left = right if left is None else left
    return np.concatenate(
        [
            _read_branch_ranges("observer.right", right, p),
            _read_branch_ranges("observer.left", of_left, p),
        ]
    )


def widths_within(right: Array, left: Array | None, p: int) -> dict[str, Any]:
    """Return widths0 (p x 2) and width_max (p) of an observer that adapts within these ranges [z].

    Args:
        right, left, p: as those of `read_width_ranges`.

    Raises:
        InputError, ShapeError: unless 0 <= lo < hi.
    """
    ranges = read_width_ranges(right, left, p)
    largest = ranges[:, 1].reshape(2, p).max(axis=0)
    return {"widths0": ranges.mean(axis=1).reshape(2, p).T, "width_max": largest}


def _read_branch_ranges(key: str, value: Array, p: int) -> Floats:
    """Return the ranges of a branch (p x 2) [z]. Raises InputError, ShapeError."""
    given = require_pairs(
        key, require_array(key, value), p, "the declared range [lo, hi]", "per output"
    )
    ranges = np.broadcast_to(given, (p, 2))
    require_ranges(key, ranges, ranges.tolist())
    return ranges


# --- Assumptions of a user


GLITCHES = 0.05  # default share of wrong readings
GLITCH_REACH = 10.0  # in largest assumed widths, over which a glitch is spread
FAKE = 0.02  # share of the outliers that are a false reading inside the zone
SPAN = 2.0  # quarter periods of the plant over which innovations are summed
PATIENCE = 0.54  # quarter periods over which the share of rejected readings is averaged
# MOST declares the delay of a jump: MOST ln 4 = 50 refused readings open a filter (TOO_MANY).
# With 18 and 72 (25, 100 readings), honest or with 10 % of random readings (64 problems as above,
# told and ranges alone), coverage, flags and medians are the same, rms of all within 1 %.
FEWEST, MOST = 6.0, 36.0  # readings over which it is averaged at least, and at most
# Mean square of the sums of innovations that counts as chance: for an assumed disturbance,
# and for a default, whose colour is not that of the true one.
CHANCE = 2.3
CHANCE_OF_DEFAULTS = 5.0
# the same of the squares of scores
SCORE = 3.3**2
SCORE_OF_DEFAULTS = 3.8**2
STAYS = 3.0  # standard deviations of its noise within which a reading counts as unchanged
MEANS = (1 / 32, 1 / 16, 2.0)  # quarter periods over which inputs are averaged
REPEATS = 0.25  # quarter periods of equal readings from which a sensor is stuck
LEAST_REPEATS = 10.0  # least number of equal readings for that: a median of five repeats fewer
HISTORY = 8.0  # quarter periods over which the squares of the sums are averaged


class Doubt(NamedTuple):
    """Parameters for doubtful readings and assumptions.

    Attributes:
        glitch: log of the prior odds that a reading outside the zone is an outlier.
        fake: log of the probability that a reading inside the zone is an outlier.
        reach: range over which an outlier is uniformly distributed (p) [z].
        noisy: 1 if a reading that repeats the one before counts as missing (p).
        fade: forgetting factor per step of the sum of innovations.
        keep: forgetting factor per step of the mean of its squares.
        std: standard deviations of `[x; d_r; d_l]` before the first reading (n + 2p).
        units: amount of each state that appears as a z of 1 (n).
        forget: forgetting factor per reading of the rate of rejected readings.
        most: largest mean square of the sums of innovations that may be chance.
        limit: largest square of a score that may be chance.
        stays: largest change of a reading that counts as none, and least |y| at which it counts
            (p) [y] (0: never).
        push: step response of z to each input after a quarter period (p x m).
        means: forgetting factors per step of three means of the inputs, as `MEANS`.
        run: largest number of equal readings of a sensor that is not stuck.
    """

    glitch: Floats
    fake: Floats
    reach: Floats
    noisy: Floats
    fade: Floats
    keep: Floats
    std: Floats
    units: Floats
    forget: Floats
    most: Floats
    limit: Floats
    stays: Floats
    push: Floats
    means: Floats
    run: Floats


def doubt_numbers(
    model: System, sensor: Zone, prior: Prior, glitches: float, is_assumed: bool
) -> Doubt:
    """Return the parameters of outlier rejection and of the consistency tests.

    Means forget exponentially: the factor exp(-Ts / T) per step gives a memory T. Each T is a
    multiple of a quarter period of the plant.

    Args:
        model: the sampled model.
        sensor: the dead zone.
        prior: prior of the filter before the first reading.
        glitches: probability that a reading is an outlier (0: none is).
        is_assumed: whether the user assumes the rms of the disturbance. False: it is a default,
            whose wider limits allow for a wrong correlation time.
    """
    assert model.Ts is not None
    quarter_period = time_scale(model.continuous, model.Ts)
    outlier_share = max(glitches, np.finfo(float).tiny)  # its logarithm must be finite
    noisy = (sensor.noise > 0) | (sensor.noise_before > 0)
    return Doubt(
        glitch=np.log(outlier_share / (1 - outlier_share)),
        fake=np.log(FAKE * outlier_share),
        reach=outlier_reach(prior),
        noisy=1.0 * (noisy & (sensor.quantum == 0)),
        fade=np.exp(-model.Ts / (SPAN * quarter_period)),
        keep=np.exp(-model.Ts / (HISTORY * quarter_period)),
        std=prior.std,
        units=state_units(model.continuous, model.Ts),
        forget=np.exp(-1 / np.clip(PATIENCE * quarter_period / model.Ts, FEWEST, MOST)),
        most=np.asarray(CHANCE if is_assumed else CHANCE_OF_DEFAULTS),
        limit=np.asarray(SCORE if is_assumed else SCORE_OF_DEFAULTS),
        stays=STAYS * np.sqrt(prior.R) * sensor.slope * (noisy & (not sensor.moves)),
        push=model.continuous.C @ zoh(model.continuous, quarter_period).B,
        means=np.exp(-model.Ts / (np.array(MEANS) * quarter_period)),
        run=np.asarray(max(REPEATS * quarter_period / model.Ts, LEAST_REPEATS)),
    )


def outlier_reach(prior: Prior) -> Floats:
    """Return the range of the uniform distribution of an outlier (p) [z]."""
    return np.asarray(GLITCH_REACH * prior.ranges[:, 1].reshape(2, -1).max(axis=0))


def outlier_probability(assumed: float | None, usual: float = GLITCHES) -> float:
    """Return the assumed probability of an outlier, or the usual one [1]. Raises InputError."""
    share = usual if assumed is None else require_number("observer.glitches", assumed, least=0.0)
    if share > 0.5:
        raise InputError(f"observer.glitches: must be at most 0.5, found {share:g}")
    return share


class Assumptions(OptionTable, frozen=True, kw_only=True):
    """Assumptions about a plant and its sensor.

    A quantity without an assumption is uncertain. The value 0 is an assumption.

    Attributes:
        right, left: ranges [lo, hi] of d_r and d_l, one or one per output [z] (left defaults to
            that of right; that of an edge that the sensor does not have, to the other's).
        centre: assumed range [lo, hi] of (d_r - d_l)/2, a number if it is known (0: a symmetric
            zone), or one range per output [z] (default: the range that follows from those of d_r
            and d_l).
        noise: least rms of a reading on an active side, one or one per output [z] (default the
            sensor's): a larger one is learnt from the readings.
        x_std: standard deviation of x(0) about 0, one or one per state (default the deviation that
            appears in z as five times the largest width).
        drift: random walk of the widths [z / sqrt(s)] (default a 400th of the range's extent in 1 /
            |pole| of the plant).
        disturbance: rms that a coloured input disturbance may have, one or one per input [u]
            (default the rms that moves z by half of the largest width, rms, in a quarter period of
            the plant and 1 / |pole| for each further pole).
        correlation_time: correlation time of the disturbance, first-order noise [s] (default a 16th
            of the plant's period, 12.5 samples if it only integrates).
        bias: rms of an unknown constant at the input, one or one per input [u] (default a quarter
            of the disturbance's).
        calibrated: probability that there is no bias.
        tolerance: relative rms error of the model: of every entry of A and B but in rows that only
            contain x_i' = x_j, or of some, as { "A[1,0]" = 0.1 } (of every parameter of a nonlinear
            plant).
        glitches: probability that a reading is wrong, for any sensor (0 trusts all readings, as
            textbooks do, and shows no wider intervals if they do not fit) (default 0.05, of a
            signal without an input 0, since no model tells a jump from a wrong reading).
    """

    right: Array
    left: Array | None = None
    centre: Array | None = None
    noise: Array | None = None
    x_std: Array | None = None
    drift: float | None = None
    disturbance: Array | None = None
    correlation_time: float | None = None
    bias: Array | None = None
    calibrated: float = 0.7
    tolerance: float | dict[str, float] = 0.05
    glitches: float | None = None

    def claims(self) -> dict[str, Any]:
        """Return the assumptions by name."""
        return {name: getattr(self, name) for name in Assumptions.__struct_fields__}
