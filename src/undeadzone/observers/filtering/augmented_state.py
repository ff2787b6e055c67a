"""State `[x; d_r; d_l]` of filters: its default disturbance, and the units of its numbers.

Filters count the states in units that make them alike, and show them in the plant's: in those of
time, states and their variances may be too far apart for numbers of single precision. The units are
powers of two, so that nothing is rounded.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from undeadzone.interfaces import Estimate, Observer, Reading
from undeadzone.linalg.hold import discretise_noise
from undeadzone.observers.filtering.prior import Prior, require_sample_time
from undeadzone.plants.system import System, arrival_time, state_units, time_scale
from undeadzone.util.arrays import Floats

SWING = 0.5  # rms, in largest widths, by which a disturbance moves z in a quarter period by default


def white_disturbance_rms(model: System, rms: float, span: float | None = None) -> Floats:
    """Return the rms of a white input disturbance (m) [u] that alone moves z by a given rms.

    Args:
        model: the sampled model.
        rms: that of z in the end [z].
        span: time that it has [s] (default a quarter period of the plant).
    """
    A, B, C = model.continuous
    reached = []
    for b in B.T:
        _, covariance = discretise_noise(A, np.outer(b, b), span or quarter_period(model))
        reached.append(np.diag(C @ covariance @ C.T).max())
    variance = np.where(np.array(reached) > 0, reached, np.inf)
    return rms / np.sqrt(require_sample_time(model) * variance)


def default_disturbance_rms(model: System, largest: float, correlation: float) -> Floats:
    """Return the default rms of a coloured input disturbance (m) [u].

    At low frequencies it is as strong as a white one that moves z by `SWING` largest widths until
    its `arrival_time`.

    Args:
        model: the sampled model.
        largest: largest assumed width [z].
        correlation: correlation time of the disturbance [s].
    """
    white = white_disturbance_rms(model, SWING * largest, arrival_time(model.continuous, model.Ts))
    return white * np.sqrt(require_sample_time(model) / 2 / correlation)


def quarter_period(model: System) -> float:
    """Return the `time_scale` of a sampled model [s]."""
    return time_scale(model.continuous, model.Ts)


def power_of_two_units(model: System) -> Floats:
    """Return the powers of two next to the `state_units` of a sampled model (n)."""
    return np.asarray(2.0 ** np.round(np.log2(state_units(model.continuous, model.Ts))))


def scale_prior(prior: Prior, units: Floats) -> Prior:
    """Return the prior of states expressed in the given units (n)."""
    n = units.size
    scale = np.concatenate([units, np.ones(prior.mean.size - n)])
    return prior._replace(mean=prior.mean / scale, std=prior.std / scale)


def rescale_states(observer: Observer, units: Floats) -> Observer:
    """Return a filter with states in the given units (n), and estimates in the plant's.

    Of a linear plant the units are numbers of its model (`System.params`), so that one graph serves
    plants whose units differ.
    """
    numbered = hasattr(observer.params.model, "units")
    if not numbered and (units == 1).all():
        return observer

    def in_plant_units(q: Any, counted: Estimate) -> Estimate:
        """Convert an estimate from the filter's to the plant's units."""
        each = q.model.units if numbered else units
        converted = counted._replace(x=each * counted.x, x_std=each * counted.x_std)
        return converted._replace(w=each * counted.w) if converted.w.shape[0] else converted

    def step(q: Any, s: Any, u: Any, reading: Reading) -> tuple[Any, Estimate]:
        """Return the next state, and the estimate in the plant's units."""
        after, counted = observer.step(q, s, u, reading)
        return after, in_plant_units(q, counted)

    smoothing = observer.smoothing
    if smoothing is not None:
        inner = smoothing.mixture_estimate
        smoothing = smoothing._replace(
            mixture_estimate=lambda q, *known: in_plant_units(q, inner(q, *known))
        )
    return observer._replace(step=step, smoothing=smoothing)
