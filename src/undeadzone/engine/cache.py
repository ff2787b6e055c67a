"""Kernels compiled once per machine: machine code in a file named by the hash of all that it depends on.

A kernel is read back and called without numba, whose import and bookkeeping take longer than most runs.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import os
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np

from undeadzone.errors import FileError
from undeadzone.files import replacing

NUMBERS: Final[dict[str, Any]] = {"int64": ctypes.c_int64, "uint64": ctypes.c_uint64, "float64": ctypes.c_double}


class Label(msgspec.Struct, frozen=True):
    """The first line of a file; needs: the C functions that the machine code after it calls by name; digest: of that code."""

    needs: list[str]
    digest: str


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
        self.function(*(value if kind is None else _address(value, kind) for value, kind in zip(given, self.arrays, strict=True)))


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
    if path is not None and (kept := _read(path)) is not None and (block := _linked(*kept, kinds)) is not None:
        return block
    label, code, text = _compiled(source, kinds)
    if path is not None:
        _keep(path, label, code)
    block = _linked(label, code, kinds)
    assert block is not None
    return block._replace(text=text)


def _address(array: Any, kind: np.dtype[Any]) -> int:
    if array.dtype != kind or not array.flags.c_contiguous:
        raise TypeError(f"expected a contiguous array of {kind}, found one of {array.dtype} with strides {array.strides}")
    return int(array.ctypes.data)


def _machine() -> str:
    """What machine code depends on besides its source."""
    from importlib.metadata import version

    from llvmlite import binding

    versions = " ".join(f"{name} {version(name)}" for name in ("casadi", "numba", "llvmlite"))
    return f"{versions} {binding.get_host_cpu_name()} {binding.get_host_cpu_features().flatten()}"


def _read(path: Path) -> tuple[Label, bytes] | None:
    """What a file holds, if it is whole."""
    try:
        head, _, code = path.read_bytes().partition(b"\n")
        label = msgspec.json.decode(head, type=Label)
    except (OSError, msgspec.DecodeError):
        return None
    return (label, code) if hashlib.sha256(code).hexdigest() == label.digest else None


def _keep(path: Path, label: Label, code: bytes) -> None:
    """Write a file, where that is possible."""
    try:
        with replacing(path) as temporary:
            temporary.write_bytes(msgspec.json.encode(label) + b"\n" + code)
    except (OSError, FileError):
        pass


def _compiled(source: str, kinds: tuple[str, ...]) -> tuple[Label, bytes, str]:
    """The machine code of `block` as a C function of that name, and LLVM's text of it."""
    from llvmlite import binding
    from numba import cfunc

    namespace: dict[str, Any] = {"__name__": "kernel"}
    exec(compile(source, "<kernel>", "exec"), namespace)
    arguments = ", ".join(f"CPointer({kind[:-1]})" if kind.endswith("*") else kind for kind in kinds)
    made = cfunc(f"void({arguments})", error_model="numpy")(namespace["block"])
    module, target = binding.parse_assembly(made.inspect_llvm()), _target()
    for part in (*module.functions, *module.global_variables):
        if part.name == made.native_name:
            part.name = "block"
        elif not part.is_declaration:
            part.linkage = "internal"
    passes = binding.create_new_module_pass_manager()  # nothing raises: what would report it to Python goes
    passes.add_ipsccp_pass()
    passes.add_simplify_cfg_pass()
    passes.add_global_dead_code_eliminate_pass()
    passes.run(module, binding.create_pass_builder(target, binding.create_pipeline_tuning_options(0)))
    needs = [part.name for part in (*module.functions, *module.global_variables) if part.is_declaration and not part.name.startswith("llvm.")]
    code = target.emit_object(module)
    return Label(needs, hashlib.sha256(code).hexdigest()), code, str(module)


def _target() -> Any:
    """A compiler for this processor, of the same settings as numba's."""
    from llvmlite import binding

    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    target = binding.Target.from_triple(binding.get_process_triple())
    cpu, features = binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten()
    reloc = "static" if target.name.startswith("x86") else "default"
    return target.create_target_machine(cpu=cpu, features=features, opt=3, reloc=reloc, codemodel="jitdefault", jit=True)


def _linked(label: Label, code: bytes, kinds: tuple[str, ...]) -> Block | None:
    """Machine code ready to be called; None if something that it needs is missing from this process, at which LLVM would abort."""
    from llvmlite import binding

    engine = binding.create_mcjit_compiler(binding.parse_assembly(""), _target())
    if None in map(binding.address_of_symbol, label.needs):
        return None
    engine.add_object_file(binding.ObjectFileRef.from_data(code))
    engine.finalize_object()
    prototype = ctypes.CFUNCTYPE(None, *(NUMBERS.get(kind, ctypes.c_void_p) for kind in kinds))
    arrays = tuple(None if kind in NUMBERS else np.dtype(kind[:-1]) for kind in kinds)
    return Block(prototype(engine.get_function_address("block")), arrays, engine, "")
