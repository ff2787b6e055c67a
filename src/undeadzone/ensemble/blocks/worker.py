"""A local worker: a process that computes the batches which come through its standard input.

`local_workers` starts it. It sends answers through what was its standard output, and ends when its
input does: a worker does not outlive the process that started it.
"""

from __future__ import annotations

import os
import pickle
import sys
import threading
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any, BinaryIO

from undeadzone.ensemble.blocks import batches
from undeadzone.ensemble.blocks.job import Job
from undeadzone.errors import ClusterError


def main() -> None:
    """Answer every batch with what `batches.compute` returns, or with what it raises."""
    answers = _own_stdout()
    payload = pickle.load(sys.stdin.buffer)
    asked: SimpleQueue[Any] = SimpleQueue()
    threading.Thread(target=_listen, args=(sys.stdin.buffer, asked), daemon=True).start()
    answer = _first(payload)
    while True:
        answers.write(answer(asked.get()))
        answers.flush()


def _own_stdout() -> BinaryIO:
    """What was standard output, for answers alone; what others print goes to standard error."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    return answers


def _listen(requests: BinaryIO, asked: SimpleQueue[Any]) -> None:
    """Pass on the batches that come; end the process, even at work, when there is no more."""
    try:
        while True:
            asked.put(pickle.load(requests))
    except BaseException:  # the process at the other end has gone
        os._exit(0)


def _first(payload: bytes) -> Callable[[list[int]], bytes]:
    """A function of a batch that gives the pickled answer."""
    try:
        job: Job = pickle.loads(payload)()
    except BaseException as error:
        refusal = _pickled(error)
        return lambda blocks: refusal
    return lambda blocks: _answer(job, blocks)


def _answer(job: Job, blocks: list[int]) -> bytes:
    """The pickled answer to a batch."""
    try:
        return pickle.dumps(batches.compute(job, blocks))
    except BaseException as error:
        return _pickled(error)


def _pickled(error: BaseException) -> bytes:
    """An exception as bytes; in other words where it cannot be read back."""
    try:
        content = pickle.dumps(error)
        pickle.loads(content)
    except Exception:
        content = pickle.dumps(ClusterError(f"a local worker: {type(error).__name__}: {error}"))
    return content
