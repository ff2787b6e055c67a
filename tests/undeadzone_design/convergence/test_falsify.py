"""The falsifier never breaks what is certified, and breaks what is not; its reports replay."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.design.random_designs import random_design, random_matrices
from scipy.linalg import expm

from further import further
from scenes import PAPER_PLANT, random_plant, scene
from undeadzone.analysis.certificate.passivity import certify, passive_gain
from undeadzone.analysis.error_dynamics import branch_pattern, build_error_dynamics
from undeadzone.errors import InputError
from undeadzone.linalg.hold import zoh
from undeadzone.linalg.matrices import Matrices
from undeadzone.numerics.runge_kutta import rk4
from undeadzone.simulation.simulate import simulate
from undeadzone.util.arrays import Floats
from undeadzone_design.convergence.falsify import (
    Cycle,
    SwitchMode,
    diverge,
    error_generator,
    falsify,
)

PAPER = PAPER_PLANT.linear


def column(*L: float) -> Floats:
    return np.array(L)[:, None]


@pytest.mark.parametrize("block", [0, *further(1, 2)])
def test_sixty_certified_designs_are_never_broken(block: int) -> None:
    """n = 1..8, 1-3 outputs, continuous and sampled, Gamma per edge or full: V never rises."""
    for k in range(20 * block, 20 * block + 20):
        rng = np.random.default_rng([7, k])
        n = 1 + k % 8
        found = certify(*random_design(rng, n, min(n, 1 + int(rng.integers(3)))))
        assert found.certified, found.reason
        attack = falsify(found.dynamics, found.V, 2000, 30, seed=k, library=60)
        assert not attack.broken
        assert attack.rise < 1e-12


@pytest.mark.parametrize("Ts", [None, 0.01])
def test_the_papers_gains_are_broken(Ts: float | None) -> None:
    """(12, 15), gamma = 2 has no V, so that the best one rises.

    That is not divergence, and none is found.
    """
    found = certify(PAPER if Ts is None else zoh(PAPER, Ts), column(12, 15), np.array([2.0]), Ts)
    attack = falsify(found.dynamics, found.V, 5000)
    assert attack.broken
    assert attack.rise > 1e-4
    assert diverge(found.dynamics).factor <= 1 + 1e-9
    grown = error_generator(found.dynamics, attack.mode)
    if Ts is None:
        passage = expm(grown * attack.mode.seconds)
    else:
        passage = np.linalg.matrix_power(np.eye(4) + Ts * grown, round(attack.mode.seconds / Ts))
    errors = np.stack([attack.start, passage @ attack.start])
    before, later = found.V.evaluate_storage(errors[:, :2], errors[:, 2:])
    assert later / before - 1 == pytest.approx(attack.rise, rel=1e-6)


def grows(
    cycle: Cycle, linear: Matrices, L: Floats, gamma: float, Ts: float | None, periods: int
) -> float:
    """The errors' growth over a period after many, by stepping plant and observer themselves."""
    rng = np.random.default_rng(0)
    n = len(L)
    state = np.concatenate([rng.normal(size=n), np.zeros(n), [0.3, 0.2]])
    right, left = 1.0, 1.0

    def rate(state: Floats, mode: SwitchMode) -> Floats:
        x, x_hat, (right_hat, left_hat) = state[:n], state[n : 2 * n], state[2 * n :]
        side = mode.S[0, 0] + mode.S[0, 1]
        y = linear.C[0] @ x - (right if side > 0 else -left)
        shift = right_hat if side > 0 else -left_hat
        e = abs(side) * mode.theta[0] * (y - linear.C[0] @ x_hat + shift)
        drift = linear.A if Ts is None else (linear.A - np.eye(n)) / Ts
        widths = [-gamma * e * float(side > 0), gamma * e * float(side < 0)]
        return np.concatenate([drift @ x, drift @ x_hat + L[:, 0] * e, widths])

    def step(state: Floats, mode: SwitchMode, h: float) -> Floats:
        if Ts is None:
            return rk4(lambda s, _: rate(s, mode), state, h)
        return state + h * rate(state, mode)

    sizes = []
    for _ in range(periods):
        for mode in cycle.modes:
            steps = 40 if Ts is None else round(mode.seconds / Ts)
            for _ in range(steps):
                state = step(state, mode, mode.seconds / steps)
        of_states = np.linalg.norm(state[:n] - state[n : 2 * n])
        sizes.append(of_states + abs(right - state[-2]) + abs(left - state[-1]))
    return float((sizes[-1] / sizes[-11]) ** 0.1)


@pytest.mark.parametrize(
    ("L", "gamma", "Ts"),
    [((0, 200), 10.0, None), ((0, 200), 10.0, 0.01), ((-1.25, -1.62), 1.0, 0.01)],
)
def test_divergence_is_found_and_is_real(
    L: tuple[float, float], gamma: float, Ts: float | None
) -> None:
    """Stable modes, an unstable switching: (0, 200); and the gains (40) as printed.

    The observer itself diverges along it.
    """
    linear = PAPER if Ts is None else zoh(PAPER, Ts)
    gains = column(*L)
    errors = build_error_dynamics(linear, gains, np.array([gamma]), Ts)
    assert not certify(linear, gains, np.array([gamma]), Ts).certified
    cycle = diverge(errors)
    assert cycle.factor > 1.005
    assert cycle.seconds == pytest.approx(sum(mode.seconds for mode in cycle.modes))
    periods = 10 + int(np.log(1e5) / np.log(cycle.factor))
    assert grows(cycle, linear, gains, gamma, Ts, periods) == pytest.approx(cycle.factor, rel=1e-3)


