"""Logs of truths that `identify` was not built for, and of a few that it was."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import filtfilt, lfilter, medfilt

from undeadzone.util.arrays import Floats

STEP = 0.01
SIZE = 1200
WIDTHS = (0.5, 0.35)  # of the sensor's zones


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
    return np.asarray(u / u.std())


def zone(v: Floats, right: float = WIDTHS[0], left: float = WIDTHS[1]) -> Floats:
    """Dz(v)."""
    return np.asarray(np.maximum(v - right, 0.0) + np.minimum(v + left, 0.0))


def dragged(u: Floats, gap: float) -> Floats:
    """What a play of that gap passes on."""
    v, at = np.empty(u.size), float(u[0])
    for k, value in enumerate(u):
        at = min(max(at, value - gap / 2), value + gap / 2)
        v[k] = at
    return v


def noisy(rng: np.random.Generator, y: Floats, rms: float = 0.02) -> Floats:
    """With white noise."""
    return np.asarray(y + rms * rng.standard_normal(y.size))


def curved(curve: Callable[[Floats], Floats]) -> Callable[[np.random.Generator], Strange]:
    """A plant behind a curve of its input."""

    def make(rng: np.random.Generator) -> Strange:
        u = walk(rng)
        return Strange(u, noisy(rng, lags(curve(u))))

    return make


def sensed(
    read: Callable[[Floats], Floats], width: float | None = None
) -> Callable[[np.random.Generator], Strange]:
    """A plant behind a sensor."""

    def make(rng: np.random.Generator) -> Strange:
        u = walk(rng)
        return Strange(u, noisy(rng, read(lags(u)), 0.01), {}, width)

    return make


def play_ahead(gap: float, samples: float) -> Callable[[np.random.Generator], Strange]:
    """Play between input and plant."""

    def make(rng: np.random.Generator) -> Strange:
        u = walk(rng, 2000, 30.0)
        return Strange(u, noisy(rng, lags(dragged(u, gap), samples, 1)), {}, gap)

    return make


def sticking(rng: np.random.Generator) -> Strange:
    """A valve that sticks, and slips by half as much when it moves."""
    u, v, at = walk(rng, 2000, 30.0), np.empty(2000), 0.0
    for k, value in enumerate(u):
        if abs(value - at) > 0.5:
            at = value - np.sign(value - at) * 0.25
        v[k] = at
    return Strange(u, noisy(rng, lags(v, 12.0, 1)))


def joint(friction: float) -> Callable[[np.random.Generator], Strange]:
    """A joint's position by its torque, with Coulomb friction and no gap."""

    def make(rng: np.random.Generator) -> Strange:
        size, tau, gain, h = 2500, 0.1, 2.0, STEP / 40
        u = steps(rng, size)
        y, x, v = np.empty(size), 0.0, 0.0
        for k in range(size):
            y[k] = x
            for _ in range(40):
                a, f = (gain * u[k] - v) / tau, gain * friction / tau
                if v == 0 and abs(a) <= f:
                    continue
                w = v + h * (a - np.sign(v or a) * f)
                w = 0.0 if w * v < 0 else w
                x, v = x + h * (v + w) / 2, w
        return Strange(u, np.round(y / 2e-4) * 2e-4, {"integrators": 1})

    return make


def sines(rng: np.random.Generator, size: int, samples: float) -> Floats:
    """Three sines about a time constant of so many samples."""
    phases, t = rng.uniform(0, 6, 3), np.arange(size) / samples
    tones = zip((1, 0.7, 0.5), (0.7, 1.9, 4.1), phases, strict=True)
    return sum((a * np.sin(w * t + p) for a, w, p in tones), np.zeros(size))


