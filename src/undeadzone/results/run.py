"""Result of a run: signals by name, with their units and derived facts."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Final

import numpy as np

from undeadzone.analysis.identifiability.linear import format_yes_no
from undeadzone.interfaces import describe_noise, describe_rejected_assumptions, describe_unknowns
from undeadzone.nonlinearities.sensor import DIRECTIONS
from undeadzone.results import files, sheet
from undeadzone.results.feedback import describe_feedback as listening_in_words
from undeadzone.results.info import Info
from undeadzone.results.scales import LIMIT, Scales, largest_scaled_signals
from undeadzone.results.sheet import Row, rows_to_json
from undeadzone.results.signals import (
    RUN,
    final_rejections,
    last_values,
    list_summary_signals,
    output_names,
)
from undeadzone.util.arrays import Floats, to_json_value, to_scalar_or_list
from undeadzone.util.files import require_schema
from undeadzone.util.shown import Block, Rows
from undeadzone.util.text import count_noun, interval_95, label_with_unit

LAST: Final = 2.0  # [s] over which errors are measured
FRAMES: Final = 25  # per second, of an arm's poses
ERRORS: Final = {  # over the end of a run: names in words
    "rms_tracking": "rms z - r",
    "rms_estimation": "rms z - z^",
    "rms_behind_play": "rms y/m - r",
    "rms_tip": "rms tip",
}
INEXACT: Final = 0.01  # of the largest |z|: an integration error above this is a failure


@dataclasses.dataclass(frozen=True, eq=False, init=False, repr=False)
class Run(files.SignalResult):
    """Signals of a run, one row per sample.

    Each signal is an attribute, None if the method does not estimate it or the plant does not have
    it: those of a simulation, and all that observers give (`results.signals.ESTIMATED`).

    Attributes:
        t: time (N) [s].
        x: state (N x n).
        z: true output (N x p) [z].
        y: reading (N x p) [y].
        side: measured side (N x p): +1 right, -1 left, 0 silent, +2, -2 at a limit of the range.
        x_hat: estimate of x (N x n).
        z_hat: estimate of z (N x p) [z].
        d_hat: estimates [d_r^, d_l^] of each output (N x 2p) [z].
        z_inverse: the deadzone inverse (26) (N x p) [z].
        innovation: the observer's (N x p).
        u: input (N x m).
        r: reference of the tracked outputs (N x tracked).
        V: storage function (N), if a certificate exists.
        info: facts besides the signals.
        signals: all of them by name.
        x_std: standard deviation of x_hat (N x n).
        d_std: standard deviation of d_hat (N x 2p) [z].
        width_std: standard deviation of d_r^ + d_l^ (N x p) [z].
        innovation_std: standard deviation of the innovation (N x p).
        w_hat: estimated effects that the observer's model leaves out (N x n), x' = f(x, u) + w.
        theta_hat: the model's parameters that the observer takes for uncertain (info.uncertain).
        theta_std: standard deviations of theta_hat.
        consistent: 1 if recent readings fit the observer's assumptions, else 0 (N x 1).
        claims, suspect: bits of the assumptions that they reject, and number of the most probable
            (N x 1).
        refused: readings that the observer took for wrong so far (N x p).
        restarts: how often the observer lost its state so far (N x 1).
        b_hat: estimates [b_r^, b_l^] of each actuator (N x 2m) [u].
        b_std: standard deviation of b_hat (N x 2m) [u].
        c_hat: estimates [c_r^, c_l^] of the play ahead of each dead zone (N x 2p) [z].
        c_std: standard deviation of c_hat (N x 2p) [z].
        gap_std: standard deviation of c_r^ + c_l^ (N x p) [z].
        noise: rms of a reading outside the zone, as learnt and as assumed (N x 2p) [z].
        level: level behind a play, y / m without noise (N x p) [z] (absent if its gaps drift).
        tip, tip_hat, tip_r: true, estimated and reference position of an arm's tip (N x 2 or 3)
            [m].
        poses: positions of an arm's base, joints and tip at FRAMES instants per second, from t = 0
            on (F x K x 3) [m] (in `.npz` files only).

    Example:
        >>> run.z.shape == run.y.shape
        True
        >>> run.rms_tracking < 0.01
        True

    See Also:
        simulate, plot
    """

    info: Info

    layout: ClassVar = RUN

    @property
    def last(self) -> slice:
        """Return the samples of the last 2 s (all of a shorter run)."""
        return last_samples(self.t)

    @property
    def lasting(self) -> float:
        """Return the length of the final interval in which errors are measured [s].

        That is 2 s, or all of a shorter run.
        """
        return min(LAST, float(self.t[-1] - self.t[0]))

    @property
    def divergence_time(self) -> float | None:
        """Return the time at which a signal left 1e12 times its scale or was not finite,
        or None [s].

        The scales are the plant's own, so that no choice of units makes a run diverge.
        """
        *of_states, of_outputs, of_inputs = self.info.scales or [1.0, 1.0]
        scales = Scales(np.array(of_states or [1.0]), of_outputs, of_inputs)
        outputs = [self.z, self.z_hat, self.d_hat]
        worst = largest_scaled_signals(scales, [self.x, self.x_hat], outputs, self.u)
        bad = np.flatnonzero(~(worst < LIMIT))
        return float(self.t[bad[0]]) if bad.size else None

    @property
    def inexact(self) -> bool:
        """Return whether half the step changes the run too much for a valid result.

        That is more than 1 % of the largest |z|, in z, z^ or d^.
        """
        share = self.info.integration_share
        return share is not None and not share <= INEXACT

    @property
    def plot_window(self) -> slice:
        """Return the samples that a figure shows: until divergence, at least two."""
        diverged = self.divergence_time
        if diverged is None:
            return slice(0, self.t.size)
        return slice(0, max(2, int(np.searchsorted(self.t, diverged))))

    @property
    def observer_name(self) -> str:
        """Return the observer's name in figures.

        This is the method, or the label that distinguishes it from the compared one.
        """
        return self.info.label or self.info.method

    @property
    def rms_tracking(self) -> float:
        """Return the root mean square of z - r over the last 2 s and the tracked outputs
        [z].
        """
        return root_mean_square((self.z[:, self.info.tracked] - self.r)[self.last])

    @property
    def rms_estimation(self) -> float:
        """Return the root mean square of z - z_hat over the last 2 s and all outputs [z]."""
        return root_mean_square((self.z - self.z_hat)[self.last])

    @property
    def rms_behind_play(self) -> float | None:
        """Return the root mean square of y / m - r over the last 2 s [z], or None without a play.

        Here y is without noise.
        """
        if self.level is None:
            return None
        return root_mean_square((self.level[:, self.info.tracked] - self.r)[self.last])

    @property
    def rms_tip(self) -> float | None:
        """Return the root mean square distance of an arm's tip from its path over the last
        2 s [m].

        None without an arm.
        """
        if self.tip is None or self.tip_r is None:
            return None
        return float(np.sqrt(np.sum((self.tip - self.tip_r)[self.last] ** 2, axis=1).mean()))

    @property
    def widths(self) -> Floats:
        """Return the final width estimates (p x 2): [d_r^, d_l^] of each output [z]."""
        return self.d_hat[-1].reshape(-1, 2)

    @property
    def parameters(self) -> dict[str, dict[str, float]]:
        """Return the final estimates of uncertain parameters, with standard deviations and
        true values.
        """
        true = self.info.uncertain
        found = self.signals.parameters(true)
        return {name: each | {"true": true[name]} for name, each in found.items()}

    @property
    def outputs(self) -> list[str]:
        """Return the names of the outputs: an arm's joints if the counts agree, else
        numbers.
        """
        return output_names(self.info.joints, self.z.shape[1])

    @property
    def silent_fraction(self) -> float:
        """Return the share of samples inside the zone of an output [1]."""
        return float((self.side == 0).mean())

    @property
    def largest_rise_of_V(self) -> float | None:
        """Return the largest increase of V above any earlier value, relative to the
        largest V [1].

        None without a certificate.
        """
        if self.V is None:
            return None
        with np.errstate(invalid="ignore"):
            rise = (self.V - np.minimum.accumulate(self.V)).max()
            return float(rise / np.maximum(self.V.max(), 1e-300))

    @property
    def fully_identifiable(self) -> bool:
        """Return whether every width of every output was identifiable from this run's
        readings.
        """
        return all(verdict["right"] and verdict["left"] for verdict in self.info.identifiable)

    @property
    def adapts(self) -> bool:
        """Return whether the observer estimates the widths.

        `luenberger`, `oracle` and a blind filter do not.
        """
        return self.info.adapts

    def summary(self) -> dict[str, Any]:
        """Return the numbers of the run, ready for JSON (lists for several outputs)."""
        verdicts = self.info.identifiable
        listens = self.info.listens
        ends = self.signals.arrays
        numbers: dict[str, Any] = {
            "title": self.info.title,
            "method": self.info.method,
            "time": self.info.time,
            "step": self.info.step,
            **rows_to_json(final_error_rows(self)),
            **last_values(ends, "d_hat"),
            **({"d_right_std": None, "d_left_std": None} | last_values(ends, "d_std")),
            **({} if self.theta_hat is None else {"parameters": self.parameters}),
            **last_values(ends, *list_summary_signals(float, but=("d_hat", "d_std", "width_std"))),
            **({"width_std": None} | last_values(ends, "width_std")),
            **_gap_intervals(self),
            **last_values(ends, *list_summary_signals(bool), *list_summary_signals(int)),
            **final_rejections(ends),
            "listens": to_scalar_or_list(np.array(listens, float)) if listens else None,
            "silent_fraction": self.silent_fraction,
            "certified": self.info.certified,
            "largest_rise_of_V": self.largest_rise_of_V,
            "integration_error": self.info.integration_error,
            "inexact": self.inexact,
            "identifiable": to_scalar_or_list(verdicts),
            "diverged_at": self.divergence_time,
            "seconds": self.info.seconds,
        }
        return to_json_value(numbers)

    def blocks(self) -> list[Block]:
        """Return the tables that `undeadzone run` prints."""
        return blocks_from_run(self)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Run:
        """Read a run saved as `.npz` or `.csv`, exactly as it was.

        Args:
            path: of the file.

        Raises:
            FileError: it cannot be read, or is not a run.
        """
        info, *signals = files.read_result(path, RUN, Info)
        require_schema(info.schema, path)
        return cls(info, *signals)


def last_samples(t: Floats) -> slice:
    """Return the samples at times t [s] in which errors are measured: the last 2 s, or all."""
    return slice(int(np.searchsorted(t, t[-1] - LAST - 1e-12)), None)


def root_mean_square(values: Floats) -> float:
    """Return the root mean square of all entries."""
    with np.errstate(over="ignore", invalid="ignore"):
        return float(np.sqrt(np.mean(values**2)))


def _gap_intervals(run: Run) -> dict[str, Any]:
    """Return the 95 % interval of each gap of gears for JSON, or nothing without such gaps.

    It is the declared range if the gap cannot be known.
    """
    if not run.info.halves:
        return {}
    ends = []
    for gap, _ in final_width_rows(run):
        assert gap.value is not None
        std = math.inf if gap.withheld else gap.std or 0.0
        ends.append(interval_95(gap.value, std, gap.least, gap.most))
    low, high = np.array(ends).T
    return {"gap_low": to_scalar_or_list(low), "gap_high": to_scalar_or_list(high)}


def final_error_rows(run: Run) -> list[Row]:
    """Return the errors at the end of a run."""
    last = f"last {run.lasting:g} s"
    unit = run.info.units.output
    rows = []
    for key, name in ERRORS.items():
        value = getattr(run, key)
        of = unit
        note = f" ({last})"
        if key == "rms_tip":
            of = "m"
            note = f" from its path ({last})"
        if value is not None:
            rows.append(Row(name, value, of, key=key, form=".4g", note=note))
    if run.info.tips:
        found, blind = run.info.tips
        note = f" ({last}; by the encoders alone {blind:.4g} m)"
        key = "rms_tip_estimation"
        rows.append(Row("rms tip - tip^", found, "m", key=key, form=".4g", note=note))
    return rows


def final_parameter_rows(run: Run) -> list[Row]:
    """Return the parameters that the observer estimates."""
    rows = []
    for name, found in run.parameters.items():
        note = f" (true {found['true']:g})"
        std = found["std"]
        rows.append(Row(name, found["estimate"], std=std, note=note))
    return rows


def lost_motion_rows(run: Run) -> list[Row]:
    """Return the lost motion of each joint whose wind-up is estimated: gap + 2 T / k.

    T is the largest torque of its motor. Gap and wind-up are separated if the interval of 1 / k
    leaves out 0.
    """
    rows = []
    gaps = final_width_rows(run) if run.info.joints else []
    for i, name in enumerate(run.info.joints):
        found = run.parameters.get(f"winding{i + 1}")
        gap = gaps[i][0]
        if found is None or gap.withheld or gap.value is None:
            continue
        torque = float(np.abs(run.u[:, i]).max())
        wound, std = 2 * torque * found["estimate"], 2 * torque * found["std"]
        parts = ": gap and wind-up are not separated"
        if interval_95(wound, std)[0] > 0:
            parts = f": gap {gap.value:.4g}, wind-up {wound:.3g} +- {std:.2g}"
        note = f" at {torque:.3g} N m{parts}"
        label = f"lost motion of {name}"
        both = math.hypot(gap.std or 0.0, std)
        rows.append(Row(label, gap.value + wound, gap.unit, both, least=0.0, note=note))
    return rows


def wear_rows(run: Run) -> list[Row]:
    """Return the growth of each gap whose wear is estimated, and the trend of each side.

    A worn gap grows to both sides. Where one side grows as the other shrinks, an encoder slips.
    """
    rows = []
    half = len(run.t) // 2
    for i, name in enumerate(run.info.joints):
        found = run.parameters.get(f"wear{i + 1}")
        if found is None or run.d_hat is None:
            continue
        moved = run.d_hat[-1] - run.d_hat[half]
        right, left = moved.reshape(-1, 2)[i] / (run.t[-1] - run.t[half])
        grows = min(right, left) > 0 and interval_95(found["estimate"], found["std"])[0] > 0
        note = f": {'wears' if grows else 'no wear shows'}; right {right:.2g}, left {left:.2g}"
        unit = f"{run.info.units.output}/s"
        label = f"gap of {name} grows by"
        rows.append(Row(label, 2 * found["estimate"], unit, 2 * found["std"], note=note))
    return rows


def final_width_rows(run: Run) -> list[list[Row]]:
    """Return the widths of each output, of gears their gap and its centre."""
    info = run.info
    rows = final_side_rows(run)
    if info.sensor != "gears":
        return rows
    deviations = None if run.width_std is None else run.width_std[-1].tolist()
    return sheet.build_gear_rows(rows, deviations, info.halves, info.identifiable)


def final_side_rows(run: Run) -> list[list[Row]]:
    """Return the right and the left width of each output."""
    return sheet.build_width_rows(
        _last_widths(run), "d", run.info.units.output, run.info.widths, run.info.ranges
    )


def final_actuator_rows(run: Run) -> list[list[Row]]:
    """Return the widths of each actuator, empty if not estimated."""
    return sheet.build_width_rows(_last_widths(run), "b", run.info.units.input, run.info.actuator)


def final_gap_rows(run: Run) -> list[list[Row]]:
    """Return the gaps of the play ahead of each dead zone, empty if not estimated."""
    return sheet.build_width_rows(_last_widths(run), "gap", run.info.units.output, run.info.gaps)


def describe_last_noise(run: files.SignalResult) -> str:
    """Describe the learnt noise where it exceeds the assumed one, or return ''."""
    return "" if run.noise is None else describe_noise(*np.split(run.noise[-1], 2))


def _last_widths(run: Run) -> dict[str, Any]:
    """Return the last widths and gaps by name, with known deviations."""
    names = "d_hat", "d_std", "b_hat", "b_std", "c_hat", "c_std", "gap_std"
    return last_values(run.signals.arrays, *names)


def blocks_from_run(run: Run) -> list[Block]:
    """Return the summary of a run: pairs, and for several outputs a table with their rows."""
    info = run.info
    single = len(run.outputs) == 1
    summary: dict[str, Any] = {
        "scenario": info.title,
        "observer": f"{info.method}, {info.time} time, step {info.step:g} s",
    }
    driven = final_actuator_rows(run)
    if single:
        summary |= sheet.rows_to_text(final_width_rows(run)[0])
    if len(driven) == 1:
        summary |= sheet.rows_to_text(driven[0])
    if single:
        for rows in final_gap_rows(run):
            summary |= sheet.rows_to_text(rows)
    found = [*final_parameter_rows(run), *lost_motion_rows(run), *wear_rows(run)]
    found += final_error_rows(run)
    summary |= sheet.rows_to_text(found)
    if info.sensor != "gears":  # whose encoders are never silent
        quiet = "holding" if info.sensor == "play" else "silent"
        summary[quiet] = f"{100 * run.silent_fraction:.1f} % of the time"
    if run.divergence_time is not None:  # identifiability is of no use then
        summary["DIVERGED"] = f"at {run.divergence_time:g} s"
        return [summary] if single else [summary, _final_output_rows(run)]
    if refuted := final_rejections(run.signals.arrays).get("claims"):
        summary["claims"] = "NOT as told: " + "; ".join(
            describe_rejected_assumptions(refuted, info.options)
        )
    if louder := describe_last_noise(run):
        summary["noise"] = louder
    if unknown := describe_unknowns(info.options):
        summary["not told"] = unknown
    if info.listens:
        summary["listens"] = listening_in_words(info.listens)
    summary |= _describe_proof(run) | _describe_identifiable(info, run.outputs)
    if run.inexact:
        share = info.integration_share
        assert share is not None
        summary["NOT EXACT"] = (
            f"half the step changes the run by {100 * share:.3g} % of the largest |z|, and the "
            f"numbers are useless. Use a smaller simulation.step"
        )
    return [summary] if single else [summary, _final_output_rows(run)]


def _final_output_rows(run: Run) -> Rows:
    """Return a row for each output: errors, widths and identifiability."""
    info = run.info
    unit = run.info.units.output
    sides = ("gap", "centre") if info.sensor == "gears" else ("d_right", "d_left")
    heads = [label_with_unit(name, unit) for name in ("rms z - r", "rms z - z^", *sides)]
    what = "joint" if info.joints == run.outputs else "output"
    rows: list[Sequence[str]] = [(what, *heads[:3], "true", heads[3], "true", "identifiable")]
    for i, (name, edges) in enumerate(zip(run.outputs, final_width_rows(run), strict=True)):
        tracking = ""
        if i in info.tracked:
            missed = run.z[:, i] - run.r[:, info.tracked.index(i)]
            tracking = f"{root_mean_square(missed[run.last]):.4g}"
        cells = [tracking, f"{root_mean_square((run.z - run.z_hat)[run.last, i]):.4g}"]
        for row in edges:
            cells += [row.value_with_interval, f"{row.true:.6g}"]
        verdict = info.identifiable[i]
        rows.append((name, *cells, _describe_verdict(verdict)))
    return rows


def _describe_verdict(verdict: Mapping[str, Any]) -> str:
    """Return the identifiability of an output's widths as text, of gears that of their gap."""
    crossings = verdict.get("crossings")
    if crossings is not None:
        answer = "yes" if verdict["width"] else "narrowed"
        shown = verdict["width"] or verdict.get("narrowed", False)
        return f"{answer}, {count_noun(crossings, 'strike')} detected" if shown else "NO"
    return "yes" if all(verdict[each] for each in DIRECTIONS) else format_yes_no(verdict)


