"""What tests of compiled kernels share."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from undeadzone.compile import cache


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv("UNDEADZONE_CACHE", str(tmp_path / "kernels"))
    cache.load_or_compile.cache_clear()
    yield tmp_path / "kernels"
    cache.load_or_compile.cache_clear()
