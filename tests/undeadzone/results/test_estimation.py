"""What is said of an estimate along a log."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from undeadzone.results.estimation import _describe_branches


@pytest.mark.parametrize(
    ("right", "left", "expected"),
    [
        (5, 1, "5 right, 1 left, 3 silent"),
        (5, 0, "5 right, 0 left, 3 silent: the left edge is never passed"),
        (0, 0, "0 right, 0 left, 3 silent: the right and the left edge is never passed"),
    ],
)
def test_an_edge_without_a_reading_is_never_passed(right: int, left: int, expected: str) -> None:
    info: Any = SimpleNamespace(
        sensor="dead_zone", right=[right], left=[left], silent=[3], limited=[], d_right=[1.0]
    )
    info.d_left = info.d_right
    assert _describe_branches(info, 0) == expected
