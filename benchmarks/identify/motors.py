"""Motors: is a gap named where none is, and found where one is? Beside two fits from outside.

MOTORS_LOGS: of each kind (4), MOTORS_FIRST: the first seed (100), MOTORS_METHODS: which, separated
by semicolons, MOTORS_RIVALS: 0 leaves out the fits with MuJoCo's own model, which take most of
the time. With both encoders `identify` asks for no friction, so none counts as right of rigid ones.

`mujoco.sysid` has MuJoCo's own model, told all but its numbers, and starts from two gaps. Its gap
is held if its 95 % interval holds it. Output error is the plain fit of order 2 with an integrator.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter

import undeadzone as uz
from benchmarks.identify.logs.motors import (
    INERTIA,
    PARTS,
    STEP,
    Motor,
    random_motor,
    record,
    record_both,
)
from benchmarks.markdown import head, row
from undeadzone.util.arrays import Floats

FALSE = 1e-3  # gap [rad] from which a fit that knows no names says that there is one
STARTS = (0.005, 0.04)  # gaps [rad]
STEPS = 12  # of a fit in MuJoCo
NO_NAME = ("undecided", "unclear")
SYSID_KNOWING_MODEL = "mujoco.sysid, told the model"
# First value and limits of ln inertia [of the true one], ln damping, ln load by rotor, friction.
SYSID = {
    "inertia": (0.0, -3.0, 3.0),
    "damping": (math.log(0.1), -9.0, 3.0),
    "share": (0.0, -3.0, 3.0),
    "friction": (0.01, 0.0, 0.3),
}


class Answer(NamedTuple):
    """What a method says of a log.

    Attributes:
        word: play, friction, none, another name or undecided.
        gap: with its interval [rad]; None: not given.
        friction: [N m]; nan: not given.
        samples: time constant [samples]; nan: not given.
        seconds: CPU.
    """

    word: str
    gap: tuple[float, float, float] | None
    friction: float
    samples: float
    seconds: float


def identified(u: Floats, y: Floats) -> Answer:
    """Return what `identify` says of a motor's log."""
    begun = time.process_time()
    try:
        found = uz.identify(t=STEP, u=u, y=y, integrators=1)
    except uz.InputError:
        return Answer("refused", None, math.nan, math.nan, time.process_time() - begun)
    seconds = time.process_time() - begun
    assert isinstance(found, uz.Identified)
    friction = found.answer.found.friction
    poles = [pole.real for pole in found.answer.poles if pole.real < 0]
    samples = -1 / (max(poles) * STEP) if poles else math.nan
    level = math.nan if friction is None else friction.value
    level = 0.0 if found.verdict == "none" else level
    width = found.width if found.verdict == "play" else None
    gap = None if width is None else (width.value, width.low, width.high)
    return Answer(found.verdict, gap, level, samples, seconds)


def by_both_encoders(motor: Motor, seed: int) -> Answer:
    """Return what `identify` says of torque, motor and load by their names, without any option."""
    u, angles = record_both(motor, seed)
    begun = time.process_time()
    columns = {"t [s]": STEP * np.arange(u.size), "torque [Nm]": u}
    columns |= {"motor [rad]": angles[:, 0], "load [rad]": angles[:, 1]}
    found = uz.identify(pd.DataFrame(columns))
    seconds = time.process_time() - begun
    width = found.width if found.verdict == "play" else None
    gap = None if width is None else (width.value, width.low, width.high)
    return Answer(found.verdict, gap, math.nan, math.nan, seconds)


def output_error(u: Floats, y: Floats) -> Answer:
    """Return the fit of y = K / (s (T s + 1)) u by output errors; all but T is linear."""
    begun = time.process_time()
    ones, t = np.ones(u.size), np.arange(u.size) * STEP

    def columns(ln_time: float) -> Floats:
        time = math.exp(ln_time)
        keep = math.exp(-STEP / time)
        driven = np.column_stack([u, ones])
        rates = lfilter([0.0, 1 - keep], [1.0, -keep], driven, axis=0)
        lost = time * (1 - keep)
        moved = np.cumsum(lost * rates + (STEP - lost) * driven, axis=0)
        moved = np.vstack([np.zeros((1, 2)), moved[:-1]])
        return np.column_stack([moved, ones, time * (1 - np.exp(-t / time))])

    def left(ln_time: float) -> float:
        each = columns(ln_time)
        rest = y - each @ np.linalg.lstsq(each, y, rcond=None)[0]
        return float(np.log(rest @ rest + 1e-300))

    grid = np.log(STEP * np.geomspace(1.0, 2000.0, 40))
    first = int(np.argmin([left(one) for one in grid]))
    around = grid[max(first - 1, 0)], grid[min(first + 1, grid.size - 1)]
    best = float(minimize_scalar(left, bounds=around, method="bounded").x)
    spent = time.process_time() - begun
    return Answer("", None, math.nan, math.exp(best) / STEP, spent)


