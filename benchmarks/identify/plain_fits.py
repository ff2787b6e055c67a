"""`identify` beside plain fits of SciPy: output errors through each nonlinearity, the least BIC.

The logs are those of `logs.names`, at most 3000 samples. Every method has the first 70 % and
simulates the rest from the input alone. The rival fits a linear plant of order 1 to 3 with each of
none, a zone of the sensor, a zone of the input, a play and a saturation by
`scipy.optimize.least_squares` from two starts, and names what has the least BIC: prediction errors
of an output-error structure. The linear fit is the one without any. PLAIN_LOGS: of each truth (3);
PLAIN_FIRST: the first seed (4000).
"""

from __future__ import annotations

import itertools
import math
import os
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

import undeadzone as uz
from benchmarks.identify.logs.names import NamedLog, make
from benchmarks.identify.logs.strangers import zone
from benchmarks.markdown import head, row
from undeadzone.nonlinearities.play import levels
from undeadzone.util.arrays import Floats

MOST, LEARNT = 3000, 0.7  # samples, and the share that is fitted
ORDERS, ROUNDS, CALLS = (1, 2, 3), 8, 60
STARTS = (0.15, 0.5)  # widths
WORDS = {
    "none": "none",
    "sensor": "dead_zone",
    "input": "input_zone",
    "play": "play",
    "saturation": "saturation",
}
NO_NAME = ("undecided", "unclear", "unreached", "refused")
UNSTABLE = 1e3  # a simulated reading goes no further


def behind_play(z: Floats, p: Floats) -> Floats:
    """Return z behind a play of gaps p, from 0 (N)."""
    return np.asarray(levels(z[:, None], p[:1], p[1:], np.zeros(1))[:, 0])


Shape = Callable[[Floats, Floats], Floats]
AT_SENSOR: dict[str, Shape] = {
    "dead_zone": lambda z, p: zone(z, *p),
    "play": behind_play,
    "saturation": lambda z, p: np.clip(z, -p[1], p[0]),
}


class Fit(NamedTuple):
    """Result of a method on a log.

    Attributes:
        word: the name that it gives.
        width: of what is named; nan: none.
        rms: of its simulation of what it was not shown, in rms of these readings; nan: withheld.
        seconds: CPU.
    """

    word: str
    width: float
    rms: float
    seconds: float


def simulate(word: str, theta: Floats, n: int, u: Floats) -> Floats:
    """Return the readings of a plant of order n with an element, from rest (N)."""
    a, b, p = theta[:n], theta[n : 2 * n], theta[2 * n :]
    v = zone(u, *p) if word == "input_zone" else u
    with np.errstate(all="ignore"):
        z = lfilter(np.append(0.0, b), np.append(1.0, a), v)
    z = np.clip(np.nan_to_num(z, nan=UNSTABLE), -UNSTABLE, UNSTABLE)
    return AT_SENSOR[word](z, p) if word in AT_SENSOR else z


def linear_start(u: Floats, y: Floats, n: int) -> Floats:
    """Return a, b by rounds of Steiglitz and McBride."""
    a = np.zeros(n)
    for _ in range(ROUNDS):
        fu, fy = (lfilter([1.0], np.append(1.0, a), one) for one in (u, y))
        lagged = [np.append(np.zeros(k), one[:-k]) for one in (-fy, fu) for k in range(1, n + 1)]
        found = np.linalg.lstsq(np.column_stack(lagged), fy, rcond=None)[0]
        if np.abs(np.roots(np.append(1.0, found[:n]))).max() >= 1:
            break
        a, component = found[:n], found
    return (
        component if a.any() else np.concatenate([[-0.9], np.zeros(n - 1), [0.1], np.zeros(n - 1)])
    )


def fit_each(u: Floats, y: Floats, known: int) -> dict[str, tuple[float, Floats, int]]:
    """Return BIC, numbers and order of the best fit of each word to the known samples."""
    found: dict[str, tuple[float, Floats, int]] = {}
    for n, word in itertools.product(ORDERS, WORDS.values()):
        begun = linear_start(u[:known], y[:known], n)
        for start in STARTS if word != "none" else STARTS[:1]:
            gain = 1.0 if word in ("none", "saturation") else 1.3
            own = [] if word == "none" else [2.0 * start if word == "saturation" else start] * 2
            x0 = np.concatenate([begun[:n], gain * begun[n:], own])
            low = np.append(np.full(2 * n, -np.inf), np.zeros(len(own)))

            def left(x: Floats, word: str = word, n: int = n) -> Floats:
                return simulate(word, x, n, u[:known]) - y[:known]

            fit = least_squares(left, x0, bounds=(low, np.inf), x_scale="jac", max_nfev=CALLS)
            bic = known * math.log(2 * fit.cost / known) + x0.size * math.log(known)
            if word not in found or bic < found[word][0]:
                found[word] = (bic, fit.x, n)
    return found


