"""The two numbers behind each claim: its quantity as printed and as repaired."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import casadi as ca
import numpy as np

from undeadzone.interfaces import graph_of
from undeadzone.linear.matrices import Matrices
from undeadzone.linear.poles import observer_gain
from undeadzone.linear.riccati import paper_riccati
from undeadzone.observers import Reading
from undeadzone.paper import measures as m
from undeadzone.paper.equations import FIGURES
from undeadzone.paper.evidence import BEGUN, RESTING, Evidence, Pair
from undeadzone.paper.example import ALPHA, L_POLES, L_PRINTED, POLES, D, printed, repaired
from undeadzone.plants.build import matrices, system
from undeadzone.scenario.schema import Scenario
from undeadzone.sensor import bound, deadzone, offset, resolve, saturation, zone
from undeadzone.simulation.run import Run
from undeadzone.support import tree
from undeadzone.support.arrays import Floats

Numbers = dict[str, tuple[dict[str, float], float]]


def measure(evidence: Evidence) -> Numbers:
    """(as printed by case, as repaired) by the claim's id; of several runs the worst counts."""
    return {
        **_sensor(evidence),
        **_gains(matrices(printed(1.0).plant)),
        **_observer(evidence),
        **_robust(evidence),
        **_paper(evidence),
    }


def _worst(measure: Callable[[Run], float], runs: Iterable[Run]) -> float:
    return max(measure(run) for run in runs)


def _cases(measure: Callable[[Run], float], evidence: Evidence) -> dict[str, float]:
    return {case: _worst(measure, runs) for case, runs in evidence.printed.items()}


def _pair(measure: Callable[[Run], float], pair: Pair) -> tuple[dict[str, float], float]:
    return _one(_worst(measure, pair.printed)), _worst(measure, pair.repaired)


def _one(value: float) -> dict[str, float]:
    return {"": value}


def _sensor(e: Evidence) -> Numbers:
    z = np.linspace(-5.0, 5.0, 1001)
    z = z[np.abs(z) > D]
    y, side, sat = deadzone(z, D, D), zone(z, D, D), float(np.abs(saturation(z, D, D)).max())
    printed_form, corrected = z - D * (side < 0) - D * (side > 0), z - offset(side, D, D)
    return {
        "decomposition": (
            _one(float(np.abs(y - printed_form).max())),
            float(np.abs(y - corrected).max()),
        ),
        "width-bound": (_one(sat - abs(D - D)), max(0.0, sat - bound(D, D))),
        "indicators": (
            _one(_worst(lambda run: m.indicator_error(run, 100.0), e.printed[RESTING])),
            _worst(m.side_error, e.repaired),
        ),
        "unit-slope": (
            _one(m.difference(e.printed[BEGUN][0], e.scaled.printed[0])),
            m.difference(e.repaired[0], e.scaled.repaired[0]),
        ),
    }


def _gains(linear: Matrices) -> Numbers:
    A, B, C = linear

    def closed(L: Iterable[float]) -> Floats:
        return A - np.reshape(np.asarray(L), (2, 1)) @ C

    def off(L: Iterable[float]) -> float:
        return float(np.abs(np.sort(np.linalg.eigvals(closed(L))) - np.sort(POLES)).max())

    def rightmost(drift: Floats) -> float:
        return float(
            np.linalg.eigvals(A - B @ paper_riccati(drift, B, ALPHA, np.eye(2)).K).real.max()
        )

    return {
        "observer-poles": (_one(off(L_PRINTED)), off(observer_gain(linear, POLES, None).ravel())),
        "riccati-gain": (_one(rightmost(closed(L_POLES))), rightmost(A)),
    }


def _observer(e: Evidence) -> Numbers:
    blind = m.state_error(e.blind, 0)
    tests: dict[str, Callable[[Run], float]] = {
        "switching": lambda run: m.state_error(run, 0) / blind,
        "reading-tracked": m.reading_error,
        "state-1": lambda run: m.state_error(run, 0),
        "state-2": lambda run: m.state_error(run, 1),
        "displacements": m.steep_share,
        "widths": m.width_error,
        "adaptation-bounded": m.largest_width,
        "cancelled": m.inverse_error,
        "cancelled-in-total": m.total_inverse_error,
        "tracking": m.tracking_error,
    }
    return {
        **{name: (_cases(test, e), _worst(test, e.repaired)) for name, test in tests.items()},
        "implied": _pair(m.width_error, e.silent),
        "lyapunov": (_cases(m.rise, e), _worst(m.rise, (*e.repaired, e.sampled))),
    }


def _robust(e: Evidence) -> Numbers:
    def diverges(run: Run) -> float:
        return float(run.diverged_at is not None)

    disturbed = (e.noisy, e.mismatched, e.disturbed)
    return {
        "bounded": (
            _cases(diverges, e),
            _worst(
                diverges,
                (*e.repaired, e.sampled, *(run for pair in disturbed for run in pair.repaired)),
            ),
        ),
        **{
            name: _pair(m.width_error, pair)
            for name, pair in zip(
                ("robust-noise", "robust-model", "robust-disturbance"), disturbed, strict=True
            )
        },
    }


def _paper(e: Evidence) -> Numbers:
    def missing(*words: str) -> tuple[dict[str, float], float]:
        count = float(
            sum(not any(word in caption for caption in FIGURES.values()) for word in words)
        )
        return _one(count), count

    return {
        "practical": (_one(_operations(printed(5.0))), _operations(repaired(5.0))),
        "slow-or-unstable": (_one(m.rate(e.slow)), m.rate(e.repaired[0])),
        "compared": missing("fuzzy", "neural", "sliding mode"),
        "manipulator": missing("manipulator"),
        "effort": missing("control effort"),
    }


def _operations(scenario: Scenario) -> float:
    """Arithmetic operations of one step of the observer alone."""
    model = system(scenario.plant)
    observer = graph_of(
        scenario.observer.build(model, resolve(scenario.sensor, model.p, scenario.simulation.step))
    )
    p_column, p = tree.symbols(observer.params, "p")
    s_column, s = tree.symbols(observer.init(observer.params), "s")
    u, y, side = (ca.SX.sym(name) for name in ("u", "y", "side"))
    following, estimate = observer.step(p, s, u, Reading(y, side))
    function = ca.Function(
        "step",
        [s_column, p_column, u, y, side],
        [tree.stack(following), tree.stack(estimate)],
        {"cse": True},
    )
    moves = (ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST)
    return float(
        sum(function.instruction_id(k) not in moves for k in range(function.n_instructions()))
    )
