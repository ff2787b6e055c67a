"""How a command ends: its exit code, one line on stderr, and what signals and closed streams do."""

from __future__ import annotations

import errno
import io
import os
import re
import signal
import sys
import traceback
import warnings
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import Any, Final

import click

from undeadzone.cli.common import say
from undeadzone.errors import EarlierMeaning, Terminated, UndeadzoneError
from undeadzone.util.streams import let_streams_wait

DONE: Final = 0
BAD_INPUT: Final = 2
INTERNAL: Final = 70  # EX_SOFTWARE of sysexits.h
INTERRUPTED: Final = 130  # 128 + SIGINT
TERMINATED: Final = 143  # 128 + SIGTERM
DEBUG: Final = "UNDEADZONE_DEBUG"  # set: an unexpected exception shows its traceback
EPOCH: Final = "SOURCE_DATE_EPOCH"  # libraries read it when they are imported, and fail
NO_MEMORY: Final = re.compile(
    "cannot allocate|failed to map segment|bad_alloc|can't start new thread", re.IGNORECASE
)
LEAST_MEMORY: Final = 400_000_000  # [bytes] of addresses
PRINTERS: Final = ("click", "rich")  # the packages that print
LONGEST: Final = 200  # characters of an unexpected exception's message that are shown


def run_to_exit_code(command: Callable[[], Any]) -> int:
    """Run a command; its exit code. Whatever it raises becomes one line on stderr."""
    try:
        if _open_streams():
            return _report_refusal(
                "stdout is closed, and the results would be lost; use > /dev/null"
            )
        let_streams_wait()
        hindrance = _hindrance()
        if hindrance:
            return _report_refusal(hindrance)
        _catch_terminate()
        with warnings.catch_warnings():
            if not os.environ.get(DEBUG):  # NumPy's remarks are no message to a user
                warnings.simplefilter("ignore")
                warnings.simplefilter("default", EarlierMeaning)
                warnings.showwarning = _warned
            code = command()
        sys.stdout.flush()
        return code if isinstance(code, int) else DONE
    except click.exceptions.Exit as error:
        return error.exit_code
    except click.ClickException as error:
        return _report_refusal(error.format_message(), _where(error))
    except UndeadzoneError as error:
        return _report_refusal(str(error))
    except (KeyboardInterrupt, click.Abort) as error:  # click makes the latter of the former
        return _report_interruption("interrupted", str(error.__cause__ or error), INTERRUPTED)
    except Terminated as error:
        return _report_interruption("terminated", str(error), TERMINATED)
    except Exception as error:
        return report_failure(error)


def _warned(message: Warning | str, *where: Any, **rest: Any) -> None:
    """Print a warning as one line on stderr."""
    say(f"undeadzone: {message}", err=True)


def report_failure(error: Exception) -> int:
    """What the system denied, or a mistake of the program's own."""
    if _memory_ran_out(error):
        return _report_refusal("memory ran out; allow more, or ask for less at once")
    if isinstance(error, OSError) and _stdout_fails(error):
        return _stdout_failed(error)
    return _report_internal_error(error)


def _open_streams() -> bool:
    """Give closed standard streams a place that swallows everything; whether stdout was closed.

    Otherwise the next file opened takes the number of such a stream, and messages end up in it.
    """
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the least number that is free: this one
            os.set_inheritable(number, True)
    closed = sys.stdout is None
    if sys.stderr is None:
        sys.stderr = os.fdopen(2, "w", encoding="utf-8", closefd=False)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal that cannot show ± is no error
            stream.reconfigure(errors="backslashreplace")
    return closed


def _hindrance() -> str:
    """Why libraries would fail, or never come back, while they are imported; empty: nothing."""
    if not os.environ.get(EPOCH, "0").isdecimal():
        return f"{EPOCH}: expected whole seconds since 1970; set it so, or unset it"
    if sys.platform == "win32":
        return ""
    import resource

    allowed, _ = resource.getrlimit(resource.RLIMIT_AS)
    if allowed != resource.RLIM_INFINITY and allowed < LEAST_MEMORY:
        return (
            f"memory ran out: {allowed / 1e6:.0f} MB of addresses are allowed, and libraries alone "
            f"take {LEAST_MEMORY / 1e6:.0f}; raise it (ulimit -v)"
        )
    return ""


def _catch_terminate() -> None:
    """Let SIGTERM and SIGHUP end a command as Ctrl-C does, where they are not ignored."""
    with suppress(ValueError):  # signals are for the main thread, whose affair they are then
        for name in ("SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)  # Windows has no SIGHUP
            if number is not None and signal.getsignal(number) is signal.SIG_DFL:
                signal.signal(number, _terminate)


def _terminate(number: int, frame: FrameType | None) -> None:
    """End the command."""
    raise Terminated


def _report_refusal(message: str, where: str = "undeadzone") -> int:
    """What is wrong with the input."""
    say(f"{where}: {message}", err=True)
    return BAD_INPUT


def _report_interruption(how: str, kept: str, code: int) -> int:
    """That a command was stopped, and what is kept."""
    say(": ".join(filter(None, (f"undeadzone: {how}", kept))), err=True)
    return code


def _report_internal_error(error: Exception) -> int:
    """Return a mistake of the program's own."""
    if os.environ.get(DEBUG):
        traceback.print_exc()
    frames = traceback.extract_tb(error.__traceback__)
    place = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "?"
    words = f"{type(error).__name__}: {error}"[:LONGEST]
    say(
        f"undeadzone: internal error at {place}: {words}; please report it, with the traceback "
        f"that {DEBUG}=1 shows",
        err=True,
    )
    return INTERNAL


def _memory_ran_out(error: Exception) -> bool:
    """Return whether the system gave no memory: for numbers, for a process, for the code of a
    library.
    """
    if isinstance(error, MemoryError):
        return True
    if isinstance(error, OSError) and error.errno == errno.ENOMEM:
        return True
    return isinstance(error, ImportError | RuntimeError) and bool(NO_MEMORY.search(str(error)))


def _stdout_fails(error: OSError) -> bool:
    """Return whether an error is of stdout: raised where things are printed, or at every flush
    again.
    """
    frames = traceback.extract_tb(error.__traceback__)
    if frames and Path(frames[-1].filename).parent.name in PRINTERS:
        return True
    try:
        sys.stdout.flush()
    except OSError:
        return True
    return False


def _stdout_failed(error: OSError) -> int:
    """That the results could not be printed; a reader who has seen enough is no failure."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    if isinstance(error, BrokenPipeError):
        return DONE
    return _report_refusal(f"stdout: cannot write: {error.strerror}")


def _where(error: click.ClickException) -> str:
    """Return the command that an error is of."""
    if isinstance(error, click.UsageError) and error.ctx:
        return error.ctx.command_path
    return "undeadzone"
