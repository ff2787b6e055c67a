"""The result of `estimate`: what an observer makes of a log. There is no truth in it."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Any

from undeadzone.simulation.log_info import LogInfo
from undeadzone.simulation.log_words import in_words
from undeadzone.simulation.run_columns import (
    arrays_of,
    output_names,
    signals_of,
    to_columns,
    to_pandas,
    unit_of,
)
from undeadzone.simulation.run_file import read, table_size, write
from undeadzone.support import shown
from undeadzone.support.arrays import Floats, finite, one_or_list
from undeadzone.support.shown import Block


@dataclasses.dataclass(frozen=True, eq=False)
class Estimation:
    """What an observer makes of a log, one row per sample.

    A signal is None where the method does not estimate it.

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

    t: Floats
    y: Floats
    u: Floats
    side: Floats
    x_hat: Floats
    z_hat: Floats
    d_hat: Floats
    z_inverse: Floats
    innovation: Floats
    info: LogInfo
    x_std: Floats | None = None
    d_std: Floats | None = None
    width_std: Floats | None = None
    innovation_std: Floats | None = None
    B: Floats | None = None
    w_hat: Floats | None = None
    theta_hat: Floats | None = None
    theta_std: Floats | None = None
    c_hat: Floats | None = None
    c_std: Floats | None = None
    gap_std: Floats | None = None
    x_smooth: Floats | None = None
    z_smooth: Floats | None = None
    d_smooth: Floats | None = None
    x_smooth_std: Floats | None = None
    d_smooth_std: Floats | None = None

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
        if self.width_std is not None:
            numbers["width_std"] = one_or_list(self.width_std[-1])
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

    def columns(self) -> dict[str, Floats]:
        """Every scalar signal by column name: t, y[0], ..., d_right[0], d_left[0], ..."""
        return to_columns(signals_of(self))

    def unit(self, name: str) -> str:
        """The unit of a signal or of one of its columns.

        Args:
            name: of the signal, `x_hat`, or of the column, `x_hat[0]`.
        """
        return unit_of(name, self.info.units)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the estimates to a file.

        Args:
            path: ending in `.npz`, or in `.csv` (17 digits, units in the header, the info as a
                first line after #).

        Returns:
            The path.

        Raises:
            FileError: it cannot be written.
            InputError: the name ends otherwise.
        """
        return write(Path(path), self.info, signals_of(self))

    @property
    def table_size(self) -> float:
        """About how many bytes its `.csv` has."""
        return table_size(signals_of(self))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Estimation:
        """Read estimates saved as `.npz` or `.csv`, exactly as they were.

        Args:
            path: of the file.

        Raises:
            FileError: it cannot be read, or holds no estimates of a log.
        """
        values = read(Path(path), *arrays_of(cls), LogInfo)
        values.pop("V")  # which runs of a simulation have
        return cls(**values)

    def to_pandas(self) -> Any:
        """A pandas DataFrame indexed by t, one column per scalar signal; needs pandas."""
        return to_pandas(self)
