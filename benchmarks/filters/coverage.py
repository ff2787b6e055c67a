"""How often claimed 95 % intervals hold the truth, over random problems.

Our two filters stand beside filterpy's EKF and UKF.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from benchmarks.filters.problems.random_plants import (
    DURATION,
    RANGE,
    REACHES,
    STEP,
    WORLDS,
    Problems,
    problems,
)
from benchmarks.filters.problems.random_plants import World as World
from benchmarks.filters.rivals.filterpy_filters import extended, unscented
from benchmarks.markdown import head, row
from undeadzone.compile import lanes
from undeadzone.interfaces import Estimate, Observer, Reading
from undeadzone.linalg.hold import zoh
from undeadzone.linalg.matrices import Matrices
from undeadzone.nonlinearities.sensor import SHAPE, Sensor, resolve, side
from undeadzone.observers import Censored, Kalman
from undeadzone.plants.build import system
from undeadzone.plants.options import Plant
from undeadzone.plants.system import plant_pace, sample_plant
from undeadzone.util import tree
from undeadzone.util.arrays import Floats

ORDERS = (1, 2, 3)
NONE = np.zeros(0)
ROUNDING = 1e-12  # of z: without a disturbance the state's variance decays below it
COLUMNS = (
    "world",
    "z reaches",
    "filter",
    "d_r",
    "d_l",
    "width",
    "centre",
    "z",
    "NEES",
    "NIS",
    "median error, std of width",
)


class Verdict(NamedTuple):
    """What the estimates of K problems are worth in the end.

    Attributes:
        errors: of [d_r, d_l, width, centre, z] (K x 5)
        stds: claimed standard deviations of the same (K x 5)
        d_error: errors of d (K x 2)
        d_cov: claimed covariances of d (K x 2 x 2)
        nis: mean of the squared innovations over their variances
    """

    errors: Floats
    stds: Floats
    d_error: Floats
    d_cov: Floats
    nis: float

    def covered(self) -> Floats:
        """The share of problems whose 95 % interval holds the truth, for each of the five."""
        return np.mean(np.abs(self.errors) <= 1.96 * self.stds + ROUNDING, axis=0)

    def nees(self) -> float:
        """Mean of e' P^-1 e / 2, e the error of d: 1 if claimed covariances are true."""
        weighted = np.linalg.solve(self.d_cov, self.d_error[..., None])[..., 0]
        return float(np.mean(np.einsum("ki,ki->k", self.d_error, weighted)) / 2)


def kalman(known: Problems, k: int) -> Kalman:
    """`Kalman` told the truth about problem k, a coloured disturbance taken for white."""
    right, left = known.ranges[k]
    options = {"right": right, "left": left, "x_std": known.x_std[k]}
    return Kalman(**options, disturbance=known.disturbance[k])


def censored(known: Problems, k: int) -> Censored:
    """`Censored` told the truth about problem k."""
    return Censored(
        right=known.ranges[k, 0],
        left=known.ranges[k, 1],
        x_std=known.x_std[k],
        disturbance=known.disturbance[k],
        correlation_time=known.correlation[k],
        bias=known.bias[k],
        calibrated=0.0,
        tolerance=known.world.tolerance,
        drift=0.0,
    )


def observe(options: Callable[[Problems, int], Any], posed: Problems) -> Verdict:
    """Run an observer on every problem, one lane each: one graph, numbers of the observer each.

    Args:
        options: of the observer for a problem
        posed: the problems
    """
    out = along(options, posed, ESTIMATES)
    used = out[:, :, 7] != 0
    return final_verdict(posed, out, out[used][:, 7] / out[used][:, 8])


def final_verdict(posed: Problems, out: Floats, innovations: Floats = NONE) -> Verdict:
    """The verdict on the last of estimates that begin with those of `FINAL`.

    Args:
        posed: the problems
        out: numbers of estimates (K x samples x numbers)
        innovations: over their claimed deviations
    """
    right, left, z, right_std, left_std, width_std, z_std = out[:, -1, :7].T
    d_cov = covariance(right_std, left_std, width_std)
    return verdict(truth(posed), np.stack([right, left, z], 1), d_cov, z_std, innovations)


def along(
    options: Callable[[Problems, int], Any],
    posed: Problems,
    select: Callable[[Estimate], list[Any]],
) -> Floats:
    """What is kept of the estimates of every problem, one lane each (K x samples x numbers).

    Args:
        options: of the observer for a problem
        posed: the problems
        select: the numbers of an estimate that are returned
    """
    built = built_of(options, posed)
    return run_observers(built, step_of(built[0], select), np.stack([posed.y, posed.u], axis=1))