def by_sysid(u: Floats, y: Floats, motor: Motor) -> Answer:
    """Return the numbers of `mujoco.sysid`, fitted to the readings from two gaps.

    It rolls the model out at all points of a derivative in parallel, here in one thread, as CPU
    time is compared.
    """
    import mujoco
    from mujoco import sysid

    begun = time.process_time()
    spec = mujoco.MjSpec.from_string(motor._replace(gap=STARTS[0], ratio=1.0).xml)
    angle = spec.add_tendon(name="angle")
    angle.wrap_joint("motor", 1.0)
    angle.wrap_joint("gap", float(motor.at_load))
    spec.add_sensor(
        name="encoder",
        type=mujoco.mjtSensor.mjSENS_TENDONPOS,
        objtype=mujoco.mjtObj.mjOBJ_TENDON,
        objname="angle",
    )
    model = spec.compile()
    # A sensor of MuJoCo is of the state ahead of a step, and sysid counts it at the step's end. So
    # readings are given one of its steps late.
    fine = STEP / PARTS * np.arange(PARTS * u.size)
    control = sysid.TimeSeries.from_control_names(fine, np.repeat(u, PARTS)[:, None], model)
    times = STEP * np.arange(1, u.size) + STEP / PARTS
    readings = sysid.TimeSeries.from_names(times, y[1:, None], model, ["encoder"])
    at_rest = sysid.create_initial_state(model, np.zeros(2))
    record = sysid.ModelSequences("motor", spec, "log", at_rest, control, readings)
    residual = sysid.build_residual_fn(
        models_sequences=[record], build_model=_with_numbers, n_threads=1
    )
    tops = []
    for gap in STARTS:
        numbers = sysid.ParameterDict()
        for name, (first, low, high) in (SYSID | {"gap": (gap, 0.0, 0.2)}).items():
            numbers.add(sysid.Parameter(name, first, low, high))
        with contextlib.redirect_stdout(io.StringIO()):  # it prints a line a step
            found, end = sysid.optimize(numbers, residual, verbose=False, max_iters=STEPS, eps=1e-4)
        left = residual(end.x, found)[0]
        half = sysid.calculate_intervals(left, end.jac)[1]
        tops.append((float(np.sum(np.concatenate(left) ** 2)), np.ravel(end.x), half))
    _, x, half = min(tops, key=lambda top: top[0])
    word = "play" if x[4] > FALSE else "none"
    samples = INERTIA * math.exp(x[0] - x[1]) / STEP
    spent = time.process_time() - begun
    return Answer(word, (x[4], x[4] - half[4], x[4] + half[4]), x[3], samples, spent)


def _with_numbers(numbers: Any, spec: Any) -> Any:
    """Return MuJoCo's model with the numbers of a fit."""
    inertia, damping, share, friction, gap = numbers.as_vector()
    whole = INERTIA * math.exp(inertia)
    rotor = whole / (1 + math.exp(share))
    spec.body("rotor").inertia = [rotor] * 3
    spec.body("load").inertia = [whole - rotor] * 3
    spec.joint("motor").damping[0] = math.exp(damping)
    spec.joint("motor").frictionloss = friction
    half = max(gap, 1e-7) / 2
    spec.joint("gap").range = [-half, half]
    return spec.compile()


# --- The table


def _median_error(values: Sequence[float], truths: Sequence[float]) -> str:
    """Return the median of relative errors in per cent, of values that there are."""
    errors = [
        abs(value / truth - 1)
        for value, truth in zip(values, truths, strict=True)
        if truth > 0 and math.isfinite(value)
    ]
    return f"{100 * float(np.median(errors)):.1f} %" if errors else "-"


