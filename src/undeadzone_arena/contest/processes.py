"""Processes that compute for this one, and end when it does."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from typing import Final

SAFE: Final = "PYTHONSAFEPATH"  # set: a new Python does not look into the working folder


@contextmanager
def pool(count: int | None) -> Iterator[ProcessPoolExecutor]:
    """Processes started anew, so that nothing is inherited, and no code of the working folder runs.

    They end with this process, also when it is killed in the middle of their work. What this
    process may import they may too: they take its path of modules before anything else is done.

    Args:
        count: of them; None: one per processor.
    """
    context = multiprocessing.get_context("spawn")
    with _safe_start(), ProcessPoolExecutor(count, context, initializer=_end_with_parent) as made:
        yield made


@contextmanager
def _safe_start() -> Iterator[None]:
    """Python starts safely inside: workers, and the process that tracks what they share."""
    before = os.environ.get(SAFE)
    os.environ[SAFE] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[SAFE]
        else:
            os.environ[SAFE] = before


def _end_with_parent() -> None:
    """End this process as soon as its parent is gone."""
    threading.Thread(target=_wait_for_end, daemon=True).start()


def _wait_for_end() -> None:
    """Wait for the parent's end."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
