"""References and disturbances as outputs of a linear exosystem w' = S w, r = Q w (piecewise where they have corners)."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from fractions import Fraction
from typing import NamedTuple

import msgspec
import numpy as np

from undeadzone.errors import FileError, InputError
from undeadzone.signals.paths import Circle, FigureEight, Path, Quintic, curve
from undeadzone.support.arrays import Array, Floats, scalar, vector
from undeadzone.support.files import reason


class Exosystem(NamedTuple):
    """w' = S w between corners and r = Q w; state(t): w at times t (len(t) x k).

    period [s]: of r, None where it has none; corners [s]: where w jumps, of the first period if there is one.
    """

    S: Floats
    Q: Floats
    state: Callable[[Floats], Floats]
    period: float | None = None
    corners: Floats = np.empty(0)

    def value(self, t: Floats, derivative: int = 0) -> Floats:
        """r, or its derivative of the given order, at times t [s] (len(t) x channels)."""
        return self.state(t) @ (self.Q @ np.linalg.matrix_power(self.S, derivative)).T


class Tone(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """amplitude * sin(2 pi frequency t + phase); frequency [Hz], phase [rad]."""

    amplitude: Array
    frequency: float
    phase: Array = 0.0


class Sine(
    Tone, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="sine"
):
    """One sine about an offset."""

    offset: Array = 0.0


class Sines(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="kind",
    tag="sines",
):
    """A sum of sines about an offset."""

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
    """`before` until `time` [s], then `amplitude`."""

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
    """Periodic trapezoid: rise [s] to +amplitude, hold [s], fall to -amplitude, hold, and so on, starting at 0."""

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
    """A CSV file with a time column [s] and one column per channel; held at its ends.

    smooth: cubic spline through the samples, else straight lines. The path is relative to the scenario file.
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
    """Seeded Gaussian noise of given rms and correlation time [s] (first-order); a disturbance only."""

    rms: Array
    correlation_time: float


Signal = Sine | Sines | Step | Trapezoid | Samples | Path
Disturbance = Sine | Sines | Step | Trapezoid | Samples | Random


def exosystem(key: str, signal: Signal, channels: int, task: bool = False) -> Exosystem:
    """The exosystem of a signal with that many channels; task: these are coordinates of an arm's tip.

    Raises InputError, ShapeError, FileError.
    """
    why = f"one per channel, there are {channels}"
    match signal:
        case Sines():
            if not signal.components:
                raise InputError(f"{key}.components: expected at least one sine, found none")
            return _tones(
                key,
                [f"{key}.components[{i}]" for i in range(len(signal.components))],
                signal.components,
                signal.offset,
                channels,
            )
        case Sine():
            return _tones(key, [key], [signal], signal.offset, channels)
        case Step():
            before, after = (
                vector(f"{key}.{name}", getattr(signal, name), channels, why)
                for name in ("before", "amplitude")
            )
            time = scalar(f"{key}.time", signal.time)
            return Exosystem(
                np.zeros((channels, channels)),
                np.eye(channels),
                lambda t: np.where(t[:, None] >= time, after, before),
                corners=np.array([time]),
            )
        case Trapezoid():
            return _trapezoid(
                key, signal, vector(f"{key}.amplitude", signal.amplitude, channels, why)
            )
        case Samples():
            t, values = read_csv(key, signal.path, channels)
            return piecewise(
                _spline(t, values) if signal.smooth and t.size > 2 else _lines(t, values), channels
            )._replace(corners=t)
        case Quintic() | Circle() | FigureEight():
            if signal.space == "task" and not task:
                raise InputError(
                    f"{key}.space: task, the coordinates of an arm's tip, needs a plant with an arm (plant.arm); use space = 'joint'"
                )
            derivatives, closure, corners, period = curve(key, signal, channels)
            return piecewise(derivatives, channels, closure)._replace(
                corners=corners, period=period
            )


def _tones(key: str, keys: list[str], tones: list[Tone], offset: Array, channels: int) -> Exosystem:
    why = f"one per channel, there are {channels}"
    constant = vector(f"{key}.offset", offset, channels, why)
    omegas, gains = [], []
    for name, tone in zip(keys, tones, strict=True):
        amplitude, phase = (
            vector(f"{name}.{part}", getattr(tone, part), channels, why)
            for part in ("amplitude", "phase")
        )
        omega = 2 * np.pi * scalar(f"{name}.frequency", tone.frequency, above=0.0)
        omegas.append(omega)
        gains += [amplitude * np.cos(phase), amplitude * np.sin(phase)]
    if constant.any():
        gains.append(constant)
    rates = np.array(omegas)
    S = np.zeros((len(gains), len(gains)))
    waves = 2 * np.arange(rates.size)
    S[waves, waves + 1], S[waves + 1, waves] = rates, -rates

    def state(t: Floats) -> Floats:
        angle = np.outer(t, rates)
        pairs = np.stack([np.sin(angle), np.cos(angle)], axis=2).reshape(t.size, 2 * rates.size)
        return np.hstack([pairs, np.ones((t.size, 1))]) if constant.any() else pairs

    return Exosystem(
        S, np.stack(gains, axis=1), state, _common_period([tone.frequency for tone in tones])
    )


