"""How a play or an input zone does on data that had no part in its fit."""

from __future__ import annotations

import numpy as np

from undeadzone.identification.element import Element
from undeadzone.identification.log import Flags
from undeadzone.identification.orders import HeldOut, is_white, trained_part
from undeadzone.identification.place_models import PlaceModel, fit_place
from undeadzone.identification.plant_fit import Data, Simulator
from undeadzone.identification.play_model import PlayModel
from undeadzone.support.arrays import Floats


def held_out_of(element: Element, held_out: float) -> HeldOut:
    """Error, share and whiteness on the last part of a log, fitted to the part before.

    Args:
        element: a play, or a zone of the input.
        held_out: share of the samples, at the end, that checks.
    """
    model = element.model
    data = model.data
    train = trained_part(data, held_out)
    residual = _residual_of_part(model, element.fitted, train)
    test = data.ok & ~train
    e = np.where(data.ok, residual, 0.0)
    rms = float(np.sqrt(np.mean(e[test] ** 2)))
    usual = float(np.sqrt(np.mean(data.y[test] ** 2)))
    return HeldOut(rms, 1 - rms / max(usual, 1e-12), _white(e, test, data))


def _residual_of_part(model: PlayModel | PlaceModel, theta: Floats, train: Flags) -> Floats:
    """y less what a fit of the training part expects (N)."""
    data = model.data._replace(ok=model.data.ok & train, climbs=None)
    layout = model.simulator.layout
    simulator = Simulator(data, layout.n, layout.integrators)
    if isinstance(model, PlayModel):
        moved = PlayModel(simulator, model.zone).climbed(theta, 25).theta
        return model.data.y - model.readings(model.z(moved), moved)
    fitted = fit_place(PlaceModel(simulator, model.shape), [theta])
    moved = theta if fitted is None else fitted.theta
    return model.data.y - model.readings(model.outputs(moved[None, :])[0], moved)


def _white(e: Floats, test: Flags, data: Data) -> bool:
    """Whether one-step residuals are white: e_t less what e_(t-1) says of it."""
    use = test.copy()
    use[1:] &= test[:-1]
    use[data.start] = False
    at = np.flatnonzero(use)
    before = e[at - 1]
    rho = float(e[at] @ before / max(float(before @ before), 1e-300))
    value = e.copy()
    value[1:] -= rho * e[:-1]
    return is_white(value, use)
