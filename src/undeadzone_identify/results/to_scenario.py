"""From the answer to a scenario, a direct input of `run`, `check`, `design` and `watch`."""

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
from undeadzone.nonlinearities.sensor import SHAPE
from undeadzone.util.arrays import Floats, to_scalar_or_list
from undeadzone.util.text import escape_controls, fill_words
from undeadzone_identify.logs.grid import rounding_step
from undeadzone_identify.logs.prepare import FAR_EDGE
from undeadzone_identify.models.estimates import Interval
from undeadzone_identify.models.kalman import AT_OUTPUT
from undeadzone_identify.models.plant import input_noise_gain
from undeadzone_identify.results.assemble import (
    Answer,
    absent_edges,
    prior_element_range,
    prior_width_range,
)
from undeadzone_identify.results.formats import describe_ends
from undeadzone_identify.results.to_continuous import continuous_with_spread
from undeadzone_identify.selection.alternatives import UNSEEN, Element
from undeadzone_identify.selection.decision import MEMORY
from undeadzone_identify.selection.widths import SIDES

REPEATED = 0.02  # of the noise: of coarser steps one reading in 200 repeats the one before
FINEST = 1e-6  # rms of y: noise that is told is no smaller, where there is any
# tolerance of an entry
LEAST = 1e-3
MOST = 0.5
MOST_OF_LOOP = 0.2  # from 0.3 on plants within three deviations are unstable, filters may diverge


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
    plants, spreads_A, spreads_B = zip(*list(map(_plant_with_spread, answers)), strict=True)
    first = answers[0]
    plant = _join_plants(plants)
    step = first.case.grid.step
    frequency = _reference_frequency(first, plant.A)
    driven = plant.B.shape[1] >= len(answers)
    words: dict[str, Any] = {
        "title": json.dumps(title, ensure_ascii=False),
        **{name.lower(): _to_toml(matrix) for name, matrix in plant._asdict().items()},
        "delay": _common_delay(answers),
        "kind": first.verdict if first.verdict in ("jump", "play") else "",
        **_point_fields(answers),
        **_zone_fields(answers),
        **_shape_fields(answers),
        "bare": first.verdict in ("input_zone", "input_play"),
        **_gap_fields(first),
        **_noise_fields(answers),
        "range": _range_field(answers),
        "driven": driven,
        "amplitude": _toml_numbers(np.quantile(np.abs(one.z_from_rest), 0.98) for one in answers),
        "frequency": _to_toml(frequency),
        **_disturbance_fields(answers),
        "tolerance": _tolerance_table(
            block_diag(*spreads_A), np.vstack(spreads_B), first.verdict == "input_play"
        ),
        "duration": _to_toml(_run_duration(step, frequency)),
        "step": repr(float(f"{step:.12g}")),
        "output": _toml_text(first.case.grid.output_unit),
        "input": _toml_text(first.case.grid.input_unit),
    }
    remarks = list(dict.fromkeys(itertools.chain(*[answer.remarks for answer in answers])))
    if not driven:
        remarks.append("fewer inputs than outputs: no controller follows references: for logs only")
    words["cautions"] = "".join(f"# {escape_controls(remark)}\n" for remark in remarks)
    template = files("undeadzone_identify.results").joinpath("scenario.toml")
    return fill_words(template.read_text(encoding="utf-8"), words)


def _point_fields(answers: Sequence[Answer]) -> dict[str, str]:
    """Return the operating point; empty if the log counts from 0.

    Raises:
        InputError: the outputs are at rest under different inputs.
    """
    points = [one.at_rest or (0.0, 0.0) for one in answers]
    if not np.any(points):
        return {"rest_output": ""}
    first, *others = dict.fromkeys(u for u, _ in points)
    if others:
        raise InputError(
            f"scenario: one output is at rest under an input of {first:.6g}, another under"
            f" {others[0]:.6g}. Identify each alone: a scenario has one operating point"
        )
    inputs = [first] + [0.0] * (answers[0].case.grid.u.shape[1] - 1)
    return {"rest_input": f"{inputs}", "rest_output": f"{[output for _, output in points]}"}


