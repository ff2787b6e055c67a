"""The verdict: is there a dead zone of the sensor, something else, or nothing that can be said?"""

from __future__ import annotations

from typing import NamedTuple

from undeadzone.identification.no_zone import CHANCE, NoZone
from undeadzone.identification.orders import OrderFit, at_limit
from undeadzone.identification.place import Place
from undeadzone.identification.plant_fit import Data
from undeadzone.identification.residual_map import ResidualMap, is_strange
from undeadzone.identification.static_rivals import CLEARLY, Density, compare_statistic

LEAST = 0.5  # share of the held-out readings that a fit must explain
NAMES = {"absolute": "other"}  # of rivals, where the verdict's word differs
WORDS = {
    "none": "a plant without any zone",
    "saturation": "a saturation",
    "absolute": "an absolute value",
    "jump": "a zone with a jump (readings not shifted)",
    "play": "play (gear backlash, hysteresis)",
}
ADVICE = (
    "to tell a sensor's zone from friction, record with an input that reverses within the plant's"
    " slowest time constant (steps or noise of 0.4 to 1.5 times its bandwidth, 50 reversals or"
    " more, several amplitudes, the largest well outside the zone), 10 or more samples a time"
    " constant"
)


class Verdict(NamedTuple):
    """The verdict and why; cautions: what to know of the widths that are given."""

    word: str
    reasons: list[str]
    cautions: list[str]


def static_verdict(
    data: Data,
    chosen: OrderFit,
    no_zone: NoZone,
    residuals: ResidualMap,
    rivals: dict[str, Density],
    quantum: float,
) -> Verdict:
    """The verdict before the zone's place is asked.

    Args:
        data: the records.
        chosen: the chosen order.
        no_zone: the test against no zone.
        residuals: what the zone leaves.
        rivals: other static maps.
        quantum: of the readings, scaled.

    Returns:
        dead_zone, or what it is instead.
    """
    fit = chosen.pairs
    width = fit.right + fit.left
    winner = winning_rival(rivals)
    if 0 < width < 1.5 * quantum and winner in (None, "none", "jump"):
        reason = f"the readings are rounded to steps that are larger than any zone ({quantum:.3g})"
        return Verdict("none", [reason], [])
    if winner not in (None, "none") and chosen_rms(rivals[str(winner)]) < 1 - LEAST:
        words = WORDS[str(winner)]
        if rivals[str(winner)].strange:
            reason = f"{words} explains the log better than a dead zone, but not fully either"
            return Verdict("other", [reason], [])
        return Verdict(
            NAMES.get(str(winner), str(winner)), [f"{words} explains the log better"], []
        )
    unclear = _unclear(chosen)
    if unclear is not None:
        return unclear
    if no_zone.chance > CHANCE or winner == "none":
        if winner == "none":
            return Verdict("none", ["a plant without any zone explains the log better"], [])
        return Verdict("none", [f"readings need no zone (p = {no_zone.chance:.2g})"], [])
    return _by_residual(data, chosen, residuals)


def saturated(verdict: Verdict, ends: str) -> Verdict:
    """What needs no zone, and sticks at the ends of its range, is a saturation.

    Args:
        verdict: by the readings between the ends.
        ends: of the range; empty: readings stick nowhere.
    """
    if verdict.word != "none" or not ends:
        return verdict
    reason = f"readings stick at the ends of the range {ends}, and between them they need no zone"
    return Verdict("saturation", [reason], [])


def _unclear(chosen: OrderFit) -> Verdict | None:
    """That nothing can be said, and why; None where something can."""
    if chosen.share < LEAST:
        return Verdict("unclear", [_explains_nothing(chosen)], [])
    if at_limit(chosen):
        reason = (
            "the plant seems to integrate, or to ring longer than the record: its state at the"
            " start and an offset or a sine cannot be told apart; say --integrators 1 if it is the"
            " position of a motor, or the like; else record for longer"
        )
        return Verdict("unclear", [reason], [])
    return None


