"""Fitted plant in continuous time, in companion form, with the uncertainty of its entries."""

from __future__ import annotations

import numpy as np

from undeadzone.errors import InputError
from undeadzone.linalg.hold import undo_zoh
from undeadzone.linalg.matrices import Matrices, companion_form
from undeadzone.util.arrays import Floats
from undeadzone_identify.models.estimates import propagate_covariance
from undeadzone_identify.models.plant import Layout

SMALL = 1e-3  # a static gain below this part of the largest makes no good scale


def observer_matrices(a: Floats, b: Floats, layout: Layout) -> Matrices:
    """Return the sampled plant in observer form: x+ = F x + B u, z = first state.

    Args:
        a: denominator a_1, a_2, ... without its integrators.
        b: numerators from delay 1, input by input (m n), in units of y and u.
        layout: order, inputs and integrators.

    Returns:
        F (n x n), B (n x m), C (1 x n).
    """
    F = np.eye(layout.n, k=1)
    F[:, 0] = -layout.full_denominator(a)[1:]
    return Matrices(F, b.reshape(layout.m, layout.n).T.copy(), np.eye(1, layout.n))


def to_continuous_plant(a: Floats, b: Floats, layout: Layout, step: float) -> Matrices:
    """Convert to the plant that becomes the sampled plant under zero-order hold, in companion
    form.

    Args:
        a, b, layout: as for `observer_matrices`.
        step: sample time [s].

    Returns:
        A (n x n) in companion form, B (n x m), C (1 x n). For one input it is the controller form:
        B has an entry in its last row alone. For several it is the observer form: C = [1, 0, ...].

    Raises:
        InputError: a pole that no plant in continuous time has: negative and real, or a delay.
    """
    sampled = observer_matrices(a, b, layout)
    try:
        A, B, C = undo_zoh(sampled, step)
    except InputError as error:
        raise InputError(f"{error}. Try another --order, or sample faster") from None
    n = layout.n
    polynomial = np.real(np.poly(A))  # highest power first
    polynomial[n + 1 - layout.integrators :] = 0.0
    # Of the free motion z, z', ...; times B, the Markov parameters.
    T = np.vstack([C @ np.linalg.matrix_power(A, k) for k in range(n)])
    if layout.m > 1:
        return companion_form(polynomial[:0:-1])._replace(B=T @ B, C=np.eye(1, n))
    numerator = np.convolve(polynomial, (T @ B)[:, 0])[:n][::-1]  # lowest power first
    rates = np.abs(np.roots(polynomial)).max()
    reach = np.abs(numerator) * rates ** np.arange(n)
    scale = numerator[0] if abs(numerator[0]) > SMALL * reach.max() else 1.0
    form = companion_form(polynomial[:0:-1], numerator / scale)
    return form._replace(B=np.where(form.B > 0, scale, 0.0))


def continuous_with_spread(
    a: Floats, b: Floats, layout: Layout, step: float, V: Floats
) -> tuple[Matrices, Floats, Floats]:
    """Return the plant in continuous time and relative standard deviations of A and B.

    Args:
        a, b, layout, step: as for `continuous`.
        V: covariance of a and b together.

    Returns:
        The matrices, deviations of A (n x n) and of B (n x m); 0 for entries that are 0.

    Raises:
        InputError: as `continuous`.
    """
    plant = to_continuous_plant(a, b, layout, step)
    entries = np.hstack(plant[:2])

    def move_entries(move: Floats) -> Floats:
        """Return the change of A and B with that of a and b."""
        try:
            moved = to_continuous_plant(a + move[: a.size], b + move[a.size :], layout, step)
        except InputError:
            return np.zeros_like(entries)
        return np.hstack(moved[:2]) - entries

    variance = propagate_covariance(0.5 * (V + V.T), move_entries)
    size = np.abs(entries)
    spread = np.divide(np.sqrt(variance), size, out=np.zeros(size.shape), where=size > 0)
    return plant, spread[:, : layout.n], spread[:, layout.n :]
