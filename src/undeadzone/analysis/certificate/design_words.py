"""A design in words: its gains, their proof, their trade."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

UNITS: Final = {
    "rate": "1/s",
    "disturbance": "rms error per white disturbance",
    "mismatch": "per relative model error",
    "noise": "per rms noise",
}


def in_words(design: Mapping[str, Any]) -> dict[str, Any]:
    """The gains of a design, their proof and their trade.

    Args:
        design: the fields of a `Design`, as its file has them.
    """
    best = design["best"]
    shown: dict[str, Any] = {
        "scenario": design["title"],
        "chosen": f"{design['chosen']}, seed {design['seed']}",
        "L": plain(best["L"]),
        "gamma": plain(best["gamma"]),
        "certified": in_words_of_margin(design["margin"], design["frequency"]),
        "rate": f"{best['rate']:.4g} 1/s along the reference",
        "proof P": [plain(row) for row in design["P"]],
        "proof W": plain(design["W"]),
        "trade": _trade(best, design["present"]),
    }
    if design["remarks"]:
        shown["remark"] = design["remarks"]
    return shown


def in_words_of_margin(margin: float, frequency: float | None) -> str:
    """The margin of a proof, and where it is attained [rad/s]."""
    where = "for large frequencies"
    if frequency is not None and math.isfinite(frequency):
        where = f"at {frequency:.4g} rad/s"
    return f"yes, margin {margin:.4g} {where}: V never rises, whatever the sides do"


def plain(gains: list[Any]) -> str:
    """Gains as one would write them in a scenario, to six digits.

    One column is written as a plain list, one number as itself.
    """
    words = []
    for row in gains:
        if not isinstance(row, list):
            words.append(f"{row:.6g}")
        elif len(row) == 1 and not isinstance(row[0], list):
            words.append(f"{row[0]:.6g}")
        else:
            words.append(plain(row))
    single = len(words) == 1 and not isinstance(gains[0], list)
    return words[0] if single else f"[{', '.join(words)}]"


def _trade(best: Mapping[str, Any], present: Mapping[str, Any] | None) -> list[str]:
    """What the gains are worth, against the present ones if there are any."""
    lines = []
    for name, unit in UNITS.items():
        words = f"{name} {best[name]:.4g} {unit}"
        if present is not None:
            words += f"; yours {present[name]:.4g}"
        lines.append(words)
    return lines
