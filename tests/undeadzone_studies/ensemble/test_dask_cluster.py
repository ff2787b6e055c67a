"""An ensemble on a Dask cluster: the same bits whatever workers do, one clear line if they fail.

Workers on this computer, without Dask, are tested in test_local_workers.py.
"""

from __future__ import annotations

import functools
import http.server
import sys
import threading
import time
from pathlib import Path

import pytest
from distributed import LocalCluster
from hypothesis import given
from hypothesis import strategies as st
from tests.jobs import local_cluster, sines

from undeadzone.errors import ClusterError, InputError
from undeadzone_studies.ensemble import dask_cluster, job, run_blocks

pytestmark = pytest.mark.usefixtures("closed_stores")


def test_no_more_is_computed_than_is_consumed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, dask: LocalCluster
) -> None:
    monkeypatch.setattr(job, "LONGEST", 0.0)
    make = functools.partial(sines, 1000, 0.0, tmp_path)
    with dask_cluster.open_dask_pool(make, dask.scheduler_address) as pool:
        blocks = job.yield_block_rows(pool, range(100))
        next(blocks)
        time.sleep(0.5)
        assert len(list(tmp_path.iterdir())) <= 4 * job.AHEAD
        assert len(list(blocks)) == 99


@given(st.floats(1e-6, 100), st.integers(1, 10**9), st.integers(1, 10**6), st.integers(1, 1000))
def test_batches_are_neither_too_short_nor_too_large_and_end_together(
    seconds: float, size: int, left: int, threads: int
) -> None:
    blocks = job.batch_size(seconds, size, left, threads)
    longest, shortest = job.LONGEST * (1 + 1e-9), job.SHORTEST * (1 + 1e-9)
    if blocks > 1:
        assert blocks * seconds <= longest
        assert blocks * size <= job.LARGEST
        assert blocks * seconds <= shortest or blocks * threads * job.AHEAD <= left
    more = blocks + 1
    long_enough = more * seconds * (1 + 1e-9) > job.SHORTEST
    assert long_enough or more * size > job.LARGEST


def test_workers_with_other_versions_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, dask: LocalCluster
) -> None:
    here = dask_cluster.package_versions() | {"llvmlite": "0.1", "casadi": "3.0"}
    monkeypatch.setattr(dask_cluster, "package_versions", lambda: here)
    words = (
        r"a worker of the cluster has other versions: "
        r"casadi [\d.]+ there, 3\.0 here, llvmlite [\d.]+ there, 0\.1 here"
    )
    make, path = functools.partial(sines, 605), tmp_path / "runs.partial"
    with pytest.raises(ClusterError, match=words):
        run_blocks.compute_job(make, path, cluster=dask.scheduler_address)
    assert list(tmp_path.iterdir()) == []


def test_a_module_that_workers_cannot_import(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, dask: LocalCluster
) -> None:
    (tmp_path / "only_here.py").write_text(
        "from tests.jobs import say, sines\n\ndef make():\n    return sines(605)\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    from only_here import make

    words = "only_here cannot be imported there. Install it on the scheduler and on every worker"
    with pytest.raises(ClusterError, match=words):
        run_blocks.compute_job(make, tmp_path / "runs.partial", cluster=dask.scheduler_address)


def test_a_cluster_without_workers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(job, "PATIENCE", 0.3)
    make, path = functools.partial(sines, 605), tmp_path / "runs.partial"
    words = r"no worker is there. Start some \(dask worker tcp://"
    with local_cluster(0) as empty, pytest.raises(ClusterError, match=words):
        run_blocks.compute_job(make, path, cluster=empty.scheduler_address)
    assert list(tmp_path.iterdir()) == []


def test_a_scheduler_that_goes_away_leaves_the_stored_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dask_cluster, "REACH", 1.0)
    make, path = functools.partial(sines, 605, 0.05), tmp_path / "runs.partial"
    words = r"of 605 runs are kept in .*runs\.partial; continue with resume=True"
    with local_cluster(1) as gone, pytest.raises(ClusterError, match=words):
        run_blocks.compute_job(
            make, path, cluster=gone.scheduler_address, progress=lambda done: gone.close()
        )
    assert path.exists()


@pytest.mark.parametrize(
    "address", ["127.0.0.1:9", "tcp://nowhere.invalid:8786", "foo://127.0.0.1:1", "nonsense", ""]
)
def test_an_address_without_a_scheduler(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, address: str
) -> None:
    monkeypatch.setattr(dask_cluster, "REACH", 0.5)
    with pytest.raises(ClusterError, match=f"^{address}: no Dask scheduler answers there: "):
        run_blocks.compute_job(
            functools.partial(sines, 605), tmp_path / "runs.partial", cluster=address
        )
    assert list(tmp_path.iterdir()) == []


def test_a_server_that_is_no_scheduler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dask_cluster, "REACH", 0.5)
    with http.server.HTTPServer(("127.0.0.1", 0), http.server.BaseHTTPRequestHandler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        make, path = functools.partial(sines, 605), tmp_path / "runs.partial"
        with pytest.raises(ClusterError, match="no Dask scheduler answers there"):
            run_blocks.compute_job(make, path, cluster=f"127.0.0.1:{server.server_port}")
        server.shutdown()


def test_without_distributed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    words = r"the package distributed is missing: pip install 'undeadzone\[dask\]'"
    with pytest.raises(InputError, match=words):
        run_blocks.compute_job(
            functools.partial(sines, 605), tmp_path / "runs.partial", cluster="tcp://127.0.0.1:9"
        )
