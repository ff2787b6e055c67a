"""The closed loop against twins written without the package.

They are events by SciPy in continuous time, and a plain loop in sampled time.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_continuous_are

from scenes import scene, slopes
from undeadzone.numerics.dense_output import Crossing
from undeadzone.results.run import Run
from undeadzone.signals import noise
from undeadzone.simulation.close import Mode, branch_after_crossing, exogenous_at
from undeadzone.simulation.simulate import simulate
from undeadzone.util.arrays import Floats

A, B, C = np.array([[0.0, 1.0], [-1.0, -2.0]]), np.array([0.0, 1.0]), np.array([1.0, 0.0])
L, GAMMA = np.array([1.0, 1.5]), 10.0
W = 2 * np.pi  # [rad/s]
RICCATI = 10.0 * B @ solve_continuous_are(A, B[:, None], np.eye(2), np.array([[1 / 20.0]]))
PLANT = {"A": A.tolist(), "B": B[:, None].tolist(), "C": C[None].tolist()}
OBSERVER = {
    "method": "certified",
    "L": L.tolist(),
    "gamma": GAMMA,
    "widths0": [0.2, 0.2],
    "width_max": 3.0,
}


class Twin(NamedTuple):
    """The paper's loop in plain NumPy; s = [x, x^, d_r^, d_l^]."""

    right: float = 1.0
    left: float = 1.0
    slope: float = 1.0
    threshold: float = 0.0
    jump: bool = False
    silence: bool = False
    gamma: float = GAMMA
    K: Floats = RICCATI
    reference: Callable[[float], Any] = lambda t: (
        5 * np.array([np.sin(W * t), W * np.cos(W * t), -(W**2) * np.sin(W * t)])
    )
    start: tuple[float, ...] = (0.5, 0.0, 0.0, 0.0, 0.2, 0.2)

    def input(self, t: float, s: Floats) -> float:
        """u = r'' + 2 r' + r - K (x^ - [r, r'])."""
        r, dr, ddr = self.reference(t)
        return float(ddr + 2 * dr + r - self.K @ (s[2:4] - np.array([r, dr])))

    def innovation(self, s: Floats, side: int, y: float) -> tuple[float, Floats]:
        """e and what drives [d_r^, d_l^] on the measured side; y in the unit of z."""
        d_r, d_l = s[4:]
        if side == 0:
            over, under = (
                (max(s[2] - d_r, 0.0), max(-s[2] - d_l, 0.0)) if self.silence else (0.0, 0.0)
            )
            return under - over, np.array([over, under])
        if self.jump:
            return y - s[2], np.array(
                [min(y - d_r, 0.0) if side > 0 else 0.0, min(-y - d_l, 0.0) if side < 0 else 0.0]
            )
        e = y - (s[2] - d_r if side > 0 else s[2] + d_l)
        return e, np.array([-e if side > 0 else 0.0, e if side < 0 else 0.0])

    def branch(self, z: float, side: int) -> float:
        """What is read of z on a side, in the unit of z."""
        return z if self.jump else z - self.right if side > 0 else z + self.left

    def rate(self, t: float, s: Floats, side: int, y: float) -> Floats:
        """s' on a side."""
        u, (e, grow) = self.input(t, s), self.innovation(s, side, y)
        return np.concatenate([A @ s[:2] + B * u, A @ s[2:4] + B * u + L * e, self.gamma * grow])

    def run(self, t: Floats) -> Floats:
        """s at times t: DOP853 from one change of side to the next, located by events."""
        margin = self.threshold / self.slope
        top, bottom = (
            (max(self.right, margin), -max(self.left, margin))
            if self.jump
            else (self.right + margin, -self.left - margin)
        )
        exits = {0: [(top, 1, 1), (bottom, -1, -1)], 1: [(top, -1, 0)], -1: [(bottom, 1, 0)]}
        now, state = 0.0, np.array(self.start)
        side = int(state[0] > top) - int(state[0] < bottom)
        found = np.empty((t.size, state.size))
        while True:
            piece = solve_ivp(
                lambda t, s, side: self.rate(t, s, side, self.branch(s[0], side)),
                (now, t[-1]),
                state,
                "DOP853",
                args=(side,),
                events=[crossing(level, direction) for level, direction, _ in exits[side]],
                rtol=1e-12,
                atol=1e-13,
                dense_output=True,
            )
            here = (t >= now) & (t <= piece.t[-1])
            if here.any():
                found[here] = piece.sol(t[here]).T
            if piece.status != 1:
                return found
            which = next(i for i, times in enumerate(piece.t_events) if times.size)
            now, state, side = piece.t[-1], piece.y[:, -1], exits[side][which][2]


