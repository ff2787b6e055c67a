"""The two numbers behind each claim: its quantity as printed and as repaired."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeAlias

import casadi as ca
import numpy as np

from undeadzone.ends.sensor import bound, deadzone, offset, resolve, saturation, zone
from undeadzone.interfaces import Reading, graph_of
from undeadzone.linear.matrices import Matrices
from undeadzone.linear.poles import observer_gain
from undeadzone.linear.riccati import paper_riccati
from undeadzone.plants.build import matrices, system
from undeadzone.results.run import Run
from undeadzone.scenario.schema import Scenario
from undeadzone.support import tree
from undeadzone.support.arrays import Floats
from undeadzone_paper import measures as m
from undeadzone_paper.equations import FIGURES
from undeadzone_paper.evidence import BEGUN, RESTING, Evidence, Pair
from undeadzone_paper.example import ALPHA, L_PRINTED, POLES, D, printed, repaired

Measure: TypeAlias = Callable[[Run], float]
Measured: TypeAlias = tuple[dict[str, float], float]  # as printed by case, as repaired
Numbers: TypeAlias = dict[str, Measured]  # by the claim's id

SHARPNESS = 100.0  # k_s of tanh(k_s y), (8)


def measure(evidence: Evidence) -> Numbers:
    """(as printed by case, as repaired) by the claim's id; of several runs the worst counts."""
    return {
        **_sensor(evidence),
        **_gains(matrices(printed(1.0).plant)),
        **_observer(evidence),
        **_robust(evidence),
        **_paper(evidence),
    }


def _worst(measure: Measure, runs: Iterable[Run]) -> float:
    """The largest value of a quantity among runs."""
    return max(measure(run) for run in runs)


def _cases(measure: Measure, evidence: Evidence) -> dict[str, float]:
    """The largest value of a quantity for each way to start the example as printed."""
    return {case: _worst(measure, runs) for case, runs in evidence.printed.items()}


def _pair(measure: Measure, pair: Pair) -> Measured:
    """A quantity on runs under the same conditions."""
    return _one(_worst(measure, pair.printed)), _worst(measure, pair.repaired)


def _one(value: float) -> dict[str, float]:
    """A value of the example as printed that has one case only."""
    return {"": value}


def _sensor(e: Evidence) -> Numbers:
    """Claims on the dead zone itself."""
    z = np.linspace(-5.0, 5.0, 1001)
    z = z[np.abs(z) > D]
    y, side = deadzone(z, D, D), zone(z, D, D)
    printed_form = z - D * (side < 0) - D * (side > 0)  # (11) with chi_bar = [chi_r, chi_l]
    signed_form = z + D * (side < 0) - D * (side > 0)  # the same with d_l = -D
    corrected = z - offset(side, D, D)
    positive, negative = "with d_l > 0", "with d_l < 0"
    decomposition = {positive: _largest(y - printed_form), negative: _largest(y - signed_form)}
    taken_off = float(np.abs(saturation(z, D, D)).max())
    widths = {
        positive: max(0.0, taken_off - abs(D - D)),
        negative: max(0.0, taken_off - abs(D + D)),
    }
    smooth = _worst(_smooth_indicator_error, e.printed[RESTING])
    slope_printed = m.difference(e.printed[BEGUN][0], e.scaled.printed[0])
    slope_repaired = m.difference(e.repaired[0], e.scaled.repaired[0])
    return {
        "decomposition": (decomposition, _largest(y - corrected)),
        "width-bound": (widths, max(0.0, taken_off - bound(D, D))),
        "indicators": (_one(smooth), _worst(m.side_error, e.repaired)),
        "unit-slope": (_one(slope_printed), slope_repaired),
    }


def _largest(values: Floats) -> float:
    """The largest size among values."""
    return float(np.abs(values).max())


def _smooth_indicator_error(run: Run) -> float:
    """The largest error of the smooth indicators as printed."""
    return m.indicator_error(run, SHARPNESS)


