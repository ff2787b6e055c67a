"""Identifiability of a linear plant's widths from readings along a schedule, with deviations.

A simulation also knows the false ones among the assumed ranges, and the remedies for an arm.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final

import numpy as np

from undeadzone.analysis.branch_schedule import Schedule, reading_levels
from undeadzone.analysis.identifiability.disturbance import unknown_bias, unknown_inputs
from undeadzone.analysis.identifiability.indistinguishable import indistinguishable_widths
from undeadzone.analysis.identifiability.information import (
    EXACT,
    Deviations,
    ReadingConditions,
    optimal_deviations,
)
from undeadzone.analysis.identifiability.linear import (
    MARGIN,
    WidthIdentifiability,
    judge_widths,
    limit_to_deviations,
    width_identifiability,
)
from undeadzone.analysis.identifiability.nonlinear import prior_rows
from undeadzone.analysis.identifiability.two_elements import (
    actuator_modes,
    gap_and_width_information,
    sensor_actuator_identifiability,
)
from undeadzone.interfaces import Traits
from undeadzone.nonlinearities.actuator import Drive
from undeadzone.nonlinearities.play import gaps_of
from undeadzone.nonlinearities.sensor import DIRECTIONS
from undeadzone.observers.filtering.prior import read_width_ranges
from undeadzone.scenario.problem import Problem
from undeadzone.simulation.loop import Outputs
from undeadzone.util.arrays import LARGEST, Floats, shift_rows

ROUNDING: Final = 1e-9  # share of a gap by which an assumed one may miss it
NONE: Final[dict[str, Any]] = dict.fromkeys(DIRECTIONS, False)  # no width is known


def linear_verdicts(
    problem: Problem, schedule: Schedule, arrive: Floats
) -> list[WidthIdentifiability]:
    """Return the identifiability for a linear plant, by the same rule as for nonlinear plants.

    A width is known if the readings determine it and its expected deviation does not exceed it.

    Args:
        problem: the scenario's parts.
        schedule: of the sides.
        arrive: share of each output's readings that arrive (p).
    """
    linear = problem.model.linear
    if problem.sensor.kind == "jump":
        return width_identifiability(linear, schedule, constant_inputs(problem), jump=True)
    judge = _judge_zone if problem.sensor.play is None else _judge_both

    def verdicts(start_std: Floats | None, centre_std: Floats | None) -> list[WidthIdentifiability]:
        """Return the verdicts with a prior."""
        readings = readings_of(problem, schedule, arrive, start_std, centre_std)
        return judge(problem, schedule, readings)

    return with_prior(problem.observer.traits, verdicts)


def with_prior(
    traits: Traits, judge: Callable[[Floats | None, Floats | None], list[WidthIdentifiability]]
) -> list[WidthIdentifiability]:
    """Return the verdicts with an observer's prior, with a note on widths known by it alone.

    Args:
        traits: of the observer.
        judge: returns the verdicts with deviations of x(0) (n) and of centres (p), None if unknown.
    """
    alone = judge(None, None)
    sources = {"start": traits.start_std, "centre": traits.centre_std}
    names = [name for name, std in sources.items() if std is not None]
    if not names:
        return alone
    judged = []
    for without, verdict in zip(alone, judge(*sources.values()), strict=True):
        new = [name for name in DIRECTIONS if getattr(verdict, name) > getattr(without, name)]
        note = f"{', '.join(new)} from the declared {' and '.join(names)} alone"
        judged.append(verdict.add_reasons(note) if new else without)
    return judged


def _judge_zone(
    problem: Problem, schedule: Schedule, readings: ReadingConditions
) -> list[WidthIdentifiability]:
    """Return verdicts with the deviations of the widths, from the readings and the prior."""
    expected = optimal_deviations(problem.model.linear, schedule, readings)
    visited = schedule.branch_visits(problem.model.n)
    judged = []
    for i, verdict in enumerate(
        judge_widths(expected.hidden, schedule, visited, readings.prior is None)
    ):
        known = as_far_as_known(problem, schedule, verdict, i, expected.widths[i])
        judged.append(known._replace(second=_second(problem, expected, readings, i)))
    return judged


def _second(
    problem: Problem, expected: Deviations, readings: ReadingConditions, i: int
) -> dict[str, Any] | None:
    """Return another truth of output i with the same readings."""
    linear = problem.model.linear
    size = expected.hidden.scale.size
    n = linear.A.shape[0]
    widths = np.array([problem.sensor.right[i], problem.sensor.left[i]])
    enters = np.zeros((n, size))  # of each unknown into x'
    if readings.colour is not None:
        enters[:, n : expected.hidden.n] = readings.colour.B
    if readings.bias is not None:
        enters[:, size - readings.bias.shape[1] :] = readings.bias
    constants = np.linalg.lstsq(linear.B, enters, rcond=None)[0]
    found = expected.hidden, expected.covariance, i, widths
    return indistinguishable_widths(*found, np.eye(n, size), constants)


def _judge_both(
    problem: Problem, schedule: Schedule, readings: ReadingConditions
) -> list[WidthIdentifiability]:
    """Return the identifiability behind a play and a dead zone, as `_judge_zone` does."""
    judged = []
    play = problem.sensor.play
    assert play is not None
    for i, one in enumerate(gap_and_width_information(problem.model.linear, schedule, readings)):
        assert one.zone.std is not None
        zone = as_far_as_known(problem, schedule, one.zone, i, one.zone.std)
        gap = float(play.right[i] + play.left[i])
        if gap < one.gap_std < np.inf:
            zone = zone.add_reasons(
                f"the gap {gap:.3g} is not known: noise leaves it a deviation of {one.gap_std:.3g}"
            )
        judged.append(zone)
    return judged


def readings_of(
    problem: Problem,
    schedule: Schedule,
    arrive: Floats,
    start_std: Floats | None = None,
    centre_std: Floats | None = None,
) -> ReadingConditions:
    """Return the readings and the prior on the widths.

    Args:
        problem, schedule, arrive: as of `linear_verdicts`.
        start_std, centre_std: of the prior, as of `prior_rows`.
    """
    simulation = problem.scenario.simulation
    disturbance = problem.scenario.disturbance
    model = problem.model
    least = EXACT * float(schedule.levels.max(initial=0.0)) or EXACT
    prior = prior_rows(model.n, model.p, start_std, centre_std, least)
    return ReadingConditions(
        noise=problem.sensor.rms,
        step=simulation.step,
        duration=simulation.duration,
        arrive=arrive,
        bias=constant_inputs(problem),
        colour=unknown_inputs(disturbance, model.linear.B, simulation.duration),
        prior=prior if len(prior) else None,
        gaps_known=gaps_known(problem),
    )


def gaps_known(problem: Problem) -> bool:
    """Return whether the observer knows the gaps of the play ahead of a dead zone."""
    model = problem.scenario.model
    return model is None or model.play is None or gaps_of(model.play, problem.model.p)[1] is None


def withdrawn(problem: Problem, why: str) -> list[WidthIdentifiability]:
    """Return verdicts without identifiable widths, with the reason."""
    return [WidthIdentifiability(**NONE, reasons=(why,))] * problem.model.p


def as_far_as_known(
    problem: Problem,
    schedule: Schedule,
    verdict: WidthIdentifiability,
    i: int,
    std: dict[str, float],
) -> WidthIdentifiability:
    """Return the verdict on output i with deviations of its widths, unknown if smaller than those.

    Args:
        problem: the scenario's parts.
        schedule: of the sides.
        verdict: identifiability from the readings alone.
        i: the output.
        std: deviations by name.
    """
    widths = problem.sensor.right[i], problem.sensor.left[i]
    swing = float(schedule.high[i] - schedule.low[i])
    return limit_to_deviations(verdict, std, *widths, swing)


def actuator_unknown(problem: Problem) -> bool:
    """Return whether the actuator's widths are to be estimated, of a linear plant."""
    belief = problem.belief
    return belief is not None and belief.ranges is not None and not problem.plant.nonlinear


