"""Host processor and its lanes, and LLVM text compiled and linked for it."""

from __future__ import annotations

import ctypes
import functools
import os
import sys
from typing import Any, Final, NamedTuple

import numpy as np

from undeadzone.errors import InputError

# Instructions of a step beyond which groups go alone, and beyond which registers are not counted.
PAIRED: Final = 350
LARGE: Final = 700
WHOLE: Final = 12  # functions that would compile no sooner than all of a step as one
SMALL_STACK: Final = 2**20
LARGE_STACK: Final = 2**23


class Shape(NamedTuple):
    """Sizes of a kernel, for which it is compiled.

    Attributes:
        sizes: of s, w and p.
        exogenous, params: entries of w and p that each lane has for itself.
        record: outputs that are kept.
    """

    sizes: tuple[int, int, int]
    exogenous: tuple[int, ...]
    params: tuple[int, ...]
    record: tuple[int, ...]


class Form(NamedTuple):
    """Arrangement of a kernel's lanes, which changes no bit.

    Attributes:
        lanes: of a vector (1 for plain numbers).
        streams: groups side by side, so that one works while the other waits.
        slots: each use of a shared number has an entry of a table for itself, which becomes an
            operand of its instruction (AVX-512).
        registers: numbers of a group that may wait for their use (0 for each instruction right
            behind its operands).
        branches: instructions of one condition that are worth a branch, of groups that go alone (0
            for no branches).
        piece: instructions of a function, if a group goes alone through a step of more than `WHOLE`
            of them.
    """

    lanes: int
    streams: int
    slots: bool
    registers: int
    branches: int = 0
    piece: int = 5000

    def is_cut(self, instructions: int) -> bool:
        """Return whether a step of the given number of instructions is split into
        functions.
        """
        return self.streams == 1 and instructions > WHOLE * self.piece


FIXED: Final = "UNDEADZONE_FORM"  # set: the form of every kernel of more than one lane
ONE: Final = Form(1, 1, False, 0, 60)  # for a single run


class Machine(NamedTuple):
    """Target of machine code.

    Attributes:
        triple: LLVM's name of processor and system.
        processor: LLVM's name.
        features: LLVM's list.
    """

    triple: str
    processor: str
    features: str

    @property
    def vector_shape(self) -> tuple[int, int]:
        """Return the lanes of a vector and the number of vectors that the registers hold."""
        features = self.features.split(",")
        if "+avx512f" in features:
            return 8, 32
        if "+avx2" in features and "+fma" in features:
            return 4, 16
        return (2, 32) if self.triple.startswith(("aarch64", "arm64")) else (2, 16)

    def choose_form(self, instructions: int, width: int) -> Form:
        """Return the form of a kernel with the given instructions per lane, for blocks of
        `width` lanes.
        """
        lanes, registers = self.vector_shape
        slots = lanes == 8
        if instructions <= PAIRED and width >= 2 * lanes and lanes * registers > 32:
            return Form(lanes, 2, slots, 20 if registers == 32 else 12)
        if registers < 32 or instructions > LARGE:
            return Form(lanes, 1, slots, 0, 300)
        return Form(lanes, 1, slots, 26)

    def alternative_forms(self, form: Form) -> list[Form]:
        """Return the forms that a long run compares with the assumed form."""
        slots = form.lanes == 8
        usual = (2, slots, 20), (2, False, 12), (2, False, 0), (1, slots, 26)
        forms = [Form(form.lanes, *each) for each in usual]
        return [other for other in forms if other != form]

    def build_target(self, effort: int = 3) -> Any:
        """Return an LLVM target machine with optimisation effort 0 to 3."""
        from llvmlite import binding

        _initialise_llvm()
        found = binding.Target.from_triple(self.triple)
        reloc = "static" if found.name.startswith("x86") else "default"
        return found.create_target_machine(
            cpu=self.processor,
            features=self.features,
            opt=effort,
            reloc=reloc,
            codemodel="jitdefault",
            jit=True,
        )


