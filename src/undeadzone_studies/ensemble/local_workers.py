"""Blocks computed by processes of this computer, connected by pipes.

No port is opened, so nobody else can give them work. A batch of a worker that dies is computed
again by another one. A worker runs `answer_requests`: it computes the batches that come through its
standard input, sends answers through its former standard output, and ends when its input does, so
that it does not outlive the process that started it.
"""

from __future__ import annotations

import functools
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager, nullcontext, suppress
from queue import SimpleQueue
from typing import Any, BinaryIO, Final, NamedTuple

from undeadzone.errors import ClusterError
from undeadzone_studies.ensemble.job import Pool, Work, compute_blocks

STOPPED: Final = "local workers: stopped"
DEATHS: Final = 4  # workers that may die at the same blocks before these are given up
# Command of a worker. -P: it does not import from the folder that it is started in,
# but from where this process imports.
BEGIN: Final = (
    "import pickle, sys; sys.path[:] = pickle.load(sys.stdin.buffer); "
    "from undeadzone_studies.ensemble.local_workers import answer_requests; answer_requests()"
)


class _Crew(NamedTuple):
    """Local worker processes.

    Attributes:
        payload: the pickled function that prepares the job.
        idle: those without work (None once all are stopped).
        every: all that were started and have not died.
        lock: held while one is started.
        closed: set once no more may be started.
    """

    payload: bytes
    idle: SimpleQueue[subprocess.Popen[bytes] | None]
    every: list[subprocess.Popen[bytes]]
    lock: threading.Lock
    closed: threading.Event


@contextmanager
def open_local_pool(prepare: Callable[[], Work], workers: int) -> Iterator[Pool]:
    """Provide local workers, all of which are stopped at the end.

    Args:
        prepare: gives the job (picklable, such as a `functools.partial` of a function of an
            importable module)
        workers: number of processes

    Raises:
        ClusterError: where workers die at the same blocks again and again
    """
    crew = _Crew(pickle.dumps(prepare), SimpleQueue(), [], threading.Lock(), threading.Event())
    waiting = ThreadPoolExecutor(workers)  # a thread for each worker that is at work
    try:
        for _ in range(workers):
            _add_worker(crew)
        yield Pool(
            threads=lambda: workers,
            submit=lambda batch: waiting.submit(_await_result, crew, workers, batch),
            failures=nullcontext,
            require_work=lambda: None,  # a death ends the batch's future
        )
    finally:
        _stop_workers(crew, workers)
        waiting.shutdown(cancel_futures=True)
        for worker in crew.every:
            _kill_worker(worker)


class Calls(NamedTuple):
    """Calls of a function: a block of work each.

    Attributes:
        function: of an importable module.
        arguments: of each call, by number.
    """

    function: Callable[..., Any]
    arguments: Mapping[int, tuple[Any, ...]]

    def block(self, index: int, threads: int | None = None) -> Any:
        """Return the result of a call (threads: not used)."""
        return self.function(*self.arguments[index])


def iterate_results(
    workers: int, function: Callable[..., Any], arguments: Mapping[int, tuple[Any, ...]]
) -> Iterator[tuple[int, Any]]:
    """Yield number and result of each call, in order of completion.

    Whoever stops in between, by Ctrl-C or SIGTERM too, waits for no call.

    Args:
        workers: number of processes.
        function: of an importable module, that computes.
        arguments: of each call, by number.

    Raises:
        ClusterError: workers died at the same call again and again.
    """
    with open_local_pool(functools.partial(Calls, function, arguments), workers) as pool:
        waiting = {pool.submit([number]): number for number in arguments}
        for future in as_completed(waiting):
            _, (result,) = future.result()
            yield waiting[future], result


def _await_result(crew: _Crew, workers: int, blocks: Sequence[int]) -> tuple[float, list[Any]]:
    """Return the result of `job.compute_blocks` on a worker.

    Raises the worker's exception, or ClusterError.
    """
    for _ in range(DEATHS):
        worker = crew.idle.get()
        if worker is None:
            raise ClusterError(STOPPED)
        try:
            answer = _request_batch(worker, blocks)
        except (OSError, EOFError, pickle.UnpicklingError):
            _discard_worker(crew, worker)
            _add_worker(crew)
            continue
        crew.idle.put(worker)
        if isinstance(answer, BaseException):
            raise answer
        return answer
    raise ClusterError(
        f"{workers} local workers: {DEATHS} workers died one after the other at the same blocks. "
        "Out of memory?"
    )


