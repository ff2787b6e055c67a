"""State-space objects of scipy and python-control to and from `Plant`."""

from __future__ import annotations

from typing import Any

import numpy as np

from undeadzone.errors import InputError
from undeadzone.plants.build import matrices
from undeadzone.plants.options import Plant


def from_statespace(system: Any, x0: Any = None) -> Plant:
    """A `Plant` from any object with A, B, C, D: scipy `StateSpace`, python-control `StateSpace`.

    Args:
        system: the object, in continuous time, with D = 0.
        x0: initial state (n); default: 0.

    Returns:
        The plant, given by its matrices A, B, C.

    Raises:
        InputError: a discrete-time system, or a direct feedthrough D != 0.
    """
    if getattr(system, "dt", None) not in (None, 0):
        raise InputError(
            f"from_statespace: expected a continuous-time system, found sample time {system.dt}"
        )
    if np.any(np.asarray(system.D)):
        raise InputError(
            "from_statespace: D must be 0, "
            "an output deadzone with direct feedthrough is not supported"
        )
    return Plant(A=np.asarray(system.A), B=np.asarray(system.B), C=np.asarray(system.C), x0=x0)


from_scipy = from_statespace
from_control = from_statespace


def to_scipy(plant: Plant) -> Any:
    """The plant as `scipy.signal.StateSpace`.

    Args:
        plant: a linear plant in any form.

    Returns:
        The state-space object, with D = 0.

    Raises:
        InputError: the plant is nonlinear, or its numbers are wrong.
    """
    from scipy.signal import StateSpace

    A, B, C = matrices(plant)
    return StateSpace(A, B, C, np.zeros((C.shape[0], B.shape[1])))


def to_control(plant: Plant) -> Any:
    """The plant as `control.StateSpace` (extra `control`).

    Args:
        plant: a linear plant in any form.

    Returns:
        The state-space object, with D = 0.

    Raises:
        InputError: the plant is nonlinear, or its numbers are wrong.
    """
    import control

    A, B, C = matrices(plant)
    return control.ss(A, B, C, np.zeros((C.shape[0], B.shape[1])))
