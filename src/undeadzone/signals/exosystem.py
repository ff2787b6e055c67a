"""References and disturbances as outputs of a linear exosystem w' = S w, r = Q w.

The exosystem is linear in pieces if the signal has corners: a trapezoid, straight lines, a spline,
also through the samples of a CSV file (time first, then one column per channel). A piece is a
function `derivatives(t)` of the value and its derivatives (len(t) x order x channels).
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from undeadzone.errors import FileError, InputError
from undeadzone.signals.paths import Circle, FigureEight, Path, Quintic, build_curve
from undeadzone.util.arrays import Array, Floats, require_number, require_vector
from undeadzone.util.files import LARGEST_TABLE, convert_read_errors, read_text
from undeadzone.util.toml import Kind, OptionTable

Derivatives = Callable[[Floats], Floats]


def common_period(frequencies: list[float]) -> float | None:
    """Return the least common period of frequencies [s], or None.

    None if their ratios are not those of whole numbers up to 1000.
    """
    first = frequencies[0]
    ratios = [Fraction(frequency / first).limit_denominator(1000) for frequency in frequencies]
    for frequency, ratio in zip(frequencies, ratios, strict=True):
        if abs(frequency / first - ratio) > 1e-12 * ratio:
            return None
    cycles = Fraction(
        math.lcm(*(ratio.denominator for ratio in ratios)),
        math.gcd(*(ratio.numerator for ratio in ratios)),
    )
    return float(cycles) / first


class Exosystem(NamedTuple):
    """Linear system w' = S w between corners and r = Q w, of k states.

    Attributes:
        S: dynamics of the states (k x k) [1/s].
        Q: gain of the output (channels x k).
        state: t (N) [s] -> w at times t (N x k).
        period: period of r [s], None if it has none.
        corners: times at which w jumps [s], those of the first period if there is one.
    """

    S: Floats
    Q: Floats
    state: Callable[[Floats], Floats]
    period: float | None = None
    corners: Floats = np.empty(0)

    def output_at(self, t: Floats, derivative: int = 0) -> Floats:
        """Return r, or its derivative of the given order, at times t [s] (len(t) x
        channels).
        """
        return self.state(t) @ (self.Q @ np.linalg.matrix_power(self.S, derivative)).T


class Tone(OptionTable, frozen=True, kw_only=True):
    """Sine amplitude * sin(2 pi frequency t + phase).

    Attributes:
        amplitude: one number or one per channel.
        frequency: frequency of the sine [Hz].
        phase: phase at t = 0, one number or one per channel [rad].
    """

    amplitude: Array
    frequency: float
    phase: Array = 0.0


class Sine(Tone, frozen=True, kw_only=True, tag_field="kind", tag="sine"):
    """Sine about an offset.

    Example:
        >>> reference = uz.Sine(amplitude=5.0, frequency=0.2)
        >>> reference.frequency
        0.2

    See Also:
        Step, Trapezoid, Sines, Samples

    Attributes:
        offset: constant added to the sine, one number or one per channel.
    """

    offset: Array = 0.0


class Sines(Kind, frozen=True, kw_only=True, tag="sines"):
    """Sum of sines about an offset.

    Attributes:
        components: the sines, each with amplitude, frequency and phase.
        offset: constant added to the sines, one number or one per channel.
    """

    components: list[Tone]
    offset: Array = 0.0


class Step(Kind, frozen=True, kw_only=True, tag="step"):
    """Step from a constant value to another.

    Example:
        >>> uz.Step(amplitude=1.0, time=0.5).time
        0.5

    See Also:
        Sine, Trapezoid

    Attributes:
        amplitude: the value after the step, one number or one per channel.
        time: time of the step [s].
        before: the value before the step, one number or one per channel.
    """

    amplitude: Array
    time: float = 0.0
    before: Array = 0.0


class Trapezoid(Kind, frozen=True, kw_only=True, tag="trapezoid"):
    """Periodic trapezoid.

    It rises to +amplitude, holds, falls to -amplitude, holds, and so on, starting at 0.

    Example:
        >>> uz.Trapezoid(amplitude=2.0, rise=1.0, hold=1.5).hold
        1.5

    See Also:
        Sine, Step

    Attributes:
        amplitude: greatest value, one number or one per channel.
        rise: time from 0 to the amplitude [s].
        hold: time at the amplitude [s].
    """

    amplitude: Array
    rise: float
    hold: float


class Samples(Kind, frozen=True, kw_only=True, tag="csv"):
    """Samples in a CSV file, constant beyond its ends.

    Attributes:
        path: the file, relative to the scenario's: a time column [s] and one column per channel.
        smooth: a cubic spline through the samples, else straight lines.
    """

    path: str
    smooth: bool = True


class Random(Kind, frozen=True, kw_only=True, tag="random"):
    """Seeded Gaussian noise, first-order, for a disturbance only.

    Example:
        >>> uz.Random(rms=0.2, correlation_time=0.5).rms
        0.2

    See Also:
        Scenario

    Attributes:
        rms: rms of the noise, one number or one per channel.
        correlation_time: correlation time of the noise [s].
    """

    rms: Array
    correlation_time: float


Signal = Sine | Sines | Step | Trapezoid | Samples | Path
Disturbance = Sine | Sines | Step | Trapezoid | Samples | Random


def build_exosystem(key: str, signal: Signal, channels: int, task: bool = False) -> Exosystem:
    """Build the exosystem of a signal.

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
            return _tones_exosystem(key, keys, signal.components, signal.offset, channels)
        case Sine():
            return _tones_exosystem(key, [key], [signal], signal.offset, channels)
        case Step():
            return _step_exosystem(key, signal, channels)
        case Trapezoid():
            return _trapezoid_exosystem(key, signal, channels)
        case Samples():
            return _samples_exosystem(key, signal, channels)
        case Quintic() | Circle() | FigureEight():
            if signal.space == "task" and not task:
                raise InputError(
                    f"{key}.space: task, the coordinates of an arm's tip, needs a plant with an "
                    "arm (plant.arm). Use space = 'joint'"
                )
            if getattr(signal, "swing", None) is not None and not task:
                raise InputError(
                    f"{key}.swing: joints swing ahead of a path of an arm's tip. Set space = 'task'"
                )
            path = build_curve(key, signal, channels)
            exo = piecewise_exosystem(path.derivatives, channels, path.closure)
            return exo._replace(corners=path.corners, period=path.period)


