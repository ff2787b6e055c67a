"""Conversion of state-space objects of scipy and python-control to `Plant`, and back to scipy."""

from __future__ import annotations

from typing import Any

import numpy as np

from undeadzone.errors import InputError
from undeadzone.linalg.hold import undo_zoh
from undeadzone.linalg.matrices import Matrices
from undeadzone.plants.options import Plant, linear_matrices


def from_statespace(system: Any, x0: Any = None) -> Plant:
    """Return a `Plant` from a linear system of scipy or python-control.

    Args:
        system: state space (any object with A, B, C, D) or transfer function, with D = 0. A
            system in discrete time is the zero-order hold of the plant, and needs its sample time.
        x0: initial state (n) (default: 0).

    Returns:
        The plant, given by its matrices A, B, C.

    Raises:
        InputError: no such system, an unknown sample time, a discrete system that is no zero-order
            hold, or a direct feedthrough D != 0.

    Example:
        >>> import scipy.signal
        >>> uz.from_scipy(scipy.signal.TransferFunction([1.0], [1.0, 2.0, 1.0])).A
        array([[-2., -1.],
               [ 1.,  0.]])

    See Also:
        from_control, Plant
    """
    Ts = getattr(system, "dt", None) or 0.0
    if Ts is True:
        raise InputError(
            "plant: the discrete system has no sample time (dt = True). Set it in seconds, "
            "control.ss(..., dt=0.01)"
        )
    system = to_state_space(system, "plant", "Plant")
    if np.any(np.asarray(system.D)):
        raise InputError(
            "plant: D must be 0, an output deadzone with direct feedthrough is not supported"
        )
    linear = Matrices(np.asarray(system.A), np.asarray(system.B), np.asarray(system.C))
    A, B, C = undo_zoh(linear, Ts) if Ts else linear
    return Plant(A=A, B=B, C=C, x0=x0)


def to_state_space(system: Any, key: str, options: str) -> Any:
    """Return a linear system of scipy or python-control as state space.

    Args:
        system: state space or transfer function.
        key: of the table that it is for, for messages.
        options: that take its matrices, for messages.

    Raises:
        InputError: no such system.
    """
    if all(hasattr(system, name) for name in "ABCD"):
        return system
    try:
        if hasattr(system, "to_ss"):
            return system.to_ss()
        if hasattr(system, "num") and hasattr(system, "den"):
            import control

            return control.ss(system)
    except (ValueError, TypeError, NotImplementedError, ImportError) as error:
        raise InputError(f"{key}: this transfer function has no state space: {error}") from None
    raise InputError(
        f"{key}: expected a state space or a transfer function of scipy or python-control, found "
        f"{type(system).__name__}. Matrices go to uz.{options}(A=..., B=..., C=...)"
    )


from_scipy = from_statespace
from_control = from_statespace


def to_scipy(plant: Plant) -> Any:
    """Return the plant as `scipy.signal.StateSpace`.

    Args:
        plant: a linear plant in any form.

    Returns:
        The state-space object, with D = 0.

    Raises:
        InputError: the plant is nonlinear, or its numbers are wrong.
    """
    from scipy.signal import StateSpace

    A, B, C = linear_matrices(plant)
    return StateSpace(A, B, C, np.zeros((C.shape[0], B.shape[1])))
