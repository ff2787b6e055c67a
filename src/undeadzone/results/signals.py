"""Signals of a result: a table of names, units and columns, with functions on it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from undeadzone.interfaces import COLUMNS, QUANTITIES, Estimate, list_rejected_assumptions
from undeadzone.scenario.schema import Units
from undeadzone.util.arrays import Floats, to_scalar_or_list
from undeadzone.util.files import read_table


class Signal(NamedTuple):
    """Signal of a result, one row per sample.

    Attributes:
        unit: quantity whose unit it has (an output, input, state or a state's rate), or the unit
            itself.
        columns: names of its columns in turn, such as those of right and left (empty: as the
            signal).
        fields: of an `Estimate`, whose columns stand in it in turn (empty: no observer gives it).
        final: form of its last row in a summary (see `Quantity`).
    """

    unit: str
    columns: tuple[str, ...] = ()
    fields: tuple[str, ...] = ()
    final: type | None = None


FORMS: Final[dict[str, type]] = {"float": float, "int": int, "bool": bool}


def _build_estimated_signals() -> dict[str, Signal]:
    """Return the signals that observers estimate. A run's b is called actuator in an estimate."""
    found: dict[str, Signal] = {}
    for field, quantity in QUANTITIES.items():
        if not quantity.signal:
            continue
        before = found.get(quantity.signal, Signal(quantity.unit, final=FORMS.get(quantity.final)))
        column = getattr(COLUMNS, field).replace("actuator", "b")
        found[quantity.signal] = before._replace(
            columns=(*before.columns, column), fields=(*before.fields, field)
        )
    return found


ESTIMATED: Final = _build_estimated_signals()
_UNITS: Final = read_table(__file__)["signals"]
SIGNALS: Final = {
    **dict(zip(_UNITS, map(Signal, _UNITS.values()), strict=True)),
    **ESTIMATED,
    "d_smooth": Signal("output", ("d_right_smooth", "d_left_smooth")),
    "d_smooth_std": Signal("output", ("d_right_smooth_std", "d_left_smooth_std")),
}
SERIES: Final = ("t", "V")  # signals of one column, which has no number

# Of those that observers give: what each of them does, what further ones do.
EVERY: Final = tuple(
    name
    for name, signal in ESTIMATED.items()
    if not Estimate._field_defaults.keys() & {*signal.fields}
)
FURTHER: Final = tuple(name for name in ESTIMATED if name not in EVERY)
DEVIATIONS: Final = ("x_std", "d_std", "width_std", "innovation_std")
SMOOTHED: Final = ("x_smooth", "z_smooth", "d_smooth", "x_smooth_std", "d_smooth_std")
NOT_OF_LOGS: Final = ("consistent", "refused", "restarts")


class Layout(NamedTuple):
    """Signals that a kind of result may have, in the order of its files.

    Attributes:
        names: of all of them.
        required: signals without which it is invalid.
    """

    names: tuple[str, ...]
    required: tuple[str, ...]


def _build_layout(
    measured: tuple[str, ...], driven: tuple[str, ...], further: tuple[str, ...]
) -> Layout:
    """Return a layout: measured signals, estimates of every observer, inputs, and optional
    signals.
    """
    required = (*measured, *EVERY, *driven)
    return Layout((*required, *further), required)


RUN: Final = _build_layout(
    ("t", "x", "z", "y", "side"),
    ("u", "r"),
    ("V", *FURTHER, "level", "tip", "tip_hat", "tip_r", "poses"),
)
_REST: Final = [name for name in FURTHER if name not in (*DEVIATIONS, *NOT_OF_LOGS)]
LOG: Final = _build_layout(("t", "y", "u", "side"), (), (*DEVIATIONS, "B", *_REST, *SMOOTHED))


class Signals:
    """Signals of a result by name. Missing signals have the value None.

    Args:
        layout: which there may be.
        given: arrays by name (None values are left out).

    Attributes:
        arrays: those that there are, in the order of the layout.

    Raises:
        TypeError: a required signal is missing, or a signal is not in the layout.
    """

    def __init__(self, layout: Layout, given: Mapping[str, Floats | None]) -> None:
        missing = [name for name in layout.required if given.get(name) is None]
        if missing:
            raise TypeError(f"{min(missing)} is missing")
        strange = given.keys() - {*layout.names}
        if strange:
            raise TypeError(f"{min(strange)} is not a signal of such a result")
        self.arrays: dict[str, Floats] = {}
        for name in layout.names:
            value = given.get(name)
            if value is not None:
                self.arrays[name] = value

    def columns(self) -> dict[str, Floats]:
        """Return the columns of the signals that have a row per sample: all but poses."""
        columns: dict[str, Floats] = {}
        for name, value in self.arrays.items():
            if name in SERIES:
                columns[name] = value
            elif value.ndim == 2:
                heads = SIGNALS[name].columns or (name,)
                for i in range(value.shape[1]):
                    columns[f"{heads[i % len(heads)]}[{i // len(heads)}]"] = value[:, i]
        return columns

    def parameters(self, names: Iterable[str]) -> dict[str, dict[str, float]]:
        """Return the last estimates of parameters with their deviations, empty without estimates.

        Args:
            names: of the parameters.
        """
        if not {"theta_hat", "theta_std"} <= self.arrays.keys():
            return {}
        ends = zip(names, self.arrays["theta_hat"][-1], self.arrays["theta_std"][-1], strict=True)
        return {name: {"estimate": float(value), "std": float(std)} for name, value, std in ends}


def last_values(signals: Mapping[str, Floats], *names: str) -> dict[str, Any]:
    """Return the last rows of signals for a summary. Missing signals are left out.

    Args:
        signals: by name.
        names: of those that are wanted.
    """
    numbers: dict[str, Any] = {}
    for name in names:
        if name in signals:
            numbers |= _last_row(SIGNALS[name], signals[name][-1])
    return numbers


def final_rejections(signals: Mapping[str, Floats]) -> dict[str, list[str]]:
    """Return the names of the assumptions that the last readings reject, empty without a filter."""
    if "claims" not in signals:
        return {}
    return {
        "claims": list_rejected_assumptions(signals["claims"][-1, 0], signals["suspect"][-1, 0])
    }


def _last_row(signal: Signal, last: Floats) -> dict[str, Any]:
    """Return the last row of a signal, by the names of its columns."""
    if signal.final is not float:
        assert signal.final is not None
        return {signal.columns[0]: signal.final(last.sum())}
    parts = len(signal.columns)
    return {name: to_scalar_or_list(last[k::parts]) for k, name in enumerate(signal.columns)}


def list_summary_signals(kind: type, but: Iterable[str] = ()) -> list[str]:
    """Return the estimated signals whose last rows appear in a summary in a given form.

    Args:
        kind: float (a number each), int (their sum) or bool (whether they hold).
        but: names to be left out.
    """
    return [name for name in ESTIMATED if ESTIMATED[name].final is kind and name not in but]


def signals_from_estimate(estimate: Estimate) -> dict[str, Floats]:
    """Return the signals that an observer estimated, by name.

    Args:
        estimate: a row for each sample in each field.

    Returns:
        Signals by name, only those that it estimates.
    """
    found = {}
    for name, signal in ESTIMATED.items():
        if all(getattr(estimate, field).size for field in _fields_to_require(signal)):
            parts = [getattr(estimate, field) for field in signal.fields]
            found[name] = np.stack(parts, axis=2).reshape(len(parts[0]), -1)
    return found


def _fields_to_require(signal: Signal) -> list[str]:
    """Return the fields that must be estimated for a signal.

    Gaps without a deviation are known.
    """
    deviations = [f"{field}_std" for field in signal.fields if field in Estimate._field_defaults]
    return [*signal.fields, *(name for name in deviations if name in QUANTITIES)]


def signals_from_columns(columns: Mapping[str, Floats], layout: Layout) -> dict[str, Floats]:
    """Return the signals of given columns.

    Args:
        columns: as `Signals.columns` names them.
        layout: of the result. Raises ValueError if a required signal is missing.
    """
    arrays: dict[str, Floats] = {}
    for name in layout.names:
        heads = SIGNALS[name].columns or (name,)
        parts = [column for key, column in columns.items() if key.partition("[")[0] in heads]
        if name in SERIES and parts:
            arrays[name] = parts[0]
        elif parts or name in layout.required:
            arrays[name] = np.stack(parts, axis=1)
    return arrays


def signal_unit(name: str, units: Units) -> str:
    """Return the unit of a signal, `x`, or of a column, `x[0]`.

    Args:
        name: of either.
        units: names of the scenario's units.
    """
    head, _, index = name.partition("[")
    of_columns = (signal for signal in SIGNALS.values() if head in signal.columns)
    unit = SIGNALS.get(head, next(of_columns, Signal("output"))).unit
    return quantity_unit(unit, int(index.rstrip("]") or 0), units)


def quantity_unit(kind: str, index: int, units: Units) -> str:
    """Return the unit of an entry of a quantity.

    Args:
        kind: output, input, state or rate, or the unit itself.
        index: of the entry (of states that are stacked they come again).
        units: names of the scenario's units.
    """
    if kind in ("state", "rate"):
        states = [units.state] if isinstance(units.state, str) else units.state
        return states[index % len(states)] + "/s" * (kind == "rate")
    return {"output": units.output, "input": units.input}.get(kind, kind)


def output_names(joints: Sequence[str], count: int) -> list[str]:
    """Return the names of outputs: an arm's joints if the counts agree, else numbers.

    Of encoders at links and motors those at the motors come last.
    """
    both = [*joints, *(f"motor of {joint}" for joint in joints)]
    if len(joints) == count:
        return list(joints)
    return both if len(both) == count else list(map(str, range(count)))
