"""`--to snippet`: a few lines that compensate a zone or a gap, from a scenario or from an answer.

They hold the numbers of one nonlinearity, not an observer: no state of the plant is estimated. The
answer of `identify`, its page, its firmware and `export` print the same lines, from here.

Noise behind a sensor's zone: let y = dz(z) + s e with white Gaussian e, a zone of width W = r + l
with the middle m = (r - l) / 2, and q = y / s. Under a flat prior the z inside the zone have the
weight W f(q) / s, and those beyond the edges F(q) and F(-q), whose sum is 1 (f: normal density, F:
distribution). Their means are m, y + r + s f(q) / F(q) and y - l - s f(q) / F(-q). The terms with
s f(q) cancel, so the posterior mean of z is

    m + (y + W / 2 (F(q) - F(-q))) / (1 + W f(q) / s)

and F(q) - F(-q) is tanh(0.7979 q + 0.0357 q^3) to 4e-4. For s -> 0 it is m at y = 0, and y plus an
edge elsewhere. Silence and the part beyond an edge weigh the same at q = sqrt(2 log(W f(0) / s)),
the threshold of a sensor with one edge.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from undeadzone.errors import FileError, InputError
from undeadzone.scenario.operating_point import OperatingPoint
from undeadzone.scenario.reader import read
from undeadzone.scenario.schema import Scenario
from undeadzone.util.files import read_table, read_text
from undeadzone.util.text import escape_controls, to_one_line
from undeadzone_export.targets import MANIFEST, Files, manifest_text, write_folder

SURE: Final = 0.8  # probability below which a verdict does not justify a snippet
RAMP: Final = 0.05  # of the narrower width: over so much the jump of an actuator fades in
LONGER: Final = (
    "a longer record, or larger and slower reversals, and identify again (--next proposes an input)"
)
KINDS: Final = {
    "dead_zone": "sensor",
    "filtered_zone": "sensor",
    "input_zone": "actuator",
    "play": "backlash",
    "input_play": "backlash",
}
VALVE: Final = ("stiction", "input_play")  # the lead lessens the error of either
OF_INPUT: Final = ("input_zone", "input_play")  # verdicts with widths in the input's unit
NAMES: Final = {"sensor": "undead", "actuator": "driven", "backlash": "commanded"}
_TEXTS: Final = read_table(__file__)

Triple: TypeAlias = tuple[float, float, float]  # a value with the ends of its interval


class Lost(NamedTuple):
    """Widths that a snippet compensates.

    Attributes:
        kind: sensor, actuator or backlash.
        right, left, width: each as (value, low, high) (of a gap the width counts alone).
        unit: of them.
        source: description of their source.
        silent: |y| up to which a sensor's sample is censored.
        absent: right or left, where a sensor has no such edge, else empty.
        is_ahead: whether a gap is that of an actuator, ahead of the plant.
        rest: reading or command from which the widths count.
        noise: rms of a sensor's readings inside the zone.
        measured: description of the error with the lines.
    """

    kind: str
    right: Triple
    left: Triple
    width: Triple
    unit: str
    source: str
    silent: float = 0.0
    absent: str = ""
    is_ahead: bool = False
    rest: float = 0.0
    noise: float = 0.0
    measured: str = "Not measured: no log is known."


def write_snippet(
    source: Path, out: Path, name: str | None, force: bool, confine: Path | None = None
) -> dict[str, Any]:
    """Write snippet.h, snippet.py and snippet.st, and return the report.

    Args:
        source: a scenario, or the identify.json of `undeadzone identify`.
        out: the folder.
        name: of the function (None: a usual one).
        force: whether files that someone edited are replaced.
        confine: a folder outside of which a scenario may name no file (None: any).

    Raises:
        InputError: there is nothing that a few lines can compensate, and why.
    """
    if source.suffix.lower() == ".json":
        lost = _of_answer(source)
    else:
        lost = _of_scenario(read(source, confine), source)
    return write_lost(lost, out, name, force)


def write_lost(lost: Lost, out: Path, name: str | None, force: bool) -> dict[str, Any]:
    """Write the three texts that compensate some widths, and return the report.

    Args:
        lost: the widths.
        out: the folder.
        name: of the function (None: a usual one).
        force: whether files that someone edited are replaced.
    """
    texts: Files = dict(snippet_texts(lost, name or NAMES[lost.kind]))
    report: dict[str, Any] = {
        "kind": lost.kind,
        **{key: list(getattr(lost, key)) for key in ("right", "left", "width")},
        "unit": lost.unit,
        "files": sorted({*texts, MANIFEST}),
    }
    written = write_folder(texts | {MANIFEST: manifest_text(dict(report))}, out, force)
    return report | {"written": list(map(str, written))}


def snippet_texts(lost: Lost, name: str) -> dict[str, str]:
    """Return the three texts by the names of their files.

    Args:
        lost: widths that they compensate.
        name: of the function.
    """
    if not (name.isascii() and name.isidentifier() and name.islower()):
        raise InputError(f"--name: expected small letters, digits and _, found {name!r}")
    r, l, w = map(_round_to_interval, (lost.right, lost.left, lost.width))
    lost = lost._replace(right=r, left=l, width=w)
    kind, rest, noise = lost.kind, lost.rest, float(f"{lost.noise:.3g}")
    right, left, width = lost.right[0], lost.left[0], lost.width[0]
    silence = (right + left) / max(noise * math.sqrt(2 * math.pi), 1e-300)
    silent = max(lost.silent, noise * math.sqrt(2 * math.log(max(silence, 1.0))))
    if kind == "sensor" and noise > lost.silent:
        kind = "noisy"
    if lost.absent:
        kind = "one_edge"
    bounded = _known_edges(lost)
    numbers = {
        "edge": bounded[0][0],
        "right": right,
        "left": left,
        "right_low": max(lost.right[1], 0.0),
        "left_low": max(lost.left[1], 0.0),
        "width": width,
        "above": rest + silent,
        "below": rest - silent,
        "middle": rest + 0.5 * (right - left),
        "half": 0.5 * (right + left),
        "noise": noise,
        "silence": float(f"{silence:.4g}"),
        "ramp": RAMP * max(min(right, left), 1e-3 * width),
    }
    words = {key: _literal(value) for key, value in numbers.items()}
    is_below = lost.absent == "right"
    signal = "y" if lost.kind == "sensor" else "wanted"
    sign = "+" if rest < 0 else "-"
    offset = f"({signal} {sign} {_literal(abs(rest))}" if rest else ""
    words |= {
        "beyond": f"< {words['below']}" if is_below else f"> {words['above']}",
        "shift": f"- {words['left']}" if is_below else f"+ {words['right']}",
        "from_rest": f"{offset})" if rest else signal,
        "from_rest_c": f"{offset}f)" if rest else signal,
        "rest": f" about {rest:.7g}: {rest - left:.7g} to {rest + right:.7g}" if rest else "",
        "name": name,
        "unit": "" if lost.unit == "1" else escape_controls(to_one_line(lost.unit)),
        "source": escape_controls(to_one_line(lost.source)).replace("*", "_"),
        "interval": ", ".join(f"{_literal(low)}..{_literal(high)}" for _, low, high in bounded)
        if any(low < high for _, low, high in bounded)
        else "given, no interval",
    }
    settings = [_TEXTS["settings"]["ahead" if lost.is_ahead else kind]]
    of_gaps = _TEXTS["settings_of_gaps"]
    if kind == "backlash" and not lost.is_ahead and lost.unit in of_gaps:
        settings.insert(0, of_gaps[lost.unit])
    lines = (*_TEXTS["heads"][kind], lost.measured, *settings)
    head = [" ".join(line.format(**words).split()) for line in lines]
    c, python, st = (_TEXTS[each][kind].format(**words) for each in ("c", "python", "st"))
    return {
        "snippet.h": "/* " + "\n   ".join(head) + " */\n" + c,
        "snippet.py": "".join(f"# {line}\n" for line in head) + python,
        "snippet.st": "(* " + "\n   ".join(head) + " *)\n" + st,
    }


def _round_to_interval(one: Triple) -> Triple:
    """Return a value and its interval with as many digits as the interval bears."""
    value, low, high = one
    digits = 2 - math.floor(math.log10(high - low)) if high > low else 12
    return round(value, digits), round(low, digits), round(high, digits)


def _known_edges(lost: Lost) -> list[Triple]:
    """Return the numbers that the lines need: the width of a gap, or each edge of a zone."""
    if lost.kind == "backlash":
        return [lost.width]
    return [getattr(lost, side) for side in ("right", "left") if side != lost.absent]


def load_lines(lost: Lost) -> Callable[[float], float]:
    """Return the lines in Python as they are printed, as a function.

    Args:
        lost: widths that they compensate.
    """
    scope: dict[str, Any] = {}
    plain = lost._replace(source="", unit="", measured="")  # no text of a file is run
    exec(snippet_texts(plain, "lines")["snippet.py"], scope)
    lines: Callable[[float], float] = scope["lines"]
    return lines


def _literal(value: float) -> str:
    """Return a number that C, Python and Structured Text read alike."""
    mantissa, mark, exponent = f"{value:.7g}".partition("e")
    return mantissa + ".0" * ("." not in mantissa) + (mark and f"e{int(exponent)}")


def _of_answer(path: Path) -> Lost:
    """Return the widths in an answer of `identify`. Raises InputError if no width is certain."""
    try:
        found = json.loads(read_text(path))
        found["verdict"]
    except (ValueError, KeyError, TypeError):
        raise FileError(
            f"{path}: expected the identify.json of `undeadzone identify`, or a scenario"
        ) from None
    return lost_of_answer(found, str(path), path.name)


def lost_of_answer(found: dict[str, Any], path: str, name: str) -> Lost:
    """Return what the numbers of an answer of `identify` compensate, if that pays.

    Args:
        found: the numbers, as in identify.json.
        path: of it, for messages.
        name: of where they came from, for people.

    Raises:
        InputError: nothing is certain, no few lines compensate it, or they do not pay.
    """
    lost = build_lost(found, path, name)
    lines = found.get("lines")
    if lines is None:
        raise InputError(f"{path}: no error of the lines was measured. Identify the log again")
    unit = "" if lost.unit == "1" else f" {lost.unit}"
    errors = f"rms error {lines['without']:.4g} -> {lines['with']:.4g}{escape_controls(unit)}"
    if not lines["with"] < lines["without"]:
        raise InputError(f"{path}: a few lines do not pay: {errors} on {lines['on']}")
    return lost._replace(measured=f"On {lines['on']}: {errors}.")


def build_lost(found: dict[str, Any], path: str, name: str) -> Lost:
    """Return the widths of an answer of `identify`, before the lines are measured.

    Args:
        found, path, name: as of `lost_of_answer`.

    Raises:
        InputError: nothing is certain, or no few lines compensate it.
    """
    verdict = found["verdict"]
    if "outputs" in found:
        raise InputError(f"{path}: holds several outputs. Identify one, named by --columns y=NAME")
    if verdict not in KINDS:
        remedies = found.get("answer", {}).get("remedies") or [LONGER]
        raise InputError(
            f"{path}: the verdict is {verdict}, which a snippet cannot compensate. What helps: "
            + "; ".join(map(str, remedies))
        )
    motion = found.get("lost_motion")
    kind = KINDS[verdict]
    try:
        account, record = found["answer"], found["record"]
        odds = found.get("odds") or {verdict: 1.0}
        faulty = sum(float(odds.get(word, 0.0)) for word in VALVE)
        share = max(faulty * (verdict in VALVE), *map(float, odds.values()))
        unit = found["units"]["input" if verdict in OF_INPUT or motion else "output"]
        silent, noise = (float(record.get(key) or 0.0) for key in ("quantum", "rest_noise"))
        if kind == "backlash":  # whose width alone may be known, and alone counts
            width = _triple(motion["gap"] if motion else found["width"])
            right = left = (0.0, 0.0, 0.0)
        else:
            right, left, width = _edges(found)
    except (KeyError, TypeError, ValueError):
        raise InputError(
            f"{path}: the verdict {verdict} has no widths with intervals. Record longer, with "
            "more passages of the edges, and identify again"
        ) from None
    if share < SURE:
        raise InputError(
            f"{path}: {verdict} is likely to {100 * share:.0f} % only, and {100 * SURE:.0f} % are "
            "needed. Record the input that `identify --next` proposes"
        )
    absent = [side for side in ("right", "left") if kind != "backlash" and found[side] is None]
    if absent and kind == "actuator":
        raise InputError(
            f"{path}: the {absent[0]} edge of the actuator's dead zone is not known, and half a "
            "compensation pulls to one side. Record an input that passes both edges"
        )
    rest = float(found.get({"sensor": "output_zero", "actuator": "input_zero"}.get(kind, "")) or 0)
    if rest and kind == "actuator":  # about which nothing is known but the band: it rests inside
        rest += 0.5 * (right[0] - left[0])
        right = left = _triple([0.5 * one for one in width])
    gone, is_ahead = "".join(absent), verdict == "input_play"
    lost = Lost(kind, right, left, width, unit, name, 0.5 * silent, gone, is_ahead, rest, noise)
    doubts = [f"{side} side was never tried" for side in account["never_tried"]]
    doubts += ["name is withheld"] * (account["grade"] != "named")
    doubts += ["interval of an edge holds 0"] * any(low <= 0 for _, low, _ in _known_edges(lost))
    if doubts:
        raise InputError(
            f"{path}: the {doubts[0]}. Record the input that `identify --next` proposes"
        )
    return lost


def _edges(found: dict[str, Any]) -> tuple[Triple, Triple, Triple]:
    """Return right, left and width of a zone; an edge that does not exist is of no width.

    Raises TypeError if neither is known, or a width is missing beside two edges.
    """
    right, left = found["right"], found["left"]
    width = found["width"] if right and left else right or left
    none = (0.0, 0.0, 0.0)
    return _triple(right or none), _triple(left or none), _triple(width)


def _triple(values: Any) -> Triple:
    """Return (value, low, high). Raises ValueError if one of them is no finite number."""
    value, low, high = map(float, values)
    if not all(map(math.isfinite, (value, low, high))):
        raise ValueError
    return value, low, high


def _of_scenario(scenario: Scenario, path: Path) -> Lost:
    """Return the zone or gap of a scenario: the sensor's, else the actuator's."""
    places = [one for one in (scenario.sensor, scenario.actuator) if one is not None]
    zones = [one for one in places if any(_numbers(one.right) + _numbers(one.left))]
    if not zones:
        raise InputError(f"{path}: no zone in sensor or actuator: nothing to compensate")
    zone = zones[0]
    if zone.kind == "jump":
        raise InputError(f"{path}: a jump sensor's readings are not shifted: nothing to add")
    is_sensor = zone is scenario.sensor
    known = scenario.observer if is_sensor else None
    right, left = (
        _with_range(_single(_numbers(getattr(zone, name)), path), getattr(known, name, None))
        for name in ("right", "left")
    )
    kind = "sensor" if is_sensor else "actuator"
    unit = scenario.units.output if is_sensor else scenario.units.input
    if zone.kind == "play":
        kind = "backlash"
    is_ahead = kind == "backlash" and not is_sensor
    width = _triple([a + b for a, b in zip(right, left, strict=True)])
    point = scenario.operating_point or OperatingPoint()
    rest = max(_numbers(point.output if is_sensor else point.input), key=abs)
    rest *= kind != "backlash"
    quantum, noise = (
        max(_numbers(one), default=0.0) for one in (scenario.sensor.quantum, scenario.sensor.noise)
    )
    return Lost(kind, right, left, width, unit, path.name, 0.5 * quantum, "", is_ahead, rest, noise)


def _numbers(value: Any) -> list[float]:
    """Return one width or several as a list, empty for a missing width."""
    return [] if value is None else np.ravel(np.asarray(value, float)).tolist()


def _single(values: list[float], path: Path) -> float:
    """Return the only width of a side. Raises InputError if there are several, or none ends."""
    if len({*values}) > 1 or not math.isfinite(values[0]):
        raise InputError(f"{path}: expected one finite width on each side, found {values}")
    return values[0]


def _with_range(value: float, prior: Any) -> tuple[float, float, float]:
    """Return a width with the observer's assumed range, if the range contains the width."""
    pair = _numbers(prior)
    is_covered = len(pair) == 2 and pair[0] <= value <= pair[1] < math.inf
    return (value, pair[0], pair[1]) if is_covered else (value, value, value)
