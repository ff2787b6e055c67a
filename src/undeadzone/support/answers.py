"""Answers of a long computation on disk, a line each: stopped at any moment, it can go on.

The first line says of what the answers are. Each line begins with a checksum of its rest, so
nothing that was torn is believed, and ends where the next one begins.

What is kept of a computation that something stops, and who may write it.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

from undeadzone.errors import FileError, InputError, Terminated, UndeadzoneError
from undeadzone.support.files import LARGEST_TABLE, open_kept, writing
from undeadzone.support.versions import versions


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


# --- Answers on disk

SUM = 16  # hexadecimal digits of a checksum


class Answers:
    """An open file of answers, locked against other processes; made where there is none.

    Args:
        path: of the file.
        problem: everything that the answers depend on, besides versions of packages.
        unit: what an answer is of, in the plural, for messages.
        resume: take up what an earlier run left there.

    Raises:
        FileError: it cannot be written, another process uses it, it is something else, or it is
            there and `resume` is not set.
        InputError: it holds another problem.
    """

    def __init__(
        self, path: Path, problem: Mapping[str, Any], unit: str, resume: bool = False
    ) -> None:
        self._path, self._unit = path, unit
        self._known: dict[str, Any] = {}
        self._is_first = not path.parent.exists()
        self._file = open_kept(path, "a+", LARGEST_TABLE)
        try:
            lock(path, self._file)
            self._open({"answers": unit, **problem, **versions()}, resume)
        except BaseException:
            self._file.close()
            raise

    def of(
        self, questions: Sequence[Any], compute: Callable[[list[int]], Iterator[tuple[int, Any]]]
    ) -> list[Any]:
        """The answers to questions; those that are missing are computed, and kept as they come.

        Args:
            questions: values that JSON knows.
            compute: takes the numbers of those to be answered, gives (number, answer).
        """
        texts = [json.dumps(question) for question in questions]
        missing = [k for k, text in enumerate(texts) if text not in self._known]
        for k, answer in compute(missing) if missing else ():
            self._append(json.dumps([texts[k], answer]))
            self._known[texts[k]] = answer
        return [self._known[text] for text in texts]

    @contextmanager
    def kept(self) -> Iterator[None]:
        """Close the file at the end; where something stops what is done inside, say what is kept.

        Then a file without answers is deleted. One that is complete stays, until what its answers
        are for is saved.
        """
        with keeping(self._leave):
            yield
        self._file.close()

    def drop(self) -> None:
        """Delete the file, and its folder where the file was the first thing in it."""
        self._path.unlink(missing_ok=True)
        if self._is_first:
            with suppress(OSError):  # something else is there by now
                self._path.parent.rmdir()

    def _open(self, problem: Mapping[str, Any], resume: bool) -> None:
        """Read the answers that are there, or begin the file."""
        with writing(self._path):
            self._file.seek(0)
            content = self._file.read()
        head = json.dumps(problem)
        if _line(head).startswith(content):  # empty, or torn in its first line
            with writing(self._path):
                self._file.truncate(0)
            try:
                self._append(head)
            except FileError:  # disk full
                self.drop()
                raise
            return
        lines = [line for line in map(_checked, content.split(b"\n")) if line is not None]
        self._require(lines, problem, resume)
        for line in lines[1:]:
            question, answer = json.loads(line)
            self._known[question] = answer
        if not content.endswith(b"\n"):  # a torn line must not swallow the next one
            with writing(self._path):
                self._file.write(b"\n")

    def _require(self, lines: list[str], problem: Mapping[str, Any], resume: bool) -> None:
        """Raise FileError or InputError for a file that cannot be continued."""
        try:
            there = json.loads(lines[0])
            there["answers"]
        except (IndexError, ValueError, TypeError, KeyError):
            raise FileError(
                f"{self._path}: holds no kept {self._unit}; choose another name or delete it"
            ) from None
        if not resume:
            raise FileError(
                f"{self._path}: {self._unit} of a stopped run are there; continue it with "
                "--resume, or delete it to start anew"
            )
        here = json.loads(json.dumps(problem))
        other = sorted(key for key in here | there if here.get(key) != there.get(key))
        if other:
            raise InputError(
                f"{self._path}: holds another problem ({', '.join(other)} differ); "
                "delete it to start anew, or choose another name"
            )

    def _append(self, text: str) -> None:
        """Write a line. Raises FileError (disk full, file removed)."""
        if not os.fstat(self._file.fileno()).st_nlink:
            raise FileError(f"{self._path}: cannot write: it was removed")
        with writing(self._path):
            view = memoryview(_line(text))
            while view:
                view = view[self._file.write(view) :]

    def _leave(self) -> str:
        """Close the file, or remove one without answers, and say what it holds."""
        self._file.close()
        if not self._known:
            self.drop()
            return ""
        return f"{len(self._known)} {self._unit} are kept in {self._path}; continue with --resume"


def _line(text: str) -> bytes:
    """A line of the file."""
    data = text.encode()
    return _sum(data) + b" " + data + b"\n"


def _sum(data: bytes) -> bytes:
    """The checksum of a line."""
    return hashlib.blake2b(data, digest_size=SUM // 2).hexdigest().encode()


def _checked(line: bytes) -> str | None:
    """What a line says, if its checksum is right."""
    begin, _, rest = line.partition(b" ")
    return rest.decode() if begin == _sum(rest) else None
