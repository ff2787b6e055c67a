"""What may be tuned and to what end, in the words of a scenario's [tune] table: an address and its bounds."""

from __future__ import annotations

from typing import Final, Literal

import msgspec

from undeadzone.scenario.address_table import Table


class Range(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """between: [low, high], the bounds of a number. log: search on a logarithmic scale, for gains. start: where the search begins.

    Default of start: the number in the scenario; where the scenario leaves it to the method, the middle of the range.
    """

    between: tuple[float, float]
    log: bool = False
    start: float | None = None


class Tune(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Numbers to be tuned. A key in quotes is the address of one: `"observer.gamma" = { between = [0.1, 100.0], log = true }`.

    Addresses are those of the options as the scenario gives them: `observer.gamma`, `observer.L[0]` of a list, `observer.L[1,0]`
    of rows, `observer.adaptation.leak`, `controller.alpha`, `controller.poles[0]`; without an index, or with `:` for one, every
    entry is tuned by itself. metric: of a run, to be made small: rms_tracking, rms_estimation, peak_tracking, settling_time,
    rms_input, silent_fraction, or the size of a final error of the widths, `d_right_error[0]`, `d_left_error[0]`. statistic: of
    the runs. certified: keep the observer's constant gains certified with at least `margin`. runs: of each candidate, the same
    for all, drawn as [ensemble] says; held_out: others, of the next seed, on which the result is judged. budget: how many
    candidates are simulated in all, those for gradients included; one that is refused or lacks the certificate costs nothing
    of it. seed: default that of [ensemble]. entries: what is tuned, by address; a key with a dot directly in [tune] is one
    of them.
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
