"""Pinocchio: its ABA called from Python, or a loop over it in C++ (pinocchio_arm.cpp), compiled for this CPU when first asked for."""

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

from benchmarks.arm_work import MOVES, Work
from undeadzone.numerics.runge_kutta import rk4
from undeadzone.support.arrays import Floats

SOURCE = Path(__file__).with_name("pinocchio_arm.cpp")
HEADERS = (
    Path(pin.__file__).parents[4] / "include",
    Path(ca.__file__).with_name("include") / "eigen3",
)  # CasADi brings Eigen's
FLAGS = ("-std=c++17", "-O3", "-march=native", "-DNDEBUG", "-fopenmp", "-shared", "-fPIC", "-w")
SIZES = ("LIST_SIZE=30", "VECTOR_SIZE=30")
BOOST = (
    *(f"-DBOOST_MPL_LIMIT_{size}" for size in SIZES),
    "-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS",
    "-DBOOST_FUSION_INVOKE_MAX_ARITY=12",
)  # Pinocchio's own


def prepare(work: Work) -> Callable[[], Floats]:
    """A loop in Python: a call per evaluation of the dynamics, NumPy for the rest."""
    model = pin.buildModelFromUrdf(str(work.path))
    data, N, h = model.createData(), model.nv, work.step
    k_p, k_d = work.gains

    def rate(x: Floats, u: Floats) -> Floats:
        return np.concatenate([x[N:], pin.aba(model, data, x[:N], x[N:], u)])

    def follow(x: Floats, u: Floats, target: Floats) -> Floats:
        q, v, a = target
        held = pin.rnea(model, data, x[:N], x[N:], a + k_p * (q - x[:N]) + k_d * (v - x[N:]))
        return rk4(lambda x, _: rate(x, held), x, h)

    def euler(x: Floats, u: Floats, target: Floats) -> Floats:
        v = x[N:] + h * pin.aba(model, data, x[:N], x[N:], u)
        return np.concatenate([x[:N] + h * v, v])

    move = {
        "euler": euler,
        "rk4": lambda x, u, target: rk4(lambda x, _: rate(x, u), x, h),
        "follow": follow,
    }[work.move]

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
    """The loop in C++. Raises ImportError with the compiler's message where it cannot be compiled."""
    model = pin.buildModelFromUrdf(str(work.path))
    rows = np.array([_row(model, i) for i in range(1, model.njoints)])
    gravity, gains = model.gravity.linear.copy(), np.array(work.gains)
    library = _compiled(model.nv)

    def run() -> Floats:
        finals = work.states.copy()
        joints, g, targets, k, states, torques = (
            ctypes.c_void_p(array.ctypes.data)
            for array in (rows, gravity, work.targets, gains, finals, work.torques)
        )
        runs, steps = (ctypes.c_long(count) for count in (len(finals), work.steps))
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
    """A joint as the C++ loop takes it: axis, placement, mass, centre, inertia. Raises ImportError for a joint that it does not know."""
    kind = model.joints[i].shortname()
    if kind not in (known := ["JointModelRX", "JointModelRY", "JointModelRZ"]):
        raise ImportError(f"the C++ loop has no {kind}")
    place, body = model.jointPlacements[i], model.inertias[i]
    inertia = body.inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    return np.concatenate(
        [
            [known.index(kind)],
            place.rotation.ravel(),
            place.translation,
            [body.mass],
            body.lever,
            inertia,
        ]
    )


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
            message = next(
                (line for line in failed.stderr.splitlines() if "error" in line), failed.stderr
            )
            raise ImportError(f"g++: {message.partition('error: ')[2] or message:.80}") from failed
        return ctypes.CDLL(str(library))
