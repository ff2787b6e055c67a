"""Widths along runs of nonlinear plants: verdicts against theory, Gramians against other runs."""

from __future__ import annotations

import functools
from types import SimpleNamespace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from scenes import linear, random_plant, seeds, tables_of
from undeadzone.analysis.branch_schedule import reading_levels, schedule_of_record
from undeadzone.analysis.convergence.floquet import matrix_exponentials
from undeadzone.analysis.identifiability import linearised_run, nonlinear
from undeadzone.analysis.identifiability.disturbance import unknown_bias
from undeadzone.analysis.identifiability.linear import WidthIdentifiability, width_identifiability
from undeadzone.analysis.identifiability.linearised_run import _assemble_run
from undeadzone.analysis.identifiability.nonlinear import (
    Observability,
    observability_along,
    reading_variance,
    width_identifiability_along,
)
from undeadzone.nonlinearities.sensor import Sensor, Zone, deadzone, resolve, zone
from undeadzone.plants.build import initial_state, system
from undeadzone.plants.options import ElasticJoint, OneLink, Plant, TwoLink
from undeadzone.plants.system import System, sample_plant
from undeadzone.scenario.reader import convert
from undeadzone.signals.exosystem import Step
from undeadzone.simulation.simulate import simulate
from undeadzone.util.arrays import Floats

STEP = 2e-3
TABLE = {"g": 0.0}
SWINGING = {  # plants, and torques under which every output passes -0.2 and 0.3
    "pendulum": (
        Plant(arm=OneLink(reference=-np.pi / 2), x0=[-1.0, 0.0]),
        lambda t, x: [1.5 * np.sin(3 * t) - 0.1 * x[1]],
    ),
    "upright": (
        Plant(arm=OneLink(reference=np.pi / 2), x0=[1.6, 0.0]),
        lambda t, x: [4 * np.sin(3 * t) - 9 * (x[0] - np.pi / 2) - 0.5 * x[1]],
    ),
    "one link on a table": (
        Plant(arm=OneLink(), parameters=TABLE),
        lambda t, x: [np.sin(3 * t) - 2 * x[0] - 0.2 * x[1]],
    ),
    "two links": (
        Plant(arm=TwoLink(), x0=[0.5, 0.0, 0.0, 0.0]),
        lambda t, x: [
            12 * np.cos(x[0]) + 9 * np.sin(2 * t) - 9 * x[0] - 3 * x[2],
            3 * np.cos(x[0] + x[1]) + 4 * np.sin(3 * t) - 5 * x[1] - x[3],
        ],
    ),
    "two links on a table": (
        Plant(arm=TwoLink(), parameters=TABLE),
        lambda t, x: [
            10 * np.sin(2 * t) - 20 * x[0] - 4 * x[2],
            8 * np.sin(3 * t) - 10 * x[1] - 2 * x[3],
        ],
    ),
    "speeds of two links on a table": (
        Plant(arm=TwoLink(measured="velocity"), parameters=TABLE),
        lambda t, x: [
            10 * np.sin(2 * t) - 20 * x[0] - 4 * x[2],
            8 * np.sin(3 * t) - 10 * x[1] - 2 * x[3],
        ],
    ),
    "motor of an elastic joint on a table": (
        Plant(arm=ElasticJoint(measured="motor"), parameters=TABLE),
        lambda t, x: [8 * np.sin(2 * t) - 9 * x[0] - 2 * x[2]],
    ),
    "motor of an elastic joint": (
        Plant(arm=ElasticJoint(measured="motor")),
        lambda t, x: [3 * np.cos(x[1]) + 6 * np.sin(2 * t) - 9 * x[0] - 2 * x[2]],
    ),
    "link of an elastic joint": (
        Plant(arm=ElasticJoint(measured="link")),
        lambda t, x: [3 * np.cos(x[1]) + 6 * np.sin(2 * t) - 9 * x[0] - 2 * x[2]],
    ),
    "duffing": (
        Plant(
            f=["v", "-k*s**3 - c*v + F"],
            h=["s"],
            states=["s", "v"],
            inputs=["F"],
            parameters={"k": 2.0, "c": 0.5},
        ),
        lambda t, x: [2 * np.sin(1.5 * t)],
    ),
    "cart and pole": (
        Plant(
            f=["v", "F", "w", "9.81*sin(a) - F*cos(a)"],
            h=["s", "5*a"],
            states=["s", "v", "a", "w"],
            inputs=["F"],
        ),
        lambda t, x: [30 * x[2] + 9 * x[3] + 1.5 * (x[0] - np.sin(2.5 * t)) + 2 * x[1]],
    ),
    "a bent integrator": (
        Plant(f=["F / (1 + s**2)"], h=["s + s**3 / 3"], states=["s"], inputs=["F"]),
        lambda t, x: [3 * np.cos(2 * t)],
    ),
}


