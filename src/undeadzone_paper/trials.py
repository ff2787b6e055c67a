"""Numbers for each claim: its quantity as printed, as repaired, and those of its reason."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import chain
from typing import Any, Final, NamedTuple, TypeAlias

import casadi as ca
import numpy as np
from scipy.optimize import brentq

from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Estimate, Reading, require_graph
from undeadzone.linalg.hold import zoh
from undeadzone.linalg.matrices import Matrices
from undeadzone.linalg.poles import observer_gain
from undeadzone.nonlinearities.sensor import (
    deadzone,
    offset,
    saturation,
    saturation_bound,
    zone,
)
from undeadzone.plants.build import system
from undeadzone.plants.options import linear_matrices
from undeadzone.results.run import Run
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.util import tree
from undeadzone.util.arrays import Floats
from undeadzone_paper import measures as m
from undeadzone_paper.arm import WORDS
from undeadzone_paper.equations import EQUATIONS, FIGURES
from undeadzone_paper.evidence import (
    BEGUN,
    CONDITIONS,
    NOMINAL,
    RESTING,
    TABLES,
    Evidence,
)
from undeadzone_paper.example import (
    L_POLES,
    L_PRINTED,
    POLES,
    D,
    example_as_printed,
    example_as_repaired,
)
from undeadzone_paper.law import PrintedLaw
from undeadzone_paper.printed import count_flags
from undeadzone_paper.theorem import (
    ERROR_FLAGS,
    ESTIMATED,
    GIVEN,
    OTHER_SIGN,
    is_kindest,
    select_outcomes,
)


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

EXACT: Final = 1e-3  # rms of x^1 - x1 up to which an observer observes
EQUAL: Final = 1e-12  # rms of y^ - y up to which they are equal
SIGNS: Final = {"with d_l > 0": D, "with d_l < 0": -D}  # d_l by case


def measure_claims(evidence: Evidence) -> Numbers:
    """Compute the numbers of all claims, by id. Of several runs the worst counts."""
    numbers = {
        **{name: _measure_rows(evidence, *rows) for name, rows in TABLES["measured"].items()},
        **_sensor_claims(evidence),
        **_gain_claims(linear_matrices(example_as_printed(1.0).plant)),
        **_observer_claims(evidence),
        **_width_claims(evidence),
        **_comparison_claims(evidence),
        **_theorem_claims(evidence),
        **{name: _missing_words(*words) for name, words in TABLES["announced"].items()},
    }
    without, with_term = map(m.tracking_error, evidence.repaired["tanh"])
    (at_output,) = evidence.repaired["zone at the output"]
    silent = evidence.printed[NOMINAL][RESTING][0]
    named = {
        "tanh-term": {"worse": with_term / without},
        "output-harder": {"silence": (at_output.side == 0).mean()},
        "tracking": {"moved": m.largest_absolute(silent.z[silent.last])},
    }
    return numbers | {name: numbers[name]._replace(named=more) for name, more in named.items()}


def _measure_rows(
    e: Evidence, measure: str, printed: str, repaired: str, beside: str = ""
) -> ClaimNumbers:
    """Compute a quantity on a row of runs as printed, and on one as repaired."""
    worst = partial(m.worst_value, getattr(m, measure))
    scale = worst(e.repaired[beside]) if beside else 1.0
    cases = e.printed[printed] if printed in e.printed else {"": e.repaired[printed]}
    return ClaimNumbers(
        {case: worst(runs) / scale for case, runs in cases.items()},
        worst(e.repaired[repaired]) / scale if repaired else None,
    )


def _single(value: float, repaired: float | None = None, **named: Any) -> ClaimNumbers:
    """Return the numbers of a claim whose quantity as printed has one case only.

    Args:
        value: the quantity as printed.
        repaired: the same as repaired (None: there is nothing to repair).
        named: numbers that its reason names.
    """
    return ClaimNumbers({"": value}, repaired, named)


def _sensor_claims(e: Evidence) -> Numbers:
    """Compute the numbers of the claims on the dead zone itself."""
    z = np.linspace(-5.0, 5.0, 1001)
    slope = CONDITIONS["slope"]
    of_slope = m.largest_absolute(deadzone(z, D, D, slope) / slope - deadzone(z, D, D))
    z = z[np.abs(z) > D]
    y = deadzone(z, D, D)
    side = zone(z, D, D)
    of_right = y - z + D * (side > 0)
    largest = m.largest_absolute(saturation(z, D, D))
    # (11) with chi_bar = [chi_r, chi_l], and the bound of (2)
    decomposition = {
        case: m.largest_absolute(of_right + left * (side < 0)) for case, left in SIGNS.items()
    }
    widths = {case: max(0.0, largest - abs(D - left)) for case, left in SIGNS.items()}
    nominal, scaled = e.repaired[NOMINAL], e.repaired["scaled"][0]
    begun = e.printed[NOMINAL][BEGUN]
    figure_1 = {
        "with x the output": max(_deviation(run, run.z) for run in begun),
        "with x the input": max(_deviation(run, run.u) for run in begun),
    }
    return {
        "decomposition": ClaimNumbers(
            decomposition, m.largest_absolute(y - (z - offset(side, D, D)))
        ),
        "width-bound": ClaimNumbers(widths, max(0.0, largest - saturation_bound(D, D))),
        "figure-1": ClaimNumbers(figure_1, max(_deviation(run, run.z) for run in nominal)),
        "indicators": _single(
            max(map(m.indicator_error, e.printed[NOMINAL][RESTING])),
            max(map(m.side_error, nominal)),
        ),
        "unit-slope": _single(of_slope, m.largest_absolute(nominal[0].d_hat - scaled.d_hat)),
    }


def _deviation(run: Run, x: Floats) -> float:
    """Return the largest difference of y from the dead zone of x [y]."""
    return m.largest_absolute(run.y - deadzone(x, D, D))


def _gain_claims(linear: Matrices) -> Numbers:
    """Compute the numbers of the claims on the gains (40) and (42)."""
    placed = observer_gain(linear, POLES, None).ravel()
    printed_drift = m.error_matrix(linear)
    left, right = np.sort(np.linalg.eigvals(printed_drift).real)
    return {
        "observer-poles": _single(
            pole_error(linear, L_PRINTED),
            pole_error(linear, placed),
            leftmost=left,
            rightmost=right,
        ),
        "riccati-gain": _single(
            max(innovation_loop_pole(linear, alpha) for alpha in _alphas()),
            _worst_rightmost_pole(linear, linear.A),
            brink=destabilising_alpha(linear, m.error_matrix(linear, L_POLES)),
            fed=right,
            fed_back=_worst_rightmost_pole(linear, printed_drift),
        ),
    }


def pole_error(linear: Matrices, L: Sequence[float] | Floats) -> float:
    """Return the largest distance of a pole of A - L C from the paper's target [1/s]."""
    poles = np.sort(np.linalg.eigvals(m.error_matrix(linear, L)))
    return m.largest_absolute(poles - np.sort(POLES))


