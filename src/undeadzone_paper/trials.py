"""Numbers for each claim: its quantity as printed, as repaired, and those of its reason."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, Final, NamedTuple, TypeAlias

import casadi as ca
import msgspec
import numpy as np
from scipy.optimize import brentq

from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Estimate, Reading, require_graph
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
from undeadzone.observers.luenberger import Luenberger
from undeadzone.plants.build import system
from undeadzone.plants.options import linear_matrices
from undeadzone.registry import CONTROLLERS
from undeadzone.results.run import Run
from undeadzone.scenario.schema import Scenario
from undeadzone.util import tree
from undeadzone.util.arrays import Floats
from undeadzone_paper import measures as m
from undeadzone_paper.arm import WORDS
from undeadzone_paper.equations import EQUATIONS, FIGURES
from undeadzone_paper.evidence import (
    BEGUN,
    CONDITIONS,
    FIXED_WIDTH,
    LESSER,
    RESTING,
    SLOPE,
    Evidence,
    RunPair,
)
from undeadzone_paper.example import (
    ALPHA,
    L_POLES,
    L_PRINTED,
    L_REPAIRED,
    POLES,
    D,
    example_as_printed,
    example_as_repaired,
)
from undeadzone_paper.law import PrintedLaw
from undeadzone_paper.theorem import (
    ESTIMATED,
    GIVEN,
    OTHER_SIGN,
    RIGHT,
    count_diverging,
    is_kindest,
    select_outcomes,
)

Measure: TypeAlias = Callable[[Run], float]


class ClaimNumbers(NamedTuple):
    """Numbers measured for a claim.

    Attributes:
        printed: its quantity as printed, by case (empty: no equation has it)
        repaired: its quantity as repaired (None: there is nothing to repair)
        named: numbers that its reason names
    """

    printed: dict[str, float]
    repaired: float | None
    named: dict[str, Any] = {}


Numbers: TypeAlias = dict[str, ClaimNumbers]  # by the claim's id

SHARPNESS: Final = 100.0  # k_s of tanh(k_s y), (8)
EQUAL: Final = 1e-12  # rms of y^ - y up to which they are equal
POSITIVE = "with d_l > 0"
NEGATIVE = "with d_l < 0"


def measure_claims(evidence: Evidence) -> Numbers:
    """Compute the numbers of all claims, by id. Of several runs the worst counts."""
    return {
        **_sensor_claims(evidence),
        **_slope_claim(evidence),
        **_gain_claims(linear_matrices(example_as_printed(1.0).plant)),
        **_observer_claims(evidence),
        **_robustness_claims(evidence),
        **_remedy_claims(evidence),
        **_paper_claims(evidence),
        **_comparison_claims(),
        **_theorem_claims(evidence),
        **_input_claims(evidence),
    }


def _worst_value(measure: Measure, runs: Iterable[Run]) -> float:
    """Return the largest value of a quantity among runs."""
    return max(measure(run) for run in runs)


def _worst_by_start(measure: Measure, evidence: Evidence) -> dict[str, float]:
    """Return the largest value of a quantity for each start of the example as printed."""
    return {case: _worst_value(measure, runs) for case, runs in evidence.printed.items()}


def _measure_pair(measure: Measure, pair: RunPair) -> ClaimNumbers:
    """Compute a quantity on runs under the same conditions."""
    return _of_single_case(
        _worst_value(measure, pair.printed), _worst_value(measure, pair.repaired)
    )


def _of_single_case(
    value: float, repaired: float | None, named: dict[str, Any] | None = None
) -> ClaimNumbers:
    """Return the numbers of a claim whose quantity as printed has one case only.

    Args:
        value: the quantity as printed.
        repaired: the same as repaired (None: there is nothing to repair).
        named: numbers that its reason names.
    """
    return ClaimNumbers({"": value}, repaired, named or {})


def _sensor_claims(e: Evidence) -> Numbers:
    """Compute the numbers of the claims on the dead zone itself."""
    z = np.linspace(-5.0, 5.0, 1001)
    z = z[np.abs(z) > D]
    y = deadzone(z, D, D)
    side = zone(z, D, D)
    printed_form = z - D * (side < 0) - D * (side > 0)  # (11) with chi_bar = [chi_r, chi_l]
    signed_form = z + D * (side < 0) - D * (side > 0)  # the same with d_l = -D
    corrected = z - offset(side, D, D)
    decomposition = {
        POSITIVE: m.largest_absolute(y - printed_form),
        NEGATIVE: m.largest_absolute(y - signed_form),
    }
    largest_saturation = m.largest_absolute(saturation(z, D, D))
    widths = {
        POSITIVE: max(0.0, largest_saturation - abs(D - D)),
        NEGATIVE: max(0.0, largest_saturation - abs(D + D)),
    }
    smooth = _worst_value(_smooth_indicator_error, e.printed[RESTING])
    figure_1 = {
        "with x the output": _worst_value(_output_deviation, e.printed[BEGUN]),
        "with x the input": _worst_value(_input_deviation, e.printed[BEGUN]),
    }
    return {
        "decomposition": ClaimNumbers(decomposition, m.largest_absolute(y - corrected)),
        "width-bound": ClaimNumbers(widths, max(0.0, largest_saturation - saturation_bound(D, D))),
        "figure-1": ClaimNumbers(figure_1, _worst_value(_output_deviation, e.repaired)),
        "indicators": _of_single_case(smooth, _worst_value(m.side_error, e.repaired)),
    }


def _slope_claim(e: Evidence) -> Numbers:
    """Compute the numbers of the claim on m: errors of a reading divided by m, and effects."""
    z = np.linspace(-5.0, 5.0, 1001)
    divided = deadzone(z, D, D, SLOPE) / SLOPE
    of_reading = m.largest_absolute(divided - deadzone(z, D, D))
    return {"unit-slope": _of_single_case(of_reading, m.width_difference(e.repaired[0], e.scaled))}


def _output_deviation(run: Run) -> float:
    """Return the largest difference of y from the dead zone of the plant's output [y]."""
    return m.largest_absolute(run.y - deadzone(run.z, D, D))


