"""`--to python`: a module that compiles the exported C and calls it, without undeadzone."""

from __future__ import annotations

from typing import Any, Final

from undeadzone.exports.code import Code
from undeadzone.exports.fields import Field
from undeadzone.support.text import one_line

_HEAD: Final = '''"""{title}: {part}, by one sample after the other.

Written by undeadzone {version}; do not edit. Needs a C compiler at the first use, and no package.

    import {name}

    instance = {name}.Instance()
    out = instance.update({arguments})    # every {step:g} s

Inputs:{inputs}.
Outputs:{outputs}.
A reading that is NaN is missing. `step` does the same on `instance.inputs` and `instance.out`,
which are structs of C whose arrays NumPy takes as they are: numpy.asarray(instance.out.z).
"""

import ctypes
import os
import platform
import shutil
import subprocess
import tempfile
from collections import namedtuple

NAME = {name!r}
HASH = {hash!r}
STEP = {step!r}  # sample time [s]
REAL = ctypes.{real}
STATE = {state!r}
INPUTS = {inputs_of!r}
OUTPUTS = {outputs_of!r}
PARAMS = {params_of!r}
'''

_BODY: Final = '''

def _struct(name, fields):
    arrays = [(key, REAL * size) for key, size in fields]
    return type(name, (ctypes.Structure,), {"_fields_": arrays})


State = _struct("State", STATE)
Inputs = _struct("Inputs", INPUTS)
Outputs = _struct("Outputs", OUTPUTS)
Params = _struct("Params", PARAMS)
Out = namedtuple("Out", [name for name, _ in OUTPUTS])


def _library():
    """The C, compiled beside this module unless it was before."""
    folder = os.path.dirname(os.path.abspath(__file__))
    ending = {"Windows": ".dll", "Darwin": ".dylib"}.get(platform.system(), ".so")
    path = os.path.join(folder, f"{NAME}-{HASH}-{platform.machine()}{ending}")
    if not os.path.exists(path):
        _compile(folder, path)
    return ctypes.PyDLL(path)


def _compile(folder, path):
    names = [os.environ.get("CC", ""), "cc", "gcc", "clang"]
    command = next((name for name in names if name and shutil.which(name)), None)
    if command is None:
        raise RuntimeError(f"{NAME}: no C compiler: expected cc, gcc or clang in PATH, or $CC")
    with tempfile.TemporaryDirectory(dir=folder) as fresh:
        made = os.path.join(fresh, "made")
        options = ["-O2", "-std=c99", "-ffp-contract=off", "-fno-math-errno", "-fPIC", "-shared"]
        source = os.path.join(folder, f"{NAME}.c")
        line = [command, *options, "-o", made, source, "-lm"]
        done = subprocess.run(line, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(f"{NAME}: {command} refuses {source}: {done.stderr.strip()[:500]}")
        os.replace(made, path)


_c = _library()
_init = getattr(_c, f"{NAME}_init")
_step = getattr(_c, f"{NAME}_step")
_init.restype = _step.restype = None


class Instance:
    """One observer with its memory; any number of them run side by side.

    Attributes:
        state, inputs, out, params: the structs of the C; change inputs and params only.
    """

    def __init__(self):
        self.state, self.inputs, self.out, self.params = State(), Inputs(), Outputs(), Params()
        structs = [self.state, self.params, self.inputs, self.out]
        if PARAMS:
            default = getattr(_c, f"{NAME}_params_default")
            default.restype = None
            default(ctypes.byref(self.params))
        else:
            del structs[1]
        self._arguments = tuple(ctypes.c_void_p(ctypes.addressof(struct)) for struct in structs)
        self.reset()

    def reset(self):
        """Start anew."""
        _init(self._arguments[0])

    def step(self):
        """One sample: from `inputs` to `out`."""
        _step(*self._arguments)

    def update(self, ARGUMENTS):
        """One sample; each argument is a number or a sequence of them.

        Returns:
            An Out: tuples of numbers.
        """
        for (name, size), value in zip(INPUTS, (ARGUMENTS,)):
            numbers = tuple(value) if hasattr(value, "__len__") else (value,)
            if len(numbers) != size:
                raise ValueError(f"{name}: expected {size} numbers, found {len(numbers)}")
            getattr(self.inputs, name)[:] = numbers
        self.step()
        return Out(*[tuple(getattr(self.out, name)) for name, _ in OUTPUTS])
'''


def module(printed: Code, report: dict[str, Any]) -> str:
    """The text of the module.

    Args:
        printed: what is printed as C.
        report: what the manifest holds.
    """
    step = printed.step
    state = _sizes(step.state)
    if printed.phases is not None and printed.phases.carried:
        state.append(("carry", printed.phases.carried))
    arguments = ", ".join(field.name for field in step.inputs)
    head = _HEAD.format(
        **{key: report[key] for key in ("name", "hash", "version", "part", "step")},
        title=_plain(report["title"]),
        arguments=arguments,
        inputs=_listed(step.inputs),
        outputs=_listed(step.outputs),
        real="c_float" if printed.single else "c_double",
        state=state,
        inputs_of=_sizes(step.inputs),
        outputs_of=_sizes(step.outputs),
        params_of=_sizes(step.params),
    )
    return head + _BODY.replace("ARGUMENTS", arguments)


def _sizes(fields: list[Field]) -> list[tuple[str, int]]:
    """Names and sizes of the arrays of a struct."""
    return [(field.name, field.size) for field in fields]


def _listed(fields: list[Field]) -> str:
    """Fields in words, a line each."""
    return "".join(
        f"\n    {field.name} ({field.size}): {_plain(field.meaning)}" for field in fields
    )


def _plain(text: str) -> str:
    """A text that ends no docstring."""
    return one_line(text).replace("\\", "/").replace('"', "'")
