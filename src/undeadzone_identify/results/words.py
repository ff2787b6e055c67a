"""Answer as numbers for JSON and as words for the terminal.

A servo behind gear play in numbers and words: its parts, and every crossing.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from undeadzone.nonlinearities.sensor import DIRECTIONS
from undeadzone.results.mjcf import Joint
from undeadzone.util.arrays import Floats
from undeadzone_identify.models.estimates import Interval
from undeadzone_identify.models.shape import SensorShape
from undeadzone_identify.results.account import Account
from undeadzone_identify.results.assemble import Answer
from undeadzone_identify.results.formats import describe_ends, describe_interval, unit_suffix
from undeadzone_identify.results.lines import rest_noise
from undeadzone_identify.selection.odds import nats_behind_best
from undeadzone_identify.servo.likelihood import At

WITHOUT_GAP = ("none", "friction")  # words of a servo whose gap is excluded


def servo_numbers(answer: Answer) -> dict[str, Any] | None:
    """Return the servo in units of the log with its crossings by column; None without a servo.

    Args:
        answer: to a log.
    """
    servo = answer.servo
    if servo is None or answer.verdict in WITHOUT_GAP:
        return None
    log = servo.log
    one = servo.servo
    theta = one.structure.disable_absent_parts(one.theta)
    parts = one.structure.parts
    rate = log.step / log.seconds
    gain = float(theta[At.GAIN]) * log.y_scale / log.u_scale
    return {
        "parts": sorted(parts),
        "inertia": not one.structure.lag,
        "damping": math.exp(theta[At.DAMPING]) * rate,
        "gain": gain * (rate if one.structure.lag else rate**2),
        "friction": float(theta[At.FRICTION]) * log.u_scale,
        "load_friction": float(theta[At.LOAD]) * log.u_scale,
        "spring": math.exp(theta[At.SPRING]) * rate**2,
        "electrical_pole": math.exp(theta[At.POLE]) * rate if "pole" in parts else None,
        "delay": float(theta[At.DELAY]) * log.seconds,
        "torque": math.exp(theta[At.TORQUE]) * log.u_scale,
        "slow_torque": math.exp(theta[At.SLOW]) * log.u_scale,
        "trends": servo.trend_remarks,
        "crossings": {name: column.tolist() for name, column in crossing_columns(answer).items()},
    }


def servo_joints(answer: Answer) -> list[Joint]:
    """Return the gears of a servo for MuJoCo; none for other answers, or without inertia.

    Args:
        answer: of a log whose input is a torque [N m] and whose output is an angle [rad].
    """
    servo = answer.servo
    numbers = servo_numbers(answer)
    if servo is None or numbers is None or not numbers["inertia"] or answer.verdict != "play":
        return []
    gap = servo.gap
    inertia = 1 / abs(numbers["gain"])
    words = f"gap {gap.value:.4g} rad [{gap.low:.4g}, {gap.high:.4g}], if y is in rad, u in N m"
    half = gap.value / 2
    motor = (numbers["friction"], numbers["damping"] * inertia)
    return [Joint("q", words, half, half, inertia, *motor, link=(numbers["load_friction"], 0.0))]


def crossing_columns(answer: Answer) -> dict[str, Floats]:
    """Return the crossings of a servo's gap by column; empty without a servo."""
    if answer.servo is None or answer.verdict in WITHOUT_GAP:
        return {}
    crossings = answer.servo.crossings
    return {
        "t": answer.case.grid.t[crossings.at],
        "side": crossings.side.astype(float),
        "speed": crossings.speed,
        "duration": crossings.duration,
        "y": crossings.y + float(answer.case.grid.y[answer.case.grid.ok][0]),
        "gap": crossings.gap,
    }


def describe_crossings(answer: Answer, unit: str) -> str:
    """Describe the median and range of all crossings of a servo's gap."""
    gaps = crossing_columns(answer)["gap"]
    middle, low, high = np.quantile(gaps, [0.5, 0.1, 0.9])
    return (
        f"all {gaps.size}: median {middle:.4g}{unit}, 80 % within {low:.4g} to {high:.4g}{unit}."
        " Each is in the JSON"
    )


# --- Any answer

