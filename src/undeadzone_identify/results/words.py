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
from undeadzone.util.text import bracket_interval
from undeadzone_identify.models.estimates import Interval
from undeadzone_identify.models.least_squares import describe_p_value
from undeadzone_identify.models.shape import SensorShape
from undeadzone_identify.results.assemble import Answer
from undeadzone_identify.results.loop_words import loop_numbers, shape_in_words
from undeadzone_identify.selection.alternatives import OF_INPUT
from undeadzone_identify.selection.decision import MODELS, VALVE
from undeadzone_identify.selection.odds import nats_behind_best
from undeadzone_identify.selection.valve import ValveFindings
from undeadzone_identify.servo.likelihood import At

WITHOUT_GAP = ("none", "friction")  # words of a servo whose gap is excluded
PRINTED = 4  # crossings on the terminal
SIDES = {1: "right", -1: "left"}


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
    theta = one.theta
    parts = one.structure.parts
    rate = log.step / log.seconds
    gain = float(theta[At.GAIN]) * log.y_scale / log.u_scale
    return {
        "parts": sorted(parts),
        "inertia": not one.structure.lag,
        "damping": math.exp(theta[At.DAMPING]) * rate,
        "gain": gain * (rate if one.structure.lag else rate**2),
        "friction": float(theta[At.FRICTION]) * log.u_scale if "friction" in parts else 0.0,
        "load_friction": float(theta[At.LOAD]) * log.u_scale if "load" in parts else 0.0,
        "spring": math.exp(theta[At.SPRING]) * rate**2 if "spring" in parts else 0.0,
        "electrical_pole": math.exp(theta[At.POLE]) * rate if "pole" in parts else None,
        "delay": float(theta[At.DELAY]) * log.seconds,
        "torque": math.exp(theta[At.TORQUE]) * log.u_scale,
        "slow_torque": math.exp(theta[At.SLOW]) * log.u_scale if "slow" in parts else 0.0,
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
    servo = answer.servo
    if servo is None or answer.verdict in WITHOUT_GAP:
        return {}
    crossings = servo.crossings
    return {
        "t": answer.case.grid.t[crossings.at],
        "side": crossings.side.astype(float),
        "speed": crossings.speed,
        "duration": crossings.duration,
        "y": crossings.y + float(answer.case.grid.y[answer.case.grid.ok][0]),
        "gap": crossings.gap,
    }


def describe_crossings(answer: Answer, unit: str) -> list[str]:
    """Describe the first crossings, and the median and range of all."""
    columns = crossing_columns(answer)
    servo = answer.servo
    if servo is None or not columns or not columns["t"].size:
        return []
    lines = []
    for k in range(min(PRINTED, columns["t"].size)):
        side = SIDES[int(columns["side"][k])]
        lines.append(
            f"t {columns['t'][k]:.4g} s, to the {side} at {abs(columns['speed'][k]):.3g}{unit}/s:"
            f" {columns['gap'][k]:.4g}{unit}"
        )
    low, high = np.quantile(columns["gap"], [0.1, 0.9])
    lines.append(
        f"all {columns['t'].size}: median {servo.crossings.median_gap:.4g}{unit}, 80 % within"
        f" {low:.4g} to {high:.4g}{unit}; every one is in the page and in the JSON"
    )
    return lines


# --- Any answer

HEADS = {  # what was found, before its numbers
    "dead_zone": "Dead zone of the sensor",
    "unreached": "Dead zone of the sensor, an edge of which is never reached",
    "none": "No dead zone and no backlash: a linear plant explains the log",
    "saturation": "Saturation",
    "jump": "Dead zone with a jump (readings are not shifted)",
    "play": "Backlash",
    "both": "Backlash and a dead zone of the sensor",
    "friction": "Friction",
    "input_zone": "Dead zone of the actuator",
    "two_zones": "Dead zones of sensor and actuator",
    "input_curve": "Curve of the input",
    "input_rate": "Limit of the input's rate",
    "input_play": "Backlash ahead of the plant",
    "filtered_zone": "Dead zone of the sensor with a filter, two slopes or round edges",
    "operating_point": "Nothing can be known of a zone",
    "other": "Another nonlinearity",
    "undecided": "Undecided",
    "unclear": "Nothing can be said",
    "stiction": "The valve sticks",
    "external": "An oscillation from outside",
    "tight_tuning": "The loop is tuned too tightly",
}
OPEN = ("operating_point", "undecided", "unclear")  # words that name nothing
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
    "external": "from outside",
    "tight_tuning": "tight tuning",
}
LETTERS = {"play": "c", "both": "c", "input_play": "c", "input_zone": "b", "friction": "f"}
LEAST_PRINTED = 0.005  # odds that are worth a word
AT_ZERO = "  assumes z = 0 at u = 0"


