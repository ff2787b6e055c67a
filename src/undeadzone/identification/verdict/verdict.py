"""A log fitted with a zone of the sensor, and the verdict: is it one, or what else, or nothing?"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from undeadzone.identification.logs.grid import Grid
from undeadzone.identification.logs.log import Options
from undeadzone.identification.logs.prepare import JumpEdge
from undeadzone.identification.models.estimates import long_run_covariance, quantile
from undeadzone.identification.models.least_squares import (
    CHANCE,
    CLEARLY,
    Density,
    compare_statistic,
    explained,
    is_strange,
)
from undeadzone.identification.models.plant import Data
from undeadzone.identification.models.zone_fit import Fit
from undeadzone.identification.verdict.delays import FittedOrders
from undeadzone.identification.verdict.orders import (
    NoZone,
    OrderFit,
    ResidualMap,
    at_limit,
    innovations,
)
from undeadzone.support.arrays import Floats

LEAST = 0.5  # share of the held-out readings that a fit must explain
NO_ZONE = 0.01  # p from which readings need no zone
SPRING = 0.03  # share of the one-step residual from which a spring is named
WELL_INSIDE = 2.0  # rms of the noise between z^ and an edge
SURE = 0.999  # level of the interval of an offset that must not hold 0
RELEVANT = 0.1  # of the residual's rms, below which an offset is no matter
OTHER = {"absolute": "other"}  # of models, where the verdict's word differs
MODELS = {
    "dead_zone": "a dead zone (readings shifted)",
    "none": "a plant without any zone",
    "saturation": "a saturation",
    "absolute": "an absolute value",
    "jump": "a zone with a jump (readings not shifted)",
    "play": "play (gear backlash, hysteresis)",
    "friction": "friction in the plant",
    "input_zone": "a zone of the input",
}


class Case(NamedTuple):
    """A log fitted with a zone of the sensor; nothing is judged.

    Attributes:
        grid: the log on its grid.
        options: what the user said.
        recorded: the records with the input as it was recorded.
        unreached: edges that no reading passes.
        fitted: every order.
        chosen: the order that was chosen.
        no_zone: the test of a zone against none.
        residuals: residual by z^.
        rivals: static rivals.
        advance: called with the number of steps just done.
    """

    grid: Grid
    options: Options
    recorded: Data
    unreached: tuple[str, ...]
    fitted: FittedOrders
    chosen: OrderFit
    no_zone: NoZone
    residuals: ResidualMap
    rivals: dict[str, Density]
    advance: Callable[[int], None]

    @property
    def data(self) -> Data:
        """The records as they were fitted."""
        return self.fitted.prepared.data

    @property
    def quantum(self) -> float:
        """Of the readings, scaled."""
        return self.fitted.prepared.quantum

    @property
    def jumps(self) -> tuple[JumpEdge, JumpEdge] | None:
        """Edges of a jump sensor, scaled, where the log was taken for one's; None elsewhere."""
        return self.fitted.prepared.jumps

    @property
    def offset(self) -> float | None:
        """rms of an unknown offset of the output, scaled; None: free."""
        rms = self.options.offset_rms()
        return None if rms is None else rms / self.data.y_scale


class Verdict(NamedTuple):
    """The verdict and why; cautions: what to know of the widths that are given."""

    word: str
    reasons: list[str]
    cautions: list[str]

    def with_cautions(self, *cautions: str) -> Verdict:
        """The same with more to know."""
        return self._replace(cautions=[*self.cautions, *cautions])


def because(word: str, *reasons: str) -> Verdict:
    """A verdict with its reasons."""
    return Verdict(word, list(reasons), [])


def explains_better(name: str, *more: str) -> Verdict:
    """The verdict that a model explains the log better than a dead zone."""
    return because(OTHER.get(name, name), f"{MODELS[name]} explains the log better", *more)


# --- By static maps


