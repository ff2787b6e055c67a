"""Controllers of arms: computed torque, PD with gravity, LQR about a trajectory.

And the feedforward along a path of the joints.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are

from scenes import random_plant, scene, slopes, table, tables_of
from undeadzone.controllers import LQR, ComputedTorque
from undeadzone.controllers.lqr import Params, linearise_trajectory, trajectory_gains
from undeadzone.errors import StepError
from undeadzone.feedforward.targets import Target, flat_targets
from undeadzone.interfaces import Controller, Estimate
from undeadzone.linalg.matrices import Matrices
from undeadzone.linalg.riccati import riccati_along, solve_riccati
from undeadzone.plants.robots.arm import forward_dynamics
from undeadzone.plants.system import System, sample_plant
from undeadzone.results.run import Run
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation import exogenous as inputs
from undeadzone.simulation.packed import graph
from undeadzone.simulation.simulate import outputs_of, prepare, simulate
from undeadzone.util import tree
from undeadzone.util.arrays import Floats

TWO = {"kind": "two_link"}
FAST = tables_of("""
kind = "sine"
amplitude = [0.5, 1.2]
frequency = 1.0
phase = [0.0, -1.5707963]
offset = [-1.5, 1.5]
""")
REST = {"kind": "step", "amplitude": [0.4, -0.7]}
LINK = {"plant": {"arm": {"kind": "elastic_joint", "measured": "link"}}, "tracked": [0]}
TORQUE: dict[str, Any] = {"method": "computed_torque", "bandwidth": 15.0}
GRAVITY: dict[str, Any] = {"method": "gravity_pd", "k_p": 200.0, "k_d": 20.0}
OPTIMAL: dict[str, Any] = {"method": "lqr", "Q": [100.0, 100.0, 1.0, 1.0], "R": 0.01}


def moving(
    controller: dict[str, Any],
    x0: Any = None,
    step: float = 1e-3,
    duration: float = 2.0,
    **changes: Any,
) -> Scenario:
    """A two-link arm on a fast path, its state known."""
    base: dict[str, Any] = {
        "plant": {"arm": TWO} | ({} if x0 is None else {"x0": x0}),
        "sensor": {"right": 0.1, "left": 0.1},
        "reference": FAST,
        "observer": {"method": "full_state"},
        "controller": controller,
        "simulation": {"duration": duration, "step": step, "time": "sampled", "substeps": 1},
    }
    return scene(**base | changes)


def targets(problem: Problem) -> Target:
    """x_ref, u_ff and what is planned, by instant."""
    m, n, tracked = problem.model.m, problem.model.n, len(problem.tracked)
    return Target(
        *np.split(
            inputs.exogenous(problem),
            np.cumsum([tracked, n, m, problem.controller.plan_size]),
            axis=1,
        )[:4]
    )


def on_path(step: float = 1e-3) -> Target:
    return targets(resolve_scenario(moving(OPTIMAL, step=step)))


def arm_model(Ts: float | None = None) -> System:
    model = resolve_scenario(moving(GRAVITY)).flow
    return model if Ts is None else sample_plant(model, Ts, 1)


def torques(controller: Controller, x: Floats, target: Target, w: Floats | None = None) -> Floats:
    """The law on numbers."""
    none = ca.SX(0, 1)
    estimate = Estimate(ca.SX(x), none, none, none, none, none, w=none if w is None else ca.SX(w))
    _, u = controller.step(controller.params, None, estimate, Target(*map(ca.SX, target)))
    return np.asarray(ca.evalf(u)).ravel()


def worst(run: Run) -> Floats:
    """The largest tracking error of each joint [rad]."""
    found: Floats = np.abs(run.z - run.r).max(axis=0)
    return found


# --- Feedforward along a path of the joints


def test_targets_of_an_arm_satisfy_its_equations() -> None:
    problem = resolve_scenario(moving(GRAVITY))
    assert problem.path is not None
    t = np.linspace(0.0, 2.0, 57)
    target = flat_targets(problem.flow, problem.path, [1], t)
    q, v, a = (problem.path.output_at(t, order) for order in range(3))
    x, u = ca.SX.sym("x", 4), ca.SX.sym("u", 2)
    move = ca.Function("move", [x, u], [problem.flow.move(ca.SX(problem.flow.params), x, u)])
    np.testing.assert_allclose(
        move(target.x_ref.T, target.u_ff.T).full().T,
        np.hstack([v, a]),
        atol=1e-11 * np.abs(a).max(),
    )
    np.testing.assert_allclose(target.r, q[:, [1]], atol=1e-14)


def test_targets_of_an_elastic_joint_satisfy_its_equations() -> None:
    """x_ref' = f(x_ref, u_ff), the derivative taken numerically."""
    problem = resolve_scenario(
        moving(GRAVITY, reference={"kind": "sine", "amplitude": 0.8, "frequency": 1.0}, **LINK)
    )
    assert problem.path is not None
    h, t = 1e-4, np.linspace(0.0, 1.0, 23)
    before = flat_targets(problem.flow, problem.path, [0], t - h)
    here = flat_targets(problem.flow, problem.path, [0], t)
    after = flat_targets(problem.flow, problem.path, [0], t + h)
    x, u = ca.SX.sym("x", 4), ca.SX.sym("u", 1)
    move = ca.Function("move", [x, u], [problem.flow.move(ca.SX(problem.flow.params), x, u)])
    rate = (after.x_ref - before.x_ref) / (2 * h)
    np.testing.assert_allclose(
        move(here.x_ref.T, here.u_ff.T).full().T, rate, atol=1e-6 * np.abs(rate).max()
    )
    np.testing.assert_allclose(here.r, problem.path.output_at(t), atol=1e-14)


