"""Long logs: what is searched in a part of them and then found from all samples."""

from __future__ import annotations

import numpy as np
import pytest

import undeadzone as uz
from records import dead_zone, logged, second_order, write_log
from undeadzone_identify.models import plant
from undeadzone_identify.models.plant import (
    PlantSimulator,
    RecordData,
    busiest_stretches,
    select_samples,
)
from undeadzone_identify.models.zone import WidthLimits
from undeadzone_identify.models.zone_fit import (
    fit_zone,
    refit_along,
    refit_busiest_part,
    refit_longest_record,
)


def log(size: int = 1600, late: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """u and y of a second-order plant that rests in the second quarter of the log."""
    rng = np.random.default_rng(7)
    u = np.repeat(rng.standard_normal(size // 10), 10)
    u[size // 4 : size // 2] *= 0.02
    z = second_order(np.roll(u, late))
    e = z + 0.03 * rng.standard_normal(size)
    return u, dead_zone(e, 0.5, 0.3)


def data_of(u: np.ndarray, y: np.ndarray, starts: tuple[int, ...] = (0,)) -> RecordData:
    return logged(u, y, starts, silent_zeros=True)


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if 800 samples were many."""
    monkeypatch.setattr(plant, "MANY", 800)


def test_the_part_is_where_both_edges_are_passed(short: None) -> None:
    u, y = log()
    data = data_of(u, y)
    part = busiest_stretches(data, 400)
    assert part.y.size == 800
    assert part.start.tolist() == [0, 400]
    passed = [np.count_nonzero(np.diff(part.side[k : k + 400])) for k in (0, 400)]
    assert min(passed) > 10
    resting = y[400:800]
    assert not any(np.array_equal(part.y[k : k + 400], resting) for k in (0, 400))
    quiet = data_of(u[:700], y[:700])
    assert busiest_stretches(quiet) is quiet


def test_stretches_stay_within_records(short: None) -> None:
    u, y = log()
    data = data_of(u, y, (0, 500, 620))
    part = busiest_stretches(data, 300)
    allowed = {tuple(y[a:b]) for a, b in ((0, 250), (250, 500), (500, 620))}
    allowed |= {
        tuple(y[a:b]) for a, b in zip((620, 865, 1110, 1355), (865, 1110, 1355, 1600), strict=True)
    }
    assert {tuple(part.y[one]) for one in part.record_slices()} <= allowed
    assert part.y.size <= 800


def test_a_fit_that_was_moved_to_all_ends_where_one_from_scratch_does(short: None) -> None:
    data = data_of(*log())
    part = busiest_stretches(data)
    small = fit_zone(PlantSimulator(part, 2), WidthLimits())
    all_ = fit_zone(PlantSimulator(data, 2), WidthLimits())
    carried = refit_along(small, data)
    assert carried.value == pytest.approx(all_.value, abs=0.1)
    assert (carried.right, carried.left) == pytest.approx((all_.right, all_.left), abs=1e-4)
    back = refit_busiest_part(all_)
    assert back.value == pytest.approx(small.value, abs=0.1)
    assert refit_longest_record(all_).objective.data.y.size == 800


def test_the_longest_of_several_records_is_refitted_alone() -> None:
    u, y = log()
    data = data_of(u, y, (0, 500, 620))
    fit = fit_zone(PlantSimulator(data, 2), WidthLimits())
    one = refit_longest_record(fit)
    assert np.array_equal(one.objective.data.y, y[620:])
    alone = select_samples(data, [slice(620, 1600)])
    assert one.value == pytest.approx(refit_along(fit, alone).value)


def test_an_answer_from_a_part_is_that_of_all(monkeypatch: pytest.MonkeyPatch) -> None:
    late = 4
    u, y = log(late=late)
    options = {"t": 0.05, "u": u, "y": y, "order": 2, "place": "sensor"}
    whole = uz.identify(**options)
    monkeypatch.setattr(plant, "MANY", 800)
    monkeypatch.setattr(plant, "STRETCH", 400)
    found = uz.identify(**options)
    assert isinstance(whole, uz.Identified)
    assert isinstance(found, uz.Identified)
    assert found.verdict == whole.verdict == "dead_zone"
    assert found.answer.found.delay == whole.answer.found.delay == late
    assert found.order == whole.order
    for name in ("right", "left", "width"):
        one, other = getattr(found, name), getattr(whole, name)
        assert tuple(one) == pytest.approx(tuple(other), abs=0.05 * other.half_width)


def test_friction_is_compared_on_one_of_two_records(tmp_path) -> None:
    """What places compare is one record, also where other maps were fitted to two."""
    rng = np.random.default_rng(3)
    u = np.repeat(rng.standard_normal(140), 10)
    v = np.zeros(u.size)
    for k in range(1, u.size):  # a mass with Coulomb friction, its velocity read
        free = 0.9 * v[k - 1] + 0.1 * u[k - 1]
        v[k] = np.sign(free) * max(abs(free) - 0.03, 0.0)
    y = v + 0.005 * rng.standard_normal(v.size)
    paths = []
    for name, part in (("a", slice(0, 600)), ("b", slice(600, 1400))):
        paths.append(str(tmp_path / f"{name}.csv"))
        write_log(paths[-1], "t,u,y", 0.05, u[part], y[part])
    found = uz.identify(paths, order=1)
    assert isinstance(found, uz.Identified)
    assert found.verdict == "friction"