def by_maps(case: Case) -> Verdict:
    """The verdict before a memory or the zone's place is asked.

    Returns:
        dead_zone or jump, or what it is instead.
    """
    if case.jumps:
        return _by_jump(case)
    verdict = _by_maps(case)
    ends = case.fitted.prepared.ends
    if verdict.word != "none" or not ends:
        return verdict
    reason = f"readings stick at the ends of the range {ends}, and between them they need no zone"
    return because("saturation", reason)


def _by_maps(case: Case) -> Verdict:
    """The verdict by the readings between the ends of their range."""
    width = case.chosen.pairs.right + case.chosen.pairs.left
    winner = winning_rival(case.rivals)
    if 0 < width < 1.5 * case.quantum and winner in (None, "none", "jump"):
        steps = "the readings are rounded to steps that are larger than any zone"
        return because("none", f"{steps} ({case.quantum:.3g})")
    if winner not in (None, "none") and case.rivals[winner].rms < 1 - LEAST:
        if case.rivals[winner].strange:
            better = f"{MODELS[winner]} explains the log better than a dead zone"
            return because("other", f"{better}, but not fully either")
        return explains_better(winner)
    unclear = _unclear(case.chosen)
    if unclear is not None:
        return unclear
    if winner == "none":
        return explains_better("none")
    if case.no_zone.chance > NO_ZONE:
        return because("none", f"readings need no zone (p = {case.no_zone.chance:.2g})")
    return _by_residual(case)


def winning_rival(rivals: dict[str, Density]) -> str | None:
    """The static rival that beats the dead zone and every other; None if none does."""
    best = min(rivals.values(), key=lambda one: one.bic)
    beats = best.name != "dead_zone" and compare_statistic(best, rivals["dead_zone"]) > CLEARLY
    return best.name if beats else None


def _by_jump(case: Case) -> Verdict:
    """The verdict on a record that was taken for that of a jump sensor.

    Returns:
        jump, unless another map explains the readings better, or no plant does.
    """
    unclear = _unclear(case.chosen)
    if unclear is not None:
        return unclear
    jump = case.rivals["jump"]
    for name, rival in case.rivals.items():
        if name != "jump" and compare_statistic(rival, jump) > CLEARLY:
            return because("other", f"{MODELS[name]} explains the log better than a jump sensor")
    verdict = _by_residual(case)
    return verdict._replace(word="jump") if verdict.word == "dead_zone" else verdict


def _unclear(chosen: OrderFit) -> Verdict | None:
    """That nothing can be said, and why; None where something can."""
    if chosen.share < LEAST:
        share = f"{100 * max(chosen.share, 0.0):.0f} %"
        reason = (
            f"the best plant explains {share} of the held-out readings: are input and output the"
            " right columns? try more inputs, a higher --order, or a log with less disturbance"
        )
        return because("unclear", reason)
    if at_limit(chosen):
        reason = (
            "the plant seems to integrate, or to ring longer than the record: its state at the"
            " start and an offset or a sine cannot be told apart; say --integrators 1 if it is the"
            " position of a motor, or the like; else record for longer"
        )
        return because("unclear", reason)
    return None


def _by_residual(case: Case) -> Verdict:
    """dead_zone, unless a curve over z^ explains what it leaves."""
    residuals = case.residuals
    curve = f"a curve over z^ explains {100 * residuals.share:.0f} % of what"
    if is_strange(residuals.share, residuals.chance):
        return because("other", f"{curve} a dead zone leaves: another nonlinearity")
    verdict = because("dead_zone")
    if residuals.strange:
        verdict = verdict.with_cautions(f"{curve} the dead zone leaves: the fit is not perfect")
    if residuals.remembers:
        memory = "the residual depends on the direction of z^: a memory, perhaps play"
        verdict = verdict.with_cautions(memory)
    if not case.data.silent_zeros and not case.chosen.white:
        verdict = verdict.with_cautions("the one-step residual is not white")
    return verdict