def _zone_fields(answers: Sequence[Answer]) -> dict[str, str]:
    """Return widths of sensor and actuator with the observer's ranges; empty without a zone.

    Raises:
        InputError: a width that no scenario has.
    """
    first = answers[0]
    fields = dict.fromkeys(("sensor", "told_sensor", "actuator", "told_actuator"), "")
    if first.verdict == "input_play":
        return fields | {"actuator": _gap_of_actuator(first)}
    place = "actuator" if first.verdict == "input_zone" else "sensor"
    fields[place] = _width_lines(list(map(_require_edges, answers)))
    fields[f"told_{place}"] = _prior_range_lines(answers)
    if first.verdict == "input_zone" and first.at_rest is not None:
        ends = describe_ends(first.case.grid.zero or 0.0, *reversed(_require_edges(first)))
        fields[place] += f"\n# {ends}"
    if first.element is not None and first.element.input:
        right, left = (first.element.input[side] for side in SIDES)
        prior = [[prior_element_range(first.element, edge)] for edge in (right, left)]
        fields["actuator"] = _width_lines([_require_nonnegative(first, right, left)])
        fields["told_actuator"] = _range_lines(prior)
    return fields


def _gap_of_actuator(answer: Answer) -> str:
    """Return the lines of an actuator's play. Raise InputError without its gap or its plant."""
    gap = answer.width
    if gap is None or answer.element is None:
        raise InputError("scenario: no plant that settles fits behind the play. Record longer")
    half = _to_toml(gap.value / 2)
    first_line = (
        f"right = {half}  # gap {gap.value:.6g}, 95 %: {_interval_remark([gap])}; even sides"
    )
    return f'kind = "play"\n{first_line}\nleft = {half}'


def _shape_fields(answers: Sequence[Answer]) -> dict[str, str]:
    """Return the sensors' shape for an observer; empty if the readings do not determine it.

    Each is the rms that value and interval leave: of a rounding or a lag about 0, of a slope of
    either side about 1.
    """
    shapes = [answer.shape for answer in answers if answer.shape is not None]
    if len(shapes) < len(answers):
        return dict.fromkeys(SHAPE, "")
    fields = {}
    for name, usual, own in zip(SHAPE, (0.0, 1.0, 0.0), zip(*shapes, strict=True), strict=True):
        stds = [math.hypot(one.value - usual, one.half_width / 2) for one in own]
        fields[name] = bool(np.isfinite(stds).all()) * _toml_numbers(stds)
    return fields


def _width_lines(zones: Sequence[tuple[Interval, Interval]]) -> str:
    """Return the lines with the widths of all outputs' zones."""
    lines = []
    for side, ends in zip(SIDES, zip(*zones, strict=True), strict=True):
        lines.append(
            f"{side} = {_toml_numbers(one.value for one in ends)}  # 95 %: {_interval_remark(ends)}"
        )
    return "\n".join(lines)


def _prior_range_lines(answers: Sequence[Answer]) -> str:
    """Return the lines with the observer's width ranges. Raise InputError."""
    element = answers[0].element
    if element is not None and element.edges is not None:
        return _range_lines(
            [[prior_element_range(element, edge)] for edge in element.edges], ", if c_r = c_l"
        )
    return _range_lines([[prior_width_range(one, side) for one in answers] for side in SIDES])


def _range_lines(ranges: Sequence[Sequence[tuple[float, float]]], where: str = "") -> str:
    """Return the lines with the ranges of the widths of all outputs, right and left."""
    lines = []
    for side, own in zip(SIDES, ranges, strict=True):
        lines.append(f"{side} = {_toml_numbers(own)}  # 99.9 % interval{where}")
    return "\n".join(lines)


def _gap_fields(answer: Answer) -> dict[str, str]:
    """Return the gap of a play ahead of the dead zone; empty without a play. Raise InputError."""
    gap = answer.width
    if answer.verdict != "both":
        return {"gap": ""}
    if answer.element is None or gap is None:
        raise InputError("scenario: both widths must be known")
    low, high = prior_element_range(answer.element, gap)
    return {
        "gap": _to_toml([gap.value / 2] * 2),
        "gap_interval": _interval_remark([gap]),
        "told_gap": _to_toml([low / 2, high / 2]),
    }


def _plant_with_spread(answer: Answer) -> tuple[Matrices, Floats, Floats]:
    """Return the plant of an output, and relative spreads of its A and B. Raise InputError."""
    layout, a, b, V = answer.plant_numbers
    return continuous_with_spread(a, b, layout, answer.case.grid.step, V)


def _common_delay(answers: Sequence[Answer]) -> int:
    """Return the samples of the plant's delay, not its recording's. Raise InputError."""
    late = set()
    for one in answers:
        found = one.found.delay * (one.case.options.delay == "auto")
        late.add(one.case.options.recorded_delay + found)
    if len(late) > 1:
        raise InputError(
            f"scenario: inputs act {min(late)} to {max(late)} samples late on different outputs,"
            " and a plant has one delay. Identify each output alone"
        )
    return late.pop() * (answers[0].case.options.delay == "auto")


