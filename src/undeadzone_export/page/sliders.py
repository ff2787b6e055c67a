"""Sliders of the page: each moves the numbers that its key of the scenario moves.

A number of the loop may depend on one slider only, by a polynomial of degree two. That is found by
building the scenario with other values of the key, and checked at the scenario's own.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from undeadzone.errors import UndeadzoneError
from undeadzone.interfaces import require_graph
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.signals.exosystem import Sine, Sines, Step
from undeadzone.simulation.loop import Loop
from undeadzone.simulation.packed import changed_params, graph, pack_problem
from undeadzone.util import tree
from undeadzone.util.arrays import Floats

ROUND = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0)
TICKS = 60  # steps of a slider, about


class Slider(NamedTuple):
    """A slider of the page.

    Attributes:
        key: its name in the link.
        label: its name on the page.
        unit: of its value.
        value: the scenario's own value.
        least, most, grid: the range, and the step in it.
        moves: (entry of the loop's params, factors of the changes of the value and its square).
    """

    key: str
    label: str
    unit: str
    value: float
    least: float
    most: float
    grid: float = 0.0
    moves: list[tuple[int, float, float]] = []


def build_slider(slider: Slider, moves: list[tuple[int, float, float]]) -> Slider:
    """Return a slider over a range that moves numbers, with steps of a round size."""
    grid = round_up_nicely((slider.most - slider.least) / TICKS, (1.0, 2.0, 5.0))
    most = max(slider.most, slider.value)
    least = min(slider.least, slider.value)
    return slider._replace(least=least, most=most, grid=grid, moves=moves)


def round_up_nicely(value: float, factors: tuple[float, ...] = ROUND) -> float:
    """Return the nearest round number that is not smaller: a factor times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    factor = next(one for one in (*factors, 10.0) if one * power >= value * (1 - 1e-9))
    return float(f"{factor * power:.12g}")


RESOLVED = 40  # steps of the run in a period, at least
EXACT = 1e-9  # relative error of the polynomial at a further value
HALVINGS = 4  # of a slider's range, if its end is refused

Change = Callable[[float], Scenario]  # value of a key -> the scenario with that value
Moves = list[tuple[int, float, float]]  # as of `Slider`


def build_sliders(problem: Problem, loop: Loop, sizes: Floats) -> list[Slider]:
    """Return the sliders of a scenario.

    Args:
        problem: the checked parts of the scenario.
        loop: its closed loop.
        sizes: largest |z| of the reference (p) [z].
    """
    scenario = problem.scenario
    sliders = _breakpoint_sliders(problem, loop, sizes)
    sliders += _reference_sliders(problem, loop)
    sliders += _adaptation_sliders(problem, loop)
    if np.ptp(problem.sensor.noise) == 0:
        noise = float(problem.sensor.noise[0])
        most = round_up_nicely(max(4 * noise, 0.05 * float(sizes.max())))
        slider = Slider("noise", "noise of the reading", _unit_label(scenario), noise, 0.0, most)
        noisy = functools.partial(scenario.replace, "sensor.noise")
        sliders += _key_sliders(problem, loop, slider, noisy)
    sliders += _mismatch_sliders(problem, loop)
    return _drop_overlapping(sliders)


def _unit_label(scenario: Scenario) -> str:
    """Return the unit of the outputs as the page shows it."""
    return "" if scenario.units.output == "1" else scenario.units.output


def _breakpoint_sliders(problem: Problem, loop: Loop, sizes: Floats) -> list[Slider]:
    """Return a slider for each breakpoint of each output."""
    sliders = []
    limit = problem.observer.traits.width_max
    sensor = problem.sensor
    for output in range(problem.plant.p):
        for k, side in enumerate(("right", "left")):
            if sensor.absent[k, output]:
                continue
            number = str(output + 1) if problem.plant.p > 1 else ""
            of = f" of output {number}" if number else ""
            width = float(getattr(sensor, side)[output])
            most = round_up_nicely(float(max(2 * sensor.widest[output], sizes[output] / 2)))
            if limit is not None:
                most = min(most, float(limit[output]))
            place = _param_index(loop, f"sensor.{side}[{output}]")
            slider = Slider(
                side + number, f"{side} edge{of}", _unit_label(problem.scenario), width, 0.0, most
            )
            sliders.append(build_slider(slider, [(place, 1.0, 0.0)]))
    return sliders


def _reference_sliders(problem: Problem, loop: Loop) -> list[Slider]:
    """Return the sliders for the size and the speed of the reference."""
    if problem.model.nonlinear:  # its target does not scale
        return []
    signal = problem.scenario.reference
    unit = _unit_label(problem.scenario)
    size, size_unit = speed, speed_unit = 1.0, "×"
    if isinstance(signal, Sine):
        speed, speed_unit = signal.frequency, "Hz"
        if np.size(signal.amplitude) == 1 and not np.any(signal.offset):
            size, size_unit = abs(float(np.ravel(signal.amplitude)[0])), unit
    place = _param_index(loop, "scale.reference")
    slider = Slider("size", "size of the motion", size_unit, size, 0.0, round_up_nicely(2 * size))
    sliders = [build_slider(slider, [(place, 1.0 / size, 0.0)])] if size > 0 else []
    if isinstance(signal, Step) or problem.model.m != len(problem.tracked):
        return sliders
    fastest = speed * _fastest_factor(problem)
    least = speed / 4
    most = min(round_up_nicely(2.5 * speed), fastest)
    slider = Slider("speed", "speed of the motion", speed_unit, speed, least, most)
    return [*sliders, build_slider(slider, [])] if most > speed else sliders


def _fastest_factor(problem: Problem) -> float:
    """Return the factor by which the reference may become faster and stay resolved."""
    signal = problem.scenario.reference
    step = problem.scenario.simulation.step
    if isinstance(signal, Sine | Sines):
        tones = signal.components if isinstance(signal, Sines) else [signal]
        return 1 / (RESOLVED * step * max(tone.frequency for tone in tones))
    period = problem.reference.period
    return 1.0 if period is None else period / (4 * RESOLVED * step)


def _adaptation_sliders(problem: Problem, loop: Loop) -> list[Slider]:
    """Return the slider of the observer's adaptation gain, or none without a numeric gain."""
    options: Any = problem.scenario.observer
    traits = problem.observer.traits
    gamma = getattr(options, "gamma", None)
    if gamma is None and hasattr(options, "gamma") and traits.gamma is not None:
        gamma = traits.gamma / (problem.model.Ts or 1.0)
    if gamma is None or not np.any(gamma) or getattr(options, "design", None) is not None:
        return []
    base = np.asarray(gamma, float)
    own, unit = (float(base.flat[0]), "1/s") if np.ptp(base) == 0 else (1.0, "×")

    def change(value: float) -> Scenario:
        """Return the scenario with another adaptation gain."""
        return problem.scenario.replace("observer.gamma", base * (value / own))

    slider = Slider("gamma", "learning gain", unit, own, 0.0, round_up_nicely(4 * own))
    return _key_sliders(problem, loop, slider, change)


def _mismatch_sliders(problem: Problem, loop: Loop) -> list[Slider]:
    """Return the slider that makes the plant's input act more strongly than in the model."""
    values = zip(tree.number_addresses(loop.params), tree.pack_tree(loop.params), strict=True)
    moves = [
        (place, float(value) / 100, 0.0)
        for place, (name, value) in enumerate(values)
        if name.startswith("plant.B[") and value
    ]
    slider = Slider("drive", "drive stronger than modelled", "%", 0.0, -30.0, 30.0)
    return [build_slider(slider, moves)] if moves else []


def _key_sliders(problem: Problem, loop: Loop, slider: Slider, change: Change) -> list[Slider]:
    """Return the slider of a key over the range in which the scenario is accepted, or none.

    Args:
        problem: the checked parts of the scenario.
        loop: its closed loop.
        slider: the slider with its widest range.
        change: gives the scenario with a value of the key.
    """
    for least in (slider.least, slider.most / TICKS):  # 0 may be another kind of scenario
        accepted = _narrow_range(slider._replace(least=least), change)
        moves = _fit_moves(problem, loop, accepted, change)
        if moves is not None:
            return [build_slider(accepted, moves)]
    return []


def _narrow_range(slider: Slider, change: Change) -> Slider:
    """Return the range with its upper end lowered until the scenario is accepted."""
    for _ in range(HALVINGS):
        if _try_value(change, slider.most) is not None:
            break
        slider = slider._replace(most=(slider.most + slider.value) / 2)
    return slider


def _try_value(change: Change, value: float) -> Problem | None:
    """Return the problem with another value of a key, or None if refused or without a graph."""
    try:
        problem = resolve_scenario(change(value))
        require_graph(problem.observer)
    except UndeadzoneError:
        return None
    return problem


def _fit_moves(problem: Problem, loop: Loop, slider: Slider, change: Change) -> Moves | None:
    """Return the changes of the loop's numbers with a key within a range.

    Return None if the key does more than move numbers by polynomials of degree two.
    """
    between = 0.37 * slider.least + 0.63 * slider.most
    points = np.array([slider.least, slider.most, between])
    possible = [_try_value(change, float(value)) for value in points]
    others = [other for other in possible if other and graph(other) == graph(problem)]
    if len(others) < len(points) or slider.most <= slider.value:
        return None
    known = np.stack([pack_problem(other, loop)[1] for other in others])
    places = changed_params(loop, known)
    size = np.abs(known[:, places]).max(axis=0)
    factors = np.linalg.solve(np.vander(points, 3, increasing=True), known[:, places])
    error = slider.value ** np.arange(3) @ factors - tree.pack_tree(loop.params)[places]
    if (np.abs(error) > EXACT * size).any():
        return None
    _, slopes, squares = factors
    squares[np.abs(squares) * points.max() ** 2 < 1e-12 * size] = 0.0
    return list(zip(places.tolist(), slopes.tolist(), squares.tolist(), strict=True))


def _param_index(loop: Loop, name: str) -> int:
    """Return the index of a number in the loop's packed params."""
    return tree.number_addresses(loop.params).index(name)


def _drop_overlapping(sliders: list[Slider]) -> list[Slider]:
    """Return the sliders without those that move a number of an earlier slider.

    Their effects would not add up.
    """
    covered: set[int] = set()
    independent = []
    for slider in sliders:
        places = {place for place, _, _ in slider.moves}
        if not places & covered:
            independent.append(slider)
            covered |= places
    return independent
