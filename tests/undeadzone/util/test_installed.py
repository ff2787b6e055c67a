"""SciPy in one thread while an observer is built, and as before afterwards."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from typing import Any

import pytest
import scipy.linalg
from threadpoolctl import ThreadpoolController

import undeadzone as uz
from undeadzone.simulation import online
from undeadzone.util import installed


@pytest.fixture
def openblas() -> Iterator[Any]:
    """The library of SciPy, set to two threads."""
    library = ctypes.CDLL(scipy.linalg._flapack.__file__)
    if not hasattr(library, "scipy_openblas_set_num_threads"):
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
    none = ThreadpoolController().select(internal_api="none")
    monkeypatch.setattr(installed, "_find_blas", lambda: none)
    with installed.use_one_blas_thread():
        pass


def test_threads_of_python_use_it_at_the_same_time(openblas: Any) -> None:
    """The first to come is the first to go: the other still has one thread, and none is lost."""
    first, second = installed.use_one_blas_thread(), installed.use_one_blas_thread()
    first.__enter__()
    second.__enter__()
    first.__exit__(None, None, None)
    assert openblas.scipy_openblas_get_num_threads() == 1
    second.__exit__(None, None, None)
    assert openblas.scipy_openblas_get_num_threads() == 2
