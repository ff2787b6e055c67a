"""From the signals of a run to a `Run`: its verdicts, its certificate, the tip of an arm."""

from __future__ import annotations

import math
import time
from typing import Any

import casadi as ca
import msgspec
import numpy as np

import undeadzone
from undeadzone.analysis.branch_schedule import Schedule, schedule_of_record
from undeadzone.analysis.certificate.passivity import Certificate, certify
from undeadzone.analysis.identifiability.disturbance import unknown_constants
from undeadzone.analysis.identifiability.linear import WidthIdentifiability
from undeadzone.errors import InputError
from undeadzone.feedforward.targets import flat_targets
from undeadzone.interfaces import Estimate
from undeadzone.nonlinearities.play import levels
from undeadzone.nonlinearities.sensor import DIRECTIONS, with_edges_beyond
from undeadzone.observers.contact import JERK, unknown_torques
from undeadzone.observers.contact_filter.drive import FADING
from undeadzone.plants.robots.arm import evaluate_rows
from undeadzone.plants.system import System
from undeadzone.results.info import Info, IntegrationError
from undeadzone.results.run import FRAMES, Run, last_samples, root_mean_square
from undeadzone.results.scales import plant_scales
from undeadzone.results.signals import RUN, Signals, signals_from_estimate
from undeadzone.scenario.operating_point import restore_signals
from undeadzone.scenario.problem import Problem, constant_gains
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.identifiability import (
    NONE,
    actuator_unknown,
    as_far_as_known,
    late_inputs,
    linear_verdicts,
    mark_excluded_widths,
    widths_with_unknown_actuator,
    with_cures,
    with_prior,
    withdrawn,
)
from undeadzone.simulation.loop import Outputs
from undeadzone.util import toml
from undeadzone.util.arrays import Floats
from undeadzone.util.files import SCHEMA

LEARNT = 1 / 5  # of the declared deviation, above which a gap is not known
SHARES = {"right_std": 1, "left_std": 1, "width_std": 4}  # of the variance of half a gap
WIDENED = 1.2  # factor of the deviation of a gap above that; 34 of 34 of fresh robots held with 1


def verdicts_of_run(
    problem: Problem, signal: Outputs
) -> tuple[list[WidthIdentifiability], Estimate]:
    """Return the identifiability of each output's widths from a run's readings, and its estimates.

    For a nonlinear plant they are determined along the run, given the observer's prior of its
    start.

    Args:
        problem: the simulated problem.
        signal: the outputs of the loop (a row per sample).
    """
    if problem.plant.gears is not None:
        return _verdicts_on_gaps(problem, signal)
    return _verdicts_on_widths(problem, signal), signal.estimate


def _verdicts_on_widths(problem: Problem, signal: Outputs) -> list[WidthIdentifiability]:
    """Return the identifiability of the widths of each output of a sensor or a play."""
    if problem.sensor.play is not None and (problem.plant.nonlinear or actuator_unknown(problem)):
        why = "a nonlinear plant" if problem.plant.nonlinear else "an actuator that is not known"
        return withdrawn(problem, f"no verdict was derived for a play and a dead zone behind {why}")
    if problem.plant.nonlinear:
        return mark_excluded_widths(problem, _verdicts_along(problem, signal))
    step = problem.scenario.simulation.step
    arrived = np.isfinite(signal.y)
    beyond = problem._replace(sensor=with_edges_beyond(problem.sensor, signal.z))
    schedule = schedule_of_record(signal.z, beyond.sensor, step, problem.model.Ts, arrived)
    if actuator_unknown(problem):
        found = _width_verdicts_beside_actuator(beyond, signal, schedule)
    else:
        found = linear_verdicts(beyond, schedule, np.ones(problem.model.p))
    return mark_excluded_widths(problem, found)


