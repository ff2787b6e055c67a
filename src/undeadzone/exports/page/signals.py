"""References and disturbances as data, from which the page computes their values at any time."""

from __future__ import annotations

from typing import Any

import numpy as np

from undeadzone.errors import InputError
from undeadzone.feedforward.targets import steady_state
from undeadzone.scenario.problem import Problem
from undeadzone.signals.exosystem import Exosystem, Sine, Sines, Step, Trapezoid
from undeadzone.support.arrays import Floats


def reference(problem: Problem) -> dict[str, Any]:
    """The target (r, x_ref, u_ff) along the run.

    Args:
        problem: the checked parts of a scenario with a linear plant.

    Raises:
        InputError: a kind of signal that the page does not draw.
        TrackingError: the plant cannot follow the reference.
    """
    signal, exo = problem.scenario.reference, problem.reference
    Pi, Gamma = steady_state(problem.model, exo, problem.tracked)
    return _data("reference", signal, exo, np.vstack([exo.Q, Pi, Gamma]))


def disturbance(problem: Problem) -> dict[str, Any] | None:
    """The disturbance along the run; None: there is none.

    Args:
        problem: the checked parts of a scenario.

    Raises:
        InputError: a kind of signal that the page does not draw.
    """
    signal, exo = problem.scenario.disturbance, problem.disturbance
    if signal is None:
        return None
    if exo is None:
        raise InputError("disturbance.kind: a random one is not drawn by the page; leave it out")
    return _data("disturbance", signal, exo, exo.Q)


def _data(key: str, signal: Any, exo: Exosystem, gains: Floats) -> dict[str, Any]:
    """A signal as what its exosystem's state is made of, and the gains from there."""
    data: dict[str, Any] = {"gains": gains.tolist()}
    if isinstance(signal, Sine | Sines):
        count = exo.S.shape[0] // 2
        waves = 2 * np.arange(count)
        data["omegas"] = exo.S[waves, waves + 1].tolist()
        data["offset"] = exo.S.shape[0] % 2 == 1
        return data
    if not isinstance(signal, Step | Trapezoid):
        kind = type(signal).__struct_config__.tag
        raise InputError(
            f"{key}.kind: the page draws sine, sines, step and trapezoid, found {kind!r}"
        )
    starts = _starts(exo)
    data["starts"] = starts.tolist()
    data["values"] = exo.state(starts).tolist()
    data["order"] = exo.S.shape[0] // exo.Q.shape[0]
    data["period"] = exo.period
    return data


def _starts(exo: Exosystem) -> Floats:
    """When the pieces of a signal begin; the first at 0."""
    corners = exo.corners if exo.period is None else exo.corners[:-1]
    later = corners[corners > 0]
    return np.concatenate([[0.0], later])
