"""From the answer to a scenario that `run`, `check`, `design` and `watch` take as it is."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import block_diag

from undeadzone.errors import InputError
from undeadzone.identification.answer import Answer
from undeadzone.identification.intervals import Interval
from undeadzone.identification.kalman_likelihood import AT_INPUT, WHITE, input_gain
from undeadzone.identification.to_continuous import entry_spread
from undeadzone.identification.told_range import told_range
from undeadzone.linear.matrices import Matrices
from undeadzone.support.arrays import Floats
from undeadzone.support.text import printable

LEAST, MOST = 1e-3, 0.5  # tolerance of an entry


def scenario_text(answers: Sequence[Answer]) -> str:
    """A scenario as TOML text.

    Args:
        answers: one for each output of one log: zones with both edges known. Each output has a
            plant of its own, and all plants have the same inputs.

    Returns:
        The text, with remarks on where each number comes from.

    Raises:
        InputError: no plant in continuous time fits, the input acts late, or a zone that does not
            hold z = 0.
    """
    parts = [_part(answer) for answer in answers]
    first = answers[0]
    step = first.evidence.grid.step
    plant = _joined([part.plant for part in parts])
    spread_A = block_diag(*[part.spread_A for part in parts])
    spread_B = np.vstack([part.spread_B for part in parts])
    right, left = [part.right for part in parts], [part.left for part in parts]
    driven = plant.B.shape[1] >= len(parts)
    lines = [
        f'title = "Identified from {_name(first)}"',
        "",
        "[plant]  # from the sampled plant by the matrix logarithm, companion form",
        f"A = {_rows(plant.A)}",
        f"B = {_rows(plant.B)}",
        f"C = {_rows(plant.C)}",
        "",
        "[sensor]",
        *(['kind = "jump"'] if first.verdict == "jump" else []),
        f"right = {_each(right)}  # 95 %: {_intervals(right)}",
        f"left = {_each(left)}  # 95 %: {_intervals(left)}",
        *_noise(answers),
        "",
        *(_reference(answers, plant.A) if driven else []),
        "[observer]",
        'method = "censored"',
        f"right = {_pairs([told_range(one, 'right') for one in answers])}  # 99.9 % interval",
        f"left = {_pairs([told_range(one, 'left') for one in answers])}  # 99.9 % interval",
        *_disturbance(answers),
        f"tolerance = {_tolerance(spread_A, spread_B)}  # relative, from the fit's covariance",
        "",
        *(["[controller]", 'method = "state_feedback"', "alpha = 1.0", ""] if driven else []),
        "[simulation]",
        f"duration = {_number(_duration(answers, plant.A))}",
        'time = "sampled"',
        f"step = {float(f'{step:.12g}')!r}  # of the log",
        "",
        "[units]",
        f"output = {_text(first.evidence.grid.output_unit)}",
        f"input = {_text(first.evidence.grid.input_unit)}",
    ]
    remarks = list(dict.fromkeys(itertools.chain(*[answer.remarks for answer in answers])))
    if not driven:
        remarks.append("fewer inputs than outputs: no controller follows references; for logs only")
    cautions = [f"# {printable(remark)}" for remark in remarks]
    return "\n".join(["# Written by undeadzone identify.", *cautions, *lines]) + "\n"


class _Part(NamedTuple):
    """What one output adds: its plant, relative spreads of A and B, its edges."""

    plant: Matrices
    spread_A: Floats
    spread_B: Floats
    right: Interval
    left: Interval


def _part(answer: Answer) -> _Part:
    """The part of one output. Raises InputError."""
    grid, delay = answer.evidence.grid, answer.evidence.delay
    if delay and answer.options.delay == "auto":
        raise InputError(
            f"scenario: the input acts {delay} samples ({delay * grid.step:.4g} s) late, and"
            f" scenarios have no delay; if only the recording is late, say --delay {delay}"
        )
    a, b, V = _plant_numbers(answer)
    plant, spread_A, spread_B = entry_spread(a, b, answer.fit.objective.layout, grid.step, V)
    return _Part(plant, spread_A, spread_B, *_edges(answer))


def _joined(plants: Sequence[Matrices]) -> Matrices:
    """Plants side by side, with the same inputs."""
    return Matrices(
        block_diag(*[plant.A for plant in plants]),
        np.vstack([plant.B for plant in plants]),
        block_diag(*[plant.C for plant in plants]),
    )


def _each(edges: Sequence[Interval]) -> str:
    """The widths of all outputs: a number, or a list."""
    return _listed([_number(edge.value) for edge in edges])


def _intervals(edges: Sequence[Interval]) -> str:
    """The 95 % intervals of all outputs, for a remark."""
    return "; ".join(f"{edge.low:.6g} to {edge.high:.6g}" for edge in edges)


def _pairs(ranges: Sequence[tuple[float, float]]) -> str:
    """The ranges of all outputs."""
    return _listed([f"[{_number(low)}, {_number(high)}]" for low, high in ranges])


def _listed(texts: Sequence[str]) -> str:
    """One text as it is, several as a list in TOML."""
    return texts[0] if len(texts) == 1 else f"[{', '.join(texts)}]"


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


def _noise(answers: Sequence[Answer]) -> list[str]:
    """Noise of the sensor, its threshold and quantum."""
    before, behind, thresholds = [], [], []
    for answer in answers:
        disturbance = answer.disturbance
        white = disturbance.rms if disturbance.white is None else disturbance.white
        before.append(white if disturbance.ahead else 0.0)
        behind.append(0.0 if disturbance.ahead else disturbance.rms)
        thresholds.append(max(0.5 * answer.evidence.grid.quantum, answer.options.threshold or 0.0))
    lines = []
    if any(before):
        texts = [_number(rms) for rms in before]
        lines.append(f"noise_before = {_listed(texts)}  # white part of what disturbs z")
        silent = [_number(threshold) for threshold in thresholds]
        lines.append(f"threshold = {_listed(silent)}  # the log has exact zeros")
    if any(behind):
        texts = [_number(rms) for rms in behind]
        lines.append(f"noise = {_listed(texts)}  # rms of the residual")
    return lines


def _reference(answers: Sequence[Answer], A: Floats) -> list[str]:
    """A sine within the range of z and the bandwidth of the plant."""
    amplitudes = []
    for answer in answers:
        z = np.abs(answer.fit.z) * answer.scale
        amplitudes.append(_number(float(np.quantile(z, 0.98))))
    return [
        "[reference]  # fits the range of z in the log",
        'kind = "sine"',
        f"amplitude = {_listed(amplitudes)}",
        f"frequency = {_number(_frequency(answers[0], A))}",
        "",
    ]


def _frequency(answer: Answer, A: Floats) -> float:
    """A frequency that plant and samples follow [Hz]."""
    rates = np.abs(np.linalg.eigvals(A))
    slowest = float(rates[rates > 1e-6 * rates.max(initial=1e-300)].min(initial=rates.max()))
    return float(f"{min(0.5 * slowest / (2 * math.pi), 0.02 / answer.evidence.grid.step):.3g}")


def _duration(answers: Sequence[Answer], A: Floats) -> float:
    """A whole number of steps that hold 20 periods of the reference, 20,000 at most."""
    step = answers[0].evidence.grid.step
    periods = 20 / _frequency(answers[0], A)
    return float(f"{step * math.ceil(min(periods / step, 20000)):.12g}")


def _disturbance(answers: Sequence[Answer]) -> list[str]:
    """What disturbs the input, for the observer: the strongest of the outputs' disturbances."""
    claims = [_claim(answer) for answer in answers]
    known = [claim for claim in claims if claim is not None]
    if len(known) < len(claims):
        return []  # something disturbs z, and nobody knows what: the observer's own default
    rms, time = max(known)
    return [
        f"disturbance = {_number(rms)}  # rms at the input",
        f"correlation_time = {_number(time)}",
    ]