def _join_plants(plants: Sequence[Matrices]) -> Matrices:
    """Join plants side by side, with the same inputs."""
    A, B, C = zip(*plants, strict=True)
    return Matrices(block_diag(*A), np.vstack(B), block_diag(*C))


def _toml_numbers(values: Iterable[Any]) -> str:
    """Return numbers, or ranges, of all outputs in TOML: that of one output, or a list."""
    return _to_toml(to_scalar_or_list([*values]))


def _interval_remark(edges: Sequence[Interval]) -> str:
    """Return the 95 % intervals of all outputs, for a remark."""
    if all(edge.low == edge.high for edge in edges):
        return "no edge" if edges[0].value == math.inf else "none: it is known"
    return "; ".join(f"{edge.low:.6g} to {edge.high:.6g}" for edge in edges)


def _require_edges(answer: Answer) -> tuple[Interval, Interval]:
    """Return both widths. Raise InputError if a width is unknown."""
    pair = (answer.right, answer.left)
    if answer.element is not None and answer.element.edges is not None:
        pair = answer.element.edges
    width = FAR_EDGE * answer.scale if answer.verdict == "input_zone" else math.inf
    far = dict.fromkeys(absent_edges(answer.case), Interval(width, width, width))
    right, left = (edge or far.get(side) for side, edge in zip(SIDES, pair, strict=True))
    if right is None or left is None:
        raise InputError("scenario: both widths must be known")
    return _require_nonnegative(answer, right, left)


