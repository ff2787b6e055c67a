"""Pinocchio: its ABA called from Python, or a loop over it in C++ (pinocchio_arm.cpp).

The loop is compiled for this CPU when first asked for.
"""

from __future__ import annotations

import ctypes
import functools
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

from benchmarks.engine.work.arm_moves import MOVES, Work
from undeadzone.numerics.runge_kutta import rk4
from undeadzone.util.arrays import Floats

SOURCE = Path(__file__).with_name("pinocchio_arm.cpp")
EIGEN = Path(ca.__file__).with_name("include") / "eigen3"  # comes with CasADi
HEADERS = (Path(pin.__file__).parents[4] / "include", EIGEN)
FLAGS = ("-std=c++17", "-O3", "-march=native", "-DNDEBUG", "-fopenmp", "-shared", "-fPIC", "-w")
BOOST = (  # Pinocchio's own
    "-DBOOST_MPL_LIMIT_LIST_SIZE=30",
    "-DBOOST_MPL_LIMIT_VECTOR_SIZE=30",
    "-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS",
    "-DBOOST_FUSION_INVOKE_MAX_ARITY=12",
)

AXES = ("JointModelRX", "JointModelRY", "JointModelRZ")


def prepare(work: Work) -> Callable[[], Floats]:
    """A loop in Python: a call per evaluation of the dynamics, NumPy for the rest."""
    model = pin.buildModelFromUrdf(str(work.path))
    data, N, h = model.createData(), model.nv, work.step
    k_p, k_d = work.gains

    def rate(x: Floats, u: Floats) -> Floats:
        return np.concatenate([x[N:], pin.aba(model, data, x[:N], x[N:], u)])

    def runge_kutta(x: Floats, u: Floats, target: Floats) -> Floats:
        return rk4(lambda x, _: rate(x, u), x, h)

    def follow(x: Floats, u: Floats, target: Floats) -> Floats:
        q, v, a = target
        acceleration = a + k_p * (q - x[:N]) + k_d * (v - x[N:])
        torque = pin.rnea(model, data, x[:N], x[N:], acceleration)
        return rk4(lambda x, _: rate(x, torque), x, h)

    def euler(x: Floats, u: Floats, target: Floats) -> Floats:
        v = x[N:] + h * pin.aba(model, data, x[:N], x[N:], u)
        return np.concatenate([x[:N] + h * v, v])

    move = {"euler": euler, "rk4": runge_kutta, "follow": follow}[work.move]

    def run() -> Floats:
        finals = work.states.copy()
        for x, u in zip(finals, work.torques, strict=True):
            state = x
            for target in work.targets:
                state = move(state, u, target)
            x[:] = state
        return finals

    return run


def calls(work: Work) -> Callable[[], None]:
    """The calls of pin.aba alone, one per step."""
    model = pin.buildModelFromUrdf(str(work.path))
    data, aba = model.createData(), pin.aba
    (q, v), u = np.split(work.states[0], 2), work.torques[0]

    def run() -> None:
        for _ in range(work.steps):
            aba(model, data, q, v, u)

    return run


def compiled_loop(work: Work, *, threads: int = 1) -> Callable[[], Floats]:
    """The loop in C++. Raises ImportError with the compiler's message where it fails."""
    model = pin.buildModelFromUrdf(str(work.path))
    rows = np.array([_row(model, i) for i in range(1, model.njoints)])
    gravity, gains = model.gravity.linear.copy(), np.array(work.gains)
    library = _compiled(model.nv)

    def run() -> Floats:
        finals = work.states.copy()
        arrays = (rows, gravity, work.targets, gains, finals, work.torques)
        pointers = (ctypes.c_void_p(array.ctypes.data) for array in arrays)
        joints, g, targets, k, states, torques = pointers
        runs, steps = ctypes.c_long(len(finals)), ctypes.c_long(work.steps)
        library.run(
            joints,
            g,
            MOVES.index(work.move),
            ctypes.c_double(work.step),
            steps,
            targets,
            k,
            runs,
            states,
            torques,
            threads,
        )
        return finals

    return run


def _row(model: Any, i: int) -> Floats:
    """A joint as the C++ loop takes it: axis, placement, mass, centre, inertia.

    Raises ImportError for a joint that it does not know.
    """
    kind = model.joints[i].shortname()
    if kind not in AXES:
        raise ImportError(f"the C++ loop has no {kind}")
    place, body = model.jointPlacements[i], model.inertias[i]
    placement = (place.rotation.ravel(), place.translation)
    inertia = body.inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    return np.concatenate([[AXES.index(kind)], *placement, [body.mass], body.lever, inertia])


@functools.cache
def _compiled(N: int) -> ctypes.CDLL:
    """The library for N joints."""
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder, "arm.so")
        includes = (f"-I{path}" for path in HEADERS)
        try:
            subprocess.run(
                ["g++", *FLAGS, *BOOST, *includes, f"-DDOF={N}", str(SOURCE), "-o", str(library)],
                check=True,
                capture_output=True,
                text=True,
            )
        except FileNotFoundError:
            raise ImportError("g++ not found") from None
        except subprocess.CalledProcessError as failed:
            errors = [line for line in failed.stderr.splitlines() if "error" in line]
            message = errors[0] if errors else failed.stderr
            raise ImportError(f"g++: {message.partition('error: ')[2] or message:.80}") from failed
        return ctypes.CDLL(str(library))
