"""Cases in a process of their own: one that hangs, dies or takes all memory is not the end."""

from __future__ import annotations

import json
import os
import resource
import select
import signal
import sys
import time
import traceback
from collections.abc import Iterator
from contextlib import suppress
from typing import BinaryIO, Final, NamedTuple

from tools.fuzz.case import Maker, stream
from tools.fuzz.judge import complaint
from tools.fuzz.perform import perform

HANGS: Final = 20.0  # [s] of the processor that a case may take
SLEEPS: Final = 200.0  # [s] of the clock that it may take
MEMORY: Final = 2 * 10**9  # [bytes] that a case may take
BATCH: Final = 2000  # cases of a process


class Result(NamedTuple):
    """What became of a case.

    Attributes:
        index: of the case.
        kind: of the input.
        code: exit code.
        complaint: what is wrong; empty if nothing is.
        words: that it left on stderr.
        seconds: that it took.
    """

    index: int
    kind: str
    code: int
    complaint: str
    words: str
    seconds: float


def results(name: str, make: Maker, seed: int, first: int, until: float) -> Iterator[Result]:
    """The results of cases from `first` on, until a time of the monotonic clock."""
    index = first
    while time.monotonic() < until:
        reader, pid = _forked(name, make, seed, index)
        with reader:
            for result in _told(reader, pid, index):
                index = result.index + 1
                yield result
                if time.monotonic() >= until:
                    break
        _end(pid)


def _forked(name: str, make: Maker, seed: int, first: int) -> tuple[BinaryIO, int]:
    """A process that runs cases, and the pipe through which it tells."""
    read, write = os.pipe()
    sys.stdout.flush()
    pid = os.fork()
    if pid:
        os.close(write)
        return open(read, "rb"), pid
    code = 1
    try:
        os.close(read)
        resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
        for index in range(first, first + BATCH):
            line = json.dumps(_result(name, make, seed, index)) + "\n"
            os.write(write, line.encode())
        code = 0
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(code)


def _result(name: str, make: Maker, seed: int, index: int) -> Result:
    """The result of a case in this process."""
    began = time.process_time()
    signal.setitimer(signal.ITIMER_PROF, HANGS)
    case = make(stream(name, seed, index))
    end = perform(case)
    wrong = complaint(case, end)
    words = (end.err + end.native)[-3000:] if wrong else ""
    return Result(index, case.kind, end.code, wrong, words, time.process_time() - began)


def _told(reader: BinaryIO, pid: int, index: int) -> Iterator[Result]:
    """The results that a process tells; that it hangs or dies is one too."""
    descriptor, rest = reader.fileno(), b""
    while True:
        ready, _, _ = select.select([descriptor], [], [], SLEEPS)
        if not ready:
            os.kill(pid, signal.SIGKILL)
            yield Result(index, "?", -1, f"took more than {SLEEPS:g} s of the clock", "", SLEEPS)
            return
        data = os.read(descriptor, 1 << 16)
        if not data:
            break
        *lines, rest = (rest + data).split(b"\n")
        for line in lines:
            result = Result(*json.loads(line))
            index = result.index + 1
            yield result
    status = os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)
    code = 0 if status is None else status.si_status
    if code == signal.SIGPROF:
        yield Result(index, "?", -1, f"took more than {HANGS:g} s", "", HANGS)
    elif code:
        yield Result(index, "?", -1, f"died: status or signal {code}", "", 0.0)


def _end(pid: int) -> None:
    """End a process."""
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
