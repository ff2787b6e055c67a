"""Unknown disturbance of a declared kind, as constants and inputs with states of their own.

Its constant part, if it has one, may be anything. Of what swings, the sizes are taken for known,
the paths are not: a constant of its rms, beside a tone of each of its frequencies, or a random
signal of its rms and autocorrelation time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from undeadzone.signals.exosystem import (
    Disturbance,
    Random,
    Samples,
    Sine,
    Sines,
    Step,
    Tone,
    Trapezoid,
    build_exosystem,
)
from undeadzone.util.arrays import Array, Floats

CONSTANT = 0.01  # of samples' size, above which their mean counts as a constant
POINTS: Final = 4096  # of a run, at which a signal is looked at
LASTS: Final = 100.0  # runs that the correlation of a constant lasts
ROUNDING: Final = 1e-12  # share of a signal, up to which a channel does not swing


class InputModel(NamedTuple):
    """Unknown inputs with states of their own: w' = A w + white noise, x' = ... + B w.

    Attributes:
        A: their dynamics (b x b) [1/s].
        Q: intensity of the white noise (b x b), per second.
        B: how they enter x' (n x b), or x+ of a sampled model.
        rms: of each w at the start (b).
    """

    A: Floats
    Q: Floats
    B: Floats
    rms: Floats


def first_order_inputs(B: Floats, rms: Floats, correlation_time: float) -> InputModel:
    """Return first-order random inputs: w' = -w / correlation_time + white.

    Args:
        B: how they enter x' (n x b), or x+ of a sampled model.
        rms: of each (b).
        correlation_time: of all of them [s].
    """
    rate = 1 / correlation_time
    return InputModel(-rate * np.eye(rms.size), 2 * rate * np.diag(rms**2), B, rms)


def tone_inputs(B: Floats, amplitude: Floats, frequency: float) -> InputModel:
    """Return sines of a common frequency, with unknown amplitudes and phases.

    Args:
        B: how they enter x' (n x b), or x+ of a sampled model.
        amplitude: whose mean square each has (b).
        frequency: [Hz].
    """
    turn = 2 * np.pi * frequency * np.array([[0.0, 1.0], [-1.0, 0.0]])
    A = np.kron(np.eye(amplitude.size), turn)
    enters = np.kron(B, np.array([[1.0, 0.0]]))
    return InputModel(A, np.zeros_like(A), enters, np.repeat(amplitude / np.sqrt(2), 2))


def join_inputs(colours: Sequence[InputModel]) -> InputModel | None:
    """Return unknown inputs side by side, or None if the sequence is empty."""
    from scipy.linalg import block_diag

    if not colours:
        return None
    A, Q, B, rms = zip(*colours, strict=True)
    return InputModel(block_diag(*A), block_diag(*Q), np.hstack(B), np.concatenate(rms))


def unknown_bias(
    disturbance: Disturbance | None, B: Floats, duration: float = np.inf
) -> Floats | None:
    """Return the columns of B with a constant disturbance of any size (n x b), or None.

    The signal itself is judged, not its kind: what does not swing within the run is a constant.

    Args:
        disturbance: any (a random one leaves no bias).
        B: inputs (n x m).
        duration: of the run [s].

    Returns:
        The columns (n x b), or None if there is none.
    """
    biased = _has_constant(disturbance, B.shape[1], duration)
    return B[:, biased] if biased.any() else None


def unknown_constants(
    disturbance: Disturbance | None, m: int, duration: float
) -> tuple[Floats, Floats]:
    """Return a disturbance as constants alone, for plants whose runs carry no other
    disturbance.

    Args:
        disturbance: any.
        m: number of inputs.
        duration: of the run [s].

    Returns:
        The inputs that one acts on (m x b), and its rms, infinite if it may be of any size (b).
    """
    constant = _has_constant(disturbance, m, duration)
    rms = np.sqrt((_varying_part(disturbance, constant, duration) ** 2).mean(axis=0))
    if isinstance(disturbance, Random):  # its mean over the run acts like a constant
        share = min(1.0, 2 * disturbance.correlation_time / duration)
        rms = np.sqrt(share) * np.broadcast_to(disturbance.rms, m)
    rms = np.where(constant, np.inf, rms)
    return np.eye(m)[:, rms > 0], rms[rms > 0]


def unknown_inputs(
    disturbance: Disturbance | None, B: Floats, duration: float
) -> InputModel | None:
    """Return unknown inputs that model the varying part of a disturbance, or None.

    Each input has its tones or a first-order random signal. It also has a slow offset, correlated
    over `LASTS` runs, unless a constant is modelled elsewhere.

    Args:
        disturbance: of the scenario (None: there is none).
        B: inputs of the plant (n x m), of one step if sampled.
        duration: of the run [s].
    """
    m = B.shape[1]
    if isinstance(disturbance, Random):
        size = np.broadcast_to(np.asarray(disturbance.rms, float), m)
        memory = disturbance.correlation_time
        return join_inputs(
            [first_order_inputs(B[:, [j]], size[[j]], memory) for j in np.flatnonzero(size)]
        )
    constant = _has_constant(disturbance, m, duration)
    swing = _varying_part(disturbance, constant, duration)
    models = []
    for j in np.flatnonzero(swing.any(axis=0)):
        column = B[:, [j]]
        rms = np.sqrt((swing[:, [j]] ** 2).mean(axis=0))
        if not constant[j]:
            models.append(first_order_inputs(column, rms, LASTS * duration))
        tones = _sine_components(disturbance)
        for tone in tones:
            amplitude = np.broadcast_to(np.ravel(tone.amplitude), m)[[j]]
            models.append(tone_inputs(column, amplitude, tone.frequency))
        if not tones:
            memory = correlation_time(swing[:, j], duration / (POINTS - 1))
            models.append(first_order_inputs(column, rms, memory))
    return join_inputs(models)


def correlation_time(signal: Floats, step: float) -> float:
    """Return the time after which a signal's autocorrelation is below 1/e [s], at least a
    step.

    Args:
        signal: without its mean (N).
        step: time between two values [s].
    """
    spectrum = np.fft.rfft(signal, 2 * signal.size)
    correlation = np.fft.irfft(np.abs(spectrum) ** 2)[: signal.size]
    fallen = np.flatnonzero(correlation < correlation[0] / np.e)
    return step * float(fallen[0] if fallen.size else signal.size)


def _varying_part(disturbance: Disturbance | None, constant: np.ndarray, duration: float) -> Floats:
    """Return a disturbance at POINTS times of a run, without constants of any size (POINTS x
    m).

    Args:
        disturbance: any.
        constant: whether it has such a constant, of each input (m, bool).
        duration: of the run [s].
    """
    m = constant.size
    t = np.linspace(0.0, duration, POINTS)
    if disturbance is None or isinstance(disturbance, Random):
        return np.zeros((POINTS, m))
    values = build_exosystem("disturbance", disturbance, m).output_at(t)
    swing = values - np.where(constant, values.mean(axis=0), 0.0)
    return np.where(np.abs(swing).max(axis=0) > ROUNDING * np.abs(values).max(), swing, 0.0)


def _has_constant(disturbance: Disturbance | None, m: int, duration: float) -> np.ndarray:
    """Return whether a disturbance has a constant part of any size, for each input (m, bool).

    A tone or a trapezoid counts if its period is longer than the run, samples in a file if their
    mean over the run is a hundredth of their size.
    """
    parts: list[Array] = []
    match disturbance:
        case Step():
            parts = [disturbance.amplitude, disturbance.before]
        case Sine() | Sines():
            tones = _sine_components(disturbance)
            slow = [one.amplitude for one in tones if one.frequency * duration < 1]
            parts = [disturbance.offset, *slow]
        case Trapezoid():
            lasts = 4 * disturbance.rise + 2 * disturbance.hold > duration
            parts = [disturbance.amplitude] * lasts
        case Samples():
            signal = build_exosystem("disturbance", disturbance, m)
            end = duration if np.isfinite(duration) else max(float(signal.corners[-1]), 1.0)
            values = signal.output_at(np.linspace(0.0, end, POINTS))
            mean = np.abs(values.mean(axis=0))
            parts = [np.where(mean > CONSTANT * np.abs(values).max(axis=0), mean, 0.0)]
    found = np.zeros(m, bool)
    for part in parts:
        found |= np.ravel(part) != 0
    return found


def _sine_components(disturbance: Disturbance | None) -> list[Tone]:
    """Return the sines of a disturbance, without its offset."""
    if isinstance(disturbance, Sines):
        return disturbance.components
    return [disturbance] if isinstance(disturbance, Sine) else []