SHORT = {
    "dead_zone": "sensor",
    "input_zone": "input",
    "both": "play and sensor",
    "zone_and_friction": "sensor and friction",
    "two_zones": "sensor and input",
    "input_curve": "curve of the input",
    "input_rate": "rate of the input",
    "input_play": "play ahead",
    "filtered_zone": "sensor with a shape",
}
GAINS = (("DC gain", ""), ("gain of the rate", " 1/s"), ("gain of the acceleration", " 1/s^2"))
LEAST_PRINTED = 0.005  # odds that are worth a word


# --- Numbers


def answer_numbers(answer: Answer, account: Account) -> dict[str, Any]:
    """Return all numbers of an answer, as nested dictionaries.

    Args:
        answer: to a log.
        account: of it.

    Returns:
        zone, verdict, right, left, width, centre (each [value, low, high] or None), order,
        alternatives, held_out, and more.
    """
    grid = answer.case.grid
    chosen = answer.chosen
    at_input = None if answer.element is None else answer.element.input
    return {
        "zone": answer.zone,
        "verdict": answer.verdict,
        "found": account.headline(),
        "answer": account.to_json(),
        "reasons": answer.reasons,
        **{name: _interval_list(getattr(answer, name)) for name in DIRECTIONS},
        "input_widths": None
        if not at_input
        else {k: _interval_list(one) for k, one in at_input.items()},
        "order": answer.order,
        "plant": {
            "poles": [[float(pole.real), float(pole.imag)] for pole in answer.poles],
            "gain": answer.gain.tolist(),
        },
        "disturbance": answer.disturbance._asdict(),
        "zone_width": None if answer.element is None else _interval_list(answer.element.zone),
        "odds": answer.found.odds,
        "alternatives": nats_behind_best(answer.found.models),
        "friction": _interval_list(answer.found.friction),
        "shape": answer.shape
        and {name: _interval_list(one) for name, one in answer.shape._asdict().items()},
        "servo": servo_numbers(answer),
        "loop": None,
        "held_out": {
            "error": chosen.error * answer.scale,
            "fit": chosen.share,
            "white": chosen.white,
        },
        "orders": [
            {"order": one.n, "bic": one.fit.bic, "held_out_error": one.error * answer.scale}
            for one in answer.case.fitted.fits
        ],
        "closed_loop": answer.loop.chance,
        "answered": answer.loop.answered,
        "no_zone": answer.case.no_zone.chance,
        "left_over": {
            one.on: {"share": one.share, "p": one.chance} for one in answer.found.remainders
        },
        "excitation": {
            "samples": list(answer.excitation.samples),
            "visits": list(answer.excitation.visits),
            "silent": answer.excitation.silent,
            "longest_silence": answer.excitation.longest * grid.step,
        },
        "record": {
            "samples": int(grid.t.size),
            "readings": int(grid.ok.sum()),
            "records": int(grid.start.size),
            "step": grid.step,
            "quantum": grid.quantum,
            "rest_noise": rest_noise(answer),
        },
        "input_zero": grid.zero,
        "output_zero": answer.case.options.zero or None,
        "units": {"input": grid.input_unit, "output": grid.output_unit},
        "remarks": answer.remarks,
    }


def _interval_list(interval: Interval | None) -> list[float] | None:
    """Return [value, low, high], or None."""
    return None if interval is None else list(map(float, interval))


# --- Words


def summarise_answer(answer: Answer, account: Account) -> dict[str, Any]:
    """Return the answer as lines of the terminal: name and text, or a list of texts.

    Args:
        answer: to a log.
        account: of it.

    Returns:
        The lines in order.
    """
    grid = answer.case.grid
    unit = unit_suffix(grid.output_unit)
    lines: dict[str, Any] = {"record": _describe_record(answer), "plant": _describe_plant(answer)}
    lines |= account.summary()
    if answer.found.odds:
        lines["odds"] = describe_shares(answer.found.odds)
    if answer.zone and answer.element is None:
        passes = zip(*answer.excitation[:2], strict=True)
        right, left = (f"{visits} times, {samples} samples" for samples, visits in passes)
        lines["passed"] = f"right edge {right}; left edge {left}"
    if grid.zero is not None and answer.left is not None and answer.right is not None:
        lines["input"] = describe_ends(grid.zero, answer.left, answer.right)
    if answer.shape is not None:
        lines["shape"] = _describe_shape(answer.shape, unit)
    if crossing_columns(answer):
        lines["crossings"] = describe_crossings(answer, unit)
    lines["disturbance"] = _describe_disturbance(answer, unit)
    lines["held out"] = _describe_held_out(answer, unit)
    if answer.remarks:
        lines["note"] = answer.remarks
    return lines


