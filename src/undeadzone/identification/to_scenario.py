"""From the answer to a scenario that `run`, `check`, `design` and `watch` take as it is."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from undeadzone.errors import InputError
from undeadzone.identification.answer import Answer
from undeadzone.identification.intervals import Interval
from undeadzone.identification.kalman_likelihood import AT_INPUT, WHITE, input_gain
from undeadzone.identification.long_run import degrees_of, quantile
from undeadzone.identification.to_continuous import entry_spread
from undeadzone.support.arrays import Floats
from undeadzone.support.text import printable

SURE = 0.999  # level of the intervals that the observer is given
LEAST, MOST = 1e-3, 0.5  # tolerance of an entry


def scenario_text(answer: Answer) -> str:
    """A scenario as TOML text.

    Args:
        answer: a dead zone with both edges known.

    Returns:
        The text, with remarks on where each number comes from.

    Raises:
        InputError: no plant in continuous time fits, or a zone that does not hold z = 0.
    """
    layout = answer.fit.objective.layout
    step = answer.evidence.grid.step
    a, b, V = _plant_numbers(answer)
    plant, spread_A, spread_B = entry_spread(a, b, layout, step, V)
    right, left = _edges(answer)
    unit = answer.evidence.grid.output_unit
    lines = [
        f'title = "Identified from {_name(answer)}"',
        "",
        "[plant]  # from the sampled plant by the matrix logarithm, companion form",
        f"A = {_rows(plant.A)}",
        f"B = {_rows(plant.B)}",
        f"C = {_rows(plant.C)}",
        "",
        "[sensor]",
        f"right = {_number(right.value)}  # 95 %: {right.low:.6g} to {right.high:.6g}",
        f"left = {_number(left.value)}  # 95 %: {left.low:.6g} to {left.high:.6g}",
        *_noise(answer),
        "",
        "[reference]  # fits the range of z in the log",
        *_reference(answer, plant.A),
        "",
        "[observer]",
        'method = "censored"',
        f"right = {_pair(right)}  # 99.9 % interval",
        f"left = {_pair(left)}  # 99.9 % interval",
        *_disturbance(answer, a, b),
        f"tolerance = {_tolerance(spread_A, spread_B)}  # relative, from the fit's covariance",
        "",
        "[controller]",
        'method = "state_feedback"',
        "alpha = 1.0",
        "",
        "[simulation]",
        f"duration = {_number(_duration(answer, plant.A))}",
        'time = "sampled"',
        f"step = {float(f'{step:.12g}')!r}  # of the log",
        "",
        "[units]",
        f"output = {_text(unit)}",
        f"input = {_text(answer.evidence.grid.input_unit)}",
    ]
    cautions = [f"# {printable(remark)}" for remark in answer.remarks]
    return "\n".join(["# Written by undeadzone identify.", *cautions, *lines]) + "\n"


def _plant_numbers(answer: Answer) -> tuple[Floats, Floats, Floats]:
    """a, b in units of y and u, and their covariance together."""
    fit = answer.fit
    layout, data = fit.objective.layout, fit.objective.data
    V = fit.objective.spread(fit.theta).V
    count = layout.b.stop
    scale = np.ones(count)
    factors = np.repeat(data.y_scale / data.u_scale, layout.n)
    scale[layout.b] = factors
    return (
        fit.theta[layout.a],
        fit.theta[layout.b] * factors,
        V[:count, :count] * np.outer(scale, scale),
    )


def _edges(answer: Answer) -> tuple[Interval, Interval]:
    """Both widths. Raises InputError."""
    if answer.right is None or answer.left is None:
        raise InputError("scenario: both widths must be known")
    for name, edge in (("right", answer.right), ("left", answer.left)):
        if not math.isfinite(edge.value):
            raise InputError(
                f"scenario: the {name} edge is never reached in the log; give it by --{name}"
            )
        if edge.value < 0:
            raise InputError(
                f"scenario: d_{name} = {edge.value:.4g} is negative: the zone does not hold z = 0;"
                " take a constant offset away from the readings that are not silent, or from u"
            )
    return answer.right, answer.left


def _name(answer: Answer) -> str:
    """The log in a title."""
    return f"a log of {answer.evidence.grid.t.size} samples"


def _noise(answer: Answer) -> list[str]:
    """Noise of the sensor, its threshold and quantum."""
    grid = answer.evidence.grid
    disturbance = answer.disturbance
    if disturbance.ahead:
        white = disturbance.rms if disturbance.white is None else disturbance.white
        lines = [f"noise_before = {_number(white)}  # white part of what disturbs z"]
        threshold = max(0.5 * grid.quantum, answer.options.threshold or 0.0)
        lines.append(f"threshold = {_number(threshold)}  # the log has exact zeros")
    else:
        lines = [f"noise = {_number(disturbance.rms)}  # rms of the residual"]
    return lines


def _reference(answer: Answer, A: Floats) -> list[str]:
    """A sine within the range of z and the bandwidth of the plant."""
    z = np.abs(answer.fit.z) * answer.scale
    amplitude = float(np.quantile(z, 0.98))
    frequency = _frequency(answer, A)
    return [
        'kind = "sine"',
        f"amplitude = {_number(amplitude)}",
        f"frequency = {_number(frequency)}",
    ]


def _frequency(answer: Answer, A: Floats) -> float:
    """A frequency that plant and samples follow [Hz]."""
    rates = np.abs(np.linalg.eigvals(A))
    slowest = float(rates[rates > 1e-6 * rates.max(initial=1e-300)].min(initial=rates.max()))
    return float(f"{min(0.5 * slowest / (2 * math.pi), 0.02 / answer.evidence.grid.step):.3g}")


def _duration(answer: Answer, A: Floats) -> float:
    """A whole number of steps that hold 20 periods of the reference, at most the log's length."""
    step = answer.evidence.grid.step
    periods = 20 / _frequency(answer, A)
    return float(f"{step * math.ceil(min(periods / step, 20000)):.12g}")