def test_feedforward_of_mid_sample_is_of_second_order() -> None:
    steps = (8e-3, 4e-3, 2e-3)
    errors = [
        float(worst(simulate(moving(OPTIMAL, on_path(step).x_ref[0].tolist(), step))).max())
        for step in steps
    ]
    assert errors[-1] < 1e-4
    assert slopes(steps, errors) == pytest.approx(2.0, abs=0.3)


# --- Computed torque


def exact(t: Floats, e0: Floats, w: float, z: float) -> Floats:
    """e(t) of e'' + 2 z w e' + w^2 e = 0, e'(0) = 0."""
    return np.stack([expm(np.array([[0.0, 1.0], [-w * w, -2 * z * w]]) * s)[0, 0] * e0 for s in t])


def test_computed_torque_makes_the_error_linear() -> None:
    """In continuous time exactly, held over samples to the first order of the sample time."""
    offset = np.array([0.4, -0.3])
    controller = {"method": "computed_torque", "bandwidth": 10.0, "damping": 0.7}
    x0 = on_path().x_ref[0] + np.append(offset, [0, 0])
    steps, errors = (4e-3, 2e-3, 1e-3), []
    for step in steps:
        run = simulate(moving(controller, x0.tolist(), step))
        errors.append(float(np.abs(run.z - run.r - exact(run.t, offset, 10.0, 0.7)).max()))
    assert slopes(steps, errors) == pytest.approx(1.0, abs=0.1)
    plain = {"duration": 2.0, "step": 1e-3, "time": "continuous", "switching": "plain"}
    run = simulate(moving(controller, x0.tolist(), simulation=plain), check_step=False)
    assert run.z - run.r == pytest.approx(exact(run.t, offset, 10.0, 0.7), abs=1e-7)


def test_computed_torque_follows_a_fast_path_that_gravity_pd_does_not() -> None:
    start = on_path().x_ref[0].tolist()
    assert worst(simulate(moving(TORQUE, start))).max() < 1e-5
    assert worst(simulate(moving(GRAVITY, start))).max() > 0.02


