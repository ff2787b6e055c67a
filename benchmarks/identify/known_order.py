"""How often intervals of (L1) and (L2) hold where order and delay are known: many logs, quickly.

Beside them intervals of independent samples (H^-1), and those of (I1) without the correction for
few passages. Then that correction alone, in a regression.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from benchmarks.identify.logs.random_plants import excitation, make, plant
from benchmarks.markdown import head, row
from undeadzone.util.arrays import Floats
from undeadzone_identify.logs.grid import to_grid
from undeadzone_identify.logs.log import Options, log_from_arrays
from undeadzone_identify.logs.prepare import prepare_log
from undeadzone_identify.models.estimates import (
    EstimateCovariance,
    sandwich_covariance,
    student_quantile,
)
from undeadzone_identify.models.kalman_fit import KalmanFit, fit_kalman
from undeadzone_identify.models.plant import PlantSimulator, delay_inputs
from undeadzone_identify.models.zone_fit import ZoneFit, fit_zone
from undeadzone_studies.statistics.intervals import proportion

FAMILIES = ("white", "coloured", "strong", "sines", "one", "drift", "heavy", "late")
FIRST = 700  # seed
PASSAGES = (4, 10, 20, 100)
LENGTH, SAMPLES = 15, 1500  # of a passage, of a regression
REPEATED = 1000


class Coverage(NamedTuple):
    """Whether the edges, then the width, lie in intervals (3): naive, uncorrected, as printed."""

    naive: Floats
    plain: Floats
    own: Floats


def stages(family: str, seed: int) -> tuple[list[Coverage], Floats]:
    """Whether intervals of (L1) and of (L2) hold, and (L2)'s errors of the edges (2)."""
    log = make(seed, family)
    prepared = prepare_log(to_grid([log_from_arrays(log.step, log.u, log.y)]), Options())
    data = prepared.data
    if family == "late":
        data = delay_inputs(data, lateness(seed))
    samples = fit_zone(PlantSimulator(data, log.n), prepared.limits)
    filtered = fit_kalman(samples)[0]
    truth = np.array([log.right, log.left, log.right + log.left]) / data.y_scale
    coverages = [of_fit(fit, truth) for fit in (samples, filtered)]
    error = np.array([filtered.right, filtered.left]) - truth[:2]
    return coverages, np.abs(error) * data.y_scale


def lateness(seed: int) -> int:
    """By how many samples the input of a log of the family `late` acts late, as `make` draws it."""
    rng = np.random.default_rng(90_000 + seed)
    _, _, step, omega, _ = plant(rng)
    excitation(rng, step, omega, False)
    return int(rng.integers(1, 9))


def of_fit(fit: ZoneFit | KalmanFit, truth: Floats) -> Coverage:
    """Whether the truth (3) lies in the intervals of a fit."""
    spread = fit.objective.robust_covariance(fit.theta)
    values = np.array([fit.right, fit.left, fit.right + fit.left])
    rows = [fit.objective.width_weights(right=r, left=le) for r, le in ((1, 0), (0, 1), (1, 1))]
    return coverage_of(spread, np.array(rows), np.abs(values - truth))


def coverage_of(spread: EstimateCovariance, rows: Floats, errors: Floats) -> Coverage:
    """Whether errors (M) of the estimates in these directions (M x P) lie in the intervals."""
    naive = np.einsum("ij,jk,ik->i", rows, spread.naive, rows)
    plain = np.einsum("ij,jk,ik->i", rows, spread.V, rows)
    own = [spread.half_width(one) for one in rows]
    return Coverage(
        1.0 * (errors <= 1.96 * np.sqrt(naive)),
        1.0 * (errors <= student_quantile(spread.degrees) * np.sqrt(plain)),
        1.0 * (errors <= own),
    )


def regression(rng: np.random.Generator, passages: int) -> Coverage:
    """Whether intervals hold of a coefficient whose regressor is on in a few stretches."""
    rows = lfilter([1.0], [1.0, -0.8], rng.standard_normal((SAMPLES, 6)), axis=0)
    rows[:, 0] = 0.0
    for first in rng.integers(0, SAMPLES - LENGTH, passages):
        rows[first : first + LENGTH, 0] = 1.0
    e = rng.standard_normal(SAMPLES)
    fitted = np.linalg.lstsq(rows, e, rcond=None)[0]
    e = e - rows @ fitted
    variance = float(np.mean(e**2))
    spread = sandwich_covariance(rows * e[:, None] / variance, rows.T @ rows / variance)
    return coverage_of(spread, np.eye(6)[:1], np.abs(fitted[:1]))


def share(values: Floats) -> str:
    """A share with its 95 % interval."""
    _, low, high = proportion(int(values.sum()), values.size)
    return f"{values.mean():.3f} [{low:.2f}, {high:.2f}]"


def family_row(family: str, count: int) -> str:
    """A line of the table of logs."""
    done = [stages(family, seed) for seed in range(FIRST, FIRST + count)]
    cells = []
    for stage in (0, 1):
        naive, plain, own = (
            np.array([coverages[stage][k] for coverages, _ in done])
            for k in range(len(Coverage._fields))
        )
        cells += [f"{naive[:, :2].mean():.3f}", f"{plain[:, :2].mean():.3f}", share(own[:, :2])]
    cells.append(share(np.array([coverages[1].own[2] for coverages, _ in done])))
    error = np.concatenate([one for _, one in done])
    return row(family, str(count), *cells, f"{np.median(error):.4f}")


def table(count: int = 60) -> str:
    """The section of RESULTS.md."""
    names = [f"{stage}, {kind}" for stage in ("L1", "L2") for kind in ("H^-1", "plain", "own")]
    rng = np.random.default_rng(0)
    lines = [
        "## Identification where order and delay are known",
        "",
        "Share of edges whose 95 % interval holds, by stage of the fit: of independent samples, of"
        " (I1) as published, and as `identify` takes it, corrected for few passages; of the width;"
        " the median error of an edge. `identify` prints the widest of both stages.",
        "",
        *head("family", "logs", *names, "L2, width", "error"),
        *[family_row(family, count) for family in FAMILIES],
        "",
        f"The same of a regression of {SAMPLES} samples on a regressor that is on in passages of"
        f" {LENGTH} samples, {REPEATED} times:",
        "",
        *head("passages", "H^-1", "plain", "own"),
    ]
    for passages in PASSAGES:
        done = np.array([regression(rng, passages) for _ in range(REPEATED)])[:, :, 0]
        lines.append(row(str(passages), *(f"{one:.3f}" for one in done.mean(axis=0))))
    return "\n".join([*lines, ""])
