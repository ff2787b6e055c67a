"""One live sample in Python, as a multiple of a NumPy matrix-vector product of the same order."""

from __future__ import annotations

import statistics
import time

import numpy as np

import undeadzone as uz


def table(calls: int = 20_000, rounds: int = 7) -> str:
    """Medians over interleaved rounds."""
    plant = uz.Plant(A=[[0, 1], [-1, -2]], B=[[0], [1]], C=[[1, 0]])
    online = uz.Online(
        uz.Certified(L=[1.0, 1.5], gamma=10.0), plant, uz.Sensor(right=1, left=1), 1e-3
    )
    A, x = np.eye(2), np.ones(2)
    steps = {
        "numpy A @ x, order 2": lambda: A @ x,
        "Online.update, order 2": lambda: online.update(0.3, 1.0),
    }
    times: dict[str, list[float]] = {name: [] for name in steps}
    for _ in range(rounds):
        for name, step in steps.items():
            began = time.perf_counter()
            for _ in range(calls):
                step()
            times[name].append((time.perf_counter() - began) / calls)
    medians = {name: statistics.median(values) for name, values in times.items()}
    unit = next(iter(medians.values()))
    rows = [
        f"| {name} | {1e6 * value:.2f} | {value / unit:.1f} |" for name, value in medians.items()
    ]
    return "\n".join(["## Live step\n", "| call | us | times numpy |", "|---|---|---|", *rows, ""])
