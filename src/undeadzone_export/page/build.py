"""A scenario's closed loop as one HTML file: WebAssembly, its numbers, and the script that
draws.
"""

from __future__ import annotations

import base64
import hashlib
import json
import tomllib
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import undeadzone
from undeadzone.compile import print_wasm
from undeadzone.compile.graph import Results
from undeadzone.compile.lower import build_portable_nodes
from undeadzone.compile.repeats import Part, outline_parts, outline_repeats
from undeadzone.errors import InputError
from undeadzone.feedforward.targets import steady_state
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.signals.exosystem import Exosystem, Sine, Sines, Step, Trapezoid
from undeadzone.simulation import exogenous
from undeadzone.simulation.exogenous import targets
from undeadzone.simulation.loop import RUNGE_KUTTA, Loop
from undeadzone.simulation.simulate import close_problem
from undeadzone.util import tree
from undeadzone.util.arrays import Floats
from undeadzone.util.files import write_text
from undeadzone.util.own_files import REMARK, require_own_file, sign_text
from undeadzone.util.text import escape_controls
from undeadzone_export.code import count_operations
from undeadzone_export.exported_step import name_entries
from undeadzone_export.page import sliders
from undeadzone_export.template import fill_template, read_template

SAMPLES = 512  # of a period, for a Fourier series
NEGLIGIBLE = 1e-16  # share of a harmonic in the signal below which it is left out
SERIES = 1e-10  # largest error of the series, relative to the signal's size


def reference_data(problem: Problem) -> dict[str, Any]:
    """Return the target (r, x_ref, u_ff) along the run, as data for the page's script.

    Args:
        problem: the checked parts of a scenario.

    Raises:
        InputError: a kind of signal that the page does not draw.
        TrackingError: the plant cannot follow the reference.
    """
    if problem.model.nonlinear:
        return _fourier_data(problem)
    signal, exo = problem.scenario.reference, problem.reference
    Pi, Gamma = steady_state(problem.model, exo, problem.tracked)
    return _signal_data("reference", signal, exo, np.vstack([exo.Q, Pi, Gamma]))


def reference_period(problem: Problem) -> float | None:
    """Return the period of the reference [s], or None if it has none."""
    return problem.reference.period if problem.path is None else problem.path.period


