"""`check` on pairs of truths with the same readings: neither may be claimed against the other.

Both zones are shifted in z, d_r up and d_l down, by what a constant at the input moves z. The
constant is of the size of what the declared disturbance does, so that either truth may be the one.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import lsim
from tests import scenes

from benchmarks.markdown import head, row
from undeadzone.linalg.matrices import Matrices
from undeadzone.nonlinearities.sensor import deadzone
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.reader import convert
from undeadzone.signals.exosystem import build_exosystem
from undeadzone.util.arrays import Floats
from undeadzone.util.text import HALF_95
from undeadzone_design.synthesis.assessment import assess_identifiability, plan_branches

KINDS = ("sine", "sines", "step", "trapezoid", "ramp", "pulse", "square wave", "slow random")
DURATION, STEP = 20.0, 0.01
SHARE = (0.3, 1.6)  # of the disturbance's rms: the constant by which both truths differ
AMPLITUDE = 8.0  # of z, with widths about 1


class Pair(NamedTuple):
    """Two truths with the same readings.

    Attributes:
        first, second: tables of scenarios; None: the class of the first holds no such second one.
        apart: by how much each width differs [z].
        unlike: largest difference of the readings [z].
    """

    first: dict[str, Any]
    second: dict[str, Any] | None
    apart: float
    unlike: float


def pair(kind: str, seed: int, folder: Path) -> Pair:
    """A random pair.

    Args:
        kind: of the disturbance, one of `KINDS`.
        seed: of everything.
        folder: where samples of disturbances are written.
    """
    rng = np.random.default_rng([KINDS.index(kind), seed])
    plant = scenes.random_plant(rng, int(rng.integers(1, 4))).linear
    gain = float((-plant.C @ np.linalg.solve(plant.A, plant.B))[0, 0])
    t = np.arange(0.0, DURATION + STEP / 2, STEP)
    size = float(rng.uniform(0.1, 0.4)) / abs(gain)
    signal, w = _signal(kind, size, t, rng)
    constant = float(rng.uniform(*SHARE)) * float(np.sqrt((w**2).mean()))
    apart = gain * constant
    widths = rng.uniform(0.8, 1.5, 2) + abs(apart)
    first = _scenario(plant, signal(0.0, folder, f"{seed}a"), widths)
    moved = signal(constant, folder, f"{seed}b")
    other = widths + np.array([apart, -apart])
    second = _scenario(plant, moved, other) if moved else None
    return Pair(first, second, abs(apart), _unlike(plant, w, constant, apart, widths, t))


def _signal(kind: str, size: float, t: Floats, rng: np.random.Generator) -> tuple[Any, Floats]:
    """How a disturbance is declared with a constant besides, and its values without one."""
    end = float(t[-1])
    if kind in ("ramp", "pulse", "square wave"):
        shapes = {
            "ramp": size * (2 * t / end - 1),
            "pulse": size * ((t > 5.0) & (t < 5.0 + 0.009 * end)),
            "square wave": size * np.sign(np.sin(2 * np.pi * t / rng.uniform(1.0, 5.0))),
        }
        w = shapes[kind]

        def sampled(constant: float, folder: Path, name: str) -> dict[str, Any]:
            path = folder / f"{kind.replace(' ', '_')}{name}.csv"
            np.savetxt(path, np.c_[t, w + constant], delimiter=",", header="t,w", comments="")
            return {"kind": "csv", "path": path.name, "smooth": False}

        return sampled, w
    frequency, phase = float(rng.uniform(1.0, 40.0) / end), float(rng.uniform(0.0, 6.0))
    plain: dict[str, Any] = {
        "sine": {"amplitude": size, "frequency": frequency, "phase": phase},
        "sines": {
            "components": [
                {"amplitude": size, "frequency": frequency},
                {"amplitude": size / 2, "frequency": 3 * frequency, "phase": phase},
            ]
        },
        "step": {"amplitude": size, "before": -size, "time": end / 3},
        "trapezoid": {"amplitude": size, "rise": 0.3, "hold": float(rng.uniform(0.5, 3.0))},
        "slow random": {"rms": size, "correlation_time": 10 * end},
    }
    fields = {"kind": kind.removeprefix("slow "), **plain[kind]}
    if kind == "slow random":
        return lambda constant, *_: fields if not constant else None, np.full(t.size, size)

    def declared(constant: float, folder: Path, name: str) -> dict[str, Any] | None:
        if kind == "trapezoid":
            return fields if not constant else None
        if kind == "step":
            more = {key: fields[key] + constant for key in ("amplitude", "before")}
            return {**fields, **more}
        return {**fields, "offset": constant}

    return declared, _values(fields, t)


def _values(fields: dict[str, Any], t: Floats) -> Floats:
    """A disturbance at times t [s]."""
    scenario = convert(scenes.table(disturbance=fields))
    assert scenario.disturbance is not None
    return build_exosystem("disturbance", scenario.disturbance, 1).output_at(t)[:, 0]


def _scenario(plant: Matrices, disturbance: dict[str, Any], widths: Floats) -> dict[str, Any]:
    """The tables of a truth."""
    return scenes.table(
        plant={"A": plant.A.tolist(), "B": plant.B.tolist(), "C": plant.C.tolist()},
        sensor={"right": float(widths[0]), "left": float(widths[1]), "noise": 0.01},
        reference={"kind": "sine", "amplitude": AMPLITUDE, "frequency": 0.3},
        disturbance=disturbance,
        observer={"method": "kalman", "right": [0.0, 4.0]},
        simulation={"duration": DURATION, "time": "sampled", "step": STEP},
    )


def _unlike(
    plant: Matrices, w: Floats, constant: float, apart: float, widths: Floats, t: Floats
) -> float:
    """How much the readings of both truths differ at most, along a common input."""
    shifts = np.array([apart, -apart])
    start = -np.linalg.solve(plant.A, plant.B)[:, 0] * constant
    u = AMPLITUDE * np.sin(2 * np.pi * 0.3 * t)
    system = (plant.A, plant.B, plant.C, np.zeros((1, 1)))
    readings = []
    for shift, x0, (right, left) in (
        (0.0, np.zeros_like(start), widths),
        (constant, start, widths + shifts),
    ):
        z = np.ravel(lsim(system, u + w + shift, t, X0=x0)[1])
        readings.append(np.asarray(deadzone(z, right, left)))
    return float(np.abs(readings[1] - readings[0]).max())


def is_certified_apart(tables: dict[str, Any], apart: float, folder: Path) -> bool:
    """Whether `check` says yes to a width with an interval that leaves out the other truth."""
    problem = resolve_scenario(convert(tables, folder))
    (known,) = assess_identifiability(problem, plan_branches(problem, None), None)
    return any(
        getattr(known, name) and HALF_95 * known.std[name] < share * apart
        for name, share in (("right", 1.0), ("left", 1.0), ("centre", 1.0))
    )


def table(pairs: int = 25) -> str:
    """How many of pairs of each kind are claimed against the other truth."""
    lines = [
        "## Two truths with the same readings\n",
        *head("disturbance", "pairs", "claimed", "readings differ by [z]"),
    ]
    with TemporaryDirectory() as name:
        folder = Path(name)
        for kind in KINDS:
            found = [pair(kind, seed, folder) for seed in range(pairs)]
            wrong = 0
            for one in found:
                truths = [truth for truth in (one.first, one.second) if truth is not None]
                wrong += any(is_certified_apart(truth, one.apart, folder) for truth in truths)
            lines.append(
                row(kind, str(pairs), str(wrong), f"{max(one.unlike for one in found):.1g}")
            )
    return "\n".join([*lines, ""])
