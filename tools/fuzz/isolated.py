"""Cases in processes of their own: one that hangs, dies or takes all memory is not the end."""

from __future__ import annotations

import resource
import signal
import time
from collections.abc import Iterator
from itertools import starmap
from typing import Final, NamedTuple

from tools.fuzz.apart import tell_apart
from tools.fuzz.case import Maker, stream
from tools.fuzz.judge import complaint
from tools.fuzz.perform import perform

HANGS: Final = 20  # [s] of the processor that a case may take
SLEEPS: Final = 200  # [s] of the clock that it may take
MEMORY: Final = 2 * 10**9  # [bytes] that a case may take
BATCH: Final = 2000  # cases of a process
ENDS: Final[dict[int, str]] = {
    signal.SIGPROF: f"took more than {HANGS} s",
    signal.SIGALRM: f"took more than {SLEEPS} s of the clock",
}


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
    while time.monotonic() < until:
        told, code = tell_apart(_batch(name, make, seed, first, until))
        yield from starmap(Result, told)
        first += len(told)
        if code:
            yield Result(first, "?", -1, ENDS.get(code, f"died: status or signal {code}"), "", 0.0)
            first += 1


def _batch(name: str, make: Maker, seed: int, first: int, until: float) -> Iterator[Result]:
    """The results of cases from `first` on in this process, until a time of the monotonic clock."""
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
    for index in range(first, first + BATCH):
        if time.monotonic() >= until:
            return
        yield _result(name, make, seed, index)


def _result(name: str, make: Maker, seed: int, index: int) -> Result:
    """The result of a case in this process."""
    began = time.process_time()
    signal.alarm(SLEEPS)
    signal.setitimer(signal.ITIMER_PROF, HANGS)
    case = make(stream(name, seed, index))
    end = perform(case)
    wrong = complaint(case, end)
    words = (end.err + end.native)[-3000:] if wrong else ""
    return Result(index, case.kind, end.code, wrong, words, time.process_time() - began)