class Trial(NamedTuple):
    """A plant, sampled, and a run of it."""

    model: System
    x: Floats
    u: Floats
    z: Floats
    sensor: Zone

    @property
    def side(self) -> Floats:
        return zone(self.z, *reading_levels(self.sensor).T)

    def verdicts(self, **known: Any) -> list[WidthIdentifiability]:
        return width_identifiability_along(
            self.model, self.x, self.u, self.z, self.sensor, STEP, **known
        )

    def observability(self, **known: Any) -> Observability:
        return observability_along(
            self.model, self.x, self.u, self.side, STEP, reading_variance(self.sensor), **known
        )


def outputs(model: System, start: Floats, u: Floats) -> tuple[Floats, Floats]:
    """(x, z) of a sampled plant from a start under inputs u."""
    x, w = ca.SX.sym("x", model.n), ca.SX.sym("u", model.m)
    params = ca.SX(model.params) if model.nonlinear else model.params
    step = ca.Function(
        "step", [x, w], [model.move(params, x, w), ca.vertcat(x, model.output(params, x))]
    )
    both = np.asarray(step.mapaccum(len(u))(start, u.T)[1]).T
    return both[:, : model.n], both[:, model.n :]


@functools.cache
def swinging(name: str, duration: float = 6.0, step: float = STEP) -> Trial:
    plant, torque = SWINGING[name]
    model = sample_plant(system(plant), step, 1)
    x, u = ca.SX.sym("x", model.n), ca.SX.sym("u", model.m)
    move = ca.Function("move", [x, u], [model.move(ca.SX(model.params), x, u)])
    start = now = initial_state(plant, model)
    inputs = []
    for k in range(round(duration / step)):
        inputs.append(np.ravel(torque(k * step, now)))
        now = move(now, inputs[-1]).full().ravel()
    x_all, z = outputs(model, start, np.array(inputs))
    return Trial(
        model, x_all, np.array(inputs), z, resolve(Sensor(right=0.3, left=0.2), model.p, step)
    )


CENTRE_LOST = {
    "one link on a table": ([True], "the position of joint q1 as a whole alters no motion"),
    "two links on a table": ([True, False], "the position of joint q1 as a whole alters no motion"),
    "motor of an elastic joint on a table": (
        [True],
        "the position of joint motor and the position of joint link as a whole",
    ),
    "cart and pole": ([True, False], "a change of x[0] as a whole alters no motion"),
    "a bent integrator": ([True], "along this run x[0] can shift with the edges"),
}


