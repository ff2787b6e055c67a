"""From the answer to a scenario that `run`, `check`, `design` and `watch` take as it is."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterable, Sequence
from importlib.resources import files
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from undeadzone.errors import InputError
from undeadzone.linalg.matrices import Matrices
from undeadzone.util.arrays import Floats
from undeadzone.util.text import fill_words, printable
from undeadzone_identify.logs.grid import rounding_of
from undeadzone_identify.models.estimates import Interval
from undeadzone_identify.models.kalman import AT_OUTPUT
from undeadzone_identify.models.plant import input_gain
from undeadzone_identify.results.assemble import Answer, range_of_element, range_of_width
from undeadzone_identify.results.to_continuous import entry_spread
from undeadzone_identify.selection.alternatives import Element
from undeadzone_identify.selection.decision import MEMORY
from undeadzone_identify.servo.gap import ServoGap

UNSEEN = 0.1  # of the readings' noise: what a disturbance makes of z, and no log of this kind shows
SIDES = ("right", "left")
REPEATED = 0.02  # of the noise: of coarser steps one reading in 200 repeats the one before
FINEST = 1e-6  # rms of y: noise that is told is no smaller, where there is any
LEAST, MOST = 1e-3, 0.5  # tolerance of an entry


def scenario_text(answers: Sequence[Answer], title: str) -> str:
    """Return a scenario as TOML text.

    Args:
        answers: one for each output of one log: zones with both edges known. Each output has a
            plant of its own, and all plants have the same inputs.
        title: of the scenario.

    Returns:
        The text, with remarks on where each number comes from.

    Raises:
        InputError: no plant in continuous time fits, outputs whose delays differ, or a zone that
            does not hold z = 0.
    """
    plants, spreads_A, spreads_B = zip(*[_plant(answer) for answer in answers], strict=True)
    first, plant = answers[0], _join_plants(plants)
    step = first.case.grid.step
    driven = plant.B.shape[1] >= len(answers)
    words: dict[str, Any] = {
        "title": json.dumps(title, ensure_ascii=False),
        **{name.lower(): _rows(matrix) for name, matrix in plant._asdict().items()},
        "delay": _delay(answers),
        "kind": first.verdict if first.verdict in ("jump", "play") else "",
        **_zones(answers),
        "bare": first.verdict == "input_zone",
        **_gap(first),
        **_noise(answers),
        "range": _range(answers),
        "driven": driven,
        "amplitude": _numbers(np.quantile(np.abs(one.z) * one.scale, 0.98) for one in answers),
        "frequency": _number(_frequency(first, plant.A)),
        **_disturbance(answers),
        "tolerance": _tolerance(block_diag(*spreads_A), np.vstack(spreads_B)),
        "duration": _number(_duration(answers, plant.A)),
        "step": repr(float(f"{step:.12g}")),
        "output": _text(first.case.grid.output_unit),
        "input": _text(first.case.grid.input_unit),
    }
    remarks = list(dict.fromkeys(itertools.chain(*[answer.remarks for answer in answers])))
    if not driven:
        remarks.append("fewer inputs than outputs: no controller follows references; for logs only")
    words["cautions"] = "".join(f"# {printable(remark)}\n" for remark in remarks)
    template = files("undeadzone_identify.results").joinpath("scenario.toml")
    return fill_words(template.read_text(encoding="utf-8"), words)


def _zones(answers: Sequence[Answer]) -> dict[str, str]:
    """Return widths of sensor and actuator, and what is told of them; empty where there is no zone.

    Raises:
        InputError: a width that no scenario has.
    """
    first, none = answers[0], ("", "")
    own = _widths([_edges(answer) for answer in answers]), _widths_for_observer(answers)
    sensor, actuator = (none, own) if first.verdict == "input_zone" else (own, none)
    if first.element is not None and first.element.input:
        right, left = (first.element.input[side] for side in SIDES)
        told = [[range_of_element(first.element, edge)] for edge in (right, left)]
        actuator = _widths([_sound(first, right, left)]), _width_ranges(told)
    names = ("sensor", "told_sensor", "actuator", "told_actuator")
    return dict(zip(names, (*sensor, *actuator), strict=True))


def _widths(zones: Sequence[tuple[Interval, Interval]]) -> str:
    """Return the widths of the zones of all outputs."""
    lines = []
    for side, ends in zip(SIDES, zip(*zones, strict=True), strict=True):
        lines.append(f"{side} = {_numbers(one.value for one in ends)}  # 95 %: {_intervals(ends)}")
    return "\n".join(lines)


def _widths_for_observer(answers: Sequence[Answer]) -> str:
    """Return the widths as the observer knows them. Raises InputError."""
    element = answers[0].element
    if element is not None and element.edges is not None:
        return _width_ranges(
            [[range_of_element(element, edge)] for edge in element.edges], ", if c_r = c_l"
        )
    return _width_ranges([[range_of_width(one, side) for one in answers] for side in SIDES])


def _width_ranges(ranges: Sequence[Sequence[tuple[float, float]]], where: str = "") -> str:
    """Return the ranges of the widths of all outputs, right and left."""
    lines = []
    for side, own in zip(SIDES, ranges, strict=True):
        lines.append(
            f"{side} = {_list_texts([_pair(*one) for one in own])}  # 99.9 % interval{where}"
        )
    return "\n".join(lines)


def _gap(answer: Answer) -> dict[str, str]:
    """Return the gap of a play ahead of the dead zone; empty without one. Raises InputError."""
    element, gap = answer.element, answer.width
    if answer.verdict != "both":
        return {"gap": ""}
    if element is None or gap is None:
        raise InputError("scenario: both widths must be known")
    low, high = range_of_element(element, gap)
    return {
        "gap": _pair(gap.value / 2, gap.value / 2),
        "gap_interval": _intervals([gap]),
        "told_gap": _pair(low / 2, high / 2),
    }


def _plant(answer: Answer) -> tuple[Matrices, Floats, Floats]:
    """Return the plant of one output, and relative spreads of its A and B. Raises InputError."""
    layout, a, b, V = answer.plant_numbers
    return entry_spread(a, b, layout, answer.case.grid.step, V)


def _delay(answers: Sequence[Answer]) -> int:
    """Samples by which the plant is late, not its recording. Raises InputError."""
    late = {one.found.delay * (one.case.options.delay == "auto") for one in answers}
    if len(late) > 1:
        raise InputError(
            f"scenario: inputs act {min(late)} to {max(late)} samples late on different outputs,"
            " and a plant has one delay; identify each output alone"
        )
    return late.pop()


def _join_plants(plants: Sequence[Matrices]) -> Matrices:
    """Return plants side by side, with the same inputs."""
    return Matrices(
        block_diag(*[plant.A for plant in plants]),
        np.vstack([plant.B for plant in plants]),
        block_diag(*[plant.C for plant in plants]),
    )


def _numbers(values: Iterable[float]) -> str:
    """Return the numbers of all outputs: one, or a list."""
    return _list_texts([_number(value) for value in values])


def _intervals(edges: Sequence[Interval]) -> str:
    """Return the 95 % intervals of all outputs, for a remark."""
    return "; ".join(f"{edge.low:.6g} to {edge.high:.6g}" for edge in edges)


def _pair(low: float, high: float) -> str:
    """Return two numbers in TOML."""
    return f"[{_number(low)}, {_number(high)}]"


def _list_texts(texts: Sequence[str]) -> str:
    """Return one text as it is, several as a list in TOML."""
    return texts[0] if len(texts) == 1 else f"[{', '.join(texts)}]"


def _edges(answer: Answer) -> tuple[Interval, Interval]:
    """Return both widths. Raises InputError."""
    right, left = answer.right, answer.left
    if answer.element is not None and answer.element.edges is not None:
        right, left = answer.element.edges
    if right is None or left is None:
        raise InputError("scenario: both widths must be known")
    return _sound(answer, right, left)


def _sound(answer: Answer, right: Interval, left: Interval) -> tuple[Interval, Interval]:
    """Return widths that a scenario may have. Raises InputError."""
    for name, edge in (("right", right), ("left", left)):
        if not math.isfinite(edge.value):
            raise InputError(
                f"scenario: the {name} edge is never reached in the log; give it by --{name}"
            )
        if edge.value < 0:
            cure = "take a constant offset away from the readings that are not silent, or from u"
            if answer.verdict == "play" and answer.centre is not None:
                middle = -answer.centre.value
                cure = f"its centre is an offset: --zero {middle:.4g} makes both sides even"
            value = f"{edge.value:.4g}"
            raise InputError(
                f"scenario: the {name} width {value} is negative: z = 0 is not inside; {cure}"
            )
    return right, left


def _noise(answers: Sequence[Answer]) -> dict[str, str]:
    """Return noise of the sensor beside its rounding, threshold, quantum; empty where there is
    none.
    """
    cases = [one.case for one in answers]
    rms = np.array([_rms_of_noise(answer) for answer in answers]).T
    quanta = np.array([rounding_of(one.grid.y[one.grid.ok]) for one in cases])
    quanta = np.where(quanta > REPEATED * rms.max(axis=0), quanta, 0.0)
    silent = [max(0.5 * one.grid.quantum, one.options.threshold or 0.0) for one in cases]
    rounding = quanta * [one.verdict not in MEMORY for one in answers]  # a play's noise has none
    ahead, behind = np.sqrt(np.maximum(rms**2 - rounding**2 / 12, 0.0))
    noise = {"ahead": ahead, "behind": behind, "quantum": quanta}
    shown = {name: bool(values.any()) * _numbers(values) for name, values in noise.items()}
    return shown | {"threshold": bool(rms[0].any()) * _numbers(silent)}


def _range(answers: Sequence[Answer]) -> str:
    """Where the readings of all outputs end; empty where none sticks at an end."""
    ends = [one.case.fitted.prepared.ends for one in answers]
    return any(ends) * _list_texts([one or "[-inf, inf]" for one in ends])


def _rms_of_noise(answer: Answer) -> tuple[float, float]:
    """Return rms of white noise ahead of the sensor's zone and behind it; of other elements
    behind.
    """
    disturbance = answer.disturbance
    white = disturbance.rms if disturbance.white is None else disturbance.white
    white = white and max(white, FINEST * answer.scale)
    silent = answer.verdict == "two_zones" and answer.case.data.silent_zeros
    at_zone = disturbance.ahead and (answer.element is None or silent)
    return (white, 0.0) if at_zone else (0.0, white)


def _frequency(answer: Answer, A: Floats) -> float:
    """Return a frequency that plant and samples follow [Hz]; integrators alone: that of the log."""
    rates = np.abs(np.linalg.eigvals(A))
    moving = rates[rates > 1e-6 * rates.max()]
    slowest = float(moving.min()) if moving.size else _rate_of_motion(answer)
    return float(f"{min(0.5 * slowest / (2 * math.pi), 0.02 / answer.case.grid.step):.3g}")


def _rate_of_motion(answer: Answer) -> float:
    """Return rms of z' over that of z along the log [1/s]: of a sine its frequency."""
    grid = answer.case.grid
    around = float(np.std(answer.z))
    return float(np.std(np.diff(answer.z))) / (grid.step * around) if around else 0.02 / grid.step


