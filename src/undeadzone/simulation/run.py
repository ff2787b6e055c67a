"""The result of a run: named signals with their units, what was found out about them, and how to keep them."""

from __future__ import annotations

import csv
import dataclasses
import os
import zipfile
import zlib
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from undeadzone.errors import FileError, InputError
from undeadzone.scenario.schema import Units
from undeadzone.support.arrays import Floats, finite
from undeadzone.support.files import reason, replacing

LAST = 2.0  # [s] over which errors are measured
FRAMES = 25  # per second, of an arm's poses
LIMIT = 1e12  # beyond this a state has diverged


class Info(msgspec.Struct, frozen=True, kw_only=True):
    """What a run knows besides its signals; widths: the true [right, left] of each output; joints: names, of an arm;
    uncertain: the parameters that the observer estimates, and their true values; label: what tells its observer from one that it is compared with.
    """

    title: str
    method: str
    time: str
    step: float
    tracked: list[int]
    widths: list[float]
    threshold: list[float]
    certified: bool | None
    integration_error: float | None
    identifiable: list[dict[str, Any]]
    seconds: float
    units: Units = Units()
    joints: list[str] = []
    uncertain: dict[str, float] = {}
    label: str = ""
    adapts: bool = True


@dataclasses.dataclass(frozen=True, eq=False)
class Run:
    """Signals of one run, one row per sample: t [s] (N), the others N x (n, p, m, 2p); V (N) where a certificate exists.

    x: state; z: true output; y: reading; side: measured side; x_hat, z_hat: estimates; d_hat: [d_r^, d_l^] of each
    output; z_inverse: the deadzone inverse (26); u: input; r: reference of the tracked outputs; innovation: observer's.
    x_std, d_std, width_std, innovation_std: standard deviations of x_hat, d_hat, d_r^ + d_l^ and innovation, where the
    observer knows them; w_hat: what its model leaves out, x' = f(x, u) + w (n), where it estimates that; theta_hat, theta_std: the model's
    parameters that it takes for uncertain (info.uncertain), and their standard deviations. Of an arm: tip,
    tip_hat, tip_r: where its tip is, is believed to be and should be [m] (2 or 3); poses (F x K x 3): where base, joints and tip are at
    FRAMES instants per second, from t = 0 on [m] (in `.npz` files only).
    """

    t: Floats
    x: Floats
    z: Floats
    y: Floats
    side: Floats
    x_hat: Floats
    z_hat: Floats
    d_hat: Floats
    z_inverse: Floats
    innovation: Floats
    u: Floats
    r: Floats
    V: Floats | None
    info: Info
    x_std: Floats | None = None
    d_std: Floats | None = None
    width_std: Floats | None = None
    innovation_std: Floats | None = None
    w_hat: Floats | None = None
    theta_hat: Floats | None = None
    theta_std: Floats | None = None
    tip: Floats | None = None
    tip_hat: Floats | None = None
    tip_r: Floats | None = None
    poses: Floats | None = None

    @property
    def last(self) -> slice:
        """The samples of the last 2 s (all of a shorter run)."""
        return last_samples(self.t)

    @property
    def diverged_at(self) -> float | None:
        """The time [s] at which a signal left +-1e12 or stopped being a number; None if none did."""
        worst = np.abs(np.hstack([self.x, self.x_hat, self.d_hat, self.u])).max(axis=1)
        bad = np.flatnonzero(~(worst < LIMIT))
        return float(self.t[bad[0]]) if bad.size else None

    @property
    def shown(self) -> slice:
        """The samples that a figure shows: those up to where the run diverged, two at least."""
        return slice(
            0,
            self.t.size
            if self.diverged_at is None
            else max(2, int(np.searchsorted(self.t, self.diverged_at))),
        )

    @property
    def name(self) -> str:
        """What figures call its observer: the method, and what tells it from one that it is compared with."""
        return self.info.label or self.info.method

    @property
    def rms_tracking(self) -> float:
        """Root mean square of z - r over the last 2 s and the tracked outputs."""
        return _rms((self.z[:, self.info.tracked] - self.r)[self.last])

    @property
    def rms_estimation(self) -> float:
        """Root mean square of z - z_hat over the last 2 s and all outputs."""
        return _rms((self.z - self.z_hat)[self.last])

    @property
    def rms_tip(self) -> float | None:
        """Root mean square distance of an arm's tip from where it should be over the last 2 s [m]; None without an arm."""
        if self.tip is None or self.tip_r is None:
            return None
        return float(np.sqrt(np.sum((self.tip - self.tip_r)[self.last] ** 2, axis=1).mean()))

    @property
    def widths(self) -> Floats:
        """The final width estimates (p x 2): [d_r^, d_l^] of each output."""
        return self.d_hat[-1].reshape(-1, 2)

    @property
    def parameters(self) -> dict[str, dict[str, float]]:
        """The final estimates of uncertain parameters, their standard deviations, and the truth."""
        if self.theta_hat is None or self.theta_std is None:
            return {}
        ends = zip(self.info.uncertain.items(), self.theta_hat[-1], self.theta_std[-1], strict=True)
        return {
            name: {"estimate": float(value), "std": float(std), "true": true}
            for (name, true), value, std in ends
        }

    @property
    def outputs(self) -> list[str]:
        """The names of the outputs: those of an arm's joints where it has one for each, else their numbers."""
        several = len(self.info.joints) == self.z.shape[1]
        return list(self.info.joints) if several else [str(i) for i in range(self.z.shape[1])]

    @property
    def silent_fraction(self) -> float:
        """The share of samples at which an output is silent."""
        return float((self.side == 0).mean())

    @property
    def largest_rise_of_V(self) -> float | None:
        """The largest increase of V above any earlier value, relative to the largest V; None without a certificate."""
        if self.V is None:
            return None
        with np.errstate(invalid="ignore"):
            return float(
                (self.V - np.minimum.accumulate(self.V)).max() / np.maximum(self.V.max(), 1e-300)
            )

    @property
    def fully_identifiable(self) -> bool:
        """Whether every width of every output could be told from this run's readings."""
        return all(verdict["right"] and verdict["left"] for verdict in self.info.identifiable)

    @property
    def adapts(self) -> bool:
        """Whether the observer estimates the widths: `luenberger` and `oracle` do not, nor does a blind filter."""
        return self.info.adapts

    def summary(self) -> dict[str, Any]:
        """The numbers of the run, ready for JSON; lists where there are several outputs."""

        def each(column: Floats) -> Any:
            return column.tolist() if column.size > 1 else float(column[0])

        right, left = map(each, self.widths.T)
        verdicts = self.info.identifiable
        found: dict[str, Any] = {
            "title": self.info.title,
            "method": self.info.method,
            "time": self.info.time,
            "step": self.info.step,
            "rms_tracking": self.rms_tracking,
            "rms_estimation": self.rms_estimation,
            **({} if self.tip is None else {"rms_tip": self.rms_tip}),
            "d_right": right,
            "d_left": left,
            "d_right_std": None if self.d_std is None else each(self.d_std[-1, 0::2]),
            "d_left_std": None if self.d_std is None else each(self.d_std[-1, 1::2]),
            **({} if self.theta_hat is None else {"parameters": self.parameters}),
            "width_std": None if self.width_std is None else each(self.width_std[-1]),
            "silent_fraction": self.silent_fraction,
            "certified": self.info.certified,
            "largest_rise_of_V": self.largest_rise_of_V,
            "integration_error": self.info.integration_error,
            "identifiable": verdicts[0] if len(verdicts) == 1 else verdicts,
            "diverged_at": self.diverged_at,
            "seconds": self.info.seconds,
        }
        return finite(found)

    def columns(self) -> dict[str, Floats]:
        """Every scalar signal by column name: t, x[0], ..., d_right[0], d_left[0], ..., V."""
        found = {"t": self.t}
        for name in ARRAYS[1:]:
            value = getattr(self, name)
            if value is None or value.ndim > 2:
                continue
            if value.ndim == 1:
                found[name] = value
            elif name in EDGES:
                found |= {
                    f"{EDGES[name][i % 2]}[{i // 2}]": value[:, i] for i in range(value.shape[1])
                }
            else:
                found |= {f"{name}[{i}]": value[:, i] for i in range(value.shape[1])}
        return found

    def unit(self, name: str) -> str:
        """The unit of a signal or of one of its columns."""
        units, (signal, _, index) = self.info.units, name.partition("[")
        if signal in ("x", "x_hat", "x_std", "w_hat"):
            state = (
                units.state
                if isinstance(units.state, str)
                else units.state[int(index.rstrip("]") or 0)]
            )
            return f"{state}/s" if signal == "w_hat" else state
        if signal in ("theta_hat", "theta_std"):
            return "1"
        return {
            "t": "s",
            "u": units.input,
            "side": "1",
            "V": "1",
            "tip": "m",
            "tip_hat": "m",
            "tip_r": "m",
        }.get(signal, units.output)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write `.npz` or `.csv` (17 digits, units in the header, the info as a first line after #). Raises FileError, InputError."""
        path = Path(path)
        if path.suffix == ".npz":
            arrays = {name: value for name in ARRAYS if (value := getattr(self, name)) is not None}
            with replacing(path) as temporary, open(temporary, "wb") as file:
                np.savez_compressed(
                    file, info=np.frombuffer(msgspec.json.encode(self.info), np.uint8), **arrays
                )
        elif path.suffix == ".csv":
            columns = self.columns()
            with (
                replacing(path) as temporary,
                open(temporary, "w", encoding="utf-8", newline="") as table,
            ):
                table.write(f"# {msgspec.json.encode(self.info).decode()}\n")
                csv.writer(table, lineterminator="\n").writerow(
                    [f"{name} [{' '.join(self.unit(name).split())}]" for name in columns]
                )
                np.savetxt(
                    table, np.stack(list(columns.values()), axis=1), fmt="%.17g", delimiter=","
                )
        else:
            raise InputError(f"{path}: the name must end in .npz or .csv")
        return path

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Run:
        """Read a run saved as `.npz` or `.csv`, exactly as it was. Raises FileError."""
        try:
            if Path(path).suffix == ".csv":
                return cls(**_read_csv(Path(path)))
            with np.load(path, allow_pickle=False) as file:
                arrays = {name: file[name] for name in ARRAYS if name in file}
                info = msgspec.json.decode(file["info"].tobytes(), type=Info)
            return cls(**{"V": None, **arrays}, info=info)
        except OSError as error:
            raise FileError(f"{path}: cannot read: {reason(error)}") from None
        except (
            ValueError,
            KeyError,
            TypeError,
            StopIteration,
            EOFError,
            msgspec.DecodeError,
            zipfile.BadZipFile,
            zlib.error,
        ) as error:
            raise FileError(f"{path}: not a run saved by undeadzone ({error})") from None

    def to_pandas(self) -> Any:
        """A pandas DataFrame indexed by t, one column per scalar signal; needs pandas."""
        import pandas as pd

        columns = self.columns()
        return pd.DataFrame(
            {name: values for name, values in columns.items() if name != "t"},
            index=pd.Index(columns["t"], name="t"),
        )


ARRAYS = tuple(field.name for field in dataclasses.fields(Run) if field.name != "info")
REQUIRED = tuple(
    field.name
    for field in dataclasses.fields(Run)
    if field.name in ARRAYS and field.default is dataclasses.MISSING
)
EDGES = {"d_hat": ("d_right", "d_left"), "d_std": ("d_right_std", "d_left_std")}  # names of columns


def last_samples(t: Floats) -> slice:
    """The samples at times t [s] over which errors are measured: of the last 2 s (all of a shorter run)."""
    return slice(int(np.searchsorted(t, t[-1] - LAST - 1e-12)), None)


def _read_csv(path: Path) -> dict[str, Any]:
    """The fields of a `Run` from the columns that `Run.columns` names."""
    with open(path, encoding="utf-8", newline="") as file:
        info = msgspec.json.decode(file.readline().removeprefix("# "), type=Info)
        names = [cell.partition(" [")[0] for cell in next(csv.reader([file.readline()]))]
        rows = file.readlines()
    if not rows:
        raise ValueError("no samples")
    table = np.loadtxt(rows, delimiter=",", ndmin=2)
    columns = dict(zip(names, table.T, strict=True))
    fields: dict[str, Any] = {"info": info, "V": columns.get("V"), "t": columns["t"]}
    for name in set(ARRAYS) - {"t", "V"}:
        parts = [
            column
            for key, column in columns.items()
            if key.partition("[")[0] in EDGES.get(name, (name,))
        ]
        if parts or name in REQUIRED:
            fields[name] = np.stack(parts, axis=1)
    return fields


def _rms(values: Floats) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        return float(np.sqrt(np.mean(values**2)))
