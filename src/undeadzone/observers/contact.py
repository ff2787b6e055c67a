"""Contact filter for arms with encoders at motors, links or both, and with gaps in the gears.

Each joint is in one of three contacts, right flank, gap or left flank, and each combination is an
extended Kalman filter (`contact_filter.modes` has the mathematics). It finds link angles, gaps,
payload and friction on the way.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import chain, product
from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.interfaces import Estimate, Observer, Reading, Traits, build_estimate
from undeadzone.nonlinearities.limits import require_pairs
from undeadzone.nonlinearities.sensor import Zone, present
from undeadzone.numerics.clip import clip
from undeadzone.numerics.gaussian import Gaussian
from undeadzone.observers.contact_filter.drive import (
    FADING,
    LASTING,
    apply_gear_impulses,
    build_drive,
    contact_balance,
    group_couplings,
    group_entries,
    group_numbers,
    group_readings,
    isolate_joints,
    join_posteriors,
    mean_posture,
    mix_posteriors,
    update_group_numbers,
)
from undeadzone.observers.contact_filter.modes import (
    LONG,
    NONE,
    WEAR,
    Drive,
    Layout,
    Modes,
    Numbers,
    Posterior,
    correct_modes,
    normalise_weights,
    pack_modes,
    predict_modes,
    replace_diverged,
    start_modes,
)
from undeadzone.observers.filtering.consistency import BEYOND, Sums, accumulate_innovations
from undeadzone.observers.filtering.innovation_tests import assumption_fields
from undeadzone.observers.filtering.multiple_models import share_step_graph, update_weights
from undeadzone.plants.robots.geared import EVEN, Geared
from undeadzone.plants.system import System
from undeadzone.registry import Options
from undeadzone.util.arrays import (
    Array,
    Floats,
    require_array,
    require_nonnegative,
    require_number,
    require_positive,
)

FRICTION = ("friction", "f")  # Coulomb's, of motors and of links, as the plant names it
# Further numbers of gears that can be estimated, and the least that each can be.
SIGNED = dict.fromkeys(("asymmetry", "pull", "spring", "hardening", WEAR), -np.inf)
FURTHER = SIGNED | {"viscous": 0.0, "winding": 0.0, "drag": 0.0, "inertia": 0.0}
DRIFT = (3e-5, 4.5e-4)  # of half gaps, coupled and joint by joint [rad / sqrt(s)]
OPEN = 0.07  # deviation to which half gaps drift, over their claimed range
WANDERING = 2e-3  # random walk of an encoder's zero about the gears' centre [rad / sqrt(s)]
LOADED = 0.1  # of a payload, over its claimed range [1 / sqrt(s)]
MOST_COUPLED = 2  # joints with gaps, beyond which there are too many combinations
RESOLVED = 0.8  # largest product of a step of integration and the frequency of contact
LEAVING = 800.0  # rate at which a link leaves a flank that pulls [1/s]
COMPLIANCE = 3e-4  # deviation of where a flank is [rad]
JERK = 1e-3  # variance that the speed of a motor gains in a second [rad^2 / s^3]
STICKING = 0.03  # time for which what static friction takes lasts [s]
TURNING = 1 / 3  # deviation of the torque through the gears, over that unknown torque
RESTITUTION = 0.5  # share by which an impulse is off
LEAST_TORQUE = 0.01  # of what holds the links, least unknown torque
TURNED = 0.5  # by that, where nothing holds them [rad/s^2]
# Where filters begin of the claimed range of half the gap, as (middle, length) over its length.
STARTS = ((0.5, 1.0), (0.25, 0.5), (0.75, 0.5))
TRUSTED = 0.3  # share of what readings say of a filter that is counted: models are not quite right
DOUBTED = 0.1  # share of their odds by which starts that found other gaps widen a gap's interval
FAINTEST = 1e-26  # odds of a filter against the best one, however wrong it was
MEMORY = 0.2  # time over which innovations are summed [s]
PATIENCE = 1.0  # time over which the squares of the sums are averaged [s]
WIDENED = 1.3  # factor of the variance of a gap that is displayed joint by joint, at least
WINDOW = 0.2  # time over which the motion of a gap's estimate is compared with its variance [s]
JUMP = 4.0  # deviations, beyond which such a motion is more than chance
CHANCE = 4.0  # mean square of the sums that is taken for chance


class Contact(Options, frozen=True, kw_only=True, tag="contact"):
    """Contact filter of an arm with gears; sampled time.

    Attributes:
        half: claimed range [lo, hi] of half the gap, or one per joint [rad].
        payload: claimed range [lo, hi] of the payload [kg], within which it may change by a random
            walk of 0.1 of the range per sqrt(s); default: that of the model.
        centre: standard deviation of the gears' centre about the model's, one or one per joint
            [rad]: of an encoder's zero, and of its eccentricity, for which the centre walks by 2e-3
            rad/sqrt(s); 0: the zero was found at the link.
        friction: standard deviation of Coulomb friction of motors and links, as a share of the
            model's.
        contact: factor by which the frequency of the contacts is off the model's, in one standard
            deviation.
        noise: rms of a reading, one or one per encoder [rad]; default the sensor's.
        disturbance: rms of an unknown torque of the motors, one or one per joint [N m]; default 0.3
            of the model's friction, at least 0.6 % of the torque that holds the links.
        load: rms of an unknown torque at the links that lasts 10 ms, one or one per joint [N m];
            default 0.75 of their friction, at least 1 % of the torque that holds them; of separate
            joints, what makes 0.5 rad/s^2.
        drift: random walk of the half gaps up to a deviation of 0.07 of the claimed range
            [rad / sqrt(s)]; default 3e-5, of separate joints 4.5e-4.
        compliance: standard deviation of the place to which a flank gives way [rad].
        unknown: further numbers of the gears that are estimated, each with its range [lo, hi] or
            one per joint: winding [rad/(N m)], asymmetry, pull [N m], spring [N m/rad], hardening
            [N m/rad^3], viscous, drag [N m s/rad], inertia of the motor [kg m^2], and wear, the
            rate at which half a gap grows [rad/s].
        starts: how many filters a joint has, of which each counts by how well it foretold the
            readings: they begin with all of the range of half the gap, with its lower and with its
            upper half (1 to 3).
        joints: "separate" filters each joint for itself, to which the rest of the arm is known but
            for noise: 3 N combinations of contacts in place of 3^N.
        groups: of separate joints, pairs of names that one filter holds, of 9 combinations each;
            default: pairs that turn about nearly the same axis somewhere along the reference.
    """

    gears = True  # it knows them

    half: Array
    payload: Array | None = None
    centre: Array = 0.003
    friction: float = 0.6
    contact: float = 2.0
    noise: Array | None = None
    disturbance: Array | None = None
    load: Array | None = None
    drift: float | None = None
    compliance: float = COMPLIANCE
    unknown: dict[str, Array] = {}
    starts: int = len(STARTS)
    joints: Literal["coupled", "separate"] = "coupled"
    groups: Sequence[Sequence[str]] | None = None

    def build(self, model: System, sensor: Zone) -> Observer:
        """Return the filter for the sampled model of an arm with gears.

        Raises InputError, ShapeError.
        """
        gears = model.gears
        Ts = model.Ts
        if gears is None or Ts is None:
            raise InputError(
                "observer.method: 'contact' is for an arm with gears in sampled time. Give "
                "plant.arm.gears, or use 'extended'"
            )
        if gears.joint_count > MOST_COUPLED and self.joints == "coupled":
            raise InputError(
                f"observer.joints: {gears.joint_count} joints have {3**gears.joint_count} "
                "combinations of contacts, each a filter of its own. "
                f'Use joints = "separate" beyond {MOST_COUPLED}'
            )
        if not 1 <= self.starts <= len(STARTS):
            raise InputError(f"observer.starts: expected 1 to {len(STARTS)}, found {self.starts}")
        fastest = float(np.max(np.asarray(gears.gear_number(gears.values, "contact"))))
        substeps = int(np.ceil(Ts * fastest / RESOLVED))
        groups = self._read_groups(gears)
        ones: tuple[Geared, ...] = ()
        if len(groups) > 1:
            ones = tuple(isolate_joints(gears, group) for group in groups)
        further = tuple(self.unknown)
        for name in further:
            if name not in FURTHER:
                raise InputError(
                    f"observer.unknown.{name}: cannot be estimated. There are {', '.join(FURTHER)}"
                )
        drives = tuple(
            build_drive(one, Ts, substeps, bool(ones), further) for one in ones or (gears,)
        )
        first, numbers = self._build_numbers(model, gears, groups, drives, sensor)
        params = Params(
            first, numbers, sensor.slope, decay_factor(Ts, MEMORY), decay_factor(Ts, PATIENCE)
        )
        each = product((*FRICTION, *further), range(1, gears.joint_count + 1))
        uncertain = ("payload", *(f"{name}{joint}" for name, joint in each))
        halves = _read_joint_ranges("observer.half", self.half, gears.joint_count)
        traits = Traits(
            uncertain=uncertain,
            ranges=self._ranges_of_gaps(model, gears),
            halves=np.vstack([halves, np.zeros((model.p - gears.joint_count, 2))]),
            groups=groups,
            unknown=numbers.torque / TURNING,
        )
        layout = Layout(gears.joint_count, further)
        setup = Setup(groups, drives, ones, model, gears, sensor.kind, layout)
        return Observer(
            params,
            partial(_start_contact_filter, setup),
            partial(_step_contact_filter, setup),
            traits=traits,
        )

    def _read_groups(self, gears: Geared) -> Groups:
        """Return the joints of each filter, by number. Raises InputError."""
        names = list(gears.arm.chain.joints)
        if self.joints == "coupled":
            if self.groups:
                raise InputError(
                    'observer.groups: joints = "coupled" is one group. Use joints = "separate"'
                )
            return (tuple(range(gears.joint_count)),)
        found: list[tuple[int, ...]] = []
        for group in self.groups or ():
            known = all(name in names for name in group)
            if not known or len({*group}) != len(group) or not 1 <= len(group) <= MOST_COUPLED:
                raise InputError(
                    f"observer.groups: expected one or {MOST_COUPLED} different names of "
                    f"{', '.join(names)}, found {list(group)!r:.80}"
                )
            found.append(tuple(sorted(map(names.index, group))))
        joints_of_groups = [*chain.from_iterable(found)]
        if len({*joints_of_groups}) != len(joints_of_groups):
            raise InputError("observer.groups: a joint belongs to one group alone")
        found += [(joint,) for joint in range(gears.joint_count) if joint not in joints_of_groups]
        return tuple(sorted(found))

    def _ranges_of_gaps(self, model: System, gears: Geared) -> Floats:
        """Return the declared [lo, hi] of all d_r, then of all d_l (2p x 2) [rad].

        They are half of the gap, moved by the gears' centre, which may be off by three deviations.
        Encoders of motors, which hide nothing, come last.
        """
        N = gears.joint_count
        half = _read_joint_ranges("observer.half", self.half, N)
        middle = np.ravel(np.asarray(gears.gear_number(model.params, "centre"), float))[:, None]
        off = 3 * require_nonnegative("observer.centre", self.centre, N, "one per joint")[:, None]
        right, left = (half + sign * middle + off * [-1.0, 1.0] for sign in (1.0, -1.0))
        motors = np.tile([0.0, 1e300], (model.p - N, 1))
        return np.vstack([right, motors, left, motors])

    def _build_numbers(
        self,
        model: System,
        gears: Geared,
        groups: Groups,
        drives: tuple[Drive, ...],
        sensor: Zone,
    ) -> tuple[tuple[tuple[Modes, ...], ...], Numbers]:
        """Return the initial modes and the parameters of the filter.

        Raises InputError, ShapeError.
        """
        N = gears.joint_count
        layout = Layout(N, drives[0].layout.further)
        Ts = drives[0].Ts
        of = layout.slice_of
        values = model.params

        def gear_parameter(name: str) -> Floats:
            """Return a parameter of the gears in the model, per joint (N)."""
            return np.asarray(gears.gear_number(values, name), float).ravel()

        mean = np.zeros(layout.entry_count)
        std = np.zeros(layout.entry_count)
        Q = np.zeros(layout.entry_count)
        low = np.full(layout.entry_count, -1e300)
        high = np.full(layout.entry_count, 1e300)
        ranges = _read_joint_ranges("observer.half", self.half, N)
        mass = float(values[model.names.index("payload")])
        weight = [mass, mass] if self.payload is None else self.payload
        limits_of = {"half": ranges, "payload": _read_joint_ranges("observer.payload", weight, 1)}
        for name, limits in self.unknown.items():
            limits_of[name] = _read_joint_ranges(
                f"observer.unknown.{name}", limits, N, FURTHER[name]
            )
        for name, limits in limits_of.items():
            low[of(name)], high[of(name)] = limits.T
            mean[of(name)] = limits.mean(axis=1)
            std[of(name)] = (limits[:, 1] - limits[:, 0]) / np.sqrt(12)
        unknown, loads, inertia = unknown_torques(model, gears, float(mean[of("payload")][0]))
        apart = drives[0].apart
        if apart:
            loads = np.maximum(loads, TURNED * inertia)
        if self.disturbance is not None:
            unknown = require_positive("observer.disturbance", self.disturbance, N, "one per joint")
        if self.load is not None:
            loads = require_nonnegative("observer.load", self.load, N, "one per joint")
        share = require_number("observer.friction", self.friction, least=0.0)
        for name in FRICTION:
            mean[of(name)] = gear_parameter(name)
            std[of(name)] = share * gear_parameter(name)
            low[of(name)] = 0.0
        std[of("firmness")] = np.log(require_number("observer.contact", self.contact, least=1.0))
        high[of("firmness")] = 3 * std[of("firmness")]
        low[of("firmness")] = -high[of("firmness")]
        mean[of("centre")] = gear_parameter("centre")
        std[of("centre")] = require_nonnegative("observer.centre", self.centre, N, "one per joint")
        std[of("push")] = unknown
        std[of("motor")] = 0.02
        std[of("link")] = ranges[:, 1]
        std[of("motor_speed")] = std[of("link_speed")] = 0.05
        Q[of("motor_speed")] = JERK * Ts
        Q[of("link_speed")] = Ts * LASTING * (loads / inertia) ** 2
        Q[of("push")] = 2 * Ts / FADING * unknown**2
        drift = DRIFT[apart] if self.drift is None else self.drift
        Q[of("half")] = require_number("observer.drift", drift, least=0.0) ** 2 * Ts
        Q[of("centre")] = Ts * np.where(std[of("centre")] > 0, WANDERING, 0.0) ** 2
        Q[of("payload")] = Ts * (LOADED * (high - low)[of("payload")]) ** 2
        most = np.maximum(std**2, NONE)
        most[of("half")] = np.maximum((OPEN * np.ptp(ranges, axis=1)) ** 2, NONE)
        rms = sensor.rms if self.noise is None else self.noise
        slack = require_number("observer.compliance", self.compliance, above=0.0) ** 2
        first = []
        for group, drive in zip(groups, drives, strict=True):
            here = group_entries(layout, group)
            begins = []
            for middle, length in STARTS[: self.starts]:
                mean[of("half")] = ranges @ [1 - middle, middle]
                std[of("half")] = length * (ranges @ [-1, 1]) / np.sqrt(12)
                begins.append(start_modes(drive.layout, mean[here], std[here], slack))
            first.append(tuple(begins))
        return tuple(first), Numbers(
            model=values,
            Q=Q,
            R=require_positive("observer.noise", rms, model.p, "one per encoder") ** 2,
            low=low,
            high=high,
            most=most,
            slack=np.asarray(slack),
            torque=TURNING * unknown,
            leaving=np.asarray(1 - decay_factor(Ts, 1 / LEAVING)),
            impact=np.asarray(RESTITUTION),
            rest=STICKING * Ts / gear_parameter("inertia") ** 2,
            least=gear_parameter("friction"),
        )


Groups = tuple[tuple[int, ...], ...]  # joints of each filter, by number


class Params(NamedTuple):
    """Parameters of the observer.

    Attributes:
        start: the modes of each filter before the first reading, of all joints or of each.
        modes: of the filter of contacts.
        slope: of the encoders (p).
        fade: share of the sum of innovations that is left after a step.
        keep: share of the mean of its squares that is left after a step.
    """

    start: tuple[tuple[Modes, ...], ...]
    modes: Numbers
    slope: Floats
    fade: Floats
    keep: Floats


class State(NamedTuple):
    """State of the filter from sample to sample.

    Attributes:
        modes: of each filter, of all joints or of each.
        odds: log of their odds, 0 for the best.
        sums: of the innovations (p each).
        coupling: the largest of each joint to those of other filters so far (N; 0: one filter).
        jumps: of the half gaps (N; 0: one filter).
    """

    modes: tuple[tuple[Modes, ...], ...]
    odds: tuple[Any, ...]
    sums: Sums
    coupling: Any
    jumps: Jumps


class Jumps(NamedTuple):
    """Motion of the half gaps' estimates beyond chance.

    Attributes:
        age: samples since the window began (1).
        value, variance: of the half gaps when it began (N) [rad, rad^2].
        excess: variance of such motion so far (N) [rad^2].
    """

    age: Any
    value: Any
    variance: Any
    excess: Any


class Setup(NamedTuple):
    """Options shared by the functions of a filter.

    Attributes:
        groups: joints of each filter.
        drives: the plant as the filter needs it, of each group.
        ones: each group alone; none if there is one group.
        model: the model.
        gears: of the model.
        kind: of the sensor.
        layout: of all joints.
    """

    groups: Groups
    drives: tuple[Drive, ...]
    ones: tuple[Geared, ...]
    model: System
    gears: Geared
    kind: str
    layout: Layout


def decay_factor(Ts: float, time: float) -> Floats:
    """Return the factor per step of an exponential decay with a time constant [1]."""
    return np.asarray(np.exp(-Ts / time))


def _read_joint_ranges(key: str, ranges: Array, N: int, least: float = 0.0) -> Floats:
    """Return the assumed ranges [lo, hi] (N x 2), all of at least `least`. Raises InputError."""
    value = require_pairs(key, require_array(key, ranges), N, "a range [lo, hi]", "per joint")
    if (value[..., 0] > value[..., 1]).any() or (value < least).any():
        order = "lo <= hi" if least < 0 else "0 <= lo <= hi"
        raise InputError(f"{key}: a range needs {order}, found {value.tolist()}")
    return np.broadcast_to(value, (N, 2))


def unknown_torques(model: System, gears: Geared, payload: float) -> tuple[Floats, Floats, Floats]:
    """Return torques that may be unknown, of motors and links (N) [N m].

    The third result is the links' inertia (N).

    Args:
        model: the model.
        gears: of the model.
        payload: as it is taken for [kg].
    """
    N = gears.joint_count
    links = gears.link_params(model.params).copy()
    names = gears.arm.names
    links[names.index("payload")] = payload
    turned = np.linspace(-np.pi, np.pi, 8, endpoint=False)
    rest = np.zeros(N)
    holding_torques = [
        np.abs(np.asarray(gears.arm.bias(links, q * np.eye(1, N)[0], rest))) for q in turned
    ]
    inertia = np.diag(np.asarray(gears.arm.mass(links, rest)))
    least = LEAST_TORQUE * np.max(holding_torques, axis=0).ravel()
    least = np.where(least > 0, least, TURNED * inertia)
    motors, own = (np.asarray(gears.gear_number(model.params, name)).ravel() for name in FRICTION)
    return np.maximum(0.3 * motors, 0.6 * least), np.maximum(0.75 * own, least), inertia


def _start_contact_filter(setup: Setup, q: Params) -> State:
    """Return the state before the first reading."""
    none = np.zeros(setup.model.p)
    odds = tuple(np.zeros(len(begins)) for begins in q.start)
    coupling = np.ones(setup.gears.joint_count if setup.ones else 0)
    half = Layout(setup.gears.joint_count).slice_of("half") if setup.ones else slice(0)
    low, high = (np.asarray(limit)[half] for limit in (q.modes.low, q.modes.high))
    jumps = Jumps(np.zeros(1), (low + high) / 2, (high - low) ** 2 / 12, np.zeros(low.size))
    return State(q.start, odds, Sums(none, none, none + 1.0), coupling, jumps)


def _step_contact_filter(
    setup: Setup, q: Params, s: State, u: Any, reading: Reading
) -> tuple[State, Estimate]:
    """Return the next state and the estimate for a sample: correct, estimate, predict."""
    groups = setup.groups
    drives = setup.drives
    y = reading.y / q.slope
    layout = setup.layout
    parts = [group_numbers(q.modes, layout, group) for group in groups]
    rows = [group_readings(group, layout.size, y.numel()) for group in groups]
    readings = [y[here] for here in rows]
    each = []
    for drive, part, modes, read in zip(drives, parts, s.modes, readings, strict=True):
        before = [(part, one, read) for one in modes]
        each.append(share_step_graph(partial(correct_modes, drive), before, LONG))
    odds, shares = _weigh_filters(s.odds, each)
    each = list(map(replace_diverged, each))
    ones = list(map(mix_posteriors, each, shares))
    whole = join_posteriors(layout, groups, ones)
    started = ca.SX(y.numel(), 1)
    for here, modes in zip(rows, s.modes, strict=True):
        started[here] = modes[0].begun
    seen = ca.logic_and(present(y), started > 0.5)
    sums = accumulate_innovations(
        s.sums, ca.if_else(seen, whole.e / whole.std, 0.0), seen, q.fade, q.keep
    )
    ratios = {"gust": ca.mmax(sums.ratio) / CHANCE}
    ratios["range"] = BEYOND * (_count_range_limits(layout, q.modes, whole.whole) > 0)
    coupling = s.coupling
    jumps = s.jumps
    apart = variance_of_starts(layout, groups, each, odds, whole.whole.mean)
    if setup.ones:
        half = layout.slice_of("half")
        gaps = whole.whole.mean[half], ca.diag(whole.whole.cov)[half]
        jumps = accumulate_jumps(jumps, *gaps, q.modes.Q[half], WINDOW / drives[0].Ts)
        apart = ca.fmax(apart, gaps[1] + largest_of_groups(groups, jumps.excess))
    doubt = Doubt(coupling, apart)
    estimate = _to_contact_estimate(setup, q, ones, whole, doubt, reading)._replace(
        **assumption_fields(ratios)
    )
    if setup.ones:
        arm = mean_posture(layout, setup.gears, q.modes.model, whole.whole.mean, u)
        updated = [
            apply_gear_impulses(groups, filters, whole.news, arm)
            for filters in zip(*each, strict=True)
        ]
        each = list(map(list, zip(*updated, strict=True)))
        ones = list(map(mix_posteriors, each, shares))
        parts = update_group_numbers(groups, setup.ones, drives, parts, ones, arm)
        coupling = ca.fmax(coupling, group_couplings(groups, arm))
    after = []
    for k, (drive, part, modes) in enumerate(zip(drives, parts, s.modes, strict=True)):
        calls = [(part, one, u[list(groups[k])]) for one in each[k]]
        moved = share_step_graph(partial(predict_modes, drive), calls, LONG)
        pairs = zip(moved, modes, strict=True)
        after.append(tuple(pack_modes(drive, *pair, readings[k]) for pair in pairs))
    return State(tuple(after), odds, sums, coupling, jumps), estimate


def _weigh_filters(
    odds: Sequence[Any], each: Sequence[Sequence[Posterior]]
) -> tuple[tuple[Any, ...], list[tuple[Any, Any]]]:
    """Return the log odds after a sample, and the weights before and after.

    Each is for the filters of a joint.

    Args:
        odds: log odds before the sample, of each joint.
        each: evidence of the readings for each filter, of each joint.
    """
    after = []
    shares = []
    for before, filters in zip(odds, each, strict=True):
        logs = TRUSTED * ca.vertcat(*(one.log for one in filters))
        now, share = update_weights(before, logs, FAINTEST)
        shares.append((update_weights(before, 0.0, FAINTEST)[1], share))
        after.append(now)
    return tuple(after), shares


def _count_range_limits(layout: Layout, q: Numbers, belief: Gaussian) -> Any:
    """Return the number of gaps, payloads and firmnesses at a limit of their range (1)."""
    entries = layout.entries_of(("half", "payload", "firmness"))
    low = q.low[entries]
    high = q.high[entries]
    value = belief.mean[entries]
    return ca.sum1((high > low) * ((value <= low) + (value >= high)))


class Doubt(NamedTuple):
    """Reasons why gaps are less sure than a filter has it.

    Attributes:
        coupling: the largest of each joint to those of other filters so far (N; 0: one filter).
        variance: of the half gaps if the odds of the starts count for less, or beside their jumps
            (N) [rad^2].
    """

    coupling: Any
    variance: Any


def accumulate_jumps(before: Jumps, value: Any, variance: Any, walk: Any, window: float) -> Jumps:
    """Return the record of changes of half-gap estimates that are too large for chance.

    In a consistent filter, the variance of an estimate's change equals the variance that the
    estimate loses. If the change over a window exceeds `JUMP` such standard deviations, the filter
    has mistaken the contact at an impact, in this window or before. The excess variance is added
    up.

    Args:
        before: the record before the sample.
        value: estimate of the half gaps (N) [rad].
        variance: of its error (N) [rad^2].
        walk: variance by which a half gap wanders in a sample (N) [rad^2].
        window: samples of a window.
    """
    age = before.age + 1
    is_over = age >= window
    lost_variance = ca.fmax(before.variance - variance, 0.0) + walk * age
    squared_change = (value - before.value) ** 2
    is_jump = ca.logic_and(is_over, squared_change > JUMP**2 * lost_variance)
    return Jumps(
        age=ca.if_else(is_over, 0.0, age),
        value=ca.if_else(is_over, value, before.value),
        variance=ca.if_else(is_over, variance, before.variance),
        excess=before.excess + ca.if_else(is_jump, squared_change - lost_variance, 0.0),
    )


def largest_of_groups(groups: Groups, excess: Any) -> Any:
    """Return the largest excess variance in the group of each half gap (N) [rad^2].

    A contact that is mistaken at one joint moves every gap of its group.

    Args:
        groups: joints of each filter.
        excess: of each half gap (N) [rad^2].
    """
    largest = ca.SX(excess.numel(), 1)
    for group in map(list, groups):
        largest[group] = ca.mmax(excess[group])
    return largest


def variance_of_starts(
    layout: Layout,
    groups: Sequence[Sequence[int]],
    each: Sequence[Sequence[Posterior]],
    odds: Sequence[Any],
    mean: Any,
) -> Any:
    """Return the variance of the half gaps about those displayed, over all starts (N) [rad^2].

    A single strike that was misread may decide the odds by ten nats, so a share of them counts.

    Args:
        layout: of all joints.
        groups: joints of each filter.
        each: posteriors of the starts, of each group.
        odds: log of their odds, of each group.
        mean: of all unknowns, as displayed.
    """
    total = ca.SX.zeros(layout.size)
    mean_half = mean[layout.slice_of("half")]
    for group, starts, log in zip(groups, each, odds, strict=True):
        here = list(group)
        half = Layout(len(group)).slice_of("half")
        weights = normalise_weights(ca.vertsplit(ca.exp(DOUBTED * log)))
        for weight, one in zip(weights, starts, strict=True):
            off = one.whole.mean[half] - mean_half[here]
            total[here] += weight * (ca.diag(one.whole.cov)[half] + off**2)
    return total


def _to_contact_estimate(
    setup: Setup,
    q: Params,
    each: Sequence[Posterior],
    whole: Posterior,
    doubt: Doubt,
    reading: Reading,
) -> Estimate:
    """Return the estimate from the posterior of each filter and of all joints.

    Joint by joint, what others do to a link counts as noise, though it repeats from strike to
    strike. So variances of gaps are displayed larger by the coupling over EVEN, at least by
    WIDENED, up to those of their ranges. Starts that found other gaps add theirs, and so do jumps
    of a gap.
    """
    layout = setup.layout
    mean = whole.whole.mean
    N = layout.size
    of = layout.slice_of
    both = ca.SX.zeros(setup.model.p - N)  # of encoders at the motors too, which hide nothing
    half = mean[of("half")]
    centre = mean[of("centre")]
    right = ca.vertcat(half + centre, both)
    left = ca.vertcat(half - centre, both)
    xi = mean[:N] - mean[N : 2 * N] + centre
    unseen = 0.0
    if setup.gears.measured == "motor":  # a link that is not seen is never beyond a flank
        xi = clip(xi, -half, half)
        unseen = q.modes.slack
    link = mean[:N] + centre - xi
    x = ca.vertcat(mean[:N], link, mean[2 * N : 4 * N])
    cov = whole.whole.cov
    variances = ca.fmax(ca.diag(cov), 0.0)
    certain = variances[of("half")]
    shift = variances[of("centre")]
    both_ways = 2 * ca.diag(cov[of("half"), of("centre")])
    contact = ca.SX(N, 1)
    for group, drive, one in zip(setup.groups, setup.drives, each, strict=True):
        contact[list(group)] = contact_balance(drive, one)
    give = ca.vertcat(q.modes.slack * ca.SX.ones(N), both)
    z = setup.model.output(q.modes.model, x)
    estimate = build_estimate(x, z, right, left, reading, q.slope, setup.kind, whole.e)
    push = mean[of("push")] / setup.gears.gear_number(q.modes.model, "inertia")
    names = ("payload", *FRICTION, *layout.further)
    known = ca.fmin(variances[N : 2 * N], half**2 + variances[:N] + certain + shift)
    open_to = ca.fmax((q.modes.high - q.modes.low)[of("half")] ** 2 / 12, certain)
    wider = ca.fmax(doubt.coupling / EVEN, WIDENED) if setup.ones else 1.0
    wide = ca.fmin(ca.fmax(wider * certain, doubt.variance), open_to)
    return estimate._replace(
        x_std=ca.sqrt(ca.vertcat(variances[:N], known + unseen, variances[2 * N : 4 * N])),
        right_std=ca.sqrt(ca.vertcat(wide + shift + both_ways, both) + give),
        left_std=ca.sqrt(ca.vertcat(wide + shift - both_ways, both) + give),
        width_std=2 * ca.sqrt(ca.vertcat(wide, both) + give),
        innovation_std=whole.std,
        w=ca.vertcat(ca.SX.zeros(2 * N), push, ca.SX.zeros(N)),
        theta=ca.vertcat(*(mean[of(name)] for name in names)),
        theta_std=ca.sqrt(ca.vertcat(*(variances[of(name)] for name in names))),
        contact=ca.vertcat((contact > 0.5) - (contact < -0.5), both),
    )