def _claim(answer: Answer) -> tuple[float, float] | None:
    """rms at the input and correlation time [s] of what disturbs an output; None: not known."""
    step = answer.evidence.grid.step
    layout = answer.fit.objective.layout
    kalman = answer.evidence.kalman
    data = answer.fit.objective.data
    if not kalman:
        return (0.0, 0.5 * step) if answer.evidence.chosen.white else None
    best = kalman[0]
    phi = best.phi
    rms = best.q / math.sqrt(1 - phi * phi) * float(data.u_scale[0])
    if best.model not in (WHITE, AT_INPUT):
        a, b, _ = _plant_numbers(answer)
        at_z = best.q / math.sqrt(1 - phi * phi) * answer.scale
        rms = at_z / math.sqrt(input_gain(a, b[: layout.n], layout.n, phi))
    if phi <= 0.01:
        return rms, 0.5 * step
    return rms, float(np.clip(-step / math.log(phi), 0.11 * step, 1e5 * step))


def _tolerance(spread_A: Floats, spread_B: Floats) -> str:
    """Relative deviations of the entries of A and B, as a TOML table in a line."""
    entries = []
    for name, spread in (("A", spread_A), ("B", spread_B)):
        for i, j in np.argwhere(spread > 0):
            value = float(np.clip(spread[i, j], LEAST, MOST))
            entries.append(f'"{name}[{i},{j}]" = {value:.3g}')
    return "{ " + ", ".join(entries) + " }"


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