def run_observers(built: Sequence[Observer], step: ca.Function, own: Floats) -> Floats:
    """What a step gives along signals (samples x m x K), one lane an observer."""
    numbers = np.stack([tree.pack_tree(one.params) for one in built])
    states = np.stack([tree.pack_tree(one.init(one.params)) for one in built])
    kernel = lanes.build_kernel(step, exogenous=range(own.shape[1]), params=range(numbers.shape[1]))
    shared = np.zeros(own.shape[:2])
    out, _ = lanes.run_lanes(kernel, states, shared, numbers[0], own, numbers, threads=1)
    return np.asarray(out)


def built_of(options: Callable[[Problems, int], Any], posed: Problems) -> list[Observer]:
    """The observers of the problems, as the product builds them."""
    built = []
    for k, model in enumerate(posed.models):
        (right, left), observer = posed.ranges[k, :, 1], options(posed, k)
        sensor = Sensor(
            right=right, left=left, noise=posed.noise[k], **exact_shape_if_known(observer)
        )
        built.append(built_for(observer, model, sensor, posed.step[k]))
    return built


def exact_shape_if_known(options: Any) -> dict[str, float]:
    """Return the keys of an exact sensor for an observer that knows all numbers, else none."""
    is_known = getattr(options, "x_std", None) is not None
    return dict.fromkeys(SHAPE, 0.0) if is_known else {}


def built_for(options: Any, model: Matrices, sensor: Sensor, step: float) -> Observer:
    """The observer of a plant and a sensor, which knows how fast the plant moves.

    Args:
        options: of the observer
        model: the plant
        sensor: in a user's words
        step: time between readings [s]
    """
    zone = resolve(sensor, 1, step, plant_pace(model))
    built: Observer = options.build(sample_plant(system(Plant(**model._asdict())), step), zone)
    return built


def selected(names: str) -> Callable[[Estimate], list[Any]]:
    """The first number of each field of an estimate that is named."""
    return lambda estimate: [getattr(estimate, name)[0] for name in names.split()]


FINAL = "right left z right_std left_std width_std x_std "
ESTIMATES = selected(FINAL + "innovation innovation_std")


def plain_reading(w: Any) -> Reading:
    """The reading of a sensor without limits."""
    return Reading(w[0], side(w[0]))


def step_of(
    observer: Observer,
    select: Callable[[Estimate], list[Any]],
    read: Callable[[Any], Reading] = plain_reading,
    size: int = 2,
) -> ca.Function:
    """next, out = step(s, w, p).

    Args:
        observer: the observer
        select: the numbers of an estimate that are in out
        read: the reading of w
        size: of w = [y, u, ...]
    """
    p, params = tree.create_symbols(observer.params, "p")
    s, state = tree.create_symbols(observer.init(observer.params), "s")
    w = ca.SX.sym("w", size)
    after, estimate = observer.step(params, state, w[1], read(w))
    names = (["s", "w", "p"], ["next", "out"])
    out = [tree.stack_leaves(after), ca.vertcat(*select(estimate))]
    return ca.Function("observe", [s, w, p], out, *names, {"cse": True})


def truth(posed: Problems) -> Floats:
    """[d_r, d_l, z] in the end (K x 3)."""
    z = [(model.C @ x)[0] for model, x in zip(posed.models, posed.x, strict=True)]
    return np.column_stack([posed.d, z])


def covariance(right_std: Floats, left_std: Floats, width_std: Floats) -> Floats:
    """Of d (K x 2 x 2), from standard deviations of d_r, d_l and their sum."""
    both = (width_std**2 - right_std**2 - left_std**2) / 2
    return np.moveaxis(np.array([[right_std**2, both], [both, left_std**2]]), -1, 0)


def verdict(
    truth: Floats, estimate: Floats, d_cov: Floats, z_std: Floats, innovations: Floats
) -> Verdict:
    """The verdict on estimates.

    Args:
        truth, estimate: [d_r, d_l, z] (K x 3)
        d_cov: claimed covariances of d (K x 2 x 2)
        z_std: claimed deviations of z (K)
        innovations: over their claimed deviations
    """
    mixed = np.array([[1.0, 0.0, 1.0, 0.5], [0.0, 1.0, 1.0, -0.5]])  # d to right, ..., centre
    error = estimate - truth
    variances = np.einsum("ji,kjl,li->ki", mixed, d_cov, mixed)
    nis = float(np.mean(np.square(innovations))) if innovations.size else np.nan
    return Verdict(
        errors=np.column_stack([error[:, :2] @ mixed, error[:, 2]]),
        stds=np.column_stack([np.sqrt(variances), z_std]),
        d_error=error[:, :2],
        d_cov=d_cov,
        nis=nis,
    )


