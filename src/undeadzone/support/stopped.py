"""What is kept of a computation that something stops, and who may write it."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from undeadzone.errors import FileError, Terminated, UndeadzoneError


@contextmanager
def keeping(leave: Callable[[], str]) -> Iterator[None]:
    """Say what is kept, if something stops what is done inside.

    Args:
        leave: closes the file and returns the sentence that says what it holds; empty: nothing.
    """
    try:
        yield
    except (KeyboardInterrupt, Terminated) as stop:
        raise type(stop)(leave()) from None
    except UndeadzoneError as error:
        sentences = (str(error), leave())
        raise type(error)("; ".join(filter(None, sentences))) from None
    except BaseException as error:
        kept = leave()
        # Ctrl-C within a lock of the thread pool ends as a RuntimeError.
        before = error.__context__
        if isinstance(before, KeyboardInterrupt | Terminated):
            raise type(before)(kept) from None
        raise


def lock(path: Path, file: IO[bytes]) -> None:
    """Keep other processes out until the file is closed, where the system has locks.

    Raises:
        FileError: another process has it.
    """
    if sys.platform == "win32":
        return
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # Another process may have finished and removed it between opening and locking.
        used = not os.fstat(file.fileno()).st_nlink
    except BlockingIOError:
        used = True
    except OSError:  # some network file systems have no locks
        return
    if used:
        raise FileError(
            f"{path}: another process is writing it; wait for it, or choose another name"
        )