def _require_nonnegative(
    answer: Answer, right: Interval, left: Interval
) -> tuple[Interval, Interval]:
    """Return widths that a scenario may have. Raise InputError."""
    edges = {"right": right, "left": left}
    for name, edge in edges.items():
        if not math.isfinite(edge.value) and name not in absent_edges(answer.case):
            raise InputError(
                f"scenario: the {name} edge is never reached in the log. Give it by --{name}"
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


def _noise_fields(answers: Sequence[Answer]) -> dict[str, str]:
    """Return the texts of sensor noise ahead of and behind the zone, quantum and threshold.

    A text is empty if all its numbers are 0. A quantum counts only if it is large enough beside the
    noise that readings repeat. Its variance, q^2 / 12, is then subtracted from that of the noise.

    Args:
        answers: the answer of each output (p).
    """
    cases = [answer.case for answer in answers]
    rms = np.array(list(map(_noise_rms_pair, answers))).T
    quanta = np.array([rounding_step(case.grid.y[case.grid.ok]) for case in cases])
    quanta = np.where(quanta > REPEATED * rms.max(axis=0), quanta, 0.0)
    thresholds = [max(0.5 * case.grid.quantum, case.options.threshold or 0.0) for case in cases]
    # The noise of a play was estimated without the rounding already.
    rounding = quanta * [answer.verdict not in MEMORY for answer in answers]
    ahead, behind = np.sqrt(np.maximum(rms**2 - rounding**2 / 12, 0.0))
    noise = {"ahead": ahead, "behind": behind, "quantum": quanta}
    texts = {name: bool(values.any()) * _toml_numbers(values) for name, values in noise.items()}
    return texts | {"threshold": bool(rms[0].any()) * _toml_numbers(thresholds)}


def _range_field(answers: Sequence[Answer]) -> str:
    """Return the text of the measuring ranges of all outputs; empty if no reading saturates."""
    ends = [one.case.fitted.prepared.ends for one in answers]
    has_ends = any(one.has_ends for one in ends)
    texts = [one.range_text for one in ends]
    return has_ends * (texts[0] if len(texts) == 1 else f"[{', '.join(texts)}]")


def _noise_rms_pair(answer: Answer) -> tuple[float, float]:
    """Return the rms of white noise ahead of the sensor's zone, and behind it.

    One of them is 0. The noise of other elements is behind.
    """
    disturbance = answer.disturbance
    white = disturbance.rms if disturbance.white is None else disturbance.white
    white = white and max(white, FINEST * answer.scale)
    silent = answer.verdict == "two_zones" and answer.case.record_data.silent_zeros
    at_zone = disturbance.ahead and (answer.element is None or silent)
    return (white, 0.0) if at_zone else (0.0, white)


def _reference_frequency(answer: Answer, A: Floats) -> float:
    """Return a frequency of a reference that plant and sample time can follow [Hz].

    It is half of the slowest pole's. For integrators alone it is that of the output in the log.
    """
    rates = np.abs(np.linalg.eigvals(A))
    moving = rates[rates > 1e-6 * rates.max()]
    slowest = float(moving.min()) if moving.size else _rate_of_output(answer)
    return float(f"{min(0.5 * slowest / (2 * math.pi), 0.02 / answer.case.grid.step):.3g}")


def _rate_of_output(answer: Answer) -> float:
    """Return the rms of z' over that of z along the log [1/s]: the frequency of a sine."""
    grid = answer.case.grid
    around = float(np.std(answer.z))
    return float(np.std(np.diff(answer.z))) / (grid.step * around) if around else 0.02 / grid.step


def _run_duration(step: float, frequency: float) -> float:
    """Return a whole number of steps with 20 periods of the reference, 20,000 at most [s]."""
    return float(f"{step * math.ceil(min(20 / frequency / step, 20000)):.12g}")


def _disturbance_fields(answers: Sequence[Answer]) -> dict[str, str]:
    """Return the input disturbance for the observer: the strongest of all outputs."""
    priors = list(map(_disturbance_prior, answers))
    known = [prior for prior in priors if prior is not None]
    if len(known) < len(priors):
        return {"disturbance": ""}  # something disturbs z: the observer's own default
    rms, time = max(known)
    return {"disturbance": _to_toml(rms), "correlation_time": _to_toml(time)}


def _disturbance_prior(answer: Answer) -> tuple[float, float] | None:
    """Return rms at the input and correlation time [s] of an output's disturbance; None if
    unknown.
    """
    step = answer.case.grid.step
    kalman = answer.found.kalman
    data = answer.fit.objective.data
    if answer.servo is not None:
        return answer.servo.motor_disturbance
    if answer.element is not None:
        return _element_disturbance_prior(answer.element, step, data.input_scale)
    if not kalman:
        return (0.0, 0.5 * step) if answer.chosen.white else None
    best = kalman[0]
    phi = best.disturbance_memory
    rms = best.driving_rms / math.sqrt(1 - phi * phi)
    scale = data.input_scale
    if best.model == AT_OUTPUT:
        layout, a, b, _ = answer.plant_numbers
        scale = answer.scale / math.sqrt(input_noise_gain(a, b[: layout.n], layout.n, phi))
    return rms * scale, _correlation_time(phi, step)


def _correlation_time(phi: float, step: float) -> float:
    """Return the correlation time [s] for a correlation over a step."""
    if phi <= 0.01:
        return 0.5 * step
    return float(np.clip(-step / math.log(phi), 0.11 * step, 1e5 * step))


def _element_disturbance_prior(
    element: Element, step: float, scale: float
) -> tuple[float, float] | None:
    """Return rms at the input and correlation time [s] of the disturbance ahead of an element.

    If noise hides the disturbance, the largest one that it can hide is returned, as white. An rms
    of 0 would exclude any disturbance.

    Args:
        element: the element, with its plant.
        step: sample time [s].
        scale: unit of the scaled input [u].
    """
    if element.ahead is None:
        return None
    hidden_rms = UNSEEN * element.noise
    if element.ahead.rms < hidden_rms:
        layout = element.simulator.layout
        theta = element.theta
        gain = input_noise_gain(
            theta[layout.denominator], theta[layout.numerators][: layout.n], layout.n, 0.0
        )
        return hidden_rms / math.sqrt(gain) * scale, 0.5 * step
    return element.ahead.at_input * scale, _correlation_time(element.ahead.phi, step)


def _tolerance_table(spread_A: Floats, spread_B: Floats, is_loop: bool) -> str:
    """Return relative deviations of the entries of A and B, as a TOML table in a line."""
    entries = []
    most = MOST_OF_LOOP if is_loop else MOST
    for name, spread in (("A", spread_A), ("B", spread_B)):
        for i, j in np.argwhere(spread > 0):
            entries.append(f'"{name}[{i},{j}]" = {np.clip(spread[i, j], LEAST, most):.3g}')
    return "{ " + ", ".join(entries) + " }"


def _to_toml(numbers: Any) -> str:
    """Return a number, or a matrix, in TOML with all digits."""
    return str(np.asarray(numbers, dtype=float).tolist())


def _toml_text(value: str) -> str:
    """Return a text in TOML."""
    return json.dumps(escape_controls(value), ensure_ascii=False)
