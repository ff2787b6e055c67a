"""All families by name: how a case is asked, and which cases there are."""

from __future__ import annotations

import functools
import importlib.util
import os
from collections.abc import Callable, Iterable
from typing import NamedTuple

from . import benches, examples, records
from .compare import Case
from .fields import Answer


def _none() -> str:
    """Return that nothing is missing."""
    return ""


class Family(NamedTuple):
    """Cases of a kind.

    Attributes:
        ask: the answer to a case by its name.
        list_cases: their names.
        find_obstacle: why none can be asked on this machine; "" if they can.
    """

    ask: Callable[[str], Answer]
    list_cases: Callable[[], Iterable[str]]
    find_obstacle: Callable[[], str] = _none


def _needs_mujoco() -> str:
    """Return why no motor can be simulated; "" if it can."""
    return "" if importlib.util.find_spec("mujoco") else "MuJoCo is not installed (extra bench)"


def _of_command(command: str, find_obstacle: Callable[[], str] = _none) -> Family:
    """Return the family of a command on each example."""
    ask = functools.partial(examples.ask, command)
    return Family(ask, lambda: examples.list_examples(command), find_obstacle)


FAMILIES = {
    "run": _of_command("run"),
    "check": _of_command("check"),
    "design": _of_command("design"),
    "export": _of_command("export", examples.find_obstacle),
    "commands": Family(examples.ask_of_its_own, lambda: examples.COMMANDS),
    "names": Family(benches.ask_named, lambda: benches.NAMES),
    "strangers": Family(benches.ask_strange, lambda: benches.STRANGERS),
    "motors": Family(
        benches.ask_motor, lambda: benches.MOTORS + benches.BOTH_ENCODERS, _needs_mujoco
    ),
    "valves": Family(benches.ask_valve, lambda: benches.VALVES),
    "lost_motion": Family(benches.ask_motion, lambda: benches.LOST_MOTION),
    "reports": Family(benches.ask_report, lambda: benches.OF_REPORTS),
    "records": Family(records.ask_record, records.find_paths, records.find_obstacle),
}


def ask_case(family: str, name: str) -> Case:
    """Return the answer to a case, or the error that it ended with.

    Args:
        family: of `FAMILIES`.
        name: of the case.
    """
    began = cpu_seconds()
    try:
        answer = FAMILIES[family].ask(name)
    except Exception as error:
        answer = Answer({"error": f"{type(error).__name__}: {error}"[:200]}, {})
    return Case(answer.fields, answer.truth, round(cpu_seconds() - began, 1))


def cpu_seconds() -> float:
    """Return the CPU time of this process and of those that it has waited for [s]."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system
