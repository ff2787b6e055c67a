"""Kernels that are compiled once per machine: files of machine code, named by a digest of all
inputs.

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
    LinkedCode,
    MachineCode,
    compile_text,
    host_machine,
    link_block,
    stack,
)

LONG: Final = 6000  # lines from which unoptimised code is worth running while LLVM optimises
IN_PIECES: Final = 100_000  # lines of a text in whose many loads and stores schedulers get lost
LITTLE_EFFORT: Final = 1  # LLVM's level of optimisation without schedulers
# Bytes of the stack that a line takes in unoptimised code, in which no two values share a place.
VECTOR_BYTES = 32
NUMBER_BYTES = 8
START: Final = 2.0  # [s] of a function's calls after which other codes of it are compiled
CALLS: Final = 32  # of each code that are compared
# Time of other jobs is not counted, except on Windows, where it is coarse (1/64 s).
clock: Final = perf_counter if sys.platform == "win32" else thread_time
SHORT: Final = 2e-5  # [s] of a call too short to be timed
FASTER: Final = 0.95  # below this share of its time a code takes the place of the assumed one


@dataclass(frozen=True)
class Recipe:
    """Text of a kernel that is generated only if no machine code for it is cached.

    Recipes are compared by their keys.

    Attributes:
        key: all that the text depends on.
        make: returns the LLVM text of a module with a function `block`, compiled without further
            optimisation, and a note that is saved with the machine code.
    """

    key: str
    make: Callable[[], tuple[str, str]] = field(compare=False)


class CompiledBlock:
    """Compiled function of numbers and C-contiguous arrays.

    Args:
        code: its machine code.
        kinds: of its arguments.
        note: what has to be known of it besides.
        text: LLVM's, if it was compiled just now.
    """

    def __init__(self, code: LinkedCode, kinds: tuple[str, ...], note: str, text: str = "") -> None:
        self.note = note
        self.text = text
        self.trial: Callable[..., None] | None = None  # calls it, or a code of the same bits
        self._arrays = tuple(map(_entry_type, kinds))
        self._codes = [code]  # all are kept, since another thread may be within one
        self._better: threading.Thread | None = None

    @property
    def c_function(self) -> Any:
        """Return the present C function. Its arguments are numbers and addresses."""
        return self._codes[-1].function

    def __call__(self, *arguments: Any) -> None:
        """Call the function.

        Raises:
            TypeError: an array of other entries, or one that is not contiguous.
        """
        plain = []
        for value, kind in zip(arguments, self._arrays, strict=True):
            plain.append(value if kind is None else _array_address(value, kind))
        (self.trial or self.c_function)(*plain)

    @property
    def has_best(self) -> bool:
        """Return whether no better code is being compiled."""
        return self._better is None or not self._better.is_alive()

    def improve(self, better: Callable[[], LinkedCode]) -> None:
        """Compile with more effort in a thread and exchange the code between two calls."""

        def improved() -> None:
            """Compile the better code and append it."""
            self._codes.append(better())

        self._better = threading.Thread(target=improved, name="compile")
        self._better.start()

    def wait_until_best(self) -> None:
        """Wait until the best code is compiled."""
        if self._better is not None:
            self._better.join()


class Trial:
    """Timing trial of a function of steps, lanes and arrays with several codes of the same
    bits.

    In a long run a thread compiles the others. Then calls are shared out among all codes until the
    fastest is known, which gets every later call. Nothing is computed twice, no call waits.

    Args:
        own: the function in the code that is assumed to be the fastest.
        others: what compiles the others, by name.
        group: other codes take calls whose lanes are a multiple of it.
        keep: called with the name of the fastest ("" for the assumed one).
    """

    def __init__(
        self,
        own: CompiledBlock,
        others: Mapping[str, Callable[[], CompiledBlock]],
        group: int,
        keep: Callable[[str], None],
    ) -> None:
        self._own = own
        self._others = others
        self._group = group
        self._keep = keep
        self.codes = {own: ""}
        self._random = random.Random(0)
        # Seconds per step and lane of the last calls.
        self.rates: dict[CompiledBlock, deque[float]] = defaultdict(lambda: deque(maxlen=CALLS))
        self._seconds = 0.0
        self._begun = threading.Lock()
        self.is_done = False

    def __call__(self, steps: int, lanes: int, *addresses: int) -> None:
        """Call the function.

        Args:
            steps, lanes: how many.
            addresses: of the arrays.
        """
        # In turn, a code might get those calls of each run in which most happens.
        block = self._own if lanes % self._group else self._random.choice([*self.codes])
        began = clock()
        block.c_function(steps, lanes, *addresses)
        seconds = clock() - began
        if seconds > SHORT:
            self.rates[block].append(seconds / max(1, steps * lanes))
        self._seconds += seconds
        if self._seconds > START and self._begun.acquire(blocking=False):
            with suppress(RuntimeError):  # without a thread nothing is measured
                threading.Thread(target=self._compile_alternatives, name="compile").start()
        elif len(self.codes) > 1 and all(len(self.rates[each]) == CALLS for each in self.codes):
            best = min(self.codes, key=self._weighted_time)
            self.codes = {best: self.codes[best]}
            self.is_done = True
            self._keep(self.codes[best])

    def _compile_alternatives(self) -> None:
        """Compile the alternative codes unless the program ends meanwhile."""
        self._own.wait_until_best()
        codes = dict(self.codes)
        for name, make in self._others.items():
            if threading.main_thread().is_alive():
                codes[make()] = name
        if threading.main_thread().is_alive():
            self.codes = codes

    def _weighted_time(self, block: CompiledBlock) -> float:
        """Return the least time per step and lane of a code [s], weighted in favour of the
        assumed code. An alternative has to be faster by the factor `FASTER`.
        """
        return min(self.rates[block]) * (FASTER if block is self._own else 1.0)


def load_block(text: str, kinds: tuple[str, ...]) -> CompiledBlock:
    """Return the function `block` that an LLVM text defines, compiled now or read from disk.

    Args:
        text: of a module.
        kinds: of its arguments, each NumPy's name of a type of numbers, followed by * for an array,
            which arrives as a pointer.
    """
    return load_or_compile(Recipe(text, lambda: (text, "")), kinds)


@functools.lru_cache(maxsize=64)
def load_or_compile(
    recipe: Recipe, kinds: tuple[str, ...], fast_start: bool = False, most_lines: float = np.inf
) -> CompiledBlock:
    """Return the function `block` of a recipe, read from disk or compiled now.

    LLVM optimises a long text slowly. With `fast_start` its function runs without optimisation
    until a thread has optimised it. If the cache folder cannot be used or trusted, or its file is
    damaged, the function is compiled.

    Args:
        recipe: text of the function, and its key in the cache.
        kinds: types of the arguments, as for `load_block`.
        fast_start: first compile a text of `LONG` lines or more without optimisation, if the
            values of such code fit on the stack.
        most_lines: lines up to which a text is then optimised. Of a longer text, the unoptimised
            code is cached. 0: no text is optimised or cached.
    """
    block = read_cached_block(recipe, kinds)
    if block is not None:
        return block
    text, note = recipe.make()
    lines = text.count("\n")
    function_lines = max(function.count("\n") for function in text.split("\n}\n"))
    stack_bytes = function_lines * (VECTOR_BYTES if " x double>" in text else NUMBER_BYTES)
    if not fast_start or lines < LONG or stack_bytes > stack() // 4:
        return CompiledBlock(_compile_fully(recipe, kinds, text, note), kinds, note, text)
    unoptimised = compile_text(text, 0)
    block = CompiledBlock(_require_linked(link_block(unoptimised, kinds)), kinds, note, text)
    if lines <= most_lines:
        block.improve(lambda: _compile_fully(recipe, kinds, text, note))
    elif most_lines:
        _write_cached(recipe.key, kinds, note, unoptimised)
    return block


def read_cached_block(recipe: Recipe, kinds: tuple[str, ...]) -> CompiledBlock | None:
    """Return the function `block` of a recipe if it is on disk, else None."""
    cached = _read_cached(recipe.key, kinds)
    code = None if cached is None else link_block(cached[1], kinds)
    return None if cached is None or code is None else CompiledBlock(code, kinds, cached[0])


def read_answer(question: str) -> str | None:
    """Return the text that `save_answer` stored on this machine, or None."""
    found = _read_cached(question, ())
    return None if found is None else found[0]


def save_answer(question: str, text: str) -> None:
    """Write a text to disk for this machine and this engine, beside the kernels."""
    _write_cached(question, (), text, MachineCode([], b""))


def _compile_fully(recipe: Recipe, kinds: tuple[str, ...], text: str, note: str) -> LinkedCode:
    """Compile a text with full effort, store the machine code and return it linked."""
    code = compile_text(text, LITTLE_EFFORT if text.count("\n") > IN_PIECES else MOST)
    _write_cached(recipe.key, kinds, note, code)
    return _require_linked(link_block(code, kinds))


def _read_cached(key: str, kinds: tuple[str, ...]) -> tuple[str, MachineCode] | None:
    """Return the note and the machine code of a key if both are on disk, else None."""
    folder = cache_folder.cache_directory()
    if folder is None or not any(folder.glob(f"{_text_digest(key, kinds)}-*")):
        return None  # before LLVM looks up the processor
    return _parse_cached(cache_folder.read_kernel_file(folder, _cache_file_name(key, kinds)))


def _write_cached(key: str, kinds: tuple[str, ...], note: str, code: MachineCode) -> None:
    """Write the file of a key if a cache folder exists."""
    folder = cache_folder.cache_directory()
    if folder is not None:
        cache_folder.write_kernel_file(
            folder, _cache_file_name(key, kinds), _cache_content(note, code)
        )


def _require_linked(code: LinkedCode | None) -> LinkedCode:
    """Return code compiled in this process, whose called functions all exist."""
    assert code is not None
    return code


def _cache_file_name(key: str, kinds: tuple[str, ...]) -> str:
    """Return the name of a key's file: digests of text and machine, with the suffix."""
    machine = hashlib.sha256(_host_description().encode()).hexdigest()[:16]
    return f"{_text_digest(key, kinds)}-{machine}{cache_folder.SUFFIX}"


