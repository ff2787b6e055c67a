"""Results of a long computation on disk, one per line, so that a stopped computation can be
resumed.

The first line identifies the computation. Each line begins with a checksum of its rest, so that a
torn line is not used, and ends at the beginning of the next one.

The results of a stopped computation are kept, and only one process may write them.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from itertools import zip_longest
from pathlib import Path
from typing import Any, Final

from undeadzone.errors import FileError, InputError, Terminated, UndeadzoneError
from undeadzone.util.files import LARGEST_TABLE, convert_write_errors, lock_file, write_all_bytes
from undeadzone.util.installed import package_versions

CURE: Final = "delete it to start anew, or choose another name"


@contextmanager
def report_saved_on_stop(leave: Callable[[], str]) -> Iterator[None]:
    """Provide a block whose interruption or error reports the saved results.

    Args:
        leave: closes the file and returns the sentence that describes its content (empty: nothing).
    """
    try:
        yield
    except (KeyboardInterrupt, Terminated) as stop:
        raise type(stop)(leave()) from None
    except UndeadzoneError as error:
        sentences = (str(error), leave())
        raise type(error)("; ".join(filter(None, sentences))) from None
    except BaseException as error:
        description = leave()
        # Ctrl-C within a lock of the thread pool ends as a RuntimeError.
        before = error.__context__
        if isinstance(before, KeyboardInterrupt | Terminated):
            raise type(before)(description) from None
        raise


def load_saved_problem(
    path: Path, head: str | bytes, mark: str, words: tuple[str, str], resume: bool
) -> dict[str, Any]:
    """Return the problem description at the beginning of a file.

    Args:
        path: of the file.
        head: its first line, JSON if it is a file of saved results.
        mark: a key of every such problem.
        words: messages that it is not such a file, and that it is one.
        resume: whether it may be taken up.

    Raises:
        FileError: it is something else, or may not be taken up.
    """
    no_such_file, is_there = words
    try:
        there: dict[str, Any] = json.loads(head)
        there[mark]
    except (ValueError, TypeError, KeyError):
        raise FileError(f"{path}: {no_such_file}. Choose another name or delete it") from None
    if not resume:
        raise FileError(
            f"{path}: {is_there}. Continue it with resume=True, or delete it to start anew"
        )
    return there


def require_same_problem(
    path: Path, there: dict[str, Any], here: dict[str, Any], cure: str = CURE
) -> None:
    """Raise InputError if a file contains another problem than this.

    Args:
        path: of the file
        there: what determines the numbers that it holds
        here: what determines those to be computed
        cure: what to do about it
    """
    found = "; ".join(_list_differences("", there, here))
    if found:
        raise InputError(f"{path}: holds another problem ({found}); {cure}")


def _list_differences(name: str, there: Any, here: Any) -> Iterator[str]:
    """Yield the first lines in which two values differ, by key of their tables."""
    if isinstance(there, dict) and isinstance(here, dict):
        for key in here | there:
            path = f"{name}.{key}" if name else key
            yield from _list_differences(path, there.get(key), here.get(key))
    elif there != here:
        lines = zip_longest(str(there).splitlines(), str(here).splitlines(), fillvalue="nothing")
        was, now = next((pair for pair in lines if pair[0] != pair[1]), (there, here))
        yield f"{name}: {was!s:.60} there, {now!s:.60} here"


# --- Answers on disk

SUM = 16  # hexadecimal digits of a checksum


class MemoryAnswers:
    """Answers to questions, each computed once."""

    def __init__(self) -> None:
        self._known: dict[str, Any] = {}

    def compute_missing(
        self, questions: Sequence[Any], compute: Callable[[list[int]], Iterator[tuple[int, Any]]]
    ) -> list[Any]:
        """Return the answers to questions.

        Missing answers are computed, and saved as they arrive.

        Args:
            questions: values that JSON knows.
            compute: takes the numbers of those to be answered, gives (number, answer).
        """
        texts = list(map(json.dumps, questions))
        missing = [k for k, text in enumerate(texts) if text not in self._known]
        for k, answer in compute(missing) if missing else ():
            self._save(texts[k], answer)
            self._known[texts[k]] = answer
        return [self._known[text] for text in texts]

    def _save(self, question: str, answer: Any) -> None:
        """Save an answer. In memory it is known already."""


class Answers(MemoryAnswers):
    """Open file of results, locked against other processes, created if missing.

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
        super().__init__()
        self._path = path
        self._unit = unit
        self._is_first = not path.parent.exists()
        with lock_file(path, "a+", LARGEST_TABLE) as self._file:
            self._load_or_begin({"answers": unit, **problem, **package_versions()}, resume)

    def _save(self, question: str, answer: Any) -> None:
        """Write an answer to the file."""
        line = _to_checksummed_line(json.dumps([question, answer]))
        write_all_bytes(self._path, self._file, line)

    @contextmanager
    def hold_file(self) -> Iterator[None]:
        """Provide the open file and close it at the end. Report the saved answers after an
        interruption.

        Then a file without answers is deleted. One that is complete stays, until what its answers
        are for is saved.
        """
        with report_saved_on_stop(self._close_and_describe):
            yield
        self._file.close()

    def delete_file(self) -> None:
        """Delete the file, and its folder if the file was the first entry of the folder."""
        self._path.unlink(missing_ok=True)
        if self._is_first:
            with suppress(OSError):  # something else is there by now
                self._path.parent.rmdir()

    def _load_or_begin(self, problem: Mapping[str, Any], resume: bool) -> None:
        """Read the saved answers, or begin the file. Raises FileError or InputError."""
        with convert_write_errors(self._path):
            self._file.seek(0)
            content = self._file.read()
        head = json.dumps(problem)
        if _to_checksummed_line(head).startswith(content):  # empty, or torn in its first line
            with convert_write_errors(self._path):
                self._file.truncate(0)
            try:
                write_all_bytes(self._path, self._file, _to_checksummed_line(head))
            except FileError:  # disk full
                self.delete_file()
                raise
            return
        lines = [line for line in map(_parse_line, content.split(b"\n")) if line is not None]
        words = f"holds no kept {self._unit}", f"{self._unit} of a stopped run are there"
        there = load_saved_problem(self._path, lines[0] if lines else "", "answers", words, resume)
        require_same_problem(self._path, there, json.loads(head))
        for line in lines[1:]:
            question, answer = json.loads(line)
            self._known[question] = answer
        if not content.endswith(b"\n"):  # a torn line must not swallow the next one
            with convert_write_errors(self._path):
                self._file.write(b"\n")

    def _close_and_describe(self) -> str:
        """Close the file, or remove an empty one, and describe its content."""
        self._file.close()
        if not self._known:
            self.delete_file()
            return ""
        return (
            f"{len(self._known)} {self._unit} are kept in {self._path}; continue with resume=True"
        )


@contextmanager
def open_answers(
    path: Path | None, describe: Callable[[], Mapping[str, Any]], unit: str, resume: bool
) -> Iterator[MemoryAnswers]:
    """Provide answers that are saved in a file, or kept in memory without a file.

    Args:
        path: of the file (None: none).
        describe: gives the `problem` of `Answers`.
        unit, resume: see `Answers`.

    Raises:
        FileError or InputError: as `Answers`.
    """
    if path is None:
        yield MemoryAnswers()
        return
    answers = Answers(path, describe(), unit, resume)
    with answers.hold_file():
        yield answers


def _to_checksummed_line(text: str) -> bytes:
    """Return a line of the file: checksum and text."""
    data = text.encode()
    return _line_checksum(data) + b" " + data + b"\n"


def _line_checksum(data: bytes) -> bytes:
    """Return the checksum of a line."""
    return hashlib.blake2b(data, digest_size=SUM // 2).hexdigest().encode()


def _parse_line(line: bytes) -> str | None:
    """Return the text of a line if its checksum is right, else None."""
    begin, _, rest = line.partition(b" ")
    return rest.decode() if begin == _line_checksum(rest) else None
