"""MuJoCo: the arm read from its URDF, contacts and joint limits off, the same integrators.

mj_step from Python, or the threaded rollout.
"""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
from mujoco import rollout

from benchmarks.engine.work.arm_moves import Work
from undeadzone.util.arrays import Floats

INTEGRATORS = {"euler": mujoco.mjtIntegrator.mjINT_EULER, "rk4": mujoco.mjtIntegrator.mjINT_RK4}


def prepare(work: Work, *, rolled: bool = False, threads: int = 1) -> Callable[[], Floats]:
    """The work made ready.

    Args:
        work: what is done
        rolled: by `mujoco.rollout`, which keeps every state; else a call of mj_step per step
        threads: of the rollout
    """
    model = mujoco.MjModel.from_xml_path(str(work.path))
    model.opt.timestep, model.opt.integrator = work.step, INTEGRATORS[work.move]
    bits = mujoco.mjtDisableBit
    model.opt.disableflags |= bits.mjDSBL_CONSTRAINT | bits.mjDSBL_CONTACT
    runs, N = work.torques.shape
    data = [mujoco.MjData(model) for _ in range(threads)]

    def stepped() -> Floats:
        finals, one = np.empty((runs, 2 * N)), data[0]
        for k, (state, torque) in enumerate(zip(work.states, work.torques, strict=True)):
            mujoco.mj_resetData(model, one)
            one.qpos, one.qvel, one.qfrc_applied = state[:N], state[N:], torque
            for _ in range(work.steps):
                mujoco.mj_step(model, one)
            finals[k] = np.concatenate([one.qpos, one.qvel])
        return finals

    starts = np.column_stack([np.zeros(runs), work.states])  # MuJoCo's state: time, q, v
    trajectories = np.empty((runs, work.steps, starts.shape[1]))
    applied = {
        "control": work.torques[:, None],
        "control_spec": int(mujoco.mjtState.mjSTATE_QFRC_APPLIED),
    }

    def rolling() -> Floats:
        states, _ = rollout.rollout(
            model,
            data,
            starts,
            nstep=work.steps,
            state=trajectories,
            persistent_pool=True,
            **applied,
        )
        return states[:, -1, 1:].copy()

    return rolling if rolled else stepped
