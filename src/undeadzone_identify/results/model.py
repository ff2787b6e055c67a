"""Answer as a model: simulated for an input, predicting a log, as other packages' objects."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.signal import lfilter

from undeadzone.errors import InputError
from undeadzone.nonlinearities import sensor
from undeadzone.nonlinearities.play import levels
from undeadzone.scenario.reader import parse
from undeadzone.simulation.estimate import estimate
from undeadzone.util.arrays import Floats
from undeadzone_identify.logs.log import Log
from undeadzone_identify.results.assemble import Answer
from undeadzone_identify.results.to_continuous import observer_matrices
from undeadzone_identify.selection.alternatives import AHEAD

LINEAR = ("none", "operating_point")


def follow_play(z: Floats, right: float, left: float) -> Floats:
    """Return the level that z moves through a gap, from 0 (N).

    Args:
        z: its input (N).
        right, left: half gaps c_r, c_l.
    """
    return levels(z, np.array([right]), np.array([left]), np.zeros(1))


SENSORS = {"dead_zone": sensor.deadzone, "jump": sensor.jump, "play": follow_play}


class Simulated(NamedTuple):
    """Response of an identified model.

    Attributes:
        t: times (N) [s].
        z: output of the plant (N) [y].
        y: reading without noise (N) [y].
    """

    t: Floats
    z: Floats
    y: Floats


class Predicted(NamedTuple):
    """Log predicted one sample ahead.

    Attributes:
        t: times (N) [s].
        y: each reading from those before it (N) [y]; NaN inside the zone, and for a missing one.
        y_std: its standard deviation (N) [y].
        z: the output of the plant, from the readings up to this one (N) [y].
    """

    t: Floats
    y: Floats
    y_std: Floats
    z: Floats


def simulate_answer(answer: Answer, u: Any) -> Simulated:
    """Simulate plant and nonlinearity of an answer from rest.

    Args:
        answer: of one output.
        u: inputs (N) or (N x m).
    """
    layout, a, b, _ = answer.plant_numbers
    inputs = np.asarray(u, float)
    inputs = inputs[:, None] if inputs.ndim == 1 else inputs
    if inputs.ndim != 2 or inputs.shape[1] != layout.m or not np.isfinite(inputs).all():
        raise InputError(f"u: expected finite rows of {layout.m}, found shape {np.shape(u)}")
    u_rest, y_rest = answer.at_rest or (0.0, 0.0)
    inputs = inputs - u_rest
    right, left = _require_widths(answer)
    if answer.verdict == "input_zone":
        inputs = sensor.deadzone(inputs, right, left)
    if answer.verdict == "input_play":
        inputs = follow_play(inputs[:, 0], right, left)[:, None]
    z = np.zeros(len(inputs))
    late = answer.found.delay
    rest = np.vstack([np.zeros((late, layout.m)), inputs])[: len(inputs)]
    for column, numerator in zip(rest.T, b.reshape(layout.m, layout.n), strict=True):
        z += lfilter(np.append(0.0, numerator), layout.full_denominator(a), column)
    y = SENSORS[answer.verdict](z, right, left) if answer.verdict in SENSORS else z
    t = answer.case.grid.step * np.arange(z.size)
    return Simulated(t, z + y_rest, np.asarray(y) + y_rest)


def _require_widths(answer: Answer) -> tuple[float, float]:
    """Return both widths of the answer's nonlinearity. Raise InputError."""
    if answer.verdict in LINEAR:
        return 0.0, 0.0
    if answer.verdict not in (*SENSORS, *AHEAD):
        raise InputError(
            f"simulate: the verdict is {answer.verdict}, and no model of it is simulated. "
            "`--kind` and `--place` of identify select another one"
        )
    right, left, width = answer.right, answer.left, answer.width
    if right is None and left is None and width is not None:
        return width.value / 2, width.value / 2
    if right is None or left is None or not np.isfinite([right.value, left.value]).all():
        raise InputError("simulate: an edge was never reached. Give it by --right or --left")
    return right.value, left.value


def predict_log(answer: Answer, text: str, log: Log) -> Predicted:
    """Predict a log by the observer of a scenario.

    Args:
        answer: of one output.
        text: of its scenario.
        log: with one output.
    """
    late = answer.case.options.recorded_delay
    found = estimate(parse(text), t=log.t, u=log.u, y=log.y, smoothing=False, delay=late)
    y = found.y[:, 0] - found.innovation[:, 0]
    y = np.where(found.side[:, 0] == 0, np.nan, y)
    return Predicted(found.t, y, found.innovation_std[:, 0], found.z_hat[:, 0])


def answer_to_control(answer: Answer) -> Any:
    """Return the sampled plant as `control.StateSpace`, a delay as states behind the others.

    Args:
        answer: of one output.
    """
    import control

    layout, a, b, _ = answer.plant_numbers
    F, B, C = observer_matrices(a, b, layout)
    grid = answer.case.grid
    for _ in range(answer.found.delay):  # each delays all inputs by one sample
        n, m = B.shape
        F = np.block([[F, B], [np.zeros((m, n + m))]])
        B = np.vstack([np.zeros((n, m)), np.eye(m)])
        C = np.hstack([C, np.zeros((1, m))])
    D = np.zeros((1, layout.m))
    if answer.found.delay < 0:  # of x - B u, as x holds what the input of its own sample adds
        B, D = F @ B, C @ B
    return control.ss(F, B, C, D, grid.step, inputs=list(grid.inputs), outputs=[grid.output])


def answer_to_pandas(answer: Answer, z: Floats, z_std: Floats) -> Any:
    """Return the log beside the hidden output, indexed by t.

    Args:
        answer: of one output.
        z, z_std: hidden output and its standard deviation (N).
    """
    import pandas as pd

    grid = answer.case.grid
    named = dict(zip(grid.inputs, (grid.u + (grid.zero or 0.0)).T, strict=True))
    named[grid.output] = np.where(grid.ok, grid.y, np.nan)
    return pd.DataFrame(named | {"z": z, "z_std": z_std}, index=pd.Index(grid.t, name="t"))
