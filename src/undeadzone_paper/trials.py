"""The numbers behind each claim: its quantity as printed, as repaired, and those of its reason."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Final, NamedTuple, TypeAlias

import casadi as ca
import msgspec
import numpy as np
from scipy.optimize import brentq

from undeadzone.interfaces import Reading, graph_of
from undeadzone.linalg.hold import zoh
from undeadzone.linalg.matrices import Matrices
from undeadzone.linalg.poles import observer_gain
from undeadzone.linalg.riccati import paper_riccati
from undeadzone.nonlinearities.sensor import (
    deadzone,
    offset,
    resolve,
    saturation,
    saturation_bound,
    zone,
)
from undeadzone.plants.build import matrices, system
from undeadzone.registry import OBSERVERS
from undeadzone.results.run import Run
from undeadzone.scenario.schema import Scenario
from undeadzone.util import tree
from undeadzone.util.arrays import Floats
from undeadzone_paper import measures as m
from undeadzone_paper.equations import EQUATIONS, FIGURES
from undeadzone_paper.evidence import BEGUN, CONDITIONS, RESTING, SLOPE, Evidence, Pair
from undeadzone_paper.example import L_POLES, L_PRINTED, POLES, D, printed_example, repaired_example

Measure: TypeAlias = Callable[[Run], float]


class Measured(NamedTuple):
    """What was measured for a claim.

    Attributes:
        printed: its quantity as printed, by case; empty: no equation has it
        repaired: its quantity as repaired; None: there is nothing to repair
        named: numbers that its reason names
    """

    printed: dict[str, float]
    repaired: float | None
    named: dict[str, float] = {}


Numbers: TypeAlias = dict[str, Measured]  # by the claim's id

SHARPNESS: Final = 100.0  # k_s of tanh(k_s y), (8)
EQUAL: Final = 1e-12  # rms of y^ - y up to which they are equal
POSITIVE, NEGATIVE = "with d_l > 0", "with d_l < 0"


def measure(evidence: Evidence) -> Numbers:
    """What was measured, by the claim's id; of several runs the worst counts."""
    return {
        **_sensor(evidence),
        **_slope(evidence),
        **_gains(matrices(printed_example(1.0).plant)),
        **_observer(evidence),
        **_robust(evidence),
        **_remedies(evidence),
        **_paper(evidence),
        **_others(),
    }


def _worst(measure: Measure, runs: Iterable[Run]) -> float:
    """Return the largest value of a quantity among runs."""
    return max(measure(run) for run in runs)


def _cases(measure: Measure, evidence: Evidence) -> dict[str, float]:
    """Return the largest value of a quantity for each way to start the example as printed."""
    return {case: _worst(measure, runs) for case, runs in evidence.printed.items()}


def _pair(measure: Measure, pair: Pair) -> Measured:
    """Return a quantity on runs under the same conditions."""
    return Measured(_one(_worst(measure, pair.printed)), _worst(measure, pair.repaired))


def _one(value: float) -> dict[str, float]:
    """Return a value of the example as printed that has one case only."""
    return {"": value}


def _sensor(e: Evidence) -> Numbers:
    """Return claims on the dead zone itself."""
    z = np.linspace(-5.0, 5.0, 1001)
    z = z[np.abs(z) > D]
    y, side = deadzone(z, D, D), zone(z, D, D)
    printed_form = z - D * (side < 0) - D * (side > 0)  # (11) with chi_bar = [chi_r, chi_l]
    signed_form = z + D * (side < 0) - D * (side > 0)  # the same with d_l = -D
    corrected = z - offset(side, D, D)
    decomposition = {POSITIVE: _largest(y - printed_form), NEGATIVE: _largest(y - signed_form)}
    taken_off = float(np.abs(saturation(z, D, D)).max())
    widths = {
        POSITIVE: max(0.0, taken_off - abs(D - D)),
        NEGATIVE: max(0.0, taken_off - abs(D + D)),
    }
    smooth = _worst(_smooth_indicator_error, e.printed[RESTING])
    figure_1 = {
        "with x the output": _worst(_apart_from_output, e.printed[BEGUN]),
        "with x the input": _worst(_apart_from_input, e.printed[BEGUN]),
    }
    return {
        "decomposition": Measured(decomposition, _largest(y - corrected)),
        "width-bound": Measured(widths, max(0.0, taken_off - saturation_bound(D, D))),
        "figure-1": Measured(figure_1, _worst(_apart_from_output, e.repaired)),
        "indicators": Measured(_one(smooth), _worst(m.side_error, e.repaired)),
    }


def _slope(e: Evidence) -> Numbers:
    """Return the claim on m: what a reading that is divided by it differs by, and what comes of
    it.
    """
    z = np.linspace(-5.0, 5.0, 1001)
    divided = deadzone(z, D, D, SLOPE) / SLOPE
    of_reading = _largest(divided - deadzone(z, D, D))
    return {"unit-slope": Measured(_one(of_reading), m.difference(e.repaired[0], e.scaled))}


