"""Fit the weights of `selection/loop.toml` to loops of known cause, judged valve by valve.

LOOPS_RECORDS: a folder of records whose names begin with S_ where the valve sticks and with N_
where it does not, or hold _S_ or _N_, with the tag behind; LOOPS_FITTED: how many generated loops
besides (300), of seeds from 20000. Records of one valve stay together, and count as one. A valve
is judged by the weights of all others, by the odds of all its records together.
"""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.special import log_softmax, logsumexp

from benchmarks.identify.answers import complete
from benchmarks.identify.logs.valves import make
from benchmarks.identify.valves import WORDS, area_under_curve, log_of_loop
from benchmarks.markdown import head, row
from benchmarks.results import commit
from undeadzone_identify.logs.log import Log, read_log
from undeadzone_identify.selection import loop as selection
from undeadzone_identify.selection.loop import (
    CAUSES,
    FEATURES,
    NAMED,
    combine_odds,
    find_loop_cause,
)

FIRST, OF_RECORDS = 20000, 3.0  # seed; weight of a valve of the records
RIDGES = (0.5, 1.0, 2.0, 4.0)  # of the weights: that by which valves foretell others best, without
# a false name of a valve that sticks
STORED = Path("build/loop_features.jsonl")
WRITTEN = Path(selection.__file__).with_suffix(".toml")


def measured(log: Log) -> dict[str, Any]:
    """The features of a loop of one record."""
    found = find_loop_cause([log])
    return {"features": np.mean([one.features for one in found.swings], axis=0).tolist()}


def known(index: int) -> dict[str, Any]:
    """A generated loop: what is measured, its cause and its valve."""
    loop = make(FIRST + index)
    name = "sticks" if loop.stick else (*WORDS[loop.cause],)[0]
    return {"cause": CAUSES.index(name), "valve": str(index), **measured(log_of_loop(loop))}


def records() -> list[dict[str, Any]]:
    """The same of all records; a valve that does not stick has any other cause, -1."""
    folder = os.environ.get("LOOPS_RECORDS")
    rows = []
    for path in sorted(Path(folder).glob("*.csv")) if folder else []:
        tag = re.sub(r"^(\w+?_)?[SN]_", "", path.stem).split("_")[0]
        cause = 0 if re.search(r"(^|_)S_", path.stem) else -1
        rows.append({"cause": cause, "valve": tag, **measured(read_log(path))})
    return rows


def likelihood(logits: np.ndarray, causes: np.ndarray, share: np.ndarray) -> float:
    """Return the log likelihood of causes; that of -1 is any but the first."""
    odds = log_softmax(logits, axis=1)
    own = odds[np.arange(len(odds)), causes]
    return float(share @ np.where(causes < 0, logsumexp(odds[:, 1:], axis=1), own))


def fit_weights(
    x: np.ndarray, causes: np.ndarray, share: np.ndarray, ridge: float
) -> dict[str, Any]:
    """Return the logistic weights of most likelihood with a ridge on those of scaled features."""
    middle, scale, width = x.mean(axis=0), x.std(axis=0), x.shape[1] + 1
    scaled = np.column_stack([np.ones(len(x)), (x - middle) / scale])

    def loss(flat: np.ndarray) -> float:
        table = flat.reshape(len(CAUSES), width)
        beside = ridge * float(np.sum(table[:, 1:] ** 2))
        return beside - likelihood(scaled @ table.T, causes, share)

    table = minimize(loss, np.zeros(len(CAUSES) * width), method="L-BFGS-B").x.reshape(-1, width)
    weights = table[:, 1:] / scale
    odds = np.exp(log_softmax(scaled @ table.T, axis=1))
    return {
        "prior": (share @ odds / share.sum()).tolist(),
        "bias": (table[:, 0] - weights @ middle).tolist(),
        "weights": weights.tolist(),
    }


def logits_of(table: dict[str, Any], x: np.ndarray) -> np.ndarray:
    """Return the log odds of the causes of each row, by itself, but for a constant."""
    return x @ np.array(table["weights"]).T + table["bias"]


