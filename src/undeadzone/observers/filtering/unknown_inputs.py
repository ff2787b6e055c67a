"""Filter states beside the widths: disturbance, bias and errors of the model.

What of a model is uncertain, an entry or a parameter, is a constant unknown. The mathematics is in
docs/filter_equations.md.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.linalg.hold import discretise_noise, zoh_slopes
from undeadzone.linalg.matrices import Matrices, change_state_units, symmetric_part
from undeadzone.numerics.gaussian import Gaussian, Products, joseph_update
from undeadzone.observers.filtering.constant_states import information_shares
from undeadzone.observers.filtering.gaussian_filter import Augmentation, Params
from undeadzone.plants.system import System, hold_integral, scale_states, state_units, time_scale
from undeadzone.util.arrays import Array, Floats, require_nonnegative, require_number

OFFSET = 0.25  # default bias, in disturbances
ROUNDING = 1e-13  # entry of a state at rest, over its largest, that rounding alone makes
SMALL = 0.01  # bias of a calibrated input, relative to that of another

BRIEF = 0.25  # default correlation time, in quarter periods of the plant


class Colour(NamedTuple):
    """Coloured disturbance C p of unit rms, p+ = F p + noise of covariance Q.

    Attributes:
        F, Q: motion and added covariance of p (k x k).
        cov: covariance of p at all times (k x k).
        C: from p to the disturbance (k).
    """

    F: Floats
    Q: Floats
    cov: Floats
    C: Floats


class Numbers(NamedTuple):
    """Parameters of the unknowns at run time.

    Attributes:
        F, Q: motion and added covariance of a disturbance of unit rms, as in `Colour`.
        variance: variances of the disturbances.
        slopes, values, hold_integral: as in `Tolerance`.
        rest: state at rest under each unit bias (n x biases).
        bias: rms of the biases.
        odds: log of the odds that the biases are `SMALL`.
    """

    F: Floats
    Q: Floats
    variance: Floats
    slopes: Floats
    values: Floats
    hold_integral: Floats
    rest: Floats
    bias: Floats
    odds: Any


class Setup(NamedTuple):
    """Options shared by the functions of `build_unknown_inputs`, extra = `[bias; p; theta]`.

    Attributes:
        model: the sampled model.
        tolerance: what of the model is uncertain.
        ends: where bias, p and theta begin and end in extra (4).
        biased: from the biases to the inputs (m x biases).
        disturbing: from p to the inputs (m x size of p).
        shaken: how many inputs have a disturbance.
        careful: whether a small bias moves widths only as far as readings contained information on
            them.
    """

    model: System
    tolerance: Tolerance
    ends: list[int]
    biased: Floats
    disturbing: Floats
    shaken: int
    careful: bool


def build_colour(correlation: float, Ts: float) -> Colour:
    """Return first-order noise p' = -p / correlation + white noise, sampled exactly.

    Args:
        correlation: correlation time [s].
        Ts: sample time [s].
    """
    from scipy.linalg import solve_discrete_lyapunov

    a = 1 / correlation
    Fd, Q = discretise_noise(np.array([[-a]]), np.array([[2 * a]]), Ts)
    return Colour(Fd, symmetric_part(Q), solve_discrete_lyapunov(Fd, Q), np.array([1.0]))


def read_time_span(key: str, value: Any, Ts: float) -> float:
    """Return a time that the samples resolve [s]. Raises InputError."""
    time = require_number(f"observer.{key}", value, above=0.0)
    if not 0.1 * Ts <= time <= 1e6 * Ts:
        raise InputError(
            f"observer.{key}: must lie between 0.1 and 1e6 sample times of {Ts:g} s, "
            f"found {time:.4g} s"
        )
    return time


def resolve_input_rms(key: str, rms: Array | None, default: Floats) -> Floats:
    """Return an rms as given, or its default (m) [u]. Raises InputError, ShapeError."""
    if rms is None:
        return default
    return require_nonnegative(f"observer.{key}", rms, np.size(default), "one per input")


def resolve_correlation_time(assumed: float | None, flow: Matrices, Ts: float) -> float:
    """Return the correlation time of a disturbance [s].

    The default is a 16th of the plant's period. Raises InputError.
    """
    time = BRIEF * time_scale(flow, Ts) if assumed is None else assumed
    return read_time_span("correlation_time", time, Ts)


def build_unknown_inputs(
    model: System,
    colour: Colour,
    rms: Floats,
    bias: Floats,
    calibrated: float,
    tolerance: Tolerance,
    careful: bool = False,
) -> Augmentation:
    """Return the augmentation by bias, disturbance and tolerance states.

    Only nonzero entries get states.

    Args:
        model: the sampled model.
        colour: the disturbance of unit rms.
        rms: rms of the disturbance (m) [u] (0: there is none).
        bias: rms of a constant at the inputs (m) [u] (0: there is none).
        calibrated: probability that the biases are `SMALL`.
        tolerance: what of the model is uncertain.
        careful: whether a small bias moves widths only as far as readings contained information on
            them.
    """
    from scipy.linalg import block_diag

    biased = np.eye(model.m)[:, bias > 0]
    shaken = np.eye(model.m)[:, rms > 0]
    inputs = shaken.shape[1]
    sizes = [0, biased.shape[1], colour.C.size * inputs, tolerance.std.size]
    disturbing = shaken @ np.kron(colour.C, np.eye(inputs))
    setup = Setup(model, tolerance, np.cumsum(sizes).tolist(), biased, disturbing, inputs, careful)
    variance = rms[rms > 0] ** 2
    numbers = Numbers(
        F=colour.F,
        Q=colour.Q,
        variance=variance,
        slopes=tolerance.slopes,
        values=tolerance.values,
        hold_integral=tolerance.hold_integral,
        rest=bias_rest_state(model, biased),
        bias=bias[bias > 0],
        odds=np.float64(calibrated / (1 - calibrated)),
    )
    cov = block_diag(
        np.diag(bias[bias > 0] ** 2),
        np.kron(colour.cov, np.diag(variance)),
        np.diag(tolerance.std**2),
    )
    may_be_small = calibrated and bias.any()
    return Augmentation(
        numbers,
        cov,
        partial(change_with_unknowns, setup),
        partial(noise_of_unknowns, setup),
        alternative=partial(assume_small_bias, setup) if may_be_small else None,
        bilinear=partial(tolerance_times_state, setup) if tolerance.entries else None,
        constants=tolerance.std.size,
    )


def bias_rest_state(model: System, biased: Floats) -> Floats:
    """Return the state at rest under each unit bias (n x biases).

    The tolerance acts on x less that state: else estimates of theta would seem to distinguish bias
    from centre.
    """
    A, B, _ = model.continuous
    units = state_units(model.continuous)
    even = change_state_units(A, units)
    rest = np.linalg.lstsq(even, -(B / units[:, None]) @ biased, rcond=None)[0]
    rest[np.abs(rest) < ROUNDING * np.abs(rest).max(initial=0.0)] = 0.0
    return np.asarray(units[:, None] * rest)


def change_with_unknowns(setup: Setup, q: Params, x: Any, extra: Any, u: Any) -> tuple[Any, Any]:
    """Return (x+ - x, extra+ - extra) under bias, disturbance and tolerance."""
    model = setup.model
    tolerance = setup.tolerance
    numbers = q.augmentation
    count = tolerance.std.size
    constant, shaped, theta = ca.vertsplit(extra, setup.ends)
    moving = u + setup.disturbing @ shaped
    total = moving + setup.biased @ constant
    assert model.change is not None
    if model.nonlinear:
        params = tolerance.changed(q.model, theta) if count else q.model
        gained = model.change(params, x, total)
    else:
        regressor = numbers.slopes @ ca.vertcat(x - numbers.rest @ constant, moving)
        gained = model.change(q.model, x, total) + ca.reshape(regressor, model.n, count) @ theta
    faded = ca.kron(numbers.F - np.eye(numbers.F.shape[0]), ca.SX.eye(setup.shaken)) @ shaped
    none = ca.SX(setup.ends[1], 1), ca.SX(count, 1)
    return gained, ca.vertcat(none[0], faded, none[1])


def tolerance_times_state(setup: Setup, q: Params, x: Any, extra: Any, u: Any) -> Products:
    """Return the products theta_i a_i `[x; u]` in the rows of A and B, held over the step."""
    numbers = q.augmentation
    entries = setup.tolerance.entries
    constant, shaped, theta = ca.vertsplit(extra, setup.ends)
    moved = ca.vertcat(x - numbers.rest @ constant, u + setup.disturbing @ shaped)
    rows = sorted({row for row, _ in entries})
    Z = ca.SX(len(rows), len(entries))
    right = ca.SX(len(entries), 1)
    for k, (row, column) in enumerate(entries):
        Z[rows.index(row), k] = 1
        right[k] = numbers.values[k] * moved[column]
    return Products(numbers.hold_integral[:, rows], Z, theta, right)


def noise_of_unknowns(setup: Setup, q: Params, x: Any, u: Any) -> tuple[Any, Any]:
    """Return the covariances that a step adds to x and to extra.

    Only the disturbances are random.
    """
    n = setup.model.n
    biases = setup.biased.shape[1]
    count = setup.tolerance.std.size
    of_disturbances = ca.kron(q.augmentation.Q, ca.diag(q.augmentation.variance))
    of_extra = ca.diagcat(ca.SX(biases, biases), of_disturbances, ca.SX(count, count))
    return ca.SX(n, n), of_extra


def assume_small_bias(setup: Setup, q: Params, belief: Gaussian) -> tuple[Gaussian, Any]:
    """Return (the Gaussian under the hypothesis of a `SMALL` bias, its odds).

    The hypothesis acts as a reading of the bias as 0 (docs/filter_equations.md).

    Returns:
        (belief, its odds).
    """
    odds = q.augmentation.odds
    moved = information_shares(q, setup.model, belief.cov) if setup.careful else 1.0
    first = setup.model.n + 2 * setup.model.p
    for i in range(setup.biased.shape[1]):
        R = q.augmentation.bias[i] ** 2 / (1 / SMALL**2 - 1)
        e = -belief.mean[first + i]
        h = ca.SX.eye(belief.mean.shape[0])[first + i, :]
        belief, S = joseph_update(belief, h, e, R, moved)
        odds = odds * ca.sqrt(R / S) * ca.exp(-(e**2) / S / 2) / SMALL
    return belief, odds


class Tolerance(NamedTuple):
    """Uncertain quantities of a model:

    K entries of A and B, or K parameters of a nonlinear plant.

    Attributes:
        std: their standard deviations (K), relative ones but in `named`.
        slopes: d[Ad, Bd] per relative change of each entry (K n x (n + m)) (empty for a nonlinear
            plant).
        entries: rows and columns of the entries in [A, B].
        values: the entries themselves (K).
        hold_integral: `plants.system.hold_integral` (n x n).
        changed: changed(params, theta) is the parameters of a nonlinear plant as theta (K) changes
            them.
    """

    std: Floats
    slopes: Floats
    entries: tuple[tuple[int, int], ...] = ()
    values: Floats = np.zeros(0)
    hold_integral: Floats = np.zeros((0, 0))
    changed: Callable[[Any, Any], Any] = lambda params, theta: params * (1 + theta)


def read_named_parameters(model: System, stds: dict[str, float]) -> Tolerance:
    """Return the tolerance of named parameters of a nonlinear plant, with absolute deviations.

    Raises InputError.
    """
    std = {}
    for name, value in stds.items():
        std[name] = require_number(f"observer.uncertain.{name}", value, above=0.0)
    unknown = sorted(set(std) - set(model.names))
    if unknown:
        raise InputError(
            f"observer.uncertain.{unknown[0]}: unknown parameter. "
            f"The model has {', '.join(model.names) or 'none with a name'}"
        )
    pick = ca.DM(len(model.names), len(std))
    for k, name in enumerate(std):
        pick[model.names.index(name), k] = 1
    return Tolerance(
        np.array([*std.values()]),
        np.zeros((0, model.n + model.m)),
        changed=lambda params, theta: params + pick @ theta,
    )


def read_tolerance(
    model: System, tolerance: float | dict[str, float], units: Floats | None = None
) -> Tolerance:
    """Return the tolerance of A and B, or of the parameters of a nonlinear plant.

    Args:
        model: the sampled model.
        tolerance: relative standard deviation of every entry, but of rows that only contain x_i' =
            x_j, or of some, as {"A[1,0]": 0.1} (or of every parameter).
        units: in which the filter counts states (n) (None: those of the model).

    Raises:
        InputError: for an entry that does not exist or is 0.
    """
    if model.nonlinear:
        return _read_parameter_tolerance(model, tolerance)
    assert model.Ts is not None
    AB = np.hstack(model.continuous[:2])
    places = _entry_names(model.n, model.m)
    if not isinstance(tolerance, dict):
        tolerance = _dynamic_entries(AB, places, tolerance)
    std = []
    entries = []
    for name, value in tolerance.items():
        relative = require_number(f"observer.tolerance.{name}", value, least=0.0)
        if name not in places or AB[places[name]] == 0.0:
            uncertain = ", ".join(name for name, at in places.items() if AB[at] != 0.0)
            raise InputError(
                f"observer.tolerance.{name}: expected an entry of A or B that is not 0: {uncertain}"
            )
        if relative:
            std.append(relative)
            entries.append(places[name])
    even = scale_states(model, np.ones(model.n) if units is None else units)
    AB = np.hstack(even.continuous[:2])
    return Tolerance(
        np.array(std),
        zoh_entry_slopes(AB, entries, model.Ts),
        tuple(entries),
        np.array([AB[at] for at in entries]),
        hold_integral(even),
    )


def _read_parameter_tolerance(model: System, tolerance: float | dict[str, float]) -> Tolerance:
    """Return the tolerance with equal relative deviations of a nonlinear plant's parameters."""
    if isinstance(tolerance, dict):
        raise InputError(
            "observer.tolerance: a nonlinear plant takes one number, for all of its parameters"
        )
    std = require_number("observer.tolerance", tolerance, least=0.0)
    count = np.size(model.params) if std else 0
    return Tolerance(np.full(count, std), np.zeros((0, model.n + model.m)))


