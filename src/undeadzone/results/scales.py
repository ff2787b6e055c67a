"""Scales of the plant's signals, the basis of the divergence test."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from undeadzone.linalg.matrices import delta_form, state_response_sizes
from undeadzone.util.arrays import Floats

if TYPE_CHECKING:
    from undeadzone.scenario.problem import Problem

LIMIT: Final = 1e12  # times its scale, beyond which a signal has diverged


class Scales(NamedTuple):
    """Scales of the plant's signals, so that the choice of units cannot make a run diverge.

    Attributes:
        states: of the states (n).
        output: of the outputs and widths.
        input: of the inputs.
    """

    states: Floats
    output: float
    input: float


def plant_scales(problem: Problem) -> Scales:
    """Return the scales of a problem. States and inputs have scale 1 if the plant is
    nonlinear.

    The scale of the outputs is the largest of widths, reference and start. Each state has the scale
    with which the outputs show about theirs, and the inputs have the scale that makes such states.
    """
    t = np.arange(problem.steps + 1) * problem.scenario.simulation.step
    sensor = problem.sensor
    plant = problem.plant.linear
    signals = [sensor.widest, problem.reference.output_at(t)]
    if not problem.plant.nonlinear:
        signals.append(plant.C @ problem.x0)
    largest = max(float(np.abs(signal).max(initial=0.0)) for signal in signals)
    output = largest if 0 < largest < np.inf else 1.0
    if problem.plant.nonlinear:
        return Scales(np.ones(problem.plant.n), output, 1.0)
    A, B, C = delta_form(plant, problem.plant.Ts)
    states = np.maximum(output / state_response_sizes(A.T, C.T), np.abs(problem.x0))
    return Scales(states, output, float((states / state_response_sizes(A, B)).max()))


def largest_scaled_signals(
    scales: Scales, states: list[Floats], outputs: list[Floats], u: Floats
) -> Floats:
    """Return the largest signal of each sample in its scale (N) [1] (`LIMIT` or more: diverged).

    Args:
        scales: of the plant.
        states: x, x^ (each N x n).
        outputs: z, z^, widths (each N x ...).
        u: the inputs (N x m).
    """
    signals = np.hstack(outputs)
    signals = np.where(signals == np.inf, 0.0, signals)  # widths of edges that do not exist
    worst = np.abs(signals).max(axis=1) / scales.output
    for x in states:
        worst = np.maximum(worst, (np.abs(x) / scales.states).max(axis=1))
    return np.maximum(worst, np.abs(u).max(axis=1) / scales.input)