def _describe_proof(run: Run) -> dict[str, Any]:
    """Return the certificate and the integration error of a run, as text by name."""
    summary: dict[str, Any] = {}
    certified = run.info.certified
    rise = run.largest_rise_of_V
    if certified is False:
        summary["certificate"] = "none found for these gains: undeadzone check gives the reason"
    elif certified:
        words = "holds for an exact model without noise or disturbance"
        if rise is not None:
            words += f". Along this run V rose by at most {rise:.1g} of its peak"
        summary["certificate"] = words
    error = run.info.integration_error
    if error is not None:
        summary["integration"] = f"error {error:.2g} (against half the step)"
    return summary


def _describe_identifiable(info: Info, outputs: Sequence[str]) -> dict[str, Any]:
    """Return the identifiability of a single output's widths, or the reasons against it for several
    outputs.
    """
    if len(outputs) == 1:
        verdict = info.identifiable[0]
        geared = verdict.get("crossings") is not None
        answer = _describe_verdict(verdict) if geared else format_yes_no(verdict)
        return {"identifiable": "; ".join([answer, *verdict["reasons"]])}
    why = []
    for name, verdict in zip(outputs, info.identifiable, strict=True):
        why += [f"{name}: {reason}" for reason in verdict["reasons"]]
    return {"why": why} if why else {}
