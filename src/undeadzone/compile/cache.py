"""Kernels compiled once per machine: files of machine code, named by what it depends on.

Where several codes compute the same bits, a long run finds out which is the fastest (`Trial`).
"""

from __future__ import annotations

import functools
import hashlib
import json
import random
import sys
import threading
from collections import defaultdict, deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter, thread_time
from typing import Any, Final

import numpy as np

import undeadzone
from undeadzone.compile import cache_folder
from undeadzone.compile.machine import (
    MOST,
    Compiled,
    Linked,
    compile_module,
    here,
    link_block,
    stack,
)

LONG: Final = 6000  # lines of a text whose code of no effort is worth while
IN_PIECES: Final = 100_000  # lines of a text in whose many loads and stores schedulers get lost
LESS: Final = 1  # LLVM's effort without them
FRAME: Final = 32  # bytes of the stack that a line takes in such code, which shares nothing
START: Final = 2.0  # [s] of a function's calls after which other codes of it are compiled
CALLS: Final = 32  # of each code that are compared
# What other jobs take is not counted, but on Windows, which counts it in 64ths of a second.
clock: Final = perf_counter if sys.platform == "win32" else thread_time
SHORT: Final = 2e-5  # [s] of a call that tells nothing
FASTER: Final = 0.95  # below this share of its time a code takes the place of the assumed one


@dataclass(frozen=True)
class Recipe:
    """A text that is made where no machine code of it is kept; recipes are their keys.

    Attributes:
        key: all that the text depends on.
        make: makes the text, LLVM's, of a module with a function `block`, compiled as it stands:
            nothing optimises it first; and a note, what has to be known of it besides, kept with
            the machine code.
    """

    key: str
    make: Callable[[], tuple[str, str]] = field(compare=False)


class Block:
    """A compiled function of numbers and C-contiguous arrays.

    Args:
        code: its machine code.
        kinds: of its arguments.
        note: what has to be known of it besides.
        text: LLVM's, if it was compiled just now.
    """

    def __init__(self, code: Linked, kinds: tuple[str, ...], note: str, text: str = "") -> None:
        self.note, self.text = note, text
        self.trial: Callable[..., None] | None = None  # calls it, or a code of the same bits
        self._arrays = tuple(map(_entries, kinds))
        self._codes = [code]  # all are kept, since another thread may be within one
        self._better: threading.Thread | None = None

    @property
    def function(self) -> Any:
        """Return the C function as it is now, which takes numbers and addresses."""
        return self._codes[-1].function

    def __call__(self, *arguments: Any) -> None:
        """Call the function.

        Raises:
            TypeError: an array of other entries, or one that is not contiguous.
        """
        plain = []
        for value, kind in zip(arguments, self._arrays, strict=True):
            plain.append(value if kind is None else _address(value, kind))
        (self.trial or self.function)(*plain)

    def improve(self, better: Callable[[], Linked]) -> None:
        """Compile with more effort in a thread, and change the code between two calls."""

        def improved() -> None:
            self._codes.append(better())

        self._better = threading.Thread(target=improved, name="compile")
        self._better.start()

    def settle(self) -> None:
        """Wait for the best code."""
        if self._better is not None:
            self._better.join()


class Trial:
    """A function of steps, lanes and arrays in several codes of the same bits.

    In a long run a thread compiles the others; then calls are shared out among all codes until the
    fastest is known, which has every call from there on. Nothing is computed twice, no call waits.

    Args:
        own: the function in the code that is assumed to be the fastest.
        others: what compiles the others, by name.
        group: other codes take calls whose lanes are a multiple of it.
        keep: told the name of the fastest; "" for the assumed one.
    """

    def __init__(
        self,
        own: Block,
        others: Mapping[str, Callable[[], Block]],
        group: int,
        keep: Callable[[str], None],
    ) -> None:
        self._own, self._others, self._group, self._keep = own, others, group, keep
        self.codes, self._random = {own: ""}, random.Random(0)
        # Seconds per step and lane of the last calls.
        self.rates: dict[Block, deque[float]] = defaultdict(lambda: deque(maxlen=CALLS))
        self._seconds, self._begun, self.is_done = 0.0, threading.Lock(), False

    def __call__(self, steps: int, lanes: int, *addresses: int) -> None:
        """Call the function.

        Args:
            steps, lanes: how many.
            addresses: of the arrays.
        """
        # In turn, a code might get those calls of each run in which most happens.
        block = self._own if lanes % self._group else self._random.choice([*self.codes])
        began = clock()
        block.function(steps, lanes, *addresses)
        seconds = clock() - began
        if seconds > SHORT:
            self.rates[block].append(seconds / max(1, steps * lanes))
        self._seconds += seconds
        if self._seconds > START and self._begun.acquire(blocking=False):
            with suppress(RuntimeError):  # where no thread can be had, nothing is measured
                threading.Thread(target=self._compile, name="compile").start()
        elif len(self.codes) > 1 and all(len(self.rates[each]) == CALLS for each in self.codes):
            best = min(self.codes, key=self._least_time)
            self.codes, self.is_done = {best: self.codes[best]}, True
            self._keep(self.codes[best])

    def _compile(self) -> None:
        """Compile the other codes, unless the program ends meanwhile."""
        self._own.settle()
        codes = dict(self.codes)
        for name, make in self._others.items():
            if threading.main_thread().is_alive():
                codes[make()] = name
        if threading.main_thread().is_alive():
            self.codes = codes

    def _least_time(self, block: Block) -> float:
        """Return the least time of a code, where another one has to be faster than the assumed
        one.
        """
        return min(self.rates[block]) * (FASTER if block is self._own else 1.0)