# --- Numbers


def answer_numbers(answer: Answer) -> dict[str, Any]:
    """Return all numbers of an answer, as nested dictionaries.

    Args:
        answer: to a log.

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
        "found": headline(answer),
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
        "levels": _level_numbers(answer),
        "friction": _interval_list(answer.found.friction),
        "shape": answer.shape
        and {name: _interval_list(one) for name, one in answer.shape._asdict().items()},
        "servo": servo_numbers(answer),
        "loop": None
        if answer.found.valve is None
        else loop_numbers(answer.case, answer.found.valve),
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
        "stages": _stage_numbers(answer),
        "record": {
            "samples": int(grid.t.size),
            "readings": int(grid.ok.sum()),
            "records": int(grid.start.size),
            "step": grid.step,
            "quantum": grid.quantum,
        },
        "input_zero": grid.zero,
        "units": {"input": grid.input_unit, "output": grid.output_unit},
        "remarks": answer.remarks,
    }


def _interval_list(interval: Interval | None) -> list[float] | None:
    """Return [value, low, high], or None."""
    return None if interval is None else [float(number) for number in interval]


def _level_numbers(answer: Answer) -> dict[str, dict[str, list[float] | None]]:
    """Return the widths under each class that is possible beside the one that is named."""
    return {
        word: {name: _interval_list(one.widths[name]) for name in DIRECTIONS}
        for word, one in answer.possible.items()
    }


def _stage_numbers(answer: Answer) -> dict[str, Any]:
    """Return widths and half intervals by stage of the fit."""
    widths = answer.widths
    stages = {}
    for name, (right, left) in widths.stages.items():
        halves = widths.halves[name]
        stages[name] = {
            "right": right * answer.scale,
            "left": left * answer.scale,
            "right_half": halves["right"] * answer.scale,
            "left_half": halves["left"] * answer.scale,
        }
    return stages


# --- Words


def headline(answer: Answer) -> str:
    """Return the finding in one line, with its number and interval.

    Args:
        answer: to a log.
    """
    grid = answer.case.grid
    word = answer.verdict
    at_input = word in ("input_zone", "friction", *VALVE)
    unit = unit_suffix(grid.input_unit if at_input else grid.output_unit)
    sides = [one for one in (answer.right, answer.left) if one is not None]
    intervals = [answer.width] if word in ("play", "both", *VALVE) or not sides else sides
    intervals = [answer.found.friction] if word == "friction" else intervals
    texts = [describe_interval(one, unit) for one in intervals if one is not None]
    return ": ".join([HEADS[word], *([" / ".join(texts)] if texts else [])])


def summarise_answer(answer: Answer) -> dict[str, Any]:
    """Return the answer as lines of the terminal: name and text, or a list of texts.

    Args:
        answer: to a log.

    Returns:
        The lines in order.
    """
    grid = answer.case.grid
    lines: dict[str, Any] = {"record": _describe_record(answer), "plant": _describe_plant(answer)}
    lines["found"] = headline(answer) + _describe_certainty(answer)
    if answer.reasons:
        lines["why"] = answer.reasons
    if answer.found.odds:
        lines["odds"] = describe_shares(answer.found.odds)
    if answer.possible:
        lines["possible"] = describe_possible(answer)
    unit = unit_suffix(grid.output_unit)
    lines |= _describe_widths(answer)
    if answer.found.valve is not None:
        lines |= _describe_valve(answer, answer.found.valve)
    if answer.found.friction is not None:
        of_input = unit_suffix(grid.input_unit)
        of_motor = ", of the motor" if answer.servo is not None else ""
        lines["friction"] = describe_interval(answer.found.friction, of_input) + of_motor
    if grid.zero is not None and answer.verdict == "input_zone":
        lines["input"] = _describe_ends(answer, grid.zero)
    if answer.shape is not None:
        lines["shape"] = _describe_shape(answer.shape, unit)
    crossings = describe_crossings(answer, unit)
    if crossings:
        lines["crossings"] = crossings
    lines["disturbance"] = _describe_disturbance(answer, unit)
    lines["held out"] = _describe_held_out(answer, unit)
    if answer.remarks:
        lines["note"] = answer.remarks
    return lines


def _describe_ends(answer: Answer, zero: float) -> str:
    """Describe both ends of a zone of an input that counts from elsewhere."""
    unit = unit_suffix(answer.case.grid.input_unit)
    ends = []
    for interval, sign in ((answer.left, -1.0), (answer.right, 1.0)):
        if interval is not None:
            low, high = sorted(zero + sign * end for end in interval[1:])
            end = Interval(zero + sign * interval.value, low, high)
            ends.append(describe_interval(end, unit))
    return f"nothing happens between {' and '.join(ends)}"


def _describe_shape(shape: SensorShape, unit: str) -> str:
    """Describe rounding, slopes and lag of a sensor."""
    rounding = f"edges round over at most {shape.rounding.high:.3g}{unit}"
    if shape.rounding.low > 0:
        rounding = f"edges round over {describe_interval(shape.rounding, unit)}"
    slope = describe_interval(shape.slope, "")
    lag = f"at most {max(shape.lag.high, 0.0):.3g} s"
    if shape.lag.low > 0:
        lag = describe_interval(shape.lag, " s")
    return f"{rounding}; slope of the left side over the right {slope}; smoothed by a lag of {lag}"


def describe_possible(answer: Answer) -> list[str]:
    """Describe the widths under each class that is possible, and how a user says that it is so."""
    grid = answer.case.grid
    lines = []
    for word, one in answer.possible.items():
        unit = unit_suffix(grid.input_unit if word in OF_INPUT else grid.output_unit)
        sides = {name: one.widths[name] for name in ("right", "left")}
        widths = sides if any(sides.values()) else {"width": one.widths["width"]}
        letter = LETTERS.get(word, "d")
        numbers = [
            f"{_width_title(letter, name)} {describe_interval(interval, unit)}"
            for name, interval in widths.items()
            if interval is not None
        ]
        known = f"; if you know this, use {one.option}" if one.option else ""
        lines.append(f"if it is {MODELS[word]}: {', '.join(numbers)}{known}")
    return lines


def _describe_widths(answer: Answer) -> dict[str, str]:
    """Describe the widths of the sensor's zone or of another element."""
    element = answer.element
    grid = answer.case.grid
    letter = "d" if element is None else LETTERS.get(element.kind, "d")
    of_input = answer.verdict in VALVE or (element is not None and element.kind in OF_INPUT)
    unit = unit_suffix(grid.input_unit if of_input else grid.output_unit)
    if answer.verdict in VALVE:
        letter = "c"
    lines = {}
    for place, name in enumerate(DIRECTIONS):
        interval: Interval | None = getattr(answer, name)
        if interval is None:
            continue
        title = _width_title(letter, name).removeprefix("d ")
        if answer.found.valve is not None:
            title = "S"
        lines[title] = describe_interval(interval, unit)
        if element is None and place < 2:
            visits = answer.excitation.visits[place]
            samples = answer.excitation.samples[place]
            lines[title] += f"  passed {visits} times, {samples} samples"
        if name == "centre" and not of_input and np.isfinite(interval.high):
            lines[title] += AT_ZERO
    for name, interval in ({} if element is None else element.input).items():
        lines[_width_title("b", name)] = describe_interval(interval, unit_suffix(grid.input_unit))
    if element is not None and element.zone is not None:
        lines["d width"] = describe_interval(element.zone, unit)
    return lines


