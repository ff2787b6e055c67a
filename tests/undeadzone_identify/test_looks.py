"""Direct looks: rows at rest, maps of any shape, maps of rates, and the witness of stillness."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType

import numpy as np
import pytest
from benchmarks.identify.logs.doors import KINDS
from benchmarks.identify.logs.strangers import dragged
from scipy.signal import lfilter

from records import holds
from undeadzone.util.arrays import Floats, turns
from undeadzone_identify.looks import edges as edges_module
from undeadzone_identify.looks import map as maps
from undeadzone_identify.looks import rate, rows
from undeadzone_identify.looks.curve import fit_curve
from undeadzone_identify.looks.map import Edge, FlatPart, RestMap, map_at_rest
from undeadzone_identify.looks.rate import map_of_rate
from undeadzone_identify.looks.rows import Rows, last_changes, noise_of, rows_at_rest
from undeadzone_identify.looks.stillness import ends_of_readings, longest_stillness

Shape = Callable[[Floats], Floats]


def zone(u: Floats, left: float, right: float) -> Floats:
    """A dead zone from -left to right."""
    return np.maximum(u - right, 0) + np.minimum(u + left, 0)


def found(u: Floats, y: Floats, t: Floats | None = None) -> RestMap:
    """The map of rows; there is one."""
    rest = map_at_rest(t, u, y)
    assert rest is not None
    return rest


def edges_of(part: FlatPart) -> tuple[Edge, Edge]:
    """Both edges of a band."""
    assert part.left is not None
    assert part.right is not None
    return part.left, part.right


def right_edge(rest: RestMap) -> Edge:
    """The only edge of a low end."""
    (part,) = rest.flats
    assert part.left is None
    assert part.right is not None
    return part.right


# Shape, reading over the command in [-1, 1], and edges (left, right) of the only flat part.
SHAPES: dict[str, tuple[Shape, str, tuple[float | None, float | None] | None]] = {
    "band": (lambda u: 3 * zone(u, 0.2, 0.3), "band", (-0.2, 0.3)),
    "uneven band": (lambda u: zone(u, 0.2, 0.3) * np.where(u > 0, 2, 1), "band", (-0.2, 0.3)),
    "bent band": (lambda u: np.tanh(1.5 * zone(u, 0.25, 0.1)), "band", (-0.25, 0.1)),
    "falling band": (lambda u: -zone(u, 0.2, 0.3), "band", (-0.2, 0.3)),
    "low end": (lambda u: np.maximum(u + 0.4, 0), "end", (None, -0.4)),
    "high end": (lambda u: np.minimum(u, 0.6), "end", (0.6, None)),
    "threshold": (lambda u: np.where(np.abs(u) > 0.305, u, 0), "band", (-0.305, 0.305)),
    "line": (lambda u: 2 * u + 1, "line", None),
    "cubic": (lambda u: u + u**3, "curve", None),
    "inflection": (lambda u: u**3, "curve", None),
    "soft limit": (lambda u: np.tanh(2 * u), "curve", None),
    "parabola": (lambda u: (u - 0.1) ** 2, "fold", None),
    "fold": (lambda u: -np.abs(u - 0.3), "fold", None),
    "stairs": (lambda u: np.round(8 * u) / 8, "ripple", None),
    "band beside a step": (
        lambda u: zone(u, 0.3, 0.2) - np.clip(u - 0.7, 0, 0.05),
        "band",
        (-0.3, 0.2),
    ),
    "ripple": (lambda u: u + 0.03 * np.sin(20 * np.pi * u), "ripple", None),
}


@pytest.mark.parametrize(
    ("name", "size"),
    [
        *((name, 41) for name, (_, shape, _) in SHAPES.items() if shape != "ripple"),
        *((name, 300) for name in SHAPES),
    ],
)
def test_a_map_has_the_shape_and_the_edges_of_its_truth(name: str, size: int) -> None:
    check_map(name, size, 1e-3)


def check_map(name: str, size: int, noise: float) -> None:
    """Compare the map of a shape with its truth."""
    function, shape, edges = SHAPES[name]
    u = np.linspace(-1, 1, size)
    y = function(u)
    rest = found(u, y + noise * np.random.default_rng(1).standard_normal(size))
    assert (rest.fold is not None) == (shape == "fold")
    assert len(rest.flats) == (edges is not None)
    inside = np.abs(u) < 0.95
    assert np.abs(rest.predict(u) - y)[inside].mean() < 0.01 * np.ptp(y)
    if edges is not None:
        for edge, truth in zip((rest.flats[0].left, rest.flats[0].right), edges, strict=True):
            assert (edge is None) == (truth is None)
            if edge is not None and truth is not None:
                assert holds(edge.interval, truth)
                assert edge.interval.value == pytest.approx(truth, abs=0.03)
                assert edge.jumps == (name == "threshold")


@pytest.mark.parametrize("factor", [0.5, 2])
@pytest.mark.parametrize(
    ("module", "names"),
    [
        (maps, "FLAT HIDES LEAST WIDE CANDIDATES NEAREST FARTHER TURN"),
        (edges_module, "DEARER RISES BEYOND KNOWN PLACES"),
    ],
)
def test_half_and_double_of_a_constant_change_no_map(
    monkeypatch: pytest.MonkeyPatch, module: ModuleType, names: str, factor: float
) -> None:
    for name in names.split():
        with monkeypatch.context() as patch:
            value = getattr(module, name)
            patch.setattr(module, name, type(value)(factor * value))
            for shape in ("bent band", "low end", "threshold", "line", "soft limit"):
                check_map(shape, 61, 2e-3)


def test_exact_edges_are_recovered_from_exact_rows() -> None:
    u = np.linspace(-1, 1, 40)
    for seed in range(10):
        left, right = np.random.default_rng(seed).uniform(0.15, 0.4, 2)
        (part,) = found(u, zone(u, left, right)).flats
        assert edges_of(part)[0].interval.value == pytest.approx(-left, abs=2e-3)
        assert edges_of(part)[1].interval.value == pytest.approx(right, abs=2e-3)
        assert part.level == pytest.approx(0, abs=1e-9)


def test_equal_readings_are_a_rest_whatever_lies_beside() -> None:
    u = np.arange(-60.0, 61.0)
    y = zone(u, 3.2, 5.4) * np.where(np.abs(u) < 22, 2, 1.6)  # a sensor with two ranges
    y[y != 0] += 0.1 * np.random.default_rng(3).standard_normal(np.count_nonzero(y))
    (part,) = found(u, y).flats
    for edge, truth in zip(edges_of(part), (-3.2, 5.4), strict=True):
        assert edge.interval.low <= truth <= edge.interval.high
        assert edge.interval.half_width < 2


def test_intervals_contain_their_truths() -> None:
    held = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        left, right = rng.uniform(0.15, 0.4, 2)
        u = np.sort(rng.uniform(-1, 1, int(rng.choice([30, 60, 120]))))
        y = zone(u, left, right) + rng.choice([0.002, 0.008]) * rng.standard_normal(u.size)
        for part in found(u, y).flats:
            assert part.kind == "band"
            held += [
                edges_of(part)[0].interval.low <= -left <= edges_of(part)[0].interval.high,
                edges_of(part)[1].interval.low <= right <= edges_of(part)[1].interval.high,
            ]
    assert len(held) >= 64
    assert np.mean(held) >= 0.9


@pytest.mark.parametrize("scale", [1e-9, -1.0, 1e9])
def test_units_and_signs_change_nothing(scale: float) -> None:
    rng = np.random.default_rng(3)
    u = np.linspace(-1, 1, 80)
    y = zone(u, 0.2, 0.35) + 0.003 * rng.standard_normal(80)
    (one,) = found(u, y).flats
    (other,) = found(scale * u + 5 * scale, 3 * y / scale - 2 / scale).flats
    edges = edges_of(one)[:: int(np.sign(scale))]
    for edge, scaled in zip(edges, edges_of(other), strict=True):
        assert scaled.interval.value == pytest.approx(scale * (edge.interval.value + 5), rel=1e-3)


def test_the_order_of_a_table_changes_nothing() -> None:
    u = np.linspace(0, 10, 30)
    y = np.maximum(u - 2.2, 0)
    order = np.random.default_rng(0).permutation(30)
    edges = [right_edge(found(*rows)) for rows in ((u, y), (u[::-1], y[::-1]))]
    assert edges[0] == edges[1]
    shuffled = right_edge(found(u[order], y[order]))
    assert shuffled.interval.value == pytest.approx(edges[0].interval.value, abs=1e-6)


def test_sides_that_were_never_tried_have_no_edge() -> None:
    u = np.linspace(0, 10, 51)
    rest = found(u, np.maximum(u - 3.3, 0))
    assert (rest.flats[0].kind, rest.flats[0].left, right_edge(rest).rows) == ("low end", None, 34)
    falling = found(u, np.maximum(6.7 - u, 0))
    assert (falling.flats[0].kind, falling.flats[0].right) == ("low end", None)
    limited = found(u, np.minimum(u, 7))
    assert (limited.flats[0].kind, limited.flats[0].right) == ("high end", None)


def test_what_a_straight_map_hides_is_below_its_bound() -> None:
    held = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        u = np.linspace(-1, 1, int(rng.choice([25, 60, 200])))
        half = rng.uniform(0, 0.04)
        y = zone(u - rng.uniform(-0.5, 0.5), half, half) + 0.01 * rng.standard_normal(u.size)
        rest = found(u, y)
        if not rest.flats:
            assert rest.curve is not None
            assert rest.curve.hides < 0.2
            held.append(rest.curve.hides >= 2 * half)
    assert len(held) > 20
    assert np.mean(held) >= 0.93


def test_a_gap_that_nobody_visited_widens_the_edge() -> None:
    u = np.append(np.linspace(-2, 0, 12), np.linspace(2, 4, 9))
    rest = found(u, np.maximum(u - 0.9, 0))
    edge = right_edge(rest).interval
    assert (edge.low, edge.high) == pytest.approx((0.0, 2.0), abs=0.02)
    assert edge.value == pytest.approx(0.9, abs=0.01)


def test_sweeps_that_differ_widen_an_edge() -> None:
    u = np.concatenate([np.linspace(0, 1, 300), np.linspace(1, 0, 300)])
    edges = np.repeat([0.30, 0.34], 300)
    edge = right_edge(found(u, np.maximum(u - edges, 0), np.arange(600.0))).interval
    assert edge.low <= 0.302
    assert edge.high >= 0.335


def test_play_is_no_band() -> None:
    u = np.concatenate([np.linspace(0, 10, 60), np.linspace(10, 0, 60)] * 2)
    y, at = np.empty(u.size), 0.0
    for k, command in enumerate(u):
        y[k] = at = min(max(at, command - 0.4), command + 0.4)
    assert not found(u, y).flats
    assert not found(u, u).flats


@pytest.mark.parametrize("gap", [0.0, 0.1])
@pytest.mark.parametrize("bend", [0.0, 0.3])
def test_a_curve_has_the_departure_and_the_distance_of_its_truth(gap: float, bend: float) -> None:
    up = np.linspace(-1, 1, 31)
    u = np.append(up, up[-2::-1])
    way = np.where(np.arange(u.size) < up.size, 1, -1)
    held, departure = [], bend * (up**2 - np.mean(up**2))
    for seed in range(60):
        x = u - way * gap / 2
        noise = 0.01 * np.random.default_rng(seed).standard_normal(u.size)
        curve = fit_curve(Rows(u, x + bend * x**2 + noise, last_changes(u), "table"))
        assert curve is not None
        assert curve.distance is not None
        held.append(
            (holds(curve.distance, gap), bend == 0 or holds(curve.departure, departure.max()))
        )
        assert (curve.distance.low > 0.02) == (gap > 0)
        assert (curve.departure.low > 0.02) == (bend > 0)
    assert np.mean(held, axis=0).min() > 0.85


def test_a_line_between_limits_is_told_from_a_curve() -> None:
    u = np.linspace(0, 10, 30)
    noise = 0.02 * np.random.default_rng(3).standard_normal(u.size)
    round_limits = 3 * np.logaddexp(0, (u - 3) / 0.3) - 3 * np.logaddexp(0, (u - 8) / 0.3)
    limits = found(u, round_limits + noise).limits
    assert holds(limits["lower"], 3.0)
    assert holds(limits["upper"], 8.0)
    assert not found(u, u + 0.05 * u**2 + noise).limits


def test_a_start_above_the_stop_is_two_thresholds() -> None:
    rng = np.random.default_rng(2)
    u, turns_now = rng.uniform(0, 100, 150), False
    y = np.empty(150)
    for k, command in enumerate(u):
        turns_now = command > 88 or (turns_now and command > 35)
        y[k] = 7 * command * turns_now
    edge = right_edge(found(u, y))
    assert edge.jumps
    assert 80 < edge.interval.high <= 88
    assert 35 < edge.interval.low < 45


def test_levels_with_repeats_are_a_table_and_one_outlier_does_no_harm() -> None:
    rng = np.random.default_rng(5)
    u = np.tile(np.arange(0, 12.0), 10)
    y = np.maximum(u - 2.6, 0) + 0.03 * rng.standard_normal(u.size)
    y[37] = 400.0
    rest = found(u, y)
    edge = right_edge(rest).interval
    assert holds(edge, 2.6)


def test_holds_give_their_last_readings() -> None:
    rng = np.random.default_rng(7)
    u = np.repeat(rng.uniform(-1, 1, 60), 40)
    y, speed = np.empty(u.size), 0.0
    for k, target in enumerate(2 * zone(u, 0.2, 0.3)):
        speed += 0.12 * (target - speed)
        y[k] = speed
    rest = found(u, y + 1e-3 * rng.standard_normal(u.size))
    assert rest.rows.how == "holds"
    (part,) = rest.flats
    assert edges_of(part)[0].interval.low <= -0.2 <= edges_of(part)[0].interval.high
    assert edges_of(part)[1].interval.low <= 0.3 <= edges_of(part)[1].interval.high


def test_an_integrating_reading_has_a_map_of_its_rate() -> None:
    rng = np.random.default_rng(4)
    u = np.repeat(rng.uniform(-100, 100, 80), 20)
    t = 0.1 * np.arange(u.size) + 0.01 * rng.uniform(-1, 1, u.size)
    y = np.append(0, np.cumsum(0.01 * zone(u, 30, 40) * np.diff(t, append=t[-1] + 0.1)))[:-1]
    rest = map_of_rate(t, u, y + 1e-3 * rng.standard_normal(u.size))
    assert rest is not None
    (part,) = rest.flats
    assert edges_of(part)[0].interval.low <= -30 <= edges_of(part)[0].interval.high
    assert edges_of(part)[1].interval.low <= 40 <= edges_of(part)[1].interval.high


@pytest.mark.parametrize(
    ("kind", "module", "name", "look", "factor"),
    [
        ("drive, ramps", rows, "STEP", map_at_rest, 0.5),
        ("drive, ramps", rows, "STEP", map_at_rest, 1.5),  # of half the range are these steps
        ("steering valve", rate, "WINDOWS", map_of_rate, 0.5),
        ("steering valve", rate, "WINDOWS", map_of_rate, 2.0),
        ("steering valve", rate, "EXPLAINED", map_of_rate, 0.5),
    ],
)
def test_steps_of_a_sweep_and_commands_in_motion_leave_the_edges(
    kind: str,
    module: ModuleType,
    name: str,
    look: Callable[..., RestMap | None],
    factor: float,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, name, type(getattr(module, name))(factor * getattr(module, name)))
    door = KINDS[kind](np.random.default_rng(9074))
    rest = look(*door.columns.values())
    assert rest is not None
    (part,) = rest.flats
    lower = door.numbers.get("lower", -door.numbers.get("left", 0.0))
    upper = door.numbers.get("upper", door.numbers.get("right"))
    for edge, truth in zip(edges_of(part), (lower, upper), strict=True):
        assert holds(edge.interval, truth)
        assert edge.interval.value == pytest.approx(truth, rel=0.03)


@pytest.mark.parametrize("size", [3000, 30_000])
def test_rates_without_a_band_have_none(size: int) -> None:
    rng = np.random.default_rng(6)
    u = rng.uniform(-100, 100, size // 20).repeat(20)
    for power in (1, 3):
        y = 0.02 * np.cumsum(np.append(0, 100 * (u / 100) ** power)[:-1])
        rest = map_of_rate(0.02 * np.arange(size), u, y + 0.02 * rng.standard_normal(size))
        assert rest is not None
        assert rest.flats == ()


def test_a_reading_that_answers_to_the_end_is_left_out_to_the_end() -> None:
    u = np.append(np.linspace(0, 5, 400), np.zeros(30))
    y = np.append(np.linspace(0, 5, 400), 5 * 0.9 ** np.arange(1, 31))
    rest = rows_at_rest(None, u, y)
    assert rest is not None
    assert rest.u.size <= 401


def test_logs_without_rest_have_no_map() -> None:
    rng = np.random.default_rng(8)
    u = rng.standard_normal(2000)
    y = np.convolve(u, np.ones(20) / 20)[:2000]
    assert map_at_rest(None, u, y) is None
    assert map_of_rate(np.arange(2000.0), u, y) is None
    assert rows_at_rest(None, u, np.ones(2000)) is None
    assert rows_at_rest(None, np.ones(2000), y) is None
    assert map_at_rest(None, u[:4], u[:4]) is None
    assert map_at_rest(None, u, np.full(2000, np.nan)) is None
    assert longest_stillness(None, u, np.full(2000, np.nan)) == 0


def test_missing_readings_and_missing_times_change_nothing() -> None:
    u = np.linspace(-1, 1, 101)
    y = zone(u, 0.2, 0.3)
    y[::7] = np.nan
    (part,) = found(u, y, np.cumsum(np.random.default_rng(0).uniform(0.5, 1.5, 101))).flats
    assert part == found(u, y).flats[0]
    assert edges_of(part)[1].interval.value == pytest.approx(0.3, abs=0.01)


def test_turns_and_noise() -> None:
    u = np.concatenate([np.linspace(0, 1, 50), np.linspace(0.99, 0.2, 40), np.linspace(0.3, 3, 60)])
    assert turns(u, 0.1).tolist() == [49, 89]
    assert turns(u, 0.9).tolist() == []
    assert turns(-u, 0.1).tolist() == [49, 89]
    noise = 0.2 * np.random.default_rng(0).standard_normal(4000)
    assert noise_of(u[0] + noise) == pytest.approx(0.2, rel=0.1)
    assert noise_of(0.5 * np.round(np.sin(np.arange(4000.0)) * 4)) > 0.1


def test_stillness_is_the_travel_of_the_command_in_a_band() -> None:
    t = np.arange(4000.0)
    u = np.sin(2 * np.pi * t / 1000)
    y = zone(u, 0.2, 0.3) + 1e-4 * np.random.default_rng(0).standard_normal(t.size)
    still = longest_stillness(t, u, y)
    assert 0.4 < still <= 0.51
    assert longest_stillness(t, u, u) == 0


def test_a_step_of_the_command_is_no_travel_at_rest() -> None:
    u = np.repeat([0.0, 1.0, 3.0, 4.0, 5.0, 8.0], 50)
    y = np.concatenate([np.zeros(25), u])[: u.size]  # late
    still = longest_stillness(None, u, y + 1e-4 * np.random.default_rng(0).standard_normal(u.size))
    assert still < 0.1


@pytest.mark.parametrize("lag", [0, 8])
def test_scattered_readings_have_a_map_unless_they_lag(lag: int) -> None:
    rng = np.random.default_rng(3)
    u = lfilter([1], [1, -0.9], rng.standard_normal(8000))
    y = np.minimum(np.roll(u, lag), 1) + 0.3 * rng.standard_normal(u.size)
    y[::50] = -9  # what else stops it
    if lag:
        assert map_at_rest(None, u, y) is None
        return
    (part,) = found(u, y).flats
    assert part.left is not None
    assert holds(part.left.interval, 1)


def test_a_log_too_short_for_a_past_has_no_map_of_what_scatters() -> None:
    u = np.repeat(np.arange(5.0), 7)
    drift = np.cumsum(np.random.default_rng(0).standard_normal(35))
    assert map_at_rest(np.arange(35.0), u, u + drift) is None


def test_readings_end_where_they_stay_longer_than_at_other_turns() -> None:
    u = np.random.default_rng(4).standard_normal(3000)
    z = lfilter([0.1], [1, -0.9], u)
    coarse = np.round(20 * z) / 20
    for y in (z, coarse, dragged(z, 0.4), np.maximum(z, 0)):
        assert ends_of_readings(None, u, y) == {}
    for y in (z, coarse):
        assert ends_of_readings(None, u, np.minimum(y, 0.4)).keys() == {"upper"}
