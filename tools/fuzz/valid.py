"""Scenarios that should run: plant, sensor, reference, observer and controller of any kind."""

from __future__ import annotations

import random
from typing import Any, Final

from tests.undeadzone.compile.test_engines import CONTROLLERS, OBSERVERS, PENDULUM, TWO_OUTPUTS

Table = dict[str, Any]
STEPS: Final = 120  # of a run
IN_PYTHON: Final = ("moving_horizon", "particle_filter")
ONE_LINK: Final[Table] = {
    "arm": {"kind": "one_link"},
    "parameters": {"m": 1.0, "l": 0.5, "c": 0.25, "I": 0.02, "b1": 0.5, "g": 9.81},
}


def scenario(draw: random.Random, in_python: bool = True) -> Table:
    """The tables of a scenario.

    Args:
        draw: the random numbers.
        in_python: whether observers that are no graphs may be among them.
    """
    time = draw.choice(("sampled", "sampled", "continuous"))
    plant, outputs = _plant(draw)
    observer = draw.choice([name for name in OBSERVERS if _known(name, time, in_python)])
    controller = draw.choice([name for name in CONTROLLERS if time in CONTROLLERS[name][0]])
    step = draw.choice((0.01, 0.005, 0.02))
    tables: Table = {
        "plant": plant,
        "sensor": _sensor(draw, outputs, time),
        "reference": _reference(draw),
        "observer": {"method": observer} | OBSERVERS.get(observer, ((), {}))[1],
        "controller": {"method": controller} | CONTROLLERS[controller][1],
        "simulation": {"duration": STEPS * step, "step": step, "time": time},
    }
    if observer in IN_PYTHON:
        tables["observer"]["right"] = [0.1, 1.0]
    if len(plant.get("A", ())) != 1 and len(plant.get("companion", ())) != 1:
        for key in ("L", "poles"):  # of one state
            tables["observer"].pop(key, None)
    if time == "continuous" and draw.random() < 0.5:
        tables["simulation"]["switching"] = "plain"
    if draw.random() < 0.3:
        tables["disturbance"] = draw.choice(
            (
                {"kind": "random", "rms": 0.2, "correlation_time": 0.1},
                {"kind": "step", "amplitude": 0.3, "time": 0.2},
                {"kind": "sine", "amplitude": 0.2, "frequency": 2.0},
            )
        )
    if "A" in plant and draw.random() < 0.2:
        tables["model"] = {"A": [[1.05 * entry for entry in row] for row in plant["A"]]}
    return tables


def _known(observer: str, time: str, in_python: bool) -> bool:
    """Whether an observer exists in that time."""
    if observer in IN_PYTHON:
        return in_python and time == "sampled"
    return time in OBSERVERS[observer][0]


def _plant(draw: random.Random) -> tuple[Table, int]:
    """A plant, and the number of its outputs."""
    kind = draw.randrange(9)
    if kind == 0:
        table: Table = {"second_order": {"zeta": draw.uniform(0.1, 2), "omega_n": _size(draw, 1)}}
    elif kind == 1:
        table = {"companion": [_size(draw, 0.5) for _ in range(draw.choice((1, 2, 3)))]}
    elif kind == 2:
        table = {"integrators": draw.choice((1, 2))}
    elif kind == 3:
        table = {"transfer_function": {"numerator": [2.0], "denominator": [1.0, _size(draw, 1), 2]}}
    elif kind == 4:
        return dict(PENDULUM), 1
    elif kind == 5:
        return dict(TWO_OUTPUTS), 2
    elif kind == 6 and draw.random() < 0.3:
        return dict(ONE_LINK), 1
    else:
        n = draw.choice((1, 2, 2, 3, 4))
        rows = [[draw.gauss(0, 1) for _ in range(n)] for _ in range(n)]
        for i in range(n):
            rows[i][i] -= 2.5
        table = {
            "A": rows,
            "B": [[draw.gauss(0, 1)] for _ in range(n)],
            "C": [[1.0 if i == 0 else draw.gauss(0, 1) for i in range(n)]],
        }
    return table, 1


def _size(draw: random.Random, middle: float) -> float:
    """A number above 0 about a middle one."""
    return float(middle * 10 ** draw.uniform(-0.5, 0.5))


def _sensor(draw: random.Random, outputs: int, time: str) -> Table:
    """A sensor."""
    table: Table = {"right": _size(draw, 0.3), "left": _size(draw, 0.3)}
    if draw.random() < 0.2:
        table["kind"] = "jump"
        table["noise"] = 0.01
    if draw.random() < 0.5:
        table["noise"] = 0.01
    if draw.random() < 0.3:
        table["noise_before"] = 0.01
    if draw.random() < 0.2:
        table["slope"] = _size(draw, 2.0)
    if draw.random() < 0.1:
        table["drift"] = 0.01
    if draw.random() < 0.15:
        table["dropout"] = 0.1
    if time == "sampled" and draw.random() < 0.15:
        table["quantum"] = 0.02
    if outputs > 1 and draw.random() < 0.5:
        table["right"] = [table["right"], 0.2]
    return table


def _reference(draw: random.Random) -> Table:
    """A reference for all channels."""
    size = _size(draw, 1.5)
    return draw.choice(
        (
            {"kind": "sine", "amplitude": size, "frequency": 1.0},
            {"kind": "sines", "components": [{"amplitude": size, "frequency": 0.7, "phase": 1.0}]},
            {"kind": "step", "amplitude": size, "time": 0.2},
            {"kind": "trapezoid", "amplitude": size, "rise": 0.3, "hold": 0.2},
        )
    )
