"""Run the paper's observer and law, and `contact`, on a link behind gears with a gap.

The gap hides the link from the encoder at the motor. The paper's observer and law (29) are given
the arm that hangs down, linearised, without the gap, and d^(0) = d (A2), d half of the gap.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.controllers import ComputedTorque
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Reading, require_graph
from undeadzone.linalg.poles import observer_gain
from undeadzone.nonlinearities.sensor import Sensor, resolve
from undeadzone.numerics.runge_kutta import rk4
from undeadzone.observers.contact import Contact
from undeadzone.plants.build import system
from undeadzone.plants.options import OneLink, Plant
from undeadzone.plants.robots.geared import Gears
from undeadzone.results.run import LAST
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.scenario.schema import Scenario, Simulation
from undeadzone.signals.exosystem import Sine
from undeadzone.simulation.simulate import simulate
from undeadzone.util import tree
from undeadzone.util.arrays import Floats
from undeadzone_paper.example import ALPHA, POLES
from undeadzone_paper.law import PrintedLaw
from undeadzone_paper.measures import rms_or_inf
from undeadzone_paper.observer import Printed

HALF_GAP: Final = 0.05  # [rad]
MOTOR: Final = 0.08  # inertia as felt at the joint [kg m^2]
VISCOUS: Final = 0.4  # [N m s/rad]
DOWN: Final = -np.pi / 2  # angle at which the link hangs [rad]
FREQUENCY: Final = 0.5  # of the reference [Hz]
SWING: Final = 0.8  # amplitude of the reference about it [rad]
WORDS: Final = {True: "with d - d^ given", False: "with d - d^ estimated"}


class ArmRuns(NamedTuple):
    """Errors of the link's angle over the last 2 s, as rms [rad].

    Attributes:
        tracking: link less reference as printed, by how the law knows d - d^
        estimation: estimate less link as printed, likewise
        contact_tracking, contact_estimation: the same of `contact` with `computed_torque`
    """

    tracking: dict[str, float]
    estimation: dict[str, float]
    contact_tracking: float
    contact_estimation: float


def geared_arm() -> Scenario:
    """Build the scenario of the arm with `contact` and `computed_torque`."""
    gears = Gears(half=HALF_GAP, inertia=MOTOR, friction=0.3, viscous=VISCOUS)
    return Scenario(
        title="One-link arm behind gears with a gap, encoder at the motor",
        plant=Plant(arm=OneLink(gears=gears), x0=[DOWN, 0.0]),
        sensor=Sensor(right=0.0, left=0.0, noise=1e-3),
        reference=Sine(amplitude=SWING, frequency=FREQUENCY, offset=DOWN),
        observer=Contact(half=[0.0, 0.15], starts=1),
        controller=ComputedTorque(bandwidth=14.0),
        simulation=Simulation(time="sampled", duration=10.0, step=2e-3, substeps=4),
    )


def hanging_arm() -> Plant:
    """Return the arm about its hanging angle, linear, rigid, motor included."""
    arm = system(Plant(arm=OneLink()))
    mass, _, centre, own, gravity, *_ = np.asarray(arm.params).tolist()  # in the order of its names
    inertia = MOTOR + (mass * centre**2 + own)
    return Plant(
        A=[[0.0, 1.0], [-(mass * centre * gravity / inertia), -VISCOUS / inertia]],
        B=[[0.0], [1 / inertia]],
        C=[[1.0, 0.0]],
    )


def run_arm() -> ArmRuns:
    """Run the arm with the paper's observer and law, and with `contact`."""
    scenario = geared_arm()
    problem = resolve_scenario(scenario)
    contact = simulate(scenario, check_step=False)
    last = slice(-round(LAST / scenario.simulation.step), None)
    tracking, estimation = {}, {}
    for given, words in WORDS.items():
        link, estimate, reference = _run_as_printed(problem, given)
        tracking[words] = rms_or_inf((link - reference)[last])
        estimation[words] = rms_or_inf((estimate - link)[last])
    return ArmRuns(tracking, estimation, contact.rms_tracking, contact.rms_estimation)


def _run_as_printed(problem: Problem, given: bool) -> tuple[Floats, ...]:
    """Run the arm with the paper's observer and law.

    Args:
        problem: of the arm
        given: whether the law is given d - d^

    Returns:
        Angle of the link, its estimate, and the reference, all about the hanging arm (N) [rad].
    """
    simulation = problem.scenario.simulation
    t = np.arange(problem.steps + 1) * simulation.step
    reference = SWING * np.sin(2 * np.pi * FREQUENCY * t)
    advance, start = _close_printed_loop(problem, given)
    _, angles = advance.mapaccum(t.size)(start, reference)
    return *np.asarray(angles), reference


def _close_printed_loop(problem: Problem, given: bool) -> tuple[ca.Function, Floats]:
    """Return the loop of a step as a function, and its state at t = 0.

    The function takes (state, reference) to (next state, `[link; its estimate]` about the hanging
    arm). Reading and torque are held for the step.
    """
    plant = problem.plant
    step = problem.scenario.simulation.step
    model = system(hanging_arm())
    L = observer_gain(model.linear, POLES, None).ravel()
    zone = resolve(Sensor(right=HALF_GAP, left=HALF_GAP), 1, step)
    observer = require_graph(Printed(L=L, alpha=ALPHA, widths0=HALF_GAP).build(model, zone))
    law = PrintedLaw(L=L, alpha=ALPHA, widths=HALF_GAP if given else None).build(model)
    first = observer.init(observer.params)
    size = tree.count_numbers(first)
    state = ca.SX.sym("s", plant.n + size)
    reference = ca.SX.sym("r")
    x = state[: plant.n]
    column = state[plant.n :]
    reading = Reading(plant.read(plant.params, x) - DOWN, ca.SX.zeros(1))
    nothing = ca.SX.zeros(1)
    s = tree.unpack_column(first, column)
    _, estimate = observer.step(observer.params, s, nothing, reading)
    _, u = law.step(law.params, None, estimate, Target(reference, nothing, nothing))

    def rate(column: ca.SX, share: float) -> ca.SX:
        """Return the derivative of the observer's state, with y and u held."""
        s = tree.unpack_column(first, column)
        return tree.stack_leaves(observer.step(observer.params, s, u, reading)[0])

    following = ca.vertcat(plant.move(plant.params, x, u), rk4(rate, column, step))
    angles = ca.vertcat(plant.output(plant.params, x) - DOWN, estimate.z)
    function = ca.Function("step", [state, reference], [following, angles], {"cse": True})
    return function, np.append(problem.x0, tree.pack_tree(first))