@pytest.mark.parametrize("name", SWINGING)
def test_the_centre_is_lost_where_nothing_depends_on_a_position_and_only_there(name: str) -> None:
    run = swinging(name)
    assert ((run.z.min(axis=0) < -0.2) & (run.z.max(axis=0) > 0.3)).all()
    lost, words = CENTRE_LOST.get(name, ([False] * run.model.p, ""))
    found = run.verdicts()
    for verdict, no in zip(found, lost, strict=True):
        assert verdict[:4] == (not no, not no, True, not no)
        assert verdict.std is not None
        assert (verdict.std["centre"] == np.inf) == no
        assert len(verdict.reasons) == no
        assert not no or (
            words in verdict.reasons[0]
            and verdict.reasons[0].startswith("the centre is not identifiable")
        )
    seen = run.observability()
    none = seen.singular <= seen.tolerance
    assert seen.singular[none].max(initial=0.0) < 1e-11
    assert seen.singular[~none].min() > 1e-3


@pytest.mark.parametrize("name", SWINGING)
def test_no_reading_shows_the_invisible_and_the_gramian_says_how_much_the_others_show(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Other starts and widths, simulated: along the invisible changes readings stay.

    Along any other they differ as the Gramian has it.
    """
    monkeypatch.setattr(nonlinear, "CAP", 1e9)
    leaving_fast = {"upright": 1.5, "two links": 1.5, "cart and pole": 3.0}  # their neighbours
    run = swinging(name, leaving_fast.get(name, 6.0))
    found, n, p = run.observability(), run.model.n, run.model.p
    rms = np.sqrt(reading_variance(run.sensor))

    def readings(change: Floats) -> Floats:
        d = np.stack([run.sensor.right, run.sensor.left], axis=1) + change[n:].reshape(p, 2)
        return deadzone(outputs(run.model, run.x[0] + change[:n], run.u)[1], d[:, 0], d[:, 1])

    hidden = found.hidden.scale[:, None] * found.hidden.basis
    for direction in np.vstack([found.follow @ hidden, hidden]).T:
        small = 1e-5 * direction / np.linalg.norm(direction)
        assert np.abs(readings(small) - readings(0 * small)).max() < 1e-9
    rng = np.random.default_rng(0)
    for _ in range(5):
        direction = 1e-8 * rng.normal(size=n + 2 * p)
        differ = np.linalg.norm((readings(direction) - readings(-direction)) / 2 / rms)
        assert differ == pytest.approx(np.linalg.norm(found.root @ direction), rel=0.02)


@pytest.mark.parametrize(
    "name", ["upright", "two links", "two links on a table", "a bent integrator"]
)
@pytest.mark.parametrize("thinner", [1, 6])
def test_long_steps_tell_nearly_the_same(
    name: str, thinner: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = swinging(name)
    exact = run.observability()
    no_bias = np.zeros((run.model.m, 0))
    rates = linearised_run._build_derivatives(run.model, run.model.rate, no_bias, ())
    work = rates.n_instructions() * len(run.x)
    monkeypatch.setattr(linearised_run, "WORK", 1.5 * work / thinner)
    found = run.observability()
    assert found.tolerance > exact.tolerance
    for i in range(run.model.p):
        assert found.output_deviations(i) == pytest.approx(exact.output_deviations(i), rel=0.01)


def test_a_run_in_continuous_time() -> None:
    """The bent integrator's invisible change is not constant: an error of steps would show it."""
    run = simulate(
        convert(
            tables_of("""
                plant.f = ["F / (1 + s**2)"]
                plant.h = ["s + s**3 / 3"]
                plant.states = ["s"]
                plant.inputs = ["F"]
                sensor = { right = 0.3, left = 0.2 }
                reference = { kind = "sine", amplitude = 1.5, frequency = 2.0 }
                observer = { method = "certified", L = [1.0], gamma = 5.0, widths0 = [0.1, 0.1] }
                controller = { method = "state_feedback", alpha = 5.0 }
                """)
            | {"simulation": {"duration": 6.0, "step": STEP}}
        ),
        check_step=False,
    )
    model = system(SWINGING["a bent integrator"][0])
    (found,) = width_identifiability_along(
        model, run.x, run.u, run.z, resolve(Sensor(right=0.3, left=0.2), 1, STEP), STEP
    )
    assert found[:4] == (False, False, True, False)


@settings(max_examples=40)
@given(
    seeds,
    st.integers(1, 3),
    st.integers(1, 2),
    st.booleans(),
    st.booleans(),
    st.booleans(),
)
def test_linear_plants_are_judged_as_by_their_matrices(
    seed: int, n: int, p: int, integrator: bool, discrete: bool, biased: bool
) -> None:
    """Edges are reached or not as chance has it."""
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, n, 1, p)
    if integrator:
        A, B, C = plant.linear
        plant = linear(np.where(np.arange(n) == 0, 0.0, A), B, C)
    model = sample_plant(plant, 0.02)
    t = np.arange(1500) * 0.02
    u = np.sin(np.outer(t, rng.uniform(1, 3, 4))) @ rng.normal(size=(4, 1))
    x, z = outputs(model, rng.normal(size=n), u)
    widths = np.abs(z).max(axis=0)[:, None] * rng.choice([0.3, 0.5, 2.0], size=(p, 2))
    sensor = resolve(Sensor(right=widths[:, 0], left=widths[:, 1]), p, 0.02)
    model = model if discrete else plant
    bias = unknown_bias(Step(amplitude=1.0), np.eye(1)) if biased else None
    expected = width_identifiability(
        model.linear,
        schedule_of_record(z, sensor, 0.02, model.Ts),
        None if bias is None else model.linear.B @ bias,
    )
    found = width_identifiability_along(model, x, u, z, sensor, 0.02, bias=bias)
    assert [verdict[:4] for verdict in found] == [verdict[:4] for verdict in expected]
    assert [bool(verdict.reasons) for verdict in found] == [
        bool(verdict.reasons) for verdict in expected
    ]