def test_an_unstable_plant_is_broken_whatever_v() -> None:
    linear = Matrices(np.array([[0.1]]), np.ones((1, 1)), np.ones((1, 1)))
    found = certify(linear, np.array([[2.0]]), np.ones(1))
    assert falsify(found.dynamics, found.V, 1000).growth > 10


def test_the_mode_matrices_are_those_of_the_observer() -> None:
    """One output: x~' = A x~ - theta L (C x~ -+ d~), d~_r' = gamma e or d~_l' = -gamma e.

    Nothing of that while silent.
    """
    L, gamma = column(1, 1.5), np.array([[10.0, 4.0]])
    errors = build_error_dynamics(PAPER, L, gamma, None)
    x, d = np.array([0.3, -0.7]), np.array([0.2, 0.5])
    for side, theta in ((1, 1.0), (-1, 0.4), (0, 1.0)):
        mode = SwitchMode(np.ones(1), branch_pattern((side,)), np.array([theta]), 1.0)
        rate = error_generator(errors, mode) @ np.concatenate([x, d])
        e = theta * (x[0] - d[0] if side > 0 else x[0] + d[1]) * abs(side)
        assert rate[:2] == pytest.approx(PAPER.A @ x - L[:, 0] * e)
        assert rate[2:] == pytest.approx([10.0 * e * (side > 0), -4.0 * e * (side < 0)])


def test_known_widths_are_not_attacked() -> None:
    """gamma = 0 means that the widths are known: V leaves them out, and so does the attack."""
    found = certify(PAPER, column(1, 1.5), np.zeros(1))
    attack = falsify(found.dynamics, found.V, 2000)
    assert found.certified
    assert not attack.broken
    assert (attack.start[2:] == 0).all()


def test_the_attack_is_reproducible() -> None:
    found = certify(PAPER, column(12, 15), np.array([2.0]))
    one, two = (falsify(found.dynamics, found.V, 1000, seed=5) for _ in range(2))
    assert one.rise == two.rise
    assert (one.start == two.start).all()
    assert one.trajectories >= 1000


def test_no_v_without_a_positive_definite_p() -> None:
    found = certify(PAPER, column(1, 1.5), np.array([2.0]))
    with pytest.raises(InputError, match="V: its P is not positive definite"):
        falsify(found.dynamics, found.V._replace(P=-found.P), 100)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("time", ["continuous", "sampled"])
def test_v_never_rises_in_the_real_loop(seed: int, time: str) -> None:
    """The graph that is simulated and flashed, with wild references, widths and guesses.

    The silence innovation is on for every other seed.
    """
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, 2 + seed % 2).linear
    run = simulate(
        scene(
            plant={name: matrix.tolist() for name, matrix in plant._asdict().items()}
            | {"x0": (3 * rng.normal(size=len(plant.A))).tolist()},
            sensor={"right": float(rng.uniform(0.1, 2)), "left": float(rng.uniform(0.1, 2))},
            reference={
                "kind": "sine",
                "amplitude": float(rng.uniform(2, 20)),
                "frequency": float(rng.uniform(0.1, 3)),
            },
            observer={
                "method": "certified",
                "L": passive_gain(plant, None).tolist(),
                "gamma": float(rng.uniform(0.5, 5)),
                "widths0": rng.uniform(0, 3, 2).tolist(),
                "width_max": 3.0,
                "silence": bool(seed % 2),
            },
            controller={"method": "state_feedback", "alpha": 1.0},
            simulation={
                "time": time,
                "duration": 3.0,
                "step": 1e-3 if time == "continuous" else 1e-2,
            },
        )
    )
    assert run.info.certified
    assert run.largest_rise_of_V is not None
    assert run.largest_rise_of_V < (1e-7 if time == "continuous" else 1e-12)


def test_stiff_and_marginally_certified_designs_are_not_broken() -> None:
    for seed in range(8):
        rng = np.random.default_rng(seed)
        linear = random_matrices(rng, 4, 1, spread=4.0)
        gains = passive_gain(linear, None) + 0.1 * rng.normal(size=(4, 1))
        found = certify(linear, gains, np.ones(1))
        if found.certified:
            assert not falsify(found.dynamics, found.V, 2000, seed=seed).broken


def test_the_largest_growth_is_that_of_the_worst_trajectory() -> None:
    """Of one switch, it is 1 + the rise."""
    proof = certify(PAPER_PLANT.linear, np.array([[1.0], [1.5]]), np.array([10.0]))
    attack = falsify(proof.dynamics, proof.V, trajectories=500, switches=1)
    assert attack.growth == pytest.approx(1 + attack.rise, rel=1e-12)
