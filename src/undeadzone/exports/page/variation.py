"""Which numbers of the loop a key of the scenario moves, found by building it with other values."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from undeadzone.errors import UndeadzoneError
from undeadzone.exports.page.slider import TICKS, Range, Slider, slider_of
from undeadzone.interfaces import graph_of
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.close import close, numbers
from undeadzone.simulation.loop import Loop
from undeadzone.support import tree
from undeadzone.support.arrays import Floats

EXACT = 1e-9  # relative error of the polynomial at a further value
HALVINGS = 4  # of a slider's range, where its end is refused

Change = Callable[[Scenario, float], Scenario]


def varied(problem: Problem, loop: Loop, wanted: Range, change: Change) -> list[Slider]:
    """The slider of a key, its range cut to where the scenario is accepted; none if it fits none.

    Args:
        problem: the checked parts of the scenario.
        loop: its closed loop.
        wanted: what the slider may take.
        change: (scenario, value) -> the scenario with that value.
    """
    for least in (wanted.least, wanted.most / TICKS):  # 0 may be another kind of scenario
        made = _fitted(
            problem, loop, _accepted(problem, wanted._replace(least=least), change), change
        )
        if made is not None:
            return [made]
    return []


def _accepted(problem: Problem, wanted: Range, change: Change) -> Range:
    """The range with its upper end brought down to where the scenario is accepted."""
    for _ in range(HALVINGS):
        if _numbers(problem, change, wanted.most) is not None:
            break
        wanted = wanted._replace(most=(wanted.most + wanted.value) / 2)
    return wanted


def _fitted(problem: Problem, loop: Loop, wanted: Range, change: Change) -> Slider | None:
    """The slider of a range; None where its key does more than move numbers by polynomials."""
    between = 0.37 * wanted.least + 0.63 * wanted.most
    points = [wanted.least, wanted.most, between]
    known = [_numbers(problem, change, value) for value in points]
    if any(each is None for each in known) or wanted.most <= wanted.value:
        return None
    moves = _polynomials(np.array(points), np.array(known), wanted.value, tree.pack(loop.params))
    if moves is None or not _same_graph(problem, change, points[:2]):
        return None
    return slider_of(wanted, moves)


def _numbers(problem: Problem, change: Change, value: float) -> Floats | None:
    """The numbers of the loop with another value of a key; None where it is refused."""
    try:
        other = resolve_scenario(change(problem.scenario, value))
        observer = graph_of(other.observer)
    except UndeadzoneError:
        return None
    step = other.scenario.simulation.step
    parts = (other.plant, other.sensor, observer, other.controller, step)
    return tree.pack(numbers(*parts, other.compensator, other.actuator))


def _same_graph(problem: Problem, change: Change, values: list[float]) -> bool:
    """Whether the loop's graph is the same with other values of a key."""
    same = _graph(problem)
    return all(_graph(resolve_scenario(change(problem.scenario, each))) == same for each in values)


def _graph(problem: Problem) -> str:
    """The loop's graph as text; without located switching, which says nothing more of its parts."""
    observer, step = graph_of(problem.observer), problem.scenario.simulation.step
    tracked = len(problem.tracked)
    loop = close(
        problem.plant,
        problem.sensor,
        observer,
        problem.controller,
        tracked,
        step,
        located=False,
        compensator=problem.compensator,
        actuator=problem.actuator,
    )
    return str(loop.step.serialize())


def _polynomials(
    points: Floats, known: Floats, value: float, own: Floats
) -> list[tuple[int, float, float]] | None:
    """How each number changes with the value; None where it is no polynomial of degree two.

    Args:
        points: three values of the slider.
        known: the numbers there (3 x numbers).
        value: the scenario's own value.
        own: the numbers there.
    """
    moves = []
    matrix = np.vander(points, 3, increasing=True)
    for place in np.flatnonzero((known != own).any(axis=0)):
        a, b, c = np.linalg.solve(matrix, known[:, place])
        size = float(np.abs(known[:, place]).max())
        if abs(a + b * value + c * value**2 - own[place]) > EXACT * size:
            return None
        square = 0.0 if abs(c) * points.max() ** 2 < 1e-12 * size else float(c)
        moves.append((int(place), float(b), square))
    return moves