def _request_batch(worker: subprocess.Popen[bytes], blocks: Sequence[int]) -> Any:
    """Return a worker's answer to a batch.

    Raises OSError, EOFError or UnpicklingError if the worker died.
    """
    assert worker.stdout is not None
    _send_parts(worker, list(blocks))
    return pickle.load(worker.stdout)


def _add_worker(crew: _Crew) -> None:
    """Start a worker.

    Raises ClusterError if no process can be started, or if the pool is closed.
    """
    with crew.lock:
        if crew.closed.is_set():
            raise ClusterError(STOPPED)
        worker = _start_worker()
        crew.every.append(worker)
    with suppress(OSError):  # a dead worker is noticed at its next request
        _send_parts(worker, sys.path, crew.payload)  # where to import from, and its job
    crew.idle.put(worker)


def _send_parts(worker: subprocess.Popen[bytes], *parts: Any) -> None:
    """Send parts to a worker. Raises OSError if the worker died."""
    assert worker.stdin is not None
    for part in parts:
        pickle.dump(part, worker.stdin)
    worker.stdin.flush()


def _start_worker() -> subprocess.Popen[bytes]:
    """Return a new process that ignores Ctrl-C: this process handles it, and then stops its
    workers.
    """
    command = [sys.executable, "-P", "-c", BEGIN]
    pipes: Any = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    try:
        if sys.platform == "win32":
            apart = subprocess.CREATE_NEW_PROCESS_GROUP
            return subprocess.Popen(command, **pipes, creationflags=apart)
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # children inherit it
        try:
            return subprocess.Popen(command, **pipes)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
    except OSError as error:
        raise ClusterError(f"local workers: cannot be started: {error.strerror}") from None


def _discard_worker(crew: _Crew, worker: subprocess.Popen[bytes]) -> None:
    """Remove a worker that died, or whose answers cannot be read."""
    with crew.lock:
        if worker in crew.every:
            crew.every.remove(worker)
    _kill_worker(worker)


def _stop_workers(crew: _Crew, threads: int) -> None:
    """Stop all workers and start no more. At most `threads` threads wait for a worker."""
    with crew.lock:
        crew.closed.set()
        for worker in crew.every:
            worker.kill()
    for _ in range(threads):
        crew.idle.put(None)


def _kill_worker(worker: subprocess.Popen[bytes]) -> None:
    """Stop a worker, wait for its end, close its pipes. No further thread may be using the
    pipes.
    """
    worker.kill()
    worker.wait()
    for pipe in (worker.stdin, worker.stdout):
        if pipe is not None:
            with suppress(OSError):  # what could not be sent any more
                pipe.close()


def answer_requests() -> None:
    """Answer every batch with the result of `job.compute_blocks`, or with its exception."""
    answers = _redirect_stdout()
    payload = pickle.load(sys.stdin.buffer)
    queue: SimpleQueue[Any] = SimpleQueue()
    threading.Thread(target=_queue_requests, args=(sys.stdin.buffer, queue), daemon=True).start()
    prepared = functools.cache(lambda: pickle.loads(payload)())
    while True:
        answers.write(_pickle_answer(prepared, queue.get()))
        answers.flush()


def _redirect_stdout() -> BinaryIO:
    """Return the standard output, for answers alone. All further output goes to standard
    error.
    """
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    return answers


def _queue_requests(requests: BinaryIO, queue: SimpleQueue[Any]) -> None:
    """Read the batches that arrive into the queue. End the process, even at work, when the
    pipe is closed.
    """
    try:
        while True:
            queue.put(pickle.load(requests))
    except BaseException:  # the process at the other end has gone
        os._exit(0)


def _pickle_answer(prepared: Callable[[], Work], blocks: list[int]) -> bytes:
    """Return the pickled answer to a batch (prepared: returns the job)."""
    try:
        return pickle.dumps(compute_blocks(prepared(), blocks))
    except BaseException as error:
        return _pickle_error(error)


def _pickle_error(error: BaseException) -> bytes:
    """Return an exception as bytes, as a ClusterError if the exception cannot be read back."""
    try:
        content = pickle.dumps(error)
        pickle.loads(content)
    except Exception:
        content = pickle.dumps(ClusterError(f"a local worker: {type(error).__name__}: {error}"))
    return content
