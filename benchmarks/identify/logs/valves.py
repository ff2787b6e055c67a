"""Control loops (OP, PV, SP) with one known cause of their oscillation, for `valves`."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

CAUSES = ("none", "stiction", "dead band", "tight tuning", "external")
SIZES = (500, 800, 1200, 2000, 4000)
SETTLING = 300  # samples ahead of the log
SLUGGISH = 0.35  # share of loops whose controller is 2 to 15 times slower than it could be
Step = Callable[[float], float]


class ValveLoop(NamedTuple):
    """A log of a loop with its truth.

    Attributes:
        op, pv, sp: controller output [%], process value, set point (N).
        cause: of `CAUSES`.
        account: of the valve: Choudhury's, Kano's, He's; "" without stiction and play.
        stick, jump: S and J [% of OP].
        integrates: whether the process does.
    """

    op: np.ndarray
    pv: np.ndarray
    sp: np.ndarray
    cause: str
    account: str
    stick: float
    jump: float
    integrates: bool


class Choudhury:
    """Valve of Choudhury, Thornhill and Shah (2005), data-driven: stuck, jump, slide."""

    def __init__(self, stick: float, jump: float, first: float) -> None:
        self.stick, self.jump = stick, jump
        self.op = self.stuck_at = self.position = first
        self.direction = self.velocity = 0.0
        self.is_stuck = True

    def __call__(self, op: float) -> float:
        velocity = op - self.op
        if not self.is_stuck and np.sign(velocity) != np.sign(self.velocity):
            self.is_stuck, self.stuck_at = True, self.op
        if self.is_stuck:
            away = op - self.stuck_at
            needed = self.stick if np.sign(away) != self.direction else self.jump
            if self.direction == 0:
                needed = (self.stick + self.jump) / 2
            if abs(away) > needed:
                self.is_stuck, self.direction = False, float(np.sign(away))
        if not self.is_stuck:
            self.position = op - self.direction * (self.stick - self.jump) / 2
        self.op, self.velocity = op, velocity
        return self.position


class Kano:
    """Valve of Kano and others (2004): it rests as soon as its input turns or stands still."""

    def __init__(self, stick: float, jump: float, first: float) -> None:
        self.stick, self.jump = stick, jump
        self.op = self.rested_at = self.position = first
        self.direction, self.rests = 0.0, True

    def __call__(self, op: float) -> float:
        if not self.rests and self.direction * (op - self.op) <= 0:
            self.rests, self.rested_at = True, self.op
        self.op = op
        if self.rests:
            away = op - self.rested_at
            if self.direction == 0 and abs(away) > (self.stick + self.jump) / 2:
                self.rests, self.direction = False, float(np.sign(away))
            elif self.direction * away > self.jump:
                self.rests = False
            elif -self.direction * away > self.stick:
                self.rests, self.direction = False, -self.direction
        if not self.rests:
            self.position = op - self.direction * (self.stick - self.jump) / 2
        return self.position


class He:
    """Valve of He and others (2007): the force that is left over is the kinetic friction."""

    def __init__(self, stick: float, jump: float, first: float) -> None:
        self.static, self.kinetic = (stick + jump) / 2, (stick - jump) / 2
        self.op = self.position = first
        self.left = 0.0

    def __call__(self, op: float) -> float:
        push = self.left + op - self.op
        self.op = op
        if abs(push) > self.static:
            friction = math.copysign(self.kinetic, push)
            self.position += push - friction
            self.left = friction
        else:
            self.left = push
        return self.position


ACCOUNTS = {"Choudhury": Choudhury, "Kano": Kano, "He": He}


class Process(NamedTuple):
    """Process of a lag, or two, and a delay, with its controller."""

    poles: tuple[float, ...]
    gain: float
    delay: int
    proportional: float
    integral: float
    derivative: float

    def with_gain(self, factor: float) -> Process:
        """The same with another gain of the controller."""
        return self._replace(proportional=self.proportional * factor)

    def radius(self) -> float:
        """Spectral radius of the linear loop."""
        controller = self.proportional * np.array(
            [1 + 1 / self.integral + self.derivative, -1 - 2 * self.derivative, self.derivative]
        )
        den = np.poly([1.0, *self.poles])
        late = np.zeros(self.delay + 1 + controller.size)
        late[self.delay + 1 :] = self.gain * controller
        whole = np.zeros(max(den.size, late.size))
        whole[: den.size] += den
        whole[: late.size] += late
        return float(np.abs(np.roots(whole)).max())


def make(
    seed: int,
    cause: str | None = None,
    size: int | None = None,
    commanded: Step | None = None,
    added: Step | None = None,
) -> ValveLoop:
    """A loop by its seed; the causes take turns.

    Args:
        seed: of everything.
        cause: of `CAUSES`.
        size: samples.
        commanded: what compensates the valve, between OP and valve; None: nothing.
        added: what the integral part adds up in place of the error; None: the error.
    """
    rng = np.random.default_rng([53, seed])
    cause = cause or CAUSES[seed % len(CAUSES)]
    size = size or int(rng.choice(SIZES))
    process, range_pv, integrates = _process(rng, cause)
    account = str(rng.choice(list(ACCOUNTS)))
    stick = rng.uniform(1.0, 8.0) if cause in ("stiction", "dead band") else 0.0
    jump = stick * rng.uniform(0.15, 1.1) if cause == "stiction" else 0.0
    faulty: Step = ACCOUNTS[account](stick, jump, 50.0) if stick else lambda op: op
    valve = faulty if commanded is None else lambda op: faulty(commanded(op))
    total = size + SETTLING
    set_point = np.full(total, 50.0)
    if cause in ("none", "dead band") or rng.random() < 0.5:
        for begin in range(0, total, size // 6):
            set_point[begin:] = 50.0 + range_pv * rng.uniform(-0.4, 0.4)
    noise, drift = (range_pv * rng.choice([0.002, 0.01, 0.03]) for _ in range(2))
    op, pv = run_loop(
        process,
        valve,
        set_point,
        noise,
        drift,
        _oscillation(rng, cause, process, total, range_pv),
        rng,
        added,
    )
    steady = slice(SETTLING, None)
    account = account if stick else ""
    return ValveLoop(
        op[steady], pv[steady], set_point[steady], cause, account, stick, jump, integrates
    )


def _process(rng: np.random.Generator, cause: str) -> tuple[Process, float, bool]:
    """A process tuned by its internal model, or up to its limit; what 10 % of OP make of PV."""
    integrates = bool(rng.random() < 0.35)
    gain, lag, delay = rng.uniform(0.4, 3.0), rng.uniform(3.0, 40.0), int(rng.integers(1, 12))
    closed = delay * rng.uniform(1.0, 3.0)
    second = math.exp(-1 / rng.uniform(1.0, 4.0)) if rng.random() < 0.3 else 0.0
    derivative = rng.uniform(0.0, 0.3) * delay if rng.random() < 0.25 else 0.0
    if integrates:
        slope = gain / 30
        tuned = 1 / (slope * (closed + delay)), 4 * (closed + delay) * rng.uniform(0.7, 1.5)
        process = Process((1.0, second), slope * (1 - second), delay, *tuned, derivative)
    else:
        pole = math.exp(-1 / lag)
        tuned = lag / (gain * (closed + delay)), min(lag, 4 * (closed + delay))
        through = gain * (1 - pole) * (1 - second)
        process = Process((pole, second), through, delay, *tuned, derivative)
    if cause == "tight tuning":
        low, high = 1.0, 60.0
        for _ in range(40):
            middle = math.sqrt(low * high)
            stable = process.with_gain(middle).radius() < 1
            low, high = (middle, high) if stable else (low, middle)
        process = process.with_gain(low / rng.uniform(1.01, 1.08))
    else:
        for _ in range(9):  # a gain margin of 1.7
            if process.with_gain(1.7).radius() < 1:
                break
            process = process.with_gain(0.8)
        if rng.random() < SLUGGISH:
            process = process.with_gain(math.exp(-rng.uniform(math.log(2), math.log(15))))
    return process, 10.0 if integrates else 10.0 * gain, integrates


def _oscillation(
    rng: np.random.Generator, cause: str, process: Process, total: int, range_pv: float
) -> np.ndarray:
    """Return the external oscillation of PV (N)."""
    phase = 2 * np.pi * np.arange(total) / (rng.uniform(4.0, 12.0) * (process.delay + 3))
    bent = 0.3 * np.sin(2 * phase + 1) + 0.2 * np.sin(3 * phase) if rng.random() < 0.5 else 0.0
    size = range_pv * rng.uniform(0.05, 0.3) * (cause == "external")
    return np.asarray(size * (np.sin(phase) + bent))


def run_loop(
    process: Process,
    valve: Step,
    set_point: np.ndarray,
    noise: float,
    drift: float,
    outside: np.ndarray,
    rng: np.random.Generator,
    added: Step | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """OP and PV of a loop (N, N)."""
    total = set_point.size
    op, pv = np.empty(total), np.empty(total)
    den = np.poly(process.poles)
    white = rng.standard_normal((total, 3))
    late, states = [0.0] * (process.delay + 1), [0.0, 0.0]
    out, wander, load, error, before = 50.0, 0.0, 0.0, 0.0, 0.0
    for t in range(total):
        wander = 0.97 * wander + 0.25 * drift * white[t, 0]
        load = 0.999 * load + 0.05 * white[t, 1]
        pv[t] = 50.0 + states[0] + wander + outside[t] + noise * white[t, 2]
        now = set_point[t] - pv[t]
        if t:
            change = now - error + (added(now) if added else now) / process.integral
            change += process.derivative * (now - 2 * error + before)
            out = min(max(out + process.proportional * change, 0.0), 100.0)
        before, error = error, now
        op[t] = out
        late.append(valve(out) - 50.0 + load)
        moved = process.gain * late[-1 - process.delay] - den[1] * states[0] - den[2] * states[1]
        states = [moved, states[0]]
    return op, pv