def plain(log: NamedLog, known: int) -> tuple[Fit, Fit]:
    """Return the fit of the least BIC, and the linear one."""
    begun = time.process_time()
    found = fit_each(log.u, log.y, known)
    spent, every = time.process_time() - begun, []
    for word in (min(found, key=lambda one: found[one][0]), "none"):
        _, theta, n = found[word]
        width = float(theta[2 * n :].sum()) if word != "none" else math.nan
        every.append(Fit(word, width, _off(log, simulate(word, theta, n, log.u), known), spent))
    return every[0], every[1]


def identified(log: NamedLog, known: int) -> Fit:
    """Return what `identify` makes of the known samples."""
    begun = time.process_time()
    try:
        found = uz.identify(t=log.step, u=log.u[:known], y=log.y[:known])
    except uz.InputError:
        return Fit("refused", math.nan, math.nan, time.process_time() - begun)
    assert isinstance(found, uz.Identified)
    spent, width = time.process_time() - begun, found.width
    value = math.nan if width is None else width.value
    if found.verdict not in WORDS.values():
        return Fit(found.verdict, value, math.nan, spent)
    try:
        y = np.asarray(found.simulate(log.u).y)
    except uz.InputError:  # a saturation has no widths
        return Fit(found.verdict, value, math.nan, spent)
    return Fit(found.verdict, value, _off(log, y, known), spent)


def _off(log: NamedLog, y: Floats, known: int) -> float:
    """Return the rms by which a simulation is off where nothing was fitted, in rms of y."""
    rest = slice(known, None)
    return float(np.sqrt(np.mean((y - log.y)[rest] ** 2)) / log.y[rest].std())


def cells(fits: list[Fit], logs: list[NamedLog], truth: str) -> list[str]:
    """Return names, error of the width and of the simulation of a method."""
    right = [one.word == WORDS[truth] for one in fits]
    wrong = sum(not ok and one.word not in NO_NAME for ok, one in zip(right, fits, strict=True))
    off = [
        abs(one.width / sum(log.widths) - 1)
        for ok, one, log in zip(right, fits, logs, strict=True)
        if ok and sum(log.widths) and math.isfinite(one.width)
    ]
    rms = [one.rms for one in fits if math.isfinite(one.rms)]
    cells_of_errors = (
        f"{np.median(off):.3f}" if off else "-",
        f"{np.median(rms):.4f}" if rms else "-",
    )
    return [
        f"{sum(right)}, {wrong}",
        *cells_of_errors,
        f"{np.mean([one.seconds for one in fits]):.1f}",
    ]


def table() -> str:
    """Return the section of RESULTS.md."""
    count, first = (int(os.environ.get(f"PLAIN_{k}", d)) for k, d in (("LOGS", 3), ("FIRST", 4000)))
    names = ("truth", "method", "named right, wrong", "width off", "simulation off", "CPU s")
    lines, behind, compared = head(*names), 0, 0
    for truth in WORDS:
        logs = [make(seed, truth) for seed in range(first, first + count)]
        logs = [log._replace(u=log.u[:MOST], y=log.y[:MOST]) for log in logs]
        known = [int(LEARNT * log.y.size) for log in logs]
        own = [identified(log, k) for log, k in zip(logs, known, strict=True)]
        both = [plain(log, k) for log, k in zip(logs, known, strict=True)]
        each = {"identify": own, "least BIC": [one[0] for one in both]}
        each["linear output error"] = [one[1] for one in both]
        for method, fits in each.items():
            lines.append(row(truth, method, *cells(fits, logs, truth)))
        for one, (rival, _) in zip(own, both, strict=True):
            if math.isfinite(one.rms):
                compared += 1
                behind += one.rms > 1.02 * rival.rms
    remark = (
        f"{count} logs of each truth. Errors are medians: of a width in its own size where the"
        " name is right, of a simulation in rms of the readings, whatever the name. Of"
        f" {compared} logs that `identify` names and simulates it is behind the least BIC by more"
        f" than 2 % in {behind}."
    )
    return "\n".join(["## Plain fits", "", remark, "", *lines, ""])