def crossing(level: float, direction: int) -> Any:
    """A SciPy event: z meets a level in a direction."""

    def event(t: float, s: Floats, side: int) -> float:
        return float(s[0]) - level

    event.terminal, event.direction = True, direction  # type: ignore[attr-defined]
    return event


def signals(run: Run) -> Floats:
    return np.hstack([run.x, run.x_hat, run.d_hat])


def error(twin: Twin, step: float, duration: float, **tables: Any) -> Floats:
    """The largest error of each signal of `simulate` against the twin."""
    sensor = {
        "right": twin.right,
        "left": twin.left,
        "slope": twin.slope,
        "threshold": twin.threshold,
        "kind": "jump" if twin.jump else "deadzone",
    }
    run = simulate(
        scene(
            observer=OBSERVER
            | {"gamma": twin.gamma, "widths0": [twin.start[4:]], "silence": twin.silence},
            sensor=sensor,
            simulation={"duration": duration, "step": step},
            **tables,
        ),
        check_step=False,
    )
    found: Floats = np.abs(signals(run) - twin.run(run.t)).max(axis=0)
    return found


@pytest.mark.parametrize(
    ("twin", "controller"),
    [
        (Twin(), {"method": "state_feedback", "alpha": 10.0}),
        (Twin(1.3, 0.6), {"method": "state_feedback", "alpha": 10.0}),
        (Twin(0.5, 2.0, slope=2.0, threshold=0.3), {"method": "state_feedback", "alpha": 10.0}),
        (Twin(K=np.array([39.0, 12.0])), {"method": "state_feedback", "poles": [-4.0, -10.0]}),
    ],
    ids=["paper", "asymmetric", "slope and threshold", "poles"],
)
def test_continuous_loop_equals_its_event_twin(twin: Twin, controller: dict[str, Any]) -> None:
    assert error(twin, 1e-3, 4.0, controller=controller).max() < 1e-8


def test_jump_sensor_equals_its_event_twin() -> None:
    """The least width seen is kept by a min, whose kink is not located.

    The widths are less accurate than the state.
    """
    found = error(Twin(0.8, 1.2, jump=True, start=(0.5, 0.0, 0.0, 0.0, 3.0, 3.0)), 1e-3, 4.0)
    assert found[:4].max() < 1e-8
    assert found[4:].max() < 1e-5


@pytest.mark.parametrize(
    ("twin", "after", "before"),
    [
        (Twin(1.3, 0.6), 0.1, 0.0),
        (Twin(1.3, 0.6, threshold=0.15), 0.1, 0.2),
        (Twin(1.3, 0.6, threshold=0.5, jump=True, start=(0.5, 0.0, 0.0, 0.0, 3.0, 3.0)), 0.1, 0.2),
    ],
    ids=["no threshold guards the zone", "before and after", "jump"],
)
def test_noise_is_constant_over_each_step(twin: Twin, after: float, before: float) -> None:
    """The twin judges reading and side anew at each stage of many small steps.

    Both err by about h^2 at a change of side.
    """
    step, substeps, steps = 1e-3, 32, 500
    sensor = {
        "right": twin.right,
        "left": twin.left,
        "noise": after,
        "noise_before": before,
        "threshold": twin.threshold,
    }
    run = simulate(
        scene(
            sensor=sensor | {"kind": "jump" if twin.jump else "deadzone"},
            observer=OBSERVER | {"widths0": [twin.start[4:]]},
            simulation={"duration": steps * step, "step": step, "seed": 3},
        ),
        check_step=False,
    )
    samples = [
        rms * noise.standard_normal_numbers(3, stream, steps + 1, 1)[:, 0]
        for rms, stream in ((after, noise.AFTER), (before, noise.BEFORE))
    ]

    def rate(t: float, s: Floats, n: float, b: float) -> Floats:
        z = s[0] + b
        inside = -twin.left <= z <= twin.right
        y = (0.0 if inside else twin.branch(z, 1 if z > 0 else -1)) + n
        return twin.rate(t, s, int(y > twin.threshold) - int(y < -twin.threshold), y)

    s, h = np.array(twin.start), step / substeps
    for k, (n, b) in enumerate(zip(*samples, strict=True)):
        assert np.abs(signals(run)[k] - s).max() < (1e-3 if twin.jump else 1e-4)
        for t in k * step + h * np.arange(substeps):
            k1 = rate(t, s, n, b)
            k2 = rate(t + h / 2, s + h / 2 * k1, n, b)
            k3 = rate(t + h / 2, s + h / 2 * k2, n, b)
            s = s + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(t + h, s + h * k3, n, b))
            s[4:] = np.clip(s[4:], 0.0, 3.0)
    assert {-1, 1} <= set(run.side.ravel())


