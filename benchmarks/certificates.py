"""Attempts to break random certified designs; `python -m benchmarks.certificates --plants 200 --trajectories 100000 --seed 0`."""

from __future__ import annotations

import argparse
import sys
from typing import NamedTuple

import numpy as np

from benchmarks.designs import random_design
from undeadzone.analysis.certificate.passivity import certify
from undeadzone.analysis.convergence.falsify import falsify

ORDERS = range(1, 9)


class Row(NamedTuple):
    """One random design: states, outputs, whether it was certified, the largest rise of V in a switch relative to V, broken."""

    n: int
    p: int
    certified: bool
    rise: float
    broken: bool


def survey(plants: int, trajectories: int, switches: int, seed: int) -> list[Row]:
    """Prove and attack `plants` designs in turn of 1 to 8 states."""
    found = []
    for k in range(plants):
        rng = np.random.default_rng([seed, k])
        n = ORDERS[k % len(ORDERS)]
        p = min(n, 1 + int(rng.integers(3)))
        certificate = certify(*random_design(rng, n, p))
        attack = (
            falsify(certificate.dynamics, certificate.V, trajectories, switches, seed=k)
            if certificate.certified
            else None
        )
        found.append(
            Row(
                n,
                p,
                certificate.certified,
                attack.rise if attack else np.nan,
                attack.broken if attack else False,
            )
        )
        print(f"{k + 1}/{plants}", end="\r", file=sys.stderr, flush=True)
    return found


def table(plants: int = 200, trajectories: int = 100_000, switches: int = 60, seed: int = 0) -> str:
    """What became of them, by order."""
    rows = survey(plants, trajectories, switches, seed)
    lines = [
        f"## Attempts to break certificates\n\n{trajectories} trajectories of {switches} switches on each design, 1-3 outputs, half of them sampled.\n",
        "| states | designs | certified | broken | largest rise of V in a switch, relative |",
        "|---|---|---|---|---|",
    ]
    for n in sorted({row.n for row in rows}):
        own = [row for row in rows if row.n == n]
        rise = max(row.rise for row in own)
        lines.append(
            f"| {n} | {len(own)} | {sum(row.certified for row in own)} | {sum(row.broken for row in own)} | {rise:.1e} |"
        )
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    for name, default in (
        ("plants", 200),
        ("trajectories", 100_000),
        ("switches", 60),
        ("seed", 0),
    ):
        parser.add_argument(f"--{name}", type=int, default=default)
    print(table(**vars(parser.parse_args())))
