"""How a play or an input zone does on data that had no part in its fit."""

from __future__ import annotations

import numpy as np

from undeadzone.identification.element import Element
from undeadzone.identification.log import Flags
from undeadzone.identification.orders import HeldOut, judged, one_step, trained_part
from undeadzone.identification.place_models import PlaceModel, fit_place
from undeadzone.identification.plant_fit import Simulator
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
    return judged(e, data, test, one_step(e, test, test, data.start))


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