def _input_deviation(run: Run) -> float:
    """Return the largest difference of y from the dead zone of the plant's input [y]."""
    return m.largest_absolute(run.y - deadzone(run.u, D, D))


def _smooth_indicator_error(run: Run) -> float:
    """Return the largest error of the smooth indicators as printed [1]."""
    return m.indicator_error(run, SHARPNESS)


def _gain_claims(linear: Matrices) -> Numbers:
    """Compute the numbers of the claims on the gains (40) and (42)."""
    placed = observer_gain(linear, POLES, None).ravel()
    poles = np.sort(np.linalg.eigvals(_error_matrix(linear, L_PRINTED)).real)
    where = {"leftmost": float(poles[0]), "rightmost": float(poles[-1])}
    printed_drift = _error_matrix(linear, L_PRINTED)
    placed_drift = _error_matrix(linear, L_POLES)
    of_riccati = {
        "brink": destabilising_alpha(linear, placed_drift),
        "fed": where["rightmost"],
        "fed_back": _worst_rightmost_pole(linear, printed_drift),
    }
    return {
        "observer-poles": _of_single_case(
            pole_error(linear, L_PRINTED), pole_error(linear, placed), where
        ),
        "riccati-gain": _of_single_case(
            max(innovation_loop_pole(linear, alpha) for alpha in _alphas()),
            _worst_rightmost_pole(linear, linear.A),
            of_riccati,
        ),
    }


def _error_matrix(linear: Matrices, L: Iterable[float]) -> Floats:
    """Return A - L C of a plant of order 2 (2 x 2) [1/s]."""
    return linear.A - np.reshape(np.asarray(L), (2, 1)) @ linear.C


def pole_error(linear: Matrices, L: Iterable[float]) -> float:
    """Return the largest distance of a pole of A - L C from the paper's target [1/s]."""
    poles = np.sort(np.linalg.eigvals(_error_matrix(linear, L)))
    return m.largest_absolute(poles - np.sort(POLES))


def rightmost_pole(linear: Matrices, drift: Floats, alpha: float) -> float:
    """Return the rightmost pole of A - B K [1/s], K by (34) with `drift` for A."""
    K = paper_riccati(drift, linear.B, alpha, np.eye(2)).K
    return float(np.linalg.eigvals(linear.A - linear.B @ K).real.max())


