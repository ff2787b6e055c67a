"""Tuned numbers of observer and controller by address, with their ranges and starts."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np

from undeadzone.analysis.certificate.passivity import certify
from undeadzone.errors import InputError, StructureError, UndeadzoneError
from undeadzone.scenario.address import (
    Number,
    entries_there,
    find_option_numbers,
    matching,
    similar,
    stem,
    with_numbers,
)
from undeadzone.scenario.problem import Problem, constant_gains, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.scenario.tune_table import TABLE, Range, Tune
from undeadzone.util.arrays import LARGEST, Floats
from undeadzone_studies.tuning.candidates import certificate_margin

GAINS: Final = "observer.L"  # the one array that an observer has by default


class Parameter(NamedTuple):
    """Number that is tuned.

    Attributes:
        name: its address
        low, high: the bounds of its range
        log: whether shares of the range are counted on a logarithmic scale
        whole: whether it is a whole number
        start: first value of the search
    """

    name: str
    low: float
    high: float
    log: bool
    whole: bool
    start: float

    def value_at_share(self, u: Floats) -> Floats:
        """Return the number at the share u, 0 to 1, of the range."""
        if self.log:
            value = self.low * (self.high / self.low) ** u
        else:
            value = self.low + u * (self.high - self.low)
        return np.clip(np.round(value) if self.whole else value, self.low, self.high)

    def share_of_range(self, value: float) -> float:
        """Return the share of the range at which a number lies [1]."""
        if self.log:
            return float(np.log(value / self.low) / np.log(self.high / self.low))
        return (value - self.low) / (self.high - self.low)


def numbers_of_address(address: str, known: Mapping[str, Number]) -> list[str]:
    """Return the numbers that an address stands for.

    A list may be indexed as the column that it is, one number as a list.

    Args:
        address: such as `observer.L` or `observer.L[:,0]`
        known: the numbers of the options, by address

    Raises:
        InputError
    """
    as_list = re.sub(r",[0:]\]$", "]", address)
    as_number = re.sub(r"\[[0:](,[0:])?\]$", "", address)
    for form in (address, as_list, as_number):
        if names := matching(form, known):
            return names
    raise InputError(f"{TABLE.entry_name(address)}: {_explain_unknown_address(address, known)}")


def _explain_unknown_address(address: str, known: Mapping[str, Number]) -> str:
    """Return the reason why no number has an address, with a remedy."""
    key = stem(address)
    extent = entries_there(address, known)
    if not extent:
        return f"no number of that name in the options. {similar(address, known, 'There are')}"
    if key in known and known[key].value is None:
        return (
            f"the scenario gives no {key}. Write it there, entry by entry, or name another number"
        )
    return f"no such entry. There is {extent}"


def resolve_parameters(entries: Mapping[str, Range], scenario: Scenario) -> tuple[Parameter, ...]:
    """Return the tuned numbers of the entries.

    Args:
        entries: of the table [tune]: ranges by address
        scenario: whose options hold the numbers

    Raises:
        InputError: for no entry, an address that is not there or there twice, bounds that cannot be
    """
    if not entries:
        raise InputError(
            "tune: nothing to tune. Name a number and its bounds in a table [tune]: "
            f"{TABLE.example}"
        )
    known = find_option_numbers(scenario)
    tuned: dict[str, Parameter] = {}
    for address, bounds in entries.items():
        for name in numbers_of_address(address, known):
            if name in tuned:
                place = TABLE.entry_name(name)
                raise InputError(f"{place}: tuned twice. Keep one entry that names it")
            tuned[name] = _build_parameter(address, name, bounds, known[name])
    return tuple(tuned.values())


def _build_parameter(address: str, name: str, bounds: Range, number: Number) -> Parameter:
    """Return a number with its checked bounds and its start (address: of its entry).

    Raises InputError.
    """
    place = TABLE.entry_name(address)
    low, high = bounds.between
    if not -LARGEST <= low < high <= LARGEST:
        raise InputError(
            f"{place}.between: expected [low, high] with low < high, found [{low:g}, {high:g}]"
        )
    if bounds.log and low <= 0:
        raise InputError(
            f"{place}.between: a logarithmic scale needs positive bounds, found {low:g}. "
            "Leave out log or raise it"
        )
    start = bounds.start
    whose = "start"
    advice = "widen between"
    if start is None:
        start = number.value
        whose = f"the scenario's {name}"
        advice = f"{advice}, or give start"
    if start is None:
        start = float(np.sqrt(low * high) if bounds.log else (low + high) / 2)
    if not low <= start <= high:
        raise InputError(f"{place}: {whose} = {start:g} lies outside [{low:g}, {high:g}]; {advice}")
    first = float(np.round(start) if number.whole else start)
    return Parameter(name, low, high, bounds.log, number.whole, first)


def values_at_shares(tuned: Sequence[Parameter], u: Floats) -> Floats:
    """Return the numbers of candidates at shares u of the ranges (candidates x numbers)."""
    return np.stack([p.value_at_share(u[:, i]) for i, p in enumerate(tuned)], axis=1)


def fill_default_gains(scenario: Scenario, what: Tune) -> Scenario:
    """Return the scenario with its observer's default L, if L is tuned but left to the method.

    The start of a tuned number is moved into its bounds.
    """
    of_gains = [address for address in what.entries if stem(address) == GAINS]
    observer: Any = scenario.observer
    if not of_gains or getattr(observer, "L", 0.0) is not None:
        return scenario
    problem = resolve_scenario(scenario)
    gains = constant_gains(problem.observer, problem.model)
    if gains is None or getattr(observer, "design", None) is not None:
        return scenario
    L = gains[0].ravel() if problem.model.p == 1 else gains[0]
    observer = msgspec.structs.replace(observer, L=L)
    scenario = msgspec.structs.replace(scenario, observer=observer)
    known = find_option_numbers(scenario)
    moved = {}
    for address in of_gains:
        low, high = what.entries[address].between
        for name in numbers_of_address(address, known):
            moved[name] = min(max(known[name].value or 0.0, low), high)
    return with_numbers(scenario, moved)


def require_parameters(what: Tune, scenarios: tuple[Scenario, ...]) -> tuple[Parameter, ...]:
    """Return the tuned numbers, present in every scenario, with a start that can be run.

    Raises InputError or a subclass.
    """
    tuned = resolve_parameters(what.entries, scenarios[0])
    start = {p.name: p.start for p in tuned}
    for scenario in scenarios:
        resolve_scenario(scenario)
        missing = start.keys() - find_option_numbers(scenario).keys()
        if missing:
            place = TABLE.entry_name(min(missing))
            raise InputError(f"{place}: scenario {scenario.title!r} has no such number")
        try:
            problem = resolve_scenario(with_numbers(scenario, start))
        except UndeadzoneError as error:
            words = ", ".join(f"{name} = {value:g}" for name, value in start.items())
            raise InputError(f"tune: cannot start from {words}: {error}") from None
        if what.certified:
            _require_certifiable(problem)
    return tuned


def _require_certifiable(problem: Problem) -> None:
    """Raise InputError or StructureError if no gains of a problem's observer can be certified."""
    certificate_margin(problem)
    model = problem.model
    proof = certify(model.linear, np.zeros((model.n, model.p)), np.ones(model.p), model.Ts)
    if proof.reason:
        raise StructureError(f"tune.certified: no gains can be certified: {proof.reason}")
