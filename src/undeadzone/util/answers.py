"""Answers of a long computation on disk, a line each: stopped at any moment, it can go on.

The first line says of what the answers are. Each line begins with a checksum of its rest, so
nothing that was torn is believed, and ends where the next one begins.

What is kept of a computation that something stops, and who may write it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from undeadzone.errors import FileError, InputError, Terminated, UndeadzoneError
from undeadzone.util.files import LARGEST_TABLE, lock_file, write_all, writing
from undeadzone.util.versions import versions


@contextmanager
def keeping(leave: Callable[[], str]) -> Iterator[None]:
    """Provide say what is kept, if something stops what is done inside.

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


def problem_there(
    path: Path, head: str | bytes, mark: str, words: tuple[str, str], resume: bool
) -> dict[str, Any]:
    """Return the problem that a file says it is of.

    Args:
        path: of the file.
        head: what it begins with, JSON where it is such a file.
        mark: a key of every such problem.
        words: that it is no such file, that it is one.
        resume: whether it may be taken up.

    Raises:
        FileError: it is something else, or may not be taken up.
    """
    no_such_file, is_there = words
    try:
        there: dict[str, Any] = json.loads(head)
        there[mark]
    except (ValueError, TypeError, KeyError):
        raise FileError(f"{path}: {no_such_file}; choose another name or delete it") from None
    if not resume:
        raise FileError(
            f"{path}: {is_there}; continue it with --resume, or delete it to start anew"
        )
    return there


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
        with lock_file(path, "a+", LARGEST_TABLE) as self._file:
            self._open({"answers": unit, **problem, **versions()}, resume)

    def of(
        self, questions: Sequence[Any], compute: Callable[[list[int]], Iterator[tuple[int, Any]]]
    ) -> list[Any]:
        """Return the answers to questions; those that are missing are computed, and kept as they
        come.

        Args:
            questions: values that JSON knows.
            compute: takes the numbers of those to be answered, gives (number, answer).
        """
        texts = [json.dumps(question) for question in questions]
        missing = [k for k, text in enumerate(texts) if text not in self._known]
        for k, answer in compute(missing) if missing else ():
            write_all(self._path, self._file, _line(json.dumps([texts[k], answer])))
            self._known[texts[k]] = answer
        return [self._known[text] for text in texts]

    @contextmanager
    def hold_file(self) -> Iterator[None]:
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
        """Read the answers that are there, or begin the file. Raises FileError or InputError."""
        with writing(self._path):
            self._file.seek(0)
            content = self._file.read()
        head = json.dumps(problem)
        if _line(head).startswith(content):  # empty, or torn in its first line
            with writing(self._path):
                self._file.truncate(0)
            try:
                write_all(self._path, self._file, _line(head))
            except FileError:  # disk full
                self.drop()
                raise
            return
        lines = [line for line in map(_parse_line, content.split(b"\n")) if line is not None]
        words = f"holds no kept {self._unit}", f"{self._unit} of a stopped run are there"
        there = problem_there(self._path, lines[0] if lines else "", "answers", words, resume)
        here = json.loads(head)
        other = sorted(key for key in here | there if here.get(key) != there.get(key))
        if other:
            raise InputError(
                f"{self._path}: holds another problem ({', '.join(other)} differ); "
                "delete it to start anew, or choose another name"
            )
        for line in lines[1:]:
            question, answer = json.loads(line)
            self._known[question] = answer
        if not content.endswith(b"\n"):  # a torn line must not swallow the next one
            with writing(self._path):
                self._file.write(b"\n")

    def _leave(self) -> str:
        """Close the file, or remove one without answers, and say what it holds."""
        self._file.close()
        if not self._known:
            self.drop()
            return ""
        return f"{len(self._known)} {self._unit} are kept in {self._path}; continue with --resume"


def _line(text: str) -> bytes:
    """Return a line of the file."""
    data = text.encode()
    return _sum(data) + b" " + data + b"\n"


def _sum(data: bytes) -> bytes:
    """Return the checksum of a line."""
    return hashlib.blake2b(data, digest_size=SUM // 2).hexdigest().encode()


def _parse_line(line: bytes) -> str | None:
    """What a line says, if its checksum is right."""
    begin, _, rest = line.partition(b" ")
    return rest.decode() if begin == _sum(rest) else None
