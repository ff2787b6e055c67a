"""End of a command: exit code, one line on stderr, handling of signals and closed streams."""

from __future__ import annotations

import errno
import functools
import io
import os
import re
import signal
import sys
import threading
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import Any, Final

import click

from undeadzone.cli.common import print_line
from undeadzone.errors import (
    DamagedPackage,
    Interrupted,
    Terminated,
    UndeadzoneError,
)
from undeadzone.util import streams

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
END_SIGNALS: Final = [
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP")
    if hasattr(signal, name)  # Windows has no SIGHUP
]
AGAIN: Final = 0.02  # [s] after which a signal comes again that was lost
# Arguments that messages of functions name; their options have the same names.
ARGUMENT: Final = re.compile(
    r'\b(columns|force|out|replay|resume)=(?:True|"?(NAME|NUMBER|(?<=")[^"]*)"?)'
)
LONGEST: Final = 200  # characters of an unexpected exception's message that are shown


def run_to_exit_code(command: Callable[[], Any]) -> int:
    """Run a command and return its exit code. An exception becomes one line on stderr."""
    try:
        if _open_closed_streams():
            return _report_refusal(
                "stdout is closed, and the results would be lost; use > /dev/null"
            )
        streams.let_streams_wait()
        hindrance = _find_import_obstacle()
        if hindrance:
            return _report_refusal(hindrance)
        with _signals_raised(), warnings.catch_warnings():
            if not os.environ.get(DEBUG):  # NumPy's remarks are not for users
                warnings.simplefilter("ignore")
                warnings.simplefilter("default", DamagedPackage)
                warnings.showwarning = _print_warning
            code = command()
        sys.stdout.flush()
        return code if isinstance(code, int) else DONE
    except click.exceptions.Exit as error:
        return error.exit_code
    except click.ClickException as error:
        return _report_refusal(error.format_message(), _command_of_error(error))
    except UndeadzoneError as error:
        return _report_refusal(str(error))
    except (
        KeyboardInterrupt,
        Interrupted,
        click.Abort,
    ) as error:  # click makes the last of the first
        return _report_interruption("interrupted", str(error.__cause__ or error), INTERRUPTED)
    except Terminated as error:
        return _report_interruption("terminated", str(error), TERMINATED)
    except Exception as error:
        return report_failure(error)


def _print_warning(message: Warning | str, *where: Any, **rest: Any) -> None:
    """Print a warning as one line on stderr."""
    print_line(f"undeadzone: {message}", err=True)


def report_failure(error: Exception) -> int:
    """Print a refusal of the system or an internal error, and return the exit code."""
    if _is_out_of_memory(error):
        return _report_refusal("memory ran out. Allow more, or compute less at once")
    if isinstance(error, OSError) and _is_stdout_error(error):
        return _report_stdout_failure(error)
    return _report_internal_error(error)


