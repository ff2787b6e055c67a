"""Further cases of a test, which `make long` runs; the cases beside them are their sentinels."""

from __future__ import annotations

from typing import Any

import pytest
from _pytest.mark.structures import ParameterSet


def further(*cases: Any) -> list[ParameterSet]:
    """Return cases of `pytest.mark.parametrize` that only `make long` runs.

    Args:
        cases: values of a single argument, or tuples of values.
    """
    return [
        pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.long)
        for case in cases
    ]