def _describe_valve(answer: Answer, valve: ValveFindings) -> dict[str, str]:
    """Describe S and J of a valve, and the shape of PV over OP."""
    unit = unit_suffix(answer.case.grid.input_unit)
    lines = {}
    if answer.verdict == "stiction":
        lines["J"] = describe_interval(valve.jump, unit)
    return lines | {"loop": shape_in_words(valve, answer.case.grid)}


def _width_title(letter: str, name: str) -> str:
    """Return the title of a width: d_right, c width."""
    return f"{letter}_{name}" if name in ("right", "left") else f"{letter} {name}"


def unit_suffix(unit: str) -> str:
    """Return a unit behind a number.

    Args:
        unit: "1" for none.
    """
    return "" if unit == "1" else f" {unit}"


def describe_interval(interval: Interval, unit: str) -> str:
    """Describe a value with its interval, with significant digits only.

    Args:
        interval: the value, its low and its high end.
        unit: behind the numbers, with a blank ahead.
    """
    value, low, high = interval
    if not np.isfinite(high):
        if not np.isfinite(low):
            return "unknown: an offset would shift it"
        return f"at least {low:.4g}{unit}: no reading lies beyond this edge"
    if high == low:
        return f"{value:.6g}{unit}  (given)"
    digits = max(0, int(np.ceil(-np.log10(max(high - low, 1e-300)))) + 2)
    return f"{bracket_interval(value, low, high, f'.{min(digits, 12)}f')}{unit}"