def test_on_the_path_computed_torque_is_the_feedforward() -> None:
    problem = resolve_scenario(
        moving({"method": "computed_torque", "k_p": [30.0, 50.0], "k_d": 9.0})
    )
    target = targets(problem)
    for k in (0, 300, 1999):
        here = Target(*(part[k] for part in target))
        assert torques(problem.controller, here.x_ref, here) == pytest.approx(here.u_ff, rel=1e-10)


@pytest.mark.parametrize("reject", [True, False])
def test_a_known_disturbance_is_rejected_on_request(reject: bool) -> None:
    """With x' = f(x, u) + w, w constant: e'' + K_d e' + K_p e = 0.

    There e' = v_ref - (v + w_q) and q'' = a + w_v.
    """
    model, rng = arm_model(), np.random.default_rng(1)
    assert model.arm is not None
    k_p, k_d = np.array([30.0, 50.0]), np.array([9.0, 11.0])
    controller = ComputedTorque(k_p=k_p, k_d=k_d, reject=reject).build(model)
    x, x_ref, w, a_ref = (rng.normal(size=size) for size in (4, 4, 4, 2))
    u = torques(controller, x, Target(np.zeros(2), x_ref, np.zeros(2), a_ref), w)
    a = np.asarray(
        ca.evalf(
            forward_dynamics(model.arm, ca.SX(model.params), ca.SX(x[:2]), ca.SX(x[2:]), ca.SX(u))
        )
    ).ravel()
    left = (a_ref - a - w[2:]) + k_d * (x_ref[2:] - x[2:] - w[:2]) + k_p * (x_ref[:2] - x[:2])
    assert left == pytest.approx(0.0 if reject else -k_d * w[:2] - w[2:], abs=1e-9)


def test_the_step_that_is_refused_is_the_one_that_is_unstable() -> None:
    """The double integrator held over Ts: refused at a spectral radius of 1 and no sooner."""
    for k_p, k_d in ((100.0, 14.0), (4000.0, 20.0)):
        limit = min(2 / k_d, 2 * k_d / k_p)
        for Ts, stable in ((0.99 * limit, True), (1.01 * limit, False)):
            closed = np.array(
                [[1 - k_p * Ts**2 / 2, Ts - k_d * Ts**2 / 2], [-k_p * Ts, 1 - k_d * Ts]]
            )
            assert (np.abs(np.linalg.eigvals(closed)).max() < 1) == stable
            options = ComputedTorque(k_p=k_p, k_d=k_d)
            if stable:
                assert options.build(arm_model(Ts)).plan_size == 2
            else:
                with pytest.raises(StepError, match=r"simulation.step: .* too coarse"):
                    options.build(arm_model(Ts))


# --- PD with gravity


@pytest.mark.parametrize("at", ["reference", "estimate"])
def test_gravity_pd_settles_where_it_should(at: str) -> None:
    run = simulate(moving(GRAVITY | {"at": at}, reference=REST, duration=4.0))
    assert run.x[-1] == pytest.approx([0.4, -0.7, 0.0, 0.0], abs=1e-6)
    assert np.abs(run.x[0] - run.x[-1]).max() > 0.5


def test_gravity_pd_hangs_where_it_does_not_know_the_payload() -> None:
    """By the payload's torque over K_p: K_p (q_ref - q) = g(q) - g^(q_ref)."""
    plant = {"arm": TWO, "parameters": {"payload": 0.5}}
    run = simulate(
        moving(
            GRAVITY,
            plant=plant,
            model={"parameters": {"payload": 0.0}},
            reference=REST,
            duration=6.0,
        )
    )
    problem = resolve_scenario(moving(GRAVITY, plant=plant))
    arm = problem.plant.arm
    assert arm is not None
    empty = np.where(np.array(arm.names) == "payload", 0.0, problem.plant.params)
    g = np.asarray(arm.bias(problem.plant.params, run.x[-1, :2], np.zeros(2))).ravel()
    compensated = np.asarray(arm.bias(empty, [0.4, -0.7], np.zeros(2))).ravel()
    gap = np.array([0.4, -0.7]) - run.x[-1, :2]
    assert 200.0 * gap == pytest.approx(g - compensated, abs=1e-4)
    assert np.abs(gap).max() > 5e-3