def _open_closed_streams() -> bool:
    """Open closed standard streams on the null device. Return whether stdout was closed.

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
        if isinstance(stream, io.TextIOWrapper):  # a terminal that cannot show ± is not an error
            stream.reconfigure(errors="backslashreplace")
    return closed


def _find_import_obstacle() -> str:
    """Return the reason that libraries would fail or hang while imported, or "" if none."""
    if not os.environ.get(EPOCH, "0").isdecimal():
        return f"{EPOCH}: expected whole seconds since 1970. Set it so, or unset it"
    if sys.platform == "win32":
        return ""
    import resource

    allowed, _ = resource.getrlimit(resource.RLIMIT_AS)
    if allowed != resource.RLIM_INFINITY and allowed < LEAST_MEMORY:
        return (
            f"memory ran out: {allowed / 1e6:.0f} MB of addresses are allowed, and libraries alone "
            f"take {LEAST_MEMORY / 1e6:.0f}. Raise it (ulimit -v)"
        )
    return ""


@contextmanager
def _signals_raised() -> Iterator[None]:
    """Provide a block in which Ctrl-C, SIGTERM, and SIGHUP of a closed terminal end a command
    alike.

    A signal that arrives while Python can raise no exception, such as in the import of a module or
    as an object is deleted, is raised again a moment later.
    """
    untouched = (signal.SIG_DFL, signal.default_int_handler)
    before: dict[int, Any] = {}
    hook = sys.unraisablehook
    sys.unraisablehook = functools.partial(_raise_again, hook)
    try:
        with suppress(ValueError):  # signals are for the main thread, whose affair they are then
            for number in END_SIGNALS:
                if signal.getsignal(number) in untouched:
                    before[number] = signal.signal(number, _raise_terminated)
        yield
    finally:
        sys.unraisablehook = hook
        for number, handler in before.items():
            signal.signal(number, handler)


def _raise_terminated(number: int, frame: FrameType | None) -> None:
    """Raise what ends the command."""
    raise Interrupted if number == signal.SIGINT else Terminated


def _raise_again(hook: Callable[[Any], Any], lost: Any) -> None:
    """Let a signal come again whose exception was lost. Pass another exception on to a hook."""
    if not issubclass(lost.exc_type, Terminated):
        hook(lost)
        return
    number = signal.SIGINT if issubclass(lost.exc_type, Interrupted) else signal.SIGTERM
    again = threading.Timer(AGAIN, signal.raise_signal, (number,))
    again.daemon = True
    again.start()


@contextmanager
def defer_signals() -> Iterator[None]:
    """Provide a block that a signal ends only at its end. A second signal acts at once."""
    came: list[int] = []
    handlers: dict[int, Any] = {}

    def note(number: int, frame: FrameType | None) -> None:
        """Note a signal."""
        if came:
            handlers[number](number, frame)
        came.append(number)

    with suppress(ValueError):
        for number in END_SIGNALS:
            handler = signal.getsignal(number)
            if callable(handler):
                handlers[number] = handler
                signal.signal(number, note)
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    if came:
        signal.raise_signal(came[0])


def end_at_once_on_signals() -> None:
    """Let a signal end the process with its line and code while Python shuts down."""
    for number in END_SIGNALS:
        signal.signal(number, _end_at_once)


def ignore_signals() -> None:
    """Ignore signals in the last moment of Python, when no message can be printed."""
    for number in END_SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def _end_at_once(number: int, frame: FrameType | None) -> None:
    """Print that the command was stopped, and end the process."""
    how, code = (
        ("interrupted", INTERRUPTED) if number == signal.SIGINT else ("terminated", TERMINATED)
    )
    _report_interruption(how, "", code)
    os._exit(code)


def _report_refusal(message: str, where: str = "undeadzone") -> int:
    """Print the error in the input, and return the exit code."""
    print_line(f"{where}: {name_options(message)}", err=True)
    return BAD_INPUT


def name_options(message: str) -> str:
    """Return a message with the options of the command line for the arguments of functions."""
    return ARGUMENT.sub(lambda found: f"--{found[1]} {found[2] or ''}".rstrip(), message)


def _report_interruption(how: str, saved: str, code: int) -> int:
    """Print that a command was stopped, with the saved results, and return the exit code."""
    print_line(": ".join(filter(None, (f"undeadzone: {how}", name_options(saved)))), err=True)
    return code


def _report_internal_error(error: Exception) -> int:
    """Print an internal error of the program, and return the exit code."""
    if os.environ.get(DEBUG):
        traceback.print_exc()
    frames = traceback.extract_tb(error.__traceback__)
    place = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "?"
    words = f"{type(error).__name__}: {error}"[:LONGEST]
    print_line(
        f"undeadzone: internal error at {place}: {words}; please report it, with the traceback "
        f"that {DEBUG}=1 shows",
        err=True,
    )
    return INTERNAL


def _is_out_of_memory(error: Exception) -> bool:
    """Return whether memory ran out: for numbers, for a process, for the code of a library."""
    if isinstance(error, MemoryError):
        return True
    if isinstance(error, OSError) and error.errno == errno.ENOMEM:
        return True
    return isinstance(error, ImportError | RuntimeError) and bool(NO_MEMORY.search(str(error)))


def _is_stdout_error(error: OSError) -> bool:
    """Return whether an error comes from stdout: raised during printing, or again at every
    flush.
    """
    frames = traceback.extract_tb(error.__traceback__)
    files = [Path(frame.filename) for frame in frames if frame.filename != streams.__file__]
    if files and files[-1].parent.name in PRINTERS:
        return True
    try:
        sys.stdout.flush()
    except OSError:
        return True
    return False


def _report_stdout_failure(error: OSError) -> int:
    """Print that stdout failed, and return the exit code. A closed pipe counts as success."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    if isinstance(error, BrokenPipeError):
        return DONE
    return _report_refusal(f"stdout: cannot write: {error.strerror}")


def _command_of_error(error: click.ClickException) -> str:
    """Return the name of the command that raised an error."""
    if isinstance(error, click.UsageError) and error.ctx:
        return error.ctx.command_path
    return "undeadzone"
