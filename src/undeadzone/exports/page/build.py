"""A scenario's loop as one HTML file: WebAssembly, the numbers, and what draws them."""

from __future__ import annotations

import base64
import hashlib
import itertools
import json
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import undeadzone
from undeadzone.compile import print_wasm
from undeadzone.compile.graph import Results, needed
from undeadzone.compile.lower import portable
from undeadzone.errors import InputError
from undeadzone.exports.code import operations
from undeadzone.exports.page import signals, sliders
from undeadzone.exports.template import filled, text_of
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation import exogenous
from undeadzone.simulation.loop import RUNGE_KUTTA, Loop
from undeadzone.simulation.simulate import closed
from undeadzone.support import tree
from undeadzone.support.arrays import Floats
from undeadzone.support.files import write_text
from undeadzone.support.own_files import REMARK, require_own, signed
from undeadzone.support.text import printable

_LARGEST = np.finfo(float).max  # in place of infinity, which JSON has not
MOST = 100_000_000  # operations of a run
RECORDED = {
    "z": "z",
    "y": "y",
    "side": "side",
    "z_hat": "estimate.z",
    "right": "estimate.right",
    "left": "estimate.left",
    "right_std": "estimate.right_std",
    "left_std": "estimate.left_std",
}
_TOLD = (
    "The observer gets the red reading and the input that drives the motion. From these it learns "
    "both edges of the band, and the truth behind it."
)
LEADS = {
    "deadzone": "Inside the yellow band this sensor reads 0; outside, it reads too little, by "
    f"the width of the band. Valves and load cells do this. {_TOLD}",
    "jump": "Inside the yellow band this sensor reads 0; outside, it tells the truth. Speed "
    f"sensors do this. {_TOLD}",
}


class Page(NamedTuple):
    """A page and what it costs.

    Attributes:
        text: the HTML.
        report: its name, sizes [bytes], operations of a step, hash.
    """

    text: str
    report: dict[str, Any]


def write_page(scenario: Scenario, out: Path, force: bool = False) -> dict[str, Any]:
    """Write the page of a scenario.

    Args:
        scenario: a linear scenario, sampled or continuous.
        out: the HTML file; an earlier page there is replaced.
        force: whether any file there is.

    Returns:
        What the page costs.

    Raises:
        InputError: a scenario that the page cannot show.
        FileError: the file is something else, or cannot be written.
    """
    require_own(out, force)
    page = build(scenario)
    write_text(page.text, out)
    return page.report


def build(scenario: Scenario) -> Page:
    """The page of a scenario; the same scenario gives the same bytes.

    Args:
        scenario: a linear scenario, sampled or continuous.

    Raises:
        InputError: a scenario that the page cannot show.
    """
    problem = resolve_scenario(scenario)
    _require_shown(problem)
    loop = closed(problem)
    _require_quick(problem, len(needed(itertools.chain(*_results(loop)))))
    code, memory = _code(loop)
    data = _data(problem, loop, memory)
    data["wasm"] = base64.b64encode(code).decode()
    text = signed(framed(scenario.title, data | {"remark": REMARK}))
    report = {
        "title": scenario.title,
        "version": undeadzone.__version__,
        "hash": hashlib.sha256(text.encode()).hexdigest()[:16],
        "steps": data["rows"],
        "sizes": {"wasm": len(code), "page": len(text.encode())},
        "operations": operations(_results(loop)),
        "sliders": [slider["key"] for slider in data["sliders"]],
        "refusals": [],
    }
    return Page(text, report)


def _require_shown(problem: Problem) -> None:
    """Raise InputError for what the page does not compute."""
    scenario, sensor = problem.scenario, problem.sensor
    if problem.controller.plan is not None:
        raise InputError(
            "controller.method: this one computes its gains ahead of a run, which the page does "
            "not; use state_feedback"
        )
    if scenario.simulation.order > RUNGE_KUTTA:
        raise InputError(
            f"simulation.order: the page takes RK4 steps, found {scenario.simulation.order}; "
            "leave the key out"
        )
    if sensor.moves:
        key = "sensor.kind" if sensor.play is None else "sensor.play"
        raise InputError(
            f"{key}: the page draws a band in which the sensor reads 0; a play has none"
        )
    for key in ("drift", "dropout"):
        if getattr(sensor, key).any():
            raise InputError(f"sensor.{key}: the page's sensor has none; leave the key out")


def _require_quick(problem: Problem, size: int) -> None:
    """Raise InputError where a run takes so long that the sliders would not follow."""
    count = problem.steps * size
    if count > MOST:
        raise InputError(
            f"simulation.duration: the page computes the whole run at each move of a slider, and "
            f"{problem.steps:,} steps of {size:,} operations take too long; take a shorter "
            f"duration or a longer step, {MOST // size:,} steps at most"
        )


def _results(loop: Loop) -> Results:
    """What a step computes as a rule."""
    return portable(loop.step if loop.parts is None else loop.parts.usual, print_wasm.KIND)