def test_gravity_pd_brings_an_elastic_joint_to_rest_from_its_motor() -> None:
    """Tomei (1991): the link stands at its reference, the motor further by the deflection."""
    joint = LINK | {
        "plant": {"arm": {"kind": "elastic_joint", "measured": "link"}, "parameters": {"b2": 0.2}}
    }
    scenario = moving(
        GRAVITY | {"k_p": 30.0, "k_d": 2.0},
        reference={"kind": "step", "amplitude": 0.4},
        duration=12.0,
        **joint,
    )
    run = simulate(scenario)
    values = dict(
        zip(
            resolve_scenario(scenario).plant.names,
            resolve_scenario(scenario).plant.params,
            strict=True,
        )
    )
    weight = values["m"] * values["c"] * values["g"] * np.cos(0.4)
    assert run.x[-1] == pytest.approx([0.4 + weight / values["k"], 0.4, 0.0, 0.0], abs=1e-5)


# --- LQR about a trajectory


@pytest.mark.parametrize("inputs_", [1, 2])
def test_on_a_linear_plant_lqr_is_the_algebraic_solution(inputs_: int) -> None:
    model = sample_plant(random_plant(np.random.default_rng(5), 4, inputs_, stable=False), 0.05)
    A, B, _ = model.linear
    Q, R = np.diag([1.0, 2.0, 3.0, 4.0]), 0.5 * np.eye(inputs_)
    P = solve_discrete_are(A, B, Q, R)
    K = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
    controller = LQR(Q=[1.0, 2.0, 3.0, 4.0], R=0.5).build(model)
    assert controller.plan is not None
    rows = controller.plan.along(
        controller.plan.params, Target(np.zeros((3, 1)), np.zeros((3, 4)), np.zeros((3, inputs_)))
    )
    x, x_ref, u_ff = np.arange(4.0), np.array([0.3, -1.0, 0.5, 2.0]), np.arange(1.0, 1.0 + inputs_)
    for row in rows:
        assert torques(controller, x, Target(np.zeros(1), x_ref, u_ff, row)) == pytest.approx(
            u_ff - K @ (x - x_ref)
        )
    many = (np.broadcast_to(part, (4000, *part.shape)) for part in (A, B))
    along = riccati_along(*many, Q, R, Q)  # from an end that is no steady state
    assert along[0] == pytest.approx(K, rel=1e-9)
    assert np.abs(along[-1] / K - 1).max() > 1e-2


def test_lqr_is_optimal_about_the_trajectory() -> None:
    """The cost of a small perturbation is e'P e.

    Constant gains, for whatever posture they are made, cost more.
    """
    target, options = on_path(), {"method": "lqr"}
    offset = 1e-3 * np.array([1.0, -1.0, 0.0, 0.0])
    start = (target.x_ref[0] + offset).tolist()
    model, Q, R = arm_model(1e-3), np.diag([1.0, 1.0, 0.01, 0.01]), np.eye(2)
    A, B = linearise_trajectory(model, target, 1)

    def stationary(k: int) -> tuple[Floats, Floats]:
        found = solve_riccati(Matrices(A[k], B[k], np.eye(4)), Q, R, 1e-3)
        return found.P, found.K

    P, _ = last = stationary(-1)
    for k in reversed(range(len(A))):
        K = np.linalg.solve(R + B[k].T @ P @ B[k], B[k].T @ P @ A[k])
        P = Q + A[k].T @ P @ A[k] - K.T @ (R + B[k].T @ P @ B[k]) @ K

    def cost(controller: dict[str, Any]) -> float:
        run = simulate(moving(controller, start))
        e, v = run.x - target.x_ref, run.u - target.u_ff
        after = A[-1] @ e[-1] + B[-1] @ v[-1]
        return float(((e @ Q) * e).sum() + ((v @ R) * v).sum() + after @ last[0] @ after)

    best = cost(options | {"Q": Q.tolist(), "R": 1.0})
    assert best == pytest.approx(offset @ P @ offset, rel=0.02)
    assert (
        min(
            cost({"method": "state_feedback", "K": stationary(k)[1].tolist()})
            for k in (0, 500, 750)
        )
        > 1.5 * best
    )


