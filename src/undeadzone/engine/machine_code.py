"""LLVM's text compiled to machine code, and machine code linked into this process."""

from __future__ import annotations

import ctypes
import sys
from typing import Any, Final, NamedTuple

from undeadzone.engine.machine import here

# ctypes of the numbers that a function takes.
NUMBERS: Final[dict[str, Any]] = {
    "int64": ctypes.c_int64,
    "uint64": ctypes.c_uint64,
    "float64": ctypes.c_double,
}
MOST: Final = 3  # effort


class Compiled(NamedTuple):
    """Machine code that is not linked yet.

    Attributes:
        calls: the C functions that it may call.
        code: the machine code.
    """

    calls: list[str]
    code: bytes


class Linked(NamedTuple):
    """Machine code that can be called.

    Attributes:
        function: takes numbers and addresses.
        engine: owns the machine code.
    """

    function: Any
    engine: Any


def compiled(text: str, effort: int = MOST) -> Compiled:
    """The machine code of a module, with LLVM's effort 0 (four times sooner, half as fast) to 3."""
    from llvmlite import binding

    target = here().target(effort)
    module = binding.parse_assembly(text)
    declared = [part.name for part in module.functions if part.is_declaration]
    return Compiled(_called(declared), target.emit_object(module))


def linked(made: Compiled, kinds: tuple[str, ...]) -> Linked | None:
    """The function `block` of machine code, ready to be called.

    None if something that it calls is missing from this process, at which LLVM would abort.
    """
    from llvmlite import binding

    library = _library()
    declarations = "\n".join(f"declare void @{name}()" for name in made.calls)
    names = binding.parse_assembly(declarations)
    engine = binding.create_mcjit_compiler(names, here().target())
    for name in made.calls:
        function = getattr(library, name, None)
        if function is not None:
            address = ctypes.cast(function, ctypes.c_void_p).value
            engine.add_global_mapping(names.get_function(name), address)
        elif binding.address_of_symbol(name) is None:
            return None
    engine.add_object_file(binding.ObjectFileRef.from_data(made.code))
    engine.finalize_object()
    prototype = ctypes.CFUNCTYPE(None, *(NUMBERS.get(kind, ctypes.c_void_p) for kind in kinds))
    return Linked(prototype(engine.get_function_address("block")), engine)


def _called(declared: list[str]) -> list[str]:
    """The C functions that may be called, from the names that LLVM declares.

    An intrinsic function such as llvm.floor.v2f64 may become a call of floor.
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
