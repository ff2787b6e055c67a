"""What of a model is uncertain is a constant unknown of a filter: an entry, a parameter."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.linear.hold import zoh_slopes
from undeadzone.plants.system import System, held, in_units
from undeadzone.support.arrays import Floats, scalar


class Tolerance(NamedTuple):
    """What of a model is uncertain: K entries of A and B, or K parameters of a nonlinear plant.

    Attributes:
        std: their standard deviations (K), relative ones but in `named`.
        slopes: d[Ad, Bd] per relative change of each entry (K n x (n + m)); none of a nonlinear
            plant.
        entries: rows and columns of the entries in [A, B].
        values: the entries themselves (K).
        held: `plants.system.held` (n x n).
        changed: changed(params, theta) is the parameters of a nonlinear plant as theta (K) changes
            them.
    """

    std: Floats
    slopes: Floats
    entries: tuple[tuple[int, int], ...] = ()
    values: Floats = np.zeros(0)
    held: Floats = np.zeros((0, 0))
    changed: Callable[[Any, Any], Any] = lambda params, theta: params * (1 + theta)


def named(model: System, stds: dict[str, float]) -> Tolerance:
    """Named parameters of a nonlinear plant, of absolute standard deviations. Raises InputError."""
    std = {}
    for name, value in stds.items():
        std[name] = scalar(f"observer.uncertain.{name}", value, above=0.0)
    unknown = sorted(set(std) - set(model.names))
    if unknown:
        raise InputError(
            f"observer.uncertain.{unknown[0]}: unknown parameter; "
            f"the model has {', '.join(model.names) or 'none with a name'}"
        )
    pick = ca.DM(len(model.names), len(std))
    for k, name in enumerate(std):
        pick[model.names.index(name), k] = 1
    return Tolerance(
        np.array([*std.values()]),
        np.zeros((0, model.n + model.m)),
        changed=lambda params, theta: params + pick @ theta,
    )


def tolerances(
    model: System, claimed: float | dict[str, float], units: Floats | None = None
) -> Tolerance:
    """The uncertain entries of the plant's A and B, or its parameters.

    Args:
        model: the sampled model.
        claimed: relative standard deviation of every entry, but of rows that only say
            x_i' = x_j; or of some, as {"A[1,0]": 0.1}; or of every parameter.
        units: in which the filter counts states (n); None: those of the model.

    Raises:
        InputError: for an entry that does not exist or is 0.
    """
    if model.nonlinear:
        return _of_parameters(model, claimed)
    assert model.Ts is not None
    assert model.flow is not None
    AB = np.hstack(model.flow[:2])
    places = _entry_names(model.n, model.m)
    if not isinstance(claimed, dict):
        claimed = _dynamic_entries(AB, places, claimed)
    std, entries = [], []
    for name, value in claimed.items():
        relative = scalar(f"observer.tolerance.{name}", value, least=0.0)
        if name not in places or AB[places[name]] == 0.0:
            uncertain = ", ".join(name for name, at in places.items() if AB[at] != 0.0)
            raise InputError(
                f"observer.tolerance.{name}: expected an entry of A or B that is not 0: {uncertain}"
            )
        if relative:
            std.append(relative)
            entries.append(places[name])
    even = in_units(model, np.ones(model.n) if units is None else units)
    assert even.flow is not None
    AB = np.hstack(even.flow[:2])
    return Tolerance(
        np.array(std),
        sampled_slopes(AB, entries, model.Ts),
        tuple(entries),
        np.array([AB[at] for at in entries]),
        held(even),
    )


def _of_parameters(model: System, claimed: float | dict[str, float]) -> Tolerance:
    """The same relative standard deviation of every parameter of a nonlinear plant."""
    if isinstance(claimed, dict):
        raise InputError(
            "observer.tolerance: a nonlinear plant takes one number, for all of its parameters"
        )
    std = scalar("observer.tolerance", claimed, least=0.0)
    count = np.size(model.params) if std else 0
    return Tolerance(np.full(count, std), np.zeros((0, model.n + model.m)))


def _entry_names(n: int, m: int) -> dict[str, tuple[int, int]]:
    """The place in [A, B] of each entry, by name: "A[0,1]", "B[1,0]"."""
    places = {}
    for name, columns, first in (("A", n, 0), ("B", m, n)):
        for i in range(n):
            for j in range(columns):
                places[f"{name}[{i},{j}]"] = (i, first + j)
    return places


def _dynamic_entries(
    AB: Floats, places: dict[str, tuple[int, int]], std: float
) -> dict[str, float]:
    """`std` for every entry that is not 0, but of rows that only say x_i' = x_j."""
    integrates = (np.count_nonzero(AB, axis=1) == 1) & (AB.max(axis=1) == 1.0)
    stds = {}
    for name, at in places.items():
        if not integrates[at[0]] and AB[at] != 0.0:
            stds[name] = std
    return stds


def sampled_slopes(AB: Floats, entries: list[tuple[int, int]], Ts: float) -> Floats:
    """d[Ad, Bd] per relative change of each entry of [A, B], one below the other (K n x (n + m)).

    Args:
        AB: [A, B] (n x (n + m)).
        entries: rows and columns in it (K).
        Ts: sample time [s].
    """
    directions = []
    for at in entries:
        direction = np.zeros(AB.shape)
        direction[at] = AB[at]
        directions.append(direction)
    return zoh_slopes(AB, directions, Ts)
