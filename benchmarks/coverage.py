"""How often the claimed 95 % intervals hold the truth, over random problems: our two filters beside filterpy's EKF and UKF."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.engine import lanes
from undeadzone.linear.hold import zoh
from undeadzone.linear.matrices import Matrices
from undeadzone.observers import Censored, Kalman, Reading
from undeadzone.plants.build import system
from undeadzone.plants.options import Plant
from undeadzone.plants.system import sampled
from undeadzone.sensor import Sensor, deadzone, resolve, side
from undeadzone.signals import noise as noises
from undeadzone.support import tree
from undeadzone.support.arrays import Floats

STEP, DURATION, RAMP = 0.01, 10.0, 2.0  # [s]
RANGE = (0.3, 2.0)  # declared range of the widths, from which they are drawn evenly
ORDERS = (1, 2, 3)
CORRELATION = 0.2  # [s] of the disturbance
ROUNDING = 1e-12  # of z: without a disturbance the state's variance decays below it
REACHES = ("both edges", "grazing", "right edge only", "no edge")


class World(NamedTuple):
    """What the problems of a family have besides noise, rms: disturbance in largest |u|, bias in z, model error."""

    disturbance: float = 0.0
    bias: float = 0.0
    tolerance: float = 0.0


WORLDS = {"noise only": World(), "disturbed": World(0.05, 0.2, 0.05)}


class Problems(NamedTuple):
    """K problems of one order n: what is known of each, what it does (time first), and what is true in the end."""

    models: list[Matrices]
    noise: Floats
    disturbance: Floats
    bias: Floats
    world: World
    x_std: float
    u: Floats
    y: Floats
    x: Floats
    d: Floats


class Verdict(NamedTuple):
    """Errors and claimed standard deviations of [d_r, d_l, width, centre, z] (K x 5) in the end, errors and covariances of
    d (K x 2, K x 2 x 2), and the mean of the squared innovations over their variances."""

    errors: Floats
    stds: Floats
    d_error: Floats
    d_cov: Floats
    nis: float

    def covered(self) -> Floats:
        """The share of problems whose 95 % interval holds the truth, for each of the five."""
        return np.mean(np.abs(self.errors) <= 1.96 * self.stds + ROUNDING, axis=0)

    def nees(self) -> float:
        """Mean of e' P^-1 e / 2 over the problems, e the error of d: 1 if claimed covariances are true."""
        return float(
            np.mean(
                np.einsum(
                    "ki,ki->k",
                    self.d_error,
                    np.linalg.solve(self.d_cov, self.d_error[..., None])[..., 0],
                )
            )
            / 2
        )


def problems(reach: str, world: World, order: int, count: int, seed: int) -> Problems:
    """Random stable plants with noise of 0.003 to 0.1, driven by two tones and an offset so that z reaches as named."""
    rng = np.random.default_rng([seed, order, REACHES.index(reach)])
    t = np.arange(0.0, DURATION, STEP)
    models = [_plant(rng, order) for _ in range(count)]
    d, noise = (
        rng.uniform(*RANGE, (count, 2)),
        np.exp(rng.uniform(np.log(0.003), np.log(0.1), count)),
    )
    offset = rng.uniform(0.5, 3.0, count) if reach == "right edge only" else np.zeros(count)
    amplitude = {
        "both edges": rng.uniform(3.0, 6.0, count),
        "grazing": d.max(axis=1) * rng.uniform(0.9, 1.2, count),
        "right edge only": offset + d[:, 1] * rng.uniform(0.0, 0.8, count),
        "no edge": d.min(axis=1) * rng.uniform(0.2, 0.8, count),
    }[reach]
    u = np.stack(
        [
            _drive(rng, model, t, a, c)
            for model, a, c in zip(models, amplitude, offset, strict=True)
        ],
        axis=1,
    )
    static = np.array([_response(model, 0.0).real for model in models])
    w_rms, bias_rms = world.disturbance * np.abs(u).max(axis=0), np.abs(world.bias / static)
    w = noises.coloured(seed, t.size, w_rms, CORRELATION, STEP)
    x_std = 1.0 if reach in ("both edges", "grazing") else 0.1
    x, bias = rng.normal(size=(count, order)) * x_std, rng.normal(size=count) * bias_rms
    A, B, C = (
        np.stack(part)
        for part in zip(
            *(zoh(_wrong(rng, model, world.tolerance), STEP) for model in models), strict=True
        )
    )
    y = np.empty_like(u)
    for k in range(t.size):
        now, z = x, np.einsum("kij,kj->ki", C, x)[:, 0]
        y[k] = deadzone(z, d[:, 0], d[:, 1]) + noise * rng.normal(size=count)
        x = np.einsum("kij,kj->ki", A, x) + B[:, :, 0] * (u[k] + w[k] + bias)[:, None]
    return Problems(models, noise, w_rms, bias_rms, world, x_std, u, y, now, d)


