"""Interfaces of observers, controllers and compensators, with the data that they exchange."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from typing import Any, Final, Literal, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.feedforward.targets import Target
from undeadzone.nonlinearities.limits import Limits, is_beyond_range
from undeadzone.nonlinearities.sensor import inverse, present, side
from undeadzone.util import tree
from undeadzone.util.arrays import Floats
from undeadzone.util.files import read_table


class Reading(NamedTuple):
    """Reading of the sensor at a sample.

    Attributes:
        y: reading (p), NaN if it is missing, infinite beyond its range.
        side: measured side (p): +1 right, -1 left, 0 silent or missing, +2, -2 at the upper, lower
            limit of the range, at which y only bounds the sensor's output.
        x: true state (n), which only a simulation has, for the reference line `full_state` (None
            elsewhere).
        level: reading from which silence is measured (p): 0 of a dead zone, y itself of a play.
        rms: of the error of y (p) [y], if the reading itself contains it (None: the sensor's).
        motion: contact of a play ahead of a dead zone in which y moves (p): +1 right, -1 left, 0 if
            it holds (None: there is none).
    """

    y: Any
    side: Any
    x: Any = None
    level: Any = 0.0
    rms: Any = None
    motion: Any = None


def to_reading(y: Any, threshold: Any, limits: Limits | None) -> Reading:
    """Return a reading from outside as a `Reading` (p).

    A value that is not a number counts as missing.

    Args:
        y: reading (p) [y], a CasADi expression.
        threshold: |y| that counts as silent (p) [y].
        limits: of the range (None: there are none).
    """
    seen = ca.if_else(present(y), y, np.nan)
    if limits is None:
        return Reading(seen, side(seen, threshold))
    seen = ca.if_else(is_beyond_range(y, limits), np.nan, seen)
    side_read = side(seen, threshold, limits)
    return Reading(ca.if_else(is_beyond_range(y, limits), np.inf, seen), side_read)


def sample_branch(reading: Reading, estimate: Any) -> Any:
    """Return the branch of a sample (p): by the observer for a backlash, or by the reading.

    Args:
        reading: the reading.
        estimate: the observer's estimate.
    """
    return estimate.contact if estimate.contact.shape[0] else reading.side


def drop_limit_readings(reading: Reading, limits: Limits | None) -> Reading:
    """Return the reading with values at a limit marked as missing, for methods without bounds."""
    if limits is None:
        return reading
    at_limit = ca.fabs(reading.side) > 1
    y = ca.if_else(at_limit, np.nan, reading.y)
    return reading._replace(y=y, side=ca.if_else(at_limit, 0.0, reading.side))


def clip_expected_reading(expected: Any, y: Any, side: Any) -> Any:
    """Return the expected reading, clipped at a reading at a limit of its range [y].

    An expected value beyond a limit does not contradict a reading at the limit.

    Args:
        expected: reading that was expected [y].
        y: reading [y].
        side: measured side.
    """
    below = ca.if_else(side > 1, ca.fmin(expected, y), expected)
    return ca.if_else(side < -1, ca.fmax(expected, y), below)


NONE: Any = ca.SX(0, 1)


class Quantity(NamedTuple):
    """Meaning, unit and display of a field of an estimate, for runs, logs, tables and exports.

    Attributes:
        meaning: in words.
        unit: quantity whose unit it has: an output, input or state, or a state's rate (1: no unit).
        signal: of a run that holds it, in turn with the others of the same signal (empty: none).
        final: form of its last value in a summary: "float", one number each, "int", their sum, or
            "bool", whether all of them hold (empty: not at all).
        column: its name in columns of a table (empty: as the field).
    """

    meaning: str
    unit: Literal["output", "input", "state", "rate", "1"]
    signal: str = ""
    final: Literal["float", "int", "bool", ""] = ""
    column: str = ""


class Estimate(NamedTuple):
    """Estimate of an observer after a reading.

    A field is empty if the observer does not estimate the quantity.

    The fields are CasADi expressions on a graph, NumPy arrays in a run or live. A new one is an
    entry here: runs, logs, tables and exports take it by its `Quantity`.

    Attributes:
        x: state x^ (n).
        z: output z^ = C x^ (p).
        right, left: widths d_r^, d_l^ (p).
        z_inverse: dead-zone inverse y + chi_bar d^ of (26) (p).
        innovation: the reading less its prediction (p).
        x_std: standard deviation of x^ (n).
        right_std, left_std: standard deviations of d_r^, d_l^ (p).
        width_std: standard deviation of d_r^ + d_l^ (p).
        innovation_std: standard deviation of the innovation (p).
        w: effects that the model leaves out (n), x' = f(x, u) + w.
        theta: parameters of the model that the observer estimates.
        theta_std: standard deviations of theta.
        consistent: 1 if recent readings fit the observer's assumptions, else 0 (1).
        claims: bits of the `ASSUMPTION_CHECKS` that recent readings reject (1).
        suspect: number of the most suspect one, from 1 on, 0 if all hold (1).
        refused: readings that were taken for wrong so far (p).
        restarts: how often the observer lost its state and began anew (1).
        contact: the side of a play that the observer made out itself (p).
        actuator_right, actuator_left: widths b_r^, b_l^ of the actuators (m).
        actuator_right_std, actuator_left_std: their standard deviations (m).
        gap_right, gap_left: gaps c_r^, c_l^ of a play ahead of a dead zone (p).
        gap_right_std, gap_left_std: their standard deviations (p).
        gap_std: standard deviation of c_r^ + c_l^ (p).
        noise, noise_assumed: rms of a reading outside the zone, as learnt and as assumed (p).
        low, high: interval of z (p).
        quality: 2 if z was measured, 1 if a reading only bounds it, 0 without a reading that counts
            (p).
    """

    x: Any
    z: Any
    right: Any
    left: Any
    z_inverse: Any
    innovation: Any
    x_std: Any = NONE
    right_std: Any = NONE
    left_std: Any = NONE
    width_std: Any = NONE
    innovation_std: Any = NONE
    w: Any = NONE
    theta: Any = NONE
    theta_std: Any = NONE
    consistent: Any = NONE
    claims: Any = NONE
    suspect: Any = NONE
    refused: Any = NONE
    restarts: Any = NONE
    contact: Any = NONE
    actuator_right: Any = NONE
    actuator_left: Any = NONE
    actuator_right_std: Any = NONE
    actuator_left_std: Any = NONE
    gap_right: Any = NONE
    gap_left: Any = NONE
    gap_right_std: Any = NONE
    gap_left_std: Any = NONE
    gap_std: Any = NONE
    noise: Any = NONE
    noise_assumed: Any = NONE
    low: Any = NONE
    high: Any = NONE
    quality: Any = NONE


class AssumptionCheck(NamedTuple):
    """Words for an assumption of an observer that the readings reject.

    Attributes:
        words: description of the readings.
        look: what to look at, if there is anything besides keys to change.
        change: what to do with the keys.
        keys: of a scenario. A method takes some of those of its observer.
    """

    words: str
    look: str = ""
    change: str = "raise"
    keys: Sequence[str] = ()

    def cure(self, options: Collection[str] = ()) -> str:
        """Return the remedy as a phrase, such as `raise observer.noise or sensor.noise`.

        Args:
            options: names of the keys that the method has (empty: all of them).
        """
        keys = []
        for key in self.keys:
            table, name = key.split(".")
            if table != "observer" or not options or name in options:
                keys.append(key)
        first = ", ".join(keys[:-1])
        change = f"{self.change} {first}{' or ' * bool(first)}{keys[-1]}" if keys else ""
        return ", or ".join(filter(None, (self.look, change)))


_TABLES: Final = read_table(__file__)
ASSUMPTION_CHECKS: Final = {
    name: AssumptionCheck(**words) for name, words in _TABLES["assumption"].items()
}
"""What readings may refute, in the order of the bits of `Estimate.claims`."""


def list_rejected_assumptions(bits: float, suspect: float) -> list[str]:
    """Return the names of the rejected assumptions, the likeliest first.

    Args:
        bits: `Estimate.claims`.
        suspect: `Estimate.suspect`.
    """
    names = list(ASSUMPTION_CHECKS)
    found = [name for k, name in enumerate(names) if int(bits) >> k & 1]
    return sorted(found, key=lambda name: names.index(name) != suspect - 1)


def describe_rejected_assumptions(names: Sequence[str], options: Collection[str] = ()) -> list[str]:
    """Describe the likeliest rejected assumption with its remedy, then list the rest.

    Args:
        names: of the rejected assumptions, the likeliest first.
        options: names of the keys that the method takes (empty: all of them).
    """
    further = ["the same readings contradict " + ", ".join(names[1:])] if names[1:] else []
    first = [ASSUMPTION_CHECKS[name] for name in names[:1]]
    return [f"{check.words}: {check.cure(options)}" for check in first] + further


MOST_SQUARE: Final = 1.5
"""Mean square of normalised errors of readings that still agrees with the assumed noise."""


def describe_noise(found: Iterable[float], assumed: Iterable[float]) -> str:
    """Describe the noise of outputs whose readings have more of it than assumed, or return ''."""
    pairs = zip(found, assumed, strict=True)
    louder = [pair for pair in pairs if pair[0] ** 2 > MOST_SQUARE * pair[1] ** 2]
    return "; ".join(f"{one:.2g} found, {other:.2g} assumed" for one, other in louder)


UNKNOWNS: Final = {"bias": "a constant at the input", "tolerance": "an error of the model"}
"""Effects that filters may allow for, by the key of an observer."""


def describe_unknowns(options: Collection[str]) -> str:
    """Describe the effects that a filter cannot allow for, empty if it allows for all.

    Args:
        options: names of the keys that the method takes. A method without `disturbance` makes no
            assumption about it, and one with `uncertain` knows errors of its model.
    """
    if "disturbance" not in options:
        return ""
    accepted = {*options, *(["tolerance"] if "uncertain" in options else [])}
    missing = [
        f"{words} (observer.{key})" for key, words in UNKNOWNS.items() if key not in accepted
    ]
    if not missing:
        return ""
    return (
        f"this method has no option for {' or '.join(missing)}: if there is one, intervals "
        "are too narrow. 'censored' and 'auto' have it"
    )


QUANTITIES: Final = {name: Quantity(**words) for name, words in _TABLES["quantity"].items()}
"""What each field of an estimate is, by its name."""

COLUMNS = Estimate(*(quantity.column or name for name, quantity in QUANTITIES.items()))
"""What the columns of a table call each field of an estimate, beside the signals of the plant."""


class Traits(NamedTuple):
    """Properties of an observer for checks, certificates and figures.

    Attributes:
        L: gain of the innovation in x^ (n x p), per step when the model is sampled (None: it
            varies).
        gamma: gain of the innovation in the widths (p), per step when the model is sampled (None:
            it varies, or no width is adapted).
        constant: whether x^' = f(x^, u) + L e, d_r^' = -gamma e on the right, d_l^' = gamma e on
            the left is all that it does, so that (30) can prove it.
        rate: fastest rate of its own that a step must resolve [1/s], beside those of L and gamma.
        width_max: upper bound d_M of the widths (p), onto which they are projected.
        adapts: whether it estimates the widths.
        knows_widths: whether it begins with the sensor's true widths.
        uncertain: names of the model's parameters that it estimates, as theta.
        start_std: standard deviation of x(0) about the assumed start (n) (None: no start is
            assumed).
        centre_std: standard deviation of each assumed (d_r - d_l)/2 (p), infinite without an
            assumption (None: none).
        ranges: declared [lo, hi] of all d_r, then of all d_l (2p x 2) [z] (None: only that they are
            not negative).
        halves: of an arm with gears, declared [lo, hi] of half the gap at each output (p x 2)
            (None: the method estimates no gaps).
        groups: of an arm with gears, joints that one filter holds (empty: all of them).
        unknown: of an arm with gears, rms of the unknown torque of its motors (N) [N m] (None: the
            method has no assumption).
    """

    L: Floats | None = None
    gamma: Floats | None = None
    constant: bool = False
    rate: float | None = None
    width_max: Floats | None = None
    adapts: bool = True
    knows_widths: bool = False
    uncertain: tuple[str, ...] = ()
    start_std: Floats | None = None
    centre_std: Floats | None = None
    ranges: Floats | None = None
    halves: Floats | None = None
    groups: tuple[tuple[int, ...], ...] = ()
    unknown: Floats | None = None

    @property
    def ranges_in_turn(self) -> list[list[float]]:
        """Return the declared [lo, hi] of d_r and d_l of each output in turn, empty without any."""
        if self.ranges is None:
            return []
        right, left = np.split(self.ranges, 2)
        return np.stack([right, left], axis=1).reshape(-1, 2).tolist()


class PythonObserver(NamedTuple):
    """Functions of an observer that computes in Python (sampled time only).

    No graph of fixed size exists for the observer.

    States are values: nothing else is changed.

    Attributes:
        start: start(seed) is the state at t = 0.
        correct: correct(state, reading) is (state, Estimate), both of NumPy arrays.
        predict: predict(state, u) is the state at the next sample.
    """

    start: Callable[[int], Any]
    correct: Callable[[Any, Reading], tuple[Any, Estimate]]
    predict: Callable[[Any, Floats], Any]


class Observer(NamedTuple):
    """Observer as pure functions on CasADi expressions.

    Attributes:
        params: tree of NumPy arrays.
        init: init(params) is the state at t = 0, a tree of NumPy arrays.
        step: step(params, state, u, reading) is (the state's derivative, or its next value when the
            model is sampled, and the `Estimate`, which must not depend on u).
        project: project(params, state) is the nearest admissible state (init gives one, and so does
            step when the model is sampled).
        traits: properties for checks, certificates and figures.
        smoothing: data for smoothing of a whole log, of type `Smoothing` (None: it has no
            smoother).
        python: functions of an observer that computes in Python (its graph only passes the estimate
            on, which is its state there). None: the graph is the observer.
    """

    params: Any
    init: Callable[[Any], Any]
    step: Callable[[Any, Any, Any, Reading], tuple[Any, Estimate]]
    project: Callable[[Any, Any], Any] = lambda params, state: state
    traits: Traits = Traits()
    smoothing: Any = None
    python: PythonObserver | None = None


class Plan(NamedTuple):
    """Quantities that a controller computes with NumPy from the whole reference before a run.

    Attributes:
        size: numbers per instant, such as gains or accelerations.
        params: tree of NumPy arrays.
        along: along(params, targets), with a row per instant, is an array (instants x size) whose
            rows `step` finds in `target.plan`.
    """

    size: int
    params: Any
    along: Callable[[Any, Target], Floats]


class Controller(NamedTuple):
    """Controller as pure functions on CasADi expressions.

    Attributes:
        params: tree of NumPy arrays.
        init: init(params) is the state at t = 0 (None: no state).
        step: step(params, state, estimate, target) is (the state's derivative, or its next value
            when the model is sampled, and u).
        plan: function that it computes ahead of a run, if any.
        K: constant state feedback u = -K x^ + ... (m x n) (None: there is none).
        rate: fastest rate of its own that a step must resolve [1/s].
    """

    params: Any
    init: Callable[[Any], Any]
    step: Callable[[Any, Any, Estimate, Target], tuple[Any, Any]]
    plan: Plan | None = None
    K: Floats | None = None
    rate: float | None = None

    @property
    def plan_size(self) -> int:
        """Return the number of values per instant that are computed before a run."""
        return 0 if self.plan is None else self.plan.size


class Compensator(NamedTuple):
    """Compensator of an actuator as pure functions on CasADi expressions.

    Attributes:
        params: tree of NumPy arrays.
        init: init(params) is the state at t = 0 (None: no state).
        step: step(params, state, v, estimate, reading) is (the state at the next sample, the
            command u (m)), v what should enter the plant (m).
    """

    params: Any
    init: Callable[[Any], Any]
    step: Callable[[Any, Any, Any, Estimate, Reading], tuple[Any, Any]]


def build_estimate(
    x: Any, z: Any, right: Any, left: Any, reading: Reading, slope: Any, kind: str, innovation: Any
) -> Estimate:
    """Return an `Estimate` with its dead-zone inverse. The inverse of a missing sample is z^.

    Args:
        x: state x^ (n).
        z: output z^ (p).
        right, left: widths d_r^, d_l^ (p).
        reading: the reading.
        slope: slope m of the sensor (p).
        kind: kind of the sensor.
        innovation: the reading less its prediction (p).
    """
    inverted = inverse(reading.y, reading.side, right, left, slope, kind)
    return Estimate(x, z, right, left, ca.if_else(present(reading.y), inverted, z), innovation)


def build_python_observer(how: PythonObserver, p: int, traits: Traits) -> Observer:
    """Return the observer of functions that compute in Python, sample by sample.

    Args:
        how: its functions.
        p: number of outputs.
        traits: properties for checks, certificates and figures.
    """
    missing = Reading(np.full(p, np.nan), np.zeros(p))
    _, first = how.correct(how.start(0), missing)

    def step(params: Any, state: Any, u: Any, reading: Reading) -> tuple[Any, Estimate]:
        """Return the state unchanged, and the estimate that the state contains."""
        return state, Estimate(*state)

    return Observer((), lambda params: tuple(first), step, traits=traits, python=how)


def require_graph(observer: Observer) -> Observer:
    """Return the observer if a graph.

    Raise InputError for an observer that computes in Python.
    """
    if observer.python is not None:
        raise InputError(
            "observer.method: this one computes in Python, sample by sample: it runs in single "
            "simulations only, not in ensembles, compiled lanes, live use or generated C. "
            "Use 'kalman' or 'censored' there"
        )
    return observer


def wrap_observer(
    observer: Observer,
    field: str,
    numbers: Any,
    start: Callable[[Any], Any],
    step: Callable[..., Any],
) -> Observer:
    """Return an observer around another one.

    Args:
        observer: the inner one.
        field: name of the outer numbers, behind the inner ones.
        numbers: tree of the outer numbers.
        start: start(inner state) is the state at t = 0, with the inner one in its field `observer`.
        step: the outer step, as of `Observer`.
    """
    kind = type(observer.params)

    def init(q: Any) -> Any:
        """Return the state at t = 0."""
        return start(observer.init(tree.drop_last_field(q, kind)))

    def project(q: Any, s: Any) -> Any:
        """Return the state with the observer's part projected."""
        return s._replace(observer=observer.project(tree.drop_last_field(q, kind), s.observer))

    params = tree.append_field(observer.params, field, numbers)
    return Observer(params, init, step, project, observer.traits)
