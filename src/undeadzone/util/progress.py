"""Progress bars of a computation, on a terminal or in a notebook.

A notebook shows displays by number, and each update takes the place of the one before: nothing is
printed twice, and nothing is left once the computation is done.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from html import escape
from typing import TYPE_CHECKING, Any, Final, Protocol

if TYPE_CHECKING:
    from rich.progress import Progress

Advance = Callable[[int], None]  # called with the number of steps just done
PATIENCE: Final = 2.0  # [s] before a bar appears
SETTING_UP: Final = "setting up"  # text of a bar before the first step
PAUSE: Final = 0.2  # [s] at least between two updates of a notebook
OF_KERNEL: Final = "JPY_PARENT_PID"  # variable that a kernel's own commands inherit


def ignore_progress(done: int) -> None:
    """Ignore the steps: without a bar."""


@contextmanager
def notebook_progress(
    progress: Advance | None, what: str, total: int | None, unit: str | None = None
) -> Iterator[Advance]:
    """Provide the function that counts the steps just done: a bar in a notebook, unless given.

    Args:
        progress: the caller's function (None: a bar in a notebook, nothing elsewhere).
        what: words in front of the bar.
        total: steps in all (None: unknown).
        unit: unit of the count (with it the bar shows how many per second).
    """
    if progress is not None:
        yield progress
    elif _is_notebook_kernel():
        with _show_bar(_NotebookBar(), what, total, unit) as advance:
            yield advance
    else:
        yield ignore_progress


@contextmanager
def terminal_progress(
    what: str, total: int | None, unit: str = "", of: Any = None
) -> Iterator[Advance]:
    """Provide the function that counts steps for a command: a bar on stderr if it is a
    terminal.

    The arguments are those of `notebook_progress`, and `of`: the observer that is set up first.
    """
    if not sys.stderr.isatty() or OF_KERNEL in os.environ:
        yield ignore_progress
        return
    first = SETTING_UP if of is None else f"{SETTING_UP} {of.__struct_config__.tag}"
    with _show_bar(_TerminalBar(), what, total, unit, first) as advance:
        yield advance


def _is_notebook_kernel() -> bool:
    """Return whether this process is the kernel of a notebook."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return type(shell).__name__ == "ZMQInteractiveShell"


class _BarDisplay(Protocol):
    """Display of a bar."""

    def draw(self, what: str, done: int, total: int | None, rate: str) -> None:
        """Draw the bar, or update it."""

    def clear(self) -> None:
        """Remove the bar."""


@contextmanager
def _show_bar(
    place: _BarDisplay, what: str, total: int | None, unit: str | None, first: str = SETTING_UP
) -> Iterator[Advance]:
    """Provide a bar that appears once PATIENCE has passed.

    Steps may be counted from several threads.

    Until the first step it shows the part that is set up.
    """
    began = time.monotonic()
    lock = threading.Lock()
    seen = 0
    settled = False  # drawn by a step, or over

    def begin() -> None:
        """Draw the bar after PATIENCE, unless a step did."""
        with lock:
            if not settled:
                place.draw(what if seen else first, seen, total, "")

    def advance(done: int) -> None:
        """Count steps just done, and draw the bar once PATIENCE has passed."""
        nonlocal seen, settled
        with lock:
            seen += done
            elapsed = time.monotonic() - began
            if elapsed > PATIENCE:
                rate = f"{seen / elapsed:,.0f} {unit}/s" if unit else ""
                settled = True
                place.draw(what, seen, total, rate)

    timer = threading.Timer(PATIENCE, begin)
    timer.daemon = True
    timer.start()
    try:
        yield advance
    finally:
        timer.cancel()
        with lock:
            settled = True
            place.clear()


class _TerminalBar:
    """Bar of rich on stderr."""

    def __init__(self) -> None:
        self._bar: Progress | None = None

    def draw(self, what: str, done: int, total: int | None, rate: str) -> None:
        """Draw the bar, or update it."""
        if self._bar is None:
            self._bar = _build_bar()
            self._bar.start()
            self._bar.add_task(what, total=total, rate="")
        (task,) = self._bar.task_ids
        self._bar.update(task, description=what, completed=done, rate=rate)

    def clear(self) -> None:
        """Remove the bar."""
        if self._bar is not None:
            self._bar.stop()


def _build_bar() -> Progress:
    """Return a bar of rich on stderr, not drawn yet."""
    from rich import progress
    from rich.console import Console

    columns = (
        progress.TextColumn("{task.description}"),
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TextColumn("{task.fields[rate]}"),
        progress.TimeRemainingColumn(),
    )
    return progress.Progress(*columns, console=Console(stderr=True), transient=True)


class _NotebookBar:
    """Bar of HTML in a notebook, with the same as text."""

    def __init__(self) -> None:
        self._handle: Any = None
        self._last = 0.0

    def draw(self, what: str, done: int, total: int | None, rate: str) -> None:
        """Draw the bar, or update it if the last time is at least PAUSE ago.

        Other threads than the main one do not know their cell.
        """
        now = time.monotonic()
        if now - self._last < PAUSE or threading.current_thread() is not threading.main_thread():
            return
        self._last = now
        share = "" if total is None else f' value="{min(done, total)}" max="{total}"'
        count = f"{done:,}" if total is None else f"{min(done, total):,} of {total:,}"
        words = " ".join(filter(None, (what, count, rate)))
        html = f"{escape(what)} <progress{share}></progress> {escape(f'{count} {rate}'.strip())}"
        self._display_bar({"text/plain": words, "text/html": html})

    def clear(self) -> None:
        """Remove the bar."""
        if self._handle is not None:
            self._display_bar({"text/plain": "", "text/html": ""})

    def _display_bar(self, mime_bundle: dict[str, str]) -> None:
        """Display the bar, in place of the earlier display."""
        from IPython import display

        show: Any = display.display

        if self._handle is None:
            self._handle = show(mime_bundle, raw=True, display_id=True)
        else:
            self._handle.update(mime_bundle, raw=True)