def _worst_rightmost_pole(linear: Matrices, drift: Floats) -> float:
    """Return the rightmost pole of A - B K in the worst case of all alpha tried [1/s]."""
    return max(rightmost_pole(linear, drift, alpha) for alpha in _alphas())


def _alphas() -> list[float]:
    """Return the values of alpha that are tried."""
    return np.geomspace(CONDITIONS["least_alpha"], CONDITIONS["most_alpha"], 51).tolist()


def innovation_loop_pole(linear: Matrices, alpha: float) -> float:
    """Return the rightmost pole of the loop that (42) closes outside the zone [1/s].

    There y - y^ = C x~, if the widths are right, and (16) without B u makes
    x~' = (A - L C) x~ - B (k_p C + k_d C (A - L C)) x~, as C B = 0. The plant adds the poles of A.
    """
    _, B, C = linear
    drift = _error_matrix(linear, L_PRINTED)
    k_p, k_d = paper_riccati(drift, B, alpha, np.eye(2)).K[0]
    closed = drift - B @ (k_p * C + k_d * C @ drift)
    return float(np.linalg.eigvals(closed).real.max())


def destabilising_alpha(linear: Matrices, drift: Floats) -> float:
    """Return the least alpha, within bounds, from which A - B K with K of (34) is unstable."""

    def excess(exponent: float) -> float:
        """Return the rightmost pole at alpha = 10^exponent [1/s]."""
        return rightmost_pole(linear, drift, 10.0**exponent)

    ends = np.log10([CONDITIONS["least_alpha"], CONDITIONS["most_alpha"]])
    return 10.0 ** float(brentq(excess, *ends, xtol=1e-12))


def _observer_claims(e: Evidence) -> Numbers:
    """Compute the numbers of the claims on the observer and its loop."""
    blind = m.state_error(e.blind, 0)

    def relative_to_blind(run: Run) -> float:
        """Return the error of x1 relative to that of the blind observer [1]."""
        return m.state_error(run, 0) / blind

    tests: dict[str, Measure] = {
        "switching": relative_to_blind,
        "reading-tracked": m.reading_error,
        "state-1": partial(m.state_error, index=0),
        "state-2": partial(m.state_error, index=1),
        "displacements": m.steep_ratio,
        "widths": m.width_error,
        "adaptation-bounded": m.growth_of_widths,
        "cancelled": m.inverse_error,
        "cancelled-in-total": m.total_inverse_error,
        "tracking": m.tracking_error,
    }
    numbers = {
        name: ClaimNumbers(_worst_by_start(test, e), _worst_value(test, e.repaired))
        for name, test in tests.items()
    }
    silent = e.printed[RESTING][0]
    numbers["tracking"] = numbers["tracking"]._replace(
        named={"moved": m.largest_absolute(silent.z[silent.last])}
    )
    rises = _worst_value(m.lyapunov_rise, (*e.repaired, e.sampled))
    return (
        numbers
        | _width_claims(e)
        | {"lyapunov": ClaimNumbers(_worst_by_start(m.lyapunov_rise, e), rises)}
    )


def _width_claims(e: Evidence) -> Numbers:
    """Compute the numbers of the claims on known widths and on unknown widths."""
    implied: dict[str, float] = {
        case: _worst_value(m.width_error, runs)
        for case, runs in e.printed.items()
        if _worst_value(m.reading_error, runs) <= EQUAL
    }
    unaware = {case: m.width_error(run) for case, run in e.unaware.items()}
    beforehand = max(abs(width.value - D) for width in e.identified)
    return {
        "implied": ClaimNumbers(
            implied,
            _worst_value(m.width_error, (*e.repaired, e.silent)),
            {
                "silent": m.width_error(e.silent),
                "crossing": _worst_value(m.width_error, e.repaired),
                "aware": _worst_value(m.width_error, e.aware),
            },
        ),
        **_reference_claims(e),
        "symmetric": _of_single_case(
            _worst_value(_lopsided_error, e.lopsided.printed),
            _worst_value(_lopsided_error, e.lopsided.repaired),
        ),
        "physical": _of_single_case(
            max((width.high - width.low) / 2 for width in e.identified), None
        ),
        "unknown-width": ClaimNumbers(unaware, m.width_error(e.repaired[0])),
        "predetermined": _of_single_case(beforehand, None),
    }