def steps(rng: np.random.Generator, size: int, hold: int = 30) -> Floats:
    """Random levels, each held for so many samples."""
    return np.repeat(rng.uniform(-1, 1, size // hold + 1), hold)[:size]


def driven_motor(u: Floats, samples: float) -> Floats:
    """The position of a linear motor whose time constant is so many samples."""
    keep = np.exp(-1 / samples)
    v = lfilter([0.0, 1 - keep], [1.0, -keep], u)
    return np.asarray(np.cumsum(np.append(0.0, v[:-1])))


def motor(samples: float) -> Callable[[np.random.Generator], Strange]:
    """A linear motor's position; its time constant is so many samples."""

    def make(rng: np.random.Generator) -> Strange:
        u = sines(rng, 2000, samples)
        y = driven_motor(u, samples)
        return Strange(u, noisy(rng, y, 0.003 * y.std()), {"integrators": 1})

    return make


def drifting(rng: np.random.Generator) -> Strange:
    """A gain that falls by half along the log, ahead of a zone."""
    u = walk(rng)
    return Strange(u, noisy(rng, zone(lags(u) * np.linspace(1.4, 0.7, u.size)), 0.01))


def of_fifth_order(rng: np.random.Generator) -> Strange:
    """A linear plant of more poles than are tried."""
    u = walk(rng)
    return Strange(u, noisy(rng, lags(u, 5.0, 5)))


def averaged(rng: np.random.Generator) -> Strange:
    """A linear plant whose readings are means of five."""
    u = walk(rng)
    return Strange(u, noisy(rng, lfilter(np.ones(5) / 5, [1.0], lags(u)), 0.01))


def of_two_inputs(rng: np.random.Generator) -> Strange:
    """A linear plant, half of whose output another input makes, which was not recorded."""
    u = walk(rng)
    return Strange(u, noisy(rng, lags(u) + 0.7 * lags(walk(rng), 30.0, 1)))


def softening(rng: np.random.Generator) -> Strange:
    """A mass on a spring that bends."""
    u = walk(rng)
    y, x, v = np.empty(u.size), 0.0, 0.0
    for k, value in enumerate(u):
        y[k] = x
        for _ in range(4):
            v += 0.25 * (0.02 * (2.0 * value - x - 0.5 * x**3) - 0.15 * v)
            x += 0.25 * v
    return Strange(u, noisy(rng, y / y.std()))


def tank(rng: np.random.Generator) -> Strange:
    """The level of a tank with a free outlet, less its mean."""
    u, y, x = walk(rng, SIZE, 30.0), np.empty(SIZE), 1.0
    for k, value in enumerate(u):
        y[k] = x
        x = max(x + 0.03 * (1 + 0.3 * value - np.sqrt(x)), 0.0)
    return Strange(u, noisy(rng, (y - y.mean()) / y.std()))


def by_pulses(rng: np.random.Generator) -> Strange:
    """A speed by pulses about 1500 us, with a zone of +- 25 of 100 about it."""
    u = walk(rng)
    return Strange(1500 + 100 * u, noisy(rng, lags(zone(u, 0.27, 0.22))), {}, 49.0)


def slow_rate(v: Floats) -> Floats:
    """Changes limited to so much a sample."""
    out, at = np.empty(v.size), float(v[0])
    for k, value in enumerate(v):
        at += min(max(float(value) - at, -0.06), 0.06)
        out[k] = at
    return out


def slopes_apart(v: Floats) -> Floats:
    """A zone whose sides have other slopes."""
    through = zone(v)
    return np.where(through > 0, through, 0.6 * through)


# --- Kinds of later rounds


def tailed(rng: np.random.Generator) -> Strange:
    """A zone whose readings have noise of heavy tails."""
    u = walk(rng)
    return Strange(u, zone(lags(u)) + 0.01 * rng.standard_t(3, u.size), {}, sum(WIDTHS))


def one_sided(rng: np.random.Generator) -> Strange:
    """A plant that answers to positive inputs by twice as much."""
    u = walk(rng)
    return Strange(u, noisy(rng, lags(np.where(u > 0, u, 0.5 * u))))


def widening(rng: np.random.Generator) -> Strange:
    """A zone of the sensor that grows from half of its width to one and a half."""
    u = walk(rng)
    grown, z = np.linspace(0.5, 1.5, u.size), lags(u)
    return Strange(u, noisy(rng, np.asarray(grown * zone(z / grown)), 0.01))


def bent_hysteresis(rng: np.random.Generator) -> Strange:
    """A smooth hysteresis behind the plant (Bouc and Wen)."""
    u = walk(rng, 2000, 30.0)
    z, h = lags(u, 12.0, 1), np.zeros(2000)
    for k in range(1, h.size):
        d = z[k] - z[k - 1]
        h[k] = h[k - 1] + d - 1.5 * (abs(d) * h[k - 1] + d * abs(h[k - 1]))
    return Strange(u, noisy(rng, z + h))


def of_two_rates(rng: np.random.Generator) -> Strange:
    """A plant that is three times slower on its way down."""
    u, y, x = walk(rng), np.empty(SIZE), 0.0
    for k, value in enumerate(u):
        y[k] = x
        x += (value - x) * (0.15 if value > x else 0.05)
    return Strange(u, noisy(rng, y / y.std()))


def switched(rng: np.random.Generator) -> Strange:
    """A relay ahead of the plant."""
    u = walk(rng)
    return Strange(u, noisy(rng, lags(np.sign(u))))


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


def zone_in_loop(rng: np.random.Generator) -> Strange:
    """A zone of the sensor in a loop that follows a reference."""
    r, y, u, x, keep = walk(rng, SIZE, 30.0), np.empty(SIZE), np.empty(SIZE), 0.0, np.exp(-1 / 12)
    for k in range(SIZE):
        y[k] = float(zone(np.array(x))) + 0.01 * rng.standard_normal()
        u[k] = 3 * (r[k] - y[k])
        x = keep * x + (1 - keep) * u[k]
    return Strange(u, y, {}, sum(WIDTHS))


def rounded(z: Floats) -> Floats:
    """A zone whose edges are round."""
    up, down = np.logaddexp(0.0, [(z - WIDTHS[0]) / 0.05, (-z - WIDTHS[1]) / 0.05])
    return np.asarray(0.05 * (up - down))


def late_zone(rng: np.random.Generator) -> Strange:
    """A zone of the input behind four samples of delay."""
    u = walk(rng)
    return Strange(u, noisy(rng, lags(zone(np.roll(u, 4), 0.4, 0.3))), {}, 0.7)


def with_actuator_lag(rng: np.random.Generator) -> Strange:
    """A lag, then a zone, then the plant."""
    u = walk(rng)
    return Strange(u, noisy(rng, lags(zone(lags(u, 4.0, 1), 0.4, 0.3))))


# --- Kinds that were chosen after the code of their round was finished


def dragging(rng: np.random.Generator) -> Strange:
    """A body in a fluid: its drag is the square of its speed."""
    u, y, v = walk(rng), np.empty(SIZE), 0.0
    for k in range(SIZE):
        y[k] = v
        v += 0.15 * (u[k] - v * abs(v) - 0.1 * v)
    return Strange(u, noisy(rng, y / y.std()))


def swaying(rng: np.random.Generator) -> Strange:
    """A linear plant whose gain sways by a third, four times along the log."""
    u = walk(rng)
    gain = 1 + 0.33 * np.sin(np.linspace(0, 8 * np.pi, u.size))
    return Strange(u, noisy(rng, gain * lags(u)))


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


def switching(rng: np.random.Generator) -> Strange:
    """A relay with hysteresis ahead of the plant."""
    u, v, at = walk(rng), np.empty(SIZE), 1.0
    for k, value in enumerate(u):
        at = 1.0 if value > 0.4 else -1.0 if value < -0.4 else at
        v[k] = at
    return Strange(u, noisy(rng, lags(v)))


def between_lags(rng: np.random.Generator) -> Strange:
    """A lag, a soft limit, and the plant."""
    u = walk(rng)
    return Strange(u, noisy(rng, lags(np.tanh(2 * lags(u, 6.0, 1)))))


def zone_beside(rng: np.random.Generator) -> Strange:
    """A zone of the input beside a path without one."""
    u = walk(rng)
    return Strange(u, noisy(rng, lags(0.5 * u + zone(u, 0.6, 0.5))))


def heated(rng: np.random.Generator) -> Strange:
    """A heater: it does nothing below 0."""
    u = walk(rng)
    return Strange(u, noisy(rng, lags(np.maximum(u, 0.0))))


def on_change(rng: np.random.Generator) -> Strange:
    """A recorder that writes a reading only if it is 0.2 off the last one written."""
    u = walk(rng)
    z = noisy(rng, lags(u))
    y, at = np.empty(z.size), float(z[0])
    for k, value in enumerate(z.tolist()):
        at = value if abs(value - at) > 0.2 else at
        y[k] = at
    return Strange(u, y)


def humming(rng: np.random.Generator) -> Strange:
    """A linear plant, and hum of a frequency that nobody recorded."""
    u = walk(rng)
    return Strange(u, noisy(rng, lags(u) + 0.4 * np.sin(0.31 * np.arange(u.size))))


def bilinear(rng: np.random.Generator) -> Strange:
    """A plant whose gain grows with its output, as a heat exchanger's does."""
    u, y, z = walk(rng), np.empty(SIZE), 0.0
    for k in range(SIZE):
        y[k] = z
        z += 0.1 * (u[k] * (1 + 0.5 * np.tanh(z)) - z)
    return Strange(u, noisy(rng, y / y.std()))


def least_pulse(u: Floats) -> Floats:
    """A valve by pulses: what is shorter than the least pulse is left out, the rest is whole."""
    return np.where(np.abs(u) > 0.5, u, 0.0)


def freezing(rng: np.random.Generator) -> Strange:
    """A linear plant whose sensor freezes for 30 samples now and then."""
    u = walk(rng)
    y = noisy(rng, lags(u))
    for begin in rng.choice(u.size - 30, 6, replace=False):
        y[begin : begin + 30] = y[begin]
    return Strange(u, y)


def swinging(rng: np.random.Generator) -> Strange:
    """A pendulum under torque: its spring is a sine."""
    u, y, z, v = walk(rng, hold=20.0), np.empty(SIZE), 0.0, 0.0
    for k in range(SIZE):
        y[k] = z
        v += 0.1 * (1.2 * u[k] - np.sin(z) * 2 - 0.8 * v)
        z += 0.1 * v
    return Strange(u, noisy(rng, y / y.std()))


def limited_and_sensed(rng: np.random.Generator) -> Strange:
    """A drive that saturates, and a dead zone of the sensor."""
    u = walk(rng)
    return Strange(u, noisy(rng, zone(lags(np.clip(u, -1.2, 1.0)))))


def of_changing_delay(rng: np.random.Generator) -> Strange:
    """A linear plant behind a pipe whose delay sways between 2 and 10 samples."""
    u = walk(rng)
    late = np.rint(6 + 4 * np.sin(np.linspace(0, 10 * np.pi, u.size))).astype(int)
    return Strange(u, noisy(rng, lags(u[np.maximum(np.arange(u.size) - late, 0)], 6.0)))


def with_leak(rng: np.random.Generator) -> Strange:
    """A zone whose sensor's zero creeps with its reading, slowly."""
    u = walk(rng)
    y = zone(lags(u))
    return Strange(u, noisy(rng, y + 0.3 * lags(y, 100.0, 1)), {}, BOTH)


# --- Kinds that were chosen last


def interpolated(rng: np.random.Generator) -> Strange:
    """A linear plant whose recorder fills three of four readings along straight lines."""
    u, k = walk(rng), np.arange(SIZE)
    y = noisy(rng, lags(u))
    return Strange(u, np.interp(k, k[::4], y[::4]))


def with_inverse_response(rng: np.random.Generator) -> Strange:
    """A linear plant that begins the wrong way."""
    u = walk(rng)
    return Strange(u, noisy(rng, lags(u, 12.0, 1) - 1.5 * lags(u, 4.0, 1)))


def unstable_in_loop(rng: np.random.Generator) -> Strange:
    """A linear plant that falls over, held by a controller."""
    r, y, u, x = walk(rng, SIZE, 30.0), np.empty(SIZE), np.empty(SIZE), 0.0
    for k in range(SIZE):
        y[k] = x + 0.02 * rng.standard_normal()
        u[k] = 3.0 * (r[k] - y[k])
        x = 1.03 * x + 0.06 * u[k]
    return Strange(u, y)


def cogging(rng: np.random.Generator) -> Strange:
    """The position of a motor whose magnets pull it to 12 places a turn."""
    u, y, x, v = 2 * steps(rng, 2500), np.empty(2500), 0.0, 0.0
    for k in range(y.size):
        y[k] = x
        for _ in range(10):
            v += 0.001 * (5 * u[k] - 5 * v - 3 * np.sin(12 * x))
            x += 0.001 * v
    return Strange(u, noisy(rng, y, 0.003 * y.std()), {"integrators": 1})


def preloaded(rng: np.random.Generator) -> Strange:
    """A lever between springs that are wound up: as a speed with friction, it needs a force to
    leave its middle.
    """
    u, y, x = walk(rng), np.empty(SIZE), 0.0
    for k in range(SIZE):
        y[k] = x
        moved = x + 0.1 * (u[k] - 0.6 * np.sign(x or u[k]) - x)
        rests = (x == 0 and abs(u[k]) < 0.6) or moved * x < 0
        x = 0.0 if rests else moved
    return Strange(u, noisy(rng, y / y.std()))


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
    goal, y, u, x, at = 0.3 * walk(rng, SIZE, 60.0), np.empty(SIZE), np.empty(SIZE), 0.0, 1.0
    for k in range(SIZE):
        y[k] = x + 0.01 * rng.standard_normal()
        at = 1.0 if y[k] < goal[k] - 0.1 else -1.0 if y[k] > goal[k] + 0.1 else at
        u[k] = at
        x += 0.05 * (2 * u[k] - x)
    return Strange(u, y)


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
    return np.asarray(zone(z - 0.75, 0.35, 0.35))


def noisy_by_size(rng: np.random.Generator) -> Strange:
    """A zone whose noise is a tenth of what it reads."""
    u = walk(rng)
    y = zone(lags(u))
    return Strange(u, noisy(rng, y * (1 + 0.1 * rng.standard_normal(SIZE)), 0.003), {}, BOTH)


def ringing(rng: np.random.Generator) -> Strange:
    """A zone behind a mass on a spring, which rings ten times."""
    u = walk(rng)
    z = lfilter([0.0, 1.0], [1.0, -2 * 0.98 * np.cos(0.2), 0.98**2], u)
    return Strange(u, noisy(rng, zone(z / z.std()), 0.01), {}, BOTH)


def compared(z: Floats) -> Floats:
    """One or zero, with a hysteresis."""
    y, at = np.empty(z.size), 0.0
    for k, value in enumerate(z):
        at = 1.0 if value > 0.2 else 0.0 if value < -0.2 else at
        y[k] = at
    return y


def nested(z: Floats) -> Floats:
    """Plays of four gaps side by side, as springs that slide (Iwan's friction) make them."""
    return np.asarray(sum(dragged(z, gap) for gap in (0.0, 0.3, 0.7, 1.2)) / 4)


def of_two_clocks(rng: np.random.Generator) -> Strange:
    """A linear plant whose readings have a clock that runs 1 % fast."""
    u, k = walk(rng), np.arange(SIZE)
    return Strange(u, noisy(rng, np.interp(k * 0.99, k, lags(u))))


def of_one_step(rng: np.random.Generator) -> Strange:
    """A linear plant whose input steps once."""
    u = np.where(np.arange(400) < 50, 0.0, 1.0)
    return Strange(u, noisy(rng, lags(u)))


def of_long_delay(rng: np.random.Generator) -> Strange:
    """A linear plant behind a delay of four of its time constants."""
    u = walk(rng)
    return Strange(u, noisy(rng, lags(np.append(np.zeros(48), u[:-48]))))


def diffusing(rng: np.random.Generator) -> Strange:
    """Heat in a thick wall: half an order, as lags of many time constants."""
    u = walk(rng, SIZE, 30.0)
    y = sum((0.5**n * lags(u, 3.0 * 4.0**n, 1) for n in range(5)), np.zeros(SIZE))
    return Strange(u, noisy(rng, y / y.std()))


def passing_on(rng: np.random.Generator) -> Strange:
    """A zone of the sensor behind a plant that passes on a third of its input at once."""
    u = walk(rng)
    return Strange(u, noisy(rng, zone(lags(u) + 0.3 * u), 0.01), {}, BOTH)


def slower_upwards(z: Floats) -> Floats:
    """A sensor that follows rises with a lag of 8 samples, and falls with one of 2."""
    y, at = np.empty(z.size), 0.0
    for k, value in enumerate(z):
        at += (value - at) / (8 if value > at else 2)
        y[k] = at
    return y


def dithered(rng: np.random.Generator) -> Strange:
    """A zone that a tone of its own size, which nobody recorded, carries across its edges."""
    u = walk(rng)
    tone = 0.4 * np.sin(2.2 * np.arange(SIZE))
    return Strange(u, noisy(rng, zone(lags(u) + tone), 0.01))


def rectified(rng: np.random.Generator) -> Strange:
    """A linear plant whose recorder writes the amplitude of its input."""
    u = walk(rng)
    return Strange(np.abs(u), noisy(rng, lags(u)))


def lagging_gap(rng: np.random.Generator) -> Strange:
    """A play of the sensor, whose readings have a lag of four samples."""
    u = walk(rng, 2000, 30.0)
    return Strange(u, noisy(rng, lfilter([0.22], [1.0, -0.78], dragged(lags(u), 0.7)), 0.005))


def static(curve: Callable[[Floats], Floats]) -> Callable[[np.random.Generator], Strange]:
    """A reading of the input of its own row, as a joystick's or a valve's at rest."""

    def make(rng: np.random.Generator) -> Strange:
        u = walk(rng)
        return Strange(u, noisy(rng, curve(u)))

    return make


def saturated_drive(rng: np.random.Generator) -> Strange:
    """A drive that lags, and ends at 0.9 of the input's rms, ahead of a plant."""
    u = walk(rng)
    return Strange(u, noisy(rng, lags(np.clip(lags(u, 4.0, 1), -0.9, 0.9))))


def with_drift(read: Callable[[Floats], Floats]) -> Callable[[np.random.Generator], Strange]:
    """A sensor whose zero drifts by half an rms along the log."""

    def make(rng: np.random.Generator) -> Strange:
        u = walk(rng)
        return Strange(u, noisy(rng, read(lags(u)) + np.linspace(0.0, 0.5, SIZE)))

    return make


def of_two_gains(rng: np.random.Generator) -> Strange:
    """A linear plant whose gain falls by a third in the middle of the log."""
    u = walk(rng)
    gain = np.where(np.arange(SIZE) < SIZE // 2, 1.2, 0.8)
    return Strange(u, noisy(rng, lags(u * gain)))


def with_coloured_noise(
    read: Callable[[Floats], Floats],
) -> Callable[[np.random.Generator], Strange]:
    """A sensor whose noise has a memory of 20 samples and a rms of a tenth."""

    def make(rng: np.random.Generator) -> Strange:
        u = walk(rng)
        return Strange(u, noisy(rng, read(lags(u)) + 0.1 * walk(rng, SIZE, 20.0), 0.01))

    return make


def with_much_noise(rng: np.random.Generator) -> Strange:
    """A zone with noise of a third of its width."""
    u = walk(rng)
    return Strange(u, noisy(rng, zone(lags(u)), 0.3), {}, BOTH)


def sampled(
    read: Callable[[Floats], Floats], samples: float
) -> Callable[[np.random.Generator], Strange]:
    """A sensor behind a plant whose time constant is so many samples."""

    def make(rng: np.random.Generator) -> Strange:
        u = walk(rng, 2400, samples)
        return Strange(u, noisy(rng, read(lags(u, samples)), 0.01), {}, BOTH)

    return make


def cylinder(rng: np.random.Generator) -> Strange:
    """The position of a hydraulic cylinder, whose valve overlaps, and which is faster outwards."""
    u = walk(rng, 2400, 20.0)
    v = zone(u, 0.4, 0.3)
    y = driven_motor(np.where(v > 0, 1.4 * v, v), 5.0)
    return Strange(u, noisy(rng, y, 0.003 * y.std()), {"integrators": 1})


def missing_counts(rng: np.random.Generator) -> Strange:
    """A motor whose encoder misses counts when it moves fast: linear, its position drifts."""
    u = steps(rng, 2500)
    moves = np.diff(driven_motor(u, 15.0), prepend=0.0)
    lost = (rng.random(u.size) < 0.02) & (np.abs(moves) > np.std(moves))
    y = np.cumsum(np.where(lost, 0.0, moves))
    return Strange(u, np.round(y, 2), {"integrators": 1})


def cut_root(z: Floats) -> Floats:
    """The root of a pressure drop, which reads 0 for small ones."""
    root = np.sign(z) * np.sqrt(np.abs(z))
    return np.asarray(np.where(np.abs(root) > 0.4, root, 0.0))


ZONE = ("dead_zone", "filtered_zone")
LINEAR = ("none", "operating_point")
BOTH = sum(WIDTHS)
ALL = {
    "fan": Kind(curved(lambda u: u * np.abs(u)), ("input_curve",)),
    "exponential valve": Kind(curved(np.expm1), ("input_curve",)),
    "soft limit of the input": Kind(curved(lambda u: np.tanh(2 * u)), ("input_curve",)),
    "cubic input": Kind(curved(lambda u: u + 0.4 * u**3), ("input_curve",)),
    "root of the input": Kind(curved(lambda u: np.sign(u) * np.sqrt(np.abs(u))), ("input_curve",)),
    "limit of the input": Kind(curved(lambda u: np.clip(u, -0.9, 1.1)), ()),
    "play ahead, 12": Kind(play_ahead(0.5, 12.0), ("input_play",)),
    "play ahead, 2": Kind(play_ahead(0.9, 2.0), ("input_play",)),
    "valve that sticks and slips": Kind(sticking, ("input_play", "stiction")),
    "rate limit of the input": Kind(curved(slow_rate), ("input_rate",)),
    "pulses about 1500": Kind(by_pulses, ("input_zone",)),
    "zone, mean of 4": Kind(sensed(lambda z: lfilter(np.ones(4) / 4, [1.0], zone(z)), BOTH), ZONE),
    "zone, lag of 3": Kind(sensed(lambda z: lfilter([0.3], [1.0, -0.7], zone(z)), BOTH), ZONE),
    "zone, median of 5": Kind(sensed(lambda z: medfilt(zone(z), 5), BOTH), ZONE),
    "zone of two slopes": Kind(sensed(slopes_apart), (*ZONE, "other")),
    "zone that ends": Kind(sensed(lambda z: np.clip(zone(z), -0.6, 0.8)), (*ZONE, "saturation")),
    "zone behind a drifting gain": Kind(drifting, ZONE),
    "rate limit of the sensor": Kind(sensed(slow_rate), ()),
    "soft sensor": Kind(sensed(lambda z: np.tanh(1.5 * z)), ("other", "saturation")),
    "joint, friction .3": Kind(joint(0.3), ("friction",)),
    "joint": Kind(joint(0.0), LINEAR),
    "motor of 5": Kind(motor(5.0), LINEAR),
    "motor of 15": Kind(motor(15.0), LINEAR),
    "motor of 50": Kind(motor(50.0), LINEAR),
    "motor of 150": Kind(motor(150.0), LINEAR),
    "motor of 500": Kind(motor(500.0), LINEAR),
    "fifth order": Kind(of_fifth_order, LINEAR),
    "mean of 5": Kind(averaged, LINEAR),
    "an input that nobody recorded": Kind(of_two_inputs, LINEAR),
    "spring that bends": Kind(softening, ()),
    "tank": Kind(tank, ()),
    "zone": Kind(sensed(zone, BOTH), ("dead_zone",)),
    "line": Kind(sensed(lambda z: z), LINEAR),
    # chosen after the code of the rounds before was finished
    "zone, heavy tails": Kind(tailed, ZONE),
    "two gains of the input": Kind(one_sided, ("input_curve",)),
    "zone that grows": Kind(widening, ZONE),
    "smooth hysteresis": Kind(bent_hysteresis, ("play", "both")),
    "two rates": Kind(of_two_rates, ()),
    "relay": Kind(switched, ()),
    "friction that falls": Kind(stribeck, ("friction",)),
    "zone in a loop": Kind(zone_in_loop, ZONE),
    "zone of a late input": Kind(late_zone, ("input_zone",)),
    "lag, zone, plant": Kind(with_actuator_lag, ()),
    "zone, round edges": Kind(sensed(rounded, BOTH), ZONE),
    "zone of one side": Kind(sensed(lambda z: zone(z, 0.6, 0.0), 0.6), ZONE),
    "root of the output": Kind(
        sensed(lambda z: np.sign(z) * np.sqrt(np.abs(z))), ("other", "saturation")
    ),
    "tenths of readings": Kind(sensed(lambda z: np.round(z, 1)), LINEAR),
    "two slopes, no zone": Kind(sensed(lambda z: np.where(z > 0, z, 0.6 * z)), ("other",)),
    "limit of one side": Kind(sensed(lambda z: np.minimum(z, 0.8)), ("saturation", "other")),
    "drag by the square": Kind(dragging, ()),
    "gain that sways": Kind(swaying, LINEAR),
    "input of uncertain time": Kind(jittery, LINEAR),
    "sensor's zero that wanders": Kind(wandering, LINEAR),
    "zone and spikes": Kind(with_spikes, ZONE),
    "relay with hysteresis": Kind(switching, ()),
    "lag, soft limit, plant": Kind(between_lags, ()),
    "zone beside a line": Kind(zone_beside, ("input_curve",)),
    "rounded input": Kind(curved(lambda u: np.round(u)), ()),
    "sensor of three slopes": Kind(sensed(lambda z: z - 0.5 * np.clip(z, -0.5, 0.4)), ("other",)),
    "heater": Kind(heated, ("input_curve", "input_zone")),
    "recorder on change": Kind(on_change, ()),
    "hum": Kind(humming, LINEAR),
    "gain by the output": Kind(bilinear, ()),
    "least pulse": Kind(curved(least_pulse), ()),
    "sensor that freezes": Kind(freezing, LINEAR),
    "pendulum": Kind(swinging, ()),
    "limit of the input, zone": Kind(limited_and_sensed, ZONE),
    "delay that sways": Kind(of_changing_delay, LINEAR),
    "zone that creeps": Kind(with_leak, ZONE),
    "interpolated readings": Kind(interpolated, LINEAR),
    "coarse readings": Kind(sensed(lambda z: 0.6 * np.round(z / 0.6)), LINEAR),
    "inverse response": Kind(with_inverse_response, LINEAR),
    "unstable plant in a loop": Kind(unstable_in_loop, LINEAR),
    "motor that cogs": Kind(cogging, ()),
    "springs wound up": Kind(preloaded, ("friction",)),
    "sensor of a logarithm": Kind(
        sensed(lambda z: np.sign(z) * np.log1p(3 * np.abs(z))), ("other", "saturation")
    ),
    "zone, two runs": Kind(of_two_runs, ZONE),
    "noise gate": Kind(sensed(lambda z: np.where(np.abs(z) > 0.4, z, 0.0), 0.8), ("jump",)),
    "smoothed both ways": Kind(smoothed, LINEAR),
    "lost rows": Kind(with_lost_rows, LINEAR),
    "loads that come and go": Kind(loaded, LINEAR),
    "thermostat": Kind(by_thermostat, LINEAR),
    "zone of the input, hunting": Kind(hunting, ("input_zone",)),
    "zone far from 0": Kind(sensed(apart_from_zero, 0.7), ZONE),
    "angle that wraps": Kind(sensed(lambda z: np.mod(z + 0.5, 1.0) - 0.5), ()),
    "flow without its sign": Kind(sensed(np.abs), ("other",)),
    "zone, read every fifth time": Kind(sensed(lambda z: np.repeat(zone(z)[::5], 5), BOTH), ZONE),
    "read every fifth time": Kind(sensed(lambda z: np.repeat(z[::5], 5)), LINEAR),
    "zone, noise by its size": Kind(noisy_by_size, ZONE),
    "zone of a light damping": Kind(ringing, ZONE),
    "comparator": Kind(sensed(compared), ()),
    "nested hystereses": Kind(sensed(nested), ("play", "both", "friction")),
    "clocks apart": Kind(of_two_clocks, LINEAR),
    "one step": Kind(of_one_step, LINEAR),
    "long dead time": Kind(of_long_delay, LINEAR),
    "diffusion": Kind(diffusing, LINEAR),
    "sensor of changes": Kind(sensed(lambda z: lfilter([1.0, -1.0], [1.0, -0.98], z)), LINEAR),
    "zone, sensor of changes": Kind(
        sensed(lambda z: lfilter([1.0, -1.0], [1.0, -0.98], zone(z)), BOTH), ()
    ),
    "zone with a share passed on": Kind(passing_on, ZONE),
    "sensor slower upwards": Kind(sensed(slower_upwards), ()),
    "range that switches": Kind(sensed(lambda z: np.where(np.abs(z) > 1, 1.05 * z, z)), ("other",)),
    "dithered zone": Kind(dithered, ZONE),
    "input without its sign": Kind(rectified, ()),
    "gap behind a lag": Kind(lagging_gap, ("play",)),
    # chosen last
    "no dynamics": Kind(static(lambda u: 2 * u), LINEAR),
    "no dynamics, zone": Kind(static(zone), (*ZONE, "input_zone")),
    "no dynamics, play": Kind(static(lambda u: dragged(u, 0.7)), ("play", "input_play")),
    "no dynamics, limit": Kind(static(lambda u: np.clip(u, -0.9, 1.1)), ("saturation",)),
    "slow drive that saturates": Kind(saturated_drive, ()),
    "offset that drifts": Kind(with_drift(lambda z: z), LINEAR),
    "zone, offset that drifts": Kind(with_drift(zone), ZONE),
    "gain that steps": Kind(of_two_gains, LINEAR),
    "coloured noise": Kind(with_coloured_noise(lambda z: z), LINEAR),
    "zone, coloured noise": Kind(with_coloured_noise(zone), ZONE),
    "zone, much noise": Kind(with_much_noise, ZONE),
    "zone, oversampled": Kind(sampled(zone, 120.0), ZONE),
    "zone, undersampled": Kind(sampled(zone, 0.7), ZONE),
    "cylinder": Kind(cylinder, ("input_zone",)),
    "encoder that misses counts": Kind(missing_counts, LINEAR),
    "root with a cut-off": Kind(sensed(cut_root), ("jump", "other")),
}
