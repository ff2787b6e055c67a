"""Diagnosis of a log that does not fit: columns exchanged, another sign, unit, or a delay.

Each is tried on the first samples of the log, with the scenario's own observer. The change whose
log is consistent and predicted best is reported, if there is one.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from undeadzone.logs.samples import Placed, Regular
from undeadzone.results.estimation import Estimation
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.follower import Follower
from undeadzone.util.arrays import Floats, shift_rows

SAMPLES: Final = 3000  # at the beginning of a log, which are tried
DELAYS: Final = (1, 2, 3, 5, 10, 20)  # samples
BETTER: Final = 0.8  # of the share of y that is not predicted: a cure leaves no more


def what_would_fit(scenario: Scenario, found: Estimation) -> str | None:
    """Return the change with which the observer agrees with a log, or None if none helps.

    Args:
        scenario: whose observer followed it.
        found: estimation from the log.
    """
    t = found.t[:SAMPLES]
    y = found.y[:SAMPLES]
    u = found.u[:SAMPLES]
    words = None
    follower = Follower(scenario)
    levels = follower.levels
    rest = (0.0, 0.0) if levels is None else (levels.y, levels.u)
    best = BETTER * _unexplained_share(found.innovation[:SAMPLES], y - rest[0])
    for name, readings, inputs in _misreadings(y, u, rest[1], follower.model.delay):
        follower.begin()
        samples = Regular(t, readings, inputs)
        tried, *_ = follower.follow(samples)
        missed = _unexplained_share(tried.innovation, readings - rest[0])
        if missed < best and follower.info("log", None, Placed(samples)).consistent:
            best = missed
            words = name
    return words


def _misreadings(
    y: Floats, u: Floats, rest: Floats | float, known: int
) -> Iterator[tuple[str, Floats, Floats]]:
    """Yield possible faults of a log, in words, with its readings and inputs corrected for each.

    Args:
        y: readings (N x p).
        u: inputs (N x m).
        rest: input at the operating point (m).
        known: samples by which the scenario has the inputs act late.
    """
    if y.shape == u.shape:
        yield "readings and inputs are exchanged: name their columns", u, y
    yield "the inputs, or the readings, have the other sign", y, 2 * rest - u
    for factor in (1e-3, 1e3):
        yield f"the readings are in another unit: times {factor:g} they fit", y * factor, u
        yield f"the inputs are in another unit: times {factor:g} they fit", y, u * factor
    for delay in DELAYS[: int(np.searchsorted(DELAYS, len(u) / 4))]:
        late, early = (shift_rows(u, samples, np.zeros(1, int)) for samples in (delay, -delay))
        yield f"the inputs act {delay} samples later: plant.delay = {known + delay}", y, late
        earlier = (
            f"plant.delay = {known - delay}"
            if known >= delay
            else f"the log has them late: delay = -{delay}"
        )
        yield f"the inputs act {delay} samples earlier: {earlier}", y, early


def _unexplained_share(innovation: Floats, y: Floats) -> float:
    """Return share of the readings that their predictions miss (rms over rms)."""
    with np.errstate(all="ignore"):
        share = np.nanmean(innovation**2) / np.nanmean(y**2)
    return float(np.sqrt(share)) if np.isfinite(share) else np.inf