def _fourier_data(problem: Problem) -> dict[str, Any]:
    """Return a periodic target as a Fourier series.

    Check the series between the samples that it was computed from.
    """
    length = reference_period(problem)
    if length is None:
        raise InputError(
            "reference: of a nonlinear plant the page draws periodic references only. Take a sine, "
            "or a circle or figure eight of an arm"
        )
    t = np.arange(SAMPLES) * length / SAMPLES
    rows = np.hstack(targets(problem, t))
    spectrum = np.fft.rfft(rows, axis=0)[: SAMPLES // 4] / SAMPLES
    size = np.abs(rows).max()
    used = np.flatnonzero(np.abs(spectrum).max(axis=1) > NEGLIGIBLE * size)
    waves = used[used > 0]
    pairs = np.stack([-2 * spectrum[waves].imag, 2 * spectrum[waves].real], axis=1)
    gains = np.vstack([pairs.reshape(2 * waves.size, rows.shape[1]), spectrum[:1].real]).T
    omegas = 2 * np.pi * waves / length
    between = t + 0.5 * length / SAMPLES
    turning = np.exp(1j * np.outer(between, omegas)) @ spectrum[waves]
    series = 2 * turning.real + spectrum[0].real
    if np.abs(series - np.hstack(targets(problem, between))).max() > SERIES * size:
        raise InputError(
            "reference: the state that belongs to it has corners, which the page does not draw "
            "for a nonlinear plant. Take a smooth reference"
        )
    return {"gains": gains.tolist(), "omegas": omegas.tolist(), "offset": True}


def disturbance_data(problem: Problem) -> dict[str, Any] | None:
    """Return the disturbance along the run as data for the page's script, or None.

    Args:
        problem: the checked parts of a scenario.

    Raises:
        InputError: a kind of signal that the page does not draw.
    """
    signal, exo = problem.scenario.disturbance, problem.disturbance
    if signal is None:
        return None
    if exo is None:
        knots = exogenous.knots_of(problem, run=0)
        return {"knots": base64.b64encode(knots.tobytes()).decode(), "channels": knots.shape[1]}
    return _signal_data("disturbance", signal, exo, exo.Q)


def _signal_data(key: str, signal: Any, exo: Exosystem, gains: Floats) -> dict[str, Any]:
    """Return a signal's data: the state of its exosystem and the gains from that state."""
    data: dict[str, Any] = {"gains": gains.tolist()}
    if isinstance(signal, Sine | Sines):
        count = exo.S.shape[0] // 2
        waves = 2 * np.arange(count)
        omegas = exo.S[waves, waves + 1].tolist()
        return data | {"omegas": omegas, "offset": exo.S.shape[0] % 2 == 1}
    if not isinstance(signal, Step | Trapezoid):
        kind = type(signal).__struct_config__.tag
        raise InputError(
            f"{key}.kind: the page draws sine, sines, step and trapezoid, found {kind!r}"
        )
    starts = _piece_starts(exo)
    return data | {
        "starts": starts.tolist(),
        "values": exo.state(starts).tolist(),
        "order": exo.S.shape[0] // exo.Q.shape[0],
        "period": exo.period,
    }


def _piece_starts(exo: Exosystem) -> Floats:
    """Return the times at which the pieces of a signal begin [s], the first at 0."""
    corners = exo.corners if exo.period is None else exo.corners[:-1]
    later = corners[corners > 0]
    return np.concatenate([[0.0], later])


_LARGEST = np.finfo(float).max  # in place of infinity, which JSON has not
MOST = 100_000_000  # operations of a run
_ESTIMATED = ("right", "left", "right_std", "left_std", "width_std")
RECORDED = {
    **{name: name for name in ("z", "y", "side")},
    "z_hat": "estimate.z",
    **{name: f"estimate.{name}" for name in _ESTIMATED},
}


class LivePage(NamedTuple):
    """HTML page with a report on its size and cost.

    Attributes:
        text: the HTML.
        report: its name, sizes [bytes], operations of a step, hash.
    """

    text: str
    report: dict[str, Any]


def write_live_page(scenario: Scenario, out: Path, force: bool = False) -> dict[str, Any]:
    """Write the page of a scenario and return its report.

    Args:
        scenario: a linear scenario, sampled or continuous.
        out: the HTML file. An earlier page there is replaced.
        force: whether any file there is.

    Returns:
        Size and cost of the page.

    Raises:
        InputError: a scenario that the page cannot show.
        FileError: the file is something else, or cannot be written.
    """
    require_own_file(out, force)
    page = build_live_page(scenario)
    write_text(page.text, out)
    return page.report


def build_live_page(scenario: Scenario) -> LivePage:
    """Build the page of a scenario. The same scenario gives the same bytes.

    Args:
        scenario: a linear scenario, sampled or continuous.

    Raises:
        InputError: a scenario that the page cannot show.
    """
    problem = resolve_scenario(scenario)
    _require_drawable(problem)
    loop = close_problem(problem)
    steps, parts = _lower_steps(loop)
    operations = count_operations(steps["step"], parts)
    _require_quick_run(problem, sum(operations.values()))
    code, memory = _wasm_module(loop, steps, parts)
    data = _page_data(problem, loop, memory)
    data["wasm"] = base64.b64encode(code).decode()
    text = sign_text(render_page(scenario.title, data | {"remark": REMARK}))
    report = {
        "title": scenario.title,
        "version": undeadzone.__version__,
        "hash": hashlib.sha256(text.encode()).hexdigest()[:16],
        "steps": data["rows"],
        "sizes": {"wasm": len(code), "page": len(text.encode())},
        "operations": operations,
        "sliders": [slider["key"] for slider in data["sliders"]],
        "refusals": [],
    }
    return LivePage(text, report)


def _require_drawable(problem: Problem) -> None:
    """Raise InputError if the scenario contains a feature that the page does not compute."""
    sensor, order = problem.sensor, problem.scenario.simulation.order
    refusals = {
        "plant.arm.gears: the page draws a band in which a sensor reads 0. Encoders have none": (
            problem.plant.gears is not None
        ),
        "controller.method: this one computes its gains ahead of a run, which the page does not. "
        "Use state_feedback": problem.controller.plan is not None,
        f"simulation.order: the page takes RK4 steps, found {order}. Leave the key out": (
            order > RUNGE_KUTTA
        ),
        "sensor.play: the page draws one band, a dead zone's or a play's, not both. Leave one of "
        "them out": sensor.play is not None,
        "sensor.drift: the page's sensor has none. Leave the key out": sensor.drift.any(),
        "sensor.dropout: the page's sensor has none. Leave the key out": sensor.dropout.any(),
    }
    for words, is_refused in refusals.items():
        if is_refused:
            raise InputError(words)


def _require_quick_run(problem: Problem, size: int) -> None:
    """Raise InputError if a run takes too long to follow the sliders."""
    count = problem.steps * size
    if count > MOST:
        raise InputError(
            f"simulation.duration: the page computes the whole run at each move of a slider, and "
            f"{problem.steps:,} steps of {size:,} operations take too long. Take a shorter "
            f"duration or a longer step, {MOST // size:,} steps at most"
        )


def _lower_steps(loop: Loop) -> tuple[dict[str, Results], list[Part]]:
    """Return the instructions of the module's functions by name, and of the functions they call.

    A loop with a cold path has it as the function "rare".
    """
    functions = {"step": loop.step}
    if loop.parts is not None:
        functions = {"step": loop.parts.usual, "rare": loop.parts.rare[-1]}
    parts = list[Part]()
    return {
        name: build_portable_nodes(function, print_wasm.KIND, parts)
        for name, function in functions.items()
    }, parts


def _wasm_module(
    loop: Loop, steps: dict[str, Results], parts: list[Part]
) -> tuple[bytes, dict[str, int]]:
    """Return the WebAssembly module and the start of each part of its memory (in numbers)."""
    step = loop.step
    each = [*map(step.size1_in, range(3)), *map(step.size1_out, range(2))]
    sizes = dict(zip("swpno", each, strict=True)) | {"flag": 1}
    places = dict(zip(sizes, np.cumsum([0, *sizes.values()]).tolist(), strict=False))
    inputs = name_entries(**{part: _byte_addresses(places[part], sizes[part]) for part in "swp"})
    stored = {"step": "no", "rare": "n"}
    repeats, printed = outline_parts(parts), []
    for name, results in steps.items():
        nodes = outline_repeats(results, repeats)
        ends = [*stored[name], "flag"][: len(nodes)]
        targets = [_byte_addresses(places[end], sizes[end]) for end in ends]
        printed.append(print_wasm.Function(name, nodes, inputs, targets))
    size = print_wasm.REAL * sum(sizes.values())
    return print_wasm.build_module(printed, size, repeats), places


def _byte_addresses(start: int, size: int) -> list[int]:
    """Return the addresses of the numbers of a part of the memory [bytes]."""
    return [print_wasm.REAL * (start + k) for k in range(size)]


def _page_data(problem: Problem, loop: Loop, memory: dict[str, int]) -> dict[str, Any]:
    """Return all data of the page except the code."""
    scenario, model = problem.scenario, problem.model
    A, B, C = model.linear
    if model.Ts is not None:  # as `feedforward.targets.steady_state` has it: per second
        A, B = (A - np.eye(model.n)) / model.Ts, B / model.Ts
    outputs, recorded = dict(tree.iterate_leaves(tree.leaf_slices(loop.outputs))), {}
    for name, address in RECORDED.items():
        place = outputs[address]
        if place.stop > place.start:
            recorded[name] = place.start
    kind, texts = problem.sensor.kind, tomllib.loads(read_template("page/words.toml"))
    lead = texts["lead"][kind]
    if problem.sensor.limits is not None:
        lead = f"{lead} {texts['lead']['range']}"
    instant = tree.leaf_slices(loop.instant)
    controls = sliders.build_sliders(problem, loop, _output_sizes(problem))
    return {
        "kind": kind,
        "lead": lead,
        "words": texts["gap" if kind == "play" else "zone"],
        "note": _prior_information_note(problem),
        "quantity": _motion_label(problem),
        "unit": escape_controls(scenario.units.output),
        "rows": problem.steps + 1,
        "step": scenario.simulation.step,
        "sampled": model.Ts is not None,
        "outputs": problem.plant.p,
        "tracked": len(problem.tracked),
        "slope": problem.sensor.slope.tolist(),
        "period": reference_period(problem),
        "model": {"A": A.tolist(), "B": B.tolist(), "C": C[problem.tracked].tolist()},
        "memory": memory,
        "rare": loop.parts is not None,
        "recorded": recorded,
        "instant": {
            "size": tree.count_numbers(loop.instant),
            "w": instant.w.start,
            "before": instant.before.start,
            "after": instant.after.start,
        },
        "start": tree.pack_tree(loop.state._replace(plant=problem.x0)).tolist(),
        "params": np.clip(tree.pack_tree(loop.params), -_LARGEST, _LARGEST).tolist(),
        "reference": reference_data(problem),
        "disturbance": disturbance_data(problem),
        "sliders": [slider._asdict() for slider in controls],
        "learns": any(slider.key == "gamma" for slider in controls),
    }


def _output_sizes(problem: Problem) -> Floats:
    """Return the largest |z| of the reference, or 4 widths if that is unknown (p) [z]."""
    rows = exogenous.exogenous(problem, run=None)
    q, n = len(problem.tracked), problem.model.n
    largest = np.zeros(problem.plant.p)
    if not problem.model.nonlinear:
        largest = np.abs(rows[:, q : q + n] @ problem.model.linear.C.T).max(axis=0)
    largest[problem.tracked] = np.abs(rows[:, :q]).max(axis=0)
    widest = problem.sensor.widest
    return np.where(largest > 0, largest, np.where(widest > 0, 4 * widest, 1.0))


def _motion_label(problem: Problem) -> str:
    """Return the label of the axis that shows the motion."""
    unit = problem.scenario.units.output
    point = " from its operating point" * (problem.levels is not None)
    return f"the motion{point}" + f" [{escape_controls(unit)}]" * (unit != "1")


def _prior_information_note(problem: Problem) -> str:
    """Return a note on the prior information of the observer.

    Readers might overrate the page without this note.
    """
    method = type(problem.scenario.observer).__struct_config__.tag
    known = "the plant exactly" if problem.scenario.model is None else "a model of the plant"
    text = (
        f"The observer ({method}) knows {known} and the input that moves it, but neither the "
        "band nor the start of the motion. "
    )
    if not problem.plant.nonlinear:
        text += "A real plant differs from its model: the last slider shows what that costs. "
    return text + "Errors are rms over the second half of the run."


# --- The HTML around the data: its own script and style, and a policy that allows nothing else


def render_page(title: str, data: dict[str, Any]) -> str:
    """Return the HTML of the page.

    Args:
        title: its title.
        data: what its script reads.
    """
    style, script = read_template("page/page.css"), read_template("page/page.js")
    policy = (
        f"default-src 'none'; script-src {_policy_hash(script)} 'wasm-unsafe-eval'; "
        f"style-src {_policy_hash(style)}; img-src data:; base-uri 'none'; form-action 'none'"
    )
    content = json.dumps(data, separators=(",", ":"), allow_nan=False)
    words = {
        "policy": policy,
        "title": escape(escape_controls(title)),
        "style": style,
        "script": script,
        "headline": data["words"]["headline"],
        "legend": data["words"]["legend"],
        "data": content.replace("<", "\\u003c"),
    }
    return fill_template("page/page.html", words)


def _policy_hash(text: str) -> str:
    """Return the hash that allows a text in the page's content policy."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