def rightmost_pole(linear: Matrices, drift: Floats, alpha: float) -> float:
    """Return the rightmost pole of A - B K [1/s], K by (34) with `drift` for A."""
    K = m.printed_riccati(linear, drift, alpha).K
    return float(np.linalg.eigvals(linear.A - linear.B @ K).real.max())


def _worst_rightmost_pole(linear: Matrices, drift: Floats) -> float:
    """Return the rightmost pole of A - B K in the worst case of all alpha tried [1/s]."""
    return max(rightmost_pole(linear, drift, alpha) for alpha in _alphas())


def _alphas() -> Floats:
    """Return the values of alpha that are tried."""
    return np.geomspace(CONDITIONS["least_alpha"], CONDITIONS["most_alpha"], 51)


def innovation_loop_pole(linear: Matrices, alpha: float) -> float:
    """Return the rightmost pole of the loop that (42) closes outside the zone [1/s].

    There y - y^ = C x~, if the widths are right, and (16) without B u makes
    x~' = (A - L C) x~ - B (k_p C + k_d C (A - L C)) x~, as C B = 0. The plant adds the poles of A.
    """
    _, B, C = linear
    drift = m.error_matrix(linear)
    k_p, k_d = m.printed_riccati(linear, drift, alpha).K[0]
    closed = drift - B @ (k_p * C + k_d * C @ drift)
    return float(np.linalg.eigvals(closed).real.max())


def destabilising_alpha(linear: Matrices, drift: Floats) -> float:
    """Return the least alpha, within bounds, from which A - B K with K of (34) is unstable."""
    ends = np.log10([CONDITIONS["least_alpha"], CONDITIONS["most_alpha"]])
    excess = brentq(lambda power: rightmost_pole(linear, drift, 10.0**power), *ends, xtol=1e-12)
    return float(10.0**excess)


