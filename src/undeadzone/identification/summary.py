"""The answer as numbers for JSON."""

from __future__ import annotations

from typing import Any

from undeadzone.identification.answer import Answer
from undeadzone.identification.intervals import Interval


def numbers(answer: Answer) -> dict[str, Any]:
    """All numbers of an answer, as nested dictionaries.

    Args:
        answer: what a log says.

    Returns:
        zone, verdict, right, left, width, centre (each [value, low, high] or None), order,
        alternatives, held_out, and more.
    """
    evidence = answer.evidence
    grid, chosen = evidence.grid, evidence.chosen
    return {
        "zone": answer.zone,
        "verdict": answer.verdict,
        "reasons": answer.reasons,
        "right": _listed(answer.right),
        "left": _listed(answer.left),
        "width": _listed(answer.width),
        "centre": _listed(answer.centre),
        "order": answer.order,
        "plant": {
            "poles": [[float(pole.real), float(pole.imag)] for pole in answer.poles],
            "gain": answer.gain.tolist(),
        },
        "disturbance": answer.disturbance._asdict(),
        "zone_width": None if answer.element is None else _listed(answer.element.zone),
        "offsets": _offsets(answer),
        "alternatives": behind_the_best(answer),
        "place": _place(answer),
        "held_out": {
            "error": chosen.error * answer.scale,
            "fit": chosen.share,
            "white": chosen.white,
        },
        "orders": [
            {"order": one.n, "bic": one.pairs.bic, "held_out_error": one.error * answer.scale}
            for one in evidence.orders
        ],
        "no_zone": evidence.no_zone.chance,
        "residual_map": {
            "share": evidence.residuals.share,
            "p": evidence.residuals.chance,
            "moving_share": evidence.residuals.moving_share,
            "moving_p": evidence.residuals.moving_chance,
        },
        "excitation": {
            "samples": list(evidence.excitation.samples),
            "visits": list(evidence.excitation.visits),
            "silent": evidence.excitation.silent,
            "longest_silence": evidence.excitation.longest * grid.step,
        },
        "stages": _stages(answer),
        "record": {
            "samples": int(grid.t.size),
            "readings": int(grid.ok.sum()),
            "records": int(grid.start.size),
            "step": grid.step,
            "quantum": grid.quantum,
        },
        "units": {"input": grid.input_unit, "output": grid.output_unit},
        "remarks": answer.remarks,
    }


def _listed(interval: Interval | None) -> list[float] | None:
    """[value, low, high]."""
    return None if interval is None else [float(number) for number in interval]


def _offsets(answer: Answer) -> dict[str, Any] | None:
    """What the four offsets of the readings say."""
    offsets = answer.evidence.offsets
    if offsets is None:
        return None
    pairs = zip(offsets.widths * answer.scale, offsets.std * answer.scale, strict=True)
    play, zone, rest = ([float(value), float(std)] for value, std in pairs)
    return {"name": offsets.name, "play": play, "dead_zone": zone, "rest": rest}


def behind_the_best(answer: Answer) -> dict[str, Any]:
    """Nats per sample by which static rivals and other places are behind the best of their kind."""
    rivals = answer.evidence.rivals
    best = min(one.bic for one in rivals.values())
    behind = {}
    for name, one in rivals.items():
        behind[name] = (one.bic - best) / (2 * one.value.size)
    return behind


def _place(answer: Answer) -> dict[str, Any] | None:
    """The place of the zone, lambda, and how far other places are behind."""
    place = answer.evidence.place
    if place is None:
        return None
    u_scale = answer.fit.objective.data.u_scale[0]
    levels = {}
    for name, (right, left) in place.levels.items():
        levels[name] = [right * u_scale, left * u_scale]
    return {
        "verdict": place.verdict,
        "lambda": [place.lam, place.lam - place.half, place.lam + place.half],
        "by_rivals": place.by_rivals,
        "by_lambda": place.by_lambda,
        "behind": place.behind,
        "levels": levels,
    }


def _stages(answer: Answer) -> dict[str, Any]:
    """Widths and half intervals by stage of the fit."""
    widths = answer.evidence.widths
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
