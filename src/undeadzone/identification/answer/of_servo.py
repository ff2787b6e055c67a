"""A servo behind gear play in numbers and words: what it is made of, and every crossing."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from undeadzone.identification.answer.answer import Answer
from undeadzone.identification.servo.sampled import (
    DAMPING,
    DELAY,
    FRICTION,
    GAIN,
    LOAD,
    POLE,
    SLOW,
    SPRING,
    TORQUE,
)
from undeadzone.results.mjcf import Joint
from undeadzone.support.arrays import Floats

PRINTED = 4  # crossings on the terminal
SIDES = {1: "right", -1: "left"}


def servo_numbers(answer: Answer) -> dict[str, Any] | None:
    """The servo in units of the log, and its crossings column by column; None without one.

    Args:
        answer: what a log says.
    """
    servo = answer.servo
    if servo is None:
        return None
    log, one = servo.log, servo.servo
    theta, parts = one.theta, one.structure.parts
    rate = log.step / log.seconds
    return {
        "parts": sorted(parts),
        "inertia": not one.structure.lag,
        "damping": math.exp(theta[DAMPING]) * rate,
        "gain": float(theta[GAIN]) * log.y_scale / log.u_scale * _per_time(one.structure.lag, rate),
        "friction": float(theta[FRICTION]) * log.u_scale if "friction" in parts else 0.0,
        "load_friction": float(theta[LOAD]) * log.u_scale if "load" in parts else 0.0,
        "spring": math.exp(theta[SPRING]) * rate**2 if "spring" in parts else 0.0,
        "electrical_pole": math.exp(theta[POLE]) * rate if "pole" in parts else None,
        "delay": float(theta[DELAY]) * log.seconds,
        "torque": math.exp(theta[TORQUE]) * log.u_scale,
        "slow_torque": math.exp(theta[SLOW]) * log.u_scale if "slow" in parts else 0.0,
        "trends": servo.trends,
        "crossings": {name: column.tolist() for name, column in crossing_columns(answer).items()},
    }


def joints(answer: Answer) -> list[Joint]:
    """The gears of a servo, for MuJoCo; none of another answer, or of a servo without inertia.

    Args:
        answer: of a log whose input is a torque [N m] and whose output is an angle [rad].
    """
    servo, numbers = answer.servo, servo_numbers(answer)
    if servo is None or numbers is None or not numbers["inertia"] or answer.verdict != "play":
        return []
    gap, inertia = servo.gap, 1 / abs(numbers["gain"])
    words = f"gap {gap.value:.4g} rad [{gap.low:.4g}, {gap.high:.4g}], if y is in rad, u in N m"
    half, friction = gap.value / 2, numbers["friction"]
    return [Joint("q", words, half, half, inertia, friction, numbers["damping"] * inertia)]


def _per_time(lag: bool, rate: float) -> float:
    """What a gain of the predictor's unit of time is per second, or per second squared."""
    return rate if lag else rate**2


def crossing_columns(answer: Answer) -> dict[str, Floats]:
    """The crossings of a servo's gap column by column; empty where there is no servo."""
    servo = answer.servo
    if servo is None:
        return {}
    crossings = servo.crossings
    return {
        "t": answer.case.grid.t[crossings.at],
        "side": crossings.side.astype(float),
        "speed": crossings.speed,
        "duration": crossings.duration,
        "y": crossings.y + float(answer.case.grid.y[answer.case.grid.ok][0]),
        "gap": crossings.gap,
    }


def crossings_in_words(answer: Answer, unit: str) -> list[str]:
    """The first crossings, and what all of them say."""
    columns, servo = crossing_columns(answer), answer.servo
    if servo is None or not columns["t"].size:
        return []
    lines = []
    for k in range(min(PRINTED, columns["t"].size)):
        side = SIDES[int(columns["side"][k])]
        lines.append(
            f"t {columns['t'][k]:.4g} s, to the {side} at {abs(columns['speed'][k]):.3g}{unit}/s:"
            f" {columns['gap'][k]:.4g}{unit}"
        )
    low, high = np.quantile(columns["gap"], [0.1, 0.9])
    lines.append(
        f"all {columns['t'].size}: median {servo.crossings.median:.4g}{unit}, 80 % within"
        f" {low:.4g} to {high:.4g}{unit}; every one is in the page and in the JSON"
    )
    return lines
