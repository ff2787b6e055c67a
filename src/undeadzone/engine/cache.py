"""Kernels compiled once per machine: files of machine code, named by what it depends on."""

from __future__ import annotations

import ctypes
import functools
import hashlib
import sys
from typing import Any, Final, NamedTuple

import numpy as np

import undeadzone
from undeadzone.engine import cache_folder
from undeadzone.engine.machine import here

# ctypes of the numbers that a kernel takes.
NUMBERS: Final[dict[str, Any]] = {
    "int64": ctypes.c_int64,
    "uint64": ctypes.c_uint64,
    "float64": ctypes.c_double,
}


class Compiled(NamedTuple):
    """Machine code that is not linked yet.

    Attributes:
        calls: the C functions that it may call.
        code: the machine code.
    """

    calls: list[str]
    code: bytes


class Block(NamedTuple):
    """A compiled function of numbers and C-contiguous arrays.

    Attributes:
        function: takes numbers and addresses.
        arrays: per argument, the type of an array's entries, or None for a number.
        engine: owns the machine code.
        text: LLVM's, if it was compiled just now.
    """

    function: Any
    arrays: tuple[np.dtype[Any] | None, ...]
    engine: Any
    text: str

    def __call__(self, *arguments: Any) -> None:
        """Call the function.

        Raises:
            TypeError: an array of other entries, or one that is not contiguous.
        """
        plain = []
        for value, kind in zip(arguments, self.arrays, strict=True):
            plain.append(value if kind is None else _address(value, kind))
        self.function(*plain)


@functools.lru_cache(maxsize=64)
def load(source: str, kinds: tuple[str, ...]) -> Block:
    """The function `block` that LLVM's text defines, compiled now or taken from disk.

    Where the folder cannot be used or trusted, or what it holds is damaged, the function is
    compiled.

    Args:
        source: of a module that is compiled as it stands: nothing optimises it first.
        kinds: of its arguments, each of `NUMBERS`, or a type of numbers followed by * for an array,
            which arrives as a pointer.
    """
    folder = cache_folder.chosen()
    if folder is None:
        return _compiled_block(source, kinds)[0]
    depends_on = "\n".join((_machine(), *kinds, source))
    name = hashlib.sha256(depends_on.encode()).hexdigest()[:32] + cache_folder.SUFFIX
    kept = _parsed(cache_folder.read(folder, name))
    block = None if kept is None else _linked(kept, kinds)
    if block is None:
        block, compiled = _compiled_block(source, kinds)
        cache_folder.keep(folder, name, _content(compiled))
    return block


def _compiled_block(source: str, kinds: tuple[str, ...]) -> tuple[Block, Compiled]:
    """A source compiled now: ready to be called, and to be kept."""
    compiled = _compiled(source)
    block = _linked(compiled, kinds)
    assert block is not None
    return block._replace(text=source), compiled


def _address(array: Any, kind: np.dtype[Any]) -> int:
    """Where the entries of an array begin, if they are of that kind and contiguous."""
    if array.dtype != kind or not array.flags.c_contiguous:
        raise TypeError(
            f"expected a contiguous array of {kind}, "
            f"found one of {array.dtype} with strides {array.strides}"
        )
    return int(array.ctypes.data)


def _machine() -> str:
    """What machine code depends on besides its source."""
    from importlib.metadata import version

    versions = " ".join(f"{name} {version(name)}" for name in ("casadi", "llvmlite"))
    return f"undeadzone {undeadzone.__version__} {versions} {' '.join(here())}"


def _parsed(content: bytes | None) -> Compiled | None:
    """What a file holds, if it is there and whole."""
    digest, _, rest = (content or b"").partition(b"\n")
    if digest != _digest(rest):
        return None
    calls, _, code = rest.partition(b"\n")
    return Compiled(calls.decode().split(), code)


def _content(compiled: Compiled) -> bytes:
    """A file's: a digest of what follows, the names of C functions, machine code.

    The digest tells damage, nothing else: whoever could write the file could compute it.
    """
    rest = " ".join(compiled.calls).encode() + b"\n" + compiled.code
    return _digest(rest) + b"\n" + rest


def _digest(content: bytes) -> bytes:
    """A digest as text."""
    return hashlib.sha256(content).hexdigest().encode()


def _compiled(source: str) -> Compiled:
    """The machine code of a source."""
    from llvmlite import binding

    target = here().target()
    module = binding.parse_assembly(source)
    module.verify()
    declared = [part.name for part in module.functions if part.is_declaration]
    return Compiled(_called(declared), target.emit_object(module))


def _called(declared: list[str]) -> list[str]:
    """The C functions that may be called, from the names that LLVM declares.

    An intrinsic function such as llvm.sin.v8f64 may become a call of sin.
    """
    library = _library()
    calls = set()
    for name in declared:
        if not name.startswith("llvm."):
            calls.add(name)
        elif hasattr(library, name.split(".")[1]):
            calls.add(name.split(".")[1])
    return sorted(calls)


def _library() -> ctypes.CDLL:
    """The C library of this process."""
    return ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None)


def _linked(compiled: Compiled, kinds: tuple[str, ...]) -> Block | None:
    """Machine code ready to be called.

    None if something that it calls is missing from this process, at which LLVM would abort.
    """
    from llvmlite import binding

    library = _library()
    declarations = "\n".join(f"declare void @{name}()" for name in compiled.calls)
    names = binding.parse_assembly(declarations)
    engine = binding.create_mcjit_compiler(names, here().target())
    for name in compiled.calls:
        function = getattr(library, name, None)
        if function is not None:
            address = ctypes.cast(function, ctypes.c_void_p).value
            engine.add_global_mapping(names.get_function(name), address)
        elif binding.address_of_symbol(name) is None:
            return None
    engine.add_object_file(binding.ObjectFileRef.from_data(compiled.code))
    engine.finalize_object()
    prototype = ctypes.CFUNCTYPE(None, *(NUMBERS.get(kind, ctypes.c_void_p) for kind in kinds))
    block = prototype(engine.get_function_address("block"))
    return Block(block, tuple(map(_entries, kinds)), engine, "")


def _entries(kind: str) -> np.dtype[Any] | None:
    """The type of an array's entries, or None for a number."""
    return None if kind in NUMBERS else np.dtype(kind[:-1])