# --- By what a linear plant behind a zone does not hold: a spring that bends, an offset


def unmodelled(verdict: Verdict, fit: Fit) -> Verdict:
    """The verdict, with what the model lacks where that has a name.

    Args:
        verdict: dead_zone, other or unclear, so far.
        fit: plant and zone.

    Returns:
        `other` where the readings inside the zone lie about another value than 0; a caution, or a
        reason why nothing is clear, where the plant's stiffness depends on z.
    """
    offset = None if verdict.word == "unclear" else offset_inside(fit)
    if offset is not None:
        value = offset * fit.objective.data.y_scale
        reason = (
            f"the readings inside the zone lie about {value:.4g}, not 0: a constant offset behind"
            f" the zone; take it away by --zero {value:.4g}"
        )
        return because("other", reason)
    if verdict.word == "other":
        return verdict
    share, chance, slope = cubic_share(fit)
    if share < SPRING or chance > CHANCE:
        return verdict
    how = "stiffer" if slope < 0 else "softer"
    words = (
        f"the cube of z^ as a force explains {100 * share:.0f} % of the one-step residual: the"
        f" plant is nonlinear, {how} far from 0, and its resonance depends on the amplitude"
    )
    if verdict.word == "unclear":
        return verdict._replace(reasons=[*verdict.reasons, words])
    return verdict.with_cautions(f"{words}; the widths may be off by more than their intervals")


def offset_inside(fit: Fit) -> float | None:
    """The mean reading well inside the zone, scaled; None where it is 0 or cannot be told.

    Args:
        fit: plant and zone; with noise behind the zone, else silence is exactly 0.
    """
    if fit.objective.kind != "behind":
        return None
    z, margin = fit.z, WELL_INSIDE * fit.s
    inside = fit.objective.readings.ok & (z < fit.right - margin) & (z > -fit.left + margin)
    y = fit.objective.data.y[inside]
    if y.size < 50:
        return None
    mean = float(y.mean())
    covariance, degrees = long_run_covariance((y - mean)[:, None])
    half = quantile(degrees, SURE) * math.sqrt(float(covariance[0, 0])) / y.size
    return mean if abs(mean) > max(half, RELEVANT * fit.s) else None


def cubic_share(fit: Fit) -> tuple[float, float, float]:
    """How much of the one-step residual a cubic spring explains.

    To first order a spring kappa z^3 beside the input changes z by -kappa G z^3, with G the plant
    from its first input. What changes of the plant's own numbers could do is taken out first.

    Args:
        fit: plant and zone.

    Returns:
        The share, p, and the coefficient of G z^3: negative for a spring that gets stiffer.
    """
    objective = fit.objective
    value, use = innovations(fit, objective.data.ok)
    slope = objective.simulator.gradient(fit.theta, fit.z)[:, objective.free]
    side = objective.data.side
    columns = np.column_stack([slope, 1.0 * (side > 0), -1.0 * (side < 0), _cube(fit)])
    whitened = columns.copy()
    whitened[1:] -= fit.rho * columns[:-1]
    rows = whitened[use]
    if len(rows) < 10 * columns.shape[1]:
        return 0.0, 1.0, 0.0
    others, cube = rows[:, :-1], rows[:, -1]
    cube = cube - others @ np.linalg.lstsq(others, cube, rcond=1e-10)[0]
    coefficients, _, share, chance = explained(cube[:, None], value[use])
    return share, chance, float(coefficients[0])


def _cube(fit: Fit) -> Floats:
    """G z^3 along the records (N)."""
    layout = fit.objective.layout
    denominator = np.append(1.0, layout.denominator(fit.theta[layout.a]))
    numerator = np.append(0.0, fit.theta[layout.b][: layout.n])
    out = np.empty(fit.z.size)
    for part in fit.objective.data.records():
        out[part] = lfilter(numerator, denominator, fit.z[part] ** 3)
    return out
