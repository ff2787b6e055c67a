"""Logs of truths that `identify` was not built for, and of a few that it was."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import filtfilt, lfilter, medfilt

from undeadzone.util.arrays import Floats

STEP = 0.01
SIZE = 1200
WIDTHS = (0.5, 0.35)  # of the sensor's zones
BOTH = sum(WIDTHS)


class Strange(NamedTuple):
    """A log whose truth may be none of the candidates.

    Attributes:
        u, y: input and reading (N).
        options: of `identify`.
        width: of what the right words name; None where no width is asked.
    """

    u: Floats
    y: Floats
    options: dict[str, Any] = {}
    width: float | None = None


class Kind(NamedTuple):
    """A truth.

    Attributes:
        make: a log of it.
        right: the verdict's words that are right; where none is, only a withheld one is.
    """

    make: Callable[[np.random.Generator], Strange]
    right: tuple[str, ...]


def walk(rng: np.random.Generator, size: int = SIZE, hold: float = 8.0) -> Floats:
    """Coloured noise of rms 1."""
    u = lfilter([1.0], [1.0, -np.exp(-1 / hold)], rng.standard_normal(size))
    return np.asarray(u / u.std())


def lags(u: Floats, samples: float = 12.0, order: int = 2) -> Floats:
    """A plant of equal time constants, its output of rms 1."""
    keep = np.exp(-1 / samples)
    for _ in range(order):
        u = lfilter([0.0, 1 - keep], [1.0, -keep], u)
    return scaled(u)


def scaled(y: Floats) -> Floats:
    """An output of rms 1."""
    return np.asarray(y / y.std())


def zone(v: Floats, right: float = WIDTHS[0], left: float = WIDTHS[1]) -> Floats:
    """Dz(v)."""
    return np.asarray(np.maximum(v - right, 0.0) + np.minimum(v + left, 0.0))


def follow(z: Floats, step: Callable[[Any, Any], Any], begin: Any) -> Floats:
    """States, or rows of them, from the first to the one behind the last value (N + 1)."""
    return np.array(list(itertools.accumulate(z, step, initial=begin)))


def dragged(u: Floats, gap: float, begin: float | None = None) -> Floats:
    """What a play of that gap passes on; it begins at the first value if nowhere else."""
    at_first = float(u[0]) if begin is None else begin
    return follow(u, lambda at, v: min(max(at, v - gap / 2), v + gap / 2), at_first)[1:]


def rubbed(
    u: Floats,
    friction: float,
    push: Callable[[float, float, float], float],
    step: float,
    parts: int,
    begin: float = 0.0,
) -> Floats:
    """Positions of a body with Coulomb friction (N).

    Args:
        u: input (N).
        friction: as an acceleration.
        push: acceleration without friction, by input, position and speed.
        step: of the log [s].
        parts: of a step, in which it is simulated.
        begin: position at first.
    """
    y, x, v, h = np.empty(u.size), begin, 0.0, step / parts
    for k, value in enumerate(u):
        y[k] = x
        for _ in range(parts):
            a = push(value, x, v)
            if v == 0 and abs(a) <= friction:
                continue
            w = v + h * (a - np.sign(v or a) * friction)
            w = 0.0 if w * v < 0 else w
            x, v = x + h * (v + w) / 2, w
    return y


def noisy(rng: np.random.Generator, y: Floats, rms: float = 0.02) -> Floats:
    """With white noise."""
    return np.asarray(y + rms * rng.standard_normal(y.size))


def driven(
    answer: Callable[[Floats], Floats],
    right: tuple[str, ...],
    rms: float = 0.02,
    width: float | None = None,
    size: int = SIZE,
    hold: float = 8.0,
) -> Kind:
    """What answers to coloured noise, read with white noise."""

    def make(rng: np.random.Generator) -> Strange:
        u = walk(rng, size, hold)
        return Strange(u, noisy(rng, answer(u), rms), {}, width)

    return Kind(make, right)


def curved(curve: Callable[[Floats], Floats], right: tuple[str, ...]) -> Kind:
    """A plant behind a curve of its input."""
    return driven(lambda u: lags(curve(u)), right)


def sensed(
    read: Callable[[Floats], Floats], right: tuple[str, ...], width: float | None = None
) -> Kind:
    """A plant behind a sensor."""
    return driven(lambda u: read(lags(u)), right, 0.01, width)


def play_ahead(gap: float, samples: float) -> Kind:
    """Play between input and plant."""
    return driven(
        lambda u: lags(dragged(u, gap), samples, 1), ("input_play",), 0.02, gap, 2000, 30.0
    )


def sticking(u: Floats) -> Floats:
    """A valve that sticks, and slips by half as much when it moves."""

    def slip(at: float, value: float) -> float:
        return float(value - np.sign(value - at) * 0.25 if abs(value - at) > 0.5 else at)

    return lags(follow(u, slip, 0.0)[1:], 12.0, 1)


def joint(friction: float) -> Callable[[np.random.Generator], Strange]:
    """A joint's position by its torque, with Coulomb friction and no gap."""

    def make(rng: np.random.Generator) -> Strange:
        u = steps(rng, 2500)
        y = rubbed(u, 2.0 * friction / 0.1, lambda drive, _, v: (2.0 * drive - v) / 0.1, STEP, 40)
        return Strange(u, np.round(y / 2e-4) * 2e-4, {"integrators": 1})

    return make