def piecewise_exosystem(
    derivatives: Derivatives, channels: int, closure: Floats | None = None
) -> Exosystem:
    """Return an exosystem whose states are a value and its derivatives.

    Args:
        derivatives: t (N) [s] -> the value and its derivatives (N x order x channels).
        channels: number of channels.
        closure: the derivative that follows the last, as a combination of those (order) (default:
            0, as of polynomials).
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


def _require_per_channel(key: str, value: Array, channels: int) -> Floats:
    """Return a number per channel, or raise."""
    return require_vector(key, value, channels, f"one per channel, there are {channels}")


def _tones_exosystem(
    key: str, keys: list[str], tones: list[Tone], offset: Array, channels: int
) -> Exosystem:
    """Return the exosystem of a sum of sines about an offset.

    States: two per sine, and 1 for an offset.
    """
    constant = _require_per_channel(f"{key}.offset", offset, channels)
    omegas = []
    gains = []
    for name, tone in zip(keys, tones, strict=True):
        amplitude = _require_per_channel(f"{name}.amplitude", tone.amplitude, channels)
        phase = _require_per_channel(f"{name}.phase", tone.phase, channels)
        omega = 2 * np.pi * require_number(f"{name}.frequency", tone.frequency, above=0.0)
        omegas.append(omega)
        gains += [amplitude * np.cos(phase), amplitude * np.sin(phase)]
    if constant.any():
        gains.append(constant)
    rates = np.array(omegas)
    S = np.zeros((len(gains), len(gains)))
    waves = 2 * np.arange(rates.size)  # first index of the two states of each sine
    S[waves, waves + 1] = rates
    S[waves + 1, waves] = -rates

    def state(t: Floats) -> Floats:
        """Return the states at times t [s] (N x k)."""
        angle = np.outer(t, rates)
        pairs = np.stack([np.sin(angle), np.cos(angle)], axis=2).reshape(t.size, 2 * rates.size)
        return np.hstack([pairs, np.ones((t.size, 1))]) if constant.any() else pairs

    period = common_period([tone.frequency for tone in tones])
    return Exosystem(S, np.stack(gains, axis=1), state, period)


def _step_exosystem(key: str, signal: Step, channels: int) -> Exosystem:
    """Return the exosystem of a step, constant on either side."""
    before = _require_per_channel(f"{key}.before", signal.before, channels)
    after = _require_per_channel(f"{key}.amplitude", signal.amplitude, channels)
    time = require_number(f"{key}.time", signal.time)
    return Exosystem(
        np.zeros((channels, channels)),
        np.eye(channels),
        lambda t: np.where(t[:, None] >= time, after, before),
        corners=np.array([time]),
    )


def _trapezoid_exosystem(key: str, signal: Trapezoid, channels: int) -> Exosystem:
    """Return the exosystem of a trapezoid."""
    amplitude = _require_per_channel(f"{key}.amplitude", signal.amplitude, channels)
    rise = require_number(f"{key}.rise", signal.rise, above=0.0)
    hold = require_number(f"{key}.hold", signal.hold, least=0.0)
    corners = np.cumsum([0.0, rise, hold, 2 * rise, hold, rise])
    exo = piecewise_exosystem(trapezoid_derivatives(corners, amplitude), channels)
    return exo._replace(period=float(corners[-1]), corners=corners)


def _samples_exosystem(key: str, signal: Samples, channels: int) -> Exosystem:
    """Return the exosystem of samples in a file."""
    t, values = read_csv(key, signal.path, channels)
    smooth = signal.smooth and t.size > 2
    derivatives = spline_derivatives(t, values) if smooth else line_derivatives(t, values)
    return piecewise_exosystem(derivatives, channels)._replace(corners=t)


def trapezoid_derivatives(corners: Floats, amplitude: Floats) -> Derivatives:
    """Return a periodic trapezoid between plus and minus its amplitude, with a derivative.

    Args:
        corners: times of its corners in one period, the first at 0 (6) [s].
        amplitude: amplitude of each channel (channels).
    """
    once = line_derivatives(corners, np.array([[0.0], [1.0], [1.0], [-1.0], [-1.0], [0.0]]))
    return lambda t: once(np.mod(t, corners[-1])) * amplitude


def line_derivatives(t: Floats, values: Floats) -> Derivatives:
    """Return straight lines between samples, with a derivative (constant beyond the ends).

    Args:
        t: times of the samples (N) [s]. If two are the same, the later sample counts.
        values: the samples (N x channels).
    """
    spans = np.diff(t)[:, None]
    slopes = np.diff(values, axis=0) / np.where(spans > 0, spans, np.inf)

    def derivatives(at: Floats) -> Floats:
        """Return value and slope at times [s] (N x 2 x channels)."""
        inside = np.clip(at, t[0], t[-1])
        piece = np.clip(np.searchsorted(t, inside, side="right") - 1, 0, t.size - 2)
        moving = ((at >= t[0]) & (at < t[-1]))[:, None]
        value = values[piece] + slopes[piece] * (inside - t[piece])[:, None]
        return np.stack([value, slopes[piece] * moving], axis=1)

    return derivatives


def spline_derivatives(t: Floats, values: Floats) -> Derivatives:
    """Return a cubic spline through samples, with three derivatives (constant beyond the ends).

    Args:
        t: times of the samples (N) [s].
        values: the samples (N x channels).
    """
    from scipy.interpolate import CubicSpline

    curve = CubicSpline(t, values, bc_type="natural" if t.size < 4 else "not-a-knot")

    def derivatives(at: Floats) -> Floats:
        """Return value and three derivatives at times [s] (N x 4 x channels)."""
        inside = np.clip(at, t[0], t[-1])
        moving = ((at >= t[0]) & (at <= t[-1]))[:, None]
        slopes = [curve(inside, order) * moving for order in range(1, 4)]
        return np.stack([curve(inside, 0), *slopes], axis=1)

    return derivatives


def read_csv(key: str, path: str, channels: int) -> tuple[Floats, Floats]:
    """Read the samples in a CSV file. A header line and lines that start with # are allowed.

    Args:
        key: name of the signal in messages.
        path: the file.
        channels: number of columns beside that of time.

    Returns:
        Times (N) [s] and values (N x channels).

    Raises:
        FileError: the file cannot be read, or holds something else.
    """
    rows = _read_cells(key, path)
    if rows and all(_parse_number(cell) is None for cell in rows[0]):
        rows = rows[1:]
    if not rows:
        raise FileError(f"{key}.path: {path} holds no samples")
    for number, row in enumerate(rows, 1):
        _require_sample(f"{key}.path: {path}: sample {number}", row, channels)
    table = np.array(rows, float)
    if table.shape[0] < 2 or (np.diff(table[:, 0]) <= 0).any():
        raise FileError(f"{key}.path: {path}: needs two samples or more, with time increasing")
    return table[:, 0], table[:, 1:]


def _read_cells(key: str, path: str) -> list[list[str]]:
    """Read the cells of a CSV file without empty lines and comments. Raises FileError."""
    with convert_read_errors(f"{key}.path: {path}"):
        lines = io.StringIO(read_text(path, LARGEST_TABLE).removeprefix("\ufeff"), newline="")
        return [row for row in csv.reader(lines) if row and not row[0].lstrip().startswith("#")]


def _require_sample(where: str, row: list[str], channels: int) -> None:
    """Raise FileError unless a row holds a time and a value per channel, all finite."""
    if len(row) != channels + 1:
        columns = f"{len(row)} column{'s' * (len(row) != 1)}"
        values = f"{channels} value{'s' * (channels != 1)}"
        raise FileError(
            f"{where} has {columns}, expected {channels + 1} "
            f"(time and {values}, separated by commas)"
        )
    # The cell itself is not quoted: the scenario may name a file that is not its author's.
    for column, cell in enumerate(row, 1):
        value = _parse_number(cell)
        if value is None or not math.isfinite(value):
            raise FileError(f"{where} is not all finite numbers: see column {column}")


def _parse_number(text: str) -> float | None:
    """Return the number in a cell, or None."""
    try:
        return float(text)
    except ValueError:
        return None
