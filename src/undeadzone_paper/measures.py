"""Quantities that the paper plots and claims, measured on a `Run` of one output."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Final

import numpy as np

from undeadzone.linalg.matrices import Matrices
from undeadzone.linalg.riccati import Riccati, paper_riccati
from undeadzone.nonlinearities.sensor import deadzone, indicators, zone
from undeadzone.plants.options import linear_matrices
from undeadzone.results.run import LAST, Run
from undeadzone.results.scales import LIMIT
from undeadzone.util.arrays import Floats
from undeadzone_paper.example import ALPHA, L_PRINTED, example_as_printed

SHARPNESS: Final = 100.0  # k_s of tanh(k_s y), (8)


def largest_absolute(values: Floats) -> float:
    """Return the largest absolute value.

    Args:
        values: any shape.
    """
    return float(np.abs(values).max())


def reading_estimate(run: Run) -> Floats:
    """Return y^ = C x^ - Sat(C x^) of (17), with the estimated widths (N) [y]."""
    return np.asarray(deadzone(run.z_hat[:, 0], run.d_hat[:, 0], run.d_hat[:, 1]))


def width_errors(run: Run) -> Floats:
    """Return d^ - d (N x 2) [z]."""
    return run.d_hat - np.array(run.info.widths)


def error_matrix(linear: Matrices, L: Sequence[float] | Floats = L_PRINTED) -> Floats:
    """Return A - L C of a plant of order 2 (2 x 2) [1/s]."""
    return np.asarray(linear.A - np.outer(L, linear.C))


def printed_riccati(linear: Matrices, drift: Floats, alpha: float = ALPHA) -> Riccati:
    """Return P and K of (34) with a drift for its A, and Q = I."""
    return paper_riccati(drift, linear.B, alpha, np.eye(2))


def with_printed_V(run: Run) -> Run:
    """Return the run with V of (30) for sigma = 1.

    The scalar C P C' stands for the n x n matrix P beside the scalar y~.
    """
    linear = linear_matrices(example_as_printed(1.0).plant)
    P = printed_riccati(linear, error_matrix(linear)).P
    of_reading = run.innovation[:, 0] ** 2 * float((linear.C @ P @ linear.C.T)[0, 0])
    of_widths = (width_errors(run) ** 2).sum(axis=1) / 2
    return Run(run.info, run.signals, V=of_reading + of_widths)


def rms_or_inf(values: Floats) -> float:
    """Return the root mean square, or inf if the values diverge."""
    size = float(np.linalg.norm(values) / np.sqrt(np.size(values)))
    return size if size < LIMIT else np.inf


def worst_value(measure: Callable[[Run], float], runs: Iterable[Run]) -> float:
    """Return the largest value of a quantity among runs, infinite if one of them diverges."""
    runs = list(runs)
    if any(run.divergence_time is not None for run in runs):
        return np.inf
    return max(map(measure, runs))


def reading_error(run: Run) -> float:
    """Return the rms of y^ - y over the last 2 s [y]."""
    return rms_or_inf((reading_estimate(run) - run.y[:, 0])[run.last])


def first_state_error(run: Run) -> float:
    """Return the rms of x^1 - x1 over the last 2 s."""
    return rms_or_inf((run.x_hat - run.x)[run.last, 0])


def second_state_error(run: Run) -> float:
    """Return the rms of x^2 - x2 over the last 2 s."""
    return rms_or_inf((run.x_hat - run.x)[run.last, 1])


def width_error(run: Run) -> float:
    """Return the largest |d^ - d| over the last 2 s [z]."""
    return largest_absolute(width_errors(run)[run.last])


def growth_of_widths(run: Run) -> float:
    """Return the largest |d^| in the second half of the run relative to the first half [1]."""
    half = run.t.size // 2
    return largest_absolute(run.d_hat[half:]) / largest_absolute(run.d_hat[:half])


def output_error(run: Run) -> float:
    """Return the rms of z^ - z over the last 2 s [z]."""
    return rms_or_inf((run.z_hat - run.z)[run.last])


def tracking_error(run: Run) -> float:
    """Return the rms of z - r over the last 2 s [z]."""
    return rms_or_inf((run.z - run.r)[run.last])


def inverse_error(run: Run) -> float:
    """Return the rms of y + chi_bar d^ - z over the last 2 s of samples outside the zone [z].

    It is 0 without any.
    """
    outside = np.flatnonzero(run.side[:, 0])[-round(LAST / run.info.step) :]
    return rms_or_inf((run.z_inverse - run.z)[outside]) if outside.size else 0.0


def total_inverse_error(run: Run) -> float:
    """Return the rms of y + chi_bar d^ - z over the last 2 s, inside the zone and outside [z]."""
    return rms_or_inf((run.z_inverse - run.z)[run.last])


def indicator_error(run: Run) -> float:
    """Return the largest error of the smooth indicators (8)-(10) of y for the branch of z [1]."""
    where = zone(run.z, *np.array(run.info.widths))
    right, left = indicators(run.y, SHARPNESS)
    return largest_absolute(np.hstack([right - (where > 0), left - (where < 0)]))


def side_error(run: Run) -> float:
    """Return the largest difference of the measured side from the true branch of z [1]."""
    return largest_absolute(run.side - zone(run.z, *np.array(run.info.widths)))


def steep_ratio(run: Run, slope: float = 0.1) -> float:
    """Return how often x^_1 - x_1 is steep in the last 5 s, relative to the first 5 s [1].

    The first 5 s count as one steep sample at least.

    Args:
        run: the run.
        slope: rate of x^_1 - x_1 above which it is steep [x_1/s].
    """
    steep = np.abs(np.gradient((run.x_hat - run.x)[:, 0], run.info.step)) > slope
    span = round(5.0 / run.info.step)
    return float(steep[-span:].mean() / max(steep[:span].mean(), 1 / span))


def lyapunov_rise(run: Run) -> float:
    """Return the largest increase of V above an earlier value, relative to its largest [1].

    Infinite without V.
    """
    rise = run.largest_rise_of_V
    return np.inf if rise is None else rise


def width_convergence_rate(run: Run) -> float:
    """Return the rate at which |d^ - d| falls [1/s].

    From its largest values in the last second and in one at half time.
    """
    size = np.abs(width_errors(run)).max(axis=1)
    second = round(1.0 / run.info.step)  # in samples
    half = size.size // 2
    ratio = size[half - second : half].max() / size[-second:].max()
    return float(np.log(ratio) / (run.t[-1] - run.t[half - 1]))
