"""Design files: a proved one with numbers changed, and its text damaged.

A file that is accepted must hold a proof: that is checked by eigenvalues of our own.
"""

from __future__ import annotations

import copy
import functools
import random
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import tomli_w

from tools.fuzz.case import Case
from tools.fuzz.damage import anything, bent, number
from undeadzone.analysis.certificate.design_file import Design
from undeadzone.analysis.certificate.passivity import certify
from undeadzone.linalg.matrices import Matrices

NAME = "design.toml"
A, B, C = [[0.0, 1.0], [-1.0, -2.0]], [[0.0], [1.0]], [[1.0, 0.0]]


def case(draw: random.Random) -> Case:
    """A changed design."""
    base = _base()
    if draw.random() < 0.4:
        kind, content = "text", bent(draw, tomli_w.dumps(base).encode())
    else:
        kind, tables = "numbers", copy.deepcopy(base)
        for _ in range(draw.choice((1, 1, 2))):
            _change(draw, tables)
        content = tomli_w.dumps(tables).encode("utf-8", "replace")
    return Case(kind, {NAME: content}, call=_loaded)


@functools.cache
def _base() -> dict[str, Any]:
    """The tables of a design of two states."""
    arrays = Matrices(np.array(A), np.array(B), np.array(C))
    proof = certify(arrays, np.array([[1.0], [1.5]]), np.array([10.0]))
    point = {
        "L": [[1.0], [1.5]],
        "gamma": [10.0],
        "rate": 0.5,
        "disturbance": 1.0,
        "mismatch": 1.0,
        "noise": 1.0,
    }
    known = {"right": True, "left": True, "width": True, "centre": True}
    return {
        "title": "base",
        "chosen": "rate",
        "seed": 0,
        "A": A,
        "B": B,
        "C": C,
        "K": [[1.0, 1.0]],
        "P": proof.P.tolist(),
        "W": np.atleast_1d(proof.V.W).tolist(),
        "margin": proof.margin,
        "never": [],
        "states": [True, True],
        "remarks": [],
        "best": point,
        "present": point,
        "identifiable": [known | {"reasons": [], "cures": [], "std": {"right": 0.1}}],
        "front": [point],
    }


def _change(draw: random.Random, tables: dict[str, Any]) -> None:
    """Change one number, or one value at all, somewhere in tables."""
    where: Any = tables
    while True:
        keys = list(where) if isinstance(where, dict) else list(range(len(where)))
        if not keys:
            return
        key = draw.choice(keys)
        if isinstance(where[key], (dict, list)) and where[key] and draw.random() < 0.9:
            where = where[key]
            continue
        break
    act = draw.randrange(6)
    if act == 0:
        del where[key]
    elif act == 1:
        where[key] = anything(draw)
    elif isinstance(where[key], float) and act == 2:
        where[key] *= draw.choice((-1.0, 1 + 1e-9, 1.01, 2.0, 1e6))
    else:
        where[key] = number(draw)


def _loaded(folder: Path) -> None:
    """A design loaded; that it is accepted means that it is proved."""
    design = Design.load(folder / NAME)
    a, p = np.array(design.A), np.array(design.P)
    assert np.linalg.eigvals(a).real.max() < 0 or design.Ts is not None
    assert np.linalg.eigvalsh((p + p.T) / 2).min() > 0
    assert np.isfinite(design.margin)
    msgspec.json.encode(msgspec.to_builtins(design), enc_hook=float)
