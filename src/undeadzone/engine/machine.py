"""The processor at hand: what its vectors hold, and code for it."""

from __future__ import annotations

import functools
import sys
from typing import Any, Final, NamedTuple

from undeadzone.engine.forms import LARGE, Form

SMALL_STACK: Final = 2**20
LARGE_STACK: Final = 2**23


class Machine(NamedTuple):
    """What machine code is made for.

    Attributes:
        triple: LLVM's name of processor and system.
        processor: LLVM's name.
        features: LLVM's list.
    """

    triple: str
    processor: str
    features: str

    @property
    def vector(self) -> tuple[int, int]:
        """Lanes of a vector, and how many vectors registers hold."""
        features = self.features.split(",")
        if "+avx512f" in features:
            return 8, 32
        if "+avx2" in features and "+fma" in features:
            return 4, 16
        return (2, 32) if self.triple.startswith(("aarch64", "arm64")) else (2, 16)

    def form(self, instructions: int, width: int) -> Form:
        """The form of a kernel of so many instructions of a lane, for blocks of so many lanes."""
        lanes, registers = self.vector
        if instructions > LARGE or registers < 32 or width < 2 * lanes:
            return Form(lanes, 1, lanes == 8, 0, 300)
        return Form(lanes, 2, lanes == 8, 20)

    def target(self, effort: int = 3) -> Any:
        """A compiler for it, of LLVM's effort 0 to 3."""
        from llvmlite import binding

        _initialized()
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


@functools.cache
def here() -> Machine:
    """This one."""
    from llvmlite import binding

    _initialized()
    features = binding.get_host_cpu_features().flatten()
    return Machine(binding.get_process_triple(), binding.get_host_cpu_name(), features)


@functools.cache
def _initialized() -> None:
    """Tell LLVM to use what it has for this processor."""
    from llvmlite import binding

    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    binding.initialize_native_asmparser()


def stack() -> int:
    """The bytes of a thread's stack, or fewer."""
    if sys.platform == "win32":
        return SMALL_STACK
    import resource

    limit = resource.getrlimit(resource.RLIMIT_STACK)[0]
    return LARGE_STACK if limit == resource.RLIM_INFINITY else min(limit, LARGE_STACK)