def sines(rng: np.random.Generator, size: int, samples: float) -> Floats:
    """Three sines about a time constant of so many samples."""
    phases, t = rng.uniform(0, 6, 3), np.arange(size) / samples
    tones = zip((1, 0.7, 0.5), (0.7, 1.9, 4.1), phases, strict=True)
    return sum((a * np.sin(w * t + p) for a, w, p in tones), np.zeros(size))


def steps(
    rng: np.random.Generator, size: int, hold: int = 30, low: float = -1.0, high: float = 1.0
) -> Floats:
    """Random levels, each held for so many samples."""
    return np.repeat(rng.uniform(low, high, size // hold + 1), hold)[:size]


def driven_motor(u: Floats, samples: float) -> Floats:
    """The position of a linear motor whose time constant is so many samples."""
    keep = np.exp(-1 / samples)
    v = lfilter([0.0, 1 - keep], [1.0, -keep], u)
    return np.asarray(np.cumsum(np.append(0.0, v[:-1])))


def of_position(rng: np.random.Generator, u: Floats, y: Floats) -> Strange:
    """A position by its input, with noise of a few thousandths."""
    return Strange(u, noisy(rng, y, 0.003 * y.std()), {"integrators": 1})


def motor(samples: float) -> Kind:
    """A linear motor's position; its time constant is so many samples."""

    def make(rng: np.random.Generator) -> Strange:
        u = sines(rng, 2000, samples)
        return of_position(rng, u, driven_motor(u, samples))

    return Kind(make, LINEAR)


def of_two_inputs(rng: np.random.Generator) -> Strange:
    """A linear plant, half of whose output another input makes, which was not recorded."""
    u = walk(rng)
    return Strange(u, noisy(rng, lags(u) + 0.7 * lags(walk(rng), 30.0, 1)))


def softening(u: Floats) -> Floats:
    """A mass on a spring that bends."""

    def step(state: tuple[float, float], force: float) -> tuple[float, float]:
        x, v = state
        for _ in range(4):
            v += 0.25 * (0.02 * (2.0 * force - x - 0.5 * x**3) - 0.15 * v)
            x += 0.25 * v
        return x, v

    return scaled(follow(u, step, (0.0, 0.0))[:-1, 0])


def tank(u: Floats) -> Floats:
    """The level of a tank with a free outlet, less its mean."""
    y = follow(u, lambda x, v: max(x + 0.03 * (1 + 0.3 * v - np.sqrt(x)), 0.0), 1.0)[:-1]
    return np.asarray((y - y.mean()) / y.std())


def by_pulses(rng: np.random.Generator) -> Strange:
    """A speed by pulses about 1500 us, with a zone of +- 25 of 100 about it."""
    u = walk(rng)
    return Strange(1500 + 100 * u, noisy(rng, lags(zone(u, 0.27, 0.22))), {}, 49.0)


def slow_rate(v: Floats) -> Floats:
    """Changes limited to so much a sample."""
    begin = float(v[0])
    return follow(v, lambda at, value: at + min(max(value - at, -0.06), 0.06), begin)[1:]


def slopes_apart(v: Floats) -> Floats:
    """A zone whose sides have other slopes."""
    through = zone(v)
    return np.where(through > 0, through, 0.6 * through)


# --- Kinds of later rounds


def tailed(rng: np.random.Generator) -> Strange:
    """A zone whose readings have noise of heavy tails."""
    u = walk(rng)
    return Strange(u, zone(lags(u)) + 0.01 * rng.standard_t(3, u.size), {}, BOTH)


def widening(z: Floats) -> Floats:
    """A zone of the sensor that grows from half of its width to one and a half."""
    grown = np.linspace(0.5, 1.5, z.size)
    return np.asarray(grown * zone(z / grown))


def bent_hysteresis(u: Floats) -> Floats:
    """A smooth hysteresis behind the plant (Bouc and Wen)."""
    z = lags(u, 12.0, 1)
    return z + follow(np.diff(z), lambda h, d: h + d - 1.5 * (abs(d) * h + d * abs(h)), 0.0)


def of_two_rates(u: Floats) -> Floats:
    """A plant that is three times slower on its way down."""
    return scaled(
        follow(u, lambda x, v: x + (v - x) * (0.15 if v > x else 0.05), 0.0)[:-1],
    )


def stribeck(rng: np.random.Generator) -> Strange:
    """A speed with friction that falls once it moves."""
    u, y, v = np.repeat(rng.normal(0, 1, 60), 20), np.empty(SIZE), 0.0
    for k in range(SIZE):
        y[k] = v
        for _ in range(10):
            friction = 0.25 + 0.2 * np.exp(-((v / 0.1) ** 2))
            if v == 0 and abs(u[k]) <= friction:
                continue
            w = v + 0.01 * (u[k] - v - friction * np.sign(v or u[k]))
            v = 0.0 if w * v < 0 else w
    return Strange(u, noisy(rng, y, 0.01 * y.std()))


def looped(
    goal: Floats,
    read: Callable[[float], float],
    drive: Callable[[float, float, float], float],
    move: Callable[[float, float], float],
) -> tuple[Floats, Floats]:
    """Inputs and readings of one state; it is driven by goal, reading and the last input."""
    rows, x, u = [], 0.0, 0.0
    for r in goal:
        y = read(x)
        u = drive(r, y, u)
        x = move(x, u)
        rows.append((u, y))
    return np.array(rows).T[0], np.array(rows).T[1]


def zone_in_loop(rng: np.random.Generator) -> Strange:
    """A zone of the sensor in a loop that follows a reference."""
    keep = np.exp(-1 / 12)
    u, y = looped(
        walk(rng, SIZE, 30.0),
        lambda x: float(zone(np.array(x))) + 0.01 * rng.standard_normal(),
        lambda r, y, _: 3 * (r - y),
        lambda x, u: keep * x + (1 - keep) * u,
    )
    return Strange(u, y, {}, BOTH)


def rounded(z: Floats) -> Floats:
    """A zone whose edges are round."""
    up, down = np.logaddexp(0.0, [(z - WIDTHS[0]) / 0.05, (-z - WIDTHS[1]) / 0.05])
    return np.asarray(0.05 * (up - down))


# --- Kinds that were chosen after the code of their round was finished


def dragging(u: Floats) -> Floats:
    """A body in a fluid: its drag is the square of its speed."""
    return scaled(follow(u, lambda v, f: v + 0.15 * (f - v * abs(v) - 0.1 * v), 0.0)[:-1])


def swaying(z: Floats) -> Floats:
    """An output whose gain sways by a third, four times along the log."""
    return np.asarray((1 + 0.33 * np.sin(np.linspace(0, 8 * np.pi, z.size))) * z)


def jittery(rng: np.random.Generator) -> Strange:
    """A linear plant whose recorder writes the input up to two samples early or late."""
    u = walk(rng)
    late = np.clip(np.arange(SIZE) + rng.integers(-2, 3, SIZE), 0, SIZE - 1)
    return Strange(u[late], noisy(rng, lags(u)))


def wandering(rng: np.random.Generator) -> Strange:
    """A linear plant whose sensor's zero wanders."""
    u = walk(rng)
    away = np.cumsum(rng.standard_normal(SIZE))
    return Strange(u, noisy(rng, lags(u) + 0.3 * away / away.std()))


def with_spikes(rng: np.random.Generator) -> Strange:
    """A zone, one in fifty of whose readings is anything."""
    u = walk(rng)
    y = noisy(rng, zone(lags(u)), 0.01)
    return Strange(u, np.where(rng.random(SIZE) < 0.02, rng.uniform(-3, 3, SIZE), y), {}, BOTH)


def relayed(v: Floats, half: float, low: float, begin: float) -> Floats:
    """1 or a low value, by a relay with hysteresis."""
    return follow(v, lambda at, x: 1.0 if x > half else low if x < -half else at, begin)[1:]


def on_change(rng: np.random.Generator) -> Strange:
    """A recorder that writes a reading only if it is 0.2 off the last one written."""
    u = walk(rng)
    z = noisy(rng, lags(u))
    return Strange(u, follow(z, lambda at, v: v if abs(v - at) > 0.2 else at, float(z[0]))[1:])


def humming(u: Floats) -> Floats:
    """A linear plant, and hum of a frequency that nobody recorded."""
    return np.asarray(lags(u) + 0.4 * np.sin(0.31 * np.arange(u.size)))


def bilinear(u: Floats) -> Floats:
    """A plant whose gain grows with its output, as a heat exchanger's does."""
    return scaled(
        follow(u, lambda z, v: z + 0.1 * (v * (1 + 0.5 * np.tanh(z)) - z), 0.0)[:-1],
    )


def cut(v: Floats, least: float = 0.4) -> Floats:
    """Small values are left out, the rest is whole: a valve's least pulse, or a noise gate."""
    return np.where(np.abs(v) > least, v, 0.0)


def freezing(rng: np.random.Generator) -> Strange:
    """A linear plant whose sensor freezes for 30 samples now and then."""
    u = walk(rng)
    y = noisy(rng, lags(u))
    for begin in rng.choice(u.size - 30, 6, replace=False):
        y[begin : begin + 30] = y[begin]
    return Strange(u, y)


def swinging(u: Floats) -> Floats:
    """A pendulum under torque: its spring is a sine."""

    def step(state: tuple[float, float], torque: float) -> tuple[float, float]:
        z, v = state
        v += 0.1 * (1.2 * torque - np.sin(z) * 2 - 0.8 * v)
        return z + 0.1 * v, v

    return scaled(follow(u, step, (0.0, 0.0))[:-1, 0])


def of_changing_delay(u: Floats) -> Floats:
    """A linear plant behind a pipe whose delay sways between 2 and 10 samples."""
    late = np.rint(6 + 4 * np.sin(np.linspace(0, 10 * np.pi, u.size))).astype(int)
    return lags(u[np.maximum(np.arange(u.size) - late, 0)], 6.0)


def with_leak(u: Floats) -> Floats:
    """A zone whose sensor's zero creeps with its reading, slowly."""
    y = zone(lags(u))
    return np.asarray(y + 0.3 * lags(y, 100.0, 1))


# --- Kinds that were chosen last


def interpolated(rng: np.random.Generator) -> Strange:
    """A linear plant whose recorder fills three of four readings along straight lines."""
    u, k = walk(rng), np.arange(SIZE)
    y = noisy(rng, lags(u))
    return Strange(u, np.interp(k, k[::4], y[::4]))


def unstable_in_loop(rng: np.random.Generator) -> Strange:
    """A linear plant that falls over, held by a controller."""
    goal = walk(rng, SIZE, 30.0)
    return Strange(
        *looped(
            goal,
            lambda x: x + 0.02 * rng.standard_normal(),
            lambda r, y, _: 3.0 * (r - y),
            lambda x, u: 1.03 * x + 0.06 * u,
        )
    )


def cogging(rng: np.random.Generator) -> Strange:
    """The position of a motor whose magnets pull it to 12 places a turn."""
    u, y, x, v = 2 * steps(rng, 2500), np.empty(2500), 0.0, 0.0
    for k in range(y.size):
        y[k] = x
        for _ in range(10):
            v += 0.001 * (5 * u[k] - 5 * v - 3 * np.sin(12 * x))
            x += 0.001 * v
    return of_position(rng, u, y)


def preloaded(u: Floats) -> Floats:
    """A lever between springs that are wound up: as a speed with friction, it needs a force to
    leave its middle.
    """

    def step(x: float, force: float) -> float:
        moved = x + 0.1 * (force - 0.6 * np.sign(x or force) - x)
        rests = (x == 0 and abs(force) < 0.6) or moved * x < 0
        return 0.0 if rests else float(moved)

    return scaled(follow(u, step, 0.0)[:-1])


def of_two_runs(rng: np.random.Generator) -> Strange:
    """Two runs with a zone of the sensor, one behind the other in a file."""
    runs = [walk(rng, SIZE // 2) for _ in range(2)]
    y = np.concatenate([zone(lags(u)) for u in runs])
    return Strange(np.concatenate(runs), noisy(rng, y, 0.01), {}, BOTH)


def smoothed(rng: np.random.Generator) -> Strange:
    """A linear plant whose readings were smoothed both ways afterwards."""
    u = walk(rng)
    return Strange(u, filtfilt([0.3], [1.0, -0.7], noisy(rng, lags(u), 0.1)))


def with_lost_rows(rng: np.random.Generator) -> Strange:
    """A linear plant, one in twenty of whose rows was lost without a trace."""
    u = walk(rng)
    left = rng.random(SIZE) > 0.05
    return Strange(u[left], noisy(rng, lags(u))[left])


def loaded(rng: np.random.Generator) -> Strange:
    """A linear plant under loads that come and go, which nobody recorded."""
    u = walk(rng)
    return Strange(u, noisy(rng, lags(u) + 0.5 * lags(steps(rng, SIZE, 150), 12.0, 1)))


def by_thermostat(rng: np.random.Generator) -> Strange:
    """A linear plant that a thermostat switches by what it reads."""
    goal = 0.3 * walk(rng, SIZE, 60.0)
    return Strange(
        *looped(
            goal,
            lambda x: x + 0.01 * rng.standard_normal(),
            lambda r, y, at: 1.0 if y < r - 0.1 else -1.0 if y > r + 0.1 else at or 1.0,
            lambda x, u: x + 0.05 * (2 * u - x),
        )
    )


def hunting(rng: np.random.Generator) -> Strange:
    """A zone of the input in a loop with an integral, which hunts about its reference."""
    r, y, u, x, total = steps(rng, 2400, 200), np.empty(2400), np.empty(2400), 0.0, 0.0
    for k in range(r.size):
        y[k] = x + 0.005 * rng.standard_normal()
        total += 0.03 * (r[k] - y[k])
        u[k] = 1.5 * (r[k] - y[k]) + total
        x += 0.08 * (float(zone(u[k], 0.3, 0.3)) - x)
    return Strange(u, y, {}, 0.6)


def apart_from_zero(z: Floats) -> Floats:
    """A zone between 0.4 and 1.1, far from 0."""
    return zone(z - 0.75, 0.35, 0.35)


def noisy_by_size(rng: np.random.Generator) -> Strange:
    """A zone whose noise is a tenth of what it reads."""
    u = walk(rng)
    y = zone(lags(u))
    return Strange(u, noisy(rng, y * (1 + 0.1 * rng.standard_normal(SIZE)), 0.003), {}, BOTH)


def ringing(u: Floats) -> Floats:
    """A zone behind a mass on a spring, which rings ten times."""
    return zone(scaled(lfilter([0.0, 1.0], [1.0, -2 * 0.98 * np.cos(0.2), 0.98**2], u)))


def compared(z: Floats) -> Floats:
    """One or zero, with a hysteresis."""
    return relayed(z, 0.2, 0.0, 0.0)


def nested(z: Floats) -> Floats:
    """Plays of four gaps side by side, as springs that slide (Iwan's friction) make them."""
    return np.asarray(sum(dragged(z, gap) for gap in (0.0, 0.3, 0.7, 1.2)) / 4)


def of_two_clocks(u: Floats) -> Floats:
    """A linear plant whose readings have a clock that runs 1 % fast."""
    k = np.arange(u.size)
    return np.interp(k * 0.99, k, lags(u))


def of_one_step(rng: np.random.Generator) -> Strange:
    """A linear plant whose input steps once."""
    u = np.where(np.arange(400) < 50, 0.0, 1.0)
    return Strange(u, noisy(rng, lags(u)))


def diffusing(u: Floats) -> Floats:
    """Heat in a thick wall: half an order, as lags of many time constants."""
    return scaled(sum((0.5**n * lags(u, 3.0 * 4.0**n, 1) for n in range(5)), np.zeros(u.size)))


def changes(z: Floats) -> Floats:
    """A sensor of changes: it forgets what stays."""
    return np.asarray(lfilter([1.0, -1.0], [1.0, -0.98], z))


def slower_upwards(z: Floats) -> Floats:
    """A sensor that follows rises with a lag of 8 samples, and falls with one of 2."""
    return follow(z, lambda at, v: at + (v - at) / (8 if v > at else 2), 0.0)[1:]


def dithered(u: Floats) -> Floats:
    """A zone that a tone of its own size, which nobody recorded, carries across its edges."""
    return zone(lags(u) + 0.4 * np.sin(2.2 * np.arange(u.size)))


def rectified(rng: np.random.Generator) -> Strange:
    """A linear plant whose recorder writes the amplitude of its input."""
    u = walk(rng)
    return Strange(np.abs(u), noisy(rng, lags(u)))


def with_drift(z: Floats) -> Floats:
    """A sensor whose zero drifts by half an rms along the log."""
    return np.asarray(z + np.linspace(0.0, 0.5, z.size))


def of_two_gains(u: Floats) -> Floats:
    """A linear plant whose gain falls by a third in the middle of the log."""
    return lags(u * np.where(np.arange(u.size) < u.size // 2, 1.2, 0.8))


def with_coloured_noise(read: Callable[[Floats], Floats], right: tuple[str, ...]) -> Kind:
    """A sensor whose noise has a memory of 20 samples and a rms of a tenth."""

    def make(rng: np.random.Generator) -> Strange:
        u = walk(rng)
        return Strange(u, noisy(rng, read(lags(u)) + 0.1 * walk(rng, SIZE, 20.0), 0.01))

    return Kind(make, right)


def sampled(samples: float) -> Kind:
    """A zone behind a plant whose time constant is so many samples."""
    return driven(lambda u: zone(lags(u, samples)), ZONE, 0.01, BOTH, 2400, samples)


def cylinder(rng: np.random.Generator) -> Strange:
    """The position of a hydraulic cylinder, whose valve overlaps, and which is faster outwards."""
    u = walk(rng, 2400, 20.0)
    v = zone(u, 0.4, 0.3)
    return of_position(rng, u, driven_motor(np.where(v > 0, 1.4 * v, v), 5.0))


def missing_counts(rng: np.random.Generator) -> Strange:
    """A motor whose encoder misses counts when it moves fast: linear, its position drifts."""
    u = steps(rng, 2500)
    moves = np.diff(driven_motor(u, 15.0), prepend=0.0)
    lost = (rng.random(u.size) < 0.02) & (np.abs(moves) > np.std(moves))
    y = np.cumsum(np.where(lost, 0.0, moves))
    return Strange(u, np.round(y, 2), {"integrators": 1})


def root(z: Floats) -> Floats:
    """The root of a pressure drop, with its sign."""
    return np.asarray(np.sign(z) * np.sqrt(np.abs(z)))


ZONE = ("dead_zone", "filtered_zone")
LINEAR = ("none", "operating_point")
CURVE = ("input_curve",)
BENT = ("other", "saturation")
ALL = {
    "fan": curved(lambda u: u * np.abs(u), CURVE),
    "exponential valve": curved(np.expm1, CURVE),
    "soft limit of the input": curved(lambda u: np.tanh(2 * u), CURVE),
    "cubic input": curved(lambda u: u + 0.4 * u**3, CURVE),
    "root of the input": curved(root, CURVE),
    "limit of the input": curved(lambda u: np.clip(u, -0.9, 1.1), ()),
    "play ahead, 12": play_ahead(0.5, 12.0),
    "play ahead, 2": play_ahead(0.9, 2.0),
    "valve that sticks and slips": driven(
        sticking, ("input_play", "stiction"), size=2000, hold=30.0
    ),
    "rate limit of the input": curved(slow_rate, ("input_rate",)),
    "pulses about 1500": Kind(by_pulses, ("input_zone",)),
    "zone, mean of 4": sensed(lambda z: lfilter(np.ones(4) / 4, [1.0], zone(z)), ZONE, BOTH),
    "zone, lag of 3": sensed(lambda z: lfilter([0.3], [1.0, -0.7], zone(z)), ZONE, BOTH),
    "zone, median of 5": sensed(lambda z: medfilt(zone(z), 5), ZONE, BOTH),
    "zone of two slopes": sensed(slopes_apart, (*ZONE, "other")),
    "zone that ends": sensed(lambda z: np.clip(zone(z), -0.6, 0.8), (*ZONE, "saturation")),
    "zone behind a drifting gain": sensed(lambda z: zone(z * np.linspace(1.4, 0.7, z.size)), ZONE),
    "rate limit of the sensor": sensed(slow_rate, ()),
    "soft sensor": sensed(lambda z: np.tanh(1.5 * z), BENT),
    "joint, friction .3": Kind(joint(0.3), ("friction",)),
    "joint": Kind(joint(0.0), LINEAR),
    **{f"motor of {samples}": motor(samples) for samples in (5, 15, 50, 150, 500)},
    "fifth order": driven(lambda u: lags(u, 5.0, 5), LINEAR),
    "mean of 5": sensed(lambda z: lfilter(np.ones(5) / 5, [1.0], z), LINEAR),
    "an input that nobody recorded": Kind(of_two_inputs, LINEAR),
    "spring that bends": driven(softening, ()),
    "tank": driven(tank, (), hold=30.0),
    "zone": sensed(zone, ("dead_zone",), BOTH),
    "line": sensed(lambda z: z, LINEAR),
    # chosen after the code of the rounds before was finished
    "zone, heavy tails": Kind(tailed, ZONE),
    "two gains of the input": curved(lambda u: np.where(u > 0, u, 0.5 * u), CURVE),
    "zone that grows": sensed(widening, ZONE),
    "smooth hysteresis": driven(bent_hysteresis, ("play", "both"), size=2000, hold=30.0),
    "two rates": driven(of_two_rates, ()),
    "relay": curved(np.sign, ()),
    "friction that falls": Kind(stribeck, ("friction",)),
    "zone in a loop": Kind(zone_in_loop, ZONE),
    "zone of a late input": driven(
        lambda u: lags(zone(np.roll(u, 4), 0.4, 0.3)), ("input_zone",), width=0.7
    ),
    "lag, zone, plant": curved(lambda u: zone(lags(u, 4.0, 1), 0.4, 0.3), ()),
    "zone, round edges": sensed(rounded, ZONE, BOTH),
    "zone of one side": sensed(lambda z: zone(z, 0.6, 0.0), ZONE, 0.6),
    "root of the output": sensed(root, BENT),
    "tenths of readings": sensed(lambda z: np.round(z, 1), LINEAR),
    "two slopes, no zone": sensed(lambda z: np.where(z > 0, z, 0.6 * z), ("other",)),
    "limit of one side": sensed(lambda z: np.minimum(z, 0.8), ("saturation", "other")),
    "drag by the square": driven(dragging, ()),
    "gain that sways": driven(lambda u: swaying(lags(u)), LINEAR),
    "input of uncertain time": Kind(jittery, LINEAR),
    "sensor's zero that wanders": Kind(wandering, LINEAR),
    "zone and spikes": Kind(with_spikes, ZONE),
    "relay with hysteresis": curved(lambda u: relayed(u, 0.4, -1.0, 1.0), ()),
    "lag, soft limit, plant": curved(lambda u: np.tanh(2 * lags(u, 6.0, 1)), ()),
    "zone beside a line": curved(lambda u: 0.5 * u + zone(u, 0.6, 0.5), CURVE),
    "rounded input": curved(np.round, ()),
    "sensor of three slopes": sensed(lambda z: z - 0.5 * np.clip(z, -0.5, 0.4), ("other",)),
    "heater": curved(lambda u: np.maximum(u, 0.0), (*CURVE, "input_zone")),
    "recorder on change": Kind(on_change, ()),
    "hum": driven(humming, LINEAR),
    "gain by the output": driven(bilinear, ()),
    "least pulse": curved(lambda u: cut(u, 0.5), ()),
    "sensor that freezes": Kind(freezing, LINEAR),
    "pendulum": driven(swinging, (), hold=20.0),
    "limit of the input, zone": driven(lambda u: zone(lags(np.clip(u, -1.2, 1.0))), ZONE),
    "delay that sways": driven(of_changing_delay, LINEAR),
    "zone that creeps": driven(with_leak, ZONE, width=BOTH),
    "interpolated readings": Kind(interpolated, LINEAR),
    "coarse readings": sensed(lambda z: 0.6 * np.round(z / 0.6), LINEAR),
    "inverse response": driven(lambda u: lags(u, 12.0, 1) - 1.5 * lags(u, 4.0, 1), LINEAR),
    "unstable plant in a loop": Kind(unstable_in_loop, LINEAR),
    "motor that cogs": Kind(cogging, ()),
    "springs wound up": driven(preloaded, ("friction",)),
    "sensor of a logarithm": sensed(lambda z: np.sign(z) * np.log1p(3 * np.abs(z)), BENT),
    "zone, two runs": Kind(of_two_runs, ZONE),
    "noise gate": sensed(cut, ("jump",), 0.8),
    "smoothed both ways": Kind(smoothed, LINEAR),
    "lost rows": Kind(with_lost_rows, LINEAR),
    "loads that come and go": Kind(loaded, LINEAR),
    "thermostat": Kind(by_thermostat, LINEAR),
    "zone of the input, hunting": Kind(hunting, ("input_zone",)),
    "zone far from 0": sensed(apart_from_zero, ZONE, 0.7),
    "angle that wraps": sensed(lambda z: np.mod(z + 0.5, 1.0) - 0.5, ()),
    "flow without its sign": sensed(np.abs, ("other",)),
    "zone, read every fifth time": sensed(lambda z: np.repeat(zone(z)[::5], 5), ZONE, BOTH),
    "read every fifth time": sensed(lambda z: np.repeat(z[::5], 5), LINEAR),
    "zone, noise by its size": Kind(noisy_by_size, ZONE),
    "zone of a light damping": driven(ringing, ZONE, 0.01, BOTH),
    "comparator": sensed(compared, ()),
    "nested hystereses": sensed(nested, ("play", "both", "friction")),
    "clocks apart": driven(of_two_clocks, LINEAR),
    "one step": Kind(of_one_step, LINEAR),
    "long dead time": curved(lambda u: np.append(np.zeros(48), u[:-48]), LINEAR),
    "diffusion": driven(diffusing, LINEAR, hold=30.0),
    "sensor of changes": sensed(changes, LINEAR),
    "zone, sensor of changes": sensed(lambda z: changes(zone(z)), (), BOTH),
    "zone with a share passed on": driven(lambda u: zone(lags(u) + 0.3 * u), ZONE, 0.01, BOTH),
    "sensor slower upwards": sensed(slower_upwards, ()),
    "range that switches": sensed(lambda z: np.where(np.abs(z) > 1, 1.05 * z, z), ("other",)),
    "dithered zone": driven(dithered, ZONE, 0.01),
    "input without its sign": Kind(rectified, ()),
    "gap behind a lag": driven(
        lambda u: lfilter([0.22], [1.0, -0.78], dragged(lags(u), 0.7)),
        ("play",),
        0.005,
        None,
        2000,
        30.0,
    ),
    # chosen last
    "no dynamics": driven(lambda u: 2 * u, LINEAR),
    "no dynamics, zone": driven(zone, (*ZONE, "input_zone")),
    "no dynamics, play": driven(lambda u: dragged(u, 0.7), ("play", "input_play")),
    "no dynamics, limit": driven(lambda u: np.clip(u, -0.9, 1.1), ("saturation",)),
    "slow drive that saturates": curved(lambda u: np.clip(lags(u, 4.0, 1), -0.9, 0.9), ()),
    "offset that drifts": driven(lambda u: with_drift(lags(u)), LINEAR),
    "zone, offset that drifts": driven(lambda u: with_drift(zone(lags(u))), ZONE),
    "gain that steps": driven(of_two_gains, LINEAR),
    "coloured noise": with_coloured_noise(lambda z: z, LINEAR),
    "zone, coloured noise": with_coloured_noise(zone, ZONE),
    "zone, much noise": driven(lambda u: zone(lags(u)), ZONE, 0.3, BOTH),
    "zone, oversampled": sampled(120.0),
    "zone, undersampled": sampled(0.7),
    "cylinder": Kind(cylinder, ("input_zone",)),
    "encoder that misses counts": Kind(missing_counts, LINEAR),
    "root with a cut-off": sensed(lambda z: cut(root(z)), ("jump", "other")),
}
