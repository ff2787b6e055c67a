"""Which nonlinearity is it: play, play and dead zone, or a dead zone of the input?"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from undeadzone.identification.element import Element, is_there, of_input_zone, of_play
from undeadzone.identification.first_fit import GLITCH, RARE
from undeadzone.identification.fit import Fit
from undeadzone.identification.four_offsets import Offsets
from undeadzone.identification.input_zone import find_input_zone
from undeadzone.identification.offsets_along import along
from undeadzone.identification.options import Options
from undeadzone.identification.orders import OrderFit
from undeadzone.identification.plant_fit import Data, Simulator
from undeadzone.identification.play_gap import Gap, find_gap
from undeadzone.identification.play_model import PlayFit, density_of, fit_both, fit_play
from undeadzone.identification.records import part_of, reduced
from undeadzone.identification.static_rivals import CLEARLY, Density, compare_statistic
from undeadzone.identification.verdict import LEAST, Verdict

LEAST_GAP = 0.02  # rms of y, below which a gap is no matter
QUIETEST = 1e-3  # least rms from which readings are counted as odd, in rms of y


class Which(NamedTuple):
    """What stands in the place of a sensor's dead zone.

    Attributes:
        verdict: in the end.
        element: what was found, with its plant; None where the sensor's dead zone or nothing was.
        offsets: the four offsets along the log; None where they were not looked at.
    """

    verdict: Verdict
    element: Element | None
    offsets: Offsets | None


def is_asked(
    verdict: Verdict, offsets: Offsets, fit: Fit, rivals: dict[str, Density], options: Options
) -> bool:
    """Whether a play is looked for: it explains the log, or something with a memory may.

    Args:
        verdict: by static maps.
        offsets: with the plant behind a dead zone.
        fit: that plant, and the zone.
        rivals: static maps.
        options: what the user said.
    """
    if options.kind in ("jump", "deadzone"):
        return False
    perhaps = verdict.word in ("play", "other", "unclear") or options.kind == "play"
    if perhaps or offsets.name in ("play", "both"):
        return True
    both = fit_both([fit])  # a lag of the plant may pass for a play
    least = min(rivals["dead_zone"], rivals["none"], key=lambda one: one.bic)
    return both is not None and compare_statistic(both.density, least) > CLEARLY


def find_play(
    verdict: Verdict,
    offsets: Offsets,
    logs: list[Data],
    fits: list[OrderFit],
    rivals: dict[str, Density],
    quantum: float,
    options: Options,
    advance: Callable[[int], None],
) -> Which:
    """The verdict where a play, or a play and a dead zone, may explain the log better.

    Args:
        verdict: by static maps.
        offsets: with the plant behind a dead zone.
        logs: the records, as they are and with a delay that was found.
        fits: of every order with a zone of the sensor, where climbs start.
        rivals: static maps.
        quantum: of the readings, scaled.
        options: what the user said.
        advance: called with the number of steps just done.
    """
    orders = [one.n for one in fits]
    plays = []
    for data in logs:
        fitted = fit_play(part_of(data), orders, options.integrators)
        if fitted and fitted[0].density.value.size == rivals["none"].value.size:
            plays.append((_without_glitches(fitted[0]), fitted[1:], data))
    if not plays:
        return Which(verdict, None, offsets)
    play, others, whole = min(plays, key=lambda one: one[0].density.bic)
    same = [reduced(one.pairs) for one in fits] if whole is logs[-1] else []
    both = fit_both([play, *same])
    best = _better(play, both, rivals, options.kind == "play")
    if best is None:
        return Which(verdict, None, offsets)
    gap = find_gap(best, others, quantum, advance)
    offsets = of_gap(gap, quantum)
    if best.model.zone and not _both_there(gap, offsets):
        best = play
        if _better(play, None, rivals, options.kind == "play") is None:
            return Which(verdict, None, offsets)
        gap = find_gap(best, others, quantum, advance)
        offsets = of_gap(gap, quantum)
    if not best.model.zone and not is_there(gap.intervals["width"], LEAST_GAP) and gap.sure:
        return Which(_no_gap(verdict, gap), None, offsets)
    rms = options.offset_rms()
    element = of_play(gap, whole, None if rms is None else rms / whole.y_scale)
    return Which(_named(element, offsets), element, offsets)


def _better(
    play: PlayFit, both: PlayFit | None, rivals: dict[str, Density], asked: bool
) -> PlayFit | None:
    """The play, or play and dead zone, that beats every static map; None: neither does.

    A play that the user knows of need not beat anything, only not be beaten.
    """
    static = [one for name, one in rivals.items() if name != "play"]
    if both is not None and both.density.rms < 1 - LEAST:
        ahead = [compare_statistic(both.density, one) for one in [play.density, *static]]
        if min(ahead) > CLEARLY:
            return both
    if play.density.strange or play.density.rms > 1 - LEAST:
        return None
    ahead = [compare_statistic(play.density, one) for one in static]
    least = -CLEARLY if asked else CLEARLY
    return play if min(ahead) > least else None


def _both_there(gap: Gap, offsets: Offsets) -> bool:
    """Whether both widths are above 0 for certain; the four offsets must not deny it."""
    there = is_there(gap.intervals["width"], LEAST_GAP) and is_there(
        gap.intervals["zone"], LEAST_GAP
    )
    return there and offsets.name in ("both", "play")


def _without_glitches(fit: PlayFit) -> PlayFit:
    """The fit without the few readings that it cannot have produced."""
    model = fit.model
    e, ok = model.residual(fit.theta), model.data.ok
    usual = float(np.median(np.abs(e[ok]))) / 0.6745
    odd = ok & (np.abs(e) > GLITCH * max(usual, QUIETEST))
    if not odd.any() or odd.sum() > RARE * ok.sum():
        return fit
    data = model.data._replace(ok=ok & ~odd, y=np.where(odd, 0.0, model.data.y))
    layout = model.simulator.layout
    clean = type(model)(Simulator(data, layout.n, layout.integrators), model.zone)
    top = clean.climbed(fit.theta)
    return PlayFit(clean, top.theta, density_of(clean, top.theta))


def _no_gap(verdict: Verdict, gap: Gap) -> Verdict:
    """A play without a gap is a constant offset, where it is anything."""
    if verdict.word != "play":
        return verdict
    offset = -gap.intervals["centre"].value * gap.model.data.y_scale
    reason = (
        f"no gap is there, but the readings lie about {offset:.4g} beside the output: a constant"
        f" offset; take it away by --zero {offset:.4g}"
    )
    return Verdict("other", [reason], [])


def _named(element: Element, offsets: Offsets) -> Verdict:
    """The verdict on a play that was found."""
    if element.kind == "both":
        reason = "a play with a dead zone after or ahead of it explains the log better than either"
        return Verdict("both", [reason], [])
    reason = "play (gear backlash, hysteresis) explains the log better"
    cautions = []
    if offsets.name in ("dead_zone", "both"):
        zone, std = offsets.widths[1], offsets.std[1]
        cautions.append(
            f"the four offsets of the readings show a dead zone of {zone:.3g} +- {2 * std:.2g} in"
            " rms of y beside the play: the fit is not perfect"
        )
    return Verdict("play", [reason], cautions)


def of_gap(gap: Gap, quantum: float) -> Offsets:
    """The four offsets along a log, with the plant behind a play.

    Args:
        gap: play, or play and dead zone.
        quantum: of the readings, scaled.
    """
    return along(gap.model.simulator, gap.theta, gap.model.rms(gap.fit.theta), quantum)


def of_zone(fit: Fit, quantum: float) -> Offsets:
    """The four offsets along a log, with the plant behind a dead zone.

    Args:
        fit: plant and zone.
        quantum: of the readings, scaled.
    """
    return along(fit.objective.simulator, fit.theta, fit.s, quantum)


def find_actuator(verdict: Verdict, fits: list[OrderFit], offsets: Offsets | None) -> Which:
    """The widths of an actuator's dead zone, where the verdict says that there is one.

    Args:
        verdict: in the end.
        fits: of every order, with a zone of the sensor.
        offsets: with the plant behind a dead zone of the sensor.
    """
    found = find_input_zone(fits)
    if found is None:
        return Which(verdict, None, offsets)
    return Which(verdict, of_input_zone(found, fits[0].pairs.objective.data), offsets)