def right_word(motor: Motor, rubs: bool) -> str:
    """Return the verdict that is right of a motor's log.

    Args:
        motor: which.
        rubs: whether friction is asked for.
    """
    if motor.gap:
        return "play"
    return "friction" if motor.friction and rubs else "none"


def _row(kind: str, method: str, motors: Sequence[Motor], answers: Sequence[Answer]) -> str:
    """Return a row of the table."""
    has_gap = bool(motors[0].gap)
    named = [one.word == "play" for one in answers]
    withheld = [one.word in (*NO_NAME, "refused") for one in answers]
    rubs = method != "identify, both encoders"
    truths = [right_word(motor, rubs) for motor in motors]
    other = [
        one.word not in (truth, "play", *NO_NAME, "refused", "")
        for one, truth in zip(answers, truths, strict=True)
    ]
    gaps = [(one.gap, motor.gap) for one, motor in zip(answers, motors, strict=True) if one.gap]
    covered = [gap[1] <= truth <= gap[2] for gap, truth in gaps if math.isfinite(gap[1])]
    values = [math.nan if one.gap is None else one.gap[0] for one in answers]
    return row(
        kind,
        method,
        str(len(answers)),
        f"{sum(named)}" if method != "output error" else "-",
        f"{sum(other)}" if method != "output error" else "-",
        f"{sum(withheld)}",
        _median_error(values, [motor.gap for motor in motors]) if has_gap else "-",
        f"{sum(covered)} of {len(covered)}" if covered else "-",
        _median_error([one.friction for one in answers], [motor.friction for motor in motors]),
        _median_error([one.samples for one in answers], [motor.samples for motor in motors]),
        f"{np.median([one.seconds for one in answers]):.1f}",
    )


KINDS: dict[str, Callable[[Motor], bool]] = {
    "open loop, encoder at the motor": lambda one: not one.closed and not one.at_load,
    "loop, encoder at the motor": lambda one: one.closed and not one.at_load,
    "open loop, encoder at the load": lambda one: not one.closed and one.at_load,
    "loop, encoder at the load": lambda one: one.closed and one.at_load,
}


METHODS: dict[str, Callable[[Floats, Floats, Motor, int], Answer]] = {
    "identify": lambda u, y, motor, seed: identified(u, y),
    "identify, both encoders": lambda u, y, motor, seed: by_both_encoders(motor, seed),
    "output error": lambda u, y, motor, seed: output_error(u, y),
    SYSID_KNOWING_MODEL: lambda u, y, motor, seed: by_sysid(u, y, motor),
}


def table() -> str:
    """Return the section of RESULTS.md."""
    count = int(os.environ.get("MOTORS_LOGS", "4"))
    first = int(os.environ.get("MOTORS_FIRST", "100"))
    requested = os.environ.get("MOTORS_METHODS", ";".join(METHODS)).split(";")
    if os.environ.get("MOTORS_RIVALS", "1") == "0":
        requested = [one for one in requested if one != SYSID_KNOWING_MODEL]
    lines = [
        "## Motors",
        "",
        "MuJoCo's joints, torque in, angle out, 200 Hz, 8 s: load 0.1 to 10 times the motor's"
        " inertia, time constants of 5 to 500 samples, friction 0 or 0.03 N m, noise of 0.2 mrad or"
        " 8192 ticks a turn, gaps of 6 to 60 mrad. Other names: not what is there, as none or"
        " friction where there is a gap.",
        "",
    ]
    lines += head("log", "method", "logs", "gap named", "other names", "withheld", "gap off",
                  "gap held", "friction off", "time constant off", "CPU s")  # fmt: skip
    for with_gap in (False, True):
        seeds = range(first, first + 4 * count)
        every = {seed: random_motor(seed, with_gap) for seed in seeds}
        for kind, belongs in KINDS.items():
            own = {seed: one for seed, one in every.items() if belongs(one)}
            logs = {seed: record(one, seed) for seed, one in own.items()}
            motors = list(own.values())
            name = f"{'gap' if with_gap else 'rigid'}, {kind}"
            for method, ask in METHODS.items():
                if method in requested:
                    answers = [ask(*log, own[seed], seed) for seed, log in logs.items()]
                    lines.append(_row(name, method, motors, answers))
    return "\n".join([*lines, ""])