def _lopsided_error(run: Run) -> float:
    """Return the largest |d^ - d| over the last 2 s [z], or inf if the run diverges."""
    return np.inf if run.divergence_time is not None else m.width_error(run)


def _reference_claims(e: Evidence) -> Numbers:
    """Compute the numbers of the claims on the reference."""
    errors = {amplitude: m.width_error(run) for amplitude, run in e.lesser.items()}
    inside, grazing, _ = e.lesser.values()
    right, left = grazing.d_hat[-1]
    run = e.printed[RESTING][0]
    period = run.r[: round(1.0 / run.info.step), 0]
    return {
        "reference-amplitude": _of_single_case(
            _worst_value(m.width_error, e.unaware.values()),
            max(*errors.values(), _worst_value(m.width_error, e.repaired)),
            {
                "inside": float(inside.d_hat[-1].max()),
                "grazing_right": float(right),
                "grazing_left": float(left),
                "outside": max(errors[LESSER[-1]], _worst_value(m.width_error, e.repaired)),
            },
        ),
        "reference-centre": _of_single_case(
            abs(float(period.mean()) - (D - D) / 2),
            None,
            {"still": m.width_error(e.still)},
        ),
    }


def _robustness_claims(e: Evidence) -> Numbers:
    """Compute the numbers of the claims on bounded signals and on robustness."""
    off_nominal = (*e.noisy.repaired, *e.mismatched.repaired, *e.disturbed.repaired)
    bounded = _worst_value(_divergence_flag, (*e.repaired, e.sampled, *off_nominal))
    diverging = _worst_by_start(_divergence_flag, e)
    return {
        "bounded": ClaimNumbers(diverging, bounded),
        "unstable": _of_single_case(1.0 - max(diverging.values()), None),
        "global": _measure_pair(m.width_error, e.far),
        "robust-noise": _measure_pair(m.width_error, e.noisy),
        "robust-model": _measure_pair(m.width_error, e.mismatched),
        "robust-disturbance": _measure_pair(m.width_error, e.disturbed),
        "practical-use": _measure_pair(m.tracking_error, e.noisy),
        "mismatch": _of_single_case(
            _mismatch_effect(e.mismatch.printed),
            _mismatch_effect(e.mismatch.repaired),
        ),
    }


def _mismatch_effect(runs: tuple[Run, ...]) -> float:
    """Return the rms by which wrong widths move x^1, per unit of d - d^, last 2 s [1]."""
    right, off = runs
    moved = (off.x_hat - right.x_hat)[right.last, 0]
    return m.rms_or_inf(moved) / (D - FIXED_WIDTH)


def _divergence_flag(run: Run) -> float:
    """Return 1 if a run diverges, else 0."""
    return float(run.divergence_time is not None)


def _remedy_claims(e: Evidence) -> Numbers:
    """Compute the numbers of the proposed remedies: a tanh term, a filter, identification."""
    without, with_term = (m.tracking_error(run) for run in e.fixed_widths)
    in_noise, in_gust = (m.width_error(run) for run in e.filtered)
    filtered = {
        "with noise on y": in_noise / _worst_value(m.width_error, e.noisy.repaired),
        "with a disturbance": in_gust / _worst_value(m.width_error, e.disturbed.repaired),
    }
    beforehand = max(abs(width.value - D) for width in e.identified)
    return {
        "tanh-term": _missing_words("robust term")._replace(named={"worse": with_term / without}),
        "filtering": ClaimNumbers(filtered, None),
        "identification": _of_single_case(beforehand / m.width_error(e.logged), None),
    }


def _paper_claims(e: Evidence) -> Numbers:
    """Compute the numbers of the claims on cost and on the announced comparisons."""
    return {
        "practical": _of_single_case(
            observer_operations(example_as_printed(5.0)),
            observer_operations(example_as_repaired(5.0)),
        ),
        "too-slow": _of_single_case(
            m.width_convergence_rate(e.slow), m.width_convergence_rate(e.repaired[0])
        ),
        "beta": _missing_words("beta"),
        "compared": _missing_words("fuzzy", "neural", "sliding mode"),
        "figures-3-4": _missing_words("theta_d"),
        "keyword": _missing_words("sliding surface"),
        "manipulator": ClaimNumbers(
            e.arm.tracking,
            e.arm.contact_tracking,
            {"link": e.arm.estimation[WORDS[False]], "contact": e.arm.contact_estimation},
        ),
        "effort": _missing_words("control effort"),
    }


