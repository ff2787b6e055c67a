"""Kernels compiled once per machine: files of machine code, named by what it depends on."""

from __future__ import annotations

import functools
import hashlib
import json
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

import undeadzone
from undeadzone.compile import cache_folder
from undeadzone.compile.machine import NUMBERS, Compiled, Linked, compiled, here, linked, stack

LONG: Final = 6000  # lines of a text whose code of no effort is worth while
FRAME: Final = 32  # bytes of the stack that a line takes in such code, which shares nothing


class Made(NamedTuple):
    """What a recipe gives.

    Attributes:
        text: LLVM's, of a module with a function `block`, compiled as it stands: nothing optimises
            it first.
        note: what has to be known of it besides, kept with the machine code.
    """

    text: str
    note: str = ""


class Recipe:
    """A text that is made where no machine code of it is kept; recipes are their keys.

    Args:
        key: all that the text depends on.
        make: makes it.
    """

    def __init__(self, key: str, make: Callable[[], Made]) -> None:
        self.key, self.make = key, make

    def __eq__(self, other: object) -> bool:
        """Whether another recipe makes the same."""
        return isinstance(other, Recipe) and other.key == self.key

    def __hash__(self) -> int:
        """Of its key."""
        return hash(self.key)


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
        self._arrays = tuple(map(_entries, kinds))
        self._codes = [code]  # all are kept, since another thread may be within one
        self._better: threading.Thread | None = None

    @property
    def function(self) -> Any:
        """The C function as it is now, which takes numbers and addresses."""
        return self._codes[-1].function

    def __call__(self, *arguments: Any) -> None:
        """Call the function.

        Raises:
            TypeError: an array of other entries, or one that is not contiguous.
        """
        plain = []
        for value, kind in zip(arguments, self._arrays, strict=True):
            plain.append(value if kind is None else _address(value, kind))
        self._codes[-1].function(*plain)

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


def load(text: str, kinds: tuple[str, ...]) -> Block:
    """The function `block` that LLVM's text defines, compiled now or taken from disk.

    Args:
        text: of a module.
        kinds: of its arguments, each of `NUMBERS`, or a type of numbers followed by * for an array,
            which arrives as a pointer.
    """
    return made(Recipe(text, lambda: Made(text)), kinds)


@functools.lru_cache(maxsize=64)
def made(recipe: Recipe, kinds: tuple[str, ...], hurry: bool = False) -> Block:
    """The function `block` of a recipe, compiled now or taken from disk.

    Where the folder cannot be used or trusted, or what it holds is damaged, the function is
    compiled.

    Args:
        recipe: of its text.
        kinds: of its arguments.
        hurry: of a long text whose numbers fit onto the stack, code of no effort at once, and the
            best one behind it.
    """
    block = kept(recipe, kinds)
    if block is not None:
        return block
    text, note = recipe.make()
    lines = text.count("\n")
    if not hurry or lines < LONG or lines * FRAME > stack() // 4:
        return Block(_best(recipe, kinds, text, note), kinds, note, text)
    block = Block(_sure(linked(compiled(text, 0), kinds)), kinds, note, text)
    block.improve(lambda: _best(recipe, kinds, text, note))
    return block


def kept(recipe: Recipe, kinds: tuple[str, ...]) -> Block | None:
    """The function `block` of a recipe, if it is on disk."""
    folder = cache_folder.chosen()
    if folder is None or not any(folder.glob(f"{_title(recipe, kinds)}-*")):
        return None  # without asking LLVM for the processor
    found = _parsed(cache_folder.read(folder, _name(recipe, kinds)))
    if found is None:
        return None
    note, compiled_before = found
    code = linked(compiled_before, kinds)
    return None if code is None else Block(code, kinds, note)


def _best(recipe: Recipe, kinds: tuple[str, ...], text: str, note: str) -> Linked:
    """A text compiled with all effort, linked and kept."""
    code = compiled(text)
    folder = cache_folder.chosen()
    if folder is not None:
        cache_folder.keep(folder, _name(recipe, kinds), _content(note, code))
    return _sure(linked(code, kinds))


def _sure(code: Linked | None) -> Linked:
    """Code that was compiled just now, and so calls what is there."""
    assert code is not None
    return code


def _name(recipe: Recipe, kinds: tuple[str, ...]) -> str:
    """The name of a recipe's file."""
    machine = hashlib.sha256(_machine().encode()).hexdigest()[:16]
    return f"{_title(recipe, kinds)}-{machine}{cache_folder.SUFFIX}"


def _title(recipe: Recipe, kinds: tuple[str, ...]) -> str:
    """The first part of that name, the same on all machines."""
    depends_on = "\n".join((_engine(), *kinds, recipe.key))
    return hashlib.sha256(depends_on.encode()).hexdigest()[:32]


def _address(array: Any, kind: np.dtype[Any]) -> int:
    """Where the entries of an array begin, if they are of that kind and contiguous."""
    if array.dtype != kind or not array.flags.c_contiguous:
        raise TypeError(
            f"expected a contiguous array of {kind}, "
            f"found one of {array.dtype} with strides {array.strides}"
        )
    return int(array.ctypes.data)


def _machine() -> str:
    """What machine code depends on besides its text."""
    from importlib.metadata import version

    versions = " ".join(f"{name} {version(name)}" for name in ("casadi", "llvmlite"))
    return f"undeadzone {undeadzone.__version__} {versions} {' '.join(here())}"


@functools.cache
def _engine() -> str:
    """What a recipe's text depends on besides its key: this engine as it is."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _parsed(content: bytes | None) -> tuple[str, Compiled] | None:
    """What a file holds, if it is there and whole."""
    digest, _, rest = (content or b"").partition(b"\n")
    if digest != _digest(rest):
        return None
    head, _, code = rest.partition(b"\n")
    note, calls = json.loads(head)
    return note, Compiled(calls, code)


def _content(note: str, code: Compiled) -> bytes:
    """A file's: a digest of what follows, note and names of C functions, machine code.

    The digest tells damage, nothing else: whoever could write the file could compute it.
    """
    rest = json.dumps([note, code.calls]).encode() + b"\n" + code.code
    return _digest(rest) + b"\n" + rest


def _digest(content: bytes) -> bytes:
    """A digest as text."""
    return hashlib.sha256(content).hexdigest().encode()


def _entries(kind: str) -> np.dtype[Any] | None:
    """The type of an array's entries, or None for a number."""
    return None if kind in NUMBERS else np.dtype(kind[:-1])