def _text_digest(key: str, kinds: tuple[str, ...]) -> str:
    """Return the first part of the file name, equal on all machines."""
    depends_on = "\n".join((_engine_digest(), *kinds, key))
    return hashlib.sha256(depends_on.encode()).hexdigest()[:32]


def _array_address(array: Any, kind: np.dtype[Any]) -> int:
    """Return the address of a contiguous array with the expected entry type.

    Raise TypeError for other arrays.
    """
    if array.dtype != kind or not array.flags.c_contiguous:
        raise TypeError(
            f"expected a contiguous array of {kind}, not {array.dtype}, strides {array.strides}"
        )
    return int(array.ctypes.data)


def _host_description() -> str:
    """Return a description of processor and library versions, the part of the key that the
    text lacks.
    """
    import casadi
    import llvmlite

    versions = f"casadi {casadi.__version__} llvmlite {llvmlite.__version__}"
    return f"undeadzone {undeadzone.__version__} {versions} {' '.join(host_machine())}"


@functools.cache
def _engine_digest() -> str:
    """Return a digest of this package's files, on which the generated text depends besides its
    key.
    """
    files = sorted(Path(__file__).parent.glob("*.*"))
    return hashlib.sha256(b"".join([path.read_bytes() for path in files])).hexdigest()


def _parse_cached(content: bytes | None) -> tuple[str, MachineCode] | None:
    """Return the note and the machine code in a file's content, or None if it is absent or
    damaged.
    """
    digest, _, rest = (content or b"").partition(b"\n")
    if digest != _sha256_text(rest):
        return None
    head, _, code = rest.partition(b"\n")
    note, calls = json.loads(head)
    return note, MachineCode(calls, code)


def _cache_content(note: str, code: MachineCode) -> bytes:
    """Return the content of a file: a digest of the rest, note and C function names, machine
    code.

    The digest only shows damage: whoever could write the file could compute it.
    """
    rest = json.dumps([note, code.calls]).encode() + b"\n" + code.code
    return _sha256_text(rest) + b"\n" + rest


def _sha256_text(content: bytes) -> bytes:
    """Return the SHA-256 digest of bytes as hexadecimal text."""
    return hashlib.sha256(content).hexdigest().encode()


def _entry_type(kind: str) -> np.dtype[Any] | None:
    """Return the entry type of an array argument, or None for a number."""
    return np.dtype(kind[:-1]) if kind.endswith("*") else None
