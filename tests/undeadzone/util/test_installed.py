"""SciPy in one thread while an observer is built, and as before afterwards."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

import undeadzone as uz
from undeadzone.simulation import online
from undeadzone.util import installed


@pytest.fixture
def openblas() -> Iterator[Any]:
    """The library of SciPy, set to two threads."""
    library = installed._load_openblas()
    if library is None:
        pytest.skip("this SciPy has another library of linear algebra")
    before = library.scipy_openblas_get_num_threads()
    library.scipy_openblas_set_num_threads(2)
    yield library
    library.scipy_openblas_set_num_threads(before)


def test_threads_are_as_before_after_an_error_too(openblas: Any) -> None:
    seen = []

    @installed.use_one_blas_thread()
    def fail() -> None:
        """Note the threads within another use and after it."""
        with installed.use_one_blas_thread():
            seen.append(openblas.scipy_openblas_get_num_threads())
        seen.append(openblas.scipy_openblas_get_num_threads())
        raise ValueError("inside")

    with pytest.raises(ValueError, match="inside"):
        fail()
    assert [*seen, openblas.scipy_openblas_get_num_threads()] == [1, 1, 2]


def test_an_observer_is_built_in_one_thread(openblas: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    seen, watching = [], online.watching

    def watched(*arguments: Any) -> Any:
        """Build, and note the threads."""
        seen.append(openblas.scipy_openblas_get_num_threads())
        return watching(*arguments)

    monkeypatch.setattr(online, "watching", watched)
    plant = uz.Plant(A=[[0.0, 1.0], [-1.0, -2.0]], B=[[0.0], [1.0]], C=[[1.0, 0.0]])
    sensor = uz.Sensor(right=1.0, left=0.6)
    uz.Online(uz.Certified(L=[1.0, 1.5], gamma=10.0), plant, sensor, step=0.01)
    assert [*seen, openblas.scipy_openblas_get_num_threads()] == [1, 2]


def test_another_library_stays_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(installed, "_load_openblas", lambda: None)
    with installed.use_one_blas_thread():
        pass
