"""The variables of an FMU: inputs, outputs, parameters and what says that a reading is missing."""

from __future__ import annotations

from typing import Final, NamedTuple

from undeadzone.exports.fields import Field
from undeadzone.exports.parts import Step
from undeadzone.interfaces import COLUMNS, QUANTITIES, Estimate
from undeadzone.scenario.schema import Units

# Fields of an estimate that a table calls otherwise; widths keep their names.
RENAMED: Final = {
    name: getattr(COLUMNS, name) for name in Estimate._fields if name in ("x", "z", "w", "theta")
}
IN_OUTPUT_UNITS: Final = (
    "y",
    "r",
    *(name for name, quantity in QUANTITIES.items() if quantity.unit == "output"),
)


class Variable(NamedTuple):
    """A variable of an FMU.

    Attributes:
        name: as importers show it.
        causality: "input", "output" or "parameter".
        meaning: what it is.
        unit: its unit; empty: it has none.
        start: its value at first; None for outputs, which are calculated.
        is_flag: whether it is a Boolean.
    """

    name: str
    causality: str
    meaning: str
    unit: str
    start: float | None
    is_flag: bool = False


def variables(step: Step, units: Units) -> list[Variable]:
    """All variables of a step, in the order of their references, which count from 0.

    Args:
        step: the step.
        units: names of the scenario's units.
    """
    listed: list[Variable] = []
    for field in step.inputs:
        for k in range(field.size):
            listed.append(_variable(field, k, "input", units, 0.0))
    for field in step.outputs:
        for k in range(field.size):
            listed.append(_variable(field, k, "output", units, None))
    values = iter(step.defaults.tolist())
    for field in step.params:
        for k in range(field.size):
            listed.append(_variable(field, k, "parameter", units, next(values)))
    for k in range(step.readings):
        meaning = f"whether reading y[{k}] is missing"
        listed.append(Variable(f"missing[{k}]", "input", meaning, "", 0.0, is_flag=True))
    return listed


def _variable(field: Field, k: int, causality: str, units: Units, start: float | None) -> Variable:
    """An entry of a field."""
    name = field.name
    if causality == "output":
        name = RENAMED.get(name, name)
    unit = "" if causality == "parameter" else _unit(field.name, k, units)
    meaning = field.meaning.split(" [")[0]
    return Variable(f"{name}[{k}]", causality, meaning, "" if unit == "1" else unit, start)


def _unit(name: str, k: int, units: Units) -> str:
    """The unit of an entry of a field."""
    state = units.state if isinstance(units.state, str) else units.state[k % len(units.state)]
    if name in IN_OUTPUT_UNITS:
        return units.output
    if name in ("u", "u_ff"):
        return units.input
    if name in ("x", "x_ref", "x_std"):
        return state
    if name == "w":
        return "1/s" if state == "1" else f"{state}/s"
    return "1"
