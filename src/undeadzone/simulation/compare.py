"""Two observers on one scenario: the scenario's own, and that of its [compare] table."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import msgspec

from undeadzone.errors import InputError
from undeadzone.results.run import Run
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.simulate import simulate, steps
from undeadzone.support.progress import in_notebook
from undeadzone.support.toml import tables


def compare(
    scenario: Scenario, *, progress: Callable[[int], None] | None = None
) -> tuple[Run, Run]:
    """Simulate a scenario, and the same scenario with the observer of its [compare] table.

    Args:
        scenario: what to simulate; its `compare` names the other observer.
        progress: called with the number of steps just done, of both runs; None: a bar in a
            notebook.

    Returns:
        The run of the scenario's own observer and that of the other. Each `info.label` says what
        tells the two observers apart.

    Raises:
        InputError: the scenario has no [compare]; or, also as a subclass, what `simulate` raises.
    """
    if scenario.compare is None:
        raise InputError(
            "compare: this scenario has no [compare]; name there the observer whose run is to be "
            'shown beside the first, such as method = "luenberger"'
        )
    with in_notebook(progress, "simulating", 2 * steps(scenario)) as advance:
        return beside(scenario, simulate(scenario, progress=advance), advance)


def beside(
    scenario: Scenario, run: Run, progress: Callable[[int], None] | None = None
) -> tuple[Run, Run]:
    """The run of a scenario and that of the observer of its [compare] table, both labelled.

    Args:
        scenario: which has a [compare] table.
        run: of it.
        progress: called with the number of steps just done.
    """
    rival = msgspec.structs.replace(scenario, observer=scenario.compare)
    second = simulate(rival, progress=progress)
    one, other = labels(scenario.observer, scenario.compare)
    return _labelled(run, one), _labelled(second, other)


def labels(first: Any, second: Any) -> tuple[str, str]:
    """Names that tell two observers apart.

    These are their methods, and, where the methods are the same, one option that differs: a switch
    before all others.
    """
    one, other = tables(first), tables(second)
    differing = [name for name in {**one, **other} if one.get(name) != other.get(name)]
    if "method" in differing or not differing:
        return _in_words(one, "method"), _in_words(other, "method")
    switches = [name for name in differing if True in (one.get(name), other.get(name))]
    name = (switches or differing)[0]
    return _in_words(one, name), _in_words(other, name)


def _in_words(options: dict[str, Any], name: str) -> str:
    """A method, and one of its options, in words."""
    method, value = str(options["method"]), options.get(name)
    if name == "method" or value in (None, False, {}):
        return method
    if value is True:
        return f"{method}, {name}"
    if isinstance(value, dict):
        return f"{method}, {name} {', '.join(value)}"
    return f"{method}, {name} = {value}"


def _labelled(run: Run, label: str) -> Run:
    """The run with a label."""
    return dataclasses.replace(run, info=msgspec.structs.replace(run.info, label=label))