def widths_with_unknown_actuator(
    problem: Problem, signal: Outputs, schedule: Schedule
) -> list[WidthIdentifiability]:
    """Return the identifiable widths of the sensor in a run with unknown actuator widths.

    Args:
        problem: the simulated problem.
        signal: the outputs of the loop (a row per sample).
        schedule: of the sensor's sides along it.
    """
    linear = problem.model.linear
    belief = problem.belief
    assert belief is not None
    drive = belief.drive if problem.actuator is None else problem.actuator
    visible = (np.abs(signal.side) == 1).any(axis=1) & np.isfinite(signal.y).all(axis=1)
    modes = actuator_modes(late_inputs(problem, signal), visible, drive, linear.A.shape[0])
    return sensor_actuator_identifiability(
        linear, schedule, modes, drive, constant_inputs(problem)
    ).outputs


def late_inputs(problem: Problem, signal: Outputs) -> Floats:
    """Return the inputs of a run at the samples at which they act on the plant (N x m)."""
    return shift_rows(signal.u, problem.plant.delay, np.zeros(1, int))


def constant_inputs(problem: Problem) -> Floats | None:
    """Return the columns of B on which the scenario's disturbance leaves an unknown constant."""
    scenario = problem.scenario
    duration = scenario.simulation.duration
    return unknown_bias(scenario.disturbance, problem.model.linear.B, duration)