@pytest.mark.parametrize("a", [1.02, 0.98, 1.0])
def test_growth_and_decay_over_hundreds_of_powers_of_ten(a: float) -> None:
    """x+ = a x, always on the right, x(0) unknown.

    The information on d_r is n - (sum a^k)^2 / sum a^2k, near n - (1 + a)/|1 - a|.
    """
    model = sample_plant(linear([[0.0]], [[1.0]], [[1.0]]), 1.0)
    model = model._replace(
        params=model.params._replace(A=np.array([[a]])),
        linear=model.linear._replace(A=np.array([[a]])),
    )
    N = 20000
    found = observability_along(
        model, np.ones((N, 1)), np.zeros((N, 1)), np.ones((N, 1)), 1.0, np.array([0.04])
    )
    expected = np.inf if a == 1.0 else 0.2 / np.sqrt(N - (1 + a) / abs(1 - a))
    assert found.output_deviations(0)["right"] == pytest.approx(expected, rel=1e-6)
    assert found.output_deviations(0)["left"] == np.inf


@pytest.mark.parametrize("name", ["cart and pole", "motor of an elastic joint on a table"])
def test_what_is_known_very_well_need_not_be_known_better(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Over 20 s of balancing x(0) shows e^60-fold.

    A link behind a spring shows far better over many blocks than over one.
    """
    run = swinging(name, 20.0)
    capped = run.observability()
    monkeypatch.setattr(nonlinear, "CAP", 1e8)
    found = run.observability()
    for i in range(run.model.p):
        assert capped.hidden.is_width_known(i, "centre") == (i == 1)
        assert capped.output_deviations(i) == pytest.approx(found.output_deviations(i), rel=1e-6)


def test_a_known_start_tells_the_centre() -> None:
    run = swinging("one link on a table")
    (found,) = run.verdicts(prior=np.array([1e-3, np.inf]))
    assert found[:4] == (True, True, True, True)
    assert found.std is not None
    assert found.std["centre"] == pytest.approx(1e-3, rel=1e-3)  # both edges shift with the start
    (unsure,) = run.verdicts(prior=np.array([0.4, np.inf]))
    assert unsure[:4] == (False, False, True, False)
    assert unsure.reasons[0].startswith("practically not")


def test_what_else_is_unknown_costs_the_centre() -> None:
    """A constant torque, or where a spring rests, shifts a mass on a spring as its edges do."""
    for name, growth in (("duffing", 1.5), ("pendulum", 3.6)):
        run = swinging(name)
        (alone,), (found,) = run.verdicts(), run.verdicts(bias=np.eye(1))
        assert found.centre  # not linear in the position: a shift changes the motion
        assert alone.std is not None
        assert found.std is not None
        assert found.std["centre"] == pytest.approx(growth * alone.std["centre"], rel=0.05)
    soft = Plant(
        f=["v", "-k*(s - s0) - c*v + F"],
        h=["s"],
        states=["s", "v"],
        inputs=["F"],
        parameters={"k": 2.0, "c": 0.5, "s0": 0.0},
    )
    model = sample_plant(system(soft), STEP, 1)
    u = 2 * np.sin(1.5 * STEP * np.arange(3000))[:, None]
    x, z = outputs(model, np.zeros(2), u)
    run = Trial(model, x, u, z, run.sensor)
    assert run.verdicts()[0][:4] == (True, True, True, True)
    (found,) = run.verdicts(bias=np.eye(1))
    assert (found.width, found.centre) == (True, False)
    assert found.reasons == (
        "the centre is not identifiable: constant input bias, centre and bias cannot be separated",
    )
    (found,) = run.verdicts(uncertain=["s0"])
    assert (found.width, found.centre) == (True, False)
    assert "with s0 uncertain" in found.reasons[0]
    (found,) = run.verdicts(uncertain=["k", "c"])
    assert found.centre


def test_noise_may_leave_nothing_of_a_width() -> None:
    run = swinging("pendulum")
    (found,) = run._replace(
        sensor=resolve(Sensor(right=0.3, left=0.2, noise=100.0, threshold=0.0), 1, STEP)
    ).verdicts()
    assert found[:4] == (False, False, False, False)
    assert found.reasons[0].startswith("practically not")


def test_an_edge_that_is_not_reached() -> None:
    run = swinging("pendulum")
    (found,) = run._replace(sensor=resolve(Sensor(right=0.3, left=2.0), 1, STEP)).verdicts()
    assert found[:4] == (True, False, False, False)
    assert found.reasons[0].startswith("the left edge is never reached")


def test_a_jump_sensor_and_a_run_that_diverges() -> None:
    run = swinging("two links on a table")
    jump = run._replace(
        sensor=resolve(Sensor(right=0.3, left=0.2, kind="jump"), 2, STEP)
    ).verdicts()
    assert [verdict[:4] for verdict in jump] == [(True,) * 4] * 2
    x = np.vstack([run.x[:2000], np.full((1000, 4), np.nan)])
    z = np.vstack([run.z[:2000], np.full((1000, 2), np.nan)])
    short = run._replace(x=run.x[:2000], u=run.u[:2000], z=run.z[:2000])
    assert run._replace(x=x, z=z).verdicts() == short.verdicts()


def test_every_reading_weighs_once() -> None:
    """Readings count at the nearest kept sample, by side, up to half a step after the last."""
    side = np.array([1, 1, 0, -1, -1, -1, 1, 0, 1, 1])[:, None]
    weight = nonlinear.reading_weights(np.array([0, 4, 8]), side, np.array([0.25]))
    assert weight.shape == (3, 1, 2)
    assert 0.25 * weight[:, 0] ** 2 == pytest.approx(np.array([[2, 0], [0, 3], [3, 0]]))
    alone = nonlinear.reading_weights(np.array([0]), side, np.array([1.0]))
    assert alone.tolist() == [[[1.0, 0.0]]]


def test_the_exponent_of_a_long_step_is_of_fourth_order() -> None:
    """x' = (A + t B) x, whose rates do not commute, against many short steps."""
    A, B = np.array([[0.0, 1.0], [-2.0, -0.3]]), np.array([[0.2, 0.0], [-1.0, 0.5]])

    def over(steps: int) -> Floats:
        h, total = 1.0 / steps, np.eye(2)
        for k in range(steps):
            rates = [(A + t * B)[None] for t in (k * h, (k + 0.5) * h, (k + 1) * h)]
            total = (
                matrix_exponentials(linearised_run._magnus_exponent(*rates, np.array(h)))[0] @ total
            )
        return total

    exact = over(512)
    coarse, fine = (float(np.abs(over(steps) - exact).max()) for steps in (4, 8))
    assert coarse / fine == pytest.approx(16, rel=0.15)


def test_exponentials_of_many_matrices() -> None:
    rng = np.random.default_rng(0)
    X = rng.normal(size=(20, 4, 4)) * 10 ** rng.uniform(-3, 1, (20, 1, 1))
    for E, one in zip(matrix_exponentials(X), X, strict=True):
        assert pytest.approx(expm(one), rel=1e-10, abs=1e-10 * np.abs(expm(one)).max()) == E


def test_a_step_of_magnus_is_of_fourth_order() -> None:
    """With the commutator's sign turned it would be of second."""
    rng = np.random.default_rng(1)
    A, slope = rng.normal(size=(2, 1, 3, 3))
    off = []
    for h in (0.1, 0.05):
        exact = np.eye(3)
        for t in (np.arange(2000) + 0.5) / 2000 * h:
            exact = expm((A + t * slope)[0] * h / 2000) @ exact
        exponent = linearised_run._magnus_exponent(
            A, A + h / 2 * slope, A + h * slope, np.full((1, 1, 1), h)
        )
        off.append(np.abs(expm(exponent[0]) - exact).max())
    assert off[0] < 1e-5
    assert off[0] > 20 * off[1]  # a factor of 2^5 a step


@pytest.mark.parametrize("part", ["steps", "outputs"])
def test_a_run_ends_where_one_entry_of_a_derivative_is_not_finite(part: str) -> None:
    steps, outputs = np.zeros((5, 2, 4)), np.zeros((5, 1, 4))
    {"steps": steps, "outputs": outputs}[part][3, 0, 1] = np.nan
    cut = _assemble_run(steps, outputs, np.arange(5), 1e-9)
    assert len(cut.steps) == len(cut.outputs) == 3


@pytest.mark.parametrize(("lost", "state"), [("right", "x[0]"), ("left", "x[1]")])
def test_the_state_that_shifts_is_that_of_the_lost_edge(
    monkeypatch: pytest.MonkeyPatch, lost: str, state: str
) -> None:
    """Of output 1: its right edge hides behind x[0], its left one behind x[1]."""
    monkeypatch.setattr(nonlinear, "symmetric", lambda model, change: False)
    hidden: Any = SimpleNamespace(scale=np.ones(4), basis=np.eye(4)[:, 2:])
    hidden.restrict_to_part = lambda part: SimpleNamespace(
        basis=hidden.basis, is_width_known=lambda i, name: False
    )
    known: Any = SimpleNamespace(hidden=hidden, follow=np.eye(2, 4, k=2))
    model: Any = SimpleNamespace(arm=None, n=2)
    words = nonlinear._describe_state_shift(model, known, 1, lost, "edge", "rest")
    assert f"along this run {state} can shift with the edges" in words


def test_what_follows_a_state_that_diverged_tells_nothing() -> None:
    """One of two states leaves all bounds where readings tell; inputs and the other stay small."""
    trial = swinging("pendulum")
    row = 300 + int(np.flatnonzero(trial.side[300:, 0])[0])
    whole = trial._replace(x=trial.x.copy())
    whole.x[row:, 0] = 1e12
    before = Trial(trial.model, trial.x[:row], trial.u[:row], trial.z[:row], trial.sensor)
    assert whole.verdicts()[0].std == before.verdicts()[0].std
