"""Limitation of an expression to a range."""

from __future__ import annotations

from typing import Any

import casadi as ca


def clip(x: Any, low: Any, high: Any) -> Any:
    """Return x limited to the range from low to high, with low if the range is empty."""
    return ca.fmax(ca.fmin(x, high), low)
