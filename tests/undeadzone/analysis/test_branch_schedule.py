"""Schedules of branches: from a record, and without branches that hardly any reading visits."""

from __future__ import annotations

import numpy as np
from test_identifiability import visiting

from undeadzone.analysis.branch_schedule import (
    _count_samples,
    drop_rare_branches,
    noiseless_reading,
    schedule_of_record,
)
from undeadzone.nonlinearities.sensor import Sensor, resolve


def test_dropout_of_one_output_alone_counts() -> None:
    schedule = visiting([True, True], [True, True], 0.01)
    judged = drop_rare_branches(schedule, np.array([1 - 1e-12, 0.0]), 0.01, 1.0, 2)
    assert (judged.sides[:, 0] == 0).all()
    np.testing.assert_array_equal(judged.sides[:, 1], schedule.sides[:, 1])
    assert (schedule.sides[:, 0] != 0).any()


def test_a_period_that_samples_never_meet_is_none() -> None:
    assert _count_samples(0.5, 0.1, 30.0) == (5, True)
    assert _count_samples(0.25, 0.1, 30.0) == (5, True)
    assert _count_samples(np.pi / 10, 0.1, 30.0) == (300, False)
    assert _count_samples(None, 0.1, 0.12) == (1, False)
    assert _count_samples(None, 0.1, 0.01) == (1, False)


def test_a_recorded_side_changes_half_way_between_two_samples() -> None:
    sensor = resolve(Sensor(right=1.0, left=1.0), 1, 0.1)
    z = np.array([0.0, 0.0, 0.0, 3.0, 3.0, -3.0, -3.0])[:, None]
    schedule = schedule_of_record(z, sensor, 0.1, None)
    np.testing.assert_allclose(schedule.sides[:, 0], [0.0, 1.0, -1.0])
    np.testing.assert_allclose(schedule.spans, [0.25, 0.2, 0.15], rtol=1e-12)


def test_a_side_is_lost_by_its_own_readings() -> None:
    """Of 100 readings on the right and 2 on the left, half are missing."""
    sides, spans = np.array([[1.0], [0.0], [-1.0]]), np.array([1.0, 0.5, 0.02])
    schedule = visiting([True], [True])._replace(sides=sides, spans=spans)
    judged = drop_rare_branches(schedule, np.array([0.5]), 0.01, spans.sum(), 2)
    np.testing.assert_array_equal(judged.sides[:, 0], [1.0, 0.0, 0.0])


def test_readings_of_a_play_end_at_both_ends_of_their_range() -> None:
    """On the way down y = z + left, and ends at -1."""
    sensor = resolve(Sensor(kind="play", right=0.4, left=0.3, range=[-1.0, 1.0]), 1, 0.01)
    z = np.array([[0.0], [-1.2], [-1.4], [0.0], [1.3], [1.5]])
    limited = noiseless_reading(z, sensor).limited[:, 0]
    assert limited.tolist() == [False, False, True, False, False, True]
