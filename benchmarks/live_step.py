"""One live sample in Python, as a multiple of a NumPy matrix-vector product of the same order."""

from __future__ import annotations

import numpy as np

import undeadzone as uz
from benchmarks.markdown import head, row
from benchmarks.timing import medians


def table(calls: int = 20_000, rounds: int = 7) -> str:
    """Medians over interleaved rounds of so many calls."""
    plant = uz.Plant(A=[[0, 1], [-1, -2]], B=[[0], [1]], C=[[1, 0]])
    observer, sensor = uz.Certified(L=[1.0, 1.5], gamma=10.0), uz.Sensor(right=1, left=1)
    online = uz.Online(observer, plant, sensor, 1e-3)
    A, x = np.eye(2), np.ones(2)

    def multiply() -> None:
        for _ in range(calls):
            A @ x

    def update() -> None:
        for _ in range(calls):
            online.update(0.3, 1.0)

    seconds = medians({"numpy A @ x, order 2": multiply, "Online.update, order 2": update}, rounds)
    unit = next(iter(seconds.values()))
    rows = []
    for name, value in seconds.items():
        rows.append(row(name, f"{1e6 * value / calls:.2f}", f"{value / unit:.1f}"))
    return "\n".join(["## Live step\n", *head("call", "us", "times numpy"), *rows, ""])