def _code(loop: Loop) -> tuple[bytes, dict[str, int]]:
    """(the module, where each part of its memory begins, counted in numbers)."""
    step = loop.step
    sizes = {
        "s": step.size1_in(0),
        "w": step.size1_in(1),
        "p": step.size1_in(2),
        "n": step.size1_in(0),
        "o": step.size1_out(1),
        "flag": 1,
    }
    places = dict(zip(sizes, np.cumsum([0, *sizes.values()]).tolist(), strict=False))
    inputs = {}
    for part in "swp":
        for k in range(sizes[part]):
            inputs[f"{part}{k}"] = print_wasm.REAL * (places[part] + k)
    functions: list[tuple[str, Any, tuple[str, ...]]] = [("step", loop.step, ("n", "o"))]
    if loop.parts is not None:
        functions = [
            ("step", loop.parts.usual, ("n", "o", "flag")),
            ("rare", loop.parts.rare[-1], ("n", "flag")),
        ]
    printed = []
    for name, function, results in functions:
        nodes = portable(function, print_wasm.KIND)
        targets = [_addresses(places[part], sizes[part]) for part in results]
        printed.append(print_wasm.Function(name, nodes, inputs, targets))
    return print_wasm.module(printed, print_wasm.REAL * sum(sizes.values())), places


def _addresses(start: int, size: int) -> list[int]:
    """Where the numbers of a part stand [bytes]."""
    return [print_wasm.REAL * (start + k) for k in range(size)]


def _data(problem: Problem, loop: Loop, memory: dict[str, int]) -> dict[str, Any]:
    """What the page knows beside the code."""
    scenario, model = problem.scenario, problem.model
    A, B, C = model.linear
    if model.Ts is not None:  # as `feedforward.targets.steady_state` has it: per second
        A, B = (A - np.eye(model.n)) / model.Ts, B / model.Ts
    outputs, recorded = dict(tree.leaves(tree.slices(loop.outputs))), {}
    for name, address in RECORDED.items():
        place = outputs[address]
        if place.stop > place.start:
            recorded[name] = place.start
    instant = tree.slices(loop.instant)
    made = sliders.sliders(problem, loop, _sizes(problem))
    return {
        "kind": problem.sensor.kind,
        "lead": LEADS[problem.sensor.kind],
        "note": _note(problem),
        "quantity": _quantity(scenario.units.output),
        "unit": printable(scenario.units.output),
        "rows": problem.steps + 1,
        "step": scenario.simulation.step,
        "sampled": model.Ts is not None,
        "outputs": problem.plant.p,
        "tracked": len(problem.tracked),
        "slope": problem.sensor.slope.tolist(),
        "period": signals.period(problem),
        "model": {"A": A.tolist(), "B": B.tolist(), "C": C[problem.tracked].tolist()},
        "memory": memory,
        "rare": loop.parts is not None,
        "recorded": recorded,
        "instant": {
            "size": tree.size(loop.instant),
            "w": instant.w.start,
            "before": instant.before.start,
            "after": instant.after.start,
        },
        "start": tree.pack(loop.state._replace(plant=problem.x0)).tolist(),
        "params": np.clip(tree.pack(loop.params), -_LARGEST, _LARGEST).tolist(),
        "reference": signals.reference(problem),
        "disturbance": signals.disturbance(problem),
        "sliders": [slider._asdict() for slider in made],
        "learns": any(slider.key == "gamma" for slider in made),
    }


def _sizes(problem: Problem) -> Floats:
    """The largest |z| that the reference asks for, or four widths where it says nothing (p)."""
    rows = exogenous.exogenous(problem, run=None)
    q, n = len(problem.tracked), problem.model.n
    largest = np.zeros(problem.plant.p)
    if not problem.model.nonlinear:
        largest = np.abs(rows[:, q : q + n] @ problem.model.linear.C.T).max(axis=0)
    largest[problem.tracked] = np.abs(rows[:, :q]).max(axis=0)
    widest = np.maximum(problem.sensor.right, problem.sensor.left)
    return np.where(largest > 0, largest, np.where(widest > 0, 4 * widest, 1.0))


def _quantity(unit: str) -> str:
    """What the axis of the motion shows."""
    return "the motion" if unit == "1" else f"the motion [{printable(unit)}]"


def _note(problem: Problem) -> str:
    """What the observer knows, so that nobody takes the page for more than it shows."""
    method = type(problem.scenario.observer).__struct_config__.tag
    known = "the plant exactly" if problem.scenario.model is None else "a model of the plant"
    text = (
        f"The observer ({method}) knows {known} and the input that moves it, but not the band and "
        "not where the motion starts. "
    )
    if not problem.plant.nonlinear:
        text += "A real plant differs from its model: the last slider shows what that costs. "
    return text + "Errors are rms over the second half of the run."


# --- The HTML around the data: its own script and style, and a policy that allows nothing else


def framed(title: str, data: dict[str, Any]) -> str:
    """The page.

    Args:
        title: its title.
        data: what its script reads.
    """
    style, script = text_of("page/page.css"), text_of("page/page.js")
    policy = (
        f"default-src 'none'; script-src {_digest(script)} 'wasm-unsafe-eval'; "
        f"style-src {_digest(style)}; img-src data:; base-uri 'none'; form-action 'none'"
    )
    content = json.dumps(data, separators=(",", ":"), allow_nan=False)
    words = {
        "policy": policy,
        "title": escape(printable(title)),
        "style": style,
        "script": script,
        "data": content.replace("<", "\\u003c"),
    }
    return filled("page/page.html", words)


def _digest(text: str) -> str:
    """The hash by which the page's policy allows a text, and no other."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