def _plant(rng: np.random.Generator, order: int) -> Matrices:
    frequency, damping = rng.uniform(1.0, 6.0), rng.uniform(0.2, 1.5)
    pair = np.roots([1.0, 2 * damping * frequency, frequency**2])
    poles = {1: [-frequency], 2: pair, 3: [*pair, -rng.uniform(0.5, 5.0)]}[order]
    a = np.poly(poles)[:0:-1].real
    A = np.eye(order, k=1)
    A[-1] = -a
    return Matrices(A, a[0] * rng.uniform(0.5, 2.0) * np.eye(order)[:, -1:], np.eye(order)[:1])


def _wrong(rng: np.random.Generator, model: Matrices, tolerance: float) -> Matrices:
    last = np.arange(model.A.shape[0]) == model.A.shape[0] - 1
    factors = 1 + tolerance * rng.normal(size=(last.size, last.size + 1)) * last[:, None]
    return Matrices(model.A * factors[:, :-1], model.B * factors[:, -1:], model.C)


def _response(model: Matrices, s: complex) -> Any:
    return (model.C @ np.linalg.solve(s * np.eye(model.A.shape[0]) - model.A, model.B))[0, 0] + 0j


def _drive(
    rng: np.random.Generator, model: Matrices, t: Floats, amplitude: float, offset: float
) -> Floats:
    """u that leads z to offset + amplitude (0.8, 0.2) . two tones, risen to smoothly."""
    slow, phase = rng.uniform(0.2, 1.0), rng.uniform(0.0, 2 * np.pi, 2)
    u = np.full(t.size, offset / _response(model, 0.0).real)
    for frequency, share, start in ((slow, 0.8, phase[0]), (2.3 * slow, 0.2, phase[1])):
        u += np.imag(
            share
            * amplitude
            / _response(model, 2j * np.pi * frequency)
            * np.exp(1j * (2 * np.pi * frequency * t + start))
        )
    rise = np.clip(t / RAMP, 0.0, 1.0)
    return u * rise**2 * (3 - 2 * rise)


def kalman(given: Problems, k: int) -> Kalman:
    """`Kalman` told the truth about problem k, a coloured disturbance taken for white."""
    return Kalman(right=RANGE, x_std=given.x_std, disturbance=given.disturbance[k])


def censored(given: Problems, k: int) -> Censored:
    """`Censored` told the truth about problem k."""
    return Censored(
        right=RANGE, x_std=given.x_std, disturbance=given.disturbance[k], correlation_time=CORRELATION, bias=given.bias[k],
        calibrated=0.0, tolerance=given.world.tolerance, drift=0.0,
    )  # fmt: skip