def _observer_claims(e: Evidence) -> Numbers:
    """Compute the numbers of the claims on the observer and its loop."""
    errors = _measure_rows(e, "first_state_error", NOMINAL, NOMINAL).printed
    cost = observer_operations(example_as_printed(5.0))
    diverging = {case: _any_diverges(runs) for case, runs in e.printed[NOMINAL].items()}
    return {
        "bounded": ClaimNumbers(diverging, _any_diverges(e.repaired["off nominal"])),
        "unstable": _single(1.0 - max(diverging.values())),
        "mismatch": _single(
            _mismatch_effect(*e.printed["fixed widths"][""]),
            _mismatch_effect(*e.repaired["fixed widths"]),
        ),
        "practical": ClaimNumbers(
            {case: cost for case, error in errors.items() if error <= EXACT},
            observer_operations(example_as_repaired(5.0)),
            {"cost": cost},
        ),
        "manipulator": ClaimNumbers(
            e.arm.tracking,
            e.arm.contact_tracking,
            {"link": e.arm.estimation[WORDS[False]], "contact": e.arm.contact_estimation},
        ),
    }


def _any_diverges(runs: Iterable[Run]) -> float:
    """Return 1 if a run diverges, else 0."""
    return float(any(run.divergence_time is not None for run in runs))


def _mismatch_effect(right: Run, off: Run) -> float:
    """Return the rms by which wrong widths move x^1, per unit of d - d^, last 2 s [1]."""
    moved = (off.x_hat - right.x_hat)[right.last, 0]
    return m.rms_or_inf(moved) / CONDITIONS["mismatched"]


def _width_claims(e: Evidence) -> Numbers:
    """Compute the numbers of the claims on known widths, unknown widths, and the reference."""
    errors = {name: m.worst_value(m.width_error, runs) for name, runs in e.repaired.items()}
    implied = {
        case: m.worst_value(m.width_error, runs)
        for case, runs in e.printed[NOMINAL].items()
        if m.worst_value(m.reading_error, runs) <= EQUAL
    }
    beforehand = max(abs(width.value - D) for width in e.identified)
    unaware = list(chain(*e.printed["unaware"].values()))
    inside, grazing, outside, *_ = e.repaired["amplitudes"]
    right, left = grazing.d_hat[-1]
    run = e.printed[NOMINAL][RESTING][0]
    period = run.r[: round(1.0 / run.info.step), 0]
    return {
        "implied": ClaimNumbers(
            implied,
            errors["implied"],
            {"silent": errors["silent"], "crossing": errors[NOMINAL], "aware": errors["aware"]},
        ),
        "reference-amplitude": _single(
            m.worst_value(m.width_error, unaware),
            errors["amplitudes"],
            inside=inside.d_hat[-1].max(),
            grazing_right=right,
            grazing_left=left,
            outside=max(m.width_error(outside), errors[NOMINAL]),
        ),
        "reference-centre": _single(abs(float(period.mean()) - (D - D) / 2), still=errors["still"]),
        "filtering": ClaimNumbers(
            {
                "with noise on y": errors["filtered noise"] / errors["noisy"],
                "with a disturbance": errors["filtered gust"] / errors["disturbed"],
            },
            None,
        ),
        "predetermined": _single(beforehand),
        "identification": _single(beforehand / errors["logged"]),
        "physical": _single(max((width.high - width.low) / 2 for width in e.identified)),
    }


def _missing_words(*words: str) -> ClaimNumbers:
    """Count the words that no caption and no equation contains. No repair can supply them."""
    text = "\n".join([*FIGURES.values(), *(equation.what for equation in EQUATIONS)])
    return _single(float(sum(word not in text for word in words)))


def _comparison_claims(e: Evidence) -> Numbers:
    """Compute the numbers of the claims on other methods: operations and chattering."""
    example = example_as_repaired(5.0)
    observer = observer_operations(example | TABLES["conditions"]["blind"])
    laws = {
        name: controller_operations(example | {"controller": table})
        for name, table in TABLES["controllers"].items()
    }
    words = ", ".join(f"{count:.0f} {name}" for name, count in laws.items())
    sign, smooth = calm_share(np.sign), calm_share(lambda s: np.tanh(m.SHARPNESS * s))
    return {
        "others-too-complex": ClaimNumbers(
            {name: 1000.0 / (count + observer) for name, count in laws.items()},
            None,
            {"laws": f"A law alone takes {words}."},
        ),
        "chattering": _single(sign / smooth, sign=sign, smooth=smooth),
    }


