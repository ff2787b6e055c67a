"""References and disturbances as data, from which the page computes their values at any time."""

from __future__ import annotations

from typing import Any

import numpy as np

from undeadzone.errors import InputError
from undeadzone.feedforward.targets import steady_state
from undeadzone.scenario.problem import Problem
from undeadzone.signals.exosystem import Exosystem, Sine, Sines, Step, Trapezoid
from undeadzone.simulation.exogenous import targets
from undeadzone.support.arrays import Floats

SAMPLES = 512  # of a period, for a Fourier series
NEGLIGIBLE = 1e-16  # share of a harmonic in the signal below which it is left out
SERIES = 1e-10  # largest error of the series, relative to the signal's size


def reference(problem: Problem) -> dict[str, Any]:
    """The target (r, x_ref, u_ff) along the run.

    Args:
        problem: the checked parts of a scenario.

    Raises:
        InputError: a kind of signal that the page does not draw.
        TrackingError: the plant cannot follow the reference.
    """
    if problem.model.nonlinear:
        return _harmonics(problem)
    signal, exo = problem.scenario.reference, problem.reference
    Pi, Gamma = steady_state(problem.model, exo, problem.tracked)
    return _data("reference", signal, exo, np.vstack([exo.Q, Pi, Gamma]))


def period(problem: Problem) -> float | None:
    """The period of the reference [s]; None: it has none."""
    return problem.reference.period if problem.path is None else problem.path.period


def _harmonics(problem: Problem) -> dict[str, Any]:
    """A periodic target as a Fourier series, checked between the samples that it was made of."""
    length = period(problem)
    if length is None:
        raise InputError(
            "reference: of a nonlinear plant the page draws periodic references only; take a sine, "
            "or a circle or figure eight of an arm"
        )
    t = np.arange(SAMPLES) * length / SAMPLES
    rows = np.hstack(targets(problem, t))
    spectrum = np.fft.rfft(rows, axis=0)[: SAMPLES // 4] / SAMPLES
    size = np.abs(rows).max()
    used = np.flatnonzero(np.abs(spectrum).max(axis=1) > NEGLIGIBLE * size)
    waves = used[used > 0]
    columns = []
    for wave in waves:
        columns += [-2 * spectrum[wave].imag, 2 * spectrum[wave].real]
    gains = np.stack([*columns, spectrum[0].real], axis=1)
    omegas = 2 * np.pi * waves / length
    between = t + 0.5 * length / SAMPLES
    angles = np.outer(between, omegas)
    state = np.stack([np.sin(angles), np.cos(angles)], axis=2).reshape(SAMPLES, 2 * waves.size)
    series = np.hstack([state, np.ones((SAMPLES, 1))]) @ gains.T
    if np.abs(series - np.hstack(targets(problem, between))).max() > SERIES * size:
        raise InputError(
            "reference: the state that belongs to it has corners, which the page does not draw "
            "for a nonlinear plant; take a smooth reference"
        )
    return {"gains": gains.tolist(), "omegas": omegas.tolist(), "offset": True}


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