def _entry_names(n: int, m: int) -> dict[str, tuple[int, int]]:
    """Return the place of each entry in [A, B] by its name: "A[0,1]", "B[1,0]"."""
    places = {}
    for name, columns, first in (("A", n, 0), ("B", m, n)):
        for i, j in np.ndindex(n, columns):
            places[f"{name}[{i},{j}]"] = (i, first + j)
    return places


def _dynamic_entries(
    AB: Floats, places: dict[str, tuple[int, int]], std: float
) -> dict[str, float]:
    """Return `std` for every nonzero entry outside rows that only state x_i' = x_j."""
    integrates = (np.count_nonzero(AB, axis=1) == 1) & (AB.max(axis=1) == 1.0)
    stds = {}
    for name, at in places.items():
        if not integrates[at[0]] and AB[at] != 0.0:
            stds[name] = std
    return stds


def zoh_entry_slopes(AB: Floats, entries: list[tuple[int, int]], Ts: float) -> Floats:
    """Return d[Ad, Bd] per relative change of each entry of [A, B], stacked (K n x (n + m)).

    Args:
        AB: [A, B] (n x (n + m)).
        entries: rows and columns in it (K).
        Ts: sample time [s].
    """
    directions: list[Floats] = []
    for at in entries:
        direction = np.zeros(AB.shape)
        direction[at] = AB[at]
        directions.append(direction)
    return zoh_slopes(AB, directions, Ts)
