"""The deadzone block: published responses, describing function, algebra, thresholds.

One definition serves NumPy and CasADi.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from undeadzone.nonlinearities import sensor
from undeadzone.nonlinearities.sensor import Sensor, deadzone

reals = st.floats(-20, 20, allow_subnormal=False)
widths = st.floats(0, 5, allow_subnormal=False)
gains = st.floats(0.1, 5)
ONE_PERIOD = np.linspace(0, 2 * np.pi, 4001)


@pytest.mark.parametrize(
    ("right", "left", "amplitude", "low", "high"),
    [(0.7, 0.7, 1.0, -0.3, 0.3), (0.7, 1.4, 2.0, -0.6, 1.3)],
)
def test_published_responses(
    right: float, left: float, amplitude: float, low: float, high: float
) -> None:
    y = deadzone(amplitude * np.sin(ONE_PERIOD), right, left)
    assert (y.min(), y.max()) == pytest.approx((low, high))
    inside = (-left < amplitude * np.sin(ONE_PERIOD)) & (amplitude * np.sin(ONE_PERIOD) < right)
    assert (y[inside] == 0).all()
    assert inside.mean() == pytest.approx(
        (np.arcsin(right / amplitude) + np.arcsin(left / amplitude)) / np.pi, abs=1e-3
    )


def saturation_describing_function(ratio: float) -> float:
    """N_sat(d / A) = 2/pi (asin q + q sqrt(1 - q^2)).

    Source: Gelb and Vander Velde (1968), table of describing functions.
    """
    q = min(ratio, 1.0)
    return float(2 / np.pi * (np.arcsin(q) + q * np.sqrt(1 - q**2)))


@pytest.mark.parametrize("amplitude", [0.5, 1.1, 2.0, 5.0, 40.0])
@pytest.mark.parametrize(
    ("right", "left", "slope"), [(1.0, 1.0, 1.0), (1.3, 0.6, 1.0), (0.4, 2.0, 2.5)]
)
def test_describing_function_is_one_minus_that_of_saturation(
    amplitude: float, right: float, left: float, slope: float
) -> None:
    corners = [np.arcsin(edge / amplitude) for edge in (right, -left) if abs(edge) < amplitude]
    mirrored = [np.sign(corner) * np.pi - corner for corner in corners]
    points = sorted(corners + mirrored)
    harmonic = quad(
        lambda a: deadzone(amplitude * np.sin(a), right, left, slope) * np.sin(a),
        -np.pi,
        np.pi,
        points=points or None,
        limit=200,
    )[0]
    closed = slope * (
        1
        - (
            saturation_describing_function(right / amplitude)
            + saturation_describing_function(left / amplitude)
        )
        / 2
    )
    assert harmonic / (np.pi * amplitude) == pytest.approx(closed, abs=1e-9)


@given(reals, widths, widths, gains)
def test_decomposition_and_inverse(z: float, right: float, left: float, slope: float) -> None:
    y, clipped = deadzone(z, right, left, slope), sensor.saturation(z, right, left)
    assert y == slope * (z - clipped)
    assert -left <= clipped <= right
    assert abs(clipped) <= sensor.saturation_bound(right, left)
    side = sensor.side(y)
    if y == 0:
        assert -left <= z <= right
        assert sensor.inverse(y, side, right, left, slope) == 0
    else:
        assert side == sensor.zone(z, right, left)
        assert sensor.inverse(y, side, right, left, slope) == pytest.approx(z, rel=1e-12, abs=1e-12)


@given(reals, widths, widths, gains)
def test_jump_sensor_reads_the_truth_outside_and_nothing_inside(
    z: float, right: float, left: float, slope: float
) -> None:
    y = sensor.jump(z, right, left, slope)
    assert y == (0.0 if -left <= z <= right else slope * z)
    assert sensor.inverse(y, sensor.side(y), right, left, slope, "jump") == pytest.approx(y / slope)


@pytest.mark.parametrize("kind", ["deadzone", "jump"])
@given(z=reals, right=widths, left=widths, slope=gains)
def test_each_branch_is_the_sensor_in_its_own_zone(
    kind: str, z: float, right: float, left: float, slope: float
) -> None:
    read = sensor.jump if kind == "jump" else deadzone
    assert sensor.branch(z, sensor.zone(z, right, left), right, left, slope, kind) == read(
        z, right, left, slope
    )


@pytest.mark.parametrize("kind", ["deadzone", "jump"])
@given(
    z=reals,
    right=widths,
    left=widths,
    slope=gains,
    threshold=widths,
    noise=st.floats(-5, 5, allow_subnormal=False),
)
def test_edges_are_where_the_side_changes(
    kind: str, z: float, right: float, left: float, slope: float, threshold: float, noise: float
) -> None:
    read = sensor.jump if kind == "jump" else deadzone
    above, below = sensor.edges(right, left, slope, kind, threshold, noise)
    if min(abs(z - above), abs(z + below), abs(z - right), abs(z + left)) < 1e-9:
        return
    expected = float(z > above) - float(z < -below)
    assert sensor.side(read(z, right, left, slope) + noise, threshold) == expected


def test_side_of_edges_noise_and_missing_samples() -> None:
    y = np.array([0.3, 0.1, 0.0, -0.1, -0.3, np.nan])
    assert sensor.side(y).tolist() == [1, 1, 0, -1, -1, 0]
    assert sensor.side(y, 0.2).tolist() == [1, 0, 0, 0, -1, 0]
    assert sensor.side(0.2, 0.2) == 0


def test_smooth_indicators() -> None:
    assert sensor.indicators(0.0, 100.0) == (0.5, 0.5)
    right, left = sensor.indicators(np.array([-1.0, -0.01, 0.0, 0.02, 1.0]), 50.0)
    assert right + left == pytest.approx(1)
    assert right[[0, -1]] == pytest.approx([0, 1])
    assert right[1] == pytest.approx((1 + np.tanh(-0.5)) / 2)


_z, _r, _l, _m, _y, _t, _n, _s = (ca.SX.sym(name) for name in "zrlmytns")
BOTH: list[tuple[Any, list[ca.SX]]] = [
    (sensor.saturation, [_z, _r, _l]),
    (sensor.deadzone, [_z, _r, _l, _m]),
    (sensor.zone, [_z, _r, _l]),
    (sensor.jump, [_z, _r, _l, _m]),
    (sensor.side, [_y, _t]),
    (lambda y, t: sensor.indicators(y, 1 + t), [_y, _t]),
    (lambda s, r, l: sensor.offset(s, r, l), [_s, _r, _l]),
    (lambda z, s, r, l, m: sensor.branch(z, s, r, l, m, "deadzone"), [_z, _s, _r, _l, _m]),
    (lambda z, s, r, l, m: sensor.branch(z, s, r, l, m, "jump"), [_z, _s, _r, _l, _m]),
    (lambda y, s, r, l, m: sensor.inverse(y, s, r, l, m), [_y, _s, _r, _l, _m]),
    (lambda r, l, m, t, n: sensor.edges(r, l, m, "deadzone", t, n), [_r, _l, _m, _t, _n]),
    (lambda r, l, m, t, n: sensor.edges(r, l, m, "jump", t, n), [_r, _l, _m, _t, _n]),
]


def compiled(function: Any, arguments: list[Any]) -> ca.Function:
    """A function of the sensor as a CasADi function of all symbols."""
    value = function(*arguments)
    if isinstance(value, tuple):
        value = ca.vertcat(*value)
    return ca.Function("f", [_z, _y, _s, _r, _l, _m, _t, _n], [value])


COMPILED = [compiled(function, arguments) for function, arguments in BOTH]


@given(
    reals,
    reals,
    st.sampled_from([-1.0, 0.0, 1.0]),
    widths,
    widths,
    gains,
    widths,
    st.floats(-5, 5, allow_subnormal=False),
)
def test_numpy_and_casadi_agree(
    z: float, y: float, s: float, r: float, l: float, m: float, t: float, n: float
) -> None:
    values = dict(zip("zysrlmtn", (z, y, s, r, l, m, t, n), strict=True))
    for (function, arguments), graph in zip(BOTH, COMPILED, strict=True):
        expected = np.ravel(function(*(np.float64(values[str(name)]) for name in arguments)))
        assert graph(z, y, s, r, l, m, t, n).full().ravel() == pytest.approx(
            expected, rel=1e-15, abs=1e-15
        )


@pytest.mark.parametrize("rate", [2.0, 20.0])
def test_false_alarms_come_at_the_requested_rate(rate: float) -> None:
    step, seconds = 1e-3, 2000
    threshold = sensor.noise_threshold(np.array([0.02]), step, rate)
    noise = np.random.default_rng(1).normal(scale=0.02, size=round(seconds / step))
    alarms = float(np.abs(sensor.side(noise, threshold)).sum())
    assert abs(alarms - rate * seconds) < 4 * np.sqrt(rate * seconds)


def test_threshold_of_each_output_and_its_limits() -> None:
    assert sensor.noise_threshold(np.zeros(2), 1e-3, 0.01).tolist() == [0, 0]
    found = sensor.resolve(Sensor(right=1.0, left=1.0, noise=[0.0, 0.5]), 2, 1e-3).threshold
    assert found[0] == 0
    assert 4 < found[1] / 0.5 < 5
    assert sensor.noise_threshold(np.ones(1), 1e-3, 1e9).tolist() == [0]
    assert np.isfinite(sensor.noise_threshold(np.array([0.0, 1.0]), 1e-300, 1e-300)).all()
    assert sensor.resolve(
        Sensor(right=1.0, left=1.0, noise=0.5, threshold=0.2), 1, 1e-3
    ).threshold.tolist() == [0.2]


def test_resolve_spreads_numbers_over_outputs() -> None:
    found = sensor.resolve(Sensor(right=1.0, left=[0.5, 0.7], slope=2.0), 2, 1e-3)
    assert (found.right.tolist(), found.left.tolist(), found.slope.tolist()) == (
        [1, 1],
        [0.5, 0.7],
        [2, 2],
    )