@pytest.mark.parametrize("kinks", [True, False])
def test_order_is_four_across_kinks_as_away_from_them(kinks: bool) -> None:
    """Away from the kinks: a raised reference holds z on the right, a low gamma keeps d^ inside."""
    twin, tables = Twin(), {}
    if not kinks:
        tables = {
            "plant": PLANT | {"x0": [1.5, 0.0]},
            "reference": {"kind": "sine", "amplitude": 1.0, "frequency": 1.0, "offset": 4.0},
        }
        twin = Twin(
            gamma=0.5,
            start=(1.5, 0.0, 0.0, 0.0, 1.0, 1.0),
            reference=lambda t: np.array(
                [4 + np.sin(W * t), W * np.cos(W * t), -(W**2) * np.sin(W * t)]
            ),
        )
    steps = [0.04, 0.02, 0.01, 0.005]
    errors = [error(twin, step, 2.0, **tables).max() for step in steps]
    assert slopes(steps, errors).min() > 3.4
    assert slopes(steps, errors).mean() == pytest.approx(4.0, abs=0.3)


def test_order_is_two_with_the_silence_innovation() -> None:
    """Where z^ passes an estimated edge in silence, the rate has a kink that is not located."""
    steps = [0.04, 0.02, 0.01, 0.005, 0.0025, 1e-3]
    errors = [error(Twin(silence=True), step, 2.0).max() for step in steps]
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(2.0, abs=0.4)
    assert errors[-1] < 1e-5


@pytest.mark.parametrize(("width", "bound"), [(1.0, 1e-7), (0.003, 1e-2)])
def test_reported_integration_error_is_the_error(width: float, bound: float) -> None:
    """A zone that is crossed within one step is skipped (one change a step is located).

    That is less accurate, and reported.
    """
    twin = Twin(width, width, gamma=0.1, start=(0.5, 0.0, 0.0, 0.0, 1.0, 1.0))
    run = simulate(
        scene(
            sensor={"right": width, "left": width},
            observer=OBSERVER | {"gamma": 0.1, "widths0": 1.0},
            simulation={"step": 4e-3},
        )
    )
    found = np.abs(signals(run) - twin.run(run.t)).max()
    assert run.info.integration_error is not None
    assert 0.3 * run.info.integration_error < found < 3 * run.info.integration_error < 3 * bound


@pytest.mark.parametrize("silence", [False, True])
def test_sampled_loop_equals_a_plain_loop(silence: bool) -> None:
    """Mismatched model, asymmetric widths, slope, noise, threshold, disturbance, projection.

    The hold is exact, by A^-1 (Ad - I) B.
    """
    h, steps, right, left, slope, threshold, gamma, limit = (
        0.01,
        1500,
        1.3,
        0.6,
        1.5,
        0.05,
        8.0,
        1.5,
    )
    true_A, true_B = np.array([[0.0, 1.0], [-1.1, -1.8]]), np.array([0.0, 0.9])
    run = simulate(
        scene(
            """
            disturbance = { kind = "sine", amplitude = 3.0, frequency = 0.3 }
            controller = { method = "state_feedback", poles = [-10.0, -12.0] }
            """,
            plant={
                "A": true_A.tolist(),
                "B": true_B[:, None].tolist(),
                "C": [[1.0, 0.0]],
                "x0": [1.0, 0.0],
            },
            model={"A": A.tolist(), "B": B[:, None].tolist()},
            sensor={
                "right": right,
                "left": left,
                "slope": slope,
                "noise": 0.05,
                "threshold": threshold,
            },
            observer=OBSERVER | {"gamma": gamma, "width_max": limit, "silence": silence},
            simulation={"duration": steps * h, "step": h, "time": "sampled"},
        )
    )
    noise = (run.y - slope * (run.z - np.clip(run.z, -left, right)))[:, 0]
    assert 0.04 < noise.std() < 0.06

    def hold(A: Floats, B: Floats) -> tuple[Floats, Floats]:
        Ad = expm(A * h)
        return Ad, np.linalg.solve(A, (Ad - np.eye(2)) @ B)

    (Ad, Bd), (Am, Bm) = hold(true_A, true_B), hold(A, B)
    polynomial = np.poly(np.exp([-10.0 * h, -12.0 * h]))
    K = np.linalg.solve(np.stack([Bm, Am @ Bm]), [0.0, 1.0]) @ (
        Am @ Am + polynomial[1] * Am + polynomial[2] * np.eye(2)
    )
    state_response = np.linalg.solve(np.exp(1j * W * h) * np.eye(2) - Am, Bm)
    x, x_hat, d = np.array([1.0, 0.0]), np.zeros(2), np.array([0.2, 0.2])
    for k in range(steps + 1):
        y = slope * (x[0] - min(max(x[0], -left), right)) + noise[k]
        side = int(y > threshold) - int(y < -threshold)
        over, under = (
            max(x_hat[0] - d[0] - threshold / slope, 0.0),
            max(-x_hat[0] - d[1] - threshold / slope, 0.0),
        )
        over, under = (over, under) if silence and side == 0 else (0.0, 0.0)
        e = y / slope - x_hat[0] + (d[0] if side > 0 else -d[1]) if side else under - over
        phasor = 5 * np.exp(1j * W * k * h) / state_response[0]
        u = phasor.imag - K @ (x_hat - (phasor * state_response).imag)
        assert [*run.x[k], *run.x_hat[k], *run.d_hat[k]] == pytest.approx(
            [*x, *x_hat, *d], abs=1e-11
        )
        assert (run.side[k, 0], run.innovation[k, 0], run.u[k, 0]) == pytest.approx(
            (side, e, u), abs=1e-10
        )
        x, x_hat = (
            Ad @ x + Bd * (u + 3 * np.sin(2 * np.pi * 0.3 * (k + 0.5) * h)),
            Am @ x_hat + Bm * u + h * L * e,
        )
        d = np.clip(
            d + h * gamma * np.array([-e * (side > 0) + over, e * (side < 0) + under]), 0.0, limit
        )
    assert {-1, 0, 1} == set(run.side.ravel())
    assert d.tolist() != run.d_hat[0].tolist()


