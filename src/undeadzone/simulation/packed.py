"""Packed numbers of a loop that a change moves, found by building it again and comparing."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import casadi as ca
import numpy as np

from undeadzone.interfaces import Reading, require_graph
from undeadzone.scenario.problem import Problem
from undeadzone.simulation.close import loop_numbers, no_target
from undeadzone.simulation.loop import Loop
from undeadzone.util import tree
from undeadzone.util.arrays import Floats, Integers


def pack_problem(problem: Problem, loop: Loop) -> tuple[Floats, Floats]:
    """Return (initial state, params), packed, that a problem gives a loop of its graph.

    Args:
        problem: the numbers' own.
        loop: of a problem with the same `graph`.

    Raises:
        InputError: the observer is not a graph.
    """
    observer = require_graph(problem.observer)
    controller = problem.controller
    state = loop.state._replace(
        plant=problem.x0,
        observer=observer.init(observer.params),
        controller=controller.init(controller.params),
    )
    return tree.pack_tree(state), tree.pack_tree(loop_numbers(problem._replace(observer=observer)))


def changed_params(loop: Loop, others: Iterable[Floats]) -> Integers:
    """Return the places at which packed params of the loop differ from those of any other loop."""
    differ: Any = np.any([other != tree.pack_tree(loop.params) for other in others], axis=0)
    return np.flatnonzero(differ)


def graph(problem: Problem) -> str:
    """Return observer and controller without their numbers, but with those of a plan, as text.

    It is equal for problems that one kernel serves.

    Args:
        problem: the checked parts of a scenario.

    Raises:
        InputError: there is no graph.
    """
    observer = require_graph(problem.observer)
    controller = problem.controller
    model = problem.model
    p_column, p = tree.create_symbols((observer.params, controller.params), "p")
    like = observer.init(observer.params), controller.init(controller.params)
    s_column, s = tree.create_symbols(like, "s")
    t_column, target = tree.create_symbols(no_target(problem), "t")
    u = ca.SX.sym("u", model.m)
    y = ca.SX.sym("y", model.p)
    side = ca.SX.sym("side", model.p)
    x = ca.SX.sym("x", model.n)
    following, estimate = observer.step(p[0], s[0], u, Reading(y, side, x))
    results = (
        following,
        estimate,
        observer.project(p[0], s[0]),
        observer.init(p[0]),
        controller.step(p[1], s[1], estimate, target),
        controller.init(p[1]),
    )
    inputs = [p_column, s_column, t_column, u, y, side, x]
    function = ca.Function("graph", inputs, list(map(tree.stack_leaves, results)))
    plan = () if controller.plan is None else tree.pack_tree(controller.plan.params).tolist()
    return str(function.serialize()) + str((tree.number_addresses((observer.params, like)), plan))
