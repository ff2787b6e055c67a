"""Worker processes that end with their parent."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import active_children
from typing import Any, Final

from undeadzone.errors import ClusterError

SAFE: Final = "PYTHONSAFEPATH"  # set: a new Python does not look into the working folder


@contextmanager
def process_pool(count: int | None) -> Iterator[ProcessPoolExecutor]:
    """Start a pool of processes that inherit nothing and run no code of the working folder.

    They end with this process, also when it is killed in the middle of their work. What this
    process may import they may too: they take its path of modules before anything else is done.

    Args:
        count: of them (None: one per processor).
    """
    context = multiprocessing.get_context("spawn")
    with _safe_start(), ProcessPoolExecutor(count, context, initializer=_start_worker) as made:
        yield made


@contextmanager
def _safe_start() -> Iterator[None]:
    """Start Python safely inside this context, the resource tracker included."""
    before = os.environ.get(SAFE)
    os.environ[SAFE] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[SAFE]
        else:
            os.environ[SAFE] = before


def iterate_results(
    count: int | None, function: Callable[..., Any], tasks: Mapping[int, tuple[Any, ...]]
) -> Iterator[tuple[int, Any]]:
    """Yield number and result of each task in order of completion.

    Whoever stops in between, by Ctrl-C or SIGTERM too, waits for no task.

    Args:
        count: of processes (None: one per processor).
        function: of a module, that computes.
        tasks: its arguments, by number.

    Raises:
        ClusterError: a process died.
    """
    others = active_children()
    with process_pool(count) as made:
        try:
            with _defer_interrupt():
                waiting = {made.submit(function, *task): k for k, task in tasks.items()}
            for future in as_completed(waiting):
                yield waiting[future], future.result()
        except BrokenProcessPool:
            raise ClusterError(
                f"arena: one of {count} processes died (out of memory?), try --processes"
            ) from None
        except BaseException:
            made.shutdown(wait=False, cancel_futures=True)
            for child in active_children():
                if child not in others:
                    child.kill()
            raise


@contextmanager
def _defer_interrupt() -> Iterator[None]:
    """Wait with Ctrl-C, inside this context, until the new processes run.

    It would print the traceback of each that is still importing.
    """
    if sys.platform == "win32":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # children inherit it
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _start_worker() -> None:
    """Set this process to end with its parent, or end at once if Ctrl-C came meanwhile."""
    if sys.platform != "win32":
        if signal.SIGINT in signal.sigpending():
            os._exit(1)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    threading.Thread(target=_exit_with_parent, daemon=True).start()


def _exit_with_parent() -> None:
    """Wait for the end of the parent, then exit."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
