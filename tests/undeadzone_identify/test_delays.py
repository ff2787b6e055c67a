"""Delays of the input: refined sample by sample, or allowed for where they are not named."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from records import dead_zone, logged
from undeadzone.nonlinearities.sensor import DIRECTIONS
from undeadzone_identify.models.plant import RecordData, delay_inputs
from undeadzone_identify.models.zone import WidthLimits
from undeadzone_identify.selection.delays import (
    REACH,
    _refit_with_delay,
    find_equivalents,
    is_delay_better,
    refine_delay,
)
from undeadzone_identify.selection.orders import OrderFit, fit_orders, order_to_report
from undeadzone_identify.selection.widths import find_widths

LATE = 6
POLES = np.array([0.86 + 0.19j, 0.86 - 0.19j, 0.71])


@pytest.fixture(scope="module")
def data() -> RecordData:
    """A plant of third order whose input acts `LATE` samples late."""
    rng = np.random.default_rng(0)
    u = np.repeat(rng.standard_normal(90), 12)
    z = lfilter(np.r_[np.zeros(LATE + 1), 0.013, 0.006, 0.017], np.poly(POLES).real, u)
    e = 2 * z + 0.05 * rng.standard_normal(u.size)
    y = dead_zone(e, 0.5, 0.4)
    return logged(u, y, silent_zeros=True)


def fitted(data: RecordData, samples: int, orders: list[int]) -> list[OrderFit]:
    return fit_orders(delay_inputs(data, samples), orders, WidthLimits(), 0.3, lambda _: None)


@pytest.fixture(scope="module")
def beyond(data: RecordData) -> list[OrderFit]:
    """Fits two samples later than the input acts."""
    return fitted(data, LATE + 2, [2, 3])


def test_of_orders_that_predict_alike_one_that_can_be_written_is_chosen() -> None:
    def fit(n: int, bic: float, error: float, poles: list[float]) -> OrderFit:
        simulator = SimpleNamespace(
            plant_poles=lambda theta: np.array(poles, complex), is_at_limit=lambda theta: False
        )
        own = SimpleNamespace(bic=bic, theta=None, objective=SimpleNamespace(simulator=simulator))
        return OrderFit(n, own, error, 1.0, True)

    one, two = fit(1, 900.0, 0.3, [0.9]), fit(2, 110.0, 0.101, [0.9, 0.8])
    best, none = fit(3, 100.0, 0.1, [0.9, 0.8, -0.3]), fit(4, 90.0, 0.1, [0.9, 0.8, 0.5, 0.01])
    assert order_to_report([one, two, best]) is two
    assert order_to_report([one, best]) is best
    assert order_to_report([one, two, best, none]) is two
    assert order_to_report([one, two]) is two


@pytest.mark.parametrize("off", [2, -2])
def test_a_delay_is_refined_to_where_the_input_acts(data: RecordData, off: int) -> None:
    late = fitted(data, LATE + off, [2, 3])
    assert abs(refine_delay(late, LATE + off) - LATE) <= 1  # a zero may take a sample


@pytest.mark.parametrize("samples", [-2, -1, 1])
def test_climbs_at_the_next_delay_end_where_those_from_scratch_do(
    data: RecordData, beyond: list[OrderFit], samples: int
) -> None:
    moved = _refit_with_delay(beyond[-1].fit, samples)
    scratch = fitted(data, LATE + 2 + samples, [3])[0].fit
    assert moved.value > scratch.value - 20


def test_intervals_reach_over_a_delay_that_is_not_excluded(data: RecordData) -> None:
    none = fitted(data, 0, [3])
    near = fitted(data, LATE, [3])
    assert is_delay_better(none, near)
    assert find_equivalents(near, none) == []
    assert len(find_equivalents(none, near)) == 1
    chosen, other = near[-1], none[-1]
    alone = find_widths(chosen, [chosen], [], None, 0.0, 0.0)
    both = find_widths(chosen, [chosen], [other], None, 0.0, 0.0)
    for name, row in DIRECTIONS.items():
        gap = np.dot(row, (other.fit.right, other.fit.left))
        gap -= np.dot(row, (chosen.fit.right, chosen.fit.left))
        one, wide = getattr(alone, name), getattr(both, name)
        assert wide.value == one.value
        assert wide.low == pytest.approx(min(one.low, one.low + gap))
        assert wide.high == pytest.approx(max(one.high, one.high + gap))
        assert abs(gap) > 0


@pytest.mark.parametrize(("behind", "there"), [(0.0, 1), (0.9 * REACH, 1), (1.1 * REACH, 0)])
def test_a_delay_nearly_as_likely_is_another_explanation(behind: float, there: int) -> None:
    def order(bic: float) -> Any:
        simulator = SimpleNamespace(is_at_limit=lambda theta: False)
        fit = SimpleNamespace(bic=bic, theta=None, objective=SimpleNamespace(simulator=simulator))
        return SimpleNamespace(fit=fit, n=1, white=True)

    assert len(find_equivalents([order(100.0)], [order(100.0 + behind)])) == there
