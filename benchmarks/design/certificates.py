"""Attempts to break random certified designs.

`python -m benchmarks certificates --plants 200 --trajectories 100000 --seed 0`
"""

from __future__ import annotations

import sys
from typing import NamedTuple

import numpy as np

from benchmarks.design.random_designs import random_design
from benchmarks.markdown import head, row
from undeadzone.analysis.certificate.passivity import certify
from undeadzone_design.convergence.falsify import falsify

ORDERS = range(1, 9)
COLUMNS = (
    "states",
    "designs",
    "certified",
    "broken",
    "largest rise of V in a switch, relative",
)


class Tried(NamedTuple):
    """One random design and what became of it.

    Attributes:
        n, p: states, outputs
        certified: whether it was certified
        rise: the largest rise of V in a switch, relative to V; nan if it was not attacked
        broken: whether the attack broke the certificate
    """

    n: int
    p: int
    certified: bool
    rise: float
    broken: bool


def survey(plants: int, trajectories: int, switches: int, seed: int) -> list[Tried]:
    """Prove and attack `plants` designs in turn of 1 to 8 states."""
    tried = []
    for k in range(plants):
        tried.append(_try(k, trajectories, switches, seed))
        print(f"{k + 1}/{plants}", end="\r", file=sys.stderr, flush=True)
    return tried


def _try(k: int, trajectories: int, switches: int, seed: int) -> Tried:
    """Prove and attack the k-th design."""
    rng = np.random.default_rng([seed, k])
    n = ORDERS[k % len(ORDERS)]
    p = min(n, 1 + int(rng.integers(3)))
    certificate = certify(*random_design(rng, n, p))
    if not certificate.certified:
        return Tried(n, p, False, np.nan, False)
    attack = falsify(certificate.dynamics, certificate.V, trajectories, switches, seed=k)
    return Tried(n, p, True, attack.rise, attack.broken)


def table(plants: int = 200, trajectories: int = 100_000, switches: int = 60, seed: int = 0) -> str:
    """What became of them, by order."""
    tried = survey(plants, trajectories, switches, seed)
    lines = [
        "## Attempts to break certificates\n",
        f"{trajectories} trajectories of {switches} switches on each design, 1-3 outputs, "
        "half of them sampled.\n",
        *head(*COLUMNS),
    ]
    for n in sorted({one.n for one in tried}):
        own = [one for one in tried if one.n == n]
        certified, broken = sum(one.certified for one in own), sum(one.broken for one in own)
        rise = max(one.rise for one in own)
        lines.append(row(f"{n}", f"{len(own)}", f"{certified}", f"{broken}", f"{rise:.1e}"))
    return "\n".join(lines) + "\n"
