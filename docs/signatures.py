"""Pictures for docs/nonlinearities.md: how each nonlinearity looks in data, and how to tell.

    python docs/signatures.py

writes docs/figures/which/*.svg. The signatures are simulated with the package's own elements.
"""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import NamedTuple

import numpy as np

from undeadzone.nonlinearities.actuator import Actuator, resolve_actuator, through_zone
from undeadzone.nonlinearities.play import apply_backlash
from undeadzone.util.arrays import Floats
from undeadzone_identify.models.place import simulate_friction

FOLDER = Path(__file__).parent / "figures" / "which"
STYLE = """<style>
.page{fill:#fff}.ink{fill:#1f2933}.dim{fill:#5b6673}.axis{stroke:#aab4be;fill:none}
.grey{stroke:#8a96a3;fill:none;stroke-width:1.2}.read{stroke:#0b6fa4;fill:none;stroke-width:1.8}
.box{fill:#eef3f7;stroke:#8a96a3}.answer{fill:#dcefe4;stroke:#3c8c5c}.line{stroke:#5b6673;fill:none}
text{font:12px system-ui,sans-serif}.small{font-size:11px}.bold{font-weight:600}
@media (prefers-color-scheme:dark){.page{fill:#1e2329}.ink{fill:#e6ebf0}.dim{fill:#a5b0bc}
.axis{stroke:#56616c}.grey{stroke:#8a96a3}.read{stroke:#5cb8e6}.box{fill:#2a3139;stroke:#6b7783}
.answer{fill:#21402f;stroke:#58a878}.line{stroke:#a5b0bc}}
</style>"""
WIDE, HIGH = 360, 150
LEFT, RIGHT = (24, 20, 120, 100), (172, 20, 176, 100)  # x, y, width, height of both panels
TIME = np.linspace(0.0, 12.0, 1201)


class Signature(NamedTuple):
    """What is drawn: the cause, its name, and the reading, over TIME."""

    cause: Floats
    letter: str
    reading: Floats


def moving() -> Floats:
    """An output that swings less and less about a place that moves."""
    return (1.6 - 0.09 * TIME) * np.sin(1.9 * TIME) + 0.35 * np.sin(0.55 * TIME)


def played(z: Floats, right: float, left: float) -> Floats:
    """z behind a play, by the rule of the simulated sensor."""
    y, now = np.empty(z.size), 0.0
    for k, value in enumerate(z):
        now = float(apply_backlash(np, value, now, right, left))
        y[k] = now
    return y


def zone(z: Floats, right: float, left: float) -> Floats:
    """z behind a dead zone, by the rule of the simulated actuator and sensor alike."""
    return np.asarray(through_zone(np, z, resolve_actuator(Actuator(right=right, left=left), 1)))


def behind(u: Floats) -> Floats:
    """Output of a first-order plant with a time constant of 0.25."""
    pole = float(np.exp(-(TIME[1] - TIME[0]) / 0.25))
    z = np.zeros(u.size)
    for k in range(1, u.size):
        z[k] = pole * z[k - 1] + (1 - pole) * u[k - 1]
    return z


def rubbing(u: Floats) -> Floats:
    """Velocity of the same plant with Coulomb friction of 0.5 that sticks."""
    pole = float(np.exp(-(TIME[1] - TIME[0]) / 0.25))
    level = 0.5 * (1 - pole)
    exogenous = np.column_stack([np.append(0.0, u[:-1]), np.eye(u.size, 1)])
    numbers = np.array([[-pole, 1 - pole, 0.0, 0.0, level, level, 0.0, 0.0]])
    return np.asarray(simulate_friction(1, 1, False, exogenous, numbers)[0])


def signatures() -> dict[str, Signature]:
    """Each element's signature, by name of its picture."""
    z = moving()
    outside = (z > 0.5) | (z < -0.4)
    return {
        "dead_zone": Signature(z, "z", zone(z, 0.5, 0.4)),
        "jump": Signature(z, "z", np.where(outside, z, 0.0)),
        "play": Signature(z, "z", played(z, 0.4, 0.3)),
        "both": Signature(z, "z", zone(played(z, 0.4, 0.3), 0.3, 0.3)),
        "saturation": Signature(z, "z", np.clip(z, -0.8, 1.0)),
        "actuator": Signature(z, "u", behind(zone(z, 0.5, 0.4))),
        "friction": Signature(z, "u", rubbing(z)),
    }