def _theorem_claims(e: Evidence) -> Numbers:
    """Compute the numbers of the claims of Theorem 4.1 with its own law (29)."""
    printed = {
        f"with d - d^ {mismatch}": select_outcomes(e.theorem, mismatch)
        for mismatch in (GIVEN, ESTIMATED)
    }
    given = select_outcomes(e.theorem, GIVEN)
    survivors = [outcome for outcome in given if not outcome.diverges]
    counts = count_flags(given, ERROR_FLAGS)
    others = select_outcomes(e.theorem, GIVEN, OTHER_SIGN)
    nominal = e.repaired[NOMINAL]
    errors = (m.first_state_error, m.second_state_error, m.width_error)
    return {
        "theorem": ClaimNumbers(
            {
                case: max(outcome.worst_error for outcome in group)
                for case, group in printed.items()
            },
            max(m.worst_value(error, nominal) for error in errors),
            {
                **dict(zip(("diverge", "right", "leave"), counts, strict=True)),
                "survive": sum(outcome.variant.width == D for outcome in survivors),
                "other_diverge": count_flags(others, ERROR_FLAGS)[0],
                "kindest": max(
                    outcome.width_error for outcome in survivors if is_kindest(outcome.variant)
                ),
            },
        ),
        "theorem-known": _single(
            _change_of_input(
                PrintedLaw(L=L_PRINTED, widths=D), PrintedLaw(L=L_PRINTED, widths=D + 1.0)
            ),
            _change_of_input(*[example_as_repaired(5.0).controller] * 2),
        ),
        "theorem-bounded": ClaimNumbers(
            {
                case: count_flags(group, ERROR_FLAGS)[0] / len(group)
                for case, group in printed.items()
            },
            _any_diverges(e.repaired["both times"]),
        ),
    }


def _change_of_input(law: Any, other: Any) -> float:
    """Return the difference of u at equal estimates between a law and the same with another d."""
    model = system(example_as_printed(1.0).plant)
    one = np.ones(1)
    estimate = Estimate(np.array([2.0, 0.0]), 2 * one, one, one, 2 * one, one)
    target = Target(0 * one, np.zeros(2), 0 * one)
    inputs = []
    for each in (law.build(model), other.build(model)):
        _, u = each.step(each.params, each.init(each.params), estimate, target)
        inputs.append(u)
    return m.largest_absolute(np.subtract(*inputs))


def calm_share(switch: Callable[[Any], Any]) -> float:
    """Return the share of steps without a jump of a sliding mode's u by half its gain [1].

    The plant (39) is held at 0 from x = (1, 0): s = 2 x1 + x2, u = x1 - gain switch(s), the state
    is measured, u is held for a step, and the last 2 s of 5 s count.

    Args:
        switch: in place of the sign of s
    """
    gain = 5.0  # of the switched part
    Ad, Bd, _ = zoh(linear_matrices(example_as_printed(1.0).plant), 1e-3)
    x = np.array([1.0, 0.0])
    inputs = []
    for _ in range(5000):
        inputs.append(x[0] - gain * float(switch(2.0 * x[0] + x[1])))
        x = Ad @ x + Bd[:, 0] * inputs[-1]
    jumps = np.abs(np.diff(inputs[-2000:]))
    return float((jumps < gain / 2).mean())


def observer_operations(scenario: Scenario) -> float:
    """Count the arithmetic operations of one step of a scenario's observer alone."""
    u, y, side = map(ca.SX.sym, ("u", "y", "side"))
    observer = require_graph(resolve_scenario(scenario).observer)
    return _count_operations(observer, u, Reading(y, side))


def controller_operations(scenario: Scenario) -> float:
    """Count the arithmetic operations of one step of a scenario's controller alone."""
    problem = resolve_scenario(scenario)
    x, x_ref = (ca.SX.sym(name, problem.plant.n) for name in ("x", "x_ref"))
    z, e, r, u_ff, right, left = map(ca.SX.sym, ("z", "e", "r", "u", "dr", "dl"))
    estimate = Estimate(x, z, right, left, z, e)
    return _count_operations(problem.controller, estimate, Target(r, x_ref, u_ff))


def _count_operations(method: Any, *inputs: Any) -> float:
    """Count the arithmetic operations of one step of an observer or a controller."""
    _, p = tree.create_symbols(method.params, "p")
    _, s = tree.create_symbols(method.init(method.params), "s")
    answer = tree.stack_leaves(method.step(p, s, *inputs))
    function = ca.Function("step", ca.symvar(answer), [answer], {"cse": True})
    moves = (ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST)
    instructions = map(function.instruction_id, range(function.n_instructions()))
    return float(sum(instruction not in moves for instruction in instructions))