def _gains(linear: Matrices) -> Numbers:
    """Claims on the gains (40) and (42)."""
    placed = observer_gain(linear, POLES, None).ravel()
    rightmost = _rightmost(linear, _closed(linear, L_PRINTED))
    return {
        "observer-poles": (_one(pole_error(linear, L_PRINTED)), pole_error(linear, placed)),
        "riccati-gain": (_one(rightmost), _rightmost(linear, linear.A)),
    }


def _closed(linear: Matrices, L: Iterable[float]) -> Floats:
    """A - L C of a plant of order 2."""
    return linear.A - np.reshape(np.asarray(L), (2, 1)) @ linear.C


def pole_error(linear: Matrices, L: Iterable[float]) -> float:
    """The largest distance [1/s] of a pole of A - L C from where the paper wants it."""
    poles = np.sort(np.linalg.eigvals(_closed(linear, L)))
    return float(np.abs(poles - np.sort(POLES)).max())


def _rightmost(linear: Matrices, drift: Floats) -> float:
    """The rightmost pole [1/s] of A - B K, K by the Riccati equation (34) with `drift` for A."""
    K = paper_riccati(drift, linear.B, ALPHA, np.eye(2)).K
    return float(np.linalg.eigvals(linear.A - linear.B @ K).real.max())


def _observer(e: Evidence) -> Numbers:
    """Claims on what the observer and its loop do."""
    blind = m.state_error(e.blind, 0)

    def relative_to_blind(run: Run) -> float:
        return m.state_error(run, 0) / blind

    tests: dict[str, Measure] = {
        "switching": relative_to_blind,
        "reading-tracked": m.reading_error,
        "state-1": _error_of_x1,
        "state-2": _error_of_x2,
        "displacements": m.steep_share,
        "widths": m.width_error,
        "adaptation-bounded": m.largest_width,
        "cancelled": m.inverse_error,
        "cancelled-in-total": m.total_inverse_error,
        "tracking": m.tracking_error,
    }
    numbers = {name: (_cases(test, e), _worst(test, e.repaired)) for name, test in tests.items()}
    numbers["implied"] = _pair(m.width_error, e.silent)
    numbers["lyapunov"] = (_cases(m.rise, e), _worst(m.rise, (*e.repaired, e.sampled)))
    return numbers


def _error_of_x1(run: Run) -> float:
    """rms of x^1 - x1 over the last 2 s."""
    return m.state_error(run, 0)


def _error_of_x2(run: Run) -> float:
    """rms of x^2 - x2 over the last 2 s."""
    return m.state_error(run, 1)


def _robust(e: Evidence) -> Numbers:
    """Claims on bounded signals and on robustness."""
    off_nominal = (*e.noisy.repaired, *e.mismatched.repaired, *e.disturbed.repaired)
    bounded = _worst(_diverges, (*e.repaired, e.sampled, *off_nominal))
    return {
        "bounded": (_cases(_diverges, e), bounded),
        "robust-noise": _pair(m.width_error, e.noisy),
        "robust-model": _pair(m.width_error, e.mismatched),
        "robust-disturbance": _pair(m.width_error, e.disturbed),
    }


def _diverges(run: Run) -> float:
    """1 where a run diverges, else 0."""
    return float(run.diverged_at is not None)


def _paper(e: Evidence) -> Numbers:
    """Claims on cost and on what the paper says it compared."""
    return {
        "practical": (_one(operations(printed(5.0))), operations(repaired(5.0))),
        "slow-or-unstable": (_one(m.rate(e.slow)), m.rate(e.repaired[0])),
        "compared": _missing("fuzzy", "neural", "sliding mode"),
        "manipulator": _missing("manipulator"),
        "effort": _missing("control effort"),
    }


def _missing(*words: str) -> Measured:
    """How many of these words no caption of a figure holds; nothing can repair that."""
    captions = "\n".join(FIGURES.values())
    count = float(sum(word not in captions for word in words))
    return _one(count), count


def operations(scenario: Scenario) -> float:
    """Arithmetic operations of one step of a scenario's observer alone."""
    model = system(scenario.plant)
    sensor = resolve(scenario.sensor, model.p, scenario.simulation.step)
    observer = graph_of(scenario.observer.build(model, sensor))
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
    instructions = [function.instruction_id(k) for k in range(function.n_instructions())]
    return float(sum(instruction not in moves for instruction in instructions))