def _apart_from_output(run: Run) -> float:
    """Return the largest difference of y from the dead zone of the plant's output."""
    return _largest(run.y - deadzone(run.z, D, D))


def _apart_from_input(run: Run) -> float:
    """Return the largest difference of y from the dead zone of the plant's input."""
    return _largest(run.y - deadzone(run.u, D, D))


def _largest(values: Floats) -> float:
    """Return the largest size among values."""
    return float(np.abs(values).max())


def _smooth_indicator_error(run: Run) -> float:
    """Return the largest error of the smooth indicators as printed."""
    return m.indicator_error(run, SHARPNESS)


def _gains(linear: Matrices) -> Numbers:
    """Return claims on the gains (40) and (42)."""
    placed = observer_gain(linear, POLES, None).ravel()
    poles = np.sort(np.linalg.eigvals(_closed_matrix(linear, L_PRINTED)).real)
    where = {"leftmost": float(poles[0]), "rightmost": float(poles[-1])}
    printed_drift, placed_drift = _closed_matrix(linear, L_PRINTED), _closed_matrix(linear, L_POLES)
    brink = {"brink": unstable_from(linear, placed_drift)}
    return {
        "observer-poles": Measured(
            _one(pole_error(linear, L_PRINTED)), pole_error(linear, placed), where
        ),
        "riccati-gain": Measured(
            _one(_rightmost_of_all(linear, printed_drift)),
            _rightmost_of_all(linear, linear.A),
            brink,
        ),
    }


def _closed_matrix(linear: Matrices, L: Iterable[float]) -> Floats:
    """Return A - L C of a plant of order 2."""
    return linear.A - np.reshape(np.asarray(L), (2, 1)) @ linear.C


def pole_error(linear: Matrices, L: Iterable[float]) -> float:
    """Return the largest distance [1/s] of a pole of A - L C from where the paper wants it."""
    poles = np.sort(np.linalg.eigvals(_closed_matrix(linear, L)))
    return float(np.abs(poles - np.sort(POLES)).max())


def rightmost(linear: Matrices, drift: Floats, alpha: float) -> float:
    """Return the rightmost pole [1/s] of A - B K, K by the Riccati equation (34) with `drift` for
    A.
    """
    K = paper_riccati(drift, linear.B, alpha, np.eye(2)).K
    return float(np.linalg.eigvals(linear.A - linear.B @ K).real.max())


def _rightmost_of_all(linear: Matrices, drift: Floats) -> float:
    """Return the same in the worst of all alpha that are tried."""
    alphas = np.geomspace(CONDITIONS["least_alpha"], CONDITIONS["most_alpha"], 51)
    return max(rightmost(linear, drift, float(alpha)) for alpha in alphas)


def unstable_from(linear: Matrices, drift: Floats) -> float:
    """Return the least alpha, between its bounds, from which A - B K with K of (34) is unstable."""

    def excess(exponent: float) -> float:
        return rightmost(linear, drift, 10.0**exponent)

    ends = np.log10([CONDITIONS["least_alpha"], CONDITIONS["most_alpha"]])
    return 10.0 ** float(brentq(excess, *ends, xtol=1e-12))


def _observer(e: Evidence) -> Numbers:
    """Return claims on what the observer and its loop do."""
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
        "adaptation-bounded": m.growth_of_widths,
        "cancelled": m.inverse_error,
        "cancelled-in-total": m.total_inverse_error,
        "tracking": m.tracking_error,
    }
    numbers = {
        name: Measured(_cases(test, e), _worst(test, e.repaired)) for name, test in tests.items()
    }
    silent = e.printed[RESTING][0]
    numbers["tracking"] = numbers["tracking"]._replace(
        named={"moved": float(np.abs(silent.z[silent.last]).max())}
    )
    rises = _worst(m.rise, (*e.repaired, e.sampled))
    return numbers | _of_widths(e) | {"lyapunov": Measured(_cases(m.rise, e), rises)}


def _of_widths(e: Evidence) -> Numbers:
    """Return claims on widths that are known, and on widths that are not."""
    implied = {
        case: _worst(m.width_error, runs)
        for case, runs in e.printed.items()
        if _worst(m.reading_error, runs) <= EQUAL
    }
    unaware = {case: m.width_error(run) for case, run in e.unaware.items()}
    beforehand = max(abs(width - D) for width in e.identified)
    return {
        "implied": Measured(
            implied, _worst(m.width_error, e.aware), {"silent": m.width_error(e.silent)}
        ),
        "unknown-width": Measured(unaware, m.width_error(e.repaired[0])),
        "predetermined": Measured(_one(beforehand), None),
    }