def _duration(answers: Sequence[Answer], A: Floats) -> float:
    """Return a whole number of steps that hold 20 periods of the reference, 20,000 at most."""
    step = answers[0].case.grid.step
    periods = 20 / _frequency(answers[0], A)
    return float(f"{step * math.ceil(min(periods / step, 20000)):.12g}")


def _disturbance(answers: Sequence[Answer]) -> dict[str, str]:
    """What disturbs the input, for the observer: the strongest of the outputs' disturbances."""
    claims = [_claim(answer) for answer in answers]
    known = [claim for claim in claims if claim is not None]
    if len(known) < len(claims):
        return {"disturbance": ""}  # something disturbs z: the observer's own default
    rms, time = max(known)
    return {"disturbance": _number(rms), "correlation_time": _number(time)}


def _claim(answer: Answer) -> tuple[float, float] | None:
    """Return rms at the input and correlation time [s] of what disturbs an output; None: not
    known.
    """
    step = answer.case.grid.step
    kalman = answer.found.kalman
    data = answer.fit.objective.data
    if answer.element is not None and isinstance(answer.element.fit, ServoGap):
        return answer.element.fit.disturbance
    if answer.element is not None:
        return _claim_ahead(answer.element, step, float(data.u_scale[0]))
    if not kalman:
        return (0.0, 0.5 * step) if answer.chosen.white else None
    best = kalman[0]
    phi = best.phi
    rms = best.q / math.sqrt(1 - phi * phi) * float(data.u_scale[0])
    if best.model == AT_OUTPUT:
        layout, a, b, _ = answer.plant_numbers
        at_z = best.q / math.sqrt(1 - phi * phi) * answer.scale
        rms = at_z / math.sqrt(input_gain(a, b[: layout.n], layout.n, phi))
    return rms, _correlation_time(phi, step)