def rivalling(build: Callable[[int], Any], posed: Problems, count: int) -> Verdict:
    """Run a filterpy filter on the first problems, with the same priors and noise as ours.

    Args:
        build: `extended` or `unscented`
        posed: the problems
        count: how many of them
    """
    estimates, covariances, z_stds, innovations = [], [], [], []
    for k in range(count):
        n = posed.models[k].A.shape[0]
        x, P, normalised = _rival(build, posed, k)
        innovations += normalised
        estimates.append(x[[n, n + 1, 0]])
        covariances.append(P[n:, n:])
        z_stds.append(np.sqrt(P[0, 0]))
    return verdict(
        truth(posed)[:count],
        np.stack(estimates),
        np.stack(covariances),
        np.stack(z_stds),
        np.array(innovations),
    )


def _rival(
    build: Callable[[int], Any], posed: Problems, k: int
) -> tuple[Floats, Floats, list[float]]:
    """Mean and covariance after the last sample of problem k, and all normalised innovations."""
    model = zoh(posed.models[k], STEP)
    n = model.A.shape[0]
    rival, correct = build(n)
    F, G = np.eye(n + 2), np.concatenate([model.B[:, 0], np.zeros(2)])
    F[:n, :n] = model.A
    of_widths = np.ptp(RANGE) ** 2 / 12  # variance
    rival.x = np.concatenate([np.zeros(n), np.full(2, np.mean(RANGE))])
    rival.P = np.diag(np.concatenate([posed.x_std[k] ** 2, np.full(2, of_widths)]))
    tiny = 1e-10 * np.eye(n + 2)  # else the UKF's Cholesky factor fails
    rival.Q = posed.disturbance[k] ** 2 * np.outer(G, G) + tiny
    rival.R = np.array([[posed.noise[k] ** 2]])
    rival.F = F
    innovations = []
    for y, u in zip(posed.y[:, k], posed.u[:, k], strict=True):
        correct(y)
        innovations.append(float(rival.y[0] / np.sqrt(rival.S[0, 0])))
        x, P = rival.x.copy(), rival.P.copy()
        if build is unscented:
            rival.predict(F=F, G=G * u)
        else:
            rival.x, rival.P = F @ rival.x + G * u, F @ rival.P @ F.T + rival.Q
    return x, P, innovations


def pooled(parts: list[Verdict]) -> Verdict:
    """One verdict over several families of as many problems each."""
    return Verdict(
        errors=np.concatenate([part.errors for part in parts]),
        stds=np.concatenate([part.stds for part in parts]),
        d_error=np.concatenate([part.d_error for part in parts]),
        d_cov=np.concatenate([part.d_cov for part in parts]),
        nis=float(np.mean([part.nis for part in parts])),
    )


def table(count: int = 600, rivals: int = 25, seed: int = 0) -> str:
    """The table, from `count` problems of each order for ours and `rivals` for filterpy's."""
    lines = [
        "## Coverage of claimed 95 % intervals\n",
        *head(*COLUMNS),
    ]
    for name, world in WORLDS.items():
        for reach in REACHES:
            families = [problems(reach, world, order, count, seed) for order in ORDERS]
            verdicts = {
                "kalman": [observe(kalman, family) for family in families],
                "censored": [observe(censored, family) for family in families],
                "EKF": [rivalling(extended, family, rivals) for family in families],
                "UKF": [rivalling(unscented, family, rivals) for family in families],
            }
            for label, parts in verdicts.items():
                lines.append(row(name, reach, label, *_cells(pooled(parts))))
    problems_of = f"{count * len(ORDERS)} problems of orders {ORDERS} a row for ours"
    samples = f"{DURATION:g} s at {1 / STEP:g} Hz"
    note = f"{problems_of}, {rivals * len(ORDERS)} for filterpy's; {samples}."
    return "\n".join([*lines, "", note, ""])


def _cells(verdict: Verdict) -> list[str]:
    """A verdict in the cells of a row."""
    shares = [f"{share:.3f}" for share in verdict.covered()]
    nis = "-" if np.isnan(verdict.nis) else f"{verdict.nis:.3g}"
    error, std = np.median(np.abs(verdict.errors[:, 2])), np.median(verdict.stds[:, 2])
    return [*shares, f"{verdict.nees():.3g}", nis, f"{error:.2g}, {std:.2g}"]
