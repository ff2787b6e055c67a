"""The result of `estimate`: what an observer makes of a log. There is no truth in it."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Any

from undeadzone.results import files
from undeadzone.results.info import LogInfo
from undeadzone.results.log_sheet import in_words
from undeadzone.results.signals import LOG, Signals, final, output_names
from undeadzone.support import shown
from undeadzone.support.arrays import Floats, finite
from undeadzone.support.shown import Block


@dataclasses.dataclass(frozen=True, eq=False, init=False)
class Estimation:
    """What an observer makes of a log, one row per sample.

    Each signal is an attribute, None where the method does not estimate it: those of a log, and
    what observers give (`results.signals.ESTIMATED`).

    Args:
        info: what is known besides the signals.
        signals: by name; None: those that are given alone.
        given: signals in their place, or besides them.

    Attributes:
        t: time (N) [s].
        y: reading (N x p) [y], NaN where it is missing.
        u: input (N x m), NaN where it is missing.
        side: measured side (N x p): +1 right, -1 left, 0 silent or missing, +2, -2 at a limit.
        x_hat: estimate of the state from the readings so far (N x n).
        z_hat: estimate of the true output (N x p) [z].
        d_hat: estimates [d_r^, d_l^] of each output (N x 2p) [z].
        z_inverse: the dead-zone inverse (26) (N x p) [z].
        innovation: what each reading adds to the prediction (N x p).
        info: counts, final widths, and whether the record is consistent.
        signals: all of them by name.
        x_std: standard deviation of x_hat (N x n).
        d_std: standard deviation of d_hat (N x 2p) [z].
        width_std: standard deviation of d_r^ + d_l^ (N x p) [z].
        innovation_std: standard deviation of the innovation (N x p).
        B: statistic of the test of consistency after each sample (N x p).
        w_hat: what the observer's model leaves out (N x n), x' = f(x, u) + w.
        theta_hat: parameters of the model that the observer estimates (info.uncertain).
        theta_std: standard deviations of theta_hat.
        c_hat: estimates [c_r^, c_l^] of the play ahead of each dead zone (N x 2p) [z].
        c_std: standard deviation of c_hat (N x 2p) [z].
        gap_std: standard deviation of c_r^ + c_l^ (N x p) [z].
        x_smooth, z_smooth, d_smooth: as x_hat, z_hat, d_hat, but from the whole log; of `kalman`,
            `censored`, `extended` and `auto`.
        x_smooth_std, d_smooth_std: their standard deviations.
    """

    signals: Signals
    info: LogInfo

    def __init__(
        self, info: LogInfo, signals: Signals | None = None, **given: Floats | None
    ) -> None:
        before = {} if signals is None else signals.arrays
        object.__setattr__(self, "info", info)
        object.__setattr__(self, "signals", Signals(LOG, {**before, **given}))

    def __getattr__(self, name: str) -> Any:
        """A signal by name, None where there is none. Raises AttributeError."""
        if name not in LOG.names:
            raise AttributeError(f"an estimation has no attribute {name!r}")
        return self.signals.arrays.get(name)

    def __dir__(self) -> list[str]:
        """The attributes, signals among them."""
        return [*object.__dir__(self), *LOG.names]

    @property
    def consistent(self) -> bool | None:
        """Whether the innovations are what the observer claims; None: it cannot be tested."""
        return self.info.consistent

    @property
    def outputs(self) -> list[str]:
        """The names of the outputs: an arm's joints where it has one for each, else numbers."""
        return output_names(self.info.joints, self.y.shape[1])

    def summary(self) -> dict[str, Any]:
        """The numbers of the log, ready for JSON; lists where there are several outputs."""
        numbers = self.info.summary()
        numbers |= final(self.signals.arrays, "width_std")
        if self.theta_hat is not None and self.theta_std is not None:
            ends = zip(self.info.uncertain, self.theta_hat[-1], self.theta_std[-1], strict=True)
            numbers["parameters"] = {
                name: {"estimate": float(value), "std": float(std)} for name, value, std in ends
            }
        numbers["smoothed"] = self.z_smooth is not None
        return finite(numbers)

    def blocks(self) -> list[Block]:
        """The tables that `undeadzone estimate` prints."""
        return in_words(self.info)

    __repr__ = shown.in_text
    _repr_html_ = shown.in_notebook

    plot = shown.plot
    """Draw it."""

    columns = files.columns
    unit = files.unit
    to_pandas = files.to_pandas
    save = files.save
    table_size = property(files.table_size)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Estimation:
        """Read estimates saved as `.npz` or `.csv`, exactly as they were.

        Args:
            path: of the file.

        Raises:
            FileError: it cannot be read, or holds no estimates of a log.
        """
        return cls(*files.read(Path(path), LOG, LogInfo))
