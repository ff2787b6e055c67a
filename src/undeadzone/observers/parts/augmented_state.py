"""Joint filters see the dead zone as one function y / m = Dz(z; d_r, d_l) of [x; d_r; d_l].

They count the states in units that make them alike, and show them in the plant's: in those of time,
states and their variances may be too far apart for numbers of single precision. The units are
powers of two, so that nothing is rounded.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from undeadzone.catalogue import Options
from undeadzone.ends import sensor as sensors
from undeadzone.ends.sensor import Zone
from undeadzone.interfaces import Estimate, Observer, Reading
from undeadzone.linear.hold import sampled_noise
from undeadzone.observers.parts.claims import GLITCHES
from undeadzone.observers.parts.prior import Prior, build_prior, sample_time, width_ranges
from undeadzone.plants.system import System
from undeadzone.plants.time_scales import state_units, time_scale
from undeadzone.support.arrays import Array, Floats, nonnegative, scalar

CROWD = 100  # readings in a quarter period beyond which each is given more noise
SWING = 0.5  # rms, in largest widths, by which a disturbance moves z in a quarter period by default


class JointClaims(Options, frozen=True, kw_only=True):
    """Claims of the rivals of `Kalman`, in its words; what is not claimed follows from `Defaults`.

    Attributes:
        right, left: claimed ranges [lo, hi] of d_r and d_l, one or one per output [z]; left
            defaults to that of right.
        noise: rms of a reading, one or one per output [z]; default the sensor's, but at least the
            method's share of the claimed range.
        x_std: standard deviation of x(0) about 0, one or one per state; default the method's
            multiple of the largest width.
        disturbance: rms of an input disturbance that is new at every sample, one or one per input
            [u]; default what moves z by `swing` times the largest width, rms, in a quarter period
            of the plant (in 50 samples of a chain of integrators).
        swing: rms, in largest widths, by which the default disturbance moves z.
        drift: random walk of the widths [z / sqrt(s)]; default the method's multiple of the extent
            of each range.
        glitches: probability that a reading is wrong, whatever the sensor promises; 0 takes all
            readings for right, as published.
    """

    right: Array
    left: Array | None = None
    noise: Array | None = None
    x_std: Array | None = None
    disturbance: Array | None = None
    swing: float = 0.1
    drift: float | None = None
    glitches: float = GLITCHES


class Defaults(NamedTuple):
    """What a method assumes where nothing is claimed.

    Of more than `CROWD` readings in a quarter period, each has so much more noise that together
    they say no more: what is wrong with the model does not average out.

    Attributes:
        noise: least noise, as a share of the claimed range.
        drift: drift, in largest widths.
        x_std: standard deviation of x(0), in largest widths.
    """

    noise: float
    drift: float
    x_std: float


class JointPrior(NamedTuple):
    """What a joint filter starts from.

    Attributes:
        prior: that of [x; d_r; d_l] and of the sensor.
        variance: that of the input disturbance (m) [u^2].
        ranges: claimed ranges of the widths (2p x 2) [z].
    """

    prior: Prior
    variance: Floats
    ranges: Floats


def joint_prior(
    claims: JointClaims, model: System, sensor: Zone, defaults: Defaults, stride: int = 1
) -> JointPrior:
    """The prior of a joint filter, with defaults where nothing is claimed.

    Args:
        claims: the options.
        model: the sampled model.
        sensor: the dead zone.
        defaults: the method's.
        stride: every how many samples a reading is used.

    Raises:
        InputError, ShapeError: for a claim that cannot be, or a model in continuous time.
    """
    Ts = sample_time(model)
    readings = quarter_period(model) / (stride * Ts)
    ranges = width_ranges(claims.right, claims.left, model.p)
    largest = float(ranges.max())
    floor = defaults.noise * max(1.0, readings / CROWD) ** 0.5
    prior = build_prior(
        model,
        sensor,
        claims.right,
        claims.left,
        claims.noise,
        claims.x_std,
        claims.drift,
        floor=floor,
        reach=defaults.x_std,
        wear=defaults.drift,
    )
    swing = scalar("observer.swing", claims.swing, least=0.0)
    if claims.disturbance is None:
        rms = agitation(model, swing * largest)
    else:
        rms = nonnegative("observer.disturbance", claims.disturbance, model.m, "one per input")
    return JointPrior(prior, rms**2, ranges)


def agitation(model: System, rms: float, span: float | None = None) -> Floats:
    """The rms (m) of a disturbance, new at every sample, that alone moves some z by a given rms.

    Args:
        model: the sampled model.
        rms: that of z in the end [z].
        span: time that it has [s]; default a quarter period of the plant.
    """
    assert model.flow is not None
    A, B, C = model.flow
    span = quarter_period(model) if span is None else span
    reached = []
    for b in B.T:
        _, covariance = sampled_noise(A, np.outer(b, b), span)
        reached.append(np.diag(C @ covariance @ C.T).max())
    variance = np.where(np.array(reached) > 0, reached, np.inf)
    return rms / np.sqrt(sample_time(model) * variance)


def default_disturbance(
    model: System, largest: float, correlation: float, span: float | None = None
) -> Floats:
    """The rms (m) [u] of a coloured disturbance where none is claimed.

    At low frequencies it is as strong as a white one that moves z by `SWING` largest widths.

    Args:
        model: the sampled model.
        largest: largest claimed width [z].
        correlation: correlation time of the disturbance [s].
        span: time in which it moves z [s]; default a quarter period of the plant.
    """
    white = agitation(model, SWING * largest, span)
    return white * np.sqrt(sample_time(model) / 2 / correlation)


def quarter_period(model: System) -> float:
    """`time_scale` [s] of a sampled model."""
    assert model.flow is not None
    return time_scale(model.flow, model.Ts)


def read(kind: str, z: Any, right: Any, left: Any) -> Any:
    """The reading y / m of z by a sensor of that kind, without noise."""
    if kind == "jump":
        return sensors.jump(z, right, left)
    return sensors.deadzone(z, right, left)


def even_units(model: System) -> Floats:
    """The powers of two next to `state_units` (n) of a sampled model."""
    assert model.flow is not None
    return np.asarray(2.0 ** np.round(np.log2(state_units(model.flow, model.Ts))))


def counted_prior(prior: Prior, units: Floats) -> Prior:
    """The prior of states that are counted in these units (n)."""
    n = units.size
    scale = np.concatenate([units, np.ones(prior.mean.size - n)])
    return prior._replace(mean=prior.mean / scale, std=prior.std / scale)


def shown_states(observer: Observer, units: Floats) -> Observer:
    """A filter of states counted in these units (n), that shows them in the plant's.

    Of a linear plant the units are numbers of its model (`in_units`), so that one graph serves
    plants whose units differ.
    """
    numbered = hasattr(observer.params.model, "units")
    if not numbered and (units == 1).all():
        return observer

    def in_plant_units(q: Any, counted: Estimate) -> Estimate:
        each = q.model.units if numbered else units
        shown = counted._replace(x=each * counted.x, x_std=each * counted.x_std)
        return shown._replace(w=each * counted.w) if shown.w.shape[0] else shown

    def step(q: Any, s: Any, u: Any, reading: Reading) -> tuple[Any, Estimate]:
        after, counted = observer.step(q, s, u, reading)
        return after, in_plant_units(q, counted)

    smoothing = observer.smoothing
    if smoothing is not None:
        inner = smoothing.shown
        smoothing = smoothing._replace(shown=lambda q, *known: in_plant_units(q, inner(q, *known)))
    return observer._replace(step=step, smoothing=smoothing)