def mark_excluded_widths(
    problem: Problem, verdicts: Sequence[WidthIdentifiability]
) -> list[WidthIdentifiability]:
    """Return the verdicts. Widths outside their assumed range are unknown, as no reading corrects
    them.

    Args:
        problem: the scenario's parts.
        verdicts: on the widths of each output (p).
    """
    options: Any = problem.scenario.observer
    has_ranges = {"right", "left"} <= set(getattr(options, "__struct_fields__", ()))
    if not has_ranges or not problem.observer.traits.adapts:
        return list(verdicts)
    p = len(verdicts)
    ranges = read_width_ranges(options.right, options.left, p)
    judged = []
    for i, verdict in enumerate(verdicts):
        for side, (low, high) in (("right", ranges[i]), ("left", ranges[p + i])):
            width = getattr(problem.sensor, side)[i]
            if width == LARGEST:  # the other edge is all that there is
                every: dict[str, Any] = dict.fromkeys(DIRECTIONS, True)
                if verdict.right or verdict.left:
                    verdict = verdict._replace(**every, reasons=())
            elif not low <= width <= high:
                reason = (
                    f"a false assumption: the {side} width is {width:.4g}, observer.{side} says "
                    f"{low:.4g} to {high:.4g}"
                )
                found = {side: False, "width": False, "centre": False}
                verdict = verdict.add_reasons(reason, **found)
        for false in _false_assumptions(problem, i):
            verdict = verdict.add_reasons(f"a false assumption: {false}", **NONE)
        judged.append(verdict)
    return judged


def _false_assumptions(problem: Problem, i: int) -> Iterator[str]:
    """Yield what [model] says of gaps and actuators that is false, and hides widths of output i."""
    play, model = problem.sensor.play, problem.scenario.model
    if play is not None and model is not None and model.play is not None:
        true = np.stack([play.right, play.left])
        gaps = gaps_of(model.play, problem.model.p, "model.play")
        if not _meets_assumptions(true, *gaps)[:, i].all():
            yield f"model.play excludes the gaps of the sensor, {true[:, i].tolist()}"
    actuator, belief = problem.actuator, problem.belief
    if actuator is not None and belief is not None:
        true, assumed = map(_gaps_or_widths, (actuator, belief.drive))
        if not (actuator.is_play or belief.drive.is_play):
            true, assumed = true[:2], assumed[:2]
        if not _meets_assumptions(true, assumed, belief.ranges).all():
            yield f"model.actuator excludes the actuator's widths, {true.tolist()}"


def _gaps_or_widths(drive: Drive) -> Floats:
    """Return widths and gaps of an actuator (4 x m). It has the ones or the others."""
    gaps = [drive.gap_right, drive.gap_left] if drive.is_play else [0 * drive.right] * 2
    return np.stack([drive.right, drive.left, *gaps])


def _meets_assumptions(true: Floats, assumed: Floats, ranges: Floats | None) -> np.ndarray:
    """Return whether true [right, left] (2 x each) equal assumed ones or lie in their ranges."""
    low, high = (assumed, assumed) if ranges is None else ranges.T.reshape(2, *true.shape)
    slack = ROUNDING * true
    return np.asarray((low - slack <= true) & (true <= high + slack))


def with_cures(
    problem: Problem, verdicts: Sequence[WidthIdentifiability], z: Floats
) -> list[WidthIdentifiability]:
    """Return the verdicts on an arm, each with a remedy if the motion passes one edge or none.

    Args:
        problem: the scenario's parts.
        verdicts: on the widths of each output (p).
        z: the outputs along the run (N x p).
    """
    options = problem.scenario.plant.arm
    if options is None or getattr(options, "measured", "") == "velocity":
        return list(verdicts)
    offset = np.broadcast_to(np.asarray(options.reference, float), z.shape[1])
    levels = reading_levels(problem.sensor)
    cured = []
    for i, verdict in enumerate(verdicts):
        where = "plant.arm.reference" + (f"[{i}]" if z.shape[1] > 1 else "")
        cure = _cure(where, z[:, i], float(offset[i]), *map(float, levels[i]))
        cured.append(verdict.add_reasons(*cure))
    return cured


def _cure(where: str, z: Floats, offset: float, right: float, left: float) -> list[str]:
    """Return the remedy, a position of the sensor's 0, empty if both edges are passed.

    Args:
        where: its key.
        z: the output along the run (N).
        offset: the position.
        right, left: from where on the sensor reads something, its threshold included.
    """
    if not np.isfinite(z).all():
        return []
    least = float(z.min())
    most = float(z.max())
    if least < -left and most > right:
        return []
    lowest = least + offset + left * (1 + MARGIN)
    highest = most + offset - right * (1 + MARGIN)
    if lowest < highest:
        return [
            f"{where} = {(lowest + highest) / 2:.4g} would do, as any from {lowest:.4g} to "
            f"{highest:.4g}: there the sensor reads 0, and this motion passes both edges"
        ]
    return [
        f"this motion, {most - least:.3g} wide, is too narrow for both edges of a zone of "
        f"{right + left:.3g}, whatever {where} is: move further"
    ]