def environment_form() -> Form | None:
    """Return the form that the environment fixes, such as 8,2,0,20, or None if it is not set.

    The numbers are lanes, streams, slots and registers.

    Raises:
        InputError: `FIXED` is set to something else.
    """
    text = os.environ.get(FIXED, "")
    if not text:
        return None
    words = text.split(",")
    numbers = [int(word) for word in words if word.strip().isdecimal()]
    are_all = len(words) == len(numbers) and len(numbers) in (4, 5)
    if not are_all or numbers[0] not in (1, 2, 4, 8) or numbers[2] > 1:
        raise InputError(
            f"{FIXED}: expected lanes (1, 2, 4 or 8), streams, slots (0 or 1) and registers, such "
            f"as 8,2,0,20, found {text!r}"
        )
    lanes, streams, slots, *rest = numbers
    return Form(lanes, max(streams, 1), bool(slots), *rest)


@functools.cache
def host_machine() -> Machine:
    """Return the processor of this process."""
    from llvmlite import binding

    _initialise_llvm()
    features = binding.get_host_cpu_features().flatten()
    return Machine(binding.get_process_triple(), binding.get_host_cpu_name(), features)


@functools.cache
def _initialise_llvm() -> None:
    """Initialise LLVM for the processor of this process."""
    from llvmlite import binding

    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    binding.initialize_native_asmparser()


def stack() -> int:
    """Return a lower bound of the stack size of a thread [bytes]."""
    if sys.platform == "win32":
        return SMALL_STACK
    import resource

    limit = resource.getrlimit(resource.RLIMIT_STACK)[0]
    return LARGE_STACK if limit == resource.RLIM_INFINITY else min(limit, LARGE_STACK)


MOST: Final = 3  # effort


class MachineCode(NamedTuple):
    """Machine code that is not linked yet.

    Attributes:
        calls: the C functions that it may call.
        code: the machine code.
    """

    calls: list[str]
    code: bytes


class LinkedCode(NamedTuple):
    """Machine code that can be called.

    Attributes:
        function: takes numbers and addresses.
        engine: owns the machine code.
    """

    function: Any
    engine: Any


def compile_text(text: str, effort: int = MOST) -> MachineCode:
    """Compile a module with LLVM's effort 0 (four times sooner, half as fast) to 3, and return
    machine code.
    """
    from llvmlite import binding

    target = host_machine().build_target(effort)
    module = binding.parse_assembly(text)
    declared = [part.name for part in module.functions if part.is_declaration]
    return MachineCode(_callable_names(declared), target.emit_object(module))


def link_block(machine_code: MachineCode, kinds: tuple[str, ...]) -> LinkedCode | None:
    """Link machine code in this process and return its function `block`.

    Args:
        machine_code: compiled code of a module.
        kinds: types of the arguments, as for `cache.load_block`.

    Returns:
        The callable function. None if this process lacks a function that the code calls: LLVM
        would abort the process.
    """
    from llvmlite import binding

    library = _c_library()
    declarations = "\n".join(f"declare void @{name}()" for name in machine_code.calls)
    declared = binding.parse_assembly(declarations)
    engine = binding.create_mcjit_compiler(declared, host_machine().build_target())
    for name in machine_code.calls:
        callee = getattr(library, name, None)
        if callee is not None:
            address = ctypes.cast(callee, ctypes.c_void_p).value
            engine.add_global_mapping(declared.get_function(name), address)
        elif binding.address_of_symbol(name) is None:
            return None
    engine.add_object_file(binding.ObjectFileRef.from_data(machine_code.code))
    engine.finalize_object()
    prototype = ctypes.CFUNCTYPE(None, *map(_c_type, kinds))
    return LinkedCode(prototype(engine.get_function_address("block")), engine)


def _c_type(kind: str) -> Any:
    """Return the C type of an argument: a number, or a pointer for an array."""
    return ctypes.c_void_p if kind.endswith("*") else np.ctypeslib.as_ctypes_type(np.dtype(kind))


def _callable_names(declared: list[str]) -> list[str]:
    """Return the names of the C functions that may be called, from the names that LLVM
    declares.

    An intrinsic function such as llvm.floor.v2f64 may become a call of floor.
    """
    library = _c_library()
    calls = set()
    for name in declared:
        if not name.startswith("llvm."):
            calls.add(name)
        elif hasattr(library, name.split(".")[1]):
            calls.add(name.split(".")[1])
    return sorted(calls)


def _c_library() -> ctypes.CDLL:
    """Return the C library of this process."""
    return ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None)
