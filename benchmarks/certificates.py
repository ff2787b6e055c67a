"""Try to break random certified designs, and the plants that no design can serve.

python benchmarks/certificates.py --plants 200 --trajectories 100000 --seed 0
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

from undeadzone.design.falsify import falsify
from undeadzone.design.passivity import certify

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from designs import random_design


def survey(plants: int, trajectories: int, switches: int, seed: int) -> dict[str, float]:
    """How many designs were certified and how many broken, and the largest rise of V in one switch, relative to V."""
    certified = broken = 0
    rise = -np.inf
    for k in range(plants):
        rng = np.random.default_rng([seed, k])
        n = 1 + k % 8
        p = min(n, 1 + int(rng.integers(3)))
        began = time.perf_counter()
        certificate = certify(*random_design(rng, n, p))
        middle = time.perf_counter()
        certified += certificate.certified
        if not certificate.certified:
            print(f"{k:4d}  n = {n}, p = {p}: not certified: {certificate.reason}")
            continue
        attack = falsify(certificate.dynamics, certificate.V, trajectories, switches, seed=k)
        broken += attack.broken
        rise = max(rise, attack.rise)
        if attack.broken or k % 20 == 0:
            seconds = f"{middle - began:.2f} s to prove, {time.perf_counter() - middle:.1f} s to attack"
            print(f"{k:4d}  n = {n}, p = {p}, margin {certificate.margin:.3g}: largest rise {attack.rise:.2g} ({seconds})", flush=True)
    return {"certified": certified, "broken": broken, "largest rise": rise}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plants", type=int, default=200)
    parser.add_argument("--trajectories", type=int, default=100_000)
    parser.add_argument("--switches", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    print(survey(**vars(parser.parse_args())))
