"""References and disturbances as outputs of a linear exosystem w' = S w, r = Q w.

The exosystem is linear in pieces where the signal has corners.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import msgspec
import numpy as np

from undeadzone.errors import InputError
from undeadzone.signals import shapes
from undeadzone.signals.csv_file import read_csv
from undeadzone.signals.paths import Circle, FigureEight, Path, Quintic, curve
from undeadzone.signals.periods import common_period
from undeadzone.support.arrays import Array, Floats, scalar, vector


class Exosystem(NamedTuple):
    """w' = S w between corners and r = Q w, of k states.

    Attributes:
        S: dynamics of the states (k x k) [1/s].
        Q: gain of the output (channels x k).
        state: t (N) [s] -> w at times t (N x k).
        period: period of r [s], None where it has none.
        corners: times at which w jumps [s], those of the first period if there is one.
    """

    S: Floats
    Q: Floats
    state: Callable[[Floats], Floats]
    period: float | None = None
    corners: Floats = np.empty(0)

    def value(self, t: Floats, derivative: int = 0) -> Floats:
        """r, or its derivative of that order, at times t [s] (len(t) x channels)."""
        return self.state(t) @ (self.Q @ np.linalg.matrix_power(self.S, derivative)).T


class Tone(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """amplitude * sin(2 pi frequency t + phase).

    Attributes:
        amplitude: one number or one per channel.
        frequency: frequency of the sine [Hz].
        phase: phase at t = 0, one number or one per channel [rad].
    """

    amplitude: Array
    frequency: float
    phase: Array = 0.0


class Sine(
    Tone, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="sine"
):
    """One sine about an offset.

    Attributes:
        offset: constant added to the sine, one number or one per channel.
    """

    offset: Array = 0.0


class Sines(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="kind",
    tag="sines",
):
    """A sum of sines about an offset.

    Attributes:
        components: the sines, each with amplitude, frequency and phase.
        offset: constant added to the sines, one number or one per channel.
    """

    components: list[Tone]
    offset: Array = 0.0


class Step(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="kind",
    tag="step",
):
    """A step from one constant value to another.

    Attributes:
        amplitude: the value after the step, one number or one per channel.
        time: time of the step [s].
        before: the value before the step, one number or one per channel.
    """

    amplitude: Array
    time: float = 0.0
    before: Array = 0.0


class Trapezoid(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="kind",
    tag="trapezoid",
):
    """A periodic trapezoid.

    It rises to +amplitude, holds, falls to -amplitude, holds, and so on, starting at 0.

    Attributes:
        amplitude: greatest value, one number or one per channel.
        rise: time from 0 to the amplitude [s].
        hold: time at the amplitude [s].
    """

    amplitude: Array
    rise: float
    hold: float


class Samples(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="kind",
    tag="csv",
):
    """Samples in a CSV file, held at its ends.

    Attributes:
        path: the file, relative to the scenario's: a time column [s] and one column per channel.
        smooth: a cubic spline through the samples, else straight lines.
    """

    path: str
    smooth: bool = True


class Random(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="kind",
    tag="random",
):
    """Seeded Gaussian noise, first-order; a disturbance only.

    Attributes:
        rms: rms of the noise, one number or one per channel.
        correlation_time: correlation time of the noise [s].
    """

    rms: Array
    correlation_time: float


Signal = Sine | Sines | Step | Trapezoid | Samples | Path
Disturbance = Sine | Sines | Step | Trapezoid | Samples | Random


def exosystem(key: str, signal: Signal, channels: int, task: bool = False) -> Exosystem:
    """The exosystem of a signal.

    Args:
        key: name of the signal in messages.
        signal: the signal in words.
        channels: number of channels.
        task: whether the channels are coordinates of an arm's tip.

    Raises:
        InputError: or a subclass, that names the key.
    """
    match signal:
        case Sines():
            if not signal.components:
                raise InputError(f"{key}.components: expected at least one sine, found none")
            keys = [f"{key}.components[{i}]" for i in range(len(signal.components))]
            return _tones(key, keys, signal.components, signal.offset, channels)
        case Sine():
            return _tones(key, [key], [signal], signal.offset, channels)
        case Step():
            return _step(key, signal, channels)
        case Trapezoid():
            return _trapezoid(key, signal, channels)
        case Samples():
            return _samples(key, signal, channels)
        case Quintic() | Circle() | FigureEight():
            if signal.space == "task" and not task:
                raise InputError(
                    f"{key}.space: task, the coordinates of an arm's tip, needs a plant with an "
                    "arm (plant.arm); use space = 'joint'"
                )
            path = curve(key, signal, channels)
            exo = piecewise(path.derivatives, channels, path.closure)
            return exo._replace(corners=path.corners, period=path.period)


def piecewise(
    derivatives: shapes.Derivatives, channels: int, closure: Floats | None = None
) -> Exosystem:
    """An exosystem whose states are a value and its derivatives.

    Args:
        derivatives: t (N) [s] -> the value and its derivatives (N x order x channels).
        channels: number of channels.
        closure: the derivative that follows the last, as a combination of those (order); default:
            0, as of polynomials.
    """
    order = derivatives(np.zeros(1)).shape[1]
    identity = np.eye(channels)
    shift = np.eye(order, k=1)
    if closure is not None:
        shift[-1] = closure
    return Exosystem(
        np.kron(shift, identity),
        np.kron(np.eye(order)[:1], identity),
        lambda t: derivatives(t).reshape(t.size, order * channels),
    )


def _per_channel(key: str, value: Array, channels: int) -> Floats:
    """One number per channel, checked."""
    return vector(key, value, channels, f"one per channel, there are {channels}")


def _tones(key: str, keys: list[str], tones: list[Tone], offset: Array, channels: int) -> Exosystem:
    """The exosystem of a sum of sines about an offset: two states a sine, and 1 for an offset."""
    constant = _per_channel(f"{key}.offset", offset, channels)
    omegas, gains = [], []
    for name, tone in zip(keys, tones, strict=True):
        amplitude = _per_channel(f"{name}.amplitude", tone.amplitude, channels)
        phase = _per_channel(f"{name}.phase", tone.phase, channels)
        omega = 2 * np.pi * scalar(f"{name}.frequency", tone.frequency, above=0.0)
        omegas.append(omega)
        gains += [amplitude * np.cos(phase), amplitude * np.sin(phase)]
    if constant.any():
        gains.append(constant)
    rates = np.array(omegas)
    S = np.zeros((len(gains), len(gains)))
    waves = 2 * np.arange(rates.size)  # where the two states of each sine begin
    S[waves, waves + 1], S[waves + 1, waves] = rates, -rates

    def state(t: Floats) -> Floats:
        angle = np.outer(t, rates)
        pairs = np.stack([np.sin(angle), np.cos(angle)], axis=2).reshape(t.size, 2 * rates.size)
        return np.hstack([pairs, np.ones((t.size, 1))]) if constant.any() else pairs

    period = common_period([tone.frequency for tone in tones])
    return Exosystem(S, np.stack(gains, axis=1), state, period)


def _step(key: str, signal: Step, channels: int) -> Exosystem:
    """The exosystem of a step, constant on either side."""
    before = _per_channel(f"{key}.before", signal.before, channels)
    after = _per_channel(f"{key}.amplitude", signal.amplitude, channels)
    time = scalar(f"{key}.time", signal.time)
    return Exosystem(
        np.zeros((channels, channels)),
        np.eye(channels),
        lambda t: np.where(t[:, None] >= time, after, before),
        corners=np.array([time]),
    )


def _trapezoid(key: str, signal: Trapezoid, channels: int) -> Exosystem:
    """The exosystem of a trapezoid."""
    amplitude = _per_channel(f"{key}.amplitude", signal.amplitude, channels)
    rise = scalar(f"{key}.rise", signal.rise, above=0.0)
    hold = scalar(f"{key}.hold", signal.hold, least=0.0)
    corners = np.cumsum([0.0, rise, hold, 2 * rise, hold, rise])
    exo = piecewise(shapes.trapezoid(corners, amplitude), channels)
    return exo._replace(period=float(corners[-1]), corners=corners)


def _samples(key: str, signal: Samples, channels: int) -> Exosystem:
    """The exosystem of samples in a file."""
    t, values = read_csv(key, signal.path, channels)
    smooth = signal.smooth and t.size > 2
    derivatives = shapes.spline(t, values) if smooth else shapes.lines(t, values)
    return piecewise(derivatives, channels)._replace(corners=t)
