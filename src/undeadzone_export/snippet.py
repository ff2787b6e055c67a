"""`--to snippet`: a few lines that compensate a zone or a gap, from a scenario or from an answer.

They hold the numbers of one nonlinearity, not an observer: no state of the plant is estimated.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from undeadzone.errors import FileError, InputError
from undeadzone.scenario.reader import read
from undeadzone.scenario.schema import Scenario
from undeadzone.util.files import read_text
from undeadzone.util.text import escape_controls, to_one_line
from undeadzone_export.targets import MANIFEST, Files, manifest_text, write_folder

SURE: Final = 0.8  # probability below which a verdict does not justify a snippet
RAMP: Final = 0.05  # of the narrower width: over so much the jump of an actuator fades in
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

_HEADS: Final = {
    "sensor": (
        "Sensor dead zone {right} / -{left} {unit} ({interval}), from {source}.",
        "It cannot see inside the zone: there it holds the edge last passed, up to {width} off.",
    ),
    "one_edge": (
        "Sensor dead zone with one edge, {edge} {unit} ({interval}), from {source}.",
        "It cannot see inside the zone: there it gives the edge, beyond which z surely is not.",
    ),
    "actuator": (
        "Actuator dead zone {right} / -{left} {unit} ({interval}), from {source}.",
        "It uses the low ends, for too large a jump oscillates. It cannot remove friction.",
    ),
    "backlash": (
        "Backlash: gap {width} {unit} ({interval}), from {source}. Reach the start from above.",
        "It cannot see a load or gravity that pushes through the gap, friction, or a spring.",
    ),
}
_SETTINGS: Final = {
    "sensor": "A PID controller: error dead band 0, with limits on its integral.",
    "one_edge": "A PID controller: error dead band 0, with limits on its integral.",
    "actuator": "A PID controller: output dead band {right_low} / -{left_low} {unit}.",
    "backlash": "LinuxCNC: BACKLASH = {width} in [JOINT_n]. Klipper and GRBL have no setting.",
    "ahead": "Smooth a noisy command first: at each of its turns the actuator crosses the gap.",
}
_SETTINGS_OF_GAPS: Final = {
    "mm": "Marlin: M425 X{width} F1 (any axis; M500 stores it).",
    **dict.fromkeys(("arcsec", "px"), "PHD2: 1000 x {width} / guide rate, in ms."),
    "ms": "PHD2: backlash compensation {width} ms.",
}
_C: Final = {
    "sensor": """static float {name}(float y)
{{
    static float edge = 0.0f;
    if (y > {silent}f) edge = {right}f;
    else if (y < -{silent}f) edge = -{left}f;
    else return edge; /* silent */
    return y + edge;
}}
""",
    "one_edge": """static float {name}(float y)
{{
    if ({sign}y <= {silent}f) return {edge}f; /* silent */
    return y + {edge}f;
}}
""",
    "actuator": """static float {name}(float wanted)
{{
    float share = wanted / {ramp}f; /* fades the jump near 0 */
    if (share > 1.0f) share = 1.0f;
    if (share < -1.0f) share = -1.0f;
    return wanted + share * (share > 0.0f ? {right_low}f : {left_low}f);
}}
""",
    "backlash": """static float {name}(float wanted)
{{
    static float before = 0.0f, lead = 0.0f;
    if (wanted > before) lead = {width}f;
    if (wanted < before) lead = 0.0f;
    before = wanted;
    return wanted + lead;
}}
""",
}
_PYTHON: Final = {
    "sensor": """class {Name}:
    edge = 0.0

    def __call__(self, y):
        if abs(y) <= {silent}:
            return self.edge  # silent
        self.edge = {right} if y > 0 else -{left}
        return y + self.edge
""",
    "one_edge": """class {Name}:
    def __call__(self, y):
        return {edge} if {sign}y <= {silent} else y + {edge}  # silent below
""",
    "actuator": """class {Name}:
    def __call__(self, wanted):
        share = max(-1.0, min(1.0, wanted / {ramp}))  # fades the jump near 0
        return wanted + share * ({right_low} if share > 0 else {left_low})
""",
    "backlash": """class {Name}:
    before = lead = 0.0

    def __call__(self, wanted):
        if wanted != self.before:
            self.lead = {width} if wanted > self.before else 0.0
        self.before = wanted
        return wanted + self.lead
""",
}
_ST: Final = {
    "sensor": """FUNCTION_BLOCK {name}
VAR_INPUT y : REAL; END_VAR
VAR_OUTPUT z : REAL; END_VAR
VAR edge : REAL := 0.0; END_VAR
IF y > {silent} THEN edge := {right}; z := y + edge;
ELSIF y < -{silent} THEN edge := -{left}; z := y + edge;
ELSE z := edge; (* silent *)
END_IF;
END_FUNCTION_BLOCK
""",
    "one_edge": """FUNCTION_BLOCK {name}
VAR_INPUT y : REAL; END_VAR
VAR_OUTPUT z : REAL; END_VAR
IF {sign}y <= {silent} THEN z := {edge}; (* silent *)
ELSE z := y + {edge};
END_IF;
END_FUNCTION_BLOCK
""",
    "actuator": """FUNCTION_BLOCK {name}