def _common_period(frequencies: list[float]) -> float | None:
    """The least common period [s] of frequencies [Hz]; None if their ratios are not those of whole numbers up to 1000."""
    ratios = [Fraction(f / frequencies[0]).limit_denominator(1000) for f in frequencies]
    if any(
        abs(f / frequencies[0] - ratio) > 1e-12 * ratio
        for f, ratio in zip(frequencies, ratios, strict=True)
    ):
        return None
    cycles = Fraction(
        math.lcm(*(ratio.denominator for ratio in ratios)),
        math.gcd(*(ratio.numerator for ratio in ratios)),
    )
    return float(cycles) / frequencies[0]


def piecewise(
    derivatives: Callable[[Floats], Floats], channels: int, closure: Floats | None = None
) -> Exosystem:
    """An exosystem of derivatives: derivatives(t) gives len(t) x order x channels, the value and its derivatives.

    closure: the derivative that follows the last, as a combination of those (order); default: 0, as of polynomials.
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


def _trapezoid(key: str, signal: Trapezoid, amplitude: Floats) -> Exosystem:
    rise = scalar(f"{key}.rise", signal.rise, above=0.0)
    hold = scalar(f"{key}.hold", signal.hold, least=0.0)
    corners = np.cumsum([0.0, rise, hold, 2 * rise, hold, rise])
    levels = np.array([0.0, 1.0, 1.0, -1.0, -1.0, 0.0])
    slopes = np.diff(levels) / np.where(np.diff(corners) > 0, np.diff(corners), np.inf)

    def derivatives(t: Floats) -> Floats:
        phase = np.mod(t, corners[-1])
        piece = np.clip(np.searchsorted(corners, phase, side="right") - 1, 0, 4)
        value = levels[piece] + slopes[piece] * (phase - corners[piece])
        return np.stack([value, slopes[piece]], axis=1)[:, :, None] * amplitude

    return piecewise(derivatives, amplitude.size)._replace(
        period=float(corners[-1]), corners=corners
    )


def _lines(t: Floats, values: Floats) -> Callable[[Floats], Floats]:
    slopes = np.diff(values, axis=0) / np.diff(t)[:, None]

    def derivatives(at: Floats) -> Floats:
        inside = np.clip(at, t[0], t[-1])
        piece = np.clip(np.searchsorted(t, inside, side="right") - 1, 0, t.size - 2)
        moving = ((at >= t[0]) & (at < t[-1]))[:, None]
        return np.stack(
            [values[piece] + slopes[piece] * (inside - t[piece])[:, None], slopes[piece] * moving],
            axis=1,
        )

    return derivatives


def _spline(t: Floats, values: Floats) -> Callable[[Floats], Floats]:
    from scipy.interpolate import CubicSpline

    curve = CubicSpline(t, values, bc_type="natural" if t.size < 4 else "not-a-knot")

    def derivatives(at: Floats) -> Floats:
        inside = np.clip(at, t[0], t[-1])
        moving = ((at >= t[0]) & (at <= t[-1]))[:, None]
        return np.stack(
            [curve(inside, order) * (1.0 if order == 0 else moving) for order in range(4)], axis=1
        )

    return derivatives


def read_csv(key: str, path: str, channels: int) -> tuple[Floats, Floats]:
    """(t, values) of a CSV file: time first, then one column per channel; a header line is allowed. Raises FileError."""
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            rows = [row for row in csv.reader(file) if row and not row[0].lstrip().startswith("#")]
    except UnicodeDecodeError:
        raise FileError(f"{key}.path: cannot read {path}: not UTF-8 text") from None
    except (OSError, ValueError, csv.Error) as error:
        raise FileError(f"{key}.path: cannot read {path}: {reason(error)}") from None
    if rows and all(_number(cell) is None for cell in rows[0]):
        rows = rows[1:]
    if not rows:
        raise FileError(f"{key}.path: {path} holds no samples")
    for number, row in enumerate(rows, 1):
        if len(row) != channels + 1:
            found, values = (
                f"{len(row)} column{'s' * (len(row) != 1)}",
                f"{channels} value{'s' * (channels != 1)}",
            )
            raise FileError(
                f"{key}.path: {path}: sample {number} has {found}, expected {channels + 1} (time and {values}, separated by commas)"
            )
        if not all((value := _number(cell)) is not None and math.isfinite(value) for cell in row):
            raise FileError(
                f"{key}.path: {path}: sample {number} is not all finite numbers: {','.join(row):.60}"
            )
    table = np.array(rows, float)
    if table.shape[0] < 2 or (np.diff(table[:, 0]) <= 0).any():
        raise FileError(f"{key}.path: {path}: needs two samples or more, with time increasing")
    return table[:, 0], table[:, 1:]


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None
