"""The sheet of a run: errors, estimates, proof, and what its readings can tell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from undeadzone.analysis.identifiability.linear import DIRECTIONS
from undeadzone.analysis.identifiability.words import yes_no
from undeadzone.results import sheet
from undeadzone.results.info import Info
from undeadzone.results.listening_words import in_words as listening_in_words
from undeadzone.results.sheet import Row
from undeadzone.support.arrays import Floats
from undeadzone.support.shown import Block, Rows
from undeadzone.support.text import label

if TYPE_CHECKING:
    from undeadzone.results.run import Run


def errors(run: Run) -> list[Row]:
    """The errors of a run over its end."""
    last, unit = f"last {run.lasting:g} s", run.info.units.output
    said = [
        ("rms_tracking", "rms z - r", "rms of z − r", unit, ""),
        ("rms_estimation", "rms z - z^", "rms of z − z^", unit, ""),
        ("rms_behind_play", "rms y/m - r", "rms of y / m − r", unit, ""),
        ("rms_tip", "rms tip", "rms distance of the tip from its path", "m", " from its path"),
    ]
    rows = []
    for key, name, title, of, note in said:
        value, behind = getattr(run, key), f"{note} ({last})"
        if value is not None:
            row = Row(name, f"{title}, {last}", value, of, key=key, form=".4g", note=behind)
            rows.append(row)
    return rows


def parameters(run: Run) -> list[Row]:
    """The parameters that the observer estimates."""
    rows = []
    for name, found in run.parameters.items():
        note = f" (true {found['true']:g})"
        std = found["std"]
        rows.append(Row(name, f"{name}, estimated", found["estimate"], std=std, note=note))
    return rows


def widths(run: Run, i: int) -> list[Row]:
    """The widths of output i."""
    unit = run.info.units.output
    return sheet.edges("d", "d", *_last(run.d_hat, run.d_std, i), unit, _pair(run.info.widths, i))


def actuators(run: Run) -> list[list[Row]]:
    """The widths of each actuator; nothing where none are estimated."""
    info = run.info
    if run.b_hat is None or run.b_std is None:
        return []
    rows = []
    for j in range(len(info.actuator) // 2):
        found = _last(run.b_hat, run.b_std, j)
        rows.append(sheet.edges("b", "b", *found, info.units.input, _pair(info.actuator, j)))
    return rows


def gaps(signals: Any, unit: str, true: Sequence[float] | None = None) -> list[list[Row]]:
    """The gaps of the play ahead of each dead zone; nothing where none are estimated.

    Args:
        signals: a result that has them.
        unit: of z.
        true: of each output in turn; None: nobody knows them.
    """
    c, std, both = signals.c_hat, signals.c_std, signals.gap_std
    if c is None or std is None or both is None:
        return []
    rows = []
    for i in range(both.shape[1]):
        truth = None if true is None else _pair(true, i)
        rows.append(sheet.gaps(*_last(c, std, i), both[-1, i], unit, truth))
    return rows


def _last(values: Floats, stds: Floats | None, i: int) -> tuple[Any, Any]:
    """The last right and left values of output i, and their deviations where known."""
    pair = slice(2 * i, 2 * i + 2)
    return values[-1, pair].tolist(), None if stds is None else stds[-1, pair].tolist()


def _pair(values: Sequence[float], i: int) -> Sequence[float]:
    """Right and left of output i."""
    return values[2 * i : 2 * i + 2]


def in_words(run: Run, of_outputs: Mapping[str, Sequence[float | None]]) -> list[Block]:
    """What a run came to: pairs, and of several outputs a table with their rows.

    Args:
        run: what is shown.
        of_outputs: rms of z - r, None where it is not tracked, and of z - z^ of each output by its
            name.
    """
    info, single = run.info, len(of_outputs) == 1
    shown: dict[str, Any] = {
        "scenario": info.title,
        "observer": f"{info.method}, {info.time} time, step {info.step:g} s",
        **sheet.in_text(errors(run)),
    }
    driven = actuators(run)
    if single:
        shown |= sheet.in_text(widths(run, 0))
    if len(driven) == 1:
        shown |= sheet.in_text(driven[0])
    if single:
        for rows in gaps(run, info.units.output, info.gaps):
            shown |= sheet.in_text(rows)
    shown |= sheet.in_text(parameters(run))
    quiet = "holding" if info.sensor == "play" else "silent"
    shown[quiet] = f"{100 * run.silent_fraction:.1f} % of the time"
    if info.listens:
        shown["listens"] = listening_in_words(info.listens)
    shown |= _proof(run) | _identifiable(info, list(of_outputs))
    if run.diverged_at is not None:
        shown["DIVERGED"] = f"at {run.diverged_at:g} s"
    elif run.inexact:
        share = info.integration_share
        assert share is not None
        shown["NOT EXACT"] = (
            f"half the step changes the run by {100 * share:.3g} % of the largest |z|: these are "
            "no results; use a smaller simulation.step"
        )
    return [shown] if single else [shown, _rows(run, of_outputs)]


def _rows(run: Run, of_outputs: Mapping[str, Sequence[float | None]]) -> Rows:
    """A row for each output: its errors, widths, and what its readings tell."""
    info, unit = run.info, run.info.units.output
    heads = [label(name, unit) for name in ("rms z - r", "rms z - z^", "d_right", "d_left")]
    what = "joint" if info.joints and list(info.joints) == list(of_outputs) else "output"
    rows: list[Sequence[str]] = [(what, *heads[:3], "true", heads[3], "true", "identifiable")]
    for i, (name, (tracking, estimation)) in enumerate(of_outputs.items()):
        cells = ["" if tracking is None else f"{tracking:.4g}", f"{estimation:.4g}"]
        for row in widths(run, i):
            cells += [row.found, f"{row.true:.6g}"]
        verdict = info.identifiable[i]
        told = "yes" if all(verdict[each] for each in DIRECTIONS) else yes_no(verdict)
        rows.append((name, *cells, told))
    return rows


def _proof(run: Run) -> dict[str, Any]:
    """What is proved of a run, and how exactly it was integrated."""
    shown: dict[str, Any] = {}
    certified, rise = run.info.certified, run.largest_rise_of_V
    if certified is False:
        shown["certificate"] = "none found for these gains; undeadzone check says why"
    elif certified:
        words = "holds for an exact model without noise or disturbance"
        if rise is not None:
            words += f"; along this run V rose by at most {rise:.1g} of its peak"
        shown["certificate"] = words
    error = run.info.integration_error
    if error is not None:
        shown["integration"] = f"error {error:.2g} (against half the step)"
    return shown


def _identifiable(info: Info, outputs: Sequence[str]) -> dict[str, Any]:
    """What the readings tell of the widths of one output; of several, why not all of them."""
    if len(outputs) == 1:
        verdict = info.identifiable[0]
        return {"identifiable": "; ".join([yes_no(verdict), *verdict["reasons"]])}
    why = []
    for name, verdict in zip(outputs, info.identifiable, strict=True):
        why += [f"{name}: {reason}" for reason in verdict["reasons"]]
    return {"why": why} if why else {}