def test_two_decoupled_outputs_equal_two_loops() -> None:
    """Each output has its own widths, gain and reference."""
    zero = np.zeros((2, 2))
    both = simulate(
        scene(
            """
            sensor = { right = [1.0, 0.5], left = [0.8, 1.1] }
            reference.kind = "sine"
            reference.amplitude = [5.0, 4.0]
            reference.frequency = 1.0
            reference.phase = [0.0, 1.0]
            """,
            plant={
                "A": np.block([[A, zero], [zero, A]]).tolist(),
                "B": np.kron(np.eye(2), B[:, None]).tolist(),
                "C": np.kron(np.eye(2), C).tolist(),
            },
            observer=OBSERVER
            | {"L": np.kron(np.eye(2), L[:, None]).tolist(), "gamma": [10.0, 2.0]},
            controller={"method": "state_feedback", "K": np.kron(np.eye(2), RICCATI).tolist()},
        )
    )
    for i, (right, left, amplitude, phase, gamma) in enumerate(
        [(1.0, 0.8, 5.0, 0.0, 10.0), (0.5, 1.1, 4.0, 1.0, 2.0)]
    ):
        alone = simulate(
            scene(
                plant=PLANT,
                sensor={"right": right, "left": left},
                reference={
                    "kind": "sine",
                    "amplitude": amplitude,
                    "frequency": 1.0,
                    "phase": phase,
                },
                observer=OBSERVER | {"gamma": gamma},
                controller={"method": "state_feedback", "K": [RICCATI.tolist()]},
            )
        )
        pair = slice(2 * i, 2 * i + 2)
        assert (
            np.abs(
                np.hstack([both.x[:, pair], both.x_hat[:, pair], both.d_hat[:, pair]])
                - signals(alone)
            ).max()
            < 1e-8
        )
        assert (both.side[:, i] == alone.side[:, 0]).mean() > 0.999


def test_exogenous_inputs_run_through_their_three_instants() -> None:
    """p = 1: five held entries keep their first value, the rest is a parabola."""
    column = [ca.DM([value, *[value] * 5]) for value in (1.0, 4.0, 11.0)]
    at = [np.asarray(exogenous_at(column, ca.DM(c), 1)).ravel() for c in (0.0, 0.25, 0.5, 1.0)]
    assert [value[0] for value in at] == pytest.approx([1.0, 2.0, 4.0, 11.0])
    assert np.array_equal(np.stack(at)[:, 1:], np.ones((4, 5)))
    assert float(exogenous_at(column, 0.5, 1)[0]) == 4.0


@pytest.mark.parametrize(
    ("edge", "rising", "zone"),
    [
        *[(1.0, 1, 1.0), (1.0, 0, 0.0), (-0.5, 1, 0.0), (-0.5, 0, -1.0)],
        *[(0.2, 1, 0.0), (0.2, 0, 0.0), (2.0, 0, 1.0)],
    ],
)
def test_motion_decides_the_zone_on_an_edge(edge: float, rising: int, zone: float) -> None:
    crossing = Crossing(ca.DM(1), ca.DM(1), ca.DM(1), ca.DM(rising))
    before = Mode(ca.DM(9), ca.DM(9))
    after = branch_after_crossing(before, crossing, ca.DM(edge), ca.DM(1.0), ca.DM(0.5))
    assert (float(after.zone), float(after.side)) == (zone, 1.0)
    unchanged = branch_after_crossing(
        before, crossing._replace(changed=ca.DM(0)), ca.DM(edge), ca.DM(1), ca.DM(1)
    )
    assert (float(unchanged.zone), float(unchanged.side)) == (9.0, 9.0)
