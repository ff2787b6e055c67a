"""Other programs for the same work, a file each.

prepare(work, **options) -> a function that does it and returns its `Result`.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

from benchmarks.engine.work.paper_loop import Result, Work


def prepare(name: str, work: Work, **options: Any) -> Callable[[], Result] | None:
    """A rival made ready, None where it is not installed."""
    try:
        return importlib.import_module(f"benchmarks.engine.rivals.{name}").prepare(work, **options)
    except ImportError:
        return None
