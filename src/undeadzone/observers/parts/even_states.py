"""A filter counts the states in units that make them alike, and shows them in the plant's.

In the plant's own units of time, states and their variances may be too far apart for numbers of
single precision. The units are powers of two, so that nothing is rounded.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from undeadzone.interfaces import Estimate, Observer, Reading
from undeadzone.observers.parts.prior import Prior
from undeadzone.plants.system import System
from undeadzone.plants.time_scales import state_units
from undeadzone.support.arrays import Floats


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
