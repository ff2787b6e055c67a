"""Why a control loop swings, in words of the trade and as numbers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from undeadzone.util.arrays import to_json_value
from undeadzone.util.text import append_unit, bracket_interval
from undeadzone_identify.logs.grid import Grid
from undeadzone_identify.models.estimates import Interval, variance_along
from undeadzone_identify.selection.decision import Case
from undeadzone_identify.selection.valve import BUMP, TIGHT, ValveFindings

UNSURE = 0.5  # of a gain: half its 95 % interval, above which it is not known


def describe_loop(case: Case, verdict: str, valve: ValveFindings) -> list[str]:
    """Return the fault of a loop and its remedy; empty if none is named.

    Args:
        case: the log.
        verdict: the word.
        valve: findings on the valve.
    """
    grid = case.grid
    period = _period(valve, grid)
    if verdict == "stiction":
        return [
            f"the valve sticks: S {_percent(valve.stick, grid)}, J {_percent(valve.jump, grid)}",
            "tuning does not cure it: see to its packing, its positioner and the size of its"
            " actuator",
            BUMP,
        ]
    if verdict == "input_play":
        return [
            f"the valve has a dead band (play) of {_percent(valve.stick, grid)}, and no jump",
            "alone it makes no cycle of a self-regulating loop; a level loop cycles, and any loop"
            " answers late: see to linkage and positioner, or add the dead band at each turn",
            BUMP,
        ]
    if verdict == "external":
        return [
            f"an oscillation from outside swings the loop, {period}: neither its valve nor its"
            " tuning; look for another loop of this period upstream",
        ]
    if verdict == "tight_tuning":
        return [
            f"the loop is tuned too tightly: it swings regularly, {period}, at which its"
            f" sensitivity |1 / (1 + C G)| is {min(valve.sensitivity, 99):.2g} (above {TIGHT:g});"
            " the valve follows",
            f"divide the controller's gain by about {_gain_to_cut(valve):.2g}, then record again",
        ]
    if verdict in ("none", "operating_point"):
        swings = f"; the loop swings, {period}" if valve.swings else ""
        return [f"the plant answers to {grid.inputs[0]} without stiction or play{swings}"]
    return []


def _percent(interval: Interval, grid: Grid) -> str:
    """Return an interval in the unit of the controller's output: % of OP."""
    width = max(interval.high - interval.low, 1e-12)
    digits = min(max(0, math.ceil(-math.log10(width)) + 1), 9)
    text = append_unit(bracket_interval(*interval, f".{digits}f"), grid.input_unit)
    return f"{text} of {grid.inputs[0]}"


def _period(valve: ValveFindings, grid: Grid) -> str:
    """Return the period in words."""
    if not math.isfinite(valve.period):
        return "without a period"
    unit = "samples" if grid.counted else "s"
    return f"period {valve.period * grid.step:.3g} {unit}"


def _gain_to_cut(valve: ValveFindings) -> float:
    """Return by how much a gain is divided to leave a sensitivity of 2 [1].

    Near its limit the loop's C G is about -1 + 1 / S; of S = 2 it is -0.5.
    """
    return max(2 * (1 - 1 / max(valve.sensitivity, TIGHT)), 1.0)


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
    below = 1 + float(theta[simulator.layout.denominator].sum())
    slope[simulator.layout.denominator] = -gain / below
    slope[simulator.layout.numerators] = 1 / below
    V = plant.squares.robust_covariance(theta).V
    unsure = 2 * math.sqrt(variance_along(V, slope)) / max(abs(gain), 1e-12)
    if unsure > UNSURE:
        return None
    moved = valve.jump.scale_by(
        abs(gain) * case.record_data.y_scale / float(case.record_data.u_scale[0])
    )
    if not 0 < moved.value < 2 * case.record_data.y_scale:
        return None
    return Interval(moved.value, moved.low * (1 - unsure), moved.high * (1 + unsure))


def shape_in_words(valve: ValveFindings, grid: Grid) -> str:
    """Return how the loop swings, and how wide PV lies over OP.

    Args:
        valve: findings on the valve.
        grid: the log.
    """
    how = "swings regularly" if valve.swings else "does not swing regularly"
    wide = f"{grid.output} over {grid.inputs[0]} is an ellipse {100 * valve.shape:.0f} % as wide as"
    return (
        f"{how} (r {min(valve.regularity, 99):.2g}, {_period(valve, grid)}); {wide}"
        f" the range of {grid.inputs[0]}"
    )


def loop_numbers(case: Case, valve: ValveFindings) -> dict[str, Any]:
    """Return the findings on a loop's valve, for JSON.

    Args:
        case: the log.
        valve: findings on the valve.
    """
    period = valve.period * case.grid.step
    moved = jump_of_reading(case, valve)
    return dict(
        to_json_value(
            {
                "S": list(valve.stick),
                "J": list(valve.jump),
                "jump_of_reading": None if moved is None else list(moved),
                "account": valve.fit.account,
                "regularity": valve.regularity,
                "period": period if math.isfinite(period) else None,
                "sensitivity": valve.sensitivity,
                "shape": valve.shape,
                "held_out_without": valve.without * case.record_data.y_scale,
            }
        )
    )