def _verdicts_on_gaps(
    problem: Problem, signal: Outputs
) -> tuple[list[WidthIdentifiability], Estimate]:
    """Return the identifiability of each joint's gears, and the estimates, of a run.

    Encoders at motors add nothing to it. A gap whose strikes hide is that of the replayed log, if
    this narrows it.
    """
    from undeadzone.analysis.identifiability.flanks import StrikeDetector, gap_identifiability
    from undeadzone.analysis.identifiability.replay import replay_gap

    plant = problem.plant
    gears = plant.gears
    path = problem.path
    step = problem.scenario.simulation.step
    model = problem.model
    told = model.gears
    estimate = signal.estimate
    assert gears is not None
    assert told is not None
    assert path is not None
    traits = problem.observer.traits
    N = gears.joint_count
    t = np.arange(len(signal.x)) * step
    along = np.stack([path.output_at(t, order) for order in range(3)], axis=1)
    unknown = traits.unknown
    if unknown is None:
        unknown = unknown_torques(model, gears, 0.0)[0]
    crossing = getattr(problem.scenario.controller, "crossing", math.inf)
    noise = problem.sensor.rms[-N:]
    detector = StrikeDetector(traits.groups or [range(N)], unknown, FADING, JERK, noise, crossing)
    log = (signal.y[:, -N:], signal.u, along)
    friction = getattr(problem.scenario.observer, "friction", 0.0)
    shift = np.zeros_like(estimate.right)
    added = np.zeros_like(estimate.right)

    def narrow(i: int) -> bool:
        """Return whether the replayed log narrows a gap."""
        if traits.halves is None:
            return False
        half = traits.halves[i]
        gap, std = replay_gap(told, model.params, i, log, detector, (half, friction), step)
        narrowed = _is_narrower(gap, std, half)
        if narrowed:
            shift[:, i] = (gap - estimate.right[:, i] - estimate.left[:, i]) / 2
            added[:, i] = (std**2 - estimate.width_std[:, i] ** 2) / 4
        return narrowed

    verdicts = gap_identifiability(gears, plant.params, signal.x, along, step, detector, narrow)
    if added.any():
        estimate = _change_gaps(estimate, shift, added)
    return verdicts * (plant.p // N), estimate


def _is_narrower(gap: float, std: float, half: Floats) -> bool:
    """Return whether a belief in a gap is narrower than the declared range [lo, hi] of half of it.

    It is, if its deviation times `WIDENED` is below that of the range, and below the way from the
    belief to the upper end: readings that ask for more than was declared contradict it (the first
    gap of an AgileX Piper came out as 60 for 20 mrad).
    """
    return bool(WIDENED * std < min(np.ptp(half) / np.sqrt(3), 2 * half[1] - gap))


def _change_gaps(estimate: Estimate, shift: Any, added: Any) -> Estimate:
    """Return estimates with half gaps larger by a shift, and with added variance (each N x p)."""
    changed = {"right": estimate.right + shift, "left": estimate.left + shift}
    for name, share in SHARES.items():
        changed[name] = np.sqrt(np.fmax(getattr(estimate, name) ** 2 + share * added, 0.0))
    return estimate._replace(**changed)


def withdraw_vague_gaps(
    problem: Problem, verdicts: list[WidthIdentifiability], estimate: Estimate
) -> list[WidthIdentifiability]:
    """Return the verdicts of a run, with a no for each gap that its filter has hardly learnt.

    Such a gap is narrowed if the filter's belief is narrower than the declared range.

    Args:
        problem: the simulated problem.
        verdicts: of each output.
        estimate: a row per sample.
    """
    ranges = problem.observer.traits.halves
    gears = problem.plant.gears
    if gears is None or ranges is None:
        return verdicts
    N = gears.joint_count
    declared = np.ptp(ranges, axis=1) / np.sqrt(3)  # of the whole gap, twice half of it
    after = []
    for i, verdict in enumerate(verdicts[:N]):
        std = estimate.width_std[-1, i]
        if verdict.width and 0 < LEARNT * declared[i] < std:
            why = (
                f"its strikes show, yet they left it uncertain by {std:.2g}, of {declared[i]:.2g}"
                " as it was declared: turn it faster, for longer, or declare less"
            )
            gap = estimate.right[-1, i] + estimate.left[-1, i]
            narrowed = _is_narrower(gap, std, ranges[i])
            verdict = verdict.add_reasons(why, **NONE, narrowed=narrowed)
        after.append(verdict)
    return after * (len(verdicts) // N)  # of encoders at motors as of those at links


def withhold_gaps(
    problem: Problem, verdicts: list[WidthIdentifiability], estimate: Estimate
) -> Estimate:
    """Return the estimates of a run, with the prior for each gap that cannot be known.

    A belief that nothing has tested may be false and narrow. A link behind such a gap may be
    anywhere in the widest one that is declared. Where a gap is narrowed, the belief stays, and its
    deviation and the link's are wider.

    Args:
        problem: the simulated problem.
        verdicts: of each output.
        estimate: a row per sample.
    """
    ranges = problem.observer.traits.halves
    gears = problem.plant.gears
    narrowed = np.array([verdict.narrowed for verdict in verdicts])
    lost = ~narrowed & [not verdict.width for verdict in verdicts]
    if gears is None or ranges is None:
        return estimate
    added = narrowed * (WIDENED**2 - 1) * estimate.width_std**2 / 4  # of half a gap
    wider = _change_gaps(estimate, 0.0, added)
    shown = {name: getattr(wider, name) for name in ("right", "left", *SHARES)}
    shown = {name: np.where(lost, signal[0], signal) for name, signal in shown.items()}
    N = gears.joint_count
    x_std = estimate.x_std.copy()
    links = np.sqrt(x_std[:, N : 2 * N] ** 2 + added[:, :N])
    widest = lost[:N] * ranges[:N, 1] / np.sqrt(3)
    x_std[:, N : 2 * N] = np.maximum(links, widest)
    return estimate._replace(**shown, x_std=x_std)


def _width_verdicts_beside_actuator(
    problem: Problem, signal: Outputs, schedule: Schedule
) -> list[WidthIdentifiability]:
    """Return the identifiability of each sensor's widths in a run with unknown actuator widths.

    The standard deviations are those of the filter after the last sample. That of the offset
    (d_r - d_l) / 2 follows from var(d_r - d_l) = 2 var d_r + 2 var d_l - var(d_r + d_l).

    Args:
        problem: the simulated problem.
        signal: the run.
        schedule: its branches.
    """
    by_output = widths_with_unknown_actuator(problem, signal, schedule)
    estimate = signal.estimate
    final_deviations = zip(
        estimate.right_std[-1], estimate.left_std[-1], estimate.width_std[-1], strict=True
    )
    verdicts = []
    for i, (right, left, width) in enumerate(final_deviations):
        centre = np.sqrt(max(2 * (right**2 + left**2) - width**2, 0.0)) / 2
        std = dict(zip(DIRECTIONS, map(float, (right, left, width, centre)), strict=True))
        verdicts.append(as_far_as_known(problem, schedule, by_output[i], i, std))
    return verdicts


def _verdicts_along(problem: Problem, signal: Outputs) -> list[WidthIdentifiability]:
    """Return the identifiability along a run of a nonlinear plant, given the prior of its start."""
    from undeadzone.analysis.identifiability.nonlinear import width_identifiability_along

    scenario = problem.scenario
    traits = problem.observer.traits
    simulation = scenario.simulation
    bias = unknown_constants(scenario.disturbance, problem.plant.m, simulation.duration)

    def width_verdicts(
        start_std: Floats | None, centre_std: Floats | None
    ) -> list[WidthIdentifiability]:
        return width_identifiability_along(
            problem.plant,
            signal.x,
            late_inputs(problem, signal),
            signal.z,
            problem.sensor,
            simulation.step,
            *bias,
            traits.uncertain,
            start_std,
            np.isfinite(signal.y),
            centre_std,
        )

    return with_cures(problem, with_prior(traits, width_verdicts), signal.z)


def tips(problem: Problem, x: Floats, x_hat: Floats, t: Floats) -> dict[str, Floats]:
    """Return true, estimated and reference position of an arm's tip [m], empty without an arm.

    Args:
        problem: the simulated problem.
        x, x_hat: state and its estimate (N x n).
        t: times (N) [s].

    Returns:
        tip, tip_hat and tip_r (N x 2 or 3 each).
    """
    body = problem.plant.arm
    if body is None or problem.path is None:
        return {}
    x_ref = flat_targets(problem.flow, problem.path, problem.tracked, t).x_ref
    return {
        "tip": _along(body.tip, problem.plant, x),
        "tip_hat": _along(body.tip, problem.model, x_hat),
        "tip_r": _along(body.tip, problem.model, x_ref),
    }


def _tip_errors(problem: Problem, x: Floats, signals: dict[str, Any]) -> list[float]:
    """Return rms distances from the tip of that estimated, and of that by the encoders alone [m].

    They are over the last samples, for gears read at the motors. For other plants the list is
    empty.

    Args:
        problem: the simulated problem.
        x: states (N x n).
        signals: of the run.
    """
    gears = problem.plant.gears
    if gears is None or gears.measured != "motor" or "tip" not in signals:
        return []
    last = last_samples(signals["t"])
    links = gears.link_params(problem.plant.params)
    blind = evaluate_rows(gears.arm.tip, links, x[last, : gears.joint_count])
    tip = signals["tip"][last]
    return [
        root_mean_square(np.hypot.reduce(each - tip, axis=1))
        for each in (signals["tip_hat"][last], blind)
    ]


def _along(f: ca.Function, system: System, x: Floats) -> Floats:
    """Return a function of an arm's parameters and joints, at each row of states (N x n)."""
    params, q = system.joints(system.params, x.T)
    return evaluate_rows(f, params, q.T)


def behind_play(problem: Problem, z: Floats) -> Floats | None:
    """Return the level of a play (N x p) [z], None without a play or if its gaps drift."""
    sensor = problem.sensor
    if sensor.kind != "play" or sensor.drift.any():
        return None
    return levels(z, sensor.right, sensor.left, sensor.start)


def _poses(problem: Problem, x: Floats, t: Floats) -> dict[str, Floats]:
    """Return the positions of an arm's base, joints and tip over time, empty without an arm."""
    body = problem.plant.arm
    if body is None:
        return {}
    frames = np.searchsorted(t, np.arange(0, t[-1] + 1e-9, 1 / FRAMES) - 1e-9)
    return {"poses": _along(body.points, problem.plant, x[frames])}


def certificate(problem: Problem) -> Certificate | None:
    """Return the proof that V never rises, for constant gains L, gamma on a linear model, else
    None.
    """
    gains = constant_gains(problem.observer, problem.model)
    if gains is None or problem.model.nonlinear:
        return None
    return certify(problem.model.linear, *gains, problem.model.Ts)


def collect(problem: Problem, signal: Outputs, error: IntegrationError | None, began: float) -> Run:
    """Return the run whose signals these are.

    Args:
        problem: the simulated problem.
        signal: the outputs of the loop (a row per sample).
        error: of the integration (None: not measured).
        began: reading of the performance counter when the run began [s].
    """
    t = np.arange(problem.steps + 1) * problem.scenario.simulation.step
    verdicts, estimate = verdicts_of_run(problem, signal)
    verdicts = withdraw_vague_gaps(problem, verdicts, estimate)
    estimate = withhold_gaps(problem, verdicts, estimate)
    given = signals_from_estimate(estimate)
    proof = certificate(problem)
    signals = {
        "t": t,
        "x": signal.x,
        "z": signal.z,
        "y": signal.y,
        "side": signal.side,
        "u": signal.u,
        "r": problem.reference.output_at(t),
        "V": _storage(problem, proof, signal.x - estimate.x, given["d_hat"]),
        "level": behind_play(problem, signal.z),
        **given,
        **tips(problem, signal.x, estimate.x, t),
        **_poses(problem, signal.x, t),
    }
    info = _info(problem, signal, verdicts, proof, error, began)
    info = msgspec.structs.replace(info, tips=_tip_errors(problem, signal.x, signals))
    return Run(info, Signals(RUN, restore_signals(problem.levels, signals)))


def _true_actuator(problem: Problem) -> list[float]:
    """Return true [right, left] of each actuator, or nothing if they are known or absent."""
    drive = problem.actuator
    belief = problem.belief
    if drive is None or belief is None or belief.ranges is None:
        return []
    return _in_turn(drive.right, drive.left)


def _true_gaps(problem: Problem, signal: Outputs) -> list[float]:
    """Return true [c_r, c_l] of each output, or nothing if they are known or absent."""
    if not signal.estimate.gap_std.shape[1]:
        return []
    play = problem.sensor.play
    return [0.0] * (2 * problem.plant.p) if play is None else _in_turn(play.right, play.left)


def _in_turn(right: Floats, left: Floats) -> list[float]:
    """Return right and left of each output or actuator in turn."""
    turns: list[float] = np.stack([right, left], axis=1).ravel().astype(float).tolist()
    return turns


def _storage(
    problem: Problem, proof: Certificate | None, x_error: Floats, d_hat: Floats
) -> Floats | None:
    """Return V along a run (N), or None without a proof.

    A width that is wrong and not adapted disturbs for ever: no V. The widths of a jump sensor do
    not enter.
    """
    gamma = problem.observer.traits.gamma
    if proof is None or not proof.certified or gamma is None:
        return None
    sensor = problem.sensor
    if sensor.kind != "jump":
        d_error = np.array(_in_turn(sensor.right, sensor.left)) - d_hat
    else:
        d_error = np.zeros_like(d_hat)
    adapted = np.repeat(gamma > 0, 2)
    if not (adapted | (d_error == 0)).all():
        return None
    return proof.V.evaluate_storage(x_error, d_error)


def _info(
    problem: Problem,
    signal: Outputs,
    verdicts: list[WidthIdentifiability],
    proof: Certificate | None,
    error: IntegrationError | None,
    began: float,
) -> Info:
    """Return the facts about a run besides its signals."""
    scenario = problem.scenario
    plant = problem.plant
    traits = problem.observer.traits
    scales = plant_scales(problem)
    absent = problem.sensor.absent
    return Info(
        title=scenario.title,
        method=str(type(scenario.observer).__struct_config__.tag),
        time=scenario.simulation.time,
        step=scenario.simulation.step,
        tracked=problem.tracked,
        widths=_in_turn(*np.where(absent, np.inf, [problem.sensor.right, problem.sensor.left])),
        threshold=problem.sensor.threshold.tolist(),
        certified=None if proof is None else proof.certified,
        integration_error=None if error is None else error.largest,
        integration_share=None if error is None else error.share,
        scales=[*map(float, scales.states), scales.output, scales.input],
        identifiable=list(map(_as_json, verdicts)),
        seconds=time.perf_counter() - began,
        units=scenario.units,
        uncertain={name: _parameter(plant, name) for name in traits.uncertain},
        joints=[] if plant.arm is None else list(plant.arm.chain.joints),
        adapts=traits.adapts,
        ranges=traits.ranges_in_turn,
        halves=[] if traits.halves is None else traits.halves.tolist(),
        sensor=problem.sensor.kind,
        actuator=_true_actuator(problem),
        gaps=_true_gaps(problem, signal),
        scenario=_text(scenario),
        version=undeadzone.__version__,
        schema=SCHEMA,
        seed=scenario.simulation.seed,
        gains=_gains(problem),
        options=list(scenario.observer.__struct_fields__),
        output_level=[] if problem.levels is None else problem.levels.z.tolist(),
        input_level=[] if problem.levels is None else problem.levels.u.tolist(),
    )


def _text(scenario: Scenario) -> str:
    """Return the scenario as TOML, empty if it contains a function of Python."""
    try:
        return toml.to_toml(scenario)
    except InputError:
        return ""


def _gains(problem: Problem) -> dict[str, list[Any]]:
    """Return the constant gains of observer and controller, by name."""
    traits = problem.observer.traits
    gains = {"L": traits.L, "gamma": traits.gamma, "K": problem.controller.K}
    return {name: np.asarray(gain).tolist() for name, gain in gains.items() if gain is not None}


def _parameter(plant: System, name: str) -> float:
    """Return the value of a named parameter of a plant, 0 for wear, of which plants are free."""
    return float(dict(zip(plant.names, np.ravel(plant.params), strict=False)).get(name, 0.0))


def _as_json(verdict: WidthIdentifiability) -> dict[str, Any]:
    """Return a verdict for JSON."""
    return verdict._asdict() | {"reasons": list(verdict.reasons)}