def _describe_record(answer: Answer) -> str:
    """Describe samples, step, names and units, share of samples inside the zone."""
    grid = answer.case.grid
    names = ", ".join(f"{name} [{grid.input_unit}]" for name in grid.inputs)
    step = "times count samples" if grid.counted else f"{grid.step:.6g} s"
    text = f"{grid.t.size} samples, {step}, {names}, {grid.output} [{grid.output_unit}]"
    if grid.start.size > 1:
        text += f", {grid.start.size} records"
    silent = answer.excitation.silent
    if answer.fit.objective.kind != "behind":
        return text + f"; {100 * silent:.0f} % silent: the zone acts on the noise too"
    if not answer.zone:
        return text + "; no silence at 0"
    return text + f"; no silence at 0: noise behind the zone; {100 * silent:.0f} % of z inside it"


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
    kind = "DC gain"
    integrators = answer.plant[0].layout.integrators
    if integrators:
        kind = "gain of the rate" if integrators == 1 else "gain of the acceleration"
        unit += " 1/s" if integrators == 1 else " 1/s^2"
    return f"order {answer.order} (BIC), poles {', '.join(pole_texts)} {rate}, {kind} {gains}{unit}"


def _describe_certainty(answer: Answer) -> str:
    """Describe the certainty of the zone."""
    if not answer.zone:
        return ""
    if answer.fit.objective.kind != "behind":
        return " (silence)"
    return f" ({describe_p_value(answer.case.no_zone.chance)})"


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
    where = "at z" if disturbance.ahead else "behind the zone"
    if not disturbance.ahead and not answer.zone:
        where = "in what the plant leaves of the readings"
    text = f"rms {disturbance.rms:.3g}{unit} {where}"
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
    if answer.found.valve is not None:
        less = 100 * (1 - chosen.error / answer.found.valve.without)
        share += f", one sample ahead ({less:.1f} % less than without the valve)"
    return (
        f"{share}: rms error {chosen.error * answer.scale:.3g}{unit},"
        f" fit {100 * chosen.share:.1f} %, one-step residual {white}"
    )


def describe_rivals(answer: Answer) -> list[tuple[str, str, float]]:
    """Describe every model with its probability and its distance behind the best
    [nats/reading].
    """
    odds = {word: f"{100 * share:.1f} %" for word, share in answer.found.odds.items()}
    rivals = sorted(nats_behind_best(answer.found.models).items(), key=lambda row: row[1])
    return [(MODELS[word], odds.get(word, "-"), nats) for word, nats in rivals]
