"""What `check` found, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from undeadzone.analysis.certificate.design_file import in_words_of_margin, plain
from undeadzone.analysis.identifiability.linear import yes_no
from undeadzone.analysis.identifiability.second_truth import in_words as in_words_of_truths
from undeadzone.ends.sensor import DIRECTIONS
from undeadzone.results.listening import in_words as share_in_words
from undeadzone.scenario.schema import Scenario
from undeadzone.support.shown import Block, Rows
from undeadzone.support.text import HALF_95, label, with_unit

REFUSED: Final = "not certified: "  # before the reason, where `check.summary` gives it


def in_words(summary: Mapping[str, Any], scenario: Scenario, names: Sequence[str]) -> list[Block]:
    """What was found of a scenario's gains: pairs, and of several outputs a table with their rows.

    Args:
        summary: what `check` says.
        scenario: that was checked.
        names: of its outputs (p).
    """
    shown = pairs(summary, scenario)
    if len(names) == 1:
        return [shown]
    duration = scenario.simulation.duration
    note = label(f"±: 95 % at best after {duration:g} s", scenario.units.output)
    return [shown, rows(summary, names), note]


def pairs(summary: Mapping[str, Any], scenario: Scenario) -> dict[str, Any]:
    """What was found of a scenario's gains, in words by what they are about.

    Args:
        summary: what `check` says.
        scenario: that was checked.
    """
    reasons = [reason for reason in summary["reasons"] if not reason.startswith(REFUSED)]
    shown = {
        "scenario": summary["title"],
        "observer": (f"{scenario.observer.__struct_config__.tag}, {scenario.simulation.time} time"),
        **_proof(summary, scenario),
        **_nearest(summary),
        **_speed(summary),
        **_listens(summary),
        **_overrun(summary),
        **_knowledge(summary, scenario),
        **_second(summary),
    }
    if reasons:
        shown["why"] = reasons
    if summary["cures"]:
        shown["cure"] = summary["cures"]
    return shown


def _second(summary: Mapping[str, Any]) -> dict[str, Any]:
    """Other truths that have the same readings."""
    truths = summary["second"]
    told = in_words_of_truths(truths if isinstance(truths, list) else [truths])
    return {"same readings": told} if told else {}


def rows(summary: Mapping[str, Any], names: Sequence[str]) -> Rows:
    """What the readings tell of each output, a row each, with the least deviations that they allow.

    Arguments as of `in_words`.
    """
    table: list[Sequence[str]] = [("identifiable", *DIRECTIONS)]
    for name, verdict, std in zip(names, summary["identifiable"], summary["std"], strict=True):
        table.append((name, *(_known(verdict, std, each) for each in DIRECTIONS)))
    return table


def _known(verdict: Mapping[str, bool], std: Mapping[str, float | None], name: str) -> str:
    """Whether a direction can be known, and how well."""
    if not verdict[name]:
        return "NO"
    value = std.get(name)
    return "yes" if value is None else f"yes, ± {HALF_95 * value:.2g}"


def _proof(summary: Mapping[str, Any], scenario: Scenario) -> dict[str, str]:
    """Whether the gains are certified, and whether a run stays where they are."""
    shown = {}
    certified = summary["certified"]
    if certified and scenario.region is not None:
        shown["certified"] = (
            f"yes on the region, margin {summary['margin']:.4g}: V never rises while x, x^ and u "
            "stay in it, whatever the sides do"
        )
    elif certified:
        shown["certified"] = in_words_of_margin(summary["margin"], summary["frequency"])
    elif certified is False:
        refused = [reason for reason in summary["reasons"] if reason.startswith(REFUSED)]
        why = "; ".join(reason.removeprefix(REFUSED) for reason in refused)
        shown["certified"] = f"NO: {why}"
    if scenario.region is not None and certified is not None:
        left = summary["left_region"]
        if left is None:
            shown["region"] = "a run of the scenario stays in it"
        else:
            shown["region"] = f"LEFT at {left:.4g} s of a run of the scenario: no claim from there"
    return shown


def _nearest(summary: Mapping[str, Any]) -> dict[str, str]:
    """Certified gains near to those that are not, and bounds of those that are."""
    shown = {}
    near = summary.get("nearest")
    if near:
        gains = f"L = {plain(near['L'])}, gamma = {plain(near['gamma'])}"
        shown["nearest certified"] = (
            f"{gains}: margin {near['margin']:.3g}, rate {near['rate']:.4g} 1/s"
        )
        shown["faster ones"] = (
            "undeadzone design finds certified gains by their rate and what they trade for it"
        )
    bounds = summary.get("l2_gain")
    if bounds:
        shown["bounded"] = (
            f"L2 gain to z - z^ {bounds['disturbance']:.4g} from the input's disturbance, "
            f"{bounds['noise']:.4g} from noise on y"
        )
    return shown


def _speed(summary: Mapping[str, Any]) -> dict[str, str]:
    """How fast the error dies, and which errors stay."""
    shown = {}
    if summary["rate"] is not None:
        after = "the error does not die"
        if summary["time_constant"] is not None:
            after = f"time constant {summary['time_constant']:.4g} s"
        shown["rate"] = f"{summary['rate']:.4g} 1/s along the reference, {after}"
    if summary["never"]:
        shown["stays"] = (
            f"{', '.join(summary['never'])}: these errors stay along this reference, whatever the "
            "gains"
        )
    return shown


def _listens(summary: Mapping[str, Any]) -> dict[str, str]:
    """How strongly readings move z^."""
    if summary["listens"] is None:
        return {}
    listens = summary["listens"]
    return {"listens": share_in_words(listens if isinstance(listens, list) else [listens])}


def _overrun(summary: Mapping[str, Any]) -> dict[str, str]:
    """Whether what is behind a play rests in its gap."""
    if "overrun" not in summary:
        return {}
    found = summary["overrun"]
    numbers = found if isinstance(found, list) else [found]
    told = ", ".join(f"{number:.3g}" for number in numbers if number is not None)
    if not told:
        return {"overrun": "cannot be told: the reference has corners"}
    return {"overrun": f"J a / f = {told}: below 1 the load rests against its contact"}


def _knowledge(summary: Mapping[str, Any], scenario: Scenario) -> dict[str, str]:
    """What the readings tell of a single output, and how well at best."""
    verdict, std = summary["identifiable"], summary["std"]
    if isinstance(verdict, list):
        return {}
    shown = {"identifiable": yes_no(verdict)}
    known = [f"{name} ± {HALF_95 * v:.2g}" for name, v in std.items() if v is not None]
    if known:
        duration = scenario.simulation.duration
        words = with_unit(", ".join(known), scenario.units.output)
        shown["known to"] = f"{words} (95 %) after {duration:g} s at best"
    return shown