def load(text: str, kinds: tuple[str, ...]) -> Block:
    """Return the function `block` that LLVM's text defines, compiled now or taken from disk.

    Args:
        text: of a module.
        kinds: of its arguments, each NumPy's name of a type of numbers, followed by * for an array,
            which arrives as a pointer.
    """
    return compile_or_load(Recipe(text, lambda: (text, "")), kinds)


@functools.lru_cache(maxsize=64)
def compile_or_load(recipe: Recipe, kinds: tuple[str, ...], hurry: bool = False) -> Block:
    """Return the function `block` of a recipe, compiled now or taken from disk.

    Where the folder cannot be used or trusted, or what it holds is damaged, the function is
    compiled.

    Args:
        recipe: of its text.
        kinds: of its arguments.
        hurry: of a long text whose numbers fit onto the stack, code of no effort at once, and the
            best one behind it.
    """
    block = cached_block(recipe, kinds)
    if block is not None:
        return block
    text, note = recipe.make()
    lines = text.count("\n")
    longest = max(part.count("\n") for part in text.split("\n}\n"))  # of its functions
    if not hurry or lines < LONG or longest * FRAME > stack() // 4:
        return Block(_best(recipe, kinds, text, note), kinds, note, text)
    block = Block(_sure(link_block(compile_module(text, 0), kinds)), kinds, note, text)
    block.improve(lambda: _best(recipe, kinds, text, note))
    return block


def cached_block(recipe: Recipe, kinds: tuple[str, ...]) -> Block | None:
    """Return the function `block` of a recipe, if it is on disk."""
    found = _read_entry(recipe.key, kinds)
    code = None if found is None else link_block(found[1], kinds)
    return None if found is None or code is None else Block(code, kinds, found[0])


def answer(question: str) -> str | None:
    """What `keep_answer` kept on this machine, if it is on disk."""
    found = _read_entry(question, ())
    return None if found is None else found[0]


def keep_answer(question: str, text: str) -> None:
    """Keep a text on disk for this machine and this engine, beside the kernels."""
    _keep(question, (), text, Compiled([], b""))


def _best(recipe: Recipe, kinds: tuple[str, ...], text: str, note: str) -> Linked:
    """Return a text compiled with all effort, linked and kept."""
    code = compile_module(text, LESS if text.count("\n") > IN_PIECES else MOST)
    _keep(recipe.key, kinds, note, code)
    return _sure(link_block(code, kinds))


def _read_entry(key: str, kinds: tuple[str, ...]) -> tuple[str, Compiled] | None:
    """Note and machine code of a key, if they are on disk."""
    folder = cache_folder.choose_folder()
    if folder is None or not any(folder.glob(f"{_title(key, kinds)}-*")):
        return None  # without asking LLVM for the processor
    return _parse_entry(cache_folder.read(folder, _name(key, kinds)))


def _keep(key: str, kinds: tuple[str, ...], note: str, code: Compiled) -> None:
    """Write a key's file, where there is a folder for it."""
    folder = cache_folder.choose_folder()
    if folder is not None:
        cache_folder.keep(folder, _name(key, kinds), _content(note, code))


def _sure(code: Linked | None) -> Linked:
    """Return code that was compiled just now, and so calls what is there."""
    assert code is not None
    return code


def _name(key: str, kinds: tuple[str, ...]) -> str:
    """Return the name of a key's file."""
    machine = hashlib.sha256(_machine().encode()).hexdigest()[:16]
    return f"{_title(key, kinds)}-{machine}{cache_folder.SUFFIX}"


def _title(key: str, kinds: tuple[str, ...]) -> str:
    """Return the first part of that name, the same on all machines."""
    depends_on = "\n".join((_engine(), *kinds, key))
    return hashlib.sha256(depends_on.encode()).hexdigest()[:32]


def _address(array: Any, kind: np.dtype[Any]) -> int:
    """Where the entries of an array begin, if they are of that kind and contiguous."""
    if array.dtype != kind or not array.flags.c_contiguous:
        raise TypeError(
            f"expected a contiguous array of {kind}, not {array.dtype}, strides {array.strides}"
        )
    return int(array.ctypes.data)


def _machine() -> str:
    """What machine code depends on besides its text."""
    import casadi
    import llvmlite

    versions = f"casadi {casadi.__version__} llvmlite {llvmlite.__version__}"
    return f"undeadzone {undeadzone.__version__} {versions} {' '.join(here())}"


@functools.cache
def _engine() -> str:
    """What a recipe's text depends on besides its key: this engine as it is."""
    files = sorted(Path(__file__).parent.glob("*.*"))
    return hashlib.sha256(b"".join([path.read_bytes() for path in files])).hexdigest()


def _parse_entry(content: bytes | None) -> tuple[str, Compiled] | None:
    """What a file holds, if it is there and whole."""
    digest, _, rest = (content or b"").partition(b"\n")
    if digest != _digest(rest):
        return None
    head, _, code = rest.partition(b"\n")
    note, calls = json.loads(head)
    return note, Compiled(calls, code)


def _content(note: str, code: Compiled) -> bytes:
    """Return a file's: a digest of what follows, note and names of C functions, machine code.

    The digest tells damage, nothing else: whoever could write the file could compute it.
    """
    rest = json.dumps([note, code.calls]).encode() + b"\n" + code.code
    return _digest(rest) + b"\n" + rest


def _digest(content: bytes) -> bytes:
    """Return a digest as text."""
    return hashlib.sha256(content).hexdigest().encode()


def _entries(kind: str) -> np.dtype[Any] | None:
    """Return the type of an array's entries, or None for a number."""
    return np.dtype(kind[:-1]) if kind.endswith("*") else None
