"""Unfinished ensembles: damaged anywhere, then resumed.

No block may count as done whose rows are not those that were computed.
"""

from __future__ import annotations

import functools
import random
import tempfile
from pathlib import Path

import numpy as np
from tests.jobs import Sines, sines

from tools.fuzz.case import Case
from tools.fuzz.damage import bent
from undeadzone_studies.ensemble import journal

NAME = "runs.npz.partial"
RUNS = 35


def case(draw: random.Random) -> Case:
    """A damaged store."""
    data = _whole()
    if draw.random() < 0.5:
        kind, content = "bytes", bent(draw, data)
    else:
        kind, content = "lost pages", _torn(draw, data)
    return Case(kind, {NAME: content}, call=_resumed)


@functools.cache
def _job() -> Sines:
    """A small job."""
    return sines(RUNS)


@functools.cache
def _whole() -> bytes:
    """The bytes of a complete store."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / NAME
        store = journal.open_store(path, _job().layout)
        for block in store.missing_blocks:
            store.write_block(block, _job().block(block))
        store.close()
        return path.read_bytes()


def _torn(draw: random.Random, data: bytes) -> bytes:
    """A store of which sectors were never written."""
    changed = bytearray(data)
    for _ in range(draw.choice((1, 1, 2, 5))):
        place = 512 * draw.randrange(len(data) // 512 + 1)
        length = len(changed[place : place + 512])
        other = draw.choice((bytes(length), bytes(data[:length])))
        changed[place : place + length] = other
    return bytes(changed)


def _resumed(folder: Path) -> None:
    """A store opened again: what counts as done is right."""
    job = _job()
    store = journal.open_store(folder / NAME, job.layout, resume=True)
    try:
        for block in store.missing_blocks:
            store.write_block(block, job.block(block))
        rows = np.stack(list(store.map_columns().values()), axis=1)
        expected = np.vstack([job.block(block) for block in range(job.layout.number_of_blocks)])
        assert np.array_equal(rows, expected, equal_nan=True)
    finally:
        store.close()