def _by_residual(data: Data, chosen: OrderFit, residuals: ResidualMap) -> Verdict:
    """dead_zone, unless a curve over z^ explains what it leaves."""
    if is_strange(residuals.share, residuals.chance):
        share = f"{100 * residuals.share:.0f} %"
        reason = (
            f"a curve over z^ explains {share} of what a dead zone leaves: another nonlinearity"
        )
        return Verdict("other", [reason], [])
    cautions = []
    if residuals.strange:
        cautions.append(
            f"a curve over z^ explains {100 * residuals.share:.0f} % of what the dead zone leaves:"
            " the fit is not perfect"
        )
    if residuals.remembers:
        cautions.append("the residual depends on the direction of z^: a memory, perhaps play")
    if not data.silent_zeros and not chosen.white:
        cautions.append("the one-step residual is not white")
    return Verdict("dead_zone", [], cautions)


def chosen_rms(density: Density) -> float:
    """rms of a rival's residual, in rms of y."""
    return density.rms


def winning_rival(rivals: dict[str, Density]) -> str | None:
    """The static rival that beats the dead zone and every other; None if none does."""
    zone = rivals["dead_zone"]
    best = min(rivals.values(), key=lambda one: one.bic)
    if best.name == "dead_zone":
        return None
    return best.name if compare_statistic(best, zone) > CLEARLY else None


def jump_verdict(
    data: Data, chosen: OrderFit, residuals: ResidualMap, rivals: dict[str, Density]
) -> Verdict:
    """The verdict on a record that was taken for that of a jump sensor.

    Args:
        data: the records, readings less the jumps.
        chosen: the chosen order.
        residuals: what the zone leaves.
        rivals: static maps, on the readings as they are.

    Returns:
        jump, unless another map explains the readings better, or no plant does.
    """
    unclear = _unclear(chosen)
    if unclear is not None:
        return unclear
    jump = rivals["jump"]
    for name, rival in rivals.items():
        if name != "jump" and compare_statistic(rival, jump) > CLEARLY:
            words = "a dead zone (readings shifted)" if name == "dead_zone" else WORDS[name]
            return Verdict("other", [f"{words} explains the log better than a jump sensor"], [])
    verdict = _by_residual(data, chosen, residuals)
    return verdict._replace(word="jump") if verdict.word == "dead_zone" else verdict


def rescued(verdict: Verdict, place: Place, rivals: dict[str, Density]) -> Verdict:
    """What is no dead zone of the sensor may be friction or a zone of the input.

    Args:
        verdict: the verdict by static maps, not dead_zone.
        place: what was found about the place.
        rivals: static maps.

    Returns:
        friction or input_zone where such a model beats every static map; else the verdict.
    """
    if place.best.strange or place.by_rivals not in ("friction", "input"):
        return verdict
    for rival in rivals.values():
        if compare_statistic(place.best, rival) <= CLEARLY:
            return verdict
    if place.by_rivals == "input":
        return Verdict("input_zone", ["a zone of the input explains the log better"], [])
    return Verdict("friction", ["friction in the plant explains the log better", ADVICE], [])


def place_verdict(verdict: Verdict, place: Place, noise_falls_silent: bool) -> Verdict:
    """The verdict after the zone's place is known.

    Args:
        verdict: dead_zone, as far as static maps go.
        place: what was found about the place.
        noise_falls_silent: whether noise ahead of the zone is silenced by it, which only a sensor
            does.

    Returns:
        dead_zone with cautions, friction or input_zone with advice.
    """
    where = place.verdict
    if where in ("friction", "friction*") and not noise_falls_silent:
        return Verdict("friction", ["friction in the plant explains the log better", ADVICE], [])
    if where == "input":
        return Verdict("input_zone", ["a zone of the input explains the log better"], [])
    cautions = list(verdict.cautions)
    if where == "both":
        cautions.append("friction or a zone of the input lies beside the sensor's zone")
    elif where in ("sensor*", "friction", "friction*"):
        cautions.append("a zone of the sensor is there; friction beside it is not excluded")
    elif where == "undecided" and noise_falls_silent:
        cautions.append("noise falls silent, so the sensor has a zone; friction is not excluded")
    elif where == "undecided":
        cautions.append(
            "a zone, yes; this record cannot tell whether sensor, friction or input has it; the"
            " widths hold if it is the sensor's alone"
        )
        cautions.append(ADVICE)
    return Verdict("dead_zone", verdict.reasons, cautions)


def _explains_nothing(chosen: OrderFit) -> str:
    """Why a fit is refused, and what to try."""
    return (
        f"the best plant explains {100 * max(chosen.share, 0.0):.0f} % of the held-out readings:"
        " are input and output the right columns? try more inputs, a higher --order, or a log with"
        " less disturbance"
    )
