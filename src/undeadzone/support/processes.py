"""Processes that compute for this one, and end when it does."""

from __future__ import annotations

import multiprocessing
import os
import threading
from concurrent.futures import ProcessPoolExecutor


def pool(count: int | None) -> ProcessPoolExecutor:
    """Processes started anew, so that nothing is inherited.

    They end with this process, also when it is killed in the middle of their work.

    Args:
        count: of them; None: one per processor.
    """
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(count, context, initializer=_end_with_parent)


def _end_with_parent() -> None:
    """End this process as soon as its parent is gone."""
    threading.Thread(target=_wait_for_end, daemon=True).start()


def _wait_for_end() -> None:
    """Wait for the parent's end."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
