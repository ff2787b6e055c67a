"""The signals of a run as the columns of a table, and back."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from undeadzone.scenario.schema import Units
from undeadzone.support.arrays import Floats, one_or_list

# Signals whose columns are right and left in turn, and what these are called.
EDGES: Final = {
    "d_hat": ("d_right", "d_left"),
    "d_std": ("d_right_std", "d_left_std"),
    "b_hat": ("b_right", "b_left"),
    "b_std": ("b_right_std", "b_left_std"),
    "c_hat": ("gap_right", "gap_left"),
    "c_std": ("gap_right_std", "gap_left_std"),
    "d_smooth": ("d_right_smooth", "d_left_smooth"),
    "d_smooth_std": ("d_right_smooth_std", "d_left_smooth_std"),
}
STATES: Final = ("x", "x_hat", "x_std", "x_smooth", "x_smooth_std", "w_hat")
# Units of the signals for which a scenario names none.
UNITS: Final = {
    "t": "s",
    "side": "1",
    "V": "1",
    "B": "1",
    "theta_hat": "1",
    "theta_std": "1",
    "consistent": "1",
    "refused": "1",
    "restarts": "1",
    "tip": "m",
    "tip_hat": "m",
    "tip_r": "m",
}


def arrays_of(kind: type) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The names of the signals that a result may have, and of those without which it is none.

    Args:
        kind: a dataclass whose fields are signals, and `info`.
    """
    fields = [field for field in dataclasses.fields(kind) if field.name != "info"]
    required = [field.name for field in fields if field.default is dataclasses.MISSING]
    return tuple(field.name for field in fields), tuple(required)


def signals_of(result: Any) -> dict[str, Floats]:
    """The signals that a result has, by name."""
    every = {name: getattr(result, name) for name in arrays_of(type(result))[0]}
    return {name: value for name, value in every.items() if value is not None}


def output_names(joints: Sequence[str], count: int) -> list[str]:
    """The names of outputs: an arm's joints where it has one for each, else numbers."""
    return list(joints) if len(joints) == count else [str(i) for i in range(count)]


def to_pandas(result: Any) -> Any:
    """A pandas DataFrame indexed by t, one column per scalar signal of a result; needs pandas."""
    import pandas as pd

    columns = to_columns(signals_of(result))
    t = pd.Index(columns.pop("t"), name="t")
    return pd.DataFrame(columns, index=t)


def to_columns(signals: Mapping[str, Floats]) -> dict[str, Floats]:
    """The columns of signals that have one row per sample; poses, which have not, are left out."""
    columns: dict[str, Floats] = {}
    for name, value in signals.items():
        if value.ndim == 1:
            columns[name] = value
        elif value.ndim == 2:
            for i in range(value.shape[1]):
                columns[_column_name(name, i)] = value[:, i]
    return columns


def from_columns(
    columns: Mapping[str, Floats], signals: Iterable[str], required: Iterable[str]
) -> dict[str, Any]:
    """The signals whose columns these are.

    Args:
        columns: as `to_columns` names them.
        signals: names of all signals that there may be.
        required: of those without which there is no run. Raises ValueError where one lacks.
    """
    needed = set(required)
    arrays: dict[str, Any] = {"V": columns.get("V"), "t": columns["t"]}
    for name in set(signals) - {"t", "V"}:
        heads = EDGES.get(name, (name,))
        parts = [column for key, column in columns.items() if key.partition("[")[0] in heads]
        if parts or name in needed:
            arrays[name] = np.stack(parts, axis=1)
    return arrays


def judgement(
    consistent: Floats | None, refused: Floats | None, restarts: Floats | None
) -> dict[str, Any]:
    """What an observer says of its readings in the end of a run; nothing where it says nothing.

    Args:
        consistent, restarts: whether they fit, and how often it began anew (N x 1).
        refused: how many it took for wrong (N x p).
    """
    if consistent is None or refused is None or restarts is None:
        return {}
    return {
        "consistent": bool(consistent[-1, 0]),
        "refused": int(refused[-1].sum()),
        "restarts": int(restarts[-1, 0]),
    }


def unit_of(name: str, units: Units) -> str:
    """The unit of a signal, `x`, or of one of its columns, `x[0]`."""
    signal, _, index = name.partition("[")
    if signal in STATES:
        state = units.state
        unit = state if isinstance(state, str) else state[int(index.rstrip("]") or 0)]
        return f"{unit}/s" if signal == "w_hat" else unit
    if signal == "u" or signal.startswith("b_"):
        return units.input
    return UNITS.get(signal, units.output)


def _column_name(signal: str, i: int) -> str:
    """The name of column i of a signal: x[0]; of widths d_right[0], d_left[0], d_right[1], ..."""
    if signal in EDGES:
        return f"{EDGES[signal][i % 2]}[{i // 2}]"
    return f"{signal}[{i}]"


def actuator_widths(b_hat: Floats | None, b_std: Floats | None) -> dict[str, Any]:
    """The final estimates of the actuators' widths, for a summary; nothing where there are none.

    Args:
        b_hat: [b_r^, b_l^] of each actuator in turn (N x 2m) [u].
        b_std: their standard deviations (N x 2m) [u].
    """
    if b_hat is None or b_std is None:
        return {}
    numbers = {"b_right": b_hat[-1, 0::2], "b_left": b_hat[-1, 1::2]}
    numbers |= {"b_right_std": b_std[-1, 0::2], "b_left_std": b_std[-1, 1::2]}
    return {name: one_or_list(value) for name, value in numbers.items()}
