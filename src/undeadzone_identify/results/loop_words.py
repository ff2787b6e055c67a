"""Why a control loop swings, as numbers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from undeadzone_identify.logs.grid import Grid
from undeadzone_identify.models.estimates import Interval, variance_along
from undeadzone_identify.selection.decision import Case
from undeadzone_identify.selection.valve import TIGHT, ValveFindings

UNSURE = 0.5  # of a gain: half its 95 % interval, above which it is not known


def swing_numbers(word: str, valve: ValveFindings, step: float) -> dict[str, Interval]:
    """Return the numbers of a loop that swings: its period [s], or by what to divide its gain.

    Near its limit the loop's C G is about -1 + 1 / S; of a sensitivity S = 2 it is -0.5.

    Args:
        word: external or tight_tuning.
        valve: findings on the valve.
        step: sample time [s].
    """
    known = {"period": valve.period * step}
    if word == "tight_tuning":
        known = {"sensitivity": valve.sensitivity}
        known["divide by"] = 2 * (1 - 1 / max(valve.sensitivity, TIGHT))
    return {name: Interval(one, one, one) for name, one in known.items()}


def jump_of_reading(case: Case, valve: ValveFindings) -> Interval | None:
    """Return how far a jump of the valve moves the reading [y]; None without a known gain.

    Args:
        case: the log.
        valve: findings on the valve.
    """
    plant = valve.plant
    if plant is None or plant.model.simulator.is_at_limit(plant.theta):
        return None
    simulator = plant.model.simulator
    theta = plant.theta
    if simulator.layout.integrators:
        return None
    gain = float(simulator.dc_gain(theta)[0])
    slope = np.zeros(theta.size)
    below = 1 + theta[simulator.layout.denominator].sum()
    slope[simulator.layout.denominator] = -gain / below
    slope[simulator.layout.numerators] = 1 / below
    V = plant.squares.robust_covariance(theta).V
    unsure = 2 * math.sqrt(variance_along(V, slope)) / max(abs(gain), 1e-12)
    if unsure > UNSURE:
        return None
    moved = valve.jump.scale_by(abs(gain) * case.record_data.y_scale / case.record_data.input_scale)
    if not 0 < moved.value < 2 * case.record_data.y_scale:
        return None
    return Interval(moved.value, moved.low * (1 - unsure), moved.high * (1 + unsure))


def shape_in_words(valve: ValveFindings, grid: Grid) -> str:
    """Return how the loop swings, and how wide PV lies over OP.

    Args:
        valve: findings on the valve.
        grid: the log.
    """
    how = "does not swing regularly"
    if valve.swings:
        unit = "samples" if grid.counted else "s"
        how = f"swings regularly, period {valve.period * grid.step:.3g} {unit}"
    wide = f"{grid.output} over {grid.inputs[0]} is an ellipse {100 * valve.shape:.0f} % as wide as"
    return f"{how} (r {min(valve.regularity, 99):.2g}); {wide} the range of {grid.inputs[0]}"


def loop_numbers(case: Case, valve: ValveFindings) -> dict[str, Any]:
    """Return the findings on a loop's valve, for JSON.

    Args:
        case: the log.
        valve: findings on the valve.
    """
    period = valve.period * case.grid.step
    moved = jump_of_reading(case, valve)
    return {
        "S": list(valve.stick),
        "J": list(valve.jump),
        "jump_of_reading": None if moved is None else list(moved),
        "account": valve.fit.account,
        "regularity": valve.regularity,
        "period": period if math.isfinite(period) else None,
        "sensitivity": valve.sensitivity,
        "shape": valve.shape,
        "held_out_without": valve.error_without * case.record_data.y_scale,
    }
