"""What disturbs z ahead of an element, by the autocorrelation of what a simulation leaves."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from undeadzone.identification.log import Flags
from undeadzone.identification.plant_fit import Layout
from undeadzone.support.arrays import Floats

COLOURS = (0.0, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98)  # correlations over one sample
LAGS = 60
LENGTH = 16_000  # samples from which the autocorrelation of each colour is taken
SETTLED = 500  # samples after which the plant has forgotten its beginning


class Ahead(NamedTuple):
    """A first-order disturbance at the plant's first input.

    Attributes:
        rms: of what it makes of z, in the scale of the fit.
        phi: its correlation over one sample.
        at_input: its own rms.
    """

    rms: float
    phi: float
    at_input: float


def disturbance_ahead(layout: Layout, plant: Floats, residual: Floats, ok: Flags) -> Ahead:
    """The disturbance whose colour, through the plant, is that of the residual.

    Args:
        layout: of the plant's numbers.
        plant: a, b, ...
        residual: y less what was simulated (N); 0 where a reading is missing.
        ok: whether there is a reading (N).

    Returns:
        The disturbance; lag 0 is not looked at, so that white noise of the readings is none of it.
    """
    lags = max(2, min(LAGS, residual.size // 10))
    seen = correlations(residual, ok, lags)[1:]
    best, error = Ahead(0.0, 0.0, 0.0), math.inf
    for phi in COLOURS:
        w = shaped(layout, plant, white(1, LENGTH, phi))[0]
        shape = correlations(w, np.ones(w.size, bool), lags)
        power = max(float(shape[1:] @ seen) / max(float(shape[1:] @ shape[1:]), 1e-300), 0.0)
        left = float(np.sum((seen - power * shape[1:]) ** 2))
        if left < error:
            rms = math.sqrt(power * shape[0])
            best, error = Ahead(rms, phi, math.sqrt(power)), left
    return best


def correlations(e: Floats, ok: Flags, lags: int) -> Floats:
    """The products of e with itself, lags 0 to lags - 1, over the number of readings."""
    centred = np.where(ok, e - e[ok].mean(), 0.0)
    products = [centred[lag:] @ centred[: e.size - lag] for lag in range(lags)]
    return np.array(products) / max(int(ok.sum()), 1)


def white(runs: int, size: int, phi: float, seed: int = 0) -> Floats:
    """First-order noise of rms 1, the same numbers for every colour (runs x (size + SETTLED))."""
    draws = np.random.default_rng(seed).standard_normal((runs, size + SETTLED))
    return np.asarray(lfilter([math.sqrt(1 - phi**2)], [1.0, -phi], draws, axis=1))


def shaped(layout: Layout, plant: Floats, noise: Floats) -> Floats:
    """What the plant makes of noise at its first input (runs x size), settled."""
    numerator = np.append(0.0, plant[layout.b][: layout.n])
    denominator = np.append(1.0, layout.denominator(plant[layout.a]))
    return np.asarray(lfilter(numerator, denominator, noise, axis=1))[:, SETTLED:]