def table() -> str:
    """The section of RESULTS.md; the weights are written beside."""
    count, of = int(os.environ.get("LOOPS_FITTED", 300)), commit()
    made = complete(STORED, of, ["index"], [(k,) for k in range(count)], known)
    made = [one for one in made if one["index"] < count]
    rows = [*records(), *made]
    x = np.array([one["features"] for one in rows])
    causes, valve = (np.array([one[key] for one in rows]) for key in ("cause", "valve"))
    is_record = np.arange(len(rows)) < len(rows) - count
    _, at, times = np.unique(valve, return_inverse=True, return_counts=True)
    share = np.where(is_record, OF_RECORDS, 1.0) / times[at]
    tags = [{*valve[is_record & ((causes == 0) == so)]} for so in (True, False)]
    valves = list(map(len, tags)) if is_record.any() else [1, 1]
    groups = np.where(is_record, at, at % 10 + at.max() + 1)

    def judge(ridge: float) -> tuple[int, float, float, np.ndarray, np.ndarray]:
        """Less the false names of valves, mean log likelihood of a valve by the weights of
        others, ridge, log odds, names.
        """
        logits, names = np.empty((len(rows), len(CAUSES))), np.empty(len(rows), int)
        for group in np.unique(groups):
            out = groups == group
            others = fit_weights(x[~out], causes[~out], share[~out], ridge)
            logits[out] = logits_of(others, x[out])
            for one in np.unique(at[out]):
                word, likely = next(
                    iter(combine_odds(x[at == one], others | {"valves": valves}).items())
                )
                names[at == one] = CAUSES.index(word) if likely >= NAMED else -1
        value = likelihood(logits, causes, share) / float(share.sum())
        return -len({*at[(causes != 0) & (names == 0)]}), value, ridge, logits, names

    judged = list(map(judge, RIDGES))
    _, _, ridge, logits, names = max(judged, key=lambda one: one[:2])
    log_odds = log_softmax(logits, axis=1)[:, 0]
    fitted = fit_weights(x, causes, share, ridge)
    texts = {"causes": CAUSES, "features": list(FEATURES), "valves": valves}
    texts |= {key: np.round(value, 4).tolist() for key, value in fitted.items()}
    lines = [f"# Written by `python -m benchmarks loop_weights` from {len(rows)} loops: {of}."]
    lines += [f"{key} = {json.dumps(value)}" for key, value in texts.items()]
    WRITTEN.write_text("\n".join(lines) + "\n", encoding="utf-8")
    shown = head(
        "loops", "records", "valves", "AUC, all", "stick", "so named", "others so named",
        "other false names",
    )  # fmt: skip
    for name, part in (("records", is_record), ("generated", ~is_record)):
        if part.any():
            area = area_under_curve(log_odds[part], causes[part] == 0)
            first = np.unique(at[part], return_index=True)[1]
            cause, said = causes[part][first], names[part][first]
            false = (said > 0) & (said != cause) & (cause >= 0)
            counts = (cause == 0, (cause == 0) & (said == 0), (cause != 0) & (said == 0), false)
            cells = [f"{area:.3f}", *(str(one.sum()) for one in counts)]
            shown.append(row(name, str(part.sum()), str(first.size), *cells))
    about = (
        "Each loop is judged by weights of other valves: the records valve by valve, generated"
        f" loops in ten parts. A valve of the records counts {OF_RECORDS:g} times. The ridge is"
        f" {ridge:g}, by mean log likelihoods of a valve by the weights of others (and false names"
        " that it sticks): "
        f"{', '.join(f'{one[1]:.3f} ({-one[0]}) at {one[2]:g}' for one in judged)}."
        " AUC is that of single records; a valve is named by the odds of all its records, from"
        f" {NAMED:g} on."
    )
    return "\n".join(["## Weights of loops", "", about, "", *shown, ""])