def _correlation_time(phi: float, step: float) -> float:
    """Return the correlation time [s] of a correlation over one step."""
    if phi <= 0.01:
        return 0.5 * step
    return float(np.clip(-step / math.log(phi), 0.11 * step, 1e5 * step))


def _claim_ahead(element: Element, step: float, scale: float) -> tuple[float, float] | None:
    """Return rms at the input and correlation time [s] of what disturbs the plant behind an
    element.
    """
    if element.ahead is None:
        return None
    unseen = UNSEEN * element.noise
    if element.ahead.rms < unseen:  # noise hides it; a zero would claim that there is none
        layout, theta = element.simulator.layout, element.theta
        gain = input_gain(theta[layout.a], theta[layout.b][: layout.n], layout.n, 0.0)
        return unseen / math.sqrt(gain) * scale, 0.5 * step
    return element.ahead.at_input * scale, _correlation_time(element.ahead.phi, step)


def _tolerance(spread_A: Floats, spread_B: Floats) -> str:
    """Return relative deviations of the entries of A and B, as a TOML table in a line."""
    entries = []
    for name, spread in (("A", spread_A), ("B", spread_B)):
        for i, j in np.argwhere(spread > 0):
            entries.append(f'"{name}[{i},{j}]" = {np.clip(spread[i, j], LEAST, MOST):.3g}')
    return "{ " + ", ".join(entries) + " }"


def _rows(matrix: Any) -> str:
    """Return a matrix in TOML."""
    return str(np.asarray(matrix, dtype=float).tolist())


def _number(value: float) -> str:
    """Return a number in TOML, every digit of it."""
    return repr(float(value))


def _text(value: str) -> str:
    """Return a text in TOML."""
    return json.dumps(printable(value), ensure_ascii=False)
