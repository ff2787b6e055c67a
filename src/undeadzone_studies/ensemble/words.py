"""Report of an ensemble: shares, quantiles, sensitivities, the worst runs."""

from __future__ import annotations

from itertools import starmap
from typing import Any, Final, NamedTuple

from undeadzone.results.run import ERRORS, LAST
from undeadzone.results.sheet import format_bounds, format_number
from undeadzone.util.shown import Block
from undeadzone.util.text import count_noun, label_with_unit
from undeadzone_studies.ensemble.saved import Info, unit_of_column


class Metric(NamedTuple):
    """Label of a metric of a run.

    Attributes:
        label: in words.
        late: whether it is taken over the end of a run.
    """

    label: str
    late: bool = False


METRICS: Final = {
    **{key: Metric(words, late=True) for key, words in ERRORS.items()},
    "rms_tip": Metric("rms distance of the tip from its path", late=True),
    "d_error": Metric("largest |d^ - d|, at the end"),
    "settling_time": Metric("settling time"),
    "peak_tracking": Metric("peak |z - r|"),
    "rms_input": Metric("rms u"),
    "silent_fraction": Metric("share of silent samples"),
}
LISTED: Final = 5  # worst runs, and entries that decide


def describe_metric(quantity: str, duration: float | None = None) -> str:
    """Return a metric or the error of a width in words.

    Args:
        quantity: its name.
        duration: of a run [s] (if given, the words name the time over which the metric is taken).
    """
    if quantity in METRICS:
        metric = METRICS[quantity]
        late = duration is not None and metric.late
        return metric.label + (f", last {min(LAST, duration or LAST):g} s" if late else "")
    edge, _, output = quantity.partition("_error[")
    if not output:
        return quantity
    return f"{edge[:3]}^ − {edge[:3]}, output {output[:-1]}"


def describe_ensemble(info: Info, summary: dict[str, Any], diverged: int) -> list[Block]:
    """Return the result of an ensemble as blocks of text and tables.

    Args:
        info: of the ensemble.
        summary: of the ensemble.
        diverged: how many runs did.
    """
    sampling = info.sampling.replace("_", " ")
    blocks: list[Block] = [
        f"{info.title}: {count_noun(info.runs, 'run')} of {info.duration:g} s, "
        f"{sampling} sampling, seed {info.seed}",
        _describe_shares(info, summary, diverged),
    ]
    if summary["metrics"]:
        blocks.append(_quantile_table(info, summary["metrics"]))
    if summary["sensitivities"]:
        entries = list(summary["sensitivities"].items())[:LISTED]
        heads = ("what decides rms z - r", "rank correlation", "share of the variance")
        blocks.append([heads, *starmap(_sensitivity_row, entries)])
    return blocks


def _describe_shares(info: Info, summary: dict[str, Any], lost: int) -> dict[str, str]:
    """Return the shares of runs that settle and that diverge."""
    diverged = summary["diverged"]
    lasts = f"for the last {LAST:g} s" if info.duration > LAST else "at the end"
    which = ""
    if diverged["runs"]:
        runs = _list_runs(diverged["runs"], lost)
        which = f": {runs}. Left out below"
    return {
        "settled": (
            f"{_format_share(summary['settled'])}: |z - r| within "
            f"{100 * info.tolerance:g} % of the "
            f"largest |r| {lasts}"
        ),
        "diverged": f"{_format_share(diverged)}{which}",
    }


def _quantile_table(info: Info, metrics: dict[str, Any]) -> list[tuple[str, ...]]:
    """Return the table of quantiles of each metric."""
    rows: list[tuple[str, ...]] = [
        ("95 % intervals in []", "median", "95 % of runs below", "99 % of runs below")
    ]
    for key in METRICS:
        if key in metrics:
            quantiles = [
                _format_metric_interval(metrics[key][column]) for column in ("median", "p95", "p99")
            ]
            words = describe_metric(key, info.duration)
            rows.append((label_with_unit(words, unit_of_column(key, info.units)), *quantiles))
    return rows


def _list_runs(runs: list[int], total: int) -> str:
    """Return the first runs of a list as text."""
    names = ", ".join(map(str, runs[:LISTED]))
    return f"run{'s' * (total > 1)} {names}{', ...' * (total > LISTED)}"


def _format_share(share: dict[str, Any]) -> str:
    """Return a share and its interval in percent, without the trivial bound at 0 % and at 100
    %.
    """
    value, low, high = (f"{100 * share[key]:.3g} %" for key in ("value", "low", "high"))
    if share["value"] <= 0:
        low = ""
    return format_bounds(value, low, high if share["value"] < 1 else "")


def _format_metric_interval(metric: dict[str, Any]) -> str:
    """Return a metric and its interval. A settling time without a bound never ends."""
    low, high = (format_number(metric[end], none="") for end in ("low", "high"))
    if metric["value"] is not None:
        return format_bounds(format_number(metric["value"]), low, high)
    return f"never settles (or after {low})" if low else "never settles"


def _sensitivity_row(name: str, entry: dict[str, Any]) -> tuple[str, str, str]:
    """Return a row of the table of sensitivities: entry, rank correlation, share of the
    variance.
    """
    share = entry["total_order"] or entry["first_order"]
    chance = entry["floor"] is not None and share["value"] < entry["floor"]
    rank = _format_hundredths(entry["spearman"])
    return name, rank, "may be chance" if chance else _format_hundredths(share)


def _format_hundredths(value: dict[str, float]) -> str:
    """Return a value and its interval, with two decimals."""
    return format_bounds(*(f"{value[key]:z.2f}" for key in ("value", "low", "high")))
