"""The answer in the units of the log, with remarks on what to be careful about."""

from __future__ import annotations

import math

import numpy as np

from undeadzone.identification.answer import Answer, Evidence
from undeadzone.identification.edge_profile import widened
from undeadzone.identification.excitation import FEW_VISITS
from undeadzone.identification.intervals import Interval, Widths, lower_bound
from undeadzone.identification.jump_edges import JumpEdge
from undeadzone.identification.options import Options
from undeadzone.identification.orders import hears_input
from undeadzone.identification.prepare import Prepared
from undeadzone.identification.verdict import Verdict


def to_answer(prepared: Prepared, options: Options, evidence: Evidence, verdict: Verdict) -> Answer:
    """The answer in the units of the log.

    Args:
        prepared: the log as it was fitted.
        options: what the user said.
        evidence: all that was computed.
        verdict: in the end.
    """
    chosen = evidence.chosen
    simulator = chosen.pairs.objective.simulator
    data = prepared.data
    poles = simulator.poles(chosen.pairs.theta).astype(complex)
    with np.errstate(divide="ignore"):
        rates = np.log(poles) / evidence.grid.step
    gain = simulator.gain(chosen.pairs.theta) * data.y_scale / data.u_scale
    gain /= evidence.grid.step**options.integrators
    remarks = [*prepared.remarks, *verdict.cautions]
    shown: dict[str, Interval | None] = dict.fromkeys(("right", "left", "width", "centre"))
    word = verdict.word
    has_edges = word == "dead_zone" or (word == "jump" and evidence.jumps is not None)
    if evidence.delay and has_edges:
        late = f" ({evidence.delay * evidence.grid.step:.4g} s)"
        if evidence.grid.counted:
            late = ""
        remarks.append(f"the input acts {evidence.delay} samples late{late}")
    if has_edges:
        heard = hears_input(chosen.pairs)
        if evidence.jumps is not None:
            shown = _jumps(evidence.jumps, data.y_scale, evidence.grid.quantum)
        else:
            shown = _shown(evidence, options, data.y_scale, 2.0 if heard else 1.0)
        remarks += _edge_remarks(evidence, shown, heard)
        remarks += _hardly_passed(evidence, shown, data.y_scale)
        word = "unreached" if evidence.unreached else word
    return Answer(
        word,
        verdict.reasons,
        shown["right"],
        shown["left"],
        shown["width"],
        shown["centre"],
        chosen.n,
        rates,
        gain,
        remarks,
        options,
        evidence,
    )


def _edge_remarks(evidence: Evidence, shown: dict[str, Interval | None], heard: bool) -> list[str]:
    """What to know of edges that are given."""
    remarks = list(evidence.widths.remarks) if evidence.jumps is None else []
    if heard:
        remarks.append(
            "past inputs explain part of the one-step residual: a delay, or too few poles; the"
            " plant model does not fit, and the intervals are doubled; try a higher --order, or"
            " shift the input by the delay"
        )
    for name in evidence.unreached:
        remarks.append(
            f"no reading lies beyond the {name} edge: record with a larger input, or say"
            f" --{name} inf if there is none"
        )
    if _tied(evidence):
        remarks.append(
            "z of an integrating plant has no zero of its own: it counts from the middle of the"
            " zone, so both edges are half of the width; the place of the zone is not asked"
        )
    for name in ("right", "left"):
        edge = shown[name]
        if edge is not None and edge.value < 0:
            remarks.append(
                f"d_{name} is negative: the zone does not hold z = 0, as after an offset of the"
                " input or of the output; the width is not touched by that"
            )
    return remarks


def _tied(evidence: Evidence) -> bool:
    """Whether both edges are one number, of a plant that integrates."""
    return evidence.chosen.pairs.objective.limits.tied


def _hardly_passed(
    evidence: Evidence, shown: dict[str, Interval | None], scale: float
) -> list[str]:
    """Widen the intervals of edges that are hardly passed, and say so."""
    remarks: list[str] = []
    if evidence.jumps is not None or _tied(evidence):
        return remarks
    for name, visits in zip(("right", "left"), evidence.excitation.visits, strict=True):
        edge = shown[name]
        if not 0 < visits < FEW_VISITS or edge is None or not edge.low < edge.high < math.inf:
            continue
        wider = widened(evidence.chosen.pairs, name, edge, scale)
        more = (edge.low - wider.low, wider.high - edge.high)
        shown[name] = wider
        shown["width"] = _grown(shown["width"], *more)
        shown["centre"] = _grown(shown["centre"], max(more), max(more))
        remarks.append(
            f"the {name} edge is passed {visits} times only: hardly known; its interval is that of"
            " the profile likelihood where that is wider"
        )
    return remarks


def _grown(interval: Interval | None, below: float, above: float) -> Interval | None:
    """An interval that reaches further."""
    if interval is None:
        return None
    return Interval(interval.value, interval.low - below, interval.high + above)


def _jumps(
    jumps: tuple[JumpEdge, JumpEdge], scale: float, quantum: float
) -> dict[str, Interval | None]:
    """The edges of a jump sensor in the units of the log; the others are on the safe side."""
    sides = []
    for edge in jumps:
        wider = 0.5 * quantum if edge.high > edge.low else 0.0
        sides.append(
            Interval(edge.value * scale, edge.low * scale - wider, edge.high * scale + wider)
        )
    right, left = sides
    return {
        "right": right,
        "left": left,
        "width": Interval(right.value + left.value, right.low + left.low, right.high + left.high),
        "centre": Interval(
            0.5 * (right.value - left.value),
            0.5 * (right.low - left.high),
            0.5 * (right.high - left.low),
        ),
    }


def _shown(
    evidence: Evidence, options: Options, scale: float, wider: float
) -> dict[str, Interval | None]:
    """The widths in the units of the log; an edge never reached has a lower bound alone."""
    widths: Widths = evidence.widths
    shown: dict[str, Interval | None] = {}
    for name in ("right", "left", "width", "centre"):
        interval = getattr(widths, name).scaled(scale)
        half = wider * interval.half
        shown[name] = Interval(interval.value, interval.value - half, interval.value + half)
    for name in ("right", "left"):
        low, high = options.bounds("right" if name == "right" else "left")
        if low == high:
            shown[name] = None if low == math.inf else Interval(low, low, high)
        if low == math.inf:
            shown["width"] = shown["centre"] = None
    if _tied(evidence):
        shown["centre"] = None
    for name in evidence.unreached:
        bound = lower_bound(evidence.chosen.singles, name) * scale
        shown[name] = Interval(bound, bound, math.inf)
        shown["width"] = shown["centre"] = None
    return shown