VAR_INPUT wanted : REAL; END_VAR
VAR_OUTPUT command : REAL; END_VAR
VAR share : REAL; END_VAR
share := LIMIT(-1.0, wanted / {ramp}, 1.0); (* fades the jump near 0 *)
IF share > 0.0 THEN command := wanted + share * {right_low};
ELSE command := wanted + share * {left_low};
END_IF;
END_FUNCTION_BLOCK
""",
    "backlash": """FUNCTION_BLOCK {name}
VAR_INPUT wanted : REAL; END_VAR
VAR_OUTPUT command : REAL; END_VAR
VAR before : REAL; lead : REAL; END_VAR
IF wanted > before THEN lead := {width}; ELSIF wanted < before THEN lead := 0.0; END_IF;
before := wanted;
command := wanted + lead;
END_FUNCTION_BLOCK
""",
}


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
    return report | {"written": [str(path) for path in written]}


def snippet_texts(lost: Lost, name: str) -> dict[str, str]:
    """Return the three texts by the names of their files.

    Args:
        lost: widths that they compensate.
        name: of the function.
    """
    if not (name.isascii() and name.isidentifier() and name.islower()):
        raise InputError(f"--name: expected small letters, digits and _, found {name!r}")
    kind = lost.kind
    sign = ""
    bounded = [lost.width] if kind == "backlash" else [lost.right, lost.left]
    if lost.absent:
        kind = "one_edge"
        sign = "-" if lost.absent == "right" else ""
        bounded = [lost.left if sign else lost.right]
    words = {
        "sign": sign,
        "edge": sign + _literal(bounded[0][0]),
        "name": name,
        "Name": name.capitalize(),
        "unit": "" if lost.unit == "1" else escape_controls(to_one_line(lost.unit)),
        "source": escape_controls(to_one_line(lost.source)).replace("*", "_"),
        "interval": ", ".join(f"{_literal(low)}..{_literal(high)}" for _, low, high in bounded)
        if any(low < high for _, low, high in bounded)
        else "given, no interval",
        "right": _literal(lost.right[0]),
        "left": _literal(lost.left[0]),
        "right_low": _literal(max(lost.right[1], 0.0)),
        "left_low": _literal(max(lost.left[1], 0.0)),
        "width": _literal(lost.width[0]),
        "silent": _literal(lost.silent),
        "ramp": _literal(RAMP * max(min(lost.right[0], lost.left[0]), 1e-3 * lost.width[0])),
    }
    settings = [_SETTINGS["ahead" if lost.is_ahead else kind]]
    if kind == "backlash" and not lost.is_ahead and lost.unit in _SETTINGS_OF_GAPS:
        settings.insert(0, _SETTINGS_OF_GAPS[lost.unit])
    head = [" ".join(line.format(**words).split()) for line in (*_HEADS[kind], *settings)]
    c, python, st = (each[kind].format(**words) for each in (_C, _PYTHON, _ST))
    return {
        "snippet.h": "/* " + "\n   ".join(head) + " */\n" + c,
        "snippet.py": "".join(f"# {line}\n" for line in head) + python,
        "snippet.st": "(* " + "\n   ".join(head) + " *)\n" + st,
    }


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
    """Return what the numbers of an answer of `identify` compensate.

    Args:
        found: the numbers, as in identify.json.
        path: of it, for messages.
        name: of where they came from, for people.

    Raises:
        InputError: nothing is certain, or no few lines compensate it.
    """
    verdict = found["verdict"]
    if "outputs" in found:
        raise InputError(f"{path}: holds several outputs. Identify one, named by --columns y=NAME")
    if verdict not in KINDS:
        raise InputError(
            f"{path}: the verdict is {verdict}, which a snippet cannot compensate. Record "
            "longer, or with larger and slower reversals, and identify again (--next proposes an "
            "input)"
        )
    motion = found.get("lost_motion")
    kind = KINDS[verdict]
    try:
        odds = found.get("odds") or {verdict: 1.0}
        faulty = sum(float(odds.get(word, 0.0)) for word in VALVE)
        share = max(faulty * (verdict in VALVE), *map(float, odds.values()))
        unit = found["units"]["input" if verdict in OF_INPUT or motion else "output"]
        silent = 0.5 * float(found["record"]["quantum"] or 0.0)
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
    if kind == "sensor" and found.get("output_zero"):
        _require_backlash(kind, path)
    gone = "".join(absent)
    return Lost(kind, right, left, width, unit, name, silent, gone, verdict == "input_play")


def _require_backlash(kind: str, path: str | Path) -> None:
    """Raise InputError if a zone is to be compensated about another point than 0."""
    if kind != "backlash":
        raise InputError(
            f"{path}: operating_point: the few lines act about 0. Export the observer with its"
            " controller by --to c or --to st, which count from the point"
        )


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
    value, low, high = (float(number) for number in values)
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
    if scenario.operating_point is not None:
        _require_backlash(kind, path)
    silent = 0.5 * max(_numbers(scenario.sensor.quantum), default=0.0)
    return Lost(kind, right, left, width, unit, path.name, silent, is_ahead=is_ahead)


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