def _missing_words(*words: str) -> ClaimNumbers:
    """Count the words that no caption and no equation contains. No repair can supply them."""
    text = "\n".join([*FIGURES.values(), *(equation.what for equation in EQUATIONS)])
    return _of_single_case(float(sum(word not in text for word in words)), None)


OTHERS: Final[dict[str, dict[str, Any]]] = {
    "with fuzzy logic": {"method": "fuzzy_feedback", "reach": [5.0, 32.0]},
    "with a network": {"method": "rbf_feedback", "reach": [5.0, 32.0]},
    "with a sliding mode": {"method": "sliding_mode", "gain": 5.0},
}
"""Controllers of the kinds that the paper calls too complex, as other packages register them."""

SIMPLE: Final = 1000.0  # operations that a practical step may take


def _comparison_claims() -> Numbers:
    """Compute the numbers of the claims on other methods: operations and chattering."""
    example = example_as_repaired(5.0)
    observer = observer_operations(
        msgspec.structs.replace(example, observer=Luenberger(L=L_REPAIRED))
    )
    laws = {}
    for name, table in OTHERS.items():
        controller = CONTROLLERS.decode_options(table)
        laws[name] = controller_operations(msgspec.structs.replace(example, controller=controller))
    words = ", ".join(f"{count:.0f} {name}" for name, count in laws.items())
    calm = {"sign": calm_share(np.sign), "smooth": calm_share(_smooth_sign)}
    return {
        "others-too-complex": ClaimNumbers(
            {name: SIMPLE / (count + observer) for name, count in laws.items()},
            None,
            {"laws": f"A law alone takes {words}."},
        ),
        "chattering": _of_single_case(calm["sign"] / calm["smooth"], None, calm),
    }


def _theorem_claims(e: Evidence) -> Numbers:
    """Compute the numbers of the claims of Theorem 4.1 with its own law (29)."""
    printed = {
        f"with d - d^ {mismatch}": select_outcomes(e.theorem, mismatch)
        for mismatch in (GIVEN, ESTIMATED)
    }
    given_outcomes = select_outcomes(e.theorem, GIVEN)
    kind = [outcome for outcome in given_outcomes if is_kindest(outcome.variant)]
    named: dict[str, Any] = {
        "diverge": count_diverging(given_outcomes),
        "right": sum(outcome.worst_error <= RIGHT for outcome in given_outcomes),
        "leave": sum(outcome.leaves_widths for outcome in given_outcomes),
        "survive": sum(
            outcome.variant.width == D and outcome.diverged_at is None for outcome in given_outcomes
        ),
        "other_diverge": count_diverging(select_outcomes(e.theorem, GIVEN, OTHER_SIGN)),
        "kindest": max(outcome.width_error or 0.0 for outcome in kind),
    }
    law = PrintedLaw(L=L_PRINTED, alpha=ALPHA)
    states = [max(m.state_error(run, 0), m.state_error(run, 1)) for run in e.repaired]
    repaired = max(*states, _worst_value(m.width_error, e.repaired))
    return {
        "theorem": ClaimNumbers(
            {
                case: max(outcome.worst_error for outcome in group)
                for case, group in printed.items()
            },
            repaired,
            named,
        ),
        "theorem-known": _of_single_case(
            _change_of_input(law),
            _change_of_input(example_as_repaired(5.0).controller),
        ),
        "theorem-bounded": ClaimNumbers(
            {case: count_diverging(group) / len(group) for case, group in printed.items()},
            _worst_value(_divergence_flag, (*e.repaired, e.sampled)),
        ),
    }