def picture(signature: Signature) -> str:
    """Reading by cause, and both over time."""
    cause, letter, reading = signature
    reach = 1.05 * max(np.abs(cause).max(), np.abs(reading).max())
    parts = [_head(WIDE, HIGH)]
    parts.append(_axes(LEFT, letter, "y"))
    parts.append(_axes(RIGHT, "time", ""))
    parts.append(_path("read", cause / reach, reading / reach, LEFT))
    spread = 2 * TIME / TIME[-1] - 1
    parts.append(_path("grey", spread, cause / reach, RIGHT))
    parts.append(_path("read", spread, reading / reach, RIGHT))
    parts.append(_text(RIGHT[0] + 4, 14, f"grey: {letter}, blue: y", "dim small"))
    parts.append(_text(LEFT[0] + 4, 14, f"y over {letter}", "dim small"))
    return "\n".join([*parts, "</svg>", ""])


def _head(wide: int, high: int) -> str:
    """The beginning of a picture, with its colours for light and dark."""
    size = f'width="{wide}" height="{high}" viewBox="0 0 {wide} {high}"'
    page = f'<rect class="page" width="{wide}" height="{high}" rx="6"/>'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size}>\n{STYLE}\n{page}'


def _axes(place: tuple[int, int, int, int], below: str, beside: str) -> str:
    """Both zero lines of a panel, with their names."""
    x, y, wide, high = place
    lines = f"M{x} {y + high / 2:g}h{wide}M{x + (wide / 2 if beside else 0):g} {y}v{high}"
    names = _text(x + wide - 4, y + high + 14, below, "dim small", "end")
    if beside:
        names += _text(x - 12, y + 10, beside, "dim small")
    return f'<path class="axis" d="{lines}"/>{names}'


def _path(name: str, x: Floats, y: Floats, place: tuple[int, int, int, int]) -> str:
    """A line through points within -1 to 1, every third of them."""
    left, top, wide, high = place
    points = []
    for a, b in zip(x[::3], y[::3], strict=True):
        points.append(f"{left + wide * (1 + a) / 2:.1f},{top + high * (1 - b) / 2:.1f}")
    return f'<polyline class="{name}" points="{" ".join(points)}"/>'


def _text(x: float, y: float, words: str, name: str = "ink", anchor: str = "start") -> str:
    """A line of text."""
    place = f'x="{x:g}" y="{y:g}" text-anchor="{anchor}"'
    return f'<text class="{name}" {place}>{escape(words)}</text>'


QUESTIONS = (  # what is asked, in two lines; the answer to yes, in two lines
    ("Does y stick at its", "largest or least value?", "saturation", "sensor.range"),
    ("Is y silent at one value,", "and holds at no other?", "dead zone", "y leaves it from 0"),
    ("", "", "jump", "y leaves it with a leap"),
    ("Does y hold after turns,", "at whatever value it has?", "play", "holds as long at 0"),
    ("", "", "play and dead zone", "and is silent at 0 besides"),
    ("Is y right, but does it", "rest until u is large?", "actuator's dead zone",
     "rests as soon as u is small"),
    ("", "", "friction", "moves on with a smaller u"),
    ("None of these", "", "no zone", "noise, lag, an offset"),
)  # fmt: skip
ROW = 58


def decision() -> str:
    """Questions downwards, their answers to the right."""
    parts = [_head(WIDE, ROW * len(QUESTIONS) + 24)]
    last = 0
    for k, (first, second, answer, sign) in enumerate(QUESTIONS):
        y = 12 + ROW * k
        if first:
            if k:
                parts.append(_arrow(84, 12 + ROW * last + 44, 84, y, "no"))
            parts.append(f'<rect class="box" x="8" y="{y}" width="172" height="44" rx="6"/>')
            middle = 18 if second else 27
            parts.append(_text(16, y + middle, first))
            parts.append(_text(16, y + 35, second))
            last = k
        parts.append(f'<rect class="answer" x="196" y="{y}" width="158" height="44" rx="6"/>')
        parts.append(_text(204, y + 18, answer, "ink bold"))
        parts.append(_text(204, y + 35, sign, "dim small"))
        parts.append(_arrow(180 if first else 188, y + 22, 196, y + 22))
        if not first:
            parts.append(f'<path class="line" d="M188 {y - ROW + 22}V{y + 22}"/>')
    return "\n".join([*parts, "</svg>", ""])


def _arrow(x: float, y: float, to_x: float, to_y: float, word: str = "") -> str:
    """A line with a word beside it."""
    path = f'<path class="line" d="M{x:g} {y:g}L{to_x:g} {to_y:g}"/>'
    return path + (_text(x + 6, (y + to_y) / 2 + 4, word, "dim small") if word else "")


def pictures() -> dict[str, str]:
    """Every picture, by the name of its file."""
    made = {"decision.svg": decision()}
    for name, signature in signatures().items():
        made[f"{name}.svg"] = picture(signature)
    return made


def main() -> None:
    """Write the pictures."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name, text in pictures().items():
        (FOLDER / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