def observe(options: Callable[[Problems, int], Any], given: Problems) -> Verdict:
    """Run an observer on every problem, one lane each: one graph, numbers of the observer by problem."""
    built = []
    for k, model in enumerate(given.models):
        zone = resolve(Sensor(right=RANGE[1], left=RANGE[1], noise=given.noise[k]), 1, STEP)
        built.append(options(given, k).build(sampled(system(Plant(**model._asdict())), STEP), zone))
    observer = built[0]
    p, params = tree.symbols(observer.params, "p")
    s, state = tree.symbols(observer.init(observer.params), "s")
    w = ca.SX.sym("w", 2)
    after, found = observer.step(params, state, w[1], Reading(w[0], side(w[0])))
    stds = (found.right_std, found.left_std, found.width_std, found.x_std[0])
    record = ca.vertcat(
        found.right, found.left, found.z, *stds, found.innovation, found.innovation_std
    )
    step = ca.Function(
        "observe",
        [s, w, p],
        [tree.stack(after), record],
        ["s", "w", "p"],
        ["next", "out"],
        {"cse": True},
    )
    numbers = np.stack([tree.pack(one.params) for one in built])
    states = np.stack([tree.pack(one.init(one.params)) for one in built])
    kernel = lanes.build(step, exogenous=range(2), params=range(numbers.shape[1]))
    out, _ = lanes.run(
        kernel,
        states,
        np.zeros((len(given.y), 2)),
        numbers[0],
        np.stack([given.y, given.u], axis=1),
        numbers,
        threads=1,
    )
    right, left, z, *stds = out[:, -1, :7].T
    used = out[:, :, 7] != 0
    right_std, left_std, width_std, z_std = stds
    return verdict(
        truth(given),
        np.stack([right, left, z], axis=1),
        covariance(right_std, left_std, width_std),
        z_std,
        out[used][:, 7] / out[used][:, 8],
    )


def truth(given: Problems) -> Floats:
    """[d_r, d_l, z] in the end (K x 3)."""
    return np.column_stack(
        [given.d, [(model.C @ x)[0] for model, x in zip(given.models, given.x, strict=True)]]
    )


def covariance(right_std: Floats, left_std: Floats, width_std: Floats) -> Floats:
    """Of d (K x 2 x 2), from standard deviations of d_r, d_l and their sum."""
    both = (width_std**2 - right_std**2 - left_std**2) / 2
    return np.moveaxis(np.array([[right_std**2, both], [both, left_std**2]]), -1, 0)


def verdict(
    truth: Floats, estimate: Floats, d_cov: Floats, z_std: Floats, innovations: Floats
) -> Verdict:
    """The verdict on estimates [d_r, d_l, z] (K x 3) with covariances of d (K x 2 x 2), and on normalised innovations."""
    mixed = np.array([[1.0, 0.0, 1.0, 0.5], [0.0, 1.0, 1.0, -0.5]])
    error = estimate - truth
    variances = np.einsum("ji,kjl,li->ki", mixed, d_cov, mixed)
    errors, stds = (
        np.column_stack([error[:, :2] @ mixed, error[:, 2]]),
        np.column_stack([np.sqrt(variances), z_std]),
    )
    return Verdict(
        errors,
        stds,
        error[:, :2],
        d_cov,
        float(np.mean(np.square(innovations))) if innovations.size else np.nan,
    )


def extended(given: Problems, k: int) -> Any:
    """filterpy's EKF on [x; d_r; d_l], its branch of the dead zone the predicted one."""
    from filterpy.kalman import ExtendedKalmanFilter

    n = given.models[k].A.shape[0]
    rival = ExtendedKalmanFilter(n + 2, 1)

    def slope(v: Floats) -> Floats:
        right, left = float(v[0] > v[n]), float(v[0] < -v[n + 1])
        return np.concatenate([[right + left], np.zeros(n - 1), [-right, left]])[None, :]

    def correct(y: float) -> None:
        rival.update(np.array([y]), slope, lambda v: np.array([deadzone(v[0], v[n], v[n + 1])]))

    return rival, correct


