"""Jobs that several files compute in other places, and what one process makes of them."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.jobs import local_cluster, sines

from undeadzone_studies.ensemble import run_blocks


@pytest.fixture
def whole(tmp_path: Path) -> bytes:
    """The store of a job that one process computed."""
    store = run_blocks.compute_job(functools.partial(sines, 605), tmp_path / "whole.partial")
    store.close()
    return store.path.read_bytes()


@pytest.fixture(scope="module")
def dask() -> Iterator[Any]:
    """A cluster of two workers."""
    with local_cluster(2) as found:
        yield found


@pytest.fixture(params=["processes", "cluster"])
def elsewhere(request: pytest.FixtureRequest) -> dict[str, Any]:
    """Options of a job that compute its blocks in other processes."""
    if request.param == "processes":
        return {"workers": 2}
    return {"cluster": request.getfixturevalue("dask").scheduler_address}
