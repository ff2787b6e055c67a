"""Tunable numbers and the objective, in the terms of a scenario's [tune] table.

An entry is an address and its bounds.
"""

from __future__ import annotations

from typing import Final, Literal

from undeadzone.scenario.address_table import Table
from undeadzone.util.toml import OptionTable


class Range(OptionTable, frozen=True, kw_only=True):
    """The range in which a number is searched.

    Attributes:
        between: [low, high], the bounds of the number.
        log: search on a logarithmic scale, for gains.
        start: first number of the search, by default the number in the scenario. If the scenario
            leaves it to the method, the middle of the range, for `observer.L` the method's gains.
    """

    between: tuple[float, float]
    log: bool = False
    start: float | None = None


class Tune(OptionTable, frozen=True, kw_only=True):
    """Numbers to be tuned.

    A key in quotes is the address of one: `"observer.gamma" = { between = [0.1, 100.0], log = true
    }`. Addresses are those of the options in the scenario: `observer.gamma`, `observer.L[0]` of a
    list, `observer.L[1,0]` of rows, `observer.adaptation.leak`, `controller.alpha`,
    `controller.poles[0]`. Without an index, or with `:` for one, every entry is tuned by itself.

    Attributes:
        metric: number of a run, to be made small: rms_tracking, rms_estimation, peak_tracking,
            settling_time, rms_input, silent_fraction, or the size of a final error of the widths,
            `d_right_error[0]`, `d_left_error[0]`.
        statistic: statistic of the metric over the runs.
        certified: keep the observer's constant gains certified with at least `margin`.
        margin: least margin of the certificate.
        runs: number of runs of each candidate, the same for all, drawn as in [ensemble].
        held_out: number of other runs, of the next seed, on which the result is judged.
        budget: number of candidates simulated in all, those for gradients included (one that is
            refused or lacks the certificate costs nothing of it).
        seed: seed of the random numbers (default: that of [ensemble]).
        entries: the bounds, by address. A key with a dot directly in [tune] is one of them.
    """

    metric: str = "rms_tracking"
    statistic: Literal["mean", "median", "p95", "worst"] = "mean"
    certified: bool = False
    margin: float = 0.01
    runs: int = 64
    held_out: int = 256
    budget: int = 200
    seed: int | None = None
    entries: dict[str, Range] = {}


TABLE: Final = Table(
    "tune", Range, "bounds", '"observer.gamma" = { between = [0.1, 100.0], log = true }'
)
