"""Kernels compiled once per machine: machine code in a file named by the hash of all that it depends on.

A kernel is read back and called without numba, whose import and bookkeeping take longer than most runs.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import os
import sys
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

import undeadzone
from undeadzone.errors import FileError
from undeadzone.support.files import replacing

NUMBERS: Final[dict[str, Any]] = {
    "int64": ctypes.c_int64,
    "uint64": ctypes.c_uint64,
    "float64": ctypes.c_double,
}


class Compiled(NamedTuple):
    """Machine code that is not linked yet, and the C functions that it may call."""

    calls: list[str]
    code: bytes


class Block(NamedTuple):
    """A compiled function of numbers and C-contiguous arrays.

    arrays: per argument, the type of an array's entries, or None for a number; engine: owns the machine code; text:
    LLVM's, if it was compiled just now.
    """

    function: Any
    arrays: tuple[np.dtype[Any] | None, ...]
    engine: Any
    text: str

    def __call__(self, *given: Any) -> None:
        """Raises TypeError for an array of other entries or that is not contiguous."""
        self.function(
            *(
                value if kind is None else _address(value, kind)
                for value, kind in zip(given, self.arrays, strict=True)
            )
        )


def folder() -> Path | None:
    """$UNDEADZONE_CACHE, or `undeadzone` in $XDG_CACHE_HOME or ~/.cache; None where there is no home."""
    if given := os.environ.get("UNDEADZONE_CACHE"):
        return Path(given)
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "undeadzone"
    except RuntimeError:
        return None


@functools.lru_cache(maxsize=64)
def load(source: str, kinds: tuple[str, ...]) -> Block:
    """The function `block` that the source defines, compiled now or taken from disk.

    kinds: of its arguments, each of `NUMBERS`, or a type of numbers followed by * for an array, which arrives as a
    pointer: `carray` gives it a shape. It must not allocate. Where the folder cannot be used, or what it holds is
    damaged, the function is compiled.
    """
    name = hashlib.sha256("\n".join((_machine(), *kinds, source)).encode()).hexdigest()[:32]
    path = None if (kernels := folder()) is None else kernels / f"{name}.kernel"
    if (
        path is not None
        and (kept := _read(path)) is not None
        and (block := _linked(kept, kinds)) is not None
    ):
        return block
    compiled, text = _compiled(source, kinds)
    if path is not None:
        _keep(path, compiled)
    block = _linked(compiled, kinds)
    assert block is not None
    return block._replace(text=text)


def _address(array: Any, kind: np.dtype[Any]) -> int:
    if array.dtype != kind or not array.flags.c_contiguous:
        raise TypeError(
            f"expected a contiguous array of {kind}, found one of {array.dtype} with strides {array.strides}"
        )
    return int(array.ctypes.data)


def _machine() -> str:
    """What machine code depends on besides its source."""
    from importlib.metadata import version

    from llvmlite import binding

    versions = " ".join(f"{name} {version(name)}" for name in ("casadi", "numba", "llvmlite"))
    return f"undeadzone {undeadzone.__version__} {versions} {binding.get_host_cpu_name()} {binding.get_host_cpu_features().flatten()}"


def _read(path: Path) -> Compiled | None:
    """What a file holds, if it is whole."""
    try:
        digest, _, rest = path.read_bytes().partition(b"\n")
    except OSError:
        return None
    calls, _, code = rest.partition(b"\n")
    return Compiled(calls.decode().split(), code) if digest == _digest(rest) else None


def _keep(path: Path, compiled: Compiled) -> None:
    """Write a file, where that is possible: a digest of what follows, the names of C functions, machine code."""
    rest = " ".join(compiled.calls).encode() + b"\n" + compiled.code
    try:
        with replacing(path) as temporary:
            temporary.write_bytes(_digest(rest) + b"\n" + rest)
    except (OSError, FileError):
        pass


def _digest(content: bytes) -> bytes:
    return hashlib.sha256(content).hexdigest().encode()


def _compiled(source: str, kinds: tuple[str, ...]) -> tuple[Compiled, str]:
    """The machine code of `block` as a C function of that name, and LLVM's text of it."""
    from llvmlite import binding
    from numba import cfunc

    namespace: dict[str, Any] = {"__name__": "kernel"}
    exec(compile(source, "<kernel>", "exec"), namespace)
    arguments = ", ".join(
        f"CPointer({kind[:-1]})" if kind.endswith("*") else kind for kind in kinds
    )
    made = cfunc(f"void({arguments})", error_model="numpy")(namespace["block"])
    module, target = binding.parse_assembly(made.inspect_llvm()), _target()
    for part in (*module.functions, *module.global_variables):
        if part.name == made.native_name:
            part.name = "block"
        elif not part.is_declaration:
            part.linkage = "internal"
    passes = (
        binding.create_new_module_pass_manager()
    )  # nothing raises: what would report it to Python goes
    passes.add_ipsccp_pass()
    passes.add_simplify_cfg_pass()
    passes.add_global_dead_code_eliminate_pass()
    passes.run(
        module, binding.create_pass_builder(target, binding.create_pipeline_tuning_options(0))
    )
    declared = [
        part.name for part in (*module.functions, *module.global_variables) if part.is_declaration
    ]
    intrinsic = {
        name.split(".")[1] for name in declared if name.startswith("llvm.")
    }  # such as llvm.sin.v8f64, which may become a call of sin
    calls = {name for name in declared if not name.startswith("llvm.")} | {
        name for name in intrinsic if hasattr(_library(), name)
    }
    return Compiled(sorted(calls), target.emit_object(module)), str(module)


def _library() -> ctypes.CDLL:
    """The C library of this process."""
    return ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None)


def _target() -> Any:
    """A compiler for this processor, of the same settings as numba's."""
    from llvmlite import binding

    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    target = binding.Target.from_triple(binding.get_process_triple())
    cpu, features = binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten()
    reloc = "static" if target.name.startswith("x86") else "default"
    return target.create_target_machine(
        cpu=cpu, features=features, opt=3, reloc=reloc, codemodel="jitdefault", jit=True
    )


def _linked(compiled: Compiled, kinds: tuple[str, ...]) -> Block | None:
    """Machine code ready to be called; None if something that it calls is missing from this process, at which LLVM would abort.

    It calls the C library itself whether numba is there or not, which puts functions of its own, with other NaNs, in its place.
    """
    from llvmlite import binding

    library, names = (
        _library(),
        binding.parse_assembly("\n".join(f"declare void @{name}()" for name in compiled.calls)),
    )
    engine = binding.create_mcjit_compiler(names, _target())
    for name in compiled.calls:
        if (found := getattr(library, name, None)) is not None:
            engine.add_global_mapping(
                names.get_function(name), ctypes.cast(found, ctypes.c_void_p).value
            )
        elif binding.address_of_symbol(name) is None:
            return None
    engine.add_object_file(binding.ObjectFileRef.from_data(compiled.code))
    engine.finalize_object()
    prototype = ctypes.CFUNCTYPE(None, *(NUMBERS.get(kind, ctypes.c_void_p) for kind in kinds))
    arrays = tuple(None if kind in NUMBERS else np.dtype(kind[:-1]) for kind in kinds)
    return Block(prototype(engine.get_function_address("block")), arrays, engine, "")