def _disturbance(answer: Answer, a: Floats, b: Floats) -> list[str]:
    """What disturbs the input, for the observer."""
    step = answer.evidence.grid.step
    layout = answer.fit.objective.layout
    kalman = answer.evidence.kalman
    data = answer.fit.objective.data
    if not kalman and not answer.evidence.chosen.white:
        return []  # something disturbs z, and nobody knows what: the observer's own default
    rms, phi = 0.0, 0.0
    if kalman and kalman[0].model in (WHITE, AT_INPUT):
        best = kalman[0]
        phi = best.phi
        rms = best.q / math.sqrt(1 - phi * phi) * float(data.u_scale[0])
    elif kalman:
        best = kalman[0]
        phi = best.phi
        at_z = best.q / math.sqrt(1 - phi * phi) * answer.scale
        rms = at_z / math.sqrt(input_gain(a, b[: layout.n], layout.n, phi))
    if phi <= 0.01:
        time = 0.5 * step
    else:
        time = float(np.clip(-step / math.log(phi), 0.11 * step, 1e5 * step))
    return [
        f"disturbance = {_number(rms)}  # rms at the input",
        f"correlation_time = {_number(time)}",
    ]


def _tolerance(spread_A: Floats, spread_B: Floats) -> str:
    """Relative deviations of the last row of A and of B, as a TOML table in a line."""
    entries = []
    for name, spread in (("A", spread_A), ("B", spread_B)):
        for i, j in np.argwhere(spread > 0):
            if name == "A" and i < spread.shape[0] - 1:
                continue
            value = float(np.clip(spread[i, j], LEAST, MOST))
            entries.append(f'"{name}[{i},{j}]" = {value:.3g}')
    return "{ " + ", ".join(entries) + " }"


def _pair(edge: Interval) -> str:
    """The interval at a higher level, within widths that make sense."""
    degrees = degrees_of(1000)
    wider = quantile(degrees, SURE) / quantile(degrees, 0.95)
    half = wider * edge.half
    low = max(edge.value - half, 0.0)
    high = edge.value + half
    if high - low < 1e-9 * max(high, 1e-12):
        low, high = low * (1 - 1e-6), high * (1 + 1e-6) + 1e-9
    return f"[{_number(low)}, {_number(high)}]"


def _rows(matrix: Any) -> str:
    """A matrix in TOML."""
    rows = ["[" + ", ".join(_number(entry) for entry in row) + "]" for row in matrix]
    return "[" + ", ".join(rows) + "]"


def _number(value: float) -> str:
    """A number in TOML, every digit of it."""
    return repr(float(value))


def _text(value: str) -> str:
    """A text in TOML."""
    safe = printable(value).replace("\\", "\\\\").replace('"', '\\"')
    return f'"{safe}"'