def unscented(given: Problems, k: int) -> Any:
    """filterpy's UKF on [x; d_r; d_l], alpha 1, beta 2, kappa 0.5."""
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    n = given.models[k].A.shape[0]
    points = MerweScaledSigmaPoints(n + 2, 1.0, 2.0, 0.5)
    rival = UnscentedKalmanFilter(
        n + 2,
        1,
        STEP,
        lambda v: np.array([deadzone(v[0], v[n], v[n + 1])]),
        lambda v, dt, F, G: F @ v + G,
        points,
    )
    return rival, lambda y: rival.update(np.array([y]))


def rivalling(build: Callable[[Problems, int], Any], given: Problems, count: int) -> Verdict:
    """Run a filterpy filter on the first `count` problems, with the same priors and true noise figures as ours."""
    estimates, covariances, z_stds, innovations = [], [], [], []
    for k in range(count):
        model = zoh(given.models[k], STEP)
        n = model.A.shape[0]
        rival, correct = build(given, k)
        F, G = np.eye(n + 2), np.concatenate([model.B[:, 0], np.zeros(2)])
        F[:n, :n] = model.A
        rival.x = np.concatenate([np.zeros(n), np.full(2, np.mean(RANGE))])
        rival.P = np.diag(
            np.concatenate([np.full(n, given.x_std**2), np.full(2, np.ptp(RANGE) ** 2 / 12)])
        )
        rival.Q = given.disturbance[k] ** 2 * np.outer(G, G) + 1e-10 * np.eye(
            n + 2
        )  # a little, else the UKF's Cholesky factor fails
        rival.R = np.array([[given.noise[k] ** 2]])
        rival.F = F
        for y, u in zip(given.y[:, k], given.u[:, k], strict=True):
            correct(y)
            innovations.append(float(rival.y[0] / np.sqrt(rival.S[0, 0])))
            final = rival.x.copy(), rival.P.copy()
            if build is unscented:
                rival.predict(F=F, G=G * u)
            else:
                rival.x, rival.P = F @ rival.x + G * u, F @ rival.P @ F.T + rival.Q
        estimates.append(final[0][[n, n + 1, 0]])
        covariances.append(final[1][n:, n:])
        z_stds.append(np.sqrt(final[1][0, 0]))
    return verdict(
        truth(given)[:count],
        *map(np.stack, (estimates, covariances, z_stds)),
        np.array(innovations),
    )


def pooled(parts: list[Verdict]) -> Verdict:
    """One verdict over several families of as many problems each."""
    arrays = (np.concatenate(column) for column in list(zip(*parts, strict=True))[:-1])
    return Verdict(*arrays, float(np.mean([part.nis for part in parts])))


def row(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"


def table(count: int = 600, rivals: int = 25, seed: int = 0) -> str:
    """The table, from `count` problems of each order for ours and `rivals` for filterpy's."""
    heads = (
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
    lines = ["## Coverage of claimed 95 % intervals\n", row(*heads), row(*["---"] * len(heads))]
    for name, world in WORLDS.items():
        for reach in REACHES:
            families = [problems(reach, world, order, count, seed) for order in ORDERS]
            found = {
                "kalman": [observe(kalman, given) for given in families],
                "censored": [observe(censored, given) for given in families],
                "EKF": [rivalling(extended, given, rivals) for given in families],
                "UKF": [rivalling(unscented, given, rivals) for given in families],
            }
            for label, parts in found.items():
                whole = pooled(parts)
                shares = [f"{share:.3f}" for share in whole.covered()]
                error, std = np.median(np.abs(whole.errors[:, 2])), np.median(whole.stds[:, 2])
                nis = "-" if np.isnan(whole.nis) else f"{whole.nis:.3g}"
                lines.append(
                    row(
                        name,
                        reach,
                        label,
                        *shares,
                        f"{whole.nees():.3g}",
                        nis,
                        f"{error:.2g}, {std:.2g}",
                    )
                )
    note = f"{count * len(ORDERS)} problems of orders {ORDERS} a row for ours, {rivals * len(ORDERS)} for filterpy's; {DURATION:g} s at {1 / STEP:g} Hz."
    return "\n".join([*lines, "", note, ""])


if __name__ == "__main__":
    print(table())