def _describe_shape(shape: SensorShape, unit: str) -> str:
    """Describe rounding, slopes and lag of a sensor."""
    rounding = describe_interval(shape.rounding, unit)
    slope = describe_interval(shape.slope, "")
    lag = describe_interval(shape.lag, " s")
    return f"edges round over {rounding}; slope of the left side over the right {slope}; lag {lag}"


def _describe_record(answer: Answer) -> str:
    """Describe samples, step, names and units, share of samples inside the zone."""
    grid = answer.case.grid
    names = ", ".join(f"{name} [{grid.input_unit}]" for name in grid.inputs)
    step = "times count samples" if grid.counted else f"{grid.step:.6g} s"
    text = f"{grid.t.size} samples, {step}, {names}, {grid.output} [{grid.output_unit}]"
    if grid.start.size > 1:
        text += f", {grid.start.size} records"
    if not answer.zone:
        return text
    return f"{text}; {100 * answer.excitation.silent:.0f} % of z inside the zone"


def _describe_plant(answer: Answer) -> str:
    """Describe order, poles, gains."""
    grid = answer.case.grid
    rate = "1/sample" if grid.counted else "1/s"
    pole_texts = []
    for pole in answer.poles:
        if abs(abs(pole.imag) * grid.step - np.pi) < 1e-9:  # negative in sampled time
            pole_texts.append(f"{pole.real:.4g} with a sign that alternates from sample to sample")
        elif pole.imag > 1e-12 * abs(pole):
            pole_texts.append(f"{pole.real:.4g} +- {pole.imag:.4g}i")
        elif abs(pole.imag) <= 1e-12 * abs(pole):
            pole_texts.append(f"{pole.real:.4g}")
    unit = f"{grid.output_unit}/{grid.input_unit}"
    unit = "" if unit == "1/1" else f" {unit}"
    gains = ", ".join(f"{gain:.4g}" for gain in answer.gain)
    kind, of_time = GAINS[min(answer.plant[0].layout.integrators, 2)]
    poles = f"order {answer.order} (BIC), poles {', '.join(pole_texts)} {rate}"
    return f"{poles}, {kind} {gains}{unit}{of_time}"


def describe_shares(odds: dict[str, float]) -> str:
    """Describe probabilities of classes, those that are worth a word: sensor 97 %, friction 3 %.

    Args:
        odds: by class [1].
    """
    texts = []
    for word, share in odds.items():
        if share >= LEAST_PRINTED:
            percent = "> 99" if share > 1 - LEAST_PRINTED else f"{100 * share:.0f}"
            texts.append(f"{SHORT.get(word, word)} {percent} %")
    return ", ".join(texts)


def _describe_disturbance(answer: Answer, unit: str) -> str:
    """Describe rms and correlation time of the disturbance."""
    disturbance = answer.disturbance
    text = f"rms {disturbance.rms:.3g}{unit} {'at z' if disturbance.ahead else 'of the readings'}"
    if disturbance.correlation_time is not None:
        unit_of_time = "samples" if answer.case.grid.counted else "s"
        text += f", correlation time {disturbance.correlation_time:.2g} {unit_of_time}"
    if disturbance.model is not None:
        text += f", {disturbance.model}, white part {disturbance.white:.2g}{unit}"
    return text


def _describe_held_out(answer: Answer, unit: str) -> str:
    """Describe the fit on held-out data."""
    chosen = answer.chosen
    share = f"{100 * answer.case.options.held_out:.0f} % in blocks"
    white = "white" if chosen.white else "not white"
    fit = f"{100 * chosen.share:.1f} %" if chosen.share > -1 else "below -100 %"
    return (
        f"{share}: rms error {chosen.error * answer.scale:.3g}{unit},"
        f" fit {fit}, one-step residual {white}"
    )