def _error_of_x1(run: Run) -> float:
    """Return rms of x^1 - x1 over the last 2 s."""
    return m.state_error(run, 0)


def _error_of_x2(run: Run) -> float:
    """Return rms of x^2 - x2 over the last 2 s."""
    return m.state_error(run, 1)


def _robust(e: Evidence) -> Numbers:
    """Return claims on bounded signals and on robustness."""
    off_nominal = (*e.noisy.repaired, *e.mismatched.repaired, *e.disturbed.repaired)
    bounded = _worst(_diverges, (*e.repaired, e.sampled, *off_nominal))
    diverging = _cases(_diverges, e)
    return {
        "bounded": Measured(diverging, bounded),
        "unstable": Measured(_one(1.0 - max(diverging.values())), None),
        "global": _pair(m.width_error, e.far),
        "robust-noise": _pair(m.width_error, e.noisy),
        "robust-model": _pair(m.width_error, e.mismatched),
        "robust-disturbance": _pair(m.width_error, e.disturbed),
    }


def _diverges(run: Run) -> float:
    """Return 1 where a run diverges, else 0."""
    return float(run.divergence_time is not None)


def _remedies(e: Evidence) -> Numbers:
    """What the paper says would help: a tanh term, a filter, identification."""
    without, with_term = (m.tracking_error(run) for run in e.held)
    in_noise, in_gust = (m.width_error(run) for run in e.filtered)
    filtered = {
        "with noise on y": in_noise / _worst(m.width_error, e.noisy.repaired),
        "with a disturbance": in_gust / _worst(m.width_error, e.disturbed.repaired),
    }
    beforehand = max(abs(width - D) for width in e.identified)
    return {
        "tanh-term": Measured({}, with_term / without),
        "filtering": Measured(filtered, None),
        "identification": Measured(_one(beforehand / m.width_error(e.logged)), None),
    }


def _paper(e: Evidence) -> Numbers:
    """Return claims on cost and on what the paper says it compared."""
    return {
        "practical": Measured(
            _one(operations(printed_example(5.0))), operations(repaired_example(5.0))
        ),
        "too-slow": Measured(_one(m.rate(e.slow)), m.rate(e.repaired[0])),
        "beta": _missing("beta"),
        "compared": _missing("fuzzy", "neural", "sliding mode"),
        "manipulator": _missing("manipulator"),
        "effort": _missing("control effort"),
    }


def _missing(*words: str) -> Measured:
    """How many of these words no caption and no equation holds; nothing can repair that."""
    shown = "\n".join([*FIGURES.values(), *(equation.what for equation in EQUATIONS)])
    return Measured(_one(float(sum(word not in shown for word in words))), None)


OTHERS: Final[dict[str, dict[str, Any]]] = {
    "with fuzzy logic": {"method": "fuzzy_residual", "reach": 5.0},
    "with a network": {"method": "rbf_residual", "reach": 5.0},
    "with a sliding mode": {"method": "walcott_zak"},
}
"""Observers of the kinds that the paper calls too complex, as other packages register them."""

SIMPLE: Final = 1000.0  # operations that a practical step may take


def _others() -> Numbers:
    """Return claims on what others do: how much a step of theirs takes, and whether it chatters."""
    example = repaired_example(5.0)
    steps = {}
    for name, table in OTHERS.items():
        observer = OBSERVERS.decode_options(table)
        steps[name] = SIMPLE / operations(msgspec.structs.replace(example, observer=observer))
    calm = {"with the sign": calm_share(np.sign), "with tanh(k_s s)": calm_share(_smooth_sign)}
    return {"others-too-complex": Measured(steps, None), "chattering": Measured(calm, None)}


def _smooth_sign(s: float) -> float:
    """Return the sign by (8)."""
    return float(np.tanh(SHARPNESS * s))


def calm_share(switch: Callable[[float], float], gain: float = 5.0, step: float = 1e-3) -> float:
    """Return share of the steps in which u of a sliding mode does not jump by half of its gain.

    The plant (39) is held at 0 from x = (1, 0): s = 2 x1 + x2, u = x1 - gain switch(s), the state
    is measured, u is held for a step, and the last 2 s of 5 s count.

    Args:
        switch: in place of the sign of s
        gain: of the switched part
        step: of sampling [s]
    """
    Ad, Bd, _ = zoh(matrices(printed_example(1.0).plant), step)
    x, inputs = np.array([1.0, 0.0]), []
    for _ in range(round(5.0 / step)):
        inputs.append(x[0] - gain * float(switch(2.0 * x[0] + x[1])))
        x = Ad @ x + Bd[:, 0] * inputs[-1]
    jumps = np.abs(np.diff(inputs[-round(2.0 / step) :]))
    return float((jumps < gain / 2).mean())


def operations(scenario: Scenario) -> float:
    """Return arithmetic operations of one step of a scenario's observer alone."""
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