def _change_of_input(options: Any) -> float:
    """Return the change of u at equal estimates when the d that a law is given grows by 1 [u]."""
    model = system(example_as_printed(1.0).plant)
    x = np.array([2.0, 0.0])
    one = np.ones(1)
    estimate = Estimate(x, x[:1], one, one, x[:1], one)
    target = Target(np.zeros(1), np.zeros(2), np.zeros(1))
    inputs = []
    for width in (D, D + 1.0):
        known = "widths" in options.__struct_fields__
        law_options = msgspec.structs.replace(options, widths=width) if known else options
        law = law_options.build(model)
        _, u = law.step(law.params, law.init(law.params), estimate, target)
        inputs.append(float(np.asarray(u).item()))
    return abs(inputs[1] - inputs[0])


def _input_claims(e: Evidence) -> Numbers:
    """Compute the numbers of the claims on a zone at the input, relative to one at the output."""
    controlled = m.tracking_error(e.at_input) / m.tracking_error(e.at_output)
    seen = _output_error(e.at_input) / _output_error(e.at_output)
    silence = {"silence": float((e.at_output.side[:, 0] == 0).mean())}
    return {
        "input-easier": _of_single_case(controlled, None),
        "output-harder": _of_single_case(seen, None, silence),
    }


def _output_error(run: Run) -> float:
    """Return the rms of z^ - z over the last 2 s [z]."""
    return m.rms_or_inf((run.z_hat - run.z)[run.last])


def _smooth_sign(s: float) -> float:
    """Return the sign by (8)."""
    return float(np.tanh(SHARPNESS * s))


def calm_share(switch: Callable[[float], float]) -> float:
    """Return the share of steps without a jump of a sliding mode's u by half its gain [1].

    The plant (39) is held at 0 from x = (1, 0): s = 2 x1 + x2, u = x1 - gain switch(s), the state
    is measured, u is held for a step, and the last 2 s of 5 s count.

    Args:
        switch: in place of the sign of s
    """
    # of the switched part; of sampling [s]
    gain = 5.0
    step = 1e-3
    Ad, Bd, _ = zoh(linear_matrices(example_as_printed(1.0).plant), step)
    x = np.array([1.0, 0.0])
    inputs = []
    for _ in range(round(5.0 / step)):
        inputs.append(x[0] - gain * float(switch(2.0 * x[0] + x[1])))
        x = Ad @ x + Bd[:, 0] * inputs[-1]
    jumps = np.abs(np.diff(inputs[-round(2.0 / step) :]))
    return float((jumps < gain / 2).mean())


def observer_operations(scenario: Scenario) -> float:
    """Count the arithmetic operations of one step of a scenario's observer alone."""
    model = system(scenario.plant)
    sensor = resolve(scenario.sensor, model.p, scenario.simulation.step)
    observer = require_graph(scenario.observer.build(model, sensor))
    p_column, p = tree.create_symbols(observer.params, "p")
    s_column, s = tree.create_symbols(observer.init(observer.params), "s")
    u, y, side = (ca.SX.sym(name) for name in ("u", "y", "side"))
    following, estimate = observer.step(p, s, u, Reading(y, side))
    return _count_operations([s_column, p_column, u, y, side], [following, estimate])


def controller_operations(scenario: Scenario) -> float:
    """Count the arithmetic operations of one step of a scenario's controller alone."""
    model = system(scenario.plant)
    law = scenario.controller.build(model)
    p_column, p = tree.create_symbols(law.params, "p")
    s_column, s = tree.create_symbols(law.init(law.params), "s")
    x = ca.SX.sym("x", model.n)
    x_ref = ca.SX.sym("x_ref", model.n)
    z, e, r, u_ff, right, left = (ca.SX.sym(name) for name in ("z", "e", "r", "u", "dr", "dl"))
    following, u = law.step(p, s, Estimate(x, z, right, left, z, e), Target(r, x_ref, u_ff))
    inputs = [s_column, p_column, x, x_ref, z, e, r, u_ff, right, left]
    return _count_operations(inputs, [following, u])


def _count_operations(inputs: list[ca.SX], outputs: list[Any]) -> float:
    """Count the arithmetic operations of a graph."""
    columns = [tree.stack_leaves(output) for output in outputs]
    function = ca.Function("step", inputs, columns, {"cse": True})
    moves = (ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST)
    instructions = [function.instruction_id(k) for k in range(function.n_instructions())]
    return float(sum(instruction not in moves for instruction in instructions))