def test_lqr_of_every_few_samples_is_nearly_that_of_all() -> None:
    model, target, weights = arm_model(1e-3), on_path(), (np.eye(4), 0.01 * np.eye(2))
    fine = trajectory_gains(model, Params(*weights, 1), target)
    gaps = [
        float(np.abs(trajectory_gains(model, Params(*weights, stride), target) - fine).max())
        for stride in (16, 8)
    ]
    assert gaps[1] < 2e-3 * np.abs(fine).max()
    assert gaps[0] > 3 * gaps[1]


def test_lqr_follows_with_a_plant_given_by_formulas() -> None:
    pendulum = {
        "states": ["a", "v"],
        "f": ["v", "-9.81 * sin(a) - 0.5 * v + u"],
        "h": ["a"],
        "x0": [0.6, 0.0],
    }
    reference = {"kind": "sine", "amplitude": 2.0, "frequency": 0.5}
    run = simulate(
        moving(
            {"method": "lqr", "Q": [50.0, 1.0], "R": 0.1},
            plant=pendulum,
            reference=reference,
            duration=4.0,
        )
    )
    assert np.abs(run.z - run.r)[-200:].max() < 1e-3
    assert np.abs(run.z[0] - run.r[0]).max() > 0.5


def test_a_reference_twice_as_large_does_not_scale_the_gains() -> None:
    """scale.reference of ensembles scales the targets of a linear plant and nothing else."""
    data = table("""
        controller = { method = "lqr", R = 0.01 }
        observer = { method = "full_state" }
        simulation = { time = "sampled" }
        """)
    start = prepare(resolve_scenario(scene(**data)))
    loop = start.loop
    scaled = loop._replace(
        params=loop.params._replace(scale=loop.params.scale._replace(reference=2.0))
    )
    doubled = scene(**data | {"reference": data["reference"] | {"amplitude": 10.0}})
    assert outputs_of(start._replace(loop=scaled)).u == pytest.approx(
        simulate(doubled).u, rel=1e-9, abs=1e-9
    )


def test_candidates_share_a_kernel_only_if_they_share_their_plan() -> None:
    def form(controller: dict[str, Any]) -> str:
        return graph(resolve_scenario(moving(controller, duration=0.01)))

    assert form(OPTIMAL) != form(OPTIMAL | {"R": 0.02})
    assert form(OPTIMAL) == form(OPTIMAL | {"R": [0.01, 0.01]})
    assert form(TORQUE) == form(TORQUE | {"bandwidth": 20.0})


# --- All of them


@pytest.mark.parametrize(
    "controller",
    [TORQUE, GRAVITY, GRAVITY | {"at": "estimate"}, OPTIMAL],
    ids=["torque", "gravity", "at estimate", "lqr"],
)
def test_compiled_lanes_run_the_same(controller: dict[str, Any]) -> None:
    scenario = moving(controller, duration=0.3)
    one, other = simulate(scenario), simulate(scenario, engine="lanes")
    assert np.ptp(one.u, axis=0).min() > 1.0
    for name in ("x", "u"):
        np.testing.assert_allclose(
            getattr(other, name),
            getattr(one, name),
            rtol=0,
            atol=1e-11 * np.abs(getattr(one, name)).max(),
        )


def test_what_is_planned_varies_along_the_path_and_is_no_parameter() -> None:
    """The gains of an arm change with its posture: inputs of the loop, which all lanes share."""
    problem = resolve_scenario(moving(OPTIMAL))
    plan = targets(problem).plan
    assert plan.shape == (problem.steps + 1, 8)
    assert np.ptp(plan, axis=0).max() > 0.1 * np.abs(plan).max()
    assert tree.count_numbers(problem.controller.params) == 0
